"""Live poses: the datagrams of a daemon with a simulated board."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import time
from pathlib import Path
from typing import Iterator

import numpy as np
import pytest
import slitpose


@pytest.fixture(params=["unix", "udp", "shm"])
def daemon(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """An address, and the process that sends poses there."""
    wanted = "udp:127.0.0.1:0" if request.param == "udp" else f"{request.param}:{tmp_path}/pose"
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


def test_the_node_of_ros_publishes_poses_velocities_and_transforms(
    daemon: tuple[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With stand-ins for the packages of ROS."""

    class Message:
        def __init__(self, **values: object) -> None:
            self.__dict__.update(values)

        def __getattr__(self, name: str) -> "Message":
            return self.__dict__.setdefault(name, Message())

    published: dict[str, list[Message]] = {}
    node = Message(
        create_publisher=lambda _, topic, queue: Message(publish=published.setdefault(topic, []).append),
        destroy_node=lambda: None,
    )
    rclpy = Message(init=lambda: None, create_node=lambda _: node, ok=lambda: True, try_shutdown=lambda: None)
    names = ("PoseWithCovarianceStamped", "TransformStamped", "TwistWithCovarianceStamped", "TFMessage")
    kinds = Message(**{name: type(name, (Message,), {}) for name in names})
    for module in ("geometry_msgs.msg", "tf2_msgs.msg"):
        monkeypatch.setitem(sys.modules, module.split(".")[0], Message(msg=kinds))
        monkeypatch.setitem(sys.modules, module, kinds)
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    example = Path(__file__).parents[2] / "examples" / "ros2" / "slitpose_ros2.py"
    runpy.run_path(str(example))["main"]([daemon[0], "--rate", "50", "--duration", "2"])
    (board,) = {topic.split("/")[1] for topic in published if topic.startswith("slitpose/")}
    poses, twists = published[f"slitpose/{board}/pose"], published[f"slitpose/{board}/twist"]
    assert 20 <= len(poses) <= 101 and 0 < len(twists) <= len(poses) == len(published["/tf"])
    stamps = [pose.header.stamp.sec + 1e-9 * pose.header.stamp.nanosec for pose in poses]
    assert stamps == sorted(stamps)
    for pose, (transform,) in zip(poses, (message.transforms for message in published["/tf"])):
        position, orientation = pose.pose.pose.position, pose.pose.pose.orientation
        assert (pose.header.frame_id, transform.child_frame_id) == ("base", "tool")
        assert (position.x, orientation.w) == (transform.transform.translation.x, transform.transform.rotation.w)
        assert abs(position.x) < 0.01 and 0.5 < abs(orientation.w) <= 1.0
        assert np.linalg.eigvalsh(np.reshape(pose.pose.covariance, (6, 6)))[0] > 0
    assert all(len(twist.twist.covariance) == 36 and twist.twist.covariance[7] > 0 for twist in twists)


def test_addresses_that_cannot_be_are_refused(tmp_path: Path) -> None:
    for wrong in ("pose", "tcp:127.0.0.1:1", "udp:127.0.0.1", "unix:", "shm:"):
        with pytest.raises(ValueError, match="give unix:PATH"):
            slitpose.follow(wrong)
    for device in ("00", "zz" * 12):
        with pytest.raises(ValueError, match="24 hexadecimal"):
            slitpose.follow("unix:pose", device=device)
    for absent in ("unix", "shm"):
        with pytest.raises(slitpose.SlitposeError, match="--publish"):
            next(slitpose.follow(f"{absent}:{tmp_path}/absent"))
    (tmp_path / "other").write_bytes(b"SLPM of another version")
    with pytest.raises(slitpose.SlitposeError, match="no memory of poses of this version"):
        next(slitpose.follow(f"shm:{tmp_path}/other"))
    with pytest.raises(ValueError, match="no pose"):
        slitpose.LivePose.of(b"SLPP")
