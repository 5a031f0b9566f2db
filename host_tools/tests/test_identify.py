"""Identification against plants whose parameters are known (plants.py), without the command line."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import (Plant, changed, marked, quasi_static, rate_of, recording, slopes_um_per_V, stack, thresholds_um,
                    waves)

from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.fit import passport
from rdpi.fit.identify import FOLDS, SLOPE_FLOOR, Fit, Options, fit, rate_slopes
from rdpi.model import Drive
from rdpi.simulate import chain

SPAN_V = 90.0
STATIC = Options(rate_independent=True)
NOISE_UM = 0.004  # 0.03 % of the stroke


def static_run(plant: Plant | None = None, high: float = SPAN_V, low: float = 0.0, cycles: float = 3,
               rate_hz: float = 500.0, **options: object) -> Recording:
    """1 Hz at rate 0, from rest unless `plant` is given."""
    options = {"noise_um": NOISE_UM, **options}
    if plant is None:
        return recording(*from_rest(high, low, cycles, rate_hz), rate_hz, **options)
    return quasi_static(plant, waves(high, 1, cycles, rate_hz, low), rate_hz, **options)


@lru_cache(maxsize=None)
def from_rest(high: float, low: float, cycles: float, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Command in V and displacement in um of a stack at rate 0 that was swept to rest at `low`."""
    plant, command = stack(), waves(high, 1, cycles, rate_hz, low)
    plant.settle(low)
    return command, plant.respond(command, np.zeros(len(command)))


@lru_cache(maxsize=None)
def static_fit() -> Fit:
    return fit([static_run()], STATIC)


@lru_cache(maxsize=None)
def moving_run(source: str, hertz: float, rate_hz: float, law: float = 1.0) -> Recording:
    """Two full cycles and a half one, the plant's slopes following the rate of the displacement or of the control."""
    plant, name = stack(law=law), f"{hertz:g}Hz.csv"
    if source == "control":
        command = np.r_[waves(SPAN_V, hertz, 2, rate_hz), waves(SPAN_V / 2, hertz, 1, rate_hz)]
        return recording(command, plant.respond(command, 0.13 * rate_of(command, rate_hz)), rate_hz, name)
    z = np.r_[waves(12.0, hertz, 2, rate_hz), waves(6.0, hertz, 1, rate_hz)]
    return recording(plant.drive(z, rate_of(z, rate_hz)), z, rate_hz, name)


def moving_runs(source: str, noise_um: float = NOISE_UM, law: float = 1.0,
                hertz: tuple[float, ...] = (1, 5, 10, 20, 30), samples: int = 300) -> list[Recording]:
    """One run per frequency, each of `samples` per cycle."""
    runs = [moving_run(source, f, samples * f, law) for f in hertz]
    return [recording(run.command_V, run.displacement_um, run.sample_rate_hz, run.path, noise_um=noise_um)
            for run in runs]


def percent(found: np.ndarray, truth: np.ndarray) -> float:
    """Largest deviation, % of the truth."""
    return 100 * float(np.max(np.abs(found / truth - 1)))


# ---- the parameters of the plant come back ----

def test_rate_independent() -> None:
    plant, result = stack(), static_fit()
    model = result.model
    assert model.thresholds_um / model.gain_um_per_V == pytest.approx(plant.thresholds_V, rel=1e-3)
    assert percent(slopes_um_per_V(model), plant.slopes) < 1.5
    assert model.deadzones_um == pytest.approx(plant.deadzones_um, abs=0.3)
    assert model.deadzone_weights == pytest.approx(plant.weights, abs=0.01)
    assert model.offset_um == pytest.approx(0, abs=0.02) and model.offset_V == 0
    assert not model.slope_rate_s_per_um.any()
    score = result.scores[0].score
    assert score.rms_um < 1.3 * NOISE_UM and result.warnings == []


@pytest.mark.parametrize("noise_um, at_rest, at_top, rms", [(0.0, 1, 2, 0.06), (0.004, 1, 2, 0.08), (0.02, 2, 4, 0.22)])
@pytest.mark.parametrize("source", ["displacement", "control"])
def test_rate_law(source: str, noise_um: float, at_rest: float, at_top: float, rms: float) -> None:
    """From 1 to 30 Hz at once, a law by which W_0 reaches zero at 2900 um/s."""
    plant, runs = stack(), moving_runs(source, noise_um)
    result = fit(runs, Options(thresholds_um=thresholds_um(plant, runs), rate_source=source))
    model = result.model
    top = model.rate.identified_um_per_s
    truly = top if source == "displacement" else top * 0.13 / model.gain_um_per_V  # the plant's x is 0.13 um/V
    assert truly == pytest.approx(max(rate_of(run.displacement_um if source == "displacement" else 0.13 * run.command_V,
                                              run.sample_rate_hz).max() for run in moving_runs(source, 0.0)), rel=0.05)
    assert percent(slopes_um_per_V(model), plant.slopes) < at_rest
    assert percent(slopes_um_per_V(model, top), plant.slopes_at(truly)) < at_top
    assert model.rate.source == source and model.rate.max_um_per_s > top
    assert max(run.score.rms_percent for run in result.scores) < rms
    assert result.warnings == []


