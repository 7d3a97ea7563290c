"""Simulate a model of an axis, with the effects that it carries, on the input of a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjsim.errors import InputError
from mjsim.mjcf import Model
from mjsim.recording import Recording

if TYPE_CHECKING:
    from mjsim.ode import Trajectory

__all__ = ["ENGINES", "STARTS", "at_first_sample", "run_servo", "run_torque"]

ENGINES = ("ode", "mujoco", "literal")
"""ode: the analytic equations; mujoco: MuJoCo with steps that end at events; literal: plain MuJoCo on the file as it is."""
STARTS = ("auto", "rest", "recorded")
BEGINNING = 0.5  # seconds over which `auto` compares
SLOPE = 0.005  # seconds over which the first velocity is read off


def run_torque(source: Model, torque: np.ndarray, record: Recording, engine: str, initial: np.ndarray | None) -> Trajectory:
    """One run on a commanded torque (N,), the recording's or its beginning. Raises DivergedError."""
    if engine == "literal":
        from mjsim.mujoco_run import run_signals

        return run_signals(source, torque, record.dt, initial=initial)
    if engine == "mujoco":
        from mjsim import accurate

        return accurate.simulate(source.axis, torque, record.dt, initial=initial)
    from mjsim import ode

    angle = None if record.angle is None else record.angle[: len(torque)]
    return ode.simulate(source.axis, torque, record.dt, initial=initial, angle=angle)


def run_servo(source: Model, record: Recording, engine: str, *, rest: bool = False) -> Trajectory:
    """One run under the model's own servo on the recorded command, from the angle that was measured first.

    ``rest``: from rest at angle 0, of a command that no motion was recorded with.
    """
    if rest and engine == "ode":
        from mjsim import ode

        still = np.zeros((2, len(source.axis.chain.bodies)))
        return ode.simulate(source.axis, record.input, record.dt, initial=still, hold=record.hold)
    from diagnose.data.experiment import prepare
    from diagnose.data.runs import free_run
    from diagnose.data.servo import as_servo

    if engine == "mujoco":
        raise InputError("--engine", "'mujoco', and the model is a servo", "'ode'", "leave the option out")
    axis, (driven,), _, _ = as_servo(source.axis, [record], [])
    if engine == "literal":
        from mjsim.servo_run import literal_servo_run

        return literal_servo_run(source, driven)
    return free_run(axis, prepare(driven, minimum=2))


def at_first_sample(source: Model, record: Recording, start: str) -> np.ndarray:
    """Angles and velocities (2, n) of the undeflected chain at the first sample.

    ``auto``: at rest or moving as recorded, whichever follows the recording better over its first half second.
    """
    chain = source.axis.chain
    ratios = np.array([chain.total_ratio(i) for i in range(len(chain.bodies))])
    angle = float(record.angle[0]) if record.angle is not None else 0.0
    rest = np.array([angle * ratios, 0.0 * ratios])
    if start == "rest":
        return rest
    speed = record.velocity if record.velocity is not None else np.gradient(record.column("angle"), record.dt)
    few = max(2, min(len(speed), round(SLOPE / record.dt)))
    first = float(np.polynomial.Polynomial.fit(np.arange(few), speed[:few], 1)(0.0))
    moving = np.array([angle * ratios, first * ratios])
    if start == "recorded":
        return moving
    count = max(2, min(len(speed), round(BEGINNING / record.dt)))
    error = []
    for initial in (rest, moving):
        run = run_torque(source, record.torque[:count], record, "ode", initial)
        error.append(float(np.linalg.norm(run.velocity - speed[:count])))
    return rest if error[0] <= error[1] else moving
