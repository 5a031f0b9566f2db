#!/usr/bin/env python3
"""Does `rdpi gap` see what becomes of an effect that the model holds already?

    .venv/bin/python tests/withheld/known.py --machines 8 --seed 1 --set report -o build/known

Machines of actuators.py are identified without the effect. The model is then given it by hand, with the values that
fit recordings for commissioning best (an amplifier's own lag adds to a delay), and the passport of both together. The
machine is recorded again with the effect as it was, larger, and smaller.

Printed: a row for each effect and each of these, and what was said of it: named first, named among rivals, not named
("none", "unknown"), or another name outside the set; with the median error of its first parameter where it was named
first.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np  # noqa: E402
from actuators import FORMS, RICH, Put  # noqa: E402
from cases import Bench  # noqa: E402
from rdpi.data import Recording  # noqa: E402
from rdpi.identify import localise, passport  # noqa: E402
from rdpi.gap import GapDocument, diagnose  # noqa: E402
from rdpi.gap.candidates import search  # noqa: E402
from rdpi.gap.dataset import Dataset  # noqa: E402
from rdpi.model import Model, Passport  # noqa: E402
from rdpi.simulate import chain, effects, signals  # noqa: E402

PERCENT = 100.0
DAMPING = 0.4  # Put.form; damping is 0.015 times 10 to this


class Held(NamedTuple):
    """An effect as the machine has it and as the model holds it."""

    name: str
    place: str  # in actuators.py
    stage: str  # in the model
    sizes: tuple[float, float, float]  # in actuators.py: as it was, larger, smaller

    def put(self, size: float) -> Put:
        return Put(self.name, size, self.place, DAMPING)

    def parameters(self, size: float) -> dict[str, float]:
        """Of the model, for a size of the machine; the one that changes first."""
        return {"delay": lambda: {"delay_s": size}, "lag": lambda: {"time_constant_s": size},
                "resonance": lambda: {"f0_hz": 1 / size, "damping": 0.015 * 10**DAMPING}}[self.name]()


# Creep is not among them: that of the machines has faster elements than the model's, so no value by hand is right.
HELD = (Held("delay", "command", "timing", (2e-3, 3e-3, 1e-3)), Held("delay", "sensor", "sensor", (2e-3, 3e-3, 1e-3)),
        Held("lag", "amplifier", "amplifier", (2e-3, 4e-3, 0.8e-3)),
        Held("lag", "sensor", "sensor", (2e-3, 4e-3, 0.8e-3)),
        Held("resonance", "", "mechanics", (1 / 120, 1 / 95, 1 / 150)))
BECOMES = "stays", "grows", "shrinks"


class Answer(NamedTuple):
    """What was said of the recordings of one machine."""

    held: Held
    becomes: str
    said: str
    error: float  # relative, of the parameter; NaN where it was not named first
    ratio: float  # to the passport


def given(bench: Bench, held: Held) -> Model:
    """The model with the effect that the machine has."""
    size = held.sizes[0]
    entry = {"name": held.name, "stage": held.stage, "parameters": held.parameters(size), "origin": "fit"}
    model = replace(bench.model, effects=[entry])
    runs = [without_monitor(run) for run in bench.recordings(bench.commissioning, [held.put(size)])]
    dataset, acting = Dataset(model, runs), effects.acting(model)
    found = search(dataset, acting[0].effect, acting, dataset.predict(acting))
    model = replace(model, effects=[{**entry, "parameters": found.values}])
    return replace(model, passport=passport_of(model, bench.recordings(bench.runs(RICH), [held.put(size)])).to_json())


def passport_of(model: Model, runs: list[Recording]) -> Passport:
    """What a model with effects misses of recordings that it was not fitted to."""
    residuals = []
    for run, one in zip(runs, chain.simulate(model, runs)):
        left, noise = run.displacement_um - one.predicted_um, signals.noise_um(run.displacement_um)
        coords = localise.coordinates(run, one.predicted_um, one.rate_um_per_s)
        residuals.append(passport.Residual(run, passport.OTHER_RUNS, left, None, coords, noise))
    return passport.build(residuals)


def without_monitor(run: Recording) -> Recording:
    return replace(run, columns={name: values for name, values in run.columns.items() if name != "monitor_V"})


def judged(document: GapDocument, held: Held, size: float) -> tuple[str, float]:
    """What was said, and the error of the first parameter."""
    first = next(iter(document.effects), None)
    if first is None:
        return document.verdict, np.nan
    parameter, truth = next(iter(held.parameters(size).items()))
    if first.name == held.name and first.was is not None:
        return "first", first.parameters[parameter].value / truth - 1
    among = {name for one in document.effects for name in (one.name, *one.confusable_with)}
    return "among rivals" if held.name in among else f"other: {first.name}", np.nan


def answers(bench: Bench) -> Iterator[Answer]:
    for held in HELD:
        model = given(bench, held)
        for becomes, size in zip(BECOMES, held.sizes):
            document = diagnose(model, bench.recordings(bench.pool("rich", True), [held.put(size)])).document
            yield Answer(held, becomes, *judged(document, held, size), document.passport.ratio)


def table(found: list[Answer]) -> list[str]:
    lines = []
    for held in HELD:
        for becomes in BECOMES:
            here = [one for one in found if one.held is held and one.becomes == becomes]
            said = ", ".join(f"{what} {count}" for what, count in Counter(one.said for one in here).most_common())
            errors = [abs(one.error) for one in here if np.isfinite(one.error)]
            error = f"; error {PERCENT * np.median(errors):.1f} %" if errors else ""
            ratio = np.median([one.ratio for one in here])
            lines.append(f"{held.name:>10} {held.stage:10} {becomes:8} ratio {ratio:5.2f}  {said}{error}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--machines", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--set", dest="form", choices=list(FORMS), default="report")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/known"))
    arguments = parser.parse_args()
    found = [answer for index in range(arguments.machines)
             for answer in answers(Bench(arguments.output, FORMS[arguments.form], arguments.seed, index))]
    print("\n".join(table(found)))


if __name__ == "__main__":
    main()
