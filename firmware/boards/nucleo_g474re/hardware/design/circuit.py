"""Parts, pins and nets of one board: what the schematic, the netlist, the bill and the simulation are made from.

A `Circuit` maps each pin of each part to the name of a net. Nothing else knows connections: the drawing is checked
against it (`drawing.Sheet.check`), the simulation reads it (`spice.deck`).
"""
from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field


class CircuitError(ValueError):
    """A part or a pin that does not fit, with its name."""


@dataclass(frozen=True)
class Pin:
    number: str
    name: str
    electrical: str = "passive"
    unit: int = 1


@dataclass(frozen=True)
class Kind:
    """A line of the catalogue: one part that can be ordered, or one without a number, such as a pad."""

    key: str
    letter: str
    symbol: str
    pins: tuple[Pin, ...]
    value: str
    footprint: str
    manufacturer: str
    number: str
    source: str
    verified: bool
    spice: str = ""
    ohms: float = 0.0
    farads: float = 0.0
    on_bill: bool = True

    def pin(self, name: str) -> list[Pin]:
        return [pin for pin in self.pins if name in (pin.name, pin.number)]


@dataclass
class Part:
    reference: str
    kind: Kind
    block: str
    nets: dict[str, str] = field(default_factory=dict)

    def net(self, name: str) -> str:
        """Net of the pin of this name or number."""
        pins = self.kind.pin(name)
        if not pins:
            raise CircuitError(f"{self.reference} ({self.kind.key}) has no pin {name}")
        return self.nets[pins[0].number]


NO_CONNECTION = ""


@dataclass
class Circuit:
    name: str
    parts: dict[str, Part] = field(default_factory=dict)

    def add(self, reference: str, kind: Kind, block: str, **nets: str) -> Part:
        """Adds a part; each keyword is a pin by name, or by number behind `p`, and its value the net. Every pin must
        be named; `NO_CONNECTION` leaves it open. Pins of the same name are joined."""
        if reference in self.parts:
            raise CircuitError(f"{reference} stands twice in {self.name}")
        part = Part(reference, kind, block)
        for key, net in nets.items():
            pins = kind.pin(key) or kind.pin(key.removeprefix("p"))
            if not pins:
                raise CircuitError(f"{reference} ({kind.key}) has no pin {key}")
            for pin in pins:
                part.nets[pin.number] = net
        missing = [pin.number for pin in kind.pins if pin.number not in part.nets]
        if missing:
            raise CircuitError(f"{reference} ({kind.key}): no net for pins {', '.join(missing)}")
        self.parts[reference] = part
        return part

    def nets(self) -> dict[str, list[tuple[str, str]]]:
        """Net to (reference, pin number), without open pins."""
        nets: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for part in self.parts.values():
            for number, net in part.nets.items():
                if net != NO_CONNECTION:
                    nets[net].append((part.reference, number))
        return dict(nets)

    def block(self, name: str) -> list[Part]:
        return [part for part in self.parts.values() if part.block == name]
