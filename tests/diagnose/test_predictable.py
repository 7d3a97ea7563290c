"""What a residual still holds: the motion that two sensors share, and what a dictionary predicts of held-out samples."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t as student

from diagnose.evidence import predictable
from diagnose.evidence.predictable import Structure, _encoder_error, _shared, remaining_structure

DT = 1e-3


def run(speed, rate, k, within=None, counts=None):
    """Errors of velocity and angle by their means over windows of ``k`` samples; ``within``: spread of the former in a window."""
    n = len(speed) * k
    velocity = np.repeat(speed, k) + (0.0 if within is None else within * np.resize([1.0, -1.0], n))
    angle = np.append(0.0, np.cumsum(np.repeat(rate, k)) * DT)
    return velocity, angle, np.ones(n + 1, bool) if counts is None else counts, DT


def by_hand(speed, rate, within):
    """(mean, four standard errors, noise) of the products of both means."""
    p = speed * rate
    spread = min(float(np.std(p, ddof=1)), 0.5 * math.sqrt(float(np.mean((speed - rate) ** 4))))
    return float(np.mean(p)), 4.0 * spread / math.sqrt(len(p)), float(np.mean((speed - rate) ** 2)) + within**2


@pytest.mark.parametrize("k", [2, 5])
def test_shared_motion_is_told_over_the_noise_variance(k):
    rng = np.random.default_rng(1)
    motion = rng.standard_normal(60)
    speed, rate = motion + 0.1 * rng.standard_normal(60), motion + 0.1 * rng.standard_normal(60)
    mean, least, noise = by_hand(speed, rate, 0.3 if k % 2 == 0 else 0.0)
    assert mean > least
    errors = run(speed, rate, k, 0.3 if k % 2 == 0 else None)
    assert _shared([errors], k * DT) == pytest.approx(mean / noise)


@pytest.mark.parametrize("burst", [False, True])
@pytest.mark.parametrize(("times", "told"), [(0.9995, False), (1.0005, True)])
def test_four_standard_errors_tell_shared_motion(burst, times, told):
    """The products of errors z + d and z - d are z^2 - d^2: their mean is set to just below and above what is asked for.

    In a short burst the spread of the products is their own size: there that of independent noises counts.
    """
    rng = np.random.default_rng(2)
    n, d = 400, rng.uniform(0.5, 1.5, 400)
    shape = (np.arange(n) < 10).astype(float) if burst else np.abs(np.sin(np.arange(n)))

    def errors(z):
        half = 0.5 * d * np.resize([1.0, -1.0], n)
        return z + half, z - half

    def over(level):
        mean, least, _ = by_hand(*errors(level * shape), 0.0)
        return mean - times * least

    low, high = 0.0, 20.0
    assert over(low) < 0 < over(high)
    for _ in range(80):
        level = 0.5 * (low + high)
        low, high = (level, high) if over(level) < 0 else (low, level)
    speed, rate = errors(high * shape)
    found = _shared([run(speed, rate, 2)], 2 * DT)
    assert (found > 0.0) is told
    if told:
        mean, _, noise = by_hand(speed, rate, 0.0)
        assert found == pytest.approx(mean / noise)


@pytest.mark.parametrize(("windows", "told"), [(19, False), (20, True)])
def test_twenty_windows_are_asked_for(windows, told):
    speed = np.resize([1.0, -1.0], windows)
    assert (_shared([run(speed, 1.1 * speed, 3)], 3 * DT) is not None) is told
    half = windows - 7
    parts = [run(speed[:half], 1.1 * speed[:half], 3), run(speed[half:], 1.1 * speed[half:], 3)]
    assert (_shared(parts, 3 * DT) is not None) is told, "over all recordings"


def test_a_window_has_two_samples_at_least():
    speed = np.resize([1.0, -1.0], 40)
    found = _shared([run(speed, speed + 0.1 * np.resize([1.0, 1.0, -1.0], 40), 2)], 0.1 * DT)
    assert found == _shared([run(speed, speed + 0.1 * np.resize([1.0, 1.0, -1.0], 40), 2)], 2 * DT) > 0


def test_windows_that_hold_a_sample_that_does_not_count_are_left_out():
    rng = np.random.default_rng(3)
    speed = rng.standard_normal(50)
    rate = speed + 0.2 * rng.standard_normal(50)
    counts = np.ones(151, bool)
    counts[[3, 44, 149]] = False
    keep = np.setdiff1d(np.arange(50), [1, 14, 49])
    mean, _, noise = by_hand(speed[keep], rate[keep], 0.0)
    assert _shared([run(speed, rate, 3, counts=counts)], 3 * DT) == pytest.approx(mean / noise)
    nothing = run(np.full(10, 1e6), np.zeros(10), 3, counts=np.zeros(31, bool))
    assert _shared([run(speed[keep], rate[keep], 3), nothing], 3 * DT) == pytest.approx(mean / noise)


def test_an_error_of_the_encoder_is_what_repeats_each_turn():
    n = 6000
    t = DT * np.arange(n)
    angle = 4.0 * np.pi * np.sin(3.0 * t)
    cyclic = 2e-3 * np.sin(angle) - 1e-3 * np.cos(2 * angle)
    error = np.diff(cyclic) / DT
    counts = np.ones(n, bool)
    found = _encoder_error(error, angle, counts, DT)
    assert np.diff(found) / DT == pytest.approx(error, abs=1e-8)
    spoilt = error.copy()
    spoilt[99:111] = 1e3  # each between two samples, one of which does not count
    counts[100:111] = False
    assert _encoder_error(spoilt, angle, counts, DT) == pytest.approx(found, abs=1e-9)
    small = 0.5 * angle / (8 * np.pi) * 1.5
    assert not _encoder_error(error, small * 0.4, counts, DT).any(), "less than an eighth of a turn"


# the regression on the dictionary


def fitter_of(estimation, held_out, own=True):
    """A fitter whose experiments are (responses, residual), None where a model cannot be run."""
    return SimpleNamespace(
        experiments=tuple(estimation), held_out=tuple(held_out), map=lambda tasks: [task() for task in tasks],
        own_values=lambda h, fitted, e: (None, None) if own else None,
    )  # fmt: skip


FITTED = SimpleNamespace(
    hypothesis=SimpleNamespace(axis=lambda x, i: None, initial=lambda x, i: None), fit=SimpleNamespace(x=None)
)


@pytest.fixture
def given(monkeypatch):
    """Regress on what the experiments are."""
    monkeypatch.setattr(predictable, "_regressed", lambda fitter, experiment, axis, initial: experiment)


def parts(seed, size, n=600):
    """Responses and a residual that holds ``size`` of them beside unit noise."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((n, 3)) * [1.0, 5.0, 0.01]
    return x, size * (x @ [1.0, 0.1, -30.0]) + rng.standard_normal(n)


