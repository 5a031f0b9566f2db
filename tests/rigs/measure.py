#!/usr/bin/env python3
"""How well does `rdpi fit` know rigs that it was not tuned on, and what do their ordinary sins cost?

    .venv/bin/python tests/rigs/measure.py --rigs 2
    .venv/bin/python tests/rigs/measure.py --rigs 5 --put threes --except duhem -o build/rigs -- --rate-independent

Each rig is commissioned twice: as it is, and without the sins that have a memory in time (CHAIN in rigs.py). Each time
`rdpi fit` identifies a model from the commissioning recordings, and the same rig plays what the model has not seen:

* prediction: field waveforms, mean error of each run removed, rms in % of the rig's stroke;
* position: mean error after a sweep that ended in the middle, at a tenth and at the edge of the range, in % of stroke;
* tracking: drives of `rdpi compensate --engine f64` for references over 60 % of the stroke, mean error removed, rms in
  % of the reference.

The table gives medians per family. The ratio compares a rig with itself without the sins. If models hold effects, the
script compares their parameters with the rig's.

`--leave-one-out` prints, per family, the figures of that family beside those of all others. For a score on left-out
families, choose thresholds with `--except FAMILY`, run with `--families FAMILY`, and do so for each family in turn.
`--sealed` measures the sealed family alone (README.md). What stands after `--` goes to `rdpi fit`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from io import StringIO
from multiprocessing import get_context
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # --jobs says how many cores are used
    os.environ.setdefault(variable, "1")
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np  # noqa: E402
import waves  # noqa: E402
from rigs import CHAIN, FAMILIES, SEALED, SINS, Rig, make_rig, record, write_recording  # noqa: E402

PLACES = {"middle": 0.5, "tenth": 0.1, "edge": 0.0}  # shares of the range where sweeps end
TRACKED = 0.6  # of the stroke
SETTLED_S = 0.3
TRACK_S = 1.6
# Sizes of sins that are put in: low, high, and whether evenly in the logarithm.
PUT: dict[str, dict[str, tuple[float, float, bool]]] = {
    "delay": {"delay_s": (1e-4, 2e-3, True)},
    "lag": {"time_constant_s": (1e-4, 2e-3, True)},
    "relaxation": {"share": (0.02, 0.08, False), "time_constant_s": (3e-4, 2e-2, True)},
    "creep": {"percent_per_decade": (1.0, 4.0, False)},
    "resonance": {"f0_hz": (150, 900, True)},
}


def choose(family: str, seed: int, put: str) -> Rig:
    """The rig with its ordinary sins, or with one or three of PUT in place of those with a memory in time."""
    rig = make_rig(family, seed)
    if put == "ordinary":
        return rig
    rig = rig.without(*CHAIN, "hold")  # a staircase hides parts of a delay
    random = np.random.default_rng([seed, len(family)])
    names = [[*PUT][seed % len(PUT)]] if put == "alone" else random.permutation([*PUT])[:3]
    for name in names:
        sizes = {}
        for parameter, (low, high, even) in PUT[name].items():
            sizes[parameter] = float(low * (high / low) ** random.random() if even else random.uniform(low, high))
        rig = rig.put(name, **sizes)
    return rig


class Refused(Exception):
    """rdpi ended with another status than 0."""


def rdpi(*arguments: object) -> None:
    """Run a command of rdpi in this process and drop what it prints."""
    from rdpi import cli

    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as errors:
        status = cli.main([str(argument) for argument in arguments], standalone_mode=False)
    if status:
        raise Refused(f"rdpi {arguments[0]}: exit status {status}: {errors.getvalue().strip()}")


def columns_of(path: Path) -> dict[str, np.ndarray]:
    with open(path, encoding="utf-8") as file:
        while (line := file.readline()).startswith("#"):
            pass
        return dict(zip(line.strip().split(","), np.loadtxt(file, delimiter=",", ndmin=2).T))


def spread(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean((error - np.mean(error)) ** 2)))


def drive(rig: Rig, name: str, rate_hz: float, scale: float) -> np.ndarray:
    return waves.drive(name, rate_hz, rig.seed, rig.start_share, scale)


def played(rig: Rig, folder: Path, name: str, share: np.ndarray, rate_hz: float, monitor: bool = False) -> Path:
    record(rig, folder / f"{name}.csv", rig.volts(share), rate_hz, monitor=monitor)
    return folder / f"{name}.csv"


def commission(rig: Rig, folder: Path, rate_hz: float, scale: float, options: Sequence[str], excite_s: float = 0.0,
               monitor: bool = False) -> Path:
    """Play the commissioning drives, or one of `rdpi excite commission`, `excite_s` long, and fit a model to them. With
    `monitor`, the recordings hold monitor_V.
    """
    if excite_s:
        rdpi("excite", "commission", "--min-V", repr(rig.low_V), "--max-V", repr(rig.high_V), "--duration", excite_s,
             "--sample-rate", rate_hz, "--no-sweep", "-o", folder / "drive.csv")
        runs = [folder / "commission.csv"]
        record(rig, runs[0], columns_of(folder / "drive.csv")["command_V"], rate_hz, monitor=monitor)
    else:
        runs = [played(rig, folder, name, drive(rig, name, rate_hz, scale), rate_hz, monitor) for name in waves.COMMISSION]
    rdpi("fit", *runs, "-o", folder / "model.json", "--min-V", repr(rig.low_V), "--max-V", repr(rig.high_V), *options)
    return folder / "model.json"


def missed(rig: Rig, folder: Path, name: str, share: np.ndarray, rate_hz: float) -> np.ndarray:
    """What the model in the folder misses of a drive, in % of the stroke."""
    rdpi("simulate", folder / "model.json", played(rig, folder, name, share, rate_hz), "-o", folder / "predicted.csv")
    columns = columns_of(folder / "predicted.csv")
    return 100 * (columns["displacement_um"] - columns["predicted_um"]) / rig.stroke_um


def predict(rig: Rig, folder: Path, rate_hz: float, scale: float) -> float:
    """rms error of the field waveforms, mean of each removed, in % of the stroke."""
    errors = [missed(rig, folder, name, drive(rig, name, rate_hz, scale), rate_hz) for name in waves.FIELD]
    return float(np.sqrt(np.mean([spread(one) ** 2 for one in errors])))


def effects_of(model: Path) -> list[dict[str, Any]]:
    return json.loads(model.read_text())["effects"]


def measure(rig: Rig, folder: Path, rate_hz: float, scale: float, options: Sequence[str]) -> dict[str, Any]:
    """Commission, fit, predict, track; figures in %."""
    model = commission(rig, folder, rate_hz, scale, options)
    found: dict[str, Any] = {"effects": effects_of(model), "prediction": predict(rig, folder, rate_hz, scale)}
    t = np.arange(round(0.5 * rate_hz)) / rate_hz
    for name, place in PLACES.items():
        toward = 1.0 if place < 0.5 else -1.0
        small = place + toward * 0.03 * (1 - np.cos(8 * np.pi * t))
        found[name] = float(np.mean(missed(rig, folder, f"from {name}", small, rate_hz)))
    for name in waves.TRACKS:
        found[name] = tracking(rig, folder, model, name, rate_hz)
    return found


def tracking(rig: Rig, folder: Path, model: Path, name: str, rate_hz: float, *options: str) -> float:
    """rms error in % of the reference; `options` are those of `rdpi compensate`."""
    return following(rig, folder, model, waves.track(name, rate_hz, TRACK_S), rate_hz, *options)


def following(rig: Rig, folder: Path, model: Path, share: np.ndarray, rate_hz: float, *options: str) -> float:
    """The same for a reference as a share of what is tracked, about its middle."""
    error = following_error(rig, folder, model, share, rate_hz, *options)
    return spread(error[round(SETTLED_S * rate_hz):])


def following_error(rig: Rig, folder: Path, model: Path, share: np.ndarray, rate_hz: float,
                    *options: str) -> np.ndarray:
    """The error itself, in % of the reference's span once it has settled."""
    reference = rig.offset_um + rig.stroke_um * (0.5 + TRACKED * share)
    write_recording(folder / "reference.csv", rig, rate_hz, "swept", {"reference_um": reference})
    rdpi("compensate", model, folder / "reference.csv", "-o", folder / "drive.csv", *(options or ("--engine", "f64")))
    reading = rig.run(columns_of(folder / "drive.csv")["command_V"], rate_hz)
    return 100 * (reading - reference) / float(np.ptp(reference[round(SETTLED_S * rate_hz):]))


