#!/usr/bin/env python3
"""Poses as Open Sound Control, for Max, Pure Data, SuperCollider, TouchDesigner and others.

    slitpose run --device auto --format ndjson | python3 osc_sender.py HOST:PORT [RATE_HZ]

Needs python-osc (pip install python-osc). Each pose is a bundle with one message, /slitpose/pose: the board (string), then
x, y, z in metres and the quaternion x, y, z, w as 32-bit floats. At most RATE_HZ (100) bundles a second are sent, chosen by the
board's clock; scans without a pose are not sent.

Time: the bundle's time tag is the instant at which the light was measured, in UTC, not that of sending. It lies in the past, so
receivers act on it at once and may compute its age. Before that instant is known the tag says "immediately".
"""

import json
import math
import sys

from pythonosc import osc_bundle_builder, osc_message_builder, udp_client


def bundle_of(scan):
    utc_ns = scan.get("host_utc_ns")
    bundle = osc_bundle_builder.OscBundleBuilder(osc_bundle_builder.IMMEDIATELY if utc_ns is None else utc_ns * 1e-9)
    message = osc_message_builder.OscMessageBuilder("/slitpose/pose")
    message.add_arg(scan["device"], "s")
    for number in scan["translation_m"] + scan["rotation_xyzw"]:
        message.add_arg(number, "f")
    bundle.add_content(message.build())
    return bundle.build()


def main():
    if len(sys.argv) < 2 or ":" not in sys.argv[1]:
        sys.exit(f"usage: {sys.argv[0]} HOST:PORT [RATE_HZ]")
    host, _, port = sys.argv[1].rpartition(":")
    period_s = 1 / float(sys.argv[2] if len(sys.argv) > 2 else 100)
    client = udp_client.UDPClient(host, int(port))
    slots = {}
    for line in sys.stdin:
        scan = json.loads(line)
        if "kind" in scan or scan["translation_m"] is None:
            continue
        # One of each slot of a period.
        slot = math.floor(scan["device_time_s"] / period_s)
        if slots.get(scan["device"]) != slot:
            slots[scan["device"]] = slot
            client.send(bundle_of(scan))


if __name__ == "__main__":
    main()
