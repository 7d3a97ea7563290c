"""What the machine of a case has and the user's file lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from lab.real_use.firmware.design import ARM, JOINTS, Case
from lab.real_use.firmware.drive import Firmware
from lab.real_use.firmware.machine import Machine, Passive, log_of

__all__ = ["machines"]

LEAST = 1e-9  # [N m | N] of a friction, which MuJoCo takes for none at zero
HOLDS = (0.99, 0.999)  # solimp of a friction that creeps by little


def machines(case: Case) -> tuple[Machine, Machine, list[tuple[str, str]]]:
    """The user's machine, the true one, and the effects of the truth as (joint, effect)."""
    rng = np.random.default_rng([case.seed, 1])
    given = _arm(rng) if case.machine == "arm" else _joint(case, rng)
    if case.kind == "friction_and_payload":
        true, where = _arm_truth(replace(case, kind="payload"), given, rng)
        true, where = _arm_truth(replace(case, kind="friction"), true, rng)
    elif case.machine == "arm":
        true, where = _arm_truth(case, given, rng)
    else:
        parts = case.kind.removeprefix("friction_and_") if case.kind.startswith("friction_and_") else case.kind
        true = _truth(replace(case, kind=parts), given, rng)
        if parts != case.kind:
            true = _truth(replace(case, kind="dry_friction"), true, rng)
        return given, true, []
    return given, true, [(joint, effect) for joint in where for effect in ARM[case.kind]]


def _joint(case: Case, rng: np.random.Generator) -> Machine:

    def about(x: float) -> float:
        return float(x * 1.5 ** rng.uniform(-1.0, 1.0))

    mass = about(0.8) if case.machine != "slide" else about(2.0)
    lever = about(0.22) if case.machine == "pendulum" else 0.0
    inertia = about(0.02)
    load = mass if case.machine == "slide" else inertia + mass * lever**2
    armature = load * about(0.2)
    total = load + armature
    bandwidth, ratio = about(22.0), rng.uniform(0.5, 1.0)
    kp, kv = total * bandwidth**2, 2.0 * ratio * total * bandwidth
    known = float(rng.choice([0.0, 0.03])) * kp * (0.15 if case.machine == "slide" else 0.8)
    friction = 0.0 if "friction" in case.kind or case.kind in ("stribeck", "asymmetric") else known
    return Machine(case.machine, Firmware(kp, kv), mass, lever, inertia, armature, 0.05 * kv, (friction,))


def _size(case: Case, given: Machine, rng: np.random.Generator) -> tuple[float, float, float]:
    """Largest force, speed and angle of the nominal machine in its first log, times .8 to 1.25."""
    _, angle, peak = log_of(replace(case, sensor="noise"), given, 0, 8.0)
    speed = np.abs(np.gradient(angle[:, 0])) * case.rate
    by = 1.25 ** rng.uniform(-1.0, 1.0)
    return by * float(peak[0]), by * float(np.quantile(speed, 0.98)), by * float(np.max(np.abs(angle)))


def _friction(level: Callable[[np.ndarray, mujoco.MjData], np.ndarray]) -> Passive:
    """Friction of a level [N m | N] that depends on the speed and the state, against the motion, at the first joint.

    It is the joint's ``frictionloss``, set at each step, with solver parameters under which it holds at rest.
    """

    def force(m: mujoco.MjModel, d: mujoco.MjData) -> np.ndarray:
        m.dof_frictionloss[0] = max(float(level(d.qvel, d)[0]), LEAST)
        m.dof_solref[0] = (2.0 * m.opt.timestep, 1.0)
        m.dof_solimp[0, :2] = HOLDS
        return np.zeros(m.nv)

    return force


def _spring(stiffness: float, rest: float) -> Passive:
    def force(_: mujoco.MjModel, d: mujoco.MjData) -> np.ndarray:
        out = np.zeros(len(d.qvel))
        out[0] = -stiffness * (d.qpos[0] - rest)
        return out

    return force


def _truth(case: Case, given: Machine, rng: np.random.Generator) -> Machine:
    force, speed, angle = _size(case, given, rng)
    kp, kv = float(given.firmware.kp), float(given.firmware.kv)  # type: ignore[arg-type]
    by = 1.25 ** float(rng.choice([-1.0, 1.0]))
    load = given.mass if case.machine == "slide" else given.inertia + given.mass * given.lever**2
    # the load on the clamped motor swings at 1 to 2 times the bandwidth of the loop
    shaft = load * rng.uniform(1.0, 2.0) ** 2 * kp / (load + given.armature)
    passive = _passive(case.kind, force, speed, angle, 0.25 * rng.uniform(0.8, 1.25))
    if passive is not None:
        return replace(given, passive=(passive,))
    match case.kind:
        case "nothing":
            return given
        case "gains":
            return given.with_drive(kp=kp * by, kv=kv / by)
        case "load":
            return replace(given, mass=given.mass * 1.3, inertia=given.inertia * 1.3)
        case "dry_friction":
            return replace(given, friction=(0.15 * force,))
        case "stop":
            return replace(given, stop=0.6 * angle)
        case "backlash":
            return replace(given, gap=0.06 * angle)
        case "elastic":
            return replace(given, stiffness=shaft)
        case kind:
            return given.with_drive(**_drive_truth(kind, kp, kv, force, speed, angle, rng))


