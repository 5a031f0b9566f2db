"""The decoder: what was sent comes out, in pieces of any size; what was damaged does not, and is counted."""

from __future__ import annotations

import binascii
import struct
import time
from dataclasses import replace

import numpy as np
import pytest
import streams
from hypothesis import given
from hypothesis import strategies as st
from streams import HELD, SWEEP, Info, Sample, frame, samples, stream

from rdpi.board import telemetry
from rdpi.board.stretches import notes, stretches
from rdpi.board.telemetry import Counts, Decoder
from rdpi.errors import BadInput


def decode(data: bytes, size: int = 1 << 20) -> Decoder:
    decoder = Decoder("board")
    for start in range(0, len(data), size):
        decoder.feed(data[start:start + size])
    decoder.finish()
    return decoder


def received(decoder: Decoder, run: int = -1) -> list[Sample]:
    """The believed samples of a run, as they would have been sent."""
    frames = decoder.runs[run].samples
    numbers = [np.ascontiguousarray(frames[name]).view("<f4").tolist() for name in ("reference", "rate")]
    rest = [frames[name].tolist() for name in ("dac_code", "adc_counts", "flags")]
    return [Sample(*fields) for fields in zip(frames["sequence"].tolist(), frames["tick"].tolist(), *numbers, *rest)]


def wrapped(sent: list[Sample]) -> list[Sample]:
    return [replace(sample, sequence=sample.sequence % 2**16, tick=sample.tick % 2**32) for sample in sent]


def test_the_crc_is_the_one_of_the_layout() -> None:
    assert binascii.crc_hqx(b"123456789", 0xFFFF) == 0x29B1


def test_what_was_sent_comes_out() -> None:
    sent, info = samples(2500), Info(counts=tuple(range(9)))
    decoder = decode(stream(sent, info))
    assert received(decoder) == sent
    assert decoder.counts == Counts(samples=2500, infos=4)
    assert decoder.runs[0].info == telemetry.Info(
        streams.FINISHED, 0, 10_000, 16, streams.FLOAT, -20, 120, 1, 0, 1, 0.001, 0.5, 2500, *range(9))


@given(st.lists(st.integers(0, 60_000), max_size=30), st.integers(0, 3))
def test_it_does_not_matter_how_the_stream_is_cut(cuts: list[int], damage: int) -> None:
    data = bytearray(stream(samples(2000)))
    for place in np.random.default_rng(damage).integers(0, len(data), damage * 50).tolist():
        data[place] ^= 0x55
    whole, cut = decode(bytes(data)), Decoder("board")
    for start, end in zip([0, *sorted(cuts)], [*sorted(cuts), len(data)]):
        cut.feed(bytes(data[start:end]))
    cut.finish()
    assert cut.counts == whole.counts
    assert [received(cut, k) for k in range(len(cut.runs))] == [received(whole, k) for k in range(len(whole.runs))]


def test_byte_by_byte() -> None:
    data = stream(samples(40))
    assert received(decode(data, 1)) == received(decode(data)) == samples(40)


def target(seed: int, count: int = 3000) -> list[Sample]:
    """A run in which the target loses ticks, and does not send all that it takes."""
    rng = np.random.default_rng(seed)
    ticks = 1 + np.cumsum(np.where(rng.random(count) < 0.003, rng.integers(2, 30, count), 1)) - 1
    taken = [replace(sample, tick=tick) for sample, tick in zip(samples(count, seed), ticks.tolist())]
    return [sample for sample, sent in zip(taken, rng.random(count) > 0.002) if sent]


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """1 % of the bytes changed, dropped, or with one put in before."""
    line = bytearray()
    for byte, hit, kind, other in zip(data, rng.random(len(data)) < 0.01, rng.integers(0, 8, len(data)).tolist(),
                                      rng.integers(0, 256, len(data)).tolist()):
        if not hit:
            line.append(byte)
        elif kind == 0:
            line += bytes([other, byte])
        elif kind > 1:
            line.append(other)
    return bytes(line)


