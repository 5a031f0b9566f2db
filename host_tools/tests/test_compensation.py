"""The drive of a reference, and what is told of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_chain import paper_model, recording, run_after

from rdpi import firmware
from rdpi.board import compensate, emulator, memory_after
from rdpi.board.sweep import OFF_THE_MIDDLE, STILL
from rdpi.data import Recording
from rdpi.data.align import AMID
from rdpi.errors import BadInput
from rdpi.model import Drive
from rdpi.simulate import chain, memory

TIME_S = np.arange(500) * 1e-4


def reference(scale: float = 1.0, **columns: np.ndarray) -> Recording:
    um = 3 + 2 * scale * np.sin(2 * np.pi * 20 * TIME_S)
    return Recording("reference.csv", {"sample_rate_hz": "10000"}, {"time_s": TIME_S, "reference_um": um, **columns})


def test_columns_are_those_of_the_reference_and_the_drive() -> None:
    model, run = paper_model(), reference(temperature_degC=TIME_S)
    found = compensate(model, run)
    steps = chain.follow(model, run)[0]
    assert list(found.columns) == ["time_s", "reference_um", "temperature_degC", "command_V", "rate_um_per_s", "flags"]
    assert np.array_equal(found.columns["command_V"], steps.drive_V)
    assert np.array_equal(found.columns["flags"], steps.flags) and found.metadata == run.metadata
    assert all(values.dtype == float for values in found.columns.values())
    assert found.flag_counts == firmware.flag_counts(steps.flags) and found.score is None and not found.why_unknown
    model.drive.dac_bits = 16
    assert np.array_equal(compensate(model, run).columns["dac_code"], chain.follow(model, run)[0].dac_code)


def test_another_column_is_followed_and_called_the_reference() -> None:
    run = reference()
    other = replace(run, columns={"time_s": TIME_S, "wanted_um": run.columns["reference_um"]})
    found = compensate(paper_model(), other, "wanted_um")
    assert np.array_equal(found.columns["reference_um"], run.columns["reference_um"])
    assert np.array_equal(found.columns["command_V"], compensate(paper_model(), run).columns["command_V"])


def test_a_recorded_command_is_kept_and_compared() -> None:
    model, (_, run) = paper_model(), run_after(0.5)
    found = compensate(model, run, "displacement_um", "f64")
    assert np.array_equal(found.columns["recorded_V"], run.command_V)
    assert found.score == chain.score(found.steps.drive_V, run.command_V)
    still = reference(command_V=np.full(500, 3.0))
    assert compensate(model, still).score is None and "recorded_V" in compensate(model, still).columns


def test_what_was_asked_for() -> None:
    values = reference(100).columns["reference_um"].copy()
    values[3] = np.nan
    found = compensate(paper_model(), replace(reference(), columns={"time_s": TIME_S, "reference_um": values}))
    assert found.flag_counts["range"] > 0 and found.flag_counts["input"] == 1
    assert found.asked_um == (np.nanmin(values), np.nanmax(values))
    moved = run_after(0.5)[1]
    shifted = replace(moved, columns={**moved.columns, "displacement_um": moved.displacement_um + 1})
    found = compensate(paper_model(), shifted, "displacement_um", remove_offset=True)
    assert found.offset_um == pytest.approx(1, abs=0.05)
    assert found.asked_um[0] == pytest.approx(shifted.displacement_um.min() - found.offset_um)


@pytest.mark.parametrize("engine", ["f32", "q31", "f64", "numpy"])
def test_engines(engine: str) -> None:
    found, exact = (compensate(paper_model(), reference(), engine=name) for name in (engine, "f64"))
    assert found.columns["command_V"] == pytest.approx(exact.columns["command_V"], abs=2e-3)


def test_an_emulated_board(monkeypatch: pytest.MonkeyPatch) -> None:
    """It gets what it needs; the emulator itself has its own tests."""
    given = {}

    def step(model: object, reference_um: np.ndarray, **options: object) -> firmware.Steps:
        given.update(options)
        return chain.follow(paper_model(), reference())[0]

    monkeypatch.setattr(emulator, "step", step)
    run = reference()
    late = replace(paper_model(), effects=[{"name": "delay", "parameters": {"delay_s": 1e-3}}])
    compensate(late, run, engine="qemu-m3", fixed_point=True, sweep=True, report=print)
    chained = given.pop("chain")
    assert chained.acts and chained.delay_s == 1e-3
    assert given == {"run": run, "board": "qemu-m3", "fixed_point": True, "sweep": True, "swept": 0, "report": print}
    swept = replace(run, metadata={**run.metadata, "memory": "reset"})
    compensate(late, swept, engine="qemu-m3")
    assert given["swept"] == round(memory.SWEPT_S / run.sample_time_s) > 0
    compensate(late, replace(swept, metadata={**run.metadata, "memory": "unknown"}), engine="qemu-m3")
    assert given["swept"] == 0


def test_what_an_engine_cannot_do() -> None:
    with pytest.raises(BadInput, match="--fixed-point"):
        compensate(paper_model(), reference(), engine="q31", fixed_point=True)
    with pytest.raises(BadInput, match="^m.json: no fixed point"):
        compensate(replace(paper_model(window_s=4.5), where="m.json"), reference(), engine="q31")
    with pytest.raises(BadInput, match="reference.csv"):
        compensate(paper_model(), replace(reference(), columns={"time_s": TIME_S, "reference_um": TIME_S + 1e9}))


# --- memory after the start-up sweep -------------------------------------------------------------------------------

def swept(end_V: float) -> object:
    """Of a drive from -100 to 200 V, whose middle is 50 V."""
    model = paper_model()
    model.drive = Drive(-100.0, 200.0, sweep_end_V=end_V)
    return model


@pytest.mark.parametrize(("end_V", "first_V", "memory", "why"), [
    (50.0, 50.0, "reset", ""), (50.0, 50.0 + 299 * STILL, "reset", ""), (50.0, 50.0 - 301 * STILL, "unknown", ""),
    (50 + 299 * AMID, 50 + 299 * AMID, "reset", ""), (50 - 301 * AMID, 50 - 301 * AMID, "unknown", OFF_THE_MIDDLE),
    (200.0, 200.0, "unknown", OFF_THE_MIDDLE), (200.0, 50.0, "unknown", "")])
def test_memory_after_the_sweep(end_V: float, first_V: float, memory: str, why: str) -> None:
    assert memory_after(swept(end_V), first_V) == (memory, why)


def test_memory_after_a_sweep_whose_share_is_known() -> None:
    model = swept(200.0)
    model.memory = replace(model.memory, sweep_share=0.5)
    assert memory_after(model, 200.0) == ("reset", "") and memory_after(model, 50.0) == ("unknown", "")


def test_memory_of_a_drive_after_the_sweep() -> None:
    found = compensate(swept(200.0), replace(reference(), columns={
        "time_s": TIME_S, "reference_um": np.full(500, 1e5)}), sweep=True)  # the drive stays at its end
    assert found.metadata == {"sample_rate_hz": "10000", "memory": "unknown"} and found.why_unknown == OFF_THE_MIDDLE
    recorded = recording(np.zeros(500), memory="reset")
    run = replace(recorded, columns={**recorded.columns, "reference_um": reference(1).columns["reference_um"]})
    assert compensate(paper_model(), run).metadata["memory"] == "reset"  # as the reference's file says
