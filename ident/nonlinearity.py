"""Is the system linear? A yes or no with a p value and a stated false-alarm rate.

Two experiments: detection lines of an odd random-phase multisine, and two levels of one excitation (a chirp).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.data import IOData, frozen
from ident.multisine import Multisine
from mjsim.errors import InputError

__all__ = ["AmplitudeTest", "BestLinearApproximation", "amplitude_test", "detection_lines"]


@dataclass(frozen=True)
class BestLinearApproximation:
    """Best linear approximation (BLA) with its disturbance levels.

    frequency_hz, response: at the excited lines. noise_db, odd_db, even_db: output level per line [dB re output unit] at the
    excited
    lines (noise) and at the detection lines at odd_hz, even_hz. p_odd, p_even: p values of "no distortion" from F tests of the
    power on the detection lines against the noise between periods. false_alarm_rate: of the joint verdict.
    """

    frequency_hz: NDArray
    response: NDArray
    noise_db: NDArray
    odd_hz: NDArray
    odd_db: NDArray
    even_hz: NDArray
    even_db: NDArray
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
            return f"No nonlinear distortion found (p = {self.p_value:.2g}, false-alarm rate {self.false_alarm_rate:g})."
        a = self.false_alarm_rate / 2
        kinds = [k for k, p in (("odd", self.p_odd), ("even", self.p_even)) if p < a]
        return (
            f"Nonlinear: {' and '.join(kinds)} distortion (p = {self.p_value:.2g}, false-alarm rate {self.false_alarm_rate:g})."
        )


def _db(power: NDArray) -> NDArray:
    return 10 * np.log10(np.maximum(power, 1e-300))


def detection_lines(data: IOData, multisine: Multisine, false_alarm_rate: float = 0.01, skip: int = 1) -> BestLinearApproximation:
    """Analyse whole periods of a multisine response; the first ``skip`` periods (transient) are dropped, at least two must
    remain.

    The noise variance per line is the scatter between periods; on each set of detection lines
    ``F = mean(P abs(Ybar)^2) / mean(var) ~ F(2 K, 2 K (P - 1))`` when the system is linear, P periods and K lines.
    """
    period = multisine.period
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

    def test(lines: NDArray) -> float:
        signal = periods * float(np.mean(np.abs(mean_y[lines]) ** 2))
        noise = float(np.mean(variance[lines])) + 1e-26 * peak  # rounding is no distortion
        return float(f_distribution.sf(signal / noise, 2 * lines.size, 2 * lines.size * (periods - 1)))

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

    frequency_hz: NDArray
    change_db: NDArray
    block_p: NDArray
    p_value: float
    false_alarm_rate: float

    @property
    def nonlinear(self) -> bool:
        """The verdict at the stated false-alarm rate."""
        return self.p_value < self.false_alarm_rate

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        tail = f"(p = {self.p_value:.2g}, false-alarm rate {self.false_alarm_rate:g})"
        if not self.nonlinear:
            return f"The frequency response does not move with the level {tail}."
        sure = np.where(self.block_p < self.false_alarm_rate, np.abs(self.change_db), 0.0)
        worst = int(np.argmax(sure))
        return (
            f"Nonlinear: the frequency response moves with the level, by {self.change_db[worst]:+.1f} dB "
            f"at {self.frequency_hz[worst]:.3g} Hz {tail}."
        )


def _fit(columns: NDArray, target: NDArray) -> tuple[NDArray, float]:
    """Complex least squares: coefficients and residual sum of squares."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    weights = np.linalg.lstsq(columns / scale, target, rcond=1e-12)[0] / scale
    return weights, float(np.sum(np.abs(target - columns @ weights) ** 2))


def amplitude_test(low: IOData, high: IOData, false_alarm_rate: float = 0.01, block: int = 24) -> AmplitudeTest:
    """Test whether one excitation (a chirp, a multisine) at two levels sees one frequency response.

    In each block of ``block`` excited lines both records are fitted by ``Y = G U + T`` with G and the transient term T
    parabolas in
    frequency (local polynomial method: Pintelon & Schoukens, 2nd ed., chapter 7), once with a common G and once with a G each.
    The
    loss of the common one gives ``F ~ F(6, 2 (2 block - 12))`` per block when the system is linear; the record's noise powers are
    brought to one level first, by their ratio over all blocks. Records of equal length and sampling interval, noise Gaussian.
    """
    if len(low) != len(high) or abs(low.dt / high.dt - 1) > 1e-9:
        raise InputError(
            "amplitude test", f"{len(low)} samples of {low.dt:g} s and {len(high)} of {high.dt:g} s", "equal records"
        )
    if block < 14:
        raise InputError("amplitude test", f"blocks of {block} lines", "at least 14")
    from scipy.stats import chi2
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

    # per block: separate fits of both records
    own = [[_fit(np.hstack([powers * u[k, None], powers]), y[k]) for u, y in ((ul, yl), (uh, yh))] for k in blocks]
    ratio = np.sqrt(sum(o[0][1] for o in own) / max(sum(o[1][1] for o in own), 1e-300))
    if not np.isfinite(ratio) or ratio == 0.0:
        ratio = 1.0
    p, change = [], []
    none = np.zeros((block, 3))
    for k, (fit_low, fit_high) in zip(blocks, own, strict=True):
        common = np.vstack(
            [np.hstack([powers * ul[k, None], powers, none]), ratio * np.hstack([powers * uh[k, None], none, powers])]
        )
        _, together = _fit(common, np.r_[yl[k], ratio * yh[k]])
        apart = fit_low[1] + ratio**2 * fit_high[1]
        rounding = 1e-24 * float(np.sum(np.abs(yl[k]) ** 2) + ratio**2 * np.sum(np.abs(yh[k]) ** 2))
        free = 2 * (2 * block - 12)
        statistic = max(0.0, together - apart) / 6 / ((apart + rounding) / free)
        p.append(float(f_distribution.sf(statistic, 6, free)))
        change.append(20 * np.log10(max(abs(fit_high[0][0]), 1e-300) / max(abs(fit_low[0][0]), 1e-300)))
    joint = float(chi2.sf(-2 * float(np.sum(np.log(np.maximum(p, 1e-300)))), 2 * count))
    centres = np.array([frequency[k].mean() for k in blocks])
    return AmplitudeTest(frozen(centres), frozen(change), frozen(p), joint, false_alarm_rate)
