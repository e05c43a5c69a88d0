"""KiCad's own view of the files: rule check and netlist. Needs kicad-cli 9."""
import json
import os
import re
import subprocess
import tempfile
import unittest
from pathlib import Path

from design import bill
from design.__main__ import ROOT


def kicad(*arguments, folder):
    environment = {"KICAD9_FOOTPRINT_DIR": "/usr/share/kicad/footprints", **os.environ}
    return subprocess.run(["kicad-cli", *map(str, arguments)], cwd=folder, env=environment, capture_output=True, text=True)


class Schematics(unittest.TestCase):
    def test_electrical_rules_find_nothing(self):
        for circuit in bill.circuits():
            with self.subTest(circuit.name), tempfile.TemporaryDirectory() as folder:
                report = Path(folder, "erc.json")
                done = kicad("sch", "erc", "--severity-all", "--format", "json", "-o", report, f"{circuit.name}.kicad_sch",
                             folder=ROOT / "kicad" / circuit.name)
                self.assertTrue(report.exists(), done.stderr)
                found = [violation for sheet in json.loads(report.read_text())["sheets"] for violation in sheet["violations"]]
                self.assertEqual([violation["description"] for violation in found], [])

    def test_netlist_of_the_drawing_is_that_of_the_circuit(self):
        for circuit in bill.circuits():
            with self.subTest(circuit.name), tempfile.TemporaryDirectory() as folder:
                path = Path(folder, "netlist")
                done = kicad("sch", "export", "netlist", "-o", path, f"{circuit.name}.kicad_sch", folder=ROOT / "kicad" / circuit.name)
                self.assertTrue(path.exists(), done.stderr)
                nets = path.read_text().split("(nets", 1)[1].split("(net ")[1:]
                drawn = set()
                for net in nets:
                    pins = frozenset(re.findall(r'\(ref "([^"]+)"\)\s*\(pin "([^"]+)"\)', net))
                    if len(pins) > 1:
                        drawn.add(pins)
                self.assertEqual(drawn, {frozenset(pins) for pins in circuit.nets().values()})


BOARD = ROOT / "kicad" / "carrier" / "carrier.kicad_pcb"


class Layout(unittest.TestCase):
    def test_design_rules_find_nothing(self):
        with tempfile.TemporaryDirectory() as folder:
            report = Path(folder, "drc.json")
            done = kicad("pcb", "drc", "--severity-all", "--format", "json", "-o", report, BOARD.name, folder=BOARD.parent)
            self.assertTrue(report.exists(), done.stderr)
            found = json.loads(report.read_text())
            self.assertEqual([violation["description"] for violation in found["violations"]], [])
            self.assertEqual(found["unconnected_items"], [])
