"""What the negative damping of the gearbox may stand for: is a delay an equivalent, and would a delay be taken for it?

All on exact frequency responses, flat weight over 0.5 to 30 Hz (a chirp's), error ``rms(G_hat - G) / rms(G)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lab.study.plants import nominal, response
from mjsim.axis import Axis

__all__ = ["DampingStudy", "study_damping"]

_F = np.linspace(0.5, 30.0, 119)
_FREE = ("Jm", "Jg", "Ja", "fm", "kg", "ka", "da")


@dataclass(frozen=True)
class DampingStudy:
    """What was found.

    zero_real: dg [Nms/rad] -> real part [rad/s] of the zero pair at the first notch. plain_sign_error: of turning dg's sign;
    sign_phase_band_hz: where that moves the phase by more than 45 deg, whole turns aside. without_delay, with_delay: the nearest
    axis with dg >= 0: its error, dg and delay [s]. mistaken: (delay of the robot [s], dg that a fit without delay finds, its
    error), for a robot with dg = 0. mistaken_for: delay [s] that is taken for the published dg, None when none within 5 ms is.
    spring_delay_s: delay of the spring's torque that is the same to first order, abs(dg) / kg; spring_delay_error: its error. A
    delay is positive when the velocity is logged late, negative when the torque is.
    """

    zero_real: dict[float, float]
    plain_sign_error: float
    sign_phase_band_hz: tuple[float, float]
    without_delay: dict[str, float]
    with_delay: dict[str, float]
    mistaken: tuple[tuple[float, float, float], ...]
    mistaken_for: float | None
    spring_delay_s: float
    spring_delay_error: float

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> DampingStudy:
        """From `dataclasses.asdict` that went through JSON."""
        known = dict(values)
        known["zero_real"] = {float(k): v for k, v in values["zero_real"].items()}
        low, high = values["sign_phase_band_hz"]
        known["sign_phase_band_hz"] = (low, high)
        known["mistaken"] = tuple(tuple(m) for m in values["mistaken"])
        return cls(**known)

    def to_dict(self) -> dict[str, Any]:
        """As it stands in ``claims.json``."""
        return {
            "first_notch_zero_real_by_dg": {f"{k:g}": v for k, v in self.zero_real.items()},
            "sign_turned_relative_error": self.plain_sign_error,
            "sign_turned_moves_phase_by_45_deg_within_hz": list(self.sign_phase_band_hz),
            "nearest_without_negative_damping": self.without_delay,
            "nearest_without_negative_damping_with_delay": self.with_delay,
            "dg_that_a_fit_without_delay_finds": [{"delay_s": d, "dg": g, "relative_error": e} for d, g, e in self.mistaken],
            "delay_taken_for_published_dg_s": self.mistaken_for,
            "equivalent_delay_of_the_spring_torque_s": self.spring_delay_s,
            "equivalent_delay_of_the_spring_torque_relative_error": self.spring_delay_error,
        }


def first_zero(axis: Axis) -> complex:
    """The zero pair of the first notch [rad/s], upper half plane."""
    from mjsim.system import assemble, state_matrix

    f = assemble(axis).f
    n = f.shape[1]
    keep = [i for i in range(2 * n) if i not in (0, n)]
    zeros = np.linalg.eigvals(state_matrix(f)[np.ix_(keep, keep)])  # the chain behind a motor that is held
    upper = zeros[zeros.imag > 0]
    return complex(upper[np.argmin(np.abs(upper))])


def _error(g: np.ndarray, reference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(g - reference) ** 2) / np.mean(np.abs(reference) ** 2)))


def _delayed(g: np.ndarray, seconds: float) -> np.ndarray:
    delayed: np.ndarray = g * np.exp(-2j * np.pi * _F * seconds)
    return delayed


def _fit(target: np.ndarray, dg_bounds: tuple[float, float], delay: bool, starts: tuple[float, ...]) -> dict[str, float]:
    """The axis nearest to a response: all linear parameters free within a factor of three, dg and delay within bounds."""
    from scipy.optimize import least_squares

    axis = nominal()
    first = {p.name: p.value for p in axis.chain.linear_parameters()}
    scale = float(np.sqrt(np.mean(np.abs(target) ** 2) * target.size))
    low = [-np.log(3.0)] * len(_FREE) + [dg_bounds[0] / 100, -1.0 if delay else 0.0]
    high = [np.log(3.0)] * len(_FREE) + [dg_bounds[1] / 100, 1.0 if delay else 1e-9]

    def modelled(x: np.ndarray) -> np.ndarray:
        values = {n: first[n] * float(np.exp(v)) for n, v in zip(_FREE, x, strict=False)}
        return _delayed(response(axis.with_linear({**values, "dg": 100 * float(x[-2])}), _F), float(x[-1]) * 1e-2)

    def residual(x: np.ndarray) -> np.ndarray:
        off = (modelled(x) - target) / scale
        parts: np.ndarray = np.r_[off.real, off.imag]
        return parts

    best = None
    for dg in starts:
        x0 = np.r_[np.zeros(len(_FREE)), np.clip(dg, *dg_bounds) / 100, -0.02 if delay else 0.0]
        x0 = np.clip(x0, np.array(low) + 1e-12, np.array(high) - 1e-12)
        found = least_squares(residual, x0, bounds=(low, high), x_scale=0.1, xtol=1e-10, ftol=1e-10, max_nfev=120)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return {
        "dg": 100 * float(best.x[-2]),
        "delay_s": float(best.x[-1]) * 1e-2 if delay else 0.0,
        "relative_error": _error(modelled(best.x), target),
    }


def _spring_delay(seconds: float) -> np.ndarray:
    """Response of the axis whose gearbox torque is its spring's alone, that long ago."""
    chain = nominal().chain
    w = 2 * np.pi * _F
    j = [b.inertia for b in chain.bodies]
    gear, arm = chain.couplings
    z_gear = gear.stiffness * np.exp(-1j * w * seconds)
    z_arm = arm.stiffness + 1j * w * arm.damping
    m = np.zeros((w.size, 3, 3), complex)
    r = gear.ratio
    m[:, 0, 0] = -(w**2) * j[0] + 1j * w * chain.bodies[0].viscous + r * r * z_gear
    m[:, 0, 1] = m[:, 1, 0] = -r * z_gear
    m[:, 1, 1] = -(w**2) * j[1] + z_gear + z_arm
    m[:, 1, 2] = m[:, 2, 1] = -z_arm
    m[:, 2, 2] = -(w**2) * j[2] + z_arm
    b = np.broadcast_to(np.array([1.0 + 0j, 0, 0]), (w.size, 3))[..., None]
    return np.asarray(1j * w * np.linalg.solve(m, b)[:, 0, 0])


