"""A jig for calibration without an instrument.

A foot has a cone for the tip (``--pivot``). On the ring, a deck carries a nest of three vees for three balls on the
handle (``--rest``), which slides along a fence against gauge blocks (``--stage``).

Lengths are millimetres, in the base frame with the tool at home.
"""

from __future__ import annotations

import math

from build123d import Align, Box, Cone, Location, Part, Pos, Rot, Sphere

from .head import HeadParts
from .sizes import ExportError
from .solids import CLEARANCE, OVER, THREAD, Joint, Placed, rod, sunk_hole

#: Directions of the vees, degrees.
VEES = (90.0, 210.0, 330.0)
#: Standoffs come in lengths of this step, mm.
STANDOFF_STEP = 5.0
#: Thread in each end of a standoff, mm.
STANDOFF_THREAD = 8.0


class JigParts:
    """The parts of the jig of one head."""

    def __init__(self, parts: HeadParts) -> None:
        self.parts = parts
        self.size = parts.sizes.jig
        self.tool = parts.sizes.tool
        if parts.tool_heights[1] + self.tool.flange_thickness > self.deck_top:
            raise ExportError("the tool's flange reaches above the jig's deck; use a smaller tool.flange_thickness")
        self.hole = self.tool.handle_radius + self.size.opening + self.size.steps

    @property
    def deck_top(self) -> float:
        """Height of the deck's top, on which the nest slides."""
        return self.parts.heights[1] + self.size.deck_thickness

    @property
    def nest_top(self) -> float:
        """Height of the nest's top."""
        return self.deck_top + self.size.nest_thickness

    @property
    def ball_height(self) -> float:
        """Height of the balls' middles: each touches both sides of its vee of 90 degrees."""
        return self.nest_top - self.size.vee_depth + math.sqrt(2.0) * self.size.ball_radius

    def ball_places(self) -> list[tuple[float, float]]:
        """Places of the balls in x and y."""
        radius = self.size.ball_circle
        return [(radius * math.cos(math.radians(angle)), radius * math.sin(math.radians(angle))) for angle in VEES]

    def fence_pins(self) -> list[tuple[float, float]]:
        """Places of the two pins of the fence, and of the stop, which a gauge block separates from the nest."""
        size = self.size
        fence = -(size.nest_flat + size.pin_radius)
        return [
            (size.fence_spread, fence),
            (-size.fence_spread, fence),
            (-(size.nest_flat + size.block + size.pin_radius), 0.0),
        ]

    def deck(self) -> Part:
        """The plate on the ring."""
        low, top = self.parts.heights[1], self.deck_top
        hole = sunk_hole("M3", low, top, head=top)
        deck = rod(max(self.size.deck_radius, self.parts.corner_radius), low, top) - rod(
            self.hole, low - OVER, top + OVER
        )
        for x, y in self.parts.corner_holes():
            deck -= Pos(x, y, 0) * hole
        for x, y in self.fence_pins():
            deck -= Pos(x, y, 0) * rod(self.size.pin_radius, low - OVER, top + OVER)
        return deck

    def nest(self) -> Part:
        """The plate with three vees, flat towards fence and stop."""
        size, low, top = self.size, self.deck_top, self.nest_top
        nest = rod(size.nest_radius, low, top) - rod(self.tool.handle_radius + size.opening, low - OVER, top + OVER)
        corner = Pos(-size.nest_flat, -size.nest_flat, low - OVER)
        nest &= corner * Box(200, 200, 100, align=(Align.MIN, Align.MIN, Align.MIN))
        apex = top - size.vee_depth
        length = 2 * (size.nest_radius - size.ball_circle) + 4 * OVER
        side = 4 * size.vee_depth
        for angle in VEES:
            wedge = Rot(45, 0, 0) * Box(length, side, side, align=(Align.CENTER, Align.MIN, Align.MIN))
            nest -= Rot(0, 0, angle) * Pos(size.ball_circle, 0, apex) * wedge
        return nest

    def ball_plate(self) -> Part:
        """The plate on the handle that holds the balls."""
        size = self.size
        low = self.nest_top + size.ball_plate_gap
        top = low + size.ball_plate_thickness
        if not low < self.ball_height + size.ball_radius < top - 0.8:
            text = (
                f"balls reach to {self.ball_height + size.ball_radius - low:.2f} mm in a plate of"
                f" {size.ball_plate_thickness:g} mm"
            )
            raise ExportError(f"{text}; change jig.vee_depth or jig.ball_plate_gap")
        plate = rod(size.ball_plate_radius, low, top) - rod(
            self.tool.handle_radius + size.clamp_clearance, low - OVER, top + OVER
        )
        for x, y in self.ball_places():
            plate -= Pos(x, y, 0) * rod(size.ball_radius, low - OVER, self.ball_height + size.ball_radius)
        middle = (low + top) / 2
        for angle in (30.0, 150.0):
            thread = Rot(0, 90, 0) * rod(
                THREAD["M3"] / 2, self.tool.handle_radius - OVER, size.ball_plate_radius + OVER
            )
            plate -= Pos(0, 0, middle) * Rot(0, 0, angle) * thread
        return plate

    @property
    def standoff(self) -> float:
        """Length of the three standoffs between foot and base plate."""
        plate = self.parts.plate_underside
        above_foot = plate - (self.tool.tip_z - self.size.cone_drop) + self.size.foot_boss_min_height
        free = max(above_foot, self.parts.tip_room[1])
        return STANDOFF_STEP * math.ceil(free / STANDOFF_STEP)

    @property
    def dowel(self) -> str:
        """Name of the dowels of fence and stop."""
        return f"jig dowel {2 * self.size.pin_radius:g}x{self.size.deck_thickness + self.size.pin_height:g}"

    def joints(self) -> list[Joint]:
        """The screws of the jig."""
        size, ring, deck = self.size, self.parts.sizes.ring, self.size.deck_thickness
        clamp = size.ball_plate_radius - self.tool.handle_radius
        return [
            Joint("M3", 3, "ISO 7046, countersunk, deck to ring", deck, ring.corner_depth),
            Joint("M4", 3, "ISO 4762, base plate to standoffs", ring.plate_thickness, STANDOFF_THREAD),
            Joint("M4", 3, "ISO 4762, foot to standoffs", size.foot_thickness, STANDOFF_THREAD),
            Joint("M3", 2, "ISO 4026, set screws, ball plate to handle", 0.0, clamp),
        ]

    def foot(self) -> Part:
        """The plate under the head, with the cone for the tip."""
        size, ball = self.size, self.tool.tip_ball_radius
        top = self.parts.plate_underside - self.standoff
        boss = self.tool.tip_z - size.cone_drop
        apex = self.tool.tip_z - ball / math.sin(math.radians(size.cone_half_angle_deg))
        wide = (boss + OVER - apex) * math.tan(math.radians(size.cone_half_angle_deg))
        foot = rod(self.parts.plate_radius, top - size.foot_thickness, top) + rod(
            size.foot_boss_radius, top - OVER, boss
        )
        foot -= Pos(0, 0, (apex + boss + OVER) / 2) * Cone(0.0, wide, boss + OVER - apex)
        for x, y in self.parts.plate_holes():
            foot -= Pos(x, y, 0) * rod(CLEARANCE["M4"] / 2, top - size.foot_thickness - OVER, top + OVER)
        return foot


