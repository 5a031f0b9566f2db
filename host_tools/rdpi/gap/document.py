"""The document of `rdpi gap --json`: what a diagnosis found, section by section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .. import version
from ..identify import localise
from ..model import Passport, records
from ..simulate import effects, signals
from ..simulate.effects import CATALOGUE, STAGES
from . import experiment, numerics, thresholds
from .augmented import AugmentedModel
from .candidates import Candidate
from .dataset import Dataset
from .normal_equations import NormalEquations
from .sections import (AcceptedEffect, BeforeAfter, CandidateEntry, GapDocument, GapFigures, Leftover, Matrix,
                       NotExcited, NotKnown, Offset, PassportFigures, Promise, Refit, RunEntry, StageShares, Verdict, Where)
from .selection import NOT_CLEAR, Excess, Round, Selection, equations_of, promised_interval, shrink_of


def build(selection: Selection, gap: Excess, verdict: Verdict, known: Passport | None, axes: Sequence[localise.Axis],
          unseen: list[NotKnown], noise_um: float, offset_um: Offset, stuck: float, notes: list[str]) -> GapDocument:
    """The document, from a selection that has ended; `known` is the passport of the model that was given, `stuck` the share
    of the gap where readings stand still.
    """
    state, first = selection.accepted, selection.rounds[0]
    final = equations_of(state) if state.chosen else None  # for what the effects promise
    passport = None if known is None else PassportFigures(ratio=gap.ratio, rms_um=gap.expected_um,
                                                          held_out=known.held_out, spread=gap.spread)
    found = GapDocument(
        tool=f"rdpi {version()}", verdict=verdict, detection=selection.detection, paired=bool(state.earlier),
        effects=_effects(selection, final), candidates=_candidates(selection, verdict, known), gap=_gap(selection, noise_um),
        where=_where(selection, axes), runs=_runs(selection, gap), passport=passport,
        promised=promised(selection, final), refit=Refit(shrink=first.baseline.refit_alone),
        numerics=numerics.compare(selection.given.model, state.recordings), not_excited=_not_excited(selection),
        not_known_from_commissioning=unseen, leftover=_leftover(selection, gap), matrix=_matrix(first),
        next_experiment=None, notes=notes, offset_um=offset_um, stuck=stuck)
    if not found.sticks:  # what is broken is mended first
        found.next_experiment = experiment.propose(selection, verdict, unseen)
    return found


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _effects(selection: Selection, final: NormalEquations | None) -> list[AcceptedEffect]:
    """The accepted effects, in the order added, with their final parameters."""
    if final is None:
        return []
    found, first = [], selection.rounds[0]
    for one, done, widths in zip(selection.accepted.chosen, selection.rounds, _widths(selection, final)):
        score = done.best
        shrink, ends = score.shrink, score.shrink_ci
        if done.refitted:
            shrink, ends = score.refitted_shrink, score.refitted_ci
        before = rms(selection.before_um) * float(np.sqrt(done.before / first.before)) if first.before > 0 else 0.0
        found.append(AcceptedEffect(
            name=one.effect.name, stage=one.effect.stage, **one.effect.options, parameters=_parameters(one, widths),
            was=_was(selection, one),
            held_out_rms_um=BeforeAfter(before=before, after=before * (1 - shrink)),
            shrink=shrink, shrink_ci95=ends, confidence=_confidence(done),
            confusable_with=list(dict.fromkeys(rival.name for rival in selection.rivals(done)))))
    return found


def may_be_as_before(selection: Selection) -> bool:
    """Whether the model holds the effect that was accepted last, and the intervals of what it is now hold all that it was."""
    one = selection.accepted.chosen[-1]
    if (was := _was(selection, one)) is None:
        return False
    widths = _widths(selection, equations_of(selection.accepted))[-1]
    return bool(widths) and all(was[name] is not None and abs(one.values[name] - was[name]) <= width
                                for name, width in widths.items())


def _widths(selection: Selection, final: NormalEquations) -> list[dict[str, float]]:
    """Half of the 95 % interval of each fitted parameter, per accepted effect; none where a part of one recording alone
    shows it.
    """
    def jackknife(moves: np.ndarray) -> np.ndarray:
        return np.sqrt((len(moves) - 1) * np.mean((moves - moves.mean(axis=0))**2, axis=0))

    errors = jackknife(final.moves())
    errors = thresholds.WIDEN * 1.96 * np.where(np.isnan(errors), jackknife(final.moves(within=True)), errors)
    found, at = [], 0
    for one in selection.accepted.chosen:
        own = {} if one.per_run else _own_widths(selection, one)
        names = () if one.per_run else one.fitted
        found.append({name: float(np.hypot(error, own.get(name, 0.0)))
                      for name, error in zip(names, errors[at:at + len(names)]) if not np.isnan(error)})
        at += len(names)
    return found


def _own_widths(selection: Selection, one: Candidate) -> dict[str, float]:
    """How sure the model is of what it holds in its place: half of each interval. What else the model lacks of it moves a
    changed value as far.
    """
    place = effects.place(selection.given.model, one.effect)
    if place is None:
        return {}
    stated = selection.given.model.effects[place].get("parameters", {})
    return {name: (ends[1] - ends[0]) / 2 for name, value in stated.items()
            if isinstance(value, dict) and isinstance(ends := value.get("ci95"), (list, tuple)) and len(ends) == 2
            and all(isinstance(end, (int, float)) and np.isfinite(end) for end in ends)}


def _parameters(one: Candidate, widths: dict[str, float]) -> dict[str, records.EffectParameter]:
    result = {}
    for parameter in one.effect.parameters:
        if parameter.name not in one.values:
            continue
        value, width = one.values[parameter.name], widths.get(parameter.name)
        ends = None if width is None else (float(max(parameter.low, value - width)),
                                           float(min(parameter.high, value + width)))
        result[parameter.name] = records.EffectParameter(value=_finite(value), ci95=ends,
                                                         unit=one.effect.unit(parameter))
    return result


def _was(selection: Selection, one: Candidate) -> dict[str, float | None] | None:
    """What the model that was given holds in its place; None: nothing."""
    known = None if one.per_run else effects.replaced(selection.given.known, one.effect)
    return None if known is None else {name: _finite(value) for name, value in known.values.items()}


def _confidence(done: Round) -> float:
    """Weight of the best among those tried, by the squares they leave; RIVAL_MARGIN apart is worth e^-1."""
    best = max(done.best.rest(done.refitted), 1e-12 * done.before)
    weights = [np.exp(-(one.rest(done.refitted) / best - 1) / thresholds.RIVAL_MARGIN)
               for one in done.scores if one.name != done.best.name]
    return float(1 / (1 + sum(weights)))


def _candidates(selection: Selection, verdict: Verdict, known: Passport | None) -> list[CandidateEntry]:
    """Every effect that was tried, as the first round scored it: at the stage that it has a name at, else at the one where
    it explains most.
    """
    first, accepted = selection.rounds[0], [one.effect.name for one in selection.accepted.chosen]
    named = {one.name: one.candidate.effect.stage for one in (*reversed(first.rivals), first.best) if one}
    result = {}
    for one in sorted(first.scores, key=lambda one: one.left):
        if one.name in result:
            continue
        one = next((other for other in first.scores if other.name == one.name
                    and other.candidate.effect.stage == named.get(one.name)), one)
        rejected = first.why_rejected(one)
        if one.name in accepted:
            rejected = None
        elif one is first.best or not accepted and one in first.rivals:
            rejected = "explains a part of the gap, but leaves too much to be its cause"
        elif rejected is None and one not in first.rivals:
            more = "more of the gap" if first.best.shrink >= one.shrink else "as much of the gap in a simpler way"
            rejected = f"{first.best.name} explains {more}"
        elif rejected == NOT_CLEAR and known is None:
            rejected = "without a passport it is not known how large a gap is usual"
        elif rejected == NOT_CLEAR and verdict == "unknown":  # it is one by its spectrum
            rejected = "explains too little of the gap"
        result[one.name] = CandidateEntry(
            name=one.name, stage=one.candidate.effect.stage, shrink=one.shrink, shrink_ci95=one.shrink_ci,
            refitted_shrink=one.refitted_shrink,
            parameters=_parameters(selection.final(first) if one is first.best else one.candidate, {}),
            was=_was(selection, one.candidate), excited=True, share_of_excess=one.share, rejected_because=rejected)
    for name, kind in CATALOGUE.items():
        if name not in result:
            why = "excluded by --without" if name in selection.without else \
                selection.refused.get(name, "the model holds none" if name in selection.given.foreign else
                                      "these recordings do not excite it")
            result[name] = CandidateEntry(name=name, stage=kind.stages[0], shrink=0.0, shrink_ci95=None,
                                          refitted_shrink=0.0, parameters={}, excited=False, rejected_because=why)
    return list(result.values())


def _not_excited(selection: Selection) -> list[NotExcited]:
    tried = {one.name for one in selection.rounds[0].scores}
    return [NotExcited(name=name, needs=kind.needs) for name, kind in CATALOGUE.items()
            if name not in tried and name not in selection.given.foreign.union(selection.without)]


def rms(parts: Sequence[np.ndarray]) -> float:
    """rms in um of all recordings together."""
    return float(np.sqrt(np.mean(np.concatenate(list(parts)) ** 2)))


def _gap(selection: Selection, noise_um: float) -> GapFigures:
    before, after = rms(selection.before_um), rms(selection.after_um)
    stroke = max(float(np.ptp(run.displacement_um)) for run in selection.given.recordings)
    return GapFigures(rms_um=before, percent_of_stroke=100 * before / stroke, noise_floor_um=noise_um,
                      explained_um=float(np.sqrt(max(before**2 - after**2, 0.0))), remaining_um=after,
                      whole_um=whole(selection))


def whole(selection: Selection) -> BeforeAfter | None:
    """rms of what the displacement misses in all, without and with the effects, where the gap is a change only."""
    state = selection.accepted
    if not state.earlier:
        return None
    dataset = Dataset(state.model, state.recordings, monitored=False)
    return BeforeAfter(before=rms(replace(state, chosen=()).residual_in(dataset)),
                       after=rms(state.residual_in(dataset)))


def _where(selection: Selection, axes: Sequence[localise.Axis]) -> Where:
    state, first = selection.accepted, selection.given.residual
    energy = [float(np.sum(part**2)) for part in selection.before_um]
    ranked = sorted(range(len(energy)), key=lambda k: -energy[k])
    stages = None
    if state.dataset.monitored:
        side = state.dataset.of_monitor[state.dataset.block]
        ahead = float(np.sum(first[side] ** 2))
        whole = ahead + float(np.sum(first[~side] ** 2))
        stages = StageShares(before_monitor=ahead / whole, after_monitor=1 - ahead / whole)
    if state.chosen:
        open_ = [state.chosen[0].effect, *(one.effect for one in selection.rivals(selection.rounds[0]))]
        possible = {stage for effect in open_ for stage in (
            [effect.stage] if state.dataset.monitored or effect.shows_stage else effect.stages)}
        stage = " or ".join(sorted(possible, key=STAGES.index))
    elif stages:
        stage = "before the monitor" if stages.before_monitor > 0.5 else "after the monitor"
    else:
        stage = "not known"
    return Where(stage=stage, stages=stages, runs=[state.recordings[k].path for k in ranked],
                 axes={axis.name: axis.entry() for axis in axes}, dominant=localise.dominant(axes).name)


def _runs(selection: Selection, gap: Excess) -> list[RunEntry]:
    state, before, after = selection.accepted, selection.before_um, selection.after_um
    whole = max(float(sum(np.sum(part**2) for part in before)), 1e-300)
    earlier = [run.path for run in state.earlier] or [None] * len(state.recordings)
    return [RunEntry(file=run.path, digest=run.digest, samples=len(run), earlier=earlier[k],
                     rms_um=BeforeAfter(before=rms([one]), after=rms([other])),
                     offset_um=model_run.mean_residual_um(state.known),
                     noise_floor_um=signals.noise_um(run.displacement_um),
                     percent_of_stroke=100 * rms([one]) / float(np.ptp(run.displacement_um)),
                     ratio=None if gap.ratios is None else gap.ratios[k], share=float(np.sum(one**2)) / whole)
            for k, (run, model_run, one, other) in enumerate(zip(
                state.recordings, selection.with_starts.by_command.model_runs, before, after))]


def promised(selection: Selection, final: NormalEquations | None) -> Promise:
    """Shrink of the gap's rms by all effects together, in recordings left out in turn."""
    if final is None:
        return Promise(shrink=None, ci90=None, why_no_interval="no effect was accepted")
    after, recordings = final.held_out(), len(selection.given.recordings)
    before = np.bincount(final.dataset.block, selection.given.residual**2, len(after))
    return Promise(shrink=shrink_of(after, before), ci90=promised_interval(after, before, recordings),
                   why_no_interval=None if recordings > 1 else "one recording shows no spread between recordings")


