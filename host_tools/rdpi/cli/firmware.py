"""Commands around the firmware: header, profile, compensate."""

from __future__ import annotations

from typing import Any

import click

from ..errors import BadInput
from .program import command
from .progress import progress
from .types import Dac, Output


@command("header")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="rdpi_params.h", type=Output(),
              help="The header.")
@click.option("--name", default="rdpi_params", show_default=True, metavar="NAME",
              help="C name of the parameters, for several actuators in one firmware.")
@click.option("--sweep-end-V", "sweep_end_V", type=float, metavar="V",
              help="Where rdpi_f32_sweep ends. Default: the model's, drive.sweep_end_V, or what holds its memory.")
@click.option("--sweep-cycles", type=int, metavar="N", help="Cycles of that sweep. Default: the model's, or 20.")
@click.option("--sweep-rate", "sweep_V_per_s", type=float, metavar="V/S",
              help="Its speed. Default: the model's, or 20 Hz over the whole range, or what its slew limit allows.")
def header(model: str, output: str, name: str, **sweep: float | None) -> dict[str, Any]:
    """Generate the C header that the firmware compiles in. The same model gives the same bytes."""
    from dataclasses import replace

    from ..firmware import build_notes, write_header
    from ..model import read_model

    parameters = read_model(model)
    parameters.drive = replace(parameters.drive, **{key: value for key, value in sweep.items() if value is not None})
    no_fixed_point = write_header(parameters, output, name, source=model)
    _tell_effects(parameters)
    click.echo(f"{output}: {name}, {len(parameters.slopes) - 1} plays, {len(parameters.deadzones_um) - 1} dead zones, "
               f"starts from {parameters.start_V():.6g} V, start-up sweep ends at {parameters.sweep_end():.6g} V")
    for note in build_notes(parameters):
        click.echo(f"note: {note}")
    if no_fixed_point:
        click.echo(f"note: single precision only, not fixed point: {no_fixed_point}")
    return {"file": output, "name": name, "digest": parameters.digest(), "q31": not no_fixed_point}


def _tell_effects(model: Any) -> None:
    from ..firmware import effects_left_out

    if names := effects_left_out(model):
        click.echo(f"note: effects that only the simulation knows, not the inverse: {', '.join(names)}", err=True)


@command("profile")
@click.argument("source", metavar="FILE.csv", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="rdpi_profile.h", type=Output(),
              help="The header.")
@click.option("--reference-column", metavar="COLUMN", help="Column to follow, um. Default: reference_um.")
@click.option("--dac", type=Dac(), metavar="BITS:MIN_V:MAX_V",
              help="FILE.csv is a drive: its command_V as codes of this DAC, volts at the actuator.")
def profile(source: str, output: str, reference_column: str | None,
            dac: tuple[int, float, float] | None) -> dict[str, Any]:
    """Generate the C header of a table that the firmware plays: a reference, or with --dac a drive.

    FILE.csv needs the columns time_s and reference_um, or another --reference-column, in um; with --dac time_s and
    command_V. References are for port/profile, which converts them to the application's numbers when it is compiled;
    drives, as `rdpi excite` makes them, for examples/excite. The same file gives the same bytes.
    """
    from ..board import profile as tables
    from ..data import atomic_write, read_recording

    if dac is not None and reference_column is not None:
        raise BadInput("--reference-column: has no meaning with --dac, which makes a drive of command_V")
    column = "command_V" if dac is not None else reference_column or "reference_um"
    with progress("generating"):
        run = read_recording(source, required=("time_s", column))
        text = tables.render_reference(run, column) if dac is None else tables.render_drive(run, *dac)
        atomic_write(output, text)
    values, rate_hz = run.columns[column], tables.integer_rate_hz(run)
    unit = "um" if dac is None else "V"
    click.echo(f"{output}: {len(run)} samples at {rate_hz} per second, {values.min():g} to {values.max():g} {unit}, "
               f"{4 * len(run)} bytes of flash")
    result = {"file": output, "samples": len(run), "sample_rate_hz": rate_hz, "digest": run.digest}
    if dac is not None:
        result["sweep_samples"] = tables.sweep_samples(run)
        click.echo(f"the first {result['sweep_samples']} samples are a decaying sweep")
    elif refused := int((~tables.usable(values)).sum()):
        click.echo(f"note: {refused} samples are beyond the largest reference: the drive holds there; check their unit")
    return result


