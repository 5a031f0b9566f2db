"""The report of `rdpi gap`: it says what the document says, reads well for every verdict, and loads nothing."""

from __future__ import annotations

import base64
import copy
import json
import re
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from unittest.mock import patch
from xml.etree import ElementTree

import numpy as np
import pytest
from injected import LATER, commissioned, drives, entry, plain_model, recorded
from matplotlib.figure import Figure
from pages import without_scripts
from plants import changed

from rdpi.data import Recording, sample_times
from rdpi.identify.localise import DIRECTIONS, Axis, Table
from rdpi.gap import diagnose
from rdpi.identify.report import drawing, numbers
from rdpi.gap.report import page as gap_report, pictures as gap_pictures, words as gap_words
from rdpi.gap.report.pictures import Pictures
from rdpi.gap.sections import GapDocument
from rdpi.simulate.effects import CATALOGUE

RATE_HZ = 5000.0
NBSP = "\N{NO-BREAK SPACE}"
NAMES = "sawtooth.csv", "steps.csv", "multisine_small.csv", "multisine_large.csv"
NOISE_UM = 0.012
USUAL = gap_words.GAP.usually
VERDICTS = "effect", "ambiguous", "none", "unknown"
NASTY = ('<script>alert("x")</script>', "a & b ' \" c", "$\\frac{$ _x", "x" * 5000, "a\nb\0\udc80c", "圧電 №7",
         "{{ 7*7 }}{% raw %}")


# What is read back from a gap.json is shown: the tests change JSON, and these read it.
read = GapDocument.from_json


def sentence(content: dict[str, Any]) -> str:
    return gap_words.sentence(read(content))


def promise(content: dict[str, Any]) -> str:
    return gap_words.promise(read(content))


def tables(content: dict[str, Any]) -> str:
    return gap_report.tables(read(content))


def write(content: dict[str, Any], shown: Pictures, folder: Path) -> None:
    gap_report.write(read(content), shown, folder)


def page_of(content: dict[str, Any], shown: Pictures) -> str:
    return without_scripts(gap_report.page(read(content), shown))


def rows_of_candidates(content: dict[str, Any]) -> list[dict[str, Any]]:
    return gap_report._candidates(read(content))


def parameter(value: float, low: float, high: float, unit: str) -> dict[str, Any]:
    return {"value": value, "ci95": [low, high], "unit": unit}


DELAY = {"delay_s": parameter(0.000521, 0.000479, 0.000561, "s")}


def candidate(name: str, shrink: float, refitted: float, why: str | None, **more: Any) -> dict[str, Any]:
    return {"name": name, "stage": CATALOGUE[name].stages[0], "shrink": shrink,
            "shrink_ci95": [shrink - 0.04, shrink + 0.03], "refitted_shrink": refitted, "parameters": {},
            "rejected_because": why, "excited": True, **more}


def document(verdict: str = "effect", **changes: Any) -> dict[str, Any]:
    """What `rdpi gap --json` might say: a delay of half a millisecond, on four recordings, with a passport."""
    known = verdict in ("effect", "ambiguous")
    factor = {"none": 0.25, "unknown": 0.9}.get(verdict, 1.0)
    before = factor * np.array([0.32, 0.11, 0.38, 0.71])
    after = np.array([0.098, 0.1, 0.093, 0.12])
    delay = {"name": "delay", "stage": "timing", "parameters": DELAY, "shrink": 0.757, "shrink_ci95": [0.71, 0.79],
             "held_out_rms_um": {"before": 0.412, "after": 0.1}, "confidence": 0.93,
             "confusable_with": ["lag"] if verdict == "ambiguous" else []}
    candidates = [
        candidate("creep", 0.031, 0.004, "gains no more than chance would"),
        candidate("delay", 0.757, 0.702, None if known else "does not hold on other recordings", parameters=DELAY)
        if verdict != "none" else candidate("delay", 0.01, 0.0, "gains no more than chance would"),
        candidate("lag", 0.741 if known else 0.12, 0.65,
                  None if verdict == "ambiguous" else "the delay does it better by more than one standard error",
                  parameters={"time_constant_s": parameter(0.00048, 0.00044, 0.00052, "s")}),
        candidate("resonance", 0.52 if known else 0.21, 0.3, "nothing is left to explain once the delay is added",
                  parameters={"f0_hz": parameter(412.7, 371.2, 455.0, "Hz"),
                              "damping": parameter(0.21, 0.1, 0.34, "1")}),
        candidate("slew_limit", 0.0, 0.0, "these recordings do not excite it", excited=False)]
    if verdict == "unknown":
        candidates[1] = candidate("delay", 0.08, 0.02, "gains no more than chance would")
    return {
        "schema": "rdpi-gap/1", "tool": "rdpi 1.4.0", "model": "stack7.json", "model_digest": "sha256:0f1e2d",
        "verdict": verdict, "detection": 3.41, "paired": False, "effects": [delay] if known else [], "candidates": candidates,
        "gap": {"rms_um": 0.412 * factor, "percent_of_stroke": 3.14 * factor, "noise_floor_um": NOISE_UM,
                "explained_um": 0.4 if known else 0.0, "remaining_um": 0.1 if known else 0.412 * factor,
                "whole_um": None},
        "passport": {"ratio": 4.2 * factor, "rms_um": 0.098, "held_out": "left out in turn", "spread": 0.2},
        "promised": {"shrink": 0.757, "ci90": [0.7, 0.8], "why_no_interval": None} if known else
                    {"shrink": None, "ci90": None, "why_no_interval": "no effect was accepted"},
        "where": {"stage": "timing", "runs": list(NAMES), "axes": axes(factor), "dominant": "rate_um_per_s",
                  "stages": {"before_monitor": 0.93, "after_monitor": 0.07}},
        "runs": [{"file": f"bench/{name}", "digest": f"sha256:{k}{'ab' * 31}c", "samples": 20000, "earlier": None,
                  "rms_um": {"before": float(before[k]), "after": float(after[k])}, "offset_um": 0.031 * k,
                  "noise_floor_um": NOISE_UM, "percent_of_stroke": 7.6 * float(before[k]),
                  "ratio": float(before[k]) / 0.1, "share": float(before[k]**2 / np.sum(before**2))}
                 for k, name in enumerate(NAMES)],
        "numerics": {"engine": "q31", "rms_um": {"q31": 0.00042, "f32": 0.0000031}}, "refit": {"shrink": 0.117},
        "offset_um": {"mean": 0.0465, "low": 0.0, "high": 0.093, "added": 0.0, "moved": False},
        "stuck": 0.0, "leftover": {"ratio": 1.1, "correlation": {"command": 0.01}, "kurtosis": 3.0},
        "notes": ["thermal_drift was estimated anew in each recording"],
        "gate_failed": False, "not_known_from_commissioning": [],
        "not_excited": [{"name": "slew_limit", "needs": CATALOGUE["slew_limit"].needs},
                        {"name": "cross_coupling", "needs": CATALOGUE["cross_coupling"].needs}],
        "matrix": {"names": ["delay", "lag", "resonance", "creep"],
                   "r2": [[1.0, 0.97 if verdict == "ambiguous" else 0.81, 0.63, 0.02], [0.85, 1.0, 0.55, 0.01],
                          [0.6, 0.5, 1.0, None], [0.0, 0.01, 0.02, 1.0]]},
        "next_experiment": {
            "command": "rdpi excite multisine --min-V 40 --max-V 60 --frequencies 20,50,120,300,700 -o next.csv",
            "why": "the magnitude at high frequency tells a delay from a lag", "seconds": 10.0}
        if verdict == "ambiguous" else None, **changes}


