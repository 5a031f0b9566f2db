"""The C header of one actuator: a model as the const parameters that rdpi_f32_init and rdpi_q31_init take; see
lib/include/rdpi/f32.h and q31.h."""

from __future__ import annotations

import hashlib
import os
import re
import unicodedata
from collections.abc import Callable, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import version
from ..data import atomic_write
from ..errors import BadInput
from ..model import Model
from .chain import Chain, Q31Chain, f32_chain
from .library import Firmware, FixedPoint, digest
from .parameters import INT32_MAX, Q31

if TYPE_CHECKING:
    import jinja2

SCHEMA = 8  # of the parameters as the template fills them in; the header compares it with the library's
NAME = "rdpi_params"

# What the header says of the fields of rdpi_f32_params_t, in its order. Tables: type, length, columns.
TABLES = {
    "play": ("rdpi_f32_play_t", "PLAYS", "r, um; W at rate 0; c, s/um; intercept at rate 0, um, and its change, s"),
    "saturation": ("rdpi_f32_deadzone_t", "DEADZONES", "S (eq. 8): d, um; weight"),
    "inverse_saturation": ("rdpi_f32_piece_t", "DEADZONES",
                           "S^-1 (eq. 13): references from and to, um; slope; intercept, um"),
    "curve": ("rdpi_f32_line_t", "CURVE_PIECES",
              "input curve: to V, um; middle, reach, um; gain, um/V, 1 / gain; offset_V; codes from, to; x and codes"),
    "memory_um": ("rdpi_real_t", "PLAYS", "y_0 ... y_n, um: the plays at power up; y_0 is x"),
}
SCALARS = {
    "offset_um": "um: displacement = z + offset_um",
    "rate_window_s": "s: the rate is a difference over this time ...",
    "rate_filter_s": "s: ... through a low-pass of this time constant",
    "max_um_per_s": "um/s: the guard clamps the rate to this",
    "min_slope_ratio": "what is left of every slope at that rate, at least",
    "min_V": "V: output range",
    "max_V": "V",
    "slew_V_per_s": "V/s: largest change of the output; 0: unlimited",
    "sweep_V_per_s": "V/s: speed of the start-up sweep ...",
    "sweep_end_V": "V: ... and where it ends",
    "sweep_forgotten": "share of what the sweep leaves in the plays that the actuator forgets",
    "min_sample_time_s": "s: rdpi_f32_init refuses a shorter sample time ...",
    "max_sample_time_s": "s: ... and a longer one",
    "last_code": "2^DAC_BITS - 1",
    "V_per_code": "V: drive = V_per_code code + min_V",
}

# What it says of the fields of rdpi_f32_chain_params_t and of rdpi_q31_chain_params_t, in their order.
CHAIN_SCALARS = {
    "poles": "",
    "preview": "1: the caller knows the future, and passes it; 0: it is extrapolated",
    "delay_s": "s: delay",
    "lag_s": "s: lag of the amplifier",
    "lead_s": "s: alpha of the lead",
    "lead_s2": "s^2: beta of the lead",
    "max_lead_um": "um: the most that the lead adds",
    "direct": "share of a move that comes at once",
}
Q31_CHAIN_SCALARS = {
    "lead_ns2": ("ull", "ns^2: beta of the lead"),
    "delay_ns": ("u", "ns: delay"),
    "lag_ns": ("u", "ns: lag of the amplifier"),
    "lead_ns": ("u", "ns: alpha of the lead"),
    "max_lead": ("", "the most that the lead adds"),
    "direct": ("", "times 2^30: share of a move that comes at once"),
    "poles": ("", ""),
    "preview": ("", "1: the caller knows the future, and passes it; 0: it is extrapolated"),
}

