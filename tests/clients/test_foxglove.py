"""`run --foxglove` as a client of Foxglove's WebSocket protocol sees it (subprotocol foxglove.sdk.v1): see `run`."""

import asyncio
import csv
import io
import json
import os
import socket
import struct
import subprocess
import unittest

import websockets
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

PROGRAM = os.environ["SLITPOSE"]

RUN = [PROGRAM, "run", "--config", "none", "--device", "sim"]

#: Longer than any answer takes on a busy machine.
PATIENCE_S = 60

#: Samples to take, and what their topics end in.
SAMPLES = 60
KINDS = {"pose", "tf", "twist", "head", "frame", "report"}

MESSAGE_DATA = 1


class Client:
    """Subscribes to every channel, and keeps what comes by the last word of its topic."""

    def __init__(self):
        self.channels, self.got, self._ros = {}, {kind: [] for kind in KINDS}, DecoderFactory()

    async def listen(self, url):
        async with asyncio.timeout(PATIENCE_S), websockets.connect(url, subprotocols=["foxglove.sdk.v1"]) as socket:
            async for message in socket:
                if isinstance(message, str):
                    await self._advertised(socket, json.loads(message))
                else:
                    self._take(message)
                if len(self.got["pose"]) >= SAMPLES and all(self.got.values()):
                    return

    async def _advertised(self, socket, message):
        found = message.get("channels", []) if message["op"] == "advertise" else []
        self.channels.update({channel["id"]: channel for channel in found})
        if found:
            wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in found]
            await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def _take(self, message):
        kind, subscription, _ = struct.unpack_from("<BIQ", message)
        if kind != MESSAGE_DATA:
            return
        channel, data = self.channels[subscription], message[13:]
        if channel["encoding"] == "json":
            value = json.loads(data)
        else:
            text = channel["schema"].encode()
            schema = Schema(id=channel["id"], name=channel["schemaName"], encoding=channel["schemaEncoding"], data=text)
            value = self._ros.decoder_for(channel["encoding"], schema)(data)
        self.got[channel["topic"].rsplit("/", 1)[1]].append(value)


class Foxglove(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        run = [*RUN, "--foxglove", "127.0.0.1:0", "--format", "csv"]
        daemon = subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        cls.client, listening = Client(), "slitpose: Foxglove connects to "
        try:
            line = daemon.stderr.readline()
            if not line.startswith(listening):
                raise AssertionError(line)
            printed = asyncio.run(cls._while_reading(daemon, line.removeprefix(listening).strip()))
        finally:
            daemon.kill()
            daemon.wait()
            daemon.stderr.close()
            daemon.stdout.close()
        cls.rows = {int(row["seq"]): row for row in csv.DictReader(io.StringIO(printed))}

    @classmethod
    async def _while_reading(cls, daemon, url):
        """What the daemon printed until the client had enough, and some more."""
        reading = asyncio.create_task(asyncio.to_thread(daemon.stdout.read))
        try:
            await cls.client.listen(url)
        finally:
            # It ends well: what it computed is printed.
            daemon.terminate()
            printed = await reading
        return printed

    def test_every_channel_has_messages(self):
        for kind, messages in self.client.got.items():
            self.assertTrue(messages, kind)

    def test_frames_are_the_poses_printed(self):
        frames = [frame for frame in self.client.got["frame"] if frame["t_m"]]
        self.assertGreater(len(frames), SAMPLES // 2)
        for frame in frames:
            row = self.rows[frame["seq"]]
            for axis, metres, sigma_m in zip("xyz", frame["t_m"], frame["sigma"]):
                # Single precision.
                self.assertAlmostEqual(metres, float(row[f"t{axis}_mm"]) * 1e-3, delta=1e-9)
                self.assertAlmostEqual(sigma_m / (float(row[f"sigma_t{axis}_mm"]) * 1e-3), 1.0, delta=1e-3)
            self.assertEqual(len(frame["cells"]), 6)
            self.assertTrue(all(cell["i_a"] for cell in frame["cells"] if "used" in cell["state"]))

    def test_poses_and_transforms_are_those_printed(self):
        rows = {self._stamp_ns(row): row for row in self.rows.values()}
        found = [(message.header, message.pose.pose.position) for message in self.client.got["pose"]]
        for message in self.client.got["tf"]:
            (transform,) = message.transforms
            self.assertEqual(transform.child_frame_id, "tool")
            found.append((transform.header, transform.transform.translation))
        for header, position in found:
            self.assertEqual(header.frame_id, "base")
            row = rows[header.stamp.sec * 10**9 + header.stamp.nanosec]
            for axis in "xyz":
                self.assertAlmostEqual(getattr(position, axis), float(row[f"t{axis}_mm"]) * 1e-3, delta=1e-12)

    @staticmethod
    def _stamp_ns(row):
        return int(row["host_utc_ns"] or float(row["device_time_s"]) * 1e9)

    def test_the_head_moves_with_the_tool(self):
        frames = {marker.ns: marker.header.frame_id for marker in self.client.got["head"][0].markers}
        expected = {"detectors": "base", "masks": "base", "emitters": "tool", "emitter_axes": "tool"}
        self.assertEqual(frames, expected)

    def test_reports_are_about_the_board(self):
        (board,) = self.client.got["report"][-1]["boards"]
        self.assertEqual(board["board"], "simulated")
        self.assertTrue(all(topic["topic"].startswith(("/slitpose/", "/tf")) for topic in self.client.channels.values()))


class Addresses(unittest.TestCase):
    def test_other_hosts_and_ports_in_use(self):
        wide = self._refused("0.0.0.0:8765")
        self.assertEqual(wide.returncode, 2)
        self.assertIn("ssh -L", wide.stderr)
        with self._port() as taken:
            address = "127.0.0.1:%d" % taken.getsockname()[1]
            busy = self._refused(address)
        self.assertEqual(busy.returncode, 1)
        self.assertIn(f"cannot serve Foxglove at {address}", busy.stderr)

    @staticmethod
    def _refused(address):
        run = [*RUN, "--foxglove", address]
        return subprocess.run(run, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S)

    @staticmethod
    def _port():
        taken = socket.socket()
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        return taken


if __name__ == "__main__":
    unittest.main()