def axis(name: str, edges: list[float] | None, labels: tuple[str, ...], rms: list[float]) -> Axis:
    values = np.array(rms)
    occupancy = np.full(len(values), 1 / len(values))
    expected = np.full(len(values), 0.1)
    unit = re.search(r"\[(.*)\]|$", gap_words.AXES[name].label).group(1) or ""
    return Axis(name, unit, None if edges is None else np.array(edges), labels, values,
                values**2 / np.sum(values**2), occupancy, expected, values / expected)


def axes(factor: float = 1.0) -> dict[str, Any]:
    grown = {
        "time_s": ([0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4], [0.4, 0.41, 0.39, 0.42, 0.44, 0.4, 0.38, 0.41]),
        "frequency_hz": ([0.125 * 2.0**k for k in range(15)],
                         [0.01, 0.01, 0.02, 0.02, 0.03, 0.05, 0.09, 0.12, 0.18, 0.27, 0.2, 0.06, 0.02, 0.01]),
        "rate_um_per_s": ([0, 3.1, 12.4, 55, 130, 310, 870, 1840, 3470], [0.1, 0.1, 0.11, 0.13, 0.18, 0.3, 0.55, 0.97]),
        "position_um": ([0.3, 1.9, 3.4, 5, 6.6, 8.1, 9.7, 11.3, 13.1], [0.2, 0.35, 0.5, 0.52, 0.5, 0.45, 0.35, 0.2]),
        "direction": (None, [0.43, 0.11, 0.45]),
        "since_reversal_s": ([0, 0.0012, 0.0051, 0.012, 0.031, 0.088, 0.23, 0.61, 2.4],
                             [0.3, 0.6, 0.7, 0.5, 0.4, 0.2, 0.12, 0.1]),
        "amplitude_um": ([0.02, 0.9, 1.8, 3.1, 4.4, 6.2, 8.8, 11, 12.8],
                         [0.12, 0.15, 0.2, 0.25, 0.33, 0.5, 0.55, 0.6]),
        "recording": (None, [0.32, 0.11, 0.38, 0.71])}
    found = {}
    for name, (edges, rms) in grown.items():
        labels = tuple(map(str, edges[1:])) if edges else NAMES if name == "recording" else DIRECTIONS
        found[name] = axis(name, edges, labels, [factor * value for value in rms]).entry().to_json()
    return found


def pictures(verdict: str = "effect", samples: int = 20000, runs: int = len(NAMES)) -> Pictures:
    """Residuals like those of a delay: the rate's shape, some noise."""
    rng = np.random.default_rng(1)
    time_s = sample_times(samples, RATE_HZ)
    recordings, before, after = [], [], []
    for k, name in enumerate(NAMES[:runs]):
        command = 50 - 50 * np.cos(2 * np.pi * (1 + 3 * k) * time_s)
        recordings.append(Recording(f"bench/{name}", {}, {"time_s": time_s, "command_V": command,
                                                          "displacement_um": 0.13 * command}))
        noise = rng.normal(0, NOISE_UM, samples)
        shape = np.sin(2 * np.pi * (1 + 3 * k) * time_s) * np.exp(-((time_s - 2.2) / 1.5)**2)
        after.append(0.1 * np.sin(2 * np.pi * 1.3 * time_s) + noise)
        before.append((0.2 + 0.2 * k) * shape + after[-1])
    rms = np.outer(np.linspace(0.6, 1, 12), np.linspace(0.1, 1, 8))
    rms[0, 5:] = np.nan
    table = Table(np.linspace(0.3, 13.1, 13), np.array([0, 3.1, 12.4, 55, 130, 310, 870, 1840, 3470.0]), rms)
    known = verdict in ("effect", "ambiguous")
    edges = [0.125 * 2.0**k for k in range(15)]
    quiet = axis("frequency_hz", edges, tuple(map(str, edges[1:])), [0.01 + 0.03 * np.exp(-k / 4) for k in range(14)])
    return Pictures(recordings, before, after if known else None, table, quiet if known else None)


VOID = {"meta", "img", "link", "br", "hr", "input"}


class Page(HTMLParser):
    """A page read back: balanced, with its text, its attributes and its tables."""

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.words: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.rows: list[list[str]] = []
        self.feed(source)
        self.close()
        assert self.open == []
        self.text = re.sub(r"\s+", " ", "".join(self.words))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert tag == self.open.pop(), f"</{tag}> closes another element"

    def handle_data(self, data: str) -> None:
        if "style" in self.open:
            return
        self.words.append(data)
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    def images(self) -> list[bytes]:
        sources = [value for tag, name, value in self.attributes if (tag, name) == ("img", "src")]
        assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)
        return [base64.b64decode(source.partition(",")[2]) for source in sources]


def rendered(content: dict[str, Any], shown: Pictures | None = None) -> Page:
    """The page; without pictures unless they are `shown`, for they take most of the time."""
    if shown:
        return Page(page_of(content, shown))
    with WITHOUT_PICTURES:
        return Page(page_of(content, pictures(samples=2)))


WITHOUT_PICTURES = patch.multiple(gap_pictures, where=lambda document, pictures: [],
                                  recordings=lambda document: drawing.Shown("data:,", "data:,", "{}", ""))
UNDRAWN = patch.object(drawing, "source", lambda figure, form="svg": "data:image/svg+xml;base64,")


def check_text(text: str) -> None:
    """Whole sentences without a hole."""
    slips = r"None(?! of)|nan\b|inf\b|[{}]| [,.)]|\.\.|,,| {2}|\( |\(\)|\b(a|an|the) (a|an|the)\b|\ba [aeio]"
    assert not re.search(slips, text), text
    assert text[0].isupper() and text.endswith(".")


