"""The virtual bench is what it claims to be: independent, deterministic, and a plausible piezo actuator."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import bench as vb  # noqa: E402
from bench_laws import LAWS, Paper, Preisach  # noqa: E402

RATE_HZ = 10_000.0
KINDS = sorted(LAWS)
OTHER_KINDS = ["bouc-wen", "preisach"]
STILL = dict(creep_percent_per_decade=0.0, noise_um=0.0, adc_bits=None)
QUASI_STATIC = dict(STILL, amplifier_hz=None, rate_dependence=0.0)


def loop_width(bench: vb.Bench, frequency_hz: float, amplitude_V: float = 42.0) -> float:
    """Distance of the two branches at mid command in the third cycle of a sine, % of the loop's peak to peak."""
    n = round(RATE_HZ / frequency_hz)
    command = 50 + amplitude_V * np.sin(2 * np.pi * np.arange(3 * n) / n)
    z = bench.run(command, RATE_HZ)[-n:]
    quarter = n // 4  # from the crest on, the sine falls for half a cycle
    falling, rising = np.arange(quarter, 3 * quarter), np.r_[3 * quarter:n, 0:quarter]
    c = command[-n:]
    return 100 * (np.interp(-50, -c[falling], z[falling]) - np.interp(50, c[rising], z[rising])) / np.ptp(z)


def path_through(*corners_V: float, points: int = 100) -> np.ndarray:
    """Straight lines from corner to corner, each `points` samples long and ending on its corner."""
    return np.concatenate([np.linspace(a, b, points + 1)[1:] for a, b in zip(corners_V, corners_V[1:])])


