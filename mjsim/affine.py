"""Piecewise-affine flow of a chain with located events, compiled.

Between events y' = A y, y = (q, v, lagged q and v, lagged input, held input, 1). The flow is the power series of exp(A s) y, so
that every event function is a polynomial in s, whose first root is bracketed and bisected to rounding. Modes (3, n): slip of
each body (-1, 0, 1); side of each gap (0 inside, +-1 in contact, +-2 where one that never pulls would); whether it has friction.
"""

from __future__ import annotations

import numpy as np

from mjsim.compiled import compiled

__all__ = ["MAX_EVENTS", "run"]

ORDER = 20  # terms of the series: 1^20/20! is below rounding for |A| s <= 1
PARTS = 4  # sub-intervals in which a margin is looked at for a dip
MAX_EVENTS = 10_000  # per sample
GATED, UNGATED, NO_PULL = 0, 1, 2

_Axis = tuple[np.ndarray, int, float, float, float, np.ndarray, np.ndarray]
"""f (6, n), gap law, gain, input lag, output lag, friction levels (n, 4), constant torques (n)."""

_Work = tuple[np.ndarray, ...]
"""A, torque balances, coupling torques, event functions, their owners and tolerances, power series, polynomial: scratch."""


@compiled()
def _couplings(f: np.ndarray, gap_law: int, mode: np.ndarray, couplings: np.ndarray) -> None:  # pragma: no cover
    """Rows (n, N) of the couplings' torques; N: size of the state."""
    n, one = f.shape[1], couplings.shape[1] - 1
    couplings[:] = 0.0
    for j in range(n - 1):
        gap = mode[1, j]
        # the torque of the coupling were it in contact; a clamped one (mode +-2) keeps this row for its event
        if f[5, j] <= 0.0 or gap != 0:
            side = 1 if gap > 0 else -1
            couplings[j, j] = f[3, j] * f[2, j]
            couplings[j, j + 1] = -f[3, j]
            if f[5, j] > 0.0:
                couplings[j, one] = -f[3, j] * side * f[5, j]
        if f[5, j] <= 0.0 or gap != 0 or gap_law == UNGATED:
            couplings[j, n + j] = f[4, j] * f[2, j]
            couplings[j, n + j + 1] = -f[4, j]


@compiled()
def _lags(n: int, tau: float, tau_out: float, a: np.ndarray) -> None:  # pragma: no cover
    """Rows of the first-order lags of the input and of the sensors."""
    size = a.shape[0]
    held, lag = size - 2, size - 3
    if tau > 0.0:
        a[lag, lag] = -1.0 / tau
        a[lag, held] = 1.0 / tau
    if tau_out > 0.0:
        for c in range(2):
            a[2 * n + c, 2 * n + c] = -1.0 / tau_out
            a[2 * n + c, c * n] = 1.0 / tau_out


@compiled()
def _build(axis: _Axis, mode: np.ndarray, a: np.ndarray, forces: np.ndarray, couplings: np.ndarray) -> None:  # pragma: no cover
    """A (N, N) of y' = A y in the present modes; rows of the torque balances (n, N) and of the couplings' torques (n, N)."""
    f, gap_law, gain, tau, tau_out, levels, torque = axis
    n = f.shape[1]
    size = a.shape[0]
    one, held, lag = size - 1, size - 2, size - 3
    a[:] = 0.0
    forces[:] = 0.0
    _couplings(f, gap_law, mode, couplings)
    for i in range(n):
        a[i, n + i] = 1.0
        forces[i, n + i] -= f[1, i]
        forces[i, one] += torque[i]
        if i == 0:
            forces[i, lag if tau > 0.0 else held] += gain
        if i > 0 and abs(mode[1, i - 1]) != 2:
            forces[i] += couplings[i - 1]
        if i < n - 1 and abs(mode[1, i]) != 2:
            forces[i] -= f[2, i] * couplings[i]
        if mode[2, i] == 0 or mode[0, i] != 0:
            a[n + i] = forces[i] / f[0, i]
            if mode[2, i] == 1:
                level = levels[i, 0] if mode[0, i] > 0 else levels[i, 1]
                a[n + i, one] -= mode[0, i] * level / f[0, i]
    _lags(n, tau, tau_out, a)


