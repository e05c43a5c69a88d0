"""What is measured on the netlists: each function builds a deck, runs ngspice and returns figures in SI units or codes.

Every part between source and load comes from `boards`; a bench adds ideal rails, the level of the DAC, the gate pin, light
and the converter's sampling capacitor only. A code is 3.3 V / 4096 at the converter's pin.
"""
from __future__ import annotations

from bisect import bisect_left
from cmath import phase
from dataclasses import dataclass, replace
from functools import cache
from math import degrees, log

from . import boards, models
from .boards import WIDE, FrontEnd
from .spice import CABLE_F, CABLE_OHM, Deck

CODE_V = 3.3 / 4096
FULL_SCALE_CODES = 4031
EDGE_S = 1e-6  # of the gate pin, from the start of a simulation
SETTLING_S = 13e-6
NOMINAL_V, EIGHTH_V, HIGHEST_V = 1.65, 0.206, 3.094  # level line (firmware/README.md, Emitter drive)
REFERENCE = ("JP2", "R5", "R6", "C10", "C11")
ANALOGUE_SUPPLY = ("R2", "C4", "C5")

RAILS = "Vavdd avdd 0 3.3\nV33 p3v3 0 3.3\nV5 p5v 0 5\nV9 p9v 0 9\nV5e p5ve 0 5"


@dataclass(frozen=True)
class Detector:
    """Model of the S3932 (KPSD1002E: 30, 50, 80 kohm, 80 pF). `lag_s` is a first-order lag of the light before it."""

    ohm: float = 50e3
    line: bool = True
    position: float = 0.5
    farad_1: float = 80e-12
    farad_2: float = 40e-12
    lag_s: float = 0.0

    def text(self, light: str = "light") -> str:
        if self.line:
            return models.detector_line(
                "{p}d1x", "{p}anode1", "{p}anode2", "{p}cathode", light, self.position, self.ohm, 80e-12
            )
        return models.detector_lump(
            "{p}d1x", "{p}anode1", "{p}anode2", "{p}cathode", light, self.ohm, self.farad_1, self.farad_2
        )

    @property
    def share_1(self) -> float:
        """Part of the current that leaves at anode 1."""
        return 1 - self.position if self.line else 1.0


# C_in 51 and 91 pF of firmware/README.md: 40 or 80 pF of the detector beside 9 pF of the amplifier and 2 pF of lines.
LUMP_51 = Detector(line=False, farad_1=40e-12)
LUMP_91 = Detector(line=False)
LINE = Detector()


def with_c_f(front_end: FrontEnd, farads: float) -> FrontEnd:
    return replace(front_end, c_f=replace(front_end.c_f, farads=max(farads, 1e-18)))


def front_end_deck(title: str, front_end: FrontEnd, detector: Detector, cell: int = 0, **deck: str) -> Deck:
    """Reference, supply filter, input channel and detector's board of one cell."""
    carrier = boards.carrier()
    bench = Deck(title, **{key: value for key, value in deck.items() if key in ("opamp", "nmos")})
    bench.add(RAILS)
    bench.parts([carrier.parts[reference] for reference in (*REFERENCE, *ANALOGUE_SUPPLY)])
    bench.parts(carrier.block(f"input {cell}"))
    bench.detector_board(cell, boards.detector(front_end), detector.text(), deck.get("open_loop", ""))
    return bench


def add_light(bench: Deck, detector: Detector, emitter_s: float, source: str) -> None:
    """Node `light` follows `source` (1 V is 1 A) with the lags of emitter and detector."""
    for i, lag in enumerate((emitter_s, detector.lag_s)):
        after = f"lag{i}"
        # Without noise: a lag of 1 ohm.
        bench.add(f"Elag{i} {after}s 0 {source} 0 1\nRlag{i} {after}s {after} 1\nClag{i} {after} 0 {max(lag, 1e-12):.6g}")
        source = after
    bench.add(f"Elight light 0 {source} 0 1")


# --- settling --------------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Step:
    left_codes: float
    settled_s: float
    overshoot_codes: float


