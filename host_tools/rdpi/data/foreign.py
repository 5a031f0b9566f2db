"""MATLAB and NumPy files, read in a process of their own.

Their readers are not ours: a damaged file makes SciPy's crash, and either may ask for any memory or never end. In a
process of its own, with a limit to its memory and its time, all of that is an error like any other.
"""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO

import numpy as np

START_S, S_PER_BYTE = 60.0, 2e-6  # time limit: a slow machine reads 1 MB in some 10 ms
START_BYTES, BYTES_PER_BYTE = 1 << 30, 20  # memory limit, beyond what the interpreter takes; packed data grow
NUMPY = b"\x93NUMPY", b"PK\x03\x04"  # what NumPy's files begin with

_CHILD = "import sys; sys.path[:] = sys.argv[2:]; from rdpi.data.foreign import serve; serve(int(sys.argv[1]))"


class Unreadable(Exception):
    """The file cannot be read; the message says why, on one line."""


def read_arrays(data: bytes) -> list[tuple[str, np.ndarray]]:
    """The real numeric arrays of a MATLAB file (version 4 to 7), .npy or .npz, with dotted names. Raises Unreadable."""
    limit_s, limit_bytes = START_S + S_PER_BYTE * len(data), START_BYTES + BYTES_PER_BYTE * len(data)
    # The child finds rdpi and NumPy where this process does, and nothing in the working folder.
    command = [sys.executable, "-P", "-c", _CHILD, str(limit_bytes), *sys.path]
    try:
        child = subprocess.run(command, input=data, capture_output=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        raise Unreadable(f"its reader did not end within {limit_s:.0f} s") from None
    if child.returncode < 0:
        number = -child.returncode
        name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
        raise Unreadable(f"its reader crashed, {name}")
    if child.returncode > 0:
        told = child.stderr.decode(errors="replace").split("\n")
        raise Unreadable(f"its reader failed, {_one_line(next(filter(str.strip, reversed(told)), 'without a word'))}")
    return _receive(io.BytesIO(child.stdout))


def serve(limit_bytes: int) -> None:
    """The child: read the file on standard input, write its arrays to standard output."""
    data = sys.stdin.buffer.read()
    try:
        if data.startswith(NUMPY):
            _limit_memory(limit_bytes)
            arrays = list(_leaves("", _numpy(data)))
        else:
            from scipy.io import loadmat

            _limit_memory(limit_bytes)
            loaded = loadmat(io.BytesIO(data), simplify_cells=True)
            arrays = list(_leaves("", {key: value for key, value in loaded.items() if not key.startswith("__")}))
    except Exception as error:  # loadmat raises nearly anything on a damaged file
        _send(sys.stdout.buffer, [], _one_line(str(error)) or type(error).__name__)
    else:
        _send(sys.stdout.buffer, arrays)


def _numpy(data: bytes) -> object:
    loaded = np.load(io.BytesIO(data), allow_pickle=False)
    if not isinstance(loaded, np.ndarray):
        return {name: loaded[name] for name in loaded.files}
    return {name: loaded[name] for name in loaded.dtype.names} if loaded.dtype.names else loaded


def _leaves(name: str, value: object) -> Iterator[tuple[str, np.ndarray]]:
    """Real numeric arrays in nested structs and cells, with dotted names."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(f"{name}.{key}" if name else key, item)
    elif isinstance(value, list) or isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 1:
        for index, item in enumerate(value):
            yield from _leaves(f"{name}.{index}" if name else str(index), item)
    elif np.asarray(value).dtype.kind in "fiub" and np.asarray(value).size:
        yield name, np.asarray(value)


def _limit_memory(further: int) -> None:
    """Refuse this process so many further bytes, where the system can tell what it has and limit it."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a crash leaves no file
        with open("/proc/self/statm") as statm:
            taken = int(statm.read().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_AS, (min([taken + further, *limits]), hard))


def _send(stream: BinaryIO, arrays: list[tuple[str, np.ndarray]], error: str = "") -> None:
    """A line of JSON with the names or what went wrong, then the arrays."""
    stream.write(json.dumps({"error": error, "names": [name for name, _ in arrays]}).encode() + b"\n")
    for _, array in arrays:
        packed = io.BytesIO()  # to a file NumPy writes by its position, which a pipe does not have
        np.lib.format.write_array(packed, np.ascontiguousarray(array).reshape(array.shape), allow_pickle=False)
        stream.write(packed.getbuffer())
    stream.flush()


def _receive(stream: BinaryIO) -> list[tuple[str, np.ndarray]]:
    try:
        told = json.loads(stream.readline())
        arrays = [(name, np.lib.format.read_array(stream, allow_pickle=False)) for name in told["names"]]
    except Exception as error:  # of a process whose memory is damaged
        raise Unreadable(f"its reader sent {_one_line(str(error))}") from None
    if stream.read(1):
        raise Unreadable("its reader sent more than its arrays")
    if told["error"]:
        raise Unreadable(told["error"])
    return arrays


def _one_line(text: str) -> str:
    return " ".join(text.split())[:200]
