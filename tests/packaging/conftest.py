from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from triangle import ROOT, host_codes


@pytest.fixture(scope="session")
def package() -> ModuleType:
    """lib/packaging/package.py"""
    spec = importlib.util.spec_from_file_location("package", ROOT / "lib/packaging/package.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def codes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[int]]:
    """Engine -> the host's codes for the triangle."""
    work: Path = tmp_path_factory.mktemp("host")
    found = {engine: host_codes(engine, work / engine) for engine in ("f32", "q31")}
    assert len(found["f32"]) == 400 and len(set(found["f32"])) > 100
    return found
