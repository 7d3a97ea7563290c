"""What the best structure leaves: whether it is material, and whether it is missing physics.

Errors are mean squares in units of the noise variance. With m the error of the refitted nominal model above the noise and l that
of the best structure, the part of the rms error that is closed is

    1 - (sqrt(1 + l) - 1) / (sqrt(1 + m) - 1)

Thresholds: docs/decisions/evidence.md.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from diagnose.data.experiment import held_rows
from diagnose.data.noise import white_noise_level
from diagnose.evidence.encoder import fit_with_encoder_error
from diagnose.evidence.predictable import Structure, by_rate_of_angle, motion_error, motion_errors, remaining_structure
from diagnose.evidence.torque_noise import made_by_torque_noise
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.validation import error_on, observed_error, pooled, predicted_samples
from diagnose.fit.whiten import noise_rms
from diagnose.options import Options
from diagnose.problem.view import ForceView
from diagnose.structure.search import Search
from diagnose.thresholds import CLEAR, MOST, OBSERVER_GAINS, SENSOR_SHARE, TWICE

__all__ = ["Remaining", "RepeatedRows", "closed", "remaining_error", "repeated_rows"]


@dataclass(frozen=True)
class Remaining:
    """What the best structure leaves, and what that is held to be.

    structure: the part of the held-out residual that input and motion predict; motion: mean square of the motion that the
    refitted nominal model and the best structure miss, over the noise variance, None where it cannot be told; unexplained: a
    material error is left that is no effect of the library; diverges: it is that of a free run whose events come at other
    moments; by_parameters: parameters fitted to every recording leave nothing; by_encoder: it repeats with the encoder's turn;
    beyond_sensors: judged by force, it is more than the noise of angle and torque can be; by_torque_noise: it is what the noise
    of the recorded torque makes of a free run.
    """

    structure: Structure
    motion: tuple[float | None, float | None]
    unexplained: bool
    diverges: bool = False
    by_parameters: bool = False
    by_encoder: bool = False
    beyond_sensors: bool = False
    by_torque_noise: bool = False


@dataclass(frozen=True)
class RepeatedRows:
    """Rows of all recordings that repeat the row before and were not measured: how many, and the error that they add.

    error: largest mean square over the recordings, over the noise variance.
    """

    count: int
    error: float


def closed(before: float, after: float) -> float:
    """Part of the rms error above the noise that was closed, from mean squares above the noise's, in units of its variance."""
    if before <= 0.0:
        return 0.0
    return 1.0 - (math.sqrt(1.0 + max(after, 0.0)) - 1.0) / (math.sqrt(1.0 + before) - 1.0)


def remaining_error(search: Search, base: Fitted, best: Fitted, structure: Structure, options: Options) -> Remaining:
    """Judge what ``best`` leaves.

    An error that is material is looked at once more by what may account for it other than missing physics: the divergence of a
    free run with events, parameters that the estimation recordings leave open, an encoder that errs over its turn.
    """
    fitter = search.fitter
    motion = motion_errors(fitter, base, best)
    now = Remaining(structure, motion, _is_unexplained(search, base, search.held_out(best), structure, motion, options))
    now = dataclasses.replace(now, unexplained=now.unexplained or _is_left_behind(fitter, base, best, options))
    beyond = _beyond_sensors(fitter, search.held_out(best))
    # effects that explain most of the error keep the verdict; the remaining error is stated
    little = beyond and not _explains_most(search.held_out(base), search.held_out(best))
    now = dataclasses.replace(now, beyond_sensors=beyond, unexplained=now.unexplained or little)
    if beyond:
        return now
    if not now.unexplained:
        if not _far_from_noise(fitter, best, search.held_out(best), motion[1]):
            return now
        diverges = _only_diverges(fitter, base, best, options)
        return dataclasses.replace(now, unexplained=not diverges, diverges=diverges)
    if _only_diverges(fitter, base, best, options):
        return dataclasses.replace(now, unexplained=False, diverges=True)
    if made_by_torque_noise(fitter, best):
        return dataclasses.replace(now, unexplained=False, by_torque_noise=True)
    # what the estimation recordings leave open is no missing physics: every recording may settle the parameters
    by_all = pooled(fitter, best)
    now = _judged_again(search, base, by_all, now, options)
    now = dataclasses.replace(now, unexplained=now.unexplained or _left_on_estimation(fitter, base, by_all, options))
    now = dataclasses.replace(now, by_parameters=not now.unexplained)
    beside = fit_with_encoder_error(fitter, best, search.options.entry) if now.unexplained else None
    if beside is None:
        return now
    # parameters that have bent to an encoder's error miss motion by it
    now = _judged_again(search, base, beside, now, options)
    unexplained = now.unexplained or _is_left_behind(fitter, base, beside, options)
    return dataclasses.replace(now, unexplained=unexplained, by_encoder=not unexplained)


