"""What an identification reports, remarks on and refuses."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fitted import NOISE_UM, SPAN_V, STATIC, moving_runs, static_fit, static_run, visited
from injected import COMMISSIONING, drives, entry, plain_model, recorded
from plants import changed, marked, quasi_static, stack, thresholds_um, waves
from scipy.signal import lfilter

from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.identify import checks, identify, passport
from rdpi.identify import thresholds as tuned
from rdpi.identify.identify import FOLDS, Fit, Options, fit
from rdpi.simulate import chain


# ---- what is reported ----

def test_held_out_scores_are_those_of_a_simulation() -> None:
    held = [static_run(high=60, cycles=2, name="held.csv"),
            static_run(high=40, low=10, cycles=2, name="other.csv", memory="unknown")]
    result = fit([static_run()], STATIC, held)
    assert [run.held_out for run in result.scores] == [False, True, True]
    for run, prediction in zip(result.scores[1:], chain.simulate(result.model, held)):
        assert run.score == chain.score(prediction.predicted_um, run.recording.displacement_um)
        error = run.recording.displacement_um - prediction.predicted_um
        assert run.score.rms_um == pytest.approx(np.sqrt(np.mean(error**2)))
        assert run.score.max_percent == pytest.approx(100 * np.abs(error).max() / np.ptp(run.recording.displacement_um))
    assert static_fit().model.slopes == pytest.approx(result.model.slopes, rel=0, abs=0)


def test_an_exact_model_predicts_its_own_rate() -> None:
    """Without noise nothing smooths the measured rate; the prediction must find its own all the same."""
    runs = moving_runs("displacement", 0.0, hertz=(1, 2, 5))
    result = fit(runs, Options(thresholds_um=thresholds_um(stack(), runs)))
    assert max(run.score.max_percent for run in result.scores) < 0.4


def test_record() -> None:
    runs, held = [static_run(name="a.csv")], [static_run(name="b.csv", memory="unknown")]
    result = fit(runs, STATIC, held)
    record = result.model.fit
    assert [run["file"] for run in record["runs"]] == ["a.csv", "b.csv"]
    assert [run["digest"] for run in record["runs"]] == ["sha256:a.csv", "sha256:b.csv"]
    assert [run["held_out"] for run in record["runs"]] == [False, True]
    assert [run["memory"] for run in record["runs"]] == ["reset", "estimated"]
    assert [run["samples"] for run in record["runs"]] == [1500, 1500]
    for row, run in zip(record["runs"], result.scores):
        assert {key: row[key] for key in run.score._fields} == run.score._asdict()
    assert record["warnings"] == result.warnings
    assert not any("left out of the fit" in text for text in result.warnings if text.startswith("b.csv"))


def test_passport_holds_each_run_as_the_others_predict_it() -> None:
    """The second run is of another actuator, nearly, so that fitting it or not shows."""
    first, third = static_run(name="first.csv"), static_run(high=60, low=10, name="third.csv")
    odd = static_run(high=70, low=20, name="second.csv")
    odd = changed(odd, displacement_um=1.05 * odd.displacement_um)
    result = fit([first, odd, third], STATIC)
    runs = result.model.passport["runs"]
    assert [(run["file"], run["digest"]) for run in runs] == [(f"{k}.csv", f"sha256:{k}.csv")
                                                              for k in ("first", "second", "third")]
    assert {run["held_out"] for run in runs} == {passport.LEFT_OUT} == {result.model.passport["held_out"]}
    for run, score in zip(runs, result.scores):
        spread = np.sqrt(score.score.rms_um**2 - score.score.offset_um**2)
        assert run["fitted_rms_um"] == pytest.approx(spread, rel=1e-3)
    # without the second run, range and gain, and with them thresholds and dead zones, are the same
    other = fit([first, third], STATIC).model
    error = odd.displacement_um - chain.simulate(other, [odd])[0].predicted_um
    assert runs[1]["rms_um"] == pytest.approx(np.std(error), rel=0.03)
    assert runs[1]["rms_um"] > 1.3 * runs[1]["fitted_rms_um"]
    assert result.model.slopes != pytest.approx(other.slopes, rel=1e-3)


def test_passport_of_held_out_runs_and_of_a_single_one() -> None:
    held = static_run(high=60, cycles=2, name="held.csv")
    result = fit([static_run()], STATIC, [held])
    known = result.model.passport
    assert known["held_out"] == passport.OTHER_RUNS
    assert [run["held_out"] for run in known["runs"]] == [passport.LEFT_OUT, passport.OTHER_RUNS]
    score = result.scores[1].score
    assert known["runs"][1]["rms_um"] == pytest.approx(np.sqrt(score.rms_um**2 - score.offset_um**2), rel=1e-3)
    assert known["runs"][1]["fitted_rms_um"] is None


def test_passport_of_a_single_run_leaves_out_its_parts() -> None:
    (run,) = (one.recording for one in static_fit().scores)
    (known,) = static_fit().model.passport["runs"]
    assert known["held_out"] == passport.LEFT_OUT == static_fit().model.passport["held_out"]
    assert known["fitted_rms_um"] < known["rms_um"] < 2 * known["fitted_rms_um"]
    odd = run.displacement_um.copy()
    quarter = slice(3 * len(odd) // 4, None)
    odd[quarter] *= 1.05
    (apart,) = fit([changed(run, displacement_um=odd)], STATIC).model.passport["runs"]
    assert apart["rms_um"] > 1.2 * apart["fitted_rms_um"], "the others do not know the last part"


def test_passport_of_a_single_run_too_short_to_leave_out_parts() -> None:
    known = fit([static_run(rate_hz=25.0, cycles=3)], STATIC).model.passport
    assert known["held_out"] == passport.FITTED


def test_passport_of_runs_with_a_rate_law() -> None:
    """Left out in turn, the fastest run too, the model still predicts them at the rate they have."""
    known = fit(moving_runs("displacement"), Options(thresholds_um=thresholds_um(
        stack(), moving_runs("displacement")))).model.passport
    assert all(run["held_out"] == passport.LEFT_OUT for run in known["runs"])
    assert all(run["rms_um"] < 4 * run["fitted_rms_um"] for run in known["runs"])


def test_passport_of_many_runs_leaves_out_groups() -> None:
    high = np.linspace(60, SPAN_V, FOLDS + 3)
    known = fit([static_run(high=top, cycles=1, name=f"{top:.0f}.csv") for top in high], STATIC).model.passport
    assert [run["held_out"] for run in known["runs"]] == [passport.LEFT_OUT] * len(high)
    assert all(run["rms_um"] < 3 * NOISE_UM for run in known["runs"])


def test_a_passport_where_the_other_runs_make_no_model() -> None:
    """What is left without the first run is too short to be fitted."""
    short = static_run(high=80, cycles=1, rate_hz=20.0, name="short.csv")
    known = fit([static_run(), short], STATIC).model.passport
    assert [run["held_out"] for run in known["runs"]] == [passport.FITTED, passport.LEFT_OUT]


def test_same_input_same_bits() -> None:
    runs = moving_runs("displacement", 0.02)
    first, second = (fit(runs, Options()) for _ in range(2))
    assert first.model.to_json() == second.model.to_json()
    assert first.rate_slopes.bands() == second.rate_slopes.bands()


def test_progress_rises_to_one() -> None:
    seen: list[float] = []
    fit([static_run(), static_run(name="again.csv")], STATIC, progress=seen.append)
    assert len(seen) > 2 and seen == sorted(seen) and 0 <= seen[0] and seen[-1] == 1


# ---- what is refused ----

def bent(**change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    run = static_run(name="bad.csv")
    return changed(run, **{key: make(run.columns[key]) for key, make in change.items()})


NOISE = np.random.default_rng(2).standard_normal(1500)
REFUSED: dict[str, tuple[Recording, str]] = {
    "constant command": (bent(command_V=lambda V: 0 * V + 5), r"command_V is constant at 5 V.*excite"),
    "constant displacement": (bent(displacement_um=lambda z: 0 * z - 2.5),
                              r"displacement_um is constant at -2\.5 um.*check"),
    "unrelated": (bent(displacement_um=lambda z: NOISE), r"unrelated.*correlation.*check"),
    "unrelated but smooth": (bent(displacement_um=lambda z: waves(12, 1.37, 4.11, 500)), r"unrelated.*check"),
    "only a ramp": (bent(command_V=lambda V: np.linspace(0, 90, 1500),
                         displacement_um=lambda z: np.linspace(0, 12, 1500) + 0.004 * NOISE),
                    r"command_V never changes direction.*rdpi excite"),
    "picometres": (bent(displacement_um=lambda z: 1e6 * z), r"displacement_um reaches 1\.2\d*e\+07; check its unit"),
    "microvolts": (bent(command_V=lambda V: 1e6 * V), r"command_V reaches 9e\+07; check its unit"),
    "sampled faster than the firmware's numbers": (
        replace(bent(time_s=lambda t: t * 500 / 2e7), metadata={"sample_rate_hz": "2e7"}),
        r"sampled at 2e\+07 Hz, beyond the firmware's 1e\+07; check"),
    "offset too large for single precision": (bent(displacement_um=lambda z: z + 9e5),
                                              r"moves by 12\.\d um at 90000\d.*subtract"),
}


@pytest.mark.parametrize("case", REFUSED)
@pytest.mark.parametrize("held_out", [False, True])
def test_refused_recording(case: str, held_out: bool) -> None:
    run, message = REFUSED[case]
    with pytest.raises(BadInput, match=message) as refusal:
        fit([static_run(), *([] if held_out else [run])], STATIC, [run] if held_out else [])
    assert str(refusal.value).startswith("bad.csv: ")
    if not held_out:
        with pytest.raises(BadInput, match=r"^bad\.csv: "):
            fit([run], Options())


@pytest.mark.parametrize("change, message", [
    (dict(command_V=lambda V: V / 1000),
     r"bad\.csv moves 1\d\d um/V, but run\.csv moves 0\.1\d+ um/V: their units or .*differ; check"),
    (dict(displacement_um=lambda z: z + 9),
     r"bad\.csv: lies 9(\.0\d*)? um from run\.csv at the same command; .*subtract"),
    (dict(displacement_um=lambda z: 12 - z), r"bad\.csv: moves opposite to run\.csv; .*sign"),
])
def test_runs_that_do_not_belong_together(change: dict[str, Callable], message: str) -> None:
    bad = replace(bent(**change), digest="sha256:bad")
    with pytest.raises(BadInput, match=message):
        fit([static_run(), bad], STATIC)
    assert fit([bad], STATIC).model


@pytest.mark.parametrize("limits", [{"min_V": 0.0, "max_V": 0.09}, {"min_V": 100.0}, {"max_V": -1.0},
                                    {"min_V": 1e3, "max_V": 1e5}])
def test_limits_in_other_units_than_the_drive(limits: dict[str, float]) -> None:
    options = replace(STATIC, **limits)
    with pytest.raises(BadInput, match=r"run\.csv: the recorded drive goes from 0 to 90 V, .* (--min-V|--max-V) .*in V"):
        fit([static_run()], options)


def test_a_small_sweep_through_a_resonance_is_of_the_same_actuator() -> None:
    """It moves ten times as far as its command says, from 30 Hz on against it, and later than it."""
    time_s = np.arange(4000) / 500
    command_V = 45 + 5 * np.sin(2 * np.pi * (2 * time_s + 4 * time_s**2))  # 2 to 66 Hz
    turn = 2 * np.pi * 30 / 500
    poles = 2 * np.exp(-0.03 * turn) * np.cos(turn), -np.exp(-0.06 * turn)
    ringing = lfilter([1 - sum(poles)], [1, -poles[0], -poles[1]], command_V - 45)
    chirp = Recording("chirp.csv", {}, {"time_s": time_s, "command_V": command_V, "displacement_um": 6 + 0.13 * ringing})
    assert np.max(np.abs(checks.late_correlations(chirp, chirp.displacement_um))) < tuned.MIN_CORRELATION
    checks.check_run(chirp)
    gains = [np.ptp(run.displacement_um) / np.ptp(run.command_V) for run in (static_run(), chirp)]
    assert gains[1] > 1.5 * tuned.GAIN_SPREAD * gains[0]
    checks.check_together([static_run(), chirp], [])
    with pytest.raises(BadInput, match="chirp.csv moves .* their units or actuators differ"):
        checks.check_together([static_run(), replace(chirp, columns={
            **chirp.columns, "displacement_um": 20 * chirp.displacement_um})], [])


@pytest.mark.parametrize("run, note", [
    (bent(displacement_um=lambda z: np.minimum(z, 11.0)),
     r"^bad\.csv: \d+ samples stay at the highest .*clipped"),
    (bent(displacement_um=lambda z: z + np.linspace(0, 4, len(z))),
     r"^bad\.csv: the model misses this run by [3-9]\.?\d* % rms .*drift"),
])
def test_doubtful_recordings_are_remarked_on(run: Recording, note: str) -> None:
    assert [text for text in fit([run], STATIC).warnings if re.search(note, text)]


@pytest.mark.parametrize("aside_um", [50.0, -6.0])
def test_a_disturbed_reading_is_named(aside_um: float) -> None:
    """It would pass for stroke. A pulse that the command has as well, or a step, is none."""
    run = static_run()
    z, V = run.displacement_um.copy(), run.command_V.copy()
    z[700] += aside_um
    with pytest.raises(BadInput, match=rf"run\.csv: displacement_um is .* in sample 700 .*{abs(aside_um):.0f}.* um from"):
        fit([replace(run, columns={**run.columns, "displacement_um": z})], STATIC)
    V[700] += 60 if V[700] < 50 else -60
    checks.check_readings(replace(run, columns={**run.columns, "displacement_um": z, "command_V": V}))
    z[700:] += aside_um
    z[700] -= aside_um
    checks.check_readings(replace(run, columns={**run.columns, "displacement_um": z}))


def test_ringing_is_no_disturbed_reading() -> None:
    run = static_run()
    since = np.arange(len(run) - 700)
    for period in (2.3, 3.3, 4.1):
        z = run.displacement_um.copy()
        z[700:] += 50 * np.exp(-since / 20) * np.sin(2 * np.pi * since / period)
        checks.check_readings(replace(run, columns={**run.columns, "displacement_um": z}))


def test_a_recording_of_days_is_remarked_on() -> None:
    """Its times may be in microseconds; and no pole of creep lasts longer than a sample."""
    run = moving_runs("displacement", law=0.0)[0]
    slow = replace(run, metadata={**run.metadata, "sample_rate_hz": repr(run.sample_rate_hz / 1e6)},
                   columns={**run.columns, "time_s": 1e6 * run.time_s})
    for one, told in ((run, False), (slow, True)):
        found = fit([one], Options(rate_independent=True))
        assert any("times are taken for seconds" in text for text in found.warnings) is told
        assert not told or all(effect["name"] != "creep" for effect in found.model.effects)
    with pytest.raises(BadInput, match="cannot show creep"):
        fit([slow], Options(effects="creep"))


def test_a_recording_of_hours_is_remarked_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its times may be in milliseconds, although it has several samples per second."""
    run = moving_runs("displacement", law=0.0)[0]
    slow = replace(changed(run, time_s=10 * run.time_s), metadata={**run.metadata, "sample_rate_hz": "30"})
    assert run.sample_rate_hz == 300 and slow.sample_rate_hz > tuned.SLOW_HZ and len(slow) / 30 < tuned.LONG_S
    for longest_s, told in ((tuned.LONG_S, False), (len(slow) / 40, True)):
        monkeypatch.setattr(tuned, "LONG_S", longest_s)
        warnings = fit([slow], Options(rate_independent=True, effects="none")).warnings
        assert any("times are taken for seconds" in text for text in warnings) is told


