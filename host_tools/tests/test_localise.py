"""Where a residual lies: coordinates of samples, axes on residuals that were put in one place, the table."""

from __future__ import annotations

import json

import numpy as np
import pytest
from plants import marked, rate_of, recording, waves

from rdpi.data import Recording
from rdpi.identify import localise, passport
from rdpi.identify.localise import BINS, UNITS, Axis, coordinates, dominant, table, turning_points
from rdpi.identify.passport import FITTED, Residual

RATE_HZ = 1000.0
NOISE_UM = 0.004
SIZE_UM = 0.3


def run_of(command: np.ndarray, name: str = "run.csv", rate_hz: float = RATE_HZ) -> tuple[Recording, dict]:
    """A run of an actuator without hysteresis, 0.1 um/V, and its coordinates."""
    z = 0.1 * command
    run = recording(command, z, rate_hz, name)
    return run, coordinates(run, z, rate_of(z, rate_hz))


def staircase(levels: tuple[float, ...], samples: int) -> np.ndarray:
    return np.repeat(levels, samples).astype(float)


def drives() -> list[np.ndarray]:
    """Loops of many sizes at many rates, about different places, and holds: no axis follows from another."""
    random = np.random.default_rng(3)
    return [np.concatenate([waves(random.uniform(60, 100), hertz, 4, RATE_HZ, random.uniform(0, 40))
                            for hertz in (1, 2, 20, 5, 0.7, 10)]),
            np.concatenate([waves(top, 3, 3, RATE_HZ, top - size)
                            for top, size in ((50, 20), (95, 30), (60, 5), (100, 100))]),
            staircase((0, 25, 50, 75, 100, 75, 50, 25, 0), 700)]


@pytest.fixture(scope="module")
def set_of_runs() -> tuple[list[Recording], list[dict]]:
    runs, coords = zip(*(run_of(drive, f"run{k}.csv") for k, drive in enumerate(drives())))
    return list(runs), list(coords)


def axes_of(runs: list[Recording], residuals: list[np.ndarray], coords: list[dict], known: dict | None = None,
            noise_um: float = NOISE_UM) -> dict[str, Axis]:
    return {axis.name: axis for axis in localise.localise(runs, residuals, coords, known, noise_um)}


# --- coordinates -----------------------------------------------------------------------------------------------------

def test_coordinates_of_a_triangle() -> None:
    command = np.concatenate([np.arange(0, 100), np.arange(100, 20, -1), np.arange(20, 60)]).astype(float)
    run, at = run_of(command)
    assert list(at) == ["time_s", "rate_um_per_s", "position_um", "direction", "since_reversal_s", "amplitude_um"]
    assert np.allclose(at["time_s"], np.arange(220) / RATE_HZ)
    assert np.array_equal(at["position_um"], run.displacement_um)
    assert np.all(at["direction"][:99] == 1) and np.all(at["direction"][101:179] == -1) and at["direction"][-1] == 1
    since = at["since_reversal_s"] * RATE_HZ
    assert np.allclose(since[:100], np.arange(100))  # since the start
    # the extremes are left within 1 % of the range, which is a quarter of what counts as turning round
    assert np.allclose(since[102:180], np.arange(102, 180) - 100, atol=1) and since[-1] == pytest.approx(39, abs=1)
    assert np.allclose(at["amplitude_um"][:100], 10) and np.allclose(at["amplitude_um"][185:], 8)


def test_since_reversal_of_a_step_counts_from_the_step() -> None:
    _, at = run_of(staircase((0, 50, 0), 100))
    assert np.allclose(at["since_reversal_s"][200:], np.arange(1, 101) / RATE_HZ)
    assert np.all(at["direction"][110:190] == 0)


def test_turning_points_are_those_that_matter() -> None:
    random = np.random.default_rng(0)
    wave = waves(100, 2, 5, RATE_HZ)
    found = turning_points(wave)
    assert np.allclose(found, np.arange(250, 2500, 250), atol=0.05 * 250)
    noisy = turning_points(wave + random.uniform(-0.4, 0.4, len(wave)))  # a command that was read back
    assert len(noisy) == 9 and np.allclose(noisy, found, atol=0.06 * 250)
    assert len(turning_points(np.linspace(0, 1, 100))) == 0 and len(turning_points(np.ones(100))) == 0


