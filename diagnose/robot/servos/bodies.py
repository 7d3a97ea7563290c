"""Numbers that all servo joints carry together: masses and first moments of the links, gravity compensation, a payload."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjsim.robot.inertia import SIZE, point_mass, pseudo_inertia
from mjsim.robot.model import Robot

__all__ = [
    "GRAVITY", "MASS", "MOMENTS", "PAYLOAD", "BodyNumber", "body_numbers", "changes", "gravcomp_of", "is_physical",
    "unit_payload",
]  # fmt: skip

PAYLOAD = "payload"
MASS = "mass"
MOMENTS = ("mx", "my", "mz")
GRAVITY = "gravity_compensation"
MOST = 1.5  # of the weight that a controller may carry: by the masses of its own model
LEAST = 1e-6  # of the arm's mass: a link with less is a frame and no body


@dataclass(frozen=True, eq=False)
class BodyNumber:
    """One inertial number of a link that may differ from the file's, or the gravity compensation of all.

    kind: `MASS` [kg], in one proportion with first moment and inertia; `MOMENTS` [kg m], a component of the first moment in the
    frame of the link, mass and inertia about the origin kept; `PAYLOAD` [kg], a point at the centre of mass; `GRAVITY`, the part
    of the links' weight that the drives carry beside their servos, which changes no inertia. nominal: value of the file, zero
    of a payload; scale: size of a large change; change (10,): what one unit adds to the link's parameters.
    """

    link: int
    body: str
    kind: str
    nominal: float
    scale: float
    change: np.ndarray

    @property
    def key(self) -> str:
        """Name in a diagnosis."""
        return self.kind if self.kind == GRAVITY else f"{self.body}.{self.kind}"

    @property
    def unit(self) -> str:
        """Unit of its value."""
        return "1" if self.kind == GRAVITY else "kg m" if self.kind in MOMENTS else "kg"

    @property
    def words(self) -> str:
        """Name in a sentence."""
        if self.kind == GRAVITY:
            return "gravity compensation, the part of the links' weight that the drives carry beside their servos"
        if self.kind == PAYLOAD:
            return f"payload on {self.body}"
        return f"{'mass' if self.kind == MASS else f'first moment {self.kind}'} of {self.body}"


def unit_payload(robot: Robot) -> np.ndarray:
    """Inertial parameters (10,) of a mass of 1 kg at the centre of mass of the last link, in its frame."""
    last = robot.nominal[-1]
    return point_mass(1.0, last[1:4] / last[0])


def body_numbers(robot: Robot) -> tuple[BodyNumber, ...]:
    """Mass and first moment of each link that has a mass, gravity compensation, then the payload on the last link."""
    least = LEAST * float(np.sum(robot.nominal[:, 0]))
    out = []
    for k, (name, phi) in enumerate(zip(robot.link_names, robot.nominal, strict=True)):
        if phi[0] > least:
            out.append(BodyNumber(k, name, MASS, float(phi[0]), float(phi[0]), phi / phi[0]))
            size = math.sqrt(float(phi[0]) * 0.5 * float(np.sum(phi[4:7])))  # mass times its distance to the origin
            out += [BodyNumber(k, name, m, float(phi[1 + i]), size, np.eye(SIZE)[1 + i]) for i, m in enumerate(MOMENTS)]
    given = gravcomp_of(robot)
    out.append(BodyNumber(0, "", GRAVITY, 0.0 if given is None else given, 1.0, np.zeros(SIZE)))
    last = len(robot.links) - 1
    mass = float(robot.nominal[-1, 0])
    return (*out, BodyNumber(last, robot.link_names[last], PAYLOAD, 0.0, mass, unit_payload(robot)))


def gravcomp_of(robot: Robot) -> float | None:
    """The gravity compensation of the file where it is the same for all links with a mass, else None."""
    values = {float(robot.model.body_gravcomp[b]) for b in robot.links if robot.model.body_mass[b] > 0.0}
    return values.pop() if len(values) == 1 else None


def changes(robot: Robot, numbers: tuple[BodyNumber, ...]) -> np.ndarray:
    """Changes (C, L, 10) of the links' inertial parameters by one unit of each number."""
    out = np.zeros((len(numbers), len(robot.links), SIZE))
    for k, n in enumerate(numbers):
        out[k, n.link] = n.change
    return out


def is_physical(robot: Robot, numbers: tuple[BodyNumber, ...], x: np.ndarray) -> bool:
    """Whether all links with the numbers x (C,) more, without what is fixed to them, remain bodies of positive density, and the
    gravity compensation lies between none and `MOST`."""
    if not all(0.0 <= n.nominal + more <= MOST for n, more in zip(numbers, x, strict=True) if n.kind == GRAVITY and more != 0.0):
        return False
    links = robot.nominal - robot.fixed
    changed = links + np.einsum("clk,c->lk", changes(robot, numbers), x)
    touched = np.any(changed != links, axis=1)
    return bool(all(np.linalg.eigvalsh(pseudo_inertia(phi))[0] > 0.0 for phi in changed[touched]))
