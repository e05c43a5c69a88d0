"""Captures of the `slitpose` that the variable SLITPOSE names, read by public packages: see `run`."""

import csv
import io
import math
import os
import subprocess
import tempfile
import tomllib
import unittest
from pathlib import Path

import jsonschema
from rosbags.highlevel import AnyReader

from read_capture import read

FRAME_RATE_HZ = 4000
POSES_HZ = 25

#: Of the shipped scene: six cells of two words of 16 bits.
LEAST_SCAN_BYTES = 24


def slitpose(*arguments):
    """Standard output of a command that has done its work."""
    command = [os.environ["SLITPOSE"], *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


# Record kinds of MCAP, and how long its magic is: https://mcap.dev/spec.
CHUNK, MESSAGE_INDEX, MAGIC_BYTES = 6, 7, 8


def record_from(content, start, kind):
    """Where the first record of this kind behind `start` begins."""
    at = MAGIC_BYTES
    while at < start or content[at] != kind:
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    return at


class Captures(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.simulated, cls.followed, cls.whole, cls.cut = (
            os.path.join(folder.name, name + ".mcap") for name in ("simulated", "followed", "whole", "cut")
        )
        slitpose("simulate", "--duration", "1s", "--output", cls.simulated)
        run = ("run", "--config", "none", "--device", "sim", "--speed", "max", "--format", "csv")
        cls.printed = slitpose(*run, "--duration", "2s", "--record", cls.followed)
        slitpose(*run, "--duration", "2s", "--record", cls.whole, "--record-poses", "0")

    def test_bytes_alone(self):
        contents = read(self.simulated)
        self.assertTrue(contents.finished)
        self.assertNotIn("pose", contents.counts())
        self.assertGreater(contents.raw_bytes, FRAME_RATE_HZ * LEAST_SCAN_BYTES)
        self.assertEqual((contents.timed_reads, len(contents.devices)), (0, 1))
        self.assertEqual(list(contents.scenes), ["wide.toml"])

    def test_poses_as_printed(self):
        contents = read(self.followed)
        self.assertTrue(contents.finished)
        counts = contents.counts()
        self.assertEqual(counts["pose"], 2 * POSES_HZ)
        # That of the first scans is not known, nor where the tool is not where its motion led.
        self.assertGreater(counts["twist"], 0.9 * counts["pose"])
        self.assertLess(counts["twist"], counts["pose"] + 1)
        self.assertGreater(counts["report"], 0)
        rows = csv.DictReader(io.StringIO(self.printed))
        printed_m = [[float(row[f"t{axis}_mm"]) * 1e-3 for axis in "xyz"] for row in rows]
        self.assertEqual(len(printed_m), 2 * FRAME_RATE_HZ)
        # At this distance from each other, but for one that rounding moves to the next scan.
        last, distance = None, FRAME_RATE_HZ // POSES_HZ
        for position_m in contents.positions_m:
            start, end = (0, 1) if last is None else (last + distance - 1, last + distance + 2)
            near = range(start, min(end, len(printed_m)))
            last = next((row for row in near if self._is_same(printed_m[row], position_m)), None)
            self.assertIsNotNone(last, f"{position_m} is not among the rows {near}")

    @staticmethod
    def _is_same(a, b):
        return all(abs(x - y) < 1e-12 for x, y in zip(a, b))

    def test_ros_tools_read_every_topic(self):
        with AnyReader([Path(self.followed)]) as reader:
            found = {}
            for connection, _, data in reader.messages():
                message = reader.deserialize(data, connection.msgtype)
                # https://design.ros2.org/articles/topic_and_service_names.html, without ~ and {}
                self.assertRegex(connection.topic, r"^(/[A-Za-z_][A-Za-z0-9_]*)+$")
                found.setdefault(connection.topic.rsplit("/", 1)[1], []).append(message)
        self.assertEqual(set(found), {"link", "hello", "head", "pose", "pose_stamped", "tf", "twist", "report"})
        self.assertEqual(len(found["pose"]), 2 * POSES_HZ)
        self.assertEqual([marker.header.frame_id for marker in found["head"][0].markers], ["base", "base", "tool", "tool"])
        self.assertEqual({len(found[kind]) for kind in ("pose_stamped", "tf")}, {2 * POSES_HZ})
        for pose, stamped, transforms in zip(found["pose"], found["pose_stamped"], found["tf"]):
            (transform,) = transforms.transforms
            self.assertEqual((stamped.header, transform.header), (pose.header, pose.header))
            self.assertEqual((transform.header.frame_id, transform.child_frame_id), ("base", "tool"))
            self.assertEqual(stamped.pose, pose.pose.pose)
            self.assertEqual(self._numbers(transform.transform.rotation), self._numbers(stamped.pose.orientation))
            self.assertEqual(self._numbers(transform.transform.translation), self._numbers(stamped.pose.position)[:3])

    def test_the_head_as_the_scene_says(self):
        for path in (self.simulated, self.followed):
            contents = read(path)
            (head,), (scene,) = contents.heads.values(), contents.scenes.values()
            scene = tomllib.loads(scene.data.decode())
            (of_detectors, detectors), (of_masks, masks), (of_emitters, emitters) = (
                head[kind] for kind in ("detectors", "masks", "emitters")
            )
            self.assertEqual((of_detectors, of_masks, of_emitters), ("base", "base", "tool"))
            sizes = [[scene[part][f"{size}_mm"] for size in ("width", "length")] for part in ("detector", "slit")]
            # Two triangles a detector, eight a mask: two between each edge of the mask and that of the slit.
            for cell, corners, mask, emitter in zip(scene["cell"], self._by(6, detectors), self._by(24, masks), emitters):
                self._are_close(emitter, cell["emitter_mm"])
                self._are_close(self._centre(corners), cell["detector_mm"])
                slit = [at_mm + scene["slit"]["distance_mm"] * z for at_mm, z in zip(cell["detector_mm"], cell["normal"])]
                inner = [point for index, point in enumerate(mask) if index % 6 in (2, 4)]
                self._are_close(self._centre(inner), slit)
                for (width_mm, length_mm), points in zip(sizes, (corners, inner)):
                    # The farthest corners are a diagonal apart.
                    diagonal_mm = max(math.dist(a, b) for a in points for b in points) * 1e3
                    self.assertAlmostEqual(diagonal_mm, math.hypot(width_mm, length_mm), places=9)

    @staticmethod
    def _by(count, points):
        return [points[start : start + count] for start in range(0, len(points), count)]

    @staticmethod
    def _centre(points):
        """Half way between the two farthest: the centre of a rectangle, whichever corners come twice."""
        a, b = max(((a, b) for a in points for b in points), key=lambda ends: math.dist(*ends))
        return [(x + y) / 2 for x, y in zip(a, b)]

    def _are_close(self, found_m, expected_mm):
        for metres, millimetres in zip(found_m, expected_mm, strict=True):
            self.assertAlmostEqual(metres * 1e3, millimetres, places=9)

    @staticmethod
    def _numbers(message):
        return [getattr(message, axis) for axis in "xyzw" if hasattr(message, axis)]

    def test_reports_are_what_their_schema_says(self):
        contents = read(self.followed)
        schema = contents.report_schema
        boards = {"$defs": schema["$defs"], "$ref": "#/$defs/BoardReport"}
        of_boards = [report for topic, report in contents.reports if topic != "/slitpose/report"]
        of_program = [report for topic, report in contents.reports if topic == "/slitpose/report"]
        self.assertGreater(min(len(of_boards), len(of_program)), 0)
        for reports, of in ((of_boards, boards), (of_program, schema)):
            validator = jsonschema.Draft202012Validator(of)
            for report in reports:
                validator.validate(report)
        # A schema that takes anything would say nothing.
        for key in ("scans", "losses", "link"):
            broken = {**of_boards[-1], key: "none"}
            self.assertFalse(jsonschema.Draft202012Validator(boards).is_valid(broken), key)
            del broken[key]
            self.assertFalse(jsonschema.Draft202012Validator(boards).is_valid(broken), key)

    def test_a_pose_for_every_scan(self):
        contents = read(self.whole)
        self.assertEqual(contents.counts()["pose"], 2 * FRAME_RATE_HZ)

    def test_a_capture_that_was_cut_off(self):
        whole = read(self.whole)
        with open(self.whole, "rb") as file:
            content = file.read()
        # Within a chunk, and within each kind of record that follows one.
        start = len(content) * 6 // 10
        for kind in (CHUNK, MESSAGE_INDEX):
            self.cut_off(content, record_from(content, start, kind) + 12, whole)

    def cut_off(self, content, length, whole):
        with open(self.cut, "wb") as cut:
            cut.write(content[:length])
        cut = read(self.cut)
        self.assertFalse(cut.finished)
        print("\ncut:", cut.counts(), "of", whole.counts())
        self.assertEqual(cut.positions_m, whole.positions_m[: len(cut.positions_m)])
        self.assertGreater(len(cut.positions_m), 0)
        self.assertLess(len(cut.positions_m), len(whole.positions_m))


if __name__ == "__main__":
    unittest.main()