def both(job: tuple[str, int], put: str, rate_hz: float, scale: float, options: Sequence[str]) -> dict[str, Any]:
    """One rig with its sins and without those with a memory in time."""
    rig = choose(*job, put)
    result: dict[str, Any] = {"family": job[0], "seed": job[1], "rate_hz": rate_hz, "truth": rig.truth}
    for name, one in (("sins", rig), ("plain", rig.without(*CHAIN))):
        with tempfile.TemporaryDirectory(prefix="rigs-") as folder:
            try:
                result[name] = measure(one, Path(folder), rate_hz, scale, options)
            except Refused as refusal:
                result["failed"] = f"{name}: {refusal}"
    return result


# --- tables ----------------------------------------------------------------------------------------------------------

def row(label: str, results: Sequence[dict[str, Any]]) -> str:
    """Medians; of the ratio also the worst, of positions the mean and worst absolute error."""
    done = [one for one in results if "failed" not in one]
    if not done:
        return f"{label:28} all {len(results)} failed"

    def figures(variant: str, name: str) -> list[float]:
        return [one[variant][name] for one in done]

    ratio = np.divide(figures("sins", "prediction"), figures("plain", "prediction"))
    cells = [f"{np.median(figures('sins', 'prediction')):7.2f}", f"{np.median(figures('plain', 'prediction')):7.2f}",
             f"{np.median(ratio):6.2f}", f"{np.max(ratio):6.2f}"]
    for place in PLACES:
        missed = np.abs(figures("sins", place))
        cells.append(f"{np.mean(missed):6.2f}/{np.max(missed):5.2f}")
    for track in waves.TRACKS:
        cells.append(f"{np.median(figures('sins', track)):7.2f}/{np.median(figures('plain', track)):5.2f}")
    return f"{label:26}{len(done):3}" + "".join(cells)


