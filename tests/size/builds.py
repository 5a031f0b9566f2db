"""The builds of the library whose cost lib/README.md shows, and the table that size.py and instructions.py share.

A row is a build. Its code, its stacks and its instructions are those of the same objects, so that nobody reads the time
of one build and the size of another.
"""

from __future__ import annotations

import difflib
import itertools
import re
import subprocess
import sys
import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build" / "size"
BEGIN, END = "<!-- tests/size/size.py -->", "<!-- end -->"
CORES = {
    "M4F": "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -mfloat-abi=hard",
    "M7": "-mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard",
    "M3": "-mcpu=cortex-m3",
    "M0": "-mcpu=cortex-m0",
}
TIMES = ("mean", "worst", "after missed")
SIZES = ("code", "libgcc, libc", "state", "stack of init", "of step", "of sweep")
UNKNOWN = "?"  # a time that belongs to code that is no longer there


@dataclass(frozen=True)
class Build:
    library: str  # f32, f32_chain, f32_axis, q31, q31_chain or q31_axis
    core: str
    level: str  # of optimisation
    quick: int | None = None  # RDPI_QUICK_STEP; None: what the library makes of the level
    least: bool = False  # no input curve, noise shaping or quick way
    plays: int = 10  # the identity included
    window: int = 1

    @property
    def name(self) -> str:
        way = {None: "", 0: ", no quick way", 2: ", whole quick way"}[self.quick]
        return f"rdpi_{self.library}, {self.core}, {self.level}{way}{', least' * self.least}"

    @property
    def compiler(self) -> list[str]:
        """The command and the options that every part of a program shares."""
        settings = {"RDPI_MAX_PLAYS": self.plays, "RDPI_MAX_WINDOW": self.window, "RDPI_MAX_POLES": 5}
        settings |= {"RDPI_MAX_CURVE_PIECES": 1, "RDPI_NOISE_SHAPING": 0, "RDPI_QUICK_STEP": 0} if self.least else {}
        settings |= {} if self.quick is None else {"RDPI_QUICK_STEP": self.quick}
        return ["arm-none-eabi-gcc", "-std=c99", self.level, "-mthumb", "-ffunction-sections", "-fdata-sections",
                *CORES[self.core].split(), *(f"-D{name}={number}" for name, number in settings.items()),
                f"-I{ROOT / 'lib' / 'include'}"]

    @property
    def number(self) -> str:
        """The number type: f32 or q31."""
        return self.library[:3]

    @property
    def folder(self) -> Path:
        """Of the objects, which operator, chain and axis share."""
        quick = "" if self.quick is None else f"-quick{self.quick}"
        return WORK / f"{self.number}-{self.core}{self.level}{quick}{'-least' * self.least}-{self.plays}-{self.window}"

    def objects(self) -> list[Path]:
        """The library in this number type, compiled once per run."""
        with lock(self.folder):
            return compiled(self.folder, tuple(self.compiler), "q31" if self.number == "f32" else "f32")


@cache
def lock(folder: Path) -> threading.Lock:
    return threading.Lock()


@cache
def compiled(folder: Path, compiler: tuple[str, ...], other: str) -> list[Path]:
    """All sources but those of the other number type."""
    folder.mkdir(parents=True, exist_ok=True)
    objects = []
    for source in sorted(path for path in (ROOT / "lib" / "src").glob("*.c") if other not in path.name):
        objects.append(folder / f"{source.stem}.o")
        run(*compiler, "-c", source, "-o", objects[-1])
    return objects


