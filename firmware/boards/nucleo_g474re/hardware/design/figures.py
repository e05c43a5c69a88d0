"""Figures of firmware/README.md beside the same figures simulated on the netlists.

Each expected value is read from that page, which calculates what is simulated here; both agree within 10 %, V_ref
within a code, and what is left of a step within 0.02 codes.
"""
from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import pi
from pathlib import Path

from . import benches, models
from .benches import EIGHTH_V, HIGHEST_V, LINE, LUMP_51, LUMP_91, NOMINAL_V, with_c_f
from .boards import ORDERABLE, WIDE

PAGE = Path(__file__).resolve().parents[4] / "README.md"
TOLERANCE = 0.10
EMITTER_S = 0.8e-6 / 2.2  # firmware/README.md, Bandwidth and settling
AMPERES_PER_CODE = benches.CODE_V / WIDE.r_f.ohms


@cache
def _page() -> str:
    return PAGE.read_text()


def _cell(heading: str, row: str, column: int) -> str:
    """Cell `column` of the first row that begins with `row` below `heading`."""
    below = _page().split(f"\n{heading}\n", 1)[1]
    found = re.search(rf"^\| {re.escape(row)} *\|.*$", below, re.M)
    if not found:
        raise LookupError(f"no row {row!r} below {heading!r}")
    return found[0].split("|")[column + 1].strip()


def _number(text: str, which: int = 0) -> float:
    return float(re.findall(r"\d[\d ]*\.?\d*", text.replace("\u00a0", " "))[which].replace(" ", ""))


def _prose(pattern: str) -> float:
    found = re.search(pattern, re.sub(r"\s+", " ", _page()))
    if not found:
        raise LookupError(f"{pattern!r} is not in firmware/README.md")
    return float(found[1])


@dataclass(frozen=True)
class Figure:
    group: str
    name: str
    unit: str
    expected: Callable[[], float]
    simulate: Callable[[], float]
    floor: float = 0.0  # differences below it do not count: the page's last digits
    tolerance: float = TOLERANCE

    def agrees(self, value: float, expected: float) -> bool:
        return abs(value - expected) <= max(self.tolerance * abs(expected), self.floor)


STABILITY, WORST = "### Stability", "### The worst parts"
SETTLING, NOISE = "### Bandwidth and settling", "### Noise of one conversion"
FRONT, DRIVE = "## Analogue front end", "## Emitter drive"


def _margins() -> list[Figure]:
    def margin(name: str, expected: Callable[[], float], *stage) -> Figure:
        return Figure("phase margin", name, "deg", expected, lambda: benches.stage_loop(*stage).margin_deg)

    figures = [
        margin(f"C_f {row}, C_in {name}", lambda row=row, i=i: _number(_cell(STABILITY, row, 1 + i)), with_c_f(WIDE, c_f), lump)
        for row, c_f in (("2.2 pF", 2.2e-12), ("3.3 pF", 3.3e-12))
        for i, (name, lump) in enumerate((("51 pF", LUMP_51), ("91 pF", LUMP_91)))
    ]
    figures += [
        margin("C_f 3.3 pF, C_in 91 pF, amplifier of 10 MHz",
               lambda: _number(_cell(STABILITY, "3.3 pF and an amplifier of 10 MHz", 2)), WIDE, LUMP_91, models.opamp(models.GBW_HZ / 2)),
        margin("100 kohm, 6.8 pF, C_in 91 pF", lambda: _number(_cell(FRONT, "100 kΩ, 6.8 pF", 2)), ORDERABLE, LUMP_91),
    ]
    figures += [
        margin(f"R_ie {row[:2]} kohm, C_f 3.3 pF, C_in 91 pF", lambda row=row: _number(_cell(WORST, row, 4)), WIDE, replace(LUMP_91, ohm=ohm))
        for ohm, row in ((30e3, "30 kΩ"), (80e3, "80 kΩ"))
    ]
    return figures


@cache
def _step(front_end, detector) -> benches.Step:
    return benches.settling(front_end, detector, EMITTER_S, benches.driver_waveform())


