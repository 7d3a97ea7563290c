"""Offsets that the angle channel confirms or contradicts, whatever the model is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from diagnose.data.experiment import Experiment
from diagnose.thresholds import BLOCKS, SIGMAS
from mjsim.effects import registered

__all__ = ["excluded_by_angle"]


def excluded_by_angle(experiments: Sequence[Experiment]) -> dict[str, str]:
    """Effects that the angle channel contradicts without any model: each with the effect beside which alone it may stand, or "".

    An offset of the velocity sensor shows as its drift from the angle; where it does, the axis itself does not move so, as by
    an offset of the torque it would: that may be there as well, but not in place of it.
    """
    verdicts = []
    for experiment in experiments:
        r = experiment.recording
        if r.velocity is None or r.angle is None or len(r) < 100:
            continue
        d = r.velocity[:-1] * 0.5 + r.velocity[1:] * 0.5 - np.diff(r.angle) / r.dt
        if np.std(d) < 1e-9 * np.std(r.velocity):
            continue  # one channel was computed from the other
        # mean of v minus slope of q; its error from what blocks of the recording differ by, since noise may be coloured
        blocks = [float(np.mean(b)) for b in np.array_split(d, BLOCKS)]
        error = float(np.std(blocks, ddof=1)) / math.sqrt(BLOCKS) + 1e-4 * float(np.std(r.velocity)) / math.sqrt(len(r))
        offset = float(np.mean(d))
        verdicts.append(abs(offset) > SIGMAS * error)
    known = registered()
    shown = [name for name, cls in known.items() if cls.shown_by_angle]
    if verdicts and all(verdicts):
        return {name: other for name, cls in known.items() for other in cls.taken_for if other in shown}
    return dict.fromkeys(shown, "") if verdicts and not any(verdicts) else {}
