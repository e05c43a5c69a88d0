"""Bill of materials of one head: a line for each part number of each board."""
from __future__ import annotations

import csv
import io
from collections import defaultdict

from . import boards
from .circuit import Circuit

BOARDS_PER_HEAD = {"carrier": 1, "detector": 6, "emitter": 6}
HEADER = ("board", "per board", "per head", "references", "value", "manufacturer", "number", "footprint", "source", "verified")
MODULES = (
    ("head", 1, 1, "", "NUCLEO-G474RE", "STMicroelectronics", "NUCLEO-G474RE", "", "firmware/PARTS.md", "yes"),
    ("head", 12, 12, "", "housing of the detectors' cables, 6 ways", "JST", "SHR-06V-S", "", "JST SH catalogue; number by its scheme", "no"),
    ("head", 6, 6, "", "housing of the emitters' wires, 2 ways", "JST", "SHR-02V-S", "", "JST SH catalogue; number by its scheme", "no"),
    ("head", 84, 84, "", "crimp contact", "JST", "SSH-003T-P0.2-H", "", "firmware/PARTS.md", "yes"),
)


def circuits() -> list[Circuit]:
    return [boards.carrier(), boards.detector(), boards.emitter()]


def rows() -> list[tuple]:
    out: list[tuple] = [HEADER]
    for circuit in circuits():
        lines = defaultdict(list)
        for part in circuit.parts.values():
            if part.kind.on_bill:
                lines[part.kind].append(part.reference)
        heads = BOARDS_PER_HEAD[circuit.name]
        for kind, references in sorted(lines.items(), key=lambda line: (line[0].letter, line[0].key)):
            out.append((
                circuit.name, len(references), heads * len(references), " ".join(references), kind.value, kind.manufacturer,
                kind.number, kind.footprint, kind.source, "yes" if kind.verified else "no",
            ))
    return out + list(MODULES)


def text() -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows())
    return buffer.getvalue()
