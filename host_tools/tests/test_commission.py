"""`rdpi excite commission`: the drive is what it says, and what it says of itself holds on another actuator.

The actuator here is a Bouc-Wen loop that shares nothing with rdpi. Each statement is checked on both sides: what is
said to show is found, to within what was said; what is absent is not found; and no statement is careful without need.
"""

from __future__ import annotations

import json
import re
import tracemalloc
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from rdpi.data import Limits, make_drive, read_recording
from rdpi.errors import BadInput
from rdpi.simulate import shown
from rdpi.simulate.effects import CATALOGUE
from rdpi.simulate.effects.planned import Shown, time_text
from rdpi.simulate.effects.relaxation import SLOWEST_S

RATE_HZ = 2000.0
LIMITS = Limits(0.0, 10.0, sample_rate_hz=RATE_HZ)
SHAPES = (0.5, 1.0, 0.0), (0.65, 1.2, 0.005)  # length, power, skew: plays miss 0.2 and 0.5 % of their strokes
Change = Callable[[np.ndarray], np.ndarray]


@lru_cache
def drawn(limits: Limits = LIMITS, duration_s: float = 60.0) -> tuple[dict, dict]:
    return make_drive("commission", limits, duration_s=duration_s)


@lru_cache
def said(limits: Limits = LIMITS, duration_s: float = 60.0) -> dict[str, Shown]:
    """By name where it is an effect, else by what it is."""
    names = {kind.title: name for name, kind in CATALOGUE.items()}
    return {names.get(what, what): one for what, one in shown(*drawn(limits, duration_s)).items()}


@lru_cache
def loop(shape: tuple[float, float, float], limits: Limits = LIMITS, bow: float = 0.0) -> np.ndarray:
    """Displacement, about 1 peak to peak, of a Bouc-Wen actuator; `bow` of the range bends its input."""
    length, power, skew = shape
    u = 2 * bent(limits, bow) - 1
    h, found = 0.0, []
    for du, at in zip(np.diff(u, prepend=u[0]).tolist(), u.tolist()):
        for _ in range(pieces := 1 + int(abs(du) / 0.05)):
            side = 0.8 if du * h > 0 else -0.8
            h += (du - (side * abs(du) + 0.2 * du) * abs(h) ** power + skew * 0.2 * at * abs(du)) / length / pieces
        found.append(h)
    z = u - 0.15 * np.array(found)
    return z / np.ptp(z)


def bent(limits: Limits, bow: float) -> np.ndarray:
    """The drive, 0 to 1, bent by `bow` of the range in the middle."""
    u = drawn(limits)[0]["command_V"] / 10
    return u + 4 * bow * u * (1 - u)


def play(u: np.ndarray, threshold: float) -> np.ndarray:
    state, found = u[0], []
    for value in u.tolist():
        state = max(value - threshold, min(value + threshold, state))
        found.append(state)
    return np.array(found)


@lru_cache
def operator(limits: Limits = LIMITS, bow: float = 0.0) -> np.ndarray:
    """What an operator can explain: plays, bends, rate law and drift; one offset before the steps and one per hold."""
    u = bent(limits, bow) - 0.5
    plays = [play(u, threshold) for threshold in np.arange(10) / 20]
    speed = np.abs(np.gradient(u))
    parts = [first for first in np.flatnonzero(np.diff(u) != 0) if first >= part("steps", limits).start]
    columns = [*plays, u**2, u**3, np.linspace(-1, 1, len(u)), *(speed * one for one in plays[::3])]
    starts = [0, part("steps", limits).start, *(one + 1 for one, past in zip(parts, [0, *parts]) if one - past > 1)]
    columns += [((np.arange(len(u)) >= first) & (np.arange(len(u)) < last)).astype(float)
                for first, last in zip(starts, [*starts[1:], len(u)])]
    return np.column_stack(columns)


def part(name: str, limits: Limits = LIMITS) -> slice:
    found = {one.split()[0]: one.split()[1].split("-") for one in drawn(limits)[1]["parts"].split(", ")}
    return slice(*(round(float(time) * limits.sample_rate_hz) for time in found[name]))


