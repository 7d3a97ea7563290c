"""Compiled event functions: stick and slip of a body, contact of a coupling, pull of a coupling."""

from __future__ import annotations

import numpy as np

from mjsim.accurate.step import NO_PULL, _forward, _laws
from mjsim.compiled import compiled
from mjsim.effects.law import N_LOCAL
from mjsim.kernel import KIND_TWIST, _call

__all__: list[str] = []


@compiled()
def _deflection(
    f: np.ndarray, el: np.ndarray, p: np.ndarray, x: np.ndarray, j: int, t: float, z: np.ndarray
) -> float:  # pragma: no cover
    """Deflection of a coupling, its kinematic error included."""
    d = f[2, j] * x[0, j] - x[0, j + 1]
    for e in range(el.shape[0]):
        if el[e, 0] == KIND_TWIST and el[e, 1] == j:
            z[0], z[1], z[2], z[5] = t, x[0, j], x[1, j], x[0, j]
            _call(el[e, 2], z.ctypes.data, p.ctypes.data + 8 * el[e, 3], z.ctypes.data + 8 * N_LOCAL)
            d += z[8]
    return d


@compiled()
def _margin(
    ev: int, mj: np.ndarray, f: np.ndarray, gap_law: int, gain: float, el: np.ndarray, p: np.ndarray, x: np.ndarray, t: float,
    u: float, mode: np.ndarray, level: np.ndarray, slope: np.ndarray, torque: np.ndarray, z: np.ndarray, extra: np.ndarray,
    qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray, smooth: np.ndarray, applied: np.ndarray, armature: np.ndarray,
    m0: np.ndarray,
) -> float:  # pragma: no cover  # fmt: skip
    """One event function, positive while its mode holds: stick / slip of a body, contact of a coupling, pull of a coupling."""
    n = f.shape[1]
    if ev < n:
        if mode[2, ev] == 0:
            return 1.0
        if mode[0, ev] != 0:
            return mode[0, ev] * x[1, ev]
        _forward(
            mj, f, gap_law, gain, el, p, x, t, u, mode, level, slope, torque, z, extra, qpos, qvel, ctrl, applied, armature, m0
        )
        return min(level[0, ev] - smooth[ev], smooth[ev] + level[1, ev])
    j = (ev - n) % n
    if j == n - 1 or f[5, j] <= 0.0:
        return 1.0
    side = 1.0 if mode[1, j] > 0 else -1.0
    if ev < 2 * n:
        d = _deflection(f, el, p, x, j, t, z)
        return side * d - f[5, j] if mode[1, j] != 0 else f[5, j] - abs(d)
    if gap_law != NO_PULL or mode[1, j] == 0:
        return 1.0
    _laws(f, gap_law, gain, el, p, x, t, u, mode, applied, extra, level, slope, torque, z)
    return side * torque[j] if abs(mode[1, j]) == 1 else -side * torque[j]


@compiled()
def _margins(
    mj: np.ndarray, f: np.ndarray, gap_law: int, gain: float, el: np.ndarray, p: np.ndarray, x: np.ndarray, t: float, u: float,
    mode: np.ndarray, level: np.ndarray, slope: np.ndarray, torque: np.ndarray, z: np.ndarray, extra: np.ndarray,
    qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray, smooth: np.ndarray, applied: np.ndarray, armature: np.ndarray,
    m0: np.ndarray, out: np.ndarray,
) -> None:  # pragma: no cover  # fmt: skip
    """All event functions."""
    for ev in range(3 * f.shape[1]):
        out[ev] = _margin(
            ev, mj, f, gap_law, gain, el, p, x, t, u, mode, level, slope, torque, z, extra, qpos, qvel, ctrl, smooth, applied,
            armature, m0,
        )  # fmt: skip
