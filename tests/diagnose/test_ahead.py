"""The error so far ahead: the noise where the model is right, the theory of a first-order error, and less than a free run."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robot_axis import effect
from scipy.signal import lfilter

from diagnose.data.experiment import prepare
from diagnose.explain.ahead import k_step
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView

NOISE = 0.05


def fitter_of(robot, *recordings):
    return Fitter(robot, MotionView(), (prepare(recordings[0]),), (prepare(recordings[1]),), 1)


def test_white_noise_is_what_no_past_predicts(pair, robot):
    fitter = fitter_of(robot, *pair())
    ahead = k_step(fitter, fitter.fit(fitter.hypothesis(())))
    assert [h for h, _ in ahead] == [0.005, 0.05, 0.25]
    assert [e for _, e in ahead] == pytest.approx([NOISE] * 3, rel=0.05)


def test_a_first_order_error_is_predicted_as_theory_says(pair, robot):
    phi, w = 0.98, 0.02
    recordings = []
    for i, r in enumerate(pair(noise=0.0, seconds=8.0)):
        slow = lfilter([w], [1.0, -phi], np.random.default_rng(i).standard_normal(len(r)))
        recordings.append(dataclasses.replace(r, velocity=r.velocity + slow))
    fitter = fitter_of(robot, *recordings)
    model = fitter.fit(fitter.hypothesis(()))
    for horizon, error in k_step(fitter, model, (0.0005, 0.01, 0.05)):
        k = round(horizon / recordings[0].dt)
        assert error == pytest.approx(w * np.sqrt((1 - phi ** (2 * k)) / (1 - phi**2)), rel=0.1)


def test_missing_physics_shows_less_the_nearer_one_looks(pair, robot):
    fitter = fitter_of(robot, *pair(effect("coulomb_friction", torque_Nm=0.1), seconds=6.0))
    base = fitter.fit(fitter.hypothesis(()))
    held = fitter.validate(base)
    assert held is not None
    near, _, far = (e for _, e in k_step(fitter, base))
    assert NOISE < near < 0.75 * far
    assert far == pytest.approx(held.rms, rel=0.2)
    right = fitter.fit(fitter.hypothesis((effect("coulomb_friction", torque_Nm=0.05),)))
    assert [e for _, e in k_step(fitter, right)] == pytest.approx([NOISE] * 3, rel=0.06)


def test_a_horizon_is_a_whole_number_of_samples(pair, robot):
    """Of a slow log: the horizons are those that its samples have, each once."""
    slow = [
        dataclasses.replace(r, time=r.time[::40], torque=r.torque[::40], velocity=r.velocity[::40], angle=r.angle[::40], dt=0.02)
        for r in pair(seconds=8.0)
    ]
    fitter = fitter_of(robot, *slow)
    assert [h for h, _ in k_step(fitter, fitter.fit(fitter.hypothesis(())), (0.005, 0.02, 0.05, 0.25))] == [0.02, 0.04, 0.24]
