"""A drawing sheet as SVG: views of solids with visible and hidden edges, dimensions, leaders and datums.

Lengths are millimetres on the part; a view is drawn at its scale. First-angle projection.
"""

from __future__ import annotations

import dataclasses
import textwrap
from html import escape
from typing import Sequence

import numpy as np
from build123d import Edge, GeomType, Part

from .layout import Float

TEXT = 3.0
ARROW = 2.2
GAP = 1.0
#: Characters in a line of notes, left of the title.
NOTE_WIDTH = 125
#: Far enough to see every part in parallel projection, mm.
FAR = 1000.0
GENERAL = "ISO 2768-mK; edges broken 0.2; inner corners R 0.5, relieved where a part sits in them; unit mm"


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

    def text(
        self, x: float, y: float, text: str, anchor: str = "middle", turn: float = 0.0, size: float = TEXT
    ) -> None:
        """Text with its base line at (x, y)."""
        rotate = f' transform="rotate({turn:g} {x:.2f} {y:.2f})"' if turn else ""
        style = f'font-size="{size:g}" text-anchor="{anchor}"'
        self.parts.append(f'<text x="{x:.2f}" y="{y:.2f}" {style}{rotate}>{escape(text)}</text>')

    def svg(self) -> str:
        """The whole sheet."""
        w, h = self.width, self.height
        box = w - 165, h - 42
        rows = [
            self.title,
            self.material,
            GENERAL,
            "Designed, not built: no part of this drawing has been made or measured.",
        ]
        for row, text in enumerate(rows):
            self.text(box[0] + 3, box[1] + 8 + 8 * row, text, "start", size=5 if row == 0 else TEXT)
        for row, text in enumerate(reversed(textwrap.wrap(" ".join(self.notes).replace(" +-", "\xa0+-"), NOTE_WIDTH))):
            self.text(14, h - 14 - 5 * row, text, "start")
        frame = f'<rect class="frame" x="8" y="8" width="{w - 16}" height="{h - 16}"/>'
        title = f'<rect class="frame" x="{box[0]}" y="{box[1]}" width="{w - 8 - box[0]}" height="{h - 8 - box[1]}"/>'
        style = (
            "polyline,rect,circle{fill:none;stroke:#111}.visible{stroke-width:.35}.hidden{stroke-width:.18;stroke-dasharray:1.6"
            " .8;stroke:#666}.thin{stroke-width:.15}.centre{stroke-width:.15;stroke-dasharray:5 1 1"
            " 1}.frame{stroke-width:.5}text{font-family:sans-serif;fill:#111}.arrow{fill:#111;stroke:none}"
        )
        head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{w:g}mm" height="{h:g}mm" viewBox="0 0 {w:g} {h:g}">'
        white = f'<rect x="0" y="0" width="{w:g}" height="{h:g}" style="fill:#fff;stroke:none"/>'
        return "\n".join([head, f"<style>{style}</style>", white, frame, title, *self.parts, "</svg>"]) + "\n"


class Projection:
    """One view of a solid on a sheet. Places are given in the view's plane, mm of the part, y up."""

    def __init__(
        self,
        sheet: Sheet,
        solid: Part,
        eye: Sequence[float],
        up: Sequence[float],
        at: tuple[float, float],
        scale: float,
        name: str = "",
        hidden: bool = True,
        below: float = 22.0,
    ) -> None:
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
        self._dimension((x0, y0), (x1, y0), (x0, y), (x1, y), text or number(abs(x1 - x0)), 0.0)

    def along(self, y0: float, y1: float, x0: float, x: float, text: str = "") -> None:
        """A vertical dimension between y0 and y1 at x (view), with extension lines from x0."""
        self._dimension((x0, y0), (x0, y1), (x, y0), (x, y1), text or number(abs(y1 - y0)), -90.0)

    def _dimension(
        self,
        from_a: tuple[float, float],
        from_b: tuple[float, float],
        a: tuple[float, float],
        b: tuple[float, float],
        text: str,
        turn: float,
    ) -> None:
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
        beyond = 3 + 0.28 * TEXT * len(text)
        if turn:
            x, y = start[0] - 0.8, middle[1] if fits else min(start[1], end[1]) - beyond
        else:
            x, y = middle[0] if fits else max(start[0], end[0]) + beyond, start[1] - 0.8
        sheet.text(float(x), float(y), text, turn=turn)

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
        self.sheet.parts.append(
            f'<rect class="thin" x="{end[0] - 2.5:.2f}" y="{end[1] - 2.5:.2f}" width="5" height="5" style="fill:#fff"/>'
        )
        self.sheet.text(float(end[0]), float(end[1] + 1.2), letter, size=3.5)
        self._arrow(tip, (end - tip) / np.linalg.norm(end - tip))


def _polyline(edge: Edge) -> list[tuple[float, float]]:
    """Points of a projected edge. By its parameter: edges seen from their end have no length to divide."""
    curve = edge.geom_adaptor()
    count = 2 if edge.geom_type == GeomType.LINE else 97
    places = [curve.Value(at) for at in np.linspace(curve.FirstParameter(), curve.LastParameter(), count)]
    return [(place.X(), place.Y()) for place in places]


def number(value: float) -> str:
    """A number with three decimals at most, without zeros at its end."""
    return f"{round(value, 3) + 0.0:.3f}".rstrip("0").rstrip(".")


def numbers(values: Sequence[float]) -> str:
    """Values of cells: one number if all are equal, else all of them."""
    shown = [number(value) for value in values]
    return shown[0] if len(set(shown)) == 1 else f"{', '.join(shown)} (cells 0 to {len(shown) - 1})"


def _ratio(scale: float) -> str:
    return f"{scale:g}:1" if scale >= 1 else f"1:{1 / scale:g}"
