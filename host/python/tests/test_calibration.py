"""Calibrations: the file that the command writes."""

from __future__ import annotations

import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
import slitpose
from conftest import Command


def test_a_calibration_is_that_of_the_command(command: Command, tmp_path: Path) -> None:
    bench, output = tmp_path / "bench", tmp_path / "head.toml"
    command("bench", "wide", "--output", bench)
    known = bench / "known.csv"
    command("calibrate", "wide", "--known", known, "--output", output)
    scene = slitpose.Scene.open("wide")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", slitpose.SlitposeWarning)
        found = slitpose.calibrate("wide", known=known)
    assert found.toml == output.read_text()
    statistics = found.statistics
    assert statistics["rows"] > 100 and 0.5 < statistics["chi2"] / statistics["redundancy"] < 1.5
    parameters = found.parameters()
    assert (parameters["sigma"] <= parameters["prior_sigma"] * 1.001).all()
    again = pickle.loads(pickle.dumps(found))
    assert again.id == found.id == slitpose.Calibration.open(output).id

    head = scene.with_calibration(output)
    assert head.is_calibrated and pickle.loads(pickle.dumps(head)).is_calibrated
    nominal, real = (of.model([0, 0, 0], [0, 0, 0]).currents_a for of in (scene, head))
    assert not np.array_equal(nominal, real)
    with pytest.raises(slitpose.SlitposeError):
        slitpose.Scene.open("fine").with_calibration(found)
    with pytest.raises(slitpose.SlitposeError, match="no row"):
        slitpose.calibrate(scene)
    with pytest.raises(ValueError, match="known_sigma_m = 0"):
        slitpose.calibrate(scene, known=known, known_sigma_m=0.0)
