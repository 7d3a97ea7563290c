"""A delay that most joints of a robot have in common: a matter of the bus or of the log before it is one of the joints."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnose.robot.result import JointResult

__all__ = ["shifted"]

ALIKE = 0.1  # relative difference of delays that are taken for one


def shifted(joints: Mapping[str, JointResult]) -> list[str]:
    """A note where most joints, and two at least, have one delay in common: the columns of the log may be shifted.

    A delay is the common one where it is within `ALIKE` of the median, or its interval holds it.
    """
    delays = [f.parameters["delay_s"] for r in joints.values() for f in r.findings if "delay_s" in f.parameters]
    if not delays:
        return []
    middle = float(np.median([e.value for e in delays]))
    alike = [e for e in delays if abs(e.value - middle) <= ALIKE * middle or e.ci95[0] <= middle <= e.ci95[1]]
    if len(alike) < 2 or 2 * len(alike) <= len(joints):
        return []
    return [
        f"{len(alike)} of {len(joints)} joints have a delay of {1e3 * middle:.3g} ms in common: that of the bus, or the "
        "inputs of the log are shifted against the positions (two clocks). Check the stamps before it is taken for physics."
    ]
