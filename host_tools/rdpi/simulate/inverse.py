"""What the firmware inverts: the operator with all folded in that folds, and the chain in front of it."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..data import Recording, arguments
from ..errors import BadInput
from ..firmware import Chain
from ..model import Model, guarded, operators
from . import effects, signals
from .effects import SENSOR, Acting, Addend, Sensor, Treatment, left_out
from .effects.planned import time_text
from .memory import within_drive

ALL = "all"  # in place of names
APART = 1.005  # least ratio of two poles' time constants: nearer ones would make shares that cancel each other
# The most that the lead adds, as a share of the stroke. A sine over all of the stroke needs that much where the lead is
# half a radian of it, beyond which it is no good.
MOST_LEAD = 0.25
FREQUENCIES_HZ = 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0
LARGEST_ERROR = 1.0  # of the amplitude, up to which the table goes
# Radians of a resonance in the delay, from which corners may ring more without preview if it is made up for: at 90 degrees
# the two add up to sqrt(2) of what rings without. A lag and limits of the drive round corners off, and then they do not.
LATE_RAD = 1.2
JUMP_S, JUMPS_S = 0.002, (1e-6, 10.0)  # that a jump over backlash is spread over, unless told otherwise; what is taken


class Told(NamedTuple):
    """What the firmware does about one effect."""

    acting: Acting
    how: str  # compensated, folded or left out
    why: str

    def __str__(self) -> str:
        return f"{self.acting}: {self.how}{':' if self.how == 'left out' else ''} {self.why}"

    def to_json(self) -> dict[str, Any]:
        return {"name": self.acting.effect.name, "stage": self.acting.effect.stage, "firmware": self.how,
                "why": self.why}


class Jump(NamedTuple):
    """What the application adds to the reference to cross backlash: half of `um` with the way the reference goes."""

    um: float = 0.0
    seconds: float = JUMP_S  # that it is spread over

    def added_um(self, reference_um: np.ndarray, sample_time_s: float) -> np.ndarray:
        """(samples,); 0 until the reference first moves. What is no reference is passed over."""
        usable = np.abs(reference_um) <= operators.MAX_REFERENCE_UM
        way = np.zeros(len(reference_um))
        way[usable] = np.sign(np.diff(reference_um[usable], prepend=reference_um[usable][:1]))
        latest = np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), 0))
        return signals.limited(self.um / 2 * way[latest], self.um * sample_time_s / self.seconds)


@dataclass(frozen=True)
class Inverse:
    """What a firmware is made of, and what it does about each effect of the model."""

    model: Model  # the operator to invert
    chain: Chain
    told: tuple[Told, ...]
    addends: tuple[Addend, ...]
    jump: Jump
    lags: tuple[tuple[float, float], ...]  # alpha and beta of each lag and resonance that the lead makes up for
    alone: bool  # whether the operator is the one that was fitted as if nothing stood around it

    @property
    def lines(self) -> list[str]:
        """For people, one per effect; last, which operator it is if effects are left out."""
        lines = [str(one) for one in self.told]
        if self.alone:
            lines.append("the operator is the one that was fitted as if nothing stood around it")
        elif any(one.how == "left out" for one in self.told) and self.model.operator_alone is not None:
            lines.append("the operator is the one that was fitted beside the effects; it takes up nothing of those "
                         "that are left out")
        return lines

    def check_sweep(self, run: Recording) -> None:
        """Raise BadInput, naming key or effect, for a start-up sweep that is too slow for this recording's samples."""
        if run.sample_time_s >= self.model.shortest_sample_s():
            return
        drive = self.model.drive
        limit = next((one.acting.effect.name for one in self.told
                      if one.how == "folded" and drive.slew_V_per_s in one.acting.values.values()), "")
        remedy = f"give --leave-out {limit}" if limit else "raise sweep_V_per_s or slew_V_per_s"
        raise BadInput(f"{self.model.where}: {limit or 'drive'}: the start-up sweep, {drive.sweep_speed():.4g} V/s, is too slow for more "
                       f"than {1 / self.model.shortest_sample_s():.3g} samples per second in single precision "
                       f"({run.path}: sample_time_s is {run.sample_time_s:g}); {remedy}, or take another --engine")

    def added_um(self, run: Recording) -> np.ndarray:
        """What the application subtracts from the reference, (samples,), as far as the run holds its columns."""
        added = np.zeros(len(run))
        for column, um_per_unit, from_first in self.addends:
            if column in run.columns:
                values = run.columns[column]
                added += um_per_unit * (values - values[0] if from_first else values)
        return added

    def wanted_um(self, run: Recording, reference_um: np.ndarray) -> np.ndarray:
        """What the actuator itself is to follow, (samples,), so that the stage follows the reference."""
        return reference_um - self.added_um(run) + self.jump.added_um(reference_um, run.sample_time_s)

    def costs(self) -> list[tuple[float, float, float]]:
        """Of a sine: frequency in Hz, error of the displacement as a share of the amplitude if no lead were there, and
        with the lead. Without end are neither the sample rate nor what the plays make of it.
        """
        rows = []
        chain = self.chain
        for frequency in FREQUENCIES_HZ if chain.leads else ():
            s = 2j * math.pi * frequency
            late = np.exp(-s * chain.delay_s) / np.prod([1 + alpha * s + beta * s**2 for alpha, beta in self.lags])
            led = 1 + chain.lead_s * s + chain.lead_s2 * s**2
            unlagged = 1 + chain.lag_s * s
            if chain.preview:
                lead = led * np.exp(s * chain.delay_s)
            else:
                d = chain.delay_s
                lead = led + d * s + (chain.lead_s * d + d**2 / 2) * s**2
            row = frequency, float(abs(1 - late)), float(abs(1 - late * lead * unlagged))
            if rows and max(row[1:]) > LARGEST_ERROR:
                break
            rows.append(row)
        return rows

    def rings_late(self) -> str | None:
        """Why corners may ring more with this inverse than if it left its resonances out: what makes up for a resonance
        comes later by the delay where there is no preview. None: not so late.
        """
        ringing = [one.acting.effect.name for one in self.told if one.how == "compensated" and one.acting.effect.rings]
        slowest_s = max((math.sqrt(beta) for _, beta in self.lags), default=0.0)
        if self.chain.preview or not ringing or self.chain.delay_s < LATE_RAD * slowest_s:
            return None
        return (f"what makes up for {ringing[0]} comes {self.chain.delay_s / (2 * math.pi * slowest_s):.2g} of its periods late "
                f"without preview, so that references with corners, such as triangles, may ring more; try --leave-out {ringing[0]} for them")


