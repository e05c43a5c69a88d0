"""Files for makers: STEP of parts and assembly, STL, DXF of masks, and the bill of materials."""

from __future__ import annotations

import copy
import csv
import dataclasses
from collections import Counter
from pathlib import Path

import ezdxf
from build123d import Color, Compound, export_step, export_stl
from ezdxf.enums import TextEntityAlignment

from .head import HeadParts
from .jig import STANDOFF_THREAD, JigParts
from .layout import Cell
from .pictures import colour
from .sizes import Sizes
from .solids import DOWEL, LENGTHS, Joint, Placed

STL_CHORD = 0.01
STL_ANGLE = 0.1


def stem(name: str) -> str:
    """The file name of a part."""
    return name.replace(" ", "_")


def distinct(placed: list[Placed]) -> dict[str, Placed]:
    """The first instance of each part."""
    found: dict[str, Placed] = {}
    for part in placed:
        found.setdefault(part.name, part)
    return found


def write_parts(placed: list[Placed], folder: Path) -> None:
    """STEP and STL of each part that is made, in its own frame."""
    for name, part in distinct(placed).items():
        if part.made:
            export_step(part.solid, folder / f"{stem(name)}.step")
            export_stl(part.solid, folder / f"{stem(name)}.stl", tolerance=STL_CHORD, angular_tolerance=STL_ANGLE)


def write_assembly(placed: list[Placed], folder: Path, assembly: str) -> None:
    """One STEP with all parts in place."""
    children = []
    for part in placed:
        child = copy.copy(part.solid)
        child.location = part.base_from_part
        child.label = part.label
        child.color = Color(*(channel / 255 for channel in colour(part.name)))
        children.append(child)
    export_step(Compound(label=assembly, children=children), folder / f"{assembly}.step")


def write_mask(cell: Cell, name: str, parts: HeadParts, path: Path) -> None:
    """The outline of a mask in the cell's frame, x along the detector, seen from the tool, with tolerances beside it."""
    size = parts.sizes.mask
    drawing = ezdxf.new("R2010")
    drawing.units = ezdxf.units.MM
    drawing.layers.add("CUT", color=1)
    drawing.layers.add("NOTE", color=8)
    space = drawing.modelspace()
    cut, note = {"layer": "CUT"}, {"layer": "NOTE"}
    space.add_circle((0, 0), size.radius, dxfattribs=cut)
    for side in (1, -1):
        space.add_circle((side * size.pin_distance, 0), size.pin_diameter / 2, dxfattribs=cut)
    corners = slit_corners(cell)
    space.add_lwpolyline(corners, close=True, dxfattribs=cut)
    lines = [
        f"{name}: {parts.layout.scene.name}",
        "Unit: mm. Layer CUT is the finished edge: allow for the cut's width or the etchant.",
        f"Steel or bronze foil {cell.thickness:g} +-{0.1 * cell.thickness:.3f}, blackened, flat within 0.02",
        f"Slit {cell.slit[0]:g} +-{size.slit_width_tolerance:g} x {cell.slit[1]:g} +-0.05",
        f"Slit's middle to the middle of the pin holes +-{size.slit_position_tolerance:g}",
        "Slit at right angles to the line of the pin holes +-0.1 degree",
        f"Pin holes {size.pin_diameter:g} +0.02/0, distance {2 * size.pin_distance:g} +-0.01",
        f"Outline {2 * size.radius:g} +-0.05",
        f"Quantity: {sum(other.mask_variant == cell.mask_variant for other in parts.layout.cells)}",
    ]
    for row, line in enumerate(lines):
        text = space.add_text(line, height=0.8, dxfattribs=note)
        text.set_placement((size.radius + 3, size.radius - 1.4 * row), align=TextEntityAlignment.TOP_LEFT)
    drawing.saveas(path)


def slit_corners(cell: Cell) -> list[tuple[float, float]]:
    """Corners of a slit in the cell's x and y."""
    x, y = cell.slit[0] / 2, cell.slit[1] / 2
    return [(cell.offset[0] + a, cell.offset[1] + b) for a, b in ((x, y), (-x, y), (-x, -y), (x, -y))]


