"""The command `rdpi`. Every command parses its options, calls a function of another room, prints, and returns what
`--json` writes.

Other rooms are imported inside the commands: `rdpi --help` must not wait for NumPy.
"""

from __future__ import annotations

import functools
import json
import os
import signal
import sys
from collections.abc import Callable
from contextlib import nullcontext, redirect_stdout, suppress
from typing import Any, NoReturn

import click

from .. import version
from ..__main__ import stopped
from ..errors import BadInput


class Program(click.Group):
    """Ends by Ctrl-C with one line and status 130; click's own is 1, which means a missed gate."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise click.exceptions.Exit(stopped()) from None


@click.group(cls=Program, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(version(), prog_name="rdpi")
def main() -> None:
    """Rate-dependent hysteresis of piezoelectric actuators: record, identify, simulate, compensate.

    Exit status: 0 done, 1 done but a quality gate you set failed, 2 bad input, 130 stopped by Ctrl-C.
    """
    for name in ("SIGTERM", "SIGHUP"):  # leave by the ordinary way, so that nothing half written stays behind
        if hasattr(signal, name) and signal.getsignal(getattr(signal, name)) == signal.SIG_DFL:
            signal.signal(getattr(signal, name), lambda number, frame: sys.exit(128 + number))
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who called; click 8.1 writes to it
            setattr(sys, name, open(os.devnull, "w"))
        if hasattr(getattr(sys, name), "reconfigure"):  # names of files need not be text: no traceback for printing one
            getattr(sys, name).reconfigure(errors="backslashreplace")


def command(name: str) -> Callable[[Callable[..., dict[str, Any]]], click.Command]:
    """Make a function a command of `main`.

    The function returns a dict for `--json` (finite numbers, text, lists, None). BadInput and files that cannot be
    read or written end as one line on stderr and exit status 2.
    """

    def decorate(function: Callable[..., dict[str, Any]]) -> click.Command:
        @main.command(name)
        @functools.wraps(function)
        def run(json_path: str | None, **options: Any) -> None:
            try:
                _check_paths(click.get_current_context())
                with redirect_stdout(sys.stderr) if json_path == "-" else nullcontext():
                    result = function(**options)
                if json_path is not None:
                    from ..data import atomic_write

                    text = json.dumps(result, indent=2, allow_nan=False, default=lambda value: value.tolist()) + "\n"
                    _print_json(text) if json_path == "-" else atomic_write(json_path, text)
                if result.get("gate_failed"):
                    raise click.exceptions.Exit(1)
            except BadInput as error:
                _fail(str(error))
            except MemoryError:
                context = click.get_current_context()
                given = [context.params[one.name] for one in context.command.params if isinstance(one, click.Argument)]
                names = ", ".join(name for value in given for name in ([value] if isinstance(value, str) else value))
                _fail(f"{names}: there is not enough memory for this; give shorter files")
            except BrokenPipeError:
                raise  # `rdpi … | head`: click ends quietly
            except OSError as error:
                where = f"{error.filename}: " if error.filename else ""
                _fail(f"{where}{error.strerror or error}; check the path and permissions")

        run.params.append(click.Option(["--json", "json_path"], type=click.Path(dir_okay=False), metavar="FILE",
                                       help="Also write the result as JSON. -: to standard output, and the rest "
                                            "to standard error."))
        return run

    return decorate


def _print_json(text: str) -> None:
    try:
        click.echo(text, nl=False)
    except BrokenPipeError:
        raise
    except OSError as error:
        with suppress(OSError, ValueError):  # the rest goes nowhere: at the program's end it would fail again
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        error.filename = "standard output"
        raise


def _check_paths(context: click.Context) -> None:
    """Refuse, before any work, outputs that cannot be written or that are inputs or each other."""
    paths: dict[str, list[str]] = {"in": [], "out": []}
    for parameter in context.command.params:
        if isinstance(parameter.type, click.Path) and (value := context.params.get(parameter.name)):
            kind = "out" if parameter.name in ("output", "json_path", "report", "raw") else "in"
            if value == "-" and parameter.name == "json_path":
                if getattr(sys.stdout, "name", None) == os.devnull:
                    raise BadInput("--json -: standard output is closed; name a file")
                continue
            if value == "-" and kind == "out":
                raise BadInput(f"{parameter.opts[0]} -: standard output is only for --json; name a file")
            names = [value] if isinstance(value, str) else list(value)
            if parameter.name == "report":
                files = ("gap.json", "index.html") if context.command.name == "gap" else ("fit.json",)
                names = [os.path.join(value, file) for file in files]
            paths[kind] += names
            if parameter.name == "report" and os.path.exists(value) and not os.path.isdir(value):
                raise BadInput(f"{value}: is no folder; name another for --report")
    for k, name in enumerate(paths["out"]):
        folder = os.path.dirname(name) or "."
        report = context.params.get("report")
        makes_folder = bool(report) and os.path.normpath(folder) == os.path.normpath(report) or \
            context.command.name == "import" and name.endswith("/")
        if not os.path.isdir(folder) and not makes_folder:
            raise BadInput(f"{name}: there is no folder {folder}; make it first")
        if "port" in context.params and os.path.realpath(name) == os.path.realpath(context.params["port"]):
            raise BadInput(f"{name}: is the port; give a file to write to")
        into = name if os.path.isdir(name) else os.path.dirname(os.path.realpath(name))
        if os.path.isdir(into) and (into == name or not is_device(name)) and not os.access(into, os.W_OK):
            raise BadInput(f"{name}: the folder {into} cannot be written to; check its permissions")
        for other in (*paths["in"], *paths["out"][:k]):
            if os.path.realpath(name) == os.path.realpath(other) and os.path.basename(name) and not is_device(name):
                kind = "an input" if other in paths["in"] else "another output"
                raise BadInput(f"{name}: would be written over {kind}; choose another name")


def is_device(path: str) -> bool:
    return os.path.exists(path) and not os.path.isfile(path)


def printable(name: str) -> str:
    """Names of files need not be text; what is printed and written must."""
    return name.encode("utf-8", "backslashreplace").decode()


def _fail(message: str) -> NoReturn:
    message = printable(message)
    with suppress(OSError):  # the terminal may be gone
        click.echo(f"rdpi: {message}", err=True)
    raise click.exceptions.Exit(2)
