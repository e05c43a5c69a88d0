"""Poses of captures: the bits of the command."""

from __future__ import annotations

import pickle
import shutil
import signal
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import polars
import pytest
import slitpose
from conftest import Command, table

POSE = ["tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad"]


def numbers(rows: list[dict[str, str]], names: list[str]) -> np.ndarray:
    return np.array([[float(row[name] or "nan") for name in names] for row in rows])


def assert_same(poses: slitpose.Poses, rows: list[dict[str, str]]) -> None:
    """The same bits in all columns that both have."""
    assert len(poses) == len(rows) > 0
    scale = np.array([1e3] * 3 + [1.0] * 3)
    pose = np.hstack([poses.translation_m, poses.rotation_rad]) * scale
    np.testing.assert_array_equal(pose, numbers(rows, POSE))
    np.testing.assert_array_equal(poses.sigma * scale, numbers(rows, [f"sigma_{name}" for name in POSE]))
    for name in ("condition", "chi2", "iterations", "cells_used"):
        np.testing.assert_array_equal(getattr(poses, name), numbers(rows, [name])[:, 0], err_msg=name)
    assert [slitpose.Status(status).name for status in poses.status] == [row["status"] for row in rows]
    assert [poses.reasons[reason] for reason in poses.reason] == [row["reason"] for row in rows]
    if "sequence" in poses.columns():
        assert poses.sequence.tolist() == [int(row["seq"]) for row in rows]
        np.testing.assert_array_equal(poses.time_s, numbers(rows, ["device_time_s"])[:, 0])


@pytest.mark.parametrize(
    ("options", "arguments"),
    [
        ({}, []),
        ({"tier": "paper"}, ["--tier", "paper"]),
        ({"tolerance": 1e-4, "without_clipped": True}, ["--tolerance", "1e-4", "--without-clipped"]),
        ({"known_light": True}, ["--known-light"]),
        ({"from_s": 0.25, "to_s": 0.5}, ["--from", "250ms", "--to", "500ms"]),
        ({"duration_s": 0.125}, ["--duration", "125ms"]),
        ({"scene": "wide", "calibration": "none"}, ["--scene", "wide", "--calibration", "none"]),
    ],
)
def test_poses_are_the_bits_of_the_command(
    command: Command, captures: Path, options: dict[str, object], arguments: list[str]
) -> None:
    file = captures / "contact.mcap"
    rows = table(command("replay", file, "--format", "csv", *arguments).stdout)
    assert_same(slitpose.replay(file, **options), rows)  # type: ignore[arg-type]


def test_frame_tip_light_level_and_reasons_are_those_of_the_command(
    command: Command, captures: Path, tmp_path: Path
) -> None:
    jig = tmp_path / "jig.toml"
    jig.write_text("[user_from_base]\ntranslation_mm = [100, -20, 5]\nrotation_rad = [0.4, -1.2, 2]\n")
    file = captures / "contact.mcap"
    rows = table(command("replay", file, "--format", "csv", "--frame", jig, "--tip", "1,2,-80").stdout)
    poses = slitpose.replay(file, frame=str(jig), tip="1,2,-80")
    assert_same(poses, rows)
    truth = numbers(rows, [f"truth_{name}" for name in POSE[:3]])
    np.testing.assert_array_equal(poses.truth_translation_m * 1e3, truth)
    np.testing.assert_array_equal(poses.light_level, numbers(rows, ["light_level"])[:, 0])
    words = [poses.words["no_twist"][number] for number in poses.no_twist]
    assert words == [row["no_twist"] for row in rows] and {"", "start"} <= set(words)
    assert {row["frame"] for row in rows} == {"jig"}
    assert "light_level" in poses.describe()


def test_chunks_are_the_whole(captures: Path) -> None:
    file = captures / "contact.mcap"
    whole, chunks = slitpose.replay(file, filter_s=5e-3), list(slitpose.replay_chunks(file, 700, filter_s=5e-3))
    assert len(chunks) > 2
    assert_equal(slitpose.Poses.concatenate(chunks), whole)
    assert whole.filtered_translation_m is not None and whole.filtered_translation_m.shape == (len(whole), 3)


def assert_equal(found: slitpose.Poses, expected: slitpose.Poses) -> None:
    assert found.columns().keys() == expected.columns().keys() and found.devices == expected.devices
    for name, column in expected.columns().items():
        np.testing.assert_array_equal(found.columns()[name], column, err_msg=name)


