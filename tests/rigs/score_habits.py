#!/usr/bin/env python3
"""What is a model worth that `rdpi fit` makes of recordings made by habit, whose start nobody knows?

    .venv/bin/python tests/rigs/score_habits.py --quick -o build/habits/before.jsonl
    .venv/bin/python tests/rigs/score_habits.py --processes 2 -o build/habits/after.jsonl
    .venv/bin/python tests/rigs/score_habits.py --habits edge,days --families duhem --seeds 1-8 -o build/habits/a.jsonl
    .venv/bin/python tests/rigs/score_habits.py --compare build/habits/before.jsonl build/habits/after.jsonl
    .venv/bin/python tests/rigs/score_habits.py --table build/habits/after.jsonl

A set is what one person has of one rig (habits.py): two to four recordings of unknown memory. Of each set come three
models:

auto    `rdpi.fit` with what stands around the operator, as people call it;
alone   the operator alone, effects "none";
stated  as auto, and each recording begins where the rig's sweep ended: it holds the past that the others lack, and its
        memory is known. It also holds what that past shows, which is a move or two and a rest.

Each predicts three drives that it has not seen: two by the same habit, whose memory is unknown as well (known to
"stated"), and a multisine after a decaying sweep. Errors are against the true displacement, not the reading; the mean
of each drive's error is removed; rms over all three, each drive counts alike, in % of the rig's stroke.

worse      sets whose "auto" is worse than "alone" by more than 5 % and 0.02 % of the stroke
est/stated auto over stated: median and worst
swept      median of auto over the drives after a sweep alone: what the model misses where its start is known
refused    sets of which no model came, by auto / alone / stated; the words stand below
Medians are of the sets that all variants answered, so they compare the same sets.

Results are lines of JSON, one per set and variant; a run that was stopped goes on where it was. Lines are taken up by a
digest of what makes the set and of the code of rdpi, without comments: after a change of rdpi give another file, and
compare the two. `--compare` pairs lines whose recordings are the same to the last bit.

`--quick` takes every family thrice and every habit three or four times, 24 sets. `--except FAMILY` and `--families
FAMILY` leave families out in turn, as README.md says; `--sealed` scores the sealed family alone, once per issue.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import re
import sys
import time
import traceback
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parent))

import measure  # noqa: E402  before NumPy: it says how many threads
import numpy as np  # noqa: E402
from habits import HABITS, Habitual, Take, make_set  # noqa: E402
from rigs import FAMILIES  # noqa: E402

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PLAYED_BY = tuple(HERE / f"{name}.py" for name in ("habits", "loops", "rigs", "sealed", "waves"))
VARIANTS = {"auto": ("auto", False), "alone": ("none", False), "stated": ("auto", True)}  # effects, start known
QUICK_HABITS = 3  # of each family
WORSE, WORSE_PERCENT = 1.05, 0.02  # of the stroke
SHOWN = 12  # lines of a list
Line = dict[str, Any]


class Job(NamedTuple):
    habit: str
    family: str
    seed: int

    def __str__(self) -> str:
        return f"{self.habit} {self.family} {self.seed}"


# --- one set ---------------------------------------------------------------------------------------------------------

def answers(job: Job, variants: Sequence[str]) -> list[Line]:
    """What rdpi makes of a set, one line per variant."""
    one = make_set(*job)
    return [{"habit": job.habit, "family": job.family, "seed": job.seed, "variant": variant, "data": data_digest(one),
             **answer(one, variant)} for variant in variants]


def answer(one: Habitual, variant: str) -> Line:
    """Error of one model in % of the stroke, pooled and per drive; or the words with which it was refused."""
    import rdpi

    effects, known = VARIANTS[variant]
    begin, found = time.process_time(), {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = rdpi.fit([recording(take, known) for take in one.fitted], effects=effects,
                             min_V=one.rig.low_V, max_V=one.rig.high_V)
            found["seconds"] = time.process_time() - begin
            found["effects"] = [effect["name"] for effect in model.parameters.effects]
            found["drives"] = {take.name: missed(model, take, known, one.rig.stroke_um) for take in one.unseen}
        found["percent"] = float(np.sqrt(np.mean(np.square([*found["drives"].values()]))))
    except rdpi.BadInput as refusal:
        found["refused"] = str(refusal)
    except Exception:  # a crash is a result too
        found["refused"] = "crashed: " + traceback.format_exc(limit=-2)
    return found


def recording(take: Take, known: bool) -> Any:
    """As rdpi takes it: from the first recorded sample on, or, where the start shall be known, from the sweep on."""
    import rdpi

    first = 0 if known else take.before
    command_V, reading_um = take.played_V[first:], take.read_um[first:]
    run = rdpi.Recording.from_arrays(np.arange(len(command_V)) / take.rate_hz, command_V, reading_um,
                                     memory="unknown" if first else "reset" if known else take.memory)
    return replace(run, path=take.name)


def missed(model: Any, take: Take, known: bool, stroke_um: float) -> float:
    """rms error over the recorded part against the truth, its mean removed, in % of the stroke."""
    predicted_um = model.predict(recording(take, known))[-len(take.true_um):]
    return 100 * measure.spread(predicted_um - take.true_um) / stroke_um


# --- what makes a result ---------------------------------------------------------------------------------------------

def data_digest(one: Habitual) -> str:
    """Of all recordings of a set, to the last bit."""
    sha = hashlib.sha256()
    for take in (*one.fitted, *one.unseen):
        sha.update(f"{take.name} {take.rate_hz} {take.before}".encode())
        for values in (take.played_V, take.read_um, take.passed_um):
            sha.update(np.ascontiguousarray(values).tobytes())
    return sha.hexdigest()[:16]


@cache
def code_digest(paths: tuple[Path, ...]) -> str:
    """Of sources; those in Python without comments and docstrings."""
    sha = hashlib.sha256()
    for path in paths:
        sha.update(path.name.encode())
        if path.suffix != ".py":
            sha.update(path.read_bytes())
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(getattr(node, "body", None), list):
                node.body = [one for one in node.body
                             if not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))]
        sha.update(ast.dump(tree).encode())
    return sha.hexdigest()[:16]


def tool_digest() -> str:
    """Of rdpi: the package, and the library that it calls."""
    return code_digest((*sorted((ROOT / "host_tools" / "rdpi").rglob("*.py")), *sorted((ROOT / "lib").rglob("*.[ch]"))))


def key_of(job: Job, variant: str) -> str:
    """Digest of what makes a line: the set's names, the sources that play it, and how it is asked."""
    return hashlib.sha256(f"{code_digest(PLAYED_BY)} {job} {variant} {VARIANTS[variant]}".encode()).hexdigest()[:16]


