#!/usr/bin/env python3
"""Does `rdpi fit` find what stands around the operator, and only where it stands? One command per question.

    .venv/bin/python tests/rigs/chain.py plain --rigs 25
    .venv/bin/python tests/rigs/chain.py recovered --rigs 13
    .venv/bin/python tests/rigs/chain.py tracked --rigs 2
    .venv/bin/python tests/rigs/chain.py monitored --rigs 2
    .venv/bin/python tests/rigs/chain.py law
    .venv/bin/python tests/rigs/chain.py picma
    .venv/bin/python tests/rigs/chain.py cuts

plain      Rigs without delay, lag, overshoot (a lag of second order) and relaxation, all else as the seed draws it:
           how many models get a delay or lag above a third of a sample, or a relaxation above 0.5 % of the movement.
           Some of these rigs come late all the same: loops that widen with the rate do so with a lag of 1 ms, and creep
           begins at 25 ms. "bare too" counts those that get one without these as well.
recovered  Rigs with one of delay, lag, relaxation, creep and resonance, and with three of them: error on waveforms that
           were not fitted, over that of the same rig without them; where the model names exactly these effects, how
           many of the 95 % intervals hold the true value. Per family, and under it all others: thresholds that were
           chosen on the others are scored on the family.
tracked    The same rigs tracked by `rdpi compensate`, which compensates what the model holds: error over that of the
           same rig without the effects and with a model of its own. "true": that model and the rig's true effects,
           which the inverse cannot beat; "fitted": a model of recordings with the effects; "none": that with --effects
           none. "rung": what the same rig without the effects misses, passed through the true resonance. An inverse
           makes the rig follow what it is asked; the resonance amplifies what the operator's model misses.
           Below, sines of several frequencies: error with and without preview.
monitored  Rigs whose sensor is late, too: how late the model says that amplifier and sensor are, from recordings with
           monitor_V, and by how much the displacement itself, which no sensor delays, misses its reference: with a model
           of recordings with monitor_V, and of the same without; over that of the same rig with a sensor in time.
law        The paper's law on tests/bench, without and behind 0.5 ms of delay: the delay that is found, and the slopes'
           rate coefficients beside those found without it.
picma      The measured P-885.91 of ../shared/data (or $RDPI_DATA): predictions, and the drive for its displacement
           against the command that was recorded.
cuts       The same record cut in two in twelve places, both parts of unknown memory: how well the model of each predicts
           the other, beside its offset and with it.

tests/benchmark/fit_speed.py tells time and memory. What stands after `--` goes to `rdpi fit`.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "bench")]

import measure  # noqa: E402  before NumPy: it says how many threads
import bench  # noqa: E402
import numpy as np  # noqa: E402
from rigs import FAMILIES, SENSOR, make_rig, second_order  # noqa: E402

LATE = "delay", "lag", "overshoot", "relaxation"
OWN = "rate", "creep"  # what comes late beside those
PUTS = "alone", "threes"
Job = tuple[str, int]


# --- plain rigs stay plain -------------------------------------------------------------------------------------------

def plain(job: Job, rate_hz: float, scale: float, options: Sequence[str]) -> dict[str, Any]:
    """Effects that the model of a rig without LATE holds; if some come late, also those without what it has of its own
    that does.
    """
    rig = make_rig(*job).without(*LATE)
    result: dict[str, Any] = {"family": job[0], "seed": job[1], "rate_hz": rate_hz}
    with tempfile.TemporaryDirectory(prefix="rigs-") as folder:
        try:
            result["effects"] = measure.effects_of(measure.commission(rig, Path(folder), rate_hz, scale, options))
            if late(result):
                bare = rig.without(*OWN)
                result["bare"] = measure.effects_of(measure.commission(bare, Path(folder), rate_hz, scale, options))
        except measure.Refused as refusal:
            result["failed"] = str(refusal)
    return result


def late(result: dict[str, Any], which: str = "effects") -> list[dict[str, Any]]:
    """Effects of LATE with a size that matters."""
    return [one for one in result.get(which, ()) if one["name"] in LATE and measure.matters(one, result["rate_hz"])]


def plain_table(results: Sequence[dict[str, Any]]) -> str:
    """Per family, rigs, how many of them got a late effect that matters, and how many get one without OWN as well;
    below, each of the former, and all names.
    """
    lines = [f"{'family':24} rigs  late  share  bare too  share"]
    done = [one for one in results if "failed" not in one]
    for name, part in by_family(done):
        wrong, bare = (sum(bool(late(one, which)) for one in part) for which in ("effects", "bare"))
        lines.append(f"{name:25}{len(part):4}{wrong:6}{100 * wrong / len(part):6.1f} %{bare:8}"
                     f"{100 * bare / len(part):6.1f} %")
    for one in done:
        for effect in late(one):
            sizes = ", ".join(f"{name} {stated['value']:.3g}" for name, stated in effect["parameters"].items())
            lines.append(f"  {one['family']} {one['seed']}: {effect['name']}, {sizes}"
                         + ("; bare too" if late(one, "bare") else ""))
    named = Counter(effect["name"] for one in done for effect in one["effects"])
    lines.append(f"models that name an effect, small or not: {', '.join(f'{k} {n}' for k, n in named.items()) or 0}")
    return "\n".join(lines + failures(results))


# --- the chain recovered ---------------------------------------------------------------------------------------------

def recovered(job: tuple[str, Job], rate_hz: float, scale: float, options: Sequence[str]) -> dict[str, Any]:
    """A rig with one or three effects put in, and the same rig without them: models, errors on field waveforms."""
    put, (family, seed) = job
    rig = measure.choose(family, seed, put)
    result: dict[str, Any] = {"put": put, "family": family, "seed": seed,
                              "truth": {name: rig.sins[name] for name in measure.PUT if name in rig.sins}}
    for name, one in (("with", rig), ("without", rig.without(*result["truth"]))):
        with tempfile.TemporaryDirectory(prefix="rigs-") as folder:
            try:
                model = measure.commission(one, Path(folder), rate_hz, scale, options)
                result[name] = {"effects": measure.effects_of(model),
                                "prediction": measure.predict(one, Path(folder), rate_hz, scale)}
            except measure.Refused as refusal:
                result["failed"] = f"{put}, {name}: {refusal}"
    return result


def right(result: dict[str, Any]) -> bool:
    """Whether the model names the effects that were put in, and no other of their kind."""
    return {one["name"] for one in result["with"]["effects"]} & set(measure.PUT) == set(result["truth"])


def covered(result: dict[str, Any]) -> tuple[int, int]:
    """Intervals that hold the true value, and intervals; of a model that names the right effects."""
    inside = []
    for effect in result["with"]["effects"] if right(result) else []:
        for name, true in result["truth"].get(effect["name"], {}).items():
            low, high = (effect["parameters"].get(name) or {}).get("ci95") or (None, None)
            if low is not None and high is not None:
                inside.append(low <= true <= high)
    return sum(inside), len(inside)


def recovered_table(results: Sequence[dict[str, Any]]) -> str:
    """Per family and for all others, of one and of three effects: rigs, ratio, right names, coverage."""
    lines = [f"{'':24}" + "".join(f"{put:>44}" for put in PUTS),
             f"{'family':24}" + f"{'rigs  median  worst   right  inside':>44}" * len(PUTS)]
    done = [one for one in results if "failed" not in one]
    for name, part in by_family(done):
        lines.append(f"{name:24}" + "".join(_recovered_cells([one for one in part if one["put"] == put])
                                            for put in PUTS))
        others = [one for one in done if one["family"] != name]
        if name in FAMILIES and others:
            lines.append(f"{'  all others':24}" + "".join(_recovered_cells([one for one in others if one["put"] == put])
                                                          for put in PUTS))
    return "\n".join(lines + failures(results))


def _recovered_cells(results: Sequence[dict[str, Any]]) -> str:
    if not results:
        return f"{'-':>44}"
    ratio = [one["with"]["prediction"] / one["without"]["prediction"] for one in results]
    inside, intervals = np.sum([covered(one) for one in results], axis=0)
    names = f"{sum(map(right, results))}/{len(results)}"
    return (f"{len(results):13}{np.median(ratio):8.2f}{np.max(ratio):7.2f}{names:>8}"
            f"{f'{inside}/{intervals}':>8}")


# --- the chain inverted ----------------------------------------------------------------------------------------------

WAYS = {"true f32": ("true", "f32"), "true q31": ("true", "q31"), "fitted f32": ("fitted", "f32"),
        "fitted q31": ("fitted", "q31"), "none": ("fitted", "f32", "--effects", "none")}
SINES_HZ = 2.0, 5.0, 10.0, 20.0, 40.0, 80.0
SINE_S = 1.0


def tracked(job: tuple[str, Job], rate_hz: float, scale: float, options: Sequence[str]) -> dict[str, Any]:
    """Tracking errors of a rig with one or three effects put in, and of the same rig without them; in %."""
    put, (family, seed) = job
    rig = measure.choose(family, seed, put)
    truth = {name: rig.sins[name] for name in measure.PUT if name in rig.sins}
    plain = rig.without(*truth)
    result: dict[str, Any] = {"put": put, "family": family, "seed": seed, "truth": truth}
    with tempfile.TemporaryDirectory(prefix="rigs-") as name:
        folder = Path(name)
        try:
            measure.commission(plain, folder, rate_hz, scale, options)
            models = {"plain": folder / "plain.json", "true": folder / "true.json", "fitted": folder / "model.json"}
            model = measure.json.loads(models["fitted"].read_text())
            models["plain"].write_text(measure.json.dumps(model))
            models["true"].write_text(measure.json.dumps({**model, "effects": _with(model["effects"], truth)}))
            measure.commission(rig, folder, rate_hz, scale, options)
            result["effects"] = measure.effects_of(models["fitted"])
            for track in measure.waves.TRACKS:
                found = {"plain": measure.tracking(plain, folder, models["plain"], track, rate_hz, "--engine", "f32")}
                found["rung"] = _rung(plain, truth, folder, models["plain"], track, rate_hz)
                for way, (which, engine, *more) in WAYS.items():
                    found[way] = measure.tracking(rig, folder, models[which], track, rate_hz, "--engine", engine, *more)
                result[track] = found
            result["sines"] = {
                which: {way: [_sine(rig, folder, models[which], hz, rate_hz, *more) for hz in SINES_HZ]
                        for way, more in (("preview", ()), ("no preview", ("--no-preview",)))}
                for which in ("true", "fitted")}
            result["sines"]["plain"] = [_sine(plain, folder, models["plain"], hz, rate_hz) for hz in SINES_HZ]
        except measure.Refused as refusal:
            result["failed"] = f"{put}: {refusal}"
    return result


def _rung(plain: Any, truth: dict[str, dict[str, float]], folder: Path, model: Path, track: str,
          rate_hz: float) -> float:
    """rms in % of the error of a rig without effects, passed through the resonance that it will have, if any."""
    share = measure.waves.track(track, rate_hz, measure.TRACK_S)
    error = measure.following_error(plain, folder, model, share, rate_hz, "--engine", "f32")
    if one := truth.get("resonance"):
        error = second_order(one["f0_hz"], one["damping"], 1 / rate_hz, held=False)(error)
    return measure.spread(error[round(measure.SETTLED_S * rate_hz):])


def _with(held: Sequence[dict[str, Any]], truth: dict[str, dict[str, float]]) -> list[dict[str, Any]]:
    """Effects of a model, and the true ones in place of theirs of the same name."""
    from rdpi.simulate.effects import CATALOGUE

    known = {name: {one.name for one in CATALOGUE[name].parameters} for name in truth}
    return [*(one for one in held if one["name"] not in truth),
            *({"name": name, "stage": CATALOGUE[name].stages[0],
               "parameters": {key: value for key, value in sizes.items() if key in known[name]}}
              for name, sizes in truth.items())]


def _sine(rig: Any, folder: Path, model: Path, hz: float, rate_hz: float, *options: str) -> float:
    t = np.arange(round((measure.SETTLED_S + SINE_S) * rate_hz)) / rate_hz
    share = np.minimum(t / measure.SETTLED_S, 1) * np.sin(2 * np.pi * hz * t) / 2
    return measure.following(rig, folder, model, share, rate_hz, "--engine", "f32", *options)


def tracked_table(results: Sequence[dict[str, Any]]) -> str:
    """Per family, and number of effects: rigs, median and worst ratio of every way; below, the sines."""
    columns = *WAYS, "rung"
    lines = [f"{'tracking error over plain':37}" + "".join(f"{way:>16}" for way in columns),
             f"{'family':25}{'put':8}{'rigs':4}" + f"{'median':>9}{'worst':>7}" * len(columns)]
    done = [one for one in results if "failed" not in one]
    for name, part in by_family(done):
        for put in PUTS:
            some = [one for one in part if one["put"] == put]
            if some:
                lines.append(f"{name:25}{put:8}{len(some):4}" + "".join(
                    f"{np.median(ratio):9.2f}{np.max(ratio):7.2f}" for ratio in (_ratios(some, way) for way in columns)))
    if done:
        lines += ["", f"{'sines, median rms %':24}" + "".join(f"{f'{hz:g} Hz':>9}" for hz in SINES_HZ)]
        lines.append(f"{'plain':24}" + _medians([one["sines"]["plain"] for one in done]))
        for which in ("true", "fitted"):
            for way in ("preview", "no preview"):
                lines.append(f"{f'{which}, {way}':24}" + _medians([one["sines"][which][way] for one in done]))
    return "\n".join(lines + failures(results))


def _ratios(results: Sequence[dict[str, Any]], way: str) -> list[float]:
    return [one[track][way] / one[track]["plain"] for one in results for track in measure.waves.TRACKS]


def _medians(rows: Sequence[Sequence[float]]) -> str:
    return "".join(f"{value:9.2f}" for value in np.median(rows, axis=0))


# --- amplifier and sensor told apart -----------------------------------------------------------------------------------

LATE_SENSORS = {"in time": False, "monitor": True, "command": False}  # how commissioned: with monitor_V?
STAGES = {"amplifier": ("timing", "amplifier"), "sensor": ("sensor",)}


def monitored(job: Job, rate_hz: float, scale: float, options: Sequence[str]) -> dict[str, Any]:
    """Tracking errors in % of the displacement of a rig with a late sensor, and how late its models say it is, in s."""
    rig = make_rig(*job)
    for name in SENSOR:
        rig = rig.put(name)
    in_time = rig.without(*SENSOR)  # moves as the rig does
    overshoot = rig.sins["overshoot"]
    late_s = {"amplifier": rig.sins["delay"]["delay_s"] + rig.sins["lag"]["time_constant_s"]
              + overshoot["damping"] / (np.pi * overshoot["f0_hz"]),
              "sensor": rig.sins["sensor_delay"]["delay_s"] + rig.sins["sensor_lag"]["time_constant_s"]}
    result: dict[str, Any] = {"family": job[0], "seed": job[1], "late_s": late_s}
    with tempfile.TemporaryDirectory(prefix="rigs-") as name:
        folder = Path(name)
        try:
            for way, monitor in LATE_SENSORS.items():
                one = in_time if way == "in time" else rig
                model = measure.commission(one, folder, rate_hz, scale, options, monitor=monitor)
                named = measure.effects_of(model)
                result[way] = {
                    "effects": named,
                    "late_s": {part: sum(effect["parameters"][time]["value"] for effect in named
                                         for time in ("delay_s", "time_constant_s")
                                         if effect["name"] in LATE[:2] and effect["stage"] in stages
                                         and time in effect["parameters"]) for part, stages in STAGES.items()},
                    "tracking": [measure.tracking(in_time, folder, model, track, rate_hz, "--engine", "f32")
                                 for track in measure.waves.TRACKS]}
        except measure.Refused as refusal:
            result["failed"] = str(refusal)
    return result


def monitored_table(results: Sequence[dict[str, Any]]) -> str:
    """Per rig: how late amplifier and sensor are, true and found, in ms; tracking over that with a sensor in time."""
    done = [one for one in results if "failed" not in one]
    lines = [f"{'late by, ms':32}{'amplifier':>20}{'sensor':>20}{'tracking error over that of a sensor in time':>50}",
             f"{'':32}" + f"{'true':>12}{'found':>8}" * len(STAGES) + f"{'with monitor_V':>30}{'without':>20}"]
    for one in done:
        lines.append(f"{one['family'] + ' ' + str(one['seed']):32}" + "".join(
            f"{1e3 * one['late_s'][part]:12.2f}{1e3 * one['monitor']['late_s'][part]:8.2f}" for part in STAGES)
            + "".join(f"{np.max(_of_in_time(one, way)):{width}.2f}" for way, width in (("monitor", 30), ("command", 20))))
    if done:
        lines.append(f"{'median, worst':72}" + "".join(
            f"{f'{np.median(ratios):.2f}, {np.max(ratios):.2f}':>{width}}" for ratios, width in (
                (np.concatenate([_of_in_time(one, way) for one in done]), width)
                for way, width in (("monitor", 30), ("command", 20)))))
    return "\n".join(lines + failures(results))


def _of_in_time(one: dict[str, Any], way: str) -> np.ndarray:
    return np.divide(one[way]["tracking"], one["in time"]["tracking"])


# --- rate law and delay ----------------------------------------------------------------------------------------------

DELAY_S = 5e-4
LAW_RATE_HZ = 10_000
LAW_OPTIONS = "--rate-source", "control"  # as the demo fits the paper's law, which depends on the rate of the control
LAW_DRIVES = {"sawtooth": ["--frequencies", "1,5,10,20,40"], "multisine": ["--duration", "4", "--seed", "1"]}
LAW_UNSEEN = {"multisine": ["--duration", "4", "--seed", "2"], "sine": ["--frequencies", "3,12,30", "--cycles", "8"]}


def law(delay_s: float, options: Sequence[str]) -> dict[str, Any]:
    """The paper's plant behind this delay, a whole number of samples: what the model says and misses."""
    late_by = round(delay_s * LAW_RATE_HZ)

    def runs_of(drives: dict[str, list[str]], folder: Path) -> list[Path]:
        paths = []
        for k, (kind, shape) in enumerate(drives.items()):
            measure.rdpi("excite", kind, "--max-V", "100", "--rest-V", "50", "--sample-rate", LAW_RATE_HZ, "--no-sweep",
                         *shape, "-o", folder / "drive.csv")
            command = measure.columns_of(folder / "drive.csv")["command_V"]
            plant = bench.make("paper", seed=7)
            plant.demagnetise(LAW_RATE_HZ)
            reading = plant.run(np.append(np.full(late_by, command[0]), command)[:len(command)], LAW_RATE_HZ)
            paths.append(folder / f"{k}-{kind}.csv")
            np.savetxt(paths[-1], np.column_stack([np.arange(len(command)) / LAW_RATE_HZ, command, reading]), "%.9g",
                       ",", header=f"# sample_rate_hz: {LAW_RATE_HZ}\n# memory: reset\n"
                       "time_s,command_V,displacement_um", comments="")
        return paths

    with tempfile.TemporaryDirectory(prefix="rigs-") as name:
        folder = Path(name)
        measure.rdpi("fit", *runs_of(LAW_DRIVES, folder), "-o", folder / "model.json", *LAW_OPTIONS, *options)
        errors = []
        for run in runs_of(LAW_UNSEEN, folder):
            measure.rdpi("simulate", folder / "model.json", run, "-o", folder / "predicted.csv")
            columns = measure.columns_of(folder / "predicted.csv")
            errors.append(100 * measure.spread(columns["displacement_um"] - columns["predicted_um"])
                          / float(np.ptp(columns["displacement_um"])))
        model = measure.json.loads((folder / "model.json").read_text())
    return {"effects": model["effects"], "rates": model["slope_rate_s_per_um"], "prediction": errors}


