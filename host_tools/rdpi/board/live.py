"""What has come of a recording while it goes on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .telemetry import BODY, NO_READING, NO_REFERENCE, Decoder, displacement_um, references_um, volts

SPAN_S = 5.0  # that is shown
POINTS = 500  # of it at most


class Live(NamedTuple):
    """The latest seconds of a recording, thinned out."""

    time_s: np.ndarray  # before the latest sample, which has 0
    columns: dict[str, np.ndarray]  # of the same length, by the names of a recording's columns; NaN where there was none
    samples: int  # that have come in all
    missing: int  # that are lost


def latest_seconds(decoder: Decoder, um_per_count: float | None = None, count_0_um: float | None = None) -> Live | None:
    """command_V, and what there is of reference_um, displacement_um and error_um; None before rate and scale are known.

    error_um is reference_um - displacement_um. The scale of the sensor is the firmware's unless it is given.
    """
    run, info = decoder.runs[-1], decoder.info
    if info is None or not run.pieces:
        return None
    wanted, pieces = SPAN_S * info.rate_hz, []
    for piece in reversed(run.pieces):
        pieces.append(piece)
        wanted -= len(piece)
        if wanted <= 0:
            break
    samples = np.concatenate([np.empty(0, BODY), *reversed(pieces)])
    time_s = (samples["tick"].astype(float) - float(samples["tick"][-1])) / info.rate_hz
    samples, time_s = samples[time_s >= -SPAN_S], time_s[time_s >= -SPAN_S]
    thin = np.unique(np.linspace(0, len(samples) - 1, POINTS).round().astype(int))
    samples, time_s = samples[thin], time_s[thin]
    columns = {"command_V": volts(info, samples["dac_code"])}
    if info.numbers != NO_REFERENCE:
        columns["reference_um"] = references_um(info, samples)
    if (read := samples["adc_counts"] != NO_READING).any():
        columns["displacement_um"] = np.where(
            read, displacement_um(info, samples["adc_counts"], um_per_count, count_0_um), np.nan)
    if {"reference_um", "displacement_um"} <= columns.keys():
        columns["error_um"] = columns["reference_um"] - columns["displacement_um"]
    return Live(time_s, columns, decoder.counts.samples, decoder.counts.missing)
