"""Telemetry to recordings on disk: of a stream that was stored, and live from a serial port."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from ..data import (MIN_SAMPLES, check_targets, is_device, make_folder, read_bytes, reserved, same_file,
                    write_recording)
from ..errors import BadInput, printable
from .serial import End, Raw, Safe, is_part, record, refusal, stop_signals
from .stretches import Following, Stretch, notes, stretches
from .telemetry import FINISHED, NO_READING, REFUSED, Decoder, displacement_um, summary

STREAM_CHUNK = 1 << 20  # bytes
Scale = tuple[float | None, float | None]  # um per count of the sensor and um at count 0; None: as the firmware says


class Stream(NamedTuple):
    """A telemetry stream that has ended, and its stretches without a gap; at least one."""

    decoder: Decoder
    stretches: list[Stretch]


@dataclass(frozen=True)
class Written:
    """The recordings written of a stream."""

    recordings: list[dict[str, Any]]  # of each: file, source, samples, sample_rate_hz, columns, metadata
    stream: dict[str, Any]  # what the whole stream holds: source, counts, stretches, finished, target
    missing: int  # samples of which nothing is known
    lines: list[str]  # the same for people


class Recorded(NamedTuple):
    """What a recording from a port came to."""

    written: list[Written]  # of each axis
    why: str  # it ended
    failures: list[str]  # what kept it, or the copy of its bytes, from being whole


def read_stream(path: str, scale: Scale = (None, None),
                report: Callable[[float], None] = lambda fraction: None, axis: int = 0) -> Stream:
    """Decode one axis of a stored stream. `report` is called with the fraction done, 0 to 1.

    Raises BadInput for a file that cannot be read, that holds no telemetry, none of this axis, or no stretch of
    MIN_SAMPLES samples.
    """
    data = read_bytes(path)

    def decoded(axis: int, done: float, part: float) -> Decoder:
        decoder = Decoder(path, axis)
        for start in range(0, len(data), STREAM_CHUNK):
            decoder.feed(data[start:start + STREAM_CHUNK])
            report(done + part * start / len(data))
        return decoder

    decoder = decoded(axis, 0.0, 0.5)
    decoder.finish()
    others = [decoded(other, 0.5, 0.5) for other in decoder.axes[1:]]
    return Stream(decoder, usable_stretches(decoder, scale, others))


def usable_stretches(decoder: Decoder, scale: Scale = (None, None), others: Sequence[Decoder] = ()) -> list[Stretch]:
    """The stretches of what has been decoded; `others` heard the other axes of the same stream.

    Raises BadInput, which says why, if there is none.
    """
    found = stretches(decoder, *scale, others)
    if not found:
        if decoder.info is not None and decoder.info.state >= REFUSED:
            raise BadInput(f"{decoder.where}: {how_it_ended(decoder)}")
        raise BadInput(f"{decoder.where}: {summary(decoder.counts)}: no {MIN_SAMPLES} samples "
                       "without a gap after the start-up sweep; record for longer, or check the line")
    return found


def how_it_ended(decoder: Decoder) -> str:
    """What the end of a stream says about its target, in words."""
    if decoder.runs[-1].finished:
        return "the target had finished"
    if decoder.info is not None and decoder.info.state >= REFUSED:
        return f"the target refuses to run: {refusal(decoder.info)}"
    return "note: the stream ends before the target had finished"


def how_it_goes(decoder: Decoder) -> str:
    """How a recording goes on, in a line."""
    latest, info, counts = decoder.latest, decoder.info, decoder.counts
    if not counts.samples:
        over = info is not None and info.state == FINISHED
        return f"waiting for {'a reset: the target had finished before' if over else 'the first frame'}; Ctrl-C stops"
    at = ""
    if info is not None and latest is not None and latest["adc_counts"] != NO_READING:
        at = f", {displacement_um(info, latest['adc_counts']):.4g} um"
    return f"{counts.samples} samples, {counts.missing} lost{at}; Ctrl-C stops"


def write_stream(stream: Stream, target: Path, source: str, every: bool = False,
                 texts: Mapping[str, str] = MappingProxyType({})) -> Written:
    """Write the longest stretch of a stream to `target`, or with `every` all of them, numbered: RUN-1.csv, RUN-2.csv.

    `source` and `texts`, which may replace `memory`, go to the metadata. Raises OSError, which names the file.
    Nothing is printed here: a terminal that is gone must not cost the recording.
    """
    decoder, found = stream
    files = [(target.with_stem(f"{target.stem}-{number}"), stretch) for number, stretch in enumerate(found, 1)]
    if not every:
        files = [(target, max(found, key=lambda stretch: stretch.samples))]
    lines = [f"{decoder.where}: {summary(decoder.counts)}",
             *(f"note: {note}" for note in notes(decoder, found, [stretch for _, stretch in files]))]
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
    whole = {"source": decoder.where, "counts": asdict(decoder.counts),
             "stretches": [stretch.samples for stretch in found], "finished": decoder.runs[-1].finished,
             "target": decoder.info_of(decoder.runs[-1])._asdict()}
    return Written(recordings, whole, decoder.counts.missing, lines)


def check_recording_outputs(port: str, outputs: Sequence[str], others: Sequence[str] = (), every: bool = False) -> None:
    """Raise BadInput unless a recording from `port` to `outputs`, one for each axis, leaves the port, each other and the
    `others` alone.

    The others are files that are written too: RUN.csv.part belongs to the recording while it goes on.
    """
    for name in (*outputs, *others):
        if same_file(name, port):
            raise BadInput(f"{name}: is the port; give a file name")
    for number, output in enumerate(outputs):
        check_targets([Path(output)], (), [*others, *outputs[:number], *outputs[number + 1:]], every)
    for target in map(os.path.realpath, outputs):
        for name in (*outputs, *others):
            if is_part(Path(os.path.realpath(name)), Path(target)):
                raise BadInput(f"{name}: is used for samples during the recording; give another name")


def record_file(port: str, outputs: Sequence[str], *, baud: int = 3_000_000, duration_s: float | None = None,
                timeout_s: float = 5.0, raw: str | None = None, every: bool = False, scale: Scale = (None, None),
                texts: Mapping[str, str] = MappingProxyType({}),
                report: Callable[[Decoder], None] = lambda decoder: None) -> Recorded:
    """Record a port's telemetry until the target has finished, `duration_s` of its time have passed, or Ctrl-C.

    `outputs` are the recordings of the board's axes, in order; `every` and `texts` are those of write_stream; `raw` gets
    every byte as it came. While the recording goes on the samples are in files beside the outputs, see Safe. `report` is
    called several times a second, with the first axis.

    Raises BadInput as `record` does, and when there are no samples to write; names the files that hold the samples
    when an output cannot be written.
    """
    decoders, copy = [Decoder(port, axis) for axis in range(len(outputs))], Raw(raw)
    with ExitStack() as stack:  # until all is written
        stopped = stack.enter_context(stop_signals())
        for name in (*outputs, raw):
            stack.enter_context(reserved(name))
        safes = [Safe(None if is_device(output) else Path(os.path.realpath(output)), every, Following(decoder, *scale),
                      {"source": printable(port), **texts}, Raw(None) if decoder.axis else copy)
                 for output, decoder in zip(outputs, decoders)]
        with ExitStack() as saving:
            for safe in safes:
                saving.enter_context(safe)
            end = record(decoders, baud, duration_s, timeout_s, safes, report, stopped)
        copied = [f"--raw {copy.failure}"] if copy.failure else []
        written, failures = [], []
        where = " and ".join(safe.where for safe in safes if safe.where)
        try:
            streams = [_ended(decoder, end, scale, copied, [one for one in decoders if one is not decoder])
                       for decoder in decoders]
        except BadInput as error:  # of one axis; the others may have samples
            raise BadInput(f"{error}; the samples are in {where}") if where else error from None
        for (stream, why), output in zip(streams, outputs):
            failures += [f"{why}; the samples before that have been written"] if why else []
            try:
                written.append(write_stream(stream, Path(output), port, every, texts))
            except OSError as error:
                if not where:
                    raise
                raise BadInput(f"{error.filename}: {error.strerror or error}; the samples are in {where}") from None
        for safe in safes:
            safe.remove()
    if left := [axis for axis in decoders[0].axes if axis >= len(outputs)]:
        written[0].lines.append(f"note: the target has axis {', '.join(map(str, left))} too; to record all axes give -o "
                                "once for each")
    return Recorded(written, end.why, list(dict.fromkeys(failures)) + copied)


def _ended(decoder: Decoder, end: End, scale: Scale, copied: list[str], others: Sequence[Decoder]
           ) -> tuple[Stream, str]:
    """What can be written, and what went wrong all the same, or "".

    Raises BadInput where there is nothing to write; `copied`, what kept the copy from being whole, is told with it.
    """
    port, why = decoder.where, "" if end.good else end.why
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
        return Stream(decoder, usable_stretches(decoder, scale, others)), why
    except BadInput as error:
        besides = [why] if why not in str(error) else []
        raise BadInput("; ".join([str(error), *besides, *copied])) from None
