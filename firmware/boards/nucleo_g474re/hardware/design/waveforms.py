"""Step responses of the whole chain as CSV, for the emulated converters: from the gate pin's edge to the converter's pins.

Columns: time after the edge in seconds; output of each electrode as a part of its end. The chain is linear in light, so that
the response to any lighting is the sum of such steps.
"""
from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path

from . import benches, figures
from .boards import ORDERABLE, WIDE

STEP_S = 50e-9
END_S = 40e-6


def response(front_end, position: float) -> list[tuple[float, float, float]]:
    """Both electrodes, with the detector as a line and the light at `position` of its length."""
    detector = replace(benches.LINE, position=position)
    rows = benches.settling_rows(front_end, detector, figures.EMITTER_S, benches.driver_waveform(), both=True)
    start, end = rows[0], rows[-1]
    found, i = [], 0
    for k in range(round(END_S / STEP_S) + 1):
        time = benches.EDGE_S + k * STEP_S
        while rows[i + 1][0] < time:
            i += 1
        part = (time - rows[i][0]) / (rows[i + 1][0] - rows[i][0])
        values = [rows[i][n] + part * (rows[i + 1][n] - rows[i][n]) for n in (1, 2)]
        found.append((k * STEP_S, *((value - start[n]) / (end[n] - start[n]) for n, value in zip((1, 2), values))))
    return found


def write(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, front_end in (("wide", WIDE), ("orderable", ORDERABLE)):
        for position in (0.1, 0.5, 0.9):
            with (folder / f"{name}_{position:g}.csv").open("w", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(("time_s", "electrode_1", "electrode_2"))
                writer.writerows((f"{time:.4g}", f"{a:.7f}", f"{b:.7f}") for time, a, b in response(front_end, position))


if __name__ == "__main__":
    write(Path(sys.argv[1]))