@pytest.mark.parametrize("seed", range(60))
def test_of_a_damaged_stream_nothing_wrong_is_accepted_and_every_loss_counted(seed: int) -> None:
    sent = target(seed)
    decoder = decode(damaged(stream(sent, finished=10), np.random.default_rng(1000 + seed)))
    got, counts = received(decoder), decoder.counts
    assert len(decoder.runs) == 1
    assert 0.5 * len(sent) < len(got) < 0.9 * len(sent), "the damage is meant to be felt"
    by_tick = {sample.tick: sample for sample in sent}
    assert all(sample == by_tick[sample.tick] for sample in got)
    # From the first sample on if the line let a STARTING through, else from the first received.
    run = decoder.runs[0]
    assert run.finished, "one of ten is meant to come through"
    first = Sample(-1, 0) if run.started else replace(got[0], sequence=got[0].sequence - 1, tick=got[0].tick - 1)
    assert counts.lost == sent[-1].sequence - first.sequence - len(got)
    assert counts.ticks_lost == got[-1].tick - first.tick - (got[-1].sequence - first.sequence)
    assert counts.samples == len(got)


@pytest.mark.slow
def test_a_million_frames_take_seconds() -> None:
    part = stream(samples(65_536), finished=0)  # the sequence wraps to the same bytes, the tick does not matter
    began = time.monotonic()
    decoder = Decoder("board")
    for _ in range(16):
        decoder.feed(part)
    assert decoder.counts.samples > 1_000_000 and decoder.counts.corrupt == 0
    assert time.monotonic() - began < 5


@pytest.mark.parametrize("first, gap, ticks_lost", [
    (65_530, 0, 0), (65_530, 3, 0), (10, 65_535, 0), (10, 65_536, 0), (10, 200_000, 17), (65_000, 1_000_000, 5),
])
def test_the_tick_tells_how_often_the_sequence_wrapped(first: int, gap: int, ticks_lost: int) -> None:
    before = [Sample(first + k, 2**32 - 50 + k) for k in range(20)]
    after = [Sample(first + 20 + gap + k, 2**32 - 30 + gap + ticks_lost + k) for k in range(40)]
    decoder = decode(b"".join(sample.frame() for sample in before + after))
    assert received(decoder) == wrapped(before + after)
    assert (decoder.counts.lost, decoder.counts.ticks_lost, decoder.counts.resets) == (gap, ticks_lost, 0)


def test_a_board_that_loses_every_other_tick_is_believed() -> None:
    sent = [Sample(k, 2 * k + 1) for k in range(100)]
    decoder = decode(b"".join(sample.frame() for sample in sent))
    assert received(decoder) == sent[1:-1], "the first and the last have one neighbour only"
    assert (decoder.counts.ticks_lost, decoder.counts.lost, decoder.counts.unconfirmed) == (97, 0, 2)


@pytest.mark.parametrize("liar", [Sample(7000, 51), Sample(50, 7000), Sample(7000, 7000), Sample(50, 49),
                                  Sample(50, 50), Sample(50, 60), Sample(50, 52), Sample(49, 50), Sample(51, 52),
                                  Sample(50, 2**32 - 1)])
def test_what_no_neighbour_confirms_is_not_believed(liar: Sample) -> None:
    sent = samples(100)
    decoder = decode(stream([*sent[:50], liar, *sent[51:]]))
    assert received(decoder) == sent[:50] + sent[51:]
    assert (decoder.counts.unconfirmed, decoder.counts.lost, decoder.counts.resets) == (1, 1, 0)


def test_a_lonely_sample_is_not_believed_at_the_end_either() -> None:
    decoder = decode(stream([*samples(50), Sample(60, 61)]))
    assert (decoder.counts.samples, decoder.counts.unconfirmed, decoder.counts.lost) == (50, 1, 11)


@pytest.mark.parametrize("last, lost_ticks", [(40, 0), (40, 7), (70_000, 3)])
def test_what_is_lost_at_the_end_is_counted_by_the_next_info(last: int, lost_ticks: int) -> None:
    sent = [Sample(last - 20 + k, last - 19 + k + lost_ticks) for k in range(20)]
    for offered in (last, last + 1, last + 70_000):
        info = Info(streams.FINISHED, offered=offered).frame()
        assert decode(b"".join(sample.frame() for sample in sent) + info * 2).counts.lost == offered - last


def test_a_run_of_which_nothing_but_start_and_end_was_heard() -> None:
    end = Info(streams.FINISHED, offered=500).frame()
    assert decode(Info(streams.STARTING).frame() + end).counts.lost == 500
    assert decode(end).counts.lost == 0, "joined when it was over"


def test_what_is_lost_at_the_start_counts_if_the_start_was_heard() -> None:
    data = stream(samples(100)[7:])
    assert decode(data).counts.lost == 7
    assert decode(data[len(Info().frame()):]).counts.lost == 0, "joined midway"


