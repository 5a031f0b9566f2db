"""What a commissioning drive will and will not be able to show, computed from the drive before it is played.

The drive is put on a nominal actuator (plays that make a loop a tenth of the stroke wide) and every effect is turned
into the change of the displacement that it makes per unit of its parameter. Least squares then says how well the
parameter can be told from what is left of that change once everything that imitates it is fitted too: the plays, their
rate law, bent curves, drift, and the neighbouring effects. An effect counts as shown from SURE standard errors on.

Two things blur it: the sensor's white noise, and what the operator misses. Where the drive moves, that takes about
PER_BRANCH independent values from one reversal to the next, once per rate for triangles, which only repeat. Behind an
edge it takes one value over the first EDGE_SAMPLES and one for each further octave of time: a hold ten times as long
tells little more.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

NOISE = 0.0005  # rms of a sample, of the stroke: a usual sensor
MISFIT = 0.005  # rms that an operator misses where it moves, of the move
PER_BRANCH, EDGE_SAMPLES = 4, 20
SURE = 3.0
THRESHOLDS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4)  # of plays, of the range
WEIGHTS = (0.75, 0.08, 0.06, 0.05, 0.03, 0.03)
TIMES = 4  # time constants tried per decade
RELAXED = 0.02  # share of a relaxation that is asked for
SETTLED = 3.0  # time constants that a hold must last to show where a relaxation ends
CREEP_TIMES_S = 10.0 ** np.arange(-1.0, 3.01, 0.5)  # lags whose sum creeps as the logarithm of time, two per decade
DAMPING = 0.05
LEAST_PERIOD = 3.0  # samples of a ringing's period that can still be simulated
PER_OCTAVE = 3  # resonances tried
RING_PERIODS = 5  # of the lowest resonance in the longest hold
THIN_PER_PERIOD, THIN_PER_OCTAVE = 50, 40  # samples looked at: of the multisine's highest line, and behind an edge


@dataclass(frozen=True)
class Shown:
    """One line: what, from which to which value (None: not at all), unit, and what limits it."""

    what: str
    low: float | None
    high: float | None
    unit: str
    text: str

    def to_json(self) -> dict[str, object]:
        return asdict(self)


def shown(columns: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> list[Shown]:
    """What the drive that `make_drive` made of kind "commission" can show."""
    drive = _Drive(columns["command_V"], metadata)
    return [_delay(drive), _lag(drive), _relaxation(drive), _creep(drive), _resonance(drive), _rate_law(drive),
            *_curves(drive), _loops(drive), *_never(drive)]


class _Drive:
    """The drive in shares of its range, the nominal actuator's displacement, and what least squares needs."""

    def __init__(self, command_V: np.ndarray, metadata: Mapping[str, str]) -> None:
        self.low_V, self.span_V = (float(metadata[key]) for key in ("min_V", "max_V"))
        self.span_V -= self.low_V
        self.rate_hz = float(metadata["sample_rate_hz"])
        self.step_s = 1 / self.rate_hz
        self.parts = {name: slice(*(round(float(time) * self.rate_hz) for time in times.split("-")))
                      for name, times, _ in (part.split() for part in metadata["parts"].split(", "))}
        self.u = (command_V - self.low_V) / self.span_V - 0.5
        self.turns = turns(self.u)
        self.plays = plays(self.u, THRESHOLDS)
        self.z = self.plays @ WEIGHTS
        self.speed = np.abs(np.gradient(self.u)) * self.rate_hz
        self.edges = self._edges()
        self.holds = np.append(self.edges, len(self.u))
        self.blur = self._blur()
        self.rows, self.weight = self._rows(max(float(f) for f in metadata["multisine_hz"].split()))
        self.imitators = np.column_stack([column[self.rows] for column in self._imitators()])

    @property
    def hold_s(self) -> float:
        return float(np.diff(self.holds).max()) * self.step_s

    def _edges(self) -> np.ndarray:
        """First samples of the moves that end in a hold; the first hold may follow the sawtooth directly."""
        first = self.parts["steps"].start
        moving = np.diff(self.u[first:], append=self.u[-1]) != 0
        begin = np.flatnonzero(moving & ~np.append(False, moving[:-1]))
        return np.unique(np.append(first, first + begin + 1))

    def _blur(self) -> np.ndarray:
        """Variance per sample that makes independent samples as good as what is really there."""
        blur = np.full(len(self.u), NOISE**2)
        for name in ("sweep", "multisine"):
            if part := self.parts.get(name):
                values = PER_BRANCH * max(1, np.count_nonzero((self.turns > part.start) & (self.turns < part.stop)))
                blur[part] += MISFIT**2 * max(1.0, (part.stop - part.start) / values)
        part = self.parts["sawtooth"]
        rates = np.round(np.log(np.maximum(self.speed[part], 1e-9)), 2)
        _, which, counts = np.unique(rates, return_inverse=True, return_counts=True)
        blur[part] += MISFIT**2 * np.maximum(1.0, counts[which] / (2 * PER_BRANCH))
        for edge, end in zip(self.edges, self.holds[1:]):
            # The first hold follows a triangle.
            move = 1.0 if edge == self.parts["steps"].start else np.ptp(self.u[edge - 1:end])
            first = EDGE_SAMPLES + np.argmax(self.u[edge:end] == self.u[end - 1])
            blur[edge:end] += (MISFIT * move) ** 2 * np.maximum(first, np.arange(end - edge))
        return blur

    def _rows(self, highest_hz: float) -> tuple[np.ndarray, np.ndarray]:
        """Samples that are looked at, fewer where all is smooth, and the root of the information in each."""
        every = max(1, int(self.rate_hz / (THIN_PER_PERIOD * highest_hz)))
        rows = [np.arange(0, self.edges[0], every)]
        for edge, end in zip(self.edges, self.holds[1:]):
            count = 2 + int(THIN_PER_OCTAVE * np.log2(max(2, end - edge)))
            near = min(end - edge, 2 * THIN_PER_OCTAVE + int(self.edge_s * self.rate_hz))
            rows.append(edge + np.unique(np.r_[np.arange(near), np.geomspace(1, end - edge, count).astype(int) - 1]))
        rows = np.concatenate(rows)
        return rows, np.sqrt(np.diff(rows, append=len(self.u)) / self.blur[rows])

    @property
    def edge_s(self) -> float:
        """How long the move to a step lasts."""
        begin, end = self.edges[-2], self.edges[-1]
        return float(1 + np.argmax(self.u[begin:end] == self.u[end - 1])) * self.step_s

    def _imitators(self) -> Iterator[np.ndarray]:
        """Columns of what is fitted in any case: plays, rate law, bends, drift, and a constant per hold."""
        yield from self.plays.T
        yield from (self.z**2, self.z**3, np.linspace(-1, 1, len(self.u)))
        fast = self.speed / self.speed.max()
        yield from (fast * self.plays[:, k] for k in (0, 2, 4))
        edges = [0, *self.edges, len(self.u)]
        for first, last in zip(edges, edges[1:]):
            constant = np.zeros(len(self.u))
            constant[first:last] = 1
            yield constant

    def lagged(self, time_s: float) -> np.ndarray:
        """What a first-order lag takes away, exact for a signal that is straight between samples."""
        from scipy.signal import lfilter

        ratio = self.step_s / time_s
        a, g = np.exp(-ratio), -np.expm1(-ratio) / ratio
        return lfilter([1 - g, g - a], [1, -a], self.z - self.z[0]) - (self.z - self.z[0])

    def delayed(self) -> np.ndarray:
        """Change per second of delay."""
        return -np.diff(self.z, prepend=self.z[0]) * self.rate_hz

    def errors(self, columns: Iterable[np.ndarray], rivals: list[np.ndarray], without: Sequence[int] = ()
               ) -> np.ndarray:
        """Standard error of each column's coefficient, by itself beside the rivals and the imitators.

        `columns` may be an iterator: one at a time is held.
        """
        beside = np.column_stack([np.delete(self.imitators, without, axis=1), *(rival[self.rows] for rival in rivals)])
        beside *= self.weight[:, None]
        beside /= np.maximum(np.linalg.norm(beside, axis=0), np.finfo(float).tiny)
        gram, found = beside.T @ beside, []
        for column in columns:
            column = column[self.rows] * self.weight
            size = max(float(np.linalg.norm(column)), np.finfo(float).tiny)
            cross = beside.T @ (column / size)
            left = 1 - float(cross @ np.linalg.lstsq(gram, cross, rcond=1e-10)[0])
            found.append(1 / (size * np.sqrt(left)) if left >= 1e-9 else np.inf)
        return np.array(found)

    def times_s(self) -> np.ndarray:
        """Time constants from far under a sample to the longest hold."""
        first, last = np.log10(0.01 * self.step_s), np.log10(self.hold_s / SETTLED)
        return np.logspace(first, last, max(2, round(TIMES * (last - first))))


