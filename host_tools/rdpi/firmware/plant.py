"""The chain from command to displacement, compiled: blocks, each a difference equation and what it remembers.

host_tools/firmware/plant.h holds the equations. A block is parameters; a memory is one array per block, and what comes
out of `run` goes on from there, whatever the number of samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..data import Past
from ..errors import BadInput
from .library import Firmware, check_rate, load_double, pointer

LINE, BENT, CUBIC, CLAMP, ROUND, STAIRCASE, SLEW, DELAY, LAGS, RING, PLAY, WIDEN, OPERATOR = (
    "LINE", "BENT", "CUBIC", "CLAMP", "ROUND", "STAIRCASE", "SLEW", "DELAY", "LAGS", "RING", "PLAY", "WIDEN", "OPERATOR")
NONE = np.zeros(0)


@dataclass(frozen=True, eq=False)
class Block:
    """One difference equation at one sample time."""

    kind: str
    numbers: tuple[float, ...] = ()  # p of plant.h
    a: np.ndarray = field(default_factory=lambda: NONE)
    b: np.ndarray = field(default_factory=lambda: NONE)
    c: np.ndarray = field(default_factory=lambda: NONE)
    count: int = 0
    ratios: np.ndarray = field(default_factory=lambda: NONE)  # of LAGS: sample time over time constant
    sample_time_s: float = 0.0  # of LAGS
    rate: tuple[float, float, float] | None = None  # of WIDEN: window, filter and sample time of its rate estimator, s
    axis: Firmware | None = None  # of OPERATOR
    of_control: bool = False
    of_actuator: bool = False  # LAGS that go on from where the actuator had been at rest before

    def settled(self, first: float, past: Past = Past()) -> np.ndarray:
        """What it remembers before a first sample `first` of what was before. Only the actuator's lags remember moves:
        what stands around it had settled.
        """
        if self.kind == SLEW or self.kind == PLAY:
            return np.array([first])
        if self.kind == DELAY:
            return np.r_[0.0, np.full(self.count - 1, first)]
        if self.kind == OPERATOR:
            return np.r_[0.0, 0.0, past.rate_um_per_s, np.zeros(self.count)]
        if self.kind == RING:
            return np.array([0.0, 0.0, first])
        if self.kind == LAGS:
            if not self.of_actuator or not len(past.away_um):
                return np.r_[np.zeros(self.count), first, first]
            times_s = self.sample_time_s / self.ratios
            left = np.exp((self.sample_time_s - past.since_s) / times_s[:, None]) @ past.away_um
            return np.r_[left, first, first + past.rest_um]
        return NONE


@dataclass(frozen=True, eq=False)
class Held:
    """What a chain of blocks remembers between two samples: an array per block, of rate estimators their bytes."""

    arrays: tuple[np.ndarray, ...]
    rates: tuple[bytes, ...]
    plays_um: np.ndarray  # of the operator; (0,) without one


def lags_block(sample_time_s: float, times_s: Sequence[float], shares: Sequence[float], direct: float = 0.0,
               of_actuator: bool = False) -> Block:
    """u + direct (u - rest) + sum of share (l - u), l' = (u - l) / T; rest is where all had settled once."""
    with np.errstate(over="ignore"):  # a lag that is infinitely shorter than a sample is none
        ratios = sample_time_s / np.asarray(times_s, float)
    return Block(LAGS, (direct,), np.exp(-ratios), -np.expm1(-ratios) / ratios, np.asarray(shares, float), len(ratios),
                 ratios, sample_time_s, of_actuator=of_actuator)


def delay_block(samples: float) -> Block:
    """Straight between samples."""
    whole = int(samples)
    return Block(DELAY, (samples - whole,), count=whole + 2)


def ring_block(numerator: Sequence[float], denominator: Sequence[float]) -> Block:
    """Second order: b and a of `scipy.signal.lfilter`, three each, a[0] = 1 and a gain of 1 at rest."""
    return Block(RING, (), np.asarray(denominator, float), np.asarray(numerator, float))


def operator_block(axis: Firmware, rates_um_per_s: tuple[float, float], control: tuple[float, float], of_control: bool,
                   steepness: float, longest: int) -> Block:
    """The operator of a compiled library, whose rate lies between `rates_um_per_s`; `control`: offset in um and gain in
    um/V of the control input, whose rate it is where it is not the displacement's; `steepness`: the saturation's steepest
    piece over its flattest; `longest`: samples over which the rate is taken at most.
    """
    return Block(OPERATOR, (*rates_um_per_s, *control, steepness), count=longest, axis=axis, of_control=of_control)


