"""No verdict is lost to where an actuator starts, or is driven: effects ahead of it lead beyond the recorded range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from injected import RATE_HZ, commissioned, entry, plain_model, recorded
from plants import changed, marked, recording, waves

from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.gap import candidates, diagnose
from rdpi.gap.dataset import Dataset
from rdpi.model import LARGEST, Drive, Model
from rdpi.simulate import chain, effects
from rdpi.simulate.effects import CATALOGUE, Acting
from rdpi.simulate.effects.hysteresis_change import widened

# Of every effect ahead of the operator; none leaves the first sample of both drives where it was.
AHEAD = {"quantisation": {"step": 100 / 31, "origin": 1.0}, "delay": {"delay_s": 0.004},
         "slew_limit": {"V_per_s": 300.0}, "lag": {"time_constant_s": 0.005},
         "rail_saturation": {"V_min": 8.0, "V_max": 90.0}, "hysteresis_change": {"scale": 0.5, "shape": 0.2},
         "input_curve": {"quadratic": 0.1, "cubic": 0.15, "low_V": 20.0, "high_V": 80.0}}
PLACES = [(name, stage) for name, kind in CATALOGUE.items() for stage in kind.stages if kind(stage).ahead]
STARTS = "lowest", "highest"
MEMORIES = "unknown", "carried", "reset"


def drives(start: str, memories: Sequence[str]) -> list[Recording]:
    """Drives that touch both ends of the range and start at one of them, their memories in turn."""
    found = []
    for k, (hertz, cycles, low) in enumerate([(1.0, 2, 0.0), (4.0, 6, 0.0), (2.0, 4, 25.0)]):
        command = waves(100.0, hertz, cycles, RATE_HZ, low)
        command = command if start == STARTS[0] else 100.0 - command
        found.append(marked(recording(command, None, RATE_HZ, f"{k}.csv"), memory=memories[k % len(memories)]))
    return found


def actuator(name: str, stage: str) -> dict:
    return entry(name, stage, **AHEAD[name])


def check_that_nothing_is_lost(model: Model, runs: Sequence[Recording]) -> None:
    """A verdict, and an improved model that simulates and can be diagnosed."""
    found = diagnose(model, runs)
    assert found.document.verdict != "none"
    chain.simulate(found.improved, runs)
    diagnose(found.improved, runs)


@pytest.mark.parametrize("start", STARTS)
def test_a_dac_of_few_bits_that_starts_beyond_the_range(start: str) -> None:
    """The nearest code lies beyond the recorded commands, and the memory is estimated there."""
    dac = entry("quantisation", "DAC", step=100 / 31, origin=-1.0 if start == STARTS[0] else 1.0)
    runs = recorded(plain_model(), drives(start, ["unknown"]), dac)
    driven = effects.driven(effects.acting(replace(plain_model(), effects=[dac])), runs[0].command_V, runs[0],
                            plain_model())
    assert not np.min(runs[0].command_V) <= driven[0] <= np.max(runs[0].command_V)
    check_that_nothing_is_lost(commissioned(), runs)


@pytest.mark.parametrize("start", [pytest.param(STARTS[0], marks=pytest.mark.slow),
                                   *(pytest.param(start, marks=pytest.mark.long) for start in STARTS[1:])])
@pytest.mark.parametrize("name, stage", PLACES)
def test_every_effect_ahead_of_the_operator_gets_a_verdict(name: str, stage: str, start: str) -> None:
    check_that_nothing_is_lost(commissioned(), recorded(plain_model(), drives(start, MEMORIES), actuator(name, stage)))


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("memory", ["reset", "unknown"])
@pytest.mark.parametrize("name, stage", PLACES)
def test_a_run_starts_where_simulate_does(name: str, stage: str, memory: str, start: str) -> None:
    """Whatever the effect does to the first sample, and to the range."""
    model = plain_model()
    with_it = replace(model, effects=[actuator(name, stage)])
    runs = recorded(model, drives(start, [memory]), *with_it.effects)
    dataset, acting = Dataset(model, runs), effects.acting(with_it)
    dataset.predict([])
    dataset = dataset.restarted(acting)
    simulated = dataset.join([one.predicted_um for one in chain.simulate(with_it, runs)])
    assert dataset.predict(acting) == pytest.approx(simulated, abs=1e-6 * model.stroke_um)


def test_a_simulated_actuator_goes_wherever_it_is_driven() -> None:
    """The model's range is what the inverse may output; a rail far beyond it is where the actuator is."""
    model = replace(plain_model(), drive=Drive(49.0, 51.0))
    rails = entry("rail_saturation", V_min=5e4, V_max=6e4)
    run = recorded(plain_model(), drives(STARTS[0], ["reset"]))[0]
    simulated = chain.simulate(replace(model, effects=[rails]), [run])[0].predicted_um
    there = chain.simulate(model, [changed(run, command_V=np.full(len(run), 5e4))])[0].predicted_um
    assert simulated == pytest.approx(there) and simulated[0] > 100 * model.stroke_um
    acting = effects.acting(replace(model, effects=[rails]))
    assert Dataset(model, [run]).predict(acting) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("command_V, words", [
    (-2 * LARGEST, r"far\.csv: the drive reaches .* V, beyond .* check the unit of command_V"),
    (1e200, r"far\.csv, sample 99: command_V is .*, beyond .* check its unit"),
])
def test_a_drive_beyond_all_numbers_is_refused_by_name(command_V: float, words: str) -> None:
    run = recording(np.linspace(0.0, command_V, 100), None, RATE_HZ, "far.csv")
    with pytest.raises(BadInput, match=words):
        chain.simulate(plain_model(), [run])


