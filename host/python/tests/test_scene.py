"""Scenes: the bits of `model` and `solve`, bounds, pictures."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import slitpose
from conftest import Command, table
from test_replay import assert_same

WIDE = slitpose.Scene.open("wide")


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    """Some of which some cells are dark or clipped; millimetres and radians, as the command takes them."""
    chance = np.random.default_rng(7)
    return chance.uniform(-1, 1, (60, 6)) * [6.0, 6.0, 6.0, 0.4, 0.4, 0.4]


@pytest.mark.parametrize("tier", ["exact", "paper"])
def test_currents_and_their_poses_are_the_bits_of_the_command(
    command: Command, tmp_path: Path, poses: np.ndarray, tier: str
) -> None:
    file, currents = tmp_path / "poses.csv", tmp_path / "currents.csv"
    lines = [f"{number}," + ",".join(repr(float(x)) for x in row) for number, row in enumerate(poses)]
    file.write_text("\n".join(["id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad", *lines]) + "\n")
    command("model", "wide", "--poses", file, "--tier", tier, "--output", currents)
    rows = table(currents.read_text())
    response = WIDE.model(poses[:, :3] * 1e-3, poses[:, 3:], tier=tier)
    for cell in range(WIDE.cells):
        column = {name: [row[f"{name}_{cell}{unit}"] for row in rows] for name, unit in
                  [("status", ""), ("flags", ""), ("x_a", "_mm"), ("solid_angle", "_sr"), ("i_o", "_a"),
                   ("i_x1", "_a"), ("i_x2", "_a")]}  # fmt: skip
        assert [slitpose.CellStatus(status).name for status in response.status[:, cell]] == column["status"]
        flags = [";".join(flag.name or "" for flag in slitpose.Flag if flag & bits) for bits in response.flags[:, cell]]
        assert flags == column["flags"]
        for found, name in [(response.x_a_m * 1e3, "x_a"), (response.solid_angle_sr, "solid_angle"), (response.i_o_a, "i_o"),
                            (response.currents_a[..., 0], "i_x1"), (response.currents_a[..., 1], "i_x2")]:  # fmt: skip
            expected = np.array([float(value or "nan") for value in column[name]])
            np.testing.assert_array_equal(found[:, cell], expected, err_msg=f"{name}_{cell}")
    solved = table(command("solve", "wide", "--currents", currents, "--tier", tier).stdout)
    assert len({row["status"] for row in solved}) > 1, "some poses are to have dark cells"
    assert_same(WIDE.solve(response.currents_a, tier=tier), solved)


def test_results_do_not_depend_on_the_number_of_cores(poses: np.ndarray) -> None:
    translation_m, rotation_rad = np.tile(poses[:, :3] * 1e-3, (5, 1)), np.tile(poses[:, 3:], (5, 1))
    results = []
    for cores in (1, 3):
        slitpose.limit_cores(cores)
        response = WIDE.model(translation_m, rotation_rad)
        solved = WIDE.solve(response.currents_a)
        results.append((response.currents_a, solved.status, solved.translation_m, solved.rotation_rad, solved.covariance))
    for one, three in zip(*results):
        np.testing.assert_array_equal(one, three)
    with pytest.raises(ValueError, match="cores = 0"):
        slitpose.limit_cores(0)


def test_derivatives_are_those_of_the_currents() -> None:
    step = 1e-6
    at = WIDE.derivatives([0, 0, 0], [0, 0, 0])
    for axis in range(6):
        offset = np.zeros(6)
        offset[axis] = step
        pair = [WIDE.model(sign * offset[:3], sign * offset[3:]).currents_a[0] for sign in (1, -1)]
        np.testing.assert_allclose(at.derivatives[0, :, :, axis], (pair[0] - pair[1]) / (2 * step), rtol=1e-4, atol=1e-9)


def test_rotations_may_be_quaternions_of_length_one() -> None:
    vectors = [[0.1, -0.2, 0.3], [0, 0, 0]]
    from slitpose import _native

    turned = _native.quaternions(np.array(vectors))
    np.testing.assert_allclose(_native.rotation_vectors(turned), vectors, atol=1e-15)
    a, b = WIDE.model(np.zeros((2, 3)), vectors), WIDE.model(np.zeros((2, 3)), turned)
    np.testing.assert_allclose(a.currents_a, b.currents_a, rtol=1e-12)
    with pytest.raises(ValueError, match="row 1 has the length 2"):
        WIDE.model(np.zeros((2, 3)), [[0, 0, 0, 1], [0, 0, 0, 2]])


def test_frames_and_missing_cells_count() -> None:
    currents = WIDE.model([0, 0, 0], [0, 0, 0]).currents_a
    one, many = WIDE.solve(currents), WIDE.solve(currents, frames=100)
    # The part of the noise that all frames share is not averaged.
    assert ((one.sigma / many.sigma > 9) & (one.sigma / many.sigma <= 10)).all()
    missing = currents.copy()
    missing[0, 2] = np.nan
    fewer = WIDE.solve(missing)
    masked = WIDE.solve(np.ma.masked_array(currents, np.isnan(missing)))
    np.testing.assert_array_equal(masked.translation_m, fewer.translation_m)
    with pytest.raises(ValueError, match="row 0 is not finite"):
        WIDE.model(np.ma.masked_array(np.zeros((1, 3)), [[0, 1, 0]]), np.zeros((1, 3)))
    assert fewer.cells_used[0] == 5 and fewer.reasons[fewer.reason[0]] == "fewer_cells"
    rows = np.repeat(currents, 3, axis=0)
    rows[1, 2, 0] = np.inf
    rows[2] = -np.inf
    some = WIDE.solve(rows)
    assert list(some.cells_used) == [6, 5, 0] and np.isnan(some.translation_m).any(axis=1).tolist() == [False, False, True]
    with pytest.warns(slitpose.SlitposeWarning, match="unobservable 1.*are the currents amperes") as caught:
        WIDE.solve(currents * 1e6)
    with pytest.warns(slitpose.SlitposeWarning, match="are these metres") as also:
        WIDE.model([1.0, 0.0, -2.0], [0, 0, 0])
    assert {warning.filename for warning in [*caught, *also]} == {__file__}
    with pytest.raises(ValueError, match=r"\(1, 6, 2\)"):
        WIDE.solve(currents[:, :5])
    with pytest.raises(ValueError, match=r"frames\[0\] = 0"):
        WIDE.solve(currents, frames=0)


def test_the_bound_is_what_solving_reaches(captures: Path) -> None:
    file = captures / "contact.mcap"
    poses = slitpose.replay(file)[::100]
    bound = WIDE.crlb(poses.truth_translation_m, poses.truth_rotation_xyzw)  # type: ignore[arg-type]
    assert bound.covariance.shape == (len(poses), 6, 6)
    np.testing.assert_allclose(np.sqrt(np.diagonal(bound.covariance, axis1=1, axis2=2)), bound.sigma)
    # A tool in motion is known a little less well than one at rest.
    ratio = poses.sigma[:, :3] / bound.sigma[:, :3]
    assert 0.95 < np.median(ratio) < 1.3
    workspace = WIDE.map(50)
    assert (np.abs(np.hstack([workspace.translation_m, workspace.rotation])) <= WIDE.workspace).all()


def test_scenes_are_read_and_refused(tmp_path: Path) -> None:
    assert "wide" in slitpose.SCENES and slitpose.Scene.from_toml(WIDE.toml, "wide").hash == WIDE.hash
    again = pickle.loads(pickle.dumps(WIDE))
    assert again.toml == WIDE.toml and repr(again) == repr(WIDE)
    with pytest.raises(slitpose.SlitposeError, match="mine.toml"):
        slitpose.Scene.from_toml("cells = 3", "mine.toml")
    with pytest.raises(slitpose.SlitposeError):
        slitpose.Scene.open(tmp_path / "absent.toml")
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        WIDE.model([0, 0], [0, 0, 0])


def test_pictures_are_those_of_the_command(command: Command, tmp_path: Path) -> None:
    file = tmp_path / "wide.svg"
    command("scene", "plot", "wide", "--output", file)
    picture = WIDE.plot()
    assert picture._repr_svg_() == file.read_text()
    picture.save(tmp_path / "again.svg")
    assert (tmp_path / "again.svg").read_text() == picture.svg
    with pytest.raises(ValueError, match="cells 0 to 5"):
        WIDE.plot(cell=6)
