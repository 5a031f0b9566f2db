"""A habit's recordings are what the habit says, and what the score is asked of is the truth."""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import score_habits  # noqa: E402
from habits import CHAIN, HABITS, Habitual, Take, make_set  # noqa: E402
from rigs import FAMILIES, SEALED  # noqa: E402

FAMILY = "maxwell-slip"  # one that is quick to play
SEEDS = range(1, 4)


@cache
def known(habit: str, seed: int) -> Habitual:
    return make_set(habit, FAMILY, seed)


def share(one: Habitual, take: Take, past: bool = False) -> np.ndarray:
    """The drive as a share of the range, from the first recorded sample on, or from the sweep on."""
    return ((take.played_V if past else take.command_V) - one.rig.low_V) / (one.rig.high_V - one.rig.low_V)


def each(habit: str) -> list[tuple[Habitual, Take]]:
    return [(one, take) for one in (known(habit, seed) for seed in SEEDS) for take in one.fitted]


def rest_s(take: Take) -> float:
    """How long the drive rested before it moved for the first time in the recording."""
    moves = np.flatnonzero(np.diff(take.played_V[take.before - 1:]))[0] + take.before - 1
    still = np.flatnonzero(np.diff(take.played_V[:moves + 1]))
    return (moves - (still[-1] + 1 if len(still) else 0)) / take.rate_hz


def peaks(values: np.ndarray) -> np.ndarray:
    """Sizes of the tops of a drive; a top that lasts counts once."""
    values = values[np.append(True, np.diff(values) != 0)]
    inner = values[1:-1]
    return inner[(inner > values[:-2]) & (inner > values[2:])]


# --- all habits ------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("habit", HABITS)
def test_set_has_two_to_four_recordings_of_unknown_memory_and_one_unseen_after_a_sweep(habit):
    for seed in SEEDS:
        one = known(habit, seed)
        assert 2 <= len(one.fitted) <= 4 and {take.memory for take in one.fitted} == {"unknown"}
        assert [take.memory for take in one.unseen] == ["unknown", "unknown", "reset"]
        assert len({take.name for take in (*one.fitted, *one.unseen)}) == len(one.fitted) + 3


@pytest.mark.parametrize("habit", HABITS)
def test_past_is_played_from_zero_volts_without_a_jump(habit):
    for one, take in each(habit):
        assert take.played_V[0] == pytest.approx(0, abs=1e-3 * (one.rig.high_V - one.rig.low_V))
        assert take.before > 0.2 * take.rate_hz
        if habit != "steps":  # where jumps are what is recorded
            assert np.max(np.abs(np.diff(share(one, take, past=True)))) < 0.2


@pytest.mark.parametrize("habit", HABITS)
def test_truth_differs_from_reading_by_noise_and_offset_only(habit):
    for seed in SEEDS[:2]:
        one = known(habit, seed)
        for take in (*one.fitted, *one.unseen):
            apart = (take.reading_um - take.true_um) / one.rig.stroke_um
            assert 3e-5 < np.std(apart) < 1.2e-3
            assert abs(np.mean(apart)) < (0.26 if habit == "days" else 1e-3)


@pytest.mark.parametrize("habit", HABITS)
def test_unseen_drives_are_no_larger_than_recorded_ones(habit):
    for seed in SEEDS:
        one = known(habit, seed)
        ends = [(take.command_V.min(), take.command_V.max()) for take in one.fitted]
        low, high = np.min(ends), np.max(ends)
        room = 0.06 * (one.rig.high_V - one.rig.low_V)  # small loops on ramps, and middles, differ
        assert all(take.command_V.min() > low - room and take.command_V.max() < high + room for take in one.unseen)


@pytest.mark.parametrize("habit", HABITS)
def test_sets_are_the_same_by_seed_and_differ_between_seeds(habit):
    digest = score_habits.data_digest
    assert digest(make_set(habit, FAMILY, 1)) == digest(known(habit, 1)) != digest(known(habit, 2))


