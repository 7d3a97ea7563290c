"""Free numbers of the state in which a recording starts; each recording has its own, and they belong to no effect.

In motion, the speed of body 0 is free, and of every further body its deflection and its rate against the one before,

    q_{j+1} = r_j q_j - d_j,    v_{j+1} = r_j v_j - d_j',    d_j ~ N(0, (s / w_j)^2),    d_j' ~ N(0, s^2),

with s the rms speed of body j + 1 and w_j the frequency of what is behind the spring, body j held: a hidden mode carries no more
energy than the motion itself. The prior holds what the samples do not determine, as behind a stiff spring. Where a torque depends
on the angle, or a servo acts, the start angle is free as well, by the noise of the first measured angle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mjsim.axis import Axis, Chain
from mjsim.effects import Effect, NotApplicableError, Scales
from mjsim.effects.ports import SplitInertia
from mjsim.quantity import Quantity
from mjsim.system import restoring, split_chain

__all__ = ["ANGLE", "VELOCITY", "Begin", "Free", "free_numbers", "holds_an_angle", "initial", "is_of_start", "slots"]

VELOCITY, ANGLE = "initial_velocity", "initial_angle"


@dataclass(frozen=True)
class Begin:
    """How a recording starts: in motion or at rest, at which measured speed [rad/s | m/s].

    angle: noise rms of the first measured angle [rad | m], 0 where that is taken as it is.
    """

    moving: bool
    speed: float = 0.0
    angle: float = 0.0


@dataclass(frozen=True)
class Free:
    """A free number of a start: its name, quantity, the deviation of its prior [SI], 0 where it has none, and a guess [SI]."""

    name: str
    quantity: Quantity
    deviation: float
    value: float = 0.0


def _names(coupling: int) -> tuple[str, str]:
    return f"initial_deflection{coupling + 1}", f"initial_deflection_rate{coupling + 1}"


def is_of_start(owner: str, name: str) -> bool:
    """Whether a number of a hypothesis is one of a start."""
    return owner == "" and name.startswith("initial_")


def slots(chain: Chain) -> dict[str, int]:
    """Places of the priors of a recording's start, the same for all structures on a nominal chain: an effect may add one body."""
    names = [ANGLE, *(name for j in range(len(chain.bodies)) for name in _names(j))]
    return {name: k for k, name in enumerate(names)}


def holds_an_angle(axis: Axis) -> bool:
    """Whether a servo acts, or a torque that depends on the angle (gravity, a spring)."""
    if axis.chain.servo is not None:
        return True
    for effect in axis.effects:
        try:
            # a torque whose slope vanishes at three angles [rad | m] does not depend on the angle
            if any(restoring(Axis(axis.chain, (effect,)), about).any() for about in (0.0, 0.5, 1.0)):
                return True
        except (NotApplicableError, ValueError):  # it has no place on this chain, and cannot be run
            continue
    return False


def free_numbers(nominal: Axis, effects: Sequence[Effect], scales: Mapping[str, Scales], begin: Begin) -> Iterator[Free]:
    """Free numbers of a start of a nominal axis with other effects."""
    if begin.angle > 0.0 and holds_an_angle(Axis(nominal.chain, tuple(effects), nominal.backlash_law)):
        yield Free(ANGLE, Quantity.ANGLE, begin.angle)
    if not begin.moving:
        return
    yield Free(VELOCITY, Quantity.VELOCITY, 0.0, begin.speed)
    chain = _extended(nominal.chain, effects)
    for j, coupling in enumerate(chain.couplings):
        ratio = abs(chain.total_ratio(j + 1))
        behind = sum(b.inertia * (chain.total_ratio(i) / ratio) ** 2 for i, b in enumerate(chain.bodies) if i > j)
        rate = ratio * scales["motor"].velocity
        deflection, speed = _names(j)
        if coupling.stiffness > 0.0:
            yield Free(deflection, Quantity.ANGLE, rate * math.sqrt(behind / coupling.stiffness))
        yield Free(speed, Quantity.VELOCITY, rate)


def _extended(chain: Chain, effects: Sequence[Effect]) -> Chain:
    """The chain with the bodies that effects split off."""
    for effect in effects:
        try:
            for port in effect.ports(chain):
                if isinstance(port, SplitInertia):
                    chain = split_chain(chain, port)
        except (NotApplicableError, ValueError):  # it has no place on this chain, and cannot be run
            continue
    return chain


def initial(chain: Chain, values: Mapping[str, float]) -> np.ndarray | None:
    """Angles and velocities (2, n) at the start, relative to the first measured angle; None where nothing of them is free."""
    if not values:
        return None
    extra = _names(len(chain.couplings))
    ratios = [c.ratio for c in chain.couplings] + [1.0] * any(name in values for name in extra)
    out = np.zeros((2, len(ratios) + 1))
    out[:, 0] = values.get(ANGLE, 0.0), values.get(VELOCITY, 0.0)
    for j, ratio in enumerate(ratios):
        out[:, j + 1] = ratio * out[:, j] - [values.get(name, 0.0) for name in _names(j)]
    return out
