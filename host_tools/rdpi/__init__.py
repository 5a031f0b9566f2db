"""Rate-dependent hysteresis models of piezoelectric actuators and their exact inverses: the host tools."""

from __future__ import annotations

from .errors import BadInput as BadInput


def version() -> str:
    """Version of the installed distribution; "unknown" when the package runs from a checkout, not installed."""
    from importlib.metadata import PackageNotFoundError, version as installed

    try:
        return installed("rdpi")
    except PackageNotFoundError:
        return "unknown"
