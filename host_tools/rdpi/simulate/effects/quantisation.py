"""Quantisation: values on a grid too coarse for what is asked."""

from __future__ import annotations

import numpy as np

from ... import firmware
from ...firmware import Block
from ...model import Model
from ..signals import grid_step
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment, left_out

HARMONICS = 8
LEAST_STEP = 1e-9  # um or V; a finer grid is none
BINS, FINER = 1 << 14, 8  # of the command's range, and of their spectrum
LEAST_STEPS = 3  # over the command's range
PEAKS = 2
ORIGINS = np.arange(16) / 16  # tried, of a step: a staircase has no slope for the fit to follow
PROMISING = 4  # of all that are tried, from which a fit starts
DITHERS = 0.0, 0.1, 0.2, 0.3, 0.45  # of a step


class Quantisation(Effect):
    """Rounding to multiples of `step`; `dither` is the uncertainty of what is rounded, which blurs the staircase.

    round(x) = x + (q / pi) sum over k of (-1)^k / k exp(-2 (pi k s / q)^2) sin(2 pi k x / q), averaged over a Gaussian
    of standard deviation s: the best prediction of a rounded value that is not known exactly.
    """

    name = "quantisation"
    title = "quantisation"
    what = "the DAC or the sensor's converter has too few bits, so that its values lie on a grid"
    remedy = "use a converter with more bits, or a smaller range of the converter"
    needs = "repeated values in the record"
    stages = "sensor", "DAC"
    shows_stage = True
    parameters = (Parameter("step", "um or V", 0.0, np.inf, joined="in steps of"),
                  Parameter("origin", "um or V", -np.inf, np.inf, internal=True),
                  Parameter("dither", "um", 0.0, np.inf, internal=True))

    @property
    def fitted(self) -> tuple[str, ...]:
        return () if self.stage == "sensor" else ("step", "origin")  # a sensor's grid is read off its values

    def unit(self, parameter: Parameter) -> str:
        return parameter.unit if parameter.unit != "um or V" else "um" if self.stage == "sensor" else "V"

    def reading_step_um(self, values: Values) -> float:
        return values["step"] if self.stage == "sensor" else 0.0

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        step = values["step"]
        if step < LEAST_STEP:
            return None
        if self.stage == "sensor":
            return _staircase(step, values["dither"])
        return Block(firmware.ROUND, (values["origin"], step))

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        if self.stage == "DAC" and folded_into.drive.noise_shaping:
            return Treatment("compensated", "what a code misses is carried to the next one")
        return left_out("noise shaping was not asked for (--noise-shaping)")

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        if self.stage == "sensor":
            step = max(grid_step(run.displacement_um) for run in residuals.runs)
            return [{"step": step, "origin": 0.0, "dither": share * step} for share in DITHERS] if step > 0 else []
        return _steps(residuals)


def _steps(residuals: Residuals) -> list[dict[str, float]]:
    """Steps of a DAC: periods of the residual as a function of the command, whose phase tells where codes lie."""
    low = min(float(np.min(run.command_V)) for run in residuals.runs)
    span = max(float(np.max(run.command_V)) for run in residuals.runs) - low
    profile = np.zeros(BINS)
    for run, residual in zip(residuals.runs, residuals.drive_residual_um):
        profile += np.bincount(np.minimum((run.command_V - low) / span * BINS, BINS - 1).astype(int), residual, BINS)
    spectrum = np.fft.rfft(profile, FINER * BINS)
    spectrum[:FINER * LEAST_STEPS] = 0
    starts = []
    for _ in range(PEAKS):
        best = int(np.argmax(np.abs(spectrum[:len(spectrum) // 2])))
        if best == 0:
            break
        # round(V) - V is -(step / pi) sin(2 pi (V - origin) / step) + ..., and bins are counted by their lower ends
        step = FINER * span / best
        phase = -np.angle(spectrum[best] * (1 if residuals.model.gain_um_per_V > 0 else -1)) - np.pi / 2
        origin = low + span / BINS / 2 + step * phase / (2 * np.pi)
        starts += [{"step": step, "origin": origin + share * step, "dither": 0.0} for share in ORIGINS]
        spectrum[max(0, best - 2 * FINER):best + 2 * FINER + 1] = 0
    return sorted(starts, key=lambda one: -_explained(one, residuals))[:PROMISING]


def _explained(values: Values, residuals: Residuals) -> float:
    """Squares that the rounding takes away, if the displacement follows it by any gain."""
    across = energy = 0.0
    for run, residual in zip(residuals.runs, residuals.drive_residual_um):
        rounding_V = firmware.Bank([Block(firmware.ROUND, (values["origin"], values["step"]))]).run(
            run.command_V)[0] - run.command_V
        across, energy = across + float(rounding_V @ residual), energy + float(rounding_V @ rounding_V)
    return max(across * np.sign(residuals.model.gain_um_per_V), 0.0) ** 2 / energy if energy > 0 else 0.0


def _staircase(step: float, dither: float) -> Block:
    if dither < 0.05 * step:
        return Block(firmware.ROUND, (0.0, step))
    k = np.arange(1, HARMONICS + 1)
    heights = step / np.pi * (-1.0) ** k / k * np.exp(-2 * (np.pi * k * dither / step) ** 2)
    heights = heights[np.abs(heights) > 1e-6 * step]  # they fall
    return Block(firmware.STAIRCASE, (2 * np.pi / step,), heights, count=len(heights))
