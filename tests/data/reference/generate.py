#!/usr/bin/env python3
"""Reference currents of single cells and of two heads of six, by multi-precision arithmetic.

It shares no code with slitpose and takes another way: 30 digits (mpmath), a polygon-free
description of the spot as an intersection of rectangles, and tensor Gauss-Legendre rules whose
error is measured on every spot by a finer rule. Spots across which an emitter's horizon
(gamma = 90 deg) runs are integrated up to that line by the tanh-sinh rule, which bears the
singular derivatives there.

    python3 generate.py            writes the tables beside this file
    python3 generate.py --check    computes them again and compares every byte

Needs Python 3.11 and mpmath. Lengths in mm, angles in rad, currents in A.

Equations, numbered as in De La Cruz et al. 2018, with what the paper leaves open:
 * Beam: a corner q of a mask's face at height h lands at q*k - e*m, k = e_z/(e_z - h), m = h/(e_z - h).
   A thick mask has its faces at d_B +- t/2; light passes both.
 * Paper tier: X_A is the middle of the spot; solid angle by eq. (3) with the tangents of the half
   angles between the middles of opposite sides; eq. (5) with gamma between the emitter's axis and
   the sum of the unit vectors to the four middles; eq. (1) splits I_O including the dark current.
 * Exact tier: I_O - I_D = S * integral of I_e cos^n(gamma) over the solid angle; X_A is the mean of x
   weighted by that power; half of the dark current goes to each electrode.
"""

import argparse
import csv
import io
import math
import pathlib
import random
import sys
import tomllib
from dataclasses import dataclass, replace

from mpmath import atan, cos, log, matrix, mp, mpf, pi, quad, radians, sin, sqrt

mp.dps = 30
HERE = pathlib.Path(__file__).parent
# An exponent whose intensity has halved at 55 degrees off the axis.
HALF_AT_55 = log(mpf(1) / 2) / log(cos(radians(mpf(55))))
# A rule of this many nodes is believed if one of half as many again agrees to 20 digits.
NODES = (24, 16)


@dataclass(frozen=True)
class Cell:
    """In the cell's own frame: detector at the origin, x along its length, z towards the emitter."""

    length: float = 12.0
    width: float = 1.0
    slit_x: float = 0.0
    slit_y: float = 0.0
    slit_distance: float = 7.5
    slit_width: float = 0.4
    slit_length: float = 10.0
    thickness: float = 0.0
    radiant_intensity: float = 3.16e-3
    responsivity: float = 0.54
    exponent: float = float(HALF_AT_55)
    dark_current: float = 0.0


def landing(cell, e):
    """The rectangle that light reaches on the detector's plane; None if the emitter is not in front."""
    faces = {mpf(cell.slit_distance) + side * mpf(cell.thickness) / 2 for side in (-1, 1)}
    if e[2] <= max(faces):
        return None
    x, y = [], []
    for height in faces:
        k, m = e[2] / (e[2] - height), height / (e[2] - height)
        for sides, middle, size, at in (
            (x, mpf(cell.slit_x), mpf(cell.slit_width), e[0]),
            (y, mpf(cell.slit_y), mpf(cell.slit_length), e[1]),
        ):
            sides.append(((middle - size / 2) * k - at * m, (middle + size / 2) * k - at * m))
    return [(max(low for low, _ in sides), min(high for _, high in sides)) for sides in (x, y)]


def spot(cell, e):
    """Status, and the part of the detector that is lit, as (x0, x1, y0, y1)."""
    beam = landing(cell, e)
    if beam is None:
        return "behind", None
    half = [mpf(cell.length) / 2, mpf(cell.width) / 2]
    (x0, x1), (y0, y1) = [(max(low, -h), min(high, h)) for (low, high), h in zip(beam, half)]
    if x0 >= x1 or y0 >= y1:
        return "dark", None
    is_cut = beam[0][0] < -half[0] or beam[0][1] > half[0]
    return ("clipped" if is_cut else "lit"), (x0, x1, y0, y1)


def norm(v):
    return sqrt(sum(q * q for q in v))