def foreign_imports(source: str) -> set[str]:
    """What the source imports beyond NumPy, SciPy and the standard library, and means of loading code unseen."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(("." * node.level) + (node.module or "").split(".")[0])
        elif isinstance(node, ast.Name) and node.id in ("__import__", "exec", "eval"):
            found.add(node.id)
    loaders = {"ctypes", "importlib", "runpy", "subprocess"}
    return found - (sys.stdlib_module_names - loaders) - {"numpy", "scipy", "bench_laws"}


@pytest.mark.parametrize("name", ["bench.py", "bench_laws.py"])
def test_shares_no_code_with_rdpi(name):
    assert foreign_imports((HERE / name).read_text()) == set()


@pytest.mark.parametrize("source", ["import rdpi", "from rdpi._f32 import lib", "import ctypes", "from . import rdpi",
                                    "def f():\n    __import__('rdpi')"])
def test_independence_check_notices(source):
    assert foreign_imports(source)


@pytest.mark.parametrize("kind", KINDS)
def test_seed_decides_everything(kind):
    command = vb.paper_profile("10hz", RATE_HZ, 0.2) * 8
    first, again, other = (vb.make(kind, seed).run(command, RATE_HZ) for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("kind", KINDS)
def test_memory_is_carried_between_runs(kind):
    command = 50 + 45 * np.sin(np.arange(3000) / 200)
    whole = vb.make(kind, adc_bits=None).run(command, RATE_HZ)
    bench = vb.make(kind, adc_bits=None)
    pieces = [bench.run(piece, RATE_HZ) for piece in np.split(command, [1, 700, 1999])]
    assert np.allclose(np.concatenate(pieces), whole, rtol=0, atol=1e-9)
    assert np.abs(vb.make(kind, adc_bits=None).run(command[1999:], RATE_HZ) - whole[1999:]).max() > 0.05


def trace_of_minor_loop(kind: str, **overrides: float | None) -> float:
    """Largest later difference in um that a closed minor loop makes."""
    tails = []
    for minor in [(), (62, 40)]:
        bench = vb.make(kind, **{**STILL, **overrides})
        bench.run(path_through(50, 5, 90, 40, *minor), RATE_HZ)
        tails.append(bench.run(path_through(40, 20, 95, 5, 30), RATE_HZ))
    return float(np.abs(tails[0] - tails[1]).max())


def test_preisach_wipes_out_closed_minor_loops():
    assert trace_of_minor_loop("preisach", **QUASI_STATIC) < 1e-9
    assert trace_of_minor_loop("preisach") > 0.01
    assert trace_of_minor_loop("preisach", **dict(QUASI_STATIC, creep_percent_per_decade=1.5)) > 0.005
    assert trace_of_minor_loop("bouc-wen", **QUASI_STATIC) > 0.01  # that equation has no return-point memory


def test_preisach_is_the_sum_of_its_relays():
    law = Preisach(rate_dependence=0.0)
    grid = np.linspace(-1, 1, 201)[1:] - 0.005
    up, down = (side.ravel() for side in np.meshgrid(grid, grid, indexing="ij"))
    weight = np.where(up > down, np.exp(-(up - down) / law.spread) * (1 + law.skew * (up + down) / 2), 0.0)
    path = path_through(0, -1, 1, -1, 0.5, -0.6, 0.3, -0.2, 0.1, -0.1, 0.4, -0.7, 0.9, -0.3, points=20)
    relays, summed = np.zeros(len(up)), []
    for u in path:
        relays[u >= up], relays[u <= down] = 1.0, 0.0
        summed.append(weight @ relays / weight.sum())
    switched = law.switch(path, 1.0)[1][39:]  # from both saturations on, the past is gone
    share = (switched - switched.min()) / np.ptp(switched)
    assert np.abs(share - summed[39:]).max() < 0.005


def minor_loop_height(bench: vb.Bench, bias_V: float) -> float:
    """Distance in um of the branches amid a minor loop of 30 V."""
    bench.run(path_through(50, 0, 100, bias_V - 15), RATE_HZ)
    z = bench.run(path_through(bias_V - 15, bias_V + 15, bias_V - 15), RATE_HZ)
    return z[149] - z[49]


@pytest.mark.parametrize("kind", OTHER_KINDS)
def test_is_no_sum_of_plays(kind):
    """The same minor loop at another bias has another size; for any sum of plays it has the same."""
    low, high = (minor_loop_height(vb.make(kind, **QUASI_STATIC), bias) for bias in (20, 80))
    assert abs(high / low - 1) > 0.1
    low, high = (minor_loop_height(vb.make("preisach", skew=0.0, **QUASI_STATIC), bias) for bias in (20, 80))
    assert high == pytest.approx(low, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_loop_is_as_wide_as_a_stacks(kind):
    assert 12 <= loop_width(vb.make(kind), 1.0) <= 18


@pytest.mark.parametrize("kind, nothing", [("preisach", {"irreversible": 0.0}), ("bouc-wen", {"share": 0.0})])
def test_loop_closes_without_hysteresis(kind, nothing):
    assert abs(loop_width(vb.make(kind, **QUASI_STATIC, **nothing), 1.0)) < 0.05


@pytest.mark.parametrize("kind, least, most", [("paper", 10, 20), ("preisach", 3, 7), ("bouc-wen", 3, 7)])
def test_loop_widens_with_rate(kind, least, most):
    slow, fast = (loop_width(vb.make(kind), frequency) for frequency in (1.0, 30.0))
    assert least < fast - slow < most
    slow, fast = (loop_width(vb.make(kind, **QUASI_STATIC), frequency) for frequency in (1.0, 30.0))
    assert abs(fast - slow) < 0.6  # coarser sampling of the turning points at 30 Hz is all that is left


def creep_per_decade(bench: vb.Bench, start_s: float, rate_hz: float = 1000.0) -> float:
    """Growth of a step from start_s to ten times that, % of the step at start_s."""
    bench.demagnetise(rate_hz)
    rest = bench.run(np.full(200, 50.0), rate_hz).mean()
    step = bench.run(np.full(round(11 * start_s * rate_hz), 80.0), rate_hz) - rest
    first, last = (step[round(0.95 * s * rate_hz):round(1.05 * s * rate_hz)].mean() for s in (start_s, 10 * start_s))
    return 100 * (last / first - 1)


@pytest.mark.parametrize("kind", OTHER_KINDS)
def test_creeps_one_to_two_percent_per_decade(kind):
    for start_s in (0.1, 1.0, 4.0):
        assert 1.0 < creep_per_decade(vb.make(kind), start_s) < 2.0
    assert abs(creep_per_decade(vb.make(kind, **QUASI_STATIC), 1.0)) < 1e-6


def delay_s(bench: vb.Bench, frequency_hz: float = 35.0) -> float:
    """Phase lag of the first harmonic, as a time."""
    t = np.arange(round(4 * RATE_HZ / frequency_hz)) / RATE_HZ
    z = bench.run(50 + 40 * np.sin(2 * np.pi * frequency_hz * t), RATE_HZ)
    phase, half = 2 * np.pi * frequency_hz * t, len(t) // 2
    columns = np.column_stack([np.sin(phase), np.cos(phase), np.ones_like(t)])
    a, b, _ = np.linalg.lstsq(columns[half:], z[half:], rcond=None)[0]
    return -np.arctan2(b, a) / (2 * np.pi * frequency_hz)


def test_amplifier_lags_less_than_60_us():
    linear = dict(STILL, rate_dependence=0.0, irreversible=0.0)
    assert 10e-6 < delay_s(vb.make("preisach", **linear)) < 60e-6
    assert abs(delay_s(vb.make("preisach", amplifier_hz=None, **linear))) < 1e-6


@pytest.mark.parametrize("late_s", [1e-3, 0.25e-3])
@pytest.mark.parametrize("chunk", [1, 7, 4000])
def test_converter_is_late(late_s, chunk):
    """By whole holds the readings are shifted; a part of one delays a slow sine as long. Chunks change nothing."""
    command = 50 + 30 * np.sin(2 * np.pi * 10 * np.arange(4000) / RATE_HZ)
    plain, late = vb.make("preisach", **STILL), vb.make("preisach", delay_s=late_s, **STILL)
    due = plain.run(np.append(np.full(20, 50.0), command), RATE_HZ)[20:]
    got = np.concatenate([late.run(piece, RATE_HZ) for piece in
                          np.split(np.append(np.full(20, 50.0), command), range(chunk, 4020, chunk))])[20:]
    whole, part = divmod(late_s * RATE_HZ, 1)
    whole = round(whole)
    expected = (1 - part) * due[1000 - whole:-whole] + part * due[999 - whole:-whole - 1]
    assert np.allclose(got[1000:], expected, rtol=0, atol=1e-9 if not part else 2e-3)
    assert np.abs(got[1000:] - due[1000:]).max() > 0.02


def test_mechanics_ring_at_their_frequency():
    settings = dict(QUASI_STATIC, resonance_damping=0.05)
    stiff = vb.make("preisach", **QUASI_STATIC).run(np.append(np.full(10, 50.0), np.full(2000, 60.0)), RATE_HZ)
    soft = vb.make("preisach", resonance_hz=300.0, **settings).run(
        np.append(np.full(10, 50.0), np.full(2000, 60.0)), RATE_HZ)
    step, swing = stiff[-1] - stiff[0], (soft - stiff)[10:]
    assert abs(swing[-1]) < 0.001 * step and np.abs(soft[:10] - stiff[:10]).max() < 1e-9
    assert (soft.max() - stiff[-1]) / step == pytest.approx(np.exp(-0.05 * np.pi / np.sqrt(1 - 0.05**2)), rel=0.02)
    crossings = np.flatnonzero(np.diff(np.sign(swing[:400])))
    assert np.diff(crossings)[1:9].mean() == pytest.approx(RATE_HZ / 600, rel=0.02)


@pytest.mark.parametrize("kind", OTHER_KINDS)
def test_sensor_has_noise_and_16_bits(kind):
    bench = vb.make(kind)
    reading = bench.run(np.full(5000, 50.0), RATE_HZ)
    assert np.std(reading) == pytest.approx(bench.noise_um, rel=0.1)
    assert 0.0002 < bench.noise_um / bench.stroke_um < 0.0005
    codes = (reading - bench.adc_range_um[0]) / (20.0 / 2**16)
    assert np.allclose(codes, np.round(codes), atol=1e-6)
    assert np.ptp(vb.make(kind, **QUASI_STATIC).run(np.full(5000, 50.0), RATE_HZ)) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_demagnetising_makes_memory_known(kind):
    def readings(demagnetise: bool) -> np.ndarray:
        benches = [vb.make(kind, seed, **STILL) for seed in range(4)]
        for bench in benches:
            if demagnetise:
                bench.demagnetise(RATE_HZ, to_V=30.0)
        return np.array([bench.run(path_through(30, 60, 20, 50), RATE_HZ) for bench in benches])

    percent = [100 * np.ptp(readings(demagnetise), axis=0).max() / 12.5 for demagnetise in (False, True)]
    assert percent[0] > 1 and percent[1] < 0.2


@pytest.mark.parametrize("rate, share", [(1.0, 1.0), (725.0, 0.5), (1305.0, 0.1), (1450.0, 0.0), (2000.0, 0.0)])
def test_papers_first_slope_vanishes_at_1450_um_per_s(rate, share):
    law = Paper()
    step_s = 0.01 / rate  # 0.01 um per sample
    x = np.concatenate([np.arange(0, -6, -0.01), np.arange(-6, -5.2, 0.01)])
    z = law(x / law.half_range_um, step_s)
    slope = np.diff(z)[-5:].mean() / 0.01
    assert slope == pytest.approx(max(share * law.rest[0], law.floor), rel=0.002)


def test_papers_higher_slopes_fall_less():
    fall = -Paper().change / Paper().rest
    assert np.all(np.diff(fall) < 0) and fall[-1] > 0


def test_rails_clip_and_nonsense_is_refused():
    assert np.array_equal(*(vb.make("preisach").run(np.full(50, v), RATE_HZ) for v in (100.0, 120.0)))
    assert not np.array_equal(*(vb.make("preisach").run(np.full(50, v), RATE_HZ) for v in (100.0, 99.0)))
    for wrong in ([np.nan, 1.0], [[1.0]]):
        with pytest.raises(ValueError):
            vb.make("paper").run(np.array(wrong), RATE_HZ)
    with pytest.raises(TypeError):
        vb.make("paper", colour=1.0)


@pytest.mark.parametrize("name, peak_um_per_s", [("10hz", np.pi * 10 * 12.5), ("5-20-35hz", 876)])
def test_profiles_span_the_stroke_within_the_identified_rates(name, peak_um_per_s):
    reference = vb.paper_profile(name, 20_000, 4.0)
    assert reference.min() == pytest.approx(0, abs=0.001) and reference.max() == pytest.approx(12.5, abs=0.001)
    assert np.abs(np.diff(reference)).max() * 20_000 == pytest.approx(peak_um_per_s, rel=0.005)
    assert np.abs(reference[:20] - 6.25).max() < 1e-3 and np.abs(np.diff(reference[:20])).max() * 20_000 < 2
    with pytest.raises(ValueError):
        vb.paper_profile("7hz", 20_000, 1.0)


def test_command_line_records_in_sequence(tmp_path):
    time_s = np.arange(500) / 5000
    drives = {"a.csv": 50 + 40 * np.sin(60 * time_s), "b.csv": 50 - 20 * time_s}
    for name, command in drives.items():
        table = np.column_stack([time_s, command, command / 8])
        header = "# note: own\ntime_s,command_V,reference_um"
        np.savetxt(tmp_path / name, table, "%.7f", ",", header=header, comments="")
    paths = [str(tmp_path / name) for name in drives]
    assert vb.main(["bouc-wen", *paths, "--out-dir", str(tmp_path / "runs"), "--seed", "5"]) == 0

    bench = vb.make("bouc-wen", 5)
    bench.demagnetise(5000.0)
    for name, memory in [("a.csv", "reset"), ("b.csv", "carried")]:
        metadata, columns, rate_hz = vb.read_drive(tmp_path / "runs" / name)
        assert metadata == {"note": "own", "actuator": "virtual bench, bouc-wen, seed 5", "memory": memory,
                            "sample_rate_hz": "5000"}
        assert list(columns) == ["time_s", "command_V", "displacement_um", "reference_um"] and rate_hz == 5000
        command = np.round(drives[name], 7)
        assert np.allclose(columns["command_V"], command, atol=1e-8)
        assert np.allclose(columns["displacement_um"], bench.run(command, 5000.0), atol=1e-8)

    assert vb.main(["bouc-wen", paths[1], "-o", str(tmp_path / "one.csv"), "--no-demagnetise"]) == 0
    assert vb.read_drive(tmp_path / "one.csv")[0]["memory"] == "unknown"
    with pytest.raises(SystemExit) as stop:
        vb.main(["bouc-wen", *paths, "-o", str(tmp_path / "two.csv")])
    assert stop.value.code == 2 and not (tmp_path / "two.csv").exists()


def test_command_line_names_what_may_be_set(capsys):
    with pytest.raises(SystemExit) as stop:
        vb.main(["bouc-wen", "a.csv", "-o", "b.csv", "--set", "delay=0.001"])
    assert stop.value.code == 2 and "bouc-wen has no delay; it has stroke_um, delay_s," in capsys.readouterr().err
