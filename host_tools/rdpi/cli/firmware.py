"""Commands around the firmware: header, profile, compensate."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from ..errors import BadInput
from .program import command
from .progress import progress
from .types import Dac, ModelFile, Output, Report

if TYPE_CHECKING:
    from ..model import Model
    from ..simulate import Inverse

NOISE_SHAPING = click.option(
    "--noise-shaping", is_flag=True,
    help="Carry what each DAC code misses to the next one, so that slow errors of rounding become small and fast ones "
         "larger. For sample rates far above the bandwidth. Default: each drive is rounded to the nearest code.")
NO_UM = "_V", "_s", "_degC", "_code"  # what names of columns that hold no displacement end with
EFFECT_OPTIONS = (
    click.option("--effects", type=click.Choice(["all", "none"]), default="all", show_default=True,
                 help="Compensate all effects of the model that the firmware can compensate, or none. With none, the "
                      "operator is the one that was fitted as if nothing stood around it."),
    click.option("--leave-out", multiple=True, metavar="NAME",
                 help="Do not compensate this effect. May be given several times."),
    click.option("--no-preview", "preview", is_flag=True, default=True, flag_value=False,
                 help="The caller does not know the reference ahead of time; the firmware extrapolates it. Prints what "
                      "that costs. Default: the caller passes the reference ahead of time."),
    click.option("--sensor-delay", "sensor_delay_s", type=float, default=0.0, metavar="S",
                 help="Delay of the sensor from its data sheet, s. That much of the delay that was found is not "
                      "compensated. Default: 0."),
    click.option("--sensor-lag", "sensor_lag_s", type=float, default=0.0, metavar="S",
                 help="Time constant of the sensor's filter from its data sheet, s, likewise. Default: 0."),
    click.option("--backlash-time", "jump_s", type=float, default=0.002, show_default=True, metavar="S",
                 help="Time that the jump over backlash at each reversal is spread over, s. A jump that takes less time "
                      "lets the mechanics ring; while it lasts, the stage stands still."),
)


def effect_options(function: Callable) -> Callable:
    """Options that say what of the model's effects is compensated."""
    for option in reversed(EFFECT_OPTIONS):
        function = option(function)
    return function


def _given(model: Model, options: dict[str, tuple[str, float | None]]) -> None:
    """Put the values of options in place of the model's keys below drive; the option is named if one is wrong."""
    from dataclasses import replace

    for option, (key, value) in options.items():
        if value is not None:
            model.drive = replace(model.drive, **{key: value})
            model.validate(f"{option} {value:g}")


def _check_in_um(column: str) -> None:
    """Raise BadInput for a column that is no displacement by its name: volts would be followed as um."""
    if column.endswith(NO_UM):
        raise BadInput(f"--reference-column {column}: is no displacement; give a column in um")


def _shaped(model: Model) -> None:
    """Ask for noise shaping."""
    from dataclasses import replace

    if not model.drive.dac_bits:
        raise BadInput(f"--noise-shaping: is only valid with DAC codes, but {model.where} has no drive.dac_bits; "
                       "give --dac-bits to `rdpi fit`, or to `rdpi compensate`")
    model.drive = replace(model.drive, noise_shaping=True)


def _inverse(model: Model, effects: str, leave_out: tuple[str, ...], preview: bool, sensor_delay_s: float,
             sensor_lag_s: float, jump_s: float) -> Inverse:
    """The inverse that these options ask for, told line by line."""
    from ..simulate import ALL, inverse_of
    from ..simulate.effects import Sensor

    if effects == "none" and leave_out:
        raise BadInput("--leave-out: --effects none leaves all effects out")
    found = inverse_of(model, leave_out=(ALL,) if effects == "none" else leave_out, preview=preview,
                       sensor=Sensor(sensor_delay_s, sensor_lag_s), jump_s=jump_s)
    for line in found.lines:
        click.echo(line)
    if effects == "none" and not preview:
        click.echo("note: --no-preview changes nothing: with --effects none nothing looks ahead")
    costs = found.costs()
    if not preview and costs:
        click.echo("without preview, error of a sine in % of its amplitude, high sample rates:")
        click.echo("      Hz   without lead   with lead")
        for frequency, without, extrapolated in costs:
            click.echo(f"{frequency:8g}{round(100 * without, 9):13.3g} %{round(100 * extrapolated, 9):10.3g} %")
    if late := found.rings_late():
        click.echo(f"note: {late}")
    return found


