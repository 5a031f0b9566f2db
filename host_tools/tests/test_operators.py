"""The NumPy operators: each equation against hand or brute force, the chain against the library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from models import MODELS, SAMPLE_TIME_S, SEEDS, random_model, random_reference, steps_of

from rdpi.firmware import Firmware
from rdpi.model import Drive, Memory, Model, Rate, operators
from rdpi.model.operators import GUARD, INPUT, MISSED, RANGE, SLEW
from rdpi.simulate import numpy_inverse


def small_model(**changes: object) -> Model:
    """Two plays, one dead zone, 10 um over 100 V: values that can be followed by hand."""
    model = Model(
        gain_um_per_V=0.1, offset_V=0.0, offset_um=1.0, stroke_um=10.0, thresholds_um=np.array([0.0, 2.0]),
        slopes=np.array([0.5, 1.0]), slope_rate_s_per_um=np.array([-0.001, 0.0]), deadzones_um=np.array([0.0, 4.0]),
        deadzone_weights=np.array([1.0, -0.5]), rate=Rate(max_um_per_s=300.0), drive=Drive(0.0, 100.0), memory=Memory())
    return replace(model, **changes)


# ---- the equations one by one ----

def test_eq_1_play() -> None:
    r = np.array([0.0, 1.0, 2.0])
    y = operators.play(1.5, r, np.zeros(3))
    assert y.tolist() == [1.5, 0.5, 0.0]
    y = operators.play(-1.25, r, y)
    assert y.tolist() == [-1.25, -0.25, 0.0]
    assert operators.play(-1.0, r, y).tolist() == [-1.0, -0.25, 0.0], "a reversal moves no play inside its slack"
    outputs, end = operators.plays(np.array([1.5, -1.25, -1.0]), r, np.zeros(3))
    assert outputs.tolist() == [[1.5, 0.5, 0.0], [-1.25, -0.25, 0.0], [-1.0, -0.25, 0.0]]
    assert end.tolist() == outputs[-1].tolist()


def test_plays_of_nothing() -> None:
    outputs, end = operators.plays(np.zeros(0), np.array([0.0, 1.0]), np.array([3.0, 2.5]))
    assert outputs.shape == (0, 2) and end.tolist() == [3.0, 2.5]


def test_eq_14_to_16_weights() -> None:
    model = small_model()
    assert operators.play_weights(model, 0.0).tolist() == [0.5, 0.5]
    assert operators.play_weights(model, np.array([0.0, 200.0])).tolist() == [[0.5, 0.5], [0.3, 0.7]]


@given(MODELS)
def test_slopes_are_those_of_the_loading_curve(model: Model) -> None:
    """From rest, v(x) climbs by W_i per um between r_i and r_(i+1): what cumulative slopes mean (eq. 9 and 16)."""
    r = model.thresholds_um
    x = np.append(r, r[-1] + 1)
    outputs = operators.plays(x, r, np.zeros(len(r)))[0]
    v = operators.bank(outputs, operators.play_weights(model, 0.0))
    np.testing.assert_allclose(np.diff(v) / np.diff(x), model.slopes, rtol=1e-9)


def test_eq_7_and_8_saturation() -> None:
    d, weights = np.array([0.0, 1.0, 3.0]), np.array([1.0, -0.2, 0.5])
    assert operators.dead_zone(np.array([-2.0, 2.0, 5.0]), d).tolist() == [[-2, 0, 0], [2, 1, 0], [5, 4, 2]]
    np.testing.assert_allclose(operators.saturation(np.array([-2.0, 0.5, 2.0, 5.0]), d, weights), [-2, 0.5, 1.8, 5.2])


def test_eq_13_inverse_saturation() -> None:
    d, weights = np.array([0.0, 1.0, 3.0]), np.array([1.0, -0.2, 0.5])  # slopes 1, 0.8 and 1.3
    np.testing.assert_allclose(operators.inverse_thresholds(d, weights), [0, 1, 2.6])
    np.testing.assert_allclose(operators.inverse_weights(weights), [1, 1 / 0.8 - 1, 1 / 1.3 - 1 / 0.8])
    np.testing.assert_allclose(operators.saturation_inverse(np.array([-2.0, 0.5, 1.8, 5.2]), d, weights),
                               [-2, 0.5, 2, 5])


@given(MODELS, st.floats(-50, 50))
def test_saturation_and_its_inverse_undo_each_other(model: Model, v_um: float) -> None:
    z = operators.saturation(v_um, model.deadzones_um, model.deadzone_weights)
    back = operators.saturation_inverse(z, model.deadzones_um, model.deadzone_weights)
    assert back == pytest.approx(v_um, rel=1e-12, abs=1e-12)


def test_eq_12_inverse_plays() -> None:
    """Slopes 1, 0.5 and 2: the loading curve passes 0, 1 and 1.5 at the thresholds; inverse slopes 1, 2 and 0.5."""
    r, weights = np.array([0.0, 1.0, 2.0]), np.array([1.0, -0.5, 1.5])
    assert operators.inverse_thresholds(r, weights).tolist() == [0.0, 1.0, 1.5]
    assert operators.inverse_weights(weights).tolist() == [1.0, 1.0, -1.5]
    # At x = 3 from rest y = (3, 2, 1), v = 3.5; all plays engaged, so y' = v - r'.
    assert operators.inverse_states(np.array([3.0, 2.0, 1.0]), weights).tolist() == [3.5, 2.5, 2.0]


def test_eq_17_forward() -> None:
    """x = 4 at rest: y = (4, 2), v = 3, z = 3; x = 8 at 100 um/s: y = (8, 6), W_0 = 0.4, v = 6.8, z = v - 1.4."""
    z, states = operators.forward(small_model(), np.array([40.0, 80.0]), np.array([0.0, 100.0]), np.zeros(2))
    np.testing.assert_allclose(z, [3 + 1, 5.4 + 1])
    np.testing.assert_allclose(states, [8, 6])


def test_forward_clamps_the_rate() -> None:
    """x = 4 at 300 um/s or more: W_0 = 0.2, v = 0.2 * 2 + 2."""
    for rate in (300.0, 1e9):
        z = operators.forward(small_model(), np.array([40.0]), np.array([rate]), np.zeros(2))[0]
        np.testing.assert_allclose(z, 2.4 + 1)


# ---- the inverses ----

def test_solve_by_hand() -> None:
    """y = (0, 0), r = (0, 2), slopes 0.5 and 1: 1 um of v up to x = 2, then slope 1; downwards the mirror image."""
    r, weights = np.array([0.0, 2.0]), np.array([0.5, 0.5])
    assert [operators.solve(v, r, weights, np.zeros(2)) for v in (0.25, 1.0, 4.0, -0.25, -4.0)] == [0.5, 2, 5, -0.5, -5]
    # After x = 5 the second play stands at 3 and v at 4; on the way back it engages at x = 1.
    assert [operators.solve(v, r, weights, np.array([5.0, 3.0])) for v in (4.0, 3.0, 1.0)] == [5, 3, 0]


@given(MODELS, st.floats(-100, 100), st.floats(0, 2))
def test_solve_against_bisection(model: Model, v_um: float, share: float) -> None:
    y = model.memory.plays_um
    weights = operators.play_weights(model, operators.guard(model.rate, share * model.rate.max_um_per_s))
    low, high = -1e6, 1e6
    while low < (middle := (low + high) / 2) < high:
        below = operators.bank(operators.play(middle, model.thresholds_um, y), weights) < v_um
        low, high = (middle, high) if below else (low, middle)
    assert operators.solve(v_um, model.thresholds_um, weights, y) == pytest.approx(high, rel=1e-11, abs=1e-11)


@settings(max_examples=50)
@given(MODELS, SEEDS)
def test_exact_inverse_round_trip(model: Model, seed: int) -> None:
    """Unlimited, the drive put into the forward operator gives the reference back, whatever the rates."""
    model = replace(model, drive=Drive(-1e6, 1e6))
    reference = random_reference(seed, model, 60)
    steps = steps_of(model, reference, SAMPLE_TIME_S)[0]
    back = operators.forward(model, steps.drive_V, steps.rate_um_per_s, model.memory.plays_um)[0]
    np.testing.assert_allclose(back, reference, rtol=0, atol=1e-12 * model.stroke_um)


@settings(max_examples=50)
@given(MODELS, SEEDS, st.floats(0, 1))
def test_formula_inverse_is_exact_at_constant_rate(model: Model, seed: int, share: float) -> None:
    z = random_reference(seed, model, 60) - model.offset_um
    rate = np.full(len(z), share * model.rate.max_um_per_s)
    x = operators.formula_inverse(model, z, rate, model.memory.plays_um)
    y, exact = model.memory.plays_um, np.empty_like(x)
    for k, v in enumerate(operators.saturation_inverse(z, model.deadzones_um, model.deadzone_weights)):
        exact[k] = operators.solve(v, model.thresholds_um, operators.play_weights(model, rate[k]), y)
        y = operators.play(exact[k], model.thresholds_um, y)
    np.testing.assert_allclose(x, exact, rtol=0, atol=1e-10)


TIME_S = np.arange(10_000) / 10_000
PROFILES = {
    "10 Hz": 6.25 * np.sin(2 * np.pi * 10 * TIME_S),
    "5-20-35 Hz": sum(a * np.sin(2 * np.pi * f * TIME_S) for a, f in ((2.7, 5), (2.2, 20), (1.6, 35))),
}


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("law", "singular_um_per_s", "low", "high"), [("mild", 7250, 0.05, 0.12),
                                                                       ("strong", 1450, 0.35, 0.55)])
def test_formula_inverse_with_a_rate_law(profile: str, law: str, singular_um_per_s: float, low: float, high: float,
                                         record_property: Callable[[str, object], None]) -> None:
    """Its error is what theory.md says, 0.05 to 0.55 % rms; the paper's whole tracking error is 0.9 %."""
    i = np.arange(10)
    model = small_model(
        thresholds_um=6.25 * i / 9, slopes=0.6 + 0.06 * i, slope_rate_s_per_um=-0.6 * (1 - i / 18) / singular_um_per_s,
        deadzones_um=np.zeros(1), deadzone_weights=np.ones(1), rate=Rate(max_um_per_s=0.8 * singular_um_per_s),
        drive=Drive(-1000, 1000), memory=Memory(), offset_um=0.0)
    model.validate()
    z = PROFILES[profile]
    rest = np.zeros(10)
    rate = operators.rate(z, SAMPLE_TIME_S, 0.0, 0.0)
    x = operators.formula_inverse(model, z, rate, rest)
    error = operators.forward(model, x / model.gain_um_per_V, rate, rest)[0] - z
    steps = Firmware(model, SAMPLE_TIME_S, "f64").step(z)
    exact = operators.forward(model, steps.drive_V, steps.rate_um_per_s, rest)[0] - z
    percent = 100 / np.ptp(z)
    rms, peak = percent * np.sqrt(np.mean(error**2)), percent * np.max(np.abs(error))
    print(f"\nformula inverse, {law} law, {profile}: rms {rms:.3f} %, max {peak:.3f} % of stroke; "
          f"exact inverse: max {percent * np.max(np.abs(exact)):.1e} %")
    record_property("formula_inverse_rms_percent", round(float(rms), 4))
    assert low < rms < high
    assert np.max(np.abs(exact)) * percent < 1e-10


