"""The diagnosis of a robot, stage by stage: filter, regression, search, intervals, verdicts."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version

import mujoco
import numpy as np

from diagnose.check.unused import unused_of_robot
from diagnose.data.listed import listed
from diagnose.result import FitFigures, Verdict
from diagnose.robot import decide
from diagnose.robot.contact import contact_notes
from diagnose.robot.elastic import Elastic, elastic, flexible_findings
from diagnose.robot.motion import RobotMotion, clean_band, moving_joints, prepare
from diagnose.robot.options import RobotOptions
from diagnose.robot.physical import consistent
from diagnose.robot.problem import Problem, build
from diagnose.robot.remains import black_box
from diagnose.robot.result import JointResult, RobotDiagnosis, Trace
from diagnose.robot.select import select
from diagnose.robot.shifted import shifted
from diagnose.robot.solve import Solution
from diagnose.robot.state import Selection
from mjsim.errors import InputError, nearest
from mjsim.quantity import Motion
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.rows import check_rows

__all__ = ["EXCLUDE", "ORDER", "Outcome", "diagnose_robot", "overall", "summary"]

EXCLUDE = "record free motion, or <exclude> the bodies that touch in a copy of the model"
SHOWN = 2  # changed numbers in the summary
DRAWN = 20_000  # points of a trace at most
ORDER = (Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY, Verdict.MISSING_PHYSICS, Verdict.UNEXPLAINED)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The diagnosis, and the search that it comes from: what `corrected.xml` is written from.

    stiffness: of flexible joints [N m/rad | N/m], by name.
    """

    diagnosis: RobotDiagnosis
    search: Selection
    stiffness: Mapping[str, float] = field(default_factory=dict)