@pytest.mark.parametrize("cut", range(1, 29, 3))
def test_a_stream_may_begin_and_end_within_a_frame(cut: int) -> None:
    frames = b"".join(sample.frame() for sample in samples(100))
    decoder = decode(Info().frame() + frames[:-cut])
    assert decoder.counts == Counts(samples=99, infos=1)
    decoder = decode(frames[cut:] + Info().frame())
    assert decoder.counts == Counts(samples=99, infos=1)


def test_zeros_between_frames_do_no_harm() -> None:
    decoder = decode(b"\0\0".join(sample.frame() for sample in samples(30)))
    assert decoder.counts == Counts(samples=30)


def test_corrupt_frames_after_the_last_sample_are_told_apart() -> None:
    data = stream(samples(50), finished=0)
    counts = decode(data[:200] + b"\x05\x05\0" + data[200:] + b"noise\0" * 3).counts
    assert (counts.corrupt, counts.corrupt_at_end) == (5, 3), "two of them are one frame, cut in two"


@pytest.mark.parametrize("told", [True, False])
def test_a_reset_begins_a_new_run(told: bool) -> None:
    first, second = samples(300, 1), samples(200, 2)
    again = stream(second)
    decoder = decode(stream(first, finished=0) + (again if told else again[len(Info().frame()):]))
    assert [received(decoder, run) for run in range(2)] == [first, second]
    assert (decoder.counts.resets, decoder.counts.lost) == (1, 0)
    assert [len(stretch.columns["time_s"]) for stretch in stretches(decoder)] == [300, 200]


def test_a_reset_is_told_even_if_the_ticks_go_on() -> None:
    decoder = decode(stream(samples(100), finished=0) + stream([Sample(k, k + 1) for k in range(150, 200)]))
    assert (len(decoder.runs), decoder.counts.resets, decoder.counts.lost) == (2, 1, 150)


@pytest.mark.parametrize("data, message", [
    (b"", "board: no telemetry frame in 0 bytes; nothing was sent"),
    (bytes(range(256)) * 100, "board: no telemetry frame in 25600 bytes; check the baud rate"),
    (b"x" * 5000, "board: no telemetry frame in 5000 bytes; check the baud rate"),
    (Info().frame(version=2), "board: telemetry of version 2: unknown to this version of rdpi"),
    (Info().frame() + frame(b"\x07abc") * 2, "board: a frame of type 7 with 4 bytes: unknown"),
    (Info().frame() + frame(b"\x01abc") * 2, "board: a frame of type 1 with 4 bytes: unknown"),
    (Info(numbers=3).frame(), "board: an info frame with numbers 3 and state 1: unknown to this version of rdpi"),
])
def test_streams_that_are_none(data: bytes, message: str) -> None:
    with pytest.raises(BadInput) as error:
        decode(data)
    assert str(error.value).startswith(message)


@pytest.mark.parametrize("info, message", [
    (Info(rate_hz=0), "0 samples per second; check rate_hz"),
    (Info(dac_bits=0), "0 DAC bits from -20 to 120 V; check min_V, max_V and dac_bits"),
    (Info(min_V=float("nan")), "16 DAC bits from nan to 120 V; check min_V, max_V and dac_bits"),
    (Info(um_per_count=float("inf")), "um_per_count = inf; check RDPI_UM_PER_COUNT"),
    (Info(um_per_count=-1e306), "um_per_count = -1e+306; check RDPI_UM_PER_COUNT"),
    (Info(count_0_um=1e9), "count_0_um = 1e+09; check RDPI_COUNT_0_UM"),
    (Info(um_per_reference=float("nan")), "um_per_reference = nan; check the parameters"),
])
def test_absurd_numbers_are_named(info: Info, message: str) -> None:
    with pytest.raises(BadInput) as error:
        decode(info.frame())
    assert str(error.value).startswith(f"board: the firmware reports {message}") and "version" not in str(error.value)


@pytest.mark.parametrize("body", [b"\x07abc", b"\x07", b"\x01", b"\x02", b"\x02\x01", b"\x02\x09"])
def test_one_strange_frame_among_many_is_damage(body: bytes) -> None:
    decoder = decode(stream(samples(50)) + frame(body))
    assert decoder.counts.corrupt == 1 and len(received(decoder)) == 50


def test_samples_without_an_info_have_no_scale() -> None:
    decoder = decode(b"".join(sample.frame() for sample in samples(50)))
    with pytest.raises(BadInput, match="there are samples, but no info frame"):
        stretches(decoder)


