"""A pendulum or a balanced link on one motor, with physics of its own, integrated here by semi-implicit Euler.

    J(t) q'' = g(t) u - b q' - m g l sin q + d(t, q, q') - f sign q'

No effect of the library and no solver of simgap takes part.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["FORMS", "KINDS", "Machine", "draw", "write_case"]

FORMS = ("torque_velocity_angle", "torque_angle", "torque_angle_feedback", "command_angle")
SECONDS, SUBSTEPS = 8.0, 10
STEP = 2.0 * math.pi / 8192  # of the encoder [rad]

STIFF, DAMPED = 200.0, 20.0  # gains of a position loop over the inertia [1/s^2], [1/s]

Torque = Callable[["Machine", float, float, float, float], float]


@dataclass
class Machine:
    """Numbers of one machine: inertia [kg m^2], friction [N m s/rad], weight [N m]; size [N m] of what is missing.

    friction: Coulomb friction beside it [N m]; second: whether this is the held-out recording; waves: of a rough surface; state:
    what a law remembers.
    """

    inertia: float
    viscous: float
    weight: float
    size: float
    rate: float
    waves: np.ndarray
    draws: np.random.Generator
    second: bool = False
    state: float = 0.0
    friction: float = 0.0


def _push(m: Machine, t: float, q: float, v: float, h: float) -> float:
    return m.size * math.sin(2 * math.pi * 0.37 * t + (2.0 if m.second else 1.0)) if t > 0.2 * SECONDS else 0.0


def _wandering_friction(m: Machine, t: float, q: float, v: float, h: float) -> float:
    m.state += 0.6 * m.size * math.sqrt(h) * float(m.draws.standard_normal())
    return -(m.size + m.state) * math.tanh(v / 0.02)


def _rough(m: Machine, t: float, q: float, v: float, h: float) -> float:
    orders = 1.7 * np.arange(3, 3 + m.waves.shape[1])
    surface = float(np.sum(m.waves[0] * np.sin(orders * q + 6.0 * m.waves[1]))) / 3.0
    return -m.size * (1.0 + 0.5 * surface) * math.tanh(v / 0.02)


def _cable(m: Machine, t: float, q: float, v: float, h: float) -> float:
    m.state += h * (v - abs(v) * m.state / 0.15)
    return -m.size * (0.6 * q**3 + 0.5 * m.state / 0.15)


def _other_damping(m: Machine, t: float, q: float, v: float, h: float) -> float:
    return -3.0 * m.viscous * v if m.second else 0.0


def _kicks(m: Machine, t: float, q: float, v: float, h: float) -> float:
    return 6.0 * m.size if (1.3 * t) % 1.0 < 0.02 else 0.0


def _friction_at_speed(m: Machine, t: float, q: float, v: float, h: float) -> float:
    return -m.size * math.copysign(1.0, v) if abs(v) > 1.2 else 0.0


def _nothing(m: Machine, t: float, q: float, v: float, h: float) -> float:
    return 0.0


KINDS: dict[str, Torque] = {
    "push": _push, "wandering_friction": _wandering_friction, "rough_surface": _rough, "cable": _cable,
    "other_damping_when_held_out": _other_damping, "kicks": _kicks, "friction_at_speed": _friction_at_speed,
    "payload_falls_off": _nothing, "gain_falls": _nothing, "slow_amplifier": _nothing,
}  # fmt: skip


def _drive(kind: str, m: Machine, t: float, u: float, h: float) -> tuple[float, float]:
    """Torque that acts [N m], and inertia [kg m^2]."""
    if kind == "gain_falls":
        return u * (1.0 - 0.3 * t / SECONDS), m.inertia
    if kind == "payload_falls_off":
        return u, m.inertia * (1.6 if t < 0.5 * SECONDS else 1.0)
    if kind == "slow_amplifier":  # follows at no more than so many N m/s
        most = 120.0 * m.inertia
        m.state += h * min(max((u - m.state) / 0.004, -most), most)
        return m.state, m.inertia
    return u, m.inertia


def draw(rng: np.random.Generator) -> tuple[Machine, str]:
    """A machine, and its nominal MJCF, which lacks the physics."""
    mass, gravity = rng.uniform(0.5, 3.0), float(rng.choice([0.0, 9.81]))
    inertia = mass * 0.4**2 / 3.0 * 1.005
    viscous = rng.uniform(0.4, 1.6) * inertia
    text = (
        f'<mujoco><option timestep=".001" gravity="0 0 {-gravity}" integrator="implicitfast"/><worldbody><body>'
        f'<joint name="hinge" axis="0 1 0" damping="{viscous}"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="{mass}" contype="0" conaffinity="0"/></body></worldbody>'
        '<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>'
    )
    waves = rng.standard_normal((2, 12))
    rate = float(rng.choice([100.0, 250.0, 500.0]))
    return Machine(inertia, viscous, mass * gravity * 0.2, 2.5 * inertia, rate, waves, rng), text


def write_case(kind: str, form: str, seed: int, folder: Path, friction: bool = False) -> float:
    """Write model.xml, fitted.csv and held_out.csv; returns the noise rms of what is judged (velocity, else angle).

    friction: Coulomb friction acts as well, 1 to 2 times the size of the unknown physics, and the model lacks it.
    """
    rng = np.random.default_rng(seed)
    m, text = draw(rng)
    if friction:
        m.friction = rng.uniform(1.0, 2.0) * m.size
    folder.mkdir(parents=True, exist_ok=True)
    servo = form == FORMS[3]
    if servo:
        gains = f'kp="{STIFF * m.inertia}" kv="{DAMPED * m.inertia}"'
        text = text.replace('<motor name="drive" joint="hinge"/>', f'<position name="drive" joint="hinge" {gains}/>')
    (folder / "model.xml").write_text(text, encoding="utf-8")
    tones, phases = rng.uniform(0.2, 4.0, 6), rng.uniform(0.0, 2 * math.pi, (2, 6))
    noise = STEP / math.sqrt(12.0)
    for which, name in enumerate(("fitted", "held_out")):
        m.second, m.state = bool(which), 0.0
        log = _run(kind, m, tones, phases[which], form == FORMS[2] or servo, servo)
        q = np.round((log[1] + rng.normal(0.0, STEP / 3, len(log[1]))) / STEP) * STEP
        columns, header = [np.arange(len(q)) / m.rate, log[0], q], f"time_s,{'command_rad' if servo else 'torque_Nm'},angle_rad"
        if form == FORMS[0]:
            noise = 0.01 * float(np.std(log[2]))
            columns.append(log[2] + rng.normal(0.0, noise, len(q)))
            header += ",velocity_rad_s"
        np.savetxt(folder / f"{name}.csv", np.column_stack(columns), "%.9g", ",", header=header, comments="")
    return noise


def _run(kind: str, m: Machine, tones: np.ndarray, phases: np.ndarray, feedback: bool, servo: bool) -> np.ndarray:
    """Torque (of a servo: the commanded angle, which it follows at every substep), angle and velocity (3, N)."""
    n, dt = int(SECONDS * m.rate), 1.0 / m.rate
    out = np.empty((3, n))
    q = v = target = 0.0
    for k in range(n):
        t = k * dt
        if feedback:
            target = 0.8 * float(np.sum(np.sin(0.5 * math.pi * tones * t + phases) - np.sin(phases))) / 3.0
            u = m.inertia * (STIFF * (target - q) - DAMPED * v)
        else:
            u = 2.5 * (m.inertia + 0.4 * m.friction) * float(np.sum(tones * np.sin(2 * math.pi * tones * t + phases)))
        out[:, k] = target if servo else u, q, v
        h = dt / SUBSTEPS
        for i in range(SUBSTEPS):
            if servo:
                u = m.inertia * (STIFF * (target - q) - DAMPED * v)
            acting, inertia = _drive(kind, m, t + i * h, u, h)
            extra = KINDS[kind](m, t + i * h, q, v, h)
            v += h * (acting + extra - m.viscous * v - m.weight * math.sin(q)) / inertia
            v = math.copysign(max(abs(v) - h * m.friction / inertia, 0.0), v)  # at rest, friction holds what it can
            q += h * v
    return out
