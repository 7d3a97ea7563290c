"""From files to a folder with the diagnosis of a robot: diagnosis.json, corrected.xml, report.html."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from diagnose.check.types import LogCheck, Severity
from diagnose.fit.command_hold import is_assumed, taken_hold, with_hold
from diagnose.result import FitFigures
from diagnose.robot.check.faults import WRONG
from diagnose.robot.check.run import check_robot
from diagnose.robot.laws import FLEXIBLE
from diagnose.robot.options import RobotOptions
from diagnose.robot.pipeline import Outcome, diagnose_robot
from diagnose.robot.problem import Problem
from diagnose.robot.result import JointResult, RobotDiagnosis
from mjsim.errors import InputError
from mjsim.mjcf.assets import bring_assets, placed
from mjsim.mjcf.compile import compile_file
from mjsim.mjcf.whole import WRITTEN, is_whole, write_whole
from mjsim.recording import Recording
from mjsim.robot.binding import find_robot_binding
from mjsim.robot.drives import has_servos
from mjsim.robot.inertia import SIZE
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.recording import RobotRecording, joints_in_table, joints_named, load_robot_recording
from mjsim.robot.rows import mujoco_torque
from mjsim.robot.write import check_writable, write_robot
from mjsim.threads import one_thread

if TYPE_CHECKING:
    from diagnose.robot.servos.pipeline import ServoOutcome

__all__ = ["diagnose_robot_files", "diagnose_robot_recordings", "driven_joints", "is_robot", "is_robot_model"]


def driven_joints(compiled: mujoco.MjModel) -> set[int]:
    """Joints that an actuator of the model drives, by their index."""
    joint = int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    inputs = np.flatnonzero(compiled.actuator_ctrlnum)
    return {int(compiled.actuator_trnid[a, 0]) for a in inputs if int(compiled.actuator_trntype[a]) in joint}


def is_robot_model(model: Path) -> bool:
    """Whether a model has several driven joints."""
    return len(driven_joints(compile_file(model))) > 1


def is_robot(recordings: Sequence[object], model: Path) -> bool:
    """Whether it is a robot: the model has several driven joints, or none that is driven and the log names several.

    ``recordings``: paths, tables of columns by name, or recordings that are loaded.
    """
    if any(isinstance(r, RobotRecording) for r in recordings):
        return True
    compiled = compile_file(model)
    if compiled.nu:
        return len(driven_joints(compiled)) > 1
    first = recordings[0]
    if isinstance(first, Recording):
        return False
    if not isinstance(first, Path):
        return isinstance(first, Iterable) and len(joints_in_table(map(str, first))) > 1
    binding = find_robot_binding(first, model)
    bound = binding.joints if binding is not None else {}
    return len(bound or joints_named(first)) > 1


LATE = (
    "The budget of time (--budget) was used up when the search ended: effects may be left untried at some joints. A larger "
    "budget looks further."
)


def checked(robot: Robot, recordings: Sequence[RobotRecording], accept_log: bool = False) -> LogCheck:
    """What is wrong with the log.

    Raises InputError for a channel in another unit or direction, or behind a gear, unless ``accept_log``.
    """
    log = check_robot(robot, recordings)
    wrong = [p for p in log.problems if p.severity is Severity.FIX and p.problem in WRONG]
    if wrong and not accept_log:
        first, more = wrong[0], f" So it is with {len(wrong) - 1} more." if len(wrong) > 1 else ""
        raise InputError(
            f"{first.recording}: {first.channel}", f"{first.sentence.rstrip('.')}.{more}", "channels as the model has them",
            f"{first.advice}; simgap check tells all; --accept-log goes on without",
        )  # fmt: skip
    return log


def _told(log: LogCheck) -> tuple[str, ...]:
    """What of the log has to be fixed, for the notes."""
    return tuple(f"The log, to be fixed: {p.sentence} {p.advice}." for p in log.problems if p.severity is Severity.FIX)


def _with_log(result: RobotDiagnosis, log: LogCheck, said: tuple[str, ...]) -> RobotDiagnosis:
    """The diagnosis with what is wrong with the log and what is ``said`` of it; the summary names a joint that moved unseen."""
    moved = [p.channel.rpartition(".")[0] for p in log.problems if p.problem == "not_logged" and p.severity is Severity.FIX]
    held = tuple(f"Joint {name} is not in the log" for name in moved)
    notes = (*_told(log), *said, *(n for n in result.notes if not (held and n.startswith(held))))
    cause = f"{', '.join(moved)} is not in the log and moved, the likely cause of what is found beside it. " if moved else ""
    return dataclasses.replace(result, log=log, notes=notes, summary=cause + result.summary)


def by_servo(robot: Robot, recordings: Sequence[RobotRecording]) -> bool:
    """Whether the log is diagnosed by commands and positions: servos in the model, and no torque of any joint in the log."""
    return has_servos(robot) and not any(r.has("torque", n) for r in recordings for n in r.joints)


def diagnose_robot_files(
    recordings: Sequence[Path],
    model: Path,
    out: Path,
    held_out: Sequence[Path] = (),
    options: RobotOptions | None = None,
    say: Callable[[str], None] = lambda line: None,
    *,
    page: bool = True,
) -> RobotDiagnosis:
    """Diagnose a robot from files and write the folder ``out``; ``page``: whether report.html is written too.

    Raises InputError for what is outside.
    """
    robot = load_robot(model)
    loaded, held = ([load_robot_recording(p, robot, model=model) for p in group] for group in (recordings, held_out))
    return diagnose_robot_recordings(loaded, model, out, held, options, say, page=page)


@one_thread
def diagnose_robot_recordings(
    recordings: Sequence[RobotRecording],
    model: Path,
    out: Path,
    held_out: Sequence[RobotRecording] = (),
    options: RobotOptions | None = None,
    say: Callable[[str], None] = lambda line: None,
    *,
    page: bool = True,
    accept_log: bool = False,
) -> RobotDiagnosis:
    """As `diagnose_robot_files`, of recordings that are loaded; ``page``: whether report.html is written too.

    The log is checked first; ``accept_log``: search even where a channel is in another unit or direction.
    """
    began, options = time.monotonic(), options or RobotOptions()
    if not is_whole(model):
        model = write_whole(model, out / WRITTEN)
        bring_assets(model)
    robot = load_robot(model)
    there = next(p for p in (out, *out.resolve().parents) if p.exists())
    if not there.is_dir():
        raise InputError(out, f"{there.name!r} is a file", "a folder", "choose another --out")
    servos = by_servo(robot, [*recordings, *held_out])
    check_writable(model, robot, links=not servos)
    log = checked(robot, [*recordings, *held_out], accept_log)
    corrected = out / "corrected.xml"
    if servos:
        from diagnose.robot.servos.hold import shown_hold
        from diagnose.robot.servos.pipeline import diagnose_servos

        assumed = is_assumed([*recordings, *held_out])
        hold = shown_hold(robot, recordings) if assumed else "held"
        found = None
        if assumed and hold == "held":
            found = diagnose_servos(robot, recordings, held_out, options, say)
            hold = "held" if options.late else shown_hold(robot, recordings, found.searches)
        if hold != "held":
            recordings, held_out = with_hold(recordings, hold), with_hold(held_out, hold)
            taken = dataclasses.replace(taken_hold(hold, 1.0 / recordings[0].dt), recording=recordings[0].source)
            log = dataclasses.replace(log, problems=(*log.problems, taken))
            say(f"commands: {taken.sentence}")
        if found is None or hold != "held":
            found = diagnose_servos(robot, recordings, held_out, options, say)
        late = options.late
        out.mkdir(parents=True, exist_ok=True)
        with placed(corrected) as part:
            result = _servos_by_mujoco(found, model, robot, part, (recordings, held_out), options, say)
    else:
        outcome = diagnose_robot(robot, recordings, held_out, options, say)
        late = options.late
        out.mkdir(parents=True, exist_ok=True)
        from simgap.robot_tracking import with_tracking

        with placed(corrected) as part:
            _write_corrected(model, robot, outcome, part)
            say("all joints together in MuJoCo")
            result = with_tracking(_by_mujoco(outcome, robot, part), robot, part, recordings, held_out)
    result = _with_log(result, log, (LATE,) if late else ())
    result = dataclasses.replace(result, seconds=time.monotonic() - began)
    if page:
        from diagnose.robot.page import write_page
        from diagnose.robot.picture import picture

        result = dataclasses.replace(result, picture=picture(result, robot, model, recordings[0].positions(robot)))

        write_page(result, out / "report.html")
    result.write_json(out / "diagnosis.json")
    return result


def _servos_by_mujoco(
    found: ServoOutcome, model: Path, robot: Robot, corrected: Path,
    recordings: tuple[Sequence[RobotRecording], Sequence[RobotRecording]], options: RobotOptions, say: Callable[[str], None],
) -> RobotDiagnosis:  # fmt: skip
    """Write the corrected file with numbers that suit MuJoCo's timestep, and judge it; recordings: fitted, held out."""
    from simgap.robot_beside import beside_simulator
    from simgap.robot_polish import polish_servos
    from simgap.robot_servos import coarse_joints, given_runs, judge_servos, with_file_at_noise
    from simgap.robot_written import write_corrected_servos

    say("all joints together in MuJoCo")
    every = (*recordings[0], *recordings[1])
    given = given_runs(robot, every)
    found = beside_simulator(with_file_at_noise(found, robot, given, every), model, robot, recordings, options, say)
    found = with_file_at_noise(found, robot, given, every)
    polish = polish_servos(model, robot, found, recordings[0], coarse_joints(found, robot, given, every))
    write_corrected_servos(model, robot, found, corrected, polish.slots)
    with tempfile.TemporaryDirectory() as work:
        by_motion = Path(work) / "by_motion.xml"
        write_corrected_servos(model, robot, found, by_motion)
        result = judge_servos(found, robot, corrected, *recordings, by_motion, given)
    return dataclasses.replace(result, notes=(*result.notes, *polish.notes))


