"""Solids of a head: primitives, places, and drills and screws."""

from __future__ import annotations

import dataclasses
import math
from typing import Iterable, Optional

import numpy as np
from build123d import Box, Cone, Cylinder, Location, Part, Plane, Polyline, Pos, Rot, make_face

from .layout import Float
from .sizes import ExportError

#: Drills: clearance holes and holes for threads (ISO 273 medium; nominal diameter less pitch).
CLEARANCE = {"M1.6": 1.8, "M2": 2.4, "M2.5": 2.9, "M3": 3.4, "M4": 4.5}
THREAD = {"M1.6": 1.25, "M2": 1.6, "M2.5": 2.05, "M3": 2.5, "M4": 3.3}
#: Diameters of countersinks of 90 degrees: heads of ISO 7046 are 4.7 and 5.5 wide and lie below the face.
COUNTERSINK = {"M2.5": 5.0, "M3": 6.0}
DOWEL = 2.0
#: Lengths of screws (ISO 4762, ISO 7046, ISO 1580, ISO 4026) and dowels (ISO 2338), mm.
LENGTHS = (3, 4, 5, 6, 8, 10, 12, 16, 20, 25)
#: Engaged thread in diameters: where its hole is deep enough, and at least. 0.8 are four turns of M2.
ENGAGEMENT = 1.5
MIN_ENGAGEMENT = 0.8
#: Left free below a screw in a blind hole, mm.
MIN_FREE_BELOW = 0.5
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


@dataclasses.dataclass(frozen=True)
class Joint:
    """Equal screws: what they join, `grip` from the head's seat (countersunk: its top) to the thread, the `hole` from
    there, and what stays `free` of it.
    """

    thread: str
    quantity: int
    text: str
    grip: float
    hole: float
    free: float = MIN_FREE_BELOW

    @property
    def length(self) -> int:
        """The shortest standard length with ENGAGEMENT, else the longest that fits.

        :raises ExportError: No length has MIN_ENGAGEMENT and fits.
        """
        diameter, most = float(self.thread[1:]), self.grip + self.hole - self.free
        least = self.grip + MIN_ENGAGEMENT * diameter
        fitting = [length for length in LENGTHS if least - 1e-9 <= length <= most + 1e-9]
        if not fitting:
            text = f"screw {self.thread} ({self.text}) must be {least:.1f} to {most:.1f} mm long"
            raise ExportError(f"{text}; no standard length is: change the thickness or the thread's depth with --sizes")
        return next((length for length in fitting if length >= self.grip + ENGAGEMENT * diameter), fitting[-1])


def is_foil(name: str) -> bool:
    """Whether a part is a slit mask, and not its frame or pin."""
    return name.startswith("mask ") and "frame" not in name and "pin" not in name


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


def sunk_hole(thread: str, z0: float, z1: float, head: float) -> Part:
    """A clearance hole between two heights with a countersink of 90 degrees at `head`, one of them."""
    wide, narrow = COUNTERSINK[thread] / 2, CLEARANCE[thread] / 2
    inward = 1.0 if head == z0 else -1.0
    cone = Cone(*((wide, narrow) if inward > 0 else (narrow, wide)), wide - narrow)
    return rod(narrow, z0 - OVER, z1 + OVER) + Pos(0, 0, head + inward * (wide - narrow) / 2) * cone


def three_between(places: Iterable[Float], radius: float) -> list[tuple[float, float]]:
    """Three places at a radius, each midway between two neighbours of `places`, as far apart as these allow."""
    towards = sorted(math.atan2(place[1], place[0]) for place in places)
    between = [(a + b) / 2 for a, b in zip(towards, [*towards[1:], towards[0] + 2 * math.pi])]
    chosen = [between[round(third * len(between) / 3) % len(between)] for third in range(3)]
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in chosen]


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
