"""Symbols of the schematic, drawn here so that no library is needed. Unit: 1.27 mm; x to the right, y upwards.

A pin is where its wire begins; `out` is the direction of that wire, away from the body.
"""
from __future__ import annotations

from dataclasses import dataclass, field

from . import catalogue

RIGHT, UP, LEFT, DOWN = (1, 0), (0, 1), (-1, 0), (0, -1)
Point = tuple[float, float]


@dataclass(frozen=True)
class SymbolPin:
    number: str
    name: str
    electrical: str
    at: Point
    out: Point
    length: float
    unit: int = 1
    hidden: bool = False


@dataclass
class Symbol:
    name: str
    pins: list[SymbolPin] = field(default_factory=list)
    # Of each unit: ("line", points), ("rectangle", a, b), ("circle", centre, radius), ("text", at, text).
    shapes: dict[int, list[tuple]] = field(default_factory=dict)
    reference: tuple[float, float, str] = (0, 0, "left")
    value: tuple[float, float, str] = (0, 0, "left")
    show_names: bool = False
    show_numbers: bool = True
    power: bool = False

    def units(self) -> list[int]:
        return sorted(self.shapes)


def _two(name: str, shapes: list[tuple], pins=(("1", "1"), ("2", "2")), reach: float = 3, body: float = 1.6) -> Symbol:
    """A part with a pin above and one below."""
    (n1, name1), (n2, name2) = pins
    return Symbol(
        name,
        [
            SymbolPin(n1, name1, "passive", (0, reach), UP, reach - body),
            SymbolPin(n2, name2, "passive", (0, -reach), DOWN, reach - body),
        ],
        {1: shapes}, (1.6, 1.0, "left"), (1.6, -1.0, "left"), show_numbers=False,
    )


def _box(
    name: str, kind, left=(), right=(), top=(), bottom=(), half_width: float = 6, pitch: float = 2, names: bool = True, tall: float = 0
) -> Symbol:
    """A box; each side lists names of pins, `None` for a gap. Pins of one name on one side lie on each other."""
    rows = max(len(left), len(right), 1)
    half = max((rows - 1) * pitch / 2 + 2, tall)
    used: set[str] = set()
    pins: list[SymbolPin] = []

    def put(side, at_of, out):
        for i, pin_name in enumerate(side):
            if pin_name is None:
                continue
            same = [pin for pin in kind.pins if pin.name == pin_name or pin.number == pin_name]
            if len({pin.number for pin in same} - used) and name in ("ESD2",):
                same = [next(pin for pin in same if pin.number not in used)]
            for j, pin in enumerate(same):
                used.add(pin.number)
                pins.append(SymbolPin(pin.number, pin.name, pin.electrical, at_of(i, len(side)), out, 3, hidden=j > 0))

    def height(i, n):
        return 0 if n == 1 else (rows - 1) * pitch / 2 - i * pitch

    put(left, lambda i, n: (-half_width - 3, height(i, n)), LEFT)
    put(right, lambda i, n: (half_width + 3, height(i, n)), RIGHT)
    put(top, lambda i, n: (-(n - 1) * 2 + i * 4, half + 3), UP)
    put(bottom, lambda i, n: (-(n - 1) * 2 + i * 4, -half - 3), DOWN)
    symbol = Symbol(name, pins, {1: [("rectangle", (-half_width, half), (half_width, -half))]}, show_names=names)
    symbol.reference = (-half_width, half + 1, "left")
    # Beside the pins below.
    symbol.value = ((len(bottom) - 1) * 2 + 1.5 if bottom else -half_width, -half - 1, "left")
    return symbol


def _diode(name: str, zener: bool = False, light: bool = False, schottky: bool = False) -> Symbol:
    bar: list[Point] = [(-1.4, 1.2), (1.4, 1.2)]
    if zener:
        bar = [(-1.8, 0.7), (-1.4, 1.2), (1.4, 1.2), (1.8, 1.7)]
    if schottky:
        bar = [(-0.9, 0.8), (-1.4, 0.8), (-1.4, 1.2), (1.4, 1.2), (1.4, 1.6), (0.9, 1.6)]
    shapes = [("line", [(-1.4, -1.2), (1.4, -1.2), (0, 1.2), (-1.4, -1.2)]), ("line", bar)]
    if light:
        shapes += [("line", [(1.8, 0.2), (3.0, 1.4), (2.4, 1.3)]), ("line", [(1.8, -1.0), (3.0, 0.2), (2.4, 0.1)])]
    symbol = _two(name, shapes, (("1", "K"), ("2", "A")), body=1.2)
    if light:
        symbol.reference, symbol.value = (3.6, 1.0, "left"), (3.6, -1.0, "left")
    return symbol