def law_table(without: dict[str, Any], behind: dict[str, Any]) -> str:
    """Delay, coefficients and how far apart they are, errors on waveforms that were not fitted."""
    lines = []
    for label, found in (("without delay", without), (f"behind {1e3 * DELAY_S:g} ms", behind)):
        named = [f"{one['name']} " + ", ".join(f"{name} {stated['value']:.4g}" for name, stated in
                                               one["parameters"].items()) for one in found["effects"]]
        lines += [f"{label:18} effects: {'; '.join(named) or 'none'}",
                  f"{'':18} rms on unseen {' and '.join(LAW_UNSEEN)}: "
                  + " and ".join(f"{error:.2f} %" for error in found["prediction"]),
                  f"{'':18} s/um: " + " ".join(f"{rate:9.2e}" for rate in found["rates"])]
    if len(without["rates"]) != len(behind["rates"]) or not any(without["rates"]):
        return "\n".join([*lines, "the models' rate coefficients cannot be compared"])
    before, after = np.array(without["rates"]), np.array(behind["rates"])
    apart = np.linalg.norm(after - before) / np.linalg.norm(before)
    return "\n".join([*lines, f"coefficients apart: {100 * apart:.1f} % of their rms, the largest by "
                      f"{100 * abs(after - before)[np.argmax(abs(before))] / np.max(abs(before)):.1f} %"])


