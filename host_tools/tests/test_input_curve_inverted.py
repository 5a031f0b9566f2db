"""The input curve behind the exact inverse: its points, its way into the firmware, and what the firmware makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models import random_model, steps_of
from rdpi.errors import BadInput
from rdpi.firmware import library, parameters
from rdpi.model import Drive, Model, along, operators
from rdpi.simulate.effects.input_curve import InputCurve

CURVES = [(0.0, 0.0), (0.15, 0.0), (-0.3, 0.2), (0.1, 0.4), (0.0, -0.4)]  # quadratic, cubic
T_S = 1e-4


def values(quadratic: float, cubic: float, low_V: float = 0.0, high_V: float = 100.0) -> dict[str, float]:
    return {"quadratic": quadratic, "cubic": cubic, "low_V": low_V, "high_V": high_V}


def bent(seed: int, pieces: int, bits: int | None, slew: bool = False) -> Model:
    """A random model with a random curve whose corners lie at codes; gains of either sign."""
    model, random = random_model(seed, plays=3 + seed % 4, deadzones=seed % 3), np.random.default_rng(seed)
    low, high = model.drive.min_V, model.drive.max_V
    shares = (np.arange(pieces + 1) + np.r_[0, random.uniform(-0.3, 0.3, pieces - 1), 0]) / pieces
    if bits:
        shares = np.rint(shares * (2**bits - 1)) / (2**bits - 1)
    output_V = low + (high - low) * shares
    output_V[-1] = high
    plays_V = low + np.r_[0, np.cumsum(np.diff(output_V) * random.uniform(0.5, 2, pieces))]
    plays_V += (high - low) / 2 - (plays_V[-1] - low) / 2
    curve = tuple(zip(output_V.tolist(), plays_V.tolist()))
    drive = Drive(low, high, (high - low) * 200 if slew else None, bits, curve_V=curve)
    model = replace(model, drive=drive, rate=replace(model.rate, window_s=0.0, filter_s=0.0))
    rest_um = float(model.x_of((low + high) / 2))
    return replace(model, memory=replace(model.memory, x_um=rest_um, plays_um=np.full(len(model.thresholds_um), rest_um)))


def references(model: Model, samples: int = 1500) -> np.ndarray:
    """Into both ends of the range and out again, and with ever larger loops."""
    ends = operators.forward(model, np.array([model.drive.min_V, model.drive.max_V]), np.zeros(2), model.memory.plays_um)[0]
    k = np.arange(samples)
    return ends.mean() + np.ptp(ends) / 2 * np.sin(0.02 * k) * np.linspace(0.05, 1.2, samples)


def test_no_two_points_of_a_coarse_dac_lie_at_one_code() -> None:
    """Rounding to volts left two at the last code, an ulp apart."""
    points, _ = InputCurve().pieces(values(-0.103, 0.091, -25.61, 75.63), -25.61, 75.63, 2)
    codes = (np.array([volts for volts, _ in points]) + 25.61) / (75.63 + 25.61) * 3
    assert np.all(np.diff(codes) > 0.5) and codes == pytest.approx(np.rint(codes))


@pytest.mark.parametrize(("quadratic", "cubic"), CURVES)
@pytest.mark.parametrize(("low_V", "high_V", "bits"), [(0.0, 100.0, None), (-10.0, 110.0, 16), (20.0, 90.0, 5)])
def test_the_pieces_follow_the_curve(quadratic: float, cubic: float, low_V: float, high_V: float, bits: int | None) -> None:
    effect, given = InputCurve(), values(quadratic, cubic)
    points, error_V = effect.pieces(given, low_V, high_V, bits)
    output_V, plays_V = np.array(points).T
    assert 2 <= len(points) <= 9 and (output_V[0], output_V[-1]) == (low_V, high_V)
    assert np.all(np.diff(output_V) > 0) and np.all(np.diff(plays_V) > 0)
    if bits:
        codes = (output_V - low_V) / (high_V - low_V) * (2**bits - 1)
        assert codes == pytest.approx(np.rint(codes), abs=1e-6)
    fine_V = np.linspace(low_V, high_V, 20011)
    largest_V = np.max(np.abs(along(fine_V, output_V, plays_V) - effect.bent(fine_V, given)))
    assert largest_V == pytest.approx(error_V, rel=0.01, abs=1e-9)
    if bits != 5:  # eight equal pieces through the curve
        even_V = np.linspace(low_V, high_V, 9)
        equal_V = np.max(np.abs(along(fine_V, even_V, effect.bent(even_V, given)) - effect.bent(fine_V, given)))
        assert largest_V <= 0.75 * equal_V + 1e-7


def test_a_straight_curve_is_one_piece() -> None:
    points, error_V = InputCurve().pieces(values(0, 0), -20.0, 120.0, 16)
    assert points == ((-20.0, -20.0), (120.0, 120.0)) and error_V < 1e-12


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("engine", ["f64", "f32", "q31"])
def test_the_library_does_what_numpy_does(seed: int, engine: str) -> None:
    bits = [None, 10, 16][seed % 3]
    model = bent(seed, 1 + seed, bits, slew=seed % 2 == 1)
    z = references(model)
    theirs, states_um = steps_of(model, z, T_S)
    one = library.engine(model, T_S, engine)
    ours = one.step(z)
    span_V = model.drive.max_V - model.drive.min_V
    tolerance_V = span_V * {"f64": 1e-12, "f32": 1e-4, "q31": 1e-5}[engine]
    code_V = span_V / (2**bits - 1) if bits else 0.0
    off_V = np.abs(ours.drive_V - theirs.drive_V)
    assert np.max(off_V) <= tolerance_V + 1.001 * code_V
    assert np.mean(off_V > tolerance_V) <= 0.05  # rounding decides some codes
    assert np.mean(ours.flags != theirs.flags) <= 0.005
    assert np.any(theirs.flags & operators.RANGE)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("engine", ["f64", "f32", "q31"])
def test_the_plays_follow_what_was_output(seed: int, engine: str) -> None:
    """The drives, put into the model behind its curve, give the references back, and the states."""
    model = bent(seed, 8 - seed, None)
    one = library.engine(model, T_S, engine)
    z = references(model)
    steps = one.step(z)
    predicted, states_um = operators.forward(model, steps.drive_V.astype(float), steps.rate_um_per_s.astype(float),
                                             model.memory.plays_um)
    free = (steps.flags & operators.RANGE) == 0
    stroke_um = np.ptp(z)
    tolerance = {"f64": 1e-12, "f32": 2e-5, "q31": 2e-6}[engine]
    assert np.max(np.abs(predicted - z)[free]) <= tolerance * stroke_um
    assert one.memory_um == pytest.approx(states_um, abs=tolerance * stroke_um)


@pytest.mark.parametrize("engine", ["f64", "f32", "q31"])
def test_forward_sweep_and_memory_go_through_the_curve(engine: str) -> None:
    model = bent(5, 6, None)
    one = library.engine(model, 1e-3, engine)
    span_V = model.drive.max_V - model.drive.min_V
    drive_V = np.linspace(model.drive.min_V, model.drive.max_V, 50)
    expected, states_um = operators.forward(model, drive_V, np.zeros(50), model.memory.plays_um)
    assert one.forward(drive_V, np.zeros(50)) == pytest.approx(expected, abs=2e-5 * np.ptp(expected))
    assert one.memory_um == pytest.approx(states_um, abs=2e-5 * np.ptp(expected))
    swept_V, _ = one.sweep()
    assert swept_V[-1] == pytest.approx(model.sweep_end(), abs=1e-4 * span_V)
    assert one.memory_um[0] == pytest.approx(float(model.x_of(model.sweep_end())), abs=2e-5 * np.ptp(expected))
    one.memory_um = np.full(len(states_um), float(model.x_of(drive_V[20])))
    assert one.predict(drive_V[20:21], np.zeros(1)) == pytest.approx(
        operators.forward(model, drive_V[20:21], np.zeros(1), one.memory_um.astype(float))[0], abs=2e-5 * np.ptp(expected))


@pytest.mark.parametrize("seed", range(4))
def test_two_points_are_a_gain_and_an_offset(seed: int) -> None:
    model = bent(seed, 1, 12)
    plain = parameters._straight(model)
    z = references(model, 500)
    for engine in ("f64", "q31"):
        ours, theirs = (library.engine(one, T_S, engine).step(z) for one in (model, plain))
        assert np.max(np.abs(ours.dac_code.astype(int) - theirs.dac_code.astype(int))) <= 1
    assert parameters.q31(model).curve_pieces == parameters.f32(model).curve_pieces == 1


def test_the_digest_covers_the_curve() -> None:
    model = bent(3, 8, 16)
    assert model.digest() != replace(model, drive=replace(model.drive, curve_V=())).digest()


@pytest.mark.parametrize(("points", "words"), [
    (((0.0, 0.0),), "must be 2 to 9 points"), (tuple((float(k), float(k)) for k in range(10)), "must be 2 to 9 points"),
    (((0.0, 0.0), (5.0, 6.0), (10.0, 6.0)), "increase in both columns"),
    (((0.0, 0.0), (5.0, float("nan")), (10.0, 10.0)), "must be finite"),
    (((0.0, 0.0), (9.0, 10.0)), "is from 0 to 9 V; must be over the range of the drive, 0 to 10 V")])
def test_a_curve_that_is_none_is_refused(points: tuple, words: str) -> None:
    model = bent(0, 1, None)
    model = replace(model, drive=replace(model.drive, min_V=0.0, max_V=10.0, curve_V=points))
    with pytest.raises(BadInput, match=rf"drive\.curve_V: .*{words}"):
        model.validate()