# ---- the verdict ----


def test_an_effect_is_named_with_its_size() -> None:
    assert sentence(document()) == (
        "The gap is 0.412 µm rms (3.1 % of the stroke) over 4 recordings, 4.2 times what the model missed at "
        "commissioning. A signal delay of 0.521 ms (95 % interval 0.479 to 0.561 ms) explains it. On recordings "
        "it was not fitted to, the residual falls from 0.412 to 0.100 µm rms.")


@pytest.mark.parametrize("paired, told", [
    (False, "The model missed as much at commissioning. So the size says nothing, but the shape does. A signal delay"),
    (True, "Two recordings of the same drive may differ by as much. So the size says nothing, but the shape does. A signal "
           "delay")])
@pytest.mark.parametrize("ratio", [0.6, 1.0, 1.08])
def test_an_effect_in_a_gap_of_usual_size(ratio: float, paired: bool, told: str) -> None:
    """Nowhere is it said in one breath that the gap is as usual and that an effect explains it."""
    content = document(paired=paired)
    content["passport"]["ratio"] = ratio
    rate = content["where"]["axes"]["rate_um_per_s"]
    rate["ratio"] = [ratio for _ in rate["ratio"]]
    text = sentence(content)
    check_text(text)
    assert told in text
    assert not re.search("as much as|times what", text + tables(content))
    assert "The gap depends most on the rate: 67 % of the energy lies at rates of 1840 to 3470 µm/s.".replace(
        "gap", "change" if paired else "gap") in gap_words.where(read(content))


def test_an_ambiguous_set() -> None:
    text = sentence(document("ambiguous"))
    assert "Either a signal delay of 0.521 ms (95 % interval 0.479 to 0.561 ms) or a first-order lag explains" in text
    assert text.endswith(" These recordings cannot tell which it is.")


def test_nothing_beyond_the_model() -> None:
    assert sentence(document("none")) == (
        "The gap is 0.103 µm rms (0.79 % of the stroke) over 4 recordings, as much as the model missed at "
        "commissioning. Nothing goes beyond the model's own error and the sensor's noise.")


@pytest.mark.parametrize(("ratio", "why", "badge"), [
    (1.8, "This is not clearly more: what it missed then is known to a factor of 4.7 only.", "nothing new"),
    (6.0, "This is more than usual, but single recordings differ by nearly as much.", "cannot tell")])
def test_nothing_for_certain(ratio: float, why: str, badge: str) -> None:
    """A passport from one recording tells little of the next; "none" beside a ratio of 1.8 says why."""
    content = document("none")
    content["passport"] |= {"ratio": ratio, "spread": 0.77}
    assert sentence(content) == (
        f"The gap is 0.103 µm rms (0.79 % of the stroke) over 4 recordings, {ratio:g} times what the model missed at "
        f"commissioning. {why} Play a drive of commissioning again and give the recording of that "
        "time with --earlier: this tells more.")
    text = page_of(content, pictures(samples=2))
    assert f">{badge}</span>" in text and ("No effect is needed" in text) == (badge == "nothing new")


def test_readings_that_stand_still_are_to_be_mended_first() -> None:
    content = document("unknown", stuck=0.8, next_experiment=None)
    assert "At least 80 % of its energy lies where readings stand still" in sentence(content)
    text = page_of(content, pictures(samples=2))
    assert "No drive is proposed: what stands still is to be mended first." in text
    content["stuck"] = 0.05
    assert "stand still" not in sentence(content)


def test_recordings_that_move_too_little_cannot_tell() -> None:
    content = document("none", not_known_from_commissioning=[{
        "axis": "movement_um", "low": 0.4, "high": 0.6, "unit": "um", "share": 0.9, "moved_um": 0.6, "commissioned_um": 3.0}])
    text = page_of(content, pictures(samples=2))
    assert "cannot tell whether something has changed" in sentence(content)
    assert '<span class="badge ambiguous">cannot tell</span>' in text and "nothing new" not in text
    assert "No effect is named: movements so small may be missed by as much." in text
    content["not_known_from_commissioning"][0]["share"] = 0.3
    assert '<span class="badge none">nothing new</span>' in page_of(content, pictures(samples=2))


def test_the_card_of_a_rival_says_what_it_would_be_and_bring() -> None:
    accepted, other = gap_report._which(read(document("ambiguous")))
    assert not accepted["rival"] and any("cannot be told from a first-order lag" in fact for fact in accepted["facts"])
    assert other["rival"] and other["facts"] == ["time constant 0.480 ms (95 % interval 0.440 to 0.520 ms)",
                                                "shrink 74 % in its place"]


def test_a_rival_of_a_later_effect_has_no_figures_of_its_own() -> None:
    """What it brings alone says nothing of what it brings beside the first."""
    content = document("ambiguous")
    delay = content["effects"][0]
    first = copy.deepcopy(delay) | {"name": "gain_change", "stage": "actuator", "confusable_with": [], "parameters": {}}
    content["effects"] = [first, delay]
    row = next(row for row in gap_report._candidates(read(content)) if row["id"] == "lag")
    assert row["verdict"] == "explains these recordings as well, beside gain_change"
    assert {row["shrink"], row["interval"], row["refitted"], row["size"]} == {gap_report.NONE}
    assert [card["facts"] for card in gap_report._which(read(content)) if card["rival"]] == [[]]


def test_a_constant_that_is_more_than_the_gap_is_told() -> None:
    """No figure counts it, and an actuator that is tracked misses by it."""
    for um, moved, told in ((0.9, False, "In the mean the recordings lie 0.9 um off, more than the gap."),
                            (0.01, False, ""), (0.9, True, "The zero lies 0.9 um off;")):
        offset = {"mean": um, "low": um, "high": um, "added": 0.0, "moved": moved}
        text = sentence(document("none", offset_um=offset)).replace("\N{NO-BREAK SPACE}", " ").replace("µm", "um")
        assert told in text and ("off" in text) == bool(told)


def test_an_unknown_cause() -> None:
    assert sentence(document("unknown")) == (
        "The gap is 0.371 µm rms (2.8 % of the stroke) over 4 recordings, 3.8 times what the model missed at "
        "commissioning. None of the 4 effects tried explains it. The best of them, mechanical resonance, would shrink "
        "it by 21 %. 67 % of the energy lies at rates of 1840 to 3470 µm/s, 8.7 times what the model missed there at "
        "commissioning.")