# The same for rdpi_q31_params_t; scalars also with what C has after a literal of their type.
Q31_TABLES = {
    "play": ("rdpi_q31_play_t", "PLAYS", "r; W at rate 0, and its change up to the guard; 2^30 is the largest W"),
    "saturation": ("rdpi_q31_deadzone_t", "DEADZONES", "S (eq. 8): d; weight"),
    "inverse_saturation": ("rdpi_q31_deadzone_t", "DEADZONES", "S^-1 (eq. 13): d; weight"),
    "curve": ("rdpi_q31_line_t", "CURVE_PIECES",
              "input curve: from drive and x; x per drive and inverse, times 2 to the shifts; not read if straight"),
    "memory": ("int32_t", "PLAYS", "y_0 ... y_n: the plays at power up; y_0 is x"),
}
Q31_SCALARS = {
    "slew_per_us": ("ull", "largest change of the output, drive units per us times 2^32; 0: unlimited"),
    "sweep_per_us": ("ull", "speed of the start-up sweep, likewise"),
    "plays": ("", ""),
    "deadzones": ("", ""),
    "dac_bits": ("", ""),
    "curve_pieces": ("", "of the input curve; 1: it is straight"),
    "noise_shaping": ("", "1: what a code misses is carried to the next one"),
    "sweep_cycles": ("", "of the start-up sweep"),
    "saturation_shift": ("", "of the weights of S"),
    "inverse_shift": ("", "of the weights of S^-1"),
    "code_shift": ("", "of codes_per_drive"),
    "drive_shift": ("", "of drive_per_code"),
    "guard_exponent": ("", "the guard is guard_mantissa 2^guard_exponent reference units per ns"),
    "min_slope_ratio": ("", "of 65536: what is left of every slope at the guard, at least"),
    "guard_mantissa": ("u", ""),
    "rate_window_ns": ("u", "ns: the rate is a difference over this time ..."),
    "rate_filter_ns": ("u", "ns: ... through a low-pass of this time constant"),
    "min_drive": ("", "output range"),
    "max_drive": ("", ""),
    "min_x": ("", "x there"),
    "max_x": ("", ""),
    "min_mV": ("", "mV: output range, for an exchange of parameters"),
    "max_mV": ("", "mV"),
    "unit_mantissa": ("u", "a reference unit is unit_mantissa 2^unit_exponent um"),
    "unit_exponent": ("", ""),
    "drive_of_code_0": ("", ""),
    "codes_per_drive": ("", "times 2^code_shift"),
    "drive_per_code": ("", "times 2^drive_shift"),
    "sweep_end": ("", "drive at which the start-up sweep ends"),
    "sweep_forgotten": ("", "times 2^30: share of what the sweep leaves in the plays that the actuator forgets"),
    "min_sample_time_ns": ("u", "ns: rdpi_q31_init refuses a shorter sample time ..."),
    "max_sample_time_ns": ("u", "ns: ... and a longer one"),
}

# Of C and C++ to date and of GNU's compilers; names of the standard headers are in templates/c_names.txt.
KEYWORDS = frozenset("""
    NULL alignas alignof and and_eq asm auto bitand bitor bool break case catch char class co_await co_return co_yield
    compl concept const const_cast consteval constexpr constinit continue decltype default delete do double dynamic_cast
    else enum explicit export extern false float for friend goto if inline int linux long main mutable namespace new
    noexcept not not_eq nullptr offsetof operator or or_eq private protected public register reinterpret_cast requires
    restrict return short signed sizeof static static_assert static_cast struct switch template this thread_local throw
    true try typedef typeid typename typeof typeof_unqual union unix unsigned using virtual void volatile while xor
    xor_eq
""".split())
RESERVED = re.compile(r"\w+_t|\w*__\w*|U?INT\w*_(MIN|MAX|WIDTH|C)|(PTRDIFF|SIG_ATOMIC|SIZE|WCHAR|WINT)_(MIN|MAX|WIDTH)")


@cache
def template(name: str) -> jinja2.Template:
    """A template of this room."""
    import jinja2

    return jinja2.Environment(loader=jinja2.PackageLoader(__package__), undefined=jinja2.StrictUndefined, trim_blocks=True,
                              lstrip_blocks=True, keep_trailing_newline=True).get_template(name)


def render(model: Model, name: str = NAME, source: str = "", chain: Chain = Chain(),
           addends: Sequence[tuple[str, float, bool]] = (), jump: tuple[float, float] = (0.0, 0.0)) -> str:
    """The header's text; the same for the same model, whenever and wherever it is made.

    `name` is what the parameters are called in C, and the prefix of arrays and (in capitals) macros, so that a firmware
    can hold several actuators. `source` is the model's file, for the banner and for messages. `addends` are columns of
    recordings, the displacement in um per unit of each, which the application subtracts from the reference, and whether
    only what the column has changed since the start counts.
    `jump` is the width of backlash in um and the time in s that its jump at a reversal is spread over.
    Raises BadInput for a name that C cannot use, for columns of one name in C, and for a model that 32-bit floats cannot
    hold.
    """
    return _render(model, name, source, chain, addends, jump).text


class Header(NamedTuple):
    """A header that was rendered."""

    text: str
    digest: str  # of the model, Model.digest; of the chain too if it does something
    no_fixed_point: str  # why it has no parameters in fixed point; "" if it has
    rates_hz: tuple[float, float]  # lowest and highest sample rate that init takes, to four digits


