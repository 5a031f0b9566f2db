"""The table of costs: a limit missed is seen, no time outlives its code, and a stack without bound is refused."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import builds  # noqa: E402
import size  # noqa: E402
from builds import ROWS, SIZES, TIMES, Build, Targets  # noqa: E402

README = "lib/README.md"


def measured() -> dict[Build, dict[str, int]]:
    return {build: dict.fromkeys(SIZES, 100) for build in ROWS}


def table(figures: dict[Build, dict[str, int]]) -> str:
    """With a time in every cell."""
    sizes, _ = size.size_cells(figures)
    return "\n".join([builds.head(), *(builds.line(build, ("1", "2", "3"), sizes[build.name]) for build in ROWS)])


def test_every_row_has_a_name_of_its_own() -> None:
    assert len({build.name for build in builds.ALL_IN_ORDER}) == len(builds.ALL_IN_ORDER) > len(ROWS)


def test_both_levels_and_both_ways_are_there() -> None:
    of_f32 = [build for build in ROWS if build.library == "f32" and build.core == "M4F" and not build.least]
    assert {(build.level, build.quick) for build in of_f32} == {
        ("-O2", None), ("-O2", 0), ("-Os", None), ("-Os", 2), ("-O0", None)}
    assert {build.library for build in ROWS if build.level == "-O0"} == {
        "f32", "f32_chain", "f32_axis", "q31", "q31_chain", "q31_axis"}


def test_limits_are_held() -> None:
    assert size.size_cells(measured())[1] == []


@pytest.mark.parametrize("build, column", [(build, column) for build, limits in size.LIMITS.items() for column in limits])
def test_a_limit_missed_by_one_is_seen(build: Build, column: str) -> None:
    figures = measured()
    (limit,) = size.LIMITS[build][column]
    for figure, count in ((limit, 0), (limit + 1, 1)):
        figures[build] = {**figures[build], column: figure}
        assert len(size.size_cells(figures)[1]) == count


def test_another_size_is_seen(capsys: pytest.CaptureFixture[str]) -> None:
    figures = measured()
    old = table(figures)
    assert size.judge(old, size.size_cells(figures)[0], README) == []
    figures[ROWS[3]]["code"] += 2
    assert len(size.judge(old, size.size_cells(figures)[0], README)) == 1
    assert ROWS[3].name in capsys.readouterr().out


def test_no_time_outlives_its_code() -> None:
    figures = measured()
    old = table(figures)
    figures[ROWS[3]]["code"] += 2
    sizes, _ = size.size_cells(figures)
    new = size.with_old_times(sizes, old)
    times = builds.times_of(new)
    assert [name for name, row in times.items() if row != ("1", "2", "3")] == [ROWS[3].name]
    assert times[ROWS[3].name] == (builds.UNKNOWN,) * len(TIMES)
    assert size.judge(new, sizes, README) == [f"{README} lacks times: tests/benchmark/instructions.py --write {README}"]


def test_a_figure_shows_what_it_meets_and_what_it_misses() -> None:
    targets = Targets()
    assert targets.cell("a", 90, 97, 100) == "90 ≤ 97"
    assert targets.cell("b", 98, 97, 100) == "98 ≤ 100 (target ≤ 97)"
    assert targets.cell("c", 546, 500, 260) == "546 (target ≤ 500, ≤ 260)"
    assert targets.cell("d", 2.5, 3, relation="≥") == "2.5 (target ≥ 3)"
    assert targets.cell("e", 7) == "7"
    assert targets.missed == {"b ≤ 97": "is 98, target ≤ 97", "c ≤ 500": "is 546, target ≤ 500",
                              "c ≤ 260": "is 546, target ≤ 260", "d": "is 2.5, target ≥ 3"}


def compiled(folder: Path, text: str) -> Path:
    (folder / "a.c").write_text(text)
    builds.run(*ROWS[0].compiler, "-nostdlib", "-nostartfiles", "-Wl,-e,rdpi_a", folder / "a.c", "-o", folder / "a.elf")
    return folder / "a.elf"


def test_a_stack_includes_what_is_called(tmp_path: Path) -> None:
    text = """
        __attribute__((noinline)) int leaf(volatile int *x) { volatile int a[25]; a[*x] = 1; return a[*x]; }
        int rdpi_a(volatile int *x) { volatile int b[10]; b[*x] = 1; return leaf(x) + b[*x]; }
        """
    found = size.stacks(compiled(tmp_path, text))["rdpi_a"]
    assert 140 <= found < 200


def test_a_call_through_a_pointer_gives_no_bound_on_the_stack(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no bound"):
        size.stacks(compiled(tmp_path, "int rdpi_a(int (*f)(int)) { return f(1) + 1; }"))


def test_a_recursion_gives_no_bound_on_the_stack(tmp_path: Path) -> None:
    text = """
        int rdpi_a(int x);
        __attribute__((noinline)) int other(int x) { return x > 0 ? rdpi_a(x - 1) * 3 : 0; }
        __attribute__((noinline)) int rdpi_a(int x) { return other(x) + 1; }
        """
    with pytest.raises(RecursionError):
        size.stacks(compiled(tmp_path, text))


def test_all_builds_share_the_objects_of_a_library() -> None:
    build = Build("f32", "M4F", "-Os")
    assert build.folder == replace(build, library="f32_chain").folder
    assert len({one.folder for one in builds.ALL_IN_ORDER if one.library == "f32"}) == sum(
        one.library == "f32" for one in builds.ALL_IN_ORDER)