# ---- rate and limits ----

@pytest.mark.parametrize(("window_s", "filter_s", "expected"), [
    (0.0, 0.0, [0, 10, 20, 0, 10]),
    (0.14, 0.0, [0, 10, 20, 0, 10]),  # N = round(1.4)
    (0.16, 0.0, [0, 5, 15, 10, 5]),  # N = round(1.6); z_0 stands for what came before
    (0.0, 0.1 / np.log(2), [0, 5, 12.5, 6.25, 8.125]),  # half of each step's news
    (9.0, 0.0, [0, 1 / 9, 3 / 9, 3 / 9, 2 / 9]),
])
def test_rate(window_s: float, filter_s: float, expected: list[float]) -> None:
    z = np.array([5.0, 6.0, 8.0, 8.0, 7.0])
    np.testing.assert_allclose(operators.rate(z, 0.1, window_s, filter_s), expected, atol=1e-12)


@given(SEEDS, st.sampled_from([0, 1, 2, 5, 30]), st.sampled_from([0.0, 0.3, 1.0, 40.0]))
def test_rate_against_its_recurrence(seed: int, window: int, filter_samples: float) -> None:
    """The formula of contract.md with explicit indices."""
    z = np.random.default_rng(seed).normal(size=40)
    n = max(1, window)
    filtered, expected = 0.0, []
    for k in range(len(z)):
        raw = abs(z[k] - z[k - n if k >= n else 0]) / (n * 1e-3)
        filtered += (1 - np.exp(-1 / filter_samples)) * (raw - filtered) if filter_samples else raw - filtered
        expected.append(filtered)
    np.testing.assert_allclose(operators.rate(z, 1e-3, window * 1e-3, filter_samples * 1e-3), expected, rtol=1e-9)


