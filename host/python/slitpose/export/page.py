"""The assembly page: pictures, parts, steps and checks of one head, as HTML."""

from __future__ import annotations

import dataclasses
import math
from html import escape
from pathlib import Path
from typing import Sequence

from .checks import MIN_GAP, MIN_WALL, Clearance, Light
from .files import Item
from .head import HeadParts
from .jig import JigParts
from .solids import DOWEL

STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:64em;margin:2em auto;padding:0"
    " 1em;color:#1e293b}img{max-width:100%}table{border-collapse:collapse}td,th{border:1px solid #cbd5e1;padding:.2em"
    " .6em;text-align:left;vertical-align:top}.note{background:#fef9c3;padding:.6em 1em}"
)


@dataclasses.dataclass(frozen=True)
class Findings:
    """What the checks of a head found.

    :ivar faults: solids that are not closed.
    :ivar overlaps: pairs of parts that share volume.
    :ivar walls: thinnest wall of each part that is made, foils aside, mm.
    """

    faults: list[str]
    overlaps: list[str]
    walls: dict[str, float]
    clearance: Clearance
    light: Light

    @property
    def failures(self) -> list[str]:
        """What keeps the head from being made, with the next step."""
        found = [f"{fault}: a size of --sizes makes this part impossible" for fault in self.faults]
        found += [f"{pair} overlap: change one of their sizes with --sizes" for pair in self.overlaps]
        found += [
            f"{name} has a wall of {wall:.2f} mm; {MIN_WALL} is the minimum"
            for name, wall in self.walls.items()
            if wall < MIN_WALL - 0.01
        ]
        if self.clearance.least < MIN_GAP:
            x, y, z = self.clearance.worst
            where = (
                f"the tool touches the housing at {self.clearance.colliding} of {self.clearance.poses} poses; least"
                f" distance {self.clearance.least:.2f} mm, {MIN_GAP} is the minimum, at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
            )
            found.append(
                f"{where}; use a smaller [workspace] in the scene, or shorter tool.half_height and emitter.board_length"
            )
        if self.light.blocked:
            parts = ", ".join(self.light.by)
            found.append(
                f"{self.light.blocked} of {self.light.rays} rays meet {parts}; use a smaller [workspace], or larger"
                " clearances"
            )
        return found

    def rows(self) -> list[tuple[str, str]]:
        """As a table."""
        least = min(self.walls, key=lambda name: self.walls[name])
        clearance = self.clearance
        return [
            ("solids closed and valid", "all" if not self.faults else "; ".join(self.faults)),
            ("parts that share volume, tool at home", "none" if not self.overlaps else "; ".join(self.overlaps)),
            ("thinnest wall", f"{self.walls[least]:.2f} mm ({least})"),
            (
                "tool against housing",
                (
                    f"{clearance.colliding} of {clearance.poses} poses of the workspace touch; least distance"
                    f" {clearance.least:.2f} mm"
                ),
            ),
            (
                "light from emitters through slits to detectors",
                f"{self.light.blocked} of {self.light.rays} rays meet a part",
            ),
        ]


def steps(parts: HeadParts) -> list[str]:
    """How the head is assembled."""
    sizes, count = parts.sizes, len(parts.layout.cells)
    return [
        "Blacken all inside faces: reflected light displaces the measured spot.",
        (
            "Lay a mask on the seat of its cell block; the table of cells lists which. Press two pins of"
            f" {sizes.mask.pin_diameter:g} mm through the mask's frame, the mask and the block, flush with the frame, and"
            " put a drop of adhesive on each."
        ),
        (
            "Solder the detector to its board, flat, and turned like the pocket of its block. Insert it into the pocket"
            f" from behind: its top face rests on the shoulder, and a gap of {sizes.block.board_gap:g} mm remains between"
            " board and flange. Do not touch the window."
        ),
        (
            f"Press a dowel of {DOWEL:g} mm into each flat of the ring. Insert each of the {count} blocks into its bore,"
            " and fasten it with two countersunk M2.5."
        ),
        (
            "Place a cover on each board, its cable opening downwards, and fasten cover and board with three M2. Tighten"
            " them evenly, until board and flange are parallel."
        ),
        "Fasten the ring to the base plate with three countersunk M3 from below.",
        (
            "Place each emitter's board in its pocket, its wires through the hole, and fasten it with two M1.6. Lead the"
            " wires up through the bore."
        ),
        (
            "Fasten handle and tip to the carrier with three M2 each. Leave a loose loop of cable: it must not pull at"
            " the tool."
        ),
        (
            "Fasten the base plate to the bench with three M4, over an opening"
            f" {parts.tip_opening} in which the tip moves, or on standoffs as long as this is deep."
        ),
        (
            "Wire the head as in firmware/README.md: cells and emitters have the scene's numbers, and the table of cells"
            " lists where electrode 2 is. Then check it: slitpose doctor --bring-up"
        ),
        "Calibrate: as made, parts are known to about 0.1 mm only. slitpose calibrate measures where they are.",
    ]


