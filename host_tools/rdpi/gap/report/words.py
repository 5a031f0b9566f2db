"""What `rdpi gap` found, in sentences: every text of its report that is more than a row of a table.

All of it says what the document of `rdpi gap --json` says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...identify import FITTED
from ...identify.report import (SAME, bin_names, bracketed, change, drawing, given, interval, listed, moved, number, percent,
                           plain, quantity, sentence_of, shrinks, sized, times, um, unit_of)
from ...simulate.effects import CATALOGUE, PARAMETERS
from .. import thresholds
from ..sections import AcceptedEffect, CandidateEntry, GapDocument, NextExperiment, PassportFigures

NOTICED = 0.005  # shrink: less is 0 %
TWO_SIGMA = 2.0  # standard deviations: within them, a ratio may be chance
EXPLAINED = 0.9  # of the energy, from where on an effect explains the gap, and not most of it
MOST = 0.6  # likewise, from where on most of it: its rms falls by more than a third


class Terms(NamedTuple):
    """What the gap is called, and what it is compared with."""

    heading: str
    gap: str
    left: str  # what it is in one recording
    opening: str  # followed by its size
    usual: str  # what the passport expects, after "as much as" or "3 times what"
    usual_there: str  # ... in one place
    as_usual: str  # a sentence where the gap is no larger, and an effect was found all the same
    usually: str  # the same in a legend and a tile
    ratio: str  # to it, in the head of a column
    nothing_beyond: str
    known: str  # what makes the passport's expectation
    sharper: str  # a sentence on what tells more; ""
    unjudged: str  # a sentence where there is no passport


GAP = Terms(
    heading="Sim-to-real gap", gap="gap", left="residual", opening="The gap is",
    usual="the model missed at commissioning",
    usual_there="the model missed there at commissioning", as_usual="The model missed as much at commissioning.",
    usually="at commissioning", ratio="ratio to commissioning",
    nothing_beyond="the model's own error and the sensor's noise", known="what it missed then",
    sharper="Play a drive of commissioning again and give the recording of that time with --earlier: this tells more.",
    unjudged="The model has no passport, so it is not known how much of this it missed at commissioning.")
CHANGE = Terms(
    heading="Change since the earlier recordings", gap="change", left="change",
    opening="The change since these drives were first recorded is",
    usual="two recordings of the same drive may differ by",
    usual_there="two recordings of the same drive may differ by there",
    as_usual="Two recordings of the same drive may differ by as much.", usually="may differ anyway",
    ratio="ratio to usual", nothing_beyond="that", known="how much they may differ", sharper="",
    unjudged="The model has no passport, so it is not known how much two recordings of the same drive may differ.")


def terms(document: GapDocument) -> Terms:
    """CHANGE where every recording is compared with an earlier one of the same drive."""
    return CHANGE if document.paired else GAP


class AxisWords(NamedTuple):
    """What an axis is called."""

    title: str
    label: str  # of a picture's axis
    place: str  # of one bin of it


AXES = {
    "time_s": AxisWords("time", drawing.LABELS["time_s"], "{} s after the start"),
    "frequency_hz": AxisWords("frequency", drawing.LABELS["frequency_hz"], "at {} Hz"),
    "rate_um_per_s": AxisWords("rate", drawing.LABELS["rate_um_per_s"], "at rates of {} µm/s"),
    "position_um": AxisWords("position", drawing.LABELS["position_um"], "at positions of {} µm"),
    "direction": AxisWords("direction", "direction", "while {}"),
    "since_reversal_s": AxisWords("time since reversal", "time since reversal [s]",
                                  "{} s after the command turned round"),
    "amplitude_um": AxisWords("size of the loop", "size of the loop [µm]", "in loops of {} µm"),
    "recording": AxisWords("recording", "recording", "in {}"),
}


# ---- effects ----


def title(name: str) -> str:
    """Of an effect, in plain words."""
    return CATALOGUE[name].title


def about(name: str) -> dict[str, str]:
    """Id, title, what it is, and what to do about it on the bench."""
    effect = CATALOGUE[name]
    remedy = " ".join(filter(None, (sentence_of(effect.remedy), effect.look)))
    return {"id": name, "title": effect.title, "what": sentence_of(effect.what), "remedy": remedy}


def named(name: str) -> str:
    """Title with its article: "a signal delay", "creep"."""
    return f"{CATALOGUE[name].article} {title(name)}".strip()


def change_of(name: str) -> str:
    """The same of one that the model holds already: "a change of the signal delay", "a change of creep"."""
    return f"a change of {'the ' if CATALOGUE[name].article else ''}{title(name)}"


def rival(document: GapDocument, name: str) -> str:
    """What an accepted effect cannot be told from."""
    held = any(one.name == name and one.was is not None for one in document.candidates)
    return change_of(name) if held else named(name)


def phrase(effect: AcceptedEffect) -> str:
    """An accepted effect with its size: "a signal delay of 0.52 ms (95 % interval 0.48 to 0.56 ms)", "a change of the
    signal delay from 1.0 ms to 1.5 ms".
    """
    was, sizes = effect.was, given(effect.parameters)
    text = named(effect.name) if was is None else change_of(effect.name)
    if len(sizes) == 1 and not {"of", "from"} & set(title(effect.name).split()):
        (name, one), = sizes.items()
        if unit_of(name, one):
            size = f"{PARAMETERS[name].joined} {quantity(name, one)}" if was is None else moved(name, was, one)
            return f"{text} {size}{bracketed(interval(name, one))}"
    return text + bracketed("; ".join(
        ", ".join(filter(None, (sized(name, one, was), interval(name, one, False))))
        for name, one in sizes.items()))


def tried(document: GapDocument) -> list[CandidateEntry]:
    """Candidates that the recordings could show."""
    return [one for one in document.candidates if one.excited]


def rivals(document: GapDocument) -> set[str]:
    """Names of what accepted effects cannot be told from."""
    return {name for effect in document.effects for name in effect.confusable_with}


def reading_step_um(effect: AcceptedEffect) -> float:
    """Step of the grid that an accepted effect puts readings on; 0: none."""
    values = {name: one.value for name, one in effect.parameters.items()}
    return CATALOGUE[effect.name](effect.stage).reading_step_um(values)


class Grid(NamedTuple):
    """What the sensor's grid adds to the residual, in um rms."""

    own_um: float
    whole_um: float  # the gap, or what is left of it where other effects were accepted too
    finer_um: float  # the same with a finer converter
    alone: bool


