"""Live poses: the datagrams of a daemon with a simulated board."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path
from typing import Iterator

import numpy as np
import pytest
import slitpose


@pytest.fixture(params=["unix", "udp"])
def daemon(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """An address, and the process that sends poses there."""
    wanted = f"unix:{tmp_path}/pose" if request.param == "unix" else "udp:127.0.0.1:0"
    words = [os.environ["SLITPOSE"], "run", "--device", "sim", "--config", "none", "--format", "none", "--publish", wanted]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
    assert process.stderr is not None
    try:
        # Its first line names the address, with the port.
        yield process.stderr.readline().split()[-1], process
    finally:
        process.terminate()
        process.communicate()


def test_poses_come_in_order(daemon: tuple[str, object]) -> None:
    address, _ = daemon
    poses = []
    for pose in slitpose.follow(address, timeout_s=60.0):
        poses.append(pose)
        if len(poses) == 200:
            break
    assert len(poses) == 200
    numbers = [pose.datagram for pose in poses]
    assert numbers == sorted(set(numbers))
    for pose in poses:
        assert pose.simulated and pose.status <= slitpose.Status.degraded
        assert abs(np.linalg.norm(pose.rotation_xyzw) - 1) < 1e-9 and np.linalg.norm(pose.translation_m) < 0.01
        assert pose.covariance.shape == (6, 6) and (np.diag(pose.covariance) > 0).all()
        np.testing.assert_array_equal(pose.covariance, pose.covariance.T)
        np.testing.assert_allclose(pose.sigma**2, np.diag(pose.covariance))
        assert np.sin(np.linalg.norm(pose.rotation_rad) / 2) == pytest.approx(np.linalg.norm(pose.rotation_xyzw[:3]))
    of_other = slitpose.follow(address, device="00" * 11 + "01", timeout_s=0.3)
    assert list(of_other) == []


def test_it_ends_after_its_duration_or_with_the_daemon(daemon: tuple[str, "subprocess.Popen[str]"]) -> None:
    address, process = daemon
    since_s = time.monotonic()
    for pose in slitpose.follow(address, duration_s=0.5):
        assert time.monotonic() - since_s < 30.0
    assert pose.simulated and time.monotonic() - since_s >= 0.5
    with pytest.raises(slitpose.SlitposeError, match="has ended after [1-9].* again$"):
        for pose in slitpose.follow(address, timeout_s=60.0):
            process.terminate()


def test_addresses_that_cannot_be_are_refused(tmp_path: Path) -> None:
    for wrong in ("pose", "tcp:127.0.0.1:1", "udp:127.0.0.1", "unix:"):
        with pytest.raises(ValueError, match="give unix:PATH"):
            slitpose.follow(wrong)
    for device in ("00", "zz" * 12):
        with pytest.raises(ValueError, match="24 hexadecimal"):
            slitpose.follow("unix:pose", device=device)
    with pytest.raises(slitpose.SlitposeError, match="--publish"):
        next(slitpose.follow(f"unix:{tmp_path}/absent"))
    with pytest.raises(ValueError, match="no pose"):
        slitpose.LivePose.of(b"SLPP")
