"""A concealed servo robot: forward dynamics of `lab.robot.arm` under position servos, with laws of its own, compiled.

The joint-space inertia and the bias torque come from a Newton-Euler recursion of its own (columns for unit accelerations; M.
W. Walker,
D. E. Orin, J. Dyn. Syst. Meas. Control 104 (1982) 205). A step is semi-implicit: gains, damping and dry friction act on the
velocity at its
end, friction by projected Gauss-Seidel sweeps over the joints. It shares no code with `mjsim`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from lab.robot.arm import GRAVITY, Arm

__all__ = ["ServoJoint", "ServoRobot", "command_for", "servo_mjcf", "simulate", "write_servo_log"]

HOSE = 1.2  # [1/rad]
Vector = tuple[float, float, float]
STEP = 5e-4  # [s]: the numerical damping of a step is kp h / 2, a thousandth of a servo's own


@dataclass(frozen=True)
class ServoJoint:
    """True servo and friction of one joint, at the joint.

    kp [N m/rad], kv [N m s/rad]; friction [N m]; load: friction per torque of the links; extra [N m] and speed [rad/s]:
    Stribeck; dead_band
    [rad]; slew [rad/s]; delay [s]; stall [N m], no_load [rad/s]: limit of torque and speed; ripple [N m], order [1/rad]:
    torque over the angle; offset [N m]; sublinear, exponent: friction sublinear |v|^exponent; cable [N m]: a hose that
    stiffens to one side, which opposes with cable (exp(`HOSE` q) - 1); source: index of a joint of which the part couple of the
    servo's torque acts here, and drag [N m] opposes its motion; spring [N m/rad], rest [rad]: a spring that takes weight;
    integral [N m/(rad s)]: gain on the integral of the servo's error, which is zero when the first command begins to act.
    """

    kp: float
    kv: float
    friction: float = 0.0
    load: float = 0.0
    extra: float = 0.0
    speed: float = 1.0
    dead_band: float = 0.0
    slew: float = 0.0
    delay: float = 0.0
    stall: float = 0.0
    no_load: float = 1.0
    ripple: float = 0.0
    order: float = 0.0
    offset: float = 0.0
    sublinear: float = 0.0
    exponent: float = 1.0
    cable: float = 0.0
    source: int = 0
    couple: float = 0.0
    drag: float = 0.0
    spring: float = 0.0
    rest: float = 0.0
    integral: float = 0.0


@dataclass(frozen=True)
class ServoRobot:
    """An arm and the servos of its joints."""

    arm: Arm
    servos: tuple[ServoJoint, ...]

    def with_servo(self, joint: int, **changes: Any) -> ServoRobot:
        """A copy with another servo at a joint."""
        servos = list(self.servos)
        servos[joint] = dataclasses.replace(servos[joint], **changes)
        return ServoRobot(self.arm, tuple(servos))


def servo_mjcf(robot: ServoRobot, name: str = "arm") -> str:
    """The arm as MJCF with position servos of these gains; nothing else of the servos is told."""
    text = robot.arm.mjcf(name)
    for i, s in enumerate(robot.servos):
        motor = f'<motor name="motor{i + 1}" joint="joint{i + 1}"/>'
        text = text.replace(motor, f'<position name="servo{i + 1}" joint="joint{i + 1}" kp="{s.kp:.9g}" kv="{s.kv:.9g}"/>')
    return text


def command_for(
    robot: ServoRobot, rng: np.random.Generator, t: np.ndarray, base: float = 0.05, harmonics: int = 10, share: float = 0.5
) -> np.ndarray:
    """Commands (N, n) [rad]: Fourier series within a share of the limits of position and speed."""
    w = 2 * np.pi * base * np.arange(1, harmonics + 1)
    out = np.empty((len(t), len(robot.servos)))
    for i, link in enumerate(robot.arm.links):
        s, c = (rng.standard_normal(harmonics) / np.arange(1, harmonics + 1) for _ in range(2))
        q = np.sin(np.outer(t, w)) @ s + np.cos(np.outer(t, w)) @ c
        q -= 0.5 * (np.max(q) + np.min(q))
        rate = np.max(np.abs(np.gradient(q, t)))
        out[:, i] = q * min(share * link.limit / np.max(np.abs(q)), link.speed / rate)
    return out


def simulate(robot: ServoRobot, command: np.ndarray, dt: float, settle: float = 1.0) -> np.ndarray:
    """Positions (N, n) [rad] at the samples, after the first command was held for ``settle`` [s]; commands are held over each
    sample."""
    links = robot.arm.links
    arm = tuple(
        np.array([getattr(x, name) for x in links], float)
        for name in ("place", "axis", "mass", "centre", "inertia", "rotor", "viscous")
    )
    servos = np.array([dataclasses.astuple(s) for s in robot.servos], float)
    before = round(settle / dt)
    lead = np.vstack([np.repeat(command[:1], before, axis=0), command])
    run: Any = _run
    return np.asarray(run(*arm, servos, lead, dt, max(1, round(dt / STEP)))[before:])


@njit(cache=True)
def _row(x: np.ndarray, i: int) -> Vector:
    return x[i, 0], x[i, 1], x[i, 2]


@njit(cache=True)
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(cache=True)
def _times(a: Vector, x: float) -> Vector:
    return a[0] * x, a[1] * x, a[2] * x


@njit(cache=True)
def _each(a: Vector, b: Vector) -> Vector:
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@njit(cache=True)
def _turned(axis: Vector, c: float, s: float, x: Vector) -> Vector:
    """A vector turned about a unit axis by the angle whose cosine and sine are c and s (Rodrigues)."""
    dot = axis[0] * x[0] + axis[1] * x[1] + axis[2] * x[2]
    turned: Vector = _sum(_sum(_times(x, c), _times(_cross(axis, x), s)), _times(axis, dot * (1 - c)))
    return turned


@njit(cache=True)
def _torque(
    place: np.ndarray, axis: np.ndarray, mass: np.ndarray, centre: np.ndarray, inertia: np.ndarray, q: np.ndarray, v: np.ndarray,
    a: np.ndarray, gravity: float, F: np.ndarray, N: np.ndarray, out: np.ndarray
) -> None:  # fmt: skip
    """Torque out (n,) of a motion: recursion outwards for accelerations, inwards for forces (Craig, Introduction to Robotics,
    ch. 6). F, N (n, 3) are to work with."""
    n = len(q)
    w, dw, acc = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, gravity)
    for i in range(n):
        about, at, middle, turns, c, s = (
            _row(axis, i),
            _row(place, i),
            _row(centre, i),
            _row(inertia, i),
            np.cos(q[i]),
            -np.sin(q[i]),
        )
        acc = _turned(about, c, s, _sum(_sum(acc, _cross(dw, at)), _cross(w, _cross(w, at))))
        w, dw = _turned(about, c, s, w), _turned(about, c, s, dw)
        own = _times(about, v[i])
        dw = _sum(_sum(dw, _cross(w, own)), _times(about, a[i]))
        w = _sum(w, own)
        F[i] = _times(_sum(_sum(acc, _cross(dw, middle)), _cross(w, _cross(w, middle))), mass[i])
        N[i] = _sum(_each(turns, dw), _cross(w, _each(turns, w)))
    f, m = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(n - 1, -1, -1):
        if i + 1 < n:
            about, c, s = _row(axis, i + 1), np.cos(q[i + 1]), np.sin(q[i + 1])
            f = _turned(about, c, s, f)
            m = _sum(_turned(about, c, s, m), _cross(_row(place, i + 1), f))
        force = _row(F, i)
        f = _sum(f, force)
        m = _sum(_sum(m, _row(N, i)), _cross(_row(centre, i), force))
        out[i] = m[0] * axis[i, 0] + m[1] * axis[i, 1] + m[2] * axis[i, 2]


@njit(cache=True)
def _run(
    place: np.ndarray, axis: np.ndarray, mass: np.ndarray, centre: np.ndarray, inertia: np.ndarray, rotor: np.ndarray,
    viscous: np.ndarray, servos: np.ndarray, lead: np.ndarray, dt: float, each: int
) -> np.ndarray:  # fmt: skip
    count, n = lead.shape
    h = dt / each
    q, v, target = lead[0].copy(), np.zeros(n), lead[0].copy()
    acceleration, summed = np.zeros(n), np.zeros(n)
    out, zero = np.empty((count, n)), np.zeros(n)
    M, A, p, level = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(n)
    F, N, bias, column, unit = np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty(n), np.zeros(n)
    for k in range(count):
        out[k] = q
        for i in range(each):
            _torque(place, axis, mass, centre, inertia, q, v, zero, GRAVITY, F, N, bias)
            for j in range(n):
                unit[j] = 1.0
                _torque(place, axis, mass, centre, inertia, q, zero, unit, 0.0, F, N, column)
                unit[j] = 0.0
                M[:, j] = column
                M[j, j] += rotor[j]
            impulse = M @ v
            links = bias + M @ acceleration - rotor * acceleration  # torque that the links need
            for j in range(n):
                kp, kv, friction, load, extra, speed, band, slew, delay, stall, no_load, ripple, order, offset = servos[j, :14]
                sublinear, exponent, cable = servos[j, 14:17]
                source, couple, drag = int(servos[j, 17]), servos[j, 18], servos[j, 19]
                goal = lead[max(int(np.floor(k + (i + 0.5) / each - delay / dt)), 0), j]
                if slew > 0:
                    target[j] += min(max(goal - target[j], -slew * h), slew * h)
                else:
                    target[j] = goal
                e = target[j] - q[j]
                active = 1.0 if abs(e) > band else 0.0
                constant = kp * (e - min(max(e, -band), band)) + servos[j, 22] * (summed[j] + 0.5 * h * e)
                stiff, damp = kp * active, kv
                if stall > 0:
                    slope = stall / no_load
                    drive = constant - kv * v[j]
                    if drive > stall - slope * v[j]:
                        constant, stiff, damp = stall, 0.0, slope
                    elif drive < -stall - slope * v[j]:
                        constant, stiff, damp = -stall, 0.0, slope
                # trapezoidal in the servo: half of its stiffness and damping at either end of the step
                p[j] = impulse[j] + h * (constant - bias[j] + offset - ripple * np.sin(order * q[j]))
                p[j] -= h * (cable * (np.exp(HOSE * q[j]) - 1.0) + servos[j, 20] * (q[j] - servos[j, 21]))
                if couple != 0.0 or drag != 0.0:
                    other = servos[source, 0] * (target[source] - q[source]) - servos[source, 1] * v[source]
                    p[j] += h * (couple * other - drag * np.sign(v[source]))
                p[j] -= 0.5 * h * (damp + viscous[j]) * v[j]
                A[j] = M[j]
                A[j, j] += 0.5 * h * (damp + viscous[j]) + 0.5 * h * h * (stiff + servos[j, 20])
                level[j] = friction + load * abs(links[j]) + extra * np.exp(-((v[j] / speed) ** 2))
                level[j] += sublinear * np.abs(v[j]) ** exponent
            new = v.copy()
            for _ in range(60):
                change = 0.0
                for j in range(n):
                    rest = p[j] + A[j, j] * new[j]
                    for m in range(n):
                        rest -= A[j, m] * new[m]
                    value = np.sign(rest) * max(abs(rest) - h * level[j], 0.0) / A[j, j]
                    change = max(change, abs(value - new[j]))
                    new[j] = value
                if change < 1e-12:
                    break
            summed += h * (target - q - 0.25 * h * (v + new))
            q = q + 0.5 * h * (v + new)
            acceleration = (new - v) / h
            v = new
    return out


def write_servo_log(
    robot: ServoRobot,
    path: Path,
    seed: int,
    seconds: float = 30.0,
    rate: float = 50.0,
    step: float = 2 * np.pi / 16384,
    *,
    base: float = 0.05,
    late: Mapping[int, int] | None = None,
) -> Mapping[str, np.ndarray]:
    """Simulate a program of commands drawn from a seed and write the log: time, commands and positions rounded to the
    encoder's step [rad]; base: lowest frequency of the commands [Hz]; late: samples by which the position
    column of a joint is late.

    Returns the columns by name.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    command = command_for(robot, rng, t, base)
    q = simulate(robot, command, 1 / rate)
    for joint, samples in (late or {}).items():
        q[:, joint] = np.concatenate([np.full(samples, q[0, joint]), q[: len(q) - samples, joint]])
    q = step * np.round((q + 0.3 * step * rng.standard_normal(q.shape)) / step)
    columns = {"time_s": t}
    for i in range(len(robot.servos)):
        columns[f"joint{i + 1}.command_rad"], columns[f"joint{i + 1}.angle_rad"] = command[:, i], q[:, i]
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return columns
