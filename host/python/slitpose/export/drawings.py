"""Dimensioned drawings of the parts that are made: fits, datums, and tolerances of what places the optics."""

from __future__ import annotations

import math

import numpy as np
from build123d import Box, GeomType, Part, Pos

from .head import HeadParts
from .layout import Cell
from .sheet import Projection, Sheet, numbers
from .sheet import number as n
from .solids import CLEARANCE, COUNTERSINK, DOWEL, THREAD

#: Of the box that cuts a part in half, mm.
HALF = 500.0
FRONT, TOP, BACK = ((0, -1, 0), (0, 0, 1)), ((0, 0, 1), (0, 1, 0)), ((0, 0, -1), (0, 1, 0))
RIGHT = ((1, 0, 0), (0, 0, 1))


def block_sheet(parts: HeadParts, cell: Cell, name: str, solid: Part, material: str) -> Sheet:
    """The cell block: from the tool, from behind, and from its side."""
    size, detector, mask = parts.sizes.block, parts.sizes.detector, parts.sizes.mask
    rear = parts.flange_rear
    roll, (slot_x, slot_y) = math.degrees(cell.roll), parts.slot(cell)
    sheet = Sheet(
        f"{name} (turned {roll:+.4g} deg)",
        material,
        (
            "Seat of the mask (C) and the detector's shoulder (floor of the pocket) parallel to D within 0.02; their",
            (
                f"distance, {n(cell.seat - detector.surface_depth)} +-0.02, sets d_B = {n(cell.distance)}. Barrel (B)"
                f" square to D within 0.02. Bore {n(2 * parts.chamber_radius(cell))} from the shoulder to"
                f" {n(size.plate)} under C;"
            ),
            (
                f"slot {n(2 * slot_x)} x {n(2 * slot_y)} from there through C. Pocket, slot and pin holes symmetrical"
                " to B within"
            ),
            (
                f"0.02; length of the pocket turned {roll:+.4g} deg, within 0.1, from the width of the flange, positive"
                " anticlockwise seen from the tool. Inside faces matt black."
            ),
        ),
    )
    half_x, half_y = size.flange_half_width, size.flange_half_height
    tool = Projection(sheet, solid, *TOP, at=(80, 105), scale=3, name="from the tool", hidden=False)
    tool.across(-half_x, half_x, -half_y, -half_y - 3)
    tool.along(-half_y, half_y, -half_x, -half_x - 9)
    tool.along(-size.ring_screw, size.ring_screw, -half_x, -half_x - 5)
    tool.across(-size.corner, size.corner, half_y, half_y + 3)
    pin = np.array([math.cos(cell.roll), math.sin(cell.roll)]) * mask.pin_distance
    tool.leader(
        -pin[0], -pin[1], 16, -80, f"2x {mask.pin_diameter:g} H7 through, {n(2 * mask.pin_distance)} +-0.01 apart"
    )
    tool.leader(
        -size.barrel_radius * 0.43,
        -size.barrel_radius * 0.9,
        -12,
        -78,
        f"B: barrel {n(2 * size.barrel_radius)} g6",
    )
    tool.leader(-size.corner, size.ring_screw, -14, 26, f"dowel {DOWEL:g} H7")
    tool.leader(size.corner, size.ring_screw, 14, 26, "3x M2")
    behind = Projection(sheet, solid, *BACK, at=(185, 105), scale=3, name="from behind", hidden=False)
    for end in (1, -1):
        behind.centre(0, end * size.ring_screw, COUNTERSINK["M2.5"] / 2)
    behind.leader(
        0,
        -size.ring_screw - CLEARANCE["M2.5"] / 2,
        14,
        -46,
        f"2x {CLEARANCE['M2.5']}, sunk {COUNTERSINK['M2.5']:g} x 90 deg for M2.5",
    )
    pocket = (
        f"pocket {n(detector.length + 2 * detector.clearance)} x {n(detector.width + 2 * detector.clearance)}, deep"
        f" {n(detector.surface_depth - rear)}"
    )
    along = np.array([-math.cos(cell.roll), math.sin(cell.roll)]) * (detector.length / 2)
    behind.leader(float(along[0]), float(along[1]), -8 if along[0] < 0 else 8, 52, pocket)
    cut = solid & (Pos(-HALF, 0, 0) * Box(2 * HALF, 2 * HALF, 2 * HALF))
    side = Projection(sheet, cut, *RIGHT, at=(325, 125), scale=4, name="section through the middle", hidden=False)
    side.along(rear, parts.flange_top, half_y, half_y + 4)
    side.along(rear, cell.seat, -half_y, -half_y - 4)
    side.along(
        detector.surface_depth, cell.seat, -half_y, -half_y - 8, f"{n(cell.seat - detector.surface_depth)} +-0.02"
    )
    side.across(-size.barrel_radius, size.barrel_radius, cell.seat, cell.seat + 4)
    side.datum(-half_y + 2, parts.flange_top, 0, 8, "D")
    side.datum(size.barrel_radius, (parts.flange_top + cell.seat) / 2, 14, 0, "B")
    side.datum(5.8, cell.seat, 0, 30, "C")
    return sheet


