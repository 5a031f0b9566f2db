"""What is told of an identification: its figures, its lines for people, and its report."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..data import Recording, atomic_write, make_folder
from ..simulate import chain, scoring
from . import around, report
from .document import FitDocument, name_of
from .identify import Fit

PAGE, PICTURE, DOCUMENT = "fit.html", "fit.png", "fit.json"  # of a report


def worst_rms_percent(result: Fit) -> float:
    """Largest rms error of the runs that a model is judged by, % of stroke: those held out, or without any, all."""
    held = any(run.held_out for run in result.scores)
    return max(run.score.rms_percent for run in result.scores if run.held_out or not held)


def write_report(folder: str | os.PathLike[str], result: Fit, runs: Sequence[Recording],
                 document: FitDocument) -> None:
    """Write fit.html and fit.png, the model beside `runs`, and fit.json, the `document`, into a folder, which is made.

    Each is written atomically. Raises OSError when they cannot be, ValueError for numbers that are not finite.
    """
    text = report.page_of(result, runs, document)
    make_folder(folder)
    figure = report.picture(result.model, runs, chain.simulate(result.model, runs), result.rate_slopes)
    report.write_picture(figure, Path(folder) / PICTURE)
    atomic_write(Path(folder) / PAGE, text)
    atomic_write(Path(folder) / DOCUMENT, json.dumps(document.to_json(), indent=2, allow_nan=False) + "\n")


def lines(result: Fit, verbose: bool = False) -> list[str]:
    """An identification for people: size, scores, slopes against rate, reach, guard, and what to know; `verbose`: and the
    models that were compared.
    """
    model, rate = result.model, result.model.rate
    low, high = chain.reachable_um(model)
    top = rate.identified_um_per_s
    told = [f"{len(model.slopes) - 1} plays, {len(model.deadzones_um) - 1} dead zones, "
            f"stroke {model.stroke_um:.5g} um, noise {result.noise_um:.2g} um rms",
            *scoring.table([(run.recording.path, run.score, ("held out" if run.held_out else "fitted") + _aside(run.score))
                            for run in result.scores]),
            *(around.lines(result.choice, model) if result.choice else ()),
            *(_variants(result) if verbose else ()),
            *_slopes(result)]
    dependent, independent = (100 * residual for residual in result.residual)
    if dependent != independent:
        told.append(f"residual of the regression: {dependent:.3g} % rms of the stroke, "
                    f"without the rate law {independent:.3g} %")
    told.append(result.sweep.line())
    singular = rate.singular_um_per_s
    return told + [
        f"reachable displacement: {low:.5g} to {high:.5g} um; references are displacements as the sensor reads them",
        f"rates identified up to {top:.4g} um/s; guard at {rate.max_um_per_s:.4g} um/s"
        + (f"; a slope reaches zero at {singular:.4g} um/s" if singular else ""),
        *([f"the slopes follow the rate behind a low-pass of {rate.filter_s:.4g} s"]
          if rate.filter_s and np.any(model.slope_rate_s_per_um) else []),
        *(f"note: {warning}" for warning in result.warnings)]


def _aside(score: chain.Score) -> str:
    """What is missed besides a constant, where that is most of it."""
    if not score.mostly_offset:
        return ""
    return f"; {score.rms_percent * score.beside_offset_um / score.rms_um:.3g} % beside an offset of {score.offset_um:.3g} um"


def _variants(result: Fit) -> list[str]:
    return ["models that were compared, the one that is delivered first: missed of whole recordings, or parts of the only "
            "one, left out in turn, offsets apart",
            f"  {'% of stroke':>11} {'parameters':>10}   around the operator",
            *(f"  {one.left_out_percent:11.3g} {one.parameters:10}   {name_of(one)}" for one in result.variants)]


def _slopes(result: Fit) -> list[str]:
    """The table of slopes: of each band of rate fitted alone, and of the model at rest and at its highest rate."""
    model, bands, top = result.model, result.rate_slopes, result.model.rate.identified_um_per_s
    rows = [*((f"{rate:.4g} um/s", slopes) for rate, slopes in zip(bands.rate_um_per_s, bands.slopes)),
            ("model, at rest", model.slopes), (f"model, {top:.4g} um/s", model.slopes_at(top))]
    return ["slopes W_i against rate: each band of rate fitted alone, then the model's law",
            f"  {'':>20}" + "".join(f"{f'W_{i}':>7}" for i in range(len(model.slopes))),
            *(f"  {label:>20}" + "".join(f"{'-' if np.isnan(slope) else f'{slope:.3f}':>7}" for slope in slopes)
              for label, slopes in rows)]
