"""The page that describes the wire is enough to read it: see `wire`."""

import math
import os
import re
import subprocess
import unittest

import wire

GOLDEN = os.path.join(os.path.dirname(wire.PAGE), "..", "tests", "testsuite", "golden.rs")


class Wire(unittest.TestCase):
    kinds = wire.schemas()

    def test_the_examples_of_the_page(self):
        with open(wire.PAGE, encoding="utf-8") as page:
            examples = re.findall(r"^//! ((?:[0-9a-f]{2} )+00)$", page.read(), re.MULTILINE)
        (pong,), damaged = wire.packets(bytes.fromhex(examples[0]))
        self.assertEqual((wire.message(pong, self.kinds), damaged), (("Pong", {"token": 7, "tick": 170_000_000}), 0))
        (stop,), damaged = wire.packets(bytes.fromhex(examples[1]))
        self.assertEqual((wire.request(stop, self.kinds), damaged), ((3, "Stop", {}), 0))

    def test_every_pinned_packet_is_read(self):
        with open(GOLDEN, encoding="utf-8") as golden:
            texts = re.findall(r'"([0-9a-f]{4,}(?:\\\s+[0-9a-f]+)*)"', golden.read())
        read = {}
        for text in texts:
            payloads, damaged = wire.packets(bytes.fromhex(re.sub(r"\\\s+", "", text)))
            self.assertEqual((len(payloads), damaged), (1, 0), text)
            for of in (wire.message, wire.request):
                try:
                    *_, name, values = of(payloads[0], self.kinds)
                    read.setdefault((of.__name__, name), []).append(values)
                except (ValueError, IndexError):
                    pass
        # A payload may make sense both ways; each kind must be among them.
        every = {("message", name) for name, _ in self.kinds[: wire.MESSAGES]}
        every |= {("request", name) for name, _ in self.kinds[wire.MESSAGES :]}
        self.assertEqual(every - set(read), set())
        (hello,) = read["message", "Hello"]
        self.assertEqual((hello["kind"], hello["board"], hello["reset_cause"]), ("Simulated", "virtual", "BrownOut"))
        self.assertEqual(hello["scaling"]["amperes_per_code"], -2.5e-9)
        (status,) = read["message", "Status"]
        self.assertEqual((status["clock"], status["settings"]), ("Crystal", "PassedOver"))
        refusals = [reply["outcome"] for reply in read["message", "Reply"] if reply["outcome"] != "Ok"]
        self.assertIn({"Err": {"Hardware": {"Conversion": {"asked_ticks": 150, "nearest_ticks": 148}}}}, refusals)

    def test_what_a_board_sends_is_read_whole(self):
        command = [os.environ["SLITPOSE"], "simulate", "--raw", "--duration", "50ms", "--output", "-"]
        stream = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
        payloads, damaged = wire.packets(stream)
        self.assertEqual(damaged, 0)
        said = [wire.message(payload, self.kinds) for payload in payloads]
        hello = next(values for name, values in said if name == "Hello")
        keys = [wire.key(*kind) for kind in self.kinds]
        for found, of_page in ((hello["message_keys"], keys[: wire.MESSAGES]), (hello["command_keys"], keys[wire.MESSAGES :])):
            self.assertEqual(found, b"".join(key.to_bytes(8, "little") for key in of_page))
        schedule = [values for name, values in said if name == "Hello"][-1]["schedule"]
        words = 2 * schedule["cells"] * (1 + (0 in schedule["slots"]))
        next_scan = 0
        for name, values in said:
            if name == "Batch":
                self.assertEqual(values["sequence"], next_scan)
                self.assertEqual(values["tick"], next_scan * schedule["frame_ticks"])
                self.assertEqual(len(values["samples"]) % (2 * words), 0)
                next_scan += len(values["samples"]) // (2 * words)
        self.assertEqual(next_scan, 200)
        truths = [values for name, values in said if name == "Truth"]
        self.assertEqual([truth["sequence"] for truth in truths], list(range(200)))
        for truth in truths:
            self.assertAlmostEqual(math.hypot(*truth["rotation_xyzw"]), 1.0, delta=1e-12)
            self.assertLess(math.hypot(*truth["translation_m"]), 0.01)


if __name__ == "__main__":
    unittest.main()
