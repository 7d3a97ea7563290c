"""What can be wrong with one channel by itself: clipped, coarse, held rows, and motion beyond the joint's limits.

As the checks of one axis, at each joint; a robot's joints may rest while others move, so that only samples in motion count.
"""

from __future__ import annotations

import math

import numpy as np

from diagnose.check.spectrum import quantisation_step
from diagnose.check.thresholds import CLIPPED_SHARE, EQUAL_NEIGHBOURS, RANGE_FIX, Z_TEST
from diagnose.check.types import Problem, Severity
from diagnose.robot.servos.positions import resolution
from mjsim.signals import Limit, limits

__all__ = ["MARKS", "beyond_limits", "clipped", "clipped_torque", "coarse", "held_rows", "in_motion", "refreshed"]

SLOW = 0.05  # of the rms speed: below it a joint may be at rest
WINDOW = 5  # samples before and after a row, in which a joint has to move the same way
FEWEST_FRAMES = 10  # frames of a sensor that tell its period
REGULAR = 0.9  # of the frames: last as long as their median, to a row
MARKS = 20  # stretches that are marked at most


def in_motion(v: np.ndarray) -> np.ndarray:
    """Samples (N,) bool at which a velocity (N,) is clear of rest."""
    return np.asarray(np.abs(v) > SLOW * math.sqrt(float(np.mean(v**2)) + 1e-300))


def refreshed(channel: str, joint: str, x: np.ndarray, dt: float) -> tuple[np.ndarray, list[Problem]]:
    """The values (M,) that a channel (N,) was given anew, and the problem of one that holds each for several rows.

    The frames of such a sensor are of one length, and differ by more than a step: what rests on a step of a coarse sensor goes on
    to the next one.
    """
    at = np.flatnonzero(np.diff(x) != 0.0) + 1
    lengths, jumps = np.diff(at), np.abs(np.diff(x)[at - 1])
    if len(lengths) < FEWEST_FRAMES:
        return x, []
    rows = int(np.median(lengths))
    regular = float(np.mean(np.abs(lengths - rows) <= 1))
    if rows < 3 or regular < REGULAR or float(np.median(jumps)) <= 1.5 * float(np.min(jumps)):
        return x, []
    return x[np.concatenate([[0], at])], [
        Problem(
            f"{joint}.{channel}", "sample_and_hold", rows * dt, "s",
            f"The {channel} of {joint} has a new value every {rows} rows ({1e3 * rows * dt:.4g} ms) and is held between them: it "
            f"is late by {1e3 * (rows - 1) * dt / 2:.4g} ms on average.",
            f"log {joint}.{channel} at the rate of its sensor, or the log at that rate", Severity.LIMITS,
        )
    ]  # fmt: skip


def clipped(channel: str, joint: str, x: np.ndarray, unit: str, time: np.ndarray) -> list[Problem]:
    """A response (N,) that stays at its own largest or smallest value, which it reaches at speed."""
    return [
        Problem(
            f"{joint}.{channel}", "clipping", limit.value, unit,
            f"The {channel} of {joint} stays at {limit.value:.5g} {unit} in {100 * limit.share:.3g} % of the samples, "
            f"{limit.visits} times: the sensor or the logger is at its limit, or the joint at a stop.",
            f"raise the range of {joint}.{channel} in the logger or the sensor, or move within it",
            Severity.FIX if limit.share > CLIPPED_SHARE else Severity.LIMITS, marks=_marks(_at(x, limit), time),
        )
        for limit in limits(x)
    ]  # fmt: skip


def _at(x: np.ndarray, limit: Limit) -> np.ndarray:
    at_limit: np.ndarray = np.isclose(x, limit.value, rtol=1e-12, atol=0)
    return at_limit


def clipped_torque(
    joint: str, torque: np.ndarray, needed: np.ndarray, v: np.ndarray, unit: str, time: np.ndarray
) -> list[Problem]:
    """A torque (N,) that stays at a limit while the motion needs more than that; ``needed`` (N,): by the model, ``v``: velocity.

    The relation of the two, friction and an offset beside it, is fitted to the samples off the limit, where its error is taken
    from. Each visit to the limit is one independent sample of what the motion needs beyond it. A drive that is at its limit needs
    no more.
    """
    found = limits(torque)
    if not found:
        return []
    held = np.any([_at(torque, limit) for limit in found], axis=0)
    C = np.column_stack([needed, v, np.sign(v), np.ones_like(v)])
    c = np.linalg.lstsq(C[~held], torque[~held], rcond=None)[0]
    error, out = float(np.sqrt(np.mean((C @ c - torque)[~held] ** 2))), []
    for limit in found:
        at, way = _at(torque, limit), 1.0 if limit.value == np.max(torque) else -1.0
        excess = ((C @ c - torque) * way)[at]
        mean = float(np.mean(excess))
        if not (mean > Z_TEST * error / math.sqrt(limit.visits)):
            continue
        out.append(
            Problem(
                f"{joint}.torque", "clipping", limit.value, unit,
                f"The torque of {joint} stays at {limit.value:.5g} {unit} in {100 * limit.share:.3g} % of the samples, "
                f"{limit.visits} times. The motion needs {mean:.3g} {unit} more there on average: the log is clipped, not the "
                "drive.", f"raise the range of {joint}.torque in the logger, or excite the joint less", Severity.FIX,
                marks=_marks(at, time),
            )
        )  # fmt: skip
    return out


