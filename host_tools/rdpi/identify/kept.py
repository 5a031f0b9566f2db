"""Copies of the recordings of a fit, kept beside the model: `rdpi gap` compares later recordings with them.

A copy holds every n-th sample behind a low-pass. n is as large as the whole recording can still be had back: its drive
as the pairing of drives needs it, everything else up to its noise. Steps and other fast edges leave n at 1.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..data import (MIN_SAMPLES, RATES_HZ, Recording, filled, make_folder, read_recording, sample_times, thinned,
                    write_recording)
from ..errors import BadInput
from ..model import Model, beside, records
from ..simulate import signals
from . import thresholds as tuned
from .checks import same_drives

EVERY = (2, 4, 8, 16)  # tried in turn
WINDOW = 64  # samples over which an error is judged: an edge must not hide in a long recording
DIGITS = 7  # of a column's range that a thinned copy holds; noise is far above
LARGEST_EVERY, MOST_SAMPLES, STEPS_UM = 1000, 1e9, (1e-12, 1e9)  # of a file that was not damaged
NAMED = 5  # files in a message


def keep(runs: Sequence[Recording], folder: str | os.PathLike[str], model: Model) -> None:
    """Write a copy of each recording, which was read from a file, into a folder, which is made; tell the model.

    A name holds eight digits of the recording's digest, so no copy is written over that of another recording. Raises
    OSError.
    """
    make_folder(folder)
    entries = []
    for run in runs:
        every, names = _every(run), _needed(run)
        file = Path(os.path.abspath(folder)) / f"{Path(run.path).stem}-{run.digest.removeprefix('sha256:')[:8]}.csv"
        metadata = {**run.metadata, "kept": f"every {every} of {len(run)} samples"}
        columns = {name: run.columns[name] for name in ("time_s", *names)}
        if every > 1:
            columns = {name: _rounded(thinned(run.columns[name], every)) for name in names}
            rate_hz = run.sample_rate_hz / every
            times = sample_times(len(columns["command_V"]), rate_hz) + run.time_s[0]
            columns, metadata["sample_rate_hz"] = {"time_s": np.round(times, 9), **columns}, f"{rate_hz:.12g}"
        write_recording(file, columns, metadata)
        entries.append(records.KeptRun(
            file=file.as_posix(), digest=read_recording(file).digest, source=run.path, source_digest=run.digest,
            samples=len(run), sample_rate_hz=run.sample_rate_hz, every=every,
            step_um=signals.grid_step(run.displacement_um)).to_json())
    model.kept = entries


def lines(model: Model) -> list[str]:
    """What was kept, for people."""
    told = [records.KeptRun.from_json(one) for one in model.kept or ()]
    return [f"kept {one.source}: {os.path.relpath(one.file)}, " + (f"every {one.every} of" if one.every > 1 else "all")
            + f" {one.samples} samples" for one in told]


def earlier(model: Model, runs: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Kept recordings of the same drives as `runs`, and remarks; no recordings unless each run has one.

    A copy that is missing, has changed or cannot be read is left out, with a remark.
    """
    found, notes = [], []
    if model.kept is None:
        return found, notes
    for number, one in enumerate(model.kept if isinstance(model.kept, list) else [model.kept]):
        where = f"{model.where}: kept[{number}]"
        try:
            found.append(_whole(model, records.KeptRun.from_json(one, where), where))
        except BadInput as error:
            notes.append(f"a recording that was kept with the model is left out: {error}; put it back beside the model "
                         "file, or fit again with --keep")
    sources = [one.get("source_digest") for one in model.kept if isinstance(one, dict)] if found else []
    same = [run.path for run in runs if run.digest and run.digest in sources]
    try:
        if not found:
            return [], notes
        if same:
            raise BadInput(f"{', '.join(same)}: was kept itself")
        used = same_drives(runs, found)
    except BadInput as error:
        alone = [run.path for run in runs if run.path not in same and _has_copy(run, found)]
        hint = (f"; give {' and '.join(alone)} alone to compare with what was kept" if alone else
                "; their drives, recorded again, show smaller changes than others do")
        return [], [*notes, f"the recordings that were kept with the model are not used: {str(error).partition('; ')[0]}{hint}"]
    names = list(dict.fromkeys(run.path for run in used))
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return used, [f"as with --earlier, compared with recordings that were kept with the model: "
                  f"{', '.join(names[:NAMED])}{more}", *notes]


