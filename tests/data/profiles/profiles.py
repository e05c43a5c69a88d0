#!/usr/bin/env python3
"""Currents of single cells with narrow, tabulated and steep emission profiles, for profiles.csv.

Independent of the Rust program: the spot is clipped in long double (80 bits), cut into triangles and
integrated by collapsed 16x16 Gauss rules; each triangle is divided in four until the sum over all
triangles changes by less than 1e-13 of the current. Tables are interpolated as model/README.md says
("Two tiers"): parabolas through the points in v = 1 - cos(gamma), blended by a quintic step.

    python3 profiles.py            writes the table beside this file; minutes of one core, on all there are
    python3 profiles.py --check    computes it again and compares; with --every N only each Nth row

Needs numpy, and a processor whose long double has 80 bits. The seed is below.

Cell frame: detector in the plane z = 0, centred, x along its length. Lengths in mm, angles in degrees.
"""
import argparse
import concurrent.futures
import heapq
import pathlib
import sys

import numpy as np
from numpy.polynomial.legendre import leggauss

L = np.longdouble
TABLE = pathlib.Path(__file__).with_suffix(".csv")
SEED = 20180718
TOLERANCE = 1e-13
S_A_PER_W, I_E_W_PER_SR = L("0.54"), L("0.00316")


def rotation(vector):
    angle = np.sqrt((vector * vector).sum())
    if angle == 0:
        return np.eye(3, dtype=L)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=L)
    return np.eye(3, dtype=L) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def clipped(polygon, normal, offset):
    result = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1]):
        fa, fb = normal @ a + offset, normal @ b + offset
        if fa >= 0:
            result.append(a)
        if (fa >= 0) != (fb >= 0):
            result.append(a + (b - a) * (fa / (fa - fb)))
    return result


def spot(case):
    """The spot's corners in front of the emitter."""
    e, u = case["e"], case["u"]
    lx, ly = case["length"] / 2, case["width"] / 2
    polygon = [np.array(p, dtype=L) for p in ((-lx, -ly), (lx, -ly), (lx, ly), (-lx, ly))]
    turn = rotation(np.radians(case["tilt"]))
    centre = np.array([case["slit_x"], case["slit_y"], case["slit_distance"]], dtype=L)
    t = case["slit_thickness"]
    for z in (-t / 2, t / 2) if t > 0 else (L(0),):
        face = centre + turn[:, 2] * z
        corners = [
            face + turn[:, 0] * (i * case["slit_width"] / 2) + turn[:, 1] * (j * case["slit_length"] / 2) - e
            for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        for a, b in zip(corners, corners[1:] + corners[:1]):
            normal = np.cross(a, b)
            if normal @ (face - e) < 0:
                normal = -normal
            polygon = clipped(polygon, normal[:2], -(normal @ e))
            if len(polygon) < 3:
                return []
    return clipped(polygon, u[:2], -(u @ e))


class Power:
    def __init__(self, exponent):
        self.exponent = L(exponent)

    def __call__(self, c):
        return np.where(c > 0, np.maximum(c, L("1e-4000")) ** self.exponent, 0)


class Table:
    def __init__(self, points):
        points = [(np.radians(L(degrees)), L(value)) for degrees, value in points]
        if points[-1][0] < np.radians(L(90)):
            points.append((np.radians(L(90)), L(0)))
        v = np.array([2 * np.sin(gamma / 2) ** 2 for gamma, _ in points])
        y = np.array([value for _, value in points])
        h, d = np.diff(v), np.diff(y) / np.diff(v)
        m, q = np.zeros(len(v), L), np.zeros(len(v), L)
        for i in range(1, len(v) - 1):
            d1, d2, h1, h2 = d[i - 1], d[i], h[i - 1], h[i]
            if d1 * d2 <= 0:
                q[i] = np.sign(d2 - d1) * min(abs(d1) / h1, abs(d2) / h2)
                continue
            m[i] = (d1 * h2 + d2 * h1) / (h1 + h2)
            q[i] = (d2 - d1) / (h1 + h2)
            most = 2 * min(abs(d1), abs(d2))
            if abs(m[i]) > most:
                m[i] = np.sign(m[i]) * most
                q[i] = (m[i] - d1) / h1 if abs(d1) < abs(d2) else (d2 - m[i]) / h2
        if len(v) == 2:
            m[:] = d[0]
        else:
            m[0], m[-1] = 2 * d[0] - m[1], 2 * d[-1] - m[-2]
            q[0], q[-1] = (m[1] - d[0]) / h[0], (m[-1] - d[-1]) / h[-1]
        self.v, self.y, self.m, self.q = v, y, m, q

    def __call__(self, c):
        v = 1 - c
        i = np.clip(np.searchsorted(self.v, v, side="right") - 1, 0, len(self.v) - 2)

        def parabola(k):
            t = v - self.v[k]
            return self.y[k] + t * (self.m[k] + t * self.q[k])

        s = (v - self.v[i]) / (self.v[i + 1] - self.v[i])
        step = s**3 * (10 - 15 * s + 6 * s * s)
        return np.where(c > 0, parabola(i) + step * (parabola(i + 1) - parabola(i)), 0)


def gauss(n):
    """Nodes and weights on 0..1, in long double."""
    x = leggauss(n)[0].astype(L)
    for _ in range(4):
        before, value = np.ones_like(x), x.copy()
        for k in range(2, n + 1):
            before, value = value, ((2 * k - 1) * x * value - (k - 1) * before) / k
        slope = n * (x * value - before) / (x * x - 1)
        x = x - value / slope
    return (1 + x) / 2, 1 / ((1 - x * x) * slope * slope)


NODE, WEIGHT = gauss(16)
XI = np.outer(NODE, np.ones_like(NODE))
ETA = np.outer(NODE, NODE)
WEIGHTS = np.outer(WEIGHT * NODE, WEIGHT)


def of_triangle(triangle, case, profile):
    """Integrals of I_rel h/r^3 and of that times x."""
    p, q, r = triangle
    x = p[0] + XI * (q[0] - p[0]) + ETA * (r[0] - q[0])
    y = p[1] + XI * (q[1] - p[1]) + ETA * (r[1] - q[1])
    twice_area = abs((q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1]))
    e, u = case["e"], case["u"]
    dx, dy = x - e[0], y - e[1]
    r2 = dx * dx + dy * dy + e[2] ** 2
    distance = np.sqrt(r2)
    cosine = (u[0] * dx + u[1] * dy - u[2] * e[2]) / distance
    f = WEIGHTS * twice_area * profile(cosine) * e[2] / (r2 * distance)
    return np.array([f.sum(), (f * x).sum() / case["length"]])


