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
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from rdpi import gap_report
from rdpi.effects import CATALOGUE
from rdpi.gap_report import Pictures, sentence, tables, write
from rdpi.localise import DIRECTIONS, Axis, Table
from rdpi.recording import Recording, sample_times

RATE_HZ = 5000.0
NBSP = "\N{NO-BREAK SPACE}"
NAMES = "sawtooth.csv", "steps.csv", "multisine_small.csv", "multisine_large.csv"
NOISE_UM = 0.012
VERDICTS = "effect", "ambiguous", "none", "unknown"
NASTY = ('<script>alert("x")</script>', "a & b ' \" c", "$\\frac{$ _x", "x" * 5000, "a\nb\0\udc80c", "圧電 №7",
         "{{ 7*7 }}{% raw %}")


def parameter(value: float, low: float, high: float, unit: str) -> dict[str, Any]:
    return {"value": value, "ci95": [low, high], "unit": unit}


DELAY = {"delay_s": parameter(0.000521, 0.000479, 0.000561, "s")}


def candidate(name: str, shrink: float, refitted: float, why: str | None, **more: Any) -> dict[str, Any]:
    return {"name": name, "stage": CATALOGUE[name].stages[0], "shrink": shrink,
            "shrink_ci95": [shrink - 0.04, shrink + 0.03], "refitted_shrink": refitted, "parameters": {},
            "passport_shrink": 0.02, "rejected_because": why, "excited": True, **more}


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
        candidate("slew_limit", 0.0, 0.0, None, excited=False)]
    if verdict == "unknown":
        candidates[1] = candidate("delay", 0.08, 0.02, "gains no more than chance would")
    return {
        "schema": "rdpi-gap/1", "tool": "rdpi 1.4.0", "model": "stack7.json", "model_digest": "sha256:0f1e2d",
        "verdict": verdict, "detection": 3.41, "effects": [delay] if known else [], "candidates": candidates,
        "gap": {"rms_um": 0.412 * factor, "percent_of_stroke": 3.14 * factor, "noise_floor_um": NOISE_UM,
                "explained_um": 0.4 if known else 0.0, "remaining_um": 0.1 if known else 0.412 * factor},
        "passport": {"ratio": 4.2 * factor, "rms_um": 0.098, "held_out": "left out in turn"},
        "promised": {"shrink": 0.757, "ci90": [0.7, 0.8], "why_no_interval": None} if known else
                    {"shrink": None, "ci90": None, "why_no_interval": "no effect was accepted"},
        "where": {"stage": "timing", "runs": list(NAMES), "axes": axes(factor), "dominant": "rate_um_per_s",
                  "stages": {"before_monitor": 0.93, "after_monitor": 0.07}},
        "runs": [{"file": f"bench/{name}", "digest": f"sha256:{k}{'ab' * 31}c", "samples": 20000,
                  "rms_um": {"before": float(before[k]), "after": float(after[k])}, "offset_um": 0.031 * k,
                  "noise_floor_um": NOISE_UM, "percent_of_stroke": 7.6 * float(before[k]),
                  "ratio": float(before[k]) / 0.1, "share": float(before[k]**2 / np.sum(before**2))}
                 for k, name in enumerate(NAMES)],
        "numerics": {"engine": "q31", "rms_um": {"q31": 0.00042, "f32": 0.0000031}}, "refit": {"shrink": 0.117},
        "notes": ["thermal_drift was estimated anew in each recording"],
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
    unit = re.search(r"\[(.*)\]|$", gap_report.AXES[name].label).group(1) or ""
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
        found[name] = axis(name, edges, labels, [factor * value for value in rms]).to_json()
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
    return Page(gap_report.page(content, shown or Pictures([], [])))


def check_text(text: str) -> None:
    """Whole sentences without a hole."""
    slips = r"None|nan\b|inf\b|[{}]| [,.)]|\.\.|,,| {2}|\( |\(\)|\b(a|an|the) (a|an|the)\b|\ba [aeio]"
    assert not re.search(slips, text), text
    assert text[0].isupper() and text.endswith(".")


# ---- the verdict ----


def test_an_effect_is_named_with_its_size() -> None:
    assert sentence(document()) == (
        "The gap is 0.412 µm rms (3.1 % of the stroke) over 4 recordings, 4.2 times what the model missed at "
        "commissioning: a signal delay of 0.521 ms (95 % interval 0.479 to 0.561 ms) explains it, and on recordings "
        "it was not fitted to, the residual falls from 0.412 to 0.100 µm rms.")


def test_an_effect_that_looks_like_another() -> None:
    content = document()
    content["effects"][0]["confusable_with"] = ["lag", "resonance"]
    assert sentence(content).endswith(" With these recordings a signal delay cannot be told from a first-order lag or "
                                      "a mechanical resonance.")


def test_an_ambiguous_set() -> None:
    text = sentence(document("ambiguous"))
    assert "either a signal delay of 0.521 ms (95 % interval 0.479 to 0.561 ms) or a first-order lag explains" in text
    assert text.endswith(" These recordings cannot tell which it is.")
    content = document("ambiguous", effects=[])
    assert "either a signal delay or a first-order lag explains it." in sentence(content)


def test_the_same_effect_at_another_stage() -> None:
    content = document("ambiguous")
    content["effects"][0]["confusable_with"] = ["delay"]
    content["candidates"].append(candidate("delay", 0.75, 0.7, None, stage="sensor"))
    assert ("either a signal delay (stage timing; delay 0.521 ms, 95 %: 0.479 to 0.561) or a signal delay "
            "(stage sensor) explains it") in sentence(content)


def test_nothing_beyond_the_model() -> None:
    assert sentence(document("none")) == (
        "The gap is 0.103 µm rms (0.79 % of the stroke) over 4 recordings, as much as the model missed at "
        "commissioning: nothing beyond the model's own error and the sensor's noise.")


def test_an_unknown_cause() -> None:
    assert sentence(document("unknown")) == (
        "The gap is 0.371 µm rms (2.8 % of the stroke) over 4 recordings, 3.8 times what the model missed at "
        "commissioning: none of the 4 effects tried explains it; the best of them, mechanical resonance, would shrink "
        "it by 21 %. 67 % of the energy lies at rates of 1840 to 3470 µm/s, 8.7 times what the model missed there at "
        "commissioning.")


def hum(**changes: Any) -> dict[str, Any]:
    return {"name": "periodic_disturbance", "stage": "environment", "shrink": 0.4, "shrink_ci95": None,
            "parameters": {"frequency_hz": parameter(50.01, 49.98, 50.04, "Hz"),
                           "amplitude_um": parameter(0.031, 0.028, 0.035, "um")},
            "held_out_rms_um": {"before": 0.1, "after": 0.06}, "confidence": "high", "confusable_with": [], **changes}


def test_several_effects() -> None:
    content = document()
    content["effects"].append(hum())
    assert ("a signal delay of 0.521 ms (95 % interval 0.479 to 0.561 ms) and a periodic disturbance (frequency "
            "50.010 Hz, 95 %: 49.980 to 50.040; amplitude 0.0310 µm, 95 %: 0.0280 to 0.0350) explain it, and on "
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
        words[after] = re.search(r"explains (.*?),", sentence(content)).group(1)
    assert words == {0.12: "it", 0.25: "most of it", 0.35: "a part of it"}
    content["passport"] = {"rms_um": 0.33, "ratio": 1.25}
    assert "explains it," in sentence(content)
    content["effects"][0]["held_out_rms_um"]["after"] = 0.43
    content["passport"]["rms_um"] = 0.5
    assert "explains a part of it, and" in sentence(content) and "goes from 0.412 to 0.430 µm" in sentence(content)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_model_without_a_passport(verdict: str) -> None:
    content = document(verdict, passport=None)
    for axis_now in content["where"]["axes"].values():
        axis_now.update(expected_um=None, ratio=None)
    for one in (*content["runs"], *content["candidates"]):
        one.update(ratio=None, passport_shrink=None)
    text = sentence(content)
    check_text(text)
    assert text.endswith("The model carries no passport: how much of this it missed at commissioning is not known.")
    assert "times" not in text and "as much" not in text
    page = rendered(content)
    assert "may be blamed on an effect" in page.text and "at commissioning" not in page.rows[0]
    assert "at commissioning" in rendered(document(verdict)).rows[0]
    assert page.text.replace(NBSP, " ").count("at commissioning") == 2  # the verdict, and what could not be seen


@pytest.mark.parametrize("verdict", VERDICTS)
def test_one_recording(verdict: str) -> None:
    content = document(verdict)
    content["runs"] = content["runs"][:1]
    why = "one recording says nothing of how much recordings differ"
    if content["effects"]:
        content["promised"] = {"shrink": 0.6, "ci90": None, "why_no_interval": why}
    text = sentence(content)
    check_text(text)
    assert " in one recording, " in text
    page = rendered(content, pictures(verdict, runs=1))
    assert "blocks of that same recording" in page.text
    assert ("on blocks of the recording" in text) == (f"no interval can be given: {why}." in page.text) \
        == bool(content["effects"])
    assert "These recordings" not in text and "worst recording" not in page.text


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_can_be_said(name: str) -> None:
    """Grammar and units of every effect's title and parameters."""
    kind = CATALOGUE[name]
    for stage in kind.stages:
        content = document(where={})  # no pictures
        content["effects"][0].update(name=name, stage=stage, confusable_with=[name], parameters={
            one.name: parameter(0.01234, 0.0112, 0.0134, one.unit) for one in kind.parameters})
        content["candidates"][0] = candidate(name, 0.8, 0.7, None)
        text = sentence(content)
        check_text(text)
        assert kind.title in text and not re.search(r"\d um|_um\b|degC|_s\b|_hz\b| 1[,;)]", text)
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
    assert "a signal delay explains it" in sentence(content)


def test_a_size_without_an_interval() -> None:
    content = document()
    for interval in (None, [None, None], [0.000521, 0.000521]):
        content["effects"][0]["parameters"] = {"delay_s": {"value": 0.000521, "ci95": interval, "unit": "s"}}
        assert "a signal delay of 0.521 ms explains it" in sentence(content)


@pytest.mark.parametrize("value, text", [
    (0.41234, "0.412 µm"), (0.1, "0.1 µm"), (12.3456, "12.3 µm"), (12345.6, "12346 µm"), (0.0, "0 µm"),
    (-0.25, "−0.25 µm"), (0.00042, "0.42 nm"), (0.9996, "1 µm"), (1e-12, "1.00e−09 nm"), (None, "–")])
def test_lengths(value: float | None, text: str) -> None:
    assert gap_report._um(value) == text


@pytest.mark.parametrize("axis_name, words", [
    ("time_s", "lies 2 to 2.5 s after the start"), ("frequency_hz", "at 64 to 128 Hz"),
    ("position_um", "at positions of 5 to 6.6 µm"), ("direction", "while rising"),
    ("since_reversal_s", "0.0051 to 0.012 s after the command turned round"),
    ("amplitude_um", "in loops of 11 to 13 µm"), ("recording", "in multisine_large.csv")])
def test_the_dominant_axis_is_told_and_marked(axis_name: str, words: str) -> None:
    content = document("unknown")
    content["where"]["dominant"] = axis_name
    assert f" {words}, " in sentence(content)
    page = gap_report.page(content, Pictures([], []))
    assert page.count('class="dominant"') == page.count("Concentrates the gap most.") == (axis_name != "recording")
    if axis_name != "recording":
        caption = page.partition('class="dominant"')[2].partition("<figcaption>")[2].partition("<")[0]
        assert caption.startswith("Spectrum" if axis_name == "frequency_hz" else
                                  f"Along {gap_report.AXES[axis_name].title}.")


# ---- the terminal ----


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_terminal_says_what_the_page_says(verdict: str) -> None:
    content = document(verdict)
    lines = tables(content).splitlines()
    assert lines[0] == sentence(content).replace("µ", "u") and tables(content).isascii()
    place = "dominant axis: rate; 67 % of the energy lies at rates of 1840 to 3470 um/s"
    assert any(line.startswith(place) for line in lines)
    rows = [line.split() for line in lines if line.startswith("  ")][:5]
    order = {"none": ["resonance", "lag", "creep", "delay"], "unknown": ["resonance", "lag", "delay", "creep"]}
    assert [row[0] for row in rows] == ["candidate", *order.get(verdict, ["delay", "lag", "resonance", "creep"])]
    assert sum(line.startswith("not to be seen in these recordings: ") for line in lines) == 2
    assert ("record next: rdpi excite multisine" in tables(content)) == (verdict == "ambiguous")
    promise = "this promises a gap smaller by 76 % on new recordings (90 % interval 70 to 80 %)."
    assert (promise in tables(content)) == ("promises" in tables(content)) == bool(content["effects"])


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_least_a_document_holds(verdict: str, tmp_path: Path) -> None:
    content = {"verdict": verdict, "gap": {"rms_um": 0.1}}
    check_text(tables(content))
    assert tables(content) == sentence(content).replace("µ", "u")
    write(content, Pictures([], []), tmp_path)
    page = Page((tmp_path / "index.html").read_text(encoding="utf-8"))
    assert page.images() == [] and sentence(content) in page.text.replace(NBSP, " ")


# ---- the page ----


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_page(verdict: str, tmp_path: Path) -> None:
    """One file that loads nothing, holds what the document says, in the order a reader asks; and the twin."""
    content, before = document(verdict), copy.deepcopy(document(verdict))
    write(content, pictures(verdict), tmp_path / "new" / "folder")
    folder = tmp_path / "new" / "folder"
    assert sorted(path.name for path in folder.iterdir()) == ["gap.json", "index.html"]
    assert json.loads((folder / "gap.json").read_text()) == before == content
    source = (folder / "index.html").read_text(encoding="utf-8")
    page = Page(source)
    text = page.text.replace(NBSP, " ")
    markup = re.sub(r"base64,[\w+/=]*", "", source)
    assert not re.search(r"https?:|//|@import|url\(|<script|<link|<iframe|<object", markup)
    assert {name for _, name, _ in page.attributes}.isdisjoint({"href", "srcset", "onload", "action"})
    for picture in page.images():
        root = ElementTree.fromstring(picture)
        links = [value for item in root.iter() for key, value in item.attrib.items() if key.endswith("href")]
        assert root.tag.endswith("svg") and all(link.startswith(("#", "data:")) for link in links)
    assert len(page.images()) == 10
    order = ["The gap is", "Where the gap lies", "Which effect", "What was tried", "What these recordings can tell",
             "How far", "What could not be seen", "What to record next", "Where this comes from"]
    assert sorted(order, key=text.index) == order and sentence(content) in text
    for run in content["runs"]:
        assert {run["file"], run["digest"]} <= {cell for row in page.rows for cell in row}
    said = ["93 % arises before the tap", "7 % after it", "q31 0.42 nm rms", "less than 1 % of the gap", "0.012 µm",
            "shrink the residual by 12 %", "thermal_drift was estimated anew", "sha256:0f1e2d", "rdpi 1.4.0",
            "stack7.json", "left out in turn", "3.41", "slew_limit: needs a large fast move",
            "cross_coupling: needs a logged column"]
    if content["effects"]:
        said += ["76 % (95 % interval 71 to 79 %)", "confidence 0.93", "90 % interval 70 to 80 %", "explained 0.4 µm",
                 "0.412 → 0.100 µm rms", "On the bench: Shift the reference ahead"]
    if verdict == "ambiguous":
        said += ["or first-order lag", "lag reproduces 97 % of delay", content["next_experiment"]["command"],
                 "The magnitude at high frequency tells a delay from a lag. It takes 10 s on the bench."]
    else:
        said += [gap_report.NOTHING_TO_RECORD[verdict], "no effect reproduces 90 % or more of another"]
    assert [phrase for phrase in said if phrase not in text] == []
    matrix = [row for row in page.rows if row[0] in content["matrix"]["names"] and len(row) == 5]
    assert [row[1:] for row in matrix] == [["–" if r2 is None else f"{r2:.2f}" for r2 in row]
                                           for row in content["matrix"]["r2"]]


def test_candidates_are_ranked_and_judged() -> None:
    """Accepted, as good, rejected by shrink; what was not excited is not among them."""
    rows = gap_report._candidates(document("ambiguous"))
    assert [(row["id"], row["verdict"]) for row in rows] == [
        ("delay", "explains these recordings best"), ("lag", "explains these recordings as well"),
        ("resonance", "nothing is left to explain once the delay is added"),
        ("creep", "gains no more than chance would")]
    assert [row["kind"] for row in rows] == ["accepted", "rival", "rejected", "rejected"]
    assert rows[1]["size"] == "time constant 0.480 ms" and rows[1]["interval"] == "70 to 77 %"
    assert (rows[3]["shrink"], rows[3]["interval"], rows[3]["refitted"], rows[3]["passport"]) == \
        ("3 %", "−1 to 6 %", "0 %", "2 %")
    assert gap_report._candidates(document())[0]["verdict"] == "accepted"


def test_candidates_without_a_verdict_or_a_figure() -> None:
    """Where no effect was accepted nothing explains the recordings "as well"."""
    content = document("none", candidates=[{"name": "lag", "rejected_because": None}])
    (row,) = gap_report._candidates(content)
    assert {row[key] for key in ("verdict", "size", "shrink", "interval", "refitted", "passport")} == {"–"}


def test_a_passport_of_fitted_recordings_is_told() -> None:
    content = document(where={})
    assert "larger than it is" not in rendered(content).text
    content["passport"]["held_out"] = "fitted"
    assert "The passport was taken on the recordings the model was fitted to" in rendered(content).text


def test_coarse_arithmetic_is_told() -> None:
    content = document(where={}, numerics={"engine": "q31", "rms_um": {"q31": 0.0824, "f32": None}})
    text = rendered(content).text.replace(NBSP, " ")
    assert "differs from exact numbers by q31 0.0824 µm rms: up to 20 % of the gap." in text


def test_recordings_are_ranked_by_share() -> None:
    rows = gap_report._runs(document())
    assert [row["file"] for row in rows] == ["multisine_large.csv", "multisine_small.csv", "sawtooth.csv", "steps.csv"]
    assert rows[0] == {
        "number": "1", "file": "multisine_large.csv", "share": "66 %", "before": "0.71 µm", "after": "0.12 µm",
        "noise": "0.012 µm", "stroke": "5.4 %", "ratio": "7.1", "offset": "0.093 µm"}
    assert {row["after"] for row in gap_report._runs(document("unknown"))} == {"–"}


def test_candidates_alone_tell_what_was_not_excited() -> None:
    content = document(not_excited=[])
    assert [(one["id"], one["needs"]) for one in gap_report._hidden(content)] == \
        [("slew_limit", CATALOGUE["slew_limit"].needs)]


def foreign(text: str) -> Page:
    """A page with `text` wherever something foreign can stand; what is written must not warn."""
    content, shown = document("ambiguous"), pictures("ambiguous", samples=2000)
    content["runs"][3]["file"] = content["model"] = f"{text}.csv"
    content["where"]["stage"] = content["passport"]["held_out"] = content["notes"][0] = text
    content["next_experiment"].update(command=f"rdpi excite {text}", why=text)
    content["candidates"][0]["rejected_because"] = content["effects"][0]["confidence"] = text
    content["where"].update(dominant="recording", axes={"recording": content["where"]["axes"]["recording"]})
    content["where"]["axes"]["recording"]["bins"][3] = text
    runs = [replace(shown.runs[0], path=f"{text}.csv"), *shown.runs[1:]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return Page(gap_report.page(content, replace(shown, runs=runs, before_um=[9 * shown.before_um[0],
                                                                                 *shown.before_um[1:]])))


@pytest.mark.parametrize("text", NASTY, ids=range(len(NASTY)))
def test_foreign_text_stays_text(text: str, harmless: Page) -> None:
    """Names of files and columns are neither mark-up nor mathematics nor templates, and cannot break the page."""
    page = foreign(text)
    assert [item[:2] for item in page.attributes] == [item[:2] for item in harmless.attributes]  # no mark-up was added
    assert all(letter.isprintable() or letter in f"\n{NBSP}" for letter in "".join(page.words))
    assert len(page.text) < len(harmless.text) + 12 * 1000
    if text.isprintable() and len(text) < 50:
        assert page.text.count(text) >= 8 and f"rdpi excite {text}" in page.text


@pytest.fixture(scope="module")
def harmless() -> Page:
    return foreign("plain")


def test_the_same_input_gives_the_same_page() -> None:
    content = document()
    content["where"]["axes"] = {"frequency_hz": content["where"]["axes"]["frequency_hz"]}
    assert gap_report.page(content, pictures()) == gap_report.page(copy.deepcopy(content), pictures())


@pytest.mark.parametrize("verdict", VERDICTS)
def test_effects_are_drawn_only_where_one_was_added(verdict: str) -> None:
    """Residuals after are given with every verdict."""
    content, source = document(verdict), gap_report.page(document(verdict, where={}), pictures("effect"))
    added = bool(content["effects"])
    assert ("before and with the effects added" in source) == ('data-label="with the effects"' in source) == added
    (band, *others), _ = ([line.get_label() for line in (*panel.collections, *panel.lines)] for panel in
                          gap_report.time_figure(pictures().runs[0], pictures().before_um[0], None, None).axes)
    assert band == "now" and not others


def test_numbers_of_numpy(tmp_path: Path) -> None:
    content = document(detection=np.float64(3.5), where={})
    content["matrix"]["r2"] = np.eye(4)
    write(content, Pictures([], []), tmp_path)
    twin = json.loads((tmp_path / "gap.json").read_text())
    assert twin["matrix"]["r2"] == np.eye(4).tolist() and twin["detection"] == 3.5


def test_what_cannot_be_written_leaves_the_old_report(tmp_path: Path) -> None:
    write(document(), pictures(), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ValueError):
        write(document(detection=float("nan")), pictures(), tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


# ---- pictures ----


def all_figures() -> list[Figure]:
    shown, content = pictures(), document()
    found = content["where"]["axes"]
    with gap_report._style():
        return [*(gap_report.axis_figure(name, found[name]) for name in gap_report.AXES if name != "frequency_hz"),
                gap_report.spectrum_figure(found["frequency_hz"], shown.spectrum_after),
                gap_report.table_figure(shown.table),
                gap_report.time_figure(shown.runs[3], shown.before_um[3], shown.after_um[3], NOISE_UM),
                gap_report.runs_figure(content["runs"], True)]


def test_every_picture_says_what_and_in_which_unit() -> None:
    for figure in all_figures():
        figure.draw_without_rendering()
        assert figure.axes
        for panel in figure.axes:
            labels = [text for text in (panel.get_xlabel(), panel.get_ylabel()) if text]
            plain = {"direction", "recording"}  # the axes without a unit
            assert labels and all(re.search(r"\[(s|Hz|µm|µm/s|µm rms)\]$", text) or text in plain for text in labels)


def test_bars_now_and_at_commissioning() -> None:
    content = document()["where"]["axes"]["rate_um_per_s"]
    panel = gap_report.axis_figure("rate_um_per_s", content).axes[0]
    heights = [bar.get_height() for bar in panel.patches]
    assert heights == [*content["rms_um"], *content["expected_um"]]
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["now", "at commissioning"]
    assert [text.get_text() for text in panel.get_xticklabels()][:3] == ["0", "3.1", "12"]
    alone = gap_report.axis_figure("rate_um_per_s", {**content, "expected_um": None}).axes[0]
    assert [bar.get_height() for bar in alone.patches] == content["rms_um"] and alone.get_legend() is None


@pytest.mark.parametrize("edges, texts", [
    ([-0.00017, 2.123, 4.2, 13.07], ["0", "2.1", "4.2", "13"]),
    ([11.01, 11.04, 11.4, 12.96], ["11.01", "11.04", "11.4", "12.96"]),
    ([0.0, 0.00123, 3470.2], ["0", "0.0012", "3470"]), ([11.203575, 11.203578, 12.9], ["11.2", "11.2", "12.9"])])
def test_edges_of_bins(edges: list[float], texts: list[str]) -> None:
    assert gap_report._edges(edges) == texts


def test_labels_of_bins_do_not_overlap() -> None:
    for figure in all_figures()[:7]:
        figure.draw_without_rendering()
        texts = [text for text in figure.axes[0].get_xticklabels() if text.get_text()]
        if texts[0].get_rotation():
            continue
        boxes = [text.get_window_extent() for text in texts]
        assert all(left.x1 < right.x0 for left, right in zip(boxes[:-1], boxes[1:])), texts


def test_spectrum() -> None:
    content, after = document()["where"]["axes"]["frequency_hz"], pictures().spectrum_after
    panel = gap_report.spectrum_figure(content, after).axes[0]
    values = [step.get_data().values for step in panel.patches]
    assert [list(one) for one in values] == [content["rms_um"], content["expected_um"], list(after.rms_um)]
    assert panel.get_xscale() == panel.get_yscale() == "log"
    silent = {**content, "rms_um": [0.0, *content["rms_um"][1:]]}
    gap_report.spectrum_figure(silent, None).draw_without_rendering()


def test_heat_map() -> None:
    table = pictures().table
    panel = gap_report.table_figure(table).axes[0]
    (mesh,) = panel.collections
    drawn = mesh.get_array().reshape(table.rms_um.T.shape)
    assert (drawn.mask == np.isnan(table.rms_um.T)).all()
    assert np.asarray(drawn[~drawn.mask]) == pytest.approx(table.rms_um.T[~np.isnan(table.rms_um.T)])
    assert len(panel.texts) == np.isfinite(table.rms_um).sum()
    large = Table(np.arange(41.0), np.arange(31.0), np.ones((40, 30)))
    assert not gap_report.table_figure(large).axes[0].texts


def test_residual_over_time_keeps_its_peaks() -> None:
    """Long recordings are drawn as the span of each column, and the lower panel shows where it is worst."""
    shown = pictures(samples=200_000)
    residual = shown.before_um[0] - np.mean(shown.before_um[0])
    residual[150_000:150_050] += 3.0
    figure = gap_report.time_figure(shown.runs[0], residual, None, None)
    top, bottom = figure.axes
    (band,) = top.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert len(heights) < 5 * gap_report.COLUMNS
    assert (heights.max(), heights.min()) == pytest.approx((residual.max() - residual.mean(),
                                                            residual.min() - residual.mean()))
    assert bottom.get_xlim()[0] <= 150_000 / RATE_HZ <= bottom.get_xlim()[1]
    assert np.ptp(bottom.get_xlim()) < 0.1 * np.ptp(top.get_xlim())


def test_a_short_recording_over_time() -> None:
    shown = pictures(samples=16)
    top, bottom = gap_report.time_figure(shown.runs[0], shown.before_um[0], shown.after_um[0], NOISE_UM).axes
    for panel in (top, bottom):
        before, after = panel.lines[:2]
        assert before.get_ydata() == pytest.approx(shown.before_um[0] - shown.before_um[0].mean())
        assert after.get_ydata() == pytest.approx(shown.after_um[0] - shown.after_um[0].mean())


def test_recordings_before_and_after() -> None:
    runs = document()["runs"]
    panel = gap_report.runs_figure(runs, True).axes[0]
    marks = {line.get_label(): line.get_xdata() for line in panel.lines}
    assert marks["before"] == pytest.approx([run["rms_um"]["before"] for run in runs])
    assert marks["with the effects"] == pytest.approx([run["rms_um"]["after"] for run in runs])
    assert marks["at commissioning"] == pytest.approx(np.full(4, 0.1))
    assert marks["noise floor"] == pytest.approx(np.full(4, NOISE_UM))
    alone = gap_report.runs_figure([{**run, "ratio": None, "noise_floor_um": None} for run in runs], False).axes[0]
    assert [line.get_label() for line in alone.lines] == ["now"]
    many = gap_report.runs_figure(runs * 10, True).axes[0]
    assert len(many.get_yticks()) == gap_report.BARS
