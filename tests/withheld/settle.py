#!/usr/bin/env python3
"""Does the next experiment that `rdpi gap` proposes settle what recordings could not tell?

    .venv/bin/python tests/withheld/settle.py --machines 12 --seed 1 --set report -o build/settle

Machines of actuators.py are identified as in check.py and then recorded with one sine of 1 Hz, or with two sines from
0.8 to 2.5 Hz, and one of the effects that a sine can hardly tell apart, at a severity of 4. Where the verdict of
`rdpi gap` is "ambiguous", the command of its `next_experiment` is run as it stands; the drive that it writes is played
on the same machine with the same effect, from any past (`memory: unknown`), and `rdpi gap` is asked again with that
recording beside the first ones.

Settled means: the first name is the effect's and it has no rival left; what is accepted beside it, with rivals or
without, is counted apart. Left out are cases whose effect stays below a severity of 2 at its largest, or lets the
residual grow by less than 10 %. Printed: the figures with Wilson's 95 % intervals, then a row per case; all of it also
in results.json.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shlex
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import check  # noqa: E402  before NumPy: it sets how many threads that starts
import numpy as np  # noqa: E402
from actuators import FORMS, WAVES, Form, Put, Run, make_run  # noqa: E402
from cases import Bench, rdpi, residual_rms, write  # noqa: E402
from rdpi.data import read_recording  # noqa: E402
from score import GREW, NAMEABLE, wilson  # noqa: E402

HARD_TO_TELL = ("delay", "lag", "resonance", "gain_change", "static_nonlinearity", "hysteresis_change",
                "rate_dependence", "backlash", "creep", "slew_limit")
RHO = 4.0
SETTLED = 0.80  # the share asked for


@dataclass
class Verdict:
    """What `rdpi gap` said: names of the accepted effects, and the rivals of the first."""

    verdict: str
    names: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()

    def __str__(self) -> str:
        first, *further = self.names or (self.verdict,)
        return " + ".join([" | ".join([first, *self.rivals]), *further]) + "?" * (self.verdict == "ambiguous")


@dataclass
class Asked:
    """One case: what is in it, what was said, what was proposed, and what was said then."""

    ident: str
    machine: int
    kind: str  # of the machine's loops
    monitor: bool
    recordings: str
    name: str
    where: str
    size: float
    rho: float
    growth: float
    first: Verdict
    command: str = ""
    then: Verdict | None = None

    @property
    def ambiguous(self) -> bool:
        return self.first.verdict == "ambiguous"

    @property
    def in_set(self) -> bool:
        return self.name in (*self.first.names[:1], *self.first.rivals)

    @property
    def settled(self) -> bool:
        return self.then is not None and self.then.names[:1] == (self.name,) and not self.then.rivals

    @property
    def alone(self) -> bool:
        return self.settled and self.then.names == (self.name,)

    @property
    def right(self) -> bool:
        return self.first.verdict == "effect" and self.first.names[0] == self.name

    @property
    def wrong(self) -> bool:
        return self.first.verdict == "effect" and self.first.names[0] != self.name


def one_hertz(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    """Four periods over most of the range, however fast they are sampled."""
    t = np.arange(int(4 * rate_hz)) / rate_hz
    return 0.5 - random.uniform(0.35, 0.5) * np.cos(2 * np.pi * t)


WAVES["sine of 1 Hz"] = one_hertz
POORLY = {"one sine": ("sine of 1 Hz",), "two sines": ("sine", "sine")}


def gap(folder: Path, model: Path, runs: Sequence[str]) -> dict[str, Any]:
    """The document of `rdpi gap`; a verdict of "failed" where it refuses or crashes."""
    found = folder / f"gap-{len(runs)}.json"
    try:
        failed = rdpi("gap", str(model), *runs, "--json", str(found))
    except Exception:  # a crash is a result too
        failed = traceback.format_exc(limit=-3)
    if failed:
        print(f"{folder}: {failed}", file=sys.stderr)
        return {"verdict": "failed", "effects": []}
    return json.loads(found.read_text())


def verdict(document: dict[str, Any]) -> Verdict:
    effects = document["effects"]
    return Verdict(document["verdict"], tuple(effect["name"] for effect in effects),
                   tuple(effects[0]["confusable_with"]) if effects else ())


def play(bench: Bench, folder: Path, command: str, put: Put) -> str:
    """Run the proposed command as it stands, in the case's folder, and record its drive; returns the recording."""
    program, *words = shlex.split(command)
    with contextlib.chdir(folder):
        if failed := rdpi(*words):
            raise SystemExit(f"{folder}: {command}: {failed}")
        drive = read_recording(words[words.index("-o") + 1], required=("time_s", "command_V"))
    rate_hz = bench.machine.sample_rate_hz
    if program != "rdpi" or drive.sample_rate_hz != rate_hz:
        raise SystemExit(f"{folder}: {command}: not a drive at the machine's {rate_hz:g} Hz")
    anywhere = make_run("sine", bench.machine, bench.form, int(bench.random.integers(2**62)), reset=False)
    still = np.zeros_like(drive.command_V)
    run = replace(anywhere, kind="next", command_V=drive.command_V, other_axis_V=still, cache={})
    return write(folder, "then", bench.recordings([run], [put]))[0]


