"""Logs made by plain MuJoCo, and plain MuJoCo beside a log."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from lab.real_use.design import Case
from lab.real_use.machines import JOINT, Extent, Numbers
from mjsim.mjcf.compile import caught_warnings

__all__ = ["Log", "extent", "follow", "make", "wave_of"]

SECONDS = {100.0: 12.0, 250.0: 10.0}
SHORT = 6.0  # [s] of logs at higher rates
NOISE = (0.003, 0.02)  # of the velocity, over its rms; of the angle likewise where the log has no velocity
TONES = 10


@dataclass(frozen=True, eq=False)
class Log:
    """input: torque or force of the actuator, or command of a servo; noise: rms of that of the velocity, else of the angle."""

    time: np.ndarray
    input: np.ndarray
    velocity: np.ndarray | None
    angle: np.ndarray
    noise: float

    @property
    def compared(self) -> np.ndarray:
        """What the diagnosis compares."""
        return self.angle if self.velocity is None else self.velocity

    def write(self, path: Path) -> None:
        """Write the log as CSV."""
        columns = [self.time, self.input, *([] if self.velocity is None else [self.velocity]), self.angle]
        names = ["time_s", "command_rad" if self.velocity is None else "torque_Nm"]
        names += [*([] if self.velocity is None else ["velocity_rad_s"]), "angle_rad"]
        np.savetxt(path, np.column_stack(columns), delimiter=",", header=",".join(names), comments="", fmt="%.9g")


def wave_of(rng: np.random.Generator, t: np.ndarray, top: float) -> np.ndarray:
    """Unit rms: tones between .2 Hz and ``top``, faded in."""
    f = np.exp(rng.uniform(math.log(0.2), math.log(top), TONES))
    x = np.sin(2 * np.pi * (f[:, None] * t + rng.uniform(0, 1, TONES)[:, None])).sum(axis=0)
    return np.asarray(x / math.sqrt(TONES / 2) * np.minimum(1.0, t / 0.2))


def _reference(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Target of a position loop, unit rms: slow tones and steps, each half of the time in turn."""
    wave = wave_of(rng, t, 2.0)
    steps = rng.uniform(-1.7, 1.7, math.ceil(t[-1] / 0.5) + 1)[(t / 0.5).astype(int)]
    return np.where((t / 2.0).astype(int) % 2 == 0, wave, steps)


def _drive(case: Case, given: Numbers, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Time, and the torque at the joint in open loop, else the target of the position loop."""
    t = np.arange(round(SECONDS.get(case.rate, SHORT) * case.rate)) / case.rate
    if case.loop == "open":
        return t, given.torque * wave_of(rng, t, min(10.0, case.rate / 10))
    return t, given.swing * _reference(rng, t)


def make(case: Case, xml: str, given: Numbers, which: int) -> Log:
    """Run MuJoCo as the case says, the input held over each sample; a controller sees the noisy log."""
    rng = np.random.default_rng([case.seed, 2, which])
    t, wave = _drive(case, given, rng)
    level, draws = rng.uniform(*NOISE), rng.standard_normal((2, len(t)))
    _, v, q, _ = _run(case, xml, given, wave, np.zeros((2, len(t))))  # without noise, for its size
    sizes = level * float(np.std(v)), level * float(np.std(v)) / 50.0
    if case.loop == "servo":
        sizes = (0.0, level * float(np.std(q)) / 4.0)
    noise = np.array(sizes)[:, None] * draws
    u, v, q, _ = _run(case, xml, given, wave, noise)
    servo = case.loop == "servo"
    return Log(t, u, None if servo else v + noise[0], q + noise[1], sizes[1] if servo else sizes[0])


def _run(
    case: Case, xml: str, given: Numbers, wave: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Input, velocity, angle and torque of the actuator at the joint, of a run from rest."""
    m = mujoco.MjModel.from_xml_string(xml)
    data, (u, v, q, torque) = mujoco.MjData(m), np.empty((4, len(wave)))
    steps, at = round(1 / (case.rate * m.opt.timestep)), (m.joint(JOINT).qposadr[0], m.joint(JOINT).dofadr[0])
    with caught_warnings():
        for k, w in enumerate(wave):
            q[k], v[k] = data.qpos[at[0]], data.qvel[at[1]]
            u[k] = given.gear * w if case.loop == "servo" else w / given.gear
            if case.loop == "pd":
                u[k] = (given.kp * (w - q[k] - noise[1, k]) - given.kv * (v[k] + noise[0, k])) / given.gear
            data.ctrl[0] = u[k]
            mujoco.mj_step(m, data, steps)
            torque[k] = data.qfrc_actuator[at[1]]
    return u, v, q, torque


def extent(case: Case, xml: str, given: Numbers) -> Extent:
    """How far the nominal machine goes."""
    t, wave = _drive(case, given, np.random.default_rng([case.seed, 2, 0]))
    _, v, q, torque = _run(case, xml, given, wave, np.zeros((2, len(t))))
    return Extent(float(np.max(np.abs(q))), *(float(np.sqrt(np.mean(x**2))) for x in (v, torque)))


def _stepped(m: mujoco.MjModel, rate: float, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and angle of the joint, from rest, the input held over each sample."""
    data, v, q = mujoco.MjData(m), np.empty(len(u)), np.empty(len(u))
    steps, at = round(1 / (rate * m.opt.timestep)), (m.joint(JOINT).qposadr[0], m.joint(JOINT).dofadr[0])
    with caught_warnings():
        for k, x in enumerate(u):
            q[k], v[k] = data.qpos[at[0]], data.qvel[at[1]]
            data.ctrl[0] = x
            mujoco.mj_step(m, data, steps)
    return v, q


def follow(model: Path | str, rate: float, log: Log) -> float:
    """Rms error of a file or text, stepped by plain MuJoCo on the input of a log; infinite where it diverges."""
    load = mujoco.MjModel.from_xml_string if isinstance(model, str) else lambda p: mujoco.MjModel.from_xml_path(str(p))
    v, q = _stepped(load(model), rate, log.input)
    e = log.compared - (q if log.velocity is None else v)
    error = float(np.sqrt(np.mean(e**2)))
    return error if math.isfinite(error) and error < 1e6 * float(np.std(log.compared)) else math.inf
