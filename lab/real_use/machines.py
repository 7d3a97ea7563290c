"""Four machines as MJCF text: the file that a user has, and the machine that the log is made of.

What the file lacks is an element or a number of MJCF that a user would write. `Numbers` holds all of a file; the truth is the
nominal numbers with some replaced.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lab.real_use.design import Case

__all__ = ["JOINT", "Extent", "Numbers", "nominal", "text", "true_numbers"]

JOINT = "j"
G = 9.81


@dataclass(frozen=True)
class Extent:
    """How far the nominal machine goes in its experiment: largest angle, rms velocity, rms torque of the actuator."""

    reach: float
    speed: float
    torque: float


@dataclass(frozen=True)
class Numbers:
    """What a file says, in SI at the joint.

    torque: rms of the input in open loop; swing: of the target of a position loop; inertia: balanced part, beside a mass at a
    lever; load, stiffness, shaft_damping, cubic, slack: of a two-mass axis; kp, kv: of a servo or of the controller, at the
    joint; ki: of a servo; part, resonance [Hz]: a further inertia, relative to the total, on a spring; spring, ref: of the joint;
    stop: half range of the joint; cam: torque of a weight on a shaft that turns three times as fast.
    """

    torque: float
    swing: float
    inertia: float
    mass: float
    lever: float
    damping: float
    friction: float
    kp: float
    kv: float
    ki: float = 0.0
    gear: float = 1.0
    gain: float = 1.0
    armature: float = 0.0
    drag: float = 0.0
    tendon_friction: float = 0.0
    delay: float = 0.0
    lag: float = 0.0
    limit: float = math.inf
    offset: float = 0.0
    gravity: bool = True
    tilt: float = 0.0
    load: float = 0.0
    stiffness: float = 0.0
    shaft_damping: float = 0.0
    cubic: float = 0.0
    slack: float = 0.0
    part: float = 0.0
    resonance: float = 0.0
    spring: float = 0.0
    ref: float = 0.0
    stop: float = math.inf
    cam: float = 0.0

    @property
    def weight(self) -> float:
        """Gravity torque at the horizontal [N m]."""
        return G * self.mass * self.lever

    @property
    def total(self) -> float:
        """Inertia or mass that moves with the joint, a flexible load included."""
        return self.inertia + self.mass * self.lever**2 + self.armature + self.load


def nominal(case: Case) -> Numbers:
    """Numbers of the file that the user has."""
    rng = np.random.default_rng([case.seed, 0])

    def about(x: float, factor: float = 1.5) -> float:
        return float(f"{x * math.exp(rng.uniform(-1, 1) * math.log(factor)):.3g}")

    match case.machine:
        case "pendulum":
            out = Numbers(0, about(0.4), about(0.01), about(0.4), about(0.2, 1.2), about(0.05), about(0.08), 0, 0)
        case "geared":
            out = Numbers(
                0, about(0.4), about(0.02), about(0.6), about(0.3, 1.2), about(0.2), about(0.25), 0, 0, gear=20.0, armature=0.05
            )
        case "slide":
            out = Numbers(about(14.0), about(0.2), about(2.0), 0.0, 0.0, about(5.0), about(2.0), 0, 0)
        case _:
            out = Numbers(
                about(0.8), about(0.4), about(0.02), 0.0, 0.0, about(0.05), about(0.08), 0, 0,
                load=about(0.03), stiffness=about(40.0), shaft_damping=about(0.02),
            )  # fmt: skip
    if out.mass:
        out = dataclasses.replace(out, torque=about(0.8 * out.weight))
    speed = rng.uniform(8.0, 16.0)  # bandwidth of the position loop [rad/s], damping ratio .7
    kp, kv = (float(f"{x:.3g}") for x in (out.total * speed**2, 1.4 * out.total * speed))
    out = dataclasses.replace(out, kp=kp, kv=kv)
    if case.kind in ("joint_friction", "tendon_friction"):
        return dataclasses.replace(out, friction=0.0)
    return dataclasses.replace(out, gravity=False) if case.kind == "gravity" else out


@dataclass(frozen=True)
class _Draw:
    """What the lacking part is sized by; factor: 1.15 to 1.5 or its inverse; size: .7 to 1.4; resonance [Hz]: 3 to 8."""

    given: Numbers
    extent: Extent
    timestep: float
    factor: float
    size: float
    resonance: float


_Changes = dict[str, float]
_LACKS: dict[str, Callable[[_Draw], _Changes]] = {
    "nothing": lambda d: {},
    "inertia": lambda d: {"inertia": d.given.inertia * d.factor, "mass": d.given.mass * d.factor},
    "armature": lambda d: {"armature": d.given.armature + 0.3 * d.size * d.given.total},
    "damping": lambda d: {"damping": d.given.damping * d.factor},
    "dry_friction": lambda d: {"friction": d.given.friction * d.factor},
    "gain": lambda d: {"gain": d.factor},
    "weight": lambda d: {"lever": d.given.lever * d.factor**0.5},
    "shaft_stiffness": lambda d: {"stiffness": d.given.stiffness * d.factor},
    "joint_friction": lambda d: {"friction": 0.2 * d.size * d.extent.torque},
    "tendon_friction": lambda d: {"tendon_friction": 0.2 * d.size * d.extent.torque},
    "drag": lambda d: {"drag": 0.2 * d.size * d.extent.torque / d.extent.speed**2},
    "delay": lambda d: {"delay": max(1, round(0.012 * d.size / d.timestep)) * d.timestep},
    "lag": lambda d: {"lag": 0.02 * d.size},
    "limit": lambda d: {"limit": 1.3 * d.size * d.extent.torque},
    "offset": lambda d: {"offset": 0.15 * d.size * d.extent.torque},
    "tilt": lambda d: {"tilt": 0.15 * d.size * d.extent.torque / d.given.inertia},
    "gravity": lambda d: {"gravity": True},
    "flexible_joint": lambda d: {"part": 0.3 * d.size, "resonance": d.resonance},
    "slack_joint": lambda d: {"slack": 0.02 * d.size},
    "hard_shaft": lambda d: {"cubic": d.size * d.given.stiffness / _deflection(d) ** 2},
    "cam": lambda d: {"cam": 0.25 * d.size * d.extent.torque},
    "spring": lambda d: {"spring": 0.4 * d.size * d.extent.torque / d.extent.reach, "ref": 0.2 * d.extent.reach},
    "stop": lambda d: {"stop": 0.5 * d.size * d.extent.reach},
}


def _deflection(d: _Draw) -> float:
    """Of the shaft under the load's share of the rms torque [rad]."""
    return d.extent.torque * d.given.load / d.given.total / d.given.stiffness