@pytest.mark.parametrize(("wish_V", "expected"), [
    (5.0, (5.0, 0)), (9.0, (6.0, SLEW)), (3.0, (4.0, SLEW)), (99.0, (6.0, RANGE | SLEW)), (6.0, (6.0, 0)),
])
def test_limit(wish_V: float, expected: tuple[float, int]) -> None:
    """From 5 V, 10 V/s and 0.1 s: one volt either way."""
    assert operators.limit(Drive(0.0, 10.0, 10.0), wish_V, 5.0, 0.1) == expected


@pytest.mark.parametrize(("wish_V", "expected"), [(-1.0, (0.0, RANGE)), (0.0, (0.0, 0)), (10.5, (10.0, RANGE))])
def test_limit_without_slew(wish_V: float, expected: tuple[float, int]) -> None:
    assert operators.limit(Drive(0.0, 10.0), wish_V, 5.0, 0.1) == expected


def test_quantise() -> None:
    drive = Drive(-1.0, 2.0, dac_bits=2)  # codes 0 to 3 at -1, 0, 1 and 2 V
    assert [operators.quantise(drive, v) for v in (-1.0, -0.51, -0.49, 1.4, 2.0)] == \
        [(-1, 0), (-1, 0), (0, 1), (1, 2), (2, 3)]
    assert operators.quantise(Drive(-1.0, 2.0), 0.3) == (0.3, 0)


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3), st.integers(1, 20))
def test_last_code_stays_inside_the_range(min_V: float, span_V: float, bits: int) -> None:
    drive = Drive(min_V, min_V + span_V, dac_bits=bits)
    assert operators.quantise(drive, drive.max_V) == (pytest.approx(drive.max_V), 2**bits - 1)
    assert operators.quantise(drive, drive.max_V)[0] <= drive.max_V


