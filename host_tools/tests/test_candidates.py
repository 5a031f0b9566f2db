"""Candidates: fits of an effect to recordings of plants that have just that, and Gram matrices as dense algebra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from injected import NOISE_UM, RATE_HZ, drives, entry, plain_model, recorded, rms
from plants import changed, marked, quasi_static, stack, waves

from rdpi.gap import normal_equations, thresholds
from rdpi.gap.candidates import Candidate, search
from rdpi.gap.dataset import BLOCKS, Dataset
from rdpi.gap.normal_equations import LEFT_OUT, NormalEquations
from rdpi.simulate import chain
from rdpi.simulate.effects import CATALOGUE, Acting
from rdpi.simulate.memory import states_after

# An effect, where it acts, and the parameters a plant has; which of them to find, and how nearly.
INJECTED: dict[str, tuple[str, dict[str, float], dict[str, float]]] = {
    "input_curve": ("actuator", {"quadratic": 0.1, "cubic": 0.15, "low_V": 0.0, "high_V": 100.0},
                    {"quadratic": 0.02, "cubic": 0.02}),
    "quantisation": ("DAC", {"step": 0.8, "origin": 0.13}, {"step": 0.01}),
    "delay": ("timing", {"delay_s": 0.0034}, {"delay_s": 0.01}),
    "delay at the sensor": ("sensor", {"delay_s": 0.0034}, {"delay_s": 0.01}),
    "slew_limit": ("amplifier", {"V_per_s": 400.0}, {"V_per_s": 0.03}),
    "lag": ("amplifier", {"time_constant_s": 0.004}, {"time_constant_s": 0.02}),
    "lag at the sensor": ("sensor", {"time_constant_s": 0.004}, {"time_constant_s": 0.02}),
    "rail_saturation": ("amplifier", {"V_min": 8.0, "V_max": 88.0}, {"V_min": 0.02, "V_max": 0.02}),
    "rate_dependence": ("actuator", {"widening": 0.3, "change": -0.05, "exponent": 0.7},
                        {"widening": 0.03, "change": 0.03, "exponent": 0.05}),
    "hysteresis_change": ("actuator", {"scale": 0.4, "shape": 0.2}, {"scale": 0.02, "shape": 0.05}),
    "creep": ("actuator", {"percent_per_decade": 2.0}, {"percent_per_decade": 0.02}),
    "relaxation": ("actuator", {"share": 0.06, "time_constant_s": 0.02}, {"share": 0.02, "time_constant_s": 0.02}),
    "gain_change": ("actuator", {"factor": 1.04}, {"factor": 0.001}),
    "backlash": ("mechanics", {"width_um": 0.3}, {"width_um": 0.02}),
    "resonance": ("mechanics", {"f0_hz": 60.0, "damping": 0.1}, {"f0_hz": 0.01, "damping": 0.05}),
    "cross_coupling": ("environment", {"um_per_V": 0.05}, {"um_per_V": 0.01}),
    "static_nonlinearity": ("sensor", {"linear": 0.01, "quadratic": 0.05, "cubic": -0.04},
                            {"linear": 0.05, "quadratic": 0.02, "cubic": 0.05})}


def found(dataset: Dataset, name: str, stage: str | None = None, acting: Sequence[Acting] = ()) -> Candidate:
    one = search(dataset, CATALOGUE[name](stage), acting, dataset.predict(acting))
    assert one is not None
    return one


# --- one recording beside its model ----------------------------------------------------------------------------------

@pytest.mark.parametrize("law", [0.0, 1.0])
def test_a_rig_predicts_what_simulate_does(law: float) -> None:
    model = plain_model(law)
    runs = recorded(model, drives())
    dataset = Dataset(model, runs)
    together = dataset.join([one.predicted_um for one in chain.simulate(model, runs)])
    assert rms(dataset.predict([]) - together) < 3e-4 * model.stroke_um
    lag = entry("lag", "sensor", time_constant_s=0.003)
    with_lag = dataset.join([one.predicted_um for one in chain.simulate(replace(model, effects=[lag]), runs)])
    assert rms(dataset.predict([Acting(CATALOGUE["lag"]("sensor"), {"time_constant_s": 0.003})]) - with_lag) < \
        3e-4 * model.stroke_um
    assert rms(with_lag - together) > 0.02


def test_effects_that_the_model_has_are_no_part_of_its_runs() -> None:
    gain = entry("gain_change", "actuator", factor=1.1)
    with_it = replace(plain_model(), effects=[gain])
    dataset = Dataset(with_it, recorded(plain_model(), drives(), gain))
    assert dataset.model_runs[0].model.effects == []
    left = dataset.measured - dataset.predict([Acting(CATALOGUE["gain_change"](), {"factor": 1.1})])
    assert rms(left) == pytest.approx(NOISE_UM, rel=0.05)


@pytest.mark.parametrize("law", [0.0, 1.0])
def test_the_models_jacobian(law: float) -> None:
    """In W_i as a share, c_i times the highest rate as a share of W_i, and the dead zones' weights."""
    model = plain_model(law, "control")
    one_run = Dataset(model, recorded(model, drives())[1:2]).model_runs[0]
    columns = one_run.model_jacobian
    step, top = 1e-6, model.rate.identified_um_per_s
    changes = [replace(model, slopes=model.slopes * (1 + step * (np.arange(10) == i))) for i in range(10)]
    if law:
        changes += [replace(model, slope_rate_s_per_um=model.slope_rate_s_per_um
                            + step * (np.arange(10) == i) * model.slopes / top) for i in range(10)]
    changes += [replace(model, deadzone_weights=model.deadzone_weights + step * (np.arange(3) == j)) for j in (1, 2)]
    assert columns.shape == (len(one_run.recording), len(changes))
    before = one_run.predict([])
    for column, other in zip(columns.T, changes):
        slope = (replace(one_run, model=other).predict([]) - before) / step
        assert column == pytest.approx(slope, abs=1e-4 * model.stroke_um)
        assert np.ptp(column) > 0.01