def motions(jigs: JigParts) -> list[tuple[str, str]]:
    """What is mounted for each motion of the calibration with the jig."""
    on_standoffs = f"base plate on standoffs of {jigs.standoff:g} mm"
    stage = f"{on_standoffs}, no foot: the tip must be free; deck, nest, and ball plate on the handle"
    return [
        ("--free", f"{on_standoffs}, nothing else of the jig: foot and deck are in the tool's way"),
        ("--pivot", f"{on_standoffs}, foot below them; no deck, nest or ball plate"),
        ("--rest", f"{stage}. Clamp the nest to the deck"),
        ("--stage", f"{stage}. The nest slides along the fence, against the gauge block"),
    ]


def cell_rows(parts: HeadParts, blocks: dict[int, str], masks: dict[int, str]) -> list[tuple[str, ...]]:
    """Of each cell: its number, its direction, its block and mask, and where its second electrode is."""
    rows: list[tuple[str, ...]] = []
    for cell in parts.layout.cells:
        outward = -cell.base_from_block[:, 2]
        azimuth = math.degrees(math.atan2(outward[1], outward[0])) % 360
        clockwise = math.degrees(math.atan2(-math.cos(cell.roll), math.sin(cell.roll))) % 360
        rows.append((str(cell.number), f"{azimuth:.1f}°", blocks[cell.number], masks[cell.number], f"{clockwise:.1f}°"))
    return rows


def write(
    path: Path,
    parts: HeadParts,
    items: Sequence[Item],
    findings: Findings,
    drawings: Sequence[str],
    blocks: dict[int, str],
    masks: dict[int, str],
    jigs: JigParts | None,
) -> None:
    """Writes the page. Pictures and drawings lie beside it."""

    def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
        cells = "".join(f"<th>{escape(text)}</th>" for text in head)
        body = "".join("<tr>" + "".join(f"<td>{text}</td>" for text in row) + "</tr>" for row in rows)
        return f"<table><tr>{cells}</tr>{body}</table>"

    def link(file: str) -> str:
        return f'<a href="{file}">{file}</a>' if file else ""

    def picture(name: str, caption: str) -> str:
        return (
            f'<figure><img src="{name}.png" alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
        )

    scene, size = parts.layout.scene, parts.layout.workspace
    extent = f"±{size[0]:g}, ±{size[1]:g}, ±{size[2]:g} mm"
    bill = [(escape(i.item), str(i.quantity), i.kind, escape(i.specification), link(i.file)) for i in items]
    lists = "".join(f"<li>{escape(step)}</li>" for step in steps(parts))
    sheets = "".join(f'<li><a href="{name}">{name}</a></li>' for name in drawings)
    jig = ""
    if jigs:
        jig = (
            "<h2>Jig</h2>"
            + picture("jig", "All parts of the jig; each motion needs some of them")
            + picture("jig_exploded", "Its parts")
            + table(("motion", "mounted"), motions(jigs))
            + "<p>How to move the tool: chapter build.md of the guide.</p>"
        )
    turned = "electrode 2, clockwise from the top, seen from outside"
    cells = table(("cell", "direction, from x towards y", "block", "mask", turned), cell_rows(parts, blocks, masks))
    html = f"""<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(scene.name)}: a head to make</title>
<style>{STYLE}</style><h1>{escape(scene.name)}: a head to make</h1>
<p class="note">Designed and checked by calculation. No head has been built or measured. Sizes of bought
parts that are assumed (firmware/PARTS.md) must be compared with the makers' drawings before anything is ordered.</p>
<p>Made from the scene with the hash {scene.hash:#018x}: places of slits, detectors and emitters are the numbers that the
software uses. Workspace {extent}.</p>
{picture("assembly", "The head, the tool at home")}{picture("exploded", "Its parts")}
{picture("section", "Section through cell 0")}{picture("cell", "Cell 0 in section")}
<h2>Parts</h2>{table(("item", "number", "", "material or specification", "file"), bill)}
<p>Everything in place: {link("assembly.step")}. The bill as a table: {link("bill.csv")}. Masks: DXF. STL beside STEP.</p>
<h2>Cells</h2>{cells}
<h2>Drawings</h2><ul>{sheets}</ul><h2>Assembly</h2><ol>{lists}</ol>{jig}
<h2>Checks of the drawings</h2>{table(("check", "result"), [(escape(a), escape(b)) for a, b in findings.rows()])}</html>
"""
    path.write_text(html, encoding="utf-8")
