"""The one exception that is meant for the user rather than for the programmer, and what its messages may hold."""

from __future__ import annotations


class BadInput(Exception):
    """Something the user gave cannot be used.

    The message is all the user sees: it names the file and the place (line, key or column), says what is wrong, and
    what to do about it. The command line prints it as `rdpi: message` and exits with status 2.
    """


def printable(name: str) -> str:
    """Text that can be printed and written as UTF-8, of a name of a file, which need not be text."""
    return name.encode("utf-8", "backslashreplace").decode()
