#!/usr/bin/env python3
"""How many instructions one sample costs, counted on emulated Cortex-M: the times in the table of tests/size/size.py, and
tables of what they grow with.

    tests/benchmark/instructions.py                          prints the tables
    tests/benchmark/instructions.py --write lib/README.md    puts them between the markers there, sizes included
    tests/benchmark/instructions.py --check lib/README.md    fails if its times are not those there, or miss a target
    tests/benchmark/instructions.py --all                    prints the table of all builds, those of lib/README.md and more
    tests/benchmark/instructions.py m4f f32 9 [OPTION ...]   one case: core, engine, n, and the inputs that cost most.
                                                             Options: -Os (any level), quick, no-quick, least, all (rate
                                                             window, rate filter and slew limit)
    tests/benchmark/instructions.py m4f f32_all blocks       blocks of 16 samples of an engine that is a chain

Mean: over `profile`. Worst: of everything that the search in instructions/main.c finds. What is counted are the objects
that size.py measures. Another version of the compiler than the one that the table names makes other code: then only the
targets count.
"""

from __future__ import annotations

import math
import os
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "host_tools"), str(ROOT / "tests" / "size")]

import builds  # noqa: E402
import size  # noqa: E402
from builds import CORES, Build, Targets, run  # noqa: E402

from rdpi.firmware import header, parameters  # noqa: E402
from rdpi.model import Memory, Model, read_model  # noqa: E402
from rdpi.simulate import chain  # noqa: E402

WORK = ROOT / "build" / "instructions"
SOURCES = Path(__file__).with_suffix("")
BOARD = ROOT / "tests" / "emulator"
GROWTH, EFFECTS, BLOCKS = (f"<!-- tests/benchmark/instructions.py: {what} -->" for what in ("growth", "effects", "blocks"))
INCLUDES = ("lib/include", "lib/src", "tests/support", "tests/property")
# Of the counting program. It is compiled apart from what it counts, and subtracts itself.
FLAGS = "-std=gnu99 -O2 -mthumb -ffunction-sections -fdata-sections --specs=rdimon.specs".split()
LINK = "-nostartfiles -Wl,--gc-sections -Wl,--defsym=flash_size=4M -Wl,--defsym=ram_size=4M".split()
MACHINES = {"M4F": "mps2-an386", "M7": "mps2-an500", "M3": "mps2-an385",
            "M0": "mps2-an385"}  # whose SysTick counts; code for the M0 runs on an M3
EFFECT_NAMES = {"plain": "without effects", "lead": "lead", "creep": "lead, creep", "lag": "lag", "all": "lead, creep, lag"}
ENGINES = {  # a library with effects, or the formula; and flags of the counting program
    "f32": ("f32", '-DENGINE="f32.h"'),
    **{f"{kind}_{name}": (f"{kind}_chain", f'-DENGINE="{kind}_chain.h" -DLEADS={leads} -DLAGS={lags} -DPOLES={poles}')
       for kind in ("f32", "q31")
       for name, leads, lags, poles in (("plain", 0, 0, 0), ("lead", 1, 0, 0), ("creep", 1, 0, 5), ("lag", 0, 1, 0),
                                        ("all", 1, 1, 5))},
    **{f"{kind}_axis": (f"{kind}_axis", f'-DENGINE="{kind}_axis.h" -DLEADS=1 -DLAGS=1 -DPOLES=5') for kind in ("f32", "q31")},
    "q31": ("q31", '-DENGINE="q31.h"'),
    "formula": ("formula", '-DENGINE="formula.h"'),
    "formula_linear": ("formula", '-DENGINE="formula.h" -DFORMULA_LINEAR'),
}  # fmt: skip
SAMPLE_TIME_S = 1e-4
OPTIONS_WINDOW = 16  # samples in the rate window where all options are on
MORE_CLIMBS = 1000  # where the table has targets


@dataclass(frozen=True)
class Case:
    core: str
    engine: str
    n: int = 9
    level: str = "-O2"
    quick: int | None = None
    least: bool = False
    options: bool = False  # rate window, rate filter, slew limit
    seed: int = 1
    climbs: int = 200

    @property
    def build(self) -> Build:
        """Of the formula: the settings that it shares with the library."""
        library = ENGINES[self.engine][0]
        return Build("f32" if library == "formula" else library, self.core, self.level, self.quick, self.least, self.n + 1,
                     OPTIONS_WINDOW if self.options else 1)


