"""The promise of `rdpi gap` for tracking, against what the inverses of both models then make of the actuator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from injected import LATER, RATE_HZ, commissioned, drives, entry, plain_model, recorded
from plants import changed

from rdpi import BadInput
from rdpi.data import Recording
from rdpi.gap import diagnose, diagnosis, promise, thresholds
from rdpi.gap.augmented import AugmentedModel
from rdpi.gap.sections import TrackingPromise
from rdpi.identify import passport
from rdpi.model import Model
from rdpi.simulate import chain

LAG = entry("lag", time_constant_s=0.004)


def sines(*frequencies_hz: float) -> Recording:
    """A reference over half of the stroke, about its middle."""
    t = np.arange(3000) / RATE_HZ
    stroke_um, offset_um = commissioned().stroke_um, commissioned().offset_um
    wave = sum(np.sin(2 * np.pi * f * t) for f in frequencies_hz) / len(frequencies_hz)
    return Recording("reference.csv", {"sample_rate_hz": f"{RATE_HZ:g}"},
                     {"time_s": t, "reference_um": offset_um + stroke_um * (0.5 + 0.25 * wave)})


def tracking_um(model: Model, reference: Recording, *effects: dict) -> float:
    """rms error of the plain actuator with these effects behind the model's inverse, mean removed."""
    drive_V = chain.follow(model, reference)[0].drive_V.astype(float)
    driven = replace(reference, columns={**reference.columns, "command_V": drive_V}, metadata={
        **reference.metadata, "memory": "reset"})
    (shown,) = chain.simulate(replace(plain_model(), effects=list(effects)), [driven])
    return float(np.std(shown.predicted_um - reference.reference_um))


def test_the_promise_comes_true() -> None:
    """More is promised for a faster reference, and what comes is within the interval."""
    runs, promises = recorded(plain_model(), drives(LATER), LAG), []
    for reference in (sines(2.0), sines(5.0, 13.0)):
        found = diagnose(commissioned(), runs, references=[reference])
        promised = found.document.promised.tracking
        before, after = (tracking_um(model, reference, LAG) for model in (commissioned(), found.improved))
        assert promised.shrink == pytest.approx(1 - after / before, abs=0.25) and promised.ci90[1] <= 1
        promises.append(promised.shrink)
    assert promises[0] < promises[1]


def test_there_is_no_promise_without_reference_effect_or_interval() -> None:
    runs, reference = recorded(plain_model(), drives(LATER), LAG), [sines(5.0)]
    assert diagnose(commissioned(), runs).document.promised.tracking is None
    none = recorded(plain_model(), drives(LATER))
    assert diagnose(commissioned(), none, references=reference).document.promised.tracking is None
    assert diagnose(commissioned(), runs[2:3], references=reference).document.promised.tracking.ci90 is None
    promised = [diagnose(model, runs, references=reference).document.promised.tracking.shrink
                for model in (commissioned(), replace(commissioned(), passport=None))]
    assert promised[0] == pytest.approx(promised[1], abs=0.3)


def test_a_reference_may_have_gaps_but_must_be_one() -> None:
    runs, whole = recorded(plain_model(), drives(LATER), LAG), sines(5.0)
    holes = whole.reference_um.copy()
    holes[100:103] = np.nan
    broken = replace(whole, columns={**whole.columns, "reference_um": holes})
    promised = [diagnose(commissioned(), runs, references=[one]).document.promised.tracking.shrink
                for one in (whole, broken)]
    assert promised[0] == pytest.approx(promised[1], abs=0.05)
    with pytest.raises(BadInput, match="reference_um"):
        diagnose(commissioned(), runs, references=runs[:1])


def test_a_reference_out_of_reach_and_a_model_without_inverse_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    runs, reference = recorded(plain_model(), drives(LATER), LAG), sines(5.0)
    far = replace(reference, columns={**reference.columns, "reference_um": reference.reference_um + 5.0})
    notes = [diagnose(commissioned(), runs, references=[one]).document.notes for one in (reference, far)]
    assert not any("reference.csv" in note for note in notes[0])
    (told,) = (note for note in notes[1] if note.startswith("reference.csv: "))
    assert "% of the reference is beyond what the drive's range reaches" in told

    def refused(model: Model) -> None:
        raise BadInput("model.json: it cannot be inverted")

    monkeypatch.setattr(promise, "inverse_of", refused)
    found = diagnose(commissioned(), runs, references=[reference]).document
    assert found.promised.tracking is None and found.verdict == "effect"
    assert "no promise for tracking: model.json: it cannot be inverted" in found.notes


def test_what_would_track_worse_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = recorded(plain_model(), drives(LATER), LAG)
    worse = TrackingPromise(shrink=-0.5, ci90=None)
    real = promise.tracking
    monkeypatch.setattr(promise, "tracking", lambda selection, *others: real(selection, *others) and worse)
    assert diagnose(commissioned(), runs).improved.effects, "only asked for references"
    found = diagnose(commissioned(), runs, references=[sines(5.0)])
    assert found.document.verdict == "effect" and [one.name for one in found.document.effects] == ["lag"], "its name stays"
    assert found.improved.digest() == commissioned().digest() and found.document.promised.tracking is None
    assert any(note.startswith("the improved model is the given one: with lag, ") and "worse by 50 %" in note
               for note in found.document.notes)