def hum(**changes: Any) -> dict[str, Any]:
    return {"name": "periodic_disturbance", "stage": "environment", "shrink": 0.4, "shrink_ci95": None,
            "parameters": {"frequency_hz": parameter(50.01, 49.98, 50.04, "Hz"),
                           "amplitude_um": parameter(0.031, 0.028, 0.035, "um")},
            "held_out_rms_um": {"before": 0.1, "after": 0.06}, "confidence": 1.0, "confusable_with": [], **changes}


def test_several_effects() -> None:
    content = document()
    content["effects"].append(hum())
    assert ("A signal delay of 0.521 ms (95 % interval 0.479 to 0.561 ms) and a periodic disturbance (frequency "
            "50.010 Hz, 95 %: 49.980 to 50.040; amplitude 0.0310 µm, 95 %: 0.0280 to 0.0350) explain it. On "
            "recordings they were not fitted to, the residual falls from 0.412 to 0.060 µm rms.") in sentence(content)
    content["verdict"] = "ambiguous"
    content["effects"][1]["confusable_with"] = ["resonance"]
    assert " and either a periodic disturbance (" in sentence(content)
    assert ") or a mechanical resonance explain it" in sentence(content)


def test_how_much_is_explained() -> None:
    """Not all of it is claimed when much is left; what the model missed before is no part of it."""
    words = {}
    for after in (0.12, 0.25, 0.35):
        content = document()
        content["effects"][0]["held_out_rms_um"]["after"] = after
        words[after] = re.search(r"explains (.*?)\. On ", sentence(content)).group(1)
    assert words == {0.12: "it", 0.25: "most of it", 0.35: "a part of it"}
    content["passport"].update(rms_um=0.33, ratio=1.25)
    assert "explains it. On " in sentence(content)
    content["effects"][0]["held_out_rms_um"]["after"] = 0.43
    content["passport"]["rms_um"] = 0.5
    assert "explains a part of it. On" in sentence(content) and "goes from 0.412 to 0.430 µm" in sentence(content)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_model_without_a_passport(verdict: str) -> None:
    content = document(verdict, passport=None)
    for axis_now in content["where"]["axes"].values():
        axis_now.update(expected_um=None, ratio=None)
    for one in content["runs"]:
        one["ratio"] = None
    text = sentence(content)
    check_text(text)
    assert text.endswith("The model has no passport, so it is not known how much of this it missed at commissioning.")
    assert "times" not in text and "as much" not in text
    page = rendered(content)
    assert page.text.replace(NBSP, " ").count("commissioning") == 1
    assert any("ratio to commissioning" in row for row in rendered(document(verdict)).rows)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_comparison_with_earlier_recordings(verdict: str) -> None:
    """It is then no gap to the model, and no passport of the commissioning that it is compared with."""
    content = document(verdict, paired=True)
    for run in content["runs"]:
        run["earlier"] = f"first/{Path(run['file']).name}"
    text, page = sentence(content), rendered(content)
    check_text(text)
    assert text.startswith("The change since these drives were first recorded is 0.")
    assert " two recordings of the same drive may differ by. " in text
    assert not re.search(r"commissioning|The gap|sim-to-real", page.text + tables(content), re.IGNORECASE)
    assert "Where the change lies" in page.text and ["1 multisine_large.csv", "66 %"] in [row[:2] for row in page.rows]
    assert ["bench/steps.csv", "first/steps.csv"] in [row[:2] for row in page.rows]
    labels = figure_labels(gap_pictures.runs_figure(read(content).runs, False, gap_words.CHANGE.usually))
    assert labels == ["now", "may differ anyway", "noise floor"]
    unjudged = document(verdict, paired=True, passport=None)
    assert sentence(unjudged).endswith(" it is not known how much two recordings of the same drive may differ.")


def quantised(stage: str = "sensor", **changes: Any) -> dict[str, Any]:
    return {"name": "quantisation", "stage": stage, "shrink": 0.002, "shrink_ci95": [-0.02, 0.03],
            "parameters": {"step": {"value": 1.2, "ci95": None, "unit": "um"},
                           "origin": {"value": 0.0, "ci95": None, "unit": "um"},
                           "dither": {"value": 0.01, "ci95": None, "unit": "um"}},
            "held_out_rms_um": {"before": 0.412, "after": 0.411}, "confidence": 1.0, "confusable_with": [], **changes}


def test_a_grid_of_readings_is_no_error_of_the_model() -> None:
    """A step of 1.2 µm rounds by 0.346 µm rms; no shrink is promised, but what a finer converter would bring."""
    content = document(effects=[quantised()], promised={"shrink": 0.002, "ci90": [0.0, 0.01], "why_no_interval": None})
    content["candidates"][1] = candidate("quantisation", 0.002, 0.0, None)
    coarse = ("The grid's own rounding makes up 0.346 µm rms of the gap; no better model removes it. A finer "
              "converter would reduce the gap from 0.412 to 0.223 µm rms.")
    assert sentence(content).endswith(f"commissioning. Quantisation in steps of 1.2 µm explains most of it. {coarse}")
    assert promise(content) == "" and "Adding this" not in rendered(content).text
    text = rendered(content).text.replace(NBSP, " ")
    assert text.count(coarse) == 2 and "step / √12 = 0.346 µm rms" in text
    assert "with a finer converter0.223 µmthe grid's own 0.346 µm" in text
    assert "accepted: read off the values" in text and "not fitted to" not in text


def test_a_grid_beside_another_effect() -> None:
    """Of what that one leaves."""
    content = document()
    content["effects"].append(quantised(held_out_rms_um={"before": 0.1, "after": 0.1}))
    content["effects"][1]["parameters"]["step"]["value"] = 0.12
    assert ("The grid's own rounding makes up 0.0346 µm rms of what is left; no better model removes it. A finer "
            "converter would reduce what is left from 0.100 to 0.098 µm rms.") in sentence(content)
    assert "should shrink the residual by 76 %" in promise(content)


def test_a_finer_converter_mends_nothing_else() -> None:
    content = document(effects=[quantised()])
    content["effects"][0]["parameters"]["step"]["value"] = 9.0
    assert sentence(content).endswith(" A finer converter would reduce the gap from 0.412 to 0.098 µm rms.")


def test_the_grid_of_a_dac_is_predicted() -> None:
    content = document(effects=[quantised("DAC", shrink=0.7)])
    assert "rounding" not in sentence(content) and "On recordings it was not fitted to" in sentence(content)
    assert "should shrink the residual by 76 %" in promise(content)


