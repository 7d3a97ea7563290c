"""Time stamps that are not uniform: jitter, and gaps in which samples are missing."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context, stamps
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.thresholds import JITTER_FIX, JITTER_LIMIT
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording
from mjsim.timebase import grid_step, lacking, rounded_up

__all__ = ["gaps", "jitter"]


@check("jitter", "jitter", question="Are the stamps uniform?")
def jitter(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Steps that differ from the sample time by more than rounding, gaps apart."""
    steps, dt = stamps(recording)
    off = steps / dt - 1
    inside = np.ones(len(steps), bool)
    inside[lacking(recording.time, dt)] = False
    grid = grid_step(recording.time) / dt
    rounding = grid if grid > JITTER_LIMIT else 0.0  # of a grid that is too fine to see, a step is off by nothing
    worst = float(np.max(np.abs(off[inside]), initial=0.0))
    if worst <= JITTER_LIMIT:
        return []
    rms = float(np.sqrt(np.mean(off[inside] ** 2)))
    far = np.flatnonzero(inside & (np.abs(off) > JITTER_LIMIT))
    return [
        Problem(
            "time", "jitter", rms * dt, "s",
            f"The steps between stamps differ from {dt:.6g} s by {100 * rms:.3g} % rms, {100 * worst:.3g} % at most."
            + (f" Stamps rounded to {1e3 * grid * dt:g} ms make {100 * rounding:.3g} % of it." if rounding else ""),
            f"if the samples were taken at these times, [recording] jitter = {rounded_up(worst):g} resamples them; if only the "
            "stamps jitter, give [recording] dt and no time column",
            Severity.FIX if worst - rounding > JITTER_FIX else Severity.LIMITS, marks=_marks(recording, far),
        )
    ]  # fmt: skip


@check("gaps", "gap", question="Are samples missing?")
def gaps(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Steps of more than one and a half samples."""
    steps, dt = stamps(recording)
    at = lacking(recording.time, dt)
    if not len(at):
        return []
    longest = float(np.max(steps[at]))
    worst = float(np.max(np.abs(np.delete(steps, at) / dt - 1), initial=0.0))
    return [
        Problem(
            "time", "gap", longest, "s",
            f"{len(at)} gaps in the stamps; the longest is {longest:.6g} s, {longest / dt:.3g} samples, "
            f"at {recording.time[at[np.argmax(steps[at])]]:.6g} s.",
            "cut the recording at the gaps and give the parts as recordings of their own; where the input was held over them, "
            f"[recording] jitter = {rounded_up(max(worst, JITTER_LIMIT)):g} resamples the rest and leaves them out", Severity.FIX,
            marks=_marks(recording, at),
        )
    ]  # fmt: skip


def _marks(recording: Recording, at: np.ndarray) -> tuple[tuple[float, float], ...]:
    """The first intervals, as many as a picture can show."""
    return tuple((float(recording.time[i]), float(recording.time[i + 1])) for i in at[:50])
