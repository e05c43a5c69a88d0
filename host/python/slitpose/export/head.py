"""The solids of a head: cell blocks, masks, ring, emitter carrier, handle and tip, and the parts one buys.

Each function makes one part in its own frame; :func:`head` puts them where the scene has them. Lengths are millimetres.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Callable, Iterable, Optional

import numpy as np
from build123d import Box, Cone, Cylinder, Location, Part, Plane, Polyline, Pos, Rot, Sphere, extrude, make_face

from .layout import Cell, Float, Layout, Rays
from .sizes import ExportError, Sizes

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


def _at(x: float, y: float, solid: Part) -> Part:
    return Pos(x, y, 0) * solid


def _turned(angle: float, solid: Part) -> Part:
    return Rot(0, 0, math.degrees(angle)) * solid


def _cut(solid: Part, tools: Iterable[Part]) -> Part:
    for tool in tools:
        solid = solid - tool
    return solid


def _hull(cell: Cell, height: float) -> tuple[float, float]:
    """Half extents of the light between slit and active area at a height above the area, in the slit's middle's x and y."""
    share = height / cell.distance
    x, y = ((1 - share) * area / 2 + share * slit / 2 for area, slit in zip(cell.area, cell.slit))
    turned = share * math.sin(abs(cell.turn)) * max(cell.slit) / 2
    return x + turned, y + turned


class HeadParts:
    """The parts of one head, each made once."""

    def __init__(self, layout: Layout, sizes: Sizes) -> None:
        self.layout = layout
        self.sizes = sizes
        self._rear = -(sizes.detector.height - sizes.detector.surface_depth)

    # The cell block and what it carries, in the block's frame.

    @property
    def flange_top(self) -> float:
        """Height of the flange's face on the ring."""
        return self.sizes.detector.surface_depth + self.sizes.block.shoulder

    def _corners(self) -> list[tuple[float, float]]:
        block = self.sizes.block
        return [(block.corner, block.ring_screw), (block.corner, -block.ring_screw), (-block.corner, -block.ring_screw)]

    def block(self, cell: Cell) -> Part:
        """Barrel and flange: the mask's seat in front, the detector's shoulder behind."""
        size, detector, mask = self.sizes.block, self.sizes.detector, self.sizes.mask
        rear = self._rear + size.board_gap
        plate = cell.seat - size.plate
        if plate <= detector.surface_depth:
            text = f"cell {cell.number}: slit.distance_mm = {cell.distance:g} leaves no room for the plate of"
            raise ExportError(f"{text} {size.plate:g} mm that carries the mask; use {self.least_distance(cell):.2f} or more")
        chamber = math.hypot(cell.area[0] / 2, cell.area[1] / 2) + size.chamber_clearance
        slot_x, slot_y = (extent + size.slot_clearance for extent in _hull(cell, plate))
        slot_y = max(slot_y, cell.slit[1] / 2 + size.slot_clearance)
        body = slab(2 * size.flange_half_width, 2 * size.flange_half_height, rear, self.flange_top)
        body += rod(size.barrel_radius, self.flange_top - OVER / 2, cell.seat)
        through = rear - OVER
        pocket_x, pocket_y = (extent + 2 * detector.clearance for extent in (detector.length, detector.width))
        head, height = COUNTERSUNK["M2.5"]
        hole = rod(CLEARANCE["M2.5"] / 2, through, self.flange_top + OVER)
        countersink = Pos(0, 0, rear + height / 2) * Cone(head / 2, CLEARANCE["M2.5"] / 2, height)
        turned = [
            slab(pocket_x, pocket_y, through, detector.surface_depth),
            _at(cell.offset[0], cell.offset[1], slab(2 * slot_x, 2 * slot_y, plate - OVER, cell.seat + OVER)),
            *(_at(side * mask.pin_distance, 0, self._pin_hole(plate - OVER, cell.seat + OVER)) for side in (1, -1)),
        ]
        return _cut(
            body,
            [
                rod(chamber, detector.surface_depth - OVER / 2, plate),
                *(_turned(cell.roll, tool) for tool in turned),
                *(_at(0, side * size.ring_screw, hole + countersink) for side in (1, -1)),
                *(_at(*at, rod(THREAD["M2"] / 2, through, self.flange_top + OVER)) for at in self._corners()),
                _at(-size.corner, size.ring_screw, rod(DOWEL / 2, through, self.flange_top + OVER)),
            ],
        )

    def least_distance(self, cell: Cell) -> float:
        """Least distance from detector to mask for which a block can be made."""
        return self.sizes.detector.surface_depth + self.sizes.block.plate + 0.5 + cell.thickness / 2

    def _pin_hole(self, z0: float, z1: float) -> Part:
        return rod(self.sizes.mask.pin_diameter / 2, z0, z1)

    def mask(self, cell: Cell) -> Part:
        """The foil with its slit and two holes for pins, in the cell's frame."""
        size, top = self.sizes.mask, cell.seat + cell.thickness
        foil = rod(size.radius, cell.seat, top)
        slit = _at(*cell.offset, _turned(cell.turn, slab(*cell.slit, cell.seat - OVER, top + OVER)))
        holes = [_at(side * size.pin_distance, 0, self._pin_hole(cell.seat - OVER, top + OVER)) for side in (1, -1)]
        return _cut(foil, [slit, *holes])

    def frame_opening(self, cell: Cell, rays: Rays) -> tuple[float, float]:
        """Half extents of the frame's opening: the light's, over the workspace, with the slot's clearance."""
        size = self.sizes.mask
        front = cell.seat + cell.thickness + size.frame_thickness
        at = rays.end + (rays.start - rays.end) * (front / rays.start[:, 2])[:, None]
        x, y = np.maximum(np.abs(at[:, :2]).max(axis=0), np.abs(cell.offset) + np.array(cell.slit) / 2)
        clearance = self.sizes.block.slot_clearance
        half = float(x) + clearance, float(y) + clearance
        if half[0] > size.pin_distance - size.pin_diameter / 2 - 0.8 or half[1] > size.frame_radius - 0.8:
            text = f"cell {cell.number}: the light needs an opening of {2 * half[0]:.1f} x {2 * half[1]:.1f} mm in the frame"
            raise ExportError(f"{text} of the mask; use a smaller workspace, or a larger mask.frame_radius and pin_distance")
        return half

    def frame(self, cell: Cell, opening: tuple[float, float]) -> Part:
        """The frame that presses the mask on its seat, in the cell's frame."""
        size, seat = self.sizes.mask, cell.seat + cell.thickness
        front = seat + size.frame_thickness
        tools = [
            slab(2 * opening[0], 2 * opening[1], seat - OVER, front + OVER),
            *(_at(side * size.pin_distance, 0, self._pin_hole(seat - OVER, front + OVER)) for side in (1, -1)),
        ]
        return _cut(rod(size.frame_radius, seat, front), tools)

    def pin(self) -> Part:
        """A pin of the mask; its upper end is its origin."""
        return rod(self.sizes.mask.pin_diameter / 2, -self.sizes.mask.pin_length, 0)

    def detector(self, cell: Cell) -> Part:
        """The package, its active area the floor of a recess, in the cell's frame."""
        size = self.sizes.detector
        return slab(size.length, size.width, self._rear, size.surface_depth) - slab(*cell.area, 0, size.surface_depth + OVER)

    def board(self) -> Part:
        """The board behind the block, to which detector, amplifier and connector are soldered, in the block's frame."""
        size = self.sizes.block
        board = slab(2 * size.flange_half_width, 2 * size.flange_half_height, self._rear - size.board_thickness, self._rear)
        hole = rod(CLEARANCE["M2"] / 2, self._rear - size.board_thickness - OVER, self._rear + OVER)
        return _cut(board, [_at(*at, hole) for at in self._corners()])

    def cover(self) -> Part:
        """The cover over the board, open below for its cable, in the block's frame."""
        size = self.sizes.block
        top = self._rear - size.board_thickness
        bottom, x, y = top - size.cover_height, 2 * size.flange_half_width, 2 * size.flange_half_height
        inside = slab(x - 2 * size.cover_wall, y - 2 * size.cover_wall, bottom + size.cover_wall, top + OVER)
        cable = Pos(0, -y / 2, top - 2.0) * Box(6.0, 4 * size.cover_wall, 4.0 + OVER)
        # As wide as a post needs, and as long as joins it to the wall.
        post_y = 2 * (size.flange_half_height - size.cover_wall - size.ring_screw)
        posts = [_at(*at, slab(4.4, post_y, bottom, top)) for at in self._corners()]
        cover = slab(x, y, bottom, top) - inside
        for post in posts:
            cover += post
        hole = rod(CLEARANCE["M2"] / 2, bottom - OVER, top + OVER)
        return _cut(cover, [cable, *(_at(*at, hole) for at in self._corners())])

    # The ring, in the base frame.

    def _faces(self, distances: Iterable[float], directions: Iterable[Float], radius: float) -> Part:
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

    @property
    def flat(self) -> float:
        """Greatest distance of a flat of the ring from the base's z axis."""
        return max(self._flat(cell) for cell in self.layout.cells)

    def _flat(self, cell: Cell) -> float:
        return float(-(cell.detector @ cell.base_from_block[:, 2])) - self.flange_top

    @property
    def inner_radius(self) -> float:
        """Radius of the ring's bore: flush with the nearest seat of a mask."""
        return min(self._flat(cell) + self.flange_top - cell.seat for cell in self.layout.cells)

    @property
    def corner_radius(self) -> float:
        """Radius of the cylinder that cuts the ring's corners."""
        return self.flat / math.cos(math.pi / 6)

    @property
    def heights(self) -> tuple[float, float]:
        """Lower and upper end of the ring."""
        z = [float(cell.detector[2]) for cell in self.layout.cells]
        return min(z) - self.sizes.ring.half_height, max(z) + self.sizes.ring.half_height

    def corner_holes(self) -> list[tuple[float, float]]:
        """Places of three M3 screws between cells, above and below the ring."""
        towards = sorted(math.atan2(cell.detector[1], cell.detector[0]) for cell in self.layout.cells)
        between = [(a + b) / 2 for a, b in zip(towards, [*towards[1:], towards[0] + 2 * math.pi])]
        count = len(between)
        chosen = [between[round(third * count / 3) % count] for third in range(3)]
        half = math.pi / count
        outer = min(self.flat / math.cos(half), self.corner_radius)
        radius = 0.4 * self.inner_radius + 0.6 * outer
        return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in chosen]

    def ring(self) -> Part:
        """The base ring: flats with a bore, a dowel and two threads for each block, threads above and below."""
        size, block, (low, high) = self.sizes.ring, self.sizes.block, self.heights
        cells = self.layout.cells
        outline = self._faces([self._flat(cell) for cell in cells], [-cell.base_from_block[:, 2] for cell in cells], self.flat)
        body = Pos(0, 0, low) * extrude(outline, high - low)
        body = (body & rod(self.corner_radius, low, high)) - rod(self.inner_radius, low - OVER, high + OVER)
        tools = []
        for cell in cells:
            wall = self._flat(cell) - self.inner_radius
            top, deep = self.flange_top, self.flange_top + wall + block.barrel_radius
            holes = [
                rod(block.barrel_radius + block.bore_clearance, top - OVER, deep),
                *(_at(0, side * block.ring_screw, rod(THREAD["M2.5"] / 2, top - OVER, deep)) for side in (1, -1)),
                _at(-block.corner, block.ring_screw, rod(DOWEL / 2, top - OVER, top + 2.5)),
            ]
            tools += [hole.moved(location(cell.detector, cell.base_from_block)) for hole in holes]
        for at in self.corner_holes():
            tools.append(_at(*at, rod(THREAD["M3"] / 2, low - OVER, low + size.corner_depth)))
            tools.append(_at(*at, rod(THREAD["M3"] / 2, high - size.corner_depth, high + OVER)))
        return _cut(body, tools)

    @property
    def plate_radius(self) -> float:
        """Radius of the base plate."""
        return self.corner_radius + self.sizes.ring.plate_margin

    def plate_holes(self) -> list[tuple[float, float]]:
        """Places of three M4 screws that hold the head, at the angles of the M3 screws."""
        radius = self.plate_radius - self.sizes.ring.plate_screw_margin
        return [(radius * x / math.hypot(x, y), radius * y / math.hypot(x, y)) for x, y in self.corner_holes()]

    def base_plate(self) -> Part:
        """The plate under the ring. Its underside is datum A, its bore datum B."""
        top = self.heights[0]
        low = top - self.sizes.ring.plate_thickness
        head, height = COUNTERSUNK["M3"]
        hole = rod(CLEARANCE["M3"] / 2, low - OVER, top + OVER)
        countersink = Pos(0, 0, low + height / 2) * Cone(head / 2, CLEARANCE["M3"] / 2, height)
        return _cut(
            rod(self.plate_radius, low, top),
            [
                rod(self.inner_radius, low - OVER, top + OVER),
                *(_at(*at, hole + countersink) for at in self.corner_holes()),
                *(_at(*at, rod(CLEARANCE["M4"] / 2, low - OVER, top + OVER)) for at in self.plate_holes()),
            ],
        )

    # The tool, in the tool's frame.

    def emitter_flat(self, cell: Cell) -> float:
        """Distance of the board's seat from the tool's z axis."""
        size = self.sizes.emitter
        return float(cell.emitter @ cell.tool_from_emitter[:, 2]) - size.source_height - size.board_thickness

    @property
    def tool_heights(self) -> tuple[float, float]:
        """Lower and upper end of the emitter carrier."""
        z = [float(cell.emitter[2]) for cell in self.layout.cells]
        return min(z) - self.sizes.tool.half_height, max(z) + self.sizes.tool.half_height

    def tool_screws(self) -> list[tuple[float, float]]:
        """Places of three M2 screws of handle and tip, between emitters."""
        towards = sorted(math.atan2(cell.emitter[1], cell.emitter[0]) for cell in self.layout.cells)
        between = [(a + b) / 2 for a, b in zip(towards, [*towards[1:], towards[0] + 2 * math.pi])]
        chosen = [between[round(third * len(between) / 3) % len(between)] for third in range(3)]
        radius = self.sizes.tool.screw_radius
        return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in chosen]

    def carrier(self) -> Part:
        """The emitter carrier: a flat with a pocket for each emitter's board, around a bore for their wires."""
        size, emitter, (low, high) = self.sizes.tool, self.sizes.emitter, self.tool_heights
        cells = self.layout.cells
        flats = [self.emitter_flat(cell) for cell in cells]
        least = size.screw_radius + THREAD["M2"] / 2 + 0.8
        if min(flats) + emitter.pocket_depth < least:
            text = f"the emitters of {self.layout.scene.name!r} are {min(flats) + emitter.pocket_depth:.1f} mm from the axis at"
            raise ExportError(f"{text} the carrier's flats; it needs {least:.1f}: move them out, or make tool.screw_radius less")
        axes = [cell.tool_from_emitter[:, 2] for cell in cells]
        outline = self._faces([flat + emitter.pocket_depth for flat in flats], axes, max(flats))
        body = Pos(0, 0, low) * extrude(outline, high - low)
        tools = [rod(size.bore_radius, low - OVER, high + OVER)]
        x, y = (extent + 2 * emitter.clearance for extent in (emitter.board_width, emitter.board_length))
        for cell, flat in zip(cells, flats):
            depth = -emitter.source_height - emitter.board_thickness
            pocket = slab(x, y, depth, depth + emitter.pocket_depth + OVER)
            screw = rod(THREAD["M1.6"] / 2, depth - 3.5, depth + OVER)
            wires = rod(size.wire_hole_diameter / 2, depth - flat, depth + OVER)
            holes = [pocket, _at(0, -size.wire_hole_distance, wires)]
            holes += [_at(0, side * emitter.screw_distance, screw) for side in (1, -1)]
            tools += [hole.moved(location(cell.emitter, cell.tool_from_emitter)) for hole in holes]
        for at in self.tool_screws():
            tools.append(_at(*at, rod(THREAD["M2"] / 2, low - OVER, low + 3.0)))
            tools.append(_at(*at, rod(THREAD["M2"] / 2, high - 3.0, high + OVER)))
        return _cut(body, tools)

    def emitter_board(self) -> Part:
        """The small board of one emitter, in the emitter's frame."""
        size = self.sizes.emitter
        top, bottom = -size.source_height, -size.source_height - size.board_thickness
        hole = rod(CLEARANCE["M1.6"] / 2, bottom - OVER, top + OVER)
        board = slab(size.board_width, size.board_length, bottom, top)
        return _cut(board, [_at(0, side * size.screw_distance, hole) for side in (1, -1)])

    def emitter(self) -> Part:
        """The emitter, its chip the floor of a recess, in the emitter's frame."""
        size = self.sizes.emitter
        top = size.height - size.source_height
        package = slab(size.width, size.length, -size.source_height, top)
        return package - slab(size.source_size, size.source_size, 0, top + OVER)

    def emitter_screw(self) -> Part:
        """The head of an M1.6 screw on the emitter's board (ISO 7380-1: 0.9 high, 3.2 wide), in the emitter's frame."""
        return rod(1.6, -self.sizes.emitter.source_height, 0.9 - self.sizes.emitter.source_height)

    def _flange(self, z0: float, z1: float) -> Part:
        hole = rod(CLEARANCE["M2"] / 2, z0 - OVER, z1 + OVER)
        return _cut(rod(self.sizes.tool.flange_radius, z0, z1), [_at(*at, hole) for at in self.tool_screws()])

    def handle(self) -> Part:
        """The handle above the carrier, with a bore for the cable."""
        size, high = self.sizes.tool, self.tool_heights[1]
        top = high + size.flange_thickness
        handle = self._flange(high, top) + rod(size.handle_radius, top - OVER, size.handle_top)
        return handle - rod(size.bore_radius, high - OVER, size.handle_top + OVER)

    def tip(self) -> Part:
        """The tip below the carrier: a shaft, a cone and a ball whose centre is the tip."""
        size, low = self.sizes.tool, self.tool_heights[0]
        bottom, ball = low - size.flange_thickness, size.tip_z
        cone = ball + 10.0
        neck = 0.8 * size.tip_ball_radius
        tip = self._flange(bottom, low) + rod(size.tip_radius, cone, bottom + OVER)
        tip += Pos(0, 0, (cone + ball) / 2) * Cone(neck, size.tip_radius, cone - ball)
        return tip + Pos(0, 0, ball) * Sphere(size.tip_ball_radius)


