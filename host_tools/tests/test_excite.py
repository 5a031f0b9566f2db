"""`rdpi excite`: drives stay within what the actuator allows and hold what they promise."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from rdpi.cli import main
from rdpi.data import read_recording
from rdpi.data.excite import KINDS, Limits, make_drive
from rdpi.errors import BadInput

SHORT = {"steps": {"hold_s": 0.02}, "sine": {"cycles": 1}, "sawtooth": {"cycles": 1}, "startup": {"cycles": 20}}


def command(kind: str, limits: Limits = Limits(), sweep: bool = False, **options: object) -> np.ndarray:
    return make_drive(kind, limits, sweep, **options)[0]["command_V"]


def reversals(voltage: np.ndarray) -> np.ndarray:
    """Voltages of the turning points, ends included."""
    moving = voltage[np.append(True, np.diff(voltage) != 0)]
    turn = np.flatnonzero(np.diff(np.sign(np.diff(moving)))) + 1
    return moving[np.concatenate([[0], turn, [len(moving) - 1]])]


@settings(max_examples=40)
@given(kind=st.sampled_from(sorted(KINDS)), low=st.floats(-200, 200), span=st.floats(0.01, 500), rest=st.floats(0, 1),
       rate_hz=st.sampled_from([200.0, 1000.0, 3333.3]), slew=st.none() | st.floats(2, 100), sweep=st.booleans())
def test_limits_hold(kind: str, low: float, span: float, rest: float, rate_hz: float, slew: float | None,
                     sweep: bool) -> None:
    """Whatever the limits: starts and ends at rest, never outside, never too fast, with every default."""
    high = low + span
    rest_V = min(max(low + rest * span, low), high)
    limits = Limits(low, high, rest_V, rate_hz, None if slew is None else slew * span)
    columns, metadata = make_drive(kind, limits, sweep, **SHORT.get(kind, {}))
    voltage = columns["command_V"]
    assert voltage.min() >= low and voltage.max() <= high
    assert abs(voltage[0] - rest_V) <= 1e-9 and abs(voltage[-1] - rest_V) <= 1e-9
    assert voltage.min() <= low + 0.05 * span and voltage.max() >= high - 0.05 * span
    if slew is not None:
        assert np.abs(np.diff(voltage)).max() * rate_hz <= limits.slew_V_per_s
    np.testing.assert_allclose(columns["time_s"], np.arange(len(voltage)) / rate_hz, atol=1e-9)
    assert metadata["drive"] == kind and metadata["memory"] == "unknown" and "None" not in metadata.values()
    assert ("sweep_s" in metadata) == (sweep and kind != "startup")


@pytest.mark.parametrize("kind", KINDS)
def test_command_line(kind: str, rdpi: Callable, tmp_path: Path) -> None:
    paths = [tmp_path / "one.csv", tmp_path / "two.csv"]
    for path in paths:
        result = rdpi("excite", kind, "-o", path, "--sample-rate", "1000", "--min-V", "-20", "--max-V", "100",
                      "--rest-V", "10", "--json", tmp_path / "result.json")
        assert result.exit_code == 0, result.output
    assert paths[0].read_bytes() == paths[1].read_bytes()
    drive = read_recording(paths[0], required=("command_V",))
    assert drive.sample_rate_hz == 1000 and drive.command_V[0] == 10 == drive.command_V[-1]
    assert drive.metadata["min_V"] == "-20" and drive.metadata["rest_V"] == "10"
    assert json.loads((tmp_path / "result.json").read_text())["samples"] == len(drive)
    assert "starts at 10 V and ends at 10 V" in result.output


def test_help_lists_every_kind() -> None:
    choices = next(parameter.type.choices for parameter in main.commands["excite"].params if parameter.name == "kind")
    assert list(choices) == list(KINDS)


def test_sawtooth_has_constant_rates() -> None:
    voltage = command("sawtooth", Limits(0, 100, 0), frequencies_hz=(1, 5, 20), cycles=2)
    rates = np.abs(np.diff(voltage)) * 10_000
    assert set(np.round(rates, 4)) == {200, 1000, 4000}
    assert list(reversals(voltage)) == [0, 100] * 6 + [0]
    again = command("sawtooth", Limits(0, 100, 0), rates_V_per_s=(200, 1000, 4000), cycles=2)
    np.testing.assert_array_equal(voltage, again)


def test_minor_loops_cover_amplitudes() -> None:
    turns = reversals(command("minor-loops", Limits(0, 12, 0), levels=6, rates_V_per_s=(30, 60)))
    amplitudes = np.abs(np.diff(turns))
    assert amplitudes.max() == 12
    for low in range(0, 12, 2):
        assert ((amplitudes > low) & (amplitudes <= low + 2)).sum() >= 4
    assert np.all(np.diff(amplitudes[1:10]) < 0)  # shrinking
    rising = [a for a, b in zip(turns, turns[1:]) if b > a]
    assert min(rising) == 0 and max(rising) > 8  # loops hang on both branches


def test_steps_hold() -> None:
    limits = Limits(0, 10, 0, sample_rate_hz=1000)
    voltage = command("steps", limits, levels=4, hold_s=0.5, rates_V_per_s=[1e6])
    runs = np.split(voltage, np.flatnonzero(np.diff(voltage)) + 1)
    assert [run[0] for run in runs] == [0, 2.5, 5, 7.5, 10, 7.5, 5, 2.5, 0]
    assert all(len(run) == 501 for run in runs[1:])
    slow = command("steps", Limits(0, 10, 0, sample_rate_hz=1000, slew_V_per_s=100), levels=1, hold_s=0.5)
    assert (np.diff(slow) != 0).sum() == 2 * 101  # 10 V at just under 100 V/s
    fine = replace(limits, sample_rate_hz=20_000)
    staircase, commission = (np.abs(np.diff(command(kind, fine))).max() for kind in ("steps", "commission"))
    assert staircase <= 1.02 * commission


def test_a_chirp_reaches_what_rings_at_a_quarter_of_the_rate(tmp_path: Path, rdpi: Callable) -> None:
    small = "--min-V", "45", "--max-V", "55", "--sample-rate", "1000"
    printed = rdpi("excite", "chirp", "-o", tmp_path / "chirp.csv", *small).stdout
    assert "chirp from 1 to 250 Hz," in printed
    refused = rdpi("excite", "chirp", "-o", tmp_path / "chirp.csv", *small, "--frequencies", "1,260")
    assert refused.exit_code == 2 and "fewer than 4 samples per period" in refused.output


def test_multisine_lines_and_crest() -> None:
    frequencies = (1, 2, 3, 5, 7, 11, 13)
    limits, options = Limits(0, 10, rest_V=5), {"frequencies_hz": frequencies, "duration_s": 4.0}
    columns, metadata = make_drive("multisine", limits, False, seed=3, **options)
    voltage = columns["command_V"]
    start = int(np.argmax(np.abs(np.diff(voltage, 2)) > 1e-7)) + 1  # the straight move from rest ends in a kink
    assert metadata["frequencies_hz"] == "1 2 3 5 7 11 13" and metadata["seed"] == "3"
    period = voltage[start:start + 20_000] - voltage[start:start + 20_000].mean()
    spectrum = np.abs(np.fft.rfft(period))
    assert set(np.argsort(spectrum)[-7:] / 2) == set(frequencies)
    assert np.sort(spectrum)[-8] < 1e-6 * spectrum.max()
    crest = np.ptp(period) / 2 / period.std()
    assert crest < 2.1 and np.ptp(period) == pytest.approx(10)
    small = voltage[-20_000:-2000]
    assert 0.7 < np.ptp(small) <= 1 and 4.5 <= small.min() and small.max() <= 5.5
    assert not np.array_equal(voltage, command("multisine", limits, seed=4, **options))


def test_sine_and_chirp_frequencies() -> None:
    voltage = command("sine", Limits(0, 2, 0), frequencies_hz=(10, 40), cycles=3)
    index = np.arange(3001)
    np.testing.assert_allclose(voltage[:3001], 1 - np.cos(2 * np.pi * 10 * index / 10_000), atol=1e-9)
    np.testing.assert_allclose(voltage[3000:], 1 - np.cos(2 * np.pi * 40 * index[:751] / 10_000), atol=1e-9)
    voltage = command("chirp", Limits(-1, 1, rest_V=0), frequencies_hz=(5, 50), duration_s=4.0)
    rising = np.flatnonzero((voltage[:-1] < 0) & (voltage[1:] >= 0))
    periods = np.diff(rising[1:-1]) / 10_000
    assert periods[0] == pytest.approx(1 / 5, rel=0.2) and periods[-1] == pytest.approx(1 / 50, rel=0.05)
    assert np.all(np.diff(periods) <= 1e-4)


def play(voltage: np.ndarray, threshold: float, state: float) -> np.ndarray:
    states = np.empty_like(voltage)
    for index, value in enumerate(voltage):
        state = states[index] = max(value - threshold, min(value + threshold, state))
    return states


@pytest.mark.parametrize("rest_V", [0.0, 3.0, 10.0])
def test_sweep_makes_memory_known(rest_V: float) -> None:
    """Play operators that start anywhere agree after the sweep, and `sweep_s` says when."""
    columns, metadata = make_drive("sine", Limits(0, 10, rest_V, 1000), frequencies_hz=(5,), cycles=1)
    after = round(float(metadata["sweep_s"]) * 1000)
    for threshold in (0.1, 2, 4.9):
        starts = (-threshold, rest_V, 10 + threshold)
        states = [play(columns["command_V"], threshold, start)[after:] for start in starts]
        np.testing.assert_array_equal(states[0], states[1])
        np.testing.assert_array_equal(states[0], states[2])


def test_a_small_drive_begins_with_a_sweep_over_the_range_that_is_asked_for() -> None:
    """A sweep over the drive's own tenth of the range would leave what larger moves left."""
    small = Limits(4.5, 5.5, sample_rate_hz=1000, slew_V_per_s=300)
    columns, metadata = make_drive("sine", replace(small, sweep_V=(0, 10)), frequencies_hz=(5,), cycles=1)
    swept, after = np.split(columns["command_V"], [round(float(metadata["sweep_s"]) * 1000) + 1])
    assert (swept.min(), swept.max(), after.min(), after.max()) == (0, 10, 4.5, 5.5) and metadata["sweep_V"] == "0 10"
    assert np.abs(np.diff(columns["command_V"])).max() * 1000 <= 300
    for threshold in (0.5, 2, 4):
        states = [play(swept, threshold, start)[-1] for start in (-threshold, 10 + threshold)]
        assert states[0] == states[1] == pytest.approx(5, abs=0.3)
    alone, _ = make_drive("sine", small, frequencies_hz=(5,), cycles=1)
    np.testing.assert_array_equal(alone["command_V"][-len(after):], after)