# --- the measured record ---------------------------------------------------------------------------------------------

RUNS = {"fitted": ("Model_Vi_Do.dat", "400:4400", "unknown"), "next": ("Model_Vi_Do.dat", "4400:8000", "carried"),
        "other": ("Test_Vi_Do_Di.dat", "200:14100", "unknown")}
CUTS, SHORTEST = 12, 600  # rows of the shortest part
CUT = 400 + SHORTEST, 8027 - SHORTEST  # rows between which the record is cut
MODELS: dict[str, list[str]] = {"defaults": [], "--deadzones 4": ["--deadzones", "4"],
                                "--rate-window 0.04": ["--rate-window", "0.04"]}


def data_folder() -> Path:
    return Path(os.environ.get("RDPI_DATA", Path(__file__).parents[3] / "shared/data/picma_p885")).resolve()


def picma(options: Sequence[str]) -> list[dict[str, Any]]:
    """Per model: effects; errors of the predictions, and of the drive by the inverse, in %."""
    results = []
    with tempfile.TemporaryDirectory(prefix="rigs-") as name:
        folder = Path(name)
        for run, (source, rows, memory) in RUNS.items():
            measure.rdpi("import", data_folder() / source, "--command", 0, "--displacement", 4, "--rate", 200, "--rows",
                         rows, "--memory", memory, "-o", folder / f"{run}.csv")
        for label, shape in MODELS.items():
            model = folder / "model.json"
            measure.rdpi("fit", folder / "fitted.csv", "-o", model, *shape, *options)
            results.append({"model": label, "effects": measure.effects_of(model), **_predicted(model, folder),
                            **{f"inverse {run}": _inverse(model, folder / f"{run}.csv") for run in ("next", "other")}})
    return results