def low_pass(z: np.ndarray, time_s: float, rate_hz: float = RATE_HZ) -> np.ndarray:
    a = np.exp(-1 / (rate_hz * time_s))
    g = -np.expm1(-1 / (rate_hz * time_s)) * rate_hz * time_s
    return z[0] + lfilter([1 - g, g - a], [1, -a], z - z[0])


def delayed(z: np.ndarray) -> np.ndarray:
    return -np.diff(z, prepend=z[0]) * RATE_HZ


def lagging(time_s: float, rate_hz: float = RATE_HZ) -> Change:
    return lambda z: low_pass(z, time_s, rate_hz) - z


def creeping(z: np.ndarray) -> np.ndarray:
    """1 % per decade, two lags per decade."""
    return sum(low_pass(z, time_s) - z for time_s in 10.0 ** np.arange(-1, 3.1, 0.5)) / 200


def ringing(f0_hz: float, rate_hz: float = RATE_HZ, damping: float = 0.05) -> Change:
    w = 2 * np.pi * f0_hz / rate_hz
    b, a, _ = cont2discrete(([w * w], [1, 2 * damping * w, w * w]), 1.0, method="foh")
    return lambda z: lfilter(np.ravel(b), a, z - z[0]) - (z - z[0])


@lru_cache
def weight(limits: Limits = LIMITS) -> np.ndarray:
    """Octaves of a hold count alike; what moves counts little, because there the operator's misses are not white."""
    u = drawn(limits)[0]["command_V"]
    since = np.arange(len(u)) - np.maximum.accumulate(np.where(np.diff(u, prepend=-1) != 0, np.arange(len(u)), 0))
    held = np.arange(len(u)) >= part("steps", limits).start
    return np.where(held, np.sqrt(20 / np.maximum(since, 20)), 0.1)


