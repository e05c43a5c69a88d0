"""How `tests/run` counts what unittest prints: by running unittest on suites that pass, fail, or never begin."""

import os
import subprocess
import sys
import tempfile
import unittest

COUNTS = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "counts")

SUITES = {
    "def test_a(self): pass\n    def test_b(self): pass": (2, 0),
    "def test_a(self): self.fail()\n    def test_b(self): pass": (1, 1),
    "def test_a(self): raise OSError\n    def test_b(self): self.fail()": (0, 2),
    "def setUpClass(cls): raise OSError\n    setUpClass = classmethod(setUpClass)\n    def test_a(self): pass": (0, 1),
    "def test_a(self): self.skipTest('x')\n    def test_b(self): pass": (1, 0),
    "@unittest.expectedFailure\n    def test_a(self): self.fail()\n    def test_b(self): self.fail()": (0, 1),
    "@unittest.expectedFailure\n    def test_a(self): pass\n    def test_b(self): pass": (1, 1),
    "pass": (0, 1),
}


class Counts(unittest.TestCase):
    def test_each_kind_of_end_is_counted(self):
        for body, expected in SUITES.items():
            with self.subTest(body=body), tempfile.TemporaryDirectory() as folder:
                with open(os.path.join(folder, "suite.py"), "w") as suite:
                    suite.write(f"import unittest\nclass Suite(unittest.TestCase):\n    {body}\n")
                log = os.path.join(folder, "log")
                with open(log, "wb") as output:
                    subprocess.run([sys.executable, "-m", "unittest", "suite"], cwd=folder, stdout=output, stderr=output)
                script = f'set -euo pipefail; log="{log}"; source "{COUNTS}"; count_unittest'
                printed = subprocess.run(["bash", "-c", script], check=True, stdout=subprocess.PIPE, text=True).stdout
                self.assertEqual(tuple(map(int, printed.split())), expected)


if __name__ == "__main__":
    unittest.main()
