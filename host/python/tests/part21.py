"""Reads STEP files (ISO 10303-21) as text, without any CAD kernel: which part is where, and its flat faces.

Only what files of an assembly with one level contain; lengths are as in the file, millimetres.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
TOKEN = re.compile(r"'((?:[^']|'')*)'|#(\d+)|\.(\w+)\.|([-+]?\d[\d.]*(?:E[-+]?\d+)?)|([A-Z_0-9]+)|([(),$*])")


@dataclasses.dataclass(frozen=True)
class Reference:
    number: int


@dataclasses.dataclass(frozen=True, eq=False)
class Face:
    """A flat face bounded by one ring of straight edges: its corners in order, and its outward normal."""

    corners: Float
    normal: Float

    @property
    def centre(self) -> Float:
        return np.asarray(self.corners.mean(axis=0))

    @property
    def sides(self) -> list[float]:
        return [float(np.linalg.norm(b - a)) for a, b in zip(self.corners, np.roll(self.corners, -1, axis=0))]


class Part21:
    """The entities of a file, by their numbers."""

    def __init__(self, path: Path) -> None:
        text = path.read_text(encoding="ascii").split("DATA;", 1)[1].split("ENDSEC;", 1)[0]
        assert "SI_UNIT(.MILLI.,.METRE.)" in text
        self.entities: dict[int, dict[str, list[Any]]] = {}
        for number, body in re.findall(r"#(\d+)\s*=\s*(.*?);\s*(?=#|\Z)", text, re.DOTALL):
            self.entities[int(number)] = _records(body)

    def all(self, name: str) -> list[tuple[int, list[Any]]]:
        return [(number, records[name]) for number, records in self.entities.items() if name in records]

    def get(self, reference: Any, name: str) -> list[Any]:
        return self.entities[reference.number][name]

    def point(self, reference: Any) -> Float:
        return np.array(self.get(reference, "CARTESIAN_POINT")[1])

    def placement(self, reference: Any) -> Float:
        """4 x 4, of an AXIS2_PLACEMENT_3D."""
        _, origin, axis, along = self.get(reference, "AXIS2_PLACEMENT_3D")
        z, x = (np.array(self.get(direction, "DIRECTION")[1]) for direction in (axis, along))
        z /= np.linalg.norm(z)
        x -= (x @ z) * z
        x /= np.linalg.norm(x)
        matrix = np.eye(4)
        matrix[:3] = np.stack([x, np.cross(z, x), z, self.point(origin)], axis=1)
        return matrix

    def placed(self) -> dict[str, tuple[Float, list[Face]]]:
        """Each instance of the assembly by name: base_from_part, and its flat faces in the part's frame."""
        shapes = {}
        for _, (definition, representation) in self.all("SHAPE_DEFINITION_REPRESENTATION"):
            target = self.get(definition, "PRODUCT_DEFINITION_SHAPE")[2]
            shapes[target.number] = representation.number
        places = {}
        for _, (relation, shape) in self.all("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION"):
            transformation = self.get(relation, "REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION")[0]
            *_, part, base = self.get(transformation, "ITEM_DEFINED_TRANSFORMATION")
            usage = self.get(shape, "PRODUCT_DEFINITION_SHAPE")[2]
            places[usage.number] = self.placement(base) @ np.linalg.inv(self.placement(part))
        found = {}
        for number, usage in self.all("NEXT_ASSEMBLY_USAGE_OCCURRENCE"):
            solids = self._solids(shapes[usage[4].number])
            found[usage[1]] = (places[number], [face for solid in solids for face in self._faces(solid)])
        return found

    def _solids(self, representation: int) -> list[Any]:
        items = []
        for name in ("ADVANCED_BREP_SHAPE_REPRESENTATION", "SHAPE_REPRESENTATION"):
            items += self.entities[representation].get(name, [None, []])[1]
        for _, relation in self.all("SHAPE_REPRESENTATION_RELATIONSHIP"):
            if relation and relation[2].number == representation:
                items += self._solids(relation[3].number)
        return [
            item
            for item in items
            if isinstance(item, Reference) and "MANIFOLD_SOLID_BREP" in self.entities[item.number]
        ]

    def _faces(self, solid: Any) -> list[Face]:
        shell = self.get(self.get(solid, "MANIFOLD_SOLID_BREP")[1], "CLOSED_SHELL")
        found = []
        for reference in shell[1]:
            _, bounds, surface, same = self.get(reference, "ADVANCED_FACE")
            if "PLANE" not in self.entities[surface.number] or len(bounds) != 1:
                continue
            (records,) = [self.entities[bounds[0].number]]
            (bound,) = [records[name] for name in ("FACE_BOUND", "FACE_OUTER_BOUND") if name in records]
            corners, straight = [], True
            for oriented in self.get(bound[1], "EDGE_LOOP")[1]:
                *_, edge, forward = self.get(oriented, "ORIENTED_EDGE")
                _, start, end, curve, _ = self.get(edge, "EDGE_CURVE")
                straight &= (
                    "LINE" in self.entities[curve.number]
                    or "SURFACE_CURVE" in self.entities[curve.number]
                    and ("LINE" in self.entities[self.get(curve, "SURFACE_CURVE")[1].number])
                )
                corners.append(self.point(self.get(start if forward == "T" else end, "VERTEX_POINT")[1]))
            if straight:
                normal = self.placement(self.get(surface, "PLANE")[1])[:3, 2]
                found.append(Face(np.array(corners), normal if same == "T" else -normal))
        return found


def _records(body: str) -> dict[str, list[Any]]:
    """`NAME(arguments)`, or several such in brackets."""
    tokens = [match for match in TOKEN.finditer(body)]
    records: dict[str, list[Any]] = {}
    at = 0
    while at < len(tokens):
        name = tokens[at].group(5)
        if name:
            records[name], at = _arguments(tokens, at + 2)
        else:
            at += 1
    return records


def _arguments(tokens: list[re.Match[str]], at: int) -> tuple[list[Any], int]:
    """What is between two brackets, of which the first is behind."""
    found: list[Any] = []
    while True:
        text, reference, word, number, name, sign = tokens[at].groups()
        at += 1
        if sign == ")":
            return found, at
        if sign == "(":
            inner, at = _arguments(tokens, at)
            found.append(inner)
        elif text is not None:
            found.append(text)
        elif reference:
            found.append(Reference(int(reference)))
        elif word:
            found.append(word)
        elif number:
            found.append(float(number))
        elif name:
            inner, at = _arguments(tokens, at + 1)
            found.append({name: inner})
        elif sign in "$*":
            found.append(None)
