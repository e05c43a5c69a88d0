"""The library of the solver from C#: see `run`."""

import csv
import io
import math
import os
import random
import subprocess
import tempfile
import unittest
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "host/examples/csharp/SolveCurrents.cs"
SEED, ROWS = 1, 100


def output_of(*command, **options):
    return subprocess.run(command, check=True, capture_output=True, text=True, **options).stdout


class Solver(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.program = os.path.join(self.folder.name, "SolveCurrents.exe")
        output_of("mcs", f"-out:{self.program}", EXAMPLE)

    def solve(self, *arguments, **options):
        environment = {**os.environ, "LD_LIBRARY_PATH": os.environ["SLITPOSE_SOLVER"]}
        return subprocess.run(["mono", self.program, *arguments], env=environment, cwd=self.folder.name, capture_output=True, text=True, **options)

    def slitpose(self, *arguments, **options):
        return output_of(os.environ["SLITPOSE"], *arguments, cwd=self.folder.name, **options)

    def assert_same(self, scene, calibration):
        """Poses of currents that the scene gives are those of the command, and so is what they are uncertain by."""
        draw = random.Random(SEED)
        poses = "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n" + "".join(
            f"{row}," + ",".join(str(draw.uniform(-size, size)) for size in (2, 2, 2, 0.1, 0.1, 0.1)) + "\n"
            for row in range(ROWS)
        )
        option = () if calibration == "-" else ("--calibration", calibration)
        currents = self.slitpose("model", scene, "--poses", "-", *option, input=poses)
        names = [f"i_x{electrode}_{cell}_a" for cell in range(6) for electrode in (1, 2)]
        # Of numbers with fewer digits, double.Parse of Mono takes one in a thousand for its neighbour.
        rows = [[f"{float(row[name]):.16e}" for name in names] for row in csv.DictReader(io.StringIO(currents))]
        table = "".join(f"{row},{','.join(numbers)}\n" for row, numbers in enumerate(rows))
        expected = self.slitpose("solve", scene, "--currents", "-", *option, input=f"id,{','.join(names)}\n{table}")
        lines = "".join(" ".join(numbers) + "\n" for numbers in rows)
        found = self.solve(scene, calibration, input=lines, check=True).stdout.splitlines()
        self.assertEqual(len(found), ROWS, f"seed {SEED}")
        for line, row in zip(found, csv.DictReader(io.StringIO(expected))):
            status, cells, *words = line.split()
            self.assertEqual((status, cells), (row["status"], row["cells_used"]), f"seed {SEED}")
            at = {word: place + 1 for place, word in enumerate(words) if word.isalnum() and not word.isdigit()}
            translation, variances = ([float(word) for word in words[at[name] :][:3]] for name in ("t", "variance"))
            self.assertEqual([1e3 * t for t in translation], [float(row[f"t{axis}_mm"]) for axis in "xyz"])
            sigmas = [1e3 * math.sqrt(variance) for variance in variances]
            self.assertEqual(sigmas, [float(row[f"sigma_t{axis}_mm"]) for axis in "xyz"])
            self.assertEqual(float(words[at["chi2"]]), float(row["chi2"]))
        tracked = self.solve(scene, calibration, "1000", input=lines.splitlines(keepends=True)[0] * 20, check=True)
        self.assertIn(" v ", tracked.stdout.splitlines()[-1])

    def test_csharp_finds_the_poses_of_the_command(self):
        self.assert_same("wide", "-")

    def test_csharp_finds_the_poses_of_a_calibrated_head(self):
        Path(self.folder.name, "head.toml").write_text(self.slitpose("scene", "show", "wide") + "[tolerance]\n")
        self.slitpose("bench", "head.toml", "--output", "mine", "--poses", "30", "--duration", "1s")
        self.slitpose("calibrate", "head.toml", "--known", "mine/known.csv", "--output", "calibration.toml")
        self.assert_same("head.toml", "calibration.toml")

    def test_csharp_is_told_what_is_wrong(self):
        missing = self.solve("missing.toml", "-")
        self.assertEqual(missing.returncode, 1)
        self.assertIn("missing.toml", missing.stderr)
        short = self.solve("wide", "-", input="1e-6 1e-6\n")
        self.assertEqual((short.returncode, short.stderr), (1, "2 currents_a for 6 cells; give 12\n"))


if __name__ == "__main__":
    unittest.main()
