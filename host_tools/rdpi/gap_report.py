"""The report of `rdpi gap`: one page that a person reads from top to bottom, its twin in JSON, the terminal's text.

All of it says what the document of `rdpi gap --json` says. Of that only `verdict` and `gap` must be there: a model
without a passport, a single recording or a verdict without an effect leaves much out, and what is missing is not shown.
"""

from __future__ import annotations

import base64
import io
import json
import math
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jinja2
import numpy as np

from . import version
from .effects import CATALOGUE
from .passport import FITTED
from .recording import Recording, atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .localise import Axis, Table

Document = Mapping[str, Any]

PAGE = "index.html"
TWIN = "gap.json"

VERDICTS = {"effect": "effect found", "ambiguous": "not decided yet", "none": "nothing new",
            "unknown": "no known effect"}
NOTHING_TO_RECORD = {
    **dict.fromkeys(("effect", "none"), "Nothing is open that another recording would settle."),
    "ambiguous": "None of the drives that rdpi excite makes would tell these effects apart. A column monitor_V (the "
                 "amplifier's output as measured) or a second sensor may.",
    "unknown": "No drive is proposed, for it is not known what to look for. More columns beside the displacement may "
               "show it: monitor_V, temperature_degC, the drives of other axes.",
}
COUNTED = {"delay", "lag", "slew_limit", "initial_memory", "gain_change", "resonance", "periodic_disturbance",
           "static_nonlinearity"}  # whose titles take an article
EXPLAINED = 0.9  # of the energy, from where on an effect explains the gap, and not most of it
ALIKE, PAIRS = 0.9, 6  # R² from which on an effect is said to look like another, and how many pairs are told
SAME = 0.1  # relative: a gap within it is as large as the passport's

TERMINAL = str.maketrans({"µ": "u", "−": "-", "–": "-", "…": "...", "°": "deg"})

INK = "#747a82"  # reads on white and on black
NOW, AFTER = "#d0642a", "#2f86c4"  # also told apart by those who are colour-blind
STYLE = {"font.size": 9, "text.color": INK, "axes.edgecolor": INK, "axes.labelcolor": INK, "xtick.color": INK,
         "ytick.color": INK, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
         "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none", "svg.hashsalt": "rdpi"}
SMALL, WIDE = (3.4, 2.3), (4.6, 3.3)  # inches
COLUMNS = 500  # of a curve over time: more cannot be seen
ZOOM = 0.05  # of a recording, shown once more where the gap is worst
NUMBERED = 120  # cells of the heat map that have room for a number
LETTERS = 24  # that fit below a small picture side by side
SHADE = 0.7  # opacity of a cell of the matrix at R² = 1: its number can still be read
BARS = 24  # recordings in the picture; the table has all

