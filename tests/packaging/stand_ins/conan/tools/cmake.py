"""What a recipe imports of conan.tools.cmake."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from conan import ConanFile


def cmake_layout(recipe: ConanFile) -> None:
    recipe.build_folder = str(Path(recipe.source_folder) / "build")


class CMakeToolchain:
    def __init__(self, recipe: ConanFile) -> None:
        self.recipe, self.cache_variables = recipe, {}

    def generate(self) -> None:
        self.recipe.cache.update(self.cache_variables)


class CMake:
    def __init__(self, recipe: ConanFile) -> None:
        self.recipe = recipe

    def _run(self, *arguments: str) -> None:
        subprocess.run(["cmake", *arguments], check=True, stdout=sys.stderr)

    def configure(self) -> None:
        self._run("-S", self.recipe.source_folder, "-B", self.recipe.build_folder, "-DCMAKE_INSTALL_LIBDIR=lib",
                  f"-DCMAKE_INSTALL_PREFIX={self.recipe.package_folder}",
                  *(f"-D{name}={value}" for name, value in self.recipe.cache.items()))

    def build(self) -> None:
        self._run("--build", self.recipe.build_folder)

    def install(self) -> None:
        self._run("--install", self.recipe.build_folder)
