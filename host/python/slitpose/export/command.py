"""Arguments, order of work and messages of the export."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from pathlib import Path
from typing import Sequence

from .. import Scene, SlitposeError
from . import checks, drawings, files, page, pictures
from .head import HeadParts, head
from .jig import JigParts, jig
from .layout import Layout
from .sizes import ExportError, Sizes
from .solids import Placed, is_foil

#: Poses for which the frames of the masks are open.
OPENING_POSES = 2000
#: Poses for which light is traced.
LIGHT_POSES = 300


def arguments(words: Sequence[str]) -> argparse.Namespace:
    """The arguments."""
    parser = argparse.ArgumentParser(
        prog="slitpose.export",
        description=(
            "Housing, masks, drawings, bill of materials and assembly page of a head, from its scene. Designed only: "
            "nothing has been built."
        ),
        epilog="Example: python3 -m slitpose.export wide --output head",
    )
    parser.add_argument(
        "scene", metavar="SCENE", help="scene file, the name of a shipped scene, or - for a scene on standard input"
    )
    parser.add_argument(
        "--output", type=Path, required=True, metavar="DIR", help="folder for the files; made if absent"
    )
    parser.add_argument(
        "--jig", action="store_true", help="also a nest, a stage and a cone for calibration without an instrument"
    )
    parser.add_argument(
        "--sizes", type=Path, metavar="FILE", help="TOML with other sizes of parts, such as: detector.length = 16.2"
    )
    parser.add_argument(
        "--poses",
        type=_count,
        default=500,
        metavar="N",
        help="poses at which tool and housing are checked (default 500)",
    )
    return parser.parse_args(words)


def _count(text: str) -> int:
    count = int(text)
    if count < 1:
        raise argparse.ArgumentTypeError(f"{count}; give 1 or more")
    return count


def run(words: Sequence[str]) -> int:
    """Makes everything; 0 done, 1 failed."""
    given = arguments(words)
    try:
        sizes = Sizes.open(given.sizes)
        scene = Scene.from_toml(sys.stdin.read(), "standard input") if given.scene == "-" else Scene.open(given.scene)
        layout = Layout.of(scene, sizes)
        given.output.mkdir(parents=True, exist_ok=True)
        failures = export(layout, sizes, given.output, given.poses, given.jig)
    except (ExportError, SlitposeError, OSError) as error:
        print(f"slitpose.export: {error}", file=sys.stderr)
        return 1
    for failure in failures:
        print(f"slitpose.export: {failure}", file=sys.stderr)
    print(f"slitpose.export: wrote {given.output / 'index.html'}", file=sys.stderr)
    return 1 if failures else 0


def export(layout: Layout, sizes: Sizes, folder: Path, poses: int, with_jig: bool) -> list[str]:
    """Writes all files of a head into a folder.

    :returns: What keeps the head from being made.
    """
    warn_of_other_parts(layout, sizes)
    parts = HeadParts(layout, sizes)
    placed = head(parts, layout.poses(OPENING_POSES))
    jigs = JigParts(parts) if with_jig else None
    fixture = jig(jigs) if jigs else []
    distinct = files.distinct([*placed, *fixture])
    files.write_parts([*placed, *fixture], folder)
    files.write_assembly(placed, folder, "assembly")
    if jigs:
        files.write_assembly([*placed, *fixture], folder, "jig_assembly")
    for name, part in distinct.items():
        if is_foil(name) and part.instance is not None:
            files.write_mask(layout.cells[part.instance], name, parts, folder / f"{files.stem(name)}.dxf")
    items = [*files.bill(placed, parts), *(files.jig_bill(jigs, fixture) if jigs else [])]
    files.write_bill(items, folder / "bill.csv")
    sheets = draw(parts, distinct, folder)
    picture(parts, placed, fixture, folder)
    findings = check(parts, placed, fixture, poses)
    blocks, masks = (
        {part.instance: part.name for part in placed if part.instance is not None and is_kind(part.name)}
        for is_kind in (lambda name: name.startswith("cell block"), is_foil)
    )
    page.write(folder / "index.html", parts, items, findings, sheets, blocks, masks, jigs)
    for name, result in findings.rows():
        print(f"{name}: {result}")
    return findings.failures


def warn_of_other_parts(layout: Layout, sizes: Sizes) -> None:
    """Names bought parts of the scene that are not those of the sizes."""
    for kind, named, sized in (
        ("emitter", layout.emitter_part, sizes.emitter.part),
        ("detector", layout.detector_part, sizes.detector.part),
    ):
        if named != sized:
            text = f"the scene's {kind} is {named}; the sizes are those of {sized}"
            print(f"slitpose.export: warning: {text}. Give others with --sizes ({kind}.part, …)", file=sys.stderr)


def check(parts: HeadParts, placed: list[Placed], fixture: list[Placed], poses: int) -> page.Findings:
    """All checks of a head."""
    layout = parts.layout
    everything = [*placed, *fixture]
    solid = {name: part.solid for name, part in files.distinct(everything).items() if part.made and not is_foil(name)}
    return page.Findings(
        faults=checks.faults(everything),
        overlaps=checks.overlaps(everything),
        walls={name: checks.thinnest(part) for name, part in solid.items()},
        clearance=checks.clearance(placed, layout.poses(poses)),
        light=checks.light(layout, placed, layout.poses(LIGHT_POSES)),
    )


def draw(parts: HeadParts, distinct: dict[str, Placed], folder: Path) -> list[str]:
    """A drawing of each part that is made.

    :returns: The names of the files.
    """
    written = []
    for name, part in distinct.items():
        if not part.made:
            continue
        text, solid = files.material(name, parts.sizes), part.solid
        if name == "base ring":
            sheet = drawings.ring_sheet(parts, solid, text)
        elif part.instance is not None and name.startswith("cell block"):
            sheet = drawings.block_sheet(parts, parts.layout.cells[part.instance], name, solid, text)
        elif part.instance is not None and name.startswith("mask frame"):
            sheet = drawings.frame_sheet(parts, parts.layout.cells[part.instance], name, solid, text)
        elif part.instance is not None and is_foil(name):
            sheet = drawings.mask_sheet(parts, parts.layout.cells[part.instance], name, solid, text)
        else:
            sheet = drawings.other_sheet(parts, name, solid, text)
        file = f"{files.stem(name)}.svg"
        (folder / file).write_text(sheet.svg(), encoding="utf-8")
        written.append(file)
    return written


def picture(parts: HeadParts, placed: list[Placed], fixture: list[Placed], folder: Path) -> None:
    """The pictures of the page."""
    outward = -parts.layout.cells[0].base_from_block[:, 2]
    azimuth = math.atan2(outward[1], outward[0])
    reach = parts.plate_radius
    pictures.render(pictures.exploded(placed, 0.0), pictures.View(), folder / "assembly.png")
    pictures.render(
        pictures.exploded(placed, 0.75 * reach), pictures.View(-70, 28), folder / "exploded.png", 1600, 1300
    )
    pictures.render(pictures.section(placed, azimuth), pictures.View(-90, 8), folder / "section.png")
    ends = ("handle", "tip", "base plate")
    near = [part for part in placed if part.name not in ends]
    pictures.render(pictures.section(near, azimuth, 2.0), pictures.View(-90, 4), folder / "cell.png")
    if fixture:
        pictures.render(pictures.exploded([*placed, *fixture], 0.0), pictures.View(-125, 30), folder / "jig.png")
        pictures.render(
            pictures.exploded(_together(placed, fixture), 0.45 * reach),
            pictures.View(-125, 28),
            folder / "jig_exploded.png",
            1600,
            1300,
        )


def _together(placed: list[Placed], fixture: list[Placed]) -> list[Placed]:
    """The head in one piece, its tool lifted out, among the parts of its jig."""
    whole = [dataclasses.replace(part, away=(0.0, 0.0, 1.2 if part.on_tool else 0.0)) for part in placed]
    return [*whole, *fixture]
