"""The README's demo does what its table says: errors in % of the stroke on actuators that are no part of rdpi."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rdpi.data import Recording, excite
from rdpi.identify import Options, fit
from rdpi.simulate import chain

ROOT = Path(__file__).resolve().parents[2]
RMS, MAX = 0, 1
sys.path[:0] = [str(ROOT / "tests" / "bench"), str(ROOT / "examples" / "demo")]

import bench as vb  # noqa: E402
import demo  # noqa: E402

RATE_HZ = demo.RATE_HZ
LIMITS = excite.Limits(0.0, 100.0, sample_rate_hz=RATE_HZ)
LOOPS_ALONE = dict(creep_percent_per_decade=0.0, amplifier_hz=None, noise_um=0.0, adc_bits=None)


@pytest.fixture(scope="module")
def errors() -> dict[str, dict[str, list[list[float]]]]:
    """Actuator -> profile -> no model and demo.ACTUATORS[actuator].models -> (rms, max)."""
    done = subprocess.run([ROOT / ".venv/bin/python", ROOT / "examples/demo/demo.py"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    print(done.stdout[done.stdout.index("Tracking error"):])
    assert (ROOT / "build/demo/demo.png").stat().st_size > 10_000
    return json.loads((ROOT / "build/demo/demo.json").read_text())


@pytest.mark.slow
def test_plant_with_the_papers_law(errors: dict) -> None:
    """Both profiles within the paper's 0.9 % rms, and the rate law worth what it was worth there.

    There the model without it misses 1.0 % at 10 Hz, as one that is identified at 10 Hz does here. One identified from
    the commissioning drive misses less: that drive is as fast as the profile.
    """
    none, commissioned, dependent = errors["paper"]["5-20-35hz"]
    assert dependent[RMS] <= 0.9 and errors["paper"]["10hz"][2][RMS] <= 0.9
    drive, _ = excite.make_drive("sine", LIMITS, False, frequencies_hz=(10.0,))
    slow = tracked("paper", drive["command_V"], rate_independent=True)
    assert slow["10hz"][RMS] == pytest.approx(demo.PAPER["10hz"][1][RMS], abs=0.05)
    independent = slow["5-20-35hz"]
    assert independent[RMS] >= 3 * dependent[RMS]
    assert independent[MAX] >= 2 * dependent[MAX]
    assert independent[RMS] > commissioned[RMS] > 2 * dependent[RMS]
    assert none[RMS] > 2 * independent[RMS]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["preisach", "bouc-wen"])
def test_actuators_that_are_no_play_operators(errors: dict, kind: str) -> None:
    limits = {"preisach": (0.50, 0.40), "bouc-wen": (0.80, 0.95)}[kind]
    assert errors[kind]["10hz"][2][RMS] <= limits[0]
    assert errors[kind]["5-20-35hz"][2][RMS] <= limits[1]
    for profile in errors[kind].values():
        none, independent, dependent = profile
        assert none[RMS] > 4 * max(independent[RMS], dependent[RMS])
        assert independent[RMS] >= dependent[RMS] or kind == "preisach", "its lag leaves the rate law hardly anything"


@pytest.mark.slow
def test_actuator_whose_amplifier_lags_and_whose_converter_is_late(errors: dict) -> None:
    """The whole chain tracks it as well as the same actuator with a fast amplifier and converter; the operator alone
    does not."""
    assert list(demo.ACTUATORS["late"].models) == ["operator alone", "whole chain"]
    for profile, (none, operator, whole) in errors["late"].items():
        plain = errors["preisach"][profile][-1]
        assert whole[RMS] <= 1.15 * plain[RMS] and whole[MAX] <= 2 * plain[MAX]
        assert operator[RMS] > 3 * whole[RMS]
        assert none[RMS] > 1.5 * operator[RMS]
    effects = {effect["name"]: {name: one["value"] for name, one in effect["parameters"].items()} for effect in
               json.loads((ROOT / "build/demo/late-whole-chain.json").read_text())["effects"]}
    assert {"delay", "lag"} <= set(effects) <= {"delay", "lag", "relaxation", "creep"}, "the actuator relaxes and creeps"
    assert effects["delay"]["delay_s"] == pytest.approx(1e-3, rel=0.05)


def as_printed(value: float) -> str:
    return f"{value:.1f}" if value >= 0.995 else f"{value:.2f}"


def agree(printed: str, measured: str) -> bool:
    """To the last digit; a library's other version may move it by one."""
    unit = 10.0 ** -len(printed.partition(".")[2])
    return abs(float(printed) - float(measured)) <= 1.01 * unit


