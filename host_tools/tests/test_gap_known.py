"""Effects that the model holds already: the diagnosis asks of each whether it has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from injected import (COMMISSIONING, FURTHER, LATER, NOISE_UM, commissioned, drives, entry, left_um, plain_model,
                      recorded, rms)
from plants import changed

from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.identify import localise, passport
from rdpi.gap import Diagnosis, candidates, diagnose, experiment, thresholds
from rdpi.gap.augmented import AugmentedModel
from rdpi.gap.candidates import Candidate, search
from rdpi.gap.dataset import Dataset
from rdpi.gap.report import page, words
from rdpi.model import Model, read_model, write_model
from rdpi.simulate import chain, effects
from rdpi.simulate.effects import CATALOGUE

# What the model holds; and what has become of it, the first parameter being the one to find.
HELD: dict[str, dict[str, float]] = {
    "delay": {"delay_s": 0.002}, "lag": {"time_constant_s": 0.003},
    "relaxation": {"share": 0.05, "time_constant_s": 0.02}, "creep": {"percent_per_decade": 2.0},
    "resonance": {"f0_hz": 60.0, "damping": 0.1}}
CHANGES: list[tuple[str, dict[str, float]]] = [
    ("delay", {"delay_s": 0.003}), ("delay", {"delay_s": 0.001}),
    ("lag", {"time_constant_s": 0.0045}), ("lag", {"time_constant_s": 0.0015}),
    ("relaxation", {"share": 0.08, "time_constant_s": 0.02}), ("relaxation", {"share": 0.02, "time_constant_s": 0.02}),
    ("creep", {"percent_per_decade": 4.0}), ("creep", {"percent_per_decade": 0.5}),
    ("resonance", {"f0_hz": 48.0, "damping": 0.1}), ("resonance", {"f0_hz": 75.0, "damping": 0.1}),
    ("resonance", {"f0_hz": 60.0, "damping": 0.3})]
TOGETHER = "delay", "lag", "relaxation"
GONE = {"delay_s": 0.0}


def held(*names: str, stage: str | None = None) -> list[dict]:
    return [{**entry(name, stage, **HELD[name]), "origin": "fit"} for name in names]


@lru_cache(maxsize=None)
def holding(*names: str, stage: str | None = None) -> Model:
    """The fitted operator with these effects as a fit writes them, and the passport of both together."""
    model = replace(commissioned(), effects=held(*names, stage=stage))
    runs = recorded(plain_model(), drives(COMMISSIONING), *model.effects)
    residuals = []
    for run, found in zip(runs, chain.simulate(model, runs)):
        coords = localise.coordinates(run, found.predicted_um, found.rate_um_per_s)
        residuals.append(passport.Residual(run, passport.OTHER_RUNS, run.displacement_um - found.predicted_um, None,
                                           coords, NOISE_UM))
    return replace(model, passport=passport.build(residuals).to_json())


def shown(names: Sequence[str], canned: tuple = LATER, seed: int = 1, stage: str | None = None,
          **now: dict[str, float]) -> list[Recording]:
    """Recordings of the actuator whose effects are those that the model holds, but for what they are `now`."""
    return recorded(plain_model(), drives(canned),
                    *(entry(name, stage, **now.get(name, HELD[name])) for name in names), seed=seed)


def monitored(runs: Sequence[Recording], *ahead: dict) -> list[Recording]:
    acting = effects.acting(replace(plain_model(), effects=list(ahead)))
    return [changed(run, monitor_V=effects.driven(acting, run.command_V, run, plain_model())) for run in runs]


def check_the_change(found: Diagnosis, model: Model, name: str, now: dict[str, float]) -> None:
    """Named first, as a change from what the model holds, its value right; the improved model holds it once."""
    document = found.document
    assert document.verdict in ("effect", "ambiguous")
    first = document.effects[0]
    assert first.name == name and first.was == HELD[name]
    for parameter, value in now.items():
        assert first.parameters[parameter].value == pytest.approx(value, rel=0.05, abs=0.05 * HELD[name][parameter])
    assert [one.name for one in document.effects] == [name]
    assert [one["name"] for one in found.improved.effects] == [one["name"] for one in model.effects]
    for before, after in zip(model.effects, found.improved.effects):
        if after["name"] != name:
            assert after == before
        else:
            assert after["origin"] == "gap" and after["was"] == HELD[name] and "new" not in after
            assert after["parameters"] == {key: one.to_json() for key, one in first.parameters.items()}


# --- grows, shrinks, stays -------------------------------------------------------------------------------------------

@pytest.mark.parametrize(("name", "now"), CHANGES)
def test_an_effect_that_has_changed(name: str, now: dict[str, float]) -> None:
    """And the improved model predicts other drives as well as the model did before the change."""
    model, runs = holding(name), shown([name], **{name: now})
    found = diagnose(model, runs)
    check_the_change(found, model, name, now)
    further = shown([name], FURTHER, **{name: now})
    assert left_um(model, further) > 1.8 * left_um(found.improved, further)
    assert left_um(found.improved, further) == pytest.approx(left_um(model, shown([name], FURTHER)), rel=0.1)
    promised = found.document.promised
    assert promised.shrink > 0.6 and promised.ci90[0] < promised.shrink < promised.ci90[1]


@pytest.mark.parametrize("names", [*((name,) for name in HELD), TOGETHER, tuple(HELD)], ids=" ".join)
def test_effects_that_stay(names: tuple[str, ...]) -> None:
    """Also in drives of other kinds, and the passport that was made with the effects holds."""
    for canned in (LATER, FURTHER):
        found = diagnose(holding(*names), shown(names, canned))
        assert found.document.verdict == "none" and found.improved.effects == holding(*names).effects
        assert 0.7 < found.document.passport.ratio < 1.5
        tried = {one.name: one for one in found.document.candidates}
        assert all(tried[name].was == HELD[name] for name in names)
        assert all(one.was is None for name, one in tried.items() if name not in names)


@pytest.mark.parametrize(("name", "now"), [change for change in CHANGES if change[0] in TOGETHER])
def test_one_of_several_has_changed(name: str, now: dict[str, float]) -> None:
    model = holding(*TOGETHER)
    check_the_change(diagnose(model, shown(TOGETHER, **{name: now})), model, name, now)


def test_an_effect_that_has_gone() -> None:
    found = diagnose(holding("delay"), shown(["delay"], delay=GONE))
    check_the_change(found, holding("delay"), "delay", GONE)
    assert diagnose(found.improved, shown(["delay"], delay=GONE, seed=3)).document.verdict == "none"


def test_a_new_effect_beside_one_that_is_held() -> None:
    runs = recorded(plain_model(), drives(LATER), *held("lag"), entry("gain_change", factor=1.04))
    found = diagnose(holding("lag"), runs)
    (one,) = found.document.effects
    assert one.name == "gain_change" and one.was is None
    assert one.parameters["factor"].value == pytest.approx(1.04, rel=0.001)
    assert [entry_["name"] for entry_ in found.improved.effects] == ["lag", "gain_change"]
    assert found.improved.effects[0] == holding("lag").effects[0] and "was" not in found.improved.effects[1]


def test_a_change_and_a_new_effect() -> None:
    runs = recorded(plain_model(), drives(LATER), entry("delay", delay_s=0.0035), entry("gain_change", factor=1.05))
    found = diagnose(holding("delay"), runs)
    sizes = {one.name: one for one in found.document.effects}
    assert set(sizes) == {"delay", "gain_change"}
    assert sizes["delay"].was == HELD["delay"] and sizes["gain_change"].was is None
    assert sizes["delay"].parameters["delay_s"].value == pytest.approx(0.0035, rel=0.05)
    assert sizes["gain_change"].parameters["factor"].value == pytest.approx(1.05, rel=0.005)
    assert [one["name"] for one in found.improved.effects] == ["delay", "gain_change"]
    assert left_um(found.improved, runs) < 0.2 * left_um(holding("delay"), runs)


def test_without_it_the_effect_stays_as_it_is() -> None:
    found = diagnose(holding("delay"), shown(["delay"], delay={"delay_s": 0.001}), without=["delay"])
    assert "delay" not in {one.name for one in found.document.effects}
    assert found.improved.effects[0] == holding("delay").effects[0]


# --- where it acts ---------------------------------------------------------------------------------------------------

def test_no_second_instance_that_recordings_cannot_tell_from_the_first() -> None:
    model = holding("delay", stage="sensor")
    found = diagnose(model, shown(["delay"], stage="sensor", delay={"delay_s": 0.003}))
    (one,) = found.document.effects
    assert (one.name, one.stage, one.was) == ("delay", "sensor", HELD["delay"])
    assert [entry_["stage"] for entry_ in found.improved.effects] == ["sensor"]


@pytest.mark.parametrize("delay_s", [0.003, 0.001])
def test_a_monitor_shows_the_change(delay_s: float) -> None:
    delay = entry("delay", delay_s=delay_s)
    found = diagnose(holding("delay"), monitored(shown(["delay"], delay={"delay_s": delay_s}), delay))
    check_the_change(found, holding("delay"), "delay", {"delay_s": delay_s})
    assert found.document.where.stage == "timing" and not any("monitor_V" in note for note in found.document.notes)


def test_a_monitor_shows_a_second_instance_behind_it() -> None:
    runs = recorded(plain_model(), drives(LATER), *held("delay"), entry("delay", "sensor", delay_s=0.001))
    found = diagnose(holding("delay"), monitored(runs, *held("delay")))
    (one,) = found.document.effects
    assert (one.name, one.stage, one.was) == ("delay", "sensor", None)
    assert one.parameters["delay_s"].value == pytest.approx(0.001, rel=0.02)
    assert [entry_["stage"] for entry_ in found.improved.effects] == ["timing", "sensor"]


@pytest.mark.parametrize(("delay_s", "verdict"), [(0.002, "none"), (0.003, "effect")])
def test_a_monitor_that_does_not_show_what_the_model_holds_ahead_of_it(delay_s: float, verdict: str) -> None:
    """The model took the sensor's delay for that of the timing. From the command it is right, and is asked from there."""
    runs = shown(["delay"], stage="sensor", delay={"delay_s": delay_s})
    document = diagnose(holding("delay"), monitored(runs)).document
    assert document.verdict == verdict
    assert [one.parameters["delay_s"].value for one in document.effects] == pytest.approx([0.003] * (delay_s > 0.002), 0.02)
    assert any("monitor_V is left out of all recordings" in note and "it does not show delay at stage timing (delay_s 0.002 s)" in note
               for note in document.notes)


