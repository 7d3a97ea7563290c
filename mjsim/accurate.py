"""The accurate MuJoCo runner: MuJoCo steps an axis natively, and its step is cut so that it lands on every event.

The axis is laid out as MuJoCo likes it best: each body on its own joint in its own units, each coupling a fixed tendon with
native stiffness and damping, the torque a native motor, RK4. Between events nothing but MuJoCo acts. At an event
`opt.timestep` is varied until the step ends on it; then the mode is switched in the model: the spring reference, stiffness and
damping of the tendon (contact, gap, and the backlash law that the axis names), the mass of a body that sticks. So static
friction with a peak and the 1999 gated backlash law hold, which plain MJCF cannot express.

Laws that MJCF lacks are called by address at each of the four stages, with MuJoCo's forward dynamics giving the acceleration
(``qfrc_applied`` and the mass matrix carry them), so they are of fourth order too; no global callback is set. The loop is
compiled and calls `mj_step` and `mj_forward` in MuJoCo's own library without the GIL: threads do not wait for one another.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from mjsim.axis import Axis
from mjsim.compiled import compiled
from mjsim.effects.base import need_torque_input
from mjsim.effects.law import N_LOCAL
from mjsim.kernel import KIND_BODY, KIND_COUPLING, KIND_FRICTION, KIND_TWIST, _call, _dips
from mjsim.mjcf.compile import caught_warnings
from mjsim.ode import DivergedError, Trajectory, _sense, apply_input
from mjsim.quantity import Motion
from mjsim.system import System, assemble

__all__ = ["Twin", "simulate", "twin", "twin_xml"]

GATED, UNGATED, NO_PULL = 0, 1, 2
HELD = 1e20  # mass of a body that sticks: its acceleration is zero to rounding
MAX_EVENTS = 256  # per sample


@intrinsic
def _call_pair(typingctx, address, m, d):  # pragma: no cover
    """Call a C function ``void(const mjModel*, mjData*)`` at an address."""
    sig = types.void(types.int64, types.int64, types.int64)

    def codegen(context, builder, signature, args):
        pointer = ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        target = builder.inttoptr(args[0], function.as_pointer())
        builder.call(target, [builder.inttoptr(a, pointer) for a in args[1:]])
        return context.get_dummy_value()

    return sig, codegen


_mj: Any = _call_pair


def twin_xml(system: System) -> str:
    """The axis as MJCF in absolute coordinates: bodies side by side, couplings as fixed tendons; no effects."""
    chain = system.chain
    joint = "hinge" if chain.motion is Motion.HINGE else "slide"
    bodies, tendons = [], []
    for i, b in enumerate(chain.bodies):
        size = f'mass="1" diaginertia="{b.inertia!r} {b.inertia!r} {b.inertia!r}"'
        if chain.motion is Motion.SLIDE:
            size = f'mass="{b.inertia!r}" diaginertia="1 1 1"'
        bodies.append(
            f'    <body name="b{i}"><joint name="j{i}" type="{joint}" axis="0 0 1" damping="{b.viscous!r}"/>'
            f'<inertial pos="0 0 0" {size}/></body>'
        )
    for j, c in enumerate(chain.couplings):
        tendons.append(
            f'    <fixed name="t{j}" stiffness="{c.stiffness!r}" damping="{c.damping!r}" springlength="0">'
            f'<joint joint="j{j}" coef="{c.ratio!r}"/><joint joint="j{j + 1}" coef="-1"/></fixed>'
        )
    return "\n".join(
        [
            '<mujoco model="twin">',
            '  <compiler angle="radian" boundmass="0" boundinertia="0" balanceinertia="false"/>',
            '  <option integrator="RK4" gravity="0 0 0" jacobian="dense">',
            '    <flag contact="disable" constraint="disable" autoreset="disable"/>',
            "  </option>",
            "  <worldbody>",
            *bodies,
            "  </worldbody>",
            "  <tendon>" if tendons else "",
            *tendons,
            "  </tendon>" if tendons else "",
            f'  <actuator><motor name="u" joint="j0" gear="{chain.gain!r}"/></actuator>',
            "</mujoco>",
        ]
    )


@dataclass(frozen=True)
class Twin:
    """A compiled twin, its data, and views into the fields that a run switches or reads."""

    model: mujoco.MjModel
    data: mujoco.MjData
    timestep: np.ndarray
    tendon: np.ndarray
    step: int
    forward: int


def twin(system: System) -> Twin:
    """Compile the twin of an axis. Every run owns one, so runs do not share state."""
    model = mujoco.MjModel.from_xml_string(twin_xml(system))
    data = mujoco.MjData(model)
    nominal = np.zeros((2, max(1, model.ntendon)))
    nominal[0, : model.ntendon], nominal[1, : model.ntendon] = model.tendon_stiffness, model.tendon_damping
    step, forward = _entry_points()
    return Twin(model, data, _timestep(model), nominal, step, forward)


@cache
def _entry_points() -> tuple[int, int]:
    """Addresses of mj_step and mj_forward in the library that the bindings have loaded."""
    folder = Path(mujoco.__file__).parent
    found = [p for pattern in ("libmujoco*.so*", "libmujoco*.dylib", "mujoco.dll") for p in sorted(folder.glob(pattern))]
    if not found:
        raise ImportError(f"no MuJoCo library in {folder}; install mujoco anew")
    library = ctypes.CDLL(str(found[0]))
    addresses = [ctypes.cast(getattr(library, name), ctypes.c_void_p).value for name in ("mj_step", "mj_forward")]
    assert addresses[0] is not None
    assert addresses[1] is not None
    return addresses[0], addresses[1]


@cache
def _timestep_offset() -> int:
    """Bytes from the start of an mjModel to opt.timestep, looked for by value: no layout of a version is assumed."""
    model = mujoco.MjModel.from_xml_string('<mujoco><option timestep="0.123456789"/></mujoco>')
    raw = (ctypes.c_double * 512).from_address(model._address)  # the sizes and mjOption stand at the head of the struct
    for i, first in enumerate(list(raw)):
        if first == 0.123456789:
            model.opt.timestep = 0.25
            if raw[i] == 0.25:
                return 8 * i
            model.opt.timestep = 0.123456789
    raise ImportError(f"opt.timestep is not where it is expected in mujoco {mujoco.__version__}; simgap needs 4.0")


def _timestep(model: mujoco.MjModel) -> np.ndarray:
    """A view of opt.timestep, which the bindings give as a number only."""
    return np.ctypeslib.as_array((ctypes.c_double * 1).from_address(model._address + _timestep_offset()))


@compiled()
def _laws(f, gap_law, el, p, x, t, u, mode, applied, extra, level, slope, torque, z):  # pragma: no cover
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
        z[4] = 0.0
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
def _mass(f, mode, extra, armature, m0):  # pragma: no cover
    """The mass matrix's diagonal: bodies at rest are held. MuJoCo takes dof_M0 for simple bodies, the armature for others."""
    for i in range(f.shape[1]):
        armature[i] = HELD if mode[0, i] == 0 else extra[i]
        m0[i] = f[0, i] + armature[i]


