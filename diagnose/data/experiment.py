"""Recordings made ready for a fit: which samples count, the noise on them, whether they start in motion."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from diagnose.data.noise import channel_noise, coloured_noise_level, white_noise_level
from diagnose.thresholds import FAR, FEWEST, ROUNDING, SHORTEST, SMALL, TWICE
from mjsim.errors import InputError
from mjsim.recording import Recording
from mjsim.signals import limits, plain_step, value_step

__all__ = [
    "Experiment",
    "angle_noise_level",
    "corrected",
    "fewest_of",
    "first_angle",
    "held_rows",
    "hold_out_blocks",
    "measured_angle",
    "measured_count",
    "measured_velocity",
    "middle",
    "prepare",
    "resting_angle",
    "smooth_velocity",
    "with_common_noise",
]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A recording and the part of it that a fit counts.

    counts (N) bool; sigma: noise rms of the judged output, at least sqrt(ROUNDING) of its spread (weights recordings against
    each other); moving: the axis is not at rest at the first sample; speed, angle: there, by the samples around it where it
    moves; angle_error: standard deviation of that angle, angle_noise: of any, 0 where there is none; before: torque held ahead
    of it; correction (N): added to the measured velocity where motion is compared; kept: signals that views computed, by their
    arguments.
    """

    recording: Recording
    counts: np.ndarray
    sigma: float
    moving: bool
    before: float
    correction: np.ndarray | None = None
    speed: float = 0.0
    angle: float = 0.0
    angle_error: float = 0.0
    angle_noise: float = 0.0
    kept: dict[tuple[object, ...], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, init=False, repr=False)

    def first(self, share: float) -> Experiment:
        """The first part of it."""
        n = max(FEWEST, math.ceil(share * len(self.recording)))
        correction = None if self.correction is None else self.correction[:n]
        return dataclasses.replace(self, recording=self.recording.slice(0, n), counts=self.counts[:n], correction=correction)


def corrected(experiments: Sequence[Experiment], corrections: Mapping[str, np.ndarray]) -> tuple[Experiment, ...]:
    """The experiments with corrections (N,) of their measured velocities, by the SHA-256 (else the source) of the recording."""
    found = [corrections.get(e.recording.sha256 or e.recording.source) for e in experiments]
    return tuple(e if c is None else dataclasses.replace(e, correction=c) for e, c in zip(experiments, found, strict=True))


def measured_velocity(recording: Recording) -> np.ndarray:
    """The velocity channel, or the central difference of the angle where there is none [rad/s | m/s]."""
    if recording.velocity is not None:
        return recording.velocity
    assert recording.angle is not None
    velocity: np.ndarray = np.gradient(recording.angle, recording.dt)
    return velocity


def smooth_velocity(recording: Recording) -> np.ndarray:
    """The velocity channel (N,), or slopes of parabolas through the angle where there is none [rad/s | m/s].

    A parabola takes the fewest samples, 1 + 2^k, for which the standard error of its slope by the noise of the angle is below a
    twentieth of the rms slope (A. Savitzky, M. J. E. Golay, Anal. Chem. 36 (1964) 1627).
    """
    if recording.velocity is not None or recording.angle is None:
        return measured_velocity(recording)
    from scipy.signal import savgol_filter  # takes half a second to load

    q, dt = recording.angle, recording.dt
    noise = max(white_noise_level(q), plain_step(q) / math.sqrt(12.0))
    slope, n = np.gradient(q, dt), 3
    while n < len(q) / 4:
        error = noise / (dt * math.sqrt(n * (n * n - 1) / 12.0))
        if error < SMALL * math.sqrt(float(np.mean(slope**2))):
            break
        n = 2 * n - 1
        slope = savgol_filter(q, n, 2, deriv=1, delta=dt)
    return np.asarray(slope)


def middle(recording: Recording) -> float:
    """The mean angle [rad | m], 0 where there is no angle."""
    return 0.0 if recording.angle is None else float(np.mean(recording.angle))


