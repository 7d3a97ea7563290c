"""The compiled run of one joint inside a robot under its own servo, the other joints following the recording.

    (M(t) + armature) q'' + b(t, q, q') + damping q' + body torques + friction = drive

M(t): inertia that joint j sees along the recorded motion; b: torque that the links need beside M q'', to first order in the
deviation of q and q' from the recording. One step takes the linear part by the implicit midpoint rule and dry friction by its
proximal map, so that a joint sticks exactly (J. J. Moreau, Unilateral contact and dry friction (1988)). It is of second order
between
events.

Where "soft" s is not zero, dry friction below its level is that of MuJoCo's soft constraint, s (q'' + "soft_rate" q'), taken by
the implicit midpoint rule as well: it lets a joint creep (`mjsim.robot.softness`).

A law is absent where its slot is zero. All slots are at the joint: SI units, gears taken out. "couple_from" is 1 + the index of
the joint that acts on this one. "late" is of the log and "acceleration" of
the command ahead of the run, and neither is used here: see `diagnose.robot.servos.motion.JointProblem.run`.
"""

from __future__ import annotations

import math

import numpy as np

from mjsim.compiled import compiled

__all__ = ["SLOT", "SLOTS", "body_torque", "coupled", "empty", "friction_level", "run_joint"]

SLOTS = (
    "kp", "kv", "damping", "armature", "zero", "limit", "delay", "lag", "dead_band", "slew", "stall", "no_load",
    "friction", "asymmetry", "extra", "stribeck", "load", "load_back", "quadratic", "sublinear", "exponent", "bristle",
    "ripple_sin", "ripple_cos", "order", "rub_sin", "rub_cos", "rub_order", "weight_sin", "weight_cos", "spring", "preload",
    "drift", "drift_time", "cable_2", "cable_3", "cable_4", "cable_low", "cable_high", "payload", "scale",
    "couple_from", "couple_torque", "couple_sign", "couple_speed", "late", "integral", "lead", "acceleration", "soft",
    "soft_rate",
)  # fmt: skip
SLOT = {name: k for k, name in enumerate(SLOTS)}
(KP, KV, DAMPING, ARMATURE, ZERO, LIMIT, DELAY, LAG, DEAD, SLEW, STALL, NO_LOAD, FRICTION, ASYMMETRY, EXTRA, STRIBECK, LOAD,
LOAD_BACK,
 QUADRATIC, SUBLINEAR, EXPONENT, BRISTLE, RIPPLE_S, RIPPLE_C, ORDER, RUB_S, RUB_C, RUB_ORDER, WEIGHT_S, WEIGHT_C, SPRING, PRELOAD,
 DRIFT, DRIFT_TIME, CABLE_2, CABLE_3, CABLE_4, CABLE_LOW, CABLE_HIGH, PAYLOAD, SCALE, COUPLE_FROM,
 COUPLE_TORQUE, COUPLE_SIGN, COUPLE_SPEED, LATE, INTEGRAL, LEAD, ACCELERATION, SOFT, SOFT_RATE) = range(len(SLOTS))  # fmt: skip


def empty() -> np.ndarray:
    """Slots (K,) of a joint without a law: no limit, the links as the file has them."""
    p = np.zeros(len(SLOTS))
    p[LIMIT] = math.inf
    p[SCALE] = 1.0
    return p


@compiled(error_model="numpy", inline="always")
def friction_level(p: np.ndarray, q: float, v: float, load: float, t: float) -> tuple[float, float]:
    """Dry friction for motion upwards and downwards, before the asymmetry."""
    level = p[FRICTION]
    if p[EXTRA] != 0.0:
        level += p[EXTRA] * math.exp(-((v / p[STRIBECK]) ** 2))
    if p[DRIFT] != 0.0:
        level *= 1.0 + p[DRIFT] * math.exp(-t / p[DRIFT_TIME])
    if p[RUB_ORDER] != 0.0:
        level *= 1.0 + p[RUB_S] * math.sin(p[RUB_ORDER] * q) + p[RUB_C] * math.cos(p[RUB_ORDER] * q)
    if p[SUBLINEAR] != 0.0:
        level += p[SUBLINEAR] * abs(v) ** p[EXPONENT]
    if p[LOAD] != 0.0 or p[LOAD_BACK] != 0.0:
        up = p[LOAD] if load > 0.0 else p[LOAD_BACK]  # motion against the load, or with it
        down = p[LOAD_BACK] if load > 0.0 else p[LOAD]
        return level + up * abs(load), level + down * abs(load)
    return level, level


