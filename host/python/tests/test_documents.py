"""The examples of the README and of the package."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest
import slitpose


def test_examples_do_what_they_say(captures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(captures)
    found = doctest.testmod(slitpose)
    assert found.attempted > 3 and found.failed == 0
    found = doctest.testfile(str(Path(__file__).parents[1] / "README.md"), module_relative=False)
    assert found.attempted > 15 and found.failed == 0
