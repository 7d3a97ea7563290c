"""Compiled steps: what MuJoCo lacks at a state, and one step of it by MuJoCo's own functions."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from mjsim.compiled import compiled
from mjsim.effects.law import N_LOCAL
from mjsim.kernel import KIND_BODY, KIND_COUPLING, KIND_FRICTION, KIND_TWIST, _call

__all__ = ["NO_PULL", "UNGATED"]

UNGATED, NO_PULL = 1, 2  # backlash laws; 0 is gated
HELD = 1e20  # mass of a body that sticks: its acceleration is zero to rounding


@intrinsic
def _call_pair(typingctx: Any, address: Any, m: Any, d: Any) -> Any:  # pragma: no cover
    """Call a C function ``void(const mjModel*, mjData*)`` at an address."""
    sig = types.void(types.int64, types.int64, types.int64)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        target = builder.inttoptr(args[0], function.as_pointer())
        builder.call(target, [builder.inttoptr(a, pointer) for a in args[1:]])
        return context.get_dummy_value()

    return sig, codegen


_mj: Any = _call_pair


@compiled()
def _laws(
    f: np.ndarray, gap_law: int, gain: float, el: np.ndarray, p: np.ndarray, x: np.ndarray, t: float, u: float, mode: np.ndarray,
    applied: np.ndarray, extra: np.ndarray, level: np.ndarray, slope: np.ndarray, torque: np.ndarray, z: np.ndarray
) -> None:  # pragma: no cover  # fmt: skip
    """What MuJoCo lacks at one state: torques (n) beside the native ones, change of mass (n), internal rates in slope rows 1, 2.

    level (2, n): breakaway levels of bodies at rest; slope (3, m): kinematic slopes of the couplings, then alpha and beta of
    the internal states; torque (n): torques of the couplings, before the no-pull law clamps them.
    """
    n = f.shape[1]
    za, pa = z.ctypes.data, p.ctypes.data
    oa = za + 8 * N_LOCAL
    for i in range(n):
        applied[i] = 0.0
        extra[i] = 0.0
        level[0, i] = 0.0
        level[1, i] = 0.0
        torque[i] = 0.0
        slope[0, i] = f[2, i]
    for j in range(n - 1):
        r, k, c, half = f[2, j], f[3, j], f[4, j], f[5, j]
        error, ratio = 0.0, r
        for e in range(el.shape[0]):
            if el[e, 0] == KIND_TWIST and el[e, 1] == j:
                z[0], z[1], z[2], z[5] = t, x[0, j], x[1, j], x[0, j]
                _call(el[e, 2], za, pa + 8 * el[e, 3], oa)
                error += z[8]
                ratio += z[9]
        slope[0, j] = ratio
        side = 0 if mode[1, j] == 0 else (1 if mode[1, j] > 0 else -1)
        joined = half <= 0.0 or side != 0
        d = r * x[0, j] - x[0, j + 1]
        rate = r * x[1, j] - x[1, j + 1]
        bent = d + error - side * half if half > 0.0 else d + error
        bent_rate = ratio * x[1, j] - x[1, j + 1]
        native, whole = 0.0, 0.0
        if joined:
            native = k * (d - side * half if half > 0.0 else d) + c * rate
            whole = k * bent + c * bent_rate
        elif gap_law == UNGATED:
            native = c * rate
            whole = c * bent_rate
        for e in range(el.shape[0]):
            if el[e, 0] == KIND_COUPLING and el[e, 1] == j:
                si = el[e, 4]
                z[0], z[1], z[2], z[5] = t, bent if joined else 0.0, bent_rate if joined else 0.0, x[0, j]
                z[7] = x[2, si] if si >= 0 else 0.0
                _call(el[e, 2], za, pa + 8 * el[e, 3], oa)
                if joined:
                    whole += z[8]
                if si >= 0:
                    slope[1, si] = z[9]
                    slope[2, si] = z[10]
        torque[j] = whole
        if abs(mode[1, j]) == 2:
            native, whole = 0.0, 0.0
        applied[j + 1] += whole - native
        applied[j] -= ratio * whole - r * native
    for e in range(el.shape[0]):
        kind, i, si = el[e, 0], el[e, 1], el[e, 4]
        if kind < KIND_BODY:
            continue
        if el[e, 2] == 0:  # friction of constant levels
            first = el[e, 3]
            if mode[0, i] == 0:
                level[0, i] += p[first + 2]
                level[1, i] += p[first + 3]
            else:
                applied[i] -= mode[0, i] * p[first + (0 if mode[0, i] > 0 else 1)]
            continue
        z[0], z[1], z[2], z[3], z[5], z[6] = t, x[0, i], x[1, i], mode[0, i], x[0, i], u
        z[4] = gain * u
        if n > 1:
            j = 0 if i == 0 else i - 1
            z[4] = 0.0 if abs(mode[1, j]) == 2 else (slope[0, 0] * torque[0] if i == 0 else torque[j])
        z[7] = x[2, si] if si >= 0 else 0.0
        if kind == KIND_FRICTION and mode[0, i] == 0:
            z[2] = 0.0
            for row in range(2):
                z[3] = 1.0 - 2.0 * row
                _call(el[e, 2], za, pa + 8 * el[e, 3], oa)
                level[row, i] += z[9]
            continue
        _call(el[e, 2], za, pa + 8 * el[e, 3], oa)
        if kind == KIND_FRICTION:
            applied[i] -= mode[0, i] * z[8]
        elif kind == KIND_BODY:
            applied[i] += z[8]
            if si >= 0:
                slope[1, si] = z[9]
                slope[2, si] = z[10]
        else:
            extra[i] += f[0, i] * z[8]
            applied[i] -= 0.5 * f[0, i] * z[9] * x[1, i] * x[1, i]


@compiled(inline="always")
def _mass(f: np.ndarray, mode: np.ndarray, extra: np.ndarray, armature: np.ndarray, m0: np.ndarray) -> None:  # pragma: no cover
    """The mass matrix's diagonal: bodies at rest are held. MuJoCo takes dof_M0 for simple bodies, the armature for others."""
    for i in range(f.shape[1]):
        armature[i] = HELD if mode[0, i] == 0 else extra[i]
        m0[i] = f[0, i] + armature[i]


