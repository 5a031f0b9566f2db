"""Hysteresis families of the rigs, each with mathematics of its own. Nothing here comes from rdpi.

A family is a function of a random generator that returns an operator. An operator is called with the actuator's input
u (1-D; -1..1 is the command range, a little beyond it is allowed) and returns its output for every value. Its state
carries over to the next call. Width and sign of an output mean nothing: rigs.py scales it.
"""

from __future__ import annotations

from collections.abc import Callable
from math import atan

import numpy as np

Operator = Callable[[np.ndarray], np.ndarray]
END = 1.4  # inputs lie between -END and END


def branches(before: float, u: np.ndarray) -> tuple[list[int], list[bool]]:
    """First index of each monotone piece of u, which comes after `before`; whether the piece rises.

    A piece ends with its turning point. Where the input rests, the piece goes on.
    """
    direction = np.sign(np.diff(u, prepend=before))
    moving = np.flatnonzero(direction)
    if not len(moving):
        return [0], [True]
    turns = moving[1:][np.diff(direction[moving]) != 0]
    first = np.concatenate([[0], turns])
    return first.tolist(), (direction[np.concatenate([moving[:1], turns])] > 0).tolist()


class Pieces:
    """An operator that answers one monotone piece of its input at a time."""

    u = 0.0

    def piece(self, u: np.ndarray, rising: bool) -> np.ndarray:
        raise NotImplementedError

    def __call__(self, u: np.ndarray) -> np.ndarray:
        result = np.empty(len(u))
        first, rises = branches(self.u, u)
        for start, stop, rising in zip(first, [*first[1:], len(u)], rises):
            result[start:stop] = self.piece(u[start:stop], rising)
            self.u = float(u[stop - 1])
        return result


# --- Preisach --------------------------------------------------------------------------------------------------------

class Everett(Pieces):
    """Preisach operator with the Everett function E(a, b) = (F(a) - F(b)) (G(a) - G(b)).

    F and G increase, so the density F'(a) G'(b) + F'(b) G'(a) is positive. Each is a line and a smooth step.
    """

    def __init__(self, steps: tuple[float, float], centres: tuple[float, float], spreads: tuple[float, float]) -> None:
        self.steps, self.centres, self.spreads = steps, centres, spreads
        self.turns = [(-END, 0.0), (END, self.everett(END, -END))]  # from the oldest to the newest
        self.rising = False
        self.output = self.turns[-1][1] - self.everett(END, self.u)

    def everett(self, high: np.ndarray | float, low: np.ndarray | float) -> np.ndarray:
        product = 1.0
        for step, centre, spread in zip(self.steps, self.centres, self.spreads):
            product = product * (high - low + step * (np.tanh((high - centre) / spread)
                                                      - np.tanh((low - centre) / spread)))
        return product

    def piece(self, u: np.ndarray, rising: bool) -> np.ndarray:
        if rising != self.rising:
            self.turns.append((self.u, self.output))
            self.rising = rising
        sign = 1 if rising else -1
        result, done = np.empty(len(u)), 0
        while True:
            at, output = self.turns[-1]
            # up to the extremum before last; passing it closes a loop and forgets both its ends
            stop = int(np.searchsorted(sign * u, sign * self.turns[-2][0])) if len(self.turns) > 2 else len(u)
            part = u[done:stop]
            result[done:stop] = output + (self.everett(part, at) if rising else -self.everett(at, part))
            done = stop
            if done == len(u):
                break
            del self.turns[-2:]
        self.output = float(result[-1])
        return result


def everett(random: np.random.Generator) -> Operator:
    return Everett(tuple(random.uniform(0.1, 0.6, 2)), tuple(random.uniform(-0.5, 0.5, 2)),
                   tuple(random.uniform(0.4, 0.9, 2)))


# --- operators that are held between two curves ----------------------------------------------------------------------

class Between:
    """Weighted sum of elements y = max(lower(u), min(upper(u), y)), lower and upper increasing functions."""

    def __init__(self, lower: list[Operator], upper: list[Operator], weights: np.ndarray) -> None:
        self.lower, self.upper, self.weights = lower, upper, weights
        self.u = 0.0
        start = np.array([self.u])
        self.y = np.array([(low(start)[0] + up(start)[0]) / 2 for low, up in zip(lower, upper)])

    def __call__(self, u: np.ndarray) -> np.ndarray:
        first, rises = branches(self.u, u)
        lengths = np.diff([*first, len(u)])
        ends = u[np.cumsum(lengths) - 1]
        lower, upper = (np.array([curve(ends) for curve in curves]).T for curves in (self.lower, self.upper))
        began = np.empty_like(lower)
        for k, rising in enumerate(rises):
            began[k] = self.y
            self.y = np.maximum(lower[k], self.y) if rising else np.minimum(upper[k], self.y)
        rising, result = np.repeat(rises, lengths), np.zeros(len(u))
        for low, up, weight, y in zip(self.lower, self.upper, self.weights, began.T):
            y = np.repeat(y, lengths)
            result += weight * np.where(rising, np.maximum(low(u), y), np.minimum(up(u), y))
        self.u = float(u[-1])
        return result


