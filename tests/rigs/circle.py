#!/usr/bin/env python3
"""The whole circle, labels sealed: how much better does a rig track after `rdpi gap` and `rdpi header`?

    .venv/bin/python tests/rigs/circle.py --cases 300 --seed 7 -o build/circle
    .venv/bin/python tests/rigs/circle.py --table build/circle

Each rig is commissioned with `rdpi fit`. Then one effect of APPEARS, several, or none appears on it; so it does four
times, each time on the rig as it was commissioned.

1. `rdpi gap` sees four field recordings, in half of the cases beside --earlier ones of the same drives, and the
   references that are to be tracked. It writes an improved model.
2. `rdpi header` makes the firmware's parameters of it.
3. The library, f32, runs its start-up sweep and tracks the references, with the old and with the improved model.
4. Both models predict recordings of waveforms that nobody has seen.

What appeared stands in DIR/sealed.jsonl. Nothing but the table opens that file. DIR/cases.jsonl holds what was said and
measured. A run that was cut off goes on where it ended.

* promise: promised - realised shrink, of cases with an improved model; means removed. median: of its size. inside:
  share of 90 % intervals that hold what was realised. Beside --earlier recordings no promise is made for the prediction
  of all that the model misses.
* harm: cases whose error with the improved model, the zero included, exceeds that with the old one by more than 2 %; of
  all new recordings together, of all references together, and of every one of them by itself ("each"). at worst: the
  largest ratio of errors of a case.
* shrink: realised, of tracking, the zero included, median.

The recordings and the tracks begin after a rest in the middle of the range. "any rest" tracks again after the rig has
rested for very long at a random place: creep holds a share of that place for hours, and no model can know it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import measure  # noqa: E402  before NumPy: it says how many threads
import numpy as np  # noqa: E402
import waves  # noqa: E402
from appears import APPEARS, PAIRS, WORSE, play, pooled, spread  # noqa: E402
from rigs import FAMILIES, Rig, make_rig, write_recording  # noqa: E402

SEEN = "decay", "moves", "biased", "two_sines"
NEW = "wander", *waves.TRACKS
NONE, ZERO, SEVERAL = 0.12, 0.06, 0.22  # shares of cases: nothing appears, the zero moves, two or three effects at once
ALONE = [name for name, (right, _) in APPEARS.items() if right and name not in PAIRS]
TOGETHER = [name for name in ALONE if "," not in name]
CASES_A_RIG = 4
APPROACH_S, SETTLED_S, TRACKED_S = 0.2, 0.4, 1.4
Record = dict[str, Any]


# --- one rig ---------------------------------------------------------------------------------------------------------

def draw(random: np.random.Generator) -> list[str]:
    """What appears in one case: names of APPEARS."""
    kind = random.random()
    if kind < NONE:
        return []
    if kind < NONE + ZERO:
        return ["zero"]
    if kind < NONE + ZERO + SEVERAL:
        return [str(name) for name in random.permutation(TOGETHER)[:random.integers(2, 4)]]
    return [ALONE[random.integers(len(ALONE))]]


def cases(job: int, seed: int, rate_hz: float, scale: float, models: Path) -> tuple[list[Record], list[Record]]:
    """The cases of one rig: what is sealed, and what was said and measured. Commissioned models are kept."""
    random = np.random.default_rng([seed, job])
    family = [*FAMILIES][(job + seed) % len(FAMILIES)]
    rig = make_rig(family, int(random.integers(1, 2**31)))
    sealed, said = [], []
    with tempfile.TemporaryDirectory(prefix="rigs-") as where:
        folder, model, refusal = Path(where), models / f"{job}.json", ""
        try:
            if not model.exists():
                model.write_text(measure.commission(rig, folder, rate_hz, scale, []).read_text())
        except measure.Refused as error:
            refusal = str(error)
        for k in range(CASES_A_RIG):
            names, after = draw(random), replace(rig)
            for name in names:
                after = APPEARS[name][1](after, random)
            case = CASES_A_RIG * job + k
            sealed.append({"case": case, "family": family, "effects": names, "before": rig.truth, "after": after.truth,
                           "offset_um": after.offset_um - rig.offset_um})
            try:
                if refusal:
                    raise measure.Refused(refusal)
                said.append({"case": case} | one_case(rig, after, folder, model, random, rate_hz, scale))
            except measure.Refused as error:
                said.append({"case": case, "failed": str(error)})
    return sealed, said


def one_case(before: Rig, after: Rig, folder: Path, model: Path, random: np.random.Generator, rate_hz: float,
             scale: float) -> Record:
    """What `rdpi gap` says of the rig as it is now, and what comes of it."""
    starts, paired = ["swept"] * len(SEEN), bool(random.random() < 0.5)
    if random.random() < 1 / 4:
        starts[random.integers(len(SEEN))] = "unknown"
    then = play(replace(before, runs=40), folder, "earlier", SEEN, starts, rate_hz, scale)[0] if paired else []
    seen, _ = play(replace(after, runs=0), folder, "seen", SEEN, starts, rate_hz, scale)
    references = {name: reference(before, model, name, rate_hz) for name in waves.TRACKS}
    improved, document = folder / "improved.json", folder / "gap.json"
    words = [part for path in then for part in ("--earlier", path)]
    for name, wanted_um in references.items():
        write_recording(folder / f"wanted-{name}.csv", before, rate_hz, "swept", {"reference_um": wanted_um})
        words += ["--reference", folder / f"wanted-{name}.csv"]
    measure.rdpi("gap", model, *seen, "-o", improved, "--json", document, *words)
    measure.rdpi("header", improved, "-o", folder / "rdpi_params.h")
    new, _ = play(replace(after, runs=9), folder, "new", NEW, ["swept"] * len(NEW), rate_hz, scale)
    gap = json.loads(document.read_text())
    first, (given, made) = gap["effects"][:1], (json.loads(path.read_text())["effects"] for path in (model, improved))
    return {"paired": paired, "stroke_um": before.stroke_um, "verdict": gap["verdict"],
            "names": [one["name"] for one in gap["effects"]], "rivals": first[0]["confusable_with"] if first else [],
            "improved": made != given,
            "ratio": (gap["passport"] or {}).get("ratio"), "promised": gap["promised"], "zero": gap["offset_um"],
            "prediction": {key: [[run["rms_um"], run["offset_um"]] for run in missed(path, new, folder)]
                           for key, path in (("old", model), ("new", improved))},
            **{kind: {key: [track(after, path, wanted_um, rate_hz, start) for wanted_um in references.values()]
                      for key, path in (("old", model), ("new", improved))}
               for kind, start in (("tracking", "rested"), ("any rest", "unknown"))}}


def missed(model: Path, runs: Sequence[Path], folder: Path) -> list[Record]:
    """What `rdpi simulate` says of each recording: rms_um with the zero, offset_um."""
    measure.rdpi("simulate", model, *runs, "--json", folder / "score.json")
    return json.loads((folder / "score.json").read_text())["runs"]


def reference(rig: Rig, model: Path, name: str, rate_hz: float) -> np.ndarray:
    """One of TRACKS in um: from where the start-up sweep of the commissioned model ends."""
    wanted_um = rig.offset_um + rig.stroke_um * (0.5 + measure.TRACKED * waves.track(name, rate_hz, TRACKED_S))
    _, library = firmware_of(model, rate_hz)
    sweep_V, _ = library.sweep()
    start_um = float(library.predict(sweep_V[-1:], np.zeros(1))[0])
    left = 1 - np.arange(round(APPROACH_S * rate_hz)) / (APPROACH_S * rate_hz)
    return np.concatenate([wanted_um[0] + (start_um - wanted_um[0]) * left**2 * (3 - 2 * left), wanted_um])


def firmware_of(path: Path, rate_hz: float) -> tuple[Any, Any]:
    """What is inverted of a model, and the library that does it."""
    from rdpi import firmware
    from rdpi.model import read_model
    from rdpi.simulate import inverse_of

    by = inverse_of(read_model(path))
    return by, firmware.engine(by.model, 1 / rate_hz, "f32", by.chain if by.chain.acts else None)


def track(rig: Rig, path: Path, wanted_um: np.ndarray, rate_hz: float, start: str) -> list[float]:
    """rms in um of what the rig misses of a reference behind its firmware, the zero included, and the mean."""
    from rdpi import firmware

    by, library = firmware_of(path, rate_hz)
    sweep_V, _ = library.sweep()
    asked_um = wanted_um + by.jump.added_um(wanted_um, 1 / rate_hz)
    drive_V = library.step(firmware.ahead(asked_um, library.preview_samples)).drive_V
    reading = replace(rig, runs=20).run(np.concatenate([sweep_V, drive_V]), rate_hz, start)[len(sweep_V):]
    error = (reading - wanted_um)[round(SETTLED_S * rate_hz):]
    return [float(np.sqrt(np.mean(error**2))), float(np.mean(error))]


# --- tables ----------------------------------------------------------------------------------------------------------

KINDS = "prediction", "tracking", "any rest"


def errors(case: Record, kind: str, which: str, zero: bool) -> list[float]:
    """rms in um of each new recording, or each reference; which: old or new."""
    return [rms_um if zero else spread({"rms_um": rms_um, "offset_um": mean_um})
            for rms_um, mean_um in case[kind][which]]


def realised(case: Record, kind: str, zero: bool = False) -> float:
    """Shrink of all together."""
    return 1 - pooled(errors(case, kind, "new", zero)) / pooled(errors(case, kind, "old", zero))


def each(case: Record, kind: str) -> list[float]:
    """Error with the improved model over that with the old one, the zero included, of each by itself."""
    return [new / old for old, new in zip(errors(case, kind, "old", True), errors(case, kind, "new", True))]


def promised(case: Record, kind: str) -> Record | None:
    """Shrink and its 90 % interval as `rdpi gap` promises them; None: it promises nothing, or beside --earlier
    recordings the shrink of the change, and not that of all that the model misses.
    """
    if kind != "prediction":
        return case["promised"].get("tracking")
    return case["promised"] if case["improved"] and not case["paired"] else None


def row(label: str, found: Sequence[Record]) -> str:
    """Promise, harm and shrink of these cases."""
    cells = [f"{label:28}{len(found):5}"]
    for kind in KINDS:
        pairs = [(promise, realised(case, kind)) for case in found if (promise := promised(case, kind))]
        off = [abs(promise["shrink"] - value) for promise, value in pairs]
        inside = [promise["ci90"][0] <= value <= promise["ci90"][1] for promise, value in pairs if promise["ci90"]]
        together = [1 - realised(case, kind, zero=True) for case in found]
        singles = [max(each(case, kind)) for case in found]
        cells.append(f" |{len(pairs):5}" + (f"{np.median(off):8.3f}" if off else f"{'-':>8}")
                     + (f"{np.mean(inside):8.2f}" if inside else f"{'-':>8}")
                     + f"{sum(np.greater(together, WORSE)):6}{sum(np.greater(singles, WORSE)):6}{max(singles):10.2f}")
    changed = [realised(case, "tracking", zero=True) for case in found]
    return "".join(cells) + f" |{np.median(changed):8.2f}"


def table(found: Sequence[Record], sealed: Sequence[Record]) -> str:
    """The two rows asked for first, then every effect, family, and what was said of each effect."""
    labels = {one["case"]: one for one in sealed}
    found = [{**labels[case["case"]], **case} for case in sorted(found, key=lambda case: case["case"])]
    done = [case for case in found if "failed" not in case]
    title = f"{'n':>5}  median  inside  harm  each  at worst"
    lines = [f"{'':28}cases" + f" |{title}" * len(KINDS) + " |  shrink",
             f"{'':33}" + "".join(f" | {kind:{len(title) - 1}}" for kind in KINDS)]
    if not done:
        return "\n".join(lines[:1])
    groups: list[tuple[str, Callable[[Record], bool]]] = [
        ("something appears", lambda case: case["effects"] not in ([], ["zero"])),
        ("nothing, or the zero moves", lambda case: case["effects"] in ([], ["zero"])),
        ("several at once", lambda case: len(case["effects"]) > 1),
        ("with --earlier", lambda case: case["paired"]), ("without", lambda case: not case["paired"])]
    said: dict[str, list[str]] = {}
    for case in done:
        name = " + ".join(sorted(case["effects"])) if len(case["effects"]) < 2 else "several"
        said.setdefault(name or "none", []).append(
            " + ".join(["|".join([case["names"][0], *case["rivals"]]), *case["names"][1:]]) if case["names"] else
            case["verdict"])
    lines.append(row("all", done))
    lines += [row(label, part) for label, hit in groups if (part := [case for case in done if hit(case)])]
    lines += ["", *(row(name, [case for case in done if case["effects"] == ([] if name == "none" else [name])])
                    for name in APPEARS if name in said)]
    lines += ["", *(row(name, [case for case in done if case["family"] == name])
                    for name in FAMILIES if any(case["family"] == name for case in done)), ""]
    lines += [f"{name}: " + ", ".join(f"{word} {words.count(word)}" for word in dict.fromkeys(words))
              for name, words in said.items()]
    return "\n".join(lines + [f"failed: {case['case']}, {case['family']}: {case['failed']}" for case in found
                              if "failed" in case])


# --- command ---------------------------------------------------------------------------------------------------------

def read_lines(path: Path) -> list[Record]:
    """The records of a file; a last line that was cut off is none."""
    lines = path.read_text().splitlines(keepends=True) if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith("\n")]


def run(work: Callable[[int], Any], jobs: Sequence[int], processes: int) -> Iterator[Any]:
    """What is made of each job, as soon as it is done."""
    if processes == 1:
        yield from map(work, jobs)
        return
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        for future in as_completed([pool.submit(work, job) for job in jobs]):
            yield future.result()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=96, help="default 96; four on each rig")
    parser.add_argument("--seed", type=int, default=1, help="of everything that is drawn (default 1)")
    parser.add_argument("--rate", type=float, default=5000.0, help="samples per second (default 5000)")
    parser.add_argument("--scale", type=float, default=0.4, help="length of the recordings (default 0.4)")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--models", type=Path, metavar="DIR", help="take commissioned models, and leave new ones, "
                        "there; only for another run of the same seed, rate and scale (default: OUTPUT/models)")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="cases.jsonl and sealed.jsonl go there")
    parser.add_argument("--table", type=Path, metavar="DIR", help="only print the table of an earlier run")
    options = parser.parse_args(arguments)
    if options.table:
        print(table(read_lines(options.table / "cases.jsonl"), read_lines(options.table / "sealed.jsonl")))
        return 0
    if not options.output:
        parser.error("say with -o where the results go, or with --table where they are")
    settings = {"seed": options.seed, "rate_hz": options.rate, "scale": options.scale}
    options.output.mkdir(parents=True, exist_ok=True)
    files = [options.output / name for name in ("sealed.jsonl", "cases.jsonl")]
    kept = options.output / "settings.json"
    if kept.exists() and json.loads(kept.read_text()) != settings:
        parser.error(f"{options.output} holds cases of other settings: {kept.read_text().strip()}")
    kept.write_text(json.dumps(settings) + "\n")
    for path in files:  # without what was cut off
        path.write_text("".join(json.dumps(one) + "\n" for one in read_lines(path)))
    there = {one["case"] // CASES_A_RIG for one in read_lines(files[1])}
    jobs = [job for job in range(-(-options.cases // CASES_A_RIG)) if job not in there]
    models = options.models or options.output / "models"
    models.mkdir(parents=True, exist_ok=True)
    for made in run(partial(cases, **settings, models=models), jobs, options.jobs):
        for path, records in zip(files, made):
            with open(path, "a", encoding="utf-8") as file:
                file.write("".join(json.dumps(one) + "\n" for one in records))
    print(table(read_lines(files[1]), read_lines(files[0])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
