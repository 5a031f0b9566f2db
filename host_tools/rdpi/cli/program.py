"""The command `rdpi`. Every command parses its options here, calls a module, prints, and returns what `--json` writes.

Modules are imported inside the commands: `rdpi --help` must not wait for NumPy.
"""

from __future__ import annotations

import functools
import json
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NoReturn

import click

from .. import version
from ..__main__ import stopped
from ..errors import BadInput

PROGRESS_DELAY_S = 2.0
LARGEST = 1e9


class Percent(click.ParamType):
    """A positive finite number."""

    name = "percent"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = click.FLOAT.convert(value, param, ctx)
        if not 0 < number < float("inf"):
            self.fail(f"{value!r}: must be positive and finite", param, ctx)
        return number


class Number(click.ParamType):
    """A finite number, as large as a voltage, a scale or a time may be."""

    name = "number"

    def __init__(self, positive: bool = False) -> None:
        self.positive = positive

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = click.FLOAT.convert(value, param, ctx)
        if not -LARGEST < number < LARGEST:  # nan neither
            self.fail(f"{value!r}: must be a number within ±{LARGEST:g}", param, ctx)
        if self.positive and number <= 0:
            self.fail(f"{value!r}: must be positive", param, ctx)
        return number


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
        if os.path.isdir(into) and (into == name or not _is_device(name)) and not os.access(into, os.W_OK):
            raise BadInput(f"{name}: the folder {into} cannot be written to; check its permissions")
        for other in (*paths["in"], *paths["out"][:k]):
            if os.path.realpath(name) == os.path.realpath(other) and os.path.basename(name) and not _is_device(name):
                kind = "an input" if other in paths["in"] else "another output"
                raise BadInput(f"{name}: would be written over {kind}; choose another name")


def _is_device(path: str) -> bool:
    return os.path.exists(path) and not os.path.isfile(path)


def _printable(name: str) -> str:
    """Names of files need not be text; what is printed and written must."""
    return name.encode("utf-8", "backslashreplace").decode()


def _fail(message: str) -> NoReturn:
    message = _printable(message)
    with suppress(OSError):  # the terminal may be gone
        click.echo(f"rdpi: {message}", err=True)
    raise click.exceptions.Exit(2)


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


def _telemetry_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """What record and import --telemetry have in common."""
    for option in reversed((
        click.option("--um-per-count", type=Number(), metavar="UM",
                     help="Displacement sensor, um per count. Default: what the firmware says."),
        click.option("--count-0-um", "count_0_um", type=Number(), metavar="UM",
                     help="Displacement at the sensor's count 0, um. Default: what the firmware says."),
        click.option("--stretches", is_flag=True,
                     help="Write every stretch between lost samples, as RUN-1.csv, RUN-2.csv, ... Default: the "
                          "longest, as RUN.csv."),
        click.option("--max-lost", type=click.IntRange(min=0), metavar="N",
                     help="Exit with status 1 if more samples than this are missing."),
    )):
        function = option(function)
    return function


def _texts(**texts: str | None) -> dict[str, str]:
    """What the user gave of a recording's metadata; refused before any work if no file could hold it."""
    for name, text in texts.items():
        if text is not None and text != _printable(text):
            raise BadInput(f"--{name} {text!r}: not UTF-8; set a UTF-8 locale, or use letters without accents")
    return {name: text for name, text in texts.items() if text is not None}


def _check_telemetry_options(context: click.Context, telemetry: bool) -> None:
    """Refuse options of import that mean nothing with --telemetry, and those that mean nothing without."""
    common = {"sources", "output", "actuator", "memory", "note", "json_path", "telemetry"}
    only = {"um_per_count", "count_0_um", "stretches", "max_lost"}
    for parameter in context.command.params:
        given = context.get_parameter_source(parameter.name) is click.core.ParameterSource.COMMANDLINE
        if given and parameter.name not in common and (parameter.name in only) != telemetry:
            raise BadInput(f"{parameter.opts[-1]}: has a meaning only {'without' if telemetry else 'with'} --telemetry")


def _import_telemetry(sources: tuple[str, ...], output: str, texts: dict[str, str],
                      scale: tuple[float | None, float | None], **options: Any) -> dict[str, Any]:
    from ..board import Decoder
    from ..data import read_bytes

    targets = _targets(sources, output, options["stretches"])
    decoders = [Decoder(source) for source in sources]
    with progress("importing") as report:
        for index, decoder in enumerate(decoders):
            stream = read_bytes(decoder.where)
            for start in range(0, len(stream), _STREAM_CHUNK):
                decoder.feed(stream[start:start + _STREAM_CHUNK])
                report((index + start / len(stream)) / len(sources))
            decoder.finish()
        # Only now, so that a bad source leaves nothing behind.
        found = [_stretches(decoder, scale) for decoder in decoders]
    results = []
    for decoder, parts, target in zip(decoders, found, targets):
        result, lines = _write_telemetry(decoder, parts, target, Path(decoder.where).name, texts, **options)
        click.echo("\n".join([*lines, _how_it_ended(decoder)]))
        _tell_gate(result, options["max_lost"])
        results.append(result)
    return {"recordings": [recording for result in results for recording in result["recordings"]],
            "streams": [{key: value for key, value in result.items() if key != "recordings"} for result in results],
            "gate_failed": any(result["gate_failed"] for result in results)}


def _stretches(decoder: Any, scale: tuple[float | None, float | None]) -> list[Any]:
    from ..board import telemetry

    found = telemetry.stretches(decoder, *scale)
    if not found:
        if decoder.info is not None and decoder.info.state >= telemetry.REFUSED:
            raise BadInput(f"{decoder.where}: {_how_it_ended(decoder)}")
        raise BadInput(f"{decoder.where}: {telemetry.summary(decoder.counts)}: no {telemetry.MIN_SAMPLES} samples "
                       "without a gap after the start-up sweep; record for longer, or see to the line")
    return found


