"""Intervals of a model that leaves a correlated error of its own hold the truth as often as they say."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from diagnose.fit.fitted import Fitted

N = 4000


def fitted(rng, memory, rough=False):
    """A straight line of two numbers, fitted to a slow wave and an error that is remembered over some samples."""
    t = np.arange(N)
    X = np.column_stack([np.sin(2 * np.pi * t / 900), np.cos(2 * np.pi * t / 700)])
    forget = np.exp(-1.0 / memory) if memory else 0.0
    y = X @ [1.0, -0.5] + 3.0 * np.sqrt(1 - forget**2) * lfilter([1.0], [1.0, -forget], rng.standard_normal(N))
    x = np.linalg.lstsq(X, y, rcond=None)[0]
    r = y - X @ x
    entry = SimpleNamespace(slope=lambda v: 1.0)
    hypothesis = SimpleNamespace(entries=(entry, entry), rough=rough)
    return Fitted(hypothesis, SimpleNamespace(J=-X, residual=r, x=x, cost=float(r @ r)), N)


@pytest.mark.parametrize("memory", [0.0, 30.0])
def test_they_hold_the_truth(memory):
    rng = np.random.default_rng(5)
    held = []
    for _ in range(60):
        f = fitted(rng, memory)
        held += list(np.abs(f.fit.x - [1.0, -0.5]) < 1.96 * f.standard_errors())
    assert 0.88 <= np.mean(held) <= 0.995  # 120 draws of 0.95: three standard errors, and 40 clusters


def test_without_stretches_they_would_be_far_too_narrow():
    """Thirty samples of memory are worth an eighth of independent ones: the plain interval holds the truth in 4 of 10."""
    rng = np.random.default_rng(5)
    f = fitted(rng, 30.0)
    plain = np.sqrt(f.chi2 / N * np.diag(np.linalg.inv(f.fit.J.T @ f.fit.J)))
    assert np.all(f.standard_errors() > 3.0 * plain)
