"""Simulation and compensation along the chain, on recordings made by the model itself so that the truth is known."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from models import SAMPLE_TIME_S, SEEDS, random_model, steps_of

from rdpi import firmware
from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.model import Drive, Memory, Model, Rate, operators
from rdpi.simulate import chain, effects, scoring
from rdpi.simulate.memory import states_after, warm_up
from rdpi.simulate.plant import Plant
from rdpi.simulate.start import estimated

TIME_S = np.arange(3000) * SAMPLE_TIME_S


def paper_model(source: str = "displacement", window_s: float = 0.015, strength: float = 1.0, offset_um: float = 0.7
                ) -> Model:
    """Ten plays over 12.5 um; at strength 1 the slope W_0 reaches zero at 1450 um/s as in the paper."""
    i = np.arange(10)
    model = Model(
        gain_um_per_V=0.125, offset_V=50.0, offset_um=offset_um, stroke_um=12.5, thresholds_um=6.25 * i / 9,
        slopes=0.6 + 0.06 * i, slope_rate_s_per_um=-strength * 0.6 * (1 - i / 18) / 1450,
        deadzones_um=np.array([0.0, 2.0]), deadzone_weights=np.array([1.0, -0.1]),
        rate=Rate(source, window_s, 0.0, 1160.0), drive=Drive(-100.0, 200.0), memory=Memory())
    model.validate()
    return model


def recording(command_V: np.ndarray, displacement_um: np.ndarray | None = None, memory: str = "unknown") -> Recording:
    columns = {"time_s": np.arange(len(command_V)) * SAMPLE_TIME_S, "command_V": command_V}
    if displacement_um is not None:
        columns["displacement_um"] = displacement_um
    return Recording("run.csv", {"sample_rate_hz": "10000", "memory": memory}, columns)


def made_run(model: Model, states_um: np.ndarray, memory: str = "unknown", samples: int = len(TIME_S)) -> Recording:
    """A run of the plant that is the model: it starts at rest with these states and follows three sines exactly."""
    start_V = states_um[:1] / model.gain_um_per_V + model.offset_V
    start_um = operators.forward(model, start_V, np.zeros(1), states_um)[0]
    z = start_um + sum(a * (np.cos(2 * np.pi * f * TIME_S[:samples]) - 1) for a, f in ((2.6, 5), (2.0, 20), (1.4, 35)))
    free = replace(model, drive=Drive(-1e4, 1e4))
    return recording(steps_of(free, z, SAMPLE_TIME_S, states_um)[0].drive_V, z, memory)


@lru_cache(maxsize=None)
def run_after(share: float) -> tuple[np.ndarray, Recording]:
    """States that the paper's model has at x = 3 um, coming straight from `share` of the last threshold beyond, and a
    run of it from there."""
    model = paper_model()
    states = states_after(3.0 + share * model.thresholds_um[-1], 3.0, model.thresholds_um)
    return states, made_run(model, states)


def share_of_stroke(model: Model, error_um: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error_um**2))) / model.stroke_um


# ---- score ----

def test_score() -> None:
    score = chain.score(np.array([0.0, 1.0, 2.0, 3.0]), np.array([1.0, 1.0, 2.0, 5.0]))
    assert score.rms_um == pytest.approx(np.sqrt(5 / 4)) and score.max_um == 2 and score.offset_um == 0.75
    assert score.rms_percent == pytest.approx(100 * np.sqrt(5 / 4) / 4) and score.max_percent == 50


def test_score_without_offset() -> None:
    score = chain.score(np.array([0.0, 1.0, 2.0, 3.0]), np.array([1.0, 1.0, 2.0, 5.0]), remove_offset=True)
    assert score.offset_um == 0.75 and score.max_um == 1.25
    assert score.rms_um == pytest.approx(np.sqrt((0.25**2 + 0.75**2 + 0.75**2 + 1.25**2) / 4))


def test_score_of_a_displacement_that_stands_still() -> None:
    with pytest.raises(BadInput, match="^dead.csv: the measured range is 0"):
        chain.score(np.zeros(3), np.full(3, 2.0), where="dead.csv")
    with pytest.raises(BadInput, match="the rms error nan"):
        chain.score(np.full(3, np.nan), np.arange(3.0))


# ---- memory at the start ----

def test_states_after() -> None:
    r = np.array([0.0, 1.0, 3.0])
    assert states_after(0.0, 2.0, r).tolist() == [2, 1, 0]
    assert states_after(5.0, 2.0, r).tolist() == [2, 3, 5]
    np.testing.assert_array_equal(states_after(-0.5, 2.0, r),
                                  operators.plays(np.linspace(-0.5, 2.0, 9), r, np.full(3, -0.5))[1])


@settings(max_examples=200)
@given(SEEDS, st.integers(1, 9))
def test_warm_up(seed: int, plays: int) -> None:
    """From there on a different memory adds nothing but constants, and not yet a sample earlier."""
    random = np.random.default_rng(seed)
    x = np.cumsum(random.normal(size=200))
    r = np.linspace(0, random.uniform(0.1, 1.5) * np.ptp(x) / 2, plays + 1)
    first = warm_up(x, r[-1])
    low, high = (firmware.plays(x, r, states_after(position, x[0], r))[0] for position in (x[0] - 99, x[0] + 99))
    left = high - low
    assert np.all(np.ptp(left[first:], axis=0) <= 0.002 * np.ptp(x))
    if 2 * r[-1] < 0.999 * np.ptp(x):
        assert np.all(np.abs(left[first:]) < 1e-9) and np.any(left[first - 1] > 1e-9)


def test_reset_puts_every_play_at_the_first_input() -> None:
    model = paper_model()
    x0 = -3.0
    run = made_run(model, np.full(10, x0), "reset")
    found = chain.simulate(model, [run])[0]
    assert found.memory == "reset"
    assert share_of_stroke(model, found.predicted_um - run.displacement_um) < 1e-4


def test_carried_goes_on_where_the_run_before_ended() -> None:
    model = paper_model()
    whole = made_run(model, np.full(10, 1.0), "reset")
    parts = [recording(whole.command_V[part], whole.displacement_um[part], memory)
             for part, memory in ((slice(0, 2000), "reset"), (slice(2000, None), "carried"))]
    first, second = chain.simulate(model, parts)
    assert (first.memory, second.memory) == ("reset", "carried")
    end = firmware.plays(model.x_of(parts[0].command_V), model.thresholds_um, np.full(10, 1.0))[1]
    np.testing.assert_allclose(first.end.plays_um, end, atol=1e-9)
    assert share_of_stroke(model, second.predicted_um - parts[1].displacement_um) < 1e-4
    forgotten = chain.simulate(model, parts[1:], memory="reset")[0]
    assert share_of_stroke(model, (forgotten.predicted_um - parts[1].displacement_um)[:200]) > 0.01


def test_carried_without_a_run_before_is_estimated_or_refused() -> None:
    model = paper_model()
    run = made_run(model, np.full(10, 1.0), "carried")
    found = chain.simulate(model, [run])[0]
    assert found.memory == "estimated"
    assert any("no recording comes before it" in note for note in scoring.notes(model, run, found))
    with pytest.raises(BadInput, match="^run.csv: memory is carried, but no recording comes before it"):
        chain.simulate(model, [recording(run.command_V, None, "carried")])


def test_carried_at_another_sample_time_is_refused() -> None:
    model = paper_model()
    run = made_run(model, np.full(10, 1.0), "reset")
    slower = replace(run, metadata={"sample_rate_hz": "5000", "memory": "carried"},
                     columns={**run.columns, "time_s": 2 * run.time_s})
    with pytest.raises(BadInput, match="^run.csv: the state is one of another sample time: 0.0001 s, this one is 0.0002"):
        chain.simulate(model, [run, slower])


def test_unknown_memory_is_the_models_without_displacement() -> None:
    states = states_after(-4.0, 2.0, paper_model().thresholds_um)
    model = replace(paper_model(), memory=Memory(2.0, states))
    run = made_run(model, states)
    found = chain.simulate(model, [recording(run.command_V)])[0]
    assert found.memory == "model"
    assert share_of_stroke(model, found.predicted_um - run.displacement_um) < 1e-4
    assert chain.simulate(model, [run], memory="model")[0].predicted_um.tolist() == found.predicted_um.tolist()


def test_memory_imposed_on_every_run() -> None:
    model = paper_model()
    run = made_run(model, np.full(10, 2.0), "carried")
    assert [found.memory for found in chain.simulate(model, [run, run], memory="reset")] == ["reset", "reset"]
    assert [found.memory for found in chain.simulate(model, [run, run], memory="model")] == ["model", "model"]
    assert [found.memory for found in chain.simulate(model, [run, run], memory="estimate")] == ["estimated"] * 2
    assert chain.simulate(model, [recording(run.command_V)], memory="estimate")[0].memory == "model"


def estimated_plays(model: Model, run: Recording) -> np.ndarray:
    return estimated(Plant(model, SAMPLE_TIME_S), run).plays_um


@pytest.mark.parametrize("source", ["control", "displacement"])
@pytest.mark.parametrize("share", [-0.9, -0.4, 0.0, 0.35, 0.8])
@pytest.mark.parametrize("drift_um", [0.0, 0.3])
def test_estimated_states_are_the_known_ones(share: float, source: str, drift_um: float) -> None:
    """A previous position is found to the grid's step or two, even when the whole displacement has drifted."""
    model = paper_model(source)
    r = model.thresholds_um
    states, run = run_after(share)
    displacement_um = run.displacement_um
    if source == "control":
        rate = operators.rate(model.x_of(run.command_V), SAMPLE_TIME_S, model.rate.window_s, 0.0)
        displacement_um = operators.forward(model, run.command_V, rate, states)[0]
    run = recording(run.command_V, displacement_um + drift_um)
    np.testing.assert_allclose(estimated_plays(model, run), states, atol=2 * (2 * r[-1] / 40) + 1e-9)
    found = chain.simulate(model, [run])[0]
    assert found.memory == "estimated"
    assert share_of_stroke(model, found.predicted_um + drift_um - run.displacement_um) < 0.005