@dataclasses.dataclass(frozen=True)
class Item:
    """A row of the bill of materials."""

    item: str
    quantity: int
    kind: str
    specification: str
    file: str


MATERIALS = {
    "base ring": "aluminium EN AW-6082, black anodised; or black PA12 (SLS)",
    "base plate": "aluminium EN AW-6082, black anodised; or black PA12 (SLS)",
    "cell block": "aluminium EN AW-6082, black anodised; or black PA12 (SLS), seats finished by hand",
    "mask frame": "brass or steel, blackened",
    "mask": "steel or bronze foil, blackened: the DXF has tolerances",
    "cover": "black PA12 (SLS) or PLA",
    "detector board": "FR4, {sizes.block.board_thickness:g} mm: detector, amplifier, connector; circuit in firmware/README.md",
    "emitter board": "FR4, {sizes.emitter.board_thickness:g} mm: one emitter, two wires",
    "emitter carrier": "aluminium EN AW-6082, black anodised; or black PA12 (SLS)",
    "handle": "aluminium or black PA12 (SLS)",
    "tip": "steel; or PA12, its ball turned from steel and bonded on",
    "jig": "PLA or PA12; gauge faces of aluminium for more than a day's use",
}


def material(name: str, sizes: Sizes) -> str:
    """What a part is made of."""
    return next(text for start, text in MATERIALS.items() if name.startswith(start)).format(sizes=sizes)


def screw(joint: Joint) -> Item:
    """The screws of a joint."""
    return Item(f"screw {joint.thread}x{joint.length}", joint.quantity, "bought", joint.text, "")


def bill(placed: list[Placed], parts: HeadParts) -> list[Item]:
    """All parts of a head: made, bought, and screws."""
    sizes, count = parts.sizes, len(parts.layout.cells)
    through = parts.flange_top - parts.flange_rear + sizes.block.dowel_depth
    dowel = max((length for length in LENGTHS if length <= through), default=LENGTHS[0])
    bought = {
        "detector": f"{sizes.detector.part}; the scene has {parts.layout.detector_part}",
        "emitter": f"{sizes.emitter.part}; the scene has {parts.layout.emitter_part}",
        "mask pin": f"ISO 2338 {sizes.mask.pin_diameter:g} x {sizes.mask.pin_length:g}",
    }
    items = []
    counts = Counter(part.name for part in placed)
    for name, part in distinct(placed).items():
        if part.made:
            items.append(Item(name, counts[name], "made", material(name, sizes), f"{stem(name)}.step"))
    for name, text in bought.items():
        items.append(Item(name, counts[name], "bought", text, ""))
    bench = f"base plate to the bench, length as needed: below the plate the tip needs an opening {parts.tip_opening}"
    return [
        *items,
        *(screw(joint) for joint in parts.joints()),
        Item(f"dowel {DOWEL:g}x{dowel}", count, "bought", "ISO 2338, block to ring: sets the roll", ""),
        Item("screw M4", 3, "bought", bench, ""),
    ]


def jig_bill(jigs: JigParts, fixture: list[Placed]) -> list[Item]:
    """All parts of a jig."""
    counts = Counter(part.name for part in fixture)
    bought = {
        jigs.dowel: "ISO 2338, fence and stop",
        "ball": f"bearing ball {2 * jigs.size.ball_radius:g}, G10",
        "gauge block": (
            f"a set: {jigs.size.block:g} at home, {jigs.size.block - jigs.size.steps:g} to"
            f" {jigs.size.block + jigs.size.steps:g} for steps"
        ),
        "jig standoff": f"M4, {jigs.standoff:g} long, thread {STANDOFF_THREAD:g} deep in both ends",
    }
    items = []
    for name, part in distinct(fixture).items():
        text = material(name, jigs.parts.sizes) if part.made else bought[name]
        items.append(
            Item(name, counts[name], "made" if part.made else "bought", text, f"{stem(name)}.step" if part.made else "")
        )
    return [*items, *(screw(joint) for joint in jigs.joints())]


def write_bill(items: list[Item], path: Path) -> None:
    """The bill of materials as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow([field.name for field in dataclasses.fields(Item)])
        rows.writerows(dataclasses.astuple(item) for item in items)
