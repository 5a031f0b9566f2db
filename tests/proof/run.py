#!/usr/bin/env python3
"""Proofs about the index arithmetic of the banks; see README.md.

    tests/proof/run.py            the quick part, some minutes of processor time
    tests/proof/run.py --long     all of it, many minutes

CXX is the compiler, g++ if it is not set.
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
CXX = [*os.environ.get("CXX", "g++").split(), "-std=c++17", "-w"]
MEMORY = ["-fsanitize=address,bounds", "-fno-sanitize-recover=bounds"]
OPTIONS = {  # of the compiler and the linker
    "f32_paths": ["-O2", *MEMORY],
    "q31_paths": ["-O1", *MEMORY, "-lz3"],  # its time is Z3's
    "q31_divide": ["-O2", "-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"],
}
ENVIRONMENT = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0:quarantine_size_mb=0:malloc_context_size=0"}
TIMEOUT_S = 1800  # a fault may make a program run for ever

# With pieces of the input curve, the whole library with the quick way has too many paths for two plays.
STRAIGHT = "RDPI_MAX_CURVE_PIECES=1"

# What is proved: (program, macros, runs with their arguments). The longest first, so that all cores end together.
F32 = [
    ("f32_paths", ["PLAYS=2", "RDPI_QUICK_STEP=0"], [""]),
    ("f32_paths", ["PLAYS=1", "RDPI_QUICK_STEP=2"], [""]),
    ("f32_paths", ["PLAYS=1", "RDPI_QUICK_STEP=1"], [""]),
    ("f32_paths", ["PLAYS=16"], [""]),
]
QUICK = [*F32, ("q31_paths", [], ["init 3", "bank 2"]), ("q31_divide", [], [""])]
LONG = [
    ("q31_paths", [], ["all 1"]),
    ("q31_paths", [], ["bank 3", "init 4"]),
    ("f32_paths", ["PLAYS=2", "RDPI_QUICK_STEP=2", STRAIGHT], [""]),
    *F32,
    ("q31_divide", ["RDPI_Q31_PORTABLE"], [""]),
    ("q31_divide", [], [""]),
]

# A proof that holds whatever the code says proves nothing. Each fault must make it fail: (program, macros, arguments,
# file, pattern of what is replaced, which occurs once, by what).
FAULTS = [
    ("f32_paths", ["PLAYS=4"], "", "f32_bank.h", r"\(rdpi_real_t\)INFINITY", "1"),
    ("f32_paths", ["PLAYS=16"], "", "f32_bank.h", r"row != last\b", "row != last + 1"),
    ("f32_paths", ["PLAYS=16"], "", "f32_bank.h", r"next < count &&", "true &&"),
    ("f32_paths", ["PLAYS=1", "RDPI_QUICK_STEP=0"], "", "f32_rate.h", r"oldest \+ 1u < rate->window",
     "oldest < rate->window"),
    ("f32_paths", ["PLAYS=1", "RDPI_QUICK_STEP=2"], "", "rdpi_f32.c",
     r"self->rate_estimator\.window == 1u &&", "true &&"),
    ("q31_divide", [], "", "q31_math.h", r"still << 1\b", "still << 2"),
    ("q31_paths", [], "init 1", "q31_check.h", r"!rdpi_q31_in_format\(params->min_drive\)", "false"),
    ("q31_paths", [], "all 1", "rdpi_q31.c",
     r"rdpi_q31_clamp\(rdpi_q31_drive_of_code\(params, code\), params->min_drive, params->max_drive\)",
     "(int32_t)rdpi_q31_drive_of_code(params, code)"),
    ("q31_paths", [], "bank 2", "q31_bank.h", r"if \(bank->engaged > 0u\)", "if (true)"),
    ("q31_paths", [], "bank 1", "q31_bank.h", r"bank->engaged \+ 1u < params->plays", "bank->engaged < params->plays"),
    ("q31_paths", [], "bank 2", "q31_bank.h", r"bank->room = -side \* way\b", "bank->room = side * way"),
    ("q31_paths", [], "bank 2", "q31_bank.h", r"room > 0 \? room : 0", "room"),
]


def fault_in(source, name, pattern, replacement):
    text, count = re.subn(pattern, replacement, (source / name).read_text())
    if count != 1:
        raise SystemExit(f"tests/proof/run.py: {name} has {count} times {pattern!r}, not once: mend FAULTS")
    (source / name).write_text(text)


def prove(program, macros, runs, fault=None):
    """For each run whether the program found no fault, None if it told nothing, and its last line."""
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "src")
        shutil.copytree(LIB / "src", source)
        if fault:
            fault_in(source, *fault)
        built = Path(folder, program)
        command = [*CXX, *("-D" + macro for macro in macros), "-I", LIB / "include", "-I", source,
                   HERE / f"{program}.cpp", "-o", built, *OPTIONS[program], *(["-O0"] if fault else [])]  # faults are found soon
        subprocess.run(command, check=True)
        for arguments in runs:
            done = subprocess.run([built, *arguments.split()], env=ENVIRONMENT, text=True, timeout=TIMEOUT_S,
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
            told = re.compile(rf"{program}:|.*ERROR: AddressSanitizer|.*runtime error")
            lines = [line for line in done.stdout.splitlines() if told.match(line)]
            held = done.returncode == 0 if lines else None
            outcomes.append((held, lines[-1] if lines else f"exit status {done.returncode}"))
    return outcomes


def main():
    options = sys.argv[1:]
    if options not in ([], ["--long"]):
        raise SystemExit(__doc__)
    jobs = [(*job, None) for job in (LONG if options else QUICK)]
    # one for each program shows that it can fail; every one needs its own build
    faults = FAULTS if options else {fault[0]: fault for fault in reversed(FAULTS)}.values()
    jobs += [(program, macros, [arguments], fault) for program, macros, arguments, *fault in faults]
    counts = {True: 0, False: 0}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for (program, macros, runs, fault), outcomes in zip(jobs, pool.map(lambda job: prove(*job), jobs)):
            for arguments, (held, last) in zip(runs, outcomes):
                good = held is (not fault)
                counts[good] += 1
                what = " ".join(filter(None, [program, *macros, arguments]))
                what += f": {fault[0]} with {fault[2]!r} for {fault[1]!r}" if fault else ""
                print(f"{'ok' if good else 'FAILED'}: {what}\n    {last}", flush=True)
    print(f"proof: {counts[True]} passed, {counts[False]} failed")
    return 1 if counts[False] else 0


if __name__ == "__main__":
    sys.exit(main())