# --- against earlier recordings --------------------------------------------------------------------------------------

@pytest.mark.parametrize("delay_s", [0.0019, 0.0015, 0.003])
def test_a_change_since_the_earlier_recordings(delay_s: float) -> None:
    before = shown(["delay"], seed=2)
    found = diagnose(holding("delay"), shown(["delay"], delay={"delay_s": delay_s}), earlier=before)
    one = found.document.effects[0]
    assert one.name == "delay" and one.was == HELD["delay"]
    assert one.parameters["delay_s"].value == pytest.approx(delay_s, rel=0.01)
    assert not any("also acted in the earlier" in note for note in found.document.notes)  # fit found it in them


def test_a_mended_model_knows_what_acted_in_the_earlier_recordings() -> None:
    """Twice: what the entry was before stays what it was when the earlier recordings were made."""
    before, model = shown(["delay"], seed=2), holding("delay")
    for delay_s in (0.0015, 0.003):
        now = shown(["delay"], delay={"delay_s": delay_s})
        found = diagnose(model, now, earlier=before)
        assert found.document.effects[0].was["delay_s"] == effects.acting(model)[0].values["delay_s"]
        model = found.improved
        (only,) = model.effects
        assert only["was"] == HELD["delay"] and only["new"] is True
        assert effects.acting(effects.then(model))[0].values == HELD["delay"]
        assert diagnose(model, now, earlier=before).document.verdict == "none"
    found = diagnose(model, shown(["delay"], delay={"delay_s": 0.004}))  # without the earlier recordings
    assert found.improved.effects[0]["was"] == HELD["delay"] and found.improved.effects[0]["new"] is True


