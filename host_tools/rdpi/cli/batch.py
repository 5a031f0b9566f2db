"""Command that works a plan off: batch."""

from __future__ import annotations

import os
import shlex
from collections.abc import Collection
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from ..errors import BadInput, printable
from . import diagnosis, models
from .program import by_options, command, other_outputs
from .progress import progress
from .types import Choices, Output, Percent, Report, all_of

if TYPE_CHECKING:
    from ..gap.batch import Row

LISTED = 5  # actuators that a line names
OPTIONS = (*(one for one in models.fit.params if isinstance(one, click.Option) and one.name not in
             ("output", "hold_out", "max_rms_percent", "report", "keep", "json_path")),
           *(one for one in diagnosis.gap.params if one.name == "without"))  # that a row of the plan may give


@command("batch")
@click.argument("plan", metavar="PLAN.csv", type=click.Path(dir_okay=False))
@click.option("-o", "--output", required=True, metavar="RESULTS.sqlite", type=Output(),
              help="Results, a row per actuator. Those that are there already stay.")
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", help="Number of processes. Default: one per core.")
@click.option("--scheduler", metavar="ADDRESS", help="Work on a Dask cluster, e.g. tcp://host:8786. Its workers need "
                                                     "the same rdpi, and the files under the same paths.")
@click.option("--all", "everything", is_flag=True, help="Do every row again. Default: those that are new, that failed, "
                                                        "or whose files or options have changed.")
@click.option("--max-rms", "max_rms_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if the rms error of any actuator's held-out recordings exceeds this, % of stroke. "
                   "Without hold_out, the limit applies to all its recordings.")
@click.option("--fail-on", multiple=True, callback=all_of, type=Choices("effect", "ambiguous", "unknown"),
              metavar="VERDICT,...",
              help="Exit with status 1 if the verdict of any actuator is one of these: effect, ambiguous, unknown.")
@click.option("--max-gap", "max_gap_percent", type=Percent(), metavar="PERCENT",
              help="Exit with status 1 if the rms gap of any actuator exceeds this, % of stroke.")
@click.option("--report", metavar="DIR", type=Report("index.html"),
              help="Write index.html, a page over all actuators, to this directory, and the pages of each to a "
                   "directory of its name.")
def batch(plan: str, output: str, jobs: int | None, scheduler: str | None, everything: bool, max_rms_percent: float | None,
          fail_on: tuple[str, ...], max_gap_percent: float | None, report: str | None) -> dict[str, Any]:
    """Fit and diagnose many actuators.

    PLAN.csv has a row per actuator and the columns actuator, fit, hold_out, gap, earlier (recordings, or patterns such
    as runs/A7-*.csv, relative to PLAN.csv, with ; between several), model (written by a fit, else read; default
    models/ACTUATOR.json) and options (of rdpi fit, and --without). Only actuator and one of fit and gap are needed.
    Lines that begin with # are comments.

    An actuator that fails stops no other; the exit status is then 2. A batch that was stopped goes on when it is
    started again. The limits hold for all actuators of the plan, also for those whose results are there already.
    """
    from ..gap import batch as work

    if jobs is not None and scheduler is not None:
        raise BadInput("--jobs: is for this machine; leave it out with --scheduler")
    pages = [] if report is None else [os.path.join(report, work.PAGE)]
    tasks = work.read_plan(plan, _options, [output, *other_outputs(), *pages], report)
    for option, limit, needed in (("--max-rms", max_rms_percent, "fit"), ("--fail-on", fail_on, "gap"),
                                  ("--max-gap", max_gap_percent, "gap")):
        if limit and not any(task.runs[needed] or task.refused for task in tasks):
            raise BadInput(f"{option}: no row of {plan} has recordings in {needed}; give some, or leave {option} out")
    with progress("working") as report_progress:
        def ended(row: Row, done: int, of: int) -> None:
            click.echo(f"{done}/{of} {row.actuator}: {_line(row)}")
            report_progress(done / of)

        rows = work.run(tasks, output, jobs, scheduler, everything, report, ended, _by_options)
    if report is not None:
        with work.Results.open(output) as results:
            work.write_page(report, list(results.rows().values()), output)
    failed = [row for row in rows if row.status != "done"]
    click.echo(f"{output}: {len(rows) - len(failed)} of {len(rows)} actuators done")
    if failed:
        click.echo(f"rdpi: {len(failed)} failed: {_named([row.actuator for row in failed])}; the column error of {output} "
                   "says why", err=True)
    beyond = [f"{row.actuator} ({', '.join(missed)})" for row in rows
              if (missed := _beyond(row, max_rms_percent, fail_on, max_gap_percent))]
    if beyond:
        click.echo(f"rdpi: {len(beyond)} beyond --max-rms, --fail-on or --max-gap: {_named(beyond)}", err=True)
    return {"results": output, "rows": [asdict(row) for row in rows], "failed": len(failed), "gate_failed": bool(beyond)}


def _named(names: list[str]) -> str:
    return ", ".join(names[:LISTED]) + (", ..." if len(names) > LISTED else "")


def _beyond(row: Row, max_rms_percent: float | None, fail_on: tuple[str, ...], max_gap_percent: float | None) -> list[str]:
    """What of an actuator's results is beyond a limit."""
    rms_percent = row.fit_rms_percent if row.held_out_rms_percent is None else row.held_out_rms_percent
    found = [f"verdict {row.verdict}"] if row.verdict in fail_on else []
    for name, value, limit in (("rms", rms_percent, max_rms_percent), ("gap", row.gap_percent, max_gap_percent)):
        if value is not None and limit is not None and value > limit:
            found.append(f"{name} {value:.3g} %")
    return found


def _options(text: str, roles: Collection[str]) -> dict[str, Any]:
    """Keywords of a row's options: those given, no defaults. `roles`: what the row does, "fit" and "gap".

    Raises BadInput, also for an option that nothing of this row takes.
    """
    from ..identify import Options, checked_options

    parser = click.Command("options", params=[*OPTIONS], add_help_option=False)
    try:
        context = parser.make_context("options", shlex.split(text))
    except (click.UsageError, ValueError) as error:
        message = error.format_message() if isinstance(error, click.UsageError) else str(error)
        raise BadInput(f"{message.rstrip('.')}; give options of rdpi fit, or --without EFFECT") from None
    found = {name: value for name, value in context.params.items()
             if context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT}
    try:
        for name in found:
            if (needed := "gap" if name == "without" else "fit") not in roles:
                raise BadInput(f"`{name}`: is only valid with recordings in {needed}; leave it out")
        checked_options(Options(**{name: value for name, value in found.items() if name != "without"}))
    except BadInput as error:
        raise BadInput(_by_options(str(error))) from None
    return found


def _by_options(message: str) -> str:
    """With the names that a row's options have in the plan."""
    return by_options(message, OPTIONS)


def _line(row: Row) -> str:
    """An actuator's results for people."""
    if row.status != "done":
        return printable(row.error or "failed")
    errors = {"fit": row.fit_rms_percent, "held out": row.held_out_rms_percent, "gap": row.gap_percent}
    parts = [f"{name} {value:.3g} %" for name, value in errors.items() if value is not None]
    return ", ".join([*parts, *filter(None, [row.verdict and f"verdict {row.verdict}", row.effect])])
