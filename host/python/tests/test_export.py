"""Heads to make: places by the scene, closed solids, clearance, light, and what is refused.

Needs the extra `cad` (`host/python/run --cad`); without it these tests are skipped, except those of the refusal.
`SLITPOSE_POSES=10000 host/python/run --cad` checks contact at as many poses (500 unless given).
"""

from __future__ import annotations

import csv
import dataclasses
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import slitpose
from conftest import Command
from part21 import Face, Float, Part21

MICROMETRE = 1e-3
MICRORADIAN = 1e-6
HEADS = ("orderable", "wide", "fine", "redundant", "base")
POSES = int(os.environ.get("SLITPOSE_POSES", "500"))
#: `base` has no workspace of its own and is the tightest: half of the default box is checked.
SHARES = {"base": 0.5}

WITHOUT = "import sys; sys.modules['build123d'] = None; sys.argv = ['export', 'wide', '--output', 'x'];"


def test_without_the_kernel_the_next_step_is_named(tmp_path: Path) -> None:
    text = f"{WITHOUT} import runpy; runpy.run_module('slitpose.export', run_name='__main__')"
    done = subprocess.run([sys.executable, "-P", "-c", text], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1 and "pip install 'slitpose[cad]'" in done.stderr, done.stderr


def test_the_command_without_the_package_names_the_next_step(command: Command, tmp_path: Path) -> None:
    fake = tmp_path / "python"
    fake.write_text("#!/bin/sh\nexit 1\n")
    fake.chmod(0o755)
    done = command("scene", "export", "wide", "--python", fake, "--output", tmp_path / "head", code=1)
    assert "host/python/run --wheel" in done.stderr and "slitpose[cad]" in done.stderr


cad = pytest.importorskip("build123d", reason="needs the extra `cad`: host/python/run --cad")

from slitpose.export import checks, command as export_command, drawings, files  # noqa: E402
from slitpose.export.head import HeadParts, head  # noqa: E402
from slitpose.export.jig import JigParts, jig  # noqa: E402
from slitpose.export.layout import Layout, rotation  # noqa: E402
from slitpose.export.sizes import ExportError, Sizes  # noqa: E402
from slitpose.export.solids import MIN_ENGAGEMENT, THREAD, Joint, Placed, location, rod  # noqa: E402


@dataclasses.dataclass
class Made:
    parts: HeadParts
    placed: list[Placed]

    def one(self, name: str, instance: int | None = None) -> Placed:
        return next(part for part in self.placed if part.name.startswith(name) and part.instance == instance)


def made(name: str, sizes: Sizes = Sizes()) -> Made:
    parts = HeadParts(Layout.of(slitpose.Scene.open(name), sizes), sizes)
    return Made(parts, head(parts, parts.layout.poses(2000)))


@pytest.fixture(scope="module", params=HEADS)
def any_head(request: pytest.FixtureRequest) -> tuple[str, Made]:
    return request.param, made(request.param)


@pytest.fixture(scope="module")
def orderable() -> Made:
    return made("orderable")


@pytest.fixture(scope="module")
def folder(command: Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command writes for `orderable` with its jig."""
    out = tmp_path_factory.mktemp("export") / "head"
    done = command(
        "scene", "export", "orderable", "--jig", "--python", sys.executable, "--poses", "50", "--output", out
    )
    assert "0 of 50 poses" in done.stdout and "no part" not in done.stdout
    return out


def cells(toml: str) -> list[dict[str, dict[str, Any]]]:
    """Detector, slit, emitter and the cell's own keys, read here from the scene's text."""
    scene = tomllib.loads(toml)
    sections = ("detector", "slit", "emitter")
    return [{"cell": cell} | {name: scene[name] | cell.get(name, {}) for name in sections} for cell in scene["cell"]]


def angle(a: Float, b: Float) -> float:
    return float(np.linalg.norm(np.cross(a, b) / np.linalg.norm(a) / np.linalg.norm(b)))


def in_base(name: str, found: dict[str, tuple[Float, list[Face]]], sides: tuple[float, float]) -> Face:
    """The face of a part with these sides, in the base frame."""
    base_from_part, faces = found[name]
    (face,) = [face for face in faces if np.allclose(sorted(face.sides), sorted([*sides, *sides]), atol=1e-6)]
    turn = base_from_part[:3, :3]
    return Face(face.corners @ turn.T + base_from_part[:3, 3], turn @ face.normal)


def misplaced(found: dict[str, tuple[Float, list[Face]]], toml: str) -> list[str]:
    """Slits, active areas and chips of an assembly that are farther than 1 µm or 1 µrad from the scene."""
    wrong = []
    for number, cell in enumerate(cells(toml)):
        place, slit, area = cell["cell"], cell["slit"], cell["detector"]
        centre, x, z = (np.array(place[key], dtype=float) for key in ("detector_mm", "x_axis", "normal"))
        y = np.cross(z, x)
        (mask,) = [
            name for name in found if name.startswith("mask ") and name.endswith(f" {number}") and len(name) <= 9
        ]
        thickness = slit.get("thickness_mm", 0.1)
        base_from_part, faces = found[mask]
        corners = np.concatenate([face.corners for face in faces]) @ base_from_part[:3, :3].T + base_from_part[:3, 3]
        middle = centre + slit["distance_mm"] * z
        expected = [
            middle + a * slit["width_mm"] / 2 * x + b * slit["length_mm"] / 2 * y + c * thickness / 2 * z
            for a in (1, -1)
            for b in (1, -1)
            for c in (1, -1)
        ]
        far = max(float(np.linalg.norm(corners - corner, axis=1).min()) for corner in expected)
        sides = [face for face in faces if np.isclose(max(face.sides), slit["length_mm"])]
        turned = max(angle(base_from_part[:3, :3] @ face.normal, x) for face in sides)
        if far > MICROMETRE or turned > MICRORADIAN or len(faces) != 4 or len(sides) != 2:
            wrong.append(f"slit {number}: {far:.6f} mm, {turned:.2e} rad")
        active = in_base(f"detector {number}", found, (area["length_mm"], area["width_mm"]))
        edge = next(
            b - a
            for a, b in zip(active.corners, np.roll(active.corners, -1, axis=0))
            if np.isclose(np.linalg.norm(b - a), area["length_mm"])
        )
        far, turned = float(np.linalg.norm(active.centre - centre)), max(angle(active.normal, z), angle(edge, x))
        if far > MICROMETRE or turned > MICRORADIAN or active.normal @ z < 0:
            wrong.append(f"detector {number}: {far:.6f} mm, {turned:.2e} rad")
        chip = in_base(f"emitter {number}", found, (0.3, 0.3))
        axis = np.array(place["emitter_axis"], dtype=float)
        far, turned = float(np.linalg.norm(chip.centre - place["emitter_mm"])), angle(chip.normal, axis)
        if far > MICROMETRE or turned > MICRORADIAN or chip.normal @ axis < 0:
            wrong.append(f"emitter {number}: {far:.6f} mm, {turned:.2e} rad")
    return wrong


def test_slits_detectors_and_emitters_of_the_step_file_are_where_the_scene_says(
    any_head: tuple[str, Made], tmp_path: Path
) -> None:
    name, found = any_head
    files.write_assembly(
        [part for part in found.placed if part.name.startswith(("mask ", "detector", "emitter"))], tmp_path, "assembly"
    )
    read = Part21(tmp_path / "assembly.step").placed()
    toml = slitpose.Scene.open(name).toml
    assert misplaced(read, toml) == []
    # A part that is 1.5 µm or 2 µrad off is found.
    for part, change in (("detector 1", (3, 1.5e-3)), ("emitter 0", (2, 1.5e-3))):
        base_from_part, faces = read[part]
        shifted = base_from_part.copy()
        shifted[change[0] % 3, 3] += change[1]
        assert len(misplaced({**read, part: (shifted, faces)}, toml)) == 1
    base_from_part, faces = read["detector 2"]
    turn = np.eye(4)
    turn[0, 1], turn[1, 0] = -2e-6, 2e-6
    assert len(misplaced({**read, "detector 2": (base_from_part @ turn, faces)}, toml)) == 1


def test_solids_are_closed_apart_and_at_least_as_thick_as_a_wall(any_head: tuple[str, Made]) -> None:
    _, found = any_head
    assert checks.faults(found.placed) == [] and checks.overlaps(found.placed) == []
    for name, part in files.distinct(found.placed).items():
        if part.made and not name.startswith("mask ") or "frame" in name:
            assert checks.thinnest(part.solid) >= checks.MIN_WALL - 0.01, name


def test_parts_that_hold_each_other_touch(any_head: tuple[str, Made]) -> None:
    _, found = any_head
    ring, carrier = found.one("base ring").in_place, found.one("emitter carrier").in_place
    for cell in found.parts.layout.cells:
        block = found.one("cell block", cell.number).in_place
        mask, frame, detector, board, emitter, small = (
            found.one(name, cell.number).in_place
            for name in ("mask ", "mask frame", "detector", "detector board", "emitter", "emitter board")
        )
        pairs = (
            (block, ring),
            (mask, block),
            (frame, mask),
            (detector, block),
            (board, detector),
            (emitter, small),
            (small, carrier),
        )
        assert max(a.distance_to(b) for a, b in pairs) < 1e-6


def test_screws_engage_and_do_not_bottom(any_head: tuple[str, Made]) -> None:
    """Each screw as a solid in its hole: of its drill's width it meets nothing, of its own only its thread."""
    parts, placed = any_head[1].parts, any_head[1].placed
    cell, sizes, jigs = parts.layout.cells[0], parts.sizes, JigParts(parts)
    block, carrier = location(cell.detector, cell.base_from_block), location(cell.emitter, cell.tool_from_emitter)
    cover = parts.flange_rear - sizes.block.board_gap - sizes.block.board_thickness - sizes.block.cover_height
    flange, down = parts.tool_heights[1] + sizes.tool.flange_thickness, cad.Rot(180, 0, 0)
    seats = [
        block * cad.Pos(0, sizes.block.ring_screw, parts.flange_rear),
        block * cad.Pos(sizes.block.corner, sizes.block.ring_screw, cover),
        cad.Pos(*parts.corner_holes()[0], parts.plate_underside),
        cad.Pos(*parts.tool_screws()[0], flange) * down,
        carrier * cad.Pos(0, sizes.emitter.screw_distance, -sizes.emitter.source_height) * down,
        cad.Pos(*parts.corner_holes()[0], jigs.deck_top) * down,
    ]
    solids = [*(part.in_place for part in placed if not part.name.startswith("screw")), jigs.deck()]
    for joint, seat in zip([*parts.joints(), *jigs.joints()], seats):
        diameter, drill = float(joint.thread[1:]), THREAD[joint.thread]

        def shared(radius: float, length: float) -> float:
            body = rod(radius, 0.1, length).moved(seat)
            meets = [solid.intersect(body) for solid in solids if solid.distance_to(body) < 1e-6]
            return sum(solid.volume for common in meets if common is not None for solid in common.solids())

        assert shared(drill / 2 - 0.05, joint.length + max(joint.free - 0.1, 0.0)) < 1e-6, joint
        engaged = shared(diameter / 2, joint.length) / (np.pi / 4 * (diameter**2 - drill**2))
        assert engaged >= MIN_ENGAGEMENT * diameter - 0.02, (joint, engaged)
        assert joint.length - joint.grip - engaged < 0.35, (joint, engaged)


def test_no_standard_length_is_an_error() -> None:
    for grip, hole in ((8.3, 2.1), (30.0, 9.0)):
        with pytest.raises(ExportError, match=f"must be {grip + 1.6:.1f} to {grip + hole - 0.5:.1f} mm long"):
            Joint("M2", 1, "cover", grip, hole).length
    assert [Joint("M2", 1, "cover", 8.3, hole).length for hole in (2.2, 2.6, 5.0)] == [10, 10, 12]


def test_the_tip_stays_in_the_room_under_the_plate(any_head: tuple[str, Made]) -> None:
    parts, tool = any_head[1].parts, any_head[1].parts.sizes.tool
    translation, turned = parts.layout.poses(2000)
    tips = translation + turned @ [0.0, 0.0, tool.tip_z]
    reach = np.linalg.norm(tips[:, :2], axis=1).max(), parts.plate_underside - tips[:, 2].min()
    share = (np.array(reach) + tool.tip_ball_radius) / parts.tip_room
    assert 0.7 < share.min() and share.max() <= 1.0 and parts.tip_room[1] <= JigParts(parts).standoff


def test_drawings_have_signs_and_the_heights_of_the_scene(orderable: Made) -> None:
    layout = orderable.parts.layout
    for cell, title in zip(layout.cells, ("block (turned +135 deg)", "block (turned -135 deg)")):
        assert drawings.block_sheet(orderable.parts, cell, "block", cad.Box(20, 30, 5), "").title == title
    raised = [dataclasses.replace(cell, detector=cell.detector + [0.0, 0.0, -1.5]) for cell in layout.cells]
    parts = HeadParts(dataclasses.replace(layout, cells=raised), Sizes())
    assert "above A by 16, z = -1.5 of the scene" in " ".join(drawings.ring_sheet(parts, cad.Box(50, 50, 32), "").notes)


def test_tool_touches_the_housing_at_no_pose(any_head: tuple[str, Made]) -> None:
    name, found = any_head
    share = SHARES.get(name, 1.0)
    layout = found.parts.layout
    translation, turned = layout.poses(POSES)
    found_clearance = checks.clearance(found.placed, (share * translation, turned))
    print(f"{name}: {found_clearance}")
    assert found_clearance.colliding == 0 and found_clearance.least > checks.MIN_GAP
    if share < 1.0:
        whole = checks.clearance(found.placed, (translation, turned))
        print(f"{name}, default box: {whole}")
        assert whole.least < checks.MIN_GAP


def test_light_meets_no_part(any_head: tuple[str, Made]) -> None:
    _, found = any_head
    traced = checks.light(found.parts.layout, found.placed, found.parts.layout.poses(150))
    assert traced.rays > 1000 and traced.blocked == 0, traced


def test_parts_in_the_way_too_thin_or_too_large_are_found(orderable: Made) -> None:
    layout = orderable.parts.layout
    pin = orderable.one("mask pin", 0)
    # A part of another cell.
    in_the_light = dataclasses.replace(pin, instance=3, base_from_part=cad.Pos(20, 0, 2) * cad.Rot(0, 90, 0))
    traced = checks.light(layout, [*orderable.placed, in_the_light], layout.poses(50))
    assert traced.blocked > 0 and traced.by == ("mask pin 3",)
    collar = Placed("collar", cad.Cylinder(18.0, 4.0), cad.Location(), on_tool=True)
    assert checks.clearance([*orderable.placed, collar], layout.poses(50)).colliding > 0
    assert any(
        "collar" in pair
        for pair in checks.overlaps([*orderable.placed, dataclasses.replace(collar, solid=cad.Cylinder(22.0, 4.0))])
    )
    assert checks.thinnest(cad.Box(10, 10, 5) - cad.Pos(0, 0, 0.5) * cad.Box(8.6, 8.0, 5)) == pytest.approx(
        0.5, abs=1e-3
    )
    two = cad.Box(1, 1, 1) + cad.Pos(3, 0, 0) * cad.Box(1, 1, 1)
    assert checks.faults([Placed("two", two, cad.Location())]) == ["two: 2 bodies, valid, 2.000 mm³"]


def test_balls_rest_in_their_vees_and_the_stage_moves_freely(orderable: Made) -> None:
    jigs = JigParts(orderable.parts)
    fixture = jig(jigs)
    assert checks.overlaps([*orderable.placed, *fixture]) == []
    nest = next(part.in_place for part in fixture if part.name == "jig nest")
    for ball in (part for part in fixture if part.name == "ball"):
        assert nest.distance_to(ball.in_place) < 1e-6
        lowered = ball.in_place.moved(cad.Pos(0, 0, -0.01)).intersect(nest)
        assert sum(solid.volume for solid in lowered.solids()) > 0.0
    foot, tip = (
        next(part.in_place for part in [*fixture, *orderable.placed] if part.name == name)
        for name in ("jig foot", "tip")
    )
    assert foot.distance_to(tip) < 1e-6
    steps = np.linspace(-jigs.size.steps, jigs.size.steps, 7)
    on_stage = [
        dataclasses.replace(part, on_tool=True) if part.name == "jig nest" else part
        for part in fixture
        if part.name != "gauge block"
    ]
    # A hair above the deck, on which it slides.
    poses = np.stack([steps, 0 * steps, 0 * steps + 0.02], axis=1), np.tile(np.eye(3), (7, 1, 1))
    named = {part.name: part for part in fixture}
    for in_the_way in ("jig foot", "jig deck"):
        met = checks.clearance([*orderable.placed, named[in_the_way]], orderable.parts.layout.poses(50))
        assert met.colliding > 0, in_the_way
    tilts = np.array(
        [rotation(np.radians(4 * np.array(axis))) for axis in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))]
    )
    tip = np.array([0.0, 0.0, orderable.parts.sizes.tool.tip_z])
    pivot = tip - tilts @ tip + [0.0, 0.0, 0.15], tilts  # above the facets of cone and ball
    assert checks.clearance([*orderable.placed, named["jig foot"]], pivot).colliding == 0
    without_foot = [part for part in on_stage if part.name != "jig foot"]
    free = np.array([[0.01, 0.06, 0.0]])
    moved = poses[0] + free * np.sign(np.abs(steps))[:, None]
    assert checks.clearance([*orderable.placed, *without_foot], (moved, poses[1])).colliding == 0


