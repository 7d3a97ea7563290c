"""Gravity compensation in a file of one joint: the weight is what it leaves."""

from __future__ import annotations

import pytest

from mjsim.mjcf import load_axis

FILE = """<mujoco><compiler angle="radian"/><worldbody>
<body name="bob" gravcomp="{share}"><joint name="j" axis="0 1 0" damping=".1"/>
<inertial pos="0 0 -.3" mass="1" diaginertia=".01 .01 .01"/></body></worldbody>
<actuator><position name="s" joint="j" kp="20" kv="1"/>
</actuator></mujoco>"""


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_the_weight_is_what_the_compensation_leaves(tmp_path, share):
    path = tmp_path / "pendulum.xml"
    path.write_text(FILE.format(share=share))
    weights = [e.values["torque_Nm"] for e in load_axis(path).effects if "torque_Nm" in e.values]
    assert weights == pytest.approx([9.81 * 0.3 * (1 - share)] if share < 1 else [])
