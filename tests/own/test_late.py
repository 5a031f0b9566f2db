"""The examples with a circular DMA, on this computer, with the DMA modelled and the processor blocked.

stm32_model.h plays the DMA and knows of each word whether it was new; late.c blocks the processor.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from test_own import HERE, OWN, ROOT, actuator, library, parameters, run

AT = 2300  # well behind the sweep; the reference moves
HALF, MARGIN = 16, 4
SAFE_V = 0.0, 40.0
SANITIZE = "-fsanitize=address,undefined", "-fno-sanitize-recover=all"


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """"one" or "two" axes, "q31" or "f32" -> the example with its DMA."""
    work = tmp_path_factory.mktemp("late")
    parameters(12, work)
    made = {}
    for axes, names in (("one", ["axis"]), ("two", ["axis_x", "axis_y"])):
        sources = [actuator(name, work / f"{axes}_{name}.c", low_um=2.0 + 4.0 * k, safe_V=SAFE_V[k]) for k, name in enumerate(names)]
        example = OWN / ("stm32g0.c" if axes == "one" else "stm32g4_two.c")
        for engine in ("q31", "f32"):
            made[f"{axes} {engine}"] = program = work / f"{axes}_{engine}"
            run("cc", "-std=gnu11", "-O1", *SANITIZE, "-Wall", "-Wextra", "-Wno-unused-function", "-Werror", f"-DAXIS_Q31={int(engine == 'q31')}", f"-DTWO={int(axes == 'two')}",
                *(f"-I{folder}" for folder in (ROOT / "lib/include", OWN, HERE / "sdk/stm32", work)), HERE / "late.c", example,
                OWN / "axis.c", *sources, library(*SANITIZE), "-o", program)
    return made


def output(program: Path, at: int = 0, blocked: int = 0, inside: bool = False, load: int = 100, samples: int = 3400,
           underrun: int = 0, fetches_late: bool = False, wait: int = 50, fault: int = 0) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Codes, whether each was new, how often the processor was late, and how many samples had old codes."""
    done = subprocess.run([program, *map(str, (at, blocked, int(inside), load, samples, underrun, int(fetches_late), wait, fault))], capture_output=True,
                          text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    *rows, last = [[int(word) for word in line.split()] for line in done.stdout.splitlines()]
    table = np.array(rows)
    return table[:, :2], table[:, 2] == 1, last[0], last[1]


def steps(codes: np.ndarray, begin: int, end: int | None = None) -> np.ndarray:
    """The larger one of both axes' steps, to the samples from `begin` on."""
    return np.abs(np.diff(codes[begin - 1:end], axis=0)).max(axis=1)


CASES = [("one q31", 2), ("one f32", 20), ("two q31", 20), ("two f32", 20)]


@pytest.mark.parametrize("inside", [False, True], ids=["before the interrupt", "in the midst of it"])
@pytest.mark.parametrize("name, each", CASES, ids=[name for name, _ in CASES])
def test_old_codes_are_noticed_and_the_axis_goes_back_by_a_ramp(programs: dict[str, Path], name: str, each: int,
                                                                inside: bool) -> None:
    whole, fresh, late, replayed = output(programs[name])
    assert fresh.all() and (late, replayed) == (0, 0)
    sweep = steps(whole, 10, 800).max()  # the ramp is as fast as the sweep
    assert sweep > 100 > 6 > steps(whole, AT - 400).max() > 0
    reached = 0
    for blocked in range(0, 101, each):
        at = AT + blocked * 37 % 400
        codes, fresh, late, replayed = output(programs[name], at, blocked, inside)
        reached += late
        assert (codes[:at] == whole[:at]).all()
        assert np.count_nonzero(~fresh) == replayed and late == (replayed > 0)
        assert late == 1 or blocked <= 2 * HALF
        assert late == 0 or blocked > HALF - MARGIN
        assert steps(codes, at)[fresh[at:]].max() <= sweep  # but where a code is output again
        old = np.flatnonzero(~fresh)
        if old.size:
            assert (np.diff(old) == 1).all() and old[0] <= at + 3 * HALF
            # a round before, the same code was output
            assert all((codes[k] == codes[k - 2 * HALF]).all() for k in old)
            back = old[-1] + 1
            # In step at once: as near as the actuator lets it be, which has been elsewhere in between. Half a buffer late is 80.
            assert (np.abs(codes[back + 3:] - whole[back + 3:]) <= 60).all()
        assert (codes[-400:] == whole[-400:]).all()
    assert reached > 50 / each


@pytest.mark.parametrize("name", ["one q31", "two f32"])
def test_a_busy_processor_is_late_more_often_and_catches_up(programs: dict[str, Path], name: str) -> None:
    whole, *_ = output(programs[name])
    for load in (200, 300):  # thousandths of a sample for each look at the DMA; there are two or three for a code
        codes, fresh, late, replayed = output(programs[name], AT, 50, True, load)
        assert late >= 1 and np.count_nonzero(~fresh) == replayed < 50 + 4 * HALF
        assert (codes[-400:] == whole[-400:]).all()


@pytest.mark.parametrize("name", ["one q31", "one f32", "two q31", "two f32"])
def test_blocked_in_the_sweep_it_sweeps_anew(programs: dict[str, Path], name: str) -> None:
    whole, *_ = output(programs[name])
    sweep = steps(whole, 10, 800).max()
    codes, fresh, late, _ = output(programs[name], 300, 60)
    assert late == 1 and steps(codes, 300)[fresh[300:]].max() <= sweep
    assert len({tuple(row) for row in codes[-400:].tolist()} - {tuple(row) for row in whole[-400:].tolist()}) <= 4


ALL = pytest.mark.parametrize("name", ["one q31", "one f32", "two q31", "two f32"])


def safe_codes(name: str) -> list[int]:
    """Of both channels of the DAC; 0 where there is no second one."""
    codes = [int((V + 20) / 140 * 4095 + 0.5) for V in SAFE_V]
    return codes if name.startswith("two") else [codes[0], 0]


@ALL
def test_the_dac_has_the_safe_code_as_soon_as_it_is_on(programs: dict[str, Path], name: str) -> None:
    """And not code 0 until the first trigger."""
    codes, *_ = output(programs[name])
    assert (codes[:2] == safe_codes(name)).all()


@ALL
@pytest.mark.parametrize("wait", [0, 50])
@pytest.mark.parametrize("fetches_late", [False, True])
def test_after_an_underrun_all_begins_anew_at_the_code_that_is_output(programs: dict[str, Path], name: str,
                                                                      fetches_late: bool, wait: int) -> None:
    whole, *_ = output(programs[name])
    codes, fresh, late, replayed = output(programs[name], samples=AT, underrun=2000, fetches_late=fetches_late, wait=wait)
    stopped = np.flatnonzero(~fresh)[-1]  # the last sample that was held
    assert (late, replayed) == (0, 0) and stopped >= 2000 + wait
    assert (codes[:2000] == whole[:2000]).all()
    assert (codes[stopped + 1] == codes[stopped]).all()  # the first trigger outputs it again
    assert steps(codes, stopped + 2).max() <= steps(whole, 10, 800).max()
    assert codes[2000:].min() < 100 and codes[2000:, 0].max() > 4000  # it sweeps


@ALL
def test_a_fault_is_output_at_once_and_a_sweep_leads_on_from_there(programs: dict[str, Path], name: str) -> None:
    whole, *_ = output(programs[name])
    codes, fresh, late, replayed = output(programs[name], samples=4000, fault=2000)
    assert fresh.all() and (late, replayed) == (0, 0)
    went = int(np.flatnonzero((codes == safe_codes(name)).all(axis=1) & (np.arange(len(codes)) > 1999))[0])
    # Each channel is written by itself.
    assert went <= 2005 and (codes[:2000] == whole[:2000]).all()
    assert set(codes[2000:went, 0]) <= {*whole[2000:2004, 0], safe_codes(name)[0]}
    assert (codes[went + 1] == codes[went]).all()
    assert steps(codes, went + 1).max() <= steps(whole, 10, 800).max()
    assert codes[2000:].min() < 100 and codes[2000:, 0].max() > 4000  # it sweeps
    assert steps(codes, len(codes) - 400).max() <= 6  # and follows the reference
