"""`rdpi import`: what laboratories have on disk becomes a recording, or the message says why not."""

from __future__ import annotations

import base64
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings, strategies as st

from rdpi.data import Recording, Request, import_recording, read_recording, sample_times, write_recording
from rdpi.data.foreign import read_arrays
from rdpi.errors import BadInput

COUNT = 40
TIME_S = sample_times(COUNT, 1000)
COMMAND_V = np.round(5 - 5 * np.cos(2 * np.pi * 50 * TIME_S), 6)
DISPLACEMENT_UM = np.round(0.25 * COMMAND_V + 1, 6)
RUN = {"time_s": TIME_S, "command_V": COMMAND_V, "displacement_um": DISPLACEMENT_UM}


def table(*columns: np.ndarray, header: str = "", delimiter: str = ",", form: str = "{:.9g}") -> str:
    return header + "".join(delimiter.join(form.format(value) for value in row) + "\n" for row in zip(*columns))


@pytest.fixture
def imported(rdpi: Callable, tmp_path: Path) -> Callable:
    """Import content or a file with options; the recording and what was printed."""

    def run(source: str | bytes | Path, *options: str, name: str = "source.csv",
            required: tuple[str, ...] = ("command_V",)) -> tuple[Recording, str]:
        if not isinstance(source, Path):
            (tmp_path / name).write_bytes(source.encode() if isinstance(source, str) else source)
            source = tmp_path / name
        result = rdpi("import", source, *options, "-o", tmp_path / "run.csv")
        assert result.exit_code == 0, result.output
        return read_recording(tmp_path / "run.csv", required), result.output

    return run


def same(recording: Recording) -> None:
    for name, column in RUN.items():
        np.testing.assert_allclose(recording.columns[name], column, rtol=1e-8, atol=1e-9)


# --- the measured stack --------------------------------------------------------------------------------------------

def test_measured_stack(picma: Path, imported: Callable) -> None:
    recording, output = imported(picma / "Model_Vi_Do.dat", "--command", "0", "--displacement", "4", "--rate", "200",
                                 "--rows", "400:4400", "--actuator", "P-885.91")
    raw = np.loadtxt(picma / "Model_Vi_Do.dat")[400:4400]
    assert len(recording) == 4000 and recording.sample_rate_hz == 200
    np.testing.assert_array_equal(recording.command_V, raw[:, 0])
    np.testing.assert_array_equal(recording.displacement_um, raw[:, 4])
    np.testing.assert_array_equal(recording.time_s, np.arange(4000) / 200)
    assert recording.metadata["source"] == "Model_Vi_Do.dat" and recording.metadata["rows"] == "400:4400"
    assert recording.metadata["actuator"] == "P-885.91" and recording.metadata["source_digest"].startswith("sha256:")
    assert "8027 rows, 7 columns" in output and "from column 4" in output and "4000 samples" in output


def test_measured_stack_with_reference(picma: Path, imported: Callable) -> None:
    recording, _ = imported(picma / "Test_Vi_Do_Di.dat", "--command", "0", "--displacement", "4", "--reference", "8",
                            "--rate", "200", "--rows", "200:14100", "--also", "command_again_V=1")
    assert list(recording.columns) == ["time_s", "command_V", "displacement_um", "reference_um", "command_again_V"]
    assert len(recording) == 13900 and 39 < np.ptp(recording.reference_um) < 41


# --- tables --------------------------------------------------------------------------------------------------------

