"""Identification: recordings to a model, as one bounded linear least-squares problem over all samples of all runs.

With the dead zones given, the model (Ang et al. 2003, eq. 8, 9, 14-17) is linear in its parameters once the saturation
stage stands on the side of the displacement:

    sum_i W_i(rho) (y_i - y_(i+1)) + offset = sum_j U_j seg_j(z),     W_i(rho) = A_i (1 - rho / top) + B_i rho / top

y_i are the outputs of the plays, U_j the slopes of the inverse saturation on its pieces (U_0 = 1) and seg_j the part of
z on piece j. A_i and B_i are the slopes at rest and at the highest rate, so that keeping every slope positive over the
whole range of rates is a lower bound on each unknown. The data are reduced to one small triangular factor; the outer
search over dead zones and the strength of the prior work on that alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .. import arguments, firmware
from ..data import RUN_COLUMNS, Recording, taken
from ..errors import BadInput
from ..model import (LARGEST, MAX_DAC_BITS, MAX_PLAYS, MIN_SLOPE_RATIO, SOURCES, Drive, Memory, Model, Rate, guarded,
                     Passport, operators, records)
from ..simulate import chain, signals
from . import localise, passport
from . import thresholds as tuned
from .checks import LARGEST_INPUT, check_run, check_together, correlation, reversals, stays_at_an_end
from .document import FitDocument, RateBand

GRID = np.linspace(0.12, 0.88, 20)  # candidate dead zones, as shares of the displacement's range
MAX_RATE_TIME_S = 1e3
RATE_BINS = 8
CHUNK = 1 << 12  # samples held as columns at a time: what fits into a processor's cache
FOLDS = 8  # at most so many groups of runs are left out in turn for the passport
THIN = 8  # of the samples, every how many are used to compare rate sources


@dataclass(frozen=True)
class Options:
    """What the user chooses; None leaves the choice to the data."""

    operators: int = 9  # n: plays with a positive threshold
    deadzones: int = 2  # m
    thresholds_um: tuple[float, ...] | None = None  # r_1 ... r_n instead of equal intervals
    rate_independent: bool = False
    rate_source: str = "displacement"
    rate_window_s: float = 0.0
    rate_filter_s: float = 0.0
    min_slope_ratio: float = MIN_SLOPE_RATIO
    min_V: float | None = None
    max_V: float | None = None
    slew_V_per_s: float | None = None
    dac_bits: int | None = None
    actuator: str | None = None


class RateSlopes(NamedTuple):
    """Slopes fitted to narrow bands of rate one by one, to compare with the model's lines (Fig. 7 of the paper)."""

    rate_um_per_s: np.ndarray  # (bands,)
    slopes: np.ndarray  # (bands, n + 1); NaN where the band's data do not reach the interval
    samples: np.ndarray  # (bands,)

    def bands(self) -> list[RateBand]:
        """A section of the document for each band."""
        return [RateBand(rate_um_per_s=rate, slopes=[None if np.isnan(w) else w for w in slopes], samples=samples)
                for rate, slopes, samples in zip(*self)]


class RunScore(NamedTuple):
    recording: Recording
    held_out: bool
    score: chain.Score
    memory: str


@dataclass
class Fit:
    """Result of an identification."""

    model: Model
    residual: tuple[float, float]  # rms of the regression as a share of the stroke: with the rate law, without one
    scores: list[RunScore]
    rate_slopes: RateSlopes
    noise_um: float
    warnings: list[str] = field(default_factory=list)

    def record(self) -> records.FitRecord:
        """The key `fit` of the model file."""
        return records.FitRecord(
            runs=[records.FittedRun(file=run.recording.path, digest=run.recording.digest, samples=len(run.recording),
                                    held_out=run.held_out, memory=run.memory, **run.score._asdict())
                  for run in self.scores],
            noise_um=self.noise_um, warnings=list(self.warnings))

    def document(self, path: str, gate_failed: bool) -> FitDocument:
        """The document of `rdpi fit --json`; `path` is that of the model file."""
        known = self.record()
        return FitDocument(runs=known.runs, noise_um=known.noise_um, warnings=known.warnings, model=path,
                           gate_failed=gate_failed, rate_slopes=self.rate_slopes.bands())