def grid(document: GapDocument) -> Grid | None:
    """Of an accepted effect that rounds readings: their errors lie evenly over a step, which is step / √12 rms."""
    effects, gap = document.effects, document.gap
    steps = [step for step in map(reading_step_um, effects) if step > 0]
    if not steps:
        return None
    alone = len(effects) == 1
    whole = gap.rms_um if alone else gap.remaining_um
    own = min(steps[0] / math.sqrt(12), whole)
    least = min(expected_um(document), whole)  # a converter mends nothing else
    return Grid(own, whole, max(math.sqrt(whole**2 - own**2), least), alone)


def expected_um(document: GapDocument) -> float:
    """rms of the gap that the passport expects; 0: there is no passport."""
    return document.passport.rms_um if document.passport else 0.0


def rounding(document: GapDocument) -> str:
    """What a sensor's grid adds, which no prediction promises to take away; "" without one."""
    found = grid(document)
    if found is None:
        return ""
    whole = f"the {terms(document).gap}" if found.alone else "what is left"
    return (f"The grid's own rounding makes up {um(found.own_um)} rms of {whole}; no better model removes it. A finer "
            f"converter would reduce {whole} from {change(found.whole_um, found.finer_um, 'to')}.")


# ---- the verdict ----


def sentence(document: GapDocument) -> str:
    """The verdict with numbers and units."""
    gap, passport, words = document.gap, document.passport, terms(document)
    runs = len(document.runs)
    text = (f"{words.opening} {um(gap.rms_um)} rms ({number(gap.percent_of_stroke, 2)} % of the stroke) "
            f"{'in one recording' if runs == 1 else f'over {runs} recordings'}")
    small = passport and document.effects and passport.ratio <= 1 + SAME
    if small:
        text += f". {words.as_usual} So the size says nothing, but the shape does"
    elif passport:
        text += f", {times(passport.ratio)} {words.usual}"
    zero = document.offset_um
    apart = ""
    if zero.moved:
        apart = f"The zero lies {um(zero.mean)} off{' since then' if document.paired else ''}; this is not counted."
    elif abs(zero.mean) > gap.rms_um:
        apart = (f"In the mean the recordings lie {um(zero.mean)} off, more than the {words.gap}. This is not counted: creep "
                 "from before, the room, or a gain about another place may move a zero so far.")
    say = {"effect": _explained, "ambiguous": _explained, "none": _nothing, "unknown": _unexplained}
    return " ".join(filter(None, (f"{text}.", say[document.verdict](document), apart,
                                  "" if passport else words.unjudged)))


