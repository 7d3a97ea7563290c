"""Logs that are very short, or move fast and little: an answer or one line, and no warning."""

from __future__ import annotations

import numpy as np
import pytest
from twins import motor, recording

from diagnose.evidence.orders import find_orders
from diagnose.pipeline import Options, diagnose
from mjsim.axis import Axis, Body, Chain

NOMINAL = Axis(Chain((Body("motor", 0.01, 0.04, "j"),), ()))


@pytest.mark.parametrize("judge", ["motion", "force"])
def test_the_shortest_log_that_is_taken(judge):
    logs = [recording(250.0, *(x[:210] for x in motor(s, 250.0, 2.0)), f"{s}.csv") for s in (1, 2)]
    result = diagnose(NOMINAL, logs[:1], logs[1:], Options(jobs=1, judge=judge, effects=("torque_offset",)))
    assert result.mismatch.spectrum is not None


def test_a_fast_and_short_motion_shows_no_order():
    """At 200 Hz a vibration of 12 Hz: a wave of one period over its travel passes in less than two samples."""
    t = np.arange(2000) / 200
    angle, velocity = 0.01 * np.sin(2 * np.pi * 12 * t), 0.01 * 2 * np.pi * 12 * np.cos(2 * np.pi * 12 * t)
    noise = np.random.default_rng(0).standard_normal(len(t))
    assert find_orders(noise, angle, velocity, np.array([0.0, 0.1]), np.array([1.0, -0.9]), 1 / 200) == ()


def test_an_unstable_axis_shows_no_order():
    """Its response over 4,000 samples is no number, of which NumPy would warn."""
    rng = np.random.default_rng(1)
    angle = np.linspace(0.0, 20.0, 4000)
    velocity = np.gradient(angle, 1 / 200)
    noise = rng.standard_normal(4000)
    assert find_orders(noise, angle, velocity, np.array([0.0, 0.1]), np.array([1.0, -1.5]), 1 / 200) == ()