def _how_it_ended(decoder: Any) -> str:
    """What the end of a stream tells of its target."""
    from ..board import REFUSED, refusal

    if decoder.runs[-1].finished:
        return "the target had finished"
    if decoder.info is not None and decoder.info.state >= REFUSED:
        return f"the target refuses to run: {refusal(decoder.info)}"
    return "note: the stream ends before the target had finished"


def _write_telemetry(decoder: Any, found: list[Any], target: Path, source: str, texts: dict[str, str],
                     stretches: bool, max_lost: int | None) -> tuple[dict[str, Any], list[str]]:
    """Write what a stream holds; returns it for `--json`, and the lines that tell it and what it does not hold.

    Nothing is printed here: a terminal that is gone must not cost the recording.
    """
    from dataclasses import asdict

    from ..board import telemetry
    from ..data import make_folder, write_recording

    counts = decoder.counts
    files = [(target.with_stem(f"{target.stem}-{number}"), stretch) for number, stretch in enumerate(found, 1)]
    if not stretches:
        files = [(target, max(found, key=lambda stretch: stretch.samples))]
    lines = [f"{decoder.where}: {telemetry.summary(counts)}",
             *(f"note: {note}" for note in telemetry.notes(decoder, found, [stretch for _, stretch in files]))]
    recordings = []
    make_folder(target.parent)
    for file, stretch in files:
        metadata = {"source": _printable(source), **stretch.metadata, **texts}
        write_recording(file, stretch.columns, metadata)
        why = f" ({stretch.why_unknown})" if stretch.why_unknown and "memory" not in texts else ""
        lines.append(f"  {file}: {stretch.samples} samples at {metadata['sample_rate_hz']} per second from tick "
                     f"{metadata['first_tick']}, memory: {metadata['memory']}{why}")
        recordings.append({"file": str(file), "source": decoder.where, "samples": stretch.samples,
                           "sample_rate_hz": metadata["sample_rate_hz"], "columns": list(stretch.columns),
                           "metadata": metadata})
    return {"recordings": recordings, "source": decoder.where, "counts": asdict(counts),
            "stretches": [stretch.samples for stretch in found], "finished": decoder.runs[-1].finished,
            "target": decoder.info_of(decoder.runs[-1])._asdict(),
            "gate_failed": max_lost is not None and counts.missing > max_lost}, lines


def _tell_gate(result: dict[str, Any], max_lost: int | None) -> None:
    if result["gate_failed"]:
        missing = result["counts"]["lost"] + result["counts"]["ticks_lost"]
        click.echo(f"rdpi: {missing} samples are missing, more than the {max_lost} allowed by --max-lost", err=True)


_STREAM_CHUNK = 1 << 20  # bytes
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
@click.option("--resample", "resample_hz", metavar="HZ", type=Number(positive=True),
              help="Put the recording on a uniform grid of so many samples per second, by interpolation, for a clock "
                   "that jitters or a rate higher than needed. Below the recorded rate a low-pass comes first, which "
                   "keeps what is below 0.4 HZ. Gaps are refused; the jitter found is told.")
@click.option("--command-gain", metavar="GAIN", type=float, default=1.0,
              help="V/V. The voltage was recorded before an amplifier of this fixed gain: multiply the command by it.")
@click.option("--as", "purpose", type=click.Choice(["run", "drive", "reference"]), default="run", show_default=True,
              help="What the file must give: command and displacement, only a command, or only a reference.")
@click.option("--actuator", metavar="TEXT", help="Kept in the recording.")
@click.option("--memory", type=click.Choice(["reset", "carried", "unknown"]),
              help="What the hysteresis remembers at the first row taken: a decaying sweep ended here, the row follows "
                   "the previous recording, or unknown.")
@click.option("--note", metavar="TEXT", help="Kept in the recording.")
@click.option("--telemetry", is_flag=True,
              help="SOURCE is what a microcontroller sent, as `rdpi record --raw` keeps it or any program that stores "
                   "what comes from a serial port.")
@_telemetry_options
def import_(sources: tuple[str, ...], output: str, rate_hz: float | None, rows: slice, resample_hz: float | None,
            command_gain: float, purpose: str, also: dict[str, str], actuator: str | None, memory: str | None,
            note: str | None, telemetry: bool, stretches: bool, max_lost: int | None, um_per_count: float | None,
            count_0_um: float | None, **columns: str | None) -> dict[str, Any]:
    """Bring other formats to a recording.

    SOURCE is a table (comma, semicolon, tab or white space; with or without names), what an oscilloscope or LabVIEW
    (.lvm) writes, with its names, units and sample interval above the table, a MATLAB .mat (up to v7), or a NumPy .npy
    or .npz. A COLUMN is a name or a number from 0. UNIT may also be a factor:
    `--displacement 4:0.5` multiplies by 0.5 to get um. Units in names (pos_nm, "disp [um]") are understood, and obvious
    names are recognised without options; what was taken for what is printed. In a matrix the longer side is time.

    \b
    rdpi import Model_Vi_Do.dat --command 0 --displacement 4 --rate 200 --rows 400:4400 -o fit.csv
    rdpi import scope.csv --time t:ms --command Vin:mV --displacement pos_nm -o run.csv
    rdpi import monday/*.mat -o runs/
    rdpi import --telemetry captured.bin -o run.csv
    """
    from ..data import ROLES, Request, import_recording, make_folder, write_recording

    _check_telemetry_options(click.get_current_context(), telemetry)

    reserved = {role.column: key for key, role in ROLES.items()}
    for name in set(also) & set(reserved):
        raise BadInput(f"--also {name}: this column has its own option, --{reserved[name]}")
    texts = _texts(actuator=actuator, memory=memory, note=note)
    if telemetry:
        return _import_telemetry(sources, output, texts, stretches=stretches, max_lost=max_lost,
                                 scale=(um_per_count, count_0_um))
    request = Request(columns={key: spec for key, spec in columns.items() if spec is not None}, also=also,
                      rate_hz=rate_hz, rows=rows, command_gain=command_gain, purpose=purpose, resample_hz=resample_hz,
                      metadata=texts)
    targets = _targets(sources, output)
    results = []
    with progress("importing") as report:
        imported = []
        for index, source in enumerate(sources):
            imported.append(import_recording(source, request))
            report((index + 0.5) / len(sources))
        # Only now, so that a bad source leaves nothing behind.
        for target, (recording, lines) in zip(targets, imported):
            make_folder(target.parent)
            write_recording(target, recording.columns, recording.metadata)
            click.echo("\n".join([*lines, f"  written to {target}"]))
            results.append({"file": str(target), "source": recording.path, "samples": len(recording),
                            "sample_rate_hz": recording.sample_rate_hz, "columns": list(recording.columns),
                            "metadata": recording.metadata})
    return {"recordings": results}


