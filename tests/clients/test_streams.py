"""Poses as LSL, OSC and opentrack receive them: see `run`."""

import json
import math
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path

import numpy as np
import pylsl
from pythonosc.osc_bundle import OscBundle

EXAMPLES = Path(__file__).parents[2] / "host/examples/python"


def setUpModule():
    """Three seconds of a simulated board at its own pace, and a scan without a pose at their end."""
    global LINES, SCANS
    run = ("run", "--config", "none", "--device", "sim", "--trajectory", "smooth", "--duration", "3s", "--format", "ndjson")
    text = subprocess.run([os.environ["SLITPOSE"], *run], check=True, capture_output=True, text=True).stdout
    LINES = text.splitlines(keepends=True)
    lost = [scan for scan in map(json.loads, LINES) if "kind" not in scan][-1]
    lost.update(status="too_dark", translation_m=None, rotation_xyzw=None, covariance=None, twist=None)
    lost["host_monotonic_ns"] += 250_000
    LINES.append(json.dumps(lost) + "\n")
    SCANS = [scan for scan in map(json.loads, LINES) if "kind" not in scan]


def sender(name, *arguments, **options):
    command = [sys.executable, EXAMPLES / f"{name}.py", *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, text=True, **options)


def datagrams(name, *arguments):
    """What the sender sends for all lines."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(2)
        process = sender(name, f"127.0.0.1:{receiver.getsockname()[1]}", *arguments)
        threading.Thread(target=process.communicate, args=("".join(LINES),)).start()
        found = []
        while True:
            try:
                found.append(receiver.recv(2000))
            except TimeoutError:
                break
        assert process.wait() == 0
        return found


def one_of_each(slots_per_s):
    """The first scan with a pose of each slot by the board's clock."""
    first = {}
    for scan in SCANS:
        if scan["translation_m"]:
            first.setdefault(math.floor(scan["device_time_s"] * slots_per_s), scan)
    return list(first.values())


def matrix(x, y, z, w):
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])  # fmt: skip


def turn(axis, degrees):
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    found = np.eye(3)
    found[j, j] = found[k, k] = cos
    found[k, j], found[j, k] = sin, -sin
    return found


class Streams(unittest.TestCase):
    def test_lsl_has_every_scan_at_its_instant(self):
        with tempfile.TemporaryDirectory() as folder:
            # No other machine is asked.
            settings = Path(folder, "lsl_api.cfg")
            settings.write_text("[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {127.0.0.1}\n")
            os.environ["LSLAPICFG"] = str(settings)
            timed = [scan for scan in SCANS if scan.get("host_monotonic_ns")]
            process = sender("lsl_outlet", "tried", env=os.environ)
            # The outlet is made for the first scan; what follows comes once somebody listens.
            process.stdin.write(json.dumps(timed[0]) + "\n")
            process.stdin.flush()
            (info,) = pylsl.resolve_byprop("name", "tried", timeout=20)
            inlet = pylsl.StreamInlet(info, max_buflen=3600)
            inlet.open_stream(timeout=20)
            described = inlet.info(timeout=20)
            self.assertEqual((described.type(), described.nominal_srate(), described.channel_count()), ("MoCap", 0, 7))
            self.assertEqual(described.source_id(), f"slitpose-{timed[0]['device']}")
            self.assertEqual(described.get_channel_labels(), ["x", "y", "z", "qx", "qy", "qz", "qw"])
            rest = [json.dumps(scan) + "\n" for scan in SCANS[SCANS.index(timed[0]) + 1 :]]
            writer = threading.Thread(target=process.communicate, args=("".join(rest),))
            writer.start()
            samples, instants = [], []
            while not samples or not math.isnan(samples[-1][0]):
                sample, instant = inlet.pull_sample(timeout=10)
                self.assertIsNotNone(sample, f"{len(samples)} of {len(timed)}")
                samples.append(sample)
                instants.append(instant)
            writer.join()
            self.assertEqual(process.returncode, 0)
        count = len(timed)
        # Nobody may have listened yet when the first was sent.
        timed = timed[-len(samples) :]
        self.assertIn(len(samples), (count - 1, count))
        expected = [scan["translation_m"] + scan["rotation_xyzw"] if scan["translation_m"] else [math.nan] * 7 for scan in timed]
        np.testing.assert_array_equal(samples, expected)
        # By the clock of LSL, which on Linux is the monotonic clock.
        off = np.array(instants) - 1e-9 * np.array([scan["host_monotonic_ns"] for scan in timed])
        print(f"{len(samples)} samples; LSL's clock minus the host's: {1e6 * off.min():.1f} to {1e6 * off.max():.1f} us")
        self.assertLess(np.abs(off).max(), 100e-6)

    def test_osc_has_a_pose_of_each_hundredth_second_with_its_instant(self):
        expected = one_of_each(100)
        bundles = [OscBundle(datagram) for datagram in datagrams("osc_sender")]
        self.assertEqual(len(bundles), len(expected))
        for bundle, scan in zip(bundles, expected):
            (message,) = bundle
            self.assertEqual(message.address, "/slitpose/pose")
            device, *numbers = message.params
            self.assertEqual(device, scan["device"])
            pose = scan["translation_m"] + scan["rotation_xyzw"]
            self.assertEqual(numbers, [struct.unpack("f", struct.pack("f", number))[0] for number in pose])
            if scan.get("host_utc_ns"):
                self.assertLess(abs(bundle.timestamp - 1e-9 * scan["host_utc_ns"]), 1e-6)
        self.assertEqual(len(datagrams("osc_sender", "20")), len(one_of_each(20)))

    def test_opentrack_turns_as_the_tool(self):
        expected = one_of_each(250)
        found = [struct.unpack("<6d", datagram) for datagram in datagrams("opentrack_sender")]
        self.assertEqual(len(found), len(expected))
        # x is x, y is z, z is -y.
        axes = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
        for (*position_cm, yaw, pitch, roll), scan in zip(found, expected):
            np.testing.assert_allclose(position_cm, 100 * axes @ scan["translation_m"], rtol=1e-12)
            rotation = turn(1, yaw) @ turn(0, pitch) @ turn(2, -roll)
            np.testing.assert_allclose(rotation, axes @ matrix(*scan["rotation_xyzw"]) @ axes.T, atol=1e-12)


if __name__ == "__main__":
    unittest.main()
