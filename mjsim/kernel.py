"""The compiled ODE kernel: fourth-order Runge-Kutta with located events, for any chain and any set of ports.

Between events the equations of `mjsim.effects.ports` are smooth and RK4 is accurate to (h w)^4; stick, slip and contact are
located to rounding and switch modes, so that neither friction nor backlash smears over a step and a fitted cost is smooth
in the parameters. Laws are called by address (`mjsim.effects.law`), so that one compiled kernel serves all effects.

Where the axis is affine between events (``affine``), a whole step is one product with the matrix exponential of the mode, kept
for each mode that occurs; the matrices are read off the same rates, and RK4 only lands on events.

``bodies``: n zeros; the length of a tuple is a constant of the compiled code, so that every loop over bodies unrolls; an array of
any length has one code (`mjsim.system.UNROLLED`).
Modes: friction of body i: -1, +1 slip, 0 stick; gap of coupling j: -1, +1 contact, 0 open. Arrays (n bodies):
``f`` (6, n): inertia, viscous; of the coupling behind each body ratio, stiffness, damping, half gap. ``el`` (n_el, 7)
integer: kind, site, law address (0: friction of constant levels, which are its parameters: sliding and breakaway, each forward
and backward; kind 5: soft friction, its parameters impedance,
rate and both levels; kind 6: soft limits of body 0, `mjsim.chain.Limit`), first parameter, state index or -1, whether it sees
the model's own angle, whether it is a torque of the drive. ``p``: parameters.
``servo`` (6): of the drive at body 0, in its torques: stiffness and damping towards the input, force limit, stall torque, its
loss per speed, half dead band (`mjsim.system.System.servo`); a drive by torque has none of them.
``mode`` (6, n): friction mode, gap mode, whether the body has friction; of body 0 only: side of the force limit at which the
drive stands (0: none), side of the dead band (0: inside), side of the joint limit that it is beyond (0: within
both). ``z``: local quantities of a law and, behind them, what it writes. ``x`` (3, m): q, v, internal states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from mjsim.compiled import compiled
from mjsim.effects.law import N_LOCAL
from mjsim.system import SLIDES, TURNS

__all__ = ["KIND_BODY", "KIND_COUPLING", "KIND_FRICTION", "KIND_INERTIA", "KIND_TWIST", "drive", "integrate"]

KIND_TWIST, KIND_COUPLING, KIND_BODY, KIND_INERTIA, KIND_FRICTION, KIND_SOFT, KIND_LIMIT = 0, 1, 2, 3, 4, 5, 6
GATED, UNGATED, NO_PULL = 0, 1, 2
SLOTS = 61  # modes whose propagators are kept at a time
MAX_EVENTS = 64  # per sample; past that the step is taken as it is (chatter)
MAX_ROUNDS = 20  # of the input whose own torque laws see, in inverse dynamics of one body
SAME = 1e-12  # relative change at which that input is found
STEADY = 0.01  # relative change of how far a sliding bristle is bent, past which a step is cut after all


@intrinsic
def _call_law(typingctx: Any, address: Any, z: Any, p: Any, out: Any) -> Any:  # pragma: no cover
    """Call the law at an address on three addresses."""
    sig = types.void(types.int64, types.int64, types.int64, types.int64)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.VoidType(), [pointer, pointer, pointer])
        target = builder.inttoptr(args[0], function.as_pointer())
        builder.call(target, [builder.inttoptr(a, pointer) for a in args[1:]])
        return context.get_dummy_value()

    return sig, codegen


_call: Any = _call_law


@intrinsic
def _view_of(typingctx: Any, array: Any) -> Any:  # pragma: no cover
    """The array without a count of its references, which every call that hands it on would raise and lower."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, args[0])
        view.meminfo = cgutils.get_null_value(view.meminfo.type)
        view.parent = cgutils.get_null_value(view.parent.type)
        return view._getvalue()

    return array(array), codegen


_view: Any = _view_of


def _bound_of(servo: np.ndarray, side: int, v: float) -> float:
    """Largest torque of the drive towards a side (-1, +1) at a velocity: the force limit and the torque-speed line."""
    return min(servo[2], servo[3] - side * servo[4] * v)


_bound: Any = compiled(error_model="numpy", forceinline=True)(_bound_of)


def _error_of(servo: np.ndarray, gain: float, u: float, q: float) -> float:
    """Torque that the input asks for through the stiffness, ahead of the dead band."""
    return gain * u - servo[0] * q


_error: Any = compiled(error_model="numpy", forceinline=True)(_error_of)


def _asked_of(servo: np.ndarray, gain: float, u: float, q: float, v: float, mode: np.ndarray) -> float:
    """Torque that the drive asks for, ahead of its limits."""
    pull = _error(servo, gain, u, q)
    if servo[5] > 0.0:
        pull = 0.0 if mode[4, 0] == 0 else pull - mode[4, 0] * servo[5]
    return pull - servo[1] * v


_asked: Any = compiled(error_model="numpy", forceinline=True)(_asked_of)


def _pull_of(servo: np.ndarray, gain: float, u: float, q: float, v: float, mode: np.ndarray) -> float:
    """Torque of the drive on body 0."""
    side = mode[3, 0]
    if side != 0:
        return side * _bound(servo, side, v)
    return _asked(servo, gain, u, q, v, mode)


_pull: Any = compiled(error_model="numpy", forceinline=True)(_pull_of)


@compiled(error_model="numpy")
def _choose_sides(servo: np.ndarray, gain: float, u: float, q: float, v: float, mode: np.ndarray) -> None:
    """Set the sides of dead band and force limit after the input jumped."""
    if servo[5] > 0.0:
        e = _error(servo, gain, u, q)
        mode[4, 0] = 1 if e > servo[5] else (-1 if e < -servo[5] else 0)
    d = _asked(servo, gain, u, q, v, mode)
    mode[3, 0] = 1 if d > _bound(servo, 1, v) else (-1 if d < -_bound(servo, -1, v) else 0)


@compiled(error_model="numpy")
def _drive_margin(which: int, servo: np.ndarray, gain: float, u: float, q: float, v: float, mode: np.ndarray) -> float:
    """Positive while the drive keeps its side of the force limit (0) or of the dead band (1)."""
    if which == 1:
        e = _error(servo, gain, u, q)
        return servo[5] - abs(e) if mode[4, 0] == 0 else mode[4, 0] * e - servo[5]
    d = _asked(servo, gain, u, q, v, mode)
    side = mode[3, 0]
    if side != 0:
        return side * d - _bound(servo, side, v)
    return min(_bound(servo, 1, v) - d, _bound(servo, -1, v) + d)


@compiled(error_model="numpy", forceinline=True)
def _acting(u: float, us: float, lag: float, tau: float, h: float) -> float:
    """Input a time h after it was u and grew by us per second; behind a lag that stood at ``lag``."""
    if tau <= 0.0:
        return u + us * h
    if us == 0.0:
        return u + (lag - u) * np.exp(-h / tau)
    return u + us * (h - tau) + (lag - u + us * tau) * np.exp(-h / tau)


@compiled(error_model="numpy")
def _impedance(p: np.ndarray, at: int, depth: float) -> float:
    """MuJoCo's impedance of a constraint that is violated by ``depth``; p[at:at+5]: solimp."""
    low, high, width, middle, power = p[at], p[at + 1], p[at + 2], p[at + 3], p[at + 4]
    if low == high or width <= 1e-15:
        return 0.5 * (low + high)
    e = abs(depth) / width
    if e >= 1.0:
        return high
    if power != 1.0:
        e = e**power / middle ** (power - 1.0) if e <= middle else 1.0 - (1.0 - e) ** power / (1.0 - middle) ** (power - 1.0)
    return low + e * (high - low)


