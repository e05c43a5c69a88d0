#!/usr/bin/env python3
"""Predicts with slitpose what published instruments measure, and prints it beside what they did.

`intervals.csv` has what a source states (intervals without width) and what it leaves open. SAMPLES instruments are
drawn from the intervals (Latin hypercube, seeded), made into scenes from the TOML files beside this program, and given
to `slitpose model`, `solve` and `scene check`. Every quantity is computed from what those print. `measured.csv` has what
was measured. The only argument is another number of draws.
"""

import csv
import functools
import json
import math
import os
import random
import statistics
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).resolve().parent
SEED, SAMPLES = 1, 24
SLITPOSE = os.environ.get("SLITPOSE", "slitpose")


def rows(name):
    return list(csv.DictReader((HERE / name).open(encoding="utf-8")))


def draws(instrument, shared=None):
    """SAMPLES dictionaries of parameters: each interval is cut into SAMPLES parts, each part is used once."""
    chance = random.Random(f"{SEED} {instrument}")
    drawn = [{} for _ in range(SAMPLES)]
    for row in rows("intervals.csv"):
        if row["instrument"] not in (instrument, shared):
            continue
        low, high = float(row["low"]), float(row["high"])
        parts = list(range(SAMPLES))
        chance.shuffle(parts)
        for values, part in zip(drawn, parts):
            share = (part + chance.random()) / SAMPLES
            is_ratio = row["law"] == "ratio"
            values[row["parameter"]] = low * (high / low) ** share if is_ratio else low + (high - low) * share
    return drawn


def scene_of(name):
    return tomllib.loads((HERE / f"{name}.toml").read_text(encoding="utf-8"))


def toml(scene):
    """The scene as text; JSON writes the values that occur in scenes as TOML does."""
    lines = [f"name = {json.dumps(scene['name'])}"]
    for key, value in scene.items():
        for table in value if isinstance(value, list) else [value] if isinstance(value, dict) else []:
            lines.append(f"[[{key}]]" if isinstance(value, list) else f"[{key}]")
            lines += [f"{name} = {json.dumps(item)}" for name, item in table.items()]
    return "\n".join(lines) + "\n"


@functools.cache
def slitpose(text, *command, table=None):
    """What `slitpose` prints for a scene: `SCENE` and `TABLE` in the command become files with `text` and `table`."""
    with tempfile.TemporaryDirectory() as folder:
        files = {"SCENE": Path(folder, "scene.toml"), "TABLE": Path(folder, "table.csv")}
        files["SCENE"].write_text(text, encoding="utf-8")
        files["TABLE"].write_text(table or "", encoding="utf-8")
        command = [SLITPOSE, *(str(files.get(word, word)) for word in command)]
        run = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "SLITPOSE_CONFIG": "none"})
    if run.returncode:
        raise SystemExit(f"{' '.join(command)}: {run.stderr}")
    return run.stdout


def currents(scene, translations, tier="exact"):
    poses = [f"{k},{','.join(map(repr, map(float, at)))},0,0,0" for k, at in enumerate(translations)]
    table = "\n".join(["id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad", *poses])
    return slitpose(toml(scene), "model", "SCENE", "--poses", "TABLE", "--tier", tier, table=table)


def model(scene, translations, tier="exact"):
    table = csv.DictReader(currents(scene, translations, tier).splitlines())
    return [{k: float(v) for k, v in row.items() if k[:2] in ("x_", "i_") and v} for row in table]


def sigma_um(scene):
    """σ of a position at home by `[noise]`, mean of the axes."""
    table = currents(scene, [(0, 0, 0)])
    pose = next(csv.DictReader(slitpose(toml(scene), "solve", "SCENE", "--currents", "TABLE", table=table).splitlines()))
    return statistics.mean(float(pose[f"sigma_{axis}_mm"]) for axis in ("tx", "ty", "tz")) * 1e3


def check(scene, samples):
    command = ("scene", "check", "SCENE", "--format", "json", "--samples", str(samples), "--jobs", "1")
    return json.loads(slitpose(toml(scene), *command))


