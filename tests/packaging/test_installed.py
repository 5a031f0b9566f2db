"""What is made to be installed, installed in an empty place and used there; twice the same bytes."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

from triangle import HERE, PARAMS, ROOT, codes_of, host_codes, run

USE = HERE / "use.c"


@pytest.fixture(scope="module")
def archives(package: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Kind -> what package.py made of it."""
    folder = tmp_path_factory.mktemp("packages")
    return {kind: package.make(kind, folder) for kind in ("deb", "source-tar", "source-zip", "wheel")}


def sandbox(folder: Path) -> dict[str, str]:
    """An environment that leads to nothing of this checkout."""
    return {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "HOME": str(folder), "LC_ALL": "C.UTF-8"}


@pytest.fixture(scope="module")
def root(archives: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty file system on which dpkg has installed nothing but the .deb."""
    root = tmp_path_factory.mktemp("root")
    for folder in ("info", "updates", "triggers"):
        (root / "var/lib/dpkg" / folder).mkdir(parents=True)
    (root / "var/lib/dpkg/status").touch()
    run("dpkg", f"--root={root}", "--force-not-root", "--install", archives["deb"], env=sandbox(root))
    return root


def test_the_deb_is_one_package_without_scripts(package: ModuleType, archives: dict[str, Path], root: Path) -> None:
    listed = run("dpkg-query", f"--admindir={root}/var/lib/dpkg", "--show", "--showformat", "${Package} ${Version} ${Status}\n")
    assert listed == f"librdpi-dev {package.version()} install ok installed\n"
    about = run("dpkg", "--info", archives["deb"])
    assert "md5sums" in about and not any(script in about for script in ("preinst", "postinst", "prerm", "postrm"))
    assert next(root.rglob("usr/share/doc/librdpi-dev/copyright")).read_text() == (ROOT / "LICENSE").read_text()


def test_the_deb_with_pkg_config(root: Path, codes: dict[str, list[int]], tmp_path: Path) -> None:
    where = next(root.rglob("rdpi.pc")).parent
    flags = run("pkg-config", "--cflags", "--libs", "rdpi", env=sandbox(tmp_path) | {"PKG_CONFIG_LIBDIR": str(where)}).split()
    assert all(str(root) in flag for flag in flags if flag.startswith(("-I", "-L")))
    run("cc", USE, f"-iquote{PARAMS}", *flags, "-o", tmp_path / "use", env=sandbox(tmp_path))
    assert codes_of(tmp_path / "use") == codes


def built_by_cmake(folder: Path, lines: str, *options: str) -> Path:
    """The program of a CMake project whose `lines` take the library in."""
    (folder / "CMakeLists.txt").write_text(
        f"cmake_minimum_required(VERSION 3.22)\nproject(user C)\n{lines}\n"
        f'add_executable(use "{USE}")\ntarget_link_libraries(use rdpi::rdpi)\ntarget_include_directories(use PRIVATE "{PARAMS}")\n')
    run("cmake", "-S", folder, "-B", folder / "build", *options, env=sandbox(folder))
    run("cmake", "--build", folder / "build", "--target", "use", env=sandbox(folder))
    return folder / "build/use"


def test_the_deb_with_find_package(package: ModuleType, root: Path, codes: dict[str, list[int]], tmp_path: Path) -> None:
    use = built_by_cmake(tmp_path, f"find_package(rdpi {package.version()} REQUIRED)",
                         f"-DCMAKE_FIND_ROOT_PATH={root}", "-DCMAKE_FIND_ROOT_PATH_MODE_PACKAGE=ONLY",
                         f"-DCMAKE_PREFIX_PATH={root}/usr")
    assert codes_of(use) == codes


@pytest.mark.parametrize("kind", ["source-tar", "source-zip"])
def test_a_source_archive_with_fetch_content(archives: dict[str, Path], codes: dict[str, list[int]], tmp_path: Path,
                                             kind: str) -> None:
    digest = hashlib.sha256(archives[kind].read_bytes()).hexdigest()
    use = built_by_cmake(tmp_path, "include(FetchContent)\n"
                         f'FetchContent_Declare(rdpi URL "{archives[kind]}" URL_HASH SHA256={digest})\n'
                         "FetchContent_MakeAvailable(rdpi)")
    assert codes_of(use) == codes


def test_a_source_archive_with_add_subdirectory(archives: dict[str, Path], codes: dict[str, list[int]], tmp_path: Path) -> None:
    with tarfile.open(archives["source-tar"]) as archive:
        archive.extractall(tmp_path)
    use = built_by_cmake(tmp_path, f"add_subdirectory(\"{archives['source-tar'].name.removesuffix('.tar.gz')}\")")
    assert codes_of(use) == codes


def tracked() -> set[str]:
    listed = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=ROOT, text=True,
                            capture_output=True).stdout.split("\n")
    return {name for name in listed if name and (ROOT / name).is_file()}


def test_the_source_archives_hold_the_project_and_nothing_else(package: ModuleType, archives: dict[str, Path]) -> None:
    top = f"rdpi-{package.version()}/"
    with tarfile.open(archives["source-tar"]) as one, zipfile.ZipFile(archives["source-zip"]) as other:
        names = {member.name for member in one if member.isfile()}
        assert names == {name for name in other.namelist() if not name.endswith("/")}
    if not tracked():
        pytest.skip("not a git checkout: nothing tells what belongs to the project")
    assert {name.removeprefix(top) for name in names} == tracked()


def test_the_wheel(package: ModuleType, archives: dict[str, Path], codes: dict[str, list[int]], tmp_path: Path) -> None:
    """Into an environment of its own, whose other packages are Debian's."""
    place = tmp_path / "place"
    run("/usr/bin/python3", "-m", "venv", "--without-pip", "--system-site-packages", place)
    run(place / "bin/python", "-m", "pip", "--isolated", "--disable-pip-version-check", "install", "--no-index", "--no-deps",
        archives["wheel"], env=sandbox(tmp_path))
    assert run(place / "bin/rdpi", "--version", env=sandbox(tmp_path)).split()[-1] == package.version()
    for engine in ("f32", "q31"):
        assert host_codes(engine, tmp_path / engine, (str(place / "bin/rdpi"),), env=sandbox(tmp_path)) == codes[engine]


def copy_of_the_project(to: Path) -> Path:
    """At another time, in another place, in another order."""
    for name in sorted(tracked(), reverse=True):
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, to / name)
        os.utime(to / name, (1.2e9, 1.2e9))
    return to


def made(checkout: Path, output: Path, umask: int) -> dict[str, str]:
    """Name of each archive -> digest, of all that package.py makes."""
    run(sys.executable, checkout / "lib/packaging/package.py", "-o", output, umask=umask,
        env={**os.environ, "SOURCE_DATE_EPOCH": "1700000000"})
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in output.iterdir()}


@pytest.mark.long
def test_the_same_files_make_the_same_bytes(package: ModuleType, tmp_path: Path) -> None:
    if not tracked():
        pytest.skip("not a git checkout: nothing tells what belongs to the project")
    first = made(ROOT, tmp_path / "first", 0o022)
    assert len(first) == len(package.KINDS)
    assert made(copy_of_the_project(tmp_path / "elsewhere"), tmp_path / "second", 0o077) == first
