"""Effects asked again beside the others: pairs that hide each other, mixtures, and what only made up for another."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import pytest
from injected import commissioned, drives, entry, plain_model, recorded
from plants import changed

from rdpi.gap import beside, candidates, thresholds
from rdpi.gap.augmented import AugmentedModel
from rdpi.gap.diagnosis import decide
from rdpi.gap.selection import Excess, Selection, excess, select
from rdpi.identify import localise, passport
from rdpi.simulate.effects import CATALOGUE

DELAY, GAIN = entry("delay", "timing", delay_s=0.003), entry("gain_change", "actuator", factor=1.04)


@lru_cache(maxsize=None)
def selected() -> tuple[Selection, Excess]:
    """What the forward selection finds of a delay and a gain."""
    given = AugmentedModel.given(commissioned(), recorded(plain_model(), drives(), DELAY, GAIN), [])
    coords = [localise.coordinates(one.recording, one.predict([]), one.rate_um_per_s)
              for one in given.dataset.model_runs]
    gap = excess(given, passport.read(commissioned()), coords)
    return select(given, gap), gap


def reached(*names: str) -> Selection:
    """The selection as if it had come to these."""
    found, _ = selected()
    states = [found.given]
    for name in names:
        state = states[-1]
        one = candidates.search(state.dataset, CATALOGUE[name](), state.acting(),
                                state.dataset.measured - state.residual)
        states.append(state.accept(one))
    rounds = (*found.rounds, found.rounds[-1])[:len(names)]
    return replace(found, reached=states[-1], accepted=states[-1], states=tuple(states), rounds=rounds)


def names(selection: Selection) -> list[str]:
    return [one.effect.name for one in selection.reached.chosen]


def test_no_start_lies_beyond_what_gap_looks_for() -> None:
    """What comes early is no relaxation."""
    runs = recorded(plain_model(), drives(), entry("relaxation", share=-0.05, time_constant_s=0.01))
    state = AugmentedModel.given(commissioned(), runs, [])
    relaxation = CATALOGUE["relaxation"]()
    found = candidates.search(state.dataset, relaxation, [], state.dataset.measured - state.residual)
    for name, (low, high) in relaxation.in_gap.items():
        assert low <= found.values[name] <= high


@pytest.mark.parametrize("name", ["delay", "gain_change", "lag"])
def test_a_guess_leads_where_starts_of_its_own_do(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    state = selected()[0].given
    effect, left = CATALOGUE[name](), state.residual
    own = candidates.search(state.dataset, effect, [], state.dataset.measured - left)
    monkeypatch.setattr(type(effect), "starts", lambda *_: pytest.fail("it has a guess"))
    guess = {parameter: 0.8 * value for parameter, value in own.values.items()}
    found = candidates.search(state.dataset, effect, [], state.dataset.measured - left, guess=guess)
    rest, least = (sum((left - one.change) ** 2) for one in (found, own))
    assert rest == pytest.approx(least, rel=0.01)


def test_two_effects_of_which_each_hides_the_other_are_found_together() -> None:
    """A delay widens the loops that have become narrower."""
    runs = recorded(plain_model(), drives(), entry("hysteresis_change", scale=-0.35), DELAY)
    found = decide(AugmentedModel.given(commissioned(), runs, []), passport.read(commissioned()))
    by_name = {one.effect.name: one.values for one in found.selection.accepted.chosen}
    assert found.verdict in ("effect", "ambiguous")
    assert by_name["delay"]["delay_s"] == pytest.approx(0.003, rel=0.1)
    assert by_name["hysteresis_change"]["scale"] == pytest.approx(-0.35, rel=0.15)


def test_what_stays_is_as_the_rounds_found_it() -> None:
    found, gap = selected()
    again = beside.settled(found, gap)
    assert names(again) == names(found) and again.detection == found.detection
    for before, after in zip(found.reached.chosen, again.reached.chosen):
        assert after.values == pytest.approx(before.values, rel=1e-3)


def test_another_effect_takes_the_place_of_one_that_leaves_more() -> None:
    _, gap = selected()
    assert sorted(names(beside.settled(reached("lag", "gain_change"), gap))) == ["delay", "gain_change"]


def test_an_effect_that_brings_nothing_beside_the_others_is_dropped() -> None:
    _, gap = selected()
    found = beside.settled(reached("hysteresis_change", "delay", "gain_change"), gap)
    assert sorted(names(found)) == ["delay", "gain_change"]
    assert len(found.states) == 3 and found.states[-1] is found.reached
    assert [done.best.name for done in found.rounds[:2]] == names(found)


def test_a_disturbance_that_was_found_first_stays() -> None:
    """The first round does not tell what is left beside it."""
    runs = [changed(run, displacement_um=run.displacement_um + 0.4 * run.time_s)
            for run in recorded(plain_model(), drives(), DELAY)]
    found = decide(AugmentedModel.given(commissioned(), runs, []), passport.read(commissioned())).selection
    assert names(found)[:2] == ["thermal_drift", "delay"]


def test_two_that_cancel_are_no_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each larger than the gap: what they leave together says nothing."""
    found, gap = selected()
    first = replace(found, reached=found.states[1], accepted=found.states[1], states=found.states[:2],
                    rounds=found.rounds[:1])
    assert len(names(beside.settled(first, gap))) == 2
    monkeypatch.setattr(thresholds, "CANCELS", 0.0)
    assert len(names(beside.settled(first, gap))) == 1
