"""The effects that a servo joint can have: free numbers of `mjsim.robot.joint_kernel`, starts, and parameters as the contract names them.

Identifiers, parameters and signs are those of `mjsim.effects`. Places are ``actuator`` for the servo and ``motor`` for the joint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from diagnose.robot.servos.bodies import PAYLOAD
from diagnose.robot.servos.fit import Number
from diagnose.robot.servos.motion import OWN, JointProblem
from mjsim.effects.admissible import BETWEEN
from mjsim.quantity import Motion, Quantity
from mjsim.robot.joint_kernel import SLOT

__all__ = ["DELAY", "PAYLOAD", "PLAIN", "PROFILE", "WEIGHT", "ServoLaw", "identifiers", "servo_laws"]

Slots = Mapping[str, float]
Values = dict[str, tuple[float, Quantity]]
DELAY = "time_delay"
WEIGHT = "gravity_load"  # a number of the robot where the file has a weight about the joint
PROFILE = "acceleration_limit"
LOGGED = "position_late"  # form of a delay that is of the log
PLAIN = "coulomb_friction"  # the law of the dry friction that a file has
MOST_ORDERS = 24  # spatial orders that are tried
MOST_PERIODS = 40.0  # over the travel


@dataclass(frozen=True, eq=False)
class ServoLaw:
    """One effect at one servo joint.

    numbers: what is free; starts: slot values from which a fit may start; values: contract parameters from slots; fixed: slots that a start
    sets and a fit keeps; holds: laws that it contains and takes the place of; dry: is dry friction; native: attributes of MJCF that
    hold all of it, by the slot that they take; kept: fixed slots that a file carries beside the parameters, by name;
    number: a number of the robot's own, and no physics; source: the joint that a coupling comes from; linear: slots in
    which its torque is linear, and which the screening sets; limit_of: key of the law of more numbers in whose place it is asked for, where
    one of those is not determined, and nowhere else.
    """

    id: str
    place: str
    numbers: tuple[Number, ...]
    starts: tuple[Slots, ...]
    values: Callable[[Slots], Values]
    sentence: str
    holds: tuple[str, ...] = ()
    form: str = ""
    fixed: tuple[str, ...] = ()
    dry: bool = False
    common: bool = False
    native: Mapping[str, str] = field(default_factory=dict)
    kept: tuple[tuple[str, str], ...] = ()
    sane: Callable[[Slots], bool] = lambda s: True
    number: bool = False
    source: str = ""
    linear: tuple[str, ...] = ()
    limit_of: str = ""

    @property
    def key(self) -> str:
        """``id``, ``id/form`` and ``id<source``."""
        return self.id + (f"/{self.form}" if self.form else "") + (f"<{self.source}" if self.source else "")

    @property
    def is_delay(self) -> bool:
        """Whether it is a delay, of the servo or of the log."""
        return self.id == DELAY

    @property
    def is_logged(self) -> bool:
        """Whether it is of the log, and not of the robot."""
        return self.form == LOGGED

    @property
    def slots(self) -> tuple[str, ...]:
        """Slots that it fills."""
        out = [s for n in self.numbers for s in (("load", "load_back") if n.slot == "load_both" else (n.slot,))]
        return (*out, *self.fixed)


@dataclass(frozen=True)
class Scales:
    """Sizes of one joint: travel [rad | m], rms and largest speed, largest acceleration, error of the servo, torque of the links and
    of the drive; least: delay or lag [s] from which on one is not a matter of how the commands go between samples."""

    travel: float
    low: float
    high: float
    speed: float
    fastest: float
    hardest: float
    error: float
    load: float
    drive: float
    span: float
    dt: float
    gear: float
    least: float = 0.0


def scales_of(problem: JointProblem, p: np.ndarray) -> Scales:
    """Sizes of a joint under slots (K,)."""
    q, v = problem.angle, problem.series[:, 6]
    error = problem.first - q if not problem.drive.velocity else problem.first - v
    rms = float(np.sqrt(np.mean(error**2)))
    gain = p[SLOT["kv"]] if problem.drive.velocity else p[SLOT["kp"]]
    span = float(np.max(np.diff(problem.starts)) * problem.dt)
    hardest = max(float(np.max(np.abs(np.gradient(v[problem.part(k)], problem.dt)))) for k in range(len(problem.sources)))
    return Scales(
        float(np.ptp(q)), float(np.min(q)), float(np.max(q)), float(np.sqrt(np.mean(v**2))) + 1e-9, float(np.max(np.abs(v))) + 1e-9,
        hardest + 1e-9, rms,
        float(np.sqrt(np.mean(problem.series[:, 4] ** 2))), float(gain) * rms, span, problem.dt, problem.drive.gear,
        0.0 if problem.hold_stated else BETWEEN * problem.dt,
    )  # fmt: skip


def servo_laws(problem: JointProblem, p: np.ndarray, only: Sequence[str] = ()) -> tuple[ServoLaw, ...]:
    """All laws of a joint, their starts from the sizes of its motion under slots (K,) of a fit without effects."""
    s, motion = scales_of(problem, p), _motion(problem)
    laws = [
        *_friction(s),
        *_drive(s, problem.drive.velocity),
        *_position(s, motion, problem.bears_weight),
        *_links(problem),
        *_coupled(s, problem),
    ]
    if problem.nominal[SLOT["friction"]] > 0.0:  # the file has dry friction: its size is one of its own numbers
        laws = [law for law in laws if law.id != PLAIN]
    if problem.nominal[SLOT["integral"]] > 0.0:
        laws = [law for law in laws if "ki" not in law.native]
    if problem.nominal[SLOT["delay"]] > 0.0:
        laws = [law for law in laws if not law.is_delay or law.is_logged]
    return tuple(law for law in laws if not only or law.id in only or law.id == PAYLOAD)


def _links(problem: JointProblem) -> list[ServoLaw]:
    """A payload on the last link, where the joint feels it: a number of the robot, which competes with the laws."""
    felt = float(np.sqrt(np.mean(problem.series[:, 8] ** 2)))
    mass = 0.2 * float(np.sqrt(np.mean(problem.series[:, 4] ** 2))) / felt if felt > 0 else 0.0
    if not mass > 0:
        return []
    n = Number("payload", False, mass)
    return [ServoLaw(PAYLOAD, "link", (n,), ({"payload": mass}, {"payload": -mass}), lambda x: {"mass_kg": (x["payload"], Quantity.INERTIA)},
                     "A mass at the centre of the last link.", number=True)]  # fmt: skip


def _coupled(s: Scales, problem: JointProblem) -> list[ServoLaw]:
    """Torque and friction that come from another joint that moves."""
    out, size, fixed = [], 0.1 * s.drive + 1e-12, ("couple_from",)
    for k, name in enumerate(problem.joints):
        torque, _, speed = (float(np.sqrt(np.mean(problem.series[:, OWN + 3 * k + i] ** 2))) for i in range(3))
        if name == problem.name or not (torque > 0 and speed > 0):
            continue
        source = {"couple_from": k + 1.0}
        ratio, viscous = size / torque, size / speed
        out += [
            ServoLaw("coupled_transmission", "actuator", (Number("couple_torque", False, ratio),), ({"couple_torque": ratio} | source,),
                     lambda x: {"ratio": (x["couple_torque"], Quantity.RATIO)}, f"A part of the torque of {name} acts here (coupled gears).",
                     fixed=fixed, source=name),
            *_coupled_friction(name, size, viscous, source),
        ]  # fmt: skip
    return out


def _coupled_friction(name: str, size: float, viscous: float, source: Slots) -> list[ServoLaw]:
    """Dry and viscous friction that goes with the motion of another joint, and either alone, its limits."""
    dry, slow = Number("couple_sign", False, size), Number("couple_speed", False, viscous)
    T, D = Quantity.TORQUE, Quantity.DAMPING
    both = ServoLaw("coupled_transmission", "actuator", (dry, slow), ({dry.slot: size, **source}, {slow.slot: viscous, **source}),
                    lambda x: {"torque_Nm": (x["couple_sign"], T), "viscous": (x["couple_speed"], D)},
                    f"Friction that goes with the motion of {name} (coupled gears).", form="friction", fixed=("couple_from",), source=name)  # fmt: skip
    return [
        both,
        replace(both, numbers=(dry,), starts=both.starts[:1], form="dry", limit_of=both.key,
                values=lambda x: {"torque_Nm": (x["couple_sign"], T)},
                sentence=f"Dry friction that goes with the motion of {name} (coupled gears)."),
        replace(both, numbers=(slow,), starts=both.starts[1:], form="viscous", limit_of=both.key,
                values=lambda x: {"viscous": (x["couple_speed"], D)},
                sentence=f"Viscous friction that goes with the motion of {name} (coupled gears)."),
    ]  # fmt: skip


def _motion(problem: JointProblem) -> Motion:
    return Motion.SLIDE if problem.slide else Motion.HINGE


def identifiers() -> tuple[str, ...]:
    """Identifiers of all laws of servo joints."""
    s = Scales(2.0, -1.0, 1.0, 1.0, 1.0, 1.0, 0.1, 1.0, 1.0, 10.0, 0.01, 1.0)
    laws = [*_friction(s), *_drive(s, False), *_position(s, Motion.HINGE)]
    return (*dict.fromkeys(law.id for law in laws), "coupled_transmission")


def _friction(s: Scales) -> list[ServoLaw]:
    T, R = Quantity.TORQUE, Quantity.RATIO
    F, amount = Number("friction"), (0.15 * s.drive, 0.5 * s.drive)
    share = min(0.5, 0.3 * s.drive / (s.load + 1e-12))
    v = s.speed
    return [
        ServoLaw("coulomb_friction", "motor", (F,), tuple({"friction": a} for a in amount), lambda x: {"torque_Nm": (x["friction"], T)},
                 "Dry friction that opposes motion, of the same size at every speed.", dry=True, common=True, native={"frictionloss": "friction"}),
        ServoLaw("asymmetric_friction", "motor", (F, Number("asymmetry", False, 0.1 * s.drive + 1e-12)),
                 tuple({"friction": amount[0], "asymmetry": c * amount[0]} for c in (-0.3, 0.3)),
                 lambda x: {"torque_Nm": (x["friction"], T), "asymmetry_Nm": (x["asymmetry"], T)},
                 "Dry friction that is larger in one direction than in the other.", ("coulomb_friction",), dry=True,
                 sane=lambda x: abs(x["asymmetry"]) < x["friction"]),
        ServoLaw("stribeck_friction", "motor", (F, Number("extra"), Number("stribeck", lower=0.02 * v, upper=s.fastest)),
                 tuple({"friction": amount[0], "extra": 0.4 * amount[0], "stribeck": c * v} for c in (0.1, 0.4)),
                 lambda x: {"torque_Nm": (x["friction"], T), "extra_static_torque_Nm": (x["extra"], T),
                            "stribeck_velocity_rad_s": (x["stribeck"], Quantity.VELOCITY)},
                 "Friction that is higher near standstill and falls with speed.", ("coulomb_friction",), dry=True,
                 sane=lambda x: x["extra"] < 10 * x["friction"] and x["stribeck"] > 0.021 * v),
        ServoLaw("load_dependent_friction", "motor", (Number("load_both", upper=0.95),), ({"load_both": share},),
                 lambda x: {"coefficient": (x["load"], R)}, "Friction that grows with the load of the joint, as in a loaded gear mesh.",
                 sane=lambda x: 0 < x["load"] < 0.9),
        ServoLaw("load_dependent_friction", "motor", (Number("load", upper=0.95), Number("load_back", upper=0.95)),
                 ({"load": share, "load_back": 0.3 * share}, {"load": 0.3 * share, "load_back": share}),
                 lambda x: {"coefficient": (x["load"], R), "coefficient_backdriven": (x["load_back"], R)},
                 "Friction that grows with the load, by another share when the load drives the motor than when the motor drives it.",
                 ("load_dependent_friction",), "two_directions", sane=lambda x: 0 < x["load"] < 0.9 and 0 < x["load_back"] < 0.9),
        ServoLaw("presliding_friction", "motor", (F, Number("bristle", lower=5e-4 * s.travel, upper=0.3 * s.travel)),
                 tuple({"friction": amount[0], "bristle": c * s.travel} for c in (0.005, 0.03)),
                 lambda x: {"torque_Nm": (x["friction"], T), "stiffness_Nm_rad": (x["friction"] / x["bristle"], Quantity.STIFFNESS)},
                 "Dry friction that builds up over a short way after each reversal.", ("coulomb_friction",), dry=True,
                 sane=lambda x: 6e-4 * s.travel < x["bristle"] < 0.28 * s.travel),
        ServoLaw("sublinear_viscous_friction", "motor", (Number("sublinear"), Number("exponent", lower=0.1, upper=0.9)),
                 tuple({"sublinear": 0.3 * s.drive / v**e, "exponent": e} for e in (0.3, 0.6)),
                 lambda x: {"coefficient": (x["sublinear"], Quantity.DAMPING), "exponent": (x["exponent"], R)},
                 "Friction that grows less than in proportion to the speed.", linear=("sublinear",), sane=lambda x: 0.11 < x["exponent"] < 0.89),
        ServoLaw("quadratic_friction", "motor", (Number("quadratic"),), ({"quadratic": 0.2 * s.drive / v**2},),
                 lambda x: {"coefficient_Nm_s2_rad2": (x["quadratic"], Quantity.QUADRATIC_DAMPING)},
                 "Friction that grows with the square of the speed.", native={"quadratic": "quadratic"}),
        ServoLaw("friction_drift", "motor",
                 (F, Number("drift", False, 0.3, -0.9, 2.0), Number("drift_time", lower=0.3 * s.span, upper=3 * s.span)),
                 tuple({"friction": amount[0], "drift": c, "drift_time": 0.6 * s.span} for c in (-0.4, 0.4)),
                 lambda x: {"torque_Nm": (x["friction"], T), "relative_change": (x["drift"], R), "time_constant_s": (x["drift_time"], Quantity.TIME)},
                 "Dry friction that changes while the robot warms up.", ("coulomb_friction",), dry=True,
                 sane=lambda x: 0.31 * s.span < x["drift_time"] < 2.9 * s.span),
    ]  # fmt: skip


def _drive(s: Scales, velocity: bool) -> list[ServoLaw]:
    laws = [
        ServoLaw(DELAY, "actuator", (Number("delay", lower=1e-4 * s.dt, upper=0.5),), tuple({"delay": c * s.dt} for c in (0.5, 1.5, 4.0)),
                 lambda x: {"delay_s": (x["delay"], Quantity.TIME)}, "The command acts later than it is logged.",
                 sane=lambda x: x["delay"] >= s.least),
        ServoLaw(DELAY, "sensor", (Number("late", lower=1e-4 * s.dt, upper=0.5),), tuple({"late": c * s.dt} for c in (0.5, 1.5, 4.0)),
                 lambda x: {"delay_s": (x["late"], Quantity.TIME)},
                 "The position is logged later than the command: a fault of the log or a slow encoder, not of the servo.", form=LOGGED,
                 sane=lambda x: x["late"] >= s.least),
        ServoLaw("actuator_lag", "actuator", (Number("lag", lower=0.01 * s.dt, upper=1.0),), tuple({"lag": c * s.dt} for c in (0.7, 3.0)),
                 lambda x: {"time_constant_s": (x["lag"], Quantity.TIME)}, "The servo's target follows the command with a lag.",
                 sane=lambda x: x["lag"] >= s.least),
        ServoLaw("actuator_saturation", "actuator", (Number("limit"),), tuple({"limit": c * s.drive} for c in (3.0, 1.5)),
                 lambda x: {"limit_Nm": (x["limit"], Quantity.TORQUE)}, "The torque of the servo is limited.", native={"forcerange": "limit"}),
        ServoLaw("torque_speed_limit", "actuator", (Number("stall"), Number("no_load", lower=0.5 * s.fastest, upper=50 * s.fastest)),
                 tuple({"stall": a * s.drive, "no_load": b * s.fastest} for a, b in ((3.0, 1.5), (1.5, 2.0))),
                 lambda x: {"stall_torque_Nm": (x["stall"], Quantity.TORQUE), "no_load_speed_rad_s": (x["no_load"], Quantity.VELOCITY)},
                 "The motor's torque is limited by its speed (back-EMF).", ("actuator_saturation",),
                 sane=lambda x: x["no_load"] < 40 * s.fastest),
    ]  # fmt: skip
    if velocity:
        laws.append(
            ServoLaw("torque_offset", "actuator", (Number("preload", False, 0.1 * s.drive + 1e-12),), ({"preload": 0.1 * s.drive},),
                     lambda x: {"torque_Nm": (-x["preload"], Quantity.TORQUE)}, "A constant torque beside that of the servo."))  # fmt: skip
        return laws
    stiff = s.drive / (s.error + 1e-300)  # kp
    return [
        *laws,
        ServoLaw("servo_deadband", "actuator", (Number("dead_band", upper=3 * s.error),), tuple({"dead_band": c * s.error} for c in (0.1, 0.4)),
                 lambda x: {"half_width_rad": (x["dead_band"], Quantity.ANGLE)},
                 "The servo does not react to errors within its dead band."),
        ServoLaw("integral_action", "actuator", (Number("integral", upper=stiff / s.dt),), tuple({"integral": c * stiff} for c in (0.5, 2.0)),
                 lambda x: {"gain_Nm_rad_s": (x["integral"], Quantity.INTEGRAL_GAIN)},
                 "The servo has integral action: beside kp and kv a gain on the integral of its error.", native={"ki": "integral"},
                 sane=lambda x: x["kp"] / s.span < x["integral"] < 0.5 * x["kp"] / s.dt),
        ServoLaw("velocity_feedforward", "actuator", (Number("lead"),), tuple({"lead": c * s.drive / s.speed} for c in (0.3, 1.0)),
                 lambda x: {"gain_Nms_rad": (x["lead"], Quantity.DAMPING)},
                 "The servo has a velocity feedforward: beside kp and kv a gain on the speed of its target.", linear=("lead",),
                 sane=lambda x: x["lead"] > x["kp"] * s.dt),
        ServoLaw("velocity_limit", "actuator", (Number("slew", upper=20 * s.fastest),), tuple({"slew": c * s.fastest} for c in (0.5, 0.9)),
                 lambda x: {"limit_rad_s": (x["slew"], Quantity.VELOCITY)}, "The servo follows its command no faster than a limit.",
                 native={"slewmax": "slew"}, sane=lambda x: x["slew"] < 5 * s.fastest),
        ServoLaw(PROFILE, "actuator", (Number("acceleration", upper=20 * s.hardest),),
                 tuple({"acceleration": 0.25 * 2 ** (k / 4) * s.hardest} for k in range(13)),
                 lambda x: {"limit_rad_s2": (x["acceleration"], Quantity.ACCELERATION)},
                 "The servo's target speeds up and slows down by no more than a limit.", sane=lambda x: x["acceleration"] < 4 * s.hardest),
    ]  # fmt: skip


def _sine(a: float, b: float) -> tuple[float, float]:
    return math.hypot(a, b), math.atan2(b, a)


def _position(s: Scales, motion: Motion, heavy: bool = False) -> list[ServoLaw]:
    """Torques of the angle; heavy: the file has a weight about the joint, so that another one is a number of it."""
    T, R = Quantity.TORQUE, Quantity.RATIO
    size = 0.1 * s.drive + 1e-12
    unit = abs(s.gear) if motion is Motion.HINGE else 1.0
    laws = [
        ServoLaw("gravity_compensation_spring", "motor", (Number("spring", False, size / (0.5 * s.travel)),),
                 ({"spring": size / (0.5 * s.travel)},), lambda x: {"stiffness_Nm_rad": (x["spring"], Quantity.STIFFNESS)},
                 "A spring at the joint; its torque at zero cannot be told from the zero of the command.", native={"stiffness": "spring"},
                 sane=lambda x: x["spring"] > 0),
        ServoLaw("cable_torque", "motor",
                 (Number("spring", False, size / (0.5 * s.travel)), *(Number(f"cable_{k}", False, size) for k in (2, 3, 4))),
                 ({"spring": 0.0, "cable_2": size, "cable_3": size, "cable_4": 0.5 * size, "cable_low": s.low, "cable_high": s.high},),
                 lambda x: {"coefficient_1": (0.5 * x["spring"] * (x["cable_high"] - x["cable_low"]), T),
                            **{f"coefficient_{k}": (x[f"cable_{k}"], T) for k in (2, 3, 4)}},
                 "A smooth torque of the angle (cables, hoses): coefficients of Chebyshev polynomials over the recorded travel.",
                 ("gravity_compensation_spring", "gravity_load"), fixed=("cable_low", "cable_high"), linear=("spring", "cable_2", "cable_3", "cable_4"), kept=(("low_rad", "cable_low"), ("high_rad", "cable_high"))),
    ]  # fmt: skip
    if motion is Motion.HINGE:
        laws.append(
            ServoLaw(WEIGHT, "motor", (Number("weight_sin", False, size), Number("weight_cos", False, size)),
                     ({"weight_sin": 0.0, "weight_cos": 0.0},),
                     lambda x: dict(zip(("torque_Nm", "phase_rad"), zip(_sine(x["weight_sin"], x["weight_cos"]), (T, Quantity.PHASE), strict=True), strict=True)),
                     "A weight about the axis, which the model does not have (a payload, a tilted base).", linear=("weight_sin", "weight_cos"), number=heavy))  # fmt: skip
    orders = _orders(s, unit)
    if orders:
        laws += [
            ServoLaw("torque_ripple", "motor",
                     (Number("ripple_sin", False, size), Number("ripple_cos", False, size), Number("order", False, 0.5 * math.pi / s.travel)),
                     tuple({"ripple_sin": size * a, "ripple_cos": size * b, "order": k} for k in orders for a, b in ((1, 0), (0, 1))),
                     lambda x: {"amplitude_Nm": (_sine(x["ripple_sin"], x["ripple_cos"])[0], T), "cycles_per_rev": (x["order"] / unit, Quantity.CYCLES),
                                "phase_rad": (_sine(x["ripple_sin"], x["ripple_cos"])[1], Quantity.PHASE)},
                     "A torque locked to the angle (cogging, a gear's error).", sane=lambda x: x["order"] > 2 * math.pi / s.travel),
            ServoLaw("position_dependent_friction", "motor",
                     (Number("friction"), Number("rub_sin", False, 0.3), Number("rub_cos", False, 0.3), Number("rub_order", False, 0.5 * math.pi / s.travel)),
                     tuple({"friction": 0.3 * s.drive, "rub_sin": 0.4 * a, "rub_cos": 0.4 * b, "rub_order": k} for k in orders for a, b in ((1, 0), (0, 1))),
                     lambda x: {"torque_Nm": (x["friction"], T), "relative_amplitude": (_sine(x["rub_sin"], x["rub_cos"])[0], R),
                                "cycles_per_rev": (x["rub_order"] / unit, Quantity.CYCLES), "phase_rad": (_sine(x["rub_sin"], x["rub_cos"])[1], Quantity.PHASE)},
                     "Dry friction that varies over the turn.", ("coulomb_friction",), dry=True,
                     sane=lambda x: _sine(x["rub_sin"], x["rub_cos"])[0] < 1 and x["rub_order"] > 2 * math.pi / s.travel),
        ]  # fmt: skip
    return laws


def _orders(s: Scales, unit: float) -> tuple[float, ...]:
    """Spatial frequencies [rad/rad | rad/m] of two periods over the travel and more, of eight samples a period at the rms speed."""
    resolution = 2 * math.pi / s.travel
    highest = min(2 * math.pi / (8 * s.speed * s.dt), MOST_PERIODS * resolution)
    if highest <= 2 * resolution:
        return ()
    grid = np.geomspace(2 * resolution, highest, MOST_ORDERS)
    turns = [k * unit for k in (1, 2, 4, 6, 8, 12) if 2 * resolution <= k * unit <= highest]
    return tuple(np.unique(np.concatenate([grid, turns])).tolist())