@compiled()
def _margins(
    f: np.ndarray, gap_law: int, levels: np.ndarray, mode: np.ndarray, forces: np.ndarray, couplings: np.ndarray,
    rows: np.ndarray, owner: np.ndarray, tol: np.ndarray
) -> int:  # pragma: no cover  # fmt: skip
    """Event functions, positive while the modes hold, as rows over y; owner: body i, or n + coupling, or 2n + coupling (pull)."""
    n = f.shape[1]
    one = rows.shape[1] - 1
    m = 0
    rows[:] = 0.0
    for i in range(n):
        if mode[2, i] == 0:
            continue
        if mode[0, i] != 0:
            rows[m, n + i] = mode[0, i]
            owner[m] = i
            tol[m] = 1e-13
            m += 1
        else:
            rows[m] = -forces[i]
            rows[m, one] += levels[i, 2]
            rows[m + 1] = forces[i]
            rows[m + 1, one] += levels[i, 3]
            for c in range(2):
                owner[m + c] = i
                tol[m + c] = 1e-14 * (levels[i, 2] + levels[i, 3])
            m += 2
    for j in range(n - 1):
        if f[5, j] <= 0.0:
            continue
        if mode[1, j] == 0:
            for c in range(2):
                side = 1.0 if c == 0 else -1.0
                rows[m, j] = -side * f[2, j]
                rows[m, j + 1] = side
                rows[m, one] = f[5, j]
                owner[m] = n + j
                tol[m] = 1e-13 * f[5, j]
                m += 1
        else:
            side = 1.0 if mode[1, j] > 0 else -1.0
            rows[m, j] = side * f[2, j]
            rows[m, j + 1] = -side
            rows[m, one] = -f[5, j]
            owner[m] = n + j
            tol[m] = 1e-13 * f[5, j]
            m += 1
            if gap_law == NO_PULL:
                rows[m] = side * couplings[j] * (1.0 if abs(mode[1, j]) == 1 else -1.0)
                owner[m] = 2 * n + j
                tol[m] = 1e-13 * f[5, j] * f[3, j]
                m += 1
    return m


@compiled()
def _poly(c: np.ndarray, s: float) -> float:  # pragma: no cover
    total = 0.0
    for k in range(ORDER, -1, -1):
        total = total * s + c[k]
    return total


@compiled()
def _slope(c: np.ndarray, s: float) -> float:  # pragma: no cover
    total = 0.0
    for k in range(ORDER, 0, -1):
        total = total * s + k * c[k]
    return total


@compiled()
def _first_root(c: np.ndarray, h: float, tol: float) -> float:  # pragma: no cover
    """First s in (0, h] at which the polynomial turns negative by more than tol, or -1."""
    left = 0.0
    for part in range(PARTS):
        right = h * (part + 1) / PARTS
        at_right = _poly(c, right)
        lo, hi = left, -1.0
        if at_right < -tol:
            hi = right
        elif _slope(c, left) < 0.0 and _slope(c, right) > 0.0:
            a, b = left, right
            for _ in range(60):
                mid = 0.5 * (a + b)
                if _slope(c, mid) < 0.0:
                    a = mid
                else:
                    b = mid
            if _poly(c, a) < -tol:
                hi = a
        if hi >= 0.0:
            for _ in range(80):
                mid = 0.5 * (lo + hi)
                if mid <= lo or mid >= hi:
                    break
                if _poly(c, mid) < 0.0:
                    hi = mid
                else:
                    lo = mid
            return hi
        left = right
    return -1.0


@compiled()
def _settle(levels: np.ndarray, mode: np.ndarray, forces: np.ndarray, y: np.ndarray, skip: int) -> bool:  # pragma: no cover
    """Stick or slip of every body that stands still; True when a mode changed."""
    n = forces.shape[0]
    changed = False
    for i in range(n):
        if mode[2, i] == 0 or i == skip or y[n + i] != 0.0:
            continue
        force = forces[i] @ y
        new = 0
        if force > levels[i, 2]:
            new = 1
        elif force < -levels[i, 3]:
            new = -1
        if new != mode[0, i]:
            mode[0, i] = new
            changed = True
    return changed