def _render(model: Model, name: str, source: str, chain: Chain, addends: Sequence[tuple[str, float, bool]],
            jump: tuple[float, float]) -> Header:
    _check_name(name)
    where = source or model.where
    model.validate(where)
    try:
        single = Firmware(model, _sample_time_s(model), "f32", chain, any_sample_time=True).parameters
    except BadInput as error:
        raise BadInput(f"{where}: rounded to single precision, {error}; move the model away from this limit") from None
    numbers, chain_numbers, reason = fixed_point(model, chain)
    model_digest = _digest(model, chain)
    text = template("rdpi_params.h.j2").render(
        name=name, NAME=name.upper(), schema=SCHEMA, version=comment(version()), source=comment(file_name(source)),
        actuator=comment(model.actuator), digest=model_digest, rate_source=model.rate.source, runs=_runs(model.fit),
        plays=single.plays, deadzones=single.deadzones, dac_bits=single.dac_bits, curve_pieces=single.curve_pieces,
        noise_shaping=single.noise_shaping, sweep_cycles=single.sweep_cycles,
        limits_V=(float(model.drive.min_V), float(model.drive.max_V)), times_s=model.sample_times_s(),
        sweep_step_V=float(model.sample_times_s()[1] * model.drive.sweep_speed()),
        params_digest=f"0x{digest(single):08X}u", identity=model_digest.removeprefix("sha256:")[:16].upper(),
        tables=[(field, *about, _rows(getattr(single, field), literal)) for field, about in TABLES.items()],
        scalars=[(field, text, literal(getattr(single, field))) for field, text in SCALARS.items()],
        chain=chain_name(name), **_chain_parts(chain), addends=_addends(addends),
        jump=[f"({float(part)!r})" for part in jump] if jump[0] else None,
        **_q31_parts(numbers, chain_numbers, reason))
    return Header(text, model_digest, reason, _rates_hz(model))


def _rates_hz(model: Model) -> tuple[float, float]:
    """The range of sample rates, rounded inwards: init takes both ends as they are printed."""
    highest_hz, lowest_hz = (1 / time_s for time_s in model.sample_times_s())
    down, up = Context(4, ROUND_FLOOR), Context(4, ROUND_CEILING)
    # 1 / time_s of a round rate may miss it by a bit, and init compares in single precision.
    return (float(up.create_decimal_from_float(lowest_hz * (1 - 1e-9))),
            float(down.create_decimal_from_float(highest_hz * (1 + 1e-9))))


def write_header(model: Model, path: str | os.PathLike[str], name: str = NAME, source: str = "",
                 chain: Chain = Chain(), addends: Sequence[tuple[str, float, bool]] = (),
                 jump: tuple[float, float] = (0.0, 0.0)) -> Header:
    """Render and write atomically. Raises BadInput as `render` does, OSError when the file cannot be written."""
    header = _render(model, name, source, chain, addends, jump)
    atomic_write(path, header.text)
    return header


def chain_name(name: str) -> str:
    """What the chain around the parameters of this name is called."""
    return "rdpi_chain" if name == NAME else f"{name}_chain"


def fixed_point(model: Model, chain: Chain = Chain()) -> tuple[Q31 | None, Q31Chain | None, str]:
    """The parameters in fixed point, or None and the reason why this valid model and its chain have none."""
    try:
        one = FixedPoint(model, _sample_time_s(model), chain, any_sample_time=True)
        return one.parameters, one.chain, ""
    except BadInput as error:
        return None, None, str(error).rpartition("no fixed point: ")[2]


def _digest(model: Model, chain: Chain) -> str:
    if not chain.acts:
        return model.digest()
    return "sha256:" + hashlib.sha256(f"{model.digest()} {chain!r}".encode()).hexdigest()


def _chain_parts(chain: Chain) -> dict[str, Any]:
    numbers = f32_chain(chain)
    whole = "poles", "preview"
    return {"chain_acts": int(chain.acts), "chain_digest": f"0x{digest(numbers):08X}u", "poles": numbers.poles,
            "chain_scalars": [(field, text, str(getattr(numbers, field)) if field in whole else
                               literal(getattr(numbers, field))) for field, text in CHAIN_SCALARS.items()],
            "chain_rows": _rows(numbers.pole, literal)}


