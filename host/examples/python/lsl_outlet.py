#!/usr/bin/env python3
"""Poses as a stream of the Lab Streaming Layer, for LabRecorder and other receivers.

    slitpose run --device auto --format ndjson | python3 lsl_outlet.py [NAME]

Needs pylsl (pip install pylsl). Channels follow the convention for motion capture
(https://github.com/sccn/xdf/wiki/MoCap-Meta-Data); a scan without a pose is a sample of NaN.

Time: LSL wants the instant of each sample by local_clock() of the sender's computer; receivers on other computers convert it
(time_correction(), or the flag proc_clocksync). slitpose states that instant, not that of arrival: measured by the board's
clock, it is converted to the computer's monotonic clock. On Linux that clock is local_clock() itself. Here the difference of
both clocks is measured all the same, and used, once a second. Scans whose instant is not known yet, as the very
first, are left out.

Rate: the stream is declared irregular. With a nominal rate, importers such as pyxdf replace time stamps by evenly
spaced ones, which would be wrong after a lost scan. `effective_srate` of the importer is then the rate of the scans.
"""

import json
import math
import sys
import time

import pylsl

# On Windows the daemon's monotonic clock is its own, so there UTC is what both know.
FIELD, CLOCK_NS = ("host_utc_ns", time.time_ns) if sys.platform == "win32" else ("host_monotonic_ns", time.monotonic_ns)
CHANNELS = [("x", "PositionX", "meters"), ("y", "PositionY", "meters"), ("z", "PositionZ", "meters"),
            ("qx", "OrientationB", "quaternion"), ("qy", "OrientationC", "quaternion"),
            ("qz", "OrientationD", "quaternion"), ("qw", "OrientationA", "quaternion")]  # fmt: skip


def lsl_minus_clock_ns():
    """local_clock() minus the clock of the poses: the reading that took least time, of ten."""
    readings = []
    for _ in range(10):
        before, lsl_s, after = CLOCK_NS(), pylsl.local_clock(), CLOCK_NS()
        readings.append((after - before, round(lsl_s * 1e9) - (before + after) // 2))
    return min(readings)[1]


def outlet_of(name, device):
    info = pylsl.StreamInfo(name, "MoCap", len(CHANNELS), pylsl.IRREGULAR_RATE, pylsl.cf_double64, f"slitpose-{device}")
    channels = info.desc().append_child("channels")
    for label, kind, unit in CHANNELS:
        channel = channels.append_child("channel")
        for key, value in [("label", label), ("object", "tool"), ("type", kind), ("unit", unit)]:
            channel.append_child_value(key, value)
    info.desc().append_child("acquisition").append_child_value("manufacturer", "slitpose")
    # For slow receivers: 360 000 samples (of an irregular stream LSL counts hundreds), a minute and a half at 4 kHz.
    return pylsl.StreamOutlet(info, max_buffered=3600)


def main():
    name = sys.argv[1] if len(sys.argv) > 1 else "slitpose"
    outlets, offset_ns, measured = {}, 0, -math.inf
    for line in sys.stdin:
        scan = json.loads(line)
        if "kind" in scan or scan.get(FIELD) is None:
            continue
        if time.monotonic() - measured > 1:
            offset_ns, measured = lsl_minus_clock_ns(), time.monotonic()
        device = scan["device"]
        if device not in outlets:
            outlets[device] = outlet_of(name, device)
        if scan["translation_m"] is None:
            sample = [math.nan] * len(CHANNELS)
        else:
            sample = scan["translation_m"] + scan["rotation_xyzw"]
        outlets[device].push_sample(sample, (scan[FIELD] + offset_ns) * 1e-9)
    # LSL sends in the background, and drops what is left at the end of the program.
    time.sleep(2)


if __name__ == "__main__":
    main()
