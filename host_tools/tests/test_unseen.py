"""What commissioning never showed is not known: said of frequencies and positions, with the drive that shows it."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benches import swept_and_played, vb
from injected import LIMITS, RATE_HZ, Drives, commissioned, drives, entry, plain_model, recorded
from plants import changed, marked, recording

from rdpi.data import Recording, excite, read_recording
from rdpi.gap import Diagnosis, diagnose, diagnosis, experiment, unseen
from rdpi.gap.augmented import AugmentedModel
from rdpi.gap.report import words
from rdpi.gap.sections import NotKnown
from rdpi.gap.selection import Excess, Selection
from rdpi.gap.spectrum import Spectrum
from rdpi.identify import Options, checks, fit, passport
from rdpi.model import Model, Passport
from rdpi.simulate import chain
from rdpi.simulate.effects import CATALOGUE

SLOW: Drives = (("sawtooth", {"frequencies_hz": (0.5, 2.0), "cycles": 2}, 1.0), ("minor-loops", {"levels": 4}, 1.0),
                ("multisine", {"duration_s": 10.0, "frequencies_hz": (0.4, 0.6, 1.0, 1.4, 2.2), "seed": 1}, 1.0))
FAST: Drives = (("sine", {"frequencies_hz": (60.0, 61.0), "cycles": 60}, 0.3),
                ("multisine", {"duration_s": 10.0, "frequencies_hz": (0.5, 1.0, 1.7), "seed": 4}, 0.9),
                ("sine", {"frequencies_hz": (45.0,), "cycles": 50}, 0.4))
RIG = entry("lag", "amplifier", time_constant_s=5e-4)  # from the first day, but slow drives do not show it


@lru_cache(maxsize=None)
def slowly_commissioned(share: float = 1.0) -> Model:
    return fit(commissioning(share), Options(rate_independent=True, effects="none")).model


def unswept(canned: Drives, share: float = 1.0) -> list[Recording]:
    """Without the sweep, which is fast."""
    return drives(tuple((kind, {**options, "sweep": False}, share * part) for kind, options, part in canned))


def commissioning(share: float = 1.0) -> list[Recording]:
    return recorded(plain_model(), unswept(SLOW, share), RIG)


@lru_cache(maxsize=None)
def asked_at_speed() -> Diagnosis:
    return diagnose(slowly_commissioned(), recorded(plain_model(), unswept(FAST), RIG))


def band_at_speed() -> NotKnown:
    (band,) = (one for one in asked_at_speed().document.not_known_from_commissioning if one.axis == "frequency_hz")
    return band


def test_where_commissioning_did_not_move_the_gap_need_not_be_new() -> None:
    band = band_at_speed()
    assert band.low == 32 and band.high >= 64
    assert band.share > 0.8 and band.moved_um > 4 * band.commissioned_um
    (said,) = (note for note in asked_at_speed().document.notes if "not known from commissioning" in note and "Hz" in note)
    assert "32 to" in said and "Hz" in said


def test_nothing_is_unknown_where_commissioning_went() -> None:
    again = recorded(plain_model(), unswept(SLOW), entry("gain_change", factor=1.05), seed=5)
    assert not diagnose(slowly_commissioned(), again).document.not_known_from_commissioning


def test_a_model_of_before_does_not_say() -> None:
    known = slowly_commissioned()
    octaves = {name: part for name, part in known.passport["octaves"].items() if name != "moved"}
    older = replace(known, passport={**known.passport, "octaves": octaves})
    older.passport["level"] = {name: part for name, part in known.passport["level"].items() if name != "least_std_um"}
    assert not diagnose(older, asked_at_speed().runs).document.not_known_from_commissioning


def test_positions_beyond_those_of_commissioning() -> None:
    wide = recorded(plain_model(), unswept(SLOW), entry("static_nonlinearity", "sensor", quadratic=0.03), seed=5)
    found = diagnose(slowly_commissioned(0.6), wide).document.not_known_from_commissioning
    assert {one.axis for one in found} == {"position_um"} and all(one.moved_um is None for one in found)
    reached = slowly_commissioned(0.6).passport["axes"]["position_um"]["edges"]
    assert {one.high for one in found if one.high <= reached[0]} <= {reached[0]}
    assert {one.low for one in found if one.low >= reached[-1]} <= {reached[-1]}


def proposed(found: Diagnosis, model: Model, make: Callable) -> Recording:
    """The drive that is proposed where nothing has a name, made by the command as it stands."""
    given = AugmentedModel.given(model, found.runs, [])
    nothing = Selection(given, given, given, (), frozenset(), (given,))
    next_one = experiment.propose(nothing, "none", found.document.not_known_from_commissioning)
    assert "commissioning" in next_one.why
    assert make(*shlex.split(next_one.command)[1:]).exit_code == 0
    drive = read_recording("next.csv", ("command_V",))
    assert drive.time_s[-1] == pytest.approx(next_one.seconds)
    return drive


def test_the_proposed_drive_shows_frequencies(rdpi: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It moves no further at them than the recordings did; fitted with it, the model knows them."""
    monkeypatch.chdir(tmp_path)
    drive = proposed(asked_at_speed(), slowly_commissioned(), rdpi)
    band = band_at_speed()
    swept = drive.time_s <= float(drive.metadata["sweep_s"])
    assert np.ptp(drive.command_V[~swept]) * 0.13 <= 2.2 * band.moved_um and np.ptp(drive.command_V[swept]) == 100
    fastest = max(np.max(np.abs(np.diff(run.command_V))) * run.sample_rate_hz for run in asked_at_speed().runs)
    assert np.max(np.abs(np.diff(drive.command_V))) * drive.sample_rate_hz < 1.01 * fastest
    played = recorded(plain_model(), [marked(drive, memory="unknown")], RIG)
    wiser = fit([*commissioning(), *played], Options(rate_independent=True)).model
    found = diagnose(wiser, asked_at_speed().runs).document
    assert [one["name"] for one in wiser.effects] == ["lag"]
    assert found.verdict == "none" and not found.not_known_from_commissioning


