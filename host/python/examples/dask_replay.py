"""Solves a folder of captures again on a Dask cluster.

    python dask_replay.py night/ poses/ [--scheduler tcp://host:8786] [--split SECONDS]

Each recording becomes a file poses/NAME.npz with the arrays of slitpose.Poses. The captures have to be
readable at the same paths on all workers.

A recording is split where its sessions begin, which gives the same bits as one replay of the whole. --split also cuts it
every so many seconds: for long recordings, where poses that differ far less than their noise are enough.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path
from typing import Any, Optional

import numpy as np
from distributed import Client, Future

import slitpose


def cuts(files: list[Path], split_s: Optional[float]) -> list[float]:
    """Where a recording is split, seconds after its beginning."""
    begun_s = slitpose.sessions(files)
    if split_s is None:
        return begun_s
    scans = slitpose.open(files)
    length_s = float(np.ptp(scans.time_s)) if len(scans) else 0.0
    return sorted({*begun_s, *np.arange(split_s, length_s, split_s).tolist()})


def replay(client: Client, recordings: list[list[Path]], split_s: Optional[float] = None) -> list[slitpose.Poses]:
    """The poses of each recording."""
    tasks = [client.submit(cuts, files, split_s, pure=False) for files in recordings]
    parts: list[list[Future[slitpose.Part]]] = []
    for files, found in zip(recordings, client.gather(tasks)):
        ends = [None, *found, None]
        pairs = zip(ends[:-1], ends[1:])
        parts.append([client.submit(slitpose.replay_part, files, a, b, pure=False) for a, b in pairs])
    # A seam that is open where none is allowed is an error, never other bits.
    return [slitpose.join(client.gather(of_one), same_bits=split_s is None) for of_one in parts]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", type=Path, help="folder with captures")
    parser.add_argument("output", type=Path, help="folder for the poses")
    parser.add_argument("--scheduler", help="address of a cluster; default: the cores of this machine")
    parser.add_argument("--split", type=float, metavar="SECONDS", help="also cut every so many seconds")
    options = parser.parse_args()
    recordings = slitpose.series(options.captures)
    options.output.mkdir(parents=True, exist_ok=True)
    has_loss = False
    with Client(options.scheduler) as client, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", slitpose.DataLossWarning)
        for files, poses in zip(recordings, replay(client, recordings, options.split)):
            arrays: dict[str, Any] = poses.columns()
            np.savez(options.output / f"{files[0].stem}.npz", **arrays)
            print(f"{files[0].name}: {poses!r}")
            has_loss |= bool(poses.losses)
    for warning in caught:
        print(warning.message, file=sys.stderr)
    return 3 if has_loss else 0


if __name__ == "__main__":
    sys.exit(main())
