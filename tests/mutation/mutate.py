#!/usr/bin/env python3
"""Puts every fault of mutants.txt into a copy of lib/ and port/ and requires that a test fails. One line per fault.

    tests/mutation/mutate.py [WORD...]    all faults, or those whose first line contains every word
    tests/mutation/mutate.py --check      only whether each fault can be put in where it says; takes a second

A fault must be seen in every build, with the quick way of the float step, half of it and none (RDPI_QUICK_STEP), but for
one where its object code is the same as without the fault. Unit tests, then property tests; then all of them with
sanitizers, which take three times as long and see what few faults need. A test that hangs has failed, one that does
not compile has not, nor one that fails without the fault. Needs what tests/support/setup.sh tests installs.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import get_ident

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build" / "mutation"
[VENDOR] = (ROOT / ".gems" / "gems").glob("ceedling-*/vendor")
UNITY, CMOCK = VENDOR / "unity", VENDOR / "cmock"
BUILDS = "2", "1", "0"  # values of RDPI_QUICK_STEP
LANGUAGE = "-std=c99 -DUNITY_INCLUDE_DOUBLE -DUNITY_SUPPORT_64 -DCMOCK_MEM_DYNAMIC".split()
WAYS = {  # to build a test, in the order in which they are tried: their options
    "plain": ["-O0"],
    "sanitized": "-O0 -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all".split(),
}
COMPARED = ["-O1"]  # options for telling whether object code is the same
MUTATED = "lib", "port"  # folders
INCLUDES = "lib/include", "lib/src", "port/include", "port/drivers", "port/cortex_m"
SECONDS = 600  # of one test, however loaded the machine is
LIBRARY = sorted((ROOT / "lib" / "src").glob("*.c"))
# Those that look elsewhere by a relative path test examples and boards.
ELSEWHERE = re.compile(r'#include "(\.\./|track)')
UNIT = [path for path in sorted((ROOT / "tests" / "unit").glob("*.c")) if not ELSEWHERE.search(path.read_text("utf-8"))]
ALL = UNIT + sorted((ROOT / "tests" / "property").glob("*.c"))


class Unseen(Exception):
    pass


@dataclass
class Fault:
    file: str
    what: str
    before: str
    after: str

    @property
    def path(self) -> Path:
        return Path(self.file) if "/" in self.file else Path("lib/src") / self.file


def read_faults() -> list[Fault]:
    faults = []
    for block in (Path(__file__).parent / "mutants.txt").read_text(encoding="utf-8").split("\n\n"):
        lines = [line for line in block.splitlines() if not line.startswith("#")]
        if lines:
            file, what = lines[0].split(": ", 1)
            before, after = ("\n".join(line[1:] for line in lines[1:] if line[0] == sign) for sign in "-+")
            faults.append(Fault(file, what, before, after))
    return faults


def obstacle(fault: Fault) -> str:
    """What keeps a fault from being put into its file; empty if nothing does."""
    path = ROOT / fault.path
    if not path.is_file():
        return "there is no such file"
    count = path.read_text(encoding="utf-8").count(fault.before) if fault.before else 0
    if count != 1:
        return f"its text occurs {count} times"
    return "it changes nothing" if fault.after == fault.before else ""


def obstacles(faults: list[Fault]) -> list[str]:
    """One line per fault that cannot be put in, and per name that several faults have: reports could not tell them apart."""
    names = [f"{fault.file}: {fault.what}" for fault in faults]
    lines = [f"{name}: {why}" for name, why in zip(names, map(obstacle, faults)) if why]
    return lines + [f"{name}: {count} faults have this name" for name, count in Counter(names).items() if count > 1]


def gcc(tree: Path, build: str, *arguments: str | Path) -> str:
    """What gcc writes. `tree` holds lib/ and port/."""
    includes = [tree / folder for folder in INCLUDES] + [ROOT / "tests" / "support", UNITY / "src", CMOCK / "src", WORK]
    command = ["gcc", *LANGUAGE, *(f"-I{folder}" for folder in includes), f"-DRDPI_QUICK_STEP={build}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if "error" in line or "undefined" in line]
        raise Unseen(f"does not compile: {(errors or ['?'])[0]}")
    return done.stdout


# ---- what a test is made of ----


@cache
def parts(source: Path) -> set[Path]:
    """The files of this checkout that a source is made of."""
    names = gcc(ROOT, BUILDS[0], "-MM", "-MG", source).replace("\\\n", " ").split()[1:]
    return {Path(name).resolve().relative_to(ROOT) for name in names if Path(name).resolve().is_relative_to(ROOT)}


@cache
def varies(source: Path) -> bool:
    """Whether a source is another one in the other build."""
    return len({gcc(ROOT, build, "-E", "-P", source) for build in BUILDS}) > 1


@cache
def sources(test: Path) -> list[Path]:
    """The test, what it uses of the library, and the drivers that it names."""
    headers = {path.stem for path in parts(test) if path.parent == Path("lib/include/rdpi")}
    stems = headers | {name.replace("chain", "state") for name in headers} | {"status"}  # f32_chain.h has two sources
    used = [path for path in LIBRARY if path.stem.removeprefix("rdpi_") in stems]
    drivers = re.findall(r'^TEST_SOURCE_FILE\("(port/.*)"\)', test.read_text("utf-8"), re.MULTILINE)
    return [test, *used, *(ROOT / driver for driver in drivers)]


@cache
def mocks(test: Path) -> list[str]:
    return re.findall(r'^#include "(mock_\w+)\.h"', test.read_text("utf-8"), re.MULTILINE)


def make_support() -> None:
    """Objects that no fault changes: Unity, the tests' main functions and mocks."""
    files = [UNITY / "src" / "unity.c", CMOCK / "src" / "cmock.c"]
    for mock in sorted({mock for test in UNIT for mock in mocks(test)}):
        header = ROOT / "port" / "include" / f"{mock.removeprefix('mock_')}.h"
        generator = ["ruby", CMOCK / "lib" / "cmock.rb", f"-o{ROOT}/project.yml", f"--mock_path={WORK}", header]
        subprocess.run(generator, check=True, capture_output=True)
        files.append(WORK / f"{mock}.c")
    for test in UNIT:
        runner = WORK / f"{test.stem}_runner.c"
        generator = ["ruby", UNITY / "auto" / "generate_test_runner.rb", test, runner]
        subprocess.run(generator, check=True, capture_output=True)
        files.append(runner)
    for file in files:
        gcc(ROOT, BUILDS[0], *WAYS["plain"], "-c", file, "-o", WORK / f"{file.stem}.o")


