"""The compiled library from Python: what it refuses, its state, and its blocks against the NumPy operators."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from models import MODELS, SAMPLE_TIME_S, SEEDS, random_model, random_reference

from rdpi import firmware
from rdpi.errors import BadInput
from rdpi.firmware import Firmware
from rdpi.model import Memory, Model, operators

MODEL = random_model(3, plays=4, deadzones=1, slew=True, dac_bits=12)
REALS = ("f32", "f64")


def with_rate(**changes: float) -> Model:
    return replace(MODEL, rate=replace(MODEL.rate, **changes))


def with_drive(**changes: float) -> Model:
    return replace(MODEL, drive=replace(MODEL.drive, **changes))


def with_memory(*plays_um: float) -> Model:
    return replace(MODEL, memory=Memory(plays_um[0], np.array(plays_um)))


# ---- refusals ----

REFUSED = {
    "NaN": (replace(MODEL, offset_um=math.nan), "NaN, infinite or beyond"),
    "infinite guard": (with_rate(max_um_per_s=math.inf), "NaN, infinite or beyond"),
    "too many plays": (replace(MODEL, thresholds_um=np.arange(130.0), slopes=np.ones(130),
                               slope_rate_s_per_um=np.zeros(130), memory=Memory()), "number of plays or dead zones"),
    "no gain": (replace(MODEL, gain_um_per_V=0.0), "gain_um_per_V is 0"),
    "thresholds": (replace(MODEL, thresholds_um=MODEL.thresholds_um[::-1]), "thresholds_um must start at 0"),
    "slopes": (replace(MODEL, slopes=-MODEL.slopes), "slope is not positive"),
    "guard": (with_rate(max_um_per_s=1e6), "a slope falls below"),
    "guard ratio": (with_rate(min_slope_ratio=1.0), "min_slope_ratio"),
    "dead zones": (replace(MODEL, deadzones_um=np.array([0.0, -1.0])), "deadzones_um must start at 0"),
    "saturation": (replace(MODEL, deadzone_weights=np.array([1.0, -1.0])), "saturation stage"),
    "rate window": (with_rate(window_s=-1.0), "rate window"),
    "rate filter": (with_rate(filter_s=-1.0), "filter time"),
    "long window": (with_rate(window_s=5000 * SAMPLE_TIME_S), "more samples than RDPI_MAX_WINDOW"),
    "drive": (with_drive(max_V=MODEL.drive.min_V), "min < max"),
    "slew": (with_drive(slew_V_per_s=-1.0), "slew not negative"),
    "no sweep": (with_drive(sweep_cycles=0), "1 to 10000 cycles"),
    "long sweep": (with_drive(sweep_cycles=10_001), "1 to 10000 cycles"),
    "sweep end": (with_drive(sweep_end_V=2 * MODEL.drive.max_V - MODEL.drive.min_V), "an end in range"),
    "slow sweep": (with_drive(sweep_V_per_s=1e-12), "not too slow"),
    "sweep against the slew limit": (with_drive(sweep_V_per_s=2 * MODEL.drive.slew_V_per_s), "within the slew"),
    "large": (replace(MODEL, offset_um=1.1e7), "beyond 1e7"),
    "DAC": (with_drive(dac_bits=21), "dac_bits"),
    "memory apart": (with_memory(0.0, 0.0, 0.0, 0.0, 50.0), "memory is not a state"),
    "memory outside the drive": (with_memory(*np.full(5, 1e3)), "memory is not a state"),
}


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize(("model", "text"), REFUSED.values(), ids=REFUSED)
def test_what_the_library_refuses_reaches_the_user(model: Model, text: str, real: str) -> None:
    with pytest.raises(BadInput, match="^the firmware library refuses: ") as refused:
        Firmware(model, SAMPLE_TIME_S, real)
    assert text in str(refused.value)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("sample_time_s", [0.0, -1e-4, math.nan, math.inf])
def test_sample_time(sample_time_s: float, real: str) -> None:
    with pytest.raises(BadInput, match="sample time must be positive"):
        Firmware(with_rate(window_s=0.0), sample_time_s, real)


@pytest.mark.parametrize(("sample_time_s", "text"), [
    (0.1, r"sample_time_s is 0\.1, and the firmware takes 5e-07 to 0\.003125 s.*would jump; .*--sweep-rate"),
    (1e-7, r"sample_time_s is 1e-07.*no controller computes more")])
@pytest.mark.parametrize("engine", firmware.ENGINES)
def test_a_sample_time_that_is_no_firmwares_is_refused_but_for_simulations(engine: str, sample_time_s: float,
                                                                           text: str) -> None:
    model = with_drive(sweep_V_per_s=40 * (MODEL.drive.max_V - MODEL.drive.min_V), slew_V_per_s=None)
    model.rate = replace(model.rate, window_s=0.0)
    with pytest.raises(BadInput, match=text):
        firmware.engine(model, sample_time_s, engine)
    firmware.engine(model, sample_time_s, engine, any_sample_time=True)
    firmware.engine(model, 0.0031, engine)


def test_a_sweep_that_no_controller_samples_is_refused() -> None:
    model = random_model(0)  # over 5.7 V
    model.drive = replace(model.drive, sweep_V_per_s=9e6)
    with pytest.raises(BadInput, match=r"drive\.sweep_V_per_s: .* faster than 8 samples of any controller"):
        model.validate()


def test_rate_says_which_window_is_too_long() -> None:
    with pytest.raises(BadInput, match=r"RDPI_MAX_WINDOW.* \(window 0.5 s at 10000 samples/s\); choose a shorter"):
        firmware.rate(np.zeros(20), 1e-4, 0.5, 0.0)


# ---- the state ----

@pytest.mark.parametrize("real", REALS)
def test_starts_from_the_models_memory(real: str) -> None:
    library = Firmware(MODEL, SAMPLE_TIME_S, real)
    np.testing.assert_array_equal(library.memory_um, MODEL.memory.plays_um.astype(firmware.DTYPES[real]))
    assert library.counts == {"guard": 0, "clip": 0, "input": 0, "missed": 0}
    held = library.step(np.array([np.nan]))
    start_V = MODEL.memory.x_um / MODEL.gain_um_per_V + MODEL.offset_V
    assert held.drive_V[0] == pytest.approx(start_V, rel=1e-5) and held.rate_um_per_s[0] == 0
    assert held.dac_code[0] == operators.quantise(MODEL.drive, start_V)[1]


@pytest.mark.parametrize("real", REALS)
def test_memory_moves_from_one_instance_to_another(real: str) -> None:
    """States and drive are all that a rate-independent model remembers, and without a DAC the states hold both."""
    model = random_model(5, falling=False)
    reference = random_reference(5, model)
    first = Firmware(model, SAMPLE_TIME_S, real)
    first.step(reference[:70])
    second = Firmware(model, SAMPLE_TIME_S, real)
    second.memory_um = first.memory_um
    np.testing.assert_array_equal(second.memory_um, first.memory_um)
    rounding = 8 * np.finfo(np.float32 if real == "f32" else float).eps  # how many are engaged is found out anew
    np.testing.assert_allclose(second.step(reference[70:]).drive_V, first.step(reference[70:]).drive_V, rtol=rounding)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("states", [[0.0, 0.0, 0.0, 0.0, 50.0], [1e3] * 5, [math.nan] * 5])
def test_impossible_memory_changes_nothing(states: list[float], real: str) -> None:
    library = Firmware(MODEL, SAMPLE_TIME_S, real)
    library.step(random_reference(1, MODEL, 20))
    before = library.memory_um
    with pytest.raises(BadInput, match="memory is not a state"):
        library.memory_um = np.array(states)
    np.testing.assert_array_equal(library.memory_um, before)


@pytest.mark.parametrize("real", REALS)
def test_reading_the_memory_gives_a_copy(real: str) -> None:
    library = Firmware(MODEL, SAMPLE_TIME_S, real)
    library.memory_um[:] = 99
    assert library.memory_um[0] != 99


@pytest.mark.parametrize("real", REALS)
def test_counts(real: str) -> None:
    library = Firmware(MODEL, SAMPLE_TIME_S, real)
    steps = library.step(np.array([np.nan, 0.0, 1e5, np.inf, -1e5]))
    flags = [int(flag) for flag in steps.flags]
    assert flags[0] == flags[3] == operators.INPUT
    assert library.counts == {"guard": sum(flag & operators.GUARD > 0 for flag in flags),
                              "clip": sum(flag & (operators.RANGE | operators.SLEW) > 0 for flag in flags), "input": 2,
                              "missed": 0}
    library.missed(7)
    assert library.counts["missed"] == 7
    assert library.counts["guard"] == 2 and library.counts["clip"] >= 2


@settings(max_examples=60)
@given(MODELS, SEEDS, st.integers(0, 150), st.sampled_from(REALS))
def test_a_split_run_is_the_whole_run(model: Model, seed: int, cut: int, real: str) -> None:
    reference = random_reference(seed, model)
    whole, parts = Firmware(model, SAMPLE_TIME_S, real), Firmware(model, SAMPLE_TIME_S, real)
    expected = whole.step(reference)
    for column, first, second in zip(expected, parts.step(reference[:cut]), parts.step(reference[cut:])):
        np.testing.assert_array_equal(np.concatenate([first, second]), column)
    np.testing.assert_array_equal(parts.memory_um, whole.memory_um)
    assert parts.counts == whole.counts


def test_instances_do_not_share_state() -> None:
    reference = random_reference(2, MODEL)
    alone = Firmware(MODEL, SAMPLE_TIME_S).step(reference)
    one, other = Firmware(MODEL, SAMPLE_TIME_S), Firmware(MODEL, SAMPLE_TIME_S)
    for k, z in enumerate(reference):
        assert one.step([z]).drive_V[0] == alone.drive_V[k]
        other.step([-z])


def test_parameters_outlive_the_model() -> None:
    """The C struct points into memory that must not be freed, nor change with the model's arrays."""
    model = random_model(3)
    reference = random_reference(3, model)
    expected = Firmware(model, SAMPLE_TIME_S, "f64").step(reference).drive_V
    library = Firmware(model, SAMPLE_TIME_S, "f64")
    for array in (model.slopes, model.thresholds_um, model.deadzone_weights):
        array *= 7
    del model
    np.testing.assert_array_equal(library.step(reference).drive_V, expected)


