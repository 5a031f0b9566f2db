"""Identification from several runs, and from runs that begin with any memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fitted import NOISE_UM, STATIC, moving_runs, percent, static_fit, static_run, visited
from plants import changed, marked, quasi_static, rate_of, slopes_um_per_V, stack, thresholds_um, waves

from rdpi.errors import BadInput
from rdpi.identify import checks, thresholds as tuned
from rdpi.identify.identify import Options, fit
from rdpi.simulate import chain


# ---- several runs ----

def test_sample_rates_and_lengths_mix() -> None:
    """Filters and windows are in seconds: the same drive sampled otherwise gives the same model."""
    runs = [static_run(rate_hz=rate, cycles=cycles, name=f"{rate:g}.csv")
            for rate, cycles in ((100.0, 4), (1000.0, 2), (10_000.0, 1))]
    result = fit(runs, STATIC)
    assert percent(slopes_um_per_V(result.model), stack().slopes) < 1.5
    assert max(run.score.rms_um for run in result.scores) < 1.3 * NOISE_UM
    alone = [fit([run], STATIC).model for run in runs[:2]]
    assert percent(slopes_um_per_V(alone[0]), slopes_um_per_V(alone[1])) < 1.5


def test_a_short_run_sampled_two_hundred_times_as_fast_takes_part() -> None:
    """Thinned, it keeps enough samples for all that looks at them."""
    slow = static_run(rate_hz=200.0, cycles=1, name="short.csv")
    short = marked(changed(slow, time_s=slow.time_s / 1000), sample_rate_hz="200000")
    setting = fit([static_run(rate_hz=1000.0), short]).choice.plain.state.setting
    assert len(setting.runs[1]) == len(short), "as long as its strokes are fast"
    assert len(short) > len(setting.thinned(1.0).runs[1]) >= tuned.CHOICE_LEAST


@pytest.mark.slow
def test_rate_law_does_not_depend_on_sampling() -> None:
    coarse, fine = (moving_runs("displacement", hertz=(2, 10, 30), samples=samples) for samples in (100, 500))
    models = [fit(runs, Options(thresholds_um=thresholds_um(stack(), runs))).model for runs in (coarse, fine)]
    for rate in (0, 1000):
        assert percent(slopes_um_per_V(models[0], rate), slopes_um_per_V(models[1], rate)) < 3


def test_slow_runs_do_not_blur_the_rate_of_fast_ones() -> None:
    """Each run's rate is smoothed by what its own noise asks for."""
    runs = moving_runs("displacement", 0.02, hertz=(30, 0.2))
    options = Options(thresholds_um=thresholds_um(stack(), runs))
    alone, beside = fit(runs[:1], options), fit(runs, options)
    peak = max(rate_of(waves(12.0, 30, 1, 9000), 9000))
    assert beside.model.rate.identified_um_per_s == pytest.approx(peak, rel=0.1)
    assert percent(slopes_um_per_V(beside.model, 1000), slopes_um_per_V(alone.model, 1000)) < 8


def test_a_small_run_beside_a_large_one() -> None:
    plant = stack()
    large = static_run(plant, name="large.csv")
    small = static_run(plant, high=25, low=0, name="small.csv", memory="carried")
    result = fit([large, small], STATIC)
    assert percent(slopes_um_per_V(result.model), plant.slopes) < 1.5
    score = result.scores[1].score
    assert score.rms_um < 1.5 * NOISE_UM
    assert score.rms_percent == pytest.approx(100 * score.rms_um / np.ptp(small.displacement_um))
    assert result.model.stroke_um == pytest.approx(np.ptp(large.displacement_um))


def test_a_run_counts_once() -> None:
    """Neither twice in the fit, nor fitted and held out."""
    for runs, held_out in (([static_run(), static_run()], []), ([static_run()], [static_run()])):
        with pytest.raises(BadInput, match=r"^run\.csv: given twice"):
            fit(runs, STATIC, held_out)


def test_the_same_samples_in_another_file_are_said() -> None:
    copy = replace(static_run(), path="copy.csv", digest="sha256:other")
    for runs, held_out in (([static_run(), copy], []), ([static_run()], [copy])):
        (told,) = (text for text in fit(runs, STATIC, held_out).warnings if "same samples" in text)
        assert told == "copy.csv holds the same samples as run.csv: it shows nothing more"


