"""`rdpi gap`: where a fitted model and its actuator part ways, which effect is behind it, and how far adding it helps.

The model is driven by the recorded command; the gap is what is left of the displacement, each recording's mean removed,
or with earlier recordings of the same drives what is left beyond what was left of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..data import RUN_COLUMNS, Recording, arguments, taken
from ..errors import BadInput
from ..identify import checks, localise, passport, stick_slip
from ..model import Model, Passport, records
from ..simulate import chain, effects, signals
from ..simulate.effects import CATALOGUE
from . import beside, document, promise, spectrum, thresholds, unseen
from .augmented import AugmentedModel
from .document import rms
from .report.words import AXES, CHANGE, GAP, Terms
from .sections import GapDocument, NotKnown, Offset, TrackingPromise, Verdict
from .selection import Excess, Selection, equations_of, excess, select, shrink_of, zeros_agree
from .spectrum import Spectrum

REFERENCE_COLUMNS = "time_s", "reference_um"
NAMED = "effect", "ambiguous"  # verdicts


@dataclass
class Diagnosis:
    """What `rdpi gap` found: the document for --json, the improved model, and residuals for the pictures."""

    document: GapDocument
    improved: Model
    runs: list[Recording]
    before_um: list[np.ndarray]
    after_um: list[np.ndarray]
    table: localise.Table
    spectrum_after: localise.Axis | None


def diagnose(model: Model, runs: Sequence[Recording], without: Sequence[str] = (),
             progress: Callable[[float], None] = lambda fraction: None, earlier: Sequence[Recording] = (),
             references: Sequence[Recording] = ()) -> Diagnosis:
    """Diagnose the gap between a model and recordings of its actuator; effects named in `without` are not known.

    With `earlier` recordings, one of the same drive for each run, the gap is what has changed since: what the model
    missed then is taken off, and with it its own error. `references`, with the column reference_um, are what the
    promise for tracking is made for; effects that would make that worse, or no recording better, are left out of the
    improved model.

    Raises BadInput for recordings that cannot be this model's, and for a run whose drive no earlier recording has.
    """
    runs, earlier, known, notes = _checked(model, runs, without, earlier)
    references = taken(references, REFERENCE_COLUMNS, "references")
    given = AugmentedModel.given(model, runs, earlier)
    if (contradicted := _contradicted(given)) is not None:
        notes.append(contradicted)
        runs, earlier = ([_without_monitor(run) for run in some] for some in (runs, earlier))
        given = AugmentedModel.given(model, runs, earlier)
    decision = decide(given, known, without, progress)
    decision, offset, tracked = _worth_tracking(decision, passport.read(model), references)
    if held := decision.held_back or _spoils(decision.selection):
        offset = replace(offset, added=0.0)
    selection, verdict, before = decision.selection, decision.verdict, decision.selection.before_um
    state, after = selection.accepted, selection.after_um
    noise = float(np.median([signals.noise_um(run.displacement_um) for run in runs]))
    axes = localise.localise(runs, before, decision.coords, known, noise)
    spectrum = next(axis for axis in axes if axis.name == "frequency_hz")
    unknown = [] if earlier else unseen.not_known(known, runs, before, decision.coords, spectrum, noise)
    notes += [*decision.notes, *_remarks_on_what_is_left(selection, verdict, offset, noise, axes, unknown),
              *map(unseen.remark, unknown)]
    found = document.build(selection, decision.gap, verdict, known, axes, unknown, noise, offset, decision.stuck, notes)
    spectrum_after = localise.along_frequency(runs, after, decision.coords, known, noise) if state.chosen else None
    found.promised.tracking = tracked
    improved = replace(state.model, effects=_entries(model, selection, found, bool(earlier)),
                       offset_um=model.offset_um + offset.added)
    if held:
        found.notes.append(held)
        improved = model
    elif state.model is not selection.given.model:
        found.notes.append(_fitted_anew(selection))
    progress(1.0)
    return Diagnosis(found, improved, list(runs), before, after, localise.table(before, decision.coords),
                     spectrum_after)


def _without_monitor(run: Recording) -> Recording:
    return replace(run, columns={name: values for name, values in run.columns.items() if name != "monitor_V"})


def _contradicted(given: AugmentedModel) -> str | None:
    """Why monitor_V does not show what drives the actuator: it is the command itself, or the displacement follows the
    command. None: it may.
    """
    if not given.dataset.monitored:
        return None
    copies = [np.array_equal(run.columns["monitor_V"], run.command_V) for run in given.recordings]
    if any(copies) and not all(copies):
        path, other = given.recordings[copies.index(True)].path, given.recordings[copies.index(False)].path
        return (f"monitor_V is left out of all recordings: in {path} it is the command to the last digit, in {other} it is "
                "not; give what the amplifier puts out in all of them")
    missed = zip(given.recordings, given.dataset.split(given.residual), given.residual_um)
    wrong = [(run.path, rms([by_monitor]), rms([by_command])) for run, by_monitor, by_command in missed
             if rms([by_monitor]) > thresholds.CONTRADICTS * rms([by_command])]
    if not wrong:
        return None
    path, by_monitor, by_command = max(wrong, key=lambda one: one[1] / max(one[2], 1e-300))
    hidden = " and ".join(map(str, given.unseen_by_monitor()))
    why = f"it does not show {hidden}, which the model holds ahead of it: that acts behind the monitor" if hidden else \
        "the displacement follows the command and not the monitor: check its gain and time"
    return (f"monitor_V is left out of all recordings: driven by it, the model misses {by_monitor:.3g} um rms of {path}, "
            f"instead of {by_command:.3g} driven by the command; {why}")


def _fitted_anew(selection: Selection) -> str:
    """That the improved model is not the given one with an effect beside it, and what to make of that."""
    name = selection.accepted.chosen[0].effect.name
    said = f"beside {name} the improved model's loops were fitted anew to these recordings (column refitted)"
    return said if selection.given.earlier else (
        f"{said}: {name} may have been there at commissioning as well; `rdpi fit` of these recordings together with those of "
        "commissioning takes both into account")


def _spoils(selection: Selection) -> str | None:
    """Why the change is none for the model: it fits today's recordings as it is, and missed the earlier ones. None: it is
    one.
    """
    state, missed = selection.accepted, document.whole(selection)
    change_um = rms(selection.before_um)
    if not state.chosen or missed is None or missed.before > min(thresholds.FITS_TODAY * change_um, missed.after):
        return None
    names = " and ".join(one.effect.name for one in state.chosen)
    return (f"the model fits these recordings as it is, and not the earlier ones: with {names} it would miss "
            f"{missed.after:.3g} um rms instead of {missed.before:.3g}; the improved model is the given one; check that the "
            "earlier recordings are of the same actuator, in the same units")


def _worth_tracking(decision: Decision, known: Passport | None, references: Sequence[Recording]
                    ) -> tuple[Decision, Offset, TrackingPromise | None]:
    """The decision, its zero and its promise for references. What is to be tracked must not get worse: the last effect
    is left out as long as references, or recordings that were left out, promise no better, or the recordings show that
    the improved model is none. The only one left keeps its name, and the improved model is the given one.

    `known` is the passport of the model.
    """
    while True:
        selection = decision.selection
        offset, state = _offset(selection), selection.accepted
        if not references or not state.chosen:
            return decision, offset, None
        improved = replace(state.model, effects=promise.entries(selection),
                           offset_um=state.model.offset_um + offset.added)
        tracked, said = None, []
        try:
            tracked = promise.tracking(selection, improved, known, decision.coords, references)
        except BadInput as error:
            said = [f"no promise for tracking: {error}"]
        ci90 = document.promised(selection, equations_of(state)).ci90
        if ci90 is not None and ci90[0] < 0:
            why = "recordings that were left out may as well be predicted worse"
        elif not all(one.per_run for one in state.chosen) and (
                found := _no_better(selection.given.model, improved, state.recordings)):
            why = found
        elif tracked is not None and tracked.shrink < -thresholds.TRACKED_WORSE:
            why = f"the inverse of the model with it is to track worse by {100 * -tracked.shrink:.0f} %"
        else:
            if tracked is not None:
                said = promise.out_of_reach(improved, references)
            return replace(decision, notes=[*decision.notes, *said]), offset, tracked
        name = state.chosen[-1].effect.name
        if len(state.chosen) == 1:
            return replace(decision, held_back=f"the improved model is the given one: with {name}, {why}"), offset, None
        decision = replace(decision, selection=selection.rejecting_last(), notes=[
            *decision.notes, f"{name} would explain more of the gap, but {why}; it is left out"])


def _no_better(given: Model, improved: Model, runs: Sequence[Recording]) -> str | None:
    """Why the improved model is none for what is to be tracked, by all that both models miss of the recordings; None:
    it is one.

    What single recordings lose must be small beside what is gained: else an effect makes up for what the model missed
    anyway, and other movements may lose as well. Movement and zero count apart: a zero that is lost in one recording is
    no price for what another's movement gains.
    """
    missed = [[run.displacement_um - one.predicted_um for run, one in zip(runs, chain.simulate(model, runs))]
              for model in (given, improved)]
    moved, zero = (np.array([[of(left) for left in parts] for parts in missed])
                   for of in (np.var, lambda left: np.mean(left) ** 2))  # (models, runs)
    more = np.array([moved[1] - moved[0], zero[1] - zero[0]])
    lost = np.sum(np.maximum(more, 0.0), axis=0)
    if np.sum(lost) > thresholds.LOST * np.sum(np.maximum(-more, 0.0)):
        return f"{runs[int(np.argmax(lost))].path} would be predicted worse in movement or zero"
    shrinks = [shrink_of(now, then) for then, now in (moved, moved + zero)]
    if max(shrinks) < thresholds.LEAST_SHRINK:
        return f"all that the model misses would shrink by {100 * max(shrinks):.1f} % only"
    return None


def _entries(model: Model, selection: Selection, found: GapDocument, paired: bool) -> list[Any]:
    """The list `effects` of the improved model: one that has changed in its old place, others at the end."""
    entries = list(model.effects)
    state = selection.accepted
    for candidate, one in zip(state.chosen, found.effects):
        shown = state.dataset.monitored or candidate.effect.shows_stage
        entry = records.EffectEntry(name=one.name, stage=one.stage, column=one.column, parameters=one.parameters,
                                    origin="gap", stage_shown=True if shown else None, new=True if paired else None,
                                    was=one.was)
        place = effects.place(model, candidate.effect)
        if place is None:
            entries.append(entry.to_json())
            continue
        if model.effects[place].get("new"):  # the earlier recordings are from before that change as well
            entry = replace(entry, new=True, was=model.effects[place].get("was"))
        entries[place] = entry.to_json()
    return entries


@dataclass(frozen=True, eq=False)
class Decision:
    """The verdict, and what it rests on."""

    verdict: Verdict
    selection: Selection  # its accepted effects are those of the verdict
    gap: Excess
    coords: list[localise.Coordinates]  # of every recording
    notes: list[str]
    stuck: float  # share of the gap's energy where readings stand still before they jump, as they did not before
    held_back: str = ""  # why the improved model is the given one; "": it has the accepted effects


def decide(given: AugmentedModel, known: Passport | None, without: Sequence[str] = (),
           progress: Callable[[float], None] = lambda fraction: None) -> Decision:
    """Whether there is a gap beyond the passport `known`, and which effects explain it."""
    coords = [localise.coordinates(one.recording, one.predict(given.acting()), one.rate_um_per_s)
              for one in given.dataset.model_runs]
    gap = excess(given, known, coords)
    selection = beside.settled(select(given, gap, without, progress), gap)
    while len(selection.accepted.chosen) > 1 and document.may_be_as_before(selection):
        selection = selection.ended_before_last()
    runs, reached = given.recordings, selection.reached
    new = spectrum.against(known, runs, selection.before_um, coords)
    left = spectrum.against(known, runs, reached.residual_um, coords, reached.excused_um) if reached.chosen else new
    verdict = _verdict(selection, gap, new, left)
    notes = _remarks(selection, gap, verdict)
    chosen = selection.accepted.chosen
    if verdict in NAMED and not _sure(selection, gap, new) and _may_harm(selection):
        verdict = "none"
        notes.append(f"{chosen[0].effect.name} explains a part of the gap, but other recordings may as well be predicted "
                     "worse with it")
    notes += [f"monitor_V does not show {one}, which the model holds ahead of it: the effect acts behind the monitor; "
              "leave the column out to ask whether it has changed" for one in given.unseen_by_monitor()
              if not any(other.effect.replaces(one.effect) for other in chosen)]
    if chosen and given.dataset.monitored and rms(selection.after_um) > rms(selection.before_um):
        notes.append("the effects that monitor_V shows would make the residual larger, so the monitor is late, "
                     "filtered or wrong; leave its column out")
        verdict = "unknown" if _sure(selection, gap, new) else "none"
    stuck, said = _stuck(known, runs, selection.before_um, coords)
    untold = verdict not in NAMED or any(one.effect.stands_still for one in chosen)
    if stuck > (thresholds.STUCK if untold else thresholds.MOSTLY):
        verdict = "unknown"
    if verdict in ("unknown", "none"):
        selection = selection.rejecting_all()
    return Decision(verdict, selection, gap, coords, said + notes, stuck)


def _checked(model: Model, runs: Sequence[Recording], without: Sequence[str], earlier: Sequence[Recording]
             ) -> tuple[list[Recording], list[Recording], Passport | None, list[str]]:
    """The recordings, the earlier one of each, what to expect of them, and remarks.

    Raises BadInput for what cannot be diagnosed.
    """
    runs, earlier = taken(runs, RUN_COLUMNS, "runs", 1), taken(earlier, RUN_COLUMNS, "earlier")
    for name in arguments.listed(without, str, "without"):
        arguments.one_of(name, CATALOGUE, "without")
    arguments.of_kind(model, Model, "model").validate()
    effects.acting(model)  # before anything else reads them
    notes, known = checks.check_against(model, runs), passport.read(model)
    notes += [*checks.read_differently([*runs, *earlier], model), *checks.slow_sensors(runs)]
    if earlier:
        notes += [f"earlier, {note}" for note in checks.check_against(model, earlier) if any(
            note.startswith(run.path) for run in earlier)]
        given, earlier = earlier, checks.same_drives(runs, earlier)
        used = {one.path for one in earlier}
        notes += [f"{one.path}: was given as earlier, but no recording is compared with it" for one in given
                  if one.path not in used]
        known = None if known is None else passport.repeated(known)
        if any(not entry.get("new") and entry.get("origin") != "fit" for entry in model.effects):
            notes.append("the diagnosis assumes that the model's effects also acted in the earlier recordings")
        notes += [f"{run.path}: its memory is {run.memory}, but {then.memory} in its earlier recording; a different "
                  "start looks like a change" for run, then in zip(runs, earlier) if run.memory != then.memory]
    return runs, earlier, known, notes


def _offset(selection: Selection) -> Offset:
    """Mean of what each recording's displacement misses with all that act, beyond what the earlier one missed; no
    other figure counts it.

    The improved model's zero moves by their mean where they agree: where it exceeds what zeros scatter by, here and
    where the model was identified. Where they do not agree, it undoes what the effects do to it, as far as that brings it
    nearer to their mean. Creep and the room move one recording's zero and not the next one's.
    That of a recording of unknown memory holds what its plays remember: it counts only if there is no other.
    A zero that only the effects move has not moved: a gain turns about an end of the model's range, the actuator's about
    another place.

    Without accepted effects the improved model is the one that was given. Starts that the rounds came to may explain
    zeros then, but are in no model.
    """
    state, given = selection.accepted if selection.accepted.chosen else selection.with_starts, selection.given
    model, base = given.model, given.by_command
    now = [one.mean_residual_um(state.acting()) for one in state.by_command.model_runs]
    old = [one.mean_residual_um(given.acting()) for one in base.model_runs]
    then = [0.0] * len(now)
    if base.earlier:  # of the model that was given: where a refitted one lies is no change of the actuator's
        then = [one.mean_residual_um(base.acting_then) for one in base.earlier.model_runs]
    zeros, before = np.subtract(now, then), np.subtract(old, then)
    sure = np.array([run.memory != "unknown" for run in state.recordings])
    sure = sure if any(sure) else ~sure
    told = zeros[sure]
    agree, added = zeros_agree(model, told, compared=bool(base.earlier)), 0.0
    if len(told) == 1 and not base.earlier:  # it agrees with itself, and what was before it goes on creeping
        agree &= abs(float(told[0])) > thresholds.ZERO_ALONE * model.stroke_um
    if (known := passport.read(model)) and not base.earlier:
        astray_um = [passport.astray_um(known, {"position_um": run.displacement_um}) for run in state.recordings]
        agree &= abs(float(np.mean(told))) > max(astray_um)
    if agree and state.chosen:
        added = float(np.mean(told))
    elif state.chosen and not any(one.effect.starts_memory for one in state.chosen):
        taken_um = float(np.mean((zeros - before)[sure]))
        undone_um = float(np.clip(np.mean(told), min(taken_um, 0.0), max(taken_um, 0.0)))
        added = undone_um if abs(undone_um) > thresholds.ZERO_UNDONE * model.stroke_um else 0.0
    least = max(thresholds.ZERO * rms(selection.before_um), thresholds.MUCH_ZERO * model.stroke_um)
    return Offset(mean=float(np.mean(zeros)), low=float(min(zeros)), high=float(max(zeros)),
                  added=added,
                  moved=bool(agree and np.ptp(np.sign(zeros)) == 0 and min(*abs(zeros), *abs(before)) > least))


def _remarks_on_what_is_left(selection: Selection, verdict: Verdict, offset: Offset, noise_um: float,
                             axes: Sequence[localise.Axis], unknown: Sequence[NotKnown]) -> list[str]:
    """Zero, noise, and the place where the gap exceeds the passport most."""
    notes, before_um = [], rms(selection.before_um)
    if offset.moved:
        ends_um = dict.fromkeys(f"{end:.3g}" for end in (offset.low, offset.high))
        named = verdict in NAMED  # else a gain that is too small to be named moves the constants as well
        notes.append(f"the recordings also lie {' to '.join(ends_um)} um from "
                     f"{'the earlier ones' if selection.given.earlier else 'the model'}; these constants, one "
                     "a recording, are not counted; "
                     + ("the sensor's zero or the mount has changed" if named else
                        "the sensor's zero, the mount or the gain may have changed")
                     + ("; the improved model includes their mean" if offset.added else ""))
    if verdict == "unknown" and noise_um**2 > 0.5 * before_um**2:
        notes.append(f"most of the {_terms(selection).gap} is noise from sample to sample, {noise_um:.3g} um rms; "
                     "check the sensor and its cables")
    if verdict == "none" and (there := _elsewhere(axes, unknown, _terms(selection))):
        notes.append(there)
    return notes


def _terms(selection: Selection) -> Terms:
    return CHANGE if selection.given.earlier else GAP


def _elsewhere(axes: Sequence[localise.Axis], unknown: Sequence[NotKnown], words: Terms) -> str | None:
    """The bin that exceeds the passport most, where the whole does not; none that commissioning does not know."""
    def is_known(axis: localise.Axis, k: int) -> bool:
        return not any(one.axis == axis.name and one.low <= (axis.edges[k] + axis.edges[k + 1]) / 2 <= one.high
                       for one in unknown)

    worst = max(((float(axis.ratio[k]), float(axis.share[k]), axis, k) for axis in axes if axis.ratio is not None
                 for k in range(len(axis.share)) if axis.share[k] > thresholds.BIN_SHARE and is_known(axis, k)),
                key=lambda one: one[0], default=None)
    if worst is None or worst[0] < thresholds.BIN_RATIO:
        return None
    ratio, share, axis, k = worst
    return (f"the {words.gap} as a whole is not clearly more than expected, but {100 * share:.0f} % of it lies "
            f"{AXES[axis.name].place.format(axis.labels[k])}, {ratio:.2g} times what {words.usual_there}; this is too little "
            "to name a cause")


def _verdict(selection: Selection, gap: Excess, new: Spectrum, left: Spectrum) -> Verdict:
    """`new` is the spectrum of the gap, `left` that of what the best of every round leave."""
    first, whatever = selection.rounds[0], "unknown" if _sure(selection, gap, new) else "none"
    if first.best is None:
        return whatever
    # What slow movements show as well shows where commissioning moved, or need not be new. What goes on at rest does not
    # follow the movement.
    effect = first.best.effect
    anyway = effect.grows_with_rate or effect.slow or effect.disturbance or effect.starts_memory
    unseen = new.known < 1 - thresholds.MOSTLY and not (selection.given.earlier or anyway)
    if unseen and whatever == "none":
        return whatever
    if gap.ratio and not first.refitted:
        squares = _left(selection)
        explained = (gap.total - squares) / max(gap.total - gap.floor, 1e-300)
        if (1 - explained) * gap.left(squares) > thresholds.UNEXPLAINED:
            return whatever
        # What a wrong effect cannot follow is new at all frequencies, also where there is little energy.
        if left.everywhere > thresholds.LEFT_EVERYWHERE and 1 - explained > thresholds.LEFT_SHARE:
            return "unknown"
    return "ambiguous" if any(selection.rivals(one) for one in selection.rounds) else "effect"


def _stuck(known: Passport | None, runs: Sequence[Recording], gap_um: Sequence[np.ndarray],
           coords: Sequence[localise.Coordinates]) -> tuple[float, list[str]]:
    """Share of the gap's energy where readings stand still before they jump, 0 if they did at commissioning; and remarks on
    each recording.
    """
    where = [stick_slip.stuck(run.displacement_um, at["position_um"]) for run, at in zip(runs, coords)]
    then = max((run.stuck or 0.0 for run in known.runs), default=0.0) if known else 0.0
    share = stick_slip.share(np.concatenate(gap_um), np.concatenate(where))
    said = [stick_slip.remark(run.path, left, run.displacement_um, there) for run, left, there in zip(runs, gap_um, where)]
    return share if share > thresholds.STUCK_MORE * then else 0.0, [one for one in said if one]


def _may_harm(selection: Selection) -> bool:
    """Whether recordings that were left out may as well be predicted worse with an effect that all recordings share."""
    state = selection.accepted
    one, ci90 = state.chosen[0].effect, document.promised(selection, equations_of(state)).ci90
    return not (one.disturbance or one.starts_memory) and ci90 is not None and ci90[0] < 0


def _left(selection: Selection) -> float:
    """Sum of squares left with the best of every round, beyond what they leave whatever is known of them."""
    return max(0.0, selection.reached.squares)


def _sure(selection: Selection, gap: Excess, new: Spectrum) -> bool:
    """Whether the gap is one, whatever its cause. What lies where commissioning hardly moved need not be new, unless earlier
    recordings moved there as well.
    """
    if gap.ratio is None:
        return False
    share = 1.0 if selection.given.earlier else max(new.known, 1e-12)
    known = replace(gap, ratio=gap.ratio * float(np.sqrt(share)))
    detection = known.evidence_with(max(done.shape for done in selection.rounds))
    clear = thresholds.UNKNOWN * gap.threshold
    spread = max(gap.spread, thresholds.USUAL_SPREAD)
    return bool(detection > clear or np.log(known.ratio) > thresholds.SPREADS * spread
                or new.evidence * new.breadth * gap.trust > (
                    thresholds.SPECTRUM_FEW if gap.few else thresholds.SPECTRUM))


def _remarks(selection: Selection, gap: Excess, verdict: str) -> list[str]:
    notes, best, state = [], selection.rounds[0].best, selection.reached
    left = gap.left(_left(selection))
    if verdict == "unknown" and best is not None:
        notes.append(f"{best.name} explains a part of the gap, but leaves too much to be its cause")
    elif verdict in NAMED and state.chosen and gap.ratio and left > thresholds.MUCH_LEFT:
        notes.append(f"with {' and '.join(one.effect.name for one in state.chosen)}, the gap is still {left:.2g} times "
                     f"what {_terms(selection).usual}; the cause may be a similar effect that rdpi does not know")
    top = state.model.rate.identified_um_per_s
    fastest = max(float(np.percentile(one.rate_um_per_s, 99.9)) for one in state.dataset.model_runs)
    far = top and fastest > thresholds.OTHER_RATE * top
    if far and not np.any(state.model.slope_rate_s_per_um) and any(one.effect.hides_rate for one in state.chosen):
        notes.append(f"the model is rate-independent and was fitted up to {top:.3g} um/s, but these recordings "
                     f"reach {fastest:.3g} um/s; a rate dependence looks like a changed loop or gain; "
                     "record at several rates")
    return notes