LINE = "t,voltage,position\n"
NAMED = table(*RUN.values(), header=LINE)
RECOGNISED = {
    "own format": "# actuator: a\n# memory: reset\n" + table(*RUN.values(), header=",".join(RUN) + "\n"),
    "units in names": table(TIME_S * 1e3, COMMAND_V * 1e3, DISPLACEMENT_UM * 1e3, header="Time_ms,Voltage_mV,pos_nm\n"),
    "units in brackets": table(TIME_S, COMMAND_V / 1e3, DISPLACEMENT_UM / 1e3, header="t [s],U (kV),Position [mm]\n"),
    "one-letter names": table(TIME_S * 1e6, COMMAND_V, DISPLACEMENT_UM, header="t/us;u;z [µm]\n", delimiter=";"),
    "tabs": table(*RUN.values(), header="Time\tDrive voltage V\tdisp\n", delimiter="\t"),
    "white space": table(*RUN.values(), header="  time   drive   disp\n", delimiter="   "),
    "names of two words": table(*RUN.values(), header="Time (s)  Drive Voltage (V)  Disp (um)\n", delimiter="  "),
    "names with units apart": table(*RUN.values(), header="Time (s) Voltage (V) Disp (um)\n", delimiter=" "),
    "numpy.savetxt": table(*RUN.values(), header="# t voltage position\n", delimiter=" ", form="{:.18e}"),
    "MATLAB comment": table(*RUN.values(), header="% made today\n% t, voltage, position\n", delimiter=" "),
    "decimal comma": table(*RUN.values(), header="Zeit;Voltage;Position\n", delimiter=";").replace(".", ","),
    "decimal comma and tabs": table(*RUN.values(), header=LINE.replace(",", "\t"), delimiter="\t").replace(".", ","),
    "line of units": table(TIME_S, COMMAND_V, DISPLACEMENT_UM * 1e3, header=LINE + "s,V,nm\n"),
    "preamble": "Scope 3000\nChannels,3\nRate,1000\n\n" + table(*RUN.values(), header='"t","voltage","position"\n'),
    "trailing separators": NAMED.replace(",", ";").replace("\n", ";\n"),
    "column of text": NAMED.replace("\n", ",ok\n").replace("position,ok", "position,state"),
    "quoted numbers": table(*RUN.values(), header=LINE, form='"{:.9g}"'),
    "CRLF": NAMED.replace("\n", "\r\n"),
    "byte-order mark": "\ufeff" + NAMED,
    "rate in the header": "# sample_rate_hz: 1000\n" + table(COMMAND_V, DISPLACEMENT_UM, header="voltage,position\n"),
}
BY_NUMBER = ["--time", "0", "--command", "1", "--displacement", "2"]
TOLD = {
    "no names": (table(*RUN.values()), BY_NUMBER),
    "names": (table(*RUN.values(), header="a,b,c\n"), ["--time", "a", "--command", "B", "--displacement", "c"]),
    "name without its unit": (table(TIME_S, COMMAND_V, DISPLACEMENT_UM * 1e3, header="a,b,laser [nm]\n"),
                              ["--time", "a", "--command", "b", "--displacement", "laser"]),
    "units": (table(TIME_S * 1e3, COMMAND_V * 1e3, DISPLACEMENT_UM * 1e-6),
              ["--time", "0:ms", "--command", "1:mV", "--displacement", "2:m"]),
    "a colon in a name": (table(*RUN.values(), header="CH:1,CH:2,CH:3\n"),
                          ["--time", "CH:1", "--command", "CH:2:V", "--displacement", "CH:3"]),
    "number of a column with a name": (NAMED, ["--displacement", "2"]),
    "sensor volts": (table(TIME_S, COMMAND_V, DISPLACEMENT_UM / -5, header="t,voltage,sensor_V\n"),
                     ["--displacement", "sensor_V:-5"]),
    "before an amplifier": (table(TIME_S, COMMAND_V / 15, DISPLACEMENT_UM, header=LINE), ["--command-gain", "15"]),
    "ticks": (table(TIME_S * 1e6, COMMAND_V, DISPLACEMENT_UM, header="tick,voltage,position\n"),
              ["--time", "tick:1e-6"]),
    "rate instead of bad times": (table(TIME_S * 0, COMMAND_V, DISPLACEMENT_UM, header=LINE), ["--rate", "1000"]),
    "metadata like a header": ("# note: two words\n" + table(COMMAND_V, DISPLACEMENT_UM, delimiter=" "),
                               ["--rate", "1000", "--command", "0", "--displacement", "1"]),
    "text around the rows taken": (LINE + "9,x,1\n8,nan,2\n" + table(*RUN.values()) + "end,of,data\n",
                                   ["--rows", "2:-1"]),
}
TABLES = {name: (content, []) for name, content in RECOGNISED.items()} | TOLD