def _predicted(model: Path, folder: Path) -> dict[str, float]:
    """The next samples of the record with the memory that the fitted ones leave; the other record without its mean."""
    def percent(*options: str | Path) -> float:
        measure.rdpi("simulate", model, *options, "--json", folder / "score.json")
        return measure.json.loads((folder / "score.json").read_text())["runs"][-1]["rms_percent"]

    return {"next": percent(folder / "fitted.csv", folder / "next.csv"),
            "other": percent(folder / "other.csv", "--remove-offset")}


def _inverse(model_path: Path, run_path: Path) -> dict[str, float]:
    """rms in % of the command's range, constant removed, of the drive that the double-precision inverse of the model's
    operator gives for the recorded displacement. Against the recorded command, shifted by the model's delays; and
    against what reaches the operator when the whole chain of the model is driven with it.
    """
    from rdpi.data import read_recording
    from rdpi.model import read_model
    from rdpi.simulate import ALL, chain, effects, inverse_of

    model, run = replace(read_model(model_path), operator_alone=None), read_recording(run_path)
    steps, _ = chain.follow(model, run, "displacement_um", "f64", remove_offset=True,
                            by=inverse_of(model, leave_out=(ALL,)))
    acting = effects.acting(model)
    delay_s = sum(one.values.get("delay_s", 0.0) for one in acting)
    shifted = np.interp(run.time_s - delay_s, run.time_s, run.command_V)
    found = {"command": shifted, "chain": effects.driven(acting, run.command_V, run, model)}
    return {name: 100 * measure.spread(steps.drive_V - drive_V) / float(np.ptp(run.command_V))
            for name, drive_V in found.items()}