def inverse_of(model: Model, *, leave_out: Collection[str] = (), preview: bool = True,
               sensor: Sensor = Sensor(), jump_s: float = JUMP_S) -> Inverse:
    """The inverse of a model and what stands around it.

    leave_out: names of effects that are not compensated; ALL stands for all of them. preview: whether the caller will
    know the reference ahead of time. sensor: how late the sensor is; that is taken from what was found where the
    recordings do not show the stage. jump_s: time that the jump over backlash is spread over. Raises BadInput for what is
    no model, for names that it does not hold, for a sensor that is later than all that was found, for no time, and for
    effects that have no inverse.
    """
    arguments.of_kind(model, Model, "model").validate()  # a wrong key would pass for an effect that does not fold
    shortest_s, longest_s = JUMPS_S
    if not shortest_s <= arguments.number(jump_s, "--backlash-time") <= longest_s:
        raise BadInput(f"--backlash-time {jump_s:g}: must be a time in s, {shortest_s:g} to {longest_s:g}")
    acting = effects.acting(model)
    leave_out = _names(model, acting, leave_out)
    open_ = [one for one in acting if _stage_is_open(model, one)]
    shown = any(one.effect.stage == SENSOR and one not in open_ for one in acting)
    lessened = _less_sensor(open_, sensor, shown)
    for whole, less in zip(open_, lessened):
        if whole.effect.name in leave_out and less.values != whole.values:
            raise BadInput(f"--sensor-delay and --sensor-lag: are taken from {whole.effect.name}, which is left out")
    folded_into = replace(model, effects=[])
    told, used = [], []
    for one in acting:
        name = one.effect.name
        values = next((less.values for whole, less in zip(open_, lessened) if whole is one), one.values)
        if name in leave_out:
            treatment = left_out("as asked")
        elif one.effect.stage == SENSOR and one not in open_:
            treatment = left_out("it is the sensor's, the actuator does not show it")
        elif values == one.effect.absent():
            treatment = left_out("with these values it does nothing" if values == one.values else
                                 "all of it is the sensor's")
        else:
            treatment = one.effect.treated(values, model, folded_into)
            if treatment.model is not None:
                treatment, folded_into = _folded(treatment, folded_into)
        spread = f", spread over {time_text(jump_s)}" if treatment.jump_um else ""
        told.append(Told(one, treatment.how, treatment.text + spread + _assumed(one, open_, treatment)))
        used.append(treatment)
    if acting and {one.effect.name for one in acting} <= leave_out:
        alone = model.operator_alone is not None
        return Inverse(model.uncompensated() if alone else folded_into, Chain(), tuple(told), (), Jump(), (), alone)
    try:
        chain = _chain(folded_into, used, preview)
    except BadInput as error:
        late = [one.acting.effect.name for one, by in zip(told, used) if by.poles]
        why = str(error).removeprefix("chain: ")
        raise BadInput(f"{model.where}: {' and '.join(late)}: {why}; give --leave-out {late[-1]}") from None
    addends = tuple(one.addend for one in used if one.addend is not None)
    lags = tuple((one.lag_s + one.lead[0], one.lead[1]) for one in used if one.lag_s or any(one.lead))
    jump = Jump(sum(one.jump_um for one in used), jump_s)
    return Inverse(folded_into, chain, tuple(told), addends, jump, lags, False)