def _hertz(rate_hz: float) -> str:
    for size, unit in ((1e6, "MHz"), (1e3, "kHz")):
        if rate_hz >= size:
            return f"{rate_hz / size:g} {unit}"
    return f"{rate_hz:g} Hz"


def _effects_of(inverse: Inverse) -> list[dict[str, Any]]:
    return [one.to_json() for one in inverse.told]


@command("header")
@click.argument("model", metavar="MODEL.json", type=ModelFile())
@click.option("-o", "--output", required=True, metavar="rdpi_params.h", type=Output(),
              help="The header.")
@click.option("--name", default="rdpi_params", show_default=True, metavar="NAME",
              help="C name of the parameters. Use several names for several actuators in one firmware.")
@click.option("--sweep-end-V", "sweep_end_V", type=float, metavar="V",
              help="Drive at which the start-up sweep ends, V. Default: the model's drive.sweep_end_V; without one, "
                   "the drive that holds the model's memory.")
@click.option("--sweep-cycles", type=int, metavar="N", help="Cycles of the start-up sweep. Default: the model's; "
                                                            "without a value there, 20.")
@click.option("--sweep-rate", "sweep_V_per_s", type=float, metavar="V/S",
              help="Speed of the start-up sweep, V/s. Default: the model's; without one, 20 Hz over the whole range, "
                   "or the slew limit if that is lower.")
@NOISE_SHAPING
@effect_options
def header(model: str, output: str, name: str, sweep_end_V: float | None, sweep_cycles: int | None,
           sweep_V_per_s: float | None, noise_shaping: bool, **of_effects: Any) -> dict[str, Any]:
    """Generate the C header with the parameters of a model.

    The firmware compiles it. The header holds the operator, rdpi_params, and what stands around it, rdpi_chain. For
    each effect of the model one line says what the firmware does about it: it compensates the effect, the effect is
    folded into the operator's parameters, or it is left out, and why. Another line says which sample rates the firmware
    accepts with it; a slower start-up sweep (--sweep-rate) lowers them. The same model gives the same bytes.
    """
    from ..firmware import build_notes, write_header
    from ..model import read_model

    parameters = read_model(model)
    _given(parameters, {"--sweep-end-V": ("sweep_end_V", sweep_end_V), "--sweep-cycles": ("sweep_cycles", sweep_cycles),
                        "--sweep-rate": ("sweep_V_per_s", sweep_V_per_s)})
    if noise_shaping:
        _shaped(parameters)
    inverse = _inverse(parameters, **of_effects)
    parameters, chain = inverse.model, inverse.chain
    written = write_header(parameters, output, name, model, chain, inverse.addends, inverse.jump)
    click.echo(f"{output}: {name}, {len(parameters.slopes) - 1} plays, {len(parameters.deadzones_um) - 1} dead zones, "
               f"starts from {parameters.start_V():.6g} V, start-up sweep ends at {parameters.sweep_end():.6g} V")
    click.echo(f"sample rates {_hertz(written.rates_hz[0])} to {_hertz(written.rates_hz[1])}")
    for note in build_notes(parameters, chain):
        click.echo(f"note: {note}")
    if written.no_fixed_point:
        click.echo(f"note: the header has no fixed-point parameters, only single precision: {written.no_fixed_point}")
    return {"file": output, "name": name, "digest": written.digest, "q31": not written.no_fixed_point,
            "sample_rates_hz": list(written.rates_hz), "chain": chain.acts, "effects": _effects_of(inverse)}


@command("profile")
@click.argument("source", metavar="FILE.csv", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="rdpi_profile.h", type=Output(),
              help="The header.")
@click.option("--reference-column", metavar="COLUMN", help="Column to follow, um. Default: reference_um.")
@click.option("--dac", type=Dac(), metavar="BITS:MIN_V:MAX_V",
              help="Convert a drive: command_V of FILE.csv becomes codes of this DAC. Volts are at the actuator.")
