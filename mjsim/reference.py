"""The exact reference: piecewise-affine flow with located events, for the effects that are affine between events.

Between events the axis obeys y' = A y with y = (q, v, lagged input, sensor lags, held input, 1), whose flow is the matrix
exponential. It is summed here as the power series of exp(A s) y, so that every event function is a polynomial in s whose
first root is bracketed and bisected to rounding. No step size enters: this is another algorithm than `mjsim.kernel` (RK4 with
secants), and what both are measured against. Coulomb, static and asymmetric friction, offsets, gaps under each law, further
modes, input and output maps, lags and delays are of this class, in any combination.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mjsim.axis import Axis
from mjsim.compiled import compiled
from mjsim.effects import ports as P  # noqa: N812
from mjsim.ode import DivergedError, Trajectory, apply_input
from mjsim.system import System, assemble, constant, state_matrix

__all__ = ["NotAffineError", "not_affine", "simulate"]

ORDER = 20  # terms of the series: 1^20/20! is below rounding for |A| s <= 1
PARTS = 4  # sub-intervals in which a margin is looked at for a dip
GATED, UNGATED, NO_PULL = 0, 1, 2


class NotAffineError(ValueError):
    """The axis has an effect that is not affine between events: the exact reference does not cover it."""


def not_affine(axis: Axis) -> str | None:
    """Why the exact reference does not cover this axis (one line), or None when it does."""
    for effect in axis.effects:
        for port in effect.ports(axis.chain):
            if isinstance(port, P.Friction):
                if constant(port.law, port.p, 1.0) is None or constant(port.law, port.p, -1.0) is None:
                    return f"the friction level of {effect.key} varies while it slides or sticks"
            elif isinstance(port, P.BodyTorque):
                if port.state or constant(port.law, port.p, 1.0) is None:
                    return f"the torque of {effect.key} is not constant"
            elif isinstance(port, P.CouplingTorque | P.Twist | P.BodyInertia):
                return f"{effect.key} is not affine"
    return None


def _constants(axis: Axis, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 4) sliding level forward, backward, breakaway level forward, backward; (n) constant torques."""
    levels, torque = np.zeros((n, 4)), np.zeros(n)
    for effect in axis.effects:
        for port in effect.ports(axis.chain):
            if isinstance(port, P.Friction):
                forward, backward = constant(port.law, port.p, 1.0), constant(port.law, port.p, -1.0)
                assert forward is not None
                assert backward is not None
                levels[port.body] += (forward[0], backward[0], forward[1], backward[1])
            elif isinstance(port, P.BodyTorque):
                value = constant(port.law, port.p, 1.0)
                assert value is not None
                torque[port.body] += value[0]
    return levels, torque


@compiled()
def _build(f, gap_law, gain, tau, tau_out, levels, torque, mode, a, forces, couplings):  # pragma: no cover
    """A (N, N) of y' = A y in the present modes; rows of the torque balances (n, N) and of the couplings' torques (n, N)."""
    n = f.shape[1]
    size = a.shape[0]
    one, held, lag = size - 1, size - 2, size - 3
    a[:] = 0.0
    forces[:] = 0.0
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
    if tau > 0.0:
        a[lag, lag] = -1.0 / tau
        a[lag, held] = 1.0 / tau
    if tau_out > 0.0:
        for c in range(2):
            a[2 * n + c, 2 * n + c] = -1.0 / tau_out
            a[2 * n + c, c * n] = 1.0 / tau_out


@compiled()
def _margins(f, gap_law, levels, mode, forces, couplings, rows, owner, tol):  # pragma: no cover
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
def _value(series, row, s):  # pragma: no cover
    """Row times the series at s."""
    total = 0.0
    for k in range(ORDER, -1, -1):
        total = total * s + series[k] @ row
    return total


@compiled()
def _poly(c, s):  # pragma: no cover
    total = 0.0
    for k in range(ORDER, -1, -1):
        total = total * s + c[k]
    return total


@compiled()
def _slope(c, s):  # pragma: no cover
    total = 0.0
    for k in range(ORDER, 0, -1):
        total = total * s + k * c[k]
    return total