def diagnose_robot(
    robot: Robot,
    recordings: Sequence[RobotRecording],
    held_out: Sequence[RobotRecording] = (),
    options: RobotOptions | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> Outcome:
    """Diagnose every joint that moves, or those named, by the force that the recorded motion needs.

    Raises InputError for a model or recordings that are outside.
    """
    options = options or RobotOptions()
    begun = time.perf_counter()
    check_rows(robot)
    everything = [*recordings, *held_out]
    names = _chosen(robot, everything, options)
    cutoff = options.cutoff_hz or min(clean_band(robot, r, names) for r in everything)
    motions = [prepare(robot, r, names, cutoff, split=not held_out) for r in recordings]
    motions += [prepare(robot, r, names, cutoff, role="held-out") for r in held_out]
    problem = build(robot, motions, [robot.joints.index(n) for n in names], options.effects)
    _enough(problem)
    say(f"{len(names)} joints, {sum(len(p.y) for p in problem.fitted.values())} samples below {cutoff:.3g} Hz")
    search = select(problem, options)
    say(f"{len(search.solution.terms)} effects of {search.hypotheses} (joint, law) hypotheses")

    def again(moved: Sequence[RobotMotion]) -> Problem:
        return build(robot, moved, problem.joints, options.effects)

    flexible = elastic(robot, motions, search, options, again)
    if flexible.compliance:
        say(f"flexible: {', '.join(robot.joints[j] for j in flexible.compliance)}")
    diagnosis = _told(flexible, recordings, held_out, cutoff, begun)
    return Outcome(diagnosis, flexible.search, {robot.joints[j]: 1.0 / c for j, c in flexible.compliance.items()})


def _chosen(robot: Robot, recordings: Sequence[RobotRecording], options: RobotOptions) -> tuple[str, ...]:
    """Names of the joints to diagnose, in the order of the model. Raises InputError."""
    moving = moving_joints(robot, recordings)
    first = recordings[0]
    for name in options.joints:
        if name not in robot.joints:
            raise InputError(
                "--joint",
                f"joint {name!r} is not in the model",
                f"one of {', '.join(robot.joints)}",
                nearest(name, robot.joints, "correct the name"),
            )
        if name not in moving:
            why = "does not move" if first.has("torque", name) else "has no torque"
            raise InputError(first.source, f"joint {name!r} {why} in the log", "motion and torque of it", "name another joint")
    if not moving:
        raise InputError(
            first.source, "no joint has a torque and moves", f"columns such as {robot.joints[0]}.torque_Nm", "add or bind them; "
            "a log of positions and commands alone is diagnosed one joint at a time",
        )  # fmt: skip
    for r in recordings[1:]:
        lacking = [n for n in moving if not r.has("torque", n)]
        if lacking:
            raise InputError(r.source, f"no torque of joint {lacking[0]!r}", "the joints of the first recording", "add it")
    return tuple(n for n in robot.joints if n in (options.joints or moving))


def _enough(problem: Problem) -> None:
    for j in problem.joints:
        for parts, word in ((problem.fitted, "fitted"), (problem.held, "held-out")):
            if len(parts[j].y) < 30:
                touched = any(m.touching is not None and m.touching.rows[:, j].any() for m in problem.motions)
                free = " and out of contact" if touched else ""
                raise InputError(
                    problem.motions[0].source, f"{len(parts[j].y)} {word} samples of {problem.robot.joints[j]!r} in motion{free}",
                    "at least 30", EXCLUDE if touched else "record longer, or name the other joints by --joint",
                )  # fmt: skip


def _told(
    flexible: Elastic, recordings: Sequence[RobotRecording], held_out: Sequence[RobotRecording], cutoff: float, begun: float
) -> RobotDiagnosis:
    search, rigid = flexible.search, flexible.rigid
    p, s, robot = search.problem, search.solution, search.problem.robot
    given, refitted = decide.nominal_solution(rigid.problem, search.weights), decide.refit(rigid)
    V, slices = decide.posterior(search)
    found = decide.findings(search, V, slices)
    for j, own in flexible_findings(flexible).items():
        found[j] = [*own, *found[j]]
    links, values = decide.estimates(p, s, V)
    joints = {}
    for j in p.joints:
        name = robot.joints[j]
        remains = black_box(p, s, search.weights, search.rows, j)
        answer = decide.verdict(p, search.options, search.weights, j, bool(found[j]), remains, given, refitted)
        fit = {
            key: decide.figures(p, x, search.weights, j)
            for key, x in (("nominal", given), ("refitted", refitted), ("corrected", s))
        }
        refused = tuple(
            f"{r.law.key}: {r.reason}" for r in search.refusals.values() if r.joint == j and r.law.key not in _laws(s, j)
        )
        joints[name] = JointResult(
            name, "N m" if robot.motions[j].value == "hinge" else "N", answer, _sentence(answer, fit["corrected"], remains),
            tuple(found[j]), fit, {k.rpartition(".")[2]: v for k, v in values.items() if k.rpartition(".")[0] == name},
            {k.rpartition(".")[2]: float(v) for k, v in zip(p.names, p.nominal, strict=True) if k.rpartition(".")[0] == name},
            remains, refused, tuple(_traces(p, j, given, refitted, s)),
        )  # fmt: skip
    worst = max((r.verdict for r in joints.values()), key=ORDER.index)
    changed = decide.changes(search) if worst is not Verdict.NO_MISMATCH else ()
    return RobotDiagnosis(
        worst, summary(worst, joints, changed), joints, overall(joints), links,
        {k: float(v) for k, v in zip(p.names, p.nominal, strict=True)}, decide.base_parameters(p, s, V), changed,
        _notes(search, recordings, joints), search.hypotheses, cutoff,
        listed(recordings, held_out),
        search.options.seed, time.perf_counter() - begun,
        {"simgap": version("simgap"), "mujoco": mujoco.__version__, "numpy": np.__version__, "python": platform.python_version()},
        conditioning=decide.determined(p),
    )  # fmt: skip


def _laws(s: Solution, joint: int) -> set[str]:
    return {t.law.key for t in s.terms if t.joint == joint}


def _sentence(answer: Verdict, fit: FitFigures, remains: tuple[float, float]) -> str:
    """Why a joint has its verdict; the noise of a torque is not known, so that the error left is given."""
    left = f"{100 * fit.nrmse:.1f} % of the torque's spread on the fitted samples and {100 * fit.held_out_nrmse:.1f} % held out"
    black = f"a black-box model predicts {100 * max(remains[0], 0.0):.1f} % of the held-out squared error"
    start = {
        Verdict.NO_MISMATCH: "The file as given does as well as one with its numbers refitted.",
        Verdict.PARAMETERS_ONLY: "The structure is right, its numbers are not.",
        Verdict.MISSING_PHYSICS: "Physics is missing at this joint.",
        Verdict.UNEXPLAINED: "Structure remains that none of the known effects accounts for.",
    }[answer]
    return f"{start} The noise is not known by force: {left} is left, and {black}."


def summary(worst: Verdict, joints: Mapping[str, JointResult], changed: Sequence[str]) -> str:
    """In words: what is missing where, where structure remains, and which numbers differ."""
    found = [f for r in joints.values() for f in r.findings]
    named = [f"{f.effect.replace('_', ' ').replace('coulomb', 'Coulomb')} at {f.joint}" for f in found]
    open_ = [r.joint for r in joints.values() if r.verdict is Verdict.UNEXPLAINED]
    parts = []
    if named:
        parts.append(f"Missing: {', '.join(named)}.")
    if open_:
        parts.append(f"Structure remains at {', '.join(open_)}.")
    if changed and worst is not Verdict.NO_MISMATCH:
        more = f"; and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
        parts.append(f"Numbers that differ from the file: {'; '.join(changed[:SHOWN])}{more}.")
    return " ".join(parts) or "The model as given agrees with the log as well as one with its numbers refitted."


def overall(joints: Mapping[str, JointResult]) -> dict[str, FitFigures]:
    """Root mean square over the joints of the errors over the spread; rms is the same number, since units differ."""
    out = {}
    for key in next(iter(joints.values())).fit:
        figures = [r.fit[key] for r in joints.values()]
        a = math.sqrt(sum(f.nrmse**2 for f in figures) / len(figures))
        b = math.sqrt(sum(f.held_out_nrmse**2 for f in figures) / len(figures))
        out[key] = FitFigures(a, a, b, b)
    return out


def _notes(search: Selection, recordings: Sequence[RobotRecording], joints: Mapping[str, JointResult]) -> tuple[str, ...]:
    p = search.problem
    notes = [*dict.fromkeys(note for r in recordings for note in r.notes), *unused_of_robot(recordings)]
    notes += contact_notes(p.robot, [(m.source, m.touching, m.dt) for m in p.motions if m.touching is not None])
    for name, at in recordings[0].held_at:
        notes.append(f"Joint {name} is not in the log: it is held at {at:.4g}.")
    still = [n for n in recordings[0].joints if n not in joints]
    if still:
        notes.append(f"Not diagnosed, since they do not move, have no torque or are not named: {', '.join(still)}.")
    if not consistent(p, search.solution.theta) or search.solution.stiffness is not None:
        notes.append("Without the demand for physical links the fit would take inertial parameters that no body has.")
    return (*notes, *shifted(joints))


def _traces(p: Problem, j: int, *solutions: Solution) -> list[Trace]:
    """Torque and motion of a joint on the whole grid of each recording, by role; NaN at samples that do not count."""
    out = []
    angle, speed = ("m", "m/s") if p.robot.motions[j] is Motion.SLIDE else ("rad", "rad/s")
    for k, motion in enumerate(p.motions):
        for parts, which, role in ((p.fitted[j], "fitted", "estimation"), (p.held[j], "held", "held-out")):
            rows = parts.run == k
            counted = motion.counts[:, j] & (motion.held if which == "held" else ~motion.held)
            if not rows.any():
                continue
            keep = slice(0, len(counted), max(1, len(counted) // DRAWN))
            signals = [parts.measured[rows], *(parts.measured[rows] - getattr(s, which)[j][rows] for s in solutions)]
            states = {
                "position": (motion.thinned(motion.z)[keep, j], angle), "velocity": (motion.thinned(motion.dz)[keep, j], speed)
            }  # fmt: skip
            measured, given, refitted, corrected = (_spread(y, counted)[keep] for y in signals)
            time = (p.dt * np.arange(len(counted)))[keep]
            out.append(Trace(motion.source, role, time, measured, given, refitted, corrected, counted[keep], states))
    return out


def _spread(y: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Values at the samples that count (n,) on the whole grid (M,), NaN elsewhere."""
    out = np.full(len(counted), np.nan)
    out[counted] = y
    return out