def coarse(channel: str, joint: str, x: np.ndarray, v: np.ndarray, unit: str) -> list[Problem]:
    """A response (N,) that stands still between coarse steps while its joint moves with velocity (N,)."""
    moves = in_motion(v)[1:]
    step = quantisation_step(x)
    still = float(np.mean(np.diff(x)[moves] == 0)) if moves.any() else 0.0
    if step == 0.0 or still <= EQUAL_NEIGHBOURS:
        return []
    return [
        Problem(
            f"{joint}.{channel}", "quantisation", step, unit,
            f"The {channel} of {joint} moves in steps of {step:.4g} {unit}; {100 * still:.0f} % of neighbours are equal in "
            f"motion, so the noise is below the step and the floor is its rounding, {step / math.sqrt(12):.3g} {unit} rms.",
            f"log {joint}.{channel} at its full resolution, or raise the sensor's resolution", Severity.LIMITS,
        )
    ]  # fmt: skip


def held_rows(responses: np.ndarray, angle: np.ndarray, time: np.ndarray) -> list[Problem]:
    """Rows of which all responses (N, k) repeat the row before, while a joint moves by more than its resolution in a sample.

    angle (N, J): recorded positions. A joint moves at a row where it goes the same way for `WINDOW` samples before and after it.
    """
    n, w = len(time), WINDOW
    held = np.zeros(n, bool)
    if n <= 2 * w + 1:
        return []
    rows = np.arange(w + 1, n - w)
    before, after = angle[rows - 1] - angle[rows - 1 - w], angle[rows + w] - angle[rows]
    least = np.array([w * max(2.0 * math.sqrt(12.0) * resolution(q), 1e-12) for q in angle.T])
    moves = np.any((np.minimum(np.abs(before), np.abs(after)) > least) & (before * after > 0), axis=1)
    held[rows] = np.all(responses[rows] == responses[rows - 1], axis=1) & moves
    count = int(held.sum())
    if not count:
        return []
    share = count / len(time)
    return [
        Problem(
            "time", "duplicated_rows", share, "1",
            f"{count} of {len(time)} rows ({100 * share:.3g} %) repeat all positions of the row before while joints move.",
            "remove the repeated rows and log each sample once: a motion that stands and jumps looks like friction",
            Severity.LIMITS, marks=_marks(held, time),
        )
    ]  # fmt: skip


def beyond_limits(joint: str, low: float, high: float, q: np.ndarray, unit: str, time: np.ndarray) -> list[Problem]:
    """A position (N,) beyond the limits of its joint by more than its noise, and by no more than `RANGE_FIX` of their distance.

    What is further out is a wrong unit, zero or range (`diagnose.robot.check.faults.out_of_range`).
    """
    beyond = max(low - float(np.min(q)), float(np.max(q)) - high)
    if not (5 * resolution(q) < beyond <= RANGE_FIX * (high - low)):
        return []
    outside = (q < low) | (q > high)
    first = float(time[np.flatnonzero(outside)[0]])
    return [
        Problem(
            f"{joint}.angle", "joint_range", beyond, unit,
            f"The position of {joint} leaves the limits of the model, {low:.4g} to {high:.4g} {unit}, by {beyond:.3g} {unit}, in "
            f"{100 * float(np.mean(outside)):.3g} % of the samples, first at {first:.4g} s.",
            "move within the limits, or widen the range in the model: a stop acts there that no effect stands for",
            Severity.LIMITS, marks=_marks(outside, time),
        )
    ]  # fmt: skip


def _marks(at: np.ndarray, time: np.ndarray) -> tuple[tuple[float, float], ...]:
    """The longest stretches of samples (N,) bool, in their order."""
    edges = np.diff(np.concatenate([[0], at.astype(int), [0]]))
    starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    longest = np.argsort(starts - ends, kind="stable")[:MARKS]
    return tuple((float(time[starts[i]]), float(time[ends[i]])) for i in sorted(longest))