@pytest.mark.parametrize(("kind", "sweep", "sweep_V", "words"), [
    ("sine", True, (1, 10), "`sweep_V` 1,10: must hold the drive"), ("sine", True, (0, np.nan), "must hold the drive"),
    ("sine", False, (0, 10), "no sweep"), ("startup", True, (0, 10), "the sweep itself")])
def test_sweeps_that_cannot_be(kind: str, sweep: bool, sweep_V: tuple[float, float], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        make_drive(kind, Limits(0, 10, sample_rate_hz=1000, sweep_V=sweep_V), sweep)


def test_startup_ends_without_memory() -> None:
    """In the middle of the range every play ends centred to within the last cycle's amplitude."""
    voltage = command("startup", Limits(0, 10, 0, 1000), end_V=5.0, cycles=50)
    assert voltage[0] == 0 and voltage[-1] == 5
    shrinking = np.abs(reversals(voltage)[1:-1] - 5)
    assert shrinking[0] == 5 and np.all(np.diff(shrinking) <= 1e-9) and shrinking[-1] <= 0.11
    for threshold in (0.5, 1, 2, 4):
        assert abs(play(voltage, threshold, 0.0)[-1] - 5) <= 0.11


def test_defaults_yield_but_wishes_are_refused() -> None:
    limits = Limits(0, 10, slew_V_per_s=50)
    _, metadata = make_drive("sine", limits)
    assert float(metadata["frequencies_hz"].split()[-1]) == pytest.approx(50 / (10 * np.pi), rel=0.01)
    with pytest.raises(BadInput, match="`slew_V_per_s` 50: a sine of 5 Hz needs 157.1 V/s; ask for lower `frequencies_hz`"):
        make_drive("sine", limits, frequencies_hz=(5,))
    columns, metadata = make_drive("startup", limits)
    assert float(metadata["frequencies_hz"]) == pytest.approx(50 / (2 * 10), rel=0.01)
    assert len(columns["time_s"]) == pytest.approx(20.5 / 2.5 * 10_000, rel=0.02)
    _, metadata = make_drive("chirp", Limits(sample_rate_hz=1000))
    assert metadata["frequencies_hz"] == "1 250"


REFUSED = {
    "limits crossed": ("sine", ["--min-V", "5", "--max-V", "1"], ["--max-V 1", "above --min-V 5"]),
    "limits not finite": ("sine", ["--max-V", "inf"], ["--max-V inf", "finite"]),
    "limits absurd": ("sine", ["--min-V", "-1e308", "--max-V", "1e308"], ["--min-V -1e+308", "at most 1e+06"]),
    "maximum absurd": ("sine", ["--max-V", "1e300"], ["--max-V 1e+300", "at most 1e+06"]),
    "sample rate absurd": ("sine", ["--sample-rate", "1e-300"], ["--sample-rate 1e-300", "1e-06 to 1e+08"]),
    "start-up too fast for slew": ("startup", ["--slew", "10", "--frequencies", "20"], ["--slew 10", "400 V/s"]),
    "rest outside": ("sine", ["--rest-V", "11"], ["--rest-V 11", "--max-V 10"]),
    "a sweep without the sweep": ("startup", ["--no-sweep"], ["startup is the sweep itself"]),
    "end outside": ("startup", ["--end-V", "-1"], ["--end-V -1", "--min-V 0"]),
    "sample rate": ("sine", ["--sample-rate", "0"], ["--sample-rate 0", "positive number of Hz"]),
    "slew": ("sine", ["--slew", "-5"], ["--slew -5", "positive number of V/s"]),
    "slew below resolution": ("sine", ["--slew", "1e-5"], ["--slew 1e-05", "nanovolts"]),
    "triangle too fast for slew": ("sawtooth", ["--slew", "100", "--rates", "50,200"],
                                   ["--slew 100", "200 V/s", "5 Hz"]),
    "triangle too fast to sample": ("sawtooth", ["--rates", "1e6"], ["--rates 1e+06", "20000 V/s", "--sample-rate"]),
    "both": ("sawtooth", ["--rates", "50", "--frequencies", "1"], ["--frequencies and --rates", "one of them"]),
    "chirp too fast for slew": ("chirp", ["--slew", "100", "--frequencies", "1,5"],
                                ["--slew 100", "a chirp to 5 Hz", "lower"]),
    "multisine too fast for slew": ("multisine", ["--slew", "10", "--frequencies", "1,5"],
                                    ["--slew 10", "multisine", "lower"]),
    "multisine too short": ("multisine", ["--frequencies", "0.1", "--duration", "1"],
                            ["--frequencies 0.1", "longer duration"]),
    "frequency too high": ("sine", ["--frequencies", "2000"],
                           ["--frequencies 2000", "at most 1000 Hz", "--sample-rate"]),
    "frequency zero": ("sine", ["--frequencies", "0"], ["--frequencies 0", "positive number of Hz"]),
    "frequency not a number": ("sine", ["--frequencies", "nan"], ["--frequencies nan", "positive"]),
    "one chirp frequency": ("chirp", ["--frequencies", "5"], ["two different frequencies"]),
    "two start-up frequencies": ("startup", ["--frequencies", "5,6"], ["exactly one"]),
    "option of another kind": ("steps", ["--seed", "1"], ["--seed: is not valid for steps", "--levels, --hold, --rates"]),
    "no cycles": ("sine", ["--cycles", "0"], ["--cycles 0", "whole number"]),
    "no levels": ("minor-loops", ["--levels", "0"], ["--levels 0", "whole number"]),
    "frequency absurd": ("sawtooth", ["--frequencies", "1e-320"], ["--frequencies 9.99", "1e-09 or more"]),
    "duration absurd": ("multisine", ["--duration", "5e-324"], ["--duration", "1e-09 or more"]),
    "no hold": ("steps", ["--hold", "0"], ["--hold 0", "positive number of s"]),
    "endless": ("steps", ["--hold", "1e9"], ["20,000,000 samples", "lower --sample-rate"]),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str, refused: Callable) -> None:
    kind, options, needles = REFUSED[name]
    message = refused("excite", kind, *options, "-o", refused.output)
    for needle in needles:
        assert needle in message


def test_usage_errors(rdpi: Callable, tmp_path: Path) -> None:
    for arguments in (["square"], ["sine", "--frequencies", "1,x"], ["sine", "--cycles", "1.5"],
                      ["multisine", "--seed", "-1"]):
        result = rdpi("excite", *arguments, "-o", tmp_path / "out.csv")
        assert result.exit_code == 2 and arguments[-1] in result.output and not (tmp_path / "out.csv").exists()


def test_rests_in_the_middle_by_default() -> None:
    """Where a sweep decays from both sides: every play then stands at the input, which is what memory: reset means."""
    columns, metadata = make_drive("sine", Limits(0, 10, sample_rate_hz=1000), frequencies_hz=(5,), cycles=1)
    swept = columns["command_V"][:round(float(metadata["sweep_s"]) * 1000) + 1]
    assert swept[0] == swept[-1] == 5
    for threshold in (0.5, 1.0, 2.0, 4.0):
        assert abs(play(swept, threshold, 5 + threshold)[-1] - 5) < 0.3