def _step(rows: list[list[float]], column: int, from_s: float, scale: float) -> Step:
    times, values = [row[0] for row in rows], [row[column] for row in rows]
    end = values[-1]
    distance = [abs(value - end) * scale for value in values]

    def at(time: float) -> float:
        i = bisect_left(times, time)
        t0, t1 = times[i - 1], times[i]
        return distance[i - 1] + (distance[i] - distance[i - 1]) * (time - t0) / (t1 - t0)

    last = max(i for i, d in enumerate(distance) if d > 0.3)
    start = values[0]
    over = max(0.0, max((value - end) / (end - start) for value in values)) * FULL_SCALE_CODES
    return Step(at(from_s + SETTLING_S), times[last] - from_s, over)


def settling_rows(
    front_end: FrontEnd, detector: Detector, emitter_s: float = 0.0, edge: Waveform | None = None, both: bool = False
) -> list[list[float]]:
    """Time and voltage at the converter's pin of electrode 1 of cell 0, or of `both`, for a step of light to 0.8 of full scale
    of the brighter electrode. With `edge` the light follows that waveform of `driver_waveform`; without, it steps at once."""
    bench = front_end_deck("settling", front_end, detector)
    light_a = 0.8 * FULL_SCALE_CODES * CODE_V / front_end.r_f.ohms / max(detector.share_1, 1 - detector.share_1)
    if edge is None:
        bench.add(f"Vlit lit_a 0 pulse(0 {light_a:.8g} {EDGE_S} 1n 1n 1)")
    else:
        points = "\n+ ".join(f"{time:.10g} {light_a * share:.10g}" for time, share in edge)
        bench.add(f"Vlit lit_a 0 pwl(\n+ {points})")
    add_light(bench, detector, emitter_s, "lit_a")
    return bench.run(f"tran 10n {EDGE_S + 45e-6} 0 25n", ["v(adc_1_0)", "v(adc_2_0)"][: 1 + both])


def settling(front_end: FrontEnd, detector: Detector, emitter_s: float = 0.0, edge: Waveform | None = None) -> Step:
    """Settling at electrode 1, in codes if the brighter electrode steps by full scale."""
    return _step(settling_rows(front_end, detector, emitter_s, edge), 1, EDGE_S, 1 / CODE_V / 0.8)


# --- loop gain -------------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Loop:
    crossover_hz: float
    margin_deg: float


def _loop(rows: list[list[float]]) -> Loop:
    for row, after in zip(rows, rows[1:]):
        gain, later = (-complex(*r[1:3]) for r in (row, after))
        if abs(gain) >= 1 > abs(later):
            part = log(abs(gain)) / log(abs(gain) / abs(later))
            frequency = row[0] * (after[0] / row[0]) ** part
            return Loop(frequency, 180 + degrees(phase(gain * (later / gain) ** part)))
    raise ValueError("the loop gain never falls to 1")


PROBE = "Vprobe probe bias dc 0 ac 1\nEbias bias 0 slow 0 1\nRslow {inverting} slow 1e6\nCslow slow 0 1e3"


def stage_loop(front_end: FrontEnd, detector: Detector, opamp: str | None = None) -> Loop:
    """Loop gain of stage 1 of cell 0, opened between the inverting input and the gain stage, which loads nothing."""
    bench = front_end_deck("stage loop", front_end, detector, opamp=opamp, open_loop="U1A")
    bench.add(PROBE.format(inverting="d0_anode1") + "\nVlight light 0 0")
    return _loop(bench.run("ac dec 200 1e4 1e8", ["v(d0_anode1)"]))


def driver_loop(level_v: float = NOMINAL_V, stiff: bool = False) -> Loop:
    bench = Deck("driver loop", nmos=models.nmos(stiff))
    bench.add(RAILS)
    add_driver(bench, 0, level_v, gate="dc 3.3", open_loop="U700A")
    bench.add(PROBE.format(inverting="sum_0"))
    return _loop(bench.run("ac dec 200 1e4 1e9", ["v(sum_0)"]))


# --- noise -----------------------------------------------------------------------------------------------------------