SIZES = (4, 9, 16, 32, 64)  # n: plays beside the identity
PER_PLAY, OPTIONS = "worst per play", "9, all options"  # heads of further columns
BLOCK = 16  # samples
GROWING = {  # the rows of the table of growth, and their engines
    **{f"rdpi_{kind}, {core}, {level}": Case(core, kind, level=level)
       for kind, core, level in (("f32", "M4F", "-O2"), ("f32", "M4F", "-Os"), ("q31", "M3", "-O2"), ("q31", "M0", "-O2"))},
    **{f"{name}, M4F, -O2": Case("M4F", engine)
       for engine, name in (("formula", "formula"), ("formula_linear", "formula in O(n)"))}}
CHAINS = [Build("f32_chain", "M4F", "-O2"), Build("f32_chain", "M4F", "-Os"), Build("q31_chain", "M3", "-O2"),
          Build("q31_chain", "M0", "-O2")]  # the rows of the tables of effects and of blocks
# Mean and worst, n = 9. The later of two is the older one, which stays the aim.
TARGETS = {Build("f32", "M4F", "-O2"): ((97, 100), (500, 260)), Build("f32", "M4F", "-Os"): ((200,), ()),
           Build("q31", "M3", "-O2"): ((160,), (500,)), Build("q31", "M0", "-O2"): ((600,), (2200,))}
CHAIN_TARGETS = {"lead": 125, "creep": 180, "lag": 125, "all": 180}  # mean of rdpi_f32_chain, M4F, -O2
PLAIN_MORE = 3  # than the operator alone
RATIOS = (8, 3)  # formula over rdpi_f32 on the M4F, n = 9: mean, worst
MAX_BLOCK_MEAN = 1.05  # of a sample in a block over the mean of single steps, of rdpi_f32_chain on the M4F, -O2
# Targets that are still to be met. One that is met, or that is missed and not named here, fails.
OPEN = ["rdpi_f32, M4F, -O2: worst ≤ 500", "rdpi_f32, M4F, -O2: worst ≤ 260",
        "rdpi_q31, M3, -O2: worst", "rdpi_q31, M0, -O2: worst", "rdpi_f32, M4F, -O2, n = 64: mean",
        "formula, M4F, -O2 : rdpi_f32, n = 9: worst", "rdpi_f32_chain, M4F, -O2, lag: mean",
        "rdpi_f32_chain, M4F, -O2, lead, creep, lag: mean", "rdpi_f32_chain, M4F, -O2, without effects, in a block: mean",
        *(f"rdpi_f32_chain, M4F, -O2, {effects}: worst block" for effects in ("without effects", "lead, creep, lag"))]
MARGIN = 1.02  # on the worst of the M0: its software arithmetic takes its time by the numbers, and no search finds all
MAX_GROWTH = 1.25  # of the mean from n = 9, where 0.1 plays engage per sample of the profile, to n = 64: 0.8
MAX_DEPARTURE = 0.05  # of the worst from a straight line in n


@dataclass(frozen=True)
class Result:
    mean: float
    worst: int  # of what the search found where no sample was missed or refused before
    worst_late: int  # of all that it found
    text: str


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


def image(case: Case, *defines: str) -> Path:
    """The program that measures."""
    folder = WORK / "-".join(map(str, (case.engine, case.build.folder.name, case.seed, case.climbs, *defines)))
    folder.mkdir(parents=True, exist_ok=True)
    write_case(case, folder)
    library, engine_flags = ENGINES[case.engine]
    numbers = {"RDPI_MAX_PLAYS": case.build.plays, "RDPI_MAX_WINDOW": case.build.window, "RDPI_MAX_POLES": 5,
               "SAMPLE_TIME_NS": round(SAMPLE_TIME_S * 1e9), "SEED": case.seed, "CLIMBS": case.climbs}  # fmt: skip
    numbers |= {"RDPI_MAX_CURVE_PIECES": 1, "RDPI_NOISE_SHAPING": 0} if case.least else {}
    given = [*engine_flags.split(), *defines, *(f"-D{name}={number}u" for name, number in numbers.items())]
    includes = [f"-I{path}" for path in (folder, SOURCES, *(ROOT / name for name in INCLUDES))]
    if library == "formula":
        objects = [folder / "formula.o"]
        # It gets the fused operations of the core, which the library asks for itself.
        run(*case.build.compiler, "-ffp-contract=fast", *engine_flags.split(), f"-DSAMPLE_TIME_NS={numbers['SAMPLE_TIME_NS']}u", *includes, "-c", SOURCES / "formula.c", "-o", objects[0])
    else:
        objects = case.build.objects()
    program = folder / "image.elf"
    run("arm-none-eabi-gcc", *FLAGS, *LINK, *CORES[case.core].split(), *given, *includes, SOURCES / "main.c", *objects,
        BOARD / "board.c", "-T", ROOT / "port/cortex_m/cortex_m.ld", "-o", program)
    return program


