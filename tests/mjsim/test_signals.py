"""Filters and power densities against those of `scipy.signal`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from mjsim.signals import coherence, freqz, lfilter, transforms, welch

seeds = st.integers(0, 2**31)


def stable(rng: np.random.Generator, order: int) -> np.ndarray:
    return np.poly(rng.uniform(0.0, 0.95, order) * np.exp(1j * rng.uniform(0, np.pi, order))).real * rng.uniform(0.5, 2.0)


@settings(deadline=None)
@given(
    seed=seeds, order=st.integers(0, 5), taps=st.integers(1, 6), n=st.integers(1, 300), columns=st.sampled_from([(), (1,), (3,)])
)
def test_a_filter_is_that_of_scipy(seed: int, order: int, taps: int, n: int, columns: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    b, a, x = rng.standard_normal(taps), stable(rng, order), rng.standard_normal((n, *columns))
    y = lfilter(b, a, x)
    assert y.shape == x.shape
    np.testing.assert_allclose(y, signal.lfilter(b, a, x, axis=0), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(lfilter(b, a, x, delay=2)[2:], y[:-2], rtol=1e-9, atol=1e-11)  # poles near one carry rounding on
    w = np.linspace(0.0, np.pi, 40)
    np.testing.assert_allclose(freqz(b, a, w), signal.freqz(b, a, w)[1], rtol=1e-9, atol=1e-12)


@settings(deadline=None)
@given(seed=seeds, n=st.integers(40, 700), length=st.integers(8, 40), level=st.booleans())
def test_densities_are_those_of_scipy(seed: int, n: int, length: int, level: bool) -> None:
    rng = np.random.default_rng(seed)
    dt, (u, y) = rng.uniform(1e-4, 2.0), rng.standard_normal((2, n)) + 1.0
    f, p = welch(u, dt, length, level=level)
    f0, p0 = signal.welch(u, 1 / dt, nperseg=length, detrend=False if level else "constant")
    np.testing.assert_allclose(f, f0)
    np.testing.assert_allclose(p, p0, rtol=1e-7, atol=1e-12 * p0.max())
    (_, U), (_, Y) = transforms(u, dt, length), transforms(y, dt, length)
    _, cross = signal.csd(u, y, 1 / dt, nperseg=length)
    np.testing.assert_allclose(np.mean(np.conj(U) * Y, axis=0), cross, rtol=1e-7, atol=1e-12 * p0.max())
    inner = slice(1, None)  # the mean that was taken away leaves nothing to compare at f = 0
    known = signal.coherence(u, y, nperseg=length)[1][inner]
    np.testing.assert_allclose(coherence(u, y, length)[inner], known, rtol=1e-6, atol=1e-9)


def test_power_is_that_of_the_signal() -> None:
    rng = np.random.default_rng(0)
    x = 3.0 * rng.standard_normal(40_000)
    f, p = welch(x, 0.002, 512)
    assert np.sum(p) * (f[1] - f[0]) == pytest.approx(9.0, rel=0.03)