def true_numbers(case: Case, given: Numbers, extent: Extent) -> Numbers:
    """Numbers of the machine: those of the file and what it lacks, sized by the extent of the experiment."""
    rng = np.random.default_rng([case.seed, 1])
    factor = math.exp(rng.choice([-1.0, 1.0]) * rng.uniform(math.log(1.15), math.log(1.5)))
    draw = _Draw(given, extent, case.timestep, factor, rng.uniform(0.7, 1.4), rng.uniform(3.0, 8.0))
    return dataclasses.replace(given, **_LACKS[case.kind](draw))  # type: ignore[arg-type]


def text(case: Case, n: Numbers) -> str:
    """MJCF of a case with these numbers."""
    gravity = f"{n.tilt!r} 0 {-G!r}" if n.gravity else "0 0 0"
    return f"""<mujoco model="{case.machine}">
  <compiler angle="radian"/>
  <option timestep="{case.timestep!r}" integrator="{case.integrator}" gravity="{gravity}"/>
  <worldbody>
{_bodies(case, n)}
  </worldbody>
{_tendon(case, n)}{_equality(n)}  <actuator>{_actuator(case, n)}</actuator>
</mujoco>
"""


def _stiff(case: Case, kind: str) -> str:
    """Attributes of a stiff constraint at the file's timestep; none with the default settings."""
    if case.solver == "default":
        return ""
    rate = (2.5 if case.integrator == "RK4" else 1.0) / case.timestep
    solref = f"-1 {-rate:g}" if kind == "friction" else f"{-1 / (2 * case.timestep) ** 2:g} {-1 / case.timestep:g}"
    return f' solref{kind}="{solref}" solimp{kind}=".9999 .9999 .001 .5 2"'


def _bodies(case: Case, n: Numbers) -> str:
    slide = case.machine == "slide"
    axis = {"slide": "1 0 0", "two_mass": "0 0 1"}.get(case.machine, "0 1 0")
    kind = ' type="slide"' if slide else ""
    damping = f"{n.damping!r} {n.drag!r}" if n.drag else f"{n.damping!r}"
    joint = f'<joint name="{JOINT}"{kind} axis="{axis}" damping="{damping}"'
    joint += f' armature="{n.armature!r}"' if n.armature else ""
    joint += f' frictionloss="{n.friction!r}"{_stiff(case, "friction")}' if n.friction else ""
    joint += f' stiffness="{n.spring!r}" springref="{n.ref!r}"' if n.spring else ""
    joint += f' range="{-n.stop!r} {n.stop!r}" limited="true"{_stiff(case, "limit")}' if math.isfinite(n.stop) else ""
    joint += "/>"
    return f'    <body name="axis">{joint}{_inertial(n, slide)}{_behind(case, n, slide, axis)}</body>{_cam_body(n)}'