def test_rigs_lack_some_of_what_comes_late_and_have_some():
    had = [set(known(habit, seed).rig.sins) & set(CHAIN) for habit in HABITS for seed in SEEDS]
    for name in CHAIN:
        assert 0.3 < np.mean([name in one for one in had]) < 0.9


@pytest.mark.parametrize("family", [*FAMILIES, *SEALED])
def test_every_family_can_be_recorded(family):
    assert np.ptp(make_set("bipolar", family, 1).fitted[0].true_um) > 1


# --- each habit ------------------------------------------------------------------------------------------------------

def test_triggered_begins_within_a_running_sine():
    for one, take in each("triggered"):
        speed = np.abs(np.diff(share(one, take)))
        assert speed[0] > 0.5 * speed.max()
        ran = share(one, take, past=True)[:take.before]
        assert len(peaks(ran)) >= 5 and peaks(ran)[-1] == pytest.approx(share(one, take).max(), abs=0.01)


@pytest.mark.parametrize("habit", ["edge", "middle"])
def test_growing_drives_begin_at_rest_and_grow(habit):
    for one, take in each(habit):
        drive = share(one, take)
        tops = peaks(np.abs(drive - drive[0]))
        tops = tops[tops > 0.02]
        assert len(tops) >= 4 and tops[-1] > 1.4 * tops[0] and np.all(np.diff(tops) > -0.02)
        assert 0.5 <= rest_s(take) < 3.5
        if habit == "edge":
            assert drive[0] in (pytest.approx(0, abs=1e-6), pytest.approx(1, abs=1e-6))
        else:
            assert 0.4 < drive[0] < 0.6 and drive.min() < drive[0] - 0.15 and drive.max() > drive[0] + 0.15


def test_some_show_their_rest_before_they_grow_and_some_do_not():
    takes = [take for _, take in each("edge") + each("middle")]
    shown = {bool(np.ptp(take.command_V[:round(0.2 * take.rate_hz)]) < 1e-9) for take in takes}
    assert shown == {False, True}


def test_ramps_are_slow_and_hold_small_loops():
    beginnings = set()
    for one, take in each("ramps"):
        drive = share(one, take)
        tops = peaks(drive)
        assert len(tops) >= 5 and np.ptp(drive) > 0.45
        assert len(drive) / take.rate_hz > 0.5
        beginnings.add(rest_s(take) >= 0.5)
    assert beginnings == {False, True}


def test_steps_hold_levels():
    for one, take in each("steps"):
        still = np.diff(share(one, take)) == 0
        assert np.mean(still) > 0.85
        levels = np.unique(np.round(share(one, take)[1:][still], 6))
        assert 5 <= len(levels) <= 12
        assert take.command_V[0] == take.played_V[take.before - 1]


def test_bipolar_goes_to_both_sides_of_zero_volts_from_rest_there():
    for one, take in each("bipolar"):
        assert one.rig.low_V == -one.rig.high_V
        assert abs(take.command_V[0]) < 1e-3 * one.rig.high_V
        assert take.command_V.max() == pytest.approx(-take.command_V.min(), rel=0.05)
        assert rest_s(take) >= 0.5


def test_days_have_offsets_of_their_own():
    for seed in SEEDS:
        one = known("days", seed)
        offsets = [np.mean(take.reading_um - take.true_um) / one.rig.stroke_um for take in (*one.fitted, *one.unseen)]
        assert np.ptp(offsets[:-1]) > 0.05 and offsets[-1] == pytest.approx(0, abs=1e-3)


# --- the score -------------------------------------------------------------------------------------------------------

def test_stated_recordings_hold_the_past_and_know_it():
    take = known("edge", 1).fitted[0]
    plain, stated = score_habits.recording(take, False), score_habits.recording(take, True)
    assert (plain.memory, stated.memory) == ("unknown", "reset")
    assert np.array_equal(stated.command_V[-len(plain):], plain.command_V)
    assert len(stated) - len(plain) == take.before


class Perfect:
    """A model that predicts the truth, from an offset of its own."""

    def __init__(self, take: Take, error_um: float) -> None:
        self.take, self.error_um = take, error_um

    def predict(self, run: object) -> np.ndarray:
        rough = self.error_um * np.where(np.arange(len(run)) % 2, 1, -1)
        return self.take.passed_um[-len(run):] + 7 + rough


