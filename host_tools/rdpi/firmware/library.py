"""The compiled firmware library, called sample by sample in C: rdpi.firmware._f32 as flashed, rdpi.firmware._f64 the
same in double.

The fixed-point half is integers alone, so that both hold the same.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from ..data import arguments
from ..errors import BadInput
from ..model import Model
from . import parameters
from .builds import check_sample_time
from .chain import Chain, F32Chain, Q31Chain, f32_chain, q31_chain
from .parameters import F32, NO_REFERENCE, Q31

DTYPES = {"f32": np.float32, "f64": np.float64}
ENGINES = *DTYPES, "q31"
COUNTS = "guard", "clip", "input", "missed"
FLAGS = {"guard": 1, "range": 2, "slew": 4, "input": 8, "missed": 16,
         "lead": 32}  # RDPI_FLAG_... in lib/include/rdpi/types.h
SWEEP_CHUNK = 100_000  # samples
KINDS: dict[type, str] = {F32: "f32", Q31: "q31", F32Chain: "f32_chain", Q31Chain: "q31_chain"}  # of structs


class Steps(NamedTuple):
    """What the inverse did, one value per sample."""

    drive_V: np.ndarray
    rate_um_per_s: np.ndarray  # after the guard
    flags: np.ndarray  # uint32, RDPI_FLAG_...
    dac_code: np.ndarray  # uint32, 0 without dac_bits


def flag_counts(flags: np.ndarray) -> dict[str, int]:
    """Number of samples with each of FLAGS set; `flags` are integers, shape (samples,)."""
    return {name: int(np.count_nonzero(flags & bit)) for name, bit in FLAGS.items()}


def engine(model: Model, sample_time_s: float, name: str, chain: Chain | None = None,
           any_sample_time: bool = False) -> Firmware | FixedPoint:
    """The library's instance of this name: "f32", "f64" or "q31"."""
    arguments.one_of(name, ENGINES, "engine")
    return (FixedPoint(model, sample_time_s, chain, any_sample_time) if name == "q31" else
            Firmware(model, sample_time_s, name, chain, any_sample_time))


