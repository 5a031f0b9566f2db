#!/usr/bin/env python3
"""How many instructions one sample costs, counted on emulated Cortex-M, as a Markdown table.

    tests/benchmark/instructions.py                         prints it
    tests/benchmark/instructions.py --write lib/README.md   puts it between the markers there
    tests/benchmark/instructions.py --check lib/README.md   fails if it is not the one there, or misses a target
    tests/benchmark/instructions.py m4f f32 9               one case: core, engine, n, and the inputs that cost most

Mean: over `profile`. Worst: of everything that the search in instructions/main.c finds. Another version of the compiler
than the one that the table names makes other code: then only the targets count.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "host_tools"))

from rdpi.simulate import chain
from rdpi.firmware import header, parameters  # noqa: E402
from rdpi.model import Memory, Model, read_model  # noqa: E402

WORK = ROOT / "build" / "instructions"
SOURCES = Path(__file__).with_suffix("")
BOARD = ROOT / "tests" / "emulator"
BEGIN, END = "<!-- tests/benchmark/instructions.py -->", "<!-- end -->"
INCLUDES = ("lib/include", "lib/src", "tests/support", "tests/property")
FLAGS = """-std=gnu99 -O2 -mthumb -ffunction-sections -fdata-sections --specs=rdimon.specs
    -nostartfiles -Wl,--gc-sections -Wl,--defsym=flash_size=4M -Wl,--defsym=ram_size=4M""".split()
CORES = {  # flags, and a machine whose SysTick counts; code for the M0 runs on an M3
    "M4F": ("-mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -mfloat-abi=hard", "mps2-an386"),
    "M7": ("-mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard", "mps2-an500"),
    "M3": ("-mcpu=cortex-m3", "mps2-an385"),
    "M0": ("-mcpu=cortex-m0", "mps2-an385"),
}
CHAIN = "lib/src/rdpi_f32.c lib/src/rdpi_f32_chain.c"
CHAIN_Q31 = "lib/src/rdpi_q31.c lib/src/rdpi_q31_chain.c"
ENGINES = {  # what is compiled, and flags
    "f32": ("lib/src/rdpi_f32.c", "-DENGINE=\"f32.h\""),
    **{f"{kind}_{name}": (sources, f'-DENGINE="{kind}_chain.h" -DLEADS={leads} -DLAGS={lags} -DPOLES={poles}')
       for kind, sources in (("f32", CHAIN), ("q31", CHAIN_Q31))
       for name, leads, lags, poles in (("plain", 0, 0, 0), ("lead", 1, 0, 0), ("creep", 1, 0, 5), ("lag", 0, 1, 0),
                                        ("all", 1, 1, 5))},
    "q31": ("lib/src/rdpi_q31.c", "-DENGINE=\"q31.h\""),
    "formula": ("tests/benchmark/instructions/formula.c", "-DENGINE=\"formula.h\""),
    "formula_linear": ("tests/benchmark/instructions/formula.c", "-DENGINE=\"formula.h\" -DFORMULA_LINEAR"),
}
SAMPLE_TIME_S = 1e-4
OPTIONS_WINDOW = 16  # samples in the rate window where all options are on
TIME_LIMIT_S = 300
MORE_CLIMBS = 1000  # where the table has targets

SIZES = (4, 9, 16, 32, 64)  # n: plays beside the identity
CHAINS = ("f32_plain", "f32_lead", "f32_creep", "f32_lag", "f32_all")  # n = 9 only
CHAINS_Q31 = tuple(name.replace("f32", "q31") for name in CHAINS)
PER_PLAY, LATE, OPTIONS = "worst per play", "9, samples missed: worst", "9, all options"  # heads of further columns
ROWS = [("f32", "M4F"), ("formula", "M4F"), ("formula_linear", "M4F"), ("f32", "M7"), ("q31", "M3"), ("q31", "M0"),
        ("q31", "M4F"), ("f32", "M3"), ("f32", "M0"), *((engine, "M4F") for engine in CHAINS),
        *((engine, core) for core in ("M3", "M0") for engine in CHAINS_Q31)]  # fmt: skip
NAMES = {"f32": "rdpi_f32", "q31": "rdpi_q31", "formula": "formula", "formula_linear": "formula, O(n)",
         **{f"{kind}_{name}": f"rdpi_{kind}_chain{what}" for kind in ("f32", "q31") for name, what in (
             ("plain", " without effects"), ("lead", ", lead"), ("creep", ", lead + creep (5 poles)"), ("lag", ", lag"),
             ("all", ", lead + creep (5 poles) + lag"))}}
TARGETS = {("f32", "M4F"): (100, 260), ("q31", "M3"): (160, 500), ("q31", "M0"): (600, 2200)}  # mean, worst, n = 9
CHAIN_TARGETS = {"f32_lead": 125, "f32_creep": 180, "f32_lag": 125, "f32_all": 180}  # mean
PLAIN_MORE = 3  # than the operator alone
RATIOS = (8, 3)  # formula over rdpi_f32 on the M4F, n = 9: mean, worst
# Targets that are still to be met. One that is met, or that is missed and not named here, fails.
OPEN = ["rdpi_f32, M4F, n = 9: worst", "rdpi_f32, M4F, n = 64: mean", "formula : rdpi_f32, M4F, n = 9: worst",
        "rdpi_q31, M3, n = 9: worst", "rdpi_q31, M0, n = 9: worst", "rdpi_f32_chain, lag, M4F, n = 9: mean",
        "rdpi_f32_chain, lead + creep (5 poles) + lag, M4F, n = 9: mean"]
MARGIN = 1.02  # on the worst of the M0: its software arithmetic takes its time by the numbers, and no search finds all
MAX_GROWTH = 1.25  # of the mean from n = 9, where 0.1 plays engage per sample of the profile, to n = 64: 0.8
MAX_DEPARTURE = 0.05  # of the worst from a straight line in n


@dataclass(frozen=True)
class Case:
    core: str
    engine: str
    n: int
    options: bool = False  # rate window, rate filter, slew limit
    seed: int = 1
    climbs: int = 200


@dataclass(frozen=True)
class Result:
    mean: float
    worst: int  # of what the search found where no sample was missed or refused before
    worst_late: int  # of all that it found
    text: str


def run(*command: str | Path) -> str:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=TIME_LIMIT_S)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def model_of(case: Case) -> Model:
    """The example's actuator with n plays beside the identity; by default a rate over one sample, not filtered, and no
    slew limit, as `rdpi fit` has it."""
    example = read_model(ROOT / "examples" / "track" / "params" / "model.json")
    r = np.linspace(0, example.thresholds_um[-1], case.n + 1)
    slopes, slope_rates = (np.interp(r, example.thresholds_um, values)
                           for values in (example.slopes, example.slope_rate_s_per_um))
    rate = replace(example.rate, window_s=0.0, filter_s=0.0)
    drive = replace(example.drive, slew_V_per_s=None, dac_bits=16)
    if case.options:
        rate = replace(rate, window_s=OPTIONS_WINDOW * SAMPLE_TIME_S, filter_s=8 * SAMPLE_TIME_S)
        drive = replace(drive, slew_V_per_s=(drive.max_V - drive.min_V) / (4 * SAMPLE_TIME_S))
    return replace(example, thresholds_um=r, slopes=slopes, slope_rate_s_per_um=slope_rates, rate=rate, drive=drive,
                   memory=Memory(0.0, np.zeros(case.n + 1)))


def profile(low_um: float, high_um: float, fastest_um_per_s: float) -> np.ndarray:
    """References in um, about one second of a hard day, in the middle 90 % of the reach."""
    centre, half = (low_um + high_um) / 2, 0.45 * (high_um - low_um)
    fast = fastest_um_per_s * SAMPLE_TIME_S  # um per sample at the guard
    random = np.random.default_rng(2003)

    def sine(hertz: float, periods: float) -> np.ndarray:
        return np.sin(2 * np.pi * hertz * SAMPLE_TIME_S * np.arange(round(periods / (hertz * SAMPLE_TIME_S))))

    def to(start: float, end: float, um_per_sample: float) -> np.ndarray:
        return np.linspace(start, end, int(abs(end - start) / um_per_sample) + 1, endpoint=False)

    paper = np.linspace(0.2, 1, 2000) * (sine(5, 1) + sine(20, 4) + sine(35, 7)) / 3
    turns = random.uniform(-4, 4, 400) * fast  # a reversal every other sample
    pieces = [
        np.full(500, centre),
        centre + half * sine(10, 1),
        centre + half * paper,
        *(to(centre - way, centre + way, speed * fast) for speed in (0.1, 0.5, 1.5) for way in (half, -half)),
        centre + np.linspace(-half, half, 1000) + 0.1 * half * sine(50, 5),
        centre + 0.05 * half * sine(200, 20),
        centre + np.cumsum(turns - np.mean(turns)),
        centre + half * np.tile(np.repeat([1.0, -1.0], 50), 10),
    ]
    return np.concatenate(pieces)


def array(kind: str, name: str, values: np.ndarray) -> str:
    texts = (header.literal(value) if kind == "float" else str(value) for value in values)
    return f"static const {kind} {name}[] = {{{', '.join(texts)}}};\n"


def write_case(case: Case, folder: Path) -> None:
    """rdpi_params.h as firmware gets it, and case.h: profile and candidates in the engine's own units."""
    model = model_of(case)
    low_um, high_um = chain.reachable_um(model)
    header.write_header(model, folder / "rdpi_params.h")
    beyond = np.array([-1.0, 1.0]) * model.stroke_um
    candidates = np.sort(np.concatenate([np.linspace(low_um, high_um, 2 * case.n + 3), beyond + (low_um, high_um)]))
    series = {"profile": profile(low_um, high_um, model.rate.max_um_per_s), "candidate": candidates}
    scale = parameters.q31(model).scale
    lines = []
    for name, values in series.items():
        values = values.round(6)  # the same on every machine
        if case.engine.startswith("q31"):
            values = parameters.integers(values, scale.um_per_reference, scale.offset_um)
        lines.append(array("int32_t" if case.engine.startswith("q31") else "float", name, values))
    (folder / "case.h").write_text(f"#include <stdint.h>\n{''.join(lines)}")


