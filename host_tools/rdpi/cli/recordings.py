"""Commands that make recordings and drives: import, record, excite."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ..errors import BadInput, printable
from .program import command, other_outputs
from .progress import progress, recording_line
from .types import Number, Numbers, Output, Rows, pairs

_COLUMN = "COLUMN[:UNIT]"


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
        if text is not None and text != printable(text):
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
                      scale: tuple[float | None, float | None], stretches: bool,
                      max_lost: int | None) -> dict[str, Any]:
    from ..board import how_it_ended, read_stream, write_stream
    from ..data import targets

    files = targets(sources, output, other_outputs(), stretches)
    with progress("importing") as report:  # all of them first, so that a bad source leaves nothing behind
        streams = [read_stream(source, scale, lambda fraction, index=index: report((index + fraction) / len(sources)))
                   for index, source in enumerate(sources)]
    recordings, told = [], []
    for source, stream, file in zip(sources, streams, files):
        written = write_stream(stream, file, Path(source).name, stretches, texts)
        click.echo("\n".join([*written.lines, how_it_ended(stream.decoder)]))
        recordings += written.recordings
        told.append({**written.stream, "gate_failed": _too_many_lost(written.missing, max_lost)})
    return {"recordings": recordings, "streams": told, "gate_failed": any(stream["gate_failed"] for stream in told)}


def _too_many_lost(missing: int, max_lost: int | None) -> bool:
    """Whether the gate of --max-lost failed, which is told."""
    failed = max_lost is not None and missing > max_lost
    if failed:
        click.echo(f"rdpi: {missing} samples are missing, more than the {max_lost} allowed by --max-lost", err=True)
    return failed


@command("import")
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE...", type=click.Path())
@click.option("-o", "--output", required=True, metavar="RUN.csv", type=Output(dir_okay=True),
              help="The recording; for several sources a folder, which gets one NAME.csv per source.")
@click.option("--time", metavar=_COLUMN, help="Time. Units: s (default), ms, us.")
@click.option("--rate", "rate_hz", metavar="HZ", type=click.FloatRange(min=0, min_open=True),
              help="Samples per second. Without --time the times are made from it, from 0 at the first row taken.")
@click.option("--command", metavar=_COLUMN, help="Drive voltage. Units: V (default), mV, kV.")
@click.option("--displacement", metavar=_COLUMN, help="Measured displacement. Units: um (default), m, mm, nm, pm.")
@click.option("--reference", metavar=_COLUMN, help="Displacement that was asked for. Units as --displacement.")
@click.option("--monitor", metavar=_COLUMN, help="Amplifier output as measured. Units as --command.")
@click.option("--temperature", metavar="COLUMN", help="Temperature in degC.")
@click.option("--also", metavar="NAME=COLUMN[:UNIT]", multiple=True, callback=pairs,
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
    from ..data import ROLES, Request, import_recording, make_folder, targets, write_recording

    _check_telemetry_options(click.get_current_context(), telemetry)
    reserved = {role.column: key for key, role in ROLES.items()}
    for name in set(also) & set(reserved):
        raise BadInput(f"--also {name}: this column has its own option, --{reserved[name]}")
    texts = _texts(actuator=actuator, memory=memory, note=note)
    if telemetry:
        return _import_telemetry(sources, output, texts, (um_per_count, count_0_um), stretches, max_lost)
    request = Request(columns={key: spec for key, spec in columns.items() if spec is not None}, also=also,
                      rate_hz=rate_hz, rows=rows, command_gain=command_gain, purpose=purpose, resample_hz=resample_hz,
                      metadata=texts)
    files = targets(sources, output, other_outputs())
    results = []
    with progress("importing") as report:
        imported = []
        for index, source in enumerate(sources):
            imported.append(import_recording(source, request))
            report((index + 0.5) / len(sources))
        # Only now, so that a bad source leaves nothing behind.
        for file, (recording, lines) in zip(files, imported):
            make_folder(file.parent)
            write_recording(file, recording.columns, recording.metadata)
            click.echo("\n".join([*lines, f"  written to {file}"]))
            results.append({"file": str(file), "source": recording.path, "samples": len(recording),
                            "sample_rate_hz": recording.sample_rate_hz, "columns": list(recording.columns),
                            "metadata": recording.metadata})
    return {"recordings": results}


@command("record")
@click.argument("port", metavar="PORT")
@click.option("-o", "--output", required=True, metavar="RUN.csv", type=Output(),
              help="The recording.")
@click.option("--baud", type=click.IntRange(min=1), default=3_000_000, show_default=True, metavar="BAUD",
              help="Bits per second on the line.")
@click.option("--duration", "duration_s", type=Number(positive=True), metavar="S",
              help="Stop after so many seconds of the target's time. Default: when it has finished, or at Ctrl-C.")
@click.option("--timeout", "timeout_s", type=Number(positive=True), default=5.0, show_default=True,
              metavar="S", help="Give up after so many seconds without a frame, once the first has come: that is "
                                "waited for without limit. So many seconds of bytes that are no telemetry, or of infos "
                                "without a sample, end it too.")
@click.option("--raw", type=Output(), metavar="FILE",
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
    from ..board import check_recording_outputs, record_file

    check_recording_outputs(port, output, other_outputs(), stretches)
    texts = _texts(actuator=actuator, memory=memory, note=note)
    with recording_line() as report:
        recorded = record_file(port, output, baud=baud, duration_s=duration_s, timeout_s=timeout_s, raw=raw,
                               every=stretches, scale=(um_per_count, count_0_um), texts=texts, report=report)
    click.echo("\n".join(recorded.written.lines))
    failed = _too_many_lost(recorded.written.missing, max_lost)
    if recorded.failures:
        raise BadInput(f"{port}: {'; '.join(recorded.failures)}")
    click.echo(f"  {recorded.why}")
    return {"recordings": recorded.written.recordings, **recorded.written.stream, "gate_failed": failed,
            "ended": recorded.why}


@command("excite")
@click.argument("kind", type=click.Choice(["commission", "sawtooth", "minor-loops", "steps", "multisine", "sine",
                                           "chirp", "startup"]))
@click.option("-o", "--output", required=True, metavar="DRIVE.csv", type=Output(), help="The drive.")
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
              help="sawtooth, sine: one wave each, default 1,2,5,10,20 Hz. commission: its triangles, default "
                   "1,5,10,20,40 Hz. multisine: its lines, default 16 of 0.5 to "
                   "50 Hz. chirp: first and last, default 1,500 Hz. startup: one, default 20 Hz. "
                   "Defaults are lowered where --slew or --sample-rate demands it.")
@click.option("--rates", "rates_V_per_s", type=Numbers(), metavar="V/S,V/S,...",
              help="sawtooth, commission: rates instead of frequencies, V/s. minor-loops: the pattern at each rate, V/s; "
                   "default: the whole range in 0.5 s.")
@click.option("--cycles", type=int, help="Periods per wave: sawtooth 3, sine 5, startup 20 by default.")
@click.option("--levels", type=int, help="minor-loops: amplitudes, default 6. steps: steps up and down, default 4.")
@click.option("--hold", "hold_s", type=float, metavar="S", help="steps: time on each step, default 5 s.")
@click.option("--duration", "duration_s", type=float, metavar="S",
              help="commission: length, default 60 s. multisine, chirp: length, default 10 s (multisine: longer where "
                   "--slew demands it).")
@click.option("--seed", type=click.IntRange(min=0), help="commission, multisine: picks the random phases, default 0.")
@click.option("--end-V", "end_V", type=float, help="startup: where the sweep ends, V. Default: --rest-V.")
def excite(kind: str, output: str, min_V: float, max_V: float, rest_V: float | None, sample_rate_hz: float,
           slew_V_per_s: float | None, no_sweep: bool, **options: Any) -> dict[str, Any]:
    """Generate a drive that makes the actuator show what a model needs to know.

    \b
    commission   all that a model needs in one recording: growing multisine, sawtooth, steps, hold
    sawtooth     triangular waves at several rates: how slopes depend on rate
    minor-loops  shrinking reversals and loops on both branches: every amplitude
    steps        staircase with holds: creep
    multisine    many frequencies at once, large then small: check a model
    sine         one frequency after another: loops, delay, lag
    chirp        one running frequency: resonance (use a small range)
    startup      decaying oscillation: brings the hysteresis to a known state

    The drive starts and ends at --rest-V and first (but for --no-sweep) brings the hysteresis to a known state by a
    decaying sweep of about one second; `sweep_s` in the file says how long it takes. Same options, same file.

    commission also says what the drive can show and what it cannot, before anything is played: the smallest delay, the
    range of lags, and so on, at a sensor noise of 0.05 % and an operator that misses 0.5 % of the stroke.
    """
    from ..data import Limits, make_drive, shown, write_recording

    limits = Limits(min_V, max_V, rest_V, sample_rate_hz, slew_V_per_s)
    given = {name: value for name, value in options.items() if value is not None}
    with progress("generating"):
        columns, metadata = make_drive(kind, limits, not no_sweep, **given)
        shows = shown(columns, metadata) if kind == "commission" else None
        write_recording(output, columns, metadata)
    voltage = columns["command_V"]
    duration_s = (len(voltage) - 1) / sample_rate_hz
    click.echo(f"{output}: {kind}, {len(voltage)} samples at {sample_rate_hz:g} per second, {duration_s:.6g} s, "
               f"{voltage.min():g} to {voltage.max():g} V, starts at {voltage[0]:g} V and ends at {voltage[-1]:g} V")
    result = {"file": output, "kind": kind, "samples": len(voltage), "duration_s": duration_s,
              "min_V": voltage.min(), "max_V": voltage.max(), "metadata": metadata}
    if shows is None:
        return result
    click.echo("It can show:")
    for one in shows:
        click.echo(f"  {one.what}: {one.text}")
    return result | {"shows": [one.to_json() for one in shows]}
