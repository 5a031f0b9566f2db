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
from .data import RATES_HZ, Recording, arguments, read_recording
from .errors import BadInput
from .firmware import ENGINES, write_header
from .gap import GapDocument, diagnose as diagnosis_of
from .identify import Options, fit as identified
from .model import Model as Parameters, read_model, write_model
from .simulate import chain, inverse_of

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

    def predict(self, run: Recording) -> np.ndarray:
        """Displacement in um, (samples,), that the model predicts from the command of a recording.

        The run's metadata say where the hysteresis starts (memory), as for `rdpi simulate`; a drive without the column
        displacement_um starts from the model's memory.

        >>> run = read_recording("today.csv")
        >>> Model.load("model.json").predict(run).shape == run.command_V.shape
        True
        """
        arguments.of_kind(run, Recording, "run")
        arguments.of_kind(self.parameters, Parameters, "parameters").validate()
        return chain.simulate(self.parameters, [run])[0].predicted_um

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
        wanted = arguments.series(reference_um, "reference_um")
        step_s = arguments.number(sample_time_s, "sample_time_s")
        if not 1 / RATES_HZ[1] <= step_s <= 1 / RATES_HZ[0]:
            raise BadInput(f"sample_time_s is {step_s:g}; must be positive, {1 / RATES_HZ[1]:g} to {1 / RATES_HZ[0]:g}")
        arguments.one_of(engine, (*ENGINES, "numpy"), "engine")
        if not len(wanted):
            raise BadInput("reference_um: give at least one value")
        run = Recording("reference_um", {"sample_rate_hz": repr(1 / step_s)},
                        {"time_s": step_s * np.arange(len(wanted)), "reference_um": wanted})
        by = inverse_of(self.parameters)
        found = followed(self.parameters, run, "reference_um", engine, by=by)
        if clipped := found.flag_counts["range"]:
            low_um, high_um = chain.reachable_um(by.model)
            warnings.warn(f"the drive is clipped at {clipped} of {len(wanted)} samples: the reference spans "
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
