"""Logs of position servos, made by plain MuJoCo: a pendulum and a geared hinge, logged as users do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from mjsim.recording import Recording

PENDULUM = """
<mujoco model="servo_pendulum">
  <compiler angle="radian"/>
  <option timestep="{timestep}" integrator="RK4"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{damping}" armature="{armature}" frictionloss="{friction}"
             solreffriction="-1 -5000" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>
      <inertial pos="0 0 -0.15" mass="{mass}" diaginertia="0.002 0.002 0.0005"/>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="hinge" kp="{kp}" kv="{kv}"{more}/>
  </actuator>
  <sensor><jointpos name="angle" joint="hinge"/></sensor>
</mujoco>
"""

GEARED = """
<mujoco model="servo_hinge">
  <compiler angle="radian"/>
  <option timestep="{timestep}" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" type="hinge" axis="0 0 1" damping="{damping}" armature="{armature}" frictionloss="{friction}"
             solreffriction="-1 -5000" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>
      <inertial pos="0 0 0" mass="{mass}" diaginertia="0.01 0.01 0.02"/>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="hinge" gear="20" kp="{kp}" kv="{kv}"{more}/>
  </actuator>
  <sensor><jointpos name="angle" joint="hinge"/></sensor>
</mujoco>
"""

NUMBERS = {
    PENDULUM: {
        "damping": 0.05,
        "armature": 0.01,
        "friction": 0.0,
        "mass": 0.5,
        "kp": 8.0,
        "kv": 0.3,
        "more": "",
        "timestep": 5e-4,
    },
    GEARED: {
        "damping": 0.05,
        "armature": 0.02,
        "friction": 0.0,
        "mass": 0.5,
        "kp": 0.03,
        "kv": 0.001,
        "more": "",
        "timestep": 5e-4,
    },
}

Change = Callable[[np.ndarray, float, float], np.ndarray]


def model(template: str, **numbers: object) -> str:
    """The MJCF text."""
    return template.format(**{**NUMBERS[template], **numbers})


def write(path: Path, template: str, **numbers: object) -> Path:
    """The MJCF file."""
    path.write_text(model(template, **numbers), encoding="utf-8")
    return path


def command(seconds: float, dt: float, seed: int, amplitude: float = 0.6, top: float = 1.5) -> np.ndarray:
    """A position command: steps, slow swings and a band-limited wave, in turn."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(round(seconds / dt))
    wave = sum(rng.uniform(0.3, 1.0) * np.sin(2 * np.pi * rng.uniform(0.1, top) * t + rng.uniform(0, 6.28)) for _ in range(6))
    steps = np.repeat(rng.uniform(-1, 1, len(t) // round(1.0 / dt) + 1), round(1.0 / dt))[: len(t)]
    kind = (t // 5).astype(int) % 2
    return amplitude * np.where(kind == 0, wave / 2.0, steps)


def record(
    text: str, *, rate: float = 100.0, seconds: float = 30.0, seed: int = 0, step: float = 0.001534, hold: str = "held",
    gear: float = 1.0, deadband: float = 0.0, amplitude: float = 0.6, noise: float = 2e-4,
    torque: float = 0.0,
) -> Recording:  # fmt: skip
    """A log of command and angle: the model under plain MuJoCo, the angle in steps of an encoder.

    gear: of the actuator, whose length the command is; deadband: of the servo, which MJCF does not have, by moving the command;
    torque: at the joint, constant.
    """
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    dt = 1.0 / rate
    each = round(dt / m.opt.timestep)
    c = gear * command(seconds, dt, seed, amplitude)
    following = np.append(c[1:], c[-1])
    q = np.empty(len(c))
    d.qpos[0], d.qfrc_applied[0] = c[0] / gear, torque
    for k in range(len(c)):
        q[k] = d.qpos[0]
        if hold == "held" and deadband == 0.0:  # one input over the whole sample
            d.ctrl[0] = c[k]
            mujoco.mj_step(m, d, each)
            continue
        for i in range(each):
            u = c[k] if hold == "held" else c[k] + (following[k] - c[k]) * (i + 0.5) / each
            e = u - gear * d.qpos[0]
            d.ctrl[0] = u - min(max(e, -deadband), deadband)
            mujoco.mj_step(m, d)
    rng = np.random.default_rng(seed + 1000)
    seen = q + noise * rng.standard_normal(len(q))
    seen = step * np.round(seen / step) if step else seen
    return Recording(
        dt * np.arange(len(c)), np.full(len(c), np.nan), None, seen, dt, source=f"servo_{seed}.csv", command=c, hold=hold
    )