# ---- the whole chain ----

def test_step_by_hand() -> None:
    """0.1 s apart, so 20 um/s at the second sample: W_0 = 0.48."""
    model = small_model()
    steps, states = steps_of(model, np.array([1.0, 3.0, np.nan, 3.0]), 0.1)
    # z = 2 from x = 0: 0.96 up to x = 2, then slope 1. At rate 0 the states y = (3.04, 1.04) make v = 2.04: back by
    # 0.04 / 0.5. The sample between holds.
    np.testing.assert_allclose(steps.drive_V, [0, 30.4, 30.4, 29.6], atol=1e-9)
    np.testing.assert_allclose(steps.rate_um_per_s, [0, 20, 20, 0], atol=1e-9)
    assert steps.flags.tolist() == [0, 0, INPUT, MISSED] and steps.dac_code.tolist() == [0, 0, 0, 0]
    np.testing.assert_allclose(states, [2.96, 1.04])


@pytest.mark.parametrize(("gap", "rate"), [(1, 10.0), (3, 5.0), (16, 20 / 17), (17, 0.0)])
def test_a_gap_counts_its_time(gap: int, rate: float) -> None:
    """2 um in gap + 1 steps of 0.1 s; after a longer gap the estimator starts afresh."""
    steps, _ = steps_of(small_model(), np.array([1.0, *[np.nan] * gap, 3.0, 3.0]), 0.1)
    assert steps.flags.tolist() == [0, *[INPUT] * gap, MISSED, 0]
    np.testing.assert_allclose(steps.rate_um_per_s, [*[0.0] * (gap + 1), rate, 0.0], atol=1e-12)


