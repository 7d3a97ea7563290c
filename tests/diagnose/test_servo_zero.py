"""A constant torque under a position servo is a zero of it: friction that is larger in one direction is an equivalent."""

from __future__ import annotations

import numpy as np
import pytest
from servo_logs import PENDULUM, model, record, write

from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from mjsim.mjcf import load_axis

FRICTION, ASYMMETRY, KP = 0.12, 0.05, 8.0
STEP = 0.001534  # [rad] of the encoder


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    """``answer(torque)``: the diagnosis of friction beside a constant torque [N m] against the motion forward, by MuJoCo."""
    nominal = load_axis(write(tmp_path_factory.mktemp("zero") / "m.xml", PENDULUM))
    options = Options(jobs=1, effects=("coulomb_friction", "asymmetric_friction"))

    def diagnosed(torque: float):
        log = {"rate": 100.0, "seconds": 8.0, "torque": -torque}
        text = model(PENDULUM, friction=FRICTION)
        logs = [record(text, **log), record(text, **{**log, "seed": 7, "seconds": 4.0})]
        return diagnose(nominal, logs[:1], logs[1:], options)

    return diagnosed


def test_friction_of_two_levels_is_given_beside_the_one_of_one_level(answer):
    uneven = answer(ASYMMETRY)
    assert uneven.verdict is Verdict.MISSING_PHYSICS
    (finding,) = uneven.findings
    assert finding.effect == "coulomb_friction"
    assert finding.parameters["torque_Nm"].value == pytest.approx(FRICTION, rel=0.03)
    assert finding.equivalents == ("asymmetric_friction",)
    (note,) = (n for n in uneven.notes if n.startswith("The zero of the servo"))
    assert "a constant torque or asymmetric friction moves the joint alike" in note
    zero = uneven.linear_parameters["zero"]
    assert zero.value == pytest.approx(ASYMMETRY / KP, abs=0.5 * STEP)
    assert not zero.ci95[0] <= 0.0 <= zero.ci95[1]


def test_nothing_is_said_of_a_zero_that_is_the_models(answer):
    even = answer(0.0)
    assert [f.effect for f in even.findings] == ["coulomb_friction"]
    assert even.findings[0].equivalents == ()
    assert not any("zero of the servo" in n for n in even.notes)
    assert np.abs(even.linear_parameters["zero"].value) < 0.5 * STEP


def test_friction_that_would_drive_the_joint_is_no_equivalent(answer):
    """A constant torque above the friction: in one direction the sum of both helps the motion, as no friction does."""
    pushed = answer(2.0 * FRICTION)
    assert [f.effect for f in pushed.findings] == ["coulomb_friction"]
    assert pushed.findings[0].equivalents == ()
    (note,) = (n for n in pushed.notes if n.startswith("The zero of the servo"))
    assert ": a constant torque moves the joint alike" in note
