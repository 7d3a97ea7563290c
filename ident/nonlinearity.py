"""Is the system linear? A yes or no with a p value and a stated false-alarm rate.

Two experiments: detection lines of an odd random-phase multisine, and two levels of one excitation (a chirp).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.data import IOData, frozen
from ident.multisine import Multisine
from ident.residuals import p_text
from mjsim.errors import InputError

__all__ = ["AmplitudeTest", "BestLinearApproximation", "amplitude_test", "detection_lines"]


@dataclass(frozen=True)
class BestLinearApproximation:
    """Best linear approximation (BLA) with its disturbance levels.

    frequency_hz, response: at the excited lines. noise_db, odd_db, even_db: output level per line [dB re output unit] at the
    excited lines (noise) and at the detection lines at odd_hz, even_hz. p_odd, p_even: p values of "no distortion" from the power
    on the detection lines against the noise between periods. false_alarm_rate: of the joint verdict.
    """

    frequency_hz: np.ndarray
    response: np.ndarray
    noise_db: np.ndarray
    odd_hz: np.ndarray
    odd_db: np.ndarray
    even_hz: np.ndarray
    even_db: np.ndarray
    p_odd: float
    p_even: float
    false_alarm_rate: float

    @property
    def p_value(self) -> float:
        """Of linearity: Bonferroni over the two tests."""
        return min(1.0, 2.0 * min(self.p_odd, self.p_even))

    @property
    def nonlinear(self) -> bool:
        """The verdict at the stated false-alarm rate."""
        return self.p_value < self.false_alarm_rate

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        if not self.nonlinear:
            return f"No nonlinear distortion found ({p_text(self.p_value)}, false-alarm rate {self.false_alarm_rate:g})."
        a = self.false_alarm_rate / 2
        kinds = [k for k, p in (("odd", self.p_odd), ("even", self.p_even)) if p < a]
        return (
            f"Nonlinear: {' and '.join(kinds)} distortion ({p_text(self.p_value)}, false-alarm rate {self.false_alarm_rate:g})."
        )


ROUNDING = 1e-26
"""Power relative to the largest line's below which a detection line holds rounding, not distortion."""


def _together(p: np.ndarray) -> float:
    """One p value out of independent ones, (K,): Fisher's combination, ``-2 sum ln p ~ chi2(2 K)``."""
    from scipy.stats import chi2

    return float(chi2.sf(-2 * float(np.sum(np.log(np.maximum(p, 1e-300)))), 2 * p.size))


def _db(power: np.ndarray) -> np.ndarray:
    level: np.ndarray = 10 * np.log10(np.maximum(power, 1e-300))
    return level


