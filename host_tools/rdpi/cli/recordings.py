"""Commands that make recordings and drives: import, record, excite."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ..errors import BadInput
from .program import command, is_device, printable
from .progress import progress, recording_line
from .types import Number, Numbers, Rows, pairs

_STREAM_CHUNK = 1 << 20  # bytes
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
        metadata = {"source": printable(source), **stretch.metadata, **texts}
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
                if _same_file(file, other) and not is_device(str(other)):
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
        safe = Safe(None if is_device(output) else target, stretches, Following(decoder, *scale),
                    {"source": printable(port), **texts}, copy)
        with safe, recording_line() as report:
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


@command("excite")
@click.argument("kind", type=click.Choice(["commission", "sawtooth", "minor-loops", "steps", "multisine", "sine",
                                           "chirp", "startup"]))
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