def run(*command: str | Path, timeout_s: float = 300) -> str:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=timeout_s)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def _rows() -> tuple[Build, ...]:
    """Of single precision the cores that have it, of fixed point those that do not, and what one of them makes of the
    other. Debug builds overflow their stack first, so each sibling has -O0."""
    every = {"M4F": "-O2 -Os -O0", "M7": "-O2 -Os", "M3": "-O2 -Os", "M0": "-O2 -Os"}
    levels = {
        "f32": every,
        "f32_chain": {core: every[core] for core in ("M4F", "M7")},
        "f32_axis": {"M4F": "-O2 -Os -O0"},
        "q31": {core: "-O2 -Os -O0" for core in ("M3", "M0")},
        "q31_chain": {core: "-O2 -Os -O0" for core in ("M3", "M0")},
        "q31_axis": {"M0": "-O2 -Os -O0"},
    }
    rows = []
    for library, cores in levels.items():
        for core, wanted in cores.items():
            for level in wanted.split():
                rows.append(Build(library, core, level))
                if library in ("f32", "f32_chain") and core == "M4F" and level != "-O0":
                    rows.append(Build(library, core, level, quick=2 if level == "-Os" else 0))
            if (library, core) in (("f32", "M4F"), ("q31", "M0")):
                rows.append(Build(library, core, "-Os", least=True))
    return tuple(rows)


ROWS = _rows()
ALL = tuple(
    Build(library, core, level, quick, least)
    for library, core, level, least in itertools.product(("f32", "f32_chain", "f32_axis", "q31", "q31_chain", "q31_axis"), CORES,
                                                         ("-O2", "-Os", "-O0"), (False, True))
    for quick in ((None, 2 if level == "-Os" else 0) if library.startswith("f32") else (None,)))  # fmt: skip
ALL_IN_ORDER = tuple(dict.fromkeys((*ROWS, *ALL)))


# ---- the table ----


def version() -> str:
    """Of the compiler."""
    return re.search(r"(\d+\.\d+\.\d+)", run("arm-none-eabi-gcc", "--version").splitlines()[0])[1]


def head() -> str:
    columns = (*TIMES, *SIZES)
    return (f"| arm-none-eabi-gcc {version()} | {' | '.join(columns)} |\n|---|" + "---:|" * len(columns))


def line(build: Build, times: tuple[str, ...], sizes: tuple[str, ...]) -> str:
    return f"| {' | '.join((build.name, *times, *sizes))} |"


def cells(table: str) -> dict[str, tuple[str, ...]]:
    """Of each row, by its name."""
    rows = ([cell.strip() for cell in row.split("|")[1:-1]] for row in table.splitlines()[2:])
    return {name: tuple(rest) for name, *rest in rows}


def times_of(table: str) -> dict[str, tuple[str, ...]]:
    return {name: row[: len(TIMES)] for name, row in cells(table).items()}


def sizes_of(table: str) -> dict[str, tuple[str, ...]]:
    return {name: row[len(TIMES) :] for name, row in cells(table).items()}


def split(text: str, name: str, begin: str = BEGIN) -> tuple[str, str, str]:
    """What is before, between and after the markers, these left to the outer parts."""
    before, found, rest = text.partition(begin + "\n")
    old, end, after = rest.partition("\n" + END)
    if not found or not end:
        sys.exit(f"{name}: no lines {begin} and {END}")
    return before + found, old, end + after


def other_compiler(old: str, new: str) -> bool:
    return old.split("|")[1] != new.split("|")[1]


def differences(old: str, new: str, name: str) -> str:
    return "\n".join(difflib.unified_diff(old.splitlines(), new.splitlines(), name, "measured", lineterm=""))


class Targets:
    """Cells with a limit next to the figure, and a list of those missed."""

    def __init__(self) -> None:
        self.missed: dict[str, str] = {}  # what, and how

    def cell(self, what: str, figure: float, *limits: float, relation: str = "≤") -> str:
        """A figure with several limits shows the tightest that it meets, and all that it misses."""
        text = f"{figure:.1f}" if isinstance(figure, float) else str(figure)
        met = [limit for limit in limits if (figure <= limit if relation == "≤" else figure >= limit)]
        shown = f"{text} {relation} {(min if relation == '≤' else max)(met):g}" if met else text
        for limit in limits:
            if limit not in met:
                which = f"{what} {relation} {limit:g}" if len(limits) > 1 else what
                self.missed[which] = f"is {text}, target {relation} {limit:g}"
        open_limits = ", ".join(f"{relation} {limit:g}" for limit in limits if limit not in met)
        return f"{shown} (target {open_limits})" if open_limits else shown