@pytest.mark.parametrize("share", [0.004, 0.0, -0.2])
def test_no_smaller_residual_is_promised(share: float) -> None:
    content = document(promised={"shrink": share, "ci90": [-0.3, 0.1], "why_no_interval": None},
                       refit={"shrink": share})
    assert promise(content) == "Adding this to the model should not shrink the residual on new recordings."
    assert "without any effect, would not help." in rendered(content).text


@pytest.mark.parametrize("verdict", VERDICTS)
def test_one_recording(verdict: str) -> None:
    content = document(verdict)
    content["runs"] = content["runs"][:1]
    assert "blocks of the recording" in tables(content)
    why = "one recording says nothing of how much recordings differ"
    if content["effects"]:
        content["promised"] = {"shrink": 0.6, "ci90": None, "why_no_interval": why}
    text = sentence(content)
    check_text(text)
    assert " in one recording, " in text
    page = rendered(content, pictures(verdict, runs=1))
    assert ("On blocks of the recording" in text) == (f"no interval can be given: {why}." in page.text) \
        == bool(content["effects"])
    assert "These recordings" not in text and "worst recording" not in page.text


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_can_be_said(name: str) -> None:
    """Grammar and units of every effect's title and parameters."""
    kind = CATALOGUE[name]
    for stage in kind.stages:
        content = document()
        content["effects"][0].update(name=name, stage=stage, confusable_with=["delay"], parameters={
            one.name: parameter(0.01234, 0.0112, 0.0134, one.unit) for one in kind.parameters})
        content["candidates"][0] = candidate(name, 0.8, 0.7, None)
        text = sentence(content)
        check_text(text)
        assert kind.title in text.lower() and not re.search(r"\d um|_um\b|degC|_s\b|_hz\b| 1[,;)]", text)
        assert "origin" not in text and "dither" not in text  # a reader needs the step of a grid only
        for one in kind.parameters:
            size = "12.3 ms" if one.unit == "s" else "0.0123"
            assert size in text
        card = rendered(content).text
        for words in (kind.what, kind.remedy):
            assert re.sub(r"\s+", " ", f"{words[0].upper()}{words[1:]}.") in card


@pytest.mark.parametrize("parameters", [{}, {"delay_s": {"value": None, "ci95": None, "unit": "s"}}])
def test_an_effect_without_a_size(parameters: dict[str, Any]) -> None:
    content = document()
    content["effects"][0]["parameters"] = parameters
    assert "A signal delay explains it" in sentence(content)


def test_a_size_without_an_interval() -> None:
    content = document()
    for interval in (None, [0.000521, 0.000521]):
        content["effects"][0]["parameters"] = {"delay_s": {"value": 0.000521, "ci95": interval, "unit": "s"}}
        assert "A signal delay of 0.521 ms explains it" in sentence(content)


@pytest.mark.parametrize("value, text", [
    (0.41234, "0.412 µm"), (0.1, "0.1 µm"), (12.3456, "12.3 µm"), (12345.6, "12346 µm"), (0.0, "0 µm"),
    (-0.25, "−0.25 µm"), (0.00042, "0.42 nm"), (0.9996, "1 µm"), (2e-6, "0.002 nm"), (-1e-12, "0 µm")])
def test_lengths(value: float, text: str) -> None:
    assert numbers.um(value) == text


@pytest.mark.parametrize("interval, text", [
    ([0.7, 0.8], "70 to 80 %"), ([-0.04, 0.03], "−4 to 3 %"), ([-3.5, 0.09], "< −100 to 9 %"),
    ([-5.54, -2.7], "< −100 %"), ([-1.0, 0.0], "−100 to 0 %"), (None, "–")])
def test_shrinks(interval: list[float] | None, text: str) -> None:
    """How much worse than twice the residual an effect makes it helps nobody."""
    assert numbers.shrinks(interval) == text
    if interval and interval[1] < 0:
        assert numbers.shrink(interval[0]) == text


@pytest.mark.parametrize("axis_name, words", [
    ("time_s", "lies 2 to 2.5 s after the start"), ("frequency_hz", "at 64 to 128 Hz"),
    ("position_um", "at positions of 5 to 6.6 µm"), ("direction", "while rising"),
    ("since_reversal_s", "0.0051 to 0.012 s after the command turned round"),
    ("amplitude_um", "in loops of 11 to 13 µm"), ("recording", "in multisine_large.csv")])
def test_the_dominant_axis_is_told_and_marked(axis_name: str, words: str) -> None:
    content = document("unknown")
    content["where"]["dominant"] = axis_name
    assert f" {words}, " in sentence(content)
    with UNDRAWN:
        page = page_of(content, pictures(samples=64))
    assert page.count('class="dominant"') == page.count("The gap depends most on this.") \
        == (axis_name != "recording")
    if axis_name != "recording":
        caption = page.partition('class="dominant"')[2].partition("<figcaption>")[2].partition("<")[0]
        assert caption.startswith("Spectrum" if axis_name == "frequency_hz" else
                                  f"Along {gap_words.AXES[axis_name].title}.")


# ---- the terminal ----


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_terminal_says_what_the_page_says(verdict: str) -> None:
    content = document(verdict)
    text, known = " ".join(tables(content).split()), bool(document(verdict)["effects"])
    assert text.startswith(sentence(content).replace("µ", "u")) and tables(content).isascii()
    assert text.count("67 % of the energy lies at rates of 1840 to 3470 um/s") == (known or verdict == "unknown")
    assert ("stage of the chain: timing" in text) == known
    assert text.count("not visible in these recordings: ") == 2
    assert ("record next: rdpi excite multisine" in text) == (verdict == "ambiguous")
    told = ("Adding this to the model should shrink the residual by 76 % on new recordings "
            "(90 % interval 70 to 80 %).")
    assert (told in text) == ("Adding this" in text) == known


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_table_of_the_terminal(verdict: str) -> None:
    """What gains much has a row, with the shrink explained below; the rest stands in one line."""
    content = document(verdict)
    content["candidates"][2]["refitted_shrink"] = -3.5
    lines = tables(content).splitlines()
    first = next(k for k, line in enumerate(lines) if line.split() == ["effect", "shrink", "refitted"])
    last = next(k for k, line in enumerate(lines) if line.startswith("  shrink: of the residual's rms"))
    names = [line.split()[0] for line in lines[first + 1:last] if line[2] != " "]
    below = "creep" if verdict != "none" else "creep, delay"
    order = {"none": ["resonance", "lag"], "unknown": ["resonance", "lag", "delay"]}
    assert names == order.get(verdict, ["delay", "lag", "resonance"])
    assert f"  less than 5 %: {below}" in lines
    assert any(line.split()[:6] == ["lag", *("74 %" if content["effects"] else "12 %").split(), "<", "-100", "%"]
               for line in lines)


