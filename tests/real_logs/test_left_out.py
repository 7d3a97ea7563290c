"""A velocity that a drive filters is late against the angle: the diagnosis goes on by the angle alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter
from twins import motor, recording

from diagnose.check import LogVerdict, Machine, check_log
from diagnose.check.left_out import told_as_left_out, without_late_velocity
from mjsim.axis import Axis, Body, Chain

MACHINE = Machine(Axis(Chain((Body("motor", 0.01, 0.04, "j"),), ())))


@pytest.fixture(scope="module")
def log():
    """At 200 Hz, the velocity behind a low-pass of 15 ms."""
    u, v, q = motor(3, 200.0, 8.0)
    late = lfilter([0.3], [1.0, -0.7], v)
    return dataclasses.replace(
        recording(200.0, u, late, q, "log.csv"), units={"torque": "Nm", "velocity": "rad/s", "angle": "rad"}
    )


def test_the_angle_takes_its_place(log):
    check = check_log(MACHINE, [log])
    assert [p.problem for p in check.to_fix()] == ["channel_skew"]
    fewer = without_late_velocity(check, [log], [])
    assert fewer is not None
    (kept,) = fewer[0]
    assert kept.velocity is None
    assert kept.judge is None
    told = told_as_left_out(check, check_log(MACHINE, [kept]))
    assert told.verdict is LogVerdict.LIMITS
    assert told.problems[0].problem == "channel_skew"
    assert told.problems[0].advice.startswith("the velocity is left out and the angle used")


def test_other_faults_stay_to_be_fixed(log):
    turned = dataclasses.replace(log, torque=-log.torque)
    check = check_log(MACHINE, [turned])
    assert check.verdict is LogVerdict.FIX
    assert without_late_velocity(check, [turned], []) is None


def test_what_the_binding_says_stays(log):
    check = check_log(MACHINE, [log])
    by_force = dataclasses.replace(log, judge="force")
    fewer = without_late_velocity(check, [by_force], [])
    assert fewer is not None
    assert fewer[0][0].judge == "force"
    assert without_late_velocity(check, [dataclasses.replace(log, angle=None)], []) is None
    sound = check_log(MACHINE, [dataclasses.replace(log, velocity=np.gradient(log.angle, log.dt))])
    assert without_late_velocity(sound, [log], []) is None
