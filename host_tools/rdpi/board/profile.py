"""The C header of a reference or a drive: the table that port/profile or examples/excite compiles in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import version
from ..data import Recording
from ..errors import BadInput
from ..firmware import comment, file_name, template
from ..model import MAX_DAC_BITS, MAX_REFERENCE_UM

MAX_RATE_HZ = 2**32 - 1
COLUMNS = 120
NONE = "RDPI_PROFILE_NONE"


def render_reference(run: Recording, column: str = "reference_um") -> str:
    """The header of a reference, in um.

    Raises BadInput where the firmware could not follow it: no whole number of samples per second, no usable value.
    """
    if not usable(run.columns[column]).any():
        raise BadInput(f"{run.path}: {column} has no value within ±{MAX_REFERENCE_UM:g} um, the largest reference; "
                       "check its unit")
    return render(run, integer_rate_hz(run), literals(run.columns[column]))


def usable(reference_um: np.ndarray) -> np.ndarray:
    """Whether the firmware takes a reference rather than hold the drive."""
    return np.abs(reference_um) <= MAX_REFERENCE_UM


def literals(reference_um: np.ndarray) -> list[str]:
    """References as port/profile converts them; what is not usable is none, which the firmware treats alike."""
    return [f"RDPI_PROFILE_UM({um!r})" if good else NONE
            for um, good in zip(reference_um.tolist(), usable(reference_um).tolist())]


def render(run: Recording, rate_hz: int, references: Sequence[str]) -> str:
    """The header of references written for C; `run` is where they come from."""
    return template("rdpi_profile.h.j2").render(
        version=comment(version()), source=comment(file_name(run.path)), digest=run.digest, rate_hz=rate_hz,
        count=len(references), dac=None, rows=_rows(references))


def render_drive(run: Recording, dac_bits: int, min_V: float, max_V: float) -> str:
    """The header of a drive, as codes of a DAC that spans min_V to max_V.

    Raises BadInput for volts beyond that, and for what render_reference refuses.
    """
    codes, swept = drive_codes(run, dac_bits, min_V, max_V), sweep_samples(run)
    return template("rdpi_profile.h.j2").render(
        version=comment(version()), source=comment(file_name(run.path)), digest=run.digest,
        rate_hz=integer_rate_hz(run), count=len(codes), dac=(dac_bits, float(min_V), float(max_V)), swept=swept,
        rows=_rows([f"{code}u" for code in codes.tolist()]))


def drive_codes(run: Recording, dac_bits: int, min_V: float, max_V: float) -> np.ndarray:
    """The nearest codes to a recording's command, int64 (samples,)."""
    if not 1 <= dac_bits <= MAX_DAC_BITS or not -1e6 <= min_V < max_V <= 1e6:
        raise BadInput(f"--dac {dac_bits}:{min_V:g}:{max_V:g}: give 1 to {MAX_DAC_BITS} bits and the volts of the "
                       "first and the last code, in rising order")
    command_V = run.command_V
    step_V = (max_V - min_V) / (2**dac_bits - 1)
    if command_V.min() < min_V - step_V / 2 or command_V.max() > max_V + step_V / 2:
        raise BadInput(f"{run.path}: command_V spans {command_V.min():g} to {command_V.max():g} V, the DAC {min_V:g} "
                       f"to {max_V:g} V; make a drive with --min-V and --max-V within that, or correct --dac")
    return np.rint((command_V - min_V) / step_V).clip(0, 2**dac_bits - 1).astype(np.int64)


def sweep_samples(run: Recording) -> int:
    """How many samples at the front are a decaying sweep, as `rdpi excite` says."""
    text = run.metadata.get("sweep_s")
    if text is None:
        return 0
    try:
        samples = round(float(text) * run.sample_rate_hz) + 1
    except (ValueError, OverflowError):
        samples = 0
    if not 1 <= samples <= len(run):
        raise BadInput(f"{run.path}: sweep_s is {text!r}; give the duration of the sweep in s, at most that of the "
                       "file")
    return samples


def integer_rate_hz(run: Recording) -> int:
    """Samples per second, which the firmware takes as a whole number; times are in whole nanoseconds."""
    rate = run.sample_rate_hz
    slack = 1e-9 * (1 + 1 / float(run.time_s[-1] - run.time_s[0]))
    if not (1 <= rate <= MAX_RATE_HZ and abs(rate - round(rate)) <= slack * rate):
        raise BadInput(f"{run.path}: {rate:.9g} samples per second; the firmware takes whole numbers only. Resample it "
                       "with `rdpi import --resample`. If only the times are inexact, add a line `# sample_rate_hz: …`")
    return round(rate)


def _rows(numbers: Sequence[str]) -> list[str]:
    """Lines of an initialiser."""
    width = COLUMNS - 4
    lines: list[list[str]] = [[]]
    length = 0
    for number in numbers:
        if length and length + len(number) + 2 > width:
            lines.append([])
            length = 0
        lines[-1].append(number)
        length += len(number) + 2
    return [", ".join(line) + "," for line in lines]