def turns(u: np.ndarray) -> np.ndarray:
    """Samples at which the signal turns back."""
    steps = np.diff(u)
    moving = np.flatnonzero(steps)
    return moving[1:][np.diff(np.sign(steps[moving])) != 0]


def plays(u: np.ndarray, thresholds: tuple[float, ...]) -> np.ndarray:
    """Outputs of play operators that start at rest on the input: (samples, thresholds)."""
    found = np.empty((len(u), len(thresholds)))
    ends = [0, *(turns(u) + 1), len(u)]
    r, state = np.asarray(thresholds), np.full(len(thresholds), u[0])
    for first, last in zip(ends, ends[1:]):
        piece = u[first:last, None]
        found[first:last] = np.maximum(piece - r, np.minimum(piece + r, state))
        state = found[last - 1]
    return found


# --- one statement each -----------------------------------------------------------------------------------------------

def _delay(drive: _Drive) -> Shown:
    least = SURE * float(drive.errors([drive.delayed()], [])[0])
    return Shown("delay", least, None, "s", f"from {_time(least)} ({least * drive.rate_hz:.2g} of a sample) on, if "
                 "nothing else comes late; half a sample of it is the converter's own hold")


def _lag(drive: _Drive) -> Shown:
    times = drive.times_s()
    seen = drive.errors((drive.lagged(time) for time in times), [drive.delayed()]) * SURE <= 1
    if not seen.any():
        return Shown("lag", None, None, "s", "cannot be told from a delay: no edge is fast enough; allow a higher "
                     "--slew or --sample-rate")
    low, high = times[seen][[0, -1]]
    return Shown("lag", float(low), float(high), "s", f"time constants from {_time(low)} to {_time(high)}; a shorter "
                 "one is seen as a delay of the same time")