def _leftover(selection: Selection, gap: Excess) -> Leftover:
    """What is left with the effects: against the passport, and whether it still goes with something."""
    state = selection.accepted
    left = np.concatenate(state.dataset.split(state.residual))
    drive = [run.command_V - np.mean(run.command_V) for run in state.recordings]
    signals_ = {"command": drive, "command_squared": [u**2 for u in drive],
                "rate": [np.abs(np.gradient(u)) / run.sample_time_s for u, run in zip(drive, state.recordings)],
                "direction": [np.sign(np.gradient(u)) for u in drive]}
    related = {}
    for name, parts in signals_.items():
        other = np.concatenate(parts)
        related[name] = float(np.corrcoef(left, other)[0, 1]) if np.ptp(left) and np.ptp(other) else 0.0
    spread = float(np.mean(left**2))
    return Leftover(ratio=rms(selection.after_um) / gap.expected_um if gap.expected_um else None, correlation=related,
                    kurtosis=float(np.mean(left**4) / spread**2) if spread > 0 else None)


def _matrix(done: Round) -> Matrix:
    """Share of a true signature (row) that another effect (column) reproduces in these recordings."""
    rank = sorted(range(len(done.scores)), key=lambda k: done.scores[k].left)
    kept = list({done.scores[k].name: k for k in reversed(rank)}.values())
    kept.sort(key=rank.index)
    return Matrix(names=[done.scores[k].name for k in kept],
                  r2=[[_finite(done.reproduced[i, j]) for j in kept] for i in kept])
