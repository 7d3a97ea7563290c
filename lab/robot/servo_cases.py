"""Concealed servo robots: cases drawn from a seed, written as a nominal MJCF and two logs of commands and positions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lab.robot.arm import six_axes, three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, write_servo_log

__all__ = ["EFFECTS", "KINDS", "LATE", "ServoCase", "draw_servo", "write_servo_case"]

RATE, SECONDS, BASE = 100.0, 10.0, 0.1
STEP = 2 * np.pi / 16384  # of the encoder [rad]
LATE = "late_position"  # the name of a delay of the log, which a diagnosis calls a time_delay of the sensor
KINDS = ("nothing", "parameters", "single", "pair", "skew", "coupled", "compensation", "integral")
EFFECTS = (
    "coulomb_friction", "stribeck_friction", "load_dependent_friction", "torque_ripple", "servo_deadband", "velocity_limit",
    "time_delay", "sublinear_viscous_friction", "cable_torque",
)  # fmt: skip
GAINS = {3: ((60, 6), (90, 8), (50, 4)), 6: ((120, 12), (200, 18), (120, 10), (40, 2.5), (40, 2.5), (20, 1.2))}
BORNE = 0.2  # of a joint's rms torque: a joint whose links need less has no load-dependent friction to speak of


@dataclass(frozen=True)
class ServoCase:
    """One concealed servo robot: nominal and true robot, effects with their true values by (effect, joint), changed numbers in
    words; late: samples by which the position of a joint is late."""

    kind: str
    seed: int
    nominal: ServoRobot
    true: ServoRobot
    effects: Mapping[tuple[str, str], Mapping[str, float]]
    parameters: tuple[str, ...]
    late: Mapping[int, int]

    @property
    def truth(self) -> Mapping[tuple[str, str], Mapping[str, float]]:
        """Effects and late positions (`LATE`) with their values by (name, joint)."""
        return dict(self.effects) | {(LATE, f"joint{j + 1}"): {"delay_s": n / RATE} for j, n in self.late.items()}

    @property
    def expected(self) -> set[tuple[str, str]]:
        """The right names, with their joints."""
        return set(self.truth)


def nominal_robot(axes: int) -> ServoRobot:
    """The arm of three or six joints with its servos."""
    return ServoRobot(three_axes() if axes == 3 else six_axes(), tuple(ServoJoint(float(p), float(v)) for p, v in GAINS[axes]))


def _sizes(robot: ServoRobot, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """rms of the torque of the drive and of the links, and largest speed (n,) along the commands of a seed."""
    t = np.arange(0, SECONDS, 0.02)
    q = command_for(robot, np.random.default_rng(seed), t, BASE)
    v = np.gradient(q, t, axis=0)
    load = robot.arm.torque(q, v, np.gradient(v, t, axis=0))
    total = load + [x.viscous for x in robot.arm.links] * v
    return np.sqrt(np.mean(total**2, axis=0)), np.sqrt(np.mean(load**2, axis=0)), np.max(np.abs(v), axis=0)


def draw_effect(
    rng: np.random.Generator, id_: str, torque: float, load: float, speed: float
) -> tuple[dict[str, float], dict[str, float]]:
    """(changes of a `ServoJoint`, contract parameters) of an effect of 6 to 25 % of the joint's rms torque."""
    size = torque * float(rng.uniform(0.06, 0.25))
    u = float(rng.uniform())
    if id_ == "stribeck_friction":
        extra, knee = size * (0.5 + 0.5 * u), speed * float(rng.uniform(0.04, 0.15))
        return {"friction": size, "extra": extra, "speed": knee}, {
            "torque_Nm": size, "extra_static_torque_Nm": extra, "stribeck_velocity_rad_s": knee,
        }  # fmt: skip
    if id_ == "load_dependent_friction":
        return {"load": size / load}, {"coefficient": size / load}
    if id_ == "torque_ripple":
        order = float(rng.integers(6, 13))
        return {"ripple": size, "order": order}, {"amplitude_Nm": size, "cycles_per_rev": order}
    if id_ == "servo_deadband":
        return {"dead_band": 0.01 + 0.03 * u}, {"half_width_rad": 0.01 + 0.03 * u}
    if id_ == "velocity_limit":
        return {"slew": speed * (0.4 + 0.3 * u)}, {"limit_rad_s": speed * (0.4 + 0.3 * u)}
    if id_ == "time_delay":
        return {"delay": 0.02 + 0.06 * u}, {"delay_s": 0.02 + 0.06 * u}
    if id_ == "sublinear_viscous_friction":
        exponent = 0.35 + 0.3 * u
        c = 2 * size / (0.4 * speed) ** exponent
        return {"sublinear": c, "exponent": exponent}, {"coefficient": c, "exponent": exponent}
    if id_ == "cable_torque":
        return {"cable": size}, {}
    return {"friction": size}, {"torque_Nm": size}


