#!/usr/bin/env python3
"""What half and twice of every tuned threshold do to the figures of the withheld check.

    .venv/bin/python tests/withheld/check.py --set tune --cases 120 --seed 5 -o build/tune
    .venv/bin/python tests/withheld/thresholds.py build/tune --cases 24
    .venv/bin/python tests/withheld/thresholds.py build/tune --cases 24 --fit --only REPEATS

Printed, per threshold of `rdpi.gap.thresholds` (with --fit: of `rdpi.identify.thresholds`) and per factor: the figures
below, of the first cases of a set that check.py has generated. Case names are random, so the first are a random sample.

  detected  of cases with an effect of rho 1 or more: a gap was reported
  alarms    of cases without effect: one was reported
  right     of single effects of rho 2 or more: first name right
  wrong     of single effects of rho 1 or more: name wrong, and none of its rivals right
  unknown   of effects that are not in the catalogue, rho 2 or more: "unknown"

Whatever does not depend on a threshold is computed once: a round is given an immutable model, and what was fitted to
that is kept. With --fit every model is fitted anew for every threshold, which takes seconds each: name the thresholds
with --only. Thresholds that are counts are rounded, to 1 at least. `chance_gain` is that of all effects.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
sys.path.insert(0, str(Path(__file__).parent))

import score  # noqa: E402
from cases import Case, read_labels  # noqa: E402

from rdpi.data import read_recording  # noqa: E402
from rdpi.identify import Options, fit, passport  # noqa: E402
from rdpi.identify import thresholds as of_fit  # noqa: E402
from rdpi.gap import diagnosis, selection  # noqa: E402
from rdpi.gap import thresholds as of_gap  # noqa: E402
from rdpi.gap.augmented import AugmentedModel  # noqa: E402
from rdpi.gap.normal_equations import NormalEquations  # noqa: E402
from rdpi.model import Model, read_model  # noqa: E402
from rdpi.simulate.effects import CATALOGUE  # noqa: E402

FACTORS = 0.5, 1.0, 2.0
CHANCE = "chance_gain"
# no verdict depends on
REMARKS = {"BIN_SHARE", "BIN_RATIO", "ZERO", "MUCH_ZERO", "ZERO_AGREES", "ZERO_SCATTER", "MUCH_LEFT", "OTHER_RATE",
           "WIDEN", "WIDEN_FEW", "HARDLY_MOVED", "BEYOND_ENDS", "ABOVE_NOISE", "MOSTLY"}
FITTED = {"OWN_MOTION"}  # what a fitted candidate depends on,
SOLVED = {"REACH", "REFIT_FREEDOM", "CORRELATED"}  # ... and what is left of it in recordings left out
FIGURES = "detected", "alarms", "right", "wrong", "unknown"


class Memory:
    """Results of functions of objects that do not change, by those objects."""

    def __init__(self) -> None:
        self.known: dict[tuple, tuple[Any, tuple]] = {}

    def of(self, function: Callable, *arguments: Any, depends: frozenset[str] | set[str] = frozenset()) -> Any:
        key = (function, *(one if isinstance(one, (str, int, bool, type(None))) else id(one) for one in arguments),
               *(getattr(of_gap, name) for name in sorted(depends)))
        if key not in self.known:
            self.known[key] = function(*arguments), arguments  # kept, so that no other object gets their ids
        return self.known[key][0]


@contextmanager
def remembering() -> Iterator[None]:
    """Let fits, joint fits and what candidates leave be computed once for every model that they are fitted to."""
    memory, accept, refit, fit_all = Memory(), AugmentedModel.accept, AugmentedModel.refit, selection._fit_all
    held_out, reproduced = NormalEquations.held_out, NormalEquations.reproduced

    def all_of(state: AugmentedModel) -> Any:
        return fit_all(state, (), lambda fraction: None)

    def fitted(state: AugmentedModel, without: Sequence[str], progress: Callable) -> Any:
        return memory.of(all_of, state, depends=FITTED)

    def equations(dataset: Any, left: Any, found: Any, chosen: Any = ()) -> NormalEquations:
        return memory.of(NormalEquations, dataset, left, found, chosen)

    def left_out(self: NormalEquations, chosen: int | None = None, refit: bool = False, within: bool = False) -> Any:
        return memory.of(held_out, self, chosen, refit, within, depends=SOLVED)

    with mock.patch.object(selection, "_fit_all", fitted), mock.patch.object(selection, "NormalEquations", equations), \
            mock.patch.object(NormalEquations, "held_out", left_out), \
            mock.patch.object(NormalEquations, "reproduced", lambda self: memory.of(reproduced, self)), \
            mock.patch.object(AugmentedModel, "accept", lambda self, one: memory.of(accept, self, one)), \
            mock.patch.object(AugmentedModel, "refit", lambda self, one, move: memory.of(refit, self, one, move)):
        yield


@contextmanager
def scaled(thresholds: ModuleType, name: str, factor: float) -> Iterator[None]:
    """One threshold changed; CHANCE: that of every effect."""
    if name == CHANCE:
        before = {kind: kind.chance_gain for kind in CATALOGUE.values()}
        for kind, gains in before.items():
            kind.chance_gain = tuple(factor * gain for gain in gains)
        yield
        for kind, gains in before.items():
            kind.chance_gain = gains
        return
    value = getattr(thresholds, name)  # read by the modules whenever they use it
    with mock.patch.object(thresholds, name, max(1, round(factor * value)) if isinstance(value, int)
                           else factor * value):
        yield


def names(thresholds: ModuleType) -> list[str]:
    """Of all thresholds that a verdict depends on and that are one number."""
    found = [name for name, value in vars(thresholds).items()
             if name.isupper() and name not in REMARKS and isinstance(value, (int, float))]
    return [*found, CHANCE] if thresholds is of_gap else found


def verdict(given: AugmentedModel, known: Any) -> dict[str, Any]:
    """What `rdpi gap --json` says, as far as the figures go by it."""
    decision = diagnosis.decide(given, known)
    found = decision.selection
    effects = [{"name": one.effect.name, "confusable_with": [rival.name for rival in done.rivals]}
               for one, done in zip(found.accepted.chosen, found.rounds)]
    candidates = [{"name": one.name, "shrink": one.shrink} for one in found.rounds[0].scores]
    return {"gap": {"verdict": decision.verdict, "effects": effects, "candidates": candidates,
                    "detection": found.detection}}


def figures(judged: Sequence[score.Judged]) -> dict[str, float | None]:
    """Shares, None without cases; see above."""
    def of(hit: Callable[[score.Judged], bool], groups: Sequence[str], rho: float) -> float | None:
        cases = [j for j in judged if j.case.group in groups and (rho == 0 or (
            j.case.reached >= rho and j.case.growth >= score.GREW))]
        if groups == ("foreign",):  # a twin's name counts neither for nor against
            cases = [j for j in cases if j.answer not in score.TWINS.get(j.case.names[0], ())]
        return sum(map(hit, cases)) / len(cases) if cases else None

    def said(j: score.Judged) -> bool:
        return j.verdict not in ("none", "failed")

    return dict(zip(FIGURES, (
        of(said, ("single", "pair", "foreign", "poor"), score.DETECTABLE), of(said, ("none",), 0),
        of(lambda j: j.right, ("single",), score.NAMEABLE), of(lambda j: j.wrong, ("single", "poor"), score.DETECTABLE),
        of(lambda j: j.verdict == "unknown", ("foreign",), score.NAMEABLE))))


@lru_cache(maxsize=None)
def refitted(path: Path, name: str, factor: float) -> Model:
    """The model as `rdpi fit` would make it with another threshold."""
    old = read_model(path)
    options = Options(deadzones=len(old.deadzones_um) - 1, rate_independent=not old.slope_rate_s_per_um.any())
    with scaled(of_fit, name, factor):
        return fit([read_recording(run) for run in sorted(path.parent.glob("fit-*.csv"))], options).model


def judge_all(folder: Path, cases: Sequence[Case], thresholds: ModuleType, asked: Sequence[str]
              ) -> dict[tuple[str, float], list[score.Judged]]:
    """Every case with every threshold and factor; at 1, one answer stands for all."""
    judged: dict[tuple[str, float], list[score.Judged]] = {}
    begin = time.perf_counter()

    def answer(case: Case, model: Model, given: AugmentedModel | None = None) -> score.Judged:
        known = passport.read(model)
        known = passport.repeated(known) if earlier and known is not None else known
        return score.judge(case, verdict(given or AugmentedModel.given(model, runs, earlier), known))

    for done, case in enumerate(cases, 1):
        place = folder / "cases" / case.ident
        path = (place / json.loads((place / "task.json").read_text())["model"]).resolve()
        runs, earlier = ([read_recording(path) for path in sorted(place.glob(kind))]
                         for kind in ("run-*.csv", "earlier-*.csv"))
        model = read_model(path)
        given = AugmentedModel.given(model, runs, earlier)
        with remembering():
            plain = answer(case, model, given)
            for name in asked:
                for factor in FACTORS:
                    with scaled(thresholds, name, factor):
                        one = plain if factor == 1 else answer(case, model, given) if thresholds is of_gap else \
                            answer(case, refitted(path, name, factor))
                    judged.setdefault((name, factor), []).append(one)
        if sys.stderr.isatty():
            left = (time.perf_counter() - begin) / done * (len(cases) - done)
            print(f"\r{done} of {len(cases)} cases, {left:.0f} s left ", end="", file=sys.stderr, flush=True)
    return judged


def table(judged: dict[tuple[str, float], list[score.Judged]], thresholds: ModuleType) -> str:
    """Rows in which a factor changes a figure or an answer; the others by name."""
    def told(value: float | None) -> str:
        return f"{'-':>10}" if value is None else f"{value:>10.3f}"

    def answers(all_: Sequence[score.Judged]) -> list[tuple]:
        return [(j.verdict, j.accepted, j.rivals) for j in all_]

    asked = list(dict.fromkeys(name for name, _ in judged))
    plain = judged[asked[0], 1.0]
    lines = [f"{'threshold':<16}{'value':>9}{'times':>7}" + "".join(f"{name:>10}" for name in FIGURES) + "   differ",
             f"{'(as they are)':<16}{'':>9}{1:>7g}" + "".join(map(told, figures(plain).values())) + f"{0:>9}"]
    same = []
    for name in asked:
        rows = []
        for factor in FACTORS:
            differ = sum(one != other for one, other in zip(answers(judged[name, factor]), answers(plain)))
            if differ:
                value = "" if name == CHANCE else f"{getattr(thresholds, name):g}"
                rows.append(f"{name:<16}{value:>9}{factor:>7g}"
                            + "".join(map(told, figures(judged[name, factor]).values())) + f"{differ:>9}")
        lines += rows
        same += [] if rows else [name]
    lines.append(f"differ: cases of {len(plain)} with another verdict, other effects or other rivals; "
                 "rows that change none are left out")
    return "\n".join(lines + ([f"half and twice change no case: {', '.join(same)}"] if same else []))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="a set that check.py has generated")
    parser.add_argument("--cases", type=int, default=24, metavar="N", help="default: %(default)s")
    parser.add_argument("--only", action="append", metavar="NAME", help="this threshold; repeatable")
    parser.add_argument("--fit", action="store_true", help="thresholds of rdpi.identify instead of rdpi.gap")
    given = parser.parse_args()
    thresholds = of_fit if given.fit else of_gap
    if unknown := set(given.only or ()) - set(names(thresholds)):
        parser.error(f"--only: no {', '.join(sorted(unknown))}; there are {', '.join(names(thresholds))}")
    note = json.loads((given.folder / "set.json").read_text())
    if note["withhold"]:
        parser.error("take a set without --withhold: the tool is denied no effect here")
    labels = read_labels(given.folder / "labels.sealed", note["labels"])
    cases = sorted(labels, key=lambda case: case.ident)[:given.cases]
    print(table(judge_all(given.folder, cases, thresholds, given.only or names(thresholds)), thresholds))


if __name__ == "__main__":
    main()
