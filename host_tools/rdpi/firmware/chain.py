"""What stands around the operator, as the firmware makes up for it: numbers of rdpi_f32_chain_params_t.

lib/include/rdpi/f32_chain.h says what they mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from .parameters import INT32_MAX, ONE, Scale

LEAD = 32  # RDPI_FLAG_LEAD
MAX_LEAD_NS, MAX_LEAD_NS2, MIN_DIRECT = 2**29, 2**60, 2**28  # RDPI_Q31_...
LEAST_DIRECT = 1e-3  # MIN_DIRECT in lib/src/f32_creep.h


@dataclass(frozen=True)
class Chain:
    """The chain around one operator; as it is by default, it does nothing."""

    delay_s: float = 0.0
    lag_s: float = 0.0  # of the amplifier
    lead_s: float = 0.0  # alpha
    lead_s2: float = 0.0  # beta
    max_lead_um: float = 1.0
    preview: bool = True
    direct: float = 1.0
    poles: tuple[tuple[float, float], ...] = ()  # share, time constant in s

    def __post_init__(self) -> None:
        numbers = {"delay_s": self.delay_s, "lag_s": self.lag_s, "lead_s": self.lead_s, "lead_s2": self.lead_s2}
        for name, value in numbers.items():
            if not 0 <= value < math.inf:
                raise BadInput(f"chain: {name}: is {value:g}; must not be negative")
        if not 0 < self.max_lead_um < math.inf:
            raise BadInput(f"chain: max_lead_um: is {self.max_lead_um:g}; must be positive")
        settled = self.direct + sum(share for share, _ in self.poles)
        if not (self.direct > 0 and settled > 0):
            raise BadInput(f"chain: of a move, a share of {self.direct:g} comes at once and {settled:g} in the end; "
                           "no inverse exists unless both are positive")
        back = -sum(min(share, 0.0) for share, _ in self.poles)
        if self.direct - back < LEAST_DIRECT:
            raise BadInput(f"chain: of a move, a share of {self.direct:.3g} comes at once and {back:.3g} is taken back "
                           "later; the firmware has no inverse unless that is less")
        if not all(0 < time_s < math.inf for _, time_s in self.poles):
            raise BadInput("chain: poles: the time constants must be positive")

    @property
    def leads_reference(self) -> bool:
        return self.delay_s > 0 or self.lead_s > 0 or self.lead_s2 > 0

    @property
    def leads(self) -> bool:
        """Whether it leads the reference, or the drive."""
        return self.leads_reference or self.lag_s > 0

    @property
    def acts(self) -> bool:
        """Whether it does anything."""
        return self.leads or bool(self.poles) or self.direct != 1

    def whole_delay(self, sample_time_s: float) -> int:
        """Samples of the delay that the preview makes up for, as single precision rounds them; the other engines may
        round half a sample the other way.
        """
        return int(np.float32(self.delay_s) / np.float32(sample_time_s) + np.float32(0.5)) if self.preview else 0

    def preview_samples(self, sample_time_s: float) -> int:
        """How far ahead of the present the firmware needs the reference, in single precision."""
        if not self.preview:
            return 0
        return (self.whole_delay(sample_time_s) + 1 if self.leads_reference else 0) + (self.lag_s > 0)

    def rounding_um(self, sample_time_s: float, largest_um: float) -> float:
        """About the rms by which single precision moves what drives the actuator, in um of the reference.

        The reference is rounded; the lead takes its second difference, and the lag's inverse the difference of that.
        """
        rounded = largest_um * float(np.finfo(np.float32).eps) / math.sqrt(24)
        led = math.hypot(1.0, self.lead_s / sample_time_s / math.sqrt(2), math.sqrt(6) * self.lead_s2 / sample_time_s**2)
        return rounded * led * max(1.0, self.lag_s / sample_time_s)


def ahead(reference_um: np.ndarray, samples: int) -> np.ndarray:
    """References so many samples ahead, as who knows the future passes them; the last one is held at the end."""
    if not samples or not len(reference_um):
        return reference_um
    held = np.full(min(samples, len(reference_um)), reference_um[-1])
    return np.concatenate([reference_um[samples:], held])


@dataclass(frozen=True)
class F32Chain:
    """rdpi_f32_chain_params_t without schema, digest and axis; every number as `dtype` rounds it."""

    poles: int
    preview: int
    delay_s: float
    lag_s: float
    lead_s: float
    lead_s2: float
    max_lead_um: float
    direct: float
    pole: np.ndarray  # (poles, 2): share, time constant


def f32_chain(chain: Chain, dtype: type = np.float32) -> F32Chain:
    """Parameters in single precision, or with np.float64 those of the library compiled for double."""
    def rounded(value: float) -> float:
        return float(dtype(value))

    return F32Chain(len(chain.poles), int(chain.preview), *(rounded(value) for value in (
        chain.delay_s, chain.lag_s, chain.lead_s, chain.lead_s2, chain.max_lead_um, chain.direct)),
        np.array(chain.poles, dtype).reshape(-1, 2))


@dataclass(frozen=True)
class Q31Chain:
    """rdpi_q31_chain_params_t without schema, digest and axis."""

    lead_ns2: int
    delay_ns: int
    lag_ns: int
    lead_ns: int
    max_lead: int
    direct: int
    poles: int
    preview: int
    pole: tuple[tuple[int, int], ...]  # share, time constant in ns


def q31_chain(chain: Chain, scale: Scale, where: str) -> Q31Chain:
    """Parameters in fixed point, in the units of the operator's. Raises BadInput, naming the number, for what 32 bits
    do not hold. `where` names the model in messages.
    """
    def refuse(key: str, what: str) -> None:
        raise BadInput(f"{where}: no fixed point: {key}: {what}")

    delay_ns, lag_ns, lead_ns, lead_ns2 = (round(value * unit) for value, unit in (
        (chain.delay_s, 1e9), (chain.lag_s, 1e9), (chain.lead_s, 1e9), (chain.lead_s2, 1e18)))
    if max(delay_ns, lag_ns) > MAX_LEAD_NS:
        refuse("delay and lag", f"{chain.delay_s:.3g} s and {chain.lag_s:.3g} s; fixed point makes up for half a "
                                "second of each at most")
    if lead_ns > MAX_LEAD_NS or lead_ns2 > MAX_LEAD_NS2:
        refuse("lead", f"{chain.lead_s:.3g} s and {chain.lead_s2:.3g} s^2, for a resonance; fixed point takes half "
                       "a second and 1.15 s^2 at most")
    direct = round(chain.direct * ONE)
    poles = tuple((round(share * ONE), max(round(time_s * 1e9), 1)) for share, time_s in chain.poles)
    shares = [share for share, _ in poles]
    if direct + sum(map(abs, shares)) > 2 * ONE or direct + sum(share for share in shares if share < 0) < MIN_DIRECT:
        refuse("creep and relaxation", f"of a move, {chain.direct:.3g} comes at once and {sum(shares) / ONE:.3g} late; "
                                       "fixed point takes at least a quarter at once, and two moves in all")
    most = min(max(round(chain.max_lead_um / scale.um_per_reference), 1), INT32_MAX)
    return Q31Chain(lead_ns2, delay_ns, lag_ns, lead_ns, most, direct, len(poles), int(chain.preview), poles)
