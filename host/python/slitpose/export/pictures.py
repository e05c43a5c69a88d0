"""Pictures of solids as PNG: shaded, with their edges, and with the names of parts. Drawn by the processor alone.

Orthographic views. Lengths are millimetres.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Callable

import numpy as np
from build123d import Align, Box, Part, Pos, Rot
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from .checks import mesh
from .layout import Float
from .solids import Placed

Projection = Callable[[Float], Float]

#: Red, green, blue of each part, by the first of its name.
COLOURS = {
    "base ring": (148, 163, 184),
    "base plate": (100, 116, 139),
    "cell block": (96, 165, 250),
    "mask frame": (45, 212, 191),
    "mask pin": (234, 179, 8),
    "mask": (250, 204, 21),
    "detector board": (34, 139, 87),
    "detector": (226, 232, 240),
    "cover": (71, 85, 105),
    "emitter board": (34, 139, 87),
    "emitter carrier": (251, 146, 60),
    "emitter": (254, 240, 138),
    "screw": (203, 213, 225),
    "handle": (244, 114, 94),
    "tip": (190, 80, 70),
    "jig": (167, 139, 250),
    "ball": (226, 232, 240),
    "gauge": (234, 179, 8),
}
SUPERSAMPLING = 2
MARGIN = 0.06
EDGE_STEP = 0.5
AMBIENT = 0.45
MESH_CHORD = 0.05
MESH_ANGLE = 0.35
EDGE = (30, 41, 59)
#: Of boxes that cut everything away on one side, mm.
SIZE = 1000.0


@dataclasses.dataclass(frozen=True)
class View:
    """Where a picture is seen from.

    :ivar azimuth_deg: of the eye, from x towards y.
    :ivar elevation_deg: of the eye above the x-y plane.
    """

    azimuth_deg: float = -60.0
    elevation_deg: float = 25.0

    @property
    def axes(self) -> Float:
        """Rows: right, up, towards the eye."""
        a, e = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        eye = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        right = np.array([-math.sin(a), math.cos(a), 0.0])
        return np.stack([right, np.cross(eye, right), eye])


@dataclasses.dataclass(frozen=True, eq=False)
class Drawn:
    """A solid in its place, its colour, and the name that a leader gives it."""

    solid: Part
    colour: tuple[int, int, int]
    label: str = ""


def colour(name: str) -> tuple[int, int, int]:
    """The colour of a part."""
    return next((rgb for start, rgb in COLOURS.items() if name.startswith(start)), (200, 200, 200))


def exploded(placed: list[Placed], step: float) -> list[Drawn]:
    """Parts moved apart by `step` for each unit of their direction; the first instance of each part is named."""
    named: set[str] = set()
    drawn = []
    for part in placed:
        moved = part.in_place.moved(Pos(*(step * along for along in part.away)))
        drawn.append(Drawn(moved, colour(part.name), "" if part.name in named else part.name))
        named.add(part.name)
    return drawn


def section(placed: list[Placed], azimuth: float, only_from: float = -SIZE) -> list[Drawn]:
    """Parts with one side of the vertical plane at `azimuth` (rad) cut away, turned so that it is the plane y = 0, and
    named where they are cut; only what reaches farther than `only_from` along the plane.
    """
    front = Pos(only_from, -SIZE / 2, 0) * Box(2 * SIZE, SIZE, SIZE, align=(Align.MIN, Align.CENTER, Align.CENTER))
    beside = Pos(only_from, 0, 0) * Box(SIZE, 2 * SIZE, SIZE, align=(Align.MAX, Align.CENTER, Align.CENTER))
    named: set[str] = set()
    drawn = []
    for part in placed:
        solid = part.in_place.moved(Rot(0, 0, -math.degrees(azimuth)))
        box = solid.bounding_box()
        if box.max.Y <= 0.0 or box.max.X <= only_from:
            continue
        is_cut = box.min.Y < 0.0 and part.name not in named
        solid = solid - front if box.min.Y < 0.0 else solid
        solid = solid - beside if box.min.X < only_from else solid
        drawn.append(Drawn(solid, colour(part.name), part.name if is_cut else ""))
        named |= {part.name} if is_cut else set()
    return drawn


def render(drawn: list[Drawn], view: View, path: Path, width: int = 1400, height: int = 1000) -> None:
    """Draws solids, with names at the sides, and writes the PNG."""
    axes = view.axes
    meshes = [mesh(item.solid, MESH_CHORD, MESH_ANGLE) for item in drawn]
    points = [body.vertices @ axes.T for body in meshes]
    low = np.min([place.min(axis=0) for place in points], axis=0)
    high = np.max([place.max(axis=0) for place in points], axis=0)
    side = 210 if any(item.label for item in drawn) else 0
    free = np.array([width - 2 * side, height]) * (1 - 2 * MARGIN)
    scale = float((free / (high - low)[:2]).min()) * SUPERSAMPLING
    centre = (low + high) / 2
    size = np.array([width, height]) * SUPERSAMPLING

    def pixels(places: Float) -> Float:
        moved = (places - centre) * scale
        return np.stack([size[0] / 2 + moved[:, 0], size[1] / 2 - moved[:, 1], moved[:, 2]], axis=1)

    image = np.full((size[1], size[0], 3), 255, dtype=np.uint8)
    depth = np.full((size[1], size[0]), -np.inf)
    for item, body, place in zip(drawn, meshes, points):
        lit = AMBIENT + (1 - AMBIENT) * np.clip(body.face_normals @ (axes.T @ [0.35, 0.5, 0.8]), 0, 1)
        shades = np.clip(lit[:, None] * np.array(item.colour), 0, 255).astype(np.uint8)
        towards = body.face_normals @ axes[2]
        corners = pixels(place)[body.faces]
        for triangle, shade in zip(corners[towards > 0], shades[towards > 0]):
            _fill(image, depth, triangle, shade)
    for item in drawn:
        _edges(image, depth, item.solid, axes, pixels)
    picture = Image.fromarray(image).resize((width, height), Image.Resampling.LANCZOS)
    _labels(picture, drawn, points, pixels, depth)
    picture.save(path, optimize=True)


def _fill(image: NDArray[np.uint8], depth: Float, corners: Float, shade: NDArray[np.uint8]) -> None:
    """One triangle, nearer than what is there."""
    x0, y0 = np.maximum(np.floor(corners[:, :2].min(axis=0)).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(corners[:, :2].max(axis=0)).astype(int) + 1, np.array(depth.shape)[::-1])
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if x1 <= x0 or y1 <= y0 or area == 0.0:
        return
    x = np.arange(x0, x1)[None, :] + 0.5
    y = np.arange(y0, y1)[:, None] + 0.5
    second = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
    third = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
    z = az + second * (bz - az) + third * (cz - az)
    part = depth[y0:y1, x0:x1]
    inside = (second >= 0) & (third >= 0) & (second + third <= 1) & (z > part)
    part[inside] = z[inside]
    image[y0:y1, x0:x1][inside] = shade


def _edges(image: NDArray[np.uint8], depth: Float, solid: Part, axes: Float, pixels: Projection) -> None:
    """The edges of a solid where nothing hides them."""
    for edge in solid.edges():
        count = max(int(edge.length / EDGE_STEP), 1) + 1
        if edge.geom_type.name == "LINE":
            ends = np.array([tuple(edge.position_at(at)) for at in (0.0, 1.0)])
            places = ends
        else:
            places = np.array([tuple(point) for point in edge.positions(np.linspace(0, 1, min(count, 60) + 4))])
        drawn = pixels(places @ axes.T)
        for a, b in zip(drawn[:-1], drawn[1:]):
            steps = int(np.abs(b - a)[:2].max()) + 1
            line = a + (b - a) * np.linspace(0, 1, steps + 1)[:, None]
            x, y = np.round(line[:, 0] - 0.5).astype(int), np.round(line[:, 1] - 0.5).astype(int)
            shown = (x > 0) & (y > 0) & (x < depth.shape[1] - 1) & (y < depth.shape[0] - 1)
            x, y, z = x[shown], y[shown], line[shown, 2]
            near = z >= depth[y, x] - 3.0
            image[y[near], x[near]] = EDGE


def _labels(picture: Image.Image, drawn: list[Drawn], points: list[Float], pixels: Projection, depth: Float) -> None:
    """Names in two columns, with leaders to a visible place of their parts; none for parts that are hidden."""
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(size=20)
    named = []
    for item, place in zip(drawn, points):
        if item.label:
            at = pixels(place)
            column, row = (np.clip(at[:, axis].astype(int), 0, depth.shape[1 - axis] - 1) for axis in (0, 1))
            chosen = at[at[:, 2] >= depth[row, column] - 4.0]
            if not len(chosen):
                continue
            middle = chosen[np.argmin(np.abs(chosen[:, :2] - np.median(chosen[:, :2], axis=0)).sum(axis=1))]
            named.append((item.label, middle[:2] / SUPERSAMPLING))
    named.sort(key=lambda entry: entry[1][0])
    half = (len(named) + 1) // 2
    for column, entries in ((0, named[:half]), (1, named[half:])):
        entries = sorted(entries, key=lambda entry: entry[1][1])
        for number, (label, at) in enumerate(entries):
            y = picture.height * (number + 1) / (len(entries) + 1)
            width = pen.textlength(label, font=font)
            x = 12 if column == 0 else picture.width - 12 - width
            start = (x + width + 6, y) if column == 0 else (x - 6, y)
            pen.line([start, tuple(at)], fill=EDGE, width=1)
            pen.ellipse([at[0] - 3, at[1] - 3, at[0] + 3, at[1] + 3], fill=EDGE)
            pen.text((x, y - 12), label, fill=EDGE, font=font)