def test_an_effect_that_came_and_then_changed_did_not_act_earlier() -> None:
    new = {**entry("delay", delay_s=0.002), "new": True}
    now = shown(["delay"], delay={"delay_s": 0.003})
    improved = diagnose(replace(commissioned(), effects=[new]), now, earlier=shown([], seed=2)).improved
    (only,) = improved.effects
    assert only["new"] is True and "was" not in only and effects.then(improved).effects == []


# --- the search ------------------------------------------------------------------------------------------------------

def searched(model: Model, runs: Sequence[Recording], name: str) -> tuple[Dataset, Candidate]:
    dataset, acting = Dataset(model, runs), effects.acting(model)
    one = search(dataset, CATALOGUE[name](), acting, dataset.predict(acting))
    assert one is not None
    return dataset, one


@pytest.mark.parametrize(("name", "now"), CHANGES)
def test_the_change_is_from_the_known_values_on(name: str, now: dict[str, float]) -> None:
    model = replace(plain_model(), effects=held(*TOGETHER, *({name} - set(TOGETHER))))
    names = [one["name"] for one in model.effects]
    dataset, one = searched(model, shown(names, **{name: now}), name)
    for parameter, value in now.items():
        assert one.values[parameter] == pytest.approx(value, rel=0.05)
    known = effects.acting(model)
    others = [other for other in known if other.effect.name != name]
    assert len(others) == len(known) - 1
    assert one.change == pytest.approx(dataset.predict(effects.beside(others, one.acting)) - dataset.predict(known),
                                       abs=1e-9)
    assert rms(dataset.measured - dataset.predict(known) - one.change) == pytest.approx(NOISE_UM, rel=0.1)
    own, least = candidates.jacobian(dataset, one, others), 1e-6 * np.max(np.abs(one.jacobian))
    assert one.jacobian == pytest.approx(own, abs=least)