@dataclass
class _Run:
    """A recording prepared for the regression."""

    recording: Recording
    x_um: np.ndarray
    rate_um_per_s: np.ndarray
    states_um: np.ndarray
    first: int  # samples before this depend on unknown memory


class _Plant(NamedTuple):
    """A candidate: slopes at rest and at the highest rate, inverse saturation, and how well it fits."""

    rest: np.ndarray  # A_i
    fast: np.ndarray  # B_i
    picks: tuple[int, ...]  # dead zones, as indices into the grid
    pieces: np.ndarray  # U_0 ... U_m
    cost: float
    residual: float  # rms, as a share of the stroke


def fit(runs: Sequence[Recording], options: Options = Options(), hold_out: Sequence[Recording] = (),
        progress: Callable[[float], None] = lambda fraction: None) -> Fit:
    """Identify a model from `runs`, score it on them and on `hold_out`. BadInput is raised if they cannot be fitted."""
    runs = taken(runs, RUN_COLUMNS, "runs", 1)
    hold_out = taken(hold_out, RUN_COLUMNS, "hold_out")
    _check_options(options)
    for run in (*runs, *hold_out):
        check_run(run)
    check_together(runs, hold_out)
    warnings: list[str] = []
    noises = [signals.noise_um(run.displacement_um) for run in (*runs, *hold_out)]
    noise = float(np.median(noises[:len(runs)]))
    smoothing_s = _smoothing(runs)

    low_V = min(float(np.min(run.command_V)) for run in runs)
    high_V = max(float(np.max(run.command_V)) for run in runs)
    low_um = min(float(np.min(run.displacement_um)) for run in runs)
    high_um = max(float(np.max(run.displacement_um)) for run in runs)
    stroke = max(float(np.ptp(run.displacement_um)) for run in runs)
    sign = 1.0 if correlation(max(runs, key=lambda run: np.ptp(run.command_V))) > 0 else -1.0
    gain = sign * stroke / max(float(np.ptp(run.command_V)) for run in runs)
    offset_V = low_V if gain > 0 else high_V  # x >= 0, as one-sided dead zones need it
    thresholds = _thresholds(options, abs(gain) * max(float(np.ptp(run.command_V)) for run in runs), warnings)

    prepared = _prepare(runs, gain, offset_V, thresholds, options.rate_source, options.rate_window_s,
                        options.rate_filter_s, smoothing_s)
    usable = np.concatenate([run.rate_um_per_s[run.first:] for run in prepared])
    top = float(np.percentile(usable, 99.9))
    if top <= 0:
        raise BadInput(f"{runs[0].path}: the displacement never moves after warm-up; "
                       "record a drive that moves the actuator")
    grid = low_um + GRID * (high_um - low_um)
    columns = _Columns(thresholds, grid, 0.0 if options.rate_independent else top)
    reduced = _reduce(prepared, columns, stroke, lambda share: progress(0.6 * share))
    factor, samples = _joined(reduced)
    unknowns = columns.plays + options.deadzones + len(runs)
    if samples < tuned.MIN_SAMPLES_PER_UNKNOWN * unknowns:
        raise BadInput(f"{runs[0].path}: {samples} samples after warm-up for {unknowns} unknowns; "
                       "record longer, state the memory, or use fewer --operators")
    plant = _search(factor, columns, options.deadzones, samples)

    if not options.rate_independent:
        _compare_sources(runs, prepared, columns, options, plant, stroke, smoothing_s, warnings)

    first = prepared[0]
    model = _of_plant(Model(
        gain_um_per_V=gain, offset_V=offset_V, offset_um=0.0, stroke_um=stroke, thresholds_um=thresholds,
        slopes=plant.rest, slope_rate_s_per_um=np.zeros(len(thresholds)), deadzones_um=np.zeros(1),
        deadzone_weights=np.ones(1),
        rate=Rate(options.rate_source, options.rate_window_s, options.rate_filter_s,
                  min_slope_ratio=options.min_slope_ratio, smoothing_s=min(smoothing_s), identified_um_per_s=top),
        drive=Drive(low_V if options.min_V is None else options.min_V,
                    high_V if options.max_V is None else options.max_V, options.slew_V_per_s, options.dac_bits),
        memory=Memory(float(first.x_um[0]), first.states_um),
        actuator=options.actuator if options.actuator is not None else runs[0].metadata.get("actuator", ""),
    ), plant, columns, prepared, reduced)
    if first.recording.memory == "unknown":
        states = chain.estimate_states(model, first.recording)
        model.memory = Memory(float(states[0]), states)
    model.memory = chain.within_drive(model)
    if options.dac_bits is not None and None in (options.min_V, options.max_V):
        warnings.append(f"the codes of the DAC are taken to span {model.drive.min_V:g} to {model.drive.max_V:g} V, the "
                        "range recorded: give --min-V and --max-V, the drives of its first and of its last code")
    _check_reset(model, runs, warnings)
    progress(0.7)
    predictions = chain.simulate(model, [*runs, *hold_out])
    scores = _scores(runs, hold_out, predictions, warnings)
    _remark(plant, scores, warnings)
    left_out = _leave_out(model, prepared, predictions, reduced, columns, options.deadzones)
    model.passport = _passport(runs, hold_out, predictions, left_out, noises).to_json()
    bands = _rate_slopes(model, prepared)
    progress(1.0)
    without = plant
    if not options.rate_independent:
        without = _search(*_without_rate(factor, columns), options.deadzones, samples)
    found = Fit(model, (plant.residual, without.residual), scores, bands, noise, warnings)
    model.fit = found.record().to_json()
    return found


