"""port/README.md, "Your own board", for a Cortex-M0+: its commands, run as printed, make an image for that core.

The board is the template with an RP2040's memories; nothing in it reaches a pin.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BOARD, CORE, FLASH_ORIGIN = "rp2040", "cortex-m0plus", 0x10000100
pytestmark = pytest.mark.slow


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of what a firmware is built from, with the template copied and renamed, and the places marked BOARD filled
    in as far as the linker needs them."""
    for name in ("CMakeLists.txt", "CMakePresets.json"):
        shutil.copy(ROOT / name, tmp_path)
    for name in ("lib", "port", "examples"):
        shutil.copytree(ROOT / name, tmp_path / name)
    folder = tmp_path / "port" / BOARD
    shutil.copytree(ROOT / "port/template", folder)
    (folder / "template.c").rename(folder / f"{BOARD}.c")
    settings = folder / "CMakeLists.txt"
    text = settings.read_text().replace("template", BOARD).replace('"BOARD"', f'"{CORE}"')
    text = text.replace("flash_origin=0", f"flash_origin={FLASH_ORIGIN:#x}").replace("ram_size=16K", "ram_size=264K")
    settings.write_text(text)
    return tmp_path


def commands(core: str = CORE) -> list[list[str]]:
    """The README's own, for this board."""
    text = (ROOT / "port/README.md").read_text().partition("## Your own board")[2]
    block = re.search(r"```\n(.*?)```", text, re.DOTALL)[1]
    assert f"-mcpu={CORE}" in block
    lines = block.replace("BOARD", BOARD).replace(CORE, core).splitlines()
    return [shlex.split(line) for line in lines if line.strip()]


@pytest.fixture
def image(checkout: Path) -> Path:
    for command in commands():
        done = subprocess.run(command, cwd=checkout, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    return checkout / "build" / BOARD / "track"


def test_the_image_is_for_the_core_that_was_named(image: Path) -> None:
    attributes = subprocess.run(["arm-none-eabi-readelf", "-A", image], capture_output=True, text=True).stdout
    assert re.search(r"Tag_CPU_arch: (.*)", attributes)[1] == "v6S-M"
    assert "Tag_FP_arch" not in attributes


def test_the_image_leaves_the_boot_block_alone(image: Path) -> None:
    """A programmer that goes by the program headers writes nothing in front of the flash's origin."""
    headers = subprocess.run(["arm-none-eabi-readelf", "-lW", image], capture_output=True, text=True).stdout
    physical = [int(line.split()[3], 16) for line in headers.splitlines() if line.split()[:1] == ["LOAD"]]
    assert min(physical) == FLASH_ORIGIN


@pytest.mark.parametrize("what, options, words", [
    ("another core", ["-DRDPI_CPU=-mcpu=cortex-m4"], f"port/{BOARD} runs on {CORE}; the compiler is told 'cortex-m4'"),
    ("a core that merely begins alike", ["-DRDPI_CPU=-mcpu=cortex-m0"], "the compiler is told 'cortex-m0'"),
    ("no core", ["-URDPI_CPU"], "RDPI_CPU is '' and names no core"),
    ("flags without a core", ["-DRDPI_CPU=-O1"], "RDPI_CPU is '-O1' and names no core"),
    ("no board", ["-DRDPI_PORT="], "RDPI_PORT is '', and port/ has no such board")])
def test_it_stops_with_words_at(checkout: Path, what: str, options: list[str], words: str) -> None:
    configure = commands()[0]
    name = options[0].removeprefix("-D").removeprefix("-U").partition("=")[0]
    command = [word for word in configure if not word.startswith(f"-D{name}=")] + options
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True)
    assert done.returncode != 0
    assert words in " ".join(done.stderr.split())


def test_a_port_that_states_no_core_is_told_so(checkout: Path) -> None:
    settings = checkout / "port" / BOARD / "CMakeLists.txt"
    settings.write_text("\n".join(line for line in settings.read_text().splitlines() if "RDPI_CORES" not in line))
    done = subprocess.run(commands()[0], cwd=checkout, capture_output=True, text=True)
    assert done.returncode != 0
    assert f"port/{BOARD}/CMakeLists.txt states no core" in " ".join(done.stderr.split())


def test_a_port_with_the_templates_placeholder_is_told_what_to_set(checkout: Path) -> None:
    settings = checkout / "port" / BOARD / "CMakeLists.txt"
    settings.write_text(settings.read_text().replace(f'"{CORE}"', '"BOARD"'))
    done = subprocess.run(commands()[0], cwd=checkout, capture_output=True, text=True)
    assert done.returncode != 0
    assert f"states no core: set the property RDPI_CORES of rdpi_port_{BOARD}" in " ".join(done.stderr.split())


def test_a_port_that_declares_a_watchdog_may_be_asked_for_it(checkout: Path) -> None:
    """By the template's line for it."""
    settings = checkout / "port" / BOARD / "CMakeLists.txt"
    configure = [*commands()[0], "-DRDPI_WATCHDOG_MS=100"]
    done = subprocess.run(configure, cwd=checkout, capture_output=True, text=True)
    assert done.returncode != 0
    assert "does not set the property RDPI_WATCHDOG" in " ".join(done.stderr.split())
    line = f"set_target_properties(rdpi_port_{BOARD} PROPERTIES RDPI_WATCHDOG ON)"
    settings.write_text(settings.read_text().replace(f"# {line}", line))
    done = subprocess.run(configure, cwd=checkout, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_build_folder_made_for_another_core_is_not_used_again(checkout: Path) -> None:
    """CMake keeps the flags of the first time."""
    configure = [word.replace(f"PORT={BOARD}", "PORT=qemu_mps2") for word in commands("cortex-m3")[0]]
    done = subprocess.run(configure, cwd=checkout, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    done = subprocess.run([word.replace("cortex-m3", "cortex-m4") for word in configure], cwd=checkout,
                          capture_output=True, text=True)
    assert done.returncode != 0
    assert "this build folder was made for other flags" in " ".join(done.stderr.split())
