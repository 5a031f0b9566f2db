"""Commands that compare a model with recordings: simulate, gap."""

from __future__ import annotations

from typing import Any

import click

from ..errors import BadInput
from .models import print_scores
from .program import command
from .progress import progress
from .types import Percent


@command("simulate")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", metavar="OUT.csv", type=click.Path(dir_okay=False),
              help="The run's columns and predicted_um; one run only.")
@click.option("--remove-offset", is_flag=True, help="Score without the mean error (thermal drift since the fit).")
@click.option("--memory", type=click.Choice(["auto", "model", "reset"]), default="auto", show_default=True,
              help="State of the hysteresis at each run's start. auto: as its metadata says, estimated where unknown.")
@click.option("--max-rms", "max_rms_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if any run is predicted worse than this, % of stroke.")
def simulate(model: str, runs: tuple[str, ...], output: str | None, remove_offset: bool, memory: str,
             max_rms_percent: float | None) -> dict[str, Any]:
    """Predict the displacement from the command and score it; percentages are of each run's measured stroke."""
    from ..data import read_recording, write_recording
    from ..model import read_model
    from ..simulate import chain, effects

    if output is not None and len(runs) > 1:
        raise BadInput("-o takes one RUN; simulate them one by one (memory: carried is then lost)")
    with progress("simulating"):
        parameters = read_model(model)
        effects.acting(parameters, model)  # refuses by the file's name
        recordings = [read_recording(path, required=("time_s", "command_V")) for path in runs]
        predictions = chain.simulate(parameters, recordings, memory)
    scores = [(run.path, chain.score(prediction.predicted_um, run.displacement_um, remove_offset, run.path),
               f"memory: {prediction.memory}")
              for run, prediction in zip(recordings, predictions) if run.displacement_um is not None]
    if max_rms_percent is not None and len(scores) < len(recordings):
        raise BadInput("--max-rms: every RUN needs a displacement_um to be judged by")
    if output is not None:
        columns = {**recordings[0].columns, "predicted_um": predictions[0].predicted_um}
        write_recording(output, columns, recordings[0].metadata)
    for run, prediction in zip(recordings, predictions):
        if run.displacement_um is None:
            click.echo(f"{run.path}: predicted, no displacement_um to score")
        low_V, high_V = parameters.drive.min_V, parameters.drive.max_V
        beyond = max(low_V - run.command_V.min(), run.command_V.max() - high_V)
        if beyond > 0.01 * (high_V - low_V):
            click.echo(f"note: {run.path}: the command goes {beyond:.3g} V beyond the model's drive range, "
                       f"{low_V:g} to {high_V:g} V")
        guarded = float((prediction.rate_um_per_s > parameters.rate.max_um_per_s).mean())
        if guarded > 0.01:
            click.echo(f"note: {run.path}: in {100 * guarded:.2g} % of the samples the rate was beyond the guard, "
                       f"{parameters.rate.max_um_per_s:.4g} um/s, and clamped")
        if not prediction.settled:
            click.echo(f"note: {run.path}: the prediction's own rate did not settle; treat it with care, "
                       "or fit with a longer --rate-window")
    if not scores:
        return {"runs": [], "rms_percent": None, "max_percent": None, "gate_failed": False}
    print_scores(scores)
    if remove_offset:
        click.echo("offsets removed: " + ", ".join(f"{score.offset_um:.4g} um" for _, score, _ in scores))
    weights = [len(run) for run in recordings if run.displacement_um is not None]
    squares = sum(weight * score.rms_percent**2 for weight, (_, score, _) in zip(weights, scores))
    failed = max_rms_percent is not None and max(score.rms_percent for _, score, _ in scores) > max_rms_percent
    if failed:
        click.echo(f"rdpi: above the {max_rms_percent:g} % rms allowed by --max-rms", err=True)
    return {"runs": [{"file": path, **score._asdict(), "memory": remark.split()[-1]} for path, score, remark in scores],
            "rms_percent": (squares / sum(weights)) ** 0.5,
            "max_percent": max(score.max_percent for _, score, _ in scores), "gate_failed": failed}


@command("gap")
@click.argument("model", metavar="MODEL.json", type=click.Path(dir_okay=False))
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", metavar="IMPROVED.json", type=click.Path(dir_okay=False),
              help="The model with the effects that were found.")
@click.option("--report", metavar="DIR", type=click.Path(file_okay=False),
              help="Write index.html, one page with pictures, and gap.json there.")
@click.option("--earlier", multiple=True, metavar="RUN", type=click.Path(dir_okay=False),
              help="A recording of the same drive as one of the RUNs, made at commissioning, say; one for each, "
                   "--earlier before every one. Then what has changed since is diagnosed, and the model's own error "
                   "does not count.")
@click.option("--without", multiple=True, metavar="EFFECT",
              help="Leave this effect out of those that are tried; may be given several times.")
def gap(model: str, runs: tuple[str, ...], output: str | None, report: str | None, earlier: tuple[str, ...],
        without: tuple[str, ...]) -> dict[str, Any]:
    """Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks once that is added.

    RUNs are recordings that the model was not fitted to, several with different waveforms if possible; a column
    monitor_V (the amplifier's output) tells what lies before the actuator from what lies after. With --earlier, drives
    that were recorded before tell smaller changes.
    """
    from ..data import read_recording
    from ..fit import checks, passport
    from ..gap import diagnose, report as gap_report
    from ..model import read_model, write_model
    from ..simulate.effects import CATALOGUE, acting

    for name in without:
        if name not in CATALOGUE:
            raise BadInput(f"--without {name}: no effect; there are {', '.join(CATALOGUE)}")
    with progress("diagnosing") as report_progress:
        parameters = read_model(model)
        checks.fitted_digests(parameters, model)
        passport.read(parameters, model)
        acting(parameters, model)
        found = diagnose(parameters, [read_recording(path) for path in runs], without, report_progress,
                         [read_recording(path) for path in earlier])
    document = {**found.document, "model": model, "model_digest": parameters.digest()}
    if output is not None:
        write_model(output, found.improved)
    if report is not None:
        gap_report.write(document, gap_report.Pictures(found.runs, found.before_um, found.after_um, found.table,
                                                       found.spectrum_after), report)
    click.echo(gap_report.tables(document))
    if output is not None:
        added = [effect["name"] for effect in found.improved.effects[len(parameters.effects):]]
        undecided = ", one of those that explain the gap" if document["verdict"] == "ambiguous" else ""
        click.echo(f"{output}: the model " + (f"with {', '.join(added)}{undecided}" if added else "unchanged"))
    return document
