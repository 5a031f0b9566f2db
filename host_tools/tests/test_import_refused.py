"""`rdpi import`: where a source cannot become a recording, the message says why."""

from __future__ import annotations

import base64
import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sources import (ARRAYS, BY_NUMBER, COMMAND_V, COUNT, DISPLACEMENT_UM, LINE, MATRIX, NAMED, RUN, TIME_S, archive,
                     array, bad_row, matlab, table)

from rdpi.data import Request, import_recording, read_recording
from rdpi.data.foreign import read_arrays
from rdpi.errors import BadInput


# --- what is refused -----------------------------------------------------------------------------------------------

def zipped(name: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive_file:
        archive_file.writestr(name, "x")
    return stream.getvalue()


OTHER = table(*RUN.values(), header="a,b,c\n")
TWO = table(TIME_S, COMMAND_V, DISPLACEMENT_UM, DISPLACEMENT_UM, header="t,voltage,position,pos_nm\n")
REFUSED = {
    "empty": ("x.csv", "", [], ["x.csv", "is empty"]),
    "binary": ("x.bin", bytes(range(256)).replace(b"\n", b"").replace(b"\r", b"") * 2000, [],
               ["x.bin:1", "no table of numbers"]),
    "words": ("x.csv", "no numbers\nhere at all\n", [], ["x.csv:1", "no table of numbers", "separated by"]),
    "no command": ("x.csv", OTHER, ["--time", "a"],
                   ["x.csv", "like the command", "--command COLUMN", "0 'a', 1 'b', 2 'c'"]),
    "no displacement": ("x.csv", OTHER, ["--time", "a", "--command", "b"], ["x.csv", "--displacement COLUMN"]),
    "no time": ("x.csv", OTHER, ["--command", "b", "--displacement", "c"], ["x.csv", "--time COLUMN", "--rate HZ"]),
    "nothing named": ("x.dat", table(*RUN.values()), [], ["x.dat", "3 columns without names, 0 to 2", "--command"]),
    "two candidates": ("x.csv", TWO, [],
                       ["'position'", "'pos_nm'", "look like the displacement", "--displacement COLUMN"]),
    "no such name": ("x.csv", NAMED, ["--command", "drive"], ["x.csv", "--command drive: no such column", "0 't'"]),
    "no such number": ("x.csv", NAMED, ["--command", "3"], ["x.csv", "--command 3: no such column"]),
    "times of day": ("x.csv", LINE + "".join(f"12:00:{k:02d}.5,{k % 7},{k % 5}\n" for k in range(40)), [],
                     ["x.csv:2: column 0 't' is '12:00:00.5', a time of day", "--rate HZ"]),
    "cut off": ("x.csv", TWO.rstrip().rpartition(",")[0], ["--displacement", "2"],
                [f"x.csv:{TWO.count(chr(10))}: ", "ends within this line: 3 value(s), and 4 in the line before", "remove it"]),
    "same name twice": ("x.csv", table(*RUN.values(), header="t,a,A\n"),
                        ["--command", "a", "--displacement", "A", "--time", "T:ks"],
                        ["x.csv", "--time T:ks", "'ks' is neither a unit nor a factor", "ms"]),
    "ambiguous name": ("x.csv", table(*RUN.values(), header="t,a,a\n"), ["--command", "a"],
                       ["several columns are called 'a'", "number"]),
    "unit of another kind": ("x.csv", NAMED, ["--displacement", "2:mV"],
                             ["--displacement 2:mV", "mV cannot be converted to um", "nm"]),
    "factor too large": ("x.csv", NAMED, ["--displacement", "2:1e308"],
                         ["x.csv", "displacement_um becomes infinite", "column 2 'position'", "smaller factor"]),
    "unit too large": ("x.csv", bad_row(5, "0.005,1e307,1"), ["--command", "1:kV"],
                       ["x.csv", "command_V becomes infinite"]),
    **{f"gain {gain}": ("x.csv", NAMED, ["--command-gain", gain], [f"--command-gain {gain}", "finite factor"])
       for gain in ("nan", "inf", "0")},
    "gain too large": ("x.csv", NAMED, ["--command-gain", "1e308"], ["x.csv", "command_V becomes infinite", "gain"]),
    **{f"rate {rate}": ("x.csv", NAMED, ["--rate", rate], ["--rate: ", f"is '{rate}'", "1e-06 to 1e+08"])
       for rate in ("1e-300", "1e+300", "inf", "nan")},
    "absurd rate in a file": ("x.npz", archive(fs=np.array(5e-324), u=COMMAND_V, z=DISPLACEMENT_UM), [],
                              ["x.npz: fs: ", "e-324'", "1e-06 to 1e+08"]),
    "absurd sample time in a file": ("x.npz", archive(ts=np.array(5e-324), u=COMMAND_V, z=DISPLACEMENT_UM), [],
                                     ["x.npz: ts: ", "'inf'"]),
    "absurd times": ("x.csv", NAMED, ["--time", "t:1e308"], ["x.csv:3", "times in seconds"]),
    "name of two lines": ("x.csv", NAMED, ["--also", "a\nb=1"], ["--also 'a\\nb'", "is not valid as a name"]),
    "name not UTF-8": ("x.csv", NAMED, ["--also", "\udcff=1"], ["--also '\\udcff'", "is not valid as a name"]),
    "note not UTF-8": ("x.csv", NAMED, ["--note", "\udcb5m"], ["--note '\\udcb5m'", "not UTF-8"]),
    "zero factor": ("x.csv", NAMED, ["--displacement", "2:0"], ["--displacement 2:0", "a number that multiplies"]),
    "name of another unit": ("x.csv", table(*RUN.values(), header="t,voltage,sensor_V\n"),
                             ["--displacement", "sensor_V"],
                             ["--displacement sensor_V", "is V, not um", "sensor_V:0.5"]),
    "unknown unit in the name": ("x.csv", table(*RUN.values(), header="t,voltage,sensor [counts]\n"),
                                 ["--displacement", "2"], ["is counts, not um", "factor"]),
    "text": ("x.csv", bad_row(5, "0.005,none,1"), [], ["x.csv:7", "column 1 'voltage' is 'none', not a number"]),
    "text in the first row": ("x.csv", bad_row(0, "0,none,1"), [],
                              ["x.csv:2", "column 1 'voltage' is 'none', not a number"]),
    "text in the second row": ("x.csv", bad_row(1, "0.001,1,-"), [],
                               ["x.csv:3", "column 2 'position' is '-', not a number"]),
    "short first row": ("x.csv", bad_row(0, "0,1"), [], ["x.csv:2", "2 value(s)"]),
    "missing value": ("x.csv", bad_row(0, "0,,1"), [], ["x.csv:2", "column 1 'voltage' is empty"]),
    "NaN": ("x.csv", bad_row(5, "0.005,1,nan"), [], ["x.csv:7", "column 2 'position' is nan"]),
    "short row": ("x.csv", bad_row(5, "0.005,1"), [], ["x.csv:7", "2 value(s)"]),
    "backwards": ("x.csv", bad_row(5, "0.0035,1,2"), [], ["x.csv:7", "runs backwards", "--rate"]),
    "lost sample": ("x.csv", table(*(np.delete(column, 20) for column in RUN.values()), header=LINE + "\n"),
                    ["--rows", "2:"], ["x.csv:23", "not uniform", "this is row 20"]),
    "rate contradicts": ("x.csv", NAMED, ["--time", "t", "--rate", "500"],
                         ["--rate", "is 500, but the times give 1000"]),
    "bad rate in the header": ("x.csv", "# sample_rate_hz: fast\n" + OTHER,
                               ["--command", "b", "--displacement", "c"], ["x.csv", "'fast'", "positive number"]),
    "bad memory in the header": ("x.csv", "# memory: good\n" + NAMED, [], ["x.csv", "'good'", "carried"]),
    "too few rows": ("x.csv", NAMED, ["--rows", "10:20"], ["x.csv, rows 10:20 of 40", "10 samples", "at least 16"]),
    "rows beyond the end": ("x.csv", NAMED, ["--rows", "100:"], ["of 40", "0 samples"]),
    "own column by --also": ("x.csv", NAMED, ["--also", "command_V=1"], ["--also command_V", "--command"]),
    "Excel": ("x.xlsx", zipped("[Content_Types].xml"), [], ["x.xlsx", "save the sheet as CSV"]),
    "other zip": ("x.npz", zipped("readme.txt"), [], ["x.npz", "contains no numeric vectors"]),
    "MATLAB 7.3": ("x.mat", b"MATLAB 7.3 MAT-file, Platform: PCWIN64" + bytes(500), [], ["x.mat", "7.3", "'-v7'"]),
    "HDF5": ("x.mat", b"\x89HDF\r\n\x1a\n" + bytes(500), [], ["x.mat", "7.3", "'-v7'"]),
    "half a MATLAB file": ("x.mat", ARRAYS["vectors.mat"][0][:700], [],
                           ["x.mat", "cannot be read as a MATLAB file", "'-v7'"]),
    "no MATLAB file": ("x.mat", b"hello", [], ["x.mat", "cannot be read as a MATLAB file"]),
    "MATLAB text": ("x.mat", matlab(remark="nothing"), [], ["x.mat", "contains no numeric vectors", "timeseries"]),
    "half an archive": ("x.npz", ARRAYS["named.npz"][0][:-100], [], ["x.npz", "cannot be read as NumPy data"]),
    "array too large": ("x.npy", array(MATRIX).replace(b"(40, 3), }" + b" " * 12, b"(40" + b"0" * 12 + b", 3), }"),
                        BY_NUMBER, ["x.npy", "cannot be read as NumPy data"]),
    "half an array": ("x.npy", ARRAYS["matrix.npy"][0][:-100], BY_NUMBER, ["x.npy", "cannot be read as NumPy data"]),
    "objects": ("x.npy", array(np.array([{}, {}]), allow_pickle=True), [], ["x.npy", "plain numeric arrays"]),
    "unequal lengths": ("x.npz", archive(t=TIME_S, u=COMMAND_V[1:], z=DISPLACEMENT_UM), [],
                        ["x.npz", "the columns differ in length", "1 'u' has 39", "2 'z' has 40"]),
    "NaN in an array": ("x.npz", archive(t=TIME_S, u=COMMAND_V, z=np.where(TIME_S == 0.03, np.nan, 1)),
                        ["--rows", "10:"], ["x.npz, row 30", "column 2 'z' is nan", "--rows"]),
    "backwards in an array": ("x.npz", archive(t=TIME_S[::-1], u=COMMAND_V, z=DISPLACEMENT_UM), [],
                              ["x.npz, row 1", "backwards"]),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str, refused: Callable, tmp_path: Path) -> None:
    file, content, options, needles = REFUSED[name]
    (tmp_path / file).write_bytes(content.encode() if isinstance(content, str) else content)
    message = refused("import", tmp_path / file, *options, "-o", refused.output)
    for needle in needles:
        assert needle in message


# --- readers that are not ours -------------------------------------------------------------------------------------

def test_a_file_that_crashes_the_matlab_reader(damaged: Path, refused: Callable, tmp_path: Path) -> None:
    file = tmp_path / "segv.mat"
    file.write_bytes(base64.b64decode((damaged / "segv.mat.b64").read_bytes()))
    message = refused("import", file, "-o", refused.output)
    assert f"{file}: cannot be read as a MATLAB file" in message and "save it again" in message


MISBEHAVIOUR = {
    "crashes": ("os.kill(os.getpid(), signal.SIGSEGV)", "its reader crashed, SIGSEGV"),
    "hangs": ("time.sleep(60)", "its reader did not end within 1 s"),
    "takes memory": ("bytearray(1 << 40)", "MemoryError"),
    "nests without end": ("deeper = lambda: deeper(); deeper()", "recursion"),
    "leaves": ("os._exit(3)", "its reader failed"),
    "talks": ("print('hello')", "its reader sent"),
}


@pytest.mark.parametrize("what", MISBEHAVIOUR)
def test_whatever_the_matlab_reader_does_is_an_error(what: str, refused: Callable, tmp_path: Path,
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader is another, which does it."""
    code, needle = MISBEHAVIOUR[what]
    (tmp_path / "other" / "scipy").mkdir(parents=True)
    (tmp_path / "other" / "scipy" / "__init__.py").touch()
    (tmp_path / "other" / "scipy" / "io.py").write_text(f"""
import os, signal, time
def loadmat(file, **options):
    {code}
    return {{}}
""")
    monkeypatch.syspath_prepend(tmp_path / "other")
    monkeypatch.setattr("rdpi.data.foreign.START_S", 1 if what == "hangs" else 60)
    (tmp_path / "x.mat").write_bytes(ARRAYS["vectors.mat"][0])
    message = refused("import", tmp_path / "x.mat", "-o", refused.output)
    assert "x.mat: cannot be read as a MATLAB file" in message and needle in message and "save it again" in message


def test_the_working_folder_is_not_searched_for_readers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("numpy.py", "scipy.py", "json.py", "rdpi.py"):
        (tmp_path / name).write_text("raise SystemExit(9)")
    monkeypatch.chdir(tmp_path)
    assert len(read_arrays(ARRAYS["vectors.mat"][0])) == 3


def test_an_archive_that_unpacks_to_more_than_its_size_allows(refused: Callable, tmp_path: Path,
                                                              monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = archive(z=np.zeros(10_000_000))
    limit = 4 * len(bomb)
    monkeypatch.setattr("rdpi.data.foreign.START_BYTES", limit)
    monkeypatch.setattr("rdpi.data.foreign.BYTES_PER_BYTE", 20)
    assert 20 * len(bomb) + limit < 8 * 10_000_000
    (tmp_path / "bomb.npz").write_bytes(bomb)
    message = refused("import", tmp_path / "bomb.npz", "--command", "z", "-o", refused.output)
    assert "cannot be read as NumPy data" in message and "Unable to allocate" in message


def test_missing_source(refused: Callable, tmp_path: Path) -> None:
    assert "nowhere.csv: cannot be read" in refused("import", tmp_path / "nowhere.csv", "-o", refused.output)


def test_a_source_whose_name_is_not_text(tmp_path: Path) -> None:
    path = tmp_path / "\udcff.csv"
    path.write_text(NAMED)
    recording, _ = import_recording(str(path), Request())
    assert recording.metadata["source"] == "?.csv"


def test_usage_errors(rdpi: Callable, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(NAMED)
    for options in (["--rows", "5"], ["--rows", "a:b"], ["--rate", "0"], ["--also", "x"], ["--also", "a,b=1"],
                    ["--memory", "good"]):
        result = rdpi("import", tmp_path / "x.csv", *options, "-o", tmp_path / "out.csv")
        assert result.exit_code == 2 and options[0] in result.output and not (tmp_path / "out.csv").exists()


LONG = 100_000
LONG_LINES = {"digits": "1" * LONG + "x", "brackets": "[" * LONG + ",u,z", "units": "a" + "_ " * LONG + ",u,z",
              "words": "# " + "a " * LONG, "blanks": "t u" + " " * LONG + "z", "hashes": "#" * LONG,
              "quotes": '"' * LONG, "commas": "," * LONG}


@pytest.mark.parametrize("name", LONG_LINES)
@pytest.mark.parametrize("delimiter", [",", " "])
def test_long_lines_above_a_table(name: str, delimiter: str, tmp_path: Path) -> None:
    """Read in a time that grows as their length: with its square, this test takes minutes."""
    path = tmp_path / "run.txt"
    path.write_text(LONG_LINES[name] + "\n" + table(*RUN.values(), delimiter=delimiter))
    recording, _ = import_recording(str(path), Request(columns={"time": "0", "command": "1", "displacement": "2"}))
    assert len(recording) == COUNT


def test_a_number_of_many_digits_and_a_letter(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(",".join(RUN) + "\n" + "1" * LONG + "x,1,2\n" + table(*RUN.values()))
    with pytest.raises(BadInput, match="run.csv:2: column time_s is .*not a number"):
        read_recording(path)