def picma_table(results: Sequence[dict[str, Any]]) -> str:
    lines = [f"{'model':22}{'next':>8}{'other':>8}   inverse against command: next, other   against chain: next, other"]
    for one in results:
        names = ", ".join(effect["name"] for effect in one["effects"]) or "none"
        lines.append(f"{one['model']:22}{one['next']:8.3f}{one['other']:8.3f}"
                     + "".join(f"{one[f'inverse {run}'][against]:{width}.3f}" for against, first in
                               (("command", 31), ("chain", 20)) for run, width in (("next", first), ("other", 8)))
                     + f"   effects: {names}")
    return "\n".join(["rms, % of the stroke; of the inverse, % of the command's range", *lines])


def cuts(options: Sequence[str]) -> list[dict[str, Any]]:
    """Errors in % of the stroke, beside the offset and with it, by the row of the cut; "later": the first part's model."""
    with tempfile.TemporaryDirectory(prefix="rigs-") as name:
        folder, results = Path(name), []
        for cut in np.linspace(CUT[0], CUT[1], CUTS + 2).round().astype(int)[1:-1]:
            parts = {"earlier": f"{CUT[0] - SHORTEST}:{cut}", "later": f"{cut}:{CUT[1] + SHORTEST}"}
            for part, rows in parts.items():
                measure.rdpi("import", data_folder() / RUNS["fitted"][0], "--command", 0, "--displacement", 4, "--rate", 200,
                             "--rows", rows, "-o", folder / f"{part}.csv")
            found: dict[str, Any] = {"row": int(cut)}
            for fitted, part in (("earlier", "later"), ("later", "earlier")):
                model = folder / "model.json"
                measure.rdpi("fit", folder / f"{fitted}.csv", "-o", model, *options)
                measure.rdpi("simulate", model, folder / f"{part}.csv", "--json", folder / "score.json")
                score = measure.json.loads((folder / "score.json").read_text())["runs"][0]
                beside = np.sqrt(max(score["rms_um"]**2 - score["offset_um"]**2, 0.0)) / score["rms_um"]
                found[part] = [float(beside * score["rms_percent"]), score["rms_percent"]]
            results.append(found)
    return results