def _names(model: Model, acting: Sequence[Acting], leave_out: Collection[str]) -> set[str]:
    held = list(dict.fromkeys(one.effect.name for one in acting))
    if set(leave_out) == {ALL}:
        return set(held)
    for name in leave_out:
        if name not in effects.CATALOGUE:
            raise BadInput(f"--leave-out {str(name)[:40]}: there is no such effect; {model.where} holds "
                           f"{', '.join(held) or 'none'}")
        if name not in held:
            raise BadInput(f"--leave-out {name}: {model.where} does not hold this effect, but "
                           f"{', '.join(held) or 'none'}")
    return set(leave_out)


def _stage_is_open(model: Model, one: Acting) -> bool:
    """Whether the effect may as well be the sensor's, or the actuator's: a command found it, and the recordings did not
    show its stage. Who writes a stage into the file by hand knows it.
    """
    kind = type(one.effect)
    if kind.shows_stage or SENSOR not in kind.stages or len(kind.stages) == 1:
        return False
    entry = model.effects[effects.place(model, one.effect)]
    return not entry.get("stage_shown") and (entry.get("origin") is not None or "stage" not in entry)


def _less_sensor(open_: Sequence[Acting], sensor: Sensor, shown: bool) -> list[Acting]:
    """The effects whose stage is open, without what is the sensor's. `shown`: the model holds some that is not open."""
    for option, value in zip(("--sensor-delay", "--sensor-lag"), sensor):
        if not 0 <= arguments.number(value, option, finite=False) < math.inf:
            raise BadInput(f"{option} {value:g}: must be a time in s, not negative")
    found, left = [], sensor
    for effect, values in open_:
        values, left = effect.less_sensor(values, left)
        found.append(Acting(effect, dict(values)))
    if left.delay_s or left.lag_s:  # to a slow reference, a delay and a lag are the same
        left = Sensor(left.lag_s, left.delay_s)
        for k, (effect, values) in enumerate(found):
            values, left = effect.less_sensor(values, left)
            found[k] = Acting(effect, dict(values))
    if (late_s := left.delay_s + left.lag_s) > 0:
        raise BadInput(f"--sensor-delay and --sensor-lag: the sensor is {late_s:.3g} s later than all that the "
                       "recordings leave open to be the sensor's"
                       + ("; the model knows already what is the sensor's: leave both options out" if shown else ""))
    return found


def _assumed(one: Acting, open_: Sequence[Acting], treatment: Treatment) -> str:
    if one not in open_ or treatment.how == "left out":
        return ""
    return "; nothing shows whether it is the sensor's, so it is taken for the actuator's"


def _folded(treatment: Treatment, before: Model) -> tuple[Treatment, Model]:
    """The operator with an effect folded in and the guard where it belongs; without it if the firmware refuses it."""
    found = treatment.model
    if found is before:
        return treatment, before
    try:
        found = guarded(found, found.rate.max_um_per_s)
        if found.drive != before.drive:
            found = replace(found, memory=within_drive(found))
        found.validate()
    except BadInput as error:
        return left_out(f"folded in, it makes no operator: {error}"), before
    return treatment, found


def _chain(model: Model, used: Sequence[Treatment], preview: bool) -> Chain:
    delay_s, lag_s = sum(one.delay_s for one in used), sum(one.lag_s for one in used)
    lead_s = lead_s2 = 0.0
    for alpha, beta in (one.lead for one in used):
        lead_s, lead_s2 = lead_s + alpha, lead_s2 + beta + lead_s * alpha
    direct, poles = in_series([(one.direct, one.poles) for one in used])
    late_s = delay_s + lead_s + math.sqrt(lead_s2)
    most_um = _most_um(model, late_s) if late_s else Chain.max_lead_um
    return Chain(delay_s, lag_s, lead_s, lead_s2, most_um, preview, direct, poles)


def _most_um(model: Model, late_s: float) -> float:
    """The most that the lead may add for what comes so much later: by the stroke, and by the slew limit."""
    most_um = MOST_LEAD * model.stroke_um
    if model.drive.slew_V_per_s is not None:
        steepest = abs(model.gain_um_per_V) * float(np.max(model.slopes) * np.max(np.cumsum(model.deadzone_weights)))
        most_um = min(most_um, steepest * model.drive.slew_V_per_s * late_s)
    return most_um


def in_series(banks: Sequence[tuple[float, Sequence[tuple[float, float]]]]
              ) -> tuple[float, tuple[tuple[float, float], ...]]:
    """Banks direct + sum of share / (1 + time s), one after the other, as one bank: by partial fractions."""
    times_s: list[float] = []
    apart = []
    for direct, poles in banks:
        moved = []
        for share, time_s in poles:
            while any(max(time_s, other) / min(time_s, other) < APART * (1 - 1e-9) for other in times_s):
                time_s *= APART
            times_s.append(time_s)
            moved.append((share, time_s))
        apart.append((direct, moved))

    def passed(bank: tuple[float, list[tuple[float, float]]], time_s: float) -> float:
        """The bank at s = -1 / time_s."""
        return bank[0] + sum(share / (1 - other / time_s) for share, other in bank[1])

    whole = tuple((share * math.prod(passed(other, time_s) for other in apart if other is not bank), time_s)
                  for bank in apart for share, time_s in bank[1])
    return math.prod(direct for direct, _ in apart), whole