def frame_sheet(parts: HeadParts, cell: Cell, name: str, solid: Part, material: str) -> Sheet:
    """The frame of a mask."""
    size = parts.sizes.mask
    sheet = Sheet(
        name,
        material,
        ("Opening symmetrical to the pin holes within 0.05. Pressed on its pins, with a drop of adhesive on each.",),
    )
    front = Projection(sheet, solid, *TOP, at=(130, 130), scale=8, name="from the tool", hidden=False)
    front.across(-size.frame_radius, size.frame_radius, -size.frame_radius, -size.frame_radius - 1.5)
    front.leader(
        size.pin_distance, 0.0, 50, 10, f"2x {size.pin_diameter:g} P7, {n(2 * size.pin_distance)} +-0.01 apart"
    )
    # The opening is the only long straight edge.
    straight = [
        edge for edge in solid.edges() if edge.geom_type == GeomType.LINE and edge.length > 2 * size.frame_thickness
    ]
    reach = np.array([tuple(edge.position_at(end)) for edge in straight for end in (0.0, 1.0)]).max(axis=0)
    front.across(-float(reach[0]), float(reach[0]), float(reach[1]), size.frame_radius + 1.5)
    front.along(-float(reach[1]), float(reach[1]), -float(reach[0]), -size.frame_radius - 1.5)
    side = Projection(sheet, solid, *FRONT, at=(310, 180), scale=8, name="from the side")
    seat = cell.seat + cell.thickness
    side.along(seat, seat + size.frame_thickness, size.frame_radius, size.frame_radius + 2)
    return sheet


def mask_sheet(parts: HeadParts, cell: Cell, name: str, solid: Part, material: str) -> Sheet:
    """The mask, with the tolerances that its DXF has."""
    size = parts.sizes.mask
    sheet = Sheet(
        name,
        material,
        (
            (
                f"Foil {cell.thickness:g} +-{0.1 * cell.thickness:.3f}, blackened on both sides, flat within 0.02. The"
                " pins turn it with its block."
            ),
            (
                "Datum A-B: the line through the middles of the pin holes. For laser or etching from the DXF of the"
                " same name."
            ),
        ),
    )
    view = Projection(sheet, solid, *TOP, at=(160, 130), scale=10, name="from the tool", hidden=False, below=36)
    radius, (w, length), (x, y) = size.radius, cell.slit, cell.offset
    view.across(x - w / 2, x + w / 2, y + length / 2, radius + 1.2, f"{n(w)} +-{size.slit_width_tolerance:g}")
    view.along(y - length / 2, y + length / 2, x + w / 2, radius + 2, f"{n(length)} +-0.05")
    view.across(-size.pin_distance, size.pin_distance, 0, -radius - 1.2, f"{n(2 * size.pin_distance)} +-0.01")
    view.across(-radius, radius, 0, -radius - 2.4, f"{n(2 * radius)} +-0.05")
    view.across(
        -size.pin_distance, x, 0, radius + 2.4, f"{n(x + size.pin_distance)} +-{size.slit_position_tolerance:g}"
    )
    view.datum(-size.pin_distance - size.pin_diameter / 2, 0, -30, 0, "A")
    view.datum(size.pin_distance + size.pin_diameter / 2, 0, 45, 0, "B")
    view.leader(-size.pin_distance, -size.pin_diameter / 2, -24, -16, f"2x {size.pin_diameter:g} +0.02/0")
    return sheet


