"""The cases of a seed: an even design over machines, solver settings, integrators, sampling rates, loops and what is lacking.

Cases come in blocks of twelve, in each of which every level of a factor occurs as often as `FACTORS` lists it. Of `TRIES` random
arrangements of a block the one is taken with the smallest sum of squares of all two-way counts so far: pairs of levels are even
as well, in any number of whole blocks. Of the kinds that a machine and a loop allow in a group, one of those used least is drawn.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass

import numpy as np

__all__ = ["BLOCK", "FACTORS", "KINDS", "Case", "draw", "kinds"]

BLOCK, TRIES = 12, 400
FACTORS: dict[str, tuple[object, ...]] = {
    "machine": ("pendulum", "geared", "slide", "two_mass") * 3,
    "solver": ("default", "stiff") * 6,
    "integrator": ("Euler", "implicitfast", "RK4") * 4,
    "rate": (100.0, 250.0, 1000.0, 2000.0) * 3,
    "loop": ("open", "pd", "servo") * 4,
    "group": ("nothing",) * 4 + ("number",) * 2 + ("effect",) * 5 + ("outside",),
}
TIMESTEPS = (0.0005, 0.001, 0.002)

_ANY = ("pendulum", "geared", "slide", "two_mass")
_RIGID, _WEIGHT, _TORQUE = ("pendulum", "geared", "slide"), ("pendulum", "geared"), ("open", "pd")
_EVERY = ("open", "pd", "servo")
# kind -> (group, name that is right, machines, loops); the name of a number is its own, and no finding
KINDS: dict[str, tuple[str, str, tuple[str, ...], tuple[str, ...]]] = {
    "nothing": ("nothing", "", _ANY, _EVERY),
    "inertia": ("number", "", _ANY, _EVERY),
    "armature": ("number", "", _ANY, _EVERY),
    "damping": ("number", "", _ANY, _EVERY),
    "dry_friction": ("number", "", _ANY, _EVERY),
    "gain": ("number", "", _ANY, _EVERY),
    "weight": ("number", "", _WEIGHT, _TORQUE),
    "shaft_stiffness": ("number", "", ("two_mass",), _EVERY),
    "joint_friction": ("effect", "coulomb_friction", _ANY, _EVERY),
    "tendon_friction": ("effect", "coulomb_friction", _ANY, _EVERY),
    "drag": ("effect", "quadratic_friction", _ANY, _EVERY),
    "delay": ("effect", "time_delay", _ANY, _EVERY),
    "lag": ("effect", "actuator_lag", _ANY, _EVERY),
    "limit": ("effect", "actuator_saturation", _ANY, _EVERY),
    "offset": ("effect", "torque_offset", _ANY, _TORQUE),
    "tilt": ("effect", "torque_offset", ("slide",), _TORQUE),
    "gravity": ("effect", "gravity_load", _WEIGHT, _EVERY),
    "flexible_joint": ("effect", "extra_flexible_mode", _RIGID, _TORQUE),
    "slack_joint": ("effect", "backlash", ("two_mass",), _TORQUE),
    "hard_shaft": ("effect", "hardening_stiffness", ("two_mass",), _TORQUE),
    "cam": ("effect", "torque_ripple", ("two_mass",), _TORQUE),
    "spring": ("outside", "joint_spring", _ANY, _EVERY),
    "stop": ("outside", "joint_stop", _ANY, _EVERY),
}


@dataclass(frozen=True)
class Case:
    """One case. kind: what the nominal file lacks; timestep [s] and rate [Hz]; seed: of its numbers, inputs and noise."""

    number: int
    machine: str
    solver: str
    integrator: str
    rate: float
    loop: str
    group: str
    kind: str
    timestep: float
    seed: int

    @property
    def right(self) -> tuple[str, ...]:
        """Effects that are to be named."""
        name = KINDS[self.kind][1]
        return (name,) if name else ()


def kinds(group: str, machine: str, loop: str) -> tuple[str, ...]:
    """Kinds of a group that a machine and a loop can have."""
    return tuple(k for k, (g, _, machines, loops) in KINDS.items() if g == group and machine in machines and loop in loops)


def draw(count: int, seed: int) -> list[Case]:
    """The first ``count`` cases of a seed."""
    rng = np.random.default_rng(seed)
    pairs: Counter[tuple[object, ...]] = Counter()
    used: Counter[str] = Counter()
    out: list[Case] = []
    while len(out) < count:
        block = min((_arranged(rng) for _ in range(TRIES)), key=lambda rows: _unevenness(rows, pairs))
        for row in block:
            pairs.update(_pairs(row))
            named = dict(zip(FACTORS, row, strict=True))
            machine, loop, group = (str(named[k]) for k in ("machine", "loop", "group"))
            rate = float(named["rate"])  # type: ignore[arg-type]
            choices = kinds(group, machine, loop)
            least = min(used[k] for k in choices)
            kind = str(rng.choice([k for k in choices if used[k] == least]))
            used[kind] += 1
            timestep = float(rng.choice([h for h in TIMESTEPS if h * rate <= 1.0 + 1e-9]))
            out.append(
                Case(len(out), machine, str(named["solver"]), str(named["integrator"]), rate, loop, group, kind, timestep,
                     int(rng.integers(2**31)))
            )  # fmt: skip
    return out[:count]


def _arranged(rng: np.random.Generator) -> list[tuple[object, ...]]:
    columns = [[levels[i] for i in rng.permutation(BLOCK)] for levels in FACTORS.values()]
    return list(zip(*columns, strict=True))


def _pairs(row: tuple[object, ...]) -> list[tuple[object, ...]]:
    return [(i, j, row[i], row[j]) for i, j in itertools.combinations(range(len(row)), 2)]


def _unevenness(rows: list[tuple[object, ...]], before: Counter[tuple[object, ...]]) -> int:
    """Growth of the sum of squares of all two-way counts."""
    new: Counter[tuple[object, ...]] = Counter()
    for row in rows:
        new.update(_pairs(row))
    return sum(n * n + 2 * n * before[p] for p, n in new.items())