@pytest.mark.parametrize(("factor", "unit"), [(1.0, None), (1e3, "nm"), (1e-6, "mm or m")])
def test_a_stroke_that_no_piezo_has_is_remarked_on(factor: float, unit: str | None) -> None:
    run = static_run()
    warnings = fit([changed(run, displacement_um=factor * run.displacement_um)], STATIC).warnings
    told = [text for text in warnings if "displacements are taken for um" in text]
    assert [f"if they are in {unit}," in text for text in told] == ([] if unit is None else [True])


@pytest.mark.parametrize("factor", [1.0, 1e3])
def test_a_drive_that_no_piezo_has_is_remarked_on(factor: float) -> None:
    run = static_run()
    warnings = fit([changed(run, command_V=factor * run.command_V)], STATIC).warnings
    assert any("commands are taken for volts" in text for text in warnings) is (factor > 1)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("swapped", [False, True])
def test_loops_that_run_the_wrong_way_round_are_remarked_on(sign: int, swapped: bool) -> None:
    run = static_run()
    volts, displacement = run.command_V, sign * run.displacement_um
    both = {"command_V": displacement, "displacement_um": volts} if swapped else \
        {"command_V": volts, "displacement_um": displacement}
    warnings = fit([changed(run, **both)], replace(STATIC, effects="none")).warnings
    assert any("the columns are not swapped" in text for text in warnings) is swapped