@compiled()
def _first_root(c, h, tol):  # pragma: no cover
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
def _settle(levels, mode, forces, y, skip):  # pragma: no cover
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


@compiled(inline="always")
def _held(u, k, before):  # pragma: no cover
    """The torque held from sample k on, which lies before the record when negative."""
    return u[k] if k >= 0 else before


@compiled()
def _run(
    f, gap_law, gain, tau, tau_out, levels, torque, has_friction, u, dt, shift, split, before, late, n_sub, x0, out, mid
):  # pragma: no cover
    """Free run; out (N, 2n + 2 + n-1): q, v, lagged q and v, coupling torques; mid: the same at (k + late) dt.

    Returns (status, sample): 0 done, 1 diverged, 2 more than 10000 events in one sample.
    """
    n = f.shape[1]
    size = 2 * n + 5
    a = np.zeros((size, size))
    forces, couplings = np.zeros((n, size)), np.zeros((n, size))
    rows = np.zeros((4 * n, size))
    owner, tol = np.zeros(4 * n, np.int64), np.zeros(4 * n)
    mode = np.zeros((3, n), np.int64)
    series = np.zeros((ORDER + 1, size))
    poly = np.zeros(ORDER + 1)
    y = np.zeros(size)
    y[:n], y[n : 2 * n] = x0[0], x0[1]
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
    total = u.shape[0]
    for k in range(total):
        y[size - 2] = _held(u, k - shift if split <= 0.0 else k - shift - 1, before)
        _build(f, gap_law, gain, tau, tau_out, levels, torque, mode, a, forces, couplings)
        for j in range(n - 1):
            if gap_law == NO_PULL and mode[1, j] != 0:
                pull = mode[1, j] * (couplings[j] @ y) < 0.0
                side = 1 if mode[1, j] > 0 else -1
                mode[1, j] = 2 * side if pull else side
        _build(f, gap_law, gain, tau, tau_out, levels, torque, mode, a, forces, couplings)
        out[k, : 2 * n + 2] = y[: 2 * n + 2]
        for j in range(n - 1):
            out[k, 2 * n + 2 + j] = 0.0 if abs(mode[1, j]) == 2 else couplings[j] @ y
        if not np.isfinite(y[n]) or abs(y[n]) > 1e12:
            return 1, k
        events = 0
        cuts = (0.0, min(split, late), max(split, late), 1.0)
        for part in range(3):
            if part > 0 and cuts[part] == late:
                mid[k, : 2 * n + 2] = y[: 2 * n + 2]
            span = (cuts[part + 1] - cuts[part]) * dt
            if span <= 0.0:
                continue
            y[size - 2] = _held(u, k - shift if cuts[part] >= split else k - shift - 1, before)
            for _sub in range(n_sub):
                left = span / n_sub
                skip = -1
                while left > 0.0:
                    if _settle(levels, mode, forces, y, skip):
                        _build(f, gap_law, gain, tau, tau_out, levels, torque, mode, a, forces, couplings)
                    count = _margins(f, gap_law, levels, mode, forces, couplings, rows, owner, tol)
                    series[0] = y
                    for order in range(ORDER):
                        for r in range(size):
                            total_r = 0.0
                            for c in range(size):
                                total_r += a[r, c] * series[order, c]
                            series[order + 1, r] = total_r / (order + 1)
                    h, hit = left, -1
                    for m in range(count):
                        for order in range(ORDER + 1):
                            dot = 0.0
                            for c in range(size):
                                dot += rows[m, c] * series[order, c]
                            poly[order] = dot
                        s = _first_root(poly, h, tol[m])
                        if s >= 0.0:
                            h, hit = s, owner[m]
                    for r in range(size):
                        total_r = 0.0
                        for order in range(ORDER, -1, -1):
                            total_r = total_r * h + series[order, r]
                        y[r] = total_r
                    left -= h
                    skip = -1
                    if hit < 0:
                        break
                    events += 1
                    if events > 10000:
                        return 2, k
                    if hit < n:
                        if mode[0, hit] != 0:
                            mode[0, hit] = 0
                            y[n + hit] = 0.0
                        else:
                            middle = 0.5 * (levels[hit, 2] - levels[hit, 3])
                            mode[0, hit] = 1 if forces[hit] @ y > middle else -1
                            skip = hit
                    elif hit < 2 * n:
                        j = hit - n
                        if mode[1, j] != 0:
                            mode[1, j] = 0
                        else:
                            mode[1, j] = 1 if f[2, j] * y[j] - y[j + 1] > 0.0 else -1
                            if gap_law == NO_PULL:
                                _build(f, gap_law, gain, tau, tau_out, levels, torque, mode, a, forces, couplings)
                                if mode[1, j] * (couplings[j] @ y) < 0.0:
                                    mode[1, j] *= 2
                    else:
                        j = hit - 2 * n
                        mode[1, j] = mode[1, j] * 2 if abs(mode[1, j]) == 1 else mode[1, j] // 2
                    _build(f, gap_law, gain, tau, tau_out, levels, torque, mode, a, forces, couplings)
    return 0, total


