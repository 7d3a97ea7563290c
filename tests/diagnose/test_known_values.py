"""Values of [experiment]: held by the fit of a servo, or named as not used."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.servo import as_servo
from mjsim.axis import Axis, Body, Chain
from mjsim.errors import InputError
from mjsim.recording import Recording
from mjsim.servo import Servo, Target

TIME = np.arange(50) * 0.01
WAVE = np.sin(TIME)
PLAIN = Chain((Body("motor", 0.01, 0.04, "j"),), ())


def driven(target: Target = Target.POSITION) -> Axis:
    return Axis(dataclasses.replace(PLAIN, servo=Servo(20.0, 0.4, target)))


def log(**known: float) -> Recording:
    return Recording(TIME, np.full(50, np.nan), None, WAVE, 0.01, command=WAVE, known=known)


def test_a_known_gain_is_held():
    axis, _, _, said = as_servo(driven(), [log(kp=12.5)], [log(kp=12.5), log()])
    assert axis.chain.servo.kp == 12.5
    assert "kp" in axis.chain.held
    assert any("kp = 12.5" in note for note in said)


def test_a_gain_that_differs_in_the_held_out_recording_is_refused():
    with pytest.raises(InputError, match="kp differs between the recordings"):
        as_servo(driven(), [log(kp=12.5)], [log(kp=25.0)])


def test_a_position_gain_of_a_velocity_servo_is_refused():
    with pytest.raises(InputError, match="is a velocity servo; expected kv"):
        as_servo(driven(Target.VELOCITY), [log(kp=12.5)], [])


def test_what_the_fit_does_not_use_is_named():
    by_torque = dataclasses.replace(log(kp=1.0, supply_V=24.0), torque=WAVE, command=None)
    said = as_servo(Axis(PLAIN), [by_torque], [])[3]
    assert any("kp: not used" in note for note in said)
    assert any("supply_V: not used" in note for note in said)
    assert not any("not used" in note for note in as_servo(driven(), [log()], [])[3])
