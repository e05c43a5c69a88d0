"""The library of the solver from C#: see `run`."""

import csv
import io
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
        return subprocess.run(["mono", self.program, *arguments], env=environment, capture_output=True, text=True, **options)

    def test_csharp_finds_the_poses_of_the_command(self):
        draw = random.Random(SEED)
        poses = "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n" + "".join(
            f"{row}," + ",".join(str(draw.uniform(-size, size)) for size in (2, 2, 2, 0.1, 0.1, 0.1)) + "\n"
            for row in range(ROWS)
        )
        currents = output_of(os.environ["SLITPOSE"], "model", "wide", "--poses", "-", input=poses)
        expected = output_of(os.environ["SLITPOSE"], "solve", "wide", "--currents", "-", input=currents)
        names = [f"i_x{electrode}_{cell}_a" for cell in range(6) for electrode in (1, 2)]
        lines = "".join(" ".join(row[name] for name in names) + "\n" for row in csv.DictReader(io.StringIO(currents)))
        found = self.solve("wide", "-", input=lines, check=True).stdout.splitlines()
        self.assertEqual(len(found), ROWS, f"seed {SEED}")
        for line, row in zip(found, csv.DictReader(io.StringIO(expected))):
            status, cells, _, *words = line.split()
            self.assertEqual((status, cells), (row["status"], row["cells_used"]), f"seed {SEED}")
            self.assertEqual([1e3 * float(word) for word in words[:3]], [float(row[f"t{axis}_mm"]) for axis in "xyz"])
            self.assertEqual(float(words[words.index("chi2") + 1]), float(row["chi2"]))
        tracked = self.solve("wide", "-", "1000", input=lines.splitlines(keepends=True)[0] * 20, check=True)
        self.assertIn(" v ", tracked.stdout.splitlines()[-1])

    def test_csharp_is_told_what_is_wrong(self):
        missing = self.solve("missing.toml", "-")
        self.assertEqual(missing.returncode, 1)
        self.assertIn("missing.toml", missing.stderr)
        short = self.solve("wide", "-", input="1e-6 1e-6\n")
        self.assertEqual((short.returncode, short.stderr), (1, "2 currents_a for 6 cells; give 12\n"))


if __name__ == "__main__":
    unittest.main()
