"""Writes the KiCad files and the bill, or with `--check` names the files that differ from what would be written."""
from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from . import bill, footprints, kicad, pages

ROOT = Path(__file__).resolve().parents[1]
NOTES = [
    "Analogue carrier of the NUCLEO-G474RE: 12 inputs, 6 emitters.",
    "Six detector's boards hold the transimpedance stages; they are a project of their own.",
    "Contacts of the Nucleo: firmware/wiring.csv. Circuit and arithmetic: firmware/README.md.",
    "Drawn by `hardware/run write`; changes made here are lost.",
]
BOARDS = (
    (pages.carrier_sheets, "slitpose carrier of the NUCLEO-G474RE", NOTES),
    (pages.detector_sheets, "", []),
    (pages.emitter_sheets, "", []),
)


def write(root: Path) -> list[Path]:
    files = []
    for draw, title, notes in BOARDS:
        circuit, sheets = draw()
        folder = root / "kicad" / circuit.name
        files += kicad.write(folder, circuit, sheets, title, notes)
        files += footprints.write(folder, circuit)
    files.append(root / "bom.csv")
    files[-1].write_text(bill.text())
    return files


def stale(root: Path = ROOT) -> list[str]:
    """Files of `root` that differ from what the design gives."""
    with tempfile.TemporaryDirectory() as folder:
        fresh = {path.relative_to(folder): path.read_text() for path in write(Path(folder))}
    return [str(name) for name, text in fresh.items() if not (root / name).exists() or (root / name).read_text() != text]


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        different = stale()
        print("\n".join(different) or "all files are current")
        sys.exit(bool(different))
    write(ROOT)
