"""Dimensioned drawings of parts as SVG: views with visible and hidden edges, dimensions, datums, tolerances.

Lengths are millimetres on the part; the sheet is drawn at `scale`. First-angle projection.
"""

from __future__ import annotations

import dataclasses
import math
from html import escape
from typing import Sequence

import numpy as np
from build123d import Box, Edge, GeomType, Part, Pos

from .head import CLEARANCE, COUNTERSUNK, THREAD, HeadParts
from .layout import Cell, Float

TEXT = 3.0
ARROW = 2.2
GAP = 1.0
#: Far enough to see every part in parallel projection, mm.
FAR = 1000.0
#: Of the box that cuts a part in half, mm.
HALF = 500.0
GENERAL = "ISO 2768-mK; edges broken 0.2; unit mm"


@dataclasses.dataclass
class Sheet:
    """An A3 sheet; its frame and title are drawn with it."""

    title: str
    material: str
    notes: Sequence[str] = ()
    width: float = 420.0
    height: float = 297.0
    parts: list[str] = dataclasses.field(default_factory=list)

    def line(self, points: Sequence[tuple[float, float]], style: str) -> None:
        """A polyline in sheet coordinates, y down."""
        path = " ".join(f"{x:.3f},{y:.3f}" for x, y in points)
        self.parts.append(f'<polyline class="{style}" points="{path}"/>')

    def text(self, x: float, y: float, text: str, anchor: str = "middle", turn: float = 0.0, size: float = TEXT) -> None:
        """Text with its base line at (x, y)."""
        rotate = f' transform="rotate({turn:g} {x:.2f} {y:.2f})"' if turn else ""
        style = f'font-size="{size:g}" text-anchor="{anchor}"'
        self.parts.append(f'<text x="{x:.2f}" y="{y:.2f}" {style}{rotate}>{escape(text)}</text>')

    def svg(self) -> str:
        """The whole sheet."""
        w, h = self.width, self.height
        box = w - 150, h - 42
        rows = [self.title, self.material, GENERAL, "Designed, not built: no part of this drawing has been made or measured."]
        for row, text in enumerate(rows):
            self.text(box[0] + 3, box[1] + 8 + 8 * row, text, "start", size=5 if row == 0 else TEXT)
        for row, text in enumerate(self.notes):
            self.text(14, h - 14 - 5 * (len(self.notes) - 1 - row), text, "start")
        frame = f'<rect class="frame" x="8" y="8" width="{w - 16}" height="{h - 16}"/>'
        title = f'<rect class="frame" x="{box[0]}" y="{box[1]}" width="{w - 8 - box[0]}" height="{h - 8 - box[1]}"/>'
        style = (
            "polyline,rect,circle{fill:none;stroke:#111}.visible{stroke-width:.35}.hidden{stroke-width:.18;stroke-dasharray:1.6 .8;"
            "stroke:#666}.thin{stroke-width:.15}.centre{stroke-width:.15;stroke-dasharray:5 1 1 1}.frame{stroke-width:.5}"
            "text{font-family:sans-serif;fill:#111}.arrow{fill:#111;stroke:none}"
        )
        head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{w:g}mm" height="{h:g}mm" viewBox="0 0 {w:g} {h:g}">'
        white = f'<rect x="0" y="0" width="{w:g}" height="{h:g}" style="fill:#fff;stroke:none"/>'
        return "\n".join([head, f"<style>{style}</style>", white, frame, title, *self.parts, "</svg>"]) + "\n"