def build(case: Case) -> Path:
    """The program that measures."""
    folder = WORK / f"{case.engine}-{case.core}-{case.n}{'-options' * case.options}-{case.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    write_case(case, folder)
    source, engine_flags = ENGINES[case.engine]
    numbers = {"RDPI_MAX_PLAYS": case.n + 1, "RDPI_MAX_WINDOW": OPTIONS_WINDOW if case.options else 1,
               "SAMPLE_TIME_NS": round(SAMPLE_TIME_S * 1e9), "SEED": case.seed, "CLIMBS": case.climbs}  # fmt: skip
    defines = [f"-D{name}={number}u" for name, number in numbers.items()]
    includes = [f"-I{path}" for path in (folder, SOURCES, *(ROOT / name for name in INCLUDES))]
    image = folder / "image.elf"
    run("arm-none-eabi-gcc", *FLAGS, *CORES[case.core][0].split(), *engine_flags.split(), *defines, *includes,
        SOURCES / "main.c", *(ROOT / name for name in source.split()), BOARD / "board.c", "-T", ROOT / "port/cortex_m/cortex_m.ld", "-o", image)
    return image


def emulate(image: Path, core: str, *options: str) -> str:
    return run("qemu-system-arm", "-M", CORES[core][1], "-nographic", "-monitor", "none", "-serial", "none",
               "-semihosting", *options, "-kernel", image)