def _explained(document: GapDocument) -> str:
    """What explains the gap, how well, and whether it is sure."""
    effects, coarse = document.effects, grid(document)
    causes = [_cause(document, effect) for effect in effects]
    several = len(causes) > 1
    before, after = held_out(document)
    text = listed(causes) + (" explain " if several else " explains ")
    if coarse and coarse.alone:
        text += _how_much(document, coarse.whole_um, coarse.finer_um)
    else:
        they = "they were" if several or effects[0].confusable_with else "it was"
        text += (f"{_how_much(document, before, after)}. On {unseen_parts(document)} {they} not fitted to, the "
                 f"{terms(document).left} {'falls' if after < before else 'goes'} from {change(before, after, 'to')}")
    lines = [sentence_of(text), rounding(document)]
    if document.verdict == "ambiguous":
        lines.append(f"{'This recording' if len(document.runs) == 1 else 'These recordings'} cannot tell which "
                     "it is.")
    return " ".join(filter(None, lines))


def _cause(document: GapDocument, effect: AcceptedEffect) -> str:
    """An accepted effect, or it and its rivals: "either a signal delay of 0.52 ms or a first-order lag"."""
    others = [rival(document, name) for name in effect.confusable_with]
    return f"either {listed([phrase(effect), *others], 'or')}" if others else phrase(effect)


def cannot_tell(document: GapDocument) -> bool:
    """Whether nothing is named because too little is known of what is usual."""
    passport = document.passport
    return document.verdict == "none" and (too_little(document) or passport is None or _doubtful(passport))


def _doubtful(passport: PassportFigures) -> bool:
    """Whether the gap is larger than usual ones, and not clearly."""
    return passport.ratio > max(1 + SAME, math.exp(TWO_SIGMA * passport.spread))


def too_little(document: GapDocument) -> bool:
    """Whether nothing is new as far as recordings tell that move too little to tell much."""
    return document.verdict == "none" and any(one.axis == "movement_um" and one.share > thresholds.MOSTLY
                                              for one in document.not_known_from_commissioning)


def _nothing(document: GapDocument) -> str:
    passport = document.passport
    if too_little(document):
        return ("These recordings move less than any of commissioning. What the model misses of such movements is not known, "
                "so that they cannot tell whether something has changed.")
    if passport is None:
        return "Whether any of it is new cannot be told."
    if _doubtful(passport):
        return " ".join(filter(None, ("This is more than usual, but single recordings differ by nearly as much.",
                                      terms(document).sharper)))
    if passport.ratio > 1 + SAME:
        factor = number(math.exp(TWO_SIGMA * passport.spread), 2)
        return " ".join(filter(None, (f"This is not clearly more: {terms(document).known} is known to a factor of {factor} "
                                      "only.", terms(document).sharper)))
    return f"Nothing goes beyond {terms(document).nothing_beyond}."


def _unexplained(document: GapDocument) -> str:
    if document.sticks:
        return (f"At least {percent(document.stuck)} of its energy lies where readings stand still while the actuator should "
                "move, and then catch up in a jump. No effect does that: the stage or its mount sticks and slips, or samples are "
                "lost. Mend this first, or cut it out (rdpi import --rows), and ask again.")
    lines = [f"{_none_tried(document)} explains it."]
    best = max(tried(document), key=lambda one: one.shrink, default=None)
    if best is not None and best.shrink >= NOTICED:
        lines.append(f"The best of them, {title(best.name)}, would shrink it by {percent(best.shrink)}.")
    return " ".join(filter(None, (*lines, place(document))))


