"""An axis laid out as arrays for the compiled kernel: what the ports of its effects add up to."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from mjsim.axis import Axis, Body, Chain, Coupling
from mjsim.chain import Limit
from mjsim.effects import ports as P  # noqa: N812
from mjsim.effects.law import ANGLE, RATE, STATE
from mjsim.law_probes import constant, follows_rate, levels, slope, yields
from mjsim.servo import Target

__all__ = ["LIMIT", "MOST_STEPS", "SLIDES", "STEP", "TURNS", "UNROLLED", "System", "assemble", "restoring", "split_chain"]

STEP = 0.12  # angle [rad] by which the fastest motion of a model with events may turn in a step
SLIDES = 4.0  # times a bristle settles within a step, past which it only slides: the spring that it is at rest is not there
TURNS = 2.0  # times the change of a velocity in a step, below which the velocity may pass zero in it
UNROLLED = 3  # bodies up to which each length has code of its own; longer chains share one (docs/decisions/kernel.md)
MOST_STEPS = 64  # of the accuracy rule in a sample

_Element = P.Twist | P.CouplingTorque | P.BodyTorque | P.BodyInertia | P.Friction
_KIND = {P.Twist: 0, P.CouplingTorque: 1, P.BodyTorque: 2, P.BodyInertia: 3, P.Friction: 4}
_SOFT, LIMIT = 5, 6


@dataclass(frozen=True)
class System:
    """Arrays for `mjsim.kernel` and the signal path around it (see there for shapes).

    gain: torque on body 0 per unit of input. servo (6), torques on body 0: stiffness and damping of the drive towards its input,
    force limit, stall torque, loss of that per speed, half width of the dead band; a drive by torque has (0, 0, limit, ...).
    omega, sliding: fastest motion of the chain, and without bristles and creep [rad/s]; yields: deflection at which a bristle
    slides; creeps: speed at which soft friction does, of no other torque.
    """

    chain: Chain
    f: np.ndarray
    gap_law: int
    elements: np.ndarray
    parameters: np.ndarray
    has_friction: np.ndarray
    n_states: int
    input_maps: tuple[P.InputMap, ...]
    slew: float
    acceleration: float
    lead: float
    input_lag: float
    input_delay: float
    output_maps: tuple[P.OutputMap, ...]
    output_lag: float
    output_delay: float
    omega: float
    sliding: float
    yields: float
    creeps: float
    spatial: float
    affine: bool
    gain: float
    servo: np.ndarray

    @property
    def n(self) -> int:
        """Number of bodies."""
        return len(self.chain.bodies)

    @property
    def soft(self) -> bool:
        """Whether any friction is soft."""
        return bool((self.elements[:, 0] == _SOFT).any())

    @property
    def bodies(self) -> tuple[int, ...] | np.ndarray:
        """Zeros (n,) that stand for the bodies in `mjsim.kernel`; up to `UNROLLED` a tuple, whose length is compiled in."""
        return (0,) * self.n if self.n <= UNROLLED else np.zeros(self.n, np.int64)

    @property
    def limit(self) -> Limit | None:
        """The limits of body 0, None where there are none."""
        if not len(self.elements) or self.elements[-1, 0] != LIMIT:
            return None
        low, high, stiffness, damping, *impedance = self.parameters[self.elements[-1, 3] :][:9].tolist()
        return Limit(low, high, stiffness, damping, tuple(impedance))

    def tied(self) -> System:
        """The same with all laws over the angle tied to a recorded one, gravity and springs too: nearly linear in its numbers."""
        elements = self.elements.copy()
        elements[:, 5] = 0
        return dataclasses.replace(self, elements=elements)

    def initial(self, given: np.ndarray | None) -> np.ndarray:
        """Angles and velocities (2, n) at the start, zero where None is given; bodies that an effect added start undeflected."""
        x = np.zeros((2, self.n))
        if given is not None:
            first = np.asarray(given, float)[:, : self.n]
            x[:, : first.shape[1]] = first
            for i in range(first.shape[1], self.n):
                x[:, i] = self.f[2, i - 1] * x[:, i - 1]
        return x

    def substeps(self, dt: float, max_speed: float, target: float = STEP) -> int:
        """RK4 steps per sample that keep (h w) under ``target`` for the chain, three times that for position-locked laws."""
        eventful = self.has_friction.any() or self.f[5].any() or np.isfinite(self.servo[2:4]).any() or self.servo[5]
        if self.affine and not eventful:
            target = 1.0  # no events: a step is exact, and its series converges to rounding up to here
        w = max(self.omega, self.spatial * max_speed / 3.0)
        if self.input_lag > 0:
            w = max(w, (1.0 if self.affine else 0.15) / self.input_lag)
        return max(1, min(MOST_STEPS, math.ceil(dt * w / target - 1e-9)))

    def steps(self, dt: float, max_speed: float, target: float = STEP) -> tuple[int, int]:
        """Steps per sample while bristles at bodies and soft friction slide, and into how many parts one is cut elsewhere."""
        most = self.substeps(dt, max_speed, target)
        if self.sliding == self.omega:
            return most, 1
        n = dataclasses.replace(self, omega=self.sliding).substeps(dt, max_speed, target)
        return n, math.ceil(most / n)

    def mean_steps(self, dt: float, velocity: np.ndarray) -> float:
        """Steps per sample, in the mean, as far as a measured velocity (N,) of body 0 tells."""
        n, parts = self.steps(dt, float(np.max(np.abs(velocity))) if self.spatial else 0.0)
        if parts == 1:
            return float(n)
        h, change = dt / n, np.abs(np.gradient(velocity)) / n
        slow = np.maximum(TURNS * change, max(SLIDES * self.yields / h, self.creeps))
        return n + n * (parts - 1) * float(np.mean(np.abs(velocity) < slow))

    def resolved(self, dt: float) -> System:
        """Itself, where no step of a sample dt [s] resolves its lag with the lag as a delay: the two differ by its square."""
        if not 0.0 < self.input_lag < dt / MOST_STEPS:
            return self
        return dataclasses.replace(self, input_lag=0.0, input_delay=self.input_delay + self.input_lag)


def split_chain(chain: Chain, port: P.SplitInertia) -> Chain:
    """The chain with part of its last body's inertia on a further spring-damper."""
    i = port.body
    if i != len(chain.bodies) - 1:
        raise ValueError("only the last body of a chain can be split")
    body = chain.bodies[i]
    if not 0 < port.inertia < body.inertia:
        raise ValueError(f"inertia to split off is {port.inertia}; expected between 0 and {body.inertia}")
    near = dataclasses.replace(body, inertia=body.inertia - port.inertia)
    far = Body(place="extra", inertia=port.inertia, viscous=0.0, joint=f"{body.joint}_extra")
    joint = Coupling("extra", 1.0, port.stiffness, port.damping, f"{body.joint}_extra")
    return dataclasses.replace(chain, bodies=(*chain.bodies[:-1], near, far), couplings=(*chain.couplings, joint))


