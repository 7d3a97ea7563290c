"""The chain: inertias joined in series by geared spring-dampers, its places and its linear parameters. Knows no effects."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mjsim.errors import nearest
from mjsim.quantity import Motion, Quantity
from mjsim.servo import Servo, Target
from mjsim.site import Side, Site

__all__ = ["Body", "Chain", "Coupling", "Limit", "LinearParameter", "Softness"]


@dataclass(frozen=True)
class Softness:
    """How MuJoCo softens the dry friction of a joint, from its solreffriction and solimpfriction.

    The friction force is f = clip(d (F + b J v), -level, level); F: all other forces on the body, J: its inertia, v: its speed.
    Below the level the body moves by v' = (1 - d) F / J - d b v instead of sticking. ``impedance`` d in (0, 1), ``rate`` b [1/s].
    Source: MuJoCo documentation, Computation, Constraint model: (A + R) f = a_ref - a_0 with R = A (1 - d) / d, a_ref = -b v.
    """

    impedance: float
    rate: float


@dataclass(frozen=True)
class Limit:
    """The range of a joint as MuJoCo limits it softly, by solreflimit and solimplimit.

    Beyond a limit by r > 0 the joint is pushed back by f = max(0, m (a_ref - a)), where all are taken away from the limit: a its
    acceleration with f, a_ref = K d r - B v, m = J d / (1 - d). ``lower``, ``upper`` [rad | m]; ``stiffness`` K [1/s^2];
    ``damping`` B [1/s]; ``impedance``: solimp (5), from which d(r) follows. Source: MuJoCo documentation, Computation, Solver
    parameters.
    """

    lower: float
    upper: float
    stiffness: float
    damping: float
    impedance: tuple[float, float, float, float, float] = (0.9, 0.95, 0.001, 0.5, 2.0)

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ValueError(f"range of a joint is {self.lower} .. {self.upper}; expected lower < upper")


@dataclass(frozen=True)
class Body:
    """An inertia [kg m^2 | kg] with viscous friction to ground [N m s/rad | N s/m]; ``joint`` is its MJCF element.

    ``softness``: of its Coulomb friction, None where that holds the body at rest; ``limit``: of the driven body's angle.
    """

    place: str
    inertia: float
    viscous: float
    joint: str
    softness: Softness | None = None
    limit: Limit | None = None


@dataclass(frozen=True)
class Coupling:
    """A spring-damper between body j and body j+1, on the side of body j+1: torque k d + damping d', d = ratio q_j - q_{j+1}."""

    place: str
    ratio: float
    stiffness: float
    damping: float
    joint: str


@dataclass(frozen=True)
class LinearParameter:
    """A parameter of the linear structure: name (Jm, fm, kg ...), where it stands, its value and quantity."""

    name: str
    kind: str
    index: int
    value: float
    quantity: Quantity