def test_the_plays_may_start_elsewhere() -> None:
    model = plain_model()
    one_run = Dataset(model, recorded(model, drives())[:1]).model_runs[0]
    before, columns = one_run.predict([]), one_run.model_jacobian
    start = states_after(one_run.start_um[0] + 3.0, one_run.start_um[0], model.thresholds_um)
    elsewhere = one_run.starting(start)
    assert np.abs(elsewhere.predict([]) - before).max() > 0.05
    assert np.abs(elsewhere.model_jacobian - columns).max() > 0.05
    assert np.array_equal(one_run.predict([]), before)


def test_a_start_that_is_no_sweeps_stays_when_the_first_sample_moves() -> None:
    """A sweep ended where it was driven to; who set a start meant it."""
    curve = Acting(CATALOGUE["input_curve"](), {"quadratic": 0.2, "cubic": 0.0, "low_V": 0.0, "high_V": 100.0})
    model = replace(plain_model(), memory=replace(plain_model().memory, sweep_share=0.5))
    (swept,) = Dataset(model, recorded(model, drives())[2:]).model_runs
    x0 = float(model.x_of(curve.effect.drive(swept.input_V, swept.recording, curve.values, model)[0]))
    assert abs(x0 - swept.start_um[0]) > 0.1
    assert swept.predict([curve]) == pytest.approx(swept.predict([curve], model.swept(x0)), abs=1e-9)
    start = states_after(x0 + 3.0, x0, model.thresholds_um)
    elsewhere = swept.starting(start)
    assert elsewhere.predict([curve]) == pytest.approx(swept.predict([curve], start), abs=1e-9)
    assert rms(elsewhere.predict([curve]) - swept.predict([curve])) > 0.01
    assert np.array_equal(swept.starting(swept.start_um).predict([curve]), swept.predict([curve]))


# --- many as one vector ----------------------------------------------------------------------------------------------

