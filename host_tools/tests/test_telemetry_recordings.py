"""Recordings from telemetry: scale, stretches, memory, gaps, and what is noted about them."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
import streams
from captures import decode
from streams import HELD, SWEEP, Info, Sample, samples, stream

from rdpi.board import telemetry
from rdpi.board.telemetry import stretches


def test_a_recording_of_it() -> None:
    sent = samples(50)
    (stretch,) = stretches(decode(stream(sent)))
    columns, metadata, _ = stretch
    assert list(columns) == ["time_s", "command_V", "displacement_um", "reference_um", "dac_code", "flags"]
    assert columns["time_s"].tolist() == [round(k / 10_000, 9) for k in range(50)]
    np.testing.assert_allclose(columns["command_V"], [-20 + 140 * s.dac_code / 65535 for s in sent], rtol=0, atol=1e-12)
    np.testing.assert_allclose(columns["displacement_um"], [0.5 + 0.001 * s.adc_counts for s in sent], atol=1e-12)
    assert columns["reference_um"].tolist() == [s.reference for s in sent]
    assert columns["dac_code"].tolist() == [s.dac_code for s in sent]
    assert (metadata["sample_rate_hz"], metadata["memory"], metadata["first_tick"]) == (10_000, "unknown", 1)
    assert metadata["telemetry_lost"] == 0


def test_another_scale_of_the_sensor() -> None:
    sent = samples(50)
    (stretch,) = stretches(decode(stream(sent)), um_per_count=0.01, count_0_um=-1.0)
    np.testing.assert_allclose(stretch.columns["displacement_um"], [-1 + 0.01 * s.adc_counts for s in sent], atol=1e-12)


def test_references_in_fixed_point() -> None:
    info = Info(numbers=streams.INT32, um_per_reference=1e-8, reference_0_um=5.0, um_per_s_per_rate=0.5)
    integers = [k * 10**8 for k in range(-10, 10)]
    frames = [Sample(k, k + 1, number, 3, 9).frame("ii") for k, number in enumerate(integers)]
    decoder = decode(info.frame() + b"".join(frames))
    (stretch,) = stretches(decoder)
    np.testing.assert_allclose(stretch.columns["reference_um"], [5 + number * 1e-8 for number in integers], atol=1e-12)
    assert set(telemetry.rates_um_per_s(decoder.runs[0].info, decoder.runs[0].samples)) == {1.5}


def test_every_unbroken_stretch_of_sixteen() -> None:
    sent = samples(400)
    gaps = {100, 150, 160, 176, 390}  # leaves 100, 49, 9, 15, 213 and 9
    found = stretches(decode(stream([sample for sample in sent if sample.sequence not in gaps])))
    assert [(s.metadata["first_tick"], len(s.columns["time_s"])) for s in found] == [(1, 100), (102, 49), (178, 213)]
    for stretch in found:
        first = stretch.metadata["first_tick"] - 1
        assert stretch.columns["dac_code"].tolist() == [
            s.dac_code for s in sent[first:first + len(stretch.columns["time_s"])]]
        assert stretch.columns["time_s"][0] == 0


def test_a_tick_that_the_target_lost_is_a_gap() -> None:
    late = [replace(sample, tick=sample.tick + 1) for sample in samples(100)[40:]]
    assert [len(s.columns["time_s"]) for s in stretches(decode(stream(samples(100)[:40] + late)))] == [40, 60]


def swept(sweep: int, count: int, code: int = 30_000) -> list[Sample]:
    """A run that begins with a sweep which ends at 30000."""
    return [replace(sample, flags=SWEEP, dac_code=30_000) if k < sweep else
            replace(sample, dac_code=code) if k == sweep else sample for k, sample in enumerate(samples(count))]


def test_after_the_sweep_the_memory_is_reset() -> None:
    sent = swept(30, 100)
    (stretch,) = stretches(decode(stream(sent)))
    assert (stretch.metadata["memory"], stretch.metadata["first_tick"]) == ("reset", 31)
    assert (stretch.samples, stretch.why_unknown) == (70, "")


NOT_WHOLE, ELSEWHERE = "the start-up sweep was not received whole to its end", "it does not begin at the sweep's end"


@pytest.mark.parametrize("sent, why", [
    pytest.param(swept(30, 100)[:10] + swept(30, 100)[11:], NOT_WHOLE, id="a gap in the sweep"),
    pytest.param(swept(30, 100)[1:], NOT_WHOLE, id="its first sample lost"),
    pytest.param(swept(30, 100)[:29] + swept(30, 100)[30:], NOT_WHOLE, id="its last sample lost"),
    pytest.param(swept(30, 100)[:30] + swept(30, 100)[31:], NOT_WHOLE, id="a gap behind it"),
    pytest.param(swept(30, 100)[:60] + swept(30, 100)[61:], ELSEWHERE, id="a gap later"),
    pytest.param(swept(30, 100, 31_000), "the drive jumps at the sweep's end", id="a jump behind it"),
    pytest.param([replace(sample, flags=HELD) if sample.tick == 31 else sample for sample in swept(30, 100)],
                 "the DAC did not take the code at the sweep's end", id="no code behind it"),
    pytest.param(samples(100), "", id="no sweep"),
])
def test_else_it_is_unknown(sent: list[Sample], why: str) -> None:
    stretch = stretches(decode(stream(sent)))[-1]
    assert (stretch.metadata["memory"], stretch.why_unknown) == ("unknown", why)


@pytest.mark.parametrize("low, high, memory", [
    (0, 60_000, "reset"), (0, 55_000, "reset"), (0, 54_000, "unknown"), (10_000, 45_000, "unknown"),
])
def test_a_sweep_that_ends_off_its_middle_leaves_the_memory_unknown(low: int, high: int, memory: str) -> None:
    sent = swept(30, 100)  # ends at 30000
    sent[3], sent[4] = (replace(sent[k], dac_code=code) for k, code in ((3, high), (4, low)))
    (stretch,) = stretches(decode(stream(sent)))
    assert stretch.metadata["memory"] == memory
    assert stretch.why_unknown == ("" if memory == "reset" else "the sweep ends off the middle")


def test_a_drive_is_recorded_from_where_its_sweep_ended() -> None:
    (stretch,) = stretches(decode(stream(swept(30, 100, 60_000), Info(numbers=streams.NONE))))
    assert (stretch.metadata["memory"], stretch.metadata["first_tick"]) == ("reset", 30)
    assert "reference_um" not in stretch.columns and stretch.columns["dac_code"][0] == 30_000


def test_a_sweep_alone_is_no_recording() -> None:
    assert stretches(decode(stream(samples(100, flags=SWEEP)))) == []


def test_without_readings_no_displacement() -> None:
    decoder = decode(stream(samples(100, adc_counts=streams.NO_READING)))
    (stretch,) = stretches(decoder)
    assert "displacement_um" not in stretch.columns
    assert any("no displacement_um" in note for note in telemetry.notes(decoder, [stretch], [stretch]))


def test_a_sample_without_reading_among_others_is_a_gap() -> None:
    sent = samples(100)
    sent[40] = replace(sent[40], adc_counts=streams.NO_READING)
    found = stretches(decode(stream(sent)))
    assert [len(s.columns["displacement_um"]) for s in found] == [40, 59]


def test_a_reference_that_is_none_leaves_the_column_out() -> None:
    sent = samples(100)
    sent[40] = replace(sent[40], reference=float("nan"))
    sent[50] = replace(sent[50], reference=float("inf"))
    decoder = decode(stream(sent))
    (stretch,) = stretches(decoder)
    assert "reference_um" not in stretch.columns and stretch.samples == 100
    assert stretch.metadata["without_reference"] == 2
    assert telemetry.notes(decoder, [stretch], [stretch]) == ["no reference_um: 2 samples had no reference"]


def test_where_the_dac_held_its_code_the_command_is_that_one() -> None:
    sent = samples(100)
    for k in (0, 1, 50, 51):
        sent[k] = replace(sent[k], flags=HELD)
    (stretch,) = stretches(decode(stream(sent)))
    assert (stretch.metadata["first_tick"], stretch.why_unknown) == (3, "")
    expected = [s.dac_code for s in sent[2:]]
    assert stretch.columns["dac_code"].tolist() == expected
    expected[48] = expected[49] = expected[47]
    np.testing.assert_allclose(stretch.columns["command_V"], -20 + 140 * np.array(expected) / 65535, atol=1e-12)


def test_a_code_that_the_dac_cannot_have_is_a_gap() -> None:
    sent = samples(100)
    sent[40] = replace(sent[40], dac_code=65_536)
    assert [len(s.columns["time_s"]) for s in stretches(decode(stream(sent)))] == [40, 59]


def test_notes() -> None:
    sent = samples(300)
    data = stream([*sent[:100], *sent[101:200], sent[210]], Info(counts=(5, *[0] * 8)), finished=0)
    decoder = decode(data + stream(sent, finished=0) + b"noise\0")
    found = stretches(decoder)
    text = "\n".join(telemetry.notes(decoder, found, found))
    assert "started anew 1 times" in text
    assert "1 samples are not used" in text and "1 corrupt frames came after the last sample" in text
    assert struct.calcsize("<BBBbIBB7d10I") == telemetry.INFO_BODY.size == 106


@pytest.mark.parametrize("start_heard, first", [(True, 41), (False, 41), (False, 1)])
def test_a_target_that_was_running_already_is_told(start_heard: bool, first: int) -> None:
    data = stream(samples(100)[first - 1:])
    decoder = decode(data if start_heard else data[len(Info().frame()):])
    found = stretches(decoder)
    told = [f"the target was running already: samples before tick {first} were not received"]
    assert telemetry.notes(decoder, found, found) == (told if first > 1 and not start_heard else [])


def test_infos_that_disagree_are_told() -> None:
    decoder = decode(stream(samples(2500)) + Info(streams.FINISHED, offered=2500, max_V=5.0).frame())
    found = stretches(decoder)
    assert telemetry.notes(decoder, found, found) == [
        "5 infos of one run tell 2 different rates or scales; those of most are used"]
    assert found[0].columns["command_V"].max() > 5


@pytest.mark.parametrize("cycles, cycles_per_s, told", [
    (0, 0, "the target itself counts 7 ticks lost"),
    (20_000, 0, "the target itself counts 7 ticks lost; its longest tick took 20000 cycles"),
    (20_000, 160_000_000, "the target itself counts 7 ticks lost; its longest tick took 20000 cycles, 0.000125 s, of a "
                          "period of 0.0001 s"),
])
def test_ticks_lost_are_told_with_the_longest(cycles: int, cycles_per_s: int, told: str) -> None:
    decoder = decode(stream(samples(100), Info(counts=(0, 7, *[0] * 5, cycles, cycles_per_s))))
    found = stretches(decoder)
    assert telemetry.notes(decoder, found, found) == [told]


def test_codes_that_the_dac_did_not_take_are_told() -> None:
    decoder = decode(stream(samples(100), Info(counts=(*[0] * 6, 5, 0, 0))))
    found = stretches(decoder)
    (note,) = telemetry.notes(decoder, found, found)
    assert note.startswith("the DAC did not take 5 codes; ") and note.endswith("match the board's DAC?")


@pytest.mark.parametrize("first, told", [(50, True), (21, True), (20, False)])
def test_a_longest_stretch_much_shorter_than_what_was_received_is_told(first: int, told: bool) -> None:
    sent = [sample for sample in swept(30, 131) if sample.sequence != 30 + first]  # 100 after the sweep
    decoder = decode(stream(sent))
    found = stretches(decoder)
    assert [stretch.samples for stretch in found] == [first, 100 - first]
    assert bool(telemetry.notes(decoder, found, [found[first < 50]])) == told
    assert telemetry.notes(decoder, found, found) == []