def _targets(sources: tuple[str, ...], output: str, stretches: bool = False) -> list[Path]:
    """What to write: with `stretches` each is a family of numbered files."""
    folder = Path(output)
    if len(sources) == 1 and not folder.is_dir() and not output.endswith("/"):
        _refuse_overwriting([folder], stretches)
        return [folder]
    if len(sources) > 1 and not folder.is_dir() and (folder.exists() or folder.suffix):
        raise BadInput(f"-o {output}: several sources need a folder; give one, e.g. -o runs/")
    targets = [folder / f"{Path(source).stem}.csv" for source in sources]
    for index, target in enumerate(targets):
        if target in targets[:index]:
            first = sources[targets.index(target)]
            raise BadInput(f"{sources[index]} and {first} would both be written to {target}; import them one by one")
    _refuse_overwriting(targets, stretches)
    return targets


def _refuse_overwriting(targets: list[Path], stretches: bool) -> None:
    """Refuse targets that are, or of which a stretch may be, an input or another output of this command."""
    options = click.get_current_context().params
    inputs = [Path(source) for source in options.get("sources", ())]
    outputs = [Path(options[name]) for name in ("json_path", "raw") if options.get(name)]
    for target in targets:
        files = [target]
        if stretches:
            member = re.compile(re.escape(target.stem) + "-[0-9]+" + re.escape(target.suffix))
            there = target.parent.iterdir() if target.parent.is_dir() else ()
            files = [file for file in (*there, *outputs) if member.fullmatch(file.name)]
            files = [target.with_name(file.name) for file in files]
        for file in files:
            for other in (*inputs, *outputs):
                if _same_file(file, other) and not _is_device(str(other)):
                    kind = "an input" if other in inputs else "another output"
                    raise BadInput(f"{file}: would be written over {kind}; give another name or folder")


def _same_file(one: Path, other: Path) -> bool:
    if one.exists() and other.exists():
        return one.samefile(other)
    return os.path.realpath(one) == os.path.realpath(other)


@command("record")
@click.argument("port", metavar="PORT")
@click.option("-o", "--output", required=True, metavar="RUN.csv", type=click.Path(dir_okay=False),
              help="The recording.")
@click.option("--baud", type=click.IntRange(min=1), default=3_000_000, show_default=True, metavar="BAUD",
              help="Bits per second on the line.")
@click.option("--duration", "duration_s", type=Number(positive=True), metavar="S",
              help="Stop after so many seconds of the target's time. Default: when it has finished, or at Ctrl-C.")
@click.option("--timeout", "timeout_s", type=Number(positive=True), default=5.0, show_default=True,
              metavar="S", help="Give up after so many seconds without a frame, once the first has come: that is "
                                "waited for without limit. So many seconds of bytes that are no telemetry, or of infos "
                                "without a sample, end it too.")
@click.option("--raw", type=click.Path(dir_okay=False), metavar="FILE",
              help="Also keep every byte as it came, for `rdpi import --telemetry`.")
@click.option("--actuator", metavar="TEXT", help="Kept in the recording.")
@click.option("--memory", type=click.Choice(["reset", "carried", "unknown"]),
              help="What the hysteresis remembers at the first sample written. Default: reset where the target's "
                   "start-up sweep was received whole, ends amid its range and the drive goes on from there, else "
                   "unknown.")
@click.option("--note", metavar="TEXT", help="Kept in the recording.")
@_telemetry_options
def record_(port: str, output: str, baud: int, duration_s: float | None, timeout_s: float, raw: str | None,
            actuator: str | None, memory: str | None, note: str | None, stretches: bool, max_lost: int | None,
            um_per_count: float | None, count_0_um: float | None) -> dict[str, Any]:
    """Read a microcontroller's telemetry from a serial port into a recording.

    PORT is a device, /dev/ttyACM0 or an emulator's pseudo-terminal, or a URL that pyserial knows, e.g.
    socket://localhost:1234. Begin before the board is flashed or reset: a start that was not heard, and all of a run
    that had finished before, is lost. Samples of the start-up sweep are left out; where there is no reference, of a
    drive, all but its last. Lost and corrupt frames are counted, in the file's metadata too; a recording never spans a
    gap.

    RUN.csv is written when the recording ends. Until then RUN.csv.part holds, on disk, all that is older than a
    second; after a gap RUN.csv.part2 and so on follow. After a crash or a power failure each of them can be used as a
    recording: a last line that was cut is left out. The longest and the present one are kept, with --stretches all.
    They are removed when RUN.csv is written.
    """
    from ..board import REFUSED, Decoder, Following, Raw, Safe, is_part, record, reserved, stop_signals

    _refuse_overwriting([Path(output)], stretches)
    target = Path(os.path.realpath(output))
    for other in filter(None, (raw, click.get_current_context().params["json_path"])):
        if is_part(Path(os.path.realpath(other)), target):
            raise BadInput(f"{other}: is where samples go while the recording goes on; give another name")
    texts = _texts(actuator=actuator, memory=memory, note=note)
    scale = um_per_count, count_0_um
    decoder, copy = Decoder(port), Raw(raw)
    with stop_signals() as stopped, reserved(output), reserved(raw):  # until all is written
        safe = Safe(None if _is_device(output) else target, stretches, Following(decoder, *scale),
                    {"source": _printable(port), **texts}, copy)
        with safe, _recording_line() as report:
            end = record(decoder, baud, duration_s, timeout_s, safe, report, stopped)
        copied = [f"--raw {copy.failure}"] if copy.failure else []
        why = "" if end.good else end.why
        try:
            if not decoder.counts.samples:
                refuses = decoder.info is not None and decoder.info.state >= REFUSED
                decoder.check()
                raise BadInput(f"{port}: {end.why}" if refuses else f"{port}: no samples: {end.why}")
            try:
                decoder.finish()
            except BadInput as error:  # what came before may be good
                if decoder.info is None:
                    raise
                why = str(error).removeprefix(f"{port}: ")
            found = _stretches(decoder, scale)
        except BadInput as error:
            besides = [why] if why not in str(error) else []
            raise BadInput("; ".join([str(error), *besides, *copied])) from None
        try:
            result, lines = _write_telemetry(decoder, found, Path(output), port, texts, stretches, max_lost)
        except OSError as error:
            if not safe.where:
                raise
            raise BadInput(f"{error.filename}: {error.strerror or error}; the samples are in {safe.where}") from None
        safe.remove()
    click.echo("\n".join(lines))
    _tell_gate(result, max_lost)
    if failures := ([f"{why}; what came before has been written"] if why else []) + copied:
        raise BadInput(f"{port}: {'; '.join(failures)}")
    click.echo(f"  {end.why}")
    return {**result, "ended": end.why}


