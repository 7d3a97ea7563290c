"""Motion beyond the range of the joint in the model, by more than MuJoCo's soft limit yields (`Machine.yields`)."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context, torque_of
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.thresholds import RANGE_FIX
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["joint_range"]


@check("joint_range", "joint_range", question="Does the motion stay within the joint's range?")
def joint_range(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """An angle outside the range by more than its noise."""
    signals = context.mended
    angle = signals.angle if signals is not None else recording.angle
    if machine.range is None or angle is None:
        return []
    low, high = machine.range
    noise = 5 * context.noise["angle"]
    beyond = max(low - float(np.min(angle)), float(np.max(angle)) - high)
    speed, asked = (0.0 if c is None else float(np.max(np.abs(c))) for c in (_speed(context, angle), torque_of(recording)))
    weight = machine.gravity(angle)
    asked = abs(machine.chain.gain) * (asked + (0.0 if weight is None else float(np.max(np.abs(weight)))))
    if beyond <= noise + machine.yields(speed, asked):
        return []
    unit, outside = ("rad" if machine.hinge else "m"), np.flatnonzero((angle < low) | (angle > high))
    time = np.linspace(recording.time[0], recording.time[-1], len(angle))
    return [
        Problem(
            "angle", "joint_range", beyond, unit,
            f"The angle leaves the joint's range [{low:.4g}, {high:.4g}] {unit} by {beyond:.4g} {unit}, in "
            f"{100 * len(outside) / len(angle):.3g} % of the samples.",
            "check the zero, the sign and the unit of the angle, or widen the range in the model",
            Severity.FIX if beyond > RANGE_FIX * (high - low) else Severity.LIMITS,
            marks=((float(time[outside[0]]), float(time[outside[-1]])),),
        )
    ]  # fmt: skip


def _speed(context: Context, angle: np.ndarray) -> np.ndarray:
    """Recorded velocity, else that of the recorded angle (N,)."""
    signals = context.mended
    if signals is not None and signals.velocity is not None:
        return signals.velocity
    r = context.recording
    return r.velocity if r.velocity is not None else np.gradient(angle, r.dt)