def test_estimate_of_a_run_that_never_moves() -> None:
    model = paper_model()
    run = recording(np.full(50, 66.0), np.full(50, 1.0))
    assert estimated_plays(model, run).tolist() == [2.0] * 10


def test_estimate_without_plays() -> None:
    model = random_model(1, plays=0)
    command = np.linspace(model.drive.min_V, model.drive.max_V, 50)
    assert estimated_plays(model, recording(command, model.x_of(command))).tolist() == [model.x_of(command[0])]


# ---- the rate of the prediction itself ----

def test_rate_of_the_control() -> None:
    model = paper_model("control", window_s=0.0)
    command = 50 + 50 * np.sin(2 * np.pi * 20 * TIME_S)
    found = chain.simulate(model, [recording(command, None, "reset")])[0]
    rate = operators.rate(model.x_of(command), SAMPLE_TIME_S, 0.0, 0.0)
    expected, states = operators.forward(model, command, rate, np.zeros(10))
    np.testing.assert_allclose(found.rate_um_per_s, rate, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.predicted_um, expected, atol=1e-9)
    np.testing.assert_allclose(found.end.plays_um, states, atol=1e-9)


def test_without_a_rate_law() -> None:
    model = paper_model(strength=0.0)
    run = made_run(model, np.zeros(10), "reset")
    np.testing.assert_allclose(chain.simulate(model, [run])[0].predicted_um, run.displacement_um, atol=1e-9)