def _on_far_body(port: P.Port, body: int, far: int) -> P.Port:
    """A port, moved to the far body where it is the load of a body that was split."""
    if isinstance(port, P.BodyTorque) and port.load and port.body == body:
        return dataclasses.replace(port, body=far)
    return port


def restoring(axis: Axis, about: float = 0.0) -> np.ndarray:
    """Stiffness (n,) [N m/rad | N/m] by which gravity and springs hold each body where body 0 stands at ``about`` [rad | m]."""
    k = np.zeros(len(axis.chain.bodies))
    for effect in axis.effects:
        for port in effect.ports(axis.chain):
            if isinstance(port, P.BodyTorque) and port.body < len(k) and not (port.spatial or port.state or port.timed):
                k[port.body] += slope(port.law, port.p, ANGLE, 1e-3, about * axis.chain.total_ratio(port.body))
    return k


@dataclass
class _Elements:
    """Rows of the kernel's elements as they are gathered, and what they add to the stiffness and damping of the bodies."""

    bodies: tuple[Body, ...]
    rows: list[tuple[int, int, int, int, int, int, int]] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    n_states: int = 0
    spatial: float = 0.0
    yields: float = 0.0
    creeps: float = 0.0

    def __post_init__(self) -> None:
        # stiffness and damping seen by each body, for the choice of step; stiffness of bristles, damping of creep at it apart
        n = len(self.bodies)
        self.stiff, self.damping, self.bristles, self.creep = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.friction = np.zeros(n, np.bool_)

    @property
    def uneven(self) -> bool:
        """Whether soft friction or a limit makes the equations other than affine."""
        return any(kind in (_SOFT, LIMIT) for kind, *_ in self.rows)

    def add(self, port: _Element, ratios: np.ndarray) -> None:
        """Take up a port; ``ratios`` (n,): of the coupling behind each body."""
        site = port.coupling if isinstance(port, P.Twist | P.CouplingTorque) else port.body
        state = -1
        if isinstance(port, P.CouplingTorque | P.BodyTorque) and port.state:
            state = self.n_states
            self.n_states += 1
            self._stiffen(port, site, ratios)
        elif isinstance(port, P.BodyTorque):
            self.damping[site] += max(slope(port.law, port.p, RATE, 1e-6), 0.0)
        if isinstance(port, P.Twist | P.BodyTorque):
            self.spatial = max(self.spatial, port.spatial)
        fixed = None
        if isinstance(port, P.Friction):
            fixed = levels(port)
            if self._soften(site, fixed):
                return
            self.friction[site] = True
        own_angle = isinstance(port, P.BodyTorque) and port.spatial == 0
        driven = isinstance(port, P.BodyTorque) and port.drive
        self.rows.append((_KIND[type(port)], site, 0 if fixed else port.law.address, len(self.values), state, own_angle, driven))
        self.values.extend(fixed or port.p)

    def _soften(self, site: int, fixed: tuple[float, float, float, float] | None) -> bool:
        """Take up friction of constant levels on a body whose friction is soft; False where it is none."""
        body = self.bodies[site]
        if body.softness is None or fixed is None or fixed[:2] != fixed[2:]:
            return False
        soft = body.softness
        rate = soft.impedance * soft.rate * body.inertia
        self.creep[site] += rate
        self.creeps = max(self.creeps, max(fixed[:2]) / rate)
        self.rows.append((_SOFT, site, 0, len(self.values), -1, False, False))
        self.values.extend((soft.impedance, soft.rate, *fixed[:2]))
        return True

    def bound(self, limit: Limit) -> None:
        """Take up the limits of body 0."""
        inertia, most = self.bodies[0].inertia, max(limit.impedance[:2])
        self.stiff[0] += inertia * most**2 * limit.stiffness
        self.damping[0] += inertia * most * limit.damping
        self.rows.append((LIMIT, 0, 0, len(self.values), -1, True, False))
        self.values.extend((limit.lower, limit.upper, limit.stiffness, limit.damping, *limit.impedance))

    def _stiffen(self, port: P.CouplingTorque | P.BodyTorque, site: int, ratios: np.ndarray) -> None:
        """Add the stiffness of a law with a state, before it yields, to the bodies that see it; a state that does not follow the
        motion is none of a bristle.
        """
        if not follows_rate(port.law, port.p):
            return
        k = abs(slope(port.law, port.p, STATE, 1.0))
        if isinstance(port, P.BodyTorque):
            self.bristles[site] += k
            self.yields = max(self.yields, yields(port.law, port.p))
        else:
            self.stiff[site] += k * ratios[site] ** 2
            self.stiff[site + 1] += k


