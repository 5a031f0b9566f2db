"""Effects that a real actuator has and its model may lack, and the models that were given some.

`CATALOGUE` holds them all, by name; `Acting` is one with its parameters, as the model file's list `effects` holds it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ...data import Recording, arguments
from ...errors import BadInput
from ...model import Model, guarded
from .backlash import Backlash
from .base import BEFORE_MONITOR, SENSOR, STAGES, Effect, Parameter, Residuals, Values
from .creep import Creep
from .cross_coupling import CrossCoupling
from .delay import Delay
from .gain_change import GainChange
from .hysteresis_change import HysteresisChange
from .initial_memory import InitialMemory
from .input_curve import InputCurve
from .lag import Lag
from .periodic_disturbance import PeriodicDisturbance
from .quantisation import Quantisation
from .rail_saturation import RailSaturation
from .rate_dependence import RateDependence
from .relaxation import Relaxation
from .resonance import Resonance
from .slew_limit import SlewLimit
from .static_nonlinearity import StaticNonlinearity
from .thermal_drift import ThermalDrift
from .treatment import Addend, Sensor, Treatment, left_out

__all__ = ["BEFORE_MONITOR", "CATALOGUE", "PARAMETERS", "SENSOR", "STAGES", "Acting", "Addend", "Displaced", "Effect",
           "Parameter", "Residuals", "Sensor", "Treatment", "Values", "acting", "beside", "disturbed", "displaced",
           "driven", "driven_run", "entries", "left_out", "operator", "place", "replaced", "then"]

CATALOGUE: dict[str, type[Effect]] = {effect.name: effect for effect in (
    # where two act at one stage, the first comes first
    InputCurve, InitialMemory, RateDependence, HysteresisChange, Relaxation, Creep, GainChange, Backlash, Resonance,
    CrossCoupling, ThermalDrift, PeriodicDisturbance, StaticNonlinearity, SlewLimit, Lag, RailSaturation, Delay,
    Quantisation)}
PARAMETERS = {one.name: one for effect in CATALOGUE.values() for one in effect.parameters}  # a name means one thing
_ORDER = list(CATALOGUE)
LEAST_SLOPE_RATIO = 0.02
MUCH_CONSTANT = 0.5  # of a constant, that disturbances make up for


class Acting(NamedTuple):
    """An effect and its parameters."""

    effect: Effect
    values: dict[str, float]

    def __str__(self) -> str:
        """Name, stage and size: "lag at the amplifier (time_constant_s 0.002 s)"."""
        sizes = [f"{one.name} {self.values[one.name]:.4g} {self.effect.unit(one)}".removesuffix(" 1")
                 for one in self.effect.parameters if not one.internal and self.values[one.name] != one.absent]
        return f"{self.effect.name} at stage {self.effect.stage}" + (f" ({', '.join(sizes)})" if sizes else "")

    @property
    def key(self) -> tuple[Any, ...]:
        """What it is, as keys of a dictionary: effect, place, covariate and values."""
        return (self.effect.name, self.effect.stage, self.effect.column, *self.values.items())

    @property
    def does_nothing(self) -> bool:
        """Whether what a fit finds first, its size, is none."""
        size = self.effect.fitted[0]
        return self.values[size] == self.effect.absent()[size]


def acting(model: Model) -> list[Acting]:
    """The model's effects in the order of the chain. Raises BadInput for one that is not known or not complete, and for
    one that stands twice.
    """
    arguments.of_kind(model, Model, "model")
    found: list[Acting] = []
    for k, entry in enumerate(arguments.of_kind(model.effects, list, f"{model.where}: effects")):
        where = f"{model.where}: effects[{k}]"
        one = _acting(entry, where)
        if (same := replaced(found, one.effect)) is not None:
            raise BadInput(f"{where} ({one.effect.name}) is at {one.effect.stage}, as effects[{found.index(same)}] is; "
                           "a chain holds an effect once at a stage: remove one of them")
        if not isinstance(entry.get("new", False), (bool, type(None))):
            raise BadInput(f"{where}: new: must be true or false")
        if entry.get("was") is not None:
            _acting({**entry, "parameters": entry["was"]}, f"{where}: was")
        found.append(one)
    return in_order(found)


def place(model: Model, effect: Effect) -> int | None:
    """Where the model's list holds the one in whose place the effect would stand; None: nowhere."""
    held = (_acting(entry, model.where).effect for entry in model.effects)
    return next((k for k, one in enumerate(held) if effect.replaces(one)), None)