# ---- results ----

@pytest.mark.parametrize("real", REALS)
def test_types_and_shapes(real: str) -> None:
    steps = Firmware(MODEL, SAMPLE_TIME_S, real).step([MODEL.offset_um] * 3)
    kind = {"f32": np.float32, "f64": np.float64}[real]
    assert [column.dtype for column in steps] == [kind, kind, np.uint32, np.uint32]
    assert [column.shape for column in steps] == [(3,)] * 4
    assert Firmware(MODEL, SAMPLE_TIME_S, real).step(np.zeros(0)).drive_V.shape == (0,)
    assert Firmware(MODEL, SAMPLE_TIME_S, real).forward(np.zeros(2), np.zeros(2)).dtype == kind


def test_any_array_is_taken() -> None:
    """Strided, of another type, read-only: what counts is the values."""
    reference = np.round(random_reference(4, MODEL))
    expected = Firmware(MODEL, SAMPLE_TIME_S).step(reference).drive_V
    strided = np.stack([reference, reference], axis=1)[:, 0]
    fixed = reference.copy()
    fixed.flags.writeable = False
    for same in (strided, reference.astype(int), fixed, list(reference)):
        np.testing.assert_array_equal(Firmware(MODEL, SAMPLE_TIME_S).step(same).drive_V, expected)