@contextmanager
def _recording_line() -> Iterator[Callable[[Any], None]]:
    """On a terminal, a line that tells how a recording goes on; when stderr is piped, nothing."""
    if not sys.stderr.isatty():
        yield lambda decoder: None
        return
    from rich.console import Console

    from ..board import FINISHED, NO_READING, displacement_um

    status = Console(stderr=True).status("waiting for the first frame; Ctrl-C ends")

    def report(decoder: Any) -> None:
        latest, info, counts = decoder.latest, decoder.info, decoder.counts
        if not counts.samples:
            over = info is not None and info.state == FINISHED
            what = "a reset: the target had finished before" if over else "the first frame"
            text = f"waiting for {what}; Ctrl-C ends"
        else:
            at = ""
            if info is not None and latest is not None and latest["adc_counts"] != NO_READING:
                at = f", {displacement_um(info, latest['adc_counts']):.4g} um"
            text = f"{counts.samples} samples, {counts.missing} lost{at}; Ctrl-C ends"
        with suppress(OSError):  # the terminal is gone, the recording is not
            status.update(text)

    try:
        with suppress(OSError):
            status.start()
        yield report
    finally:
        with suppress(OSError):
            status.stop()


@command("excite")
@click.argument("kind", type=click.Choice(["sawtooth", "minor-loops", "steps", "multisine", "sine", "chirp",
                                           "startup"]))
@click.option("-o", "--output", required=True, metavar="DRIVE.csv", type=click.Path(dir_okay=False), help="The drive.")
@click.option("--min-V", "min_V", type=float, default=0.0, show_default=True, help="Lowest voltage, V.")
@click.option("--max-V", "max_V", type=float, default=10.0, show_default=True, help="Highest voltage, V.")
@click.option("--rest-V", "rest_V", type=float,
              help="Voltage at which the drive starts and ends, V. Default: the middle, where a sweep can decay from "
                   "both sides; one that ends near an edge leaves a branch behind (memory unknown, not reset).")
@click.option("--sample-rate", "sample_rate_hz", type=float, default=10_000.0, show_default=True, metavar="HZ",
              help="Samples per second.")