@pytest.mark.slow
def test_the_readmes_table_is_what_the_demo_finds(errors: dict) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()
            if re.match(r"\|[^|]*\| (the paper's law|Preisach|Bouc-Wen)", line)]
    assert len(rows) == 6
    kinds = [(profile, kind) for profile in demo.PROFILES for kind in ("paper", "preisach", "bouc-wen")]
    for row, (profile, kind) in zip(rows, kinds):
        same(row[2:], errors[kind][profile], f"{profile}, {kind}")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()
            if re.match(r"\| (no model|operator alone|whole chain)[ |]", line)]
    assert len(rows) == 3
    for k, row in enumerate(rows):
        same(row[1:], [errors["late"][profile][k] for profile in demo.PROFILES], f"late, {row[0]}")


def same(cells: list[str], pairs: list[list[float]], what: str) -> None:
    """Cells of README.md hold the rms and max that were found."""
    for cell, pair in zip(cells, pairs, strict=True):
        for printed, found in zip(cell.split(" / "), pair, strict=True):
            assert agree(printed, as_printed(found)), f"README.md: {what}: {cell}; found {pair}"


@pytest.mark.slow
def test_the_readmes_picture_is_what_the_demo_draws(errors: dict) -> None:
    """To replace it: cp build/demo/tracking.svg examples/demo/"""
    committed, drawn = ((ROOT / folder / "tracking.svg").read_text(encoding="utf-8") for folder in
                        ("examples/demo", "build/demo"))
    legend = r"<text[^>]*>([a-z ]+): ([\d.]+) % rms, ([\d.]+) % max<"
    shown, found = re.findall(legend, committed), re.findall(legend, drawn)
    assert [one[0] for one in shown] == [one[0] for one in found] == demo.models_of(demo.FRONT_PAGE)
    for one, other in zip(shown, found):
        assert agree(one[1], other[1]) and agree(one[2], other[2])


def run_of(memory: str, **columns: np.ndarray) -> Recording:
    samples = len(next(iter(columns.values())))
    metadata = {"memory": memory, "sample_rate_hz": str(RATE_HZ)}
    return Recording("run.csv", metadata, {"time_s": np.arange(samples) / RATE_HZ, **columns})


def tracked(kind: str, command_V: np.ndarray, rate_independent: bool = False) -> dict[str, tuple[float, float]]:
    """rms and max in % per profile, as in the demo, of an actuator that is nothing but its loops."""
    def play(command_V: np.ndarray, seed: int) -> np.ndarray:
        actuator = vb.make(kind, seed, **LOOPS_ALONE)
        actuator.demagnetise(RATE_HZ)
        return actuator.run(command_V, RATE_HZ)

    recorded = run_of("reset", command_V=command_V, displacement_um=play(command_V, 0))
    model = fit([recorded], Options(min_V=0.0, max_V=100.0, dac_bits=16, rate_independent=rate_independent)).model
    found = {}
    for profile in demo.PROFILES:
        reference = vb.paper_profile(profile, RATE_HZ, 2.0)
        steps, _ = chain.follow(model, run_of("unknown", reference_um=reference))
        found[profile] = vb.error_percent(play(steps.drive_V.astype(float), 7), reference, RATE_HZ)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["preisach", "bouc-wen"])
def test_what_remains_is_the_shape_of_the_loops(errors: dict, kind: str) -> None:
    """Most of the mean square stays where there is neither creep nor amplifier, noise nor converter."""
    drive, _ = excite.make_drive("commission", LIMITS, False, duration_s=float(demo.COMMISSION_S))
    alone = tracked(kind, drive["command_V"])
    print(f"{kind}, loops alone: " + ", ".join(f"{profile} {rms:.2f} %" for profile, (rms, _) in alone.items()))
    for profile, (rms, _) in alone.items():
        assert rms**2 > errors[kind][profile][2][RMS] ** 2 / 2
