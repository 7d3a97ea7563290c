"""Verdicts of servo joints by all joints together: the closed-loop run of corrected.xml in MuJoCo beside the recordings.

The search fits one joint at a time while the others follow the recording. The run of the whole robot has the errors of all joints
at once, so that its figures decide: a verdict stands only where they agree with it.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from diagnose.result import FitFigures, Verdict
from diagnose.robot.result import JointResult
from diagnose.robot.servos.answer import AT_NOISE, STARTS
from diagnose.robot.servos.fit import Fit
from diagnose.robot.servos.remains import black_box, tells
from diagnose.robot.servos.state import JointSearch

__all__ = ["is_explained", "judged", "leaves_noise", "lowered", "predictable"]

LEVEL = 0.05  # of the one-sided test that a black-box model predicts the error


def predictable(s: JointSearch, error: np.ndarray) -> tuple[float, float]:
    """(share of the held-out squared closed-loop error (N,) that a black-box model predicts, its one-sided p-value)."""
    if not np.isfinite(error).all():
        return 1.0, 0.0
    fit: Fit = dataclasses.replace(s.now.fit, error=error)
    return black_box(s.problem, fit)


def is_explained(s: JointSearch, error: np.ndarray, remains: tuple[float, float]) -> bool:
    """Whether a closed-loop error (N,) is at the noise of the position, or at the error of a black-box model of the same data."""
    if not np.isfinite(error).all():
        return False
    if leaves_noise(s, error) or remains[0] <= s.options.remains:
        return True
    return remains[1] >= LEVEL and tells(s.problem, error, s.now.fit.weights)


def leaves_noise(s: JointSearch, error: np.ndarray) -> bool:
    """Whether a closed-loop error (N,) is at the noise of the position, on fitted and held-out samples."""
    p = s.problem
    return bool(
        np.isfinite(error).all()
        and all(float(np.sqrt(np.mean(error[mask] ** 2))) < AT_NOISE * p.noise for mask in (p.fitted, p.held) if mask.any())
    )


def lowered(nominal: FitFigures, corrected: FitFigures) -> bool:
    """Whether the held-out closed-loop error of corrected.xml is below that of the file as given; a diverged run is above any."""
    before, after = (x.held_out_rms if math.isfinite(x.held_out_rms) else math.inf for x in (nominal, corrected))
    return after < before


def judged(
    s: JointSearch, result: JointResult, explained: bool, remains: tuple[float, float], *, noise: bool = False
) -> JointResult:
    """The result of a joint with the verdict that its closed-loop figures allow; ``result.fit`` holds these figures.

    noise: whether the closed-loop error is at the noise.

    ``unexplained`` where corrected.xml does not lower the held-out error that it changes, or where its error is neither at the
    noise nor at that of a black-box model. A joint that is ``unexplained`` by itself, along the smoothed motion of the others, is
    explained where the whole robot leaves noise. Findings are kept.
    """
    changes = result.verdict is not Verdict.NO_MISMATCH
    nominal, corrected = result.fit["nominal"], result.fit["corrected"]
    factor, unit = 1e3, "mm" if s.problem.slide else "mrad"
    if result.verdict is Verdict.UNEXPLAINED:
        if not (noise and lowered(nominal, corrected)):
            return result
        why = (
            f"All joints together in MuJoCo, corrected.xml leaves {factor * corrected.held_out_rms:.3g} {unit} rms on held-out "
            "samples, which is noise."
        )
        verdict = Verdict.MISSING_PHYSICS if result.findings else Verdict.PARAMETERS_ONLY
        return dataclasses.replace(result, verdict=verdict, summary=f"{STARTS[verdict]} {why}")
    if changes and not lowered(nominal, corrected):
        why = (
            f"All joints together in MuJoCo, corrected.xml does not lower the held-out error of this joint "
            f"({factor * nominal.held_out_rms:.3g} {unit} as given, {factor * corrected.held_out_rms:.3g} {unit} corrected)."
        )
    elif not explained:
        why = (
            f"All joints together in MuJoCo, {factor * corrected.held_out_rms:.3g} {unit} rms is left on held-out samples. A "
            f"black-box model predicts {100 * remains[0]:.1f} % of its square. The joint alone follows the recording, the robot "
            "does not."
        )
    else:
        return result
    return dataclasses.replace(result, verdict=Verdict.UNEXPLAINED, summary=f"{why} {result.summary}")
