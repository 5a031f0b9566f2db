"""The page of `rdpi batch --report`: all actuators in one table, how large their errors are, and verdicts over time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from ... import version
from ...data import atomic_write, make_folder
from ...identify import summary
from ...identify.report import NONE, drawing, environment, number, percent, plain
from ..report import page as gap_page
from .results import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = "index.html"
FILES = {"gap": (gap_page.PAGE, gap_page.TWIN), "fit": (summary.PAGE, summary.PICTURE, summary.DOCUMENT)}
PAGES = {kind: names[0] for kind, names in FILES.items()}  # of an actuator, in the folder of its name
STATES = {"none": "#2f86c4", "effect": "#d0642a", "ambiguous": "#c9a227", "unknown": "#a32c3a", "failed": "#747a82",
          "fitted": "#7fb069"}  # in the order of the picture
BINS = 24
ERRORS = {"gap_percent": "gap", "held_out_rms_percent": "held out", "fit_rms_percent": "fitted"}
DAY_S = 86400

TEMPLATES = environment(__package__)


def write_page(folder: str | os.PathLike[str], rows: Sequence[Row], results: str) -> None:
    """Write index.html over these rows, which stand in the file `results`, into a folder, which is made."""
    make_folder(folder)
    with drawing.style():
        text = TEMPLATES.get_template("batch.html.j2").render(
            sentence=_sentence(rows), tiles=_tiles(rows), rows=[_cells(row, Path(folder)) for row in rows],
            states=[one for one in STATES if any(state(row) == one for row in rows)],
            figures=[drawing.shown(figure, caption) for figure, caption in _figures(rows)],
            facts=[("results", plain(results, 200)), ("tool", f"rdpi {version()}")])
    atomic_write(Path(folder) / PAGE, text)


def state(row: Row) -> str:
    """The verdict, and for want of one "fitted" or "failed"."""
    return "failed" if row.status != "done" else row.verdict or "fitted"


def _sentence(rows: Sequence[Row]) -> str:
    states = [state(row) for row in rows]
    parts = [f"{states.count(name)} {words}" for name, words in (
        ("effect", "with an effect found"), ("ambiguous", "not decided"), ("unknown", "with an unknown effect"),
        ("none", "with nothing new"), ("fitted", "fitted"), ("failed", "failed")) if name in states]
    return f"{len(rows)} actuator{'s' if len(rows) != 1 else ''}: {', '.join(parts)}."


def _tiles(rows: Sequence[Row]) -> list[dict[str, str]]:
    tiles = []
    for name, label in ERRORS.items():
        values = _values(rows, name)
        if len(values):
            worst = max((row for row in rows if getattr(row, name) is not None), key=lambda row: getattr(row, name))
            tiles.append({"name": f"{label}, median", "value": f"{number(float(np.median(values)), 2)} %",
                          "remark": f"worst {number(float(np.max(values)), 2)} %, {plain(worst.actuator, 40)}"})
    return tiles


def _values(rows: Sequence[Row], name: str) -> np.ndarray:
    return np.array([getattr(row, name) for row in rows if getattr(row, name) is not None])


def _cells(row: Row, folder: Path) -> dict[str, Any]:
    links = [{"kind": kind, "target": quote(f"{row.actuator}/{page}")} for kind, page in PAGES.items()
             if (folder / row.actuator / page).exists()]
    numbers = [{"label": label, "value": getattr(row, name), "text": _percent(getattr(row, name))}
               for name, label in ERRORS.items()]
    return {"actuator": plain(row.actuator, 60), "links": links, "state": state(row), "effect": row.effect or "",
            "shrink": {"value": row.shrink, "text": NONE if row.shrink is None else percent(row.shrink)},
            "numbers": numbers, "started": (row.started_at or "").replace("T", " ").replace("+00:00", " UTC"),
            "error": plain(row.error or "", 400), "model": plain(row.model_path or "", 80)}


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{number(value, 2)} %"


def _figures(rows: Sequence[Row]) -> list[tuple[Figure, str]]:
    made = []
    if any(len(_values(rows, name)) for name in ERRORS):
        made.append((_errors(rows), "How many actuators have which error, in % of their stroke."))
    if any(row.started_at for row in rows):
        made.append((_over_time(rows), "Verdicts by the time at which each actuator was worked on, in UTC."))
    return made


def _errors(rows: Sequence[Row]) -> Figure:
    figure, axes = drawing.panel()
    curves = {label: values for name, label in ERRORS.items() if len(values := _values(rows, name))}
    everything = np.concatenate([*curves.values()])
    low, high = everything[everything > 0].min(initial=1.0), everything.max(initial=1.0)
    edges = np.geomspace(low / 1.05, high * 1.05, BINS + 1)
    for (label, values), colour in zip(curves.items(), (drawing.NOW, drawing.AFTER, drawing.INK)):
        axes.stairs(np.histogram(np.maximum(values, low), edges)[0], edges, color=colour, lw=1.6, label=label)
    axes.set(xscale="log", xlabel="rms error [% of stroke]", ylabel="actuators", xlim=(edges[0], edges[-1]))
    drawing.logarithmic(axes)
    drawing.counting(axes.yaxis)
    drawing.legend(axes)
    return figure


def _over_time(rows: Sequence[Row]) -> Figure:
    from matplotlib import dates

    figure, axes = drawing.panel()
    timed = [(datetime.fromisoformat(row.started_at).timestamp() / DAY_S, state(row)) for row in rows if row.started_at]
    days = np.array([day for day, _ in timed])
    span = max(float(np.ptp(days)), 1 / BINS / 60)
    edges = np.linspace(days.min() - span / BINS / 2, days.max() + span / BINS / 2, BINS + 1)
    below = np.zeros(BINS)
    for name, colour in STATES.items():
        count = np.histogram(days[[one == name for _, one in timed]], edges)[0]
        if count.any():
            axes.bar(edges[:-1], count, np.diff(edges), below, align="edge", color=colour, label=name)
            below += count
    locator = dates.AutoDateLocator(minticks=3, maxticks=8)  # with fewer it finds none for some spans, and warns
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    axes.set(ylabel="actuators")
    drawing.counting(axes.yaxis)
    drawing.legend(axes)
    return figure