class Projection:
    """One view of a solid on a sheet. Places are given in the view's plane, mm of the part, y up."""

    def __init__(self, sheet: Sheet, solid: Part, eye: Sequence[float], up: Sequence[float], at: tuple[float, float], scale: float, name: str = "", hidden: bool = True, below: float = 22.0) -> None:
        self.sheet, self.at, self.scale = sheet, at, scale
        direction = np.array(eye, dtype=float)
        visible, behind = solid.project_to_viewport(tuple(direction * FAR), tuple(up), (0, 0, 0))
        for style, edges in (("hidden", behind if hidden else []), ("visible", visible)):
            for edge in edges:
                sheet.line([self.place(x, y) for x, y in _polyline(edge)], style)
        if name:
            x, y = self.place(0, min(y for edge in visible for _, y in _polyline(edge)))
            sheet.text(x, y + below, f"{name}  {_ratio(scale)}", size=4)

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Where a place of the view is on the sheet."""
        return self.at[0] + x * self.scale, self.at[1] - y * self.scale

    def centre(self, x: float, y: float, radius: float) -> None:
        """The centre lines of a hole."""
        reach = radius + 1.5 / self.scale
        self.sheet.line([self.place(x - reach, y), self.place(x + reach, y)], "centre")
        self.sheet.line([self.place(x, y - reach), self.place(x, y + reach)], "centre")

    def across(self, x0: float, x1: float, y0: float, y: float, text: str = "") -> None:
        """A horizontal dimension between x0 and x1 at y (view), with extension lines from y0."""
        self._dimension((x0, y0), (x1, y0), (x0, y), (x1, y), text or _number(x1 - x0), 0.0)

    def along(self, y0: float, y1: float, x0: float, x: float, text: str = "") -> None:
        """A vertical dimension between y0 and y1 at x (view), with extension lines from x0."""
        self._dimension((x0, y0), (x0, y1), (x, y0), (x, y1), text or _number(y1 - y0), -90.0)

    def _dimension(self, from_a: tuple[float, float], from_b: tuple[float, float], a: tuple[float, float], b: tuple[float, float], text: str, turn: float) -> None:
        sheet = self.sheet
        start, end = self.place(*a), self.place(*b)
        for origin, tip in ((from_a, start), (from_b, end)):
            base = np.array(self.place(*origin))
            run = np.array(tip) - base
            length = float(np.linalg.norm(run))
            if length > GAP:
                unit = run / length
                sheet.line([tuple(base + GAP * unit), tuple(np.array(tip) + 1.2 * unit)], "thin")
        sheet.line([start, end], "thin")
        span = np.array(end) - np.array(start)
        length = float(np.linalg.norm(span))
        unit = span / length if length else np.array([1.0, 0.0])
        inward = 1.0 if length > 3 * ARROW else -1.0
        self._arrow(np.array(start), inward * unit)
        self._arrow(np.array(end), -inward * unit)
        middle = (np.array(start) + np.array(end)) / 2
        fits = length > 0.55 * TEXT * len(text) + 2 * ARROW
        if turn:
            at = middle + np.array([-0.8, 0.0]) if fits else np.array([start[0] - 0.8, min(start[1], end[1]) - 3 - 0.28 * TEXT * len(text)])
            sheet.text(float(at[0]), float(at[1]), text, turn=turn)
        else:
            at = middle + np.array([0.0, -0.8]) if fits else np.array([max(start[0], end[0]) + 3 + 0.28 * TEXT * len(text), start[1] - 0.8])
            sheet.text(float(at[0]), float(at[1]), text)

    def _arrow(self, tip: Float, direction: Float) -> None:
        side = np.array([-direction[1], direction[0]])
        corners = [tip, tip + ARROW * direction + ARROW / 6 * side, tip + ARROW * direction - ARROW / 6 * side]
        path = " ".join(f"{x:.3f},{y:.3f}" for x, y in corners)
        self.sheet.parts.append(f'<polygon class="arrow" points="{path}"/>')

    def leader(self, x: float, y: float, dx: float, dy: float, text: str) -> None:
        """A note with an arrow to (x, y); (dx, dy) leads to it in sheet millimetres, y up."""
        tip = np.array(self.place(x, y))
        knee = tip + np.array([dx, -dy])
        side = 1.0 if dx >= 0 else -1.0
        self.sheet.line([tuple(tip), tuple(knee), (float(knee[0] + 4 * side), float(knee[1]))], "thin")
        length = float(np.linalg.norm(knee - tip))
        self._arrow(tip, (knee - tip) / length)
        self.sheet.text(float(knee[0] + 5 * side), float(knee[1] + 1), text, "start" if side > 0 else "end")

    def datum(self, x: float, y: float, dx: float, dy: float, letter: str) -> None:
        """A datum letter in a box, at the end of a line from (x, y)."""
        tip = np.array(self.place(x, y))
        end = tip + np.array([dx, -dy])
        self.sheet.line([tuple(tip), tuple(end)], "thin")
        self.sheet.parts.append(f'<rect class="thin" x="{end[0] - 2.5:.2f}" y="{end[1] - 2.5:.2f}" width="5" height="5" style="fill:#fff"/>')
        self.sheet.text(float(end[0]), float(end[1] + 1.2), letter, size=3.5)
        self._arrow(tip, (end - tip) / np.linalg.norm(end - tip))


def _polyline(edge: Edge) -> list[tuple[float, float]]:
    """Points of a projected edge. By its parameter: edges seen from their end have no length to divide."""
    curve = edge.geom_adaptor()
    count = 2 if edge.geom_type == GeomType.LINE else 97
    places = [curve.Value(at) for at in np.linspace(curve.FirstParameter(), curve.LastParameter(), count)]
    return [(place.X(), place.Y()) for place in places]


def _number(value: float) -> str:
    return f"{abs(value):.3f}".rstrip("0").rstrip(".")


def _ratio(scale: float) -> str:
    return f"{scale:g}:1" if scale >= 1 else f"1:{1 / scale:g}"


FRONT, TOP, BACK = ((0, -1, 0), (0, 0, 1)), ((0, 0, 1), (0, 1, 0)), ((0, 0, -1), (0, 1, 0))
RIGHT = ((1, 0, 0), (0, 0, 1))


def block_sheet(parts: HeadParts, cell: Cell, name: str, solid: Part, material: str) -> Sheet:
    """The cell block: from the tool, from behind, and from its side."""
    size, detector, mask = parts.sizes.block, parts.sizes.detector, parts.sizes.mask
    rear = -(detector.height - detector.surface_depth) + size.board_gap
    roll = math.degrees(cell.roll)
    sheet = Sheet(
        f"{name} ({_number(roll)} deg)",
        material,
        (
            f"Seat of the mask (C) parallel to the detector's shoulder (A) within 0.02; distance {_number(cell.seat - detector.surface_depth)} +-0.02",
            f"sets d_B = {_number(cell.distance)}. Barrel (B) square to the flange within 0.02. Pocket, slot and pin holes symmetrical to B within 0.02,",
            f"turned by {_number(roll)} +-0.1 deg against the line of the M2.5 holes. All inside faces matt black.",
        ),
    )
    half_x, half_y = size.flange_half_width, size.flange_half_height
    tool = Projection(sheet, solid, *TOP, at=(80, 105), scale=3, name="from the tool", hidden=False)
    tool.across(-half_x, half_x, -half_y, -half_y - 3)
    tool.along(-half_y, half_y, -half_x, -half_x - 9)
    tool.along(-size.ring_screw, size.ring_screw, -half_x, -half_x - 5)
    tool.across(-size.corner, size.corner, half_y, half_y + 3)
    pin = np.array([math.cos(cell.roll), math.sin(cell.roll)]) * mask.pin_distance
    tool.leader(-pin[0], -pin[1], 16, -80, f"2x {mask.pin_diameter:g} H7 through, {_number(2 * mask.pin_distance)} +-0.01 apart")
    tool.leader(-size.barrel_radius * 0.43, -size.barrel_radius * 0.9, -12, -78, f"B: barrel {_number(2 * size.barrel_radius)} g6")
    tool.leader(-size.corner, size.ring_screw, -14, 26, "dowel 2 H7")
    tool.leader(size.corner, size.ring_screw, 14, 26, "3x M2")
    behind = Projection(sheet, solid, (0, 0, -1), (0, 1, 0), at=(185, 105), scale=3, name="from behind", hidden=False)
    for end in (1, -1):
        behind.centre(0, end * size.ring_screw, COUNTERSUNK["M2.5"][0] / 2)
    behind.leader(0, -size.ring_screw - CLEARANCE["M2.5"] / 2, 14, -46, f"2x {CLEARANCE['M2.5']}, sunk {COUNTERSUNK['M2.5'][0]:g} for M2.5")
    pocket = f"pocket {_number(detector.length + 2 * detector.clearance)} x {_number(detector.width + 2 * detector.clearance)}, deep {_number(detector.surface_depth - rear)}"
    along = np.array([-math.cos(cell.roll), math.sin(cell.roll)]) * (detector.length / 2)
    behind.leader(float(along[0]), float(along[1]), -8 if along[0] < 0 else 8, 52, pocket)
    cut = solid & (Pos(-HALF, 0, 0) * Box(2 * HALF, 2 * HALF, 2 * HALF))
    side = Projection(sheet, cut, *RIGHT, at=(325, 125), scale=4, name="section through the middle", hidden=False)
    side.along(rear, parts.flange_top, half_y, half_y + 4)
    side.along(rear, cell.seat, -half_y, -half_y - 4)
    side.along(detector.surface_depth, cell.seat, -half_y, -half_y - 8, f"{_number(cell.seat - detector.surface_depth)} +-0.02")
    side.across(-size.barrel_radius, size.barrel_radius, cell.seat, cell.seat + 4)
    side.datum(-half_y + 2, parts.flange_top, 0, 8, "D")
    side.datum(size.barrel_radius, (parts.flange_top + cell.seat) / 2, 14, 0, "B")
    side.datum(5.8, cell.seat, 0, 30, "C")
    return sheet


def frame_sheet(parts: HeadParts, cell: Cell, name: str, solid: Part, material: str) -> Sheet:
    """The frame of a mask."""
    size = parts.sizes.mask
    sheet = Sheet(name, material, (f"Opening symmetrical to the pin holes within 0.05. Pressed on its pins, with a drop of adhesive on each.",))
    front = Projection(sheet, solid, *TOP, at=(130, 130), scale=8, name="from the tool", hidden=False)
    front.across(-size.frame_radius, size.frame_radius, -size.frame_radius, -size.frame_radius - 1.5)
    front.leader(size.pin_distance, 0.0, 50, 10, f"2x {size.pin_diameter:g} P7, {_number(2 * size.pin_distance)} +-0.01 apart")
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
            f"Foil {cell.thickness:g} +-{0.1 * cell.thickness:.3f}, blackened on both sides, flat within 0.02. The pins turn it with its block.",
            "Datum A-B: the line through the middles of the pin holes. For laser or etching from the DXF of the same name.",
        ),
    )
    view = Projection(sheet, solid, *TOP, at=(160, 130), scale=10, name="from the tool", hidden=False, below=36)
    radius, (w, length), (x, y) = size.radius, cell.slit, cell.offset
    view.across(x - w / 2, x + w / 2, y + length / 2, radius + 1.2, f"{_number(w)} +-{size.slit_width_tolerance:g}")
    view.along(y - length / 2, y + length / 2, x + w / 2, radius + 2, f"{_number(length)} +-0.05")
    view.across(-size.pin_distance, size.pin_distance, 0, -radius - 1.2, f"{_number(2 * size.pin_distance)} +-0.01")
    view.across(-radius, radius, 0, -radius - 2.4, f"{_number(2 * radius)} +-0.05")
    view.across(-size.pin_distance, x, 0, radius + 2.4, f"{_number(x + size.pin_distance)} +-{size.slit_position_tolerance:g}")
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
            "Datum A: lower face. Datum B: bore. Each flat is one cell; its bore is at the middle of the cell, at height 0 of the scene.",
            "Bores: position within 0.02 to A and B. Flats: distance to B's axis +-0.02, square to A within 0.02.",
        ),
    )
    scale = 2.0
    top = Projection(sheet, solid, *TOP, at=(120, 115), scale=scale, name="from above", hidden=False, below=26)
    radius = parts.inner_radius
    top.across(-radius, radius, 0, -parts.corner_radius - 5, f"B: {_number(2 * radius)} H8")
    first = cells[0]
    outward = -first.base_from_block[:, 2]
    flat = -float(first.detector @ first.base_from_block[:, 2]) - parts.flange_top
    top.leader(float(outward[0] * flat), float(outward[1] * flat), 22, 12, f"{len(cells)} flats at {_number(flat)} from B (cell 0)")
    x, y = parts.corner_holes()[0]
    top.centre(x, y, THREAD["M3"] / 2)
    top.leader(x, y, 70, 10, f"3x M3 x {size.corner_depth:g}, above and below, radius {_number(math.hypot(x, y))}")
    view = Projection(sheet, solid, tuple(outward), (0, 0, 1), at=(310, 115), scale=scale, name="flat of cell 0", hidden=False, below=26)
    middle = float(first.detector[2])
    side = -parts.flat / math.cos(math.pi / 6)
    view.along(low, high, side, side - 9)
    view.along(low, middle, 0, side - 4)
    view.leader(block.barrel_radius * 0.7, middle + block.barrel_radius * 0.7, 40, 8, f"{_number(2 * (block.barrel_radius + block.bore_clearance))} H7")
    view.leader(0, middle - block.ring_screw, 30, -24, f"2x M2.5 through, {_number(2 * block.ring_screw)} apart")
    view.leader(block.corner, middle + block.ring_screw, 24, 26, f"dowel 2 H7 x 2.5, {_number(block.corner)} from the middle")
    view.datum(-12, low, 0, -14, "A")
    return sheet


def jig_notes(parts: HeadParts) -> dict[str, tuple[str, ...]]:
    """Notes for the drawings of the jig's parts."""
    jig, tool = parts.sizes.jig, parts.sizes.tool
    screws = f"3x {CLEARANCE['M3']:g} sunk {COUNTERSUNK['M3'][0]:g} from above for M3, at radius {_number(math.hypot(*parts.corner_holes()[0]))}"
    pins = f"fence: 2 dowels {_number(2 * jig.pin_radius)} at (+-{_number(jig.fence_spread)}, -{_number(jig.nest_flat + jig.pin_radius)})"
    stop = f"stop: 1 at (-{_number(jig.nest_flat + jig.block + jig.pin_radius)}, 0)"
    return {
        "jig deck": (f"{screws}. Top flat within 0.05. Dowels m6 in holes H7: {pins} +-0.02; {stop} +-0.02.", f"Opening {_number(2 * (tool.handle_radius + jig.opening + jig.steps))}."),
        "jig nest": (
            f"Three vees of 90 deg at 90, 210 and 330 deg, apex {_number(jig.vee_depth)} +-0.05 below the top, smooth. Flats at {_number(jig.nest_flat)} +-0.05, straight within 0.02,",
            f"square to each other within 0.02. The underside slides on the deck. Bore {_number(2 * (tool.handle_radius + jig.opening))}.",
        ),
        "jig ball plate": (
            f"Three holes {_number(2 * jig.ball_radius)} H7 at radius {_number(jig.ball_circle)}, for balls {_number(2 * jig.ball_radius)} G10, bonded; deep until the balls stand out by {_number(jig.ball_plate_gap + jig.vee_depth - (math.sqrt(2.0) - 1.0) * jig.ball_radius)}.",
            f"Bore {_number(2 * (tool.handle_radius + jig.clamp_clearance))}; two M3 towards it at 30 and 150 deg.",
        ),
        "jig foot": (
            f"Cone of {_number(2 * jig.cone_half_angle_deg)} deg, smooth, for the tip's ball of {_number(2 * tool.tip_ball_radius)}. 3x {CLEARANCE['M4']:g} at radius {_number(math.hypot(*parts.plate_holes()[0]))}.",
            f"Plate {_number(jig.foot_thickness)} thick, boss {_number(2 * jig.foot_boss_radius)}. Any place will do: calibration finds where the tip rests.",
        ),
    }