@click.option("--slew", "slew_V_per_s", type=float, metavar="V/S",
              help="The drive never changes faster than this, V/s.")
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
@click.option("--duration", "duration_s", type=float, metavar="S",
              help="multisine, chirp: length, default 10 s (multisine: longer where --slew demands it).")
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
    decaying sweep of about one second; `sweep_s` in the file says how long it takes. Same options, same file.
    """
    from ..data import Limits, make_drive, write_recording

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


@command("fit")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="MODEL.json", type=click.Path(dir_okay=False), help="The model.")
@click.option("--operators", type=int, default=9, show_default=True, metavar="N",
              help="Plays with a positive threshold.")
@click.option("--deadzones", type=int, default=2, show_default=True, metavar="M",
              help="Dead zones of the saturation stage.")
@click.option("--thresholds", "thresholds_um", type=Numbers(), metavar="UM,UM,...",
              help="Thresholds r_1, r_2, ... in um instead of equal intervals.")
@click.option("--rate-independent", is_flag=True, help="Fit no rate law: slopes do not depend on rate.")
@click.option("--rate-source", type=click.Choice(["displacement", "control"]), default="displacement",
              show_default=True, help="Whose rate modulates the slopes.")
@click.option("--rate-window", "rate_window_s", type=float, default=0.0, show_default=True, metavar="S",
              help="The firmware's rate is a difference over this time, s; 0: one sample.")
@click.option("--rate-filter", "rate_filter_s", type=float, default=0.0, show_default=True, metavar="S",
              help="Time constant of the firmware's low-pass on the rate, s; 0: none.")
@click.option("--min-slope-ratio", type=float, default=0.2, show_default=True, metavar="RATIO",
              help="The guard clamps the rate where a slope has fallen to this share of its value at rest.")
@click.option("--min-V", "min_V", type=float, metavar="V",
              help="Lowest drive the firmware may output. Default: lowest recorded.")
@click.option("--max-V", "max_V", type=float, metavar="V", help="Highest drive. Default: highest recorded.")
@click.option("--slew", "slew_V_per_s", type=float, metavar="V/S",
              help="Fastest change of the drive. Default: no limit.")
@click.option("--dac-bits", type=int, metavar="BITS",
              help="Codes of the DAC span --min-V to --max-V. Default: no codes.")
@click.option("--actuator", metavar="TEXT", help="Name kept in the model. Default: the first recording's.")
@click.option("--hold-out", multiple=True, metavar="RUN", type=click.Path(dir_okay=False),
              help="A recording to score the model on, not fitted; may be given several times.")
@click.option("--max-rms", "max_rms_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if any held-out run (without any: any run) is predicted worse than this, "
                   "% of stroke.")
@click.option("--report", metavar="DIR", type=click.Path(file_okay=False),
              help="Write fit.png (loops, slopes, residual) and fit.json there.")
def fit(runs: tuple[str, ...], output: str, hold_out: tuple[str, ...], max_rms_percent: float | None,
        report: str | None, **options: Any) -> dict[str, Any]:
    """Identify a model from recordings.

    One bounded least-squares problem over all samples of all runs. Recordings at several rates and amplitudes, with
    memory known (metadata memory: reset) where possible, give the best model; see `rdpi excite`.
    """
    from ..data import read_recording
    from ..fit import Options, fit as identify
    from ..model import write_model

    with progress("fitting") as report_progress:
        fitted = [read_recording(path) for path in runs]
        held = [read_recording(path) for path in hold_out]
        result = identify(fitted, Options(**options), held, report_progress)
    write_model(output, result.model)
    judged = [run.score.rms_percent for run in result.scores if run.held_out or not held]
    failed = max_rms_percent is not None and max(judged) > max_rms_percent
    summary = {**result.model.fit, "model": output, "gate_failed": failed, "rate_slopes": result.rate_slopes.to_json()}
    if report is not None:
        _write_fit_report(result, [*fitted, *held], Path(report), summary)
    _print_fit(result, output)
    if failed:
        click.echo(f"rdpi: {max(judged):.3g} % rms, above the {max_rms_percent:g} % allowed by --max-rms", err=True)
    return summary


def _print_fit(result: Any, output: str) -> None:
    import numpy as np

    from ..simulate import chain

    model = result.model
    click.echo(f"{output}: {len(model.slopes) - 1} plays, {len(model.deadzones_um) - 1} dead zones, "
               f"stroke {model.stroke_um:.5g} um, noise {result.noise_um:.2g} um rms")
    _print_scores([(run.recording.path, run.score, "held out" if run.held_out else "fitted") for run in result.scores])
    bands = result.rate_slopes
    top = model.rate.identified_um_per_s
    click.echo("slopes W_i against rate: each band of rate fitted alone, then the model's law")
    click.echo(f"  {'':>20}" + "".join(f"{f'W_{i}':>7}" for i in range(len(model.slopes))))
    rows = [(f"{rate:.4g} um/s", slopes) for rate, slopes in zip(bands.rate_um_per_s, bands.slopes)]
    for label, slopes in (*rows, ("model, at rest", model.slopes), (f"model, {top:.4g} um/s", model.slopes_at(top))):
        click.echo(f"  {label:>20}" + "".join(f"{'-' if np.isnan(slope) else f'{slope:.3f}':>7}" for slope in slopes))
    dependent, independent = (100 * residual for residual in result.residual)
    if dependent != independent:
        click.echo(f"residual of the regression: {dependent:.3g} % rms of the stroke, "
                   f"without the rate law {independent:.3g} %")
    low, high = chain.reachable_um(model)
    click.echo(f"reachable displacement: {low:.5g} to {high:.5g} um; "
               "references are displacements as the sensor reads them")
    singular = model.rate.singular_um_per_s
    click.echo(f"rates identified up to {top:.4g} um/s; guard at {model.rate.max_um_per_s:.4g} um/s"
               + (f"; a slope reaches zero at {singular:.4g} um/s" if singular else ""))
    for warning in result.warnings:
        click.echo(f"note: {warning}")


def _print_scores(rows: list[tuple[str, Any, str]]) -> None:
    width = max(len(path) for path, _, _ in rows)
    click.echo(f"  {'':{width}}  {'rms um':>9} {'max um':>9} {'rms %':>7} {'max %':>7}   (% of the run's stroke)")
    for path, score, remark in rows:
        click.echo(f"  {path:{width}}  {score.rms_um:9.4g} {score.max_um:9.4g} "
                   f"{score.rms_percent:7.3f} {score.max_percent:7.3f}   {remark}")


def _write_fit_report(result: Any, runs: list[Any], folder: Path, summary: dict[str, Any]) -> None:
    from ..data import atomic_write, make_folder
    from ..fit import report
    from ..simulate import chain

    make_folder(folder)
    figure = report.picture(result.model, runs, chain.simulate(result.model, runs), result.rate_slopes)
    report.write_picture(figure, folder / "fit.png")
    atomic_write(folder / "fit.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")


@command("header")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="rdpi_params.h", type=click.Path(dir_okay=False),
              help="The header.")
@click.option("--name", default="rdpi_params", show_default=True, metavar="NAME",
              help="C name of the parameters, for several actuators in one firmware.")
@click.option("--sweep-end-V", "sweep_end_V", type=float, metavar="V",
              help="Where rdpi_f32_sweep ends. Default: the model's, drive.sweep_end_V, or what holds its memory.")
@click.option("--sweep-cycles", type=int, metavar="N", help="Cycles of that sweep. Default: the model's, or 20.")
@click.option("--sweep-rate", "sweep_V_per_s", type=float, metavar="V/S",
              help="Its speed. Default: the model's, or 20 Hz over the whole range, or what its slew limit allows.")
def header(model: str, output: str, name: str, **sweep: float | None) -> dict[str, Any]:
    """Generate the C header that the firmware compiles in. The same model gives the same bytes."""
    from dataclasses import replace

    from ..firmware import fixed_point, write_header
    from ..model import read_model

    parameters = read_model(model)
    parameters.drive = replace(parameters.drive, **{key: value for key, value in sweep.items() if value is not None})
    write_header(parameters, output, name, source=model)
    _tell_effects(parameters)
    click.echo(f"{output}: {name}, {len(parameters.slopes) - 1} plays, {len(parameters.deadzones_um) - 1} dead zones, "
               f"starts from {parameters.memory.x_um / parameters.gain_um_per_V + parameters.offset_V:.6g} V, "
               f"start-up sweep ends at {parameters.sweep_end():.6g} V")
    for need, default, maximum in ((len(parameters.slopes), 16, "RDPI_MAX_PLAYS"),
                                   (len(parameters.deadzones_um), 8, "RDPI_MAX_DEADZONES")):
        if need > default:
            click.echo(f"note: compile the library and its users with -D{maximum}={need} (default {default})")
    if parameters.rate.window_s:
        click.echo(f"note: the rate window spans {parameters.rate.window_s:g} s times the samples per second; "
                   "above 16 samples compile with -DRDPI_MAX_WINDOW=...")
    if parameters.shortest_sample_s() > 1e-6:
        click.echo(f"note: at {parameters.drive.sweep_speed():.4g} V/s the start-up sweep is too slow for more than "
                   f"{1 / parameters.shortest_sample_s():.3g} samples per second; rdpi_f32_init refuses them")
    q31, reason = fixed_point(parameters)
    if q31 is None:
        click.echo(f"note: single precision only, not fixed point: {reason}")
    return {"file": output, "name": name, "digest": parameters.digest(), "q31": q31 is not None}


def _tell_effects(model: Any) -> None:
    """The inverse has none of the effects that `gap` adds: say so wherever it is made of a model that has."""
    names = [str(effect.get("name")) for effect in model.effects if isinstance(effect, dict)]
    if names:
        click.echo(f"note: effects that only the simulation knows, not the inverse: {', '.join(names)}", err=True)


class Dac(click.ParamType):
    """BITS:MIN_V:MAX_V."""

    name = "dac"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, float, float]:
        if isinstance(value, tuple):
            return value
        try:
            bits, low, high = value.split(":")
            return int(bits), float(low), float(high)
        except ValueError:
            self.fail(f"{value!r}: give BITS:MIN_V:MAX_V, e.g. 16:-20:120", param, ctx)


@command("profile")
@click.argument("source", metavar="FILE.csv", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="rdpi_profile.h", type=click.Path(dir_okay=False),
              help="The header.")
@click.option("--reference-column", metavar="COLUMN", help="Column to follow, um. Default: reference_um.")
@click.option("--dac", type=Dac(), metavar="BITS:MIN_V:MAX_V",
              help="FILE.csv is a drive: its command_V as codes of this DAC, volts at the actuator.")
def profile(source: str, output: str, reference_column: str | None,
            dac: tuple[int, float, float] | None) -> dict[str, Any]:
    """Generate the C header of a table that the firmware plays: a reference, or with --dac a drive.

    FILE.csv needs the columns time_s and reference_um, or another --reference-column, in um; with --dac time_s and
    command_V. References are for port/profile, which converts them to the application's numbers when it is compiled;
    drives, as `rdpi excite` makes them, for examples/excite. The same file gives the same bytes.
    """
    from ..board import profile as tables
    from ..data import atomic_write, read_recording

    if dac is not None and reference_column is not None:
        raise BadInput("--reference-column: has no meaning with --dac, which makes a drive of command_V")
    column = "command_V" if dac is not None else reference_column or "reference_um"
    with progress("generating"):
        run = read_recording(source, required=("time_s", column))
        text = tables.render_reference(run, column) if dac is None else tables.render_drive(run, *dac)
        atomic_write(output, text)
    values, rate_hz = run.columns[column], tables.integer_rate_hz(run)
    unit = "um" if dac is None else "V"
    click.echo(f"{output}: {len(run)} samples at {rate_hz} per second, {values.min():g} to {values.max():g} {unit}, "
               f"{4 * len(run)} bytes of flash")
    result = {"file": output, "samples": len(run), "sample_rate_hz": rate_hz, "digest": run.digest}
    if dac is not None:
        result["sweep_samples"] = tables.sweep_samples(run)
        click.echo(f"the first {result['sweep_samples']} samples are a decaying sweep")
    elif refused := int((~tables.usable(values)).sum()):
        click.echo(f"note: {refused} samples are beyond the largest reference: the drive holds there; check their unit")
    return result


@command("simulate")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", metavar="OUT.csv", type=click.Path(dir_okay=False),
              help="The run's columns and predicted_um; one run only.")
@click.option("--remove-offset", is_flag=True, help="Score without the mean error (thermal drift since the fit).")
@click.option("--memory", type=click.Choice(["auto", "model", "reset"]), default="auto", show_default=True,
              help="State of the hysteresis at each run's start. auto: as its metadata says, estimated where unknown.")
@click.option("--max-rms", "max_rms_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if any run is predicted worse than this, % of stroke.")
def simulate(model: str, runs: tuple[str, ...], output: str | None, remove_offset: bool, memory: str,
             max_rms_percent: float | None) -> dict[str, Any]:
    """Predict the displacement from the command and score it; percentages are of each run's measured stroke."""
    from ..data import read_recording, write_recording
    from ..model import read_model
    from ..simulate import chain, effects

    if output is not None and len(runs) > 1:
        raise BadInput("-o takes one RUN; simulate them one by one (memory: carried is then lost)")
    with progress("simulating"):
        parameters = read_model(model)
        effects.acting(parameters, model)  # refuses by the file's name
        recordings = [read_recording(path, required=("time_s", "command_V")) for path in runs]
        predictions = chain.simulate(parameters, recordings, memory)
    scores = [(run.path, chain.score(prediction.predicted_um, run.displacement_um, remove_offset, run.path),
               f"memory: {prediction.memory}")
              for run, prediction in zip(recordings, predictions) if run.displacement_um is not None]
    if max_rms_percent is not None and len(scores) < len(recordings):
        raise BadInput("--max-rms: every RUN needs a displacement_um to be judged by")
    if output is not None:
        columns = {**recordings[0].columns, "predicted_um": predictions[0].predicted_um}
        write_recording(output, columns, recordings[0].metadata)
    for run, prediction in zip(recordings, predictions):
        if run.displacement_um is None:
            click.echo(f"{run.path}: predicted, no displacement_um to score")
        low_V, high_V = parameters.drive.min_V, parameters.drive.max_V
        beyond = max(low_V - run.command_V.min(), run.command_V.max() - high_V)
        if beyond > 0.01 * (high_V - low_V):
            click.echo(f"note: {run.path}: the command goes {beyond:.3g} V beyond the model's drive range, "
                       f"{low_V:g} to {high_V:g} V")
        guarded = float((prediction.rate_um_per_s > parameters.rate.max_um_per_s).mean())
        if guarded > 0.01:
            click.echo(f"note: {run.path}: in {100 * guarded:.2g} % of the samples the rate was beyond the guard, "
                       f"{parameters.rate.max_um_per_s:.4g} um/s, and clamped")
        if not prediction.settled:
            click.echo(f"note: {run.path}: the prediction's own rate did not settle; treat it with care, "
                       "or fit with a longer --rate-window")
    if not scores:
        return {"runs": [], "rms_percent": None, "max_percent": None, "gate_failed": False}
    _print_scores(scores)
    if remove_offset:
        click.echo("offsets removed: " + ", ".join(f"{score.offset_um:.4g} um" for _, score, _ in scores))
    weights = [len(run) for run in recordings if run.displacement_um is not None]
    squares = sum(weight * score.rms_percent**2 for weight, (_, score, _) in zip(weights, scores))
    failed = max_rms_percent is not None and max(score.rms_percent for _, score, _ in scores) > max_rms_percent
    if failed:
        click.echo(f"rdpi: above the {max_rms_percent:g} % rms allowed by --max-rms", err=True)
    return {"runs": [{"file": path, **score._asdict(), "memory": remark.split()[-1]} for path, score, remark in scores],
            "rms_percent": (squares / sum(weights)) ** 0.5,
            "max_percent": max(score.max_percent for _, score, _ in scores), "gate_failed": failed}


