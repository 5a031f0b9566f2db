"""What a commissioning drive will and will not be able to show, said before it is played."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ..data import Recording
from .effects import BEFORE_MONITOR, CATALOGUE
from .effects.planned import MISFIT, NOISE, PlannedDrive, Shown

LEAST_SWING, FEW = 0.01, 5  # of the range: smaller ones are no loops; percent of the loops may be smaller than is said
LEAST_RATIO = 2.0  # of the fastest triangle's rate to the slowest's: less tells no law
ASIDE = 0.05  # of the range from the middle: a beginning nearer to it shows nothing of the start
ASSUMED = (f"the sensor's noise is {100 * NOISE:g} % of the stroke, and the operator misses {100 * MISFIT:g} % of a "
           "move")


def shown(columns: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> dict[str, Shown]:
    """What the drive that `make_drive` made of kind "commission" can show, by what it is."""
    drive = PlannedDrive(Recording("drive", dict(metadata), dict(columns)))
    loops = _operator(drive)
    found = {"operator": loops, "rate law": _rate_law(drive), "start": _start(drive, loops)}
    for kind in CATALOGUE.values():
        if (one := kind().shown(drive)) is not None:
            found[kind.title] = one
    return found | dict(_places(found))


def _operator(drive: PlannedDrive) -> Shown:
    swings = np.abs(np.diff(drive.u[drive.turns]))
    swings = swings[swings > LEAST_SWING]
    small, large = float(np.percentile(swings, FEW)), float(swings.max())
    return Shown(f"{len(swings)} branches, {100 - FEW} % of them over {100 * small:.2g} % of the range or more, up to "
                 f"{100 * large:.3g} %; smaller loops are extrapolated", small, large, "of the range")


def _rate_law(drive: PlannedDrive) -> Shown:
    speed = drive.speed[drive.parts["sawtooth"]]
    slow, fast = np.percentile(speed[speed > 0] * drive.span_V, (1, 99))
    if fast < LEAST_RATIO * slow:
        return Shown(f"all triangles have about {fast:.3g} V/s; give a longer --duration or allow a higher --slew")
    change = drive.speed / drive.speed.max() * drive.z
    least = drive.least([change], [drive.later(), drive.lagged(drive.step_s)], "rate law")[0]
    return Shown(f"slopes from {slow:.4g} to {fast:.4g} V/s; changes of {100 * least:.2g} % or more over that range; "
                 "faster motion is extrapolated", float(slow), float(fast), "V/s")


def _start(drive: PlannedDrive, loops: Shown) -> Shown:
    """Where a sweep leaves an actuator. In the middle of the range it leaves all alike."""
    text = "whether inner loops are forgotten, which tells where a decaying sweep leaves the actuator"
    if abs(drive.u[0]) > ASIDE:
        text += f"; the beginning too, if a sweep ended at {drive.run.command_V[0]:.4g} V right before it"
    return loops._replace(text=text)


def _places(found: Mapping[str, Shown]) -> Iterator[tuple[str, Shown]]:
    """What acts alike ahead of the actuator and behind it."""
    alike = [kind.title for kind in CATALOGUE.values() if kind.title in found and found[kind.title].low is not None
             and {stage in BEFORE_MONITOR for stage in kind.stages} == {True, False}]
    if alike:
        yield "amplifier or sensor", Shown(f"whose {' or '.join(alike)} it is can be told with monitor_V only")
