"""What the Python functions are given: converted where it is what they take, else refused by name."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from numbers import Real
from typing import Any

import numpy as np

from ..errors import BadInput


def series(values: Any, name: str, finite: bool = True) -> np.ndarray:
    """A one-dimensional float64 array of an array or list of numbers; the same array if it is one already.

    Raises BadInput that names the argument for anything else, for masked values, and if `finite` for NaN and infinity.
    """
    if type(values) is np.ndarray and values.ndim == 1 and values.dtype == float and not finite:
        return values  # what the library's own functions pass, thousands of times
    try:
        array = np.asarray(values)
    except Exception:  # noqa: BLE001 - rows of unequal length; and whatever an array of another library raises
        array = np.empty(0, object)
    if array.ndim != 1 or array.dtype.kind not in "iuf":
        raise BadInput(f"{name}: must be a one-dimensional array or list of numbers")
    if np.ma.is_masked(values):  # what stands below a mask is no number
        raise BadInput(f"{name}[{int(np.argmax(np.ma.getmaskarray(values)))}] is masked; every value must be a number")
    with np.errstate(over="ignore"):  # what a double does not hold becomes infinite
        array = array.astype(float, copy=False)
    if finite and not np.all(np.isfinite(array)):
        at = int(np.argmin(np.isfinite(array)))
        raise BadInput(f"{name}[{at}] is {array[at]}; every value must be finite")
    return array


def is_number(value: Any) -> bool:
    """Whether it is a number that a float holds, NaN and infinity included."""
    if type(value) is float:
        return True
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    try:
        with np.errstate(over="ignore"):
            held = float(value)
    except OverflowError:
        return False
    return abs(held) != np.inf or held == value  # NumPy makes infinity of a longer number


def number(value: Any, name: str, finite: bool = True) -> float:
    """A number as a float. Raises BadInput that names the argument for anything else, as `series` does."""
    if not is_number(value) or finite and not np.isfinite(float(value)):
        raise BadInput(f"{name} is {shown(value)}; must be a {'finite ' if finite else ''}number")
    return float(value)


def one_of(value: Any, allowed: Iterable[str], name: str) -> str:
    """One of these words. Raises BadInput that names the argument for anything else."""
    if not isinstance(value, str) or value not in allowed:
        raise BadInput(f"{name} is {shown(value)}; must be one of {', '.join(allowed)}")
    return value


def of_kind(value: Any, kind: type, name: str) -> Any:
    """A value of this class. Raises BadInput that names the argument for anything else."""
    if not isinstance(value, kind):
        raise BadInput(f"{name}: must be a {kind.__name__}, got {shown(value)}")
    return value


def listed(values: Any, kind: type, name: str) -> list:
    """A list of values of this class. Raises BadInput that names the argument for anything else."""
    found = None
    if isinstance(values, Iterable) and not isinstance(values, (str, dict)):
        with suppress(TypeError):  # an array of no dimension
            found = list(values)
    if found is None:
        raise BadInput(f"{name}: must be a list of {kind.__name__}s, got {shown(values)}")
    return [of_kind(value, kind, f"{name}[{k}]") for k, value in enumerate(found)]


def path(value: Any, name: str = "path") -> str:
    """The name of a file. Raises BadInput that names the argument for anything else."""
    text = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if not isinstance(text, str) or not text or "\0" in text or not _encodes(text):
        raise BadInput(f"{name}: must be the name of a file, got {shown(value)}")
    return text


def _encodes(text: str) -> bool:
    """Whether the system can be asked for a file of this name: half a letter of UTF-16, as JSON may hold, is none."""
    try:
        os.fsencode(text)
    except UnicodeEncodeError:
        return False
    return True


def shown(value: Any) -> str:
    """Short enough for a message."""
    text = repr(value) if isinstance(value, (str, float, bool, type(None))) else f"a {type(value).__name__}"
    return text if len(text) <= 40 else text[:39] + "…"