def bench(p):
    """Experiment 1: what the paper's equations say for its drawing, against currents of a bench as it may have been."""
    poses = [(0.5 * k - 5.5, 0.0, 0.0) for k in range(23)]
    ideal = scene_of("bench")
    del ideal["slit"]["thickness_mm"]
    calculated = [row["x_a_0_mm"] for row in model(ideal, poses, "paper")]
    real = scene_of("bench")
    real["slit"] |= {"distance_mm": p["slit_distance"], "offset_mm": [p["slit_lateral"], 0.0]}
    real["window"] = {"thickness_mm": p["resin"], "refractive_index": p["resin_index"]}
    real["cell"][0]["emitter_mm"] = [p["chip_lateral"], 0.0, p["chip_depth"]]
    real["detector"]["nonlinearity_mm"] = [0.0, 0.0, p["nonlinearity_even"], p["nonlinearity_odd"]]
    current = model(real, [(0.0, 0.0, 0.0)])[0]["i_o_0_a"]
    real["stray"] = {"current_a": p["stray"] * current, "centre_mm": 0.0}
    half = real["detector"]["length_mm"] / 2
    shown = [half * (row["i_x2_0_a"] - row["i_x1_0_a"]) / (row["i_x1_0_a"] + row["i_x2_0_a"]) for row in model(real, poses)]
    error = [abs(a - b) for a, b in zip(shown, calculated)]
    inner = [e for e, pose in zip(error, poses) if abs(pose[0]) < 4.0]
    return {"mean error": statistics.mean(error), "largest error": max(error), "smallest error": min(error),
            "mean error within ±4 mm": statistics.mean(inner)}


def amplifier_noise(p):
    """Noise of one electrode's current. The noise voltages of two amplifiers drive the resistance between them: each
    adds e/R to one current and takes it from the other. Independent noise of 2·e/R an electrode moves the position as
    much."""
    return 2.0 * p["amplifier"] * math.sqrt(p["bandwidth"]) / p["resistance"]


def psd(p):
    scene = scene_of("psd")
    scene["detector"] |= {"length_mm": p["length"], "interelectrode_ohm": p["resistance"]}
    light = model(scene, [(0.0, 0.0, 0.0)])[0]["i_o_0_a"]
    scene["emitter"]["radiant_intensity_w_per_sr"] *= p["photocurrent"] / light
    scene["noise"] |= {"bandwidth_hz": p["bandwidth"], "adc_a": amplifier_noise(p)}
    resolution = math.sqrt(2.0) * sigma_um(scene)
    # Added after the comparison: the sheets' rule counts the shot noise of the whole current in one electrode.
    shot = math.sqrt(2.0 * 1.602176634e-19 * p["photocurrent"] * p["bandwidth"])
    shot_um = p["length"] * 1e3 * shot / p["photocurrent"]
    return {"resolution": resolution, "resolution, shot noise added": math.hypot(resolution, shot_um)}


def triangulation(p):
    """(near − middle)/(middle − far) of the position: no gain, offset or place of the detector changes it."""
    scene = scene_of("triangulation")
    scene["slit"] |= {"distance_mm": p["focal_length"], "focal_length_mm": p["focal_length"]}
    scene["emitter"]["source_diameter_mm"] = p["patch"]
    scene["cell"][0]["detector_mm"] = [p["base"], 0.0, -p["lens_depth"] - p["focal_length"]]
    near, middle, far = (row["x_a_0_mm"] for row in model(scene, [(0.0, 0.0, p[k]) for k in ("near", "middle", "far")]))
    return {"(near − middle)/(middle − far)": (near - middle) / (middle - far)}


def space_mouse(p):
    """Counts by deflection. A value along x or y is the sum of the codes of two or three detectors, each with its sign."""
    travel = p["travel"]
    home, x, y, single = model(scene_of("spacemouse"), [(0, 0, 0), (travel, 0, 0), (0, travel, 0), (0, travel, 0)])
    span = 2.0 * p["span"] * abs(single["x_a_0_mm"] - home["x_a_0_mm"])
    codes = [sum(abs(at[f"x_a_{k}_mm"] - home[f"x_a_{k}_mm"]) for k in range(3)) * p["codes"] / span for at in (x, y)]
    return {"counts per mm, three detectors": codes[1] / travel, "counts per mm, two detectors": codes[0] / travel,
            "ratio of the two ranges": codes[1] / codes[0]}