@command("compensate")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("reference", metavar="REFERENCE.csv", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="DRIVE.csv", type=Output(),
              help="The reference's columns and command_V, rate_um_per_s, flags and, with --dac-bits, dac_code.")
@click.option("--engine", default="f32", show_default=True,
              type=click.Choice(["f32", "q31", "f64", "numpy", "qemu-m0", "qemu-m3", "qemu-m4f", "qemu-m7"]),
              help="f32: the firmware library; q31: the same in fixed point; f64: in double; numpy: the independent "
                   "reference; qemu-...: the firmware itself on an emulated Cortex-M0, M3, M4F or M7.")
@click.option("--fixed-point", is_flag=True, help="The emulated firmware is that in fixed point. Default: single "
                                                  "precision, on every board.")
@click.option("--sweep", is_flag=True,
              help="Run the firmware's start-up sweep first, as a board does, and leave it out: the drive starts from "
                   "where that leaves the actuator. Default: from the model's memory, or what REFERENCE.csv tells of "
                   "it. Not with --engine numpy.")
@click.option("--dac-bits", type=int, metavar="BITS", help="Output codes of this many bits. Default: the model's.")
@click.option("--reference-column", default="reference_um", show_default=True, metavar="COLUMN",
              help="Column to follow; displacement_um of a recording shows how well its command is recovered.")
@click.option("--remove-offset", is_flag=True,
              help="First remove the recording's mean deviation from the model (thermal drift).")
def compensate(model: str, reference: str, output: str, engine: str, fixed_point: bool, sweep: bool,
               dac_bits: int | None, reference_column: str, remove_offset: bool) -> dict[str, Any]:
    """Run the inverse as the firmware does: reference in um to drive in V.

    REFERENCE.csv needs the columns time_s and reference_um, or another --reference-column. A board sweeps before it
    follows: its codes are those of --sweep.

    flags are the sum of 1 (rate clamped by the guard), 2 (drive clipped to its range), 4 (drive clipped by its slew
    limit), 8 (reference not usable, drive held) and 16 (the first after such samples). If REFERENCE.csv has a command_V
    it is kept as recorded_V, and the computed drive is compared with it.

    The engines qemu-... build examples/track for model and reference and run it in qemu-system-arm; they need the
    project's checkout (set RDPI_HOME where the tools are installed apart from it) and arm-none-eabi-gcc.
    """
    from dataclasses import replace

    from .. import board
    from ..data import read_recording, write_recording
    from ..model import read_model
    from ..simulate import chain

    parameters = read_model(model)
    _tell_effects(parameters)
    if dac_bits is not None:
        parameters.drive = replace(parameters.drive, dac_bits=dac_bits)
        parameters.validate()
    run = read_recording(reference, required=("time_s", reference_column))
    with progress("compensating") as report:
        found = board.compensate(parameters, run, reference_column, engine, fixed_point=fixed_point, sweep=sweep,
                                 remove_offset=remove_offset, report=report)
    result: dict[str, Any] = {"file": output, "engine": engine, "sweep": sweep, "samples": len(run),
                              **{f"{name}_count": count for name, count in found.flag_counts.items()}}
    if found.flag_counts["range"]:
        low_um, high_um = chain.reachable_um(parameters)
        click.echo(f"note: the drive was clipped; reachable {low_um:.5g} to {high_um:.5g} um, "
                   f"asked for {found.asked_um[0]:.5g} to {found.asked_um[1]:.5g} um")
    drive_V = found.steps.drive_V
    flagged = ", ".join(f"{found.flag_counts[name]} {name}" for name in ("guard", "range", "slew", "input"))
    click.echo(f"{output}: {len(run)} samples, {drive_V.min():.6g} to {drive_V.max():.6g} V, flagged: {flagged}")
    if score := found.score:
        click.echo(f"against the recorded command: rms {score.rms_percent:.3f} %, max {score.max_percent:.3f} % of its "
                   f"peak-to-peak" + (f" (offset of {found.offset_um:.4g} um removed)" if remove_offset else ""))
        result["recorded"] = {"rms_V": score.rms_um, "max_V": score.max_um, "rms_percent": score.rms_percent,
                              "max_percent": score.max_percent, "removed_um": found.offset_um}
    if found.why_unknown:
        click.echo(f"memory: unknown ({found.why_unknown})")
    write_recording(output, found.columns, found.metadata)
    return result
