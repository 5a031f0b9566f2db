"""The interval of a promise holds what new recordings show, few as they are."""

from __future__ import annotations

import numpy as np
import pytest

from rdpi.gap import selection
from rdpi.gap.dataset import BLOCKS

SCATTER, WITHIN = 0.5, 0.3  # of the logarithm of what is left: between recordings, within one


def squares(random: np.random.Generator, recordings: int) -> tuple[np.ndarray, np.ndarray]:
    """Left after and before an effect, (recordings x BLOCKS,)."""
    before = np.exp(WITHIN * random.standard_normal((recordings, BLOCKS)))
    left = 0.3 * np.exp(SCATTER * random.standard_normal((recordings, 1)) + WITHIN * random.standard_normal(before.shape))
    return (before * left).ravel(), before.ravel()


@pytest.mark.parametrize("recordings", [3, 4, 6, 10])
def test_it_holds_what_many_new_recordings_show(recordings: int) -> None:
    random, held = np.random.default_rng(recordings), []
    shown = selection.shrink_of(*squares(random, 100_000))
    for _ in range(300):
        low, high = selection.promised_interval(*squares(random, recordings), recordings)
        held.append(low <= shown <= high)
    assert 0.85 < np.mean(held) < 0.95


def test_few_recordings_say_little_and_one_nothing() -> None:
    both = squares(np.random.default_rng(1), 6)
    widths = [np.ptp(selection.promised_interval(*(part[:n * BLOCKS] for part in both), n)) for n in (2, 6)]
    assert widths[0] > widths[1] and selection.promised_interval(both[0][:BLOCKS], both[1][:BLOCKS], 1) is None
