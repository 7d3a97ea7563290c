"""Logs of position servos that go to their command by trapezoidal profiles, in plain MuJoCo; the profile is a plain loop."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjsim.recording import Recording
from tests.mjsim.servo_logs import model

DT, PERIOD = 0.01, 1e-3  # of the log, and of the drive [s]
ACCELERATION = 10.0  # [rad/s^2]


def steps(seconds: float, dt: float, seed: int, size: float = 0.8) -> np.ndarray:
    """Commands (N,) that stand for .5 to 1 s, from half a second at zero on."""
    rng = np.random.default_rng(seed)
    out = [np.zeros(round(0.5 / dt))]
    while sum(map(len, out)) * dt < seconds:
        out.append(np.full(round(rng.uniform(0.5, 1.0) / dt), rng.uniform(-size, size)))
    return np.concatenate(out)[: round(seconds / dt)]


def plain_profile(u: np.ndarray, dt: float, h: float, limit: float, acceleration: float, hold: str) -> np.ndarray:
    """Target (N dt / h + 1,) at steps of h [s] for a command (N,) every dt [s]."""
    n = round(dt / h)
    r, v, out = float(u[0]), 0.0, [float(u[0])]
    for k in range(len(u)):
        after = u[min(k + 1, len(u) - 1)]
        for i in range(n):
            c = u[k] if hold == "held" else u[k] + (after - u[k]) * (i + 1) / n
            e = c - r
            brake = acceleration * h
            wanted = math.copysign(min(math.sqrt(brake**2 / 4 + 2 * acceleration * abs(e)) - brake / 2, limit), e)
            v += min(max(wanted - v, -brake), brake)
            r += h * v
            out.append(r)
    return np.array(out)


def log(
    template: str, hold: str, seed: int, seconds: float, limit: float, acceleration: float = ACCELERATION, noise: float = 0.0,
    **true: object,
) -> Recording:  # fmt: skip
    """A log of plain MuJoCo; limit, acceleration: of the target at the joint, infinity for none."""
    m = mujoco.MjModel.from_xml_string(model(template, timestep=0.5 * PERIOD, **true))
    d, gear = mujoco.MjData(m), float(m.actuator_gear[0, 0])
    q = steps(seconds, DT, seed)
    if hold == "linear":  # ramps between the steps
        q = np.convolve(np.pad(q, (20, 0), mode="edge"), np.full(21, 1 / 21), "valid")
    u = gear * q
    each = round(DT / PERIOD)
    if math.isinf(acceleration):
        target = np.repeat(u, each)
        if math.isfinite(limit):
            target = slewed(target, gear * limit * PERIOD)
    else:
        target = plain_profile(u, DT, PERIOD, gear * limit, gear * acceleration, hold)
        target = 0.5 * (target[:-1] + target[1:])
    for _ in range(2000):  # the weight is borne when the log begins
        d.ctrl[0] = u[0]
        mujoco.mj_step(m, d)
    angle = np.empty(len(u))
    for k in range(len(u)):
        angle[k] = d.qpos[0]
        for i in range(each):
            d.ctrl[0] = target[k * each + i]
            mujoco.mj_step(m, d, 2)
    angle += noise * np.random.default_rng(seed).standard_normal(len(u))
    t, none = DT * np.arange(len(u)), np.full(len(u), np.nan)
    return Recording(t, none, None, angle, DT, command=u, hold=hold, hold_stated=True, source=f"{seed}.csv")


def slewed(u: np.ndarray, step: float) -> np.ndarray:
    """What follows u (N,) by no more than a step at a time."""
    out = u.copy()
    for k in range(1, len(u)):
        out[k] = out[k - 1] + min(max(u[k] - out[k - 1], -step), step)
    return out
