"""A reference to the drive that the firmware makes of it: by the library on this machine, or by an emulated board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..data import Recording
from ..errors import BadInput
from ..firmware import Steps, flag_counts
from ..model import Model
from ..simulate import Inverse, chain, inverse_of, swept_ticks
from . import emulator, sweep as start_up


@dataclass(frozen=True)
class Compensation:
    """A drive and what is to be said of it."""

    columns: dict[str, np.ndarray]  # of the recording to write: the reference's, then the drive's
    metadata: dict[str, str]
    steps: Steps  # what the firmware returned, sample by sample
    flag_counts: dict[str, int]  # samples with each flag, by firmware.FLAGS
    offset_um: float  # removed from the reference
    asked_um: tuple[float, float]  # lowest and highest reference, offset removed
    score: chain.Score | None  # drive against the recorded command, in V instead of um; None without one that moves
    why_unknown: str  # why the memory after the start-up sweep is unknown, or ""


def compensate(model: Model, run: Recording, column: str = "reference_um", engine: str = "f32", *,
               fixed_point: bool = False, sweep: bool = False, remove_offset: bool = False,
               by: Inverse | None = None, report: Callable[[float], None] = lambda fraction: None) -> Compensation:
    """Run the inverse over a column of `run`, in um, as the firmware does.

    `engine` is "numpy", a key of firmware.ENGINES, or a key of emulator.MACHINES; only the latter take `fixed_point`.
    With `sweep` the firmware's start-up sweep comes first and is left out. `remove_offset` and `by` are those of
    chain.follow.
    `report` is called with the fraction done, 0 to 1.

    Raises BadInput for a model that the engine cannot have, for a reference without a usable value, and for what
    emulator.step refuses.
    """
    emulated = engine in emulator.MACHINES
    if fixed_point and not emulated:
        raise BadInput(f"--fixed-point: is only valid with the engines qemu-..., not with --engine {engine}")
    by = inverse_of(model) if by is None else by
    how: str | chain.Engine = engine
    if emulated:
        swept = swept_ticks(run.sample_time_s) if run.memory == "reset" and not sweep else 0
        how = partial(emulator.step, run=run, board=engine, fixed_point=fixed_point, sweep=sweep, chain=by.chain,
                      report=report, swept=swept)
    steps, offset_um = chain.follow(model, run, column, how, remove_offset, sweep, by)
    reference_um = run.columns[column]
    asked_um = reference_um[np.isfinite(reference_um)] - offset_um
    score, metadata, why_unknown = None, run.metadata, ""
    if run.command_V is not None and np.ptp(run.command_V) > 0:
        score = chain.score(steps.drive_V.astype(float), run.command_V, where=run.path)
    if sweep:
        memory, why_unknown = start_up.memory_after(by.model, float(steps.drive_V[0]))
        metadata = {**metadata, "memory": memory}
    return Compensation(_columns(by.model, run, reference_um, steps), metadata, steps, flag_counts(steps.flags),
                        offset_um, (float(asked_um.min()), float(asked_um.max())), score, why_unknown)


def _columns(model: Model, run: Recording, reference_um: np.ndarray, steps: Steps) -> dict[str, np.ndarray]:
    """Those of the reference's file, its command as recorded_V, and those of the drive."""
    columns = {name: values for name, values in run.columns.items() if name != "command_V"}
    columns["reference_um"] = reference_um
    columns.update(command_V=steps.drive_V.astype(float), rate_um_per_s=steps.rate_um_per_s.astype(float),
                   flags=steps.flags.astype(float))
    if model.drive.dac_bits:
        columns["dac_code"] = steps.dac_code.astype(float)
    if run.command_V is not None:
        columns["recorded_V"] = run.command_V
    return columns