def test_a_displacement_that_comes_first_is_remarked_on() -> None:
    """Its loops get narrower with the rate."""
    def early(time_s: float) -> list[str]:
        runs = []
        for run in moving_runs("displacement", law=0.0):
            samples = round(time_s * run.sample_rate_hz)
            runs.append(replace(run, columns={"time_s": run.time_s[samples:],
                                              "command_V": run.command_V[:len(run) - samples],
                                              "displacement_um": run.displacement_um[samples:]}))
        return [text for text in fit(runs, Options(effects="none")).warnings if "come before the command" in text]

    assert not early(0.0) and early(0.002)


def test_what_a_model_says_to_come_late_does_not_come_first() -> None:
    """Although the loops behind the lag get narrower."""
    found = fit(recorded(plain_model(-0.2), drives(COMMISSIONING), entry("lag", time_constant_s=0.003)),
                Options(effects="lag"))
    model = found.model
    assert model.slopes_at(model.rate.max_um_per_s)[0] / model.slopes[0] - 1 > tuned.NARROWER
    assert not any("come before the command" in text for text in found.warnings)


@pytest.mark.parametrize(("memory", "end_V"), [("reset", None), ("unknown", 45.0)])
def test_the_start_up_sweep_of_a_model_whose_memory_is_estimated_ends_in_the_middle(memory: str, end_V: float | None) -> None:
    assert fit([marked(static_run(), memory=memory)], STATIC).model.drive.sweep_end_V == end_V


