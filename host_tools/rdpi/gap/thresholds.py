"""Every tuned number of the gap: [unit] meaning; source.

Modules read these at the time of use (`thresholds.RIVAL_MARGIN`), so that tests/withheld/thresholds.py can show what
half and twice of each do to the figures of the withheld check. What an effect gains by chance is in its own file
(`Effect.chance_gain`).

Sources:
  tune      chosen on the tuning set of tests/withheld (`check.py --set tune`): its 'none' controls and single effects
  coverage  so that intervals stated as 90 % cover 90 % of the tuning set
  rigs      chosen on tests/rigs (`appears.py`, `circle.py`), a family left out in turn
  picma     chosen on ../shared/data/picma_p885, nothing injected (`check.py --set measured`)
  judged    set when the search was written; no set is on record
"""

from __future__ import annotations

# --- is there a gap?
DETECTION = 0.32  # [1] evidence from which there is a gap; tune
DETECTION_FEW = 0.36  # [1] the same with few recordings, or a passport of few; rigs
DETECTION_ONE = 0.55  # [1] the same with one recording: the model's own error has the shape of something in it; rigs
TOGETHER_FEW = 0.65  # [1] of the evidence by size and by shape together, with few recordings; rigs
FEW = 4  # [recordings] fewer are few; tune
FEWEST = 2  # [recordings] at most, in which a gap smaller than usual may have the shape of an effect; rigs
USUAL_SPREAD = 0.2  # [ln] scatter of a passport; a poorer one's ratio counts less; tune
UNKNOWN = 1.3  # [detection] times the evidence for a gap, from which one without a name is reported; rigs
SPREADS = 2.5  # [spread] of the passport by which ln(ratio) must exceed 0 for the same; tune
SPECTRUM = 0.4  # [ln] mean of ln(rms / passport) as the energy lies, times breadth and trust, for the same; picma
SPECTRUM_FEW = 0.8  # [ln] the same with few recordings, or a passport of few; judged
MOST_BREADTH = 2.0  # [passport] in an octave, mean of all, as far as it counts as breadth; judged
FEW_LINES = 4.0  # [lines] of a spectrum, by which an octave counts half; judged

# --- which effect?
MOST_EFFECTS = 3  # [effects] accepted at most; tune
LEAST_SHARE = 0.15  # [of the excess] that an effect must explain; tune
LEAST_SHRINK = 0.04  # [1] that it must bring beyond chance, and of all that is missed before references; tune
BORN_IN = 0.25  # [1] shrink that makes an effect where nothing exceeds the passport; tune
BORN_IN_FEW = 0.45  # [1] the same with few recordings; tune
NEW_RATIO = 1.15  # [passport] from which something is new, whatever was there before; tune
CLEAR_RATIO = 1.5  # [passport] below it, refitting the model may decide; tune
BESIDE = 0.75  # [of the squares] ... if an effect beside the refitted model leaves less than this share; tune
WORSE_LEFT_OUT = 0.15  # [of the squares gained] by which recordings left out may be predicted worse; rigs
FURTHER_RATIO = 1.4  # [passport] that must be left for a second and third effect; tune
FURTHER_SHARE = 0.3  # [of the excess] that a second and third effect must explain; tune
FURTHER_SHRINK = 0.06  # [1] that a second and third effect must bring; tune
HOPELESS = 4.0  # [of the squares] that the best leaves beside others, to first order; more is not tried; judged
CANCELS = 1.5  # [of the squares] of the gap, that one of a pair leaves alone: they cancel; rigs
UNEXPLAINED = 0.75  # [passport] left, times the share of the excess not explained, from which the gap is unknown; rigs
LEFT_EVERYWHERE = 1.7  # [passport] left in an octave, mean of all, from which the gap is unknown; rigs
LEFT_SHARE = 0.2  # [of the excess] ... if as much is not explained; rigs
CONTRADICTS = 2.0  # [1] what is missed driven by a monitor, over that driven by the command; the monitor is wrong; judged
FITS_TODAY = 0.2  # [change] rms that a model misses in all: it fits today, and a change is of what was earlier; judged
NOISE_GRID = 1.5  # [step] times the passport's grid of readings, from which a coarser one is new; tune
STILL_THERE = 0.5  # [of the energy] of a disturbance in the earlier recordings, from which it is not new; tune
STUCK = 0.05  # [of the energy] while readings stick, from which that is why nothing else can be named; rigs
STUCK_MORE = 2.0  # [commissioning] times the share of the energy while readings stick, from which it is new; judged
OWN_MOTION = 2.0  # [amplitude] of a line, from which a recording moves at its frequency itself; judged

