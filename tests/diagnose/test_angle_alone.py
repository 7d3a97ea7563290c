"""Servo logs of an angle alone: an error far above the noise of the angle is motion, whatever its colour."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.evidence.predictable import motion_error
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.structure.passes import _NoiseOnly
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import effect_class
from mjsim.ode import simulate
from mjsim.recording import Recording
from mjsim.servo import Servo, Target

DT, N, NOISE = 0.005, 1200, 9e-4
MOTOR = Servo(0.0, 0.05, Target.VELOCITY, scale=0.04)
NOMINAL = Axis(Chain((Body("motor", 0.005, 0.0, "base"),), (), servo=MOTOR, held=("Jm", "fm")))
MODE = effect_class("extra_flexible_mode")(place="arm", inertia_kgm2=0.0035, stiffness_Nm_rad=0.8, damping_Nms_rad=0.005)
FRICTION = effect_class("coulomb_friction")(place="motor", torque_Nm=0.01)


def log(seed, *effects):
    t = DT * np.arange(N)
    phase = 2 * np.pi * (0.3 * t + 0.5 * 0.5 * t**2)
    u = (80.0 - 20.0 * seed) * np.sin(phase + seed) + 20.0 * np.sin(2 * np.pi * 0.2 * t)
    u[1] = u[0]  # at rest: a log whose command moves from its first row on has a speed of its own at its start
    angle = simulate(dataclasses.replace(NOMINAL, effects=effects), u, DT).angle
    angle = angle + NOISE * np.random.default_rng(seed).standard_normal(N)
    return Recording(t, np.full(N, np.nan), None, angle, DT, source=f"{seed}.csv", command=u)


@pytest.mark.parametrize(("times", "told"), [(1.95, False), (2.05, True)])
def test_an_error_of_twice_the_noise_of_an_angle_is_motion(times, told):
    """Below that it may be noise of another colour, and counts as such."""
    view, (fitted, held) = MotionView.of(NOMINAL, [log(0, FRICTION)]), (prepare(log(s, FRICTION)) for s in (0, 1))
    assert view.channel == "angle"
    fitter = Fitter(NOMINAL, view, (fitted,), (held,), 1)
    try:
        base = fitter.fit(fitter.hypothesis(()))
        exact = motion_error(fitter, base)
        assert exact > 100.0
        rms = held.sigma * np.sqrt(exact + 1.0)
        scaled = Fitter(NOMINAL, view, (fitted,), (dataclasses.replace(held, sigma=rms / times),), 1)
        found = motion_error(scaled, base)
        assert found == (pytest.approx(times**2 - 1.0, rel=1e-6) if told else None)
        assert _NoiseOnly(0.05, unknown=True)(scaled, base) is not told
        scaled.close()
    finally:
        fitter.close()


@pytest.mark.slow
def test_a_mode_is_named_although_what_it_leaves_is_coloured():
    """The friction beside it is no candidate here: a residual of many times the noise is left, and is not whitened away."""
    logs = [log(s, MODE, FRICTION) for s in (0, 1)]
    free = dataclasses.replace(NOMINAL, chain=dataclasses.replace(NOMINAL.chain, held=()))
    result = diagnose(free, logs[:1], logs[1:], Options(jobs=1, effects=("extra_flexible_mode",)))
    assert [f.effect for f in result.findings] == ["extra_flexible_mode"]
    assert result.fit["corrected"].held_out_rms > 2 * NOISE
    assert not any("Record angle and velocity" in note for note in result.notes)
