"""What a plot of a page holds of the picture that it stands for."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import datetime
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from rdpi.identify.report import drawing, interactive


def plotted(draw: Callable[[Axes], Any]) -> dict:
    with drawing.style():
        figure, axes = drawing.panel()
        draw(axes)
        return json.loads(drawing.shown(figure, "").plot)


def test_lines_keep_names_looks_and_gaps() -> None:
    def draw(axes: Axes) -> None:
        axes.plot([0, 1, 2], [1, np.nan, 3], "--", color="red", lw=2, label="measured")
        axes.plot([0, 1], [1, 1], color="blue")

    first, second = plotted(draw)["series"]
    assert (first["type"], first["name"], first["data"]) == ("line", "measured", [[0, 1], [1, None], [2, 3]])
    assert first["lineStyle"]["type"] == "dashed" and first["color"] == "#ff0000ff"
    assert second["name"] == "" and second["lineStyle"]["type"] == "solid"


def test_marks_and_straight_lines_across() -> None:
    def draw(axes: Axes) -> None:
        axes.plot([1], [2], "o", label="now")
        axes.axhline(0.5)
        axes.axvline(0.25)

    marks, across = plotted(draw)["series"]
    assert (marks["type"], marks["data"]) == ("scatter", [[1, 2]])
    assert [{key: line.get(key) for key in ("xAxis", "yAxis")} for line in across["markLine"]["data"]] == [
        {"xAxis": None, "yAxis": 0.5}, {"xAxis": 0.25, "yAxis": None}]


def test_stairs_hold_each_value_up_to_the_next_edge() -> None:
    (one,) = plotted(lambda axes: axes.stairs([5, 6], [0, 1, 3], baseline=None, label="now"))["series"]
    assert (one["step"], one["data"]) == ("end", [[0, 5], [1, 6], [3, 6]])


def test_a_span_goes_up_and_down_between_its_extremes() -> None:
    (one,) = plotted(lambda axes: axes.fill_between([0, 1, 2], [0, -1, -2], [1, 2, 3]))["series"]
    assert one["data"] == [[0, 0], [0, 1], [1, -1], [1, 2], [2, -2], [2, 3]]


def test_bars_are_rectangles() -> None:
    (one,) = plotted(lambda axes: axes.bar([0, 1], [2, 3], width=0.5, bottom=1, label="now"))["series"]
    assert one["name"] == "now" and one["data"] == [[-0.25, 0.25, 1, 3, 2], [0.75, 1.25, 1, 4, 3]]


def test_bars_over_time() -> None:
    from matplotlib import dates

    day = datetime(2026, 11, 23).toordinal() - datetime(1970, 1, 1).toordinal()

    def draw(axes: Axes) -> None:
        axes.bar([day], [2], 0.5, align="edge")
        locator = dates.AutoDateLocator()
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))

    made = plotted(draw)
    assert made["xAxis"][0]["type"] == "time"
    assert made["series"][0]["data"][0][:2] == [day * 86.4e6, (day + 0.5) * 86.4e6]


def test_a_heat_map_has_its_colours_and_no_empty_cell() -> None:
    values = np.ma.masked_invalid([[1.0, np.nan], [3.0, 4.0]])
    (one,) = plotted(lambda axes: axes.pcolormesh([0, 1, 2], [0, 1, 2], values, vmin=0, vmax=4))["series"]
    assert [cell[:5] for cell in one["data"]] == [[0, 1, 0, 1, 1], [0, 1, 1, 2, 3], [1, 2, 1, 2, 4]]
    assert one["data"][2][5] == "#fde725ff"  # viridis' last


def test_a_scale_of_colours_stands_beside_its_panel() -> None:
    def draw(axes: Axes) -> None:
        axes.figure.colorbar(axes.pcolormesh([0, 1], [0, 1], [[2.0]], vmin=0, vmax=4), ax=axes, label="residual")

    made = plotted(draw)
    cells, scale = made["series"]
    left, right = ([float(box[key].rstrip("%")) for key in ("left", "width")] for box in made["grid"])
    assert cells["yAxisIndex"] == 0 and scale["yAxisIndex"] == 1 and sum(left) < right[0]
    axis = made["yAxis"][1]
    assert (axis["min"], axis["max"], axis["name"], axis["position"]) == (0, 4, "residual", "right")
    assert "mute" not in axis and made["xAxis"][1]["mute"]
    assert sum(right) / 100 + axis["nameGap"] < 1  # the name is within the picture
    assert scale["data"][-1][5] == "#fde725ff" and len(scale["data"]) > 100


def test_lines_between_marks_are_apart() -> None:
    (one,) = plotted(lambda axes: axes.hlines([0, 1], [2, 3], [4, 5]))["series"]
    assert one["data"] == [[2, 0], [4, 0], [None, None], [3, 1], [5, 1], [None, None]]


def test_names_in_a_panel() -> None:
    (one,) = plotted(lambda axes: axes.annotate("$W_{3}$", (1, 2), xytext=(4, 0), textcoords="offset points"))["series"]
    assert one["data"][0]["value"] == [1, 2] and one["data"][0]["label"]["formatter"] == "W3"


def test_counts_are_whole_numbers() -> None:
    def draw(axes: Axes) -> None:
        axes.plot([0, 1], [0, 1])
        drawing.counting(axes.yaxis)

    made = plotted(draw)
    assert made["yAxis"][0]["whole"] and "whole" not in made["xAxis"][0]


@pytest.mark.parametrize("low, high", [(0.11, 9.0), (0.3, 0.9), (2.1, 4.9), (1.02, 1.07), (0.5, 2000.0)])
def test_a_logarithmic_axis_has_two_labels_or_more(low: float, high: float) -> None:
    with drawing.style():
        figure, axes = drawing.panel()
        axes.plot([low, high], [1, 2])
        axes.set(xscale="log", xlim=(low, high))
        drawing.logarithmic(axes)
        figure.draw_without_rendering()
        shown = {one.get_text() for one in axes.get_xticklabels()
                 if one.get_text() and low <= one.get_position()[0] <= high}
        beside = [one.get_text() for one in axes.get_xticklabels(minor=True) if one.get_text()]
    assert len(shown) > 1 and beside == []


def test_axes() -> None:
    def draw(axes: Axes) -> None:
        axes.set(xscale="log", xlim=(1, 100), ylim=(2.6, -0.6), xlabel="frequency [Hz]")
        axes.set_yticks([0, 1, 2], ["one", "two", "three"])

    made = plotted(draw)
    x, y = made["xAxis"][0], made["yAxis"][0]
    assert (x["type"], x["min"], x["max"], x["name"]) == ("log", 1, 100, "frequency [Hz]")
    assert 0 < x["nameGap"] < 0.3
    assert y["inverse"] and y["ticks"] == [0, 1, 2] and y["texts"] == ["one", "two", "three"]


def test_the_legend_names_what_the_pictures_does() -> None:
    def draw(axes: Axes) -> None:
        axes.plot([0, 1], label="now")
        axes.plot([1, 0], label="after")
        drawing.legend(axes)

    assert plotted(draw)["legend"]["data"] == ["now", "after"]


def test_names_of_files_cannot_end_the_script() -> None:
    with drawing.style():
        figure, axes = drawing.panel()
        axes.plot([0, 1], label="</script><script>alert(1)")
        assert "<" not in interactive.plot(figure)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_what_is_no_number_is_a_gap(value: float) -> None:
    (one,) = plotted(lambda axes: axes.plot([0, 1], [0, value]))["series"]
    assert one["data"][1] == [1, None]
