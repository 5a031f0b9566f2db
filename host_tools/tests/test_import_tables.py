"""`rdpi import`: what is recognised in tables, and the tables that instruments write."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sources import BY_NUMBER, COMMAND_V, COUNT, DISPLACEMENT_UM, LINE, NAMED, RUN, TIME_S, same, table

RECOGNISED = {
    "own format": "# actuator: a\n# memory: reset\n" + table(*RUN.values(), header=",".join(RUN) + "\n"),
    "units in names": table(TIME_S * 1e3, COMMAND_V * 1e3, DISPLACEMENT_UM * 1e3, header="Time_ms,Voltage_mV,pos_nm\n"),
    "units in brackets": table(TIME_S, COMMAND_V / 1e3, DISPLACEMENT_UM / 1e3, header="t [s],U (kV),Position [mm]\n"),
    "one-letter names": table(TIME_S * 1e6, COMMAND_V, DISPLACEMENT_UM, header="t/us;u;z [µm]\n", delimiter=";"),
    "tabs": table(*RUN.values(), header="Time\tDrive voltage V\tdisp\n", delimiter="\t"),
    "white space": table(*RUN.values(), header="  time   drive   disp\n", delimiter="   "),
    "names of piezos": table(*RUN.values(), header="time (s),Piezo drive (V),Stage position (um)\n"),
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