def study_damping(quick: bool = False) -> DampingStudy:
    """Fit delays for damping and damping for delays."""
    axis = nominal()
    known = {p.name: p.value for p in axis.chain.linear_parameters()}
    published = known["dg"]
    target = response(axis, _F)
    plain = response(axis.with_linear({"dg": -published}), _F)
    fine = np.arange(8.0, 24.0, 0.01)
    turned, straight = (response(axis.with_linear({"dg": d}), fine) for d in (-published, published))
    apart = fine[np.abs(np.angle(turned / straight, deg=True)) > 45.0]
    mistaken = []
    for delay in (-2e-3, 0.0, 2e-3) if quick else (-5e-3, -4e-3, -3e-3, -2e-3, -1e-3, -0.5e-3, 0.0, 0.5e-3, 1e-3, 2e-3):
        robot = _delayed(response(axis.with_linear({"dg": 0.0}), _F), delay)
        found = _fit(robot, (-400.0, 400.0), False, (0.0,) if quick else (0.0, published))
        mistaken.append((delay, found["dg"], found["relative_error"]))
    delays, dgs = (np.array([m[i] for m in mistaken]) for i in (0, 1))
    crossing = np.flatnonzero((dgs[:-1] - published) * (dgs[1:] - published) <= 0)
    taken = None
    if crossing.size:
        i = int(crossing[0])
        taken = float(delays[i] + (published - dgs[i]) / (dgs[i + 1] - dgs[i]) * (delays[i + 1] - delays[i]))
    spring = -published / known["kg"]
    return DampingStudy(
        zero_real={d: float(first_zero(axis.with_linear({"dg": d})).real) for d in (published, 0.0, -published)},
        plain_sign_error=_error(plain, target),
        sign_phase_band_hz=(round(float(apart[0]), 2), round(float(apart[-1]), 2)),
        without_delay=_fit(target, (0.0, 400.0), False, (0.0, 62.0)),
        with_delay=_fit(target, (0.0, 400.0), True, (0.0, 62.0)),
        mistaken=tuple(mistaken),
        mistaken_for=taken,
        spring_delay_s=spring,
        spring_delay_error=_error(_spring_delay(spring), target),
    )


def second_mode_hz() -> float:
    """Natural frequency [Hz] of the second flexible mode of the nominal axis, from its poles."""
    from mjsim.system import assemble, state_matrix

    poles = np.linalg.eigvals(state_matrix(assemble(nominal()).f))
    return float(np.max(np.abs(poles[poles.imag > 0])) / (2 * np.pi))