@compiled()
def _switch(f, gap_law, nominal, mode, stiffness, damping, reference):  # pragma: no cover
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
    mj, f, gap_law, el, p, x, t, u, mode, level, slope, torque, z, extra, qpos, qvel, ctrl, applied, armature, m0
):  # pragma: no cover
    """MuJoCo's forward dynamics at a state, laws included."""
    n = f.shape[1]
    _laws(f, gap_law, el, p, x, t, u, mode, applied, extra, level, slope, torque, z)
    _mass(f, mode, extra, armature, m0)
    for i in range(n):
        qpos[i] = x[0, i]
        qvel[i] = x[1, i]
    ctrl[0] = u
    _mj(mj[3], mj[0], mj[1])


@compiled()
def _advance(
    mj, staged, f, gap_law, el, p, x, xn, h, t, u, lag, tau, n_s, mode, level, slope, torque, z, extra, wk,
    qpos, qvel, qacc, ctrl, applied, armature, m0, timestep,
):  # pragma: no cover  # fmt: skip
    """One step of length h from x to xn: mj_step, or where laws act its four stages around mj_forward."""
    n = f.shape[1]
    if not staged:
        _laws(f, gap_law, el, p, x, t, u, mode, applied, extra, level, slope, torque, z)
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
def _flow(s, alpha, beta, h):  # pragma: no cover
    """Exact flow of s' = alpha - beta s over h."""
    e = beta * h
    if e < 1e-7:
        return s + alpha * h * (1.0 - 0.5 * e) - s * e
    return s * np.exp(-e) - alpha * np.expm1(-e) / beta


