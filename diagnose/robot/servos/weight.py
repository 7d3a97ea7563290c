"""The weight behind a joint as a multiple of the file's: masses and centres of links are numbers, and no missing physics."""

from __future__ import annotations

import math

import numpy as np

from diagnose.result import Estimate
from diagnose.robot.result import JointResult
from diagnose.robot.servos.library import WEIGHT
from diagnose.robot.servos.state import JointSearch
from mjsim.robot.joint_kernel import SLOT

__all__ = ["FACTOR", "weight_factor", "weight_line"]

FACTOR = "weight / that of the file"


def weight_factor(s: JointSearch, V: np.ndarray) -> Estimate | None:
    """Least-squares multiple x of the file's weight w(t) about the joint that the weight found is.

        w + a sin q + b cos q ~ x w over the fitted samples

    V (P, P): covariance of the coded numbers. None where no such number stands.
    """
    law = next((x for x in s.now.laws if x.id == WEIGHT and x.number), None)
    if law is None:
        return None
    p = s.problem
    w, q = p.as_given.weight[p.fitted], p.angle[p.fitted]
    slots = ("weight_sin", "weight_cos")
    along = np.array([float(w @ f(q)) for f in (np.sin, np.cos)]) / float(w @ w)
    at = [next(i for i, n in enumerate(s.now.fit.numbers) if n.slot == name) for name in slots]
    scale = np.array([s.now.fit.numbers[i].scale for i in at])
    value = float(w @ p.weight[p.fitted]) / float(w @ w) + float(along @ [s.now.fit.slots[SLOT[name]] for name in slots])
    half = 1.96 * math.sqrt(max(float((along * scale) @ V[np.ix_(at, at)] @ (along * scale)), 0.0))
    return Estimate(value, (value - half, value + half), "1")


def weight_line(result: JointResult) -> list[str]:
    """In words, that the weight behind the joint differs, and what command and position do not tell."""
    e = result.linear_parameters.get(FACTOR)
    if e is None:
        return []
    turned = "" if not e.ci95[0] <= 1.0 <= e.ci95[1] else ", its centre in another direction"
    return [
        f"weight behind {result.joint}: {e.value:.4g} times the file's [{e.ci95[0]:.4g}, {e.ci95[1]:.4g}]{turned} "
        "(mass or centre of a link or a payload; which link, and a factor common to masses and gains, are not told by command "
        "and position)"
    ]
