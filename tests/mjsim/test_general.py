"""An effect on the drive is written beside every short form of an actuator: the <general> in its place moves alike."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjsim.effects import effect_class
from mjsim.mjcf import load_axis, write_corrected
from mjsim.mjcf.general import spelled_out

TEXT = (
    '<mujoco><compiler angle="radian"/><worldbody><body name="b"><joint name="j" axis="0 1 0" damping=".05" range="-2 2"/>'
    '<inertial pos="0 0 0" mass="1" diaginertia=".02 .02 .02"/></body></worldbody><actuator>{}</actuator></mujoco>'
)
FORMS = {
    "position": '<position name="a" joint="j" kp="20" kv=".4"/>',
    "dampratio": '<position name="a" joint="j" kp="20" dampratio="1" inheritrange=".5"/>',
    "filtered": '<position name="a" joint="j" kp="20" kv=".4" timeconst=".01"/>',
    "velocity": '<velocity name="a" joint="j" kv=".4"/>',
    "intvelocity": '<intvelocity name="a" joint="j" kp="20" kv=".4" actrange="-3 3"/>',
    "cylinder": '<cylinder name="a" joint="j" diameter=".5" timeconst=".02"/>',
}


@pytest.mark.parametrize("form", FORMS)
def test_a_torque_of_the_drive_is_written_beside_a_short_form(tmp_path, form):
    path, out = tmp_path / "m.xml", tmp_path / "corrected.xml"
    path.write_text(TEXT.format(FORMS[form]), encoding="utf-8")
    write_corrected(path, load_axis(path).with_effects([effect_class("torque_offset")(torque_Nm=0.1)]), out)
    before, after = (mujoco.MjModel.from_xml_path(str(p)) for p in (path, out))
    pulls = []
    for model in (before, after):
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0], data.ctrl[0] = 0.3, -0.7, 1.7
        mujoco.mj_forward(model, data)
        pulls.append((float(data.actuator_force[0]), *map(float, data.act_dot)))
    assert pulls[1][0] - pulls[0][0] == pytest.approx(0.1, abs=1e-12)
    assert pulls[1][1:] == pytest.approx(pulls[0][1:])
    np.testing.assert_array_equal(before.actuator_ctrlrange, after.actuator_ctrlrange)
    assert any(e.id == "torque_offset" for e in load_axis(out).effects)


def test_the_attributes_of_a_short_form_go():
    model = mujoco.MjModel.from_xml_string(TEXT.format(FORMS["filtered"]))
    found = spelled_out(model, 0, {"name": "a", "joint": "j", "kp": "20", "kv": ".4", "timeconst": ".01"})
    assert [key for key, value in found.items() if value is None] == ["kp", "kv", "timeconst"]
    assert (found["dyntype"], found["dynprm"], found["biasprm"]) == ("filterexact", "0.01", "0.0 -20.0 -0.4")
