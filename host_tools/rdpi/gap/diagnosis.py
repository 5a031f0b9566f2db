"""`rdpi gap`: where a fitted model and its actuator part ways, which effect is behind it, and how far adding it helps.

The model is driven by the recorded command; the gap is what is left of the displacement, each recording's mean removed,
or with earlier recordings of the same drives what is left beyond what was left of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import arguments
from ..data import RUN_COLUMNS, Recording, taken
from ..fit import checks, localise, passport
from ..model import Model
from ..simulate import signals
from ..simulate.effects import CATALOGUE
from . import document
from .document import rms
from .report.words import CHANGE, GAP, Terms
from .selection import USUAL_SPREAD, Excess, Round, Selection, detected, excess, select

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
    if state.chosen and state.bench.monitored and rms(state.after_um()) > rms(before):
        notes.append("monitor_V shows what would move the actuator further from where it is: it is the monitor that "
                     "is late, filtered or wrong; leave the column out")
        verdict = "unknown" if _sure(state, gap) else "none"
    if verdict in ("unknown", "none"):
        state.forget()
    after = state.after_um() if state.chosen else before
    zeros = _zeros(state)
    zero = float(np.average(zeros, weights=state.bench.lengths)) if state.chosen else 0.0
    moved = min(map(abs, zeros)) > max(ZERO * rms(before), MUCH_ZERO * model.stroke_um)
    if moved:
        notes.append(f"beside it the recordings lie {min(zeros):.3g} to {max(zeros):.3g} um from "
                     f"{'the earlier ones' if earlier else 'the model'}, a constant of each that is not counted: the "
                     "sensor's zero has changed, or the mount"
                     + ("; the improved model has their mean" if state.chosen else ""))
    noise = float(np.median([signals.noise_um(run.displacement_um) for run in runs]))
    if verdict == "unknown" and noise**2 > 0.5 * rms(before) ** 2:
        notes.append(f"most of it is noise from sample to sample, {noise:.3g} um rms: look at the sensor and cables")
    axes = localise.localise(runs, before, coords, known, noise)
    if verdict == "none" and (there := _elsewhere(axes, _terms(state))):
        notes.append(there)
    offset = {"mean": float(np.mean(zeros)), "low": min(zeros), "high": max(zeros), "added": zero, "moved": moved}
    found = document.build(state, gap, rounds, verdict, model, known, axes, noise, before, after, offset, notes)
    spectrum = localise.along_frequency(runs, after, coords, known, noise) if state.chosen else None
    entries = [{key: entry[key] for key in ("name", "stage", "column", "parameters") if key in entry}
               | ({"new": True} if earlier else {}) for entry in found["effects"]]
    improved = replace(state.model, effects=[*model.effects, *entries], offset_um=model.offset_um + zero)
    progress(1.0)
    return Diagnosis(found, improved, list(runs), before, after,
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
    if alone and any(one.effect.name in ("hysteresis_change", "gain_change") for one in state.chosen):
        notes.append(f"the model is rate-independent and was fitted up to {top:.3g} um/s, these recordings reach "
                     f"{fastest:.3g}: a rate dependence looks like a changed loop or gain; record at several rates")
    return notes