def test_motions_that_the_jig_allows_calibrate_a_head(command: Command, tmp_path: Path) -> None:
    """Stage, cone and nest with the sizes of the jig, free motion, and the noise of the front end; a perfect jig."""
    command("bench", "orderable", "--output", tmp_path / "head", "--poses", "60", "--duration", "1s")
    scene = slitpose.Scene.open("orderable")
    true = scene.with_calibration(slitpose.calibrate("orderable", known=tmp_path / "head" / "known.csv"))
    noise, sizes = np.random.default_rng(3), Sizes()

    def write(name: str, translation: Float, turned: Float, frames: int, steps_mm: Float | None = None) -> Path:
        currents = true.model(translation, turned).currents_a
        sigma = 32.5e-6 / 4031 * np.sqrt(2 / 8 / frames)  # one code, eight conversions, lit minus dark
        currents = currents + sigma * noise.standard_normal(currents.shape)
        rows = [
            [row, *([] if steps_mm is None else [steps_mm[row]]), *it.ravel(), frames]
            for row, it in enumerate(currents)
        ]
        head = [
            "id",
            *([] if steps_mm is None else ["step_mm"]),
            *(f"i_x{e}_{k}_a" for k in range(6) for e in (1, 2)),
            "frames",
        ]
        with (tmp_path / name).open("w", newline="") as file:
            csv.writer(file).writerows([head, *rows])
        return tmp_path / name

    def path(extent: float, count: int) -> Float:
        """Smooth motion within an extent."""
        rate, phase = noise.uniform(12, 56, (3, 3, 1)), noise.uniform(0, 6.3, (3, 3, 1))
        return np.asarray(extent / 3 * np.sin(rate * np.linspace(0, 1, count) + phase).sum(axis=0).T)

    home, askew = np.array([0.15e-3, -0.1e-3, 0.12e-3]), np.radians([0.4, -0.3, 0.5])
    steps = np.arange(-sizes.jig.steps, sizes.jig.steps + 0.1, 0.5)
    along = home + np.outer(1e-3 * steps, [1, 0, 0])
    tip = np.array([0, 0, 1e-3 * sizes.tool.tip_z])
    tilts = np.radians(noise.uniform([-4, -4, -15], [4, 4, 15], (60, 3)))
    found = slitpose.calibrate(
        scene,
        free=write("free.csv", path(3.3e-3, 600), path(np.radians(15), 600), 1),
        stage=write("stage.csv", along, np.tile(askew, (len(steps), 1)), 100, steps - steps[0]),
        rest=write("rest.csv", np.tile(home, (20, 1)), np.tile(askew, (20, 1)), 100),
        pivot=write("pivot.csv", np.array([home + tip - rotation(tilt) @ tip for tilt in tilts]), tilts, 100),
    )
    places, turns = path(3e-3, 400), path(np.radians(14), 400)
    currents = true.model(places, turns).currents_a

    def error_um(head: slitpose.Scene) -> float:
        poses = head.solve(currents).translation_m
        lengths = [np.linalg.norm(points[7:] - points[:-7], axis=1) for points in (poses, places)]
        return float(1e6 * np.sqrt(np.mean((lengths[0] - lengths[1]) ** 2)))

    before, after = error_um(scene), error_um(scene.with_calibration(found))
    print(f"displacements err by {before:.1f} um rms before, {after:.2f} um after")
    assert before > 20 and 0.1 < after < 4


