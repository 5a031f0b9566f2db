"""The sealed family: walls that move over a rugged landscape. Nothing here comes from rdpi.

Nobody looks at its figures during development: measure.py scores it with `--sealed` only, once per issue (README.md).

A domain wall rests where its restoring force and the pinning of its own landscape add up to the input. Driven up, it
moves reversibly in its well, and jumps to the next place that holds it; driven down likewise. The output is the mean
position of many walls.
"""

from __future__ import annotations

import numpy as np
from loops import Pieces

PLACES = 400
REACH = 2.5  # landscapes extend from -REACH to REACH


class Walls(Pieces):
    """Walls at places p_i of a grid. The input stiffness p_i + pinning_i holds a wall at p_i."""

    def __init__(self, pinning: np.ndarray, stiffness: np.ndarray) -> None:
        self.place = np.linspace(-REACH, REACH, PLACES)
        self.held_by = np.multiply.outer(stiffness, self.place) + pinning
        self.at = np.argmax(self.held_by >= self.u, axis=1)

    def piece(self, u: np.ndarray, rising: bool) -> np.ndarray:
        sign = 1 if rising else -1
        walls = np.arange(len(self.at))
        ahead = np.clip(self.at + sign, 0, PLACES - 1)
        moves = sign * self.held_by[walls, ahead] <= sign * u[-1]
        total = np.full(len(u), np.sum(self.place[self.at[~moves]]))
        for wall in walls[moves]:
            at = self.at[wall]
            # the input that takes the wall past all places up to each one is the greatest on the way
            way = self.held_by[wall, at:] if rising else -self.held_by[wall, at::-1]
            steps = np.searchsorted(np.maximum.accumulate(way), sign * u, "right") - 1
            here = at + sign * np.maximum(steps, 0)
            total += self.place[here]
            self.at[wall] = here[-1]
        return total / len(walls)


def walls(random: np.random.Generator) -> Walls:
    count, length = 40, random.uniform(8, 14)  # of the landscape's hills, in places
    rough = random.standard_normal((count, PLACES))
    hill = np.exp(-0.5 * (np.arange(-40, 41) / length) ** 2)
    smooth = np.array([np.convolve(row, hill, "same") for row in rough])
    smooth *= random.uniform(0.25, 0.45) / np.std(smooth)
    return Walls(smooth + random.uniform(-0.3, 0.3), random.uniform(0.8, 1.2, count))


SEALED = {"walls": walls}
