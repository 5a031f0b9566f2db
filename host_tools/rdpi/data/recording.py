"""Recordings: one CSV file per run, `# key: value` metadata, a line of column names, then numbers.

Column names carry their units. Sampling is uniform, and that is checked, not assumed: see `check_samples`.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from . import arguments
from ..errors import BadInput
from .files import atomic_write, read_bytes, write_all
from .rows import NUMBER, Place, line_of_row, parse_rows, quoted

MIN_SAMPLES = 16
UNFINISHED = "unfinished"  # first key of a recording that still grows; what it is set to is for people
ENDS = ("low", "high")  # of the drive, where it rested
MEMORY = ("reset", *ENDS, "carried", "unknown")
AT_END = 0.02  # of the drive's range in a recording, by which it may begin beside its end
LONGEST_REST_S = 1e9
RUN_COLUMNS = ("time_s", "command_V", "displacement_um")
GRID_TOLERANCE = 0.25  # of a sample time; a lost sample moves some time by at least 0.5
RATE_TOLERANCE = 1e-3  # relative, between stated and measured rate
LARGEST = 1e12  # V or um; no actuator has as much, and squares stay far from overflow
LARGEST_OTHER = 1e100  # of covariates, whose units are unknown
RATES_HZ = (1e-6, 1e8)  # samples per second; times are written in whole nanoseconds

_NAME = re.compile(r'(?!#)[^,"\r\n\ud800-\udfff]+')  # surrogates stand for bytes that are no UTF-8
_ROWS_PER_WRITE = 1 << 16


class Past(NamedTuple):
    """What an actuator did before a recording: moves that ended at its first sample's displacement, none by default, and
    the memory of the plays that all of it has left.
    """

    away_um: np.ndarray = np.zeros(0)  # from how far away each came, (moves,)
    since_s: np.ndarray = np.zeros(0)  # how long before the first sample, (moves,)
    rest_um: float = 0.0  # from the first sample to where the actuator had rested for long
    thresholds_V: np.ndarray = np.zeros(0)  # (plays,); none: as the metadata state it
    plays_V: np.ndarray = np.zeros(0)  # the drive at which each play rests, (plays,)
    rate_um_per_s: float = 0.0  # behind the low-pass of the rate, where there is one


@dataclass(frozen=True, eq=False)
class Recording:
    """One run. Columns are float64, 1-D and equally long; metadata and columns keep the file's order."""

    path: str
    metadata: dict[str, str]
    columns: dict[str, np.ndarray]
    digest: str = field(default="")  # "sha256:…" of the file's bytes
    past: Past | None = None  # as estimated; None: as the metadata state it

    @classmethod
    def from_arrays(cls, time_s: Sequence[float] | np.ndarray, command_V: Sequence[float] | np.ndarray,
                    displacement_um: Sequence[float] | np.ndarray, memory: str = "unknown",
                    rested_s: float | None = None, **columns: Sequence[float] | np.ndarray) -> Recording:
        """A recording of arrays of numbers, all (samples,): times in s, evenly spaced, drive in V, displacement in um.

        `memory` says what the actuator remembers at the first sample: "reset", a decaying sweep ended here; "low" or
        "high", the drive came to that end of its range and rested there, for `rested_s` seconds if that is known;
        "carried", the recording before it in a list goes on; or "unknown". Further columns carry their unit in their
        name: monitor_V, temperature_degC.

        Raises BadInput that names the argument, as `read_recording` names the place.

        >>> time_s = np.arange(1000) / 1000
        >>> command_V = 50 - 50 * np.cos(2 * np.pi * 5 * time_s)
        >>> run = Recording.from_arrays(time_s, command_V, 0.1 * command_V, memory="reset")
        >>> len(run), run.sample_time_s, run.memory
        (1000, 0.001, 'reset')
        """
        given = {"time_s": time_s, "command_V": command_V, "displacement_um": displacement_um, **columns}
        for name in given:
            if not is_column_name(name):
                raise BadInput(f"{name!r}: is no name of a column")
        arrays = {name: arguments.series(values, name) for name, values in given.items()}
        for name, values in arrays.items():
            if len(values) != len(arrays["time_s"]):
                raise BadInput(f"{name}: has {len(values)} values, time_s has {len(arrays['time_s'])}")
        metadata = {"memory": arguments.one_of(memory, MEMORY, "memory")}
        if rested_s is not None:
            metadata["rested_s"] = repr(arguments.number(rested_s, "rested_s", finite=False))
        check_metadata(metadata, "{}".format)
        check_samples("time_s", arrays, "sample {}".format)
        check_sizes(arrays, "sample {}".format)
        check_end(arrays, metadata, "memory")
        return cls("arrays", metadata, {name: values.copy() for name, values in arrays.items()})

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def time_s(self) -> np.ndarray:
        return self.columns["time_s"]

    @property
    def command_V(self) -> np.ndarray | None:
        return self.columns.get("command_V")

    @property
    def displacement_um(self) -> np.ndarray | None:
        return self.columns.get("displacement_um")

    @property
    def reference_um(self) -> np.ndarray | None:
        return self.columns.get("reference_um")

    @property
    def sample_rate_hz(self) -> float:
        """The stated rate, or else the mean rate of the times to nine digits (more is rounding noise)."""
        if "sample_rate_hz" in self.metadata:
            return float(self.metadata["sample_rate_hz"])
        return float(f"{1 / _grid(self.time_s)[0]:.9g}")

    @property
    def sample_time_s(self) -> float:
        return 1 / self.sample_rate_hz

    @property
    def memory(self) -> str:
        """What the actuator remembers at the first sample: "reset", "low", "high", "carried" or "unknown"."""
        return self.metadata.get("memory", "unknown")


