"""`rdpi import --drive`: a scope file beside the drive that was played."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rdpi import fit
from rdpi.data import Recording, read_recording, sample_times, write_recording
from rdpi.data.align import LEAST_ALIKE, MAX_CLOCK, MOST_DOUBT, align, beside_drive
from rdpi.errors import BadInput
from rdpi.model import read_model
from scopes import FAMILIES, KINDS, File, drive_of, off_by, scope

# ---- the place ----

@pytest.mark.parametrize("seed", range(20))
def test_within_half_a_sample(seed: int) -> None:
    """Trigger, clock, gain, noise, rate and kind of drive by chance."""
    random = np.random.default_rng(100 + seed)
    kind, options = KINDS[seed % (len(KINDS) - 1)]
    drive = drive_of(kind, rate_hz=float(random.choice([1000, 2000, 5000])), **options)
    start_s, clock = float(random.uniform(0, 1)), 1 + float(random.uniform(-1, 1)) * random.choice([1e-5, 1e-4, 5e-3])
    gain, offset_V = float(random.choice([1, -1, 0.1, -0.05, 10])), float(random.normal())
    rate_hz = drive.sample_rate_hz * float(random.choice([2.5, 5, 8]))
    run = scope(drive, rate_hz, start_s, clock=clock, gain=gain, offset_V=offset_V,
                noise=random.choice([0, 0.003, 0.01]), before_s=start_s, held=bool(seed % 2), seed=seed)
    found = align(run, drive)
    assert off_by(found.start_s, found.clock, File(drive, run, start_s, clock, 0, 0, 0)) < 0.5
    assert found.gain == pytest.approx(gain, rel=0.02)
    assert found.offset_V == pytest.approx(offset_V, abs=0.02 * abs(gain) * 100)
    assert found.clock == pytest.approx(clock, abs=2e-4)


@pytest.mark.parametrize("files", [pytest.param(8, marks=pytest.mark.slow), pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize(("family", "least"), [("usual", 0.95), ("rough", 0.65)])
def test_many_files(family: str, least: float, files: int) -> None:
    """None aligned wrongly; nearly all usual ones within half a sample, the others refused with cause and remedy."""
    aligned = 0
    for seed in range(2000, 2000 + files):
        file = FAMILIES[family](seed)
        try:
            found = align(file.run, file.drive, file.first)
        except BadInput as refused:
            assert "is found, but only to" in str(refused) and "; " in str(refused), seed
            continue
        aligned += 1
        assert off_by(found.start_s, found.clock, file) < 0.5, seed
    assert aligned >= least * files


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


def test_a_reference_that_was_not_recorded_is_that_of_the_drive() -> None:
    drive = drive_of()
    drive = replace(drive, columns={**drive.columns, "reference_um": 0.1 * drive.command_V})
    run = scope(drive, 9000.0, 0.7)
    recording, _ = beside_drive(run, drive)
    np.testing.assert_array_equal(recording.reference_um, 0.1 * recording.command_V)
    own = replace(run, columns={**run.columns, "reference_um": np.full(len(run), 3.0)})
    recording, _ = beside_drive(own, drive)
    np.testing.assert_allclose(recording.reference_um, 3.0)


@pytest.mark.parametrize("clock", [1.0, 1.004])
def test_where_in_the_hold_a_row_is_read(clock: float) -> None:
    """In its middle, or half a sample of the drive before: told by a displacement that is the scope's own time."""
    drive = drive_of()
    run = scope(drive, 9000.0, 0.7, clock=clock, noise=0.003)
    run = replace(run, columns={**run.columns, "displacement_um": run.time_s})
    middle, _ = beside_drive(run, drive)
    switch, lines = beside_drive(run, drive, "switch")
    np.testing.assert_array_equal(switch.command_V, middle.command_V)
    np.testing.assert_allclose(middle.displacement_um - switch.displacement_um, 0.5 * clock / 2000, rtol=1e-6)
    assert [middle.metadata["read_at"], switch.metadata["read_at"]] == ["middle", "switch"]
    assert "half a sample before the middle" in " ".join(lines)


def test_what_is_read_as_the_converter_switches_is_fitted_half_a_sample_later(tmp_path: Path) -> None:
    """The delay that `compensate` then makes up for is that to the converter's clock: what it held is .4 ms late here."""
    drive = drive_of("commission", rate_hz=1000.0, duration_s=20.0)
    run = scope(drive, 20_000.0, 0.7, noise=0.001)
    late = np.interp(run.time_s - 0.4e-3, run.time_s, run.columns["displacement_um"])
    run = replace(run, columns={**run.columns, "displacement_um": late})
    delays_s = []
    for at in ("middle", "switch"):
        fit([beside_drive(run, drive, at)[0]], effects=["delay"]).save(tmp_path / "model.json")
        (delay,) = read_model(tmp_path / "model.json").effects
        delays_s.append(delay["parameters"]["delay_s"]["value"])
    np.testing.assert_allclose(delays_s, [0.4e-3, 0.9e-3], atol=0.02e-3)


