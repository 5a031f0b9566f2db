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
MODELS = "no model", "rate-independent", "rate-dependent"
# The paper's law depends on the rate of the control input; for a real actuator the displacement's rate is the default.
FIT_OPTIONS = {"paper": ["--rate-source", "control"], "preisach": [], "bouc-wen": []}

Run = dict[str, np.ndarray]


def run(*command: str | Path, quiet: bool = False) -> None:
    """A command as the user would type it, printed; its output is shown unless quiet."""
    words = [str(word.relative_to(OUT) if isinstance(word, Path) and word.is_relative_to(OUT) else word)
             for word in command]
    print("$ " + shlex.join(words), flush=True)
    program = ROOT / ".venv" / "bin" / words[0]
    done = subprocess.run([str(program) if program.exists() else words[0], *words[1:]], cwd=OUT, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode or not quiet:
        print("".join(f"    {line}\n" for line in done.stdout.splitlines()), end="")
    if done.returncode:
        sys.exit(f"demo: this command failed with status {done.returncode}")


def excite() -> str:
    """One drive tells all that a model needs; it says before it is played what it shows."""
    run("rdpi", "excite", "commission", "--max-V", RANGE_V[1], "--sample-rate", str(RATE_HZ), "--duration",
        COMMISSION_S, "--no-sweep", "-o", "commission.csv")  # the bench does the sweep
    return "commission.csv"


def build(model: str) -> Path:
    """Header of the model, and the firmware example compiled with it for the host; all share one build folder."""
    folder, shared = OUT / model.removesuffix(".json"), OUT / "build"
    folder.mkdir(exist_ok=True)
    run("rdpi", "header", model, "-o", folder / "rdpi_params.h", quiet=True)
    run("cmake", "-S", ROOT, "-B", shared, f"-DRDPI_PARAMS_DIR={folder}", "-DRDPI_BUILD_TESTS=OFF",
        "-DCMAKE_BUILD_TYPE=Release", quiet=True)
    run("cmake", "--build", shared, "--target", "track", quiet=True)
    run("cp", shared / "track", folder / "track", quiet=True)
    return folder / "track"


def play(kind: str, command_V: np.ndarray) -> np.ndarray:
    """What the sensor of a fresh, demagnetised actuator reads while the drive is played."""
    actuator = bench.make(kind, seed=7)
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
    """Per profile, one run for each of MODELS: drive and reading."""
    print(f"\n=== actuator: {kind}")
    recording = f"{kind}/{drive}"
    run("python", ROOT / "tests/bench/bench.py", kind, drive, "--out-dir", kind, quiet=True)
    limits = "--min-V", RANGE_V[0], "--max-V", RANGE_V[1], "--dac-bits", DAC.split(":")[0]
    tracks = []
    for name, options in (("rate-independent", ["--rate-independent"]), ("rate-dependent", FIT_OPTIONS[kind])):
        model = f"{kind}-{name}.json"
        run("rdpi", "fit", recording, *limits, *options, "-o", model)
        tracks.append(build(model))
    runs: dict[str, list[Run]] = {}
    for profile, reference in references.items():
        found = [linear_drive(kind, reference)]
        for track, name in zip(tracks, MODELS[1:]):
            found.append(drive_of(track, f"{profile}.csv", f"{kind}/{profile}-{name}.csv"))
        runs[profile] = [{"drive": drive, "reading": play(kind, drive)} for drive in found]
    return runs


def print_table(errors: dict[str, dict[str, list[tuple[float, float]]]]) -> None:
    print("\nTracking error, rms / max in % of the profile's peak-to-peak (12.5 um)")
    print(f"{'':42}" + "".join(f"{name:>18}" for name in MODELS))
    for profile, title in PROFILES.items():
        rows = {"paper's Table 1, measured": PAPER[profile]}
        rows |= {f"actuator {kind}": errors[kind][profile] for kind in errors}
        for label, row in rows.items():
            cells = "".join(f"{f'{rms:.2f} / {peak:5.2f}':>18}" for rms, peak in row)
            print(f"  {f'{title}: {label}':40}{cells}")


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
        for name, colour, found in zip(MODELS, ("C3", "C1", "C0"), runs[kind][profile]):
            rms, peak = errors[kind][profile][MODELS.index(name)]
            if name != MODELS[1]:
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
    """The picture of README.md, build/demo/tracking.svg: one actuator without and with its model.

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
        for k, name, colour in ((0, MODELS[0], "C3"), (2, "with rdpi", "C0")):
            reading, (rms, peak) = found[k]["reading"], errors[k]
            loop.plot(reference_um[shown], reading[shown], color=colour, lw=1, label=name)
            error.plot(time_s[shown], (reading - reference_um)[shown], color=colour, lw=1,
                       label=f"{name}: {rms:.2f} % rms, {peak:.1f} % max")
        loop.set(xlabel="reference [µm]", ylabel="displacement [µm]")
        error.set(xlabel="time [s]", ylabel="error [µm]")
        low, high = error.get_ylim()
        error.set_ylim(low, high + 0.35 * (high - low))  # room for the legend
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
    runs = {kind: identify_and_track(kind, drive, references) for kind in FIT_OPTIONS}
    errors = {kind: {profile: [bench.error_percent(found["reading"], references[profile], RATE_HZ)
                               for found in runs[kind][profile]]
                     for profile in PROFILES} for kind in runs}
    print_table(errors)
    (OUT / "demo.json").write_text(json.dumps(errors, indent=1) + "\n")
    print(f"\npicture: {draw(runs, references, errors)}")
    draw_front_page(runs["preisach"]["5-20-35hz"], references["5-20-35hz"],
                     errors["preisach"]["5-20-35hz"])


if __name__ == "__main__":
    main()
