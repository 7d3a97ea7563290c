"""Time stamps that are not uniform: jitter, and gaps in which samples are missing."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context, stamps
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.thresholds import GAP_STEP, JITTER_FIX, JITTER_LIMIT
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["gaps", "jitter"]


@check("jitter", "jitter", question="Are the stamps uniform?")
def jitter(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Steps that differ from the sample time by more than rounding, gaps apart."""
    steps, dt = stamps(recording)
    off = steps / dt - 1
    inside = np.ones(len(steps), bool)
    inside[_lost(recording.time, steps, dt)] = False
    worst = float(np.max(np.abs(off[inside]), initial=0.0))
    if worst <= JITTER_LIMIT:
        return []
    rms = float(np.sqrt(np.mean(off[inside] ** 2)))
    far = np.flatnonzero(inside & (np.abs(off) > JITTER_LIMIT))
    return [
        Problem(
            "time", "jitter", rms * dt, "s",
            f"The steps between stamps differ from {dt:.6g} s by {100 * rms:.3g} % rms, {100 * worst:.3g} % at most.",
            "if only the stamps jitter, give [recording] dt and no time column; else resample to a uniform grid by the stamps",
            Severity.FIX if worst > JITTER_FIX else Severity.LIMITS, marks=_marks(recording, far),
        )
    ]  # fmt: skip


@check("gaps", "gap", question="Are samples missing?")
def gaps(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Steps of more than one and a half samples."""
    steps, dt = stamps(recording)
    at = _lost(recording.time, steps, dt)
    if not len(at):
        return []
    longest = float(np.max(steps[at]))
    return [
        Problem(
            "time", "gap", longest, "s",
            f"{len(at)} gaps in the stamps; the longest is {longest:.6g} s, {longest / dt:.3g} samples, "
            f"at {recording.time[at[np.argmax(steps[at])]]:.6g} s.",
            "cut the recording at the gaps and give the parts as recordings of their own", Severity.FIX,
            marks=_marks(recording, at),
        )
    ]  # fmt: skip


def _lost(time: np.ndarray, steps: np.ndarray, dt: float) -> np.ndarray:
    """Steps at which samples are missing: the stamps after them stay late by half a sample or more (their median over ten)."""
    phase = time / dt - np.arange(len(time))
    found = []
    for i in np.flatnonzero(steps >= GAP_STEP * dt):
        before, after = phase[max(i - 9, 0) : i + 1], phase[i + 1 : i + 11]
        if np.median(after) - np.median(before) >= GAP_STEP - 1:
            found.append(i)
    return np.array(found, int)


def _marks(recording: Recording, at: np.ndarray) -> tuple[tuple[float, float], ...]:
    """The first intervals, as many as a picture can show."""
    return tuple((float(recording.time[i]), float(recording.time[i + 1])) for i in at[:50])