def cuts_table(results: Sequence[dict[str, Any]]) -> str:
    lines = [f"{one['row']:6}" + "".join(f"{value:9.3f}" for part in ("later", "earlier") for value in one[part])
             for one in results]
    worst = np.max([[*one["later"], *one["earlier"]] for one in results], axis=0)
    return "\n".join(["rms, % of the stroke: of the later part by the earlier one's model, beside its offset and with it; "
                      "of the earlier part", *lines, f"{'worst':>6}" + "".join(f"{value:9.3f}" for value in worst)])


# --- command ---------------------------------------------------------------------------------------------------------

def by_family(results: Sequence[dict[str, Any]]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Results of each family, and of all."""
    families = dict.fromkeys(one["family"] for one in results)
    parts = [(name, [one for one in results if one["family"] == name]) for name in families]
    return [*parts, ("all", list(results))] if results else []


def failures(results: Sequence[dict[str, Any]]) -> list[str]:
    return [f"failed: {one['family']} {one['seed']}: {one['failed']}" for one in results if "failed" in one]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                     usage="%(prog)s [options] {plain,recovered,tracked,monitored,law,picma,cuts} "
                                           "[-- options of rdpi fit]")
    parser.add_argument("what", choices=["plain", "recovered", "tracked", "monitored", "law", "picma", "cuts"])
    parser.add_argument("--rigs", type=int, default=2, help="per family, and per number of effects (default 2)")
    parser.add_argument("--seed", type=int, default=1, help="of the first rig (default 1)")
    measure.add_families(parser)
    parser.add_argument("--rate", type=float, default=5000.0, help="samples per second (default 5000)")
    parser.add_argument("--scale", type=float, default=0.5, help="length of the recordings (default 0.5)")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.json", help="also write all results there")
    words = list(sys.argv[1:] if arguments is None else arguments)
    own = words.index("--") if "--" in words else len(words)
    options, of_fit = parser.parse_args(words[:own]), words[own + 1:]
    rigs = [(family, seed) for family in measure.families_of(parser, options)
            for seed in range(options.seed, options.seed + options.rigs)]
    work: dict[str, Callable] = {"plain": plain, "recovered": recovered, "tracked": tracked, "monitored": monitored}
    tables: dict[str, Callable] = {"plain": plain_table, "recovered": recovered_table, "tracked": tracked_table,
                                   "monitored": monitored_table}
    results: Any
    if options.what in work:
        jobs = [(put, rig) for rig in rigs for put in PUTS] if options.what in ("recovered", "tracked") else rigs
        results = measure.run_all(partial(work[options.what], rate_hz=options.rate, scale=options.scale,
                                          options=of_fit), jobs, options.jobs)
        print(tables[options.what](results))
    elif options.what == "law":
        results = [law(delay_s, of_fit) for delay_s in (0.0, DELAY_S)]
        print(law_table(*results))
    elif options.what == "picma":
        results = picma(of_fit)
        print(picma_table(results))
    else:
        results = cuts(of_fit)
        print(cuts_table(results))
    if options.output:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(measure.json.dumps(results, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
