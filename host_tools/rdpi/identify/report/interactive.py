"""Pictures that zoom and tell values: a Matplotlib figure as the option object of an Apache ECharts plot.

A page holds both. The picture is what is printed, and what stands where no script runs; page.html.j2 puts the plot in
its place. Known is what the pictures of the pages draw: lines, marks, spans, stairs, bars, heat maps, straight lines
across a panel.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from .figure import whatever_letters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

DIGITS = 6  # of a value
DAY_MS = 86_400_000
WHOLE = "{x:.0f}"  # format of the labels of an axis that counts
LEADING = 0.3  # of a label's height: what a browser's line has above its letters
DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "solid": "solid", "dotted": "dotted"}
SYMBOLS = {"o": "circle", ".": "circle", "|": "rect", "x": "diamond"}

Json = dict[str, Any]


def plot(figure: Figure) -> str:
    """The option as JSON that may stand in a page's <script>."""
    return json.dumps(option(figure), default=float, allow_nan=False, separators=(",", ":")).replace("<", r"\u003c")


def option(figure: Figure) -> Json:
    """ECharts' option of a figure; page.html.j2 says what it adds. Lengths and sizes of letters are shares of the
    figure's width, so that the plot has the picture's layout at any width.
    """
    with whatever_letters():
        figure.draw_without_rendering()  # labels are where the last drawing put them, which had other dots per inch
    panels = figure.axes
    width, height = figure.get_size_inches() * figure.dpi
    names = [name for axes in panels if axes.get_legend() is not None
             for name in axes.get_legend_handles_labels()[1]]
    made: Json = {"aspect": float(width / height), "letters": _letters(panels[0]) * figure.dpi / 72 / width,
                  "grid": [], "xAxis": [], "yAxis": [], "series": [], "legend": {"data": names}}
    for index, axes in enumerate(panels):
        box = axes.get_position()
        made["grid"].append({"left": _percent(box.x0), "top": _percent(1 - box.y1), "width": _percent(box.width),
                             "height": _percent(box.height)})
        made["xAxis"].append(_axis(axes.xaxis, index, width))
        made["yAxis"].append(_axis(axes.yaxis, index, width))
        made["series"] += [{**one, "xAxisIndex": index, "yAxisIndex": index} for one in _series(axes)]
    return made


def _letters(axes: Axes) -> float:
    """Points."""
    return float(axes.xaxis.label.get_size())


def _percent(share: float) -> str:
    return f"{100 * share:.2f}%"


def _axis(axis: Axis, index: int, width: float) -> Json:
    from matplotlib import dates
    from matplotlib.ticker import FixedLocator

    low, high = sorted(float(end) for end in axis.get_view_interval())
    made: Json = {"type": "log" if axis.get_scale() == "log" else "value", "gridIndex": index, "min": _short(low),
                  "max": _short(high), "inverse": bool(axis.get_inverted())}
    text = axis.get_label_text()
    if text:
        label, box = axis.label.get_window_extent(), axis.axes.bbox
        gap = box.y0 - label.y1 - LEADING * label.height if axis.axis_name == "x" else \
            max(box.x0 - label.x1, label.x0 - box.x1)
        made |= {"name": text, "nameLocation": "middle", "nameGap": gap / width}
    if axis.get_ticks_position() == "right":
        made["position"] = "right"
    if isinstance(axis.get_major_locator(), FixedLocator):
        labels = axis.get_ticklabels()
        made |= {"ticks": [float(value) for value in axis.get_ticklocs()], "texts": [one.get_text() for one in labels],
                 "rotate": float(labels[0].get_rotation()) if labels else 0.0}
    elif isinstance(axis.get_major_formatter(), dates.ConciseDateFormatter):
        made |= {"type": "time", "min": low * DAY_MS, "max": high * DAY_MS}
    if getattr(axis.get_major_formatter(), "fmt", None) == WHOLE:
        made["whole"] = True
    if not any(one.label1.get_visible() or one.label2.get_visible() for one in axis.get_major_ticks()):
        made["mute"] = True  # shared with the panel below, or none at all
    return made


