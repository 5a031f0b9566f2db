"""The report of `rdpi gap`: one page that a person reads from top to bottom, its twin in JSON, the terminal's text."""

from __future__ import annotations

import json
import os
import textwrap
from pathlib import Path
from typing import Any

from ...data import atomic_write, make_folder
from ...identify.report import (NONE, base, bracketed, change, environment, given, interval, listed, number, percent, plain,
                           shrink, shrinks, sized, tight, um)
from ..sections import AcceptedEffect, CandidateEntry, GapDocument
from . import pictures as draw, words
from .pictures import Pictures
from .words import about, grid, terms

PAGE = "index.html"
TWIN = "gap.json"

VERDICTS = {"effect": "effect found", "ambiguous": "not decided yet", "none": "nothing new",
            "unknown": "no known effect"}
CANNOT_TELL = "cannot tell"  # in the place of "nothing new"
NOTHING_TO_RECORD = {
    **dict.fromkeys(("effect", "none"), "No question is open that another recording would settle."),
    "ambiguous": "None of the drives that rdpi excite makes would tell these effects apart. A column monitor_V (the "
                 "amplifier's output as measured) or a second sensor may.",
    "unknown": "No drive is proposed, because it is not known what to look for. More columns beside the displacement "
               "may show the cause: monitor_V, temperature_degC, the drives of other axes.",
}
MEND = "No drive is proposed: what stands still is to be mended first."
ALIKE, PAIRS = 0.9, 6  # R² from which on an effect is said to look like another, and how many pairs are told
SHADE = 0.7  # opacity of a cell of the matrix at R² = 1: its number can still be read

LITTLE = 0.05  # shrink: what gains less is told in one line of the terminal, and without its size
WIDTH = 80  # of the terminal's lines, commands apart
TERMINAL = str.maketrans({"\N{NO-BREAK SPACE}": " ", "µ": "u", "−": "-", "–": "-", "…": "...", "°": "deg"})

TEMPLATES = environment(__package__)


def write(document: GapDocument, pictures: Pictures, folder: str | os.PathLike[str]) -> None:
    """Write `index.html`, which loads nothing from elsewhere, and `gap.json` into `folder`, which is made.

    Both are written atomically. Raises OSError when they cannot be, ValueError for numbers that are not finite.
    """
    twin = json.dumps(document.to_json(), indent=2, allow_nan=False) + "\n"
    text = page(document, pictures)
    make_folder(folder)
    atomic_write(Path(folder) / TWIN, twin)
    atomic_write(Path(folder) / PAGE, text)


def page(document: GapDocument, pictures: Pictures) -> str:
    """The page's text; the same for the same document and pictures."""
    verdict = document.verdict
    badge, tone = (CANNOT_TELL, "ambiguous") if words.cannot_tell(document) else (VERDICTS[verdict], verdict)
    return TEMPLATES.get_template("gap.html.j2").render(
        terms=terms(document), paired=document.paired, badge=badge, tone=tone,
        sentence=words.sentence(document), promise=words.promise(document), tiles=_tiles(document),
        where=words.where(document), figures=draw.where(document, pictures), why=words.why(document),
        which=_which(document), candidates=_candidates(document), matrix=_matrix(document),
        far=words.far(document), runs=_runs(document), with_ratio=document.passport is not None,
        runs_figure=draw.recordings(document), hidden=_hidden(document), left_out=_left_out(document),
        limits=words.limits(document), next_experiment=words.next_experiment(document),
        no_experiment=MEND if document.sticks else NOTHING_TO_RECORD[verdict], facts=_facts(document),
        provenance=_provenance(document), twin=TWIN)


# ---- the terminal ----


def tables(document: GapDocument) -> str:
    """For the terminal: the verdict, where the gap lies, the candidates, what is hidden, what to record next.

    Of letters beyond ASCII only those that came from files, as with the other commands.
    """
    lines = [_wrapped(text) for text in (words.sentence(document), words.promise(document)) if text]
    lines.append(f"verdict: {document.verdict}")
    if document.effects:
        lines += [_wrapped(f"where: {spot}", "  ") for spot in [words.place(document)] if spot]
        lines.append(f"stage of the chain: {document.where.stage}")
    lines += _rows(document)
    remarks = [*(f"not visible in these recordings: {one['id']} (needs {one['needs']})"
                 for one in _hidden(document)),
               *(f"not tried: {one}" for one in _left_out(document)),
               *(f"note: {note}" for note in words.notes(document))]
    lines += [_wrapped(line, "  ") for line in remarks]
    experiment = words.next_experiment(document)
    if experiment:
        lines += [f"record next: {experiment.command}", _wrapped(f"  {experiment.why}", "  ")]
    return "\n".join(lines).translate(TERMINAL)


