from __future__ import annotations

import sys
from pathlib import Path

import pytest

from rdpi.model import Model, read_model

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/bench"), str(Path(__file__).parent)]

from boards import Builder  # noqa: E402


@pytest.fixture(scope="package")
def model() -> Model:
    return read_model(ROOT / "examples/track/params/model.json")


@pytest.fixture(scope="package")
def build(model: Model, tmp_path_factory: pytest.TempPathFactory) -> Builder:
    return Builder(model, tmp_path_factory.mktemp)
