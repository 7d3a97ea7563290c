"""The diagnosis of a servo robot from commands and positions, stage by stage: series, fits, search at each joint, scale,
answer."""

from __future__ import annotations

import dataclasses
import math
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from types import MappingProxyType

import mujoco
import numpy as np

from diagnose.check.unused import unused_of_robot
from diagnose.data.listed import listed
from diagnose.robot.contact import contact_notes
from diagnose.robot.options import RobotOptions
from diagnose.robot.pipeline import EXCLUDE, ORDER, overall, summary
from diagnose.robot.result import RobotDiagnosis
from diagnose.robot.servos.agree import Masses, agree
from diagnose.robot.servos.answer import Scale, answer, changed, scale_of, scale_of_fit
from diagnose.robot.servos.bodies import body_numbers
from diagnose.robot.servos.clocks import clocks
from diagnose.robot.servos.fit import Fit, Number
from diagnose.robot.servos.motion import JointProblem, joint_problem, moving, prepare
from diagnose.robot.servos.search import refit_with, search_joint
from diagnose.robot.servos.softness import with_fitting_friction
from diagnose.robot.servos.starts import own_numbers, start_fit
from diagnose.robot.servos.state import JointSearch
from diagnose.robot.servos.unfollowed import unfollowed_note
from diagnose.robot.shifted import shifted
from mjsim.errors import InputError, nearest
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.rows import check_rows
from mjsim.robot.touching import Touching

__all__ = ["ServoOutcome", "diagnose_servos", "search_beside"]

IDLE = "The actuator of {name} has the further input {inputs}, of which a log holds nothing: it is taken as zero."
FEWEST = 200  # samples of a joint in motion, fitted and held out each
SPREAD = 0.3  # standard deviation of the logarithm of a gain among servos of one kind


@dataclass(frozen=True, eq=False)
class ServoOutcome:
    """The diagnosis, the searches by joint that `corrected.xml` is written from, and the masses that all joints carry.

    contacts: what is said of samples with contact.
    """

    diagnosis: RobotDiagnosis
    searches: tuple[JointSearch, ...]
    masses: Masses
    contacts: tuple[str, ...] = ()


def diagnose_servos(
    robot: Robot,
    recordings: Sequence[RobotRecording],
    held_out: Sequence[RobotRecording] = (),
    options: RobotOptions | None = None,
    say: Callable[[str], None] = lambda line: None,
    jobs: int = 2,
) -> ServoOutcome:
    """Diagnose every servo joint that moves, or those named, by its free run under the recorded command.

    Raises InputError for a model or recordings that are outside.
    """
    options, begun = options or RobotOptions(), time.perf_counter()
    check_rows(robot)
    everything = [*recordings, *held_out]
    names = _chosen(robot, everything, options)

    contacts: list[tuple[str, Touching, float]] = []

    def series(lates: Mapping[str, float]) -> list[JointProblem]:
        motions = [prepare(robot, r, k >= len(recordings), lates) for k, r in enumerate(everything)]
        contacts[:] = [(m.recording.source, m.touching, m.recording.dt) for m in motions]
        problems = [joint_problem(robot, motions, n, not held_out) for n in names]
        touched = np.any([t.rows.any(axis=0) for _, t, _ in contacts], axis=0)
        return [p for p in problems if _enough(p, len(names), touched=bool(touched[p.joint]))]

    problems = series({})
    if not problems:
        touch = any(t.rows.any() for _, t, _ in contacts)
        raise InputError(
            recordings[0].source, f"no joint has enough samples in motion{' and out of contact' if touch else ''}",
            f"{FEWEST} fitted and held out each", EXCLUDE if touch else "record longer",
        )  # fmt: skip
    say(f"{len(problems)} joints by command and position, {sum(len(r) for r in everything)} samples")
    searches = _searched(problems, options, jobs, say)
    searches = _by_clock(searches, series, options, jobs, say)

    def again(problems: Sequence[JointProblem], before: Sequence[JointSearch]) -> tuple[JointSearch, ...]:
        return _searched_again(problems, before, options, jobs, say)

    searches, masses = agree(robot, body_numbers(robot), searches, options, again, say)
    return _answered(robot, searches, masses, contact_notes(robot, contacts), recordings, held_out, begun)