def first_angle(recording: Recording) -> tuple[float, float]:
    """The angle [rad | m] at the first sample of a motion, and its standard deviation; 0, 0 where there is no angle.

    By a parabola through the most samples, 1 + 2^k, that it fits to their noise.
    """
    q = recording.angle
    if q is None:
        return 0.0, 0.0
    noise = max(angle_noise_level(q), channel_noise(recording, "angle"))
    best, n = (float(q[0]), noise), 5
    while noise > 0.0 and n < len(q) / 4:
        basis = np.vander(np.arange(n) / n, 3, increasing=True)
        fit = np.linalg.lstsq(basis, q[:n], rcond=None)[0]
        left = math.sqrt(float(np.sum((q[:n] - basis @ fit) ** 2)) / (n - 3))
        if left > noise * (1.0 + 1.0 / math.sqrt(2.0 * (n - 3))):  # a standard error above it: it bends otherwise
            break
        best = float(fit[0]), noise * math.sqrt(float(np.linalg.inv(basis.T @ basis)[0, 0]))
        n = 2 * n - 1
    return best


def resting_angle(recording: Recording) -> tuple[float, float]:
    """The angle [rad | m] at the first sample of a recording from rest, and its standard deviation; 0, 0 where there is no angle.

    The mean over the rows ahead of the first change of the input, where these differ by no more than twice their noise; else the
    first row.
    """
    q = recording.angle
    if q is None:
        return 0.0, 0.0
    noise = max(angle_noise_level(q), channel_noise(recording, "angle"))
    changed = np.flatnonzero(recording.input != recording.input[0])
    n = int(changed[0]) if len(changed) else 1
    if n < 2 or noise == 0.0 or float(np.std(q[:n], ddof=1)) > TWICE * noise:  # it settles
        return float(q[0]), noise
    return float(np.mean(q[:n])), noise / math.sqrt(n)


def angle_noise_level(q: np.ndarray) -> float:
    """Noise rms of an angle (N,): that of its sixth differences, at least that of rounding where all values lie on a grid."""
    return max(white_noise_level(q), value_step(q) / math.sqrt(12.0))


def measured_angle(recording: Recording) -> np.ndarray:
    """The angle channel, or the integral of the velocity where there is none, from 0 [rad | m]."""
    if recording.angle is not None:
        return recording.angle
    v = measured_velocity(recording)
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * recording.dt])


def held_rows(recording: Recording, slow: float = 0.05) -> np.ndarray:
    """Rows (N,) bool that were not measured but hold the row before: velocity and angle repeat it to the last digit, in motion.

    None where a channel stands still between coarse steps, or is alone: it may well repeat itself then. ``slow``: part of the
    rms speed below which the axis may be at rest.
    """
    v, q = recording.velocity, recording.angle
    held = np.zeros(len(recording), bool)
    if v is None or q is None or plain_step(v) > 0 or plain_step(q) > 0:
        return held
    same = np.diff(v) == 0, np.diff(q) == 0
    held[1:] = same[0] & same[1]
    by_chance = float(np.mean(same[0][~same[1]])) * float(np.sum(same[1])) if not np.all(same[1]) else 0.0
    if np.sum(held) <= FAR * (by_chance + math.sqrt(by_chance)):  # a quantised velocity repeats as often as the angle moves
        return np.zeros(len(recording), bool)
    speed = np.abs(v[~held])  # of each row that was measured, and of the one after it: neither is fast at rest
    moves = np.maximum(speed, np.append(speed[1:], 0.0)) > slow * math.sqrt(float(np.mean(v**2)))
    carried: np.ndarray = held & moves[np.cumsum(~held) - 1]
    return carried


def measured_count(recording: Recording) -> int:
    """Number of samples that were measured: those in no gap of the stamps. A log that is not on a grid yet marks none."""
    missing = getattr(recording, "missing", None)
    return len(recording) - (0 if missing is None else int(np.sum(missing)))


def fewest_of(recordings: Sequence[Recording]) -> int:
    """Measured samples that each recording of a fit needs: `SHORTEST` where together they have `FEWEST`, else `FEWEST`."""
    return SHORTEST if sum(map(measured_count, recordings)) >= FEWEST else FEWEST