def envelope(random: np.random.Generator) -> Operator:
    """Generalised plays whose two sides are different tanh curves: asymmetric loops that saturate."""
    steep, bend = random.uniform(0.6, 0.9), random.uniform(-0.2, 0.2, 2)
    radii = np.linspace(0.02, random.uniform(0.5, 0.8), 14)

    def side(radius: float, sign: int) -> Operator:
        shift = bend[0] if sign < 0 else bend[1]
        scale = steep * (1.0 if sign < 0 else 1.05)
        # at any u the falling side lies above the rising one: 0.05 tanh'(..) and the bends are small against 0.35
        apart = radius + (0.35 if sign > 0 else 0.0)
        return lambda u: np.tanh(scale * u + shift) / steep + sign * apart

    weights = radii**random.uniform(0.0, 1.0) * np.exp(-random.uniform(0.5, 2.0) * radii)
    return Between([side(r, -1) for r in radii], [side(r, 1) for r in radii], weights)


def krasnoselskii_pokrovskii(random: np.random.Generator) -> Operator:
    """Krasnosel'skii-Pokrovskii kernels: relays with ramps for edges, on a triangle of thresholds."""
    ramp, count = random.uniform(0.7, 1.1), 11
    thresholds = np.linspace(-1.1 - ramp, 1.1, count)
    centre, spread, far = random.uniform(-0.15, 0.15) - ramp / 2, random.uniform(1.0, 1.6), random.uniform(0.6, 1.2)

    def edge(threshold: float) -> Operator:
        return lambda u: np.clip((u - threshold) / ramp, 0, 1)

    pairs = [(down, up) for up in thresholds for down in thresholds if down <= up]
    weights = np.array([np.exp(-((down + up) / 2 - centre) ** 2 / spread**2 - (up - down) ** 2 / far**2)
                        for down, up in pairs])
    return Between([edge(up) for _, up in pairs], [edge(down) for down, _ in pairs], weights)


# --- springs and sliders ---------------------------------------------------------------------------------------------

class MaxwellSlip(Pieces):
    """Goldfarb and Celanovic: voltage = charge / capacity + elasto-slides in series, solved for the charge."""

    def __init__(self, stiffness: np.ndarray, limits: np.ndarray, capacity: float) -> None:
        self.stiffness, self.limits, self.capacity = stiffness, limits, capacity
        self.charge, self.forces = 0.0, np.zeros(len(stiffness))

    def piece(self, u: np.ndarray, rising: bool) -> np.ndarray:
        sign = 1 if rising else -1
        way = (self.limits - sign * self.forces) / self.stiffness  # each slide's way to where it slips
        order = np.argsort(way)
        stuck = np.sum(self.stiffness) - np.concatenate([[0.0], np.cumsum(self.stiffness[order])])
        corners = np.concatenate([[0.0], way[order], [way[order[-1]] + 10 * self.capacity]])
        volts = np.concatenate([[0.0], np.cumsum(np.diff(corners) * (1 / self.capacity + stuck))])
        charge = self.charge + sign * np.interp(sign * (u - self.u), volts, corners)
        moved = charge[-1] - self.charge
        self.forces = np.clip(self.forces + self.stiffness * moved, -self.limits, self.limits)
        self.charge = float(charge[-1])
        return charge


def maxwell_slip(random: np.random.Generator) -> Operator:
    count = int(random.integers(8, 17))
    slips = np.geomspace(0.03, random.uniform(1.2, 1.8), count)
    stiffness = random.uniform(0.5, 1.5, count) * slips**random.uniform(-0.3, 0.3)
    stiffness *= random.uniform(0.5, 0.8) / np.sum(stiffness)
    return MaxwellSlip(stiffness, stiffness * slips, 1.0)


# --- differential equations ------------------------------------------------------------------------------------------

