"""Netlists against the table of contacts and the page of parts; files against the design. Needs no tool."""
import csv
import re
import unittest
from collections import Counter

from design import __main__ as files
from design import bill, boards, figures, pages
from design.circuit import NO_CONNECTION, CircuitError

FIRMWARE = figures.PAGE.parent


def wiring():
    with (FIRMWARE / "wiring.csv").open(newline="") as file:
        return list(csv.DictReader(file))


class Contacts(unittest.TestCase):
    def setUp(self):
        self.carrier = boards.carrier()
        self.of_contact = {
            f"{connector}-{number}": net for connector in ("CN7", "CN10") for number, net in self.carrier.parts[connector].nets.items()
        }

    def on_morpho(self, row):
        return [contact for contact in row["contact"].split() if contact in self.of_contact]

    def test_each_signal_of_the_table_is_at_its_contact(self):
        signals = [row for row in wiring() if row["kind"] == "signal"]
        self.assertGreater(len(signals), 25)
        for row in signals:
            with self.subTest(row["name"]):
                if row["name"] in boards.OPEN_SIGNALS:
                    expected = NO_CONNECTION
                else:
                    expected = boards.NET_OF_SIGNAL[row["name"]]
                    self.assertEqual(len(self.on_morpho(row)), 1)
                for contact in self.on_morpho(row):
                    self.assertEqual(self.of_contact[contact], expected, contact)

    def test_each_rail_of_the_table_is_at_its_contacts(self):
        for row in wiring():
            if row["kind"] == "rail" and self.on_morpho(row):
                for contact in self.on_morpho(row):
                    self.assertEqual(self.of_contact[contact], boards.NET_OF_RAIL[row["name"]], f"{row['name']} {contact}")

    def test_contacts_outside_the_table_are_open(self):
        named = {contact for row in wiring() if row["kind"] in ("signal", "rail") for contact in row["contact"].split()}
        for contact, net in self.of_contact.items():
            if contact not in named:
                self.assertEqual(net, NO_CONNECTION, contact)

    def test_contacts_that_may_carry_pc4_and_pc5_are_open(self):
        shared = [row for row in wiring() if row["kind"] == "bridge" and row["name"] in ("SB13", "SB19")]
        contacts = {contact for row in shared for contact in self.on_morpho(row)}
        self.assertEqual(contacts, {"CN10-35", "CN10-37"})
        for contact in contacts:
            self.assertEqual(self.of_contact[contact], NO_CONNECTION)

    def test_a_moved_contact_is_found(self):
        self.of_contact["CN7-28"], self.of_contact["CN7-30"] = self.of_contact["CN7-30"], self.of_contact["CN7-28"]
        rows = {row["name"]: row for row in wiring()}
        row = rows["I_X1 of cell 0"]
        self.assertNotEqual(self.of_contact[self.on_morpho(row)[0]], boards.NET_OF_SIGNAL[row["name"]])


class Circuits(unittest.TestCase):
    def test_every_net_joins_two_pins_or_more(self):
        for circuit in bill.circuits():
            for net, pins in circuit.nets().items():
                self.assertGreaterEqual(len(pins), 2, f"{circuit.name}: {net}")

    def test_both_ends_of_the_detector_cable_agree(self):
        carrier, detector = boards.carrier(), boards.detector()
        for cell in boards.CELLS:
            there = carrier.parts[f"J{100 * (cell + 1)}"].nets
            for contact, net in detector.parts["J1"].nets.items():
                at_carrier = {"VREF": f"VREF_{cell}", "OUT1": f"OUT_1_{cell}", "OUT2": f"OUT_2_{cell}"}.get(net, net)
                self.assertEqual(there[contact], at_carrier)

    def test_an_unnamed_pin_is_rejected(self):
        with self.assertRaisesRegex(CircuitError, "no net for pins 2"):
            boards.carrier().add("R999", boards.c.resistor("1k"), "none", p1="GND")

    def test_drawings_join_what_the_circuits_join(self):
        # Drawing a board checks it: `drawing.check` raises.
        for draw in (pages.carrier_sheets, pages.detector_sheets, pages.emitter_sheets):
            draw()

    def test_counts_are_those_of_the_parts_table(self):
        """Parts of a head by value against the table Parts of firmware/README.md."""
        counts = Counter()
        for circuit in bill.circuits():
            for part in circuit.parts.values():
                if part.kind.on_bill:
                    counts[part.kind.key] += bill.BOARDS_PER_HEAD[circuit.name]
        section = figures._page().split("\n## Parts\n", 1)[1].split("\n## ", 1)[0]
        page = {row.split("|")[1].strip(): row.split("|")[3].strip() for row in section.splitlines() if row.startswith("| ")}
        for row, keys, extra in (
            ("detector", ["S3932"], 0), ("emitter", ["VSMY1850"], 0), ("amplifier", ["OPA2320"], 0),
            ("R_f", ["R 100k 0.1 %"], 1),  # 1 of the reference's divider
            ("C_f", ["C 6.8p C0G"], 0), ("series resistor", ["R 220 1 %"], 0), ("capacitor at the pin", ["C 470p C0G"], 0),
            ("clamp", ["BAT54S"], 1),  # 1 of the trigger input
            ("regulator", ["TPS7A4901"], 0), ("transistor", ["NTR4003N"], 0), ("sense resistor", ["R 3.3 1 % 0.25 W"], 0),
            ("analogue switch", ["SN74LVC1G3157"], 0), ("load switch", ["TPS22918"], 0),
        ):
            with self.subTest(row):
                self.assertEqual(sum(counts[key] for key in keys) - extra, int(re.match(r"\d+", page[row])[0]))


class Layout(unittest.TestCase):
    def test_pads_of_the_board_have_the_nets_of_the_circuit(self):
        text = (files.ROOT / "kicad" / "carrier" / "carrier.kicad_pcb").read_text()
        circuit, found = boards.carrier(), {}
        for footprint in text.split("\n\t(footprint ")[1:]:
            reference = re.search(r'\(property "Reference" "([^"]+)"', footprint)[1]
            self.assertNotIn(reference, found)
            found[reference] = footprint
        self.assertEqual({name for name in found if not name.startswith("H")}, set(circuit.parts))
        for reference, part in circuit.parts.items():
            self.assertTrue(found[reference].startswith(f'"{part.kind.footprint}"'), reference)
            pads = {}
            for pad in found[reference].split("\n\t\t(pad ")[1:]:
                pad = pad.split("\n\t\t)")[0]
                net = re.search(r'\(net \d+ "([^"]+)"\)', pad)
                pads.setdefault(pad.split('"')[1], set()).add(net[1] if net else NO_CONNECTION)
            for number, net in part.nets.items():
                self.assertEqual(pads[number], {net}, f"{reference} pad {number}")


class Files(unittest.TestCase):
    def test_committed_files_are_current(self):
        self.assertEqual(files.stale(), [], "run `hardware/run write`")

    def test_every_line_of_the_bill_is_complete(self):
        header, *rows = bill.rows()
        on_bill = set()
        for row in rows:
            line = dict(zip(header, row))
            for key in ("manufacturer", "number", "source", "verified"):
                self.assertTrue(line[key], f"{line['references'] or line['value']}: no {key}")
            if line["board"] != "head":
                self.assertTrue(line["footprint"], line["references"])
                on_bill |= {(line["board"], reference) for reference in line["references"].split()}
        for circuit in bill.circuits():
            for part in circuit.parts.values():
                self.assertEqual((circuit.name, part.reference) in on_bill, part.kind.on_bill, part.reference)
