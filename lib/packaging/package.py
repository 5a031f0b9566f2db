#!/usr/bin/env python3
"""Makes what others install, of the files in the project as they are now.

    lib/packaging/package.py [KIND...] [-o DIRECTORY]

KIND: arduino, platformio, zephyr, esp-idf, cmsis, vcpkg, conan: the library for a build system
      deb, source-tar, source-zip: by CPack, the installed library and the whole project
      wheel: the host tools, by the Python of .venv, or by the one that runs this if there is no .venv

Without any, all are made. The default of DIRECTORY is build/packages.

The folder of a build system beside this file holds its manifests. They go into the archive as they are, but for these words:

    @VERSION@           the version that the project's CMakeLists.txt states
    @DATE@              the date of that version, from CHANGELOG.md
    @SOURCE@, @HEADER@  the line is repeated for each file of lib/src/*.c, of lib/include/rdpi/*.h
    @RDPI_...@          the default of that setting, from lib/include/rdpi/types.h

No list of files is written down anywhere: a new file of lib/ is in all archives.

The same files and tools give the same bytes. All files in an archive are dated SOURCE_DATE_EPOCH (seconds since 1970, from the
environment), or 1980-01-01.
"""

from __future__ import annotations

import argparse
import gzip
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIB = ROOT / "lib"
HERE = LIB / "packaging"
BUSES = "rdpi_i2c.h", "rdpi_spi.h"  # headers of port/include that drivers of DACs stand on
EARLIEST = 315532800  # 1980-01-01, before which a zip has no time

Tree = dict[str, bytes]  # path in an archive -> what the file holds


