"""The reference tables are what the programs beside them compute."""

import pathlib
import subprocess
import sys
import unittest

DATA = pathlib.Path(__file__).resolve().parent.parent / "data"


class References(unittest.TestCase):
    def check(self, program, *options):
        done = subprocess.run([sys.executable, DATA / program, "--check", *options], stderr=subprocess.PIPE, text=True)
        self.assertEqual((done.returncode, done.stderr), (0, ""))

    def test_multi_precision_arithmetic_gives_the_reference_tables(self):
        self.check("reference/generate.py")

    def test_adaptive_rules_give_the_table_of_profiles(self):
        # All rows take minutes: `profiles.py --check` compares them.
        self.check("profiles/profiles.py", "--every", "8")


if __name__ == "__main__":
    unittest.main()
