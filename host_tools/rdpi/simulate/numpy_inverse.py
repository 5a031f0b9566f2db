"""The inverse of the whole chain in NumPy and double precision: the independent check of the compiled library.

Written from the formulas of lib/include/rdpi/f32_chain.h and the operator's of model/operators.py; plain rather than
fast. Where the drive is clipped, creep follows what was output, so that everything is done sample by sample.
"""

from __future__ import annotations

import math

import numpy as np

from ..firmware import LEAD, Chain, Steps
from ..model import Drive, Model, operators
from .memory import middle_um


class Lead:
    """r + alpha r' + beta r'' at the time t + delay."""

    def __init__(self, chain: Chain, sample_time_s: float) -> None:
        self.chain, self.step_s = chain, sample_time_s
        late = chain.delay_s - chain.whole_delay(sample_time_s) * sample_time_s
        self.rings = chain.lead_s > 0 or chain.lead_s2 > 0
        self.first = chain.lead_s + late
        self.second = chain.lead_s2 + chain.lead_s * late + late**2 / 2
        self.restart()

    def restart(self) -> None:
        self.before = None

    def step(self, ahead_um: float, missed: int) -> tuple[float, int]:
        """The reference to follow, and flags."""
        if not self.chain.leads_reference:
            return ahead_um, 0
        if self.before is None or missed > operators.MAX_MISSED:
            self.before, self.change = ahead_um, 0.0
            return ahead_um, 0
        change = (ahead_um - self.before) / (1 + missed)  # per sample
        changed = self.change if not missed else change  # a straight line through what was missed
        if self.chain.preview:  # of the parabola through three references, at the middle one
            of, slope = ahead_um - change, (change + changed) / 2
        else:  # ... at the latest
            of, slope = ahead_um, (3 * change - changed) / 2
        wish_um = self.first * slope / self.step_s + self.second * (change - changed) / self.step_s**2
        if not self.rings and not change * changed > 0:
            wish_um = 0.0  # a jump
        led_um = float(np.clip(wish_um, -self.chain.max_lead_um, self.chain.max_lead_um))
        self.before, self.change = ahead_um, change
        return of + led_um, LEAD * (led_um != wish_um)


class Unlag:
    """x + lag x' of the drive; x' is the mean of two differences, at most twice the smaller one, and 0 unless both have
    the same sign.
    """

    def __init__(self, chain: Chain, drive: Drive, sample_time_s: float, drive_V: float) -> None:
        self.chain, self.drive, self.per_step, self.step_s = chain, drive, chain.lag_s / sample_time_s, sample_time_s
        self.before_V: float | None = None
        self.change_V, self.carried_V = 0.0, 0.0
        self.ramp_V = drive_V  # what was output before it was rounded to a code: a slow slew would never leave one

    def step(self, asked_V: float, missed: int) -> tuple[float, int, int]:
        """The drive to output, its code, and flags."""
        if self.before_V is None or missed > operators.MAX_MISSED:
            self.before_V, self.change_V, missed = asked_V, 0.0, 0
        change_V = (asked_V - self.before_V) / (1 + missed)
        changed_V = change_V if missed else self.change_V
        self.before_V, self.change_V = asked_V, change_V
        slope_V = 0.0
        if change_V * changed_V > 0:
            slope_V = min((change_V + changed_V) / 2, 2 * change_V, 2 * changed_V, key=abs)
        wish_V = asked_V - (change_V if self.chain.preview else 0.0) + self.per_step * slope_V
        drive = self.drive
        limited_V, _ = operators.limit(drive, wish_V, self.ramp_V, self.step_s)
        self.ramp_V, shaped_V = limited_V, limited_V + self.carried_V
        output_V, code = operators.quantise(drive, min(max(shaped_V, drive.min_V), drive.max_V))
        if drive.noise_shaping:
            self.carried_V = shaped_V - output_V if limited_V == wish_V else 0.0
        return output_V, code, LEAD * (limited_V != wish_V)


class Poles:
    """z = h_0 + direct (h - h_0) + sum of share_i (l_i - h_0), solved for h. l_i is exact for h straight between
    samples: with m' = (h - m) / T of a staircase h, l_k = g m_(k-1) + (1 - g) h_k.
    """

    def __init__(self, chain: Chain, sample_time_s: float, settled_um: float) -> None:
        self.share, times_s = np.array(chain.poles, float).reshape(-1, 2).T
        ratio = sample_time_s / times_s
        self.blend = -np.expm1(-ratio)
        self.weight = self.blend / ratio
        self.at_once = chain.direct + float(self.share @ (1 - self.weight))
        self.settled_um, self.last, self.states = settled_um, 0.0, np.zeros(len(times_s))

    def swept(self, samples: int, h_um: float) -> None:
        """A sweep from where they had settled ended here so many samples ago."""
        self.last = h_um - self.settled_um
        self.missed(samples)

    def missed(self, samples: int) -> None:
        self.states += (1 - (1 - self.blend) ** samples) * (self.last - self.states)

    def wish(self, z_um: float) -> float:
        late = float((self.share * self.weight) @ self.states)
        return (z_um - self.settled_um - late) / self.at_once + self.settled_um

    def follow(self, h_um: float) -> None:
        self.last = h_um - self.settled_um
        self.states += self.blend * (self.last - self.states)


