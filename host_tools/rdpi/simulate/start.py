"""Where a recording of unknown memory began, estimated from how it goes on.

Not known are the plays, what relaxation and creep still owe of a move before the first sample, and, where the rate passes a
low-pass, the rate before. The plays
that a history leaves are a function of the threshold whose slope lies between -1 and 1, so that as many slopes are
sought, within these bounds. What the poles owe follows from where the actuator had been and when it left, of which any
time is as likely as ten times it. All are linear near by: the estimate is the maximum of their posterior (Gauss and
Newton), beside a constant. What the model misses anyway is correlated from sample to sample, and so many samples count
as are independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .. import firmware
from ..data import Past, Recording
from ..model import Model, operators
from . import effects, signals
from .memory import states_after, warm_up
from .plant import Plant, Ran, State

ROWS = 6000  # of the samples that are looked at, about so many count: more say no more
LAST = 3  # times as long as plays remember is looked at where no pole owes anything: what comes after shows the constant
STEPS = 12  # of Gauss and Newton at most
HALVINGS = 4  # of one that went too far
ENOUGH = 0.01  # of the cost: a step that gains less is the last
POSITIONS = 9  # from which the input may have come straight, tried to begin with
SLOPE_SPREAD = 3**-0.5  # standard deviation of a slope that is as likely anywhere from -1 to 1
AWAY = 3**-0.5 / 2  # [stroke] that of a place in the range, from its middle
LEAST = 1e-9  # [stroke] missed is rounding
NEAR = 1e-3  # step of derivatives through what stands behind the operator
LEFT_S = np.geomspace(1e-3, 1e5, 17)  # when the actuator may have left there


class Estimate(NamedTuple):
    """A start, and what it was estimated from."""

    state: State
    plays_um: np.ndarray  # (n + 1,)
    past: Past
    samples: int  # that depended on the plays at the start
    rms_um: float  # missed in the samples that were looked at, a constant apart


def estimated(plant: Plant, run: Recording) -> Estimate:
    """The start of a recording that has a displacement."""
    return _Search(plant, run).found()


def doubted(plant: Plant, run: Recording) -> tuple[float, float]:
    """What is missed of the samples that depend on the start, um rms, after a sweep and after the past that suits them
    best.
    """
    search = _Search(plant, run)
    if search.remembered < 2:
        return 0.0, 0.0
    early = search.rows < search.remembered
    swept, best = (search.missed_from(state)[0][early] for state in (
        search.smooth.swept(search.first_V), estimated(plant, run).state))
    return float(np.sqrt(np.mean(swept**2))), float(np.sqrt(np.mean(best**2)))


def started(model: Model, runs: Sequence[Recording]) -> list[Recording]:
    """The recordings, those of unknown memory with the past that this model estimates."""
    return [run if run.memory != "unknown" else
            replace(run, past=estimated(Plant(model, run.sample_time_s), run).past) for run in runs]


def _unexplained(missed: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """What no start explains, near by."""
    return missed - jacobian @ np.linalg.lstsq(jacobian, missed, rcond=None)[0]


class _Search:
    """One recording beside a plant. Unknowns: slopes of the plays' memory, what the poles owe, and the rate as a share of the
    highest.
    """

    def __init__(self, plant: Plant, run: Recording) -> None:
        self.plant, self.run = plant, run
        # Readings that are rounded have no derivatives; what is missed is missed by them as well.
        smooth = [one for one in plant.acting if not one.effect.reading_step_um(one.values)]
        self.smooth = plant if len(smooth) == len(plant.acting) else Plant(
            replace(plant.model, effects=effects.entries(smooth)), plant.sample_time_s)
        self.first_V = float(run.command_V[0])
        model = self.model = plant.operator
        self.x0_um = float(model.x_of(plant.driven_V(self.first_V)))
        self.gaps_um = np.diff(model.thresholds_um)
        x_um = model.x_of(effects.driven(plant.acting, run.command_V, run, plant.model))
        self.remembered = warm_up(x_um, model.thresholds_um[-1]) if len(self.gaps_um) else 0
        self.moves = len(LEFT_S) if len(self.smooth.poles_s) else 0
        law = model.rate
        self.rates = int(law.filter_s > 0 and bool(np.any(model.slope_rate_s_per_um)))
        self.top_um_per_s = law.identified_um_per_s or law.max_um_per_s
        length = len(run) if self.moves else min(len(run), LAST * max(self.remembered, 1))
        self.used = slice(0, length)
        self.columns = {name: values[self.used] for name, values in run.columns.items()}
        self.rows = signals.uneven(0, length, max(1, length // ROWS))
        self.owing = self._owing()
        self.prior = self._prior()

    def found(self) -> Estimate:
        reach = np.linspace(-1, 1, POSITIONS) * self.model.thresholds_um[-1]
        straight = [self._slopes(states_after(self.x0_um + far, self.x0_um, self.model.thresholds_um)) for far in reach]
        count, moves = len(self.gaps_um), np.zeros(self.moves + self.rates)
        tried = [np.r_[slopes, moves] for slopes in (np.zeros(count), *straight)] if count else [moves]
        misses = [self._missed(one)[0] for one in tried]
        noise_um = self._noise(min(misses, key=lambda one: float(one @ one)))
        at = min(zip(tried, misses, strict=True), key=lambda pair: self._cost(*pair, noise_um))[0]
        missed, ran = self._missed(at)
        for _ in range(STEPS if self.remembered > 1 or self.moves or self.rates else 0):
            jacobian = self._jacobian(at, ran)
            noise_um = self._noise(_unexplained(missed, jacobian))
            before = self._cost(at, missed, noise_um)
            step = self._step(at, missed, jacobian, noise_um)
            for _ in range(HALVINGS):
                new = at + step
                new_missed, new_ran = self._missed(new)
                after = self._cost(new, new_missed, noise_um)
                if after < before:
                    break
                step = step / 2
            else:
                break
            at, missed, ran = new, new_missed, new_ran
            if after > before * (1 - ENOUGH):
                break
        plays_um, past = self._plays(at), self._past(at)
        return Estimate(self.plant.after(self.first_V, plays_um, past), plays_um, past, self.remembered,
                        float(np.sqrt(np.mean(missed**2))))

    def _slopes(self, plays_um: np.ndarray) -> np.ndarray:
        return np.diff(plays_um) / self.gaps_um

    def _plays(self, at: np.ndarray) -> np.ndarray:
        slopes = at[:len(self.gaps_um)]
        return self.x0_um + np.r_[0.0, np.cumsum(slopes * self.gaps_um)]

    def _owing(self) -> np.ndarray:
        """What is no matter of the start: a constant, drift and disturbances, (rows, columns), orthonormal."""
        run = replace(self.run, columns=self.columns)
        beside = [signals.asides(self.run)[self.used][self.rows], self.rows[:, None] / len(self.run)]
        columns = [one.effect.columns(run, one.values, self.model)[self.rows] for one in self.plant.acting
                   if one.effect.disturbance]
        return np.linalg.qr(np.column_stack([*beside, *columns]))[0]

    def _prior(self) -> np.ndarray:
        """Of each unknown, one over what it may be (standard deviation)."""
        moved_um = AWAY * self.model.stroke_um / len(LEFT_S) ** 0.5
        return np.r_[np.full(len(self.gaps_um), 1 / SLOPE_SPREAD), np.full(self.moves, 1 / moved_um),
                     np.full(self.rates, 1 / SLOPE_SPREAD)]

    def _past(self, at: np.ndarray) -> Past:
        moves_um = at[len(self.gaps_um):len(self.gaps_um) + self.moves]
        gain, plays_V = self.model.gain_um_per_V, self._plays(at) / self.model.gain_um_per_V + self.model.offset_V
        beside = Past(thresholds_V=self.model.thresholds_um / abs(gain), plays_V=plays_V,
                      rate_um_per_s=float(at[-1]) * self.top_um_per_s if self.rates else 0.0)
        return beside._replace(away_um=moves_um, since_s=LEFT_S) if self.moves else beside

    def _state(self, at: np.ndarray) -> State:
        return self.smooth.after(self.first_V, self._plays(at), self._past(at))

    def _missed(self, at: np.ndarray) -> tuple[np.ndarray, Ran]:
        """What is missed in the rows, beside what is no matter of the start; and the run."""
        return self.missed_from(self._state(at))

    def missed_from(self, state: State) -> tuple[np.ndarray, Ran]:
        """Likewise."""
        ran = self.smooth.run(self.columns["command_V"], state, self.columns)
        return self._beside((self.columns["displacement_um"] - ran.displacement_um)[self.rows]), ran

    def _beside(self, rows: np.ndarray) -> np.ndarray:
        return rows - self.owing @ (self.owing.T @ rows)

    def _noise(self, missed: np.ndarray) -> float:
        """Standard deviation of one of so many samples as are independent, um: white noise would leave it as it is."""
        power = np.abs(np.fft.rfft(missed, 2 * len(missed))) ** 2
        correlation = np.fft.irfft(power)[:len(missed)]
        if not correlation[0] > 0:
            return LEAST * self.model.stroke_um
        correlation /= correlation[0]
        last = int(np.argmax(correlation < 0)) or len(missed)  # the initial positive sequence
        times = 2 * np.sum(correlation[:last]) - 1
        return max(float(np.sqrt(np.mean(missed**2) * times)), LEAST * self.model.stroke_um)

    def _cost(self, at: np.ndarray, missed: np.ndarray, noise_um: float) -> float:
        return float(np.sum((missed / noise_um) ** 2) + np.sum((self.prior * at) ** 2))

    def _jacobian(self, at: np.ndarray, ran: Ran) -> np.ndarray:
        """Of the displacement by the unknowns, (rows, unknowns)."""
        behind, state = self.smooth.behind, self._state(at)
        plain_um = behind(ran.operated_um, ran.driven_V, state)
        columns = [behind(ran.operated_um + NEAR * column, ran.driven_V, state) - plain_um
                   for column in self._play_columns(at, ran).T]
        near_um = NEAR * self.model.stroke_um
        for k in range(self.moves):
            other = at.copy()
            other[len(self.gaps_um) + k] += near_um
            columns.append((behind(ran.operated_um, ran.driven_V, self._state(other)) - plain_um) / near_um * NEAR)
        if self.rates:
            other = at.copy()
            other[-1] += NEAR if at[-1] < 0.5 else -NEAR
            moved = self.smooth.run(self.columns["command_V"], self._state(other), self.columns).displacement_um
            columns.append((moved - ran.displacement_um) / (other[-1] - at[-1]) * NEAR)
        return self._beside(np.column_stack([column[self.rows] for column in columns]) / NEAR)

    def _play_columns(self, at: np.ndarray, ran: Ran) -> np.ndarray:
        """Of the operator's output by the slopes of its memory, at the rate that it has, (samples, slopes)."""
        model, plays_um = self.model, self._plays(at)
        outputs = firmware.plays(model.x_of(ran.driven_V), model.thresholds_um, plays_um)[0]
        untouched = np.logical_and.accumulate(outputs == plays_um, axis=0)
        weights = operators.play_weights(model, operators.guard(model.rate, ran.rate_um_per_s))
        v_um = operators.bank(outputs, weights)
        steep = np.cumsum(model.deadzone_weights)[np.searchsorted(model.deadzones_um[1:], v_um)]
        moved = (steep[:, None] * weights * untouched)[:, 1:]
        return np.cumsum(moved[:, ::-1], axis=1)[:, ::-1] * self.gaps_um

    def _step(self, at: np.ndarray, missed: np.ndarray, jacobian: np.ndarray, noise_um: float) -> np.ndarray:
        from scipy.optimize import lsq_linear

        count = len(self.gaps_um)
        low, high = (np.r_[np.full(count, end), np.full(self.moves, end * np.inf), np.full(self.rates, (end + 1) / 2)] - at
                     for end in (-1.0, 1.0))
        slack = 1e-9
        return lsq_linear(np.vstack([jacobian / noise_um, np.diag(self.prior)]), np.r_[missed / noise_um, -self.prior * at],
                          (low - slack, high + slack), method="bvls").x.clip(low, high)