@compiled()
def _run(
    mj, staged, f, gap_law, gain, el, p, has_friction, nominal, u, dt, shift, split, before, tau, n_sub, x0, s0, t0, out,
    qpos, qvel, qacc, smooth, ctrl, applied, armature, m0, stiffness, damping, reference, timestep,
):  # pragma: no cover  # fmt: skip
    """Free run; out (N, 2n + n-1): q, v, coupling torques. mj: addresses of model, data, mj_step, mj_forward.

    Returns (status, sample): 0 done, 1 diverged at that sample.
    """
    n, n_s = f.shape[1], s0.shape[0]
    m = max(n, n_s, 1)
    x, xn, xt = np.zeros((3, m)), np.zeros((3, m)), np.zeros((3, m))
    wk, z = np.zeros((16, m)), np.zeros(N_LOCAL + 3)
    level, slope, torque, extra = np.zeros((2, n)), np.zeros((3, m)), np.zeros(n), np.zeros(n)
    mode = np.zeros((3, n), np.int64)
    for i in range(n):
        x[0, i], x[1, i] = x0[0, i], x0[1, i]
        mode[0, i] = 1
        if has_friction[i]:
            mode[2, i] = 1
            mode[0, i] = 1 if x[1, i] > 0 else (-1 if x[1, i] < 0 else 0)
    for i in range(n_s):
        x[2, i] = s0[i]
    eventful = False
    for j in range(n):
        eventful = eventful or has_friction[j] or f[5, j] > 0.0
    for j in range(n - 1):
        if f[5, j] > 0.0:
            d = _deflection(f, el, p, x, j, t0, z)
            mode[1, j] = 1 if d > f[5, j] else (-1 if d < -f[5, j] else 0)
    _switch(f, gap_law, nominal, mode, stiffness, damping, reference)
    total, lag = u.shape[0], before
    n_margin = 3 * n
    g1 = np.zeros(n_margin)
    stride = np.zeros(n)
    for k in range(total):
        t = t0 + k * dt
        for i in range(n):
            out[k, i], out[k, n + i] = x[0, i], x[1, i]
        if eventful or staged:
            _laws(f, gap_law, el, p, x, t, u[k], mode, applied, extra, level, slope, torque, z)
            for j in range(n - 1):
                out[k, 2 * n + j] = 0.0 if abs(mode[1, j]) == 2 else torque[j]
        else:
            for j in range(n - 1):
                out[k, 2 * n + j] = f[3, j] * (f[2, j] * x[0, j] - x[0, j + 1]) + f[4, j] * (f[2, j] * x[1, j] - x[1, j + 1])
        if not np.isfinite(x[1, 0]) or abs(x[1, 0]) > 1e9:
            return 1, k
        if k == total - 1:
            break
        events = 0
        for seg in range(2):
            span = split * dt if seg == 0 else (1.0 - split) * dt
            if span <= 0.0:
                continue
            kk = k - shift - 1 if seg == 0 else k - shift
            uk = u[kk] if kk >= 0 else before
            sub = max(1, int(np.ceil(n_sub * span / dt - 1e-9)))
            for _sub in range(sub):
                left = span / sub
                skip = -1
                while left > 0.0:
                    # bodies at rest: stick or slide under the torques of this instant
                    for i in range(n):
                        if mode[2, i] == 1 and x[1, i] == 0.0 and i != skip:
                            mode[0, i] = 0
                            _forward(
                                mj, f, gap_law, el, p, x, t, lag if tau > 0.0 else uk, mode, level, slope, torque, z, extra,
                                qpos, qvel, ctrl, applied, armature, m0,
                            )  # fmt: skip
                            if smooth[i] > level[0, i]:
                                mode[0, i] = 1
                            elif smooth[i] < -level[1, i]:
                                mode[0, i] = -1
                    h, hit = left, -1
                    low = h
                    for attempt in range(2):
                        # attempt 0: the whole remaining step; 1: only to where a velocity seems to dip below zero inside it
                        reach = h if attempt == 0 else low
                        ahead = xn if attempt == 0 else xt
                        _advance(
                            mj, staged, f, gap_law, el, p, x, ahead, reach, t, uk, lag, tau, n_s, mode, level, slope, torque, z,
                            extra, wk, qpos, qvel, qacc, ctrl, applied, armature, m0, timestep,
                        )  # fmt: skip
                        if not eventful or events >= MAX_EVENTS:
                            break
                        up = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-reach / tau)
                        _margins(
                            mj, f, gap_law, el, p, ahead, t + reach, up, mode, level, slope, torque, z, extra, qpos, qvel, ctrl,
                            smooth, applied, armature, m0, g1,
                        )  # fmt: skip
                        near = False
                        for ev in range(n_margin):
                            if g1[ev] >= 0.0:
                                if attempt == 0 and ev < n and mode[2, ev] == 1 and mode[0, ev] != 0:
                                    stride[ev] = max(stride[ev], abs(x[1, ev] - xn[1, ev]))
                                    near = near or min(abs(x[1, ev]), abs(xn[1, ev])) < 2.0 * stride[ev]
                                continue
                            lo, hi, ghi, glo = 0.0, reach, g1[ev], 1.0
                            bisect = True
                            side = 0
                            for _it in range(80):
                                if hi - lo < 1e-13 + 1e-12 * dt:
                                    break
                                mid = 0.5 * (lo + hi)
                                if not bisect:
                                    guess = (lo * ghi - hi * glo) / (ghi - glo)
                                    if guess > lo and guess < hi:
                                        mid = guess
                                _advance(
                                    mj, staged, f, gap_law, el, p, x, xt, mid, t, uk, lag, tau, n_s, mode, level, slope, torque,
                                    z, extra, wk, qpos, qvel, qacc, ctrl, applied, armature, m0, timestep,
                                )  # fmt: skip
                                um = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-mid / tau)
                                gm = _margin(
                                    ev, mj, f, gap_law, el, p, xt, t + mid, um, mode, level, slope, torque, z, extra, qpos, qvel,
                                    ctrl, smooth, applied, armature, m0,
                                )  # fmt: skip
                                if gm < 0.0:
                                    hi, ghi = mid, gm
                                    if side == -1:
                                        glo *= 0.5
                                    side = -1
                                    if gm > -1e-15:
                                        break
                                else:
                                    lo, glo, bisect = mid, gm, gm <= 0.0
                                    if side == 1:
                                        ghi *= 0.5
                                    side = 1
                            hit, reach = ev, hi
                            h = hi
                            _advance(
                                mj, staged, f, gap_law, el, p, x, xn, h, t, uk, lag, tau, n_s, mode, level, slope, torque, z,
                                extra, wk, qpos, qvel, qacc, ctrl, applied, armature, m0, timestep,
                            )  # fmt: skip
                            up = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-h / tau)
                            _margins(
                                mj, f, gap_law, el, p, xn, t + h, up, mode, level, slope, torque, z, extra, qpos, qvel, ctrl,
                                smooth, applied, armature, m0, g1,
                            )  # fmt: skip
                        if hit >= 0 or not near:
                            break
                        # the slopes at both ends, by MuJoCo's forward dynamics, tell where it could dip
                        near, low = False, h
                        for i in range(n):
                            if mode[2, i] == 0 or mode[0, i] == 0:
                                continue
                            _forward(
                                mj, f, gap_law, el, p, x, t, lag if tau > 0.0 else uk, mode, level, slope, torque, z, extra,
                                qpos, qvel, ctrl, applied, armature, m0,
                            )  # fmt: skip
                            s0 = mode[0, i] * qacc[i]
                            _forward(
                                mj, f, gap_law, el, p, xn, t + h, up, mode, level, slope, torque, z, extra, qpos, qvel, ctrl,
                                applied, armature, m0,
                            )  # fmt: skip
                            dip = _dips(mode[0, i] * x[1, i], s0, mode[0, i] * xn[1, i], mode[0, i] * qacc[i], h)
                            if dip > 0.0:
                                near, low = True, min(low, dip)
                        if not near:
                            break
                    for i in range(n):
                        x[0, i], x[1, i] = xn[0, i], xn[1, i]
                    for i in range(n_s):
                        x[2, i] = xn[2, i]
                    t += h
                    left = left - h if left - h > 1e-15 else 0.0
                    lag = uk + (lag - uk) * np.exp(-h / tau) if tau > 0.0 else uk
                    skip = -1
                    if hit < 0:
                        continue
                    events += 1
                    if hit < n:
                        if mode[0, hit] != 0:
                            x[1, hit], mode[0, hit] = 0.0, 0
                        else:
                            _forward(
                                mj, f, gap_law, el, p, x, t, lag, mode, level, slope, torque, z, extra, qpos, qvel, ctrl, applied,
                                armature, m0,
                            )  # fmt: skip
                            mode[0, hit] = 1 if smooth[hit] > 0.5 * (level[0, hit] - level[1, hit]) else -1
                            skip = hit
                    elif hit < 2 * n:
                        j = hit - n
                        if mode[1, j] != 0:
                            mode[1, j] = 0
                        else:
                            mode[1, j] = 1 if _deflection(f, el, p, x, j, t, z) > 0.0 else -1
                            if gap_law == NO_PULL:
                                _laws(f, gap_law, el, p, x, t, lag, mode, applied, extra, level, slope, torque, z)
                                if mode[1, j] * torque[j] < 0.0:
                                    mode[1, j] *= 2
                    else:
                        j = hit - 2 * n
                        mode[1, j] = mode[1, j] * 2 if abs(mode[1, j]) == 1 else mode[1, j] // 2
                    _switch(f, gap_law, nominal, mode, stiffness, damping, reference)
    return 0, total


