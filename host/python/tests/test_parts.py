"""Parts of recordings: when they are the bits of the whole, and when they cannot be."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import slitpose
from test_replay import assert_equal


def parts(files: list[Path], cuts: list[float], **options: float) -> list[slitpose.Part]:
    ends = [None, *cuts, None]
    return [slitpose.replay_part(files, a, b, **options) for a, b in zip(ends[:-1], ends[1:])]  # type: ignore[arg-type]


@pytest.fixture
def several(command: object, tmp_path: Path) -> list[Path]:
    """One recording of two sessions: the same board with one head, then with another."""
    files = [tmp_path / "night-0001.mcap", tmp_path / "night-0002.mcap"]
    for file, scene in zip(files, ("wide", "fine")):
        # In real time: a recording goes on by UTC.
        run = ("run", "--device", "sim", "--config", "none", "--format", "none", "--scene", scene)
        command(*run, "--duration", "300ms", "--record", file)  # type: ignore[operator]
    return files


def test_parts_split_at_sessions_are_the_whole(several: list[Path]) -> None:
    cuts = slitpose.sessions(several)
    assert len(cuts) == 1
    found = parts(several, cuts)
    assert [len(part.poses) > 0 for part in found] == [True, True]
    assert slitpose.open_seams(found) == []
    assert_equal(slitpose.join(found), slitpose.replay(several))


def test_parts_split_elsewhere_agree_to_rounding_and_say_so(captures: Path) -> None:
    file = captures / "contact.mcap"
    whole, found = slitpose.replay(file), parts([file], [0.3, 0.6])
    assert slitpose.open_seams(found) == [1, 2]
    with pytest.raises(slitpose.SeamError) as error:
        slitpose.join(found)
    assert error.value.seams == (1, 2)
    joined = slitpose.join(found, same_bits=False)
    assert joined.sequence.tolist() == whole.sequence.tolist()  # type: ignore[union-attr]
    difference = np.abs(joined.translation_m - whole.translation_m)
    assert difference[found[0].poses.sequence].max() == 0  # type: ignore[index]
    assert 0 < np.nanmax(difference / whole.sigma[:, :3]) < 1e-6


def test_a_warm_up_from_the_beginning_closes_every_seam(captures: Path) -> None:
    file = captures / "contact.mcap"
    found = parts([file], [0.3, 0.6], warm_up_s=math.inf)
    assert_equal(slitpose.join(found), slitpose.replay(file))


def test_parts_with_gaps_are_refused(captures: Path) -> None:
    first, _, last = parts([captures / "contact.mcap"], [0.3, 0.6])
    with pytest.raises(ValueError, match="part 1 begins at 0.6"):
        slitpose.join([first, last])
    with pytest.raises(ValueError, match="no beginning"):
        slitpose.join([last])


def test_a_cluster_gives_the_bits_of_one_replay(captures: Path, tmp_path: Path) -> None:
    example = Path(__file__).parents[1] / "examples" / "dask_replay.py"
    done = subprocess.run([sys.executable, example, captures, tmp_path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name in ("contact", "smooth"):
        expected = slitpose.replay(captures / f"{name}.mcap").columns()
        found = np.load(tmp_path / f"{name}.npz")
        assert set(found) == set(expected)
        for column in found:
            np.testing.assert_array_equal(found[column], expected[column], err_msg=column)