def taken(runs: Sequence[Recording], needs: Sequence[str], name: str = "runs", least: int = 0) -> list[Recording]:
    """These recordings, their columns as float64. Raises BadInput for what is none, and one that lacks a column it
    needs or has columns that are not of one length or not finite; `reference_um` may hold NaN, which is no reference.
    Whoever made one by hand may have made anything.
    """
    found = []
    for run in arguments.listed(runs, Recording, name):
        def key_place(key: str, path: object = run.path) -> str:
            return f"{path}: metadata"

        check_metadata(arguments.of_kind(run.metadata, dict, f"{run.path}: metadata"), key_place)
        columns = {arguments.of_kind(key, str, f"{run.path}: columns"):
                   arguments.series(values, f"{run.path}: {key}", finite=key != "reference_um")
                   for key, values in arguments.of_kind(run.columns, dict, f"{run.path}: columns").items()}
        for key in ("time_s", *needs):
            if key not in columns:
                raise BadInput(f"{run.path}: there is no column {key}")
        for key, values in columns.items():
            if len(values) != len(columns["time_s"]):
                raise BadInput(f"{run.path}: {key} has {len(values)} values, time_s has {len(columns['time_s'])}")
        check_samples(run.path, columns, lambda row, run=run: f"{run.path}, sample {row}")
        check_rate(columns["time_s"], run.metadata, key_place)
        check_end(columns, run.metadata, run.path)
        same = all(columns[key] is run.columns[key] for key in columns)
        found.append(run if same else replace(run, columns=columns))
    if len(found) < least:
        raise BadInput(f"{name}: give at least one recording")
    return found


def read_recording(path: str | os.PathLike[str], required: Sequence[str] = RUN_COLUMNS) -> Recording:
    """Read and check one recording.

    `required` names the columns that must be there; `time_s` always must. Every other column is kept as a covariate.
    UTF-8 with or without a byte-order mark, any line ends, blank lines ignored. A metadata key given on several
    lines is one value of several lines; `#` lines without a colon are comments and are dropped. Of a recording that was
    cut off while it grew, all whole lines are read.

    Raises BadInput for a file that cannot be read, missing or repeated columns, text, NaN or infinity in a number,
    rows of unequal length, an unknown `memory`, and everything `check_samples` checks.
    """
    path, required = arguments.path(path), arguments.listed(required, str, "required")
    data = read_bytes(path)
    text = _decode(path, whole_lines(data))
    metadata, key_lines, header_line, header, body = _split_header(path, text)
    names = _column_names(path, header_line, header, dict.fromkeys(("time_s", *required)))
    place = line_of_row(path, body, header_line + 1)
    table = parse_rows(path, body, header_line + 1, names)
    columns = {name: np.ascontiguousarray(table[:, index]) for index, name in enumerate(names)}

    def key_place(key: str) -> str:
        return f"{path}:{key_lines[key]}"

    check_metadata(metadata, key_place)
    check_samples(path, columns, place)
    check_rate(columns["time_s"], metadata, key_place)
    if "memory" in metadata:
        check_end(columns, metadata, key_place("memory"))
    return Recording(path, metadata, columns, f"sha256:{hashlib.sha256(data).hexdigest()}")


