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


def test_rounding_is_noise_of_a_resampled_channel_that_mostly_rests():
    """A servo that steps twice and rests: all differences are zero, before and after."""
    stamps = DT * (np.arange(N) + uniform(0.2))
    step = 2 * np.pi / 3600
    moved = 0.2 * (np.tanh(100 * (stamps - 2.0)) - np.tanh(100 * (stamps - 8.0)))
    columns = {"time_s": stamps, "command_rad": 0.4 * ((stamps > 2) & (stamps < 8)), "angle_rad": step * np.round(moved / step)}
    binding = {"time": "time_s", "command": "command_rad", "angle": "angle_rad", "jitter": 1.0}
    log = simgap.load(columns, binding={"recording": binding})
    assert 0.7 < log.noise["angle"] / (step / np.sqrt(12)) < 1.1
    assert prepare(log).angle_noise == pytest.approx(log.noise["angle"])


def test_samples_in_gaps_do_not_count():
    k = np.arange(N)
    stamps = DT * (k + uniform(0.1))[k % 13 < 8]
    binding = {"recording": BINDING["recording"] | {"velocity": "velocity_rad_s"}}
    log = simgap.load({"time_s": stamps, "torque_Nm": np.cos(20.0 * stamps), "velocity_rad_s": motion(stamps)}, binding=binding)
    assert len(log) == pytest.approx(N, rel=0.005)
    e = prepare(log)
    assert not np.any(e.counts & log.missing)
    assert np.sum(e.counts) == pytest.approx(8 / 13 * N, rel=0.01)
    assert log.slice(5, 50).missing.tolist() == log.missing[5:50].tolist()


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
