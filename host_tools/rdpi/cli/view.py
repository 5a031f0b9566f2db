"""What is seen of a recording while it goes on: in the terminal, and in a window."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ..board import Decoder, Live

TITLES = {"reference_um": "reference", "displacement_um": "reading", "error_um": "error", "command_V": "drive"}
BLOCKS, ASCII = "▁▂▃▄▅▆▇█", "_.:-=+*#"
WIDEST, BESIDE = 60, 40  # columns of a curve; of what stands beside it


@contextmanager
def recording_view(um_per_count: float | None, count_0_um: float | None, window: bool
                   ) -> Iterator[Callable[[Decoder], None]]:
    """Yields what is to be called while the recording goes on. The latest seconds are shown on a terminal, not when
    stderr is piped, and with `window` in a window. Raises BadInput if none can be opened.
    """
    from ..board import latest_seconds

    with ExitStack() as stack:
        opened = None
        if window:
            from .window import Window

            opened = Window("rdpi record")
            stack.callback(opened.close)
        update = stack.enter_context(_terminal()) if sys.stderr.isatty() else None

        def report(decoder: Decoder) -> None:
            now = latest_seconds(decoder, um_per_count, count_0_um) if opened or update else None
            if update:
                update(now, decoder)
            if opened and now:
                opened.show(now)

        yield report


@contextmanager
def _terminal() -> Iterator[Callable[[Live | None, Decoder], None]]:
    from rich.console import Console
    from rich.live import Live as Screen
    from rich.text import Text

    from ..board import how_it_goes

    console = Console(stderr=True)
    screen = Screen("waiting for the first frame; Ctrl-C stops", console=console, transient=True, auto_refresh=False)

    def update(now: Live | None, decoder: Decoder) -> None:
        with suppress(OSError):  # the terminal is gone, the recording is not
            lines = curves(now, console.width, console.encoding) if now else []
            screen.update(Text("\n".join([*lines, how_it_goes(decoder)])), refresh=True)

    try:
        with suppress(OSError):
            screen.start(refresh=True)
        yield update
    finally:
        with suppress(OSError):
            screen.stop()


def curves(now: Live, width: int, encoding: str) -> list[str]:
    """A line of text for each column: what it is, its curve, its range, and the latest value."""
    blocks = BLOCKS if encoding.lower().startswith("utf") else ASCII
    points = np.linspace(0, len(now.time_s) - 1, max(8, min(WIDEST, width - BESIDE))).round().astype(int)
    lines = []
    for name, title in TITLES.items():
        values = now.columns.get(name, np.array([np.nan]))
        if not np.isfinite(values).any():
            continue
        low, high = np.nanmin(values), np.nanmax(values)
        steps = (values[points] - low) / max(high - low, 1e-300) * (len(blocks) - 1)
        curve = "".join(" " if np.isnan(step) else blocks[round(step)] for step in steps)
        unit = name.rpartition("_")[2]
        lines.append(f"{title:9} {curve} {low:.4g} to {high:.4g} {unit}"
                     + ("" if np.isnan(values[-1]) else f", now {values[-1]:.4g}"))
    return lines
