"""What is seen of a recording while it goes on: the latest seconds, in a terminal and in a window."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import streams
from captures import SENT
from matplotlib.figure import Figure
from ports import Board
from streams import Info, stream

from rdpi.board import Decoder, Live, latest_seconds
from rdpi.board.live import POINTS, SPAN_S
from rdpi.cli.view import ASCII, BLOCKS, curves
from rdpi.cli.window import Window, draw
from rdpi.data import read_recording
from rdpi.errors import BadInput

RATE_HZ = Info().rate_hz


def live(sent: list[streams.Sample], info: Info = Info()) -> Live | None:
    decoder = Decoder("board")
    decoder.feed(stream(sent, info, finished=0))
    return latest_seconds(decoder)


def test_nothing_has_come() -> None:
    assert live([]) is None


def test_the_latest_seconds_of_all_that_came() -> None:
    count = int(1.4 * SPAN_S * RATE_HZ)
    now = live(streams.samples(count, adc_counts=2000, reference=4.0))
    assert len(now.time_s) <= POINTS and now.time_s[-1] == 0 and np.all(np.diff(now.time_s) > 0)
    assert now.time_s[0] == pytest.approx(-SPAN_S, abs=0.02)
    assert set(map(len, now.columns.values())) == {len(now.time_s)} and now.missing == 0
    assert now.samples in (count, count - 1)  # nothing confirms the last one yet
    assert np.allclose(now.columns["displacement_um"], 2.5) and np.allclose(now.columns["error_um"], 1.5)


def test_what_is_lost_takes_its_time() -> None:
    now = live([one for one in streams.samples(300) if not 100 <= one.sequence < 200])
    assert now.missing == 100 and np.max(np.diff(now.time_s)) == pytest.approx(101 / RATE_HZ)


def test_columns_are_those_that_there_are() -> None:
    unread = streams.samples(50, adc_counts=streams.NO_READING)
    assert live(unread).columns.keys() == {"command_V", "reference_um"}
    some = [replace(one, adc_counts=streams.NO_READING if one.sequence % 2 else 100) for one in unread]
    assert np.isnan(live(some).columns["displacement_um"]).sum() in (24, 25)
    alone = Info(numbers=streams.NONE)
    assert live(streams.samples(50), alone).columns.keys() == {"command_V", "displacement_um"}


def test_a_curve_for_each_column() -> None:
    t = np.linspace(-1, 0, 101)
    now = Live(t, {"command_V": 50 + 10 * t, "displacement_um": np.where(t < -0.5, np.nan, t)}, 101, 0)
    reading, drive = curves(now, 120, "utf-8")
    assert drive.startswith("drive") and drive.endswith("40 to 50 V, now 50")
    shown = drive.split()[1]
    assert shown == "".join(sorted(shown, key=BLOCKS.index)) and set(shown) == set(BLOCKS)
    assert reading.startswith("reading            ") and "-0.5 to 0 um" in reading
    assert all(len(line) <= 80 for line in curves(now, 80, "utf-8"))
    assert set(curves(now, 80, "latin-1")[1].split()[1]) == set(ASCII)


def test_a_constant_and_a_gap_have_curves_too() -> None:
    now = Live(np.array([-1.0, 0.0]), {"command_V": np.array([5.0, 5.0]), "error_um": np.array([1.0, np.nan])}, 2, 0)
    error, drive = curves(now, 80, "utf-8")
    assert "now" not in error and drive.endswith("5 to 5 V, now 5")


def test_a_window_has_a_panel_for_what_there_is() -> None:
    figure, t = Figure(), np.linspace(-1, 0, 10)
    draw(figure, Live(t, {"command_V": t, "reference_um": t, "displacement_um": t, "error_um": 0 * t}, 10, 3))
    assert [len(axes.lines) for axes in figure.axes] == [2, 1, 1]
    assert [axes.get_ylabel() for axes in figure.axes] == ["position [µm]", "error [µm]", "drive [V]"]
    assert figure.axes[0].get_title() == "10 samples, 3 lost"
    draw(figure, Live(t, {"command_V": t}, 10, 0))
    assert [len(axes.lines) for axes in figure.axes] == [1]


def test_no_window_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(BadInput, match="--window: no window can be opened here: .*display"):
        Window("rdpi record")


def test_a_recording_is_whole_beside_its_window(board: Board, run_csv: Path) -> None:
    environment = {name: text for name, text in os.environ.items() if name not in ("WAYLAND_DISPLAY", "MPLBACKEND")}
    command = [sys.executable, "-m", "rdpi", "record", board.port, "-o", run_csv, "--window"]
    board.renew()
    with subprocess.Popen(["xvfb-run", "-a", *command], env=environment, stderr=subprocess.PIPE, text=True) as process:
        board.wait()
        board.send(stream(SENT))
        _, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    assert len(read_recording(run_csv)) == len(SENT)
