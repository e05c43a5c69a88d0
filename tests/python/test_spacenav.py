"""The tool as a 6-DoF mouse, seen by Debian's libspnav, the library of Blender and FreeCAD."""

import ctypes
import ctypes.util
import os
import select
import subprocess
import sys
import tempfile
import time
import unittest

#: Longer than any answer takes on a busy machine.
PATIENCE_S = 60

MOTION = 1

MOUSE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../host/examples/python/spacenav_mouse.py")

#: Of the shipped scene: half extents of its workspace.
HALF_EXTENT_MM, HALF_EXTENT_RAD = 3.3, 0.2617993877991494
FULL, DEAD_ZONE = 350, 0.05


class Motion(ctypes.Structure):
    """`struct spnav_event_motion` of spnav.h."""

    _fields_ = [(name, ctypes.c_int) for name in ("type", "x", "y", "z", "rx", "ry", "rz")]
    _fields_ += [("period", ctypes.c_uint), ("data", ctypes.c_void_p)]


class Event(ctypes.Union):
    """`spnav_event` of spnav.h; larger than any of its members."""

    _fields_ = [("type", ctypes.c_int), ("motion", Motion), ("room", ctypes.c_char * 256)]


def steps(deflection):
    """What a device gives for a share of the workspace."""
    beyond = max(abs(deflection) - DEAD_ZONE, 0) / (1 - DEAD_ZONE)
    return min(FULL * beyond, FULL) * (1 if deflection > 0 else -1)


class Spacenav(unittest.TestCase):
    def setUp(self):
        name = ctypes.util.find_library("spnav")
        self.assertIsNotNone(name, "no libspnav; on Debian an administrator runs: apt-get install libspnav0")
        self.library = ctypes.CDLL(name)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = os.path.join(folder.name, "spnav.sock")
        # A tool that is held still, off its zero.
        self.trajectory = os.path.join(folder.name, "held.csv")
        with open(self.trajectory, "w") as table:
            table.write("time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n")
            for time_s in (0, 1000):
                table.write(f"{time_s},2,-1,0.1,0,0.1,0\n")
        # libspnav reads it as it opens; Python's os.environ reaches C by putenv.
        os.environ["SPNAV_SOCKET"] = self.path

    def test_a_held_tool_moves_at_its_rate(self):
        run = (os.environ["SLITPOSE"], "run", "--config", "none", "--device", "sim", "--format", "ndjson")
        daemon = subprocess.Popen([*run, "--trajectory", self.trajectory], stdout=subprocess.PIPE)
        mouse = subprocess.Popen([sys.executable, MOUSE, self.path], stdin=daemon.stdout)
        daemon.stdout.close()
        try:
            deadline = time.monotonic() + PATIENCE_S
            while self.library.spnav_open() != 0:
                self.assertLess(time.monotonic(), deadline, "no socket")
                self.assertIsNone(mouse.poll(), "the mouse has ended")
                time.sleep(0.05)
            event = Event()
            for _ in range(20):
                ready, _, _ = select.select([self.library.spnav_fd()], [], [], PATIENCE_S)
                self.assertTrue(ready, "no event")
                self.assertEqual(self.library.spnav_poll_event(ctypes.byref(event)), MOTION)
                motion = event.motion
                found = (motion.x, motion.y, motion.z, motion.rx, motion.ry, motion.rz)
                # To the right x, up z, into the screen y; z lies within the dead zone.
                moved = (2 / HALF_EXTENT_MM, 0, -1 / HALF_EXTENT_MM)
                turned = (0, 0, 0.1 / HALF_EXTENT_RAD)
                for value, expected in zip(found, map(steps, moved + turned)):
                    # 8 σ of a frame: 4 µm, 0.5 mrad.
                    self.assertAlmostEqual(value, expected, delta=6)
                self.assertLessEqual(motion.period, 1000)
            self.library.spnav_close()
        finally:
            daemon.terminate()
            daemon.wait(PATIENCE_S)
            mouse.wait(PATIENCE_S)
        self.assertFalse(os.path.exists(self.path))
