"""The command `rdpi`. Every command parses its options here, calls one module, prints, and returns what `--json` writes.

Modules are imported inside the commands: `rdpi --help` must not wait for NumPy.
"""

from __future__ import annotations

import functools
import json
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import click

from . import version
from .errors import BadInput

PROGRESS_DELAY_S = 2.0


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(version(), prog_name="rdpi")
def main() -> None:
    """Rate-dependent hysteresis of piezoelectric actuators: record, identify, simulate, compensate.

    Exit status: 0 done, 1 done but a quality gate you set failed, 2 bad input.
    """


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
                result = function(**options)
                if json_path is not None:
                    from .recording import atomic_write

                    text = json.dumps(result, indent=2, allow_nan=False, default=lambda value: value.tolist())
                    atomic_write(json_path, text + "\n")
            except BadInput as error:
                _fail(str(error))
            except BrokenPipeError:
                raise  # `rdpi … | head`: click ends quietly
            except OSError as error:
                _fail(f"{error.filename}: {error.strerror}; check the path and permissions" if error.filename else str(error))

        run.params.append(click.Option(["--json", "json_path"], type=click.Path(dir_okay=False), metavar="FILE",
                                       help="Also write the result as JSON."))
        return run

    return decorate


def _fail(message: str) -> NoReturn:
    click.echo(f"rdpi: {message}", err=True)
    raise click.exceptions.Exit(2)


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """Yield a function to call with the fraction done, 0 to 1, as often as convenient.

    A bar appears on a terminal when the work lasts over two seconds (before the first call it only says that work goes on);
    nothing is shown when stderr is piped.
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

    timer = threading.Timer(PROGRESS_DELAY_S, show)
    timer.start()
    try:
        yield report
    finally:
        timer.cancel()
        timer.join()
        if bar is not None:
            bar.stop()


class Numbers(click.ParamType):
    """Comma-separated numbers."""

    name = "numbers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        try:
            return value if isinstance(value, tuple) else tuple(float(part) for part in value.split(","))
        except ValueError:
            self.fail(f"{value!r}: give numbers separated by commas", param, ctx)


class Rows(click.ParamType):
    """START:STOP, as Python slices count."""

    name = "rows"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> slice:
        if isinstance(value, slice):
            return value
        try:
            start, stop = (int(part) if part.strip() else None for part in value.split(":"))
        except ValueError:
            self.fail(f"{value!r}: give START:STOP, e.g. 400:4400, 400: or :-100", param, ctx)
        return slice(start, stop)


def _pairs(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    pairs = {}
    for value in values:
        name, equals, rest = (part.strip() for part in value.partition("="))
        if not (name and equals and rest) or set(name) & set(',"#'):
            raise click.BadParameter(f"{value!r}: give NAME=COLUMN, e.g. other_axis_V=3", ctx, param)
        pairs[name] = rest
    return pairs


_COLUMN = "COLUMN[:UNIT]"


@command("import")
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE...", type=click.Path())
@click.option("-o", "--output", required=True, metavar="RUN.csv", type=click.Path(),
              help="The recording; for several sources a folder, which gets one NAME.csv per source.")
@click.option("--time", metavar=_COLUMN, help="Time. Units: s (default), ms, us.")
@click.option("--rate", "rate_hz", metavar="HZ", type=click.FloatRange(min=0, min_open=True),
              help="Samples per second. Without --time the times are made from it, from 0 at the first row taken.")
@click.option("--command", metavar=_COLUMN, help="Drive voltage. Units: V (default), mV, kV.")
@click.option("--displacement", metavar=_COLUMN, help="Measured displacement. Units: um (default), m, mm, nm, pm.")
@click.option("--reference", metavar=_COLUMN, help="Displacement that was asked for. Units as --displacement.")
@click.option("--monitor", metavar=_COLUMN, help="Amplifier output as measured. Units as --command.")
@click.option("--temperature", metavar="COLUMN", help="Temperature in degC.")
@click.option("--also", metavar="NAME=COLUMN[:UNIT]", multiple=True, callback=_pairs,
              help="Keep a further column under this name, e.g. other_axis_V=3:mV. May be repeated.")
@click.option("--rows", metavar="START:STOP", type=Rows(), default=":",
              help="Take these data rows, counted from 0, STOP not included; negative numbers count from the end.")
@click.option("--command-gain", metavar="GAIN", type=float, default=1.0,
              help="V/V. The voltage was recorded before an amplifier of this fixed gain: multiply the command by it.")
@click.option("--as", "purpose", type=click.Choice(["run", "drive", "reference"]), default="run", show_default=True,
              help="What the file must give: command and displacement, only a command, or only a reference.")
@click.option("--actuator", metavar="TEXT", help="Kept in the recording.")
@click.option("--memory", type=click.Choice(["reset", "carried", "unknown"]),
              help="What the hysteresis remembers at the first row taken: a decaying sweep ended here, the row follows "
                   "the previous recording, or unknown.")
@click.option("--note", metavar="TEXT", help="Kept in the recording.")
def import_(sources: tuple[str, ...], output: str, rate_hz: float | None, rows: slice, command_gain: float, purpose: str,
            also: dict[str, str], actuator: str | None, memory: str | None, note: str | None,
            **columns: str | None) -> dict[str, Any]:
    """Bring other formats to a recording.

    SOURCE is a table (comma, semicolon, tab or white space; with or without names; text above the table is skipped), a
    MATLAB .mat (up to v7), or a NumPy .npy or .npz. A COLUMN is a name or a number from 0. UNIT may also be a factor:
    `--displacement 4:0.5` multiplies by 0.5 to get um. Units in names (pos_nm, "disp [um]") are understood, and obvious
    names are recognised without options; what was taken for what is printed. In a matrix the longer side is time.

    \b
    rdpi import Model_Vi_Do.dat --command 0 --displacement 4 --rate 200 --rows 400:4400 -o fit.csv
    rdpi import scope.csv --time t:ms --command Vin:mV --displacement pos_nm -o run.csv
    rdpi import monday/*.mat -o runs/
    """
    from .importer import ROLES, Request, import_recording
    from .recording import write_recording

    reserved = {role.column: key for key, role in ROLES.items()}
    for name in set(also) & set(reserved):
        raise BadInput(f"--also {name}: this column has its own option, --{reserved[name]}")
    texts = {"actuator": actuator, "memory": memory, "note": note}
    request = Request({key: spec for key, spec in columns.items() if spec is not None}, also, rate_hz, rows, command_gain,
                      purpose, {key: text for key, text in texts.items() if text is not None})
    targets = _targets(sources, output)
    results = []
    with progress("importing") as report:
        imported = []
        for index, source in enumerate(sources):
            imported.append(import_recording(source, request))
            report((index + 0.5) / len(sources))
        # Only now, so that a bad source leaves nothing behind.
        for target, (recording, lines) in zip(targets, imported):
            target.parent.mkdir(parents=True, exist_ok=True)
            write_recording(target, recording.columns, recording.metadata)
            click.echo("\n".join([*lines, f"  written to {target}"]))
            results.append({"file": str(target), "source": recording.path, "samples": len(recording),
                            "sample_rate_hz": recording.sample_rate_hz, "columns": list(recording.columns),
                            "metadata": recording.metadata})
    return {"recordings": results}


def _targets(sources: tuple[str, ...], output: str) -> list[Path]:
    folder = Path(output)
    if len(sources) == 1 and not folder.is_dir() and not output.endswith("/"):
        return [folder]
    if len(sources) > 1 and not folder.is_dir() and (folder.exists() or folder.suffix):
        raise BadInput(f"-o {output}: several sources need a folder; give one, e.g. -o runs/")
    targets = [folder / f"{Path(source).stem}.csv" for source in sources]
    for index, target in enumerate(targets):
        if target in targets[:index]:
            first = sources[targets.index(target)]
            raise BadInput(f"{sources[index]} and {first} would both be written to {target}; import them one by one")
    return targets


@command("excite")
@click.argument("kind", type=click.Choice(["sawtooth", "minor-loops", "steps", "multisine", "sine", "chirp", "startup"]))
@click.option("-o", "--output", required=True, metavar="DRIVE.csv", type=click.Path(dir_okay=False), help="The drive.")
@click.option("--min-V", "min_V", type=float, default=0.0, show_default=True, help="Lowest voltage, V.")
@click.option("--max-V", "max_V", type=float, default=10.0, show_default=True, help="Highest voltage, V.")
@click.option("--rest-V", "rest_V", type=float, help="Voltage at which the drive starts and ends, V. Default: --min-V.")
@click.option("--sample-rate", "sample_rate_hz", type=float, default=10_000.0, show_default=True, metavar="HZ",
              help="Samples per second.")
@click.option("--slew", "slew_V_per_s", type=float, metavar="V/S", help="The drive never changes faster than this, V/s.")
@click.option("--no-sweep", is_flag=True, help="Leave out the decaying sweep at the start.")
@click.option("--frequencies", "frequencies_hz", type=Numbers(), metavar="HZ,HZ,...",
              help="sawtooth, sine: one wave each, default 1,2,5,10,20 Hz. multisine: its lines, default 16 of 0.5 to "
                   "50 Hz. chirp: first and last, default 1,500 Hz. startup: one, default 20 Hz. "
                   "Defaults are lowered where --slew or --sample-rate demands it.")
@click.option("--rates", "rates_V_per_s", type=Numbers(), metavar="V/S,V/S,...",
              help="sawtooth: rates instead of frequencies, V/s. minor-loops: the pattern at each rate, V/s; default: "
                   "the whole range in 0.5 s.")
@click.option("--cycles", type=int, help="Periods per wave: sawtooth 3, sine 5, startup 20 by default.")
@click.option("--levels", type=int, help="minor-loops: amplitudes, default 6. steps: steps up and down, default 4.")
@click.option("--hold", "hold_s", type=float, metavar="S", help="steps: time on each step, default 5 s.")
@click.option("--duration", "duration_s", type=float, metavar="S", help="multisine, chirp: length, default 10 s (multisine: longer if --slew demands it).")
@click.option("--seed", type=click.IntRange(min=0), help="multisine: picks the random phases, default 0.")
@click.option("--end-V", "end_V", type=float, help="startup: where the sweep ends, V. Default: --rest-V.")
def excite(kind: str, output: str, min_V: float, max_V: float, rest_V: float | None, sample_rate_hz: float,
           slew_V_per_s: float | None, no_sweep: bool, **options: Any) -> dict[str, Any]:
    """Generate a drive that makes the actuator show what a model needs to know.

    \b
    sawtooth     triangular waves at several rates: how slopes depend on rate
    minor-loops  shrinking reversals and loops on both branches: every amplitude
    steps        staircase with holds: creep
    multisine    many frequencies at once, large then small: check a model
    sine         one frequency after another: loops, delay, lag
    chirp        one running frequency: resonance (use a small range)
    startup      decaying oscillation: brings the hysteresis to a known state

    The drive starts and ends at --rest-V and first (but for --no-sweep) brings the hysteresis to a known state by a
    decaying sweep of about one second; `sweep_s` in the file says how long it takes. The same options give the same file.
    """
    from .excite import Limits, make_drive
    from .recording import write_recording

    limits = Limits(min_V, max_V, rest_V, sample_rate_hz, slew_V_per_s)
    given = {name: value for name, value in options.items() if value is not None}
    with progress("generating"):
        columns, metadata = make_drive(kind, limits, not no_sweep, **given)
        write_recording(output, columns, metadata)
    voltage = columns["command_V"]
    duration_s = (len(voltage) - 1) / sample_rate_hz
    click.echo(f"{output}: {kind}, {len(voltage)} samples at {sample_rate_hz:g} per second, {duration_s:.6g} s, "
               f"{voltage.min():g} to {voltage.max():g} V, starts at {voltage[0]:g} V and ends at {voltage[-1]:g} V")
    return {"file": output, "kind": kind, "samples": len(voltage), "duration_s": duration_s,
            "min_V": voltage.min(), "max_V": voltage.max(), "metadata": metadata}
