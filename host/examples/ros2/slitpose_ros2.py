#!/usr/bin/env python3
"""Poses of a running slitpose as a node of ROS 2, with whichever middleware ROS uses.

    slitpose run --publish udp:127.0.0.1:7452
    python3 slitpose_ros2.py udp:127.0.0.1:7452 --rate 100

Needs ROS 2 (rclpy, geometry_msgs, tf2_msgs) and the package slitpose in the same Python. What is published: host/ROS.md.
"""

from __future__ import annotations

import argparse
from typing import Any, Sequence

import rclpy
import slitpose
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, TwistWithCovarianceStamped
from tf2_msgs.msg import TFMessage

#: Messages that wait for a slow subscriber.
QUEUE = 10


def stamp(header: Any, pose: slitpose.LivePose, frame: str) -> None:
    """The instant of the scan: UTC, or the board's time since its start while that is unknown."""
    time_ns = round(pose.time_s * 1e9) if pose.host_utc_ns is None else pose.host_utc_ns
    header.stamp.sec, header.stamp.nanosec = divmod(time_ns, 1_000_000_000)
    header.frame_id = frame


def place(to: Any, numbers: Sequence[float], names: str = "xyz") -> None:
    for name, number in zip(names, numbers):
        setattr(to, name, float(number))


class Board:
    """The topics of one board."""

    def __init__(self, node: Any, device: str, frame: str, tool: str) -> None:
        self.frame, self.tool, self.due_s = frame, tool, -float("inf")
        topic = f"slitpose/board_{device}"
        self.poses = node.create_publisher(PoseWithCovarianceStamped, f"{topic}/pose", QUEUE)
        self.twists = node.create_publisher(TwistWithCovarianceStamped, f"{topic}/twist", QUEUE)
        self.transforms = node.create_publisher(TFMessage, "/tf", QUEUE)

    def publish(self, pose: slitpose.LivePose) -> None:
        if pose.status > slitpose.Status.degraded:
            return
        message = PoseWithCovarianceStamped()
        stamp(message.header, pose, self.frame)
        place(message.pose.pose.position, pose.translation_m)
        place(message.pose.pose.orientation, pose.rotation_xyzw, "xyzw")
        message.pose.covariance = pose.covariance.ravel().tolist()
        self.poses.publish(message)
        transform = TransformStamped(child_frame_id=self.tool)
        stamp(transform.header, pose, self.frame)
        place(transform.transform.translation, pose.translation_m)
        place(transform.transform.rotation, pose.rotation_xyzw, "xyzw")
        self.transforms.publish(TFMessage(transforms=[transform]))
        if pose.twist[0] != pose.twist[0]:
            return
        message = TwistWithCovarianceStamped()
        stamp(message.header, pose, self.frame)
        place(message.twist.twist.linear, pose.twist[:3])
        place(message.twist.twist.angular, pose.twist[3:])
        variances = [0.0] * 36
        variances[::7] = (pose.twist_sigma**2).tolist()
        message.twist.covariance = variances
        self.twists.publish(message)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Poses of a running slitpose as a node of ROS 2.")
    parser.add_argument("address", help="that of `slitpose run --publish`, such as udp:127.0.0.1:7452")
    parser.add_argument("--rate", type=float, default=100.0, help="poses a second; 0: each (default: 100)")
    parser.add_argument("--frame", default="base", help="name of the frame of the poses (default: base)")
    parser.add_argument("--duration", type=float, help="end after so many seconds")
    options = parser.parse_args(arguments)
    rclpy.init()
    node = rclpy.create_node("slitpose")
    boards: dict[str, Board] = {}
    try:
        for pose in slitpose.follow(options.address, duration_s=options.duration):
            if pose.device not in boards:
                tool = f"tool_{pose.device}" if boards else "tool"
                boards[pose.device] = Board(node, pose.device, options.frame, tool)
            board = boards[pose.device]
            if pose.time_s >= board.due_s or pose.time_s < board.due_s - 1.0:
                board.due_s = pose.time_s + (1.0 / options.rate if options.rate else 0.0)
                board.publish(pose)
            if not rclpy.ok():
                break
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