def assert_rate_is_its_own(model: Model, run: Recording, found: chain.Prediction, states_um: np.ndarray) -> None:
    """The rate is that of the prediction, and the prediction what that rate makes."""
    own_rate = operators.rate(found.predicted_um, SAMPLE_TIME_S, model.rate.window_s, model.rate.filter_s)
    np.testing.assert_allclose(found.rate_um_per_s, own_rate, rtol=1e-6, atol=1e-6 * own_rate.max())
    again = operators.forward(model, run.command_V, own_rate, states_um)[0]
    np.testing.assert_allclose(found.predicted_um, again, atol=1e-8 * model.stroke_um)


@pytest.mark.parametrize(("strength", "window_s"), [(0.2, 0.002), (0.2, 0.004), (1.0, 0.012), (1.0, 0.018)])
def test_the_rate_is_that_of_the_prediction(strength: float, window_s: float) -> None:
    """... and the displacement is that of the plant."""
    model = paper_model(window_s=window_s, strength=strength)
    run = made_run(model, np.full(10, 1.0), "reset")
    found = chain.simulate(model, [run])[0]
    assert_rate_is_its_own(model, run, found, np.full(10, 1.0))
    assert share_of_stroke(model, found.predicted_um - run.displacement_um) < 1e-4


@pytest.mark.parametrize("strength", [1.0, 0.3, -0.3])
@pytest.mark.parametrize("rate_hz", [2e3, 1e4, 5e4])
def test_a_strong_law_and_a_short_window_have_a_smooth_prediction_too(strength: float, rate_hz: float) -> None:
    """With a difference over one sample no displacement satisfies the law after a turn. Whatever the sample time, the
    prediction does not tremble, moves about as fast as without the law, and is the same.
    """
    model = paper_model(window_s=0.0, strength=strength)

    def predicted(hz: float, law: Model = model) -> np.ndarray:
        time_s = np.arange(round(0.4 * hz)) / hz
        run = Recording("run.csv", {"sample_rate_hz": repr(hz), "memory": "reset"},
                        {"time_s": time_s, "command_V": 50 + 45 * np.sin(2 * np.pi * 10 * time_s)})
        return chain.simulate(law, [run])[0].predicted_um

    found = predicted(rate_hz)
    moves = np.diff(found)
    assert np.sum(np.abs(moves)) < 8.2 * np.ptp(found)  # of eight strokes, the first and the last of which are halves
    assert np.max(np.abs(moves)) < 1.5 * np.max(np.abs(np.diff(predicted(rate_hz, replace(
        model, slope_rate_s_per_um=np.zeros(10))))))
    assert share_of_stroke(model, found - predicted(5 * rate_hz)[::5]) < 0.01