def read_lines(path: Path) -> list[Line]:
    """The lines of a result file, of each set and variant the last. One that was cut off is none."""
    found = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        found[line["habit"], line["family"], line["seed"], line["variant"]] = line
    return list(found.values())


# --- all sets --------------------------------------------------------------------------------------------------------

def run(jobs: Sequence[Job], variants: Sequence[str], processes: int, path: Path) -> list[Line]:
    """The lines of these sets: what the file holds, and what is asked now, which goes to the file as it comes."""
    code = tool_digest()
    lines = {line["key"]: line for line in read_lines(path)}
    if other := sum(line["code"] != code for line in lines.values()):
        raise SystemExit(f"{path}: {other} lines come of other code of rdpi; give another file, and --compare the two")
    waiting = [(job, [one for one in variants if key_of(job, one) not in lines]) for job in jobs]
    waiting = [(job, missing) for job, missing in waiting if missing]
    path.parent.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    with open(path, "a", encoding="utf-8") as file:
        if file.tell() and not path.read_bytes().endswith(b"\n"):
            file.write("\n")
        for done, (job, found) in enumerate(as_they_come(waiting, processes), 1):
            for line in found:
                line = {"key": key_of(job, line["variant"]), "code": code, **line}
                lines[line["key"]] = line
                file.write(json.dumps(line) + "\n")
            file.flush()
            if sys.stderr.isatty():
                left_s = (time.perf_counter() - begin) / done * (len(waiting) - done)
                print(f"\r{done} of {len(waiting)}, {left_s:.0f} s left ", end="", file=sys.stderr, flush=True)
    return [lines[key] for job in jobs for one in variants if (key := key_of(job, one)) in lines]


