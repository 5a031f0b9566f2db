"""What is new in one octave, or in all of them with little energy, shows in the spectrum before it shows in the rms."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from injected import RATE_HZ, commissioned, drives, entry, plain_model, recorded
from plants import changed

from rdpi.data import Recording
from rdpi.gap import diagnose, spectrum, thresholds
from rdpi.gap.augmented import AugmentedModel
from rdpi.gap.spectrum import Spectrum
from rdpi.identify import localise, passport


@lru_cache(maxsize=None)
def later(seed: int = 7) -> tuple[Recording, ...]:
    return tuple(recorded(plain_model(), drives(), seed=seed))


def beside(left_um: float, seed: int, hertz: float | None = None) -> list[Recording]:
    """Recordings with a line that comes and goes, or white noise, of this rms."""
    random, result = np.random.default_rng(seed), []
    for run in later():
        white = random.standard_normal(len(run))
        t = np.arange(len(run)) / RATE_HZ
        added = white if hertz is None else np.sqrt(2) * np.sin(2 * np.pi * hertz * t + 3 * np.cumsum(white) / 50)
        result.append(changed(run, displacement_um=run.displacement_um + left_um * added))
    return result


def of(runs: list[Recording], excused_um: float = 0.0) -> Spectrum:
    given = AugmentedModel.given(commissioned(), runs, [])
    coords = [localise.coordinates(one.recording, one.predict([]), one.rate_um_per_s)
              for one in given.dataset.model_runs]
    return spectrum.against(passport.read(commissioned()), runs, given.residual_um, coords, excused_um)


def test_nothing_new_is_as_the_passport_expects() -> None:
    found = of(list(later()))
    assert found.evidence < 0.2 and found.everywhere < 1.2 and found.breadth < 1.2
    assert spectrum.against(None, [], [], []) == Spectrum(0.0, 1.0)


def test_a_narrow_band_shows_before_the_whole_does() -> None:
    plain = rms(list(later()))
    loud = beside(1.2 * plain, 3, hertz=90.0)
    assert rms(loud) < 1.7 * plain and of(loud).evidence > thresholds.SPECTRUM
    assert of(loud).everywhere < 1.5
    found = diagnose(commissioned(), loud).document
    assert found.verdict == "unknown" and found.where.dominant == "frequency_hz"


def test_white_noise_is_new_everywhere_unless_a_grid_excuses_it() -> None:
    noisy = beside(1.0, 4)
    assert of(noisy).everywhere > 3 and of(noisy).evidence > 1 and of(noisy).breadth == thresholds.MOST_BREADTH
    assert of(noisy, excused_um=1.0).everywhere == pytest.approx(1.0, abs=0.1)


def test_where_commissioning_hardly_moved_nothing_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    loud = beside(1.4 * rms(list(later())), 3, hertz=90.0)
    found = of(loud)
    assert found.evidence > thresholds.SPECTRUM and found.known == 1.0
    assert diagnose(commissioned(), loud).document.verdict == "unknown"
    monkeypatch.setattr(spectrum.unseen, "hardly_moved", lambda known, runs, coords, axis: axis.edges[1:] > 16)
    found = of(loud)
    assert found.evidence < thresholds.SPECTRUM / 2 and found.known < 0.3
    assert diagnose(commissioned(), loud).document.verdict == "none"


def test_logarithms_of_a_poor_passport_count_less(monkeypatch: pytest.MonkeyPatch) -> None:
    loud = beside(1.2 * rms(list(later())), 3, hertz=90.0)
    assert diagnose(commissioned(), loud).document.verdict == "unknown"
    monkeypatch.setattr(thresholds, "USUAL_SPREAD", thresholds.USUAL_SPREAD / 4)
    assert diagnose(commissioned(), loud).document.verdict == "none"


@pytest.mark.parametrize("step_um, verdict", [(0.035, "effect"), (0.07, "unknown")])
def test_what_a_wrong_effect_leaves_at_all_frequencies_makes_it_none(step_um: float, verdict: str) -> None:
    """A stage that sticks and slips is late at every reversal, as backlash is, but it jumps."""
    loose = recorded(plain_model(), drives(), entry("backlash", width_um=0.05))
    stuck = [changed(run, displacement_um=sticking(run.displacement_um, step_um)) for run in loose]
    found = diagnose(commissioned(), stuck).document
    assert found.verdict == verdict
    assert [one.name for one in found.effects] == (["backlash"] if verdict == "effect" else [])
    assert any("backlash explains a part" in note for note in found.notes) == (verdict == "unknown")


def sticking(z_um: np.ndarray, width_um: float) -> np.ndarray:
    result, at = np.empty(len(z_um)), z_um[0]
    for k, value in enumerate(z_um):
        at = value if abs(value - at) > width_um else at
        result[k] = at
    return result


def rms(runs: list[Recording]) -> float:
    left = AugmentedModel.given(commissioned(), runs, []).residual_um
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))
