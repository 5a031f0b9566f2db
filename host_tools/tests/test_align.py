"""`rdpi import --drive`: a scope file beside the drive that was played."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rdpi.data import Limits, Recording, make_drive, read_recording, sample_times, write_recording
from rdpi.data.align import LEAST_ALIKE, MAX_CLOCK, Alignment, align, beside_drive
from rdpi.errors import BadInput

KINDS = (("sawtooth", {"cycles": 1}), ("multisine", {"duration_s": 4.0}), ("sine", {"cycles": 2}),
         ("steps", {"hold_s": 0.4}), ("minor-loops", {"levels": 3}))


def drive_of(kind: str = "sawtooth", rate_hz: float = 2000.0, sweep: bool = True, **options: object) -> Recording:
    columns, metadata = make_drive(kind, Limits(0.0, 100.0, sample_rate_hz=rate_hz), sweep, **options)
    return Recording("drive.csv", metadata, columns, "sha256:0")


def scope(drive: Recording, rate_hz: float, start_s: float, *, clock: float = 1.0, gain: float = 1.0,
          offset_V: float = 0.0, noise: float = 0.0, before_s: float = 0.5, after_s: float = 0.5, held: bool = True,
          seed: int = 1) -> Recording:
    """What a scope records of a drive that is `start_s` late: gain and offset of its voltage, noise as a share of its
    rms, a clock that counts `clock` seconds per second. The displacement is 0.1 um/V of the voltage at the actuator.
    """
    lasts_s = clock * (len(drive) - 1) / drive.sample_rate_hz
    time_s = np.arange(0, before_s + lasts_s + after_s, 1 / rate_hz)
    at = (time_s - start_s) / clock * drive.sample_rate_hz
    if held:  # a sample is taken at the middle of its hold
        volts = drive.command_V[np.clip(np.floor(at + 0.5).astype(int), 0, len(drive) - 1)]
    else:
        volts = np.interp(at, np.arange(len(drive)), drive.command_V)
    random = np.random.default_rng(seed)
    heard = gain * volts + offset_V + abs(gain) * noise * np.std(drive.command_V) * random.standard_normal(len(volts))
    return Recording("scope.csv", {}, {"time_s": time_s, "command_V": heard, "displacement_um": 0.1 * volts})


def off_by(found: Alignment, drive: Recording, start_s: float, clock: float, first: int = 0) -> float:
    """Largest error of the place, from sample `first` of the drive on, in samples of the drive."""
    ends = [found.start_s - start_s + k / drive.sample_rate_hz * (found.clock - clock)
            for k in (first, len(drive) - 1)]
    return float(np.max(np.abs(ends))) * drive.sample_rate_hz


# ---- the place ----

@pytest.mark.parametrize("seed", range(20))
def test_within_half_a_sample(seed: int) -> None:
    """Trigger, clock, gain, noise, rate and kind of drive by chance."""
    random = np.random.default_rng(100 + seed)
    kind, options = KINDS[seed % len(KINDS)]
    drive = drive_of(kind, rate_hz=float(random.choice([1000, 2000, 5000])), **options)
    start_s, clock = float(random.uniform(0, 1)), 1 + float(random.uniform(-1, 1)) * random.choice([1e-5, 1e-4, 5e-3])
    gain, offset_V = float(random.choice([1, -1, 0.1, -0.05, 10])), float(random.normal())
    rate_hz = drive.sample_rate_hz * float(random.choice([2.5, 5, 8]))
    run = scope(drive, rate_hz, start_s, clock=clock, gain=gain, offset_V=offset_V, noise=random.choice([0, 0.003, 0.01]),
                before_s=start_s, held=bool(seed % 2), seed=seed)
    found = align(run, drive)
    assert off_by(found, drive, start_s, clock) < 0.5
    assert found.gain == pytest.approx(gain, rel=0.02)
    assert found.offset_V == pytest.approx(offset_V, abs=0.02 * abs(gain) * 100)
    assert found.clock == pytest.approx(clock, abs=2e-4)


@pytest.mark.slow
def test_a_hundred_files() -> None:
    """Each aligned within half a sample or refused; none refused with little noise and a scope twice as fast."""
    aligned = 0
    for seed in range(2000, 2100):
        random = np.random.default_rng(seed)
        kind, options = (*KINDS, ("commission", {"duration_s": 20.0}))[random.integers(6)]
        drive = drive_of(kind, float(random.choice([1000, 2000, 5000, 10000])), bool(random.random() < 0.8), **options)
        start_s, noise = float(random.uniform(0, 1)), float(random.choice([0, 0.003, 0.01, 0.1, 0.3]))
        off = float(np.clip(random.normal() * random.choice([0, 1e-4, 3e-3]), -0.009, 0.009))
        faster = float(random.choice([0.3, 0.5, 1, 1.37, 2.5, 5]))
        run = scope(drive, faster * drive.sample_rate_hz, start_s, clock=1 + off, noise=noise, before_s=start_s,
                    gain=float(random.choice([1, -1, 0.1, -0.05, 10])), offset_V=float(random.normal()),
                    held=bool(random.random() < 0.7), seed=seed)
        first = round(float(drive.metadata.get("sweep_s", 0)) * drive.sample_rate_hz)
        try:
            found = align(run, drive, first)
        except BadInput as refused:
            assert "is found, but only to" in str(refused) and (noise >= 0.1 or faster < 2), seed
            continue
        aligned += 1
        assert off_by(found, drive, start_s, 1 + off, first) < 0.5, seed
    assert aligned > 50


def test_noise_shows_in_the_doubt() -> None:
    drive = drive_of()
    doubts = [align(scope(drive, 2000.0, 0.3, noise=noise), drive).doubt_s for noise in (0.01, 0.1)]
    assert 0 < doubts[0] < doubts[1]


def test_a_file_that_begins_within_the_sweep() -> None:
    """Only what follows the sweep is needed."""
    drive = drive_of()
    run = scope(drive, 4000.0, -0.6)
    recording, lines = beside_drive(run, drive)
    assert recording.memory == "reset" and "before the first one used" in lines[0]
    sweep = round(float(drive.metadata["sweep_s"]) * 2000)
    np.testing.assert_array_equal(recording.command_V, drive.command_V[sweep:])


# ---- the recording ----

def test_the_recording_has_the_samples_of_the_drive() -> None:
    drive = drive_of("multisine", duration_s=4.0)
    run = scope(drive, 9000.0, 0.7, clock=1.0005, gain=-0.05, offset_V=0.4, noise=0.01, held=False)
    recording, lines = beside_drive(run, drive)
    sweep = round(float(drive.metadata["sweep_s"]) * 2000)
    np.testing.assert_array_equal(recording.command_V, drive.command_V[sweep:])
    np.testing.assert_array_equal(recording.time_s, sample_times(len(drive) - sweep, 2000.0))
    assert recording.sample_rate_hz == 2000 and recording.memory == "reset"
    inside = slice(50, -50)
    np.testing.assert_allclose(recording.displacement_um[inside], 0.1 * recording.command_V[inside], atol=0.02)
    text = " ".join(lines)
    assert "inverted" in text and "ppm" in text and f"= {float(recording.metadata['played_gain']):.6g} x drive" in text
    assert float(recording.metadata["played_clock"]) == pytest.approx(1.0005, abs=1e-5)
    assert float(recording.metadata["played_from_s"]) == pytest.approx(0.7, abs=0.5 / 2000)


@pytest.mark.parametrize(("changes", "memory"), [
    ({}, "reset"), ({"rest_V": "5"}, "unknown"), ({"sweep_s": None}, "unknown"), ({"max_V": None}, "unknown"),
    ({"max_V": "many"}, "unknown")])
def test_memory(changes: dict, memory: str) -> None:
    drive = drive_of()
    metadata = {key: value for key, value in {**drive.metadata, **changes}.items() if value is not None}
    recording, _ = beside_drive(scope(drive, 2000.0, 0.5), Recording("drive.csv", metadata, drive.columns))
    assert recording.memory == memory
    assert (len(recording) < len(drive)) == ("sweep_s" in metadata)


# ---- what is refused ----

WRONG = {
    "another seed": (lambda drive: scope(drive_of("multisine", duration_s=4.0, seed=9), 2000.0, 0.5), "is not found"),
    "another kind": (lambda drive: scope(drive_of("sine", cycles=3), 2000.0, 0.5), "is not found|ends|lasts"),
    "noise": (lambda drive: scope(drive, 2000.0, 0.5, noise=0.8), "is not found"),
    "too short": (lambda drive: scope(drive, 2000.0, 0.0, before_s=0, after_s=-3.0), "lasts .* but the drive"),
    "its end is missing": (lambda drive: scope(drive, 2000.0, 1.5, before_s=1.5, after_s=-1.0), "is not found|ends"),
    "begins after the sweep": (lambda drive: scope(drive, 2000.0, -1.8, after_s=1.0), "is not found|begins"),
    "constant": (lambda drive: scope(drive, 2000.0, 0.5, gain=0.0), "constant"),
}


@pytest.mark.parametrize("what", WRONG)
def test_refused(what: str) -> None:
    drive = drive_of("multisine", duration_s=4.0)
    make, words = WRONG[what]
    with pytest.raises(BadInput, match=words) as told:
        beside_drive(make(drive), drive)
    assert str(told.value).startswith("scope.csv: ")


def test_too_much_noise_for_a_slow_drive() -> None:
    drive = drive_of(rate_hz=2000.0, sweep=False, frequencies_hz=(0.2,), cycles=1)
    with pytest.raises(BadInput, match="only to .* of its samples"):
        align(scope(drive, 2000.0, 0.5, noise=0.05), drive)


@pytest.mark.parametrize(("sweep_s", "command_V", "words"), [
    ("900", None, "sweep_s is 900"), ("0", None, "sweep_s is 0"), (None, 50.0, "does not move")])
def test_drives_that_cannot_be(sweep_s: str | None, command_V: float | None, words: str) -> None:
    drive = drive_of()
    columns = drive.columns if command_V is None else {**drive.columns, "command_V": np.full(len(drive), command_V)}
    metadata = {**drive.metadata, **({} if sweep_s is None else {"sweep_s": sweep_s})}
    with pytest.raises(BadInput, match=words):
        beside_drive(scope(drive, 2000.0, 0.5), Recording("drive.csv", metadata, columns))


def test_a_clock_beyond_reach() -> None:
    drive = drive_of("multisine", duration_s=4.0)
    with pytest.raises(BadInput):
        align(scope(drive, 2000.0, 0.5, clock=1 + 3 * MAX_CLOCK), drive)
    assert LEAST_ALIKE > 0.9


# ---- the command ----

@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """drive.csv, and scope.csv: a scope's record of it, inverted."""
    folder, drive = tmp_path_factory.mktemp("scope"), drive_of()
    write_recording(folder / "drive.csv", drive.columns, drive.metadata)
    run = scope(drive, 5000.0, 0.25, gain=-0.05, noise=0.01)
    np.savetxt(folder / "scope.csv", np.stack([*run.columns.values()], axis=1), delimiter=",",
               header="t [s],Vin [V],pos [um]", comments="")
    return folder