def _needed(run: Recording) -> list[str]:
    """Columns that a comparison uses: drive, displacement, and what effects follow."""
    return [name for name in run.columns if name == "displacement_um" or name.endswith(("_V", "_degC"))]


def _every(run: Recording) -> int:
    """The largest n of which every n-th sample holds the recording."""
    best = 1
    for every in EVERY:
        if len(run) // every < 4 * MIN_SAMPLES or not all(_holds(name, run.columns[name], every)
                                                          for name in _needed(run)):
            break
        best = every
    return best


def _holds(name: str, values: np.ndarray, every: int) -> bool:
    """Whether every n-th sample of a column holds all of it."""
    lost = np.abs(values - filled(_rounded(thinned(values, every)), every, len(values)))
    span = float(np.ptp(values))
    if name == "command_V":
        return float(np.max(lost)) <= tuned.LOST_DRIVE * span
    windows = lost[:len(lost) // WINDOW * WINDOW].reshape(-1, WINDOW)
    worst = float(np.sqrt(np.max(np.mean(windows**2, axis=1))))
    return worst <= tuned.LOST_NOISE * signals.noise_um(values) + tuned.LOST_RANGE * span


def _rounded(values: np.ndarray) -> np.ndarray:
    """To DIGITS digits of the range, which print short."""
    span = float(np.ptp(values))
    return np.round(values, DIGITS - int(np.floor(np.log10(span)))) if span > 0 else values


def _has_copy(run: Recording, found: Sequence[Recording]) -> bool:
    try:
        return bool(same_drives([run], found))
    except BadInput:
        return False


def _whole(model: Model, one: records.KeptRun, where: str) -> Recording:
    """The recording that a copy was made of. Raises BadInput for a copy that is not there or not as it was written."""
    for name, kind in (("file", str), ("digest", str), ("samples", int), ("every", int),
                       ("sample_rate_hz", (int, float)), ("step_um", (int, float)), ("source_digest", str)):
        if not isinstance(getattr(one, name), kind) or isinstance(getattr(one, name), bool):
            raise BadInput(f"{where}.{name}: is not as `rdpi fit` writes it")
    if not (1 <= one.every <= LARGEST_EVERY and 1 <= one.samples <= MOST_SAMPLES
            and RATES_HZ[0] <= one.sample_rate_hz <= RATES_HZ[1] and (one.step_um == 0 or STEPS_UM[0] <= one.step_um
                                                                      <= STEPS_UM[1])):
        raise BadInput(f"{where}: is not as `rdpi fit` writes it")
    run = read_recording(str(beside(model, one.file)))
    if run.digest != one.digest:
        raise BadInput(f"{run.path}: has changed since `rdpi fit` wrote it")
    if one.every == 1:
        return run
    if (len(run) - 1) * one.every + 1 < one.samples:
        raise BadInput(f"{where}.samples: the copy holds fewer")
    columns = {name: filled(values, one.every, one.samples) for name, values in run.columns.items() if name != "time_s"}
    if one.step_um > 0:  # a sensor with a grid has had it before
        columns["displacement_um"] = np.round(columns["displacement_um"] / one.step_um) * one.step_um
    times = run.time_s[0] + sample_times(one.samples, one.sample_rate_hz)
    return replace(run, metadata={**run.metadata, "sample_rate_hz": f"{one.sample_rate_hz:.12g}"},
                   columns={"time_s": times, **columns})
