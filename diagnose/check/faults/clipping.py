"""Channels that stay at their own largest or smallest value: a converter or logger at its limit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnose.check.context import Context, torque_of
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.thresholds import CLIPPED_SHARE, EXCESS_TOLD, Z_TEST
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording
from mjsim.signals import Limit, limits

__all__ = ["clipping", "torque_excess"]


@check("clipping", "clipping", question="Is a channel at its limit?")
def clipping(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Responses at a limit, and a torque at a limit where the motion needs more than that."""
    found = []
    units = {"torque": "N m" if machine.hinge else "N", "velocity": "rad/s" if machine.hinge else "m/s"}
    for name, unit in units.items():
        x = torque_of(recording) if name == "torque" else recording.velocity
        if x is None:
            continue
        at = limits(x)
        excess = torque_excess(recording, context, at) if name == "torque" and at else None
        if excess is not None and excess <= 0:
            continue  # the drive itself is at its limit: the log is right
        found += [_problem(recording, name, unit, x, limit, excess) for limit in at]
    return found


def _problem(recording: Recording, name: str, unit: str, x: np.ndarray, limit: Limit, excess: float | None) -> Problem:
    fix = limit.share > CLIPPED_SHARE or bool(excess)
    more = f" The motion needs {excess:.3g} {unit} more there on average: the log is clipped, not the drive." if excess else ""
    return Problem(
        name, "clipping", limit.value, unit,
        f"The {name} stays at {limit.value:.5g} {unit} in {100 * limit.share:.3g} % of the samples, {limit.visits} times.{more}",
        f"raise the range of the {name} in the logger or the sensor, or excite the axis less",
        Severity.FIX if fix else Severity.LIMITS,
        marks=_marks(recording, x, limit),
    )  # fmt: skip


def torque_excess(recording: Recording, context: Context, at: Sequence[Limit]) -> float | None:
    """Torque [N m | N] beyond its limits that the motion needs while the log stays at them.

    0 where there is none, None where the data do not tell. One more column in the relation: the sign of the torque at the samples
    at a limit. It stands on the side of the motion, so that what the log lacks has the opposite sign.
    """
    signals, relation = context.mended, context.relation
    if signals is None or relation is None or len(signals.torque) != len(recording):
        return None
    held = np.any([np.isclose(recording.torque, limit.value, rtol=1e-12, atol=0) for limit in at], axis=0)
    fit = relation.fit(context.hold, np.where(held, np.sign(signals.torque), 0.0))
    if fit is None or fit.extra is None or context.scale is None:
        return None
    factor = abs(context.scale.chosen.torque)
    lacking, error = -fit.extra.value / factor, fit.extra.error / factor
    if lacking > Z_TEST * error:
        return float(lacking)
    return 0.0 if Z_TEST * error < EXCESS_TOLD * min(abs(limit.value) for limit in at) else None


def _marks(recording: Recording, x: np.ndarray, limit: Limit) -> tuple[tuple[float, float], ...]:
    """The first stretches at the limit."""
    at = np.isclose(x, limit.value, rtol=1e-12, atol=0).astype(int)
    edges = np.diff(np.concatenate([[0], at, [0]]))
    starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    longest = np.argsort(starts - ends)[:20]
    return tuple((float(recording.time[starts[i]]), float(recording.time[ends[i]])) for i in sorted(longest))