def _compare_sources(runs: Sequence[Recording], prepared: Sequence[_Run], columns: _Columns, options: Options,
                     plant: _Plant, stroke: float, smoothing_s: Sequence[float], warnings: list[str]) -> None:
    """Say so if the other source of the rate explains the recordings much better."""
    other = next(source for source in SOURCES if source != options.rate_source)
    rates = [_rate(run, used.x_um, other, options.rate_window_s, options.rate_filter_s, smoothing)
             for run, used, smoothing in zip(runs, prepared, smoothing_s)]
    swapped = [replace(run, rate_um_per_s=rate) for run, rate in zip(prepared, rates)]
    factor, samples = _joined(_reduce(swapped, columns, stroke, every=THIN))
    residual = plant.residual
    for _ in range(3):  # the prior follows the residual
        residual = _solve(factor, columns, plant.picks, samples, residual).residual
    if residual < tuned.OTHER_SOURCE * plant.residual:
        warnings.append(f"the rate of the {other} explains these recordings better ({100 * residual:.2g} % rms of the "
                        f"stroke against {100 * plant.residual:.2g} %): try --rate-source {other}")


def _check_reset(model: Model, runs: Sequence[Recording], warnings: list[str]) -> None:
    """A run marked reset whose start looks like another state was not swept from both sides of where it starts."""
    for run in runs:
        if run.memory == "reset":
            _, at_rest, best = chain.start_states(model, run)
            if best < tuned.RESET_DOUBT * at_rest and at_rest - best > 0.003 * model.stroke_um:
                warnings.append(f"{run.path}: marked memory: reset, but its beginning is explained better by another "
                                f"state ({best:.2g} um rms against {at_rest:.2g}); did the sweep decay from both "
                                "sides? Else mark it unknown")


