"""Identification: recordings to a model.

The operator is one bounded linear least-squares problem over all samples of all runs (regression.py). What stands
around it is chosen first (around.py); the operator is then fitted to the recordings as it alone would have made them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np

from ..data import RUN_COLUMNS, Recording, arguments, taken
from ..errors import BadInput
from ..model import (LARGEST, MAX_DAC_BITS, MAX_PLAYS, MIN_SLOPE_RATIO, SOURCES, Drive, Memory, Model, Rate, Passport,
                     guarded, operators, records)
from ..simulate import Plant, chain, doubted, effects, signals, started
from . import around, localise, passport, stick_slip
from . import thresholds as tuned
from .amplifier import Amplifier, seen_by_monitor
from .checks import (LARGEST_INPUT, check_drive, check_monitor, check_readings, check_run, check_together, correlation,
                     late_correlations, read_differently, same_samples, slow_sensors, stays_at_an_end)
from .bands import RateSlopes, slopes_of_bands
from .choice import Choice
from .document import FitDocument
from .regression import (Columns, Reduced, Run, Solution, joined, offset_of, parts_of, prepare, reduce, rerated,
                         saturation_of, search, smoothing_times_s, solve, top_rate, without_rate)
from .strokes import Strokes, covered
from .sweep_start import SweepStart, sweep_start

GRID = np.linspace(0.12, 0.88, 20)  # candidate dead zones, as shares of the displacement's range
MAX_RATE_TIME_S = 1e3
FOLDS = 8  # at most so many groups of runs are left out in turn for the passport
BLOCKS = 8  # of a recording, in which models are compared
ROUNDS = 3  # in which operator and unknown starts are estimated in turn
THIN = 8  # of the samples, every how many are used to compare rate sources


@dataclass(frozen=True)
class Options:
    """What the user chooses; None leaves the choice to the data."""

    operators: int = 9  # n: plays with a positive threshold
    deadzones: int = 2  # m
    thresholds_um: tuple[float, ...] | None = None  # r_1 ... r_n instead of equal intervals
    rate_independent: bool = False
    effects: str | tuple[str, ...] = "auto"  # around the operator: "auto", "none", or names of those to identify
    rate_source: str = "displacement"
    rate_window_s: float = 0.0
    rate_filter_s: float | None = None
    min_slope_ratio: float = MIN_SLOPE_RATIO
    min_V: float | None = None
    max_V: float | None = None
    slew_V_per_s: float | None = None
    dac_bits: int | None = None
    actuator: str | None = None


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
    sweep: SweepStart
    warnings: list[str] = field(default_factory=list)
    choice: Choice | None = None  # what stands around the operator; None: it was not asked
    plain: Model | None = None  # the operator alone, fitted as if nothing stood around it
    variants: list[records.Variant] = field(default_factory=list)  # that were compared, the model first

    def record(self) -> records.FitRecord:
        """The key `fit` of the model file."""
        return records.FitRecord(
            runs=[records.FittedRun(file=run.recording.path, digest=run.recording.digest, samples=len(run.recording),
                                    held_out=run.held_out, memory=run.memory, read_at=run.recording.metadata.get("read_at"),
                                    **run.score._asdict())
                  for run in self.scores],
            noise_um=self.noise_um, warnings=list(self.warnings), variants=list(self.variants))

    def document(self, path: str, gate_failed: bool) -> FitDocument:
        """The document of `rdpi fit --json`; `path` is that of the model file."""
        known = self.record()
        return FitDocument(runs=known.runs, noise_um=known.noise_um, warnings=known.warnings, variants=known.variants,
                           model=path,
                           gate_failed=gate_failed, rate_slopes=self.rate_slopes.bands(),
                           effects=around.sections(self.choice), sweep=self.sweep.record())


def fit(runs: Sequence[Recording], options: Options = Options(), hold_out: Sequence[Recording] = (),
        progress: Callable[[float], None] = lambda fraction: None) -> Fit:
    """Identify a model from `runs`, score it on them and on `hold_out`. BadInput is raised if they cannot be fitted."""
    runs = taken(runs, RUN_COLUMNS, "runs", 1)
    hold_out = taken(hold_out, RUN_COLUMNS, "hold_out")
    options = checked_options(options)
    for run in (*runs, *hold_out):
        check_run(run)
        check_readings(run)
        if "monitor_V" in run.columns:
            check_monitor(run, float(np.ptp(run.command_V)))
    check_together(runs, hold_out)
    check_drive(runs, options.min_V, options.max_V)
    warnings = [remark for told in (same_samples, read_differently, slow_sensors) for remark in told([*runs, *hold_out])]
    noises = [signals.noise_um(run.displacement_um) for run in (*runs, *hold_out)]
    frame = Frame.of(runs, options, warnings)

    rounds = 2 if options.effects != around.NONE and any(run.memory == "unknown" for run in runs) else 1
    remarks: list[str] = []
    begun = runs
    whole = _identified(begun, frame, options, remarks, lambda share: progress(0.6 * share / rounds))
    for k in range(1, rounds):  # what was before a recording is estimated anew beside what stands around the operator
        begun, remarks = started(whole.model, runs), []
        whole = _identified(begun, frame, options, remarks, lambda share: progress(0.6 * (k + share) / rounds))
    warnings += remarks
    tried = _compared(whole, begun, [*runs, *hold_out], frame, options)
    if around.wanted(options.effects) is None:
        tried = _best_first(tried)
    (plain, found, chosen, model), predictions, left_out, _ = tried[0]
    seen = [run.recording for run in found.runs]
    if found.columns.top_um_per_s:
        _compare_sources(seen, found, options, warnings)
    if options.dac_bits is not None and None in (options.min_V, options.max_V):
        warnings.append(f"the DAC's codes are assumed to span {model.drive.min_V:g} to {model.drive.max_V:g} V, the "
                        "recorded range; give --min-V and --max-V, the drives of the first and of the last code")
    if (beyond := _beyond(model, frame.range_V)) is not None:
        warnings.append(beyond)
    several_rates = Strokes.of(runs).rates_differ
    if chosen is not None and not several_rates and (late := _late(chosen, model)):
        warnings.append(f"all strokes of these recordings have about the same rate, at which delay, lag, relaxation and "
                        f"rate law look alike: {late} may be another of them, and holds at that rate only; record several "
                        "rates, as `rdpi excite commission` does")
    _check_reset(found.model, found.runs, warnings)
    _check_loops(runs, warnings)
    if several_rates and not (chosen is not None and chosen.found.hypothesis.comes_late):
        _check_order(found.model, warnings)
    progress(0.7)
    scores = _scores(runs, hold_out, predictions, warnings)
    _remark(found.solution, scores, model.stroke_um, warnings)
    if len(found.solution.picks) < options.deadzones:
        warnings.append(f"only {len(found.solution.picks)} of {options.deadzones} dead zones are fitted, because more "
                        "would lie at or below zero; check for ringing and delay, and that the range is covered")
    drift_um = _half_loop_um(model) if found.sweep.drifts else 0.0
    model.passport = _passport(runs, hold_out, predictions, left_out, noises, drift_um, warnings).to_json()
    bands = slopes_of_bands(found.model, found.runs)
    progress(1.0)
    result = Fit(model, (found.solution.residual, found.without.residual), scores, bands,
                 float(np.median(noises[:len(runs)])), found.sweep, warnings, chosen, plain.model,
                 [one.variant(frame.stroke_um) for one in tried])
    model.fit = result.record().to_json()
    return result


class _Whole(NamedTuple):
    """What was identified from recordings whose starts were stated, guessed or estimated."""

    plain: Operator  # as if nothing stood around it
    found: Operator
    chosen: Choice | None
    model: Model


def _identified(runs: Sequence[Recording], frame: Frame, options: Options, warnings: list[str],
                progress: Callable[[float], None]) -> _Whole:
    plain = _operator(runs, frame, options, not options.rate_independent, lambda share: progress(0.4 * share))
    if options.effects != around.NONE:
        amplifier, behind, driven = _behind_amplifier(plain, runs, frame, options, warnings)
        inner = frame.of_others(around.without_ringing(behind, driven, options), options)
        if inner.stroke_um < tuned.RINGS_FAR * frame.stroke_um:
            behind = _operator(driven, inner, options, not options.rate_independent)
        chosen = around.identify(behind, driven, options, lambda share: progress(0.4 + 0.5 * share), amplifier)
        if amplifier is not None:
            chosen = around.behind(chosen, amplifier, runs)
            free = around.by_command(chosen, runs, around.wanted(options.effects))
            if chosen.found.rms_um > tuned.MONITOR_WORSE * free.rms_um:
                warnings.append(f"monitor_V is not used: driven by it, the model misses {chosen.found.rms_um:.3g} um rms of "
                                f"what was not fitted, instead of {free.rms_um:.3g} driven by the command; check that the "
                                "column holds what drives the actuator, sampled at the same time, without glitches and hum")
                chosen = around.identify(plain, runs, options, lambda share: progress(0.9 + 0.1 * share))
        if chosen.kept and chosen.found.rms_um > chosen.plain.rms_um:
            warnings.append(f"with {', '.join(one.acting.effect.name for one in chosen.kept)} the model misses more of "
                            "what was not fitted than the operator alone; leave out what is not there, or use "
                            "--effects auto")
        if (more := chosen.may_be_there):
            all_of_them = [*(one.effect.name for one in chosen.found.hypothesis.acting), *more]
            warnings.append(f"{' and '.join(more)} may stand around the operator as well: parts of "
                            f"these recordings, each predicted from the others, would be missed by "
                            f"{chosen.percent(chosen.perhaps.rms_um):.2g} % of the stroke instead of "
                            f"{chosen.percent(chosen.found.rms_um):.2g} %, but too few parts show it; record more, or take "
                            f"them with --effects {','.join(all_of_them)}")
        return _around(plain, chosen, frame, options)
    return _Whole(plain, plain, None, plain.model)


def _around(plain: Operator, chosen: Choice, frame: Frame, options: Options, sweep: SweepStart | None = None) -> _Whole:
    """The operator fitted to what it alone made of the recordings, and what was chosen around it."""
    found, chain_of_rig = plain, around.entries(chosen)
    filter_s = chosen.found.state.setting.rate_filter_s
    if chain_of_rig or filter_s != plain.model.rate.filter_s:
        rated = chosen.found.hypothesis.rated and not options.rate_independent
        seen = chosen.found.state.seen()
        found = _operator(seen, frame.of_others(seen, options), replace(options, rate_filter_s=filter_s), rated, sweep=sweep)
    model = replace(found.model, effects=chain_of_rig, operator_alone=plain.model.alone() if chain_of_rig else None)
    return _Whole(plain, found, chosen, model)


class _Tried(NamedTuple):
    """A model, and what it misses of whole recordings."""

    whole: _Whole
    predictions: list[chain.Prediction]
    left_out: list[np.ndarray | None]  # of each run, (samples,); see _leave_out
    squares: np.ndarray  # of that in each block, mean, each run's offset apart, um², (blocks,)

    @property
    def missed_um(self) -> float:
        """rms; every recording counts alike."""
        return float(np.sqrt(np.mean(self.squares)))

    def beats(self, other: _Tried) -> bool:
        """Whether it misses less, by more than the standard error of the gains over what is missed."""
        gain = (other.squares - self.squares) / np.maximum(other.squares + self.squares, np.finfo(float).tiny)
        return self.missed_um < other.missed_um and bool(
            np.mean(gain) > np.std(gain, ddof=1) / np.sqrt(len(gain)))

    def variant(self, stroke_um: float) -> records.Variant:
        """For the model file and the document."""
        model, acting = self.whole.model, effects.acting(self.whole.model)
        rated = bool(np.any(model.slope_rate_s_per_um))
        parameters = len(model.slopes) * (1 + rated) + len(model.deadzones_um) + sum(len(one.effect.fitted) for one in acting)
        return records.Variant(effects=[one.effect.name for one in acting], rate_law=rated, parameters=parameters,
                               left_out_percent=100 * self.missed_um / stroke_um)


def _tried(whole: _Whole, runs: Sequence[Recording]) -> _Tried:
    """... of `runs`, the first of which were fitted, each from a start as chain.simulate has it."""
    predictions = chain.simulate(whole.model, runs)
    fitted = runs[:len(whole.found.runs)]
    left_out = _leave_out(whole.found, fitted, effects.acting(whole.model), predictions)
    missed = [run.displacement_um - one.predicted_um if left is None else left
              for run, one, left in zip(fitted, predictions, left_out)]
    squares = [np.mean(block**2) for one in missed for block in np.array_split(one - np.mean(one), BLOCKS)]
    return _Tried(whole, predictions, left_out, np.array(squares))


def _best_first(tried: Sequence[_Tried]) -> list[_Tried]:
    """The first of them, or what beats it with less; then the others, from the best on."""
    best = tried[0]
    rest = sorted(tried[1:], key=lambda one: one.missed_um)
    for one in rest:
        best = one if one.beats(best) else best
    return [best, *(one for one in sorted(tried, key=lambda one: one.missed_um) if one is not best)]


def _compared(whole: _Whole, begun: Sequence[Recording], runs: Sequence[Recording], frame: Frame, options: Options
              ) -> list[_Tried]:
    """A model, and what has less: chains that lack one effect of it, or of the best of these, the operator alone, the
    operator without a rate law. `begun`: what is fitted, with starts that were estimated; `runs`: as recorded.
    """
    best = _tried(whole, runs)
    tried, plain, sweep = [best], whole.plain, whole.found.sweep
    # What monitor_V shows is there, whatever it brings.
    while whole.chosen is not None and len((now := best.whole.chosen).kept) > 1 and not any(one.stage_shown for one in now.kept):
        less = [_tried(_around(plain, around.lacking(now, one), frame, options, sweep), runs) for one in now.kept]
        tried += less
        better = min(less, key=lambda one: one.missed_um)
        if better.missed_um > best.missed_um:
            break
        best = better
    rated = bool(np.any(plain.model.slope_rate_s_per_um))
    alone = [plain] if whole.found is not plain else []
    if rated:
        alone.append(_operator(begun, frame, options, False, sweep=plain.sweep))
    for one in alone:
        nothing = None if whole.chosen is None else around.nothing(whole.chosen, rated and one is plain)
        tried.append(_tried(_Whole(plain, one, nothing, one.model), runs))
    return tried


@dataclass(frozen=True)
class Frame:
    """What is the same for every model of these recordings."""

    gain_um_per_V: float
    offset_V: float
    range_V: tuple[float, float]
    thresholds_um: np.ndarray
    grid_um: np.ndarray  # candidate dead zones
    stroke_um: float
    smoothing_s: list[float]

    @classmethod
    def of(cls, runs: Sequence[Recording], options: Options, warnings: list[str]) -> Frame:
        low_V = min(float(np.min(run.command_V)) for run in runs)
        high_V = max(float(np.max(run.command_V)) for run in runs)
        low_um = min(float(np.min(run.displacement_um)) for run in runs)
        high_um = max(float(np.max(run.displacement_um)) for run in runs)
        stroke = max(float(np.ptp(run.displacement_um)) for run in runs)
        widest = max(runs, key=lambda run: np.ptp(run.command_V))
        sign = 1.0 if correlation(widest) > 0 else -1.0
        if sign < 0 and np.max(late_correlations(widest, widest.displacement_um)) > tuned.MIN_CORRELATION:
            warnings.append(f"{widest.path}: the displacement moves opposite to the command, as one that is late by half "
                            "a period does; if the actuator is not inverted, record a slower drive")
        widest_V = max(float(np.ptp(run.command_V)) for run in runs)
        gain = sign * stroke / widest_V
        return cls(gain, low_V if gain > 0 else high_V,  # x >= 0, as one-sided dead zones need it
                   (low_V, high_V), _thresholds(options, abs(gain) * widest_V, warnings),
                   low_um + GRID * (high_um - low_um), stroke, smoothing_times_s(runs))

    def of_others(self, runs: Sequence[Recording], options: Options) -> Frame:
        """For the same recordings as a part of the chain saw them; the drive stays that of the whole."""
        return replace(Frame.of(runs, options, []), offset_V=self.offset_V, range_V=self.range_V)


@dataclass(frozen=True, eq=False)
class Operator:
    """The operator identified from recordings as it made them, and the regression behind it."""

    model: Model  # without effects
    solution: Solution
    without: Solution  # the same without a rate law
    runs: list[Run]
    reduced: list[Reduced]
    columns: Columns
    sweep: SweepStart


def _operator(runs: Sequence[Recording], frame: Frame, options: Options, rated: bool,
              progress: Callable[[float], None] = lambda fraction: None, sweep: SweepStart | None = None) -> Operator:
    """`sweep`: where a sweep leaves the plays, if that is known already."""
    low_V, high_V = frame.range_V
    ends_V = (low_V if options.min_V is None else options.min_V, high_V if options.max_V is None else options.max_V)
    if not ends_V[1] > ends_V[0]:
        raise BadInput(f"`max_V` {ends_V[1]:g}: must be above the lowest drive, {ends_V[0]:g} V; give `min_V` "
                       "and `max_V`")
    sweep = sweep or sweep_start(runs, frame.gain_um_per_V, frame.offset_V, frame.thresholds_um, ends_V)
    plays = len(frame.thresholds_um)
    bare = Model(  # until one is fitted
        gain_um_per_V=frame.gain_um_per_V, offset_V=frame.offset_V, offset_um=0.0, stroke_um=frame.stroke_um,
        thresholds_um=frame.thresholds_um, slopes=np.ones(plays), slope_rate_s_per_um=np.zeros(plays),
        deadzones_um=np.zeros(1), deadzone_weights=np.ones(1),
        rate=Rate(options.rate_source, options.rate_window_s, options.rate_filter_s or 0.0,
                  min_slope_ratio=options.min_slope_ratio, smoothing_s=min(frame.smoothing_s)),
        drive=Drive(*ends_V, options.slew_V_per_s, options.dac_bits, sweep_end_V=_sweep_end(runs[0], ends_V)),
        memory=Memory(sweep_share=sweep.share),
        actuator=options.actuator if options.actuator is not None else runs[0].metadata.get("actuator", ""),
    )
    found = _fitted(runs, bare, frame, options, rated, sweep, progress)
    guessed = [k for k, run in enumerate(runs) if run.memory == "unknown" and run.past is None]
    for _ in range(ROUNDS if guessed else 0):
        runs = list(runs)
        for k in guessed:
            runs[k] = replace(runs[k], past=None)
        runs = started(found.model, runs)
        found = _fitted(runs, bare, frame, options, rated, sweep, lambda fraction: None)
    return found


def _fitted(runs: Sequence[Recording], bare: Model, frame: Frame, options: Options, rated: bool, sweep: SweepStart,
            progress: Callable[[float], None]) -> Operator:
    """The operator, where the recordings start as they state or as it was estimated."""
    prepared = prepare(runs, bare, frame.smoothing_s, sweep.states_um)
    top = top_rate(prepared)
    if top <= 0:
        raise BadInput(f"{runs[0].path}: the displacement never moves after warm-up; "
                       "record a drive that moves the actuator")
    columns = Columns(frame.thresholds_um, frame.grid_um, top if rated else 0.0)
    reduced = reduce(prepared, columns, frame.stroke_um, progress)
    factor, samples = joined(reduced)
    unknowns = columns.plays + options.deadzones + len(runs)
    if samples < tuned.MIN_SAMPLES_PER_UNKNOWN * unknowns:
        raise BadInput(f"{runs[0].path}: the fit has {unknowns} unknowns, but only {samples} samples after "
                       "warm-up; record longer, state the memory, or use fewer `operators`")
    first = prepared[0]
    bare = replace(bare, rate=replace(bare.rate, identified_um_per_s=top),
                   memory=replace(bare.memory, x_um=float(first.x_um[0]), plays_um=first.states_um))
    for deadzones in range(options.deadzones, -1, -1):
        solution = search(factor, columns, deadzones, samples)
        model = _of_solution(bare, solution, columns, prepared, reduced)
        if model is not None:
            break
    without = search(*without_rate(factor, columns), deadzones, samples) if rated else solution
    model.memory = chain.within_drive(model)
    return Operator(model, solution, without, prepared, reduced, columns, sweep)


def _sweep_end(first: Recording, ends_V: tuple[float, float]) -> float | None:
    """Where the start-up sweep shall end: in the middle, where the model's memory is that of no sweep. A sweep that ends
    near an edge leaves the larger plays behind. None: where the memory is.
    """
    return sum(ends_V) / 2 if first.memory == "unknown" else None


def _behind_amplifier(plain: Operator, runs: Sequence[Recording], frame: Frame, options: Options, warnings: list[str]
                      ) -> tuple[Amplifier | None, Operator, Sequence[Recording]]:
    """The amplifier that monitor_V shows, the operator behind it, and recordings with what drives the actuator as their
    command. None where there is no monitor.
    """
    lacking = [run.path for run in runs if "monitor_V" not in run.columns]
    if lacking:
        if len(lacking) < len(runs):
            warnings.append(f"monitor_V is not used, because {', '.join(lacking)} lack{'s' * (len(lacking) == 1)} it")
        return None, plain, runs
    if all(np.array_equal(run.columns["monitor_V"], run.command_V) for run in runs):
        warnings.append("monitor_V is not used: it is command_V to the last digit; give what the amplifier puts out")
        return None, plain, runs
    names = around.wanted(options.effects)
    found = seen_by_monitor(runs, plain.model, names)
    if found.left > tuned.MONITOR_LEFT and names is None:
        warnings.append(f"monitor_V moves otherwise than the command behind a delay and a lag, by {100 * found.left:.2g} % "
                        "rms of its range: by hum or glitches, or because the recorder or the amplifier reaches a limit")
    if not found.acting:
        return found, plain, runs
    driven = found.drives(runs, plain.model)
    return found, _operator(driven, frame.of_others(driven, options), options, not options.rate_independent), driven


def _beyond(model: Model, range_V: tuple[float, float]) -> str | None:
    """A remark where the firmware may drive far beyond what was recorded."""
    (low_V, high_V), drive = range_V, model.drive
    if max(low_V - drive.min_V, drive.max_V - high_V) <= tuned.BEYOND * (high_V - low_V):
        return None
    return (f"the model may drive {drive.min_V:g} to {drive.max_V:g} V, but only {low_V:g} to {high_V:g} V were recorded: "
            "what the actuator does beyond is extrapolated")


def _late(chosen: Choice, model: Model) -> str:
    """What comes late in a model, in words; "": nothing."""
    late = dict.fromkeys(one.acting.effect.name for one in chosen.kept
                         if one.acting.effect.comes_late and not one.of_amplifier)
    return " and ".join([f"its {name}" for name in late] + ["its rate law"] * bool(np.any(model.slope_rate_s_per_um)))


def _compare_sources(runs: Sequence[Recording], found: Operator, options: Options, warnings: list[str]) -> None:
    """Say so if the other source of the rate explains the recordings much better."""
    other = next(source for source in SOURCES if source != options.rate_source)
    columns, solution = found.columns, found.solution
    swapped = rerated(found.runs, other, options.rate_window_s, found.model.rate.filter_s, smoothing_times_s(runs))
    factor, samples = joined(reduce(swapped, columns, found.model.stroke_um, every=THIN))
    residual = solution.residual
    for _ in range(3):  # the prior follows the residual
        residual = solve(factor, columns, solution.picks, samples, residual).residual
    if residual < tuned.OTHER_SOURCE * solution.residual:
        warnings.append(f"the rate of the {other} explains these recordings better ({100 * residual:.2g} % rms of the "
                        f"stroke against {100 * solution.residual:.2g} %): try --rate-source {other}")


def _check_reset(model: Model, runs: Sequence[Run], warnings: list[str]) -> None:
    """A run marked reset whose start looks like another state was not swept from both sides of where it starts."""
    for prepared in runs:
        run = prepared.recording
        if run.memory == "reset":
            at_rest, best = doubted(Plant(model, run.sample_time_s), run)
            if best < tuned.RESET_DOUBT * at_rest and at_rest - best > 0.003 * model.stroke_um:
                warnings.append(f"{run.path}: marked memory: reset, but another state explains its beginning better "
                                f"({best:.2g} um rms against {at_rest:.2g}); check that the sweep decayed from both "
                                "sides, or mark the memory unknown")


def checked_options(options: Options) -> Options:
    """The same with numbers as Python has them: those of NumPy neither go into a file nor reckon like them.

    Raises BadInput that names the argument. What is in backticks the command line replaces by its option.
    """
    arguments.of_kind(options, Options, "options")
    numbers: dict[str, float] = {}
    for item in fields(Options):
        value = getattr(options, item.name)
        if item.type.startswith(("int", "float")) and not (value is None and item.type.endswith("None")):
            whole = item.type.startswith("int")
            number = arguments.number(value, item.name, finite=whole)
            if whole and number != number // 1:
                raise BadInput(f"{item.name} is {value}; must be a whole number")
            numbers[item.name] = int(number) if whole else number
    options = replace(options, **numbers)
    arguments.of_kind(options.rate_independent, bool, "rate_independent")
    arguments.one_of(options.rate_source, SOURCES, "rate_source")
    if options.thresholds_um is not None:
        _check_thresholds(arguments.series(options.thresholds_um, "thresholds_um", finite=False))
    names = around.wanted(options.effects)
    options = replace(options, effects=around.AUTO if names is None else tuple(names) or around.NONE)
    if options.actuator is not None:
        arguments.of_kind(options.actuator, str, "actuator")
    if not 0 <= options.operators <= 128:
        raise BadInput(f"`operators` {options.operators}: must be 0 to 128")
    if not 0 <= options.deadzones <= 6:
        raise BadInput(f"`deadzones` {options.deadzones}: must be 0 to 6; recordings cannot tell more of them apart")
    if not 0 < options.min_slope_ratio < 1:
        raise BadInput(f"`min_slope_ratio` {options.min_slope_ratio:g}: must lie between 0 and 1")
    for name, value in (("rate_window_s", options.rate_window_s), ("rate_filter_s", options.rate_filter_s)):
        if value is not None and not 0 <= value <= MAX_RATE_TIME_S:
            raise BadInput(f"`{name}` {value:g}: must be 0 to {MAX_RATE_TIME_S:g} s")
    for name, value in (("min_V", options.min_V), ("max_V", options.max_V)):
        if value is not None and not abs(value) <= LARGEST_INPUT:
            raise BadInput(f"`{name}` {value:g}: must be a voltage")
    if options.slew_V_per_s is not None and not 0 < options.slew_V_per_s <= LARGEST:
        raise BadInput(f"`slew_V_per_s` {options.slew_V_per_s:g}: must be positive, in V/s")
    if options.dac_bits is not None and not 1 <= options.dac_bits <= MAX_DAC_BITS:
        raise BadInput(f"`dac_bits` {options.dac_bits}: must be 1 to {MAX_DAC_BITS}")
    return options


def _check_thresholds(thresholds_um: np.ndarray) -> None:
    """Raise BadInput unless they can be r_1 ... r_n."""
    if not np.all(np.diff([0.0, *thresholds_um]) > 0) or not np.all(np.isfinite(thresholds_um)):  # refuses NaN too
        raise BadInput("`thresholds_um`: must be positive, finite and increasing")
    if len(thresholds_um) >= MAX_PLAYS:
        raise BadInput(f"`thresholds_um`: {len(thresholds_um)} values; at most {MAX_PLAYS - 1}")


def _thresholds(options: Options, excursion_um: float, warnings: list[str]) -> np.ndarray:
    """r_0 = 0 ... r_n. A play with a threshold beyond half the largest excursion never moves: not to be identified."""
    reach = excursion_um / 2
    if options.thresholds_um is None:
        # n + 1 equal intervals up to the reach, so that the last slope is seen over as long a way as the others
        return np.arange(options.operators + 1) * reach / (options.operators + 1)
    wanted = np.array([0.0, *options.thresholds_um])
    hidden = wanted[wanted > 0.98 * reach]
    if len(hidden):
        warnings.append(f"thresholds {', '.join(f'{r:g}' for r in hidden)} um are not fitted: they are unobservable, "
                        f"because they exceed half the largest excursion in the recordings ({reach:.4g} um)")
    return wanted[wanted <= 0.98 * reach]


def _of_solution(model: Model, solution: Solution, columns: Columns, runs: Sequence[Run],
              reduced: Sequence[Reduced]) -> Model | None:
    """The model with slopes, saturation, guard and offset of a solution for these runs.

    None: a dead zone lies at or below zero, where it has no meaning. There is none without dead zones.
    """
    offsets = np.array([offset_of(run.means, columns, solution) for run in reduced]) * model.stroke_um
    # The offset of a run whose unknown memory is never erased holds what its plays remember: only if there is no other.
    known = [run.recording.memory != "unknown" or np.ptp(run.x_um) >= 2 * model.thresholds_um[-1] for run in runs]
    weights = [len(run.x_um) * (sure or not any(known)) for run, sure in zip(runs, known)]
    offset_um = float(np.average(offsets, weights=weights))
    corners_um = columns.grid_um[list(solution.picks)] - offset_um
    if np.any(corners_um <= 0):
        return None
    deadzones, deadzone_weights = saturation_of(corners_um, solution.pieces)
    top = model.rate.identified_um_per_s
    change = (solution.fast - solution.rest) / top
    found = replace(model, offset_um=offset_um, slopes=solution.rest, slope_rate_s_per_um=change, deadzones_um=deadzones,
                    deadzone_weights=deadzone_weights)
    return guarded(found, tuned.RATE_HEADROOM * top, slack=1.0)


def _leave_out(found: Operator, recorded: Sequence[Recording], acting: Sequence[effects.Acting],
               predictions: Sequence[chain.Prediction]) -> list[np.ndarray | None]:
    """What a model fitted to the others misses of each run, as `recorded`, (samples,); None where the others do not make a
    model. Of a run that moves where no other does, such as the only one, parts are left out in turn.

    Effects, rate and memory are those of the model's own prediction: they hardly differ, and finding them anew takes
    long.
    """
    columns, m = found.columns, len(found.solution.picks)
    parts: list[tuple[int, slice]] = []
    runs: list[Run] = []
    for k, (run, whole) in enumerate(zip(found.runs, covered([run.recording for run in found.runs]))):
        slices = [slice(None)]
        if not whole:
            ends = np.linspace(run.first, len(run.x_um), passport.PARTS + 1).astype(int)
            ends[0] = 0  # what depends on an unknown memory goes with the first part
            slices = [slice(*map(int, pair)) for pair in zip(ends, ends[1:])]
        parts += [(k, part) for part in slices]
        runs += [run] if whole else parts_of(run, columns.thresholds_um, slices)
    reduced = found.reduced if len(runs) == len(found.runs) else reduce(runs, columns, found.model.stroke_um)
    left: list[np.ndarray | None] = [None] * len(parts)
    for group in np.array_split(np.arange(len(runs)), min(len(runs), FOLDS)):
        rest = [k for k in range(len(runs)) if k not in group]
        if sum(reduced[k].samples for k in rest) < tuned.MIN_SAMPLES_PER_UNKNOWN * (columns.plays + m + len(rest)):
            continue
        others = [reduced[k] for k in rest]
        try:
            factor, samples = joined(others)
            solution = search(factor, columns, m, samples)
            other = _of_solution(found.model, solution, columns, [runs[k] for k in rest], others)
            for k in group if other is not None else ():
                at, part = parts[k]
                driven, seen = found.runs[at].recording, predictions[at]
                z = chain.operator_from(other, driven, seen.start_um).forward(driven.command_V, seen.rate_um_per_s)
                shown = effects.displaced(acting, z, driven, found.model)
                left[k] = (recorded[at].displacement_um - shown)[part]
        except BadInput:  # what the others determine is no model: the run is then known as fitted only
            pass
    of_runs = [[one for one, (at, _) in zip(left, parts) if at == k] for k in range(len(found.runs))]
    return [None if any(one is None for one in pieces) else np.concatenate(pieces) for pieces in of_runs]


def _passport(runs: Sequence[Recording], hold_out: Sequence[Recording], predictions: Sequence[chain.Prediction],
              left_out: Sequence[np.ndarray | None], noises: Sequence[float], drift_um: float, warnings: list[str]
              ) -> Passport:
    residuals = []
    for k, (run, prediction) in enumerate(zip([*runs, *hold_out], predictions)):
        left = run.displacement_um - prediction.predicted_um
        coords = localise.coordinates(run, prediction.predicted_um, prediction.rate_um_per_s)
        stuck = stick_slip.stuck(run.displacement_um, prediction.predicted_um)
        if sticks := stick_slip.remark(run.path, left, run.displacement_um, stuck):
            warnings.append(sticks)
        if k >= len(runs):
            how, held_out, fitted = passport.OTHER_RUNS, left, None
        elif left_out[k] is None:
            how, held_out, fitted = passport.FITTED, None, left
        else:
            how, held_out, fitted = passport.LEFT_OUT, left_out[k], left
        residuals.append(passport.Residual(run, how, held_out, fitted, coords, noises[k], stuck))
    return passport.build(residuals, drift_um)


def _half_loop_um(model: Model) -> float:
    """Half the width of the great loop at rest, amid the range: as far as plays that forget lead aside of others."""
    reach_um = abs(model.gain_um_per_V) * (model.drive.max_V - model.drive.min_V) / 2
    return abs(float(operators.bank(np.minimum(model.thresholds_um, reach_um), operators.play_weights(model, 0.0))))


def _expected_there(run: Recording, at: int, memory: str) -> bool:
    """Whether a model misses most in this sample anyway: behind an unknown past, or behind an edge of the drive."""
    speed = np.abs(np.diff(run.command_V))
    behind = speed[max(0, at - round(tuned.LATEST_S / run.sample_time_s)):at + 1]
    edge = max(tuned.EDGE * float(np.sqrt(np.mean(speed**2))), float(np.max(speed)) / 2)
    return memory == "estimated" and at < len(run) // 10 or float(np.max(behind, initial=0.0)) > edge


def _scores(runs: Sequence[Recording], hold_out: Sequence[Recording], predictions: Sequence[chain.Prediction],
            warnings: list[str]) -> list[RunScore]:
    scores = []
    for k, (run, prediction) in enumerate(zip([*runs, *hold_out], predictions)):
        score = chain.score(prediction.predicted_um, run.displacement_um, where=run.path)
        at = int(np.argmax(np.abs(run.displacement_um - prediction.predicted_um)))
        if score.max_um > tuned.FAR_OFF * score.rms_um and not _expected_there(run, at, prediction.memory):
            warnings.append(f"{run.path}: most is missed at {run.time_s[at]:.6g} s, {score.max_um:.3g} um and "
                            f"{tuned.FAR_OFF:g} times the rms or more; if what lies there is none of the actuator's, cut it "
                            "off with `rdpi import --rows`")
        scores.append(RunScore(run, k >= len(runs), score, prediction.memory))
    return scores


def _check_loops(runs: Sequence[Recording], warnings: list[str]) -> None:
    """Loops that run the other way round than those of hysteresis: the displacement leads the command."""
    for run in runs:
        u, z = (np.append(one, one[0]) for one in (run.command_V, run.displacement_um))  # closed
        moves, rectangle = np.diff(u), float(np.ptp(u) * np.ptp(z))
        way = float(np.sum(np.abs(moves))) * float(np.ptp(z))  # twice the rectangles of all strokes
        area = float(np.sum(moves * (z[1:] + z[:-1])))  # twice that of the loops
        if way > 4 * rectangle > 0 and area * np.sign(correlation(run)) > tuned.WRONG_WAY * way:
            warnings.append(f"{run.path}: its loops run the wrong way round, as if the displacement drove the command; check "
                            "that the columns are not swapped, and that both were sampled at the same time")


def _check_order(model: Model, warnings: list[str]) -> None:
    """Loops that get narrower with the rate are not an actuator's: the columns may be out of step."""
    narrower = model.slopes_at(model.rate.max_um_per_s)[0] / model.slopes[0] - 1
    if narrower > tuned.NARROWER:
        warnings.append(f"loops get narrower the faster they are: the lowest slope is {100 * narrower:.2g} % larger at the "
                        "highest rate; so the displacement may come before the command as recorded; check that both "
                        "were sampled at the same time (`rdpi import --drive` aligns them)")