def then(model: Model) -> Model:
    """The model with its effects as they acted before `rdpi gap --earlier` found them new, or changed."""
    acted = [entry if not entry.get("new") else {**entry, "parameters": entry["was"]} for entry in model.effects
             if not entry.get("new") or entry.get("was") is not None]
    return replace(model, effects=acted)


def entries(effects: Iterable[Acting]) -> list[dict[str, Any]]:
    """Effects as the model file's list holds them."""
    return [{"name": one.effect.name, "stage": one.effect.stage, **one.effect.options, "parameters": dict(one.values)}
            for one in effects]


def replaced(effects: Iterable[Acting], effect: Effect) -> Acting | None:
    """The one in whose place the effect would stand; None: it would stand beside all of them."""
    return next((one for one in effects if effect.replaces(one.effect)), None)


def beside(effects: Iterable[Acting], *more: Acting) -> list[Acting]:
    """Effects with others beside them, or in their place, along the chain."""
    kept = [one for one in effects if not any(other.effect.replaces(one.effect) for other in more)]
    return in_order([*kept, *more])


def in_order(effects: Iterable[Acting]) -> list[Acting]:
    """Sorted along the chain."""
    return sorted(effects, key=lambda one: (STAGES.index(one.effect.stage), _ORDER.index(one.effect.name)))


def driven(effects: Sequence[Acting], drive_V: np.ndarray, run: Recording, model: Model) -> np.ndarray:
    """The drive in V that reaches the actuator, of the one that goes in, both (samples,)."""
    for effect, values in effects:
        drive_V = effect.drive(drive_V, run, values, model)
    return drive_V


def driven_run(effects: Sequence[Acting], run: Recording, model: Model) -> Recording:
    """The recording with the drive that reaches the actuator as its command."""
    return replace(run, columns={**run.columns, "command_V": driven(effects, run.command_V, run, model)})


def operator(effects: Sequence[Acting], model: Model) -> Model:
    """The model with what the effects change of its operator.

    It is only ever driven forward, so that its guard keeps the slopes positive and no more.
    """
    changed = model
    for effect, values in effects:
        changed = effect.operator(changed, values)
    if changed is model:
        return model
    return guarded(replace(changed, rate=replace(changed.rate, min_slope_ratio=LEAST_SLOPE_RATIO)),
                   model.rate.max_um_per_s)


def displaced(effects: Sequence[Acting], z_um: np.ndarray, run: Recording, model: Model) -> np.ndarray:
    """The displacement in um that the sensor shows, of the one that the operator gives, both (samples,).

    run.command_V is what drove the actuator.
    """
    for effect, values in effects:
        z_um = effect.displacement(z_um, run, values, model)
    return z_um


class Displaced:
    """`displaced` asked again and again of few different outputs of the operator: from the first effect on that differs
    from the last time.
    """

    def __init__(self) -> None:
        self._last: list[tuple[Any, np.ndarray, np.ndarray]] = []  # of each effect: what it is, z, what it made of it

    def __call__(self, effects: Sequence[Acting], z_um: np.ndarray, run: Recording, model: Model) -> np.ndarray:
        """Of run and model, which must be those of z_um, an array that nobody changes."""
        last, self._last = self._last, []
        same, shown_um = True, z_um
        for k, one in enumerate(effects):
            same = same and k < len(last) and last[k][0] == one.key and last[k][1] is z_um
            shown_um = last[k][2] if same else displaced([one], shown_um, run, model)
            self._last.append((one.key, z_um, shown_um))
        return shown_um


def disturbed(effects: Sequence[Acting], predicted_um: np.ndarray, run: Recording, model: Model) -> np.ndarray:
    """The prediction with the disturbances of this very recording, estimated from what is missed, (samples,)."""
    columns = [one.effect.columns(run, one.values, model) for one in effects if one.effect.disturbance]
    if not columns or run.displacement_um is None:
        return predicted_um
    design, constant = np.column_stack(columns), np.ones(len(run))
    moves_zero = any(one.effect.moves_zero for one in effects)
    made_up = constant @ design @ np.linalg.lstsq(design, constant, rcond=None)[0]
    if not moves_zero and made_up > MUCH_CONSTANT * len(run):
        design = design - np.mean(design, axis=0)  # a part of a period: its size is not to be balanced by a constant
    found = np.linalg.lstsq(np.column_stack([constant, design]), run.displacement_um - predicted_um, rcond=None)[0]
    if not moves_zero:
        found[0] = 0.0
    return predicted_um + found[0] + design @ found[1:]


