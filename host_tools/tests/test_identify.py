"""Identification against plants whose parameters are known (plants.py), without the command line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fitted import NOISE_UM, SPAN_V, STATIC, moving_runs, percent, static_fit, static_run
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import changed, marked, rate_of, recording, slopes_um_per_V, stack, thresholds_um, waves

from rdpi.errors import BadInput
from rdpi.identify import thresholds
from rdpi.identify.bands import rate_slopes
from rdpi.identify.identify import Options, fit
from rdpi.model import Drive


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


@pytest.mark.parametrize("noise_um, at_rest, at_top, rms", [
    pytest.param(0.0, 1, 2, 0.06, marks=pytest.mark.long), (0.004, 1, 2, 0.08),
    pytest.param(0.02, 2, 4, 0.22, marks=pytest.mark.long)])
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
    # After a turn the displacement's own rate is taken over a while: the faster, the more that misses.
    slow = result.scores if source == "control" else result.scores[:2]
    assert max(run.score.rms_percent for run in slow) < rms
    assert max(run.score.rms_percent for run in result.scores) < 1.0
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
        rows = [band.to_json() for band in bands.bands()]
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


@pytest.mark.parametrize(("limits", "told"), [({"max_V": 1000.0}, True), ({"min_V": 4.0}, True), ({"max_V": 82.0}, False)])
def test_drives_that_were_not_recorded(limits: dict[str, float], told: bool) -> None:
    warnings = fit([static_run(low=10, high=80)], replace(STATIC, **limits)).warnings
    assert any("only 10 to 80 V were recorded" in text for text in warnings) == told


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
        assert min(model.slopes.min(), model.slopes_at(top).min()) >= thresholds.SLOPE_FLOOR * (1 - 1e-9)
        assert min(model.slopes_at(model.rate.max_um_per_s) / model.slopes) >= model.rate.min_slope_ratio * (1 - 1e-9)


def test_the_floor_is_reported() -> None:
    """An actuator that stands still for 10 V after each reversal has slopes of 0, and no inverse."""
    slack = replace(stack(), slopes=np.where(stack().thresholds_V < 10, 0.0, 0.15))
    result = fit([static_run(slack)], STATIC)
    assert result.model.slopes[:3].min() == pytest.approx(thresholds.SLOPE_FLOOR)
    assert any("lower bound" in text and "--operators" in text for text in result.warnings)
    assert not any("lower bound" in text for text in static_fit().warnings)


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
        # one play alone leaves so much that creep would take a part of it, and of the reach
        thresholds = fit([run], replace(STATIC, operators=operators, effects="none")).model.thresholds_um
        reach = np.ptp(run.displacement_um) / 2
        assert thresholds == pytest.approx(np.arange(operators + 1) * reach / (operators + 1))


@pytest.mark.parametrize("deadzones", range(5))
@pytest.mark.parametrize("operators", [0, 1, 20])
def test_numbers(operators: int, deadzones: int) -> None:
    for options in (STATIC, Options()):  # a delay would take the place of plays
        result = fit([static_run()], replace(options, operators=operators, deadzones=deadzones, effects="none"))
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
