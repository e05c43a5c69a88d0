"""The table that describes the frames for a motor controller is enough to read them: see `frame`."""

import math
import re
import unittest

import frame


class Frame(unittest.TestCase):
    def setUp(self):
        with open(frame.PAGE, encoding="utf-8") as page:
            texts = re.findall(r'const WITH(?:OUT)?_POSE: &str = "([0-9a-f\\\s]+)"', page.read())
        self.with_pose, self.without_pose = (bytes.fromhex(re.sub(r"\\\s+", "", text)) for text in texts)

    def test_the_table_has_64_bytes(self):
        self.assertEqual(frame.table()[1], 64)

    def test_a_frame_has_the_numbers_it_was_made_of(self):
        (values,), others = frame.frames(self.with_pose)
        self.assertEqual(others, 0)
        self.assertEqual((values[0], values[2], values[3]), (b"\xa5\x5a", 1, 2))
        self.assertEqual((values[4], values[8], values[12], values[14]), (0x89ABCDEF, 0xFEDCBA98, 1234, 5))
        self.assertEqual((values[16], values[18]), (0b111101, 0b10))
        for value, expected in zip(values[20], (1e-3, -2e-3, 0.5), strict=True):
            self.assertAlmostEqual(value, expected, delta=1e-10)
        self.assertEqual(values[32], (0.5, -0.5, 0.5, 0.5))
        self.assertEqual((values[48], values[52], values[56]), (3 * 2**-20, 9 * 2**-15, 6.25))

    def test_a_frame_without_a_pose_has_no_numbers(self):
        (values,), _ = frame.frames(self.without_pose)
        self.assertEqual(values[3], 6)
        self.assertTrue(all(math.isnan(value) for value in (*values[20], *values[32], values[48], values[52])))

    def test_damaged_and_cut_frames_cost_no_other(self):
        damaged = bytearray(self.with_pose)
        damaged[40] ^= 1
        stream = self.with_pose[50:] + self.with_pose + bytes(damaged) + self.with_pose[:30] + self.without_pose
        found, others = frame.frames(stream)
        self.assertEqual(([values[3] for values in found], others), ([2, 6], 14 + 64 + 30))


if __name__ == "__main__":
    unittest.main()
