"""Commands that make and show models: fit, plot."""

from __future__ import annotations

from typing import Any

import click

from .program import command
from .progress import progress
from .types import Folder, ModelFile, Numbers, Output, Percent, Report


@command("fit")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="MODEL.json", type=Output(json=True), help="The model.")
@click.option("--operators", type=int, default=9, show_default=True, metavar="N",
              help="Number of plays with a positive threshold.")
@click.option("--deadzones", type=int, default=2, show_default=True, metavar="M",
              help="Number of dead zones of the saturation stage.")
@click.option("--thresholds", "thresholds_um", type=Numbers(), metavar="UM,UM,...",
              help="Thresholds r_1, r_2, ..., um. Default: equal intervals.")
@click.option("--rate-independent", is_flag=True, help="Fit a model whose slopes do not depend on rate.")
@click.option("--effects", default="auto", show_default=True, metavar="auto|none|NAME,...",
              help="Effects to identify around the operator. auto: those that recordings show. NAME,...: "
                   "exactly these. Beside effects, the rate law stays only if it helps.")
@click.option("--rate-source", type=click.Choice(["displacement", "control"]), default="displacement",
              show_default=True, help="Signal whose rate modulates the slopes.")
@click.option("--rate-window", "rate_window_s", type=float, default=0.0, show_default=True, metavar="S",
              help="Time over which the firmware takes the difference for its rate, s. 0: one sample.")
@click.option("--rate-filter", "rate_filter_s", type=float, metavar="S",
              help="Time constant of the firmware's low-pass filter on the rate, s. 0: no filter. Default: none, unless "
                   "the recordings show that a filter helps.")
@click.option("--min-slope-ratio", type=float, default=0.2, show_default=True, metavar="RATIO",
              help="The guard limits the rate so that no slope falls below this share of its value at rest.")
@click.option("--min-V", "min_V", type=float, metavar="V",
              help="Lowest drive that the firmware may output, V. Default: lowest recorded.")
@click.option("--max-V", "max_V", type=float, metavar="V", help="Highest drive that the firmware may output, V. "
                                                                "Default: highest recorded.")
@click.option("--slew", "slew_V_per_s", type=float, metavar="V/S",
              help="Largest rate of change of the drive, V/s. Default: no limit.")
@click.option("--dac-bits", type=int, metavar="BITS",
              help="Bits of the DAC. Its codes span --min-V to --max-V. Default: the firmware outputs no codes.")
@click.option("--actuator", metavar="TEXT", help="Name of the actuator, stored in the model. Default: that of the "
                                                 "first recording.")
@click.option("--hold-out", multiple=True, metavar="RUN", type=click.Path(dir_okay=False),
              help="Recording that the model is tested on and not fitted to. May be given several times.")
@click.option("--max-rms", "max_rms_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if the rms error of any held-out run exceeds this, % of stroke. Without "
                   "--hold-out, the limit applies to all runs.")
@click.option("-v", "--verbose", is_flag=True, help="Print the models that were compared as well.")
@click.option("--report", metavar="DIR", type=Report("fit.json", "fit.png", "fit.html"),
              help="Write fit.html (one page with pictures), fit.png and fit.json to this directory.")
@click.option("--keep", metavar="DIR", type=Folder(),
              help="Keep copies of the recordings in this directory, thinned out as far as nothing but noise is lost. "
                   "`rdpi gap MODEL.json` then compares new recordings of the same drives with them, as with --earlier. "
                   "Move the directory together with MODEL.json.")
def fit(runs: tuple[str, ...], output: str, hold_out: tuple[str, ...], max_rms_percent: float | None,
        report: str | None, keep: str | None, verbose: bool, **options: Any) -> dict[str, Any]:
    """Identify a model from recordings.

    The fit finds the operator and what stands around it, such as a delay, creep or a resonance. An effect is kept if it
    lowers the error on recordings that were left out. The best models come from recordings at several rates and
    amplitudes whose memory is known (metadata memory: reset). `rdpi excite commission` makes the drive for them.
    """
    from ..data import make_folder, read_recording
    from ..identify import Options, fit as identify, kept, summary
    from ..model import write_model

    with progress("fitting") as report_progress:
        fitted = [read_recording(path) for path in runs]
        held = [read_recording(path) for path in hold_out]
        result = identify(fitted, Options(**options), held, report_progress)
    if report is not None:
        make_folder(report)  # the model may go there too
    if keep is not None:  # before the model, which names what is kept
        with progress("keeping"):
            kept.keep([*fitted, *held], keep, result.model)
    write_model(output, result.model)
    worst = summary.worst_rms_percent(result)
    failed = max_rms_percent is not None and worst > max_rms_percent
    document = result.document(output, failed)
    if report is not None:
        summary.write_report(report, result, [*fitted, *held], document)
    click.echo(f"{output}: " + "\n".join(summary.lines(result, verbose)))
    for line in kept.lines(result.model):
        click.echo(line)
    if failed:
        click.echo(f"rdpi: the rms error is {worst:.3g} %; --max-rms allows {max_rms_percent:g} %", err=True)
    return document.to_json()


@command("plot")
@click.argument("model", metavar="MODEL.json", type=ModelFile())
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", default="rdpi.png", show_default=True, metavar="PICTURE",
              type=Output(), help="The picture: .png, .svg or .pdf.")
def plot(model: str, runs: tuple[str, ...], output: str) -> dict[str, Any]:
    """Plot loops, slopes against rate, prediction and residual.

    The prediction is shown where it is worst.
    """
    from ..data import read_recording
    from ..identify import rate_slopes, report
    from ..model import read_model
    from ..simulate import chain

    report.check_picture_name(output)
    with progress("drawing"):
        parameters = read_model(model)
        recordings = [read_recording(path) for path in runs]
        predictions = chain.simulate(parameters, recordings)
        figure = report.picture(parameters, recordings, predictions, rate_slopes(parameters, recordings))
        report.write_picture(figure, output)
    click.echo(output)
    return {"file": output}
