"""The next experiment: of a few canned drives the one that tells the surviving effects apart best per second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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
from .selection import Selection

CANNED: tuple[tuple[str, dict[str, Any]], ...] = (
    ("sawtooth", {"cycles": 2}), ("steps", {"levels": 3, "hold_s": 1.0}), ("steps", {"levels": 2, "hold_s": 5.0}),
    ("minor-loops", {"levels": 4}), ("multisine", {"duration_s": 10.0}), ("sine", {"cycles": 3}),
    ("chirp", {"duration_s": 5.0}), ("startup", {}))
SMALL = 0.1  # of the drive's range
CHIRP_S = 10.0  # where nothing is known yet
LONGEST = 120_000  # samples of a drive that is simulated


def propose(selection: Selection, verdict: Verdict, unseen: Sequence[NotKnown] = ()) -> NextExperiment | None:
    """The canned recording that would tell the survivors apart best per second of bench time; what shows most of what
    is not known from commissioning, where the gap lies there and has no name.
    """
    state = selection.accepted
    if verdict in ("unknown", "none") and (most := max(unseen, key=lambda one: one.share, default=None)) \
            and most.share > thresholds.MOSTLY:
        return _commissioning(state, most)
    if verdict == "unknown":
        why = "fast edges and holds show what kind of motion is missing; record a column monitor_V too"
        limits = _limits(state)
        return NextExperiment(command=_command(limits, "steps", {"levels": 3, "hold_s": 1.0}), why=why, seconds=None)
    open_ = next((done for done in selection.rounds if selection.rivals(done)), None) if verdict == "ambiguous" else None
    if open_ is None:
        return None
    truth, rivals = selection.final(open_), selection.rivals(open_)
    at_hand = _shown(state, truth, min(state.recordings, key=len))
    known, best = passport.read(state.model), None
    for kind, options in CANNED:
        try:
            limits = _limits(state, kind)
            columns, _ = excite.make_drive(kind, limits, **options)
            if (times := len(columns["time_s"]) / LONGEST) > 1:  # judged at fewer samples per second
                limits = replace(limits, sample_rate_hz=limits.sample_rate_hz / times)
                columns, _ = excite.make_drive(kind, limits, **options)
            seconds = float(columns["time_s"][-1])
            metadata = {"memory": "reset", "sample_rate_hz": f"{limits.sample_rate_hz:.12g}"}
            drive = Recording("next.csv", metadata, columns)
            dataset = Dataset(state.model, [_shown(state, truth, drive), at_hand], monitored=False)
            apart = min(_apart(dataset, state.known, rival.effect) for rival in rivals)
            worth = apart / _missed(state, known, drive) ** 2 / seconds
        except BadInput:  # this drive is not to be had, or not to be simulated
            continue
        if best is None or worth > best[0]:
            best = worth, apart / len(drive), kind, options, seconds
    if best is None:
        return None
    names = " and ".join([truth.effect.name, *dict.fromkeys(rival.name for rival in rivals)])
    why = f"of the canned recordings, this one tells {names} apart best per second"
    if best[1] < float(np.mean(state.residual**2)) / 4:
        why += "; if it does not, a column monitor_V will separate causes before the actuator from causes after it"
    if state.earlier:
        why += "; no earlier recording has this drive, so it helps only if the change also shows without --earlier"
    return NextExperiment(command=_command(_limits(state, best[2]), best[2], best[3]), why=why, seconds=best[4])


def _commissioning(state: AugmentedModel, unknown: NotKnown) -> NextExperiment | None:
    """The drive that goes where commissioning did not: no further, and no faster, than these recordings."""
    limits, options = _limits(state), {}
    if unknown.axis == "position_um":
        kind, seen = "commission", [run.command_V for run in state.recordings]
        limits = replace(limits, min_V=min(limits.min_V, *map(np.min, seen)), max_V=max(limits.max_V, *map(np.max, seen)))
    else:
        top_hz = min(unknown.high, limits.sample_rate_hz / excite.SAMPLES_PER_PERIOD)
        kind, options = "chirp", {"frequencies_hz": (unknown.low / 4, top_hz), "duration_s": CHIRP_S}
        half_V = unknown.moved_um / abs(state.model.gain_um_per_V * float(state.model.slopes[-1]))
        fastest = signals.fastest_V_per_s(state.recordings)
        slew_V = min(limits.slew_V_per_s or np.inf, fastest) / (2 * np.pi * top_hz)
        limits = _amid(limits, min(half_V, slew_V, (limits.max_V - limits.min_V) / 2))
    try:
        columns, _ = excite.make_drive(kind, limits, **options)
    except BadInput:  # the sample rate is too low, or the range too small
        return None
    why = f"this drive goes where commissioning did not: {unknown.low:.4g} to {unknown.high:.4g} {unknown.unit}; give " \
          "its recording to `rdpi fit` with those of commissioning, and ask again"
    return NextExperiment(command=_command(limits, kind, options), why=why, seconds=float(columns["time_s"][-1]))


def _limits(state: AugmentedModel, kind: str = "") -> excite.Limits:
    """The model's drive; for a chirp, which reaches resonances, a tenth of its range about the middle."""
    drive = state.model.drive
    limits = excite.Limits(drive.min_V, drive.max_V, sample_rate_hz=max(run.sample_rate_hz for run in state.recordings),
                           slew_V_per_s=drive.slew_V_per_s)
    return _amid(limits, SMALL * (drive.max_V - drive.min_V) / 2) if kind == "chirp" else limits


def _amid(limits: excite.Limits, half_V: float) -> excite.Limits:
    """So far to both sides of the middle."""
    middle_V = (limits.min_V + limits.max_V) / 2
    return replace(limits, min_V=middle_V - half_V, max_V=middle_V + half_V)


def _command(limits: excite.Limits, kind: str, options: dict[str, Any]) -> str:
    parts = ["rdpi excite", kind, "-o next.csv", f"--min-V {limits.min_V:.12g}", f"--max-V {limits.max_V:.12g}",
             f"--sample-rate {limits.sample_rate_hz:.12g}"]
    if limits.slew_V_per_s is not None:
        parts.append(f"--slew {limits.slew_V_per_s:.12g}")
    return " ".join(parts + [f"--{excite.OPTION_NAMES[name]} " + ",".join(f"{one:g}" for one in np.atleast_1d(value))
                             for name, value in options.items()])


def _apart(dataset: Dataset, known: Sequence[Acting], rival: Effect) -> float:
    """Sum of squares that the rival leaves of what the truth would show in a drive and in a recording at hand.

    It is fitted to both: what happens to be alike in the one differs in the other.
    """
    before = dataset.predict(known)
    found = candidates.search(dataset, rival, known, before)
    left = dataset.measured - before
    return float(np.sum((left if found is None else left - found.change) ** 2))


def _shown(state: AugmentedModel, truth: Candidate, run: Recording) -> Recording:
    """What an actuator that is the model with this effect would show."""
    shown = model_runs(state.model, [run], False)[0].predict(effects.beside(state.known, truth.acting))
    if truth.per_run:
        columns = truth.effect.columns(run, truth.values, state.model)
        shown = shown + columns @ truth.effect.usual_sizes(truth.values)
    return replace(run, columns={**run.columns, "displacement_um": shown})


def _missed(state: AugmentedModel, known: Passport | None, drive: Recording) -> float:
    """rms in um that the model is expected to miss in this drive anyway; 1 where that is not known."""
    if known is None:
        return 1.0
    (one,) = model_runs(state.model, [drive], False)
    return passport.level_um(known, localise.coordinates(drive, one.predict(state.known), one.rate_um_per_s))