def _passive(kind: str, force: float, speed: float, angle: float, slope: float) -> Passive | None:
    """What acts beside the drive, or None; slope: of a friction over the force of the drive."""
    match kind:
        case "load_friction":
            return _friction(lambda v, d: slope * np.abs(d.qfrc_actuator) + 0.01 * force)
        case "stribeck":
            return _friction(lambda v, d: 0.08 * force * (1.0 + np.exp(-((v / (0.06 * speed)) ** 2))))
        case "asymmetric":
            return _friction(lambda v, d: 0.12 * force * np.where(v > 0, 1.0, 0.5))
        case "drag":
            return _friction(lambda v, d: 0.3 * force * (v / speed) ** 2)
        case "spring":
            return _spring(0.5 * force / angle, 0.1 * angle)
    return None


def _drive_truth(
    kind: str, kp: float, kv: float, force: float, speed: float, angle: float, rng: np.random.Generator
) -> dict[str, float]:
    match kind:
        case "profile":
            return {"acceleration": 8.0 * speed * rng.uniform(0.7, 1.4), "speed": 0.8 * speed}
        case "latency":
            return {"latency": float(rng.choice([0.02, 0.03, 0.045]))}
        case "deadband":
            return {"deadband": 0.02 * angle}
        case "torque_speed":
            return {"stall": 0.9 * force, "free_speed": speed}
        case "feedforward":
            return {"lead": kv * rng.uniform(0.6, 1.0)}
        case "integral":
            return {"ki": kp * float(np.exp(rng.uniform(np.log(0.5), np.log(4.0))))}
        case "lag":
            return {"lag": 0.25 * kv / kp}
        case "slew":
            return {"speed": 0.6 * speed}
        case "limit":
            return {"limit": 0.5 * force}
    raise ValueError(kind)


def _arm(rng: np.random.Generator) -> Machine:
    scale = float(1.3 ** rng.uniform(-1.0, 1.0))
    stiff = np.array([80.0, 80.0, 40.0, 10.0]) * scale**4 * rng.uniform(0.8, 1.25, 4)
    damping = np.array([4.0, 4.0, 2.0, 0.4]) * scale**4 * rng.uniform(0.8, 1.25, 4)
    firmware = Firmware(kp=tuple(stiff.tolist()), kv=tuple(damping.tolist()))
    return Machine("arm", firmware, damping=0.2 * scale**4, friction=(0.0,) * 4, scale=scale)


def _arm_truth(case: Case, given: Machine, rng: np.random.Generator) -> tuple[Machine, list[str]]:
    kp, kv = (np.array(x) for x in (given.firmware.kp, given.firmware.kv))
    every, one = list(JOINTS), int(rng.integers(len(JOINTS)))

    def only(value: float, other: float) -> tuple[float, ...]:
        return tuple(value if i == one else other for i in range(len(JOINTS)))

    match case.kind:
        case "gains":
            by = 1.25 ** rng.choice([-1.0, 1.0], 4)
            return given.with_drive(kp=tuple((kp * by).tolist())), []
        case "payload":
            return replace(given, payload=0.35 * given.scale**2), []
        case "friction":
            level = np.array([0.008, 0.01, 0.01, 0.012]) * kp * rng.uniform(0.7, 1.4)
            return replace(given, friction=tuple(level.tolist())), every
        case "compensation":
            return replace(given, compensated=True), []
        case "latency":
            return given.with_drive(latency=float(rng.choice([0.03, 0.045, 0.06]))), every
        case "profile":
            return given.with_drive(acceleration=tuple((rng.uniform(1.5, 2.5) * np.array([1.0, 0.7, 0.8, 1.0])).tolist())), every
        case "deadband":
            return given.with_drive(deadband=only(0.02, 0.0)), [JOINTS[one]]
        case "feedforward":
            return given.with_drive(lead=tuple((rng.uniform(0.6, 1.0) * kv).tolist())), every
        case "integral":
            return given.with_drive(ki=tuple((rng.uniform(0.7, 3.0) * kp).tolist())), every
        case "limit":
            peak = log_of(replace(case, sensor="noise"), given, 0, 8.0)[2]
            return given.with_drive(limit=only(0.8 * float(peak[one]), np.inf)), [JOINTS[one]]
        case _:
            return given, []