class Bank:
    """Blocks one after the other, and what they remember."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        module = load_double()
        self._ffi, self._lib = module.ffi, module.lib
        self._structs = self._ffi.new("rdpi_block_t[]", len(self.blocks))
        self._kept: list[Any] = []  # what the structs point to
        self._arrays: list[np.ndarray] = []
        self._rates: list[Any] = []
        self._axis: Firmware | None = None
        for struct, block in zip(self._structs, self.blocks):
            self._fill(struct, block)
        self._fresh = [self._bytes(rate) for rate in self._rates]
        self._one = np.empty((3, 1))
        self._pointers = tuple(pointer(self._ffi, row) for row in self._one)

    def _fill(self, struct: Any, block: Block) -> None:
        struct.kind = getattr(self._lib, f"RDPI_BLOCK_{block.kind}")
        struct.count = block.count
        for k, number in enumerate(block.numbers):
            struct.p[k] = number
        state = block.settled(0.0)
        for name, array in (("a", block.a), ("b", block.b), ("c", block.c), ("state", state)):
            if len(array):
                self._kept.append(at := self._ffi.from_buffer("rdpi_real_t[]", array))
                setattr(struct, name, at)
        self._arrays.append(state)
        if block.rate is not None:
            self._rates.append(self._ffi.new("rdpi_f32_rate_t *"))
            check_rate(self._lib.rdpi_plant_rate_init(self._rates[-1], *block.rate), block.rate)
            struct.rate = self._rates[-1]
        if block.axis is not None:
            self._axis, struct.axis, struct.of_control = block.axis, block.axis.instance, block.of_control

    def _bytes(self, rate: Any) -> bytes:
        return bytes(self._ffi.buffer(rate))

    @property
    def held(self) -> Held:
        return Held(tuple(one.copy() for one in self._arrays), tuple(map(self._bytes, self._rates)),
                    self._axis.memory_um if self._axis is not None else NONE)

    @held.setter
    def held(self, held: Held) -> None:
        if [len(one) for one in held.arrays] != [len(one) for one in self._arrays] or len(held.rates) != len(self._rates):
            raise BadInput("the state is one of another model, or of another sample time")
        if self._axis is not None:
            self._axis.memory_um = held.plays_um
        for array, kept in zip(self._arrays, held.arrays):
            array[:] = kept
        for rate, kept in zip(self._rates, held.rates):
            self._ffi.buffer(rate)[:] = kept

    def start(self, first: float, plays_um: np.ndarray = NONE, past: Past = Past()) -> None:
        """Sets the memory to that before a first sample `first`, as Block.settled has it, the operator's plays at
        `plays_um`.
        """
        self._forget(plays_um)
        self.passed_on(first, len(self.blocks), past)
        self._forget(plays_um)

    def _forget(self, plays_um: np.ndarray) -> None:
        """The operator's plays as given, and rate estimators that have seen no sample."""
        if self._axis is not None:
            self._axis.memory_um = plays_um
        for rate, fresh in zip(self._rates, self._fresh):
            self._ffi.buffer(rate)[:] = fresh

    def passed_on(self, first: float, count: int, past: Past = Past()) -> float:
        """What the first `count` blocks make of a first sample, each as Block.settled has it, and stays."""
        for k, block in enumerate(self.blocks[:count]):
            memory = block.settled(first, past)
            self._arrays[k][:] = memory
            first = float(self.run(np.array([first]), slice(k, k + 1))[0][0])
            self._arrays[k][:] = memory
        return first

    def run(self, signal: np.ndarray, blocks: slice = slice(None), driven_V: np.ndarray | None = None
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What comes out, what drove the operator, and its rate in um/s, of a signal, (samples,). `driven_V` is the
        latter's drive where the operator is none of the blocks.
        """
        out = np.array(signal, float)
        driven_V = np.array(out if driven_V is None else driven_V, float)
        rate = np.zeros(len(out))
        first, last, _ = blocks.indices(len(self.blocks))
        self._lib.rdpi_plant_run(self._structs + first, last - first, len(out),
                                 *(pointer(self._ffi, one) for one in (out, driven_V, rate)))
        return out, driven_V, rate

    def step(self, value: float) -> float:
        """`run` of one sample."""
        self._one[0, 0] = value
        self._lib.rdpi_plant_run(self._structs, len(self.blocks), 1, *self._pointers)
        return float(self._one[0, 0])


def lags(signal: np.ndarray, sample_time_s: float, times_s: Sequence[float], ahead: Sequence[float]) -> np.ndarray:
    """First-order lags of unit gain, exact for a signal (samples,) that is straight between samples, in double: how far
    they are ahead of it in all, (samples,). `ahead` is how far each is at the first sample.
    """
    block = lags_block(sample_time_s, times_s, np.ones(len(times_s)))
    before = np.divide(ahead, block.a, out=np.zeros(len(block.a)), where=block.a > 0)  # the first sample
    bank = Bank([block])
    bank.held = Held((np.r_[before, signal[0], 0.0],), (), NONE)
    return bank.run(signal)[0] - signal