@pytest.mark.parametrize("name", HELD)
def test_no_change_is_the_known_values(name: str) -> None:
    _, one = searched(replace(plain_model(), effects=held(name)), shown([name]), name)
    assert rms(one.change) < 0.3 * NOISE_UM
    assert one.values == {parameter: pytest.approx(value, rel=0.05) for parameter, value in HELD[name].items()}


def test_a_resonance_is_sought_far_from_where_it_was() -> None:
    """Gauss-Newton from the known values would not come there."""
    now = {"f0_hz": 200.0, "damping": 0.05}
    _, one = searched(replace(plain_model(), effects=held("resonance")), shown(["resonance"], resonance=now),
                      "resonance")
    assert one.values == {key: pytest.approx(value, rel=0.02) for key, value in now.items()}


def test_every_effect_can_be_asked_where_it_is_held() -> None:
    """Those of one stage too whose usual place is another."""
    model = replace(plain_model(), effects=[entry("gain_change", "sensor", factor=1.02), *held("delay")])
    runs = shown(["delay"])
    places = {name: AugmentedModel.given(model, runs, []).places(kind) for name, kind in CATALOGUE.items()}
    assert [str(one) for one in places["gain_change"]] == ["gain_change(sensor)"]
    assert [str(one) for one in places["delay"]] == ["delay(timing)"]
    assert [str(one) for one in places["lag"]] == ["lag(amplifier)", "lag(sensor)"]
    seen = AugmentedModel.given(model, monitored(runs, *held("delay")), []).places(CATALOGUE["delay"])
    assert [str(one) for one in seen] == ["delay(timing)", "delay(sensor)"]
    coarse = replace(plain_model(), effects=[entry("quantisation", "sensor", step=0.01)])
    assert len(AugmentedModel.given(coarse, runs, []).places(CATALOGUE["quantisation"])) == 2  # the values tell


def test_lines_of_several_frequencies_stand_beside_each_other() -> None:
    hum = entry("periodic_disturbance", frequency_hz=47.3, amplitude_um=0.05)
    model = replace(commissioned(), effects=[hum])
    runs = [changed(run, displacement_um=run.displacement_um + 0.05 * sum(
        np.sin(2 * np.pi * hertz * run.time_s + k) for hertz in (47.3, 81.0))) for k, run in enumerate(shown([]))]
    improved = diagnose(model, runs).improved
    assert [one["name"] for one in improved.effects] == 2 * ["periodic_disturbance"]
    assert improved.effects[1]["parameters"]["frequency_hz"]["value"] == pytest.approx(81.0, abs=0.05)
    assert len(effects.acting(improved)) == 2