def _settling() -> list[Figure]:
    figures = [
        Figure("settling", "stage alone, ideal step, 3.3 pF: left after 13 us", "codes",
               lambda: _number(_cell(SETTLING, "3.3 pF", 4)), lambda: benches.settling(WIDE, LINE).left_codes, floor=0.02),
    ]
    slow, fast = 1.36e-6, 0.41e-6
    for text, c_f in (("2.2 pF", 2.2e-12), ("3.3 pF", 3.3e-12), ("4.3 pF", 4.3e-12)):
        fe = with_c_f(WIDE, c_f)
        for name, column, which, detector, take in (
            ("detector 0.41 us, C_in 91 pF: left after 13 us", 5, 0, replace(LUMP_91, lag_s=fast), "left"),
            ("detector 1.36 us, C_in 91 pF: left after 13 us", 6, 0, replace(LUMP_91, lag_s=slow), "left"),
            ("detector 0.41 us, C_in 51 pF: 0.3 codes after", 7, 0, replace(LUMP_51, lag_s=fast), "time"),
            ("detector 1.36 us, C_in 91 pF: 0.3 codes after", 7, 1, replace(LUMP_91, lag_s=slow), "time"),
        ):
            figures.append(Figure(
                "settling", f"chain, C_f {text}, {name}", "codes" if take == "left" else "us",
                lambda text=text, column=column, which=which: _number(_cell(SETTLING, text, column), which),
                lambda fe=fe, detector=detector, take=take: (
                    _step(fe, detector).left_codes if take == "left" else _step(fe, detector).settled_s * 1e6),
                floor=0.02 if take == "left" else 0.0))
    fe = ORDERABLE
    figures += [
        Figure("settling", "chain, 100 kohm, 6.8 pF, detector 0.41 us: left after 13 us", "codes",
               lambda: _number(_cell(FRONT, "100 kΩ, 6.8 pF", 3), 0), lambda: _step(fe, replace(LUMP_91, lag_s=fast)).left_codes, floor=0.02),
        Figure("settling", "chain, 100 kohm, 6.8 pF, detector 1.36 us: left after 13 us", "codes",
               lambda: _number(_cell(FRONT, "100 kΩ, 6.8 pF", 3), 1), lambda: _step(fe, replace(LUMP_91, lag_s=slow)).left_codes, floor=0.02),
    ]
    for ohm, row in ((30e3, "30 kΩ"), (80e3, "80 kΩ")):
        lag = ohm * 80e-12 / pi**2
        figures.append(Figure(
            "settling", f"chain, R_ie {row[:2]} kohm, C_in 91 pF: 0.3 codes after", "us", lambda row=row: _number(_cell(WORST, row, 3)),
            lambda ohm=ohm, lag=lag: _step(WIDE, replace(LUMP_91, ohm=ohm, lag_s=lag)).settled_s * 1e6))
    return figures


@cache
def _noise() -> dict[str, float]:
    return benches.noise(WIDE)


def _noises() -> list[Figure]:
    rows = {
        "R_f, Johnson": "R_f, Johnson", "interelectrode 50 kΩ, Johnson": "interelectrode, Johnson",
        "own amplifier, 7 nV/√Hz · noise gain": "own amplifier", "the other amplifier, through 50 kΩ": "the other amplifier",
        "shot noise at 5 µA": "shot noise",
    }
    return [
        Figure("noise", name.replace("interelectrode", "interelectrode 50 kohm"), "pA rms", lambda row=row: _number(_cell(NOISE, row, 2)),
               lambda name=name: _noise()[name] * 1e12)
        for row, name in rows.items()
    ]


@cache
def _edge(level_v: float) -> benches.Edge:
    return benches.driver_edge(level_v)


@cache
def _kick() -> tuple[float, float]:
    return benches.kickback()


@cache
def _ripple() -> tuple[float, float]:
    return benches.cathode_ripple(WIDE)


