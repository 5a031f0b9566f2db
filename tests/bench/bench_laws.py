"""Three hysteresis laws for the virtual bench. No code of rdpi and, the paper's own law apart, none of its mathematics.

A law is called with the actuator's input u (1-D, normalised: -1..1 is the command range; the value at the end of each
step) and the step in seconds, and returns the displacement in um about the middle of the range. State carries over.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi, sqrt

import numpy as np
from scipy.signal import cont2discrete, lfilter


class Pole:
    """First-order lag of unit gain, exact for an input that is constant within each step."""

    def __init__(self, time_constant_s: float) -> None:
        self.time_constant_s = time_constant_s
        self.state = 0.0

    def __call__(self, signal: np.ndarray, step_s: float) -> np.ndarray:
        keep = exp(-step_s / self.time_constant_s)
        output, _ = lfilter([1 - keep], [1, -keep], signal, zi=[keep * self.state])
        self.state = float(output[-1])
        return output


class Resonance:
    """Oscillator of unit gain at rest, exact for an input that is straight within each step; begins at rest."""

    def __init__(self, frequency_hz: float, damping: float) -> None:
        w = 2 * pi * frequency_hz
        self.transfer = [w * w], [1.0, 2 * damping * w, w * w]
        self.step_s = 0.0
        self.rest: float | None = None

    def __call__(self, signal: np.ndarray, step_s: float) -> np.ndarray:
        if step_s != self.step_s:
            numerator, self.denominator, _ = cont2discrete(self.transfer, step_s, "foh")
            self.numerator, self.step_s, self.rest = numerator[0], step_s, None
        if self.rest is None:
            self.rest, self.state = float(signal[0]), np.zeros(2)
        output, self.state = lfilter(self.numerator, self.denominator, signal - self.rest, zi=self.state)
        return self.rest + output


@dataclass
class Paper:
    """The law of Ang et al. (IROS 2003), literally: backlash operators, slopes falling linearly with the input's rate.

    W_i(rate) = rest_i (1 - fall_i rate / singular): fall is 1 for W_0, which reaches zero at the singular rate, and
    less for every higher slope. The paper does not print its weights. The further up the fall reaches, the more |dx/dt|
    departs from the reference's rate, which is all that an inverse can know: with a power of 2 in place of the 4 below,
    the 5-20-35 Hz profile is tracked to 0.95 % rms instead of 0.61.
    """

    rate_dependence: float = 1.0
    singular_um_per_s: float = 1450.0
    floor: float = 0.02  # no slope falls below, so that the plant exists past the singularity
    half_range_um: float = 7.5

    def __post_init__(self) -> None:
        q = np.arange(10) / 9
        self.thresholds = np.arange(10) * 0.625
        self.rest = 1.12 * (0.65 + 0.45 * (1 - (1 - q) ** 1.5))
        fall = 0.02 + 0.98 * (1 - q) ** 4
        self.change = -self.rate_dependence * self.rest * fall / self.singular_um_per_s
        self.plays = np.zeros(10)
        self.x = 0.0

    def __call__(self, u: np.ndarray, step_s: float) -> np.ndarray:
        x = self.half_range_um * u
        rate = np.abs(np.diff(x, prepend=self.x)) / step_s
        self.x = x[-1]
        upper, lower = np.add.outer(x, self.thresholds), np.subtract.outer(x, self.thresholds)
        states = np.empty_like(upper)
        y = self.plays
        for k in range(len(x)):
            y = np.maximum(lower[k], np.minimum(upper[k], y, out=states[k]), out=states[k])
        self.plays = y.copy()
        slopes = np.maximum(self.rest + np.multiply.outer(rate, self.change), self.floor)
        v = (np.diff(slopes, axis=1, prepend=0) * states).sum(axis=1)
        return v - 0.04 * np.maximum(v - 1.5, 0) - 0.06 * np.maximum(v - 4.0, 0)


@dataclass
class Preisach:
    """Preisach operator by its Everett function, after a visco-elastic input and a rate-dependent lag of the switching.

    Density exp(-(a - b) / spread) (1 + skew (a + b) / 2) over up and down thresholds a > b, integrated in closed form.
    The skew makes both branches differ and puts the operator outside the plays' reach. Rate: a share of the input
    relaxes with one pole, and the switching trails its field as sqrt(rate), the excess loss of Bertotti's dynamics.
    """

    rate_dependence: float = 1.0
    range_um: float = 15.0
    irreversible: float = 0.30  # share of the range that switches
    spread: float = 1.5
    skew: float = 0.4
    viscous_share: float = 0.06
    viscous_s: float = 0.002
    excess: float = 0.002  # lag per sqrt(rate), rate in half ranges per second

    def __post_init__(self) -> None:
        self.viscous = Pole(self.viscous_s)
        self.u = 0.0
        # turning points (input, output) from the oldest to the newest; the first two lie out of reach
        full = self.everett(1.05, -1.05)
        self.scale = self.irreversible * self.range_um / self.everett(1.0, -1.0)
        self.turns = [(-1.05, -full / 2), (1.05, full / 2)]
        self.output = self.turns[-1][1] - self.everett(1.05, 0.0)

    def everett(self, high: float, low: float) -> float:
        w = high - low
        return (1 + self.skew * (high + low) / 2) * (w - self.spread * (1 - exp(-w / self.spread)))

    def switch(self, field: np.ndarray, step_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Input that the hysterons see and their summed output, at the end of each step."""
        seen, switched = np.empty_like(field), np.empty_like(field)
        everett, turns, u, output = self.everett, self.turns, self.u, self.output
        rising = turns[-1][0] < u
        lag = (self.rate_dependence * self.excess) ** 2 / step_s
        for k, target in enumerate(field.tolist()):
            error = target - u
            # implicit step of du/dt = error |error| / excess^2: |e| + |e|^2 / lag = |error|, e what is left
            left = 0.5 * lag * (sqrt(1 + 4 * abs(error) / lag) - 1) if lag else 0.0
            new = target - left if error > 0 else target + left
            if new != u:
                if (new > u) != rising:
                    turns.append((u, output))
                    rising = not rising
                u = new
                # wiping out: passing the extremum before last closes a loop and forgets both its ends
                if rising:
                    while u >= turns[-2][0]:
                        del turns[-2:]
                    output = turns[-1][1] + everett(u, turns[-1][0])
                else:
                    while u <= turns[-2][0]:
                        del turns[-2:]
                    output = turns[-1][1] - everett(turns[-1][0], u)
            seen[k], switched[k] = u, output
        self.u, self.output = u, output
        return seen, switched

    def __call__(self, u: np.ndarray, step_s: float) -> np.ndarray:
        share = self.rate_dependence * self.viscous_share
        seen, switched = self.switch((1 - share) * u + share * self.viscous(u, step_s), step_s)
        reversible = (1 - self.irreversible) * self.range_um / 2
        return reversible * (seen + 0.03 * (1 - seen**2)) + self.scale * switched


