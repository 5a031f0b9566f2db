"""The oldest CMake that the project claims, 3.22 of Ubuntu 22.04, knows what the project uses of CMake.

The installed one is later. Its manual, Help/ beside its modules, tells when each command, option, variable and property
came.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = [ROOT / "CMakeLists.txt", *(file for folder in ("lib", "port", "examples", "tests")
                                    for name in ("CMakeLists.txt", "*.cmake")
                                    for file in sorted((ROOT / folder).rglob(name)))]
PROPERTIES = "prop_tgt", "prop_sf", "prop_test", "prop_dir", "prop_gbl"
# An older CMake takes them for names of the project's own: warnings stay warnings there.
WITHOUT_EFFECT = {"COMPILE_WARNING_AS_ERROR", "CMAKE_COMPILE_WARNING_AS_ERROR"}


@pytest.fixture(scope="module")
def manuals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    script = tmp_path_factory.mktemp("cmake") / "root.cmake"
    script.write_text('message("${CMAKE_ROOT}")')
    root = subprocess.run(["cmake", "-P", script], capture_output=True, text=True, check=True).stderr.strip()
    assert (Path(root) / "Help/command/project.rst").is_file()
    return Path(root) / "Help"


def version(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in text.split("."))


def oldest() -> tuple[int, ...]:
    return version(re.search(r"cmake_minimum_required\(VERSION ([0-9.]+)\)", (ROOT / "CMakeLists.txt").read_text())[1])


def came_with(page: Path) -> tuple[int, ...]:
    """The version in which what a page is about came, (0,) for one that does not say."""
    found = re.match(r"(?:\.\. \w.*\n|\n)*.+\n[-=]+\n\s*\.\. versionadded:: ([0-9.]+)", page.read_text())
    return version(found[1]) if found else (0,)


def later_options(page: Path) -> set[str]:
    """Words of a command that came later than the oldest CMake claimed; the line above each such mark names them.

    A mark behind other text is about what follows it, such as an option of an option.
    """
    lines, words = page.read_text().splitlines(), set()
    for k, line in enumerate(lines):
        mark = re.match(r"(\s+)\.\. versionadded:: ([0-9.]+)", line)
        if mark and version(mark[2]) > oldest():
            above = next((text for text in lines[k - 1::-1] if text.strip()), "")
            if len(above) - len(above.lstrip()) >= len(mark[1]):
                continue
            words |= set(re.findall(r"\b[A-Z][A-Z_]{3,}\b", above.partition("<")[0]))
    return words


def code(file: Path) -> str:
    return re.sub(r"#.*", "", file.read_text())


def test_the_oldest_cmake_is_that_of_ubuntu_22_04() -> None:
    assert oldest() == (3, 22)
    for file in FILES:
        for found in re.findall(r"cmake_minimum_required\(VERSION ([0-9.]+)\)", code(file)):
            assert version(found) == oldest(), file


def test_the_presets_are_readable_for_it(manuals: Path) -> None:
    presets = json.loads((ROOT / "CMakePresets.json").read_text())
    text = (manuals / "manual/cmake-presets.7.rst").read_text()
    came = dict(re.findall(r"``(\d+)``\n\s+\.\. versionadded:: ([0-9.]+)", text))
    assert version(came[str(presets["version"])]) <= oldest()
    needs = presets["cmakeMinimumRequired"]
    assert (needs["major"], needs["minor"]) == oldest()


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_nothing_used_came_later(manuals: Path, file: Path) -> None:
    expressions = re.findall(r"\.\. genex:: \$<(\w+).*\n\s+\.\. versionadded:: ([0-9.]+)",
                             (manuals / "manual/cmake-generator-expressions.7.rst").read_text())
    later = {name for name, came in expressions if version(came) > oldest()}
    assert later and not later & set(re.findall(r"\$<(\w+)", code(file)))
    for command, arguments in re.findall(r"\b([a-z_]+)\s*\(([^()]*)", code(file)):
        words = set(re.findall(r"\w+", arguments)) - WITHOUT_EFFECT
        kinds = ("variable", *PROPERTIES) if "propert" in command else ("variable",)
        pages = [manuals / f"command/{command}.rst",
                 *(manuals / f"{kind}/{word}.rst" for kind in kinds for word in words)]
        for page in (page for page in pages if page.is_file()):
            assert came_with(page) <= oldest(), f"{page.stem} in {command}({arguments}"
        if pages[0].is_file():
            assert not words & later_options(pages[0]), f"{command}({arguments}"


def test_what_came_later_would_be_seen(manuals: Path) -> None:
    assert came_with(manuals / "command/block.rst") > oldest() >= came_with(manuals / "command/cmake_path.rst") > (0,)
    assert came_with(manuals / "prop_tgt/COMPILE_WARNING_AS_ERROR.rst") > oldest()
    assert "FILE_SET" in later_options(manuals / "command/target_sources.rst") | later_options(
        manuals / "command/install.rst")


@pytest.mark.parametrize(("maximum", "value"), [("RDPI_MAX_PLAYS", "0"), ("RDPI_MAX_DEADZONES", "OFF"),
                                                ("RDPI_MAX_WINDOW", "N"), ("RDPI_MAX_PLAYS", "1.5"),
                                                ("RDPI_MAX_POLES", "-1"), ("RDPI_MAX_CURVE_PIECES", "x")])
def test_a_maximum_is_a_whole_number_from_1_on(maximum: str, value: str, tmp_path: Path) -> None:
    done = subprocess.run(["cmake", "-S", ROOT, "-B", tmp_path, f"-D{maximum}={value}", "-DRDPI_BUILD_TESTS=OFF",
                           "-DRDPI_BUILD_EXAMPLES=OFF"], capture_output=True, text=True)
    assert done.returncode != 0 and f"{maximum} is '{value}'" in " ".join(done.stderr.split())


@pytest.mark.parametrize("maximum", ["RDPI_MAX_PLAYS", "RDPI_MAX_DEADZONES", "RDPI_MAX_WINDOW", "RDPI_MAX_POLES",
                                     "RDPI_MAX_CURVE_PIECES"])
def test_the_compiler_refuses_a_maximum_of_0(maximum: str) -> None:
    command = ["cc", "-std=c99", "-fsyntax-only", "-I", ROOT / "lib/include", "-x", "c", ROOT / "lib/src/status.c"]
    assert subprocess.run([*command, f"-D{maximum}=1"], capture_output=True).returncode == 0
    done = subprocess.run([*command, f"-D{maximum}=0"], capture_output=True, text=True)
    assert done.returncode != 0 and "as at least 1" in done.stderr
