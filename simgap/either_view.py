"""A log of torque and position compared by force, and by motion where a free run of the answer follows it.

A comparison by force needs the acceleration, whose noise biases what it fits; it holds where unknown torques make a free run
drift. Where they do not, motion is compared (docs/decisions/motion-and-force.md).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from diagnose.data.split import split
from diagnose.fit.fitter import Fitter
from diagnose.options import Options
from diagnose.problem.view import MotionView
from diagnose.progress import Step
from diagnose.result import Diagnosis, Verdict
from diagnose.thresholds import FAR
from diagnose.verdict.reference_stage import Nominal
from mjsim.axis import Axis
from mjsim.effects import NotApplicableError
from mjsim.errors import InputError
from mjsim.recording import Recording
from simgap.either_numerics import by_either_numerics
from simgap.found import as_fitted, physics_found
from simgap.judging import before_search

__all__ = ["by_motion_too"]

BY_MOTION = (
    "The log has no velocity. Compared by force first, then by motion, by the rate of the angle on both sides: a free run of "
    "what was found by force follows the recordings."
)


def by_motion_too(
    model: Path, nominal: Axis, first: Diagnosis, recordings: Sequence[Recording], held_out: Sequence[Recording],
    options: Options, say: Callable[[Step], None],
) -> tuple[Axis, Nominal | None, Diagnosis]:  # fmt: skip
    """The nominal axis, the runs of its file in MuJoCo and the diagnosis by motion; as given, with None, where force decides.

    ``first``: the diagnosis by force. Motion is compared where neither options nor bindings choose, the log has an angle and no
    velocity, and a free run of what was found follows it; it decides where it explains the recordings.
    """
    began = time.monotonic()
    if not (_is_open(first, recordings[0], options) and _follows_freely(nominal, first, recordings, held_out, options)):
        return nominal, None, first
    left = options.since(began)
    if not left.seconds:
        return nominal, None, first
    say(Step("reference", "again by motion, which a free run of the answer follows"))
    free = dataclasses.replace(left, judge="motion")
    given = before_search(model, nominal, recordings, held_out, free)
    if given is None:  # a known torque, which a file does not hold
        return nominal, None, first
    axis, runs, second = by_either_numerics(given, recordings, held_out, free, say, None)
    if second.verdict is Verdict.UNEXPLAINED:
        return nominal, None, first
    return axis, runs, dataclasses.replace(second, notes=(BY_MOTION, *second.notes))


def _is_open(result: Diagnosis, first: Recording, options: Options) -> bool:
    """Whether a diagnosis by force may be one by motion: neither options nor bindings choose, and there is an angle alone."""
    chosen = options.judge or first.judge
    return result.channel == "torque" and chosen is None and first.velocity is None and first.angle is not None


def _follows_freely(
    nominal: Axis, result: Diagnosis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options
) -> bool:
    """Whether a free run of what was found by force, its numbers refitted to the motion, leaves less than `FAR` times the noise
    variance on the estimation data."""
    fitter: Fitter | None = None
    try:
        view = MotionView.of(nominal, recordings)
        fitter = Fitter(nominal, view, *split(recordings, held_out), options.jobs, recordings[0].varies)
        fitted = fitter.fit(fitter.hypothesis(physics_found(result), as_fitted(result)))
        return fitted.ok and not fitter.above(fitted, FAR)
    except (InputError, NotApplicableError):
        return False
    finally:
        if fitter is not None:
            fitter.close()