def ask(bench: Bench, recordings: str, runs: Sequence[Run], name: str) -> Asked:
    """Put the effect in, diagnose, and record what is proposed where the verdict is "ambiguous"."""
    floor_um = residual_rms(bench.model, bench.recordings(runs, ()))
    put, rms_um = bench.sized(name, runs, RHO * floor_um)
    recorded = bench.recordings(runs, [put])
    ident = bench.random.bytes(6).hex()
    folder, model = bench.folder / "cases" / ident, bench.folder / "models" / bench.name / "model.json"
    paths = write(folder, "run", recorded)
    document = gap(folder, model, paths)
    case = Asked(ident, 0, bench.machine.kind, bench.machine.monitor, recordings, name, put.where, put.size,
                 rms_um / floor_um, residual_rms(bench.model, recorded) / floor_um, verdict(document))
    if case.ambiguous and document["next_experiment"]:
        case.command = document["next_experiment"]["command"]
        case.then = verdict(gap(folder, model, [*paths, play(bench, folder, case.command, put)]))
    return case


def ask_machine(folder: Path, form: str, seed: int, names: Sequence[str], index: int) -> list[Asked]:
    """Every effect on every kind of poor recordings of one machine."""
    bench = Bench(folder, FORMS[form], seed, index)
    asked = []
    for recordings, kinds in POORLY.items():
        runs = bench.runs(kinds)
        asked += [replace(ask(bench, recordings, runs, name), machine=index) for name in names]
    return asked


def run(folder: Path, form: str, seed: int, machines: int, jobs: int = 1,
        names: Sequence[str] = HARD_TO_TELL) -> tuple[list[Asked], int]:
    """All cases that count, in the order of machines, and how many were left out."""
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise SystemExit(f"{folder}: holds something; empty it, or give another folder")
    function = partial(ask_machine, folder, form, seed + check.SEEDS[form], names)
    asked = [case for cases in check.each(jobs, "machines", function, list(range(machines))) for case in cases]
    counted = [case for case in asked if case.rho >= NAMEABLE and case.growth >= GREW]
    return sorted(counted, key=lambda case: case.machine), len(asked) - len(counted)


def figures(asked: Sequence[Asked]) -> dict[str, dict[str, float]]:
    """Shares with their intervals, counts beside them; over all cases asked and over the ambiguous ones."""
    ambiguous = [case for case in asked if case.ambiguous]
    told: tuple[tuple[str, Sequence[Asked], Callable[[Asked], bool]], ...] = (
        ("right name without a set", asked, lambda case: case.right),
        ("wrong name without a set", asked, lambda case: case.wrong),
        ("ambiguous", asked, lambda case: case.ambiguous),
        ("  right member in the set", ambiguous, lambda case: case.in_set),
        ("  settled by the next experiment", ambiguous, lambda case: case.settled),
        *((f"    of these with {recordings}", [case for case in ambiguous if case.recordings == recordings],
           lambda case: case.settled) for recordings in POORLY),
        ("    of these nothing named beside it", [case for case in ambiguous if case.settled], lambda case: case.alone))
    rows = {}
    for name, cases, hit in told:
        hits = sum(map(hit, cases))
        share, low, high = wilson(hits, len(cases)) if cases else (np.nan,) * 3
        rows[name] = {"hits": hits, "cases": len(cases), "share": share, "low": low, "high": high}
    return rows


def table(rows: dict[str, dict[str, float]]) -> str:
    lines = [f"{'figure':<36}{'cases':>10}{'share':>8}  95 % interval"]
    for name, row in rows.items():
        count = f"{row['hits']}/{row['cases']}"
        lines.append(f"{name:<36}{count:>10}{row['share']:>8.3f}  {row['low']:.3f} .. {row['high']:.3f}")
    settled = rows["  settled by the next experiment"]
    met = "met" if settled["share"] >= SETTLED else "NOT MET"
    return "\n".join([*lines, f"settled in at least {SETTLED:.0%} of the ambiguous cases: {met}"])


def case_rows(asked: Sequence[Asked]) -> str:
    """A row per case, named as its folder. M: with monitor; "a | b?": an ambiguous set; "a + b": both are accepted."""
    lines = [f"{'case':<13}{'machine':<19}{'recordings':<11}{'effect':<30}{'rho':>5}  said; proposed -> said then"]
    for case in asked:
        machine = f"{case.machine} {case.kind}" + " M" * case.monitor
        effect = " ".join(filter(None, (case.name, case.where)))
        line = f"{case.ident:<13}{machine:<19}{case.recordings:<11}{effect:<30}{case.rho:>5.1f}  {case.first}"
        if case.ambiguous:
            words = shlex.split(case.command)
            limits = words.index("--sample-rate") + 2 if words else 0  # the same for all of a machine's
            proposed = " ".join([*words[2:3], *words[limits:]]) or "nothing"
            line += f"; {proposed} -> {case.then or 'not asked'}: "
            line += ("settled" if case.settled else "NOT SETTLED") + ("" if case.in_set else ", NOT IN SET")
        elif case.wrong:
            line += ": WRONG"
        lines.append(line)
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--machines", type=int, default=12, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--set", choices=list(FORMS), default="report", help="default: %(default)s")
    parser.add_argument("--jobs", type=int, default=1, help="processes; default: %(default)s")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    given = parser.parse_args()
    asked, left_out = run(given.output, given.set, given.seed, given.machines, given.jobs)
    rows = figures(asked)
    print(f"asked: {len(asked)} cases, {left_out} more left out: the effect hides in what the model misses anyway")
    print("", table(rows), "", case_rows(asked), sep="\n")
    (given.output / "results.json").write_text(json.dumps(
        {"figures": rows, "left_out": left_out, "cases": [asdict(case) for case in asked]}, indent=1))


if __name__ == "__main__":
    main()