@compiled(error_model="numpy", inline="always")
def body_torque(p: np.ndarray, q: float) -> float:
    """Torque against motion that depends on the position, without the spring's stiffness."""
    T = p[PRELOAD]
    if p[ORDER] != 0.0:
        T += p[RIPPLE_S] * math.sin(p[ORDER] * q) + p[RIPPLE_C] * math.cos(p[ORDER] * q)
    if p[WEIGHT_S] != 0.0 or p[WEIGHT_C] != 0.0:
        T += p[WEIGHT_S] * math.sin(q) + p[WEIGHT_C] * math.cos(q)
    if p[CABLE_HIGH] > p[CABLE_LOW]:
        x = min(max((2.0 * q - p[CABLE_LOW] - p[CABLE_HIGH]) / (p[CABLE_HIGH] - p[CABLE_LOW]), -1.0), 1.0)
        T += p[CABLE_2] * (2 * x * x - 1) + p[CABLE_3] * (4 * x * x - 3) * x + p[CABLE_4] * (8 * x**4 - 8 * x * x + 1)
    return T


@compiled(error_model="numpy", inline="always")
def coupled(p: np.ndarray, torque: float, sign: float, speed: float) -> float:
    """Torque against motion that comes from another joint: its drive's torque, sign of motion, and velocity."""
    return p[COUPLE_SIGN] * sign + p[COUPLE_SPEED] * speed - p[COUPLE_TORQUE] * torque


@compiled(error_model="numpy", inline="always")
def _drive(p: np.ndarray, velocity: bool, r: float, q: float, v: float, wound: float) -> tuple[float, float, float]:
    """The drive as (force at q = 0 and v = 0, stiffness, damping) about the present state; wound: torque of its integral and of
    its feedforward."""
    if velocity:
        constant, stiff, damp = p[KV] * (r - p[ZERO]), 0.0, p[KV]
    else:
        e = r - p[ZERO] - q
        w = p[DEAD]
        if w > 0.0 and abs(e) <= w:
            constant, stiff, damp = 0.0, 0.0, p[KV]
        else:
            shift = 0.0 if w == 0.0 else (w if e > 0.0 else -w)
            constant, stiff, damp = p[KP] * (r - p[ZERO] - shift), p[KP], p[KV]
    constant += wound
    force = constant - stiff * q - damp * v
    high, low, slope = p[LIMIT], -p[LIMIT], 0.0
    if p[STALL] > 0.0:
        slope = p[STALL] / p[NO_LOAD]
        if p[STALL] - slope * v < high:
            high = p[STALL] - slope * v
            if force > high:
                return p[STALL], 0.0, slope
        if -p[STALL] - slope * v > low:
            low = -p[STALL] - slope * v
            if force < low:
                return -p[STALL], 0.0, slope
    if force > high:
        return high, 0.0, 0.0
    if force < low:
        return low, 0.0, 0.0
    return constant, stiff, damp


