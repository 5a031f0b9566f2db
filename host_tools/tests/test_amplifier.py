"""Recordings with monitor_V: what comes late before it is the amplifier's, what comes late behind it the sensor's."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from injected import COMMISSIONING, FURTHER, RATE_HZ, drives, entry, plain_model, recorded
from plants import changed, recording

from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.identify import Options, amplifier, around, fit
from rdpi.identify.identify import Fit
from rdpi.identify.report.page import page_of
from rdpi.simulate import chain, effects, inverse_of
from rdpi.simulate.effects import Sensor

MONITOR_NOISE_V = 0.01
AHEAD = entry("delay", "timing", delay_s=0.0012), entry("lag", "amplifier", time_constant_s=0.002)
BEHIND = entry("lag", "sensor", time_constant_s=0.004), entry("delay", "sensor", delay_s=0.0025)
LATE = {  # effects, those that monitor_V shows, and true times by stage
    "amplifier": (AHEAD, {"timing": 0.0012, "amplifier": 0.002}),
    "delay of the amplifier": (AHEAD[:1], {"timing": 0.0012}),
    "sensor": (BEHIND[:1], {"sensor": 0.004}),
    "both": (AHEAD + BEHIND[1:], {"timing": 0.0012, "amplifier": 0.002, "sensor": 0.0025})}


def monitored(*entries: dict, noise_V: float = MONITOR_NOISE_V, which: tuple[str, ...] = COMMISSIONING) -> list[Recording]:
    """Recordings of a model with these effects, and what its amplifier puts out."""
    model = replace(plain_model(), effects=list(entries))
    acting = [one for one in effects.acting(model) if one.effect.before_monitor]
    random = np.random.default_rng(4)
    return [changed(run, monitor_V=effects.driven(acting, run.command_V, run, model)
                    + noise_V * random.standard_normal(len(run)))
            for run in recorded(plain_model(), drives(which), *entries)]


def without_monitor(run: Recording) -> Recording:
    return replace(run, columns={name: values for name, values in run.columns.items() if name != "monitor_V"})


@lru_cache(maxsize=None)
def fitted(case: str) -> Fit:
    return fit(monitored(*LATE[case][0]), Options(operators=6))


@lru_cache(maxsize=None)
def unmonitored(case: str) -> Fit:
    return fit([*map(without_monitor, monitored(*LATE[case][0]))], Options(operators=6))


@pytest.mark.parametrize("case", LATE)
def test_each_part_gets_its_own_time(case: str) -> None:
    found, times = fitted(case), LATE[case][1]
    said = {one.effect.stage: one.values[one.effect.late_by] for one in effects.acting(found.model) if one.effect.late_by}
    assert said == {stage: pytest.approx(time_s, rel=0.05) for stage, time_s in times.items()}
    shown = [one["stage_shown"] for one in found.model.effects if one["name"] in ("delay", "lag")]
    assert shown == [True] * len(times)


@pytest.mark.parametrize("case", LATE)
def test_intervals_hold_the_times_that_the_monitor_shows(case: str) -> None:
    for one in fitted(case).choice.kept:
        if one.acting.effect.before_monitor:
            (low, high), = one.ci95.values()
            assert low <= LATE[case][1][one.acting.effect.stage] <= high < low + 0.6 / RATE_HZ


def test_the_firmware_compensates_what_is_the_amplifiers_only() -> None:
    inverse = inverse_of(fitted("both").model)
    assert (inverse.chain.delay_s, inverse.chain.lag_s) == pytest.approx((0.0012, 0.002), rel=0.05)
    assert [one.why for one in inverse.told if one.how == "left out"] == [
        "it is the sensor's, the actuator does not show it"]
    assert not any("nothing shows whether" in line for line in inverse.lines)


def test_what_was_not_fitted_is_predicted_as_well_as_without_a_monitor() -> None:
    """Recordings that need not have the column."""
    unseen = recorded(plain_model(), drives(FURTHER), *LATE["both"][0], seed=5)

    def missed_um(model):
        return np.sqrt(np.mean(np.concatenate([run.displacement_um - one.predicted_um for run, one in zip(
            unseen, chain.simulate(model, unseen))]) ** 2))

    assert missed_um(fitted("both").model) < 1.05 * missed_um(unmonitored("both").model)


def test_each_says_where_it_stands_and_what_a_model_without_it_misses() -> None:
    found = fitted("both")
    told = around.lines(found.choice, found.model)
    for name, stage in (("delay", "timing"), ("lag", "amplifier"), ("delay", "sensor")):
        assert sum(line.startswith(f"  {name} at stage {stage}, as monitor_V shows: ") for line in told) == 1
    assert [" without it " in line for line in told[1:]] == [False, False, True]  # the amplifier's hide behind the sensor's
    sections = {one.stage: one for one in around.sections(found.choice)}
    assert all(one.stage_shown for one in sections.values())
    page = page_of(found, [run.recording for run in found.scores], found.document("model.json", False))
    for stage in sections:
        assert page.count(f"Stage: {stage}, as monitor_V shows.") == 1
    for stage in ("timing", "amplifier"):
        assert sections[stage].held_out_rms_um.before >= sections[stage].held_out_rms_um.after
    assert not any("monitor_V" in text for text in found.warnings)


def test_what_is_shorter_than_a_noisy_monitor_shows_stays_open() -> None:
    late = entry("delay", "timing", delay_s=0.0012)
    found = fit(monitored(late, noise_V=20.0, which=COMMISSIONING[:2]), Options(operators=6))
    (one,) = (one for one in found.model.effects if one["name"] in ("delay", "lag"))
    assert not one.get("stage_shown")
    assert any("nothing shows whether it is the sensor's" in line for line in inverse_of(found.model).lines)


NOT_USED = "monitor_V is not used: driven by it, the model misses "


@pytest.mark.parametrize("wrong", ["other clock", *(
    pytest.param(wrong, marks=pytest.mark.long) for wrong in ("hum", "slow probe", "glitches", "clipped", "stands still"))])
def test_a_monitor_that_does_not_show_the_drive_is_not_used(wrong: str) -> None:
    """The model is then that of recordings without the column."""
    runs, random = monitored(*LATE["both"][0]), np.random.default_rng(2)
    filter_ = effects.acting(replace(plain_model(), effects=[entry("lag", "amplifier", time_constant_s=0.02)]))
    spoil = {"slow probe": lambda run, monitor: effects.driven(filter_, monitor, run, plain_model()),
             "other clock": lambda run, monitor: np.r_[np.full(15, monitor[0]), monitor[:-15]],
             "hum": lambda run, monitor: monitor + 5 * np.sin(2 * np.pi * 50 * run.time_s),
             "glitches": lambda run, monitor: monitor + 500 * (random.random(len(run)) < 0.001),
             "clipped": lambda run, monitor: np.clip(monitor, 10, 60),
             "stands still": lambda run, monitor: run.command_V + 1e-3}[wrong]
    found = fit([changed(run, monitor_V=spoil(run, run.columns["monitor_V"])) for run in runs], Options(operators=6))
    assert any(text.startswith(NOT_USED) for text in found.warnings)
    assert found.model.effects == unmonitored("both").model.effects


@pytest.mark.parametrize("limit", [
    entry("slew_limit", "amplifier", V_per_s=1500.0),
    pytest.param(entry("rail_saturation", "amplifier", V_min=5.0, V_max=90.0), marks=pytest.mark.long)])
def test_an_amplifier_at_its_limit_is_remarked_on(limit: dict) -> None:
    words = "monitor_V moves otherwise than the command behind a delay and a lag, by "
    assert any(text.startswith(words) for text in fit(monitored(limit), Options(operators=6)).warnings)
    assert not any(words in text for text in fitted("amplifier").warnings)


def test_a_monitor_that_is_the_command_is_not_used() -> None:
    runs = [changed(run, monitor_V=run.command_V) for run in monitored(*AHEAD[:1])]
    found = fit(runs, Options(operators=6))
    assert any("it is command_V to the last digit" in text for text in found.warnings)
    assert {one["stage"] for one in found.model.effects} == {"timing"}


def test_a_plain_rig_stays_plain_beside_its_monitor() -> None:
    found = fit(monitored(), Options(operators=6))
    assert found.model.effects == [] and not any("monitor_V" in text for text in found.warnings)


def test_the_better_of_delay_and_lag_is_taken_where_a_monitor_is_noisy() -> None:
    runs = monitored(*AHEAD[:1], noise_V=0.5)
    found = amplifier.seen_by_monitor(runs, plain_model(), None)
    assert [one.effect.name for one in found.acting] == ["delay"]


def test_a_drive_that_moves_only_at_its_end_is_no_division_by_zero() -> None:
    command = np.r_[np.zeros(3000), 50 - 50 * np.cos(np.arange(300) / 20)]
    run = changed(recording(command, 0.1 * command, 1000.0, "late.csv"), monitor_V=np.r_[[0.0] * 2, command[:-2]])
    with np.errstate(divide="raise", invalid="raise"):
        found = amplifier.seen_by_monitor([run], plain_model(), None)
    assert sum(one.values[one.effect.late_by] for one in found.acting) == pytest.approx(0.002, rel=0.05)


def test_a_sensor_that_is_known_is_not_taken_away_again() -> None:
    with pytest.raises(BadInput, match="the model knows already what is the sensor's: leave both options out"):
        inverse_of(fitted("both").model, sensor=Sensor(0.0025, 0.0))


def test_a_monitor_in_some_recordings_only_is_not_used() -> None:
    first, *others = monitored(*AHEAD)
    found = fit([without_monitor(first), *others], Options(operators=6))
    assert f"monitor_V is not used, because {first.path} lacks it" in found.warnings
    assert {one["stage"] for one in found.model.effects} <= {"timing", "amplifier"}


def test_only_what_is_asked_for_is_taken_from_the_monitor() -> None:
    runs = monitored(*AHEAD)
    named = fit(runs, Options(operators=6, effects=("lag",)))
    assert {one["name"] for one in named.model.effects} == {"lag"}
    none = fit(runs, Options(operators=6, effects="none"))
    assert none.model.effects == [] and not any("monitor_V" in text for text in none.warnings)