@compiled()
def _start(
    f: np.ndarray, has_friction: np.ndarray, x0: np.ndarray, before: float
) -> tuple[np.ndarray, np.ndarray]:  # pragma: no cover
    """State (N) and modes (3, n) at the first sample: slip of the bodies, side of the gaps, which bodies have friction."""
    n = f.shape[1]
    size = 2 * n + 5
    y, mode = np.zeros(size), np.zeros((3, n), np.int64)
    for i in range(n):  # a slice compiles texts of its errors as well
        y[i], y[n + i] = x0[0, i], x0[1, i]
    y[2 * n], y[2 * n + 1] = y[0], y[n]
    y[size - 1], y[size - 3] = 1.0, before
    for i in range(n):
        if has_friction[i]:
            mode[2, i] = 1
            mode[0, i] = 1 if y[n + i] > 0 else (-1 if y[n + i] < 0 else 0)
    for j in range(n - 1):
        if f[5, j] > 0.0:
            d = f[2, j] * y[j] - y[j + 1]
            mode[1, j] = 1 if d > f[5, j] else (-1 if d < -f[5, j] else 0)
    return y, mode


@compiled()
def _clamp(axis: _Axis, y: np.ndarray, mode: np.ndarray, couplings: np.ndarray) -> None:  # pragma: no cover
    """Couplings that never pull transmit nothing (mode +-2) while they would."""
    gap_law = axis[1]
    if gap_law != NO_PULL:
        return
    for j in range(mode.shape[1] - 1):
        if mode[1, j] != 0:
            side = 1 if mode[1, j] > 0 else -1
            mode[1, j] = 2 * side if mode[1, j] * (couplings[j] @ y) < 0.0 else side


@compiled()
def _expand(a: np.ndarray, y: np.ndarray, series: np.ndarray) -> None:  # pragma: no cover
    """The power series (ORDER + 1, N) of exp(A s) y."""
    size = a.shape[0]
    series[0] = y
    for order in range(ORDER):
        for r in range(size):
            total = 0.0
            for c in range(size):
                total += a[r, c] * series[order, c]
            series[order + 1, r] = total / (order + 1)


@compiled()
def _next_event(
    series: np.ndarray, rows: np.ndarray, owner: np.ndarray, tol: np.ndarray, count: int, h: float, poly: np.ndarray
) -> tuple[float, int]:  # pragma: no cover
    """The first event within h: its time and its owner, (h, -1) when there is none."""
    hit = -1
    for m in range(count):
        for order in range(ORDER + 1):
            dot = 0.0
            for c in range(rows.shape[1]):
                dot += rows[m, c] * series[order, c]
            poly[order] = dot
        s = _first_root(poly, h, tol[m])
        if s >= 0.0:
            h, hit = s, owner[m]
    return h, hit


@compiled()
def _flow(series: np.ndarray, h: float, y: np.ndarray) -> None:  # pragma: no cover
    """The state after h."""
    for r in range(y.shape[0]):
        total = 0.0
        for order in range(ORDER, -1, -1):
            total = total * h + series[order, r]
        y[r] = total


@compiled()
def _switch(hit: int, axis: _Axis, y: np.ndarray, mode: np.ndarray, work: _Work) -> int:  # pragma: no cover
    """Change the mode that an event ends; returns the body that has begun to slip, which may stand still yet, or -1."""
    a, forces, couplings = work[0], work[1], work[2]
    f, gap_law, levels = axis[0], axis[1], axis[5]
    n = f.shape[1]
    skip = -1
    if hit < n and mode[0, hit] != 0:
        mode[0, hit] = 0
        y[n + hit] = 0.0
    elif hit < n:
        middle = 0.5 * (levels[hit, 2] - levels[hit, 3])
        mode[0, hit] = 1 if forces[hit] @ y > middle else -1
        skip = hit
    elif hit < 2 * n and mode[1, hit - n] != 0:
        mode[1, hit - n] = 0
    elif hit < 2 * n:
        j = hit - n
        mode[1, j] = 1 if f[2, j] * y[j] - y[j + 1] > 0.0 else -1
        if gap_law == NO_PULL:
            _build(axis, mode, a, forces, couplings)
            if mode[1, j] * (couplings[j] @ y) < 0.0:
                mode[1, j] *= 2
    else:
        j = hit - 2 * n
        mode[1, j] = mode[1, j] * 2 if abs(mode[1, j]) == 1 else mode[1, j] // 2
    _build(axis, mode, a, forces, couplings)
    return skip