def _short(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None


def _points(x: np.ndarray, y: np.ndarray) -> list[list[float | None]]:
    return [[_short(one), _short(other)] for one, other in zip(np.asarray(x, float), np.asarray(y, float))]


def _colour(colour: Any) -> str:
    from matplotlib.colors import to_hex

    return to_hex(colour, keep_alpha=True)


def _series(axes: Axes) -> Iterator[Json]:
    """What is drawn in a panel, in the order of drawing."""
    from matplotlib.collections import LineCollection, PolyCollection, QuadMesh
    from matplotlib.patches import StepPatch

    across: list[Json] = []
    for line in axes.lines:
        if line.get_transform() == axes.transData:
            yield _line(line)
        else:  # axhline, axvline
            (x, *_), (y, *_) = line.get_data()
            level = {"yAxis": _short(y)} if line.get_transform() == axes.get_yaxis_transform(which="grid") else \
                {"xAxis": _short(x)}
            across.append({**level, "lineStyle": {"color": _colour(line.get_color()), "width": line.get_linewidth(),
                                                  "type": DASHES.get(line.get_linestyle(), "dashed")}})
    if across:
        yield {"type": "line", "data": [], "markLine": {"data": across, "symbol": "none", "silent": True,
                                                       "label": {"show": False}}}
    for patch in axes.patches:
        if isinstance(patch, StepPatch):
            values, edges, _ = patch.get_data()
            yield _curve(patch.get_label(), _points(edges, np.append(values, values[-1])), patch.get_edgecolor(),
                         patch.get_linewidth(), patch.get_linestyle()) | {"step": "end"}
    for bars in axes.containers:
        time = DAY_MS if _axis(axes.xaxis, 0, 1.0)["type"] == "time" else 1
        yield {"type": "custom", "name": bars.get_label(), "color": _colour(bars[0].get_facecolor()),
               "data": [[one.get_x() * time, (one.get_x() + one.get_width()) * time, one.get_y(),
                         one.get_y() + one.get_height(), _short(one.get_height())] for one in bars]}
    for drawn in axes.collections:
        if isinstance(drawn, QuadMesh):
            yield _cells(drawn)
        elif isinstance(drawn, LineCollection) and drawn.get_segments():
            ends = [point for one in drawn.get_segments() for point in (*_points(*np.transpose(one)), [None, None])]
            yield _curve("", ends, drawn.get_color()[0], 1.0, "-")
        elif isinstance(drawn, PolyCollection):  # a span between extremes: up and down in each of its columns
            corners = drawn.get_paths()[0].vertices
            x = np.unique(corners[:, 0])
            ends = np.array([[reach(corners[corners[:, 0] == one, 1]) for reach in (np.min, np.max)] for one in x])
            yield _curve(drawn.get_label(), _points(np.repeat(x, 2), ends.ravel()), drawn.get_facecolor()[0], 1.0, "-")


    named = [one for one in axes.texts if one.get_text()]
    if named:
        yield {"type": "scatter", "name": "", "silent": True, "symbolSize": 0, "data": [_text(one) for one in named]}


def _text(text: Text) -> Json:
    """A name at a place of the panel, without mathematics."""
    x, y = getattr(text, "xy", None) or text.get_position()
    beside = {"left": "right", "right": "left", "center": "inside"}[text.get_ha()]
    return {"value": [_short(x), _short(y)],
            "label": {"show": True, "formatter": text.get_text().translate(str.maketrans("", "", "$_{}\\")),
                      "position": beside, "color": _colour(text.get_color()), "share": text.get_size() / _letters(text.axes)}}


def _line(line: Line2D) -> Json:
    marker = line.get_marker()
    if marker not in SYMBOLS:
        return _curve(line.get_label(), _points(*line.get_data()), line.get_color(), line.get_linewidth(),
                      line.get_linestyle())
    return {"type": "scatter", "name": line.get_label(), "data": _points(*line.get_data()), "symbol": SYMBOLS[marker],
            "symbolSize": [2, 13] if marker == "|" else 1.2 * line.get_markersize(),
            "itemStyle": {"color": _colour(line.get_color())}}


def _curve(name: str, points: list[list[float | None]], colour: Any, width: float, dash: Any) -> Json:
    return {"type": "line", "name": "" if name.startswith("_") else name, "data": points, "showSymbol": False,
            "sampling": None, "color": _colour(colour),
            "lineStyle": {"color": _colour(colour), "width": 1.2 * width,
                          "type": DASHES.get(dash, "dashed") if isinstance(dash, str) else "dashed"}}


def _cells(mesh: Any) -> Json:
    """A rectangle and a value each; without a value there is none."""
    corners = mesh.get_coordinates()
    values = np.ma.filled(np.ma.asarray(mesh.get_array(), float), np.nan).reshape(np.array(corners.shape[:2]) - 1)
    cells = []
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            (x0, y0), (x1, y1) = corners[row, column], corners[row + 1, column + 1]
            cells.append([x0, x1, y0, y1, _short(value), _colour(mesh.to_rgba(value))])
    return {"type": "custom", "name": "", "data": cells}