def write_recording(path: str | os.PathLike[str], columns: Mapping[str, np.ndarray],
                    metadata: Mapping[str, object]) -> None:
    """Write a recording atomically; every number reads back as the same float64.

    Columns and metadata keep the order they are given in. Raises ValueError for columns of unequal length, NaN or
    infinity, and names that the format cannot hold.
    """
    arrays = _checked(columns)
    atomic_write(path, _head(columns, metadata) + "".join(_format_rows(arrays)))


class GrowingRecording:
    """A recording that is on disk up to the last `append`, and that `read_recording` reads wherever it is cut off.

    Its first line has the key UNFINISHED: where that is, a last line without its end is no sample. A number that has
    lost its last digits is another number. The file is there from its first samples on, of which there must be enough.
    """

    def __init__(self, path: str | os.PathLike[str], columns: Mapping[str, np.ndarray], metadata: Mapping[str, object],
                 note: str) -> None:
        """`note` is the value of UNFINISHED. Raises as `write_recording` does."""
        self.path = Path(path)
        self.names = tuple(columns)
        self.samples = len(columns["time_s"])
        write_recording(path, columns, {UNFINISHED: note, **metadata})
        self._file = open(path, "ab", buffering=0)

    def append(self, columns: Mapping[str, np.ndarray]) -> None:
        """Further samples, of the same columns. Returns when they are on disk. Raises OSError, which names the file."""
        try:
            write_all(self._file, "".join(_format_rows(_checked(columns))).encode())
        except OSError as error:
            error.filename = os.fspath(self.path)
            raise
        self.samples += len(columns["time_s"])

    def close(self) -> None:
        self._file.close()

    def remove(self) -> None:
        self.close()
        with suppress(OSError):
            self.path.unlink()


def whole_lines(data: bytes) -> bytes:
    """A recording that was cut off while it grew, up to the last whole line; any other file as it is.

    A file system may have made the file longer than what it had written of it: then zeros follow.
    """
    if not data.startswith(f"# {UNFINISHED}:".encode()):
        return data
    data = data.partition(b"\0")[0]
    return data[:data.rfind(b"\n") + 1]


def is_column_name(name: str) -> bool:
    """Whether a column of a recording can have this name."""
    return name == name.strip() and _NAME.fullmatch(name) is not None


def sample_times(count: int, rate_hz: float, first: int = 0) -> np.ndarray:
    """Times of `count` uniform samples from number `first` on, in whole nanoseconds so that they print short."""
    return np.round(np.arange(first, first + count) / rate_hz, 9)


def check_metadata(metadata: Mapping[str, str], key_place: Callable[[str], str]) -> None:
    """Raise BadInput unless `memory`, `rested_s` and `sample_rate_hz`, where given, are so written and can be used."""
    for key in metadata:
        known = str(key).lower()
        if key != known and known in ("memory", "rested_s", "sample_rate_hz"):
            raise BadInput(f"{key_place(key)}: write {known} in lower case, not {quoted(str(key))}")
    memory = metadata.get("memory")
    if memory is not None and memory not in MEMORY:
        raise BadInput(f"{key_place('memory')}: memory is {quoted(str(memory))}; use one of {', '.join(MEMORY)}")
    rested = metadata.get("rested_s")
    if rested is not None and not (NUMBER.fullmatch(str(rested)) and 0 <= float(rested) <= LONGEST_REST_S):
        raise BadInput(f"{key_place('rested_s')}: rested_s is {quoted(str(rested))}; give the time in s for which the drive "
                       f"had rested at its end before the first sample, 0 to {LONGEST_REST_S:g}")
    if rested is not None and memory not in ENDS:
        raise BadInput(f"{key_place('rested_s')}: rested_s says how long the drive rested at an end of its range: it goes "
                       f"with memory low or high, not with {quoted(str(memory or 'unknown'))}")
    rate = metadata.get("sample_rate_hz")
    if rate is not None and not (NUMBER.fullmatch(str(rate)) and RATES_HZ[0] <= float(rate) <= RATES_HZ[1]):
        raise BadInput(f"{key_place('sample_rate_hz')}: sample_rate_hz is {quoted(str(rate))}; give a positive number of "
                       f"samples per second, {RATES_HZ[0]:g} to {RATES_HZ[1]:g}, or leave it out")


