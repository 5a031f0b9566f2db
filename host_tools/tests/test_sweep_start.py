"""Where a decaying sweep leaves the plays: the rule against plays that follow the sweep, and what a fit finds of it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from fitted import STATIC, static_run
from test_chain import paper_model, recording

from rdpi import firmware
from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.identify import fit
from rdpi.identify.sweep_start import _columns, _superposed, sweep_start
from rdpi.model import Model, operators, read_model, swept_states, write_model
from rdpi.simulate import chain

RADII = np.linspace(0, 9, 10)
RATE_HZ = 1000.0


def swept_by(end: float, low: float, high: float, r: np.ndarray, cycles: int = 400) -> np.ndarray:
    """Plays that follow a sweep about a centre which moves from the middle of the range to its end."""
    left = np.linspace(1, 0, 200 * cycles + 1)
    wave = np.sin(2 * np.pi * cycles * left)
    x = end + left * ((low + high) / 2 - end + (high - low) / 2 * wave)
    return firmware.plays(x, r, np.full(len(r), (low + high) / 2))[1]


@pytest.mark.parametrize("end", [-4.0, -2.2, 3.0, 6.0, 16.0])
@pytest.mark.parametrize("turned", [False, True])
def test_the_share_of_1_is_what_the_plays_make_of_the_sweep(end: float, turned: bool) -> None:
    low, high = -4.0, 16.0
    found = swept_states(end, RADII, (high, low) if turned else (low, high), 1.0)
    np.testing.assert_allclose(found, swept_by(end, low, high, RADII), atol=0.05)  # a cycle's decrement: 20 / 400


def test_a_play_that_never_moved_is_within_its_reach() -> None:
    for end in (0.0, 1.0, 5.0):
        found = swept_states(end, np.array([0.0, 3.0, 8.0]), (0.0, 10.0), 1.0)
        assert np.all(np.abs(found - 5.0) <= 5.0) and np.all(np.abs(found - end) <= [0, 3, 8])


def test_shares_between_and_ends_outside_the_range() -> None:
    rest, all_the_way = (swept_states(2.0, RADII, (0.0, 20.0), share) for share in (0.0, 1.0))
    assert rest.tolist() == [2.0] * 10
    np.testing.assert_allclose(swept_states(2.0, RADII, (0.0, 20.0), 0.25), 0.75 * rest + 0.25 * all_the_way)
    np.testing.assert_allclose(swept_states(-3.0, RADII, (0.0, 20.0), 1.0), RADII - 3.0)


# ---- the model, the simulation, the firmware ----

def sharing(share: float | None, **changes: object) -> Model:
    model = paper_model(**changes)
    return replace(model, memory=replace(model.memory, sweep_share=share))


def test_the_model_file_holds_it(tmp_path) -> None:
    path = tmp_path / "model.json"
    for share in (None, 0.0, 0.25, 1.0):
        write_model(path, sharing(share))
        assert json.loads(path.read_text())["memory"].get("sweep_share", None) == share
        assert read_model(path).memory.sweep_share == share


@pytest.mark.parametrize("share", [-0.1, 1.1, np.nan])
def test_no_share(share: float) -> None:
    with pytest.raises(BadInput, match="memory.sweep_share"):
        sharing(share).validate()


def test_the_digest_tells_what_the_firmware_does() -> None:
    assert sharing(None).digest() == sharing(1.0).digest() != sharing(0.5).digest()


@pytest.mark.parametrize("share", [None, 0.0, 0.5, 1.0])
def test_a_recording_after_a_sweep_begins_there(share: float | None) -> None:
    model = sharing(share)
    command = 20 + 5 * np.sin(np.arange(300) / 20)
    states = swept_states(float(model.x_of(20.0)), model.thresholds_um, model.x_of(np.array([-100, 200])), share or 0)
    found = chain.simulate(model, [recording(command, memory="reset")])[0]
    np.testing.assert_allclose(found.start_um, states)
    first_um = operators.forward(model, command[:1], np.zeros(1), states)[0]
    np.testing.assert_allclose(found.predicted_um[0], first_um, atol=0.01)


@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("displacement_um", [-4.0, 2.0, 6.0])
def test_rest_at_finds_the_drive_where_a_sweep_leaves_the_displacement(displacement_um: float, share: float) -> None:
    model = sharing(share)
    memory = chain.rest_at(model, displacement_um)
    start_V = memory.x_um / model.gain_um_per_V + model.offset_V
    np.testing.assert_allclose(memory.plays_um, model.swept(memory.x_um))
    assert np.ptp(memory.plays_um) > 0.1 and memory.sweep_share == share
    z = operators.forward(model, np.array([start_V]), np.zeros(1), memory.plays_um)[0]
    np.testing.assert_allclose(z, displacement_um)
    replace(model, memory=memory).validate()


@pytest.mark.parametrize("engine", ["f32", "f64", "q31"])
@pytest.mark.parametrize("share", [None, 0.0, 0.4, 1.0])
@pytest.mark.parametrize("end_V", [-100.0, -70.0, 50.0])
def test_the_firmware_sweeps_to_where_the_simulation_begins(engine: str, share: float | None, end_V: float) -> None:
    model = sharing(share)
    model.drive = replace(model.drive, sweep_end_V=end_V, sweep_cycles=400, sweep_V_per_s=1000.0)
    library = firmware.engine(model, 1e-3, engine)
    library.sweep()
    expected = replace(model, memory=replace(model.memory, sweep_share=model.memory.followed_share())).swept(
        float(model.x_of(end_V)))
    step_um = 37.5 / 400 + 0.125  # a cycle's decrement, a sample of the ramp
    np.testing.assert_allclose(library.memory_um, expected, atol=step_um)
    if share == 0:
        np.testing.assert_allclose(library.memory_um, expected[0], rtol=1e-6, atol=1e-6)


# ---- the fit ----

@lru_cache(maxsize=None)
def recordings(forgets: float, share: float, start: float, lag_s: float = 0.0) -> tuple[Recording, ...]:
    """Great loops, and a multisine that grows, of plays of another shape and number than any that a fit uses."""
    t = np.arange(4000) / RATE_HZ
    random = np.random.default_rng(5)
    lines = sum(np.sin(2 * np.pi * (f * t + random.random())) / np.sqrt(f) for f in (1.3, 2.9, 6.1, 11.3, 17.9))
    lines *= np.linspace(0.2, 1, len(t)) / np.abs(lines).max()
    drives = [np.interp((t * 2) % 1, [0, 0.5, 1], [-1, 1, -1]), lines]
    r = np.geomspace(0.02, 0.9, 17)
    weights = r**0.7 * np.exp(-r)
    runs = []
    for k, wave in enumerate(drives):
        u = np.concatenate([np.full(5, start), np.interp(np.arange(200), [0, 199], [start, wave[0]]), wave])
        y, z = u[0] - share * u[0] * r, np.empty(len(u))
        for i, (at, moved) in enumerate(zip(u, np.abs(np.diff(u, prepend=u[0])))):
            y = at + np.clip((y - at) * np.exp(-forgets * moved), -r, r)
            z[i] = at + 0.15 * weights @ y / weights.sum() - 0.02 * at**2
        for i in range(1, len(z) if lag_s else 0):
            z[i] = z[i - 1] + (z[i] - z[i - 1]) / (1 + lag_s * RATE_HZ)
        z = z + 1e-4 * random.standard_normal(len(z))
        columns = {"time_s": np.arange(len(u)) / RATE_HZ, "command_V": 50 + 50 * u, "displacement_um": 5 + 5 * z}
        runs.append(Recording(f"{k}.csv", {"sample_rate_hz": str(RATE_HZ), "memory": "reset"}, columns,
                              digest=f"sha256:{k}"))
    return tuple(runs)


def found(runs: tuple[Recording, ...]):
    return sweep_start(runs, 0.1, 50.0, np.arange(10) * 0.5, (0.0, 100.0))


@pytest.mark.parametrize("lag_s", [0.0, 0.002])
def test_plays_that_forget_are_told_by_inner_loops(lag_s: float) -> None:
    forgets, remembers = found(recordings(1.0, 0.0, 0.0, lag_s)), found(recordings(0.0, 1.0, 0.0, lag_s))
    assert forgets[:2] == (0.0, "inner loops") and forgets.drifts
    assert remembers[:2] == (1.0, "nothing") and not remembers.drifts


@pytest.mark.parametrize("start", [-1.0, 0.8])
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_beginnings_aside_of_the_middle_show_the_share(share: float, start: float) -> None:
    seen = found(recordings(0.0, share, start))
    assert seen.shown_by == "beginnings" and seen.share == pytest.approx(share, abs=0.06) and not seen.drifts


@pytest.mark.parametrize("forgets", [0.3, 1.0])
@pytest.mark.parametrize("drift_um", [0.0, 0.01, 0.025])
def test_beginnings_aside_of_the_middle_tell_plays_that_forget(forgets: float, drift_um: float) -> None:
    """Where the rest of the recordings tells little, for what else they hold, the beginnings still tell."""
    random = np.random.default_rng(7)
    runs = []
    for run in recordings(forgets, 0.0, -1.0):
        drift = drift_um * np.convolve(random.standard_normal(len(run)), np.full(30, 30**-0.5), "same")
        runs.append(replace(run, columns={**run.columns, "displacement_um": run.displacement_um + drift}))
    assert found(tuple(runs))[:2] == (0.0, "beginnings")


def test_recordings_of_unknown_memory_show_what_follows_a_warm_up() -> None:
    for forgets, share in ((1.0, 0.0), (0.0, 1.0)):
        runs = recordings(forgets, share, 0.0)
        unknown = replace(runs[0], metadata={**runs[0].metadata, "memory": "unknown"})
        assert found((unknown, runs[1])).share == share
    still = replace(unknown, columns={name: values[:6] for name, values in unknown.columns.items()})
    assert found((still,))[:2] == (1.0, "nothing")


def test_what_the_columns_sum_up_to_needs_no_columns() -> None:
    random = np.random.default_rng(2)
    plays, rate, weights = random.normal(size=(50, 4)), random.uniform(0, 1, 50), random.normal(size=10)
    np.testing.assert_allclose(_superposed(plays, rate, weights), _columns(plays, rate[:, None]) @ weights)


@pytest.mark.parametrize("start", [0.0, -1.0])
@pytest.mark.parametrize("thresholds_um", [[0.0], [0.0, 1e-9], [0.0, 1e3]])
def test_plays_that_explain_no_loop_show_no_share(thresholds_um: list[float], start: float) -> None:
    runs = recordings(0.0, 1.0, start)
    seen = sweep_start(runs, 0.1, 50.0, np.array(thresholds_um), (0.0, 100.0))
    assert seen[:4] == (1.0, "nothing", None, None) and "show no loops" in seen.line()
    assert seen.record().to_json()["remembers_rms"] is None


@pytest.mark.parametrize("noise_um", [0.0, 1e-3, 1.0])
def test_a_straight_actuator_shows_no_share(noise_um: float) -> None:
    random = np.random.default_rng(1)
    runs = [replace(run, columns={**run.columns, "displacement_um": 0.1 * run.command_V
                                  + noise_um * random.standard_normal(len(run))})
            for run in recordings(0.0, 1.0, -1.0)]
    assert found(tuple(runs))[:4] == (1.0, "nothing", None, None)


def test_the_fit_uses_what_it_finds() -> None:
    runs = recordings(0.0, 1.0, -1.0)
    result = fit(runs)
    assert result.model.memory.sweep_share == 1
    assert result.document("m.json", False).to_json()["sweep"]["shown_by"] == "beginnings"
    np.testing.assert_allclose(result.model.memory.plays_um, result.model.swept(float(result.model.x_of(0.0))))
    rest = replace(result.model, memory=replace(result.model.memory, sweep_share=0.0))
    for run, one, known in zip(runs, chain.simulate(rest, runs), result.scores):
        assert chain.score(one.predicted_um, run.displacement_um).rms_percent > 1.5 * known.score.rms_percent


def test_plays_at_rest_are_found_too() -> None:
    assert fit([static_run()], STATIC).model.memory.sweep_share == 0
