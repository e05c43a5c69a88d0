"""Sheets: where parts stand and how wires run, checked against the circuit before anything is written.

Unit 1.27 mm, x to the right, y downwards. A pin that no wire touches gets a stub with a power symbol, or with its net's
name; a net on several sheets has a global label.
"""
from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

from .circuit import NO_CONNECTION, Circuit
from .symbols import LIBRARY, POWER, Symbol

Point = tuple[float, float]


class DrawingError(ValueError):
    """The drawing and the circuit differ; the pins or nets that do."""


def rotated(point: Point, rotation: int, mirrored: bool) -> Point:
    """From the symbol's frame (y up) to the sheet's (y down), about the origin."""
    x, y = point
    if mirrored:
        x = -x
    for _ in range(rotation // 90):
        x, y = -y, x
    return x, -y


@dataclass
class Placed:
    reference: str
    symbol: Symbol
    unit: int
    at: Point
    rotation: int = 0
    mirrored: bool = False

    def pins(self):
        for pin in self.symbol.pins:
            if pin.unit == self.unit:
                x, y = rotated(pin.at, self.rotation, self.mirrored)
                yield pin, (round(self.at[0] + x, 3), round(self.at[1] + y, 3)), rotated(pin.out, self.rotation, self.mirrored)


@dataclass
class Sheet:
    circuit: Circuit
    name: str
    title: str
    paper: str = "A3"
    placed: list[Placed] = field(default_factory=list)
    powers: list[tuple[str, Point, Point]] = field(default_factory=list)
    flags: list[Point] = field(default_factory=list)
    wires: list[tuple[Point, Point]] = field(default_factory=list)
    labels: list[tuple[str, Point, Point]] = field(default_factory=list)
    open_pins: list[Point] = field(default_factory=list)
    texts: list[tuple[str, Point, float]] = field(default_factory=list)
    frames: list[tuple[Point, Point]] = field(default_factory=list)

    def put(self, reference: str, x: float, y: float, rotation: int = 0, unit: int = 1, mirrored: bool = False) -> Placed:
        placed = Placed(reference, LIBRARY[self.circuit.parts[reference].kind.symbol], unit, (x, y), rotation, mirrored)
        self.placed.append(placed)
        return placed

    def wire(self, *points: Point) -> None:
        """Straight pieces through `points`."""
        for a, b in zip(points, points[1:]):
            if a[0] != b[0] and a[1] != b[1]:
                raise DrawingError(f"{self.name}: the wire {a} {b} is neither level nor upright")
            self.wires.append((a, b))

    def label(self, net: str, x: float, y: float, direction: Point = (1, 0)) -> None:
        """Name of a net at a point of a wire; the text runs in `direction`."""
        self.labels.append((net, (x, y), direction))

    def power(self, net: str, x: float, y: float, direction: Point | None = None) -> None:
        """Symbol of a rail; it points up, ground down, or in `direction`."""
        self.powers.append((net, (x, y), direction or ((0, 1) if net == "GND" else (0, -1))))

    def flag(self, net: str, x: float, y: float) -> None:
        """A rail with its source for the electrical rule check: the supply comes from a connector."""
        self.power(net, x, y)
        self.flags.append((x + 5, y))
        self.wire((x, y), (x + 5, y))

    def text(self, text: str, x: float, y: float, size: float = 1.5) -> None:
        self.texts.append((text, (x, y), size))

    def frame(self, x: float, y: float, width: float, height: float, title: str) -> None:
        """A dashed rectangle around a block, and its name."""
        self.frames.append(((x, y), (x + width, y + height)))
        self.text(title, x + 1.5, y + 2.5, 1.8)

    def on_wire(self, point: Point) -> bool:
        return any(_on(point, wire) for wire in self.wires)

    def finish(self) -> None:
        """Stubs for all pins that no wire touches; then all moves inside the sheet's border."""
        for placed in self.placed:
            nets = self.circuit.parts[placed.reference].nets
            done: set[Point] = set()
            for pin, at, out in placed.pins():
                net = nets[pin.number]
                if net == NO_CONNECTION:
                    self.open_pins.append(at)
                elif not self.on_wire(at) and at not in done and not any(at == p for _, p, _ in self.powers):
                    done.add(at)
                    self._stub(net, at, out)
        self._split()
        self._shift(4, 3)

    def _shift(self, dx: float, dy: float) -> None:
        def moved(point: Point) -> Point:
            return point[0] + dx, point[1] + dy

        for placed in self.placed:
            placed.at = moved(placed.at)
        self.powers = [(net, moved(at), direction) for net, at, direction in self.powers]
        self.flags, self.open_pins = [moved(at) for at in self.flags], [moved(at) for at in self.open_pins]
        self.wires = [(moved(a), moved(b)) for a, b in self.wires]
        self.frames = [(moved(a), moved(b)) for a, b in self.frames]
        self.labels = [(net, moved(at), direction) for net, at, direction in self.labels]
        self.texts = [(text, moved(at), size) for text, at, size in self.texts]

    def _split(self) -> None:
        """KiCad joins wires at their ends only: cuts each where another ends, or at a pin."""
        ends = {point for wire in self.wires for point in wire} | {at for _, at, _ in self.powers} | set(self.flags)
        ends |= {at for placed in self.placed for _, at, _ in placed.pins()}
        pieces = []
        for a, b in self.wires:
            inside = sorted({point for point in ends if _on(point, (a, b))} | {a, b})
            pieces += list(zip(inside, inside[1:]))
        self.wires = sorted(set(pieces))

    def _stub(self, net: str, at: Point, out: Point) -> None:
        end = (at[0] + 2 * out[0], at[1] + 2 * out[1])
        if net in POWER:
            upright = out == ((0, 1) if net == "GND" else (0, -1))
            if upright:
                self.power(net, *at)
                return
            self.wires.append((at, end))
            self.power(net, *end, out)
        else:
            self.wires.append((at, end))
            self.labels.append((net, end, out))

    def junctions(self) -> set[Point]:
        """Points where three ends of wires or pins meet."""
        ends: dict[Point, int] = defaultdict(int)
        for wire in self.wires:
            for point in wire:
                ends[point] += 1
        pins = {at for placed in self.placed for _, at, _ in placed.pins()} | {at for _, at, _ in self.powers} | set(self.flags)
        return {point for point, count in ends.items() if count + (point in pins) >= 3}


def _on(point: Point, wire: tuple[Point, Point]) -> bool:
    (x0, y0), (x1, y1) = wire
    x, y = point
    return min(x0, x1) <= x <= max(x0, x1) and min(y0, y1) <= y <= max(y0, y1) and ((x0 == x1 == x) or (y0 == y1 == y))


def check(circuit: Circuit, sheets: list[Sheet]) -> None:
    """Every pin of the circuit is drawn once, and what the drawing joins is exactly the circuit's nets."""
    parent: dict = {}

    def root(item):
        while parent.setdefault(item, item) != item:
            item = parent[item]
        return item

    drawn: dict[tuple[str, str], tuple] = {}
    for sheet in sheets:
        points: list[Point] = [point for wire in sheet.wires for point in wire]
        points += [at for _, at, _ in sheet.labels] + [at for _, at, _ in sheet.powers] + sheet.flags
        for placed in sheet.placed:
            for pin, at, _ in placed.pins():
                if (placed.reference, pin.number) in drawn:
                    raise DrawingError(f"{placed.reference} pin {pin.number} is drawn twice")
                drawn[placed.reference, pin.number] = (sheet.name, at)
                points.append(at)
        for wire in sheet.wires:
            for point in points:
                if _on(point, wire):
                    parent[root((sheet.name, point))] = root((sheet.name, wire[0]))
        for net, at, _ in sheet.labels:
            parent[root((sheet.name, at))] = root(net)
        for net, at, _ in sheet.powers:
            parent[root((sheet.name, at))] = root(net)
    faults = []
    of_root: dict = {}
    for part in circuit.parts.values():
        for number, net in part.nets.items():
            at = drawn.get((part.reference, number))
            if at is None:
                faults.append(f"{part.reference} pin {number} is not drawn")
                continue
            found = root(at)
            if net == NO_CONNECTION:
                net = f"(open) {part.reference}.{number}"
            if of_root.setdefault(found, net) != net:
                faults.append(f"{part.reference} pin {number}: {net} is joined to {of_root[found]}")
    roots: dict[str, set] = defaultdict(set)
    for found, net in of_root.items():
        roots[net].add(found)
    faults += [f"net {net} is in {len(found)} pieces" for net, found in roots.items() if len(found) > 1]
    if faults:
        raise DrawingError("\n".join(faults))
