#!/usr/bin/env python3
"""Puts every fault of mutants.txt into a copy of lib/ and requires that a test fails. One line per fault.

    tests/mutation/mutate.py [WORD...]    all faults, or those whose first line contains every word

Unit tests, then property tests, with sanitizers; a test that hangs has failed, one that does not compile has not.
Needs what tests/support/setup.sh tests installs.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build" / "mutation"
[UNITY] = (ROOT / ".gems" / "gems").glob("ceedling-*/vendor/unity")
TESTS = ROOT / "tests"
FLAGS = (
    "-std=c99 -O0 -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all "
    f"-DUNITY_INCLUDE_DOUBLE -I{UNITY}/src -I{TESTS}/support"
).split()
SECONDS = 180
SOURCES = sorted((ROOT / "lib" / "src").glob("*.c"))
# Those with mocks, or that look elsewhere, test examples and ports.
ELSEWHERE = re.compile(r'#include "(mock_|\.\./|ring\.h)')
UNIT = [path for path in sorted((TESTS / "unit").glob("*.c")) if not ELSEWHERE.search(path.read_text("utf-8"))]
ALL = UNIT + sorted((TESTS / "property").glob("*.c"))


class Unseen(Exception):
    pass


@dataclass
class Fault:
    file: str
    what: str
    before: str
    after: str


def read_faults() -> list[Fault]:
    faults = []
    for block in (Path(__file__).parent / "mutants.txt").read_text(encoding="utf-8").split("\n\n"):
        lines = [line for line in block.splitlines() if not line.startswith("#")]
        if lines:
            file, what = lines[0].split(": ", 1)
            before, after = ("\n".join(line[1:] for line in lines[1:] if line[0] == sign) for sign in "-+")
            faults.append(Fault(file, what, before, after))
    return faults


def compile_(library: Path, *arguments: str | Path) -> None:
    command = ["gcc", *FLAGS, f"-I{library}/include", f"-I{library}/src", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise Unseen("does not compile: " + next(line for line in done.stderr.splitlines() if "error" in line))


@cache
def parts(source: Path) -> str:
    """The files that a source is made of."""
    command = ["gcc", "-MM", f"-I{ROOT}/lib/include", source]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def fails(test: Path, library: Path, folder: Path, file: str = "") -> bool:
    """Whether the test fails with that library, which differs from lib/ in `file`."""
    program = folder / test.stem
    sources = [test]
    for source in SOURCES:
        other = file and f"/src/{file}" in parts(source)
        sources.append(library / "src" / source.name if other else WORK / f"{source.stem}.o")
    if test in UNIT:
        runner = WORK / f"{test.stem}_runner.c"
        sources += [runner, WORK / "unity.o"]
    compile_(library, *sources, "-lm", "-o", program)
    try:
        return subprocess.run([program], capture_output=True, timeout=SECONDS).returncode != 0
    except subprocess.TimeoutExpired:
        return True


def killer(fault: Fault) -> str:
    """The name of the test that sees it."""
    folder = WORK / re.sub(r"\W+", "-", f"{fault.file}-{fault.what}")
    shutil.copytree(ROOT / "lib", folder / "lib")
    path = folder / "lib" / "src" / fault.file
    text = path.read_text(encoding="utf-8")
    if text.count(fault.before) != 1 or not fault.before:
        raise Unseen(f"its text occurs {text.count(fault.before)} times")
    path.write_text(text.replace(fault.before, fault.after), encoding="utf-8")
    nearest = "test_" + re.sub(r"^rdpi_|\.[ch]$", "", fault.file)
    for test in sorted(ALL, key=lambda test: test.stem != nearest):
        if fails(test, folder / "lib", folder, fault.file):
            shutil.rmtree(folder)
            return test.stem
    raise Unseen("no test sees it")


def outcome(fault: Fault) -> tuple[bool, str]:
    try:
        return True, f"seen by {killer(fault)}"
    except Unseen as error:
        return False, str(error)


def main() -> int:
    faults = [one for one in read_faults() if all(word in f"{one.file}: {one.what}" for word in sys.argv[1:])]
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    for source in (UNITY / "src" / "unity.c", *SOURCES):
        compile_(ROOT / "lib", "-c", source, "-o", WORK / f"{source.stem}.o")
    for test in UNIT:
        generator = UNITY / "auto" / "generate_test_runner.rb"
        subprocess.run(["ruby", generator, test, WORK / f"{test.stem}_runner.c"], check=True, capture_output=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        unharmed = pool.map(lambda test: fails(test, ROOT / "lib", WORK), ALL)
        broken = [test.stem for test, failed in zip(ALL, unharmed) if failed]
        if broken:
            sys.exit(f"mutation: without any fault, these fail: {' '.join(broken)}")
        passed = 0
        for fault, (seen, text) in zip(faults, pool.map(outcome, faults)):
            print("ok  " if seen else "FAIL", f"{fault.file}: {fault.what}: {text}", flush=True)
            passed += seen
    print(f"mutation: {passed} passed, {len(faults) - passed} failed")
    return 0 if passed == len(faults) > 0 else 1


if __name__ == "__main__":
    sys.exit(main())
