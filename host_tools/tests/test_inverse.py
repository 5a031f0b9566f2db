"""The inverse of the whole chain: what is compensated, folded or left out, and that it comes out again in front."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from models import random_model
from scipy import signal

from rdpi import firmware
from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.firmware import Chain, ahead
from rdpi.model import Drive, Memory, Model, Rate, loop_ends_um
from rdpi.simulate import ALL, Inverse, chain, effects, inverse_of, numpy_inverse
from rdpi.simulate.effects import CATALOGUE, Sensor
from rdpi.simulate.effects.base import low_pass
from rdpi.simulate.effects.treatment import Treatment
from rdpi.simulate.inverse import APART, Jump, _chain, in_series
from rdpi.simulate.memory import swept_um

STEP_S = 1e-4
SIZES: dict[str, dict[str, float]] = {
    "input_curve": {"quadratic": 0.1, "cubic": 0.05, "low_V": -1.0, "high_V": 1.0}, "initial_memory": {
        "position_um": 1.0}, "rate_dependence": {"widening": 0.1, "change": 0.05, "exponent": 1.0},
    "hysteresis_change": {"scale": 0.2, "shape": 0.1}, "relaxation": {"share": 0.06, "time_constant_s": 0.004},
    "creep": {"percent_per_decade": 3.0}, "gain_change": {"factor": 1.1}, "backlash": {"width_um": 0.1},
    "resonance": {"f0_hz": 600.0, "damping": 0.03}, "cross_coupling": {"um_per_V": 0.02},
    "thermal_drift": {"um_per_s": 0.01, "um_per_degC": 0.3},
    "periodic_disturbance": {one.name: 1.0 for one in CATALOGUE["periodic_disturbance"].parameters},
    "static_nonlinearity": {"linear": 0.02, "quadratic": 0.03, "cubic": -0.02}, "slew_limit": {"V_per_s": 1e4},
    "lag": {"time_constant_s": 5e-4}, "rail_saturation": {"V_min": -1e6, "V_max": 1e6}, "delay": {"delay_s": 1.23e-3},
    "quantisation": {"step": 0.01, "origin": 0.0, "dither": 0.0}}


def entry(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "parameters": dict(SIZES[name])} | more


def model_with(*names: str | dict[str, Any], **changes: Any) -> Model:
    """A model without rate law whose control input is never negative."""
    model = random_model(5, plays=6, falling=False)
    low_um = min(float(model.x_of(end_V)) for end_V in (model.drive.min_V, model.drive.max_V))
    model = replace(model, offset_V=model.offset_V + low_um / model.gain_um_per_V, rate=Rate(max_um_per_s=1e5))
    middle_um = float(model.x_of((model.drive.min_V + model.drive.max_V) / 2))
    memory = replace(model.memory, x_um=middle_um, plays_um=np.full(len(model.slopes), middle_um))
    made = replace(model, memory=memory, effects=[one if isinstance(one, dict) else entry(one) for one in names],
                   **changes)
    made.validate()
    return made


def reference(inverse: Inverse, samples: int = 3000) -> np.ndarray:
    """Two sines that stay within the range, and begin at rest: plays remember a start with a jolt."""
    low, high = chain.reachable_um(inverse.model)
    t = np.arange(samples) * STEP_S
    fade = (1 - np.cos(np.pi * np.minimum(t / 0.04, 1))) / 2
    return low + (high - low) * (0.5 + 0.1 * fade * (np.sin(2 * np.pi * 10 * t) + np.sin(2 * np.pi * 25 * t)))


def starting(model: Model, inverse: Inverse, first_um: float) -> tuple[Model, Inverse]:
    """With the memory at this displacement."""
    memory = chain.rest_at(inverse.model, first_um)
    return replace(model, memory=memory), replace(inverse, model=replace(inverse.model, memory=memory))


def returned(model: Model, inverse: Inverse, engine: str = "f64", memory: str = "reset"
             ) -> tuple[np.ndarray, np.ndarray]:
    """A reference, and what the model says the actuator makes of the drive for it; rest of the start left out."""
    wanted = reference(inverse)
    model, inverse = starting(model, inverse, wanted[0]) if memory != "reset" else (model, inverse)
    time_s = np.arange(len(wanted)) * STEP_S
    run = Recording("r.csv", {"memory": memory}, {"time_s": time_s, "reference_um": wanted})
    drive_V = chain.follow(model, run, engine=engine, by=inverse)[0].drive_V.astype(float)
    driven = Recording("d.csv", {"memory": memory}, {"time_s": time_s, "command_V": drive_V})
    part = slice(500, -100)
    return wanted[part], chain.simulate(model, [driven])[0].predicted_um[part]


def miss(model: Model, inverse: Inverse, engine: str = "f64", memory: str = "reset") -> float:
    """rms error as a share of the reference."""
    wanted, found = returned(model, inverse, engine, memory)
    return float(np.sqrt(np.mean((found - wanted) ** 2)) / np.ptp(wanted))


# --- the forward chain after the inverse is the reference ----------------------------------------------------------

@pytest.mark.parametrize("names", [(), ("relaxation",), ("creep",), ("relaxation", "creep"), ("gain_change",),
                                   ("hysteresis_change",), ("gain_change", "creep", "hysteresis_change")])
@pytest.mark.parametrize("memory", ["reset", "unknown"])
@pytest.mark.parametrize("engine", ["numpy", "f64"])
def test_what_has_an_exact_inverse_comes_back(names: tuple[str, ...], memory: str, engine: str) -> None:
    """Two in series say little else of a sweep than one bank: while it ended, the second was driven by the first."""
    model = model_with(*names)
    found = inverse_of(model)
    assert {one.how for one in found.told} <= {"compensated", "folded"}
    in_series = memory == "reset" and {"relaxation", "creep"} <= set(names)
    assert miss(model, found, engine, memory) < (1e-6 if in_series else 1e-9)
    if names:
        assert miss(model, inverse_of(model, leave_out=(ALL,))) > 3e-4


@pytest.mark.parametrize(("names", "most"), [(("delay",), 1e-4), (("lag",), 2e-3), (("resonance",), 1e-4),
                                             (("delay", "lag", "resonance"), 6e-3),
                                             (("delay", "lag", "resonance", "relaxation", "creep"), 6e-3)])
@pytest.mark.parametrize("preview", [True, False])
@pytest.mark.parametrize("engine", ["numpy", "f64", "f32", "q31"])
def test_what_a_lead_makes_up_for(names: tuple[str, ...], most: float, preview: bool, engine: str) -> None:
    model = model_with(*names)
    found = inverse_of(model, preview=preview)
    assert miss(model, found, engine) < most * (1 if preview else 5)
    left = miss(model, inverse_of(model, leave_out=(ALL,)))
    assert left > 3 * miss(model, found, engine)


def test_a_curve_is_folded_and_its_error_told() -> None:
    model = model_with(entry("static_nonlinearity", stage="actuator"))
    found = inverse_of(model)
    assert found.told[0].how == "folded" and len(found.model.deadzones_um) == 8
    told = float(found.told[0].why.partition("off by up to ")[2].partition(" %")[0]) / 100
    wanted, back = returned(model, found)
    assert np.max(np.abs(back - wanted)) <= 1.05 * told * model.stroke_um
    assert miss(model, found) < 0.25 * miss(model, inverse_of(model, leave_out=(ALL,)))


@pytest.mark.parametrize("engine", ["numpy", "f64", "f32", "q31"])
@pytest.mark.parametrize("dac_bits", [None, 16])
def test_a_curve_at_the_input_becomes_pieces(engine: str, dac_bits: int | None) -> None:
    drive = replace(model_with().drive, dac_bits=dac_bits)
    curve = {"quadratic": 0.15, "cubic": -0.1, "low_V": drive.min_V, "high_V": drive.max_V}
    model = model_with({"name": "input_curve", "parameters": curve}, "creep", drive=drive)
    found = inverse_of(model)
    assert len(found.model.drive.curve_V) == 9 and "into 8 pieces" in found.told[0].why and not model.drive.curve_V
    told = float(found.told[0].why.partition("off by up to ")[2].partition(" %")[0]) / 100
    assert miss(model, found, engine) < 3 * told < 0.02 * miss(model, inverse_of(model, leave_out=["input_curve"]))
    assert "beside" not in found.told[0].why
    straight = {"name": "input_curve", "parameters": {**curve, "quadratic": 0.0, "cubic": 0.0}}
    assert not inverse_of(model_with(straight)).model.drive.curve_V


def test_a_curve_beside_the_drives_range_is_said() -> None:
    curve = {"quadratic": 0.1, "cubic": 0.0, "low_V": 20.0, "high_V": 30.0}
    (told,) = inverse_of(model_with({"name": "input_curve", "parameters": curve}, drive=Drive(-20.0, 20.0))).told
    assert "its own range, 20 to 30 V, lies beside the drive's" in told.why


def test_a_curve_below_0_is_left_out() -> None:
    model = replace(random_model(3, falling=False), effects=[entry("static_nonlinearity", stage="actuator")])
    (told,) = inverse_of(model).told
    assert told.how == "left out" and "would be off by" in told.why
    falling = {"name": "static_nonlinearity", "parameters": {"linear": -1.5, "quadratic": 0.0, "cubic": 0.0}}
    (told,) = inverse_of(model_with(falling)).told
    assert told.how == "left out" and "does not increase" in told.why


# --- the reference in NumPy against the library --------------------------------------------------------------------

EVERYTHING = Chain(1.26e-3, 7e-4, 4e-4, 1e-7, 2.0, True, 0.93,
                   ((0.05, 3e-3), (0.02, 0.5), (-0.01, 20.0), (0.02, 900.0)))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("preview", [True, False])
def test_numpy_and_the_library_agree_whatever_happens(seed: int, preview: bool) -> None:
    """Clips, slew, codes, guard, NaN, missed samples, jumps."""
    model = random_model(seed, slew=seed % 2 == 0, dac_bits=None if seed % 3 else 16, window=3, filter_s=3e-4)
    random = np.random.default_rng(seed)
    wanted = model.offset_um + 4 * np.cumsum(random.normal(size=400)) / 20
    wanted[100:200] += 5.0
    wanted[random.integers(0, 400, 12)] = np.nan
    wanted[250:253] = np.inf
    around = replace(EVERYTHING, preview=preview)
    exact = numpy_inverse.step(model, around, wanted, STEP_S)[0]
    library = firmware.Firmware(model, STEP_S, "f64", around)
    found = library.step(wanted)
    span_V = model.drive.max_V - model.drive.min_V
    assert found.drive_V == pytest.approx(exact.drive_V, abs=1e-6 * span_V + (span_V / 65535 if seed % 3 == 0 else 0))
    assert np.mean(found.flags == exact.flags) > 0.99
    seen = np.bitwise_or.reduce(exact.flags)
    assert seen & operators_flags("input", "missed", "lead") == operators_flags("input", "missed", "lead")
    assert library.preview_samples == around.preview_samples(STEP_S) == (15 if preview else 0)


def operators_flags(*names: str) -> int:
    return sum(firmware.FLAGS[name] for name in names)


@pytest.mark.parametrize("engine", ["numpy", "f64", "q31"])
@pytest.mark.parametrize(("delay_s", "step_s"), [(2.5e-3, 1e-3), (1.5e-4, 1e-4), (1.05e-3, 1e-4), (4.5e-5, 2e-5)])
def test_half_a_sample_of_delay_is_looked_ahead_as_the_engine_rounds_it(delay_s: float, step_s: float, engine: str
                                                                        ) -> None:
    model = model_with(entry("delay", parameters={"delay_s": delay_s}))
    low, high = chain.reachable_um(inverse_of(model).model)
    time_s = np.arange(1000) * step_s
    wanted = low + (high - low) * (0.5 + 0.2 * np.sin(2 * np.pi * 0.005 * time_s / step_s))
    run = Recording("r.csv", {}, {"time_s": time_s, "reference_um": wanted})
    found, single = (chain.follow(model, run, engine=one)[0].drive_V for one in (engine, "f32"))
    missed_V = np.mean(np.abs(found - single)[50:])  # where the reference turns, a sample has no lead
    assert missed_V < 1e-4 * (model.drive.max_V - model.drive.min_V)


@pytest.mark.parametrize("engine", ["f32", "q31"])
def test_the_flashed_ones_follow(engine: str) -> None:
    model = model_with()
    wanted = reference(inverse_of(model))
    exact = numpy_inverse.step(model, EVERYTHING, wanted, STEP_S)[0]
    found = firmware.engine(model, STEP_S, engine, EVERYTHING).step(wanted)
    assert found.drive_V == pytest.approx(exact.drive_V, abs=1e-3 * (model.drive.max_V - model.drive.min_V))


@pytest.mark.parametrize("engine", ["numpy", "f64"])
def test_what_follows_a_clip_is_exact_again(engine: str) -> None:
    """Creep follows what was output, not what was asked for."""
    model = model_with("creep", "relaxation")
    found = inverse_of(model)
    low, high = chain.reachable_um(found.model)
    t = np.arange(1500) * STEP_S
    wanted = (low + high) / 2 + 0.8 * (high - low) * np.sin(2 * np.pi * 20 * t) * np.exp(-t / 0.05)
    model, found = starting(model, found, wanted[0])
    run = Recording("r.csv", {}, {"time_s": t, "reference_um": wanted})
    steps = chain.follow(model, run, engine=engine, by=found)[0]
    clipped = steps.flags & operators_flags("range") > 0
    driven = Recording("d.csv", {}, {"time_s": t, "command_V": steps.drive_V})
    missed = np.abs(chain.simulate(model, [driven])[0].predicted_um - wanted)
    assert 50 < np.count_nonzero(clipped) < 700 and not clipped[-500:].any()
    assert missed[~clipped].max() < 1e-9 * (high - low) and missed[clipped].max() > 0.01 * (high - low)


def test_a_chain_that_does_nothing_changes_no_bit() -> None:
    model = random_model(2, dac_bits=16)
    wanted = reference(inverse_of(model), 500)
    for name in firmware.ENGINES:
        plain, chained = (firmware.engine(model, STEP_S, name, one).step(wanted) for one in (None, Chain()))
        assert all(np.array_equal(*pair) for pair in zip(plain, chained))


@pytest.mark.parametrize("name", firmware.ENGINES)
def test_the_memory_settles_the_chain(name: str) -> None:
    model = model_with()
    one, other = (firmware.engine(model, STEP_S, name, EVERYTHING) for _ in range(2))
    other.step(reference(inverse_of(model)))
    other.memory_um = one.memory_um
    wanted = one.predict(np.array([model.start_V()]), np.zeros(1))[0] + np.zeros(50)
    assert one.step(wanted).drive_V == pytest.approx(other.step(wanted).drive_V, abs=1e-4)


@pytest.mark.parametrize("place", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("name", firmware.ENGINES)
def test_creep_follows_the_sweep_from_the_middle_of_the_range_on(name: str, place: float) -> None:
    model = model_with()
    low_V, high_V = model.drive.min_V, model.drive.max_V
    drive = replace(model.drive, sweep_end_V=low_V + place * (high_V - low_V), sweep_cycles=5)
    model = replace(model, drive=drive, memory=replace(model.memory, sweep_share=1.0))
    bank = Chain(direct=0.97, poles=((0.03, 0.004), (0.02, 0.1), (0.02, 0.5)))
    library, plant = firmware.engine(model, STEP_S, name, bank), firmware.Firmware(model, STEP_S, "f64")
    swept_V = library.sweep()[0].astype(float)
    last_um = library.predict(swept_V[-1:], np.zeros(1))[0]
    wanted = last_um + 0.03 * model.stroke_um * np.sin(np.arange(300) / 50)
    drives = np.r_[swept_V, library.step(wanted).drive_V]
    h = plant.forward(drives, np.zeros(len(drives)))
    middle_um = swept_um(model, float(model.x_of(low_V) + model.x_of(high_V)) / 2)
    signal = np.r_[middle_um, h]
    z = middle_um + bank.direct * (h - middle_um) + sum(
        share * (low_pass(signal, STEP_S, time_s)[1:] - middle_um) for share, time_s in bank.poles)
    near_um = {"f64": 1e-9, "f32": 3e-5, "q31": 1e-5}[name] * model.stroke_um
    assert z[-300:] == pytest.approx(wanted, abs=near_um)
    assert np.max(np.abs(h[-300:] - wanted)) > 1e-3 * model.stroke_um


def test_missed_samples_reach_the_chain() -> None:
    model = model_with()
    wanted = reference(inverse_of(model), 60)
    held = wanted.copy()
    held[30:33] = np.nan
    for name in firmware.ENGINES:
        one, other = (firmware.engine(model, STEP_S, name, EVERYTHING) for _ in range(2))
        expected = one.step(held).drive_V[33:]
        other.step(held[:30])
        other.missed(3)
        # Where slow poles move in turns, a gap changes the order.
        near_V = 5e-5 * (model.drive.max_V - model.drive.min_V) if name != "f64" else 0
        assert other.step(held[33:]).drive_V == pytest.approx(expected, rel=1e-12, abs=near_V)


@pytest.mark.parametrize(("samples", "expected"), [(0, [1, 2, 3, 4]), (1, [2, 3, 4, 4]), (3, [4, 4, 4, 4]),
                                                   (9, [4, 4, 4, 4])])
def test_the_file_is_its_own_future(samples: int, expected: list[float]) -> None:
    assert ahead(np.array([1.0, 2.0, 3.0, 4.0]), samples).tolist() == expected


@pytest.mark.parametrize("engine", ["numpy", "f64", "f32", "q31"])
@pytest.mark.parametrize("edge_s", [0.0, STEP_S, 2e-3, 1e-2])
def test_a_lag_leaves_nothing_where_the_reference_rests(edge_s: float, engine: str) -> None:
    """However it came there. Plays that follow a lead of the reference turn where the actuator does not: 2 ms of way
    then left 2.7 % of the stroke.
    """
    model = model_with(entry("delay", parameters={"delay_s": 10 * STEP_S}),
                       entry("lag", parameters={"time_constant_s": 9.3 * STEP_S}))
    low, high = chain.reachable_um(inverse_of(model).model)
    levels = low + (high - low) * np.array([0.5, 0.7, 0.2, 0.6, 0.9, 0.35, 0.5, 0.52])
    each, way = 1000, max(1, round(edge_s / STEP_S))
    wanted = np.concatenate([np.r_[before + (after - before) * np.arange(1, way + 1) / way, np.full(each - way, after)]
                             for before, after in zip(levels[:1].tolist() + levels[:-1].tolist(), levels)])
    model, found = starting(model, inverse_of(model), wanted[0])
    run = Recording("r.csv", {}, {"time_s": np.arange(len(wanted)) * STEP_S, "reference_um": wanted})
    driven = Recording("d.csv", {}, {"time_s": run.time_s,
                                     "command_V": chain.follow(model, run, engine=engine, by=found)[0].drive_V})
    missed = chain.simulate(model, [driven])[0].predicted_um - wanted
    assert np.max(np.abs(missed.reshape(len(levels), each)[1:, each // 2:])) < 1e-3 * (high - low)


@pytest.mark.parametrize("engine", ["numpy", "f64", "f32", "q31"])
def test_a_slow_slew_gets_from_code_to_code_behind_a_lag(engine: str) -> None:
    """A fifth of a code per sample: the drive moves as far as the slew limit lets it."""
    model = model_with("lag")
    drive = replace(model.drive, dac_bits=10)
    per_sample_V = (drive.max_V - drive.min_V) / 1023 / 5
    model = replace(model, drive=replace(drive, slew_V_per_s=per_sample_V / STEP_S))
    low, high = chain.reachable_um(inverse_of(model).model)
    wanted = np.r_[np.full(10, (low + high) / 2), np.full(1000, low + 0.9 * (high - low))]
    run = Recording("r.csv", {}, {"time_s": np.arange(len(wanted)) * STEP_S, "reference_um": wanted})
    found = chain.follow(model, run, engine=engine)[0].drive_V
    assert abs(found[-1] - found[0]) == pytest.approx(1000 * per_sample_V, rel=0.01)


# --- what the host makes of the model's effects --------------------------------------------------------------------

@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_says_what_the_firmware_does(name: str) -> None:
    (told,) = inverse_of(model_with(entry(name))).told
    assert told.how in ("compensated", "folded", "left out") and told.why
    assert str(told).startswith(f"{name} at stage ") and f": {told.how}" in str(told)
    assert told.to_json() == {"name": name, "stage": told.acting.effect.stage, "firmware": told.how, "why": told.why}


def test_leads_add_up() -> None:
    found = inverse_of(model_with("delay", "lag", "resonance")).chain
    tau, w = 5e-4, 2 * np.pi * 600
    assert found.delay_s == 1.23e-3 and found.lag_s == tau
    assert (found.lead_s, found.lead_s2) == pytest.approx((0.06 / w, 1 / w**2))
    twice = _chain(model_with(), [Treatment("compensated", "", lead=one) for one in ((2e-4, 3e-8), (5e-4, 7e-8))], True)
    assert (twice.lead_s, twice.lead_s2) == pytest.approx((7e-4, 1e-7 + 1e-7))
    assert found.preview and not inverse_of(model_with("delay"), preview=False).chain.preview
    assert not inverse_of(model_with()).chain.acts


def test_banks_in_series_are_one_bank() -> None:
    banks = [(0.95, [(0.05, 4e-3)]), (1.0, [(0.01, 0.1), (0.02, 1.0), (-0.01, 10.0)]), (0.9, [(0.2, 0.03)])]
    direct, poles = in_series(banks)
    for s in (0.0, 0.3j, 5j, 400j, 2 + 30j, 1e9j):
        each = [one + sum(share / (1 + time_s * s) for share, time_s in lags) for one, lags in banks]
        assert direct + sum(share / (1 + time_s * s) for share, time_s in poles) == pytest.approx(np.prod(each))


def test_poles_of_one_time_are_set_apart() -> None:
    direct, poles = in_series([(1.0, [(0.05, 0.1)]), (1.0, [(0.03, 0.1)]), (1.0, [(0.03, 0.1 * APART)])])
    times_s = sorted(time_s for _, time_s in poles)
    assert direct == 1 and min(np.divide(times_s[1:], times_s[:-1])) > APART * (1 - 1e-6)
    assert sum(share for share, _ in poles) + direct == pytest.approx(1.05 * 1.03**2)


def test_limits_of_the_amplifier_become_those_of_the_drive() -> None:
    model = model_with("slew_limit", {"name": "rail_saturation", "parameters": {"V_min": -1e6, "V_max": 0.0}},
                       drive=Drive(-20.0, 20.0, 2e4, sweep_V_per_s=1.5e4, sweep_end_V=3.0))
    drive = inverse_of(model).model.drive
    assert (drive.min_V, drive.max_V, drive.slew_V_per_s) == (-20.0, 0.0, 1e4)
    assert (drive.sweep_V_per_s, drive.sweep_end_V) == (1e4, 0.0)
    inverse_of(model).model.validate()
    coded = replace(model, drive=replace(model.drive, dac_bits=16))
    rails = next(one for one in inverse_of(coded).told if one.acting.effect.name == "rail_saturation")
    assert rails.how == "left out" and "codes span" in rails.why
    assert inverse_of(coded).model.drive.max_V == 20.0
    beside = {"name": "rail_saturation", "parameters": {"V_min": 30.0, "V_max": 40.0}}
    for one in (model, coded):
        (told,) = inverse_of(replace(one, effects=[beside])).told
        assert told.how == "left out" and told.why == "the rails leave nothing of the drive's range, -20 to 20 V"


def test_rails_do_not_change_what_wider_loops_are_folded_into() -> None:
    """Loops are widened over the range of the model, as in the prediction, whatever the rails leave of it."""
    rails = {"name": "rail_saturation", "parameters": {"V_min": -1e6, "V_max": 5.0}}
    alone = model_with("hysteresis_change", drive=Drive(-20.0, 20.0))
    both = model_with("hysteresis_change", rails, drive=Drive(-20.0, 20.0))
    assert inverse_of(both).model.slopes == pytest.approx(inverse_of(alone).model.slopes, rel=1e-12)
    assert inverse_of(both).model.drive.max_V == 5.0 and inverse_of(alone).model.drive.max_V == 20.0


def test_the_lead_has_a_limit() -> None:
    model = model_with("delay")
    assert inverse_of(model).chain.max_lead_um == 0.25 * model.stroke_um
    slow = replace(model, drive=replace(model.drive, slew_V_per_s=1.0))
    assert 0 < inverse_of(slow).chain.max_lead_um < 1e-2 * model.stroke_um


def test_a_fold_that_makes_no_operator_is_left_out() -> None:
    model = model_with("hysteresis_change")
    model.effects[0]["parameters"] = {"scale": 5.0, "shape": 2.0}
    found = inverse_of(replace(model, rate=Rate(max_um_per_s=1e5, min_slope_ratio=0.5)))
    for one in found.told:
        assert one.how == "folded" or "makes no operator" in one.why
    found.model.validate()


def test_the_rate_law_is_that_of_the_changed_gain() -> None:
    model = random_model(8, plays=5)
    found = inverse_of(replace(model, effects=[entry("gain_change", stage="actuator")])).model
    ratio = found.slopes_at(1.1 * 50.0) / model.slopes_at(50.0)
    assert ratio == pytest.approx(np.ones(6)) and found.rate.max_um_per_s <= 1.1 * model.rate.max_um_per_s


@pytest.mark.parametrize(("column", "name", "added"), [
    ("other_axis_V", "cross_coupling", [0.04, 0.06, 0.1]), ("temperature_degC", "thermal_drift", [0.0, 0.3, 0.9])])
def test_what_the_application_subtracts(column: str, name: str, added: list[float]) -> None:
    found = inverse_of(model_with(entry(name, column=column)))
    assert found.told[0].how == "compensated" and column in found.told[0].why
    run = Recording("r.csv", {}, {"time_s": np.arange(3.0), column: np.array([2.0, 3.0, 5.0])})
    assert found.added_um(run) == pytest.approx(added)
    assert not found.added_um(Recording("r.csv", {}, {"time_s": np.arange(3.0)})).any()


# --- sensor, stages, leaving out -----------------------------------------------------------------------------------

def test_a_stage_that_nothing_shows_is_said_to_be_assumed() -> None:
    for more, assumed in (({"origin": "fit"}, True), ({}, True), ({"stage": "timing"}, False),
                          ({"origin": "gap", "stage": "timing", "stage_shown": True}, False)):
        (told,) = inverse_of(model_with(entry("delay", **more))).told
        assert told.how == "compensated" and ("nothing shows whether" in told.why) == assumed


def test_the_sensors_are_left_out_where_they_are_known_to_be_its() -> None:
    for more in ({}, {"origin": "gap", "stage_shown": True}):
        found = inverse_of(model_with(entry("delay", stage="sensor", **more)))
        assert found.told[0].how == "left out" and "sensor's" in found.told[0].why and not found.chain.acts
    found = inverse_of(model_with(entry("delay", stage="sensor", origin="gap")))
    assert found.told[0].how == "compensated" and found.chain.delay_s == 1.23e-3


@pytest.mark.parametrize(("sensor", "delay_s", "lag_s"), [
    (Sensor(2.3e-4, 0.0), 1e-3, 5e-4), (Sensor(0.0, 2e-4), 1.23e-3, 3e-4), (Sensor(1.33e-3, 1e-4), 0.0, 3e-4),
    (Sensor(0.0, 6e-4), 1.13e-3, 0.0)])
def test_the_data_sheet_of_the_sensor(sensor: Sensor, delay_s: float, lag_s: float) -> None:
    found = inverse_of(model_with(entry("delay", origin="fit"), entry("lag", origin="fit")), sensor=sensor).chain
    assert (found.delay_s, found.lag_s) == pytest.approx((delay_s, lag_s), abs=1e-12)


def test_an_effect_that_acts_has_all_its_values() -> None:
    for share, refused in ((0.1, True), (0.0, False), (None, False)):
        model = model_with(entry("relaxation", parameters={"share": share, "time_constant_s": None}))
        if refused:
            with pytest.raises(BadInput, match=r"relaxation\): time_constant_s is null, but the effect acts"):
                inverse_of(model)
        else:
            assert not inverse_of(model).chain.acts


def test_what_does_nothing_is_not_said_to_be_compensated() -> None:
    (told,) = inverse_of(model_with(entry("delay", parameters={"delay_s": {"value": None}}))).told
    assert (told.how, told.why) == ("left out", "with these values it does nothing")
    found = inverse_of(model_with(entry("delay", origin="fit")), sensor=Sensor(1.23e-3, 0.0))
    assert (found.told[0].how, found.told[0].why) == ("left out", "all of it is the sensor's") and not found.chain.acts


@pytest.mark.parametrize(("sensor", "words"), [
    (Sensor(2e-3, 0.0), "later than all"), (Sensor(-1.0, 0.0), "--sensor-delay -1"),
    (Sensor(0.0, float("nan")), "--sensor-lag nan")])
def test_sensors_that_cannot_be(sensor: Sensor, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        inverse_of(model_with(entry("delay", origin="fit"), entry("lag", origin="fit")), sensor=sensor)


def test_a_stage_that_is_known_is_not_the_sensors() -> None:
    with pytest.raises(BadInput, match="later than all"):
        inverse_of(model_with(entry("delay", stage="timing")), sensor=Sensor(1e-4, 0.0))


def test_leaving_out() -> None:
    model = model_with("delay", "creep")
    found = inverse_of(model, leave_out=["delay"])
    assert [(one.acting.effect.name, one.how) for one in found.told] == [("delay", "left out"), ("creep",
                                                                                                  "compensated")]
    assert not found.chain.leads and found.chain.poles and not found.alone
    with pytest.raises(BadInput, match="--leave-out lag: .* does not hold this effect, but delay, creep"):
        inverse_of(model, leave_out=["lag"])
    with pytest.raises(BadInput, match="--leave-out wobble: there is no such effect"):
        inverse_of(model, leave_out=["wobble"])


def test_the_operator_alone_is_for_an_inverse_that_leaves_all_out() -> None:
    other = random_model(11, plays=6, falling=False)
    model = replace(model_with("delay", "creep"), operator_alone=replace(
        model_with(), slopes=1.01 * model_with().slopes).alone())
    for leave_out in ((ALL,), ("delay", "creep")):
        found = inverse_of(model, leave_out=leave_out)
        assert found.alone and found.lines[-1].endswith("as if nothing stood around it")
        assert found.model.slopes == pytest.approx(1.01 * model.slopes) and not found.chain.acts
    some = inverse_of(model, leave_out=["delay"])
    assert not some.alone and some.model.slopes == pytest.approx(model.slopes)
    assert some.lines[-1].endswith("it takes up nothing of those that are left out")
    assert len(inverse_of(model).lines) == 2 and not inverse_of(other).lines


# --- what a lead costs ---------------------------------------------------------------------------------------------

def test_what_no_preview_costs() -> None:
    model = model_with("delay", "lag")
    with_it, without = inverse_of(model).costs(), inverse_of(model, preview=False).costs()
    assert [row[0] for row in with_it][:3] == [1, 2, 5] and not inverse_of(model_with("creep")).costs()
    for (_, left, led), (_, same, extrapolated) in zip(with_it, without):
        assert led < left == same and led < extrapolated < left
    hz, left, _ = with_it[0]
    late = np.exp(-2j * np.pi * hz * 1.23e-3) / (1 + 2j * np.pi * hz * 5e-4)
    assert left == pytest.approx(abs(1 - late))


@pytest.mark.parametrize(("delay_s", "late"), [(1e-4, False), (6e-4, True)])
def test_corners_ring_more_with_a_resonance_that_is_made_up_for_too_late(delay_s: float, late: bool) -> None:
    delay = {"name": "delay", "parameters": {"delay_s": delay_s}}
    model = model_with(delay, "resonance")
    both, other = (inverse_of(model, preview=False, leave_out=names) for names in ((), ("resonance",)))
    low_um, high_um = chain.reachable_um(both.model)
    wanted_um = low_um + (high_um - low_um) * (0.5 + 0.3 * signal.sawtooth(40 * np.pi * STEP_S * np.arange(5000), 0.5))
    missed = []
    for found in (both, other):
        run = Recording("r.csv", {"memory": "reset"}, {"time_s": np.arange(5000) * STEP_S, "reference_um": wanted_um})
        drive_V = chain.follow(model, run, engine="f64", by=found)[0].drive_V.astype(float)
        driven = replace(run, columns={"time_s": run.time_s, "command_V": drive_V})
        missed.append(float(np.std((chain.simulate(model, [driven])[0].predicted_um - wanted_um)[1000:])))
    assert (missed[0] > missed[1]) == late == (both.rings_late() is not None)
    assert other.rings_late() is None and inverse_of(model).rings_late() is None


@pytest.mark.parametrize(("numbers", "words"), [
    ({"delay_s": -1.0}, "delay_s: is -1"), ({"lead_s2": float("nan")}, "lead_s2"),
    ({"max_lead_um": 0.0}, "max_lead_um"),
    ({"direct": 0.0}, "a share of 0 comes at once"), ({"direct": 0.5, "poles": ((-0.6, 1.0),)}, "-0.1 in the end"),
    ({"poles": ((0.1, 0.0),)}, "time constants must be positive")])
def test_chains_that_have_no_inverse(numbers: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        Chain(**numbers)


@pytest.mark.parametrize(("around", "words"), [
    (Chain(delay_s=0.6), "delay and lag: 0.6 s and 0 s; .* half a second"),
    (Chain(lead_s=0.6), "lead: 0.6 s and 0 s"), (Chain(lead_s2=2.0), "lead: 0 s and 2 s"), (Chain(direct=0.5, poles=((-0.3, 1.0),)), "at least a quarter"),
    (Chain(poles=((1.5, 1.0),)), "two moves in all")])
def test_chains_beyond_fixed_point(around: Chain, words: str) -> None:
    with pytest.raises(BadInput, match=f"no fixed point: .*{words}"):
        firmware.FixedPoint(model_with(), STEP_S, around)


def test_columns_of_other_axes_are_subtracted_from_the_reference() -> None:
    model = model_with(entry("cross_coupling"))
    wanted = reference(inverse_of(model), 400)
    other_V = 5 * np.sin(np.arange(400) / 50)
    columns = {"time_s": np.arange(400) * STEP_S, "reference_um": wanted, "other_axis_V": other_V}
    drive_V = chain.follow(model, Recording("r.csv", {"memory": "reset"}, columns), engine="f64")[0].drive_V
    plain = {"time_s": columns["time_s"], "reference_um": wanted - 0.02 * other_V}
    expected = chain.follow(replace(model, effects=[]), Recording("r.csv", {"memory": "reset"}, plain), engine="f64")
    assert drive_V == pytest.approx(expected[0].drive_V)


def test_effects_alone_do_not_change_what_stands_in_the_model() -> None:
    model = model_with("gain_change", "creep")
    before = model.digest(), effects.entries(effects.acting(model))
    inverse_of(model)
    assert (model.digest(), effects.entries(effects.acting(model))) == before


# --- backlash ---

@pytest.mark.parametrize("others", [(), ("creep",), ("lag", "delay")])
def test_backlash_is_crossed_at_each_reversal(others: tuple[str, ...]) -> None:
    model = model_with(*others, {"name": "backlash", "parameters": {"width_um": 1.0}})
    model.effects[-1]["parameters"]["width_um"] = 0.05 * model.stroke_um
    crossed = miss(model, inverse_of(model, jump_s=5e-4))
    assert crossed < 0.4 * miss(model, inverse_of(model, leave_out=["backlash"]))
    assert "spread over 500 us" in inverse_of(model, jump_s=5e-4).lines[-1]


def test_the_jump_over_backlash() -> None:
    """It takes its time, goes on from where it is, and what is no reference neither turns it nor starts it."""
    jump = Jump(0.8, 0.004)  # 0.2 um a sample of 1 ms
    wanted = np.array([np.nan, 3, 3, 4, 5, 6, 5, 5, 2e6, np.nan, 5, 6, 7])
    added = [0, 0, 0, 0.2, 0.4, 0.4, 0.2, 0, -0.2, -0.4, -0.4, -0.2, 0]
    assert jump.added_um(wanted, 0.001) == pytest.approx(np.array(added))
    assert not np.any(Jump().added_um(wanted, 0.001)) and not np.any(jump.added_um(np.full(3, np.nan), 0.001))


@pytest.mark.parametrize("jump_s", [0.0, -1.0, 11.0, float("nan"), float("inf")])
def test_a_jump_takes_time(jump_s: float) -> None:
    with pytest.raises(BadInput, match="--backlash-time"):
        inverse_of(model_with(), jump_s=jump_s)


@pytest.mark.parametrize("volts", [(0.0, 100.0), (40.0, 60.0), (45.0, 55.0)])
@pytest.mark.parametrize("gain_um_per_V", [0.1, -0.1])
def test_the_greatest_loop_of_a_narrow_range_has_plays_that_rest(gain_um_per_V: float, volts: tuple[float, float]
                                                                 ) -> None:
    """Thresholds of 2 and 4 um, and a range of 1 and 2 um: the ends are those that the library reaches."""
    model = Model(gain_um_per_V=gain_um_per_V, offset_V=50.0, offset_um=0.0, stroke_um=10.0,
                  slopes=np.array([0.5, 0.7, 0.9, 1]), thresholds_um=np.array([0.0, 1.0, 2.0, 4.0]), slope_rate_s_per_um=np.zeros(4),
                  deadzones_um=np.zeros(1), deadzone_weights=np.ones(1), drive=Drive(*volts),
                  rate=Rate(max_um_per_s=1e5), memory=Memory(0.0, np.zeros(4)))
    assert loop_ends_um(model) == pytest.approx(chain.reachable_um(model))
    curved = replace(model, effects=[{"name": "static_nonlinearity",
                                      "parameters": {"linear": 0.0, "quadratic": 0.05, "cubic": 0.0}}])
    assert inverse_of(curved).told[0].how in ("folded", "left out")
