"""What the tests of the host tools share."""

from __future__ import annotations

import itertools
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import click.testing
import hypothesis
import numpy as np
import pytest
import written
from captures import WITHOUT_A_FEW
from ports import Board
from streams import stream

from rdpi.cli import main
from rdpi.data import Recording, read_recording, sample_times

# No time limit per example, which a busy machine breaks; no folder of examples in the checkout; in CI the same examples
# every time, so that what lands depends on the code alone. `--hypothesis-profile long` is for fuzzing: see `rounds`.
hypothesis.settings.register_profile("rdpi", deadline=None, database=None, derandomize="CI" in os.environ)
hypothesis.settings.register_profile("long", hypothesis.settings.get_profile("rdpi"), max_examples=2000,
                                     derandomize=False)
hypothesis.settings.load_profile("rdpi")
written.install()  # what a command writes in this process is checked
LONG_S = float(os.environ.get("RDPI_FUZZ_SECONDS", 60))

ROOT = Path(__file__).resolve().parents[2]
PICMA = Path(os.environ.get("RDPI_DATA", ROOT / ".." / "shared" / "data" / "picma_p885")).resolve()


@pytest.fixture
def long(pytestconfig: pytest.Config) -> bool:
    """Whether tests may take minutes: pytest was given `--hypothesis-profile long`."""
    return pytestconfig.getoption("--hypothesis-profile", None) == "long"


@pytest.fixture
def rounds(long: bool) -> Iterator[Iterator[int]]:
    """How often to check a property: once, or if `long` with new examples until RDPI_FUZZ_SECONDS (60) are over."""
    end, numbers = time.monotonic() + LONG_S, itertools.count()
    yield itertools.takewhile(lambda number: number == 0 or long and time.monotonic() < end, numbers)
    if long:
        print(f"{next(numbers) - 1} rounds of {hypothesis.settings.default.max_examples} examples")  # pytest -rP


@pytest.fixture
def rdpi() -> Callable[..., click.testing.Result]:
    """Run the command line in this process."""
    return lambda *arguments: click.testing.CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture
def run_csv(tmp_path: Path) -> Path:
    return tmp_path / "run.csv"


@pytest.fixture
def captured(tmp_path: Path) -> Path:
    """A stream with two gaps, as a serial port gave it."""
    path = tmp_path / "captured.bin"
    path.write_bytes(stream(WITHOUT_A_FEW))
    return path


@pytest.fixture
def imported(rdpi: Callable[..., click.testing.Result], tmp_path: Path) -> Callable[..., tuple[Recording, str]]:
    """Import content or a file with options; the recording and what was printed."""

    def run(source: str | bytes | Path, *options: str, name: str = "source.csv",
            required: tuple[str, ...] = ("command_V",)) -> tuple[Recording, str]:
        if not isinstance(source, Path):
            (tmp_path / name).write_bytes(source.encode() if isinstance(source, str) else source)
            source = tmp_path / name
        result = rdpi("import", source, *options, "-o", tmp_path / "run.csv")
        assert result.exit_code == 0, result.output
        return read_recording(tmp_path / "run.csv", required), result.output

    return run


@pytest.fixture
def folder(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work here, beside a copy of the module's `files`."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def refused(rdpi: Callable[..., click.testing.Result], tmp_path: Path) -> Callable[..., str]:
    """Run a command that must refuse its input; returns the message.

    Checks exit status 2, a message without traceback, and that neither a new nor an existing output file is touched.
    The output file is an argument that is the Path `refused.output`, anywhere in the command line.
    """
    output = tmp_path / "result" / "out.dat"

    def run(*arguments: object) -> str:
        assert output in arguments
        for existing in (False, True):
            output.parent.mkdir(exist_ok=True)
            if existing:
                output.write_text("as it was\n")
            result = rdpi(*arguments)
            assert result.exit_code == 2, result.output
            assert result.output.startswith("rdpi: ") and "Traceback" not in result.output
            assert result.output.count("\n") == 1
            assert [path.name for path in output.parent.iterdir()] == ([output.name] if existing else [])
        assert output.read_text() == "as it was\n"
        output.unlink()
        return result.output.removeprefix("rdpi: ").strip()

    run.output = output
    return run


def shared(folder: Path) -> Path:
    """A folder of the data that are not part of the project; where it is missing the test is skipped, but not in CI."""
    if not folder.is_dir():
        message = f"measured data not found in {folder}; set RDPI_DATA to the folder of picma_p885"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    return folder


@pytest.fixture
def picma() -> Path:
    """The measured stack records of PI P-885.91; see the README beside them."""
    return shared(PICMA)


@pytest.fixture
def damaged() -> Path:
    """Files that are damaged so that their readers crash; see the README beside them."""
    return shared(PICMA.parent / "damaged")


@pytest.fixture
def run_columns() -> dict[str, np.ndarray]:
    """200 samples of a small, plausible run at 1 kHz."""
    time_s = sample_times(200, 1000)
    command_V = np.round(50 - 50 * np.cos(2 * np.pi * 10 * time_s), 6)
    return {"time_s": time_s, "command_V": command_V, "displacement_um": np.round(0.12 * command_V + 0.3, 6)}


@pytest.fixture
def board() -> Iterator[Board]:
    board = Board()
    yield board
    if board.line >= 0:
        board.unplug()
