"""A log compared both ways where one is not enough: by force, and by motion.

A comparison by force needs the acceleration, whose noise biases what it fits; it holds where unknown torques make a free run
drift. A log of torque and position is compared by force, and by motion where a free run of the answer, or of the nominal
structure, follows it. A log with a velocity is compared by motion, and by force where a free run leaves the mismatch unexplained
and names nothing (docs/decisions/motion-and-force.md).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from diagnose.data.split import split
from diagnose.fit.fitter import Fitter
from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.problem.view import MotionView
from diagnose.progress import Step
from diagnose.result import Diagnosis, Verdict
from diagnose.thresholds import FAR, MATERIAL, MOST
from diagnose.verdict.reference import at_noise
from diagnose.verdict.reference_stage import Nominal
from diagnose.verdict.summary import summary
from mjsim.axis import Axis
from mjsim.effects import NotApplicableError
from mjsim.errors import InputError
from mjsim.recording import Recording
from simgap.either_numerics import by_either_numerics
from simgap.found import as_fitted, physics_found
from simgap.judging import before_search

__all__ = ["by_force_too", "by_motion_too"]

BY_MOTION = (
    "The log has no velocity. Compared by force first, then by motion, by the rate of the angle on both sides, which explains "
    "more."
)
BY_FORCE = (
    "Compared by motion, no effect was found that takes most of the error: what a free run misses adds up. What is named is "
    "found by the force that the recorded motion needs, where each sample counts for itself. The mismatch of the free run stays "
    "unexplained."
)


def by_motion_too(
    model: Path, nominal: Axis, first: Diagnosis, recordings: Sequence[Recording], held_out: Sequence[Recording],
    options: Options, say: Callable[[Step], None],
) -> tuple[Axis, Nominal | None, Diagnosis]:  # fmt: skip
    """The nominal axis, the runs of its file in MuJoCo and the diagnosis by motion; as given, with None, where force decides.

    ``first``: the diagnosis by force. Motion is compared where neither options nor bindings choose, the log has an angle and no
    velocity, and a free run of what was found follows it, or force explains nothing; it decides where it explains the recordings,
    or names what takes most of the error where force names nothing.
    """
    began = time.monotonic()
    if not _is_open(first, recordings[0], options):
        return nominal, None, first
    nothing = first.verdict is Verdict.UNEXPLAINED and not first.findings
    if not nothing and not _follows_freely(nominal, first, recordings, held_out, options):
        return nominal, None, first
    left = options.since(began)
    if not left.seconds:
        return nominal, None, first
    say(Step("reference", "again by motion"))
    free = dataclasses.replace(left, judge="motion")
    given = before_search(model, nominal, recordings, held_out, free)
    if given is None:  # a known torque, which a file does not hold
        return nominal, None, first
    axis, runs, second = by_either_numerics(given, recordings, held_out, free, say, None)
    if second.verdict is Verdict.UNEXPLAINED and not (nothing and second.findings and _explains_most(second)):
        return nominal, None, first
    return axis, runs, dataclasses.replace(second, notes=(BY_MOTION, *second.notes))


def by_force_too(
    nominal: Axis, first: Diagnosis, given: Nominal, recordings: Sequence[Recording], held_out: Sequence[Recording],
    options: Options, say: Callable[[Step], None],
) -> Diagnosis:  # fmt: skip
    """The diagnosis by force where that by motion is unexplained and names nothing that takes most of the error.

    ``first``: the diagnosis by motion, ``given``: the nominal file in MuJoCo. The verdict stays ``unexplained``. As given where
    options or bindings choose the comparison, under a servo, where MuJoCo follows the recordings, or where force finds nothing
    that predicts better than the model as given.
    """
    chosen = options.judge or recordings[0].judge or nominal.chain.servo
    if first.verdict is not Verdict.UNEXPLAINED or chosen is not None or (first.findings and _explains_most(first)):
        return first
    if not options.seconds or at_noise(given.cases, given.runs, angles=True):
        return first
    say(Step("reference", "again by force, since a free run names nothing that takes most of the error"))
    try:
        second = diagnose(nominal, recordings, held_out, dataclasses.replace(options, judge="force"), say)
    except InputError:  # too few samples count, or the chain swings up when its motion is imposed
        return first
    if not second.findings or not _better_than_given(second):
        return first
    said = summary(Verdict.UNEXPLAINED, second.findings, second.fit, second.gap_closed, False, second.unit)
    return dataclasses.replace(second, verdict=Verdict.UNEXPLAINED, summary=said, notes=(BY_FORCE, *second.notes))


def _better_than_given(result: Diagnosis) -> bool:
    """Whether what was found predicts the held-out recordings better than the model as given, whose numbers were not fitted."""
    return result.fit["corrected"].held_out_rms < result.fit["nominal"].held_out_rms


def _explains_most(result: Diagnosis) -> bool:
    """Whether what was found takes more than `MOST` of the held-out squared error of the refitted nominal model."""
    before, after = (result.fit[name].held_out_rms for name in ("refitted", "corrected"))
    return after**2 < (1.0 - MOST) * before**2


def _is_open(result: Diagnosis, first: Recording, options: Options) -> bool:
    """Whether a diagnosis by force may be one by motion: neither options nor bindings choose, and there is an angle alone."""
    chosen = options.judge or first.judge
    return result.channel == "torque" and chosen is None and first.velocity is None and first.angle is not None


def _follows_freely(
    nominal: Axis, result: Diagnosis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options
) -> bool:
    """Whether a free run of what was found by force, or of the nominal structure, its numbers refitted to the motion, leaves less
    than `FAR` times the noise variance on the estimation data, or `MATERIAL` of the squared motion on the held-out data.

    The simulator's numerics may be more than the noise, and drift by a torque that is not in the model is much of the motion.
    """
    fitter: Fitter | None = None
    try:
        view = MotionView.of(nominal, recordings)
        fitter = Fitter(nominal, view, *split(recordings, held_out), options.jobs, recordings[0].varies)
        found = physics_found(result)
        for h in (fitter.hypothesis(found, as_fitted(result)), *([fitter.hypothesis(())] if found else [])):
            fitted = fitter.fit(h)
            if fitted.ok and not fitter.above(fitted, FAR):
                return True
            held = fitter.validate(fitted) if fitted.ok else None
            if held is not None and held.nrmse**2 < MATERIAL:
                return True
        return False
    except (InputError, NotApplicableError):
        return False
    finally:
        if fitter is not None:
            fitter.close()
