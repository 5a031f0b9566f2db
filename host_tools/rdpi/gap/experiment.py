"""The next experiment: of a few canned drives the one that tells the surviving effects apart best per second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..data import Recording, excite
from ..errors import BadInput
from ..identify import localise, passport
from ..model import Passport
from ..simulate import effects, signals
from ..simulate.effects import Acting, Effect
from . import candidates, thresholds
from .augmented import AugmentedModel
from .candidates import Candidate
from .dataset import Dataset, model_runs
from .sections import NextExperiment, NotKnown, Verdict
from .selection import Score, Selection

CANNED: tuple[tuple[str, dict[str, Any]], ...] = (
    ("sawtooth", {"cycles": 2}), ("steps", {"levels": 3, "hold_s": 1.0}), ("steps", {"levels": 2, "hold_s": 5.0}),
    ("minor-loops", {"levels": 4}), ("multisine", {"duration_s": 10.0}), ("sine", {"cycles": 3}),
    ("chirp", {"duration_s": 5.0}), ("startup", {}))
# Where nothing has a name.
SHOWING: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("steps", {"levels": 2, "hold_s": 5.0}, "fast edges and long holds show what kind of motion is missing"),
    ("chirp", {"duration_s": 10.0}, "small movements of all frequencies show whether it depends on the amplitude"),
    ("minor-loops", {"levels": 4}, "loops of all sizes show whether it is the hysteresis"))
SMALL, LEAST_WIDTH = 0.1, 1e-3  # of the drive's range
CHIRP_S, CHIRP_PERIODS, LITTLE_S = (10.0, 120.0), 3.0, 20.0  # where nothing is known yet; and of small movements
LONGEST = 120_000  # samples of a drive that is simulated
SAME, SAME_LENGTH = 0.9, 0.05  # correlation, and share of the length, of two recordings of the same drive


@dataclass(frozen=True)
class Drive:
    """A canned drive, and what its recording is expected to show."""

    kind: str
    options: dict[str, Any]
    seconds: float
    contrast: float  # squares that the nearest rival leaves of what the effect shows, over those that the model misses;
    # less of those whose shape may be the model's own


def propose(selection: Selection, verdict: Verdict, unseen: Sequence[NotKnown] = ()) -> NextExperiment | None:
    """The canned recording that would tell the survivors apart best, of those that are not there yet; what shows most of
    what is not known from commissioning, where the gap lies there and has no name.
    """
    state = selection.accepted
    if verdict in ("unknown", "none") and (most := max(unseen, key=lambda one: one.share, default=None)) \
            and most.share > thresholds.MOSTLY and (there := _commissioning(state, most)) is not None:
        return there
    if verdict == "unknown":
        for kind, options, why in SHOWING:
            if _missing(state, kind, options) is not None:
                return NextExperiment(command=excite.command_line(kind, _limits(state, kind), "next.csv", **options),
                                      why=f"{why}; record a column monitor_V too", seconds=None)
        return None
    done = next((done for done in selection.rounds if selection.rivals(done)), None) if verdict == "ambiguous" else None
    if done is None:
        return None
    truth, rivals = selection.final(done), selection.rivals(done)
    drives = _drives(state, truth, rivals)
    if not drives:
        return None
    most, enough = max(one.contrast for one in drives), thresholds.RIVAL_MARGIN + thresholds.LACKING
    least = min(most, max(thresholds.AS_GOOD * most, enough))
    best = min((one for one in drives if one.contrast >= least), key=lambda one: one.seconds)
    names = " and ".join([truth.effect.name, *dict.fromkeys(rival.name for rival in rivals)])
    why = f"of the canned recordings that are not there yet, this one tells {names} apart best"
    weak = best.contrast < enough
    if weak:
        why += ", but hardly beside what the model misses anyway"
    why += ". Give its recording beside these"
    if state.earlier:
        why += ", without --earlier and with --no-kept, for no earlier recording has this drive"
    if weak:
        why += ". More may be told by the drive of commissioning, played again and given " + (
            "alone: what its copy that was kept shows is taken off" if state.model.kept else
            "with --earlier, which takes off what the model misses")
        why += ". A column monitor_V would separate causes before the actuator from causes after it"
    return NextExperiment(command=excite.command_line(best.kind, _limits(state, best.kind), "next.csv", **best.options), why=why,
                          seconds=best.seconds)


def _drives(state: AugmentedModel, truth: Candidate, rivals: Sequence[Score]) -> list[Drive]:
    """The canned drives that are to be had, to be simulated, and not among the recordings."""
    at_hand = _shown(state, truth, min(state.recordings, key=len))
    known, found = passport.read(state.model), []
    for kind, options in CANNED:
        columns, limits = _missing(state, kind, options), _limits(state, kind)
        if columns is None:
            continue
        seconds = float(columns["time_s"][-1])
        try:
            if (times := len(columns["time_s"]) / LONGEST) > 1:  # judged at fewer samples per second
                limits = replace(limits, sample_rate_hz=limits.sample_rate_hz / times)
                columns, _ = excite.make_drive(kind, limits, **options)
            drive = Recording("next.csv", {"memory": "reset", "sample_rate_hz": f"{limits.sample_rate_hz:.12g}"}, columns)
            dataset = Dataset(state.model, [_shown(state, truth, drive), at_hand], monitored=False)
            apart = min(_apart(dataset, state.known, rival.effect) for rival in rivals)
            contrast = apart * (_trusted(state, known, drive) if known else 1.0)
        except BadInput:  # this drive is not to be had, or not to be simulated
            continue
        found.append(Drive(kind, options, seconds, contrast))
    return found


def _missing(state: AugmentedModel, kind: str, options: dict[str, Any], limits: excite.Limits | None = None
             ) -> dict[str, np.ndarray] | None:
    """Columns of a drive; None: it is not to be had, or a recording is of it, with its sweep or without."""
    try:
        drive, metadata = excite.make_drive(kind, limits or _limits(state, kind), **options)
    except BadInput:
        return None
    for begin_s in (0.0, float(metadata.get("sweep_s", 0.0))):
        time_s, command_V = (drive[name][drive["time_s"] >= begin_s] for name in ("time_s", "command_V"))
        for run in state.recordings:
            since_s = run.time_s - run.time_s[0]
            as_long = abs(since_s[-1] / (time_s[-1] - time_s[0]) - 1) < SAME_LENGTH
            if as_long and np.corrcoef(command_V, np.interp(time_s - time_s[0], since_s, run.command_V))[0, 1] > SAME:
                return None
    return drive


def _commissioning(state: AugmentedModel, unknown: NotKnown) -> NextExperiment | None:
    """The drive that goes where commissioning did not: no further, and no faster, than these recordings."""
    limits, options = _limits(state), {}
    where, otherwise = f"goes where commissioning did not: {unknown.low:.4g} to {unknown.high:.4g} {unknown.unit}", ""
    if unknown.axis == "position_um":
        kind, seen = "commission", [run.command_V for run in state.recordings]
        limits = replace(limits, min_V=min(limits.min_V, *map(np.min, seen)), max_V=max(limits.max_V, *map(np.max, seen)))
    elif unknown.axis == "movement_um":
        span_V = limits.max_V - limits.min_V
        mostly_V = [float(np.ptp(np.percentile(run.command_V, (10, 90)))) for run in state.recordings]  # not the way there
        least_V = [width_V for width_V in mostly_V if width_V > LEAST_WIDTH * span_V]
        kind, options, limits = "commission", {"duration_s": LITTLE_S}, _amid(limits, min([*least_V, SMALL * span_V]) / 2)
        where = "moves as little as these recordings, and commissioning did not"
        otherwise = "; if it may have changed, play the drive of commissioning again and give its recording to `rdpi gap`"
    else:
        top_hz = min(unknown.high, limits.sample_rate_hz / excite.RINGING_SAMPLES)
        duration_s = float(np.clip(CHIRP_PERIODS / unknown.low, *CHIRP_S))
        kind = "chirp"
        options = {"frequencies_hz": (max(unknown.low / 4, 1 / duration_s), top_hz), "duration_s": duration_s}
        half_V = unknown.moved_um / abs(state.model.gain_um_per_V * float(state.model.slopes[-1]))
        fastest = signals.fastest_V_per_s(state.recordings)
        slew_V = min(limits.slew_V_per_s or np.inf, fastest) / (2 * np.pi * top_hz)
        limits = _amid(limits, min(half_V / _amplified(state, top_hz), slew_V, (limits.max_V - limits.min_V) / 2))
    if (columns := _missing(state, kind, options, limits)) is None:  # or the rate is too low, or the range too small
        return None
    why = f"this drive {where}; if the actuator is as it was, give its recording to `rdpi fit` with those of commissioning, " \
          f"and ask again{otherwise}"
    return NextExperiment(command=excite.command_line(kind, limits, "next.csv", **options), why=why, seconds=float(columns["time_s"][-1]))


def _limits(state: AugmentedModel, kind: str = "") -> excite.Limits:
    """The model's drive; for a chirp, which reaches resonances, a tenth of its range about the middle, and no more than
    rings over all of it.
    """
    drive = state.model.drive
    limits = excite.Limits(drive.min_V, drive.max_V, sample_rate_hz=max(run.sample_rate_hz for run in state.recordings),
                           slew_V_per_s=drive.slew_V_per_s)
    if kind != "chirp":
        return limits
    share = min(SMALL, 1 / _amplified(state, limits.sample_rate_hz / excite.RINGING_SAMPLES))
    return _amid(limits, share * (drive.max_V - drive.min_V) / 2)


def _amplified(state: AugmentedModel, highest_hz: float) -> float:
    """What the model's resonances make of a movement at most, at frequencies up to this one."""
    return float(np.prod([one.effect.amplification(one.values, highest_hz) for one in state.known]))