def place_lens(scene, p, reach, radius):
    """Lens and detector along each cell's normal, sharp; light at `fill` of the detector's half when moved by `reach`."""
    distance = p["lens_distance"] * p["fill"] * p["length"] / 2.0 / reach
    scene["detector"] |= {"length_mm": p["length"], "width_mm": p["length"], "interelectrode_ohm": p["resistance"]}
    scene["slit"] |= {"distance_mm": distance, "diameter_mm": p["lens_diameter"],
                      "focal_length_mm": 1.0 / (1.0 / p["lens_distance"] + 1.0 / distance)}
    scene["emitter"]["radiant_intensity_w_per_sr"] = p["intensity"]
    for cell in scene["cell"]:
        if "normal" in cell:
            cell["detector_mm"] = [-c * (radius + p["lens_distance"] + distance) for c in cell["normal"]]


def maglev(p):
    scene = scene_of("maglev")
    radius = p["emitter_radius"]
    place_lens(scene, p, 12.5 + radius * math.radians(7.5), radius)
    for cell in scene["cell"]:
        if "normal" in cell:
            cell["emitter_mm"] = [-c * radius for c in cell["normal"]]
    bits = round(p["adc_bits"])
    scene["front_end"] |= {"adc_bits": bits, "raw_noise_lsb": p["raw_noise"], "full_scale_a": 1.0}
    largest = max(cell["most_electrode_a"] for cell in check(scene, 64)["coverage"]["cells"])
    scene["front_end"]["full_scale_a"] = p["headroom"] * largest
    return {"resolution": statistics.mean(check(scene, 1)["sigma_at_home"][:3]) * 1e6}


def asap(p):
    scene = scene_of("asap")
    half = math.radians(p["verging"] / 2.0)
    for cell in scene["cell"]:
        if "normal" in cell:
            cell["normal"] = [math.copysign(math.sin(half), cell["normal"][0]), -math.cos(half), 0.0]
    place_lens(scene, p, 15.0 * math.sqrt(2.0), 0.0)
    p = {**p, "bandwidth": p["bandwidth"] * p["rate"]}
    scene["noise"] |= {"bandwidth_hz": p["bandwidth"], "adc_a": amplifier_noise(p)}
    return {"peak to peak": p["peak_to_peak"] * sigma_um(scene)}


# Which intervals an instrument shares, and what predicts it.
INSTRUMENTS = {"bench": (None, bench), "Space Mouse": (None, space_mouse), "maglev": (None, maglev),
               "ASAP": ("any ASAP", asap), "Micron": ("any ASAP", asap)}
FAMILIES = {"S": ("any PSD", psd), "GP2": ("any GP2Y", triangulation)}


@functools.cache
def predict(instrument):
    shared, function = INSTRUMENTS.get(instrument) or next(f for k, f in FAMILIES.items() if instrument.startswith(k))
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(function, draws(instrument, shared)))
    return {name: sorted(result[name] for result in results) for name in results[0]}


def digits(value):
    return f"{value:.2g}" if value < 100.0 else f"{value:.0f}"


def main():
    global SAMPLES
    SAMPLES = int(sys.argv[1]) if len(sys.argv) > 1 else SAMPLES
    print(f"{SAMPLES} draws of each instrument, seed {SEED}: median (least … greatest)")
    print(f"{'instrument':12}{'quantity':33}{'unit':>5}{'measured':>9}{'predicted':>10}{'':18}{'ratio':>5}  status")
    for row in rows("measured.csv"):
        values, measured = predict(row["instrument"])[row["quantity"]], float(row["measured"])
        median = statistics.median(values)
        print(f"{row['instrument']:12}{row['quantity']:33}{row['unit']:>5}{measured:>9.4g}{digits(median):>10}"
              f" {f'({digits(values[0])} … {digits(values[-1])})':17}{median / measured:>5.2f}  {row['status']}")


if __name__ == "__main__":
    main()
