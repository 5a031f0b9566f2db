#!/usr/bin/env python3
"""Does `rdpi gap` find what is really wrong? Asked on virtual actuators that share no code with rdpi.

    .venv/bin/python tests/withheld/check.py --cases 600 --seed 1 --jobs 2 -o build/withheld
    .venv/bin/python tests/withheld/check.py --withhold all --cases 160 -o build/withheld-one-out

1. Generate. Machines of actuators.py are recorded and identified with `rdpi fit`; then they are recorded again, under
   random names, with other waveforms and fresh noise, with or without an effect in them: one of sixteen that the
   tool knows, one that it does not, two at once, or none; at severities from 0.3 to 10 times what the model misses
   anyway; on rich recordings and on poor ones (a tracking profile and a sine); with the amplifier's monitor and
   without. Mostly the effect appears after the model was identified; where it is "born in", it was there before. What
   is in which goes to one file, labels.sealed.
2. Diagnose. `rdpi gap` sees model and recordings; what it promises is tried with `rdpi simulate` on as many more
   recordings of the same kinds, which it does not see. Stopped and started again, this goes on where it was.
3. Score. Only now are the labels read, after their digest has been compared. Printed: the table of the design with 95 %
   intervals (Wilson's for shares, bootstrap else), rows per effect and severity, the confusion matrix; all of it in
   results.json and confusion.png.

With `--paired`, every drive is recorded before the effect is put in as well, for `rdpi gap --earlier`, and effects are
smaller; what is promised is not tried.

`--set tune` and `--set report` differ in seeds, kinds of loops, ranges of parameters, sampling rates and waveforms:
thresholds may be tuned on the one, figures are told from the other. `--set measured` judges one half of the measured
record by the other instead, see measured.py. With `--withhold NAME`, or each in turn with `all`, the data hold exactly
the effect that the tool is denied (`rdpi gap --without NAME`): right is then "unknown".

Terms: an effect counts as to be detected from rho 1, to be named from rho 2. A name is wrong if it is none of the
case's and its set of rivals holds none of them. Cases whose residual grew by less than 10 % do not count: "born in",
the fit took the effect up; else it hides in what the model misses anyway. "First two" and "first three" are of a
ranking: accepted effects, then the first one's rivals, then the other candidates by their shrink. What an effect
outside the catalogue looks like by construction is its twin (TWINS in score.py); a twin's name counts neither for nor
against.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # --jobs says how many cores are used
    os.environ.setdefault(variable, "1")
sys.path.insert(0, str(Path(__file__).parent))

import measured  # noqa: E402
import score  # noqa: E402
from actuators import FORMS, IN_CATALOGUE  # noqa: E402
from cases import Case, generate, plan, rdpi, read_labels, write_labels  # noqa: E402

SEEDS = {"tune": 0, "report": 1_000_000}  # added to --seed


def diagnose(case: Path) -> None:
    """Write verdict.json into a case's folder, from what stands in its task and recordings."""
    task = json.loads((case / "task.json").read_text())
    model, improved, gap = (case / task["model"]).resolve(), case / "improved.json", case / "gap.json"
    without = [word for name in task["without"] for word in ("--without", name)]
    earlier = [word for path in sorted(case.glob("earlier-*.csv")) for word in ("--earlier", str(path))]
    later = [str(path) for path in sorted(case.glob("later-*.csv"))]
    for old in (improved, gap):
        old.unlink(missing_ok=True)
    begin = time.perf_counter()
    verdict: dict[str, Any] = {}
    try:
        verdict["failed"] = rdpi("gap", str(model), *map(str, sorted(case.glob("run-*.csv"))), "-o", str(improved),
                                 "--json", str(gap), *without, *earlier)
    except Exception:  # a crash is a result too
        verdict["failed"] = traceback.format_exc(limit=-3)
    verdict["seconds"] = time.perf_counter() - begin
    if gap.exists():
        found = json.loads(gap.read_text())
        # the bins of every axis are most of the file, and no one scores them
        verdict["gap"] = {**found, "where": {key: found["where"].get(key) for key in ("stage", "dominant")}}
        for key, path in (("before_um", model), ("after_um", improved)):
            if later and path.exists():
                verdict[key] = error_um(path, later)
    partial_path = case / "verdict.part"
    partial_path.write_text(json.dumps(verdict))
    partial_path.replace(case / "verdict.json")