class Equation:
    """dh/du = slope(h, u, sign of du) by the midpoint rule, in increments of at most 2 % of the half range."""

    def __init__(self, slope: Callable[[float, float, float], float]) -> None:
        self.slope, self.u, self.h = slope, 0.0, 0.0

    def __call__(self, u: np.ndarray) -> np.ndarray:
        slope, at, h, result = self.slope, self.u, self.h, []
        for target in u.tolist():
            change = target - at
            if change:
                sign = 1.0 if change > 0 else -1.0
                count = 1 + int(abs(change) * 50)
                du = change / count
                for _ in range(count):
                    h += du * slope(h + du / 2 * slope(h, at, sign), at + du / 2, sign)
                    at += du
                at = target
            result.append(h)
        self.u, self.h = at, h
        return np.array(result)


def bouc_wen(random: np.random.Generator) -> Operator:
    """Wang and Wen's asymmetric equation: the loss differs by the signs of the motion and of h, and of both."""
    length = random.uniform(0.9, 1.4)
    gamma, beta, phi = random.uniform(-0.1, 0.3), random.uniform(0.5, 0.9), random.uniform(-0.06, 0.06)

    def slope(h: float, u: float, sign: float) -> float:
        side = 1.0 if h > 0 else -1.0
        return (1 - h * h * (gamma + beta * sign * side + phi * (sign + side))) / length

    return Equation(slope)


def dahl(random: np.random.Generator) -> Operator:
    """Dahl's friction with an exponent; its level grows with position, and pulling differs from pushing."""
    stiffness, exponent = random.uniform(0.6, 1.1), random.uniform(1.1, 1.6)
    grows, pulls = random.uniform(-0.2, 0.2), random.uniform(0.85, 1.15)

    def slope(h: float, u: float, sign: float) -> float:
        level = (1 + grows * u) * (pulls if sign > 0 else 1.0)
        left = 1 - sign * h / level
        return stiffness * left**exponent if left > 0 else 0.0

    return Equation(slope)


class ColemanHodgdon:
    """Duhem equation of Coleman and Hodgdon, dh/du = rate sign(du) (f(u) - h) + g, f a saturating curve.

    Rising and falling have rates of their own. Minor loops do not close: nothing is wiped out.
    """

    def __init__(self, rising: float, falling: float, height: float, steep: float, slope: float) -> None:
        self.rising, self.falling = rising, falling
        self.height, self.steep, self.slope = height, steep, slope
        self.u = self.h = 0.0

    def __call__(self, u: np.ndarray) -> np.ndarray:
        du = np.diff(u, prepend=self.u)
        keep = np.exp(-np.where(du > 0, self.rising, self.falling) * np.abs(du))
        pull = (1 - keep) * self.height * np.tanh(self.steep * (u - du / 2)) + self.slope * du
        h, result = self.h, []
        for k, p in zip(keep.tolist(), pull.tolist()):
            h = k * h + p
            result.append(h)
        self.u, self.h = float(u[-1]), h
        return np.array(result)


def duhem(random: np.random.Generator) -> Operator:
    rising = random.uniform(1.0, 2.0)
    return ColemanHodgdon(rising, rising * random.uniform(0.8, 1.25), 1.0, random.uniform(0.6, 1.2),
                          random.uniform(0.0, 0.4))


def jiles_atherton(random: np.random.Generator) -> Operator:
    """Jiles and Atherton's magnetisation with the arctangent for the anhysteretic curve."""
    shape, pinning = random.uniform(0.5, 0.9), random.uniform(0.35, 0.6)
    coupling, reversible = random.uniform(0.0, 0.15), random.uniform(0.1, 0.4)
    shift = random.uniform(-0.2, 0.2)

    def slope(m: float, u: float, sign: float) -> float:
        field = (u + shift + coupling * m) / shape
        away = atan(field) - m
        turned = 1 / (shape * (1 + field * field))
        moved = away / (pinning * sign - coupling * away) if away * sign > 0 else 0.0
        both = (1 - reversible) * moved + reversible * turned
        return both / (1 - coupling * reversible * turned)

    return Equation(slope)


FAMILIES: dict[str, Callable[[np.random.Generator], Operator]] = {
    "everett": everett,
    "bouc-wen": bouc_wen,
    "duhem": duhem,
    "dahl": dahl,
    "maxwell-slip": maxwell_slip,
    "envelope": envelope,
    "jiles-atherton": jiles_atherton,
    "krasnoselskii-pokrovskii": krasnoselskii_pokrovskii,
}
WIPE_OUT = {"everett", "maxwell-slip", "envelope", "krasnoselskii-pokrovskii"}  # minor loops close and are forgotten
