"""The instruction tables: a target missed is seen, the counter refuses to guess, and no other search finds worse."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "size")]

import builds  # noqa: E402
import instructions  # noqa: E402
from builds import Build, Targets  # noqa: E402
from instructions import BLOCK, CHAINS, GROWING, RATIOS, ROOT, SIZES, TARGETS, Case, Measured, Result  # noqa: E402

README = "lib/README.md"
OLD = "| arm-none-eabi-gcc 12.2.1 | mean |\n| 1 | 2 |"
F32 = Build("f32", "M4F", "-O2")


def limits() -> Iterator[tuple[Build, str, float]]:
    """Every target of the main table: build, field, figure."""
    for build, (means, worsts) in TARGETS.items():
        yield from ((build, "mean", mean) for mean in means)
        yield from ((build, "worst", worst) for worst in worsts)


def tightest(build: Build) -> tuple[float, int]:
    """A mean and a worst that meet every target."""
    mean, worst = TARGETS.get(build, ((), ()))
    return min(mean, default=100), min(worst, default=260)


def met() -> Measured:
    """Results that meet every target exactly, but for growth."""
    times = {}
    for build in builds.ROWS:
        mean, worst = tightest(build)
        times[build] = Result(mean, worst, 0, "")
    growth = {}
    for name, case in GROWING.items():
        mean, worst = tightest(case.build)
        if case.engine.startswith("formula"):
            mean, worst = (ratio * target for ratio, target in zip(RATIOS, tightest(F32)))
        growth[name] = {head: Result(mean, round(worst * (one.n + 20) / 29), 0, "")
                        for head, one in instructions.growth_cases(case).items()}
    effects = {build: {effect: Result(instructions.CHAIN_TARGETS.get(effect, times[F32].mean + instructions.PLAIN_MORE), 260,
                                      0, "") for effect in instructions.EFFECT_NAMES} for build in CHAINS}
    blocks = {(build, effect): {"single": 100.0, "mean": 105.0, "worst": float(BLOCK * 105 + 260)}
              for build in CHAINS for effect in ("plain", "all")}
    return Measured(times, growth, effects, blocks)


def missed(measured: Measured) -> list[str]:
    targets = Targets()
    instructions.time_cells(measured.times, targets)
    instructions.tables(measured, targets)
    return instructions.judge(targets.missed, [])


def test_targets_are_met() -> None:
    assert missed(met()) == []


def test_a_target_known_to_be_missed_is_no_fault_until_it_is_met() -> None:
    assert instructions.judge({"a": "is 3, target ≤ 2", "b": "is 1, target ≥ 2"}, ["a"]) == ["b is 1, target ≥ 2"]
    assert instructions.judge({}, ["a"]) == ["a is met: take it out of OPEN"]


@pytest.mark.parametrize("build, field, limit", limits(), ids=lambda value: getattr(value, "name", None))
def test_a_target_missed_by_one_is_seen(build: Build, field: str, limit: float) -> None:
    measured = met()
    measured.times[build] = replace(measured.times[build], **{field: limit + 1})
    assert any(line.startswith(f"{build.name}: {field}") and line.endswith(f"is {limit + 1:g}, target ≤ {limit:g}")
               for line in missed(measured))


@pytest.mark.parametrize("effect", instructions.EFFECT_NAMES)
def test_a_target_of_the_chain_missed_by_one_is_seen(effect: str) -> None:
    measured = met()
    target = measured.effects[CHAINS[0]][effect].mean
    for mean, lines in ((target, 0), (target + 1, 1)):
        measured.effects[CHAINS[0]][effect] = replace(measured.effects[CHAINS[0]][effect], mean=mean)
        assert len(missed(measured)) == lines


@pytest.mark.parametrize("effect", ["plain", "all"])
def test_a_dear_block_is_seen(effect: str) -> None:
    measured = met()
    measured.blocks[CHAINS[0], effect]["worst"] += 1
    assert ["worst block" in line for line in missed(measured)] == [True]
    measured = met()
    measured.blocks[CHAINS[0], effect]["mean"] += 0.1
    assert ["in a block" in line for line in missed(measured)] == [True]


@pytest.mark.parametrize("field", ["mean", "worst"])
def test_a_ratio_missed_is_seen(field: str) -> None:
    measured = met()
    formula = measured.growth["formula, M4F, -O2"]
    formula["9"] = replace(formula["9"], **{field: 0.99 * getattr(formula["9"], field)})
    assert len(missed(measured)) == 1


@pytest.mark.parametrize("build", [build for build in TARGETS if build.level == "-O2"], ids=lambda build: build.name)
def test_growth_is_seen(build: Build) -> None:
    measured = met()
    row = measured.growth[build.name]
    last = row[str(SIZES[-1])]
    row[str(SIZES[-1])] = replace(last, mean=1.02 * instructions.MAX_GROWTH * last.mean)
    assert len(missed(measured)) == 1
    row[str(SIZES[-1])] = replace(last, worst=2 * last.worst)
    assert ["straight line" in line for line in missed(measured)] == [True]


def test_every_row_of_the_growth_is_a_row_of_the_costs() -> None:
    names = {build.name for build in builds.ROWS}
    assert {name for name in GROWING if name.startswith("rdpi")} <= names
    assert {build.name for build in CHAINS} <= names


def test_another_table_is_seen(capsys: pytest.CaptureFixture[str]) -> None:
    assert instructions.compare(OLD, OLD, README) == []
    assert len(instructions.compare(OLD, OLD.replace("2 |", "3 |"), README)) == 1
    assert instructions.compare(OLD, OLD.replace("12.2.1", "14.2.1"), README) == []
    assert "another compiler" in capsys.readouterr().out


def test_counts_nothing_without_icount() -> None:
    program = instructions.image(Case("M3", "q31", 4, seed=9))
    with pytest.raises(SystemExit, match="does not count instructions"):
        instructions.emulate(program, "M3")


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 3, 4])
@pytest.mark.parametrize("build", TARGETS, ids=lambda build: build.name)
def test_no_other_search_finds_worse(build: Build, seed: int) -> None:
    table = builds.split((ROOT / README).read_text(encoding="utf-8"), README)[1]
    if f"gcc {builds.version()} " not in table:
        pytest.skip("the table is of another compiler")
    _, worst, late = builds.times_of(table)[build.name]
    found = instructions.measure(replace(instructions.case_of(build), seed=seed, climbs=Case.climbs))
    assert found.worst <= int(re.match(r"\d+", worst)[0])
    assert found.worst_late <= int(late)
