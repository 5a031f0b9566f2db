"""The program `rdpi`. Little happens before `main`, for until then Ctrl-C shows a traceback."""

from __future__ import annotations

import signal
import sys


def main() -> None:
    try:
        from .cli import main as command

        command(prog_name="rdpi")
    except KeyboardInterrupt:  # while modules were loaded
        sys.exit(stopped())
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is done, or told; the interpreter's own end takes a moment


def stopped() -> int:
    """Tell that Ctrl-C ended the program; returns its exit status."""
    try:
        sys.stderr.write("rdpi: stopped\n")
    except (AttributeError, OSError):  # closed by who called
        pass
    return 128 + signal.SIGINT


if __name__ == "__main__":
    main()
