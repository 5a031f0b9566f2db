"""The wheel works where there is no checkout: built, installed in an empty environment and used from elsewhere."""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from written import complaints

pytestmark = pytest.mark.slow

HOST_TOOLS = Path(__file__).resolve().parents[1]
OFFLINE = ["--isolated", "--disable-pip-version-check", "--no-index", "--no-deps"]


def run(*command: object, cwd: Path) -> str:
    """Standard output of a command that must succeed, in an environment that knows nothing of the checkout."""
    unwanted = ("PYTHON", "PIP_", "VIRTUAL_ENV")
    environment = {key: value for key, value in os.environ.items() if not key.startswith(unwanted)}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=environment | {"PIP_CONFIG_FILE": os.devnull},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def build_wheel(source: Path, folder: Path) -> Path:
    run(sys.executable, "-m", "pip", "wheel", *OFFLINE, "--no-build-isolation", "-w", folder, source, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    return wheel


def files_in_host_tools() -> set[Path]:
    return {path for path in HOST_TOOLS.rglob("*") if "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    before = files_in_host_tools()
    wheel = build_wheel(HOST_TOOLS, tmp_path_factory.mktemp("wheel"))
    assert files_in_host_tools() == before, "the build left files in the checkout"
    return wheel


@pytest.fixture(scope="module")
def bin_dir(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """bin/ of an environment that holds the wheel, and NumPy and the like from the system."""
    venv = tmp_path_factory.mktemp("environment")
    run(sys.executable, "-m", "venv", "--system-site-packages", "--without-pip", venv, cwd=venv)
    run(venv / "bin/python", "-m", "pip", "install", *OFFLINE, wheel, cwd=venv)
    return venv / "bin"


def play(x: float, r: float, y: float) -> float:
    return max(x - r, min(x + r, y))


def write_recording(path: Path) -> list[list[float]]:
    """Triangles of falling height, 0.5 um/V, through two plays; rows of time_s, command_V, displacement_um."""
    rows, y = [], [0.0, 0.0]
    for k in range(4000):
        height = 100 - 20 * (k // 1000)
        command_V = height * (1 - abs((k % 1000) / 500 - 1))
        y = [play(0.5 * command_V, r, last) for r, last in zip((5, 12), y)]
        rows.append([k / 1000, command_V, 0.4 * command_V + 0.2 * y[0] + 0.1 * y[1]])
    write_csv(path, ["time_s", "command_V", "displacement_um"], rows, "# memory: reset\n")
    return rows


def write_csv(path: Path, names: list[str], rows: list[list[float]], head: str = "") -> None:
    lines = [",".join(names), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    path.write_text(head + "\n".join(lines) + "\n")


def test_it_is_found_in_its_own_environment(bin_dir: Path, tmp_path: Path) -> None:
    assert run(bin_dir / "rdpi", "--version", cwd=tmp_path).startswith("rdpi")
    where = "from rdpi.firmware import _f32, _f64; print(_f32.__file__, _f64.__file__)"
    for path in run(bin_dir / "python", "-c", where, cwd=tmp_path).split():
        assert Path(path).is_relative_to(bin_dir.parent)


def test_fit_header_compensate(bin_dir: Path, tmp_path: Path) -> None:
    rows = write_recording(tmp_path / "run.csv")
    write_csv(tmp_path / "reference.csv", ["time_s", "reference_um"], [[time, um] for time, _, um in rows])
    rdpi = bin_dir / "rdpi"
    run(rdpi, "fit", "run.csv", "-o", "model.json", "--rate-independent", cwd=tmp_path)
    run(rdpi, "header", "model.json", "-o", "rdpi_params.h", cwd=tmp_path)
    run(rdpi, "compensate", "model.json", "reference.csv", "-o", "drive.csv", "--engine", "f32", cwd=tmp_path)

    assert json.loads((tmp_path / "model.json").read_text())["schema"] == "rdpi-model/1"
    assert complaints(json.loads((tmp_path / "model.json").read_text())) == []
    assert "RDPI_PARAMS_SCHEMA" in (tmp_path / "rdpi_params.h").read_text()
    with open(tmp_path / "drive.csv") as file:
        drive = [float(row["command_V"]) for row in csv.DictReader(line for line in file if not line.startswith("#"))]
    assert len(drive) == len(rows)
    error_V = [asked - given for asked, (_, given, _) in zip(drive, rows)]
    assert math.sqrt(sum(e * e for e in error_V) / len(error_V)) < 1  # of 100 V peak to peak


def test_it_holds_the_schemas(bin_dir: Path, tmp_path: Path) -> None:
    """Of the three documents, and they are those of the checkout."""
    where = "import pathlib, rdpi; print(*pathlib.Path(rdpi.__file__).parent.glob('*/schemas/*.json'), sep='\\n')"
    found = {Path(path) for path in run(bin_dir / "python", "-c", where, cwd=tmp_path).splitlines()}
    assert {path.name for path in found} == {"rdpi-model-1.json", "rdpi-fit-1.json", "rdpi-gap-1.json"}
    for path in found:
        assert path.read_bytes() == (HOST_TOOLS / "rdpi" / path.parts[-3] / "schemas" / path.name).read_bytes()


def test_the_source_distribution_builds_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    build = f"from setuptools import build_meta; print(build_meta.build_sdist({str(tmp_path)!r}))"
    run(sys.executable, "-c", build, cwd=HOST_TOOLS)
    (sdist,) = tmp_path.glob("*.tar.gz")
    again = build_wheel(sdist, tmp_path)
    assert again.name == wheel.name
    assert set(zipfile.ZipFile(again).namelist()) == set(zipfile.ZipFile(wheel).namelist())
