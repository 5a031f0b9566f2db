"""Every tuned number of the fit: [unit] meaning; source.

Modules read these at the time of use (`tuned.POOR_PERCENT`), `thresholds` being those of the plays there.

Sources:
  picma     chosen on the second file of ../shared/data/picma_p885, which was not fitted, and on the virtual benches of
            tests/bench, where they lie on a wide plateau
  benches   chosen on recordings of the virtual benches of tests/bench, told from others: drives, seeds and settings
            that were not used for choosing
  cycles    measured on the cycles of ../shared/data/picma_p885, one to nine cycles apart, noise taken off
  rigs      chosen on virtual rigs of tests/rigs, scored on others of each family
  judged    set when the check was written, far from what recordings of one actuator show; no set is on record
"""

from __future__ import annotations

# --- the fit (identify.py, regression.py, bands.py)
# The prior: what the model cannot explain must not bend the slopes, so its strength follows the residual. Each weight
# times the relative residual times a slope's departure weighs as much as that residual in every sample.
PRIOR_BEND = 2.5  # [1] bend along the loading curve; picma
PRIOR_RATE_BEND = 25.0  # [1] bend of the rate law along the curve; picma
PRIOR_RATE = 0.75  # [1] size of the rate law; picma
PRIOR_SATURATION = 2.5  # [1] saturation away from a straight line; picma
SLOPE_FLOOR = 0.05  # [1] no slope of a loading curve falls below this within the identified rates; judged
PIECE_RANGE = 0.2, 5.0  # [1] bounds of the inverse saturation's slopes U_j; judged
GRID_GAP = 3  # [grid points] dead zones closer than this cannot be told apart; judged
RATE_HEADROOM = 1.25  # [identified rate] beyond which the guard never lies; judged
BAND_OFFSET = 3.0  # [1] weight that keeps the offset of a band of rate near the model's; judged
MIN_SAMPLES_PER_UNKNOWN = 5  # [samples] fewer cannot be fitted; judged

CHOICE_HZ = 5000.0  # [1/s] recordings sampled faster are thinned to this while effects are chosen; judged
CHOICE_STROKE = 60.0  # [samples] that a fast stroke keeps then; judged
CHOICE_LEAST = 64  # [samples] that a short recording keeps; judged
HOLD_ERRORS = 3.0  # [standard errors] by which creep may be larger than holds show; judged
HOLD_SLACK = 0.05  # [1] by which it may be larger beside that: no rig's creep is quite that of the catalogue; judged
CHAIN_LAW = 0.1  # [1] of the rate law's prior, beside effects: what holds the law back makes delays longer; benches
# What an effect around the operator must take away of the squares on what was left out, and how many standard errors
# that must be.
FIRST_GAIN = 0.25, 2.0  # [of the squares, errors] the first that comes late, or a rate law; rigs
INSTEAD_GAIN = 0.1, 2.0  # [of the squares, errors] one that comes late, in the place of a rate law; rigs
FURTHER_GAIN = 0.05, 1.0  # [of the squares, errors] beside one that comes late, and effects of other kinds; rigs
FAR_LESS = 0.3  # [of the squares] all effects together, to stay although they are late, or to be told of; judged
REACH = 0.5  # [of what an effect does] by which it moves at most where blocks are left out; judged
OUT_OF_STEP = 2.0  # [squares] of the best, that a resonance behind what is late leaves, from which more may grow; rigs
RINGS_FAR = 0.9  # [stroke] that the operator alone makes, below which its thresholds did not fit it; judged
CHAIN_EXCHANGE = 0.95  # [squares] held out, that an effect in the place of another leaves at most; judged
CHAIN_LEAST = 3e-4  # [stroke] rms that it must take away; judged
CHAIN_WIDEN = 2.4  # [width] by which intervals of its parameters are widened; rigs
COVERED = 0.5  # [range] of a recording that others must move over for it to be left out as a whole; judged
MOST_LEFT_OUT = 0.75  # [samples] that one recording may hold for recordings to be left out in turn; judged
MONITOR_ERRORS = 2.0  # [errors] by which monitor_V must show a delay or lag of the amplifier; judged
MONITOR_WORSE = 1.1  # [1] rms that the monitor as the drive leaves over that of the command; more, and it is wrong; judged
MONITOR_LEFT = 0.01  # [range] rms of a monitor beside delay, lag and noise, from which it is a remark; judged
STROKE = 0.1  # [range] a shorter movement is no stroke; judged
SEVERAL_SIZES = 2.0  # [1] ratio of the strokes' sizes, from which they are several; judged
SEVERAL_RATES = 3.0  # [1] ratio of the strokes' mean rates, from which they are several; judged

# --- what a fit remarks on (identify.py)
WRONG_WAY = 0.01  # [of the strokes' rectangles] area of loops that the command closes, not the displacement; judged
NARROWER = 0.05  # [of the lowest slope] that it grows with the rate; actuators' loops get wider; judged
FAR_OFF = 20.0  # [rms] that the largest miss of a recording is, from which its place is told; judged
EDGE = 5.0  # [rms] of the drive's rate, that an edge exceeds; judged
SLOW_HZ = 20.0  # [samples per second] slower ones are told: times may be in ms or us; judged
LONG_S = 7200.0  # [s] and longer recordings; judged
NO_DRIVE_V = 5e3  # [V] drives that go further are told: commands may be in mV; judged
NO_STROKE_UM = 1e-3, 3e3  # [um] strokes outside are told: displacements may be in nm, mm or m; judged
POOR_PERCENT = 3.0  # [% of the stroke] rms of a run; judged
POOR_SMALL = 0.3  # [stroke] that a run which moves less is taken to move there; judged
RESET_DOUBT = 0.7  # [1] error of a run's beginning, best start over rest, below which reset is doubted; judged
OTHER_SOURCE = 0.6  # [1] residual with the other rate source over this one's; below, that one is proposed; judged

