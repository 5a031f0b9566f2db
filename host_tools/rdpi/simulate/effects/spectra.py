"""What changes of the prediction explain of a residual, told in the frequency domain, where many of them cost little."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...data import Recording

PER_BIN = 0.002  # octaves, within which a response is taken to be constant


class Spectra(NamedTuple):
    """Of the predictions and residuals of all recordings together, without their means; (bins,)."""

    hertz: np.ndarray
    power_um2: np.ndarray  # of the prediction, summed over samples
    common_um2: np.ndarray  # of residual and prediction, complex

    @classmethod
    def of(cls, runs: Sequence[Recording], predicted_um: Sequence[np.ndarray], residual_um: Sequence[np.ndarray]
           ) -> Spectra:
        from scipy.fft import next_fast_len, rfft, rfftfreq

        parts = []
        for run, predicted, left in zip(runs, predicted_um, residual_um):
            count = next_fast_len(len(run), real=True)  # zeros go on from a level signal
            asked, missed = (rfft(_level(signal), count)[1:] for signal in (predicted, left))
            hertz = rfftfreq(count, run.sample_time_s)[1:]
            parts.append((hertz, np.conj(asked) * asked * 2 / count, np.conj(asked) * missed * 2 / count))
        hertz, power, common = (np.concatenate(lines) for lines in zip(*parts))
        _, first, place = np.unique(np.floor(np.log2(hertz) / PER_BIN), return_index=True, return_inverse=True)
        return cls(hertz[first], np.bincount(place, power.real),
                   np.bincount(place, common.real) + 1j * np.bincount(place, common.imag))

    def explained(self, response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of changes of the prediction by these responses, (changes, bins): their products with the residual and with
        themselves, summed over samples.

        The best multiple of a change takes product^2 / energy of the residual's squares away, the change as it is
        2 product - energy.
        """
        product = np.sum((np.conj(response) * self.common_um2).real, axis=1)
        return product, np.sum(np.abs(response) ** 2 * self.power_um2, axis=1)

    def explained_late(self, response: np.ndarray, late_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same of the prediction passed through each of these responses, (responses, bins), and late by each of these
        times: (responses, times).
        """
        turned = np.exp(-2j * np.pi * self.hertz[:, None] * late_s)
        product = (np.conj(response) @ (self.common_um2[:, None] * np.conj(turned))).real - np.sum(self.common_um2.real)
        across = (response @ (self.power_um2[:, None] * turned)).real
        return product, (np.abs(response) ** 2 @ self.power_um2)[:, None] + np.sum(self.power_um2) - 2 * across


def _level(signal: np.ndarray) -> np.ndarray:
    """Less the straight line from its first sample to its last: to a spectrum, the first one follows the last."""
    return signal - np.linspace(signal[0], signal[-1], len(signal))