@pytest.mark.parametrize(("drive_V", "rate"), [(math.nan, 0.0), (math.inf, 0.0), (1.0, math.nan), (1.0, -1.0)])
def test_forward_ignores_what_is_no_input(drive_V: float, rate: float) -> None:
    library = Firmware(MODEL, SAMPLE_TIME_S, "f64")
    before = library.forward(np.array([MODEL.drive.min_V]), np.zeros(1)), library.memory_um
    after = library.forward(np.array([drive_V]), np.array([rate])), library.memory_um
    assert after[0] == before[0] and after[1].tolist() == before[1].tolist() and library.counts["input"] == 1


@given(MODELS, SEEDS, st.sampled_from(REALS))
def test_forward_of_an_array_is_forward_of_each_sample(model: Model, seed: int, real: str) -> None:
    """To the bit, beside drives out of range, rates above the guard and what is no input."""
    random = np.random.default_rng(seed)
    low, high = model.drive.min_V, model.drive.max_V
    drive = np.clip(np.cumsum(random.normal(0, (high - low) / 8, 120)) + low, low, high)
    rate = random.uniform(0, 1.1 * model.rate.max_um_per_s, 120)
    for odd, at in ((drive, (math.nan, 3 * high - 2 * low, 1e30)), (rate, (math.inf, math.nan, -1.0))):
        odd[random.integers(120, size=3)] = at
    whole, single = Firmware(model, SAMPLE_TIME_S, real), Firmware(model, SAMPLE_TIME_S, real)
    shown = whole.forward(drive, rate)
    each = [single.forward(drive[k:k + 1], rate[k:k + 1]) for k in range(120)]
    np.testing.assert_array_equal(shown, np.concatenate(each))
    assert whole.memory_um.tolist() == single.memory_um.tolist() and whole.counts == single.counts


@pytest.mark.parametrize("real", REALS)
def test_predict_moves_nothing(real: str) -> None:
    library = Firmware(MODEL, SAMPLE_TIME_S, real)
    drive = np.linspace(MODEL.drive.min_V, MODEL.drive.max_V, 9)
    before = library.memory_um
    predicted = library.predict(drive, np.full(9, 50.0))
    np.testing.assert_array_equal(library.memory_um, before)
    for k, expected in enumerate(predicted):
        again = Firmware(MODEL, SAMPLE_TIME_S, real)
        assert again.forward(drive[k:k + 1], np.full(1, 50.0)) == expected
    assert np.isnan(library.predict(np.array([math.nan, 1.0]), np.array([0.0, -1.0]))).all()


