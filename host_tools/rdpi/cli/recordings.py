"""Commands that make recordings and drives: import, record, excite."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ..errors import BadInput, printable
from .program import command, other_outputs
from .progress import progress
from .types import Number, Numbers, Output, Rows, pairs

_COLUMN = "COLUMN[:UNIT]"
MEMORIES = "reset", "low", "high", "carried", "unknown"


def _telemetry_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """What record and import --telemetry have in common."""
    for option in reversed((
        click.option("--um-per-count", type=Number(), metavar="UM",
                     help="Scale of the displacement sensor, um per count. Default: the firmware's."),
        click.option("--count-0-um", "count_0_um", type=Number(), metavar="UM",
                     help="Displacement at count 0 of the sensor, um. Default: the firmware's."),
        click.option("--stretches", is_flag=True,
                     help="Write every stretch between lost samples: RUN-1.csv, RUN-2.csv, ... Default: write the "
                          "longest stretch to RUN.csv."),
        click.option("--max-lost", type=click.IntRange(min=0), metavar="N",
                     help="Exit with status 1 if more samples than this are missing."),
    )):
        function = option(function)
    return function


def _texts(**texts: str | None) -> dict[str, str]:
    """What the user gave of a recording's metadata; refused before any work if no file could hold it."""
    for name, text in texts.items():
        if text is not None and text != printable(text):
            raise BadInput(f"--{name} {text!r}: is not UTF-8; set a UTF-8 locale, or use letters without accents")
    return {name: text for name, text in texts.items() if text is not None}


def _check_telemetry_options(context: click.Context, telemetry: bool) -> None:
    """Refuse options of import that mean nothing with --telemetry, and those that mean nothing without."""
    common = {"sources", "output", "actuator", "memory", "note", "json_path", "telemetry"}
    only = {"um_per_count", "count_0_um", "stretches", "max_lost", "axis"}
    for parameter in context.command.params:
        given = context.get_parameter_source(parameter.name) is click.core.ParameterSource.COMMANDLINE
        if given and parameter.name not in common and (parameter.name in only) != telemetry:
            raise BadInput(f"{parameter.opts[-1]}: is only valid {'without' if telemetry else 'with'} --telemetry")


def _import_telemetry(sources: tuple[str, ...], output: str, texts: dict[str, str],
                      scale: tuple[float | None, float | None], stretches: bool, max_lost: int | None,
                      axis: int) -> dict[str, Any]:
    from ..board import how_it_ended, read_stream, write_stream
    from ..data import targets

    files = targets(sources, output, other_outputs(), stretches)
    with progress("importing") as report:  # all of them first, so that a bad source leaves nothing behind
        streams = [read_stream(source, scale, lambda fraction, index=index: report((index + fraction) / len(sources)),
                               axis) for index, source in enumerate(sources)]
    recordings, told = [], []
    for source, stream, file in zip(sources, streams, files):
        written = write_stream(stream, file, Path(source).name, stretches, texts)
        click.echo("\n".join([*written.lines, how_it_ended(stream.decoder)]))
        if others := stream.decoder.axes[1:]:
            click.echo(f"note: the file has axis {', '.join(map(str, others))} too, see --axis")
        recordings += written.recordings
        told.append({**written.stream, "gate_failed": _too_many_lost(written.missing, max_lost)})
    return {"recordings": recordings, "streams": told, "gate_failed": any(stream["gate_failed"] for stream in told)}


def _too_many_lost(missing: int, max_lost: int | None) -> bool:
    """Whether the gate of --max-lost failed, which is told."""
    failed = max_lost is not None and missing > max_lost
    if failed:
        click.echo(f"rdpi: {missing} samples are missing, more than the {max_lost} allowed by --max-lost", err=True)
    return failed