def measure(case: Case) -> Result:
    text = emulate(build(case), case.core, "-icount", "shift=10")
    figures = {name: float(figure) for name, figure in re.findall(r"^([a-z ]+): ([\d.]+)", text, re.M)}
    mean, late = figures.pop("mean"), figures.pop("after missed")
    margin = MARGIN if case.core == "M0" else 1
    in_time, any_time = (math.ceil(margin * figure) for figure in (max(figures.values()), max(late, *figures.values())))
    return Result(mean, in_time, any_time, text)


# ---- the table ----


def columns(engine: str, core: str) -> dict[str, Case]:
    """What the table shows of one engine on one core, by the head of the column."""
    if engine in CHAINS_Q31:
        return {"9": Case(core, engine, 9, climbs=20)}
    if engine in CHAINS or (engine == "f32" and core in ("M3", "M0")):  # no hardware for it: that it works, not how it grows
        return {"9": Case(core, engine, 9)}
    few, many = (Case.climbs, MORE_CLIMBS) if engine in ("f32", "q31") else (10, 10)  # the formula: one is like another
    every = {str(n): Case(core, engine, n, climbs=many if n == 9 else few) for n in SIZES}
    return every | {OPTIONS: Case(core, engine, 9, options=True)}


def measure_all() -> dict[tuple[str, str], dict[str, Result]]:
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        futures = {key: {head: pool.submit(measure, case) for head, case in columns(*key).items()} for key in ROWS}
        return {key: {head: future.result() for head, future in row.items()} for key, row in futures.items()}


def straight_line(results: dict[str, Result]) -> tuple[float, float]:
    """Of the worst counts against n: how many per play, and the largest departure from the line, relative."""
    worst = np.array([results[str(n)].worst for n in SIZES])
    per_play, base = np.polyfit(SIZES, worst, 1)
    return per_play, float(np.max(np.abs(base + per_play * np.array(SIZES) - worst) / worst))


class Targets:
    """Cells with a target beside the figure, and a list of those missed."""

    def __init__(self) -> None:
        self.missed: dict[str, str] = {}  # what, and how

    def cell(self, what: str, figure: float, relation: str = "≤", target: float | None = None) -> str:
        text = f"{figure:.1f}" if isinstance(figure, float) else str(figure)
        if target is None:
            return text
        if figure > target if relation == "≤" else figure < target:
            self.missed[what] = f"is {text}, target {relation} {target:g}"
            return f"{text} (target {relation} {target:g})"
        return f"{text} {relation} {target:g}"


