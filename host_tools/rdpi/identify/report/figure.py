"""Pictures of a model beside recordings: loops, slopes against rate, prediction over time, residual."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from ...data import Recording, atomic_write
from ...errors import BadInput
from ...model import Model
from ...simulate import Prediction
from ..bands import RateSlopes
from ..strokes import along_path, turning_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 4000  # drawn per curve: more cannot be seen
PATH, PATH_POINTS = 0.02, 200_000  # of the command's range, between points of a loop; so many at most
RESTS = 0.1  # of the samples of a cycle, by which it may rest more than another
WINDOW_POINTS = 2000  # samples of the prediction shown over time
RESIDUAL_BINS = 80
PICTURE_FORMATS = ".png", ".svg", ".pdf"
NAMED_RUNS = 8  # more names would cover the loops
LABELS = 20  # slopes that have room for a name, of LINES in the height of the panel
LINES = 28


def picture(model: Model, runs: Sequence[Recording], predictions: Sequence[Prediction],
            bands: RateSlopes | None) -> Figure:
    """Figure of four panels, the error in time on a fifth axis; `predictions` one per run, `bands` None if no rate."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 9), layout="constrained")
    loops, slopes, time, residual = figure.subplots(2, 2).flat
    _loops(loops, runs, predictions)
    draw_slopes(slopes, model, bands)
    worst = max(range(len(runs)), key=lambda i: np.std(runs[i].displacement_um - predictions[i].predicted_um))
    _time(time, runs[worst], predictions[worst])
    _residual(residual, runs, predictions)
    if model.actuator:
        figure.suptitle(_shown(model.actuator, 100))
    return figure


def check_picture_name(path: str) -> None:
    """Raise BadInput unless the suffix of the name is one of PICTURE_FORMATS."""
    if os.path.splitext(path)[1].lower() not in PICTURE_FORMATS:
        raise BadInput(f"{path}: write a picture as .png, .svg or .pdf")


@contextmanager
def whatever_letters() -> Iterator[None]:
    """Without a warning of letters that the font lacks."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")
        yield


def write_picture(figure: Figure, path: str | os.PathLike[str]) -> None:
    """PNG, SVG or PDF by the name's suffix, written atomically; text stays text, to be searched and edited."""
    from matplotlib import rc_context

    suffix = os.path.splitext(path)[1].lstrip(".").lower() or "png"
    data = io.BytesIO()
    with whatever_letters(), rc_context({"svg.fonttype": "none", "pdf.fonttype": 42}):
        figure.savefig(data, format=suffix, dpi=110)
    atomic_write(path, data.getvalue())