@pytest.mark.parametrize(("changes", "memory"), [
    ({}, "reset"), ({"rest_V": "5"}, "unknown"), ({"sweep_s": None}, "unknown"), ({"max_V": None}, "unknown"),
    ({"max_V": "many"}, "unknown"), ({"sweep_V": "0 100"}, "reset"), ({"sweep_V": "0 200"}, "unknown"),
    ({"sweep_V": "0"}, "unknown"), ({"sweep_V": "0 many"}, "unknown")])
def test_memory(changes: dict, memory: str) -> None:
    drive = drive_of()
    metadata = {key: value for key, value in {**drive.metadata, **changes}.items() if value is not None}
    recording, _ = beside_drive(scope(drive, 2000.0, 0.5), Recording("drive.csv", metadata, drive.columns))
    assert recording.memory == memory
    assert (len(recording) < len(drive)) == ("sweep_s" in metadata)


@pytest.mark.parametrize("twice", [False, True])
def test_the_first_of_several_plays(twice: bool) -> None:
    drive = drive_of()
    one = scope(drive, 5000.0, 0.25, noise=0.01)
    columns = {name: np.tile(values, 1 + twice) for name, values in one.columns.items()}
    columns["time_s"] = sample_times(len(columns["time_s"]), 5000.0)
    recording, lines = beside_drive(Recording("scope.csv", {}, columns), drive)
    assert float(recording.metadata["played_from_s"]) == pytest.approx(0.25, abs=0.5 / 2000)
    assert ("played 2 times" in " ".join(lines)) == twice


@pytest.mark.parametrize("moves", [False, True])
def test_what_comes_behind_the_drive_is_told_if_it_moves(moves: bool) -> None:
    """Another drive that begins alike, and not an amplifier that is switched off."""
    drive = drive_of()
    one = scope(drive, 5000.0, 0.25)
    behind = one.command_V[::-1] if moves else np.full(5000, np.min(one.command_V))
    columns = {name: np.concatenate([values, behind]) for name, values in one.columns.items()}
    columns["time_s"] = sample_times(len(columns["time_s"]), 5000.0)
    _, lines = beside_drive(Recording("scope.csv", {}, columns), drive)
    assert ("moves on after the end of the drive" in " ".join(lines)) == moves


def test_hum_at_a_line_of_the_drive() -> None:
    """A multisine holds a line at 50 Hz; hum there looks like a shift of it."""
    drive = drive_of("multisine", 10000.0, duration_s=4.0)
    start_s = 0.50013  # no sample just where the converter switches
    run = scope(drive, 20000.0, start_s, noise=0.003, hum=0.005, bits=8)
    found = align(run, drive)
    assert off_by(found.start_s, found.clock, File(drive, run, start_s, 1.0, 0, 0, 0)) < 0.2


def test_a_sweep_that_was_clipped() -> None:
    """Only what follows the sweep must be there."""
    drive = drive_of("multisine", duration_s=4.0)
    run, sweep_s = scope(drive, 5000.0, 0.5, noise=0.003), float(drive.metadata["sweep_s"])
    run.columns["command_V"][run.time_s < 0.5 + sweep_s] = 12.0
    found = align(run, drive, round(sweep_s * 2000))
    assert off_by(found.start_s, found.clock, File(drive, run, 0.5, 1.0, round(sweep_s * 2000), 0, 0)) < 0.5


@pytest.mark.parametrize("kind", ["sawtooth", "commission"])
def test_a_clock_that_both_share(kind: str) -> None:
    """Each sample of the drive is seen once: its place is known to half a hold, and told so. A rest at the end of the
    drive adds nothing to the doubt.
    """
    drive = drive_of(kind)
    for late in (0.0, 0.3, -0.4):  # of a sample
        found = align(scope(drive, 2000.0, 0.5 + late / 2000, noise=0.003), drive)
        assert 0.4 < found.doubt_s * 2000 <= MOST_DOUBT
        assert abs(found.start_s - 0.5 - late / 2000) * 2000 < 0.5