class RateOf:
    """operators.rate, sample by sample; missed samples lie on a straight line."""

    def __init__(self, model: Model, sample_time_s: float) -> None:
        law, self.step_s = model.rate, sample_time_s
        self.window = max(1, math.floor(law.window_s / sample_time_s + 0.5))
        self.blend = -math.expm1(-sample_time_s / law.filter_s) if law.filter_s > 0 else 1.0
        self.history: list[float] = []
        self.rate = 0.0

    def step(self, z_um: float, missed: int) -> float:
        if not self.history or missed > operators.MAX_MISSED:
            self.history, self.rate, missed = [z_um], 0.0, 0
            return 0.0
        last = self.history[-1]
        for k in range(1, missed + 2):
            self.history.append(last + (z_um - last) * k / (missed + 1))
            before = self.history[max(len(self.history) - 1 - self.window, 0)]
            raw = abs(self.history[-1] - before) / (self.window * self.step_s)
            self.rate += self.blend * (raw - self.rate)
        return self.rate


def displacement(model: Model, drive_V: float, rate_um_per_s: float, states_um: np.ndarray) -> float:
    """The operator's, in um, once the plays have moved to this drive."""
    return float(operators.forward(model, np.array([drive_V]), np.array([rate_um_per_s]), states_um)[0][0])


def _moved_V(model: Model, x_um: float, carried_um: float) -> float:
    """The drive that is rounded to a code: with noise shaping, x makes up for what the codes so far have missed, by half
    a code at most.
    """
    drive = model.drive
    drive_V = model.drive_of(x_um)
    if not drive.noise_shaping or drive.dac_bits is None:
        return drive_V
    step_V = (drive.max_V - drive.min_V) / (2**drive.dac_bits - 1)
    half_um = abs(model.x_of(drive_V + step_V / 2) - model.x_of(drive_V - step_V / 2)) / 2
    moved_V = model.drive_of(x_um + float(np.clip(carried_um / model.slopes[0], -half_um, half_um)))
    return float(np.clip(moved_V, drive.min_V, drive.max_V))


def step(model: Model, chain: Chain, ahead_um: np.ndarray, sample_time_s: float, swept: int | None = None
         ) -> tuple[Steps, np.ndarray]:
    """References (samples,), in um, as rdpi_f32_chain_step is given them, to drives, from the model's memory: so many
    samples after a sweep ended there, or None: where creep has settled.

    Returns the Steps and the states of the plays at the end.
    """
    drive, r, y = model.drive, model.thresholds_um, model.memory.plays_um
    clipped = operators.RANGE | operators.SLEW
    drive_V = ramp_V = min(max(model.drive_of(y[0]), drive.min_V), drive.max_V)
    start_um = displacement(model, drive_V, 0.0, y)
    poles = Poles(chain, sample_time_s, start_um if swept is None else middle_um(model))
    if swept is not None:
        poles.swept(swept, start_um)
    lead, rate = Lead(chain, sample_time_s), RateOf(model, sample_time_s)
    unlag, out_V = Unlag(chain, drive, sample_time_s, drive_V), drive_V
    carried_um = 0.0
    missed, rho, code = 0, 0.0, operators.quantise(drive, drive_V)[1]
    rows = []
    for asked_um in np.asarray(ahead_um, float):
        if not abs(asked_um) <= operators.MAX_REFERENCE_UM:
            missed += 1
            rows.append((out_V, rho, operators.INPUT, code))
            continue
        led_um, flags = lead.step(asked_um, missed)
        poles.missed(missed)
        wish_um = poles.wish(led_um)
        h = wish_um - model.offset_um
        estimated = rate.step(h, missed)
        rho = float(operators.guard(model.rate, np.array(estimated)))
        v = float(operators.saturation_inverse(np.array([h]), model.deadzones_um, model.deadzone_weights)[0])
        weights = operators.play_weights(model, rho)
        x = operators.solve(v, r, weights, y)
        ramp_V, limited = operators.limit(drive, model.drive_of(x), ramp_V, sample_time_s)
        drive_V, code = operators.quantise(drive, ramp_V if limited else _moved_V(model, x, carried_um))
        flags |= limited | operators.GUARD * (estimated > rho) | operators.MISSED * (missed > 0)
        poles.follow(displacement(model, drive_V, rho, y) if limited & clipped else wish_um)
        y = operators.play(model.x_of(drive_V), r, y)
        carried_um = 0.0 if limited else carried_um + v - float(weights @ y)
        out_V = drive_V
        if chain.lag_s > 0:
            out_V, code, led = unlag.step(ramp_V if limited else model.drive_of(x), missed)
            flags |= led
        missed = 0
        rows.append((out_V, rho, flags, code))
    kinds = (np.float64, np.float64, np.uint32, np.uint32)
    columns = zip(*rows) if rows else ((),) * len(kinds)
    return Steps(*(np.array(column, kind) for column, kind in zip(columns, kinds))), y