def test_the_next_experiment_is_made_with_what_the_model_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drive that tells a longer delay from others: from the known delay on, not from none."""
    monkeypatch.setattr(thresholds, "RIVAL_MARGIN", 1e9)  # nothing is told apart
    document = diagnose(holding(*TOGETHER), shown(TOGETHER, delay={"delay_s": 0.003})).document
    assert document.verdict == "ambiguous" and document.next_experiment.command.startswith("rdpi excite ")
    state = AugmentedModel.given(holding(*TOGETHER), shown(TOGETHER), [])
    same = experiment._shown(state, Candidate(CATALOGUE["delay"](), HELD["delay"], (), np.zeros(0), np.zeros(0)),
                             state.recordings[0])
    held_um = state.dataset.model_runs[0].predict(state.known)
    assert same.displacement_um == pytest.approx(held_um, abs=1e-12)


# --- what is said ----------------------------------------------------------------------------------------------------

@lru_cache(maxsize=None)
def slower() -> Diagnosis:
    return diagnose(holding(*TOGETHER), shown(TOGETHER, delay={"delay_s": 0.003}))


def test_a_change_is_told_as_one() -> None:
    document = slower().document
    text = words.sentence(document)
    assert "a change of the signal delay from 2.0" in text.lower() and " ms to 3.0" in text
    assert "(95 % interval 3.0" in text
    assert "2.0" in page.tables(document) and "change of the signal delay" in page.tables(document).replace("\n", " ")


def test_the_interval_of_a_change_holds_what_the_model_does_not_know() -> None:
    """Half of the interval that the fit stated of what it held adds to that of the new value, as independent."""
    was = HELD["delay"]["delay_s"]
    sure, unsure = (diagnose(replace(holding("delay"), effects=[{**held("delay")[0], "parameters": {
        "delay_s": {"value": was, "ci95": [was - half, was + half], "unit": "s"}}}]),
        shown(("delay",), delay={"delay_s": 0.003})) for half in (0.0, 1e-4))
    (low, high), (lower, higher) = (one.document.effects[0].parameters["delay_s"].ci95 for one in (sure, unsure))
    assert (higher - lower) / 2 == pytest.approx(np.hypot((high - low) / 2, 1e-4), rel=1e-3)


@pytest.mark.parametrize(("name", "now", "text"), [
    ("creep", {"percent_per_decade": 4.0}, "a change of creep from 2.0"),
    ("resonance", {"f0_hz": 48.0, "damping": 0.1}, "a change of the mechanical resonance (f0 from 60.0"),
    ("relaxation", {"share": 0.02, "time_constant_s": 0.02}, "a change of relaxation (share from 0.05"),
    ("delay", GONE, "a change of the signal delay from 2.0")])
def test_changes_in_words(name: str, now: dict[str, float], text: str) -> None:
    document = diagnose(holding(name), shown([name], **{name: now})).document
    assert text in words.sentence(document).replace("A change", "a change")


def test_a_rival_that_is_held_is_a_change_too() -> None:
    document = slower().document
    effect = replace(document.effects[0], confusable_with=["lag", "resonance"])
    text = words.sentence(replace(document, effects=[effect], verdict="ambiguous"))
    assert "Either a change of the signal delay from" in text
    assert "a change of the first-order lag or a mechanical resonance explains it" in text


# --- the model file --------------------------------------------------------------------------------------------------

def test_a_changed_effect_goes_through_the_file(tmp_path: Path) -> None:
    improved = slower().improved
    write_model(tmp_path / "improved.json", improved)
    again = read_model(tmp_path / "improved.json")
    assert again.effects == improved.effects and effects.acting(again) is not None
    assert [str(one) for one in effects.acting(again)] == [str(one) for one in effects.acting(improved)]


@pytest.mark.parametrize(("bad", "message"), [
    ([*held("delay"), *held("lag"), entry("delay", delay_s=0.001)],
     r"model: effects\[2\] \(delay\) is at timing, as effects\[0\] is; a chain holds an effect once at a stage"),
    ([entry("lag", "sensor", time_constant_s=0.1), entry("lag", "sensor", time_constant_s=0.1)],
     r"effects\[1\] \(lag\) is at sensor, as effects\[0\] is"),
    ([{**entry("delay", delay_s=0.001), "was": {"delay_s": -1}}], r"effects\[0\]: was \(delay\): delay_s is -1"),
    ([{**entry("delay", delay_s=0.001), "was": 0.002}], r"effects\[0\]: was \(delay\): parameters must be an object"),
    ([entry("delay", delay_s={"value": 1, "unit": "ms"})], r"\(delay\): delay_s is in \"ms\"; give it in s"),
    ([{**entry("delay", delay_s=0.001), "new": [1]}], r"effects\[0\]: new: must be true or false"),
    ([{**entry("delay", delay_s=0.001), "was": {}}], r"effects\[0\]: was \(delay\): no delay_s"),
])
def test_effects_that_cannot_stand(bad: list[dict], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        effects.acting(replace(plain_model(), effects=bad))


def test_where_an_effect_comes_from_is_no_parameter_of_the_same_name() -> None:
    coarse = {**entry("quantisation", "DAC", step=0.8, origin=0.13), "origin": "gap"}
    assert effects.acting(replace(plain_model(), effects=[coarse]))[0].values["origin"] == 0.13


def test_effects_that_can_stand_together() -> None:
    both = [entry("delay", delay_s=0.001), entry("delay", "sensor", delay_s=0.001),
            {**entry("cross_coupling", um_per_V=0.1), "column": "x_V"}, entry("cross_coupling", um_per_V=0.1)]
    assert len(effects.acting(replace(plain_model(), effects=both))) == 4
