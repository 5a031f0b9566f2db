"""The page of `rdpi fit --report`: what it says and shows is what the fit found, with and without effects."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache
from html import unescape

import numpy as np
import pytest
from matplotlib.figure import Figure
from pages import without_scripts
from plants import changed, quasi_static, stack, waves

from rdpi.data import Recording
from rdpi.identify import around, localise
from rdpi.identify.identify import Fit, Options, fit
from rdpi.identify.report import drawing
from rdpi.identify.report.numbers import sentence_of
from rdpi.identify.report.page import WITH, WITHOUT, _missed, _sides, _spectrum, _tables, page_of
from rdpi.simulate import chain

RATE_HZ = 2000.0
DELAY = {"name": "delay", "stage": "timing",
         "parameters": {"delay_s": {"value": 0.0042, "ci95": [0.0038, 0.0046], "unit": "s"}}}
CURVE = {"name": "input_curve", "parameters": {"quadratic": 0.0, "cubic": 0.0, "low_V": 12.5, "high_V": 77.5}}
OPTIONS = Options(rate_independent=True, effects="none")  # what the fit finds is not asked here
NASTY = '<b>$x$ & "q".csv'


def test_remarks_are_sentences_and_names_of_files_stay() -> None:
    assert [sentence_of(text) for text in ("a slope is low", "run.csv: is long.", "data/run: is long", " ")] == [
        "A slope is low.", "run.csv: is long.", "data/run: is long.", ""]


@lru_cache(maxsize=None)
def runs() -> tuple[Recording, ...]:
    """Two recordings of an actuator that answers 4 ms late."""
    found = []
    for k, command in enumerate((np.r_[waves(90, 2, 1, RATE_HZ), waves(90, 10, 2, RATE_HZ)], waves(80, 5, 4, RATE_HZ))):
        run = quasi_static(stack(law=0), command, RATE_HZ, noise_um=0.004)
        late = np.r_[np.full(8, run.displacement_um[0]), run.displacement_um[:-8]]
        found.append(replace(changed(run, displacement_um=late), path=f"folder/{k}.csv", digest=f"{k}"))
    return tuple(found)


@lru_cache(maxsize=None)
def fitted(compared: bool) -> Fit:
    """Fitted to the first recording; with effects, behind the delay."""
    first, second = runs()
    plain = fit([first], OPTIONS, [second])
    if not compared:
        return plain
    ahead = [changed(run, displacement_um=np.r_[run.displacement_um[8:], np.full(8, run.displacement_um[-1])])
             for run in (first, second)]
    found = fit(ahead[:1], OPTIONS, ahead[1:])
    return replace(found, model=replace(found.model, effects=[DELAY, CURVE]), plain=plain.model)


def written(result: Fit, *recordings: Recording) -> str:
    return without_scripts(page_of(result, recordings or runs(), result.document("model.json", False)))


def text_of(page: str) -> str:
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", "", page[page.index("</style>"):])))


def captions(page: str) -> list[str]:
    return [re.sub(r"\s+", " ", unescape(text)) for text in re.findall(r"<figcaption>(.*?)</figcaption>", page, re.S)]


@pytest.mark.parametrize("compared", [pytest.param(False, marks=pytest.mark.long), True])
def test_the_page_stands_alone(compared: bool) -> None:
    page = written(fitted(compared))
    assert page == written(fitted(compared)) and page.startswith("<!DOCTYPE html>") and page.endswith("</html>\n")
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert sources and all(source.startswith("data:image/svg+xml;base64,") for source in sources)
    assert not re.search(r"<script|<link|url\(|@import", page)


def test_a_model_without_effects_has_one_curve_each() -> None:
    page = written(fitted(False))
    assert len(captions(page)) == 2 + 2 + 1 + 1 + 1  # time, loops, slopes, table, spectrum
    text = text_of(page)
    assert "The model holds no effect beside its operator." in text and "effects" not in text
    assert [one.label for one in _sides(fitted(False), runs())] == ["predicted"]
    assert written(replace(fitted(False), plain=fitted(True).model)) == page  # nothing was found around the operator


def test_a_model_with_effects_is_shown_beside_the_one_without() -> None:
    page = written(fitted(True))
    shown = captions(page)
    assert len(shown) == 2 + 2 + 2 + 2 + 1
    for words in (f"of the model {WITH}", f"of the model {WITHOUT}"):
        assert sum(words in caption for caption in shown) == 2
    text = text_of(page)
    assert "delay 4.20 ms (95 % interval 3.80 to 4.60 ms)" in text.replace("\N{NO-BREAK SPACE}", " ")
    assert "input curve" in text and "12.5" not in text  # what only a simulation needs


def test_the_page_tells_what_the_terminal_does() -> None:
    result = fit(runs(), Options(rate_independent=True, effects="delay"))
    first, delay = around.lines(result.choice, result.model)
    alone, without = first.split("operator alone ")[1], delay.split("without it ")[1].split(";")[0]
    text = text_of(written(result)).replace("\N{NO-BREAK SPACE}", " ")
    assert f"of the stroke, a rate-independent operator alone {alone}." in text and f"without it {without}" in text
    confused = replace(result.choice, kept=(replace(result.choice.kept[0], confusable_with=("lag", "relaxation")),))
    assert "first-order lag or relaxation would do as well" in text_of(written(replace(result, choice=confused)))


def test_the_sentence_tells_the_worst_of_those_that_judge() -> None:
    result = fitted(True)
    document = result.document("model.json", False)
    without = [chain.score(one.predicted_um, run.displacement_um).rms_percent
               for run, one in zip(runs(), chain.simulate(result.plain, runs()))]
    assert without[1] > 3 * document.runs[1].rms_percent
    page = text_of(written(result)).replace("\N{NO-BREAK SPACE}", " ")
    assert (f"The model predicts the held-out recordings to {document.runs[1].rms_percent:.2g} % rms of their "
            f"stroke; an operator fitted to them without the effects, to {without[1]:.2g} %.") in page
    for run, missed in zip(document.runs, without):
        assert f"{run.rms_percent:.2g} % {missed:.2g} %" in page
    alone = replace(fitted(False), scores=[one._replace(held_out=False) for one in fitted(False).scores])
    worst = max(one.score.rms_percent for one in alone.scores)
    assert f"The model predicts the fitted recordings to {worst:.2g} % rms of their stroke or better." in text_of(
        written(alone)).replace("\N{NO-BREAK SPACE}", " ")


def drawn(figure: Figure) -> Figure:
    figure.draw_without_rendering()
    return figure


def test_measured_and_predicted_where_most_is_missed() -> None:
    run, sides = runs()[1], _sides(fitted(True), runs())
    measured, with_it, without = drawn(drawing.time_figure(run, _missed(sides, 1))).axes[0].lines
    assert [line.get_label() for line in (measured, with_it, without)] == ["measured", WITH, WITHOUT]
    assert with_it.get_color() == drawing.AFTER and without.get_color() == drawing.NOW
    part = drawing.worst_strokes(run, sides[0].residuals_um[1])
    assert measured.get_ydata() == pytest.approx(run.displacement_um[part])
    for line, side in ((without, sides[0]), (with_it, sides[1])):
        residual = side.residuals_um[1] - np.mean(side.residuals_um[1])
        assert line.get_ydata() == pytest.approx(run.displacement_um[part] - residual[part])


def test_a_few_strokes_are_shown_of_the_worst_part() -> None:
    run, sides = runs()[1], _sides(fitted(True), runs())
    many = changed(run, command_V=np.tile(run.command_V[:200], 60)[:len(run)])
    residual_um = np.where(np.arange(len(run)) < len(run) // 2, 1.0, 0.1) * np.sin(np.arange(len(run)))
    part, whole = drawing.worst_strokes(many, residual_um), drawing.worst_part(residual_um)
    assert whole.start <= part.start < part.stop <= whole.stop and part.stop <= len(run) // 2 + 200
    turns = np.count_nonzero(np.diff(np.sign(np.diff(many.command_V[part]))))
    assert turns <= drawing.STROKES


def test_loops_and_what_is_missed_of_them() -> None:
    run, sides = runs()[1], _sides(fitted(True), runs())
    loop, miss = drawn(drawing.loop_figure(run, _missed(sides, 1))).axes
    measured, with_it, without = loop.lines
    assert 75 < np.ptp(measured.get_xdata()) <= 80 and len(measured.get_xdata()) < len(run) / 2
    for line, below in ((without, miss.lines[0]), (with_it, miss.lines[1])):
        assert below.get_ydata() == pytest.approx(measured.get_ydata() - line.get_ydata())
        assert below.get_color() == line.get_color()
    assert np.std(miss.lines[0].get_ydata()) > 3 * np.std(miss.lines[1].get_ydata())


def test_both_tables_have_the_same_colours() -> None:
    sides = _sides(fitted(True), runs())
    found = _tables(runs(), sides)
    limits = {figure.axes[0].collections[0].get_clim() for figure, _ in found}
    assert len(limits) == 1 and WITH in found[0][1] and WITHOUT in found[1][1]
    coords = [localise.coordinates(run, one.predicted_um, one.rate_um_per_s)
              for run, one in zip(runs(), sides[0].predictions)]
    assert limits.pop() == (0, pytest.approx(np.nanmax(localise.table(sides[0].residuals_um, coords).rms_um)))


def test_the_spectrum_holds_the_whole_residual() -> None:
    sides = _sides(fitted(True), runs())
    curves = drawn(_spectrum(runs(), sides, 0.004)[0]).axes[0].patches
    for side, curve in zip(sides, curves, strict=True):
        total = np.mean(np.concatenate([one - np.mean(one) for one in side.residuals_um]) ** 2)
        assert np.nansum(curve.get_data().values ** 2) == pytest.approx(total, rel=0.05)


def test_foreign_text_is_shown_as_it_is() -> None:
    strange = [replace(run, path=f"{k}{NASTY}") for k, run in enumerate(runs())]
    result = fitted(False)
    result = replace(result, model=replace(result.model, actuator=NASTY), warnings=[NASTY],
                     scores=[one._replace(recording=run) for one, run in zip(result.scores, strange)])
    page = written(result, *strange)
    assert "<b>" not in page and text_of(page).count(NASTY) >= 6
