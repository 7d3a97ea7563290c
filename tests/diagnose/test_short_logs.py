"""Logs of a second: what cannot be judged by force is judged by motion, or refused in one line."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from mjsim.axis import Axis, Body, Chain
from mjsim.errors import InputError
from mjsim.recording import Recording

DT, N = 0.0024, 250
AXIS = Axis(Chain((Body("motor", 0.003, 0.01, "horn"),), ()))


def half_a_second(judge=None):
    """A servo that swings once, of a coarse potentiometer: the torque of its noise leaves a band below 1 Hz."""
    rng, t = np.random.default_rng(0), DT * np.arange(N)
    torque = 0.05 + 0.01 * rng.standard_normal(N)
    angle = 1.3 * (1 - np.cos(2 * np.pi * t / 0.6)) + 4e-3 * rng.standard_normal(N)
    return Recording(t, torque, None, angle, DT, judge=judge)


def test_a_recording_shorter_than_the_ends_of_the_low_pass_is_judged_by_motion():
    result = diagnose(AXIS, [half_a_second()], [], Options(jobs=1, effects=("coulomb_friction",)))
    assert result.channel == MotionView().channel
    assert np.isfinite(result.fit["refitted"].held_out_rms)


def test_where_force_is_asked_for_it_is_refused():
    with pytest.raises(InputError, match=r"can be judged by force below .* judge by motion"):
        diagnose(AXIS, [half_a_second("force")], [], Options(jobs=1, effects=("coulomb_friction",)))