def profile(source: str, output: str, reference_column: str | None,
            dac: tuple[int, float, float] | None) -> dict[str, Any]:
    """Generate the C header with a table for the firmware.

    The table is a reference, or with --dac a drive.

    \b
    reference  needs the columns time_s and reference_um (or --reference-column), in um; for port/profile
    drive      needs the columns time_s and command_V, as `rdpi excite` makes them; for examples/excite

    References are converted to the application's number format when port/profile is compiled. The same file gives the
    same bytes.
    """
    from ..board import profile as tables
    from ..data import atomic_write, read_recording

    if dac is not None and reference_column is not None:
        raise BadInput("--reference-column: is only valid without --dac; with --dac the column is command_V")
    column = "command_V" if dac is not None else reference_column or "reference_um"
    if dac is None:
        _check_in_um(column)
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
        if result["sweep_samples"]:
            click.echo(f"the first {result['sweep_samples']} samples are a decaying sweep")
    elif refused := int((~tables.usable(values)).sum()):
        click.echo(f"note: {refused} samples are beyond the largest reference; the firmware holds the drive there: "
                   "check the unit")
    return result


@command("compensate")
@click.argument("model", metavar="MODEL.json", type=ModelFile())
@click.argument("reference", metavar="REFERENCE.csv", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="DRIVE.csv", type=Output(),
              help="The columns of REFERENCE.csv and the drive: command_V, rate_um_per_s, flags and, if the model or "
                   "--dac-bits gives DAC codes, dac_code.")
@click.option("--engine", default="f32", show_default=True,
              type=click.Choice(["f32", "q31", "f64", "numpy", "qemu-m0", "qemu-m3", "qemu-m4f", "qemu-m7"]),
              help="f32: the firmware library in single precision. q31: in fixed point. f64: in double precision. "
                   "numpy: an independent implementation. qemu-...: the firmware on an emulated Cortex-M0, M3, M4F or "
                   "M7.")
@click.option("--fixed-point", is_flag=True, help="Emulate the fixed-point firmware. Only valid with qemu-... "
                                                  "engines. Default: single precision.")
@click.option("--sweep", is_flag=True,
              help="Run the firmware's start-up sweep first, as a board does. DRIVE.csv does not contain the sweep; it "
                   "starts from the state that the sweep leaves. Default: start from the memory of the model or of "
                   "REFERENCE.csv. Not valid with --engine numpy.")
@click.option("--dac-bits", type=int, metavar="BITS", help="Bits of the DAC. Default: the model's.")
@click.option("--reference-column", default="reference_um", show_default=True, metavar="COLUMN",
              help="Column to follow. With displacement_um of a recording, the command shows how well the drive "
                   "matches the recorded one.")
@click.option("--remove-offset", is_flag=True,
              help="Remove the mean difference between recording and model from the reference first (thermal drift).")
@click.option("--report", metavar="DIR", type=Report("compensate.json", "compensate.html"),
              help="Write compensate.html (one page with pictures) and compensate.json to this directory. REFERENCE.csv "
                   "needs a column displacement_um.")