def test_small_movements_of_unknown_past_are_missed_by_little() -> None:
    """Their past leaves a constant, and a large share of what they move; none of it says that they are another actuator's."""
    small = static_run(visited((90.0, 30.0)), low=40, high=46, name="small.csv", memory="unknown")
    small = changed(small, displacement_um=small.displacement_um + 0.4)
    found = fit([static_run(), small], STATIC)
    score = found.scores[1].score
    assert score.rms_percent > tuned.POOR_PERCENT > 100 * score.beside_offset_um / found.model.stroke_um
    assert not any("misses this run" in text for text in found.warnings)
    broken = changed(small, displacement_um=small.displacement_um + 0.3 * np.random.default_rng(1).standard_normal(len(small)))
    assert any(text.startswith("small.csv: the model misses this run") for text in fit([static_run(), broken], STATIC).warnings)


def test_a_start_unlike_the_others_is_remarked_on() -> None:
    runs = [static_run(), static_run(high=80, name="b.csv"), static_run(visited((90.0, 0.0)), name="bad.csv")]
    result = fit([replace(run, digest=f"sha256:{run.path}") for run in runs], STATIC)
    assert any(re.match(r"bad\.csv: marked memory: reset, but .*unknown", text) for text in result.warnings)


def test_recordings_of_different_actuators_are_remarked_on() -> None:
    runs = [marked(run, actuator=run.path) for run in (static_run(name="a"), static_run(name="b"))]
    assert "the recordings name different actuators: a, b" in fit(runs, STATIC).warnings


