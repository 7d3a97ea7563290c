"""`check`: what is wrong with recordings, and what they can show, before any physics is sought."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco

from diagnose.check import Machine, check_log
from diagnose.check.types import LogCheck
from mjsim.mjcf import load_model
from mjsim.recording import Recording
from simgap.api.model import Model
from simgap.api.recording import loaded
from simgap.robot import is_robot
from simgap.sole import sole_in_python

if TYPE_CHECKING:
    from mjsim.robot.recording import RobotRecording

__all__ = ["check", "listed"]


def listed(source: Any) -> list[Any]:
    """Recordings as a list: one alone, or several in a list or tuple."""
    return list(source) if isinstance(source, list | tuple) else [source]


def check(
    recordings: Any | Sequence[Any], model: Model | str | Path | mujoco.MjSpec, *, out: str | Path | None = None
) -> LogCheck:
    """Check recordings of one axis, or of all joints of a robot, against its model.

    ``recordings``: one, or several in a list; each a file, columns by name, a DataFrame or a `Recording`. ``out``: a folder for
    check.json and check.html. Returns the verdict (``ready``, ``limits`` or ``fix``), the problems with what to do about each,
    and, where a torque drives the axis, which families of effects the excitation can show. The position of a servo is compared
    with its command. Raises `InputError` for a log without the input that the model's actuator takes.

    >>> import numpy as np
    >>> import simgap
    >>> t = np.arange(0, 3, 0.004)
    >>> torque = 3 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    >>> run = simgap.simulate("pendulum", torque, dt=0.004)
    >>> velocity = run.velocity + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    >>> log = {"time_s": t, "torque_Nm": torque, "velocity_rad_s": velocity}
    >>> simgap.check(log, "pendulum").verdict.value
    'ready'
    >>> wrong = log | {"velocity_rad_s": -velocity}
    >>> [(p.channel, p.problem) for p in simgap.check(wrong, "pendulum").to_fix()]
    [('torque', 'sign')]
    """
    subject = Model(model)
    given = [Path(x) if isinstance(x, str) else x for x in listed(recordings)]
    if is_robot(given, subject.path):
        return _check_robot(given, subject, out)
    source = load_model(subject.path)
    group = [r for r in (loaded(x, subject, uniform=False) for x in listed(recordings)) if isinstance(r, Recording)]
    if source.axis.chain.servo is not None:
        from diagnose.robot.check.axis import check_servo_axis

        result = check_servo_axis(source.axis.chain, subject.robot, group)
    else:
        result = check_log(Machine.of(source), group)
    if out is not None:
        _write(result, group, subject, Path(out))
    return result


def _check_robot(given: Sequence[Any], subject: Model, out: str | Path | None) -> LogCheck:
    """The check of a robot: its channels joint by joint; a file that a diagnosis would refuse is read all the same."""
    from diagnose.robot.check.run import check_robot
    from mjsim.robot.recording import RobotRecording, load_robot_recording

    robot = subject.robot
    group = [
        load_robot_recording(x, robot, model=subject.path, checked=False)
        if isinstance(x, Path)
        else loaded(x, subject, robot=True)
        for x in given
    ]
    logs = [r for r in group if isinstance(r, RobotRecording)]
    result = check_robot(robot, logs)
    if out is not None:
        _write(result, logs, subject, Path(out))
    return result


def _write(result: LogCheck, logs: Sequence[Recording | RobotRecording], subject: Model, out: Path) -> None:
    """check.json and check.html. Raises InputError where another run writes to the folder."""
    from diagnose.check.page import write_check

    with sole_in_python(out):
        write_check(result, logs, subject.path.name, out)