def test_joining_and_splitting() -> None:
    dataset = Dataset(plain_model(), recorded(plain_model(), drives()))
    parts = dataset.split(dataset.measured)
    for part, one_run in zip(parts, dataset.model_runs):
        z = one_run.recording.displacement_um
        assert part == pytest.approx(z - np.mean(z))
    assert dataset.join([part + 7.0 for part in parts]) == pytest.approx(dataset.measured, abs=1e-9)
    assert np.array_equal(np.unique(dataset.block), np.arange(len(dataset.run_of_block)))
    for run, length in enumerate(dataset.lengths):
        inside = dataset.run_of_block[dataset.block] == run
        assert np.count_nonzero(inside) == length
        counts = np.bincount(dataset.block[inside])[-BLOCKS:]
        assert counts.max() - counts.min() <= 1


def test_a_monitor_is_judged_by_itself_and_drives_the_actuator() -> None:
    """A lag before the tap: the monitor shows it, and behind the tap nothing is missing."""
    model = plain_model()
    lag = Acting(CATALOGUE["lag"]("amplifier"), {"time_constant_s": 0.004})
    runs = recorded(model, drives(), entry("lag", "amplifier", **lag.values))
    runs = [changed(run, monitor_V=lag.effect.drive(run.command_V, run, lag.values, model)) for run in runs]
    dataset = Dataset(model, runs)
    assert dataset.monitored and len(dataset.measured) == 2 * sum(dataset.lengths)
    left = dataset.measured - dataset.predict([])
    assert rms(np.concatenate(dataset.split(left))) == pytest.approx(NOISE_UM, rel=0.05)
    assert rms(np.concatenate(dataset.split(left, monitor=True))) > 0.05
    of_monitor = dataset.of_monitor[dataset.block]
    assert np.sum(left[of_monitor] ** 2) > 100 * np.sum(left[~of_monitor] ** 2)
    one = found(dataset, "lag", "amplifier")
    assert one.values["time_constant_s"] == pytest.approx(0.004, rel=0.01)
    behind = found(dataset, "lag", "sensor")
    assert behind.values["time_constant_s"] < 2e-4  # s; nothing is there to find


# --- fits ------------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("case", INJECTED)
def test_search_finds_what_was_injected(case: str) -> None:
    stage, values, tolerances = INJECTED[case]
    name = case.split(" ")[0]
    model = plain_model()
    dataset = Dataset(model, recorded(model, drives(), entry(name, stage, **values)))
    one = found(dataset, name, stage)
    for parameter, tolerance in tolerances.items():
        assert one.values[parameter] == pytest.approx(values[parameter], rel=tolerance)
    assert one.change == pytest.approx(dataset.predict([one.acting]) - dataset.predict([]), abs=1e-9)
    assert one.jacobian.shape == (len(one.change), len(one.fitted))
    left = rms(dataset.measured - dataset.predict([]) - one.change)
    before = rms(dataset.measured - dataset.predict([]))
    # where the codes of a DAC lie is found to a few percent of a step
    assert left < (0.5 * before if name == "quantisation" else 1.1 * NOISE_UM) and before > 2 * NOISE_UM


def test_search_beside_an_effect_that_acts() -> None:
    model = plain_model()
    delay = Acting(CATALOGUE["delay"]("timing"), {"delay_s": 0.0034})
    dataset = Dataset(model, recorded(model, drives(), entry("delay", "timing", **delay.values),
                                  entry("creep", "actuator", percent_per_decade=2.0)))
    one = found(dataset, "creep", acting=[delay])
    assert one.values["percent_per_decade"] == pytest.approx(2.0, rel=0.02)
    assert rms(dataset.measured - dataset.predict([delay]) - one.change) < 1.1 * NOISE_UM


def test_search_on_recordings_without_the_effect_stays_near_nothing() -> None:
    model = plain_model()
    dataset = Dataset(model, recorded(model, drives()))
    for name, near in (("delay", 2e-5), ("lag", 2e-5), ("creep", 0.02), ("backlash", 0.01)):
        one = found(dataset, name)
        (value,) = one.values.values()
        assert abs(value) < near
    assert found(dataset, "gain_change").values["factor"] == pytest.approx(1, abs=1e-4)