def test_a_damaged_info_does_not_set_the_scale() -> None:
    decoder = decode(stream(samples(3000)) + Info(max_V=5.0).frame())
    assert decoder.info_of(decoder.runs[0]).max_V == 120


# ---- recordings ----

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


NOT_WHOLE, ELSEWHERE = "the start-up sweep was not received completely", "it does not start at the end of the sweep"


@pytest.mark.parametrize("sent, why", [
    pytest.param(swept(30, 100)[:10] + swept(30, 100)[11:], NOT_WHOLE, id="a gap in the sweep"),
    pytest.param(swept(30, 100)[1:], NOT_WHOLE, id="its first sample lost"),
    pytest.param(swept(30, 100)[:29] + swept(30, 100)[30:], NOT_WHOLE, id="its last sample lost"),
    pytest.param(swept(30, 100)[:30] + swept(30, 100)[31:], NOT_WHOLE, id="a gap behind it"),
    pytest.param(swept(30, 100)[:60] + swept(30, 100)[61:], ELSEWHERE, id="a gap later"),
    pytest.param(swept(30, 100, 31_000), "the drive jumps at the end of the sweep", id="a jump behind it"),
    pytest.param([replace(sample, flags=HELD) if sample.tick == 31 else sample for sample in swept(30, 100)],
                 "the DAC did not take the code at the end of the sweep", id="no code behind it"),
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
    assert stretch.why_unknown == ("" if memory == "reset" else "the sweep does not end in the middle of its range")


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
    assert any("there is no displacement_um" in note for note in notes(decoder, [stretch], [stretch]))


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
    assert notes(decoder, [stretch], [stretch]) == ["there is no reference_um: 2 samples had no reference"]


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
    text = "\n".join(notes(decoder, found, found))
    assert "the target was reset 1 times" in text
    assert "1 samples are not used" in text and "1 corrupt frames came after the last sample" in text
    assert struct.calcsize("<BBBbIBB7d10I") == telemetry.INFO_BODY.size == 106


@pytest.mark.parametrize("start_heard, first", [(True, 41), (False, 41), (False, 1)])
def test_a_target_that_was_running_already_is_told(start_heard: bool, first: int) -> None:
    data = stream(samples(100)[first - 1:])
    decoder = decode(data if start_heard else data[len(Info().frame()):])
    found = stretches(decoder)
    told = [f"the target was already running: samples before tick {first} were not received"]
    assert notes(decoder, found, found) == (told if first > 1 and not start_heard else [])


def test_infos_that_disagree_are_told() -> None:
    decoder = decode(stream(samples(2500)) + Info(streams.FINISHED, offered=2500, max_V=5.0).frame())
    found = stretches(decoder)
    assert notes(decoder, found, found) == [
        "the 5 info frames of one run contain 2 different rates or scales; the most frequent are used"]
    assert found[0].columns["command_V"].max() > 5


@pytest.mark.parametrize("cycles, cycles_per_s, told", [
    (0, 0, "the target reports 7 lost ticks"),
    (20_000, 0, "the target reports 7 lost ticks; the longest tick took 20000 cycles"),
    (20_000, 160_000_000, "the target reports 7 lost ticks; the longest tick took 20000 cycles (0.000125 s; "
                          "the period is 0.0001 s)"),
])
def test_ticks_lost_are_told_with_the_longest(cycles: int, cycles_per_s: int, told: str) -> None:
    decoder = decode(stream(samples(100), Info(counts=(0, 7, *[0] * 5, cycles, cycles_per_s))))
    found = stretches(decoder)
    assert notes(decoder, found, found) == [told]


def test_codes_that_the_dac_did_not_take_are_told() -> None:
    decoder = decode(stream(samples(100), Info(counts=(*[0] * 6, 5, 0, 0))))
    found = stretches(decoder)
    (note,) = notes(decoder, found, found)
    assert note.startswith("the DAC did not take 5 codes; ") and note.endswith("matches the board's DAC")


@pytest.mark.parametrize("first, told", [(50, True), (21, True), (20, False)])
def test_a_longest_stretch_much_shorter_than_what_was_received_is_told(first: int, told: bool) -> None:
    sent = [sample for sample in swept(30, 131) if sample.sequence != 30 + first]  # 100 after the sweep
    decoder = decode(stream(sent))
    found = stretches(decoder)
    assert [stretch.samples for stretch in found] == [first, 100 - first]
    assert bool(notes(decoder, found, [found[first < 50]])) == told
    assert notes(decoder, found, found) == []
