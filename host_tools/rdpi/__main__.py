"""The program `rdpi`. Little happens before `main`, for until then Ctrl-C shows a traceback."""

from __future__ import annotations

import os
import signal
import sys

THREADS = "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"


def main() -> None:
    one_thread()
    try:
        from .cli import main as command

        command(prog_name="rdpi")
    except KeyboardInterrupt:  # while modules were loaded
        sys.exit(stopped())
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is done, or told; the interpreter's own end takes a moment


def one_thread() -> None:
    """Linear algebra takes one thread, before NumPy is loaded, unless the user says how many: the matrices are small, and
    where other programs run threads wait for each other far longer than they work.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")


def stopped() -> int:
    """Tell that Ctrl-C ended the program; returns its exit status."""
    try:
        sys.stderr.write("rdpi: stopped\n")
    except (AttributeError, OSError):  # closed by who called
        pass
    return 128 + signal.SIGINT


if __name__ == "__main__":
    main()
