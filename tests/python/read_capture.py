#!/usr/bin/env python3
"""Reads a capture with the public `mcap` and `mcap_ros2` packages, as any other program would.

usage: read_capture.py FILE

Prints one line of JSON; exit code 1 if the file is not what host/CAPTURES.md says, 3 if it ends before
its end, as that of a recorder that was cut off: then the line says what could be read.
"""

import json
import math
import struct
import sys

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

LINK = "slitpose_msgs/msg/LinkBytes"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
HEAD = "visualization_msgs/msg/MarkerArray"
REPORT = "std_msgs/msg/String"
NOTE = "rcl_interfaces/msg/Log"
SCHEMAS = {
    "link": LINK, "hello": LINK, "pose": POSE, "pose_stamped": POSE_STAMPED, "tf": TRANSFORMS, "twist": TWIST,
    "head": HEAD, "report": REPORT, "notes": NOTE,
}
NO_TIME = 2**64 - 1


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


def settings_hash(device):
    """FNV-1a of all other entries in the order of their keys: key, 0, value, 0."""
    state = 0xCBF29CE484222325
    for key in sorted(device):
        if key != "settings_hash":
            for byte in f"{key}\0{device[key]}\0".encode():
                state = (state ^ byte) * 0x100000001B3 % 2**64
    return f"{state:016x}"


def vector(message):
    return [message.x, message.y, message.z]


class Contents:
    """What is in a capture, record by record."""

    def __init__(self):
        self.finished = True
        self.raw_bytes = 0
        self.timed_reads = 0
        self.positions_m = []
        self.reports, self.notes = [], []
        self.heads = {}
        self.report_schema = None
        self.scenes, self.devices, self.schemas, self.channels, self.topics = {}, [], {}, {}, {}
        self._ros = DecoderFactory()

    def take(self, record):
        if isinstance(record, Header):
            check(record.profile == "ros2" and record.library.startswith("slitpose "), f"header {record}")
        elif isinstance(record, Attachment) and record.name == "report.schema.json":
            check(record.media_type == "application/schema+json", "a schema of another kind")
            self.report_schema = json.loads(record.data)
        elif isinstance(record, Attachment):
            check(record.media_type == "application/toml" and record.data, "a scene without text")
            # Copies further on are for files whose beginning is damaged.
            known = self.scenes.setdefault(record.name, record)
            check(known.data == record.data, "two scenes of one name")
        elif isinstance(record, Metadata) and record.name == "slitpose.device":
            self._take_device(record.metadata)
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = self.schemas[record.schema_id]
            kind = record.topic.rsplit("/", 1)[1]
            check(schema.name == SCHEMAS.get(kind), f"{record.topic} has schema {schema.name}")
            self.channels[record.id] = record
        elif isinstance(record, Message):
            self._take_message(record)

    def _take_device(self, device):
        check(device["scene"] in self.scenes, "a board without scene")
        check(device["tier"] in ("paper", "exact"), "a board without tier")
        check(device["settings_hash"] == settings_hash(device), "settings are not what was written")
        if device not in self.devices:
            self.devices.append(device)

    def _take_message(self, record):
        channel = self.channels[record.channel_id]
        schema = self.schemas[channel.schema_id]
        topic = self.topics.setdefault(channel.topic, {"messages": 0, "schema": schema.name})
        topic["messages"] += 1
        check(channel.message_encoding == "cdr", "a message that ROS does not know")
        message = self._ros.decoder_for(channel.message_encoding, schema)(record.data)
        if schema.name == REPORT:
            self.reports.append((channel.topic, json.loads(message.data)))
            return
        if schema.name == NOTE:
            self.notes.append((message.stamp.sec + message.stamp.nanosec * 1e-9, message.msg))
            return
        check(self.devices, "a message before its board")
        if schema.name == LINK:
            check_link(message)
            if channel.topic.endswith("/link"):
                self.raw_bytes += len(message.data)
                self.timed_reads += sum(time != NO_TIME for time in message.read_monotonic_ns)
            return
        if schema.name == HEAD:
            shapes = {marker.ns: (marker.header.frame_id, [vector(at) for at in marker.points]) for marker in message.markers}
            # Copies further on are for files whose beginning is damaged.
            check(self.heads.setdefault(channel.topic, shapes) == shapes, "two heads of one board")
            return
        if schema.name == TRANSFORMS:
            (message,) = message.transforms
            check(message.child_frame_id == "tool", "a transform of another frame")
        check(message.header.frame_id == "base", "a pose or velocity in another frame")
        if schema.name in (POSE_STAMPED, TRANSFORMS):
            return
        if schema.name == POSE:
            check_covariance(message.pose.covariance)
            q = message.pose.pose.orientation
            check(abs(math.hypot(q.x, q.y, q.z, q.w) - 1.0) < 1e-6, "a rotation is no unit quaternion")
            self.positions_m.append(vector(message.pose.pose.position))
        else:
            check_covariance(message.twist.covariance)

    def counts(self):
        """Messages of each kind, of all boards."""
        counts = {}
        for topic, found in self.topics.items():
            kind = topic.rsplit("/", 1)[1]
            counts[kind] = counts.get(kind, 0) + found["messages"]
        return counts


def read(path):
    """Reads from the front, which can be done wherever the file ends."""
    contents = Contents()
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                contents.take(record)
        except (EndOfFile, struct.error):
            # The latter where the file ends within a record that the reader unpacks as it reads: an index.
            contents.finished = False
    if contents.finished:
        check_index(path, contents)
    check(contents.raw_bytes > 0 or not contents.finished, "no bytes of a link")
    return contents


def check_index(path, contents):
    """What the end of the file says of the rest."""
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        check(summary is not None and summary.statistics is not None, "no summary")
        messages = sum(topic["messages"] for topic in contents.topics.values())
        check(summary.statistics.message_count == messages, "the summary counts other messages")
        check(sum(1 for _ in reader.iter_messages()) == messages, "the index leads to other messages")
        names = {attachment.name for attachment in reader.iter_attachments()} - {"report.schema.json"}
        check(names == set(contents.scenes), "scenes without an index")


def main():
    if len(sys.argv) != 2:
        print("usage: read_capture.py FILE", file=sys.stderr)
        return 2
    try:
        contents = read(sys.argv[1])
    except Exception as error:  # whatever a reader stumbles over is what this program is for
        print(f"{sys.argv[1]}: {type(error).__name__}: {error}", file=sys.stderr)
        return 1
    shown = ("finished", "topics", "raw_bytes", "timed_reads")
    line = {name: getattr(contents, name) for name in shown}
    print(json.dumps({**line, "scenes": sorted(contents.scenes)}))
    return 0 if contents.finished else 3


if __name__ == "__main__":
    sys.exit(main())
