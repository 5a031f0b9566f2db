#!/usr/bin/env python3
"""Proofs about the index arithmetic of the banks; see README.md.

    tests/proof/run.py            the quick part
    tests/proof/run.py --long     all of it
"""
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).resolve().parent
LIB = HERE.parent.parent / "lib"
CXX = "g++ -std=c++17 -O1 -g -fpermissive -w -fsanitize=address,bounds -fno-sanitize-recover=bounds".split()

# What is proved: (program, macros, arguments).
QUICK = [
    ("f32_paths", ["RDPI_MAX_PLAYS=16"], []),
    ("q31_paths", [], ["bank", "2"]),
]
LONG = QUICK[:1] + [
    ("f32_paths", ["RDPI_MAX_PLAYS=2", "RDPI_QUICK_STEP=0"], []),
    ("f32_paths", ["RDPI_MAX_PLAYS=2", "RDPI_QUICK_STEP=1"], []),
    ("q31_paths", [], ["bank", "3"]),
    ("q31_paths", [], ["all", "1"]),
]

# A proof that holds whatever the code says proves nothing. Each fault must make it fail: (program, macros, arguments,
# file, what is replaced, by what).
FAULTS = [
    ("f32_paths", ["RDPI_MAX_PLAYS=4"], [], "inverse.h", "-side * (rdpi_real_t)INFINITY;", "-side;"),
    ("f32_paths", ["RDPI_MAX_PLAYS=16"], [], "inverse.h", "row != last) {", "row != last + 1) {"),
    ("f32_paths", ["RDPI_MAX_PLAYS=16"], [], "inverse.h", "next < count && ", ""),
    ("q31_paths", [], ["all", "1"], "rdpi_q31.c",
     "rdpi_q31_clamp(drive_of_code(params, code), params->min_drive, params->max_drive);",
     "(int32_t)drive_of_code(params, code);"),
    ("q31_paths", [], ["bank", "2"], "q31_inverse.h", "if (bank->engaged > 0u) {", "if (true) {"),
    ("q31_paths", [], ["bank", "2"], "q31_inverse.h", "bank->room = -side * way;",
     "bank->room = side * way;"),
    ("q31_paths", [], ["bank", "2"], "q31_inverse.h", "bank->room = room > 0 ? room : 0;", "bank->room = room;"),
]


def prove(program, macros, arguments, fault=None):
    """(whether the program found no fault, its last line)"""
    with tempfile.TemporaryDirectory() as folder:
        source = LIB / "src"
        if fault:
            name, old, new = fault
            source = Path(folder, "src")
            shutil.copytree(LIB / "src", source)
            text = (source / name).read_text()
            if old not in text:
                raise SystemExit(f"tests/proof/run.py: {name} has no longer {old!r}: mend FAULTS")
            (source / name).write_text(text.replace(old, new))
        built = Path(folder, program)
        subprocess.run([*CXX, *("-D" + macro for macro in macros), "-I", LIB / "include", "-I", source,
                        HERE / f"{program}.cpp", "-o", built, *(["-lz3"] if program == "q31_paths" else [])], check=True)
        done = subprocess.run([built, *arguments], env={**os.environ, "ASAN_OPTIONS": "detect_leaks=0"}, text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    told = re.compile(r"\w+_paths:|.*ERROR: AddressSanitizer|.*runtime error")
    lines = [line for line in done.stdout.splitlines() if told.match(line)]
    return done.returncode == 0, lines[-1] if lines else f"exit status {done.returncode}"


def main():
    jobs = [(*job, None) for job in (LONG if "--long" in sys.argv[1:] else QUICK)]
    jobs += [(program, macros, arguments, fault) for program, macros, arguments, *fault in FAULTS]
    failed = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for (program, macros, _, fault), (held, last) in zip(jobs, pool.map(lambda job: prove(*job), jobs)):
            good = held != bool(fault)
            failed += not good
            what = " ".join([program, *macros]) + (f", {fault[0]} without {fault[1]!r}" if fault else "")
            print(f"{'ok' if good else 'FAILED'}: {what}\n    {last}", flush=True)
    print(f"proof: {len(jobs) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
