"""The promise for tracking: how far the improved model's inverse shrinks the error of what the actuator follows.

No board is needed. The improved model stands for the actuator as it is now. It is driven by the inverse of the model
that was given, and by its own. What both miss of a reference is the change that the effects make. Beside it stands what
no effect explains: what the passport expects of such a movement, and what the recordings show beyond that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import firmware
from ..data import Recording
from ..identify import localise, passport
from ..model import Model, Passport
from ..simulate import chain, effects, inverse_of
from . import thresholds
from .dataset import Dataset
from .sections import TrackingPromise
from .selection import Selection

DRAWS = 400


Bands = dict[int, float]  # um^2 in the octaves [2^k, 2^(k + 1)) Hz


@dataclass(frozen=True, eq=False)
class _Movement:
    """What goes with one recording, or with one reference; mean squares, means removed."""

    samples: int
    before: float  # what is missed without the effects
    after: Bands  # with them: of a recording measured, of a reference what the improved model's own inverse misses
    change: Bands  # what the effects change; of a reference what the inverse of the given model misses of them
    expected: Bands  # what the passport expects


def tracking(selection: Selection, improved: Model, known: Passport | None, coords: Sequence[localise.Coordinates],
             references: Sequence[Recording]) -> TrackingPromise | None:
    """The promise for these references, column reference_um.

    None without references or accepted effects. `known` is the passport of the model that was given, `coords` are those
    of the recordings. Raises BadInput if a model has no inverse.
    """
    if not references or not selection.accepted.chosen:
        return None
    given = selection.given.model
    tracked = [_tracked(given, improved, known, run) for run in references]
    runs = _recorded(selection, known, coords)
    if known is None:  # what is left is taken to grow with the movement
        size = np.mean([np.var(run.displacement_um) for run in selection.given.recordings])
        tracked = [replace(one, expected=_times(_mean(runs, "after"), float(np.nanvar(run.reference_um)) / size))
                   for one, run in zip(tracked, references)]
        runs = [replace(one, expected=one.after) for one in runs]
    level = thresholds.TRACKED_LEVEL
    promised = _shrink(runs, tracked, level)
    if len(runs) < 2:
        return TrackingPromise(shrink=promised, ci90=None)
    random = np.random.default_rng(0)
    levels = level * np.exp(2 * thresholds.TRACKED_SPREAD * random.standard_normal(DRAWS))
    drawn = [_shrink([runs[k] for k in random.integers(len(runs), size=len(runs))], tracked, float(one))
             for one in levels] + thresholds.TRACKED_SCATTER * random.standard_normal(DRAWS)
    low, high = np.percentile(drawn, (5, 95))
    return TrackingPromise(shrink=promised, ci90=(float(min(low, promised)), float(min(max(high, promised), 1.0))))


def out_of_reach(improved: Model, references: Sequence[Recording]) -> list[str]:
    """A remark for each reference that the actuator cannot follow within its drive's range."""
    low_um, high_um = chain.reachable_um(inverse_of(improved).model)
    return [f"{run.path}: {share:.0%} of the reference is beyond what the drive's range reaches, {low_um:.5g} to "
            f"{high_um:.5g} um; the promise for tracking includes what stays out of reach there"
            for run in references
            if (share := float(np.mean((run.reference_um < low_um) | (run.reference_um > high_um)))) > 0]


def entries(selection: Selection) -> list[dict[str, Any]]:
    """All effects that act, as the improved model's file holds them."""
    given, dataset, found = selection.given.model, selection.accepted.dataset, []
    new = [one.effect for one in selection.accepted.chosen]
    for acting, entry in zip(selection.accepted.acting(), effects.entries(selection.accepted.acting())):
        place = effects.place(given, acting.effect)
        held = {"origin": "gap"} if place is None else given.effects[place]
        shown = acting.effect in new and (dataset.monitored or acting.effect.shows_stage)
        found.append({**held, **entry, **({"stage_shown": True} if shown else {})})
    return found