@given(SEEDS, st.sampled_from([1, 2, 5]), st.sampled_from([0.0, 2e-4]), st.integers(0, 16))
def test_a_gap_on_a_straight_line_goes_unnoticed(seed: int, window: int, filter_s: float, gap: int) -> None:
    z = np.random.default_rng(seed).normal(size=40)
    z[20:20 + gap + 2] = np.linspace(z[20], z[20 + gap + 1], gap + 2)
    whole = operators.rate(z, 1e-4, window * 1e-4, filter_s)
    law = Rate(window_s=window * 1e-4, filter_s=filter_s, max_um_per_s=1e6)
    estimator = numpy_inverse.RateOf(small_model(rate=law), 1e-4)
    for k in (k for k in range(len(z)) if not 20 < k <= 20 + gap):
        assert estimator.step(z[k], gap if k == 21 + gap else 0) == pytest.approx(whole[k], rel=1e-9)


def test_step_commits_what_was_output() -> None:
    """Clipped at 20 V the plays stand at x = 2, and an 8-bit code holds them on its grid."""
    steps, states = steps_of(small_model(drive=Drive(0.0, 20.0)), np.array([1.0, 9.0, 9.0]), 0.1)
    assert steps.drive_V.tolist() == [0, 20, 20] and steps.flags.tolist() == [0, RANGE, RANGE]
    assert states.tolist() == [2, 0]
    steps, states = steps_of(small_model(drive=Drive(0.0, 100.0, dac_bits=8)), np.array([1.0, 3.0]), 0.1)
    assert steps.dac_code.tolist() == [0, 78] and steps.drive_V[1] == pytest.approx(78 / 2.55)
    assert states[0] == pytest.approx(7.8 / 2.55)


def test_step_flags_the_guard() -> None:
    steps, _ = steps_of(small_model(), np.array([1.0, 2.0]), 0.001)
    assert steps.flags.tolist() == [0, GUARD] and steps.rate_um_per_s.tolist() == [0, 300]


def test_step_leaves_a_code_however_slow_the_slew() -> None:
    """A tenth of a code per sample: the slew goes on below the code's resolution."""
    model = small_model(drive=Drive(0.0, 100.0, slew_V_per_s=0.1 * 100 / 255, dac_bits=8))
    steps, _ = steps_of(model, np.full(100, 9.0), 1.0)
    assert steps.dac_code[[3, 4, 99]].tolist() == [0, 1, 10]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1.0001e6, -1.0001e6])
def test_step_of_unusable_references_only(bad: float) -> None:
    model = small_model(memory=Memory(5.0, np.array([5.0, 4.0])))
    steps, states = steps_of(model, np.full(3, bad), SAMPLE_TIME_S)
    assert steps.drive_V.tolist() == [50, 50, 50] and steps.flags.tolist() == [INPUT] * 3
    assert not steps.rate_um_per_s.any() and states.tolist() == [5, 4]


def test_step_of_nothing() -> None:
    steps, states = steps_of(small_model(), np.zeros(0), SAMPLE_TIME_S)
    assert [(len(column), column.dtype) for column in steps] == [(0, float), (0, float), (0, np.uint32), (0, np.uint32)]
    assert states.tolist() == [0, 0]


