"""The chain as one thing that runs from a state to a state: nothing is forgotten where a drive is cut."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from models import SEEDS
from test_chain import paper_model, recording
from test_effects import SIZES, entry

import rdpi
from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.model import Model
from rdpi.simulate import Plant, Simulator, chain
from rdpi.simulate.effects import CATALOGUE

STEP_S = 1e-3
DRIVE_V = np.r_[np.full(30, 20.0), 50 + 40 * np.sin(np.arange(300) / 9) * np.linspace(0, 1, 300), np.full(40, 75.0),
                np.linspace(75, -5, 60)]
OTHER_V = 3 * np.cos(np.arange(len(DRIVE_V)) / 20)
NAMES = sorted(name for name in SIZES if not CATALOGUE[name].disturbance)
PAIRS = [*((name,) for name in NAMES), *itertools.combinations(NAMES, 2)]


def with_effects(*names: str, source: str = "displacement") -> Model:
    return replace(paper_model(source), effects=[entry(name, **SIZES[name]) for name in names])


def cut_up(plant: Plant, cuts: list[int]) -> np.ndarray:
    """The displacement where the drive is cut at these samples, each part from the state of the one before."""
    state, found = plant.swept(float(DRIVE_V[0])), []
    for part in np.split(np.arange(len(DRIVE_V)), cuts):
        ran = plant.run(DRIVE_V[part], state, {"other_axis_V": OTHER_V[part]})
        found.append(ran.displacement_um)
        state = ran.state
    return np.concatenate(found)


@pytest.mark.parametrize("names", PAIRS, ids="+".join)
def test_parts_are_the_whole(names: tuple[str, ...]) -> None:
    plant = Plant(with_effects(*names), STEP_S)
    whole = cut_up(plant, [])
    assert np.max(np.abs(cut_up(plant, [7, 8, 150, 151, 333]) - whole)) < 1e-9 * np.ptp(whole)


@settings(max_examples=20)
@given(SEEDS, st.sampled_from(["control", "displacement"]))
def test_parts_are_the_whole_with_everything(seed: int, source: str) -> None:
    random = np.random.default_rng(seed)
    plant = Plant(with_effects(*NAMES, source=source), STEP_S)
    cuts = sorted(random.choice(np.arange(1, len(DRIVE_V)), 5, replace=False).tolist())
    whole = cut_up(plant, [])
    assert np.max(np.abs(cut_up(plant, cuts) - whole)) < 1e-9 * np.ptp(whole)


def test_each_effect_acts_in_it() -> None:
    """A property of effects that do nothing would hold for nothing."""
    plain = cut_up(Plant(with_effects(), STEP_S), [])
    for name in NAMES:
        assert np.max(np.abs(cut_up(Plant(with_effects(name), STEP_S), []) - plain)) > 1e-4 * np.ptp(plain), name


@pytest.mark.parametrize("names", [(), ("delay", "lag", "creep", "relaxation", "resonance")], ids=["operator", "chain"])
def test_step_is_run(names: tuple[str, ...]) -> None:
    model = with_effects(*names)
    one = rdpi.Model(model).simulator(STEP_S, start_V=float(DRIVE_V[0]))
    before = one.state
    steps = np.array([one.step(drive_V) for drive_V in DRIVE_V])
    one.state = before
    assert np.array_equal(one.run(DRIVE_V), steps)
    predicted = rdpi.Model(model).predict(DRIVE_V, STEP_S, start="reset")
    assert np.array_equal(predicted, steps)
    assert np.array_equal(rdpi.Model(model).predict(DRIVE_V, STEP_S, start=before), steps)


def test_a_simulator_begins_amid_the_range_or_from_a_state() -> None:
    model = with_effects("creep")
    middle = Simulator(model, STEP_S)
    assert middle.step(50.0) == Simulator(model, STEP_S, start_V=50.0).step(50.0)
    assert Simulator(model, STEP_S, state=middle.state).step(20.0) == middle.step(20.0)


@pytest.mark.parametrize("gain", [1, -1])
@pytest.mark.parametrize("end", ["low", "high"])
def test_an_end_is_where_a_drive_over_the_range_leaves_the_plays(end: str, gain: int) -> None:
    model = paper_model()
    model = replace(model, gain_um_per_V=gain * model.gain_um_per_V)
    ends_V = (model.drive.min_V, model.drive.max_V)[::1 if end == "high" else -1]
    plant = Plant(model, STEP_S)
    arrived = plant.run(np.linspace(*ends_V, 50), plant.settled(ends_V[0])).state
    np.testing.assert_allclose(plant.held(ends_V[1], end).plays_um, arrived.plays_um, atol=1e-9)


def test_creep_goes_on_after_a_rest_as_if_it_had_been_played() -> None:
    """... from the middle of the range, where it had settled, to the end."""
    model = with_effects("creep")
    plant = Plant(model, STEP_S)
    played = plant.run(np.zeros(3000), plant.after(0.0, plant.held(0.0, "low").plays_um))
    rested = [plant.run(np.zeros(2000), plant.held(0.0, "low", rested_s)).displacement_um for rested_s in (0.5, 5.0, None)]
    assert np.ptp(played.displacement_um) < 1e-9  # settled
    moves = [float(np.ptp(one)) for one in rested]
    assert moves[0] > 2 * moves[1] > 0 and moves[2] < 1e-9
    later = plant.run(np.zeros(4500), plant.held(0.0, "low", 0.5)).displacement_um[4500 - 1]
    assert later == pytest.approx(plant.run(np.zeros(1), plant.held(0.0, "low", 4.999)).displacement_um[0], rel=1e-9)


def lasting(memory: str, **metadata: str) -> Recording:
    run = recording(50 - 50 * np.cos(np.arange(500) / 40), None, memory)
    return replace(run, metadata={**run.metadata, **metadata})


def test_a_recording_that_rested_is_predicted_from_there() -> None:
    model = with_effects("creep")
    found = {rest: chain.simulate(model, [lasting("low", **rest_of(rest))])[0] for rest in (None, 0.2)}
    plant = Plant(model, 1e-4)
    for rest, prediction in found.items():
        assert prediction.memory == "low"
        expected = plant.run(lasting("low").command_V, plant.held(0.0, "low", rest)).displacement_um
        assert np.array_equal(prediction.predicted_um, expected)


def rest_of(rest_s: float | None) -> dict[str, str]:
    return {} if rest_s is None else {"rested_s": str(rest_s)}


def test_what_is_carried_is_everything() -> None:
    model = with_effects("creep", "relaxation", "lag", "delay")
    whole = recording(DRIVE_V, None, "reset")
    parts = [recording(DRIVE_V[part], None, memory) for part, memory in ((slice(200), "reset"), (slice(200, None), "carried"))]
    expected = chain.simulate(model, [whole])[0].predicted_um
    found = np.concatenate([one.predicted_um for one in chain.simulate(model, parts)])
    assert np.max(np.abs(found - expected)) < 1e-9 * np.ptp(expected)


REFUSED = {
    "a state of another model": ("another model", lambda: Plant(with_effects("lag"), STEP_S).run(
        DRIVE_V, Plant(with_effects("creep"), STEP_S).settled(0.0))),
    "a state of another sample time": ("another sample time: 0.001 s, this one is 0.002 s", lambda: Simulator(
        with_effects("lag"), 2e-3, state=Plant(with_effects("lag"), STEP_S).settled(0.0))),
    "low, but begins elsewhere": (
        "^arrays: memory is low, but the drive begins at 45 V and goes on to 0 V", lambda: chain.simulate(
            with_effects(), [replace(lasting("low"), path="arrays", columns={
                **lasting("low").columns, "command_V": np.linspace(45.0, 0.0, 500)})])),
    "a rest below 0": ("rested_s is '-1'; give the time in s", lambda: chain.simulate(
        with_effects(), [lasting("low", rested_s="-1")])),
    "a rest without end": ("rested_s is '1e10'; give the time in s", lambda: chain.simulate(
        with_effects(), [lasting("high", rested_s="1e10")])),
    "a rest after a sweep": ("it goes with memory low or high, not with 'reset'", lambda: chain.simulate(
        with_effects(), [lasting("reset", rested_s="2")])),
    "a drive in no volts": ("the drive reaches 1e\\+09 V", lambda: Plant(with_effects(), STEP_S).run(
        np.array([1e9]), Plant(with_effects(), STEP_S).settled(0.0))),
    "a drive without a sample time": ("run: give a recording, or a drive", lambda: rdpi.Model(with_effects()).predict(DRIVE_V)),
    "a sample time of a recording": ("a recording has its own", lambda: rdpi.Model(with_effects()).predict(
        recording(DRIVE_V), STEP_S)),
    "a start that is none": ("start", lambda: rdpi.Model(with_effects()).predict(DRIVE_V, STEP_S, start="somewhere")),
    "no state": ("state", lambda: rdpi.Model(with_effects()).simulator(STEP_S, state="somewhere")),
    "too short a sample time": ("sample_time_s", lambda: rdpi.Model(with_effects()).simulator(0.0)),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case: str) -> None:
    message, use = REFUSED[case]
    with pytest.raises(BadInput, match=message):
        use()
