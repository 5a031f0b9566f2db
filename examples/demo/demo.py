"""Identify virtual actuators, track the paper's two profiles with the firmware built for them, report the errors.

Only the bench and the pictures are called from here; everything of rdpi goes through its commands, which are printed.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "build" / "demo"
sys.path.insert(0, str(ROOT / "tests" / "bench"))

import bench  # noqa: E402

RATE_HZ = 10_000
RANGE_V = "0", "100"
DAC = "16:0:100"
COMMISSION_S = "30"  # half the default; a whole minute tracks no better here, and would take the demo a minute more
PROFILES = {"10hz": "10 Hz", "5-20-35hz": "5, 20, 35 Hz"}
# Table 1 of the paper: rms / max, % of peak-to-peak
PAPER = {"10hz": ((8.6, 16.6), (1.0, 2.6), (0.9, 2.7)), "5-20-35hz": ((6.7, 16.6), (3.2, 10.7), (0.9, 4.4))}
NO_MODEL = "no model"


class Actuator(NamedTuple):
    """A virtual actuator, and the models of it that are compared."""

    law: str
    settings: dict[str, float]  # of the bench, beside those of the law
    models: dict[str, list[str]]  # their names and options of `rdpi fit`


ACTUATORS = {
    # The paper's law depends on the rate of the control input; for a real actuator the displacement's is the default.
    "paper": Actuator("paper", {}, {"rate-independent": ["--rate-independent"],
                                    "rate-dependent": ["--rate-source", "control"]}),
    "preisach": Actuator("preisach", {}, {"rate-independent": ["--rate-independent"], "rate-dependent": []}),
    "bouc-wen": Actuator("bouc-wen", {}, {"rate-independent": ["--rate-independent"], "rate-dependent": []}),
    # As preisach, but its amplifier lags by 0.5 ms and its converter is 1 ms late, as real ones are.
    "late": Actuator("preisach", {"amplifier_hz": 300.0, "delay_s": 1e-3},
                     {"operator alone": ["--effects", "none"], "whole chain": []}),
}
COLOURS = "C3", "C1", "C0"
FRONT_PAGE = "late"  # the actuator on the picture of README.md

Run = dict[str, np.ndarray]


def start(*command: str | Path) -> tuple[list[str], subprocess.Popen]:
    """A command as the user would type it, under way."""
    words = [str(word.relative_to(OUT) if isinstance(word, Path) and word.is_relative_to(OUT) else word)
             for word in command]
    program = ROOT / ".venv" / "bin" / words[0]
    return words, subprocess.Popen([str(program) if program.exists() else words[0], *words[1:]], cwd=OUT, text=True,
                                   stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def finish(words: list[str], process: subprocess.Popen, quiet: bool = False) -> None:
    """Wait for a command and print it; its output is shown unless quiet."""
    print("$ " + shlex.join(words), flush=True)
    output, _ = process.communicate()
    if process.returncode or not quiet:
        print("".join(f"    {line}\n" for line in output.splitlines()), end="")
    if process.returncode:
        sys.exit(f"demo: this command failed with status {process.returncode}")


def run(*command: str | Path, quiet: bool = False) -> None:
    finish(*start(*command), quiet)


def excite() -> str:
    """One drive tells all that a model needs; it says before it is played what it shows."""
    run("rdpi", "excite", "commission", "--max-V", RANGE_V[1], "--sample-rate", str(RATE_HZ), "--duration",
        COMMISSION_S, "--no-sweep", "-o", "commission.csv")  # the bench does the sweep
    return "commission.csv"


def record(kind: str, drive: str) -> str:
    """Play a drive on a fresh, demagnetised actuator; the recording."""
    law, settings, _ = ACTUATORS[kind]
    run("python", ROOT / "tests/bench/bench.py", law, drive, "--out-dir", kind,
        *(f"--set={name}={value:g}" for name, value in settings.items()), quiet=True)
    return f"{kind}/{drive}"


def build(model: str) -> Path:
    """Header of the model, and the firmware example compiled with it for the host; all share one build folder."""
    folder, shared = OUT / model.removesuffix(".json"), OUT / "build"
    folder.mkdir(exist_ok=True)
    run("rdpi", "header", model, "-o", folder / "rdpi_params.h")
    run("cmake", "-S", ROOT, "-B", shared, f"-DRDPI_PARAMS_DIR={folder}", "-DRDPI_BUILD_TESTS=OFF",
        "-DCMAKE_BUILD_TYPE=Release", quiet=True)
    run("cmake", "--build", shared, "--target", "track", quiet=True)
    run("cp", shared / "track", folder / "track", quiet=True)
    return folder / "track"


def play(kind: str, command_V: np.ndarray) -> np.ndarray:
    """What the sensor of a fresh, demagnetised actuator reads while the drive is played."""
    actuator = bench.make(ACTUATORS[kind].law, seed=7, **ACTUATORS[kind].settings)
    actuator.demagnetise(RATE_HZ)
    return actuator.run(command_V, RATE_HZ)


def drive_of(track: Path, reference: str, drive: str) -> np.ndarray:
    """Run the firmware over a reference; the volts of its DAC codes."""
    run(track, reference, "-o", drive, "--dac", DAC, quiet=True)
    return bench.read_drive(OUT / drive)[1]["command_V"]


def linear_drive(kind: str, reference_um: np.ndarray) -> np.ndarray:
    """No model: the best straight line through the identification recording."""
    columns = bench.read_drive(OUT / kind / "commission.csv")[1]
    slope, offset = np.polyfit(columns["displacement_um"], columns["command_V"], 1)
    return np.clip(slope * reference_um + offset, float(RANGE_V[0]), float(RANGE_V[1]))


def identify_and_track(kind: str, drive: str, references: dict[str, np.ndarray]) -> dict[str, list[Run]]:
    """Per profile, one run without a model and one for each model: drive and reading."""
    print(f"\n=== actuator: {kind}")
    models, recording = ACTUATORS[kind].models, record(kind, drive)
    limits = "--min-V", RANGE_V[0], "--max-V", RANGE_V[1], "--dac-bits", DAC.split(":")[0]
    files = {name: f"{kind}-{name.replace(' ', '-')}.json" for name in models}
    fits = [start("rdpi", "fit", recording, *limits, *options, "-o", files[name])
            for name, options in models.items()]  # side by side
    for fit in fits:
        finish(*fit)
    tracks = {file.removesuffix(".json"): build(file) for file in files.values()}
    runs: dict[str, list[Run]] = {}
    for profile, reference in references.items():
        drives = [linear_drive(kind, reference)]
        drives += [drive_of(track, f"{profile}.csv", f"{kind}/{profile}-{name}.csv") for name, track in tracks.items()]
        runs[profile] = [{"drive": drive, "reading": play(kind, drive)} for drive in drives]
    return runs


def models_of(kind: str) -> list[str]:
    return [NO_MODEL, *ACTUATORS[kind].models]


def print_table(errors: dict[str, dict[str, list[tuple[float, float]]]]) -> None:
    print("\nTracking error, rms / max in % of the profile's peak-to-peak (12.5 um)")
    print_rows(models_of("paper"), {
        f"{title}: {label}": row for profile, title in PROFILES.items() for label, row in
        {"paper's Table 1, measured": PAPER[profile],
         **{f"actuator {kind}": errors[kind][profile] for kind in errors
            if models_of(kind) == models_of("paper")}}.items()})
    print("\nThe same of an actuator whose amplifier lags and whose converter is late")
    print_rows(models_of("late"), {f"{title}: actuator late": errors["late"][profile]
                                   for profile, title in PROFILES.items()})


def print_rows(models: list[str], rows: dict[str, list[tuple[float, float]]]) -> None:
    print(f"{'':42}" + "".join(f"{name:>18}" for name in models))
    for label, row in rows.items():
        print(f"  {label:40}" + "".join(f"{f'{rms:.2f} / {peak:5.2f}':>18}" for rms, peak in row))


def draw(runs: dict[str, dict[str, list[Run]]], references: dict[str, np.ndarray], errors: dict) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 3.4 * len(runs)), layout="constrained")
    axes = figure.subplots(len(runs), 3, squeeze=False)
    time = {profile: np.arange(len(reference)) / RATE_HZ for profile, reference in references.items()}
    for row, kind in zip(axes, runs):
        loop, tracking, error = row
        metadata, recording, _ = bench.read_drive(OUT / kind / "commission.csv")
        saw_s = re.search(r"sawtooth ([\d.]+)-([\d.]+) s", metadata["parts"])
        saw = slice(*(round(float(time_s) * RATE_HZ) for time_s in saw_s.groups()))
        loop.plot(recording["command_V"][saw], recording["displacement_um"][saw], lw=0.6, color="grey")
        loop.set(title=f"{kind}: recorded sawtooth", xlabel="command [V]", ylabel="displacement [µm]")
        profile = "5-20-35hz"
        shown = slice(round(0.5 * RATE_HZ), round(0.8 * RATE_HZ))
        tracking.plot(time[profile][shown], references[profile][shown], color="black", lw=1.5, label="reference")
        for name, colour, found, (rms, peak) in zip(models_of(kind), COLOURS, runs[kind][profile],
                                                    errors[kind][profile]):
            tracking.plot(time[profile][shown], found["reading"][shown], color=colour, lw=1, label=name)
            error.plot(time[profile][shown], (found["reading"] - references[profile])[shown], color=colour, lw=1,
                       label=f"{name}: {rms:.2f} % rms, {peak:.1f} % max")
        tracking.set(title=f"{PROFILES[profile]}: displacement", xlabel="time [s]", ylabel="displacement [µm]")
        error.set(title="error", xlabel="time [s]", ylabel="error [µm]")
        for panel in (tracking, error):
            low, high = panel.get_ylim()
            panel.set_ylim(low, high + 0.45 * (high - low))  # room for the legend
            panel.legend(fontsize="small", loc="upper right")
    path = OUT / "demo.png"
    figure.savefig(path, dpi=100)
    return path


def draw_front_page(found: list[Run], reference_um: np.ndarray, errors: list[tuple[float, float]]) -> None:
    """The picture of README.md, build/demo/tracking.svg: one actuator without and with its models.

    Text stays text, for a test to read.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    shown = slice(round(0.5 * RATE_HZ), round(0.8 * RATE_HZ), 10)
    time_s = np.arange(len(reference_um)) / RATE_HZ
    path = OUT / "tracking.svg"
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "rdpi", "path.simplify": False, "font.size": 9}):
        figure = Figure(figsize=(8, 3), layout="constrained")
        loop, error = figure.subplots(1, 2)
        for name, colour, run_of, (rms, peak) in zip(models_of(FRONT_PAGE), COLOURS, found, errors):
            reading = run_of["reading"]
            loop.plot(reference_um[shown], reading[shown], color=colour, lw=1, label=name)
            error.plot(time_s[shown], (reading - reference_um)[shown], color=colour, lw=1,
                       label=f"{name}: {rms:.2f} % rms, {peak:.1f} % max")
        loop.set(xlabel="reference [µm]", ylabel="displacement [µm]")
        error.set(xlabel="time [s]", ylabel="error [µm]")
        low, high = error.get_ylim()
        error.set_ylim(low, high + 0.45 * (high - low))  # room for the legend
        for panel in (loop, error):
            panel.legend(fontsize="small", loc="upper left", frameon=False)
        figure.savefig(path, metadata={"Date": None, "Creator": None})
    text = re.sub(r'(?<= d=")[^"]+', lambda curve: re.sub(r"(\.\d)\d+", r"\1", curve[0]), path.read_text("utf-8"))
    path.write_text(text, "utf-8")  # a tenth of a point is enough: half the size


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    print(f"in {OUT}:")
    drive = excite()
    references = {profile: bench.paper_profile(profile, RATE_HZ, 2.0) for profile in PROFILES}
    for profile, reference in references.items():
        columns = np.column_stack([np.arange(len(reference)) / RATE_HZ, reference])
        np.savetxt(OUT / f"{profile}.csv", columns, "%.9g", ",", header="time_s,reference_um", comments="")
    runs = {kind: identify_and_track(kind, drive, references) for kind in ACTUATORS}
    errors = {kind: {profile: [bench.error_percent(found["reading"], references[profile], RATE_HZ)
                               for found in runs[kind][profile]]
                     for profile in PROFILES} for kind in runs}
    print_table(errors)
    (OUT / "demo.json").write_text(json.dumps(errors, indent=1) + "\n")
    print(f"\npicture: {draw(runs, references, errors)}")
    draw_front_page(runs[FRONT_PAGE]["5-20-35hz"], references["5-20-35hz"], errors[FRONT_PAGE]["5-20-35hz"])


if __name__ == "__main__":
    main()