def with_common_noise(experiments: Sequence[Experiment]) -> tuple[Experiment, ...]:
    """The experiments, those of fewer than `FEWEST` samples weighed by the noise of all: theirs alone is known too roughly.

    The variance is the mean of the variances, weighed by the numbers of samples.
    """
    counts = [measured_count(e.recording) for e in experiments]
    if all(n >= FEWEST for n in counts):
        return tuple(experiments)
    common = math.sqrt(sum(n * e.sigma**2 for n, e in zip(counts, experiments, strict=True)) / sum(counts))
    return tuple(e if n >= FEWEST else dataclasses.replace(e, sigma=common) for n, e in zip(counts, experiments, strict=True))


def prepare(recording: Recording, *, counts: np.ndarray | None = None, minimum: int = FEWEST) -> Experiment:
    """Check a recording and make it an experiment; rows that were held and not measured do not count.

    Raises InputError when it is too short, does not move, or is clipped flat for much of its length.
    """
    v = measured_velocity(recording)
    missing = np.zeros(len(v), bool) if recording.missing is None else recording.missing
    n = measured_count(recording)
    if n < minimum:
        together = ", in one recording or in several that are fitted together" if minimum == FEWEST else ""
        raise InputError(
            recording.source, f"{n} samples ({recording.duration:.3g} s)", f"at least {minimum}{together}", "record longer"
        )
    noise = _velocity_noise(recording, v)
    spread = float(np.std(v))
    if recording.driven and np.ptp(recording.input) == 0 and not steps_from_rest(recording):
        name = "torque" if recording.command is None else "command"
        raise InputError(
            recording.source, f"the {name} is constant", "an input that varies, or a step from rest", "excite the axis"
        )
    if spread == 0 or spread < 1.5 * noise:
        raise InputError(
            recording.source, f"the motion (rms {spread:.3g}) does not rise above its noise (rms {noise:.3g})",
            "a moving axis", "excite it with more torque",
        )  # fmt: skip
    for limit in limits(v):
        if limit.share > SMALL:
            raise InputError(
                recording.source, f"velocity stands at its limit {limit.value:.4g} for {100 * limit.share:.0f} % of the time",
                "an unclipped signal", "raise the sensor's range or lower the excitation",
            )  # fmt: skip
    if recording.velocity is None and recording.angle is not None:  # what central differences make of the angle's noise
        q = recording.angle
        noise = max(channel_noise(recording, "angle"), plain_step(q) / np.sqrt(12.0)) / (np.sqrt(2.0) * recording.dt)
    _need_one_motion(recording)
    moving = _starts_in_motion(recording, v, noise, spread)
    speed = float(smooth_velocity(recording)[0]) if moving else 0.0
    before = float(recording.input[0]) if moving or recording.command is not None else 0.0
    held = held_rows(recording)
    if recording.velocity is not None and recording.angle is not None and not held.any():
        q = recording.angle
        angle_noise = max(channel_noise(recording, "angle"), plain_step(q) / np.sqrt(12.0))
        noise = coloured_noise_level(v, q, recording.dt, noise, angle_noise)
    counts = ~held & ~missing & (True if counts is None else counts)
    of_angle = 0.0
    if recording.angle is not None:
        of_angle = max(angle_noise_level(recording.angle), channel_noise(recording, "angle"))
    if recording.command is not None and recording.angle is not None:
        noise = of_angle
        spread = float(np.std(recording.angle))
    angle, angle_error = (first_angle if moving else resting_angle)(recording)
    sigma = max(noise, math.sqrt(ROUNDING) * spread)
    return Experiment(
        recording, counts, sigma, moving, before, speed=speed, angle=angle, angle_error=angle_error, angle_noise=of_angle
    )


def _velocity_noise(recording: Recording, v: np.ndarray) -> float:
    """Noise rms of `measured_velocity`, at least that of its steps."""
    white = white_noise_level(v) if recording.velocity is None else channel_noise(recording, "velocity")
    return float(max(white, plain_step(v) / math.sqrt(12.0)))