def test_recordings_that_were_read_at_two_moments_of_the_hold_are_said() -> None:
    """Half a sample between them would pass for a delay. The model tells later recordings from its own."""
    runs = [marked(static_run(name=f"{at}.csv", high=high), read_at=at) for at, high in (("middle", 60), ("switch", 50))]
    result = fit(runs[:1], STATIC, runs[1:])
    (told,) = (text for text in result.warnings if "--at" in text)
    assert "middle.csv with --at middle and switch.csv with --at switch" in told
    (alone,) = result.model.fit["runs"][:1]
    assert alone["read_at"] == "middle" and checks.read_differently(runs[:1], result.model) != []
    assert checks.read_differently(runs[:1], fit(runs[:1], STATIC).model) == []
    assert "read_at" not in fit([static_run()], STATIC).model.fit["runs"][0]


def test_an_actuator_late_by_half_a_period_is_not_taken_for_inverted_in_silence() -> None:
    run = static_run()
    time_s = np.arange(4000) / 1e4
    drive_V = 50 + 40 * np.sin(2 * np.pi * 200 * time_s) * (0.5 + 0.5 * np.sin(2 * np.pi * 2.5 * time_s))
    late = changed(run, time_s=time_s, command_V=drive_V, displacement_um=0.1 * np.roll(drive_V, 24))
    late = replace(late, metadata={**late.metadata, "sample_rate_hz": "10000"})
    assert any("late by half a period" in text for text in fit([late], STATIC).warnings)
    inverted = changed(run, displacement_um=12 - run.displacement_um)
    assert not any("late by half a period" in text for text in fit([inverted], STATIC).warnings)


# ---- memory at the start ----

def test_reset() -> None:
    plant = stack()
    plant.settle(45.0)
    rising = np.r_[np.linspace(45, 90, 300), waves(0, 1, 2, 1000, 90)]
    run = quasi_static(plant, rising, noise_um=NOISE_UM)
    result = fit([run], STATIC)
    assert result.scores[0].memory == "reset" and result.scores[0].score.rms_um < 1.3 * NOISE_UM
    assert percent(slopes_um_per_V(result.model), plant.slopes) < 1.5
    x0 = result.model.x_of(45.0)
    assert result.model.memory.x_um == pytest.approx(x0)
    assert result.model.memory.plays_um == pytest.approx(np.full(10, x0))


def test_carried() -> None:
    plant = stack()
    first = quasi_static(plant, np.r_[waves(90, 1, 1, 1000), np.linspace(0, 60, 200)], name="first.csv",
                         noise_um=NOISE_UM)
    second = quasi_static(plant, np.r_[np.linspace(60, 30, 200), waves(55, 1, 1, 1000, 30)], memory="carried",
                          name="second.csv", noise_um=NOISE_UM)
    result = fit([first, second], STATIC)
    assert [run.memory for run in result.scores] == ["reset", "carried"]
    assert max(run.score.rms_um for run in result.scores) < 3 * NOISE_UM
    mistaken = fit([first, marked(second, memory="reset")], STATIC)
    assert mistaken.scores[1].score.rms_um > 10 * NOISE_UM


def test_a_held_out_run_is_carried_on_from_the_one_before() -> None:
    plant = stack()
    first = quasi_static(plant, np.r_[waves(90, 1, 2, 1000), np.linspace(0, 60, 200)], name="first.csv",
                         noise_um=NOISE_UM)
    second, third = (quasi_static(plant, np.r_[np.linspace(60, low, 200), np.linspace(low, 60, 200)], memory="carried",
                                  name=f"{low}.csv", noise_um=NOISE_UM) for low in (20, 40))
    result = fit([first], STATIC, [second, third])
    assert [run.memory for run in result.scores] == ["reset", "carried", "carried"]
    assert max(run.score.rms_um for run in result.scores) < 5 * NOISE_UM


