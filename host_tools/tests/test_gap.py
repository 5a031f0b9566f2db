"""The diagnosis: it names what was injected, promises what arrives, and says what it cannot say."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benches import swept_and_played, vb
from injected import (COMMISSIONING, FURTHER, LATER, NOISE_UM, RATE_HZ, commissioned, drives, entry, left_um,
                      plain_model, recorded, rms)
from plants import changed, marked, recording

from rdpi.data import Recording, excite
from rdpi.errors import BadInput
from rdpi.identify import Options, fit, localise, passport
from rdpi.gap import Diagnosis, diagnose, diagnosis, experiment, thresholds
from rdpi.gap.augmented import AugmentedModel
from rdpi.gap.candidates import Candidate, bounded
from rdpi.gap.dataset import model_runs
from rdpi.gap.selection import Excess, Selection, excess
from rdpi.gap.spectrum import Spectrum
from rdpi.model import Memory, Model
from rdpi.simulate import chain, effects
from rdpi.simulate.effects import CATALOGUE, STAGES
from rdpi.simulate.memory import states_after

# Plain to see in LATER; which parameter to find, and how nearly: the model is fitted and has an error of its own.
PLAIN: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "delay": ({"delay_s": 0.0034}, {"delay_s": 0.02}),
    "slew_limit": ({"V_per_s": 400.0}, {"V_per_s": 0.03}),
    "lag": ({"time_constant_s": 0.004}, {"time_constant_s": 0.02}),
    "rail_saturation": ({"V_min": 8.0, "V_max": 88.0}, {"V_min": 0.02, "V_max": 0.01}),
    "rate_dependence": ({"widening": 0.3, "change": -0.05, "exponent": 0.7}, {"widening": 0.3, "change": 0.2}),
    "hysteresis_change": ({"scale": 0.4, "shape": 0.2}, {"scale": 0.15}),
    "creep": ({"percent_per_decade": 2.0}, {"percent_per_decade": 0.1}),
    "relaxation": ({"share": 0.08, "time_constant_s": 0.02}, {"share": 0.1, "time_constant_s": 0.1}),
    "gain_change": ({"factor": 1.04}, {"factor": 0.001}),
    "backlash": ({"width_um": 0.3}, {"width_um": 0.03}),
    "resonance": ({"f0_hz": 60.0, "damping": 0.1}, {"f0_hz": 0.01, "damping": 0.05}),
    "cross_coupling": ({"um_per_V": 0.05}, {"um_per_V": 0.01}),
    "static_nonlinearity": ({"linear": 0.01, "quadratic": 0.05, "cubic": -0.04}, {"quadratic": 0.2, "cubic": 0.2})}


def later(*entries: dict) -> list[Recording]:
    return recorded(plain_model(), drives(LATER), *entries)


@lru_cache(maxsize=None)
def diagnosed(case: str) -> Diagnosis:
    return diagnose(commissioned(), CASES[case]())


def name_of(found: Diagnosis) -> str:
    return found.document.effects[0].name


def named(found: Diagnosis) -> set[str]:
    """The first effect and what it may be confused with."""
    first = found.document.effects[0]
    return {first.name, *first.confusable_with}


def scaled(run: Recording, command: float = 1.0, displacement: float = 1.0) -> Recording:
    return changed(run, command_V=command * run.command_V, displacement_um=displacement * run.displacement_um)


def numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for part in value:
            yield from numbers(part)
    elif isinstance(value, (int, float)):
        yield value


# --- names and promises ----------------------------------------------------------------------------------------------

@pytest.mark.parametrize("name", PLAIN)
def test_names_what_was_injected_and_promises_what_arrives(name: str) -> None:
    values, tolerances = PLAIN[name]
    runs = later(entry(name, **values))
    found = diagnose(commissioned(), runs)
    assert found.document.verdict in ("effect", "ambiguous") and name_of(found) == name
    first = found.document.effects[0]
    for parameter, tolerance in tolerances.items():
        assert first.parameters[parameter].value == pytest.approx(values[parameter], rel=tolerance)
    further = recorded(plain_model(), drives(FURTHER), entry(name, **values))
    realised = 1 - left_um(found.improved, further) / left_um(commissioned(), further)
    assert found.document.promised.shrink == pytest.approx(realised, abs=0.1) and realised > 0.4


def test_creep_and_a_smaller_gain_are_no_relaxation() -> None:
    """Both together leave a share that comes late, as a relaxation of 0.36 s would."""
    found = diagnose(commissioned(), later(entry("creep", percent_per_decade=5.0), entry("gain_change", factor=0.93)))
    creep, gain = sorted(found.document.effects, key=lambda one: one.name)
    assert (creep.name, gain.name) == ("creep", "gain_change")
    assert creep.parameters["percent_per_decade"].value == pytest.approx(5.0, rel=0.1)
    assert gain.parameters["factor"].value == pytest.approx(0.93, abs=0.01)


def test_of_two_effects_the_one_that_explains_more_comes_first() -> None:
    """As a pair a static curve and the lag leave least; then the gain takes the place of the curve."""
    found = diagnose(commissioned(), later(entry("lag", time_constant_s=0.001), entry("gain_change", factor=1.08)))
    assert [one.name for one in found.document.effects] == ["gain_change", "lag"]


def test_an_effect_that_does_not_come_up_is_asked_only_of_a_model_that_holds_it() -> None:
    values = {"quadratic": 0.1, "cubic": 0.15, "low_V": 0.0, "high_V": 100.0}
    runs = later(entry("input_curve", **values))
    found = diagnose(commissioned(), runs).document
    (one,) = (candidate for candidate in found.candidates if candidate.name == "input_curve")
    assert not one.excited and one.rejected_because == "the model holds none"
    assert "input_curve" not in {other.name for other in found.not_excited}
    straight = entry("input_curve", **{**values, "quadratic": 0.0, "cubic": 0.0})
    holding = diagnose(replace(commissioned(), effects=[straight]), runs)
    assert holding.document.verdict in ("effect", "ambiguous") and "input_curve" in named(holding)
    first = holding.document.effects[0]
    assert first.name == "input_curve" and {name: one.value for name, one in first.parameters.items()} == pytest.approx(
        values, rel=0.1)


def test_nothing_on_fresh_recordings() -> None:
    for canned in (LATER, FURTHER):
        found = diagnose(commissioned(), recorded(plain_model(), drives(canned)))
        assert found.document.verdict == "none" and found.document.effects == []
        assert found.improved.effects == []
        assert 0.7 < found.document.passport.ratio < 1.5
        assert found.document.gap.remaining_um == found.document.gap.rms_um
        assert found.document.promised.shrink is None


def test_hum_and_drift() -> None:
    runs = later()
    hum = [changed(run, displacement_um=run.displacement_um + 0.05 * np.sin(2 * np.pi * 47.3 * run.time_s + k))
           for k, run in enumerate(runs)]
    found = diagnose(commissioned(), hum)
    assert found.document.verdict == "effect" and name_of(found) == "periodic_disturbance"
    values = found.document.effects[0].parameters
    assert values["frequency_hz"].value == pytest.approx(47.3, abs=0.02)
    assert values["amplitude_um"].value == pytest.approx(0.05, rel=0.05)
    drift = [changed(run, displacement_um=run.displacement_um + 0.05 * (k - 1.5) * run.time_s)
             for k, run in enumerate(runs)]
    found = diagnose(commissioned(), drift)
    assert found.document.verdict == "effect" and name_of(found) == "thermal_drift"


def test_a_coarse_sensor() -> None:
    found = diagnose(commissioned(), [changed(run, displacement_um=0.1 * np.round(run.displacement_um / 0.1))
                                      for run in later()])
    assert found.document.verdict == "effect" and name_of(found) == "quantisation"
    first = found.document.effects[0]
    assert first.stage == "sensor" == found.document.where.stage
    assert first.parameters["step"].unit == "um"
    assert first.parameters["step"].value == pytest.approx(0.1, rel=1e-6)


def test_a_dac_of_few_bits() -> None:
    found = diagnose(commissioned(), later(entry("quantisation", "DAC", step=0.8, origin=0.13)))
    assert found.document.verdict in ("effect", "ambiguous") and name_of(found) == "quantisation"
    first = found.document.effects[0]
    assert first.stage == "DAC" and first.parameters["step"].unit == "V"
    assert first.parameters["step"].value == pytest.approx(0.8, rel=0.01)


def come_from(place_V: float, hertz: float, middle_V: float, half_V: float, seed: int, memory: str = "reset",
              effects: Sequence[dict] = ()) -> Recording:
    """The plant came straight from `place_V` to the middle of a sine that grows."""
    model, t = plain_model(), np.arange(3000) / RATE_HZ
    x = float(model.x_of(middle_V))
    start = states_after(float(model.x_of(place_V)), x, model.thresholds_um)
    plant = replace(model, memory=Memory(x, start), effects=list(effects))
    command = middle_V + half_V * np.sin(2 * np.pi * hertz * t) * np.linspace(0.4, 1, len(t))
    silent = recording(command, None, RATE_HZ, f"{hertz} Hz.csv", memory)
    z = chain.simulate(plant, [silent], "model")[0].predicted_um
    return changed(silent, displacement_um=z + NOISE_UM * np.random.default_rng(seed).standard_normal(len(z)))


def not_reset() -> list[Recording]:
    """The recordings say that a sweep ended at their first sample."""
    return [come_from(place_V, hertz, 50.0, 25.0, k)
            for k, (hertz, place_V) in enumerate(((1.0, 0.0), (0.7, 100.0), (1.6, 0.0), (2.3, 100.0)))]


def test_a_memory_that_was_not_reset() -> None:
    found = diagnose(commissioned(), not_reset())
    assert found.document.verdict in ("effect", "ambiguous") and "initial_memory" in named(found)


@pytest.mark.parametrize("bend", [{"quadratic": 0.12}, {"cubic": 0.15}])
def test_a_start_that_is_not_known_takes_up_no_part_of_an_effect(bend: dict[str, float]) -> None:
    """Estimated without the effect it does, and then another effect is named, alone or beside it."""
    curve = [entry("static_nonlinearity", "sensor", **bend)]
    found = diagnose(commissioned(), [
        come_from(50.0, 1.0, 50.0, 45.0, 0, "reset", curve), come_from(50.0, 2.3, 50.0, 30.0, 1, "reset", curve),
        come_from(0.0, 1.3, 75.0, 24.0, 2, "unknown", curve)])
    assert [one.name for one in found.document.effects] == ["static_nonlinearity"]
    assert found.document.verdict == "effect"
    assert found.document.promised.shrink > 0.95


def test_where_inner_loops_drift_a_start_is_no_change() -> None:
    """The model's plays do not drift, so they do not say where a recording starts; what both recordings miss is gone."""
    drifts = replace(commissioned(), passport={**commissioned().passport, "drifts": True})
    found = diagnose(drifts, not_reset()).document
    assert found.verdict == "none" and "initial_memory" in [one.name for one in found.not_excited]
    earlier = recorded(plain_model(), not_reset())
    paired = diagnose(drifts, not_reset(), earlier=earlier)
    assert paired.document.verdict in ("effect", "ambiguous") and "initial_memory" in named(paired)