def test_search_of_what_nothing_excites() -> None:
    model = plain_model()
    dataset = Dataset(model, recorded(model, drives()))
    assert search(dataset, CATALOGUE["quantisation"]("sensor"), [], dataset.predict([])) is None
    assert search(dataset, CATALOGUE["cross_coupling"](column="third_V"), [], dataset.predict([])) is None


def test_search_for_the_start_of_the_memory() -> None:
    model, plant = plain_model(), stack(law=0)
    plant.settle(80.0)
    plant.respond(np.array([50.0]), np.zeros(1))
    run = quasi_static(plant, np.r_[50 + waves(20, 2, 2, RATE_HZ), 50 - waves(50, 2, 2, RATE_HZ)], RATE_HZ,
                       noise_um=NOISE_UM)
    dataset = Dataset(model, [run])
    one = found(dataset, "initial_memory")
    before, after = (rms(dataset.measured - dataset.predict([]) - change) for change in (0.0, one.change))
    assert before > 10 * NOISE_UM and after < 3 * NOISE_UM  # positions are tried on a grid
    assert dataset.starting(one.memory_um).predict([]) == pytest.approx(dataset.measured, abs=0.1)
    assert search(Dataset(model, [marked(run, memory="unknown")]), CATALOGUE["initial_memory"](), [],
                  dataset.predict([])) is None


def test_search_for_drift_in_every_recording() -> None:
    runs = [changed(run, displacement_um=run.displacement_um + um_per_s * run.time_s)
            for run, um_per_s in zip(recorded(plain_model(), drives()), (0.1, -0.2, 0.05))]
    dataset = Dataset(plain_model(), runs)
    one = found(dataset, "thermal_drift")
    assert one.values["um_per_s"] == pytest.approx(np.average([0.1, -0.2, 0.05], weights=dataset.lengths), abs=0.002)
    assert rms(dataset.measured - dataset.predict([]) - one.change) == pytest.approx(NOISE_UM, rel=0.05)


def test_search_for_hum() -> None:
    runs = [changed(run, displacement_um=run.displacement_um + 0.05 * np.sin(2 * np.pi * 47.3 * run.time_s + phase))
            for run, phase in zip(recorded(plain_model(), drives()), (0.0, 1.0, 4.0))]
    dataset = Dataset(plain_model(), runs)
    one = found(dataset, "periodic_disturbance")
    assert one.values["frequency_hz"] == pytest.approx(47.3, abs=0.01)
    assert one.values["amplitude_um"] == pytest.approx(0.05, rel=0.03)
    assert rms(dataset.measured - dataset.predict([]) - one.change) == pytest.approx(NOISE_UM, rel=0.05)


# --- Gram matrices ---------------------------------------------------------------------------------------------------

@lru_cache(maxsize=None)
def judged() -> tuple[Dataset, np.ndarray, NormalEquations]:
    """A curved sensor and drift, the gap, and four candidates: 0 curve, 1 creep, 2 drift, 3 gain."""
    model = plain_model()
    runs = recorded(model, drives(), entry("static_nonlinearity", "sensor", quadratic=0.02, cubic=-0.01))
    runs = [changed(run, displacement_um=run.displacement_um + 0.05 * (k - 1) * run.time_s)
            for k, run in enumerate(runs)]
    dataset = Dataset(model, runs)
    left = dataset.measured - dataset.predict([])
    tried = [found(dataset, name) for name in ("static_nonlinearity", "creep", "thermal_drift", "gain_change")]
    return dataset, left, NormalEquations(dataset, left, tried)


def per_block(dataset: Dataset, left: np.ndarray) -> np.ndarray:
    return np.bincount(dataset.block, left**2, len(dataset.run_of_block))


def test_what_is_left_without_any_effect() -> None:
    dataset, left, equations = judged()
    assert equations.held_out() == pytest.approx(per_block(dataset, left), rel=1e-9)


