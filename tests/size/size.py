#!/usr/bin/env python3
"""What the library costs a Cortex-M: code, RAM and stack, as a Markdown table.

    tests/size/size.py                         prints it
    tests/size/size.py --write lib/README.md   puts it between the markers there
    tests/size/size.py --check lib/README.md   fails if it is not the one there, or beyond a limit

Another version of the compiler than the one that the table names makes other code: then only the limits count.
"""

from __future__ import annotations

import difflib
import itertools
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build" / "size"
BEGIN, END = "<!-- tests/size/size.py -->", "<!-- end -->"
FLAGS = "-std=c99 -Os -mthumb -ffunction-sections -fdata-sections -DRDPI_MAX_PLAYS=10 -DRDPI_MAX_WINDOW=1"
FLAGS += " -DRDPI_MAX_POLES=5"
CORES = {
    "M4F": "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -mfloat-abi=hard",
    "M7": "-mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard",
    "M3": "-mcpu=cortex-m3",
    "M0": "-mcpu=cortex-m0",
}
CALLS = ("init_layout", "step", "sweep")  # the first is what init, inline, calls
COLUMNS = ("code", "libgcc, libc", "state", "stack of init", "of step", "of sweep")
LEAST = "-DRDPI_MAX_CURVE_PIECES=1 -DRDPI_NOISE_SHAPING=0 -DRDPI_QUICK_STEP=0"
ROWS = (("f32", LEAST), ("f32", ""), ("f32_chain", ""), ("q31", LEAST), ("q31", ""), ("q31_chain", ""))
LIMITS = {("f32", LEAST, "M4F"): {"code": 3072, "state": 128, "of step": 128}}


def run(*command: str | Path) -> str:
    return subprocess.run([str(word) for word in command], check=True, stdout=subprocess.PIPE, text=True).stdout


def text_size(path: Path) -> int:
    """Code and constants."""
    return int(run("arm-none-eabi-size", path).splitlines()[1].split()[0])


def stacks(elf: Path) -> dict[str, int]:
    """Worst depth of the stack of every function and what it calls, from what it pushes. A jump to another function
    counts as a call, so this is at times a word or two too much, never too little."""
    frames: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    name = ""
    for line in run("arm-none-eabi-objdump", "-d", "--no-show-raw-insn", elf).splitlines():
        if match := re.match(r"[0-9a-f]+ <(.+)>:", line):
            name = match[1]
            frames[name], calls[name] = 0, set()
        elif match := re.match(r"\s+[0-9a-f]+:\s+(\S+)\s*(.*)", line):
            operation, operands = match[1].split(".")[0], match[2]
            if operation in ("push", "vpush", "stmdb") and (operation != "stmdb" or operands.startswith("sp!")):
                frames[name] += sum(registers(part) for part in re.search(r"{(.*)}", operands)[1].split(","))
            elif operation in ("sub", "subw") and (match := re.match(r"sp,(?: sp,)? #(\d+)", operands)):
                frames[name] += int(match[1])
            elif match := re.search(r"\[sp, #-(\d+)\]!", operands):
                frames[name] += int(match[1])
            elif operation == "blx" or (operation == "add" and re.match(r"sp,(?: sp,)? r", operands)):
                sys.exit(f"{elf}: {name}: no bound on the stack after {operation} {operands}")
            elif operation.startswith("b") and (match := re.search(r"<([^>+]+)>", operands)) and match[1] != name:
                calls[name].add(match[1])

    @cache
    def depth(function: str) -> int:  # a recursion would not end, and so be seen
        return frames[function] + max((depth(callee) for callee in calls[function]), default=0)

    return {function: depth(function) for function in frames if function.startswith("rdpi_")}


def registers(part: str) -> int:
    """The bytes of "r4", "r4-r7" or "d8-d10"."""
    numbers = [int(number) for number in re.findall(r"\d+", part)] or [0]
    return (numbers[-1] - numbers[0] + 1) * (8 if "d" in part else 4)


def compiler(setting: str, core: str) -> list[str]:
    return ["arm-none-eabi-gcc", *FLAGS.split(), *setting.split(), *CORES[core].split(), f"-I{ROOT / 'lib' / 'include'}"]


