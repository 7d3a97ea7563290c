"""A tumbling pendulum logged from MuJoCo: its own file needs no physics, nor does one whose bob is lighter."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

from diagnose.options import Options
from simgap.pipeline import diagnose_files

MODEL = """<mujoco model="pendulum"><option timestep="0.001"/><worldbody><body name="link" pos="0 0 1">
  <joint name="j" type="hinge" axis="0 1 0" damping="0.05" frictionloss="0.35"/>
  <geom name="rod" type="capsule" fromto="0 0 0 0 0 -.3" size=".01" mass=".1"/>
  <geom name="bob" type="sphere" pos="0 0 -.3" size=".04" mass="0.8"/></body></worldbody>
  <actuator><motor name="m" joint="j"/></actuator></mujoco>"""
RATE, SECONDS, NOISE = 1000, 8.0, 0.02


def log(path, xml, seed, part):
    """Twelve tones of torque, the speed and the angle with white noise."""
    rng = np.random.default_rng([43, seed, part])
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    t = np.arange(round(RATE * SECONDS)) / RATE
    f = np.exp(rng.uniform(np.log(0.2), np.log(8.0), 12))
    tones = np.sin(2 * np.pi * (f[:, None] * t + rng.uniform(0, 1, 12)[:, None])).sum(0)
    torque = 1.5 * tones / np.sqrt(6) * np.minimum(1, t / 0.2)
    motion = np.empty((len(t), 2))
    for k, u in enumerate(torque):
        motion[k] = data.qvel[0], data.qpos[0]
        data.ctrl[0] = u
        mujoco.mj_step(model, data)
    motion += np.column_stack([rng.normal(0, NOISE / 50, len(t)), rng.normal(0, NOISE, len(t))])[:, ::-1]
    table = np.column_stack([t, torque, motion])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="", fmt="%.9g")
    return path


def diagnosed(folder, xml, recorded, seed):
    """diagnosis.json of a file beside two logs of another one."""
    model = folder / "model.xml"
    model.write_text(xml)
    first, second = (log(folder / f"{part}.csv", recorded, seed, part) for part in (0, 1))
    diagnose_files([first], model, folder / "out", [second], Options(jobs=2), progress=False)
    return json.loads((folder / "out/diagnosis.json").read_text())


@pytest.mark.slow
def test_the_file_itself_is_no_missing_physics(tmp_path):
    found = diagnosed(tmp_path, MODEL, MODEL, 1)
    assert found["verdict"] == "no_mismatch"
    assert not found["findings"]
    assert found["fit"]["corrected"] == found["fit"]["nominal"]


@pytest.mark.slow
def test_a_heavier_bob_is_a_matter_of_numbers(tmp_path):
    frictionless = MODEL.replace(' frictionloss="0.35"', "")
    found = diagnosed(tmp_path, frictionless, frictionless.replace('mass="0.8"', 'mass="0.92"'), 2)
    assert found["verdict"] == "parameters_only"
    assert not found["findings"]
    assert found["fit"]["nominal"]["held_out_rms"] > 100 * NOISE
    assert found["fit"]["corrected"]["rms"] < 1.1 * NOISE
    assert found["fit"]["corrected"]["held_out_rms"] < 2 * NOISE  # numbers known to one part in a million