class Firmware:
    """One rdpi_f32_t with the parameters of `model`, in single ("f32") or double ("f64") precision; with a chain, the
    one in an rdpi_f32_chain_t.

    any_sample_time: take sample times too that the parameters as flashed refuse, for a simulation that no controller
    runs. Raises BadInput with the library's own words if it refuses the parameters.
    """

    def __init__(self, model: Model, sample_time_s: float, real: str = "f32", chain: Chain | None = None,
                 any_sample_time: bool = False) -> None:
        arguments.of_kind(model, Model, "model")
        self._module, self._dtype = _load(real)
        ffi, lib = self._module.ffi, self._module.lib
        self.parameters = parameters.f32(model, self._dtype)
        self._params, self._arrays = _struct(self._module, "f32", _unbounded(self.parameters) if any_sample_time else
                                             self.parameters)
        sample_time_s = arguments.number(sample_time_s, "sample_time_s", finite=False)  # the library has the words
        if chain is None:
            self._chain, self._self = None, ffi.new("rdpi_f32_t *")
            _check_init(self._module, lib.rdpi_f32_init(self._self, self._params, sample_time_s), model, sample_time_s)
            return
        self.chain = f32_chain(chain, self._dtype)
        self._chain_params, self._poles = _struct(self._module, "f32_chain", self.chain)
        self._chain_params.axis = self._params
        self._chain = ffi.new("rdpi_f32_chain_t *")
        self._self = ffi.addressof(self._chain, "axis")
        _check_init(self._module, lib.rdpi_f32_chain_init(self._chain, self._chain_params, sample_time_s), model,
                    sample_time_s)

    def step(self, reference_um: np.ndarray) -> Steps:
        """rdpi_f32_step for each reference in um, shape (samples,), going on from the present state.

        With a chain rdpi_f32_chain_step: the references are preview_samples ahead.
        """
        ffi, lib = self._module.ffi, self._module.lib
        reference_um = _array(reference_um, self._dtype, "reference_um")
        result = Steps(*(np.empty(len(reference_um), kind)
                         for kind in (self._dtype, self._dtype, np.uint32, np.uint32)))
        function, instance = ((lib.rdpi_batch_step, self._self) if self._chain is None else
                              (lib.rdpi_batch_chain_step, self._chain))
        function(instance, pointer(ffi, reference_um), len(reference_um), *(pointer(ffi, one) for one in result))
        return result

    @property
    def instance(self) -> Any:
        """The rdpi_f32_t, alive as long as this."""
        return self._self

    @property
    def preview_samples(self) -> int:
        """How far ahead of the present the references for `step` must be."""
        return 0 if self._chain is None else self._chain.preview_samples

    def missed(self, ticks: int) -> None:
        """rdpi_f32_missed: so many samples went by without a step."""
        if self._chain is None:
            self._module.lib.rdpi_f32_missed(self._self, _ticks(ticks))
        else:
            self._module.lib.rdpi_f32_chain_missed(self._chain, _ticks(ticks))

    def swept(self, ticks: int) -> None:
        """rdpi_f32_chain_swept: a sweep ended so many samples ago. Without a chain, nothing follows from that."""
        if self._chain is not None:
            self._module.lib.rdpi_f32_chain_swept(self._chain, _ticks(ticks))

    def sweep(self) -> tuple[np.ndarray, np.ndarray]:
        """The whole start-up sweep: drives in V and DAC codes, both (samples,).

        rdpi_f32_sweep until it ends, then rdpi_f32_forget_sweep.
        """
        lib = self._module.lib
        function, instance = ((lib.rdpi_batch_sweep, self._self) if self._chain is None else
                              (lib.rdpi_batch_chain_sweep, self._chain))
        return _sweep(self._module, function, instance, self._dtype)

    def predict(self, drive_V: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        """rdpi_f32_predict for each drive in V and rate in um/s: the displacement in um, shape (samples,)."""
        return self._displacement(self._module.lib.rdpi_batch_predict, drive_V, rate_um_per_s)

    def forward(self, drive_V: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        """rdpi_f32_forward for each drive in V and rate in um/s: the displacement in um, shape (samples,)."""
        return self._displacement(self._module.lib.rdpi_batch_forward, drive_V, rate_um_per_s)

    def _displacement(self, function: Any, drive_V: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        ffi = self._module.ffi
        drive_V = _array(drive_V, self._dtype, "drive_V")
        rate_um_per_s = _array(rate_um_per_s, self._dtype, "rate_um_per_s")
        _check_alike(drive_V, rate_um_per_s)
        displacement_um = np.empty_like(drive_V)
        function(self._self, pointer(ffi, drive_V), pointer(ffi, rate_um_per_s), len(drive_V),
                 pointer(ffi, displacement_um))
        return displacement_um

    @property
    def memory_um(self) -> np.ndarray:
        """States of the plays, shape (n + 1,); assigning validates as rdpi_f32_set_memory does."""
        states = np.empty(self.parameters.plays, self._dtype)
        self._module.lib.rdpi_f32_get_memory(self._self, pointer(self._module.ffi, states))
        return states

    @memory_um.setter
    def memory_um(self, states_um: np.ndarray) -> None:
        states = _array(states_um, self._dtype, "memory_um")
        _check_states(states, self.parameters.plays)
        self._check(self._module.lib.rdpi_f32_set_memory(self._self, pointer(self._module.ffi, states)))
        if self._chain is not None:
            self._module.lib.rdpi_f32_chain_settle(self._chain)

    @property
    def counts(self) -> dict[str, int]:
        """Since the start: steps flagged guard, clip (range or slew) and input, samples reported as missed."""
        return {key: getattr(self._self, f"{key}_count") for key in COUNTS}

    def _check(self, status: int) -> None:
        _check(self._module, status)


class FixedPoint:
    """One rdpi_q31_t with the parameters of `model`, or with a chain the one in an rdpi_q31_chain_t; um, V and um/s
    outside, integers inside.

    any_sample_time: as for Firmware. Raises BadInput if 32 bits cannot hold the model, or with the library's own words
    if it refuses the parameters.
    """

    def __init__(self, model: Model, sample_time_s: float, chain: Chain | None = None,
                 any_sample_time: bool = False) -> None:
        arguments.of_kind(model, Model, "model").validate()
        self._module = _load("f32")[0]
        ffi, lib = self._module.ffi, self._module.lib
        self.parameters, self._limits_V = parameters.q31(model), (model.drive.min_V, model.drive.max_V)
        self._scale = self.parameters.scale
        self._params, self._arrays = _struct(self._module, "q31", _unbounded(self.parameters) if any_sample_time else
                                             self.parameters)
        if not 0.5e-9 < arguments.number(sample_time_s, "sample_time_s", finite=False) < 2**32 * 1e-9 - 1e-9:
            raise BadInput(f"sample_time_s is {sample_time_s:g}; fixed point takes 1 ns to 4.29 s")
        if chain is None:
            self._chain, self._self = None, ffi.new("rdpi_q31_t *")
            _check_init(self._module, lib.rdpi_q31_init(self._self, self._params, round(sample_time_s * 1e9)), model,
                        sample_time_s)
            return
        self.chain = q31_chain(chain, self._scale, model.where)
        self._chain_params, self._poles = _struct(self._module, "q31_chain", self.chain)
        self._chain_params.axis = self._params
        self._chain = ffi.new("rdpi_q31_chain_t *")
        self._self = ffi.addressof(self._chain, "axis")
        _check_init(self._module, lib.rdpi_q31_chain_init(self._chain, self._chain_params, round(sample_time_s * 1e9)),
                    model, sample_time_s)

    def step(self, reference_um: np.ndarray) -> Steps:
        """rdpi_q31_step for each reference in um, shape (samples,), going on from the present state.

        With a chain rdpi_q31_chain_step: the references are preview_samples ahead.
        """
        ffi, lib = self._module.ffi, self._module.lib
        reference = self.references(reference_um)
        columns = [np.empty(len(reference), kind) for kind in (np.int32, np.int32, np.uint32, np.uint32)]
        function, instance = ((lib.rdpi_batch_q31_step, self._self) if self._chain is None else
                              (lib.rdpi_batch_q31_chain_step, self._chain))
        function(instance, pointer(ffi, reference), len(reference), *(pointer(ffi, one) for one in columns))
        drive, rate, flags, dac_code = columns
        return Steps(self._volts(drive), rate * self._scale.um_per_s_per_rate, flags, dac_code)

    def references(self, reference_um: np.ndarray) -> np.ndarray:
        """What the firmware is given for references in um, int32 (samples,)."""
        reference_um = arguments.series(reference_um, "reference_um", finite=False)
        usable = np.abs(reference_um) <= self._module.lib.RDPI_MAX_REFERENCE_UM
        return np.where(usable, parameters.integers(reference_um, self._scale.um_per_reference, self._scale.offset_um),
                        np.int32(NO_REFERENCE))

    @property
    def preview_samples(self) -> int:
        """How far ahead of the present the references for `step` must be."""
        return 0 if self._chain is None else self._chain.preview_samples

    def missed(self, ticks: int) -> None:
        """rdpi_q31_missed: so many samples went by without a step."""
        if self._chain is None:
            self._module.lib.rdpi_q31_missed(self._self, _ticks(ticks))
        else:
            self._module.lib.rdpi_q31_chain_missed(self._chain, _ticks(ticks))

    def swept(self, ticks: int) -> None:
        """As Firmware.swept."""
        if self._chain is not None:
            self._module.lib.rdpi_q31_chain_swept(self._chain, _ticks(ticks))

    def sweep(self) -> tuple[np.ndarray, np.ndarray]:
        """The whole start-up sweep: drives in V and DAC codes, both (samples,).

        rdpi_q31_sweep until it ends, then rdpi_q31_forget_sweep.
        """
        lib = self._module.lib
        function, instance = ((lib.rdpi_batch_q31_sweep, self._self) if self._chain is None else
                              (lib.rdpi_batch_q31_chain_sweep, self._chain))
        drive, codes = _sweep(self._module, function, instance, np.int32)
        return self._volts(drive), codes

    def predict(self, drive_V: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        """rdpi_q31_predict for each drive in V and rate in um/s: the displacement in um, shape (samples,)."""
        return self._displacement(self._module.lib.rdpi_batch_q31_predict, drive_V, rate_um_per_s)

    def forward(self, drive_V: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        """rdpi_q31_forward for each drive in V and rate in um/s: the displacement in um, shape (samples,)."""
        return self._displacement(self._module.lib.rdpi_batch_q31_forward, drive_V, rate_um_per_s)

    def _displacement(self, function: Any, drive_V: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        ffi, scale = self._module.ffi, self._scale
        drive_V = arguments.series(drive_V, "drive_V", finite=False)
        rate_um_per_s = arguments.series(rate_um_per_s, "rate_um_per_s", finite=False)
        _check_alike(drive_V, rate_um_per_s)
        drive = parameters.integers(drive_V, scale.V_per_drive, scale.offset_V)
        rate = parameters.integers(rate_um_per_s, scale.um_per_s_per_rate)
        rate = np.where(np.isfinite(rate_um_per_s) & (rate_um_per_s >= 0), rate, np.int32(-1))
        displacement = np.empty_like(drive)
        function(self._self, pointer(ffi, drive), pointer(ffi, rate), len(drive), pointer(ffi, displacement))
        return np.where(displacement == NO_REFERENCE, np.nan, displacement * scale.um_per_reference + scale.offset_um)

    def _volts(self, drive: np.ndarray) -> np.ndarray:
        """Clipped, because the ends of the range are rounded too."""
        return np.clip(drive * self._scale.V_per_drive + self._scale.offset_V, *self._limits_V)

    @property
    def memory_um(self) -> np.ndarray:
        """States of the plays, shape (n + 1,); assigning validates as rdpi_q31_set_memory does."""
        states = np.empty(self.parameters.plays, np.int32)
        self._module.lib.rdpi_q31_get_memory(self._self, pointer(self._module.ffi, states))
        return states * self._scale.um_per_drive

    @memory_um.setter
    def memory_um(self, states_um: np.ndarray) -> None:
        states_um = arguments.series(states_um, "memory_um", finite=False)
        _check_states(states_um, self.parameters.plays)
        states = parameters.states(states_um, self._scale.um_per_drive, self.parameters.play[:, 0])
        self._check(self._module.lib.rdpi_q31_set_memory(self._self, pointer(self._module.ffi, states)))
        if self._chain is not None:
            self._module.lib.rdpi_q31_chain_settle(self._chain)

    @property
    def counts(self) -> dict[str, int]:
        """As Firmware.counts."""
        return {key: getattr(self._self, f"{key}_count") for key in COUNTS}

    def _check(self, status: int) -> None:
        _check(self._module, status)


def digest(numbers: F32 | Q31 | F32Chain | Q31Chain) -> int:
    """What the library makes of parameters, in single precision or fixed point: the field `digest`."""
    return _struct(_load("f32")[0], KINDS[type(numbers)], numbers)[0].digest


def status_text(status: int) -> str:
    """rdpi_status_text: a status in the library's words."""
    module = _load("f32")[0]
    return module.ffi.string(module.lib.rdpi_status_text(status)).decode()


def plays(x_um: np.ndarray, thresholds_um: np.ndarray, states_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bank of play operators in double: x (samples,), thresholds (n + 1,), states at the start (n + 1,).

    Returns the outputs, shape (samples, n + 1), and the states at the end, shape (n + 1,), all in um.
    """
    module, dtype = _load("f64")
    x_um, thresholds_um = _array(x_um, dtype, "x_um"), _array(thresholds_um, dtype, "thresholds_um")
    states_um = _array(states_um, dtype, "states_um").copy()  # the library moves them
    if states_um.shape != thresholds_um.shape:
        raise BadInput(f"{states_um.shape} states, {thresholds_um.shape} thresholds; there is one each per play")
    outputs_um = np.empty((len(x_um), len(thresholds_um)), dtype)
    module.lib.rdpi_batch_plays(pointer(module.ffi, x_um), len(x_um), pointer(module.ffi, thresholds_um),
                                len(thresholds_um), pointer(module.ffi, states_um), pointer(module.ffi, outputs_um))
    return outputs_um, states_um


def rate(z_um: np.ndarray, sample_time_s: float, window_s: float, filter_s: float) -> np.ndarray:
    """The firmware's rate estimator in double, um/s, shape as z (samples,). Raises BadInput for too long a window."""
    module, dtype = _load("f64")
    z_um = _array(z_um, dtype, "z_um")
    sample_time_s, window_s, filter_s = (
        arguments.number(value, name, finite=False) for name, value in
        (("sample_time_s", sample_time_s), ("window_s", window_s), ("filter_s", filter_s)))
    if sample_time_s == 0:
        raise BadInput("sample_time_s is 0; must be positive")
    result = np.empty_like(z_um)
    check_rate(module.lib.rdpi_batch_rate(window_s, filter_s, sample_time_s, pointer(module.ffi, z_um), len(z_um),
                                          pointer(module.ffi, result)), (window_s, filter_s, sample_time_s))
    return result


def check_rate(status: int, rate: tuple[float, float, float]) -> None:
    """Raise BadInput for a status of the rate estimator with this window, filter and sample time, s."""
    if status != _load("f64")[0].lib.RDPI_OK:
        window_s, _, sample_time_s = rate
        raise BadInput(f"rate estimator: {status_text(status)} (window {window_s:g} s at "
                       f"{1 / sample_time_s:g} samples/s); choose a shorter window")


def _struct(module: Any, kind: str, numbers: F32 | Q31 | F32Chain | Q31Chain) -> tuple[Any, list[Any]]:
    """The C struct of parameters, schema and digest included, and what it points to: keep both alive."""
    ffi, lib = module.ffi, module.lib
    struct = ffi.new(f"rdpi_{kind}_params_t *")
    struct.schema = lib.RDPI_PARAMS_SCHEMA
    kept: list[Any] = []
    for name in (item.name for item in fields(numbers) if item.name != "scale"):
        value = getattr(numbers, name)
        if isinstance(value, np.ndarray):
            kept.append(value)
            value = ffi.cast(ffi.typeof(getattr(struct, name)), ffi.from_buffer(value))
        elif isinstance(value, tuple):  # rows of unlike integers
            kept.append(ffi.new("rdpi_q31_pole_t[]", value))
            value = kept[-1]
        setattr(struct, name, value)
    struct.digest = getattr(lib, f"rdpi_{kind}_digest")(struct)
    return struct, kept


def _sweep(module: Any, function: Any, instance: Any, dtype: type) -> tuple[np.ndarray, np.ndarray]:
    drives, codes, taken = [], [], 0
    while not taken:
        drives.append(np.empty(SWEEP_CHUNK, dtype))
        codes.append(np.empty(SWEEP_CHUNK, np.uint32))
        taken = function(instance, SWEEP_CHUNK, pointer(module.ffi, drives[-1]), pointer(module.ffi, codes[-1]))
    samples = SWEEP_CHUNK * (len(drives) - 1) + taken
    return np.concatenate(drives)[:samples], np.concatenate(codes)[:samples]


def _unbounded(numbers: F32 | Q31) -> F32 | Q31:
    """The parameters for any sample time."""
    return replace(numbers, **{item.name: 0 for item in fields(numbers) if item.name.startswith(("min_sample_time",
                                                                                                 "max_sample_time"))})


def _check(module: Any, status: int) -> None:
    if status != module.lib.RDPI_OK:
        raise BadInput(f"the firmware library refuses: {status_text(status)}")


def _check_init(module: Any, status: int, model: Model, sample_time_s: float) -> None:
    if status == module.lib.RDPI_ERR_SAMPLE_RANGE:
        check_sample_time(model, sample_time_s)
    if status != module.lib.RDPI_OK:
        raise BadInput(f"the firmware library refuses: {status_text(status)} (sample_time_s is {sample_time_s:g})")


def load_double() -> Any:
    """The compiled module in double precision."""
    return _load("f64")[0]


def _load(real: str) -> tuple[Any, type]:
    return importlib.import_module(f"{__package__}._{real}"), DTYPES[real]


def _ticks(ticks: int) -> int:
    ticks = arguments.number(ticks, "ticks")
    if not 0 <= ticks < 2**32 or ticks != int(ticks):
        raise BadInput(f"ticks is {ticks:g}; must be a whole number, 0 to {2**32 - 1}")
    return int(ticks)


def _check_alike(drive_V: np.ndarray, rate_um_per_s: np.ndarray) -> None:
    if len(drive_V) != len(rate_um_per_s):
        raise BadInput(f"{len(drive_V)} drives, {len(rate_um_per_s)} rates; give one rate per drive")


def _check_states(states_um: np.ndarray, plays: int) -> None:
    if len(states_um) != plays:
        raise BadInput(f"memory_um: {len(states_um)} states for {plays} plays")


def _array(values: np.ndarray, dtype: type, name: str) -> np.ndarray:
    values = arguments.series(values, name, finite=False)  # the library says what is made of NaN and infinity
    with np.errstate(over="ignore"):  # what overflows becomes infinite, and the library knows infinity
        return np.ascontiguousarray(values, dtype=dtype)


def pointer(ffi: Any, array: np.ndarray) -> Any:
    """Typed pointer to a contiguous array's data; the caller keeps the array alive."""
    kinds = {"f": "rdpi_real_t[]", "u": "uint32_t[]", "i": "int32_t[]"}
    return ffi.from_buffer(kinds[array.dtype.kind], array, require_writable=False)