def check_end(columns: Mapping[str, np.ndarray], metadata: Mapping[str, str], place: str) -> None:
    """Raise BadInput if the drive begins elsewhere than at the end of its range where `memory` says that it rested."""
    end, drive_V = metadata.get("memory"), columns.get("command_V")
    if end not in ENDS or drive_V is None or not len(drive_V):
        return
    low_V, high_V = float(np.min(drive_V)), float(np.max(drive_V))
    end_V = low_V if end == "low" else high_V
    if not abs(drive_V[0] - end_V) <= AT_END * (high_V - low_V):
        raise BadInput(f"{place}: memory is {end}, but the drive begins at {drive_V[0]:.4g} V and goes on to {end_V:.4g} V; "
                       "say low or high only where it had rested at that end of its range")


@np.errstate(over="ignore", invalid="ignore")  # absurd times are refused by their step
def check_samples(path: str, columns: Mapping[str, np.ndarray], place: Place, first_row: int = 0) -> None:
    """Raise BadInput unless there are enough samples, at rising and uniform times.

    Uniform means: every time lies within a quarter of the sample time of the evenly spaced grid that fits all times
    best. That lets pass times printed with few digits and small jitter, and finds every lost sample and any change of
    rate that adds up. Times need not start at 0. `first_row` is the number of the first sample's row in its file.
    """
    time_s = columns["time_s"]
    check_count(path, time_s)
    check_rising(time_s, place)
    steps = np.diff(time_s)
    sample_time_s, deviation = _grid(time_s)
    if not 1 - RATE_TOLERANCE < sample_time_s * RATES_HZ[1] or not sample_time_s * RATES_HZ[0] < 1 + RATE_TOLERANCE:
        raise BadInput(f"{place(1)}: time_s steps by {sample_time_s:.6g} s; a recording has {RATES_HZ[0]:g} to "
                       f"{RATES_HZ[1]:g} samples per second. Give times in seconds")
    if deviation > GRID_TOLERANCE * sample_time_s:
        usual = float(np.median(steps))
        row = int(np.argmax(np.abs(steps - usual))) + 1
        raise BadInput(f"{place(row)}: sampling is not uniform: time_s steps by {steps[row - 1]:.6g} here and by "
                       f"{usual:.6g} elsewhere. If the clock jitters, use `rdpi import --resample`. If samples are "
                       f"missing, cut the recording with `rdpi import --rows` (this is row {first_row + row}). If only "
                       "the times are inexact, rebuild them with `rdpi import --rate`")


def check_sizes(columns: Mapping[str, np.ndarray], place: Place) -> None:
    """Raise BadInput for numbers that are no measurements, and with which no arithmetic is possible."""
    for name, values in columns.items():
        limit = LARGEST if name.endswith(("_V", "_um")) else LARGEST_OTHER
        row = int(np.argmax(np.abs(values)))
        if np.abs(values[row]) > limit and name != "time_s":
            raise BadInput(f"{place(row)}: {name} is {values[row]:g}, beyond ±{limit:g}; check its unit, cut the "
                           "recording there, or remove the column")


def check_count(path: str, samples: Sequence[float] | np.ndarray) -> None:
    """Raise BadInput unless there are enough samples."""
    if len(samples) < MIN_SAMPLES:
        raise BadInput(f"{path}: {len(samples)} samples; at least {MIN_SAMPLES} are needed")


def check_rising(time_s: np.ndarray, place: Place) -> None:
    """Raise BadInput unless every time is later than the one before."""
    steps = np.diff(time_s)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        what = "repeats" if steps[row - 1] == 0 else "runs backwards"
        raise BadInput(f"{place(row)}: time_s {what} ({time_s[row - 1]:.12g} then {time_s[row]:.12g}); cut the "
                       "recording there, write times with more digits, or rebuild them with `rdpi import --rate`")


def check_rate(time_s: np.ndarray, metadata: Mapping[str, str], key_place: Callable[[str], str]) -> None:
    """Raise BadInput when `sample_rate_hz`, where given, contradicts the times.

    They may differ by 0.1 %, and by what the grid tolerance at both ends of the recording leaves open.
    """
    if "sample_rate_hz" not in metadata:
        return
    stated, measured = float(metadata["sample_rate_hz"]), 1 / _grid(time_s)[0]
    if abs(stated / measured - 1) > RATE_TOLERANCE + 2 * GRID_TOLERANCE / (len(time_s) - 1):
        raise BadInput(f"{key_place('sample_rate_hz')}: sample_rate_hz is {stated:.9g}, but the times give "
                       f"{measured:.9g}; correct the wrong one (the times: `rdpi import --rate`)")