@compiled()
def _span(
    axis: _Axis, y: np.ndarray, mode: np.ndarray, work: _Work, span: float, n_sub: int, events: int
) -> int:  # pragma: no cover
    """The state after a span [s] of constant input, in n_sub parts; returns the events so far, -1 when they are too many."""
    a, forces, couplings, rows, owner, tol, series, poly = work
    f, gap_law, levels = axis[0], axis[1], axis[5]
    for _ in range(n_sub):
        left = span / n_sub
        skip = np.int64(-1)
        while left > 0.0:
            if _settle(levels, mode, forces, y, skip):
                _build(axis, mode, a, forces, couplings)
            count = _margins(f, gap_law, levels, mode, forces, couplings, rows, owner, tol)
            _expand(a, y, series)
            h, hit = _next_event(series, rows, owner, tol, count, left, poly)
            _flow(series, h, y)
            left -= h
            if hit < 0:
                break
            events += 1
            if events > MAX_EVENTS:
                return -1
            skip = _switch(hit, axis, y, mode, work)
    return events


@compiled()
def _sample(axis: _Axis, y: np.ndarray, mode: np.ndarray, work: _Work, out: np.ndarray) -> bool:  # pragma: no cover
    """Modes and signals (2n + 2 + n - 1) at the instant of a sample; False when the run has left the finite numbers."""
    a, forces, couplings = work[0], work[1], work[2]
    n = axis[0].shape[1]
    _build(axis, mode, a, forces, couplings)
    _clamp(axis, y, mode, couplings)
    _build(axis, mode, a, forces, couplings)
    out[: 2 * n + 2] = y[: 2 * n + 2]
    for j in range(n - 1):
        out[2 * n + 2 + j] = 0.0 if abs(mode[1, j]) == 2 else couplings[j] @ y
    return bool(np.isfinite(y[n]) and abs(y[n]) <= 1e12)


@compiled(inline="always")
def _held(u: np.ndarray, k: int, before: float) -> float:  # pragma: no cover
    """The torque held from sample k on, which lies before the record when negative."""
    return u[k] if k >= 0 else before


@compiled()
def run(
    axis: _Axis, has_friction: np.ndarray, u: np.ndarray, dt: float, shift: int, split: float, before: float, late: float,
    n_sub: int, x0: np.ndarray, out: np.ndarray, mid: np.ndarray
) -> tuple[int, int]:  # pragma: no cover  # fmt: skip
    """Free run; out (N, 2n + 2 + n-1): q, v, lagged q and v, coupling torques; mid: the same at (k + late) dt.

    axis: (f, gap law, gain, input lag, output lag, friction levels, constant torques). Returns (status, sample): 0 done,
    1 diverged, 2 more than MAX_EVENTS events in one sample.
    """
    n = axis[0].shape[1]
    size = 2 * n + 5
    y, mode = _start(axis[0], has_friction, x0, before)
    work = (
        np.zeros((size, size)), np.zeros((n, size)), np.zeros((n, size)), np.zeros((4 * n, size)), np.zeros(4 * n, np.int64),
        np.zeros(4 * n), np.zeros((ORDER + 1, size)), np.zeros(ORDER + 1),
    )  # fmt: skip
    cuts = (0.0, min(split, late), max(split, late), 1.0)
    for k in range(u.shape[0]):
        y[size - 2] = _held(u, k - shift if split <= 0.0 else k - shift - 1, before)
        if not _sample(axis, y, mode, work, out[k]):
            return 1, k
        events = np.int64(0)  # a literal would be compiled apart
        for part in range(3):
            if part > 0 and cuts[part] == late:
                mid[k, : 2 * n + 2] = y[: 2 * n + 2]
            span = (cuts[part + 1] - cuts[part]) * dt
            if span <= 0.0:
                continue
            y[size - 2] = _held(u, k - shift if cuts[part] >= split else k - shift - 1, before)
            events = _span(axis, y, mode, work, span, n_sub, events)
            if events < 0:
                return 2, k
    return 0, u.shape[0]
