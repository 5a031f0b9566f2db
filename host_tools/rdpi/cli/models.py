"""Commands that make and show models: fit, plot."""

from __future__ import annotations

from typing import Any

import click

from .program import command
from .progress import progress
from .types import Numbers, Output, Percent, Report


@command("fit")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="MODEL.json", type=Output(), help="The model.")
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
@click.option("--report", metavar="DIR", type=Report("fit.json"),
              help="Write fit.png (loops, slopes, residual) and fit.json there.")
def fit(runs: tuple[str, ...], output: str, hold_out: tuple[str, ...], max_rms_percent: float | None,
        report: str | None, **options: Any) -> dict[str, Any]:
    """Identify a model from recordings.

    One bounded least-squares problem over all samples of all runs. Recordings at several rates and amplitudes, with
    memory known (metadata memory: reset) where possible, give the best model; see `rdpi excite`.
    """
    from ..data import read_recording
    from ..fit import Options, fit as identify, summary
    from ..model import write_model

    with progress("fitting") as report_progress:
        fitted = [read_recording(path) for path in runs]
        held = [read_recording(path) for path in hold_out]
        result = identify(fitted, Options(**options), held, report_progress)
    write_model(output, result.model)
    worst = summary.worst_rms_percent(result)
    failed = max_rms_percent is not None and worst > max_rms_percent
    document = result.document(output, failed)
    if report is not None:
        summary.write_report(report, result, [*fitted, *held], document)
    click.echo(f"{output}: " + "\n".join(summary.lines(result)))
    if failed:
        click.echo(f"rdpi: {worst:.3g} % rms, above the {max_rms_percent:g} % allowed by --max-rms", err=True)
    return document.to_json()


@command("plot")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", default="rdpi.png", show_default=True, metavar="PICTURE",
              type=Output(), help="The picture, .png, .svg or .pdf.")
def plot(model: str, runs: tuple[str, ...], output: str) -> dict[str, Any]:
    """Draw loops, slopes against rate, the prediction where it is worst, and the residual."""
    from ..data import read_recording
    from ..fit import identify, report
    from ..model import read_model
    from ..simulate import chain

    report.check_picture_name(output)
    with progress("drawing"):
        parameters = read_model(model)
        recordings = [read_recording(path) for path in runs]
        predictions = chain.simulate(parameters, recordings)
        figure = report.picture(parameters, recordings, predictions, identify.rate_slopes(parameters, recordings))
        report.write_picture(figure, output)
    click.echo(output)
    return {"file": output}
