"""A robot whose file cannot take a correction is refused before anything is fitted, and one in another encoding is not."""

from __future__ import annotations

import numpy as np
import pytest

import simgap.robot as robot_module
from mjsim.errors import InputError
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.write import check_writable, write_robot

ARM = """<mujoco>{head}<worldbody><body name="upper"><joint name="{joint}" axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 .3" size=".02" mass="1"/>{before}<body name="lower" pos="0 0 .3">
<joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .3" size=".02" mass="1"/></body>{after}
</body></worldbody>
<actuator><motor name="m1" joint="{joint}"/></actuator></mujoco>"""
PLAIN = {"head": "", "joint": "shoulder", "before": "", "after": ""}
REFUSED = [
    ({"joint": "gear & box"}, "not well-formed XML.*write & as &amp;"),
    ({"before": '<replicate count="1">', "after": "</replicate>"}, "no <body name='lower0'>"),
]


@pytest.mark.parametrize("links", [True, False], ids=["links", "joints"])
@pytest.mark.parametrize("joint", ["shoulder", "gear &amp; box"])
@pytest.mark.parametrize("declared", ["", '<?xml version="1.0" encoding="ISO-8859-1"?>'])
def test_a_file_in_latin_1_takes_a_correction_and_keeps_its_encoding(tmp_path, declared, joint, links):
    path = tmp_path / "arm.xml"
    path.write_bytes((declared + ARM.format(**PLAIN | {"joint": joint, "head": "<!-- Trägheit -->"})).encode("latin-1"))
    robot = load_robot(path)
    check_writable(path, robot, links=links)
    write_robot(path, robot, tmp_path / "out.xml", robot.nominal - robot.fixed, {robot.joints[0]: {"damping": 0.25}}, [])
    assert "Trägheit".encode("latin-1") in (tmp_path / "out.xml").read_bytes()
    assert load_robot(tmp_path / "out.xml").model.dof_damping[0] == 0.25


@pytest.mark.parametrize(("changed", "said"), REFUSED, ids=["ampersand", "copies"])
def test_what_cannot_be_written_is_refused_before_the_fits(tmp_path, monkeypatch, changed, said):
    monkeypatch.setattr(robot_module, "checked", None)  # what comes next
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(**PLAIN | changed))
    joints, t = load_robot(path).joints, 0.002 * np.arange(500)
    moved = np.tile(np.sin(t)[:, None], len(joints))
    log = RobotRecording(t, joints, 0.002, angle=moved, torque=moved)
    with pytest.raises(InputError, match=said):
        robot_module.diagnose_robot_recordings([log], path, tmp_path / "out")
    assert not (tmp_path / "out").exists()