@compiled()
def _switch(
    f: np.ndarray, gap_law: int, nominal: np.ndarray, mode: np.ndarray, stiffness: np.ndarray, damping: np.ndarray,
    reference: np.ndarray
) -> None:  # pragma: no cover  # fmt: skip
    """The couplings' mode in the model: stiffness, damping and spring reference of their tendons."""
    for j in range(f.shape[1] - 1):
        half, gap = f[5, j], mode[1, j]
        if half <= 0.0:
            continue
        side = 0 if gap == 0 else (1 if gap > 0 else -1)
        on = abs(gap) == 1
        stiffness[j] = nominal[0, j] if on else 0.0
        damping[j] = nominal[1, j] if on or (gap == 0 and gap_law == UNGATED) else 0.0
        reference[j, 0] = side * half
        reference[j, 1] = side * half


@compiled()
def _forward(
    mj: np.ndarray, f: np.ndarray, gap_law: int, gain: float, el: np.ndarray, p: np.ndarray, x: np.ndarray, t: float, u: float,
    mode: np.ndarray, level: np.ndarray, slope: np.ndarray, torque: np.ndarray, z: np.ndarray, extra: np.ndarray,
    qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray, applied: np.ndarray, armature: np.ndarray, m0: np.ndarray
) -> None:  # pragma: no cover  # fmt: skip
    """MuJoCo's forward dynamics at a state, laws included."""
    n = f.shape[1]
    _laws(f, gap_law, gain, el, p, x, t, u, mode, applied, extra, level, slope, torque, z)
    _mass(f, mode, extra, armature, m0)
    for i in range(n):
        qpos[i] = x[0, i]
        qvel[i] = x[1, i]
    ctrl[0] = u
    _mj(mj[3], mj[0], mj[1])