@pytest.mark.parametrize("stated", [False, True])
def test_error_is_against_the_truth_beside_the_offset(stated):
    take = known("days", 1).fitted[0]
    assert score_habits.missed(Perfect(take, 0.2), take, stated, 20.0) == pytest.approx(1.0, rel=1e-3)


def test_quick_takes_every_family_and_habit():
    jobs = score_habits.quick(list(FAMILIES), list(HABITS), 1)
    assert len(jobs) == len(set(jobs)) == 24
    assert {job.family for job in jobs} == {*FAMILIES} and {job.habit for job in jobs} == {*HABITS}


def line(habit: str, variant: str, percent: float | None, **more: object) -> dict[str, object]:
    answer = {"refused": "3 Hz: too short"} if percent is None else \
        {"percent": percent, "drives": {"unseen swept": percent}, "effects": ["lag"], "seconds": 1.0}
    return {"key": habit + variant, "code": "c", "habit": habit, "family": FAMILY, "seed": 1, "variant": variant,
            "data": "d", **answer, **more}


def test_table_counts_what_is_worse_refused_and_misses_its_start():
    lines = [line("edge", "auto", 1.2), line("edge", "alone", 1.0), line("edge", "stated", 0.5),
             line("days", "auto", None), line("days", "alone", 1.0), line("days", "stated", 1.0),
             line("steps", "auto", 1.06), line("steps", "alone", 1.0), line("steps", "stated", 1.06)]
    text = score_habits.table(lines)
    row = next(row for row in text.splitlines() if row.startswith("all ")).split()
    assert row == ["all", "3", "1.13", "1.00", "0.78", "1/2", "50.0", "%", "1.70", "2.40", "1.13", *"1 / 0 / 0".split()]
    assert "edge maxwell-slip 1: 1.20 for 1.00 % (lag)" in text and "refused 1 times: 3 Hz: too short" in text


def test_compare_pairs_equal_recordings():
    before = [line("edge", "auto", 1.0), line("edge", "alone", 1.0), line("days", "auto", None),
              line("steps", "auto", 1.0)]
    after = [line("edge", "auto", 1.5), line("edge", "alone", 1.0), line("days", "auto", 0.5),
             line("steps", "auto", 9.0, data="other")]
    text = score_habits.compare(before, after)
    assert text.startswith("2 sets in both; 1 only before, 1 only after")
    assert "worse now: edge maxwell-slip 1: 1.00 -> 1.50 %" in text and "1 -> 0" in text and "9.0" not in text


def test_results_are_taken_up_where_they_were_cut_off(tmp_path, monkeypatch, capsys):
    asked = []

    def answers(job, variants):
        asked.append((job.habit, *variants))
        return [{key: value for key, value in line(job.habit, one, 1.0).items() if key not in ("key", "code")}
                for one in variants]

    monkeypatch.setattr(score_habits, "answers", answers)
    path = tmp_path / "some.jsonl"
    words = ["--families", FAMILY, "--seeds", "1", "--habits", "edge,days", "-o", str(path)]
    score_habits.main(words)
    whole = path.read_text()
    path.write_text(whole[:-20])  # the last line is no line any more
    asked.clear()
    score_habits.main(words)
    assert asked == [("days", "stated")] and len(score_habits.read_lines(path)) == 6
    asked.clear()
    score_habits.main(words)
    assert not asked
    lines = [json.loads(one) for one in whole.splitlines()]
    path.write_text("".join(json.dumps({**one, "code": "other"}) + "\n" for one in lines))
    with pytest.raises(SystemExit, match="other code"):
        score_habits.main(words)


def test_a_refusal_is_a_result():
    one = known("edge", 1)
    short = Habitual(one.habit, one.rig, (one.fitted[0].__class__("3 Hz", 1000.0, 1, *[np.zeros(40)] * 3),), one.unseen)
    assert "constant" in score_habits.answer(short, "alone")["refused"]