@command("compensate")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("reference", metavar="REFERENCE.csv", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="DRIVE.csv", type=click.Path(dir_okay=False),
              help="The reference's columns and command_V, rate_um_per_s, flags and, with --dac-bits, dac_code.")
@click.option("--engine", default="f32", show_default=True,
              type=click.Choice(["f32", "q31", "f64", "numpy", "qemu-m0", "qemu-m3", "qemu-m4f", "qemu-m7"]),
              help="f32: the firmware library; q31: the same in fixed point; f64: in double; numpy: the independent "
                   "reference; qemu-...: the firmware itself on an emulated Cortex-M0, M3, M4F or M7.")
@click.option("--fixed-point", is_flag=True, help="The emulated firmware is that in fixed point. Default: single "
                                                  "precision, on every board.")
@click.option("--sweep", is_flag=True,
              help="Run the firmware's start-up sweep first, as a board does, and leave it out: the drive starts from "
                   "where that leaves the actuator. Default: from the model's memory, or what REFERENCE.csv tells of "
                   "it. Not with --engine numpy.")
@click.option("--dac-bits", type=int, metavar="BITS", help="Output codes of this many bits. Default: the model's.")
@click.option("--reference-column", default="reference_um", show_default=True, metavar="COLUMN",
              help="Column to follow; displacement_um of a recording shows how well its command is recovered.")
