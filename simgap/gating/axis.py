"""The gate of an axis: the errors of its diagnosis, once more, with the model of today."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from diagnose.data.channels import with_common_channels
from diagnose.data.derived import without_derived_velocity
from diagnose.data.experiment import Experiment, hold_out_blocks, prepare
from diagnose.data.gap_input import with_input_in_gaps
from diagnose.data.listed import as_taken
from diagnose.data.servo import as_servo
from diagnose.problem.choose_view import choose_view
from diagnose.problem.view import View
from diagnose.thresholds import SHORTEST
from diagnose.verdict.reference import Case, cases_of, error
from diagnose.verdict.reference_runs import run_files
from mjsim.axis import Axis
from mjsim.control import as_driven
from mjsim.mjcf import carried_binding, load_model
from mjsim.mjcf.whole import WRITTEN, is_whole, write_whole
from mjsim.plant import MujocoPlant
from mjsim.recording import Recording, load
from simgap.gating.check import ROLES, Baseline, Check, of_the_baseline, ratio_of

__all__ = ["judged"]


@dataclass(frozen=True)
class _Errors:
    """Errors of one recording: sums of squares and numbers of samples of each role it has in the baseline."""

    source: str
    roles: tuple[str, ...]
    squares: Mapping[str, float]
    counts: Mapping[str, int]


def judged(model: Path, recordings: Sequence[Path], known: Baseline, tolerance: float) -> list[Check]:
    """Checks of a model on recordings against a baseline's figures.

    A recording is known by its SHA-256. All recordings of one role in the baseline are compared together with the figure of that
    role, since the baseline holds one figure for them; where some are missing, each is compared alone. Raises InputError.
    """
    source = load_model(model)
    chain = source.axis.chain
    loaded = [as_driven(chain, load(p, model=model, binding=carried_binding(source, p), driven=chain.driven)) for p in recordings]
    loaded = [as_taken(r, known.holds) for r in loaded]
    roles = [of_the_baseline(r.source, r.sha256, known) for r in loaded]
    loaded, _, _ = with_common_channels(loaded, [])
    loaded, _, _ = with_input_in_gaps(loaded, [])
    if known.by_mujoco:
        errors = _in_mujoco(model, source.axis, loaded, roles)
    else:
        loaded = [without_derived_velocity(r) for r in loaded]
        view = choose_view(loaded, known.view, source.axis)
        errors = [_errors(source.axis, view, r, own) for r, own in zip(loaded, roles, strict=True)]
    checks, alone = [], list(errors)
    for each in dict.fromkeys(e.roles for e in errors):
        group = [e for e in errors if e.roles == each]
        if len(group) == sum(1 for r in known.roles.values() if r == each):
            checks.append(_check(group, each, known, tolerance))
            alone = [e for e in alone if e.roles != each]
    return [*checks, *(_check([e], e.roles, known, tolerance) for e in alone)]


def _in_mujoco(model: Path, axis: Axis, recordings: Sequence[Recording], roles: Sequence[tuple[str, ...]]) -> list[_Errors]:
    """Squared errors of the file as MuJoCo steps it with its own options, which is what the baseline's figures are of."""
    cases = [_case(axis, r, own) for r, own in zip(recordings, roles, strict=True)]
    with tempfile.TemporaryDirectory() as work:
        whole = model if is_whole(model) else write_whole(model, Path(work) / WRITTEN)
        runs = run_files([MujocoPlant.load(whole)], cases, threads=1)[0]
    out = []
    for case, run, own in zip(cases, runs, roles, strict=True):
        masks = {role: m for role, m in zip(ROLES, (case.estimation, case.held_out), strict=True) if role in own}
        squares = {role: math.inf if run is None else float(np.sum(error(case, run)[m] ** 2)) for role, m in masks.items()}
        counts = {role: max(1, int(np.sum(m))) for role, m in masks.items()}
        out.append(_Errors(case.recording.source, own, squares, counts))
    return out


def _case(axis: Axis, recording: Recording, roles: tuple[str, ...]) -> Case:
    """The recording split as the diagnosis split it: into blocks where it had both roles."""
    _, (r,), _, _ = as_servo(axis, [recording], [])
    return cases_of([r], [], SHORTEST)[0] if len(roles) > 1 else cases_of([r], [r], SHORTEST)[ROLES.index(roles[0])]


