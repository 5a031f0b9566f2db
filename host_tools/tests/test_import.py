"""`rdpi import`: the measured stack, MATLAB and NumPy files, several sources, any reasonable table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sources import ARRAYS, COUNT, NAMED, RUN, bad_row, same

from rdpi.data import Request, import_recording, read_recording, sample_times, write_recording


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


# --- MATLAB and NumPy ----------------------------------------------------------------------------------------------

@pytest.mark.parametrize("name", ARRAYS)
def test_arrays(name: str, imported: Callable) -> None:
    content, options = ARRAYS[name]
    recording, _ = imported(content, *options, name=name)
    assert set(recording.columns) == set(RUN) and len(recording) == COUNT and recording.sample_rate_hz == 1000
    for column, values in RUN.items():
        np.testing.assert_allclose(recording.columns[column], values, rtol=1e-6, atol=1e-9)


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
                                    ([a, again], tmp_path / "runs.csv", "need a folder")):
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
