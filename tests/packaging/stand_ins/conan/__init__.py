"""What a recipe imports of Conan 2."""

from __future__ import annotations

from types import SimpleNamespace


class _Settings:
    def __init__(self) -> None:
        self.removed: list[str] = []

    def rm_safe(self, name: str) -> None:
        self.removed.append(name)


class _CppInfo(SimpleNamespace):
    def set_property(self, name: str, value: str) -> None:
        assert (name, value) == ("cmake_target_name", "rdpi::rdpi")


class ConanFile:
    def __init__(self, source: str, package: str) -> None:
        self.source_folder, self.package_folder = source, package
        self.settings = _Settings()
        self.cache: dict[str, str] = {}
        self.cpp_info = _CppInfo(libs=[])
