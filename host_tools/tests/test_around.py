"""What stands around the operator: effects that `fit` finds with it, and those that it must not find."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fitted import moving_runs, static_run
from injected import COMMISSIONING, FURTHER, LIMITS, NOISE_UM, RATE_HZ, drives, entry, left_um, plain_model, recorded
from plants import changed, recording, stack

from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.identify import Options, around, choice, fit, joint, rate_slopes, summary
from rdpi.identify import thresholds as tuned
from rdpi.identify.around import lines
from rdpi.identify.choice import Choice, choose
from rdpi.identify.hypothesis import Hypothesis, Setting
from rdpi.identify.identify import Fit
from rdpi.identify.joint import Linearised
from rdpi.identify.passport import LEFT_OUT
from rdpi.identify.strokes import covered
from rdpi.model import Model
from rdpi.simulate import ALL, chain, inverse_of
from rdpi.simulate.effects import CATALOGUE, Acting, Residuals

# Smaller than a sample of 1 ms, one sample, and several.
PUT: dict[str, dict[str, float]] = {
    "delay": {"delay_s": 0.0006}, "lag": {"time_constant_s": 0.003},
    "relaxation": {"share": 0.05, "time_constant_s": 0.02}, "creep": {"percent_per_decade": 3.0},
    "resonance": {"f0_hz": 60.0, "damping": 0.05},
    "input_curve": {"quadratic": 0.15, "cubic": 0.1, "low_V": 0.0, "high_V": 100.0}}
TOGETHER = "delay", "lag", "resonance"


def put(*names: str, law: float = 0.0) -> list[Recording]:
    return recorded(plain_model(law), drives(COMMISSIONING), *(entry(name, **PUT[name]) for name in names))


@lru_cache(maxsize=None)
def fitted(*names: str, effects: str = "auto", law: float = 0.0) -> Fit:
    return fit(put(*names, law=law), Options(effects=effects))


def misses_um(model: Model, *names: str, law: float = 0.0) -> float:
    """rms on drives that were not fitted, beyond their noise."""
    runs = recorded(plain_model(law), drives(FURTHER), *(entry(name, **PUT[name]) for name in names), seed=5)
    left = np.concatenate([run.displacement_um - found.predicted_um
                           for run, found in zip(runs, chain.simulate(model, runs))])
    return float(np.sqrt(max(np.mean(left**2) - NOISE_UM**2, 0.0)))


SQUARES = 1.0 + 0.1 * np.random.default_rng(1).random((2, joint.BLOCKS))


def leaving(share: float, *names: str, rated: bool = False, ends: tuple[str, ...] = ()) -> choice.Judged:
    """What leaves a share of SQUARES, with these effects of PUT, of which some stand at an end of what rigs have."""
    acting = {name: Acting(CATALOGUE[name](), PUT[name]) for name in names}
    return choice.Judged(SimpleNamespace(hypothesis=Hypothesis(tuple(acting.values()), rated=rated),
                                         at_ends=[acting[name] for name in ends],
                                         setting=SimpleNamespace(samples=1000)), share * SQUARES)


def test_of_two_effects_that_help_only_together_both_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a curve creep brings little, and the curve alone nothing that is certain; both together do."""
    class Standing(SimpleNamespace):
        """What is left of it; one beats another that leaves half as much again."""

        def beats(self, other: Standing) -> bool:
            return self.left * 1.5 < other.left

        def trying(self, names: str) -> Standing:
            return fitted_ones[names]

        is_better = beats

    left = {"": 10.0, "curve": 7.0, "creep": 9.0, "creep, curve": 6.0}
    early = SimpleNamespace(comes_late=False)
    fitted_ones = {names: Standing(left=value, hypothesis=early, state=SimpleNamespace(names=names))
                   for names, value in left.items()}
    monkeypatch.setattr(choice, "_smaller", lambda state, rate_law: {"creep, curve": ["curve", "creep"]}.get(
        state.names, [""] * bool(state.names)))
    pruned = partial(choice._pruned, fitted_ones["creep, curve"], False)
    assert pruned() is fitted_ones["curve"] and not pruned().beats(fitted_ones[""])
    assert pruned(than=fitted_ones[""]) is fitted_ones["creep, curve"]
    early.comes_late = True
    assert pruned(than=fitted_ones[""]) is fitted_ones["curve"]
    assert pruned(than=fitted_ones[""], late_counts=True) is fitted_ones["creep, curve"]


