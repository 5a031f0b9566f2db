"""Commands that make and show models: fit, plot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ..errors import BadInput
from .program import command
from .progress import progress
from .types import Numbers, Percent


@command("fit")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="MODEL.json", type=click.Path(dir_okay=False), help="The model.")
@click.option("--operators", type=int, default=9, show_default=True, metavar="N",
              help="Plays with a positive threshold.")
@click.option("--deadzones", type=int, default=2, show_default=True, metavar="M",
              help="Dead zones of the saturation stage.")
@click.option("--thresholds", "thresholds_um", type=Numbers(), metavar="UM,UM,...",
              help="Thresholds r_1, r_2, ... in um instead of equal intervals.")
@click.option("--rate-independent", is_flag=True, help="Fit no rate law: slopes do not depend on rate.")
@click.option("--rate-source", type=click.Choice(["displacement", "control"]), default="displacement",
              show_default=True, help="Whose rate modulates the slopes.")
@click.option("--rate-window", "rate_window_s", type=float, default=0.0, show_default=True, metavar="S",
              help="The firmware's rate is a difference over this time, s; 0: one sample.")
@click.option("--rate-filter", "rate_filter_s", type=float, default=0.0, show_default=True, metavar="S",
              help="Time constant of the firmware's low-pass on the rate, s; 0: none.")
@click.option("--min-slope-ratio", type=float, default=0.2, show_default=True, metavar="RATIO",
              help="The guard clamps the rate where a slope has fallen to this share of its value at rest.")
@click.option("--min-V", "min_V", type=float, metavar="V",
              help="Lowest drive the firmware may output. Default: lowest recorded.")
@click.option("--max-V", "max_V", type=float, metavar="V", help="Highest drive. Default: highest recorded.")
@click.option("--slew", "slew_V_per_s", type=float, metavar="V/S",
              help="Fastest change of the drive. Default: no limit.")
@click.option("--dac-bits", type=int, metavar="BITS",
              help="Codes of the DAC span --min-V to --max-V. Default: no codes.")
@click.option("--actuator", metavar="TEXT", help="Name kept in the model. Default: the first recording's.")
@click.option("--hold-out", multiple=True, metavar="RUN", type=click.Path(dir_okay=False),
              help="A recording to score the model on, not fitted; may be given several times.")
@click.option("--max-rms", "max_rms_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if any held-out run (without any: any run) is predicted worse than this, "
                   "% of stroke.")
@click.option("--report", metavar="DIR", type=click.Path(file_okay=False),
              help="Write fit.png (loops, slopes, residual) and fit.json there.")
def fit(runs: tuple[str, ...], output: str, hold_out: tuple[str, ...], max_rms_percent: float | None,
        report: str | None, **options: Any) -> dict[str, Any]:
    """Identify a model from recordings.

    One bounded least-squares problem over all samples of all runs. Recordings at several rates and amplitudes, with
    memory known (metadata memory: reset) where possible, give the best model; see `rdpi excite`.
    """
    from ..data import read_recording
    from ..fit import Options, fit as identify
    from ..model import write_model

    with progress("fitting") as report_progress:
        fitted = [read_recording(path) for path in runs]
        held = [read_recording(path) for path in hold_out]
        result = identify(fitted, Options(**options), held, report_progress)
    write_model(output, result.model)
    judged = [run.score.rms_percent for run in result.scores if run.held_out or not held]
    failed = max_rms_percent is not None and max(judged) > max_rms_percent
    summary = {**result.model.fit, "model": output, "gate_failed": failed, "rate_slopes": result.rate_slopes.to_json()}
    if report is not None:
        _write_fit_report(result, [*fitted, *held], Path(report), summary)
    _print_fit(result, output)
    if failed:
        click.echo(f"rdpi: {max(judged):.3g} % rms, above the {max_rms_percent:g} % allowed by --max-rms", err=True)
    return summary


def _print_fit(result: Any, output: str) -> None:
    import numpy as np

    from ..simulate import chain

    model = result.model
    click.echo(f"{output}: {len(model.slopes) - 1} plays, {len(model.deadzones_um) - 1} dead zones, "
               f"stroke {model.stroke_um:.5g} um, noise {result.noise_um:.2g} um rms")
    print_scores([(run.recording.path, run.score, "held out" if run.held_out else "fitted") for run in result.scores])
    bands = result.rate_slopes
    top = model.rate.identified_um_per_s
    click.echo("slopes W_i against rate: each band of rate fitted alone, then the model's law")
    click.echo(f"  {'':>20}" + "".join(f"{f'W_{i}':>7}" for i in range(len(model.slopes))))
    rows = [(f"{rate:.4g} um/s", slopes) for rate, slopes in zip(bands.rate_um_per_s, bands.slopes)]
    for label, slopes in (*rows, ("model, at rest", model.slopes), (f"model, {top:.4g} um/s", model.slopes_at(top))):
        click.echo(f"  {label:>20}" + "".join(f"{'-' if np.isnan(slope) else f'{slope:.3f}':>7}" for slope in slopes))
    dependent, independent = (100 * residual for residual in result.residual)
    if dependent != independent:
        click.echo(f"residual of the regression: {dependent:.3g} % rms of the stroke, "
                   f"without the rate law {independent:.3g} %")
    low, high = chain.reachable_um(model)
    click.echo(f"reachable displacement: {low:.5g} to {high:.5g} um; "
               "references are displacements as the sensor reads them")
    singular = model.rate.singular_um_per_s
    click.echo(f"rates identified up to {top:.4g} um/s; guard at {model.rate.max_um_per_s:.4g} um/s"
               + (f"; a slope reaches zero at {singular:.4g} um/s" if singular else ""))
    for warning in result.warnings:
        click.echo(f"note: {warning}")


def print_scores(rows: list[tuple[str, Any, str]]) -> None:
    width = max(len(path) for path, _, _ in rows)
    click.echo(f"  {'':{width}}  {'rms um':>9} {'max um':>9} {'rms %':>7} {'max %':>7}   (% of the run's stroke)")
    for path, score, remark in rows:
        click.echo(f"  {path:{width}}  {score.rms_um:9.4g} {score.max_um:9.4g} "
                   f"{score.rms_percent:7.3f} {score.max_percent:7.3f}   {remark}")


def _write_fit_report(result: Any, runs: list[Any], folder: Path, summary: dict[str, Any]) -> None:
    from ..data import atomic_write, make_folder
    from ..fit import report
    from ..simulate import chain

    make_folder(folder)
    figure = report.picture(result.model, runs, chain.simulate(result.model, runs), result.rate_slopes)
    report.write_picture(figure, folder / "fit.png")
    atomic_write(folder / "fit.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")


@command("plot")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", default="rdpi.png", show_default=True, metavar="PICTURE",
              type=click.Path(dir_okay=False), help="The picture, .png, .svg or .pdf.")
def plot(model: str, runs: tuple[str, ...], output: str) -> dict[str, Any]:
    """Draw loops, slopes against rate, the prediction where it is worst, and the residual."""
    from ..data import read_recording
    from ..fit import identify, report
    from ..model import read_model
    from ..simulate import chain, effects

    if Path(output).suffix.lower() not in (".png", ".svg", ".pdf"):
        raise BadInput(f"{output}: write a picture as .png, .svg or .pdf")
    with progress("drawing"):
        parameters = read_model(model)
        effects.acting(parameters, model)  # refuses by the file's name
        recordings = [read_recording(path) for path in runs]
        predictions = chain.simulate(parameters, recordings)
        figure = report.picture(parameters, recordings, predictions, identify.rate_slopes(parameters, recordings))
        report.write_picture(figure, output)
    click.echo(output)
    return {"file": output}
