"""Poses as Apache Arrow reads them from Parquet: see `run`."""

import csv
import math
import os
import subprocess
import tempfile
import unittest

import pyarrow
from pyarrow import parquet

OF_CSV = {"seq": pyarrow.int64(), "tx_mm": pyarrow.float64(), "status": pyarrow.string(), "simulated": pyarrow.bool_()}


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
            for file in ("poses.csv", "poses.parquet"):
                slitpose("export", name("capture.mcap"), "--filter", "5ms", "--output", name(file))
            with open(name("poses.csv"), encoding="utf-8", newline="") as file:
                rows = list(csv.DictReader(file))
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
        for axis in ("tx_mm", "ry_rad"):
            filtered, true = (table[f"{prefix}_{axis}"].drop_null() for prefix in ("filtered", "truth"))
            self.assertEqual(len(true), len(rows))
            self.assertGreater(len(filtered), 1000)
        # Velocities are those of the true pose: at most 63 mm/s where the tool is seen at all, with a noise of 3 mm/s.
        x, speeds = (table[column].to_pylist() for column in ("truth_tx_mm", "vx_m_per_s"))
        pairs = [((x[k + 8] - x[k - 8]) / 1000 * 250, speeds[k]) for k in range(8, len(x) - 8) if speeds[k] is not None]
        errors = sorted(abs(true - speed) for true, speed in pairs)
        self.assertGreater(max(true for true, _ in pairs), 0.02)
        self.assertLess(errors[len(errors) // 2], 0.005)


if __name__ == "__main__":
    unittest.main()
