"""The effects of the registry that a force regression can express: torque columns of one joint.

needed torque = nominal torque + sum over columns coefficient * column(q, v, load, ...; shape)

Each law has coefficients (linear) and at most one shape parameter (a velocity, an order, a time), which runs over a grid before
it is refined. Identifiers, parameters and signs are those of `mjsim.effects`; a joint is the place ``motor`` of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from mjsim.quantity import Motion, Quantity

__all__ = ["FLEXIBLE", "Law", "Row", "identifiers", "law_parameters", "laws_for"]


@dataclass(frozen=True, eq=False)
class Row:
    """Signals (N,) of one joint on the fine grid of one recording, in SI at the joint.

    t: time since the start; load: torque that the links need (no friction, no rotor); torque: recorded, filtered twice; rate: its
    derivative; others: by joint name (velocity, torque) of the other joints.
    """

    q: np.ndarray
    v: np.ndarray
    t: np.ndarray
    load: np.ndarray
    torque: np.ndarray
    rate: np.ndarray
    others: dict[str, tuple[np.ndarray, np.ndarray]]


MOST_PERIODS = 40.0  # over the travel: of shorter ones only those of the motor's turn are tried
FLEXIBLE = "joint_flexibility"  # no column of one row: see `diagnose.robot.elastic`
Columns = Callable[[Row, float], list[np.ndarray]]
Values = dict[str, tuple[float, Quantity]]
Native = Callable[[np.ndarray], dict[str, float]]


@dataclass(frozen=True)
class Law:
    """One effect at one joint as columns.

    id: contract identifier; form: variant of it; columns: of a row and a shape; passes: how often the columns have yet to be
    filtered; values: parameters from (coefficients, shape); sane: whether these are physical; grid: shapes that are tried; holds:
    laws that this one contains; sentence: plain words; source: the other joint, of a coupling; dry: holds dry friction, and takes the
    place of the file's own; common: tested with a weight of its own; loaded: depends on the load, hence on the robot's own
    parameters; is_sum: is no more than the laws that it holds together; native: MJCF attributes of the joint that hold it, in SI.
    """

    id: str
    columns: Columns
    passes: int
    values: Callable[[np.ndarray, float], Values]
    sane: Callable[[np.ndarray, float], bool]
    grid: tuple[float, ...] = (0.0,)
    holds: tuple[str, ...] = ()
    form: str = ""
    sentence: str = ""
    source: str = ""
    shape_name: str = ""
    limits: tuple[float, float] = field(default=(-math.inf, math.inf))
    dry: bool = False
    common: bool = False
    loaded: bool = False
    is_sum: bool = False
    native: Native | None = None

    @property
    def key(self) -> str:
        """``id``, ``id/form`` and ``id<source``: what tells two laws of one joint apart."""
        return self.id + (f"/{self.form}" if self.form else "") + (f"<{self.source}" if self.source else "")


def _positive(c: np.ndarray, s: float) -> bool:
    return bool(np.all(c > 0))


def _any(c: np.ndarray, s: float) -> bool:
    return True


def _sine(c: np.ndarray) -> tuple[float, float]:
    """Amplitude and phase of c[0] sin(x) + c[1] cos(x)."""
    return float(np.hypot(c[0], c[1])), float(np.arctan2(c[1], c[0]))


def _plain() -> list[Law]:
    """Laws without a shape."""
    T, R = Quantity.TORQUE, Quantity.RATIO
    return [
        Law("coulomb_friction", lambda r, s: [np.sign(r.v)], 2, lambda c, s: {"torque_Nm": (c[0], T)}, _positive,
            dry=True, common=True, native=lambda c: {"frictionloss": float(c[0])},
            sentence="Dry friction that opposes motion, of the same size at every speed."),
        Law("torque_offset", lambda r, s: [np.ones_like(r.q)], 0, lambda c, s: {"torque_Nm": (-c[0], T)}, _any,
            sentence="A constant torque beside the commanded one (amplifier offset, preload)."),
        Law("asymmetric_friction", lambda r, s: [np.sign(r.v), np.ones_like(r.q)], 2,
            lambda c, s: {"torque_Nm": (c[0], T), "asymmetry_Nm": (c[1], T)}, lambda c, s: abs(c[1]) < c[0],
            holds=("coulomb_friction", "torque_offset"), dry=True, is_sum=True,
            sentence="Dry friction that is larger in one direction than in the other."),
        Law("quadratic_friction", lambda r, s: [r.v * np.abs(r.v)], 1,
            lambda c, s: {"coefficient_Nm_s2_rad2": (c[0], Quantity.QUADRATIC_DAMPING)}, _positive,
            native=lambda c: {"quadratic": float(c[0])}, sentence="Friction that grows with the square of the speed."),
        Law("load_dependent_friction", lambda r, s: [np.sign(r.v) * np.abs(r.load)], 2, lambda c, s: {"coefficient": (c[0], R)},
            lambda c, s: 0 < c[0] < 1, loaded=True, sentence="Friction that grows with the load of the joint, as in a loaded gear mesh."),
        Law("load_dependent_friction", lambda r, s: [np.sign(r.v) * np.abs(r.load) * d for d in (r.load * r.v > 0, r.load * r.v < 0)],
            2, lambda c, s: {"coefficient": (c[0], R), "coefficient_backdriven": (c[1], R)},
            lambda c, s: bool(np.all(c > 0) and np.all(c < 1)), holds=("load_dependent_friction",), form="two_directions", loaded=True,
            sentence="Friction that grows with the load, by another share when the load drives the motor than when the motor drives it."),
        Law("torque_gain_droop", lambda r, s: [r.torque**3], 0,
            lambda c, s: {"coefficient_per_Nm2": (c[0], Quantity.PER_TORQUE_SQUARED)}, _positive,
            sentence="The drive gives less than it is asked for at large torques."),
        Law("time_delay", lambda r, s: [r.rate], 0, lambda c, s: {"delay_s": (c[0], Quantity.TIME)}, _positive,
            sentence="The torque acts later than it is logged; a lag of the same time cannot be told from a delay at these frequencies."),
    ]  # fmt: skip


def _shaped(row: Row, motion: Motion) -> list[Law]:
    """Laws with a shape, whose grid follows from the motion of the joint."""
    T = Quantity.TORQUE
    rms, travel, span = float(np.sqrt(np.mean(row.v**2))), float(np.ptp(row.q)), float(np.ptp(row.t))
    fastest = float(np.max(np.abs(row.v)))
    return [
        Law("stribeck_friction", lambda r, s: [np.sign(r.v), np.sign(r.v) * np.exp(-((r.v / s) ** 2))], 2,
            lambda c, s: {"torque_Nm": (c[0], T), "extra_static_torque_Nm": (c[1], T),
                          "stribeck_velocity_rad_s": (s, Quantity.VELOCITY)},
            _positive, tuple(rms * x for x in (0.05, 0.1, 0.2, 0.4, 0.8)), ("coulomb_friction",), dry=True, shape_name="stribeck_velocity_rad_s",
            limits=(0.02 * rms, fastest), sentence="Friction that is higher near standstill and falls with speed."),
        Law("sublinear_viscous_friction", lambda r, s: [np.sign(r.v) * np.abs(r.v) ** s], 2,
            lambda c, s: {"coefficient": (c[0], Quantity.DAMPING), "exponent": (s, Quantity.RATIO)}, _positive,
            (0.3, 0.5, 0.7), shape_name="exponent", limits=(0.1, 0.9),
            sentence="Friction that grows less than in proportion to the speed."),
        Law("friction_drift", lambda r, s: [np.sign(r.v), np.sign(r.v) * np.exp(-r.t / s)], 2,
            lambda c, s: {"torque_Nm": (c[0], T), "relative_change": (c[1] / c[0], Quantity.RATIO), "time_constant_s": (s, Quantity.TIME)},
            lambda c, s: c[0] > 0 and -0.9 * c[0] < c[1] < 2 * c[0], tuple(span * x for x in (0.4, 1.0)), ("coulomb_friction",), dry=True,
            shape_name="time_constant_s", limits=(0.3 * span, 3.0 * span),
            sentence="Dry friction that changes while the robot warms up."),
        Law("presliding_friction", lambda r, s: [_dahl(r.q, s)], 2,
            lambda c, s: {"torque_Nm": (c[0], T), "stiffness_Nm_rad": (c[0] / s, Quantity.STIFFNESS)}, _positive,
            tuple(travel * x for x in (0.002, 0.005, 0.01, 0.03, 0.1)), ("coulomb_friction",), dry=True, shape_name="deflection",
            limits=(0.001 * travel, 0.3 * travel), sentence="Dry friction that builds up over a short way after each reversal."),
    ]  # fmt: skip


def _dahl(q: np.ndarray, deflection: float) -> np.ndarray:
    """Dahl's friction over its level along a path: y' = (v - |v| y) / deflection, exact between samples."""
    steps = np.diff(q) / deflection
    y = np.zeros(len(q))
    for i, step in enumerate(steps):
        y[i + 1] = np.sign(step) + (y[i] - np.sign(step)) * math.exp(-abs(step))
    return y


def _orders(row: Row, motion: Motion, gear: float) -> tuple[float, ...]:
    """Spatial frequencies [rad/rad | rad/m] that the travel can show: two periods and more, and sampled well.

    A step of 0.4 of what the travel resolves; those of the motor's turn, and its multiples, are on the grid.
    """
    travel = float(np.ptp(row.q))
    resolution = 2 * math.pi / travel
    fastest = float(np.sqrt(np.mean(row.v**2)))
    dt = float(row.t[1] - row.t[0])
    highest = math.pi / 8 / (fastest * dt)  # a period is 16 samples of the fine grid, at the rms speed: within the cutoff
    grid = np.arange(2 * resolution, min(highest, MOST_PERIODS * resolution), 0.4 * resolution)
    unit = abs(gear) if motion is Motion.HINGE else 2 * math.pi
    turns = [k * unit for k in range(1, 13) if 2 * resolution <= k * unit <= highest]
    return tuple(np.unique(np.concatenate([grid, turns])).tolist())


def _position(row: Row, motion: Motion, gear: float) -> list[Law]:
    """Laws that are locked to the position."""
    T, R = Quantity.TORQUE, Quantity.RATIO
    orders = _orders(row, motion, gear)
    unit = abs(gear) if motion is Motion.HINGE else 1.0
    low, high = float(np.min(row.q)), float(np.max(row.q))

    def chebyshev(q: np.ndarray) -> list[np.ndarray]:
        x = (2 * q - low - high) / (high - low)
        return [np.cos(k * np.arccos(np.clip(x, -1, 1))) for k in range(5)]

    laws = [
        Law("gravity_compensation_spring", lambda r, s: [r.q, np.ones_like(r.q)], 1,
            lambda c, s: {"stiffness_Nm_rad": (c[0], Quantity.STIFFNESS), "torque_Nm": (c[1], T)}, lambda c, s: c[0] > 0,
            holds=("torque_offset",), native=lambda c: {"stiffness": float(c[0]), "springref": float(-c[1] / c[0])},
            sentence="A spring at the joint: stiffness, and its torque at zero."),
        Law("cable_torque", lambda r, s: chebyshev(r.q), 1, lambda c, s: {f"coefficient_{k}": (c[k], T) for k in range(5)}, _any,
            holds=("torque_offset", "gravity_compensation_spring", "gravity_load"),
            sentence="A smooth torque of the angle (cables, hoses): coefficients of Chebyshev polynomials over the recorded travel."),
    ]  # fmt: skip
    if motion is Motion.HINGE:
        laws.append(
            Law("gravity_load", lambda r, s: [np.sin(r.q), np.cos(r.q)], 1,
                lambda c, s: dict(zip(("torque_Nm", "phase_rad"), zip(_sine(c), (T, Quantity.PHASE), strict=True), strict=True)),
                _any, sentence="A weight about the axis, which the model does not have (a tilted base)."))  # fmt: skip
    if orders:
        step = 0.4 * 2 * math.pi / (high - low)
        within = (orders[0] - step, orders[-1] + step)
        laws += [
            Law("torque_ripple", lambda r, s: [np.sin(s * r.q), np.cos(s * r.q)], 2,
                lambda c, s: {"amplitude_Nm": (_sine(c)[0], T), "cycles_per_rev": (s / unit, Quantity.CYCLES),
                              "phase_rad": (_sine(c)[1], Quantity.PHASE)},
                _any, orders, shape_name="order", limits=within, sentence="A torque locked to the angle (cogging, a gear's error)."),
            Law("position_dependent_friction",
                lambda r, s: [np.sign(r.v), np.sign(r.v) * np.sin(s * r.q), np.sign(r.v) * np.cos(s * r.q)], 2,
                lambda c, s: {"torque_Nm": (c[0], T), "relative_amplitude": (_sine(c[1:])[0] / c[0], R),
                              "cycles_per_rev": (s / unit, Quantity.CYCLES), "phase_rad": (_sine(c[1:])[1], Quantity.PHASE)},
                lambda c, s: 0 < _sine(c[1:])[0] < c[0], orders, ("coulomb_friction",), dry=True, shape_name="order", limits=within,
                sentence="Dry friction that varies over the turn."),
        ]  # fmt: skip
    return laws


def _coupled(row: Row) -> list[Law]:
    """Laws that come from another joint."""
    out = []
    for name in row.others:
        out += [
            Law("coupled_transmission", lambda r, s, k=name: [-r.others[k][1]], 0, lambda c, s: {"ratio": (c[0], Quantity.RATIO)},  # type: ignore[misc]
                _any, source=name, sentence=f"A part of the torque of {name} acts here (coupled gears)."),
            Law("coupled_transmission", lambda r, s, k=name: [np.sign(r.others[k][0]), r.others[k][0]], 2,  # type: ignore[misc]
                lambda c, s: {"torque_Nm": (c[0], Quantity.TORQUE), "viscous": (c[1], Quantity.DAMPING)}, _any, source=name,
                form="friction", sentence=f"Friction that goes with the motion of {name} (coupled gears)."),
        ]  # fmt: skip
    return out


def laws_for(row: Row, motion: Motion, gear: float, only: Sequence[str] = ()) -> tuple[Law, ...]:
    """All laws of a joint; ``row``: its signals over all estimation recordings, from which the grids follow."""
    laws = (*_plain(), *_shaped(row, motion), *_position(row, motion, gear), *_coupled(row))
    return tuple(law for law in laws if not only or law.id in only)


def identifiers() -> tuple[str, ...]:
    """Identifiers of all laws that are looked for by force."""
    x = np.linspace(-1.0, 1.0, 200)
    row = Row(x, np.cos(x), 0.01 * np.arange(200.0), x, x, x, {"": (x, x)})
    return (*dict.fromkeys(law.id for law in laws_for(row, Motion.HINGE, 10.0)), FLEXIBLE)


def law_parameters(law: Law, c: np.ndarray, shape: float, V: np.ndarray) -> dict[str, tuple[float, float, float, Quantity]]:
    """Parameters of a law as (value, ends of the 95 % interval, quantity), by the delta method.

    V: covariance of the coefficients (k,), and of the shape where the law has one. The gradient of each parameter is taken by
    central differences.
    """
    x = np.append(c, shape) if law.shape_name else np.asarray(c, float)
    k = len(c)
    out: dict[str, tuple[float, float, float, Quantity]] = {}
    for name, (value, quantity) in law.values(c, shape).items():
        gradient = np.zeros(len(x))
        for i in range(len(x)):
            step = np.zeros(len(x))
            step[i] = 1e-4 * max(abs(x[i]), 1e-3 * float(np.max(np.abs(c))))
            high, low = ((law.values(y[:k], float(y[-1]) if law.shape_name else shape)[name][0]) for y in (x + step, x - step))
            change = math.remainder(high - low, 2 * math.pi) if quantity is Quantity.PHASE else high - low
            gradient[i] = change / (2 * step[i])
        half = 1.96 * math.sqrt(max(float(gradient @ V @ gradient), 0.0))
        out[name] = float(value), float(value) - half, float(value) + half, quantity
    return out