def _acting(entry: Any, where: str) -> Acting:
    if not isinstance(entry, dict) or str(entry.get("name")) not in CATALOGUE:
        name = entry.get("name") if isinstance(entry, dict) else entry
        raise BadInput(f"{where} is {_text(name)}, which this version cannot simulate; it knows "
                       f"{', '.join(CATALOGUE)}")
    kind = CATALOGUE[entry["name"]]
    where += f" ({kind.name})"
    stage = entry.get("stage", kind.stages[0])
    if not isinstance(stage, str) or stage not in kind.stages:
        raise BadInput(f"{where}: stage is {_text(stage)}; must be one of {', '.join(kind.stages)}")
    options = {"column": entry["column"]} if kind.of_column and "column" in entry else {}
    if options and (complaint := kind.wrong_column(entry["column"])) is not None:
        raise BadInput(f"{where}: column is {_text(entry['column'])}; {complaint}")
    given = entry.get("parameters", {})
    if not isinstance(given, dict):
        raise BadInput(f"{where}: parameters must be an object")
    if (complaint := _misnamed(entry, given, kind)) is not None:
        raise BadInput(f"{where}: {complaint}")
    effect = kind(stage, **options)
    values, unknown = {}, []
    for parameter in kind.parameters:
        value = given.get(parameter.name, parameter.absent)
        if isinstance(value, dict):
            if "value" not in value:
                raise BadInput(f'{where}: {parameter.name} has no value; give it as "value", '
                               "or the number in place of the object")
            unit = value.get("unit", known := effect.unit(parameter))
            if unit not in (known, parameter.unit):
                raise BadInput(f"{where}: {parameter.name} is in {_text(unit)}; give it in {known}, the unit of every "
                               "model file")
            value = value["value"]
        if value is None:
            value = parameter.absent
            unknown += [parameter.name] if value and np.isfinite(value) else []
        low, high = parameter.ends
        if isinstance(value, bool) or not isinstance(value, (int, float)) or \
                not (low <= value <= high or value in (parameter.low, parameter.high)):
            raise BadInput(f"{where}: {parameter.name} is {_text(value)}; must be a number, "
                           f"{low:g} to {high:g}{'' if parameter.unit == '1' else f' {parameter.unit}'}")
        values[parameter.name] = float(value)
    if (complaint := kind.refusal(values)) is not None:
        raise BadInput(f"{where}: {complaint}")
    if unknown and values != effect.absent():
        raise BadInput(f"{where}: {unknown[0]} is null, but the effect acts; give it a number")
    return Acting(effect, values)


def _text(value: Any) -> str:
    """Short enough for a message: JSON, or what a caller of Python functions gave instead."""
    try:
        return json.dumps(value)[:40]
    except (TypeError, ValueError):
        return arguments.shown(value)


def _misnamed(entry: dict[str, Any], given: dict[str, Any], kind: type[Effect]) -> str | None:
    """What is wrong with the names of parameters; None: nothing.

    Keys that this version does not know are accepted beside all that the effect has. Where one of those is missing
    they are a misspelling of it, and the effect would silently do nothing.
    """
    own = [parameter.name for parameter in kind.parameters]
    missing = [name for name in own if name not in given]
    strange = [key for key in given if key not in own]
    beside = [key for key in own if isinstance(entry.get(key), (int, float, dict))]  # not the text of a key "origin"
    if not missing or not strange and not beside and len(missing) < len(own):
        return None
    known = ", ".join(f"{parameter.name} ({parameter.unit})" for parameter in kind.parameters)
    found = ", ".join(map(_text, [*strange, *beside]))
    return (f"no {' and no '.join(missing)} in its parameters"
            + (f", but {found[:80]}{' beside them' if beside and not strange else ''}" if found else "")
            + f"; they are {known}")
