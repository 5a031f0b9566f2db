"""The command `rdpi`. Every command parses its options, calls a function of another room, prints, and returns what
`--json` writes.

Other rooms are imported inside the commands: `rdpi --help` must not wait for NumPy.
"""

from __future__ import annotations

import functools
import json
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout, suppress
from typing import Any, NoReturn, TextIO

import click

from .. import version
from ..__main__ import stopped
from ..errors import BadInput, printable
from .types import Folder, ModelFile, Output, Report


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

    \b
    Exit status:
      0    success
      1    success, but a limit that you set was exceeded (--max-rms, --max-gap, --fail-on, --max-lost)
      2    bad input, also of one actuator of a batch
      130  stopped by Ctrl-C
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
                with redirect_stdout(sys.stderr if json_path == "-" else _WhileRead(sys.stdout)):
                    result = function(**options)
                    for page in _pages(click.get_current_context()):
                        click.echo(f"{page}: the report, a page for a browser")
                if json_path is not None:
                    from ..data import atomic_write

                    text = json.dumps(result, indent=2, allow_nan=False, default=lambda value: value.tolist()) + "\n"
                    _print_json(text) if json_path == "-" else atomic_write(json_path, text)
                if result.get("failed") or result.get("gate_failed"):
                    raise click.exceptions.Exit(2 if result.get("failed") else 1)
            except BadInput as error:
                _fail(str(error))
            except MemoryError:
                context = click.get_current_context()
                given = [context.params[one.name] for one in context.command.params if isinstance(one, click.Argument)]
                names = ", ".join(name for value in given for name in ([value] if isinstance(value, str) else value))
                _fail(f"{names}: there is not enough memory; give shorter files")
            except BrokenPipeError:
                raise  # of JSON or of stderr: click ends quietly
            except OSError as error:
                where = f"{error.filename}: " if error.filename else ""
                _fail(f"{where}{error.strerror or error}; check the path and permissions")

        run.params.append(click.Option(["--json", "json_path"], type=Output(json=True), metavar="FILE",
                                       help="Also write the result as JSON. With -, JSON goes to standard output "
                                            "and all other text to standard error."))
        return run

    return decorate


def _pages(context: click.Context) -> list[str]:
    """Those that `--report` has written."""
    return [os.path.join(context.params[one.name], file) for one in context.command.params
            if isinstance(one.type, Report) and context.params[one.name] is not None
            for file in one.type.files if file.endswith(".html")]


def _print_json(text: str) -> None:
    try:
        click.echo(text, nl=False)
    except BrokenPipeError:
        raise
    except OSError as error:
        _goes_nowhere(sys.stdout)
        error.filename = "standard output"
        raise


class _WhileRead:
    """A stream until its reader goes away (`rdpi … | head`): then the rest goes nowhere, and the work goes on."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            _goes_nowhere(self._stream)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            _goes_nowhere(self._stream)


def _goes_nowhere(stream: TextIO) -> None:
    """What is printed from now on; also what waits in a buffer, which would fail again at the program's end."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _check_paths(context: click.Context) -> None:
    """Refuse, before any work, outputs that cannot be written or that are inputs, kept with a model, or each other, and
    JSON in the place of a table.
    """
    inputs: list[str] = []
    models: list[str] = []
    outputs: list[str] = []
    documents: list[str] = []
    folders: list[str] = []
    kept: list[tuple[str, str]] = []
    made = None
    for parameter in context.command.params:
        kind, value = parameter.type, context.params.get(parameter.name)
        if not isinstance(kind, click.Path) or value is None or value == ():
            continue
        values = [value] if isinstance(value, str) else value
        if "" in values:
            raise BadInput(f"{parameter.opts[0]}: the name is empty; give a name")
        if isinstance(kind, Report):
            made = value
            outputs += [os.path.join(value, file) for file in kind.files]
        elif isinstance(kind, Folder):
            kept.append((value, parameter.opts[0]))
        elif not isinstance(kind, Output):
            inputs += values
            models += values if isinstance(kind, ModelFile) else []
        elif "-" not in values:
            outputs += values
            documents += values if kind.json else []
            folders += values if kind.dir_okay else []
        elif parameter.name != "json_path":
            raise BadInput(f"{parameter.opts[0]} -: standard output is only for --json; give a file name")
        elif getattr(sys.stdout, "name", None) == os.devnull:
            raise BadInput("--json -: standard output is closed; give a file name")
    if outputs:
        from ..data import check_no_table, check_outputs
        from ..model import kept_with

        check_outputs(outputs, inputs, made, folders, [file for model in models for file in kept_with(model)])
        for name in documents:
            check_no_table(name)
    for folder, option in kept:
        from ..data import check_made

        check_made(folder, outputs, option, ".csv")


def by_options(message: str, parameters: Sequence[click.Parameter]) -> str:
    """A message in which arguments of Python functions, in backticks, are called by the options that set them."""
    options = {one.name: one.opts[-1] for one in parameters if isinstance(one, click.Option)}
    return re.sub(r"`(\w+)`", lambda found: options.get(found[1], found[0]), message)


def other_outputs() -> list[str]:
    """Files that the running command writes beside its -o."""
    given = click.get_current_context().params
    return [given[name] for name in ("json_path", "raw") if given.get(name)]


def _fail(message: str) -> NoReturn:
    message = printable(by_options(message, click.get_current_context().command.params))
    with suppress(OSError):  # the terminal may be gone
        click.echo(f"rdpi: {message}", err=True)
    raise click.exceptions.Exit(2)
