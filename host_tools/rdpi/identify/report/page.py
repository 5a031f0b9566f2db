"""The page of `rdpi fit --report`: how well the model predicts, what stands around the operator, what is missed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ... import version
from ...data import Recording
from ...model import Model, records
from ...simulate import Prediction, chain
from ...simulate.effects import CATALOGUE
from .. import localise
from ..bands import RateSlopes, rate_slopes
from ..document import FitDocument, name_of
from . import drawing, figure
from .numbers import NONE, base, bracketed, given, interval, number, plain, sentence_of, sized, um
from .templating import environment

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..choice import Choice
    from ..identify import Fit

SLOPES = 4.6, 4.4  # inches
LOOPS = 4  # recordings whose loops are shown, those first of which most is missed
WITH, WITHOUT, ALONE = "with effects", "without effects", "predicted"

TEMPLATES = environment(__package__)


class Side(NamedTuple):
    """A model beside the recordings."""

    label: str
    colour: str
    model: Model
    predictions: list[Prediction]
    residuals_um: list[np.ndarray]  # measured - predicted, (samples,) per run
    bands: RateSlopes


def page_of(result: Fit, runs: Sequence[Recording], document: FitDocument) -> str:
    """The page's text, which loads nothing from elsewhere; `runs` are all recordings, those held out last."""
    sides = _sides(result, runs)
    with drawing.style():
        return TEMPLATES.get_template("fit.html.j2").render(
            heading=plain(result.model.actuator or "actuator", 100), sentence=_sentence(document, sides),
            tiles=_tiles(result, document), effects=_effects(result), brought=_brought(result.choice),
            variants=[{"name": name_of(one), "parameters": one.parameters, "missed": f"{number(one.left_out_percent, 3)} %"}
                      for one in document.variants],
            sweep=sentence_of(result.sweep.line()),
            rows=_rows(document, sides), compared=len(sides) > 1, sections=_sections(result, runs, sides),
            warnings=[sentence_of(plain(warning, 1000)) for warning in document.warnings],
            facts=[("model", plain(document.model, 200)), ("tool", f"rdpi {version()}")],
            provenance=[{"file": plain(run.file, 200), "digest": run.digest, "samples": f"{run.samples:,}".replace(",", " ")}
                        for run in document.runs])


def _sides(result: Fit, runs: Sequence[Recording]) -> list[Side]:
    """The model; and if it has effects, before it the one that was fitted without."""
    def side(label: str, colour: str, model: Model, bands: RateSlopes) -> Side:
        predictions = chain.simulate(model, runs)
        residuals = [run.displacement_um - one.predicted_um for run, one in zip(runs, predictions)]
        return Side(label, colour, model, predictions, residuals, bands)

    if result.plain is None or not result.model.effects:
        return [side(ALONE, drawing.AFTER, result.model, result.rate_slopes)]
    return [side(WITHOUT, drawing.NOW, result.plain, rate_slopes(result.plain, runs)),
            side(WITH, drawing.AFTER, result.model, result.rate_slopes)]


# ---- words and numbers ----


def _sentence(document: FitDocument, sides: Sequence[Side]) -> str:
    held = [k for k, run in enumerate(document.runs) if run.held_out]
    judged = held or range(len(document.runs))
    worst = max(document.runs[k].rms_percent for k in judged)
    kind = "held-out" if held else "fitted"
    text = f"The model predicts the {kind} recordings to {number(worst, 2)} % rms of their stroke"
    if len(sides) > 1:
        before = max(float(row) for row in (_percent(sides[0], k) for k in judged))
        text += f"; an operator fitted to them without the effects, to {number(before, 2)} %"
    return text + (" or better." if len(judged) > 1 else ".")


def _percent(side: Side, k: int) -> float:
    """rms error of a recording in % of its stroke, as the scores of a fit have it."""
    predicted = side.predictions[k].predicted_um
    return chain.score(predicted, predicted + side.residuals_um[k]).rms_percent


def _tiles(result: Fit, document: FitDocument) -> list[dict[str, str]]:
    """The key figures."""
    model, rate = result.model, result.model.rate
    low, high = chain.reachable_um(model)
    tiles = [("stroke", um(model.stroke_um), f"reachable {number(low)} to {number(high)} µm"),
             ("noise", um(document.noise_um), "of the sensor, rms"),
             ("operator", f"{len(model.slopes) - 1} plays", f"{len(model.deadzones_um) - 1} dead zones"),
             ("rates up to", f"{number(rate.identified_um_per_s)} µm/s", f"guard at {number(rate.max_um_per_s)} µm/s")]
    return [{"name": name, "value": value, "remark": remark} for name, value, remark in tiles]


def _brought(choice: Choice | None) -> str:
    """What all effects and the rate law brought; "" where none was looked for."""
    if choice is None:
        return ""
    after, before = (f"{number(choice.percent(one.rms_um), 3)} %" for one in (choice.found, choice.plain))
    return f"Of parts of these recordings, each predicted from the others, the model misses {after} rms of the stroke" + (
        f", a rate-independent operator alone {before}." if before != after else ".")


