"""The noise of a velocity by its fastest part, and slow noise by the angle beside it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robot_axis import effect
from scipy.signal import lfilter

from diagnose.data.experiment import prepare
from diagnose.data.noise import white_noise_level

COLOURS = {
    "slow": [1.0, -0.95],
    "slow, of two poles": np.poly([0.95 + 0.035j, 0.95 - 0.035j]),
    "a resonance at 30 Hz": np.poly(0.95 * np.exp([0.094j, -0.094j])).real,
    "a resonance at 140 Hz": np.poly(0.9 * np.exp([0.44j, -0.44j])).real,
}
RMS = 0.05


def noisy(quiet, poles, seed):
    """A quiet recording with noise of these poles and of the rms `RMS` on its velocity."""
    n = len(quiet)
    noise = lfilter([1.0], poles, np.random.default_rng(seed).standard_normal(n + 2000))[2000:]
    return dataclasses.replace(quiet, velocity=quiet.velocity + RMS * noise / np.std(noise))


@pytest.fixture(scope="module")
def quiet(record):
    return record(effect("coulomb_friction", torque_Nm=0.1), noise=0.0, seconds=10.0)


@pytest.mark.parametrize("colour", COLOURS)
def test_slow_noise_is_seen_beside_the_angle(quiet, colour):
    """Differences of a smooth noise saw a hundredth of it, and everything counted as mismatch."""
    for seed in range(3):
        r = noisy(quiet, COLOURS[colour], seed)
        assert white_noise_level(r.velocity) < 0.5 * RMS, "else there is nothing to show"
        assert 0.7 * RMS < prepare(r).sigma < 1.05 * RMS, "what is not clear is not counted"


@pytest.fixture(scope="module")
def hardened(record):
    """A recording without noise of an axis that hardens."""
    return record(effect("hardening_stiffness", place="arm", coefficient_Nm_rad3=2e9), noise=0.0, seconds=10.0)


@pytest.mark.parametrize("between", ["nothing", "a lag", "a gain and an offset"])
def test_white_noise_stays_what_it_is(hardened, between):
    """Whatever else lies between the two sensors."""
    quiet, v = hardened, hardened.velocity
    if between == "a lag":
        v = lfilter([0.25], [1.0, -0.75], v)  # of one and a half milliseconds
    if between == "a gain and an offset":
        v = 1.05 * v + 0.3
    for seed in range(4):
        noise = RMS * np.random.default_rng(seed).standard_normal(len(v))
        r = dataclasses.replace(quiet, velocity=v + noise)
        sigma = prepare(r).sigma
        assert sigma == pytest.approx(white_noise_level(r.velocity), rel=0.03)
        assert sigma == pytest.approx(RMS, rel=0.05)
