"""Boards over Zenoh, with Zenoh's own Python client and another's nodes of ROS 2: see `run`."""

import asyncio
import collections
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import unittest
from importlib.metadata import version
from pathlib import Path

import pyzeros
import zenoh
from pyzeros.pub import publisher_keyexpr, token_keyexpr
from pyzeros.utils import rmw_zenoh_gid
from rosbags.typesys import Stores, get_typestore

HERE = Path(__file__).parent
SERIAL = "73696d756c61746564000000"
BOARD = f"board_{SERIAL}"
TYPES = {
    f"slitpose/{BOARD}/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    f"slitpose/{BOARD}/twist": "geometry_msgs/msg/TwistWithCovarianceStamped",
    f"slitpose/{BOARD}/head": "visualization_msgs/msg/MarkerArray",
    "tf": "tf2_msgs/msg/TFMessage",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}

#: Longest wait for what must come at last, seconds; none of the tests depends on how long it takes.
AT_LAST = 60

store = get_typestore(Stores.ROS2_JAZZY)


def until(done, what):
    """Waits until `done()`, and returns how long that took, seconds."""
    began = time.monotonic()
    while not done():
        if time.monotonic() - began > AT_LAST:
            raise TimeoutError(what)
        time.sleep(0.02)
    return time.monotonic() - began


