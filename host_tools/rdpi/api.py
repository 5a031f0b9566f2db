"""The Python interface: what `import rdpi` gives. Displacements are in um, drives in V, times in s.

From recordings to a header, and to the name of what has changed since:

>>> import numpy as np, rdpi
>>> runs = [rdpi.read_recording(path) for path in ("slow.csv", "fast.csv")]
>>> model = rdpi.fit(runs, dac_bits=16)
>>> model.save("model.json")
>>> model.header("rdpi_params.h")
>>> reference_um = 5 + 2 * np.sin(2 * np.pi * 10 * np.arange(400) / 1000)
>>> drive_V = model.compensate(reference_um, sample_time_s=1e-3)
>>> found = rdpi.diagnose(model, [rdpi.read_recording("today.csv")])
>>> found.verdict
'effect'
>>> found.effects[0].name.replace("_", " ")
'gain change'
>>> found.improved.save("improved.json")

What cannot be used raises `rdpi.BadInput`, which names the argument, the file or the place.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from .board import compensate as followed
from .data import ENDS, RATES_HZ, Recording, arguments, read_recording, taken
from .errors import BadInput
from .firmware import ENGINES, write_header
from .gap import GapDocument, diagnose as diagnosis_of
from .identify import Options, fit as identified
from .model import Model as Parameters, read_model, write_model
from .simulate import Plant, Simulator, State, chain, inverse_of

__all__ = ["Diagnosis", "Model", "Recording", "diagnose", "fit", "read_recording"]


class Model:
    """An identified actuator: its operator, and what stands around it.

    `parameters` are the numbers of the model file, as host_tools/formats.md describes them.

    >>> model = Model.load("model.json")
    >>> model.parameters.drive.max_V
    100.0
    """

    def __init__(self, parameters: Parameters) -> None:
        self.parameters: Parameters = arguments.of_kind(parameters, Parameters, "parameters")

    def __repr__(self) -> str:
        known = self.parameters
        return (f"<rdpi.Model {known.actuator or known.where}: {len(known.slopes) - 1} plays, "
                f"{len(known.deadzones_um) - 1} dead zones, {len(known.effects)} effects, stroke {known.stroke_um:.4g} um>")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Model:
        """Read a model file. Raises BadInput for one that the firmware would refuse."""
        return cls(read_model(arguments.path(path)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model file, atomically. Raises BadInput for numbers that make no model, OSError."""
        write_model(arguments.path(path), self.parameters)

    def predict(self, run: Recording | Sequence[float] | np.ndarray, sample_time_s: float | None = None, *,
                start: State | str | None = None) -> np.ndarray:
        """Displacement in um, (samples,), that the model predicts from the command of a recording, or from a drive in V,
        (samples,), and its sample time in s.

        A recording's metadata say where it starts (memory), as for `rdpi simulate`; one of unknown memory starts from an
        estimate that needs its measured displacement, or from the model's memory if it has none. `start` says otherwise:
        "reset", after a decaying sweep that ended at the first drive; "low" or "high", that end of the drive's range, after
        a rest; "model", the model's memory, as for a drive without a recording by default; or the `state` of a simulator.

        >>> run = read_recording("today.csv")
        >>> model = Model.load("model.json")
        >>> model.predict(run).shape == run.command_V.shape
        True
        >>> model.predict(50 - 50 * np.cos(np.arange(1000) / 50), 1e-3, start="low").shape
        (1000,)
        """
        parameters = arguments.of_kind(self.parameters, Parameters, "parameters")
        parameters.validate()
        if not isinstance(run, Recording):
            if sample_time_s is None:
                raise BadInput("run: give a recording, or a drive in V and its sample_time_s")
            run = _run("command_V", run, sample_time_s)
        elif sample_time_s is not None:
            raise BadInput("sample_time_s: a recording has its own; give it with a drive only")
        if isinstance(start, State):
            (run,) = taken([run], ["command_V"], "run")
            plant = Plant(parameters, run.sample_time_s)
            ran = plant.run(run.command_V, start, run.columns)
            return ran.displacement_um
        if start is not None:
            arguments.one_of(start, ("reset", *ENDS, "model"), "start")
        return chain.simulate(parameters, [run], start or "auto")[0].predicted_um

    def simulator(self, sample_time_s: float, start_V: float | None = None, state: State | None = None) -> Simulator:
        """The actuator sample by sample: `step(drive_V) -> displacement_um`, `run(array)`, and `state`, which may be read
        and set. It begins as a decaying sweep that ended at `start_V`, by default the middle of the drive's range, leaves
        it, or goes on from a state.

        >>> actuator = Model.load("model.json").simulator(1e-3)
        >>> before = actuator.state
        >>> z_um = actuator.step(60.0)
        >>> actuator.state = before
        >>> z_um == actuator.run([60.0, 60.0])[0]
        True
        """
        arguments.of_kind(self.parameters, Parameters, "parameters").validate()
        if start_V is not None:
            start_V = arguments.number(start_V, "start_V")
        if state is not None:
            arguments.of_kind(state, State, "state")
        return Simulator(self.parameters, _sample_time(sample_time_s), start_V, state)

    def compensate(self, reference_um: Sequence[float] | np.ndarray, sample_time_s: float,
                   engine: str = "f32") -> np.ndarray:
        """Drive in V, (samples,), with which the displacement follows a reference in um, (samples,).

        The engines "f32", "q31" and "f64" are the firmware library, "numpy" is an independent implementation. What the
        firmware would compensate is compensated; the reference's own future is the preview. The hysteresis starts from
        the model's memory. Warns (UserWarning) where the drive is clipped because the reference is out of reach.

        >>> reference_um = 5 + np.sin(np.arange(100) / 20)
        >>> Model.load("model.json").compensate(reference_um, 1e-3).shape
        (100,)
        """
        arguments.one_of(engine, (*ENGINES, "numpy"), "engine")
        run = _run("reference_um", reference_um, sample_time_s)
        by = inverse_of(self.parameters)
        found = followed(self.parameters, run, "reference_um", engine, by=by)
        if clipped := found.flag_counts["range"]:
            low_um, high_um = chain.reachable_um(by.model)
            warnings.warn(f"the drive is clipped at {clipped} of {len(run)} samples: the reference spans "
                          f"{found.asked_um[0]:.5g} to {found.asked_um[1]:.5g} um, the model reaches {low_um:.5g} to "
                          f"{high_um:.5g} um", stacklevel=2)
        return found.steps.drive_V.astype(float)

    def header(self, path: str | os.PathLike[str], name: str = "rdpi_params") -> None:
        """Write the C header that the firmware compiles in; `name` is the C name of the parameters.

        Effects are compensated, folded in or left out as `rdpi header` does it. Raises BadInput, OSError.
        """
        inverse = inverse_of(self.parameters)
        write_header(inverse.model, arguments.path(path), arguments.of_kind(name, str, "name"), "",
                     inverse.chain, inverse.addends, inverse.jump)


