"""What a terminal shows while work goes on."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

DELAY_S = 2.0


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """Yield a function to call with the fraction done, 0 to 1, as often as convenient.

    A bar appears on a terminal when the work lasts over two seconds (before the first call it only says that work goes
    on); nothing is shown when stderr is piped.
    """
    if not sys.stderr.isatty():
        yield lambda fraction: None
        return
    fraction_done: float | None = None
    bar = task = None

    def show() -> None:
        nonlocal bar, task
        from rich.console import Console
        from rich.progress import Progress

        bar = Progress(console=Console(stderr=True), transient=True)
        task = bar.add_task(label, total=None if fraction_done is None else 1.0, completed=fraction_done or 0.0)
        bar.start()

    def report(fraction: float) -> None:
        nonlocal fraction_done
        fraction_done = fraction
        if task is not None:
            bar.update(task, total=1.0, completed=fraction)

    timer = threading.Timer(DELAY_S, show)
    timer.start()
    try:
        yield report
    finally:
        timer.cancel()
        timer.join()
        if bar is not None:
            bar.stop()
