"""Captures of simulated boards, made by the command."""

from __future__ import annotations

import csv
import io
import os
import subprocess
from pathlib import Path
from typing import Callable

import pytest

Command = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="session")
def command() -> Command:
    """Runs the command; exit codes are 0 unless `code` says otherwise."""

    def run(*arguments: object, code: int = 0) -> "subprocess.CompletedProcess[str]":
        words = [os.environ["SLITPOSE"], *map(str, arguments)]
        done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL)
        assert done.returncode == code, done.stderr
        return done

    return run


def table(text: str) -> list[dict[str, str]]:
    """The rows of a CSV."""
    return list(csv.DictReader(io.StringIO(text)))


@pytest.fixture(scope="session")
def captures(command: Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder: `contact.mcap`, one second; `smooth.mcap`, half a second of another head; `bench`, measurements of a head."""
    folder = tmp_path_factory.mktemp("captures")
    simulate = ("simulate", "--trajectory")
    command(*simulate, "contact", "--duration", "1s", "--output", folder / "contact.mcap")
    command(*simulate, "smooth", "--duration", "500ms", "--scene", "fine", "--trigger", "40Hz", "--output", folder / "smooth.mcap")
    command("bench", "wide", "--output", folder / "bench", "--poses", "60", "--duration", "1s")
    return folder
