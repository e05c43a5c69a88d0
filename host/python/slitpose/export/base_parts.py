"""The parts of a head's base: cell blocks, masks, boards and covers, the ring and its plate.

Each method makes one part in its own frame. Lengths are millimetres.
"""

from __future__ import annotations

import math

import numpy as np
from build123d import Box, Part, Pos, extrude

from .layout import Cell, Layout, Rays
from .sizes import ExportError, Sizes
from .solids import (
    CLEARANCE,
    DOWEL,
    OVER,
    THREAD,
    cut,
    location,
    polygon,
    rod,
    shifted,
    slab,
    sunk_hole,
    three_between,
    turned_about_z,
)


def _hull(cell: Cell, height: float) -> tuple[float, float]:
    """Half extents in x and y of the light between slit and active area, at a height above the area."""
    share = height / cell.distance
    (area_x, area_y), (slit_x, slit_y) = cell.area, cell.slit
    return (1 - share) * area_x / 2 + share * slit_x / 2, (1 - share) * area_y / 2 + share * slit_y / 2


class BaseParts:
    """The parts of one head that stay with its base."""

    def __init__(self, layout: Layout, sizes: Sizes) -> None:
        self.layout = layout
        self.sizes = sizes
        #: Height of the detector's back, on its board.
        self.rear = -(sizes.detector.height - sizes.detector.surface_depth)

    # The cell block and what it carries, in the block's frame.

    @property
    def flange_rear(self) -> float:
        """Height of the flange's face towards the board."""
        return self.rear + self.sizes.block.board_gap

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
        rear = self.flange_rear
        plate = cell.seat - size.plate
        if plate <= detector.surface_depth:
            text = f"cell {cell.number}: slit.distance_mm = {cell.distance:g} leaves no room for the plate of"
            raise ExportError(
                f"{text} {size.plate:g} mm that carries the mask; use {self.min_distance(cell):.2f} or more"
            )
        chamber, (slot_x, slot_y) = self.chamber_radius(cell), self.slot(cell)
        body = slab(2 * size.flange_half_width, 2 * size.flange_half_height, rear, self.flange_top)
        body += rod(size.barrel_radius, self.flange_top - OVER / 2, cell.seat)
        through = rear - OVER
        pocket_x, pocket_y = (extent + 2 * detector.clearance for extent in (detector.length, detector.width))
        hole = sunk_hole("M2.5", rear, self.flange_top, head=rear)
        turned = [
            slab(pocket_x, pocket_y, through, detector.surface_depth),
            shifted(cell.offset[0], cell.offset[1], slab(2 * slot_x, 2 * slot_y, plate - OVER, cell.seat + OVER)),
            *(shifted(side * mask.pin_distance, 0, self._pin_hole(plate - OVER, cell.seat + OVER)) for side in (1, -1)),
        ]
        return cut(
            body,
            [
                rod(chamber, detector.surface_depth - OVER / 2, plate),
                *(turned_about_z(cell.roll, tool) for tool in turned),
                *(shifted(0, side * size.ring_screw, hole) for side in (1, -1)),
                *(shifted(*at, rod(THREAD["M2"] / 2, through, self.flange_top + OVER)) for at in self._corners()),
                shifted(-size.corner, size.ring_screw, rod(DOWEL / 2, through, self.flange_top + OVER)),
            ],
        )

    def chamber_radius(self, cell: Cell) -> float:
        """Radius of the bore between mask and detector."""
        return math.hypot(cell.area[0] / 2, cell.area[1] / 2) + self.sizes.block.chamber_clearance

    def slot(self, cell: Cell) -> tuple[float, float]:
        """Half extents of the slot behind the mask, along the detector and across it."""
        size = self.sizes.block
        x, y = (extent + size.slot_clearance for extent in _hull(cell, cell.seat - size.plate))
        return x, max(y, cell.slit[1] / 2 + size.slot_clearance)

    def min_distance(self, cell: Cell) -> float:
        """Least distance from detector to mask for which a block can be made."""
        return self.sizes.detector.surface_depth + self.sizes.block.plate + 0.5 + cell.thickness / 2

    def _pin_hole(self, z0: float, z1: float) -> Part:
        return rod(self.sizes.mask.pin_diameter / 2, z0, z1)

    def mask(self, cell: Cell) -> Part:
        """The foil with its slit and two holes for pins, in the cell's frame."""
        size, top = self.sizes.mask, cell.seat + cell.thickness
        foil = rod(size.radius, cell.seat, top)
        slit = shifted(*cell.offset, slab(*cell.slit, cell.seat - OVER, top + OVER))
        holes = [shifted(side * size.pin_distance, 0, self._pin_hole(cell.seat - OVER, top + OVER)) for side in (1, -1)]
        return cut(foil, [slit, *holes])

    def frame_opening(self, cell: Cell, rays: Rays) -> tuple[float, float]:
        """Half extents of the frame's opening: the light's, over the workspace, with the slot's clearance."""
        size = self.sizes.mask
        front = cell.seat + cell.thickness + size.frame_thickness
        at = rays.end + (rays.start - rays.end) * (front / rays.start[:, 2])[:, None]
        x, y = np.maximum(np.abs(at[:, :2]).max(axis=0), np.abs(cell.offset) + np.array(cell.slit) / 2)
        clearance = self.sizes.block.slot_clearance
        half = float(x) + clearance, float(y) + clearance
        if half[0] > size.pin_distance - size.pin_diameter / 2 - 0.8 or half[1] > size.frame_radius - 0.8:
            text = (
                f"cell {cell.number}: the light needs an opening of {2 * half[0]:.1f} x {2 * half[1]:.1f} mm in the"
                " frame"
            )
            raise ExportError(
                f"{text} of the mask; use a smaller workspace, or a larger mask.frame_radius and pin_distance"
            )
        return half

    def frame(self, cell: Cell, opening: tuple[float, float]) -> Part:
        """The frame that presses the mask on its seat, in the cell's frame."""
        size, seat = self.sizes.mask, cell.seat + cell.thickness
        front = seat + size.frame_thickness
        tools = [
            slab(2 * opening[0], 2 * opening[1], seat - OVER, front + OVER),
            *(shifted(side * size.pin_distance, 0, self._pin_hole(seat - OVER, front + OVER)) for side in (1, -1)),
        ]
        return cut(rod(size.frame_radius, seat, front), tools)

    def pin(self) -> Part:
        """A pin of the mask; its upper end is its origin."""
        return rod(self.sizes.mask.pin_diameter / 2, -self.sizes.mask.pin_length, 0)

    def detector(self, cell: Cell) -> Part:
        """The package, its active area the floor of a recess, in the cell's frame."""
        size = self.sizes.detector
        return slab(size.length, size.width, self.rear, size.surface_depth) - slab(
            *cell.area, 0, size.surface_depth + OVER
        )

    def board(self) -> Part:
        """The board behind the block, to which detector, amplifier and connector are soldered, in the block's frame."""
        size = self.sizes.block
        board = slab(
            2 * size.flange_half_width, 2 * size.flange_half_height, self.rear - size.board_thickness, self.rear
        )
        hole = rod(CLEARANCE["M2"] / 2, self.rear - size.board_thickness - OVER, self.rear + OVER)
        return cut(board, [shifted(*at, hole) for at in self._corners()])

    def cover(self) -> Part:
        """The cover over the board, open below for its cable, in the block's frame."""
        size = self.sizes.block
        top = self.rear - size.board_thickness
        bottom, x, y = top - size.cover_height, 2 * size.flange_half_width, 2 * size.flange_half_height
        inside = slab(x - 2 * size.cover_wall, y - 2 * size.cover_wall, bottom + size.cover_wall, top + OVER)
        cable = Pos(0, -y / 2, top - 2.0) * Box(6.0, 4 * size.cover_wall, 4.0 + OVER)
        # As wide as a post needs, and as long as joins it to the wall.
        post_y = 2 * (size.flange_half_height - size.cover_wall - size.ring_screw)
        posts = [shifted(*at, slab(4.4, post_y, bottom, top)) for at in self._corners()]
        cover = slab(x, y, bottom, top) - inside
        for post in posts:
            cover += post
        hole = rod(CLEARANCE["M2"] / 2, bottom - OVER, top + OVER)
        return cut(cover, [cable, *(shifted(*at, hole) for at in self._corners())])

    # The ring, in the base frame.
    @property
    def flat(self) -> float:
        """Greatest distance of a flat of the ring from the base's z axis."""
        return max(self.flat_of(cell) for cell in self.layout.cells)

    def flat_of(self, cell: Cell) -> float:
        """Distance of a cell's flat from the base's z axis."""
        return float(-(cell.detector @ cell.base_from_block[:, 2])) - self.flange_top

    @property
    def inner_radius(self) -> float:
        """Radius of the ring's bore: flush with the nearest seat of a mask."""
        return min(self.flat_of(cell) + self.flange_top - cell.seat for cell in self.layout.cells)

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
        cells = self.layout.cells
        outer = min(self.flat / math.cos(math.pi / len(cells)), self.corner_radius)
        return three_between([cell.detector for cell in cells], 0.4 * self.inner_radius + 0.6 * outer)

    def ring(self) -> Part:
        """The base ring: flats with a bore, a dowel and two threads for each block, threads above and below."""
        size, block, (low, high) = self.sizes.ring, self.sizes.block, self.heights
        cells = self.layout.cells
        outline = polygon(
            [self.flat_of(cell) for cell in cells], [-cell.base_from_block[:, 2] for cell in cells], self.flat
        )
        body = Pos(0, 0, low) * extrude(outline, high - low)
        body = (body & rod(self.corner_radius, low, high)) - rod(self.inner_radius, low - OVER, high + OVER)
        tools = []
        for cell in cells:
            wall = self.flat_of(cell) - self.inner_radius
            top, deep = self.flange_top, self.flange_top + wall + block.barrel_radius
            holes = [
                rod(block.barrel_radius + block.bore_clearance, top - OVER, deep),
                *(shifted(0, side * block.ring_screw, rod(THREAD["M2.5"] / 2, top - OVER, deep)) for side in (1, -1)),
                shifted(-block.corner, block.ring_screw, rod(DOWEL / 2, top - OVER, top + block.dowel_depth)),
            ]
            tools += [hole.moved(location(cell.detector, cell.base_from_block)) for hole in holes]
        for at in self.corner_holes():
            tools.append(shifted(*at, rod(THREAD["M3"] / 2, low - OVER, low + size.corner_depth)))
            tools.append(shifted(*at, rod(THREAD["M3"] / 2, high - size.corner_depth, high + OVER)))
        return cut(body, tools)

    @property
    def plate_radius(self) -> float:
        """Radius of the base plate."""
        return self.corner_radius + self.sizes.ring.plate_margin

    def plate_holes(self) -> list[tuple[float, float]]:
        """Places of three M4 screws that hold the head, at the angles of the M3 screws."""
        radius = self.plate_radius - self.sizes.ring.plate_screw_margin
        return three_between([cell.detector for cell in self.layout.cells], radius)

    @property
    def plate_underside(self) -> float:
        """Height of datum A, on which the head stands."""
        return self.heights[0] - self.sizes.ring.plate_thickness

    def base_plate(self) -> Part:
        """The plate under the ring. Its underside is datum A, its bore datum B."""
        low, top = self.plate_underside, self.heights[0]
        hole = sunk_hole("M3", low, top, head=low)
        return cut(
            rod(self.plate_radius, low, top),
            [
                rod(self.inner_radius, low - OVER, top + OVER),
                *(shifted(*at, hole) for at in self.corner_holes()),
                *(shifted(*at, rod(CLEARANCE["M4"] / 2, low - OVER, top + OVER)) for at in self.plate_holes()),
            ],
        )