def _inertial(n: Numbers, slide: bool) -> str:
    if slide:
        return f'<inertial pos="0 0 0" mass="{n.inertia!r}" diaginertia=".01 .01 .01"/>'
    return f'<inertial pos="0 0 {-n.lever!r}" mass="{n.mass or 1.0!r}" diaginertia="{" ".join([repr(n.inertia)] * 3)}"/>'


def _behind(case: Case, n: Numbers, slide: bool, axis: str) -> str:
    """The load of a two-mass axis, or a further inertia that hangs on a spring."""
    if n.part:
        hung = n.part * n.total
        pull = hung * (2 * math.pi * n.resonance) ** 2
        loss = 0.04 * math.sqrt(hung * pull)
        kind = ' type="slide"' if slide else ""
        inertial = (
            f'mass="{hung!r}" diaginertia=".01 .01 .01"' if slide else f'mass=".001" diaginertia="{hung!r} {hung!r} {hung!r}"'
        )
        return (
            f'\n      <body name="hung"><joint name="flex"{kind} axis="{axis}" stiffness="{pull!r}" damping="{loss!r}"/>'
            f'<inertial pos="0 0 0" {inertial}/></body>'
        )
    if not n.load:
        return ""
    stiffness = f"{n.stiffness!r} 0 {n.cubic!r}" if n.cubic else f"{n.stiffness!r}"
    load = (
        f'<body name="load"><joint name="shaft" axis="0 0 1" stiffness="{stiffness}" damping="{n.shaft_damping!r}"/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia="{n.load!r} {n.load!r} {n.load!r}"/></body>'
    )
    if not n.slack:
        return f"\n      {load}"
    half, small = n.slack / 2, n.load / 100
    return (
        f'\n      <body name="coupling"><joint name="play" axis="0 0 1" range="{-half!r} {half!r}" limited="true" '
        f'damping="{n.shaft_damping / 20!r}"{_stiff(case, "limit")}/>'
        f'<inertial pos="0 0 0" mass=".05" diaginertia="{small!r} {small!r} {small!r}"/>{load}</body>'
    )


def _cam_body(n: Numbers) -> str:
    if not n.cam:
        return ""
    mass = n.cam / (3 * G * 0.05)
    return (
        '\n    <body name="cam" pos="0 0 .5"><joint name="cam" axis="0 1 0"/>'
        f'<inertial pos="0 0 -.05" mass="{mass!r}" diaginertia="1e-5 1e-5 1e-5"/></body>'
    )


def _equality(n: Numbers) -> str:
    if not n.cam:
        return ""
    return f'  <equality><joint joint1="cam" joint2="{JOINT}" polycoef="0 3 0 0 0" solref=".005 1"/></equality>\n'


def _tendon(case: Case, n: Numbers) -> str:
    if not n.tendon_friction:
        return ""
    solver = _stiff(case, "friction")
    return (
        f'  <tendon><fixed name="seal" frictionloss="{n.tendon_friction!r}"{solver}><joint joint="{JOINT}" coef="1"/>'
        "</fixed></tendon>\n"
    )


def _actuator(case: Case, n: Numbers) -> str:
    more = f' delay="{n.delay!r}" nsample="{round(n.delay / case.timestep) + 2}"' if n.delay else ""
    limit = n.limit / n.gear
    if case.loop == "servo":
        more += f' timeconst="{n.lag!r}"' if n.lag else ""
        more += f' forcelimited="true" forcerange="{-limit!r} {limit!r}"' if math.isfinite(limit) else ""
        gains = f'kp="{n.gain * n.kp / n.gear**2!r}" kv="{n.kv / n.gear**2!r}"'
        if n.ki:
            return f'<pid name="drive" joint="{JOINT}" gear="{n.gear!r}" {gains} ki="{n.ki / n.gear**2!r}" input="pos"{more}/>'
        return f'<position name="drive" joint="{JOINT}" gear="{n.gear!r}" {gains}{more}/>'
    more += f' dyntype="filterexact" dynprm="{n.lag!r}"' if n.lag else ""
    more += f' ctrllimited="true" ctrlrange="{-limit!r} {limit!r}"' if math.isfinite(limit) else ""
    more += f' biastype="affine" biasprm="{n.offset / n.gear!r} 0 0"' if n.offset else ""
    return f'<general name="drive" joint="{JOINT}" gear="{n.gain * n.gear!r}"{more}/>'
