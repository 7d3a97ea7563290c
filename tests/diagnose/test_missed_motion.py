"""Motion that a model missed is what two sensors' errors share, however short it was; noise of either alone is none."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.evidence.predictable import _most_shared, _shared
from diagnose.thresholds import WINDOWS

DT, N, VELOCITY, ANGLE = 5e-4, 20_000, 0.05, 1e-4

NOISES = {
    "normal": lambda rng: rng.standard_normal(N),
    "uniform": lambda rng: rng.uniform(-np.sqrt(3), np.sqrt(3), N),
    "two values": lambda rng: rng.choice([-1.0, 1.0], N),
    "bursts": lambda rng: rng.standard_normal(N) * np.where(rng.random(N // 500).repeat(500) < 0.1, 10.0, 1.0),
    "coloured": lambda rng: np.convolve(rng.standard_normal(N + 20), np.ones(21) / np.sqrt(21), "valid"),
}


def _errors(motion: np.ndarray, velocity_noise: np.ndarray, angle_noise: np.ndarray) -> list[tuple]:
    """Both errors of a model that missed a velocity (N,), as `motion_error` hands them on."""
    angle = np.concatenate([[0.0], np.cumsum(motion[:-1])]) * DT
    return [(motion[:-1] + VELOCITY * velocity_noise[:-1], angle + ANGLE * angle_noise, np.ones(N, bool), DT)]


def test_a_burst_of_motion_is_seen():
    # a gear that began strained rings for a tenth of a second in ten: its own spread is as large as it is
    t = DT * np.arange(N)
    motion = 0.9 * np.exp(-t / 0.04) * np.sin(2 * np.pi * 45 * t)
    rng = np.random.default_rng(1)
    errors = _errors(motion, rng.standard_normal(N), rng.standard_normal(N))
    found = max(_shared(errors, window) for window in WINDOWS)
    there = np.mean(motion**2) / VELOCITY**2
    assert 0.5 * there < found < 1.1 * there, "what a window of the motion's own length leaves of it"


@pytest.mark.parametrize("angle", NOISES)
@pytest.mark.parametrize("velocity", NOISES)
def test_noise_of_two_sensors_is_no_motion(velocity, angle):
    rng = np.random.default_rng([list(NOISES).index(velocity), list(NOISES).index(angle)])
    found = [
        _shared(_errors(np.zeros(N), NOISES[velocity](rng), NOISES[angle](rng)), window) for _ in range(20) for window in WINDOWS
    ]
    assert found == [0.0] * len(found)


def test_what_does_not_count_is_no_noise():
    """An error of the encoder that some stretches bear out was taken out of all: no motion was seen beside what that left."""
    t = DT * np.arange(N)
    rng = np.random.default_rng(3)
    ((error, angle_error, counts, dt),) = _errors(0.3 * np.sin(40 * t), rng.standard_normal(N), rng.standard_normal(N))
    counts[N // 2 :] = False
    clean = [_shared([(error, angle_error, counts, dt)], window) for window in WINDOWS]
    wild = np.where(np.arange(N - 1) < N // 2 + 200, error, 1e4 * rng.standard_normal(N - 1))
    assert [_shared([(wild, angle_error, counts, dt)], window) for window in WINDOWS] == clean
    assert min(clean) > 1.0


@pytest.mark.parametrize("missed", [0.0, 0.5])
def test_a_coarse_angle_tells_by_longer_windows(missed):
    """Two short steps at 160 samples a second, angle in steps of five degrees: its rate over 20 ms tells nothing."""
    dt, n, step = 1 / 160, 200, np.deg2rad(5.0)
    runs = []
    for sign, seed in ((1, 0), (-1, 1)):
        rng = np.random.default_rng(seed)
        late = sign * missed * dt * np.arange(n) + step * rng.uniform(-0.5, 0.5, n)
        speed = sign * missed + 0.05 * rng.standard_normal(n - 1)
        runs.append((speed, late, np.ones(n, bool), dt))
    found = _most_shared(runs, WINDOWS)
    if missed:
        assert [_shared(runs, window) for window in WINDOWS] == [None] * len(WINDOWS)
        assert found == pytest.approx(0.25 / (2 * 0.05**2 + (step / (np.sqrt(6) * 10 * dt)) ** 2), rel=0.5)
    else:
        assert not found
