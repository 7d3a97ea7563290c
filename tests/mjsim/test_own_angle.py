"""Which laws a free run ties to the recorded angle: those that repeat over it, and no torque that holds the axis in place."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.evidence.orders import torque_to_velocity
from mjsim.axis import Axis
from mjsim.chain import Body, Chain
from mjsim.effects import effect_class
from mjsim.ode import simulate
from mjsim.signals import lfilter
from mjsim.system import restoring

DT = 2e-3
CHAIN = Chain((Body("motor", 0.04, 0.05, "hinge"),), ())
PUSH = 0.3 * np.sin(2 * np.pi * 0.5 * DT * np.arange(2000))
GRAVITY = effect_class("gravity_load")(torque_Nm=1.4, phase_rad=0.2)
SPRING = effect_class("joint_spring")(place="motor", stiffness_Nm_rad=2.0, torque_at_zero_Nm=0.2)
RIPPLE = effect_class("torque_ripple")(place="motor", amplitude_Nm=0.1, cycles_per_rev=20.0, phase_rad=0.0)


def recorded(axis):
    """The angle of a run that starts where a recording does, at .3 rad, and what another model would make of it."""
    return simulate(axis, PUSH, DT, initial=np.array([[0.3], [0.0]]))


@pytest.mark.parametrize("effect", [GRAVITY, SPRING])
def test_gravity_and_springs_act_at_the_models_own_angle(effect):
    axis = Axis(CHAIN) + effect
    run = recorded(axis)
    other = run.angle + 0.2 * np.sin(np.linspace(0, 9, len(run.angle)))  # an angle that this model does not take
    tied = simulate(axis, PUSH, DT, angle=other)
    np.testing.assert_allclose(tied.velocity, run.velocity, atol=1e-9)


def test_a_ripple_follows_the_recorded_angle():
    axis = Axis(CHAIN) + RIPPLE
    run = recorded(axis)
    assert np.max(np.abs(simulate(axis, PUSH, DT, angle=run.angle + 0.05).velocity - run.velocity)) > 1e-3
    start = np.array([[0.3], [0.0]])
    np.testing.assert_allclose(simulate(axis, PUSH, DT, angle=run.angle, initial=start).velocity, run.velocity, atol=2e-3)


@pytest.mark.parametrize(
    ("effect", "about", "stiffness"), [(GRAVITY, 0.5, 1.4 * np.cos(0.7)), (SPRING, 3.0, 2.0), (RIPPLE, 0.0, 0.0)]
)
def test_stiffness_that_holds_the_axis_in_place(effect, about, stiffness):
    assert restoring(Axis(CHAIN) + effect, about) == pytest.approx([stiffness], rel=1e-5)


def test_the_linear_model_swings_as_the_axis_does():
    axis = Axis(CHAIN) + GRAVITY
    small = 1e-3 * PUSH
    at = -GRAVITY.phase_rad
    run = simulate(axis, small, DT, initial=np.array([[at], [0.0]]))
    b, a = torque_to_velocity(axis, DT, about=at)
    np.testing.assert_allclose(lfilter(b, a, small), run.velocity, atol=1e-3 * np.max(np.abs(run.velocity)))
