"""The parts of a head's tool: emitter carrier, emitters on their boards, handle and tip.

Each method makes one part in its own frame. Lengths are millimetres.
"""

from __future__ import annotations

from build123d import Cone, Part, Pos, Sphere, extrude

from .layout import Cell, Layout
from .sizes import ExportError, Sizes
from .solids import CLEARANCE, OVER, THREAD, cut, location, polygon, rod, shifted, slab, three_between


class ToolParts:
    """The parts of one head that move with its tool."""

    def __init__(self, layout: Layout, sizes: Sizes) -> None:
        self.layout = layout
        self.sizes = sizes

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
        return three_between([cell.emitter for cell in self.layout.cells], self.sizes.tool.screw_radius)

    def carrier(self) -> Part:
        """The emitter carrier: a flat with a pocket for each emitter's board, around a bore for their wires."""
        size, emitter, (low, high) = self.sizes.tool, self.sizes.emitter, self.tool_heights
        cells = self.layout.cells
        flats = [self.emitter_flat(cell) for cell in cells]
        least = size.screw_radius + THREAD["M2"] / 2 + 0.8
        if min(flats) + emitter.pocket_depth < least:
            text = (
                f"the emitters of {self.layout.scene.name!r} are {min(flats) + emitter.pocket_depth:.1f} mm from the"
                " axis at"
            )
            raise ExportError(
                f"{text} the carrier's flats; it needs {least:.1f}: move them out, or make tool.screw_radius less"
            )
        axes = [cell.tool_from_emitter[:, 2] for cell in cells]
        outline = polygon([flat + emitter.pocket_depth for flat in flats], axes, max(flats))
        body = Pos(0, 0, low) * extrude(outline, high - low)
        tools = [rod(size.bore_radius, low - OVER, high + OVER)]
        x, y = (extent + 2 * emitter.clearance for extent in (emitter.board_width, emitter.board_length))
        for cell, flat in zip(cells, flats):
            depth = -emitter.source_height - emitter.board_thickness
            pocket = slab(x, y, depth, depth + emitter.pocket_depth + OVER)
            screw = rod(THREAD["M1.6"] / 2, depth - emitter.thread_depth, depth + OVER)
            wires = rod(size.wire_hole_diameter / 2, depth - flat, depth + OVER)
            holes = [pocket, shifted(0, -size.wire_hole_distance, wires)]
            holes += [shifted(0, side * emitter.screw_distance, screw) for side in (1, -1)]
            tools += [hole.moved(location(cell.emitter, cell.tool_from_emitter)) for hole in holes]
        for at in self.tool_screws():
            tools.append(shifted(*at, rod(THREAD["M2"] / 2, low - OVER, low + size.thread_depth)))
            tools.append(shifted(*at, rod(THREAD["M2"] / 2, high - size.thread_depth, high + OVER)))
        return cut(body, tools)

    def emitter_board(self) -> Part:
        """The small board of one emitter, in the emitter's frame."""
        size = self.sizes.emitter
        top, bottom = -size.source_height, -size.source_height - size.board_thickness
        hole = rod(CLEARANCE["M1.6"] / 2, bottom - OVER, top + OVER)
        board = slab(size.board_width, size.board_length, bottom, top)
        return cut(board, [shifted(0, side * size.screw_distance, hole) for side in (1, -1)])

    def emitter(self) -> Part:
        """The emitter, its chip the floor of a recess, in the emitter's frame."""
        size = self.sizes.emitter
        top = size.height - size.source_height
        package = slab(size.width, size.length, -size.source_height, top)
        return package - slab(size.source_size, size.source_size, 0, top + OVER)

    def emitter_screw(self) -> Part:
        """The head of an M1.6 screw on the emitter's board (ISO 1580: 3.2 wide), in the emitter's frame."""
        size = self.sizes.emitter
        return rod(1.6, -size.source_height, size.screw_head - size.source_height)

    def _flange(self, z0: float, z1: float) -> Part:
        hole = rod(CLEARANCE["M2"] / 2, z0 - OVER, z1 + OVER)
        return cut(rod(self.sizes.tool.flange_radius, z0, z1), [shifted(*at, hole) for at in self.tool_screws()])

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
