"""The document of `rdpi gap --json`: what a diagnosis found, section by section."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import version
from ..fit import localise
from ..model import Model
from ..simulate import signals
from ..simulate.effects import CATALOGUE, STAGES
from . import experiment, numerics
from .candidates import Bench, Candidate, Grams
from .selection import SAME, WIDEN, Excess, Judged, Round, Selection, shrink_of

SCHEMA = "rdpi-gap/1"


def build(state: Selection, gap: Excess, rounds: list[Round], verdict: str, model: Model, known: dict[str, Any] | None,
          axes: Sequence[localise.Axis], noise_um: float, before_um: Sequence[np.ndarray],
          after_um: Sequence[np.ndarray], offset: dict[str, Any], notes: list[str]) -> dict[str, Any]:
    """The document, from a selection that has ended; `model` is the one that was given, `known` its passport."""
    final = Grams(state.bench, state.rest, [], state.chosen) if state.chosen else None
    return {
        "schema": SCHEMA, "tool": f"rdpi {version()}", "verdict": verdict, "detection": state.detection,
        "paired": bool(state.earlier),
        "effects": _effects(state, rounds, final), "candidates": _candidates(state, rounds),
        "gap": {**_gap(state, noise_um, before_um, after_um), "whole_um": _whole(state)},
        "where": _where(state, axes, before_um, rounds[0].rivals),
        "runs": _runs(state, gap, before_um, after_um),
        "passport": None if known is None else {"ratio": gap.ratio, "rms_um": gap.expected_um,
                                                "held_out": known["held_out"], "spread": gap.spread},
        "promised": _promised(state, final), "refit": {"shrink": rounds[0].refit_alone},
        "numerics": numerics.compare(model, state.runs), "not_excited": _not_excited(state, rounds),
        "leftover": _leftover(state, gap), "matrix": _matrix(rounds[0]),
        "next_experiment": experiment.propose(state, rounds, verdict), "notes": notes,
        "offset_um": offset,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _effects(state: Selection, rounds: list[Round], final: Grams | None) -> list[dict[str, Any]]:
    """The accepted effects, in the order added, with their final parameters."""
    if final is None:
        return []
    moves = final.moves()
    errors = WIDEN * 1.96 * np.sqrt((len(moves) - 1) * np.mean((moves - moves.mean(axis=0))**2, axis=0))
    found, at = [], 0
    for one, done in zip(state.chosen, rounds):
        widths = {}
        if not one.per_run:
            widths = dict(zip(one.free, errors[at:at + len(one.free)]))
            at += len(one.free)
        judged = done.best
        shrink, ends = judged.shrink, judged.shrink_ci
        if done.refitted:
            shrink, ends = judged.refitted_shrink, judged.refitted_ci
        before = rms(state.before_um) * float(np.sqrt(done.before / rounds[0].before)) if rounds[0].before > 0 else 0.0
        found.append({
            "name": one.effect.name, "stage": one.effect.stage, **one.effect.options,
            "parameters": _parameters(one, widths),
            "held_out_rms_um": {"before": before, "after": before * (1 - shrink)},
            "shrink": shrink, "shrink_ci95": ends, "confidence": _confidence(done),
            "confusable_with": list(dict.fromkeys(rival.name for rival in done.rivals))})
    return found


def _parameters(one: Candidate, widths: dict[str, float]) -> dict[str, dict[str, Any]]:
    result = {}
    for parameter in one.effect.parameters:
        if parameter.name not in one.values:
            continue
        value, width = one.values[parameter.name], widths.get(parameter.name)
        ends = None if width is None else [float(max(parameter.low, value - width)),
                                           float(min(parameter.high, value + width))]
        unit = parameter.unit
        if one.effect.name == "quantisation" and parameter.name != "dither":
            unit = "um" if one.effect.stage == "sensor" else "V"
        result[parameter.name] = {"value": _finite(value), "ci95": ends, "unit": unit}
    return result


def _confidence(done: Round) -> float:
    """Weight of the best among those tried, by the squares they leave; SAME apart is worth e^-1."""
    best = max(done.best.rest(done.refitted), 1e-12 * done.before)
    weights = [np.exp(-(one.rest(done.refitted) / best - 1) / SAME)
               for one in done.judged if one.name != done.best.name]
    return float(1 / (1 + sum(weights)))


def _candidates(state: Selection, rounds: list[Round]) -> list[dict[str, Any]]:
    """Every effect that was tried, each at its stage that explains most, as the first round judged it."""
    first, accepted = rounds[0], [one.effect.name for one in state.chosen]
    result = {}
    for one in sorted(first.judged, key=lambda one: one.left):
        if one.name in result:
            continue
        rejected = one.rejected
        if one.name in accepted:
            rejected = None
        elif one is first.best or not accepted and one in first.rivals:
            rejected = "takes up a part of the gap, but leaves too much to be its cause"
        elif rejected is None and one not in first.rivals:
            rejected = f"{first.best.name} explains more of the gap"
        result[one.name] = {
            "name": one.name, "stage": one.candidate.effect.stage, "shrink": one.shrink, "shrink_ci95": one.shrink_ci,
            "refitted_shrink": one.refitted_shrink, "parameters": _parameters(one.candidate, {}), "excited": True,
            "share_of_excess": one.share, "rejected_because": rejected}
    for name, kind in CATALOGUE.items():
        if name not in result:
            result[name] = {"name": name, "stage": kind.stages[0], "shrink": 0.0, "shrink_ci95": None,
                            "refitted_shrink": 0.0, "parameters": {}, "excited": False,
                            "rejected_because": "left out by --without" if name in state.without else
                            state.refused.get(name, "these recordings do not excite it")}
    return list(result.values())


def _not_excited(state: Selection, rounds: list[Round]) -> list[dict[str, str]]:
    tried = {one.name for one in rounds[0].judged}
    return [{"name": name, "needs": kind.needs} for name, kind in CATALOGUE.items()
            if name not in tried and name not in state.without]


def rms(parts: Sequence[np.ndarray]) -> float:
    """rms in um of all recordings together."""
    return float(np.sqrt(np.mean(np.concatenate(list(parts)) ** 2)))


def _gap(state: Selection, noise_um: float, before_um: Sequence[np.ndarray], after_um: Sequence[np.ndarray]
         ) -> dict[str, Any]:
    before, after = rms(before_um), rms(after_um)
    stroke = max(float(np.ptp(run.displacement_um)) for run in state.runs)
    return {"rms_um": before, "percent_of_stroke": 100 * before / stroke, "noise_floor_um": noise_um,
            "explained_um": float(np.sqrt(max(before**2 - after**2, 0.0))), "remaining_um": after}


def _whole(state: Selection) -> dict[str, float] | None:
    """rms of what the displacement misses in all, without and with the effects, where the gap is a change only."""
    if not state.earlier:
        return None
    bench = Bench(state.model, state.runs, monitored=False)
    return {name: rms(bench.split(bench.measured - state.predict(bench, chosen)))
            for name, chosen in (("before", []), ("after", state.chosen))}


def _where(state: Selection, axes: Sequence[localise.Axis], before: Sequence[np.ndarray], rivals: Sequence[Judged]
           ) -> dict[str, Any]:
    energy = [float(np.sum(part**2)) for part in before]
    ranked = sorted(range(len(energy)), key=lambda k: -energy[k])
    stages = None
    if state.bench.monitored:
        side = state.bench.of_monitor[state.bench.block]
        ahead = float(np.sum(state.first[side] ** 2))
        whole = ahead + float(np.sum(state.first[~side] ** 2))
        stages = {"before_monitor": ahead / whole, "after_monitor": 1 - ahead / whole}
    if state.chosen:
        open_ = [state.chosen[0].effect, *(one.candidate.effect for one in rivals)]
        possible = {stage for effect in open_ for stage in (
            [effect.stage] if state.bench.monitored or effect.shows_stage else effect.stages)}
        stage = " or ".join(sorted(possible, key=STAGES.index))
    elif stages:
        stage = "before the monitor" if stages["before_monitor"] > 0.5 else "after the monitor"
    else:
        stage = "not known"
    return {"stage": stage, "stages": stages, "runs": [state.runs[k].path for k in ranked],
            "axes": {axis.name: axis.to_json() for axis in axes}, "dominant": localise.dominant(axes).name}


def _runs(state: Selection, gap: Excess, before: Sequence[np.ndarray], after: Sequence[np.ndarray]
          ) -> list[dict[str, Any]]:
    whole = max(float(sum(np.sum(part**2) for part in before)), 1e-300)
    earlier = [run.path for run in state.earlier] or [None] * len(state.runs)
    return [{"file": run.path, "digest": run.digest, "samples": len(run), "earlier": earlier[k],
             "rms_um": {"before": rms([one]), "after": rms([other])},
             "offset_um": rig.missed_um(state.known),
             "noise_floor_um": signals.noise_um(run.displacement_um),
             "percent_of_stroke": 100 * rms([one]) / float(np.ptp(run.displacement_um)),
             "ratio": None if gap.ratios is None else gap.ratios[k], "share": float(np.sum(one**2)) / whole}
            for k, (run, rig, one, other) in enumerate(zip(state.runs, state.bench.rigs, before, after))]


def _promised(state: Selection, final: Grams | None) -> dict[str, Any]:
    """Shrink of the gap's rms by all effects together, in recordings left out in turn."""
    if final is None:
        return {"shrink": None, "ci90": None, "why_no_interval": "no effect was accepted"}
    after = final.held_out()
    before = np.bincount(state.bench.block, state.first**2, len(after))
    return {"shrink": shrink_of(after, before), "ci90": state.interval(after, before, 90),
            "why_no_interval": None if len(state.runs) > 1 else "one recording shows no spread between recordings"}