def _numbers_of(chain: Chain) -> np.ndarray:
    """Inertia, viscous friction, ratio, stiffness and damping of each body and the coupling behind it; the gap (6, n)."""
    f = np.zeros((6, len(chain.bodies)))
    for i, body in enumerate(chain.bodies):
        f[0, i], f[1, i] = body.inertia, body.viscous
    for j, c in enumerate(chain.couplings):
        f[2, j], f[3, j], f[4, j] = c.ratio, c.stiffness, c.damping
    return f


def _rank(port: _Element) -> tuple[int, bool]:
    """Order of the elements: by kind, the torques of the drive ahead of the torques that may follow from it."""
    return _KIND[type(port)], not (isinstance(port, P.BodyTorque) and port.drive)


def assemble(axis: Axis) -> System:
    """Gather the ports of all effects of an axis. Raises NotApplicableError when an effect has no place to act at."""
    chain, ports = axis.chain, [port for effect in axis.effects for port in effect.ports(axis.chain)]
    for split in [p for p in ports if isinstance(p, P.SplitInertia)]:
        chain = split_chain(chain, split)
        if split.loaded:
            ports = [_on_far_body(port, split.body, len(chain.bodies) - 1) for port in ports]
    f = _numbers_of(chain)
    elements = _Elements(chain.bodies)
    for element in sorted((p for p in ports if isinstance(p, _Element)), key=_rank):
        elements.add(element, f[2])
    limit = next((p.limit for p in ports if isinstance(p, P.JointLimit)), chain.bodies[0].limit)
    if limit is not None:
        elements.bound(limit)
    gaps = [port for port in ports if isinstance(port, P.Gap)]
    for gap in gaps:
        f[5, gap.coupling] += 0.5 * gap.width
    gap_law = next((gap.contact for gap in gaps if gap.contact is not None), axis.backlash_law)
    gain, servo = _drive(chain, ports)
    stiff, damping = elements.stiff, elements.damping
    stiff[0] += servo[0]
    damping[0] += servo[1]
    return System(
        chain=chain,
        f=f,
        gap_law=gap_law.value,
        elements=np.array(sorted(elements.rows, key=lambda row: row[0]), np.int64).reshape(-1, 7),
        parameters=np.array(elements.values or [0.0]),
        has_friction=elements.friction,
        n_states=elements.n_states,
        lead=float(sum(p.seconds for p in ports if isinstance(p, P.CommandLead))),
        slew=min((p.limit for p in ports if isinstance(p, P.CommandSlew)), default=math.inf),
        acceleration=min((p.limit for p in ports if isinstance(p, P.CommandAcceleration)), default=math.inf),
        input_maps=tuple(p for p in ports if isinstance(p, P.InputMap)),
        input_lag=float(sum(p.time_constant for p in ports if isinstance(p, P.InputLag))),
        input_delay=float(sum(p.delay for p in ports if isinstance(p, P.InputDelay))),
        output_maps=tuple(p for p in ports if isinstance(p, P.OutputMap)),
        output_lag=float(sum(p.time_constant for p in ports if isinstance(p, P.OutputLag))),
        output_delay=float(sum(p.delay for p in ports if isinstance(p, P.OutputDelay))),
        omega=_fastest(f, stiff + elements.bristles, damping + elements.creep),
        sliding=_fastest(f, stiff, damping),
        yields=elements.yields,
        creeps=elements.creeps,
        spatial=elements.spatial,
        affine=_affine(ports, gap_law) and not np.isfinite(servo[2:4]).all() and not elements.uneven,
        gain=gain,
        servo=servo,
    )