@click.option("--remove-offset", is_flag=True,
              help="First remove the recording's mean deviation from the model (thermal drift).")
def compensate(model: str, reference: str, output: str, engine: str, fixed_point: bool, sweep: bool,
               dac_bits: int | None, reference_column: str, remove_offset: bool) -> dict[str, Any]:
    """Run the inverse as the firmware does: reference in um to drive in V.

    REFERENCE.csv needs the columns time_s and reference_um, or another --reference-column. A board sweeps before it
    follows: its codes are those of --sweep.

    flags are the sum of 1 (rate clamped by the guard), 2 (drive clipped to its range), 4 (drive clipped by its slew
    limit), 8 (reference not usable, drive held) and 16 (the first after such samples). If REFERENCE.csv has a command_V
    it is kept as recorded_V, and the computed drive is compared with it.

    The engines qemu-... build examples/track for model and reference and run it in qemu-system-arm; they need the
    project's checkout (set RDPI_HOME where the tools are installed apart from it) and arm-none-eabi-gcc.
    """
    from dataclasses import replace
    from functools import partial

    import numpy as np

    from ..board import OFF_THE_MIDDLE, STILL, amid
    from ..data import read_recording, write_recording
    from ..firmware import q31
    from ..model import read_model
    from ..simulate import chain

    parameters = read_model(model)
    _tell_effects(parameters)
    if dac_bits is not None:
        parameters.drive = replace(parameters.drive, dac_bits=dac_bits)
        parameters.validate(model)
    emulated = engine.startswith("qemu-")
    if fixed_point and not emulated:
        raise BadInput(f"--fixed-point: is for the engines qemu-...; with --engine {engine} it has no meaning")
    if engine == "q31" or fixed_point:
        q31(parameters, model)  # refuses by the file's name
    run = read_recording(reference, required=("time_s", reference_column))
    with progress("compensating") as report:
        how: str | chain.Engine = engine
        if emulated:
            from ..board import emulator

            how = partial(emulator.step, run=run, board=engine, fixed_point=fixed_point, sweep=sweep, report=report)
        steps, offset = chain.follow(parameters, run, reference_column, how, remove_offset, sweep)
    columns = {name: values for name, values in run.columns.items() if name != "command_V"}
    columns["reference_um"] = run.columns[reference_column]
    columns.update(command_V=steps.drive_V.astype(float), rate_um_per_s=steps.rate_um_per_s.astype(float),
                   flags=steps.flags.astype(float))
    if parameters.drive.dac_bits:
        columns["dac_code"] = steps.dac_code.astype(float)
    result: dict[str, Any] = {"file": output, "engine": engine, "sweep": sweep, "samples": len(run)}
    for name, bit in (("guard", 1), ("range", 2), ("slew", 4), ("input", 8), ("missed", 16)):
        result[f"{name}_count"] = int(((steps.flags & bit) > 0).sum())
    flagged = ", ".join(f"{result[f'{name}_count']} {name}" for name in ("guard", "range", "slew", "input"))
    if result["range_count"]:
        low, high = chain.reachable_um(parameters)
        reference_um = columns["reference_um"][np.isfinite(columns["reference_um"])] - offset
        click.echo(f"note: the drive was clipped; reachable {low:.5g} to {high:.5g} um, "
                   f"asked for {reference_um.min():.5g} to {reference_um.max():.5g} um")
    click.echo(f"{output}: {len(run)} samples, {steps.drive_V.min():.6g} to {steps.drive_V.max():.6g} V, "
               f"flagged: {flagged}")
    if run.command_V is not None:
        columns["recorded_V"] = run.command_V
    if run.command_V is not None and np.ptp(run.command_V) > 0:
        score = chain.score(steps.drive_V.astype(float), run.command_V, where=reference)
        click.echo(f"against the recorded command: rms {score.rms_percent:.3f} %, max {score.max_percent:.3f} % of its "
                   f"peak-to-peak" + (f" (offset of {offset:.4g} um removed)" if remove_offset else ""))
        result["recorded"] = {"rms_V": score.rms_um, "max_V": score.max_um, "rms_percent": score.rms_percent,
                              "max_percent": score.max_percent, "removed_um": offset}
    metadata = run.metadata
    if sweep:  # what the drive's first sample remembers
        low_V, high_V, end_V = parameters.drive.min_V, parameters.drive.max_V, parameters.sweep_end()
        stays = abs(float(steps.drive_V[0]) - end_V) <= STILL * (high_V - low_V)
        reset = stays and amid(end_V, low_V, high_V)
        metadata = {**metadata, "memory": "reset" if reset else "unknown"}
        if stays and not reset:
            click.echo(f"memory: unknown ({OFF_THE_MIDDLE})")
    write_recording(output, columns, metadata)
    return result