def search_beside(
    robot: Robot,
    outcome: ServoOutcome,
    shifts: Mapping[str, np.ndarray],
    recordings: Sequence[RobotRecording],
    held_out: Sequence[RobotRecording],
    options: RobotOptions,
    say: Callable[[str], None] = lambda line: None,
    jobs: int = 2,
) -> ServoOutcome:
    """The outcome of all joints searched again under the same masses, beside the user's simulator.

    shifts: by joint what the simulator's run of the whole robot is beyond the joint's own run (N,) [rad | m].
    """
    begun = time.perf_counter()
    problems = [dataclasses.replace(s.problem, shift=shifts[s.problem.name]) for s in outcome.searches]
    searches = _searched_again(problems, outcome.searches, options, jobs, say)
    return _answered(robot, searches, outcome.masses, outcome.contacts, recordings, held_out, begun)


def _answered(
    robot: Robot, searches: Sequence[JointSearch], masses: Masses, contacts: tuple[str, ...],
    recordings: Sequence[RobotRecording], held_out: Sequence[RobotRecording], begun: float,
) -> ServoOutcome:  # fmt: skip
    scales = {s.problem.name: scale_of(s) for s in searches}
    borrowed = _borrow(searches, scales)
    diagnosis = _told(robot, searches, scales, borrowed, masses, recordings, held_out, begun)
    diagnosis = dataclasses.replace(diagnosis, notes=(*contacts, *diagnosis.notes))
    return ServoOutcome(diagnosis, tuple(searches), masses, contacts)


def _searched(
    problems: Sequence[JointProblem],
    options: RobotOptions,
    jobs: int,
    say: Callable[[str], None],
    without: Mapping[str, str] = MappingProxyType({}),
) -> tuple[JointSearch, ...]:
    """The searches at all joints; ``without``: by joint, the key of a law that is not tried."""

    def one(p: JointProblem, numbers: tuple[Number, ...], start: Fit) -> JointSearch:
        s = search_joint(p, options, len(problems), numbers, start, without.get(p.name, ""))
        say(f"{p.name}: {', '.join(x.key for x in s.now.laws) or 'no effect'}")
        return s

    with ThreadPoolExecutor(jobs) as pool:
        numbers, starts = _starts(problems, lambda f, *xs: list(pool.map(f, *xs)))
        chosen = list(pool.map(with_fitting_friction, problems, numbers, starts))
        return tuple(pool.map(one, [p for p, _ in chosen], numbers, [start for _, start in chosen]))


def _by_clock(
    searches: tuple[JointSearch, ...], series: Callable[[Mapping[str, float]], list[JointProblem]], options: RobotOptions,
    jobs: int, say: Callable[[str], None],
) -> tuple[JointSearch, ...]:  # fmt: skip
    """The searches with each delay assigned to the servo or to the log (`diagnose.robot.servos.clocks`).

    Where columns are late, all joints are searched again with what they carry computed from positions moved earlier.
    """
    found, lates = clocks(searches, series)
    if not found:
        return searches
    for c in found:
        say(f"{c.joint}: {c.sentence}")
    own = {c.joint: c for c in found}
    without = {s.problem.name: x.key for s in searches for x in s.laws if x.is_delay and s.problem.name in own
               and x.is_logged != own[s.problem.name].log}  # fmt: skip
    again = lates or any(law.is_logged and not own[s.problem.name].log for s in searches for law in s.now.laws)
    if again and not options.late:
        searches = _searched(series(lates), options, jobs, say, without)
    for s in searches:
        if s.problem.name in own:
            s.note_clock(own[s.problem.name].sentence, own[s.problem.name].distinguishable)
    return searches