def test_poses_are_near_the_truth_and_pickle(captures: Path) -> None:
    poses = slitpose.replay(captures / "contact.mcap")
    assert poses.truth_translation_m is not None and poses.simulated is not None and poses.simulated.all()
    error = (poses.translation_m - poses.truth_translation_m) / poses.sigma[:, :3]
    # Mean square of normal numbers, a few of which belong to frames in which the tool hits something.
    assert 0.8 < np.nanmean(error**2) < 1.25
    assert_equal(pickle.loads(pickle.dumps(poses)), poses)
    assert_equal(poses[poses.sequence < 10], poses[:10])  # type: ignore[operator]
    with pytest.raises(ValueError, match="no rows"):
        poses[3]


def test_errors_and_their_squares_are_those_of_the_command(command: Command, captures: Path, tmp_path: Path) -> None:
    """The printed numbers: rms of each axis in µm and µrad, and the mean NEES."""
    file, truth = captures / "contact.mcap", tmp_path / "truth.csv"
    command("simulate", "--trajectory", "contact", "--duration", "1s", "--output", tmp_path / "same.mcap", "--truth", truth)
    told = command("replay", file, "--compare", truth, "--format", "none").stderr.splitlines()
    rms = [float(next(line for line in told if f": {axis} " in line).split()[3]) for axis in "xyz"]
    poses = slitpose.replay(file)
    error = poses.error()
    np.testing.assert_allclose(np.sqrt((error**2).mean(axis=0))[:3] * 1e6, rms, atol=1e-3)
    assert f"mean NEES {poses.nees().mean():.2f} " in next(line for line in told if "NEES" in line)
    rows = table(truth.read_text())
    true = numbers(rows, POSE) * np.array([1e-3] * 3 + [1.0] * 3)
    np.testing.assert_allclose(poses.error(true[:, :3], true[:, 3:]), error, atol=1e-12)
    rest = slitpose.Scene.open("wide").solve(slitpose.open(file).currents_a[:3])
    with pytest.raises(ValueError, match="have no truth"):
        rest.error()
    with pytest.raises(ValueError, match="a pose for each row"):
        poses.error(true[:5, :3], true[:5, 3:])
    with pytest.raises(ValueError, match="give both"):
        poses.error(true[:, :3])
    covariance = rest.covariance.copy()
    covariance[1], rest.status[1] = np.nan, slitpose.Status.too_dark
    rest = rest._with({**rest.columns(), "covariance": covariance}, ())
    assert np.isnan(rest.nees(np.ones((3, 6)))).tolist() == [False, True, False]


def test_arrays_are_declared_and_the_absent_ones_say_why(captures: Path) -> None:
    names = [name for name, *_ in slitpose.poses._native.COLUMNS]
    poses = slitpose.replay(captures / "contact.mcap", filter_s=5e-3, to_s=0.1)
    declared = {name: kind for name, kind in slitpose.Poses.__annotations__.items()}
    assert list(declared) == names == list(poses.columns())
    for name, kind in declared.items():
        assert str(getattr(poses, name).dtype) == kind[len("NDArray[np.") : -1].rstrip("_"), name
    assert slitpose.Poses.__doc__ and all(name in slitpose.Poses.__doc__ for name in names)
    with pytest.raises(AttributeError, match="give filter_s"):
        slitpose.replay(captures / "contact.mcap", to_s=0.1).filtered_twist
    with pytest.raises(AttributeError, match="only poses of captures"):
        slitpose.Scene.open("wide").solve(np.full((1, 6, 2), 1e-6)).time_s
    with pytest.raises(AttributeError, match="no translation; see"):
        poses.translation  # type: ignore[attr-defined]


def test_frames_name_units(captures: Path) -> None:
    poses = slitpose.replay(captures / "contact.mcap", filter_s=5e-3)
    frame = poses.to_frame()
    assert len(frame) == len(poses) and frame["status"].dtype == "category"
    np.testing.assert_array_equal(frame["tx_m"], poses.translation_m[:, 0])
    np.testing.assert_array_equal(frame["sigma_rz_rad"], poses.sigma[:, 5])
    assert {"vx_m_per_s", "truth_tx_m", "filtered_rz_rad", "time_s", "host_utc"} <= set(frame.columns)


def test_tables_of_others_are_one_line(captures: Path, tmp_path: Path) -> None:
    poses, file = slitpose.replay(captures / "contact.mcap"), tmp_path / "poses.parquet"
    poses.to_frame().to_parquet(file)
    table = polars.from_pandas(poses.to_frame())
    assert table.equals(polars.read_parquet(file)) and table["status"].unique().to_list() == ["converged"]
    arrays = polars.DataFrame(poses.columns())
    np.testing.assert_array_equal(arrays["covariance"].to_numpy(), poses.covariance)


