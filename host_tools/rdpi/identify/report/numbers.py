"""Numbers with their units, and names that came from files, as reports write them."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...model import records
from ...simulate.effects import PARAMETERS
from ..localise import AxisEntry

NONE = "–"
SAME = 0.1  # relative: a gap within it is as large as what it is compared with
PICOMETRE = 1e-6  # um
LEAST = -1.0  # a shrink below it is told no closer


def number(value: float | None, digits: int = 3, strip: bool = True) -> str:
    """To so many significant digits, all digits before the point; "–" for None."""
    if value is None:
        return NONE
    size = magnitude(value)
    if not -5 < size < 7:
        text = f"{value:.{max(0, digits - 1)}e}"
    else:
        text = f"{value:.{max(0, digits - 1 - size)}f}"
        text = text.rstrip("0").rstrip(".") if strip and "." in text else text
    return text.replace("-", "−") if float(text) else text.replace("-", "")


def magnitude(value: float) -> int:
    """Power of ten of the first digit."""
    return math.floor(math.log10(abs(value))) if value else 0


def um(value: float) -> str:
    """A length in µm, or nm when it is very small; less than a picometre is 0."""
    return f"{number(1e3 * value)} nm" if PICOMETRE <= abs(value) < 1e-3 else \
        f"{number(value if abs(value) >= PICOMETRE else 0.0)} µm"


def percent(share: float) -> str:
    """0.074 as "7 %"."""
    return f"{_whole(100 * share)} %"


def shrink(share: float) -> str:
    """The same of a shrink; how much worse than twice the residual is told to nobody."""
    return percent(share) if share >= LEAST else f"< {percent(LEAST)}"


def shrinks(interval: Sequence[float] | None) -> str:
    """(0.7, 0.8) as "70 to 80 %"; "–" for None."""
    if interval is None:
        return NONE
    low, high = interval
    return shrink(high) if high < LEAST else f"{shrink(low).removesuffix(' %')} to {percent(high)}"


def change(before: float, after: float, word: str) -> str:
    """"0.412 to 0.100 µm rms": to the same number of decimals."""
    width = max(abs(before), abs(after))
    digits = [max(1, 3 + magnitude(value) - magnitude(width)) for value in (before, after)]
    return f"{number(before, digits[0], strip=False)} {word} {number(after, digits[1], strip=False)} µm rms"


def times(ratio: float) -> str:
    """To be followed by "the model missed"."""
    return "as much as" if abs(ratio - 1) <= SAME else f"{number(ratio, 2)} times what"


def tight(text: str) -> str:
    """With numbers that no line break parts from their units."""
    return re.sub(r"(?<=\d) (?=(%|[nµm]?[ms]|Hz|V)\b|%)", "\N{NO-BREAK SPACE}", text)


def _whole(value: float) -> str:
    return f"{round(value)}".replace("-", "−")


# ---- parameters of effects ----


def given(parameters: Mapping[str, records.EffectParameter]) -> dict[str, records.EffectParameter]:
    """Those that have a value and that a reader needs."""
    return {name: one for name, one in parameters.items()
            if one.value is not None and not PARAMETERS[name].internal}


def sized(name: str, parameter: records.EffectParameter, was: Mapping[str, float | None] | None = None) -> str:
    """Label, value and unit: "time constant 0.48 ms", "time constant from 0.30 ms to 0.48 ms" with what it was."""
    return f"{_label(name)} {quantity(name, parameter) if was is None else moved(name, was, parameter)}".strip()


def moved(name: str, was: Mapping[str, float | None], parameter: records.EffectParameter) -> str:
    """From the old value to the new one: "from 1.0 ms to 1.5 ms"; one that looks the same only once."""
    old = was.get(name)
    if old is None:
        return quantity(name, parameter)
    largest = max(old, parameter.value, key=abs)
    texts = [quantity(name, replace(parameter, value=value), largest) for value in (old, parameter.value)]
    return texts[1] if texts[0] == texts[1] else f"from {texts[0]} to {texts[1]}"


def _label(name: str) -> str:
    """Of a parameter, without its unit: "time constant" for time_constant_s, "" for V_per_s."""
    if "_per_" in name:
        return ""
    for unit in ("_s", "_um", "_hz"):
        name = name.removesuffix(unit)
    return name if "_" in name and name[0].isupper() else plain(name.replace("_", " "))


def unit_of(name: str, parameter: records.EffectParameter) -> str:
    """As it is written after a number."""
    unit = parameter.unit
    if unit == "%" and "_per_" in name:
        unit = f"% per {name.partition('_per_')[2].replace('_', ' ')}"
    return "" if unit == "1" else unit.replace("um", "µm").replace("degC", "°C")


def quantity(name: str, parameter: records.EffectParameter, largest: float | None = None) -> str:
    """Value and unit, to as many digits as the interval is worth, in the unit that suits the largest beside it."""
    factor, unit = _scale(parameter.value if largest is None else largest, unit_of(name, parameter))
    interval = _ends(parameter.ci95)
    if interval:
        return f"{_fixed(factor * parameter.value, factor * (interval[1] - interval[0]))} {unit}".strip()
    return f"{number(factor * parameter.value, PARAMETERS[name].digits)} {unit}".strip()


def interval(name: str, parameter: records.EffectParameter, unit: bool = True) -> str:
    """"95 % interval 0.48 to 0.56 ms", or "95 %: 0.48 to 0.56"; "" without one."""
    ends = _ends(parameter.ci95)
    if not ends:
        return ""
    factor, written = _scale(parameter.value, unit_of(name, parameter))
    low, high = (_fixed(factor * end, factor * (ends[1] - ends[0])) for end in ends)
    return f"95 % interval {low} to {high} {written}".strip() if unit else f"95 %: {low} to {high}"


def _scale(value: float, unit: str) -> tuple[float, str]:
    """Factor and unit that make a short time readable."""
    if unit != "s" or abs(value) >= 0.1 or value == 0:
        return 1.0, unit
    return (1e3, "ms") if abs(value) >= 1e-4 else (1e6, "µs")


def _ends(ends: Sequence[float] | None) -> Sequence[float] | None:
    """An interval whose two ends differ."""
    return ends if ends is not None and ends[1] > ends[0] else None


def _fixed(value: float, width: float) -> str:
    """`value` to two digits of half the width of its interval."""
    return number(value, max(1, 2 + magnitude(value) - magnitude(width / 2)), strip=False)


# ---- lists and names ----


def listed(items: Sequence[str], conjunction: str = "and") -> str:
    """"a", "a and b", "a, b and c"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {conjunction} {items[-1]}"


