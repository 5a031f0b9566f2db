"""Pictures: what they show is what the model and the recordings say."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from plants import quasi_static, rate_of, recording, stack, waves

from rdpi.data import Recording
from rdpi.identify import report
from rdpi.identify.report import figure as drawn_figure
from rdpi.identify.identify import Fit, Options, fit
from rdpi.simulate import chain


@lru_cache(maxsize=None)
def fitted() -> Fit:
    command = np.r_[waves(90, 20, 2, 5000), waves(90, 4, 1, 5000)]
    response = stack().respond(command, 0.13 * rate_of(command, 5000))
    run = recording(command, response, 5000, "folder/run.csv", noise_um=0.004)
    return fit([run], Options(rate_source="control"))


NASTY = (r"$\frac$", "$a$ $b$", "_hidden", "x" * 100_000, "a\nb\0\udc80", "圧電 №7", "\\", "{}%^~&#")


def panels(figure: Figure) -> tuple[Axes, ...]:
    """Loops, slopes, time, residual, error (the second axis of time)."""
    assert len(figure.axes) == 5
    return tuple(figure.axes)


def drawn(figure: Figure) -> Figure:
    """As it is on paper: with every text in its place, and without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.draw_without_rendering()
    return figure


def draw(runs: list[Recording], bands: object = None, **changes: object) -> Figure:
    model = replace(fitted().model, **changes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return report.picture(model, runs, chain.simulate(model, runs), bands)


def test_every_panel_says_what_and_in_which_unit() -> None:
    figure = draw([fitted().scores[0].recording], actuator="stack 7")
    assert len(panels(figure)) == 5 and figure._suptitle.get_text() == "stack 7"
    for axes in panels(figure)[:4]:
        assert axes.get_title() and axes.lines
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            assert re.search(r"\[(V|s|µm|µm/s)\]$", label) or label == "slope of the loading curve"
    assert panels(figure)[4].lines and panels(figure)[4].get_ylabel() == "measured − predicted [µm]"


def test_loops() -> None:
    run = fitted().scores[0].recording
    measured, predicted = panels(draw([run]))[0].lines
    assert measured.get_label() == "run.csv" and predicted.get_label() == "predicted, one wide cycle"
    assert np.isin(measured.get_ydata(), run.displacement_um).all()
    assert np.ptp(measured.get_xdata()) == pytest.approx(90, rel=0.01)
    expected = chain.simulate(fitted().model, [run])[0].predicted_um
    sample = {point: i for i, point in enumerate(zip(run.command_V, expected))}
    at = [sample[point] for point in zip(predicted.get_xdata(), predicted.get_ydata())]  # what the model predicts,
    assert np.ptp(predicted.get_xdata()) > 85  # over a loop,
    turns = np.diff(np.sign(np.diff(predicted.get_xdata()))) != 0
    assert 2 <= np.count_nonzero(turns) <= 4 and len(predicted.get_xdata()) < len(run) / 2  # once
    assert 0 < np.abs(run.displacement_um[at] - predicted.get_ydata()).max() < 0.1


def test_the_cycle_drawn_is_the_last_wide_one() -> None:
    phase = 2 * np.pi * np.arange(5000) / 1000
    height = np.array([1.0, 0.9, 0.8, 0.2, 0.1])[(phase / (2 * np.pi)).astype(int)]
    cycle = drawn_figure.last_cycle(50 - 50 * height * np.cos(phase))
    assert 1000 < cycle.start < 1500 < 2000 < cycle.stop < 2500
    steps = 100 * np.array([0.9, 0.1, 0.5, 0.2, 0.6, 0.1, 0.9]).repeat(100)
    for later in (steps, 100 * np.array([0.1, 0.4, 0.9, 0.5, 0.1, 0.9]).repeat(100)):  # which turns more often, or rests
        assert drawn_figure.last_cycle(np.r_[50 - 50 * height * np.cos(phase), later]) == cycle
    assert drawn_figure.last_cycle(np.linspace(0, 90, 50)) == drawn_figure.last_cycle(np.full(50, 3.0)) == slice(None)


def test_slopes_against_rate() -> None:
    """Fig. 7 of the paper: a line per slope, a dot per band."""
    model, bands = fitted().model, fitted().rate_slopes
    axes = panels(draw([fitted().scores[0].recording], bands))[1]
    lines = [line for line in axes.lines if line.get_linestyle() == "-"]
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    assert len(lines) == len(dots) == len(model.slopes)
    top = model.rate.identified_um_per_s
    for i, (line, dot) in enumerate(zip(lines, dots)):
        assert line.get_xdata()[-1] == pytest.approx(top)
        rest, change = model.slopes[i], top * model.slope_rate_s_per_um[i]
        assert line.get_ydata() == pytest.approx([rest, rest + change])
        assert dot.get_xdata() == pytest.approx(bands.rate_um_per_s)
        assert dot.get_ydata() == pytest.approx(bands.slopes[:, i], nan_ok=True)
    texts = [text.get_text() for text in axes.texts]
    assert [f"$W_{{{i}}}$" for i in range(len(model.slopes))] == [text for text in texts if text.startswith("$")]
    low, high = axes.get_ylim()
    assert all(low < height < high for line in [*lines, *dots] for height in line.get_ydata() if np.isfinite(height))
    assert high - low < 1.5 * np.ptp([h for line in [*lines, *dots] for h in line.get_ydata() if np.isfinite(h)])
    without = panels(draw([fitted().scores[0].recording]))[1]
    assert not any(line.get_marker() == "o" for line in without.lines)


def test_guard_is_drawn_where_it_is() -> None:
    run, rate = fitted().scores[0].recording, fitted().model.rate
    guard = [line for line in panels(draw([run]))[1].lines if line.get_linestyle() == "--"]
    assert [line.get_xdata()[0] for line in guard] == [pytest.approx(rate.max_um_per_s)]
    far = draw([run], rate=replace(rate, max_um_per_s=2 * rate.identified_um_per_s, min_slope_ratio=0.01))
    assert not [line for line in panels(far)[1].lines if line.get_linestyle() == "--"]


@pytest.mark.parametrize("slopes, guard", [
    (10, 1.0), (10, 1.2), (10, 0.02), (1, 1.0), (33, 1.0), (33, 0.5)])
@pytest.mark.parametrize("spacing", [0.0, 0.001, 0.1])
def test_labels_stay_inside_and_apart(slopes: int, guard: float, spacing: float) -> None:
    """Whatever the slopes are: equal, close or far apart."""
    model = fitted().model
    top = model.rate.identified_um_per_s
    model = replace(model, slopes=1 + spacing * np.arange(slopes), slope_rate_s_per_um=np.zeros(slopes),
                    rate=replace(model.rate, max_um_per_s=guard * top))
    figure = Figure(figsize=(6.5, 4.5), layout="constrained")
    axes = figure.subplots()
    drawn_figure.draw_slopes(axes, model, None)
    drawn(figure)
    whole = [text.get_window_extent() for text in axes.texts]  # with leaders
    boxes = [Text.get_window_extent(text) for text in axes.texts]
    frame = axes.get_window_extent()
    assert min(slopes, 10) < len(boxes) <= drawn_figure.LABELS + 1
    for i, (box, all_of_it) in enumerate(zip(boxes, whole)):
        assert frame.x0 <= all_of_it.x0 < all_of_it.x1 <= frame.x1, axes.texts[i]
        assert frame.y0 <= all_of_it.y0 < all_of_it.y1 <= frame.y1, axes.texts[i]
        centre, letters = (box.y0 + box.y1) / 2, 8 * figure.dpi / 72
        for other in boxes[:i]:
            assert abs(centre - (other.y0 + other.y1) / 2) > letters, axes.texts[i]


def test_time_shows_the_worst_moment_of_the_worst_run() -> None:
    good = fitted().scores[0].recording
    z = good.displacement_um.copy()
    z[1000] += 3
    spiked = replace(good, path="spiked.csv", columns={**good.columns, "displacement_um": z})
    axes = panels(draw([good, spiked]))[2]
    measured, predicted = axes.lines
    error = panels(axes.figure)[4].lines[0]
    assert error.get_ydata() == pytest.approx(measured.get_ydata() - predicted.get_ydata())
    assert error.get_xdata() == pytest.approx(measured.get_xdata())
    assert "spiked.csv" in axes.get_title()
    assert measured.get_xdata()[0] <= good.time_s[1000] <= measured.get_xdata()[-1]
    assert np.abs(measured.get_ydata() - predicted.get_ydata()).max() > 2.5
    (error,) = panels(draw([good, spiked]))[4].lines
    assert error.get_ydata() == pytest.approx(measured.get_ydata() - predicted.get_ydata())
    assert error.axes.get_ylim()[1] > error.get_ydata().max() > 2.5


def test_residual_of_both_directions() -> None:
    """An error that only the rising branch has shows in the rising curve alone."""
    good = fitted().scores[0].recording
    rising = np.gradient(good.command_V) > 0
    shifted = replace(good, columns={**good.columns, "displacement_um": good.displacement_um + 0.5 * rising})
    axes = panels(draw([shifted]))[3]
    means = {line.get_label(): np.median(line.get_ydata()) for line in axes.lines if "mean" in str(line.get_label())}
    assert means["rising, mean"] == pytest.approx(0.5, abs=0.05)
    assert means["falling, mean"] == pytest.approx(0, abs=0.05)


def test_long_recordings_are_thinned() -> None:
    """Points that cannot be seen are not drawn, and neither curve loses its ends."""
    run = quasi_static(stack(), waves(90, 1, 30, 1000), memory="reset")
    figure = draw([run])
    for axes in panels(figure):
        assert all(len(line.get_xdata()) < 2.1 * drawn_figure.POINTS for line in axes.lines)
    assert np.ptp(panels(figure)[0].lines[0].get_xdata()) > 89


def test_many_runs_have_no_names_in_the_legend() -> None:
    runs = [replace(fitted().scores[0].recording, path=f"{i}.csv") for i in range(9)]
    legends = (panels(draw(runs[:count]))[0].get_legend() for count in (8, 9))
    few, many = ({text.get_text() for text in legend.get_texts()} for legend in legends)
    assert few == {f"{i}.csv" for i in range(8)} | {"predicted, one wide cycle"}
    assert many == {"predicted, one wide cycle"}


def test_a_constant_command_can_be_drawn(caplog: pytest.LogCaptureFixture) -> None:
    """No branch rises or falls: an empty residual, and no warning of the drawing library."""
    still = recording(np.full(100, 45.0), 5 + 0.01 * np.sin(np.arange(100.0)), 1000, "still.csv")
    figure = drawn(draw([still]))
    assert caplog.records == [] and len(panels(figure)) == 5
    assert [len(axes.lines) for axes in panels(figure)[:1] + panels(figure)[2:]] == [2, 2, 1, 1]


@pytest.mark.parametrize("text", NASTY, ids=range(len(NASTY)))
def test_foreign_text_is_shown_as_it_is(text: str, tmp_path: Path) -> None:
    """No mathematics, no lost legend entry, nothing too long or unprintable."""
    run = replace(fitted().scores[0].recording, path=f"folder/{text}.csv")
    figure = draw([run], actuator=text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report.write_picture(figure, tmp_path / "a.png")
    legend = panels(figure)[0].get_legend().get_texts()
    assert len(legend) == 2
    shown = [figure._suptitle, legend[0], panels(figure)[2].title]
    for item in shown:
        plain, mathematics = item._preprocess_math(item.get_text())
        assert not mathematics and len(plain) < 120 and plain.isprintable()
        if text.isprintable() and len(text) < 100:
            assert text in plain
        else:
            assert text[:1] in plain


def empty() -> Figure:
    figure = Figure(figsize=(1, 1))
    figure.subplots()
    return figure


@pytest.mark.parametrize("name, start", [("a.png", b"\x89PNG"), ("a.PNG", b"\x89PNG"), ("a.svg", b"<?xml"),
                                         ("a.pdf", b"%PDF"), ("a", b"\x89PNG")])
def test_formats(name: str, start: bytes, tmp_path: Path) -> None:
    report.write_picture(empty(), tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(start)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_text_of_a_saved_picture_stays_text(tmp_path: Path) -> None:
    """As characters in an SVG; in a PDF with a TrueType font, which programs can select from and edit."""
    figure = empty()
    figure.suptitle("displacement")
    for name in ("a.svg", "a.pdf"):
        report.write_picture(figure, tmp_path / name)
    assert "displacement</text>" in (tmp_path / "a.svg").read_text()
    assert b"/FontFile2" in (tmp_path / "a.pdf").read_bytes()


def test_a_picture_that_cannot_be_drawn_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "a.bmp"
    path.write_text("as it was")
    with pytest.raises(ValueError):
        report.write_picture(empty(), path)
    assert path.read_text() == "as it was" and [file.name for file in tmp_path.iterdir()] == ["a.bmp"]