def _sample_time(sample_time_s: float) -> float:
    step_s = arguments.number(sample_time_s, "sample_time_s")
    if not 1 / RATES_HZ[1] <= step_s <= 1 / RATES_HZ[0]:
        raise BadInput(f"sample_time_s is {step_s:g}; must be positive, {1 / RATES_HZ[1]:g} to {1 / RATES_HZ[0]:g}")
    return step_s


def _run(column: str, values: Sequence[float] | np.ndarray, sample_time_s: float) -> Recording:
    """A recording of one column, named as that."""
    values, step_s = arguments.series(values, column), _sample_time(sample_time_s)
    if not len(values):
        raise BadInput(f"{column}: give at least one value")
    return Recording(column, {"sample_rate_hz": repr(1 / step_s)}, {"time_s": step_s * np.arange(len(values)), column: values})


class Diagnosis:
    """What explains the gap between a model and recordings.

    It has the fields of `rdpi gap --json` as attributes (verdict, effects, candidates, gap, where, ...);
    host_tools/formats.md describes them. `improved` is the model with the accepted effects.

    >>> found = diagnose(Model.load("model.json"), [read_recording("today.csv")])
    >>> found.effects[0].shrink > 0.8
    True
    >>> found.to_json()["schema"]
    'rdpi-gap/1'
    """

    def __init__(self, document: GapDocument, improved: Model) -> None:
        self.document = document
        self.improved = improved

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "document":  # not there yet while it is copied
            raise AttributeError(name)
        return getattr(self.document, name)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(one.name for one in fields(self.document))})

    def to_json(self) -> dict[str, Any]:
        """The document of `rdpi gap --json`."""
        return self.document.to_json()


def fit(runs: Sequence[Recording], **options: Any) -> Model:
    """Identify a model from recordings.

    Options are those of `rdpi fit`, with its defaults: operators, deadzones, thresholds_um, rate_independent, effects,
    rate_source, rate_window_s, rate_filter_s, min_slope_ratio, min_V, max_V, slew_V_per_s, dac_bits, actuator. Raises
    BadInput for others, and for recordings that no model can be identified from.

    >>> fit([read_recording("slow.csv")], rate_independent=True, effects="none").parameters.effects
    []
    """
    known = [one.name for one in fields(Options)]
    for name in options:
        if name not in known:
            raise BadInput(f"{name}: is no option of fit; the options are {', '.join(known)}")
        if arguments.is_number(options[name]):
            arguments.number(options[name], name)
    if options.get("thresholds_um") is not None:
        arguments.series(options["thresholds_um"], "thresholds_um")
    return Model(identified(runs, Options(**options)).model)


def diagnose(model: Model, runs: Sequence[Recording], earlier: Sequence[Recording] = ()) -> Diagnosis:
    """Say why a model misses recordings that it was not fitted to, as `rdpi gap` does.

    With `earlier` recordings, one of the same drive for each run, the gap is what has changed since. Raises BadInput.
    """
    parameters = arguments.of_kind(model, Model, "model").parameters
    found = diagnosis_of(parameters, runs, earlier=earlier)
    return Diagnosis(found.document, Model(found.improved))