def test_slopes_of_each_band_agree_with_the_law() -> None:
    for source in ("displacement", "control"):
        runs = moving_runs(source)
        result = fit(runs, Options(thresholds_um=thresholds_um(stack(), runs), rate_source=source))
        bands = result.rate_slopes
        assert len(bands.rate_um_per_s) >= 6 and np.all(np.diff(bands.rate_um_per_s) > 0)
        assert bands.rate_um_per_s[-1] > 0.8 * result.model.rate.identified_um_per_s
        law = result.model.slopes_at(bands.rate_um_per_s)
        seen = ~np.isnan(bands.slopes)
        assert seen.mean() > 0.7 and percent(bands.slopes[seen], law[seen]) < 10
        assert percent(bands.slopes[0], law[0]) < 2  # most samples are slow
        again = rate_slopes(result.model, runs)
        assert all(np.allclose(one, other, rtol=0.01, equal_nan=True) for one, other in zip(again, bands))
        rows = bands.to_json()
        assert sum(row["samples"] for row in rows) <= sum(map(len, runs))
        assert [slope is None for slope in rows[0]["slopes"]] == list(np.isnan(bands.slopes[0]))


def test_the_other_source_is_recommended_only_where_it_is_right() -> None:
    runs = moving_runs("control")
    thresholds = thresholds_um(stack(), runs)
    wrong, right = (fit(runs, Options(thresholds_um=thresholds, rate_source=source))
                    for source in ("displacement", "control"))
    assert any("--rate-source control" in text for text in wrong.warnings)
    assert right.warnings == []
    assert max(run.score.rms_percent for run in wrong.scores) > 2 * max(run.score.rms_percent for run in right.scores)


def test_rate_window_and_filter_are_part_of_the_law() -> None:
    """A plant that feels its rate through the firmware's low-pass is identified by the same low-pass."""
    rate_hz, filter_s = 4000.0, 0.01
    plant = stack()
    command = np.r_[waves(SPAN_V, 20, 4, rate_hz), waves(SPAN_V, 5, 1, rate_hz)]
    rate, state = [], 0.0
    for raw in 0.13 * rate_of(command, rate_hz):
        state += (1 - np.exp(-1 / rate_hz / filter_s)) * (raw - state)
        rate.append(state)
    run = recording(command, plant.respond(command, rate), rate_hz, noise_um=NOISE_UM)
    with_filter, without = (fit([run], Options(rate_source="control", rate_filter_s=time)) for time in (filter_s, 0.0))
    assert with_filter.model.rate.filter_s == filter_s
    assert with_filter.scores[0].score.rms_percent < 0.06 < 3 * 0.06 < without.scores[0].score.rms_percent


@pytest.mark.parametrize("noise_um", [1e-3, 4e-3, 2e-2])
@pytest.mark.parametrize("rate_hz", [500.0, 5000.0])
def test_noise_floor(noise_um: float, rate_hz: float) -> None:
    result = fit([static_run(rate_hz=rate_hz, noise_um=noise_um, cycles=1)], STATIC)
    assert result.noise_um == pytest.approx(noise_um, rel=0.2)
    assert result.model.fit["noise_um"] == result.noise_um


# ---- gain, offsets, polarity ----

def test_inverted_actuator() -> None:
    upright, inverted = (fit([static_run(stack(inverted=inverted, offset_V=offset), low=low, high=high)], STATIC)
                         for inverted, offset, low, high in ((False, 0.0, 0.0, 90.0), (True, 50.0, 50.0, -40.0)))
    model = inverted.model
    assert model.gain_um_per_V == pytest.approx(-upright.model.gain_um_per_V) and model.offset_V == 50
    assert model.slopes == pytest.approx(upright.model.slopes, rel=1e-6)
    assert model.deadzones_um == pytest.approx(upright.model.deadzones_um, rel=1e-6)
    assert inverted.scores[0].score.rms_um == pytest.approx(upright.scores[0].score.rms_um, rel=1e-6)


@given(command_scale=st.sampled_from([-1e3, -1.0, 1e-3, 7.0]), command_shift=st.floats(-300, 300),
       displacement_scale=st.sampled_from([1e-3, 1.0, 1e3]), displacement_shift=st.floats(-900, 900))
@settings(max_examples=15)
def test_units_and_zeros_do_not_matter(command_scale: float, command_shift: float, displacement_scale: float,
                                       displacement_shift: float) -> None:
    run = static_run(cycles=2, rate_hz=250.0)
    moved = recording(command_scale * run.command_V + command_shift,
                      displacement_scale * (run.displacement_um + displacement_shift), 250.0)
    one, other = fit([run], STATIC).model, fit([moved], STATIC).model
    assert other.gain_um_per_V == pytest.approx(one.gain_um_per_V * displacement_scale / command_scale)
    assert other.slopes == pytest.approx(one.slopes, rel=1e-5)
    assert other.thresholds_um == pytest.approx(displacement_scale * one.thresholds_um)
    assert other.deadzones_um == pytest.approx(displacement_scale * one.deadzones_um, rel=1e-5)
    assert other.offset_um / displacement_scale == pytest.approx(one.offset_um + displacement_shift, abs=1e-4)


