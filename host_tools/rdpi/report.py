"""Pictures of a model beside recordings: loops, slopes against rate, prediction over time, residual."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .chain import Prediction
from .identify import RateSlopes
from .model import Model
from .recording import Recording, atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 4000  # drawn per curve: more cannot be seen
WINDOW_POINTS = 2000  # samples of the prediction shown over time
RESIDUAL_BINS = 80


def picture(model: Model, runs: Sequence[Recording], predictions: Sequence[Prediction], bands: RateSlopes | None) -> Figure:
    """Figure of four panels; `predictions` one per run, `bands` None without a rate to show."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 9), layout="constrained")
    loops, slopes, time, residual = figure.subplots(2, 2).flat
    _loops(loops, runs, predictions)
    _slopes(slopes, model, bands)
    worst = max(range(len(runs)), key=lambda i: np.std(runs[i].displacement_um - predictions[i].predicted_um))
    _time(time, runs[worst], predictions[worst])
    _residual(residual, runs, predictions)
    if model.actuator:
        figure.suptitle(model.actuator)
    return figure


def write_picture(figure: Figure, path: str | os.PathLike[str]) -> None:
    """PNG, SVG or PDF by the name's suffix, written atomically."""
    suffix = os.path.splitext(path)[1].lstrip(".").lower() or "png"
    data = io.BytesIO()
    figure.savefig(data, format=suffix, dpi=110)
    atomic_write(path, data.getvalue())


def _thin(samples: int) -> slice:
    return slice(None, None, max(1, samples // POINTS))


def _loops(axes: Axes, runs: Sequence[Recording], predictions: Sequence[Prediction]) -> None:
    for i, (run, prediction) in enumerate(zip(runs, predictions)):
        part = _thin(len(run))
        axes.plot(run.command_V[part], run.displacement_um[part], lw=2.5, color=f"C{i % 10}", alpha=0.5,
                  label=os.path.basename(run.path) if len(runs) <= 8 else None)
        axes.plot(run.command_V[part], prediction.predicted_um[part], lw=0.4, color="black", alpha=0.6,
                  label="predicted" if i == 0 else None)
    axes.set(xlabel="command [V]", ylabel="displacement [µm]", title="Loops")
    axes.legend(fontsize="small", loc="upper left")


def _slopes(axes: Axes, model: Model, bands: RateSlopes | None) -> None:
    """Fig. 7 of the paper: slopes against rate, each band fitted alone (dots) and the model's law (lines)."""
    from matplotlib import colormaps

    top = model.rate.identified_um_per_s or model.rate.max_um_per_s
    rate = np.array([0.0, top])
    colours = colormaps["viridis"](np.linspace(0, 0.9, len(model.slopes)))
    ends = model.slopes_at(top)
    shown = np.concatenate([model.slopes, ends] + ([bands.slopes[np.isfinite(bands.slopes)]] if bands is not None else []))
    low, high = 0.9 * np.min(shown), 1.05 * np.max(shown)
    labels = _spread(ends, (high - low) / 28)
    for i, colour in enumerate(colours):
        axes.plot(rate, model.slopes_at(rate)[:, i], color=colour)
        if bands is not None:
            axes.plot(bands.rate_um_per_s, bands.slopes[:, i], "o", ms=4, color=colour)
        axes.annotate(f"$W_{{{i}}}$", (top, labels[i]), xytext=(4, -3), textcoords="offset points", fontsize=8, color=colour)
    if model.rate.max_um_per_s < 1.3 * top:
        axes.axvline(model.rate.max_um_per_s, color="red", lw=0.8, ls="--")
        axes.annotate("guard", (model.rate.max_um_per_s, low), xytext=(-3, 4), textcoords="offset points", ha="right",
                      color="red", fontsize=8)
    axes.set(xlabel="rate [µm/s]", ylabel="slope of the loading curve", ylim=(low, high),
             title="Slopes against rate (lines: model, dots: each band of rate alone)")


def _spread(values: np.ndarray, gap: float) -> np.ndarray:
    """Heights of labels near `values`, at least `gap` apart."""
    order = np.argsort(values, kind="stable")
    heights = np.array(values, float)
    for before, after in zip(order, order[1:]):
        heights[after] = max(heights[after], heights[before] + gap)
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
    axes.set(xlabel="time [s]", ylabel="displacement [µm]", title=f"Prediction where it is worst: {os.path.basename(run.path)}")
    axes.legend(fontsize="small", loc="upper right")


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
        axes.plot(where[_thin(len(where))], what[_thin(len(where))], ".", ms=1.5, color=colour, alpha=0.25)
        edges = np.linspace(where.min(), where.max(), RESIDUAL_BINS + 1)
        bins = np.digitize(where, edges[1:-1])
        counts = np.bincount(bins, minlength=RESIDUAL_BINS)
        means = np.bincount(bins, what, RESIDUAL_BINS) / np.maximum(counts, 1)
        axes.plot(((edges[1:] + edges[:-1]) / 2)[counts > 0], means[counts > 0], color=colour, label=f"{label}, mean")
    axes.axhline(0, color="black", lw=0.5)
    axes.set(xlabel="predicted displacement [µm]", ylabel="measured − predicted [µm]", title="Residual")
    axes.legend(fontsize="small")
