"""The analytic ODE of an axis: free run on a torque, and inverse dynamics along a measured motion."""

from __future__ import annotations

import math
import threading
import weakref
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mjsim.axis import Axis, Body, Chain, Coupling
from mjsim.hold import between, slewed
from mjsim.servo import Target
from mjsim.system import STEP, System, assemble
from mjsim.trapezoid import profiled

__all__ = [
    "DivergedError",
    "Trajectory",
    "apply_input",
    "count_work",
    "inverse",
    "load_kernel",
    "sensed",
    "simulate",
    "work_done",
]

_here = threading.local()  # what a thread works in
_copies: dict[int, tuple[weakref.ref[np.ndarray], np.ndarray]] = {}  # of arrays that nobody can change, while they live


class DivergedError(ArithmeticError):
    """The run left the finite numbers; the message says when and what to change."""


@dataclass(frozen=True)
class Trajectory:
    """A simulated motion at the sample times (N samples, n bodies); arrays are read-only.

    time (N) [s]; torque (N): commanded input [N m | N]; velocity, angle (N): measured at body 0, sensor effects included
    [rad/s, rad | m/s, m]; q, v (N, n): true angles and velocities; coupling_torque (N, n-1) [N m | N], link side.
    """

    time: np.ndarray
    torque: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    q: np.ndarray
    v: np.ndarray
    coupling_torque: np.ndarray

    def __post_init__(self) -> None:
        for name in ("time", "torque", "velocity", "angle", "q", "v", "coupling_torque"):
            getattr(self, name).flags.writeable = False


def apply_input(system: System, u: np.ndarray) -> np.ndarray:
    """The memoryless part of the actuator on the commanded torque (N,)."""
    for m in system.input_maps:
        u = m.map.apply(u, m.c)
    return u


def _own(a: np.ndarray) -> np.ndarray:
    """A writable contiguous copy: one array type, so one compiled kernel."""
    return np.array(a, float, order="C")


def _fixed(a: np.ndarray) -> bool:
    """Whether nobody can change its numbers."""
    while isinstance(a, np.ndarray) and not a.flags.writeable:
        if a.base is None:
            return True
        a = a.base
    return False


def _lent(a: np.ndarray) -> np.ndarray:
    """The same numbers as an array of that one type, to be read only: itself, or a copy, which is kept where it stays true."""
    if a.flags.writeable and a.flags.c_contiguous and a.dtype == float:
        return a
    key = id(a)
    known = _copies.get(key)
    if known is not None and known[0]() is a:
        return known[1]
    own = _own(a)
    if _fixed(a):
        _copies[key] = weakref.ref(a, lambda _: _copies.pop(key, None)), own
    return own


def _workspace(count: int, width: int) -> np.ndarray:
    """An array (count, width) that is this thread's until it asks for the next: a fresh one is zeroed by the system each time."""
    held = getattr(_here, "held", None)
    if held is None or held.size < count * width:
        held = _here.held = np.empty(count * width)
    return np.asarray(held[: count * width].reshape(count, width))


def _kept(a: np.ndarray) -> np.ndarray:
    """Itself where nobody can change it, else a copy."""
    return a if isinstance(a, np.ndarray) and a.dtype == float and not a.flags.writeable else np.array(a, float)


@lru_cache(8)
def _times(count: int, dt: float, t0: float) -> np.ndarray:
    """Times (N,) of the samples [s], read-only."""
    time = t0 + dt * np.arange(count)
    time.flags.writeable = False
    return time


