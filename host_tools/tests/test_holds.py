"""Holds: creep is no larger than what moves on while the drive stands still."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from injected import Drives, drives, entry, plain_model, recorded
from plants import changed, recording

from rdpi.data import Recording, excite
from rdpi.identify import around, fit, holds
from rdpi.simulate.effects import CATALOGUE
from rdpi.simulate.effects.base import low_pass

HELD: Drives = (
    ("sawtooth", {"cycles": 1}, 1.0), ("multisine", {"duration_s": 4.0, "seed": 1}, 1.0),
    ("steps", {"levels": 4, "hold_s": 2.0}, 1.0))
NAME = "percent_per_decade"


@lru_cache(maxsize=None)
def creeping(percent: float) -> list[Recording]:
    return recorded(plain_model(), drives(HELD), *([entry("creep", **{NAME: percent})] if percent else []))


def most(runs: list[Recording]) -> float:
    return holds.most_shown(CATALOGUE["creep"](), NAME, runs, plain_model())


def forgetful(percent: float) -> Recording:
    """A Bouc-Wen actuator of another scale than plays, whose loops creep with its way; it starts after a sweep."""
    limits = excite.Limits(0.0, 100.0, sample_rate_hz=2000.0)
    command = excite.make_drive("commission", limits, duration_s=25.0)[0]["command_V"]
    z, left = 0.0, np.empty(len(command))
    for k, (v, move) in enumerate(zip(command, np.diff(command, prepend=command[0]))):
        z += move - 0.035 * abs(move) * z - 0.015 * move * abs(z)
        left[k] = 0.75 * (v - 0.35 * z)
    creep = sum(percent / 100 * low_pass(left, 1 / 2000, time_s) for time_s in (0.1, 1.0, 10.0, 100.0))
    noise = 0.008 * np.random.default_rng(3).standard_normal(len(left))
    return recording(command, left + creep + noise, 2000.0, memory="reset")


def test_the_holds_of_a_drive() -> None:
    steps = drives(HELD)[2]
    found = list(holds._holds(steps))
    lengths = np.array([part.stop - part.start for part in found])
    assert all(np.ptp(steps.command_V[part]) < 0.1 for part in found)
    assert np.count_nonzero(np.abs(lengths - 1800) <= 20) >= 4  # of 2 s, without what comes late
    assert len({round(float(steps.command_V[part][0])) for part in found}) >= 4


@pytest.mark.parametrize("percent", [0.0, 1.0, 4.0])
def test_holds_show_how_much_creep_there_is_at_most(percent: float) -> None:
    assert percent < most(creeping(percent)) < 1.1 * percent + 0.2


def test_drift_leaves_more_open() -> None:
    drifting = [changed(run, displacement_um=run.displacement_um + 0.01 * run.time_s) for run in creeping(1.0)]
    assert most(drifting) > 1.2 * most(creeping(1.0))


def test_without_holds_nothing_limits_creep() -> None:
    assert most([creeping(1.0)[1]]) == np.inf
    effect = CATALOGUE["delay"]()
    assert holds.limited(effect, creeping(1.0), plain_model()) is effect


def creep_found(percent: float) -> tuple[float, str]:
    """Its size, and what is told of it; 0 and nothing where none is found."""
    found = fit([forgetful(percent)])
    size = sum(one.acting.values[NAME] for one in found.choice.kept if one.acting.effect.name == "creep")
    return size, "".join(line for line in around.lines(found.choice, found.model) if "creep: " in line)


def test_what_the_operator_misses_is_not_told_as_creep(monkeypatch: pytest.MonkeyPatch) -> None:
    assert creep_found(0.0)[0] <= 0.1
    size, told = creep_found(1.2)
    assert size == pytest.approx(1.2, rel=0.2) and "the most that holds show" in told
    monkeypatch.setattr(around, "limited", lambda effect, runs, model: effect)
    size, told = creep_found(1.2)
    assert size > 2.0 and "holds" not in told