def test_each_run_has_an_offset_of_its_own() -> None:
    """Drift between runs must not bend the slopes; the model's offset is the mean."""
    shifts = (0.0, 1.5, -0.3)
    runs = [static_run(name=f"{i}.csv") for i in range(len(shifts))]
    drifted = [changed(run, displacement_um=run.displacement_um + shift) for run, shift in zip(runs, shifts)]
    one, other = (fit(group, replace(STATIC, deadzones=0)) for group in (runs, drifted))
    assert other.model.slopes == pytest.approx(one.model.slopes, rel=1e-9)
    assert other.model.offset_um - one.model.offset_um == pytest.approx(0.4)
    for run, before, shift in zip(other.scores, one.scores, shifts):
        assert run.score.offset_um == pytest.approx(before.score.offset_um + shift - 0.4, abs=1e-6)


def test_drive_limits_and_name() -> None:
    run = static_run(low=10, high=80, plant=stack(offset_V=10))
    named = marked(run, actuator="stack 7")
    model = fit([named], STATIC).model
    assert model.drive == Drive(10, 80, None, None)
    assert model.actuator == "stack 7"
    chosen = fit([named], replace(STATIC, min_V=-5, max_V=120, slew_V_per_s=1e4, dac_bits=16, actuator="other")).model
    assert chosen.drive == Drive(-5, 120, 1e4, 16)
    assert chosen.actuator == "other"


@pytest.mark.parametrize("limits, told", [
    ({}, True), ({"min_V": 0.0}, True), ({"min_V": 0.0, "max_V": 100.0}, False),
])
def test_codes_that_span_the_recorded_range_are_told(limits: dict[str, float], told: bool) -> None:
    """A DAC's first code is 10 V only by chance: every drive would be wrong."""
    run = static_run(low=10, high=80, plant=stack(offset_V=10))
    for bits in (None, 16):
        warnings = fit([run], replace(STATIC, dac_bits=bits, **limits)).warnings
        assert any("give --min-V and --max-V" in text for text in warnings) == (told and bits is not None)


def test_a_drive_range_within_the_recordings() -> None:
    """The recordings start at 0 V: the memory is moved into what the user allows the firmware to output."""
    model = fit([static_run()], replace(STATIC, min_V=20, max_V=60)).model
    model.validate()
    assert (model.drive.min_V, model.drive.max_V) == (20, 60)


# ---- slopes stay positive, the guard stays below the singularity ----

AWKWARD: dict[str, Callable[[np.random.Generator, np.ndarray], np.ndarray]] = {
    "loop the wrong way round": lambda random, command: 0.1 * np.roll(command, -30),
    "backlash": lambda random, command: replace(stack(), slopes=np.repeat([0, 0.15], 5)).respond(command, 0 * command),
    "coarse": lambda random, command: np.round(0.1 * command),
    "very noisy": lambda random, command: 0.1 * command + random.normal(size=len(command)),
    "drifting": lambda random, command: 0.1 * command + np.linspace(0, 5, len(command)),
    "saturating": lambda random, command: np.minimum(0.1 * command, 6),
    "dead at first": lambda random, command: np.maximum(0.1 * command - 2, 0),
    "straight": lambda random, command: 0.1 * command,
}


@pytest.mark.parametrize("kind", AWKWARD)
@pytest.mark.parametrize("rate_independent", [True, False])
def test_slopes_never_fall_below_the_floor(kind: str, rate_independent: bool) -> None:
    """Whatever the recording, the result is a model that the firmware would take."""
    command = np.r_[waves(90, 1, 1, 500), waves(50, 7, 3, 500, 20)]
    run = recording(command, AWKWARD[kind](np.random.default_rng(1), command), 500.0)
    for operators, deadzones in ((9, 2), (20, 0), (3, 4)):
        try:
            model = fit([run], Options(operators, deadzones, rate_independent=rate_independent)).model
        except BadInput as refusal:
            assert "--deadzones" in str(refusal) and deadzones > 0
            continue
        model.validate()
        top = model.rate.identified_um_per_s
        assert min(model.slopes.min(), model.slopes_at(top).min()) >= SLOPE_FLOOR * (1 - 1e-9)
        assert min(model.slopes_at(model.rate.max_um_per_s) / model.slopes) >= model.rate.min_slope_ratio * (1 - 1e-9)


def test_the_floor_is_reported() -> None:
    """An actuator that stands still for 10 V after each reversal has slopes of 0, and no inverse."""
    slack = replace(stack(), slopes=np.where(stack().thresholds_V < 10, 0.0, 0.15))
    result = fit([static_run(slack)], STATIC)
    assert result.model.slopes[:3].min() == pytest.approx(SLOPE_FLOOR)
    assert any("floor" in text and "--operators" in text for text in result.warnings)
    assert not any("floor" in text for text in static_fit().warnings)


