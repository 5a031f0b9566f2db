"""Where a decaying sweep leaves the plays.

A sweep oscillates about a centre that moves from the middle M of its range to its end e, with a half amplitude that
falls from H, half the range, to 0. A play of threshold r follows it while the half amplitude exceeds r. It stays behind
at the centre where both are equal: y = e + r (M - e) / H. A play with r > H never followed, and is within its reach.
"""

from __future__ import annotations

import numpy as np


def swept_states(x_um: float, thresholds_um: np.ndarray, range_um: tuple[float, float], share: float) -> np.ndarray:
    """States of the plays, (n + 1,), after a sweep over `range_um` that ended at `x_um`: control inputs in um.

    `share` is that of Memory.sweep_share.
    """
    middle, half = sum(range_um) / 2, abs(range_um[1] - range_um[0]) / 2
    aside = min(max((middle - x_um) / half, -1.0), 1.0)
    return x_um + share * aside * np.minimum(thresholds_um, half)