def as_they_come(waiting: Sequence[tuple[Job, list[str]]], processes: int) -> Iterator[tuple[Job, list[Line]]]:
    if processes == 1:
        yield from ((job, answers(job, variants)) for job, variants in waiting)
        return
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        futures = {pool.submit(answers, job, variants): job for job, variants in waiting}
        for future in as_completed(futures):
            yield futures[future], future.result()


def quick(families: Sequence[str], habits: Sequence[str], seed: int) -> list[Job]:
    """Each family with some habits, others for each family, so that every habit has its turn."""
    return [Job(habit, family, seed) for k, family in enumerate(FAMILIES) if family in families
            for j in range(QUICK_HABITS) if (habit := [*HABITS][(QUICK_HABITS * k + j) % len(HABITS)]) in habits]


# --- tables ----------------------------------------------------------------------------------------------------------

def sets_of(lines: Sequence[Line]) -> dict[Job, dict[str, Line]]:
    """Lines by set, then by variant."""
    found: dict[Job, dict[str, Line]] = defaultdict(dict)
    for line in lines:
        found[Job(line["habit"], line["family"], line["seed"])][line["variant"]] = line
    return found


Sets = dict[Job, dict[str, Line]]


def answered(sets: Sets, *variants: str) -> list[list[float]]:
    """Errors by these variants, of the sets that all of them answered."""
    return [[one[variant]["percent"] for variant in variants] for one in sets.values()
            if all("percent" in one.get(variant, {}) for variant in variants)]


def is_worse(error: float, than: float) -> bool:
    return error > WORSE * than + WORSE_PERCENT


def median(values: Sequence[float], form: str = "8.2f") -> str:
    return f"{np.median(values):{form}}" if len(values) else f"{'-':>{form.partition('.')[0]}}"


def row(label: str, sets: Sets, variants: Sequence[str]) -> str:
    errors = np.reshape(answered(sets, *variants), (-1, len(variants)))
    cells = [median(column) for column in errors.T]
    both = answered(sets, "auto", "alone")
    worse = sum(is_worse(*pair) for pair in both)
    cells.append(f"{f'{worse}/{len(both)}':>9}{100 * worse / max(len(both), 1):6.1f} %")
    ratio = [auto / stated for auto, stated in answered(sets, "auto", "stated")]
    cells.append(median(ratio) + (f"{max(ratio):7.2f}" if ratio else f"{'-':>7}"))
    swept = [error for one in sets.values() for name, error in one.get("auto", {}).get("drives", {}).items()
             if name.endswith("swept") and "percent" in one["auto"]]
    cells.append(median(swept))
    cells.append("   " + " / ".join(str(sum("refused" in one.get(variant, {}) for one in sets.values()))
                                    for variant in variants))
    return f"{label:26}{len(sets):4}" + "".join(cells)


def header(variants: Sequence[str]) -> str:
    return (f"{'':26}{'median error, % of stroke':>{4 + 8 * len(variants)}}  worse than alone      est/stated\n"
            f"{'':26}sets" + "".join(f"{one:>8}" for one in variants)
            + f"{'sets':>9}{'share':>8}{'median':>8}{'worst':>7}{'swept':>8}   refused: {' / '.join(variants)}")


def table(lines: Sequence[Line]) -> str:
    if not lines:
        return "no set was asked"
    sets = sets_of(lines)
    variants = [one for one in VARIANTS if any(one in found for found in sets.values())]
    rows = [header(variants)]
    for part in (lambda job: job.habit, lambda job: job.family):
        rows += [row(name, some, variants) for name, some in grouped(sets, part)] + [""]
    rows += [row("all", sets, variants), *sizes(sets), *worst_of(sets), *refusals(lines)]
    return "\n".join(rows)