def test_two_effects_at_once() -> None:
    found = diagnose(commissioned(), later(entry("delay", delay_s=0.003), entry("gain_change", factor=1.03)))
    assert {one.name for one in found.document.effects} == {"delay", "gain_change"}
    after = {one.name: one.parameters for one in found.document.effects}
    assert after["delay"]["delay_s"].value == pytest.approx(0.003, rel=0.02)
    assert after["gain_change"]["factor"].value == pytest.approx(1.03, abs=0.002)
    assert [one["name"] for one in found.improved.effects] == [one.name for one in found.document.effects]


@pytest.mark.parametrize("delay_s", [0.0, 0.0008])
def test_what_is_not_in_the_catalogue_is_unknown(delay_s: float) -> None:
    """The sensor's zero jumps every 0.4 s; that a known effect takes up a part of it does not make that the cause."""
    random = np.random.default_rng(5)
    runs = [changed(run, displacement_um=run.displacement_um
                    + np.repeat(random.normal(0, 0.2, len(run) // 400 + 1), 400)[:len(run)])
            for run in later(entry("delay", delay_s=delay_s))]
    found = diagnose(commissioned(), runs)
    assert found.document.verdict == "unknown" and found.document.effects == []
    assert found.improved.effects == [] and found.document.passport.ratio > 3
    assert found.document.gap.remaining_um == found.document.gap.rms_um
    assert found.document.promised.shrink is None
    assert all(one.rejected_because for one in found.document.candidates)
    assert found.document.next_experiment.command.startswith("rdpi excite ")


def test_an_improved_model_has_no_gap_left() -> None:
    delayed, improved = entry("delay", delay_s=0.003), diagnosed("effect").improved
    again = diagnose(improved, recorded(plain_model(), drives(FURTHER), delayed))
    assert again.document.verdict == "none" and again.improved.effects == improved.effects


def test_an_effect_that_is_left_out_is_not_named() -> None:
    runs = later(entry("delay", delay_s=0.003))
    found = diagnose(commissioned(), runs, ["delay", "lag"])
    assert not {"delay", "lag"} & {one.name for one in found.document.effects}
    tried = [one.name for one in found.document.candidates if one.excited]
    assert not {"delay", "lag"} & set(tried)
    assert not {"delay", "lag"} & {one.name for one in found.document.not_excited}
    assert found.document.gap.remaining_um > 3 * diagnosed("effect").document.gap.remaining_um


# --- the paper's plant -----------------------------------------------------------------------------------------------

LIMITS = excite.Limits(0.0, 100.0, sample_rate_hz=2000.0)
SLOW = (("sawtooth", {"frequencies_hz": (0.5, 1.0), "cycles": 2}, 1.0),
        ("minor-loops", {"levels": 5, "rates_V_per_s": (200.0,)}, 1.0),
        ("sine", {"frequencies_hz": (1.0,), "cycles": 4}, 1.0),
        ("multisine", {"duration_s": 8.0, "frequencies_hz": (0.3, 0.7, 1.1), "seed": 4}, 0.6))
FAST = (("sawtooth", {"frequencies_hz": (1.0, 3.0, 10.0, 30.0), "cycles": 2}, 1.0),
        ("minor-loops", {"levels": 5, "rates_V_per_s": (500.0, 2000.0)}, 1.0),
        ("sine", {"frequencies_hz": (2.0, 12.0), "cycles": 4}, 1.0), ("multisine", {"duration_s": 4.0, "seed": 4}, 0.6))
SEVERAL_RATES = {
    "sines": tuple(("sine", {"frequencies_hz": (hertz,), "cycles": 8}, share)
                   for hertz, share in ((1.0, 1.0), (5.0, 0.7), (10.0, 0.4), (20.0, 0.9), (35.0, 0.6))),
    "mixed": (("sawtooth", {"frequencies_hz": (1.0, 5.0, 20.0), "cycles": 2}, 0.9),
              ("multisine", {"duration_s": 4.0, "seed": 7}, 1.0),
              ("sine", {"frequencies_hz": (2.0, 8.0, 25.0), "cycles": 6}, 0.7),
              ("sine", {"frequencies_hz": (15.0,), "cycles": 20}, 0.5))}
UNSEEN = (("sine", {"frequencies_hz": (4.0, 15.0), "cycles": 8}, 1.0),
          ("multisine", {"duration_s": 4.0, "seed": 11}, 0.8),
          ("sawtooth", {"frequencies_hz": (3.0, 12.0), "cycles": 6}, 0.7))


def played(bench: vb.Bench, canned: tuple, sweep: bool) -> list[Recording]:
    runs = []
    for k, (kind, options, share) in enumerate(canned):
        command = 50 + share * (excite.make_drive(kind, LIMITS, sweep=sweep, **options)[0]["command_V"] - 50)
        runs.append(swept_and_played(bench, command, 2000.0, f"{kind} {k}.csv"))
    return runs


@lru_cache(maxsize=None)
def paper(commissioning: str) -> tuple[Model, vb.Bench]:
    """A rate-independent model of a plant with the paper's law, from slow recordings, from fast ones, or from those
    with the sweeps ahead of them that `rdpi excite` puts there.
    """
    bench = vb.make("paper", 3, noise_um=NOISE_UM)
    runs = played(bench, SLOW if commissioning == "slow" else FAST, commissioning == "swept")
    return fit(runs, Options(rate_independent=True, effects="none")).model, bench


@pytest.mark.parametrize("kind", SEVERAL_RATES)
@pytest.mark.parametrize(("commissioning", "near"), [("slow", 0.15), ("swept", 0.05)])
def test_a_rate_independent_model_of_the_papers_plant_lacks_rate_dependence(kind: str, commissioning: str, near: float
                                                                            ) -> None:
    """What the slow recordings promise for others depends on how fast those are."""
    model, bench = paper(commissioning)
    found = diagnose(model, played(bench, SEVERAL_RATES[kind], False))
    assert found.document.verdict in ("effect", "ambiguous") and name_of(found) == "rate_dependence"
    unseen = played(bench, UNSEEN, False)
    realised = 1 - left_um(found.improved, unseen) / left_um(model, unseen)
    assert found.document.promised.shrink == pytest.approx(realised, abs=near) and realised > 0.5


@pytest.mark.parametrize("kind", SEVERAL_RATES)
def test_rate_dependence_that_the_fit_partly_took_up(kind: str) -> None:
    model, bench = paper("fast")
    found = diagnose(model, played(bench, SEVERAL_RATES[kind], False))
    assert found.document.verdict in ("effect", "ambiguous") and "rate_dependence" in named(found)


# --- where -----------------------------------------------------------------------------------------------------------

def monitored(*entries: dict) -> list[Recording]:
    """Recordings with what the amplifier puts out, and 10 mV of noise on it."""
    runs, model = later(*entries), plain_model()
    acting = effects.acting(replace(model, effects=list(entries)))
    outputs = [effects.driven(acting, run.command_V, run, model) for run in runs]
    return [changed(run, monitor_V=output + 0.01 * np.random.default_rng(3).standard_normal(len(run)))
            for run, output in zip(runs, outputs)]


@pytest.mark.parametrize(("name", "stage", "values"), [
    ("lag", "amplifier", {"time_constant_s": 0.004}), ("lag", "sensor", {"time_constant_s": 0.004}),
    ("delay", "timing", {"delay_s": 0.003}), ("delay", "sensor", {"delay_s": 0.003})])
def test_a_monitor_tells_the_stage(name: str, stage: str, values: dict[str, float]) -> None:
    found = diagnose(commissioned(), monitored(entry(name, stage, **values)))
    assert found.document.verdict == "effect" and name_of(found) == name
    assert found.document.effects[0].stage == found.document.where.stage == stage
    shares = found.document.where.stages
    assert getattr(shares, "before_monitor" if stage != "sensor" else "after_monitor") > 0.9
    assert shares.before_monitor + shares.after_monitor == pytest.approx(1)
    assert [one["stage_shown"] for one in found.improved.effects] == [True] * len(found.document.effects)


@pytest.mark.parametrize("slow_s", [0.03, 0.1])
def test_the_monitor_of_an_amplifier_too_slow_for_the_drive(slow_s: float) -> None:
    """It moves by little of what is asked, which is no matter of units."""
    command = 50 + 45 * np.sin(2 * np.pi * 8 * np.arange(2000) / RATE_HZ)
    lag = entry("lag", "amplifier", time_constant_s=slow_s)
    runs = recorded(plain_model(), [recording(command, None, RATE_HZ, "fast.csv")], lag)
    shown = [changed(run, monitor_V=effects.driven(effects.acting(replace(plain_model(), effects=[lag])), run.command_V,
                                                   run, plain_model())) for run in runs]
    assert np.polyfit(command, shown[0].columns["monitor_V"], 1)[0] < 0.4
    assert name_of(diagnose(commissioned(), shown)) == "lag"
    for wrong in (command / 100, 1000 * command, np.random.default_rng(0).standard_normal(len(command))):
        with pytest.raises(BadInput, match="fast.csv: monitor_V moves .* V per volt of the command"):
            diagnose(commissioned(), [changed(runs[0], monitor_V=wrong)])


def test_without_a_monitor_the_stage_stays_a_set() -> None:
    where = diagnosed("effect").document.where
    assert where.stages is None and set(where.stage.split(" or ")) == {"timing", "sensor"}
    assert not any("stage_shown" in one for one in diagnosed("effect").improved.effects)


def test_the_gap_and_its_shares() -> None:
    runs, document = CASES["effect"](), diagnosed("effect").document
    left = [run.displacement_um - one.predicted_um for run, one in zip(runs, chain.simulate(commissioned(), runs))]
    left = [part - np.mean(part) for part in left]
    gap = document.gap
    assert gap.rms_um == pytest.approx(left_um(commissioned(), runs), rel=1e-6)
    stroke = max(np.ptp(run.displacement_um) for run in runs)
    assert gap.percent_of_stroke == pytest.approx(100 * gap.rms_um / stroke)
    assert gap.noise_floor_um == pytest.approx(NOISE_UM, rel=0.5)
    assert gap.explained_um == pytest.approx(math.sqrt(gap.rms_um ** 2 - gap.remaining_um ** 2))
    energy = {run.path: float(np.sum(part**2)) for run, part in zip(runs, left)}
    assert document.where.runs == sorted(energy, key=energy.get, reverse=True)
    for row, run, part in zip(document.runs, runs, left):
        assert row.file == run.path and row.samples == len(run)
        assert row.rms_um.before == pytest.approx(rms(part), rel=1e-6)
        assert row.share == pytest.approx(energy[run.path] / sum(energy.values()), rel=1e-6)
    assert set(document.where.axes) >= {"time_s", "frequency_hz", "rate_um_per_s", "position_um", "direction",
                                           "since_reversal_s"}
    assert document.where.dominant in {*document.where.axes, "recording"}
    assert document.where.dominant == "rate_um_per_s"  # a delay misses in proportion to the rate


# --- the document ----------------------------------------------------------------------------------------------------

CASES: dict[str, Callable[[], list[Recording]]] = {
    "effect": lambda: later(entry("delay", delay_s=0.003)), "none": later,
    "ambiguous": lambda: sines(entry("delay", delay_s=0.003)),
    "infinite parameters": lambda: later(entry("rail_saturation", V_max=85.0)),
    "monitor": lambda: monitored(entry("lag", "amplifier", time_constant_s=0.004)),
    "one recording": lambda: later(entry("delay", delay_s=0.003))[:1]}


def sines(*entries: dict) -> list[Recording]:
    """Slow sines alone, of which a delay and a lag look the same."""
    t = np.arange(5000) / RATE_HZ
    silent = [recording(50 - 50 * share * np.cos(2 * np.pi * t), None, RATE_HZ, f"sine {share}.csv")
              for share in (1.0, 0.6)]
    return recorded(plain_model(), silent, *entries)


@pytest.mark.parametrize("case", CASES)
def test_document_as_in_the_contract(case: str) -> None:
    found = diagnosed(case)
    document = json.loads(json.dumps(found.document.to_json(), allow_nan=False))
    assert all(math.isfinite(number) for number in numbers(document))
    assert document["schema"] == "rdpi-gap/1"
    assert document["verdict"] in ("effect", "none", "unknown", "ambiguous")
    assert (document["verdict"] in ("none", "unknown")) == (document["effects"] == [])
    assert set(document["gap"]) >= {"rms_um", "percent_of_stroke", "noise_floor_um", "explained_um", "remaining_um"}
    where = document["where"]
    assert set(where) >= {"stage", "runs", "axes", "dominant"}
    assert set(where["axes"]) >= {"time_s", "frequency_hz", "rate_um_per_s", "position_um", "direction",
                                  "since_reversal_s"}
    for one in document["effects"]:
        kind = CATALOGUE[one["name"]]
        assert set(one) >= {"name", "stage", "parameters", "held_out_rms_um", "shrink", "shrink_ci95", "confidence",
                            "confusable_with"}
        assert one["stage"] in kind.stages and set(one["confusable_with"]) <= set(CATALOGUE) - {one["name"]}
        assert set(one["parameters"]) == {parameter.name for parameter in kind.parameters}
        for parameter in one["parameters"].values():
            assert set(parameter) == {"value", "ci95", "unit"} and parameter["unit"]
            if parameter["ci95"] is not None:
                assert parameter["ci95"][0] <= parameter["value"] <= parameter["ci95"][1]
        assert set(one["held_out_rms_um"]) == {"before", "after"} and 0 <= one["confidence"] <= 1
        if one["shrink_ci95"] is not None:
            assert one["shrink_ci95"][0] <= one["shrink"] <= one["shrink_ci95"][1] <= 1
    assert [one["name"] for one in document["candidates"]] == list(dict.fromkeys(
        one["name"] for one in document["candidates"]))
    assert {one["name"] for one in document["candidates"]} == set(CATALOGUE)
    accepted = {one["name"] for one in document["effects"]}
    rivals = {name for one in document["effects"] for name in one["confusable_with"]}
    for one in document["candidates"]:
        assert set(one) >= {"name", "shrink", "shrink_ci95", "rejected_because"}
        assert (one["rejected_because"] is None) == (one["name"] in accepted | rivals)
    assert {one["name"] for one in document["not_excited"]} == {
        one["name"] for one in document["candidates"] if not one["excited"] and CATALOGUE[one["name"]].comes_up}
    r2 = np.array(document["matrix"]["r2"])
    assert r2.shape == (len(document["matrix"]["names"]),) * 2
    assert np.all((r2 >= 0) & (r2 <= 1))
    assert all(share == pytest.approx(1) or not np.any(row) for share, row in zip(np.diag(r2), r2))  # or does nothing
    if document["next_experiment"] is not None:
        assert set(document["next_experiment"]) >= {"command", "why"}


@pytest.mark.parametrize("case", [case for case in CASES if case != "monitor"])  # of which simulate makes no use
def test_improved_model_leaves_what_is_reported(case: str) -> None:
    runs, found = CASES[case](), diagnosed(case)
    assert left_um(found.improved, runs) == pytest.approx(found.document.gap.remaining_um, rel=0.03)


@pytest.mark.parametrize(("name", "values"), [("lag", {"time_constant_s": 0.02}), ("delay", {"delay_s": 0.01}),
                                              ("hysteresis_change", {"scale": 0.8})])
def test_recordings_whose_memory_is_not_known(name: str, values: dict[str, float]) -> None:
    """It is estimated beside the effects that act, in the diagnosis as in simulate."""
    model, runs, t = plain_model(), [], np.arange(4000) / RATE_HZ
    for share, hertz, came_from_V in ((1.0, 1.0, 100.0), (0.6, 4.0, 0.0), (0.8, 2.0, 100.0)):
        x = float(model.x_of(50.0))
        start = states_after(float(model.x_of(came_from_V)), x, model.thresholds_um)
        plant = replace(model, memory=Memory(x, start), effects=[entry(name, **values)])
        command = 50 + 50 * share * np.sin(2 * np.pi * hertz * t) * np.minimum(t / 2, 1)
        silent = recording(command, None, RATE_HZ, f"{hertz} Hz.csv", "unknown")
        z = chain.simulate(plant, [silent], "model")[0].predicted_um
        runs.append(changed(silent, displacement_um=z + NOISE_UM * np.random.default_rng(3).standard_normal(len(z))))
    found = diagnose(commissioned(), runs)
    assert found.document.verdict in ("effect", "ambiguous") and name in named(found)
    assert left_um(found.improved, runs) == pytest.approx(found.document.gap.remaining_um, rel=0.05)
    assert found.document.gap.remaining_um < 0.05 * found.document.gap.rms_um


def test_recordings_that_cannot_tell_and_the_one_that_can() -> None:
    delayed = entry("delay", delay_s=0.003)
    found = diagnosed("ambiguous")
    assert found.document.verdict == "ambiguous" and {"delay", "lag"} <= named(found)
    proposed = found.document.next_experiment
    assert "delay" in proposed.why and "lag" in proposed.why and proposed.seconds > 0
    kind = proposed.command.split()[2]
    options = {"chirp": {"duration_s": 5.0}, "steps": {"levels": 3, "hold_s": 1.0}, "startup": {}}[kind]
    columns, _ = excite.make_drive(kind, excite.Limits(0.0, 100.0, sample_rate_hz=RATE_HZ), **options)
    assert columns["time_s"][-1] == pytest.approx(proposed.seconds)
    drive = recording(columns["command_V"], None, RATE_HZ, "next.csv")
    both = diagnose(commissioned(), [*sines(delayed), *recorded(plain_model(), [drive], delayed)])
    assert both.document.verdict == "effect" and name_of(both) == "delay"


def test_a_drive_that_moves_less_than_commissioning_counts_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """What its recording shows would be "not known from commissioning", beside those that are there."""
    monkeypatch.setattr(passport, "level_um", lambda known, coords: 2.0)
    known = passport.read(commissioned())
    columns, _ = excite.make_drive("chirp", excite.Limits(45.0, 55.0, sample_rate_hz=RATE_HZ), duration_s=2.0)
    drive = recording(columns["command_V"], None, RATE_HZ, "next.csv")
    state = AugmentedModel.given(commissioned(), later(), [])
    (one,) = model_runs(commissioned(), [drive], False)
    moved_um = np.std(localise.coordinates(drive, one.predict(()), one.rate_um_per_s)["position_um"])
    counts = [experiment._trusted(state, replace(known, level=replace(known.level, least_std_um=times * moved_um)), drive)
              for times in (0.5, 4.0)]
    assert counts == pytest.approx([1 / 2.0**2, 0.25 / 2.0**2])


def proposed_drive(command: str) -> Recording:
    """Without its sweep, as it is recorded."""
    _, _, kind, *words = command.split()
    given = dict(zip(words[::2], words[1::2]))
    options = {name: given[f"--{word}"] for name, word in excite.OPTION_NAMES.items() if f"--{word}" in given}
    limits = excite.Limits(float(given["--min-V"]), float(given["--max-V"]), sample_rate_hz=RATE_HZ)
    columns, metadata = excite.make_drive(kind, limits, **{
        name: int(value) if name in ("levels", "cycles") else float(value) for name, value in options.items()})
    swept = columns["time_s"] >= float(metadata.get("sweep_s", 0.0))
    return recording(columns["command_V"][swept], None, RATE_HZ, f"{kind}.csv")


def test_no_recording_is_proposed_that_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the end nothing is left to propose, whether the gap has a name or not."""
    monkeypatch.setattr(thresholds, "RIVAL_MARGIN", 1e9)  # nothing is ever told apart
    monkeypatch.setattr(experiment, "CANNED", (("startup", {}), ("chirp", {"duration_s": 5.0})))
    delayed, runs, kinds = entry("delay", delay_s=0.003), sines(entry("delay", delay_s=0.003)), []
    while (proposed := diagnose(commissioned(), runs).document.next_experiment) is not None:
        drive = proposed_drive(proposed.command)
        kinds.append(drive.path)
        runs += recorded(plain_model(), [marked(drive, memory="unknown")], delayed)
        assert len(kinds) < 3
    assert sorted(kinds) == ["chirp.csv", "startup.csv"]


def test_what_is_proposed_where_nothing_has_a_name() -> None:
    """One drive after the other; of any clock, with its sweep or without."""
    found = diagnose(commissioned(), later())
    state, kinds = AugmentedModel.given(commissioned(), found.runs, []), []
    while (proposed := experiment.propose(Selection(state, state, state, (), frozenset(), (state,)), "unknown")) is not None:
        drive = proposed_drive(proposed.command)
        kinds.append(drive.path)
        slower = marked(recording(np.interp(np.arange(0, drive.time_s[-1], 1.1 / RATE_HZ), drive.time_s, drive.command_V),
                                  None, RATE_HZ / 1.1, drive.path), memory="unknown")
        state = AugmentedModel.given(commissioned(), [*state.recordings, *recorded(plain_model(), [slower])], [])
    assert kinds == ["steps.csv", "chirp.csv", "minor-loops.csv"]


def test_one_recording_gives_no_interval_and_says_so() -> None:
    document = diagnosed("one recording").document
    assert document.effects[0].name == "delay" and document.effects[0].shrink_ci95 is None
    assert document.promised.ci90 is None and "one recording" in document.promised.why_no_interval
    assert any("there is only one recording" in note for note in document.notes)


def test_several_recordings_give_an_interval() -> None:
    document = diagnose(commissioned(), later(entry("creep", percent_per_decade=2.0))).document
    low, high = document.promised.ci90
    assert low < document.promised.shrink < high and document.promised.why_no_interval is None
    low, high = document.effects[0].parameters["percent_per_decade"].ci95
    assert 0 < low < high and not any("one recording" in note for note in document.notes)


def test_recordings_that_the_model_was_fitted_to() -> None:
    note = next(note for note in diagnose(commissioned(), later()).document.notes if "was fitted to" in note)
    assert "give other recordings" in note


def test_a_model_without_passport_says_what_it_cannot_claim() -> None:
    model = replace(commissioned(), passport=None)
    document = diagnose(model, later(entry("delay", delay_s=0.003))).document
    assert document.effects[0].name == "delay" and document.passport is None
    assert any("no passport" in note and "fit the model again" in note for note in document.notes)
    assert all(row.ratio is None for row in document.runs)
    assert diagnose(model, later()).document.verdict == "none"


@pytest.mark.filterwarnings("error")
def test_recordings_that_show_no_noise() -> None:
    """Of a plant that is the model: what is left is nothing, and nothing divides by it."""
    model = plain_model()
    silent = drives(LATER)
    for entries in ([], [entry("creep", percent_per_decade=2.0)], [entry("delay", delay_s=0.003)]):
        truth = chain.simulate(replace(model, effects=entries), silent)
        runs = [changed(run, displacement_um=one.predicted_um) for run, one in zip(silent, truth)]
        found = diagnose(model, runs)
        assert [one.name for one in found.document.effects] == [one["name"] for one in entries]
        json.dumps(found.document.to_json(), allow_nan=False)


def test_numerics_are_settled_without_recordings() -> None:
    document = diagnosed("none").document
    for rates in ("rms_um", "rms_um_4x"):
        assert set(getattr(document.numerics, rates)) == {"f32", "q31"}
        assert all(0 < value < 1e-3 * 12 for value in getattr(document.numerics, rates).values())


def test_progress_ends_at_one() -> None:
    seen: list[float] = []
    diagnose(commissioned(), later(), progress=seen.append)
    assert seen[-1] == 1.0 and all(0 <= fraction <= 1 for fraction in seen) and len(seen) > 5


def test_same_recordings_same_document() -> None:
    runs = later(entry("creep", percent_per_decade=2.0))
    assert diagnose(commissioned(), runs).document == diagnose(commissioned(), runs).document


# --- against earlier recordings of the same drives -------------------------------------------------------------------

CREEP = entry("creep", percent_per_decade=3.0)  # that the actuator always had


@lru_cache(maxsize=None)
def with_creep() -> Model:
    """Of the operator alone: with the creep in the model nothing would hide."""
    return fit(recorded(plain_model(), drives(COMMISSIONING), CREEP),
               Options(rate_independent=True, effects="none")).model


def twice(*entries: dict, always: Sequence[dict] = (CREEP,)) -> tuple[list[Recording], list[Recording]]:
    """An actuator before and after."""
    return (recorded(plain_model(), drives(LATER), *always, seed=2),
            recorded(plain_model(), drives(LATER), *always, *entries))


@pytest.mark.parametrize(("name", "values"), [("gain_change", {"factor": 1.005}), ("backlash", {"width_um": 0.02})])
def test_earlier_recordings_show_what_hides_in_the_models_own_error(name: str, values: dict[str, float]) -> None:
    before, now = twice(entry(name, **values))
    alone, found = diagnose(with_creep(), now), diagnose(with_creep(), now, earlier=before)
    assert alone.document.verdict == "none" or name_of(alone) != name
    assert found.document.verdict == "effect" and name_of(found) == name
    (parameter,) = values
    assert found.document.effects[0].parameters[parameter].value == pytest.approx(values[parameter], rel=0.1)
    assert found.document.paired and not alone.document.paired
    assert found.document.gap.rms_um < alone.document.gap.rms_um
    assert [row.earlier for row in found.document.runs] == [run.path for run in before]


def test_nothing_new_is_nothing_however_wrong_the_model() -> None:
    before, now = twice(always=[CREEP, entry("backlash", width_um=0.3)])
    found = diagnose(with_creep(), now, earlier=before[::-1])
    assert found.document.verdict == "none" and found.document.passport.ratio < 1.2
    assert found.document.gap.rms_um == pytest.approx(np.sqrt(2) * NOISE_UM, rel=0.1)
    assert diagnose(with_creep(), now).document.verdict != "none"


def test_a_monitor_before_and_after() -> None:
    """Of an amplifier that always lagged, and now is late as well."""
    lag, late = entry("lag", time_constant_s=0.0003), entry("delay", delay_s=0.002)

    def monitored(runs: list[Recording], *ahead: dict) -> list[Recording]:
        acting = effects.acting(replace(plain_model(), effects=list(ahead)))
        return [changed(run, monitor_V=effects.driven(acting, run.command_V, run, plain_model())) for run in runs]

    before, now = twice(late, always=[CREEP, lag])
    found = diagnose(with_creep(), monitored(now, lag, late), earlier=monitored(before, lag))
    assert found.document.verdict == "effect" and name_of(found) == "delay"
    assert found.document.effects[0].parameters["delay_s"].value == pytest.approx(0.002, rel=0.1)
    assert found.document.where.stage == "timing"
    with pytest.raises(BadInput, match=r"lacks monitor_V, which sawtooth 0\.9\.csv has"):
        diagnose(with_creep(), monitored(now, lag, late), earlier=before)


@pytest.mark.parametrize(("change", "message"), [
    (lambda run: scaled(run, command=1.01),
     r"no earlier recording has the same drive throughout \(the nearest is \S+ "),
    (lambda run: changed(run, **{name: values[:-1] for name, values in run.columns.items()}),
     r"the same drive throughout \(the nearest is .+, which ends after \d+ of its \d+ samples\)"),
    (lambda run: marked(changed(run, time_s=run.time_s / 2), sample_rate_hz="2000"), "1000 samples per second"),
    (lambda run: scaled(run, displacement=-1.0), "moves opposite to the model"),
])
def test_earlier_recordings_that_are_of_other_drives(change: Any, message: str) -> None:
    before, now = twice()
    with pytest.raises(BadInput, match=message):
        diagnose(with_creep(), now, earlier=[*map(change, before)])


def test_a_disturbance_that_was_there_before_is_not_new() -> None:
    """As strong, at another phase: it does not cancel; nor does one that has gone."""
    def hummed(runs: list[Recording], size_um: float, phase: float) -> list[Recording]:
        return [changed(run, displacement_um=run.displacement_um
                        + size_um * np.sin(2 * np.pi * 47.3 * run.time_s + phase * (k + 1)))
                for k, run in enumerate(runs)]

    before, now = twice()
    for earlier, later_ in ((0.05, 0.05), (0.05, 0.0)):
        document = diagnose(with_creep(), hummed(now, later_, 0.5), earlier=hummed(before, earlier, 2.0)).document
        assert not document.effects
        (line,) = (one for one in document.candidates if one.name == "periodic_disturbance")
        assert line.rejected_because == "was already in the earlier recordings"
    found = diagnose(with_creep(), hummed(now, 0.1, 0.5), earlier=hummed(before, 0.02, 2.0))
    assert found.document.verdict == "effect" and name_of(found) == "periodic_disturbance"


def moved(runs: Sequence[Recording], *zeros_um: float) -> list[Recording]:
    """Every recording with its own zero."""
    return [changed(run, displacement_um=run.displacement_um + zero) for run, zero in zip(runs, zeros_um, strict=True)]


def test_the_zero_moves_where_recordings_agree_that_it_did() -> None:
    late = later(entry("delay", delay_s=0.0034))
    plain, stroke_um = diagnose(commissioned(), late), commissioned().stroke_um
    assert plain.document.offset_um.added == 0 and plain.improved.offset_um == commissioned().offset_um
    all_ = diagnose(commissioned(), moved(late, *[0.05 * stroke_um] * len(late)))
    assert all_.document.offset_um.added == pytest.approx(0.05 * stroke_um, abs=0.005 * stroke_um)
    assert all_.improved.offset_um - commissioned().offset_um == all_.document.offset_um.added
    assert all_.document.offset_um.moved and any("includes their mean" in note for note in all_.document.notes)
    some = diagnose(commissioned(), moved(late, 0.08 * stroke_um, *[0.02 * stroke_um] * (len(late) - 1)))
    assert some.document.offset_um.mean > 0.02 * stroke_um and some.document.offset_um.added == 0
    assert not some.document.offset_um.moved and name_of(some) == "delay"


@pytest.mark.parametrize("share", [-2.0, -0.7, -0.4, 0.7])
def test_what_an_effect_does_to_the_zero_is_undone_as_far_as_recordings_say(share: float) -> None:
    """Zeros that scatter, and do not agree with what the effect does to them."""
    runs = later(entry("gain_change", factor=1.2))
    done_um = float(np.mean([np.mean(run.displacement_um - one.predicted_um)
                             for run, one in zip(runs, chain.simulate(commissioned(), runs))]))
    zeros = share * done_um + done_um * np.array([1.0, -1.0, 1.0, -1.0])
    found = diagnose(commissioned(), moved(runs, *zeros))
    assert name_of(found) == "gain_change" and not found.document.offset_um.moved
    assert found.document.offset_um.added == pytest.approx(np.clip(share, -1, 0) * done_um, abs=0.02 * done_um)


def test_the_zero_of_an_unknown_memory_counts_only_if_there_is_no_other() -> None:
    late, stroke_um = later(entry("delay", delay_s=0.0034)), commissioned().stroke_um
    others = [0.0] * (len(late) - 1)
    lost = [marked(late[0], memory="unknown"), *late[1:]]
    near = diagnose(commissioned(), moved(lost, 0.1 * stroke_um, *others)).document.offset_um
    assert near.added == 0 and near.high > 0.09 * stroke_um
    far = diagnose(commissioned(), moved(lost, 0.0, *[0.05 * stroke_um for _ in others])).document.offset_um
    assert far.added == pytest.approx(0.05 * stroke_um, abs=0.005 * stroke_um) and far.low < 0.01 * stroke_um


def test_a_single_recordings_zero_moves_if_it_moved_far() -> None:
    """Its scatter is not known; a usual one stands for it."""
    late = later(entry("delay", delay_s=0.0034))[:1]
    stroke_um = commissioned().stroke_um
    near, by_creep, far = (diagnose(commissioned(), moved(late, share * stroke_um)).document.offset_um
                           for share in (0.004, 0.03, 0.1))
    assert near.added == by_creep.added == 0 and not by_creep.moved
    assert far.added == pytest.approx(0.1 * stroke_um, abs=0.01 * stroke_um)


def test_the_sensors_zero_is_compared_with_the_earlier_one() -> None:
    before, now = ([changed(run, displacement_um=run.displacement_um + 3.0) for run in runs]
                   for runs in twice(entry("gain_change", factor=1.02)))
    found = diagnose(with_creep(), now, earlier=before).document
    assert abs(found.offset_um.mean) < 0.3 and not any("constant" in note for note in found.notes)
    further = diagnose(with_creep(), moved(now, *[1.0] * len(now)), earlier=before)
    assert further.document.offset_um.mean == pytest.approx(found.offset_um.mean + 1.0, abs=0.01)
    assert any("um from the earlier ones; these constants, one a recording, are not counted" in note
               for note in further.document.notes)
    unnamed = diagnose(with_creep(), moved(before, *[1.0] * len(now)), earlier=before).document
    for one, text in ((further.document, "zero or the mount has changed"), (unnamed, "the gain may have changed")):
        assert any(text in note for note in one.notes), (one.verdict, one.notes)


def test_what_differs_from_recording_to_recording_anyway_is_new_only_beyond_that() -> None:
    """A drift of the room, and a start that another past has left, small beside what a drive repeated differs by."""
    def drifted(um_per_s: float) -> list[Recording]:
        return [changed(run, displacement_um=run.displacement_um + um_per_s * (k + 1) * run.time_s)
                for k, run in enumerate(now)]

    before, now = twice()
    for um_per_s, drifts in ((0.002, False), (0.1, True)):
        document = diagnose(with_creep(), drifted(um_per_s), earlier=before).document
        (row,) = (one for one in document.candidates if one.name == "thermal_drift")
        assert row.shrink > 0.2 and (document.passport.ratio > 1) == drifts
        assert [one.name for one in document.effects] == ["thermal_drift"] * drifts
        assert (row.rejected_because == "recordings of an unchanged rig may differ by as much") != drifts


def test_a_grid_of_readings_that_was_there_before_is_not_new() -> None:
    before, now = ([changed(run, displacement_um=0.3 * np.round(run.displacement_um / 0.3)) for run in runs]
                   for runs in twice())
    assert not diagnose(with_creep(), now, earlier=before).document.effects
    assert name_of(diagnose(with_creep(), now, earlier=twice()[0])) == "quantisation"


def test_what_is_promised_of_a_change_is_told_beside_the_whole() -> None:
    before, now = twice(entry("gain_change", factor=1.005))
    found = diagnose(with_creep(), now, earlier=before)
    assert found.document.gap.whole_um.before == pytest.approx(left_um(with_creep(), now), rel=1e-6)
    assert found.document.gap.whole_um.after == pytest.approx(left_um(found.improved, now), rel=1e-3)
    assert diagnose(with_creep(), now).document.gap.whole_um is None


def test_a_mended_model_has_no_change_left() -> None:
    """The effect that was found had not acted in the earlier recordings."""
    before, now = twice(entry("gain_change", factor=1.02))
    improved = diagnose(with_creep(), now, earlier=before).improved
    again = diagnose(improved, now, earlier=before).document
    assert again.verdict == "none" and not any("also acted in the earlier" in note for note in again.notes)


@pytest.mark.parametrize(("wrong", "words"), [
    (lambda volts: np.full_like(volts, 5.0), "is constant at 5 V while the command moves"),
    (lambda volts: volts + 30, "lies 30 V from it"), (lambda volts: 1000 * volts, "moves 1e.03 V per volt"),
    (lambda volts: -volts, "moves -1 V per volt")])
def test_a_monitor_that_cannot_be_one_is_refused_in_any_recording(wrong: Callable, words: str) -> None:
    for k in range(3):
        runs = [changed(run, monitor_V=run.command_V) for run in later()]
        runs[k] = changed(runs[k], monitor_V=wrong(runs[k].command_V))
        with pytest.raises(BadInput, match=words):
            diagnose(commissioned(), runs)


def test_recordings_read_at_another_moment_of_the_hold_than_the_models_are_said() -> None:
    model, runs = commissioned(), [marked(run, read_at="switch") for run in later()]
    assert not any("--at" in note for note in diagnose(model, runs).document.notes)
    fitted = [{**run, "read_at": "middle"} for run in model.fit["runs"]]
    notes = diagnose(replace(model, fit={**model.fit, "runs": fitted}), runs).document.notes
    assert any("half a sample" in note and "--at middle and" in note for note in notes)


def test_recordings_of_another_clock_range_or_length() -> None:
    run = later()[0]
    slower = marked(run, sample_rate_hz=f"{run.sample_rate_hz / 1000:g}")
    slower = replace(slower, columns={**run.columns, "time_s": 1000 * run.time_s})
    assert any("check that time_s is in s" in note for note in diagnose(commissioned(), [slower]).document.notes)
    short = replace(run, columns={name: column[:300] for name, column in run.columns.items()})
    assert any("only 300 samples" in note for note in diagnose(commissioned(), [short]).document.notes)
    with pytest.raises(BadInput, match="V beyond 0 to 100 V, the whole range of the model"):
        diagnose(commissioned(), [changed(run, command_V=5 * run.command_V)])


def test_a_change_that_may_be_none_is_left_out() -> None:
    """Beside a new delay, the resonance that the model holds stays what it was."""
    ringing = [entry("resonance", f0_hz=60.0, damping=0.02)]
    model = fit(recorded(plain_model(), drives(COMMISSIONING), *ringing), Options(rate_independent=True)).model
    assert "resonance" in [one["name"] for one in model.effects]
    delayed = entry("delay", delay_s=0.003)
    document = diagnose(model, recorded(plain_model(), drives(LATER), *ringing, delayed, seed=3),
                        earlier=recorded(plain_model(), drives(LATER), *ringing, seed=4)).document
    assert [one.name for one in document.effects] == ["delay"]
    resonance = Candidate(CATALOGUE["resonance"](), {"f0_hz": 61.0, "damping": 0.02}, ("f0_hz", "damping"),
                          np.zeros(0), np.zeros((0, 2)))
    broad = replace(resonance, values={"f0_hz": 61.0, "damping": 0.3})
    assert not resonance.at_end and broad.at_end
    assert not replace(broad, held={"f0_hz": 60.0, "damping": 0.3}).at_end, "the model holds such a one"
    assert bounded(resonance.effect, resonance.values, {"damping": 1.0})["damping"] == 0.3
    assert bounded(resonance.effect, {"f0_hz": 61.0, "damping": 0.5}, {"damping": 1.0})["damping"] == 0.5


def shown_filtered(runs: list[Recording]) -> list[Recording]:
    """With the monitor of an amplifier that does not lag, behind a filter that does."""
    lag = effects.acting(replace(plain_model(), effects=[entry("lag", "amplifier", time_constant_s=0.003)]))
    return [changed(run, monitor_V=effects.driven(lag, run.command_V, run, plain_model())) for run in runs]


@pytest.mark.parametrize(("make", "why"), [
    (shown_filtered, "follows the command and not the monitor"),
    (lambda runs: [changed(run, monitor_V=0.8 * run.command_V) for run in runs], "check its gain and time"),
    (lambda runs: [changed(run, monitor_V=np.roll(run.command_V, -10)) for run in runs], "check its gain and time")])
def test_a_monitor_that_the_displacement_does_not_follow_is_left_out(make: Callable, why: str) -> None:
    """What the column shows does not drive the actuator; without it, the gain that changed is found."""
    assert diagnose(commissioned(), make(later())).improved.digest() == commissioned().digest()
    document = diagnose(commissioned(), make(later(entry("gain_change", factor=1.05)))).document
    assert document.effects[0].name == "gain_change"
    assert document.effects[0].parameters["factor"].value == pytest.approx(1.05, abs=0.005)
    assert any("monitor_V is left out of all recordings" in note and why in note for note in document.notes)


def test_monitors_that_contradict_each_other_are_left_out() -> None:
    """One is a copy of the command, the others show an amplifier that lags: so does the actuator's, in all of them."""
    lag = entry("lag", "amplifier", time_constant_s=0.003)
    seen = shown_filtered(later(lag))
    found = diagnose(commissioned(), [changed(seen[0], monitor_V=seen[0].command_V), *seen[1:]])
    document = found.document
    assert not any("monitor_V" in run.columns for run in found.runs)  # a model that is refitted must not see it again
    assert "lag" in {document.effects[0].name, *document.effects[0].confusable_with}
    assert any(f"in {seen[0].path} it is the command to the last digit" in note
               for note in document.notes)
    whole = diagnose(commissioned(), seen).document
    assert [one.name for one in whole.effects] == ["lag"] and not any("left out" in note for note in whole.notes)


def test_a_monitor_that_is_itself_filtered_improves_nothing() -> None:
    """Beside a large gap the monitor is believed until what it shows makes that larger."""
    runs = [changed(run, displacement_um=run.displacement_um + np.random.default_rng(k).normal(0, 0.35, len(run)))
            for k, run in enumerate(later())]
    found = diagnose(commissioned(), shown_filtered(runs))
    assert found.document.verdict == "unknown" and found.improved.digest() == commissioned().digest()
    assert any("the monitor is late" in note for note in found.document.notes)


@pytest.mark.parametrize(("few", "ratio", "shape", "sure"), [
    (True, 1.3, 0.46, False), (True, 1.3, 0.48, True), (True, 0.5, 0.48, True), (True, 3.0, 0.0, False),
    (True, 3.0, 0.3, True), (False, 1.3, 0.3, False), (False, 1.3, 0.32, True), (False, 0.5, 0.43, True)])
def test_what_a_gap_without_a_name_must_show(few: bool, ratio: float, shape: float, sure: bool) -> None:
    """A small size hides no shape; with few recordings both together count less than their sum."""
    gap = Excess(total=1.0, floor=0.5, ratio=ratio, spread=0.5, ratios=None, few=few)
    found = SimpleNamespace(given=SimpleNamespace(earlier=[]), rounds=[SimpleNamespace(shape=shape)])
    assert diagnosis._sure(found, gap, Spectrum()) == sure


@pytest.mark.parametrize(("now", "usual", "few"), [(4, 4, False), (3, 4, True), (4, 3, True), (1, 1, True)])
def test_few_recordings_show_a_gap_less_surely_and_so_does_a_passport_of_few(now: int, usual: int, few: bool) -> None:
    known = passport.read(commissioned())
    known, runs = replace(known, runs=known.runs[:usual]), [*later(), *later()][:now]
    given = AugmentedModel.given(commissioned(), runs, [])
    coords = [localise.coordinates(one.recording, one.predict(()), one.rate_um_per_s) for one in given.dataset.model_runs]
    assert excess(given, known, coords).few == few


@pytest.mark.parametrize(("count", "compared", "least", "less"), [
    (1, False, thresholds.DETECTION_ONE, True), (1, True, thresholds.DETECTION_FEW, False),
    (2, False, thresholds.DETECTION_FEW, True), (2, True, thresholds.DETECTION_FEW, False),
    (3, False, thresholds.DETECTION_FEW, False)])
def test_one_or_two_recordings_show_a_gap_least_surely(count: int, compared: bool, least: float, less: bool) -> None:
    """What is smaller than usual may have the shape of an effect there. Earlier recordings take off what the model misses."""
    gap = Excess(total=1.0, floor=0.8, ratio=0.8, spread=0.5, ratios=[0.8] * count, few=True, compared=compared)
    assert gap.threshold == least
    assert gap.evidence_with(0.4) == pytest.approx(0.4 + less * gap.evidence) and gap.evidence < 0


def test_what_few_recordings_do_not_agree_on_is_less_sure() -> None:
    """Beside a passport of few: a model may miss some waveforms by more than commissioning has shown."""
    known, model = passport.read(commissioned()), commissioned()
    runs = [*later()]
    agreed = [changed(run, displacement_um=run.displacement_um * 1.1) for run in runs]
    apart = [*runs[:3], changed(runs[3], displacement_um=runs[3].displacement_um * 1.2)]

    def spread(of: Sequence[Recording], usual: int) -> float:
        given = AugmentedModel.given(model, of, [])
        coords = [localise.coordinates(one.recording, one.predict(()), one.rate_um_per_s)
                  for one in given.dataset.model_runs]
        return excess(given, replace(known, runs=known.runs[:usual]), coords).spread

    assert spread(agreed, 4) == spread(apart, 4) == known.spread
    assert known.spread < spread(agreed, 3) < spread(apart, 3)
    assert spread(apart[1:], 3) == known.spread  # three do not tell how they scatter


def test_beside_earlier_recordings_a_passport_of_few_is_no_doubt() -> None:
    model, (before, now) = with_creep(), twice()
    known = passport.read(model)
    given = AugmentedModel.given(model, now * 2, before * 2)
    coords = [localise.coordinates(one.recording, one.predict(()), one.rate_um_per_s) for one in given.dataset.model_runs]
    assert len(now * 2) >= thresholds.FEW and not excess(given, replace(known, runs=known.runs[:1]), coords).few


def test_a_sensor_that_became_noisy() -> None:
    random = np.random.default_rng(3)
    found = diagnose(commissioned(), [changed(run, displacement_um=run.displacement_um
                                              + 0.3 * random.standard_normal(len(run))) for run in later()])
    assert found.document.verdict == "unknown"
    assert any("noise from sample to sample" in note for note in found.document.notes)


def test_remarks_on_earlier_recordings() -> None:
    before, now = twice()
    notes = diagnose(with_creep(), now, earlier=[scaled(run, displacement=5.0) for run in before]).document.notes
    assert any(note.startswith("earlier, sawtooth 0.9.csv moves")
               and "check that it is of the same actuator" in note for note in notes)
    model = replace(with_creep(), effects=[entry("delay", delay_s=0.001)])
    assert any("also acted in the earlier" in note
               for note in diagnose(model, now, earlier=before).document.notes)
    notes = diagnose(with_creep(), now, earlier=[marked(run, memory="unknown") for run in before]).document.notes
    assert any("its memory is reset, but unknown in its earlier recording" in note for note in notes)


def test_earlier_recordings_may_be_longer_and_more() -> None:
    before, now = twice(entry("delay", delay_s=0.002))
    shorter = [changed(run, **{name: values[:-50] for name, values in run.columns.items()}) for run in now[1:]]
    assert name_of(diagnose(with_creep(), shorter, earlier=before)) == "delay"


def test_an_earlier_recording_is_not_the_same_one() -> None:
    now = twice()[1]
    with pytest.raises(BadInput, match=r"holds the samples of .*, which is to be earlier"):
        diagnose(with_creep(), now, earlier=now)


@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_a_change_that_would_spoil_a_model_that_fits_today_is_none_of_the_actuators(scale: float) -> None:
    """Earlier recordings in other units."""
    before, now = twice()
    scaled = [changed(run, displacement_um=scale * run.displacement_um) for run in before]
    found = diagnose(with_creep(), now, earlier=scaled)
    assert found.improved == with_creep()
    (told,) = (note for note in found.document.notes if "the improved model is the given one" in note)
    assert "gain_change" in told


def test_a_model_whose_effects_are_no_objects_beside_earlier_recordings() -> None:
    before, now = twice()
    with pytest.raises(BadInput, match=r"effects\[0\] is 3, which this version cannot simulate"):
        diagnose(replace(with_creep(), effects=[3]), now, earlier=before)


# --- what it refuses, what it remarks --------------------------------------------------------------------------------

@pytest.mark.parametrize(("change", "message"), [
    (lambda run: scaled(run, displacement=1000.0), "the units differ"),
    (lambda run: scaled(run, displacement=1e-3), "the units differ"),
    (lambda run: scaled(run, command=1000.0), "the units differ"),
    (lambda run: scaled(run, displacement=-1.0), "moves opposite to the model"),
    (lambda run: changed(run, displacement_um=np.full(len(run), 3.0)), "displacement_um is constant"),
    (lambda run: changed(run, command_V=np.full(len(run), 3.0)), "command_V is constant"),
])
def test_recordings_that_cannot_be_this_models(change: Any, message: str) -> None:
    with pytest.raises(BadInput, match=message) as error:
        diagnose(commissioned(), [change(run) for run in later()])
    assert str(error.value).startswith("sawtooth 0.9.csv: ")


@pytest.mark.parametrize("share", [0.2, 5.0])
def test_recordings_of_another_actuator_are_remarked_on(share: float) -> None:
    document = diagnose(commissioned(), [scaled(run, displacement=share) for run in later()]).document
    assert any("check that it is of the same actuator" in note for note in document.notes)
    assert document.verdict != "none"


def test_another_actuators_name_is_remarked_on() -> None:
    model = replace(commissioned(), actuator="stack 7")
    document = diagnose(model, [marked(run, actuator="stack 8") for run in later()]).document
    assert any("the recordings are of stack 8, but the model is of stack 7" in note for note in document.notes)
    notes = diagnose(model, [marked(run, actuator="stack 7") for run in later()]).document.notes
    assert not any("recorded from" in note for note in notes)


def test_a_clipped_sensor_is_remarked_on() -> None:
    clipped = [changed(run, displacement_um=np.minimum(run.displacement_um, 8.0)) for run in later()]
    document = diagnose(commissioned(), clipped).document
    assert any("a clipped sensor" in note for note in document.notes) and document.verdict != "none"


def test_a_command_beyond_what_the_model_was_fitted_to_is_remarked_on() -> None:
    wide = recorded(plain_model(), [changed(run, command_V=1.3 * run.command_V) for run in drives(LATER)])
    document = diagnose(commissioned(), wide).document
    assert any("V beyond the range that the model was fitted to" in note for note in document.notes)


def test_loops_that_are_fitted_anew_are_told() -> None:
    """A lag that was there at commissioning has bent them; one that is new has not."""
    lag = entry("lag", time_constant_s=0.004)
    model = fit(recorded(plain_model(), drives(COMMISSIONING), lag), Options(rate_independent=True, effects="none")).model
    there, new = diagnose(model, later(lag)), diagnose(commissioned(), later(lag))
    assert name_of(there) == name_of(new) == "lag"
    assert not np.allclose(there.improved.slopes, model.slopes) and np.allclose(new.improved.slopes, commissioned().slopes)
    told = [any("loops were fitted anew" in note for note in found.document.notes) for found in (there, new)]
    assert told == [True, False]


def test_what_is_named_stands_at_one_stage() -> None:
    """Beside what the model lacks, a delay of the sensor leaves a little less than the one that is named."""
    play = entry("backlash", width_um=1.0)
    model = fit(recorded(plain_model(), drives(COMMISSIONING), play), Options(rate_independent=True, effects="none")).model
    document = diagnose(model, recorded(plain_model(), drives(), play, entry("delay", delay_s=0.01))).document
    (effect,) = document.effects
    assert [(one.name, one.stage) for one in document.candidates if one.name == effect.name] == [("delay", effect.stage)]


def test_every_stage_lies_in_the_chain() -> None:
    document = diagnosed("effect").document
    assert set(document.where.stage.split(" or ")) <= set(STAGES)
    assert all(one.stage in STAGES for one in document.candidates)