def _none_tried(document: GapDocument) -> str:
    count = len(tried(document))
    return f"None of the {count} effects tried" if count > 1 else "No effect that was tried"


def _how_much(document: GapDocument, before: float, after: float) -> str:
    """Of the gap: it, most of it, a part of it."""
    expected = expected_um(document)
    explained = 1 - (after / before)**2 if before > 0 else 0.0
    if explained >= EXPLAINED or (explained > 0 and after <= (1 + SAME) * expected):
        return "it"
    return "most of it" if explained >= MOST else "a part of it"


def held_out(document: GapDocument) -> tuple[float, float]:
    """rms in um before the first effect and with the last one, on recordings not fitted to."""
    effects = document.effects
    return effects[0].held_out_rms_um.before, effects[-1].held_out_rms_um.after


def unseen_parts(document: GapDocument) -> str:
    """What effects are judged on."""
    return "blocks of the recording" if len(document.runs) == 1 else "recordings"


def promise(document: GapDocument) -> str:
    """What adding the effects to the model promises on recordings to come; "" where they can promise nothing."""
    promised, coarse = document.promised, grid(document)
    if promised.shrink is None or coarse and coarse.alone:
        return ""
    if promised.shrink < NOTICED:
        return "Adding this to the model should not shrink the residual on new recordings."
    share = percent(promised.shrink)
    sure = f" (90 % interval {shrinks(promised.ci90)})" if promised.ci90 else ""
    text = f"Adding this to the model should shrink the residual by {share} on new recordings{sure}"
    if whole := document.gap.whole_um:
        text = (f"Adding this to the model should remove {share}{sure} of the change on new recordings. What the "
                "model always missed remains. In all, the residual of these recordings goes from "
                f"{change(whole.before, whole.after, 'to')}")
    text = f"{text}." if sure else f"{text}; no interval can be given: {promised.why_no_interval}."
    if tracking := promised.tracking:
        sure = f" (90 % interval {shrinks(tracking.ci90)})" if tracking.ci90 else ""
        text += (f" Compensated by the firmware, it should {'shrink' if tracking.shrink >= 0 else 'increase'} the "
                 f"tracking error by {percent(abs(tracking.shrink))}{sure}.")
    return text


# ---- where, why, how far ----


def place(document: GapDocument) -> str:
    """Where on the dominant axis the gap lies: "62 % of the energy lies at 40 to 80 Hz."; "" where it is nowhere."""
    name = document.where.dominant
    axis = document.where.axes[name]
    if not any(axis.share):
        return ""
    worst = int(np.argmax(axis.share))
    text = f"{percent(axis.share[worst])} of the energy lies {AXES[name].place.format(bin_names(axis)[worst])}"
    ratio = axis.ratio and axis.ratio[worst]
    told = ratio and not (document.effects and ratio <= 1 + SAME)  # an effect is found by its shape too
    return f"{text}, {times(ratio)} {terms(document).usual_there}." if told else f"{text}."


def where(document: GapDocument) -> list[str]:
    """Sentences on the dominant axis, the stage and the arithmetic."""
    found, gap = document.where, terms(document).gap
    lines = []
    if spot := place(document):
        lines.append(f"The {gap} depends most on the {AXES[found.dominant].title}: {spot}")
    lines.append(f"Stage of the chain: {found.stage}.")
    if stages := found.stages:
        lines.append(f"The recorded monitor_V splits the {gap}'s energy: {percent(stages.before_monitor)} arises "
                     "before the tap (numerics, DAC, timing, amplifier), "
                     f"{percent(stages.after_monitor)} after it (actuator, mechanics, environment, sensor).")
    engines = document.numerics.rms_um if document.numerics else {}
    sizes = {name: size for name, size in engines.items() if size is not None}
    if sizes:
        share = max(sizes.values()) / (document.gap.rms_um or math.inf)
        lines.append(f"The firmware's arithmetic ({listed(list(sizes), 'or')}) is not the cause: it adds less than 1 % "
                     f"of the {gap}." if share < 0.01 else
                     "The firmware's arithmetic differs from exact numbers by "
                     f"{listed([f'{um(size)} rms ({name})' for name, size in sizes.items()])}: up to {percent(share)} "
                     f"of the {gap}.")
    return lines


