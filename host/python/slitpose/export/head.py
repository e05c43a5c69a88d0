"""A head's parts in their places. Lengths are millimetres."""

from __future__ import annotations

import math
from typing import Callable

import numpy as np
from build123d import Location, Part, Pos

from .base_parts import BaseParts
from .layout import Cell, Float, Layout
from .sizes import Sizes
from .solids import Joint, Placed, location
from .tool_parts import ToolParts

#: An M2.5 may stand out of the ring's bore by this: the light passes 11 mm beside it, the tool 1 mm away.
MAX_PROTRUSION = 0.3


class HeadParts(BaseParts, ToolParts):
    """The parts of one head."""

    def __init__(self, layout: Layout, sizes: Sizes) -> None:
        BaseParts.__init__(self, layout, sizes)
        ToolParts.__init__(self, layout, sizes)

    @property
    def tip_room(self) -> tuple[float, float]:
        """Radius about z, and depth below the base plate, of the room that the tip needs over the workspace."""
        tool, (x, y, z, *turn) = self.sizes.tool, self.layout.workspace
        tilt = min(math.hypot(*turn[:2]), math.pi / 2)
        radius = math.hypot(x, y) - tool.tip_z * math.sin(tilt) + tool.tip_ball_radius
        return radius, max(self.plate_underside - tool.tip_z + float(z) + tool.tip_ball_radius, 0.0)

    @property
    def tip_opening(self) -> str:
        """The room of the tip in words."""
        radius, depth = self.tip_room
        return f"{math.ceil(2 * radius)} mm wide and {math.ceil(depth)} mm deep"

    def joints(self) -> list[Joint]:
        """The screws of the head, but for those that hold it."""
        block, emitter, ring, tool = self.sizes.block, self.sizes.emitter, self.sizes.ring, self.sizes.tool
        count, flange = len(self.layout.cells), self.flange_top - self.flange_rear
        wall = min(self.flat_of(cell) for cell in self.layout.cells) - self.inner_radius
        cover = block.cover_height + block.board_thickness + block.board_gap
        board, plate = emitter.board_thickness, ring.plate_thickness
        return [
            Joint("M2.5", 2 * count, "ISO 7046, countersunk, block to ring", flange, wall, -MAX_PROTRUSION),
            Joint("M2", 3 * count, "ISO 4762, cover and board to block", cover, flange),
            Joint("M3", 3, "ISO 7046, countersunk, base plate to ring", plate, ring.corner_depth),
            Joint("M2", 6, "ISO 4762, handle and tip to carrier", tool.flange_thickness, tool.thread_depth),
            Joint("M1.6", 2 * count, "ISO 1580, emitter board to carrier", board, emitter.thread_depth),
        ]


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

    placed = [
        Placed("base ring", parts.ring(), Location()),
        Placed("base plate", parts.base_plate(), Location(), away=(0, 0, -1)),
    ]
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
            placed.append(Placed("screw M1.6", screw, hole, cell.number, **bought))  # type: ignore[arg-type]
    placed.append(Placed("emitter carrier", parts.carrier(), Location(), on_tool=True, away=(0, 0, 1.8)))
    placed.append(Placed("handle", parts.handle(), Location(), on_tool=True, away=(0, 0, 2.6)))
    placed.append(Placed("tip", parts.tip(), Location(), on_tool=True, away=(0, 0, 0.6)))
    return placed
