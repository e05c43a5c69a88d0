"""Solids of a head: primitives, places, and drills and screws."""

from __future__ import annotations

import dataclasses
import math
from typing import Iterable, Optional

import numpy as np
from build123d import Box, Cylinder, Location, Part, Plane, Polyline, Pos, Rot, make_face

from .layout import Float

#: Drills: clearance holes and holes for threads (ISO 273 medium; nominal diameter less pitch).
CLEARANCE = {"M1.6": 1.8, "M2": 2.4, "M2.5": 2.9, "M3": 3.4, "M4": 4.5}
THREAD = {"M1.6": 1.25, "M2": 1.6, "M2.5": 2.05, "M3": 2.5, "M4": 3.3}
#: Heads of countersunk screws (ISO 10642, DIN 965): diameter, height.
COUNTERSUNK = {"M2.5": (5.0, 1.3), "M3": (6.0, 1.7)}
DOWEL = 2.0
#: Cuts go through faces by this much.
OVER = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """A solid in its place, with the tool at home.

    :ivar name: of the part, the same for parts that are the same.
    :ivar instance: tells instances apart: the cell's number.
    :ivar on_tool: it moves with the tool.
    :ivar made: it is made to this drawing; else it is bought.
    :ivar away: direction in which exploded views move it.
    """

    name: str
    solid: Part
    base_from_part: Location
    instance: Optional[int] = None
    on_tool: bool = False
    made: bool = True
    away: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def label(self) -> str:
        """Name and instance."""
        return self.name if self.instance is None else f"{self.name} {self.instance}"

    @property
    def in_place(self) -> Part:
        """The solid in the base frame."""
        return self.solid.moved(self.base_from_part)


def location(translation: Float, turned: Float) -> Location:
    """The location of a frame: its origin, and its axes as columns."""
    origin, x, z = (tuple(float(number) for number in vector) for vector in (translation, turned[:, 0], turned[:, 2]))
    return Location(Plane(origin=origin, x_dir=x, z_dir=z))


def rod(radius: float, z0: float, z1: float) -> Part:
    """A cylinder about z between two heights."""
    return Pos(0, 0, (z0 + z1) / 2) * Cylinder(radius, z1 - z0)


def slab(x: float, y: float, z0: float, z1: float) -> Part:
    """A cuboid about z between two heights."""
    return Pos(0, 0, (z0 + z1) / 2) * Box(x, y, z1 - z0)


def shifted(x: float, y: float, solid: Part) -> Part:
    """A solid moved in x and y."""
    return Pos(x, y, 0) * solid


def turned_about_z(angle: float, solid: Part) -> Part:
    """A solid turned about z, rad."""
    return Rot(0, 0, math.degrees(angle)) * solid


def cut(solid: Part, tools: Iterable[Part]) -> Part:
    """A solid without the tools."""
    for tool in tools:
        solid = solid - tool
    return solid


def polygon(distances: Iterable[float], directions: Iterable[Float], radius: float) -> Part:
    """The polygon of half planes `direction · p <= distance`, within a circle, as a face at z = 0."""
    corners = [np.array(corner) * radius * 2.0 for corner in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    for distance, direction in zip(distances, directions):
        outside = [float(direction[:2] @ corner) - distance for corner in corners]
        kept: list[Float] = []
        for i, corner in enumerate(corners):
            before, here = outside[i - 1], outside[i]
            if (before > 0.0) != (here > 0.0):
                kept.append(corners[i - 1] + (corner - corners[i - 1]) * (before / (before - here)))
            if here <= 0.0:
                kept.append(corner)
        corners = kept
    points = [(float(x), float(y)) for x, y in corners]
    return make_face(Polyline(*points, close=True))