def _once(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> str | None:
    """`rdpi record` takes one -o per axis: here the last one would get the axis of the first."""
    if len(values) > 1:
        raise click.BadParameter("give it once; of a stream with several axes, import each by itself, with --axis",
                                 context, parameter)
    return values[0] if values else None


@command("import")
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE...", type=click.Path())
@click.option("-o", "--output", required=True, multiple=True, callback=_once, metavar="RUN.csv",
              type=Output(dir_okay=True),
              help="The recording. For several sources: a directory, which gets one NAME.csv for each source.")
@click.option("--time", metavar=_COLUMN, help="Time. Units: s (default), ms, us, ns.")
@click.option("--rate", "rate_hz", metavar="HZ", type=click.FloatRange(min=0, min_open=True),
              help="Samples per second. Without --time, the command makes the times from it: the first row used is at "
                   "time 0.")
@click.option("--command", metavar=_COLUMN, help="Drive voltage. Units: V (default), mV, kV.")
@click.option("--displacement", metavar=_COLUMN, help="Measured displacement. Units: um (default), m, mm, nm, pm.")
@click.option("--reference", metavar=_COLUMN, help="Commanded displacement. Units as for --displacement.")
@click.option("--monitor", metavar=_COLUMN, help="Measured amplifier output. Units as for --command.")
@click.option("--temperature", metavar="COLUMN", help="Temperature in degC.")
@click.option("--also", metavar="NAME=COLUMN[:UNIT]", multiple=True, callback=pairs,
              help="Keep a further column under this name, e.g. other_axis_V=3:mV. May be given several times.")
@click.option("--rows", metavar="START:STOP", type=Rows(), default=":",
              help="Use only these data rows, counted from 0. STOP is not included. Negative numbers count from the "
                   "end.")
@click.option("--resample", "resample_hz", metavar="HZ", type=Number(positive=True),
              help="Interpolate to a uniform grid of HZ samples per second. Use it if the clock jitters, or if the "
                   "rate is higher than needed. If HZ is below the recorded rate, a low-pass filter comes first; it "
                   "keeps frequencies below 0.4 times HZ. Gaps are an error. The command prints the jitter that it "
                   "found.")
@click.option("--command-gain", metavar="GAIN", type=float, default=1.0,
              help="Multiply the command by this gain, V/V. Use it if the voltage was recorded before an amplifier of "
                   "fixed gain.")
@click.option("--drive", metavar="DRIVE.csv", type=click.Path(dir_okay=False),
              help="The drive that was played, as `rdpi excite` wrote it. The command finds it in the recorded voltage, "
                   "and says delay, clock, gain and offset. The recording then has the drive's samples as command_V, "
                   "starts where its sweep ends, and knows its memory. Give the clock's rate as the file has it; it may "
                   "be off by 1 %.")
@click.option("--at", type=click.Choice(["middle", "switch"]), default="middle", show_default=True,
              help="With --drive: when the columns of a row are read. middle: amid the converter's hold of its sample. "
                   "switch: as the converter switches to it, half a sample of the drive before. Take switch if the "
                   "actuator must follow a reference by the clock of the converter.")
@click.option("--as", "purpose", type=click.Choice(["run", "drive", "reference"]), default="run", show_default=True,
              help="What the file must contain. run: command and displacement. drive: a command. reference: a "
                   "reference.")
@click.option("--actuator", metavar="TEXT", help="Name of the actuator, stored in the recording.")
@click.option("--memory", type=click.Choice(MEMORIES),
              help="What the actuator remembers at the first row used. reset: a decaying sweep ended here. low, high: the "
                   "drive rested at that end of its range. carried: the row follows the previous recording. unknown: none "
                   "of these.")
@click.option("--note", metavar="TEXT", help="Any text, stored in the recording.")
@click.option("--telemetry", is_flag=True,
              help="SOURCE is the bytes that a microcontroller sent, as stored by `rdpi record --raw` or by any "
                   "program that reads a serial port.")
@click.option("--axis", type=click.IntRange(min=0, max=15), default=0, metavar="N",
              help="With --telemetry, of a board with several axes: which one, counted from 0. Default: 0.")
@_telemetry_options
def import_(sources: tuple[str, ...], output: str, rate_hz: float | None, rows: slice, resample_hz: float | None,
            command_gain: float, purpose: str, also: dict[str, str], actuator: str | None, memory: str | None,
            note: str | None, drive: str | None, at: str, telemetry: bool, stretches: bool, max_lost: int | None,
            um_per_count: float | None, count_0_um: float | None, axis: int,
            **columns: str | None) -> dict[str, Any]:
    """Convert files of other formats to recordings.

    SOURCE is one of these:

    \b
    - a table: columns separated by comma, semicolon, tab or white space
    - a file from an oscilloscope or LabVIEW (.lvm), its header included
    - a MATLAB .mat file, up to version 7
    - a NumPy .npy or .npz file

    Tables may have a line of names. COLUMN is a name, or a number counted from 0. UNIT is a unit or a factor:
    `--displacement 4:0.5` multiplies column 4 by 0.5 to get um. The command understands units in names (pos_nm,
    "disp [um]"). Columns with an obvious name need no option. The command prints which column it used for what. In a
    matrix, the longer side is time.

    \b
    rdpi import Model_Vi_Do.dat --command 0 --displacement 4 --rate 200 --rows 400:4400 -o fit.csv
    rdpi import scope.csv --drive drive.csv -o run.csv
    rdpi import scope.csv --time t:ms --command Vin:mV --displacement pos_nm -o run.csv
    rdpi import monday/*.mat -o runs/
    rdpi import --telemetry captured.bin -o run.csv
    """
    from ..data import (ROLES, Request, beside_drive, import_recording, make_folder, read_recording, targets,
                        write_recording)

    _check_telemetry_options(click.get_current_context(), telemetry)
    reserved = {role.column: key for key, role in ROLES.items()}
    for name in set(also) & set(reserved):
        raise BadInput(f"--also {name}: this column has its own option, --{reserved[name]}")
    if drive is not None and (purpose != "run" or resample_hz is not None):
        raise BadInput("--drive: makes a run at the drive's samples; leave out --as and --resample")
    if drive is None and at != "middle":
        raise BadInput(f"--at {at}: is only valid with --drive")
    texts = _texts(actuator=actuator, memory=memory, note=note)
    if telemetry:
        return _import_telemetry(sources, output, texts, (um_per_count, count_0_um), stretches, max_lost,
                                 axis)
    request = Request(columns={key: spec for key, spec in columns.items() if spec is not None}, also=also,
                      rate_hz=rate_hz, rows=rows, command_gain=command_gain, purpose=purpose, resample_hz=resample_hz,
                      metadata=texts)
    files = targets(sources, output, other_outputs())
    results = []
    with progress("importing") as report:
        imported = []
        played = None if drive is None else read_recording(drive, required=("command_V",))
        for index, source in enumerate(sources):
            recording, lines = import_recording(source, request)
            if played is not None:
                if memory is None:  # a file's own is that of its first sample
                    recording.metadata.pop("memory", None)
                recording, found = beside_drive(recording, played, at)
                lines += found
            imported.append((recording, lines))
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
@click.option("-o", "--output", "outputs", required=True, multiple=True, metavar="RUN.csv", type=Output(),
              help="The recording. Of a board with several axes: once for each, in their order.")
@click.option("--baud", type=click.IntRange(min=1), default=3_000_000, show_default=True, metavar="BAUD",
              help="Bits per second on the line.")
@click.option("--duration", "duration_s", type=Number(positive=True), metavar="S",
              help="Stop after this time on the target's clock, s. Default: stop when the target has finished, or at "
                   "Ctrl-C.")
@click.option("--timeout", "timeout_s", type=Number(positive=True), default=5.0, show_default=True,
              metavar="S", help="Stop with an error after this time without a frame, s. The time also applies to bytes "
                                "that are not telemetry, and to info frames without a sample. The wait for the first "
                                "frame has no limit.")
@click.option("--raw", type=Output(), metavar="FILE",
              help="Also store every byte received, for `rdpi import --telemetry`.")
@click.option("--actuator", metavar="TEXT", help="Name of the actuator, stored in the recording.")
@click.option("--memory", type=click.Choice(MEMORIES),
              help="What the actuator remembers at the first sample written. Default: reset if the start-up sweep was "
                   "received completely, ended near the middle of its range, and the drive goes on from there; "
                   "otherwise unknown.")
@click.option("--note", metavar="TEXT", help="Any text, stored in the recording.")
@click.option("--window", is_flag=True,
              help="Show reference, reading, error and drive also in a window. It needs a display and a library for "
                   "windows that Matplotlib knows, such as Debian's python3-tk.")
@_telemetry_options
def record_(port: str, outputs: tuple[str, ...], baud: int, duration_s: float | None, timeout_s: float, raw: str | None, window: bool,
            actuator: str | None, memory: str | None, note: str | None, stretches: bool, max_lost: int | None,
            um_per_count: float | None, count_0_um: float | None) -> dict[str, Any]:
    """Record a microcontroller's telemetry from a serial port.

    PORT is a device (/dev/ttyACM0, an emulator's pseudo-terminal) or a URL that pyserial knows
    (socket://localhost:1234).

    \b
    1. Start this command.
    2. Flash or reset the board. Samples that the board sent before step 1 are lost.

    A terminal shows the latest five seconds while they come: reference, reading, error, drive, and what is lost.

    A board with several axes is recorded to as many files. Each holds the drive of the other axis too, in the column
    other_axis_V; of more than two axes, in axis_0_V, axis_1_V, ...

    The recording does not contain the start-up sweep. If the target plays a drive without a reference, it contains the
    last sample of the sweep. A recording never spans a gap. The file's metadata count the lost samples and the corrupt
    frames.

    RUN.csv is written when the recording ends. Until then, RUN.csv.part holds all samples that are older than a second.
    After a gap, a new file follows: RUN.csv.part2 and so on. The longest and the latest of these files are kept; with
    --stretches, all. They are removed when RUN.csv has been written. After a crash or a power failure, each of them is
    a valid recording: a reader ignores a last line that is incomplete.
    """
    from ..board import check_recording_outputs, record_file
    from .view import recording_view

    check_recording_outputs(port, outputs, other_outputs(), stretches)
    texts = _texts(actuator=actuator, memory=memory, note=note)
    with recording_view(um_per_count, count_0_um, window) as report:
        recorded = record_file(port, outputs, baud=baud, duration_s=duration_s, timeout_s=timeout_s, raw=raw,
                               every=stretches, scale=(um_per_count, count_0_um), texts=texts, report=report)
    for written in recorded.written:
        click.echo("\n".join(written.lines))
    failed = _too_many_lost(max(written.missing for written in recorded.written), max_lost)
    if recorded.failures:
        raise BadInput(f"{port}: {'; '.join(recorded.failures)}")
    click.echo(f"  {recorded.why}")
    first, *further = recorded.written
    return {"recordings": [one for written in recorded.written for one in written.recordings], **first.stream,
            "further_axes": [written.stream for written in further], "gate_failed": failed, "ended": recorded.why}


@command("excite")
@click.argument("kind", type=click.Choice(["commission", "sawtooth", "minor-loops", "steps", "multisine", "sine", "chirp",
                                           "startup"]))
@click.option("-o", "--output", required=True, metavar="DRIVE.csv", type=Output(), help="The drive.")
@click.option("--min-V", "min_V", type=float, default=0.0, show_default=True, help="Lowest voltage, V.")
@click.option("--max-V", "max_V", type=float, default=10.0, show_default=True, help="Highest voltage, V.")
@click.option("--rest-V", "rest_V", type=float,
              help="Voltage at which the drive starts and ends, V. Default: the middle of the range, where a sweep "
                   "decays from both sides. A sweep that ends near an edge does not reset the hysteresis: its memory "
                   "is unknown.")
@click.option("--sample-rate", "sample_rate_hz", type=float, default=10_000.0, show_default=True, metavar="HZ",
              help="Samples per second.")
@click.option("--slew", "slew_V_per_s", type=float, metavar="V/S",
              help="Largest rate of change of the drive, V/s.")
@click.option("--no-sweep", is_flag=True, help="Leave out the decaying sweep at the start.")
@click.option("--sweep-V", "sweep_V", type=Numbers(), metavar="LOW,HIGH",
              help="Ends of that sweep, V. Default: those of the drive. If the drive has a part of the actuator's range, "
                   "give the whole range: a smaller sweep leaves what larger moves left.")
@click.option("--frequencies", "frequencies_hz", type=Numbers(), metavar="HZ,HZ,...",
              help="sawtooth, sine: one wave at each, default 1,2,5,10,20 Hz. commission: its triangles, default "
                   "1,5,10,20,40 Hz. multisine: its lines, default about 16 from 0.5 to 50 Hz, of whole periods. "
                   "chirp: first and last frequency, default 1,500 Hz. startup: one frequency, default 20 Hz. Defaults "
                   "are lower if --slew or --sample-rate requires it.")
@click.option("--rates", "rates_V_per_s", type=Numbers(), metavar="V/S,V/S,...",
              help="sawtooth, commission: rates instead of frequencies, V/s. minor-loops: rates at which the "
                   "pattern is repeated, V/s; default: the rate that crosses the whole range in 0.5 s. steps: one rate, "
                   "that of the edges; default: that of commission's edges, 100 ranges per second or less.")
@click.option("--cycles", type=int, help="Periods per wave. Default: sawtooth 3, sine 5, startup 20.")
@click.option("--levels", type=int, help="minor-loops: number of amplitudes, default 6. steps: number of steps up and "
                                         "down, default 4.")
@click.option("--hold", "hold_s", type=float, metavar="S", help="steps: duration of each step, default 5 s.")
@click.option("--duration", "duration_s", type=float, metavar="S",
              help="commission: duration, default 60 s. multisine, chirp: duration, default 10 s. multisine takes "
                   "longer if --slew requires it.")
@click.option("--seed", type=click.IntRange(min=0), help="commission, multisine: seed of the random phases, default 0.")
@click.option("--end-V", "end_V", type=float, help="startup: voltage at which the sweep ends, V. Default: --rest-V.")
def excite(kind: str, output: str, min_V: float, max_V: float, rest_V: float | None, sample_rate_hz: float,
           slew_V_per_s: float | None, no_sweep: bool, sweep_V: tuple[float, ...] | None, **options: Any) -> dict[str, Any]:
    """Generate a drive signal for identification.

    \b
    commission   all that a model needs in one recording: growing multisine, sawtooth, steps, hold
    sawtooth     triangular waves at several rates: shows how slopes depend on rate
    minor-loops  shrinking reversals and loops on both branches: shows every amplitude
    steps        staircase with holds: shows creep
    multisine    many frequencies at once, large then small: checks a model
    sine         one frequency after another: shows loops, delay and lag
    chirp        a frequency that changes continuously: shows resonance (use a small range)
    startup      decaying oscillation: brings the hysteresis to a known state

    The drive starts at --rest-V. Every drive but startup begins with a decaying sweep of about one second, which brings
    the hysteresis to a known state, and ends at --rest-V. --no-sweep leaves the sweep out. The metadata `sweep_s` is
    the duration of the sweep. startup is that sweep alone; it ends at --end-V. The same options give the same file.

    For commission, the command prints which effects the drive shows, and from which size on. It computes this from the
    drive, for a usual sensor. A smaller effect needs a longer drive, a faster one or a better sensor.
    """
    from ..data import Limits, make_drive, write_recording
    from ..simulate import ASSUMED, shown

    if sweep_V is not None and len(sweep_V) != 2:
        raise BadInput(f"--sweep-V has {len(sweep_V)} values; give two, the lowest and the highest voltage of the sweep")
    if no_sweep and kind == "startup":
        raise BadInput("--no-sweep: startup is the sweep itself; leave the option out")
    limits = Limits(min_V, max_V, rest_V, sample_rate_hz, slew_V_per_s, sweep_V)
    given = {name: value for name, value in options.items() if value is not None}
    with progress("generating"):
        columns, metadata = make_drive(kind, limits, not no_sweep, **given)
        shows = shown(columns, metadata) if kind == "commission" else {}
        write_recording(output, columns, metadata)
    voltage = columns["command_V"]
    duration_s = (len(voltage) - 1) / sample_rate_hz
    ends_hz = f" from {' to '.join(metadata['frequencies_hz'].split())} Hz" if kind == "chirp" else ""
    click.echo(f"{output}: {kind}{ends_hz}, {len(voltage)} samples at {sample_rate_hz:g} per second, {duration_s:.6g} s, "
               f"{voltage.min():g} to {voltage.max():g} V, starts at {voltage[0]:g} V and ends at {voltage[-1]:g} V")
    for title, is_shown in ((f"It shows, if {ASSUMED}:", True), ("It does not show:", False)):
        lines = [f"  {what}: {one.text}" for what, one in shows.items() if (one.low is not None) == is_shown]
        click.echo("\n".join([title, *lines]) if lines else "", nl=bool(lines))
    return {"file": output, "kind": kind, "samples": len(voltage), "duration_s": duration_s,
            "min_V": voltage.min(), "max_V": voltage.max(), "metadata": metadata,
            "shows": [{"what": what, **one._asdict()} for what, one in shows.items()]}
