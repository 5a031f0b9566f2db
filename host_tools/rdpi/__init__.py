"""Rate-dependent hysteresis models of piezoelectric actuators and their exact inverses: the host tools.

`rdpi.api` documents the Python interface. Its names are here too, and are loaded when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .errors import BadInput as BadInput

if TYPE_CHECKING:
    from .api import (Diagnosis as Diagnosis, Model as Model, Recording as Recording, diagnose as diagnose, fit as fit,
                      read_recording as read_recording)

_LATER = "Diagnosis", "Model", "Recording", "diagnose", "fit", "read_recording"
__all__ = ["BadInput", "version", *_LATER]


def version() -> str:
    """Version of the installed distribution; "unknown" when the package runs from a checkout, not installed."""
    from importlib.metadata import PackageNotFoundError, version as installed

    try:
        return installed("rdpi")
    except PackageNotFoundError:
        return "unknown"


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'rdpi' has no attribute {name!r}")
    from . import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({name for name in globals() if name.startswith("__")} | {*__all__})