def other_sheet(parts: HeadParts, name: str, solid: Part, material: str) -> Sheet:
    """Any other part: two views with overall dimensions, and notes for its holes."""
    sizes, block = parts.sizes, parts.sizes.block
    screw = f"3x M2 at radius {_number(sizes.tool.screw_radius)}, at 120 deg, between emitters"
    corner = f"3x {CLEARANCE['M2']:g} at ({_number(block.corner)}, +-{_number(block.ring_screw)}) and ({-block.corner:g}, {-block.ring_screw:g}) from the middle"
    flats = ", ".join(_number(parts.emitter_flat(cell)) for cell in parts.layout.cells)
    emitter = sizes.emitter
    plate = math.hypot(*parts.corner_holes()[0]), math.hypot(*parts.plate_holes()[0])
    notes: dict[str, tuple[str, ...]] = {
        "base plate": (
            f"Bore {_number(2 * parts.inner_radius)} H8 (datum B), underside datum A, flat within 0.05. At three angles of 120 deg:",
            f"{CLEARANCE['M3']:g} sunk {COUNTERSUNK['M3'][0]:g} from below at radius {_number(plate[0])} (M3); {CLEARANCE['M4']:g} through at radius {_number(plate[1])} (M4).",
        ),
        "cover": (f"Wall {_number(block.cover_wall)}; posts 4.4 wide with {corner}. Opening for the cable 6 wide.",),
        "detector board": (f"Outline and holes of the board: {corner}.", "The detector's middle is the board's middle; it is turned as the pocket of its block."),
        "emitter board": (
            f"2x {CLEARANCE['M1.6']:g} at +-{_number(emitter.screw_distance)} from the middle, which is the emitter's; emitter along the board's length.",
            "Outline +-0.05: it locates the emitter in its pocket. Emitter's middle to the outline +-0.05.",
        ),
        "emitter carrier": (
            f"Seats of the boards (floors of the pockets), from the axis, cells 0 to {len(parts.layout.cells) - 1}: {flats}, each +-0.02, square to A within 0.02.",
            f"Pocket {_number(emitter.board_width + 2 * emitter.clearance)} x {_number(emitter.board_length + 2 * emitter.clearance)} H9, deep {_number(emitter.pocket_depth)}, its middle at the emitter's height (0 of the scene);",
            f"in it 2x M1.6 x 3.5 at +-{_number(emitter.screw_distance)}, and {_number(sizes.tool.wire_hole_diameter)} to the bore, {_number(sizes.tool.wire_hole_distance)} below the middle.",
            f"Above and below: {screw}, 3 deep. Bore {_number(2 * sizes.tool.bore_radius)} (datum B), lower face datum A.",
        ),
        "handle": (
            f"Flange {_number(2 * sizes.tool.flange_radius)} x {_number(sizes.tool.flange_thickness)} with {screw}: through {CLEARANCE['M2']:g}.",
            f"Tube {_number(2 * sizes.tool.handle_radius)} h9, bore {_number(2 * sizes.tool.bore_radius)}.",
        ),
        "tip": (
            f"Flange {_number(2 * sizes.tool.flange_radius)} x {_number(sizes.tool.flange_thickness)} with {screw}: through {CLEARANCE['M2']:g}.",
            f"Shaft {_number(2 * sizes.tool.tip_radius)}; cone over the last 10 before the ball's middle, to {_number(1.6 * sizes.tool.tip_ball_radius)}.",
            f"Ball {_number(2 * sizes.tool.tip_ball_radius)} +-0.01, its centre at z = {sizes.tool.tip_z:g} of the tool's frame (--tip 0,0,{sizes.tool.tip_z:g}).",
        ),
        **jig_notes(parts),
    }
    box = solid.bounding_box()
    eyes = (("from above", TOP), ("from the side", FRONT))
    reach = max(box.size.X, box.size.Y, box.size.Z)
    scale = next((ratio for ratio in (8.0, 5.0, 4.0, 3.0, 2.0, 1.5, 1.0) if ratio * reach < 160.0), 1.0)
    sheet = Sheet(name, material, notes.get(name, ()))
    for number, (title, (eye, up)) in enumerate(eyes):
        corners = np.array([(x, y, z) for x in (box.min.X, box.max.X) for y in (box.min.Y, box.max.Y) for z in (box.min.Z, box.max.Z)])
        flat = np.stack([corners @ np.cross(up, eye), corners @ np.array(up)], axis=1)
        (x0, y0), (x1, y1) = (tuple(float(number) for number in corner) for corner in (flat.min(axis=0), flat.max(axis=0)))
        at = (115 + 190 * number - (x0 + x1) / 2 * scale, 115 + (y0 + y1) / 2 * scale)
        view = Projection(sheet, solid, eye, up, at, scale, title)
        view.across(x0, x1, y0, y0 - 8 / scale)
        view.along(y0, y1, x0, x0 - 8 / scale)
    return sheet