def _numbers(rng: np.random.Generator, true: ServoRobot, axes: int) -> tuple[ServoRobot, str]:
    """A robot with one number changed by far more than the small errors, and the change in words."""
    what, j = str(rng.choice(["payload", "mass", "kp", "armature"])), int(rng.integers(1, axes))
    arm, link = true.arm, true.arm.links[j]
    if what == "payload":
        mass = float(rng.uniform(0.3, 1.2))
        return ServoRobot(arm.with_payload(mass, arm.links[-1].centre), true.servos), f"payload {mass:.2f} kg"
    factor = float(rng.choice([0.7, 1.35]))
    if what == "kp":
        return true.with_servo(j, kp=factor * true.servos[j].kp), f"kp of joint{j + 1} x {factor:.2f}"
    if what == "mass":
        changed = arm.with_link(j, mass=factor * link.mass, inertia=tuple(factor * x for x in link.inertia))
        return ServoRobot(changed, true.servos), f"mass of {link.name} x {factor:.2f}"
    return ServoRobot(arm.with_link(j, rotor=3 * link.rotor), true.servos), f"armature of joint{j + 1} x 3"


def draw_servo(seed: int, kind: str, axes: int, effect: str = "") -> ServoCase:
    """A case. But in "nothing", gains, rotors and dampings are off by some per cent. ``effect``: instead of one that is drawn."""
    rng = np.random.default_rng([seed, KINDS.index(kind), axes])
    nominal = nominal_robot(axes)
    true, words, late = nominal, [], {}
    if kind != "nothing":
        for j, (link, s) in enumerate(zip(nominal.arm.links, nominal.servos, strict=True)):
            arm = true.arm.with_link(j, rotor=link.rotor * rng.uniform(0.9, 1.1), viscous=link.viscous * rng.uniform(0.8, 1.2))
            true = dataclasses.replace(true, arm=arm).with_servo(j, kp=s.kp * rng.uniform(0.95, 1.05))
    if kind == "parameters":
        true, told = _numbers(rng, true, axes)
        words.append(told)
    if kind == "skew":
        j, samples = int(rng.integers(axes)), int(rng.integers(3, 9))
        late = {j: samples}
        words.append(f"position of joint{j + 1} late by {samples} samples")
    effects: dict[tuple[str, str], Mapping[str, float]] = {}
    torque, load, speed = _sizes(nominal, seed)
    for joint in rng.choice(axes, {"single": 1, "pair": 2}.get(kind, 0), replace=False):
        j = int(joint)
        borne = [e for e in EFFECTS if e != "load_dependent_friction" or load[j] > BORNE * torque[j]]
        id_ = effect or str(rng.choice(borne))
        changes, values = draw_effect(rng, id_, float(torque[j]), float(load[j]), float(speed[j]))
        true = true.with_servo(j, **changes)
        effects[id_, f"joint{j + 1}"] = values
    if kind == "coupled":
        j, other = (int(x) for x in rng.choice(axes, 2, replace=False))
        ratio = float(torque[j] / torque[other] * rng.uniform(0.06, 0.25))
        true = true.with_servo(j, source=other, couple=ratio)
        effects["coupled_transmission", f"joint{j + 1}"] = {"ratio": ratio}
        words.append(f"from joint{other + 1}")
    if kind == "compensation":  # of a quarter to the whole of the weight, at half a radian
        stiff, rest = 2.0 * float(load[1] * rng.uniform(0.25, 1.0)), float(rng.uniform(-0.5, 0.5))
        true = true.with_servo(1, spring=stiff, rest=rest)
        effects["gravity_compensation_spring", "joint2"] = {"stiffness_Nm_rad": stiff}
    if kind == "integral":
        j = int(rng.integers(axes))
        gain = true.servos[j].kp * float(np.exp(rng.uniform(np.log(1 / 3), np.log(5.0))))
        true = true.with_servo(j, integral=gain)
        effects["integral_action", f"joint{j + 1}"] = {"gain_Nm_rad_s": gain}
    return ServoCase(kind, seed, nominal, true, effects, tuple(words), late)


def write_servo_case(case: ServoCase, folder: Path) -> None:
    """Write arm.xml, a.csv and b.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(servo_mjcf(case.nominal), encoding="utf-8")
    for k, name in enumerate(("a.csv", "b.csv")):
        write_servo_log(case.true, folder / name, 10 * case.seed + k, SECONDS, RATE, STEP, base=BASE, late=case.late)
