"""Each manifest is read as its tool would, and what it lists is compiled: those files, include paths and macros only.

None of these tools runs here: PlatformIO, Zephyr's west, ESP-IDF, CMSIS-Pack's packchk, vcpkg and Conan. stand_ins/ holds
what the manifests call of them.
"""

from __future__ import annotations

import fnmatch
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

from triangle import HERE, PARAMS, ROOT, codes_of, run

STAND_INS = HERE / "stand_ins"
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
FUNCTION = re.compile(r"^(?:const )?\w+[ *]+(rdpi_\w+)\(", re.MULTILINE)


@dataclass
class Listed:
    """What a manifest says that a program that uses the library needs."""

    sources: list[Path]
    includes: list[Path]
    macros: list[str]


def unpacked(package: ModuleType, kind: str, folder: Path) -> Path:
    """The directory that the archive of a kind holds, in `folder`."""
    path = package.make(kind, folder)
    to = folder / kind
    with zipfile.ZipFile(path) if path.suffix in (".zip", ".pack") else tarfile.open(path) as archive:
        archive.extractall(to)
    return to / package.TREES[kind][1]


def public_functions() -> list[str]:
    """The functions of the public headers that the library, and not a header, holds."""
    return sorted({name for header in (ROOT / "lib/include/rdpi").glob("*.h")
                   for name in FUNCTION.findall(COMMENT.sub("", header.read_text()))})


def program_that_needs_all(folder: Path) -> Path:
    """use.c, and beside it the address of every public function: it does not link if a source is missing."""
    path = folder / "needs_all.c"
    names = public_functions()
    assert len(names) > 30
    path.write_text('#define main use_main\n#include "use.c"\n#undef main\nint main(void)\n{\n'
                    f"    void (*const all[])(void) = {{{', '.join(f'(void (*)(void)){name}' for name in names)}}};\n"
                    "    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) {\n"
                    "        if (!all[i]) {\n            return 2;\n        }\n    }\n    return use_main();\n}\n")
    return path