def simulate(
    axis: Axis, torque: np.ndarray, dt: float, *, initial: np.ndarray | None = None, t0: float = 0.0, before: float = 0.0
) -> Trajectory:
    """Free-run a piecewise-affine axis exactly on a commanded torque (N,) held over each sample of dt [s].

    ``initial`` (2, n): angles and velocities at the start, at rest when None; ``before``: commanded torque ahead of the
    first sample. Raises NotAffineError when an effect is not of the class, DivergedError when the run leaves the finite numbers.
    """
    reason = not_affine(axis)
    if reason is not None:
        raise NotAffineError(reason)
    s: System = assemble(axis)
    n, count = s.n, len(torque)
    levels, torques = _constants(axis, n)
    u = np.array(apply_input(s, np.asarray(torque, float)), float)
    x0 = np.zeros((2, n))
    if initial is not None:
        given = np.asarray(initial, float)
        x0[:, : given.shape[1]] = given
        for i in range(given.shape[1], n):
            x0[:, i] = s.f[2, i - 1] * x0[:, i - 1]
    shift, split = _parts(s.input_delay / dt)
    back = math.ceil(s.output_delay / dt - 1e-9)
    late = max(0.0, back - s.output_delay / dt)
    fastest = float(np.max(np.abs(np.linalg.eigvals(state_matrix(s.f)))))
    rates = [fastest, *(1 / tau for tau in (s.input_lag, s.output_lag) if tau > 0)]
    n_sub = max(1, math.ceil(dt * max(rates)))
    out, mid = np.empty((count, 2 * n + 2 + n - 1)), np.empty((count, 2 * n + 2))
    status, at = _run(
        s.f, s.gap_law, s.chain.gain, s.input_lag, s.output_lag, levels, torques, s.has_friction, u, dt, shift, split,
        float(before), late, n_sub, x0, out, mid,
    )  # fmt: skip
    if status:
        what = "diverged" if status == 1 else "met more than 10000 events within one sample"
        raise DivergedError(f"the exact reference {what} at {t0 + at * dt:.4f} s (body {s.chain.bodies[0].joint!r})")
    time = t0 + dt * np.arange(count)
    column = 2 * n if s.output_lag > 0 else 0
    measured: list[Any] = []
    for c in (column + (1 if s.output_lag > 0 else n), column):
        if back == 0:
            measured.append(out[:, c].copy())
        else:
            seen = mid[:, c] if late > 0 else out[:, c]
            measured.append(np.concatenate([np.full(min(back, count), out[0, c]), seen[: max(count - back, 0)]]))
    velocity, angle = measured
    for m in s.output_maps:
        velocity = m.map.apply(velocity, m.c)
    return Trajectory(
        time, np.array(torque, float), velocity, angle, out[:, :n].copy(), out[:, n : 2 * n].copy(), out[:, 2 * n + 2 :].copy()
    )


def _parts(delay: float) -> tuple[int, float]:
    """Whole samples and the fraction of one, with rounding kept out of the fraction."""
    whole = math.floor(delay + 1e-12)
    part = max(0.0, delay - whole)
    return whole, part if part >= 1e-9 else 0.0
