"""A recording of a robot as its inverse dynamics see it: low-passed motion and torque on one grid, and the samples that count.

Motion and torque pass one zero-phase Butterworth filter F. What is computed from the filtered motion is filtered once more, so
that the torque is filtered twice: a column linear in the motion is then F^2 of it, as the torque is. A column that jumps
with the sign
of a velocity has to be filtered twice itself. Source: M. Gautier, IEEE ICRA (1997) 2278, for filtering both sides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.data.noise import white_noise_level
from mjsim.errors import InputError
from mjsim.hold import at_samples
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.rows import inertia_along
from mjsim.robot.touching import Touching, touching

__all__ = ["ORDER", "RobotMotion", "clean_band", "moving_joints", "prepare"]

ORDER = 4  # of the Butterworth filter, run both ways
OVERSAMPLING = 8  # samples of the fine grid per period of the cutoff: an eighth-order difference errs by 1e-5 there
THINNED = 3  # samples of the coarse grid per period of the cutoff
SLOW, REST = 0.005, 0.05  # of the rms speed, as diagnose.problem.view.ForceView counts
SHARE = 1e-3  # of the torque's power that the encoder's noise may make below the cutoff
LEAST_MOVED = 20.0  # times the encoder's noise: the travel of a joint that moves
ENDS = 2.0  # periods of the cutoff: what the filter spreads of a step to either side
LEAST_PERIODS = 20  # of the cutoff: the filter's ends take four
BLOCKS, EVERY = 10, 3  # blocks of a recording, of which every third is held out

_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])


@dataclass(frozen=True, eq=False)
class RobotMotion:
    """One recording on the fine grid (N), and which samples of the coarse grid (M) count.

    time (N,) [s]; z, dz, ddz (N, m): filtered once; torque (N, m): joint side, filtered twice, NaN for a joint without; counts
    (M, m): samples of a joint's row that are compared; held (M,): samples that are held out; sos: the filter on the fine
    grid; every:
    samples of the fine grid per sample of the coarse one; dt: of the fine grid [s]; touching: contact, on the fine grid; link:
    motion of the links, where joints are flexible.
    """

    source: str
    sha256: str
    role: str
    time: np.ndarray
    z: np.ndarray
    dz: np.ndarray
    ddz: np.ndarray
    torque: np.ndarray
    counts: np.ndarray
    held: np.ndarray
    sos: np.ndarray
    every: int
    dt: float
    payload: tuple[int, np.ndarray] | None = None
    touching: Touching | None = None
    link: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @property
    def of_links(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration (N, m) of the links: those of the motors, but behind flexible joints."""
        return (self.z, self.dz, self.ddz) if self.link is None else self.link

    def low_passed(self, columns: np.ndarray, times: int = 1) -> np.ndarray:
        """Columns (N, ...) of the fine grid behind the filter, ``times`` over."""
        from scipy.signal import sosfiltfilt

        for _ in range(times):
            columns = sosfiltfilt(self.sos, columns, axis=0)
        return columns

    def thinned(self, columns: np.ndarray) -> np.ndarray:
        """Columns (M, ...) of the coarse grid."""
        return columns[:: self.every]


def derivative(x: np.ndarray, dt: float, second: bool = False) -> np.ndarray:
    """First or second derivative (N, m) by eighth-order central differences; lower order within four samples of the ends."""
    from scipy.ndimage import correlate1d

    inner = correlate1d(x, _SECOND if second else _FIRST, axis=0, mode="nearest") / (dt * dt if second else dt)
    edges = np.gradient(np.gradient(x, dt, axis=0), dt, axis=0) if second else np.gradient(x, dt, axis=0)
    inner[:4], inner[-4:] = edges[:4], edges[-4:]
    return np.asarray(inner)


def moving_joints(robot: Robot, recordings: Sequence[RobotRecording]) -> tuple[str, ...]:
    """Driven joints whose travel, in the first recording, is clearly more than the encoder's noise, and whose torque is
    logged."""
    first = recordings[0]
    out = []
    for k, name in enumerate(robot.joints):
        if not first.has("torque", name):
            continue
        q = first.angle[:, first.joints.index(name)]
        if np.ptp(q) > LEAST_MOVED * max(white_noise_level(q), _step(q)) > 0 or (np.ptp(q) > 0 and white_noise_level(q) == 0):
            out.append(robot.joints[k])
    return tuple(out)


def _step(q: np.ndarray) -> float:
    """Rounding step of an encoder: the least change that is seen; 0 where nothing changes or it is no rounding."""
    change = np.abs(np.diff(q))
    least = float(np.min(change[change > 0], initial=math.inf))
    return least if math.isfinite(least) and least > 1e-9 * np.ptp(q) else 0.0


