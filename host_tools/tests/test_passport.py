"""The residual passport: what it holds, what it expects of recordings the model has not seen, malformed ones."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from benches import swept_and_played, vb
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import model_of, rate_of, recording, stack, waves

from rdpi.data import Recording, excite
from rdpi.errors import BadInput
from rdpi.identify import localise, passport, thresholds
from rdpi.identify.identify import Fit, fit
from rdpi.identify.passport import FITTED, LEFT_OUT, OTHER_RUNS, Residual
from rdpi.model import Model, Passport, read_model, write_model
from rdpi.simulate import chain

RATE_HZ = 1000.0
NOISE_UM = 0.004


def left_of(command: np.ndarray, left_um: np.ndarray, name: str = "run.csv", how: str = FITTED,
            rate_hz: float = RATE_HZ) -> Residual:
    """What a model left of an actuator that moves 0.1 um/V without hysteresis."""
    z = 0.1 * command
    run = recording(command, z + left_um, rate_hz, name)
    coords = localise.coordinates(run, z, rate_of(z, rate_hz))
    if how == FITTED:
        return Residual(run, how, None, left_um, coords, NOISE_UM)
    return Residual(run, how, left_um, 0.9 * left_um if how == LEFT_OUT else None, coords, NOISE_UM)


def noise(samples: int, size_um: float | np.ndarray = 1.0, seed: int = 0) -> np.ndarray:
    return size_um * np.random.default_rng(seed).standard_normal(samples)


@lru_cache(maxsize=None)
def plain(runs: int = 3) -> Passport:
    """A passport of runs whose residual is a hundredth of how far they move, and that move at all rates."""
    commands = [np.concatenate([waves(30 + 60 * k / runs, hertz, 4, RATE_HZ) for hertz in (1, 3, 10)])
                for k in range(1, runs + 1)]
    return passport.build([left_of(command, noise(len(command), 0.001 * np.std(command), k), f"run{k}.csv", LEFT_OUT)
                           for k, command in enumerate(commands)])


# --- spectrum --------------------------------------------------------------------------------------------------------

@given(st.integers(16, 3000), st.floats(1e-3, 1e5), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_octaves_add_up_to_the_mean_square(samples: int, rate_hz: float, seed: int) -> None:
    signal = noise(samples, seed=seed)
    signal -= np.mean(signal)
    found = passport.octaves(signal, rate_hz)
    assert np.sum(found.power) == pytest.approx(np.mean(signal**2), rel=1e-9)
    assert np.sum(found.white) == pytest.approx(1)
    edges = 2.0 ** np.array([found.first, found.first + 1, found.first + len(found.power)])
    assert edges[0] <= rate_hz / samples * (1 + 1e-9) < edges[1] * (1 + 1e-9)
    assert edges[2] / 2 < rate_hz / 2 <= edges[2] * (1 + 1e-9)


@pytest.mark.parametrize("octave", [-1, 0, 3, 6, 8])
def test_a_sine_lies_in_its_octave(octave: int) -> None:
    time_s = np.arange(20_000) / RATE_HZ
    found = passport.octaves(np.sin(2 * np.pi * 1.4 * 2.0**octave * time_s), RATE_HZ)
    assert found.power[octave - found.first] > 0.495 and np.sum(found.power) == pytest.approx(0.5, rel=0.01)


def test_white_noise_is_spread_as_said() -> None:
    signal = noise(1 << 16)
    found = passport.octaves(signal - np.mean(signal), RATE_HZ)
    assert np.allclose(found.power[-6:], found.white[-6:], rtol=0.1)


# --- what it holds ---------------------------------------------------------------------------------------------------

def test_what_a_passport_holds_of_each_run() -> None:
    command = waves(90, 2, 5, RATE_HZ)
    z_step, left = 0.01, noise(len(command), 0.05) + 0.7
    one = left_of(command, left, "a.csv", OTHER_RUNS)
    stepped = replace(one.run, columns={**one.run.columns,
                                        "displacement_um": np.round(one.run.displacement_um / z_step) * z_step})
    known = passport.build([one._replace(run=stepped)])
    assert known.held_out == OTHER_RUNS and known.kurtosis == pytest.approx(3, abs=0.3)
    run, = known.runs
    assert {key: getattr(run, key) for key in ("file", "digest", "samples", "held_out", "sample_rate_hz", "fitted_rms_um")} == {
        "file": "a.csv", "digest": "sha256:a.csv", "samples": len(command), "held_out": OTHER_RUNS,
        "sample_rate_hz": RATE_HZ, "fitted_rms_um": None}
    assert run.rms_um == pytest.approx(np.std(left), rel=1e-4)
    assert run.offset_um == pytest.approx(np.mean(left), rel=1e-4)
    assert run.step_um == pytest.approx(z_step, rel=1e-4) and run.noise_um == NOISE_UM
    assert run.stroke_um == pytest.approx(np.ptp(stepped.displacement_um), rel=1e-4)


@pytest.mark.parametrize("hows, name", [((FITTED,), FITTED), ((FITTED, LEFT_OUT), LEFT_OUT),
                                        ((LEFT_OUT, OTHER_RUNS, FITTED), OTHER_RUNS)])
def test_the_best_source_names_the_passport(hows: tuple[str, ...], name: str) -> None:
    command = waves(90, 2, 5, RATE_HZ)
    known = passport.build([left_of(command, noise(len(command), 0.05, k), f"{k}.csv", how)
                            for k, how in enumerate(hows)])
    assert known.held_out == name and [run.held_out for run in known.runs] == list(hows)


@pytest.mark.parametrize("runs", [1, 8, 25])
def test_a_passport_is_small_and_is_json(runs: int) -> None:
    assert len(json.dumps(plain(runs).to_json(), allow_nan=False)) < 20_000


@pytest.mark.parametrize("left", [0.0, 1e-9, 1e3])
def test_residuals_of_any_size_make_a_passport(left: float) -> None:
    command = waves(90, 2, 5, RATE_HZ)
    one = left_of(command, noise(len(command), left))
    known = passport.build([one, one])
    assert passport.read(with_passport(known)) == known
    expected = passport.expected_um(known, one.coords)
    assert np.all(np.isfinite(expected))
    assert np.sqrt(np.mean(expected**2)) == pytest.approx(max(left, NOISE_UM), rel=0.2)


# --- what it expects -------------------------------------------------------------------------------------------------

def gain_off(*shares: float) -> Passport:
    """The passport of a model whose gain is off by 1 %, from recordings that move by these shares of the range."""
    drives = [45 + share * (waves(90, hertz, 6, RATE_HZ) - 45) for share in shares for hertz in (1, 3)]
    return passport.build([left_of(drive, 0.001 * drive + noise(len(drive), NOISE_UM), f"{k}.csv")
                           for k, drive in enumerate(drives)])


@pytest.mark.parametrize("share", [1.0, 0.3, 0.1])
def test_a_small_movement_is_expected_to_leave_little_where_small_ones_were_recorded(share: float) -> None:
    command = 45 + share * (waves(90, 2, 9, RATE_HZ) - 45)
    at = left_of(command, np.zeros(len(command))).coords
    small = gain_off(1.0, 0.3, 0.1)
    assert passport.level_um(small, at) == pytest.approx(np.hypot(0.001 * np.std(command), NOISE_UM), rel=0.35)
    assert passport.too_small(small, at) < 0.02


def test_a_movement_smaller_than_any_recording_is_expected_to_leave_as_much_as_the_smallest() -> None:
    """A model may miss it by a larger share: loops of a tenth of the range do not look like a tenth of the loops."""
    whole = gain_off(1.0)
    command = 45 + 0.1 * (waves(90, 2, 9, RATE_HZ) - 45)
    at, large = (left_of(drive, np.zeros(len(drive))).coords for drive in (command, 45 + 10 * (command - 45)))
    assert passport.too_small(whole, at) == pytest.approx(0.9, abs=0.02) and passport.too_small(whole, large) < 0.01
    assert passport.level_um(whole, at) == pytest.approx(passport.level_um(whole, large), rel=0.3)
    older = replace(whole, level=replace(whole.level, least_std_um=None))
    assert passport.level_um(older, at) < 0.3 * passport.level_um(whole, at) and passport.too_small(older, at) == 0


def test_loops_that_drift_may_lead_aside_of_a_small_movement() -> None:
    """By all that the movement does not wipe out."""
    whole = gain_off(1.0)
    drifting = replace(whole, level=replace(whole.level, drift_um=2.0))
    for share in (1.0, 0.5, 0.0):
        command = 45 + share * (waves(90, 2, 9, RATE_HZ) - 45)
        at = left_of(command, np.zeros(len(command))).coords
        beside = np.sqrt(passport.level_um(drifting, at) ** 2 - passport.level_um(whole, at) ** 2)
        assert beside == pytest.approx((1 - share**2) * 2.0 * thresholds.ASTRAY, abs=0.03)
        assert passport.level_um(passport.repeated(drifting), at) == passport.level_um(passport.repeated(whole), at)


def test_a_fast_movement_is_expected_to_leave_much_where_the_model_is_bad_at_rates() -> None:
    command = np.concatenate([waves(top, hertz, 6, RATE_HZ) for hertz in (1, 2, 4, 8, 16) for top in (30, 90)])
    size = 1e-3 * rate_of(0.1 * command, RATE_HZ)
    known = passport.build([left_of(command, noise(len(command), size, seed), f"{seed}.csv") for seed in (1, 2)])
    for hertz in (1.5, 6, 12):
        other = waves(90, hertz, 12, RATE_HZ)
        at = left_of(other, np.zeros(len(other))).coords
        expected, truth = passport.expected_um(known, at), 1e-3 * at["rate_um_per_s"]
        assert np.sqrt(np.mean(expected**2)) == pytest.approx(max(np.sqrt(np.mean(truth**2)), NOISE_UM), rel=0.35)
        assert np.corrcoef(expected, truth)[0, 1] > 0.8


def test_no_less_than_the_noise_is_expected() -> None:
    command = 45 + 0.001 * waves(90, 3, 9, RATE_HZ)
    at = left_of(command, np.zeros(len(command))).coords
    assert np.all(passport.expected_um(plain(), at) >= plain().noise_um)


def test_ratio_of_a_residual_that_grew() -> None:
    command = waves(80, 2, 8, RATE_HZ)
    left = noise(len(command), 0.001 * np.std(command), 9)
    at = left_of(command, left).coords
    usual = passport.ratio(plain(), [left + 3.0], [at])  # an offset is no residual
    assert usual.overall == pytest.approx(1, abs=0.2) and usual.actual_um[0] == pytest.approx(np.std(left))
    both = passport.ratio(plain(), [left, 4 * left], [at, at])
    assert np.allclose(both.ratio, usual.ratio * [1, 4])
    assert both.overall == pytest.approx(usual.overall * np.sqrt(17 / 2))
    assert both.spread == plain().spread


def test_two_recordings_of_the_same_drive_differ_by_less_than_a_model_misses() -> None:
    """... where noise is little; where it is all, by twice its energy."""
    known, run = plain(), recording(waves(60, 2, 4, RATE_HZ), None, RATE_HZ)
    z = 0.1 * run.command_V
    coords = localise.coordinates(run, z, rate_of(z, RATE_HZ))
    quiet, loud = replace(known, noise_um=0.0), passport.expected_um(known, coords)
    assert passport.expected_um(passport.repeated(quiet), coords) == pytest.approx(thresholds.REPEATS * loud)
    noisy = replace(known, noise_um=1.0, level=replace(known.level, coefficients=[1.0, 0.0, 0.0, 0.0],
                                                       rms_um=[1.0] * len(known.level.rms_um)))
    differ = passport.repeated(noisy)
    assert passport.level_um(differ, coords) == pytest.approx(np.sqrt(2)) and differ.noise_um == np.sqrt(2)
    assert passport.read(replace(model_of(stack()), passport=json.loads(json.dumps(differ.to_json())))) == differ


def test_expected_spectrum_adds_up_and_follows_the_movement() -> None:
    command = np.concatenate([waves(90, 2, 20, RATE_HZ), waves(40, 2, 10, RATE_HZ)])
    time_s = np.arange(len(command)) / RATE_HZ
    known = passport.build([left_of(command, 0.1 * np.sin(2 * np.pi * 6.5 * time_s) + noise(len(command), NOISE_UM))])
    other = waves(90, 16, 160, RATE_HZ)
    one = left_of(other, noise(len(other), 0.1))
    spectrum = passport.octaves(one.fitted_um, RATE_HZ)
    expected = passport.expected_octaves(known, one.coords, spectrum, RATE_HZ)
    assert expected.shape == spectrum.power.shape
    assert np.sum(expected) == pytest.approx(np.mean(passport.expected_um(known, one.coords) ** 2))
    share = dict(zip(range(spectrum.first, 20), expected / np.sum(expected)))
    assert share[2] > 0.3  # 6.5 Hz, as it was
    assert share[5] > 0.3  # three times the movement's frequency, as it was
    assert share[3] < 0.1


def test_spread_tells_runs_alike_from_runs_apart() -> None:
    command = waves(80, 2, 8, RATE_HZ)

    def spread(sizes: tuple[float, ...], how: str = LEFT_OUT) -> float:
        return passport.build([left_of(command, noise(len(command), size, k), f"{k}.csv", how)
                               for k, size in enumerate(sizes)]).spread

    assert spread((0.1,) * 8) < 0.25 < 0.6 < spread((0.05, 0.4) * 4)
    assert spread((0.1,), FITTED) > 1.5 * spread((0.1,), OTHER_RUNS)  # nothing says how optimistic it is


def test_spread_of_a_single_run_is_that_of_its_parts() -> None:
    command = waves(80, 2, 8, RATE_HZ)

    def spread(sizes: tuple[float, ...]) -> float:
        size = np.repeat(sizes, -(-len(command) // 4))[:len(command)]
        return passport.build([left_of(command, noise(len(command), size), how=LEFT_OUT)]).spread

    assert 0.25 < spread((0.1,) * 4) < 0.35 < 0.5 < spread((0.05, 0.4, 0.05, 0.4))


def test_spread_does_not_ask_recordings_about_movements_far_from_theirs() -> None:
    """The passport is not asked that way either."""
    wide, little = waves(90, 2, 8, RATE_HZ), 45 + 0.05 * (waves(90, 2, 8, RATE_HZ) - 45)
    apart = passport.build([left_of(drive, noise(len(drive), size), f"{size}.csv", LEFT_OUT)
                            for drive, size in ((wide, 0.5), (little, 0.02))])
    assert apart.spread == thresholds.SPREAD


# --- on actuators that are not the model -----------------------------------------------------------------------------

LIMITS = excite.Limits(0, 100, sample_rate_hz=2000.0)
COMMISSIONING = (("sawtooth", {"frequencies_hz": (1.0, 3.0, 10.0, 30.0), "cycles": 2}),
                 ("minor-loops", {"levels": 5, "rates_V_per_s": (300.0,)}), ("steps", {"hold_s": 0.7}),
                 ("multisine", {"duration_s": 6.0, "seed": 1}))
LATER = (("multisine", {"duration_s": 6.0, "seed": 7, "frequencies_hz": (0.7, 1.9, 4.3, 9.0, 17.0, 33.0)}, 1.0),
         ("multisine", {"duration_s": 6.0, "seed": 9}, 0.2),
         ("minor-loops", {"levels": 4, "rates_V_per_s": (900.0,)}, 1.0),
         ("sine", {"frequencies_hz": (1.0,), "cycles": 5}, 1.0),
         ("sine", {"frequencies_hz": (25.0,), "cycles": 60}, 1.0),
         ("chirp", {"frequencies_hz": (0.5, 30.0), "duration_s": 6.0}, 1.0),
         ("steps", {"hold_s": 0.5, "levels": 6}, 1.0),
         ("sawtooth", {"frequencies_hz": (6.0,), "cycles": 12}, 0.5))


def played(bench: vb.Bench, kind: str, options: dict, size: float, name: str) -> Recording:
    """A recording of a drive, shrunk about mid range, on a bench that was swept."""
    drive = 50 + size * (excite.make_drive(kind, LIMITS, **options)[0]["command_V"] - 50)
    return swept_and_played(bench, drive, LIMITS.sample_rate_hz, name)


@lru_cache(maxsize=None)
def commissioned(kind: str) -> tuple[Fit, vb.Bench]:
    bench = vb.make(kind, 3)
    runs = [played(bench, name, options, 1.0, f"{k}.csv") for k, (name, options) in enumerate(COMMISSIONING)]
    return fit(runs), bench


# ratio of actual to expected, its logarithm: scatter over the runs, and that of all samples together
@pytest.mark.parametrize("kind, scatter, overall", [
    pytest.param("preisach", 0.25, 0.2, marks=pytest.mark.long), ("bouc-wen", 0.5, 0.25),
    pytest.param("paper", 0.3, 0.2, marks=pytest.mark.long)])
def test_unchanged_actuators_leave_what_is_expected(kind: str, scatter: float, overall: float) -> None:
    (result, bench), known = commissioned(kind), passport.read(commissioned(kind)[0].model)
    runs = [played(bench, name, options, size, f"later {k}.csv") for k, (name, options, size) in enumerate(LATER)]
    predictions = chain.simulate(result.model, runs)
    coords = [localise.coordinates(run, seen.predicted_um, seen.rate_um_per_s)
              for run, seen in zip(runs, predictions)]
    residuals = [run.displacement_um - seen.predicted_um for run, seen in zip(runs, predictions)]
    small = np.array([passport.too_small(known, at) > 0.1 for at in coords])
    assert 1 < np.count_nonzero(small) < 4
    large = [[one for one, left_out in zip(some, small) if not left_out] for some in (residuals, coords)]
    found = passport.ratio(known, *large)
    misses = np.log(found.ratio)
    assert np.std(misses) < scatter and abs(np.log(found.overall)) < overall
    assert found.spread > 0.5 * np.std(misses)
    constant = np.log(found.actual_um / known.rms_um)  # what one number for all recordings would say
    assert np.sqrt(np.mean(misses**2)) < 0.7 * np.sqrt(np.mean(constant**2))
    assert np.all(passport.ratio(known, residuals, coords).ratio[small] < np.exp(2 * found.spread))  # or much less


def test_a_changed_actuator_leaves_more() -> None:
    result, bench = commissioned("preisach")
    run = played(bench, *LATER[0], "later.csv")
    prediction, = chain.simulate(result.model, [run])
    coords = [localise.coordinates(run, prediction.predicted_um, prediction.rate_um_per_s)]
    late = np.interp(run.time_s - 1e-3, run.time_s, run.displacement_um)
    before = passport.ratio(passport.read(result.model), [run.displacement_um - prediction.predicted_um], coords)
    after = passport.ratio(passport.read(result.model), [late - prediction.predicted_um], coords)
    assert np.log(before.overall) < 2 * before.spread < np.log(after.overall)


# --- in the model file -----------------------------------------------------------------------------------------------

def with_passport(known: object) -> Model:
    return replace(model_of(stack()), passport=known.to_json() if isinstance(known, Passport) else known)


def test_survives_the_model_file(tmp_path: Path) -> None:
    write_model(tmp_path / "model.json", with_passport(plain()))
    model = read_model(tmp_path / "model.json")
    assert passport.read(model) == plain()
    at = left_of(waves(70, 4, 4, RATE_HZ), np.zeros(1000)).coords
    assert np.array_equal(passport.expected_um(passport.read(model), at), passport.expected_um(plain(), at))


def test_a_model_without_passport_has_none() -> None:
    assert passport.read(with_passport(None)) is None


@pytest.mark.parametrize("path, value, key", [
    ("", [], "passport: must be an object"), ("", {"owner": "lab"}, "passport.schema: is missing"),
    ("schema", "rdpi-passport/9", "passport.schema"), ("held_out", "perhaps", "passport.held_out"),
    ("noise_um", -1, "passport.noise_um"), ("noise_um", float("nan"), "passport.noise_um"),
    ("spread", None, "passport.spread"), ("rms_um", True, "passport.rms_um"), ("runs", {}, "passport.runs"),
    ("axes", 1, "passport.axes: must be an object"),
    ("axes rate_um_per_s", None, "passport.axes.rate_um_per_s: must be an object"),
    ("axes position_um edges", [0.0], "passport.axes.position_um.edges"),
    ("axes position_um edges", [2.0, 1.0], "passport.axes.position_um.edges"),
    ("axes rate_um_per_s rms_um", [1.0], "passport.axes.rate_um_per_s.rms_um: has 1 values, expected 8"),
    ("axes rate_um_per_s factor", [0.0] * 8, "passport.axes.rate_um_per_s.factor: must be positive"),
    ("octaves relative first", 0.5, "passport.octaves.relative.first"),
    ("octaves absolute first", 10**9, "passport.octaves.absolute.first"),
    ("octaves absolute share", [0, 0], "passport.octaves.absolute.share"),
    ("octaves absolute share", "1", "passport.octaves.absolute.share"),
    ("octaves moved", 3, "passport.octaves.moved: must be an object"),
    ("octaves moved first", None, "passport.octaves.moved.first"),
    ("octaves moved peak_um", [1.0, -1.0], "passport.octaves.moved.peak_um"),
    ("octaves moved missed", [1.0], "passport.octaves.moved.missed: has 1 values"),
    ("octaves moved missed", [-1.0] * 8, "passport.octaves.moved.missed"),
    ("drifts", "yes", "passport.drifts: must be true or false"),
    ("level coefficients", [1, 2], "passport.level.coefficients: has 2 values, expected 4"),
    ("level coefficients", [1, 2, 3, -4], "passport.level.coefficients"),
    ("level rms_um", [], "passport.level.rms_um"), ("level weight", [1], "passport.level.weight: has 1 values"),
    ("level std_um", [float("inf")] * 63, "passport.level.std_um"),
    ("level rms_um", [0.0] * 63, "passport.level.rms_um: must be positive"),
])
def test_a_malformed_passport_is_refused(path: str, value: object, key: str) -> None:
    known = plain().to_json()
    place = known
    *parents, last = path.split(" ") if path else [""]
    for name in parents:
        place = place[name]
    if path:
        place[last] = value
    with pytest.raises(BadInput) as error:
        passport.read(replace(with_passport(known if path else value), where="m.json"))
    assert str(error.value).startswith(f"m.json: {key}") and "fit the model again" in str(error.value)


@pytest.mark.parametrize("name", ["offset_um", "sample_rate_hz"])
@pytest.mark.parametrize("value", ["x", [], 10**400, float("nan"), True])
def test_a_value_of_a_run_that_is_no_number(name: str, value: object) -> None:
    known = plain().to_json()
    known["runs"] = [{**run, name: value} for run in known["runs"]]
    with pytest.raises(BadInput, match=rf"passport\.runs\[0\]\.{name}: must be a number"):
        passport.read(with_passport(known))


@pytest.mark.parametrize("name", ["least_std_um", "drift_um"])
@pytest.mark.parametrize("value", [-1.0, 1e15, float("nan"), "x", True, []])
def test_what_small_movements_bring_is_a_number_within_the_movement(name: str, value: object) -> None:
    known = plain().to_json()
    known["level"] = {**known["level"], name: value}
    with pytest.raises(BadInput, match=rf"passport\.level\.{name}: must be a number from 0 to"):
        passport.read(with_passport(known))


def test_a_passport_of_rests_remembers_nothing_and_all() -> None:
    known = plain()
    rests = replace(known, level=replace(known.level, std_um=[0.0] * len(known.level.std_um)))
    assert passport.remembered(rests, {"position_um": np.zeros(9)}) == 1
    assert passport.remembered(rests, {"position_um": np.arange(9.0)}) == 0


def test_every_key_is_needed() -> None:
    """Take out one key after another: refused by its name, not by a traceback."""

    def keys(of: dict, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
        for name, value in of.items():
            yield (*path, name)
            if isinstance(value, dict):
                yield from keys(value, (*path, name))

    # Younger than the format: models of before lack them.
    younger = ("octaves", "moved"), ("octaves", "moved", "missed"), ("drifts",), ("level", "least_std_um"), ("level", "drift_um")
    found = [path for path in keys(plain().to_json()) if path not in younger]
    assert len(found) > 25
    for path in found:
        known = plain().to_json()
        place = known
        for name in path[:-1]:
            place = place[name]
        del place[path[-1]]
        with pytest.raises(BadInput, match=f"passport.{'.'.join(path)}: is missing"):
            passport.read(with_passport(known))
