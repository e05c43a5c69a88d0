#!/usr/bin/env python3
"""Reads a capture with the public `mcap` and `mcap_ros2` packages, as any other program would.

usage: read_capture.py FILE

Prints one line of JSON; exit code 1 if the file is not what host/CAPTURES.md says.
"""

import json
import math
import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

LINK = "slitpose_msgs/msg/LinkBytes"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"
SCHEMAS = {"link": LINK, "hello": LINK, "pose": POSE, "twist": TWIST, "report": "slitpose.Report"}
NO_TIME = 2**64 - 1


class JsonDecoderFactory:
    """Reports are JSON."""

    def decoder_for(self, message_encoding, _schema):
        return json.loads if message_encoding == "json" else None


def check(condition, what):
    if not condition:
        raise ValueError(what)


def check_link(message):
    check(sum(message.read_bytes) == len(message.data), "reads do not add up to the data")
    for times in (message.read_monotonic_ns, message.read_utc_minus_monotonic_ns):
        check(len(times) == len(message.read_bytes), "a read without a time")
    for times in (message.ping_monotonic_ns, message.ping_utc_minus_monotonic_ns):
        check(len(times) == len(message.ping_token), "a ping without a time")


def check_covariance(covariance):
    check(len(covariance) == 36 and all(map(math.isfinite, covariance)), "a covariance is not 36 numbers")
    for i in range(6):
        check(covariance[7 * i] >= 0.0, "a negative variance")


def summary(path):
    topics = {}
    raw_bytes = 0
    timed_reads = 0
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory(), JsonDecoderFactory()], validate_crcs=True)
        header = reader.get_header()
        check(header.profile == "ros2" and header.library.startswith("slitpose "), f"header {header}")
        scenes = {attachment.name: attachment for attachment in reader.iter_attachments()}
        devices = [data.metadata for data in reader.iter_metadata() if data.name == "slitpose.device"]
        check(devices, "no board")
        for device in devices:
            scene = scenes.get(device["scene"])
            check(scene is not None and scene.media_type == "application/toml" and scene.data, "a board without scene")
            check(device["tier"] in ("paper", "exact"), "a board without tier")
        for schema, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            kind = channel.topic.rsplit("/", 1)[1]
            check(schema.name == SCHEMAS.get(kind), f"{channel.topic} has schema {schema.name}")
            topic = topics.setdefault(channel.topic, {"messages": 0, "schema": schema.name})
            topic["messages"] += 1
            if schema.name == LINK:
                check_link(message)
                if kind == "link":
                    raw_bytes += len(message.data)
                    timed_reads += sum(time != NO_TIME for time in message.read_monotonic_ns)
            elif schema.name == POSE:
                check(message.header.frame_id == "base", "a pose in another frame")
                check_covariance(message.pose.covariance)
                position, q = message.pose.pose.position, message.pose.pose.orientation
                check(abs(math.hypot(q.x, q.y, q.z, q.w) - 1.0) < 1e-6, "a rotation is no unit quaternion")
                topic.setdefault("first_position_m", [position.x, position.y, position.z])
            elif schema.name == TWIST:
                check(message.header.frame_id == "base", "a velocity in another frame")
                check_covariance(message.twist.covariance)
    check(raw_bytes > 0, "no bytes of a link")
    return {"topics": topics, "raw_bytes": raw_bytes, "timed_reads": timed_reads, "scenes": sorted(scenes)}


def main():
    if len(sys.argv) != 2:
        print("usage: read_capture.py FILE", file=sys.stderr)
        return 2
    try:
        print(json.dumps(summary(sys.argv[1])))
    except Exception as error:  # whatever a reader stumbles over is what this program is for
        print(f"{sys.argv[1]}: {type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