def compiled(setting: str, core: str) -> list[Path]:
    """Objects of the library."""
    folder = WORK / f"{setting}-{core}"
    folder.mkdir(parents=True, exist_ok=True)
    objects = []
    for source in sorted((ROOT / "lib" / "src").glob("*.c")):
        objects.append(folder / f"{source.stem}.o")
        run(*compiler(setting, core), "-c", source, "-o", objects[-1])
    return objects


def measure(library: str, setting: str, core: str, objects: list[Path]) -> dict[str, int]:
    """`library` is f32, f32_chain, q31 or q31_chain; `setting` is "" or more options of the compiler."""
    folder = WORK / f"{library}{setting}-{core}"
    folder.mkdir(parents=True, exist_ok=True)
    gcc = compiler(setting, core)
    probe = folder / "state.c"
    probe.write_text(f'#include "rdpi/{library}.h"\nchar state[sizeof(rdpi_{library}_t)];\n')
    run(*gcc, "-c", probe, "-o", folder / "state.o")

    # Of the library what the three functions need; then the same with what they need of others.
    roots = [f"-Wl,-u,rdpi_{library}_{call}" for call in CALLS]
    link = [*gcc, "-nostartfiles", "-Wl,--gc-sections", *roots, *objects]
    run(*link, "-nostdlib", "-r", "-o", folder / "own.o")
    run(*link, f"-Wl,-e,rdpi_{library}_{CALLS[0]}", "-o", folder / "all.elf")
    own, depths = text_size(folder / "own.o"), stacks(folder / "all.elf")
    return dict(zip(COLUMNS, [
        own,
        text_size(folder / "all.elf") - own,
        int(run("arm-none-eabi-nm", "--size-sort", folder / "state.o").split()[0], 16),
        *(depths[f"rdpi_{library}_{call}"] for call in CALLS),
    ]))  # fmt: skip


def table() -> tuple[str, list[str]]:
    """The table, and which limits it breaks."""
    version = re.search(r"(\d+\.\d+\.\d+)", run("arm-none-eabi-gcc", "--version").splitlines()[0])[1]
    lines = [f"| bytes, arm-none-eabi-gcc {version} -Os | {' | '.join(COLUMNS)} |"]
    lines.append("|---|" + "---:|" * len(COLUMNS))
    broken = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        builds = list(itertools.product(sorted({setting for _, setting in ROWS}), CORES))
        objects = dict(zip(builds, pool.map(lambda build: compiled(*build), builds)))
        cases = [(*row, core) for row, core in itertools.product(ROWS, CORES)]
        sizes = dict(zip(cases, pool.map(lambda case: measure(*case, objects[case[1:]]), cases)))
    for library, setting in ROWS:
        name = f"rdpi_{library}{', least' if setting else ''}"
        for core in CORES:
            cells = [f"{name}, {core}"]
            for column, figure in sizes[library, setting, core].items():
                limit = LIMITS.get((library, setting, core), {}).get(column)
                cells.append(f"{figure} ≤ {limit}" if limit else str(figure))
                if limit and figure > limit:
                    broken.append(f"{name}, {core}: {column} is {figure}, limit {limit}")
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines), broken


def main() -> int:
    arguments = sys.argv[1:]
    if arguments and (len(arguments) != 2 or arguments[0] not in ("--write", "--check")):
        sys.exit(__doc__)
    new, broken = table()
    print(new)
    if arguments:
        option, name = arguments
        text = Path(name).read_text(encoding="utf-8")
        before, begin, rest = text.partition(BEGIN + "\n")
        old, end, after = rest.partition("\n" + END)
        if not begin or not end:
            sys.exit(f"{name}: no lines {BEGIN} and {END}")
        if option == "--write":
            Path(name).write_text(before + begin + new + end + after, encoding="utf-8")
        elif old.split("|")[1] != new.split("|")[1]:
            print(f"{name} has a table of another compiler: only the limits are checked")
        elif old != new:
            lines = difflib.unified_diff(old.splitlines(), new.splitlines(), name, "measured", lineterm="")
            print(*lines, sep="\n")
            broken.append(f"{name} has another table: tests/size/size.py --write {name}")
    print(*broken, f"size: {'failed' if broken else 'passed'}", sep="\n")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
