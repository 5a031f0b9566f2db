#!/usr/bin/env python3
"""What the library costs a Cortex-M: code, RAM and stack of each build, in the table of lib/README.md.

    tests/size/size.py                         prints it; the times are those of lib/README.md
    tests/size/size.py --write lib/README.md   puts it between the markers there
    tests/size/size.py --check lib/README.md   fails if it is not the one there, or beyond a limit

tests/benchmark/instructions.py has the other columns, the times. A row whose size changes is of other code: --write takes
its times out, and --check fails until they are measured anew. Another version of the compiler than the one that the table
names makes other code: then only the limits count.
"""

from __future__ import annotations

import os
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import builds
from builds import ROOT, ROWS, SIZES, TIMES, UNKNOWN, WORK, Build, Targets, run

CALLS = ("init_layout", "step", "sweep")  # the first is what init, inline, calls
CALLS_OF_AN_AXIS = ("init_layout", "step", "step")  # which sweeps, too
LEAST = Build("f32", "M4F", "-Os", least=True)
LIMITS = {LEAST: {"code": (3072,), "state": (128,), "of step": (128,)},
          Build("f32", "M4F", "-Os"): {"code": (3686 + 1536,)}}  # 1.5 kB more than before its step became faster


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


def measure(build: Build) -> dict[str, int]:
    library, objects = build.library, build.objects()
    calls = CALLS_OF_AN_AXIS if library.endswith("axis") else CALLS
    folder = WORK / build.name.replace(", ", "_").replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / "state.c"
    probe.write_text(f'#include "rdpi/{library}.h"\nchar state[sizeof(rdpi_{library}_t)];\n')
    run(*build.compiler, "-c", probe, "-o", folder / "state.o")

    # Of the library what the three functions need; then the same with what they need of others.
    roots = [f"-Wl,-u,rdpi_{library}_{call}" for call in calls]
    link = [*build.compiler, "-nostartfiles", "-Wl,--gc-sections", *roots, *objects]
    run(*link, "-nostdlib", "-r", "-o", folder / "own.o")
    run(*link, f"-Wl,-e,rdpi_{library}_{calls[0]}", "-o", folder / "all.elf")
    own, depths = text_size(folder / "own.o"), stacks(folder / "all.elf")
    return dict(zip(SIZES, [
        own,
        text_size(folder / "all.elf") - own,
        int(run("arm-none-eabi-nm", "--size-sort", folder / "state.o").split()[0], 16),
        *(depths[f"rdpi_{library}_{call}"] for call in calls),
    ]))  # fmt: skip


def measure_all(wanted: tuple[Build, ...]) -> dict[Build, dict[str, int]]:
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return dict(zip(wanted, pool.map(measure, wanted)))


def size_cells(measured: dict[Build, dict[str, int]]) -> tuple[dict[str, tuple[str, ...]], list[str]]:
    """Of each build by name, and which limits they break."""
    targets = Targets()
    found = {}
    for build, figures in measured.items():
        limits = LIMITS.get(build, {})
        found[build.name] = tuple(targets.cell(f"{build.name}: {column}", figure, *limits.get(column, ()))
                                  for column, figure in figures.items())
    return found, [f"{what} {how}" for what, how in targets.missed.items()]


def with_old_times(sizes: dict[str, tuple[str, ...]], old: str) -> str:
    """The table, with the times of rows whose size is still that of the old one."""
    old_sizes, old_times = builds.sizes_of(old), builds.times_of(old)
    unknown = (UNKNOWN,) * len(TIMES)
    lines = [builds.line(build, old_times[build.name] if old_sizes.get(build.name) == sizes[build.name] else unknown,
                         sizes[build.name]) for build in ROWS]
    return "\n".join([builds.head(), *lines])


def judge(old: str, sizes: dict[str, tuple[str, ...]], name: str) -> list[str]:
    """What is wrong with the sizes in the table of the file `name`, times that are left out included."""
    wrong = []
    if builds.sizes_of(old) != sizes or list(builds.sizes_of(old)) != list(sizes):
        print(builds.differences(old, with_old_times(sizes, old), name))
        wrong.append(f"{name} has another table: tests/size/size.py --write {name}")
    if any(UNKNOWN in times for times in builds.times_of(old).values()):
        wrong.append(f"{name} lacks times: tests/benchmark/instructions.py --write {name}")
    return wrong


def main() -> int:
    arguments = sys.argv[1:]
    if arguments and (len(arguments) != 2 or arguments[0] not in ("--write", "--check")):
        sys.exit(__doc__)
    option, name = arguments or ("", ROOT / "lib" / "README.md")
    text = Path(name).read_text(encoding="utf-8")
    before, old, after = builds.split(text, name)
    sizes, broken = size_cells(measure_all(ROWS))
    new = with_old_times(sizes, old)
    print(new)
    if option == "--write":
        Path(name).write_text(before + new + after, encoding="utf-8")
    elif option == "--check":
        if builds.other_compiler(old, new):
            print(f"{name} has a table of another compiler: only the limits are checked")
        else:
            broken += judge(old, sizes, name)
    print(*broken, f"size: {'failed' if broken else 'passed'}", sep="\n")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