def detection_lines(data: IOData, multisine: Multisine, false_alarm_rate: float = 0.01, skip: int = 1) -> BestLinearApproximation:
    """Analyse whole periods of a multisine response; the first ``skip`` periods (transient) are dropped, at least two must
    remain.

    The noise variance per line is the scatter between periods. When the system is linear, ``F_k = P abs(Ybar_k)^2 / var_k`` is
    F(2, 2 (P - 1)) on each detection line, P periods (Pintelon & Schoukens, 2nd ed., section 4.3); the lines of a set are put
    together by Fisher's combination, so that each is judged against its own noise and coloured noise raises no alarm. Assumes
    noise that is stationary with a memory short against a period, and a steady response.

    Raises InputError for fewer than two periods after the skipped ones, and for another sampling interval than the multisine's.
    """
    period = multisine.period
    if abs(data.dt / multisine.dt - 1) > 1e-9:
        raise InputError(data.source, f"dt = {data.dt:g} s, the multisine's is {multisine.dt:g} s", "equal sampling intervals")
    periods = len(data) // period - skip
    if periods < 2:
        raise InputError(
            data.source, f"{len(data) / period:.1f} periods", f"at least {skip + 2}", "repeat the multisine more often"
        )
    from scipy.stats import f as f_distribution

    start = skip * period
    y = np.fft.rfft(np.asarray(data.y)[start : start + periods * period].reshape(periods, period), axis=1) / period
    u = np.fft.rfft(np.asarray(data.u)[start : start + periods * period].reshape(periods, period), axis=1) / period
    mean_y, mean_u = y.mean(axis=0), u.mean(axis=0)
    variance = np.sum(np.abs(y - mean_y) ** 2, axis=0) / (periods - 1)
    f = np.arange(period // 2 + 1) / (period * multisine.dt)
    peak = float(np.max(np.abs(mean_y[multisine.excited]) ** 2))

    def test(lines: np.ndarray) -> float:
        signal = periods * np.abs(mean_y[lines]) ** 2
        noise = variance[lines] + ROUNDING * peak
        return _together(f_distribution.sf(signal / noise, 2, 2 * (periods - 1)))

    odd, even, on = multisine.odd_detection, multisine.even_detection, multisine.excited
    return BestLinearApproximation(
        frozen(f[on]),
        frozen(mean_y[on] / mean_u[on], complex),
        frozen(_db(4 * variance[on] / periods)),
        frozen(f[odd]),
        frozen(_db(4 * np.abs(mean_y[odd]) ** 2)),
        frozen(f[even]),
        frozen(_db(4 * np.abs(mean_y[even]) ** 2)),
        test(odd),
        test(even),
        false_alarm_rate,
    )


@dataclass(frozen=True)
class AmplitudeTest:
    """Whether the frequency response moves with the level.

    frequency_hz: (B,) block centres. change_db: abs(G) at the high level over abs(G) at the low one. block_p: p value per block.
    p_value: of linearity, all blocks together (Fisher's combination).
    """

    frequency_hz: np.ndarray
    change_db: np.ndarray
    block_p: np.ndarray
    p_value: float
    false_alarm_rate: float

    @property
    def nonlinear(self) -> bool:
        """The verdict at the stated false-alarm rate."""
        return self.p_value < self.false_alarm_rate

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        tail = f"({p_text(self.p_value)}, false-alarm rate {self.false_alarm_rate:g})"
        if not self.nonlinear:
            return f"The frequency response does not move with the level {tail}."
        sure = np.where(self.block_p < self.false_alarm_rate, np.abs(self.change_db), 0.0)
        worst = int(np.argmax(sure))
        return (
            f"Nonlinear: the frequency response moves with the level, by {self.change_db[worst]:+.1f} dB "
            f"at {self.frequency_hz[worst]:.3g} Hz {tail}."
        )


def _fit(columns: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, float]:
    """Complex least squares: coefficients and residual sum of squares."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    weights = np.linalg.lstsq(columns / scale, target, rcond=1e-12)[0] / scale
    return weights, float(np.sum(np.abs(target - columns @ weights) ** 2))


SMALLEST_BLOCK = 14
"""Lines per block: six coefficients, and as many degrees of freedom again for the noise."""


def amplitude_test(low: IOData, high: IOData, false_alarm_rate: float = 0.01, block: int = 24) -> AmplitudeTest:
    """Test whether one excitation (a chirp, a multisine) at two levels sees one frequency response.

    With one G at both levels, ``D = Y_high - Y_low U_high / U_low`` holds noise and transients only, whatever the shape of G: a
    resonance between two lines is no nonlinearity. In each block of ``block`` excited lines D is fitted by ``dG U_high + T`` with
    the change dG of the response and the transient term T parabolas in frequency (after the local polynomial method: Pintelon &
    Schoukens, 2nd ed., chapter 7). What dG takes off the residual gives ``F ~ F(6, 2 (block - 6))`` per block when the system is
    linear; Fisher's combination joins the blocks. Lines count by ``1 / (1 + abs(U_high / U_low)^2)``, exact when both records
    have one noise level and when their inputs are proportional.

    Assumes records that start in one state (at rest), inputs known without noise, stationary Gaussian noise that is flat over a
    block. Raises InputError for records of unequal length or sampling interval and for too few excited lines.
    """
    if len(low) != len(high) or abs(low.dt / high.dt - 1) > 1e-9:
        raise InputError(
            f"{low.source} against {high.source}",
            f"{len(low)} samples of {low.dt:g} s and {len(high)} of {high.dt:g} s",
            "equal records of one excitation at two levels",
            "cut the longer one",
        )
    if block < SMALLEST_BLOCK:
        raise InputError("amplitude test", f"blocks of {block} lines", f"at least {SMALLEST_BLOCK}")
    from scipy.stats import f as f_distribution

    ul, yl, uh, yh = (np.fft.rfft(x) for x in (low.u, low.y, high.u, high.y))
    frequency = np.fft.rfftfreq(len(low), low.dt)
    level = [0.1 * np.quantile(np.abs(u), 1 - min(0.5, 20 / u.size)) for u in (ul, uh)]
    lines = np.flatnonzero((np.abs(ul) > level[0]) & (np.abs(uh) > level[1]) & (frequency > 0))
    count = lines.size // block
    if count < 1:
        raise InputError("amplitude test", f"{lines.size} excited lines", f"at least {block}", "record longer")
    blocks = [lines[i * block : (i + 1) * block] for i in range(count)]
    powers = np.vander(np.linspace(-1, 1, block), 3, increasing=True)
    free = 2 * (block - 6)

    p, change = [], []
    for k in blocks:
        ratio = uh[k] / ul[k]
        weight = 1.0 / np.sqrt(1.0 + np.abs(ratio) ** 2)
        difference = weight * (yh[k] - ratio * yl[k])
        transient = weight[:, None] * powers
        moved, apart = _fit(np.hstack([transient * uh[k, None], transient]), difference)
        _, together = _fit(transient, difference)
        rounding = 1e-24 * float(np.sum(np.abs(weight * yh[k]) ** 2 + np.abs(weight * ratio * yl[k]) ** 2))
        statistic = max(0.0, together - apart) / 6 / ((apart + rounding) / free)
        p.append(float(f_distribution.sf(statistic, 6, free)))
        own = _fit(np.hstack([powers * ul[k, None], powers]), yl[k])[0][0]
        change.append(20 * np.log10(max(abs(own + moved[0]), 1e-300) / max(abs(own), 1e-300)))
    centres = np.array([frequency[k].mean() for k in blocks])
    return AmplitudeTest(frozen(centres), frozen(change), frozen(p), _together(np.array(p)), false_alarm_rate)
