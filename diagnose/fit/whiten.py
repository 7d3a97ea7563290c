"""The colour of the residual: an autoregressive filter that whitens it, so that its correlation is counted.

By least squares over the stretches that count (the covariance method), order by BIC. The residual's autocorrelation would take
it for zero beyond their ends, and each end for an innovation as large as the residual itself: noise 19 times as large as its
innovations came out with a third coefficient of 0.10, which it has not. Source: L. Ljung, System Identification (1999), ch. 10.1.
"""

from __future__ import annotations

import numpy as np

from diagnose.data.experiment import Experiment
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Status
from diagnose.thresholds import MATERIAL
from mjsim.signals import freqz

__all__ = [
    "autoregression",
    "effective_share",
    "effective_share_between",
    "effective_share_of_errors",
    "innovation",
    "lagged_products",
    "lags_of",
    "levinson",
    "noise_psd",
    "noise_rms",
    "offset_share",
    "same_filter",
    "tempered_prior_weight",
    "whitened_fit",
    "whitening_filter",
]


def levinson(r: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """AR polynomial (order + 1,), monic, and the innovation variances of all orders 0..order from autocovariances r."""
    a = np.zeros(order + 1)
    a[0] = 1.0
    variance = np.empty(order + 1)
    variance[0] = r[0]
    for m in range(1, order + 1):
        if not variance[m - 1] > 0:  # nothing is left to predict
            variance[m:] = variance[m - 1]
            break
        k = -float(a[:m] @ r[m:0:-1]) / variance[m - 1]
        a[1 : m + 1] += k * a[m - 1 :: -1][:m]
        variance[m] = variance[m - 1] * (1 - k * k)
    return a, variance


def autoregression(products: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """AR polynomial (order + 1,), monic, and the innovations' sums of squares of all orders 0..order.

    ``products``: those of the samples with the ones before them, as `lagged_products` gives.
    """
    a = np.ones(1)
    left = [float(products[0, 0])]
    for m in range(1, order + 1):
        before = np.linalg.lstsq(products[1 : m + 1, 1 : m + 1], -products[1 : m + 1, 0], rcond=1e-14)[0]
        a = np.concatenate([[1.0], before])
        left.append(max(float(products[0, 0] + before @ products[1 : m + 1, 0]), 0.0))
    return a, np.array(left)


def lagged_products(e: np.ndarray, largest: int) -> np.ndarray:
    """Sums over t of e[t - i] e[t - j] (largest + 1, largest + 1), t from ``largest`` on: nothing is supposed before e (N,)."""
    n, p = len(e), largest
    out = np.empty((p + 1, p + 1))
    out[0] = [float(e[p:] @ e[p - j : n - j]) for j in range(p + 1)]
    ahead, last = e[p - 1 :: -1], e[n - 1 : n - 1 - p : -1]
    for i in range(p):
        out[i + 1, 1:] = out[i, :-1] + ahead[i] * ahead - last[i] * last
        out[i + 1, 0] = out[0, i + 1]
    return out


def _stretches(counts: np.ndarray, least: int) -> list[slice]:
    """Stretches of at least so many samples in a row that count."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], counts, [False]]).astype(np.int8)))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= least]


def _order_left(counts: np.ndarray, largest: int) -> int:
    """The highest order of a filter, up to ``largest``, that leaves half of the samples that count (N,) bool."""
    lengths = np.array([s.stop - s.start for s in _stretches(counts, 1)])
    return next((p for p in range(largest, 0, -1) if 2 * int(np.sum(np.maximum(lengths - p, 0))) >= int(counts.sum())), 0)


def effective_share(fitter: Fitter, fitted: Fitted, lags: int = 200) -> float:
    """Effective sample size over the number of samples, 1 / (1 + 2 sum rho_k^2), from the residual of the first experiment.

    Source: M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536. Used where the residual is the model's own error rather than
    sensor noise:
    a filter would weigh such errors by their colour, not by what they mean.
    """
    experiment = fitter.experiments[0]
    e = fitter.error_of(fitted, 0)
    if e is None:
        return 1.0
    e = np.where(fitter.counted(experiment), e, 0.0)
    lags = min(lags, len(e) // 4)
    return float(1.0 / (1.0 + 2.0 * np.sum(_correlation(e, lags) ** 2)))


def tempered_prior_weight(fitter: Fitter, f: Fitted) -> float:
    """Weight by which a prior on the nominal linear parameters counts beside what a structure leaves.

    Such an error is correlated: its effective sample size is small, and its variance is as large as the misfit.
    """
    return f.chi2 / f.n / effective_share(fitter, f)


def effective_share_between(fitter: Fitter, poorer: Fitted, richer: Fitted, span: float = 2.0) -> float:
    """Effective sample size, over the number of samples, to distinguish two models: 1 / (1 + 2 sum rho_k sigma_k).

    rho: autocorrelation of the richer model's residual, sigma: that of the difference of the two predictions, over a ``span`` [s]
    of the first experiment. A slow error says little about a slow effect and much about a fast one. The poorer model's
    residual would not do: it holds the effect itself, and is the more correlated the more there is to find.
    Source: M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536, for the correlation of two series.
    """
    experiment = fitter.experiments[0]
    errors = []
    for f in (poorer, richer):
        e = fitter.error_of(f, 0)
        if e is None:
            return 1.0
        errors.append(np.where(fitter.counted(experiment), e, 0.0))
    return effective_share_of_errors(errors[0] - errors[1], errors[1], lags_of(fitter, span))


def lags_of(fitter: Fitter, span: float = 2.0) -> int:
    """Compared samples in a span [s]."""
    return round(span / (fitter.experiments[0].recording.dt * fitter.view.decimate))


def effective_share_of_errors(difference: np.ndarray, left: np.ndarray, lags: int) -> float:
    """The share of `effective_share_between` from the difference (N,) of two predictions and the residual (N,) of the better."""
    lags = min(lags, len(left) // 4)
    rho, sigma = _correlation(left, lags), _correlation(difference, lags)
    return 1.0 / max(1.0, 1.0 + 2.0 * float(rho @ sigma))


def _correlation(e: np.ndarray, lags: int) -> np.ndarray:
    """Autocorrelation at lags 1 to ``lags``; zero for a signal that is zero."""
    r = np.array([float(e[: len(e) - k] @ e[k:]) for k in range(lags + 1)])
    return r[1:] / r[0] if r[0] > 0 else np.zeros(lags)


def whitening_filter(fitter: Fitter, fitted: Fitted, largest: int = 24, material: float = MATERIAL) -> np.ndarray | None:
    """The filter for the residual of a fitted model, or None when it is white to within ``material`` of its variance.

    Its order is at most ``largest``, and so low that half of the samples that count are left: a filter of order p takes the
    first p of every stretch of them.
    """
    largest = min(_order_left(fitter.counted(e), largest) for e in fitter.experiments)
    if largest == 0:
        return None
    total = np.zeros((largest + 1, largest + 1))
    n = 0
    for i, experiment in enumerate(fitter.experiments):
        e, counts = fitter.error_of(fitted, i), fitter.counted(experiment)
        if e is None:
            return None
        e = np.where(counts, e, 0.0) / fitter.sigma(experiment)
        pieces = _stretches(counts, 2 * largest)
        if 2 * sum(s.stop - s.start for s in pieces) < counts.sum():  # what counts is in pieces: as if zeros were between them
            e, pieces = np.concatenate([np.zeros(largest), e, np.zeros(largest)]), [slice(None)]
            n += int(counts.sum())
        else:
            n += sum(s.stop - s.start - largest for s in pieces)
        for s in pieces:
            total += lagged_products(e[s], largest)
    _, left = autoregression(total, largest)
    bic = n * np.log(np.maximum(left / n, 1e-300)) + np.log(n) * np.arange(largest + 1)
    order = int(np.argmin(bic))
    if order == 0 or 1 - left[order] / left[0] < material:
        return None
    return autoregression(total, order)[0]


def offset_share(fitter: Fitter, fitted: Fitted, blocks: int = 20, sure: float = 1e-4) -> float:
    """Largest share of a residual's mean square, over the experiments, that its mean has; of means that stand out only.

    The mean of coloured noise differs from zero as well: by the means of ``blocks`` of it, each long beside its memory, it must
    be no chance (two-sided Student's t at ``sure``).
    """
    from scipy.special import stdtr

    shares = [0.0]
    for i, experiment in enumerate(fitter.experiments):
        e = fitter.error_of(fitted, i)
        if e is not None:
            e = e[fitter.counted(experiment)]
            means = np.array([float(np.mean(part)) for part in np.array_split(e, blocks)])
            t = abs(float(np.mean(means))) / (float(np.std(means, ddof=1)) / np.sqrt(blocks) + 1e-300)
            if 2.0 * float(stdtr(blocks - 1, -t)) < sure:
                shares.append(float(np.mean(e) ** 2 / max(np.mean(e**2), 1e-300)))
    return max(shares)


def innovation(fitter: Fitter, fitted: Fitted, filter_: np.ndarray) -> float:
    """Rms of a fitted model's weighted error behind a monic filter: divided by it, the filter leaves errors of rms one.

    The weight is taken from the fastest part of the noise, which says little of the whole where the noise is coloured.
    """
    by, total, count = fitter.relax(whitening=filter_), 0.0, 0
    for i, experiment in enumerate(fitter.experiments):
        e = fitter.error_of(fitted, i)
        if e is not None:
            w, keep = by.whitened(e, experiment)
            total += float(np.sum(w[keep] ** 2))
            count += int(np.sum(keep))
    return float(np.sqrt(total / count)) if total > 0 else 1.0


def same_filter(a: np.ndarray, b: np.ndarray, tolerance: float = MATERIAL) -> bool:
    """Whether two filters differ by less than ``tolerance`` in each coefficient."""
    width = max(len(a), len(b))
    return bool(np.max(np.abs(np.pad(a, (0, width - len(a))) - np.pad(b, (0, width - len(b))))) < tolerance)


def whitened_fit(fitter: Fitter, fitted: Fitted, rounds: int = 8) -> tuple[np.ndarray, Fitted] | None:
    """A structure fitted on errors that its own filter whitens, and that filter; None where its errors are white.

    The structure is refitted on filtered errors and the filter taken from what it leaves, in turns.

    Under feedback coloured noise is in the recorded torque as well, so that a fit on plain errors takes part of the noise for
    response, and a filter from its residual keeps that. Turns end at the prediction-error estimate with an autoregressive
    noise model, which feedback does not bias. Source: D. Cochrane, G. H. Orcutt, J. Am. Stat. Assoc. 44 (1949) 32; Ljung
    (1999), ch. 13.4.
    """
    now, current = whitening_filter(fitter, fitted), fitted
    if now is None:
        return None
    for _ in range(rounds):
        current = fitter.relax(whitening=now).fit(current.hypothesis, current.fit.x, iterations=12)
        new = whitening_filter(fitter, current)
        if not current.ok or new is None:
            break
        settled = same_filter(new, now, 2e-3) and current.fit.status is not Status.BUDGET
        now = new
        if settled:
            break
    return now, current


def noise_psd(fitter: Fitter, experiment: Experiment, angles: np.ndarray) -> np.ndarray:
    """Power of the noise in the judged channel at frequencies (k,) [rad/sample], coloured as the filter of the search has it.

    As squares per sample: its mean over all angles is the mean square of the noise.
    """
    return np.asarray((fitter.sigma(experiment) / np.abs(freqz(fitter.whitening, np.ones(1), angles))) ** 2)


def noise_rms(fitter: Fitter, experiment: Experiment, grid: int = 2**14) -> float:
    """Rms of the noise in the judged channel: that of white noise is what errors are weighed by, of coloured noise it is more."""
    if len(fitter.whitening) == 1:
        return fitter.sigma(experiment)
    angles = (np.arange(grid) + 0.5) * np.pi / grid  # which makes no difference between a pole and its image in the unit circle
    return float(np.sqrt(np.mean(noise_psd(fitter, experiment, angles))))
