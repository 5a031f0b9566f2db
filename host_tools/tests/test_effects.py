"""Effects: each acts as its docstring says, on signals whose answer is known, alone and in the chain."""

from __future__ import annotations

import ast
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from injected import entry
from models import SEEDS, random_model
from plants import Plant, changed, marked, model_of, quasi_static, recording, stack, waves
from scipy.signal import lfilter

import rdpi as rdpi_package
from rdpi import firmware
from rdpi.data import Recording, read_recording, write_recording
from rdpi.errors import BadInput
from rdpi.gap.dataset import model_runs
from rdpi.model import Drive, Memory, Model, Rate, read_model, write_model
from rdpi.simulate import chain, effects
from rdpi.simulate.effects import CATALOGUE, Acting, Effect, Residuals, base

RATE_HZ = 1000.0
GAIN = 0.125  # um/V of `straight`
PLACES = [(name, stage) for name, kind in CATALOGUE.items() for stage in kind.stages]
# At these every effect does something to `moving`.
SIZES: dict[str, dict[str, float]] = {
    "input_curve": {"quadratic": 0.1, "cubic": 0.15, "low_V": 0.0, "high_V": 90.0},
    "quantisation": {"step": 0.5}, "delay": {"delay_s": 0.0034}, "slew_limit": {"V_per_s": 120.0},
    "lag": {"time_constant_s": 0.004}, "rail_saturation": {"V_min": 5.0, "V_max": 70.0},
    "initial_memory": {"position_um": 0.0}, "rate_dependence": {"widening": 0.3, "change": -0.1, "exponent": 0.7},
    "hysteresis_change": {"scale": 0.4, "shape": 0.3}, "creep": {"percent_per_decade": 2.0},
    "relaxation": {"share": 0.1, "time_constant_s": 0.02},
    "gain_change": {"factor": 1.04}, "backlash": {"width_um": 0.3}, "resonance": {"f0_hz": 60.0, "damping": 0.1},
    "cross_coupling": {"um_per_V": 0.1}, "thermal_drift": {"um_per_s": 0.0},
    "periodic_disturbance": {"frequency_hz": 50.0},
    "static_nonlinearity": {"linear": 0.01, "quadratic": 0.05, "cubic": -0.04}}


def straight(**changes: object) -> Model:
    """An actuator without hysteresis: GAIN um per volt from 0 V, 1 um off; 12.5 um over 100 V."""
    return Model(**{**dict(
        gain_um_per_V=GAIN, offset_V=0.0, offset_um=1.0, stroke_um=12.5, thresholds_um=np.zeros(1), slopes=np.ones(1),
        slope_rate_s_per_um=np.zeros(1), deadzones_um=np.zeros(1), deadzone_weights=np.ones(1),
        rate=Rate(max_um_per_s=1000.0), drive=Drive(0.0, 100.0), memory=Memory(0.0, np.zeros(1))), **changes})


def bent(**changes: object) -> Model:
    """plants.stack without rate law, of 0 to 90 V."""
    return model_of(stack(law=0), drive=Drive(0.0, 90.0), rate=Rate(max_um_per_s=1000.0, identified_um_per_s=400.0),
                    **changes)


def drive(command_V: np.ndarray, **columns: np.ndarray) -> Recording:
    return recording(command_V, None, RATE_HZ, **columns)


def moving() -> Recording:
    """A recording of the actuator that is `bent`, started elsewhere than it says, with another axis and a fast step."""
    plant = stack(law=0)
    plant.respond(np.array([0.0, 90.0, 30.0]), np.zeros(3))
    command = np.r_[30 - waves(30, 2, 0.5, RATE_HZ), waves(90, 4, 2.5, RATE_HZ), np.full(400, 40.0)]
    other = np.sin(np.arange(len(command)) / 40)
    return quasi_static(plant, command, RATE_HZ, noise_um=0.01, other_axis_V=other)


def shown(model: Model, run: Recording, *entries: dict) -> np.ndarray:
    """What simulate predicts with these effects."""
    return chain.simulate(replace(model, effects=list(entries)), [run])[0].predicted_um


def settled(run: Recording) -> Recording:
    """The same where no sweep came before."""
    return replace(run, metadata={**run.metadata, "memory": "unknown"})


def shape_of(run: Recording) -> np.ndarray:
    return run.time_s - run.time_s[0]


# --- signals in and out ----------------------------------------------------------------------------------------------

