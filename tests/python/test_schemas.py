"""What the program reads and writes, against the schemas that it prints."""

import json
import os
import pathlib
import subprocess
import tempfile
import tomllib
import unittest

from jsonschema import Draft202012Validator

SLITPOSE = os.environ["SLITPOSE"]
ROOT = pathlib.Path(__file__).resolve().parents[2]


def slitpose(*arguments: object) -> str:
    return subprocess.run([SLITPOSE, *map(str, arguments)], check=True, capture_output=True, text=True).stdout


def schema(name: str) -> Draft202012Validator:
    found = json.loads(slitpose("schema", name))
    Draft202012Validator.check_schema(found)
    return Draft202012Validator(found)


def toml(path: pathlib.Path) -> dict:
    return tomllib.loads(path.read_text())


class Schemas(unittest.TestCase):
    def test_scenes_and_what_is_wrong_in_them(self) -> None:
        scene = schema("scene")
        paths = sorted((ROOT / "host/head/scenes").glob("*.toml"))
        self.assertGreater(len(paths), 7)
        for path in paths:
            scene.validate(toml(path))
        for section, key, value in [("slit", "widht_mm", 0.6), ("slit", "width_mm", "wide"), ("slit", "mount", "table")]:
            wrong = toml(ROOT / "host/head/scenes/wide.toml")
            wrong[section][key] = value
            self.assertFalse(scene.is_valid(wrong), f"{section}.{key} = {value}")

    def test_a_calibration(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            slitpose("bench", "wide", "--output", f"{folder}/mine", "--poses", 20, "--duration", "1s")
            slitpose("calibrate", f"{folder}/mine/scene.toml", "--known", f"{folder}/mine/known.csv", "--output", f"{folder}/c.toml")
            calibration = toml(pathlib.Path(folder, "c.toml"))
        schema("calibration").validate(calibration)
        del calibration["pose_error"]
        self.assertFalse(schema("calibration").is_valid(calibration))

    def test_configurations(self) -> None:
        config = schema("config")
        config.validate(toml(ROOT / "host/systemd/service.toml"))
        config.validate(tomllib.loads(slitpose("run", "--config", "none", "--print-config")))
        self.assertFalse(config.is_valid({"devise": "sim"}))

    def test_every_kind_of_object_in_a_stream(self) -> None:
        lines = slitpose(
            *("run", "--device", "sim", "--duration", "300ms", "--speed", "max", "--format", "ndjson", "--filter", "5ms"),
            *("--trigger", "10Hz", "--tip", "0,0,10", "--fault", "occlude:cell=2,from=50ms,for=20ms"),
        ).splitlines()
        objects = [json.loads(line) for line in lines]
        kinds = {found.get("kind", "pose") for found in objects}
        self.assertEqual(kinds, {"pose", "frame", "edge", "injected_fault"})
        stream = schema("ndjson")
        for found in objects:
            stream.validate(found)
        # Nothing is written that the schema does not name.
        named = stream.schema["anyOf"][0]["properties"]
        poses = [found for found in objects if "kind" not in found]
        self.assertLessEqual({key for pose in poses for key in pose}, named.keys())
        self.assertFalse(stream.is_valid({**poses[-1], "translation_m": [1.0, 2.0]}))


if __name__ == "__main__":
    unittest.main()
