#!/usr/bin/env python3
"""An effect appears on a rig after commissioning: does `rdpi gap` name it, and is its improved model worth having?

    .venv/bin/python tests/rigs/appears.py --rigs 2 --jobs 2 -o build/appears
    .venv/bin/python tests/rigs/appears.py --families duhem --effects none,delay -- --earlier

Each rig is commissioned with `rdpi fit`. Then each effect of APPEARS, one after the other, appears on it. `rdpi gap`
sees three field recordings, one of them of unknown memory in a third of the cases, and writes an improved model. Both
models predict NEW recordings, other waveforms after a sweep, as `rdpi simulate` does: the zero included.

* rho: rms of what the effect changes, means removed, over what the model missed before. Names count from rho 1 on.
  Of a pair it is that of both together; a row tells those of which each has as much by itself.
* right: the first name is the effect's; in set: it or one of its rivals is; misnamed: a name, and none of them is.
* worse: new recordings, each by itself, that the improved model predicts worse than the old one by more than 2 % of the
  old error, the zero included; and by how much at worst.
* promise: promised - realised shrink, means removed: median of its size. "same": of fresh recordings of the kinds that
  `rdpi gap` saw; "holds": how often its 90 % interval holds that; "other": of the new recordings, other waveforms.

Under the table stand the rows of targets that the tool is to reach: singles are one effect of APPEARS of rho 1 or more,
and "all" are these. A track alone: one of the references, predicted with the zero included, by more than 5 % worse.
A fresh recording is one of the kinds that `rdpi gap` saw, with other random numbers: its frequency may be three times
as high, which changes what a delay brings. Beside the promise for these stands that for the same drives once more.
An effect may hide what the model missed all along; then the right one makes a prediction worse. The row below leaves
these out: they were predicted as badly before the effect.
`--poor` shows a tracked profile and a sine only, `--fine` movements of a tenth of the range only, `--one` a single
recording. `--nones` lets nothing happen several times, with other drives.
`--follow` plays the recording that an "ambiguous" verdict proposes, on the rig as it is then, from any past, and asks
again with it beside the first ones; so many times. Settled: the first name is right and has no rival left.

The zero moves with the effects "zero" and "delay, zero" only. Thresholds that are chosen on all families but one are
scored on that one: `--except`, `--families`, as in README.md. What stands after `--` goes to `rdpi gap`; `--earlier`
there needs no path: the field recordings are made before the effect as well.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shlex
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import measure  # noqa: E402  before NumPy: it says how many threads
import numpy as np  # noqa: E402
import waves  # noqa: E402
from rigs import Rig, make_rig, record  # noqa: E402

SEEN = "decay", "moves", "biased"
POOR = "5-20-35hz", "10hz"
NEW = "two_sines", *waves.TRACKS
WORSE = 1.02  # of the old error
NAMEABLE = 1.0  # rho
FRESH, OTHER = 500_000, 1_000  # added to the seed of drives
MUCH_WORSE = 1.05  # of the old error
Appears = Callable[[Rig, np.random.Generator], Rig]


def more(sin: str, parameter: str, low: float, high: float) -> Appears:
    """A parameter of a sin grows by something between low and high; a rig without the sin gets it."""
    def change(rig: Rig, random: np.random.Generator) -> Rig:
        had = rig.sins.get(sin)
        values = had or {**rig.put(sin).sins[sin], parameter: 0.0}
        return rig.put(sin, **{**values, parameter: values[parameter] + random.uniform(low, high)})
    return change


def times(sin: str, parameter: str, low: float, high: float) -> Appears:
    """A parameter of a sin is so many times what it was."""
    return lambda rig, random: rig.put(sin, **{**rig.sins[sin],
                                               parameter: rig.sins[sin][parameter] * random.uniform(low, high)})


def scaled(name: str, *ranges: tuple[float, float]) -> Appears:
    """A number of the rig is so many times what it was, from one of the ranges."""
    return lambda rig, random: replace(rig, **{name: getattr(rig, name)
                                               * random.uniform(*ranges[random.integers(len(ranges))])})


def zero(rig: Rig, random: np.random.Generator) -> Rig:
    moved = random.choice([-1, 1]) * random.uniform(0.02, 0.06) * rig.stroke_um
    return replace(rig, offset_um=rig.offset_um + moved)


def curve(rig: Rig, random: np.random.Generator) -> Rig:
    return replace(rig, curve=(rig.curve[0] + random.choice([-1, 1]) * random.uniform(0.02, 0.06), rig.curve[1]))


DELAY = more("delay", "delay_s", 3e-4, 2e-3)
# Names that are right, and what happens.
APPEARS: dict[str, tuple[tuple[str, ...], Appears]] = {
    "none": ((), lambda rig, random: replace(rig)),
    "zero": ((), zero),
    "delay": (("delay",), DELAY),
    "delay, zero": (("delay",), lambda rig, random: zero(DELAY(rig, random), random)),
    "lag": (("lag",), more("lag", "time_constant_s", 5e-4, 3e-3)),
    "relaxation": (("relaxation",), more("relaxation", "share", 0.04, 0.12)),
    "creep": (("creep",), more("creep", "percent_per_decade", 2.0, 6.0)),
    "resonance": (("resonance",), times("resonance", "f0_hz", 0.3, 0.6)),
    "rate": (("rate_dependence",), more("rate", "growth", 0.3, 1.0)),
    "loop": (("hysteresis_change",), scaled("width", (0.5, 0.75), (1.3, 1.8))),
    "gain": (("gain_change",), scaled("stroke_um", (0.9, 0.97), (1.03, 1.1))),
    "curve": (("static_nonlinearity", "input_curve"), curve),
}
# What rdpi has no name for; beside it names that are as right as its catalogue allows.
STRANGERS: dict[str, tuple[str, ...]] = {
    "leakage": ("creep", "thermal_drift", "relaxation"), "settling": ("creep", "relaxation"),
    "second_resonance": ("resonance",), "softening": ("gain_change", "rate_dependence", "thermal_drift"),
    "stick_slip": (), "dropouts": (),
}
APPEARS |= {name: (twins, lambda rig, random, name=name: rig.put(name)) for name, twins in STRANGERS.items()}
PAIRS = {f"{one}, {other}": (one, other) for one, other in (
    ("delay", "gain"), ("lag", "creep"), ("loop", "delay"), ("creep", "gain"), ("rate", "lag"), ("curve", "relaxation"))}
APPEARS |= {name: (sum((APPEARS[part][0] for part in parts), ()), lambda rig, random, name=name: after_each(
    rig, name, random)[-1]) for name, parts in PAIRS.items()}


def after_each(rig: Rig, name: str, random: np.random.Generator) -> list[Rig]:
    """The rig after each effect of a pair in turn, or after the one."""
    found = [rig]
    for part in PAIRS.get(name, (name,)):
        found.append(APPEARS[part][1](found[-1], random))
    return found[1:]


def play(rig: Rig, folder: Path, kind: str, names: Sequence[str], starts: Sequence[str], rate_hz: float, scale: float,
         seed: int | None = None) -> tuple[list[Path], list[np.ndarray]]:
    """Recordings of these drives, and their readings; like measure.drive, tracks about the middle of the range."""
    paths, readings = [], []
    for name, start in zip(names, starts):
        share = 0.5 + measure.TRACKED * waves.track(name, rate_hz, 2 * scale) if name in waves.TRACKS else \
            waves.drive(name, rate_hz, rig.seed if seed is None else seed, rig.start_share, scale)
        paths.append(folder / f"{kind}-{name}.csv")
        readings.append(record(rig, paths[-1], rig.volts(share), rate_hz, start))
    return paths, readings


def missed(model: Path, runs: Sequence[Path]) -> list[dict[str, float]]:
    """What `rdpi simulate` says of each recording: rms_um with the zero, offset_um."""
    measure.rdpi("simulate", model, *runs, "--json", model.with_suffix(".score"))
    return json.loads(model.with_suffix(".score").read_text())["runs"]


def spread(run: dict[str, float]) -> float:
    """rms of an error without its mean."""
    return float(np.sqrt(max(0.0, run["rms_um"] ** 2 - run["offset_um"] ** 2)))


def pooled(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def shrink(old: Sequence[dict[str, float]], new: Sequence[dict[str, float]]) -> float:
    """Of errors without their means."""
    return 1 - pooled([*map(spread, new)]) / pooled([*map(spread, old)])


def cases(job: tuple[str, int], effects: Sequence[str], rate_hz: float, scale: float, options: Sequence[str],
          chain: str = "auto", shown: Sequence[str] = SEEN, nones: int = 1, follow: int = 0, excite_s: float = 0.0
          ) -> list[dict[str, Any]]:
    """One rig, commissioned once, and each effect that appears on it; `chain`: option --effects of `rdpi fit`;
    `follow`: proposed recordings to play; `excite_s`: of the only commissioning recording.
    """
    family, seed = job
    rig, found = make_rig(family, seed), []
    with tempfile.TemporaryDirectory(prefix="rigs-") as where:
        folder = Path(where)
        try:
            model = measure.commission(rig, folder, rate_hz, scale, ["--effects", chain], excite_s)
        except measure.Refused as refusal:
            return [{"family": family, "seed": seed, "effect": "all", "failed": str(refusal)}]
        offsets = [run["offset_um"] for run in json.loads(model.read_text())["passport"]["runs"]]
        for name, again in ((name, k) for name in effects for k in range(nones if name == "none" else 1)):
            random = np.random.default_rng([seed, len(family), list(APPEARS).index(name), *[again] * bool(again)])
            case = {"family": family, "seed": seed, "effect": name, "stroke_um": rig.stroke_um,
                    "commissioned_um": offsets}
            try:
                found.append(case | ask(rig, after_each(rig, name, random), folder, model, random, rate_hz, scale,
                                        options, shown, seed + OTHER * again, follow))
            except measure.Refused as refusal:
                found.append(case | {"failed": str(refusal)})
    return found


def ask(before: Rig, changed: Sequence[Rig], folder: Path, model: Path, random: np.random.Generator, rate_hz: float,
        scale: float, options: Sequence[str], shown: Sequence[str] = SEEN, seed: int | None = None, follow: int = 0
        ) -> dict[str, Any]:
    """What `rdpi gap` says of the rig as it is after the effect appeared, or the last of several, and what both models
    miss of it.
    """
    after = changed[-1]
    seed, starts = before.seed if seed is None else seed, ["swept"] * len(shown)
    if random.random() < 1 / 3:
        starts[random.integers(len(shown))] = "unknown"
    then, was = play(replace(before, runs=0), folder, "earlier", shown, starts, rate_hz, scale, seed)
    between = [play(replace(rig, runs=0), folder, "seen", shown, starts, rate_hz, scale, seed) for rig in changed]
    seen, now = between[-1]
    fresh, unchanged, repeated = (
        play(replace(rig, runs=6), folder, kind, shown, starts, rate_hz, scale, seed + further)[0]
        for kind, rig, further in (("fresh", after, FRESH), ("unchanged", before, FRESH), ("repeated", after, 0)))
    new, _ = play(replace(after, runs=9), folder, "new", NEW, ["swept"] * len(NEW), rate_hz, scale)
    if "--earlier" in options:  # other noise than those after the effect
        then, _ = play(replace(before, runs=12), folder, "then", shown, starts, rate_hz, scale, seed)
    words = [part for word in options for part in (sum((["--earlier", path] for path in then), [])
                                                   if word == "--earlier" else [word])]
    improved, document = folder / "improved.json", folder / "gap.json"
    measure.rdpi("gap", model, *seen, "-o", improved, "--json", document, *words)
    gap = json.loads(document.read_text())
    floor = pooled([spread(run) for run in missed(model, then)])

    def rho(one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> float:
        return pooled([np.std(b - a) for a, b in zip(one, other)]) / floor

    in_turn = pairwise([was, *(readings for _, readings in between)])
    old, better = missed(model, new), missed(improved, new)
    same, same_better, usual = missed(model, fresh), missed(improved, fresh), missed(model, unchanged)
    once, once_better = missed(model, repeated), missed(improved, repeated)
    return {**said(gap), "then": followed(after, folder, model, seen, gap, rate_hz, follow),
            "paired": gap["paired"], "detection": gap["detection"], "ratio": gap["passport"]["ratio"],
            "left": gap["passport"]["ratio"] * gap["gap"]["remaining_um"] / gap["gap"]["rms_um"],
            "rho": rho(was, now), "least_rho": min(rho(*pair) for pair in in_turn), "promised": gap["promised"]["shrink"],
            "ci90": gap["promised"]["ci90"],
            "fresh": [spread(b) / spread(a) for a, b in zip(same, same_better)],
            "beyond_usual": [spread(b) / max(spread(a), spread(c)) for a, b, c in zip(same, same_better, usual)],
            "same": shrink(same, same_better), "repeated": shrink(once, once_better), "realised": shrink(old, better),
            "zero": gap["offset_um"], "seen_um": [run["offset_um"] for run in missed(model, seen)],
            "seen_after_um": [run["offset_um"] for run in missed(improved, seen)],
            "old": [[run["rms_um"], run["offset_um"]] for run in old],
            "new": [[run["rms_um"], run["offset_um"]] for run in better]}


def said(gap: dict[str, Any]) -> dict[str, Any]:
    """The verdict, the names, the rivals of the first of them, and those of the others."""
    rivals = [one["confusable_with"] for one in gap["effects"]]
    return {"verdict": gap["verdict"], "names": [one["name"] for one in gap["effects"]],
            "rivals": rivals[0] if rivals else [], "rivals_of_others": sum(rivals[1:], [])}


def followed(rig: Rig, folder: Path, model: Path, seen: Sequence[Path], gap: dict[str, Any], rate_hz: float, most: int
             ) -> list[dict[str, Any]]:
    """What was proposed, and what `rdpi gap` says with that beside all before, as long as its verdict is "ambiguous"."""
    runs, found, document = [*seen], [], folder / "then.json"
    while gap["verdict"] == "ambiguous" and len(found) < most:
        if not gap["next_experiment"]:
            return [*found, {"command": None, "verdict": "nothing proposed", "names": [], "rivals": []}]
        _, *words = shlex.split(gap["next_experiment"]["command"])
        with contextlib.chdir(folder):
            measure.rdpi(*words)
        drive_V = measure.columns_of(folder / words[words.index("-o") + 1])["command_V"]
        runs.append(folder / f"proposed-{len(found)}.csv")
        record(replace(rig, runs=20 + len(found)), runs[-1], drive_V, rate_hz, "unknown")
        measure.rdpi("gap", model, *runs, "--json", document)
        gap = json.loads(document.read_text())
        found.append({"command": " ".join(words), **said(gap)})
    return found


# --- tables ----------------------------------------------------------------------------------------------------------

def right(case: dict[str, Any]) -> bool:
    return bool(case["names"]) and case["names"][0] in APPEARS[case["effect"]][0]


def in_set(case: dict[str, Any]) -> bool:
    return bool(case["names"]) and bool({case["names"][0], *case["rivals"]} & set(APPEARS[case["effect"]][0]))


def settled(case: dict[str, Any], times: int) -> bool:
    """Whether so many proposed recordings, or fewer, told which effect it is."""
    return any(right(case | then) and not then["rivals"] for then in case["then"][:times])


def again(case: dict[str, Any]) -> bool:
    """Whether a recording was proposed that had been given already."""
    commands = [then["command"] for then in case["then"]]
    return len(set(commands)) < len(commands)


def worse(case: dict[str, Any]) -> list[float]:
    """Error with the improved model over that with the old one, of each new recording."""
    return [after[0] / before[0] for before, after in zip(case["old"], case["new"])]


HEADER = (f"{'':26}cases  rho>=1  right  in set  misnamed  unknown   none | worse  at worst  together | "
          "promise: same  holds  other")


def row(label: str, found: Sequence[dict[str, Any]]) -> str:
    """Shares of cases of rho 1 or more, of new recordings, and the promise."""
    done = [case for case in found if "failed" not in case]
    if not done:
        return f"{label:26}{0:5}"
    loud = [case for case in done if case["rho"] >= NAMEABLE or not APPEARS[case["effect"]][0]]

    def share(hit: Callable[[dict[str, Any]], bool]) -> str:
        return f"{sum(map(hit, loud)) / len(loud):.2f}" if loud else "-"

    ratios = [ratio for case in done for ratio in worse(case)]
    together = [pooled([a[0] for a in case["new"]]) / pooled([a[0] for a in case["old"]]) for case in done]
    named = [case for case in done if case["names"]]
    same, other = ([abs(case["promised"] - case[what]) for case in named] for what in ("same", "realised"))
    holds = [case["ci90"][0] <= case["same"] <= case["ci90"][1] for case in named if case["ci90"]]

    def mean(values: Sequence[float], of: Callable[[Sequence[float]], float], digits: int) -> str:
        return f"{of(values):.{digits}f}" if values else "-"

    return (f"{label:26}{len(done):5}{len(loud):8}{share(right):>7}{share(in_set):>8}"
            f"{share(lambda case: bool(case['names']) and not in_set(case)):>10}"
            f"{share(lambda case: case['verdict'] == 'unknown'):>9}{share(lambda case: case['verdict'] == 'none'):>7} |"
            f"{np.mean(np.greater(ratios, WORSE)):6.2f}{max(ratios):10.2f}"
            f"{np.mean(np.greater(together, WORSE)):10.2f} |"
            f"{mean(same, np.median, 3):>14}{mean(holds, np.mean, 2):>7}{mean(other, np.median, 3):>7}")


def area(louder: Sequence[float], quiet: Sequence[float]) -> float:
    """Under the curve of hits over false alarms: how often one of the first is larger than one of the others."""
    return float(np.mean(np.greater.outer(louder, quiet) + 0.5 * np.equal.outer(louder, quiet)))


def targets(found: Sequence[dict[str, Any]]) -> list[str]:
    """The rows that the tool is to reach, each with its target and what it is counted on."""
    done = [case for case in found if "failed" not in case]
    nones = [case for case in done if case["effect"] == "none"]
    single = [case for case in done if APPEARS[case["effect"]][0] and case["effect"] not in PAIRS | STRANGERS]
    loud = [case for case in single if case["rho"] >= NAMEABLE]
    named, strange = [case for case in loud if case["names"]], [case for case in done if case["effect"] in STRANGERS
                                                               and case["rho"] >= NAMEABLE]
    pairs = [case for case in done if case["effect"] in PAIRS and case["rho"] >= NAMEABLE]
    improved = [case for case in done if case["names"]]
    open_ = [case for case in loud if case["then"]]

    def both(case: dict[str, Any]) -> bool:
        said = {*case["names"], *case["rivals"], *case["rivals_of_others"]}
        return all(said & set(APPEARS[part][0]) for part in PAIRS[case["effect"]])

    def share(label: str, aim: str, of: Sequence[dict[str, Any]], hit: Callable[[dict[str, Any]], bool]) -> str:
        return f"{label:64}{f'{sum(map(hit, of)) / len(of):.3f}' if of else '-':>8}{len(of):7}   {aim}"

    def detected(low: float, high: float, aim: str) -> str:
        some = [case["detection"] for case in single if low <= case["rho"] < high]
        value = f"{area(some, [case['detection'] for case in nones]):.3f}" if some and nones else "-"
        return f"{f'detected, area under the curve, rho {low:g} to {high:g}':64}{value:>8}{len(some):7}   {aim}"

    def missed_by(label: str, aim: str, what: str) -> str:
        misses = [abs(case["promised"] - case[what]) for case in all_counted]
        return f"{label:64}{f'{np.median(misses):.3f}' if misses else '-':>8}{len(misses):7}   {aim}"

    all_counted = [case for case in improved if not case["paired"]]  # beside earlier recordings the change is promised
    tracks = [case | {"ratio": ratio} for case in done for ratio in worse(case)[1:]]
    return [f"{'':64}{'':>8}  cases   target",
            share("right first name, of those named", ">= .90 (.95 with --earlier)", named, right),
            share("right name in the set, of those named", ">= .95", named, in_set),
            share("wrong name outside the set, of all", "<= .05", loud,
                  lambda case: bool(case["names"]) and not in_set(case)),
            share("named, of all", "", loud, lambda case: bool(case["names"])),
            share("false alarms where nothing appeared", "<= .03", nones, lambda case: case["verdict"] != "none"),
            share("  of them with a name", "", nones, lambda case: bool(case["names"])),
            share("not in the catalogue: unknown, or a twin", ">= .85", strange,
                  lambda case: case["verdict"] == "unknown" or in_set(case)),
            share("not in the catalogue: misnamed", "<= .08", strange,
                  lambda case: bool(case["names"]) and not in_set(case)),
            missed_by("promise less realised, same kinds, median", "<= .03", "same"),
            share("  its 90 % interval holds it", ".85 to .95", [case for case in all_counted if case["ci90"]],
                  lambda case: case["ci90"][0] <= case["same"] <= case["ci90"][1]),
            missed_by("  of the same drives, played once more", "", "repeated"),
            share("a fresh recording predicted worse by 5 %, offset removed", "0", done,
                  lambda case: max(case["fresh"]) > MUCH_WORSE),
            share("  and than the old model predicted the rig before", "", done,
                  lambda case: max(case["beyond_usual"]) > MUCH_WORSE),
            share("a track alone predicted worse by 5 %, zero included", "<= .03", tracks,
                  lambda case: case["ratio"] > MUCH_WORSE),
            detected(1, 3, ">= .97"), detected(3, np.inf, ">= .995"),
            share("pairs: first name right", ">= .92", pairs, right),
            share("pairs: both in names and rivals", ">= .75", pairs, both),
            share("  of those of which each has rho 1 or more", "",
                  [case for case in pairs if case["least_rho"] >= NAMEABLE], both),
            share("ambiguous: the proposed recording settles it", ">= .85", open_, lambda case: settled(case, 1)),
            share("  as many as were followed do", "", open_, lambda case: settled(case, len(case["then"]))),
            share("  one is proposed again", "0", open_, again)]


def table(found: Sequence[dict[str, Any]]) -> str:
    """Per effect and per family; under them the targets, and what was said of each effect."""
    lines = [HEADER]
    for key in ("effect", "family"):
        for value in dict.fromkeys(case[key] for case in found):
            lines.append(row(value, [case for case in found if case[key] == value]))
        lines.append("")
    effects = [case for case in found if "failed" not in case and APPEARS[case["effect"]][0]]
    lines += [row("all with an effect", effects), row("all", found), "", *targets(found), ""]
    for value in dict.fromkeys(case["effect"] for case in found):
        said = [" + ".join(["|".join([case["names"][0], *case["rivals"]]), *case["names"][1:]]) if case["names"] else
                case["verdict"] for case in found if case["effect"] == value and "failed" not in case]
        lines.append(f"{value}: " + ", ".join(f"{name} {said.count(name)}" for name in dict.fromkeys(said)))
    return "\n".join(lines + [f"failed: {case['family']} {case['seed']}, {case['effect']}: {case['failed']}"
                              for case in found if "failed" in case])


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=1, help="per family (default 1)")
    parser.add_argument("--seed", type=int, default=1, help="of the first rig (default 1)")
    measure.add_families(parser)
    parser.add_argument("--effects", default=";".join(APPEARS), help="of APPEARS, semicolons between (default: all)")
    parser.add_argument("--chain", choices=["auto", "none"], default="auto",
                        help="effects that `rdpi fit` looks for; none: the model lacks the chain from the first day")
    parser.add_argument("--nones", type=int, default=1, help="cases per rig in which nothing appears (default 1)")
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--poor", dest="shown", action="store_const", const=POOR, default=SEEN,
                       help="`rdpi gap` sees a tracked profile and a sine only")
    shown.add_argument("--fine", dest="shown", action="store_const", const=tuple(waves.FINE),
                       help="`rdpi gap` sees movements of a tenth of the range only")
    shown.add_argument("--one", choices=waves.FIELD, help="`rdpi gap` sees one recording only, of this field waveform")
    parser.add_argument("--follow", type=int, default=0, metavar="N", help="proposed recordings to play (default 0)")
    parser.add_argument("--excite", type=float, default=0.0, metavar="S",
                        help="commission with one recording of `rdpi excite commission`, so long")
    parser.add_argument("--rate", type=float, default=5000.0, help="samples per second (default 5000)")
    parser.add_argument("--scale", type=float, default=0.5, help="length of the recordings (default 0.5)")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="write appears.json there")
    parser.add_argument("options", nargs="*", metavar="-- OPTION", help="options of rdpi gap")
    options = parser.parse_args(arguments)
    families, effects = measure.families_of(parser, options), options.effects.split(";")
    if wrong := set(effects) - set(APPEARS):
        parser.error(f"no effect {', '.join(sorted(wrong))}: {'; '.join(APPEARS)}")
    jobs = [(family, seed) for family in families for seed in range(options.seed, options.seed + options.rigs)]
    work = partial(cases, effects=effects, rate_hz=options.rate, scale=options.scale, options=options.options,
                   chain=options.chain, shown=(options.one,) if options.one else options.shown, nones=options.nones,
                   follow=options.follow, excite_s=options.excite)
    found = sum(measure.run_all(work, jobs, options.jobs), [])
    print(table(found))
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "appears.json").write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