@pytest.mark.parametrize("options, message", [
    (Options(operators=-1), "`operators` -1"), (Options(operators=129), "`operators` 129"),
    (Options(deadzones=-1), "`deadzones` -1"), (Options(deadzones=7), "`deadzones` 7"),
    (Options(min_slope_ratio=0.0), "`min_slope_ratio` 0"), (Options(min_slope_ratio=1.0), "`min_slope_ratio` 1"),
    (Options(min_slope_ratio=float("nan")), "`min_slope_ratio` nan"),
    (Options(thresholds_um=(1.0, 1.0)), "`thresholds_um`"), (Options(thresholds_um=(-1.0, 1.0)), "`thresholds_um`"),
    (Options(thresholds_um=(2.0, 1.0)), "`thresholds_um`"), (Options(thresholds_um=(1.0, float("nan"))), "`thresholds_um`"),
    (Options(thresholds_um=(1.0, float("inf"))), "`thresholds_um`"),
    (Options(rate_window_s=-1.0), "`rate_window_s` -1"), (Options(rate_filter_s=-1.0), "`rate_filter_s` -1"),
    (Options(rate_window_s=100.0), "window"),
])
def test_refused_options(options: Options, message: str) -> None:
    """The argument is named; `rdpi fit` says its option (test_cli_fit)."""
    with pytest.raises(BadInput, match=message):
        fit([static_run()], options)


