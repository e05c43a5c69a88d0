#!/usr/bin/env python3
"""Poses for opentrack, which passes them on to games and flight simulators: choose its input "UDP over network".

    slitpose run --device auto --format ndjson | python3 opentrack_sender.py [HOST:PORT]

Needs Python alone. By default 127.0.0.1:4242, opentrack's port. A datagram is six little-endian doubles: x, y, z in cm, yaw,
pitch, roll in degrees (opentrack: tracker-udp/ftnoir_tracker_udp.cpp reads double[6], api/plugin-api.hpp has their
order). Its rotation is Ry(yaw) Rx(pitch) Rz(-roll) (logic/pipeline.cpp, compat/euler.cpp) with x to the right, y up and z to the
back, so that of a base frame whose z points up, x is x, y is z and z is -y. Inputs can be exchanged and inverted in opentrack;
`slitpose run --frame` gives poses in a frame of yours.

At most 250 datagrams a second are sent, as often as opentrack looks. They have no time: opentrack takes the newest. Scans
without a pose are not sent; opentrack keeps the last pose. With several boards the first one is sent.
"""

import json
import math
import socket
import struct
import sys

DATAGRAM = struct.Struct("<6d")
PERIOD_S = 1 / 250


def datagram_of(scan):
    (x, y, z), (qx, qy, qz, w) = scan["translation_m"], scan["rotation_xyzw"]
    # The same in opentrack's axes.
    x, y, z, qx, qy, qz = x, z, -y, qx, qz, -qy
    yaw = math.atan2(2 * (qx * qz + w * qy), 1 - 2 * (qx * qx + qy * qy))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * qx - qy * qz))))
    roll = -math.atan2(2 * (qx * qy + w * qz), 1 - 2 * (qx * qx + qz * qz))
    return DATAGRAM.pack(100 * x, 100 * y, 100 * z, *map(math.degrees, (yaw, pitch, roll)))


def main():
    host, _, port = (sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1:4242").rpartition(":")
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    device = slot = None
    for line in sys.stdin:
        scan = json.loads(line)
        if "kind" in scan or scan["translation_m"] is None:
            continue
        device = device or scan["device"]
        now = math.floor(scan["device_time_s"] / PERIOD_S)
        if scan["device"] == device and now != slot:
            slot = now
            sender.sendto(datagram_of(scan), (host, int(port)))


if __name__ == "__main__":
    main()