def paper(cell, e, u, lit):
    """(X_A, solid angle, photocurrent) by equations (3) and (5)."""
    x0, x1, y0, y1 = lit
    xm, ym = (x0 + x1) / 2, (y0 + y1) / 2
    ends = [(x0, ym), (x1, ym), (xm, y0), (xm, y1)]
    units = []
    for x, y in ends:
        v = (x - e[0], y - e[1], -e[2])
        units.append([q / norm(v) for q in v])

    def tangent(a, b):
        """tan of half the angle between two unit vectors: |a - b|/|a + b|."""
        return norm([p - q for p, q in zip(a, b)]) / norm([p + q for p, q in zip(a, b)])

    alpha, beta = tangent(units[0], units[1]), tangent(units[2], units[3])
    omega = 4 * atan(alpha * beta / sqrt(1 + alpha**2 + beta**2))
    axis = [sum(unit[i] for unit in units) for i in range(3)]
    cosine = sum(p * q for p, q in zip(u, axis)) / norm(axis)
    relative = cosine ** mpf(cell.exponent) if cosine > 0 else mpf(0)
    return xm, omega, omega * mpf(cell.radiant_intensity) * relative * mpf(cell.responsivity)


RULES = {}


def rule(count):
    """Nodes and weights of Gauss and Legendre on [-1, 1], by Newton's method on the recurrence."""
    if count not in RULES:
        nodes = []
        for i in range(count):
            x = cos(pi * (i + mpf(3) / 4) / (count + mpf(1) / 2))
            for _ in range(100):
                p, before = mpf(1), mpf(0)
                for j in range(count):
                    p, before = ((2 * j + 1) * x * p - j * before) / (j + 1), p
                slope = count * (x * p - before) / (x * x - 1)
                step = p / slope
                x -= step
                if abs(step) < mpf(10) ** -(mp.dps - 2):
                    break
            nodes.append((x, 2 / ((1 - x * x) * slope * slope)))
        RULES[count] = nodes
    return RULES[count]


def tensor(integrand, lit, counts):
    x0, x1, y0, y1 = lit
    total = [mpf(0), mpf(0)]
    for gx, wx in rule(counts[0]):
        x = (x0 + x1) / 2 + (x1 - x0) / 2 * gx
        for gy, wy in rule(counts[1]):
            y = (y0 + y1) / 2 + (y1 - y0) / 2 * gy
            value = integrand(x, y) * wx * wy
            total[0] += value
            total[1] += value * (x - (x0 + x1) / 2)
    return [value * (x1 - x0) * (y1 - y0) / 4 for value in total]