@dataclass(frozen=True)
class Chain:
    """A single-axis chain: N bodies, N-1 couplings; torque acts on body 0, which is also the measured one.

    ``gain`` is the actuator's gear: generalised torque on body 0 per unit of input, or of the force of a servo. Viscous friction
    is free at body 0 and wherever the model carries some. ``servo``: the law of a drive whose input is a command. ``held``: names
    of parameters (of effects as ``id@place.name``) that are known, or that a recording cannot tell from the others: they are not
    free. ``driven``: False where there is no actuator, or it was off: the torque is zero. ``idle``: inputs of the drive beside
    its command, which are zero.
    """

    bodies: tuple[Body, ...]
    couplings: tuple[Coupling, ...]
    motion: Motion = Motion.HINGE
    gain: float = 1.0
    actuator: str = "motor_torque"
    velocity_sensor: str = "motor_velocity"
    angle_sensor: str = "motor_angle"
    servo: Servo | None = None
    held: tuple[str, ...] = ()
    driven: bool = True
    idle: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.bodies or len(self.couplings) != len(self.bodies) - 1:
            raise ValueError(f"a chain of {len(self.bodies)} bodies needs {len(self.bodies) - 1} couplings")
        for body in self.bodies:
            if not body.inertia > 0:
                raise ValueError(f"inertia of {body.joint!r} is {body.inertia}; expected > 0")

    def body(self, place: str) -> int | None:
        """Index of the body at a place (``motor`` first, ``arm`` last, ``gearbox`` in between), or None when there is none."""
        n = len(self.bodies)
        return {"motor": 0, "arm": n - 1, "gearbox": 1 if n >= 3 else None}.get(place)

    def coupling(self, place: str) -> int | None:
        """Index of the coupling at a place: ``gearbox`` the first, ``arm`` the last of two or more."""
        n = len(self.couplings)
        return {"gearbox": 0 if n >= 1 else None, "arm": n - 1 if n >= 2 else None}.get(place)

    def element(self, place: str, *, coupling: bool = False) -> str:
        """MJCF element that stands for a place."""
        if place == "actuator":
            return self.actuator
        if place == "sensor":
            return self.velocity_sensor
        j = self.coupling(place) if coupling else None
        if j is not None:
            return self.couplings[j].joint
        i = self.body(place)
        return self.bodies[i if i is not None else 0].joint

    def sites(self) -> tuple[Site, ...]:
        """Every site of the chain: its bodies from the motor on, its couplings, its actuator and its sensor."""
        bodies = (Site(b.joint, Side.LINK if i else Side.MOTOR) for i, b in enumerate(self.bodies))
        couplings = (Site(c.joint, Side.COUPLING) for c in self.couplings)
        driven = self.bodies[0].joint
        return (*bodies, *couplings, Site(driven, Side.ACTUATOR), Site(driven, Side.SENSOR))

    def site(self, place: str, *, coupling: bool = False) -> Site | None:
        """Site of a place, of its coupling or of its body; None when this chain has no such place."""
        if place in ("actuator", "sensor"):
            return Site(self.bodies[0].joint, Side(place))
        if coupling:
            j = self.coupling(place)
            return None if j is None else Site(self.couplings[j].joint, Side.COUPLING)
        i = self.body(place)
        return None if i is None else Site(self.bodies[i].joint, Side.LINK if i else Side.MOTOR)

    def place(self, site: Site) -> str:
        """Place string of a site. Raises KeyError, naming the sites that there are, when it is none of this chain."""
        if site not in self.sites():
            raise KeyError(f"no site {str(site)!r}; choose from {', '.join(map(str, self.sites()))}")
        if site.side in (Side.ACTUATOR, Side.SENSOR):
            return str(site.side.value)
        parts: tuple[Body, ...] | tuple[Coupling, ...] = self.couplings if site.side is Side.COUPLING else self.bodies
        return next(part.place for part in parts if part.joint == site.joint)

    def total_ratio(self, body: int) -> float:
        """Angle of a body per angle of body 0 when nothing deflects."""
        ratio = 1.0
        for coupling in self.couplings[:body]:
            ratio *= coupling.ratio
        return ratio

    def linear_parameters(self) -> tuple[LinearParameter, ...]:
        """The free numbers of the linear structure: J, f (where the model has one), k, d, and those of a servo."""
        return self._linear

    @cached_property
    def _linear(self) -> tuple[LinearParameter, ...]:
        suffix = _suffixes([b.place for b in self.bodies])
        csuffix = _suffixes([c.place for c in self.couplings])
        out = [
            LinearParameter(f"J{s}", "inertia", i, b.inertia, Quantity.INERTIA)
            for i, (b, s) in enumerate(zip(self.bodies, suffix, strict=True))
        ]
        out += [
            LinearParameter(f"f{s}", "viscous", i, b.viscous, Quantity.DAMPING)
            for i, (b, s) in enumerate(zip(self.bodies, suffix, strict=True))
            if i == 0 or b.viscous != 0
        ]
        out += [
            LinearParameter(f"k{s}", "stiffness", i, c.stiffness, Quantity.STIFFNESS)
            for i, (c, s) in enumerate(zip(self.couplings, csuffix, strict=True))
        ]
        out += [
            LinearParameter(f"d{s}", "damping", i, c.damping, Quantity.DAMPING)
            for i, (c, s) in enumerate(zip(self.couplings, csuffix, strict=True))
        ]
        out += self._of_servo()
        return tuple(p for p in out if p.name not in self.held)

    def _of_servo(self) -> list[LinearParameter]:
        """Gains, force limit and zero of the servo."""
        servo = self.servo
        if servo is None:
            return []
        speed = servo.target is Target.VELOCITY
        numbers = [
            ("kp", "stiffness of the servo", servo.kp, Quantity.STIFFNESS),
            ("gain", "gain of the servo", servo.gain, Quantity.TORQUE_PER_COMMAND),
            ("kv", "gain of the servo" if speed else "damping of the servo", servo.kv, Quantity.DAMPING),
            ("limit", "limit of the servo", servo.limit, Quantity.TORQUE),
            ("zero", "zero of the servo", servo.zero, Quantity.VELOCITY if speed else Quantity.ANGLE),
        ]
        there = {"kp": not speed, "gain": servo.back_emf, "limit": math.isfinite(servo.limit)}
        return [LinearParameter(name, kind, 0, value, q) for name, kind, value, q in numbers if there.get(name, True)]

    @cached_property
    def _linear_by_name(self) -> dict[str, LinearParameter]:
        return {p.name: p for p in self._linear}

    def with_linear(self, values: Mapping[str, float]) -> Chain:
        """A copy with some linear parameters replaced, by name."""
        known = self._linear_by_name
        bodies: dict[int, dict[str, Any]] = {}
        couplings: dict[int, dict[str, Any]] = {}
        servo: dict[str, Any] = {}
        for name, value in values.items():
            if name not in known:
                raise KeyError(
                    f"unknown linear parameter {name!r}; choose from {', '.join(known)}; {nearest(name, known, 'name one')}"
                )
            p = known[name]
            if p.kind.endswith("servo"):
                servo[name] = float(value)
                continue
            changed = bodies if p.kind in ("inertia", "viscous") else couplings
            changed.setdefault(p.index, {})[p.kind] = float(value)
        return dataclasses.replace(
            self,
            bodies=tuple(dataclasses.replace(b, **bodies[i]) if i in bodies else b for i, b in enumerate(self.bodies)),
            couplings=tuple(
                dataclasses.replace(c, **couplings[i]) if i in couplings else c for i, c in enumerate(self.couplings)
            ),
            servo=self.servo.with_numbers(servo) if self.servo is not None and servo else self.servo,
        )


def _suffixes(places: list[str]) -> list[str]:
    """First letters when they are unique, else underscore and whole names."""
    letters = [p[0] for p in places]
    return letters if len(set(letters)) == len(letters) else [f"_{p}" for p in places]
