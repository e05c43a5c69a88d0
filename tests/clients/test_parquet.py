"""Poses as Apache Arrow reads them from Parquet: see `run`."""

import csv
import json
import math
import os
import subprocess
import tempfile
import unittest

import pyarrow
from pyarrow import parquet

OF_CSV = {"seq": pyarrow.int64(), "tx_mm": pyarrow.float64(), "status": pyarrow.string(), "simulated": pyarrow.bool_()}

SPEEDS = ("vx_m_per_s", "vy_m_per_s", "vz_m_per_s", "wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s")


def text(value):
    """As CSV has it; the numbers of both read back as the same bits."""
    return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


class Parquet(unittest.TestCase):
    def test_the_columns_of_csv_and_more(self):
        with tempfile.TemporaryDirectory() as folder:
            def name(file):
                return os.path.join(folder, file)

            def slitpose(*arguments):
                subprocess.run([os.environ["SLITPOSE"], *arguments], check=True)

            # The tool goes out of sight, 100 mm to the side and back. 80,000 scans are more than one group of rows.
            with open(name("away.csv"), "w", encoding="utf-8") as file:
                print("time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad", file=file)
                for tenth in range(202):
                    print(f"{tenth / 10},{50 - 50 * math.cos(math.pi * tenth / 25)},0,0,0,0,0", file=file)
            run = ("--config", "none", "--device", "sim", "--speed", "max", "--duration", "20s", "--format", "none")
            slitpose("run", *run, "--trajectory", name("away.csv"), "--record", name("capture.mcap"))
            for file in ("poses.csv", "poses.ndjson", "poses.parquet"):
                slitpose("export", name("capture.mcap"), "--filter", "5ms", "--output", name(file))
            with open(name("poses.csv"), encoding="utf-8", newline="") as file:
                rows = list(csv.DictReader(file))
            with open(name("poses.ndjson"), encoding="utf-8") as file:
                lines = [json.loads(line) for line, _ in zip(file, range(4000))]
            table = parquet.read_table(name("poses.parquet"))
        self.assertEqual(len(rows), 80_000)
        self.assertEqual(table.num_rows, len(rows))
        for column, kind in OF_CSV.items():
            self.assertEqual(table.schema.field(column).type, kind, column)
        words = set(table["status"].to_pylist())
        print(f"{table.num_rows} rows, {table.num_columns} columns, statuses {words}, read by pyarrow {pyarrow.__version__}")
        self.assertGreater(len(words), 1)
        for column in rows[0]:
            found = table[column].to_pylist()
            if table.schema.field(column).type == pyarrow.float64():
                same = [(row[column] == "") if value is None else float(row[column]) == value for row, value in zip(rows, found)]
            else:
                same = [row[column] == text(value) for row, value in zip(rows, found)]
            self.assertTrue(all(same), column)
        # As NDJSON has them.
        for prefix, values in {
            "": lambda line: line["twist"] and [*line["twist"]["linear_m_per_s"], *line["twist"]["angular_rad_per_s"]],
            "sigma_": lambda line: line["twist"] and line["twist"]["sigma"],
        }.items():
            for axis, name in enumerate(SPEEDS):
                found = table[prefix + name].slice(0, len(lines)).to_pylist()
                self.assertEqual(found, [(values(line) or [None] * 6)[axis] for line in lines], prefix + name)
        for axis, name in enumerate(("tx_mm", "ty_mm", "tz_mm")):
            columns = [table[f"{prefix}{name}"].slice(0, len(lines)).to_pylist() for prefix in ("filtered_", "filtered_sigma_", "truth_")]
            for line, filtered, sigma, true in zip(lines, *columns):
                self.assertEqual(true, line["truth"]["translation_m"][axis] * 1e3)
                if (pose := line.get("filtered")) is None:
                    self.assertIsNone(filtered)
                    continue
                self.assertEqual(filtered, pose["translation_m"][axis] * 1e3)
                self.assertAlmostEqual(sigma, math.sqrt(pose["covariance"][7 * axis]) * 1e3, delta=1e-12 * sigma)


if __name__ == "__main__":
    unittest.main()
