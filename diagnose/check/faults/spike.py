"""Single samples far from both neighbours: no inertia moves so; a frame was lost on the bus, or a counter overflowed."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["spike", "spikes"]

FEW = 1e-3  # of the samples: more than that are no single faults
MARKED = 50  # spikes that a picture marks


def spikes(x: np.ndarray) -> np.ndarray:
    """Indices of samples (k,) of x (N,) that differ from both neighbours, to the same side, by more than all others range.

    A step, as at an impact, differs from one neighbour alone. At most `FEW` of the samples, and at least one, are asked about.
    """
    if len(x) < 3:
        return np.zeros(0, int)
    before, after = x[1:-1] - x[:-2], x[1:-1] - x[2:]
    off = np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    asked = 1 + np.argsort(off)[-max(1, int(FEW * len(x))) :]
    others = np.delete(x, asked)
    return np.sort(asked[off[asked - 1] > np.ptp(others)]) if len(others) else np.zeros(0, int)


@check("spike", "spike", question="Is every sample of the motion near its neighbours?")
def spike(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Single samples of velocity or angle that lie further off than the range of all others."""
    found = []
    for name, unit in (("velocity", "rad/s" if machine.hinge else "m/s"), ("angle", "rad" if machine.hinge else "m")):
        x = getattr(recording, name)
        at = spikes(x) if x is not None else np.zeros(0, int)
        if len(at):
            first = int(at[0])
            found.append(
                Problem(
                    name, "spike", float(x[first]), unit,
                    f"{len(at)} single samples of the {name} lie further from both neighbours than all others range; the first "
                    f"is {x[first]:.4g} {unit} at {recording.time[first]:.6g} s.",
                    "replace them by the measured values, or record again; they bias every estimate", Severity.FIX,
                    marks=tuple((float(recording.time[i - 1]), float(recording.time[i + 1])) for i in at[:MARKED]),
                )
            )  # fmt: skip
    return found