def head(parts: HeadParts, poses: tuple[Float, Float]) -> list[Placed]:
    """All parts of a head in their places, with the tool at home; `poses` are those for which frames are open."""
    layout, sizes = parts.layout, parts.sizes
    made: dict[tuple[str, tuple[float, ...]], tuple[str, Part]] = {}
    openings = [parts.frame_opening(cell, layout.rays(cell.number, poses)) for cell in layout.cells]
    opening = tuple(np.array(openings).max(axis=0))

    def variant(name: str, cell: Cell, numbers: tuple[float, ...], make: Callable[[Cell], Part]) -> tuple[str, Part]:
        key = (name, numbers)
        if key not in made:
            letter = chr(ord("A") + sum(known == name for known, _ in made))
            made[key] = (f"{name} {letter}", make(cell))
        return made[key]

    placed = [Placed("base ring", parts.ring(), Location()), Placed("base plate", parts.base_plate(), Location(), away=(0, 0, -1))]
    board, cover, pin, emitter_board = parts.board(), parts.cover(), parts.pin(), parts.emitter_board()
    emitter, screw = parts.emitter(), parts.emitter_screw()
    for cell in layout.cells:
        number = cell.number
        base_from_block = location(cell.detector, cell.base_from_block)
        base_from_cell = location(cell.detector, cell.base_from_cell)
        out = -cell.base_from_block[:, 2]

        def away(steps: float, out: Float = out) -> tuple[float, float, float]:
            return float(out[0] * steps), float(out[1] * steps), 0.0

        def put(name: str, solid: Part, at: Location, steps: float, made_here: bool = True) -> None:
            placed.append(Placed(name, solid, at, number, made=made_here, away=away(steps)))

        put(*variant("cell block", cell, cell.block_variant, parts.block), base_from_block, 2.0)
        put(*variant("mask", cell, cell.mask_variant, parts.mask), base_from_cell, 1.1)
        put(*variant("mask frame", cell, cell.mask_variant, lambda of: parts.frame(of, opening)), base_from_cell, 0.8)
        top = cell.seat + cell.thickness + sizes.mask.frame_thickness
        for side in (1, -1):
            at = base_from_cell * Pos(side * sizes.mask.pin_distance, 0, top)
            put("mask pin", pin, at, 0.5, made_here=False)
        put("detector", parts.detector(cell), base_from_cell, 2.7, made_here=False)
        put("detector board", board, base_from_block, 3.2)
        put("cover", cover, base_from_block, 3.9)
    for cell in layout.cells:
        at = location(cell.emitter, cell.tool_from_emitter)
        out = cell.tool_from_emitter[:, 2]
        step = (float(out[0]) * 0.5, float(out[1]) * 0.5, 1.8)
        bought = {"on_tool": True, "made": False, "away": step}
        placed.append(Placed("emitter board", emitter_board, at, cell.number, on_tool=True, away=step))
        placed.append(Placed("emitter", emitter, at, cell.number, **bought))  # type: ignore[arg-type]
        for side in (1, -1):
            hole = at * Pos(0, side * sizes.emitter.screw_distance, 0)
            placed.append(Placed("screw M1.6x4", screw, hole, cell.number, **bought))  # type: ignore[arg-type]
    placed.append(Placed("emitter carrier", parts.carrier(), Location(), on_tool=True, away=(0, 0, 1.8)))
    placed.append(Placed("handle", parts.handle(), Location(), on_tool=True, away=(0, 0, 2.6)))
    placed.append(Placed("tip", parts.tip(), Location(), on_tool=True, away=(0, 0, 0.6)))
    return placed