def emulate(program: Path, core: str, *options: str) -> str:
    return run("qemu-system-arm", "-M", MACHINES[core], "-nographic", "-monitor", "none", "-serial", "none",
               "-semihosting", *options, "-kernel", program)


def figures_of(text: str) -> dict[str, float]:
    return {name: float(figure) for name, figure in re.findall(r"^([a-z ]+): ([\d.]+)", text, re.M)}


def measure(case: Case) -> Result:
    text = emulate(image(case), case.core, "-icount", "shift=10")
    figures = figures_of(text)
    mean, late = figures.pop("mean"), figures.pop("after missed")
    margin = MARGIN if case.core == "M0" else 1
    in_time, any_time = (math.ceil(margin * figure) for figure in (max(figures.values()), max(late, *figures.values())))
    return Result(mean, in_time, any_time, text)


def measure_blocks(case: Case) -> dict[str, float]:
    """`single`: the mean of a step over the profile; `mean` and `worst` of blocks: per sample, and of a whole block."""
    return figures_of(emulate(image(case, f"-DBLOCK={BLOCK}u"), case.core, "-icount", "shift=10"))


# ---- the tables ----


def case_of(build: Build, effects: str = "all") -> Case:
    """The case of a row: a chain has all effects, and an axis has that chain."""
    engine = build.library.replace("chain", effects)
    climbs = {"f32": MORE_CLIMBS, "q31": MORE_CLIMBS, "q31_chain": 20, "q31_axis": 20}.get(build.library, Case.climbs)
    if build.library == "f32" and build.core in ("M3", "M0"):  # no hardware for it: that it works, not how it grows
        climbs = Case.climbs
    return Case(build.core, engine, 9, build.level, build.quick, build.least, climbs=climbs)


def growth_cases(case: Case) -> dict[str, Case]:
    """By the head of the column."""
    few, many = (Case.climbs, MORE_CLIMBS) if case.engine in ("f32", "q31") else (10, 10)  # one formula is like another
    every = {str(n): replace(case, n=n, climbs=many if n == 9 else few) for n in SIZES}
    return every | {OPTIONS: replace(case, options=True)}


@dataclass
class Measured:
    times: dict[Build, Result]
    growth: dict[str, dict[str, Result]]  # by row, by head of the column
    effects: dict[Build, dict[str, Result]]
    blocks: dict[tuple[Build, str], dict[str, float]]


def measure_all() -> Measured:
    growth = {name: growth_cases(case) for name, case in GROWING.items()}
    effects = {build: {effect: case_of(build, effect) for effect in EFFECT_NAMES} for build in CHAINS}
    block_cases = {(build, effect): case_of(build, effect) for build in CHAINS for effect in ("plain", "all")}
    wanted = {*map(case_of, builds.ROWS), *(case for row in (*growth.values(), *effects.values()) for case in row.values())}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        blocks = {key: pool.submit(measure_blocks, case) for key, case in block_cases.items()}
        found = dict(zip(wanted, pool.map(measure, wanted)))
        return Measured({build: found[case_of(build)] for build in builds.ROWS},
                        {name: {head: found[case] for head, case in row.items()} for name, row in growth.items()},
                        {build: {effect: found[case] for effect, case in row.items()} for build, row in effects.items()},
                        {key: future.result() for key, future in blocks.items()})


def straight_line(results: dict[str, Result]) -> tuple[float, float]:
    """Of the worst counts against n: how many per play, and the largest departure from the line, relative."""
    worst = np.array([results[str(n)].worst for n in SIZES])
    per_play, base = np.polyfit(SIZES, worst, 1)
    return per_play, float(np.max(np.abs(base + per_play * np.array(SIZES) - worst) / worst))