def test_the_terminal_without_an_effect_worth_a_row() -> None:
    content = document("none")
    content["candidates"] = [candidate("creep", 0.03, 0.01, "explains too little of the gap"),
                             candidate("delay", 0.01, 0.2, "explains too little of the gap")]
    assert "  less than 5 %: creep" in tables(content)  # the model refitted, the delay gains much
    content["candidates"][1]["refitted_shrink"] = 0.01
    assert "  shrink it by less than 5 %: creep, delay" in tables(content) and "refitted" not in tables(content)


def test_lines_of_the_terminal_fit() -> None:
    """The command stays in one line, for it is copied."""
    content = document("ambiguous")
    content["candidates"][3]["rejected_because"] = "explains a part of the gap, but leaves too much to be its cause"
    lines = tables(content).splitlines()
    command = f"record next: {content['next_experiment']['command']}"
    assert len(command) > gap_report.WIDTH
    assert all(len(line) <= gap_report.WIDTH for line in {*lines} ^ {command})
    assert not any(line.lstrip().startswith(("% ", "um ", "ms ")) for line in lines)


def test_what_was_left_out_is_told_apart_from_what_cannot_be_seen() -> None:
    content = document()
    content["candidates"].append(candidate("backlash", 0.0, 0.0, "excluded by --without", excited=False))
    assert "not tried: backlash (excluded by --without)" in tables(content)
    text = rendered(content).text
    assert "Not tried: backlash (excluded by --without)" in text and "slew_limit: needs" in text
    assert "backlash: needs" not in text and "Not tried: slew_limit" not in text


# ---- the page ----


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_page(verdict: str, tmp_path: Path) -> None:
    """One file that loads nothing, holds what the document says, in the order a reader asks; and the twin."""
    content, before = document(verdict), copy.deepcopy(document(verdict))
    write(content, pictures(verdict), tmp_path / "new" / "folder")
    folder = tmp_path / "new" / "folder"
    assert sorted(path.name for path in folder.iterdir()) == ["gap.json", "index.html"]
    assert json.loads((folder / "gap.json").read_text()) == before == content
    source = without_scripts((folder / "index.html").read_text(encoding="utf-8"))
    page = Page(source)
    text = page.text.replace(NBSP, " ")
    markup = re.sub(r"base64,[\w+/=]*", "", source)
    assert not re.search(r"https?:|//|@import|url\(|<script|<link|<iframe|<object", markup)
    assert {name for _, name, _ in page.attributes}.isdisjoint({"href", "srcset", "onload", "action"})
    for picture in page.images():
        root = ElementTree.fromstring(picture)
        links = [value for item in root.iter() for key, value in item.attrib.items() if key.endswith("href")]
        assert root.tag.endswith("svg") and all(link.startswith(("#", "data:")) for link in links)
    assert len(page.images()) == 12
    order = ["The gap is", "Where the gap lies", "Which effect", "What was tried", "What these recordings can tell",
             "How far", "What could not be seen", "What to record next", "Where this comes from"]
    assert sorted(order, key=text.index) == order and sentence(content) in text
    for run in content["runs"]:
        assert {run["file"], run["digest"]} <= {cell for row in page.rows for cell in row}
    said = ["93 % arises before the tap", "7 % after it", "(q31 or f32) is not the cause", "less than 1 % of the gap",
            "0.012 µm", "shrink the residual by 12 %", "thermal_drift was estimated anew", "sha256:0f1e2d",
            "rdpi 1.4.0", "stack7.json", "left out in turn", "3.41", "slew_limit: needs a large fast move",
            "cross_coupling: needs a recorded column"]
    if content["effects"]:
        said += ["76 % (95 % interval 71 to 79 %)", "90 % interval 70 to 80 %", "explained 0.4 µm",
                 "0.412 → 0.100 µm rms", "On the bench: Shift the reference ahead"]
    if verdict == "ambiguous":
        said += ["or first-order lag", "lag reproduces 97 % of delay", content["next_experiment"]["command"],
                 "The magnitude at high frequency tells a delay from a lag. The drive takes 10 s."]
    else:
        said += [gap_report.NOTHING_TO_RECORD[verdict], "no effect reproduces 90 % or more of another"]
    assert [phrase for phrase in said if phrase not in text] == []
    matrix = [row for row in page.rows if row[0] in content["matrix"]["names"] and len(row) == 5]
    assert [row[1:] for row in matrix] == [["–" if r2 is None else f"{r2:.2f}" for r2 in row]
                                           for row in content["matrix"]["r2"]]


def test_candidates_are_ranked_and_judged() -> None:
    """Accepted, as good, rejected by shrink; what was not excited is not among them."""
    rows = rows_of_candidates(document("ambiguous"))
    assert [(row["id"], row["verdict"]) for row in rows] == [
        ("delay", "explains these recordings best"), ("lag", "explains these recordings as well"),
        ("resonance", "nothing is left to explain once the delay is added"),
        ("creep", "gains no more than chance would")]
    assert [row["kind"] for row in rows] == ["accepted", "rival", "rejected", "rejected"]
    assert rows[1]["size"] == "time constant 0.480 ms" and rows[1]["interval"] == "70 to 77 %"
    assert (rows[3]["shrink"], rows[3]["interval"], rows[3]["refitted"]) == ("3 %", "−1 to 6 %", "0 %")
    assert rows_of_candidates(document())[0]["verdict"] == "accepted"


def test_a_second_effect_is_told_as_it_was_judged() -> None:
    """Beside the first, at its own stage; what it cannot be told from then is not rejected."""
    content = document("ambiguous", effects=[document()["effects"][0], hum(confusable_with=["creep"])])
    content["candidates"][2]["rejected_because"] = "delay explains more of the gap"
    content["candidates"].append(candidate("periodic_disturbance", 0.8, 0.0, None, stage="sensor"))
    rows = rows_of_candidates(content)
    assert [(row["id"], row["kind"]) for row in rows] == [
        ("delay", "accepted"), ("periodic_disturbance", "accepted"), ("creep", "rival"), ("lag", "rejected"),
        ("resonance", "rejected")]
    assert rows[1]["verdict"] == "explains these recordings best, beside delay"
    told = [rows[1][key] for key in ("stage", "shrink", "interval", "refitted")]
    assert told == ["environment", "40 %", "–", "–"]


def test_sizes_of_what_gains_nothing_are_noise() -> None:
    content = document("none")
    assert [row["size"] for row in rows_of_candidates(content)] == [
        "f0 413 Hz; damping 0.21", "time constant 0.480 ms", "–", "–"]