def support(test: Path) -> list[Path]:
    names = ["unity", f"{test.stem}_runner"] if test in UNIT else []
    names += ["cmock", *mocks(test)] if mocks(test) else []
    return [WORK / f"{name}.o" for name in names]


# ---- one fault ----


@dataclass
class Tree:
    """lib/ and port/, with a fault in `changed` or without any."""

    folder: Path
    changed: Path | None = None

    def affects(self, source: Path) -> bool:
        return self.changed is None or self.changed in parts(source)

    def compiled(self, source: Path, build: str, options: list[str]) -> Path:
        """The object of a source: that without a fault where there is no difference."""
        if not self.affects(source):
            return UNHARMED.compiled(source, build, options)
        build = build if varies(source) else BUILDS[0]
        target = self.folder / "objects" / build / "".join(options) / f"{source.stem}.o"
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            inside = source.relative_to(ROOT)
            path = self.folder / inside if self.changed and inside.parts[0] in MUTATED else source
            temporary = target.with_suffix(f".{get_ident()}.o")
            gcc(self.folder if self.changed else ROOT, build, *options, "-c", path, "-o", temporary)
            temporary.replace(target)
        return target

    def fails(self, test: Path, build: str, way: str) -> bool:
        program = self.folder / f"{test.stem}-{build}-{way}"
        objects = [self.compiled(source, build, WAYS[way]) for source in sources(test)]
        gcc(ROOT, build, *WAYS[way], *objects, *support(test), "-lm", "-o", program)
        processor_s = 3 if test in UNIT else 100  # the longest take 0.3 and 15, sanitized
        command = ["sh", "-c", f'ulimit -t {processor_s}; exec "$0"', program]
        try:
            return subprocess.run(command, capture_output=True, timeout=SECONDS).returncode != 0
        except subprocess.TimeoutExpired:
            return True

    def differs(self, test: Path, build: str) -> bool:
        """Whether the fault makes the test another program."""
        objects = ([tree.compiled(source, build, COMPARED) for source in sources(test)] for tree in (self, UNHARMED))
        return any(mine.read_bytes() != theirs.read_bytes() for mine, theirs in zip(*objects))