@compiled(error_model="numpy")
def run_joint(
    p: np.ndarray, velocity: bool, starts: np.ndarray, first: np.ndarray, slope: np.ndarray, series: np.ndarray, dt: float,
    each: int, shift: np.ndarray, q: np.ndarray, v: np.ndarray
) -> None:  # fmt: skip
    """Write position and velocity (N,) of all recordings, one after the other, into q and v.

    p: slots (K,); velocity: whether the command is one; starts (R + 1,): where each recording begins; first, slope (N,):
    command at the
    start of each sample and its slope over it; series (N, 10 + 3 m): inertia, b, db/dq, db/dq', |load| as a signed torque,
    recorded position and velocity, inertia, torque and its db/dq of a unit payload, then of each joint of the robot the torque of
    its drive, the sign of its motion and its velocity; dt [s]; each: steps per sample; shift (R,): torque of a servo's integral
    at the start of each recording beyond what carries the links there.
    """
    h = dt / each
    late = p[DELAY] / dt
    source = 10 + 3 * (int(p[COUPLE_FROM]) - 1) if p[COUPLE_FROM] > 0.0 else -1
    forget = 1.0 - math.exp(-h / p[LAG]) if p[LAG] > 0.0 else 1.0
    held = p[LEAD] != 0.0 and not np.any(slope)
    for run in range(len(starts) - 1):
        a, b = starts[run], starts[run + 1]
        x, w, y = series[a, 5], 0.0, 0.0
        lagged = first[a]
        r = first[a] if not velocity else 0.0
        q[a], v[a] = x, 0.0
        wound, begun = 0.0, 0.0
        if p[INTEGRAL] > 0.0:
            begun = p[SCALE] * series[a, 4] + p[PAYLOAD] * series[a, 8] + body_torque(p, x) + p[SPRING] * x
            begun += shift[run] - p[KP] * (first[a] - p[ZERO] - x)
        for k in range(a, b - 1):
            M0, b0, bq0, bv0 = p[SCALE] * series[k, 0], p[SCALE] * series[k, 1], p[SCALE] * series[k, 2], p[SCALE] * series[k, 3]
            M1, b1, bq1, bv1 = (
                p[SCALE] * series[k + 1, 0],
                p[SCALE] * series[k + 1, 1],
                p[SCALE] * series[k + 1, 2],
                p[SCALE] * series[k + 1, 3],
            )
            load0, load1 = p[SCALE] * series[k, 4], p[SCALE] * series[k + 1, 4]
            if p[PAYLOAD] != 0.0:
                M0, b0, bq0, load0 = (M0 + p[PAYLOAD] * series[k, 7], b0 + p[PAYLOAD] * series[k, 8],
                    bq0 + p[PAYLOAD] * series[k, 9],
                                      load0 + p[PAYLOAD] * series[k, 8])  # fmt: skip
                M1, b1, bq1, load1 = (
                    M1 + p[PAYLOAD] * series[k + 1, 7], b1 + p[PAYLOAD] * series[k + 1, 8], bq1 + p[PAYLOAD] * series[k + 1, 9],
                    load1 + p[PAYLOAD] * series[k + 1, 8],
                )  # fmt: skip
            b0 -= bq0 * series[k, 5] + bv0 * series[k, 6]
            b1 -= bq1 * series[k + 1, 5] + bv1 * series[k + 1, 6]
            for i in range(each):
                f = (i + 0.5) / each
                g = 1.0 - f
                t = (k - a + f) * dt
                # mean of the command over the step, which its arrival may divide
                at = k - a + i / each - late
                n = int(at) if at >= 0.0 else 0
                part = min(max((n + 1 - at) * each, 0.0), 1.0)
                if at <= -1.0 / each:
                    c = first[a]
                else:
                    at = max(at, 0.0)
                    c = first[a + n] + slope[a + n] * (at - n + 0.5 * part / each) * dt
                    if part < 1.0:
                        c = part * c + (1.0 - part) * (first[a + n + 1] + slope[a + n + 1] * 0.5 * (1.0 - part) / each * dt)
                speed = 0.0  # of the target
                if p[LEAD] != 0.0 and at > -1.0 / each:
                    speed = slope[a + n]
                    if held:
                        speed = (first[a + n] - first[a + n - 1]) / dt if n > 0 else 0.0
                        if part < 1.0:
                            speed = part * speed + (1.0 - part) * (first[a + n + 1] - first[a + n]) / dt
                if p[LAG] > 0.0:
                    before = lagged
                    lagged += (c - lagged) * forget
                    c = 0.5 * (before + lagged)
                    speed = (lagged - before) / h
                if p[SLEW] > 0.0:
                    before = r
                    r += min(max(c - r, -p[SLEW] * h), p[SLEW] * h)
                    goal = 0.5 * (before + r)
                    speed = (r - before) / h
                else:
                    goal = c
                M = g * M0 + f * M1 + p[ARMATURE]
                bq, bv, bias, load = g * bq0 + f * bq1, g * bv0 + f * bv1, g * b0 + f * b1, g * load0 + f * load1
                off = goal - p[ZERO] - x
                if p[INTEGRAL] > 0.0:
                    wound = begun + p[INTEGRAL] * 0.5 * h * off
                constant, stiff, damp = _drive(p, velocity, goal, x, w, wound + p[LEAD] * speed)
                F = constant - bias - body_torque(p, x)
                if source >= 0:
                    F -= g * coupled(p, series[k, source], series[k, source + 1], series[k, source + 2])
                    F -= f * coupled(p, series[k + 1, source], series[k + 1, source + 1], series[k + 1, source + 2])
                K = stiff + bq + p[SPRING]
                D = damp + bv + p[DAMPING] + p[QUADRATIC] * abs(w)
                up, down = friction_level(p, x, w, load, t)
                up, down = up + p[ASYMMETRY], down - p[ASYMMETRY]
                if p[BRISTLE] > 0.0:
                    level = up if w >= 0.0 else down
                    # y' = (v - |v| y) / deflection, implicit in the coming step
                    rate = 1.0 - y if w > 0.0 else 1.0 + y
                    F -= level * y
                    D += 0.5 * h * level * max(rate, 0.0) / p[BRISTLE]
                    up = down = 0.0
                A = M / h + 0.5 * D + 0.25 * h * K
                push = w * (M / h - 0.5 * D - 0.25 * h * K) + F - K * x
                rub = push
                if p[SOFT] > 0.0:  # s ((new - w) / h + rate (new + w) / 2) with new = (push - rub) / A
                    ahead, behind = 1.0 / h + 0.5 * p[SOFT_RATE], 0.5 * p[SOFT_RATE] - 1.0 / h
                    rub = p[SOFT] * (ahead * push / A + behind * w) / (1.0 + p[SOFT] * ahead / A)
                new = (push - min(max(rub, -down), up)) / A
                way = 0.5 * h * (w + new)
                if p[BRISTLE] > 0.0 and way != 0.0:
                    s = 1.0 if way > 0.0 else -1.0
                    y = s + (y - s) * math.exp(-abs(way) / p[BRISTLE])
                begun += p[INTEGRAL] * h * (off - 0.5 * way)
                x += way
                w = new
            q[k + 1], v[k + 1] = x, w