def _opamp() -> Symbol:
    pins, shapes = [], {}
    for unit, numbers in ((1, ("3", "2", "1")), (2, ("5", "6", "7"))):
        plus, minus, out = numbers
        letter = "AB"[unit - 1]
        pins += [
            SymbolPin(plus, letter + "+", "input", (-6, 2), LEFT, 2, unit),
            SymbolPin(minus, letter + "-", "input", (-6, -2), LEFT, 2, unit),
            SymbolPin(out, letter + "OUT", "output", (6, 0), RIGHT, 2, unit),
        ]
        shapes[unit] = [
            ("line", [(-4, 4), (4, 0), (-4, -4), (-4, 4)]), ("line", [(-3.4, 2), (-2.2, 2)]), ("line", [(-2.8, 2.6), (-2.8, 1.4)]),
            ("line", [(-3.4, -2), (-2.2, -2)]),
        ]
    pins += [
        SymbolPin("8", "V+", "power_in", (0, 6), UP, 3, 3), SymbolPin("4", "V-", "power_in", (0, -6), DOWN, 3, 3),
    ]
    shapes[3] = [("rectangle", (-2, 3), (2, -3))]
    symbol = Symbol("OPA2", pins, shapes, (0, 4.6, "left"), (0, -4.6, "left"))
    return symbol


def _nmos() -> Symbol:
    return Symbol(
        "NMOS",
        [
            SymbolPin("1", "G", "input", (-4, 0), LEFT, 3), SymbolPin("3", "D", "passive", (2, 6), UP, 4),
            SymbolPin("2", "S", "passive", (2, -6), DOWN, 4),
        ],
        {1: [
            ("line", [(-1, 2), (-1, -2)]), ("line", [(-0.3, 2.4), (-0.3, 1.2)]), ("line", [(-0.3, 0.6), (-0.3, -0.6)]),
            ("line", [(-0.3, -1.2), (-0.3, -2.4)]), ("line", [(-0.3, 1.8), (2, 1.8), (2, 2)]),
            ("line", [(2, -2), (2, -1.8), (-0.3, -1.8)]), ("line", [(2, -1.8), (2, 0), (-0.3, 0)]),
            ("line", [(0.6, 0.5), (-0.2, 0), (0.6, -0.5)]),
        ]}, (3.6, 1.0, "left"), (3.6, -1.0, "left"),
    )


def _pair() -> Symbol:
    """Two diodes in series, lying: anode left, cathode right, their middle above."""
    def triangle(x):
        return [
            ("line", [(x - 1.2, 1.2), (x - 1.2, -1.2), (x + 1.2, 0), (x - 1.2, 1.2)]),
            ("line", [(x + 1.2, 1.2), (x + 1.2, -1.2)]),
        ]
    return Symbol(
        "PAIR",
        [
            SymbolPin("1", "A", "passive", (-6, 0), LEFT, 2), SymbolPin("2", "K", "passive", (6, 0), RIGHT, 2),
            SymbolPin("3", "COM", "passive", (0, 5), UP, 5),
        ],
        {1: [*triangle(-2.4), *triangle(2.4), ("line", [(-4, 0), (-3.6, 0)]), ("line", [(-1.2, 0), (1.2, 0)]), ("line", [(3.6, 0), (4, 0)])]},
        (-4.5, -2.6, "left"), (-4.5, -4.4, "left"),
    )


def _psd() -> Symbol:
    return Symbol(
        "PSD",
        [
            SymbolPin("2", "K1", "passive", (-2, 7), UP, 3), SymbolPin("4", "K2", "passive", (2, 7), UP, 3),
            SymbolPin("1", "A1", "passive", (9, 2), RIGHT, 3), SymbolPin("3", "A2", "passive", (9, -2), RIGHT, 3),
        ],
        {1: [
            ("rectangle", (-6, 4), (6, -4)), ("line", [(-2.5, -1.5), (-0.5, -1.5), (-1.5, 0.5), (-2.5, -1.5)]),
            ("line", [(-2.6, 0.6), (-0.4, 0.6)]), ("line", [(-5.2, 2.4), (-3.2, 0.8), (-4.0, 0.9)]),
            ("line", [(-5.2, 0.9), (-3.2, -0.7), (-4.0, -0.6)]),
        ]}, (-6, -5.2, "left"), (-6, -7.0, "left"), show_names=True,
    )