def _check_options(options: Options) -> None:
    arguments.of_kind(options, Options, "options")
    for item in fields(Options):
        value = getattr(options, item.name)
        if item.type.startswith(("int", "float")) and not (value is None and item.type.endswith("None")):
            whole = item.type.startswith("int")
            if arguments.number(value, item.name, finite=whole) != value // 1 and whole:
                raise BadInput(f"{item.name} is {value}; must be a whole number")
    arguments.of_kind(options.rate_independent, bool, "rate_independent")
    arguments.one_of(options.rate_source, SOURCES, "rate_source")
    if options.thresholds_um is not None:
        arguments.series(options.thresholds_um, "thresholds_um", finite=False)
    if options.actuator is not None:
        arguments.of_kind(options.actuator, str, "actuator")
    if not 0 <= options.operators <= 128:
        raise BadInput(f"--operators {options.operators}: must be 0 to 128")
    if not 0 <= options.deadzones <= 6:
        raise BadInput(f"--deadzones {options.deadzones}: must be 0 to 6; more cannot be told apart")
    if not 0 < options.min_slope_ratio < 1:
        raise BadInput(f"--min-slope-ratio {options.min_slope_ratio:g}: must lie between 0 and 1")
    for option, value in (("--rate-window", options.rate_window_s), ("--rate-filter", options.rate_filter_s)):
        if not 0 <= value <= MAX_RATE_TIME_S:
            raise BadInput(f"{option} {value:g}: must be 0 to {MAX_RATE_TIME_S:g} s")
    for option, value in (("--min-V", options.min_V), ("--max-V", options.max_V)):
        if value is not None and not abs(value) <= LARGEST_INPUT:
            raise BadInput(f"{option} {value:g}: must be a voltage")
    if options.slew_V_per_s is not None and not 0 < options.slew_V_per_s <= LARGEST:
        raise BadInput(f"--slew {options.slew_V_per_s:g}: must be positive, in V/s")
    if options.dac_bits is not None and not 1 <= options.dac_bits <= MAX_DAC_BITS:
        raise BadInput(f"--dac-bits {options.dac_bits}: must be 1 to {MAX_DAC_BITS}")


def _thresholds(options: Options, excursion_um: float, warnings: list[str]) -> np.ndarray:
    """r_0 = 0 ... r_n. A play with a threshold beyond half the largest excursion never moves: not to be identified."""
    reach = excursion_um / 2
    if options.thresholds_um is None:
        # n + 1 equal intervals up to the reach, so that the last slope is seen over as long a way as the others
        return np.arange(options.operators + 1) * reach / (options.operators + 1)
    wanted = np.array([0.0, *options.thresholds_um])
    if not np.all(np.diff(wanted) > 0) or not np.isfinite(wanted[-1]):  # refuses NaN too
        raise BadInput("--thresholds: must be positive, finite and increase")
    if len(wanted) > MAX_PLAYS:
        raise BadInput(f"--thresholds: {len(wanted) - 1} of them; at most {MAX_PLAYS - 1}")
    hidden = wanted[wanted > 0.98 * reach]
    if len(hidden):
        warnings.append(f"thresholds {', '.join(f'{r:g}' for r in hidden)} um not fitted: unobservable, "
                        f"beyond half the largest excursion in the recordings ({reach:.4g} um)")
    return wanted[wanted <= 0.98 * reach]


def _smoothing(runs: Sequence[Recording]) -> list[float]:
    return [signals.smoothing_time_s(run.displacement_um, run.sample_time_s) for run in runs]


def _prepare(runs: Sequence[Recording], gain: float, offset_V: float, thresholds: np.ndarray, source: str,
             window_s: float, filter_s: float, smoothing_s: Sequence[float]) -> list[_Run]:
    prepared: list[_Run] = []
    end: np.ndarray | None = None
    for run, smoothing in zip(runs, smoothing_s):
        x = gain * (run.command_V - offset_V)
        rate = _rate(run, x, source, window_s, filter_s, smoothing)
        known = run.memory == "reset" or (run.memory == "carried" and end is not None)
        carried = run.memory == "carried" and end is not None
        states = np.array(end) if carried else chain.states_after(x[0], x[0], thresholds)
        first = 0 if known else chain.warm_up(x, thresholds[-1])
        if first and reversals(x, 0.1, first) == 0:
            raise BadInput(f"{run.path}: its memory is unknown, and the drive does not turn round any more once it has "
                           "erased it; state the memory (reset, carried) or record longer")
        prepared.append(_Run(run, x, rate, states, first))
        end = firmware.plays(x, thresholds, states)[1]
    return prepared


def _rate(run: Recording, x_um: np.ndarray, source: str, window_s: float, filter_s: float,
          smoothing_s: float) -> np.ndarray:
    """The rate that modulates the slopes; the command is free of noise and is not smoothed."""
    if source == "control":
        return signals.rate(x_um, run.sample_time_s, window_s, filter_s, 0.0)
    return signals.rate(run.displacement_um, run.sample_time_s, window_s, filter_s, smoothing_s)


