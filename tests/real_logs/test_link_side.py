"""A velocity behind the gear is recorded by some: it is said that nothing is made of it."""

from __future__ import annotations

import dataclasses

from twins import motor, recording

from diagnose.pipeline import Options, diagnose
from mjsim.axis import Axis, Body, Chain


def test_the_velocity_behind_the_gear_is_said_to_be_ignored():
    nominal = Axis(Chain((Body("motor", 0.01, 0.04, "j"),), ()))
    logs = [recording(250.0, *motor(s, 250.0, 2.0, level=0.0), f"{s}.csv") for s in (1, 2)]
    logs = [dataclasses.replace(r, second_velocity=r.velocity) for r in logs]
    result = diagnose(nominal, logs[:1], logs[1:], Options(jobs=1, effects=("torque_offset",)))
    assert any("second_velocity" in note and "not used" in note for note in result.notes)
