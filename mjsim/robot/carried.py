"""Effects that a robot's file carries in ``<custom>``, as slots of the joint kernel, and what they do at one instant of a
MuJoCo run.

Each law acts through what MuJoCo has: the level of the joint's ``frictionloss``, a torque at the joint, the target of the
servo and the force
range of its actuator. Friction that differs between the directions is its mean and a constant torque.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mjsim.compiled import compiled
from mjsim.quantity import Motion
from mjsim.robot.joint_kernel import SLOT, body_torque, coupled, empty, friction_level
from mjsim.robot.model import Robot

__all__ = ["AT_SERVO", "act", "effect_of_slots", "effect_slots", "needed_parameters", "slots_by_joint"]

LIMIT, LAG, DEAD, SLEW, STALL, NO_LOAD, ASYMMETRY, QUADRATIC, BRISTLE, SPRING, FROM, LEAD = (
    SLOT[x]
    for x in (
        "limit", "lag", "dead_band", "slew", "stall", "no_load", "asymmetry", "quadratic", "bristle", "spring", "couple_from",
        "lead",
    )
)  # fmt: skip
_SIMPLE: dict[str, dict[str, str]] = {
    "coulomb_friction": {"friction": "torque_Nm"},
    "asymmetric_friction": {"friction": "torque_Nm", "asymmetry": "asymmetry_Nm"},
    "stribeck_friction": {"friction": "torque_Nm", "extra": "extra_static_torque_Nm", "stribeck": "stribeck_velocity_rad_s"},
    "sublinear_viscous_friction": {"sublinear": "coefficient", "exponent": "exponent"},
    "quadratic_friction": {"quadratic": "coefficient_Nm_s2_rad2"},
    "friction_drift": {"friction": "torque_Nm", "drift": "relative_change", "drift_time": "time_constant_s"},
    "time_delay": {"delay": "delay_s"},
    "actuator_lag": {"lag": "time_constant_s"},
    "actuator_saturation": {"limit": "limit_Nm"},
    "servo_deadband": {"dead_band": "half_width_rad"},
    "velocity_limit": {"slew": "limit_rad_s"},
    "acceleration_limit": {"acceleration": "limit_rad_s2"},
    "velocity_feedforward": {"lead": "gain_Nms_rad"},
    "torque_speed_limit": {"stall": "stall_torque_Nm", "no_load": "no_load_speed_rad_s"},
}

# of the others: parameters that are needed, and those that may be left out
_OTHERS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "coupled_transmission": ((), ("ratio", "torque_Nm", "viscous")),
    "load_dependent_friction": (("coefficient",), ("coefficient_backdriven",)),
    "presliding_friction": (("torque_Nm", "stiffness_Nm_rad"), ()),
    "torque_offset": (("torque_Nm",), ()),
    "gravity_compensation_spring": (("stiffness_Nm_rad",), ("torque_Nm",)),
    "cable_torque": (("low_rad", "high_rad", *(f"coefficient_{k}" for k in (1, 2, 3, 4))), ("coefficient_0",)),
    "torque_ripple": (("amplitude_Nm", "cycles_per_rev", "phase_rad"), ()),
    "position_dependent_friction": (("torque_Nm", "relative_amplitude", "cycles_per_rev", "phase_rad"), ()),
    "gravity_load": (("torque_Nm", "phase_rad"), ()),
}
AT_SERVO = frozenset(
    (
        "time_delay",
        "actuator_lag",
        "actuator_saturation",
        "servo_deadband",
        "velocity_limit",
        "acceleration_limit",
        "velocity_feedforward",
        "torque_speed_limit",
    )
)  # of the input: a joint that a torque drives is held to its recording by a loop beside it


def needed_parameters() -> dict[str, tuple[frozenset[str], frozenset[str]]]:
    """Parameters of each effect that a run takes, by its identifier: those needed, and those that may be left out."""
    simple = {id_: (frozenset(names.values()), frozenset[str]()) for id_, names in _SIMPLE.items()}
    return simple | {id_: (frozenset(a), frozenset(b)) for id_, (a, b) in _OTHERS.items()}


def effect_slots(effect: Mapping[str, Any], robot: Robot) -> dict[str, float] | None:
    """Slot values of a carried effect; None for one that acts on the recorded torque."""
    id_, given = effect["effect"], effect["parameters"]
    if id_ == "coupled_transmission":
        source = {"couple_from": 1.0 + robot.joints.index(effect["from"])}
        names = (("couple_torque", "ratio"), ("couple_sign", "torque_Nm"), ("couple_speed", "viscous"))
        return source | {slot: float(given[name]) for slot, name in names if name in given}
    if id_ == "time_delay" and effect.get("place") == "sensor":
        return {"late": float(given["delay_s"])}
    if id_ in _SIMPLE:
        return {slot: float(given[name]) for slot, name in _SIMPLE[id_].items()}
    j = robot.joints.index(effect["joint"])
    unit = abs(float(robot.gear[j])) if robot.motions[j] is Motion.HINGE else 1.0
    if id_ == "load_dependent_friction":
        c = float(given["coefficient"])
        return {"load": c, "load_back": float(given.get("coefficient_backdriven", c))}
    if id_ == "presliding_friction":
        return {"friction": float(given["torque_Nm"]), "bristle": float(given["torque_Nm"]) / float(given["stiffness_Nm_rad"])}
    if id_ == "torque_offset":
        return {"preload": -float(given["torque_Nm"])}
    if id_ == "gravity_compensation_spring":
        return {"spring": float(given["stiffness_Nm_rad"]), "preload": float(given.get("torque_Nm", 0.0))}
    if id_ == "cable_torque":
        return _cable(given)
    if id_ in ("torque_ripple", "position_dependent_friction", "gravity_load"):
        return _periodic(id_, given, unit)
    return None


def effect_of_slots(joint: str, place: str, slots: Mapping[str, float]) -> dict[str, Any]:
    """The carried effect, as JSON values, whose numbers are these slots and no others."""
    id_, names = next((id_, names) for id_, names in _SIMPLE.items() if set(names) == set(slots))
    parameters = {names[slot]: float(value) for slot, value in slots.items()}
    return {"effect": id_, "form": "", "joint": joint, "place": place, "parameters": parameters}


def _periodic(id_: str, given: Mapping[str, float], unit: float) -> dict[str, float]:
    """Amplitude and phase as a sine and a cosine."""
    phase, order = float(given["phase_rad"]), float(given.get("cycles_per_rev", 0.0)) * unit
    s, c = math.cos(phase), math.sin(phase)
    if id_ == "gravity_load":
        return {"weight_sin": given["torque_Nm"] * s, "weight_cos": given["torque_Nm"] * c}
    if id_ == "torque_ripple":
        return {"ripple_sin": given["amplitude_Nm"] * s, "ripple_cos": given["amplitude_Nm"] * c, "order": order}
    a = given["relative_amplitude"]
    return {"friction": given["torque_Nm"], "rub_sin": a * s, "rub_cos": a * c, "rub_order": order}


def _cable(given: Mapping[str, float]) -> dict[str, float] | None:
    """Chebyshev coefficients over a range: the linear one is a spring about its middle."""
    if "low_rad" not in given:
        return None
    low, high = float(given["low_rad"]), float(given["high_rad"])
    stiff = 2.0 * given["coefficient_1"] / (high - low)
    out = {f"cable_{k}": float(given[f"coefficient_{k}"]) for k in (2, 3, 4)}
    preload = float(given.get("coefficient_0", 0.0)) - 0.5 * stiff * (low + high)
    return {**out, "cable_low": low, "cable_high": high, "spring": stiff, "preload": preload}


def slots_by_joint(effects: Sequence[Mapping[str, Any]], robot: Robot) -> tuple[np.ndarray, tuple[str, ...]]:
    """Slots (m, K) of all joints, and in words the effects that cannot be run."""
    out, lacking = np.array([empty() for _ in robot.joints]), []
    for effect in effects:
        slots = effect_slots(effect, robot)
        if slots is None:
            lacking.append(f"{effect['effect']} at {effect['joint']}")
            continue
        own = out[robot.joints.index(effect["joint"])]
        for name, value in slots.items():
            own[SLOT[name]] = value + (own[SLOT[name]] if name in ("spring", "preload") else 0.0)
    return out, tuple(lacking)


@compiled(error_model="numpy")
def act(
    p: np.ndarray, native: np.ndarray, zero: np.ndarray, target: np.ndarray, rate: np.ndarray, q: np.ndarray, v: np.ndarray,
    load: np.ndarray, drive: np.ndarray, t: float, h: float, state: np.ndarray, out: np.ndarray
) -> None:  # fmt: skip
    """What carried laws do at one instant.

    p (m, K): slots of carried laws; native (m,): frictionloss of the file; zero (m,): of the servos; target, rate (m,): of the
    servos, after their delay, and its speed; q, v, load, drive (m,): motion, torque
    of the links and of the drives; t [s]; h: step [s]; state (m, 4): lagged target, slewed target, bristle, and whether it has
    begun; out
    (m, 5): dry friction, torque, target, least and largest force at the joint.
    """
    for j in range(len(q)):
        c = p[j]
        r, speed = target[j], rate[j]
        if state[j, 3] == 0.0:
            state[j, 0], state[j, 1], state[j, 3] = r, r, 1.0
        if c[LAG] > 0.0:  # lag
            way = (r - state[j, 0]) * (1.0 - math.exp(-h / c[LAG]))
            state[j, 0] += way
            r, speed = state[j, 0], way / h
        if c[SLEW] > 0.0:  # slew
            way = min(max(r - state[j, 1], -c[SLEW] * h), c[SLEW] * h)
            state[j, 1] += way
            r, speed = state[j, 1], way / h
        if c[DEAD] > 0.0:  # dead band
            r -= min(max(r - zero[j] - q[j], -c[DEAD]), c[DEAD])
        up, down = friction_level(c, q[j], v[j], load[j], t)
        up, down = up + c[ASYMMETRY], down - c[ASYMMETRY]
        level, offset = 0.5 * (up + down), 0.5 * (up - down)
        torque = -body_torque(c, q[j]) - c[SPRING] * q[j] - c[QUADRATIC] * v[j] * abs(v[j]) - offset
        torque += c[LEAD] * speed
        if c[FROM] > 0.0:  # another joint
            k = int(c[FROM]) - 1
            torque -= coupled(c, drive[k], np.sign(v[k]), v[k])
        if c[BRISTLE] > 0.0:  # bristle: exact along the way of one step
            way = v[j] * h
            s = 1.0 if way > 0.0 else -1.0
            state[j, 2] = s + (state[j, 2] - s) * math.exp(-abs(way) / c[BRISTLE])
            torque -= level * state[j, 2]
            level = 0.0
        high, low = c[LIMIT], -c[LIMIT]
        if c[STALL] > 0.0:  # back-EMF
            slope = c[STALL] / c[NO_LOAD]
            high, low = min(high, c[STALL] - slope * v[j]), max(low, -c[STALL] - slope * v[j])
        out[j, 0], out[j, 1], out[j, 2], out[j, 3], out[j, 4] = native[j] + level, torque, r, low, high