@NOISE_SHAPING
@effect_options
def compensate(model: str, reference: str, output: str, engine: str, fixed_point: bool, sweep: bool,
               dac_bits: int | None, reference_column: str, remove_offset: bool, noise_shaping: bool,
               report: str | None, **of_effects: Any) -> dict[str, Any]:
    """Compute the drive for a reference, as the firmware does.

    REFERENCE.csv needs the columns time_s and reference_um (or --reference-column). A board runs its start-up sweep
    before it follows a reference: only with --sweep are the codes the same as on the board.

    The model's effects are compensated as `rdpi header` compensates them, and one line per effect says how. Where that
    takes the reference ahead of time, REFERENCE.csv itself is the future; its last value holds at the end.

    The column flags is the sum of:

    \b
     1  the guard clamped the rate
     2  the drive was clipped to its range
     4  the drive was clipped by its slew limit
     8  the reference was not usable; the drive was held
    16  first sample after one or more that were not usable
    32  a lead was limited: what it adds to the reference, or, for a lag, to the drive

    If REFERENCE.csv has a column command_V, DRIVE.csv keeps it as recorded_V, and the command compares the computed
    drive with it.

    The engines qemu-... build examples/track for this model and reference and run it in qemu-system-arm. They need
    arm-none-eabi-gcc and the project's checkout. If the tools are installed outside the checkout, set RDPI_HOME to its
    directory.
    """
    from .. import board
    from ..data import Limits, Recording, excite, read_recording, write_recording
    from ..firmware import beyond_sample_times
    from ..model import read_model
    from ..simulate import chain, scoring

    _check_in_um(reference_column)
    parameters = read_model(model)
    _given(parameters, {"--dac-bits": ("dac_bits", dac_bits)})
    if noise_shaping:
        _shaped(parameters)
    inverse = _inverse(parameters, **of_effects)
    recorded = () if report is None else ("displacement_um",)
    run = read_recording(reference, required=("time_s", reference_column, *recorded))
    with progress("compensating") as advance:
        found = board.compensate(parameters, run, reference_column, engine, fixed_point=fixed_point, sweep=sweep,
                                 remove_offset=remove_offset, by=inverse, report=advance)
    result: dict[str, Any] = {"file": output, "engine": engine, "sweep": sweep, "samples": len(run),
                              "effects": _effects_of(inverse),
                              **{f"{name}_count": count for name, count in found.flag_counts.items()}}
    if found.flag_counts["range"]:
        low_um, high_um = chain.reachable_um(inverse.model)
        click.echo(f"note: the drive was clipped; the reachable range is {low_um:.5g} to {high_um:.5g} um, "
                   f"the reference spans {found.asked_um[0]:.5g} to {found.asked_um[1]:.5g} um")
    if engine in ("f32", "q31") and (why := beyond_sample_times(inverse.model, run.sample_time_s)):
        click.echo(f"note: a board would refuse this rate: {why}; for a board take another rate, or another --sweep-rate "
                   "of `rdpi header`")
    single = not fixed_point and engine not in ("q31", "f64", "numpy")
    for note in scoring.doubts(parameters, inverse, run, reference_column, sweep, single):
        click.echo(f"note: {note}")
    drive_V = found.steps.drive_V
    if sweep or recorded == () and scoring.estimated_start(parameters) is None:
        drive, begins_there = inverse.model.drive, run.memory == "reset" and not sweep
        end_V = float(drive_V[0]) if begins_there else inverse.model.sweep_end()
        limits = Limits(drive.min_V, drive.max_V, None, run.sample_rate_hz, drive.slew_V_per_s)
        click.echo("the drive follows on the start-up sweep; where no firmware plays it, first play what this makes: "
                   + excite.command_line("startup", limits, "startup.csv", end_V=end_V))
        if not begins_there and (aside := scoring.begins_aside(inverse, drive_V)):
            click.echo(f"note: {aside}")
    if preview := inverse.chain.preview_samples(run.sample_time_s):
        click.echo(f"preview: the firmware needs the reference {preview} samples ahead at {run.sample_rate_hz:g} per second: "
                   "the delay's, and one for each of lead and lag that takes a difference")
    flagged = ", ".join(f"{found.flag_counts[name]} {name}" for name in ("guard", "range", "slew", "input")
                        + (("lead",) if inverse.chain.leads else ()))
    write_recording(output, found.columns, found.metadata)
    click.echo(f"{output}: {len(run)} samples, {drive_V.min():.6g} to {drive_V.max():.6g} V, flagged: {flagged}")
    if score := found.score:
        click.echo(f"against the recorded command: rms {score.rms_percent:.3f} %, max {score.max_percent:.3f} % of its "
                   f"peak-to-peak" + (f" (offset of {found.offset_um:.4g} um removed)" if remove_offset else ""))
        result["recorded"] = {"rms_V": score.rms_um, "max_V": score.max_um, "rms_percent": score.rms_percent,
                              "max_percent": score.max_percent, "removed_um": found.offset_um}
    if found.why_unknown:
        click.echo(f"memory: unknown ({found.why_unknown})")
    if report is not None:
        from ..identify import report as reports

        reports.write_compensation(report, Recording(output, found.metadata, found.columns), inverse.lines,
                                   score.rms_percent if score else None, result)
    return result