def _relaxation(drive: _Drive) -> Shown:
    times = drive.times_s()
    times = times[times >= drive.step_s]
    rivals = [drive.delayed(), drive.lagged(drive.step_s), _creeping(drive)]
    share = SURE * drive.errors((drive.lagged(time) for time in times), rivals)
    seen = share <= RELAXED
    if not seen.any():
        return Shown("relaxation", None, None, "s", f"a share of {100 * RELAXED:g} % cannot be told from delay, lag "
                     "and creep; ask for a longer --duration or allow a higher --slew")
    low, high = times[seen][[0, -1]]
    return Shown("relaxation", float(low), float(high), "s",
                 f"shares from {100 * RELAXED:g} % on with time constants from {_time(low)} to {_time(high)} (at best "
                 f"{100 * share[seen].min():.2g} %); a faster one is seen as lag, a slower one as creep")


def _creeping(drive: _Drive) -> np.ndarray:
    return sum(drive.lagged(time) for time in CREEP_TIMES_S) / 2 / 100


def _creep(drive: _Drive) -> Shown:
    least = SURE * float(drive.errors([_creeping(drive)], [drive.lagged(0.01)])[0])
    if not least < 20:
        return Shown("creep", None, None, "%/decade", f"the longest hold of {_time(drive.hold_s)} is too short; "
                     "give a longer --duration")
    return Shown("creep", least, 20.0, "%/decade", f"from {least:.2g} % of a move per decade on, up to the decade that "
                 f"ends at {_time(drive.hold_s)}, the longest hold; what comes later is extrapolated")