@pytest.mark.parametrize("low, high", [(30, 90), (30, 84), (30, 60), (30, 45)])
@pytest.mark.parametrize("drift_um", [0.0, 0.4])
def test_unknown_memory_is_estimated(low: float, high: float, drift_um: float) -> None:
    """Also that of runs too small to erase it all, where the rest is an offset."""
    model = static_fit().model
    plant = stack()
    plant.settle(high)
    plant.respond(np.linspace(high, low, 50), np.zeros(50))
    run = static_run(plant, low=low, high=high, memory="unknown")
    run = changed(run, displacement_um=run.displacement_um + drift_um)
    prediction = chain.simulate(model, [run])[0]
    assert prediction.memory == "estimated"
    score = chain.score(prediction.predicted_um, run.displacement_um, remove_offset=True)
    assert score.rms_percent < 0.6 and score.max_percent < 2.5
    at_rest = chain.simulate(model, [run], "reset")[0].predicted_um
    assert chain.score(at_rest, run.displacement_um, remove_offset=True).rms_percent > 3 * score.rms_percent


def test_a_start_that_is_not_known_is_estimated() -> None:
    """A past that is claimed wrongly goes into the model."""
    run = static_run(visited((0.0, 45.0, 30.0)), low=30, memory="unknown")
    found, claimed = (fit([one], STATIC).scores[0] for one in (run, marked(run, memory="reset")))
    assert found.memory == "estimated" and found.score.rms_um < claimed.score.rms_um / 2


def test_rates_before_the_memory_is_erased_are_identified() -> None:
    command = np.r_[waves(50, 20, 3, 1000), waves(90, 1, 2, 1000)]
    unknown, known = (fit([quasi_static(stack(), command, memory=memory, noise_um=NOISE_UM)], STATIC)
                      for memory in ("unknown", "reset"))
    assert unknown.model.rate.identified_um_per_s == pytest.approx(known.model.rate.identified_um_per_s, rel=0.01)


def test_unknown_memory_of_one_run_does_not_move_the_offset_of_others() -> None:
    known = static_run()
    unknown = static_run(visited((90.0, 30.0)), low=30, high=84, memory="unknown", name="unknown.csv")
    result = fit([known, unknown], STATIC)
    assert result.scores[0].score.rms_um < 3 * NOISE_UM


def test_model_remembers_where_the_first_run_began() -> None:
    run = static_run(visited((90.0, 30.0)), low=30, high=90, memory="unknown")
    model = fit([run], STATIC).model
    assert model.memory.x_um == pytest.approx(model.x_of(30.0))
    truth = np.minimum(90.0 - model.thresholds_um / model.gain_um_per_V, 30 + model.thresholds_um / model.gain_um_per_V)
    assert model.memory.plays_um == pytest.approx(model.x_of(truth), abs=0.6)
    model.validate()


def test_recordings_of_one_rate_are_named_where_the_model_rests_on_them() -> None:
    one, several = (fit(moving_runs("displacement", hertz=hertz)) for hertz in ((10,), (2, 10)))
    told = [text for text in one.warnings if "about the same rate" in text]
    assert len(told) == 1 and "its rate law may be another of them" in told[0]
    assert not any("about the same rate" in text for text in several.warnings)
    assert not any("about the same rate" in text for text in fit([static_run()], STATIC).warnings)


def test_a_transient_is_named_with_its_place() -> None:
    run = static_run()
    odd = run.displacement_um.copy()
    odd[200:203] += 4.0
    told = [text for text in fit([changed(run, displacement_um=odd)], STATIC).warnings if "most is missed at" in text]
    assert len(told) == 1 and any(f"at {time_s:.6g} s" in told[0] for time_s in run.time_s[200:203])
    assert not any("most is missed at" in text for text in static_fit().warnings)


@pytest.mark.parametrize("at", ["start", "edge"])
def test_what_a_model_misses_anyway_is_no_transient(at: str) -> None:
    """Behind an unknown past, and where the drive steps."""
    run = static_run(memory="unknown" if at == "start" else "reset")
    command_V, odd = run.command_V.copy(), run.displacement_um.copy()
    sample = 20 if at == "start" else 700
    odd[sample:sample + 2] += 12.0
    if at == "edge":
        command_V[sample:sample + 2] += 20.0
    assert not any("most is missed at" in text for text in fit([changed(run, command_V=command_V, displacement_um=odd)],
                                                               STATIC).warnings)


def test_a_monitor_that_cannot_be_one_is_refused() -> None:
    run = static_run()
    for monitor_V, words in ((-run.command_V, "moves -1 V per volt"), (np.zeros(len(run)), "constant at 0 V")):
        with pytest.raises(BadInput, match=words):
            fit([changed(run, monitor_V=monitor_V)], STATIC)
