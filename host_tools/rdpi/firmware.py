"""The compiled firmware library, called sample by sample in C: rdpi._f32 as flashed, rdpi._f64 the same in double."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np

from .errors import BadInput
from .model import Model

DTYPES = {"f32": np.float32, "f64": np.float64}


class Steps(NamedTuple):
    """What the inverse did, one value per sample."""

    drive_V: np.ndarray
    rate_um_per_s: np.ndarray  # after the guard
    flags: np.ndarray  # uint32, RDPI_FLAG_...
    dac_code: np.ndarray  # uint32, 0 without dac_bits


class Firmware:
    """One rdpi_f32_t with the parameters of `model`, in single ("f32") or double ("f64") precision.

    Raises BadInput with the library's own words if it refuses the parameters.
    """

    def __init__(self, model: Model, sample_time_s: float, real: str = "f32") -> None:
        model.validate_lengths()
        self._module, self._dtype = _load(real)
        ffi, lib = self._module.ffi, self._module.lib
        self._arrays = {  # copies, kept alive because the C struct points to them
            "thresholds_um": model.thresholds_um, "slopes": model.slopes,
            "slope_rate_s_per_um": model.slope_rate_s_per_um, "deadzones_um": model.deadzones_um,
            "deadzone_weights": model.deadzone_weights, "memory_um": model.memory.plays_um,
        }
        self._arrays = {key: np.array(value, self._dtype) for key, value in self._arrays.items()}
        self._params = ffi.new("rdpi_f32_params_t *", {
            "schema": lib.RDPI_PARAMS_SCHEMA, "plays": len(model.thresholds_um), "deadzones": len(model.deadzones_um),
            **{key: _pointer(ffi, value) for key, value in self._arrays.items()}, **scalars(model)})
        self._self = ffi.new("rdpi_f32_t *")
        self._plays = len(model.thresholds_um)
        self._check(lib.rdpi_f32_init(self._self, self._params, sample_time_s))

    def step(self, reference_um: np.ndarray) -> Steps:
        """rdpi_f32_step for each reference in um, shape (samples,), going on from the present state."""
        ffi, lib = self._module.ffi, self._module.lib
        reference_um = _array(reference_um, self._dtype)
        result = Steps(*(np.empty(len(reference_um), kind)
                         for kind in (self._dtype, self._dtype, np.uint32, np.uint32)))
        lib.rdpi_batch_step(self._self, _pointer(ffi, reference_um), len(reference_um),
                            *(_pointer(ffi, column) for column in result))
        return result

    def forward(self, drive_V: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        """rdpi_f32_forward for each drive in V and rate in um/s: the displacement in um, shape (samples,)."""
        ffi, lib = self._module.ffi, self._module.lib
        drive_V, rate_um_per_s = _array(drive_V, self._dtype), _array(rate_um_per_s, self._dtype)
        if drive_V.shape != rate_um_per_s.shape:
            raise ValueError(f"{drive_V.shape} drives, {rate_um_per_s.shape} rates")
        displacement_um = np.empty_like(drive_V)
        lib.rdpi_batch_forward(self._self, _pointer(ffi, drive_V), _pointer(ffi, rate_um_per_s), len(drive_V),
                               _pointer(ffi, displacement_um))
        return displacement_um

    @property
    def memory_um(self) -> np.ndarray:
        """States of the plays, shape (n + 1,); assigning validates as rdpi_f32_set_memory does."""
        states = np.empty(self._plays, self._dtype)
        self._module.lib.rdpi_f32_get_memory(self._self, _pointer(self._module.ffi, states))
        return states

    @memory_um.setter
    def memory_um(self, states_um: np.ndarray) -> None:
        states = _array(states_um, self._dtype)
        if states.shape != (self._plays,):
            raise ValueError(f"{states.shape} states for {self._plays} plays")
        self._check(self._module.lib.rdpi_f32_set_memory(self._self, _pointer(self._module.ffi, states)))

    @property
    def counts(self) -> dict[str, int]:
        """Steps flagged since the start: guard, clip (range or slew), input."""
        return {key: getattr(self._self, f"{key}_count") for key in ("guard", "clip", "input")}

    def _check(self, status: int) -> None:
        if status != self._module.lib.RDPI_OK:
            text = self._module.ffi.string(self._module.lib.rdpi_status_text(status)).decode()
            raise BadInput(f"the firmware library refuses: {text}")


def scalars(model: Model) -> dict[str, float]:
    """The scalar fields of rdpi_f32_params_t."""
    return {
        "gain_um_per_V": model.gain_um_per_V, "offset_V": model.offset_V, "offset_um": model.offset_um,
        "rate_window_s": model.rate.window_s, "rate_filter_s": model.rate.filter_s,
        "max_um_per_s": model.rate.max_um_per_s, "min_slope_ratio": model.rate.min_slope_ratio,
        "min_V": model.drive.min_V, "max_V": model.drive.max_V, "slew_V_per_s": model.drive.slew_V_per_s or 0.0,
        "dac_bits": model.drive.dac_bits or 0,
    }


def plays(x_um: np.ndarray, thresholds_um: np.ndarray, states_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bank of play operators in double: x (samples,), thresholds (n + 1,), states at the start (n + 1,).

    Returns the outputs, shape (samples, n + 1), and the states at the end, shape (n + 1,), all in um.
    """
    module, dtype = _load("f64")
    x_um, thresholds_um = _array(x_um, dtype), _array(thresholds_um, dtype)
    states_um = np.array(states_um, dtype)  # a copy: the library moves them
    if states_um.shape != thresholds_um.shape:
        raise ValueError(f"{states_um.shape} states, {thresholds_um.shape} thresholds")
    outputs_um = np.empty((len(x_um), len(thresholds_um)), dtype)
    module.lib.rdpi_batch_plays(_pointer(module.ffi, x_um), len(x_um), _pointer(module.ffi, thresholds_um),
                                len(thresholds_um), _pointer(module.ffi, states_um), _pointer(module.ffi, outputs_um))
    return outputs_um, states_um


def rate(z_um: np.ndarray, sample_time_s: float, window_s: float, filter_s: float) -> np.ndarray:
    """The firmware's rate estimator in double, um/s, shape as z (samples,). Raises BadInput if the window is too long."""
    module, dtype = _load("f64")
    z_um = _array(z_um, dtype)
    result = np.empty_like(z_um)
    status = module.lib.rdpi_batch_rate(window_s, filter_s, sample_time_s, _pointer(module.ffi, z_um), len(z_um),
                                        _pointer(module.ffi, result))
    if status != module.lib.RDPI_OK:
        raise BadInput(f"rate estimator: {module.ffi.string(module.lib.rdpi_status_text(status)).decode()} "
                       f"(window {window_s:g} s at {1 / sample_time_s:g} samples/s); choose a shorter window")
    return result


def _load(real: str) -> tuple[Any, type]:
    return importlib.import_module(f"rdpi._{real}"), DTYPES[real]


def _array(values: np.ndarray, dtype: type) -> np.ndarray:
    with np.errstate(over="ignore"):  # what overflows becomes infinite, and the library knows infinity
        return np.ascontiguousarray(values, dtype=dtype)


def _pointer(ffi: Any, array: np.ndarray) -> Any:
    """Typed pointer to a contiguous array's data; the caller keeps the array alive."""
    return ffi.from_buffer("rdpi_real_t[]" if array.dtype.kind == "f" else "uint32_t[]", array, require_writable=False)