def _write_corrected(model: Path, robot: Robot, outcome: Outcome, path: Path) -> None:
    """The corrected MJCF: links, armature, damping, dry friction and springs in their elements, the rest carried."""
    search = outcome.search
    p, theta = search.problem, search.solution.theta
    size = len(robot.links) * SIZE
    joints: dict[str, dict[str, float]] = {}
    for name, value in zip(p.names[size:], theta[size:], strict=True):
        joint, _, kind = name.rpartition(".")
        joints.setdefault(joint, {})[kind] = float(value)
    carried: list[Mapping[str, Any]] = []
    for term, c in zip(search.solution.terms, search.solution.coefficients, strict=True):
        joint = robot.joints[term.joint]
        native = term.law.native(c) if term.law.native is not None else {}
        if native and not any(k in joints[joint] for k in native if k != "frictionloss"):
            joints[joint] |= native
        else:
            values = {k: v[0] for k, v in term.law.values(c, term.shape).items()}
            effect = {"effect": term.law.id, "form": term.law.form, "joint": joint, "parameters": values}
            carried.append(effect | ({"from": term.law.source} if term.law.source else {}))
    carried += [
        {"effect": FLEXIBLE, "form": "", "joint": joint, "parameters": {"stiffness_Nm_rad": k}}
        for joint, k in outcome.stiffness.items()
    ]
    for values_of in joints.values():  # a law has taken the place of the file's own dry friction
        if abs(values_of.get("frictionloss", 0.0)) < 1e-12 and "frictionloss" in values_of:
            values_of["frictionloss"] = 0.0
    links = theta[:size].reshape(-1, SIZE) - robot.fixed
    unchanged = np.allclose(theta[:size].reshape(-1, SIZE), robot.nominal, rtol=1e-12)
    write_robot(model, robot, path, robot.nominal - robot.fixed if unchanged else links, joints, carried)


