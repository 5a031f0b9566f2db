"""Commands that judge recordings: simulate, gap, score."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from .. import version
from ..errors import BadInput
from .program import command
from .progress import progress
from .types import Choices, ModelFile, Output, Percent, Report, all_of

if TYPE_CHECKING:
    from ..gap import GapDocument


@command("simulate")
@click.argument("model", metavar="MODEL.json", type=ModelFile())
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", metavar="OUT.csv", type=Output(),
              help="The columns of RUN and predicted_um. Only valid with one RUN.")
@click.option("--remove-offset", is_flag=True, help="Remove the mean error before scoring (thermal drift since the "
                                                    "fit).")
@click.option("--memory", type=click.Choice(["auto", "model", "reset", "low", "high"]), default="auto", show_default=True,
              help="What the actuator remembers at the start of each run. auto: from the run's metadata; if unknown, it is "
                   "estimated. low, high: it rested at that end of the drive.")
@click.option("--max-rms", "max_rms_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if the rms error of any run exceeds this, % of stroke.")
def simulate(model: str, runs: tuple[str, ...], output: str | None, remove_offset: bool, memory: str,
             max_rms_percent: float | None) -> dict[str, Any]:
    """Predict the displacement and compare it with the measured one.

    Errors in percent refer to the measured stroke of each run.
    """
    from ..data import read_recording, write_recording
    from ..model import read_model
    from ..simulate import chain, scoring

    if output is not None and len(runs) > 1:
        raise BadInput("-o: is only valid with one RUN; simulate the runs one by one (memory: carried is then lost)")
    with progress("simulating"):
        parameters = read_model(model)
        recordings = [read_recording(path, required=("time_s", "command_V")) for path in runs]
        predictions = chain.simulate(parameters, recordings, memory)
    scored = [(run, prediction, chain.score(prediction.predicted_um, run.displacement_um, remove_offset, run.path))
              for run, prediction in zip(recordings, predictions) if run.displacement_um is not None]
    if max_rms_percent is not None and len(scored) < len(recordings):
        raise BadInput("--max-rms: every RUN needs the column displacement_um")
    if output is not None:
        columns = {**recordings[0].columns, "predicted_um": predictions[0].predicted_um}
        write_recording(output, columns, recordings[0].metadata)
    for run, prediction in zip(recordings, predictions):
        if run.displacement_um is None:
            click.echo(f"{run.path}: predicted; there is no displacement_um to compare with" + (
                "" if output else ", and no -o to write the prediction to"))
        for note in scoring.notes(parameters, run, prediction):
            click.echo(f"note: {note}")
    if not scored:
        return {"runs": [], "rms_percent": None, "max_percent": None, "gate_failed": False}
    scores = [score for _, _, score in scored]
    click.echo("\n".join(scoring.table([(run.path, score, f"memory: {prediction.memory}")
                                        for run, prediction, score in scored])))
    if remove_offset:
        click.echo("offsets removed: " + ", ".join(f"{score.offset_um:.4g} um" for score in scores))
    failed = max_rms_percent is not None and max(score.rms_percent for score in scores) > max_rms_percent
    if failed:
        click.echo(f"rdpi: the rms error exceeds the {max_rms_percent:g} % that --max-rms allows", err=True)
    return {"runs": [{"file": run.path, **score._asdict(), "memory": prediction.memory}
                     for run, prediction, score in scored],
            "rms_percent": scoring.overall_rms_percent(scores, [len(run) for run, _, _ in scored]),
            "max_percent": max(score.max_percent for score in scores), "gate_failed": failed}


@command("gap")
@click.argument("model", metavar="MODEL.json", type=ModelFile())
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("-o", "--output", metavar="IMPROVED.json", type=Output(json=True),
              help="The model, with the effects that were found.")
@click.option("--report", metavar="DIR", type=Report("gap.json", "index.html"),
              help="Write index.html (one page with pictures) and gap.json to this directory.")
@click.option("--earlier", multiple=True, metavar="RUN", type=click.Path(dir_okay=False),
              help="Earlier recording of the same drive as one of the RUNs, e.g. from commissioning. Give one for "
                   "each RUN, each after an --earlier of its own. The diagnosis then covers only what has changed "
                   "since, without the model's own error.")
@click.option("--no-kept", is_flag=True,
              help="Do not use the recordings that `rdpi fit --keep` kept with the model. Without --earlier, they are "
                   "used if each RUN has the same drive as one of them.")
@click.option("--reference", "references", multiple=True, metavar="REFERENCE.csv", type=click.Path(dir_okay=False),
              help="What is to be tracked, a column reference_um. The command then promises by how much compensation "
                   "shrinks the tracking error, and leaves out effects that would increase it, that predict a "
                   "recording worse or hardly any better, or of which recordings that were left out do not show that "
                   "they help. May be given several times.")
@click.option("--without", multiple=True, metavar="EFFECT",
              help="Do not try this effect. May be given several times.")
@click.option("--fail-on", multiple=True, callback=all_of, type=Choices("effect", "ambiguous", "unknown"),
              metavar="VERDICT,...",
              help="Exit with status 1 if the verdict is one of these: effect, ambiguous, unknown.")
@click.option("--max-gap", "max_gap_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if the rms gap exceeds this, % of stroke.")
def gap(model: str, runs: tuple[str, ...], output: str | None, report: str | None, earlier: tuple[str, ...],
        no_kept: bool, references: tuple[str, ...], without: tuple[str, ...], fail_on: tuple[str, ...],
        max_gap_percent: float | None) -> dict[str, Any]:
    """Say why a model misses recordings.

    The diagnosis tells where the gap is, which effect causes it, and how far that effect closes it.

    RUNs are recordings that the model was not fitted to. Give several with different waveforms, if possible. With a
    column monitor_V (the measured amplifier output), the diagnosis separates causes before and after the amplifier's
    output. With --earlier it finds smaller changes. An effect that the model holds already is asked whether it has
    changed.
    """
    from ..data import make_folder, read_recording
    from ..gap import diagnose, report as gap_report
    from ..identify import kept
    from ..model import read_model, write_model
    from ..simulate import effects

    for name in without:
        if name not in effects.CATALOGUE:
            raise BadInput(f"--without {name}: is not an effect; the effects are {', '.join(effects.CATALOGUE)}")
    with progress("diagnosing") as report_progress:
        parameters = read_model(model)
        recordings, before, told = [read_recording(path) for path in runs], [read_recording(path) for path in earlier], []
        if not before and not no_kept:
            before, told = kept.earlier(parameters, recordings)
        found = diagnose(parameters, recordings, without, report_progress, before,
                         [read_recording(path, required=("time_s", "reference_um")) for path in references])
    missed = _missed_gates(found.document, fail_on, max_gap_percent)
    document = replace(found.document, model=model, model_digest=parameters.digest(), gate_failed=bool(missed),
                       notes=[*told, *found.document.notes])
    if report is not None:
        make_folder(report)  # the model may go there too
    if output is not None:
        write_model(output, found.improved)
    if report is not None:
        gap_report.write(document, gap_report.Pictures(found.runs, found.before_um, found.after_um, found.table,
                                                       found.spectrum_after), report)
    click.echo(gap_report.tables(document))
    if output is not None:
        added = [one.name if one.was is None else f"{one.name} changed" for one in document.effects]
        undecided = ", one of those that explain the gap" if document.verdict == "ambiguous" else ""
        changed = found.improved.effects != parameters.effects
        click.echo(f"{output}: the model " + (f"with {', '.join(added)}{undecided}" if changed else "unchanged"))
    for line in missed:
        click.echo(f"rdpi: {line}", err=True)
    return document.to_json()


def _missed_gates(document: GapDocument, fail_on: tuple[str, ...], max_gap_percent: float | None) -> list[str]:
    """A line for each limit that is exceeded."""
    lines, percent = [], document.gap.percent_of_stroke
    if document.verdict in fail_on:
        lines.append(f"the verdict is {document.verdict}, which --fail-on names")
    if max_gap_percent is not None and percent > max_gap_percent:
        lines.append(f"the gap is {percent:.3g} % of the stroke; --max-gap allows {max_gap_percent:g} %")
    return lines


@command("score")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(dir_okay=False))
@click.option("--remove-offset", is_flag=True, help="Remove the mean error before scoring.")
@click.option("--skip", "skip_s", type=float, default=0.0, metavar="S",
              help="Leave out the first S seconds of each run: a start that is none of the tracking. Default: 0.")
@click.option("--max-rms", "max_rms_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if the rms error of any run exceeds this, % of the reference's peak-to-peak.")
@click.option("--report", metavar="DIR", type=Report("score.json", "score.html"),
              help="Write score.html (one page with pictures) and score.json to this directory.")
def score(runs: tuple[str, ...], remove_offset: bool, skip_s: float, max_rms_percent: float | None,
          report: str | None) -> dict[str, Any]:
    """Say how well references were tracked.

    RUNs are recordings with the columns time_s, reference_um and displacement_um. `rdpi record` writes them. Of a drive
    that `rdpi compensate` has computed and another bench has played, add what the sensor read as displacement_um to the
    columns of the drive. Errors in percent refer to the peak-to-peak of each run's reference. The delay is that with
    which the displacement follows the reference best.
    """
    from ..data import read_recording
    from ..identify import report as reports
    from ..simulate import scoring, tracking

    recordings = [tracking.without_start(read_recording(path, required=tracking.COLUMNS), skip_s) for path in runs]
    scores = [tracking.track(run, remove_offset) for run in recordings]
    worst = max(one.rms_percent for one in scores)
    failed = max_rms_percent is not None and worst > max_rms_percent
    result = {"tool": version(), "runs": [{"file": run.path, **one._asdict()} for run, one in zip(recordings, scores)],
              "rms_percent": scoring.overall_rms_percent(scores, [len(run) for run in recordings]),
              "max_percent": max(one.max_percent for one in scores), "gate_failed": failed}
    if report is not None:
        reports.write_score(report, recordings, scores, result, remove_offset)
    click.echo("\n".join(scoring.table(
        [(run.path, one, f"largest at {one.max_at_s:.4g} s; {1e3 * abs(one.delay_s):.3g} ms {'late' if one.delay_s >= 0 else 'early'}, "
          f"offset {one.offset_um:.3g} um{' (removed)' if remove_offset else ''}; without both "
          f"{one.rms_percent_without_delay:.3f} % rms") for run, one in zip(recordings, scores)],
        "the reference's peak-to-peak")))
    if failed:
        click.echo(f"rdpi: the rms error is {worst:.3g} %; --max-rms allows {max_rms_percent:g} %", err=True)
    return result