def steps_from_rest(recording: Recording) -> bool:
    """Whether a constant torque is a step with the first sample: the axis is at rest there, and then goes the way of the torque.

    It may ring back by a small part of its travel. Of an axis that swings under a constant torque nothing tells that the torque
    is not the wrong column.
    """
    u = float(recording.torque[0])
    v = measured_velocity(recording)
    noise, spread = _velocity_noise(recording, v), float(np.std(v))
    if recording.command is not None or u == 0.0 or spread == 0.0 or spread < 1.5 * noise:
        return False
    gone = math.copysign(1.0, u) * (measured_angle(recording) - measured_angle(recording)[0])
    return not _starts_in_motion(recording, v, noise, spread) and bool(
        np.max(np.maximum.accumulate(gone) - gone) <= SMALL * np.ptp(gone) and gone[-1] > 0.0
    )


def _need_one_motion(recording: Recording, window: float = 0.02) -> None:
    """Refuse an angle that jumps (wrapped at a turn), or moves otherwise than the velocity says (unit, sign, side of a gear).

    Both are averaged over ``window`` [s], so that the noise of neither matters; an offset of one is no contradiction.
    """
    v, q = recording.velocity, recording.angle
    if q is None:
        return
    step = np.abs(np.diff(q))
    jump = int(np.argmax(step))
    if step[jump] > 0.5 * np.ptp(q) > 0:
        raise InputError(
            recording.source, f"the angle jumps by {step[jump]:.4g} at sample {jump + 2}", "an angle that goes on past a turn",
            "unwrap it (numpy.unwrap) first",
        )  # fmt: skip
    if v is None:
        return
    k = max(2, min(round(window / recording.dt), (len(q) - 1) // 25))
    count = (len(q) - 1) // k
    if count < 20:
        return
    speed = (0.5 * (v[1:] + v[:-1]))[: count * k].reshape(count, k).mean(axis=1)
    rate = np.diff(q[: count * k + 1 : k]) / (k * recording.dt)
    if min(np.std(speed), np.std(rate)) == 0:
        return
    alike, times = float(np.corrcoef(speed, rate)[0, 1]), float(np.std(rate) / np.std(speed))
    if abs(alike) > 0.95 and not (alike > 0 and 0.7 < times < 1.4):
        raise InputError(
            recording.source, f"the angle moves {math.copysign(times, alike):.4g} times as fast as the velocity says",
            "both of the motor, in rad and rad/s (m and m/s)", "state units and gains in the binding (link side: second_angle)",
        )  # fmt: skip


def hold_out_blocks(recording: Recording, blocks: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Masks (estimation, held-out) of one recording: every third of ``blocks`` stretches of equal length is held out."""
    index = np.minimum(np.arange(len(recording)) * blocks // len(recording), blocks - 1)
    held = index % 3 == 2
    return ~held, held


def _starts_in_motion(recording: Recording, v: np.ndarray, noise: float, spread: float) -> bool:
    """Whether rest at the first sample cannot be taken for granted.

    By a parabola through the first samples, the most that it fits to their noise, the speed there exceeds its noise and is not
    negligible; or the axis gains speed against the torque, as an elastic deflection or gravity makes it. Without a drive a motion
    does not start from rest, except by chance; nor does that of a servo whose command moves from the first row on, whose angle
    alone tells slow speeds too coarsely.
    """
    if not recording.driven:
        return True
    command = recording.command
    if command is not None and recording.velocity is None and len(command) > 1 and command[1] != command[0]:
        return True
    count = min(10, len(v) // 4)  # short: an excitation of 40 Hz turns within 20 samples at 2 kHz
    while True:
        basis = np.vander(np.arange(count) / count, 3, increasing=True)
        fit = np.linalg.lstsq(basis, v[:count], rcond=None)[0]
        left = math.sqrt(float(np.sum((v[:count] - basis @ fit) ** 2)) / max(count - 3, 1))
        if count <= 4 or left <= noise * (
            1.0 + 1.0 / math.sqrt(2.0 * (count - 3))
        ):  # a standard error above it: it bends otherwise
            break
        count -= 1
    start, gained = fit[:2]
    covariance = noise**2 * np.linalg.inv(basis.T @ basis)
    if abs(start) > 5 * math.sqrt(covariance[0, 0]) + 0.02 * spread:
        return True
    u = recording.input
    acts = recording.command is None and abs(u[0]) > SMALL * math.sqrt(float(np.mean(u**2)))
    return bool(acts and -gained * np.sign(u[0]) > 5 * math.sqrt(covariance[1, 1]))
