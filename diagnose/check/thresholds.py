"""Every threshold of the checks, with its derivation. Levels of tests, physical bounds and tolerances; nothing else decides."""

from __future__ import annotations

from statistics import NormalDist

__all__ = [
    "ACTUATOR_DELAY", "CLIPPED_SHARE", "CONTENT_DROP", "DISTINCT", "EDGE_DROP", "EDGE_SLOPE", "EQUAL_NEIGHBOURS",
    "EXCESS_TOLD", "FAMILY_LEVEL", "FLOOR_SLOPE", "FOLLOWED", "HOLD_TOLERANCE", "IMPACTS", "IMPACT_NOISE",
    "INERTIA_RANGE", "INTERPOLATED", "JITTER_FIX", "JITTER_LIMIT", "MODE_RATE", "PARAMETER_FACTOR", "RANGE_FIX",
    "RATIO_TOLERANCE", "RESOLVED", "SHAPE_SPREAD", "SKEW_FIX", "STRAIGHT", "TESTS", "Z95", "Z_TEST",
]  # fmt: skip

FAMILY_LEVEL = 1e-3
"""Chance that one of the tests on estimates reports a fault of a sound log, over all of them together."""

TESTS = 12
"""Tests on estimates for one recording: delay, hold, delay and ratio between the channels, three ratios of two responses,
clip."""

Z_TEST = NormalDist().inv_cdf(1 - FAMILY_LEVEL / TESTS / 2)
"""Two-sided normal quantile of one test, Bonferroni over `TESTS`: 4.1 standard errors."""

Z95 = NormalDist().inv_cdf(0.975)

MODE_RATE = 5.0
"""Samples per period that a mode needs: it is out of reach from Nyquist / 2.5 on. Below five samples per period a held input
of the next sample turns the mode by more than a radian, and a linear interpolation of its motion is off by 18 % (1 - cos(pi
/ 5))."""

SHAPE_SPREAD = 0.25
"""Standard deviation of the logarithm of an inertia, stiffness or damping over its nominal value in the relation: most data
sheets are right to a quarter. It only keeps directions that the data do not show; a wrong value that the data show
overrules it."""

PARAMETER_FACTOR = 2.5
"""A parameter may be wrong by this factor without being a unit. The closest known factor (2 pi) is as far from 1 as 2.5
squared."""

DISTINCT = 5.0
"""Smallest factor that counts as a unit or a gear side: below it a scale may be a wrong parameter at both ends of the range
above."""

INERTIA_RANGE = 10.0
"""Factor by which an inertia of a fit may differ from the model's (`diagnose.problem.hypothesis`): beyond it every fit ends at
that bound."""

RATIO_TOLERANCE = 0.1
"""Relative distance between the ratio of angle to integrated velocity and a known factor: gains of sensors are known to some
per cent, and the known factors are further apart than that."""

RESOLVED = 0.2
"""Relative standard error from which a ratio to the model counts as determined: five standard errors from zero."""

ACTUATOR_DELAY = 3e-3
"""Delay [s] that a torque loop explains: a current loop of 50 Hz bandwidth lags by 1 / (2 pi 50) = 3 ms."""

SKEW_FIX = 10e-3
"""Delay of the response [s] beyond which no drive explains it: two cycles of a 250 Hz bus and a torque loop of 50 Hz. Between
`ACTUATOR_DELAY` and this a skew of the clocks and a transport delay are equivalent, and the log limits; a response ahead of its
cause is a skew whatever its size."""

JITTER_LIMIT = 0.05
"""Deviation of a stamp from the uniform grid, in samples, that rounding of printed stamps does not reach (the reader's
tolerance)."""

JITTER_FIX = 0.5
"""Deviation in samples at which neighbouring stamps may change places: the order of the samples is then not sure."""

CLIPPED_SHARE = 0.05
"""Part of the samples at a limit from which a response cannot be used: the share at which `diagnose.data.experiment` refuses."""

EQUAL_NEIGHBOURS = 1 / 3
"""Part of neighbouring samples that are equal, from which rounding hides the noise: Gaussian noise of rms s on a step d gives
d / (2 s sqrt(pi)), one third at s = 0.85 d."""

FLOOR_SLOPE = -1.0
"""Slope d log(density) / d log(f) over the upper half of the band, at which a channel is filtered: half way between white
noise (0) and a first-order filter (-2)."""

CONTENT_DROP = 1e-2
"""Density at the top of the band over that at a fifth of it, below which the content ends: a sensor's noise is as large at
both."""

EDGE_SLOPE = -8.0
"""Slope d log(density) / d log(f) of an edge: a filter of the fourth order. Behind two resonances a motion falls as fast, and
then by less than `EDGE_DROP` before it meets its noise."""

EDGE_DROP = 1e4
"""Ratio of densities on both sides of an edge: 1 % in amplitude."""

FOLLOWED = 0.8
"""Part of the input's variance that a relation must explain before its delay is reported: four fifths is a signal-to-noise ratio
of 2."""

HOLD_TOLERANCE = 0.25
"""Samples within which a delay is that of a hold: half of the half sample by which the holds differ."""

RANGE_FIX = 0.05
"""Part of the joint's range beyond which motion outside it is no play of a stop: stops of industrial joints give by less."""

IMPACTS = 3
"""Impacts at one end of the travel that are a stop: a knock from outside comes at any angle, and falls three times into the same
twentieth of the travel with a chance of 1e-4."""

IMPACT_NOISE = 6.0
"""Standard deviations of a velocity difference beyond which it is no noise: 2e-9 a sample, 2e-4 over 1e5 samples."""

STRAIGHT = 1e-6
"""Second difference over its rms, up to which a signal counts as straight: rounding of printed numbers; noise is below it with
probability 1e-6."""

INTERPOLATED = 0.4
"""Part of straight samples from which a signal is interpolated: one new point in every two leaves a half."""

EXCESS_TOLD = 0.25
"""Part of a torque limit: an excess beyond it of that size must be visible before its absence says that the drive is at its
limit."""
