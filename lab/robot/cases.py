"""Concealed robots: cases drawn from a seed, and their logs by the plant of `lab.robot.arm` with laws of its own.

Motion is a band-limited Fourier series within the joints' limits (J. Swevers et al., IEEE Trans. Robotics and Automation 13
(1997) 730), the best of
a few for the condition of the inertial regressor. The log is what a robot's controller gives: angles of an encoder and the
torque of
the drives, both with noise, at 250 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lab.robot.arm import Arm, six_axes, three_axes

__all__ = ["KINDS", "Case", "draw", "motion", "trajectory", "write_log"]

RATE, SECONDS = 250.0, 10.0
ENCODER = 2e-5  # rms of the angle's noise [rad]
TORQUE_NOISE = 0.004  # of a joint's rms torque
KINDS = ("nothing", "parameters", "single", "pair", "compensation", "steady_load", "cable", "flexible")
STEADY, POSE = 0.05, 0.6  # share of the motion, and pose of every joint [rad], about which the load hardly varies
HOSE = 1.2  # [1/rad]


@dataclass(frozen=True)
class Law:
    """One concealed law at a joint: identifier, values, and the torque (N,) that it adds to what the drive must give."""

    id: str
    joint: int
    values: dict[str, float]
    torque: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray] = field(compare=False, repr=False)


@dataclass(frozen=True)
class Case:
    """One concealed robot: the nominal arm, the true one, and its laws; parameters: what of its numbers was changed, in words.

    stiffness: of flexible joints [N m/rad], by index; their angle is that of the motor, behind the gear.
    """

    kind: str
    seed: int
    nominal: Arm
    true: Arm
    laws: tuple[Law, ...]
    parameters: tuple[str, ...]
    stiffness: Mapping[int, float] = field(default_factory=dict)


def trajectory(
    arm: Arm, rng: np.random.Generator, t: np.ndarray, base: float = 0.1, harmonics: int = 12, tries: int = 6
) -> tuple[np.ndarray, ...]:
    """Position, velocity, acceleration (N, n) of a Fourier series within the limits, the best conditioned of a few."""
    best: tuple[float, tuple[np.ndarray, ...]] | None = None
    w = 2 * math.pi * base * np.arange(1, harmonics + 1)
    sine, cosine = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    for _ in range(tries):
        q, v, a = (np.empty((len(t), len(arm.links))) for _ in range(3))
        for i, link in enumerate(arm.links):
            s, c = (rng.standard_normal(harmonics) / np.sqrt(np.arange(1, harmonics + 1)) for _ in range(2))
            v[:, i] = cosine @ s + sine @ c
            q[:, i] = sine @ (s / w) - cosine @ (c / w)
            a[:, i] = -sine @ (s * w) + cosine @ (c * w)
            shift = 0.5 * (np.max(q[:, i]) + np.min(q[:, i]))
            size = min(link.speed / np.max(np.abs(v[:, i])), 0.8 * link.limit / (0.5 * np.ptp(q[:, i])))
            q[:, i], v[:, i], a[:, i] = size * (q[:, i] - shift), size * v[:, i], size * a[:, i]
        few = slice(None, None, max(1, len(t) // 150))
        score = _condition(arm, q[few], v[few], a[few])
        if best is None or score < best[0]:
            best = score, (q, v, a)
    assert best is not None
    return best[1]


def _condition(arm: Arm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> float:
    """Condition number of the torque's sensitivities to the masses, the centres and the rotors, each by its own size."""
    reference = arm.torque(q, v, a)
    columns = []
    for i, link in enumerate(arm.links):
        columns.append((arm.with_link(i, mass=1.1 * link.mass).torque(q, v, a) - reference).ravel())
        for k in range(3):
            moved = tuple(c + 0.02 * (k == m) for m, c in enumerate(link.centre))
            columns.append((arm.with_link(i, centre=moved).torque(q, v, a) - reference).ravel())
    s = np.linalg.svd(np.column_stack([c for c in columns if np.linalg.norm(c) > 1e-9]), compute_uv=False)
    s = s[s > 1e-6 * s[0]]
    return float(s[0] / s[-1]) / len(s)