def noise(front_end: FrontEnd, detector: Detector = LUMP_91, shot_a: float = 5e-6) -> dict[str, float]:
    """Noise of one conversion by source, 1 Hz to 100 MHz, referred to the photocurrent: amperes."""
    bench = front_end_deck("noise", front_end, detector)
    # A resistor whose Johnson noise current is the shot noise 2qI; its voltage steers the light.
    shot_ohm = 4 * models.BOLTZMANN * models.KELVIN / (2 * models.CHARGE * shot_a)
    bench.add(f"Vlight light light0 dc 0 ac 1\nElight light0 0 shot 0 {1 / shot_ohm:.8g}\nRshot shot 0 {shot_ohm:.8g}")
    names = {
        "R_f, Johnson": "rd0_r1",
        "interelectrode, Johnson": "rd0_d1x",
        "own amplifier": "r.xd0_u1a.rn",
        "the other amplifier": "r.xd0_u1b.rn",
        "shot noise": "rshot",
        "220 ohm": "rr101",
    }
    found = bench.values("noise v(adc_1_0) Vlight dec 200 1 1e8 1")
    return {
        label: found[name] / front_end.r_f.ohms
        for label, name in {**{label: f"onoise_total_{name}" for label, name in names.items()}, "sum": "onoise_total"}.items()
    }


# --- emitter drive ---------------------------------------------------------------------------------------------------

def add_driver(bench: Deck, emitter: int, level_v: float, gate: str | None = None, open_loop: str = "") -> None:
    """Both sinks of the pair of `emitter`, each with its emitter at the cable, and the level lines; the other one's gate
    pin is low. Current of `emitter`: that of the source `vlit_N`."""
    carrier = boards.carrier()
    bench.parts(carrier.block(f"pair {emitter % 3}"), open_loop=open_loop)
    bench.parts([carrier.parts[reference] for reference in ("R7", "R8", "R9", "R10")])
    if not any("Rr2 " in text for text in bench.lines):
        bench.parts([carrier.parts[reference] for reference in ANALOGUE_SUPPLY])
    bench.add(f"Vdaca dac_a 0 {level_v}\nVdacb dac_b 0 {level_v}")
    gate = gate or f"pulse(0 3.3 {EDGE_S} 5n 5n 1)"
    for n, source in ((emitter, gate), ((emitter + 3) % 6, "0")):
        bench.add(
            f"Vgate{n} gate_{n} 0 {source}\nVlit_{n} p5ve led_{n} 0\nRled_{n} led_{n} led_{n}x {2 * CABLE_OHM}\n"
            f"Dled_{n} led_{n}x drain_{n} emitter\nCled_{n} drain_{n} 0 {CABLE_F}"
        )


@dataclass(frozen=True)
class Edge:
    current_a: float
    dead_s: float  # to a tenth of the current
    time_constant_s: float  # from 63 % to 95 % of the step, by ln
    within_s: float  # to within 0.1 % for good
    overshoot: float
    off_s: float  # gate low to 0.1 % left


def _driver_rows(level_v: float, lit_s: float, stiff: bool, threshold_v: float = 1.1) -> list[list[float]]:
    bench = Deck("driver edge", nmos=models.nmos(stiff, threshold_v))
    bench.add(RAILS)
    add_driver(bench, 0, level_v, gate=f"pulse(0 3.3 {EDGE_S} 5n 5n {lit_s})")
    return bench.run(f"tran 2n {EDGE_S + lit_s + 8e-6} 0 4n", ["i(vlit_0)"])


Waveform = tuple[tuple[float, float], ...]


@cache
def driver_waveform(level_v: float = NOMINAL_V, stiff: bool = False) -> Waveform:
    """Current of emitter 0 after its gate pin's edge, as a part of its end, for `settling`."""
    rows = _driver_rows(level_v, 15e-6, stiff)
    times, end = [row[0] for row in rows], rows[bisect_left([row[0] for row in rows], EDGE_S + 14e-6)][1]
    # Evenly spaced: the simulator's own steps are too close around edges for a piecewise linear source.
    grid = [EDGE_S + 10e-9 * i for i in range(800)]
    return (0.0, 0.0), *((time, rows[bisect_left(times, time)][1] / end) for time in grid)


def driver_edge(level_v: float = NOMINAL_V, stiff: bool = False, threshold_v: float = 1.1, lit_s: float = 15e-6) -> Edge:
    rows = _driver_rows(level_v, lit_s, stiff, threshold_v)
    times, current = [row[0] for row in rows], [row[1] for row in rows]
    lit = [i for i, t in enumerate(times) if t < EDGE_S + lit_s]
    end = current[lit[-1]]

    def first(share: float) -> float:
        return next(times[i] for i in lit if times[i] > EDGE_S and current[i] >= share * end) - EDGE_S

    off = max(i for i, value in enumerate(current) if abs(value) > 1e-3 * end)
    settled = max(i for i in lit if abs(current[i] / end - 1) > 1e-3)
    return Edge(
        end, first(0.1), (first(0.95) - first(0.632)) / log(0.368 / 0.05), times[settled] - EDGE_S,
        max(current[i] for i in lit) / end - 1, times[off] - EDGE_S - lit_s,
    )


