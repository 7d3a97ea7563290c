"""Channels that some record and no fit uses are named as such, by the check and by the diagnosis."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from twins import motor, recording

from diagnose.check.unused import unused_channels, unused_of_robot
from diagnose.explain.second_encoder import judge_second_encoder
from diagnose.pipeline import Options, diagnose
from mjsim.axis import Axis, Body, Chain
from mjsim.recording import Recording
from mjsim.robot.recording import RobotRecording

CHAIN = Chain((Body("motor", 0.01, 0.04, "j"),), ())


def log(seed: int = 1) -> Recording:
    return recording(250.0, *motor(seed, 250.0, 2.0, level=0.0), f"{seed}.csv")


def test_a_diagnosis_says_which_link_side_channels_it_does_not_fit():
    logs = [dataclasses.replace(r, second_velocity=r.velocity, second_angle=r.angle) for r in (log(1), log(2))]
    result = diagnose(Axis(CHAIN), logs[:1], logs[1:], Options(jobs=1, effects=("torque_offset",)))
    assert any("second_velocity" in note and "not used" in note for note in result.notes)
    assert any("second_angle" in note and "not fitted" in note for note in result.notes)


@pytest.mark.parametrize("channel", ["second_angle", "second_velocity", "current", "supply"])
def test_a_channel_is_named_only_where_it_is_recorded(channel):
    bare = log()
    assert unused_channels([bare], servo=False) == ()
    (said,) = unused_channels([bare, dataclasses.replace(bare, **{channel: bare.velocity})], servo=False)
    assert said.startswith(f"{channel} ")


def test_a_second_angle_is_not_compared_without_a_motor_angle_or_torque():
    both = dataclasses.replace(log(), second_angle=log().angle)
    (with_angle,) = unused_channels([both], servo=False)
    (alone,) = unused_channels([dataclasses.replace(both, angle=None)], servo=False)
    (servo,) = unused_channels([both], servo=True)
    assert ("not fitted" in with_angle, "not used" in alone, "not used" in servo) == (True, True, True)


def test_a_second_encoder_without_torque_is_not_judged():
    from diagnose.data.experiment import prepare

    held = dataclasses.replace(log(), second_angle=log().angle)
    part = dataclasses.replace(prepare(held), recording=dataclasses.replace(held, torque=np.full(len(held), np.nan)))
    assert judge_second_encoder(CHAIN, [part], [part]) is None


def test_a_robot_channel_is_named_only_where_it_is_recorded():
    t = np.arange(4) * 0.01
    bare = RobotRecording(t, ("elbow",), 0.01, angle=np.zeros((4, 1)))
    assert unused_of_robot([bare]) == ()
    (said,) = unused_of_robot([bare, dataclasses.replace(bare, second_angle=np.zeros((4, 1)))])
    assert said.startswith("second_angle is not used")