def thin(samples: int, points: int = POINTS) -> slice:
    return slice(None, None, max(1, samples // points))


def _shown(text: str, longest: int = 32) -> str:
    """`text` as a picture can show it: short, printable, no mathematics; a leading _ would hide it from a legend."""
    if len(text) > longest:
        text = f"{text[:longest // 2]}…{text[-(longest - longest // 2 - 1):]}"
    text = "".join(letter if letter.isprintable() else "?" for letter in text).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def _name(run: Recording) -> str:
    return _shown(os.path.basename(run.path))


def last_cycle(command_V: np.ndarray) -> slice:
    """From one rise to the next, over at least half of the command's range: the last of those that turn round least
    often and hardly rest; everything if there is none.
    """
    low, high = np.quantile([command_V.min(), command_V.max()], (0.25, 0.75))
    ends = np.flatnonzero((command_V <= low) | (command_V >= high))
    above = command_V[ends] >= high
    rises = ends[1:][above[1:] & ~above[:-1]]
    if len(rises) < 2:
        return slice(None)
    turns = np.diff(np.searchsorted(turning_points(command_V), rises))
    rests = np.diff(np.cumsum(np.diff(command_V, prepend=np.nan) == 0)[rises]) / np.diff(rises)
    fewest = turns == np.min(turns)
    last = np.flatnonzero(fewest & (rests <= np.min(rests[fewest]) + RESTS))[-1]
    return slice(rises[last], rises[last + 1] + 1)


def _loops(axes: Axes, runs: Sequence[Recording], predictions: Sequence[Prediction]) -> None:
    """One cycle of each prediction: more would hide what was measured."""
    for i, (run, prediction) in enumerate(zip(runs, predictions)):
        part, cycle = along_path(run.command_V, PATH * float(np.ptp(run.command_V))), last_cycle(run.command_V)
        part = part[thin(len(part), PATH_POINTS)]
        axes.plot(run.command_V[part], run.displacement_um[part], lw=1, color=f"C{i % 10}", alpha=0.6, rasterized=True,
                  label=_name(run) if len(runs) <= NAMED_RUNS else None)
        command, predicted = run.command_V[cycle], prediction.predicted_um[cycle]
        part = thin(len(command))
        axes.plot(command[part], predicted[part], lw=0.9, ls=(0, (4, 3)), color="black", zorder=3,
                  label="predicted, one wide cycle" if i == len(runs) - 1 else None)
    axes.set(xlabel="command [V]", ylabel="displacement [µm]", title="Loops")
    axes.legend(fontsize="small", loc="upper left")


def draw_slopes(axes: Axes, model: Model, bands: RateSlopes | None) -> None:
    """Fig. 7 of the paper: slopes against rate, each band fitted alone (dots) and the model's law (lines)."""
    from matplotlib import colormaps

    top = model.rate.identified_um_per_s or model.rate.max_um_per_s
    rate = np.array([0.0, top])
    colours = colormaps["viridis"](np.linspace(0.3, 0.85, len(model.slopes)))  # seen on dark pages and on bright ones
    ends = model.slopes_at(top)
    for i, colour in enumerate(colours):
        axes.plot(rate, model.slopes_at(rate)[:, i], color=colour)
        if bands is not None:
            axes.plot(bands.rate_um_per_s, bands.slopes[:, i], "o", ms=4, color=colour)
    alone = bands.slopes[np.isfinite(bands.slopes)] if bands is not None else []
    shown = np.concatenate([model.slopes, ends, alone])
    middle, span = (np.min(shown) + np.max(shown)) / 2, np.ptp(shown) or 0.1
    line = span / (LINES - 4)
    low, high = middle - span / 2 - line, middle + span / 2 + 3 * line  # room for the guard's name above the slopes'
    named = np.arange(0, len(ends), -(-len(ends) // LABELS))
    guard = model.rate.max_um_per_s
    near = guard < 1.3 * top
    right = max(top, guard) if near else top
    for i, height in zip(named, _spread(ends[named], line, high - 2.5 * line)):
        # A leader from the line's end: where lines are close, their names stand above them.
        axes.annotate(f"$W_{{{i}}}$", (top, ends[i]), xytext=(top + 0.03 * right, height), fontsize=8, va="center",
                      color=colours[i], arrowprops={"arrowstyle": "-", "lw": 0.6, "color": colours[i], "shrinkA": 0,
                                                    "shrinkB": 0})
    if near:
        axes.axvline(guard, color="red", lw=0.8, ls="--")
        side = 1 if guard < right / 2 else -1
        axes.annotate("guard", (guard, high), xytext=(3 * side, -3), textcoords="offset points", va="top",
                      ha="left" if side > 0 else "right", color="red", fontsize=8)
    axes.set(xlabel="rate [µm/s]", ylabel="slope of the loading curve", ylim=(low, high),
             xlim=(-0.04 * right, 1.1 * right), title="Slopes against rate (lines: model, dots: bands of rate)")


def _spread(values: np.ndarray, gap: float, top: float) -> np.ndarray:
    """Heights of labels near `values`, at least `gap` apart and none above `top`."""
    order = np.argsort(values, kind="stable")
    steps = gap * np.arange(len(values))
    heights = np.empty(len(values))
    heights[order] = np.minimum(np.maximum.accumulate(values[order] - steps), top - steps[-1]) + steps
    return heights


def _time(axes: Axes, run: Recording, prediction: Prediction) -> None:
    error = np.abs(run.displacement_um - prediction.predicted_um)
    start = int(np.clip(np.argmax(error) - WINDOW_POINTS // 2, 0, max(0, len(run) - WINDOW_POINTS)))
    part = slice(start, start + WINDOW_POINTS)
    axes.plot(run.time_s[part], run.displacement_um[part], color="C0", label="measured")
    axes.plot(run.time_s[part], prediction.predicted_um[part], color="black", lw=0.8, ls="--", label="predicted")
    miss = axes.twinx()
    miss.plot(run.time_s[part], (run.displacement_um - prediction.predicted_um)[part], color="C3", lw=0.7)
    miss.set_ylabel("measured − predicted [µm]", color="C3")
    largest = 3 * float(error[part].max()) or 1.0
    miss.set_ylim(-largest, largest)
    axes.set(xlabel="time [s]", ylabel="displacement [µm]", title=f"Prediction where it is worst: {_name(run)}")
    axes.margins(y=0.13)  # the legend above the curves
    axes.legend(fontsize="small", loc="upper right", ncol=2)


def _residual(axes: Axes, runs: Sequence[Recording], predictions: Sequence[Prediction]) -> None:
    """Residual against position, rising and falling apart: what dead zones and plays cannot take up shows as shape."""
    for rising, colour, label in ((True, "C3", "rising"), (False, "C0", "falling")):
        position, error = [], []
        for run, prediction in zip(runs, predictions):
            move = np.gradient(run.command_V)
            inside = move > 0 if rising else move < 0
            position.append(prediction.predicted_um[inside])
            error.append((run.displacement_um - prediction.predicted_um)[inside])
        where, what = np.concatenate(position), np.concatenate(error)
        if not len(where):
            continue
        axes.plot(where[thin(len(where))], what[thin(len(where))], ".", ms=1.5, color=colour, alpha=0.25)
        edges = np.linspace(where.min(), where.max(), RESIDUAL_BINS + 1)
        bins = np.digitize(where, edges[1:-1])
        counts = np.bincount(bins, minlength=RESIDUAL_BINS)
        means = np.bincount(bins, what, RESIDUAL_BINS) / np.maximum(counts, 1)
        axes.plot(((edges[1:] + edges[:-1]) / 2)[counts > 0], means[counts > 0], color=colour, label=f"{label}, mean")
    axes.axhline(0, color="black", lw=0.5)
    axes.set(xlabel="predicted displacement [µm]", ylabel="measured − predicted [µm]", title="Residual")
    if len(axes.lines) > 1:  # a constant command has neither branch
        axes.legend(fontsize="small")
