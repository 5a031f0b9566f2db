"""What the firmware does about an effect: each effect says it for itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from ...model import Model

How = Literal["compensated", "folded", "left out"]


class Addend(NamedTuple):
    """Displacement in um per unit of a recorded column, which the application subtracts from the reference."""

    column: str
    um_per_unit: float
    from_first: bool  # of the column's change since the start


class Sensor(NamedTuple):
    """How late the sensor is, from its data sheet: that much of what was found is not the actuator's."""

    delay_s: float = 0.0
    lag_s: float = 0.0


@dataclass(frozen=True)
class Treatment:
    """What the firmware does about one effect, and the numbers of its part."""

    how: How
    text: str  # by what it is compensated, or into what it is folded, or why it is left out
    model: Model | None = None  # the operator with the effect folded in
    delay_s: float = 0.0
    lag_s: float = 0.0  # of the amplifier
    lead: tuple[float, float] = (0.0, 0.0)  # alpha in s, beta in s^2 of 1 + alpha s + beta s^2
    direct: float = 1.0
    poles: tuple[tuple[float, float], ...] = ()  # share, time constant in s
    addend: Addend | None = None
    jump_um: float = 0.0  # between two reversals of the reference


def left_out(why: str) -> Treatment:
    return Treatment("left out", why)


def folded(into: str, model: Model) -> Treatment:
    return Treatment("folded", into, model)
