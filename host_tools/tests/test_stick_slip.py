"""Readings that stand still and then jump are found, and nothing that rdpi has a name for is taken for one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from injected import COMMISSIONING, LATER, NOISE_UM, RATE_HZ, commissioned, drives, entry, plain_model, recorded
from plants import changed

from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.gap import diagnose, thresholds
from rdpi.gap.report import words
from rdpi.identify import Options, checks, fit, passport, stick_slip
from rdpi.model import Model
from rdpi.simulate import chain

OTHERS = [entry("delay", delay_s=0.01), entry("lag", "amplifier", time_constant_s=0.005), entry("backlash", width_um=2.0),
          entry("rail_saturation", V_min=5.0, V_max=80.0), entry("slew_limit", V_per_s=300.0),
          entry("resonance", f0_hz=60.0, damping=0.05), entry("gain_change", factor=1.3)]


def sticks(z_um: np.ndarray, random: np.random.Generator, band_um: float = 1.5) -> np.ndarray:
    """A stage that stands until it is so far behind."""
    found, at = np.empty(len(z_um)), z_um[0]
    for k, value in enumerate(z_um):
        at = value if abs(value - at) > band_um else at
        found[k] = at
    return found + NOISE_UM * random.standard_normal(len(z_um))


def loses(z_um: np.ndarray, random: np.random.Generator, hold: int = 20) -> np.ndarray:
    """Readings that are repeated instead of 20 others, five times a second."""
    lost = np.convolve(random.random(len(z_um)) < 5 / RATE_HZ, np.ones(hold))[:len(z_um)] > 0
    return z_um[np.maximum.accumulate(np.where(lost, 0, np.arange(len(z_um))))]


def slow_sensor(times: float) -> Callable[[np.ndarray, np.random.Generator], np.ndarray]:
    """A sensor that is so many times slower than the recording."""
    return lambda z_um, random: z_um[(np.arange(len(z_um)) // times * times).astype(int)]


FAULTS = [sticks, loses]


def faulty(fault: Callable, runs: Sequence[Recording]) -> list[Recording]:
    random = np.random.default_rng(5)
    return [changed(run, displacement_um=fault(run.displacement_um, random)) for run in runs]


def share(model: Model, runs: Sequence[Recording]) -> float:
    """Of what the model misses, where readings stand still before a jump."""
    predicted = [one.predicted_um for one in chain.simulate(model, runs)]
    left = [run.displacement_um - one for run, one in zip(runs, predicted)]
    where = [stick_slip.stuck(run.displacement_um, one) for run, one in zip(runs, predicted)]
    return stick_slip.share(np.concatenate(left), np.concatenate(where))


@pytest.mark.parametrize("fault", FAULTS)
def test_readings_that_stand_still_and_jump(fault: Callable) -> None:
    runs = recorded(plain_model(), drives(LATER))
    assert share(plain_model(), faulty(fault, runs)) > 0.6
    assert share(plain_model(), runs) < 0.01


@pytest.mark.parametrize("effect", OTHERS, ids=lambda one: one["name"])
def test_no_effect_of_the_catalogue_looks_like_that(effect: dict) -> None:
    assert share(plain_model(), recorded(plain_model(), drives(LATER), effect)) < 0.05


@pytest.mark.parametrize("times", [2, 7.3, 8])
def test_a_sensor_slower_than_the_recording_does_not_stand_still(times: float) -> None:
    assert share(plain_model(), faulty(slow_sensor(times), recorded(plain_model(), drives(LATER)))) == 0


@pytest.mark.parametrize(("times", "least"), [(2, 0.5), (3.3, 0.2)])
def test_a_stage_that_sticks_is_seen_by_a_slow_sensor_too(times: float, least: float) -> None:
    """As far as it stands still for several of the sensor's readings."""
    stuck = faulty(slow_sensor(times), faulty(sticks, recorded(plain_model(), drives(LATER))))
    assert share(plain_model(), stuck) > least


@pytest.mark.parametrize("samples", [9, 10, 65])
def test_short_and_constant_readings(samples: int) -> None:
    assert not np.any(stick_slip.stuck(np.zeros(samples), np.arange(samples)))
    assert not np.any(stick_slip.stuck(np.arange(samples) % 2 * 1.0, np.zeros(samples)))


def test_stillness_is_followed_to_its_beginning() -> None:
    moves = np.linspace(0.0, 10.0, 2001)
    still = np.where(np.arange(2001) < 1500, 0.0, moves)
    assert np.array_equal(np.flatnonzero(stick_slip.stuck(still, moves)), np.arange(1500))