def jig(jigs: JigParts) -> list[Placed]:
    """All parts of the jig in their places, the tool in the nest at home."""
    size, deck = jigs.size, jigs.deck_top
    low = jigs.parts.heights[1]
    pin = rod(size.pin_radius, 0.0, size.deck_thickness + size.pin_height)
    placed = [
        Placed("jig deck", jigs.deck(), Location(), away=(0, 0, 1.6)),
        Placed("jig nest", jigs.nest(), Location(), away=(0, 0, 2.2)),
        Placed("jig ball plate", jigs.ball_plate(), Location(), on_tool=True, away=(0, 0, 2.9)),
        Placed("jig foot", jigs.foot(), Location(), away=(0, 0, -1.6)),
    ]
    for number, (x, y) in enumerate(jigs.fence_pins()):
        placed.append(Placed(jigs.dowel, pin, Pos(x, y, low), number, made=False, away=(0, 0, 1.9)))
    for number, (x, y) in enumerate(jigs.ball_places()):
        ball = Sphere(size.ball_radius)
        placed.append(
            Placed("ball", ball, Pos(x, y, jigs.ball_height), number, on_tool=True, made=False, away=(0, 0, 2.6))
        )
    gauge = Pos(-(size.nest_flat + size.block / 2), 0, deck + 4.0) * Box(size.block, 30.0, 8.0)
    placed.append(Placed("gauge block", gauge, Location(), made=False, away=(-0.8, 0, 1.9)))
    plate = jigs.parts.plate_underside
    standoff = rod(3.5, plate - jigs.standoff, plate)
    for number, (x, y) in enumerate(jigs.parts.plate_holes()):
        placed.append(Placed("jig standoff", standoff, Pos(x, y, 0), number, made=False, away=(0, 0, -1.3)))
    return placed
