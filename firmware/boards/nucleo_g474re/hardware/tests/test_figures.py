"""Simulated figures against firmware/README.md and against this folder's page. Needs ngspice."""
import re
import unittest

from design import figures, waveforms
from design.boards import ORDERABLE
from design.__main__ import ROOT


class Figures(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.simulated = {(figure.group, figure.name): (figure, figure.simulate()) for figure in figures.figures()}

    def test_each_figure_agrees_with_the_calculated_one(self):
        for (group, name), (figure, value) in self.simulated.items():
            with self.subTest(f"{group}: {name}"):
                expected = figure.expected()
                self.assertTrue(figure.agrees(value, expected), f"{value:.4g}, page {expected:.4g} {figure.unit}")

    def test_page_has_the_simulated_figures(self):
        rows = {tuple(cell.strip() for cell in line.split("|")[1:3]): line.split("|") for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("| ")}
        for key, (figure, value) in self.simulated.items():
            with self.subTest(key):
                written = float(re.match(r"[-+.e\d]+", rows[key][4].strip())[0])
                self.assertAlmostEqual(value, written, delta=0.01 * abs(written) + 1e-3, msg=figure.unit)

    def test_figures_that_firmware_lacks_are_on_the_page(self):
        text = (ROOT / "README.md").read_text()
        for row in figures.unlisted():
            with self.subTest(row.name):
                found = re.search(rf"^\| {re.escape(row.name)} \| (\S+)", text, re.M)
                self.assertIsNotNone(found)
                self.assertAlmostEqual(row.simulate(), float(found[1]), delta=0.05 * abs(float(found[1])) + 0.01)


class Waveforms(unittest.TestCase):
    def test_step_responses_rise_once_and_settle(self):
        rows = waveforms.response(ORDERABLE, 0.5)
        self.assertLess(max(map(abs, rows[0][1:])), 1e-9)
        for column in (1, 2):
            values = [row[column] for row in rows]
            self.assertLess(max(abs(value - 1) for row, value in zip(rows, values) if row[0] > 15e-6), 1e-4)
            self.assertGreater(min(after - before for before, after in zip(values, values[1:])), -1e-4)
        # Light in the middle: both electrodes alike.
        self.assertLess(max(abs(row[1] - row[2]) for row in rows), 1e-3)
