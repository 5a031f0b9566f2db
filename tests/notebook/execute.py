#!/usr/bin/env python3
"""Executes examples/notebook/piezo.ipynb from top to bottom, in a kernel and a folder of its own.

    .venv/bin/python tests/notebook/execute.py OUT.ipynb              # what comes out
    .venv/bin/python tests/notebook/execute.py examples/notebook/piezo.ipynb   # store it in the notebook
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import nbclient
import nbformat

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "examples/notebook/piezo.ipynb"


def executed(folder: Path) -> nbformat.NotebookNode:
    """The notebook with its outputs. It works in `folder`."""
    python = Path(sys.executable)
    os.environ.update(PATH=f"{python.parent}:{os.environ['PATH']}", JUPYTER_PATH=str(folder / "share/jupyter"),
                      JUPYTER_RUNTIME_DIR=str(folder / "runtime"), IPYTHONDIR=str(folder / "ipython"),
                      PYDEVD_DISABLE_FILE_VALIDATION="1", NO_COLOR="1")
    subprocess.run([python, "-m", "ipykernel", "install", "--prefix", folder], check=True, capture_output=True)
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    metadata = dict(notebook.metadata)
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", record_timing=False,
                            resources={"metadata": {"path": str(folder)}}).execute()
    notebook.metadata = nbformat.from_dict(metadata)  # the kernel adds its version
    return notebook


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory() as made:
        nbformat.write(executed(Path(made)), sys.argv[1])
