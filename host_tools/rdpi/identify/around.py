"""What stands around the operator: which effects a fit looks for, and how it tells what it found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data import Recording, arguments
from ..errors import BadInput
from ..model import Model, records
from ..simulate.effects import CATALOGUE, SENSOR, Acting, Effect
from .amplifier import OF_AMPLIFIER, Amplifier
from .choice import (Choice, Judged, Kept, choose, forced, judged, refitted, ringing_late, starts, with_intervals,
                     with_rate_filter, without_rate_law)
from .document import BeforeAfter, IdentifiedEffect
from .holds import is_limited, limited
from .hypothesis import Hypothesis, Setting, Unknowns
from .joint import Linearised, refined
from .regression import Run, rerated, smoothing_times_s, top_rate
from .strokes import Strokes

if TYPE_CHECKING:
    from .identify import Operator, Options

CORNERS = 6  # of the saturation while effects are chosen
FILTERS = 0.25 * 0.5 ** np.arange(8)  # of the longest stroke's time: low-passes on the rate that are tried
FILTER_SAMPLES = 2  # that these last at least: a shorter one is the difference of two samples, seen half a sample late
FILTER_S = 4.0  # that these last at most: fixed point counts 32 bits of ns
AUTO, NONE = "auto", "none"
FITTED = {name: kind for name, kind in reversed(CATALOGUE.items()) if kind.of_rig}  # the simplest first


def wanted(effects: str | Sequence[str]) -> list[str] | None:
    """Names of the effects that must be identified; None: those that recordings show. Raises BadInput for others."""
    if isinstance(effects, str) and effects in (AUTO, NONE):
        return [] if effects == NONE else None
    names = [name.strip() for name in effects.split(",")] if isinstance(effects, str) else \
        arguments.listed(effects, str, "effects")
    for name in names:
        if name in (AUTO, NONE):
            raise BadInput(f"`effects`: {name} stands alone, without names of effects")
        if name not in FITTED:
            known = f"{name} is none that `rdpi fit` identifies" if name in CATALOGUE else f"no effect {name!r}"
            raise BadInput(f"`effects`: {known}; it identifies {', '.join(FITTED)}")
        if names.count(name) > 1:
            raise BadInput(f"`effects`: {name} is named twice; an effect acts once")
    if not names:
        raise BadInput("`effects`: names no effect; say none, auto, or names")
    return names


def identify(plain: Operator, runs: Sequence[Recording], options: Options, progress: Callable[[float], None],
             amplifier: Amplifier | None = None) -> Choice:
    """What stands around the operator; `plain` is the operator fitted as if nothing did. Behind an amplifier: what else
    does, and the runs have what drives the actuator as their command.
    """
    setting, unknowns = _setting(plain, runs, options)
    strokes = Strokes.of(runs)
    # Also where the model shall have no rate law, it takes part: what it explains is not to pass for a delay.
    rate_law = strokes.rates_differ
    names = wanted(options.effects)
    if names is None:
        candidates = list(filter(None, (limited(_placed(kind, amplifier), runs, plain.model) for kind in FITTED.values()
                                        if strokes.show(kind))))
        found = choose(setting.thinned(strokes.shortest_s), unknowns, candidates, rate_law, progress)
        if options.rate_independent and found.found.hypothesis.rated:
            found, rate_law = without_rate_law(found, candidates), False
        elif options.rate_filter_s is None and not options.rate_independent:
            least_s = FILTER_SAMPLES * max(run.sample_time_s for run in runs)
            smoothing_s = smoothing_times_s(runs)
            settings = {filter_s: _filtered(setting, plain, options, filter_s, smoothing_s)
                        for filter_s in strokes.longest_s * FILTERS if least_s <= filter_s <= FILTER_S}
            if settings:
                thinned = [one.thinned(strokes.shortest_s) for one in settings.values()]
                found = with_rate_filter(found, thinned, candidates)
            setting = settings.get(found.found.state.setting.rate_filter_s, setting)
        found = refitted(found, setting)
    else:
        candidates = [_placed(kind, amplifier) for name, kind in FITTED.items() if name in names]  # in whatever order they are given
        alone = refined(setting, Hypothesis(), unknowns)
        for effect in candidates:
            _check_excited(alone, effect, strokes)
        found = forced(setting, unknowns, candidates, rate_law)
        if options.rate_independent and found.found.hypothesis.rated:
            found, rate_law = without_rate_law(found, ()), False
    return with_intervals(found, candidates, rate_law)


def without_ringing(plain: Operator, runs: Sequence[Recording], options: Options) -> list[Recording]:
    """The recordings as an operator alone would have made them, as far as a resonance that is sought is seen at once."""
    setting, unknowns = _setting(plain, runs, options)
    names = wanted(options.effects)
    sought = [kind() for name, kind in FITTED.items() if names is None or name in names]
    return ringing_late(refined(setting, Hypothesis(), unknowns), sought).seen()


def _setting(plain: Operator, runs: Sequence[Recording], options: Options) -> tuple[Setting, Unknowns]:
    """What is the same for every hypothesis, and unknowns to begin with."""
    # Corners everywhere: each hypothesis has dead zones of its own, and none is to make up for those of another.
    corners_um = plain.columns.grid_um[np.linspace(1, len(plain.columns.grid_um) - 2, CORNERS).round().astype(int)]
    setting = Setting(
        runs, [run.states_um if run.recording.memory != "reset" or plain.sweep.share else None for run in plain.runs],
        [_first(run) for run in plain.runs], plain.model, corners_um if options.deadzones else corners_um[:0],
        [run.rate_um_per_s for run in plain.runs], plain.model.rate.identified_um_per_s, plain.model.rate.filter_s)
    slopes = plain.without.rest
    return setting, Unknowns(slopes, np.zeros(len(slopes)), np.ones(len(setting.corners_um)))


def _placed(kind: type[Effect], amplifier: Amplifier | None) -> Effect:
    """Where a fit looks for it: behind the amplifier, what comes late is the sensor's."""
    return kind(SENSOR if amplifier is not None and kind.name in OF_AMPLIFIER else None)


