"""A joint of a servo robot without a mismatch, whose file errs in MuJoCo by its timestep."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from diagnose.result import Verdict
from mjsim.robot.recording import RobotRecording
from simgap.robot import diagnose_robot_recordings

DT, NOISE = 0.02, 5e-4
ARM = """<mujoco><option timestep="{timestep}" integrator="implicitfast"/><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping=".2" armature=".02"/>
<inertial pos=".15 0 0" mass="1.2" diaginertia=".002 .01 .01"/>
<body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" damping=".02" armature=".004"/>
<inertial pos=".1 0 0" mass=".4" diaginertia=".0005 .001 .001"/></body></body></worldbody>
<actuator><position name="s1" joint="shoulder" kp="{kp}" kv="5"/><position name="s2" joint="elbow" kp="15" kv=".5"/></actuator>
</mujoco>"""


def recorded(seed: int, seconds: float = 12.0) -> RobotRecording:
    m = mujoco.MjModel.from_xml_string(ARM.format(timestep=0.0002, kp=100))
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    t = np.arange(round(seconds / DT)) * DT
    f, phase = rng.uniform(0.1, 1.0, (2, 5, 1)), rng.uniform(0, 2 * np.pi, (2, 5, 1))
    command = 0.25 * np.sin(2 * np.pi * f * t + phase).sum(axis=1).T
    command = command - command[0] * np.exp(-t / 0.3)[:, None]
    angle = np.empty_like(command)
    for k in range(-50, len(t)):
        if k >= 0:
            angle[k] = d.qpos
        d.ctrl[:] = command[max(k, 0)]
        mujoco.mj_step(m, d, 100)
    angle += NOISE * rng.standard_normal(angle.shape)
    return RobotRecording(
        t, ("shoulder", "elbow"), DT, angle, command=command, hold="held", hold_stated=True, source=f"{seed}.csv"
    )


@pytest.mark.slow
def test_the_corrected_file_takes_up_the_integration_error_of_such_a_joint(tmp_path):
    """The gain of the shoulder differs, no number of the elbow does; MuJoCo at 5 ms errs at both."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(timestep=0.005, kp=80))
    logs = [recorded(seed) for seed in (1, 2)]
    found = diagnose_robot_recordings(logs[:1], path, tmp_path / "out", logs[1:], page=False)
    assert found.findings == ()
    assert {n: r.verdict for n, r in found.joints.items()} == {
        "shoulder": Verdict.PARAMETERS_ONLY, "elbow": Verdict.NO_MISMATCH,
    }  # fmt: skip
    elbow = found.joints["elbow"].fit
    assert elbow["corrected"].held_out_rms < 0.5 * elbow["nominal"].held_out_rms
    assert any("elbow" in note and "integration error" in note for note in found.notes)