def test_coordinates_of_a_run_at_rest() -> None:
    _, at = run_of(np.full(50, 3.0))
    assert np.all(at["direction"] == 0) and np.all(at["amplitude_um"] == 0)
    assert np.allclose(at["since_reversal_s"], at["time_s"])


# --- axes ------------------------------------------------------------------------------------------------------------

def test_every_axis_accounts_for_all_of_the_energy(set_of_runs: tuple) -> None:
    runs, coords = set_of_runs
    random = np.random.default_rng(1)
    residuals = [SIZE_UM * random.standard_normal(len(run)) + 5 * k for k, run in enumerate(runs)]
    mean_square = np.mean(np.concatenate([residual - residual.mean() for residual in residuals]) ** 2)
    axes = axes_of(runs, residuals, coords, noise_um=0.0)
    assert list(axes) == list(UNITS)
    for axis in axes.values():
        bins = len(axis.labels)
        assert all(len(part) == bins for part in (axis.rms_um, axis.share, axis.occupancy))
        assert axis.edges is None or (len(axis.edges) == bins + 1 and np.all(np.diff(axis.edges) > 0))
        assert axis.expected_um is None and axis.ratio is None
        assert np.sum(axis.share) == pytest.approx(1) and np.sum(axis.occupancy) == pytest.approx(1)
        weight = 1.0 if axis.name == "frequency_hz" else axis.occupancy
        assert np.sum(weight * axis.rms_um**2) == pytest.approx(mean_square, rel=1e-9)
        json.dumps(axis.entry().to_json(), allow_nan=False)
    for name in ("time_s", "position_um", "amplitude_um"):
        assert len(axes[name].labels) <= BINS and np.max(axes[name].occupancy) < 0.5
    assert np.allclose(axes["time_s"].occupancy, 1 / BINS, atol=0.01)


def test_noise_is_taken_off(set_of_runs: tuple) -> None:
    runs, coords = set_of_runs
    random = np.random.default_rng(2)
    noise = [NOISE_UM * random.standard_normal(len(run)) for run in runs]
    loud = [part + 3 * NOISE_UM * random.standard_normal(len(part)) * (at["position_um"] > 8)
            for part, at in zip(noise, coords)]
    axis = axes_of(runs, loud, coords)["position_um"]
    above = axis.edges[:-1] >= 8
    with_noise = axes_of(runs, loud, coords, noise_um=0.0)["position_um"]
    assert np.sum(axis.share[above]) > np.sum(with_noise.share[above]) + 0.05
    assert np.all(axes_of(runs, [0.5 * part for part in noise], coords)["time_s"].share == 0)


@pytest.mark.parametrize("name, where", [
    ("rate_um_per_s", lambda at: at["rate_um_per_s"] > 150),
    ("position_um", lambda at: np.abs(at["position_um"] - 5) < 0.7),
    ("direction", lambda at: at["direction"] > 0),
    ("since_reversal_s", lambda at: at["since_reversal_s"] < 0.01),
    ("time_s", lambda at: at["time_s"] > 6.0),
    ("recording", lambda at: np.full(len(at["time_s"]), np.any(at["direction"] == 0) and len(at["time_s"]) == 6300)),
    ("frequency_hz", None),
])
def test_dominant_axis_is_where_the_residual_was_put(set_of_runs: tuple, name: str, where: object) -> None:
    runs, coords = set_of_runs
    random = np.random.default_rng(4)
    residuals = []
    for at in coords:
        noise = NOISE_UM * random.standard_normal(len(at["time_s"]))
        shape = np.sin(2 * np.pi * 50 * at["time_s"]) if where is None else (
            random.standard_normal(len(noise)) * where(at))
        residuals.append(noise + SIZE_UM * shape)
    axes = axes_of(runs, residuals, coords)
    found = dominant(list(axes.values()))
    assert found.name == name
    if name == "frequency_hz":
        assert found.labels[int(np.argmax(found.share))] == "32 to 64"
    elif name == "direction":
        assert found.labels[int(np.argmax(found.share))] == "rising"
    elif name == "recording":
        assert found.labels[int(np.argmax(found.share))] == "run2.csv"