def time_cells(times: dict[Build, Result], targets: Targets) -> dict[str, tuple[str, ...]]:
    """Of each build, by its name."""
    found = {}
    for build, result in times.items():
        mean, worst = TARGETS.get(build, ((), ()))
        found[build.name] = (targets.cell(f"{build.name}: mean", round(result.mean), *mean),
                             targets.cell(f"{build.name}: worst", result.worst, *worst), str(result.worst_late))
    return found


def growth_table(growth: dict[str, dict[str, Result]], targets: Targets) -> str:
    heads = [*map(str, SIZES), PER_PLAY, OPTIONS]
    lines = [f"| mean / worst, arm-none-eabi-gcc {builds.version()} | n = {' | '.join(heads)} |",
             "|---|" + "---:|" * len(heads)]
    growing = {build.name for build in TARGETS if build.level == "-O2"}
    for name, results in growth.items():
        cells = {}
        for head, result in results.items():
            mean = [round(MAX_GROWTH * results["9"].mean)] if head == str(SIZES[-1]) and name in growing else []
            cells[head] = targets.cell(f"{name}, n = {head}: mean", round(result.mean), *mean) + f" / {result.worst}"
        if name.startswith("rdpi"):
            per_play, departure = straight_line(results)
            cells[PER_PLAY] = f"{per_play:.1f}"
            if departure > MAX_DEPARTURE:
                targets.missed[f"{name}: growth of the worst"] = f"is {departure:.0%} off a straight line in n"
        lines.append(f"| {name} | {' | '.join(cells.get(head, '') for head in heads)} |")
    ours = growth["rdpi_f32, M4F, -O2"]
    for formula in ("formula, M4F, -O2", "formula in O(n), M4F, -O2"):
        name = f"{formula} : rdpi_f32"
        cells = []
        for head in map(str, SIZES):
            mean, worst = RATIOS if (formula, head) == ("formula, M4F, -O2", "9") else (None, None)
            theirs = growth[formula][head]
            pairs = (("mean", theirs.mean / ours[head].mean, mean), ("worst", theirs.worst / ours[head].worst, worst))
            cells.append(" / ".join(targets.cell(f"{name}, n = {head}: {what}", ratio, *([] if limit is None else [limit]),
                                                 relation="≥") for what, ratio, limit in pairs))
        lines.append(f"| {name} | {' | '.join(cells)} |{' |' * (len(heads) - len(cells))}")
    return "\n".join(lines)


def effects_table(effects: dict[Build, dict[str, Result]], operator_mean: float, targets: Targets) -> str:
    lines = [f"| mean / worst, arm-none-eabi-gcc {builds.version()} | {' | '.join(EFFECT_NAMES.values())} |",
             "|---|" + "---:|" * len(EFFECT_NAMES)]
    for build, results in effects.items():
        cells = []
        for effect, result in results.items():
            held = [CHAIN_TARGETS.get(effect, round(operator_mean) + PLAIN_MORE)] if build == CHAINS[0] else []
            mean = targets.cell(f"{build.name}, {EFFECT_NAMES[effect]}: mean", round(result.mean), *held)
            cells.append(f"{mean} / {result.worst}")
        lines.append(f"| {build.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def blocks_table(blocks: dict[tuple[Build, str], dict[str, float]], effects: dict[Build, dict[str, Result]],
                 targets: Targets) -> str:
    heads = "a step: mean", "in a block: mean", f"worst block of {BLOCK}", f"{BLOCK} means and one worst"
    lines = [f"| arm-none-eabi-gcc {builds.version()} | {' | '.join(heads)} |", "|---|" + "---:|" * len(heads)]
    for (build, effect), figures in blocks.items():
        name = f"{build.name}, {EFFECT_NAMES[effect]}"
        single, per_sample = figures["single"], figures["mean"]
        bound = round(BLOCK * per_sample) + effects[build][effect].worst
        held = build == CHAINS[0]
        cells = (f"{single:.1f}", targets.cell(f"{name}, in a block: mean", per_sample,
                                               *[round(MAX_BLOCK_MEAN * single, 1)] * held),
                 targets.cell(f"{name}: worst block", round(figures["worst"]), *[bound] * held), str(bound))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def tables(measured: Measured, targets: Targets) -> dict[str, str]:
    """Those of the times alone, by their markers."""
    operator = measured.times[Build("f32", "M4F", "-O2")].mean
    return {GROWTH: growth_table(measured.growth, targets), EFFECTS: effects_table(measured.effects, operator, targets),
            BLOCKS: blocks_table(measured.blocks, measured.effects, targets)}


