"""Where the parts of the carrier stand: millimetres from the upper left corner, y downwards, degrees counterclockwise.

The Nucleo lies on top, its contacts in sockets of the carrier. Distances of its connectors: KiCad's template
STM32_Nucleo-64_Morpho (contact 1 of CN10 is 60.96 mm right of contact 1 of CN7, contact 2 is 2.54 mm right of contact 1).
"""
from __future__ import annotations

WIDTH, HEIGHT = 106.0, 131.0
CN7, CN10 = (20.0, 44.0), (80.96, 44.0)
HOLES = ((4, 36), (102, 36), (4, 92), (102, 91))

Place = tuple[float, float, float]


def carrier() -> dict[str, Place]:
    places: dict[str, Place] = {"CN7": (*CN7, 0), "CN10": (*CN10, 0)}
    _inputs(places)
    for pair, x in enumerate((31.5, 56.0, 80.5)):
        _pair(places, 700 + 100 * pair, x)
    _supplies(places)
    _sockets(places)
    return places


# Height of the group of R, C and clamp of each contact: electrode 1 at CN7, electrode 2 at CN10.
AT_CN7 = {0: 65.0, 1: 69.5, 3: 74.0, 4: 78.5, 5: 83.0, 2: 87.5}
AT_CN10 = {2: 49.0, 0: 58.0, 4: 63.5, 3: 69.0, 5: 75.0, 1: 84.0}


def _inputs(places: dict[str, Place]) -> None:
    for cell in range(6):
        base, x = 100 * (cell + 1), 11 + 16.6 * cell
        places[f"J{base}"] = (x, 4.5, 0)
        places[f"U{base}"] = (x, 12, 270)
        places[f"R{base}"] = (x - 5.5, 10.5, 90)
        for electrode, heights, (c, d, r), turn in ((1, AT_CN7, (27.5, 32, 36.5), 0), (2, AT_CN10, (76, 71.5, 67), 180)):
            y = heights[cell]
            places[f"C{base + electrode}"] = (c, y, turn)
            places[f"D{base + electrode}"] = (d, y, 180 - turn)
            places[f"R{base + electrode}"] = (r, y, 180 - turn)


def _pair(places: dict[str, Place], base: int, x: float) -> None:
    places[f"U{base}"] = (x + 12, 109.5, 0)
    places[f"C{base}"] = (x + 12, 106, 0)
    places[f"C{base + 1}"] = (x + 12, 113.8, 0)
    places[f"U{base + 1}"] = (x + 12, 118.5, 90)
    for n, side in ((base + 10, -1), (base + 20, 1)):
        middle = x + 12 + 6.2 * side
        places[f"U{n}"] = (middle - 2.5, 99, 0)
        places[f"C{n}"] = (middle + 2.8, 97.8, 0)
        places[f"R{n}"] = (middle + 2.8, 100.2, 0)
        places[f"R{n + 1}"] = (middle - 2.5, 103.2, 0)
        places[f"R{n + 2}"] = (middle + 1.5, 103.2, 0)
        outer = x + 12 + 7.5 * side
        places[f"R{n + 3}"] = (outer, 107, 0)
        places[f"C{n + 1}"] = (outer, 109.5, 0)
        places[f"R{n + 4}"] = (outer, 112, 0)
        places[f"Q{n}"] = (x + 12 + 5.5 * side, 116, 0)
        places[f"R{n + 5}"] = (x + 12 + 9.8 * side, 116, 90)
        places[f"J{n}"] = (x + 12 + 6.5 * side, 126.5, 180)


def _supplies(places: dict[str, Place]) -> None:
    places.update({
        # 5 V, lower left
        "J1": (7.5, 108, 270), "F1": (20, 101, 0), "D1": (20, 106, 0), "C1": (20, 114, 0), "JP1": (5, 98, 0),
        "U1": (8, 125, 0), "C2": (3.5, 122, 90), "R1": (12.5, 123.5, 0), "C3": (12.5, 126, 0),
        "R2": (24, 121, 0), "C4": (21, 126.5, 0), "C5": (28, 122.5, 90),
        # 12 V, left
        "J2": (7.5, 56, 270), "F2": (8, 68, 0), "D2": (8, 73.5, 0), "D3": (8, 78.5, 0), "C6": (8, 82.5, 0),
        # 9 V, middle
        "U2": (46, 50, 0), "C7": (52, 46.5, 0), "R3": (41, 46.5, 0), "R4": (41, 53, 0), "C8": (41, 50, 90), "C9": (46, 45.5, 0),
        # reference
        "JP2": (50, 60, 0), "TP1": (55.5, 60, 0), "R5": (50, 64, 0), "R6": (50, 67, 0), "C10": (50, 70, 0), "C11": (50, 73, 0),
        "C12": (50, 79, 0), "C13": (57, 73, 0),
        # level lines
        "R7": (50, 83, 0), "R8": (56, 83, 0), "R9": (50, 86, 0), "R10": (56, 86, 0),
    })


def _sockets(places: dict[str, Place]) -> None:
    places.update({
        "J3": (101, 50, 90), "U3": (91.5, 50, 0), "R11": (92, 45.5, 0), "R12": (92, 54.5, 0), "C14": (92, 43, 0),
        "J4": (101.5, 74, 90), "U4": (93.5, 69, 180), "R13": (93, 73.5, 0), "R14": (90, 77, 0), "D4": (94.5, 77.5, 0),
        "R15": (93, 62, 0), "R16": (93, 64, 0), "R17": (93, 59.5, 0), "TP2": (90, 84.5, 0), "TP3": (90, 88.5, 0),
    })
