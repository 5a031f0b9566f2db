"""Random models and references for the tests of operators, model, firmware and chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from rdpi.firmware import Chain, Steps
from rdpi.model import Drive, Memory, Model, Rate, operators
from rdpi.simulate import numpy_inverse

SAMPLE_TIME_S = 1e-4


def random_model(seed: int, plays: int = 9, deadzones: int = 2, falling: bool = True, slew: bool = False,
                 dac_bits: int | None = None, window: int = 1, filter_s: float = 0.0) -> Model:
    """A valid model of about 12 um stroke for SAMPLE_TIME_S, every value drawn: n = `plays`, m = `deadzones`.

    `falling` gives it a rate law; the drive range is about what the stroke needs; `window` is in samples.
    """
    random = np.random.default_rng(seed)
    thresholds = np.concatenate([[0.0], np.cumsum(random.uniform(0.2, 1, plays))])
    thresholds *= 6 / max(thresholds[-1], 6)
    slopes = random.uniform(0.4, 1.6, plays + 1)
    ratio = random.uniform(0.1, 0.4)
    top = 10 ** random.uniform(2, 4)
    fastest = slopes * random.uniform(1.02 * ratio, 1.3, plays + 1) if falling else slopes
    corners = np.concatenate([[0.0], np.cumsum(random.uniform(0.5, 2, deadzones))])
    pieces = random.uniform(0.5, 1.5, deadzones + 1)
    history = random.uniform(-6, 6, 8)
    states = operators.plays(history, thresholds, np.zeros(plays + 1))[1]
    gain = random.choice([-1, 1]) * 10 ** random.uniform(-2, 1)
    offset_V = random.uniform(-20, 20)
    reach_um = np.abs(history[-1]) + random.uniform(4, 16)
    range_V = sorted(np.array([-reach_um, reach_um]) / gain + offset_V)
    slew_V_per_s = random.uniform(0.002, 0.1) * (range_V[1] - range_V[0]) / SAMPLE_TIME_S
    return Model(
        gain_um_per_V=gain, offset_V=offset_V, offset_um=random.uniform(-10, 10), stroke_um=12.0,
        thresholds_um=thresholds, slopes=slopes, slope_rate_s_per_um=(fastest - slopes) / top,
        deadzones_um=corners, deadzone_weights=np.diff(pieces, prepend=0.0),
        rate=Rate("displacement", window * SAMPLE_TIME_S, filter_s, top, None, ratio),
        drive=Drive(*range_V, slew_V_per_s if slew else None, dac_bits), memory=Memory(states[0], states))


def random_reference(seed: int, model: Model, samples: int = 150, broken: float = 0.0) -> np.ndarray:
    """Displacements in um about the model's offset: sines, steps and pauses, often beyond the drive's range.

    A share `broken` of the samples is NaN, infinite or absurdly large.
    """
    random = np.random.default_rng(seed)
    time = np.arange(samples) / samples
    z = sum(random.uniform(0, 5) * np.sin(2 * np.pi * (cycles * time + random.uniform())) for cycles in (1, 3, 11))
    z += random.choice([0, 5]) * random.normal(size=samples // 10 + 1).repeat(10)[:samples]
    z[random.integers(samples):][:20] = z[0]
    if model.drive.dac_bits is not None:
        # On a pause a coarse DAC may fall into a cycle that meets the edge of a code or flag exactly. Avoid that.
        z += 1e-6 * random.normal(size=samples)
    places = random.uniform(size=samples) < broken
    z[places] = random.choice([np.nan, np.inf, -np.inf, 1e7, -1e300], np.count_nonzero(places))
    return z + model.offset_um


SEEDS = st.integers(0, 2**32 - 1)
MODELS = st.builds(random_model, SEEDS, st.integers(0, 12), st.integers(0, 4), st.booleans(), st.booleans(),
                   st.none() | st.sampled_from([1, 8, 12, 16, 20]), st.sampled_from([0, 1, 2, 7, 200]),
                   st.sampled_from([0.0, 3e-5, 1e-3, 1.0]))


def steps_of(model: Model, reference_um: np.ndarray, sample_time_s: float, states_um: np.ndarray | None = None
             ) -> tuple[Steps, np.ndarray]:
    """numpy_inverse.step of the operator alone, from these states of the plays or the model's memory."""
    memory = model.memory if states_um is None else Memory(float(states_um[0]), states_um)
    return numpy_inverse.step(replace(model, memory=memory), Chain(), reference_um, sample_time_s)