def _laws(rng: np.random.Generator, joint: int, rms: tuple[float, ...], only: str = "") -> Law:
    """A law at a joint; rms: of its torque, of its load and of its speed. Of 6 to 25 % of the joint's rms torque."""
    ids = ("coulomb_friction", "stribeck_friction", "load_dependent_friction", "torque_offset", "torque_ripple",
           "quadratic_friction", "gravity_compensation_spring", "asymmetric_friction")  # fmt: skip
    id_ = only or str(rng.choice(ids))
    torque, load, speed = rms
    size = torque * float(rng.uniform(0.06, 0.25))
    if id_ == "coulomb_friction":
        return Law(id_, joint, {"torque_Nm": size}, lambda q, v, T, t: size * _sign(v))
    if id_ == "stribeck_friction":
        extra, vs = size * float(rng.uniform(0.4, 1.0)), speed * float(rng.uniform(0.08, 0.3))
        values = {"torque_Nm": size, "extra_static_torque_Nm": extra, "stribeck_velocity_rad_s": vs}
        return Law(id_, joint, values, lambda q, v, T, t: (size + extra * np.exp(-((v / vs) ** 2))) * _sign(v))
    if id_ == "load_dependent_friction":
        share = size / max(load, 1e-9)
        return Law(id_, joint, {"coefficient": share}, lambda q, v, T, t: share * np.abs(T) * _sign(v))
    if id_ == "torque_offset":
        sign = float(rng.choice([-1.0, 1.0]))
        return Law(id_, joint, {"torque_Nm": sign * size}, lambda q, v, T, t: np.full(len(q), -sign * size))
    if id_ == "torque_ripple":
        order, phase = float(rng.integers(6, 13)), float(rng.uniform(-3, 3))
        return Law(
            id_, joint, {"amplitude_Nm": size, "cycles_per_rev": order}, lambda q, v, T, t: size * np.sin(order * q + phase)
        )
    if id_ == "quadratic_friction":
        c = size / speed**2
        return Law(id_, joint, {"coefficient_Nm_s2_rad2": c}, lambda q, v, T, t: c * v * np.abs(v))
    if id_ == "gravity_compensation_spring":
        k, zero = 2 * size, float(rng.uniform(-0.5, 0.5))
        return Law(id_, joint, {"stiffness_Nm_rad": k}, lambda q, v, T, t: k * (q - zero))
    if id_ == "cable_torque":
        return Law(id_, joint, {}, lambda q, v, T, t: size * (np.exp(HOSE * q) - 1.0))
    more = size * float(rng.uniform(0.2, 0.5))
    return Law("asymmetric_friction", joint, {"torque_Nm": size, "asymmetry_Nm": more}, lambda q, v, T, t: size * _sign(v) + more)


def _sign(v: np.ndarray) -> np.ndarray:
    return np.asarray(np.sign(v))


