"""The rounds of the selection: complete when they are returned, and the same whenever they are asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from injected import RATE_HZ, commissioned, drives, entry, plain_model, recorded
from plants import changed, recording

from rdpi.data import Recording
from rdpi.identify import localise, passport
from rdpi.gap import selection, thresholds
from rdpi.gap.augmented import AugmentedModel
from rdpi.gap.candidates import Candidate
from rdpi.gap.dataset import ModelRun
from rdpi.gap.diagnosis import Decision, decide
from rdpi.gap.selection import Baseline, Excess, Round, Score, Selection
from rdpi.model import Model
from rdpi.simulate.effects import CATALOGUE

FROZEN = AugmentedModel, Baseline, Candidate, Decision, Excess, ModelRun, Round, Score, Selection


@lru_cache(maxsize=None)
def given() -> AugmentedModel:
    """Two effects, of which none explains the other."""
    runs = recorded(plain_model(), drives(), entry("delay", "timing", delay_s=0.003),
                    entry("gain_change", "actuator", factor=1.04))
    return AugmentedModel.given(commissioned(), runs, [])


@lru_cache(maxsize=None)
def decided() -> Decision:
    return decide(given(), passport.read(commissioned()))


def coordinates() -> list[localise.Coordinates]:
    return [localise.coordinates(one.recording, one.predict([]), one.rate_um_per_s)
            for one in given().dataset.model_runs]


def numbers(value: Any) -> Iterator[np.ndarray]:
    """Every number within a result, in order."""
    if isinstance(value, (Score, Baseline, Candidate)):
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for part in value:
            yield from numbers(part)
    elif isinstance(value, (int, float, np.ndarray)):
        yield np.asarray(value)


def same(one: Round, other: Round) -> bool:
    pairs = [(getattr(one, field.name), getattr(other, field.name)) for field in dataclasses.fields(Round)]
    return all(len(a) == len(b) and all(map(np.array_equal, a, b))
               for a, b in ((list(numbers(x)), list(numbers(y))) for x, y in pairs))


@pytest.mark.parametrize("kind", FROZEN, ids=lambda kind: kind.__name__)
def test_results_do_not_change(kind: type) -> None:
    assert dataclasses.is_dataclass(kind) and kind.__dataclass_params__.frozen


def test_a_round_is_complete_and_nothing_is_added_later() -> None:
    found = decided().selection
    assert [done.best.name for done in found.rounds if done.best] == [one.effect.name for one in found.reached.chosen]
    assert {one.effect.name for one in found.reached.chosen} == {"delay", "gain_change"}
    for done in found.rounds:
        assert set(vars(done)) == {field.name for field in dataclasses.fields(Round)}
        assert len(done.scores) == len(done.rejected) == len(done.reproduced)
        assert done.best is None or done.why_rejected(done.best) is None and done.best not in done.rivals


def test_what_was_accepted_beside_an_effect_is_no_rival_of_it() -> None:
    found = decided().selection
    first, second = found.rounds[:2]
    beside = next(one for one in first.scores if one.name == second.best.name)
    other = next(one for one in first.scores if one.name not in (first.best.name, beside.name))
    first = dataclasses.replace(first, rivals=(beside, other))
    found = dataclasses.replace(found, rounds=(first, *found.rounds[1:]))
    assert found.rivals(first) == (other,) and found.rejecting_last().rivals(first) == (beside, other)


def test_the_same_round_asked_for_again_says_the_same() -> None:
    """Whatever was accepted since: the model that was given has not changed."""
    before = given().residual
    gap = selection.excess(given(), passport.read(commissioned()), coordinates())
    first = selection.select(given(), gap).rounds[0]
    again = selection.one_round(given(), gap)
    assert again is not first and same(first, again)
    assert given().residual is before and not given().chosen
    assert np.array_equal(before, AugmentedModel.given(commissioned(), given().recordings, []).residual)


def test_several_cores_find_what_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    gap = selection.excess(given(), passport.read(commissioned()), coordinates())
    alone = selection.one_round(given(), gap)
    monkeypatch.setattr(selection, "LONG", 0)
    monkeypatch.setattr(selection.os, "cpu_count", lambda: 4)
    assert same(alone, selection.one_round(given(), gap))


def test_at_a_single_rate_what_needs_several_is_not_tried() -> None:
    """Gain and phase at will would pass for anything; nor is what the model holds taken away from it."""
    sine = recording(50 - 45 * np.cos(4 * np.pi * np.arange(3000) / RATE_HZ), None, RATE_HZ)
    runs = recorded(plain_model(), [sine], entry("delay", "timing", delay_s=0.003))

    def tried(model: Model) -> dict[str, dict[str, float]]:
        state = AugmentedModel.given(model, runs, [])
        coords = [localise.coordinates(one.recording, one.predict([]), one.rate_um_per_s)
                  for one in state.dataset.model_runs]
        return {score.name: score.candidate.values for score in selection.one_round(
            state, selection.excess(state, passport.read(model), coords)).scores}

    held = dataclasses.replace(commissioned(), effects=[entry("relaxation", share=0.05, time_constant_s=0.01)])
    assert "relaxation" in {score.name for score in decided().selection.rounds[0].scores}
    found = tried(commissioned())
    assert "relaxation" not in found and "delay" in found and "relaxation" in tried(held)
    assert found.get("resonance", {"f0_hz": np.inf})["f0_hz"] > 20  # rings five times in a stroke of 0.25 s


def test_recordings_that_do_not_lie_where_creep_would_take_them() -> None:
    """Creep from the middle of the range shows in where recordings beside it lie; of the same motions elsewhere it is not
    the cause.
    """
    t = np.arange(8000) / RATE_HZ
    commands = [50 * share * (1 - np.cos(2 * np.pi * hertz * t)) * np.clip(t / 2, 0.2, 1)
                for share, hertz in ((0.7, 0.5), (0.6, 1.5), (0.6, 4.0))]
    silent = [recording(command, None, RATE_HZ, f"{k}.csv", "reset") for k, command in enumerate(commands)]
    crept = recorded(plain_model(), silent, entry("creep", percent_per_decade=3.0))
    as_before = [changed(run, displacement_um=run.displacement_um - np.mean(run.displacement_um) + np.mean(
        before.displacement_um)) for run, before in zip(crept, recorded(plain_model(), silent))]

    def first_round(runs: list[Recording]) -> Round:
        return decide(AugmentedModel.given(commissioned(), runs, []), passport.read(commissioned())).selection.rounds[0]

    assert first_round(crept).best.name == "creep"
    elsewhere = first_round(as_before)
    (creep,) = (score for score in elsewhere.scores if score.name == "creep")
    assert elsewhere.best is not creep and "do not lie" in elsewhere.why_rejected(creep)


def test_what_may_predict_recordings_that_were_left_out_worse_is_rejected() -> None:
    best = decided().selection.rounds[0].best
    assert selection._why_rejected(best, further=False, clear=True, born_in=0.25) is None
    doubtful = dataclasses.replace(best, lost=2 * thresholds.WORSE_LEFT_OUT)
    assert "worse" in selection._why_rejected(doubtful, further=False, clear=True, born_in=0.25)


def test_stick_slip_has_no_name() -> None:
    """The stage stands still until it is 0.5 um behind, then slips all the way; others explain three quarters of that."""
    def slipping(run: Recording) -> Recording:
        at, shown = run.displacement_um[0], np.empty(len(run))
        for k, z in enumerate(run.displacement_um):
            at = z if abs(z - at) > 0.5 else at
            shown[k] = at
        return changed(run, displacement_um=shown)

    runs = [slipping(run) for run in recorded(plain_model(), drives())]
    found = decide(AugmentedModel.given(commissioned(), runs, []), passport.read(commissioned()))
    assert found.verdict == "unknown" and not found.selection.accepted.chosen
    assert any("explains a part of the gap, but leaves too much" in note for note in found.notes)


def test_accepting_makes_another_model() -> None:
    best = decided().selection.rounds[0].best.candidate
    values, jacobian = dict(best.values), best.jacobian.copy()
    more = given().accept(best)
    assert more.chosen[0].effect is best.effect and not given().chosen
    assert np.sum(more.residual**2) < 0.5 * np.sum(given().residual**2)
    assert best.values == values and np.array_equal(best.jacobian, jacobian)


def test_all_that_act_are_fitted_together() -> None:
    """What the second round leaves is less than if the first effect had stayed where its own round put it."""
    found = decided().selection
    last = found.rounds[len(found.reached.chosen) - 1]
    first = found.rounds[0].best.candidate
    assert found.final(found.rounds[0]).values != first.values
    alone = given().dataset.measured - given().dataset.predict([first.acting, last.best.candidate.acting])
    assert np.sum(found.reached.residual**2) < np.sum(alone**2)


def test_rejecting_all_leaves_what_was_given() -> None:
    found = decided().selection
    none = found.rejecting_all()
    assert none.accepted is found.given and none.after_um is none.before_um and none.rounds is found.rounds
    assert found.accepted is found.reached


@pytest.mark.parametrize(("name", "little", "wanders", "told"), [
    ("creep", 0.1, 0.6, 0.4), ("creep", 0.7, 0.6, 0.3), ("thermal_drift", 0.0, 0.6, 0.4), ("lag", 0.1, 0.6, 0.9),
    ("resonance", 0.0, 0.6, 1.0), ("gain_change", 0.1, 0.6, 0.9), ("relaxation", 0.1, 0.6, 0.9)])
def test_loops_that_wander_hide_what_is_slow_only(name: str, little: float, wanders: float, told: float) -> None:
    gap = Excess(total=1.0, floor=0.5, ratio=1.4, spread=0.2, ratios=None, little=little, wanders=wanders)
    assert gap.told(CATALOGUE[name]()) == pytest.approx(told) and gap.untold == max(little, wanders)


def test_thresholds_are_read_when_they_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thresholds, "MOST_EFFECTS", 1)
    gap = selection.excess(given(), passport.read(commissioned()), coordinates())
    assert len(selection.select(given(), gap).rounds) == 1 < len(decided().selection.rounds)
