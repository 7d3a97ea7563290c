"""Excitations: commanded torques, and references of a velocity loop, as plain arrays; what is random comes from a Generator."""

from __future__ import annotations

import dataclasses
import enum
import math
from dataclasses import dataclass

import numpy as np

from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.ode import DivergedError
from mjsim.system import System, assemble

__all__ = ["Cascade", "Grid", "chirp", "close_loop", "multisine", "samples", "step", "trapezoids"]


def samples(duration: float, dt: float) -> int:
    """Number of samples of a record of this length [s]. Raises InputError for one that no array can hold."""
    count = duration / dt
    if not count <= np.iinfo(np.intp).max // np.dtype(float).itemsize:
        raise InputError("duration", f"{duration:g} s in samples of {dt:g} s", "fewer samples", "shorten it")
    return round(count)


def chirp(duration: float, dt: float, amplitude: float, low: float, high: float) -> np.ndarray:
    """Linear chirp from ``low`` to ``high`` [Hz], constant amplitude [N m | N]."""
    t = dt * np.arange(samples(duration, dt))
    return np.asarray(amplitude * np.sin(2 * math.pi * (low * t + (high - low) / (2 * duration) * t * t)))


class Grid(enum.Enum):
    """Which lines of a multisine are excited."""

    FULL = "full"
    ODD = "odd"  # even distortions fall on lines that are free


def multisine(
    rng: np.random.Generator, duration: float, dt: float, rms: float, low: float, high: float, *, period: float, grid: Grid
) -> np.ndarray:
    """Random-phase multisine with flat amplitude on the lines n / period within [low, high] Hz, repeated for the duration.

    ``rms`` [N m | N] of one period; phases are drawn uniformly, one per line, lowest line first.
    """
    count = samples(period, dt)
    first, last = max(1, math.ceil(low * period - 1e-9)), math.floor(high * period + 1e-9)
    lines = [n for n in range(first, last + 1) if grid is Grid.FULL or n % 2]
    if not lines or last >= count // 2:
        raise ValueError(f"no multisine lines between {low} and {high} Hz for a period of {period} s at dt = {dt} s")
    spectrum = np.zeros(count // 2 + 1, complex)
    spectrum[lines] = np.exp(1j * rng.uniform(0.0, 2 * math.pi, len(lines)))
    one = np.fft.irfft(spectrum, count)
    one *= rms / math.sqrt(np.mean(one**2))
    return np.resize(one, samples(duration, dt))


def step(duration: float, dt: float, amplitude: float, at: float) -> np.ndarray:
    """Zero, and ``amplitude`` [N m | N] from the time ``at`` [s] on."""
    return np.where(dt * np.arange(samples(duration, dt)) >= at - 1e-12, amplitude, 0.0)


def trapezoids(duration: float, dt: float, speed: float, acceleration: float, hold: float, rest: float) -> np.ndarray:
    """Velocity reference [rad/s | m/s]: trapezoids to and fro, with ``hold`` at speed and ``rest`` between them [s]."""
    flank = speed / acceleration
    half = 2 * flank + hold + rest
    t = dt * np.arange(samples(duration, dt))
    phase, side = np.mod(t, half), np.where(np.mod(t, 2 * half) < half, 1.0, -1.0)
    shape = np.minimum(np.minimum(phase / flank, (2 * flank + hold - phase) / flank), 1.0)
    return np.asarray(side * speed * np.maximum(shape, 0.0))


@dataclass(frozen=True)
class Cascade:
    """P position loop around a PI velocity loop: u = kp_v (w - v) + ki_v integral(w - v), w = v_ref + kp_q (q_ref - q).

    ``position_gain`` [1/s], ``velocity_gain`` [N m s/rad | N s/m], ``integral_gain`` [N m/rad | N/m]; ``limit`` [N m | N] of the
    command, at which the integral stands still.
    """

    position_gain: float
    velocity_gain: float
    integral_gain: float
    limit: float


def close_loop(axis: Axis, reference: np.ndarray, dt: float, cascade: Cascade, noise: np.ndarray | None = None) -> np.ndarray:
    """Commanded torque (N,) with which a cascade moves the axis along a velocity reference (N,), sampled every dt [s].

    The loop is closed over the analytic ODE, sample by sample; ``noise`` (N,) is added to the velocity that the controller sees.
    """
    from mjsim import kernel

    # one sample at a time, plain Runge-Kutta costs less than setting up propagators
    s: System = dataclasses.replace(assemble(axis), affine=False)
    if s.output_lag > 0 or s.output_delay > 0 or (s.input_lag > 0 and s.input_delay > 0):
        raise InputError("velocity loop", "a lag or delay of the sensor, or a lag and a delay of the actuator",
                         "neither in the loop", "use a torque excitation for this axis")  # fmt: skip
    n, n_s, count = s.n, s.n_states, len(reference)
    whole = math.floor(s.input_delay / dt + 1e-12)
    part = max(0.0, s.input_delay / dt - whole)
    part = part if part >= 1e-9 else 0.0
    target = np.concatenate([[0.0], np.cumsum(0.5 * dt * (reference[1:] + reference[:-1]))])
    command, acting = np.zeros(count), np.zeros(count)
    x, states, integral, before = np.zeros((2, n)), np.zeros(n_s), 0.0, 0.0
    out, n_sub = np.empty((2, 2 * n + n_s + n - 1)), s.substeps(dt, 100.0)
    for k in range(count):
        seen = float(x[1, 0]) + (0.0 if noise is None else float(noise[k]))
        for m in s.output_maps:
            seen = float(m.map.apply(np.array(seen), m.c))
        error = reference[k] + cascade.position_gain * (target[k] - x[0, 0]) - seen
        u = cascade.velocity_gain * error + cascade.integral_gain * (integral + dt * error)
        if abs(u) <= cascade.limit:
            integral += dt * error
        command[k] = min(max(u, -cascade.limit), cascade.limit)
        mapped = command[k : k + 1]
        for i in s.input_maps:
            mapped = i.map.apply(mapped, i.c)
        acting[k] = mapped[0]
        held = acting[k - whole] if k >= whole else 0.0
        if part > 0:
            before = acting[k - whole - 1] if k > whole else 0.0
        status, _, _ = kernel.integrate(
            s.bodies, s.f, s.gap_law, s.gain, s.servo, s.elements, s.parameters, s.has_friction, np.full(2, held),
            np.zeros(2), dt, 0, part,
            before, s.input_lag, n_sub, 1, s.affine, x, states, np.zeros(2), False, 0.0, k * dt, out,
        )  # fmt: skip
        if status or not np.all(np.isfinite(out[1])):
            raise DivergedError(f"the velocity loop diverged at {k * dt:.4f} s; lower the gains of the controller")
        if s.input_lag > 0:
            before = held + (before - held) * math.exp(-dt / s.input_lag)
        x = np.stack([out[1, :n], out[1, n : 2 * n]])
        states = out[1, 2 * n : 2 * n + n_s].copy()
    return command