@pytest.mark.parametrize("law, ratio", [(1.0, 0.2), (1.0, 0.5), (1.0, 0.7), (0.3, 0.2), (0.0, 0.2)])
def test_guard(law: float, ratio: float) -> None:
    runs = moving_runs("control", law=law)
    model = fit(runs, Options(rate_source="control", min_slope_ratio=ratio)).model
    top, rate = model.rate.identified_um_per_s, model.rate
    falling = model.slope_rate_s_per_um < 0
    zero = np.min(model.slopes[falling] / -model.slope_rate_s_per_um[falling], initial=np.inf)
    assert rate.singular_um_per_s == (pytest.approx(zero) if np.isfinite(zero) else None)
    assert rate.max_um_per_s == pytest.approx(min((1 - ratio) * zero, 1.25 * top))
    assert rate.min_slope_ratio == ratio
    if law == 1:
        assert rate.singular_um_per_s == pytest.approx(2900 * model.gain_um_per_V / 0.13, rel=0.05)
        assert (rate.max_um_per_s < 1.25 * top) == (ratio > 0.5)  # both limits are met


def test_no_rate_law_no_singularity() -> None:
    model = fit(moving_runs("displacement"), STATIC).model
    assert model.rate.singular_um_per_s is None
    assert model.rate.max_um_per_s == pytest.approx(1.25 * model.rate.identified_um_per_s)


# ---- thresholds, numbers of operators and dead zones ----

def test_unobservable_thresholds_are_not_fitted() -> None:
    run = static_run()
    reach = np.ptp(run.displacement_um) / 2  # in x: the fit's gain is stroke per command
    wanted = tuple(reach * share for share in (0.2, 0.5, 0.9, 0.99, 1.5))
    result = fit([run], replace(STATIC, thresholds_um=wanted))
    assert result.model.thresholds_um == pytest.approx([0, *wanted[:3]])
    (warning,) = [text for text in result.warnings if "unobservable" in text]
    assert f"{wanted[3]:g}, {wanted[4]:g} um" in warning and f"{reach:.4g} um" in warning
    assert not any("unobservable" in text for text in fit([run], replace(STATIC, thresholds_um=wanted[:3])).warnings)


def test_default_thresholds_are_equal_intervals_within_reach() -> None:
    for operators in (1, 5, 9):
        run = static_run()
        thresholds = fit([run], replace(STATIC, operators=operators)).model.thresholds_um
        reach = np.ptp(run.displacement_um) / 2
        assert thresholds == pytest.approx(np.arange(operators + 1) * reach / (operators + 1))


@pytest.mark.parametrize("deadzones", range(5))
@pytest.mark.parametrize("operators", [0, 1, 20])
def test_numbers(operators: int, deadzones: int) -> None:
    for options in (STATIC, Options()):
        result = fit([static_run()], replace(options, operators=operators, deadzones=deadzones))
        model = result.model
        assert len(model.slopes) == len(model.thresholds_um) == operators + 1
        assert len(model.deadzones_um) == len(model.deadzone_weights) == deadzones + 1
        model.validate()
        rms = result.scores[0].score.rms_percent
        assert 0.025 < rms < {0: 5.0, 1: 1.2, 20: 0.05 if deadzones > 1 else 1.0}[operators]
        assert operators == 20 or rms > {0: 4.0, 1: 0.4}[operators]


def test_more_dead_zones_fit_no_worse_and_predict_no_worse() -> None:
    """m = 4 on a plant of two dead zones, on a drive that was not fitted: the prior keeps what is not there small."""
    other = static_run(high=70, low=5, cycles=2, noise_um=0.0, name="other.csv")
    scores = []
    for deadzones in (0, 1, 2, 4):
        result = fit([static_run()], replace(STATIC, deadzones=deadzones), [other])
        scores.append([run.score.rms_percent for run in result.scores])
    fitted, held_out = np.array(scores).T
    assert fitted[0] > 5 * fitted[1] > 10 * fitted[2] and fitted[3] < 1.1 * fitted[2]
    assert held_out[0] > held_out[1] > 3 * held_out[2] and max(held_out[2:]) < 0.15


# ---- several runs ----

def test_sample_rates_and_lengths_mix() -> None:
    """Filters and windows are in seconds: the same drive sampled otherwise gives the same model."""
    runs = [static_run(rate_hz=rate, cycles=cycles, name=f"{rate:g}.csv")
            for rate, cycles in ((100.0, 4), (1000.0, 2), (10_000.0, 1))]
    result = fit(runs, STATIC)
    assert percent(slopes_um_per_V(result.model), stack().slopes) < 1.5
    assert max(run.score.rms_um for run in result.scores) < 1.3 * NOISE_UM
    alone = [fit([run], STATIC).model for run in runs[:2]]
    assert percent(slopes_um_per_V(alone[0]), slopes_um_per_V(alone[1])) < 1.5


