"""A gear between the recorded angle and the joint that the model does not state: its ratio, by the weight of the model.

Under a ratio R the recorded angle theta is that of a motor, and the joint stands at theta / R. The weight is then seen as

    w sin(theta / R + phase),    w = g(R) times the weight of the model.

Only near the right ratio does this law explain the torque, and only there is g = 1. Ratios are tried on a grid; between two of
them g goes with a power of R.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from diagnose.check.machine import Machine
from diagnose.check.relation import Fit, Relation, Signals
from diagnose.check.scale import Evidence, Hypothesis

__all__ = ["GearRatio", "find_gear"]

RATIOS = tuple(np.geomspace(2.0, 512.0, 17))  # steps of 1.41: a travel of one radian is then wrong by 0.4 rad at most
MENDED = 0.25  # of the variance that the labels leave unexplained: what a ratio may leave of it


@dataclass(frozen=True)
class GearRatio:
    """The ratio of the gear, and what of the torque is explained with it and as labelled."""

    ratio: float
    explained: float
    labelled: float


def find_gear(signals: Signals, machine: Machine, labelled: Fit, hold: str) -> GearRatio | None:
    """The ratio at which the weight is that of the model, where the angle is the only response; None where there is none."""
    if signals.velocity is not None or signals.angle is None or labelled.gravity is None:
        return None
    found = [(ratio, fit) for ratio in RATIOS if (fit := _fit(signals, machine, float(ratio), hold)) is not None]
    for (low, a), (high, b) in pairwise(found):
        if not (_weight(a) < 1.0 <= _weight(b)):
            continue
        share = -math.log(_weight(a)) / math.log(_weight(b) / _weight(a)) if _weight(a) > 0 else 1.0
        ratio = float(low * (high / low) ** share)
        fit = _fit(signals, machine, ratio, hold)
        if fit is not None and 1.0 - fit.explained < MENDED * (1.0 - labelled.explained):
            evidence = Evidence((fit,), None)
            if evidence.model_agrees() and evidence.supported() and not evidence.turned():
                return GearRatio(ratio, fit.explained, labelled.explained)
    return None


def _weight(fit: Fit) -> float:
    assert fit.gravity is not None
    return fit.gravity.value


def _fit(signals: Signals, machine: Machine, ratio: float, hold: str) -> Fit | None:
    """The relation with the angle over a ratio; None where it cannot be fitted, or has no weight."""
    fit = Relation(_over(ratio).apply(signals), machine, "angle").fit(hold)
    return None if fit is None or fit.gravity is None else fit


def _over(ratio: float) -> Hypothesis:
    return Hypothesis("side", "angle", "", "", angle=1.0 / ratio)
