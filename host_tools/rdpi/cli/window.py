"""A window that shows a recording while it goes on: a process of its own, for drawing must not keep the port waiting."""

from __future__ import annotations

import signal
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from ..errors import BadInput
from .view import TITLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..board import Live

PANELS = (("reference_um", "displacement_um"), ("error_um",), ("command_V",))
UNITS = "position [µm]", "error [µm]", "drive [V]"
PAUSE_S = 0.02


class Window:
    """Opens the window; raises BadInput if none can be. Closed by hand, it is gone, and the recording goes on."""

    def __init__(self, title: str) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_show, args=(theirs, title), daemon=True)
        self._process.start()
        theirs.close()
        try:
            why = self._pipe.recv()
        except EOFError:
            why = "its process ended"
        if why:
            raise BadInput(f"--window: no window can be opened here: {why}")

    def show(self, now: Live) -> None:
        """Show this unless the window is still busy with what came before."""
        with suppress(OSError, EOFError):  # closed by hand
            if self._pipe.poll():
                self._pipe.recv()
                self._pipe.send(now)

    def close(self) -> None:
        self._pipe.close()
        self._process.join(timeout=2)
        self._process.terminate()


def _show(pipe: Connection, title: str) -> None:
    """In a process of its own: draw what comes through the pipe, and ask for the next, until either side is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the recording's
    try:
        from matplotlib import pyplot

        figure = pyplot.figure(title, layout="constrained")
        if figure.canvas.required_interactive_framework is None:
            raise ImportError("there is no display, or no library for windows (Debian: python3-tk)")
        figure.show()
    except Exception as error:  # each library for windows has its own
        pipe.send(str(error) or type(error).__name__)
        return
    open_ = [True]
    figure.canvas.mpl_connect("close_event", lambda event: open_.clear())
    pipe.send("")
    pipe.send("next")
    with suppress(OSError, EOFError):
        while open_:
            if pipe.poll():
                draw(figure, pipe.recv())
                pipe.send("next")
            figure.canvas.start_event_loop(PAUSE_S)


def draw(figure: Figure, now: Live) -> None:
    """Reference and reading, error, drive over the latest seconds, as far as there are such columns."""
    figure.clear()
    shown = [(names, unit) for names, unit in zip(PANELS, UNITS) if any(name in now.columns for name in names)]
    panels: Any = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (names, unit) in zip(panels, shown):
        for name in names:
            if name in now.columns:
                axes.plot(now.time_s, now.columns[name], label=TITLES[name], lw=1)
        axes.set_ylabel(unit)
        if len(axes.lines) > 1:
            axes.legend(loc="upper left")
    panels[0].set_title(f"{now.samples} samples, {now.missing} lost")
    panels[-1].set_xlabel("time before now [s]")
    figure.canvas.draw_idle()