@pytest.mark.parametrize("name", TABLES)
def test_tables(name: str, imported: Callable) -> None:
    content, options = TABLES[name]
    recording, _ = imported(content, *options)
    same(recording)
    assert len(recording) == COUNT and recording.sample_rate_hz == 1000


# As the instruments write them: names over units, numbers of channels for names, settings beside the names, units and
# settings in lines of their own, a column for comments, no column of times.
SENSED = "CH2:0.25"  # um per volt; the columns of a scope are volts
VOLTS = COMMAND_V, DISPLACEMENT_UM / 0.25
LVM_HEAD = """LabVIEW Measurement
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
Multi_Headings\t{headings}
X_Columns\t{columns}
Time_Pref\tRelative
Date\t2026/11/20
Time\t12:03:04.9389457702636718750
***End_of_Header***

Channels\t2\t\t
Samples\t40\t40\t
Date\t2026/11/20\t2026/11/20\t
Y_Unit_Label\tVolts\tMicrons\t
X_Dimension\tTime\tTime\t
X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t
Delta_X\t0.001000\t0.001000\t
***End_of_Header***\t\t\t
X_Value\tDrive\tStage\tComment
"""
LVM = LVM_HEAD.format(headings="No", columns="One") + table(*RUN.values(), delimiter="\t")
NO_TIMES = table(COMMAND_V, DISPLACEMENT_UM, delimiter="\t").replace("\n", "\n\t")[:-1]
INSTRUMENTS = {
    "Rigol, rows counted": ("X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-2.000000e-02,1.000000e-03\n"
                            + table(np.arange(COUNT), *VOLTS).replace("\n", ",\n"), ["--command", "CH1"], "X"),
    "Rigol, seconds": ("X,CH1,CH2,\nSecond,Volt,Volt,\n" + table(TIME_S, *VOLTS).replace("\n", ",\n"),
                       ["--command", "CH1"], "X"),
    "Rigol, step beside the names": ("CH1(V),CH2(V),t0 = -2.000000e-02, tInc = 1.000000e-03,\n"
                                     + table(*VOLTS).replace("\n", ",,,\n"), ["--command", "CH1"], ""),
    "Keysight": ("x-axis,1,2\nsecond,Volt,Volt\n" + table(TIME_S, *VOLTS, form="{:+.6E}"), ["--command", "1"],
                 "x-axis"),
    "Tektronix": ("Model,MSO44\nFirmware Version,1.2\n\nHorizontal Units,s\nSample Interval,1e-03\nRecord Length,40\n"
                  "Probe Attenuation,10,10\nVertical Units,V,V\nVertical Offset,0,0\nLabel,,\n\nTIME,CH1,CH2\n"
                  + table(TIME_S, *VOLTS), ["--command", "CH1"], "TIME"),
    "Siglent": ("Record Length,Analog:40\nSample Interval,Analog:0.001\nVertical Units,CH1:V,CH2:V\n"
                "Source,CH1,CH2\nSecond,Volt,Volt\n" + table(TIME_S, *VOLTS), ["--command", "CH1"], "Source"),
    "LeCroy": ("LECROYWR,12345,Waveform\nSegments,1,SegmentSize,40\nSegment,TrigTime,TimeSinceSegment1\n"
               "#1,20-Nov-2026 12:03:04,0\nTime,CH1,CH2\n" + table(TIME_S, *VOLTS), ["--command", "CH1"], "Time"),
    "PicoScope": ("Time,CH1,CH2\n(ms),(V),(mV)\n\n" + table(TIME_S * 1e3, VOLTS[0], VOLTS[1]), ["--command", "CH1"],
                  "Time"),
    "Saleae": ("Time [s],CH1,CH2\n" + table(TIME_S, *VOLTS, form="{:.9f}"), ["--command", "CH1"], "Time"),
    "LabVIEW": (LVM, ["--command", "Drive"], "X_Value"),
    "LabVIEW, a comment": (LVM.replace("\n0\t0\t1\n", "\n0\t0\t1\tit begins\n"), ["--command", "Drive"], "X_Value"),
    "LabVIEW, decimal comma": (LVM.replace(".", ","), ["--command", "Drive"], "X_Value"),
    "LabVIEW, no times": (LVM_HEAD.format(headings="No", columns="No") + "\t" + NO_TIMES, ["--command", "Drive"], ""),
}


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_what_instruments_write(name: str, imported: Callable) -> None:
    content, options, time = INSTRUMENTS[name]
    options = [*options, "--displacement", "Stage" if "LabVIEW" in name else "2:0.25" if name == "Keysight" else SENSED]
    recording, output = imported(content, *options, name="run.txt")
    assert recording.sample_rate_hz == 1000 and len(recording) == COUNT
    np.testing.assert_allclose(np.diff(recording.time_s), 1e-3, rtol=1e-6)
    np.testing.assert_allclose(recording.command_V, COMMAND_V, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, rtol=1e-5, atol=1e-5)
    assert f"from column 0 '{time}" in output if time else "1000 samples per second" in output


