"""The compiled free run, whose steps land on events."""

from __future__ import annotations

import numpy as np

from mjsim.accurate.events import _deflection, _margin, _margins
from mjsim.accurate.step import NO_PULL, _advance, _forward, _laws, _switch
from mjsim.compiled import compiled
from mjsim.effects.law import N_LOCAL
from mjsim.kernel import _dips

__all__: list[str] = []

MAX_EVENTS = 256  # per sample


@compiled()
def _run(
    mj: np.ndarray, staged: bool, f: np.ndarray, gap_law: int, gain: float, el: np.ndarray, p: np.ndarray,
    has_friction: np.ndarray, nominal: np.ndarray, u: np.ndarray, dt: float, shift: int, split: float, before: float, tau: float,
    n_sub: int, x0: np.ndarray, s0: np.ndarray, t0: float, out: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, qacc: np.ndarray,
    smooth: np.ndarray, ctrl: np.ndarray, applied: np.ndarray, armature: np.ndarray, m0: np.ndarray, stiffness: np.ndarray,
    damping: np.ndarray, reference: np.ndarray, timestep: np.ndarray
) -> tuple[int, int]:  # pragma: no cover  # fmt: skip
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
            _laws(f, gap_law, gain, el, p, x, t, u[k], mode, applied, extra, level, slope, torque, z)
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
                                mj, f, gap_law, gain, el, p, x, t, lag if tau > 0.0 else uk, mode, level, slope, torque, z, extra,
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
                            mj, staged, f, gap_law, gain, el, p, x, ahead, reach, t, uk, lag, tau, n_s, mode, level, slope,
                            torque, z, extra, wk, qpos, qvel, qacc, ctrl, applied, armature, m0, timestep,
                        )  # fmt: skip
                        if not eventful or events >= MAX_EVENTS:
                            break
                        up = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-reach / tau)
                        _margins(
                            mj, f, gap_law, gain, el, p, ahead, t + reach, up, mode, level, slope, torque, z, extra, qpos, qvel,
                            ctrl, smooth, applied, armature, m0, g1,
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
                                    mj, staged, f, gap_law, gain, el, p, x, xt, mid, t, uk, lag, tau, n_s, mode, level, slope,
                                    torque, z, extra, wk, qpos, qvel, qacc, ctrl, applied, armature, m0, timestep,
                                )  # fmt: skip
                                um = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-mid / tau)
                                gm = _margin(
                                    ev, mj, f, gap_law, gain, el, p, xt, t + mid, um, mode, level, slope, torque, z, extra,
                                    qpos, qvel, ctrl, smooth, applied, armature, m0,
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
                                mj, staged, f, gap_law, gain, el, p, x, xn, h, t, uk, lag, tau, n_s, mode, level, slope, torque,
                                z, extra, wk, qpos, qvel, qacc, ctrl, applied, armature, m0, timestep,
                            )  # fmt: skip
                            up = uk if tau <= 0.0 else uk + (lag - uk) * np.exp(-h / tau)
                            _margins(
                                mj, f, gap_law, gain, el, p, xn, t + h, up, mode, level, slope, torque, z, extra, qpos, qvel,
                                ctrl, smooth, applied, armature, m0, g1,
                            )  # fmt: skip
                        if hit >= 0 or not near:
                            break
                        # the slopes at both ends, by MuJoCo's forward dynamics, tell where it could dip
                        near, low = False, h
                        for i in range(n):
                            if mode[2, i] == 0 or mode[0, i] == 0:
                                continue
                            _forward(
                                mj, f, gap_law, gain, el, p, x, t, lag if tau > 0.0 else uk, mode, level, slope, torque, z, extra,
                                qpos, qvel, ctrl, applied, armature, m0,
                            )  # fmt: skip
                            s0 = mode[0, i] * qacc[i]
                            _forward(
                                mj, f, gap_law, gain, el, p, xn, t + h, up, mode, level, slope, torque, z, extra, qpos, qvel,
                                ctrl, applied, armature, m0,
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
                                mj, f, gap_law, gain, el, p, x, t, lag, mode, level, slope, torque, z, extra, qpos, qvel, ctrl,
                                applied, armature, m0,
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
                                _laws(f, gap_law, gain, el, p, x, t, lag, mode, applied, extra, level, slope, torque, z)
                                if mode[1, j] * torque[j] < 0.0:
                                    mode[1, j] *= 2
                    else:
                        j = hit - 2 * n
                        mode[1, j] = mode[1, j] * 2 if abs(mode[1, j]) == 1 else mode[1, j] // 2
                    _switch(f, gap_law, nominal, mode, stiffness, damping, reference)
    return 0, total
