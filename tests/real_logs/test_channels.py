"""Recordings with unlike channels are diagnosed by what all of them have."""

from __future__ import annotations

import pytest
from twins import motor, recording

from diagnose.data.channels import with_common_channels
from diagnose.pipeline import Options, diagnose
from mjsim.axis import Axis, Body, Chain
from mjsim.errors import InputError

NOMINAL = Axis(Chain((Body("motor", 0.01, 0.04, "j"),), ()))


def log(seed: int, velocity: bool = True, angle: bool = True):
    u, v, q = motor(seed, 250.0, 3.0)
    return recording(250.0, u, v if velocity else None, q if angle else None, f"{seed}.csv")


@pytest.mark.parametrize(
    ("first", "second", "left"),
    [
        ((True, True), (True, False), ("velocity",)),
        ((True, False), (True, True), ("velocity",)),
        ((True, True), (False, True), ("angle",)),
        ((True, True), (True, True), ("velocity", "angle")),
    ],
)
def test_what_one_recording_lacks_is_used_of_none(first, second, left):
    a, b, said = with_common_channels([log(1, *first)], [log(2, *second)])
    for r in (*a, *b):
        assert tuple(n for n in ("velocity", "angle") if getattr(r, n) is not None) == left
    assert len(said) == 2 - len(left)


def test_recordings_without_a_common_response_are_refused():
    with pytest.raises(InputError, match="no response that the other recordings have too"):
        with_common_channels([log(1, angle=False)], [log(2, velocity=False)])


def test_a_held_out_recording_without_angle_is_no_traceback():
    result = diagnose(NOMINAL, [log(1)], [log(2, angle=False)], Options(jobs=1, effects=("torque_offset",)))
    assert "The angle is not used: 2.csv has none." in result.notes