def _leftover(state: Selection, gap: Excess) -> dict[str, Any]:
    """What is left with the effects: against the passport, and whether it still goes with something."""
    left = np.concatenate(state.bench.split(state.rest))
    drive = [run.command_V - np.mean(run.command_V) for run in state.runs]
    signals_ = {"command": drive, "command_squared": [u**2 for u in drive],
                "rate": [np.abs(np.gradient(u)) / run.sample_time_s for u, run in zip(drive, state.runs)],
                "direction": [np.sign(np.gradient(u)) for u in drive]}
    related = {}
    for name, parts in signals_.items():
        other = np.concatenate(parts)
        related[name] = float(np.corrcoef(left, other)[0, 1]) if np.ptp(left) and np.ptp(other) else 0.0
    spread = float(np.mean(left**2))
    return {"ratio": gap.left(float(np.sum(state.rest**2))) if gap.ratio else None, "correlation": related,
            "kurtosis": float(np.mean(left**4) / spread**2) if spread > 0 else None}


def _matrix(done: Round) -> dict[str, Any]:
    """Share of a true signature (row) that another effect (column) reproduces in these recordings."""
    rank = sorted(range(len(done.judged)), key=lambda k: done.judged[k].left)
    kept = list({done.judged[k].name: k for k in reversed(rank)}.values())
    kept.sort(key=rank.index)
    return {"names": [done.judged[k].name for k in kept],
            "r2": [[_finite(done.reproduced[i, j]) for j in kept] for i in kept]}
