"""The examples of the README and of the package, and the notebook of the guide."""

from __future__ import annotations

import doctest
import os
import re
from pathlib import Path

import nbformat
import pytest
import slitpose
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).parents[2] / "guide/analyst.ipynb"


def test_examples_do_what_they_say(captures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(captures)
    found = doctest.testmod(slitpose)
    assert found.attempted > 3 and found.failed == 0
    found = doctest.testfile(str(Path(__file__).parents[1] / "README.md"), module_relative=False)
    assert found.attempted > 15 and found.failed == 0


def test_the_notebook_runs_in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", os.path.dirname(os.environ["SLITPOSE"]), prepend=os.pathsep)
    monkeypatch.setenv("SLITPOSE_CONFIG", "none")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells), "strip its outputs"
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in cells for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 5
    text = "".join(output.get("text", "") for output in outputs)
    nees = re.search(r"mean NEES ([0-9.]+) ", text)
    assert nees and 5.5 < float(nees[1]) < 6.5, text