def grouped(sets: Sets, part: Callable[[Job], str]) -> list[tuple[str, Sets]]:
    found: dict[str, Sets] = defaultdict(dict)
    for job, one in sets.items():
        found[part(job)][job] = one
    order = [*HABITS, *FAMILIES]
    return sorted(found.items(), key=lambda item: order.index(item[0]) if item[0] in order else len(order))


def sizes(sets: Sets) -> list[str]:
    """Time, and what auto keeps."""
    autos = [one["auto"] for one in sets.values() if "seconds" in one.get("auto", {})]
    if not autos:
        return []
    seconds = [one["seconds"] for one in autos]
    named = defaultdict(int)
    for name in (name for one in autos for name in one["effects"]):
        named[name] += 1
    names = ", ".join(f"{name} {count}" for name, count in sorted(named.items()))
    return ["", f"auto took {np.median(seconds):.1f} s of processor in the median, {np.max(seconds):.1f} s at most; "
                f"it named {names or 'nothing'}"]


def worst_of(sets: Sets) -> list[str]:
    """The sets that auto spoils most, and those that the estimate of the start spoils most."""
    found = []
    for than, title in (("alone", "auto worse than alone"), ("stated", "auto worse than twice stated")):
        limit = is_worse if than == "alone" else (lambda error, other: error > 2 * other)
        both = [(job, one["auto"], one[than]) for job, one in sets.items()
                if "percent" in one.get("auto", {}) and "percent" in one.get(than, {})]
        pairs = [(auto["percent"], other["percent"], job, auto["effects"]) for job, auto, other in both]
        worse = sorted((pair for pair in pairs if limit(*pair[:2])), key=lambda pair: pair[1] / pair[0])
        if worse:
            found += ["", f"{title}, {len(worse)} sets, the worst:"]
            found += [f"  {job}: {error:.2f} for {other:.2f} % ({', '.join(effects) or 'no effects'})"
                      for error, other, job, effects in worse[:SHOWN]]
    return found


def refusals(lines: Sequence[Line]) -> list[str]:
    """Words of refusals, those that differ in names and numbers alone together."""
    found: dict[str, list[Line]] = defaultdict(list)
    for line in lines:
        if "refused" in line:
            found[re.sub(r"^[^:]* Hz: |[-+]?\d[\d.e+-]*", "…", line["refused"])].append(line)
    rows = [""] if found else []
    for some in sorted(found.values(), key=len, reverse=True):
        names = [f"{Job(one['habit'], one['family'], one['seed'])} {one['variant']}" for one in some]
        rows.append(f"refused {len(some)} times: {some[0]['refused'].strip()}\n  {', '.join(names[:SHOWN])}"
                    + (" …" if len(names) > SHOWN else ""))
    return rows


# --- before and after ------------------------------------------------------------------------------------------------

def compare(before: Sequence[Line], after: Sequence[Line]) -> str:
    """Two results side by side, of the sets that both hold: medians, ratio per set, worse than alone, refused."""
    old, new = sets_of(before), sets_of(after)
    pairs = {job: (old[job], new[job]) for job in old if job in new and data_of(old[job]) == data_of(new[job])}
    rows = [f"{len(pairs)} sets in both; {len(old) - len(pairs)} only before, {len(new) - len(pairs)} only after, "
            "or made of other recordings"]
    variants = [one for one in VARIANTS if any(one in a and one in b for a, b in pairs.values())]
    for variant in variants:
        rows += ["", f"{variant:26}sets  before   after  after/before  set by set: median  worse  worse than alone  "
                     "refused"]
        for part in (lambda job: job.habit, lambda job: job.family, lambda job: "all"):
            rows += [compared(name, some, variant) for name, some in grouped(pairs, part)]
        rows += changes(pairs, variant)
    for k, name in enumerate(("before", "after")):
        ratio = [auto / stated for auto, stated in answered(side(pairs, k), "auto", "stated")]
        if ratio:
            rows += ["", f"est/stated {name}: {len(ratio)} sets, median {np.median(ratio):.2f}, worst {max(ratio):.2f}"]
    return "\n".join(rows)


Pairs = dict[Job, tuple[dict[str, Line], dict[str, Line]]]