# --- where a sweep leaves the plays (sweep_start.py)
FORGETS = 0.955  # [1] rms that plays which forget leave over that of plays which remember; below, they forget; rigs
FORGETS_LOOP = 8e-4  # [loop, squared] by which the squares differ at least; rigs
SWEEP_SHOWN = 0.98  # [1] rms with the best share over that with 1, or with 0, below which this one is wrong; rigs

# --- the passport (passport.py)
# On the recordings not used for choosing KERNEL and HALF, ln(actual / expected) had mean and sd -0.03, 0.21 (Preisach),
# -0.04, 0.36 (Bouc-Wen) and 0.21, 0.33 (the paper's law, which the model fits so well that the bench's amplifier is
# most of what is left); with one rms for all recordings -0.36, 0.35; -0.78, 0.36; -0.44, 0.49. Some sixty ways were
# tried.
KERNEL = 0.3  # [ln] width of the kernel over the logarithms of a window's features; benches
HALF = 0.2  # [1] evidence at which what similar windows say counts half; benches
SPREAD_FITTED = 0.8  # [ln] of actual / expected before any run was left out, where all residuals are of fits; benches
SPREAD = 0.4  # [ln] the same of runs that were left out; benches
PART_WORTH = 0.5  # [runs] that a part of the only recording is worth there; judged
SPREAD_RUNS = 3.0  # [runs] that such a spread is worth beside those of the passport itself; benches
REPEATS = 0.6  # [1] an actuator's difference from itself, drive repeated, over the model's error: 0.5 to 0.6; cycles
LOW = 1e-2  # [usual size] of a feature, below which its logarithm says nothing; judged
NEAR = 0.5  # [movement] of the others of a passport's recordings, from which they tell what is missed of one; judged
ASTRAY = 0.2  # [way] rms of a run whose drifting loops go astray, mean removed; 1 / sqrt(12) at a constant rate; benches
AT_REST = 1e-3  # [1] movement of a part of a recording beside the largest, below which it rests; judged
LEAST = 1e-6  # [stroke] the same of a window; judged
MAX_WINDOWS = 200  # [windows] of all recordings; more are not kept; judged
MIN_WINDOW = 100  # [samples] shorter windows are not taken; judged

# --- is it this actuator? (checks.py)
MONITOR_SLOPE = 0.3, 2.0  # [V/V] of monitor_V over command_V; judged
MONITOR_ASIDE = 0.2  # [range] by which a monitor may lie off the command in the mean; judged
OTHER_CLOCK = 50.0  # [samples per second] ratio to those of the fit, from which it is a remark; judged
FEW_SAMPLES = 500  # [samples] of all recordings, below which it is one; judged
AT_ONCE = 0.8  # [correlation] of a monitor with the command from which it is not slow; judged
LATEST_S = 0.05  # [s] by which a displacement may follow and still be of this drive; judged
MIN_CORRELATION = 0.5  # [correlation] of command and displacement; judged
MIN_COHERENCE = 0.6  # [coherence] of both, where they do not correlate: through a resonance; judged
BEYOND = 0.05  # [range] by which drives may exceed what was recorded without a remark; judged
SPIKE = 0.3  # [of the movement] by which a single reading lies aside; judged
USUAL_SPIKE = 10.0  # [of the usual, between neighbours] ... and more than noise does; judged
FEW_SPIKES = 20  # [samples] more are no disturbed readings, but what happens; judged
GAIN_SPREAD = 5.0  # [1] ratio of two runs' um per V; judged
MODEL_SPREAD = 3.0  # [1] ratio of the model's um per V and a recording's; judged
OTHER_UNITS = 200.0  # [1] the same, from which it is a matter of units; judged
SAME_DRIVE = 0.005  # [range] two commands of the same drive differ at most: a converter's step, jitter; judged
LOST_DRIVE = 0.001  # [range] by which the drive of a thinned copy may differ, well within SAME_DRIVE; judged
LOST_NOISE = 1.6  # [noise] rms that a thinned copy may lose over a short window: all the noise, and its scatter; judged
LOST_RANGE = 1e-4  # [range] the same beside it, for recordings without noise; judged
DEAD = 0.25  # [range] that the command moves at the end while no reading changes; judged
DEAD_SHARE = 0.02  # [recording] that this takes at least; judged
DEAD_TIMES = 3.0  # [longest before] during which no reading changed, that this takes at least; judged
CLIPPED_SHARE = 0.01  # [samples] at the very highest or lowest reading while the command moves; judged

# --- does the reading stand still and jump? (stick_slip.py)
STILL = 4.0  # [noise] by which readings that stand still lie apart; rigs
LEAST_STILL = 1e-4  # [movement] the same of readings without noise; judged
JUMP = 3.0  # [movement] of the prediction at its fastest meanwhile, from which the reading jumps; rigs
CAUGHT_UP = 0.5  # [jump] that the prediction moves meanwhile; rigs
STUCK = 0.1  # [of the energy] that is missed there, from which it is a remark; judged
