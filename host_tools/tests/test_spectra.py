"""What changes explain, told in the frequency domain, against filters in time."""

import numpy as np
import pytest
from rdpi.simulate.effects import CATALOGUE
from test_effects import SHORT, bent, changed, entry, residuals_of, shown


def products(left: np.ndarray, change: np.ndarray) -> tuple[float, float]:
    change = change - np.mean(change)
    return float(change @ left), float(change @ change)


@pytest.mark.parametrize("time_constant_s", [0.003, 0.02])
def test_what_a_lag_explains(time_constant_s: float) -> None:
    """As its filter says, but for the beginning of a recording, which a spectrum takes to follow its end."""
    plain = shown(bent(), SHORT)
    late = shown(bent(), SHORT, entry("lag", stage="sensor", time_constant_s=time_constant_s)) - plain
    residuals = residuals_of(changed(SHORT, displacement_um=SHORT.displacement_um + 0.7 * late))
    spectra = residuals.spectra
    response = 1 / (1 + 2j * np.pi * spectra.hertz[None] * time_constant_s) - 1
    found = [float(one[0]) for one in spectra.explained(response)]
    assert found == pytest.approx(products(residuals.residual_um[0], late), rel=0.1)


def test_a_sharp_resonance_starts_where_it_is() -> None:
    rings = shown(bent(), SHORT, entry("resonance", f0_hz=137.0, damping=0.02))
    starts = CATALOGUE["resonance"]().starts(residuals_of(changed(SHORT, displacement_um=rings)))
    assert min(abs(np.log(values["f0_hz"] / 137.0)) for values in starts) < 0.02


def test_a_converter_starts_where_its_codes_lie() -> None:
    coarse = changed(SHORT, command_V=0.3 + 1.7 * np.round((SHORT.command_V - 0.3) / 1.7))
    starts = CATALOGUE["quantisation"]("DAC").starts(residuals_of(changed(SHORT, displacement_um=shown(bent(), coarse))))
    assert starts[0]["step"] == pytest.approx(1.7, rel=0.01)
    assert (starts[0]["origin"] - 0.3 + 0.85) % 1.7 - 0.85 == pytest.approx(0, abs=0.2)