def ring_sheet(parts: HeadParts, solid: Part, material: str) -> Sheet:
    """The base ring: from above, and one of its flats."""
    cells, size, block = parts.layout.cells, parts.sizes.ring, parts.sizes.block
    low, high = parts.heights
    sheet = Sheet(
        "base ring",
        material,
        (
            (
                "Datum A: lower face. Datum B: bore. Each flat is one cell, its bore at the middle of the cell: above A"
                f" by {numbers([cell.detector[2] - low for cell in cells])}, z ="
                f" {numbers([cell.detector[2] for cell in cells])} of the scene."
            ),
            "Bores: position within 0.02 to A and B. Flats: distance to B's axis +-0.02, square to A within 0.02.",
        ),
    )
    scale = 2.0
    top = Projection(sheet, solid, *TOP, at=(120, 115), scale=scale, name="from above", hidden=False, below=26)
    radius = parts.inner_radius
    top.across(-radius, radius, 0, -parts.corner_radius - 5, f"B: {n(2 * radius)} H8")
    first = cells[0]
    outward = -first.base_from_block[:, 2]
    flat = parts.flat_of(first)
    top.leader(
        float(outward[0] * flat),
        float(outward[1] * flat),
        22,
        12,
        f"{len(cells)} flats at {numbers([parts.flat_of(cell) for cell in cells])} from the axis of B",
    )
    x, y = parts.corner_holes()[0]
    top.centre(x, y, THREAD["M3"] / 2)
    top.leader(x, y, 70, 10, f"3x M3 x {size.corner_depth:g}, above and below, radius {n(math.hypot(x, y))}")
    view = Projection(
        sheet,
        solid,
        tuple(outward),
        (0, 0, 1),
        at=(310, 115),
        scale=scale,
        name="flat of cell 0",
        hidden=False,
        below=26,
    )
    middle = float(first.detector[2])
    side = -parts.corner_radius
    view.along(low, high, side, side - 9)
    view.along(low, middle, 0, side - 4)
    view.leader(
        block.barrel_radius * 0.7,
        middle + block.barrel_radius * 0.7,
        40,
        8,
        f"{n(2 * (block.barrel_radius + block.bore_clearance))} H7",
    )
    view.leader(0, middle - block.ring_screw, 30, -24, f"2x M2.5 through, {n(2 * block.ring_screw)} apart")
    view.leader(
        block.corner,
        middle + block.ring_screw,
        24,
        26,
        f"dowel {DOWEL:g} H7 x {n(block.dowel_depth)}, {n(block.corner)} from the middle",
    )
    view.datum(-12, low, 0, -14, "A")
    return sheet


def jig_notes(parts: HeadParts) -> dict[str, tuple[str, ...]]:
    """Notes for the drawings of the jig's parts."""
    jig, tool = parts.sizes.jig, parts.sizes.tool
    screws = (
        f"3x {CLEARANCE['M3']:g} sunk {COUNTERSINK['M3']:g} x 90 deg from above for M3, at radius"
        f" {n(math.hypot(*parts.corner_holes()[0]))}"
    )
    pins = f"fence: 2 dowels {n(2 * jig.pin_radius)} at (+-{n(jig.fence_spread)}, -{n(jig.nest_flat + jig.pin_radius)})"
    stop = f"stop: 1 at (-{n(jig.nest_flat + jig.block + jig.pin_radius)}, 0)"
    return {
        "jig deck": (
            f"{screws}. Top flat within 0.05. Dowels m6 in holes H7: {pins} +-0.02; {stop} +-0.02.",
            f"Opening {n(2 * (tool.handle_radius + jig.opening + jig.steps))}.",
        ),
        "jig nest": (
            (
                f"Three vees of 90 deg at 90, 210 and 330 deg, apex {n(jig.vee_depth)} +-0.05 below the top, smooth."
                f" Flats at {n(jig.nest_flat)} +-0.05, straight within 0.02,"
            ),
            (
                "square to each other within 0.02. The underside slides on the deck. Bore"
                f" {n(2 * (tool.handle_radius + jig.opening))}."
            ),
        ),
        "jig ball plate": (
            (
                f"Three holes {n(2 * jig.ball_radius)} H7 at radius {n(jig.ball_circle)}, for balls"
                f" {n(2 * jig.ball_radius)} G10, bonded; deep until the balls stand out by"
                f" {n(jig.ball_plate_gap + jig.vee_depth - (math.sqrt(2.0) - 1.0) * jig.ball_radius)}."
            ),
            f"Bore {n(2 * (tool.handle_radius + jig.clamp_clearance))}; two M3 towards it at 30 and 150 deg.",
        ),
        "jig foot": (
            (
                f"Cone of {n(2 * jig.cone_half_angle_deg)} deg, smooth, for the tip's ball of"
                f" {n(2 * tool.tip_ball_radius)}. 3x {CLEARANCE['M4']:g} at radius"
                f" {n(math.hypot(*parts.plate_holes()[0]))}."
            ),
            (
                f"Plate {n(jig.foot_thickness)} thick, boss {n(2 * jig.foot_boss_radius)}. Any place will do:"
                " calibration finds where the tip rests."
            ),
        ),
    }


