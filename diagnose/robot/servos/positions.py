"""Measured positions of a servo robot: their resolution, and positions behind a zero-phase low-pass with derivatives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from diagnose.data.noise import white_noise_level
from diagnose.robot.motion import LEAST_MOVED, derivative
from mjsim.errors import InputError
from mjsim.hold import delayed
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording

__all__ = ["moves", "resolution", "smoothed"]

ORDER = 4  # of the low-pass, run both ways
FASTEST = 0.2  # of the sampling rate: the highest cutoff, where an eighth-order difference errs by 1e-3
STANDS_OUT = 4.0  # power of the position over that of its noise, up to which it is kept


def resolution(q: np.ndarray) -> float:
    """Noise rms of an angle (N,): that of its sixth differences, at least that of its steps (step / sqrt 12)."""
    change = np.abs(np.diff(q))
    step = float(np.min(change[change > 1e-9 * (np.ptp(q) + 1e-300)], initial=math.inf))
    steps = np.unique(np.round(change[change > 0] / step)) if math.isfinite(step) else np.zeros(0)
    rounded = 0 < len(steps) < 0.5 * np.count_nonzero(change)
    return max(white_noise_level(q), step / math.sqrt(12.0) if rounded else 0.0)


def moves(q: np.ndarray) -> bool:
    """Whether a position (N,) travels more than its resolution explains."""
    return bool(np.ptp(q) > LEAST_MOVED * resolution(q))


def smoothed(
    robot: Robot, r: RobotRecording, late: Mapping[str, float] = MappingProxyType({})
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity, acceleration (N, m) behind a zero-phase low-pass at the highest frequency that stands out of the noise;
    those of joints in ``late`` are moved earlier by so many seconds."""
    from scipy.signal import butter, sosfiltfilt, welch

    raw = r.positions(robot)
    for name, seconds in late.items():
        j = robot.joints.index(name)
        raw[:, j] = delayed(raw[:, j], -seconds / r.dt)
    cutoff = 0.0
    for name in r.joints:
        q = r.angle[:, r.joints.index(name)]
        if not moves(q):
            continue
        f, power = welch(q, 1 / r.dt, nperseg=min(len(q), 512), detrend="linear")
        clear = np.flatnonzero(power > STANDS_OUT * 2 * r.dt * (resolution(q) ** 2 + 1e-300))
        if len(clear):
            cutoff = max(cutoff, float(f[clear[-1]]))
    cutoff = min(max(cutoff, 0.02 / r.dt), FASTEST / r.dt)
    low_pass = butter(ORDER, 2 * cutoff * r.dt, output="sos")
    padding = 3 * (2 * len(low_pass) + 1)  # samples that sosfiltfilt adds at both ends
    if len(raw) <= padding:
        raise InputError(r.source, f"{len(raw)} samples", f"more than {padding}", "record longer")
    z = sosfiltfilt(low_pass, raw, axis=0)
    return z, derivative(z, r.dt), derivative(z, r.dt, second=True)