def _judged_again(search: Search, base: Fitted, other: Fitted, now: Remaining, options: Options) -> Remaining:
    """The same judgement of another fit of the best structure."""
    fitter = search.fitter
    structure, motion = remaining_structure(fitter, other), (now.motion[0], motion_error(fitter, other))
    unexplained = _is_unexplained(search, base, fitter.validate(other), structure, motion, options)
    return dataclasses.replace(now, structure=structure, motion=motion, unexplained=unexplained)


def _is_unexplained(
    search: Search, base: Fitted, after: HeldOut | None, structure: Structure, motion: tuple[float | None, float | None],
    options: Options,
) -> bool:  # fmt: skip
    """Whether the remaining held-out error is material against the noise, and against the mismatch that there was.

    Two witnesses: the part of the held-out error that the input and the motion predict, and the motion that the angle confirms.
    """
    before = search.held_out(base)
    if before is None or after is None:
        return False
    predicted = structure.share * after.rms**2
    clear = structure.p_value < options.structure_p and structure.share > options.structure_share
    if not search.fitter.noise.absolute:
        return clear and predicted > options.left * before.rms**2
    variance = noise_rms(search.fitter, search.fitter.experiments[0]) ** 2
    mismatch, left = before.rms**2 / variance - 1.0, after.rms**2 / variance - 1.0
    if clear and closed(mismatch, predicted / variance) < options.closed:
        return True
    missed_before, missed_after = motion
    if missed_before is None or missed_after is None or missed_after <= options.missed:
        return False
    if closed(missed_before, missed_after) >= options.closed:
        return False
    # fast motion averages out in what the angle confirms: how much of all was closed is seen in the error itself
    return by_rate_of_angle(search.fitter) or closed(mismatch, left) < options.closed


def _is_left_behind(fitter: Fitter, base: Fitted, best: Fitted, options: Options) -> bool:
    """Whether a material error is left on the recordings that the model was fitted to, and the angle confirms it as motion.

    What a confounder explains under one excitation it may leave under another, and that may be the one it was fitted to.
    """
    left = best.chi2 / best.n - 1.0
    hidden = (
        not fitter.noise.exceeds(left + 1.0, 1.0 + options.missed) or closed(base.chi2 / base.n - 1.0, left) >= options.closed
    )
    if hidden and not by_rate_of_angle(fitter):  # the noise of a rate hides motion that the angle shows
        return False
    before, after = motion_errors(fitter, base, best, fitter.experiments)
    return before is not None and after is not None and after > options.missed and closed(before, after) < options.closed


def _far_from_noise(fitter: Fitter, best: Fitted, held: HeldOut | None, missed: float | None) -> bool:
    """Whether the error is more than noise of any colour: over `TWICE**2` times the mean square that the recording shows.

    Asked where one channel alone shows the motion, so that no second one can tell noise from it: an angle that is judged, or a
    velocity of which the angle tells nothing (``missed`` is None).
    """
    if not fitter.noise.absolute or (missed is not None and fitter.view.channel == "velocity"):
        return False
    for i, experiment in enumerate(fitter.experiments):
        e, level = fitter.error_of(best, i), fitter.view.noise(experiment)
        if e is not None and level and float(np.mean(e[fitter.counted(experiment)] ** 2)) > TWICE**2 * level**2:
            return True
    levels = [level for e in fitter.held_out if (level := fitter.view.noise(e))]
    return held is not None and bool(levels) and held.rms**2 > TWICE**2 * float(np.mean(np.square(levels)))


