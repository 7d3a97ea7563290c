"""Rows that repeat the row before in motion: the logger held them, or ran faster than the sensor."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context, torque_of
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from diagnose.data.experiment import held_rows
from mjsim.recording import Recording
from mjsim.signals import plain_step

__all__ = ["duplicated_rows"]


@check("duplicated_rows", "duplicated_rows", question="Does every row hold a measurement of its own?")
def duplicated_rows(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Rows whose channels all repeat the row before to the last digit while the axis moves."""
    held = held_rows(recording)
    if not held.any():
        held = _repeated(recording)
    count = int(np.sum(held))
    if not count:
        return []
    share = count / len(recording)
    first = np.flatnonzero(held)[:50]
    return [
        Problem(
            "time", "duplicated_rows", share, "1",
            f"{count} of {len(recording)} rows ({100 * share:.3g} %) repeat the row before while the axis moves.",
            "remove the repeated rows and log each sample once; they are not counted in a diagnosis", Severity.LIMITS,
            marks=tuple((float(recording.time[max(i - 1, 0)]), float(recording.time[i])) for i in first),
        )
    ]  # fmt: skip


def _repeated(recording: Recording) -> np.ndarray:
    """Repeats of all channels at once where there is one response; none where it is rounded so that it may repeat itself."""
    response = recording.velocity if recording.velocity is not None else recording.angle
    torque = torque_of(recording)
    out = np.zeros(len(recording), bool)
    both = recording.velocity is not None and recording.angle is not None
    if response is None or torque is None or both or not recording.driven:
        return out
    steps = np.diff(response)
    if plain_step(response) > 0 or len(np.unique(response)) < 0.5 * len(response):
        return out
    out[1:] = (steps == 0) & (np.diff(torque) == 0)
    return out