@pytest.mark.parametrize("asked", [False, True], ids=["recordings alone", "references"])
def test_what_makes_up_for_what_the_model_missed_anyway_is_left_out(asked: bool) -> None:
    """The model is right now and was wrong before: what has changed since would take it away from the actuator."""
    before, after = (recorded(plain_model(), drives(LATER), *which, seed=k)
                     for k, which in enumerate(((entry("gain_change", factor=1.05),), ())))
    found = diagnose(commissioned(), after, earlier=before, references=[sines(5.0)] if asked else [])
    assert found.document.verdict == "effect" and [one.name for one in found.document.effects] == ["gain_change"]
    told = [note for note in found.document.notes if "would be predicted worse in movement or zero" in note]
    assert len(told) == asked and all(note.startswith("the improved model is the given one: with gain_") for note in told)
    if asked:
        assert any(run.path in told[0] for run in after) and found.document.offset_um.added == 0
        assert found.improved.digest() == commissioned().digest()


def test_the_zero_stays_where_no_effect_is_accepted() -> None:
    """Starts of the memory that an effect came to, which was left out then, move the zeros that are told alone."""
    given = AugmentedModel.given(commissioned(), recorded(plain_model(), drives((LATER[3],)), LAG), [])
    found = diagnosis.decide(given, passport.read(commissioned())).selection
    reached = found.reached.dataset
    left = replace(found.rejecting_all(), reached=replace(found.reached, dataset=reached.starting(
        [one.start_um - 0.1 * commissioned().stroke_um for one in reached.model_runs])))
    told = diagnosis._offset(left)
    assert found.reached.chosen and told.added == 0
    assert told.mean > thresholds.ZERO_SCATTER * commissioned().stroke_um


def test_a_zero_that_only_an_effect_moves_has_not_moved() -> None:
    """The actuator's gain turns about its middle, that of the model about an end of its range."""
    runs = recorded(plain_model(), drives(LATER))
    middle_um = [float(np.mean(run.displacement_um)) for run in runs]
    runs = [changed(run, displacement_um=at + 0.92 * (run.displacement_um - at)) for run, at in zip(runs, middle_um)]
    found = diagnose(commissioned(), runs)
    offset = found.document.offset_um
    assert [one.name for one in found.document.effects] == ["gain_change"] and not offset.moved
    assert min(abs(offset.low), abs(offset.high)) > 0.02 * commissioned().stroke_um
    assert offset.added == pytest.approx(offset.mean)
    assert not any("zero" in note for note in found.document.notes)


@pytest.mark.parametrize("undone", [True, False])
def test_what_an_effect_does_to_the_zero_is_undone(undone: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A curve that leaves the zero nearly where it was would lay all recordings .3 % of the stroke further off."""
    if not undone:
        monkeypatch.setattr(thresholds, "ZERO_UNDONE", thresholds.ZERO_SCATTER)
    runs = [changed(run, displacement_um=run.displacement_um - 0.005 * commissioned().stroke_um) for run in recorded(
        plain_model(), drives(LATER), entry("static_nonlinearity", linear=0.0, quadratic=0.02, cubic=0.0))]
    found = diagnose(commissioned(), runs)
    assert [one.name for one in found.document.effects] == ["static_nonlinearity"]
    before, after = (sum(float(np.mean(run.displacement_um - one.predicted_um)) ** 2
                         for run, one in zip(runs, chain.simulate(model, runs))) for model in (commissioned(), found.improved))
    assert (found.document.offset_um.added != 0) == (after < 1.2 * before) == undone


def test_what_hardly_shrinks_all_that_is_missed_is_left_out() -> None:
    """The change is explained as a whole, and is small beside what the model missed before."""
    curve, small = entry("static_nonlinearity", linear=0.0, quadratic=0.3, cubic=0.0), entry("delay", delay_s=0.0006)
    before, after = (recorded(plain_model(), drives(LATER), curve, *which, seed=k)
                     for k, which in enumerate(((), (small,))))
    alone, asked = (diagnose(commissioned(), after, earlier=before, references=references)
                    for references in ([], [sines(5.0)]))
    assert [one.name for one in alone.document.effects] == ["delay"] and alone.document.promised.shrink > 0.5
    assert asked.document.effects and asked.improved.digest() == commissioned().digest()
    assert any("all that the model misses would shrink by" in note for note in asked.document.notes)


def test_the_zero_stays_where_a_refitted_model_lies() -> None:
    """With earlier recordings, the improved model misses on average what was missed before the change."""
    before, after = (recorded(plain_model(), drives(LATER), *which, seed=k) for k, which in enumerate(((), (LAG,))))
    found = diagnose(commissioned(), after, earlier=before)
    then, now = ([np.mean(run.displacement_um - one.predicted_um) for run, one in zip(runs, chain.simulate(model, runs))]
                 for model, runs in ((commissioned(), before), (found.improved, after)))
    assert np.mean(now) == pytest.approx(np.mean(then), abs=0.005 * commissioned().stroke_um)