def _effects(result: Fit) -> list[dict[str, Any]]:
    """The model's effects, a card each: what it is, its size, what it brought, and what may be in its place."""
    cards = [_effect(entry) for entry in result.model.effects]
    for card, one in zip(cards, result.choice.kept if result.choice else ()):
        if one.stage_shown:
            card["stage"] += ", as monitor_V shows"
        if not one.of_amplifier:
            card["facts"].append(f"without it {number(result.choice.percent(one.without.rms_um), 3)} %")
        if one.confusable_with:
            others = " or ".join(CATALOGUE[name].title for name in one.confusable_with)
            card["facts"].append(f"{others} would do as well")
    return cards


def _effect(entry: dict[str, Any]) -> dict[str, Any]:
    """An effect of the model: what it is, and its size."""
    kind = CATALOGUE[entry["name"]]
    units = {parameter.name: parameter.unit for parameter in kind.parameters}
    parameters = {}
    for name, stated in entry.get("parameters", {}).items():
        stated = stated if isinstance(stated, dict) else {"value": stated}
        if name in units:
            parameters[name] = records.EffectParameter(value=stated.get("value"), ci95=stated.get("ci95"),
                                                       unit=units[name])
    return {"id": kind.name, "title": kind.title, "what": sentence_of(kind.what), "stage": entry.get("stage", ""),
            "facts": [f"{sized(name, one)}{bracketed(interval(name, one))}" for name, one in given(parameters).items()]}


def _rows(document: FitDocument, sides: Sequence[Side]) -> list[dict[str, str]]:
    """Rows of the table of recordings."""
    return [{"number": str(k + 1), "file": plain(base(run.file), 60), "use": "held out" if run.held_out else "fitted",
             "memory": run.memory, "rms": um(run.rms_um), "percent": f"{number(run.rms_percent, 2)} %",
             "max": f"{number(run.max_percent, 2)} %", "offset": um(run.offset_um),
             "without": f"{number(_percent(sides[0], k), 2)} %" if len(sides) > 1 else NONE}
            for k, run in enumerate(document.runs)]


# ---- pictures ----


def _sections(result: Fit, runs: Sequence[Recording], sides: Sequence[Side]) -> list[dict[str, Any]]:
    """Headings with their pictures."""
    worst = sorted(range(len(runs)), key=lambda k: -float(np.std(sides[-1].residuals_um[k])))
    first, by = runs[worst[0]], " without the effects" if len(sides) > 1 else ""
    return [
        _section("Measured against predicted", True, [
            (drawing.time_figure(first, _missed(sides, worst[0])),
             f"{_name(first)}, where most is missed{by}. The mean error is removed."),
            (drawing.residual_figure(first, _missed(sides, worst[0]), result.noise_um),
             f"What is missed of {_name(first)}: all of it, and where it is worst{by}. The mean is removed.")]),
        _section("Loops", False, [(drawing.loop_figure(runs[k], _missed(sides, k)), f"{_name(runs[k])}: one wide "
                                   "cycle, and what is missed of it.") for k in worst[:LOOPS]]),
        _section("Slopes against rate", True, [
            (_slopes_figure(one), f"Slopes {_of_model(one, sides)}. Lines: the model. Dots: each band of rate "
             "fitted alone.") for one in sides[::-1]]),
        _section("What the model misses", True, [*_tables(runs, sides), _spectrum(runs, sides, result.noise_um)])]


def _section(heading: str, wide: bool, figures: Sequence[tuple[Figure, str]]) -> dict[str, Any]:
    return {"heading": heading, "wide": wide,
            "figures": [drawing.shown(drawn, caption) for drawn, caption in figures]}


def _missed(sides: Sequence[Side], k: int) -> dict[str, np.ndarray]:
    return {one.label: one.residuals_um[k] for one in sides}


def _of_model(side: Side, sides: Sequence[Side]) -> str:
    """"of the model", and where there are two, "of the model with effects"."""
    return "of the model" + (f" {side.label}" if len(sides) > 1 else "")


def _name(run: Recording) -> str:
    return plain(base(run.path), 60)


def _slopes_figure(side: Side) -> Figure:
    drawn, axes = drawing.panel(SLOPES)
    figure.draw_slopes(axes, side.model, side.bands)
    axes.set_title("")
    return drawn


def _tables(runs: Sequence[Recording], sides: Sequence[Side]) -> list[tuple[Figure, str]]:
    """rms over position and rate of each side, in the same colours."""
    tables = [localise.table(one.residuals_um, _coordinates(runs, one)) for one in sides]
    most = max(float(np.nanmax(table.rms_um, initial=0.0)) for table in tables) or None
    return [(drawing.table_figure(table, most), f"rms of what is missed over position and rate, "
             f"{_of_model(one, sides)}. Empty cells hold hardly any samples.")
            for one, table in zip(sides, tables)][::-1]


def _spectrum(runs: Sequence[Recording], sides: Sequence[Side], noise_um: float) -> tuple[Figure, str]:
    curves = []
    for one in sides:
        residuals = [residual - np.mean(residual) for residual in one.residuals_um]
        axis = localise.along_frequency(runs, residuals, _coordinates(runs, one), None, noise_um)
        curves.append((one.label, axis.rms_um, axis.edges, {"color": one.colour, "lw": 1.8}))
    return drawing.spectrum_figure(curves), "Spectrum of what is missed, in octaves."


def _coordinates(runs: Sequence[Recording], side: Side) -> list[localise.Coordinates]:
    return [localise.coordinates(run, one.predicted_um, one.rate_um_per_s)
            for run, one in zip(runs, side.predictions)]
