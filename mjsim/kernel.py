"""The compiled ODE kernel: fourth-order Runge-Kutta with located events, for any chain and any set of ports.

Between events the equations of `mjsim.effects.ports` are smooth and RK4 is accurate to (h w)^4; stick, slip and contact are
located to rounding and switch modes, so that neither friction nor backlash smears over a step and a fitted cost is smooth
in the parameters. Laws are called by address (`mjsim.effects.law`), so that one compiled kernel serves all effects.

Modes: friction of body i: -1, +1 slip, 0 stick; gap of coupling j: -1, +1 contact, 0 open. Arrays (n bodies):
``f`` (6, n): inertia, viscous; of the coupling behind each body ratio, stiffness, damping, half gap. ``el`` (n_el, 5)
integer: kind, site, law address, first parameter, state index or -1. ``p``: parameters.
``mode`` (3, n): friction mode, gap mode, whether the body has friction. ``z``: local quantities of a law and, behind them, what it writes. ``x`` (3, m): q, v, internal states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from mjsim.effects.law import N_LOCAL

__all__ = ["KIND_BODY", "KIND_COUPLING", "KIND_FRICTION", "KIND_INERTIA", "KIND_TWIST", "drive", "integrate"]

KIND_TWIST, KIND_COUPLING, KIND_BODY, KIND_INERTIA, KIND_FRICTION = 0, 1, 2, 3, 4
GATED, UNGATED, NO_PULL = 0, 1, 2
MAX_EVENTS = 64  # per sample; past that the step is taken as it is (chatter)


@intrinsic
def _call_law(typingctx, address, z, p, out):  # pragma: no cover
    """Call the law at an address on three addresses."""
    sig = types.void(types.int64, types.int64, types.int64, types.int64)

    def codegen(context, builder, signature, args):
        pointer = ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.VoidType(), [pointer, pointer, pointer])
        target = builder.inttoptr(args[0], function.as_pointer())
        builder.call(target, [builder.inttoptr(a, pointer) for a in args[1:]])
        return context.get_dummy_value()

    return sig, codegen


_call: Any = _call_law


@njit(cache=True, nogil=True)
def _rates(f, gap_law, gain, el, p, x, t, u, mode, w, z):
    """Accelerations and internal rates at one instant.

    Writes w (n_w, m): rows 0 accelerations, 1 torque balance without friction, 2 / 3 breakaway levels forward / backward of
    stuck bodies, 4 coupling torques, 5 elastic deflections, 6 deflection rates, 7 kinematic slopes, 8 alpha, 9 beta, 10 sliding friction
    (signed), 11 effective inertias, 12 raw deflections.
    """
    n = f.shape[1]
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
    for i in range(n):
        force = -f[1, i] * x[1, i]
        if i == 0:
            force += gain * u
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
        z[0] = t
        z[1] = x[0, i]
        z[2] = x[1, i]
        z[3] = mode[0, i]
        if n > 1:
            z[4] = w[7, 0] * w[4, 0] if i == 0 else w[4, i - 1]
        else:
            z[4] = 0.0
        z[5] = x[0, i] + w[13, i]
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
                if si >= 0:
                    w[8, si] = z[9]
                    w[9, si] = z[10]
            else:
                w[11, i] += f[0, i] * z[8]
                w[1, i] -= 0.5 * f[0, i] * z[9] * x[1, i] * x[1, i]
        e += 1
    for i in range(n):
        w[0, i] = (w[1, i] - w[10, i]) / w[11, i]


@njit(cache=True, nogil=True)
def _relax(s, alpha, beta, h):
    """Exact flow of s' = alpha - beta s over h."""
    x = beta * h
    if x < 1e-7:
        return s + alpha * h * (1.0 - 0.5 * x) - s * x
    decay = np.exp(-x)
    return s * decay + alpha * (1.0 - decay) / beta


@njit(cache=True, nogil=True)
def _step(f, gap_law, gain, el, p, x, xn, h, t, u, lag, tau, n_s, mode, w, wk, z):
    """One RK4 step of length h from x to xn (each 3 x m: q, v, s); u relaxes from ``lag`` to ``u`` when tau > 0.

    wk (12, m) holds the stage slopes.
    """
    n = f.shape[1]
    for stage in range(4):
        c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        ut = u if tau <= 0.0 else u + (lag - u) * np.exp(-c * h / tau)
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
        _rates(f, gap_law, gain, el, p, xn, t + c * h, ut, mode, w, z)
        b = 3 * stage
        for i in range(n):
            wk[b, i] = xn[1, i]
            wk[b + 1, i] = w[0, i] if mode[0, i] != 0 else 0.0
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