def _addends(addends: Sequence[tuple[str, float, bool]]) -> list[tuple[str, str, str, bool]]:
    """Macro's name without prefix, column, um per unit, and whether only its change since the start counts."""
    columns: dict[str, str] = {}  # by macro
    rows = []
    for column, size, from_first in addends:
        macro = re.sub(r"[^A-Z0-9]+", "_", comment(column).upper())
        if columns.setdefault(macro, column) != column:
            raise BadInput(f"columns {columns[macro]} and {column}: are the same name in C, {macro}; rename one in the "
                           "recordings and in the model")
        rows.append((macro, comment(column), f"({float(size)!r})", from_first))
    return rows


def _sample_time_s(model: Model) -> float:
    """One for which the rate window is short and the start-up sweep fast enough."""
    return max(model.rate.window_s, 1e-3, 2 * model.shortest_sample_s())


def _q31_parts(numbers: Q31 | None, chain: Q31Chain | None, reason: str) -> dict[str, Any]:
    if numbers is None or chain is None:
        return {"q31": False, "q31_reason": comment(reason, 300)}
    scale = numbers.scale
    reach_um = INT32_MAX * scale.um_per_reference
    return {
        "q31": True, "q31_digest": f"0x{digest(numbers):08X}u",
        "q31_tables": [(field, *about, _rows(getattr(numbers, field), str)) for field, about in Q31_TABLES.items()],
        "q31_scalars": [(field, text, f"{getattr(numbers, field)}{suffix}")
                        for field, (suffix, text) in Q31_SCALARS.items()],
        "q31_chain_digest": f"0x{digest(chain):08X}u",
        "q31_chain_scalars": [(field, text, f"{getattr(chain, field)}{suffix}")
                              for field, (suffix, text) in Q31_CHAIN_SCALARS.items()],
        "q31_chain_rows": [f"{{{share}, {time_ns}ull}}," for share, time_ns in chain.pole],
        "q31_scale": {key: f"({float(value)!r})" for key, value in (
            ("per_um", 1 / scale.um_per_reference), ("um", scale.um_per_reference), ("offset_um", scale.offset_um),
            ("V", scale.V_per_drive), ("offset_V", scale.offset_V), ("rate", scale.um_per_s_per_rate))},
        "q31_reach": [f"{scale.offset_um + sign * reach_um:.6g}" for sign in (-1, 1)]}


def literal(value: float) -> str:
    """A C literal that reads back as the float32 nearest to `value`, bit for bit: nine significant digits do."""
    return f"{float(np.float32(value)):#.9g}f"


def _rows(table: np.ndarray, text: Callable[[float], str]) -> list[str]:
    """The rows of an initialiser: one struct each, or of a plain array six numbers each."""
    if table.ndim == 2:
        return [line for row in table for line in _lines("{" + ", ".join(map(text, row)) + "},", 7)]
    return _lines(", ".join(map(text, table)) + ",", 6)


def _lines(text: str, numbers: int) -> list[str]:
    """A list of numbers as lines of so many."""
    words = text.split()
    return [" ".join(words[k:k + numbers]) for k in range(0, len(words), numbers)]


def comment(text: str, length: int = 100) -> str:
    """Foreign text made fit for a C comment: one line of ASCII that cannot end the comment or make trigraphs."""
    text = unicodedata.normalize("NFKD", " ".join(text.split())).replace("\u03bc", "u")  # the Greek letter of um
    text = "".join(letter for letter in text if not unicodedata.combining(letter))
    return re.sub(r"[^A-Za-z0-9 .,:;_+()\[\]<>=%&@#'/-]", "_", text)[:length].rstrip()


def _check_name(name: str) -> None:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,39}", name) or name in KEYWORDS or RESERVED.fullmatch(name):
        raise BadInput(f"name {name[:60]!r}: must be a C identifier of at most 40 letters, digits and _, starting with "
                       "a letter, without __, and no keyword, standard macro or type (..._t) of C or C++")
    if name in standard_names():
        raise BadInput(f"name {name!r}: a standard header of C, of POSIX or of a compiler's library has this name; use "
                       f"another, or {NAME}_…")
    if re.match(r"rdpi_(?!params_)", name + "_", re.IGNORECASE):
        raise BadInput(f"name {name!r}: names that start with rdpi_ belong to the library; use another, or {NAME}_…")


def standard_names() -> frozenset[str]:
    """What the C libraries of GNU, newlib and picolibc declare at file scope in the headers of standard C."""
    return frozenset(resources.files(__package__).joinpath("templates", "c_names.txt").read_text("ascii").split())


def file_name(path: str) -> str:
    """The last part of a path of any system."""
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
        lines.append({"file": comment(file_name(str(run.get("file", ""))), 60), "held_out": bool(run.get("held_out")),
                      "errors": f"{errors} of stroke" if errors else "", "digest": comment(str(run.get("digest", "")))})
    return lines