@compiled()
def _advance(
    mj: np.ndarray, staged: bool, f: np.ndarray, gap_law: int, gain: float, el: np.ndarray, p: np.ndarray, x: np.ndarray,
    xn: np.ndarray, h: float, t: float, u: float, lag: float, tau: float, n_s: int, mode: np.ndarray, level: np.ndarray,
    slope: np.ndarray, torque: np.ndarray, z: np.ndarray, extra: np.ndarray, wk: np.ndarray, qpos: np.ndarray, qvel: np.ndarray,
    qacc: np.ndarray, ctrl: np.ndarray, applied: np.ndarray, armature: np.ndarray, m0: np.ndarray, timestep: np.ndarray
) -> None:  # pragma: no cover  # fmt: skip
    """One step of length h from x to xn: mj_step, or where laws act its four stages around mj_forward."""
    n = f.shape[1]
    if not staged:
        _laws(f, gap_law, gain, el, p, x, t, u, mode, applied, extra, level, slope, torque, z)
        _mass(f, mode, extra, armature, m0)
        for i in range(n):
            qpos[i] = x[0, i]
            qvel[i] = x[1, i]
        ctrl[0] = u
        timestep[0] = h
        _mj(mj[2], mj[0], mj[1])
        for i in range(n):
            xn[0, i] = qpos[i] if mode[0, i] != 0 else x[0, i]
            xn[1, i] = qvel[i] if mode[0, i] != 0 else x[1, i]
        return
    for stage in range(4):
        c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        b = 4 * (stage - 1)
        for i in range(n):
            xn[0, i] = x[0, i] + (c * h * wk[b, i] if stage > 0 else 0.0)
            xn[1, i] = x[1, i] + (c * h * wk[b + 1, i] if stage > 0 else 0.0)
        for i in range(n_s):
            xn[2, i] = x[2, i] if stage == 0 else _flow(x[2, i], wk[b + 2, i], wk[b + 3, i], c * h)
        ut = u if tau <= 0.0 else u + (lag - u) * np.exp(-c * h / tau)
        _forward(
            mj,
            f,
            gap_law,
            gain,
            el,
            p,
            xn,
            t + c * h,
            ut,
            mode,
            level,
            slope,
            torque,
            z,
            extra,
            qpos,
            qvel,
            ctrl,
            applied,
            armature,
            m0,
        )
        b = 4 * stage
        for i in range(n):
            wk[b, i] = xn[1, i]
            wk[b + 1, i] = qacc[i] if mode[0, i] != 0 else 0.0
        for i in range(n_s):
            wk[b + 2, i] = slope[1, i]
            wk[b + 3, i] = slope[2, i]
    for i in range(n):
        xn[0, i] = x[0, i] + h / 6.0 * (wk[0, i] + 2.0 * wk[4, i] + 2.0 * wk[8, i] + wk[12, i])
        xn[1, i] = x[1, i] + h / 6.0 * (wk[1, i] + 2.0 * wk[5, i] + 2.0 * wk[9, i] + wk[13, i])
    for i in range(n_s):
        alpha = (wk[2, i] + 2.0 * wk[6, i] + 2.0 * wk[10, i] + wk[14, i]) / 6.0
        beta = (wk[3, i] + 2.0 * wk[7, i] + 2.0 * wk[11, i] + wk[15, i]) / 6.0
        xn[2, i] = _flow(x[2, i], alpha, beta, h)


@compiled()
def _flow(s: float, alpha: float, beta: float, h: float) -> float:  # pragma: no cover
    """Exact flow of s' = alpha - beta s over h."""
    e = beta * h
    if e < 1e-7:
        return s + alpha * h * (1.0 - 0.5 * e) - s * e
    return s * np.exp(-e) - alpha * np.expm1(-e) / beta
