"""Noise of the recorded torque lets a free run stray: that is no missing physics, unless the noise acts."""

from __future__ import annotations

import numpy as np
import pytest
from twins import Bristle, recording, run, wave

from diagnose.data.experiment import prepare
from diagnose.evidence.torque_noise import made_by_torque_noise, of_torque_noise
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView
from mjsim.axis import Axis, Body, Chain

RATE, TRUE = 500.0, Axis(Chain((Body("motor", 0.012, 0.05, "j"),), ()))


def log(seed, measured=0.0, acting=0.0, level=0.0):
    rng = np.random.default_rng(seed)
    t = np.arange(round(4.0 * RATE)) / RATE
    u = 0.5 * wave(rng, t, 0.3, 5.0) + acting * rng.standard_normal(len(t))
    friction = Bristle(level) if level else None
    u, q, v = run(u, RATE, 0.012, lambda _t, _q, v, u: u - 0.05 * v, friction=friction, substeps=4)
    noise = rng.standard_normal((3, len(t)))
    return recording(RATE, u + measured * noise[0], v + 0.01 * noise[1], q + 1e-4 * noise[2], f"{seed}.csv")


def left(**how):
    fitted, held = (prepare(log(seed, **how)) for seed in (1, 2))
    fitter = Fitter(TRUE, MotionView(), (fitted,), (held,), 1)
    try:
        f = fitter.fit(fitter.hypothesis(()))
        return made_by_torque_noise(fitter, f), float(np.sqrt(of_torque_noise(f.axis, held)))
    finally:
        fitter.close()


def test_the_noise_of_a_sensor_makes_the_error():
    made, size = left(measured=0.04)
    assert made
    assert 0.01 < size < 0.1


def test_the_error_of_the_input_is_as_large_as_it_says():
    e = prepare(log(1, measured=0.04))
    rng = np.random.default_rng(0)
    draws = [
        run(0.04 * rng.standard_normal(2000), RATE, 0.012, lambda _t, _q, v, u: u - 0.05 * v, substeps=2)[2] for _ in range(8)
    ]
    assert np.sqrt(of_torque_noise(TRUE, e)) == pytest.approx(np.sqrt(np.mean(np.square(draws))), rel=0.25)


@pytest.mark.parametrize("how", [{"acting": 0.04, "level": 0.02}, {"measured": 0.002, "level": 0.06}])
def test_noise_that_acts_or_is_too_small_explains_nothing(how):
    """Friction that is missing errs by more, and noise that a controller puts into its torque is in the motion."""
    assert not left(**how)[0]