def behind(choice: Choice, amplifier: Amplifier, runs: Sequence[Recording]) -> Choice:
    """What was chosen behind an amplifier, and the amplifier; `runs` are as recorded."""
    found, setting = choice.found, choice.found.state.setting

    def without(one: Acting) -> Judged:
        driven = amplifier.drives(runs, setting.model, without=one)
        return judged(replace(setting, runs=driven), found.hypothesis, found.state.found)

    plain = judged(replace(setting, runs=runs), Hypothesis(), choice.plain.state.found) if amplifier.acting else \
        choice.plain
    ahead = [Kept(one, {one.effect.late_by: amplifier.ci95[one.effect.late_by]}, without(one), (), stage_shown=True)
             for one in amplifier.acting]
    rest = [replace(one, stage_shown=True) if amplifier.shows(one.acting) else
            replace(one, acting=amplifier.unplaced(one.acting)) for one in choice.kept]
    return Choice(plain, found, (*ahead, *rest))


def lacking(choice: Choice, one: Kept) -> Choice:
    """The same without one of the effects, the others fitted anew."""
    less, others = one.without, [other for other in choice.kept if other is not one]
    kept = [replace(other, acting=acting, without=less.trying(less.hypothesis.lacking(acting)))
            for other, acting in zip(others, less.hypothesis.acting)]
    found = Choice(choice.plain, less, tuple(kept))
    return with_intervals(found, [other.acting.effect for other in kept], less.hypothesis.rated)


def nothing(choice: Choice, rated: bool) -> Choice:
    """The same without any effect, with a rate law or without."""
    return Choice(choice.plain, choice.plain.trying(Hypothesis(rated=True)) if rated else choice.plain, ())


def by_command(choice: Choice, runs: Sequence[Recording], names: Sequence[str] | None) -> Judged:
    """What was chosen behind an amplifier, with the command as the drive, and all that comes late ahead of the actuator;
    the same if nothing does.
    """
    late_s = sum(one.acting.values[one.acting.effect.late_by] for one in choice.kept if one.acting.effect.late_by)
    if not late_s:
        return choice.found
    kinds = [kind for name, kind in OF_AMPLIFIER.items() if names is None or name in names]
    found, hypothesis = choice.found, Hypothesis(rated=choice.found.hypothesis.rated)
    for one in (*(one for one in found.hypothesis.acting if one.effect.name not in OF_AMPLIFIER),
                *(Acting(kind(), {kind.late_by: late_s / len(kinds)}) for kind in kinds)):
        hypothesis = hypothesis.having(one)
    return judged(replace(found.state.setting, runs=runs), hypothesis, found.state.found)


