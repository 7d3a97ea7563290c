"""Stamps that jitter or wander are resampled, and the noise that is known of the result is that of the result."""

from __future__ import annotations

import numpy as np
import pytest

import simgap
from diagnose.data.experiment import prepare
from mjsim.timebase import noise_after

N, DT, NOISE = 6000, 0.002, 0.01
BINDING = {"recording": {"time": "time_s", "torque": "torque_Nm", "jitter": 1.0, "hold": "linear"}}


def motion(t):
    return 5.0 * np.sin(2 * np.pi * 3.0 * t)


def uniform(half):
    return np.random.default_rng(0).uniform(-half, half, N)


def wander(rms):
    walk = np.cumsum(np.random.default_rng(1).standard_normal(N))
    walk -= np.linspace(walk[0], walk[-1], N)
    return rms * walk / np.std(walk)


OFF = {"jitter of 0.1": uniform(0.1), "jitter of 0.3": uniform(0.3), "wander of 0.5": wander(0.5)}


@pytest.mark.parametrize("name", list(OFF))
@pytest.mark.parametrize("channel", ["velocity", "angle"])
def test_the_noise_of_a_resampled_channel_is_known(name, channel):
    off = OFF[name].copy()
    off[[0, -1]] = 0.0
    stamps = DT * (np.arange(N) + off)
    measured = motion(stamps) + NOISE * np.random.default_rng(2).standard_normal(N)
    column = {"velocity": "velocity_rad_s", "angle": "angle_rad"}[channel]
    binding = {"recording": BINDING["recording"] | {channel: column}}
    log = simgap.load({"time_s": stamps, "torque_Nm": np.cos(20.0 * stamps), column: measured}, binding=binding)
    true = float(np.std(getattr(log, channel) - motion(log.time)))
    assert log.noise[channel] == pytest.approx(true, rel=0.03)
    sigma = prepare(log).sigma
    assert sigma == pytest.approx(true if channel == "velocity" else true / (np.sqrt(2.0) * DT), rel=0.03)
    assert log.slice(0, N // 2).noise == log.noise


def test_a_uniform_log_has_no_noise_of_its_own():
    t = DT * np.arange(N)
    binding = {"recording": BINDING["recording"] | {"velocity": "velocity_rad_s"}}
    log = simgap.load({"time_s": t, "torque_Nm": np.cos(20.0 * t), "velocity_rad_s": motion(t)}, binding=binding)
    assert dict(log.noise) == {}


def test_polynomials_of_degree_five_have_no_noise():
    t = DT * (np.arange(400) + uniform(0.3)[:400])
    found = noise_after(t, {"velocity": (t / t[-1]) ** 5}, DT)
    assert found["velocity"] < 1e-12
    assert noise_after(t[:5], {"velocity": t[:5]}, DT) == {}