def test_from_scope_to_recording(folder: Path, rdpi: Callable) -> None:
    done = rdpi("import", "scope.csv", "--drive", "drive.csv", "-o", "run.csv")
    assert done.exit_code == 0, done.output
    recording = read_recording("run.csv")
    assert recording.memory == "reset" and recording.sample_rate_hz == 2000
    assert "aligned with drive.csv" in done.output and "(inverted)" in done.output and "memory: reset" in done.output
    assert recording.metadata["played_digest"] == read_recording("drive.csv", required=("command_V",)).digest
    done = rdpi("import", "scope.csv", "--drive", "drive.csv", "--memory", "unknown", "-o", "run.csv")
    assert done.exit_code == 0 and read_recording("run.csv").memory == "unknown"


@pytest.mark.parametrize(("options", "words"), [
    (("--as", "drive"), "--drive: makes a run"), (("--resample", "1000"), "--drive: makes a run"),
    (("--drive", "none.csv"), "none.csv: cannot be read"),
    (("--drive", "scope.csv"), "scope.csv:1: there is no column"),
    (("--rows", ":3000"), "the recording lasts"), (("--telemetry",), "--drive: is only valid without")])
def test_refused_by_the_command(options: tuple[str, ...], words: str, folder: Path, refused: Callable) -> None:
    given = () if "--drive" in options else ("--drive", "drive.csv")
    assert words in refused("import", "scope.csv", *given, *options, "-o", refused.output)
