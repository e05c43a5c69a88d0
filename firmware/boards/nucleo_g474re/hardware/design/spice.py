"""SPICE decks from the netlists of the boards, and ngspice as their simulator.

`Deck` translates parts one by one and never names a connection of its own: nodes are the nets of `boards`. A bench adds
sources and loads only. The detector's board of cell k has its nets under `dk_`, joined to the carrier's by the cable.
"""
from __future__ import annotations

import os
import re
import subprocess
import tempfile
from pathlib import Path

from . import boards, models
from .circuit import Circuit, Part

# Wire of the cable, 0.3 m of AWG 28: 0.07 ohm, and 60 pF/m to its neighbours (assumed, not measured).
CABLE_OHM, CABLE_F = 0.07, 18e-12
# Track and input protection at an anode (firmware/README.md, Stability: lines 2 pF).
ANODE_F = 2e-12
CELSIUS = 26.85  # 300 K, as in firmware/analogue
TIMEOUT_S = 20


def node(net: str, prefix: str = "") -> str:
    if net == "GND":
        return "0"
    return prefix + re.sub(r"[^a-z0-9_]", lambda match: {"+": "p", "-": "m"}.get(match[0], "_"), net.lower())


class Deck:
    def __init__(self, title: str, opamp: str | None = None, nmos: str | None = None):
        self.title = title
        self.lines: list[str] = [opamp or models.opamp(), nmos or models.nmos(), models.COMMON]
        self.opened: set[str] = set()

    def add(self, text: str) -> None:
        self.lines.append(text)

    def parts(self, parts: list[Part], prefix: str = "", open_loop: str = "") -> None:
        """Elements of `parts`. Of the amplifier half named `open_loop`, as `U1A`, the gain stage's inverting input is the
        node `probe`."""
        for part in parts:
            self.add("\n".join(self._elements(part, prefix, open_loop)))

    def _elements(self, part: Part, prefix: str, open_loop: str) -> list[str]:
        name, kind = f"{prefix}{part.reference}".lower(), part.kind

        def at(pin: str) -> str:
            return node(part.net(pin), prefix)

        match kind.spice:
            case "r":
                return [f"R{name} {at('1')} {at('2')} {kind.ohms:.8g}"]
            case "c":
                return [f"C{name} {at('1')} {at('2')} {kind.farads:.8g}"]
            case "opa2320":
                return [
                    f"X{name}{half.lower()} {at(half + '+')} {at(half + '-')} {at('V+')} {at('V-')} {at(half + 'OUT')} "
                    f"{'probe' if open_loop == part.reference + half else at(half + '-')} opa2320"
                    for half in "AB"
                ]
            case "spdt":
                return [f"X{name} {at('B1')} {at('B2')} {at('A')} {at('S')} {at('VCC')} {at('GND')} spdt"]
            case "nmos":
                return [f"X{name} {at('D')} {at('G')} {at('S')} ntr4003n"]
            case "bat54s":
                return [f"D{name}a {at('A')} {at('COM')} schottky", f"D{name}b {at('COM')} {at('K')} schottky"]
            case "esd2":
                return [f"C{name}_{io} {at(io)} 0 3.5p" for io in ("IO1", "IO2")]
            case "jumper12":
                return [f"R{name} {at('A')} {at('C')} 1m"]
            case _:
                return []

    def detector_board(self, cell: int, board: Circuit, detector: str, open_loop: str = "") -> None:
        """Board of `cell` at its connector of the carrier; `detector` is the text of a detector model, with `{p}` for the
        prefix of its nets."""
        prefix = f"d{cell}_"
        self.parts(list(board.parts.values()), prefix, open_loop)
        self.add(detector.replace("{p}", prefix))
        for anode in ("anode1", "anode2"):
            self.add(f"C{prefix}{anode} {prefix}{anode} 0 {ANODE_F:.8g}")
        at_carrier = boards.carrier().parts[f"J{100 * (cell + 1)}"]
        for contact, net in board.parts["J1"].nets.items():
            there, here = node(at_carrier.nets[contact]), node(net, prefix)
            if here != "0":
                self.add(f"Rw{prefix}{contact} {here} {there} {CABLE_OHM}\nCw{prefix}{contact} {there} 0 {CABLE_F:.8g}")

    def run(self, control: str, columns: list[str]) -> list[list[float]]:
        """Rows of `columns` of the last analysis of `control`, the scale first; complex columns are two numbers."""
        with tempfile.TemporaryDirectory() as folder:
            data = Path(folder, "data.txt")
            text = self._simulate(folder, f"{control}\nwrdata {data} {' '.join(columns)}")
            if not data.exists():
                raise SpiceError(f"{self.title}:\n{text[-3000:]}")
            return [[float(value) for value in line.split()] for line in data.read_text().splitlines() if line.strip()]

    def values(self, control: str) -> dict[str, float]:
        """All scalars that the last analysis of `control` leaves, by name."""
        with tempfile.TemporaryDirectory() as folder:
            text = self._simulate(folder, f"{control}\nprint all")
        return {name: float(value) for name, value in re.findall(r"^(\S+) = (\S+)$", text, re.M)}

    def _simulate(self, folder: str, control: str) -> str:
        elements = "\n".join(self.lines)
        deck = (
            f"* {self.title}\n{elements}\n.options temp={CELSIUS} tnom={CELSIUS} reltol=1e-6 abstol=1e-14 vntol=1e-9 "
            f"chgtol=1e-18 method=gear\n.control\nset wr_singlescale\nset numdgt=14\n{control}\nquit\n.endc\n.end\n"
        )
        keep = os.environ.get("SLITPOSE_DECKS")
        for path in [Path(folder, "deck.cir")] + ([Path(keep, re.sub(r"\W+", "_", self.title) + ".cir")] if keep else []):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(deck)
        done = subprocess.run(
            ["ngspice", "-b", str(Path(folder, "deck.cir"))], capture_output=True, text=True, timeout=TIMEOUT_S
        )
        return done.stdout + done.stderr


class SpiceError(RuntimeError):
    """ngspice left no result; the end of its output."""