def test_the_proposed_drive_shows_positions(rdpi: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    bent = recorded(plain_model(), unswept(SLOW), entry("static_nonlinearity", "sensor", cubic=0.1))
    drive = proposed(diagnose(slowly_commissioned(0.6), bent), slowly_commissioned(0.6), rdpi)
    assert np.min(drive.command_V) == 0 and np.max(drive.command_V) == 100


def chirp_at(model: Model, band: NotKnown, *further: Recording) -> tuple[excite.Limits, dict[str, float]] | None:
    """What is proposed for a band, as `excite` takes it; None: nothing."""
    given = AugmentedModel.given(model, [*asked_at_speed().runs, *further], [])
    next_one = experiment.propose(Selection(given, given, given, (), frozenset(), (given,)), "none", [band])
    if next_one is None:
        return None
    _, _, kind, *words = shlex.split(next_one.command)
    told = dict(zip(words[::2], words[1::2]))
    low_V, high_V = (float(told[f"--{name}"]) for name in ("min-V", "max-V"))
    options = {"frequencies_hz": tuple(map(float, told["--frequencies"].split(","))),
               "duration_s": float(told["--duration"])}
    assert kind == "chirp" and len(told["--min-V"]) < 8  # volts that a person can read
    return excite.Limits(low_V, high_V, sample_rate_hz=RATE_HZ, sweep_V=(0.0, 100.0)), options


def test_no_proposed_drive_makes_a_resonance_move_further() -> None:
    """One that the model holds makes forty times as much of a chirp."""
    model = replace(slowly_commissioned(), effects=[entry("resonance", f0_hz=60.0, damping=0.0125)])
    band = replace(band_at_speed(), low=32.0, high=128.0)
    limits, options = chirp_at(model, band)
    columns, metadata = excite.make_drive("chirp", limits, **options)
    drive = recording(columns["command_V"][columns["time_s"] >= float(metadata["sweep_s"])], None, RATE_HZ)
    moved = chain.simulate(model, [drive])[0].predicted_um
    assert 0.5 * band.moved_um < np.ptp(moved) < 2.2 * band.moved_um
    plain, _ = chirp_at(slowly_commissioned(), band)
    assert plain.span_V > 20 * limits.span_V


def test_a_slow_band_gets_a_long_drive_and_none_twice() -> None:
    band = replace(band_at_speed(), low=0.0625, high=0.5)
    limits, options = chirp_at(slowly_commissioned(), band)
    assert options["duration_s"] * band.low >= 3 and options["frequencies_hz"][0] < 0.5 * band.low
    columns, _ = excite.make_drive("chirp", limits, **options)
    there = recorded(plain_model(), [recording(columns["command_V"], None, RATE_HZ)])
    assert chirp_at(slowly_commissioned(), band, *there) is None


def test_a_sine_that_is_upside_down_is_remarked_on() -> None:
    """As one that is late by half a period is, which it may be."""
    (sine,) = recorded(plain_model(), unswept((("sine", {"frequencies_hz": (20.0,), "cycles": 20}, 0.8),)), RIG)
    notes = checks.check_against(slowly_commissioned(), [changed(sine, displacement_um=-sine.displacement_um)])
    assert any("moves opposite to the model" in note and "sign" in note for note in notes)
    assert not any("opposite" in note for note in checks.check_against(slowly_commissioned(), [sine]))


def test_a_disturbed_reading_of_the_field_is_named() -> None:
    (sine,) = recorded(plain_model(), unswept((("sine", {"frequencies_hz": (5.0,), "cycles": 5}, 0.8),)), RIG)
    z = sine.displacement_um.copy()
    z[300] += 50
    (note,) = set(checks.check_against(slowly_commissioned(), [changed(sine, displacement_um=z)])) \
        - set(checks.check_against(slowly_commissioned(), [sine]))
    assert "in sample 300 " in note and "a disturbed reading" in note


FINE = (("sine", {"frequencies_hz": (2.0,), "cycles": 12}, 0.06, 25.0),
        ("sawtooth", {"frequencies_hz": (1.0, 2.0), "cycles": 3}, 0.04, 25.0),
        ("multisine", {"duration_s": 10.0, "frequencies_hz": (0.5, 1.0, 1.7), "seed": 4}, 0.08, 70.0))


def played(bench: vb.Bench, command_V: np.ndarray, name: str) -> Recording:
    return swept_and_played(bench, command_V, LIMITS.sample_rate_hz, name)


def finely(bench: vb.Bench) -> list[Recording]:
    """Movements of 4 to 8 % of the range about places aside of its middle."""
    found = []
    for kind, options, share, place_V in FINE:
        wave = place_V + share * (excite.make_drive(kind, LIMITS, **options, sweep=False)[0]["command_V"] - 50)
        found.append(played(bench, np.r_[np.full(50, 50.0), np.linspace(50, wave[0], 400), wave], f"fine {kind}.csv"))
    return found


@lru_cache(maxsize=None)
def asked_of_little(kind: str) -> tuple[Model, Diagnosis]:
    """Commissioned over its range and asked about little movements."""
    bench = vb.make(kind, 3)
    model = fit([played(bench, drive.command_V, drive.path) for drive in unswept(SLOW)]).model
    return model, diagnose(model, finely(bench))


def test_movements_smaller_than_those_of_commissioning_show_nothing_new() -> None:
    model, found = asked_of_little("bouc-wen")  # its inner loops drift
    (little,) = found.document.not_known_from_commissioning
    assert little.axis == "movement_um" and little.share > 0.9
    assert little.low < little.high == little.moved_um < 0.4 * little.commissioned_um
    assert found.document.verdict == "none"
    (said,) = (note for note in found.document.notes if "not known from commissioning" in note)
    assert "um rms or less" in said and "cannot tell whether something has changed" in words.sentence(found.document)
    level = {**model.passport["level"], "least_std_um": None, "drift_um": None}
    older = replace(model, passport={**model.passport, "level": level})
    assert diagnose(older, found.runs).document.verdict != "none"


def test_the_proposed_drive_shows_small_movements(rdpi: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fitted with it, the model knows what it misses of them."""
    monkeypatch.chdir(tmp_path)
    model, found = asked_of_little("preisach")
    assert found.document.not_known_from_commissioning
    drive = proposed(found, model, rdpi)
    swept = drive.time_s <= float(drive.metadata["sweep_s"])
    assert 3 < np.ptp(drive.command_V[~swept]) < 10 and np.ptp(drive.command_V[swept]) == 100
    bench = vb.make("preisach", 3)
    runs = [played(bench, drive.command_V, drive.path) for drive in (*unswept(SLOW), drive)]
    again = diagnose(fit(runs).model, finely(bench)).document
    assert again.verdict == "none" and not again.not_known_from_commissioning


@pytest.mark.parametrize("drift_um, moved", [(None, True), (2.0, False)])
def test_a_zero_within_the_reach_of_loops_that_drift_has_not_moved(drift_um: float | None, moved: bool) -> None:
    model, found = asked_of_little("bouc-wen")
    level = {**model.passport["level"], "drift_um": drift_um}
    shift_um = 0.8 - found.document.runs[0].offset_um
    aside = changed(found.runs[0], displacement_um=found.runs[0].displacement_um + shift_um)
    offset = diagnose(replace(model, passport={**model.passport, "level": level}), [aside]).document.offset_um
    assert offset.mean == pytest.approx(0.8, abs=0.1) and offset.moved == moved


def octave(known: Passport, power_of_two: int) -> float:
    return known.octaves.moved.missed[power_of_two - known.octaves.moved.first]


def test_the_passport_tells_what_the_operators_own_error_makes_of_a_resonance() -> None:
    """A model that was fitted to other recordings misses as much of the ringing as one that was fitted to these."""
    canned = (("sawtooth", {"frequencies_hz": (1.0, 3.0, 9.0), "cycles": 6}, 0.6),
              ("multisine", {"duration_s": 4.0, "frequencies_hz": (0.5, 1.7, 4.0), "seed": 1}, 1.0))
    runs = recorded(plain_model(law=0.3), unswept(canned), entry("resonance", f0_hz=80.0, damping=0.01))
    found = fit(runs, Options(effects=("resonance",), rate_independent=True)).model
    missed = moved = 0.0
    for run, shown in zip(runs, chain.simulate(found, runs)):
        left, z = (passport.octaves(signal - np.mean(signal), RATE_HZ)
                   for signal in (run.displacement_um - shown.predicted_um, shown.predicted_um))
        missed, moved = missed + len(run) * left.power[6 - left.first], moved + len(run) * z.power[6 - z.first]
    assert 0.7 < octave(passport.read(found), 6) / np.sqrt(missed / moved) < 1.4


@pytest.mark.parametrize(("missed", "level", "share", "peak_um", "as_much"), [
    (0.3, 0.1, 0.2, 0.5, True), (0.3, 0.1, 0.7, 0.5, False), (0.3, 0.25, 0.2, 0.5, False), (0.3, 0.1, 0.2, 2.0, False),
    (None, 0.1, 0.2, 0.5, False)])
def test_the_model_may_always_have_missed_as_much_of_what_rings(missed: float | None, level: float, share: float,
                                                               peak_um: float, as_much: bool) -> None:
    """`share`: of 1 um that moves at 64 to 128 Hz, what is missed; `level`: what the passport expects from all that moves;
    `peak_um`: how far commissioning moved there.
    """
    known = passport.read(slowly_commissioned())
    moved, octaves = known.octaves.moved, len(known.octaves.moved.peak_um)
    shares = None if missed is None else [missed] * octaves
    known = replace(known, octaves=replace(known.octaves, moved=replace(moved, missed=shares, peak_um=[peak_um] * octaves)))
    command = np.sin(2 * np.pi * 90.0 * np.arange(4000) / RATE_HZ)
    axis = SimpleNamespace(edges=2.0 ** np.array([5, 6, 7, 8]), rms_um=share * np.array([0, np.std(command), 0]),
                           expected_um=level * np.std(command) * np.ones(3))
    found = unseen.missed_as_much(known, [recording(command, None, RATE_HZ)], [{"position_um": command}], axis)
    assert found.tolist() == [False, as_much, False]


def after_a_rest(command_V: np.ndarray, rest_V: float, creep: float, drift_um_per_s: float) -> Recording:
    """Of an actuator that creeps, and rested there before; cut where the drive begins."""
    before_V = np.r_[np.full(30_000, rest_V), np.linspace(rest_V, command_V[0], 20)]
    whole = recording(np.r_[before_V, command_V], None, RATE_HZ)
    run, = recorded(plain_model(), [whole], entry("creep", percent_per_decade=creep), seed=5)
    part = {name: column[len(before_V):] for name, column in run.columns.items()}
    part["displacement_um"] = part["displacement_um"] + drift_um_per_s * np.arange(len(command_V)) / RATE_HZ
    return replace(run, columns=part, metadata={"memory": "unknown"})


@pytest.mark.parametrize(("creep", "rest_V", "drift_um_per_s", "names"), [
    (2.0, 100.0, 0.0, []), (2.0, 0.0, 0.0, []), (2.0, 50.0, 0.1, ["thermal_drift"]), (0.0, 50.0, 0.1, ["thermal_drift"])])
def test_what_goes_on_from_before_a_recording_is_nothing_new(creep: float, rest_V: float, drift_um_per_s: float,
                                                             names: list[str]) -> None:
    """As far as what the model holds of creep explains it."""
    drive, = unswept((("multisine", {"duration_s": 10.0, "frequencies_hz": (0.5, 1.7, 4.0), "seed": 4}, 0.6),))
    run = after_a_rest(drive.command_V, rest_V, creep, drift_um_per_s)
    held = [entry("creep", percent_per_decade=creep)] if creep else []
    found = diagnose(replace(commissioned(), effects=held), [run]).document
    assert [one.name for one in found.effects] == names and found.verdict == ("effect" if names else "none")


def test_what_a_monitor_shows_is_new_whatever_goes_on_behind_it() -> None:
    drive, = unswept((("multisine", {"duration_s": 10.0, "frequencies_hz": (0.5, 1.7, 4.0), "seed": 4}, 0.6),))
    run = after_a_rest(drive.command_V, 100.0, 2.0, 0.0)
    early = changed(run, command_V=np.r_[run.command_V[3:], np.full(3, run.command_V[-1])], monitor_V=run.command_V)
    model = replace(commissioned(), effects=[entry("creep", percent_per_decade=2.0)])
    assert [one.name for one in diagnose(model, [early]).document.effects] == ["delay"]


@pytest.mark.parametrize(("known", "name", "earlier", "sure", "verdict"), [
    (0.3, "backlash", False, False, "none"), (0.3, "backlash", True, False, "effect"),
    (0.8, "backlash", False, False, "effect"), (0.3, "backlash", False, True, "effect"),
    (0.3, "rate_dependence", False, False, "effect"), (0.3, "creep", False, False, "effect"),
    (0.3, "thermal_drift", False, False, "effect"), (0.3, "initial_memory", False, False, "effect")])
def test_what_need_not_be_new_gets_no_name(known: float, name: str, earlier: bool, sure: bool, verdict: str,
                                           monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless it is compared with earlier recordings, shows at such rates only, goes on at rest, or the rest of the gap is
    one as well.
    """
    monkeypatch.setattr(diagnosis, "_sure", lambda *arguments: sure)
    best = SimpleNamespace(effect=CATALOGUE[name]())
    found = SimpleNamespace(given=SimpleNamespace(earlier=earlier), rivals=lambda one: [],
                            rounds=[SimpleNamespace(best=best, refitted=True)])
    assert diagnosis._verdict(found, SimpleNamespace(ratio=3.0), Spectrum(known=known), Spectrum()) == verdict


@pytest.mark.parametrize(("name", "low", "harms"), [
    ("creep", -0.1, True), ("creep", 0.1, False), ("creep", None, False), ("initial_memory", -0.1, False),
    ("thermal_drift", -0.1, False)])
def test_what_may_as_well_harm_other_recordings(name: str, low: float | None, harms: bool,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    """A start and a drift are each recording's own: what one shows is lost when it is left out."""
    promise = SimpleNamespace(ci90=None if low is None else (low, 0.5))
    monkeypatch.setattr(diagnosis.document, "promised", lambda *arguments: promise)
    monkeypatch.setattr(diagnosis, "equations_of", lambda state: None)
    found = SimpleNamespace(accepted=SimpleNamespace(chosen=[SimpleNamespace(effect=CATALOGUE[name]())]))
    assert diagnosis._may_harm(found) == harms


@pytest.mark.parametrize("earlier", [False, True])
def test_what_earlier_recordings_show_as_well_is_known_wherever_commissioning_moved(earlier: bool) -> None:
    """Creep that had become three times as large was lost when it was compared with earlier recordings."""
    gap = Excess(total=9.4, floor=1.0, ratio=3.06, spread=0.315, ratios=[3.0, 3.3, 2.0], few=True)
    found = SimpleNamespace(given=SimpleNamespace(earlier=earlier), rounds=[SimpleNamespace(shape=0.2)])
    assert diagnosis._sure(found, gap, Spectrum(known=0.24)) == earlier


@pytest.mark.parametrize("sure", [False, True])
def test_what_leaves_too_much_is_unknown_only_if_there_is_a_gap(sure: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "_sure", lambda *arguments: sure)
    found = SimpleNamespace(given=SimpleNamespace(earlier=False), reached=SimpleNamespace(squares=9.0),
                            rounds=[SimpleNamespace(best=SimpleNamespace(effect=CATALOGUE["lag"]()), refitted=False)])
    gap = Excess(total=10.0, floor=1.0, ratio=3.0, spread=0.2, ratios=None)
    assert diagnosis._verdict(found, gap, Spectrum(), Spectrum()) == ("unknown" if sure else "none")
