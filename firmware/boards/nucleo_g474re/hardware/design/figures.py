"""Figures of firmware/README.md beside the same figures simulated on the netlists.

Each expected value is read from that page. A figure agrees within 10 %; one that does not has its simulated value here
(`found`) with the reason, and its row of the page is to be mended. A simulation that leaves both by more than 10 % fails.
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
    found: float | None = None
    reason: str = ""
    floor: float = 0.0  # differences below it do not count: the page's last digit

    def agrees(self, value: float, with_value: float) -> bool:
        return abs(value - with_value) <= max(TOLERANCE * abs(with_value), self.floor)


ONE_POLE = models.opamp(ideal=True)
ONE_POLE_10 = models.opamp(models.GBW_HZ / 2, ideal=True)
STABILITY, WORST = "### Stability", "### The worst parts"
SETTLING, NOISE = "### Bandwidth and settling", "### Noise of one conversion"
FRONT, DRIVE = "## Analogue front end", "## Emitter drive"
POLES = "90 ohm of the amplifier ahead of 220 ohm and 470 pF, which the page leaves out"
CASCADE = "pole of the stage and of the amplifier in cascade are slower than their closed loop"


def _margins() -> list[Figure]:
    rows = [
        # row of the page, C_f, amplifier of one pole, found with the full amplifier at 51 and 91 pF
        ("2.2 pF", 2.2e-12, ONE_POLE, (69.1, 62.7)), ("3.3 pF", 3.3e-12, ONE_POLE, (74.5, 71.6)),
    ]
    figures = []
    for row, c_f, simple, found in rows:
        for i, (name, lump) in enumerate((("51 pF", LUMP_51), ("91 pF", LUMP_91))):
            expected = lambda row=row, i=i: _number(_cell(STABILITY, row, 1 + i))  # noqa: E731
            fe = with_c_f(WIDE, c_f)
            figures += [
                Figure("phase margin", f"C_f {row}, C_in {name}, amplifier of one pole", "deg", expected,
                       lambda fe=fe, lump=lump, simple=simple: benches.stage_loop(fe, lump, simple).margin_deg, floor=1),
                Figure("phase margin", f"C_f {row}, C_in {name}", "deg", expected,
                       lambda fe=fe, lump=lump: benches.stage_loop(fe, lump).margin_deg, found[i], POLES, floor=1),
            ]
    figures += [
        Figure("phase margin", "C_f 3.3 pF, C_in 91 pF, one pole of 10 MHz", "deg",
               lambda: _number(_cell(STABILITY, "3.3 pF and an amplifier of 10 MHz", 2)),
               lambda: benches.stage_loop(WIDE, LUMP_91, ONE_POLE_10).margin_deg, floor=1),
        Figure("phase margin", "100 kohm, 6.8 pF, C_in 91 pF, amplifier of one pole", "deg",
               lambda: _number(_cell(FRONT, "100 kΩ, 6.8 pF", 2)),
               lambda: benches.stage_loop(ORDERABLE, LUMP_91, ONE_POLE).margin_deg, floor=1),
        Figure("phase margin", "100 kohm, 6.8 pF, C_in 91 pF", "deg", lambda: _number(_cell(FRONT, "100 kΩ, 6.8 pF", 2)),
               lambda: benches.stage_loop(ORDERABLE, LUMP_91).margin_deg, 69.7, POLES, floor=1),
    ]
    for ohm, row in ((30e3, "30 kΩ"), (80e3, "80 kΩ")):
        figures.append(
            Figure("phase margin", f"R_ie {row}, C_f 3.3 pF, C_in 91 pF, one pole".replace("Ω", "ohm"), "deg",
                   lambda row=row: _number(_cell(WORST, row, 4)),
                   lambda ohm=ohm: benches.stage_loop(WIDE, replace(LUMP_91, ohm=ohm), ONE_POLE).margin_deg, floor=1))
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
    # C_f, found: left with 0.41 us, left with 1.36 us, first and last time to 0.3 codes
    for text, c_f, found in (
        ("2.2 pF", 2.2e-12, (None, 0.92, 7.29, None)), ("3.3 pF", 3.3e-12, (0.022, 1.73, None, None)), ("4.3 pF", 4.3e-12, (0.48, 4.41, None, None)),
    ):
        fe = with_c_f(WIDE, c_f)
        for i, (name, column, which, detector, take) in enumerate((
            ("detector 0.41 us, C_in 91 pF: left after 13 us", 5, 0, replace(LUMP_91, lag_s=fast), "left"),
            ("detector 1.36 us, C_in 91 pF: left after 13 us", 6, 0, replace(LUMP_91, lag_s=slow), "left"),
            ("detector 0.41 us, C_in 51 pF: 0.3 codes after", 7, 0, replace(LUMP_51, lag_s=fast), "time"),
            ("detector 1.36 us, C_in 91 pF: 0.3 codes after", 7, 1, replace(LUMP_91, lag_s=slow), "time"),
        )):
            figures.append(Figure(
                "settling", f"chain, C_f {text}, {name}", "codes" if take == "left" else "us",
                lambda text=text, column=column, which=which: _number(_cell(SETTLING, text, column), which),
                lambda fe=fe, detector=detector, take=take: (
                    _step(fe, detector).left_codes if take == "left" else _step(fe, detector).settled_s * 1e6),
                found[i], CASCADE if found[i] is not None else "", floor=0.02 if take == "left" else 0.0))
    fe = ORDERABLE
    figures += [
        Figure("settling", "chain, 100 kohm, 6.8 pF, detector 0.41 us: left after 13 us", "codes",
               lambda: _number(_cell(FRONT, "100 kΩ, 6.8 pF", 3), 0), lambda: _step(fe, replace(LUMP_91, lag_s=fast)).left_codes, floor=0.02),
        Figure("settling", "chain, 100 kohm, 6.8 pF, detector 1.36 us: left after 13 us", "codes",
               lambda: _number(_cell(FRONT, "100 kΩ, 6.8 pF", 3), 1), lambda: _step(fe, replace(LUMP_91, lag_s=slow)).left_codes,
               0.98, CASCADE, floor=0.02),
    ]
    for ohm, row, found in ((30e3, "30 kΩ", None), (80e3, "80 kΩ", 10.4)):
        lag = ohm * 80e-12 / pi**2
        figures.append(Figure(
            "settling", f"chain, R_ie {row[:2]} kohm, C_in 91 pF: 0.3 codes after", "us", lambda row=row: _number(_cell(WORST, row, 3)),
            lambda ohm=ohm, lag=lag: _step(WIDE, replace(LUMP_91, ohm=ohm, lag_s=lag)).settled_s * 1e6,
            found, CASCADE if found else ""))
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
               lambda: benches.operating_point(WIDE)["vref"], floor=0.0),
        Figure("cathode", "filter at 100 kHz, attenuation", "", lambda: _prose(r"attenuate by (\d+) at 100 kHz"), lambda: _ripple()[0]),
        Figure("cathode", "1 mV of ripple at 100 kHz, per electrode", "nA", lambda: _prose(r"behind the filter it is (0\.\d+) nA"),
               lambda: _ripple()[1] * 1e9, 0.033, "the stage's own bandwidth", floor=0.002),
        Figure("converter's pin", "5 pF off by 3.25 V: first deviation", "codes", lambda: _prose(r"34 mV, (\d+) codes"), lambda: _kick()[0]),
        Figure("converter's pin", "the same: left after the sampling time", "codes", lambda: _prose(r"sampling time: (0\.\d+) codes"),
               lambda: _kick()[1], 0.33, "90 ohm of the amplifier are in series with the 220 ohm above its crossover; 12 pF of the clamp"),
        Figure("converter's pin", "current of the clamp in a fault", "mA", lambda: _prose(r"220 Ω = (\d\.\d) mA"), lambda: benches.clamp_current() * 1e3),
        Figure(drive, "current, an eighth", "mA", lambda: _number(_cell(DRIVE, "an eighth (lowest of automatic exposure)", 4)),
               lambda: _edge(EIGHTH_V).current_a * 1e3),
        Figure(drive, "current, nominal", "mA", lambda: _number(_cell(DRIVE, "nominal (0x8000)", 4)), lambda: _edge(NOMINAL_V).current_a * 1e3),
        Figure(drive, "current, highest", "mA", lambda: _number(_cell(DRIVE, "highest the firmware drives (0xF000)", 4)),
               lambda: _edge(HIGHEST_V).current_a * 1e3),
        Figure(drive, "dead time, nominal", "us", lambda: _prose(r"so (0\.\d) µs dead time"), lambda: _edge(NOMINAL_V).dead_s * 1e6, floor=0.02),
        Figure(drive, "dead time, an eighth", "us", lambda: _prose(r"and (\d\.\d) µs at an eighth"), lambda: _edge(EIGHTH_V).dead_s * 1e6,
               1.20, "the gate rises by 1.4 V, not 2 V, for a threshold of 1.1 V; with 1.4 V, the most, below"),
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
    lines = ["| | figure | firmware/README.md | simulated | |", "|---|---|---|---|---|"]
    for figure in figures():
        expected, value = figure.expected(), figure.simulate()
        verdict = "" if figure.agrees(value, expected) else f"to be mended: {figure.reason}"
        cells = (figure.group, figure.name, f"{expected:g} {figure.unit}".strip(), f"{shown(value)} {figure.unit}".strip(), verdict)
        lines.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
    lines += ["", "| not on that page | simulated |", "|---|---|"]
    lines += [f"| {row.name} | {shown(row.simulate())} {row.unit} |" for row in unlisted()]
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