@compiled(error_model="numpy")
def _limited(
    p: np.ndarray, at: int, side: int, q: float, v: float, balance: float, inertia: float, share: float, soft: int
) -> tuple[float, float]:
    """Force of a joint limit and the force of soft friction beside it, both on the body: (limit, friction).

    ``side``: -1 beyond the lower limit, +1 beyond the upper; balance: all other forces; inertia: the body's, at its angle; share:
    nominal inertia, from which MuJoCo takes the regularisation; soft: first parameter of the friction, -1 for none.
    Inertia a = balance + limit + friction, with a limit -side max(0, m (side (a + B v) + K d depth)), m = share d / (1 - d).
    """
    depth = side * (q - p[at + (1 if side > 0 else 0)])
    d = _impedance(p, at + 4, depth)
    m = share * d / (1.0 - d)
    push = m * (p[at + 3] * v + side * p[at + 2] * d * depth)
    mf = 0.0
    drag = 0.0
    if soft >= 0:
        mf = share * p[soft] / (1.0 - p[soft])
        drag = mf * p[soft + 1] * v
    for active in range(1, -1, -1):
        force, mass = balance, inertia
        if active == 1:
            force, mass = force - push, mass + m
        a = (force - drag) / (mass + mf)
        friction = -drag - mf * a
        if soft >= 0 and friction > p[soft + 3]:
            friction = p[soft + 3]
            a = (force + friction) / mass
        elif soft >= 0 and friction < -p[soft + 2]:
            friction = -p[soft + 2]
            a = (force + friction) / mass
        stop = m * a + push
        if active == 0 or side * stop >= 0.0:
            return -stop if active == 1 else 0.0, friction
    return 0.0, 0.0


@compiled(error_model="numpy")
def _held_by_limit(p: np.ndarray, at: int, side: int, q: float, v: float, a: float, share: float) -> float:
    """Force of a joint limit on a body whose acceleration is ``a``; arguments as of `_limited`."""
    depth = side * (q - p[at + (1 if side > 0 else 0)])
    d = _impedance(p, at + 4, depth)
    stop = share * d / (1.0 - d) * (a + p[at + 3] * v + side * p[at + 2] * d * depth)
    return -stop if side * stop > 0.0 else 0.0


@compiled(error_model="numpy")
def _push_back(f: np.ndarray, el: np.ndarray, p: np.ndarray, x: np.ndarray, mode: np.ndarray, w: np.ndarray) -> None:
    """Add the force of the joint limits to what `_rates` has gathered for body 0, and solve for soft friction beside it."""
    side = mode[5, 0]
    if side == 0:
        return
    last = el.shape[0] - 1
    at = el[last, 3]
    q = x[0, 0] + w[14 if el[last, 5] else 13, 0]
    if mode[0, 0] == 0:
        w[1, 0] += _held_by_limit(p, at, side, q, 0.0, 0.0, f[0, 0])
        return
    dry = w[10, 0]
    softness = -1
    e = last - 1
    while e >= 0 and el[e, 0] == KIND_SOFT:
        if el[e, 1] == 0:
            softness = el[e, 3]
        e -= 1
    if softness >= 0:
        soft = p[softness] * (w[1, 0] + p[softness + 1] * w[11, 0] * x[1, 0])
        dry -= min(max(soft, -p[softness + 3]), p[softness + 2])
    stop, soft = _limited(p, at, side, q, x[1, 0], w[1, 0] - dry, w[11, 0], f[0, 0], softness)
    w[10, 0] = dry - soft
    w[1, 0] += stop


def _slips_of(p: np.ndarray, at: int, balance: float, inertia: float, v: float) -> int:
    """Direction in which soft friction with first parameter ``at`` slips, at its level; 0 where the body creeps below it.

    balance: all other forces; inertia: the body's.
    """
    soft = p[at] * (balance + p[at + 1] * inertia * v)
    return 1 if soft >= p[at + 2] else (-1 if soft <= -p[at + 3] else 0)


_slips: Any = compiled(error_model="numpy", forceinline=True)(_slips_of)


def _rates_of(
    bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray, p: np.ndarray,
    x: np.ndarray, t: float, u: float, mode: np.ndarray, w: np.ndarray, z: np.ndarray
) -> None:  # fmt: skip
    """Accelerations and internal rates at one instant.

    Writes w (n_w, m): rows 0 accelerations, 1 torque balance without friction, 2 / 3 breakaway levels forward / backward of
    stuck bodies, 4 coupling torques, 5 elastic deflections, 6 deflection rates, 7 kinematic slopes, 8 alpha, 9 beta, 10 sliding
    friction (signed), 11 effective inertias, 12 raw deflections; 13, 14 hold what is added to the angles that laws see: to the
    recorded angle, and to where the recording starts.
    """
    n = len(bodies)
    za, pa = z.ctypes.data, p.ctypes.data
    oa = za + 8 * N_LOCAL
    for j in range(n - 1):
        w[5, j] = 0.0
        w[7, j] = 0.0
    first = 0
    while first < el.shape[0] and el[first, 0] == KIND_TWIST:
        j = el[first, 1]
        z[0] = t
        z[1] = x[0, j]
        z[2] = x[1, j]
        z[5] = x[0, j] + w[13, j]
        _call(el[first, 2], za, pa + 8 * el[first, 3], oa)
        w[5, j] += z[8]
        w[7, j] += z[9]
        first += 1
    for j in range(n - 1):
        d = f[2, j] * x[0, j] + w[5, j] - x[0, j + 1]
        w[7, j] += f[2, j]
        rate = w[7, j] * x[1, j] - x[1, j + 1]
        torque = f[4, j] * rate
        w[12, j] = d
        w[6, j] = rate
        hb = f[5, j]
        if hb > 0.0:
            if mode[1, j] == 0:
                d = 0.0
                if gap_law != UNGATED:
                    torque = 0.0
            else:
                d -= mode[1, j] * hb
        w[5, j] = d
        w[4, j] = torque + f[3, j] * d
    e = first
    while e < el.shape[0] and el[e, 0] == KIND_COUPLING:
        j = el[e, 1]
        connected = f[5, j] <= 0.0 or mode[1, j] != 0
        si = el[e, 4]
        z[0] = t
        z[1] = w[5, j]
        z[2] = w[6, j] if connected else 0.0
        z[5] = x[0, j] + w[13, j]
        z[7] = x[2, si] if si >= 0 else 0.0
        _call(el[e, 2], za, pa + 8 * el[e, 3], oa)
        if connected:
            w[4, j] += z[8]
        if si >= 0:
            w[8, si] = z[9]
            w[9, si] = z[10]
        e += 1
    if gap_law == NO_PULL:
        for j in range(n - 1):
            if f[5, j] > 0.0 and mode[1, j] * w[4, j] < 0.0:
                w[4, j] = 0.0
    pull = _pull(servo, gain, u, x[0, 0], x[1, 0], mode)
    for i in range(n):
        force = -f[1, i] * x[1, i]
        if i == 0:
            force += pull
        else:
            force += w[4, i - 1]
        if i < n - 1:
            force -= w[7, i] * w[4, i]
        w[1, i] = force
        w[2, i] = 0.0
        w[3, i] = 0.0
        w[10, i] = 0.0
        w[11, i] = f[0, i]
    while e < el.shape[0]:
        kind = el[e, 0]
        i = el[e, 1]
        si = el[e, 4]
        if kind == KIND_LIMIT:
            _push_back(f, el, p, x, mode, w)
            e += 1
            continue
        if kind == KIND_SOFT:  # `mjsim.chain.Softness`
            at = el[e, 3]
            soft = p[at] * (w[1, i] + p[at + 1] * w[11, i] * x[1, i])
            w[10, i] += min(max(soft, -p[at + 3]), p[at + 2])
            e += 1
            continue
        if el[e, 2] == 0:  # friction of constant levels
            at = el[e, 3]
            if mode[0, i] == 0:
                w[2, i] += p[at + 2]
                w[3, i] += p[at + 3]
            else:
                w[10, i] += mode[0, i] * p[at + (0 if mode[0, i] > 0 else 1)]
            e += 1
            continue
        z[0] = t
        z[1] = x[0, i]
        z[2] = x[1, i]
        z[3] = mode[0, i]
        if n > 1:
            z[4] = w[7, 0] * w[4, 0] if i == 0 else w[4, i - 1]
        else:
            z[4] = pull
        z[5] = x[0, i] + w[14 if el[e, 5] else 13, i]
        z[6] = u
        z[7] = x[2, si] if si >= 0 else 0.0
        if kind == KIND_FRICTION and mode[0, i] == 0:
            z[2] = 0.0
            z[3] = 1.0
            _call(el[e, 2], za, pa + 8 * el[e, 3], oa)
            w[2, i] += z[9]
            z[3] = -1.0
            _call(el[e, 2], za, pa + 8 * el[e, 3], oa)
            w[3, i] += z[9]
        else:
            _call(el[e, 2], za, pa + 8 * el[e, 3], oa)
            if kind == KIND_FRICTION:
                w[10, i] += mode[0, i] * z[8]
            elif kind == KIND_BODY:
                w[1, i] += z[8]
                if el[e, 6] == 1:
                    pull += z[8]
                if si >= 0:
                    w[8, si] = z[9]
                    w[9, si] = z[10]
            else:
                w[11, i] += f[0, i] * z[8]
                w[1, i] -= 0.5 * f[0, i] * z[9] * x[1, i] * x[1, i]
        e += 1
    for i in range(n):
        w[0, i] = (w[1, i] - w[10, i]) / w[11, i]


