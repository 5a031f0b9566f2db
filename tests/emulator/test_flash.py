"""The target `flash`, with programs in the place of OpenOCD, pyOCD and st-flash that only note their arguments."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from rdpi.firmware import write_header
from rdpi.model import Model

ROOT = Path(__file__).resolve().parents[2]
# OpenOCD's and pyOCD's names of the chip; where the stack begins, which is the first word; bits of the DAC
BOARDS = {"stm32f405": ("target/stm32f4x.cfg", "stm32f405rg", 0x20020000, 16),
          "stm32g474": ("target/stm32g4x.cfg", "stm32g474retx", 0x20018000, 12)}


@pytest.fixture(scope="module", params=BOARDS)
def flash(request: pytest.FixtureRequest, model: Model, tmp_path_factory: pytest.TempPathFactory) -> Callable:
    """Configure with options and build `flash`; returns board, image and the arguments of each program that was run."""
    board, folder, programs = request.param, tmp_path_factory.mktemp("build"), tmp_path_factory.mktemp("programs")
    params = tmp_path_factory.mktemp("params")
    write_header(replace(model, drive=replace(model.drive, dac_bits=BOARDS[board][3])), params / "rdpi_params.h")
    shutil.copy(ROOT / "examples/track/params/rdpi_profile.h", params)
    for name in ("openocd", "pyocd", "st-flash"):
        (programs / name).write_text(f'#!/bin/sh\nprintf "%s\\n" {name} "$@" >>"{programs}/log"\n')
        (programs / name).chmod(0o755)
    environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"}

    def run(*options: str) -> tuple[str, Path, list[str], subprocess.CompletedProcess]:
        (programs / "log").write_text("")
        configure = ["cmake", "--preset", board, "-S", ROOT, "-B", folder, "-DRDPI_EXCITE_DIR=",
                     f"-DRDPI_PARAMS_DIR={params}", *options]
        configured = subprocess.run(configure, env=environment, capture_output=True, text=True)
        assert configured.returncode == 0, configured.stderr
        done = subprocess.run(["cmake", "--build", folder, "--target", "flash"], env=environment, capture_output=True,
                              text=True)
        return board, folder / "track", (programs / "log").read_text().splitlines(), done

    return run


@pytest.mark.slow
def test_openocd_is_the_first_choice(flash: Callable) -> None:
    board, image, arguments, done = flash("-DRDPI_FLASHER=")
    assert done.returncode == 0
    assert arguments == ["openocd", "-f", "interface/stlink.cfg", "-f", BOARDS[board][0],
                         "-c", f"program {{{image}}} verify reset exit"]
    assert image.read_bytes()[:4] == b"\x7fELF"


def test_pyocd(flash: Callable) -> None:
    board, image, arguments, done = flash("-DRDPI_FLASHER=pyocd")
    assert done.returncode == 0
    assert arguments == ["pyocd", "flash", "--target", BOARDS[board][1], "--format", "elf", str(image)]


def test_st_flash_gets_the_memory_from_its_first_word_on(flash: Callable) -> None:
    board, image, arguments, done = flash("-DRDPI_FLASHER=st-flash")
    assert done.returncode == 0
    assert arguments == ["st-flash", "--reset", "write", f"{image}.bin", "0x08000000"]
    stack, reset = struct.unpack("<II", image.with_name("track.bin").read_bytes()[:8])
    assert stack == BOARDS[board][2] and reset >> 24 == 0x08


def test_without_any_the_packages_are_named(flash: Callable) -> None:
    _, _, arguments, done = flash("-DRDPI_FLASHER=no-such-programmer")
    assert done.returncode != 0 and not arguments
    assert "install openocd, python3-pyocd or stlink-tools" in done.stdout


def test_of_two_applications_it_is_the_excitation(flash: Callable, tmp_path: Path) -> None:
    bits = BOARDS[flash("-DRDPI_FLASHER=openocd")[0]][3]
    (tmp_path / "drive.csv").write_text("time_s,command_V\n" + "".join(f"{k / 1000:.3f},{k}\n" for k in range(20)))
    subprocess.run([sys.executable, "-m", "rdpi", "profile", tmp_path / "drive.csv", "--dac", f"{bits}:0:100",
                    "-o", tmp_path / "rdpi_profile.h"], check=True, capture_output=True)
    _, image, arguments, done = flash("-DRDPI_FLASHER=openocd", f"-DRDPI_EXCITE_DIR={tmp_path}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert arguments[-1] == f"program {{{image.with_name('excite')}}} verify reset exit"


def test_a_model_of_another_dac_does_not_build(flash: Callable, model: Model, tmp_path: Path) -> None:
    write_header(replace(model, drive=replace(model.drive, dac_bits=14)), tmp_path / "rdpi_params.h")
    shutil.copy(ROOT / "examples/track/params/rdpi_profile.h", tmp_path)
    _, _, arguments, done = flash("-DRDPI_FLASHER=openocd", f"-DRDPI_PARAMS_DIR={tmp_path}")
    assert done.returncode != 0 and not arguments
    assert "this board's DAC has other bits than the model" in done.stderr