def _others() -> list[Figure]:
    drive = "emitter drive"
    return [
        Figure("reference", "V_ref", "V", lambda: _number(_cell(FRONT, "V_ref divider from V_DDA, 1.62 kΩ above 100 kΩ", 2), 1),
               lambda: benches.operating_point(WIDE)["vref"], tolerance=2.5e-4),  # a code
        Figure("cathode", "filter at 100 kHz, attenuation", "", lambda: _prose(r"attenuate by (\d+) at 100 kHz"), lambda: _ripple()[0]),
        Figure("cathode", "1 mV of ripple at 100 kHz, per electrode", "nA", lambda: _prose(r"behind the filter it is (0\.\d+) nA"),
               lambda: _ripple()[1] * 1e9, floor=0.005),
        Figure("converter's pin", "5 pF off by 3.25 V: first deviation", "codes", lambda: _prose(r"34 mV, (\d+) codes"), lambda: _kick()[0]),
        Figure("converter's pin", "the same: left after the sampling time", "codes", lambda: _prose(r"make that (0\.\d+) in the first conversion"),
               lambda: _kick()[1]),
        Figure("converter's pin", "current of the clamp in a fault", "mA", lambda: _prose(r"220 Ω = (\d\.\d) mA"), lambda: benches.clamp_current() * 1e3),
        Figure(drive, "current, an eighth", "mA", lambda: _number(_cell(DRIVE, "an eighth (lowest of automatic exposure)", 4)),
               lambda: _edge(EIGHTH_V).current_a * 1e3),
        Figure(drive, "current, nominal", "mA", lambda: _number(_cell(DRIVE, "nominal (0x8000)", 4)), lambda: _edge(NOMINAL_V).current_a * 1e3),
        Figure(drive, "current, highest", "mA", lambda: _number(_cell(DRIVE, "highest the firmware drives (0xF000)", 4)),
               lambda: _edge(HIGHEST_V).current_a * 1e3),
        Figure(drive, "dead time, nominal", "us", lambda: _prose(r"so (0\.\d) µs dead time"), lambda: _edge(NOMINAL_V).dead_s * 1e6, floor=0.02),
        Figure(drive, "dead time, an eighth", "us", lambda: _prose(r"and (\d\.\d) to 1\.5 µs at an eighth"), lambda: _edge(EIGHTH_V).dead_s * 1e6),
        Figure(drive, "time constant, nominal", "us", lambda: _prose(r"0\.33 S: 2\.5 MHz, (0\.\d+) µs"), lambda: _edge(NOMINAL_V).time_constant_s * 1e6),
    ]


def figures() -> list[Figure]:
    return [*_others(), *_margins(), *_noises(), *_settling()]


@dataclass(frozen=True)
class Unlisted:
    """Simulated figures that firmware/README.md does not have."""

    name: str
    unit: str
    simulate: Callable[[], float]


def unlisted() -> list[Unlisted]:
    return [
        Unlisted("detector as a line, spot in the middle, 324 kohm: 0.3 codes after", "us", lambda: _step(WIDE, LINE).settled_s * 1e6),
        Unlisted("the same, spot at a tenth of the length from the other electrode", "us", lambda: _step(WIDE, replace(LINE, position=0.9)).settled_s * 1e6),
        Unlisted("detector as a line, spot in the middle, 100 kohm: 0.3 codes after", "us", lambda: _step(ORDERABLE, LINE).settled_s * 1e6),
        Unlisted("phase margin, detector as a line, 324 kohm, 3.3 pF", "deg", lambda: benches.stage_loop(WIDE, LINE).margin_deg),
        Unlisted("phase margin, detector as a line, 100 kohm, 6.8 pF", "deg", lambda: benches.stage_loop(ORDERABLE, LINE).margin_deg),
        Unlisted("phase margin of an emitter's sink, nominal", "deg", lambda: benches.driver_loop().margin_deg),
        Unlisted("the same, transistor of 1 S", "deg", lambda: benches.driver_loop(stiff=True).margin_deg),
        Unlisted("overshoot of the current, nominal", "%", lambda: _edge(NOMINAL_V).overshoot * 100),
        Unlisted("emitter within 0.1 %, nominal, after", "us", lambda: _edge(NOMINAL_V).within_s * 1e6),
        Unlisted("emitter within 0.1 %, an eighth, after", "us", lambda: _edge(EIGHTH_V).within_s * 1e6),
        Unlisted("dead time, an eighth, threshold 1.4 V", "us", lambda: benches.driver_edge(EIGHTH_V, threshold_v=1.4).dead_s * 1e6),
        Unlisted("emitter dark (0.1 %) after its gate, nominal", "us", lambda: _edge(NOMINAL_V).off_s * 1e6),
        Unlisted("emitter dark (0.1 %) after its gate, an eighth", "us", lambda: _edge(EIGHTH_V).off_s * 1e6),
        Unlisted("left after the sampling time, 100 kohm and 6.8 pF", "codes", lambda: benches.kickback(ORDERABLE)[1]),
        Unlisted("full-scale step of cell 0 in dark cell 1, by the common reference", "codes", lambda: benches.crosstalk(WIDE)),
    ]


def shown(value: float) -> str:
    return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.0e}"


def table() -> str:
    lines = ["| | figure | firmware/README.md | simulated |", "|---|---|---|---|"]
    for figure in figures():
        expected, value = figure.expected(), figure.simulate()
        cells = (figure.group, figure.name, f"{expected:g} {figure.unit}".strip(), f"{shown(value)} {figure.unit}".strip())
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "| not on that page | simulated |", "|---|---|"]
    lines += [f"| {row.name} | {shown(row.simulate())} {row.unit} |" for row in unlisted()]
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