def table(measured: dict[tuple[str, str], dict[str, Result]], version: str) -> tuple[str, dict[str, str]]:
    """The table, and which targets are missed by how much."""
    targets = Targets()
    heads = [*map(str, SIZES), PER_PLAY, LATE, OPTIONS]
    lines = [f"| mean / worst, arm-none-eabi-gcc {version} -O2 | n = {' | '.join(heads)} |",
             "|---|" + "---:|" * len(heads)]
    for (engine, core), results in measured.items():
        name = f"{NAMES[engine]}, {core}"
        cells = {}
        for head, result in results.items():
            mean, worst = TARGETS.get((engine, core), (None, None)) if head == "9" else (None, None)
            if engine in CHAINS:
                plain = round(measured["f32", "M4F"]["9"].mean) + PLAIN_MORE
                mean = CHAIN_TARGETS.get(engine, plain)
            if head == str(SIZES[-1]) and (engine, core) in TARGETS:
                mean = round(MAX_GROWTH * results["9"].mean)
            cells[head] = (targets.cell(f"{name}, n = {head}: mean", round(result.mean), target=mean) + " / "
                           + targets.cell(f"{name}, n = {head}: worst", result.worst, target=worst))
        cells[LATE] = str(results["9"].worst_late)
        if engine in ("f32", "q31") and OPTIONS in results:
            per_play, departure = straight_line(results)
            cells[PER_PLAY] = f"{per_play:.1f}"
            if departure > MAX_DEPARTURE:
                targets.missed[f"{name}: growth of the worst"] = f"is {departure:.0%} off a straight line in n"
        lines.append(f"| {name} | {' | '.join(cells.get(head, '') for head in heads)} |")
    for engine in ("formula", "formula_linear"):
        ours, theirs = measured["f32", "M4F"], measured[engine, "M4F"]
        name = f"{NAMES[engine]} : rdpi_f32, M4F"
        cells = []
        for head in map(str, SIZES):
            mean, worst = RATIOS if (engine, head) == ("formula", "9") else (None, None)
            cells.append(targets.cell(f"{name}, n = {head}: mean", theirs[head].mean / ours[head].mean, "≥", mean)
                         + " / " + targets.cell(f"{name}, n = {head}: worst", theirs[head].worst / ours[head].worst,
                                                "≥", worst))
        lines.append(f"| {name} | {' | '.join(cells)} |{' |' * (len(heads) - len(cells))}")
    return "\n".join(lines), targets.missed


def split(text: str, name: str) -> tuple[str, str, str]:
    """What is before, between and after the markers, these left to the outer parts."""
    before, begin, rest = text.partition(BEGIN + "\n")
    old, end, after = rest.partition("\n" + END)
    if not begin or not end:
        sys.exit(f"{name}: no lines {BEGIN} and {END}")
    return before + begin, old, end + after


def compare(old: str, new: str, name: str) -> list[str]:
    """What is wrong with the table in the file `name`."""
    if old.split("|")[1] != new.split("|")[1]:
        print(f"{name} has a table of another compiler: only the targets are checked")
    elif old != new:
        lines = difflib.unified_diff(old.splitlines(), new.splitlines(), name, "measured", lineterm="")
        print(*lines, sep="\n")
        return [f"{name} has another table: tests/benchmark/instructions.py --write {name}"]
    return []


def judge(missed: dict[str, str], known: list[str]) -> list[str]:
    """What is wrong: targets missed that are not known to be, and known ones that are met."""
    return ([f"{what} {how}" for what, how in missed.items() if what not in known]
            + [f"{what} is met: take it out of OPEN" for what in known if what not in missed])


def compiler() -> str:
    return re.search(r"(\d+\.\d+\.\d+)", run("arm-none-eabi-gcc", "--version").splitlines()[0])[1]


def one_case(core: str, engine: str, n: str, *options: str) -> int:
    cores = {name.lower(): name for name in CORES}
    if core.lower() not in cores or engine not in ENGINES or not n.isdecimal() or options not in ((), ("all",)):
        sys.exit(f"usage: instructions.py {'|'.join(cores)} {'|'.join(ENGINES)} N [all]")
    print(measure(Case(cores[core.lower()], engine, int(n), bool(options), climbs=MORE_CLIMBS)).text, end="")
    return 0


def main() -> int:
    arguments = sys.argv[1:]
    if len(arguments) > 2:
        return one_case(*arguments)
    if arguments and (len(arguments) != 2 or arguments[0] not in ("--write", "--check")):
        sys.exit(__doc__)
    new, missed = table(measure_all(), compiler())
    print(new, *(f"open: {what} {missed[what]}" for what in OPEN if what in missed), sep="\n")
    wrong = judge(missed, OPEN)
    if arguments:
        option, name = arguments
        before, old, after = split(Path(name).read_text(encoding="utf-8"), name)
        if option == "--write":
            Path(name).write_text(before + new + after, encoding="utf-8")
        else:
            wrong += compare(old, new, name)
    print(*wrong, f"instructions: {'failed' if wrong else 'passed'}", sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
