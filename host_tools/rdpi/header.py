"""The C header of one actuator: a model as the const parameters that rdpi_f32_init takes (lib/include/rdpi/rdpi.h)."""

from __future__ import annotations

import os
import re
import unicodedata
from operator import attrgetter
from typing import Any

import jinja2
import numpy as np

from . import version
from .errors import BadInput
from .firmware import Firmware, scalars
from .model import Model
from .recording import atomic_write

SCHEMA = 1  # of rdpi_f32_params_t as the template fills it in; the header compares it with the library's
NAME = "rdpi_params"

# Fields of rdpi_f32_params_t in its order, and what the header says of each; for arrays also key in the model and length.
ARRAYS = {
    "thresholds_um": ("thresholds_um", "PLAYS", "r_0 = 0 < r_1 < ... < r_n, um: play thresholds (eq. 1)"),
    "slopes": ("slopes", "PLAYS", "W_0 ... W_n at rate 0: slopes of the loading curve, not play weights (eq. 15)"),
    "slope_rate_s_per_um": ("slope_rate_s_per_um", "PLAYS", "c_0 ... c_n, s/um: W_i(rate) = W_i + c_i rate (eq. 14)"),
    "deadzones_um": ("deadzones_um", "DEADZONES", "d_0 = 0 < d_1 < ... < d_m, um: dead-zone thresholds (eq. 7)"),
    "deadzone_weights": ("deadzone_weights", "DEADZONES", "ws_0 ... ws_m: dead-zone weights (eq. 8)"),
    "memory_um": ("memory.plays_um", "PLAYS", "y_0 ... y_n, um: the plays at power up; y_0 is x"),
}
SCALARS = {
    "gain_um_per_V": "um/V: x = gain (V - offset_V)",
    "offset_V": "V",
    "offset_um": "um: displacement = z + offset_um",
    "rate_window_s": "s: the rate is a difference over this time ...",
    "rate_filter_s": "s: ... through a low-pass of this time constant",
    "max_um_per_s": "um/s: the guard clamps the rate to this",
    "min_slope_ratio": "what is left of every slope at that rate, at least",
    "min_V": "V: output range",
    "max_V": "V",
    "slew_V_per_s": "V/s: largest change of the output; 0: unlimited",
}

# Of C and C++ to date and of GNU's compilers; types and macros of the headers that rdpi.h includes.
KEYWORDS = frozenset("""
    NULL alignas alignof and and_eq asm auto bitand bitor bool break case catch char class co_await co_return co_yield
    compl concept const const_cast consteval constexpr constinit continue decltype default delete do double dynamic_cast
    else enum explicit export extern false float for friend goto if inline int linux long main mutable namespace new
    noexcept not not_eq nullptr offsetof operator or or_eq private protected public register reinterpret_cast requires
    restrict return short signed sizeof static static_assert static_cast struct switch template this thread_local throw
    true try typedef typeid typename typeof typeof_unqual union unix unsigned using virtual void volatile while xor
    xor_eq
""".split())
RESERVED = re.compile(r"\w+_t|U?INT\w*_(MIN|MAX|WIDTH|C)|(PTRDIFF|SIG_ATOMIC|SIZE|WCHAR|WINT)_(MIN|MAX|WIDTH)")

_TEMPLATES = jinja2.Environment(loader=jinja2.PackageLoader(__package__), undefined=jinja2.StrictUndefined,
                                trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)


def render(model: Model, name: str = NAME, source: str = "") -> str:
    """The header's text; the same for the same model, whenever and wherever it is made.

    `name` is what the parameters are called in C, and the prefix of arrays and (in capitals) macros, so that a firmware
    can hold several actuators. `source` is the model's file, for the banner and for messages.
    Raises BadInput for a name that C cannot use and for a model that 32-bit floats cannot hold.
    """
    _check_name(name)
    where = source or "model"
    model.validate(where)
    try:
        Firmware(model, max(model.rate.window_s, 1e-3), "f32")  # at a sample time for which the window is short
    except BadInput as error:
        raise BadInput(f"{where}: rounded to single precision, {error}; move the model away from this limit") from None
    fields = scalars(model)
    return _TEMPLATES.get_template("rdpi_params.h.j2").render(
        name=name, NAME=name.upper(), schema=SCHEMA, version=comment(version()), source=comment(_file_name(source)),
        actuator=comment(model.actuator), digest=model.digest(), rate_source=model.rate.source, runs=_runs(model.fit),
        plays=len(model.thresholds_um), deadzones=len(model.deadzones_um), dac_bits=int(fields["dac_bits"]),
        arrays=[(field, length, text, [literal(value) for value in attrgetter(key)(model)])
                for field, (key, length, text) in ARRAYS.items()],
        scalars=[(field, text, literal(fields[field])) for field, text in SCALARS.items()])


def write_header(model: Model, path: str | os.PathLike[str], name: str = NAME, source: str = "") -> None:
    """Render and write atomically. Raises BadInput as `render` does, OSError when the file cannot be written."""
    atomic_write(path, render(model, name, source))


def literal(value: float) -> str:
    """A C literal that reads back as the float32 nearest to `value`, bit for bit: nine significant digits do."""
    return f"{float(np.float32(value)):#.9g}f"


def comment(text: str, length: int = 100) -> str:
    """Foreign text made fit for a C comment: one line of ASCII that cannot end the comment or make trigraphs."""
    text = unicodedata.normalize("NFKD", " ".join(text.split())).replace("\u03bc", "u")  # the Greek letter of um
    text = "".join(letter for letter in text if not unicodedata.combining(letter))
    return re.sub(r"[^A-Za-z0-9 .,:;_+()\[\]<>=%&@#'/-]", "_", text)[:length].rstrip()


def _check_name(name: str) -> None:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,39}", name) or name in KEYWORDS or RESERVED.fullmatch(name):
        raise BadInput(f"name {name[:60]!r}: must be a C identifier of at most 40 letters, digits and _, starting with "
                       "a letter, and no keyword, standard macro or type (..._t) of C or C++")
    if re.match(r"rdpi_(?!params_)", name + "_", re.IGNORECASE):
        raise BadInput(f"name {name!r}: names that start with rdpi_ belong to the library; use another, or {NAME}_…")


def _file_name(path: str) -> str:
    return re.split(r"[\\/]", path)[-1]


def _runs(fit: dict[str, Any]) -> list[dict[str, str]]:
    """What the banner says about each run the model was fitted to or tested on."""
    runs = fit.get("runs")
    lines = []
    for run in runs if isinstance(runs, list) else []:  # nothing has checked this part of the model file
        run = run if isinstance(run, dict) else {"file": run}
        percents = {kind: run.get(f"{kind}_percent") for kind in ("rms", "max")}
        errors = ", ".join(f"{kind} {percent:.3g} %" for kind, percent in percents.items()
                           if isinstance(percent, (int, float)) and abs(percent) < 1e9)  # no float holds some integers
        lines.append({"file": comment(_file_name(str(run.get("file", ""))), 60), "held_out": bool(run.get("held_out")),
                      "errors": f"{errors} of stroke" if errors else "", "digest": comment(str(run.get("digest", "")))})
    return lines