# --- what a fit tries stays what a model file takes, and what the library takes --------------------------------------

@pytest.mark.parametrize("name", CATALOGUE)
def test_a_fit_stays_within_what_a_model_file_takes(name: str) -> None:
    effect = CATALOGUE[name]()
    middle = {parameter.name: sum(parameter.ends) / 2 for parameter in effect.parameters}
    for sign in (-1, 1):
        far = candidates.bounded(effect, middle, dict.fromkeys(middle, sign * 1e12))
        for parameter, value in far.items():
            model = replace(plain_model(), effects=[entry(name, effect.stage, **{**effect.absent(), parameter: value})])
            if effect.refusal({**effect.absent(), parameter: value}) is None:
                assert effects.acting(model)[0].values[parameter] == value


@pytest.mark.parametrize("span_V", [100.0, 60.0, 20.0, 5.0, 1.0])
def test_changed_hysteresis_keeps_the_stroke_of_any_drive(span_V: float) -> None:
    """Also of one too short for the widest plays, as after drive.min_V and max_V were brought together."""
    model = replace(plain_model(), drive=Drive(50 - span_V / 2, 50 + span_V / 2),
                    deadzones_um=np.zeros(1), deadzone_weights=np.ones(1))
    up_and_down = recording(np.tile([model.drive.min_V, model.drive.max_V], 10), None, RATE_HZ)

    def stroke_um(changes: list[dict]) -> float:
        return float(np.ptp(chain.simulate(replace(model, effects=changes), [up_and_down])[0].predicted_um[2:]))

    for scale in (-0.9, 0.5, 5.0):
        assert np.all(widened(model, np.full(len(model.slopes), 1 + scale)) > 0)
        changes = [entry("hysteresis_change", scale=scale, shape=0.0)]
        assert stroke_um(changes) == pytest.approx(stroke_um([]), rel=1e-6)


def test_an_effect_that_cannot_be_tried_costs_no_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    search = candidates.search

    def refusing(dataset: Dataset, effect: effects.Effect, acting: Sequence[Acting], *predicted: np.ndarray) -> object:
        if effect.name == "delay":
            raise BadInput("the library refuses this one")
        return search(dataset, effect, acting, *predicted)

    monkeypatch.setattr(candidates, "search", refusing)
    runs = recorded(plain_model(), drives(STARTS[0], ["reset"]), actuator("lag", "amplifier"))
    document = diagnose(commissioned(), runs).document
    assert [one.name for one in document.effects] == ["lag"]
    delay = next(one for one in document.candidates if one.name == "delay")
    assert delay.rejected_because == "the library refuses this one" and not delay.excited