HEADER = (f"{'':29}prediction, rms %    ratio     position, mean/worst %               tracking, rms %, sins/plain\n"
          f"{'family':24} rigs   sins  plain median worst"
          + "".join(f"{place:>12}" for place in PLACES) + "".join(f"{track:>13}" for track in waves.TRACKS))


def table(results: Sequence[dict[str, Any]], leave_one_out: bool = False) -> str:
    families = list(dict.fromkeys(one["family"] for one in results))
    lines = [HEADER]
    for family in families:
        lines.append(row(family, [one for one in results if one["family"] == family]))
        if leave_one_out:
            lines.append(row("  all others", [one for one in results if one["family"] != family]))
    lines.append(row("all", results))
    lines += [f"failed: {one['family']} {one['seed']}: {one['failed']}" for one in results if "failed" in one]
    return "\n".join(lines + chain_rows(results))


def chain_rows(results: Sequence[dict[str, Any]]) -> list[str]:
    """Per effect that models hold: rigs that have it and models that name it; per parameter, error and coverage."""
    cases = []  # the sins of one rig, the effects of its model, the sample rate
    for one in results:
        if "failed" not in one:
            plain = {name: values for name, values in one["truth"].items() if name not in CHAIN}
            for truth, variant in ((one["truth"], "sins"), (plain, "plain")):
                cases.append((truth, {effect["name"]: effect for effect in one[variant]["effects"]}, one["rate_hz"]))
    lines = []
    for name in SINS:
        if not any(name in effects for _, effects, _ in cases):
            continue
        have = [(truth[name], effects.get(name)) for truth, effects, _ in cases if name in truth]
        right = [(truth, found) for truth, found in have if found]
        false = [matters(effects[name], rate_hz) for truth, effects, rate_hz in cases
                 if name in effects and name not in truth]
        lines.append(f"{name}: named on {len(right)} of {len(have)} rigs that have it, and on {len(false)} of "
                     f"{len(cases) - len(have)} that do not, {sum(false)} times with a size that matters")
        for parameter in SINS[name](np.random.default_rng(0)):
            pairs = [(truth[parameter], found["parameters"][parameter]) for truth, found in right
                     if parameter in found["parameters"]]
            if pairs:
                off = [abs(stated["value"] - true) / abs(true) for true, stated in pairs]
                inside = [stated["ci95"][0] <= true <= stated["ci95"][1] for true, stated in pairs
                          if stated.get("ci95") and None not in stated["ci95"]]
                lines.append(f"  {parameter}: median error {100 * np.median(off):.0f} %; the 95 % interval holds the "
                             f"true value in {sum(inside)} of {len(inside)}")
    return lines