def side(pairs: Pairs, k: int) -> Sets:
    return {job: pair[k] for job, pair in pairs.items()}


def data_of(one: dict[str, Line]) -> str:
    return next(iter(one.values()))["data"]


def compared(label: str, pairs: Pairs, variant: str) -> str:
    some = [(a[variant], b[variant]) for a, b in pairs.values() if variant in a and variant in b]
    both = np.reshape([(a["percent"], b["percent"]) for a, b in some if "percent" in a and "percent" in b], (-1, 2))
    ratio = both[:, 1] / both[:, 0]
    spoiled = [sum(is_worse(*pair) for pair in answered(side(pairs, k), variant, "alone")) for k in (0, 1)]
    refused = [sum("refused" in pair[k] for pair in some) for k in (0, 1)]
    whole = f"{np.median(both[:, 1]) / np.median(both[:, 0]):14.2f}" if len(both) else f"{'-':>14}"
    return (f"{label:26}{len(both):4}{median(both[:, 0])}{median(both[:, 1])}{whole}{median(ratio, '20.2f')}"
            f"{sum(is_worse(b, a) for a, b in both):7}{f'{spoiled[0]} -> {spoiled[1]}':>18}"
            f"{f'{refused[0]} -> {refused[1]}':>9}")


def changes(pairs: Pairs, variant: str) -> list[str]:
    """The sets that became worse, most of all first, and those that are refused now."""
    rows, found = [], []
    for job, (a, b) in pairs.items():
        if variant in a and variant in b and "percent" in a[variant]:
            if "percent" not in b[variant]:
                rows.append(f"  refused now: {job}: {b[variant]['refused'].strip()}")
            elif is_worse(b[variant]["percent"], a[variant]["percent"]):
                found.append((b[variant]["percent"], a[variant]["percent"], job))
    found.sort(key=lambda one: one[1] / one[0])
    return rows + [f"  worse now: {job}: {old:.2f} -> {new:.2f} %" for new, old, job in found[:SHOWN]]


# --- the command -----------------------------------------------------------------------------------------------------

def seeds_of(text: str) -> list[int]:
    """ "1-4,7" """
    found: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        found += range(int(first), int(last or first) + 1)
    return found


def jobs_of(options: argparse.Namespace, families: Sequence[str]) -> list[Job]:
    habits = options.habits.split(",")
    if wrong := set(habits) - set(HABITS):
        raise SystemExit(f"no habit {', '.join(sorted(wrong))}: {', '.join(HABITS)}")
    if options.quick and not options.sealed:
        return [job for seed in options.seeds[:1] for job in quick(families, habits, seed)]
    seeds = options.seeds[:1] if options.quick else options.seeds
    return [Job(habit, family, seed) for seed in seeds for family in families for habit in habits]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds_of, default=[1, 2, 3, 4], metavar="1-4,7", help="default 1-4: 224 sets")
    measure.add_families(parser)
    parser.add_argument("--habits", default=",".join(HABITS), help="names, commas between (default: all)")
    parser.add_argument("--variants", default=",".join(VARIANTS), help="commas between (default: all)")
    parser.add_argument("--quick", action="store_true", help="24 sets of the first seed")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.jsonl", help="where results are, and go on to be")
    parser.add_argument("--table", type=Path, metavar="FILE.jsonl", help="print the table of a result file only")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE", "AFTER"),
                        help="print two result files side by side only")
    options = parser.parse_args(arguments)
    if options.compare or options.table:
        for path in options.compare or [options.table]:
            if not path.exists():
                parser.error(f"{path}: is not there")
        print(compare(*map(read_lines, options.compare)) if options.compare else table(read_lines(options.table)))
        return 0
    if options.output is None:
        parser.error("-o FILE.jsonl: say where the results go")
    variants = options.variants.split(",")
    if wrong := set(variants) - set(VARIANTS):
        parser.error(f"no variant {', '.join(sorted(wrong))}: {', '.join(VARIANTS)}")
    jobs = jobs_of(options, measure.families_of(parser, options))
    print(table(run(jobs, variants, options.processes, options.output)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
