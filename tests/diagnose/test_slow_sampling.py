"""A log of 100 Hz of an axis with modes near its Nyquist frequency: friction is found there too."""

from __future__ import annotations

import numpy as np
import pytest
from robot_axis import effect

from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.thresholds import MOST_SUBSTEPS
from mjsim.ode import simulate
from mjsim.recording import Recording

DT = 0.01


def record(axis, seed):
    rng = np.random.default_rng(seed)
    t = DT * np.arange(1000)
    u = sum(np.cos(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f in np.arange(0.4, 30.0, 0.2))
    u /= np.std(u)
    y = simulate(axis, u, DT)
    noisy = y.velocity + 0.05 * rng.standard_normal(len(t)), y.angle + 1e-4 * rng.standard_normal(len(t))
    return Recording(t, u, *noisy, DT)


def test_friction_is_found_in_a_slow_log(robot):
    true = robot.with_linear({"Jm": 4.7e-4, "kg": 1.46e5}) + effect("coulomb_friction", torque_Nm=0.1)
    recordings = [record(true, s) for s in (1, 2)]
    assert MotionView.of(robot, recordings).most_substeps > MOST_SUBSTEPS
    only = ("coulomb_friction", "torque_offset", "quadratic_friction")
    result = diagnose(robot, recordings[:1], recordings[1:], Options(jobs=1, effects=only))
    assert [f.effect for f in result.findings] == ["coulomb_friction"]
    assert result.findings[0].parameters["torque_Nm"].value == pytest.approx(0.1, rel=0.02)
