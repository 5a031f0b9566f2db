"""What tests of `rdpi import` take in: one run as table, MATLAB and NumPy file."""

from __future__ import annotations

import io

import numpy as np
import scipy.io

from rdpi.data import Recording, sample_times

COUNT = 40
TIME_S = sample_times(COUNT, 1000)
COMMAND_V = np.round(5 - 5 * np.cos(2 * np.pi * 50 * TIME_S), 6)
DISPLACEMENT_UM = np.round(0.25 * COMMAND_V + 1, 6)
RUN = {"time_s": TIME_S, "command_V": COMMAND_V, "displacement_um": DISPLACEMENT_UM}


def table(*columns: np.ndarray, header: str = "", delimiter: str = ",", form: str = "{:.9g}") -> str:
    return header + "".join(delimiter.join(form.format(value) for value in row) + "\n" for row in zip(*columns))


def same(recording: Recording) -> None:
    for name, column in RUN.items():
        np.testing.assert_allclose(recording.columns[name], column, rtol=1e-8, atol=1e-9)


LINE = "t,voltage,position\n"
NAMED = table(*RUN.values(), header=LINE)
BY_NUMBER = ["--time", "0", "--command", "1", "--displacement", "2"]


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


def bad_row(row: int, line: str) -> str:
    lines = table(*RUN.values(), header="t,voltage,position\n").splitlines()
    lines[row + 1] = line
    return "\n".join(lines)