def test_a_short_recording() -> None:
    """Sixteen samples, the fewest that a recording may have, are too few for ten slopes and enough for one."""
    run = static_run(cycles=1, rate_hz=16, noise_um=0.0)
    with pytest.raises(BadInput, match=r"^run\.csv: the fit has 13 unknowns, but only 16 samples .*; record longer"):
        fit([run], STATIC)
    result: Fit = fit([run], replace(STATIC, operators=1, deadzones=0))
    result.model.validate()
    assert result.scores[0].score.rms_percent < 2


def test_a_run_of_unknown_memory_that_never_turns_round_once_it_is_erased() -> None:
    command = np.r_[np.linspace(45, 0, 500), np.linspace(0, 90, 1000)]
    run = quasi_static(visited((90.0, 30.0, 45.0)), command, noise_um=NOISE_UM, memory="unknown")
    assert fit([run], STATIC).scores[0].score.rms_percent < 2


def test_passport_of_a_single_run_whose_memory_is_erased_late() -> None:
    """Each part holds samples that count."""
    run = static_run()
    low = np.r_[np.full(len(run), 40.0) + 5 * np.sin(np.arange(len(run)) / 50), run.command_V]
    z = np.r_[np.full(len(run), run.displacement_um[0]), run.displacement_um]
    late = changed(run, time_s=np.arange(len(low)) * run.sample_time_s, command_V=low, displacement_um=z)
    known = fit([marked(late, memory="unknown")], STATIC).model.passport
    assert known["held_out"] == passport.LEFT_OUT and np.isfinite(known["spread"])


def tried(*squares: float) -> list[identify._Tried]:
    """Models that miss this in each of eight blocks, give or take a tenth."""
    scatter = 1 + 0.1 * np.array([1, -1] * 4)
    return [identify._Tried(None, [], [], square * np.roll(scatter, k)) for k, square in enumerate(squares)]


def test_a_smaller_model_is_taken_where_it_misses_less_for_certain() -> None:
    for squares, best in (((1.0, 2.0, 0.5), 2), ((1.0, 0.98, 2.0), 0), ((1.0, 0.5, 0.4), 2)):
        models = tried(*squares)
        found = identify._best_first(models)
        assert found[0] is models[best] and set(map(id, found)) == set(map(id, models))
        others = [one.missed_um for one in found[1:]]
        assert others == sorted(others)