def _amid(limits: excite.Limits, half_V: float) -> excite.Limits:
    """So far to both sides of the middle, in three digits, after a sweep over all of the range."""
    middle_V, half_V = (limits.min_V + limits.max_V) / 2, float(f"{half_V:.3g}")
    return replace(limits, min_V=middle_V - half_V, max_V=middle_V + half_V, sweep_V=(limits.min_V, limits.max_V))


def _apart(dataset: Dataset, known: Sequence[Acting], rival: Effect) -> float:
    """Squares, mean over a drive, that the rival leaves of what the truth would show there.

    It is fitted to the drive and to a recording at hand: what happens to be alike in the one differs in the other.
    """
    before = dataset.predict(known)
    found = candidates.search(dataset, rival, known, before)
    left = dataset.measured - before
    left, _ = dataset.split(left if found is None else left - found.change)
    return float(np.mean(left**2))


def _shown(state: AugmentedModel, truth: Candidate, run: Recording) -> Recording:
    """What an actuator that is the model with this effect would show."""
    shown = model_runs(state.model, [run], False)[0].predict(effects.beside(state.known, truth.acting))
    if truth.per_run:
        columns = truth.effect.columns(run, truth.values, state.model)
        shown = shown + columns @ truth.effect.usual_sizes(truth.values)
    return replace(run, columns={**run.columns, "displacement_um": shown})


def _trusted(state: AugmentedModel, known: Passport, drive: Recording) -> float:
    """What a square that this drive shows counts: over those that the model is expected to miss in it anyway, and less
    where it moves less than commissioning, as `Excess.little` will.
    """
    (one,) = model_runs(state.model, [drive], False)
    at = localise.coordinates(drive, one.predict(state.known), one.rate_um_per_s)
    return (1 - passport.too_small(known, at)) / passport.level_um(known, at) ** 2