_rates: Any = compiled(error_model="numpy")(_rates_of)
_rates_here: Any = compiled(inline="always")(_rates_of)  # in the step: passing arrays costs as much as the work


@compiled(error_model="numpy")
def _relax(s: float, alpha: float, beta: float, h: float) -> float:
    """Exact flow of s' = alpha - beta s over h."""
    x = beta * h
    if x < 1e-7:
        return s + alpha * h * (1.0 - 0.5 * x) - s * x
    decay = np.exp(-x)
    return s * decay + alpha * (1.0 - decay) / beta


def _step_of(
    bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray, p: np.ndarray,
    x: np.ndarray, xn: np.ndarray, h: float, t: float, u: float, us: float, lag: float, tau: float, n_s: int, mode: np.ndarray,
    w: np.ndarray, wk: np.ndarray, z: np.ndarray
) -> None:  # fmt: skip
    """One RK4 step of length h from x to xn (each 3 x m: q, v, s); the input is u and grows by us, behind a lag when tau > 0.

    wk (19, m) holds the stage slopes and, of the start, the coupling torques, the torque balances without friction and the
    effective inertias.
    """
    n = len(bodies)
    for stage in range(4):
        c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        ut = _acting(u, us, lag, tau, c * h)
        if stage == 0:
            for i in range(n):
                xn[0, i] = x[0, i]
                xn[1, i] = x[1, i]
            for i in range(n_s):
                xn[2, i] = x[2, i]
        else:
            b = 3 * (stage - 1)
            for i in range(n):
                xn[0, i] = x[0, i] + c * h * wk[b, i]
                xn[1, i] = x[1, i] + c * h * wk[b + 1, i]
            for i in range(n_s):
                xn[2, i] = _relax(x[2, i], wk[b + 2, i], wk[12 + stage - 1, i], c * h)
        _rates_here(bodies, f, gap_law, gain, servo, el, p, xn, t + c * h, ut, mode, w, z)
        b = 3 * stage
        for i in range(n):
            wk[b, i] = xn[1, i]
            wk[b + 1, i] = w[0, i] if mode[0, i] != 0 else 0.0
            if stage == 0:
                wk[16, i] = w[4, i]
                wk[17, i] = w[1, i]
                wk[18, i] = w[11, i]
        for i in range(n_s):
            wk[b + 2, i] = w[8, i]
            wk[12 + stage, i] = w[9, i]
    for i in range(n):
        xn[0, i] = x[0, i] + h / 6.0 * (wk[0, i] + 2.0 * wk[3, i] + 2.0 * wk[6, i] + wk[9, i])
        xn[1, i] = x[1, i] + h / 6.0 * (wk[1, i] + 2.0 * wk[4, i] + 2.0 * wk[7, i] + wk[10, i])
    for i in range(n_s):
        alpha = (wk[2, i] + 2.0 * wk[5, i] + 2.0 * wk[8, i] + wk[11, i]) / 6.0
        beta = (wk[12, i] + 2.0 * wk[13, i] + 2.0 * wk[14, i] + wk[15, i]) / 6.0
        xn[2, i] = _relax(x[2, i], alpha, beta, h)


_step: Any = compiled(error_model="numpy")(_step_of)
_step_here: Any = compiled(error_model="numpy", forceinline=True)(_step_of)


@compiled(error_model="numpy")
def _margin(
    event: int, bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray,
    p: np.ndarray, x: np.ndarray, t: float, u: float, mode: np.ndarray, w: np.ndarray, z: np.ndarray
) -> float:  # fmt: skip
    """Event function, positive while the mode holds.

    Events 0..n-1: friction of a body; n..2n-2: gap of a coupling; 2n-1, 2n: force limit and dead band of the drive; 2n+1: the
    joint limits of body 0.
    """
    n = len(bodies)
    if event == 2 * n + 1:
        last = el.shape[0] - 1
        at = el[last, 3]
        q = x[0, 0] + w[14 if el[last, 5] else 13, 0]
        if mode[5, 0] == 0:
            return min(q - p[at], p[at + 1] - q)
        return mode[5, 0] * (q - p[at + (1 if mode[5, 0] > 0 else 0)])
    if event >= 2 * n - 1:
        return _drive_margin(event - 2 * n + 1, servo, gain, u, x[0, 0], x[1, 0], mode)
    if event < n:
        if mode[0, event] != 0:
            return mode[0, event] * x[1, event]
        _rates(bodies, f, gap_law, gain, servo, el, p, x, t, u, mode, w, z)
        force = w[1, event]
        return min(w[2, event] - force, force + w[3, event])
    j = event - n
    # a kinematic error shifts the deflection, so it is read from the rates when there is one
    if el.shape[0] > 0 and el[0, 0] == KIND_TWIST:
        _rates(bodies, f, gap_law, gain, servo, el, p, x, t, u, mode, w, z)
        d = w[12, j]
    else:
        d = f[2, j] * x[0, j] - x[0, j + 1]
    if mode[1, j] != 0:
        return mode[1, j] * d - f[5, j]
    return f[5, j] - abs(d)


@compiled(error_model="numpy")
def _beyond(el: np.ndarray, p: np.ndarray, x: np.ndarray, w: np.ndarray) -> int:
    """Side of the joint limit that body 0 is beyond: -1, +1, or 0 within both."""
    last = el.shape[0] - 1
    at = el[last, 3]
    q = x[0, 0] + w[14 if el[last, 5] else 13, 0]
    return 1 if q > p[at + 1] else (-1 if q < p[at] else 0)


