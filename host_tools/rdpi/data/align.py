"""A recording of another clock beside the drive that was played: where the drive lies in it, to parts of a sample.

The recorded voltage is taken for gain · drive + offset at times start + clock · (time of the drive). The place is
searched by correlation on a coarse grid, for clocks that differ by up to MAX_CLOCK, refined by least squares
(Gauss-Newton) on signals that are smoothed less and less, and settled on the samples as recorded (place.py). Where a
converter holds each sample, the place is the middle of the hold. A drive that was logged itself, at its own rate, is told
by its samples instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..errors import BadInput
from .place import WIDEST, Place, place
from .recording import MIN_SAMPLES, Recording, check_sizes, sample_times
from .resample import NEAR, at_times

AMID = 0.05  # of a sweep's range: from its middle, where a sweep has decayed from both sides
LEAST_V = 1e-12  # that a drive moves, and a recorded voltage; below, it is rounding that moves
MAX_CLOCK = 0.01  # by which two clocks may differ
COARSE = 16_000  # samples of the drive among which the place is searched
CLOCKS = 201  # at most so many clocks are tried, an odd number
LEAST_ALIKE = 0.95  # correlation of a recorded voltage with its drive; noise of 30 % of the drive's rms leaves .957
PART_ALIKE = 0.8  # the same of each of PARTS parts of the drive that move
PARTS = 8
AS_ALIKE = 0.99  # of the best correlation: from here on it is another play of the same drive
MOVES_ON = 0.6  # of the drive's range: who switches off behind it goes from the middle to an end
MOVES = 0.5  # of the drive's rms: a part that moves less says little about noise
MOST_DOUBT = 0.55  # samples of the drive, at either end of what is needed of it: half a hold, and what noise adds
SLOW = 1.5  # recorded samples for each of the drive: with fewer, a faster scope helps
NOISY = 0.02  # of the drive's rms: less noise is not what keeps a drive from being found
ROUNDS = 40  # of refinement, at most, with each smoothing
HELD = 1 / 8, 3 / 4, 1 / 8  # what two means over a sample's length make of samples that a converter holds
LOGGED, MISPLACED = 1e-4, 10.0  # of its rms: what a logged drive differs from the drive, and how many times a sample off
NEIGHBOURS = 2  # samples, to either side of where a drive seems to be, that are tried
ROUNDING = 1e-6  # of the drive's range: a smaller offset is none
SETTLED = 0.02  # samples of the drive: a round that moves its ends by less is the last


class Alignment(NamedTuple):
    """Where a drive lies in a recording."""

    start_s: float  # the drive's first sample, from the recording's first one; negative: the recording began later
    clock: float  # seconds of the recording per second of the drive
    gain: float  # recorded V per V of the drive; negative: inverted
    offset_V: float  # recorded where the drive is 0 V
    alike: float  # correlation of both, 0 to 1
    plays: int  # of the drive in the recording; this is the first
    doubt_s: float  # by how much the place may be wrong, at the end of the drive where it is larger
    logged: bool = False  # the drive itself, sample by sample: nothing says what a converter held


def amid(end: float, lowest: float, highest: float) -> bool:
    """Whether a decaying sweep over this range has left every play at x: near an edge the larger are left behind."""
    return abs(end - (lowest + highest) / 2) <= AMID * (highest - lowest)


def beside_drive(run: Recording, drive: Recording, at: str = "middle") -> tuple[Recording, list[str]]:
    """A recording at the samples of the drive that was played, from where its sweep ends; and lines that say what was
    found.

    command_V becomes that of the drive, every other column is interpolated behind a low-pass: in the middle of the hold
    of each sample, or half a sample of the drive before, `at` "switch". A reference that was not recorded is that of the
    drive. Raises BadInput if the drive is not in the recording from the end of its sweep to its own end, if its place
    stays in doubt, or for "switch" where the drive itself was logged.
    """
    first, swept = _after_sweep(drive)
    found = align(run, drive, first)
    if at == "switch" and found.logged:
        raise BadInput(f"{run.path}: --at switch: the file logs the drive itself, sample by sample: each row has its "
                       "moment, and no converter is seen to switch; leave out --at")
    samples = np.arange(first, len(drive)) - (0.5 if at == "switch" else 0.0)
    times = run.time_s[0] + found.start_s + found.clock * samples / drive.sample_rate_hz
    columns = {name: values for name, values in run.columns.items() if name not in ("time_s", "command_V")}
    read = at_times(run.time_s, columns, times)
    if drive.reference_um is not None:
        read.setdefault("reference_um", drive.reference_um[first:])
    rate_hz = drive.sample_rate_hz
    metadata = {**run.metadata, "memory": run.metadata.get("memory", "reset" if swept else "unknown"),
                "sample_rate_hz": f"{rate_hz:.12g}", "played": drive.path, "played_digest": drive.digest,
                "played_from_s": f"{found.start_s:.9g}", "played_clock": f"{found.clock:.9g}",
                "played_gain": f"{found.gain:.6g}", "played_offset_V": f"{found.offset_V:.6g}",
                **({} if found.logged else {"read_at": at})}
    offset_V = found.offset_V if abs(found.offset_V) > ROUNDING * np.ptp(drive.command_V) else 0.0
    lines = [f"  aligned with {drive.path}: its first sample is {abs(found.start_s):.9g} s "
             + ("after" if found.start_s >= 0 else "before") + " the first one used, known to "
             f"{found.doubt_s * rate_hz:.1g} samples of the drive",
             f"  clock {round(1e6 * (found.clock - 1), 3):+.4g} ppm, recorded voltage = {found.gain:.6g} x drive "
             f"{'+' if offset_V >= 0 else '-'} {abs(offset_V):.4g} V"
             + (" (inverted)" if found.gain < 0 else "") + f", correlation {found.alike:.5f}",
             f"  cut to {len(times)} samples at the drive's {rate_hz:g} per second"
             + (f", from the end of its sweep at {first / rate_hz:.6g} s" if first else "")
             + f"; memory: {metadata['memory']}"]
    if at == "switch":
        lines.append("  read as the converter switches to a sample, half a sample before the middle of its hold")
    if found.plays > 1:
        lines.append(f"  the drive was played {found.plays} times; this is the first; choose another with --rows")
    rest = run.command_V[run.time_s > times[-1] + max(1 / rate_hz, run.sample_time_s)]
    if found.plays == 1 and len(rest) and np.ptp(rest) > MOVES_ON * np.ptp(drive.command_V) * abs(found.gain):
        lines.append(f"  the voltage moves on after the end of the drive, for {len(rest) / run.sample_rate_hz:.4g} s, which are "
                     "left out; check that this is the drive that was played")
    if run.sample_rate_hz < rate_hz * NEAR:
        lines.append(f"  recorded at {run.sample_rate_hz:.6g} per second: columns are interpolated between samples")
    return Recording(run.path, metadata, {"time_s": sample_times(len(times), rate_hz),
                                          "command_V": drive.command_V[first:], **read}), lines


def align(run: Recording, drive: Recording, first: int = 0) -> Alignment:
    """Where the drive lies in the recording, as its samples from number `first` on show it. Raises BadInput."""
    wanted, where = drive.command_V[first:], f"{run.path}: --drive {drive.path}"
    for one in (run, drive):
        check_sizes(one.columns, lambda row, path=one.path: f"{path}, sample {row}")
    if np.ptp(wanted) <= LEAST_V:
        raise BadInput(f"{where}: command_V does not move; give the drive that was played")
    if np.ptp(run.command_V) <= LEAST_V:
        raise BadInput(f"{where}: the recorded voltage is constant; choose its column with --command")
    step_s, needed_s = 1 / drive.sample_rate_hz, (len(wanted) - 1) / drive.sample_rate_hz
    lasts_s = run.time_s[-1] - run.time_s[0]
    if lasts_s < needed_s * (1 - MAX_CLOCK):
        raise BadInput(f"{where}: the recording lasts {lasts_s:.6g} s, but the drive {needed_s:.6g} s"
                       + (" from the end of its sweep" if first else "") + "; record all of it, or cut the drive")
    if needed_s < MIN_SAMPLES * run.sample_time_s:
        raise BadInput(f"{where}: the drive lasts {needed_s:.3g} s, less than {MIN_SAMPLES} samples of the recording, "
                       f"which has {run.sample_rate_hz:.6g} per second; check both times, or record at a higher rate")
    start_s, clock, width_s, plays = _coarse(run, wanted, step_s)
    finest_s = max(step_s, run.sample_time_s)
    while True:
        start_s, clock, fitted = _refined(run, wanted, step_s, start_s, clock, width_s)
        if width_s <= finest_s:
            break
        width_s = max(width_s / 2, finest_s)
    slack_s = max(step_s, run.sample_time_s)
    before, after = -start_s, start_s + clock * needed_s - lasts_s
    if max(before, after) > slack_s:
        raise BadInput(f"{where}: the recording "
                       + (f"begins {before:.4g} s after" if before > after else f"ends {after:.4g} s before")
                       + (" the end of the drive's sweep" if before > after and first else " the drive does")
                       + f" (or is cut short elsewhere, or of another drive: correlation {fitted.alike:.3f}); record all of it")
    if fitted.alike < LEAST_ALIKE or fitted.least_alike < PART_ALIKE:
        raise BadInput(f"{where}: the drive is not found in the recorded voltage (correlation {fitted.alike:.3f}, in "
                       f"the worst part {fitted.least_alike:.3f}; needed are {LEAST_ALIKE:g} and {PART_ALIKE:g}); "
                       "check that this drive was played and recorded as a whole, and the columns")
    if (logged := _logged(run, wanted, step_s, start_s)) is not None:
        sample, gain, offset_V, doubt = logged
        return Alignment(sample * run.sample_time_s - first * step_s, 1.0, gain, offset_V, fitted.alike, plays, doubt * step_s,
                         logged=True)
    start_s -= clock * first * step_s
    at = (run.time_s - run.time_s[0] - start_s) / (clock * step_s)
    swept = (at >= 0) & (at <= first)
    if np.sum(swept) > PARTS:
        alike = np.corrcoef(run.command_V[swept], drive.command_V[at[swept].astype(np.intp)])[0, 1]
        if not alike * np.sign(fitted.gain) >= PART_ALIKE:
            at[at < first] = -np.inf  # clipped, or another sweep: only what follows must be there
    found = place(run.command_V, at, drive.command_V, first, run.sample_time_s / step_s, clock * step_s)
    if not found.doubt <= MOST_DOUBT:
        raise BadInput(f"{where}: {_too_doubtful(found, run, drive)}")
    stretch = (found.last - found.first) / (len(drive) - 1)
    return Alignment(start_s + clock * step_s * found.first, clock * (1 + stretch), found.gain, found.offset_V,
                     fitted.alike, plays, found.doubt * step_s)


def _logged(run: Recording, wanted: np.ndarray, step_s: float, start_s: float) -> tuple[int, float, float, float] | None:
    """The first sample, gain, offset and doubt in samples of a drive that was logged itself, sample by sample, near a
    start; None: it was not. A measured voltage has noise, and a drive that rests much says little of its place then.
    """
    if abs(run.sample_time_s / step_s - 1) * len(wanted) > 0.5:
        return None
    # Its ends aside, a drive that fills the recording has neighbours, too.
    core = wanted[NEIGHBOURS:len(wanted) - NEIGHBOURS]
    usual, found = float(np.std(core)) if len(core) else 0.0, []
    if not usual:
        return None
    for sample in round(start_s / step_s) + np.arange(-NEIGHBOURS, NEIGHBOURS + 1):
        first = max(sample + NEIGHBOURS, 0)
        heard = run.command_V[first:first + len(core)]
        if first == sample + NEIGHBOURS and len(heard) == len(core):
            gain, offset_V = np.polyfit(core, heard, 1)
            found.append((float(np.std(heard - gain * core)) / (abs(gain) * usual or np.inf), int(sample), float(gain),
                          float(offset_V)))
    if len(found) < 2:
        return None
    (least, sample, gain, offset_V), (next_best, *_), *_ = sorted(found)
    if not 0 <= sample <= len(run) - len(wanted):
        return None
    if least > LOGGED or next_best < MISPLACED * least:
        return None
    return sample, gain, offset_V, least / next_best


def _too_doubtful(found: Place, run: Recording, drive: Recording) -> str:
    per_sample = run.sample_rate_hz / drive.sample_rate_hz
    told = f"{found.doubt:.2g}" if np.isfinite(found.doubt) else f"more than {WIDEST:g}"
    remedies = (["record the voltage with less noise: use all of the scope's range, and see that no sample is lost, that the "
                 "clock is right, and that the voltage is not clipped"] if found.noise > NOISY else []) + (
        [f"record at {2 * drive.sample_rate_hz:g} samples per second or more"] if per_sample < SLOW else [])
    return (f"the drive is found, but only to {told} of its samples (noise {100 * found.noise:.2g} % of the drive, "
            f"{per_sample:.3g} recorded samples for each of it; needed is {MOST_DOUBT:g}); "
            + (", and ".join(remedies) or "play a drive that moves faster"))


class _Fitted(NamedTuple):
    gain: float
    alike: float
    least_alike: float


def _after_sweep(drive: Recording) -> tuple[int, bool]:
    """The sample at which the start-up sweep of the drive ends, and whether it leaves a known memory."""
    def number(text: str | None) -> float | None:
        try:
            value = float(text)
        except (TypeError, ValueError):
            return None
        return value if np.isfinite(value) else None

    known = drive.metadata
    ends = known["sweep_V"].split() if "sweep_V" in known else [known.get("min_V"), known.get("max_V")]
    sweep_s, end = number(known.get("sweep_s")), number(known.get("rest_V"))
    low, high = map(number, ends) if len(ends) == 2 else (None, None)
    if sweep_s is None:
        return 0, False
    first = round(sweep_s * drive.sample_rate_hz)
    if not 0 < first < len(drive) - 1:
        raise BadInput(f"{drive.path}: sweep_s is {sweep_s:g}, but the drive lasts "
                       f"{(len(drive) - 1) / drive.sample_rate_hz:g} s; correct it, or leave it out")
    return first, None not in (low, high, end) and amid(end, low, high)


def _coarse(run: Recording, wanted: np.ndarray, step_s: float) -> tuple[float, float, float, int]:
    """Start in s from the recording's first sample, clock, the step of the grid on which both were searched, and how
    often the drive was played.
    """
    needed_s = (len(wanted) - 1) * step_s
    grid_s = max(step_s, run.sample_time_s, needed_s / COARSE)
    beyond_s = needed_s * MAX_CLOCK / 2  # a clock that is off must not push an end out
    lasts_s = run.time_s[-1] - run.time_s[0]
    heard = _smoothed(run.command_V, grid_s / run.sample_time_s)
    heard = np.interp(np.arange(-beyond_s, lasts_s + beyond_s, grid_s), run.time_s - run.time_s[0], heard)
    heard = heard - np.mean(heard)
    smooth, own_s = _smoothed(wanted, grid_s / step_s), np.arange(len(wanted)) * step_s
    size = 1 << int(len(heard) + 2).bit_length()
    spectrum = np.fft.rfft(heard, size)
    sums, squares = (np.concatenate([[0.0], np.cumsum(part)]) for part in (heard, heard**2))
    clocks = min(CLOCKS, 2 * int(np.ceil(2 * MAX_CLOCK * needed_s / grid_s / 2)) + 1)
    best, plays = (0.0, 0.0, 1.0), 1
    for clock in 1 + MAX_CLOCK * np.linspace(-1, 1, max(3, clocks)):
        shape = np.interp(np.arange(0, needed_s * clock, grid_s), own_s * clock, smooth)
        if len(shape) > len(heard):
            continue
        shape -= np.mean(shape)
        product = np.fft.irfft(spectrum * np.conj(np.fft.rfft(shape, size)), size)[:len(heard) - len(shape) + 1]
        mean = (sums[len(shape):] - sums[:-len(shape)]) / len(shape)
        power = (squares[len(shape):] - squares[:-len(shape)]) - len(shape) * mean**2
        power = np.maximum(power, 1e-6 * squares[-1])
        alike = np.abs(product) / np.sqrt(power * (shape @ shape))
        highest = float(np.max(alike))
        if highest > best[0]:
            places = _apart(alike, AS_ALIKE * highest, len(shape))
            best, plays = (highest, places[0] * grid_s - beyond_s, float(clock)), len(places)
    return best[1], best[2], grid_s, plays


def _apart(alike: np.ndarray, least: float, length: int) -> list[int]:
    """The places that are alike at least so, best within a drive's length; the earliest first."""
    found: list[int] = []
    for start in np.flatnonzero(alike >= least):
        if not found or start - found[-1] > 0.9 * length:
            found.append(int(start + np.argmax(alike[start:start + max(1, length // 2)])))
    return found


def _refined(run: Recording, wanted: np.ndarray, step_s: float, start_s: float, clock: float, width_s: float
             ) -> tuple[float, float, _Fitted]:
    """Start and clock after rounds of Gauss-Newton on signals smoothed over a width, and how well they fit."""
    smooth, own_s = _smoothed(wanted, width_s / step_s), np.arange(len(wanted)) * step_s
    heard = _smoothed(run.command_V, width_s / run.sample_time_s)
    if smooth is wanted and heard is not run.command_V:
        smooth = np.convolve(np.pad(wanted, 1, mode="edge"), HELD, mode="valid")
    slope, middle_s = np.gradient(smooth, step_s), own_s[-1] / 2
    columns = np.stack([smooth, np.ones_like(smooth), slope, slope * (own_s - middle_s)], axis=1)
    normal = columns.T @ columns
    for _ in range(ROUNDS):
        read = np.interp(start_s + clock * own_s, run.time_s - run.time_s[0], heard)
        gain, offset_V, late, stretch = np.linalg.lstsq(normal, columns.T @ read, rcond=None)[0]
        if gain == 0:
            break
        # read = gain · drive(t + shift): the recording is ahead by the shift, of at most a width at each round
        shift = float(np.clip(late / gain, -width_s, width_s))
        faster = float(np.clip(stretch / gain, *(np.array([-1, 1]) * width_s / max(middle_s, step_s))))
        start_s -= clock * (shift - faster * middle_s)
        clock = float(np.clip(clock * (1 - faster), 1 - MAX_CLOCK, 1 + MAX_CLOCK))
        if abs(shift) + abs(faster) * middle_s < SETTLED * step_s:
            break
    read = np.interp(start_s + clock * own_s, run.time_s - run.time_s[0], heard)
    gain, offset_V = np.polyfit(smooth, read, 1)
    left = read - gain * smooth - offset_V
    usual = float(np.std(smooth))
    parts = [float(np.sqrt(max(0.0, 1 - np.mean(e**2) / max(np.var(gain * u), np.finfo(float).tiny))))
             for e, u in zip(np.array_split(left, PARTS), np.array_split(smooth, PARTS)) if np.std(u) > MOVES * usual]
    alike = float(np.sqrt(max(0.0, 1 - np.mean(left**2) / max(float(np.var(read)), np.finfo(float).tiny))))
    return start_s, clock, _Fitted(float(gain), alike, min(parts, default=alike))


def _smoothed(values: np.ndarray, width: float) -> np.ndarray:
    """Twice the mean over `width` samples, for what happens between samples of a grid as wide."""
    from scipy.ndimage import uniform_filter1d

    size = int(round(width)) | 1
    return values if size < 3 else uniform_filter1d(uniform_filter1d(values, size, mode="nearest"), size,
                                                    mode="nearest")