TEMPLATES = jinja2.Environment(loader=jinja2.PackageLoader(__package__), undefined=jinja2.StrictUndefined,
                                autoescape=True, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
TEMPLATES.filters["tight"] = lambda text: re.sub(r"(?<=\d) (?=(%|[nµm]?[ms]|Hz|V)\b|%)", "\N{NO-BREAK SPACE}", text)


@dataclass(frozen=True)
class Pictures:
    """What the page's pictures need beyond the document."""

    runs: Sequence[Recording]
    before_um: Sequence[np.ndarray]  # measured - predicted, (samples,) per run
    after_um: Sequence[np.ndarray] | None = None  # the same with the effects added; None where none was
    table: Table | None = None  # rms over position x rate
    spectrum_after: Axis | None = None  # the axis frequency_hz with the effects added


class AxisWords(NamedTuple):
    """What an axis is called."""

    title: str
    label: str  # of a picture's axis
    place: str  # of one bin of it


AXES = {
    "time_s": AxisWords("time", "time from the start [s]", "{} s after the start"),
    "frequency_hz": AxisWords("frequency", "frequency [Hz]", "at {} Hz"),
    "rate_um_per_s": AxisWords("rate", "rate [µm/s]", "at rates of {} µm/s"),
    "position_um": AxisWords("position", "position [µm]", "at positions of {} µm"),
    "direction": AxisWords("direction", "direction", "while {}"),
    "since_reversal_s": AxisWords("time since reversal", "time since reversal [s]",
                                  "{} s after the command turned round"),
    "amplitude_um": AxisWords("amplitude", "size of the loop [µm]", "in loops of {} µm"),
    "recording": AxisWords("recording", "recording", "in {}"),
}


def write(document: Document, pictures: Pictures, folder: str | os.PathLike[str]) -> None:
    """Write `index.html`, which loads nothing from elsewhere, and `gap.json` into `folder`, which is made.

    Both are written atomically. Raises OSError when they cannot be, ValueError for numbers that are not finite.
    """
    twin = json.dumps(document, indent=2, allow_nan=False, default=lambda value: value.tolist()) + "\n"
    text = page(document, pictures)
    Path(folder).mkdir(parents=True, exist_ok=True)
    atomic_write(Path(folder) / TWIN, twin)
    atomic_write(Path(folder) / PAGE, text)


def page(document: Document, pictures: Pictures) -> str:
    """The page's text; the same for the same document and pictures."""
    candidates, runs = _candidates(document), _runs(document)
    return TEMPLATES.get_template("gap.html.j2").render(
        badge=VERDICTS[document["verdict"]], verdict=document["verdict"], sentence=sentence(document),
        promise=_promise(document), tiles=_tiles(document), where=_where(document),
        figures=_where_figures(document, pictures), why=_why(document), which=_which(document), candidates=candidates,
        with_passport=any(row["passport"] != "–" for row in candidates), matrix=_matrix(document), far=_far(document),
        runs=runs, with_ratio=any(row["ratio"] != "–" for row in runs), runs_figure=_runs_figure(document),
        hidden=_hidden(document), unseen=_unseen(document), next_experiment=_next(document),
        no_experiment=NOTHING_TO_RECORD[document["verdict"]], provenance=_provenance(document), twin=TWIN)


# ---- the verdict in words ----


def sentence(document: Document) -> str:
    """The verdict in one sentence with numbers and units, and one or two more where something limits it."""
    gap, passport, verdict = document["gap"], document.get("passport"), document["verdict"]
    text = f"The gap is {_um(gap['rms_um'])} rms"
    if gap.get("percent_of_stroke") is not None:
        text += f" ({_number(gap['percent_of_stroke'], 2)} % of the stroke)"
    runs = len(document.get("runs") or ())
    text += " in one recording" if runs == 1 else f" over {runs} recordings" if runs else ""
    if passport:
        text += f", {_times(passport['ratio'])} the model missed at commissioning"
    say = {"effect": _explained, "ambiguous": _explained, "none": _nothing, "unknown": _unexplained}[verdict]
    text += say(document)
    if not passport:
        text += " The model carries no passport: how much of this it missed at commissioning is not known."
    return text


def _explained(document: Document) -> str:
    """What explains the gap, how well, and what it cannot be told from."""
    effects = document.get("effects") or ()
    undecided = document["verdict"] == "ambiguous"
    causes = [_cause(document, effect) if undecided else _phrase(effect) for effect in effects] or [_open(document)]
    several, one_run = len(causes) > 1, len(document.get("runs") or ()) == 1
    before, after = _held_out(document)
    text = f": {_listed(causes)} explain{'' if several else 's'} {_how_much(document, before, after)}"
    if after is not None:
        they = "they were" if several or causes[0].startswith("either") else "it was"
        text += (f", and on {_unseen_parts(document)} {they} not fitted to, the residual "
                 f"{'falls' if after < before else 'goes'} from {_change(before, after, 'to')}")
    if undecided:
        return f"{text}. {'This recording' if one_run else 'These recordings'} cannot tell which it is."
    for effect in effects:
        stage, rivals = _told_from(document, effect)
        if rivals:
            here = "this recording" if one_run else "these recordings"
            text += f". With {here} {_named(effect['name'], stage)} cannot be told from {_listed(rivals, 'or')}"
    return f"{text}."


def _cause(document: Document, effect: Document) -> str:
    """An accepted effect, or it and its rivals: "either a signal delay of 0.52 ms or a first-order lag"."""
    stage, rivals = _told_from(document, effect)
    phrase = _phrase(effect, stage)
    return f"either {_listed([phrase, *rivals], 'or')}" if rivals else phrase


def _open(document: Document) -> str:
    """What may explain the gap when no effect was singled out."""
    names = list(dict.fromkeys(one["name"] for one in _tried(document) if not one.get("rejected_because")))
    return f"either {_listed([_named(name) for name in names], 'or')}" if len(names) > 1 else "more than one effect"


def _nothing(document: Document) -> str:
    if document.get("passport"):
        return ": nothing beyond the model's own error and the sensor's noise."
    return f": {_none_tried(document)} makes it smaller by more than chance would."


def _unexplained(document: Document) -> str:
    text = f": {_none_tried(document)} explains it"
    best = max((one for one in _tried(document) if one.get("shrink") is not None),
               key=lambda one: one["shrink"], default=None)
    if best is not None and best["shrink"] > 0:
        text += f"; the best of them, {_title(best['name'])}, would shrink it by {_percent(best['shrink'])}"
    text += "."
    place = _concentration(document)
    return f"{text} {place[0].upper()}{place[1:]}." if place else text


def _none_tried(document: Document) -> str:
    tried = len({one["name"] for one in _tried(document)})
    return f"none of the {tried} effects tried" if tried > 1 else "no effect that was tried"


def _concentration(document: Document) -> str:
    """Where on the dominant axis the gap lies: "62 % of the energy lies at 40 to 80 Hz"; "" when that is not known."""
    where = document.get("where") or {}
    name = where.get("dominant")
    axis = (where.get("axes") or {}).get(name)
    if not axis or not any(axis.get("share") or ()):
        return ""
    worst = int(np.argmax(axis["share"]))
    text = f"{_percent(axis['share'][worst])} of the energy lies {AXES[name].place.format(_bins(axis)[worst])}"
    ratio = (axis.get("ratio") or {worst: None})[worst]
    return text + (f", {_times(ratio)} the model missed there at commissioning" if ratio else "")


def _promise(document: Document) -> str:
    """What adding the effects to the model promises on recordings to come; "" when nothing is promised."""
    promised = document.get("promised") or {}
    if promised.get("shrink") is None:
        return ""
    text = f"Added to the model, this promises a gap smaller by {_percent(promised['shrink'])} on new recordings"
    if promised.get("ci90"):
        return f"{text} (90 % interval {_percents(promised['ci90'])})."
    why = _plain(promised.get("why_no_interval") or "", 300).rstrip(".")
    return f"{text}; no interval can be given{f': {why}' if why else ''}."


def _held_out(document: Document) -> tuple[float, float | None]:
    """rms in um before the first effect and with the last one, on recordings not fitted to; None when none was."""
    scores = [effect["held_out_rms_um"] for effect in document.get("effects") or () if effect.get("held_out_rms_um")]
    return (scores[0]["before"], scores[-1]["after"]) if scores else (document["gap"]["rms_um"], None)


def _unseen_parts(document: Document) -> str:
    """What effects are judged on."""
    return "blocks of the recording" if len(document.get("runs") or ()) == 1 else "recordings"


def _how_much(document: Document, before: float, after: float | None) -> str:
    """Of the gap: it, most of it, a part of it."""
    if after is None:
        return "it"
    expected = (document.get("passport") or {}).get("rms_um") or 0.0
    explained = 1 - (after / before)**2 if before > 0 else 0.0
    if explained >= EXPLAINED or (explained > 0 and after <= (1 + SAME) * expected):
        return "it"
    return "most of it" if explained >= 0.5 else "a part of it"


def _rivals(document: Document, effect: Document) -> list[tuple[str, str]]:
    """Name and stage of what the effect cannot be told from; a stage only where the name is the effect's own."""
    candidates = document.get("candidates") or ()
    rivals = []
    for name in effect.get("confusable_with") or ():
        elsewhere = [one["stage"] for one in candidates if one["name"] == name and one.get("stage") is not None
                     and one["stage"] != effect.get("stage")]
        rivals.append((name, "" if name != effect["name"] else f"stage {_plain((elsewhere or ['unknown'])[0])}"))
    return rivals


def _told_from(document: Document, effect: Document) -> tuple[str, list[str]]:
    """The effect's own stage, where only that tells it from a rival, and the rivals: ["creep", "a signal delay"]."""
    rivals = _rivals(document, effect)
    same = any(name == effect["name"] for name, _ in rivals) and effect.get("stage")
    return f"stage {_plain(effect['stage'])}" if same else "", [_named(*rival) for rival in rivals]


def _tried(document: Document) -> list[Document]:
    """Candidates that the recordings could show."""
    return [one for one in document.get("candidates") or () if one.get("excited", True)]


# ---- the terminal ----


def tables(document: Document) -> str:
    """For the terminal: the verdict, where the gap lies, the candidates, what is hidden, what to record next.

    Of letters beyond ASCII only those that came from files, as with the other commands.
    """
    lines = [sentence(document)]
    if promise := _promise(document):
        lines.append(promise)
    if place := _concentration(document):
        lines.append(f"dominant axis: {AXES[document['where']['dominant']].title}; {place}")
    rows = _candidates(document)
    if rows:
        heads = ["candidate", "", "stage", "shrink", "95 % interval", "refitted", ""]
        table = [heads, *([row["id"], row["title"], row["stage"], row["shrink"], row["interval"], row["refitted"],
                           row["verdict"]] for row in rows)]
        widths = [max(len(row[column]) for row in table) for column in range(len(heads))]
        lines += ["  " + "  ".join(cell.rjust(width) if column in (3, 5) else cell.ljust(width)
                                   for column, (cell, width) in enumerate(zip(row, widths))).rstrip() for row in table]
    lines += [f"not to be seen in these recordings: {one['id']}" + (f" (needs {one['needs']})" if one["needs"] else "")
              for one in _hidden(document)]
    lines += [f"note: {note}" for note in _notes(document)]
    experiment = _next(document)
    if experiment:
        lines += [f"record next: {experiment['command']}", *([f"  {experiment['why']}"] if experiment["why"] else [])]
    return "\n".join(lines).translate(TERMINAL)


# ---- what the page shows ----


def _tiles(document: Document) -> list[dict[str, str]]:
    """The key figures."""
    gap, passport = document["gap"], document.get("passport")
    stroke = gap.get("percent_of_stroke")
    tiles = [("gap", _um(gap["rms_um"]), f"{_number(stroke, 2)} % of the stroke" if stroke is not None else "")]
    if passport:
        tiles.append(("at commissioning", _um(passport["rms_um"]), f"ratio {_number(passport['ratio'], 2)}"))
    if gap.get("noise_floor_um") is not None:
        tiles.append(("noise floor", _um(gap["noise_floor_um"]), "of the sensor"))
    if document.get("effects") and gap.get("remaining_um") is not None:
        explained = gap.get("explained_um")
        tiles.append(("with the effects added", _um(gap["remaining_um"]),
                      f"explained {_um(explained)}" if explained is not None else ""))
    return [{"name": name, "value": value, "remark": remark} for name, value, remark in tiles]


def _where(document: Document) -> list[str]:
    """Sentences on the stage, the dominant axis and the numerics."""
    where, numerics = document.get("where") or {}, document.get("numerics")
    lines = []
    if place := _concentration(document):
        lines.append(f"The gap concentrates most when sorted by {AXES[where['dominant']].title}: {place}.")
    stage = where.get("stage")
    if stage:
        stage = stage if isinstance(stage, str) else _listed([str(one) for one in stage], "or")
        lines.append(f"Stage of the chain: {_plain(stage)}.")
    if stages := where.get("stages"):
        lines.append("The recorded monitor_V splits the gap's energy: "
                     f"{_percent(stages['before_monitor'])} arises before the tap (numerics, DAC, timing, amplifier), "
                     f"{_percent(stages['after_monitor'])} after it (actuator, mechanics, environment, sensor).")
    if numerics and any(size is not None for size in (numerics.get("rms_um") or {}).values()):
        sizes = [f"{_plain(name)} {_um(size)} rms" for name, size in numerics["rms_um"].items() if size is not None]
        worst = max(size for size in numerics["rms_um"].values() if size is not None)
        share = worst / (document["gap"]["rms_um"] or math.inf)
        lines.append(f"The arithmetic of the firmware differs from exact numbers by {_listed(sizes)}: "
                     f"{'less than 1 %' if share < 0.01 else f'up to {_percent(share)}'} of the gap.")
    return lines


def _why(document: Document) -> list[str]:
    """Why these effects: what they gain, the best of the others, and what refitting the model alone gains."""
    lines = []
    rest = [one for one in _tried(document) if one.get("rejected_because") and (one.get("shrink") or 0) > 0]
    best = max(rest, key=lambda one: one["shrink"], default=None)
    if document.get("effects"):
        tried, several = len({one["name"] for one in _tried(document)}), len(document["effects"]) > 1
        if document["verdict"] == "ambiguous":
            lines.append("More than one effect explains these recordings equally well; to take one of them for the "
                         "cause would be a guess.")
        elif tried > 1:
            lines.append(f"Of {tried} effects tried, {'these are the ones' if several else 'this is the one'} that "
                         f"{_unseen_parts(document)} {'they were' if several else 'it was'} not fitted to bear out.")
        if best is not None:
            lines.append(f"The best of those rejected, {_title(best['name'])}, would shrink the residual by "
                         f"{_percent(best['shrink'])}: {_plain(best['rejected_because'], 300)}.")
    elif document["verdict"] == "none":
        lines.append("No effect is needed. What those that were tried would gain is no more than chance gives.")
    elif document["verdict"] == "unknown":
        lines.append("The gap is real, but no effect that is known here makes it go away. What causes it is not in the "
                     "list, or what it needs to be seen is not in these recordings.")
    if (document.get("refit") or {}).get("shrink") is not None:
        lines.append("Fitting the model anew to these recordings, without any effect, would shrink the residual by "
                     f"{_percent(document['refit']['shrink'])}.")
    return lines


def _far(document: Document) -> list[str]:
    """What adding the effects gains over all recordings."""
    before, after = _held_out(document)
    if after is None:
        return ["No effect was added; this is the gap in each recording as it is."]
    floor = document["gap"].get("noise_floor_um")
    noise = f"; the sensor's noise alone is {_um(floor)} rms" if floor is not None else ""
    lines = [f"On {_unseen_parts(document)} not used to fit or to select, the residual is {_um(before)} rms without "
             f"and {_um(after)} rms with the effects{noise}."]
    promise = _promise(document)
    return [*lines, promise] if promise else lines


def _which(document: Document) -> list[dict[str, Any]]:
    """The accepted effects and what they cannot be told from, for a card each."""
    cards = []
    for effect in document.get("effects") or ():
        rivals = _rivals(document, effect)
        scores, interval = effect.get("held_out_rms_um"), effect.get("shrink_ci95")
        facts = [f"{_label(name)} {_quantity(name, one)}{_bracketed(_interval(name, one))}".strip()
                 for name, one in (effect.get("parameters") or {}).items() if _given(one)]
        if scores:
            facts.append(f"residual, held out: {_change(scores['before'], scores['after'], '→')}")
        if effect.get("shrink") is not None:
            facts.append(f"shrink {_percent(effect['shrink'])}"
                         + (f" (95 % interval {_percents(interval)})" if interval else ""))
        if effect.get("confidence") is not None:
            facts.append(f"confidence {_text(effect['confidence'])}")
        if rivals:
            facts.append(f"cannot be told from {_listed(_told_from(document, effect)[1], 'or')}")
        cards.append({**_about(effect["name"]), "stage": _plain(effect.get("stage") or ""), "facts": facts,
                      "rival": False})
        cards += [{**_about(name), "stage": stage.removeprefix("stage "), "facts": [], "rival": True}
                  for name, stage in rivals]
    return cards


def _candidates(document: Document) -> list[dict[str, str]]:
    """Rows of the table of what was tried: accepted, as good, then by shrink."""
    effects = document.get("effects") or ()
    rows = []
    for one in _tried(document):
        own = [effect for effect in effects if one["name"] == effect["name"]
               and one.get("stage") in (None, effect.get("stage"))]
        if own:
            open_end = document["verdict"] == "ambiguous" and own[0].get("confusable_with")
            rank, verdict = 0, "explains these recordings best" if open_end else "accepted"
        elif one.get("rejected_because"):
            rank, verdict = 2, _plain(one["rejected_because"], 300)
        elif effects or document["verdict"] == "ambiguous":
            rank, verdict = 1, "explains these recordings as well"
        else:
            rank, verdict = 2, "–"
        shrink = one.get("shrink")
        row = {"id": one["name"], "title": _title(one["name"]), "stage": _plain(one.get("stage") or ""),
               "size": "; ".join(f"{_label(name)} {_quantity(name, value)}".strip()
                                 for name, value in (one.get("parameters") or {}).items() if _given(value)) or "–",
               "shrink": _percent(shrink), "interval": _percents(one.get("shrink_ci95")),
               "refitted": _percent(one.get("refitted_shrink")), "passport": _percent(one.get("passport_shrink")),
               "verdict": verdict, "kind": ("accepted", "rival", "rejected")[rank]}
        rows.append((rank, -math.inf if shrink is None else shrink, row))
    return [row for _, _, row in sorted(rows, key=lambda entry: (entry[0], -entry[1]))]


def _matrix(document: Document) -> dict[str, Any] | None:
    """Rows of R² with their names, and in words the pairs that are alike; None without a matrix of two or more."""
    matrix = document.get("matrix")
    if not matrix or len(matrix["names"]) < 2:
        return None
    names = [_plain(name) for name in matrix["names"]]
    rows = [{"name": names[row], "cells": [
        {"text": "–" if r2 is None else f"{r2:.2f}", "shade": round(SHADE * min(max(r2 or 0.0, 0.0), 1.0), 3),
         "alike": row != column and r2 is not None and r2 >= ALIKE} for column, r2 in enumerate(values)]}
        for row, values in enumerate(matrix["r2"])]
    alike = sorted(((r2, f"{names[column]} reproduces {_percent(r2)} of {names[row]}")
                    for row, values in enumerate(matrix["r2"]) for column, r2 in enumerate(values)
                    if row != column and r2 is not None and r2 >= ALIKE), reverse=True)
    more = len(alike) - PAIRS
    listed = [text for _, text in alike[:PAIRS]] + ([f"{more} more pairs, in bold below"] if more > 0 else [])
    summary = f"Nearly the same in these recordings: {_listed(listed)}." if listed else \
        f"In these recordings no effect reproduces {_percent(ALIKE)} or more of another."
    return {"names": names, "rows": rows, "summary": summary}


def _runs(document: Document) -> list[dict[str, str]]:
    """Rows of the table of recordings, the largest share first."""
    rows = []
    for number, run in enumerate(_ranked(document), 1):
        rms = run.get("rms_um") or {}
        before, after, stroke = rms.get("before"), rms.get("after"), run.get("percent_of_stroke")
        rows.append({"number": str(number), "file": _plain(_base(run.get("file")), 60),
                     "share": _percent(run.get("share")), "before": _um(before),
                     "after": _um(after) if document.get("effects") else "–", "noise": _um(run.get("noise_floor_um")),
                     "stroke": "–" if stroke is None else f"{_number(stroke, 2)} %",
                     "ratio": _number(run.get("ratio"), 2), "offset": _um(run.get("offset_um"))})
    return rows


def _ranked(document: Document) -> list[Document]:
    """Recordings, the one with the largest share of the gap first."""
    return sorted(document.get("runs") or (), key=lambda run: -(run.get("share") or 0))


def _hidden(document: Document) -> list[dict[str, str]]:
    """Effects that these recordings could not show."""
    named = [one["name"] for one in document.get("not_excited") or ()]
    needs = {one["name"]: one.get("needs") for one in document.get("not_excited") or ()}
    more = [one["name"] for one in document.get("candidates") or () if not one.get("excited", True)]
    return [{**_about(name), "needs": _plain(needs.get(name) or _about(name)["needs"], 300)}
            for name in dict.fromkeys([*named, *more])]


def _unseen(document: Document) -> list[str]:
    """What limits what can be said, besides effects not excited."""
    passport, where = document.get("passport"), document.get("where") or {}
    lines = []
    if not passport:
        lines.append("The model carries no passport, so its own error at commissioning cannot be taken off: an error "
                     "that was always there may be blamed on an effect. A model that rdpi fit makes today has one.")
    elif passport.get("held_out") == FITTED:
        lines.append("The passport was taken on the recordings the model was fitted to, which makes the gap look "
                     "larger than it is; fit with two or more recordings, or with --hold-out.")
    if where.get("stages") is None:
        lines.append("Without a column monitor_V (the amplifier's output as measured) in every recording, amplifier "
                     "and sensor can be told apart only by the effect itself.")
    if len(document.get("runs") or ()) == 1:
        lines.append("With one recording effects are judged on blocks of that same recording: what holds for other "
                     "drives is not tested.")
    return [*lines, *_notes(document)]


def _notes(document: Document) -> list[str]:
    return [_plain(note, 500) for note in document.get("notes") or ()]


def _next(document: Document) -> dict[str, str] | None:
    experiment = document.get("next_experiment")
    if not experiment:
        return None
    why = _sentence(_plain(experiment.get("why") or "", 500))
    seconds = experiment.get("seconds")
    duration = f"It takes {_number(seconds)} s on the bench." if seconds is not None else ""
    return {"command": _plain(experiment["command"], 1000),
            "why": " ".join(part for part in (why, duration) if part)}


def _provenance(document: Document) -> dict[str, Any]:
    """Where all this comes from."""
    passport, facts = document.get("passport"), []
    if document.get("model"):
        facts.append(("model", _plain(str(document["model"]), 200)))
    if document.get("model_digest"):
        facts.append(("model's digest", _plain(str(document["model_digest"]))))
    facts.append(("tool", _plain(str(document.get("tool") or f"rdpi {version()}"))))
    if passport and passport.get("held_out"):
        facts.append(("the passport's recordings", _plain(str(passport["held_out"]))))
    if document.get("detection") is not None:
        facts.append(("detection score", f"{_number(document['detection'])} (larger: surer that there is a gap beyond "
                                         "the passport)"))
    return {"facts": facts, "runs": [
        {"file": _plain(run.get("file") or "", 200), "digest": _plain(run.get("digest") or "", 100),
         "samples": f"{run['samples']:,}".replace(",", " ") if run.get("samples") is not None else "–"}
        for run in document.get("runs") or ()]}


# ---- pictures ----


def _where_figures(document: Document, pictures: Pictures) -> list[dict[str, Any]]:
    """Of the section "where": source, caption, alternative text, whether it is wide and shows the dominant axis."""
    where = document.get("where") or {}
    axes, dominant, added = where.get("axes") or {}, where.get("dominant"), bool(document.get("effects"))
    passport = any(axis.get("expected_um") for axis in axes.values())
    shown = []

    def add(figure: Figure, caption: str, wide: bool, name: str = "") -> None:
        shown.append({"source": _source(figure), "caption": caption, "wide": wide,
                      "dominant": bool(name) and name == dominant})

    with _style():
        for name in AXES:
            if name in axes and name not in ("frequency_hz", "recording"):
                add(axis_figure(name, axes[name]), f"Along {AXES[name].title}.", False, name)
        if "frequency_hz" in axes:
            after = pictures.spectrum_after if added else None
            curves = ["now", *["at commissioning"] * passport, *["with the effects added"] * (after is not None)]
            add(spectrum_figure(axes["frequency_hz"], after), f"Spectrum of the residual, {_listed(curves)}.", True,
                "frequency_hz")
        if pictures.table is not None:
            add(table_figure(pictures.table), "rms of the residual over position and rate. Empty cells hold "
                "hardly any samples.", True)
        if pictures.runs:
            sizes = [float(np.std(residual)) for residual in pictures.before_um]
            worst = int(np.argmax(sizes))
            after = pictures.after_um[worst] if added and pictures.after_um is not None else None
            noise = next((run.get("noise_floor_um") for run in (document.get("runs") or ())[worst:worst + 1]), None)
            add(time_figure(pictures.runs[worst], pictures.before_um[worst], after, noise),
                f"Residual of {'the recording' if len(sizes) == 1 else 'the worst recording'}, "
                f"{_plain(_base(pictures.runs[worst].path), 60)}: all of it, and where it is worst.", True)
    return shown


def _runs_figure(document: Document) -> str | None:
    runs = [run for run in _ranked(document) if (run.get("rms_um") or {}).get("before") is not None]
    if not runs:
        return None
    with _style():
        return _source(runs_figure(runs, bool(document.get("effects"))))


def axis_figure(name: str, axis: Document) -> Figure:
    """The rms in each bin, and beside it the passport's; `axis` is one of `where.axes`."""
    figure, axes = _panel(SMALL)
    rms = np.array(axis["rms_um"])
    at = np.arange(len(rms))
    if axis.get("expected_um"):
        axes.bar(at - 0.21, rms, width=0.42, color=NOW, label="now")
        axes.bar(at + 0.21, axis["expected_um"], width=0.42, color=INK, label="at commissioning")
    else:
        axes.bar(at, rms, width=0.84, color=NOW)
    if axis.get("edges"):
        labels = _edges(axis["edges"])
        axes.set_xticks(np.arange(len(labels)) - 0.5, labels)
    else:
        labels = [_drawn(_base(label), 14) for label in axis["bins"]]
        axes.set_xticks(at, labels)
    if sum(map(len, labels)) > LETTERS:
        for label in axes.get_xticklabels():
            label.set(rotation=45, ha="right", rotation_mode="anchor")
    axes.set(xlabel=AXES[name].label, ylabel="residual [µm rms]", xlim=(-0.6, len(rms) - 0.4))
    _legend(axes)
    return figure


def spectrum_figure(axis: Document, after: Axis | None) -> Figure:
    """rms per band of frequency now, at commissioning and with the effects added."""
    figure, axes = _panel(WIDE)
    edges = np.array(axis["edges"])
    curves = [("now", axis["rms_um"], edges, {"color": NOW, "lw": 1.8})]
    if axis.get("expected_um"):
        curves.append(("at commissioning", axis["expected_um"], edges, {"color": INK, "lw": 1.4, "ls": "--"}))
    if after is not None:
        curves.append(("with the effects", after.rms_um, after.edges, {"color": AFTER, "lw": 1.8}))
    for label, rms, bands, look in curves:
        axes.stairs(np.where(np.array(rms) > 0, rms, np.nan), bands, baseline=None, label=label, **look)
    axes.set(xscale="log", yscale="log", xlabel=AXES["frequency_hz"].label, ylabel="residual per band [µm rms]",
             xlim=(edges[edges > 0][0], edges[-1]))
    _legend(axes)
    return figure


def table_figure(table: Table) -> Figure:
    """Heat map; the cells are drawn equally large, with the bins' true edges beside them."""
    from matplotlib import colormaps

    figure, axes = _panel(WIDE)
    rms = table.rms_um.T
    colours = colormaps["cividis"]
    mesh = axes.pcolormesh(np.arange(rms.shape[1] + 1), np.arange(rms.shape[0] + 1), np.ma.masked_invalid(rms),
                           cmap=colours, vmin=0, edgecolors="none")
    if rms.size <= NUMBERED:
        decimals = max(0, 1 - _magnitude(np.nanmax(rms, initial=0.0) / 2))
        for (row, column), value in np.ndenumerate(rms):
            if np.isfinite(value):
                axes.text(column + 0.5, row + 0.5, f"{value:.{decimals}f}", ha="center", va="center", fontsize=6,
                          color="black" if mesh.norm(value) > 0.5 else "white")
    for ticks, edges in ((axes.set_xticks, table.position_um), (axes.set_yticks, table.rate_um_per_s)):
        step = -(-len(edges) // 9)
        ticks(np.arange(len(edges))[::step], _edges(edges)[::step])
    axes.set(xlabel=AXES["position_um"].label, ylabel=AXES["rate_um_per_s"].label)
    figure.colorbar(mesh, ax=axes, label="residual [µm rms]", pad=0.02)
    return figure


def time_figure(run: Recording, before_um: np.ndarray, after_um: np.ndarray | None, noise_um: float | None) -> Figure:
    """The residual over all of a run, and once more where it is worst; means removed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE[0], 1.2 * WIDE[1]), layout="constrained")
    panels = figure.subplots(2, 1)
    time_s = run.time_s - run.time_s[0]
    residuals = [("now", NOW, before_um)] if after_um is None else [("before", NOW, before_um),
                                                                    ("with the effects", AFTER, after_um)]
    length = max(2, min(len(time_s), max(COLUMNS // 2, int(ZOOM * len(time_s)))))
    energy = np.cumsum(np.r_[0.0, (before_um - np.mean(before_um))**2])
    start = int(np.argmax(energy[length:] - energy[:-length]))
    for axes, part in zip(panels, (slice(None), slice(start, start + length))):
        for label, colour, residual in residuals:
            _band(axes, time_s[part], (residual - np.mean(residual))[part], colour, label)
        if noise_um:
            for side in (-1, 1):
                axes.axhline(side * noise_um, color=INK, lw=0.8, ls=":", label="noise, ±1 rms" if side > 0 else None)
        axes.set(ylabel="residual [µm]", xlim=(time_s[part][0], time_s[part][-1]))
    panels[1].set_xlabel(AXES["time_s"].label)
    _legend(panels[0])
    return figure


def runs_figure(runs: Sequence[Document], added: bool) -> Figure:
    """rms of each run before and, with effects `added`, after; the noise floor and the passport's level beside them."""
    shown = runs[:BARS]
    figure, axes = _panel((WIDE[0], 1.1 + 0.3 * len(shown)))
    at = np.arange(len(shown))
    before = np.array([run["rms_um"]["before"] for run in shown])
    marks = [("before" if added else "now", before, {"marker": "o", "color": NOW, "ms": 7})]
    if added:
        after = np.array([np.nan if run["rms_um"].get("after") is None else run["rms_um"]["after"] for run in shown])
        axes.hlines(at, np.fmin(before, after), np.fmax(before, after), color=INK, lw=1)
        marks.append(("with the effects", after, {"marker": "o", "color": AFTER, "ms": 7}))
    noise = np.array([run.get("noise_floor_um") or np.nan for run in shown])
    expected = np.array([before[k] / run["ratio"] if run.get("ratio") else np.nan for k, run in enumerate(shown)])
    marks += [("at commissioning", expected, {"marker": "|", "color": INK, "ms": 13, "mew": 2}),
              ("noise floor", noise, {"marker": "x", "color": INK, "ms": 5})]
    for label, values, look in marks:
        if np.isfinite(values).any():
            axes.plot(values, at, ls="", label=label, zorder=3, **look)
    axes.set_yticks(at, [f"{_drawn(_base(run.get('file')), 22)}  {k}" for k, run in enumerate(shown, 1)])
    axes.set(xlabel="residual [µm rms]", ylim=(len(shown) - 0.4, -0.6))
    axes.set_xlim(left=0)
    axes.grid(axis="x", color=INK, alpha=0.25, lw=0.6)
    axes.set_axisbelow(True)
    _legend(axes)
    return figure


def _panel(size: tuple[float, float]) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots()


def _band(axes: Axes, time_s: np.ndarray, values: np.ndarray, colour: str, label: str) -> None:
    """A curve, or of a long one the span between its extremes in each column of the picture: peaks stay."""
    per_column = len(values) // COLUMNS
    if per_column < 2:
        axes.plot(time_s, values, color=colour, lw=0.9, label=label)
        return
    first = np.arange(0, len(values), per_column)
    axes.fill_between(time_s[first], np.minimum.reduceat(values, first), np.maximum.reduceat(values, first),
                      color=colour, lw=0.4, alpha=0.85, label=label)


def _legend(axes: Axes) -> None:
    """Above the panel, where it covers nothing."""
    count = len(axes.get_legend_handles_labels()[1])
    if count > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=2 if count == 4 else count, fontsize="small",
                    borderaxespad=0.2, columnspacing=1.2, handlelength=1.4)


def _style() -> Any:
    from matplotlib import rc_context

    return rc_context(STYLE)


def _source(figure: Figure) -> str:
    """A picture as the data URI of an SVG; the same bytes for the same picture."""
    data = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # letters the font lacks
        figure.savefig(data, format="svg", metadata={"Date": None, "Creator": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(data.getvalue()).decode()}"


# ---- words and numbers ----


def _about(name: str) -> dict[str, str]:
    """Id, title, what it is, what to do about it and what it needs to be seen."""
    effect = CATALOGUE.get(name)
    what, remedy, needs = ("", "", "") if effect is None else (effect.what, effect.remedy, effect.needs)
    return {"id": _plain(name), "title": _title(name), "what": _sentence(what), "remedy": _sentence(remedy),
            "needs": needs}


def _sentence(text: str) -> str:
    """With a capital and a full stop; "" stays."""
    text = text.strip().rstrip(".")
    return f"{text[0].upper()}{text[1:]}." if text else ""


def _title(name: str) -> str:
    return CATALOGUE[name].title if name in CATALOGUE else _plain(name.replace("_", " "))


def _named(name: str, stage: str = "") -> str:
    """Title with its article: "a signal delay", "creep", "a first-order lag (stage sensor)"."""
    title = _title(name)
    article = "" if name not in COUNTED else "an " if title[0] in "aeiou" else "a "
    return f"{article}{title}{_bracketed(stage)}"


def _phrase(effect: Document, stage: str = "") -> str:
    """An accepted effect with its size: "a signal delay of 0.52 ms (95 % interval 0.48 to 0.56 ms)"."""
    named = _named(effect["name"])
    given = {name: one for name, one in (effect.get("parameters") or {}).items() if _given(one)}
    if len(given) == 1 and not stage and not {"of", "from"} & set(named.split()):
        (name, one), = given.items()
        if _unit(name, one):
            return f"{named} of {_quantity(name, one)}{_bracketed(_interval(name, one))}"
    sizes = [", ".join(filter(None, (f"{_label(name)} {_quantity(name, one)}".strip(), _interval(name, one, False))))
             for name, one in given.items()]
    return f"{named}{_bracketed('; '.join([stage, *sizes] if stage else sizes))}"


def _bracketed(text: str) -> str:
    return f" ({text})" if text else ""


def _given(parameter: Document) -> bool:
    return parameter.get("value") is not None


def _label(name: str) -> str:
    """Of a parameter, without its unit: "time constant" for time_constant_s, "" for V_per_s."""
    if "_per_" in name:
        return ""
    for unit in ("_s", "_um", "_hz"):
        name = name.removesuffix(unit)
    return name if "_" in name and name[0].isupper() else _plain(name.replace("_", " "))


def _unit(name: str, parameter: Document) -> str:
    """As it is written after a number."""
    unit = _plain(parameter.get("unit") or "")
    if unit == "%" and "_per_" in name:
        unit = f"% per {name.partition('_per_')[2].replace('_', ' ')}"
    return "" if unit == "1" else unit.replace("um", "µm").replace("degC", "°C")


def _scale(value: float, unit: str) -> tuple[float, str]:
    """Factor and unit that make a short time readable."""
    if unit != "s" or abs(value) >= 0.1 or value == 0:
        return 1.0, unit
    return (1e3, "ms") if abs(value) >= 1e-4 else (1e6, "µs")


def _quantity(name: str, parameter: Document) -> str:
    """Value and unit, to as many digits as the interval is worth."""
    factor, unit = _scale(parameter["value"], _unit(name, parameter))
    interval = _ends(parameter.get("ci95"))
    if interval:
        return f"{_fixed(factor * parameter['value'], factor * (interval[1] - interval[0]))} {unit}".strip()
    return f"{_number(factor * parameter['value'])} {unit}".strip()


def _interval(name: str, parameter: Document, unit: bool = True) -> str:
    """"95 % interval 0.48 to 0.56 ms", or "95 %: 0.48 to 0.56"; "" without one."""
    interval = _ends(parameter.get("ci95"))
    if not interval:
        return ""
    factor, written = _scale(parameter["value"], _unit(name, parameter))
    low, high = (_fixed(factor * end, factor * (interval[1] - interval[0])) for end in interval)
    return f"95 % interval {low} to {high} {written}".strip() if unit else f"95 %: {low} to {high}"


def _ends(interval: Sequence[float | None] | None) -> tuple[float, float] | None:
    """An interval whose two ends are known and differ."""
    return (interval[0], interval[1]) if interval and None not in interval and interval[1] > interval[0] else None


def _fixed(value: float, width: float) -> str:
    """`value` to two digits of half the width of its interval."""
    return _number(value, max(1, 2 + _magnitude(value) - _magnitude(width / 2)), strip=False)


def _magnitude(value: float) -> int:
    return math.floor(math.log10(abs(value))) if value else 0


def _number(value: float | None, digits: int = 3, strip: bool = True) -> str:
    """To so many significant digits, all digits before the point; "–" for None."""
    if value is None:
        return "–"
    magnitude = _magnitude(value)
    if not -5 < magnitude < 7:
        text = f"{value:.{max(0, digits - 1)}e}"
    else:
        text = f"{value:.{max(0, digits - 1 - magnitude)}f}"
        text = text.rstrip("0").rstrip(".") if strip and "." in text else text
    return text.replace("-", "−") if float(text) else text.replace("-", "")


def _um(value: float | None) -> str:
    """A length in µm, or nm when it is very small; "–" for None."""
    if value is None:
        return "–"
    return f"{_number(1e3 * value)} nm" if 0 < abs(value) < 1e-3 else f"{_number(value)} µm"


def _percent(share: float | None) -> str:
    """0.074 as "7 %"."""
    return "–" if share is None else f"{_whole(100 * share)} %"


def _percents(interval: Sequence[float | None] | None) -> str:
    """(0.7, 0.8) as "70 to 80 %"."""
    if not interval or None in interval:
        return "–"
    return f"{_whole(100 * interval[0])} to {_whole(100 * interval[1])} %"


def _whole(value: float) -> str:
    return f"{round(value)}".replace("-", "−")


def _change(before: float, after: float, word: str) -> str:
    """"0.412 to 0.100 µm rms": to the same number of decimals."""
    width = max(abs(before), abs(after))
    digits = [max(1, 3 + _magnitude(value) - _magnitude(width)) for value in (before, after)]
    return f"{_number(before, digits[0], strip=False)} {word} {_number(after, digits[1], strip=False)} µm rms"


def _times(ratio: float) -> str:
    return "as much as" if abs(ratio - 1) <= SAME else f"{_number(ratio, 2)} times what"


def _listed(items: Sequence[str], conjunction: str = "and") -> str:
    """"a", "a and b", "a, b and c"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {conjunction} {items[-1]}"


def _bins(axis: Document) -> list[str]:
    """Names of an axis's bins."""
    if axis.get("edges"):
        edges = _edges(axis["edges"])
        return [f"{low} to {high}" for low, high in zip(edges[:-1], edges[1:])]
    return ["at rest" if label == "rest" else _plain(_base(label)) for label in axis["bins"]]


def _edges(edges: Sequence[float]) -> list[str]:
    """Edges of bins to two digits, or to up to four if that tells them apart; what is nothing beside every bin is 0."""
    nothing = 0.01 * float(np.min(np.diff(edges)))
    for digits in (2, 3, 4):
        texts = [_number(0.0 if abs(edge) < nothing else edge, digits) for edge in edges]
        if len(set(texts)) == len(texts):
            break
    return texts


def _text(value: Any) -> str:
    return _number(value) if isinstance(value, (int, float)) else _plain(str(value))


def _base(path: Any) -> str:
    return os.path.basename(str(path or ""))


def _plain(text: str, longest: int = 80) -> str:
    """Foreign text made fit to be read: printable, on one line, its middle left out when it is long."""
    text = "".join(letter if letter.isprintable() else " " if letter.isspace() else "?" for letter in text)
    return text if len(text) <= longest else f"{text[:longest // 2]}…{text[-(longest - longest // 2 - 1):]}"


def _drawn(text: str, longest: int) -> str:
    """The same for a picture: no mathematics."""
    return _plain(text, longest).replace("$", r"\$")