@settings(max_examples=40)
@example(seed=1, window=1, filter_s=0.0)
@given(SEEDS, st.sampled_from([1, 3, 10, 30, 100]), st.sampled_from([0.0, 0.002]))
def test_every_prediction_is_what_its_rate_makes(seed: int, window: int, filter_s: float) -> None:
    model = random_model(seed, window=window, filter_s=filter_s)
    model = replace(model, drive=Drive(-1e5, 1e5), memory=Memory(0.0, np.zeros(10)))
    run = made_run(model, np.zeros(10), samples=400)
    found = chain.simulate(model, [run], memory="model")[0]
    again = operators.forward(model, run.command_V, found.rate_um_per_s, np.zeros(10))[0]
    np.testing.assert_allclose(found.predicted_um, again, atol=1e-8 * model.stroke_um)


# ---- what cannot be simulated ----

def test_unknown_effects_are_refused() -> None:
    model = replace(paper_model(), effects=[{"name": "delay", "parameters": {"delay_s": 0.0}}, {"name": "poltergeist"}])
    with pytest.raises(BadInput, match=r'effects\[1\] is "poltergeist", which this version cannot simulate; it knows'):
        chain.simulate(model, [recording(np.zeros(20))])


@pytest.mark.parametrize("x0", [-1.0, 1.0])
def test_a_run_may_use_more_of_the_drive_than_the_model_allows(x0: float) -> None:
    wide = paper_model()
    narrow = replace(wide, drive=Drive(45.0, 55.0, 10.0, 8))
    run = made_run(wide, np.full(10, x0), "reset")
    expected = chain.simulate(wide, [run])[0].predicted_um
    np.testing.assert_array_equal(chain.simulate(narrow, [run])[0].predicted_um, expected)


# ---- the drive's range ----