# ---- missed samples and the start-up sweep ----

@settings(max_examples=60)
@given(MODELS, SEEDS, st.integers(0, 20), st.sampled_from(REALS))
def test_refused_references_are_missed_samples(model: Model, seed: int, ticks: int, real: str) -> None:
    """Reported by rdpi_f32_missed or refused as NaN: what follows is the same."""
    reference = random_reference(seed, model, 60)
    reported, refused = Firmware(model, SAMPLE_TIME_S, real), Firmware(model, SAMPLE_TIME_S, real)
    reported.step(reference[:30])
    reported.missed(ticks)
    refused.step(np.concatenate([reference[:30], np.full(ticks, np.nan)]))
    for one, other in zip(reported.step(reference[30:]), refused.step(reference[30:])):
        np.testing.assert_array_equal(one, other)
    assert (reported.counts["missed"], refused.counts["input"]) == (ticks, ticks)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("changes", [{}, {"sweep_cycles": 3, "sweep_V_per_s": 100.0, "sweep_end_V": None}])
def test_sweep(real: str, changes: dict) -> None:
    """From both ends towards its own end, as fast as it says; it erases what the plays remember."""
    model = random_model(3, plays=4, deadzones=1)
    model.drive = replace(model.drive, sweep_cycles=7, sweep_end_V=model.drive.min_V + 1.0)
    model.drive = replace(model.drive, **changes)
    drive, end_V, speed = model.drive, model.sweep_end(), model.drive.sweep_speed()
    library, other = Firmware(model, SAMPLE_TIME_S, real), Firmware(model, SAMPLE_TIME_S, real)
    other.step(random_reference(3, model))
    drive_V, codes = library.sweep()
    close = pytest.approx(end_V, abs=1e-5 * (drive.max_V - drive.min_V))
    assert drive_V.shape == codes.shape and not codes.any() and drive_V[-1] == close == other.sweep()[0][-1]
    assert drive_V.max() == pytest.approx(drive.max_V) and drive_V.min() == pytest.approx(drive.min_V)
    assert np.abs(np.diff(drive_V)).max() <= speed * SAMPLE_TIME_S * 1.001 + 1e-5 * np.abs(drive_V).max()
    turns = np.count_nonzero(np.diff(np.sign(np.diff(drive_V))))
    assert turns == 2 * drive.sweep_cycles
    np.testing.assert_allclose(library.memory_um, other.memory_um, rtol=0, atol=1e-5 * model.stroke_um)


# ---- blocks against the operators ----

@settings(max_examples=50)
@given(MODELS, SEEDS)
def test_plays(model: Model, seed: int) -> None:
    x = np.random.default_rng(seed).uniform(-10, 10, 80)
    start = model.memory.plays_um.copy()
    outputs, end = firmware.plays(x, model.thresholds_um, start)
    expected = operators.plays(x, model.thresholds_um, start)
    np.testing.assert_array_equal(outputs, expected[0])
    np.testing.assert_array_equal(end, expected[1])
    np.testing.assert_array_equal(start, model.memory.plays_um)


@settings(max_examples=50)
@given(SEEDS, st.floats(1e-6, 10), st.floats(0, 50), st.none() | st.floats(0.01, 1000))
def test_rate(seed: int, sample_time_s: float, window: float, filter_samples: float | None) -> None:
    z = np.cumsum(np.random.default_rng(seed).normal(size=120))
    window_s, filter_s = window * sample_time_s, (filter_samples or 0.0) * sample_time_s
    np.testing.assert_allclose(firmware.rate(z, sample_time_s, window_s, filter_s),
                               operators.rate(z, sample_time_s, window_s, filter_s), rtol=1e-9)


def test_lengths_that_differ_reach_no_c_code() -> None:
    """The library cannot know how long an array is."""
    library = Firmware(MODEL, SAMPLE_TIME_S)
    with pytest.raises(BadInput, match="states for"):
        library.memory_um = np.zeros(1)
    with pytest.raises(BadInput, match="drives"):
        library.forward(np.zeros(5), np.zeros(1))
    with pytest.raises(BadInput, match="states, "):
        firmware.plays(np.zeros(2), np.array([0.0, 1.0, 2.0]), np.zeros(1))
    with pytest.raises(BadInput, match="^model: slopes: has 2 values"):
        Firmware(replace(MODEL, slopes=np.ones(2)), SAMPLE_TIME_S)