@pytest.mark.slow
def test_rate_law_does_not_depend_on_sampling() -> None:
    coarse, fine = (moving_runs("displacement", hertz=(2, 10, 30), samples=samples) for samples in (100, 500))
    models = [fit(runs, Options(thresholds_um=thresholds_um(stack(), runs))).model for runs in (coarse, fine)]
    for rate in (0, 1000):
        assert percent(slopes_um_per_V(models[0], rate), slopes_um_per_V(models[1], rate)) < 3


def test_slow_runs_do_not_blur_the_rate_of_fast_ones() -> None:
    """Each run's rate is smoothed by what its own noise asks for."""
    runs = moving_runs("displacement", 0.02, hertz=(30, 0.2))
    options = Options(thresholds_um=thresholds_um(stack(), runs))
    alone, beside = fit(runs[:1], options), fit(runs, options)
    peak = max(rate_of(waves(12.0, 30, 1, 9000), 9000))
    assert beside.model.rate.identified_um_per_s == pytest.approx(peak, rel=0.1)
    assert beside.scores[0].score.rms_percent < 1.1 * alone.scores[0].score.rms_percent + 0.02


def test_a_small_run_beside_a_large_one() -> None:
    plant = stack()
    large = static_run(plant, name="large.csv")
    small = static_run(plant, high=25, low=0, name="small.csv", memory="carried")
    result = fit([large, small], STATIC)
    assert percent(slopes_um_per_V(result.model), plant.slopes) < 1.5
    score = result.scores[1].score
    assert score.rms_um < 1.5 * NOISE_UM
    assert score.rms_percent == pytest.approx(100 * score.rms_um / np.ptp(small.displacement_um))
    assert result.model.stroke_um == pytest.approx(np.ptp(large.displacement_um))


def test_a_run_counts_once() -> None:
    """Neither twice in the fit, nor fitted and held out."""
    for runs, held_out in (([static_run(), static_run()], []), ([static_run()], [static_run()])):
        with pytest.raises(BadInput, match=r"^run\.csv: given twice"):
            fit(runs, STATIC, held_out)


# ---- memory at the start ----

def visited(turns: tuple[float, ...], **options: object) -> Plant:
    """A plant that was moved through these voltages, in straight lines, and left at the last."""
    plant = stack(**options)
    for low, high in zip(turns, turns[1:]):
        plant.respond(np.linspace(low, high, 50), np.zeros(50))
    return plant


def test_reset() -> None:
    plant = stack()
    plant.settle(45.0)
    rising = np.r_[np.linspace(45, 90, 300), waves(0, 1, 2, 1000, 90)]
    run = quasi_static(plant, rising, noise_um=NOISE_UM)
    result = fit([run], STATIC)
    assert result.scores[0].memory == "reset" and result.scores[0].score.rms_um < 1.3 * NOISE_UM
    assert percent(slopes_um_per_V(result.model), plant.slopes) < 1.5
    x0 = result.model.x_of(45.0)
    assert result.model.memory.x_um == pytest.approx(x0)
    assert result.model.memory.plays_um == pytest.approx(np.full(10, x0))


def test_carried() -> None:
    plant = stack()
    first = quasi_static(plant, np.r_[waves(90, 1, 1, 1000), np.linspace(0, 60, 200)], name="first.csv",
                         noise_um=NOISE_UM)
    second = quasi_static(plant, np.r_[np.linspace(60, 30, 200), waves(55, 1, 1, 1000, 30)], memory="carried",
                          name="second.csv", noise_um=NOISE_UM)
    result = fit([first, second], STATIC)
    assert [run.memory for run in result.scores] == ["reset", "carried"]
    assert max(run.score.rms_um for run in result.scores) < 3 * NOISE_UM
    mistaken = fit([first, marked(second, memory="reset")], STATIC)
    assert mistaken.scores[1].score.rms_um > 10 * NOISE_UM


def test_a_held_out_run_is_carried_on_from_the_one_before() -> None:
    plant = stack()
    first = quasi_static(plant, np.r_[waves(90, 1, 2, 1000), np.linspace(0, 60, 200)], name="first.csv",
                         noise_um=NOISE_UM)
    second, third = (quasi_static(plant, np.r_[np.linspace(60, low, 200), np.linspace(low, 60, 200)], memory="carried",
                                  name=f"{low}.csv", noise_um=NOISE_UM) for low in (20, 40))
    result = fit([first], STATIC, [second, third])
    assert [run.memory for run in result.scores] == ["reset", "carried", "carried"]
    assert max(run.score.rms_um for run in result.scores) < 5 * NOISE_UM


@pytest.mark.parametrize("low, high", [(30, 90), (30, 84), (30, 60), (30, 45)])
@pytest.mark.parametrize("drift_um", [0.0, 0.4])
def test_unknown_memory_is_estimated(low: float, high: float, drift_um: float) -> None:
    """Also that of runs too small to erase it all, where the rest is an offset."""
    model = static_fit().model
    plant = stack()
    plant.settle(high)
    plant.respond(np.linspace(high, low, 50), np.zeros(50))
    run = static_run(plant, low=low, high=high, memory="unknown")
    run = changed(run, displacement_um=run.displacement_um + drift_um)
    prediction = chain.simulate(model, [run])[0]
    assert prediction.memory == "estimated"
    score = chain.score(prediction.predicted_um, run.displacement_um, remove_offset=True)
    assert score.rms_percent < 0.6 and score.max_percent < 2.5
    at_rest = chain.simulate(model, [run], "reset")[0].predicted_um
    assert chain.score(at_rest, run.displacement_um, remove_offset=True).rms_percent > 3 * score.rms_percent


