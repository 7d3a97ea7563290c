"""A stop of the joint: the motion turns back at one end of its travel, faster than any torque in the log turns it.

    J |dv / dt| > PARAMETER_FACTOR g (max|u| + max|weight|)      only where the angle is at that end, and only away from it

J is the inertia of the model, which may be wrong by `PARAMETER_FACTOR`; friction is no larger than the torque that moves it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.relation import Signals
from diagnose.check.thresholds import IMPACT_NOISE, IMPACTS, PARAMETER_FACTOR, RANGE_FIX
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["joint_stop"]


@check("joint_stop", "joint_stop", question="Does the joint run against a stop?")
def joint_stop(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Impacts at an end of the travel. Of one body only: a spring behind it may turn a lighter body as fast."""
    s = context.mended
    if s is None or s.velocity is None or s.angle is None or machine.chain.couplings:
        return []
    unit, found = ("rad" if machine.hinge else "m"), list(_stops(s, machine, context.noise["velocity"]))
    if not found:
        return []
    time = np.linspace(recording.time[0], recording.time[-1], len(s.angle))
    has = machine.range is not None
    todo = (
        "record within the range of the model, unless its stiffness and damping at the stop are wanted (solreflimit, solimplimit)"
        if has
        else "a diagnosis names it (joint_stop); or state it in the model (limited, range, solreflimit of the joint)"
    )
    return [
        Problem(
            "angle", "joint_stop", at, unit,
            f"The joint runs against a stop at {at:.4g} {unit}, {len(hits)} times: it is turned back there faster than the "
            "logged torque can turn it, and nowhere else.",
            todo,
            Severity.LIMITS,
            marks=tuple((float(time[h[0]]), float(time[h[-1]])) for h in hits[:20]),
        )
        for at, hits in found
    ]  # fmt: skip


def _stops(s: Signals, machine: Machine, noise: float) -> Iterator[tuple[float, list[np.ndarray]]]:
    """(angle, samples of each impact) of each end of the travel that is a stop; none where the motion is as abrupt elsewhere."""
    assert s.velocity is not None
    assert s.angle is not None
    weight = machine.gravity(s.angle)
    asked = float(np.max(np.abs(s.torque))) + (0.0 if weight is None else float(np.max(np.abs(weight))))
    change, angle = np.diff(s.velocity), s.angle[:-1]
    most = PARAMETER_FACTOR * abs(machine.chain.gain) * asked / machine.inertia * s.dt
    abrupt = np.abs(change) > most + IMPACT_NOISE * np.sqrt(2.0) * noise
    ends = {-1: float(np.max(angle)), 1: float(np.min(angle))}  # direction of the change at each end
    near = RANGE_FIX * (ends[-1] - ends[1])
    at = {way: abrupt & (np.sign(change) == way) & (np.abs(angle - end) <= near) for way, end in ends.items()}
    if np.any(abrupt & ~at[-1] & ~at[1]):
        return
    for way in ends:
        samples = np.flatnonzero(at[way])
        hits = _apart(samples, s.velocity * way)
        if len(hits) >= IMPACTS:
            yield float(np.median([angle[h[0]] for h in hits])), hits


def _apart(samples: np.ndarray, away: np.ndarray) -> list[np.ndarray]:
    """Samples of impacts, one array an impact: between two of them the joint moves ``away`` (N,), and comes back."""
    if not len(samples):
        return []
    returned = np.cumsum(np.diff(np.sign(away), prepend=0.0) < 0)  # turns towards the end
    return np.split(samples, np.flatnonzero(np.diff(returned[samples])) + 1)