@pytest.mark.parametrize("fault", FAULTS)
def test_gap_says_that_no_known_effect_is_behind_it(fault: Callable) -> None:
    found = diagnose(commissioned(), faulty(fault, recorded(plain_model(), drives(LATER)))).document
    assert found.verdict == "unknown" and not found.effects and found.stuck > 0.5 and found.next_experiment is None
    why = {sticks: "the stage or its mount sticks and slips", loses: "samples are lost"}[fault]
    assert sum("stands still while the actuator should move" in note and why in note for note in found.notes) >= 2
    assert "Mend this first" in words.sentence(found)


def test_little_of_it_is_said_where_nothing_has_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside what the model missed all along, the gap is not large enough to be called new by its size."""
    creeps = entry("creep", percent_per_decade=4.0)
    model = fit(recorded(plain_model(), drives(COMMISSIONING), creeps), Options(rate_independent=True, effects="none")).model
    runs = recorded(plain_model(), drives(LATER), creeps)
    assert diagnose(model, runs).document.verdict == "none"
    runs[:1] = faulty(lambda z_um, random: loses(z_um, random, 4), runs[:1])
    found = diagnose(model, runs).document
    assert found.verdict == "unknown" and 0.05 < found.stuck < 0.5 and "Mend this first" in words.sentence(found)
    monkeypatch.setattr(thresholds, "STUCK", thresholds.MOSTLY)
    assert diagnose(model, runs).document.verdict == "none"


@pytest.mark.parametrize("effect, verdict", [(entry("backlash", width_um=2.0), "unknown"),
                                             (entry("gain_change", factor=1.5), "effect")], ids=["backlash", "gain"])
def test_little_of_it_denies_backlash_and_nothing_else(effect: dict, verdict: str) -> None:
    """A play follows without a jump, and hides readings that stick."""
    runs = recorded(plain_model(), drives(LATER), effect)
    assert [one.name for one in diagnose(commissioned(), runs).document.effects] == [effect["name"]]
    runs[:1] = faulty(lambda z_um, random: sticks(z_um, random, 1.0), runs[:1])
    found = diagnose(commissioned(), runs).document
    assert found.verdict == verdict and 0.05 < found.stuck < 0.5


def test_fit_says_so_and_gap_calls_it_nothing_new_then() -> None:
    found = fit(faulty(sticks, recorded(plain_model(), drives(COMMISSIONING))), Options(rate_independent=True))
    assert sum("stands still" in note for note in found.warnings) >= 2
    model = found.model
    assert max(run["stuck"] for run in model.passport["runs"]) > 0.5
    again = faulty(sticks, recorded(plain_model(), drives(LATER)))
    assert diagnose(model, again).document.verdict != "unknown"
    # A model of before does not say how it was then.
    runs = [{key: value for key, value in run.items() if key != "stuck"} for run in model.passport["runs"]]
    assert diagnose(replace(model, passport={**model.passport, "runs": runs}), again).document.verdict == "unknown"


@pytest.mark.parametrize("value", ["0.5", -1.0, 1e9, True, [], {}])
def test_a_share_that_is_none_is_refused(value: object) -> None:
    model = commissioned()
    runs = [{**run, "stuck": value} for run in model.passport["runs"]]
    with pytest.raises(BadInput, match=r"passport\.runs\[0\]\.stuck: must be a number from 0 to 1"):
        passport.read(replace(model, passport={**model.passport, "runs": runs}))


def test_a_sensor_that_has_stopped_is_named() -> None:
    (run, *_) = recorded(plain_model(), drives(LATER))
    checks.check_readings(run)
    stopped = run.displacement_um.copy()
    stopped[len(run) // 2:] = stopped[len(run) // 2]
    with pytest.raises(BadInput, match=f"from sample {len(run) // 2} .* the sensor has stopped; cut"):
        checks.check_readings(changed(run, displacement_um=stopped))
    (note,) = set(checks.check_against(commissioned(), [changed(run, displacement_um=stopped)])) \
        - set(checks.check_against(commissioned(), [run]))
    assert "the sensor has stopped" in note
    clipped = np.minimum(run.displacement_um, np.median(run.displacement_um))
    checks.check_readings(changed(run, displacement_um=clipped))


def test_a_slow_sensor_is_told() -> None:
    runs = recorded(plain_model(), drives(LATER))
    assert not checks.slow_sensors(runs)
    (note,) = checks.slow_sensors(faulty(slow_sensor(8), runs))
    assert f"and {len(runs) - 1} more: each reading is repeated for 8 samples" in note and "late by 3.5 ms" in note