PADDED = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-2.000000e-02,1.000000e-03\n"
BITS = np.char.mod("0x%02X", np.arange(COUNT) % 256)
BESIDE = {  # what scopes put beside the columns: separators below the settings' names, digital channels
    "one separator more": PADDED + table(np.arange(COUNT), *VOLTS).replace("\n", ",,\n"),
    "as many fields as names": PADDED + table(np.arange(COUNT), *VOLTS).replace("\n", ",,,\n"),
    "seconds, padded": PADDED.replace("Sequence", "Second") + table(TIME_S - 0.02, *VOLTS).replace("\n", ",,,\n"),
    **{f"digital channels{padding}": "X,CH1,D7-D0,D15-D8,CH2,Start,Increment,\nSequence,Volt,,,Volt,-2e-2,1e-3\n"
       + "".join(f"{k},{u:.9g},{bits},0x00,{z:.9g},{padding}\n"
                 for k, (u, bits, z) in enumerate(zip(VOLTS[0], BITS, VOLTS[1])))
       for padding in ("", ",", ",,")},
    **{f"a column of text{padding}": "X,CH1,State,CH2,Start,Increment\nSequence,Volt,,Volt,-2e-2,1e-3\n"
       + "".join(f"{k},{u:.9g},ok,{z:.9g}{padding}\n" for k, (u, z) in enumerate(zip(*VOLTS)))
       for padding in ("", ",", ",,,")},
}


@pytest.mark.parametrize("name", BESIDE)
def test_fields_beside_the_numbers(name: str, imported: Callable, refused: Callable, tmp_path: Path) -> None:
    recording, output = imported(BESIDE[name], "--command", "CH1", "--displacement", SENSED)
    np.testing.assert_allclose(recording.time_s, TIME_S - 0.02, atol=1e-9)
    np.testing.assert_allclose(recording.command_V, COMMAND_V, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, rtol=1e-5, atol=1e-5)
    assert "from column 0 'X" in output
    (tmp_path / "run.csv").write_text(BESIDE[name])
    assert "V, not um" in refused("import", tmp_path / "run.csv", "--command", "CH1", "--displacement", "CH2", "-o",
                                  refused.output)


def test_hexadecimal_numbers_are_text(imported: Callable, refused: Callable, tmp_path: Path) -> None:
    (tmp_path / "scope.csv").write_text(BESIDE["digital channels"])
    options = ["--command", "CH1", "--displacement", SENSED]
    assert "not used: D7-D0, D15-D8 (" in imported(tmp_path / "scope.csv", *options)[1]
    message = refused("import", tmp_path / "scope.csv", *options, "--also", "bits=D7-D0", "-o", refused.output)
    assert "column 2 'D7-D0' is '0x00', not a number" in message


def test_counted_rows_begin_where_the_scope_says(imported: Callable) -> None:
    content, options, _ = INSTRUMENTS["Rigol, rows counted"]
    recording, _ = imported(content, *options, "--displacement", SENSED)
    np.testing.assert_allclose(recording.time_s, TIME_S - 0.02, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in INSTRUMENTS if name not in ("LeCroy", "Saleae")])
def test_the_units_that_instruments_write_are_known(name: str, refused: Callable, tmp_path: Path) -> None:
    """Volts, or microns, are not taken for the other."""
    content, options, _ = INSTRUMENTS[name]
    (tmp_path / "run.txt").write_text(content)
    swapped = "Drive" if "LabVIEW" in name else "2" if name == "Keysight" else "CH2"
    message = refused("import", tmp_path / "run.txt", *options, "--displacement", swapped, "-o", refused.output)
    assert "V, not um" in message