def test_what_drift_may_be_instead() -> None:
    content = document()
    content["effects"][0].update(name="thermal_drift", stage="environment", parameters={})
    content["candidates"][1] = candidate("thermal_drift", 0.757, 0.702, None)
    assert ("or re-zero. If the residual over time shows a step rather than a slope, something slipped"
            in rendered(content).text)


def test_a_passport_of_fitted_recordings_is_told() -> None:
    content = document()
    assert "larger than it is" not in rendered(content).text
    content["passport"]["held_out"] = "fitted"
    assert "The passport comes from the recordings that the model was fitted to" in rendered(content).text


def test_coarse_arithmetic_is_told() -> None:
    content = document(numerics={"engine": "q31", "rms_um": {"q31": 0.0824, "f32": None}})
    assert ("The firmware's arithmetic differs from exact numbers by 0.0824 µm rms (q31): up to 20 % of the gap."
            in gap_words.where(read(content)))
    for silent in (None, {"engine": "q31", "rms_um": {"q31": None, "f32": None}}):
        assert "arithmetic" not in " ".join(gap_words.where(read(document(numerics=silent))))


def test_recordings_are_ranked_by_share() -> None:
    rows = gap_report._runs(read(document()))
    assert [row["file"] for row in rows] == ["multisine_large.csv", "multisine_small.csv", "sawtooth.csv", "steps.csv"]
    assert rows[0] == {
        "number": "1", "file": "multisine_large.csv", "share": "66 %", "before": "0.71 µm", "after": "0.12 µm",
        "noise": "0.012 µm", "stroke": "5.4 %", "ratio": "7.1", "offset": "0.093 µm"}