UNHARMED = Tree(WORK)
SAW: dict[Path, Counter[str]] = defaultdict(Counter)  # of the faults in a file, how many each test saw
FAILED: set[tuple[Path, str, str]] = set()  # programs that saw a fault: they must not fail without it


def seen_by(tree: Tree, tests: list[Path], build: str) -> Path | None:
    """The first test that fails; None where the fault changes nothing."""
    for way in WAYS:
        for k, test in enumerate(tests):
            if (k == 0 or tree.differs(test, build)) and tree.fails(test, build, way):
                FAILED.add((test, build, way))
                return test
    if any(tree.differs(test, build) for test in tests):
        raise Unseen(f"no test sees it where RDPI_QUICK_STEP is {build}")
    return None


def killers(fault: Fault) -> list[str]:
    """The names of the tests that see it: one for each build where it changes something."""
    if why := obstacle(fault):
        raise Unseen(why)
    tree = Tree(WORK / re.sub(r"\W+", "-", f"{fault.file}-{fault.what}"), fault.path)
    for folder in MUTATED:
        shutil.copytree(ROOT / folder, tree.folder / folder)
    path = tree.folder / fault.path
    path.write_text(path.read_text(encoding="utf-8").replace(fault.before, fault.after), encoding="utf-8")
    nearest = "test_" + path.stem.removeprefix("rdpi_")
    tests = [test for test in ALL if any(tree.affects(source) for source in sources(test))]
    sibling = "_".join(nearest.split("_")[:2])
    saw = SAW[fault.path]
    tests.sort(key=lambda test: (test.stem != nearest, test not in UNIT, -saw[test.stem],
                                 not test.stem.startswith(sibling)))
    seen: list[str] = []
    for build in BUILDS:
        test = seen_by(tree, tests, build)
        if test and test.stem not in seen:
            seen.append(test.stem)
        if test and not any(varies(source) for source in sources(test)):
            break  # it is the same program in the other build
    if not seen:
        raise Unseen("changes nothing in any build")
    shutil.rmtree(tree.folder)
    saw.update(seen)
    return seen


def outcome(fault: Fault) -> tuple[bool, str]:
    try:
        return True, f"seen by {', '.join(killers(fault))}"
    except Unseen as error:
        return False, str(error)


def main() -> int:
    if sys.argv[1:] == ["--check"]:
        lines = obstacles(read_faults())
        print(*lines, f"mutation: {len(lines)} faults cannot be put in", sep="\n")
        return 1 if lines else 0
    faults = [one for one in read_faults() if all(word in f"{one.file}: {one.what}" for word in sys.argv[1:])]
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    make_support()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        passed = 0
        for fault, (seen, text) in zip(faults, pool.map(outcome, faults)):
            print("ok  " if seen else "FAIL", f"{fault.file}: {fault.what}: {text}", flush=True)
            passed += seen
        programs = sorted(FAILED)
        unharmed = pool.map(lambda program: UNHARMED.fails(*program), programs)
        broken = [f"{test.stem} ({build}, {way})" for (test, build, way), failed in zip(programs, unharmed) if failed]
        if broken:
            sys.exit(f"mutation: without any fault, these fail (RDPI_QUICK_STEP): {', '.join(broken)}")
    print(f"mutation: {passed} passed, {len(faults) - passed} failed")
    return 0 if passed == len(faults) > 0 else 1


if __name__ == "__main__":
    sys.exit(main())
