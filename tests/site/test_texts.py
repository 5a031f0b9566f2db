"""What the texts show works: C compiles, commands take their options, files and settings exist."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import click
import pytest

from rdpi.cli import main

ROOT = Path(__file__).resolve().parents[2]
TEXTS = sorted(path for pattern in ("*.md", "*/README.md", "*/SAFETY.md", "*/*/README.md") for path in ROOT.glob(pattern)
               if path.relative_to(ROOT).parts[0] in ("lib", "port", "host_tools", "examples", "tests", path.name))
NAMES = [str(path.relative_to(ROOT)) for path in TEXTS]
INCLUDES = [f"-I{ROOT / folder}" for folder in ("lib/include", "port/include", "port/drivers", "examples/track/params", "examples/own")]
BEFORE = {"port/README.md": '#include "dac8562.h"\n#include "rdpi_port.h"\nvoid wait_ms(int ms);\n'}
PLACEHOLDERS = re.compile(r"BOARD|NAME|PART|\bDIR\b|[*{]|\.\.\.")


def c_blocks() -> list[tuple[str, str]]:
    return [(name, block) for name, path in zip(NAMES, TEXTS)
            for block in re.findall(r"^ *```c\n(.*?)^ *```", path.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)]


def in_code(path: Path) -> list[str]:
    """Lines of blocks, long lines joined, and what stands between backticks."""
    text = path.read_text(encoding="utf-8")
    fences = [block for language, block in re.findall(r"^ *```(\w*)\n(.*?)^ *```", text, re.DOTALL | re.MULTILINE)
              if not language]
    indented = re.findall(r"^    \S.*$", text, re.MULTILINE)
    prose = re.sub(r"^ *```.*?^ *```", "", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for block in fences for line in block.replace("\\\n", "").splitlines()]
    return [*lines, *indented, *(" ".join(one.split()) for one in re.findall(r"`([^`]+)`", prose))]


CODE = [(name, line) for name, path in zip(NAMES, TEXTS) for line in in_code(path)]


def test_texts_are_found() -> None:
    assert {"README.md", "lib/README.md", "port/README.md", "host_tools/README.md", "CONTRIBUTING.md",
            "examples/track/README.md"} <= set(NAMES)


@pytest.mark.parametrize("name, block", c_blocks(), ids=lambda text: text if text in NAMES else "c")
def test_c_compiles(tmp_path: Path, name: str, block: str) -> None:
    source = tmp_path / "text.c"
    source.write_text(BEFORE.get(name, "") + block, encoding="utf-8")
    done = subprocess.run(["cc", *"-std=c99 -Wall -Wextra -Wconversion -Wpedantic -Wno-unused-function -Werror".split(),
                           *INCLUDES, "-c", source, "-o", tmp_path / "text.o"], capture_output=True, text=True)
    assert done.returncode == 0, f"{name}:\n{done.stderr}"


@pytest.mark.parametrize("core", ["cortex-m0plus", "cortex-m4 -mfpu=fpv4-sp-d16 -mfloat-abi=hard"])
@pytest.mark.parametrize("optimisation", ["-O0", "-Og"])
def test_libm_is_not_needed(optimisation: str, core: str, tmp_path: Path) -> None:
    """Without optimisation either, as CMake's Debug compiles."""
    subprocess.run(["arm-none-eabi-gcc", "-mthumb", *f"-mcpu={core}".split(), optimisation, *INCLUDES, "-c",
                    *(ROOT / "lib/src").glob("*.c")], cwd=tmp_path, check=True)
    found = subprocess.run(["arm-none-eabi-nm", "--undefined-only", *tmp_path.glob("*.o")], capture_output=True, text=True,
                           check=True).stdout
    called = set(re.findall(r"^ +U (\w+)$", found, re.MULTILINE))
    assert {name for name in called if not name.startswith(("rdpi_", "__")) and name not in ("memcpy", "memset")} == set()


def test_there_is_c_to_compile() -> None:
    assert {name for name, _ in c_blocks()} >= {"README.md", "lib/README.md", "port/README.md"}


def test_commands_and_options_exist() -> None:
    seen = 0
    for name, line in CODE:
        for command, rest in re.findall(r"\brdpi ([a-z]+)((?: [^#|&;]*)?)", line.partition("  #")[0]):
            assert command in main.commands, f"{name}: {line}: no such command"
            options = {one for parameter in main.commands[command].params if isinstance(parameter, click.Option)
                       for one in parameter.opts} | {"--help"}
            for option in re.findall(r"(?<!\S)--?[a-zA-Z][\w-]*", rest):
                assert option in options, f"{name}: {line}: no option {option}"
                seen += 1
    assert seen > 20


def test_files_exist() -> None:
    seen = 0
    for name, line in CODE:
        for path in re.findall(r"(?<![\w./$=-])(?:lib|port|host_tools|examples|tests)/[\w./*{-]+", line):
            if not PLACEHOLDERS.search(path):
                assert (ROOT / path).exists(), f"{name}: {line}: there is no {path}"
                seen += 1
    assert seen > 40


def test_settings_exist() -> None:
    """Macros and CMake's variables."""
    files = [path for folder in ("lib", "port", "examples") for path in (ROOT / folder).rglob("*")
             if path.suffix in (".c", ".h", ".cmake", ".txt")]
    known = "\n".join(path.read_text(encoding="utf-8") for path in [*files, ROOT / "CMakeLists.txt"])
    python = "\n".join(path.read_text(encoding="utf-8") for folder in ("rdpi", "tests")
                       for path in (ROOT / "host_tools" / folder).rglob("*.py"))
    seen = 0
    for name, line in CODE:
        for setting in re.findall(r"\b-?D?(RDPI_[A-Z0-9_]+)", line):
            if not PLACEHOLDERS.search(setting):
                found = re.search(rf"\b{setting}\b" if setting[-1] != "_" else setting, known + python)
                assert found, f"{name}: {line}: nobody knows {setting}"
                seen += 1
    assert seen > 40
