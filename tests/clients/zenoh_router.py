"""A router of Zenoh at the endpoint that is given, until standard input ends."""

import json
import sys

import zenoh

with_settings = zenoh.Config()
for key, value in {
    "mode": "router",
    "listen/endpoints": [sys.argv[1]],
    "scouting/multicast/enabled": False,
}.items():
    with_settings.insert_json5(key, json.dumps(value))
with zenoh.open(with_settings):
    print("ready", flush=True)
    sys.stdin.read()