def _drive(chain: Chain, ports: list[P.Port]) -> tuple[float, np.ndarray]:
    """Torque on body 0 per unit of input, and the drive's numbers (6) as torques on body 0 (`System`)."""
    g, servo = chain.gain, chain.servo
    limit = min([servo.limit if servo else math.inf, *(p.limit for p in ports if isinstance(p, P.DriveLimit))])
    lines = [p for p in ports if isinstance(p, P.TorqueSpeedLine)]
    line = min(lines, key=lambda p: p.stall, default=P.TorqueSpeedLine(math.inf, math.inf))
    out = np.array([0.0, 0.0, abs(g) * limit, abs(g) * line.stall, g * g * line.stall / line.no_load, 0.0])
    if not np.isfinite(out[3]):
        out[4] = 0.0
    if servo is None:
        return g, out
    out[0], out[1] = g * g * servo.kp, g * g * servo.kv
    per_unit = servo.kv if servo.target is Target.VELOCITY else servo.kp
    out[5] = abs(g) * servo.kp * sum(p.half_width for p in ports if isinstance(p, P.CommandDeadBand))
    return g * per_unit, out


def _affine(ports: list[P.Port], gap_law: P.BacklashLaw) -> bool:
    """Whether the equations are affine in every mode of friction and gap."""
    for port in ports:
        if isinstance(port, P.Friction):
            if levels(port) is None:
                return False
        elif isinstance(port, P.BodyTorque):
            if port.state or port.timed or constant(port.law, port.p, 1.0) is None:
                return False
        elif isinstance(port, P.CouplingTorque | P.Twist | P.BodyInertia) or (
            isinstance(port, P.Gap) and gap_law is P.BacklashLaw.NO_PULL
        ):
            return False
    return True


def _fastest(f: np.ndarray, stiff: np.ndarray, damping: np.ndarray) -> float:
    """Largest natural frequency or decay rate of the chain [rad/s]."""
    return _fastest_of(np.concatenate((f[0], f[1] + damping, f[2], f[3], f[4], stiff)).tobytes(), f.shape[1])


@lru_cache(256)  # fits change one number of many at a time, and most of them are none of the linear chain
def _fastest_of(rows: bytes, n: int) -> float:
    """The same of f (5, n) and the extra stiffness (n), as bytes."""
    f = np.frombuffer(rows).reshape(-1, n)
    return float(np.max(np.abs(np.linalg.eigvals(state_matrix(f[:5], f[5])))))


def state_matrix(f: np.ndarray, stiff: np.ndarray | None = None) -> np.ndarray:
    """A (2n, 2n) of x' = A x + b u for x = (q, v), without gaps and effects."""
    n = f.shape[1]
    inertia, viscous, ratio, stiffness, damping = f[:5].tolist()  # numbers of their own are the quicker
    rows = [[0.0] * (2 * n) for _ in range(2 * n)]
    for i in range(n):
        rows[i][n + i] = 1.0
        rows[n + i][i], rows[n + i][n + i] = 0.0 if stiff is None else float(stiff[i]), viscous[i]
    for j in range(n - 1):
        for first, c in ((0, stiffness[j]), (n, damping[j])):
            rows[n + j][first + j] += c * (ratio[j] * ratio[j])
            rows[n + j][first + j + 1] -= c * ratio[j]
            rows[n + j + 1][first + j] -= c * ratio[j]
            rows[n + j + 1][first + j + 1] += c
    a = np.array(rows)
    a[n:] /= -np.array(inertia)[:, None]
    return a