def _errors(axis: Axis, view: View, recording: Recording, roles: tuple[str, ...]) -> _Errors:
    """Squared errors of the model on one recording, for each role that it has in the baseline.

    From rest or from the recorded speed, whichever has the smaller error. On what was not fitted, the phases of effects over
    the angle are estimated anew, as the diagnosis does: the zero of an encoder may differ between recordings.
    """
    squares, counts = {}, {}
    blocks = dict(zip(ROLES, hold_out_blocks(recording), strict=True))
    for role in roles:
        experiment = prepare(recording, counts=blocks[role] if len(roles) > 1 else None, minimum=SHORTEST)
        axes = [axis] if role == "estimation" else [axis, _in_phase(axis, view, experiment)]
        starts = _starts(axis, recording) if view.channel == "velocity" else [None]
        keep = view.counts(experiment)
        errors = [_error(each, view, experiment, initial) for each in axes for initial in starts]
        squares[role] = min((float(np.sum(e[keep] ** 2)) for e in errors if e is not None), default=math.inf)
        counts[role] = max(1, int(np.sum(keep)))
    return _Errors(recording.source, roles, squares, counts)


def _error(axis: Axis, view: View, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray | None:
    """Measured minus predicted (M,) in the view's unit; None when the run is not finite."""
    s = view.signals(axis, experiment, initial)
    return None if s is None or not np.isfinite(s.predicted).all() else s.measured - s.predicted


def _in_phase(axis: Axis, view: View, experiment: Experiment) -> Axis:
    """The axis with the per-recording parameters of its effects (phases) fitted to this recording by least squares."""
    free = [(e.key, s.name) for e in axis.effects for s in e.specs() if s.nuisance]
    start = np.array([getattr(e, s.name) for e in axis.effects for s in e.specs() if s.nuisance])
    keep = view.counts(experiment)
    if not free or (as_given := _error(axis, view, experiment, None)) is None:
        return axis

    def moved(x: np.ndarray) -> Axis:
        out = axis
        for e in axis.effects:
            own = {name: float(v) for (key, name), v in zip(free, x, strict=True) if key == e.key}
            out = out.without(e.key) + e.with_values(own) if own else out
        return out

    def residual(x: np.ndarray) -> np.ndarray:
        error = _error(moved(x), view, experiment, None)
        return np.full(int(keep.sum()), 1e6 * np.std(as_given)) if error is None else error[keep]

    # the solver's steps are relative: the shift is counted from 1, so that a central step is 1e-3 rad whatever the phase is
    fit = least_squares(lambda z: residual(start + z - 1.0), np.ones(len(start)), jac="3-point", diff_step=1e-3, max_nfev=20)
    return moved(start + fit.x - 1.0)


def _starts(axis: Axis, recording: Recording) -> list[np.ndarray | None]:
    """Rest, and the chain moving as recorded at the first sample (a straight line through the first 5 ms), without deflection."""
    speed = recording.velocity if recording.velocity is not None else np.gradient(recording.column("angle"), recording.dt)
    few = max(2, min(len(speed), round(0.005 / recording.dt)))
    first = float(np.polynomial.Polynomial.fit(np.arange(few), speed[:few], 1)(0.0))
    ratios = np.array([axis.chain.total_ratio(i) for i in range(len(axis.chain.bodies))])
    angle = float(recording.angle[0]) if recording.angle is not None else 0.0
    return [None, np.array([angle * ratios, first * ratios])]


def _check(group: Sequence[_Errors], roles: tuple[str, ...], known: Baseline, tolerance: float) -> Check:
    """The errors of a group against the baseline's figures, each role weighted by its number of samples."""
    count = {role: sum(e.counts[role] for e in group) for role in group[0].counts}
    total = sum(count.values())
    rms = math.sqrt(sum(sum(e.squares[role] for e in group) for role in count) / total)
    reference = {role: known.rms[role] if math.isfinite(known.rms[role]) else known.rms["estimation"] for role in count}
    before = math.sqrt(sum(count[role] * reference[role] ** 2 for role in count) / total)
    ratio = ratio_of(rms, before)
    named = tuple(e.source for e in group)
    return Check(named, " + ".join(roles), rms, before, ratio, not ratio <= 1 + tolerance, known.unit)
