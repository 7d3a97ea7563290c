"""The time base of a log: its uniform sample time, stamps that jitter, and commands with stamps of their own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mjsim.errors import InputError
from mjsim.signals import value_step

__all__ = [
    "grid_of",
    "grid_step",
    "lacking",
    "noise_after",
    "off_by",
    "onto_stamps",
    "rate_of",
    "resample",
    "rounded_up",
    "sample_time",
    "unrounded",
    "where_in",
]

PRINTED = 1e-6  # part of dt: what printing in decimals leaves of uniform stamps
UNIFORM = 0.05  # part of dt: a printed time stamp is rounded, a missing or shifted sample is off by a good part of dt

DIGITS = 30
LARGEST = 10.0**DIGITS
"""Largest size of a value in SI units, its inverse the smallest: products of several of them are finite and not zero."""


GAP = 1.5  # sample times: a longer step lacks a sample
COARSEST = 6  # powers of ten below a second that a grid of stamps may have


def grid_step(time: np.ndarray) -> float:
    """The coarsest decimal grid [s] from 1 s on that all stamps (N,) lie on, as far as float64 shows; 0 where there is none."""
    since = time - time[0]
    digits = 4.0 * np.finfo(float).eps * float(np.max(np.abs(time)))
    for k in range(COARSEST + 1):
        g = 10.0**-k
        if digits < 1e-2 * g and np.all(np.abs(since - g * np.round(since / g)) < max(digits, 1e-6 * g)):
            return g
    return 0.0


def unrounded(time: np.ndarray) -> tuple[np.ndarray, str]:
    """Uniform stamps that were rounded to a grid (whole milliseconds), as they were before, and a note.

    Stamps round((a + k dt) / g) g are off the line a + k dt by half a grid step g at most, and their steps by a whole one. The
    stamps as they are, and no note, where they are uniform, g is too small to matter or a sample was taken at another time: the
    line of least squares errs by 2 / sqrt(N) of the rounding's rms at its ends.
    """
    n = len(time)
    if n < 3 or np.any(np.diff(time) <= 0):
        return time, ""
    g, dt = grid_step(time), float((time[-1] - time[0]) / (n - 1))
    if g <= UNIFORM * dt:
        return time, ""
    k = np.arange(n)
    slope, start = np.polyfit(k, time - time[0], 1)
    off = float(np.max(np.abs(time - time[0] - start - slope * k)))
    if off <= PRINTED * dt or off > g * (0.5 + 4.0 * 2.0 / math.sqrt(12.0 * n)):
        return time, ""
    note = (
        f"The time stamps are rounded to {1e3 * g:g} ms, and agree with uniform sampling at {1e3 * slope:.6g} ms to within half "
        "of that: the samples are taken as uniform."
    )
    return time[0] + slope * k, note


def rate_of(time: np.ndarray) -> float:
    """The sample time [s] of increasing stamps (N,): the mean step, of those that lack no sample."""
    steps = np.diff(time)
    middle, g = float(np.median(steps)), grid_step(time)
    about = float(np.mean(steps[np.abs(steps - middle) <= max(g, 0.5 * middle) * (1.0 + 1e-9)]))
    return float(np.mean(np.delete(steps, lacking(time, about))))


def lacking(time: np.ndarray, dt: float) -> np.ndarray:
    """Steps at which samples are missing: the stamps after them stay late by half a sample or more (their median over ten)."""
    phase, steps = time / dt - np.arange(len(time)), np.diff(time)
    found = []
    for i in np.flatnonzero(steps >= GAP * dt):
        before, after = phase[max(i - 9, 0) : i + 1], phase[i + 1 : i + 11]
        if np.median(after) - np.median(before) >= GAP - 1:
            found.append(i)
    return np.array(found, int)


def where_in(path: Path, index: int) -> str:
    """How a user finds a sample in the file: by its row in a CSV, of which the header is row 1, else by its number from 1 on."""
    return f"row {index + 2}" if path.suffix.lower() == ".csv" else f"sample {index + 1}"


def need_numbers(path: Path, name: str, values: np.ndarray) -> None:
    """Raise InputError for a channel (N,) with a value that is not finite, or of a size that no quantity in SI units has."""
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise InputError(
            path, f"{name} is not finite in {where_in(path, int(bad[0]))}", "a number", "remove or interpolate these samples"
        )
    at = int(np.argmax(np.abs(values))) if len(values) else 0
    largest = float(abs(values[at])) if len(values) else 0.0
    if largest > LARGEST or 0 < largest < 1 / LARGEST:
        said = f"{name} is {values[at]:.3g} in {where_in(path, at)}, its largest value"
        raise InputError(path, said, f"1e-{DIGITS} to 1e{DIGITS} in SI units", "check unit and gain")


def sample_time(path: Path, time: np.ndarray, jitter: float = 0.0, *, uniform: bool = True, gaps: bool = False) -> float:
    """The uniform sample time [s] of stamps (N,), or an InputError that names the row at which it is not.

    ``jitter``: part of the sample time by which a step may be off; ``gaps``: where a jitter is declared, steps that lack samples
    are let through; ``uniform``: refuse others. Where steps are off, the mean is taken of those that lack no sample (`rate_of`).
    """
    if len(time) < 2:
        raise InputError(path, f"{len(time)} samples", "at least two", "record longer")
    step = np.diff(time)
    back = np.flatnonzero(step <= 0)
    if len(back):
        raise InputError(
            path, f"time does not increase at {where_in(path, back[0] + 1)}", "increasing time", "sort or remove these rows"
        )
    dt = float((time[-1] - time[0]) / (len(time) - 1))
    off = np.flatnonzero(np.abs(step - dt) > UNIFORM * dt)
    if not len(off):
        return float(f"{dt:.9g}")
    rate = rate_of(time)
    most = off_by(time, rate, gaps=gaps)
    if not uniform or (jitter and most <= jitter):
        return float(f"{rate:.9g}")
    number = len(lacking(time, rate)) if gaps else 0
    raise InputError(
        path, f"sample time {step[off[0]]:.6g} s at {where_in(path, off[0] + 1)}, elsewhere {rate:.6g} s", "uniform sampling",
        "resample to a uniform grid first; if only the stamps jitter, give [recording] dt in the binding, and no time; "
        f"if the samples were taken at these times, jitter = {rounded_up(max(most, UNIFORM)):g} resamples them"
        + (f", and what lies in the {number} gaps is not compared" if number else ""),
    )  # fmt: skip


def off_by(time: np.ndarray, dt: float, *, gaps: bool) -> float:
    """The largest part of the sample time by which a step is off; ``gaps``: of those that lack no sample."""
    off = np.abs(np.diff(time) - dt) / dt
    if gaps:
        off = np.delete(off, lacking(time, dt))
    return float(np.max(off, initial=0.0))


def rounded_up(x: float) -> float:
    """The next number above x > 0 with two significant digits: what is printed is enough."""
    unit = 10.0 ** (math.floor(math.log10(x)) - 1)
    return float(f"{math.ceil(x / unit * (1.0 + 1e-9)) * unit:.3g}")


def onto_stamps(path: Path, values: np.ndarray, stamps: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, str]:
    """A command (N,) with stamps of its own, interpolated in straight lines onto the stamps of the state, and a note.

    The note is empty where both stamps are the same, to a thousandth of a sample.
    """
    back = np.flatnonzero(np.diff(stamps) <= 0)
    if len(back):
        raise InputError(
            path, f"the time of the command does not increase at {where_in(path, back[0] + 1)}", "increasing time",
            "sort or remove these rows",
        )  # fmt: skip
    apart = time - stamps
    if np.max(np.abs(apart)) < 1e-3 * float(np.median(np.diff(time))):
        return values, ""
    note = (
        f"The command has time stamps of its own, {1e3 * float(np.median(apart)):.3g} ms (median) before those of the state "
        f"(from {1e3 * float(np.min(apart)):.3g} to {1e3 * float(np.max(apart)):.3g} ms): it was interpolated onto these."
    )
    return np.interp(time, stamps, values), note


def grid_of(time: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """The uniform grid (M,) [s] from the first to the last of the stamps (N,), and which of it (M,) lies where samples lack."""
    grid = time[0] + dt * np.arange(math.floor((time[-1] - time[0]) / dt + 0.01) + 1)
    missing = np.zeros(len(grid), bool)
    for i in lacking(time, dt):
        missing |= (grid > time[i] + 0.5 * dt) & (grid < time[i + 1] - 0.5 * dt)
    return grid, missing


def resample(arrays: dict[str, np.ndarray], hold: str, dt: float) -> tuple[dict[str, np.ndarray], str]:
    """Channels (N,) at jittered stamps ``time`` on the uniform grid of the same ends, and a note; "" where stamps are uniform.

    Inputs are resampled exactly for how they are held: of a held or averaged input the mean over each new sample is kept, a
    linear one is read off its lines. Outputs are read off a cubic spline. ``missing`` (M,) bool is among the channels where
    samples lack (`grid_of`): what the others are there is no measurement.
    """
    time = arrays["time"]
    grid, missing = grid_of(time, dt)
    worst = 0.0 if missing.any() else float(np.max(np.abs(time - grid)))
    if worst < 1e-6 * dt and not missing.any():
        return arrays, ""
    out = {}
    for name, y in arrays.items():
        if name == "time":
            out[name] = grid
        elif name in ("torque", "command", "control"):
            out[name] = np.interp(grid, time, y) if hold == "linear" else _means(time, y, grid, dt, hold)
        elif name == "known_torque":
            out[name] = np.interp(grid, time, y)
        else:
            out[name] = _spline(time, y, np.clip(grid, time[0], time[-1]))
    gaps = lacking(time, dt)
    jitter = float(np.max(np.abs(np.delete(np.diff(time), gaps) - dt), initial=0.0))
    onto = f"to {'a grid' if len(gaps) else 'one'} of {1e3 * dt:.6g} ms"
    stray = "" if len(gaps) else f" and stray up to {1e3 * worst:.3g} ms from a uniform grid"
    note = (
        f"The time stamps jitter by up to {1e3 * jitter:.3g} ms a step{stray}: all channels were resampled {onto}, the input for "
        f"being {hold}."
    )
    if missing.any():
        out["missing"] = missing
        note += f" {int(missing.sum())} of its {len(grid)} samples lie in {len(gaps)} gaps of the stamps, and are not compared."
    return out, note


ORDER = 6  # of the differences that leave noise alone
DRAWS = 20_000  # values of noise that are resampled to see what becomes of it: their rms is known to 0.5 %


def noise_after(time: np.ndarray, arrays: Mapping[str, np.ndarray], dt: float) -> dict[str, float]:
    """Rms of the white noise of channels (N,) at jittered stamps once they were resampled; {} where there are too few samples.

    What a spline makes of noise depends on how far the new samples are from the old ones, and is no longer white: differences of
    the new samples tell too little. So its rms s is taken before, from divided differences of order 6,

        d_i = sum_k w_ik y_(i+k) / sqrt(sum_k w_ik^2),    w_ik = 1 / prod_(m != k) (t_(i+k) - t_(i+m)),

    whose rms is s for white noise and that is 0 for a polynomial of degree 5; at least that of rounding to the steps in which
    all values of a channel lie; and times the rms of resampled noise of rms 1.
    """
    if len(time) < 2 * ORDER:
        return {}
    stamps = np.lib.stride_tricks.sliding_window_view(time / dt, ORDER + 1)
    apart = stamps[:, :, None] - stamps[:, None, :]
    apart[:, np.arange(ORDER + 1), np.arange(ORDER + 1)] = 1.0
    weights = 1.0 / np.prod(apart, axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((len(time), -(-DRAWS // len(time))))
    grid, missing = grid_of(time, dt)
    gain = float(np.sqrt(np.mean(_spline(time, draws, np.clip(grid, time[0], time[-1]))[~missing] ** 2)))
    out = {}
    for name, y in arrays.items():
        d = np.sum(weights * np.lib.stride_tricks.sliding_window_view(y, ORDER + 1), axis=1)
        white = float(1.4826 * np.median(np.abs(d - np.median(d))))
        out[name] = gain * max(white, value_step(y) / math.sqrt(12.0))
    return out


def _spline(time: np.ndarray, y: np.ndarray, grid: np.ndarray) -> np.ndarray:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(time, y)(grid))


def _means(time: np.ndarray, u: np.ndarray, grid: np.ndarray, dt: float, hold: str) -> np.ndarray:
    """Means over the samples of a grid of an input that is constant from each stamp to the next, by rows of the same hold."""
    if np.ptp(u) == 0:  # to the last digit
        return np.full(len(grid), u[0])
    if hold == "mean":  # each row is of the interval before it
        return np.concatenate([u[:1], _means(time, np.append(u[1:], u[-1:]), grid, dt, "held")[:-1]])
    edges = np.append(time, max(time[-1], grid[-1]) + 2.0 * dt)
    area = np.concatenate([[0.0], np.cumsum(u * np.diff(edges))])
    total = np.interp(np.append(grid, grid[-1] + dt), edges, area)
    means: np.ndarray = np.diff(total) / dt
    return means