@settings(max_examples=250)
@given(MODELS, SEEDS, st.sampled_from([0.0, 0.1, 0.9]))
def test_step_against_the_library(model: Model, seed: int, broken: float) -> None:
    """Every value is drawn at random, so that no drive lies on the edge between two codes or two flags."""
    model.validate()
    reference = random_reference(seed, model, broken=broken)
    library = Firmware(model, SAMPLE_TIME_S, "f64")
    theirs, (ours, states) = library.step(reference), steps_of(model, reference, SAMPLE_TIME_S)
    range_V = model.drive.max_V - model.drive.min_V
    # As many slew steps down as up end where they began: rounding decides whether the last one was limited. Elsewhere than
    # at an end of the range so does any change of the reference as small.
    ends = np.minimum(np.abs(ours.drive_V - model.drive.min_V), np.abs(ours.drive_V - model.drive.max_V))
    undecided = np.where((ends < 1e-12 * range_V) & (ours.flags & RANGE > 0), SLEW, 0).astype(np.uint32)
    if model.drive.slew_V_per_s is not None:
        change = 1e-11 * np.random.default_rng(seed).normal(size=len(reference))
        above, below = (steps_of(model, reference + sign * change, SAMPLE_TIME_S)[0].flags for sign in (1, -1))
        undecided |= (above ^ below) & SLEW
    np.testing.assert_array_equal(ours.flags | undecided, theirs.flags | undecided)
    np.testing.assert_array_equal(ours.dac_code, theirs.dac_code)
    np.testing.assert_allclose(ours.drive_V, theirs.drive_V, rtol=0, atol=1e-9 * range_V)
    np.testing.assert_allclose(ours.rate_um_per_s, theirs.rate_um_per_s, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(states, library.memory_um, rtol=0, atol=1e-9 * model.stroke_um)
    flagged = {"guard": GUARD, "clip": RANGE | SLEW, "input": INPUT, "missed": 0}
    assert library.counts == {name: np.count_nonzero(theirs.flags & bits) for name, bits in flagged.items()}


@settings(max_examples=50)
@given(MODELS, SEEDS, st.floats(0, 3))
def test_forward_against_the_library(model: Model, seed: int, share: float) -> None:
    random = np.random.default_rng(seed)
    command = random.uniform(model.drive.min_V, model.drive.max_V, 60)
    rate = random.uniform(0, share * model.rate.max_um_per_s, 60)
    library = Firmware(model, SAMPLE_TIME_S, "f64")
    ours, states = operators.forward(model, command, rate, library.memory_um)
    np.testing.assert_allclose(ours, library.forward(command, rate), rtol=0, atol=1e-12 * model.stroke_um)
    np.testing.assert_allclose(states, library.memory_um, rtol=0, atol=1e-12 * model.stroke_um)


@settings(max_examples=100)
@given(MODELS, SEEDS)
def test_single_precision_round_trip(model: Model, seed: int) -> None:
    """In single precision too the drive brings the reference back, to 1e-5 of the stroke, until a limit clips it.

    Drives are not compared: their rates, differences of rounded references, differ, and so do the slopes.
    """
    assume(model.drive.dac_bits is None)
    reference = random_reference(seed, model, broken=0.05)
    with np.errstate(over="ignore"):  # an absurd reference is infinite in single precision
        steps = Firmware(model, SAMPLE_TIME_S, "f32").step(reference)
    drive_V, rate = (column.astype(float) for column in steps[:2])
    steps.flags[:] &= ~np.uint32(MISSED)
    moved = operators.forward(model, drive_V, rate, model.memory.plays_um)[0]
    followed = steps.flags & ~np.uint32(GUARD) == 0
    np.testing.assert_allclose(moved[followed], reference[followed], rtol=0, atol=1e-5 * model.stroke_um)
    assert np.all(np.isin(drive_V[steps.flags & ~np.uint32(GUARD) == RANGE],
                          np.float32([model.drive.min_V, model.drive.max_V])))


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_single_precision_picks_the_same_codes_to_one(bits: int) -> None:
    model = random_model(7, dac_bits=bits)
    reference = random_reference(7, model)
    single, double = (Firmware(model, SAMPLE_TIME_S, real).step(reference).dac_code.astype(int)
                      for real in ("f32", "f64"))
    assert np.abs(single - double).max() <= 1 and np.mean(single == double) > 0.95