def _resonance(drive: _Drive) -> Shown:
    from scipy.signal import cont2discrete, lfilter

    lowest, highest = RING_PERIODS / drive.hold_s, drive.rate_hz / LEAST_PERIOD
    if lowest >= highest:
        return Shown("resonance", None, None, "Hz", "no hold is long enough to ring in; ask for a longer --duration")
    grid = np.geomspace(lowest, highest, 1 + int(PER_OCTAVE * np.log2(highest / lowest)))

    def rung(f0_hz: float) -> np.ndarray:
        w = 2 * np.pi * f0_hz * drive.step_s
        b, a, _ = cont2discrete(([w * w], [1, 2 * DAMPING * w, w * w]), 1.0, method="foh")
        return lfilter(np.ravel(b), a, drive.z - drive.z[0]) - (drive.z - drive.z[0])

    # Ringing must be seen beside delay and lag, which are what its slow side looks like.
    rivals = [drive.delayed(), drive.lagged(2 * drive.step_s)]
    seen = SURE * drive.errors(map(rung, grid), rivals) <= 1
    if not seen.any():
        return Shown("resonance", None, None, "Hz", "the edges are too slow to make it ring; allow faster rates")
    # The edge's spectrum has gaps; above the first one only some resonances would ring.
    first = int(np.argmax(seen))
    last = len(seen) - 1 if seen[first:].all() else first + int(np.argmin(seen[first:])) - 1
    low, high = float(grid[first]), float(grid[last])
    why = (f"{LEAST_PERIOD:g} samples per period are needed, {2 * high / drive.rate_hz:.2g} of half the sample rate"
           if last == len(seen) - 1 else
           f"edges of {_time(drive.edge_s)} do not make a higher one ring")
    return Shown("resonance", low, high, "Hz", f"from {low:.4g} to {high:.4g} Hz (damping {DAMPING:g}); {why}")


def _rate_law(drive: _Drive) -> Shown:
    part = drive.parts["sawtooth"]
    rates = drive.speed[part][drive.speed[part] > 0] * drive.span_V
    slow, fast = np.percentile(rates, (1, 99))
    fast_column = [drive.speed / drive.speed.max() * drive.z]
    rated = range(len(THRESHOLDS) + 3, len(THRESHOLDS) + 6)
    least = SURE * float(drive.errors(fast_column, [drive.delayed(), drive.lagged(drive.step_s)], list(rated))[0])
    return Shown("rate law", slow, fast, "V/s", f"slopes between {slow:.4g} and {fast:.4g} V/s; changes from "
                 f"{100 * least:.2g} % on over that range, beside a delay. Rates in um/s are known only once "
                 "um per V is")


def _curves(drive: _Drive) -> list[Shown]:
    bent_u = drive.u + 0.05 * (0.25 - drive.u**2)
    before = (plays(bent_u, THRESHOLDS) @ WEIGHTS - drive.z) / 0.05
    after = 0.25 - drive.z**2
    first_bend = len(THRESHOLDS)
    texts = []
    for what, column, rival in (("input curve", before, after), ("static curve", after, before)):
        alone, beside = (SURE * float(drive.errors([column], rivals, [first_bend, first_bend + 1])[0])
                         for rivals in ([], [rival]))
        # 0.25 of a unit coefficient is the height of the bow in the middle of the range
        texts.append(Shown(what, alone / 4, None, "of the range", f"bows from {25 * alone:.2g} % of the range on; "
                           f"which of input curve and static curve it is, from {25 * beside:.2g} % on"))
    return texts


def _loops(drive: _Drive) -> Shown:
    heights = drive.u[drive.turns]
    swings = np.abs(np.diff(heights))
    swings = swings[swings > 0.01]
    small = float(np.percentile(swings, 5))
    return Shown("loops", small, float(swings.max()), "of the range", f"{len(swings)} half loops, nine tenths of them "
                 f"of {100 * small:.2g} % of the range or more, up to {100 * swings.max():.3g} %; smaller loops are "
                 "extrapolated")


def _never(drive: _Drive) -> list[Shown]:
    end = len(drive.u) * drive.step_s
    return [
        Shown("creep beyond the hold", None, None, "s", f"no: nothing rests longer than {_time(drive.hold_s)}"),
        Shown("where a delay or lag stands", None, None, "s", "no: before or behind the actuator looks the same; "
              "record monitor_V beside it"),
        Shown("warming, other axes", None, None, "", f"no: not within {_time(end)} of one axis; record their columns")]


def _time(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            break
    return f"{seconds / size:.3g} {unit}"
