"""Units of the columns that an import meets, and how people write them."""

from __future__ import annotations

import re

# unit -> dimension (by its base unit), power of ten to the base unit
UNITS = {
    "V": ("V", 0), "mV": ("V", -3), "kV": ("V", 3),
    "m": ("um", 6), "mm": ("um", 3), "um": ("um", 0), "nm": ("um", -3), "pm": ("um", -6),
    "s": ("s", 0), "ms": ("s", -3), "us": ("s", -6), "ns": ("s", -9),
    "degC": ("degC", 0),
}
LONGEST_NAME = 200
_SPELLINGS = {"µm": "um", "μm": "um", "micron": "um", "microns": "um", "µs": "us", "μs": "us", "sec": "s",
              "second": "s", "seconds": "s", "volt": "V", "volts": "V", "c": "degC", "°c": "degC",
              **{unit.lower(): unit for unit in UNITS}}


def known_unit(text: str) -> str | None:
    """The key of UNITS that a text means."""
    return text if text in UNITS else _SPELLINGS.get(text.lower())


def units_of(dimension: str | None) -> str:
    """The units of a dimension, or all, for a message."""
    return ", ".join(name for name, (of, _) in UNITS.items() if dimension in (None, of))


def split_unit(name: str) -> tuple[str, str | None]:
    """("pos", "nm") of "pos_nm", "pos [nm]", "pos (nm)", "pos/nm" or "pos nm"; the unit is None when there is none.

    An unknown unit in brackets is returned as it is written: better an error than a wrong scale. What is too long for a
    name has none: the patterns take time that grows with its square.
    """
    if len(name) > LONGEST_NAME:
        return name, None
    bracket = re.fullmatch(r"(.+?)[\s_]*[\[(]\s*([^\])]+?)\s*[\])]", name)
    if bracket:
        return bracket[1], known_unit(bracket[2]) or bracket[2]
    plain = re.fullmatch(r"(.+?)\s*[_\s/]\s*([^_\s/]+)", name)
    if plain and known_unit(plain[2]):
        return plain[1], known_unit(plain[2])
    return name, None
