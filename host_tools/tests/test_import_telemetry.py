"""`rdpi import --telemetry` as a user types it: a captured stream becomes recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import streams
from captures import SENT, WITHOUT_A_FEW, codes
from ports import Board
from streams import Info, stream

from rdpi import firmware
from rdpi.data import read_recording


def test_the_longest_stretch_of_a_captured_stream(captured: Path, run_csv: Path, rdpi: Callable,
                                                  tmp_path: Path) -> None:
    done = rdpi("import", "--telemetry", captured, "-o", run_csv, "--json", tmp_path / "json")
    assert done.exit_code == 0, done.output
    assert "2997 samples, 3 lost on the way" in done.output
    assert codes(run_csv) == [sample.dac_code for sample in SENT[1801:]]
    assert read_recording(run_csv).metadata.items() >= {"source": "captured.bin", "telemetry_lost": "3"}.items()
    assert done.output.endswith("\nthe target had finished\n")
    assert "note: the longest stretch without a gap has 1199 of the 2997 samples received; --stretches writes all 3\n" \
        in done.output
    result = json.loads((tmp_path / "json").read_text())
    assert result["streams"][0]["counts"]["lost"] == 3 and result["streams"][0]["stretches"] == [1000, 798, 1199]
    assert [row["samples"] for row in result["recordings"]] == [1199]


def test_every_stretch_of_it(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    done = rdpi("import", "--telemetry", captured, "-o", run_csv, "--stretches")
    assert done.exit_code == 0 and not run_csv.exists() and "note: the longest" not in done.output
    parts = [codes(run_csv.with_stem(f"run-{k}")) for k in (1, 2, 3)]
    assert [len(part) for part in parts] == [1000, 798, 1199]
    assert sum(parts, []) == [sample.dac_code for sample in WITHOUT_A_FEW]


@pytest.mark.parametrize("most, status", [(3, 0), (2, 1)])
def test_the_gate(captured: Path, run_csv: Path, rdpi: Callable, most: int, status: int) -> None:
    done = rdpi("import", "--telemetry", captured, "-o", run_csv, "--max-lost", most)
    assert done.exit_code == status and run_csv.exists()
    assert ("3 samples are missing, more than the 2 allowed by --max-lost" in done.output) == (status == 1)


def test_several_streams_to_a_folder(captured: Path, rdpi: Callable, tmp_path: Path) -> None:
    other = tmp_path / "other.bin"
    other.write_bytes(stream(SENT[:500]))
    done = rdpi("import", "--telemetry", captured, other, "-o", f"{tmp_path}/runs/")
    assert done.exit_code == 0, done.output
    assert len(codes(tmp_path / "runs/captured.csv")) == 1199 and len(codes(tmp_path / "runs/other.csv")) == 500


def test_another_sensor(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    assert rdpi("import", "--telemetry", captured, "-o", run_csv, "--um-per-count", "-0.5", "--count-0-um",
                "7").exit_code == 0
    assert read_recording(run_csv).displacement_um.tolist() == [7 - 0.5 * s.adc_counts for s in SENT[1801:]]


@pytest.mark.parametrize("data, message", [
    (b"", "no telemetry frame in 0 bytes; nothing was sent"),
    (b"abc" * 100, "no telemetry frame in 300 bytes; is the baud rate right?"),
    (stream(SENT[:15]), "15 samples, 0 lost on the way, 0 ticks lost by the target; 0 corrupt frames: no 16 samples w"),
    (Info().frame(), "0 samples, 0 lost on the way, 0 ticks lost by the target; 0 corrupt frames: no 16 samples w"),
    (Info(streams.REFUSED, -8).frame(), f"the target refuses to run: {firmware.status_text(-8)} (status -8)"),
    (stream(SENT)[len(Info().frame()):20_000], "samples, but no info frame"),
])
def test_streams_without_a_recording(captured: Path, refused: Callable, data: bytes, message: str) -> None:
    captured.write_bytes(data)
    assert refused("import", "--telemetry", captured, "-o", refused.output).startswith(f"{captured}: {message}")


def test_a_bad_stream_among_good_ones_leaves_nothing(captured: Path, tmp_path: Path, rdpi: Callable) -> None:
    (tmp_path / "bad.bin").write_bytes(stream(SENT[:5]))
    assert rdpi("import", "--telemetry", captured, tmp_path / "bad.bin", "-o", f"{tmp_path}/runs/").exit_code == 2
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("words, message", [
    (["--telemetry", "--rate", "5"], "--rate: has a meaning only without --telemetry"),
    (["--telemetry", "--command", "1"], "--command: has a meaning only without --telemetry"),
    (["--stretches"], "--stretches: has a meaning only with --telemetry"),
    (["--um-per-count", "1"], "--um-per-count: has a meaning only with --telemetry"),
])
def test_options_of_the_other_kind(captured: Path, refused: Callable, words: list[str], message: str) -> None:
    assert refused("import", captured, "-o", refused.output, *words) == message


@pytest.mark.parametrize("name", ["run-1.csv", "run-12.csv"])
def test_stretches_are_not_written_over_what_is_read(captured: Path, rdpi: Callable, tmp_path: Path,
                                                     name: str) -> None:
    source = captured.rename(tmp_path / name)
    as_it_was = source.read_bytes()
    done = rdpi("import", "--telemetry", source, "-o", tmp_path / "run.csv", "--stretches")
    assert (done.exit_code, done.output) == (
        2, f"rdpi: {source}: would be written over an input; give another name or folder\n")
    link = tmp_path / "other-1.csv"
    link.symlink_to(source)
    done = rdpi("import", "--telemetry", source, "-o", tmp_path / "other.csv", "--stretches")
    assert done.exit_code == 2 and f"{link}: would be written over an input" in done.output
    assert source.read_bytes() == as_it_was


def test_nor_over_what_else_is_written(captured: Path, board: Board, rdpi: Callable, tmp_path: Path) -> None:
    for words in (["import", "--telemetry", captured, "-o", tmp_path / "run.csv", "--stretches", "--json"],
                  ["record", board.port, "-o", tmp_path / "run.csv", "--stretches", "--raw"]):
        done = rdpi(*words, tmp_path / "run-1.csv")
        assert done.exit_code == 2 and "run-1.csv: would be written over another output" in done.output
    (tmp_path / "runs").mkdir()
    done = rdpi("import", "--telemetry", captured, "-o", tmp_path / "runs", "--json", tmp_path / "runs/captured.csv")
    assert done.exit_code == 2 and "captured.csv: would be written over another output" in done.output
    assert not list((tmp_path / "runs").iterdir())


def test_the_raw_stream_is_not_written_over_the_recording(refused: Callable) -> None:
    message = refused("record", "/dev/null", "-o", refused.output, "--raw", refused.output)
    assert "another output" in message


def test_the_target_told_what_it_did_not_send(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    captured.write_bytes(stream(WITHOUT_A_FEW, Info(counts=(3, *[0] * 8))))
    done = rdpi("import", "--telemetry", captured, "-o", run_csv)
    assert "note: 3 samples never left the target: its line is too slow" in done.output


@pytest.mark.parametrize("sent, note", [
    (stream(SENT), None),
    (stream(SENT, finished=0), "note: the stream ends before the target had finished"),
    (stream(SENT, finished=0) + Info(streams.REFUSED).frame(), "the target refuses to run: the board has no timer for"),
])
def test_how_a_stream_ended(captured: Path, run_csv: Path, rdpi: Callable, sent: bytes, note: str | None) -> None:
    captured.write_bytes(sent)
    done = rdpi("import", "--telemetry", captured, "-o", run_csv)
    assert done.exit_code == 0 and len(codes(run_csv)) == 3000
    assert ("the target had finished\n" in done.output) == (note is None or note.startswith("note"))
    assert note is None or f"\n{note}" in done.output


def test_why_the_memory_is_unknown(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    sent = [replace(sample, flags=streams.SWEEP, dac_code=0) if sample.sequence < 30 else
            replace(sample, dac_code=40_000) for sample in SENT]
    captured.write_bytes(stream(sent))
    done = rdpi("import", "--telemetry", captured, "-o", run_csv)
    assert "memory: unknown (the drive jumps at the sweep's end)\n" in done.output
    done = rdpi("import", "--telemetry", captured, "-o", run_csv, "--memory", "carried")
    assert "memory: carried\n" in done.output


def test_samples_without_readings(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    captured.write_bytes(stream([replace(sample, adc_counts=streams.NO_READING) for sample in SENT]))
    done = rdpi("import", "--telemetry", captured, "-o", run_csv)
    assert done.exit_code == 0 and "note: no displacement_um" in done.output
    assert read_recording(run_csv, ("command_V",)).displacement_um is None