@pytest.mark.parametrize(("left", "stays"), [(0.65, True), (0.75, False)])
def test_what_leaves_far_less_together_stays_although_it_comes_late(left: float, stays: bool,
                                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    """A lag and a resonance of 700 Hz: each alone was no more than what makes any actuator look a little late."""
    def standing(left: float) -> SimpleNamespace:
        return SimpleNamespace(left=left, beats=lambda other: left < other.left, is_better=lambda other: left < other.left)

    plain, full, too_little = standing(1.0), standing(left), standing(1.1)
    for name, found in {"judged": plain, "_grown": plain, "_late_instead": plain, "_late_first": plain, "_full": full,
                        "_kept": []}.items():
        monkeypatch.setattr(choice, name, lambda *arguments, found=found: found)
    monkeypatch.setattr(choice, "_pruned", lambda now, *rest, late_counts=False, **than:
                        now if now is plain or late_counts else too_little)
    monkeypatch.setattr(choice, "_exchanged", lambda now, candidates: (now, []))
    chosen = choice.choose(SimpleNamespace(samples=1), None, [], False)
    assert chosen.found is (full if stays else plain) and chosen.perhaps is None


@pytest.mark.parametrize("rated", [False, True])
def test_a_rate_law_takes_the_place_of_no_lag_that_leaves_clearly_less(rated: bool) -> None:
    """A plain operator is behind a lag only if that leaves a quarter less; one with a rate law is not plain."""
    law_or_plain = leaving(1.0, rated=rated)
    assert [leaving(share, "lag").beats(law_or_plain) for share in (0.7, 0.85, 0.95)] == [True, rated, False]


@pytest.mark.parametrize(("left", "taken"), [(0.5, True), (0.85, False)])
def test_several_that_come_late_take_the_place_of_a_rate_law(left: float, taken: bool, monkeypatch: pytest.MonkeyPatch
                                                             ) -> None:
    """Each alone hardly leaves less than the law; together they must leave far less."""
    asked = []
    plain, law, late = leaving(3.0), leaving(1.0, rated=True), leaving(left, "lag", "relaxation")
    monkeypatch.setattr(choice, "_grown", lambda *arguments: asked.append(arguments) or late)
    monkeypatch.setattr(choice, "_pruned", lambda now, rate_law: now)
    assert choice._late_instead(plain, law, []) is (late if taken else law) and asked == [(plain, [], False)]
    for beside in (plain, leaving(1.0, "lag", rated=True)):  # no law, or one beside what comes late
        assert choice._late_instead(plain, beside, []) is beside and len(asked) == 1


@pytest.mark.parametrize("beside", [(), ("delay",)])
def test_what_comes_late_at_the_end_of_what_rigs_have_is_not_kept(beside: tuple[str, ...]) -> None:
    assert leaving(0.5, *beside, "relaxation").beats(leaving(1.0, *beside))
    assert not leaving(0.5, *beside, "relaxation", ends=("relaxation",)).beats(leaving(1.0, *beside))


def test_a_resonance_that_does_not_ring_is_not_kept() -> None:
    """With the most damping that rigs have, it only comes late."""
    for damping, rings in ((0.3, False), (0.05, True), (0.001, True)):
        one = Acting(CATALOGUE["resonance"](), {"f0_hz": 60.0, "damping": damping})
        state = SimpleNamespace(hypothesis=Hypothesis((one,)), free=[(0, "f0_hz"), (0, "damping")])
        state.ends = joint.Linearised.ends.fget(state)
        state.at_ends = joint.Linearised.at_ends.fget(state)
        state.at_most, state.setting = joint.Linearised.at_most.fget(state), SimpleNamespace(samples=1000)
        assert choice.Judged(state, 0.5 * SQUARES).beats(leaving(1.0)) is rings


@pytest.mark.parametrize(("left", "taken"), [(0.9, True), (1.1, False)])
def test_without_a_rate_law_what_comes_late_takes_its_place_if_it_leaves_less(left: float, taken: bool,
                                                                              monkeypatch: pytest.MonkeyPatch) -> None:
    plain, law, late = leaving(3.0), leaving(1.0, rated=True), leaving(left, "lag")
    monkeypatch.setattr(choice, "_grown", lambda now, candidates, rate_law: late)
    monkeypatch.setattr(choice, "_pruned", lambda now, rate_law: now)
    monkeypatch.setattr(choice, "_compared", lambda now, candidates: [])
    law._tried.append((Hypothesis(), plain))
    found = choice.without_rate_law(choice.Choice(plain, law, ()), []).found
    assert found is (late if taken else plain)


@pytest.mark.parametrize("names", [*(pytest.param((name,), marks=pytest.mark.long if name in TOGETHER else [])
                                     for name in PUT), TOGETHER], ids=" ".join)
def test_finds_what_is_there(names: tuple[str, ...]) -> None:
    """By name and size; what was not fitted is predicted as if nothing stood around the operator."""
    found = fitted(*names)
    kept = {one.acting.effect.name: one for one in found.choice.kept}
    assert set(kept) == set(names)
    for name in names:
        for parameter, value in PUT[name].items():
            near = 0.6 if name == "input_curve" else 0.15  # the saturation, which bends likewise, takes its part
            assert kept[name].acting.values[parameter] == pytest.approx(value, rel=near)
    assert misses_um(found.model, *names) < 2 * misses_um(fitted(effects="none").model)
    assert misses_um(found.model, *names) < 0.7 * misses_um(fitted(*names, effects="none").model, *names)


@pytest.mark.long
def test_finds_what_hides_behind_strong_ringing() -> None:
    """Alone none of these brings much."""
    behind = {"lag": {"time_constant_s": 0.003}, "relaxation": {"share": 0.08, "time_constant_s": 0.04},
              "resonance": {"f0_hz": 40.0, "damping": 0.015}}
    found = fit(recorded(plain_model(), drives(COMMISSIONING), *(entry(name, **behind[name]) for name in behind)))
    assert [one.acting.effect.name for one in found.choice.kept] == list(behind)
    for one in found.choice.kept:
        assert dict(one.acting.values) == pytest.approx(behind[one.acting.effect.name], rel=0.15)


def test_a_share_that_comes_as_late_as_creep_is_creep() -> None:
    runs = recorded(plain_model(), drives(COMMISSIONING), entry("relaxation", share=0.06, time_constant_s=0.3))
    found = fit(runs)
    assert [one.acting.effect.name for one in found.choice.kept] == ["creep"]
    assert left_um(found.model, runs) < 0.4 * left_um(fit(runs, Options(effects="none")).model, runs)


@pytest.mark.parametrize("f0_hz", [200.0, 201.0, 202.0, 203.0])
def test_a_start_lies_on_a_sharp_peak_wherever_that_is(f0_hz: float) -> None:
    """It is four tenths of a hertz wide, a tenth of the bands in which peaks are looked for."""
    resonance, model = CATALOGUE["resonance"](), plain_model()
    walk = np.cumsum(np.random.default_rng(1).standard_normal(20_000))
    run = replace(put()[0], columns={"time_s": np.arange(len(walk)) / RATE_HZ, "command_V": walk,
                                     "displacement_um": walk}, metadata={})
    missed = resonance.displacement(walk, run, {"f0_hz": f0_hz, "damping": 0.001}, model) - walk
    starts = resonance.starts(Residuals(model, [run], [walk], [missed], [missed]))
    assert min(abs(one["f0_hz"] / f0_hz - 1) for one in starts if one["damping"] < 0.01) < 0.002


@pytest.mark.parametrize(("put_s", "f0_hz", "damping"), [(0.005, 50.0, 0.04), (0.002, 37.0, 0.012), (0.0, 60.0, 0.05)])
def test_what_rings_late_starts_as_late_as_it_is(put_s: float, f0_hz: float, damping: float) -> None:
    """Not a period later, although slightly damped ringing looks the same then."""
    resonance, delay, model, run = CATALOGUE["resonance"](), CATALOGUE["delay"]("sensor"), plain_model(), put()[0]
    asked = run.displacement_um
    late = delay.act(asked, run, {"delay_s": put_s}, model)
    missed = resonance.displacement(late, run, {"f0_hz": f0_hz, "damping": damping}, model) - asked
    starts = resonance.late_starts(Residuals(model, [run], [asked], [missed], [missed]))
    assert starts and all(abs(late_s - put_s) < 0.1 / f0_hz and one["f0_hz"] == pytest.approx(f0_hz, rel=0.03)
                          for one, late_s in starts)


@pytest.mark.parametrize("put_s", [0.0004, 0.005])
def test_what_is_late_alone_rings_nowhere(put_s: float) -> None:
    model, run = plain_model(), put()[0]
    asked = run.displacement_um
    missed = CATALOGUE["delay"]("sensor").act(asked, run, {"delay_s": put_s}, model) - asked
    assert CATALOGUE["resonance"]().late_starts(Residuals(model, [run], [asked], [missed], [missed])) == []


@pytest.mark.long
def test_a_resonance_that_rings_out_of_step_is_found_again_behind_what_is_late() -> None:
    """From a frequency a little off, no step leads to both; from the delay one does."""
    behind = {"delay": {"delay_s": 0.0045}, "resonance": {"f0_hz": 40.0, "damping": 0.012}}
    runs = recorded(plain_model(), drives(COMMISSIONING), *(entry(name, **behind[name]) for name in behind))
    found = fit(runs).choice
    delay, resonance = (one.acting.effect for one in found.kept)
    rung_um, alone_um = (max(np.ptp(run.displacement_um) for run in made) for made in (runs, put()))
    assert rung_um > 1.5 * alone_um  # thresholds spread over what the operator does alone
    assert found.found.state.setting.model.stroke_um == pytest.approx(alone_um, rel=0.1)
    wrong = Hypothesis((Acting(resonance, {"f0_hz": 39.0, "damping": 0.007}),))
    state = Linearised(found.plain.state.setting, wrong, found.plain.state.found)
    again = choice._late_first(found.plain, choice.Judged(state, state.held_out()), [delay, resonance], False)
    assert [one.effect.name for one in again.hypothesis.acting] == list(behind)
    for one in again.hypothesis.acting:
        assert dict(one.values) == pytest.approx(behind[one.effect.name], rel=0.1)


@pytest.mark.parametrize("column", ["slope", "rate", "piece", "time_constant_s", "f0_hz"])
def test_columns_are_what_a_resonance_makes_of_a_change(column: str) -> None:
    """It rings ten times as much as what moves it. So does all that stands ahead of it, the operator's unknowns too."""
    rated = column == "rate"  # without a saturation
    plain = fitted().choice.plain.state
    setting = replace(plain.setting, corners_um=plain.setting.corners_um[:0]) if rated else plain.setting
    found = replace(plain.found, pieces=plain.found.pieces[:len(setting.corners_um)])

    def at(slope: float = 0.0, rate: float = 0.0, piece: float = 0.0, time_constant_s: float = 0.0, f0_hz: float = 0.0
           ) -> Linearised:
        late = Acting(CATALOGUE["lag"](), {"time_constant_s": 0.002 + time_constant_s})
        ringing = Acting(CATALOGUE["resonance"](), {"f0_hz": 60.0 + f0_hz, "damping": 0.02})
        unknowns = replace(found, rest=found.rest + slope * (np.arange(len(found.rest)) == 2),
                           change=found.change + rate * (np.arange(len(found.change)) == 2),
                           pieces=found.pieces + piece * (np.arange(len(found.pieces)) == 1))
        return Linearised(setting, Hypothesis((late, ringing), rated), unknowns)

    def left(state: Linearised, rows: np.ndarray, step: float = 0.0) -> np.ndarray:
        """The residual of this state's unknowns, by these columns; `step` of the parameter."""
        weights = np.zeros(rows.shape[1])
        weights[state.linear] = np.r_[state.found.rest, state.found.change[:len(found.change) * rated],
                                      state.found.pieces]
        weights[-1] = -1.0
        weights[state.own[names.index(column) if column in names else 0]] = step
        return rows @ weights

    step = {"time_constant_s": 1e-6}.get(column, 1e-3)
    here, there = at(), at(**{column: step})
    names = [name for _, name in here.free]
    moved = 0
    for k in range(len(setting.runs)):
        before, told, after = (one - np.mean(one) for one in (
            left(here, here._rows(k, True)), left(there, here._rows(k, True), step * (column in names)),
            left(there, there._rows(k, True))))
        if np.std(after - before) > 1e-9:
            assert np.std(told - after) < 0.1 * np.std(after - before)
            moved += 1
    assert moved


def test_all_together_hold_what_only_a_resonance_uncovers() -> None:
    """Beside a delay that is as late as both, a lag leaves no less before the resonance is there."""
    behind = {"delay": {"delay_s": 0.001}, "lag": {"time_constant_s": 0.002}, "resonance": {"f0_hz": 60.0, "damping": 0.03}}
    found = fit(recorded(plain_model(), drives(COMMISSIONING), *(entry(name, **behind[name]) for name in behind))).choice
    candidates = [CATALOGUE[name]() for name in behind]
    late = Hypothesis((Acting(candidates[0], {"delay_s": 0.003}),))
    from_delay = choice.judged(found.plain.state.setting, late, found.plain.state.found)
    together = {one.effect.name: dict(one.values) for one in choice._full(from_delay, candidates).hypothesis.acting}
    assert set(together) == set(behind)
    for name in behind:
        assert together[name] == pytest.approx(behind[name], rel=0.1)


def test_what_comes_in_ahead_of_a_resonance() -> None:
    """It makes what comes out; of what is too fast to pass it no more than that comes in."""
    resonance, values, model = CATALOGUE["resonance"](), {"f0_hz": 60.0, "damping": 0.02}, plain_model()
    run = put()[0]
    t = run.sample_time_s * np.arange(4000)
    run = replace(run, columns={name: np.resize(column, 4000) for name, column in run.columns.items()})
    inside = np.clip(np.minimum(t, t[-1] - t) / 0.5, 0, 1) ** 2
    slow, fast = (inside * np.sin(2 * np.pi * f_hz * t) for f_hz in (58.0, 400.0))
    again = resonance.displacement(resonance.before(slow, run, values), run, values, model)
    assert np.std(again - slow) < 0.02 * np.std(slow)
    assert np.std(resonance.before(fast, run, values)) < np.std(fast)


def test_where_blocks_are_left_out_no_effect_moves_further_than_its_derivatives_hold(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """At its best values none moves so far; where none may move at all, all else is fitted beside them."""
    state = fitted("resonance").choice.found.state
    usual = state.held_out()
    monkeypatch.setattr(tuned, "REACH", 1e9)
    assert np.array_equal(state.held_out(), usual)
    monkeypatch.setattr(tuned, "REACH", 0.0)
    found = state.held_out()
    assert not np.array_equal(found, usual)
    residual = state.best(state.still)[2]
    for row, folds in zip(found, state.foldings):
        for fold in folds:
            weights = state.solve(state.still[~fold], state.linear, False, state.target, residual)
            assert row[fold] == pytest.approx(np.einsum("i,bij,j->b", weights, state.still[fold], weights))


def test_dead_zones_without_meaning_are_left_out() -> None:
    """By itself the operator puts them below zero; the fit goes on without them, and says so."""
    ringing = entry("resonance", f0_hz=60.0, damping=0.01), entry("lag", time_constant_s=0.002)
    found = fit(recorded(plain_model(), drives(COMMISSIONING), *ringing), Options(effects="none"))
    assert len(found.model.deadzones_um) < 3
    assert any("of 2 dead zones are fitted" in text for text in found.warnings)


def test_finds_nothing_where_nothing_is() -> None:
    for law in (0.0, 1.0):
        found = fitted(law=law)
        assert found.choice.kept == () and found.model.effects == [] and found.model.rate.filter_s == 0
        assert found.model.operator_alone is None
        kept = found.model.slope_rate_s_per_um.any()
        assert kept or not law
        told = "with a rate law" if kept else "no rate law"
        assert f"around the operator: nothing, {told}" in lines(found.choice, found.model)[0]


def test_what_is_not_certain_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it, and with the command that takes it."""
    for there in ((), ("delay", "creep")):
        assert not any("may stand around" in remark for remark in fitted(*there).warnings)
    monkeypatch.setattr(choice.Judged, "beats", lambda *_: False)
    found = fit(put("delay", "creep"))
    (remark,) = (remark for remark in found.warnings if "may stand around" in remark)
    names = remark.partition(" may stand around the operator as well")[0].split(" and ")
    assert not found.model.effects and {"delay", "creep"} <= set(names)
    assert remark.endswith(f"take them with --effects {','.join(names)}")


def test_a_delay_and_a_rate_law_are_told_apart() -> None:
    """On an actuator that is not the model's own code, with a law by which W_0 reaches zero at 2900 um/s."""
    delay_s = 0.0007
    runs = moving_runs("displacement", 0.004)
    late = []
    for run in runs:
        time_s = np.arange(len(run)) * run.sample_time_s
        late.append(changed(run, displacement_um=np.interp(time_s - delay_s, time_s, run.displacement_um)))
    alone, both = fit(runs), fit(late)
    assert alone.choice.kept == ()
    (delay,) = both.choice.kept
    assert delay.acting.effect.name == "delay" and delay.acting.values["delay_s"] == pytest.approx(delay_s, rel=0.05)
    before, after = alone.model.slope_rate_s_per_um, both.model.slope_rate_s_per_um
    assert np.linalg.norm(after - before) < 0.1 * np.linalg.norm(before)


def test_a_rate_law_that_acts_late_gets_a_low_pass() -> None:
    """Without it, other effects would stand in for it; the model without one is worse."""
    model = plain_model(1.0)
    runs = recorded(replace(model, rate=replace(model.rate, filter_s=0.02)), drives(COMMISSIONING))
    found, without = fit(runs), fit(runs, Options(rate_filter_s=0.0))
    assert 0.01 < found.model.rate.filter_s < 0.04 and found.choice.kept == ()
    assert any("behind a low-pass" in line for line in summary.lines(found))
    assert found.choice.found.rms_um < 0.7 * without.choice.found.rms_um and without.model.rate.filter_s == 0
    assert fit(runs, Options(rate_independent=True)).model.rate.filter_s == 0


def test_what_is_told() -> None:
    found = fitted(*TOGETHER)
    document = found.document("model.json", False)
    assert [one.name for one in document.effects] == list(TOGETHER)
    for one, kept in zip(document.effects, found.choice.kept):
        assert one.held_out_rms_um.before > one.held_out_rms_um.after > 0
        assert one.shrink == pytest.approx(1 - one.held_out_rms_um.after / one.held_out_rms_um.before)
        for name, (low, high) in kept.ci95.items():
            assert low < kept.acting.values[name] < high
            assert one.parameters[name].ci95 == (low, high)
    assert [item["origin"] for item in found.model.effects] == ["fit"] * len(TOGETHER)
    told = "\n".join(lines(found.choice, found.model))
    assert "around the operator: delay, lag, resonance" in told
    assert all(f"{name}: " in told for name in TOGETHER)


def test_slopes_of_bands_are_those_of_the_operator() -> None:
    """Of the recordings as they are, a lag would make them fall with the rate."""
    found = fitted("lag")
    again = rate_slopes(found.model, put("lag"))
    assert again.rate_um_per_s == pytest.approx(found.rate_slopes.rate_um_per_s, rel=0.1)
    assert again.slopes == pytest.approx(found.rate_slopes.slopes, abs=0.05, nan_ok=True)
    as_they_are = rate_slopes(replace(found.model, effects=[]), put("lag"))
    assert np.nanmax(np.abs(as_they_are.slopes - again.slopes)) > 0.2


def test_effects_by_name() -> None:
    """Exactly these, and none."""
    forced = fitted("delay", effects="lag,creep,relaxation,resonance,input_curve")
    assert {one.acting.effect.name for one in forced.choice.kept} == set(PUT) - {"delay"}
    (warned,) = (text for text in fitted("input_curve", effects="creep").warnings if "operator alone" in text)
    assert warned.startswith("with creep ") and not any("operator alone" in text for text in forced.warnings)
    none = fitted("delay", effects="none")
    assert none.choice is None and none.model.effects == []


def test_names_in_any_order_are_the_same_model() -> None:
    orders = "delay,lag,resonance", "resonance,lag,delay"
    found = [fitted("delay", "lag", effects=order).model for order in orders]
    assert found[0].to_json() == found[1].to_json()


def test_what_is_not_there_does_no_harm_where_it_is_asked_for() -> None:
    """A resonance may start far from anything that helps."""
    alone, beside = (fitted("delay", "lag", effects=names) for names in ("delay,lag", "delay,lag,resonance"))
    assert beside.scores[0].score.rms_um < 1.05 * alone.scores[0].score.rms_um


def test_plays_begin_where_a_sweep_through_the_input_curve_ended() -> None:
    model = replace(plain_model(), memory=replace(plain_model().memory, sweep_share=0.5))
    run = drives()[0]
    setting = Setting([run], [model.swept(float(model.x_of(run.command_V[0])))], [0], model, np.zeros(0),
                      [np.zeros(len(run))], 1.0)
    bent_V = run.command_V + 5.0
    begun = setting.all_plays(0, bent_V)[0]
    swept = model.swept(float(model.x_of(bent_V[0])))
    assert np.cumsum(begun[::-1])[::-1] == pytest.approx(swept) and np.ptp(swept) > 0.2


@pytest.mark.parametrize("effects, words", [
    ("delay,delay", "named twice"), ("auto,delay", "stands alone"), ("sloth", "no effect 'sloth'"),
    ("", "no effect ''"),
    ("gain_change", "none that `rdpi fit` identifies"), ((), "names no effect"), (3, "effects")])
def test_names_that_are_refused(effects: object, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        fit([static_run()], Options(effects=effects))


def test_recordings_that_cannot_show_what_is_asked_for() -> None:
    one_rate = static_run(stack())
    with pytest.raises(BadInput, match="static.csv: cannot show relaxation: all strokes have about the same rate"):
        fit([replace(one_rate, path="static.csv")], Options(effects="relaxation"))
    with pytest.raises(BadInput, match="cannot show input_curve: all strokes have about the same size"):
        fit([one_rate], Options(effects="input_curve"))
    short = put()[0]
    short = replace(short, columns={name: values[:900] for name, values in short.columns.items()})
    with pytest.raises(BadInput, match="cannot show creep: too short or too slow"):
        fit([short], Options(effects="creep"))


def test_a_drive_that_repeats_is_not_met_at_the_same_places_always() -> None:
    """Of 300 000 samples a part counts: at even steps, 25 of them, a sine of 40 Hz would be seen at ten places."""
    command = np.tile(50 + 45 * np.sin(2 * np.pi * np.arange(2500) / 250), 12)
    slow = np.tile(50 + 45 * np.sin(2 * np.pi * np.arange(25000) / 25000), 6)
    run = changed(drives()[0], command_V=np.r_[command, slow], time_s=np.arange(len(command) + len(slow)) / 1e4)
    rows = Setting([run], [None], [0], plain_model(), np.zeros(0), [np.zeros(len(run))], 1.0).rows[0]
    assert len(rows) < len(run) / 10 and np.all(np.diff(rows) > 0)
    assert len(np.unique(rows[rows < len(command)] % 250)) > 125


def test_a_delay_that_hides_a_lag_is_parted() -> None:
    """To first order both are the same, so that a lag from zero on helps nothing beside a delay for both."""
    runs = recorded(plain_model(), drives(COMMISSIONING), entry("delay", delay_s=0.0025), entry("lag", time_constant_s=0.002))
    plain, (delay, lag) = fit(runs, Options(effects="delay")).choice.plain, (CATALOGUE[name]() for name in ("delay", "lag"))
    late = choice.judged(plain.state.setting, Hypothesis((Acting(delay, {"delay_s": 0.004}),)), plain.state.found)
    assert choice._to_first_order(late.state, [lag])["lag"][0] > 0.9 * late.left
    both = choice._joined(late, [delay, lag], False)
    assert both is not None and both.left < 0.1 * late.left
    assert [next(iter(one.values.values())) for one in both.hypothesis.acting] == pytest.approx([0.0025, 0.002], abs=0.0002)


@pytest.mark.parametrize("parted", [True, pytest.param(False, marks=pytest.mark.long)])
def test_the_interval_of_one_that_may_hide_another_holds_both(parted: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not parted:  # then it holds nothing but the sum
        monkeypatch.setattr(choice, "_all_parted", lambda hypothesis, absent: [])
    runs = recorded(plain_model(), drives(COMMISSIONING), entry("delay", delay_s=0.0002),
                    entry("lag", time_constant_s=0.0002))
    [one] = fit(runs).choice.kept  # in samples of 1 ms
    low, high = one.ci95[one.acting.effect.late_by]
    assert one.acting.effect.late_by and low < 0.0004 < high
    assert (low < 0.0002) == parted


def test_nothing_is_fitted_twice_from_the_same_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pruning, exchanging and comparing all ask what is left without each effect."""
    asked, judged = [], choice.judged

    def watched(*place: Any) -> choice.Judged:
        asked.append(place)
        return judged(*place)

    monkeypatch.setattr(choice, "judged", watched)
    fit(put("delay", "lag", "creep"))
    assert len(asked) > 10
    for k, (setting, hypothesis, found) in enumerate(asked):
        assert not any(setting is other and found is there and hypothesis == again
                       for other, again, there in asked[:k])


def test_thinned_recordings_choose_and_whole_ones_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, chosen_on = fitted("delay", "lag", "resonance").choice, []

    def watched(setting: Setting, *arguments: Any) -> Choice:
        chosen_on.append(len(setting.runs[0]))
        return choose(setting, *arguments)

    monkeypatch.setattr(around, "choose", watched)
    monkeypatch.setattr(tuned, "CHOICE_HZ", 0.4 * RATE_HZ)
    fit(put("delay"))
    monkeypatch.setattr(tuned, "CHOICE_STROKE", 2.0)
    found, samples = fit(put("delay", "lag", "resonance")).choice, len(put("delay")[0])
    assert chosen_on == [samples, pytest.approx(samples / 2, abs=1)], "fast strokes need all of them"
    assert len(found.plain.state.predicted_um[0]) == len(found.kept[0].without.state.predicted_um[0]) == samples
    assert [len(one) for one in found.found.state.predicted_um] == [len(run) for run in put("delay")]
    assert len(found.kept) == len(whole.kept)
    for one, other in zip(found.kept, whole.kept):
        assert one.acting.effect.name == other.acting.effect.name
        assert one.acting.values == pytest.approx(other.acting.values, rel=0.02)
        assert all(low < one.acting.values[name] < high for name, (low, high) in one.ci95.items())


def test_what_does_nothing_in_whole_recordings_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """They come early: a delay that thinned ones showed is none here. The creep beside it stays."""
    plain = fitted("creep").choice.plain
    early = [replace(run, columns={**run.columns, "displacement_um": np.r_[run.displacement_um[1:],
                                                                           run.displacement_um[-1]]})
             for run in put("creep")]
    thinned, whole = plain.state.setting, replace(plain.state.setting, runs=early)
    delay, creep = CATALOGUE["delay"](), CATALOGUE["creep"]()
    both = choice.judged(thinned, Hypothesis((Acting(creep, PUT["creep"]), Acting(delay, PUT["delay"]))),
                         plain.state.found)
    alone = {one.effect.name: choice.judged(thinned, Hypothesis((one,)), plain.state.found)
             for one in both.hypothesis.acting}
    kept = tuple(choice.Kept(one, {}, alone[other], ()) for one, other in
                 zip(both.hypothesis.acting, ("delay", "creep")))
    found = choice.refitted(Choice(plain, both, kept), whole)
    assert [one.acting.effect.name for one in found.kept] == ["creep"]
    assert found.found.hypothesis.acting == tuple(one.acting for one in found.kept)
    assert found.kept[0].without.hypothesis.acting == ()


def test_whole_recordings_that_miss_more_than_thinned_ones_are_no_reason_to_warn(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no effect was kept, there is none to leave out."""
    monkeypatch.setattr(tuned, "CHOICE_HZ", RATE_HZ)
    monkeypatch.setattr(tuned, "CHOICE_STROKE", 2.0)
    skipped = np.random.default_rng(3)  # thinning takes every second sample: the others are noisier
    runs = []
    for run in recorded(plain_model(), drives(COMMISSIONING[:2], replace(LIMITS, sample_rate_hz=2 * RATE_HZ))):
        z = run.displacement_um.copy()
        z[1::2] += 0.01 * skipped.standard_normal(len(z[1::2]))
        runs.append(changed(run, displacement_um=z))
    found = fit(runs)
    assert not found.choice.kept and found.choice.found is found.choice.plain
    assert not any("operator alone" in text for text in found.warnings)


def test_a_short_recording_beside_a_long_one_hides_nothing() -> None:
    long = put("lag")
    whole = replace(long[0], columns={name: np.concatenate([run.columns[name] for run in long])
                                      for name in ("command_V", "displacement_um")}
                    | {"time_s": np.arange(sum(map(len, long))) / 1000.0}, metadata={})
    short = replace(long[0], path="short.csv", digest="short", metadata={},
                    columns={name: values[300:900] for name, values in long[0].columns.items()})
    found = fit([whole, short])
    assert [one.acting.effect.name for one in found.choice.kept] == ["lag"]


def test_what_a_rate_independent_model_is_told() -> None:
    """The rate law takes part in the choice, and stays out of what is told."""
    found = fit(put("delay", law=1.0), Options(rate_independent=True))
    assert not found.model.slope_rate_s_per_um.any()
    assert "no rate law" in lines(found.choice, found.model)[0]


def test_nothing_to_find_in_exact_recordings() -> None:
    runs = [changed(run, displacement_um=0.1 * run.command_V) for run in put()]
    found = fit(runs)
    told = "\n".join(lines(found.choice, found.model))
    assert "nan" not in told


def test_the_drive_of_the_model_is_the_recorded_one() -> None:
    """And not what a lag makes of it; an inverse that compensates nothing is that of the operator alone."""
    found, alone = fitted("lag"), fitted("lag", effects="none")
    assert found.model.effects
    assert (found.model.drive.min_V, found.model.drive.max_V) == (alone.model.drive.min_V, alone.model.drive.max_V)
    reference = changed(drives()[0], reference_um=5 + 2 * np.sin(np.arange(len(drives()[0])) / 50))
    one, other = (chain.follow(model, reference, engine="f64", by=inverse_of(model, leave_out=(ALL,)))[0].drive_V
                  for model in (found.model, alone.model))
    assert one == pytest.approx(other)


def test_an_inverse_without_compensation_has_the_operator_alone() -> None:
    """What the operator can take up of effects must stay in it where none is compensated."""
    found, alone = fitted(*TOGETHER), fitted(*TOGETHER, effects="none")
    inverse = found.model.uncompensated()
    assert inverse.effects == []
    for name in ("offset_um", "slopes", "slope_rate_s_per_um", "deadzones_um", "deadzone_weights"):
        assert getattr(inverse, name) == pytest.approx(getattr(alone.model, name))
    assert inverse.rate.max_um_per_s == alone.model.rate.max_um_per_s
    assert alone.model.uncompensated() is alone.model
    broken = replace(found.model, operator_alone={**found.model.operator_alone, "slopes": [1.0]})
    with pytest.raises(BadInput, match="operator_alone: slopes: has 1 values"):
        broken.uncompensated()


# --- a recording beside which the others show little -----------------------------------------------------------------

WIDE, LITTLE = (("multisine", {"duration_s": length_s, "seed": seed}, share) for length_s, seed, share in
                ((8.0, 3, 1.0), (6.0, 4, 0.06)))
LATE_AND_CREEPING = entry("lag", "amplifier", time_constant_s=1e-3), entry("creep", percent_per_decade=2.0)


def uneven(*canned: tuple) -> list[Recording]:
    """Of a late, creeping actuator that no plays describe quite."""
    return [changed(run, displacement_um=run.displacement_um + 0.02 * np.sin(3 * run.displacement_um))
            for run in recorded(plain_model(), drives(canned), *LATE_AND_CREEPING)]


def test_small_movements_beside_large_ones_take_nothing_from_the_model() -> None:
    """What is fitted to the small ones only says nothing about the large ones, so that these are left out in parts."""
    alone, both = fit(uneven(WIDE)), fit(uneven(WIDE, LITTLE))
    assert [one["name"] for one in both.model.effects] == [one["name"] for one in alone.model.effects] == ["lag", "creep"]
    assert both.scores[0].score.rms_um < 1.1 * alone.scores[0].score.rms_um
    large, little = both.model.passport["runs"]
    assert large["held_out"] == little["held_out"] == LEFT_OUT
    assert large["rms_um"] < 1.3 * both.scores[0].score.rms_um and little["rms_um"] < large["rms_um"]


def test_a_recording_of_one_rate_judges_no_others() -> None:
    """What is fitted to it alone says nothing about other rates, so that the others are left out in parts."""
    (wide,) = drives((WIDE,))
    phase = np.arange(8000) / RATE_HZ * 3.0 % 1
    triangle = replace(wide, columns={"time_s": np.arange(8000) / RATE_HZ, "command_V": 100 * (1 - np.abs(2 * phase - 1))})
    assert all(covered([wide, triangle]))
    for runs, whole in (([wide, wide], True), ([wide, triangle], False), ([wide, wide, triangle], True),
                        ([triangle, triangle], True)):
        assert Setting.others_cover.func(SimpleNamespace(runs=runs)) == whole


def test_what_creeps_on_from_before_a_recording_takes_nothing_from_its_creep() -> None:
    """Before recordings of unknown past the actuator rested at the other end of its range."""
    runs = []
    for slow_hz in (0.5, 1.0):
        drive, = drives((("sawtooth", {"frequencies_hz": (slow_hz, 10 * slow_hz), "cycles": 4}, 1.0),))
        before_V = np.r_[np.full(20_000, 100.0), np.linspace(100.0, drive.command_V[0], 20)]
        whole = recording(np.r_[before_V, drive.command_V], None, RATE_HZ)
        run, = recorded(plain_model(), [whole], entry("creep", **PUT["creep"]))
        runs.append(replace(run, path=f"{slow_hz}.csv", digest=f"{slow_hz}", metadata={"memory": "unknown"},
                            columns={name: column[len(before_V):] for name, column in run.columns.items()}))
    creep = next(one for one in fit(runs).choice.kept if one.acting.effect.name == "creep")
    put_in = PUT["creep"]["percent_per_decade"]
    assert creep.acting.values["percent_per_decade"] == pytest.approx(put_in, rel=0.05)
    low, high = creep.ci95["percent_per_decade"]
    assert low < put_in < high < low + 0.5 * put_in


def test_a_recording_is_covered_by_others_that_move_where_it_does() -> None:
    wide, little = drives((WIDE, LITTLE))
    assert covered([wide]) == [False] and covered([wide, wide]) == [True, True]
    assert covered([wide, little]) == [False, True] and covered([little, wide, wide]) == [True, True, True]
    low, high = (changed(wide, command_V=place + wide.command_V / 2) for place in (0.0, 50.0))
    assert covered([low, high]) == [False, False] and covered([low, high, wide]) == [True, True, True]
