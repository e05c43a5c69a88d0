#!/usr/bin/env python3
"""The tool as a 6-DoF mouse, for Blender, FreeCAD and all programs that use libspnav.

    slitpose run --device auto --format ndjson | python3 spacenav_mouse.py SOCKET [options] &
    SPNAV_SOCKET=SOCKET blender

It stands in for spacenavd: without SPNAV_SOCKET programs look for /var/run/spnav.sock. The tool's displacement from the origin
sets the speed of the motion; with `slitpose run --frame FILE`, `slitpose zero` makes the present pose the origin. Without a pose
nothing moves. The first board is the mouse. Python alone is needed.

The protocol is version 0 of spacenavd's (proto.h and spnav.c of libspnav 1.1): an event is eight 32-bit integers, 0 for motion,
x, y, z, rx, ry, rz, and the milliseconds since the event before. A client sends a float, its sensitivity, or asks for another
version by 0x7faa5500 | version, and is told 0.
"""

import argparse
import json
import math
import os
import selectors
import socket
import struct
import sys
import time

FULL = 350  # Full deflection of the usual devices.
PERIOD_S = 1 / 60
LOST_S = 0.1  # Without scans for this long the tool counts as at rest.
MAX_CLIENTS = 16
VERSION_0 = 0x7FAA5500


def axes(text):
    """Axes of the base that point to the right, up and into the screen, as (axis, sign)."""
    names = [name.strip() for name in text.split(",")]
    if sorted(name.removeprefix("-") for name in names) != ["x", "y", "z"]:
        raise argparse.ArgumentTypeError("name x, y and z once each, such as x,z,y or y,z,-x")
    return [("xyz".index(name[-1]), -1 if name[0] == "-" else 1) for name in names]


def motion(scan, feel):
    """Six steps, of a scan's displacement."""
    if scan["translation_m"] is None:
        return (0,) * 6
    x, y, z, w = scan["rotation_xyzw"]
    length = math.hypot(x, y, z)
    per = 2 * math.atan2(length, abs(w)) / length * math.copysign(1, w) if length else 0
    found = []
    for values, half in ((scan["translation_m"], feel.half_mm * 1e-3), ((per * x, per * y, per * z), math.radians(feel.half_deg))):
        for axis, sign in feel.axes:
            beyond = max(abs(values[axis]) / half - feel.dead_zone, 0) / (1 - feel.dead_zone)
            found.append(round(math.copysign(min(FULL * feel.gain * beyond, FULL), sign * values[axis])))
    return tuple(found)


class Client:
    def __init__(self, connection):
        self.connection, self.sensitivity, self.is_at_rest, self.part = connection, 1.0, True, b""

    def listen(self):
        """Takes what the client says; whether it is still there."""
        try:
            said = self.connection.recv(1024)
            words, self.part = self.part + said, b""
            for at in range(0, len(words), 4):
                word = words[at : at + 4]
                if len(word) < 4:
                    self.part = word
                elif struct.unpack("=I", word)[0] & ~0xFF == VERSION_0:
                    self.connection.send(struct.pack("=I", VERSION_0))
                elif math.isfinite(value := struct.unpack("=f", word)[0]):
                    self.sensitivity = value
            return bool(said)
        except OSError as error:
            return isinstance(error, BlockingIOError)

    def tell(self, steps, period_ms):
        """Sends an event, of a tool at rest once; whether the client is still there. One that does not read misses events."""
        if self.is_at_rest and not any(steps):
            return True
        try:
            limited = (max(-(2**31), min(2**31 - 1, int(step * self.sensitivity))) for step in steps)
            sent = self.connection.send(struct.pack("=8i", 0, *limited, period_ms))
        except OSError as error:
            return isinstance(error, BlockingIOError)
        self.is_at_rest = not any(steps)
        return sent == 32


def serve(listener, feel):
    selector = selectors.DefaultSelector()
    selector.register(listener, selectors.EVENT_READ)
    selector.register(sys.stdin.buffer, selectors.EVENT_READ)
    clients, rest, device, steps = {}, b"", None, (0,) * 6
    seen_s = told_s = due_s = time.monotonic()

    def drop(client):
        selector.unregister(client.connection)
        clients.pop(client.connection).connection.close()

    while True:
        newest = None
        for key, _ in selector.select(max(due_s - time.monotonic(), 0)):
            if key.fileobj is listener:
                connection, _ = listener.accept()
                connection.setblocking(False)
                if len(clients) == MAX_CLIENTS:
                    connection.close()
                else:
                    clients[connection] = Client(connection)
                    selector.register(connection, selectors.EVENT_READ)
            elif key.fileobj in clients:
                if not clients[key.fileobj].listen():
                    drop(clients[key.fileobj])
            else:
                if not (read := os.read(sys.stdin.fileno(), 1 << 16)):
                    return
                *lines, rest = (rest + read).split(b"\n")
                for line in lines:
                    # Lines with a kind are no poses; only the newest pose is looked into, unless boards have to be told apart.
                    if line.startswith(b'{"seq"'):
                        scan = json.loads(line) if device is None else None
                        device = device or scan["device"].encode()
                        newest = line if device in line else newest
        now_s = time.monotonic()
        if newest:
            steps, seen_s = motion(json.loads(newest), feel), now_s
        if now_s >= due_s:
            due_s = now_s + PERIOD_S
            steps = steps if now_s - seen_s < LOST_S else (0,) * 6
            if any(steps) or any(not client.is_at_rest for client in clients.values()):
                period_ms, told_s = min(int(1000 * (now_s - told_s)), 1000), now_s
                for client in [client for client in clients.values() if not client.tell(steps, period_ms)]:
                    drop(client)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("socket", help="path of the socket; an old one is replaced")
    parser.add_argument("--gain", type=float, default=1, help="full deflections at the edge of the workspace")
    parser.add_argument("--dead-zone", type=float, default=0.05, help="share of the workspace in which an axis gives nothing")
    parser.add_argument("--axes", type=axes, default="x,z,y", help="axes of the base to the right, up, into the screen (x,z,y)")
    parser.add_argument("--half-mm", type=float, default=3.3, help="edge of the workspace from its middle, that of `wide`")
    parser.add_argument("--half-deg", type=float, default=15, help="the same in rotations")
    feel = parser.parse_args()
    if not (feel.gain > 0 and 0 <= feel.dead_zone <= 0.9 and feel.half_mm > 0 and feel.half_deg > 0):
        parser.error("give a gain and edges above 0, and a dead zone from 0 to 0.9")
    with socket.socket(socket.AF_UNIX) as listener:
        if os.path.exists(feel.socket):
            with socket.socket(socket.AF_UNIX) as other:
                if other.connect_ex(feel.socket) == 0:
                    parser.error(f"another program serves {feel.socket}; give another path, or end it")
            os.unlink(feel.socket)
        listener.bind(feel.socket)
        try:
            listener.listen()
            listener.setblocking(False)
            serve(listener, feel)
        except KeyboardInterrupt:
            pass
        finally:
            os.unlink(feel.socket)


if __name__ == "__main__":
    main()