@compiled(error_model="numpy")
def _settle(
    bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray, p: np.ndarray,
    x: np.ndarray, t: float, u: float, mode: np.ndarray, w: np.ndarray, z: np.ndarray
) -> None:  # fmt: skip
    """Re-decide stick or slip of every body at rest, after the torques jumped."""
    n = len(bodies)
    for _ in range(2):
        for i in range(n):
            if mode[2, i] == 1 and x[1, i] == 0.0:
                old = mode[0, i]
                mode[0, i] = 0
                _rates(bodies, f, gap_law, gain, servo, el, p, x, t, u, mode, w, z)
                force = w[1, i]
                if force > w[2, i] or (force >= w[2, i] and old == 1):
                    mode[0, i] = 1
                elif force < -w[3, i] or (force <= -w[3, i] and old == -1):
                    mode[0, i] = -1


@compiled(error_model="numpy")
def _propagator(
    bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray, p: np.ndarray,
    mode: np.ndarray, tau: float, steps: np.ndarray, w: np.ndarray, z: np.ndarray, xt: np.ndarray, a: np.ndarray,
    power: np.ndarray, term: np.ndarray, phis: np.ndarray, rows: np.ndarray, level: np.ndarray
) -> None:  # fmt: skip
    """Matrices of the present mode over y = (q, v, lagged input, input, its slope, 1), N = 2n + 4, read off the rates.

    Writes phis (2, 2n+1, N): y(h) - y(0) for both steps h; rows (4n, N): accelerations, balances without friction, their rates
    of change, coupling torques; level (2, n): breakaway levels forward and backward. a, power, term (N, N) are scratch.
    """
    n = len(bodies)
    size = 2 * n + 4
    a[:] = 0.0
    rows[:] = 0.0
    for c in range(-1, 2 * n + 1):
        for i in range(n):
            xt[0, i] = 1.0 if c == i else 0.0
            xt[1, i] = 1.0 if c == n + i else 0.0
        _rates(bodies, f, gap_law, gain, servo, el, p, xt, 0.0, 1.0 if c == 2 * n else 0.0, mode, w, z)
        column = size - 1 if c < 0 else c
        if c == 2 * n and tau <= 0.0:
            column = 2 * n + 1
        for i in range(n):
            rows[i, column] = w[0, i]
            rows[n + i, column] = w[1, i]
            if i < n - 1:
                rows[3 * n + i, column] = w[4, i]
            if c < 0:
                level[0, i] = w[2, i]
                level[1, i] = w[3, i]
            else:
                rows[i, column] -= rows[i, size - 1]
                rows[n + i, column] -= rows[n + i, size - 1]
                rows[3 * n + i, column] -= rows[3 * n + i, size - 1]
    for i in range(n):
        a[i, n + i] = 1.0
        if mode[0, i] == 0:
            rows[i] = 0.0
        for k in range(size):
            a[n + i, k] = rows[i, k]
    if tau > 0.0:
        a[2 * n, 2 * n] = -1.0 / tau
        a[2 * n, 2 * n + 1] = 1.0 / tau
    a[2 * n + 1, 2 * n + 2] = 1.0
    for i in range(n):
        for c in range(size):
            total = 0.0
            for r in range(size):
                total += rows[n + i, r] * a[r, c]
            rows[2 * n + i, c] = total
    phis[:] = 0.0
    for seg in range(2):
        h = steps[seg]
        if h <= 0.0:
            continue
        power[:] = 0.0
        for r in range(size):
            power[r, r] = 1.0
        for k in range(1, 20):
            for r in range(size):
                for c in range(size):
                    total = 0.0
                    for b in range(size):
                        total += a[r, b] * power[b, c]
                    term[r, c] = total * h / k
            for r in range(size):
                for c in range(size):
                    power[r, c] = term[r, c]
                    if r <= 2 * n:
                        phis[seg, r, c] += term[r, c]


@compiled(error_model="numpy", forceinline=True)
def _dips(g0: float, s0: float, g1: float, s1: float, h: float) -> float:
    """Whether the cubic through two margins and their slopes falls below zero in between; the time of its minimum, or -1."""
    if not (s0 < 0.0 and s1 > 0.0):
        return -1.0
    # g(e) = g0 + a e + b e^2 + c e^3, e = t / h
    a = s0 * h
    d = g1 - g0
    b = 3.0 * d - 2.0 * a - s1 * h
    c = a + s1 * h - 2.0 * d
    root = b * b - 3.0 * a * c
    if root < 0.0:
        return -1.0
    e = -a / (b + np.sqrt(root))
    if not (e > 0.0 and e < 1.0):
        return -1.0
    return e * h if g0 + e * (a + e * (b + e * c)) < 0.0 else -1.0


@compiled(error_model="numpy")
def _cubic_root(g0: float, s0: float, g1: float, s1: float, h: float) -> tuple[float, float]:
    """Where the cubic through a margin that holds at 0 and is violated at h crosses zero, and its slope there."""
    a = s0 * h
    d = g1 - g0
    b = 3.0 * d - 2.0 * a - s1 * h
    c = a + s1 * h - 2.0 * d
    lo, hi = 0.0, 1.0
    e = g0 / (g0 - g1)
    slope = d
    for _ in range(40):
        value = g0 + e * (a + e * (b + e * c))
        if value < 0.0:
            hi = e
        else:
            lo = e
        slope = a + e * (2.0 * b + 3.0 * e * c)
        new = e - value / slope if slope < 0.0 else 0.5 * (lo + hi)
        if not (new > lo and new < hi):
            new = 0.5 * (lo + hi)
        if abs(new - e) < 1e-10:
            break
        e = new
    return e * h, slope / h