@pytest.mark.parametrize(("chosen", "name"), [(0, "static_nonlinearity"), (3, "gain_change"), (1, "creep")])
def test_leaving_out_a_recording_is_fitting_to_the_others(chosen: int, name: str) -> None:
    """By the effect itself with the parameters that fit the others best: these effects are linear in them."""
    dataset, left, equations = judged()
    run = dataset.run_of_block[dataset.block]
    effect, expected = CATALOGUE[name](), np.empty(len(dataset.run_of_block))
    units = [{**effect.absent(), one.name: one.absent + 1e-3} for one in effect.parameters]
    columns = np.column_stack([dataset.predict([Acting(effect, values)]) - dataset.predict([]) for values in units])
    for held in range(3):
        sizes = np.linalg.lstsq(columns[run != held], left[run != held], rcond=None)[0]
        values = {one.name: one.absent + 1e-3 * size for one, size in zip(effect.parameters, sizes)}
        rest = dataset.measured - dataset.predict([Acting(effect, values)])
        inside = dataset.run_of_block == held
        expected[inside] = per_block(dataset, rest)[inside]
    assert equations.held_out(chosen) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("chosen", [None, 0])
def test_leaving_out_a_recording_with_the_model_refitted(chosen: int | None) -> None:
    """Dense algebra: the model's slopes with their prior as further rows."""
    dataset, left, equations = judged()
    run = dataset.run_of_block[dataset.block]
    own = dataset.join([one_run.model_jacobian for one_run in dataset.model_runs])
    one = None if chosen is None else equations.candidates[chosen]
    target = left if one is None else left - one.change
    columns = own if one is None else np.hstack([own, one.jacobian])
    prior = np.sqrt(np.sum(left**2) * thresholds.CORRELATED / len(left)) / thresholds.REFIT_FREEDOM
    rows = np.pad(prior * np.eye(own.shape[1]), ((0, 0), (0, columns.shape[1] - own.shape[1])))
    expected = np.empty(len(dataset.run_of_block))
    for held in range(3):
        stacked = np.vstack([columns[run != held], rows])
        scale = np.linalg.norm(stacked, axis=0)
        move = np.linalg.lstsq(stacked / scale, np.r_[target[run != held], np.zeros(len(rows))], rcond=None)[0] / scale
        inside = dataset.run_of_block == held
        expected[inside] = per_block(dataset, target - columns @ move)[inside]
    assert equations.held_out(chosen, refit=True) == pytest.approx(expected, rel=1e-3)


def test_a_disturbance_is_judged_between_the_blocks_it_was_fitted_to() -> None:
    dataset, left, equations = judged()
    drift = equations.candidates[2]
    expected = np.empty(len(dataset.run_of_block))
    for block in range(len(expected)):
        mates = [k for k in range(len(expected)) if dataset.run_of_block[k] == dataset.run_of_block[block]
                 and k % 2 != block % 2]
        inside, fitted = dataset.block == block, np.isin(dataset.block, mates)
        size = np.linalg.lstsq(drift.jacobian[fitted], (left - drift.change)[fitted], rcond=None)[0]
        expected[block] = np.sum((left[inside] - drift.change[inside] - drift.jacobian[inside] @ size) ** 2)
    assert equations.held_out(2) == pytest.approx(expected, rel=1e-4)


def test_parts_of_the_only_recording_are_left_out() -> None:
    model = plain_model()
    dataset = Dataset(model, recorded(model, drives(), entry("gain_change", "actuator", factor=1.02))[:1])
    left = dataset.measured - dataset.predict([])
    one = found(dataset, "gain_change")
    equations = NormalEquations(dataset, left, [one])
    fold, _ = equations.folds()
    assert np.array_equal(np.bincount(fold), np.full(LEFT_OUT, BLOCKS / LEFT_OUT))
    assert np.array_equal(fold, equations.folds(within=True)[0])
    expected = np.empty(BLOCKS)
    for held in (fold == part for part in range(LEFT_OUT)):
        outside = ~held[dataset.block]
        size = np.linalg.lstsq(one.jacobian[outside], (left - one.change)[outside], rcond=None)[0]
        expected[held] = per_block(dataset, left - one.change - one.jacobian @ size)[held]
    assert equations.held_out(0) == pytest.approx(expected, rel=1e-4)