def _power(name: str, down: bool) -> Symbol:
    shape = (
        [("line", [(0, 0), (0, -1)]), ("line", [(-1.2, -1), (1.2, -1), (0, -2.2), (-1.2, -1)])] if down
        else [("line", [(0, 0), (0, 1.6)]), ("line", [(-0.6, 0.9), (0, 1.8), (0.6, 0.9)])]
    )
    symbol = Symbol(
        name, [SymbolPin("1", name, "power_in", (0, 0), DOWN if not down else UP, 0)], {1: shape},
        value=(0, -3.2, "center") if down else (0, 2.6, "center"), power=True, show_numbers=False,
    )
    return symbol


POWER = ("GND", "+5V", "+5VA", "+5VE", "+3V3", "+9V", "+12V", "AVDD")


def library() -> dict[str, Symbol]:
    c = catalogue
    c_plates = [("line", [(-1.6, 0.4), (1.6, 0.4)]), ("line", [(-1.6, -0.4), (1.6, -0.4)])]
    capacitor, polarised = (_two(name, [*c_plates], pins, body=0.4) for name, pins in (
        ("C", (("1", "1"), ("2", "2"))), ("CP", (("1", "+"), ("2", "-")))
    ))
    polarised.shapes[1] = [*c_plates, ("line", [(-1.6, 1.4), (-0.8, 1.4)]), ("line", [(-1.2, 1.8), (-1.2, 1.0)])]
    for symbol in (capacitor, polarised):
        symbol.reference, symbol.value = (2.0, 1.2, "left"), (2.0, -1.2, "left")
    flag = Symbol(
        "PWR_FLAG", [SymbolPin("1", "1", "power_out", (0, 0), DOWN, 0)],
        {1: [("line", [(0, 0), (0, 1)]), ("line", [(0, 1), (-0.8, 1.7), (0, 2.4), (0.8, 1.7), (0, 1)])]}, value=(0, 3.2, "center"),
        power=True, show_numbers=False,
    )
    pad = Symbol(
        "TP", [SymbolPin("1", "1", "passive", (0, 0), DOWN, 0)], {1: [("circle", (0, 1), 0.8), ("line", [(0, 0), (0, 0.2)])]},
        (1.4, 2.4, "left"), (1.4, 1.0, "left"), show_numbers=False,
    )
    morpho = _box(
        "MORPHO", c.MORPHO, [str(i) for i in range(1, 39, 2)], [str(i) for i in range(2, 39, 2)], half_width=4, pitch=4, names=False,
    )
    symbols = [
        _two("R", [("rectangle", (-0.8, 1.6), (0.8, -1.6))]), capacitor, polarised,
        _two("FUSE", [("rectangle", (-0.7, 1.6), (0.7, -1.6)), ("line", [(0, 1.6), (0, -1.6)])]),
        _diode("TVS", zener=True), _diode("SCHOTTKY", schottky=True), _diode("LED", light=True),
        _opamp(), _nmos(), _pair(), _psd(), pad, morpho,
        _box("SPDT", c.SWITCH, ["B2", "B1"], ["A"], ["VCC"], ["S", "GND"], half_width=5, pitch=4),
        _box("ESD2", c.ESD2, ["IO1", "IO2"], ["IO1", "IO2"], ["VBUS"], ["GND"], half_width=5, pitch=4),
        _box("ESD4", c.ESD4, ["IO1", "IO2", "IO3", "IO4"], [], ["VBUS"], ["GND"], half_width=5),
        _box("LOADSW", c.LOAD_SWITCH, ["VIN", "ON"], ["VOUT", "QOD", "CT"], [], ["GND"]),
        _box("LDO", c.REGULATOR, ["IN", "EN", "NR"], ["OUT", "FB", "NC", "DNC"], [], ["GND", "PAD"]),
        _box("CONN6", c.JST_6, [], [str(i) for i in range(1, 7)], half_width=3, pitch=4, names=False),
        _box("CONN2", c.JST_2, [], ["1", "2"], half_width=3, pitch=4, names=False),
        _box("USBC", c.USB_C, [], ["VBUS", "CC1", "CC2", "D-", "D+", "SBU1", "SBU2", "GND", "SHIELD"], half_width=6),
        _box("JUMPER3", c.JUMPER3, ["A", "B"], ["C"], half_width=4, pitch=4),
        _box("JUMPER2", c.JUMPER2, ["A"], ["B"], half_width=4),
        flag, *(_power(name, name == "GND") for name in POWER),
    ]
    return {symbol.name: symbol for symbol in symbols}


LIBRARY = library()