def _filtered(setting: Setting, plain: Operator, options: Options, filter_s: float, smoothing_s: Sequence[float]
              ) -> Setting:
    """With rates behind a low-pass."""
    runs = rerated(plain.runs, options.rate_source, options.rate_window_s, filter_s, smoothing_s)
    return replace(setting, rates_um_per_s=[run.rate_um_per_s for run in runs], top_um_per_s=top_rate(runs),
                   rate_filter_s=filter_s)


def _first(run: Run) -> int:
    """The first sample that counts. A run that goes on from another starts in motion, where lags start settled."""
    part = len(run.x_um) // 8 if run.recording.memory == "carried" else 0
    return max(run.first, part)


def _check_excited(alone: Linearised, effect: Effect, strokes: Strokes) -> None:
    paths = ", ".join(run.path for run in alone.setting.runs)
    if not strokes.show(type(effect)):
        alike = "rate" if effect.needs_rates else "size"
        raise BadInput(f"{paths}: cannot show {effect.name}: all strokes have about the same {alike}; it needs "
                       f"{effect.needs}")
    if not starts(alone, effect):
        raise BadInput(f"{paths}: cannot show {effect.name}: too short or too slow; it needs {effect.needs}")


# ---- what was found ----


def entries(choice: Choice) -> list[dict[str, Any]]:
    """For the list `effects` of the model file."""
    return [records.EffectEntry(name=one.acting.effect.name, stage=one.acting.effect.stage, origin="fit",
                                parameters=_parameters(one), stage_shown=one.stage_shown or None).to_json()
            for one in choice.kept]


def sections(choice: Choice | None) -> list[IdentifiedEffect]:
    """For the document of the fit."""
    return [IdentifiedEffect(
        name=one.acting.effect.name, stage=one.acting.effect.stage, parameters=_parameters(one),
        held_out_rms_um=BeforeAfter(before=one.without.rms_um, after=choice.found.rms_um),
        shrink=1 - choice.found.rms_um / max(one.without.rms_um, 1e-300), confusable_with=list(one.confusable_with),
        stage_shown=one.stage_shown)
        for one in (choice.kept if choice else ())]


def _parameters(one: Kept) -> dict[str, records.EffectParameter]:
    effect, values = one.acting
    return {parameter.name: records.EffectParameter(value=values[parameter.name], ci95=one.ci95.get(parameter.name),
                                                    unit=effect.unit(parameter)) for parameter in effect.parameters}


def lines(choice: Choice, model: Model) -> list[str]:
    """For people: each effect, its size, what it brought, and what may be in its place."""
    names, rated = list(dict.fromkeys(one.acting.effect.name for one in choice.kept)), choice.found.hypothesis.rated
    law = "with a rate law" if rated else "no rate law"
    if not rated and np.any(model.slope_rate_s_per_um):  # where nothing stands around it, the operator keeps its own
        law = "with a rate law that does not help for certain"
    told = [f"around the operator: {', '.join(names) or 'nothing'}, {law}; rms of parts of "
            f"these recordings, each predicted from the others: {choice.percent(choice.found.rms_um):.3g} % of the stroke"
            + (f", a rate-independent operator alone {choice.percent(choice.plain.rms_um):.3g} %" if names or rated else "")]
    for one in choice.kept:
        effect, values = one.acting
        sizes = ", ".join(_size(effect, parameter, values[parameter.name], one.ci95.get(parameter.name))
                          for parameter in effect.parameters if not parameter.internal)
        rivals = f"; {' or '.join(one.confusable_with)} would do as well" if one.confusable_with else ""
        where = f" at stage {effect.stage}" if effect.stage != effect.stages[0] or one.stage_shown else ""
        where += ", as monitor_V shows" if one.stage_shown else ""
        brought = "" if one.of_amplifier else f"; without it {choice.percent(one.without.rms_um):.3g} %"
        told.append(f"  {effect.name}{where}: {sizes}{brought}{rivals}")
    return told


def _size(effect: Effect, parameter: Any, value: float, ci95: tuple[float, float] | None) -> str:
    unit = effect.unit(parameter)
    text = f"{parameter.name} {value:.4g}" + (f" {unit}" if unit != "1" else "")
    if ci95:
        return f"{text} (95 %: {ci95[0]:.4g} to {ci95[1]:.4g})"
    return text + (", the most that holds show" if is_limited(effect) and value > 0 else
                   ", at an end of what the fit allows")