def _remark(solution: Solution, scores: Sequence[RunScore], stroke_um: float, warnings: list[str]) -> None:
    slopes = np.r_[solution.rest, solution.fast]
    if np.any(slopes <= tuned.SLOPE_FLOOR * 1.0001):
        warnings.append(f"a slope is at its lower bound of {tuned.SLOPE_FLOOR:g}: the recordings do not determine it; "
                        "use fewer --operators or record more amplitudes and rates")
    least_um, most_um = tuned.NO_STROKE_UM
    if not least_um <= stroke_um <= most_um:
        others = "nm" if stroke_um > most_um else "mm or m"
        warnings.append(f"the stroke is {stroke_um:.3g} um: displacements are taken for um; if they are in {others}, give "
                        "`rdpi import` their unit")
    furthest_V = max(float(np.max(np.abs(run.recording.command_V))) for run in scores)
    if furthest_V > tuned.NO_DRIVE_V:
        warnings.append(f"the drive goes to {furthest_V:.3g} V: commands are taken for volts; if they are in mV, give "
                        "`rdpi import` their unit")
    actuators = sorted({run.recording.metadata["actuator"] for run in scores if "actuator" in run.recording.metadata})
    if len(actuators) > 1:
        warnings.append(f"the recordings name different actuators: {', '.join(actuators)}")
    for run in scores:
        path, stays = run.recording.path, stays_at_an_end(run.recording)
        if run.memory == "estimated":
            warnings.append(f"{path}: the memory at the start is unknown and is estimated" + (
                "" if run.held_out else "; where it is known, say so above the columns: # memory: reset right after a "
                "decaying sweep, as `rdpi import --drive` cuts it off, # memory: low or high after a rest at that end"))
        rate_hz = run.recording.sample_rate_hz
        lasts_s = len(run.recording) / rate_hz
        if rate_hz < tuned.SLOW_HZ or lasts_s > tuned.LONG_S:
            warnings.append(f"{path}: {rate_hz:.3g} samples per second, so that it lasts {lasts_s:.3g} s: "
                            "times are taken for seconds; if they are ms or us, give `rdpi import` their unit")
        if stays:
            warnings.append(f"{path}: {stays} samples stay at the highest or lowest reading "
                            "while the command moves; check whether the sensor is clipped")
        # An unknown past leaves a constant, and of a small movement everything is a large share.
        missed_um = run.score.beside_offset_um if run.memory == "estimated" else run.score.rms_um
        moved_um = float(np.ptp(run.recording.displacement_um))
        if 100 * missed_um > tuned.POOR_PERCENT * max(moved_um, tuned.POOR_SMALL * stroke_um):
            aside = f"; it lies {run.score.offset_um:.3g} um aside of the model: check the sensor's zero" \
                if run.memory != "estimated" and run.score.mostly_offset else ""
            warnings.append(f"{path}: the model misses this run by {100 * missed_um / moved_um:.2g} % rms of its stroke "
                            "and may not be fit for use; check that the run is of the same actuator, in the same units, "
                            f"and without drift, delay or ringing{aside}")