def error_um(model: Path, runs: list[str]) -> float | None:
    """Rms over all samples, each run's mean removed; None if the model cannot be simulated."""
    scores = model.with_suffix(".score")
    try:
        if rdpi("simulate", str(model), *runs, "--remove-offset", "--json", str(scores)):
            return None
    except Exception:  # a crash: no shrink arrives
        return None
    found = [run["rms_um"] for run in json.loads(scores.read_text())["runs"]]
    lines = [Path(run).read_text().count("\n") for run in runs]
    return (sum(n * rms**2 for n, rms in zip(lines, found)) / sum(lines)) ** 0.5


def each(jobs: int, what: str, function: Callable[[Any], Any], items: list[Any]) -> Iterable[Any]:
    """Results as they come, with a line of progress on a terminal."""
    begin = time.perf_counter()
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        for done, future in enumerate(as_completed([pool.submit(function, item) for item in items]), 1):
            yield future.result()
            if sys.stderr.isatty():
                left = (time.perf_counter() - begin) / done * (len(items) - done)
                print(f"\r{what}: {done} of {len(items)}, {left:.0f} s left ", end="", file=sys.stderr, flush=True)
    if sys.stderr.isatty():
        print(file=sys.stderr)


def prepare(folder: Path, settings: dict[str, Any], jobs: int) -> str:
    """Generate the set unless it is there; returns the digest of the sealed labels."""
    note = folder / "set.json"
    if note.exists():
        known = json.loads(note.read_text())
        digest = known.pop("labels")
        if known != settings:
            raise SystemExit(f"{folder}: holds another set ({known}); give another folder")
        return digest
    if folder.exists() and any(folder.iterdir()):
        raise SystemExit(f"{folder}: holds something else, or a set whose generation was stopped; empty it, or give "
                         "another folder")
    if settings["set"] == "measured":
        labels = measured.generate(folder, settings["seed"])
    else:
        seed = settings["seed"] + SEEDS[settings["set"]]
        by_machine: dict[int, list[Case]] = {}
        for case in plan(settings["cases"], seed, settings["withhold"], settings["paired"]):
            by_machine.setdefault(case.machine, []).append(case)
        make = partial(generate, folder, settings["set"], seed, settings["paired"])
        labels = [case for cases in each(jobs, "generating, machines", make, list(by_machine.values()))
                  for case in cases]
    digest = write_labels(folder / "labels.sealed", labels)
    note.write_text(json.dumps({**settings, "labels": digest}))
    return digest


def run(folder: Path, settings: dict[str, Any], jobs: int, again: bool = False) -> list[score.Judged]:
    """Generate, diagnose what has no verdict yet (or all, again), and only then open the labels."""
    folder.mkdir(parents=True, exist_ok=True)
    digest = prepare(folder, settings, jobs)
    if again:
        for old in folder.glob("cases/*/verdict.json"):
            old.unlink()
    waiting = [path.parent for path in sorted(folder.glob("cases/*/task.json"))
               if not (path.parent / "verdict.json").exists()]
    for _ in each(jobs, "diagnosing, cases", diagnose, waiting):
        pass
    labels = read_labels(folder / "labels.sealed", digest)
    return [score.judge(case, json.loads((folder / "cases" / case.ident / "verdict.json").read_text()))
            for case in labels]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=600, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--set", choices=[*FORMS, "measured"], default="report",
                        help="default: %(default)s")
    parser.add_argument("--withhold", choices=[*IN_CATALOGUE, "all"], metavar="NAME",
                        help="deny the tool this effect and present exactly that; all: each in turn")
    parser.add_argument("--paired", action="store_true",
                        help="record every drive before the effect as well, for `rdpi gap --earlier`")
    parser.add_argument("--jobs", type=int, default=2, help="processes; default: %(default)s")
    parser.add_argument("--again", action="store_true", help="diagnose anew what has a verdict; recordings stay")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    given = parser.parse_args()
    if (given.withhold or given.paired) and given.set == "measured":
        parser.error("--withhold, --paired: take the sets of virtual actuators")
    settings = {"cases": given.cases, "seed": given.seed, "set": given.set, "withhold": given.withhold,
                "paired": given.paired}
    judged = run(given.output, settings, given.jobs, given.again)
    rows = score.figures(judged)
    matrix = score.confusion(judged)
    print(score.table(rows), score.per_effect(judged), score.matrix_text(*matrix), sep="\n\n")
    score.draw_matrix(given.output / "confusion.png", *matrix)
    (given.output / "results.json").write_text(json.dumps(score.results(judged, rows), indent=1))


if __name__ == "__main__":
    main()
