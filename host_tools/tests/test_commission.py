"""`rdpi excite commission`: the parts of the drive are what the metadata say."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from rdpi.data import Limits, make_drive
from rdpi.errors import BadInput

RATE_HZ = 2000.0
LIMITS = Limits(0.0, 10.0, sample_rate_hz=RATE_HZ)


@lru_cache
def drawn(limits: Limits = LIMITS, duration_s: float = 60.0) -> tuple[dict, dict]:
    return make_drive("commission", limits, duration_s=duration_s)


def part(name: str, limits: Limits = LIMITS) -> slice:
    found = {one.split()[0]: one.split()[1].split("-") for one in drawn(limits)[1]["parts"].split(", ")}
    return slice(*(round(float(time) * limits.sample_rate_hz) for time in found[name]))


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


REFUSED = {
    "sweep alone": (["--duration", "1"], ["--duration 1", "decaying sweep takes 1.02 s", "--no-sweep"]),
    "too short for the triangles": (["--frequencies", "0.1,40"], ["too short for 2 triangles", "0.1 Hz", "at least"]),
    "too short for the multisine": (["--frequencies", "0.1"], ["too short for a multisine", "at least"]),
    "too slow": (["--slew", "2"], ["--duration 60", "decaying sweep takes", "at least"]),
    "too slow for the multisine": (["--slew", "6", "--no-sweep"], ["too short for a multisine", "faster rates"]),
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
