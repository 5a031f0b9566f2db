"""A board as `rdpi record` sees it."""

from __future__ import annotations

import contextlib
import os
import pty
import termios
import threading
import time
from collections.abc import Callable

A_MOMENT_S = 0.2


class Board:
    """The far end of a pseudo-terminal."""

    def __init__(self) -> None:
        self.line, self._port = pty.openpty()
        self.port = os.ttyname(self._port)
        self._as_it_was = termios.tcgetattr(self.line)

    def send(self, data: bytes) -> None:
        while data:
            data = data[os.write(self.line, data[:1000]):]

    def unplug(self) -> None:
        for end in (self.line, self._port):
            os.close(end)
        self.line = -1

    def renew(self) -> None:
        """As it was before a command opened it."""
        termios.tcsetattr(self.line, termios.TCSANOW, self._as_it_was)

    def wait(self) -> None:
        """Until a command has opened the port, which makes the terminal raw and then empties it."""
        while termios.tcgetattr(self.line)[3] & termios.ICANON:
            time.sleep(0.01)
        time.sleep(A_MOMENT_S)

    def later(self, *acts: Callable[[], None]) -> None:
        """Do this once the command that follows is at work."""
        self.renew()

        def work() -> None:
            self.wait()
            with contextlib.suppress(OSError):  # unplugged in the middle of it
                for act in acts:
                    act()

        threading.Thread(target=work, daemon=True).start()