def _searched_again(
    problems: Sequence[JointProblem], before: Sequence[JointSearch], options: RobotOptions, jobs: int, say: Callable[[str], None]
) -> tuple[JointSearch, ...]:  # fmt: skip
    """The searches of other problems of the same joints, with the delays assigned to servo or log as before."""
    clocked = {s.problem.name: s for s in before if s.clock}
    without = {
        name: law.key for name, s in clocked.items() for law in s.laws
        if law.is_delay and law.key not in {x.key for x in s.now.laws} and any(x.is_delay for x in s.now.laws)
    }  # fmt: skip
    searches = _searched(problems, options, jobs, say, without)
    for s in searches:
        was = clocked.get(s.problem.name)
        if was is not None:
            s.note_clock(was.clock, not any(x.is_delay and x.id in was.alike.get(x.key, ()) for x in was.now.laws))
    return searches


def _chosen(robot: Robot, recordings: Sequence[RobotRecording], options: RobotOptions) -> tuple[str, ...]:
    found = moving(robot, recordings)
    for name in options.joints:
        if name not in robot.joints:
            raise InputError(
                "--joint", f"joint {name!r} is not in the model", f"one of {', '.join(robot.joints)}",
                nearest(name, robot.joints, "correct the name"),
            )  # fmt: skip
        if name not in found:
            raise InputError(
                recordings[0].source, f"joint {name!r} does not move, or has no servo, command or position",
                "a servo joint that moves",
                "name another joint",
            )  # fmt: skip
    return tuple(n for n in robot.joints if n in (options.joints or found))


def _enough(p: JointProblem, count: int, *, touched: bool) -> bool:
    """Whether a joint moves in fitted and held-out samples; raises InputError where it is the only one."""
    enough = min(int(p.fitted.sum()), int(p.held.sum())) >= FEWEST
    if not enough and count == 1:
        raise InputError(
            p.sources[0][0],
            f"{int(p.fitted.sum())} fitted and {int(p.held.sum())} held-out samples of {p.name!r} in recordings in which it "
            f"moves{' and nothing touches' if touched else ''}", f"at least {FEWEST} each",
            EXCLUDE if touched else "give recordings in which it moves on both sides",
        )  # fmt: skip
    return enough


def _starts(problems: Sequence[JointProblem], each: Callable[..., list[Fit]]) -> tuple[list[tuple[Number, ...]], list[Fit]]:
    """The own numbers of each joint and its fit without effects; ``each``: maps a function over joints.

    A joint whose data do not tell the scale of torques gets the gain of like servos beforehand: the force limit of the file
    and the inertia of the links act by that scale, and its effects are searched where they act as they do.
    """
    numbers = [own_numbers(p) for p in problems]
    starts = each(start_fit, problems, numbers)
    scales = {p.name: scale_of_fit(p, f) for p, f in zip(problems, starts, strict=True)}
    again = []
    for k, p in enumerate(problems):
        kin = _kin(p, problems, scales)
        if kin and not scales[p.name].identifiable:
            numbers[k] = _with_gain(p, numbers[k], _mean_gain(kin, scales))
            again.append(k)
    for k, f in zip(again, each(start_fit, [problems[k] for k in again], [numbers[k] for k in again]), strict=True):
        starts[k] = f
    return numbers, starts


def _kin(p: JointProblem, problems: Sequence[JointProblem], scales: Mapping[str, Scale]) -> list[str]:
    """Joints whose torque scale is identifiable and whose servo is that of a joint in the file."""
    return [x.name for x in problems if scales[x.name].identifiable and _same_servo(x, p)]


def _mean_gain(kin: Sequence[str], scales: Mapping[str, Scale]) -> float:
    """Mean coded gain of joints."""
    return float(np.mean([scales[name].gain for name in kin]))