def _explains_most(before: HeldOut | None, after: HeldOut | None) -> bool:
    """Whether a model takes more than `MOST` of the held-out squared error of the refitted nominal model."""
    return before is not None and after is not None and after.rms**2 < (1.0 - MOST) * before.rms**2


def _beyond_sensors(fitter: Fitter, held: HeldOut | None) -> bool:
    """Whether the force that a model misses is more than sensors make of it.

    The band is such that the noise of the angle, differentiated twice, has `SENSOR_SHARE` of the torque's power; the torque's
    is the white part of it in the same band. `TWICE**2` times their sum is allowed.
    """
    view = fitter.view
    if held is None or not isinstance(view, ForceView):
        return False
    sensors = 0.0
    for e in fitter.held_out:
        u, dt = e.recording.torque, e.recording.dt
        band = min(1.0, 2.0 * dt * view.band(dt))
        sensors = max(sensors, SENSOR_SHARE + band * white_noise_level(u) ** 2 / float(np.var(u)))
    return held.nrmse**2 > TWICE**2 * sensors


def _only_diverges(fitter: Fitter, base: Fitted, best: Fitted, options: Options) -> bool:
    """Whether a held-out error is that of a free run whose events come at other moments.

    Stick-slip and impacts make such a run diverge by an error of its parameters far within their intervals. While models drawn
    by the covariance stay together, or under an observer gain that leaves an event no time to carry, the held-out recording still
    judges: the model must leave no material error there, and the nominal one much more than that.
    """
    if not best.rough or not fitter.noise.within(best.chi2 / best.n, 1.0 + options.missed):
        return False

    def judged(before: float | None, after: float | None) -> bool:
        if before is None or after is None:
            return False
        # the measured noise enters through the observer gain: the error is small, or small beside the nominal model's
        little = after - 1.0 < options.missed or closed(before - 1.0, after - 1.0) >= options.closed
        return little and before - 1.0 > CLEAR * options.missed

    samples = predicted_samples(fitter, best)
    if samples is not None and judged(error_on(fitter, base, samples), error_on(fitter, best, samples)):
        return True
    return any(judged(*(observed_error(fitter, f, gain) for f in (base, best))) for gain in OBSERVER_GAINS)


def _left_on_estimation(fitter: Fitter, base: Fitted, by_all: Fitted, options: Options) -> bool:
    """Whether a model fitted to every recording leaves the estimation recordings a material error, whitened if need be."""
    r = fitter.residual(by_all.hypothesis)(by_all.fit.x) if fitter.noise.absolute else None
    if r is None:
        return False
    left = float(r @ r) / base.n - 1.0
    return left > options.missed and closed(base.chi2 / base.n - 1.0, left) < options.closed


def repeated_rows(fitter: Fitter, best: Fitted) -> RepeatedRows:
    """Rows that were held and not measured, over all recordings."""
    if fitter.view.channel != "velocity":
        return RepeatedRows(0, 0.0)
    # one recording may be fitted in some blocks and held out in others
    experiments = {id(e.recording): e for e in (*fitter.held_out, *fitter.experiments)}
    count, most = 0, 0.0
    for experiment in experiments.values():
        rows = held_rows(experiment.recording)
        count += int(rows.sum())
        solved = fitter.own_values(best.hypothesis, best, experiment) if rows.any() and fitter.noise.absolute else None
        e = fitter.error(solved[0], experiment, solved[1]) if solved is not None else None
        if e is not None:
            most = max(most, float(np.sum(e[rows] ** 2)) / len(e) / noise_rms(fitter, experiment) ** 2)
    return RepeatedRows(count, most)