def _rows(document: GapDocument) -> list[str]:
    """The candidates that were accepted, are as good or gain much, and a line for the others."""
    candidates, lines = _candidates(document), []
    rows = [row for row in candidates if not row["little"]]
    others = [row["id"] for row in candidates if row["little"]]
    if rows:
        heads = {"id": "effect", "shrink": "shrink", "refitted": "refitted", "verdict": ""}
        table = [heads, *rows]
        widths = {name: max(len(row[name]) for row in table) for name in heads}
        hang = " " * (2 + sum(widths[name] + 2 for name in ("id", "shrink", "refitted")))
        lines += [_wrapped(f"  {row['id']:{widths['id']}}  {row['shrink']:>{widths['shrink']}}  "
                           f"{row['refitted']:>{widths['refitted']}}  {row['verdict']}".rstrip(), hang)
                  for row in table]
        lines.append(_wrapped(f"  shrink: of the residual's rms, on {words.unseen_parts(document)} not fitted to; "
                              "refitted: what it adds to fitting the model itself again", "  "))
    if others:
        lines.append(_wrapped(f"  {'less' if rows else 'shrink it by less'} than {percent(LITTLE)}: "
                              f"{', '.join(others)}", "  "))
    return lines


def _wrapped(line: str, indent: str = "") -> str:
    return textwrap.fill(tight(line), WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


# ---- what the page shows ----


def _tiles(document: GapDocument) -> list[dict[str, str]]:
    """The key figures."""
    gap, passport, coarse = document.gap, document.passport, grid(document)
    tiles = [(terms(document).gap, um(gap.rms_um), f"{number(gap.percent_of_stroke, 2)} % of the stroke")]
    if passport:
        tiles.append((terms(document).usually, um(passport.rms_um), f"ratio {number(passport.ratio, 2)}"))
    tiles.append(("noise floor", um(gap.noise_floor_um), "of the sensor"))
    if coarse and coarse.alone:
        tiles.append(("with a finer converter", um(coarse.finer_um), f"the grid's own {um(coarse.own_um)}"))
    elif document.effects:
        tiles.append(("with the effects added", um(gap.remaining_um), f"on these recordings; explained {um(gap.explained_um)}"))
    return [{"name": name, "value": value, "remark": remark} for name, value, remark in tiles]


def _which(document: GapDocument) -> list[dict[str, Any]]:
    """The accepted effects and what they cannot be told from, for a card each."""
    cards, coarse = [], grid(document)
    for k, effect in enumerate(document.effects):
        scores, rivals = effect.held_out_rms_um, effect.confusable_with
        facts = _sizes(effect)
        if coarse and words.reading_step_um(effect) > 0:
            facts.append(f"its rounding: step / √12 = {um(coarse.own_um)} rms")
        facts += [f"residual, held out: {change(scores.before, scores.after, '→')}",
                  f"shrink {shrink(effect.shrink)}"
                  + (f" (95 % interval {shrinks(effect.shrink_ci95)})" if effect.shrink_ci95 else "")]
        if rivals:
            facts.append(f"cannot be told from {listed([words.rival(document, name) for name in rivals], 'or')}")
        cards.append({**about(effect.name), "stage": effect.stage, "facts": facts, "rival": False})
        cards += [{**about(name), "stage": "", "facts": [] if k else _in_its_place(document, name), "rival": True}
                  for name in rivals]
    return cards


def _in_its_place(document: GapDocument, name: str) -> list[str]:
    """What a rival of the first effect would be, and bring. Of others it is known alone, and not beside the first."""
    one = next((one for one in words.tried(document) if one.name == name), None)
    return [] if one is None else [*_sizes(one), f"shrink {shrink(one.shrink)} in its place"]


def _sizes(effect: AcceptedEffect | CandidateEntry) -> list[str]:
    return [f"{sized(name, one, effect.was)}{bracketed(interval(name, one))}"
            for name, one in given(effect.parameters).items()]


def _candidates(document: GapDocument) -> list[dict[str, Any]]:
    """Rows of the table of what was tried: accepted, as good, then by shrink."""
    effects = document.effects
    order = [effect.name for effect in effects]
    rivals = {name: rank for rank, effect in reversed([*enumerate(effects)]) for name in effect.confusable_with}
    found = []
    for one in words.tried(document):
        name, refitted, best, shown, alone = one.name, one.refitted_shrink, one.shrink, one, False
        if name in order:
            rank, kind, own = order.index(name), "accepted", effects[order.index(name)]
            verdict = "explains these recordings best" if own.confusable_with else "accepted"
            if rank:  # judged beside those that were accepted before it
                shown, refitted = own, None
                verdict += f", beside {listed(order[:rank])}"
            if words.reading_step_um(own) > 0:
                verdict += ": read off the values"
        elif name in rivals:
            rank, kind, verdict = len(order), "rival", "explains these recordings as well"
            if beside := order[:rivals[name]]:  # its figures are what it brings alone, which says nothing of that
                alone, refitted = True, None
                verdict += f", beside {listed(beside)}"
        else:
            rank, kind, verdict = len(order) + 1, "rejected", one.rejected_because
        little = kind == "rejected" and max(best, refitted) < LITTLE
        sizes = {} if little or alone else given(shown.parameters)
        row = {"id": name, "title": words.title(name), "stage": shown.stage,
               "size": "; ".join(sized(*item, shown.was) for item in sizes.items()) or NONE,
               "shrink": NONE if alone else shrink(shown.shrink),
               "interval": NONE if alone else shrinks(shown.shrink_ci95),
               "refitted": NONE if refitted is None else shrink(refitted), "verdict": verdict, "kind": kind,
               "little": little}
        found.append((rank, -best, row))
    return [row for *_, row in sorted(found, key=lambda entry: entry[:2])]


def _matrix(document: GapDocument) -> dict[str, Any] | None:
    """Rows of R² with their names, and in words the pairs that are alike; None without a matrix of two or more."""
    names, r2 = document.matrix.names, document.matrix.r2
    if len(names) < 2:
        return None
    rows = [{"name": names[row], "cells": [
        {"text": NONE if value is None else f"{value:.2f}", "shade": round(SHADE * min(max(value or 0.0, 0.0), 1.0), 3),
         "alike": row != column and value is not None and value >= ALIKE} for column, value in enumerate(values)]}
        for row, values in enumerate(r2)]
    return {"names": names, "rows": rows, "summary": words.resemblances(names, r2, ALIKE, PAIRS)}


def _runs(document: GapDocument) -> list[dict[str, str]]:
    """Rows of the table of recordings, the largest share first."""
    return [{"number": str(k), "file": plain(base(run.file), 60), "share": percent(run.share),
             "before": um(run.rms_um.before), "after": um(run.rms_um.after),
             "noise": um(run.noise_floor_um), "stroke": f"{number(run.percent_of_stroke, 2)} %",
             "ratio": number(run.ratio, 2), "offset": um(run.offset_um)}
            for k, run in enumerate(draw.ranked(document), 1)]


def _hidden(document: GapDocument) -> list[dict[str, str]]:
    """Effects that these recordings could not show."""
    return [{**about(one.name), "needs": one.needs} for one in document.not_excited]


def _left_out(document: GapDocument) -> list[str]:
    """Effects that nobody looked for, and why."""
    hidden = {one.name for one in document.not_excited}
    return [f"{one.name} ({one.rejected_because})" for one in document.candidates
            if not one.excited and one.name not in hidden]


def _facts(document: GapDocument) -> list[tuple[str, str]]:
    """Where all this comes from."""
    passport = document.passport
    facts = [("model", plain(document.model or NONE, 200)), ("model's digest", document.model_digest or NONE),
             ("tool", document.tool)]
    if passport:
        facts.append(("the passport's recordings", passport.held_out))
    return [*facts, ("detection score", f"{number(document.detection)} (larger: more certain that something is new)")]


def _provenance(document: GapDocument) -> list[dict[str, str]]:
    """Rows of the table of the recordings as read."""
    return [{"file": plain(run.file, 200), "earlier": plain(run.earlier or "", 200), "digest": run.digest,
             "samples": f"{run.samples:,}".replace(",", " ")} for run in document.runs]