class _Columns(NamedTuple):
    """Layout of the regression's columns: plays (twice with a rate law), candidate dead zones, displacement."""

    thresholds_um: np.ndarray
    grid_um: np.ndarray
    top_um_per_s: float  # 0: rate-independent

    @property
    def plays(self) -> int:
        return len(self.thresholds_um) * (2 if self.top_um_per_s else 1)

    def blocks(self, run: _Run, every: int = 1) -> Iterator[np.ndarray]:
        """Blocks of at most CHUNK rows, one row for `every` samples, warm-up left out; first column 1."""
        states = run.states_um
        z = run.recording.displacement_um
        for start in range(0, len(z), CHUNK):
            part = slice(start, start + CHUNK)
            outputs, states = firmware.plays(run.x_um[part], self.thresholds_um, states)
            outputs[:, :-1] -= outputs[:, 1:]
            if self.top_um_per_s:
                share = (run.rate_um_per_s[part] / self.top_um_per_s)[:, None]
                outputs = np.hstack([outputs * (1 - share), outputs * share])
            zone = np.maximum(z[part, None] - self.grid_um, 0)
            block = np.hstack([np.ones((len(outputs), 1)), outputs, zone, z[part, None]])
            block = block[max(0, run.first - start)::every]
            if len(block):
                yield block


class _Reduced(NamedTuple):
    """What the regression needs of one run; displacements in units of the stroke."""

    factor: np.ndarray  # triangular, of all columns with the run's mean removed: each run has its own offset
    means: np.ndarray  # of the columns
    samples: int


def _reduce(runs: Sequence[_Run], columns: _Columns, stroke: float,
            progress: Callable[[float], None] = lambda fraction: None, every: int = 1) -> list[_Reduced]:
    reduced: list[_Reduced] = []
    everything, done = sum(len(run.x_um) for run in runs), 0
    for run in runs:
        factor, samples = np.zeros((0, columns.plays + len(columns.grid_um) + 2)), 0
        for block in columns.blocks(run, every):
            block[:, 1:] /= stroke
            factor = np.linalg.qr(np.vstack([factor, block]), mode="r")
            samples += len(block)
            progress(min(1.0, (done + samples) * every / everything))
        done += samples
        means = factor[0, 1:] / factor[0, 0]  # of a factor with a leading column of ones
        reduced.append(_Reduced(factor[1:, 1:], means, samples))
    return reduced


def _joined(reduced: Sequence[_Reduced]) -> tuple[np.ndarray, int]:
    """Triangular factor of several runs together, and their samples."""
    factor = reduced[0].factor[:0]
    for run in reduced:
        factor = np.linalg.qr(np.vstack([factor, run.factor]), mode="r")
    return factor, sum(run.samples for run in reduced)