def simulate(
    axis: Axis | System,
    torque: np.ndarray,
    dt: float,
    *,
    initial: np.ndarray | None = None,
    states: np.ndarray | None = None,
    angle: np.ndarray | None = None,
    origin: float | None = None,
    t0: float = 0.0,
    before: float = 0.0,
    substeps: int | None = None,
    most_substeps: int = 64,
    step: float = STEP,
    hold: str = "held",
    speed: float | None = None,
) -> Trajectory:
    """Free-run an axis on an input (N,), a torque or the command of a servo, at samples dt [s] apart.

    ``hold``: how the input goes between samples (`mjsim.hold.between`).

    ``initial`` (2, n): angles and velocities at the start, at rest when None; ``states``: internal states of the effects;
    ``angle`` (N,): measured angle of body 0, ahead of what the sensor path does to it; laws that repeat over the angle are
    tied to it, a torque without a spatial frequency (gravity, a spring) acts at the model's own angle and ``origin``, by which
    the model starts at the first measured angle when it is None;
    ``before``: commanded torque ahead of the first sample, which a delay or lag still delivers; ``substeps`` overrides the
    accuracy rule of `System.substeps` by ``step``; a model that needs more than ``most_substeps`` is not run; ``speed``: largest
    speed of body 0 [rad/s | m/s], by which a law that repeats over the angle is resolved: where None that of ``angle``, or 100.
    Raises DivergedError.
    """
    s = (axis if isinstance(axis, System) else assemble(axis)).resolved(dt)
    n, out = s.n, np.empty((len(torque), _width(s)))
    _run(s, torque, dt, initial, states, angle, origin, t0, before, substeps, most_substeps, step, out, hold, speed)
    time = _times(len(torque), dt, t0)
    velocity, measured = _sense(s, out[:, n], out[:, 0], dt)
    return Trajectory(
        time, _kept(torque), velocity.copy(), measured.copy(), out[:, :n], out[:, n : 2 * n], out[:, 2 * n + s.n_states :]
    )  # fmt: skip


def sensed(
    axis: Axis | System,
    torque: np.ndarray,
    dt: float,
    *,
    initial: np.ndarray | None = None,
    angle: np.ndarray | None = None,
    origin: float | None = None,
    before: float = 0.0,
    most_substeps: int = 64,
    step: float = STEP,
    hold: str = "held",
) -> np.ndarray:
    """Velocity (N,) that the sensor shows of the free run of `simulate`, and nothing else of it: what a fit asks for."""
    s = (axis if isinstance(axis, System) else assemble(axis)).resolved(dt)
    out = _workspace(len(torque), _width(s))
    _run(s, torque, dt, initial, None, angle, origin, 0.0, before, None, most_substeps, step, out, hold)
    return _sense(s, out[:, s.n], out[:, 0], dt)[0].copy()


def count_work(products: int) -> None:
    """Add to what this thread has done: what comes after a run takes time too."""
    _here.work = work_done() + products


def work_done() -> int:
    """What the runs of this thread have taken so far, in products of a step (`kernel.integrate`): the same everywhere."""
    return getattr(_here, "work", 0)


def load_kernel(bodies: int) -> None:
    """Load the compiled simulation of so many bodies, or compile it where it was not yet (some 20 s)."""
    chain = Chain(
        tuple(Body("arm", 1.0, 0.1, f"joint{i}") for i in range(bodies)),
        tuple(Coupling("arm", 1.0, 1.0, 0.1, f"joint{i}") for i in range(1, bodies)),
    )
    simulate(Axis(chain), np.zeros(2), 1e-3)


def _width(s: System) -> int:
    """Numbers that a run gives for each sample: angles, velocities, states, coupling torques."""
    return 2 * s.n + s.n_states + s.n - 1


