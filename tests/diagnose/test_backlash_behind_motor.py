"""A gap between motor and link of a servo whose model is one rigid body: found from command and angle, and written."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numba import njit

from diagnose.options import Options
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis, write_corrected
from mjsim.ode import simulate
from mjsim.recording import Recording
from simgap.pipeline import diagnose_recordings

MOTOR, LINK, GAP, KP, KV, WEIGHT = 0.02, 0.0626, 0.02, 40.0, 1.5, 2.4525
MODEL = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="link"><joint name="j" axis="0 1 0" damping=".07" armature=".02"/>
<inertial pos="0 0 -.25" mass="1" diaginertia=".0001 .0001 .0001"/></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""
SERVO = f'<position name="drive" joint="j" kp="{KP}" kv="{KV}"/>'


@njit
def _turned(command, dt, parts, gap):
    """Angle of the motor (N,) of a servo whose link hangs behind a gap, by symplectic Euler steps."""
    q, v, angle, speed = 0.0, 0.0, 0.0, 0.0
    out, h = np.zeros(len(command)), dt / parts
    for i in range(len(command)):
        out[i] = q
        for _ in range(parts):
            deep = max(q - angle - gap / 2, 0.0) + min(q - angle + gap / 2, 0.0)
            contact = 3000.0 * deep + 3.0 * (v - speed) if deep != 0.0 else 0.0
            if contact * deep < 0.0:
                contact = 0.0
            v += h * (40.0 * (command[i] - q) - 1.57 * v - contact) / 0.02
            speed += h * (contact - 2.4525 * math.sin(angle)) / 0.0626
            q += h * v
            angle += h * speed
    return out


def _log(seed: int, gap: float, count: int = 500, dt: float = 0.01) -> Recording:
    rng = np.random.default_rng(seed)
    t, phase = dt * np.arange(count), rng.uniform(0, 2 * np.pi, 5)
    tones = 0.2 * (30.0 ** (np.arange(5) / 9))
    command = sum(0.35 / (i + 1) * np.sin(2 * np.pi * tones[i] * t + phase[i]) for i in range(5))
    angle = _turned(command, dt, 400, gap) + 1e-4 * rng.standard_normal(count)
    return Recording(t, np.full(count, np.nan), None, angle, dt, command=command)


def _axis(model: Path) -> Axis:
    gap = effect_class("backlash_behind_motor")(gap_rad=GAP, inertia_kgm2=LINK, stiffness_Nm_rad=3000.0, damping_Nms_rad=3.0)
    return load_axis(model) + gap


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "servo.xml"
    path.write_text(MODEL.format(actuator=SERVO), encoding="utf-8")
    return path


SLIDE = MODEL.replace('axis="0 1 0"', 'type="slide" axis="1 0 0"').replace(
    'pos="0 0 -.25" mass="1"', f'pos="0 0 0" mass="{LINK}"'
)


@pytest.mark.parametrize("text", [MODEL, SLIDE], ids=["hinge", "slide"])
def test_mujoco_steps_the_slack_joint_that_is_written_as_the_equations_say(tmp_path: Path, model: Path, text: str) -> None:
    """A body of slides along an axis of its frame is a "simple" one to MuJoCo, with a diagonal inertia matrix: not here."""
    model.write_text(text.format(actuator='<motor name="drive" joint="j"/>'), encoding="utf-8")
    axis, dt, count = _axis(model), 0.002, 1000
    torque = 1.5 * np.sin(2 * np.pi * 0.7 * dt * np.arange(count))
    assert write_corrected(model, axis, tmp_path / "corrected.xml").lacks == ()
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    data, steps = mujoco.MjData(m), round(dt / m.opt.timestep)
    speed = np.zeros(count)
    for i in range(count):
        speed[i] = data.joint("j").qvel[0]
        data.ctrl[0] = torque[i]
        mujoco.mj_step(m, data, steps)
    run = simulate(axis, torque, dt)
    rigid = simulate(load_axis(model), torque, dt)
    change = float(np.std(run.velocity - rigid.velocity))
    assert float(np.std(speed - run.velocity)) < 0.05 * change


@pytest.mark.parametrize("text", [MODEL, SLIDE], ids=["hinge", "slide"])
def test_the_slack_joint_can_be_taken_back(tmp_path: Path, model: Path, text: str) -> None:
    model.write_text(text.format(actuator=SERVO), encoding="utf-8")
    write_corrected(model, _axis(model), tmp_path / "corrected.xml")
    assert load_axis(tmp_path / "corrected.xml").effects == _axis(model).effects
    write_corrected(tmp_path / "corrected.xml", load_axis(model), tmp_path / "back.xml")
    assert "slack" not in (tmp_path / "back.xml").read_text(encoding="utf-8")


FINE = MODEL.replace('timestep="0.002" integrator="implicitfast"', 'timestep="2e-4" integrator="RK4"')


@pytest.mark.slow
@pytest.mark.parametrize(("text", "numerics"), [(FINE, []), (MODEL, ["coarse_timestep"])], ids=["fine steps", "coarse steps"])
def test_a_gap_behind_the_motor_is_named_and_the_file_follows_the_recording(
    tmp_path: Path, model: Path, text: str, numerics: list[str]
) -> None:
    """Steps of 2 ms are coarse for a gap that was recorded in finer ones: that is said beside it."""
    model.write_text(text.format(actuator=SERVO), encoding="utf-8")
    effects = ("backlash", "extra_flexible_mode")
    options = Options(effects=effects, jobs=1)
    found = diagnose_recordings([_log(1, GAP)], model, tmp_path / "out", [_log(2, GAP)], options, progress=False, page=False)
    assert [f.effect for f in found.findings] == ["backlash", *numerics]
    numbers = found.findings[0].parameters
    assert numbers["gap_rad"].value == pytest.approx(GAP, rel=0.15)
    assert numbers["inertia_kgm2"].value == pytest.approx(LINK, rel=0.1)
    assert found.fit["corrected"].held_out_rms < 0.5 * found.fit["refitted"].held_out_rms