def test_memory_is_found_beside_a_drift() -> None:
    """What the drift explains is no part of what a start changes."""
    model = plain_model()
    run = drives()[2]
    x0 = float(model.x_of(run.command_V[0]))
    start = states_after(x0 + 4.0, x0, model.thresholds_um)
    wrong = replace(model, memory=replace(model.memory, x_um=x0, plays_um=start))
    (shown,) = recorded(wrong, [marked(run, memory="unknown")])
    shown = marked(changed(shown, displacement_um=shown.displacement_um + 0.3 * run.time_s), memory="reset")
    dataset = Dataset(model, [shown])
    drift = found(dataset, "thermal_drift")
    before = dataset.predict([]) + drift.change
    one = search(dataset, CATALOGUE["initial_memory"](), [], before)
    assert one is not None and one.values["position_um"] == pytest.approx(x0 + 4.0, abs=0.5)
    left = dataset.measured - before
    assert rms(left - one.change) < 0.7 * rms(left)
    assert one.change == pytest.approx(dataset.starting(one.memory_um).predict([]) - dataset.predict([]), abs=1e-9)


def test_a_rail_that_no_command_reaches_is_none() -> None:
    model = plain_model()
    dataset = Dataset(model, recorded(model, drives(), entry("rail_saturation", V_max=70.0)))
    one = found(dataset, "rail_saturation")
    assert one.values["V_min"] == -np.inf and one.values["V_max"] == pytest.approx(70.0, abs=0.5)
    left = dataset.measured - dataset.predict([]) - one.change
    equations = NormalEquations(dataset, left, [], [one])
    for moves in (equations.moves(), equations.moves(within=True)):
        assert np.all(np.isnan(moves[:, 0])) and np.all(np.isfinite(moves[:, 1]))


def test_moves_of_what_one_recording_alone_shows() -> None:
    model = plain_model()
    slow = drives((("sine", {"frequencies_hz": (1.0,), "cycles": 3}, 0.1),))
    fast = drives((("steps", {"levels": 4, "hold_s": 0.3}, 1.0),))
    dataset = Dataset(model, recorded(model, [*slow, *fast], entry("slew_limit", V_per_s=350.0)))
    one = found(dataset, "slew_limit")
    equations = NormalEquations(dataset, dataset.measured - dataset.predict([]) - one.change, [], [one])
    runs, parts = equations.moves(), equations.moves(within=True)
    assert np.isfinite(runs[0]) and np.isnan(runs[1]), "without the steps nothing tells of it"
    assert np.all(np.isfinite(parts)) and np.ptp(parts) > 0


def test_moves_of_those_that_act_already() -> None:
    dataset, left, _ = judged()
    acting = [found(dataset, "static_nonlinearity"), found(dataset, "thermal_drift")]
    rest = left - acting[0].change
    run = dataset.run_of_block[dataset.block]
    moves = NormalEquations(dataset, rest, [], acting).moves()
    for held, move in enumerate(moves):
        expected = np.linalg.lstsq(acting[0].jacobian[run != held], rest[run != held], rcond=None)[0]
        assert move == pytest.approx(expected, rel=1e-3, abs=1e-8)


def test_the_models_refit_beside_a_candidate() -> None:
    """A plant whose slopes and gain departed from the model: both are found together."""
    model = plain_model()
    wider = replace(model, slopes=model.slopes * np.linspace(1.02, 1.0, 10))
    dataset = Dataset(model, recorded(wider, drives(), entry("creep", "actuator", percent_per_decade=2.0)))
    left = dataset.measured - dataset.predict([])
    equations = NormalEquations(dataset, left, [found(dataset, "creep")])
    move = equations.refitted_model(0)
    assert move[:9] == pytest.approx(np.linspace(0.02, 0.0, 10)[:9], abs=0.003)
    own = dataset.join([one_run.model_jacobian for one_run in dataset.model_runs])
    one = equations.candidates[0]
    sizes = np.linalg.lstsq(one.jacobian, left - own @ move, rcond=None)[0]
    assert sizes == pytest.approx([2.0], rel=0.02)