def test_a_second_table_in_a_file(refused: Callable, imported: Callable, tmp_path: Path) -> None:
    (tmp_path / "two.lvm").write_text(LVM + LVM.partition("***\n")[2])
    options = ["--command", "Drive", "--displacement", "Stage"]
    message = refused("import", tmp_path / "two.lvm", *options, "-o", refused.output)
    assert f"If another table begins there, choose the rows of one with --rows, e.g. --rows 0:{COUNT}" in message
    same(imported(tmp_path / "two.lvm", *options, "--rows", f"0:{COUNT}")[0])


def test_old_encodings(imported: Callable) -> None:
    content = table(TIME_S, COMMAND_V, DISPLACEMENT_UM, header="t,voltage,position [µm]\n")
    for encoding in ("latin-1", "utf-16"):
        same(imported(content.encode(encoding))[0])


def test_units_are_exact(imported: Callable) -> None:
    """1234.5 nm is 1.2345 µm, not 1.2345000000000002."""
    values = np.arange(COUNT) + 1234.5
    recording, _ = imported(table(TIME_S, COMMAND_V, values, header="t,voltage,pos_nm\n", form="{:.17g}"))
    expected = [f"{1.2345 + k / 1000:.4f}" for k in range(COUNT)]
    assert [repr(value) for value in recording.displacement_um.tolist()] == expected


def test_what_is_printed_and_kept(imported: Callable, rdpi: Callable, tmp_path: Path) -> None:
    content = "# actuator: old\n# memory: reset\n" + table(
        TIME_S, COMMAND_V, DISPLACEMENT_UM, COMMAND_V, COMMAND_V + 1, TIME_S,
        header="t,Drive_V,disp [um],Vmon,temp_C,spare\n")
    recording, output = imported(content, "--note", "a note", "--actuator", "new", "--also", "other_axis_V=spare:mV",
                                 "--json", str(tmp_path / "result.json"), required=("monitor_V", "temperature_degC"))
    assert [line.split() for line in output.splitlines()[1:-2]] == [
        "time_s from column 0 't', s, recognised, unit assumed".split(),
        "command_V from column 1 'Drive_V', V, recognised".split(),
        "displacement_um from column 2 'disp [um]', um, recognised".split(),
        "monitor_V from column 3 'Vmon', V, recognised, unit assumed".split(),
        "temperature_degC from column 4 'temp_C', degC, recognised".split(),
        "other_axis_V from column 5 'spare', mV".split(),
    ]
    metadata = {"actuator": "new", "memory": "reset", "note": "a note", "source": "source.csv", "rows": f"0:{COUNT}",
                "source_columns": "time_s=0:s command_V=1:V displacement_um=2:um monitor_V=3:V temperature_degC=4:degC "
                                  "other_axis_V=5:mV"}
    assert recording.metadata == metadata | {"source_digest": recording.metadata["source_digest"]}
    np.testing.assert_array_equal(recording.columns["other_axis_V"], TIME_S / 1e3)
    result = json.loads((tmp_path / "result.json").read_text())["recordings"][0]
    assert result["samples"] == COUNT and result["columns"] == list(recording.columns)
    _, output = imported(content)
    assert "not used: spare (keep one with --also" in output