# --- can it be told from others?
RIVAL_MARGIN = 0.08  # [of the squares] that a rival may leave more, and cannot be told; tune
LACKING = 0.5  # [of the squares to be expected] likewise: the model's own error may favour a wrong effect; rigs
TWIN = 0.98  # [R2] of the signature, from which another effect is its twin; tune
TWIN_MARGIN = 1.0  # [of the squares] that a twin may leave more: the rest may be the model's misfit; tune
ROUNDED_OFF = 0.005  # [of the squares] that a monitor shows of any amplifier beside the effect looked for; tune
SIMPLER = 0.05  # [of the squares] that every further parameter must bring; tune
CONTAINED = 0.9  # [1] share of what an effect explains, from which the simpler one that it contains is enough; tune
ONE_RATE = 3.0  # [rate] between fastest and slowest recording; below, changes of loops cannot be told; tune
ALIKE_LOOPS = 0.7  # [R2] ... if they look so much alike; tune
AS_GOOD = 0.5  # [contrast] of the best canned recording, from which a shorter one is as good; rigs

# --- how far?
WIDEN = 1.3  # [width] by which bootstrapped intervals are widened; coverage
WIDEN_FEW = 0.84  # [width] of what few recordings call for, by which promises are widened at least; rigs
REFIT_FREEDOM = 0.2  # [slope] standard deviation of a slope's prior when the model is refitted; judged
CORRELATED = 30  # [samples] of the residual that count as one: what the model misses is no white noise; judged
SHOWN_LEFT = 0.1  # [squares] of what shows a parameter, without which what is left out does not tell of it; judged
REACH = 0.5  # [change] share of a candidate's change, as far as its Jacobian is taken to hold; judged
TRACKED_LEVEL = 0.6  # [of the squares] that recordings and passport leave unexplained, in tracked references; rigs
TRACKED_SPREAD = 0.35  # [ln] scatter of the rms of that; rigs
TRACKED_SCATTER = 0.12  # [1] of the shrink beside that: effects that have another name; rigs
MOST_BEYOND = 1.0  # [of the change] in an octave, that no effect explains; rigs
TRACKED_WORSE = 0.02  # [1] by which tracking may get worse as promised, before an effect is left out; rigs
LOST = 0.2  # [of the squares gained] by which recordings may be predicted worse, before an effect is left out; rigs

# --- has the zero moved?
ZERO_AGREES = 4.0  # [scatter] of zeros, from which their mean is carried over to the improved model; rigs
ZERO_SCATTER = 0.004  # [stroke] that zeros scatter by, worth one recording; rigs
ZERO_ALONE = 0.04  # [stroke] ... and a single recording's does; judged
ZERO_UNDONE = 0.002  # [stroke] that effects do to it, from which it is undone where zeros do not agree; judged

# --- is it known from commissioning?
HARDLY_MOVED = 4.0  # [movement] of commissioning, by which more is not known in an octave; judged
MISSED_MORE = 1.5  # [level] from which what was missed of an octave's movement says more than the level; rigs
MISSED_AS_MUCH = 2.0  # [1] times that, up to which an octave's gap need not be new; rigs
BEYOND_ENDS = 0.02  # [range] of commissioning, beyond whose ends nothing is known; judged
TOO_SMALL = 0.5  # [1] by which recordings move less than any of commissioning, for their gap not to be known; judged
ABOVE_NOISE = 1.4  # [noise] rms from which a gap has places; judged
MOSTLY = 0.5  # [of the energy] at places that are not known, from which these come first; judged

# --- what is worth a remark? No verdict depends on these.
BIN_SHARE = 0.1  # [of the energy] in one bin; tune
BIN_RATIO = 2.5  # [passport] in that bin; tune
ZERO = 1.0  # [gap rms] offsets from which the zero has moved; tune
MUCH_ZERO = 0.01  # [stroke] ... and of the stroke; tune
MUCH_LEFT = 1.8  # [passport] left with the effects; tune
UNSEEN = 0.05  # [of the squares] of a monitor, left without an effect of the model, below which it is not there; judged
OTHER_RATE = 2.0  # [rate] times the identified one: the recordings are faster than the model knows; tune