def _grid(time_s: np.ndarray) -> tuple[float, float]:
    """Step of the evenly spaced grid that fits the times best, and the largest deviation from it, in s."""
    index = np.arange(len(time_s)) - (len(time_s) - 1) / 2
    centred = time_s - time_s.mean()
    step = float(index @ centred / (index @ index))
    return step, float(np.abs(centred - step * index).max())


def _decode(path: str, data: bytes) -> str:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise BadInput(f"{path}:{line}: is not UTF-8 text; save the recording as CSV in UTF-8, "
                       "or convert another format with `rdpi import`") from None
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _split_header(path: str, text: str) -> tuple[dict[str, str], dict[str, int], int, str, str]:
    """Metadata, the line of each key, the line and text of the column names, and the body below."""
    metadata: dict[str, str] = {}
    key_lines: dict[str, int] = {}
    line_number = start = 0
    while start < len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        line, start, line_number = text[start:end].strip(), end + 1, line_number + 1
        if not line:
            continue
        if not line.startswith("#"):
            return metadata, key_lines, line_number, line, text[start:]
        key, colon, value = (part.strip() for part in line[1:].partition(":"))
        if colon and key:
            metadata[key] = f"{metadata[key]}\n{value}" if key in metadata else value
            key_lines[key] = line_number
    raise BadInput(f"{path}: {'contains no column names and no samples' if text.strip() else 'is empty'}; "
                   f"a recording has a line {','.join(RUN_COLUMNS)}, then one line for each sample")


def _column_names(path: str, line: int, header: str, required: Iterable[str]) -> list[str]:
    names = [name.strip().strip('"').strip() for name in header.split(",")]
    place = f"{path}:{line}"
    if all(NUMBER.fullmatch(name) for name in names):
        raise BadInput(f"{place}: there are numbers where the column names should be; "
                       "assign the columns with `rdpi import --command … --displacement …`")
    for name in required:
        if name not in names:
            raise BadInput(f"{place}: there is no column {name}; the columns are {_show_list(names)}. "
                           "Rename the column, or assign the columns with `rdpi import`")
    for index, name in enumerate(names):
        if not name:
            raise BadInput(f"{place}: column {index + 1} has no name; name it or remove it")
        if name in names[:index]:
            raise BadInput(f"{place}: column {name} exists twice; rename or remove one of them")
        if not is_column_name(name):
            raise BadInput(f"{place}: column {index + 1} is called {quoted(name)}; use a name without quotation marks "
                           "and without a leading #")
    return names


def _checked(columns: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """The columns as float64. Raises ValueError for those that the format cannot hold."""
    arrays = [np.asarray(column, dtype=np.float64) for column in columns.values()]
    if not arrays or any(array.ndim != 1 or len(array) != len(arrays[0]) for array in arrays):
        raise ValueError("columns must be 1-D and equally long")
    for name, array in zip(columns, arrays):
        if not is_column_name(name):
            raise ValueError(f"column name {name!r} cannot be written")
        if not np.isfinite(array).all():
            raise ValueError(f"column {name} holds NaN or infinity")
    return arrays


def _head(names: Iterable[str], metadata: Mapping[str, object]) -> str:
    """The lines above the numbers."""
    lines = []
    for key, value in metadata.items():
        if key != key.strip() or not key or re.search(r"[:\r\n]", key):
            raise ValueError(f"metadata key {key!r} cannot be written")
        lines += [f"# {key}: {line.strip()}".rstrip() for line in str(value).splitlines() or [""]]
    return "\n".join([*lines, ",".join(names)]) + "\n"


def _format_rows(arrays: Sequence[np.ndarray]) -> Iterator[str]:
    # Codes and counts look like integers in the file; 2^53 is where float64 stops telling integers apart.
    whole = [bool((np.abs(array) < 2.0**53).all() and (array == np.rint(array)).all()) for array in arrays]
    for start in range(0, len(arrays[0]), _ROWS_PER_WRITE):
        part = [array[start:start + _ROWS_PER_WRITE] for array in arrays]
        texts = [map(repr, (piece.astype(np.int64) if w else piece).tolist()) for piece, w in zip(part, whole)]
        yield "\n".join(map(",".join, zip(*texts))) + "\n"


def _show_list(names: Sequence[str]) -> str:
    shown = ", ".join(name if name.isprintable() and len(name) <= 40 else quoted(name) for name in names[:12])
    return shown + (f" and {len(names) - 12} more" if len(names) > 12 else "")