def bracketed(text: str) -> str:
    """" (text)", "" stays."""
    return f" ({text})" if text else ""


def sentence_of(text: str) -> str:
    """With a full stop, and with a capital if it does not begin with the name of a file; "" stays."""
    text = text.strip().rstrip(".")
    if not text:
        return ""
    first = text.split()[0]
    return f"{text}." if "." in first or "/" in first else f"{text[0].upper()}{text[1:]}."


def bin_names(axis: AxisEntry) -> list[str]:
    """Names of an axis's bins."""
    if axis.edges is not None:
        ends = edge_names(axis.edges)
        return [f"{low} to {high}" for low, high in zip(ends[:-1], ends[1:])]
    return ["at rest" if name == "rest" else plain(base(name)) for name in axis.bins]


def edge_names(values: Sequence[float]) -> list[str]:
    """Edges of bins to two digits, or to up to four if that tells them apart. What is nothing beside every bin, or beside
    all of them together, is 0.
    """
    nothing = max(0.01 * float(np.min(np.diff(values))), 1e-7 * float(np.ptp(values)))
    edges = [0.0 if abs(edge) < nothing else edge for edge in values]
    for digits in (2, 3, 4):
        texts = [number(edge, digits) for edge in edges]
        if len(set(texts)) == len(set(edges)):
            break
    return texts


def base(path: str) -> str:
    """A file's name without its folder."""
    return os.path.basename(path)


def plain(text: str, longest: int = 80) -> str:
    """Foreign text made fit to be read: printable, on one line, its middle left out when it is long."""
    text = "".join(letter if letter.isprintable() else " " if letter.isspace() else "?" for letter in text)
    return text if len(text) <= longest else f"{text[:longest // 2]}…{text[-(longest - longest // 2 - 1):]}"


def drawn(text: str, longest: int) -> str:
    """The same for a picture: no mathematics."""
    return plain(text, longest).replace("$", r"\$")
