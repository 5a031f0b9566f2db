"""The gains that examples/track/README.md advises for its controller are those of the linear loop.

The plant is a pure delay with gain 1. The loop is simulated as a matrix, so nothing is shared with the formulas of the text.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

README = Path(__file__).resolve().parents[2] / "examples/track/README.md"
SHARE = 0.3  # KI times the whole delay


def radius(step: Callable[[np.ndarray], np.ndarray], states: int) -> float:
    """Of a linear step from state to state: below 1 the loop is stable."""
    return float(max(abs(np.linalg.eigvals(np.array([step(state) for state in np.eye(states)]).T))))


def of_samples(ki_T: float, d: int) -> float:
    """Each code is output d ticks after the first that could follow from its reading."""

    def step(outputs: np.ndarray) -> np.ndarray:  # the latest first; the last is what the latest reading shows
        return np.concatenate([[outputs[0] - ki_T * outputs[d]], outputs[:-1]])

    return radius(step, d + 1)


def of_halves(ki_T: float, samples: int, each: bool) -> float:
    """Codes in halves: one is computed while the one before is output."""

    def step(state: np.ndarray) -> np.ndarray:
        integral, waiting, read = state[0], state[1:1 + samples], state[1 + samples:]
        codes = integral - ki_T * np.cumsum(read if each else np.full(samples, read[-1]))
        return np.concatenate([[codes[-1]], codes, waiting])

    return radius(step, 1 + 2 * samples)


def limit(radius_at: Callable[[float], float]) -> float:
    low, high = 0.0, 4.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if radius_at(middle) < 1 else (low, middle)
    return low


def rows() -> list[tuple[str, int, float, float, float]]:
    """Kind, d or samples, wait in samples, KI T and limit, of every row of the table."""
    found, kind = [], ""
    for text, wait, ki_T, largest in re.findall(r"^\| ([^|]+) \| ([\d.]+) T \| ([\d.]+) \| ([\d.]+) \|$",
                                                README.read_text(encoding="utf-8"), re.M):
        kind = next((name for name, words in (("next", "next tick"), ("d", "d ticks"), ("held", "one reading"),
                                              ("each", "a reading for each")) if words in text), kind)
        number = re.search(r"d = (\d+)|(\d+) samples", text)
        found.append((kind, int(number[1] or number[2]) if number else 1, float(wait), float(ki_T), float(largest)))
    return found


def test_the_table_is_found() -> None:
    assert [kind for kind, *_ in rows()] == ["next", *["d"] * 3, *["held"] * 3, *["each"] * 3]


@pytest.mark.parametrize("kind, number, wait, ki_T, largest", rows())
def test_the_table_is_that_of_the_loop(kind: str, number: int, wait: float, ki_T: float, largest: float) -> None:
    def radius_at(gain: float) -> float:
        return of_samples(gain, number) if kind in ("next", "d") else of_halves(gain, number, kind == "each")

    assert largest == pytest.approx(limit(radius_at), rel=3e-3)
    assert ki_T == pytest.approx(SHARE / wait, rel=3e-3)
    assert 4.9 < largest / ki_T < 5.5, "the gain margin that the text promises"


@pytest.mark.parametrize("d", [1, 2, 5, 20])
def test_the_formula_of_the_limit(d: int) -> None:
    assert limit(lambda gain: of_samples(gain, d)) == pytest.approx(2 * np.sin(np.pi / (4 * d + 2)), rel=1e-6)


@pytest.mark.parametrize("d, kp, margin", [(1, 0.0, 4.9), (20, 0.0, 4.9), (1, 0.35, 2.0), (4, 0.35, 2.0), (20, 0.35, 2.0)])
def test_margins(d: int, kp: float, margin: float) -> None:
    """Of the open loop with KI as advised: reading, controller, d ticks."""
    w = np.linspace(1e-4, np.pi, 200_000)  # radians per sample
    z = np.exp(1j * w)
    open_loop = (kp + SHARE / (d + 0.5) / (1 - 1 / z)) * z ** -(d + 1)
    phase = np.unwrap(np.angle(open_loop))
    crossing = np.argmax(phase < -np.pi)
    assert np.abs(open_loop[crossing:]).max() < 1 / margin
    if kp == 0:
        degrees = 180 + np.degrees(phase[np.argmax(np.abs(open_loop) < 1)])
        assert 68 < degrees < 75