@command("gap")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", metavar="IMPROVED.json", type=click.Path(dir_okay=False),
              help="The model with the effects that were found.")
@click.option("--report", metavar="DIR", type=click.Path(file_okay=False),
              help="Write index.html, one page with pictures, and gap.json there.")
@click.option("--earlier", multiple=True, metavar="RUN", type=click.Path(dir_okay=False),
              help="A recording of the same drive as one of the RUNs, made at commissioning, say; one for each, "
                   "--earlier before every one. Then what has changed since is diagnosed, and the model's own error "
                   "does not count.")
@click.option("--without", multiple=True, metavar="EFFECT",
              help="Leave this effect out of those that are tried; may be given several times.")
def gap(model: str, runs: tuple[str, ...], output: str | None, report: str | None, earlier: tuple[str, ...],
        without: tuple[str, ...]) -> dict[str, Any]:
    """Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks once that is added.

    RUNs are recordings that the model was not fitted to, several with different waveforms if possible; a column
    monitor_V (the amplifier's output) tells what lies before the actuator from what lies after. With --earlier, drives
    that were recorded before tell smaller changes.
    """
    from ..data import read_recording
    from ..fit import checks, passport
    from ..gap import diagnose, report as gap_report
    from ..model import read_model, write_model
    from ..simulate.effects import CATALOGUE, acting

    for name in without:
        if name not in CATALOGUE:
            raise BadInput(f"--without {name}: no effect; there are {', '.join(CATALOGUE)}")
    with progress("diagnosing") as report_progress:
        parameters = read_model(model)
        checks.fitted_digests(parameters, model)
        passport.read(parameters, model)
        acting(parameters, model)
        found = diagnose(parameters, [read_recording(path) for path in runs], without, report_progress,
                         [read_recording(path) for path in earlier])
    document = {**found.document, "model": model, "model_digest": parameters.digest()}
    if output is not None:
        write_model(output, found.improved)
    if report is not None:
        gap_report.write(document, gap_report.Pictures(found.runs, found.before_um, found.after_um, found.table,
                                                       found.spectrum_after), report)
    click.echo(gap_report.tables(document))
    if output is not None:
        added = [effect["name"] for effect in found.improved.effects[len(parameters.effects):]]
        undecided = ", one of those that explain the gap" if document["verdict"] == "ambiguous" else ""
        click.echo(f"{output}: the model " + (f"with {', '.join(added)}{undecided}" if added else "unchanged"))
    return document


@command("plot")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", default="rdpi.png", show_default=True, metavar="PICTURE",
              type=click.Path(dir_okay=False), help="The picture, .png, .svg or .pdf.")
def plot(model: str, runs: tuple[str, ...], output: str) -> dict[str, Any]:
    """Draw loops, slopes against rate, the prediction where it is worst, and the residual."""
    from ..data import read_recording
    from ..fit import identify, report
    from ..model import read_model
    from ..simulate import chain, effects

    if Path(output).suffix.lower() not in (".png", ".svg", ".pdf"):
        raise BadInput(f"{output}: write a picture as .png, .svg or .pdf")
    with progress("drawing"):
        parameters = read_model(model)
        effects.acting(parameters, model)  # refuses by the file's name
        recordings = [read_recording(path) for path in runs]
        predictions = chain.simulate(parameters, recordings)
        figure = report.picture(parameters, recordings, predictions, identify.rate_slopes(parameters, recordings))
        report.write_picture(figure, output)
    click.echo(output)
    return {"file": output}