@njit(cache=True, nogil=True)
def _margin(event, f, gap_law, gain, el, p, x, t, u, mode, w, z):
    """Event function, positive while the mode holds. Events 0..n-1: friction of a body; n..: gap of a coupling."""
    n = f.shape[1]
    if event < n:
        if mode[0, event] != 0:
            return mode[0, event] * x[1, event]
        _rates(f, gap_law, gain, el, p, x, t, u, mode, w, z)
        force = w[1, event]
        return min(w[2, event] - force, force + w[3, event])
    j = event - n
    # a kinematic error shifts the deflection, so it is read from the rates when there is one
    if el.shape[0] > 0 and el[0, 0] == KIND_TWIST:
        _rates(f, gap_law, gain, el, p, x, t, u, mode, w, z)
        d = w[12, j]
    else:
        d = f[2, j] * x[0, j] - x[0, j + 1]
    if mode[1, j] != 0:
        return mode[1, j] * d - f[5, j]
    return f[5, j] - abs(d)


@njit(cache=True, nogil=True)
def _settle(f, gap_law, gain, el, p, x, t, u, mode, w, z):
    """Re-decide stick or slip of every body at rest, after the torques jumped."""
    n = f.shape[1]
    for _ in range(2):
        for i in range(n):
            if mode[2, i] == 1 and x[1, i] == 0.0:
                old = mode[0, i]
                mode[0, i] = 0
                _rates(f, gap_law, gain, el, p, x, t, u, mode, w, z)
                force = w[1, i]
                if force > w[2, i] or (force >= w[2, i] and old == 1):
                    mode[0, i] = 1
                elif force < -w[3, i] or (force <= -w[3, i] and old == -1):
                    mode[0, i] = -1