def test_counts_beyond_any_time(refused: Callable, tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    content, options, _ = INSTRUMENTS["Rigol, rows counted"]
    (tmp_path / "run.csv").write_text(content.replace("1.000000e-03", "1.000000e+308"))
    message = refused("import", tmp_path / "run.csv", *options, "--displacement", SENSED, "-o", refused.output)
    assert "time_s becomes infinite" in message and not recwarn.list


def test_numbers_beyond_a_double(refused: Callable, tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    largest = np.longdouble(np.finfo(float).max)
    with np.errstate(over="ignore"):
        matrix = np.column_stack([TIME_S, COMMAND_V, DISPLACEMENT_UM]).astype(np.longdouble)
        matrix[3, 2] = 2 * largest
    np.save(tmp_path / "long.npy", matrix)
    message = refused("import", tmp_path / "long.npy", *BY_NUMBER, "-o", refused.output)
    assert "long.npy, row 3: column 2 is inf" in message and not recwarn.list


def test_memory_belongs_to_the_first_row(imported: Callable) -> None:
    content = "# memory: reset\n" + table(*RUN.values(), header="t,voltage,position\n")
    assert imported(content, "--rows", ":20")[0].memory == "reset"
    later, _ = imported(content, "--rows", "20:")
    assert later.memory == "unknown" and later.metadata["rows"] == "20:40" and later.time_s[0] == 0.02
    assert imported(content, "--rows", "20:", "--memory", "carried")[0].memory == "carried"


def test_drive_and_reference(imported: Callable, refused: Callable, tmp_path: Path) -> None:
    drive, _ = imported(table(TIME_S, COMMAND_V, header="t,voltage\n"), "--as", "drive")
    assert list(drive.columns) == ["time_s", "command_V"]
    reference, _ = imported(table(DISPLACEMENT_UM, header="desired_um\n"), "--as", "reference", "--rate", "1000",
                            required=("reference_um",))
    np.testing.assert_array_equal(reference.reference_um, DISPLACEMENT_UM)
    source = tmp_path / "source.csv"
    message = refused("import", source, "--as", "drive", "--rate", "1000", "-o", refused.output)
    assert "no column looks like the command" in message


# --- MATLAB and NumPy ----------------------------------------------------------------------------------------------

def matlab(**variables: object) -> bytes:
    stream = io.BytesIO()
    scipy.io.savemat(stream, variables)
    return stream.getvalue()


def archive(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def array(values: np.ndarray, **options: bool) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values, **options)
    return stream.getvalue()


MATRIX = np.column_stack(list(RUN.values()))
ARRAYS = {
    "vectors.mat": (matlab(t=TIME_S[:, None], voltage=COMMAND_V[None], pos_nm=DISPLACEMENT_UM * 1e3, remark="x"), []),
    "rate.mat": (matlab(fs=1000, u=COMMAND_V, z=DISPLACEMENT_UM.astype(">f8")), []),
    "sample_time.mat": (matlab(Ts=0.001, u=COMMAND_V, z=DISPLACEMENT_UM), []),
    "matrix.mat": (matlab(data=MATRIX), ["--time", "data.0", "--command", "data.1", "--displacement", "2"]),
    "to_file.mat": (matlab(ans=MATRIX.T), ["--time", "ans.0", "--command", "ans.1", "--displacement", "ans.2"]),
    "struct.mat": (matlab(out={"time": TIME_S, "signals": {"values": MATRIX[:, 1:]}}),
                   ["--time", "out.time", "--command", "out.signals.values.0", "--displacement",
                    "out.signals.values.1"]),
    "dspace.mat": (matlab(run={"X": {"Data": TIME_S}, "Y": np.array([{"Data": COMMAND_V}, {"Data": DISPLACEMENT_UM}])}),
                   ["--time", "run.X.Data", "--command", "run.Y.0.Data", "--displacement", "run.Y.1.Data"]),
    "integers.mat": (matlab(t=np.arange(COUNT, dtype=np.uint32), u=COMMAND_V, z=DISPLACEMENT_UM), ["--time", "t:ms"]),
    "matrix.npy": (array(MATRIX), BY_NUMBER),
    "rows.npy": (array(MATRIX.T.astype(np.float32)), [*BY_NUMBER, "--rate", "1000"]),
    "fields.npy": (array(np.rec.fromarrays(list(RUN.values()), names="t,voltage,position")), []),
    "named.npz": (archive(t=TIME_S, command=COMMAND_V, displacement=DISPLACEMENT_UM), []),
    "rate.npz": (archive(sample_rate_hz=np.array(1000.0), command=COMMAND_V, displacement=DISPLACEMENT_UM), []),
    "matrix.npz": (archive(data=MATRIX), BY_NUMBER),
    "no_suffix": (matlab(t=TIME_S, u=COMMAND_V, z=DISPLACEMENT_UM), []),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays(name: str, imported: Callable) -> None:
    content, options = ARRAYS[name]
    recording, _ = imported(content, *options, name=name)
    assert set(recording.columns) == set(RUN) and len(recording) == COUNT and recording.sample_rate_hz == 1000
    for column, values in RUN.items():
        np.testing.assert_allclose(recording.columns[column], values, rtol=1e-6, atol=1e-9)


# --- what is refused -----------------------------------------------------------------------------------------------

def zipped(name: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive_file:
        archive_file.writestr(name, "x")
    return stream.getvalue()


def bad_row(row: int, line: str) -> str:
    lines = table(*RUN.values(), header="t,voltage,position\n").splitlines()
    lines[row + 1] = line
    return "\n".join(lines)


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
    "rate contradicts": ("x.csv", NAMED, ["--time", "t", "--rate", "500"], ["--rate", "is 500, but the times give 1000"]),
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
    "nests without end": ("loadmat(file)", "recursion"),
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


# --- several sources -----------------------------------------------------------------------------------------------

def test_several_sources(rdpi: Callable, tmp_path: Path) -> None:
    for name in ("a.csv", "b.dat"):
        (tmp_path / name).write_text(NAMED)
    result = rdpi("import", tmp_path / "a.csv", tmp_path / "b.dat", "-o", tmp_path / "runs")
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == ["a.csv", "b.csv"]
    same(read_recording(tmp_path / "runs" / "b.csv"))
    assert rdpi("import", tmp_path / "a.csv", "-o", f"{tmp_path}/one/").exit_code == 0
    assert (tmp_path / "one" / "a.csv").exists()


def test_several_sources_all_or_nothing(rdpi: Callable, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(NAMED)
    (tmp_path / "b.csv").write_text(bad_row(3, "0.003,x,1"))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a.dat").write_text(NAMED)
    a, b, again = tmp_path / "a.csv", tmp_path / "b.csv", tmp_path / "other" / "a.dat"
    for sources, output, needle in (([a, b], tmp_path / "runs", "b.csv:5"),
                                    ([a, again], tmp_path / "runs", "would both be written"),
                                    ([a, again], tmp_path / "runs.csv", "need a directory")):
        result = rdpi("import", *sources, "-o", output)
        assert result.exit_code == 2 and needle in result.output and not output.exists()


# --- any reasonable table ------------------------------------------------------------------------------------------

@settings(max_examples=60)
@given(delimiter=st.sampled_from([",", ", ", ";", "\t", " ", "   "]), end=st.sampled_from(["\n", "\r\n", " \n"]),
       form=st.sampled_from(["{!r}", "{:.17g}", "{:+.16e}"]), named=st.booleans(), order=st.permutations(range(4)),
       values=st.lists(st.floats(-1e9, 1e9), min_size=20, max_size=30))
def test_any_table(delimiter: str, end: str, form: str, named: bool, order: list[int], values: list[float],
                   tmp_path_factory: pytest.TempPathFactory) -> None:
    """Separators, number formats and the order of columns do not change what is read."""
    columns = [sample_times(len(values), 200), np.array(values), np.array(values[::-1]), np.arange(len(values)) * 1.5]
    names = ["t", "voltage", "position", "spare"]
    lines = [delimiter.join(names[index] for index in order)] if named else []
    lines += [delimiter.join(form.format(float(columns[index][row])) for index in order) for row in range(len(values))]
    path = tmp_path_factory.getbasetemp() / "any.txt"
    path.write_bytes("".join(line + end for line in lines).encode())
    by_number = {key: str(order.index(index)) for index, key in enumerate(("time", "command", "displacement"))}
    recording, _ = import_recording(str(path), Request(columns={} if named else by_number))
    for name, column in zip(("time_s", "command_V", "displacement_um"), columns):
        np.testing.assert_array_equal(recording.columns[name], column)


def test_what_import_writes_imports_again(tmp_path: Path, run_columns: dict[str, np.ndarray]) -> None:
    write_recording(tmp_path / "run.csv", run_columns, {"actuator": "x", "sample_rate_hz": 1000})
    again, _ = import_recording(str(tmp_path / "run.csv"), Request())
    for name, column in run_columns.items():
        np.testing.assert_array_equal(again.columns[name], column)
    assert again.metadata["actuator"] == "x" and again.sample_rate_hz == 1000
