"""The cases of a seed: what the file lacks, in a fixed order, and levels of every other factor drawn evenly."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

__all__ = ["ARM", "JOINTS", "SINGLE", "Case", "draw"]

# kind -> the sets of effects any of which is right; one empty set: physics is not to be named
SINGLE: dict[str, tuple[frozenset[str], ...]] = {
    kind: tuple(frozenset(names.split("+")) - {""} for names in right)
    for kind, right in {
        "nothing": ("",),
        "gains": ("",),
        "load": ("",),
        "dry_friction": ("coulomb_friction",),
        "profile": ("acceleration_limit", "acceleration_limit+velocity_limit"),
        "latency": ("time_delay",),
        "load_friction": ("load_dependent_friction", "coulomb_friction+load_dependent_friction"),
        "spring": ("joint_spring",),
        "deadband": ("servo_deadband",),
        "torque_speed": ("torque_speed_limit",),
        "stribeck": ("stribeck_friction", "static_friction"),
        "feedforward": ("velocity_feedforward",),
        "integral": ("integral_action",),
        "lag": ("actuator_lag",),
        "slew": ("velocity_limit",),
        "limit": ("actuator_saturation",),
        "drag": ("quadratic_friction",),
        "backlash": ("backlash",),
        "elastic": ("extra_flexible_mode",),
        "stop": ("joint_stop",),
        "asymmetric": ("asymmetric_friction",),
        "friction_and_latency": ("coulomb_friction+time_delay",),
        "friction_and_spring": ("coulomb_friction+joint_spring",),
        "friction_and_feedforward": ("coulomb_friction+velocity_feedforward",),
    }.items()
}
# the same for arms; at which joints stands in the case's truth
ARM: dict[str, tuple[str, ...]] = {
    "nothing": (),
    "gains": (),
    "payload": (),
    "friction": ("coulomb_friction",),
    "latency": ("time_delay",),
    "profile": ("acceleration_limit",),
    "deadband": ("servo_deadband",),
    "feedforward": ("velocity_feedforward",),
    "compensation": (),
    "integral": ("integral_action",),
    "limit": ("actuator_saturation",),
    "friction_and_payload": ("coulomb_friction",),
}
JOINTS = ("yaw", "shoulder", "elbow", "wrist")


@dataclass(frozen=True)
class Case:
    """One case. machine: pendulum, turntable, slide or arm; rate [Hz]; motion: sines, steps, ramps; sensor: encoder, noise;
    way: how the drive takes the command between samples (held, interpolated); kind: what the file lacks."""

    number: int
    machine: str
    kind: str
    rate: float
    motion: str
    sensor: str
    way: str
    seed: int


def draw(count: int, seed: int, arms: bool) -> list[Case]:
    """The first ``count`` cases of a seed, of single joints or of arms; the kinds come in turn."""
    rng = np.random.default_rng([seed, int(arms)])
    kinds = list(ARM if arms else SINGLE)
    machines = ("arm",) if arms else ("pendulum", "turntable", "slide")
    rates = (50.0, 100.0) if arms else (50.0, 100.0, 200.0, 500.0)
    motions = ("sines", "ramps") if arms else ("sines", "steps", "ramps")
    levels = list(itertools.product(machines, rates, motions, ("encoder", "noise"), ("held", "interpolated")))
    out: list[Case] = []
    order: list[int] = []
    for number in range(count):
        order = order or list(rng.permutation(len(levels)))
        machine, rate, motion, sensor, way = levels[order.pop()]
        kind = kinds[number % len(kinds)]
        if machine != "pendulum" and kind == "load_friction":
            machine = "pendulum"  # friction in proportion to the load shows where the load varies
        out.append(Case(number, machine, kind, rate, motion, sensor, way, int(rng.integers(2**31))))
    return out
