"""A spring at the joint is a law of its own, which weight and ripple together can make up over a part of a turn."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.result import Verdict
from mjsim.axis import Axis, Body, Chain
from mjsim.effects.joint_spring import JointSpring
from mjsim.ode import simulate
from mjsim.recording import Recording

DT = 4e-3


def log(axis, seed):
    rng = np.random.default_rng(seed)
    t = DT * np.arange(1000)
    u = sum(rng.uniform(0.2, 0.6) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.4, 0.9, 1.7, 3.1)) * np.minimum(
        t, 1
    )
    run = simulate(axis, u, DT)
    noise = rng.standard_normal((2, len(t)))
    v, q = run.velocity + 0.01 * noise[0], run.angle + 2e-4 * noise[1]
    return Recording(t, u, v, q, DT, source=f"log_{seed}.csv")


def test_a_spring_at_the_joint_is_named_with_its_values():
    nominal = Axis(Chain((Body("motor", 0.05, 0.06, "j"),), ()), ())
    true = nominal + JointSpring(stiffness_Nm_rad=0.6, torque_at_zero_Nm=0.06)
    options = Options(jobs=1, effects=("joint_spring", "gravity_load", "torque_ripple", "torque_offset"))
    result = diagnose(nominal, [log(true, 1)], [log(true, 2)], options)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["joint_spring"]
    values = result.findings[0].parameters
    assert values["stiffness_Nm_rad"].value == pytest.approx(0.6, rel=0.01)
    assert values["torque_at_zero_Nm"].value == pytest.approx(0.06, abs=0.006)