@compiled()
def _deflection(f, el, p, x, j, t, z):  # pragma: no cover
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
    ev, mj, f, gap_law, el, p, x, t, u, mode, level, slope, torque, z, extra, qpos, qvel, ctrl, smooth, applied, armature, m0
):  # pragma: no cover
    """One event function, positive while its mode holds: stick / slip of a body, contact of a coupling, pull of a coupling."""
    n = f.shape[1]
    if ev < n:
        if mode[2, ev] == 0:
            return 1.0
        if mode[0, ev] != 0:
            return mode[0, ev] * x[1, ev]
        _forward(mj, f, gap_law, el, p, x, t, u, mode, level, slope, torque, z, extra, qpos, qvel, ctrl, applied, armature, m0)
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
    _laws(f, gap_law, el, p, x, t, u, mode, applied, extra, level, slope, torque, z)
    return side * torque[j] if abs(mode[1, j]) == 1 else -side * torque[j]


@compiled()
def _margins(
    mj, f, gap_law, el, p, x, t, u, mode, level, slope, torque, z, extra, qpos, qvel, ctrl, smooth, applied, armature, m0, out
):  # pragma: no cover
    """All event functions."""
    for ev in range(3 * f.shape[1]):
        out[ev] = _margin(
            ev, mj, f, gap_law, el, p, x, t, u, mode, level, slope, torque, z, extra, qpos, qvel, ctrl, smooth, applied,
            armature, m0,
        )  # fmt: skip