class Router:
    """A router that can be restarted, and programs around it."""

    def __init__(self):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        self.programs = []
        self.sessions = []
        self.folder = tempfile.TemporaryDirectory()
        self.start()

    def start(self):
        self.process = subprocess.Popen(
            [sys.executable, HERE / "zenoh_router.py", self.endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout.readline() == "ready\n"

    def kill(self):
        self.process.kill()
        self.process.communicate()

    def session(self):
        config = zenoh.Config()
        retry = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}
        for key, value in {
            "mode": "client",
            "connect/endpoints": [self.endpoint],
            "connect/retry": retry,
            "connect/exit_on_failure": False,
            "scouting/multicast/enabled": False,
        }.items():
            config.insert_json5(key, json.dumps(value))
        self.sessions.append(zenoh.open(config))
        return self.sessions[-1]

    def slitpose(self, *arguments, environment=()):
        """A daemon, and the file of its poses."""
        output = os.path.join(self.folder.name, f"{len(self.programs)}.ndjson")
        command = [os.environ["SLITPOSE"], "run", "--config", "none", "--zenoh-router", self.endpoint, "--format", "ndjson"]
        with open(output, "wb") as file:
            program = subprocess.Popen(
                [*command, *arguments], stdout=file, stderr=subprocess.PIPE, text=True, env={**os.environ, **dict(environment)}
            )
        self.programs.append(program)
        return program, output

    def close(self):
        for session in self.sessions:
            session.close()
        for program in self.programs:
            if program.poll() is None:
                program.kill()
            program.communicate()
        self.kill()
        self.folder.cleanup()


def poses(file):
    """The lines of a file of poses, by number."""
    with open(file, encoding="utf-8") as lines:
        return {line["seq"]: line for line in (json.loads(text) for text in lines if text.endswith("\n"))}


def number_of(sample):
    return struct.unpack_from("<q", sample.attachment.to_bytes())[0]


class Zenoh(unittest.TestCase):
    def setUp(self):
        self.router = Router()
        self.addCleanup(self.router.close)

    def ended(self, program):
        _, talk = program.communicate(timeout=AT_LAST)
        self.assertEqual(program.returncode, 0, talk)
        return talk

    def test_messages_are_those_of_the_poses(self):
        heard, tokens = collections.defaultdict(list), set()
        session = self.router.session()
        session.declare_subscriber("0/**", lambda sample: heard[str(sample.key_expr)].append(sample))
        session.liveliness().declare_subscriber("@ros2_lv/0/**", lambda sample: tokens.add(str(sample.key_expr)))
        program, output = self.router.slitpose("--device", "sim", "--zenoh", "--zenoh-poses", "0", "--duration", "4s")
        self.ended(program)
        # Times never decrease, so that several scans may have one.
        lines = collections.defaultdict(list)
        for line in poses(output).values():
            lines[line.get("host_utc_ns")].append(line)
        counts = {}
        for topic, kind in TYPES.items():
            dds = "{0}::msg::dds_::{2}_".format(*kind.split("/"))
            with self.subTest(topic=topic):
                # Key, token and number of a publisher, as another program makes them; the hash of the type by a third.
                key = publisher_keyexpr("/" + topic, dds, store.hash_rihs01(kind), domain_id=0)
                samples = heard[key]
                self.assertTrue(samples, key)
                (token,) = (token for token in tokens if f"/%{topic.replace('/', '%')}/" in token)
                _, domain, zid, node, entity, _, enclave, _, name, *_ = token.split("/")
                expected = token_keyexpr(
                    "/" + topic, dds, store.hash_rihs01(kind), node_name=name, session=session, domain_id=domain,
                    _enclave=enclave, _node_id=node, _zenoh_id=zid, _entity_id=entity,
                )  # fmt: skip
                # The default of that program has its namespace as "%", the same as none.
                self.assertEqual(token, expected)
                numbers = []
                for sample in samples:
                    number, stamp, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
                    self.assertEqual((length, gid), (16, rmw_zenoh_gid(token)))
                    self.assertLess(abs(stamp - time.time_ns()), 3600e9)
                    numbers.append(number)
                self.assertEqual(numbers, sorted(set(numbers)))
                if topic.endswith(("pose", "twist", "tf")):
                    # All but those that a stalled machine had no room for.
                    self.assertGreater(numbers[-1], 0.75 * len(poses(output)))
                messages = [store.deserialize_cdr(sample.payload.to_bytes(), kind) for sample in samples]
                compared = 0
                for message in messages if topic.endswith(("pose", "twist", "tf")) else []:
                    header = message.transforms[0].header if topic == "tf" else message.header
                    self.assertEqual(header.frame_id, "base")
                    found = lines[header.stamp.sec * 10**9 + header.stamp.nanosec]
                    if len(found) != 1:
                        continue
                    (line,) = found
                    compared += 1
                    if topic.endswith("pose"):
                        at, turn = message.pose.pose.position, message.pose.pose.orientation
                        self.assertEqual([at.x, at.y, at.z], line["translation_m"])
                        self.assertEqual([turn.x, turn.y, turn.z, turn.w], line["rotation_xyzw"])
                        self.assertEqual(list(message.pose.covariance), line["covariance"])
                    elif topic.endswith("twist"):
                        speed, spin = message.twist.twist.linear, message.twist.twist.angular
                        self.assertEqual([speed.x, speed.y, speed.z], line["twist"]["linear_m_per_s"])
                        self.assertEqual([spin.x, spin.y, spin.z], line["twist"]["angular_rad_per_s"])
                    else:
                        at = message.transforms[0].transform.translation
                        self.assertEqual([at.x, at.y, at.z], line["translation_m"])
                counts[topic] = (len(messages), compared)
                if topic == "diagnostics":
                    status = messages[-1].status[0]
                    self.assertEqual((status.name, status.hardware_id), ("slitpose", SERIAL))
                elif topic.endswith("head"):
                    self.assertEqual({marker.header.frame_id for marker in messages[-1].markers}, {"base", "tool"})
                else:
                    self.assertGreater(compared, 100)
        self.assertEqual(len([token for token in tokens if "/NN/" in token]), 1)
        print(f"messages, and those compared with poses: {counts}; zenoh {version('eclipse-zenoh')}")

    def test_a_node_of_ros_hears_poses(self):
        from ros2_pyterfaces.cydr.all_msgs import PoseWithCovarianceStamped

        # It needs one to be made, and runs nothing in it.
        loop = asyncio.new_event_loop()
        self.addCleanup(loop.close)
        asyncio.set_event_loop(loop)
        heard = []
        node = pyzeros.Node("listener", session=self.router.session(), domain_id=0)
        subscriber = pyzeros.sub.RawSub(
            PoseWithCovarianceStamped, f"/slitpose/{BOARD}/pose", heard.append, session=node, scope=None
        )
        program, _ = self.router.slitpose("--device", "sim", "--zenoh", "--duration", "2s")
        self.ended(program)
        until(lambda: heard, "a pose")
        message = PoseWithCovarianceStamped.deserialize(heard[-1].payload.to_bytes())
        self.assertEqual(message.header.frame_id, b"base")
        print(f"{len(heard)} poses heard by a node of pyzeros")
        subscriber.close()

    def test_a_router_may_restart(self):
        session, heard = self.router.session(), []
        session.declare_subscriber(f"0/slitpose/{BOARD}/pose/**", heard.append)
        program, _ = self.router.slitpose("--device", "sim", "--zenoh")
        until(lambda: heard, "poses")
        self.router.kill()
        time.sleep(2)
        before = len(heard)
        self.router.start()
        client_s = until(lambda: len(heard) > before, "poses again")
        program.send_signal(signal.SIGINT)
        self.ended(program)
        print(f"router back: client hears after {client_s:.1f} s")

    def test_a_router_may_come_late(self):
        self.router.kill()
        program, output = self.router.slitpose("--device", "sim", "--zenoh")
        until(lambda: poses(output), "poses without a router")
        self.router.start()
        heard = []
        self.router.session().declare_subscriber(f"0/slitpose/{BOARD}/pose/**", heard.append)
        until(lambda: heard, "poses by Zenoh")
        program.send_signal(signal.SIGINT)
        self.ended(program)

    def test_boards_are_not_mixed(self):
        boards = 16
        session, heard = self.router.session(), [[] for _ in range(boards)]
        serials = [f"{SERIAL[:-2]}{number:02x}" for number in range(boards)]
        for serial, samples in zip(serials, heard):
            session.declare_subscriber(f"0/slitpose/board_{serial}/pose/**", samples.append)
        scene = os.path.join(self.router.folder.name, "slow.toml")
        show = [os.environ["SLITPOSE"], "scene", "show", "wide"]
        text = subprocess.run(show, check=True, capture_output=True, text=True).stdout
        self.assertIn("frame_rate_hz = 4000", text)
        Path(scene).write_text(text.replace("frame_rate_hz = 4000", "frame_rate_hz = 200"), encoding="utf-8")
        program, output = self.router.slitpose(
            *("--device", ",".join(["sim"] * boards), "--scene", scene, "--zenoh", "--zenoh-poses", "0", "--duration", "3s")
        )
        self.ended(program)
        lines = collections.defaultdict(dict)
        with open(output, encoding="utf-8") as file:
            for line in map(json.loads, file):
                if "host_utc_ns" in line:
                    lines[line["device"]][line["host_utc_ns"]] = line["translation_m"]
        compared = 0
        for serial, samples in zip(serials, heard):
            for sample in samples:
                message = store.deserialize_cdr(sample.payload.to_bytes(), "geometry_msgs/msg/PoseWithCovarianceStamped")
                stamp, at = message.header.stamp, message.pose.pose.position
                found = lines[serial].get(stamp.sec * 10**9 + stamp.nanosec)
                if found is not None:
                    compared += 1
                    self.assertEqual([at.x, at.y, at.z], found)
        self.assertTrue(all(heard))
        print(f"{boards} boards, {6 * boards} publishers: {compared} poses compared, each its own board's")

    def test_a_slow_subscriber_misses_messages_and_delays_none(self):
        sleeper = subprocess.Popen(
            [sys.executable, "-c", SLEEPER, self.router.endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.addCleanup(sleeper.wait)
        self.addCleanup(sleeper.kill)
        self.assertEqual(sleeper.stdout.readline(), "ready\n")
        numbers = []
        self.router.session().declare_subscriber(f"0/slitpose/{BOARD}/pose/**", lambda sample: numbers.append(number_of(sample)))
        program, output = self.router.slitpose(
            "--device", "sim", "--zenoh", "--zenoh-poses", "0", "--trajectory", "fast", "--duration", "20s"
        )
        until(lambda: numbers, "poses")
        # It reads nothing from here on.
        sleeper.send_signal(signal.SIGSTOP)
        self.ended(program)
        sleeper.send_signal(signal.SIGCONT)
        time.sleep(1)
        sleeper.stdin.close()
        with sleeper.stdout as output_of_sleeper:
            slow = [int(number) for number in output_of_sleeper.read().split()]
        lines = poses(output)
        self.assertEqual(list(lines), list(range(80_000)))
        missed = numbers[-1] - numbers[0] + 1 - len(numbers)
        print(f"one who read nothing heard {len(slow)} of {numbers[-1]} messages, another missed {missed}")
        # It knows from the numbers what it missed.
        self.assertLess(len(slow), numbers[-1])
        self.assertEqual(slow, sorted(set(slow)))


SLEEPER = """
import json, sys, zenoh
config = zenoh.Config()
for key, value in {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}.items():
    config.insert_json5(key, json.dumps(value))
numbers = []
with zenoh.open(config) as session:
    session.declare_subscriber("0/*/*/pose/**", lambda sample: numbers.append(int.from_bytes(sample.attachment.to_bytes()[:8], "little")))
    print("ready", flush=True)
    sys.stdin.read()
print(*numbers)
"""


if __name__ == "__main__":
    unittest.main()
