"""`rdpi gap`: where a fitted model and its actuator part ways, which effect is behind it, and how far adding it helps.

The model is driven by the recorded command; the gap is what is left of the displacement, each recording's mean removed,
or with earlier recordings of the same drives what is left beyond what was left of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import arguments, version
from ..data import RUN_COLUMNS, Recording, taken
from ..fit import checks, localise, passport
from ..model import Model
from ..simulate import signals
from ..simulate.effects import CATALOGUE, STAGES
from . import experiment, numerics
from .candidates import Bench, Candidate, Grams
from .report.words import CHANGE, GAP, Terms
from .selection import SAME, USUAL_SPREAD, WIDEN, Excess, Judged, Round, Selection, detected, excess, select, shrink_of

SCHEMA = "rdpi-gap/1"
# Learnt on the tuning set of tests/withheld, as the thresholds of the selection are.
UNKNOWN = 1.25  # times the evidence that an effect needs, from which a gap without a name is one
SPREADS = 2.5  # ... or so many times the passport's own scatter
EXPLAINED, LEFT_OVER = 0.6, 1.5  # of the excess that all explain, or the ratio they leave, or the gap is unknown
BIN_SHARE, BIN_RATIO = 0.1, 2.5  # of the gap in one bin, and times the passport there: worth a remark
ZERO, MUCH_ZERO = 1.0, 0.01  # times the gap, and of the stroke: offsets worth a remark
MUCH_LEFT = 1.8  # times the passport, with the effects: worth a remark
RATES = 2.0  # times the identified rate, or that part of it: other rates


@dataclass
class Diagnosis:
    """What `rdpi gap` found: the document for --json, the improved model, and residuals for the pictures."""

    document: dict[str, Any]
    improved: Model
    runs: list[Recording]
    before_um: list[np.ndarray]
    after_um: list[np.ndarray]
    table: localise.Table
    spectrum_after: localise.Axis | None


def diagnose(model: Model, runs: Sequence[Recording], without: Sequence[str] = (),
             progress: Callable[[float], None] = lambda fraction: None, earlier: Sequence[Recording] = ()) -> Diagnosis:
    """Diagnose the gap between a model and recordings of its actuator; effects named in `without` are not known.

    With `earlier` recordings, one of the same drive for each run, the gap is what has changed since: what the model
    missed then is taken off, and with it its own error.

    Raises BadInput for recordings that cannot be this model's, and for a run whose drive no earlier recording has.
    """
    runs, earlier = taken(runs, RUN_COLUMNS, "runs", 1), taken(earlier, RUN_COLUMNS, "earlier")
    for name in arguments.listed(without, str, "without"):
        arguments.one_of(name, CATALOGUE, "without")
    arguments.of_kind(model, Model, "model").validate()
    notes, known = checks.check_against(model, runs), passport.read(model)
    if earlier:
        notes += [f"earlier, {note}" for note in checks.check_against(model, earlier) if any(
            note.startswith(run.path) for run in earlier)]
        earlier = checks.same_drives(runs, earlier)
        if any(not entry.get("new") for entry in model.effects):
            notes.append("the effects that the model has are taken to have acted in the earlier recordings too")
        notes += [f"{run.path}: its memory is {run.memory}, and {then.memory} in its earlier recording: a start that "
                  "differs looks like a change" for run, then in zip(runs, earlier) if run.memory != then.memory]
        known = None if known is None else passport.repeated(known)
    state = Selection(model, runs, earlier, without, progress)
    before = state.before_um
    coords = [localise.coordinates(rig.recording, rig.respond(state.acting()), rig.rate_um_per_s)
              for rig in state.bench.rigs]
    gap = excess(state, known, coords)
    rounds = select(state, gap)
    verdict = _verdict(state, gap, rounds)
    notes += _remarks(state, gap, rounds, verdict)
    if state.chosen and state.bench.monitored and _rms(state.after_um()) > _rms(before):
        notes.append("monitor_V shows what would move the actuator further from where it is: it is the monitor that "
                     "is late, filtered or wrong; leave the column out")
        verdict = "unknown" if _sure(state, gap) else "none"
    if verdict in ("unknown", "none"):
        state.forget()
    after = state.after_um() if state.chosen else before
    zeros = _zeros(state)
    zero = float(np.average(zeros, weights=state.bench.lengths)) if state.chosen else 0.0
    moved = min(map(abs, zeros)) > max(ZERO * _rms(before), MUCH_ZERO * model.stroke_um)
    if moved:
        notes.append(f"beside it the recordings lie {min(zeros):.3g} to {max(zeros):.3g} um from "
                     f"{'the earlier ones' if earlier else 'the model'}, a constant of each that is not counted: the "
                     "sensor's zero has changed, or the mount"
                     + ("; the improved model has their mean" if state.chosen else ""))
    noise = float(np.median([signals.noise_um(run.displacement_um) for run in runs]))
    if verdict == "unknown" and noise**2 > 0.5 * _rms(before) ** 2:
        notes.append(f"most of it is noise from sample to sample, {noise:.3g} um rms: look at the sensor and cables")
    axes = localise.localise(runs, before, coords, known, noise)
    if verdict == "none" and (there := _elsewhere(axes, _terms(state))):
        notes.append(there)
    final = Grams(state.bench, state.rest, [], state.chosen) if state.chosen else None
    document = {
        "schema": SCHEMA, "tool": f"rdpi {version()}", "verdict": verdict, "detection": state.detection,
        "paired": bool(earlier),
        "effects": _effects(state, rounds, final), "candidates": _candidates(state, rounds),
        "gap": {**_gap(state, noise, before, after), "whole_um": _whole(state)},
        "where": _where(state, axes, before, rounds[0].rivals),
        "runs": _runs(state, gap, before, after),
        "passport": None if known is None else {"ratio": gap.ratio, "rms_um": gap.expected_um,
                                                "held_out": known["held_out"], "spread": gap.spread},
        "promised": _promised(state, final), "refit": {"shrink": rounds[0].refit_alone},
        "numerics": numerics.compare(model, runs), "not_excited": _not_excited(state, rounds),
        "leftover": _leftover(state, gap), "matrix": _matrix(rounds[0]),
        "next_experiment": experiment.propose(state, rounds, verdict), "notes": notes,
        "offset_um": {"mean": float(np.mean(zeros)), "low": min(zeros), "high": max(zeros), "added": zero,
                      "moved": moved},
    }
    spectrum = localise.along_frequency(runs, after, coords, known, noise) if state.chosen else None
    entries = [{key: entry[key] for key in ("name", "stage", "column", "parameters") if key in entry}
               | ({"new": True} if earlier else {}) for entry in document["effects"]]
    improved = replace(state.model, effects=[*model.effects, *entries], offset_um=model.offset_um + zero)
    progress(1.0)
    return Diagnosis(document, improved, list(runs), before, after,
                     localise.table(before, coords), spectrum)


def _terms(state: Selection) -> Terms:
    return CHANGE if state.earlier else GAP


def _elsewhere(axes: Sequence[localise.Axis], words: Terms) -> str | None:
    """The bin that exceeds the passport most, where the whole does not."""
    worst = max(((float(axis.ratio[k]), float(axis.share[k]), axis, k) for axis in axes if axis.ratio is not None
                 for k in range(len(axis.share)) if axis.share[k] > BIN_SHARE), key=lambda one: one[0], default=None)
    if worst is None or worst[0] < BIN_RATIO:
        return None
    ratio, share, axis, k = worst
    return (f"the whole is as expected, but {100 * share:.0f} % of it lies at {axis.name} {axis.labels[k]}, "
            f"{ratio:.2g} times what {words.usual_there}: too little to be named")


def _zeros(state: Selection) -> list[float]:
    """Mean of what each recording's displacement misses with all that act, beyond what the earlier one missed; no
    other figure counts it.
    """
    bench = state.driven(state.model)
    now = [rig.missed_um(state.acting()) for rig in bench.rigs]
    then = [rig.missed_um(bench.acting_then) for rig in bench.earlier.rigs] if bench.earlier else [0.0] * len(now)
    return [float(one - other) for one, other in zip(now, then)]


def _verdict(state: Selection, gap: Excess, rounds: list[Round]) -> str:
    first = rounds[0]
    if first.best is None:
        return "unknown" if _sure(state, gap) else "none"
    if gap.ratio and not first.refitted:
        left = max(0.0, float(np.sum(state.rest**2)) - state.excused())
        explained = (gap.total - left) / max(gap.total - gap.floor, 1e-300)
        if explained < EXPLAINED and gap.left(left) > LEFT_OVER:
            return "unknown"
    return "ambiguous" if any(one.rivals for one in rounds) else "effect"


def _sure(state: Selection, gap: Excess) -> bool:
    """Whether the gap is one, whatever its cause."""
    return gap.ratio is not None and bool(state.detection > UNKNOWN * detected(state)
                                          or np.log(gap.ratio) > SPREADS * max(gap.spread, USUAL_SPREAD))


def _remarks(state: Selection, gap: Excess, rounds: list[Round], verdict: str) -> list[str]:
    notes, best = [], rounds[0].best
    left = gap.left(max(0.0, float(np.sum(state.rest**2)) - state.excused()))
    if verdict == "unknown" and best is not None:
        notes.append(f"{best.name} takes up a part of the gap, but leaves too much to be its cause")
    elif state.chosen and gap.ratio and left > MUCH_LEFT:
        notes.append(f"with {' and '.join(one.effect.name for one in state.chosen)} the gap is still {left:.2g} times "
                     f"what {_terms(state).usual}: the cause may be something like it, not known here")
    top, fastest = state.model.rate.identified_um_per_s, max(float(np.percentile(rig.rate_um_per_s, 99.9))
                                                             for rig in state.bench.rigs)
    alone = not np.any(state.model.slope_rate_s_per_um) and top and not 1 / RATES < fastest / top < RATES
    if alone and any(one.effect.hides_rate for one in state.chosen):
        notes.append(f"the model is rate-independent and was fitted up to {top:.3g} um/s, these recordings reach "
                     f"{fastest:.3g}: a rate dependence looks like a changed loop or gain; record at several rates")
    return notes


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
        rms = _rms(state.before_um) * float(np.sqrt(done.before / rounds[0].before)) if rounds[0].before > 0 else 0.0
        found.append({
            "name": one.effect.name, "stage": one.effect.stage, **one.effect.options,
            "parameters": _parameters(one, widths),
            "held_out_rms_um": {"before": rms, "after": rms * (1 - shrink)},
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
        result[parameter.name] = {"value": _finite(value), "ci95": ends, "unit": one.effect.unit(parameter)}
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


def _rms(parts: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(list(parts)) ** 2)))


def _gap(state: Selection, noise_um: float, before_um: Sequence[np.ndarray], after_um: Sequence[np.ndarray]
         ) -> dict[str, Any]:
    before, after = _rms(before_um), _rms(after_um)
    stroke = max(float(np.ptp(run.displacement_um)) for run in state.runs)
    return {"rms_um": before, "percent_of_stroke": 100 * before / stroke, "noise_floor_um": noise_um,
            "explained_um": float(np.sqrt(max(before**2 - after**2, 0.0))), "remaining_um": after}


def _whole(state: Selection) -> dict[str, float] | None:
    """rms of what the displacement misses in all, without and with the effects, where the gap is a change only."""
    if not state.earlier:
        return None
    bench = Bench(state.model, state.runs, monitored=False)
    return {name: _rms(bench.split(bench.measured - state.predict(bench, chosen)))
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
             "rms_um": {"before": _rms([one]), "after": _rms([other])},
             "offset_um": rig.missed_um(state.known),
             "noise_floor_um": signals.noise_um(run.displacement_um),
             "percent_of_stroke": 100 * _rms([one]) / float(np.ptp(run.displacement_um)),
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