@compiled(error_model="numpy")
def integrate(
    bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray, p: np.ndarray,
    has_friction: np.ndarray, u: np.ndarray, growth: np.ndarray, dt: float, shift: int, split: float, before: float, tau: float,
    n_sub: int, parts: int, affine: bool, x0: np.ndarray, states0: np.ndarray, angle: np.ndarray, locked: bool, origin: float,
    t0: float, out: np.ndarray
) -> tuple[int, int, int]:  # fmt: skip
    """Free run. u (N) input at the start of each sample, growth (N) its slope over it.

    out (N, 2 n + n_s + n-1) receives q, v, s, coupling torques.

    The input is delayed by ``shift`` whole samples and the fraction ``split`` of a sample (0 <= split < 1); ``before`` is the
    torque ahead of the first sample; tau > 0 lags it. A sample has ``n_sub`` steps; one in which a bristle at a body may turn, or
    act as a spring, or a body creeps under soft friction, is cut into ``parts``. ``affine``: the equations are affine in every
    mode. angle (N): measured angle of body 0, used when ``locked``: laws with el[:, 5] == 0 see it, the others the run's own
    angle and ``origin``.
    Returns (status, sample, work): 0 done, 1 diverged at that
    sample; what it took, in products of a step: a step by RK4 is four.
    """
    n = len(bodies)
    n_s = states0.shape[0]
    m = max(n, n_s, 1)
    own_x = np.zeros((9, m))
    own_w = np.zeros((15, m))
    own_z = np.zeros(N_LOCAL + 3)
    own_wk = np.zeros((19, m))
    own_mode = np.zeros((6, n), np.int64)
    # counting references to these at every call costs as much as the work
    x, xn, xt = _view(own_x[:3]), _view(own_x[3:6]), _view(own_x[6:])
    w, z, wk, mode = _view(own_w), _view(own_z), _view(own_wk), _view(own_mode)
    f, el, p, servo = _view(f), _view(el), _view(p), _view(servo)
    for i in range(n):
        x[0, i] = x0[0, i]
        x[1, i] = x0[1, i]
        if has_friction[i]:
            mode[2, i] = 1
            mode[0, i] = 1 if x[1, i] > 0 else (-1 if x[1, i] < 0 else 0)
        else:
            mode[0, i] = 1
    for i in range(n_s):
        x[2, i] = states0[i]
    _rates(bodies, f, gap_law, gain, servo, el, p, x, t0, u[0], mode, w, z)
    for j in range(n - 1):
        if f[5, j] > 0.0:
            mode[1, j] = 1 if w[12, j] > f[5, j] else (-1 if w[12, j] < -f[5, j] else 0)
    total = u.shape[0]
    status, at = 0, total
    work = 0
    limited = np.isfinite(servo[2]) or np.isfinite(servo[3])
    slack = servo[5] > 0.0
    last = el.shape[0] - 1
    stop = last >= 0 and el[last, 0] == KIND_LIMIT
    n_event = 2 * n + 2 if stop else (2 * n + 1 if limited or slack else 2 * n - 1)
    ratio = np.ones(n)
    for i in range(1, n):
        ratio[i] = ratio[i - 1] * f[2, i - 1]
    any_event = False
    for i in range(n):
        any_event = any_event or has_friction[i] or f[5, i] > 0.0
    any_event = any_event or limited or slack or stop
    if locked:
        for i in range(n):
            w[14, i] = ratio[i] * origin
            w[13, i] = w[14, i]
    if stop:
        mode[5, 0] = _beyond(el, p, x, w)
    lag = before
    before_t = 0.0
    before_g = 0.0
    spans = np.array([split * dt, (1.0 - split) * dt])
    subs = np.ones(2, np.int64)
    steps = np.zeros(2)
    for seg in range(2):
        subs[seg] = max(1, int(np.ceil(n_sub * spans[seg] / dt - 1e-9))) * parts
        steps[seg] = spans[seg] / subs[seg]
    last_u = before
    # the propagators by mode, a direct-mapped store; looked up in two places, each written out: as a function, inlined or not,
    # counting the references of its arrays made a step of the linear axis seven times as slow
    size = 2 * n + 4
    slots = SLOTS if affine else 1
    keys = np.full(slots, -1)
    y = np.zeros(size)
    yn = np.zeros(size)
    a = np.zeros((size, size))
    power = np.zeros((size, size))
    term = np.zeros((size, size))
    phis = np.zeros((slots, 2, 2 * n + 1, size))
    rows = np.zeros((slots, 4 * n, size))
    levels = np.zeros((slots, 2, n))
    stride = np.zeros(n)  # largest change of a velocity in a step so far: only this near zero can a step hide a reversal
    y[size - 1] = 1.0
    yn[size - 1] = 1.0
    for k in range(total):
        t = t0 + k * dt
        if locked:
            off = angle[k] - x[0, 0]
            for i in range(n):
                w[13, i] = ratio[i] * off
            if stop and el[last, 5] == 0:
                mode[5, 0] = _beyond(el, p, x, w)
        for i in range(n):
            out[k, i] = x[0, i]
            out[k, n + i] = x[1, i]
        for i in range(n_s):
            out[k, 2 * n + i] = x[2, i]
        slot = 0
        if affine:
            code = 0
            for i in range(n):
                code = code * 9 + 3 * mode[0, i] + mode[1, i] + 4
            code = code * 9 + 3 * mode[3, 0] + mode[4, 0] + 4
            slot = code % SLOTS
            if keys[slot] != code:
                keys[slot] = code
                _propagator(
                    bodies,
                    f,
                    gap_law,
                    gain,
                    servo,
                    el,
                    p,
                    mode,
                    tau,
                    steps,
                    w,
                    z,
                    xt,
                    a,
                    power,
                    term,
                    phis[slot],
                    rows[slot],
                    levels[slot],
                )
            for i in range(n):
                y[i] = x[0, i]
                y[n + i] = x[1, i]
            for j in range(n - 1):
                dot = 0.0
                for c in range(size):
                    dot += rows[slot, 3 * n + j, c] * y[c]
                out[k, 2 * n + n_s + j] = dot
        elif k == total - 1:
            _rates(bodies, f, gap_law, gain, servo, el, p, x, t, u[k], mode, w, z)
            for j in range(n - 1):
                out[k, 2 * n + n_s + j] = w[4, j]
        if not np.isfinite(x[1, 0]) or abs(x[1, 0]) > 1e12:
            status, at = 1, k
            break
        if k == total - 1:
            break
        events = 0
        first = not affine
        for seg in range(2):
            if spans[seg] <= 0.0:
                continue
            kk = k - shift - 1 if seg == 0 else k - shift
            uk = u[kk] if kk >= 0 else before
            us = growth[kk] if kk >= 0 else 0.0
            if seg == 0:
                uk += us * (dt - spans[0])  # the older sample is under way
            if limited or slack:
                _choose_sides(servo, gain, uk if tau <= 0.0 else lag, x[0, 0], x[1, 0], mode)
            sub = 0
            while sub < subs[seg]:
                left = steps[seg]
                whole = 0.0
                if parts > 1 and sub % parts == 0:
                    whole = parts * left
                    for e in range(el.shape[0]):
                        soft = el[e, 0] == KIND_SOFT
                        if soft or (el[e, 0] == KIND_BODY and el[e, 4] >= 0):
                            i = el[e, 1]
                            new = gain * (uk - last_u) if i == 0 and sub == 0 else 0.0
                            change = abs(wk[10, i]) + abs(new) / f[0, 0]  # at the end of the step before, and by the new torque
                            if abs(x[1, i]) < TURNS * whole * change:
                                whole = 0.0
                            elif soft:
                                slips = _slips(p, el[e, 3], w[1, i] + new, w[11, i], x[1, i])
                                if slips == 0 or mode[5, 0] != 0:
                                    whole = 0.0
                            elif wk[15, el[e, 4]] * whole < SLIDES:
                                whole = 0.0
                if whole > 0.0:
                    left = whole
                    sub += parts
                else:
                    sub += 1
                if affine:
                    code = 0
                    for i in range(n):
                        code = code * 9 + 3 * mode[0, i] + mode[1, i] + 4
                    code = code * 9 + 3 * mode[3, 0] + mode[4, 0] + 4
                    slot = code % SLOTS
                    if keys[slot] != code:
                        keys[slot] = code
                        _propagator(
                            bodies,
                            f,
                            gap_law,
                            gain,
                            servo,
                            el,
                            p,
                            mode,
                            tau,
                            steps,
                            w,
                            z,
                            xt,
                            a,
                            power,
                            term,
                            phis[slot],
                            rows[slot],
                            levels[slot],
                        )
                    for i in range(n):
                        y[i] = x[0, i]
                        y[n + i] = x[1, i]
                    y[2 * n] = lag
                    y[2 * n + 1] = uk
                    y[2 * n + 2] = us
                    for r in range(2 * n + 1):
                        dot = 0.0
                        for c in range(size):
                            dot += phis[slot, seg, r, c] * y[c]
                        yn[r] = y[r] + dot
                    yn[2 * n + 1] = uk + us * left
                    yn[2 * n + 2] = us
                    clean = True
                    if any_event:
                        for i in range(n):
                            if mode[2, i] == 0:
                                continue
                            if mode[0, i] != 0:
                                g0 = mode[0, i] * y[n + i]
                                g1 = mode[0, i] * yn[n + i]
                                stride[i] = max(stride[i], abs(g1 - g0))
                                if g0 <= 0.0 or g1 <= 0.0:
                                    clean = False
                                elif min(g0, g1) < 2.0 * stride[i]:
                                    s0 = 0.0
                                    s1 = 0.0
                                    for c in range(size):
                                        s0 += rows[slot, i, c] * y[c]
                                        s1 += rows[slot, i, c] * yn[c]
                                    if _dips(g0, mode[0, i] * s0, g1, mode[0, i] * s1, left) >= 0.0:
                                        clean = False
                            else:
                                f0 = 0.0
                                f1 = 0.0
                                s0 = 0.0
                                s1 = 0.0
                                for c in range(size):
                                    f0 += rows[slot, n + i, c] * y[c]
                                    f1 += rows[slot, n + i, c] * yn[c]
                                    s0 += rows[slot, 2 * n + i, c] * y[c]
                                    s1 += rows[slot, 2 * n + i, c] * yn[c]
                                up = levels[slot, 0, i]
                                down = levels[slot, 1, i]
                                if (
                                    min(up - f0, up - f1, f0 + down, f1 + down) <= 0.0
                                    or _dips(up - f0, -s0, up - f1, -s1, left) >= 0.0
                                    or _dips(f0 + down, s0, f1 + down, s1, left) >= 0.0
                                ):
                                    clean = False
                        for j in range(n - 1):
                            if f[5, j] <= 0.0:
                                continue
                            d0 = f[2, j] * y[j] - y[j + 1]
                            d1 = f[2, j] * yn[j] - yn[j + 1]
                            s0 = f[2, j] * y[n + j] - y[n + j + 1]
                            s1 = f[2, j] * yn[n + j] - yn[n + j + 1]
                            hb = f[5, j]
                            if mode[1, j] != 0:
                                side = mode[1, j]
                                if (
                                    min(side * d0, side * d1) <= hb
                                    or _dips(side * d0 - hb, side * s0, side * d1 - hb, side * s1, left) >= 0.0
                                ):
                                    clean = False
                            elif (
                                max(abs(d0), abs(d1)) >= hb
                                or _dips(hb - d0, -s0, hb - d1, -s1, left) >= 0.0
                                or _dips(hb + d0, s0, hb + d1, s1, left) >= 0.0
                            ):
                                clean = False
                        if clean and (limited or slack):
                            # margins of the drive at both ends, and whether they dip in between
                            at_u = 2 * n if tau > 0.0 else 2 * n + 1
                            r0 = (uk - y[2 * n]) / tau if tau > 0.0 else us
                            r1 = (yn[2 * n + 1] - yn[2 * n]) / tau if tau > 0.0 else us
                            b0 = 0.0
                            b1 = 0.0
                            for c in range(size):
                                b0 += rows[slot, 0, c] * y[c]
                                b1 += rows[slot, 0, c] * yn[c]
                            e0 = gain * r0 - servo[0] * y[n]
                            e1 = gain * r1 - servo[0] * yn[n]
                            for which in range(2):
                                if (which == 0 and not limited) or (which == 1 and not slack):
                                    continue
                                g0 = _drive_margin(which, servo, gain, y[at_u], y[0], y[n], mode)
                                g1 = _drive_margin(which, servo, gain, yn[at_u], yn[0], yn[n], mode)
                                if min(g0, g1) <= 0.0:
                                    clean = False
                                    continue
                                side = mode[4 - (1 - which), 0]
                                grow0, grow1 = e0, e1
                                if which == 0:
                                    keep = 1.0 if not slack or mode[4, 0] != 0 else 0.0
                                    grow0, grow1 = keep * e0 - servo[1] * b0, keep * e1 - servo[1] * b1
                                    if side != 0:
                                        grow0, grow1 = grow0 + servo[4] * b0, grow1 + servo[4] * b1
                                        clean = clean and _dips(g0, side * grow0, g1, side * grow1, left) < 0.0
                                        continue
                                    for way in (-1, 1):
                                        m0 = _bound(servo, way, y[n]) - way * _asked(servo, gain, y[at_u], y[0], y[n], mode)
                                        m1 = _bound(servo, way, yn[n]) - way * _asked(servo, gain, yn[at_u], yn[0], yn[n], mode)
                                        k0 = -way * (grow0 + servo[4] * b0)
                                        k1 = -way * (grow1 + servo[4] * b1)
                                        clean = clean and _dips(m0, k0, m1, k1, left) < 0.0
                                elif side != 0:
                                    clean = clean and _dips(g0, side * grow0, g1, side * grow1, left) < 0.0
                                else:
                                    for way in (-1, 1):
                                        m0 = servo[5] - way * _error(servo, gain, y[at_u], y[0])
                                        m1 = servo[5] - way * _error(servo, gain, yn[at_u], yn[0])
                                        clean = clean and _dips(m0, -way * grow0, m1, -way * grow1, left) < 0.0
                    if clean:
                        work += 1
                        for i in range(n):
                            x[0, i] = yn[i]
                            x[1, i] = yn[n + i]
                        uk += us * left
                        lag = yn[2 * n] if tau > 0.0 else uk
                        t += left
                        continue
                resting = False
                for i in range(n):
                    resting = resting or (mode[2, i] == 1 and x[1, i] == 0.0)
                if resting:
                    ue = uk if tau <= 0.0 else lag
                    _settle(bodies, f, gap_law, gain, servo, el, p, x, t, ue, mode, w, z)
                while left > 0.0:
                    work += 4
                    _step_here(bodies, f, gap_law, gain, servo, el, p, x, xn, left, t, uk, us, lag, tau, n_s, mode, w, wk, z)
                    if whole > 0.0:
                        slides = True
                        for e in range(el.shape[0]):
                            i = el[e, 1]
                            if el[e, 0] == KIND_SOFT:
                                slips = _slips(p, el[e, 3], wk[17, i], wk[18, i], x[1, i])
                                end_slips = _slips(p, el[e, 3], w[1, i], w[11, i], xn[1, i])
                                slides = slides and slips != 0 and slips == end_slips and mode[5, 0] == 0
                            elif el[e, 0] == KIND_BODY and el[e, 4] >= 0:
                                si = el[e, 4]
                                # how far it is bent while it slides, at both ends
                                bent, end = wk[2, si] / wk[12, si], wk[11, si] / wk[15, si]
                                slides = slides and x[1, i] * xn[1, i] > 0.0 and abs(end - bent) < STEADY * abs(end)
                        whole = 0.0
                        if not slides:  # it has turned all the same, or bends as its speed changes: once more, in parts
                            sub -= parts - 1
                            left = steps[seg]
                            continue
                    if first:
                        first = False
                        for j in range(n - 1):
                            out[k, 2 * n + n_s + j] = wk[16, j]
                    h = left
                    hit = -1
                    if any_event and events < MAX_EVENTS:
                        ue = _acting(uk, us, lag, tau, h)
                        for ev in range(n_event):
                            if ev < n and not has_friction[ev]:
                                continue
                            if ev >= 2 * n - 1:
                                if (ev == 2 * n - 1 and not limited) or (ev == 2 * n and not slack):  # 2 n + 1: a stop is there
                                    continue
                            elif ev >= n and f[5, ev - n] <= 0.0:
                                continue
                            if ev < n and mode[0, ev] != 0:
                                g = mode[0, ev] * xn[1, ev]  # here, as a call passes every array
                            else:
                                g = _margin(ev, bodies, f, gap_law, gain, servo, el, p, xn, t + h, ue, mode, w, z)
                            hi = h
                            smooth = True
                            s0 = 0.0
                            s1 = 0.0
                            g0 = 0.0
                            if ev < n:
                                side_ev = mode[0, ev]
                                smooth = side_ev != 0
                                g0, s0, s1 = side_ev * x[1, ev], side_ev * wk[1, ev], side_ev * wk[10, ev]
                            elif stop and ev == 2 * n + 1:
                                at_p = el[last, 3]
                                q0 = x[0, 0] + w[14 if el[last, 5] else 13, 0]
                                q1 = q0 + xn[0, 0] - x[0, 0]
                                side_ev = mode[5, 0]
                                upper = side_ev > 0
                                if side_ev == 0:
                                    upper = q0 + q1 > p[at_p] + p[at_p + 1]
                                    side_ev = -1 if upper else 1
                                g0 = side_ev * (q0 - p[at_p + (1 if upper else 0)])
                                s0, s1 = side_ev * x[1, 0], side_ev * xn[1, 0]
                            elif ev >= 2 * n - 1:
                                smooth = False
                            else:
                                j = ev - n
                                side_ev = mode[1, j]
                                d0, d1 = f[2, j] * x[0, j] - x[0, j + 1], f[2, j] * xn[0, j] - xn[0, j + 1]
                                if side_ev == 0:
                                    side_ev = -1 if d0 + d1 > 0.0 else 1
                                g0 = side_ev * d0 + f[5, j] if mode[1, j] == 0 else side_ev * d0 - f[5, j]
                                s0 = side_ev * (f[2, j] * x[1, j] - x[1, j + 1])
                                s1 = side_ev * (f[2, j] * xn[1, j] - xn[1, j + 1])
                            if g >= 0.0:
                                if not smooth:
                                    continue
                                # the step may hide a reversal: violated in between, holding again at its end
                                hi = _dips(g0, s0, g, s1, h)
                                if hi < 0.0:
                                    continue
                                work += 4
                                _step(bodies, f, gap_law, gain, servo, el, p, x, xt, hi, t, uk, us, lag, tau, n_s, mode, w, wk, z)
                                um = _acting(uk, us, lag, tau, hi)
                                g = _margin(ev, bodies, f, gap_law, gain, servo, el, p, xt, t + hi, um, mode, w, z)
                                if g >= 0.0:
                                    continue
                                smooth = False
                            # bracket [lo, hi]: holds at lo, violated at hi
                            lo, ghi = 0.0, g
                            glo = _margin(ev, bodies, f, gap_law, gain, servo, el, p, x, t, lag if tau > 0.0 else uk, mode, w, z)
                            if glo <= 0.0:
                                # the mode was entered at this very instant: look for a moment at which it holds
                                probe = 0.5 * h
                                while probe > 1e-6 * dt:
                                    work += 4
                                    _step(
                                        bodies,
                                        f,
                                        gap_law,
                                        gain,
                                        servo,
                                        el,
                                        p,
                                        x,
                                        xt,
                                        probe,
                                        t,
                                        uk,
                                        us,
                                        lag,
                                        tau,
                                        n_s,
                                        mode,
                                        w,
                                        wk,
                                        z,
                                    )
                                    up = _acting(uk, us, lag, tau, probe)
                                    gp = _margin(ev, bodies, f, gap_law, gain, servo, el, p, xt, t + probe, up, mode, w, z)
                                    if gp > 0.0:
                                        lo, glo = probe, gp
                                        break
                                    hi, ghi = probe, gp
                                    probe *= 0.5
                            if glo > 0.0:
                                # secants from the root of the cubic through both ends; they end just past the event
                                close = 1e-13 + 1e-12 * dt
                                mid = (lo * ghi - hi * glo) / (ghi - glo)
                                slope = (ghi - glo) / (hi - lo)
                                if lo == 0.0 and smooth:
                                    mid, slope = _cubic_root(glo, s0, ghi, s1, hi)
                                for it in range(60):
                                    if not (mid > lo and mid < hi):
                                        mid = 0.5 * (lo + hi)
                                    work += 4
                                    _step(
                                        bodies,
                                        f,
                                        gap_law,
                                        gain,
                                        servo,
                                        el,
                                        p,
                                        x,
                                        xt,
                                        mid,
                                        t,
                                        uk,
                                        us,
                                        lag,
                                        tau,
                                        n_s,
                                        mode,
                                        w,
                                        wk,
                                        z,
                                    )
                                    um = _acting(uk, us, lag, tau, mid)
                                    gm = _margin(ev, bodies, f, gap_law, gain, servo, el, p, xt, t + mid, um, mode, w, z)
                                    if it > 0 and mid != before_t:
                                        slope = (gm - before_g) / (mid - before_t)
                                    before_t, before_g = mid, gm
                                    if gm < 0.0:
                                        hi, ghi = mid, gm
                                    else:
                                        lo, glo = mid, gm
                                    if hi - lo < close:
                                        break
                                    move = -gm / slope if slope < 0.0 else h
                                    if abs(move) < 2e-7 * dt:
                                        hi = min(hi, mid + move + 1e-15)
                                        break
                                    # a secant that leaves the bracket, or does not settle, gives way to bisection
                                    mid = mid + move if it < 12 else 0.5 * (lo + hi)
                            h = hi
                            hit = ev
                            work += 4
                            _step(bodies, f, gap_law, gain, servo, el, p, x, xn, h, t, uk, us, lag, tau, n_s, mode, w, wk, z)
                            ue = _acting(uk, us, lag, tau, h)
                    for i in range(n):
                        x[0, i] = xn[0, i]
                        x[1, i] = xn[1, i]
                    for i in range(n_s):
                        x[2, i] = xn[2, i]
                    t += h
                    left -= h
                    if left < 1e-15:
                        left = 0.0
                    lag = _acting(uk, us, lag, tau, h)
                    uk += us * h
                    if hit >= 0:
                        events += 1
                        if hit < n:
                            if mode[0, hit] != 0:
                                x[1, hit] = 0.0
                                mode[0, hit] = 0
                            else:
                                _rates(bodies, f, gap_law, gain, servo, el, p, x, t, lag, mode, w, z)
                                mode[0, hit] = 1 if w[1, hit] > 0.5 * (w[2, hit] - w[3, hit]) else -1
                        elif stop and hit == 2 * n + 1:
                            mode[5, 0] = _beyond(el, p, x, w) if mode[5, 0] == 0 else 0
                        elif hit == 2 * n - 1:
                            if mode[3, 0] != 0:
                                mode[3, 0] = 0
                            else:
                                mode[3, 0] = 1 if _asked(servo, gain, lag, x[0, 0], x[1, 0], mode) > 0.0 else -1
                        elif hit == 2 * n:
                            if mode[4, 0] != 0:
                                mode[4, 0] = 0
                            else:
                                mode[4, 0] = 1 if _error(servo, gain, lag, x[0, 0]) > 0.0 else -1
                        else:
                            j = hit - n
                            if mode[1, j] != 0:
                                mode[1, j] = 0
                            else:
                                _rates(bodies, f, gap_law, gain, servo, el, p, x, t, lag, mode, w, z)
                                mode[1, j] = 1 if w[12, j] > 0 else -1
                        _settle(bodies, f, gap_law, gain, servo, el, p, x, t, lag, mode, w, z)
            last_u = uk
    # used to the end, so that what the views look at is there to the end
    own_x[0, 0] = own_w[0, 0] = own_z[0] = own_wk[0, 0] = 0.0
    own_mode[0, 0] = 0
    return status, at, work


