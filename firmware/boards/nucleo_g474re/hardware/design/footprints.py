"""The one footprint that no library has: the detector S3932. Its land pattern is a placeholder.

No drawing of the package was at hand. Four pads at the ends of a package of 16 x 5 mm (the size that firmware/PARTS.md
assumes) let the netlist be complete; compare with the maker's drawing before a board is made.
"""
from __future__ import annotations

from pathlib import Path

from .circuit import Circuit

PADS = {"1": (-7.0, 1.25), "2": (-7.0, -1.25), "4": (7.0, -1.25), "3": (7.0, 1.25)}


def s3932() -> str:
    pads = "\n".join(
        f'(pad "{number}" smd rect (at {x} {y}) (size 2.5 1.5) (layers "F.Cu" "F.Paste" "F.Mask"))' for number, (x, y) in PADS.items()
    )
    lines = "\n".join(
        f'(fp_line (start {x0} {y0}) (end {x1} {y1}) (stroke (width 0.1) (type solid)) (layer "F.Fab"))'
        for x0, y0, x1, y1 in ((-8, -2.5, 8, -2.5), (8, -2.5, 8, 2.5), (8, 2.5, -8, 2.5), (-8, 2.5, -8, -2.5))
    )
    return (
        '(footprint "S3932" (version 20240108) (generator "slitpose") (layer "F.Cu")\n'
        '(descr "Hamamatsu S3932. PLACEHOLDER: land pattern and order of pins not verified")\n'
        '(fp_text reference "REF**" (at 0 -3.5) (layer "F.SilkS") (effects (font (size 1 1) (thickness 0.15))))\n'
        '(fp_text value "S3932" (at 0 3.5) (layer "F.Fab") (effects (font (size 1 1) (thickness 0.15))))\n'
        f"{lines}\n{pads}\n)\n"
    )


def write(folder: Path, circuit: Circuit) -> list[Path]:
    if not any(part.kind.footprint == "slitpose:S3932" for part in circuit.parts.values()):
        return []
    path = folder / "slitpose.pretty" / "S3932.kicad_mod"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(s3932())
    return [path]