@pytest.mark.parametrize(("before", "after"), [(600, 400), (0, 0)])
@pytest.mark.parametrize("kind", ["steps", "chirp", "startup", "sawtooth"])
def test_a_drive_that_was_logged_itself(kind: str, before: int, after: int) -> None:
    """At the drive's own rate, to the digits of a file: its samples are told, also of a drive that mostly rests, and
    of one that fills the recording."""
    drive = drive_of(kind)
    logged = np.round(np.concatenate([np.full(before, drive.command_V[0]), drive.command_V, np.full(after, 50.0)]), 6)
    run = Recording("logged.csv", {}, {"time_s": sample_times(len(logged), 2000.0), "command_V": logged,
                                       "displacement_um": np.arange(len(logged)) / 7})
    found = align(run, drive)
    assert found.start_s == pytest.approx(before / 2000) and found.clock == 1 and 0 < found.doubt_s * 2000 < 0.01
    imported, lines = beside_drive(run, drive)
    with pytest.raises(BadInput, match="--at switch: the file logs the drive itself"):
        beside_drive(run, drive, "switch")
    assert imported.displacement_um[0] == pytest.approx((before + len(drive) - len(imported)) / 7)
    assert "clock +0 ppm, recorded voltage = 1 x drive + 0 V" in lines[1]


@pytest.mark.parametrize(("rate_hz", "told"), [(300.0, True), (5000.0, False)])
def test_a_scope_slower_than_the_drive_is_told(rate_hz: float, told: bool) -> None:
    drive = drive_of(rate_hz=2000.0)
    _, lines = beside_drive(scope(drive, rate_hz, 0.5), drive)
    assert ("interpolated between" in " ".join(lines)) == told


# ---- what is refused ----

WRONG = {
    "another seed": (lambda drive: scope(drive_of("multisine", duration_s=4.0, seed=9), 2000.0, 0.5), "is not found"),
    "another kind": (lambda drive: scope(drive_of("sine", cycles=3), 2000.0, 0.5), "is not found|ends|lasts"),
    "noise": (lambda drive: scope(drive, 2000.0, 0.5, noise=0.8), "is not found"),
    "too short": (lambda drive: scope(drive, 2000.0, 0.0, before_s=0, after_s=-3.0), "lasts .* but the drive"),
    "its end is missing": (lambda drive: scope(drive, 2000.0, 1.5, before_s=1.5, after_s=-1.0), "is not found|ends"),
    "begins after the sweep": (lambda drive: scope(drive, 2000.0, -1.8, after_s=1.0), "is not found|begins"),
    "constant": (lambda drive: scope(drive, 2000.0, 0.5, gain=0.0), "constant"),
    "rounding": (lambda drive: scope(drive, 2000.0, 0.5, gain=1e-16), "constant"),
    "times of another unit": (lambda drive: scope(drive, 2.0, 0.5), r"lasts 4.* s, less than 16 samples"),
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
    with pytest.raises(BadInput, match=r"only to .* of its samples \(noise 5.* at 4000 samples per second or more"):
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
    write_recording(folder / "flat.csv", {**drive.columns, "command_V": np.full(len(drive), 5.0)}, drive.metadata)
    (folder / "empty.csv").touch()
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
    done = rdpi("import", "scope.csv", "--drive", "drive.csv", "--at", "switch", "-o", "run.csv")
    assert done.exit_code == 0 and read_recording("run.csv").metadata["read_at"] == "switch"
    done = rdpi("import", "scope.csv", "--drive", "drive.csv", "--memory", "unknown", "-o", "run.csv")
    assert done.exit_code == 0 and read_recording("run.csv").memory == "unknown"


@pytest.mark.parametrize(("options", "words"), [
    (("--as", "drive"), "--drive: makes a run"), (("--resample", "1000"), "--drive: makes a run"),
    (("--drive", "none.csv"), "none.csv: cannot be read"),
    (("--drive", "scope.csv"), "scope.csv:1: there is no column"),
    (("--drive", "flat.csv"), "flat.csv: command_V does not move"),
    (("--drive", "empty.csv"), "empty.csv: is empty"), (("--rows", ":2"), "; at least 16 are needed"),
    (("--rows", ":3000"), "the recording lasts"), (("--telemetry",), "--drive: is only valid without")])
def test_refused_by_the_command(options: tuple[str, ...], words: str, folder: Path, refused: Callable) -> None:
    given = () if "--drive" in options else ("--drive", "drive.csv")
    assert words in refused("import", "scope.csv", *given, *options, "-o", refused.output)


def test_when_to_read_needs_a_drive(folder: Path, refused: Callable) -> None:
    assert "--at switch: is only valid with --drive" in refused("import", "scope.csv", "--at", "switch", "-o",
                                                                 refused.output)


@pytest.mark.parametrize(("offset_V", "gain"), [(1e6, 1.0), (0.0, 1e-9), (-1e6, -1e3)])
def test_any_gain_and_offset(offset_V: float, gain: float) -> None:
    drive = drive_of()
    found = align(scope(drive, 5000.0, 0.25, gain=gain, offset_V=offset_V), drive)
    assert found.gain == pytest.approx(gain, rel=1e-3)
    assert off_by(found.start_s, found.clock, File(drive, None, 0.25, 1.0, 0, 0, 0)) < 0.5