@compiled(error_model="numpy")
def _needed(
    bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray, p: np.ndarray,
    x: np.ndarray, t: float, u: float, a: float, mode: np.ndarray, w: np.ndarray, z: np.ndarray
) -> float:  # fmt: skip
    """Input beyond u that gives body 0 an acceleration a, where laws see the drive's torque at u."""
    _rates(bodies, f, gap_law, gain, servo, el, p, x, t, u, mode, w, z)
    v = x[1, 0]
    for e in range(el.shape[0]):
        if el[e, 0] == KIND_SOFT and el[e, 1] == 0:  # that of the forces with the input, which the acceleration tells
            at = el[e, 3]
            soft = p[at] * (w[1, 0] + p[at + 1] * w[11, 0] * v)
            w[10, 0] -= min(max(soft, -p[at + 3]), p[at + 2])
            soft = p[at] / (1.0 - p[at]) * w[11, 0] * (a + p[at + 1] * v)
            w[10, 0] += min(max(soft, -p[at + 3]), p[at + 2])
        if el[e, 0] == KIND_LIMIT:
            side = _beyond(el, p, x, w)
            if side != 0:
                w[1, 0] += _held_by_limit(p, el[e, 3], side, x[0, 0], v, a, f[0, 0])
    return (w[11, 0] * a - w[1, 0] + w[10, 0]) / gain