# --- converter's pin, supplies, faults -------------------------------------------------------------------------------

def kickback(front_end: FrontEnd = WIDE, sampling_s: float = 24.5 / 42.5e6, off_v: float = 3.25) -> tuple[float, float]:
    """5 pF that are off by `off_v` are switched to the pin: first deviation, and what is left at the end of sampling;
    codes. The switch is the same as the 5 pF at the pin and their charge, within a nanosecond."""
    bench = front_end_deck("kickback", front_end, LINE)
    farads = 5e-12
    bench.add(
        f"Vlight light 0 0\nCheld adc_1_0 0 {farads}\n"
        f"Ikick adc_1_0 0 pulse(0 {farads * off_v / 1e-9:.6g} {EDGE_S} 10p 10p 0.99n 1)"
    )
    rows = bench.run(f"tran 1n {EDGE_S + 4e-6} 0 1n", ["v(adc_1_0)"])
    rest = rows[-1][1]
    at = next(row for row in rows if row[0] >= EDGE_S + sampling_s)
    return max(abs(row[1] - rest) for row in rows) / CODE_V, abs(at[1] - rest) / CODE_V


def cathode_ripple(front_end: FrontEnd, frequency_hz: float = 100e3) -> tuple[float, float]:
    """Attenuation of the cathode filter, and current per electrode of 1 mV on the 9 V rail: A."""
    bench = front_end_deck("cathode ripple", front_end, LINE)
    bench.lines = [text.replace("V9 p9v 0 9", "V9 p9v 0 dc 9 ac 1") for text in bench.lines]
    bench.add("Vlight light 0 0")
    row = bench.run(f"ac lin 1 {frequency_hz} {frequency_hz}", ["v(d0_cathode)", "v(d0_out1)"])[0]
    return 1 / abs(complex(row[1], row[2])), abs(complex(row[3], row[4])) * 1e-3 / front_end.r_f.ohms


def operating_point(front_end: FrontEnd, light_a: float = 0.0) -> dict[str, float]:
    """DC voltages: reference at the detector's board, output, pin, cathode."""
    bench = front_end_deck("operating point", front_end, LINE)
    bench.add(f"Vlight light 0 {light_a}")
    row = bench.run("op", ["v(d0_vref)", "v(d0_out1)", "v(adc_1_0)", "v(d0_cathode)"])[0]
    return dict(zip(("vref", "out", "pin", "cathode"), row[-4:] if len(row) in (4, 5) else row[1::2]))


def clamp_current() -> float:
    """Current of the clamp if the amplifier's output is at 5 V: A."""
    bench = Deck("clamp")
    bench.add(RAILS)
    bench.parts(boards.carrier().block("input 0"))
    bench.add("Vfault out_1_0 0 5\nVrest out_2_0 0 3\nVr vref 0 3.2474")
    row = bench.run("op", ["v(adc_1_0)"])[0]
    return (5 - row[-1]) / 220


def crosstalk(front_end: FrontEnd) -> float:
    """Full-scale step of cell 0: deviation of cell 1's dark pin after the settling time, codes."""
    carrier = boards.carrier()
    bench = front_end_deck("crosstalk", front_end, LINE)
    bench.parts(carrier.block("input 1"))
    bench.detector_board(1, boards.detector(front_end), LINE.text("0"))
    full_a = FULL_SCALE_CODES * CODE_V / front_end.r_f.ohms
    bench.add(f"Vlight light 0 pulse(0 {2 * 0.9 * full_a:.8g} {EDGE_S} 10n 10n 1)")
    rows = bench.run(f"tran 20n {EDGE_S + 34e-6} 0 50n", ["v(adc_1_1)"])
    before = [row for row in rows if row[0] < EDGE_S][-1][1]
    return max(abs(row[1] - before) for row in rows if row[0] > EDGE_S + SETTLING_S) / CODE_V