def other_sheet(parts: HeadParts, name: str, solid: Part, material: str) -> Sheet:
    """Any other part: two views with overall dimensions, and notes for its holes."""
    sizes, block = parts.sizes, parts.sizes.block
    screw = f"3x M2 at radius {n(sizes.tool.screw_radius)}, at 120 deg, between emitters"
    corner = (
        f"3x {CLEARANCE['M2']:g} at ({n(block.corner)}, +-{n(block.ring_screw)}) and ({-block.corner:g},"
        f" {-block.ring_screw:g}) from the middle"
    )
    emitter, cells, carrier = sizes.emitter, parts.layout.cells, parts.tool_heights[0]
    heights = [float(cell.emitter[2]) for cell in cells]
    plate = math.hypot(*parts.corner_holes()[0]), math.hypot(*parts.plate_holes()[0])
    notes: dict[str, tuple[str, ...]] = {
        "base plate": (
            (
                f"Bore {n(2 * parts.inner_radius)} H8 (datum B), underside datum A, flat within 0.05. At three angles"
                " of 120 deg:"
            ),
            (
                f"{CLEARANCE['M3']:g} sunk {COUNTERSINK['M3']:g} x 90 deg from below at radius {n(plate[0])} (M3);"
                f" {CLEARANCE['M4']:g} through at radius {n(plate[1])} (M4)."
            ),
        ),
        "cover": (f"Wall {n(block.cover_wall)}; posts 4.4 wide with {corner}. Opening for the cable 6 wide.",),
        "detector board": (
            f"Outline and holes of the board: {corner}.",
            "The detector's middle is the board's middle; it is turned as the pocket of its block.",
        ),
        "emitter board": (
            (
                f"2x {CLEARANCE['M1.6']:g} at +-{n(emitter.screw_distance)} from the middle, which is the emitter's;"
                " emitter along the board's length."
            ),
            "Outline +-0.05: it locates the emitter in its pocket. Emitter's middle to the outline +-0.05.",
        ),
        "emitter carrier": (
            (
                "Seats of the boards (floors of the pockets), from the axis:"
                f" {numbers([parts.emitter_flat(cell) for cell in cells])}, each +-0.02, square to A within 0.02."
            ),
            (
                f"Pocket {n(emitter.board_width + 2 * emitter.clearance)} x"
                f" {n(emitter.board_length + 2 * emitter.clearance)} H9, deep {n(emitter.pocket_depth)}, its middle above A"
                f" by {numbers([height - carrier for height in heights])}, z = {numbers(heights)} of the scene;"
            ),
            (
                f"in it 2x M1.6 x {n(emitter.thread_depth)} at +-{n(emitter.screw_distance)}, and {n(sizes.tool.wire_hole_diameter)} to the"
                f" bore, {n(sizes.tool.wire_hole_distance)} below the middle."
            ),
            f"Above and below: {screw}, {n(sizes.tool.thread_depth)} deep. Bore {n(2 * sizes.tool.bore_radius)} (datum B), lower face datum A.",
        ),
        "handle": (
            (
                f"Flange {n(2 * sizes.tool.flange_radius)} x {n(sizes.tool.flange_thickness)} with {screw}: through"
                f" {CLEARANCE['M2']:g}."
            ),
            f"Tube {n(2 * sizes.tool.handle_radius)} h9, bore {n(2 * sizes.tool.bore_radius)}.",
        ),
        "tip": (
            (
                f"Flange {n(2 * sizes.tool.flange_radius)} x {n(sizes.tool.flange_thickness)} with {screw}: through"
                f" {CLEARANCE['M2']:g}."
            ),
            (
                f"Shaft {n(2 * sizes.tool.tip_radius)}; cone over the last 10 before the ball's middle, to"
                f" {n(1.6 * sizes.tool.tip_ball_radius)}."
            ),
            (
                f"Ball {n(2 * sizes.tool.tip_ball_radius)} +-0.01, its centre at z = {sizes.tool.tip_z:g} of the tool's"
                f" frame (--tip 0,0,{sizes.tool.tip_z:g})."
            ),
        ),
        **jig_notes(parts),
    }
    box = solid.bounding_box()
    reach = max(box.size.X, box.size.Y, box.size.Z)
    scale = next((ratio for ratio in (8.0, 5.0, 4.0, 3.0, 2.0, 1.5, 1.0) if ratio * reach < 160.0), 1.0)
    sheet = Sheet(name, material, notes.get(name, ()))
    above = ("from above", TOP, box.min.Y, box.max.Y)
    x0, x1 = box.min.X, box.max.X
    for number, (title, eye, y0, y1) in enumerate((above, ("from the side", FRONT, box.min.Z, box.max.Z))):
        at = (115 + 190 * number - (x0 + x1) / 2 * scale, 115 + (y0 + y1) / 2 * scale)
        view = Projection(sheet, solid, *eye, at, scale, title)
        view.across(x0, x1, y0, y0 - 8 / scale)
        view.along(y0, y1, x0, x0 - 8 / scale)
    return sheet