def version() -> str:
    """The version that the project's CMakeLists.txt states: the only place."""
    return re.search(r"^project\(rdpi VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text(), re.MULTILINE)[1]


def date() -> str:
    """The date of this version, YYYY-MM-DD, from CHANGELOG.md."""
    found = re.search(rf"^## \[{re.escape(version())}\] - (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    if found is None:
        raise SystemExit(f"package.py: CHANGELOG.md has no date for version {version()}")
    return found[1]


def defaults() -> dict[str, str]:
    """Setting of types.h -> its default."""
    types = (LIB / "include/rdpi/types.h").read_text()
    return dict(re.findall(r"^#ifndef (RDPI_\w+)\n#define \1 (\d+)", types, re.MULTILINE))


def rendered(text: str) -> str:
    """A manifest with its words replaced."""
    files = {"SOURCE": sorted(path.name for path in LIB.glob("src/*.c")),
             "HEADER": sorted(path.name for path in LIB.glob("include/rdpi/*.h"))}
    lines = []
    for line in text.splitlines(keepends=True):
        names = next((names for word, names in files.items() if f"@{word}@" in line), None)
        lines += [line] if names is None else [re.sub("@(SOURCE|HEADER)@", name, line) for name in names]
    words = {"VERSION": version(), "DATE": date(), **defaults()}
    return re.sub(r"@([A-Z_]+)@", lambda found: words[found[1]], "".join(lines))


def files_in(folder: Path, to: str = "") -> Tree:
    return {to + path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*")
            if path.is_file() and "__pycache__" not in path.parts}


def manifests(kind: str) -> Tree:
    return {name: rendered(data.decode()).encode() for name, data in files_in(HERE / kind).items()}


def library(include: str = "include", source: str = "src") -> Tree:
    """The library with its public headers and its sources in the folders named, and the licence."""
    return {**files_in(LIB / "include", f"{include}/"), **files_in(LIB / "src", f"{source}/"),
            "LICENSE": (ROOT / "LICENSE").read_bytes()}


def project() -> Tree:
    """What CMake needs of the project to build and install the library."""
    return {name: (ROOT / name).read_bytes()
            for name in ("CMakeLists.txt", "LICENSE", "lib/packaging/rdpi.pc.in")} | {
            f"lib/{name}": data for name, data in library().items() if name != "LICENSE"}


def dac_drivers() -> Tree:
    """The drivers of DACs and the headers of their buses; who uses one writes the functions of its bus."""
    sources = [path for path in (ROOT / "port/drivers").glob("*.c")
               if any(f'#include "{bus}"' in path.read_text() for bus in BUSES)]
    files = [*sources, *(source.with_suffix(".h") for source in sources)]
    return {f"src/drivers/{path.name}": path.read_bytes() for path in files} | {
        f"src/{bus}": (ROOT / "port/include" / bus).read_bytes() for bus in BUSES}


def arduino() -> Tree:
    """The Arduino IDE finds a library by a header at the top of src/."""
    sketches = manifests("arduino")
    params = (ROOT / "examples/track/params/rdpi_params.h").read_bytes()
    actuators = {str(Path(name).with_name("rdpi_params.h")): params for name in sketches if name.endswith(".ino")}
    return {"src/rdpi.h": b'#include "rdpi/rdpi.h"\n', **library("src", "src"), **dac_drivers(), **sketches, **actuators}


def vcpkg() -> Tree:
    top = f"rdpi-{version()}"
    return {**manifests("vcpkg"), f"{top}.tar.gz": tar_gz(top, project())}


def epoch() -> int:
    return max(EARLIEST, int(os.environ.get("SOURCE_DATE_EPOCH", EARLIEST)))


def tar_gz(top: str, tree: Tree) -> bytes:
    packed = io.BytesIO()
    with gzip.GzipFile(fileobj=packed, mode="wb", filename="", mtime=epoch()) as stream, \
            tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, data in sorted(tree.items()):
            member = tarfile.TarInfo(f"{top}/{name}" if top else name)
            member.size, member.mtime = len(data), epoch()
            archive.addfile(member, io.BytesIO(data))
    return packed.getvalue()


def zipped(top: str, tree: Tree) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, data in sorted(tree.items()):
            member = zipfile.ZipInfo(f"{top}/{name}" if top else name, time.gmtime(epoch())[:6])
            member.compress_type, member.create_system = zipfile.ZIP_DEFLATED, 3  # so that the mode counts
            member.external_attr = 0o644 << 16
            archive.writestr(member, data)
    return packed.getvalue()


def run(*command: object) -> None:
    """Runs a program; prints what it said only if it fails."""
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          env={**os.environ, "SOURCE_DATE_EPOCH": str(epoch())}, umask=0o022)
    if done.returncode != 0:
        raise SystemExit(f"package.py: {' '.join(map(str, command))}\n{done.stdout}")


def by_cpack(generator: str, config: str, work: Path) -> None:
    build = work / "build"
    run("cmake", "-S", ROOT, "-B", build, "-DCMAKE_INSTALL_PREFIX=/usr", "-DCMAKE_INSTALL_DOCDIR=share/doc/librdpi-dev",
        "-DCMAKE_BUILD_TYPE=Release", "-DRDPI_BUILD_TESTS=OFF", "-DRDPI_BUILD_EXAMPLES=OFF")
    if generator == "DEB":
        run("cmake", "--build", build)
    run("cpack", "-G", generator, "--config", build / config, "-B", work / "made")


def wheel(work: Path) -> None:
    venv = ROOT / ".venv/bin/python"
    run(venv if venv.exists() else sys.executable, "-m", "pip", "--isolated", "--disable-pip-version-check", "wheel", "--no-index", "--no-deps",
        "--no-build-isolation", "--no-cache-dir", "--wheel-dir", work / "made", ROOT / "host_tools")
    (made,) = Path(work, "made").glob("*.whl")
    with zipfile.ZipFile(made) as archive:  # modes are those of the checkout
        made.write_bytes(zipped("", {name: archive.read(name) for name in archive.namelist()}))


# kind -> (its files, folder in the archive, how it is packed, name of the archive)
TREES = {
    "arduino": (arduino, "rdpi", zipped, "rdpi-{version}-arduino.zip"),
    "platformio": (lambda: library() | manifests("platformio"), "", tar_gz, "rdpi-{version}-platformio.tar.gz"),
    "zephyr": (lambda: library() | manifests("zephyr"), "rdpi", tar_gz, "rdpi-{version}-zephyr.tar.gz"),
    "esp-idf": (lambda: library() | manifests("esp-idf"), "rdpi", tar_gz, "rdpi-{version}-esp-idf.tar.gz"),
    "cmsis": (lambda: library() | manifests("cmsis"), "", zipped, "rdpi.rdpi.{version}.pack"),
    "vcpkg": (vcpkg, "rdpi", tar_gz, "rdpi-{version}-vcpkg.tar.gz"),
    "conan": (lambda: project() | manifests("conan"), "rdpi", tar_gz, "rdpi-{version}-conan.tar.gz"),
}

# kind -> what makes it in made/ of a directory, and its name there
TOOLS = {
    "deb": (lambda work: by_cpack("DEB", "CPackConfig.cmake", work), "*.deb"),
    "source-tar": (lambda work: by_cpack("TGZ", "CPackSourceConfig.cmake", work), "*.tar.gz"),
    "source-zip": (lambda work: by_cpack("ZIP", "CPackSourceConfig.cmake", work), "*.zip"),
    "wheel": (wheel, "*.whl"),
}
KINDS = [*TREES, *TOOLS]


def make(kind: str, folder: Path) -> Path:
    """Writes the archive of one kind into `folder` and returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    if kind in TREES:
        tree, top, pack, name = TREES[kind]
        path = folder / name.format(version=version())
        path.write_bytes(pack(top, tree()))
        return path
    make_in, name = TOOLS[kind]
    with tempfile.TemporaryDirectory(prefix="rdpi-package-") as work:
        make_in(Path(work))
        (made,) = Path(work, "made").glob(name)
        return Path(shutil.copy(made, folder / made.name))


def main() -> None:
    about, _, details = __doc__.partition("\n\n")
    parser = argparse.ArgumentParser(description=about, epilog=details, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("kind", nargs="*", metavar="KIND", help="the archives to make; default: all")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build/packages", metavar="DIRECTORY")
    given = parser.parse_args()
    unknown = sorted(set(given.kind) - set(KINDS))
    if unknown:
        parser.error(f"no such kind: {', '.join(unknown)}; there are {', '.join(KINDS)}")
    for kind in given.kind or KINDS:
        print(make(kind, given.output))


if __name__ == "__main__":
    sys.exit(main())
