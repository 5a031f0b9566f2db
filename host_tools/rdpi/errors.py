"""The one exception that is meant for the user rather than for the programmer."""

from __future__ import annotations


class BadInput(Exception):
    """Something the user gave cannot be used.

    The message is all the user sees: it names the file and the place (line, key or column), says what is wrong, and
    what to do about it. The command line prints it as `rdpi: message` and exits with status 2.
    """