def simulate(
    axis: Axis | System,
    torque: np.ndarray,
    dt: float,
    *,
    step: float | None = None,
    initial: np.ndarray | None = None,
    before: float = 0.0,
    t0: float = 0.0,
) -> Trajectory:
    """Free-run an axis in MuJoCo on a commanded torque (N,) held over each sample of dt [s], landing on every event.

    ``step``: largest MuJoCo step [s], 0.25 ms when None; the sample time is cut into equal parts of at most that. ``initial``
    (2, n): angles and velocities at the start, at rest when None; ``before``: commanded torque ahead of the first sample.
    Raises DivergedError, NotApplicableError for a servo.
    """
    s = (axis if isinstance(axis, System) else assemble(axis)).resolved(dt)
    need_torque_input(s.chain)
    n, count = s.n, len(torque)
    mine = twin(s)
    m, d = mine.model, mine.data
    u = np.array(apply_input(s, np.asarray(torque, float)), float)
    x0 = np.zeros((2, n))
    if initial is not None:
        given = np.asarray(initial, float)
        x0[:, : given.shape[1]] = given
        for i in range(given.shape[1], n):
            x0[:, i] = s.f[2, i - 1] * x0[:, i - 1]
    delay = s.input_delay / dt
    shift = math.floor(delay + 1e-12)
    split = max(0.0, delay - shift)
    split = split if split >= 1e-9 else 0.0
    largest = 2.5e-4 if step is None else step
    speed = 100.0 if s.spatial > 0 else 0.0
    n_sub = max(math.ceil(dt / largest - 1e-9), 1 if step is not None else s.substeps(dt, speed))
    staged = s.input_lag > 0 or not s.affine
    out = np.empty((count, 2 * n + n - 1))
    address = np.array([m._address, d._address, mine.step, mine.forward], np.int64)
    with caught_warnings() as warnings:
        mujoco.mj_forward(m, d)
        status, at = _run(
            address, staged, s.f, s.gap_law, s.chain.gain, s.elements, s.parameters, s.has_friction, mine.tendon, u, dt, shift,
            split, float(before), s.input_lag, n_sub, x0, np.zeros(s.n_states), t0, out, d.qpos, d.qvel, d.qacc, d.qfrc_smooth,
            d.ctrl, d.qfrc_applied, m.dof_armature, m.dof_M0, m.tendon_stiffness, m.tendon_damping,
            m.tendon_lengthspring.reshape(-1, 2), mine.timestep,
        )  # fmt: skip
    if status or warnings:
        said = f" (MuJoCo: {warnings[0]})" if warnings else ""
        raise DivergedError(
            f"MuJoCo's run diverged at {t0 + at * dt:.4f} s, body {s.chain.bodies[0].joint!r}{said}; "
            "take a shorter step, or check signs of damping and stiffness"
        )
    time = t0 + dt * np.arange(count)
    velocity, measured = _sense(s, out[:, n], out[:, 0], dt)
    return Trajectory(
        time, np.array(torque, float), velocity.copy(), measured.copy(),
        out[:, :n].copy(), out[:, n : 2 * n].copy(), out[:, 2 * n :].copy(),
    )  # fmt: skip