def _shrink(runs: Sequence[_Movement], tracked: Sequence[_Movement], level: float) -> float:
    """Of the tracking error; `level` times what these recordings say that no effect explains."""
    after, change, expected = (_mean(runs, name) for name in ("after", "change", "expected"))
    left, usual, moved = (sum(bands.values()) for bands in (after, expected, change))
    # What the model missed anyway may cancel a part of the change, or add to it.
    gained = max(_weighted(runs, [one.before for one in runs]) - left, 0.0) / max(moved, 1e-300)
    factor = min(1.0, left / max(usual, 1e-300))
    beyond = {k: min(max(0.0, value - expected.get(k, 0.0)) / max(change.get(k, 0.0), 1e-300), thresholds.MOST_BEYOND)
              for k, value in after.items()} if left > usual else {}
    now, then = [], []
    for one in tracked:
        unexplained = factor * sum(one.expected.values()) + sum(beyond.get(k, 0.0) * value
                                                                for k, value in one.change.items())
        own = sum(one.after.values())
        less = sum(one.change.values()) - own
        now.append(level * unexplained + own)
        then.append(now[-1] + (gained if less > 0 else 1.0) * less)
    return float(1 - np.sqrt(_weighted(tracked, now) / max(_weighted(tracked, then), 1e-300)))


def _weighted(movements: Sequence[_Movement], values: Sequence[float]) -> float:
    return float(np.average(values, weights=[one.samples for one in movements]))


def _mean(movements: Sequence[_Movement], name: str) -> Bands:
    """Over all samples."""
    octaves = {k for one in movements for k in getattr(one, name)}
    return {k: _weighted(movements, [getattr(one, name).get(k, 0.0) for one in movements]) for k in octaves}


def _times(bands: Bands, factor: float) -> Bands:
    return {k: factor * value for k, value in bands.items()}


def _bands(signal: np.ndarray, sample_rate_hz: float) -> Bands:
    found = passport.octaves(signal - np.mean(signal), sample_rate_hz)
    return dict(enumerate(found.power.tolist(), found.first))


def _expected(known: Passport | None, at: localise.Coordinates, signal: np.ndarray, sample_rate_hz: float) -> Bands:
    if known is None:
        return {}
    spectrum = passport.octaves(signal - np.mean(signal), sample_rate_hz)
    power = passport.expected_octaves(known, at, spectrum, sample_rate_hz)
    return dict(enumerate(np.asarray(power).tolist(), spectrum.first))


def _without_disturbances(model: Model) -> Model:
    return replace(model, effects=effects.entries(one for one in effects.acting(model) if not one.effect.disturbance))


def _tracked(given: Model, improved: Model, known: Passport | None, run: Recording) -> _Movement:
    """A reference behind the start-up sweep and the inverses of both models; the improved one is the actuator."""
    actuator, wanted, rate_hz, missed = _without_disturbances(improved), run.reference_um, run.sample_rate_hz, []
    wanted = np.where(np.isfinite(wanted), wanted, np.nanmean(wanted))
    for model in (given, improved):
        by = inverse_of(model)
        library = firmware.engine(by.model, run.sample_time_s, "f64", by.chain if by.chain.acts else None,
                                  any_sample_time=True)
        end_V = library.sweep()[0][-1:]  # where the sweep ends; what it leaves, the models say themselves
        drive_V = library.step(firmware.ahead(by.wanted_um(run, wanted), library.preview_samples)).drive_V
        columns = {name: np.concatenate([values[:1], values]) for name, values in run.columns.items()
                   if name != "displacement_um"}
        columns["time_s"] = np.arange(1 + len(wanted)) * run.sample_time_s
        columns["command_V"] = np.concatenate([end_V, drive_V]).astype(float)
        swept = replace(run, columns=columns, metadata={**run.metadata, "memory": "reset"})
        (found,) = chain.simulate(actuator, [swept], "reset")
        missed.append(found.predicted_um[1:] - wanted)
    driven = replace(run, columns={"time_s": run.time_s, "command_V": drive_V.astype(float)})
    at = localise.coordinates(driven, found.predicted_um[1:], found.rate_um_per_s[1:])
    return _Movement(len(wanted), float(np.var(missed[0])), _bands(missed[1], rate_hz), _bands(missed[0], rate_hz),
                     _expected(known, at, missed[0], rate_hz))


def _recorded(selection: Selection, known: Passport | None, coords: Sequence[localise.Coordinates]) -> list[_Movement]:
    """All that the displacement misses, also where earlier recordings took a part of it off."""
    state, runs = selection.accepted, selection.given.recordings
    dataset = state.started(Dataset(state.model, runs, monitored=False))
    acting = dataset.predict(state.acting())
    given = dataset if state.model is selection.given.model else Dataset(selection.given.model, runs, monitored=False)
    plain = given.predict(state.known)
    parts = zip(runs, coords, *(dataset.split(one) for one in (dataset.measured - plain, dataset.measured - acting,
                                                               acting - plain)))
    return [_Movement(len(run), float(np.mean(before**2)), _bands(after, run.sample_rate_hz),
                      _bands(change, run.sample_rate_hz), _expected(known, at, after, run.sample_rate_hz))
            for run, at, before, after, change in parts]
