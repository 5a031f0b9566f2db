"""The promise for tracking: how far the improved model's inverse shrinks the error of what the actuator follows.

No board is needed. The improved model stands for the actuator as it is now. It is driven by the inverse of the model
that was given, and by its own. What both miss of a reference is the change that the effects make. Beside it stands what
no effect explains: what the passport expects of such a movement, and what the recordings show beyond that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..data import Recording
from ..errors import BadInput
from ..fit import localise, passport
from ..model import Model, Passport
from ..simulate import chain, effects, inverse_of
from . import thresholds
from .dataset import Dataset
from .sections import TrackingPromise
from .selection import Selection

DRAWS = 400


@dataclass(frozen=True, eq=False)
class _Left:
    """Mean squares in um^2 of each recording, (recordings,), and its length in samples."""

    after: np.ndarray  # what the prediction misses with the effects, disturbances apart
    expected: np.ndarray  # what the passport expects
    change: np.ndarray  # what the effects change
    samples: np.ndarray

    def factors(self, drawn: np.ndarray) -> tuple[float, float]:
        """Of what the passport expects, and of what the effects change: they add up to what is left."""
        weight = self.samples[drawn]
        after, expected, change = (float(weight @ part[drawn]) for part in (self.after, self.expected, self.change))
        if after <= expected or change <= 0:
            return after / max(expected, 1e-300), 0.0
        return 1.0, (after - expected) / change


def tracking(selection: Selection, improved: Model, known: Passport | None, coords: Sequence[localise.Coordinates],
             references: Sequence[Recording]) -> TrackingPromise | None:
    """The promise for these references, column reference_um; without any, for the movements of the recordings.

    None without accepted effects, and if a model has no inverse. `known` is the passport of the model that was given,
    `coords` are those of the recordings.
    """
    if not selection.accepted.chosen:
        return None
    given = replace(selection.given.model, effects=effects.entries(selection.given.known))
    try:
        profiles = list(references) or [_asked(given, run) for run in selection.given.recordings]
        before, after, expected, samples = _simulated(given, improved, known, profiles)
    except BadInput:
        return None
    left = _left(selection, known, coords)
    if known is None:  # what is left is taken to grow with the movement
        span = np.mean([np.std(run.displacement_um) for run in selection.given.recordings]) ** 2
        expected = np.array([float(np.nanstd(run.columns["reference_um"])) ** 2 / span for run in profiles]) * left.expected[0]
    runs = np.arange(len(left.after))

    def shrink(drawn: np.ndarray, level: float) -> float:
        factor, share = left.factors(drawn)
        unexplained = level * (factor * expected + share * before)
        return float(1 - np.sqrt(samples @ (after + unexplained) / max(samples @ (before + unexplained), 1e-300)))

    if len(runs) < 2:
        return TrackingPromise(shrink=shrink(runs, 1.0), ci90=None)
    random = np.random.default_rng(0)
    sigma = thresholds.TRACKED_SPREAD
    found = [shrink(random.integers(len(runs), size=len(runs)), float(np.exp(2 * sigma * random.standard_normal())))
             for _ in range(DRAWS)]
    low, high = np.percentile(found, (5, 95))
    return TrackingPromise(shrink=shrink(runs, 1.0), ci90=(float(low), float(high)))


def _asked(given: Model, run: Recording) -> Recording:
    """What the inverse of the model was asked for, had it made the drive of a recording."""
    (found,) = chain.simulate(_without_disturbances(given), [run])
    return replace(run, columns={"time_s": run.time_s, "reference_um": found.predicted_um},
                   metadata={**run.metadata, "memory": "reset"})


def _without_disturbances(model: Model) -> Model:
    return replace(model, effects=effects.entries(one for one in effects.acting(model) if not one.effect.disturbance))


def _simulated(given: Model, improved: Model, known: Passport | None, profiles: Sequence[Recording]
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of each reference: mean squares of what the improved model, driven by both inverses, misses of it; what the
    passport expects of the movement; samples.
    """
    actuator, rows = _without_disturbances(improved), []
    for run in profiles:
        wanted, missed = run.columns["reference_um"], []
        for model in (given, improved):
            steps, _ = chain.follow(model, run, engine="f64", by=inverse_of(model))
            driven = replace(run, columns={**run.columns, "command_V": steps.drive_V.astype(float)},
                             metadata={**run.metadata, "memory": "reset"})
            (found,) = chain.simulate(actuator, [driven])
            missed.append(float(np.nanvar(found.predicted_um - wanted)))
        at = localise.coordinates(driven, found.predicted_um, found.rate_um_per_s)
        rows.append([*missed, 0.0 if known is None else float(np.mean(passport.expected_um(known, at) ** 2)),
                     len(wanted)])
    before, after, expected, samples = np.array(rows).T
    return before, after, expected, samples


def _left(selection: Selection, known: Passport | None, coords: Sequence[localise.Coordinates]) -> _Left:
    state = selection.accepted
    # all that the displacement misses, also where earlier recordings took a part of it off
    dataset = state.started(Dataset(state.model, state.recordings, monitored=False))
    acting = dataset.predict(state.acting())
    after = np.array([np.mean(part**2) for part in dataset.split(dataset.measured - acting)])
    change = np.array([np.mean(part**2) for part in dataset.split(acting - dataset.predict(state.known))])
    expected = np.full(len(after), np.mean(after)) if known is None else \
        np.array([np.mean(passport.expected_um(known, at) ** 2) for at in coords])
    return _Left(after, expected, change, np.array(dataset.lengths, float))