def test_currents_solve_to_nearly_the_same_poses(captures: Path) -> None:
    """A tool that hardly moves within a frame: then all currents belong to one instant."""
    file = captures / "smooth.mcap"
    scans, poses = slitpose.open(file), slitpose.replay(file)
    assert scans.sequence.tolist() == poses.sequence.tolist()  # type: ignore[union-attr]
    assert (scans.reading == slitpose.Reading.light).all()
    found = slitpose.Scene.open("fine").solve(scans.currents_a[:50])
    assert np.abs(found.translation_m - poses.translation_m[:50]).max() < 1e-4


def test_damage_is_told(command: Command, captures: Path, tmp_path: Path) -> None:
    data = bytearray((captures / "contact.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    file = tmp_path / "damaged.mcap"
    file.write_bytes(data)
    done = command("replay", file, "--format", "csv", code=3)
    with pytest.warns(slitpose.DataLossWarning) as caught:
        poses = slitpose.replay(file)
    assert_same(poses, table(done.stdout))
    assert poses.losses and all(loss in done.stderr.replace("\n", " ") or loss for loss in poses.losses)
    assert [str(warning.message) for warning in caught] == list(poses.losses)
    assert {warning.filename for warning in caught} == {__file__}
    for loss in poses.losses:
        assert f"slitpose: {loss}" in done.stderr
    with pytest.warns(slitpose.DataLossWarning) as caught:
        assert slitpose.open(file).losses == poses.losses
    assert {warning.filename for warning in caught} == {__file__}


def test_errors_are_those_of_the_command(command: Command, tmp_path: Path, captures: Path) -> None:
    nothing = tmp_path / "empty.mcap"
    nothing.write_bytes(b"")
    for file in (nothing, tmp_path / "absent.mcap"):
        done = command("replay", file, code=1)
        with pytest.raises(slitpose.SlitposeError) as error:
            slitpose.replay(file)
        assert done.stderr.strip() == f"slitpose: {error.value}"
    file = captures / "contact.mcap"
    for options, text in [
        ({"tier": "best"}, 'tier = "best"'),
        ({"tolerance": 2.0}, "tolerance = 2"),
        ({"from_s": -1.0}, "from_s = -1"),
        ({"from_s": 2.0, "to_s": 1.0}, "to_s = 1"),
    ]:
        with pytest.raises(ValueError, match=text):
            slitpose.replay(file, **options)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="'filter'.* are no options"):
        list(slitpose.replay_chunks(file, filter=1))  # type: ignore[call-arg]
    with pytest.raises(slitpose.SlitposeError, match="cannot read the frame"):
        slitpose.replay(file, frame=tmp_path / "absent.toml")
    with pytest.raises(slitpose.SlitposeError, match="begin earlier"):
        slitpose.replay(file, from_s=100.0)
    with pytest.raises(ValueError, match="2 recordings"):
        slitpose.replay(captures)


def test_edges_of_the_trigger_input_are_on_the_clock_of_the_poses(captures: Path) -> None:
    edges, poses = slitpose.edges(captures / "smooth.mcap"), slitpose.replay(captures / "smooth.mcap")
    # 40 Hz for half a second.
    assert len(edges) == 40 and edges.devices == poses.devices
    np.testing.assert_allclose(edges.time_s, np.arange(1, 41) / 80, atol=1e-8)
    assert edges.is_high.tolist() == [True, False] * 20
    assert edges.number.tolist() == list(range(40)) and not edges.missed.any()
    assert poses.time_s[0] < edges.time_s[0] and abs(poses.time_s[-1] - edges.time_s[-1]) < 1e-3
    assert len(slitpose.edges(captures / "contact.mcap")) == 0


def test_other_threads_run_meanwhile_and_interrupts_end_it(captures: Path, tmp_path: Path) -> None:
    files = [Path(shutil.copyfile(captures / "contact.mcap", tmp_path / f"{number}.mcap")) for number in range(200)]
    ticks = []

    def tick() -> None:
        for _ in range(4):
            time.sleep(0.05)
            ticks.append(time.monotonic())
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=tick)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        thread.start()
        with pytest.raises(KeyboardInterrupt):
            slitpose.replay(files)
            time.sleep(60.0)  # if it was done before
    thread.join()
    assert len(ticks) == 4