def _assemble(rows: np.ndarray, columns: _Columns, picks: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Design matrix [plays, -seg_1 ... -seg_m] and target seg_0, for dead zones at grid[picks]."""
    zones = rows[:, [columns.plays + j for j in picks]]
    parts = np.hstack([rows[:, -1:], zones])
    parts[:, :-1] -= zones
    return np.hstack([rows[:, :columns.plays], -parts[:, 1:]]), parts[:, 0]


@lru_cache(maxsize=16)
def _prior(n: int, plays: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and targets that keep the loading curve smooth, the rate law smooth and small, the saturation straight.

    For n slopes in as many columns, `plays`, or with a rate law twice as many, and m dead zones.
    """
    bend, none = np.diff(np.eye(n), 2, axis=0), np.zeros
    rows = [tuned.PRIOR_BEND * np.hstack([bend, none((len(bend), plays + m - n))])]
    if plays > n:
        rows.append(tuned.PRIOR_RATE_BEND * np.hstack([-bend, bend, none((len(bend), m))]))
        rows.append(tuned.PRIOR_RATE * np.hstack([-np.eye(n), np.eye(n), none((n, m))]))
    straight = tuned.PRIOR_SATURATION * np.hstack([none((m, plays)), np.eye(m)])
    rows.append(straight)
    return np.vstack(rows), np.r_[none(sum(map(len, rows)) - m), straight.sum(axis=1)]


def _solve(factor: np.ndarray, columns: _Columns, picks: tuple[int, ...], samples: int, residual: float) -> _Plant:
    """Slopes and pieces for given dead zones; `residual` is the relative error that the prior is weighed against."""
    from scipy.optimize import lsq_linear

    n, m = len(columns.thresholds_um), len(picks)
    design, target = _assemble(factor, columns, picks)
    prior, wish = (residual * np.sqrt(samples) * part for part in _prior(n, columns.plays, m))
    low = np.r_[np.full(columns.plays, tuned.SLOPE_FLOOR), np.full(m, tuned.PIECE_RANGE[0])]
    high = np.r_[np.full(columns.plays, np.inf), np.full(m, tuned.PIECE_RANGE[1])]
    both = np.vstack([design, prior]), np.r_[target, wish]
    found = np.linalg.lstsq(*both, rcond=None)[0]
    if np.any(found < low) or np.any(found > high):
        found = lsq_linear(*both, (low, high), method="bvls").x
    left = np.sum((design @ found - target) ** 2)
    cost = np.sum((both[0] @ found - both[1]) ** 2)
    rest = found[:n]
    fast = found[n:2 * n] if columns.top_um_per_s else rest
    return _Plant(rest, fast, picks, np.r_[1.0, found[columns.plays:]], float(cost), float(np.sqrt(left / samples)))


def _search(factor: np.ndarray, columns: _Columns, m: int, samples: int) -> _Plant:
    """Outer search over the dead zones, one at a time until none moves; the prior follows the residual."""
    spread = np.linspace(0, len(columns.grid_um) - 1, m + 2)[1:-1]
    plant = _solve(factor, columns, tuple(int(round(j)) for j in spread), samples, 1e-3)
    for _ in range(4):
        residual = plant.residual
        plant = _solve(factor, columns, plant.picks, samples, residual)
        before = plant.picks
        for j in range(m):
            lowest = plant.picks[j - 1] + tuned.GRID_GAP if j else 0
            highest = plant.picks[j + 1] - tuned.GRID_GAP if j + 1 < m else len(columns.grid_um) - 1
            for place in range(lowest, highest + 1):
                picks = (*plant.picks[:j], place, *plant.picks[j + 1:])
                plant = min(plant, _solve(factor, columns, picks, samples, residual), key=lambda p: p.cost)
        if plant.picks == before:
            break
    return plant


def _without_rate(factor: np.ndarray, columns: _Columns) -> tuple[np.ndarray, _Columns]:
    """The same regression with slopes that do not depend on rate: both columns of a play added."""
    n = len(columns.thresholds_um)
    return np.hstack([factor[:, :n] + factor[:, n:2 * n], factor[:, 2 * n:]]), columns._replace(top_um_per_s=0.0)


def _offset(means: np.ndarray, columns: _Columns, plant: _Plant) -> float:
    """Offset of one run, in units of the stroke: what its means leave."""
    design, target = _assemble(means[None, :], columns, plant.picks)
    slopes = np.r_[plant.rest, plant.fast] if columns.top_um_per_s else plant.rest
    return float((target - design @ np.r_[slopes, plant.pieces[1:]])[0])


def _saturation(corners_um: np.ndarray, pieces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d_j and ws_j of S from the corners of its inverse (in um of z, increasing) and the slopes U_j of that."""
    corners = np.r_[0.0, corners_um]
    if np.any(np.diff(corners) <= 0):
        raise BadInput("the saturation stage does not fit these recordings (a dead zone lies at or below zero); "
                       "use fewer --deadzones")
    deadzones = np.r_[0.0, np.cumsum(np.diff(corners) * pieces[:-1])]
    return deadzones, np.diff(1 / pieces, prepend=0.0)


def _of_plant(model: Model, plant: _Plant, columns: _Columns, runs: Sequence[_Run],
              reduced: Sequence[_Reduced]) -> Model:
    """The model with slopes, saturation, guard and offset of a plant fitted to these runs.

    Raises BadInput for a saturation that has no meaning.
    """
    offsets = np.array([_offset(run.means, columns, plant) for run in reduced]) * model.stroke_um
    # The offset of a run whose unknown memory is never erased holds what its plays remember: only if there is no other.
    erased = [run.first == 0 or np.ptp(run.x_um) >= 2 * model.thresholds_um[-1] for run in runs]
    weights = [(len(run.x_um) - run.first) * (sure or not any(erased)) for run, sure in zip(runs, erased)]
    offset_um = float(np.average(offsets, weights=weights))
    deadzones, deadzone_weights = _saturation(columns.grid_um[list(plant.picks)] - offset_um, plant.pieces)
    top = model.rate.identified_um_per_s
    change = (plant.fast - plant.rest) / top
    found = replace(model, offset_um=offset_um, slopes=plant.rest, slope_rate_s_per_um=change, deadzones_um=deadzones,
                    deadzone_weights=deadzone_weights)
    return guarded(found, 1 - model.rate.min_slope_ratio, tuned.RATE_HEADROOM * top)


def _leave_out(model: Model, runs: Sequence[_Run], predictions: Sequence[chain.Prediction],
               reduced: Sequence[_Reduced], columns: _Columns, m: int) -> list[np.ndarray | None]:
    """Each run as predicted by a model fitted to the others, (samples,); None where the others do not make a model.

    Rate and memory are those of the model's own prediction: they hardly differ, and finding them anew takes long.
    """
    found: list[np.ndarray | None] = [None] * len(runs)
    for group in np.array_split(np.arange(len(runs)), min(len(runs), FOLDS)):
        rest = [k for k in range(len(runs)) if k not in group]
        if sum(reduced[k].samples for k in rest) < tuned.MIN_SAMPLES_PER_UNKNOWN * (columns.plays + m + len(rest)):
            continue
        left = [reduced[k] for k in rest]
        try:
            factor, samples = _joined(left)
            plant = _search(factor, columns, m, samples)
            other = _of_plant(model, plant, columns, [runs[k] for k in rest], left)
            for k in group:
                run, seen = runs[k].recording, predictions[k]
                found[k] = chain.operator_from(other, run, seen.start_um).forward(run.command_V, seen.rate_um_per_s)
        except BadInput:  # what the others determine is no model: the run is then known as fitted only
            pass
    return found


def _passport(runs: Sequence[Recording], hold_out: Sequence[Recording], predictions: Sequence[chain.Prediction],
              left_out: Sequence[np.ndarray | None], noises: Sequence[float]) -> Passport:
    residuals = []
    for k, (run, prediction) in enumerate(zip([*runs, *hold_out], predictions)):
        left = run.displacement_um - prediction.predicted_um
        coords = localise.coordinates(run, prediction.predicted_um, prediction.rate_um_per_s)
        if k >= len(runs):
            residuals.append(passport.Residual(run, passport.OTHER_RUNS, left, None, coords, noises[k]))
        elif left_out[k] is None:
            residuals.append(passport.Residual(run, passport.FITTED, None, left, coords, noises[k]))
        else:
            without = run.displacement_um - left_out[k]
            residuals.append(passport.Residual(run, passport.LEFT_OUT, without, left, coords, noises[k]))
    return passport.build(residuals)


def _scores(runs: Sequence[Recording], hold_out: Sequence[Recording], predictions: Sequence[chain.Prediction],
            warnings: list[str]) -> list[RunScore]:
    scores = []
    for k, (run, prediction) in enumerate(zip([*runs, *hold_out], predictions)):
        if not prediction.settled:
            warnings.append(f"{run.path}: the prediction's own rate did not settle; treat its score with care, "
                            "or fit with a longer --rate-window")
        score = chain.score(prediction.predicted_um, run.displacement_um, where=run.path)
        scores.append(RunScore(run, k >= len(runs), score, prediction.memory))
    return scores


def rate_slopes(model: Model, runs: Sequence[Recording]) -> RateSlopes:
    """The slopes that each band of rate has when fitted alone, thresholds and saturation those of `model`."""
    prepared = _prepare(runs, model.gain_um_per_V, model.offset_V, model.thresholds_um, model.rate.source,
                        model.rate.window_s, model.rate.filter_s, _smoothing(runs))
    return _rate_slopes(model, prepared)


def _rate_slopes(model: Model, runs: Sequence[_Run]) -> RateSlopes:
    from scipy.optimize import lsq_linear

    columns = _Columns(model.thresholds_um, np.zeros(0), 0.0)
    n = len(model.thresholds_um)
    edges = np.linspace(0, np.percentile(np.concatenate([run.rate_um_per_s for run in runs]), 99.9), RATE_BINS + 1)
    factors = [np.zeros((0, n + 2))] * RATE_BINS
    samples, totals = np.zeros(RATE_BINS, int), np.zeros(RATE_BINS)
    for run in runs:
        start = run.first
        for block in columns.blocks(run):
            rate = run.rate_um_per_s[start:start + len(block)]
            start += len(block)
            block[:, -1] = operators.saturation_inverse(block[:, -1] - model.offset_um, model.deadzones_um,
                                                        model.deadzone_weights)
            bands = np.digitize(rate, edges[1:-1])
            for band in range(RATE_BINS):
                inside = bands == band
                factors[band] = np.linalg.qr(np.vstack([factors[band], block[inside]]), mode="r")
                samples[band] += np.count_nonzero(inside)
                totals[band] += np.sum(rate[inside])
    seen = samples >= 8 * n
    slopes = np.full((RATE_BINS, n), np.nan)
    for band in np.flatnonzero(seen):
        factor = factors[band] / np.sqrt(samples[band])
        factor[:, 1:] /= model.stroke_um
        residual = 1e-3
        for _ in range(3):  # the prior follows the residual, as in the fit itself
            bend = residual * np.pad(_prior(n, n, 0)[0], ((0, 0), (1, 0)))
            bound = np.eye(1, n + 1) * tuned.BAND_OFFSET  # runs drift, but hardly from one rate to the next
            design = np.vstack([factor[:, :-1], bend, bound])
            target = np.r_[factor[:, -1], np.zeros(len(bend) + 1)]
            lowest = np.r_[-np.inf, np.full(n, tuned.SLOPE_FLOOR)]
            found = lsq_linear(design, target, (lowest, np.inf), method="bvls").x
            residual = float(np.linalg.norm(factor[:, :-1] @ found - factor[:, -1]))
        reached = np.linalg.norm(factor[:, 1:-1], axis=0) > 0.1 / n  # an interval the band hardly enters says nothing
        slopes[band, reached] = found[1:][reached]
    return RateSlopes(totals[seen] / samples[seen], slopes[seen], samples[seen])


def _remark(plant: _Plant, scores: Sequence[RunScore], warnings: list[str]) -> None:
    slopes = np.r_[plant.rest, plant.fast]
    if np.any(slopes <= tuned.SLOPE_FLOOR * 1.0001):
        warnings.append(f"a slope lies on its floor of {tuned.SLOPE_FLOOR:g}: the recordings do not determine it; "
                        "use fewer --operators or record more amplitudes and rates")
    actuators = sorted({run.recording.metadata["actuator"] for run in scores if "actuator" in run.recording.metadata})
    if len(actuators) > 1:
        warnings.append(f"the recordings name different actuators: {', '.join(actuators)}")
    for run in scores:
        path, stays = run.recording.path, stays_at_an_end(run.recording)
        if run.memory == "estimated":
            warnings.append(f"{path}: memory at the start unknown; estimated"
                            + ("" if run.held_out else ", and left out of the fit until the drive had erased it"))
        if stays:
            warnings.append(f"{path}: {stays} samples stand at the very highest or lowest reading "
                            "while the command moves: is the sensor clipped?")
        if run.score.rms_percent > tuned.POOR_PERCENT:
            warnings.append(f"{path}: explained only to {run.score.rms_percent:.2g} % rms of its stroke: "
                            "is it the same actuator, in the same units, without drift, delay or ringing? "
                            "The model may not be fit for use")