def _with_gain(p: JointProblem, numbers: Sequence[Number], mean: float) -> tuple[Number, ...]:
    """Numbers with the prior of the servo's gain at that of like servos."""
    main = "kv" if p.drive.velocity else "kp"
    return tuple(dataclasses.replace(n, prior=(mean, SPREAD)) if n.slot == main else n for n in numbers)


def _borrow(searches: Sequence[JointSearch], scales: dict[str, Scale]) -> dict[str, str]:
    """Fit joints of unidentifiable torque scale with the gain of joints of the same servo in the file; say so, by joint."""
    out = {}
    for s in searches:
        p, scale = s.problem, scales[s.problem.name]
        if scale.identifiable:
            out[p.name] = "The load of the links, by the masses of the file, sets the scale of torques."
            continue
        main = "kv" if p.drive.velocity else "kp"
        kin = _kin(p, [x.problem for x in searches], scales)
        ratios = "Command and position tell only ratios here (friction / kp, damping / kp, kp / inertia)"
        if not kin:
            out[p.name] = (
                f"{ratios}: the scale follows the armature of the file, to a factor of three. A known load at this joint tells."
            )
            continue
        mean = _mean_gain(kin, scales)
        refit_with(s, _with_gain(p, s.numbers, mean))
        out[p.name] = (
            f"{ratios}: {main} is taken to be that of {', '.join(kin)} ({math.exp(mean):.3g}), whose servos are the same in the "
            "file."
        )
    return out


def _same_servo(a: JointProblem, b: JointProblem) -> bool:
    """Whether the file gives two joints the same servo."""
    keys = [SLOT[x] for x in ("kp", "kv", "limit", "armature", "damping")]
    return a.slide == b.slide and bool(np.array_equal(a.nominal[keys], b.nominal[keys]))


def _told(
    robot: Robot, searches: Sequence[JointSearch], scales: dict[str, Scale], borrowed: dict[str, str], masses: Masses,
    recordings: Sequence[RobotRecording], held_out: Sequence[RobotRecording], begun: float,
) -> RobotDiagnosis:  # fmt: skip
    joints = {s.problem.name: answer(s, scales[s.problem.name], borrowed[s.problem.name]) for s in searches}
    worst = max((r.verdict for r in joints.values()), key=ORDER.index)
    lines = tuple(x for s in searches for x in changed(s, joints[s.problem.name], scales[s.problem.name]))
    lines = (*masses.lines, *lines)
    notes = list(dict.fromkeys(note for r in recordings for note in r.notes))
    idle = {s.problem.name: " and ".join(s.problem.drive.idle) for s in searches}
    notes += [IDLE.format(name=name, inputs=inputs) for name, inputs in idle.items() if inputs]
    notes += [f"Joint {name} is not in the log: it is held at {at:.4g}." for name, at in recordings[0].held_at]
    still = [n for n in recordings[0].joints if n not in joints]
    if still:
        notes.append(f"Not diagnosed, since they do not move enough, have no servo or are not named: {', '.join(still)}.")
    notes += unused_of_robot(recordings)
    notes += [f"{name}: {text}" for name, text in borrowed.items()]
    notes += shifted(joints)
    notes += [x for s in searches if (x := unfollowed_note(s.problem, s.now.fit.error))]
    notes.append("Backlash between motor and joint is not looked for: an encoder at the joint does not show it.")
    return RobotDiagnosis(
        worst, summary(worst, joints, lines), joints, overall(joints), masses.estimates, masses.nominal, (), lines, tuple(notes),
        sum(len(s.laws) for s in searches), math.nan,
        listed(recordings, held_out),
        searches[0].options.seed, time.perf_counter() - begun,
        {"simgap": version("simgap"), "mujoco": mujoco.__version__, "numpy": np.__version__, "python": platform.python_version()},
        {"channel": "angle", "unit": "rad", "view": "motion"},
    )  # fmt: skip
