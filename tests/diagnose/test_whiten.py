"""The whitening filter and the effective number of samples, against NumPy and against processes of known colour."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from diagnose.data.experiment import prepare
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Status
from diagnose.fit.whiten import (
    autoregression,
    effective_share,
    innovation,
    lagged_products,
    levinson,
    noise_rms,
    offset_share,
    whitened_fit,
    whitening_filter,
)
from diagnose.problem.view import MotionView


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(0, 10**6))
def test_levinson_solves_the_yule_walker_equations(order, seed):
    x = np.random.default_rng(seed).standard_normal(400)
    r = np.array([x[: len(x) - k] @ x[k:] for k in range(order + 1)])
    a, variance = levinson(r, order)
    expected = np.append(1.0, solve_toeplitz(r[:-1], -r[1:]))
    np.testing.assert_allclose(a, expected, atol=1e-9)
    assert variance[-1] == pytest.approx(r[0] + expected[1:] @ r[1:])
    assert np.all(np.diff(variance) <= 1e-12 * r[0])


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(0, 10**6))
def test_an_autoregression_is_least_squares_over_the_samples_that_have_a_past(order, seed):
    x = np.cumsum(np.random.default_rng(seed).standard_normal(300)) + 5.0
    a, left = autoregression(lagged_products(x, order), order)
    past = np.stack([x[order - k : len(x) - k] for k in range(1, order + 1)], axis=1)
    expected, *_ = np.linalg.lstsq(past, -x[order:], rcond=None)
    np.testing.assert_allclose(a[1:], expected, atol=1e-5)
    assert left[-1] == pytest.approx(float(np.sum((x[order:] + past @ expected) ** 2)), rel=1e-6)
    assert np.all(np.diff(left) <= 1e-9 * left[0])


def test_noise_far_larger_than_its_innovations_is_whitened_by_its_own_poles(record, robot):
    """By its autocorrelation, which takes it for nought beyond its ends, it had a third coefficient of 0.1."""
    innovations = np.random.default_rng(5).standard_normal(8000)
    poles = np.poly([0.922 + 0.061j, 0.922 - 0.061j]).real
    noise = 0.004 * lfilter([1.0], poles, innovations)[-6000:]
    fitter, f = fitted(record, robot, noise)
    found = whitening_filter(fitter, f)
    assert len(found) == 3
    np.testing.assert_allclose(found, poles, atol=0.02)
    # with rows that were not measured: those stretches alone
    counts = np.ones(6000, bool)
    counts[np.random.default_rng(6).integers(0, 6000, 20)] = False
    fitter, f = fitted(record, robot, noise)
    (experiment,) = fitter.experiments
    part = dataclasses.replace(experiment, counts=counts)
    fitter = fitter.related(fitter.problem.on((part,), (experiment,)))
    np.testing.assert_allclose(whitening_filter(fitter, f)[:3], poles, atol=0.05)
    counts[::30] = False  # no stretch is long enough
    assert whitening_filter(fitter, f) is not None


def fitted(record, robot, noise):
    """A fitter whose residual at the true axis is a given noise."""
    r = record(changed=False, noise=0.0, seconds=3.0)
    r = dataclasses.replace(r, velocity=r.velocity + noise)
    fitter = Fitter(robot, MotionView(), (prepare(r),), (prepare(r),), 1)
    return fitter, fitter.fit(fitter.hypothesis(()), iterations=0)


def test_white_noise_needs_no_filter(record, robot):
    white = 0.05 * np.random.default_rng(0).standard_normal(6000)
    fitter, f = fitted(record, robot, white)
    assert whitening_filter(fitter, f) is None
    # 200 lags, each with a squared correlation of 1/n by chance
    assert effective_share(fitter, f) == pytest.approx(1 / (1 + 2 * 200 / 6000), rel=0.05)


def test_coloured_noise_is_whitened(record, robot):
    coloured = lfilter([1.0], [1.0, -0.8], 0.05 * np.random.default_rng(0).standard_normal(6000))
    fitter, f = fitted(record, robot, coloured)
    filter_ = whitening_filter(fitter, f)
    assert filter_ is not None
    white = lfilter(filter_, [1.0], coloured)[20:]
    rho = np.array([white[:-k] @ white[k:] for k in range(1, 20)]) / (white @ white)
    assert np.max(np.abs(rho)) < 4 / np.sqrt(len(white))
    assert noise_rms(fitter, fitter.experiments[0]) == fitter.sigma(fitter.experiments[0])
    whitened = fitter.relax(whitening=filter_ / innovation(fitter, f, filter_))
    assert noise_rms(whitened, whitened.experiments[0]) == pytest.approx(0.05 / np.sqrt(1 - 0.64), rel=0.05)
    # sum of .8^(2k) is 1.78: one sample in 4.6 counts
    assert effective_share(fitter, f) == pytest.approx(1 / (1 + 2 * 0.64 / 0.36), rel=0.15)


def test_a_filter_is_not_settled_before_the_fit_behind_it_is(record, robot, monkeypatch):
    """One that stayed as it was ended the turns while its fit was still on its way: a null under feedback was `unexplained`."""
    noise = lfilter([1.0], [1.0, -0.85], 0.05 * np.random.default_rng(2).standard_normal(6000))
    fitter, _ = fitted(record, robot, noise)
    begin = fitter.fit(fitter.hypothesis((), {p.name: 1.3 * p.value for p in robot.chain.linear_parameters()}), iterations=0)
    fit, few = Fitter.fit, []

    def short(self, h, x0=None, **how):
        few.append(1)
        return fit(self, h, x0, **{**how, "iterations": 2})

    monkeypatch.setattr(Fitter, "fit", short)
    filter_, settled = whitened_fit(fitter, begin)
    assert len(few) > 2
    assert settled.fit.status is Status.CONVERGED or len(few) == 8
    np.testing.assert_allclose(filter_[1], -0.85, atol=0.03)


def test_the_mean_of_coloured_noise_is_no_offset():
    """One per cent of the mean square and more lies in the mean of noise whose memory is a hundred samples."""
    rng = np.random.default_rng(3)
    all_count = np.ones(20000, bool)
    left = SimpleNamespace(experiments=(None,), counted=lambda _: all_count, error_of=lambda fitted, _: fitted)
    shares, told, offsets = [], [], []
    for _ in range(100):
        e = lfilter([1.0], [1.0, -0.99], rng.standard_normal(22000))[2000:]
        e /= np.sqrt(np.mean(e**2))
        shares.append(np.mean(e) ** 2 / np.mean(e**2))
        told.append(offset_share(left, e))
        offsets.append(offset_share(left, e + 0.8))
    assert np.mean(np.array(shares) > 0.01) > 0.2, "else there is nothing to show"
    assert np.mean(np.array(told) > 0) <= 0.01
    assert np.mean(np.array(offsets) > 0.2) > 0.95