def test_files_are_complete_and_agree_with_the_scene(folder: Path) -> None:
    rows = list(csv.DictReader((folder / "bill.csv").open(encoding="utf-8")))
    count = {row["item"]: int(row["quantity"]) for row in rows}
    assert (
        count["detector"] == count["emitter"] == count["cover"] == 6
        and count["cell block A"] + count["cell block B"] == 6
    )
    assert (count["screw M2x10"], count["screw M2x5"], count["screw M2.5x6"]) == (18, 6, 12)
    assert count["mask pin"] == 12 and count["jig deck"] == 1 and count["ball"] == 3
    page = (folder / "index.html").read_text(encoding="utf-8")
    for row in rows:
        assert not row["file"] or (folder / row["file"]).stat().st_size > 1000 and row["file"] in page
        assert row["kind"] == "bought" or (folder / row["file"]).with_suffix(".svg").exists()
    assert "No head has been built or measured" in page and f"{slitpose.Scene.open('orderable').hash:#018x}" in page
    for motion, mounted in (
        ("free", "nothing else"),
        ("pivot", "foot below"),
        ("rest", "no foot"),
        ("stage", "no foot"),
    ):
        row_of = re.search(f"<tr><td>--{motion}</td><td>(.*?)</td>", page)
        assert row_of and mounted in row_of[1], motion
    for picture in ("assembly", "exploded", "section", "cell", "jig", "jig_exploded"):
        assert (folder / f"{picture}.png").read_bytes().startswith(b"\x89PNG") and f"{picture}.png" in page
    for drawing in folder.glob("*.svg"):
        texts = [element.text or "" for element in ElementTree.parse(drawing).iter("{http://www.w3.org/2000/svg}text")]
        assert any("no part of this drawing has been made" in text for text in texts), drawing.name
    block = (folder / "cell_block_A.svg").read_text(encoding="utf-8")
    assert "4.35 +-0.02" in block and "d_B = 5." in block