def draw(seed: int, kind: str, axes: int) -> Case:
    """A case. The true arm is never quite the nominal one: rotors and dampings are off by some per cent, but in "nothing".

    compensation: a spring at joint2 that takes part of its weight; steady_load: friction that grows with the load at a joint that
    bears weight, in a log in which that load hardly varies; cable: a hose that stiffens to one side, at a random joint.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind), axes])
    nominal = three_axes() if axes == 3 else six_axes()
    true, changed = nominal, []
    if kind != "nothing":
        for i, link in enumerate(nominal.links):
            true = true.with_link(i, rotor=link.rotor * rng.uniform(0.9, 1.1), viscous=link.viscous * rng.uniform(0.8, 1.2))
    if kind == "parameters":
        what = str(rng.choice(["payload", "mass", "armature"]))
        if what == "payload":
            mass, last = float(rng.uniform(0.3, 1.5)), nominal.links[-1]
            reach = float(rng.uniform(0.05, 0.12))
            at = (reach, last.centre[1], last.centre[2]) if axes == 3 else (reach, 0.005, 0.0)
            true = true.with_payload(mass, at)
            changed.append(f"payload {mass:.2f} kg")
        else:
            i = int(rng.integers(1, axes))
            link, factor = nominal.links[i], float(rng.choice([0.75, 1.3]))
            if what == "mass":
                true = true.with_link(i, mass=factor * link.mass, inertia=tuple(factor * x for x in link.inertia))
            else:
                true = true.with_link(i, rotor=2 * factor * link.rotor)
            changed.append(f"{what} of {link.name} x {factor if what == 'mass' else 2 * factor:.2f}")
    laws: list[Law] = []
    count = {"single": 1, "pair": 2}.get(kind, 0)
    if count:
        t = np.arange(0, SECONDS, 0.02)
        q, v, a = trajectory(nominal, np.random.default_rng([seed, 7]), t)
        load = nominal.torque(q, v, a)
        total = load + [link.rotor for link in nominal.links] * a + [link.viscous for link in nominal.links] * v
        for joint in rng.choice(axes, count, replace=False):
            j = int(joint)
            rms = tuple(float(np.sqrt(np.mean(x[:, j] ** 2))) for x in (total, load, v))
            law = _laws(rng, j, rms)
            # a joint that bears no load has no load-dependent friction to speak of
            laws.append(_laws(rng, j, rms, only="coulomb_friction") if law.values.get("coefficient", 0.0) > 0.5 else law)
    if kind in ALONE:
        laws.append(_alone(kind, rng, nominal, seed))
    stiffness = _flexible(rng, nominal) if kind == "flexible" else {}
    return Case(kind, seed, nominal, true, tuple(laws), tuple(changed), stiffness)


def _flexible(rng: np.random.Generator, arm: Arm) -> dict[int, float]:
    """Stiffness of one of the first three joints, at which its links swing with 5 to 12 Hz where all others are still."""
    j, n = int(rng.integers(3)), len(arm.links)
    still, unit = np.full((1, n), 0.3), np.zeros((1, n))
    unit[0, j] = 1.0
    inertia = float((arm.torque(still, 0 * still, unit) - arm.torque(still, 0 * still, 0 * still))[0, j])
    return {j: inertia * (2 * math.pi * float(rng.uniform(5.0, 12.0))) ** 2}


ALONE = {"compensation": "gravity_compensation_spring", "steady_load": "load_dependent_friction", "cable": "cable_torque"}


def _alone(kind: str, rng: np.random.Generator, arm: Arm, seed: int) -> Law:
    """The law of a kind that has one: at joint2, which bears weight, or a cable at any joint."""
    t = np.arange(0, SECONDS, 0.02)
    q, v, a = motion(kind, arm, np.random.default_rng([seed, 7]), t)
    load = arm.torque(q, v, a)
    j = int(rng.integers(len(arm.links))) if kind == "cable" else 1
    rms = tuple(float(np.sqrt(np.mean(x[:, j] ** 2))) for x in (load, load, v))
    if kind == "compensation":  # a quarter to the whole of the load, at half a radian
        rms = (4.0 * rms[0], *rms[1:])
    return _laws(rng, j, rms, only=ALONE[kind])


def motion(kind: str, arm: Arm, rng: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Position, velocity, acceleration (N, n) of a case: an exciting trajectory, or a small one about a pose (steady_load)."""
    q, v, a = trajectory(arm, rng, t)
    return (POSE + STEADY * q, STEADY * v, STEADY * a) if kind == "steady_load" else (q, v, a)


FINER = 10  # samples of the grid on which derivatives of a flexible joint's torque are taken, for one of the log


def write_log(case: Case, path: Path, index: int) -> None:
    """Write log ``index`` of a case as CSV: time, and of each joint angle and torque."""
    rng = np.random.default_rng([case.seed, KINDS.index(case.kind), len(case.nominal.links), 100 + index])
    every = FINER if case.stiffness else 1
    dt = 1 / (RATE * every)
    t = np.arange(0, SECONDS, dt)
    q, v, a = motion(case.kind, case.nominal, rng, t)
    load = case.true.torque(q, v, a)
    for j, k in case.stiffness.items():  # the motor is ahead of its link by the torque that the link needs
        ahead = load[:, j] / k
        rate = np.gradient(ahead, dt)
        q[:, j], v[:, j], a[:, j] = q[:, j] + ahead, v[:, j] + rate, a[:, j] + np.gradient(rate, dt)
    t, q, v, a, load = (x[::every] for x in (t, q, v, a, load))
    torque = load + [link.rotor for link in case.true.links] * a + [link.viscous for link in case.true.links] * v
    for law in case.laws:
        torque[:, law.joint] += law.torque(q[:, law.joint], v[:, law.joint], load[:, law.joint], t)
    torque = torque + TORQUE_NOISE * np.sqrt(np.mean(torque**2, axis=0)) * rng.standard_normal(torque.shape)
    q = q + ENCODER * rng.standard_normal(q.shape)
    names = [f"joint{i + 1}" for i in range(q.shape[1])]
    header = ",".join(["time_s", *(f"{n}.angle_rad" for n in names), *(f"{n}.torque_Nm" for n in names)])
    np.savetxt(path, np.column_stack([t, q, torque]), delimiter=",", header=header, comments="", fmt="%.9g")
    path.with_suffix(".toml").write_text(
        '[recording]\nhold = "linear"  # the torque is measured beside the angle\n', encoding="utf-8"
    )
