#!/usr/bin/env python3
"""The library under every compiler, standard and analyser it promises to satisfy; of the ports, that they compile
without a warning and what the analysers say. One line per item.

    tests/lint/lint.py [WORD...]    all items, or those whose name contains every word

What is not followed, and why, is in deviations.md and nowhere else; a deviation that nothing needs is an error.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Callable

Item = tuple[str, Callable[[], str]]  # a name, and what returns what is wrong, or nothing

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build" / "lint"
SOURCES = sorted((ROOT / "lib" / "src").glob("*.c"))
PUBLIC = sorted((ROOT / "lib" / "include" / "rdpi").glob("*.h"))
# axis_life.h is what two sources have in common, not a header: they define its names.
PRIVATE = sorted(path for path in (ROOT / "lib" / "src").glob("*.h") if path.name != "axis_life.h")
INCLUDE = f"-I{ROOT / 'lib' / 'include'}"
WARNINGS = "-Wall -Wextra -Wpedantic -Wshadow -Werror".split()
C_WARNINGS = [*WARNINGS, "-Wconversion", "-Wdouble-promotion"]
CORES = {
    "M0": "-mcpu=cortex-m0",
    "M3": "-mcpu=cortex-m3",
    "M4F": "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -mfloat-abi=hard",
    "M7": "-mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard",
}
PORT_INCLUDE = [f"-I{ROOT / 'port' / folder}" for folder in ("include", "cortex_m")]
PORTS = {  # folders of port/, and what they run on
    **dict.fromkeys(("drivers", "cortex_m", "template"), [*CORES]),
    "microbit": ["M0"], "qemu_mps2": ["M3", "M4F", "M7"], "stm32f405": ["M4F"], "stm32g474": ["M4F"],
}
ANALYSED = "drivers", "stm32f405", "stm32g474", "template"  # analysers misread registers behind pointers, and start-up
PORT_SOURCES = {folder: sorted((ROOT / "port" / folder).glob("*.c")) for folder in PORTS}
PORT_HEADERS = sorted(path for folder in ("include", "drivers") for path in (ROOT / "port" / folder).glob("*.h"))
# Compilers emit these of their own accord, and libgcc's arithmetic (__aeabi_fadd, __clzsi2).
ALLOWED_CALLS = re.compile(r"rdpi_\w+|memcpy|memset|__\w+")


@dataclass
class Deviation:
    number: str
    tool: str
    rules: list[str]
    used: bool = False


def run(*command: str | Path, text: str = "") -> str:
    """The output of a command that must succeed silently."""
    done = subprocess.run([str(word) for word in command], input=text, capture_output=True, text=True, cwd=ROOT)
    output = (done.stdout + done.stderr).strip().replace(f"{ROOT}/", "")
    return output or (f"{command[0]}: exit status {done.returncode}" if done.returncode else "")


# ---- deviations ----


def read_deviations() -> list[Deviation]:
    deviations = []
    for line in (Path(__file__).parent / "deviations.md").read_text(encoding="utf-8").splitlines():
        if re.match(r"\| *D\d", line):
            number, tool, rules, reason = (cell.strip() for cell in line.strip("|").split("|"))
            if number != f"D{len(deviations) + 1}" or tool not in ("misra", "cppcheck", "clang-tidy") or not reason:
                sys.exit(f"deviations.md: not the next number, no such tool or no reason: {line}")
            deviations.append(Deviation(number, tool, rules.split(", ")))
    return deviations


DEVIATIONS = read_deviations()


def without_deviations(tool: str, findings: list[tuple[str, str]]) -> str:
    """Of (rule, text), the texts whose rules are to be followed."""
    left = []
    for rule, text in findings:
        matching = [deviation for deviation in DEVIATIONS if deviation.tool == tool and rule in deviation.rules]
        for deviation in matching:
            deviation.used = True
        if not matching:
            left.append(text)
    return "\n".join(left)


def unused_deviations() -> str:
    """A row about rules that the installed version of the tool has not heard of is not unused."""
    known = {
        "clang-tidy": run("clang-tidy", "--list-checks", "--checks=*"),
        "cppcheck": run("cppcheck", "--errorlist"),
    }
    return "\n".join(
        f"{row.number}: nothing needs it"
        for row in DEVIATIONS
        if not row.used and any(rule in known.get(row.tool, rule) for rule in row.rules)
    )


# ---- compilers ----


def compile_all(folder: str, *command: str, sources: list[Path] = SOURCES) -> str:
    objects = WORK / folder
    objects.mkdir(parents=True)
    complaints = (run(*command, *C_WARNINGS, INCLUDE, "-c", file, "-o", objects / f"{file.stem}.o") for file in sources)
    return "\n".join(filter(None, complaints))


def compiler_items() -> list[Item]:
    matrix = itertools.product(("gcc", "clang"), ("-std=c99", "-std=c11"), ("-O0", "-O2", "-Os"), ("-m64", "-m32"))
    # -fno-pic as firmware is built; with it, compilers add symbols and data of their own.
    items = [(" ".join(words), partial(compile_all, "".join(words), *words, "-fno-pic")) for words in matrix]
    for (core, flags), optimisation in itertools.product(CORES.items(), ("-O2", "-Os")):
        command = ["arm-none-eabi-gcc", "-std=c99", optimisation, "-mthumb", *flags.split()]
        name = f"arm-{core}{optimisation}"
        items.append((f"arm-none-eabi-gcc {core} {optimisation}", partial(compile_all, name, *command)))
        for port in (port for port, cores in PORTS.items() if core in cores):
            compile_port = partial(compile_all, f"port/{port}-{core}{optimisation}", *command, *PORT_INCLUDE,
                                   sources=PORT_SOURCES[port])
            items.append((f"arm-none-eabi-gcc {core} {optimisation} port/{port}", compile_port))
    items.append(("gcc -fanalyzer", partial(compile_all, "analyzer", "gcc", "-std=c99", "-O2", "-fanalyzer")))
    return items


def header_items() -> list[Item]:
    """Every header alone and twice: nothing that it needs may come from what was included before it."""
    items = []
    languages = {"gcc": "c99", "clang": "c99", "g++": "c++11", "clang++": "c++11"}
    for header, (compiler, standard) in itertools.product((*PUBLIC, *PRIVATE, *PORT_HEADERS), languages.items()):
        if header in PRIVATE and standard != "c99":
            continue
        warnings = C_WARNINGS if standard == "c99" else WARNINGS
        command = [compiler, f"-std={standard}", *warnings, "-Wno-unused-function", INCLUDE, *PORT_INCLUDE, f"-I{ROOT}"]
        command += ["-fsyntax-only", "-x", standard[:-2], "-"]
        text = f'#include "{header.relative_to(ROOT)}"\n' * 2
        items.append((f"{compiler} {standard} {header.name} alone", partial(run, *command, text=text)))
    return items


# ---- objects ----


def objects() -> list[Path]:
    """Those of the library."""
    return sorted(path for path in WORK.glob("*/*.o") if path.parent.name != "analyzer")


def binutils(tool: str, path: Path, *options: str) -> list[str]:
    prefix = "arm-none-eabi-" if path.parent.name.startswith("arm") else ""
    return run(prefix + tool, *options, path).splitlines()


def no_static_data() -> str:
    """.data, .bss and what else is writable."""
    wrong = []
    for path in objects():
        for line in binutils("objdump", path, "-h"):
            words = line.split()
            if len(words) > 2 and re.match(r"\.(data|bss|tdata|tbss)", words[1]) and int(words[2], 16):
                wrong.append(f"{path.relative_to(WORK)}: {words[1]} has {int(words[2], 16)} bytes")
    return "\n".join(wrong)


def symbols(path: Path, *options: str) -> list[str]:
    return [line.split()[-1] for line in binutils("nm", path, *options)]


def only_own_symbols() -> str:
    return "\n".join(
        f"{path.relative_to(WORK)}: {name} is global"
        for path in objects()
        for name in symbols(path, "--extern-only", "--defined-only")
        if not name.startswith("rdpi_")
    )


def nothing_called() -> str:
    return "\n".join(
        f"{path.relative_to(WORK)}: needs {name}"
        for path in objects()
        if path.parent.name.startswith("arm")
        for name in symbols(path, "--undefined-only")
        if not ALLOWED_CALLS.fullmatch(name)
    )


# ---- analysers ----


# It analyses some branches of large functions only, and version 2.17 says so in every run.
CPPCHECK = ("cppcheck --quiet --std=c99 --enable=warning,style,performance,portability "
            "--suppress=normalCheckLevelMaxBranches").split()


@cache
def cppcheck_findings() -> list[tuple[str, str, str]]:
    """(tool, rule, text)"""
    findings = []
    template = "--template={file}:{line}: {id}: {message}"
    for line in run(*CPPCHECK, "--addon=misra", template, INCLUDE, *SOURCES).splitlines():
        match = re.match(r"[^ ]+: (misra-c2012-)?([\w.]+): ", line)
        tool, rule = ("misra" if match[1] else "cppcheck", match[2]) if match else ("cppcheck", line)
        findings.append((tool, rule, line.replace(" (use --rule-texts=<file> to get proper output)", "")))
    return findings


def cppcheck(wanted: str) -> str:
    return without_deviations(wanted, [(rule, text) for tool, rule, text in cppcheck_findings() if tool == wanted])


def cppcheck_ports() -> str:
    return run(*CPPCHECK, *PORT_INCLUDE, *(file for port in ANALYSED for file in PORT_SOURCES[port]))


def clang_tidy() -> str:
    checks = "--checks=-*,bugprone-*,cert-*,clang-analyzer-*,misc-*,performance-*,portability-*"
    options = ["--quiet", checks, "--header-filter=/(lib|port)/"]
    sources = [*SOURCES, *(file for port in ANALYSED for file in PORT_SOURCES[port])]
    findings = []
    # One file at a time: given several, it keeps to itself what it has said of a header before.
    for file in sources:
        for line in run("clang-tidy", *options, file, "--", "-std=c99", INCLUDE, *PORT_INCLUDE).splitlines():
            match = re.match(r".*: (?:warning|error): .*\[([^]]+)\]$", line)
            findings += [(rule, line) for rule in match[1].split(",")] if match else []
    return without_deviations("clang-tidy", findings)


# ---- the whole ----


def main() -> int:
    first = [  # the longest ahead, so that all cores end together
        ("clang-tidy", clang_tidy),
        ("cppcheck", partial(cppcheck, "cppcheck")),
        ("cppcheck port", cppcheck_ports),
        ("doxygen: all that is public is documented", partial(run, "doxygen", "tests/lint/Doxyfile")),
        *compiler_items(),
        *header_items(),
    ]
    then = [
        ("objects: .data and .bss are 0", no_static_data),
        ("objects: only rdpi_ symbols are global", only_own_symbols),
        ("arm objects: call nothing but memcpy, memset and the compiler's arithmetic", nothing_called),
        ("cppcheck: MISRA C:2012", partial(cppcheck, "misra")),
        ("deviations.md: each is needed", unused_deviations),
    ]
    words = sys.argv[1:]
    failed = passed = 0
    shutil.rmtree(WORK, ignore_errors=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for items in (first, then):
            items = [item for item in items if all(word in item[0] for word in words)]
            for (name, _), complaint in zip(items, pool.map(lambda item: item[1](), items)):
                print("FAIL" if complaint else "ok  ", name, flush=True)
                if complaint:
                    print(textwrap.indent(complaint, "     "))
                failed, passed = failed + bool(complaint), passed + (not complaint)
    print(f"lint: {passed} passed, {failed} failed")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