@njit(cache=True, nogil=True)
def integrate(f, gap_law, gain, el, p, has_friction, u, dt, shift, split, before, tau, n_sub, x0, s0, angle, locked, t0, out):
    """Free run. u (N) torque held over each sample; out (N, 2 n + n_s + n-1) receives q, v, s, coupling torques.

    The input is delayed by ``shift`` whole samples and the fraction ``split`` of a sample (0 <= split < 1); ``before`` is the
    torque ahead of the first sample; tau > 0 lags it. angle (N): measured angle of body 0 for laws locked to it, used when ``locked``. Returns (status, sample): 0 done,
    1 diverged at that sample.
    """
    n = f.shape[1]
    n_s = s0.shape[0]
    m = max(n, n_s, 1)
    x = np.zeros((3, m))
    xn = np.zeros((3, m))
    xt = np.zeros((3, m))
    w = np.zeros((14, m))
    z = np.zeros(N_LOCAL + 3)
    wk = np.zeros((16, m))
    mode = np.zeros((3, n), np.int64)
    for i in range(n):
        x[0, i] = x0[0, i]
        x[1, i] = x0[1, i]
        if has_friction[i]:
            mode[2, i] = 1
            mode[0, i] = 1 if x[1, i] > 0 else (-1 if x[1, i] < 0 else 0)
        else:
            mode[0, i] = 1
    for i in range(n_s):
        x[2, i] = s0[i]
    _rates(f, gap_law, gain, el, p, x, t0, u[0], mode, w, z)
    for j in range(n - 1):
        if f[5, j] > 0.0:
            mode[1, j] = 1 if w[12, j] > f[5, j] else (-1 if w[12, j] < -f[5, j] else 0)
    total = u.shape[0]
    n_event = 2 * n - 1
    ratio = np.ones(n)
    for i in range(1, n):
        ratio[i] = ratio[i - 1] * f[2, i - 1]
    any_event = False
    for i in range(n):
        any_event = any_event or has_friction[i] or f[5, i] > 0.0
    lag = before
    for k in range(total):
        t = t0 + k * dt
        if locked:
            off = angle[k] - x[0, 0]
            for i in range(n):
                w[13, i] = ratio[i] * off
        for i in range(n):
            out[k, i] = x[0, i]
            out[k, n + i] = x[1, i]
        for i in range(n_s):
            out[k, 2 * n + i] = x[2, i]
        if n > 1:
            _rates(f, gap_law, gain, el, p, x, t, u[k], mode, w, z)
            for j in range(n - 1):
                out[k, 2 * n + n_s + j] = w[4, j]
        if not np.isfinite(x[1, 0]) or abs(x[1, 0]) > 1e12:
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
                if any_event:
                    ue = uk if tau <= 0.0 else lag
                    _settle(f, gap_law, gain, el, p, x, t, ue, mode, w, z)
                while left > 0.0:
                    _step(f, gap_law, gain, el, p, x, xn, left, t, uk, lag, tau, n_s, mode, w, wk, z)
                    h = left
                    hit = -1
                    if any_event and events < MAX_EVENTS:
                        ue = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-h / tau)
                        for ev in range(n_event):
                            if ev < n and not has_friction[ev]:
                                continue
                            if ev >= n and f[5, ev - n] <= 0.0:
                                continue
                            g = _margin(ev, f, gap_law, gain, el, p, xn, t + h, ue, mode, w, z)
                            if g >= 0.0:
                                continue
                            # bracket [lo, hi]: holds at lo, violated at hi
                            lo, hi, ghi = 0.0, h, g
                            glo = _margin(ev, f, gap_law, gain, el, p, x, t, lag if tau > 0.0 else uk, mode, w, z)
                            if glo <= 0.0:
                                # the mode was entered at this very instant: look for a moment at which it holds
                                probe = 0.5 * h
                                while probe > 1e-6 * dt:
                                    _step(f, gap_law, gain, el, p, x, xt, probe, t, uk, lag, tau, n_s, mode, w, wk, z)
                                    up = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-probe / tau)
                                    gp = _margin(ev, f, gap_law, gain, el, p, xt, t + probe, up, mode, w, z)
                                    if gp > 0.0:
                                        lo, glo = probe, gp
                                        break
                                    hi, ghi = probe, gp
                                    probe *= 0.5
                            side = 0
                            if glo > 0.0:
                                for _it in range(60):
                                    if hi - lo < 1e-13 + 1e-12 * dt:
                                        break
                                    mid = (lo * ghi - hi * glo) / (ghi - glo)
                                    if not (mid > lo and mid < hi):
                                        mid = 0.5 * (lo + hi)
                                    _step(f, gap_law, gain, el, p, x, xt, mid, t, uk, lag, tau, n_s, mode, w, wk, z)
                                    um = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-mid / tau)
                                    gm = _margin(ev, f, gap_law, gain, el, p, xt, t + mid, um, mode, w, z)
                                    if gm < 0.0:
                                        hi, ghi = mid, gm
                                        if side == -1:
                                            glo *= 0.5
                                        side = -1
                                        if gm > -1e-15:
                                            break
                                    else:
                                        lo, glo = mid, gm
                                        if gm == 0.0:
                                            hi = mid
                                            break
                                        if side == 1:
                                            ghi *= 0.5
                                        side = 1
                            h = hi
                            hit = ev
                            _step(f, gap_law, gain, el, p, x, xn, h, t, uk, lag, tau, n_s, mode, w, wk, z)
                            ue = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-h / tau)
                    for i in range(n):
                        x[0, i] = xn[0, i]
                        x[1, i] = xn[1, i]
                    for i in range(n_s):
                        x[2, i] = xn[2, i]
                    t += h
                    left -= h
                    if left < 1e-15:
                        left = 0.0
                    lag = uk + (lag - uk) * np.exp(-h / tau) if tau > 0.0 else uk
                    if hit >= 0:
                        events += 1
                        if hit < n:
                            if mode[0, hit] != 0:
                                x[1, hit] = 0.0
                                mode[0, hit] = 0
                            else:
                                _rates(f, gap_law, gain, el, p, x, t, lag, mode, w, z)
                                mode[0, hit] = 1 if w[1, hit] > 0.5 * (w[2, hit] - w[3, hit]) else -1
                        else:
                            j = hit - n
                            if mode[1, j] != 0:
                                mode[1, j] = 0
                            else:
                                _rates(f, gap_law, gain, el, p, x, t, lag, mode, w, z)
                                mode[1, j] = 1 if w[12, j] > 0 else -1
                        _settle(f, gap_law, gain, el, p, x, t, lag, mode, w, z)
    return 0, total


@njit(cache=True, nogil=True)
def drive(f, gap_law, gain, el, p, q0, v0, a0, dt, n_sub, t0, rest, out):
    """Inverse dynamics: body 0 is moved as measured (q0, v0, a0, each (N)); out (N) receives the input torque that this needs.

    Bodies behind it run free from the deflections ``rest`` (2, n) relative to a rigid chain. Friction of body 0 takes the
    direction of v0; the other bodies' friction acts by direction too. Returns (status, sample).
    """
    n = f.shape[1]
    n_s = 0
    for e in range(el.shape[0]):
        if el[e, 4] >= 0:
            n_s += 1
    m = max(n, n_s, 1)
    x = np.zeros((3, m))
    xn = np.zeros((3, m))
    w = np.zeros((14, m))
    z = np.zeros(N_LOCAL + 3)
    wk = np.zeros((16, m))
    mode = np.zeros((3, n), np.int64)
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
        _rates(f, gap_law, gain, el, p, x, t, 0.0, mode, w, z)
        out[k] = (w[11, 0] * a0[k] - w[1, 0] + w[10, 0]) / gain
        if not np.isfinite(out[k]):
            return 1, k
        if k == total - 1:
            break
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
                _rates(f, gap_law, gain, el, p, xn, t + g * dt, 0.0, mode, w, z)
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