@dataclass
class BoucWen:
    """Asymmetric Bouc-Wen equation with a rate term, followed by a Kelvin-Voigt share of the mechanics.

    length dh/du = drive(rate) - (beta sign(du h) + gamma) |h|^power + skew u sign(du), displacement ~ u - share h.
    """

    rate_dependence: float = 1.0
    range_um: float = 15.0
    share: float = 0.17
    length: float = 0.55
    beta: float = 0.8
    gamma: float = 0.2
    power: float = 1.3
    skew: float = 0.25
    drive_gain: float = 0.02  # growth of the drive term per sqrt(rate), rate in half ranges per second
    viscous_share: float = 0.06
    viscous_s: float = 0.002

    def __post_init__(self) -> None:
        self.viscous = Pole(self.viscous_s)
        self.rate_filter = Pole(0.001)
        self.u = 0.0
        self.h = 0.0

    def slope(self, h: float, u: float, sign: float, drive: float) -> float:
        side = self.beta if sign * h > 0 else -self.beta
        return (drive - (side + self.gamma) * abs(h) ** self.power + self.skew * u * sign) / self.length

    def internal(self, u: np.ndarray, drive: np.ndarray) -> np.ndarray:
        """The inner variable h along u, by the midpoint rule in increments of at most 2 % of the half range."""
        result = np.empty_like(u)
        slope, past, h = self.slope, self.u, self.h
        for k, (target, a) in enumerate(zip(u.tolist(), drive.tolist())):
            change = target - past
            if change:
                sign = 1.0 if change > 0 else -1.0
                pieces = 1 + int(abs(change) / 0.02)
                du = change / pieces
                for _ in range(pieces):
                    h += du * slope(h + du / 2 * slope(h, past, sign, a), past + du / 2, sign, a)
                    past += du
                past = target
            result[k] = h
        self.u, self.h = past, h
        return result

    def __call__(self, u: np.ndarray, step_s: float) -> np.ndarray:
        rate = self.rate_filter(np.abs(np.diff(u, prepend=self.u)) / step_s, step_s)
        h = self.internal(u, 1 + self.rate_dependence * self.drive_gain * np.sqrt(rate))
        z = self.range_um / 2 * ((u - self.share * h) / (1 - self.share) - 0.015 * u**2)
        share = self.rate_dependence * self.viscous_share
        return (1 - share) * z + share * self.viscous(z, step_s)


LAWS = {"paper": Paper, "preisach": Preisach, "bouc-wen": BoucWen}
