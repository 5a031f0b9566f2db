"""What pyproject.toml cannot say: the version's source, the compiled firmware, and where build files go."""

from __future__ import annotations

import atexit
import re
import shutil
import sys
import tempfile
from pathlib import Path

from setuptools import setup
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from firmware_build import EXTENSIONS, LIB, BuildFirmware  # noqa: E402


def version() -> str:
    """From the project's CMakeLists.txt, or in an sdist from its PKG-INFO."""
    for path, pattern in (
        (HERE / "PKG-INFO", r"^Version: (\S+)"),
        (HERE.parent / "CMakeLists.txt", r"^project\(rdpi VERSION (\S+)"),
    ):
        if path.is_file():
            return re.search(pattern, path.read_text(), re.MULTILINE)[1]
    raise SystemExit(f"rdpi: no version: neither PKG-INFO nor ../CMakeLists.txt beside {HERE}")


class SdistWithLib(sdist):
    """Carries lib/, which lies beside host_tools/ in a checkout."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        super().make_release_tree(base_dir, files)
        shutil.copytree(LIB, Path(base_dir) / "lib", dirs_exist_ok=True)


# Outside the checkout: it may be read-only, and a module deleted since must not come back from an old build/.
build = tempfile.mkdtemp(prefix="rdpi-build-")
atexit.register(shutil.rmtree, build, ignore_errors=True)

setup(
    version=version(),
    license="MIT",
    ext_modules=EXTENSIONS,
    cmdclass={"build_ext": BuildFirmware, "sdist": SdistWithLib},
    options={"build": {"build_base": build}, "egg_info": {"egg_base": build}},
)