def test_an_even_residual_lies_nowhere(set_of_runs: tuple) -> None:
    runs, coords = set_of_runs
    random = np.random.default_rng(5)
    axes = axes_of(runs, [SIZE_UM * random.standard_normal(len(run)) for run in runs], coords)
    assert all(axis.concentration < 0.06 for axis in axes.values())


def test_a_gain_error_is_no_matter_of_frequency(set_of_runs: tuple) -> None:
    """Its spectrum is that of the movement, which is what to expect."""
    runs, coords = set_of_runs
    axes = axes_of(runs, [0.02 * at["position_um"] for at in coords], coords)
    assert axes["frequency_hz"].concentration < 0.25 * axes["position_um"].concentration


def test_with_a_passport_only_what_changed_is_concentrated(set_of_runs: tuple) -> None:
    runs, coords = set_of_runs
    random = np.random.default_rng(6)

    def usual() -> list[np.ndarray]:
        return [0.001 * np.minimum(at["rate_um_per_s"], 400) * random.standard_normal(len(at["time_s"]))
                for at in coords]

    known = passport.build([Residual(run, FITTED, None, left, at, NOISE_UM)
                            for run, left, at in zip(runs, usual(), coords)])
    bare, seen = axes_of(runs, usual(), coords), axes_of(runs, usual(), coords, known)
    assert bare["rate_um_per_s"].concentration > 0.3  # the model was always worst there
    assert seen["rate_um_per_s"].concentration < 0.05
    assert np.allclose(seen["rate_um_per_s"].ratio[-2:], 1, atol=0.3)
    changed = [left + 0.2 * (np.abs(at["position_um"] - 5) < 0.7) * random.standard_normal(len(left))
               for left, at in zip(usual(), coords)]
    axes = axes_of(runs, changed, coords, known)
    assert axes["position_um"].concentration > 3 * seen["position_um"].concentration
    loudest = int(np.argmax(axes["position_um"].ratio))
    assert axes["position_um"].edges[loudest] < 5.7 and axes["position_um"].edges[loudest + 1] > 4.3


def test_runs_of_different_rate_and_length_share_one_frequency_axis() -> None:
    pieces = [run_of(waves(100, 1, 4, rate_hz), f"{rate_hz:g}.csv", rate_hz) for rate_hz in (250.0, 4000.0)]
    runs, coords = [run for run, _ in pieces], [at for _, at in pieces]
    hum = [SIZE_UM * np.sin(2 * np.pi * hertz * at["time_s"]) for hertz, at in zip((20, 1500), coords)]
    axis = axes_of(runs, hum, coords, noise_um=0.0)["frequency_hz"]
    assert axis.edges[0] <= 0.25 and axis.edges[-1] >= 2000
    low, high = (float(axis.share[np.searchsorted(axis.edges, hertz) - 1]) for hertz in (20, 1500))
    # both sines are equally large; energies go with samples, of which one run has a seventeenth
    assert low == pytest.approx(1 / 17, rel=0.02) and high == pytest.approx(16 / 17, rel=0.02)


# --- table -----------------------------------------------------------------------------------------------------------

def test_table_over_position_and_rate(set_of_runs: tuple) -> None:
    _, coords = set_of_runs
    random = np.random.default_rng(7)
    fast = localise.quantile_edges(np.concatenate([at["rate_um_per_s"] for at in coords]), 4)[-2]
    loud = [(1 + 4 * ((at["position_um"] > 7) & (at["rate_um_per_s"] >= fast))) * NOISE_UM
            * random.standard_normal(len(at["time_s"])) for at in coords]
    position, rate, rms = table(loud, coords)
    assert rms.shape == (len(position) - 1, len(rate) - 1)
    inside = np.ix_(position[:-1] >= 7, rate[:-1] >= fast)
    assert np.nanmin(rms[inside]) > 3.5 * NOISE_UM
    outside = rms[position[1:] <= 7]
    assert np.nanmax(outside) < 1.6 * NOISE_UM
    short = [{name: values[:25] for name, values in at.items()} for at in coords]
    assert np.isnan(table([part[:25] for part in loud], short).rms_um).any()


def test_a_run_of_metadata_unknown_is_placed_alike(set_of_runs: tuple) -> None:
    runs, coords = set_of_runs
    again = coordinates(marked(runs[0], memory="unknown"), coords[0]["position_um"], coords[0]["rate_um_per_s"])
    assert all(np.array_equal(again[name], coords[0][name]) for name in again)