def clean_band(robot: Robot, recording: RobotRecording, joints: Sequence[str]) -> float:
    """Highest frequency [Hz], at most a tenth of the sampling rate, below which the torque of encoder noise is negligible.

    White noise of an angle makes a torque M_jj w^2 of it: below the cutoff that may have `SHARE` of the power of the
    recorded torque.
    The lowest of all joints counts, since the motion of every joint is in every row.
    """
    from scipy.signal import welch

    highest = 0.1 / recording.dt
    inertia = np.sqrt(np.mean(inertia_along(robot, recording.positions(robot)[:: max(1, len(recording) // 200)]) ** 2, axis=0))
    bands = [highest]
    for name in joints:
        k, j = recording.joints.index(name), robot.joints.index(name)
        q = recording.angle[:, k]
        noise = max(white_noise_level(q), _step(q) / math.sqrt(12.0))
        assert recording.torque is not None
        segment = min(len(q), max(256, 2 ** int(np.log2(len(q) / 6))))
        f, power = welch(robot.gear[j] * recording.torque[:, k], 1 / recording.dt, nperseg=segment)
        false = inertia[j] ** 2 * (2 * np.pi * f) ** 4 * noise**2 * 2 * recording.dt
        dirty = np.flatnonzero((np.cumsum(false) > SHARE * np.cumsum(power)) & (f <= highest) & (f > 0))
        if len(dirty):
            bands.append(float(max(f[dirty[0]], 0.02 * highest)))
    return min(bands)


def prepare(
    robot: Robot,
    recording: RobotRecording,
    joints: Sequence[str],
    cutoff: float,
    *,
    role: str = "estimation",
    split: bool = False,
) -> RobotMotion:
    """The recording behind the filter. ``split``: hold out every third of ten blocks; role "held-out": hold out all of it."""
    from scipy.signal import butter, sosfiltfilt

    coarse = max(1, int(1 / (recording.dt * OVERSAMPLING * cutoff)))
    first = butter(ORDER, min(2 * cutoff * recording.dt, 0.9), output="sos")
    periods = len(recording) * recording.dt * cutoff
    if periods < LEAST_PERIODS:
        found = f"{len(recording)} samples hold {periods:.0f} periods of the {cutoff:.3g} Hz that are compared"
        raise InputError(recording.source, found, f"at least {LEAST_PERIODS}", "record longer")
    z = sosfiltfilt(first, recording.positions(robot), axis=0)[::coarse]
    dt = recording.dt * coarse
    sos = np.asarray(butter(ORDER, min(2 * cutoff * dt, 0.9), output="sos"))
    dz = derivative(z, dt)
    torque = np.full(z.shape, np.nan)
    for name in joints:
        j = robot.joints.index(name)
        assert recording.torque is not None
        raw = robot.gear[j] * recording.torque[:, recording.joints.index(name)]
        if recording.hold != "linear":  # its mean about each sample: half a sample late, or early
            raw = at_samples(raw, recording.hold)
        torque[:, j] = sosfiltfilt(sos, sosfiltfilt(first, raw)[::coarse])
    every = max(1, int(1 / (dt * THINNED * cutoff)))
    ddz, reach = derivative(z, dt, second=True), math.ceil(ENDS / (cutoff * dt))
    contact = touching(robot, z, dz, ddz, dt)
    counts = (_counts(dz, dt, cutoff) & ~contact.widened(reach, reach))[::every]
    for j, name in enumerate(robot.joints):
        counts[:, j] &= name in joints
    held = np.zeros(len(counts), bool)
    if role == "held-out":
        held[:] = True
    elif split:
        held = (np.arange(len(counts)) * BLOCKS // len(counts)) % EVERY == EVERY - 1
    payload = None
    if recording.payload is not None:
        from mjsim.robot.inertia import moved, point_mass

        link, pos, quat = robot.link_of(recording.payload.body)
        payload = link, moved(point_mass(recording.payload.mass, np.array(recording.payload.pos)), pos, quat)
    return RobotMotion(
        recording.source, recording.sha256, role, recording.time[::coarse], z, dz, ddz, torque, counts,
        held, sos, every, dt, payload, contact,
    )  # fmt: skip


def _counts(dz: np.ndarray, dt: float, cutoff: float) -> np.ndarray:
    """Samples (N, m) that count in each joint's row: neither at rest nor within the filter's ends."""
    from scipy.ndimage import maximum_filter1d

    rms = np.sqrt(np.mean(dz**2, axis=0)) + 1e-300
    speed = np.abs(dz)
    rest = maximum_filter1d(speed, 2 * max(1, round(0.1 / dt)) + 1, axis=0) < REST * rms
    edge = math.ceil(ENDS / (cutoff * dt))
    inside = np.zeros(len(dz), bool)
    inside[edge : len(dz) - edge] = True
    return np.asarray((speed > SLOW * rms) & ~rest & inside[:, None])