def integrals(case, profile):
    polygon = spot(case)
    if len(polygon) < 3:
        return None
    heap, count = [], 0

    def push(triangle, value, depth):
        nonlocal count
        p, q, r = triangle
        a, b, c = (p + q) / 2, (q + r) / 2, (r + p) / 2
        parts = [(p, a, c), (a, q, b), (c, b, r), (a, b, c)]
        values = [of_triangle(part, case, profile) for part in parts]
        total = sum(values)
        # Four divisions at least: a lobe must not hide between nodes.
        error = abs(total - value).max() if depth > 3 else L("1e300")
        count += 1
        heapq.heappush(heap, (-error, count, parts, values, total, depth))

    for i in range(1, len(polygon) - 1):
        triangle = (polygon[0], polygon[i], polygon[i + 1])
        push(triangle, of_triangle(triangle, case, profile), 0)
    while True:
        error = -sum(entry[0] for entry in heap)
        total = sum(entry[4] for entry in heap)
        if error <= TOLERANCE * total[0]:
            return total
        if count > 40000:
            return None
        for _ in range(max(1, len(heap) // 20)):
            _, _, parts, values, _, depth = heapq.heappop(heap)
            for part, value in zip(parts, values):
                push(part, value, depth + 1)


# A power with errors of up to 0.002, too rough to be the rounding of a smooth function.
ROUGH_TABLE = [(a, round(float(np.cos(np.radians(a)) ** 1.247 - 0.001 * (a * 7 // 5 % 5 - 2)), 4)) for a in range(0, 90, 5)]
BUMPY_TABLE = [(0, 1), (10, 0.9), (20, 0.6), (30, 0.75), (40, 0.5), (50, 0.45), (60, 0.2), (70, 0.1)]
SMOOTH_TABLE = [(0, 1), (20, 0.925), (40, 0.7), (60, 0.4), (75, 0.1)]
STEEP_TABLE = [(0, 1), (7.16, 1.042), (19.63, 0.731), (21.51, 1.076), (29.02, 0.796), (59.16, 0.509), (75.23, 0)]
NARROW_TABLE = [(0, 1), (1, 0.97), (2, 0.88), (4, 0.6), (6, 0.3), (8, 0.1), (10, 0.02), (15, 0)]
OPEN_TABLE = [(0, 0.3), (30, 0.8), (60, 1), (90, 0.5)]
PROFILES = [1.247, 3.9, 4.1, 20, 45, 193.553, 1000, 4550.3, 20000] + [
    ROUGH_TABLE, BUMPY_TABLE, SMOOTH_TABLE, STEEP_TABLE, NARROW_TABLE, OPEN_TABLE
]


def cases():
    """An ordinary cell and a wide one with each profile: straight, aside, turned, tilted, thick."""
    rng = np.random.default_rng(SEED)
    for profile in PROFILES:
        for wide in (False, True):
            for k in range(4):
                a = lambda half: L(round(float(rng.uniform(-half, half)), 3))
                case = dict(length=L(12), width=L(5 if wide else 1), slit_x=a(0.3), slit_y=a(0.3))
                case["slit_distance"] = L(1 if wide else 5)
                case["slit_width"], case["slit_length"] = L(4 if wide else 0.6), L(10)
                case["slit_thickness"] = L("0.25") if k == 2 else L(0)
                case["tilt"] = np.array([a(12), a(12), a(40)] if k == 3 else [0, 0, 0], dtype=L)
                case["e"] = np.array([a(1.5), a(1), L("2.3") + abs(a(1)) if wide else 15 + a(3)], dtype=L)
                turn = 0 if k == 0 else 1.2 if k == 1 and not isinstance(profile, list) and profile < 5 else 0.3
                u = np.array([a(turn), a(turn), -1], dtype=L)
                case["u"] = u / np.sqrt(u @ u)
                yield profile, case


def number(value):
    return f"{np.float64(value):.17g}"


COLUMNS = "ex ey ez ux uy uz length width slit_x slit_y slit_distance slit_width slit_length slit_thickness".split()
GIVEN = ["id", *COLUMNS, "tilt_x", "tilt_y", "tilt_z", "profile"]
CURRENTS = ["i_o_a", "i_x1_a", "i_x2_a"]


def row(numbered):
    """A row of the table, or none of a spot that no light reaches or that takes too many triangles."""
    index, (profile, case) = numbered
    # What the file holds is what is computed.
    for key in ("e", "u"):
        case[key] = case[key].astype(np.float64).astype(L)
    falloff = Table(profile) if isinstance(profile, list) else Power(profile)
    sums = integrals(case, falloff)
    if sums is None:
        return None
    i_o, moment = S_A_PER_W * I_E_W_PER_SR * sums
    text = " ".join(f"{a}:{b}" for a, b in profile) if isinstance(profile, list) else str(profile)
    given = [*case["e"], *case["u"], *(case[key] for key in COLUMNS[6:]), *case["tilt"]]
    return [str(index), *map(number, given), text, *map(number, [i_o, i_o / 2 - moment, i_o / 2 + moment])]


def is_same(computed, written):
    """What is given, character by character; currents within the tolerance of each of the two."""
    now, then = [[float(value) for value in values[len(GIVEN) :]] for values in (computed, written)]
    near = all(abs(a - b) <= 2 * TOLERANCE * then[0] for a, b in zip(now, then))
    return computed[: len(GIVEN)] == written[: len(GIVEN)] and len(now) == len(then) and near


def main():
    parser = argparse.ArgumentParser(description="Currents of narrow, steep and tabulated profiles.")
    parser.add_argument("--check", action="store_true", help="compare with the table instead of writing it")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="compare each Nth row only")
    options = parser.parse_args()
    if options.every > 1 and not options.check:
        parser.error("--every goes with --check")
    with concurrent.futures.ProcessPoolExecutor() as pool:
        chosen = list(enumerate(cases()))[:: options.every]
        rows = [GIVEN + CURRENTS, *filter(None, pool.map(row, chosen))]
    if not options.check:
        TABLE.write_text("".join(",".join(values) + "\n" for values in rows))
        return
    written = [line.split(",") for line in TABLE.read_text().splitlines()]
    indices = {str(index) for index, _ in chosen}
    written = written[:1] + [values for values in written[1:] if values[0] in indices]
    if rows[0] != written[0] or len(rows) != len(written):
        sys.exit(f"{TABLE.name} has other rows or columns than what is computed")
    differing = [now[0] for now, then in zip(rows[1:], written[1:]) if not is_same(now, then)]
    if differing:
        sys.exit(f"{TABLE.name} differs from what is computed in rows {', '.join(differing)}")


if __name__ == "__main__":
    main()
