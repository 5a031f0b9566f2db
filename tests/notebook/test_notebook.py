"""The notebook runs from top to bottom in Jupyter's kernel, shows what it says it shows, and holds its own outputs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from execute import NOTEBOOK

NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?")


def printed(notebook: nbformat.NotebookNode) -> str:
    return "".join(out.get("text", "") for cell in notebook.cells for out in cell.get("outputs", []))


def pictures(notebook: nbformat.NotebookNode) -> int:
    return sum("image/png" in out.get("data", {}) for cell in notebook.cells for out in cell.get("outputs", []))


@pytest.fixture(scope="module")
def now(tmp_path_factory: pytest.TempPathFactory) -> nbformat.NotebookNode:
    out = tmp_path_factory.mktemp("notebook") / "out.ipynb"
    done = subprocess.run([sys.executable, Path(__file__).with_name("execute.py"), out], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return nbformat.read(out, as_version=4)


@pytest.mark.slow
def test_it_shows_what_it_says(now: nbformat.NotebookNode) -> None:
    text = printed(now)
    without, with_model = map(float, re.search(r"without a model ([\d.]+) %.* with the model ([\d.]+) %", text).groups())
    assert with_model < without / 5
    assert "verdict: effect\nlag explains" in text
    assert float(re.search(r"time_constant_s = ([\d.]+) s", text)[1]) == pytest.approx(2e-3, rel=0.2)  # as the rig has
    old, improved = map(float, re.search(r"old model ([\d.]+) %.* improved one ([\d.]+) %", text).groups())
    assert improved < old / 2
    assert not any(out.get("name") == "stderr" for cell in now.cells for out in cell.get("outputs", []))


@pytest.mark.slow
def test_it_holds_its_own_outputs(now: nbformat.NotebookNode) -> None:
    """Another NumPy may change the last digits."""
    stored = nbformat.read(NOTEBOOK, as_version=4)
    texts = [printed(one) for one in (now, stored)]
    remedy = "run tests/notebook/execute.py, as its head says"
    assert NUMBER.sub("N", texts[0]) == NUMBER.sub("N", texts[1]), remedy
    numbers = [[float(one) for one in NUMBER.findall(text)] for text in texts]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.3, abs=0.1), remedy
    assert pictures(now) == pictures(stored) == 4


def test_it_is_readable() -> None:
    """Cells of code are short, and a text stands before each step."""
    stored = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(stored)
    assert all(len(cell.source.splitlines()) <= 30 for cell in stored.cells if cell.cell_type == "code")
    assert sum(cell.cell_type == "markdown" for cell in stored.cells) >= 6
    assert NOTEBOOK.stat().st_size < 400_000