@compiled(error_model="numpy")
def _consistent(
    bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray, p: np.ndarray,
    x: np.ndarray, t: float, u: float, a: float, mode: np.ndarray, w: np.ndarray, z: np.ndarray
) -> float:  # fmt: skip
    """The input that gives the one body an acceleration a, its own effect on the laws included; u: that without it.

    A fixed point by Aitken's extrapolation from a drive without torque: exact after one round for laws in proportion to it.
    """
    for k in range(MAX_ROUNDS):
        first = u + _needed(bodies, f, gap_law, gain, servo, el, p, x, t, u, a, mode, w, z)
        change = first - u
        if not abs(change) > SAME * (abs(first) + abs(u)):
            break
        if k == 0:
            u = (servo[0] * x[0, 0] + servo[1] * x[1, 0]) / gain
            first = u + _needed(bodies, f, gap_law, gain, servo, el, p, x, t, u, a, mode, w, z)
            change = first - u
        second = first + _needed(bodies, f, gap_law, gain, servo, el, p, x, t, first, a, mode, w, z)
        bend = second - first - change
        u = second if bend == 0.0 else u - change * change / bend
    return u


@compiled(error_model="numpy")
def drive(
    bodies: tuple[int, ...], f: np.ndarray, gap_law: int, gain: float, servo: np.ndarray, el: np.ndarray, p: np.ndarray,
    q0: np.ndarray, v0: np.ndarray, a0: np.ndarray, dt: float, n_sub: int, t0: float, rest: np.ndarray, out: np.ndarray
) -> tuple[int, int]:  # fmt: skip
    """Inverse dynamics: body 0 is moved as measured (q0, v0, a0, each (N)); out (N) receives the input torque that this needs.

    Bodies behind it run free from the deflections ``rest`` (2, n) relative to a rigid chain. Friction of body 0 takes the
    direction of v0; the other bodies' friction acts by direction too. Returns (status, sample).
    """
    n = len(bodies)
    n_s = 0
    for e in range(el.shape[0]):
        if el[e, 4] >= 0:
            n_s += 1
    m = max(n, n_s, 1)
    x = np.zeros((3, m))
    xn = np.zeros((3, m))
    w = np.zeros((15, m))
    z = np.zeros(N_LOCAL + 3)
    wk = np.zeros((19, m))
    mode = np.zeros((6, n), np.int64)
    ratio = 1.0
    for i in range(n):
        x[0, i] = ratio * q0[0] + rest[0, i]
        x[1, i] = ratio * v0[0] + rest[1, i]
        if i < n - 1:
            ratio *= f[2, i]
    total = q0.shape[0]
    for k in range(total):
        t = t0 + k * dt
        x[0, 0] = q0[k]
        x[1, 0] = v0[k]
        for i in range(n):
            mode[0, i] = 1 if x[1, i] >= 0 else -1
        for j in range(n - 1):
            if f[5, j] > 0.0:
                d = f[2, j] * x[0, j] - x[0, j + 1]
                mode[1, j] = 1 if d > f[5, j] else (-1 if d < -f[5, j] else 0)
        out[k] = _needed(bodies, f, gap_law, gain, servo, el, p, x, t, 0.0, a0[k], mode, w, z)
        if n == 1:  # a law may take the torque of the drive itself
            out[k] = _consistent(bodies, f, gap_law, gain, servo, el, p, x, t, out[k], a0[k], mode, w, z)
        if not np.isfinite(out[k]):
            return 1, k
        if k == total - 1:
            break
        if n == 1 and n_s == 0:
            continue  # nothing moves but what is measured
        h = dt / n_sub
        for sub in range(n_sub):
            for stage in range(4):
                c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                g = (sub + c) / n_sub
                # cubic Hermite of the measured motion
                g2, g3 = g * g, g * g * g
                qs = (
                    (2 * g3 - 3 * g2 + 1) * q0[k]
                    + (g3 - 2 * g2 + g) * dt * v0[k]
                    + (3 * g2 - 2 * g3) * q0[k + 1]
                    + (g3 - g2) * dt * v0[k + 1]
                )
                vs = (6 * g2 - 6 * g) * (q0[k] - q0[k + 1]) / dt + (3 * g2 - 4 * g + 1) * v0[k] + (3 * g2 - 2 * g) * v0[k + 1]
                b = 3 * (stage - 1)
                for i in range(n):
                    if stage == 0:
                        xn[0, i] = x[0, i]
                        xn[1, i] = x[1, i]
                    else:
                        xn[0, i] = x[0, i] + c * h * wk[b, i]
                        xn[1, i] = x[1, i] + c * h * wk[b + 1, i]
                for i in range(n_s):
                    xn[2, i] = x[2, i] if stage == 0 else _relax(x[2, i], wk[b + 2, i], wk[12 + stage - 1, i], c * h)
                xn[0, 0] = qs
                xn[1, 0] = vs
                for i in range(n):
                    mode[0, i] = 1 if xn[1, i] >= 0 else -1
                for j in range(n - 1):
                    if f[5, j] > 0.0:
                        d = f[2, j] * xn[0, j] - xn[0, j + 1]
                        mode[1, j] = 1 if d > f[5, j] else (-1 if d < -f[5, j] else 0)
                _rates(bodies, f, gap_law, gain, servo, el, p, xn, t + g * dt, 0.0, mode, w, z)
                for i in range(n):
                    wk[3 * stage, i] = xn[1, i]
                    wk[3 * stage + 1, i] = w[0, i]
                for i in range(n_s):
                    wk[3 * stage + 2, i] = w[8, i]
                    wk[12 + stage, i] = w[9, i]
            for i in range(n):
                x[0, i] += h / 6.0 * (wk[0, i] + 2.0 * wk[3, i] + 2.0 * wk[6, i] + wk[9, i])
                x[1, i] += h / 6.0 * (wk[1, i] + 2.0 * wk[4, i] + 2.0 * wk[7, i] + wk[10, i])
            for i in range(n_s):
                alpha = (wk[2, i] + 2.0 * wk[5, i] + 2.0 * wk[8, i] + wk[11, i]) / 6.0
                beta = (wk[12, i] + 2.0 * wk[13, i] + 2.0 * wk[14, i] + wk[15, i]) / 6.0
                x[2, i] = _relax(x[2, i], alpha, beta, h)
    return 0, total