def test_masks_of_the_dxf_have_the_slit_of_the_scene(folder: Path) -> None:
    lines = [line.strip() for line in (folder / "mask_A.dxf").read_text(encoding="utf-8").splitlines()]
    pairs = list(zip(lines[::2], lines[1::2]))
    start = pairs.index(("0", "LWPOLYLINE"), pairs.index(("2", "ENTITIES")))
    end = next(at for at in range(start + 1, len(pairs)) if pairs[at][0] == "0")
    x, y = ([float(value) for code, value in pairs[start:end] if code == wanted] for wanted in ("10", "20"))
    assert max(x) - min(x) == pytest.approx(0.6, abs=1e-9) and max(y) - min(y) == pytest.approx(10.0, abs=1e-9)
    assert sum(x) == pytest.approx(0.0, abs=1e-9) and sum(y) == pytest.approx(0.0, abs=1e-9)
    assert ("8", "CUT") in pairs[start:end] and any("0.6 +-0.012 x 10" in value for _, value in pairs)


def test_parts_that_the_sizes_were_not_made_for_are_named(orderable: Made, capsys: pytest.CaptureFixture[str]) -> None:
    export_command.warn_of_other_parts(orderable.parts.layout, Sizes())
    assert capsys.readouterr().err == ""
    export_command.warn_of_other_parts(dataclasses.replace(orderable.parts.layout, detector_part="S3931"), Sizes())
    assert "warning: the scene's detector is S3931; the sizes are those of S3932" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("scene", "reason"),
    [("maglev", "a lens"), ("spacemouse", "a slit on the tool"), ("bench", "at least 3")],
)
def test_scenes_that_no_ring_can_hold_are_refused(
    scene: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export_command.run([scene, "--output", str(tmp_path / "head")]) == 1
    message = capsys.readouterr().err
    assert reason in message and "choose another scene" in message and not (tmp_path / "head").exists()


def test_scenes_and_sizes_that_cannot_be_made_are_refused_with_their_numbers(tmp_path: Path) -> None:
    toml = slitpose.Scene.open("wide").toml
    for old, new, reason in (
        ("distance_mm = 5.0", "distance_mm = 2.0", "slit.distance_mm = 2"),
        (
            "normal = [-1.0, 0.0, 0.0]\nemitter",
            "normal = [-0.8, 0.424264068711929, -0.424264068711928]\nemitter",
            "component -0.424264 along z",
        ),
        (
            "normal = [-1.0, 0.0, 0.0]\nemitter",
            "normal = [1.0, 0.0, 0.0]\nemitter",
            "normal points away from the z axis",
        ),
        ("width_mm = 0.6", "width_mm = 0.6\ntilt_deg = [2.0, 0.0, 0.0]", "slit.tilt_deg = [2, 0, 0]"),
        ("width_mm = 0.6", "width_mm = 0.6\ntilt_deg = [0.0, 0.0, 1.0]", "turn its detector with it"),
    ):
        changed = toml.replace(old, new)
        assert changed != toml
        with pytest.raises(ExportError, match=re.escape(reason)):
            parts = HeadParts(Layout.of(slitpose.Scene.from_toml(changed, "changed"), Sizes()), Sizes())
            head(parts, parts.layout.poses(10))
    sizes = tmp_path / "sizes.toml"
    for text, reason in (
        ("detector.breadth = 5.0", "no size 'breadth'"),
        ("detector.length = true", "length = True"),
        ("x", "sizes.toml"),
        ("\xff", "sizes.toml: 'utf-8' codec"),
        ("detector.length = nan", "sizes.toml, detector: length = nan must be positive"),
        ("detector.length = inf", "length = inf"),
        ("block.plate = 0", "plate = 0 must be positive"),
        ("ring.half_height = -16", "half_height = -16 must be positive"),
        ("tool.tip_z = 40", "tip_z = 40 must be negative"),
    ):
        sizes.write_text(text, encoding="latin-1")
        with pytest.raises(ExportError, match=reason):
            Sizes.open(sizes)
    sizes.write_text("detector.length = 16.2\ntool.tip_z = -50\n")
    found = Sizes.open(sizes)
    assert (found.detector.length, found.tool.tip_z, found.detector.width) == (16.2, -50.0, 5.0)