def _by_mujoco(outcome: Outcome, robot: Robot, corrected: Path) -> RobotDiagnosis:
    """The diagnosis with the errors of the two files as plain MuJoCo finds them; those of the regression stand as "surrogate"."""
    p = outcome.search.problem
    errors = {key: _file_figures(p, r) for key, r in (("nominal", robot), ("corrected", load_robot(corrected)))}
    joints: dict[str, JointResult] = {}
    for j in p.joints:
        name = robot.joints[j]
        was = outcome.diagnosis.joints[name]
        fit = {"nominal": errors["nominal"][j], "refitted": was.fit["refitted"], "corrected": errors["corrected"][j],
               "surrogate": was.fit["corrected"]}  # fmt: skip
        joints[name] = dataclasses.replace(was, fit=fit)
    overall = {}
    for key in ("nominal", "refitted", "corrected", "surrogate"):
        own = [r.fit[key] for r in joints.values()]
        a, b = (math.sqrt(sum(getattr(f, k) ** 2 for f in own) / len(own)) for k in ("nrmse", "held_out_nrmse"))
        overall[key] = FitFigures(a, a, b, b)
    return dataclasses.replace(outcome.diagnosis, joints=joints, fit=overall)


def _file_figures(p: Problem, robot: Robot) -> dict[int, FitFigures]:
    """Errors of a file's torque by mj_inverse along the filtered motion, by joint."""
    fitted: dict[int, list[np.ndarray]] = {j: [] for j in p.joints}
    held: dict[int, list[np.ndarray]] = {j: [] for j in p.joints}
    for motion, Y in zip(p.motions, p.links, strict=True):
        torque = mujoco_torque(robot, motion.z, motion.dz, motion.ddz)
        if motion.payload is not None:
            torque = torque + Y[:, :, motion.payload[0]] @ motion.payload[1]
        error = motion.thinned(motion.torque - motion.low_passed(torque))
        for j in p.joints:
            fitted[j].append(error[motion.counts[:, j] & ~motion.held, j])
            held[j].append(error[motion.counts[:, j] & motion.held, j])
    out = {}
    for j in p.joints:
        a, b = (float(np.sqrt(np.mean(np.concatenate(x[j]) ** 2))) for x in (fitted, held))
        spread = [float(np.std(x[j].measured)) + 1e-300 for x in (p.fitted, p.held)]
        out[j] = FitFigures(a, a / spread[0], b, b / spread[1])
    return out
