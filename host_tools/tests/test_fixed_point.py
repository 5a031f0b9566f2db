"""The fixed-point library: integers that the host tools choose, and what it computes with them against the others."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from models import MODELS, SAMPLE_TIME_S, SEEDS, random_model, random_reference

from rdpi import firmware
from rdpi.errors import BadInput
from rdpi.firmware import Firmware, FixedPoint, Steps, parameters
from rdpi.firmware.parameters import INT32_MAX, MAX_DRIVE, MIN_SLOPE, NO_REFERENCE, ONE, Q31
from rdpi.model import Drive, Memory, Model, Rate, operators
from rdpi.model.operators import GUARD, INPUT, MISSED, RANGE, SLEW

MODEL = random_model(3, plays=4, deadzones=1, slew=True, dac_bits=12)
TABLES = "play", "saturation", "inverse_saturation", "curve", "memory"
SCALARS = [item.name for item in fields(Q31) if item.name not in (*TABLES, "scale")]
PROMISED = 2.0**-20  # of MAX_DRIVE: rdpi_q31_step in lib/include/rdpi/q31.h


def with_drive(**changes: object) -> Model:
    return replace(MODEL, drive=replace(MODEL.drive, **changes))


def dequantised(q: Q31) -> Model:
    """The model that the integers make, in units of MAX_DRIVE for x and v, of ONE for displacements."""
    rest, change = q.play[:, 1] / ONE, q.play[:, 2] / ONE
    guard = math.ldexp(q.guard_mantissa, q.guard_exponent) * 1e9 / ONE
    per_s = 1e6 / 2**32 / MAX_DRIVE
    memory = q.memory / MAX_DRIVE
    rising = q.drive_of_code_0 == q.min_drive  # drives are x, whose sign is the gain's
    ends = sorted(np.array([q.min_drive, q.max_drive]) / MAX_DRIVE * (1 if rising else -1))
    return Model(
        gain_um_per_V=1.0 if rising else -1.0, offset_V=0.0, offset_um=0.0, stroke_um=1.0,
        thresholds_um=q.play[:, 0] / MAX_DRIVE, slopes=rest, slope_rate_s_per_um=change / guard,
        deadzones_um=q.saturation[:, 0] / MAX_DRIVE,
        deadzone_weights=np.ldexp(q.saturation[:, 1].astype(float), -1 - q.saturation_shift),
        rate=Rate("displacement", q.rate_window_ns * 1e-9, q.rate_filter_ns * 1e-9, guard, None,
                  q.min_slope_ratio / 65536),
        drive=Drive(*ends, q.slew_per_us * per_s or None, q.dac_bits or None, q.sweep_cycles, q.sweep_per_us * per_s),
        memory=Memory(float(memory[0]), memory))


def steep_model(seed: int) -> Model:
    """Slopes as far apart as fixed point takes, at rest and at the guard."""
    random = np.random.default_rng(seed)
    model = random_model(seed)
    model.slopes = 60 ** random.uniform(-1, 0, 10)
    ends = np.clip(model.slopes * random.uniform(0.15, 5, 10), 1 / 60, 1)
    model.slope_rate_s_per_um = (ends - model.slopes) / model.rate.max_um_per_s
    model.rate = replace(model.rate, min_slope_ratio=0.1)
    return model


def narrow_model(seed: int, shift_um: float = 500.0, dac_bits: int | None = None) -> Model:
    """A range that is a small part of the numbers, far from x = 0."""
    model = random_model(seed, dac_bits=dac_bits)
    model.drive = replace(model.drive, min_V=model.drive.min_V + shift_um / model.gain_um_per_V,
                          max_V=model.drive.max_V + shift_um / model.gain_um_per_V)
    model.memory = Memory(model.memory.x_um + shift_um, model.memory.plays_um + shift_um)
    return model


# ---- the integers ----

def test_the_fields_by_hand() -> None:
    """10 um over 100 V, slopes 0.5 and 1, at the guard 0.2 and 1; one piece above v = 4."""
    model = Model(
        gain_um_per_V=0.1, offset_V=50.0, offset_um=1.0, stroke_um=10.0, thresholds_um=np.array([0.0, 2.0]),
        slopes=np.array([0.5, 1.0]), slope_rate_s_per_um=np.array([-0.001, 0.0]), deadzones_um=np.array([0.0, 4.0]),
        deadzone_weights=np.array([1.0, -0.5]), rate=Rate("displacement", 1e-3, 2e-4, 300.0),
        drive=Drive(0.0, 100.0, 1e4, 16, 7, 2e3), memory=Memory(1.0, np.array([1.0, 0.5])))
    q = parameters.q31(model)
    per_um = (MAX_DRIVE - 256) / 5
    assert (q.min_drive, q.drive_of_code_0, q.max_drive) == (256 - MAX_DRIVE, 256 - MAX_DRIVE, MAX_DRIVE - 256)
    assert q.sweep_end == round(per_um)
    assert q.play.tolist() == [[0, ONE // 2, round(0.2 * ONE) - ONE // 2], [round(2 * per_um), ONE, 0]]
    assert q.memory.tolist() == [round(per_um), round(0.5 * per_um)]
    assert (q.plays, q.deadzones, q.dac_bits, q.sweep_cycles) == (2, 2, 16, 7)
    assert (q.rate_window_ns, q.rate_filter_ns, q.min_slope_ratio) == (1_000_000, 200_000, 13107)
    assert q.slew_per_us == pytest.approx(1e4 * 0.1 * per_um * 1e-6 * 2**32, rel=1e-12)
    assert q.slew_per_us == pytest.approx(5 * q.sweep_per_us, rel=1e-12)
    # The reach is that of v = 5 + 0.8 * 2 (the play may lag on either side): z = 6.6 - 0.5 * 2.6, downwards 6.6.
    assert q.scale.um_per_reference == pytest.approx(6.6 / ONE)
    assert math.ldexp(q.guard_mantissa, q.guard_exponent) == pytest.approx(300e-9 / 6.6 * ONE, rel=1e-9)
    for stage, shift, corner, slopes in (
            (q.saturation, q.saturation_shift, 4 / 5 * MAX_DRIVE, np.array([1, 0.5]) * 5 / MAX_DRIVE / 6.6 * ONE),
            (q.inverse_saturation, q.inverse_shift, 4 / 6.6 * ONE, np.array([1, 2.0]) / 5 * MAX_DRIVE * 6.6 / ONE)):
        assert stage[0, 0] == 0 and stage[1, 0] == pytest.approx(corner, rel=1e-6)
        np.testing.assert_allclose(np.cumsum(stage[:, 1].astype(float)) / 2.0**shift, slopes, rtol=1e-6)
        assert 2**30 < np.abs(stage[:, 1].astype(int)).sum() <= 2**31
    assert q.scale.V_per_drive == pytest.approx(10 / per_um) and q.scale.offset_V == 50


@settings(max_examples=200)
@given(MODELS)
def test_init_takes_what_is_chosen_and_formats_are_used(model: Model) -> None:
    q = FixedPoint(model, SAMPLE_TIME_S).parameters
    ends = np.array([q.play[:, 1], q.play[:, 1] + q.play[:, 2]])
    assert ends.max() == ONE and ends.min() >= MIN_SLOPE
    assert MAX_DRIVE - 512 < max(-q.min_drive, q.max_drive, q.play[-1, 0], np.abs(q.memory).max()) <= MAX_DRIVE
    assert q.guard_mantissa >= 2**31 and (q.slew_per_us == 0 or q.slew_per_us >= q.sweep_per_us)
    if q.dac_bits > 1:
        assert min(abs(q.codes_per_drive), abs(q.drive_per_code)) >= 2**29


@pytest.mark.parametrize("seed", range(5))
def test_the_digest_is_the_crc_of_the_fields_in_their_order(seed: int) -> None:
    model = random_model(seed, plays=seed, deadzones=seed % 3, slew=seed > 2, dac_bits=16)
    low_V, high_V = model.drive.min_V, model.drive.max_V
    if bent := seed % 2 == 1:
        middle = (low_V + high_V) / 2, low_V + 0.6 * (high_V - low_V)
        model = replace(model, drive=replace(model.drive, curve_V=((low_V, low_V), middle, (high_V, high_V))))
    q = parameters.q31(model)
    data = struct.pack("<2QH4BH4BhH3I6iI6i2I", *(getattr(q, name) for name in SCALARS))
    data += b"".join(getattr(q, name).astype("<i4").tobytes() for name in TABLES if name != "curve" or bent)
    assert firmware.digest(q) == zlib.crc32(data)


REFUSED = {
    "slopes too far apart": (replace(MODEL, slopes=np.array([1.0, 1, 1, 1, 70])), "slopes: at rest or at the guard"),
    "narrow range": (replace(MODEL, drive=Drive(MODEL.drive.min_V, MODEL.drive.min_V + 1e-3), memory=Memory(
        *[MODEL.x_of(MODEL.drive.min_V), np.full(5, MODEL.x_of(MODEL.drive.min_V))])), "drive: the range"),
    "fine codes": (narrow_model(3, 2e3, 20), "drive: the range"),
    "thresholds": (replace(MODEL, thresholds_um=np.array([0, 1, 1 + 1e-9, 2, 5])), "thresholds_um: two lie within"),
    "dead zones": (replace(MODEL, deadzones_um=np.array([0, 1e-9])), "deadzones_um: two lie too close"),
    "long window": (replace(MODEL, rate=replace(MODEL.rate, window_s=4.5)), "rate.window_s: is 4.5 s"),
    "long filter": (replace(MODEL, rate=replace(MODEL.rate, filter_s=4.5)), "rate.filter_s: is 4.5 s"),
    "slope ratio": (replace(MODEL, rate=replace(MODEL.rate, min_slope_ratio=1e-5)), "rate.min_slope_ratio: 1e-05 is"),
    "slow sweep": (with_drive(sweep_V_per_s=1e-15), "drive.sweep_V_per_s: a start-up sweep of 1e-15"),
}


@pytest.mark.parametrize(("model", "text"), REFUSED.values(), ids=REFUSED)
def test_what_32_bits_do_not_hold_is_refused(model: Model, text: str) -> None:
    with pytest.raises(BadInput) as refused:
        parameters.q31(replace(model, where="a.json"))
    assert str(refused.value).startswith(f"a.json: no fixed point: {text}")


@pytest.mark.parametrize("sample_time_s", [0.0, 1e-10, 5.0, math.nan])
def test_sample_time(sample_time_s: float) -> None:
    with pytest.raises(BadInput, match="fixed point takes 1 ns to 4.29 s"):
        FixedPoint(MODEL, sample_time_s)


def test_what_the_library_refuses_reaches_the_user() -> None:
    with pytest.raises(BadInput, match="^the firmware library refuses: rate window spans"):
        FixedPoint(replace(MODEL, rate=replace(MODEL.rate, window_s=1.0)), 1e-4)


def test_states_beyond_the_range_fit_too() -> None:
    """The plays stand where a history outside the range left them, and x, rounded, a little below the range."""
    model = random_model(3)
    low, high = sorted((model.x_of(model.drive.min_V), model.x_of(model.drive.max_V)))
    x = high + 0.5e-5 * (high - low)
    model.thresholds_um = model.thresholds_um * 4
    model.memory = Memory(x, x + model.thresholds_um)
    model.validate()
    fixed = FixedPoint(model, SAMPLE_TIME_S)
    assert fixed.parameters.memory[0] == fixed.parameters.max_drive < fixed.parameters.memory[-1] <= MAX_DRIVE
    np.testing.assert_allclose(fixed.memory_um, model.memory.plays_um, atol=1e-5 * (high - low))


@settings(max_examples=200)
@given(SEEDS, st.integers(1, 128), st.floats(1e-3, 1.0))
def test_rounded_states_are_states(seed: int, plays: int, unit: float) -> None:
    """Every play at the end of its slack, where rounding one by one would break the rule between neighbours."""
    random = np.random.default_rng(seed)
    r_um = np.concatenate([[0.0], np.cumsum(random.uniform(2, 9, plays))])
    y_um = random.normal() + np.cumsum(np.diff(r_um, prepend=0.0) * random.choice([-1, 1], plays + 1))
    r = np.array([round(value / unit) for value in r_um])
    states = parameters.states(y_um, unit, r)
    assert np.all(np.abs(np.diff(states.astype(int))) <= np.diff(r))
    np.testing.assert_allclose(states, y_um / unit, rtol=0, atol=2.1)


def test_integers_saturate() -> None:
    given = [0.4, -0.6, 1e30, -1e30, math.inf, -math.inf, math.nan]
    expected = [0, -1, INT32_MAX, -INT32_MAX, INT32_MAX, -INT32_MAX, NO_REFERENCE]
    assert parameters.integers(np.array(given), 1.0).tolist() == expected


# ---- what the library makes of them ----

def compare(model: Model, reference_um: np.ndarray, sample_time_s: float = SAMPLE_TIME_S) -> tuple[Steps, Steps, float]:
    """Steps in fixed point, those of the double library with the same integers, and the largest error of the drive as
    a share of MAX_DRIVE."""
    fixed = FixedPoint(model, sample_time_s)
    q = fixed.parameters
    double = Firmware(dequantised(q), round(sample_time_s * 1e9) * 1e-9, "f64")
    integers = fixed.references(reference_um)
    ours = fixed.step(reference_um)
    theirs = double.step(np.where(integers == NO_REFERENCE, np.nan, integers / ONE))
    drive = (ours.drive_V - q.scale.offset_V) / abs(q.scale.V_per_drive) / MAX_DRIVE
    return ours, theirs, float(np.max(np.abs(drive - theirs.drive_V), initial=0))


KINDS = {"usual": random_model, "steep": steep_model, "narrow": narrow_model,
         "one slope": lambda seed: random_model(seed, plays=0, deadzones=0),
         "window": lambda seed: random_model(seed, window=7, filter_s=3e-5),
         "slow filter": lambda seed: random_model(seed, filter_s=0.1),
         "slew": lambda seed: random_model(seed, slew=True),
         "many": lambda seed: random_model(seed, plays=40, deadzones=12)}


@pytest.mark.parametrize("kind", KINDS)
def test_drive_against_the_double_library(kind: str, record_property: Callable[[str, object], None]) -> None:
    """2^-20 of MAX_DRIVE with the same integers; flags are equal, as random numbers meet no limit exactly."""
    worst, apart = 0.0, 0.0
    for seed in range(120):
        model = KINDS[kind](seed)
        model.validate()
        reference = random_reference(seed, model, broken=0.05 * (seed % 3))
        ours, theirs, error = compare(model, reference)
        np.testing.assert_array_equal(ours.flags, theirs.flags, err_msg=f"seed {seed}")
        worst = max(worst, error)
        assert model.drive.min_V <= ours.drive_V.min() and ours.drive_V.max() <= model.drive.max_V
        # Beyond twice the reach integers saturate, and with them the rate.
        scale = FixedPoint(model, SAMPLE_TIME_S).parameters.scale
        within = np.clip(reference, *(model.offset_um + np.array([-1, 1]) * INT32_MAX * scale.um_per_reference))
        exact = Firmware(model, SAMPLE_TIME_S, "f64").step(np.where(np.abs(reference) <= 1e6, within, np.nan))
        apart = max(apart, np.max(np.abs(ours.drive_V - exact.drive_V)) / (model.drive.max_V - model.drive.min_V))
    print(f"\nfixed point, {kind}: drive within 2^{math.log2(worst):.1f} of full scale with the same integers, "
          f"within 2^{math.log2(apart):.1f} of the range of the model itself")
    record_property("worst_log2", round(math.log2(worst), 2))
    assert worst <= PROMISED


@settings(max_examples=100)
@given(MODELS, SEEDS, st.sampled_from([0.0, 0.1]))
def test_rate_against_the_double_library(model: Model, seed: int, broken: float) -> None:
    """Where samples are missed, the line through them is rounded to integers."""
    ours, theirs, _ = compare(model, random_reference(seed, model, broken=broken))
    guard = dequantised(parameters.q31(model)).rate.max_um_per_s
    rounding = 2 / (guard * SAMPLE_TIME_S * ONE) if broken else 0.0
    np.testing.assert_allclose(ours.rate_um_per_s / model.rate.max_um_per_s, theirs.rate_um_per_s / guard,
                               rtol=0, atol=3e-8 + rounding)


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_the_same_codes_to_one(bits: int) -> None:
    for seed in range(20):
        model = random_model(seed, dac_bits=bits)
        ours, theirs, _ = compare(model, random_reference(seed, model))
        codes = [column.dac_code.astype(int) for column in (ours, theirs)]
        assert np.abs(codes[0] - codes[1]).max() <= 1 and np.mean(codes[0] == codes[1]) > 0.97
        np.testing.assert_array_equal(ours.flags & ~np.uint32(SLEW), theirs.flags & ~np.uint32(SLEW))
        step_V = (model.drive.max_V - model.drive.min_V) / (2**bits - 1)
        at_codes = model.drive.min_V + ours.dac_code * step_V
        np.testing.assert_allclose(ours.drive_V, at_codes, rtol=0, atol=1e-3 * step_V)


@settings(max_examples=60)
@given(MODELS, SEEDS, st.floats(0, 3))
def test_forward_and_predict(model: Model, seed: int, share: float) -> None:
    random = np.random.default_rng(seed)
    command = random.uniform(model.drive.min_V, model.drive.max_V, 60)
    rate = random.uniform(0, share * model.rate.max_um_per_s, 60)
    fixed, double = FixedPoint(model, SAMPLE_TIME_S), Firmware(model, SAMPLE_TIME_S, "f64")
    close = dict(rtol=0, atol=2e-7 * float(np.abs(double.predict(command, rate) - model.offset_um).max() + 1))
    np.testing.assert_allclose(fixed.predict(command, rate), double.predict(command, rate), **close)
    np.testing.assert_allclose(fixed.forward(command, rate), double.forward(command, rate), **close)
    np.testing.assert_allclose(fixed.memory_um, double.memory_um, rtol=0, atol=1e-6)
    assert fixed.counts == double.counts


@settings(max_examples=60)
@given(MODELS, SEEDS)
def test_round_trip(model: Model, seed: int) -> None:
    """The drive brings the reference back until a limit clips it: the worst over slopes down to 1 / 40."""
    assume(model.drive.dac_bits is None)
    reference = random_reference(seed, model, broken=0.05)
    steps = FixedPoint(model, SAMPLE_TIME_S).step(reference)
    moved = operators.forward(model, steps.drive_V, steps.rate_um_per_s, model.memory.plays_um)[0]
    followed = (steps.flags & (INPUT | RANGE | SLEW)) == 0
    np.testing.assert_allclose(moved[followed], reference[followed], rtol=0, atol=1e-6 * model.stroke_um)


@pytest.mark.parametrize(("drive_V", "rate"), [(math.nan, 0.0), (math.inf, 0.0), (1e9, 0.0), (1.0, math.nan),
                                               (1.0, -1.0), (1.0, math.inf)])
def test_forward_ignores_what_is_no_input(drive_V: float, rate: float) -> None:
    fixed = FixedPoint(MODEL, SAMPLE_TIME_S)
    before = fixed.forward(np.array([MODEL.drive.min_V]), np.zeros(1)), fixed.memory_um
    if rate != math.inf:
        assert np.isnan(fixed.predict(np.array([drive_V]), np.array([rate])))
    after = fixed.forward(np.array([drive_V]), np.array([rate])), fixed.memory_um
    assert after[0] == before[0] and after[1].tolist() == before[1].tolist() and fixed.counts["input"] == 1


# ---- the state ----

def test_missed_and_refused_samples() -> None:
    reference = random_reference(2, MODEL, 60)
    reported, refused = FixedPoint(MODEL, SAMPLE_TIME_S), FixedPoint(MODEL, SAMPLE_TIME_S)
    reported.step(reference[:30])
    reported.missed(5)
    held = refused.step(np.concatenate([reference[:30], [np.nan, np.inf, -np.inf, 1.1e6, -1e300]]))
    assert held.flags[30:].tolist() == [INPUT] * 5 and len(set(held.drive_V[29:])) == 1
    rest = reported.step(reference[30:])
    for one, other in zip(rest, refused.step(reference[30:])):
        np.testing.assert_array_equal(one, other)
    assert rest.flags[0] & MISSED and not rest.flags[1] & MISSED
    assert (reported.counts["missed"], refused.counts["input"]) == (5, 5)


@pytest.mark.parametrize("bits", [None, 12])
@pytest.mark.parametrize("seed", [1, 3], ids=["rising", "falling"])
def test_sweep(seed: int, bits: int | None) -> None:
    """The drives are those of the double library also where the gain is negative."""
    model = random_model(seed, plays=4, deadzones=1, dac_bits=bits)
    model.drive = replace(model.drive, sweep_cycles=7, sweep_end_V=0.8 * model.drive.min_V + 0.2 * model.drive.max_V)
    fixed, double, other = (FixedPoint(model, SAMPLE_TIME_S), Firmware(model, SAMPLE_TIME_S, "f64"),
                            FixedPoint(model, SAMPLE_TIME_S))
    other.step(random_reference(3, model))
    drive_V, codes = fixed.sweep()
    expected_V, expected = double.sweep()
    assert abs(len(drive_V) - len(expected_V)) <= 15  # a sample at each turn
    assert drive_V[-1] == pytest.approx(expected_V[-1], abs=1e-6) == other.sweep()[0][-1]
    for pick in (np.min, np.max, lambda column: column[-1]):
        assert pick(codes) == pick(expected)
    assert (drive_V.min(), drive_V.max()) == (pytest.approx(model.drive.min_V), pytest.approx(model.drive.max_V))
    np.testing.assert_allclose(fixed.memory_um, other.memory_um, rtol=0, atol=1e-6)
    np.testing.assert_allclose(fixed.memory_um, double.memory_um, rtol=0, atol=1e-3 * model.stroke_um)


@settings(max_examples=60)
@given(MODELS, SEEDS)
def test_memory_moves_from_one_instance_to_another(model: Model, seed: int) -> None:
    first, second = FixedPoint(model, SAMPLE_TIME_S), FixedPoint(model, SAMPLE_TIME_S)
    first.step(random_reference(seed, model))
    second.memory_um = first.memory_um
    np.testing.assert_array_equal(second.memory_um, first.memory_um)


@pytest.mark.parametrize("states", [[0.0, 0.0, 0.0, 0.0, 50.0], [1e3] * 5, [1e30] * 5, [math.nan] * 5])
def test_impossible_memory_changes_nothing(states: list[float]) -> None:
    fixed = FixedPoint(MODEL, SAMPLE_TIME_S)
    fixed.step(random_reference(1, MODEL, 20))
    before = fixed.memory_um
    with pytest.raises(BadInput, match="memory is not a state"):
        fixed.memory_um = np.array(states)
    np.testing.assert_array_equal(fixed.memory_um, before)
    with pytest.raises(BadInput, match="states for"):
        fixed.memory_um = np.zeros(1)
    with pytest.raises(BadInput, match="drives"):
        fixed.forward(np.zeros(5), np.zeros(1))


def test_flags_and_counts() -> None:
    steps = FixedPoint(MODEL, SAMPLE_TIME_S)
    flags = [int(flag) for flag in steps.step(np.array([np.nan, 0.0, 1e5, np.inf, -1e5])).flags]
    assert flags[0] == flags[3] == INPUT and flags[2] & GUARD
    assert steps.counts == {"guard": sum(flag & GUARD > 0 for flag in flags),
                            "clip": sum(flag & (RANGE | SLEW) > 0 for flag in flags), "input": 2, "missed": 0}


def test_types_and_shapes() -> None:
    steps = FixedPoint(MODEL, SAMPLE_TIME_S).step([MODEL.offset_um] * 3)
    assert [column.dtype for column in steps] == [float, float, np.uint32, np.uint32]
    assert [column.shape for column in steps] == [(3,)] * 4
    assert FixedPoint(MODEL, SAMPLE_TIME_S).step(np.zeros(0)).drive_V.shape == (0,)