def built(listed: Listed, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    program = folder / "program"
    run("cc", "-std=c99", "-ffp-contract=off", *(f"-D{macro}" for macro in listed.macros),
        *(f"-I{path}" for path in listed.includes), f"-iquote{HERE}", f"-iquote{PARAMS}", *listed.sources,
        program_that_needs_all(folder), "-o", program)
    return program


# ---- readers: what a manifest says ----


def platformio(folder: Path) -> Listed:
    manifest = json.loads((folder / "library.json").read_text())
    build = manifest["build"]
    assert set(build) == {"includeDir", "srcDir", "srcFilter"}
    source = folder / build["srcDir"]
    chosen: set[Path] = set()
    for rule in build["srcFilter"]:
        sign, pattern = re.fullmatch(r"([+-])<(.+)>", rule).groups()
        found = {path for path in source.rglob("*.c") if fnmatch.fnmatch(str(path.relative_to(source)), pattern)}
        assert found or sign == "-", f"{rule} names no file"
        chosen = chosen | found if sign == "+" else chosen - found
    assert (folder / build["includeDir"] / manifest["headers"]).is_file()
    return Listed(sorted(chosen), [folder / build["includeDir"]], [])


def cmsis(folder: Path) -> Listed:
    package = ElementTree.parse(folder / "rdpi.rdpi.pdsc").getroot()
    assert (folder / package.findtext("license")).is_file()
    described = {one.get("Cclass") for one in package.iter("description")}
    files = [(file.get("category"), folder / file.get("name"), one) for one in package.iter("component")
             for file in one.iter("file")]
    assert {one.get("Cclass") for _, _, one in files} <= described
    for category, path, _ in files:
        assert path.is_dir() if category == "include" else path.is_file(), path
    headers = {path for category, path, _ in files if category == "header"}
    assert headers == set((folder / "include").rglob("*.h"))
    return Listed([path for category, path, _ in files if category == "source"],
                  [path for category, path, _ in files if category == "include"], [])


def kconfig(path: Path) -> dict[str, str]:
    """Symbol -> default. Only what our files use: config, bool or int, range, default."""
    found, symbol = {}, ""
    for line in path.read_text().splitlines():
        if line.startswith("config "):
            symbol = line.split()[1]
        elif line.startswith("\tdefault "):
            found[symbol] = line.split()[1]
        else:
            assert re.fullmatch(r'|(if|endif|menu|endmenu)\b.*|\t(bool|int) ".+"|\trange \d+ \d+', line), line
    return found


def by_cmake(kind: str, folder: Path, settings: dict[str, str]) -> Listed:
    """What a CMakeLists.txt tells the tool, by the tool's functions in stand_ins/KIND."""
    build = folder.parent / "by_cmake"
    shutil.rmtree(build, ignore_errors=True)
    run("cmake", "-S", STAND_INS / kind, "-B", build, f"-DMODULE={folder}",
        *(f"-DCONFIG_{name}={value}" for name, value in settings.items()))
    said = dict(line.partition("=")[::2] for line in (build / "listed.txt").read_text().splitlines())
    return Listed(*([Path(path) for path in said[key].split(";") if path] for key in ("sources", "includes")),
                  macros=[one for one in said["macros"].split(";") if one])


def zephyr(folder: Path) -> Listed:
    module = dict(re.findall(r"^ *(\w+): (\S+)$", (folder / "zephyr/module.yml").read_text(), re.MULTILINE))
    assert module["name"] == "rdpi"
    return by_cmake("zephyr", folder / module["cmake"], {"RDPI": "y", **kconfig(folder / module["kconfig"])})


def esp_idf(folder: Path) -> Listed:
    return by_cmake("esp-idf", folder, kconfig(folder / "Kconfig"))


READERS: dict[str, Callable[[Path], Listed]] = {"platformio": platformio, "cmsis": cmsis, "zephyr": zephyr, "esp-idf": esp_idf}


@pytest.mark.parametrize("kind", READERS)
def test_what_is_listed_is_all_and_enough(package: ModuleType, codes: dict[str, list[int]], tmp_path: Path, kind: str) -> None:
    listed = READERS[kind](unpacked(package, kind, tmp_path))
    assert {path.name for path in listed.sources} == {path.name for path in (ROOT / "lib/src").glob("*.c")}
    assert codes_of(built(listed, tmp_path / "build")) == codes


@pytest.mark.parametrize("kind", READERS)
def test_a_file_too_many_or_too_few_fails(package: ModuleType, tmp_path: Path, kind: str) -> None:
    folder = unpacked(package, kind, tmp_path)
    listed = READERS[kind](folder)
    for left_out in listed.sources:
        with pytest.raises(AssertionError, match="undefined reference"):
            built(Listed([path for path in listed.sources if path != left_out], listed.includes, listed.macros),
                  tmp_path / "build")
    with pytest.raises(AssertionError, match="rdpi/rdpi.h: No such file"):
        built(Listed(listed.sources, [], listed.macros), tmp_path / "build")
    next(folder.rglob("status.c")).unlink()
    with pytest.raises(AssertionError):
        built(READERS[kind](folder), tmp_path / "build")


@pytest.mark.parametrize("kind", ["zephyr", "esp-idf"])
def test_the_settings_are_those_of_the_library(package: ModuleType, tmp_path: Path, kind: str) -> None:
    folder = unpacked(package, kind, tmp_path)
    assert sorted(READERS[kind](folder).macros) == sorted(f"{name}={value}" for name, value in package.defaults().items())
    types = (ROOT / "lib/include/rdpi/types.h").read_text()
    assert set(package.defaults()) == set(re.findall(r"^#ifndef (RDPI_(?!TYPES_H)\w+)", types, re.MULTILINE))
    changed = next(folder.rglob("Kconfig"))
    changed.write_text(re.sub(r"(config RDPI_MAX_PLAYS\n.*\n.*\n\tdefault) \d+", r"\1 21", changed.read_text()))
    assert "RDPI_MAX_PLAYS=21" in READERS[kind](folder).macros


@pytest.mark.parametrize("kind", ["zephyr", "esp-idf"])
def test_a_menu_offers_what_the_library_accepts(package: ModuleType, tmp_path: Path, kind: str) -> None:
    """Every setting at both ends of its range; where types.h has a limit, the range goes as far as that."""
    folder = unpacked(package, kind, tmp_path)
    menu = next(folder.rglob("Kconfig")).read_text()
    found = re.findall(r'^config (RDPI_\w+)\n\tint ".+"\n\trange (\d+) (\d+)\n\tdefault (\d+)$', menu, re.MULTILINE)
    assert {name: default for name, _, _, default in found} == package.defaults()

    def accepted(name: str, value: int, *files: Path) -> bool:
        done = subprocess.run(["cc", "-std=c99", "-fsyntax-only", f"-I{folder}/include", f"-D{name}={value}", *files],
                              capture_output=True, text=True)
        assert done.returncode == 0 or "#error" in done.stderr, done.stderr
        return done.returncode == 0

    for name, low, high, default in found:
        low, high = int(low), int(high)
        assert low <= int(default) <= high
        for value in (low, high):
            assert accepted(name, value, *sorted(folder.glob("src/*.c"))), (name, value)
        types = folder / "include/rdpi/types.h"
        assert not accepted(name, low - 1, types) and (high == 65535 or not accepted(name, high + 1, types)), name


def test_zephyr_leaves_the_library_out_unless_it_is_chosen(package: ModuleType, tmp_path: Path) -> None:
    assert by_cmake("zephyr", unpacked(package, "zephyr", tmp_path) / "zephyr", {}) == Listed([], [], [])


# ---- those that build with the project's own CMakeLists.txt ----


def used(prefix: Path, folder: Path) -> Path:
    """A program of a project that finds what is installed in `prefix`."""
    folder.mkdir()
    (folder / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.22)\nproject(user C)\nfind_package(rdpi REQUIRED)\n"
        f'add_executable(program "{program_that_needs_all(folder)}")\ntarget_link_libraries(program rdpi::rdpi)\n'
        f'target_include_directories(program PRIVATE "{HERE}" "{PARAMS}")\n')
    run("cmake", "-S", folder, "-B", folder / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    assert f"rdpi_DIR:PATH={prefix}" in (folder / "build/CMakeCache.txt").read_text()
    run("cmake", "--build", folder / "build")
    return folder / "build/program"


def test_the_vcpkg_port(package: ModuleType, codes: dict[str, list[int]], tmp_path: Path) -> None:
    port = unpacked(package, "vcpkg", tmp_path)
    manifest = json.loads((port / "vcpkg.json").read_text())
    assert manifest["name"] == port.name == "rdpi"
    prefix = tmp_path / "installed"
    run("cmake", f"-DVERSION={manifest['version']}", f"-DCURRENT_PORT_DIR={port}", f"-DCURRENT_PACKAGES_DIR={prefix}",
        f"-DCURRENT_BUILDTREES_DIR={tmp_path / 'trees'}", "-P", STAND_INS / "vcpkg.cmake")
    assert (prefix / "share/rdpi/copyright").read_text() == (ROOT / "LICENSE").read_text()
    asked = {one["name"] for one in manifest["dependencies"]}
    assert asked == {"vcpkg-cmake", "vcpkg-cmake-config"}  # which bring the functions that the stand-in has
    assert codes_of(used(prefix, tmp_path / "use")) == codes


def test_the_conan_recipe(package: ModuleType, codes: dict[str, list[int]], tmp_path: Path) -> None:
    recipe = unpacked(package, "conan", tmp_path)
    prefix = tmp_path / "installed"
    said = json.loads(run(sys.executable, STAND_INS / "conan_create.py", recipe, tmp_path / "cache", prefix,
                          env={**os.environ, "PYTHONPATH": str(STAND_INS)}))
    assert said == {"name": "rdpi", "version": package.version(), "libs": ["rdpi"]}
    program = tmp_path / "program"
    run("cc", program_that_needs_all(tmp_path), f"-I{prefix}/include", f"-iquote{HERE}", f"-iquote{PARAMS}",
        f"-L{prefix}/lib", *(f"-l{name}" for name in said["libs"]), "-o", program)
    assert codes_of(program) == codes


# ---- what they have in common ----


def test_every_manifest_states_the_version(package: ModuleType, tmp_path: Path) -> None:
    assert set(package.TREES) - {"arduino", "zephyr"} == {"platformio", "cmsis", "esp-idf", "vcpkg", "conan"}
    version, stated = package.version(), {}
    for kind, file in {"arduino": "library.properties", "platformio": "library.json", "cmsis": "rdpi.rdpi.pdsc",
                       "esp-idf": "idf_component.yml", "vcpkg": "vcpkg.json", "conan": "conanfile.py"}.items():
        text = (unpacked(package, kind, tmp_path) / file).read_text()
        stated[kind] = set(re.findall(r"""^\W*(?:version|<release version|.*Cversion)\W{0,2}[=:] ?["']?(\d[\w.]*)""", text,
                                      re.MULTILINE))
        assert "@" not in re.sub(r"schemaVersion.*", "", text)
    assert stated == dict.fromkeys(stated, {version})


def test_every_archive_holds_all_of_the_library(package: ModuleType) -> None:
    files = {path.read_bytes() for folder in ("include", "src") for path in (ROOT / "lib" / folder).rglob("*.[ch]")}
    for kind, (tree, *_) in package.TREES.items():
        if kind != "vcpkg":  # whose sources are in an archive within: test_the_vcpkg_port
            assert files <= set(tree().values()), kind
            assert (ROOT / "LICENSE").read_bytes() in tree().values(), kind


def test_cmake_lists_all_sources() -> None:
    listed = re.findall(r"lib/src/(\w+\.c)", (ROOT / "CMakeLists.txt").read_text())
    assert sorted(listed) == sorted(path.name for path in (ROOT / "lib/src").glob("*.c"))


def test_the_command_refuses_what_it_does_not_know() -> None:
    done = subprocess.run([ROOT / "lib/packaging/package.py", "arduino", "debian"], capture_output=True, text=True)
    assert done.returncode == 2 and "no such kind: debian; there are arduino, " in done.stderr