def matters(effect: dict[str, Any], rate_hz: float) -> bool:
    """Whether a delay or lag exceeds a third of a sample, a relaxation 0.5 % of the movement; others always do."""
    value = {parameter: stated["value"] for parameter, stated in effect["parameters"].items()}
    if effect["name"] in ("delay", "lag"):
        return max(value.values()) > 1 / (3 * rate_hz)
    return effect["name"] != "relaxation" or value["share"] > 0.005


def run_all(work: Callable[[Any], Any], jobs: Sequence[Any], processes: int) -> list[Any]:
    """Each job's result, in order."""
    if processes == 1:
        return list(map(work, jobs))
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        return list(pool.map(work, jobs))


def add_families(parser: argparse.ArgumentParser) -> None:
    """The options that say which families of rigs are measured."""
    parser.add_argument("--families", default=",".join(FAMILIES), help="names, commas between (default: all open ones)")
    parser.add_argument("--except", dest="left_out", default="", metavar="FAMILY", help="leave this family out")
    parser.add_argument("--sealed", action="store_true", help="measure the sealed family, once per issue (README.md)")


def families_of(parser: argparse.ArgumentParser, options: argparse.Namespace) -> list[str]:
    """The families that were asked for; ends the program if there is no such family."""
    if options.sealed:
        return [*SEALED]
    families = options.families.split(",")
    if wrong := {*families, options.left_out or families[0]} - set(FAMILIES):
        parser.error(f"no open family {', '.join(sorted(wrong))}: {', '.join(FAMILIES)}")
    return [one for one in families if one != options.left_out]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=2, help="per family (default 2)")
    parser.add_argument("--seed", type=int, default=1, help="of the first rig (default 1)")
    add_families(parser)
    parser.add_argument("--put", choices=["ordinary", "alone", "threes"], default="ordinary",
                        help="sins that the rig's seed draws, or one or three of delay, lag, relaxation, creep, "
                             "resonance in their place (default ordinary)")
    parser.add_argument("--rate", type=float, default=5000.0, help="samples per second (default 5000)")
    parser.add_argument("--scale", type=float, default=0.5, help="length of the recordings (default 0.5)")
    parser.add_argument("--leave-one-out", action="store_true", help="print each family beside all others")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="write results.json there")
    parser.add_argument("options", nargs="*", metavar="-- OPTION", help="options of rdpi fit")
    options = parser.parse_args(arguments)
    jobs = [(family, seed) for family in families_of(parser, options)
            for seed in range(options.seed, options.seed + options.rigs)]
    results = run_all(partial(both, put=options.put, rate_hz=options.rate, scale=options.scale,
                              options=options.options), jobs, options.jobs)
    print(table(results, options.leave_one_out))
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
