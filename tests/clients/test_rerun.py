"""A capture as Rerun imports it: see `run`."""

import os
import subprocess
import sysconfig
import tempfile
import unittest
from pathlib import Path

BOARD = "/slitpose/board_73696d756c61746564000000"

#: What Rerun draws of a capture by itself, and what it lists as the fields of a ROS message.
COLUMNS = {
    "/tf": "Transform3D:translation",
    f"{BOARD}/pose_stamped": "InstancePoses3D:translations",
    f"{BOARD}/pose": "geometry_msgs.msg.PoseWithCovarianceStamped:message",
    f"{BOARD}/twist": "geometry_msgs.msg.TwistWithCovarianceStamped:message",
    f"{BOARD}/head": "visualization_msgs.msg.MarkerArray:message",
}


class Rerun(unittest.TestCase):
    def test_a_capture_is_imported(self):
        with tempfile.TemporaryDirectory() as folder:
            capture, recording = (os.path.join(folder, name) for name in ("capture.mcap", "capture.rrd"))
            run = ("run", "--config", "none", "--device", "sim", "--speed", "max", "--duration", "2s", "--format", "none")
            subprocess.run([os.environ["SLITPOSE"], *run, "--record", capture], check=True)
            # A home of its own: Rerun keeps settings there, and asks nothing twice.
            environment = {**os.environ, "HOME": folder}
            rerun = Path(sysconfig.get_path("scripts"), "rerun")

            def said(*arguments):
                return subprocess.run([rerun, *arguments], check=True, env=environment, capture_output=True, text=True).stdout

            said("analytics", "disable")
            said("mcap", "convert", capture, "-o", recording)
            chunks = [line for line in said("rrd", "print", recording).splitlines() if line.startswith("Chunk(")]
        for entity, column in COLUMNS.items():
            found = [chunk for chunk in chunks if f" - {entity} - " in chunk and column in chunk]
            print(f"{entity}: {column} in {len(found)} chunks")
            self.assertTrue(found, entity)


if __name__ == "__main__":
    unittest.main()