@pytest.mark.parametrize("stage", ["timing", "sensor"])
@pytest.mark.parametrize("delay_s", [0.0003, 0.004, 0.0255])
def test_delay_shifts_a_ramp(stage: str, delay_s: float) -> None:
    run = drive(np.linspace(0, 80, 401))  # 200 V/s
    expected = 1 + GAIN * 200 * np.maximum(shape_of(run) - delay_s, 0)
    assert shown(straight(), run, entry("delay", stage, delay_s=delay_s)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("stage", ["amplifier", "sensor"])
@pytest.mark.parametrize("lag_s", [1e-5, 0.004, 0.2])
def test_lag_of_a_ramp(stage: str, lag_s: float) -> None:
    """y' = (s t - y) / T from rest: y = s (t - T (1 - exp(-t / T)))."""
    run = drive(np.linspace(0, 80, 401))
    t = shape_of(run)
    expected = 1 + GAIN * 200 * (t - lag_s * (1 - np.exp(-t / lag_s)))
    assert shown(straight(), run, entry("lag", stage, time_constant_s=lag_s)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("hertz", [2, 10, 40])
def test_lag_of_a_sine(hertz: float) -> None:
    t = np.arange(2000) / RATE_HZ
    found = shown(straight(), drive(50 + 40 * np.sin(2 * np.pi * hertz * t)), entry("lag", time_constant_s=0.01))
    response = 1 / (1 + 2j * np.pi * hertz * 0.01)
    expected = 1 + GAIN * (50 + 40 * np.imag(response * np.exp(2j * np.pi * hertz * t)))
    assert found[1000:] == pytest.approx(expected[1000:], abs=0.006 * GAIN * 40)  # chords of 25 samples a period


def test_slew_limit_of_a_step() -> None:
    command = np.r_[np.full(20, 10.0), np.full(200, 60.0)]
    found = shown(straight(), drive(command), entry("slew_limit", V_per_s=1000.0))
    expected = 1 + GAIN * np.minimum(60, 10 + np.maximum(np.arange(220) - 19, 0))
    assert found == pytest.approx(expected, abs=1e-9)


@given(SEEDS, st.floats(0.01, 3.0))
def test_slew_limit_follows_one_sample_after_the_other(seed: int, limit: float) -> None:
    signal = np.cumsum(np.random.default_rng(seed).standard_normal(200)) * (np.arange(200) % 50 < 25)
    values = {"V_per_s": limit * RATE_HZ}
    found = CATALOGUE["slew_limit"]().drive(signal, drive(signal), values, straight())
    expected = [signal[0]]
    for wanted in signal[1:]:
        expected.append(min(max(wanted, expected[-1] - limit), expected[-1] + limit))
    assert found == pytest.approx(np.array(expected), abs=1e-9)


def test_rails() -> None:
    command = waves(100, 3, 2, RATE_HZ)
    found = shown(straight(), drive(command), entry("rail_saturation", V_min=12.0, V_max=81.0))
    assert found == pytest.approx(1 + GAIN * np.clip(command, 12, 81))
    assert shown(straight(), drive(command), entry("rail_saturation", V_max=81.0)) == pytest.approx(
        1 + GAIN * np.minimum(command, 81))


def test_a_dac_of_few_bits() -> None:
    command = waves(100, 3, 2, RATE_HZ)
    found = (shown(straight(), drive(command), entry("quantisation", "DAC", step=0.7, origin=0.2)) - 1) / GAIN
    codes = (found - 0.2) / 0.7
    assert codes == pytest.approx(np.round(codes), abs=1e-9)
    assert np.abs(found - command).max() == pytest.approx(0.35, rel=0.01)


def test_a_coarse_sensor() -> None:
    found = shown(straight(), drive(waves(100, 3, 2, RATE_HZ)), entry("quantisation", "sensor", step=0.3))
    assert found / 0.3 == pytest.approx(np.round(found / 0.3), abs=1e-9)
    assert np.abs(found - shown(straight(), drive(waves(100, 3, 2, RATE_HZ)))).max() == pytest.approx(0.15, rel=0.01)


@pytest.mark.parametrize("dither", [0.06, 0.1, 0.2, 0.45])
def test_a_blurred_staircase_is_the_mean_of_rounded_values(dither: float) -> None:
    """The mean of round(x + s n), n normal, is a sum of steps at the half-integers by the normal distribution."""
    x = np.linspace(-2, 2, 201)
    steps = np.arange(-8, 8) + 0.5
    normal = np.vectorize(math.erf)((x[:, None] - steps) / (dither * math.sqrt(2))) / 2 + 0.5
    expected = 0.3 * (np.sum(normal, axis=1) - 8)
    found = CATALOGUE["quantisation"]().displacement(0.3 * x, drive(x), {"step": 0.3, "dither": 0.3 * dither},
                                                     straight())
    assert found == pytest.approx(expected, abs=1e-3 * 0.3)


def test_gain() -> None:
    run = drive(waves(100, 3, 2, RATE_HZ))
    assert shown(straight(), run, entry("gain_change", factor=0.9)) == pytest.approx(
        1 + 0.9 * GAIN * run.command_V)


@pytest.mark.parametrize("stage", ["sensor", "actuator"])
def test_static_curve(stage: str) -> None:
    run = drive(waves(100, 3, 2, RATE_HZ))
    p = run.command_V / 50 - 1
    found = shown(straight(), run, entry("static_nonlinearity", stage, linear=0.02, quadratic=-0.1, cubic=0.05))
    assert found == pytest.approx(1 + GAIN * run.command_V + 6.25 * (0.02 * p - 0.1 * p**2 + 0.05 * p**3))


def test_backlash() -> None:
    """Half the width behind the input on either branch; what moves less than the width does nothing."""
    up, down = np.linspace(30, 90, 301), np.linspace(90, 10, 401)
    found = (shown(straight(), drive(np.r_[up, down]), entry("backlash", width_um=0.4)) - 1) / GAIN
    half = 0.2 / GAIN
    assert found[:301] == pytest.approx(np.maximum(30, up - half))
    assert found[301:] == pytest.approx(np.minimum(90 - half, down + half))
    shaken = drive(50 + 0.99 * half * np.sin(np.arange(400) / 20))
    assert np.ptp(shown(straight(), shaken, entry("backlash", width_um=0.4))) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("damping", [0.02, 0.2, 0.9])
@pytest.mark.parametrize("hertz", [5.0, 20.0, 35.0])
def test_resonance_of_a_sine(damping: float, hertz: float) -> None:
    """1 / (1 - (f / f0)^2 + 2 i damping f / f0) about the mean, f0 = 20 Hz, once the ringing is over."""
    t = np.arange(8000) / RATE_HZ
    found = shown(straight(), drive(50 + 10 * np.sin(2 * np.pi * hertz * t)),
                  entry("resonance", f0_hz=20.0, damping=damping))
    response = 1 / (1 - (hertz / 20) ** 2 + 2j * damping * hertz / 20)
    expected = 1 + GAIN * (50 + 10 * np.imag(response * np.exp(2j * np.pi * hertz * t)))
    assert found[6000:] == pytest.approx(expected[6000:], abs=0.01 * GAIN * 10 * max(1, abs(response)))


def test_resonance_has_unit_gain_at_rest() -> None:
    command = np.r_[np.full(10, 20.0), np.full(3000, 60.0)]
    found = (shown(straight(), drive(command), entry("resonance", f0_hz=80.0, damping=0.1)) - 1) / GAIN
    assert found[:10] == pytest.approx(20) and found[-100:] == pytest.approx(60, abs=1e-6)
    overshoot = math.exp(-math.pi * 0.1 / math.sqrt(1 - 0.01))  # of a step
    assert found.max() == pytest.approx(60 + 40 * overshoot, rel=0.01)


@pytest.mark.parametrize(("quadratic", "cubic"), [(0.2, 0.0), (0.0, 0.15), (-0.3, 0.25), (0.1, -0.4)])
def test_input_curve(quadratic: float, cubic: float) -> None:
    """The ends stay, the polynomial lies between them, and outside it goes straight on."""
    u = np.linspace(-0.3, 1.4, 171)
    found = (shown(straight(), drive(20 + 50 * u),
                   entry("input_curve", quadratic=quadratic, cubic=cubic, low_V=20.0, high_V=70.0)) - 1) / GAIN
    curve = np.polynomial.Polynomial([0, 1 + quadratic + cubic, -quadratic - 3 * cubic, 2 * cubic])
    slopes = curve.deriv()(np.array([0.0, 1.0]))
    expected = np.where(u < 0, slopes[0] * u, np.where(u > 1, 1 + slopes[1] * (u - 1), curve(u)))
    assert found == pytest.approx(20 + 50 * expected, abs=1e-9)
    assert curve(np.array([0.0, 1.0])) == pytest.approx([0, 1], abs=1e-12)
    assert np.all(np.diff(found) > 0)


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_an_input_curve_that_hardly_rises_is_refused(quadratic: float, cubic: float) -> None:
    values = {"quadratic": quadratic, "cubic": cubic, "low_V": 20.0, "high_V": 70.0}
    u = np.linspace(0, 1, 4001)
    least = np.min(1 + quadratic * (1 - 2 * u) + cubic * (1 - 6 * u + 6 * u**2))
    assume(abs(least - 0.1) > 1e-5)
    assert (CATALOGUE["input_curve"].refusal(values) is None) == (least > 0.1)


def test_an_input_curve_acts_behind_the_amplifier_on_what_a_monitor_shows() -> None:
    """It drives the plays whether the command or monitor_V drives the actuator, and the monitor does not show it."""
    run = drive(waves(90, 4, 2, RATE_HZ))
    curve, rails = entry("input_curve", **SIZES["input_curve"]), entry("rail_saturation", V_max=60.0)
    clipped = changed(run, command_V=np.minimum(run.command_V, 60))
    assert shown(bent(), run, curve, rails) == pytest.approx(shown(bent(), clipped, curve), abs=1e-12)
    measured = changed(run, monitor_V=clipped.command_V, displacement_um=shown(bent(), clipped, curve))
    model = replace(bent(), effects=[curve, rails])
    (one,) = model_runs(model, [measured], monitored=True)
    acting = effects.acting(model)
    assert one.predict(acting) == pytest.approx(measured.displacement_um, abs=1e-9)
    assert one.predict_monitor(acting) == pytest.approx(one.um_per_V * clipped.command_V, abs=1e-9)


def test_another_drive_range_leaves_an_input_curve() -> None:
    run, curve = drive(waves(90, 4, 2, RATE_HZ)), entry("input_curve", **SIZES["input_curve"])
    wider = replace(bent(), drive=Drive(-20.0, 120.0))
    assert np.array_equal(shown(wider, run, curve), shown(bent(), run, curve))


def test_cross_coupling() -> None:
    other = np.sin(np.arange(500) / 30)
    run = drive(waves(100, 4, 2, RATE_HZ), other_axis_V=other, third_V=-2 * other)
    plain = shown(straight(), run)
    assert shown(straight(), run, entry("cross_coupling", um_per_V=0.3)) == pytest.approx(plain + 0.3 * other)
    third = {**entry("cross_coupling", um_per_V=0.3), "column": "third_V"}
    assert shown(straight(), run, third) == pytest.approx(plain - 0.6 * other)
    assert np.array_equal(shown(straight(), run, {**third, "column": "fourth_V"}), plain)


# --- creep -----------------------------------------------------------------------------------------------------------

def test_predictions_that_are_kept_know_their_covariate() -> None:
    """Two axes couple alike: without the one, the other's part is asked for."""
    run = drive(np.zeros(4), a_V=np.arange(4.0), b_V=-np.arange(4.0))
    one, other = (Acting(CATALOGUE["cross_coupling"](column=column), {"um_per_V": 0.05}) for column in ("a_V", "b_V"))
    z, model, kept = np.zeros(4), straight(), effects.Displaced()
    assert kept([one, other], z, run, model) == pytest.approx(np.zeros(4))
    assert kept([other], z, run, model) == pytest.approx(-0.05 * np.arange(4))


@pytest.mark.parametrize("percent", [-1.0, 0.5, 3.0])
def test_creep_is_so_many_percent_of_a_step_for_every_decade(percent: float) -> None:
    command = np.r_[np.full(20, 20.0), np.full(20_000, 60.0)]
    run = settled(recording(command, None, 100.0))
    found = shown(straight(), run, entry("creep", percent_per_decade=percent))
    since = np.array([1, 3, 10, 30, 100])  # s
    crept = found[20 + 100 * since] - (1 + GAIN * 60)
    per_decade = np.polyfit(np.log10(since), crept, 1)[0]
    assert per_decade == pytest.approx(percent / 100 * GAIN * 40, rel=0.03)
    assert crept == pytest.approx(np.polyval(np.polyfit(np.log10(since), crept, 1), np.log10(since)),
                                  abs=0.05 * abs(per_decade))


@pytest.mark.parametrize("share", [-0.2, 0.05, 0.5])
@pytest.mark.parametrize("time_s", [1e-4, 0.004, 1.0])
def test_relaxation_of_a_ramp(share: float, time_s: float) -> None:
    """A share of it lags, y = s (t - T (1 - exp(-t / T))); the rest does not."""
    run = settled(drive(np.linspace(0, 80, 401)))  # 200 V/s
    t = shape_of(run)
    expected = 1 + GAIN * 200 * (t - share * time_s * (1 - np.exp(-t / time_s)))
    found = shown(straight(), run, entry("relaxation", share=share, time_constant_s=time_s))
    assert found == pytest.approx(expected, abs=1e-9)


def test_relaxation_of_a_step() -> None:
    """The most of it at once, the share with its time constant."""
    run = drive(np.r_[np.full(20, 20.0), np.full(400, 60.0)])
    found = shown(straight(), run, entry("relaxation", share=0.1, time_constant_s=0.05)) - (1 + GAIN * 20)
    t = (np.arange(400) + 0.5) / RATE_HZ  # the step lasts one sample
    assert found[20:] == pytest.approx(GAIN * 40 * (1 - 0.1 * np.exp(-t / 0.05)), abs=1e-4 * GAIN * 40)


def test_relaxation_is_looked_for_at_its_time_constant() -> None:
    late = shown(bent(), SHORT, entry("relaxation", share=0.08, time_constant_s=0.012)) - shown(bent(), SHORT)
    run = changed(SHORT, displacement_um=SHORT.displacement_um + late)
    starts = CATALOGUE["relaxation"]().starts(residuals_of(run))
    times = np.array([values["time_constant_s"] for values in starts])
    assert times == pytest.approx(0.012, rel=1.2) and np.all(np.diff(np.log10(times)) < 0.34)
    nearest = starts[int(np.argmin(np.abs(np.log(times / 0.012))))]
    assert nearest["share"] == pytest.approx(0.08, rel=0.3)


def test_creep_is_linear_and_rests_at_rest() -> None:
    at_rest = settled(drive(np.full(3000, 40.0)))
    assert shown(straight(), at_rest, entry("creep", percent_per_decade=5.0)) == pytest.approx(1 + GAIN * 40, abs=1e-12)
    run = drive(waves(80, 1, 3, RATE_HZ))
    plain = shown(straight(), run)
    once, thrice = (shown(straight(), run, entry("creep", percent_per_decade=percent)) - plain for percent in (1, 3))
    assert np.ptp(once) > 0.01 and thrice == pytest.approx(3 * once, abs=1e-10)


# --- the operator ----------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("scale", [-0.6, 0.3, 0.9])
@pytest.mark.parametrize("shape", [-0.3, 0.0, 0.3])
def test_hysteresis_change_is_that_of_the_plays_weights(scale: float, shape: float) -> None:
    """The same stroke with other weights, against plays written out; without dead zones, so that all is linear."""
    plant = replace(stack(law=0), deadzones_um=np.zeros(1), weights=np.ones(1))
    r = plant.thresholds_V
    weights = np.diff(plant.slopes, prepend=0.0)
    factors = 1 + scale + shape * (2 * r / r[-1] - 1)
    other = np.r_[plant.slopes[-1] - weights[1:] @ factors[1:], weights[1:] * factors[1:]]
    command = np.r_[waves(90, 1, 1.5, RATE_HZ), 90 - waves(60, 1, 1.5, RATE_HZ)]
    truth = replace(plant, slopes=np.cumsum(other)).respond(command, np.zeros(len(command)))
    before = plant.respond(command, np.zeros(len(command)))
    loop = slice(500, 1500)  # from one end to the other and back
    truth *= np.ptp(before[loop]) / np.ptp(truth[loop])
    model = model_of(plant, drive=Drive(0.0, 90.0))
    found = shown(model, drive(command), entry("hysteresis_change", scale=scale, shape=shape))
    assert found == pytest.approx(truth, abs=1e-9)
    assert np.ptp(found - before) > 0.02


@pytest.mark.parametrize("inverted", [False, True])
def test_rate_dependence_widens_the_loops_at_the_top_rate(inverted: bool) -> None:
    """z goes at a constant rate while the command lies such that h is +/- 0.5 um."""
    plant = stack(law=0, inverted=inverted, offset_V=90.0 if inverted else 0.0)
    model = model_of(plant, drive=Drive(0.0, 90.0), rate=Rate(max_um_per_s=1000.0, identified_um_per_s=400.0),
                     offset_um=2.0)
    rest = replace(model, memory=Memory(float(model.x_of(0.0)), np.full(10, float(model.x_of(0.0)))))
    ends = np.r_[np.linspace(0, 90, 50), np.linspace(90, 0, 50), np.linspace(0, 90, 50)]
    loop = chain.simulate(rest, [drive(ends)], "model")[0].predicted_um
    low, high = loop[99], loop[49]
    z = np.r_[np.arange(2.5, 12.0, 0.1), np.arange(12.0, 2.5, -0.1)]
    h = np.where(np.arange(len(z)) < 95, -0.5, 0.5)
    command = np.interp((z - h - low) / (high - low), [-1, 2], [-90, 180])
    for rate_um_per_s, exponent in ((400.0, 1.0), (200.0, 1.0), (100.0, 0.5)):
        run = recording(command, None, rate_um_per_s / 0.1)
        values = {"widening": 0.3, "change": -0.1, "exponent": exponent}
        found = CATALOGUE["rate_dependence"]().displacement(z, run, values, model)
        share = (rate_um_per_s / 400) ** exponent
        expected = z + share * (0.3 * h - 0.1 * (z - (low + high) / 2))
        inside = np.r_[2:94, 97:189]
        assert found[inside] == pytest.approx(expected[inside], abs=1e-6)


def test_rate_dependence_leaves_slow_loops() -> None:
    command = waves(90, 0.2, 1.5, RATE_HZ)
    slow, fast = recording(command, None, 100.0), recording(command, None, 50_000.0)
    extra = [np.abs(shown(bent(), run, entry("rate_dependence", widening=0.5)) - shown(bent(), run)).max()
             for run in (slow, fast)]
    assert extra[0] < 0.01 * extra[1] and extra[1] > 0.1


# --- what every recording has of its own -----------------------------------------------------------------------------

def test_drift_is_estimated_in_every_recording() -> None:
    model = replace(bent(), effects=[entry("thermal_drift", um_per_s=77.0)])
    runs = [moving(), moving()]
    z = shown(bent(), runs[0])
    t = shape_of(runs[0])
    degrees = 20 + np.sin(t)
    runs = [changed(runs[0], displacement_um=z + 0.2 - 0.3 * t),
            changed(runs[1], displacement_um=z - 0.1 + 0.7 * degrees, temperature_degC=degrees)]
    warm = {**entry("thermal_drift", um_per_degC=77.0), "column": "temperature_degC"}
    for run, with_drift in zip(runs, (model, replace(bent(), effects=[warm]))):
        assert chain.simulate(with_drift, [run])[0].predicted_um == pytest.approx(run.displacement_um, abs=1e-9)
    alone = drive(runs[0].command_V)
    assert np.array_equal(shown(model, alone), shown(bent(), alone))


def test_hum_is_estimated_in_every_recording_and_the_zero_stays() -> None:
    model = replace(bent(), effects=[entry("periodic_disturbance", frequency_hz=37.0)])
    z = shown(bent(), moving())
    t = shape_of(moving())
    runs = [changed(moving(), displacement_um=z + 0.25 + size * np.sin(2 * np.pi * 37 * t + phase))
            for size, phase in ((0.1, 0.3), (0.4, 2.0))]
    for run, found in zip(runs, chain.simulate(model, runs)):
        assert found.predicted_um == pytest.approx(run.displacement_um - 0.25, abs=1e-9)


@pytest.mark.parametrize("frequency_hz", [1e-3, 0.1])
def test_a_part_of_a_slow_hum_moves_no_prediction_away(frequency_hz: float) -> None:
    model = replace(bent(), effects=[entry("periodic_disturbance", frequency_hz=frequency_hz)])
    z = shown(bent(), moving())
    run = changed(moving(), displacement_um=z + 0.25 + 0.01 * np.random.default_rng(1).standard_normal(len(z)))
    (found,) = chain.simulate(model, [run])
    assert np.max(np.abs(found.predicted_um - z)) < 0.05


@pytest.mark.parametrize("sample_time_s", [1e-5, 1e-3, 0.5])
@pytest.mark.parametrize("samples", [1, 2, 31, 32, 33, 64, 65, 1000])
def test_many_lags_at_once_are_the_sum_of_each(samples: int, sample_time_s: float) -> None:
    times_s, away = (0.03, 0.1, 10.0, 1000.0), (2.0, -0.5, 0.7, 3.0)
    signal = 3 + np.cumsum(np.random.default_rng(samples).standard_normal(samples))
    found = firmware.lags(signal, sample_time_s, times_s, away)
    assert found[0] == pytest.approx(sum(away))
    # scipy's filter of y_k = a y_(k-1) + (1 - g) u_k + (g - a) u_(k-1)
    each = []
    for time_s, one in zip(times_s, away):
        ratio = sample_time_s / time_s
        a, g = np.exp(-ratio), -np.expm1(-ratio) / ratio
        each.append(signal[0] + lfilter([1 - g, g - a], [1, -a], signal - signal[0], zi=[one])[0])
    assert len(times_s) * signal + found == pytest.approx(sum(each), rel=1e-10)


def test_initial_memory_is_sought_whatever_the_recording_says() -> None:
    run = moving()
    assert run.memory == "reset"
    plain, with_it = (chain.simulate(replace(bent(), effects=entries), [run])[0]
                      for entries in ([], [entry("initial_memory", position_um=0.0)]))
    assert plain.memory == "reset" and with_it.memory == "estimated"
    rms = [np.sqrt(np.mean((one.predicted_um - run.displacement_um) ** 2)) for one in (plain, with_it)]
    assert rms[0] > 0.03 and rms[1] < 0.0125  # noise is 0.01


def test_a_drive_alone_starts_as_its_metadata_say() -> None:
    """Nothing can be sought in it."""
    run = drive(waves(90, 4, 2, RATE_HZ, 20.0))
    found = chain.simulate(replace(bent(), effects=[entry("initial_memory", position_um=0.0)]), [run])[0]
    assert found.memory == "reset" and np.array_equal(found.predicted_um, shown(bent(), run))


# --- all of them -----------------------------------------------------------------------------------------------------

@pytest.mark.parametrize(("name", "stage"), PLACES)
def test_every_effect_has_a_size_at_which_it_does_nothing(name: str, stage: str) -> None:
    run = marked(moving(), memory="unknown")  # of which the memory is sought anyway
    effect = CATALOGUE[name](stage)
    run = changed(run, displacement_um=shown(bent(), run) + 0.2 * (name != "thermal_drift"))  # drift moves the zero too
    plain = shown(bent(), run)
    with pytest.raises(BadInput, match="in its parameters"):  # left out they would silently be this size
        shown(bent(), run, entry(name, stage))
    assert shown(bent(), run, entry(name, stage, **effect.absent())) == pytest.approx(
        plain, abs=1e-3 if effect.disturbance else 1e-9)  # the start is sought beside a drift
    assert np.abs(shown(bent(), moving(), entry(name, stage, **SIZES[name])) - shown(bent(), moving())).max() > 2e-3


@pytest.mark.parametrize("name", CATALOGUE)
@settings(max_examples=30)
@given(st.data())
def test_predictions_are_finite_within_the_bounds(name: str, data: st.DataObject) -> None:
    """Over the bounds, or where there are none, over what a file might say of an actuator of 12 um and 90 V."""
    kind = CATALOGUE[name]
    stage = data.draw(st.sampled_from(kind.stages))
    values = {parameter.name: data.draw(st.floats(max(parameter.low, -1e4), min(parameter.high, 1e4)) |
                                        st.sampled_from([max(parameter.low, -1e4), min(parameter.high, 1e4)]),
                                        label=parameter.name) for parameter in kind.parameters}
    absent = kind(stage).absent()
    for _ in range(6):  # most of what is refused lies far from what does nothing
        if kind.refusal(values) is not None:
            values = {parameter: (value + absent[parameter]) / 2 for parameter, value in values.items()}
    assume(kind.refusal(values) is None)
    model = random_model(data.draw(SEEDS, label="model"))
    reach = model.drive.max_V - model.drive.min_V
    run = drive(np.r_[waves(model.drive.max_V, 5, 1, RATE_HZ, model.drive.min_V), np.full(20, model.drive.min_V),
                      model.drive.min_V + reach * (np.arange(20) % 2)], other_axis_V=np.linspace(0, 1, 240))
    effect = kind(stage)
    acting = [Acting(effect, values)]
    command = effects.driven(acting, run.command_V, run, model)
    changed_model = effects.operator(acting, model)
    assert np.all(np.isfinite(command)) and command.shape == run.command_V.shape
    assert np.all(np.isfinite(changed_model.slopes)) and np.all(changed_model.slopes > 0)
    z = model.gain_um_per_V * run.command_V
    shown_um = effects.displaced(acting, z, run, model)
    assert np.all(np.isfinite(shown_um)) and shown_um.shape == z.shape
    if effect.disturbance:
        assert np.all(np.isfinite(effect.columns(run, values, model)))


@pytest.mark.parametrize(("name", "stage"), [place for place in PLACES if not CATALOGUE[place[0]].disturbance])
def test_simulate_of_a_model_with_an_effect_is_the_effect_applied_by_hand(name: str, stage: str) -> None:
    model, run = bent(), moving()
    effect, values = CATALOGUE[name](stage), {**CATALOGUE[name]().absent(), **SIZES[name]}
    command = effect.drive(run.command_V, run, values, model)
    driven = changed(run, command_V=command)
    z = shown(effect.operator(model, values), driven)
    assert shown(model, run, entry(name, stage, **SIZES[name])) == pytest.approx(
        effect.displacement(z, driven, values, model), abs=1e-9)


def test_every_effect_says_what_a_person_needs_to_know() -> None:
    for name, kind in CATALOGUE.items():
        assert kind.name == name and all((kind.title, kind.what, kind.remedy, kind.needs))
        assert kind.stages and set(kind.stages) <= set(effects.STAGES)
        assert 1 <= len([one for one in kind.parameters if not one.internal]) <= 3
        assert all(one.low <= one.absent <= one.high and one.unit for one in kind.parameters)
        with pytest.raises(ValueError, match=f"{name} does not act at nowhere"):
            kind("nowhere")


def test_a_parameters_name_means_one_thing() -> None:
    for kind in CATALOGUE.values():
        for one in kind.parameters:
            other = effects.PARAMETERS[one.name]
            assert (one.unit, one.internal, one.digits, one.joined) == (
                other.unit, other.internal, other.digits, other.joined)


def test_comparisons_with_others_are_sound() -> None:
    for kind in CATALOGUE.values():
        assert kind.contains is None or kind.contains in CATALOGUE.values() and kind.contains.contains is None
        assert kind.frequency is None or kind.frequency in {one.name for one in kind.parameters}
        assert len(kind.chance_gain) == 2 and all(0 <= gain < 1 for gain in kind.chance_gain)
        assert kind.article in ("", "an" if kind.title[0] in "aeiou" else "a")


# --- an effect is one file -------------------------------------------------------------------------------------------

PACKAGE = Path(rdpi_package.__file__).parent
EFFECTS = PACKAGE / "simulate" / "effects"


def asked_by_name(source: str) -> set[str]:
    """Effects that a module asks for: in a string, by an attribute, a class, or anywhere by a name of two words."""
    classes = {kind.__name__: name for name, kind in CATALOGUE.items()}
    found = {name for name in CATALOGUE if "_" in name and re.search(rf"\b{name}\b", source)}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value} & set(CATALOGUE)
        for word in (getattr(node, "attr", None), getattr(node, "id", None), getattr(node, "name", None)):
            found |= {classes[word]} if word in classes else set()
        if isinstance(node, ast.Attribute) or isinstance(node, ast.alias):
            found |= {getattr(node, "attr", getattr(node, "name", None))} & set(CATALOGUE)
    return found


@pytest.mark.parametrize("path", [path for path in sorted(PACKAGE.rglob("*.py")) if EFFECTS not in path.parents],
                         ids=lambda path: str(path.relative_to(PACKAGE)))
def test_nothing_outside_its_file_asks_for_an_effect_by_name(path: Path) -> None:
    assert not asked_by_name(path.read_text("utf-8"))


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_is_one_file_and_its_registration(name: str) -> None:
    others = {path.stem: path.read_text("utf-8") for path in EFFECTS.glob("*.py") if path.stem != name}
    containing = {kind.name for kind in CATALOGUE.values() if kind.contains is CATALOGUE[name]}
    asking = {stem for stem, source in others.items() if name in asked_by_name(source)}
    assert (EFFECTS / f"{name}.py").exists() and asking == {"__init__"} | containing


@pytest.mark.parametrize(("source", "found"), [
    ('if one.name == "delay": pass', {"delay"}), ("x = effects.delay", {"delay"}), ("x: Delay", {"delay"}),
    ("from .effects.lag import Lag", {"lag"}), ("# unlike gain_change", {"gain_change"}),
    ('"""A delay, with creep."""\nlag = 1', set()), ("GainChange()", {"gain_change"})])
def test_what_asking_by_name_is(source: str, found: set[str]) -> None:
    assert asked_by_name(source) == found


# --- several ---------------------------------------------------------------------------------------------------------

@given(st.permutations([("gain_change", None), ("static_nonlinearity", "sensor"), ("quantisation", "DAC"),
                        ("backlash", None), ("lag", "amplifier"), ("delay", "timing"), ("creep", None),
                        ("input_curve", None)]))
@settings(max_examples=10)
def test_effects_act_along_the_chain_in_whatever_order_the_file_lists_them(order: list[tuple[str, str | None]]) -> None:
    run = drive(np.r_[waves(90, 4, 1, RATE_HZ), np.full(50, 40.0)])
    found = effects.acting(replace(bent(), effects=[entry(name, stage, **SIZES[name]) for name, stage in order]))
    assert [one.effect.name for one in found] == ["quantisation", "delay", "lag", "input_curve", "creep",
                                                  "gain_change", "backlash", "static_nonlinearity"]
    entries = [entry(name, stage, **SIZES[name]) for name, stage in order]
    assert np.array_equal(shown(bent(), run, *entries), shown(bent(), run, *entries[::-1]))


def test_the_last_thing_in_a_sensor_is_its_converter() -> None:
    run = drive(waves(90, 4, 2, RATE_HZ))
    entries = [entry("quantisation", "sensor", step=0.2), *(
        entry(name, "sensor", **SIZES[name]) for name in ("lag", "delay", "static_nonlinearity"))]
    found = shown(bent(), run, *entries) / 0.2
    assert found == pytest.approx(np.round(found), abs=1e-9)


def test_a_model_with_both_an_operators_effect_and_a_drives() -> None:
    run = drive(waves(90, 4, 2, RATE_HZ))
    both = shown(bent(), run, entry("hysteresis_change", scale=0.5), entry("rail_saturation", V_max=60.0))
    clipped = changed(run, command_V=np.minimum(run.command_V, 60))
    assert both == pytest.approx(shown(bent(), clipped, entry("hysteresis_change", scale=0.5)), abs=1e-12)


# --- the model file --------------------------------------------------------------------------------------------------

@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    run = moving()
    write_recording("run.csv", run.columns, run.metadata)
    return tmp_path


def test_effects_go_through_the_file(folder: Path) -> None:
    units = {(name, stage, one.name): effects.CATALOGUE[name](stage).unit(one) for name, stage in PLACES
             for one in effects.CATALOGUE[name].parameters}
    entries = [{**entry(name, stage, **{
        key: {"value": value, "ci95": None, "unit": units[name, stage, key]} if value else value
        for key, value in SIZES[name].items()}), "note": "kept"}
               for name, stage in PLACES]
    model = replace(bent(), effects=entries)
    write_model("model.json", model)
    again = read_model("model.json")
    assert again.effects == entries
    for before, after in zip(effects.acting(model), effects.acting(again)):
        assert before.values == after.values and repr(before.effect) == repr(after.effect)
    values = {one.effect.name: one.values for one in effects.acting(again)}
    assert all(values[name][key] == value for name, size in SIZES.items() for key, value in size.items())


def test_an_effect_without_limit_is_null_in_the_file(folder: Path) -> None:
    write_model("model.json", replace(bent(), effects=[entry("rail_saturation", V_min=None, V_max={"value": 60})]))
    (one,) = effects.acting(read_model("model.json"))
    assert one.values == {"V_min": -np.inf, "V_max": 60.0}


@pytest.mark.parametrize("name", ["delay", "creep", "hysteresis_change", "static_nonlinearity"])
def test_rdpi_simulate_includes_effects(folder: Path, rdpi: Callable, name: str) -> None:
    model = replace(bent(), effects=[entry(name, **SIZES[name])])
    write_model("model.json", model)
    done = rdpi("simulate", "model.json", "run.csv", "-o", "out.csv")
    assert done.exit_code == 0, done.output
    run = read_recording("run.csv")
    found = read_recording("out.csv", required=("predicted_um",)).columns["predicted_um"]
    assert found == pytest.approx(shown(model, run, *model.effects), abs=1e-9)
    assert np.abs(found - shown(bent(), run)).max() > 0.01


BAD_EFFECTS: dict[str, tuple[object, str]] = {
    "no effect": ({"name": "magic"}, r'effects\[0\] is "magic", which this version cannot simulate; it knows .*delay'),
    "no name": ({"stage": "timing"}, r"effects\[0\] is null"),
    "no object": ("delay", r'effects\[0\] is "delay", which this version cannot simulate'),
    "a list for a name": ({"name": ["delay"]}, r"effects\[0\] is "),
    "another stage": (entry("delay", "mechanics", delay_s=0.1),
                      r'effects\[0\] \(delay\): stage is "mechanics"; must be one of timing, sensor'),
    "a number for a stage": ({**entry("delay"), "stage": 3}, r"stage is 3; must be one of timing, sensor"),
    "a list for a stage": ({**entry("delay"), "stage": []}, r"stage is \[\]; must be one of timing, sensor"),
    "parameters no object": ({"name": "delay", "parameters": [0.1]}, r"\(delay\): parameters must be an object"),
    "too large": (entry("delay", delay_s=2.0), r"\(delay\): delay_s is 2.0; must be a number, 0 to 1 s"),
    "too small": (entry("delay", delay_s=-0.1), r"delay_s is -0.1; must be a number, 0 to 1 s"),
    "text": (entry("gain_change", factor="1.1"), r'factor is "1.1"; must be a number, 0.05 to 20$'),
    "true": (entry("gain_change", factor=True), r"factor is true; must be a number"),
    "a list": (entry("gain_change", factor=[1.1]), r"factor is \[1.1\]; must be a number"),
    "text as value": (entry("gain_change", factor={"value": "1.1"}), r'factor is "1.1"; must be a number'),
    "an object without a value": (entry("delay", delay_s={"valu": 0.1}), r"\(delay\): delay_s has no value; give it"),
    "a misspelt parameter": (entry("delay", dely_s=0.5), r'\(delay\): no delay_s in its parameters, but "dely_s"; they '
                             r"are delay_s \(s\)"),
    "one of several misspelt": (entry("rail_saturation", V_min=0.0, Vmax=60.0),
                                r'no V_max in its parameters, but "Vmax"; they are V_min \(V\), V_max \(V\)'),
    "a parameter beside the others": ({"name": "quantisation", "stage": "DAC", "step": 20},
                                      r"no step and no origin and no dither in its parameters, "
                                      r'but "step" beside them; they are step \(um or V\)'),
    "no parameters": ({"name": "creep"}, r"no percent_per_decade in its parameters; they are percent_per_decade \(%\)"),
    "parameters empty": (entry("lag"), r"no time_constant_s in its parameters; they are"),
    "an input curve that turns": (entry("input_curve", quadratic=0.8, cubic=-0.4, low_V=0.0, high_V=90.0),
                                  r"\(input_curve\): the least slope of the curve is -0.2 of its mean slope; must be"),
    "an input curve without range": (entry("input_curve", quadratic=0.1, cubic=0.0),
                                     r"low_V is 0 and high_V 0; the range must have a length"),
    "rails that cross": (entry("rail_saturation", V_min=60.0, V_max=20.0), r"\(rail_saturation\): V_min"),
}


@pytest.mark.parametrize("case", BAD_EFFECTS)
def test_malformed_effects(folder: Path, rdpi: Callable, case: str) -> None:
    bad, expected = BAD_EFFECTS[case]
    write_model("model.json", bent())
    document = json.loads(Path("model.json").read_text())
    Path("model.json").write_text(json.dumps({**document, "effects": [bad]}))
    with pytest.raises(BadInput, match=expected):
        chain.simulate(read_model("model.json"), [read_recording("run.csv")])
    done = rdpi("simulate", "model.json", "run.csv")
    assert done.exit_code == 2 and done.output.startswith("rdpi: model.json: effects[0] ")
    assert done.output.count("\n") == 1


@pytest.mark.parametrize("parameters", [{"delay_s": 0.1, "later": 1}, {"delay_s": {"value": 0.1, "later": 1}}])
def test_keys_that_this_version_does_not_know(parameters: dict) -> None:
    bent_by = replace(bent(), effects=[{"name": "delay", "later": 1, "parameters": parameters}])
    assert [one.values for one in effects.acting(bent_by)] == [{"delay_s": 0.1}]


@pytest.mark.parametrize("wrong", [None, {}, [entry("delay", delay_s={1})], [entry("delay", delay_s=np.array([0.1]))]],
                         ids=["None", "object", "set", "array"])
def test_effects_that_were_put_in_by_hand(wrong: object) -> None:
    with pytest.raises(BadInput, match="effects"):
        effects.acting(replace(bent(), effects=wrong))


# --- what recordings excite ------------------------------------------------------------------------------------------

def residuals_of(*runs: Recording, model: Model | None = None) -> Residuals:
    model = model or bent()
    predicted = [shown(model, run) for run in runs]
    left = [run.displacement_um - one for run, one in zip(runs, predicted)]
    left = [one - np.mean(one) for one in left]
    return Residuals(model, runs, predicted, left, left)


def recorded(command_V: np.ndarray, rate_hz: float = RATE_HZ, **options: object) -> Recording:
    return quasi_static(stack(law=0), command_V, rate_hz, noise_um=0.005, **options)


SHORT = recorded(waves(90, 4, 2, RATE_HZ))
PLAIN: Plant = stack(plays=0, law=0)
HIDDEN: dict[str, tuple[Effect, Residuals, Residuals]] = {  # what does not excite it, what does
    "cross_coupling": (CATALOGUE["cross_coupling"](), residuals_of(changed(SHORT, other_axis_V=np.full(500, 3.0))),
                       residuals_of(changed(SHORT, other_axis_V=np.arange(500.0)))),
    "relaxation": (CATALOGUE["relaxation"](), residuals_of(recorded(waves(90, 0.02, 2, 0.4), 0.4)),
                   residuals_of(SHORT)),
    "creep": (CATALOGUE["creep"](), residuals_of(SHORT), residuals_of(recorded(waves(90, 1, 2, RATE_HZ)))),
    "rate_dependence": (CATALOGUE["rate_dependence"](), residuals_of(recorded(90 - np.abs(np.linspace(-90, 90, 500)))),
                        residuals_of(recorded(np.r_[waves(90, 0.5, 1, RATE_HZ), waves(90, 5, 2, RATE_HZ)]))),
    "initial_memory": (CATALOGUE["initial_memory"](), residuals_of(marked(SHORT, memory="unknown")),
                       residuals_of(SHORT)),
    "initial_memory without plays": (
        CATALOGUE["initial_memory"](),
        residuals_of(quasi_static(PLAIN, waves(90, 4, 2, RATE_HZ)), model=model_of(PLAIN)), residuals_of(SHORT)),
    "hysteresis_change without plays": (
        CATALOGUE["hysteresis_change"](),
        residuals_of(quasi_static(PLAIN, waves(90, 4, 2, RATE_HZ)), model=model_of(PLAIN)), residuals_of(SHORT)),
    "a grid of readings": (CATALOGUE["quantisation"]("sensor"), residuals_of(SHORT), residuals_of(
        changed(SHORT, displacement_um=np.round(SHORT.displacement_um, 1)))),
}


@pytest.mark.parametrize("case", HIDDEN)
def test_what_recordings_do_not_excite(case: str) -> None:
    effect, hiding, showing = HIDDEN[case]
    assert effect.starts(hiding) == [] and effect.hidden(hiding)
    assert effect.starts(showing) and not effect.hidden(showing)


@pytest.mark.parametrize(("name", "stage"), PLACES)
def test_fits_start_within_the_bounds(name: str, stage: str) -> None:
    effect = CATALOGUE[name](stage)
    run = changed(moving(), displacement_um=np.round(moving().displacement_um, 1))
    starts = effect.starts(residuals_of(run))
    assert starts
    for values in starts:
        assert all(one.low <= values[one.name] <= one.high for one in effect.parameters if one.name in values)
        assert effect.disturbance or set(values) == set(effect.absent())


def test_hum_is_looked_for_at_its_frequency() -> None:
    t = shape_of(SHORT)
    hum = changed(SHORT, displacement_um=SHORT.displacement_um + 0.05 * np.sin(2 * np.pi * 83.3 * t))
    strongest = CATALOGUE["periodic_disturbance"]().starts(residuals_of(hum))[0]
    assert strongest["frequency_hz"] == pytest.approx(83.3, abs=0.6)


def test_a_grid_is_looked_for_at_its_step() -> None:
    step = 0.07
    coarse = changed(SHORT, displacement_um=step * np.round(SHORT.displacement_um / step))
    starts = CATALOGUE["quantisation"]("sensor").starts(residuals_of(coarse))
    assert [values["step"] for values in starts] == pytest.approx([step] * len(starts), rel=1e-6) and starts