def foreign(text: str) -> Page:
    """A page with `text` wherever something foreign can stand; what is written must not warn."""
    content, shown = document("ambiguous"), pictures("ambiguous", samples=2000)
    content["runs"][3]["file"] = content["model"] = f"{text}.csv"
    content.update(paired=True, notes=[text])
    content["runs"][0]["earlier"] = text
    content["where"]["dominant"] = "recording"
    content["where"]["axes"]["recording"]["bins"][3] = text
    runs = [replace(shown.runs[0], path=f"{text}.csv"), *shown.runs[1:]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return Page(page_of(content, replace(shown, runs=runs, before_um=[9 * shown.before_um[0],
                                                                                 *shown.before_um[1:]])))


@pytest.mark.parametrize("text", [pytest.param(text, marks=pytest.mark.long if k else [])
                                  for k, text in enumerate(NASTY)], ids=range(len(NASTY)))
def test_foreign_text_stays_text(text: str, harmless: Page) -> None:
    """Names of files and columns are neither mark-up nor mathematics nor templates, and cannot break the page."""
    page = foreign(text)
    assert [item[:2] for item in page.attributes] == [item[:2] for item in harmless.attributes]  # no mark-up was added
    assert all(letter.isprintable() or letter in f"\n{NBSP}" for letter in "".join(page.words))
    assert len(page.text) < len(harmless.text) + 12 * 1000
    if text.isprintable() and len(text) < 50:
        assert page.text.count(text) == (9 if "/" not in text else 4)  # elsewhere the name without its folder


@pytest.fixture(scope="module")
def harmless() -> Page:
    return foreign("plain")


def test_the_same_input_gives_the_same_page() -> None:
    content = document()
    assert page_of(content, pictures()) == page_of(copy.deepcopy(content), pictures())


@pytest.mark.parametrize("verdict", VERDICTS)
def test_effects_are_drawn_only_where_one_was_added(verdict: str) -> None:
    """Residuals after are given with every verdict."""
    content = document(verdict)
    with UNDRAWN:
        source = page_of(content, pictures("effect", samples=64))
    added = bool(content["effects"])
    assert ("now and with the effects added" in source) == ('data-label="with the effects"' in source) == added
    (band, *others), _ = ([line.get_label() for line in (*panel.collections, *panel.lines)] for panel in
                          drawing.residual_figure(pictures().runs[0], {"now": pictures().before_um[0]}, NOISE_UM).axes)
    assert band == "now" and "with the effects" not in others


def test_numbers_of_numpy(tmp_path: Path) -> None:
    content = document(detection=np.float64(3.5))
    content["matrix"]["r2"] = np.eye(4)
    with WITHOUT_PICTURES:
        write(content, pictures(samples=2), tmp_path)
    twin = json.loads((tmp_path / "gap.json").read_text())
    assert twin["matrix"]["r2"] == np.eye(4).tolist() and twin["detection"] == 3.5


def test_what_cannot_be_written_leaves_the_old_report(tmp_path: Path) -> None:
    with WITHOUT_PICTURES:
        write(document(), pictures(samples=2), tmp_path)
        before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        with pytest.raises(ValueError):
            write(document(detection=float("nan")), pictures(samples=2), tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("case, verdict", [("a delay", "effect"), ("a grid", "effect"), ("nothing", "none"),
                                           ("no passport", "effect"), ("one recording", "effect"),
                                           ("none of those known", "unknown")])
def test_what_a_diagnosis_says(case: str, verdict: str) -> None:
    """All that the report needs is in the document, whatever that holds."""
    model, entries = commissioned(), [] if case in ("a grid", "nothing") else [entry("delay", delay_s=0.003)]
    runs = recorded(plain_model(), drives(LATER[:1] if case == "one recording" else LATER), *entries)
    if case == "a grid":
        runs = [changed(run, displacement_um=0.2 * np.round(run.displacement_um / 0.2)) for run in runs]
    found = diagnose(replace(model, passport=None) if case == "no passport" else model, runs,
                     tuple(CATALOGUE) if case == "none of those known" else ())
    content = replace(found.document, model="model.json", model_digest=model.digest()).to_json()
    assert content["verdict"] == verdict
    check_text(sentence(content))
    assert sentence(content).replace("µ", "u").split() == tables(content).split()[:len(sentence(content).split())]
    shown = Pictures(found.runs, found.before_um, found.after_um, found.table, found.spectrum_after)
    with UNDRAWN:
        assert sentence(content) in rendered(content, shown).text.replace(NBSP, " ")


# ---- pictures ----


def figure_labels(figure: Figure) -> list[str]:
    return [line.get_label() for line in figure.axes[0].lines]


def all_figures() -> list[Figure]:
    shown, content = pictures(), read(document())
    found = content.where.axes
    with drawing.style():
        return [*(gap_pictures.axis_figure(name, found[name], USUAL) for name in gap_words.AXES
                  if name != "frequency_hz"),
                gap_pictures.spectrum_figure(found["frequency_hz"], shown.spectrum_after, USUAL),
                drawing.table_figure(shown.table),
                drawing.residual_figure(shown.runs[3], {"now": shown.before_um[3], "with": shown.after_um[3]}, NOISE_UM),
                gap_pictures.runs_figure(content.runs, True, USUAL)]


def test_every_picture_says_what_and_in_which_unit() -> None:
    for figure in all_figures():
        figure.draw_without_rendering()
        assert figure.axes
        for panel in figure.axes:
            labels = [text for text in (panel.get_xlabel(), panel.get_ylabel()) if text]
            plain = {"direction", "recording"}  # the axes without a unit
            assert labels and all(re.search(r"\[(s|Hz|µm|µm/s|µm rms)\]$", text) or text in plain for text in labels)


def test_bars_now_and_at_commissioning() -> None:
    content = read(document()).where.axes["rate_um_per_s"]
    panel = gap_pictures.axis_figure("rate_um_per_s", content, USUAL).axes[0]
    heights = [bar.get_height() for bar in panel.patches]
    assert heights == [*content.rms_um, *content.expected_um]
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["now", "at commissioning"]
    assert [text.get_text() for text in panel.get_xticklabels()][:3] == ["0", "3.1", "12"]
    alone = gap_pictures.axis_figure("rate_um_per_s", replace(content, expected_um=None), USUAL).axes[0]
    assert [bar.get_height() for bar in alone.patches] == content.rms_um and alone.get_legend() is None


@pytest.mark.parametrize("edges, texts", [
    ([-0.00017, 2.123, 4.2, 13.07], ["0", "2.1", "4.2", "13"]),
    ([11.01, 11.04, 11.4, 12.96], ["11.01", "11.04", "11.4", "12.96"]),
    ([0.0, 0.00123, 3470.2], ["0", "0.0012", "3470"]), ([11.203575, 11.203578, 12.9], ["11.2", "11.2", "12.9"]),
    ([2.5e-90, 4.1e-90, 3.0, 12.9], ["0", "0", "3", "13"]),
    ([4.3e-6, 9.1e-6, 60.2, 121.3], ["0", "0", "60", "121"])])
def test_edges_of_bins(edges: list[float], texts: list[str]) -> None:
    assert numbers.edge_names(edges) == texts


def test_labels_of_bins_do_not_overlap() -> None:
    for figure in all_figures()[:7]:
        figure.draw_without_rendering()
        texts = [text for text in figure.axes[0].get_xticklabels() if text.get_text()]
        if texts[0].get_rotation():
            continue
        boxes = [text.get_window_extent() for text in texts]
        assert all(left.x1 < right.x0 for left, right in zip(boxes[:-1], boxes[1:])), texts


def test_spectrum() -> None:
    content, after = read(document()).where.axes["frequency_hz"], pictures().spectrum_after
    panel = gap_pictures.spectrum_figure(content, after, USUAL).axes[0]
    values = [step.get_data().values for step in panel.patches]
    assert [list(one) for one in values] == [content.rms_um, content.expected_um, list(after.rms_um)]
    assert panel.get_xscale() == panel.get_yscale() == "log"
    silent = replace(content, rms_um=[0.0, *content.rms_um[1:]])
    gap_pictures.spectrum_figure(silent, None, USUAL).draw_without_rendering()


@pytest.mark.parametrize("most_um", [0.0123, 0.0951, 1.24, 356.0])
def test_numbers_in_a_heat_map_do_not_overlap(most_um: float) -> None:
    figure = drawing.table_figure(Table(np.arange(13.0), np.arange(11.0), np.full((12, 10), most_um)))
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts[:12]]
    assert all(left.x1 < right.x0 for left, right in zip(boxes[:-1], boxes[1:]))


def test_heat_map() -> None:
    table = pictures().table
    panel = drawing.table_figure(table).axes[0]
    (mesh,) = panel.collections
    drawn = mesh.get_array().reshape(table.rms_um.T.shape)
    assert (drawn.mask == np.isnan(table.rms_um.T)).all()
    assert np.asarray(drawn[~drawn.mask]) == pytest.approx(table.rms_um.T[~np.isnan(table.rms_um.T)])
    assert len(panel.texts) == np.isfinite(table.rms_um).sum()
    large = Table(np.arange(41.0), np.arange(31.0), np.ones((40, 30)))
    assert not drawing.table_figure(large).axes[0].texts


def test_residual_over_time_keeps_its_peaks() -> None:
    """Long recordings are drawn as the span of each column, and the lower panel shows where it is worst."""
    shown = pictures(samples=200_000)
    residual = shown.before_um[0] - np.mean(shown.before_um[0])
    residual[150_000:150_050] += 3.0
    figure = drawing.residual_figure(shown.runs[0], {"now": residual}, NOISE_UM)
    top, bottom = figure.axes
    (band,) = top.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert len(heights) < 5 * drawing.COLUMNS
    assert (heights.max(), heights.min()) == pytest.approx((residual.max() - residual.mean(),
                                                            residual.min() - residual.mean()))
    assert bottom.get_xlim()[0] <= 150_000 / RATE_HZ <= bottom.get_xlim()[1]
    assert np.ptp(bottom.get_xlim()) < 0.1 * np.ptp(top.get_xlim())


def test_a_short_recording_over_time() -> None:
    shown = pictures(samples=16)
    top, bottom = drawing.residual_figure(
        shown.runs[0], {"now": shown.before_um[0], gap_pictures.WITH: shown.after_um[0]}, NOISE_UM).axes
    for panel in (top, bottom):
        before, after = panel.lines[:2]
        assert before.get_ydata() == pytest.approx(shown.before_um[0] - shown.before_um[0].mean())
        assert after.get_ydata() == pytest.approx(shown.after_um[0] - shown.after_um[0].mean())


def test_recordings_before_and_after() -> None:
    runs = read(document()).runs
    panel = gap_pictures.runs_figure(runs, True, USUAL).axes[0]
    marks = {line.get_label(): line.get_xdata() for line in panel.lines}
    assert marks["now"] == pytest.approx([run.rms_um.before for run in runs])
    assert marks["with the effects"] == pytest.approx([run.rms_um.after for run in runs])
    assert marks["at commissioning"] == pytest.approx(np.full(4, 0.1))
    assert marks["noise floor"] == pytest.approx(np.full(4, NOISE_UM))
    alone = gap_pictures.runs_figure([replace(run, ratio=None) for run in runs], False, USUAL)
    assert figure_labels(alone) == ["now", "noise floor"]
    many = gap_pictures.runs_figure(runs * 10, True, USUAL).axes[0]
    assert len(many.get_yticks()) == gap_pictures.BARS