def exact(cell, e, u, lit):
    """(X_A or None, solid angle, photocurrent), integrated."""
    x0, x1, y0, y1 = lit

    def corner(x, y):
        return atan((x - e[0]) * (y - e[1]) / (e[2] * norm((x - e[0], y - e[1], e[2]))))

    omega = corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)

    def rise(x, y):
        """r cos(gamma): linear in x and y."""
        return u[0] * (x - e[0]) + u[1] * (y - e[1]) - u[2] * e[2]

    def integrand(x, y):
        r, above = norm((x - e[0], y - e[1], e[2])), rise(x, y)
        return e[2] / r**3 * (above / r) ** mpf(cell.exponent) if above > 0 else mpf(0)

    rises = [rise(x, y) for x in (x0, x1) for y in (y0, y1)]
    if max(rises) <= 0:
        return None, omega, mpf(0)
    # A power as high as that of a narrow lobe is a polynomial; its horizon, if along y, is an end of the spot.
    is_narrow = cell.exponent >= 50 and cell.exponent.is_integer() and u[1] == 0
    if min(rises) > 0 or is_narrow:
        counts = NODES
        if min(rises) <= 0:
            horizon = e[0] + u[2] * e[2] / u[0]
            lit = (x0, horizon, y0, y1) if rise(x0, y0) > 0 else (horizon, x1, y0, y1)
            counts = (NODES[0] + int(cell.exponent) // 2, NODES[1])
        coarse = tensor(integrand, lit, counts)
        fine = tensor(integrand, lit, [3 * n // 2 for n in counts])
        if abs(coarse[0] / fine[0] - 1) > mpf(10) ** -18:
            raise ArithmeticError(f"{cell}, emitter at {e}: rules of {counts} nodes do not suffice")
        power, moment = fine[0], fine[1] + fine[0] * ((lit[0] + lit[1]) - (x0 + x1)) / 2
    else:
        power, moment = up_to_horizon(integrand, rise, e, u, lit)
    current = mpf(cell.responsivity) * mpf(cell.radiant_intensity) * power
    return (x0 + x1) / 2 + moment / power, omega, current


def up_to_horizon(integrand, rise, e, u, lit):
    """Power and its moment where gamma = 90 deg crosses the spot."""
    x0, x1, y0, y1 = lit
    cuts = {x0, x1}
    if u[0] != 0:
        crossings = [e[0] + (u[2] * e[2] - u[1] * (y - e[1])) / u[0] for y in (y0, y1)]
        cuts |= {x for x in crossings if x0 < x < x1}

    def column(x):
        """The part of a column of the spot that the emitter sees."""
        if u[1] == 0:
            return (y0, y1) if rise(x, (y0 + y1) / 2) > 0 else (y0, y0)
        y = min(y1, max(y0, e[1] + (u[2] * e[2] - u[0] * (x - e[0])) / u[1]))
        return (y, y1) if u[1] > 0 else (y0, y)

    def along(weight):
        def inner(x):
            low, high = column(x)
            return quad(lambda y: integrand(x, y), [low, high], method="tanh-sinh") * weight(x) if low < high else mpf(0)

        return quad(inner, sorted(cuts), method="tanh-sinh")

    return along(lambda x: 1), along(lambda x: x - (x0 + x1) / 2)


def electrodes(i_o, x_a, cell):
    share = 2 * x_a / mpf(cell.length)
    return i_o / 2 * (1 - share), i_o / 2 * (1 + share)


def respond(cell, e, u):
    """Status, and of each tier (X_A or None, solid angle, I_O, I_X1, I_X2)."""
    status, lit = spot(cell, e)
    dark = mpf(cell.dark_current)
    if lit is None:
        return status, [(None, mpf(0), dark, dark / 2, dark / 2)] * 2
    x_a, omega, photo = paper(cell, e, u, lit)
    i_o = photo + dark
    printed = (x_a, omega, i_o, *electrodes(i_o, x_a, cell))
    x_a, omega, photo = exact(cell, e, u, lit)
    halves = electrodes(photo, x_a or mpf(0), cell)
    return status, [printed, (x_a, omega, photo + dark, *(half + dark / 2 for half in halves))]


def digits(value):
    return "nan" if value is None else f"{float(value):.17g}"


def slanted(degrees):
    """An axis turned in the x-z plane, away from the detector's normal."""
    angle = radians(mpf(degrees))
    return float(sin(angle)), 0.0, float(-cos(angle))


def unit(*v):
    length = norm([mpf(q) for q in v])
    return tuple(float(mpf(q) / length) for q in v)


DOWN = (0.0, 0.0, -1.0)
THICK = Cell(thickness=0.15)
SINGLE_CELLS = [
    ("nominal", (0, 0, 15), DOWN, Cell()),
    ("nominal_dark20nA", (0, 0, 15), DOWN, Cell(dark_current=20e-9)),
    ("exp1_+0.5", (0.5, 0, 15), DOWN, Cell()),
    ("exp1_-2", (-2, 0, 15), DOWN, Cell()),
    ("exp1_+4.5", (4.5, 0, 15), DOWN, Cell()),
    ("exp1_+5.5", (5.5, 0, 15), DOWN, Cell()),
    ("exp1_-5.5_dark", (-5.5, 0, 15), DOWN, Cell(dark_current=20e-9)),
    ("exp2_+30", (0, 0, 15), slanted(30), Cell()),
    ("exp2_-45", (0, 0, 15), slanted(-45), Cell()),
    ("exp2_+65", (0, 0, 15), slanted(65), Cell()),
    ("exp2_+80", (0, 0, 15), slanted(80), Cell()),
    ("edge_touch", (5.6, 0, 15), DOWN, Cell()),
    ("clip_x_5.8", (5.8, 0, 15), DOWN, Cell()),
    ("clip_x_-6.35", (-6.35, 0, 15), DOWN, Cell()),
    ("off_x_6.5", (6.5, 0, 15), DOWN, Cell()),
    ("off_x_-9_dark", (-9, 0, 15), DOWN, Cell(dark_current=20e-9)),
    ("generic1", (1.37, -2.11, 13.2), unit(0.2, -0.1, -1), Cell()),
    ("generic2", (-2.6, 3.1, 17.2), unit(-0.35, -0.2, -0.9), Cell()),
    ("generic3_thick", (2.2, 1.3, 12.4), unit(0.1, 0.3, -1), THICK),
    ("thick_nominal", (0, 0, 15), DOWN, THICK),
    ("thick_5.5", (5.5, 0, 15), DOWN, THICK),
    ("thick_clipped", (-6.2, 0.7, 14), unit(0.4, 0, -1), replace(THICK, dark_current=7e-9)),
    ("thick_closed", (4.5, 0, 9), DOWN, replace(THICK, slit_width=0.1, length=60.0)),
    ("near_8.0", (0.3, 0.1, 8.0), DOWN, Cell()),
    ("near_7.51", (0.001, 0, 7.51), DOWN, Cell()),
    ("slit_plane", (0, 0, 7.5), DOWN, Cell()),
    ("behind_7.0", (0.4, 0, 7.0), DOWN, Cell()),
    ("far_100", (3, 2, 100), DOWN, Cell()),
    ("far_1e4", (20, -10, 1e4), DOWN, Cell()),
    ("far_1e6", (0, 0, 1e6), DOWN, Cell()),
    ("grazing_half_lit", (0, 0, 15), (1.0, 0.0, 0.0), Cell()),
    ("grazing_92deg", (0, 0, 15), slanted(91), Cell()),
    ("grazing_skew", (1.1, -0.6, 14), unit(0.5, 0.86, -0.02), Cell()),
    ("facing_away", (0, 0, 15), (0.0, 0.0, 1.0), Cell()),
    ("zero_width", (0, 0, 15), DOWN, Cell(slit_width=0.0)),
    ("width_1nm", (0.7, 0.2, 15), DOWN, Cell(slit_width=1e-6)),
    ("wide_slit_3", (2.5, 0, 14), unit(-0.2, 0, -1), Cell(slit_width=3.0)),
    ("short_slit_y", (1.0, 0.1, 15), DOWN, Cell(slit_length=0.2)),
    ("y_partial", (0.5, 9.8, 15), unit(0, -0.4, -1), Cell()),
    ("y_off", (0.5, 10.6, 15), DOWN, Cell()),
    ("narrow_lobe_n50", (1, 0, 15), slanted(12), Cell(exponent=50.0)),
    ("grazing_n100", (0, 0, 15), slanted(-91.4756), Cell(exponent=100.0)),
    ("grazing_n150", (0, 0, 15), slanted(-90.98), Cell(exponent=150.0)),
    ("grazing_n200", (0, 0, 15), slanted(-89.782), Cell(exponent=200.0)),
    ("grazing_faint_n150", (0, 0, 15), slanted(-90.52), Cell(exponent=150.0)),
    ("slit_offset", (-1.2, 0.4, 16), unit(0.05, 0.1, -1), Cell(slit_x=0.35, slit_y=-0.2, dark_current=5e-9)),
]


def single_cells():
    parameters = {
        "length_mm": "length", "width_mm": "width", "slit_x_mm": "slit_x", "slit_y_mm": "slit_y",
        "slit_distance_mm": "slit_distance", "slit_width_mm": "slit_width", "slit_length_mm": "slit_length",
        "slit_thickness_mm": "thickness", "radiant_intensity_w_per_sr": "radiant_intensity",
        "responsivity_a_per_w": "responsivity", "profile_exponent": "exponent", "dark_current_a": "dark_current",
    }  # fmt: skip
    results = ["x_a_mm", "solid_angle_sr", "i_o_a", "i_x1_a", "i_x2_a"]
    yield ["name", "ex_mm", "ey_mm", "ez_mm", "ux", "uy", "uz", *parameters, "status"] + [
        f"{tier}_{column}" for tier in ("paper", "exact") for column in results
    ]
    for name, e, u, cell in SINGLE_CELLS:
        status, tiers = respond(cell, [mpf(q) for q in e], [mpf(q) for q in u])
        given = [digits(q) for q in (*e, *u, *(getattr(cell, field) for field in parameters.values()))]
        yield [name, *given, status, *(digits(value) for tier in tiers for value in tier)]


# Beams on the cell of the paper's bench that are hard for arithmetic, in metres: no light, the emitter's horizon within the
# spot, from afar, close above the slit, and nearly along the detector behind a low slit.
HEIGHT, SLIT, LENGTH = 15e-3, 7.5e-3, 12e-3


def extreme_beams():
    """Study, case, distance of the slit, emitter, and its axis."""
    down = (0.0, 0.0, -1.0)
    for case, x, z in (
        ("emitter in the slit's plane", 0.0, SLIT), ("emitter 1 nm behind it", 0.0, SLIT - 1e-9),
        ("emitter behind the detector", 0.0, -SLIT), ("spot beside the detector", 2 * LENGTH, HEIGHT),
    ):  # fmt: skip
        yield "no light", case, SLIT, (x, 0.0, z), down
    for share in (0.0, 0.5, 0.9, 0.99, 0.999):
        angle = 90 + share * math.degrees(math.atan(0.2e-3 / (HEIGHT - SLIT)))
        yield "horizon", f"axis at {angle:.3f}°", SLIT, (0.0, 0.0, HEIGHT), slanted(angle)
    for exponent in range(-1, 8):
        for aside in (0.0, 0.1)[: 1 + (exponent in (0, 2, 4, 6))]:
            case = f"emitter at 1e{exponent} m" + (f" and {aside * 10.0**exponent:g} m aside" if aside else "")
            yield "small solid angle", case, SLIT, (aside * 10.0**exponent, 0.0, 10.0**exponent), down
    for exponent in range(-3, -10, -1):
        # Past an edge of the slit, so that the spot ends on the detector: it hangs on a difference of nearly equal numbers.
        above = 10.0**exponent
        x = (0.2e-3 * (SLIT + above) - 0.25 * LENGTH * above) / SLIT
        yield "near field", f"emitter 1e{exponent} m above the slit", SLIT, (x, 0.0, SLIT + above), down
    for slit in (5e-3, 2e-3, 1e-3, 1e-4, 1e-5, 1e-6):
        reach = 0.4 * LENGTH
        angle = math.atan(reach / slit)
        axis = (-math.sin(angle), 0.0, -math.cos(angle))
        emitter = (-reach - HEIGHT * axis[0], 0.0, -HEIGHT * axis[2])
        yield "grazing light", f"incidence {math.degrees(angle):.3f}°", slit, emitter, axis


def extremes():
    yield ["study", "case", "slit_distance_m", "x_m", "y_m", "z_m", "axis_x", "axis_y", "axis_z", "status", "i_x1_a", "i_x2_a"]
    for study, case, slit, e, u in extreme_beams():
        cell = Cell(LENGTH, 1e-3, 0.0, 0.0, slit, 0.4e-3, 10e-3)
        status, (_, (*_, i_x1, i_x2)) = respond(cell, [mpf(q) for q in e], [mpf(q) for q in u])
        yield [study, case, *map(digits, (slit, *e, *u)), status, digits(i_x1), digits(i_x2)]


def rotation(vector):
    """exp of a rotation vector (Rodrigues)."""
    angle = norm(vector)
    if angle == 0:
        return mp.eye(3)
    x, y, z = [q / angle for q in vector]
    cross = matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return mp.eye(3) + sin(angle) * cross + (1 - cos(angle)) * cross * cross


def column(values):
    return matrix([mpf(q) for q in values])


def head(scene):
    """Of each cell: its parameters, rows x, y, z of its frame, detector, emitter and axis on the tool."""
    detector, slit, emitter = scene["detector"], scene["slit"], scene["emitter"]
    shared = Cell(
        length=detector["length_mm"], width=detector["width_mm"], responsivity=detector["responsivity_a_per_w"],
        dark_current=detector.get("dark_current_a", 0.0), slit_distance=slit["distance_mm"],
        slit_width=slit["width_mm"], slit_length=slit["length_mm"],
        radiant_intensity=emitter["radiant_intensity_w_per_sr"],
        exponent=log(mpf(1) / 2) / log(cos(radians(mpf(emitter["half_angle_deg"])))),
    )  # fmt: skip
    for cell in scene["cell"]:
        x, z, axis = [column(cell[key]) for key in ("x_axis", "normal", "emitter_axis")]
        x, z, axis = [v / norm(v) for v in (x, z, axis)]
        y = column([z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]])
        yield shared, matrix([list(x), list(y), list(z)]), column(cell["detector_mm"]), column(cell["emitter_mm"]), axis


# Home, the corners of what a head is built for, a step too small to see, far outside, upside down.
POSES = [
    (0, 0, 0, 0, 0, 0), (4, 0, 0, 0, 0, 0), (0, 0, -4, 0, 0, 0), (0, 0, 0, 0.26, 0, 0), (0, 0, 0, 0, 0, -0.26),
    (4, 4, 4, 0.26, 0.26, 0.26), (-4, 4, -4, -0.26, 0.26, 0.26), (1e-6, -2e-6, 1e-6, 1e-7, 0, -1e-7),
    (6, -5, 3, 0.4, -0.3, 0.35), (0, 0, 0, 0, 0, 3.1),
]  # fmt: skip


def six_cells(name, seed):
    scene = tomllib.loads((HERE / f"six_cell_{name}.toml").read_text())
    cells = list(head(scene))
    draw = random.Random(seed)
    within = [draw.uniform for _ in range(6)]
    poses = POSES + [tuple(u(-s, s) for u, s in zip(within, (4, 4, 4, 0.26, 0.26, 0.26))) for _ in range(20)]
    axes = ["tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad"]
    currents = [f"{tier}_i_x{j}_{k}_a" for tier in ("paper", "exact") for k in range(len(cells)) for j in (1, 2)]
    yield ["id", *axes, *(f"status_{k}" for k in range(len(cells))), *currents]
    for number, pose in enumerate(poses):
        turn, shift = rotation([mpf(q) for q in pose[3:]]), column(pose[:3])
        statuses, pairs = [], ([], [])
        for cell, frame, detector, emitter, axis in cells:
            e, u = frame * (turn * emitter + shift - detector), frame * (turn * axis)
            status, tiers = respond(cell, list(e), list(u))
            statuses.append(status)
            for pair, tier in zip(pairs, tiers):
                pair += [digits(tier[3]), digits(tier[4])]
        yield [f"{name}{number:02d}", *map(digits, pose), *statuses, *pairs[0], *pairs[1]]


def main():
    parser = argparse.ArgumentParser(description="Reference currents, by multi-precision arithmetic.")
    parser.add_argument("--check", action="store_true", help="compare with the tables instead of writing them")
    check = parser.parse_args().check
    tables = {
        "single_cell.csv": single_cells(),
        "six_cell_base_poses.csv": six_cells("base", 101),
        "six_cell_wide_poses.csv": six_cells("wide", 102),
        # For the report on extreme cases.
        "../../../host/design/src/report/extremes.csv": extremes(),
    }
    differing = []
    for name, rows in tables.items():
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        if not check:
            (HERE / name).write_text(text.getvalue())
        elif (HERE / name).read_text() != text.getvalue():
            differing.append(name)
    if differing:
        sys.exit(f"differ from what is computed: {', '.join(differing)}")


if __name__ == "__main__":
    main()
