"""Samples of telemetry as recordings: the stretches without a gap, and what the user should know about them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np

from ..data import MIN_SAMPLES, amid, sample_times
from .sweep import OFF_THE_MIDDLE, STILL
from .telemetry import (BODY, HELD, NO_READING, NO_REFERENCE, SWEEP, Decoder, Info, Run, displacement_um, references_um,
                        step_by, ticks_between, volts)

MOST = 0.8  # of the samples received: a recording with fewer is worth a word


class Stretch(NamedTuple):
    """Samples without a gap: the columns and the metadata of a recording."""

    columns: dict[str, np.ndarray]
    metadata: dict[str, object]
    why_unknown: str  # where `memory` is that, what kept a start-up sweep from making it reset

    @property
    def samples(self) -> int:
        return len(self.columns["time_s"])


def stretches(decoder: Decoder, um_per_count: float | None = None, count_0_um: float | None = None,
              others: Sequence[Decoder] = ()) -> list[Stretch]:
    """Every unbroken stretch of at least 16 samples after the start-up sweep, in order, as a recording.

    A stretch ends where a sample is missing, or has no reading while others have one. `memory` is reset if the sweep
    was received from the first sample to the last, ends amid its own range, and the stretch begins where it ended: with
    references, at the first one if the drive stays; without, at the sweep's last sample. `um_per_count` and
    `count_0_um` replace the firmware's. `others` are those of the same stream that heard the other axes: their drives
    become columns, see _drives.
    """
    found = []
    for number, run in enumerate(decoder.runs):
        if len(samples := run.samples):
            read = bool((samples["adc_counts"] != NO_READING).any())
            parts = [part for _, part in _stretches(samples, decoder.info_of(run), um_per_count, count_0_um, read)]
            same = [other for other in others if len(other.runs) == len(decoder.runs)]
            found += [part._replace(columns=part.columns | _drives(part, number, same, len(others) + 1))
                      for part in parts]
    counts = {f"telemetry_{name}": count for name, count in asdict(decoder.counts).items() if name != "corrupt_at_end"}
    return [stretch._replace(metadata=stretch.metadata | counts) for stretch in found]


def _drives(stretch: Stretch, run: int, others: Sequence[Decoder], axes: int) -> dict[str, np.ndarray]:
    """The drives of the other axes in V, by column: other_axis_V of two axes, axis_0_V and so on of more.

    Where a sample of theirs is missing it is the one before; an axis of which none came by then has no column.
    """
    ticks = int(stretch.metadata["first_tick"]) + np.arange(stretch.samples)
    columns = {}
    for other in others:
        samples = other.runs[run].samples
        at = np.searchsorted(samples["tick"], ticks, side="right") - 1
        if len(samples) and at[0] >= 0:
            name = "other_axis_V" if axes == 2 else f"axis_{other.axis}_V"
            columns[name] = volts(other.info_of(other.runs[run]), _output(samples)[at])
    return columns


class Following:
    """The same stretches while the stream still comes, with what can be known by then.

    Not known are the counts, and that a stretch will lack a column: a sample without a reference begins another.
    """

    def __init__(self, decoder: Decoder, um_per_count: float | None = None, count_0_um: float | None = None) -> None:
        self._decoder = decoder
        self._scale = um_per_count, count_0_um
        self._run = -1
        self._begin_run()

    def new(self) -> Iterator[tuple[bool, Stretch]]:
        """What has come since the last call: whether it goes on with the stretch before, and the samples.

        May be called from another thread than the decoder's: that only appends, to runs, pieces and infos.
        """
        while self._decoder.info is not None:  # without rate and scale it is no recording yet
            over = self._run + 1 < len(self._decoder.runs)  # asked before its pieces are taken: then none is to come
            yield from self._take(self._decoder.runs[self._run])
            if not over:
                return
            self._begin_run()

    def _begin_run(self) -> None:
        self._run += 1
        self._pieces = 0  # taken of those of the run
        self._rest = np.empty(0, BODY)  # of them what may be needed again
        self._read = False  # whether any had a reading
        self._info: Info | None = None
        self._open: tuple[str, ...] = ()  # columns of the stretch of which the rest is the last sample
        self._samples = 0  # of it

    def _take(self, run: Run) -> Iterator[tuple[bool, Stretch]]:
        pieces = run.pieces[self._pieces:]
        if not pieces:
            return
        self._pieces += len(pieces)
        samples = np.concatenate([self._rest, *pieces])
        self._read |= bool((samples["adc_counts"] != NO_READING).any())
        if not self._open or self._info is None:
            self._info = self._decoder.info_of(run)
        before, self._open = self._open, ()
        for start, part in _stretches(samples, self._info, *self._scale, self._read, goes_on=bool(before)):
            columns = part.columns
            goes_on = start == 0 and bool(before) and columns.keys() >= set(before)
            if goes_on:
                columns = {name: columns[name][1:] for name in before}
                columns["time_s"] = sample_times(part.samples - 1, self._info.rate_hz, self._samples)
                self._samples += part.samples - 1
            elif part.samples >= MIN_SAMPLES:
                self._samples = part.samples
            else:
                continue
            if len(columns["time_s"]):
                yield goes_on, part._replace(columns=columns)
            if start + part.samples == len(samples):
                self._open = tuple(columns)
        if self._open:
            self._rest = samples[-1:].copy()
            self._rest["dac_code"] = _output(samples)[-1]  # where the DAC is, should it not take the next codes
            self._rest["flags"] &= ~np.uint16(HELD)
        else:  # from the last break on, and a start-up sweep before it
            starts = _starts(samples, self._info, self._read)
            swept = len(starts) > 1 and samples["flags"][starts[-2]] & SWEEP
            self._rest = samples[starts[-2 if swept else -1]:]


def _stretches(samples: np.ndarray, info: Info, um_per_count: float | None, count_0_um: float | None, read: bool,
               goes_on: bool = False) -> list[tuple[int, Stretch]]:
    """Stretches and where they start. `read`: there are readings, so that a sample needs one.

    `goes_on`: the first sample is the last of a stretch before; what goes on with it may be of any length.
    """
    starts = _starts(samples, info, read)
    ends = np.r_[starts[1:], len(samples)]
    sweeping = samples["flags"] & SWEEP != 0
    held = samples["flags"] & HELD != 0
    last_code = 2**info.dac_bits - 1
    output, usable = _output(samples), _usable(samples, info, read)
    swept = int(np.argmin(sweeping))  # samples of the sweep, if all of them are there
    if samples["tick"][0] != 1 or sweeping[swept] or not _whole(samples)[:swept].all():
        swept = 0
    no_sweep = "the start-up sweep was not received completely" if sweeping.any() else ""
    wanted = ~sweeping[starts] & usable[starts]
    found = []
    for start, end in zip(starts[wanted].tolist(), ends[wanted].tolist()):
        why = "" if 0 < start == swept else "it does not start at the end of the sweep" if swept else no_sweep
        reset = 0 < start == swept
        if reset and info.numbers == NO_REFERENCE and usable[start - 1]:
            start -= 1
        if held[start]:  # which code it was is not known
            start += int(np.argmin(np.r_[held[start:end], False]))
            reset, why = False, "the DAC did not take the code at the end of the sweep" if reset else why
        if end - start < (1 if goes_on and start == 0 else MIN_SAMPLES):
            continue
        if reset and abs(int(output[start]) - int(output[swept - 1])) > STILL * last_code:
            reset, why = False, "the drive jumps at the end of the sweep"
        if reset and not amid(int(output[swept - 1]), int(output[:swept].min()), int(output[:swept].max())):
            reset, why = False, OFF_THE_MIDDLE
        metadata = {"sample_rate_hz": info.rate_hz, "memory": "reset" if reset else "unknown",
                    "first_tick": int(samples["tick"][start])}
        columns = _columns(samples[start:end], output[start:end], info, um_per_count, count_0_um)
        if info.numbers != NO_REFERENCE and "reference_um" not in columns:
            metadata["without_reference"] = int((~np.isfinite(references_um(info, samples[start:end]))).sum())
        found.append((start, Stretch(columns, metadata, why)))
    return found


def _starts(samples: np.ndarray, info: Info, read: bool) -> np.ndarray:
    """Samples that do not go on from the one before, or of which one of the two is of the sweep, or not usable."""
    sweeping, usable = samples["flags"] & SWEEP != 0, _usable(samples, info, read)
    return np.r_[0, np.flatnonzero(~_whole(samples) | np.diff(sweeping) | ~usable[1:] | ~usable[:-1]) + 1]


def _whole(samples: np.ndarray) -> np.ndarray:
    """Whether nothing is between a sample and the next."""
    return step_by(samples, "sequence", 1) & (ticks_between(samples) == 1)


def _usable(samples: np.ndarray, info: Info, read: bool) -> np.ndarray:
    possible = samples["dac_code"] <= 2**info.dac_bits - 1
    return possible & (samples["adc_counts"] != NO_READING) if read else possible


def _output(samples: np.ndarray) -> np.ndarray:
    """The codes that the DAC was at: where it held one, that of the last sample which it took."""
    held = samples["flags"] & HELD != 0
    return samples["dac_code"][np.maximum.accumulate(np.where(held, 0, np.arange(len(samples))))]


def _columns(samples: np.ndarray, output: np.ndarray, info: Info, um_per_count: float | None,
             count_0_um: float | None) -> dict[str, np.ndarray]:
    """Of a recording, with what there is: no displacement without readings, no reference where one is none.

    `output` are the codes that the DAC was at; those of the samples are what it was given.
    """
    columns = {"time_s": sample_times(len(samples), info.rate_hz), "command_V": volts(info, output)}
    if (samples["adc_counts"] != NO_READING).all():
        columns["displacement_um"] = displacement_um(info, samples["adc_counts"], um_per_count, count_0_um)
    if info.numbers != NO_REFERENCE and np.isfinite(reference := references_um(info, samples)).all():
        columns["reference_um"] = reference
    return columns | {"dac_code": samples["dac_code"].astype(float), "flags": samples["flags"].astype(float)}


def notes(decoder: Decoder, found: list[Stretch], written: list[Stretch]) -> list[str]:
    """What the user should know about the recordings written of those found in a stream."""
    counts, info, said = decoder.counts, decoder.info_of(decoder.runs[-1]), []
    if counts.resets:
        said.append(f"the target was reset {counts.resets} times; a recording never spans a reset")
    for run in decoder.runs:
        if run.pieces and not run.started and (first := int(run.pieces[0]["tick"][0])) > 1:
            said.append(f"the target was already running: samples before tick {first} were not received")
        constants = Counter(told.constants for told in run.infos)
        if len(constants) > 1:
            said.append(f"the {len(run.infos)} info frames of one run contain {len(constants)} different rates or "
                        "scales; the most frequent are used")
    if info.refused_count:
        said.append(f"the target could not send {info.refused_count} samples: its line is too slow")
    if info.overruns or counts.ticks_lost:
        said.append(f"the target reports {info.overruns} lost ticks{_longest_tick(info)}")
    if info.held_count:
        said.append(f"the DAC did not take {info.held_count} codes; command_V is the drive that it held instead. Check "
                    "that --dac-bits of the fit matches the board's DAC")
    if counts.unconfirmed:
        said.append(f"{counts.unconfirmed} samples are not used: both neighbours are lost, so nothing confirms them")
    if counts.corrupt_at_end and not decoder.runs[-1].finished:
        said.append(f"{counts.corrupt_at_end} corrupt frames came after the last sample: that many more samples may be "
                    "lost")
    received = sum(int(np.count_nonzero(run.samples["flags"] & SWEEP == 0)) for run in decoder.runs)
    if len(written) < len(found) and written[0].samples < MOST * received:
        said.append(f"the longest stretch without a gap has {written[0].samples} of the {received} samples received; "
                    f"--stretches writes all {len(found)}")
    if any("displacement_um" not in stretch.columns for stretch in written):
        said.append("there is no displacement_um: the target does not read a sensor")
    if without := sum(int(stretch.metadata.get("without_reference", 0)) for stretch in written):
        said.append(f"there is no reference_um: {without} samples had no reference")
    return said


def _longest_tick(info: Info) -> str:
    if info.longest_tick_cycles == 0:  # a board without cycle counter
        return ""
    took = f"; the longest tick took {info.longest_tick_cycles} cycles"
    if info.cycles_per_s > 0:
        took += f" ({info.longest_tick_cycles / info.cycles_per_s:.3g} s; the period is {1 / info.rate_hz:.3g} s)"
    return took