@pytest.mark.parametrize("size", [0.0, 0.2, 1.0])
def test_what_carries_over_to_held_out_samples_is_the_share(given, size):
    """Ridge regression with 1e-4 of the samples, blockwise gains 2 z p - p^2 and Student's t of their mean."""
    estimation, held_out = [parts(1, size), parts(2, size, 500)], [parts(3, size), parts(4, size, 400)]
    found = remaining_structure(fitter_of(estimation, held_out), FITTED, blocks=10)
    x, y = np.vstack([e[0] for e in estimation]), np.concatenate([e[1] for e in estimation])
    scale = np.sqrt(np.mean(x**2, axis=0))
    weights = np.linalg.solve((x / scale).T @ (x / scale) + 1e-4 * len(x) * np.eye(3), (x / scale).T @ y)
    gains, before = [], 0.0
    for responses, z in held_out:
        p = (responses / scale) @ weights
        gains += [float(np.sum(part)) for part in np.array_split(2 * z * p - p**2, 10)]
        before += float(np.sum(z**2))
    t = np.mean(gains) / (np.std(gains, ddof=1) / math.sqrt(20))
    assert found.share == pytest.approx(sum(gains) / before)
    assert found.p_value == pytest.approx(student.sf(t, 19))
    assert (found.share > 0.5) is (size == 1.0)


def test_a_model_that_cannot_be_run_leaves_nothing_to_regress(given):
    one = parts(1, 1.0)
    nothing = Structure(0.0, 1.0)
    assert remaining_structure(fitter_of([one], [None]), FITTED) == nothing
    assert remaining_structure(fitter_of([None], [one]), FITTED) == nothing
    assert remaining_structure(fitter_of([one], [one], own=False), FITTED) == nothing
    assert remaining_structure(fitter_of([one], [one]), FITTED).p_value < 1e-6
