"""The decoder: what was sent comes out, in pieces of any size; what was damaged does not, and is counted."""

from __future__ import annotations

import binascii
import time
from dataclasses import replace

import numpy as np
import pytest
import streams
from captures import decode
from hypothesis import given
from hypothesis import strategies as st
from streams import Info, Sample, frame, samples, stream

from rdpi.board import telemetry
from rdpi.board.stretches import stretches
from rdpi.board.telemetry import Counts, Decoder
from rdpi.errors import BadInput


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
def test_a_frame_costs_as_much_after_a_million_as_before() -> None:
    part = stream(samples(65_536), finished=0)  # the sequence wraps to the same bytes, the tick does not matter
    decoder, took_s = Decoder("board"), []
    for _ in range(16):
        began = time.process_time()
        decoder.feed(part)
        took_s.append(time.process_time() - began)
    assert decoder.counts.samples > 1_000_000 and decoder.counts.corrupt == 0
    assert min(took_s[-4:]) < 3 * min(took_s[:4])


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