def test_within_drive() -> None:
    """From x = 8, 114 V, down to the 60 V that may be output: the plays follow."""
    states = states_after(10.0, 8.0, paper_model().thresholds_um)
    model = replace(paper_model(), drive=Drive(-50.0, 60.0), memory=Memory(8.0, states))
    memory = chain.within_drive(model)
    np.testing.assert_array_equal(memory.plays_um, operators.play(1.25, model.thresholds_um, states))
    assert memory.x_um == 1.25
    replace(model, memory=memory).validate()
    inside = replace(model, drive=Drive(-50.0, 120.0))
    np.testing.assert_array_equal(chain.within_drive(inside).plays_um, states)


@pytest.mark.parametrize("gain", [0.125, -0.125])
def test_reachable(gain: float) -> None:
    """Both ends, each approached from the other one, whatever the memory."""
    model = replace(paper_model(), gain_um_per_V=gain, drive=Drive(-10.0, 90.0), memory=Memory(1.0, np.full(10, 1.0)))
    ends = operators.forward(model, np.array([-10.0, 90.0, -10.0, 90.0]), np.zeros(4), np.zeros(10))[0]
    np.testing.assert_allclose(chain.reachable_um(model), sorted(ends[2:]))


# ---- following a reference ----

def reference_run(reference_um: np.ndarray, memory: str = "unknown") -> Recording:
    columns = {"time_s": np.arange(len(reference_um)) * SAMPLE_TIME_S, "reference_um": reference_um}
    return Recording("profile.csv", {"sample_rate_hz": "10000", "memory": memory}, columns)


@pytest.mark.parametrize("engine", ["f32", "q31", "f64", "numpy"])
def test_follow(engine: str) -> None:
    """The engines are one and the same chain; each drive brings the reference back."""
    model = paper_model(window_s=0.001)
    z = 0.7 + 5 * np.sin(2 * np.pi * 10 * TIME_S)
    steps, offset = chain.follow(model, reference_run(z), engine=engine)
    assert offset == 0 and steps._fields == firmware.Steps._fields and not steps.flags.any()
    back = operators.forward(model, steps.drive_V.astype(float), steps.rate_um_per_s.astype(float), np.zeros(10))[0]
    np.testing.assert_allclose(back, z, atol={"f32": 1e-5, "q31": 1e-7}.get(engine, 1e-11) * model.stroke_um)


@pytest.mark.parametrize("displacement_um", [-4.0, 0.7, 6.0])
def test_rest_at_holds_the_displacement(displacement_um: float) -> None:
    """A decaying sweep left every play at x, and there the model gives this displacement."""
    model = paper_model()
    memory = chain.rest_at(model, displacement_um)
    assert set(memory.plays_um) == {memory.x_um}
    start_V = memory.x_um / model.gain_um_per_V + model.offset_V
    z = operators.forward(model, np.array([start_V]), np.zeros(1), memory.plays_um)[0]
    np.testing.assert_allclose(z, displacement_um)
    replace(model, memory=memory).validate()


def test_rest_stays_inside_the_drive() -> None:
    model = paper_model()
    memory = chain.rest_at(model, 1e3)
    assert memory.x_um / model.gain_um_per_V + model.offset_V == pytest.approx(model.drive.max_V)
    replace(model, memory=memory).validate()


def test_follow_from_a_reset() -> None:
    model = paper_model(window_s=0.001)
    z = 4 + np.sin(2 * np.pi * 10 * TIME_S[:300])
    steps, _ = chain.follow(model, reference_run(z, "reset"), engine="f64")
    memory = chain.rest_at(model, z[0])
    assert steps.drive_V[0] == pytest.approx(memory.x_um / model.gain_um_per_V + model.offset_V)
    np.testing.assert_allclose(operators.forward(model, steps.drive_V, steps.rate_um_per_s, memory.plays_um)[0], z)


@pytest.mark.parametrize("drift_um", [0.0, 0.4])
def test_follow_what_was_measured_gives_the_recorded_command(drift_um: float) -> None:
    """Once the estimated memory is forgotten; `remove_offset` takes a drift out."""
    model = paper_model()
    run = made_run(model, states_after(-1.0, 2.0, model.thresholds_um))
    run.columns["displacement_um"] = run.displacement_um + drift_um
    steps, offset = chain.follow(model, run, "displacement_um", "f64", remove_offset=True)
    assert offset == pytest.approx(drift_um, abs=0.002 * model.stroke_um)
    late = warm_up(model.x_of(run.command_V), model.thresholds_um[-1])
    assert 0 < late < 2500
    assert np.sqrt(np.mean((steps.drive_V - run.command_V)[late:] ** 2)) < 0.003 * np.ptp(run.command_V)