def test_start_up_transient_is_left_out() -> None:
    """Before the drive has erased the memory, samples say nothing: whatever they were, the slopes stay the same."""
    run = static_run(visited((90.0, 30.0, 60.0, 0.0)), memory="unknown", cycles=3)
    erased = chain.warm_up(run.command_V, run.command_V[:].max() / 2 * 0.9)
    spoilt = run.displacement_um.copy()
    spoilt[:erased // 2] += np.linspace(1, 0, erased // 2)
    results = [fit([changed(run, displacement_um=z)], STATIC) for z in (run.displacement_um, spoilt)]
    assert results[1].model.slopes == pytest.approx(results[0].model.slopes, rel=1e-6)
    assert results[0].scores[0].memory == "estimated"
    assert percent(slopes_um_per_V(results[0].model), stack().slopes) < 3
    claimed = fit([marked(changed(run, displacement_um=spoilt), memory="reset")], STATIC)
    assert percent(slopes_um_per_V(claimed.model), stack().slopes) > 10


def test_rates_before_the_memory_is_erased_are_not_identified() -> None:
    command = np.r_[waves(50, 20, 3, 1000), waves(90, 1, 2, 1000)]
    unknown, known = (quasi_static(stack(), command, memory=memory, noise_um=NOISE_UM)
                      for memory in ("unknown", "reset"))
    slow, fast = (fit([run], STATIC).model.rate.identified_um_per_s for run in (unknown, known))
    peak = np.percentile(rate_of(static_run(rate_hz=1000.0, noise_um=0.0).displacement_um, 1000), 99.9)
    assert slow == pytest.approx(peak, rel=0.2) and fast > 5 * slow


def test_unknown_memory_of_one_run_does_not_move_the_offset_of_others() -> None:
    known = static_run()
    unknown = static_run(visited((90.0, 30.0)), low=30, high=84, memory="unknown", name="unknown.csv")
    result = fit([known, unknown], STATIC)
    assert result.scores[0].score.rms_um < 3 * NOISE_UM


def test_model_remembers_where_the_first_run_began() -> None:
    run = static_run(visited((90.0, 30.0)), low=30, high=90, memory="unknown")
    model = fit([run], STATIC).model
    assert model.memory.x_um == pytest.approx(model.x_of(30.0))
    truth = np.minimum(90.0 - model.thresholds_um / model.gain_um_per_V, 30 + model.thresholds_um / model.gain_um_per_V)
    assert model.memory.plays_um == pytest.approx(model.x_of(truth), abs=0.6)
    model.validate()


# ---- what is reported ----

def test_held_out_scores_are_those_of_a_simulation() -> None:
    held = [static_run(high=60, cycles=2, name="held.csv"),
            static_run(high=40, low=10, cycles=2, name="other.csv", memory="unknown")]
    result = fit([static_run()], STATIC, held)
    assert [run.held_out for run in result.scores] == [False, True, True]
    for run, prediction in zip(result.scores[1:], chain.simulate(result.model, held)):
        assert run.score == chain.score(prediction.predicted_um, run.recording.displacement_um)
        error = run.recording.displacement_um - prediction.predicted_um
        assert run.score.rms_um == pytest.approx(np.sqrt(np.mean(error**2)))
        assert run.score.max_percent == pytest.approx(100 * np.abs(error).max() / np.ptp(run.recording.displacement_um))
    assert static_fit().model.slopes == pytest.approx(result.model.slopes, rel=0, abs=0)


def test_an_exact_model_predicts_its_own_rate() -> None:
    """Without noise nothing smooths the measured rate; the prediction must find its own all the same."""
    runs = moving_runs("displacement", 0.0)
    result = fit(runs, Options(thresholds_um=thresholds_um(stack(), runs)))
    assert all(prediction.settled for prediction in chain.simulate(result.model, runs))
    assert max(run.score.max_percent for run in result.scores) < 0.4


def test_record() -> None:
    runs, held = [static_run(name="a.csv")], [static_run(name="b.csv", memory="unknown")]
    result = fit(runs, STATIC, held)
    record = result.model.fit
    assert [run["file"] for run in record["runs"]] == ["a.csv", "b.csv"]
    assert [run["digest"] for run in record["runs"]] == ["sha256:a.csv", "sha256:b.csv"]
    assert [run["held_out"] for run in record["runs"]] == [False, True]
    assert [run["memory"] for run in record["runs"]] == ["reset", "estimated"]
    assert [run["samples"] for run in record["runs"]] == [1500, 1500]
    for row, run in zip(record["runs"], result.scores):
        assert {key: row[key] for key in run.score._fields} == run.score._asdict()
    assert record["warnings"] == result.warnings
    assert not any("left out of the fit" in text for text in result.warnings if text.startswith("b.csv"))


def test_passport_holds_each_run_as_the_others_predict_it() -> None:
    """The second run is of another actuator, nearly, so that fitting it or not shows."""
    first, third = static_run(name="first.csv"), static_run(high=60, low=10, name="third.csv")
    odd = static_run(high=70, low=20, name="second.csv")
    odd = changed(odd, displacement_um=1.05 * odd.displacement_um)
    result = fit([first, odd, third], STATIC)
    runs = result.model.passport["runs"]
    assert [(run["file"], run["digest"]) for run in runs] == [(f"{k}.csv", f"sha256:{k}.csv")
                                                              for k in ("first", "second", "third")]
    assert {run["held_out"] for run in runs} == {passport.LEFT_OUT} == {result.model.passport["held_out"]}
    for run, score in zip(runs, result.scores):
        spread = np.sqrt(score.score.rms_um**2 - score.score.offset_um**2)
        assert run["fitted_rms_um"] == pytest.approx(spread, rel=1e-3)
    # without the second run, range and gain, and with them thresholds and dead zones, are the same
    other = fit([first, third], STATIC).model
    error = odd.displacement_um - chain.simulate(other, [odd])[0].predicted_um
    assert runs[1]["rms_um"] == pytest.approx(np.std(error), rel=0.03)
    assert runs[1]["rms_um"] > 1.3 * runs[1]["fitted_rms_um"]
    assert result.model.slopes != pytest.approx(other.slopes, rel=1e-3)


def test_passport_of_held_out_runs_and_of_a_single_one() -> None:
    held = static_run(high=60, cycles=2, name="held.csv")
    result = fit([static_run()], STATIC, [held])
    known = result.model.passport
    assert known["held_out"] == passport.OTHER_RUNS
    assert [run["held_out"] for run in known["runs"]] == [passport.FITTED, passport.OTHER_RUNS]
    score = result.scores[1].score
    assert known["runs"][1]["rms_um"] == pytest.approx(np.sqrt(score.rms_um**2 - score.offset_um**2), rel=1e-3)
    assert known["runs"][1]["fitted_rms_um"] is None
    single = static_fit().model.passport
    assert single["held_out"] == passport.FITTED and single["spread"] > known["spread"]


def test_passport_of_runs_with_a_rate_law() -> None:
    """Left out in turn, the fastest run too, the model still predicts them at the rate they have."""
    known = fit(moving_runs("displacement"), Options(thresholds_um=thresholds_um(
        stack(), moving_runs("displacement")))).model.passport
    assert all(run["held_out"] == passport.LEFT_OUT for run in known["runs"])
    assert all(run["rms_um"] < 4 * run["fitted_rms_um"] for run in known["runs"])


def test_passport_of_many_runs_leaves_out_groups() -> None:
    high = np.linspace(60, SPAN_V, FOLDS + 3)
    known = fit([static_run(high=top, cycles=1, name=f"{top:.0f}.csv") for top in high], STATIC).model.passport
    assert [run["held_out"] for run in known["runs"]] == [passport.LEFT_OUT] * len(high)
    assert all(run["rms_um"] < 3 * NOISE_UM for run in known["runs"])


def test_a_passport_where_the_other_runs_make_no_model() -> None:
    """What is left without the first run is too short to be fitted."""
    short = static_run(high=80, cycles=1, rate_hz=20.0, name="short.csv")
    known = fit([static_run(), short], STATIC).model.passport
    assert [run["held_out"] for run in known["runs"]] == [passport.FITTED, passport.LEFT_OUT]


def test_same_input_same_bits() -> None:
    runs = moving_runs("displacement", 0.02)
    first, second = (fit(runs, Options()) for _ in range(2))
    assert first.model.to_json() == second.model.to_json()
    assert first.rate_slopes.to_json() == second.rate_slopes.to_json()


def test_progress_rises_to_one() -> None:
    seen: list[float] = []
    fit([static_run(), static_run(name="again.csv")], STATIC, progress=seen.append)
    assert len(seen) > 2 and seen == sorted(seen) and 0 <= seen[0] and seen[-1] == 1


# ---- what is refused ----

def bent(**change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    run = static_run(name="bad.csv")
    return changed(run, **{key: make(run.columns[key]) for key, make in change.items()})


NOISE = np.random.default_rng(2).standard_normal(1500)
REFUSED: dict[str, tuple[Recording, str]] = {
    "constant command": (bent(command_V=lambda V: 0 * V + 5), r"command_V is constant at 5 V.*excite"),
    "constant displacement": (bent(displacement_um=lambda z: 0 * z - 2.5),
                              r"displacement_um is constant at -2\.5 um.*check"),
    "unrelated": (bent(displacement_um=lambda z: NOISE), r"unrelated.*correlation.*check"),
    "unrelated but smooth": (bent(displacement_um=lambda z: waves(12, 1.37, 4.11, 500)), r"unrelated.*check"),
    "only a ramp": (bent(command_V=lambda V: np.linspace(0, 90, 1500),
                         displacement_um=lambda z: np.linspace(0, 12, 1500) + 0.004 * NOISE),
                    r"command_V never changes direction.*rdpi excite"),
    "picometres": (bent(displacement_um=lambda z: 1e6 * z), r"displacement_um reaches 1\.2\d*e\+07; check its unit"),
    "microvolts": (bent(command_V=lambda V: 1e6 * V), r"command_V reaches 9e\+07; check its unit"),
    "offset too large for single precision": (bent(displacement_um=lambda z: z + 9e5),
                                              r"moves by 12\.\d um at 90000\d.*subtract"),
}


@pytest.mark.parametrize("case", REFUSED)
@pytest.mark.parametrize("held_out", [False, True])
def test_refused_recording(case: str, held_out: bool) -> None:
    run, message = REFUSED[case]
    with pytest.raises(BadInput, match=message) as refusal:
        fit([static_run(), *([] if held_out else [run])], STATIC, [run] if held_out else [])
    assert str(refusal.value).startswith("bad.csv: ")
    if not held_out:
        with pytest.raises(BadInput, match=r"^bad\.csv: "):
            fit([run], Options())


@pytest.mark.parametrize("change, message", [
    (dict(command_V=lambda V: V / 1000), r"bad\.csv moves 1\d\d um/V and run\.csv 0\.1\d+: .* same units.*check"),
    (dict(displacement_um=lambda z: z + 9),
     r"bad\.csv: lies 9(\.0\d*)? um from run\.csv at the same command; .*subtract"),
    (dict(displacement_um=lambda z: 12 - z), r"bad\.csv: moves opposite to run\.csv; .*sign"),
])
def test_runs_that_do_not_belong_together(change: dict[str, Callable], message: str) -> None:
    bad = replace(bent(**change), digest="sha256:bad")
    with pytest.raises(BadInput, match=message):
        fit([static_run(), bad], STATIC)
    assert fit([bad], STATIC).model


@pytest.mark.parametrize("run, note", [
    (bent(displacement_um=lambda z: np.minimum(z, 11.0)),
     r"^bad\.csv: \d+ samples stand at the very highest .*clipped"),
    (bent(displacement_um=lambda z: z + np.linspace(0, 4, len(z))),
     r"^bad\.csv: explained only to [3-9]\.?\d* % rms .*drift"),
    (static_run(visited((90.0, 0.0)), name="bad.csv"), r"^bad\.csv: marked memory: reset, but .*unknown"),
])
def test_doubtful_recordings_are_remarked_on(run: Recording, note: str) -> None:
    assert [text for text in fit([run], STATIC).warnings if re.search(note, text)]


def test_recordings_of_different_actuators_are_remarked_on() -> None:
    runs = [marked(run, actuator=run.path) for run in (static_run(name="a"), static_run(name="b"))]
    assert "the recordings name different actuators: a, b" in fit(runs, STATIC).warnings


@pytest.mark.parametrize("options, message", [
    (Options(operators=-1), "--operators -1"), (Options(operators=129), "--operators 129"),
    (Options(deadzones=-1), "--deadzones -1"), (Options(deadzones=7), "--deadzones 7"),
    (Options(min_slope_ratio=0.0), "--min-slope-ratio 0"), (Options(min_slope_ratio=1.0), "--min-slope-ratio 1"),
    (Options(min_slope_ratio=float("nan")), "--min-slope-ratio nan"),
    (Options(thresholds_um=(1.0, 1.0)), "--thresholds"), (Options(thresholds_um=(-1.0, 1.0)), "--thresholds"),
    (Options(thresholds_um=(2.0, 1.0)), "--thresholds"), (Options(thresholds_um=(1.0, float("nan"))), "--thresholds"),
    (Options(thresholds_um=(1.0, float("inf"))), "--thresholds"),
    (Options(rate_window_s=-1.0), "--rate-window -1"), (Options(rate_filter_s=-1.0), "--rate-filter -1"),
    (Options(rate_window_s=100.0), "window"),
])
def test_refused_options(options: Options, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        fit([static_run()], options)


def test_a_short_recording() -> None:
    """Sixteen samples, the fewest that a recording may have, are too few for ten slopes and enough for one."""
    run = static_run(cycles=1, rate_hz=16, noise_um=0.0)
    with pytest.raises(BadInput, match=r"^run\.csv: 16 samples .* for 13 unknowns; record longer"):
        fit([run], STATIC)
    result: Fit = fit([run], replace(STATIC, operators=1, deadzones=0))
    result.model.validate()
    assert result.scores[0].score.rms_percent < 2


def test_too_little_is_left_of_a_run_whose_memory_is_unknown() -> None:
    """Once the drive has erased what came before, it does not turn round any more."""
    command = np.r_[np.linspace(45, 0, 500), np.linspace(0, 90, 1000)]
    run = quasi_static(visited((90.0, 30.0, 45.0)), command, noise_um=NOISE_UM, memory="unknown", name="bad.csv")
    with pytest.raises(BadInput, match=r"^bad\.csv: .*memory"):
        fit([run], STATIC)
    assert fit([marked(run, memory="reset")], STATIC).model