def solve(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(columns, axis=0)
    gram = columns.T @ columns / np.outer(size, size)
    return np.linalg.lstsq(gram, columns.T @ target / size, rcond=1e-12)[0] / size


def found(truth: float, change: Change, rivals: tuple[Change, ...], shape: tuple, noise: float = 5e-4) -> float:
    """How much of an effect least squares finds in an actuator that has `truth` of it, beside what imitates it."""
    z = loop(shape)
    reading = z + truth * change(z) + noise * np.random.default_rng(1).standard_normal(len(z))
    known, w = operator(), weight()
    model = known @ solve(known * w[:, None], reading * w)
    for _ in range(2):  # the operator's own displacement, without what the effect adds
        columns = np.column_stack([known, *(one(model) for one in (*rivals, change))])
        values = solve(columns * w[:, None], reading * w)
        model = known @ values[:known.shape[1]]
    return float(values[-1])


def found_bow(truth: float, shape: tuple, noise: float = 5e-4) -> float:
    """How large an input curve least squares finds in an actuator whose input is bent by `truth` of the range.

    Nothing bends the displacement: that would look nearly alike.
    """
    z = loop(shape, bow=truth)
    reading = z + noise * np.random.default_rng(1).standard_normal(len(z))
    plays, others, small, w = operator()[:, :10], operator()[:, 12:], 0.01, weight()
    moved = operator(bow=small)[:, :10] - plays
    values = solve(np.column_stack([plays, others]) * w[:, None], reading * w)
    for _ in range(3):
        columns = np.column_stack([plays, others, moved @ values[:10] / small])
        values = solve(columns * w[:, None], reading * w)
    return float(values[-1])


CHECKS = {  # what is said: change per unit, rivals, limit in that unit
    "delay": lambda said: (delayed, (), said["delay"].low),
    "creep": lambda said: (creeping, (lagging(0.01),), said["creep"].low),
    "lag": lambda said: (lagging(said["lag"].low), (delayed,), 1.0),
    "relaxation": lambda said: (lagging(said["relaxation"].low), (delayed, lagging(1 / RATE_HZ), creeping), 0.02),
    "slow relaxation": lambda said: (lagging(said["relaxation"].high), (delayed, lagging(1 / RATE_HZ), creeping), 0.02),
    "resonance": lambda said: (ringing(said["resonance"].high), (delayed, lagging(2 / RATE_HZ)), 1.0),
}


@pytest.mark.parametrize("name", CHECKS)
def test_what_is_said_to_show_is_found(name: str) -> None:
    """Within the limit that was said: none where there is none, and as much as there is."""
    change, rivals, limit = CHECKS[name](said())
    for shape in SHAPES:
        none, some = (found(times * limit, change, rivals, shape) / limit for times in (0, 1))
        assert abs(none) < 1 and abs(some - 1) < 1 and some - none > 0.2


def test_an_input_curve_of_the_size_that_is_said_is_found() -> None:
    """The actuator has a bend of its own, which looks alike: what counts is by how much more is found."""
    limit = said()["input_curve"].low
    assert 0.0005 < limit < 0.005 and "looks nearly alike" in said()["input_curve"].text
    for shape in SHAPES:
        none, some = (found_bow(truth, shape) for truth in (0.0, limit))
        assert some - none == pytest.approx(limit, rel=0.2)


@pytest.mark.parametrize(("name", "times"), [("lag", 4), ("relaxation", 8)])
def test_what_is_too_fast_is_not_found(name: str, times: float) -> None:
    """Far under the shortest time constant that was said, an actuator without any seems to have more than the limit."""
    _, rivals, limit = CHECKS[name](said())
    change = lagging(said()[name].low / times)
    assert max(abs(found(0, change, rivals, shape)) for shape in SHAPES) > limit


@pytest.mark.parametrize("name", ["delay", "creep"])
def test_limits_are_not_careful_without_need(name: str) -> None:
    """The error is a fair part of the limit, which is three standard errors."""
    change, rivals, limit = CHECKS[name](said())
    assert max(abs(found(0, change, rivals, shape)) for shape in SHAPES) > limit / 20


def test_slow_edges_ring_less() -> None:
    """What the slew limit keeps from ringing stays under the noise and under what the operator misses of an edge."""
    slow = Limits(0.0, 10.0, sample_rate_hz=RATE_HZ, slew_V_per_s=20.0)
    one, free = said(slow)["resonance"], said()["resonance"]
    assert one.high < free.high == pytest.approx(RATE_HZ / 3) and "edges of" in one.text and "3 samples" in free.text
    u = drawn(slow)[0]["command_V"] / 10
    held = part("steps", slow)
    assert np.abs(ringing(1.5 * one.high, RATE_HZ)(u)[held]).max() < 3 * 0.005 * 0.25


def test_statements_follow_duration_and_slew() -> None:
    short, slow = said(LIMITS, 10.0), said(Limits(0.0, 10.0, sample_rate_hz=RATE_HZ, slew_V_per_s=20.0))
    for what in ("delay", "creep", "rate law"):
        assert short[what].low > said()[what].low, what
    assert slow["delay"].low > 10 * said()["delay"].low and slow["lag"].low > said()["lag"].low
    assert slow["rate law"].high == pytest.approx(20, rel=0.01)
    u = drawn()[0]["command_V"]
    hold_s = (len(u) - 2 - np.flatnonzero(np.diff(u))[-1]) / RATE_HZ
    assert f"the longest hold lasts {hold_s:.3g} s" in said()["creep"].text


def test_a_larger_relaxation_is_shown_over_more_time_constants() -> None:
    number = r"([\d.]+) (us|ms|s)"
    found = re.findall(rf"shares of (\d+) %: time constants from {number} to {number}", said()["relaxation"].text)
    (small, *few), (large, *many) = [(int(one[0]), *(float(one[k]) * {"us": 1e-6, "ms": 1e-3, "s": 1}[one[k + 1]]
                                                     for k in (1, 3))) for one in found]
    assert small < large and many[0] < few[0] < few[1] <= many[1] <= SLOWEST_S
    assert few == pytest.approx([said()["relaxation"].low, said()["relaxation"].high], rel=0.01)


def test_what_no_single_axis_of_a_minute_shows_is_said() -> None:
    for what, remedy in (("amplifier or sensor", "monitor_V"), ("thermal_drift", "temperature_degC"),
                         ("cross_coupling", "other_axis_V")):
        assert said()[what].low is None and remedy in said()[what].text


def test_one_rate_shows_no_rate_law() -> None:
    slow = shown(*make_drive("commission", Limits(0.0, 10.0, sample_rate_hz=RATE_HZ, slew_V_per_s=6.0), False))
    assert slow["rate law"].low is None and "about 6 V/s" in slow["rate law"].text
    assert said()["rate law"].high >= 2 * said()["rate law"].low


def test_the_beginning_shows_the_start_only_aside_of_the_middle() -> None:
    assert "inner loops" in said()["start"].text and "beginning" not in said()["start"].text
    aside = shown(*make_drive("commission", Limits(0.0, 10.0, 2.0, RATE_HZ)))["start"].text
    assert "inner loops" in aside and "beginning too, if a sweep ended at 2 V" in aside


@pytest.mark.parametrize("limits", [
    Limits(-1e-3, 1e-3, sample_rate_hz=300.0), Limits(0.0, 900.0, 900.0, 5000.0), Limits(0.0, 1.0, None, 50.0, 2.0)])
@pytest.mark.parametrize("duration_s", [25.0, 90.0])
@pytest.mark.parametrize("sweep", [True, False])
def test_statements_are_sound_on_any_drive(limits: Limits, duration_s: float, sweep: bool) -> None:
    for what, one in shown(*make_drive("commission", limits, sweep, duration_s=duration_s)).items():
        assert what and one.text and not one.text.endswith(".") and "nan" not in one.text and "inf" not in one.text
        assert one.low is None and one.high is None or 0 < one.low < np.inf
        assert one.high is None or one.low <= one.high < np.inf
        assert (one.low is None) == (not one.unit)


def test_loops_are_counted() -> None:
    """Branches from reversal to reversal: the triangles alone have two per period, over the whole range."""
    columns, _ = drawn()
    low, high = said()["operator"].low, said()["operator"].high
    assert high == pytest.approx(1.0) and 0.01 < low < 0.1
    count = int(said()["operator"].text.split()[0])
    u = columns["command_V"]
    reversals = np.count_nonzero(np.diff(np.sign(np.diff(u)[np.diff(u) != 0])))
    assert 0.8 * reversals < count <= reversals


def test_parts_are_what_they_say() -> None:
    u = drawn()[0]["command_V"] / 10
    steps = np.abs(np.diff(u))
    assert part("sweep").start == 0 and part("hold").stop == len(u) - 1
    assert np.all(u[part("hold")][3:] == 0.5) and np.ptp(u[part("hold")]) == 0.25
    values, counts = np.unique(u[part("steps")], return_counts=True)
    assert list(values[counts > 500]) == [0.0, 0.25, 0.5, 0.75, 1.0] and counts[counts <= 500].max() <= 2
    assert steps[part("steps")].max() * RATE_HZ <= 2.5 * 80 * (1 + 1e-9)
    wave = u[part("multisine")][50:-150] - 0.5  # without the moves
    assert np.abs(wave[:len(wave) // 30]).max() < 0.5 * 0.35
    assert np.abs(wave[len(wave) // 3:]).max() == pytest.approx(0.5)
    assert steps[part("multisine")].max() * RATE_HZ <= 80 * (1 + 1e-9)  # the fastest triangle's rate
    saw = u[part("sawtooth")]
    assert set(np.round(np.abs(np.diff(saw[200:])) * RATE_HZ)) == {2, 10, 20, 40, 80} and np.ptp(saw) == 1
    assert len(u) == 60 * RATE_HZ + 1


def test_rates_may_be_chosen() -> None:
    by_rate = make_drive("commission", LIMITS, rates_V_per_s=(400.0, 40.0))[0]["command_V"]
    np.testing.assert_array_equal(by_rate, make_drive("commission", LIMITS, frequencies_hz=(2.0, 20.0))[0]["command_V"])
    other = make_drive("commission", LIMITS, rates_V_per_s=(400.0, 40.0), seed=1)[0]["command_V"]
    assert not np.array_equal(by_rate, other)


def test_it_is_said_before_playing(rdpi: Callable, tmp_path: Path) -> None:
    result = rdpi("excite", "commission", "-o", tmp_path / "drive.csv", "--sample-rate", "500", "--duration", "20",
                  "--json", tmp_path / "result.json")
    assert result.exit_code == 0, result.output
    shows = {one["what"]: one for one in json.loads((tmp_path / "result.json").read_text())["shows"]}
    does, does_not = result.output.split("It does not show:")
    assert "noise is 0.05 % of the stroke" in does
    for what in ("operator", "rate law", "start", "signal delay", "first-order lag", "relaxation", "creep",
                 "mechanical resonance"):
        assert f"  {what}: {shows[what]['text']}" in does and shows[what]["low"] > 0 and shows[what]["unit"]
    for what in ("thermal drift", "cross coupling from another axis", "amplifier or sensor"):
        assert f"  {what}: {shows[what]['text']}" in does_not and shows[what]["low"] is None
    assert read_recording(tmp_path / "drive.csv", required=("command_V",)).metadata["parts"].startswith("sweep 0-")


def test_other_drives_promise_nothing(rdpi: Callable, tmp_path: Path) -> None:
    result = rdpi("excite", "steps", "-o", tmp_path / "drive.csv", "--sample-rate", "500",
                  "--json", tmp_path / "result.json")
    assert json.loads((tmp_path / "result.json").read_text())["shows"] == []
    assert result.exit_code == 0 and "It shows" not in result.output and "It does not show" not in result.output


REFUSED = {
    "sweep alone": (["--duration", "1"], ["--duration 1", "decaying sweep takes 1.02 s", "--no-sweep"]),
    "too short for the triangles": (["--frequencies", "0.1,40"], ["too short for 2 triangles", "0.1 Hz", "at least"]),
    "too short for the multisine": (["--frequencies", "0.1"], ["too short for a multisine", "at least"]),
    "too slow": (["--slew", "2"], ["--duration 60", "decaying sweep takes", "at least"]),
    "too slow for the multisine": (["--slew", "3", "--no-sweep"], ["too short for a multisine", "faster rates"]),
    "faster than slew": (["--slew", "100", "--rates", "200"], ["--slew 100", "200 V/s"]),
    "faster than samples": (["--frequencies", "2000"], ["--frequencies 2000", "at most"]),
    "both": (["--frequencies", "5", "--rates", "50"], ["--frequencies and --rates", "one of them"]),
    "duration": (["--duration", "nan"], ["--duration nan", "positive number of s"]),
    "endless": (["--duration", "1e6"], ["20,000,000 samples"]),
    "another kind's option": (["--levels", "3"], ["--levels: is not valid for commission"]),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str, refused: Callable) -> None:
    options, needles = REFUSED[name]
    message = refused("excite", "commission", *options, "-o", refused.output)
    for needle in needles:
        assert needle in message


def test_advice_helps() -> None:
    """The duration that a refusal names is enough."""
    with pytest.raises(BadInput, match="use at least") as refusal:
        make_drive("commission", LIMITS, frequencies_hz=(0.1, 40.0))
    make_drive("commission", LIMITS, frequencies_hz=(0.1, 40.0),
               duration_s=float(str(refusal.value).split("use at least ")[1].split(" s")[0]))


@pytest.mark.parametrize("seconds, text", [(1000.0, "1000 s"), (12345.0, "12300 s"), (0.9996, "1000 ms"), (54.321, "54.3 s"),
                                           (0.0002968, "297 us")])
def test_times_are_written_without_exponents(seconds: float, text: str) -> None:
    assert time_text(seconds) == text


def test_a_long_drive_is_looked_at_in_little_memory():
    """It is compared with some hundred signals as long as itself: ten minutes at 10 kHz took 4 GB with all at once."""
    columns, metadata = drawn()
    shown(columns, metadata)  # what is imported on the way does not count
    tracemalloc.start()
    shown(columns, metadata)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 600 * len(columns["command_V"])