def _run(
    s: System, torque: np.ndarray, dt: float, initial: np.ndarray | None, states: np.ndarray | None, angle: np.ndarray | None,
    origin: float | None, t0: float, before: float, substeps: int | None, most_substeps: int,
    step: float, out: np.ndarray, hold: str = "held", speed: float | None = None,
) -> None:  # fmt: skip
    """Write the free run of `simulate` to ``out`` (N, `_width`)."""
    from mjsim import kernel

    count = len(torque)
    u, slope, before = _input(s, np.asarray(torque, float), dt, hold, before)
    x0 = s.initial(initial)
    s0 = np.zeros(s.n_states) if states is None else _own(states)
    delay = s.input_delay / dt
    shift = math.floor(delay + 1e-12)
    split = max(0.0, delay - shift)
    if split < 1e-9:
        split = 0.0
    locked = angle is not None
    if angle is not None:
        angle = _ahead_of_sensor(s, np.asarray(angle, float), dt)
        origin = float(angle[0] - x0[0, 0]) if origin is None else origin
    if s.spatial > 0 and speed is None:
        speed = float(np.max(np.abs(np.diff(angle)))) / dt if angle is not None and count > 1 else 100.0
    n_sub, parts = (substeps, 1) if substeps else s.steps(dt, speed or 0.0, step)
    if n_sub * parts > most_substeps:
        raise DivergedError(f"the model is too stiff: it needs {n_sub * parts} steps a sample, {most_substeps} are allowed")
    status, at, work = kernel.integrate(
        s.bodies, s.f, s.gap_law, s.gain, s.servo, s.elements, s.parameters, s.has_friction, u, slope, dt, shift, split,
        float(before), s.input_lag, n_sub, parts, s.affine, x0, s0, _lent(angle) if angle is not None else u, locked,
        origin or 0.0, t0, out,
    )  # fmt: skip
    count_work(work)
    if status:
        raise DivergedError(
            f"the run diverged at {t0 + at * dt:.4f} s (body {s.chain.bodies[0].joint!r}); check signs of damping and stiffness"
        )


