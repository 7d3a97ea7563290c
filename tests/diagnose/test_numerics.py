"""Settings of the simulator that act like physics, from log to corrected file: found, sized, mended, never called physics."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

from diagnose.options import Options
from mjsim.mjcf import load_axis
from mjsim.plant import MujocoPlant
from simgap.pipeline import diagnose_files

FINE = 5e-5
HARD = f'solreflimit="{-1 / FINE**2:.6g} {-2 / FINE:.6g}" solimplimit=".9999 .9999 .001 .5 2"'
AXIS = """<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
  <body name="motor"><joint name="motor" axis="0 0 1" damping=".05"/><inertial pos="0 0 0" mass="1" diaginertia=".02 .02 .02"/>
  <body name="load">{slack}<joint name="shaft" axis="0 0 1" stiffness="{stiffness}" damping="{damping}"/>
  <inertial pos="0 0 0" mass="1" diaginertia=".05 .05 .05"/></body></body></worldbody>{across}
  <actuator><motor name="drive" joint="motor"/></actuator></mujoco>"""
ACROSS = """<tendon><fixed name="across" damping=".3"><joint joint="slack" coef="1"/><joint joint="shaft" coef="1"/></fixed>
  </tendon>"""


def elastic(step, integrator):
    """Two inertias on a spring."""
    return AXIS.format(step=step, integrator=integrator, slack="", stiffness=20, damping=0.02, across="")


def with_gap(step, solver):
    """Two inertias on a spring with play: a joint within limits."""
    slack = f'<joint name="slack" axis="0 0 1" limited="true" range="-.0025 .0025" armature="5e-4" {solver}/>'
    return AXIS.format(step=step, integrator="RK4", slack=slack, stiffness=120, damping=0, across=ACROSS)


def diagnosed(folder, given, true, dt, seconds, torque, sigma):
    """diagnosis.json of two logs of a machine that MuJoCo steps, and a file."""
    (folder / "nominal.xml").write_text(given, encoding="utf-8")
    m, logs = mujoco.MjModel.from_xml_string(true), []
    for seed in (1, 2):
        d, rng, t = mujoco.MjData(m), np.random.default_rng(seed), dt * np.arange(round(seconds / dt))
        u = torque * np.sin(2 * np.pi * (0.4 + 0.5 * t) * t + seed) * np.minimum(t, 1.0)
        motion = np.empty((len(t), 2))
        for k in range(len(t)):
            motion[k], d.ctrl[0] = (d.qvel[0], d.qpos[0]), u[k]
            mujoco.mj_step(m, d, round(dt / m.opt.timestep))
        motion += rng.standard_normal(motion.shape) * (sigma, 1e-4)
        logs.append(folder / f"log_{seed}.csv")
        header = "time_s,torque_Nm,velocity_rad_s,angle_rad"
        np.savetxt(logs[-1], np.column_stack([t, u, motion]), delimiter=",", header=header, comments="")
    diagnose_files(logs[:1], folder / "nominal.xml", folder / "out", logs[1:], Options(jobs=1), progress=False, page=False)
    return json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))


def mended_alone(said, effect, sigma):
    """The finding, once it is the only one and of class numerics, and the corrected file at the noise."""
    (finding,) = said["findings"]
    assert (said["verdict"], finding["effect"], finding["class"]) == ("parameters_only", effect, "numerics")
    assert said["fit"]["corrected"]["held_out_rms"] == pytest.approx(sigma, rel=0.06)
    assert said["fit"]["nominal"]["held_out_rms"] > 3 * sigma
    assert finding["evidence"]["held_out_error_after"] == pytest.approx(said["fit"]["corrected"]["held_out_rms"])
    return finding["evidence"]


def test_a_coarse_timestep_is_found_sized_and_mended(tmp_path):
    said = diagnosed(tmp_path, elastic(4e-3, "Euler"), elastic(1e-4, "RK4"), 4e-3, 6.0, 0.5, 0.005)
    size = mended_alone(said, "coarse_timestep", 0.005)
    assert size["difference_over_noise"] > 3 > 0.2 > size["difference_over_noise_mended"]
    m = MujocoPlant.load(tmp_path / "out" / "corrected.xml").model
    assert (m.opt.timestep, m.opt.integrator) == (2e-3, mujoco.mjtIntegrator.mjINT_RK4)
    given, mended = (load_axis(tmp_path / name).chain for name in ("nominal.xml", "out/corrected.xml"))
    assert given == mended  # its numbers were right


@pytest.mark.slow  # hard limits take twenty times the steps
def test_a_soft_limit_is_found_sized_and_mended(tmp_path):
    said = diagnosed(tmp_path, with_gap(5e-4, ""), with_gap(FINE, HARD), 2e-3, 3.0, 1.0, 0.02)
    size = mended_alone(said, "soft_limit", 0.02)
    assert size["difference_over_noise"] > 3
    m = MujocoPlant.load(tmp_path / "out" / "corrected.xml").model
    assert m.opt.timestep == FINE
    assert m.jnt_solref[m.joint("slack").id, 0] == pytest.approx(-1 / FINE**2, rel=1e-6)
