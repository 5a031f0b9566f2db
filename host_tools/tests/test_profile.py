"""`rdpi profile`: the tables of examples/track and examples/excite, and what C makes of them."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rdpi.board import profile
from rdpi.data import Recording, read_recording, sample_times, write_recording
from rdpi.firmware import FixedPoint, write_header
from rdpi.model import read_model

ROOT = Path(__file__).resolve().parents[2]
PARAMS = ROOT / "examples/track/params"
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Wdouble-promotion", "-Werror"]


def write(path: Path, values: np.ndarray, column: str = "reference_um", rate_hz: float = 10_000,
          **metadata: object) -> Path:
    write_recording(path, {"time_s": sample_times(len(values), rate_hz), column: values}, metadata)
    return path


@pytest.fixture
def compiled(tmp_path: Path) -> Callable[..., list[int | float]]:
    """Compile C with the header rdpi_profile.h of this folder, and read the numbers that it prints."""
    def run(source: str, *options: str) -> list[float]:
        (tmp_path / "main.c").write_text(source)
        for command in (["gcc", *WARNINGS, *options, f"-I{ROOT}/port/include", f"-I{ROOT}/lib/include", f"-I{tmp_path}",
                         tmp_path / "main.c", "-o", tmp_path / "main"], [tmp_path / "main"]):
            done = subprocess.run(command, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
        return [float(word) for word in done.stdout.split()]

    return run


def reader(kind: str, name: str, form: str, ahead: int = 0) -> str:
    """A program that prints what port/profile gives, tick by tick: the present reference, or the one so far ahead."""
    return f"""
        #include "{ROOT}/port/profile/profile.c"
        #include <stdio.h>
        int main(void)
        {{
            {kind} reference = 0, later = 0;
            while ({name}(1, {ahead}u, &reference, &later)) {{
                printf("{form}\\n", {"(double)" * (kind == "float")}{"later" if ahead else "reference"});
            }}
            return 0;
        }}"""


def references(count: int = 500) -> np.ndarray:
    return np.random.default_rng(5).uniform(-1, 9, count)


def test_references_come_back_to_the_bit_in_single_precision(tmp_path: Path, rdpi: Callable,
                                                                 compiled: Callable) -> None:
    wanted = np.r_[references(), 1e-30, -0.0, 1e6, -1 / 3]
    write(tmp_path / "reference.csv", wanted)
    done = rdpi("profile", tmp_path / "reference.csv", "-o", tmp_path / "rdpi_profile.h", "--json", tmp_path / "json")
    assert done.exit_code == 0, done.output
    assert re.search(r"504 samples at 10000 per second, -0.99\d+ to 1e\+06 um, 2016 bytes of flash", done.output)
    got = compiled(reader("float", "rdpi_reference_um", "%.9g"))
    assert np.array(got, np.float32).tobytes() == wanted.astype(np.float32).tobytes()
    result = json.loads((tmp_path / "json").read_text())
    assert (result["samples"], result["sample_rate_hz"]) == (504, 10_000)


def test_references_come_back_as_the_host_rounds_them_in_fixed_point(tmp_path: Path, rdpi: Callable,
                                                                     compiled: Callable) -> None:
    model, wanted = read_model(PARAMS / "model.json"), references()
    write_header(model, tmp_path / "rdpi_params.h")
    write(tmp_path / "reference.csv", wanted)
    assert rdpi("profile", tmp_path / "reference.csv", "-o", tmp_path / "rdpi_profile.h").exit_code == 0
    got = compiled(reader("int32_t", "rdpi_reference_q31", "%d"), "-DRDPI_REFERENCE_Q31=1",
                   "-Wno-unused-const-variable")
    expected = FixedPoint(model, 1e-4).references(wanted)
    assert np.abs(np.array(got) - expected).max() <= 1


def test_what_is_no_reference_is_none(tmp_path: Path, rdpi: Callable, compiled: Callable) -> None:
    wanted = np.where(np.arange(20) == 7, 2e6, 1.5)
    write(tmp_path / "reference.csv", wanted)
    done = rdpi("profile", tmp_path / "reference.csv", "-o", tmp_path / "rdpi_profile.h")
    assert done.exit_code == 0 and "note: 1 samples are beyond the largest reference" in done.output
    assert np.isnan(compiled(reader("float", "rdpi_reference_um", "%.9g"))).tolist() == (wanted == 2e6).tolist()


def test_lost_ticks_skip_references(tmp_path: Path, rdpi: Callable, compiled: Callable) -> None:
    write(tmp_path / "reference.csv", np.arange(20.0))
    assert rdpi("profile", tmp_path / "reference.csv", "-o", tmp_path / "rdpi_profile.h").exit_code == 0
    source = reader("float", "rdpi_reference_um", "%g").replace("(1, ", "(3, ")
    assert compiled(source) == [2, 5, 8, 11, 14, 17]


@pytest.mark.parametrize("ahead", [1, 3, 19, 20, 2**32 - 1])
def test_ahead_is_the_reference_of_a_later_sample_and_beyond_the_end_the_last(tmp_path: Path, rdpi: Callable,
                                                                              compiled: Callable, ahead: int) -> None:
    write(tmp_path / "reference.csv", np.arange(20.0))
    assert rdpi("profile", tmp_path / "reference.csv", "-o", tmp_path / "rdpi_profile.h").exit_code == 0
    source = reader("float", "rdpi_reference_um", "%g", ahead)
    assert compiled(source) == np.minimum(np.arange(20) + ahead, 19).tolist()
    lost = np.arange(2, 20, 3)  # two ticks before each
    assert compiled(source.replace("(1, ", "(3, ")) == np.minimum(lost + ahead, 19).tolist()


def test_another_rate_than_the_applications_does_not_compile(tmp_path: Path, rdpi: Callable,
                                                                     compiled: Callable) -> None:
    write(tmp_path / "reference.csv", references(), rate_hz=20_000)
    assert rdpi("profile", tmp_path / "reference.csv", "-o", tmp_path / "rdpi_profile.h").exit_code == 0
    source = reader("float", "rdpi_reference_um", "%.9g")
    assert len(compiled(source, "-DTRACK_RATE_HZ=20000")) == 500
    with pytest.raises(AssertionError, match="another number of samples per second"):
        compiled(source, "-DTRACK_RATE_HZ=10000")


def test_another_column(tmp_path: Path, rdpi: Callable, compiled: Callable) -> None:
    write(tmp_path / "reference.csv", np.arange(20.0), "displacement_um")
    assert rdpi("profile", tmp_path / "reference.csv", "-o", tmp_path / "rdpi_profile.h", "--reference-column",
                "displacement_um").exit_code == 0
    assert compiled(reader("float", "rdpi_reference_um", "%g")) == list(range(20))


DRIVE = """
    #include "rdpi_profile.h"
    #include <stdio.h>
    int main(void)
    {
        printf("%u %u %d %.17g %.17g %u\\n", RDPI_PROFILE_RATE_HZ, RDPI_PROFILE_COUNT, RDPI_PROFILE_DAC_BITS,
               RDPI_PROFILE_MIN_V, RDPI_PROFILE_MAX_V, RDPI_PROFILE_SWEEP);
        for (unsigned k = 0; k < RDPI_PROFILE_COUNT; k++) {
            printf("%lu\\n", (unsigned long)rdpi_profile_codes[k]);
        }
        return 0;
    }"""


def test_a_drive_with_its_sweep(tmp_path: Path, rdpi: Callable, compiled: Callable) -> None:
    drive, header = tmp_path / "drive.csv", tmp_path / "rdpi_profile.h"
    assert rdpi("excite", "sine", "--min-V", "-10", "--max-V", "100", "--frequencies", "20", "-o", drive).exit_code == 0
    done = rdpi("profile", drive, "--dac", "12:-20:120.5", "-o", header, "--json", tmp_path / "json")
    assert done.exit_code == 0, done.output
    run = read_recording(drive, ("command_V",))
    about, codes = np.split(np.array(compiled(DRIVE)), [6])
    swept = round(float(run.metadata["sweep_s"]) * 10_000) + 1
    assert about.tolist() == [10_000, len(run), 12, -20, 120.5, swept]
    assert json.loads((tmp_path / "json").read_text())["sweep_samples"] == swept
    np.testing.assert_allclose(-20 + 140.5 * codes / 4095, run.command_V, rtol=0, atol=140.5 / 4095 / 2 + 1e-9)
    assert run.command_V[swept - 1] == float(run.metadata["rest_V"])
    assert np.ptp(run.command_V[swept - 1:swept + 1]) > 0, "and then it moves on"


def test_a_drive_without_sweep(tmp_path: Path, rdpi: Callable, compiled: Callable) -> None:
    write(tmp_path / "drive.csv", np.linspace(0, 10, 50), "command_V")
    done = rdpi("profile", tmp_path / "drive.csv", "--dac", "16:0:10", "-o", tmp_path / "rdpi_profile.h")
    assert done.exit_code == 0 and "decaying sweep" not in done.output
    about, codes = np.split(np.array(compiled(DRIVE)), [6])
    assert about[5] == 0 and codes[[0, -1]].tolist() == [0, 65535]


@pytest.mark.parametrize("rate_hz, samples", [(44_100, 500), (3, 100), (96_000, 16), (1, 20)])
def test_times_in_nanoseconds_are_exact_enough(tmp_path: Path, rate_hz: int, samples: int) -> None:
    source = write(tmp_path / "reference.csv", np.zeros(samples), rate_hz=rate_hz)
    assert profile.integer_rate_hz(read_recording(source, ("reference_um",))) == rate_hz


def test_the_same_bytes_every_time_and_wherever(tmp_path: Path, rdpi: Callable) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder / "reference.csv", references())
        assert rdpi("profile", tmp_path / folder / "reference.csv", "-o", tmp_path / folder / "p.h").exit_code == 0
    first, second = ((tmp_path / folder / "p.h").read_text() for folder in ("a", "b"))
    assert first == second
    assert read_recording(tmp_path / "a/reference.csv", ("reference_um",)).digest in first
    assert max(map(len, first.splitlines())) <= 120


@pytest.mark.parametrize("values, column, rate_hz, metadata, words, message", [
    (references(), "reference_um", 10_000.5, {}, [], ": 10000.5 samples per second; the firmware takes whole numbers"),
    (references(), "reference_um", 0.5, {}, [], ": 0.5 samples per second; the firmware takes whole numbers"),
    (references(), "command_V", 1000, {}, [], ": there is no column reference_um"),
    (references(), "reference_um", 1000, {}, ["--dac", "16:0:10"], ": there is no column command_V"),
    (references() + 1e7, "reference_um", 1000, {}, [], ": reference_um has no value within ±1e+06 um"),
    (references(), "command_V", 1000, {}, ["--dac", "16:0:10"], ": command_V spans -0.99"),
    (references(), "command_V", 1000, {}, ["--dac", "16:-5:8"], ": command_V spans -0.99"),
    (references(), "command_V", 1000, {"sweep_s": "1"}, ["--dac", "16:-5:10"], ": sweep_s is '1'; give the duration"),
    (references(), "command_V", 1000, {"sweep_s": "nan"}, ["--dac", "16:-5:10"], ": sweep_s is 'nan'; give"),
])
def test_what_the_firmware_cannot_play(tmp_path: Path, refused: Callable, values: np.ndarray, column: str,
                                       rate_hz: float, metadata: dict, words: list[str], message: str) -> None:
    source = write(tmp_path / "file.csv", values, column, rate_hz, **metadata)
    text = refused("profile", source, "-o", refused.output, *words)
    assert re.sub(r":\d+:", ":", text, count=1).startswith(f"{source}{message}")


@pytest.mark.parametrize("dac, message", [
    ("0:0:10", "--dac 0:0:10: give 1 to 20 bits"), ("21:0:10", "--dac 21:0:10: give"), ("8:10:0", "--dac 8:10:0: give"),
    ("8:0:nan", "--dac 8:0:nan: give"),
])
def test_dacs_that_are_none(tmp_path: Path, refused: Callable, dac: str, message: str) -> None:
    source = write(tmp_path / "drive.csv", references(), "command_V")
    assert refused("profile", source, "-o", refused.output, "--dac", dac).startswith(message)


@pytest.mark.parametrize("dac", ["16", "16:0", "x:0:1", "16:0:1:2"])
def test_a_dac_is_three_numbers(tmp_path: Path, rdpi: Callable, dac: str) -> None:
    source = write(tmp_path / "drive.csv", references(), "command_V")
    done = rdpi("profile", source, "-o", tmp_path / "p.h", "--dac", dac)
    assert done.exit_code == 2 and "give BITS:MIN_V:MAX_V" in done.output and not (tmp_path / "p.h").exists()


def test_a_column_of_a_drive_is_refused(tmp_path: Path, refused: Callable) -> None:
    source = write(tmp_path / "drive.csv", references(), "command_V")
    assert refused("profile", source, "-o", refused.output, "--dac", "16:-5:10", "--reference-column",
                   "command_V").startswith("--reference-column: is only valid without --dac")


def test_volts_are_no_reference(tmp_path: Path, refused: Callable) -> None:
    source = write(tmp_path / "drive.csv", references(), "command_V")
    assert refused("profile", source, "-o", refused.output, "--reference-column", "command_V").startswith(
        "--reference-column command_V: is no displacement")


def test_the_shipped_profile_is_one_period_of_a_sine(tmp_path: Path) -> None:
    time_s = sample_times(1000, 10_000)
    source = write(tmp_path / "sine.csv", np.round(4 - 4 * np.cos(2 * np.pi * 10 * time_s), 6))
    run: Recording = read_recording(source, ("reference_um",))

    def without_version(text: str) -> str:
        return re.sub(r"Generated by rdpi \S+", "Generated by rdpi", text)

    shipped = (PARAMS / "rdpi_profile.h").read_text()
    assert without_version(shipped) == without_version(profile.render_reference(run))
    assert len(shipped) < 40_000