def _input(s: System, command: np.ndarray, dt: float, hold: str, before: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Input past the actuator's maps at the start of each sample (N,), its slope over the sample (N,), and what it was before."""
    servo = s.chain.servo
    if servo is not None:
        if not (math.isinf(servo.low) and math.isinf(servo.high)):
            command, before = np.clip(command, servo.low, servo.high), min(max(before, servo.low), servo.high)
        command, before = servo.scale * command, servo.scale * before
        if servo.target is Target.INTEGRATED:
            start, slope = between(command, dt, hold)
            mean = start + 0.5 * dt * slope  # the part of second order within a sample is left out
            command = np.concatenate([[0.0], np.cumsum(mean[:-1]) * dt])
            hold, before = "linear", 0.0
        command, before = command - servo.zero, before - servo.zero
    if not (math.isinf(s.slew) and math.isinf(s.acceleration)):
        if math.isinf(s.acceleration):
            start, slope = slewed(command, dt, s.slew, hold)
        else:
            start, slope = profiled(*between(command, dt, hold), dt, s.slew, s.acceleration)
        return _lent(start + s.lead * slope), _lent(slope), before
    u = apply_input(s, command)
    if hold == "held":
        if s.lead:
            u = u + s.lead / dt * np.diff(u, prepend=u[:1])
        return _lent(u), _still(len(u)), before
    start, slope = between(u, dt, hold)
    if s.lead:
        start = start + s.lead * slope
    return _lent(start), _lent(slope), before


@lru_cache(8)
def _still(count: int) -> np.ndarray:
    """Zeros (N,), which nobody writes to."""
    return np.zeros(count)


def _sense(s: System, v: np.ndarray, q: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Sensor path: delay, lag, then the memoryless maps (of the velocity).

    Between samples the angle is the cubic through both angles and velocities: the held torque makes the acceleration jump at
    every sample, so that a spline over several samples, or a straight line, is two orders worse than the motion itself.
    """
    if s.output_delay > 0:
        v, q = _delay(v, q, s.output_delay / dt, dt)
    if s.output_lag > 0:
        v, q = _lag(v, q, s.output_lag, dt)
    for m in s.output_maps:
        v = m.map.apply(v, m.c)
    return v, q


def _ahead_of_sensor(s: System, angle: np.ndarray, dt: float) -> np.ndarray:
    """The angle (N,) of which a late one was measured: q = q_m + lag dq_m/dt, read a delay later (held at the end)."""
    if s.output_lag > 0 and len(angle) > 1:
        angle = angle + s.output_lag * np.gradient(angle, dt)
    if s.output_delay > 0:
        k = np.arange(len(angle))
        angle = np.interp(k + s.output_delay / dt, k, angle)
    return angle


def _cubic(v: np.ndarray, q: np.ndarray, dt: float) -> np.ndarray:
    """(4, N-1): coefficients over g = (t - t_k) / dt of the angle's Hermite cubic in each interval, less its start."""
    step = np.diff(q)
    a, b = dt * v[:-1], dt * v[1:]
    return np.stack([np.zeros_like(a), a, 3 * step - 2 * a - b, a + b - 2 * step])


def _delay(v: np.ndarray, q: np.ndarray, samples: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and angle a number of samples ago, at rest where they start."""
    back = math.ceil(samples - 1e-9)
    g = max(0.0, back - samples)
    c = _cubic(v, q, dt)
    late_q = q[:-1] + g * (c[1] + g * (c[2] + g * c[3]))
    late_v = v[:-1] if g == 0 else (c[1] + g * (2 * c[2] + 3 * g * c[3])) / dt
    head = np.ones(min(back, len(v)))
    tail = max(len(v) - back, 0)
    if back == 0:
        return v, q
    return np.concatenate([v[0] * head, late_v[:tail]]), np.concatenate([q[0] * head, late_q[:tail]])


def _lag(v: np.ndarray, q: np.ndarray, tau: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """First-order lag of both signals, exact for the cubic; they start settled."""
    from mjsim.signals import lfilter

    x = dt / tau
    decay = math.exp(-x)
    if x > 0.1:
        moment = [1.0 - decay]
        for m in (1, 2, 3):
            moment.append(1.0 - m / x * moment[-1])
    else:  # the recursion cancels; Gauss-Legendre is exact to rounding here
        g, weight = np.polynomial.legendre.leggauss(8)
        g, weight = 0.5 * (g + 1), 0.5 * weight
        moment = [float(np.sum(weight * x * np.exp(-x * (1 - g)) * g**m)) for m in range(4)]
    c = _cubic(v, q, dt)
    drive_q = (1.0 - decay) * q[:-1] + sum(moment[m] * c[m] for m in (1, 2, 3))
    drive_v = sum(m * moment[m - 1] * c[m] for m in (1, 2, 3)) / dt
    out = lfilter([1.0], [1.0, -decay], np.column_stack([np.append(v[0], drive_v), np.append(q[0], drive_q)]))
    return out[:, 0], out[:, 1]


def inverse(
    axis: Axis | System,
    angle: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    dt: float,
    *,
    t0: float = 0.0,
    rest: np.ndarray | None = None,
) -> np.ndarray:
    """Input torque (N,) that moves body 0 as measured (each array (N,)); bodies behind it run free from the deflections ``rest``.

    Raises DivergedError, as when the chain behind body 0 is unstable once body 0 is held (non-minimum phase).
    """
    from mjsim import kernel

    s = axis if isinstance(axis, System) else assemble(axis)
    speed = float(np.max(np.abs(velocity))) if len(velocity) else 0.0
    out = np.empty(len(angle))
    n_sub = s.substeps(dt, speed)
    count_work(4 * len(angle) * n_sub)
    status, at = kernel.drive(
        s.bodies, s.f, s.gap_law, s.gain, s.servo, s.elements, s.parameters,
        _own(angle), _own(velocity), _own(acceleration),
        dt, n_sub, t0, np.zeros((2, s.n)) if rest is None else _own(rest), out,
    )  # fmt: skip
    if status:
        raise DivergedError(f"the inverse run diverged at {t0 + at * dt:.4f} s: the chain is unstable when its motor is held")
    return out
