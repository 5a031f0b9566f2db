"""The Arduino library, built by arduino-builder for an AVR and run in simavr."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import threading
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

from triangle import PARAMS, host_codes, run

BOARDS = {"atmega328p": "arduino:avr:uno", "atmega2560": "arduino:avr:mega:cpu=atmega2560"}
SKETCHES = {"f32": "Track", "q31": "TrackFixedPoint"}


@pytest.fixture(scope="module")
def libraries(package: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An Arduino libraries directory with nothing but the unpacked archive."""
    folder = tmp_path_factory.mktemp("arduino")
    with zipfile.ZipFile(package.make("arduino", folder)) as archive:
        archive.extractall(folder / "libraries")
    return folder / "libraries"


def build(libraries: Path, sketch: str, board: str, folder: Path) -> Path:
    folder.mkdir()
    done = subprocess.run([
        "arduino-builder", "-compile", "-hardware", "/usr/share/arduino/hardware", "-hardware",
        "/usr/share/arduino-builder", "-tools", "/usr/bin", "-libraries", libraries, "-fqbn", board, "-build-path", folder,
        # The core of Debian 12 needs it, and its avr-gcc 5.4 defines it for C only.
        "-prefs", "compiler.cpp.extra_flags=-DDECIMAL_DIG=__DECIMAL_DIG__",
        libraries / f"rdpi/examples/{sketch}/{sketch}.ino"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / f"{sketch}.ino.elf"


def prints(program: Path, chip: str) -> list[str]:
    """What a program sends over its serial line until "end". simavr adds colours, and dots for control characters."""
    lines = []
    simulator = subprocess.Popen(["simavr", "-m", chip, "-f", "16000000", program], stdout=subprocess.PIPE,
                                 stderr=subprocess.STDOUT, text=True)
    limit = threading.Timer(60, simulator.kill)
    limit.start()
    try:
        for line in simulator.stdout:
            lines.append(re.sub(r"\x1b\[\d+m|\.+\n", "", line))
            if lines[-1] == "end":
                return lines[:-1]
    finally:
        limit.cancel()
        simulator.kill()
        simulator.communicate()
    raise AssertionError(f"no end: {lines}")


@pytest.mark.parametrize("chip", BOARDS)
@pytest.mark.parametrize("engine", SKETCHES)
def test_a_sketch_outputs_the_codes_of_the_host(libraries: Path, codes: dict[str, list[int]], tmp_path: Path, engine: str,
                                                chip: str) -> None:
    program = build(libraries, SKETCHES[engine], BOARDS[chip], tmp_path / "build")
    status, *said = prints(program, chip)
    assert status == "status 0"
    assert [int(line) for line in said] == codes[engine]


def test_the_sketch_is_right_for_a_sensor_whose_zero_is_elsewhere(libraries: Path, tmp_path: Path) -> None:
    params = tmp_path / "params"
    params.mkdir()
    model = json.loads((PARAMS / "model.json").read_text()) | {"offset_um": -3.75}
    (params / "model.json").write_text(json.dumps(model))
    run(sys.executable, "-m", "rdpi", "header", params / "model.json", "-o", params / "rdpi_params.h")
    shutil.copytree(libraries, tmp_path / "libraries")
    shutil.copy(params / "rdpi_params.h", tmp_path / "libraries/rdpi/examples/TrackFixedPoint")
    program = build(tmp_path / "libraries", "TrackFixedPoint", BOARDS["atmega2560"], tmp_path / "build")
    status, *said = prints(program, "atmega2560")
    assert status == "status 0"
    codes = host_codes("q31", tmp_path / "host", params=params)
    assert max(abs(int(line) - code) for line, code in zip(said, codes, strict=True)) <= 1  # its double has 32 bits
    assert len(set(codes)) > 100


def test_the_library_tells_the_ide_what_it_asks_for(package: ModuleType, libraries: Path) -> None:
    properties = dict(line.split("=", 1) for line in (libraries / "rdpi/library.properties").read_text().splitlines())
    assert {"name", "version", "author", "maintainer", "sentence", "paragraph", "category", "url",
            "architectures"} <= set(properties)
    assert properties["version"] == package.version()
    assert (libraries / "rdpi/src" / properties["includes"]).is_file()