def test_what_reproduces_what() -> None:
    dataset, _, equations = judged()
    r2 = equations.reproduced()
    assert np.diag(r2) == pytest.approx(np.ones(4))
    run = dataset.run_of_block[dataset.block]
    for i, truth in enumerate(equations.candidates):
        for j, other in enumerate(equations.candidates):
            columns = np.column_stack([other.change, other.jacobian])
            parts = [run == k for k in range(3)] if other.per_run else [np.full(len(run), True)]
            explained = 0.0
            for part in parts:
                sizes = np.linalg.lstsq(columns[part], truth.change[part], rcond=1e-9)[0]
                explained += float(np.sum((columns[part] @ sizes) ** 2))
            assert r2[i, j] == pytest.approx(explained / np.sum(truth.change**2), abs=1e-4)
    assert r2[3, 0] == pytest.approx(1, abs=1e-6)  # a curve's linear part is a gain
    assert r2[0, 3] < 0.9


def test_fewer_rows_say_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset, left, equations = judged()
    monkeypatch.setattr(normal_equations, "ROWS", 4000)
    fewer = NormalEquations(dataset, left, equations.candidates)
    assert np.sum(fewer.held_out(0)) == pytest.approx(np.sum(equations.held_out(0)), rel=0.05)


def test_no_move_goes_beyond_the_bounds() -> None:
    dataset, _, _ = judged()
    one = found(dataset, "creep")
    left = 30 * one.jacobian[:, 0] + one.change  # 30 % a decade more, at most 20 in all
    equations = NormalEquations(dataset, left, [one])
    expected = per_block(dataset, (30 + one.values["percent_per_decade"] - 20) * one.jacobian[:, 0])
    assert equations.held_out(0) == pytest.approx(expected, rel=1e-6)


def test_no_move_goes_further_than_jacobians_hold() -> None:
    """A delay of which the recordings ask for ten times more than its change: by REACH of that at most."""
    dataset = Dataset(plain_model(), recorded(plain_model(), drives(), entry("delay", "timing", delay_s=0.001)))
    one = found(dataset, "delay")
    equations = NormalEquations(dataset, 10 * one.change, [one])
    column = one.jacobian[:, 0].astype(float)
    step = np.sign(one.change @ column) * thresholds.REACH * np.linalg.norm(one.change) / np.linalg.norm(column)
    expected = per_block(dataset, 9 * one.change - step * column)
    assert equations.held_out(0) == pytest.approx(expected, rel=1e-6)


def test_what_was_asked_before_changes_no_prediction() -> None:
    """A dataset remembers what effects made of the last prediction: ahead of the operator, behind it, at both sides."""
    random, runs = np.random.default_rng(3), recorded(plain_model(), drives())
    dataset = Dataset(plain_model(), runs)
    known = [("delay", "timing", {"delay_s": (0.001, 0.003)}), ("relaxation", "actuator", {"share": (0.02, 0.05)}),
             ("creep", "actuator", {"percent_per_decade": (1.0, 3.0)}), ("gain_change", "actuator", {"factor": (1.1, 0.9)}),
             ("resonance", "mechanics", {"f0_hz": (90.0, 150.0)})]
    others = {"relaxation": {"time_constant_s": 0.02}, "resonance": {"damping": 0.1}}
    for _ in range(12):
        acting = [Acting(CATALOGUE[name](stage), {key: ends[random.integers(2)] for key, ends in values.items()}
                         | others.get(name, {})) for name, stage, values in known if random.random() < 0.7]
        assert np.array_equal(dataset.predict(acting), Dataset(plain_model(), runs).predict(acting))
