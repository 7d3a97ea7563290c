"""A law of friction outside the library is not taken for waves over the angle."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.evidence.speed import left_beside_speed
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from mjsim.axis import Axis
from mjsim.chain import Body, Chain
from mjsim.effects import effect_class
from mjsim.recording import Recording

DT, INERTIA, DAMPING, LEVEL = 2e-3, 0.07, 0.05, 0.2
EFFECTS = ("coulomb_friction", "position_dependent_friction", "torque_ripple")


@pytest.fixture(scope="module")
def rotor():
    return Axis(Chain((Body("motor", INERTIA, DAMPING, "hinge"),), ()), ())


def swing(law, seed, n=3000, inner=20):
    """A rotor under three tones: torque, speed and angle, where a torque ``law(v, q)`` acts against the motion."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(n)
    u = 0.8 * sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.3, 1.1, 4.0))
    q, v, h = 0.0, 0.0, DT / inner
    motion = np.empty((n, 2))
    for k in range(n):
        motion[k] = q, v
        for _ in range(inner):
            v += h * (u[k] - DAMPING * v - law(v, q)) / INERTIA
            q += h * v
    noise = rng.standard_normal((n, 2)) * [1e-4, 0.01]
    angle, velocity = (motion + noise).T
    return Recording(t, u, velocity, angle, DT, source=f"{seed}.csv")


def smooth(v, q):
    return LEVEL * np.tanh(v / 0.3)


def varying(v, q):
    return LEVEL * np.tanh(v / 0.01) * (1 + 0.3 * np.sin(5 * q))


@pytest.mark.slow
def test_a_smooth_law_of_friction_is_no_wave_over_the_angle(rotor):
    found = diagnose(rotor, [swing(smooth, 1)], [swing(smooth, 2)], Options(jobs=1, effects=EFFECTS))
    assert {f.effect for f in found.findings} <= {"coulomb_friction"}
    assert any(r.test == "speed" for r in found.refusals)


@pytest.mark.slow
def test_friction_that_varies_over_the_turn_is_named(rotor):
    found = diagnose(rotor, [swing(varying, 1)], [swing(varying, 2)], Options(jobs=1, effects=EFFECTS))
    assert [f.effect for f in found.findings] == ["position_dependent_friction"]


def test_what_a_function_of_the_speed_leaves(rotor):
    dry = effect_class("coulomb_friction")(torque_Nm=LEVEL)
    left = {}
    for name, law in (("smooth", smooth), ("varying", varying)):
        fitter = Fitter(rotor, MotionView(), (prepare(swing(law, 1)),), (), 1)
        fitted = fitter.fit(fitter.hypothesis([dry]))
        left[name] = fitted.chi2 / fitted.n, left_beside_speed(fitter, fitted)[0] / fitted.n
        fitter.close()
    assert left["smooth"][0] > 2.0
    assert left["smooth"][1] < 1.3
    assert left["varying"][1] > 5.0  # no function of the speed follows the angle