def cost_table(times: dict[str, tuple[str, ...]], sizes: dict[str, tuple[str, ...]]) -> str:
    """Of those that have both."""
    return "\n".join([builds.head(), *(builds.line(build, times[build.name], sizes[build.name])
                                       for build in builds.ALL_IN_ORDER if build.name in times and build.name in sizes)])


def compare(old: str, new: str, name: str) -> list[str]:
    """What is wrong with a table in the file `name`."""
    if builds.other_compiler(old, new):
        print(f"{name} has a table of another compiler: only the targets are checked")
    elif old != new:
        print(builds.differences(old, new, name))
        return [f"{name} has another table: tests/benchmark/instructions.py --write {name}"]
    return []


def judge(missed: dict[str, str], known: list[str]) -> list[str]:
    """What is wrong: targets missed that are not known to be, and known ones that are met."""
    return ([f"{what} {how}" for what, how in missed.items() if what not in known]
            + [f"{what} is met: take it out of OPEN" for what in known if what not in missed])


def one_case(core: str, engine: str, what: str, *options: str) -> int:
    cores = {name.lower(): name for name in CORES}
    words = {"quick": {"quick": 2}, "no-quick": {"quick": 0}, "least": {"least": True}, "all": {"options": True}}
    known = all(option in words or option.startswith("-O") for option in options)
    if core.lower() not in cores or engine not in ENGINES or not (what.isdecimal() or what == "blocks") or not known:
        sys.exit(f"usage: instructions.py {'|'.join(cores)} {'|'.join(ENGINES)} N|blocks [-O...] [{'] ['.join(words)}]")
    chosen = {}
    for option in options:
        chosen |= words.get(option, {"level": option})
    case = Case(cores[core.lower()], engine, climbs=MORE_CLIMBS, **chosen)
    if what == "blocks":
        print(*(f"{name}: {figure:g}" for name, figure in measure_blocks(case).items()), sep="\n")
    else:
        print(measure(replace(case, n=int(what))).text, end="")
    return 0


def all_builds() -> int:
    sizes, broken = size.size_cells(size.measure_all(builds.ALL_IN_ORDER))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        times = dict(zip(builds.ALL_IN_ORDER, pool.map(lambda build: measure(case_of(build)), builds.ALL_IN_ORDER)))
    print(cost_table(time_cells(times, Targets()), sizes), *broken, sep="\n")
    return 1 if broken else 0


def main() -> int:
    arguments = sys.argv[1:]
    if arguments == ["--all"]:
        return all_builds()
    if len(arguments) > 2:
        return one_case(*arguments)
    if arguments and (len(arguments) != 2 or arguments[0] not in ("--write", "--check")):
        sys.exit(__doc__)
    option, name = arguments or ("", ROOT / "lib" / "README.md")
    targets = Targets()
    measured = measure_all()
    times = time_cells(measured.times, targets)
    new = tables(measured, targets)
    text = Path(name).read_text(encoding="utf-8")
    old = {marker: builds.split(text, name, marker)[1] for marker in (builds.BEGIN, *new)}
    sizes, wrong = builds.sizes_of(old[builds.BEGIN]), []
    if option != "--check":
        sizes, wrong = size.size_cells(size.measure_all(builds.ROWS))
    new = {builds.BEGIN: cost_table(times, sizes)} | new
    print(*new.values(), *(f"open: {what} {targets.missed[what]}" for what in OPEN if what in targets.missed), sep="\n")
    wrong += judge(targets.missed, OPEN)
    for marker, table in new.items():
        if option == "--write":
            before, _, after = builds.split(text, name, marker)
            text = before + table + after
        elif option == "--check":
            wrong += compare(old[marker], table, name)
    if option == "--write":
        Path(name).write_text(text, encoding="utf-8")
    print(*wrong, f"instructions: {'failed' if wrong else 'passed'}", sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