@pytest.mark.parametrize("end", ["low", "high"])
def test_follow_starts_from_a_rest_at_an_end(end: str) -> None:
    model = paper_model()
    sign = 1.0 if end == "low" else -1.0
    command = 50 - sign * 40 * np.cos(2 * np.pi * 5 * TIME_S)
    run = recording(command, chain.simulate(model, [recording(command)], end)[0].predicted_um, end)
    started = []

    def engine(model: Model, reference_um: np.ndarray) -> firmware.Steps:
        started.append(model.memory.plays_um)
        return firmware.engine(model, SAMPLE_TIME_S, "f64").step(reference_um)

    chain.follow(model, run, "displacement_um", engine)
    np.testing.assert_allclose(started[0], model.x_of(command[0]) + sign * model.thresholds_um, atol=1e-9)


def test_follow_estimates_the_start_beside_the_effects() -> None:
    """A sensor's delay is no memory."""
    states, run = run_after(0.35)
    late = replace(paper_model(), effects=[{"name": "delay", "stage": "sensor", "parameters": {"delay_s": 0.004}}])
    (one,) = effects.acting(late)
    run = recording(run.command_V, one.effect.displacement(run.displacement_um, run, one.values, late))
    started = []

    def engine(model: Model, reference_um: np.ndarray) -> firmware.Steps:
        started.append(model.memory.plays_um)
        return firmware.engine(model, SAMPLE_TIME_S, "f64").step(reference_um)

    for model in (late, paper_model()):
        chain.follow(model, run, "displacement_um", engine)
    step = 2 * late.thresholds_um[-1] / 40
    assert np.max(np.abs(started[0] - states)) < 2 * step + 1e-9
    assert np.max(np.abs(started[1] - states)) > np.max(np.abs(started[0] - states))


def test_offset_of_a_reference_alone_cannot_be_removed() -> None:
    with pytest.raises(BadInput, match="profile.csv: an offset can only be removed from a recording"):
        chain.follow(paper_model(), reference_run(np.zeros(20)), remove_offset=True)


def test_a_recording_at_rest_whose_offset_cannot_be_removed_is_named() -> None:
    at_rest = recording(np.full(20, 50.0), np.full(20, 5.0))
    with pytest.raises(BadInput, match=f"{at_rest.path}: the measured range is 0"):
        chain.follow(paper_model(), at_rest, "displacement_um", remove_offset=True)


def test_follow_keeps_the_estimated_start_inside_the_drive() -> None:
    """The recording began outside what the model may output: the firmware starts at the limit."""
    wide = paper_model()
    run = made_run(wide, np.full(10, 2.0))
    narrow = replace(wide, drive=Drive(-50.0, 60.0), memory=Memory())
    assert run.command_V[0] == pytest.approx(66)
    steps, _ = chain.follow(narrow, run, "displacement_um", "f64")
    assert steps.drive_V.max() <= 60 and steps.drive_V[0] == pytest.approx(60)


@pytest.mark.parametrize("gain_um_per_V", [1e-3, 4.0, -4e3])
def test_any_gain_is_simulated(gain_um_per_V: float) -> None:
    """The control input is bounded too, not the drive alone."""
    model = paper_model()
    scale = model.gain_um_per_V / gain_um_per_V
    drive = Drive(*sorted(scale * np.array([model.drive.min_V, model.drive.max_V])))
    other = replace(model, gain_um_per_V=gain_um_per_V, offset_V=scale * model.offset_V, drive=drive)
    _, run = run_after(0.5)
    scaled = replace(run, columns={**run.columns, "command_V": scale * run.command_V})
    (found,), (expected,) = chain.simulate(other, [scaled], "model"), chain.simulate(model, [run], "model")
    assert found.predicted_um == pytest.approx(expected.predicted_um, abs=1e-6)
