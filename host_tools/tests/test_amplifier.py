"""Recordings with monitor_V: what comes late before it is the amplifier's, what comes late behind it the sensor's."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from injected import COMMISSIONING, FURTHER, drives, entry, plain_model, recorded
from plants import changed

from rdpi.data import Recording
from rdpi.identify import Options, around, fit
from rdpi.identify.identify import Fit
from rdpi.simulate import chain, effects, inverse_of

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
            assert low <= LATE[case][1][one.acting.effect.stage] <= high < 1.1 * low


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

    alone = fit([*map(without_monitor, monitored(*LATE["both"][0]))], Options(operators=6))
    assert missed_um(fitted("both").model) < 1.05 * missed_um(alone.model)


def test_each_says_where_it_stands_and_what_a_model_without_it_misses() -> None:
    found = fitted("both")
    told = around.lines(found.choice, found.model)
    for name, stage in (("delay", "timing"), ("lag", "amplifier"), ("delay", "sensor")):
        assert sum(line.startswith(f"  {name} at stage {stage}, as monitor_V shows: ") for line in told) == 1
    sections = {one.stage: one for one in around.sections(found.choice)}
    for stage in ("timing", "amplifier"):
        assert sections[stage].held_out_rms_um.before >= sections[stage].held_out_rms_um.after
    assert not any("monitor_V" in text for text in found.warnings)


def test_what_is_shorter_than_a_noisy_monitor_shows_stays_open() -> None:
    late = entry("delay", "timing", delay_s=0.0012)
    found = fit(monitored(late, noise_V=20.0, which=COMMISSIONING[:2]), Options(operators=6))
    (one,) = (one for one in found.model.effects if one["name"] in ("delay", "lag"))
    assert not one.get("stage_shown")
    assert any("nothing shows whether it is the sensor's" in line for line in inverse_of(found.model).lines)


def test_a_monitor_that_comes_later_than_the_displacement_is_not_used() -> None:
    """What stands between the amplifier and the column, a filter of the recorder, is no amplifier's."""
    runs = monitored(entry("lag", "amplifier", time_constant_s=0.02))
    apart = recorded(plain_model(), drives(COMMISSIONING))
    found = fit([changed(run, displacement_um=other.displacement_um) for run, other in zip(runs, apart)],
                Options(operators=6))
    assert any(text.startswith("monitor_V is not used: it comes later than the displacement (lag at stage amplifier")
               for text in found.warnings)
    assert not [one for one in found.model.effects if one["name"] == "lag"]


@pytest.mark.parametrize("limit", [entry("slew_limit", "amplifier", V_per_s=1500.0),
                                   entry("rail_saturation", "amplifier", V_min=5.0, V_max=90.0)])
def test_an_amplifier_at_its_limit_is_remarked_on(limit: dict) -> None:
    words = "monitor_V moves otherwise than the command behind a delay and a lag, by "
    assert any(text.startswith(words) for text in fit(monitored(limit), Options(operators=6)).warnings)
    assert not any(words in text for text in fitted("amplifier").warnings)


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
