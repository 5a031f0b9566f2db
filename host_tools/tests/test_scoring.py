"""What is said of predictions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plants import marked
from test_chain import paper_model, recording

from rdpi import board
from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.simulate import Prediction, chain, inverse_of, scoring


def case(command_V: np.ndarray, rate_um_per_s: float = 1.0) -> tuple[Recording, Prediction]:
    run, rate = recording(command_V), np.full(len(command_V), rate_um_per_s)
    return run, replace(chain.simulate(paper_model(), [run])[0], rate_um_per_s=rate)


def test_the_error_over_all_runs_is_that_of_all_samples() -> None:
    random = np.random.default_rng(1)
    measured = [random.normal(size=count) for count in (100, 700)]
    measured = [10 * values / np.ptp(values) for values in measured]
    predicted = [values + random.normal(0, sd, len(values)) for values, sd in zip(measured, (1, 3))]
    scores = [chain.score(*pair) for pair in zip(predicted, measured)]
    error = np.concatenate(measured) - np.concatenate(predicted)
    expected = 100 * np.sqrt(np.mean(error**2)) / 10
    assert scoring.overall_rms_percent(scores, [100, 700]) == pytest.approx(expected)
    assert scoring.overall_rms_percent(scores[:1], [100]) == pytest.approx(scores[0].rms_percent)


def test_the_table() -> None:
    score = chain.Score(1.0, 2.0, 3.0, 4.0, 0.0)
    head, first, second = scoring.table([("a.csv", score, "fitted"), ("longer.csv", score, "held out")])
    assert head.index("rms um") == first.index("        1") + 3 and first.endswith("fitted")
    assert len({line.index("3.000") for line in (first, second)}) == 1 and second.split()[0] == "longer.csv"


def test_nothing_to_note() -> None:
    model = paper_model()
    assert scoring.notes(model, *case(np.linspace(-100, 200, 50))) == []
    assert scoring.notes(model, *case(np.linspace(-100, 202.9, 50))) == []


def test_a_drive_beyond_the_range() -> None:
    for command_V, beyond in ((np.linspace(0, 203.1, 50), "3.1 V"), (np.linspace(-110, 200, 50), "10 V")):
        (note,) = scoring.notes(paper_model(), *case(command_V))
        assert note.startswith("run.csv: ") and beyond in note and "-100 to 200 V" in note


def test_a_rate_beyond_the_guard() -> None:
    command_V = np.zeros(1000)
    run, prediction = case(command_V)
    prediction.rate_um_per_s[:10] = 1161
    assert scoring.notes(paper_model(), run, prediction) == []  # a hundredth of the samples
    prediction.rate_um_per_s[:12] = 1161
    (note,) = scoring.notes(paper_model(), run, prediction)
    assert "1.2 %" in note and "1160 um/s" in note


def test_a_models_own_name() -> None:
    """Errors about a model say which, without being told."""
    model = replace(paper_model(), where="m.json", effects=["no effect"])
    with pytest.raises(BadInput, match=r"^m\.json: effects\[0\]"):
        chain.simulate(model, [recording(np.zeros(50))])


def referred(samples: int) -> Recording:
    run = recording(np.linspace(0, 100, samples))
    run.columns["reference_um"] = np.linspace(0, 10, samples)
    return run


def test_rounding_that_the_chain_differentiates_is_noted() -> None:
    """A resonance and a lag at ten thousand samples per second: as much noise as single precision makes of it."""
    model = replace(paper_model(), effects=[{"name": "resonance", "parameters": {"f0_hz": 30.0, "damping": 0.05}},
                                            {"name": "lag", "parameters": {"time_constant_s": 0.002}}])
    inverse, run = inverse_of(model), referred(10_000)
    run.columns["reference_um"] = 5 + np.sin(2 * np.pi * 5 * run.time_s)
    (note,) = scoring.doubts(model, inverse, run, "reference_um", True, True)
    assert "single precision" in note and scoring.doubts(model, inverse, run, "reference_um", True, False) == []
    single, double = (board.compensate(model, run, engine=engine, by=inverse).steps.drive_V for engine in ("f32", "f64"))
    told_V = inverse.chain.rounding_um(run.sample_time_s, 6.0) / abs(model.gain_um_per_V)
    assert 0.3 < np.std((single - double)[100:-100]) / told_V < 3


@pytest.mark.parametrize(("measured", "words"), [
    (lambda z: z, None), (lambda z: -z, "moves opposite"), (lambda z: 1000 * z, "moves 1e+03 times as far"),
    (lambda z: 0 * z, None)])
def test_a_run_of_another_sign_or_in_other_units(measured: Callable, words: str | None) -> None:
    run, prediction = case(np.linspace(0, 100, 50))
    prediction = replace(prediction, predicted_um=np.linspace(0, 10, 50))
    run.columns["displacement_um"] = measured(prediction.predicted_um)
    notes = scoring.notes(paper_model(), run, prediction)
    assert [words in note for note in notes] == [True] if words else notes == []


def test_what_makes_a_drive_doubtful() -> None:
    model = replace(paper_model(), effects=[{"name": "cross_coupling", "parameters": {"um_per_V": 1.0}},
                                            {"name": "delay", "parameters": {"delay_s": 0.2}}],
                    fit={"runs": [{"file": "first.csv", "memory": "estimated"}]})
    inverse, run = inverse_of(model), referred(50)
    coupled, estimated, short = scoring.doubts(model, inverse, run, "reference_um", False, True)
    assert "no column other_axis_V" in coupled and "first.csv" in estimated and "--sweep" in estimated
    assert "50 samples" in short and "ahead" in short
    assert len(scoring.doubts(model, inverse, run, "reference_um", True, True)) == 2
    assert "cross_coupling is left out" in scoring.notes(model, *case(np.zeros(50)))[0]
    whole = referred(10_000)
    whole.columns["other_axis_V"] = np.zeros(10_000)
    assert scoring.doubts(replace(model, fit={}), inverse, whole, "reference_um", False, True) == []
    assert scoring.lacking(model, whole) == []


def test_a_resonance_that_the_samples_cannot_show_is_said_to_be_left_out() -> None:
    for f0_hz, told in ((40.0, []), (60.0, ["run.csv: has 100 samples per second, too few for 60 Hz, so resonance is left out"]),
                        (1e7, [])):
        model = replace(paper_model(), effects=[{"name": "resonance", "stage": "mechanics",
                                                 "parameters": {"f0_hz": f0_hz, "damping": 0.5}}])
        run, prediction = case(np.linspace(-100, 200, 50))
        assert scoring.notes(model, marked(run, sample_rate_hz="100"), prediction) == told