def why(document: GapDocument) -> list[str]:
    """Why these effects: what they gain, the best of the others, and what refitting the model alone gains."""
    lines, verdict, several, coarse = [], document.verdict, len(document.effects) > 1, grid(document)
    if verdict == "ambiguous":
        lines.append("Several effects explain these recordings equally well; to take one of them for the cause would "
                     "be a guess.")
    elif coarse and coarse.alone:
        lines.append(f"{len(tried(document))} effects were tried. This one is read from the recorded values.")
    elif verdict == "effect":
        lines.append(f"{len(tried(document))} effects were tried. {'These hold' if several else 'This one holds'} on "
                     f"{unseen_parts(document)} {'they were' if several else 'it was'} not fitted to.")
    elif too_little(document):
        lines.append("No effect is named: movements so small may be missed by as much.")
    elif verdict == "none":
        lines.append("No effect is named: it is not known well enough what is usual." if cannot_tell(document) else
                     "No effect is needed: what is left is not clearly more than was to be expected.")
    else:
        lines.append("Either the cause is not among the effects that rdpi knows, or these recordings do not contain "
                     "what would show it.")
    open_ = {effect.name for effect in document.effects} | rivals(document)
    best = max((one for one in tried(document) if one.name not in open_), key=lambda one: one.shrink,
               default=None)
    if document.effects and best is not None and best.shrink >= NOTICED:
        lines.append(f"The best of those rejected, {title(best.name)}, would shrink the residual by "
                     f"{percent(best.shrink)}: {best.rejected_because}.")
    refit = document.refit.shrink
    lines.append("Fitting the model again to these recordings, without any effect, would "
                 + (f"shrink the residual by {percent(refit)}." if refit >= NOTICED else "not help."))
    return lines


def far(document: GapDocument) -> list[str]:
    """What adding the effects gains over all recordings."""
    words = terms(document)
    if not document.effects:
        return [f"No effect was added, so the {words.gap} of each recording is unchanged."]
    before, after = held_out(document)
    text = (f"On {unseen_parts(document)} not used to fit or to select, the {words.left} is {um(before)} rms without "
            f"and {um(after)} rms with the effects")
    if coarse := rounding(document):
        return [f"{text}.", coarse]
    return [f"{text}; the sensor's noise alone is {um(document.gap.noise_floor_um)} rms."]


# ---- what could not be seen, what to record ----


def limits(document: GapDocument) -> list[str]:
    """What limits what can be said, besides effects not excited."""
    passport, lines = document.passport, []
    if passport and passport.held_out == FITTED and not document.paired:
        lines.append("The passport comes from the recordings that the model was fitted to. This makes the gap look "
                     "larger than it is. Fit with two or more recordings, or with --hold-out.")
    if document.where.stages is None:
        lines.append("Not every recording has a column monitor_V (the amplifier's output as measured). Only the effect "
                     "itself can then tell amplifier and sensor apart.")
    return [*lines, *notes(document)]


def notes(document: GapDocument) -> list[str]:
    """Remarks of the diagnosis."""
    return [plain(note, 500) for note in document.notes]


def next_experiment(document: GapDocument) -> NextExperiment | None:
    """The command that makes the drive to record, and why; None where none is proposed."""
    experiment = document.next_experiment
    if not experiment:
        return None
    why, seconds = sentence_of(experiment.why), experiment.seconds
    return replace(experiment, why=why if seconds is None else f"{why} The drive takes {number(seconds)} s.")


def resemblances(names: Sequence[str], r2: Sequence[Sequence[float | None]], alike: float, most: int) -> str:
    """The pairs of effects of the matrix that look alike, `most` of them named."""
    found = sorted(((value, f"{names[column]} reproduces {percent(value)} of {names[row]}")
                    for row, values in enumerate(r2) for column, value in enumerate(values)
                    if row != column and value is not None and value >= alike), reverse=True)
    if not found:
        return f"In these recordings no effect reproduces {percent(alike)} or more of another."
    more = len(found) - most
    told = [text for _, text in found[:most]] + ([f"{more} more, in bold below"] if more > 0 else [])
    return f"Nearly the same in these recordings: {listed(told)}."
