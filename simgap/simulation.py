"""Simulate a model of an axis, with the effects that it carries, on the input of a recording."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from mjsim.errors import InputError
from mjsim.hold import within
from mjsim.known_torque import KnownTorque
from mjsim.mjcf import Model
from mjsim.recording import Recording

if TYPE_CHECKING:
    from diagnose.verdict.reference import Case, Run
    from mjsim.axis import Axis
    from mjsim.ode import Trajectory
    from mjsim.plant import Start

__all__ = ["ENGINES", "STARTS", "at_first_sample", "fitted_start", "run_servo", "run_torque"]

ENGINES = ("ode", "mujoco", "literal")
"""ode: the analytic equations; mujoco: MuJoCo with steps that end at events; literal: plain MuJoCo on the file as it is."""
STARTS = ("auto", "rest", "recorded")
BEGINNING = 0.5  # seconds over which `auto` compares
SLOPE = 0.005  # seconds over which the first velocity is read off


def run_torque(source: Model, torque: np.ndarray, record: Recording, engine: str, initial: np.ndarray | None) -> Trajectory:
    """One run on a commanded torque (N,), the recording's or its beginning, and its known torque. Raises DivergedError.

    A torque that is not held between samples is cut for MuJoCo into parts of a timestep, at its mean over each.
    """
    axis = _with_known(source.axis, record)
    if engine == "ode":
        from mjsim import ode

        angle = None if record.angle is None else record.angle[: len(torque)]
        origin = None if initial is None else 0.0  # it has the angle of the recording
        return ode.simulate(axis, torque, record.dt, initial=initial, angle=angle, origin=origin, hold=record.hold)
    if record.hold == "held":
        return _stepped(source, axis, torque, record.dt, record.known_torque, engine, initial)
    from mjsim.servo_run import finer, sampled

    each = max(1, math.ceil(record.dt / float(source.mjmodel.opt.timestep) - 1e-6))
    known = None if record.known_torque is None else finer(record.known_torque, each)
    fine = within(np.asarray(torque, float), record.dt, record.hold, each)
    run = sampled(_stepped(source, axis, fine, record.dt / each, known, engine, initial), each)
    return dataclasses.replace(run, torque=np.array(torque, float))


def _stepped(
    source: Model, axis: Axis, torque: np.ndarray, dt: float, known: np.ndarray | None, engine: str, initial: np.ndarray | None
) -> Trajectory:
    """A run of MuJoCo on a torque (N,) held over each sample of dt [s]: of the file, or of the axis with steps to each event."""
    if engine == "literal":
        from mjsim.mujoco_run import run_signals

        bodies = len(source.found.chain.bodies)  # one that an effect splits off starts undeflected
        initial = None if initial is None else initial[:, :bodies]
        return run_signals(source, torque, dt, initial=initial, known=None if known is None else known[: len(torque)])
    from mjsim import accurate

    return accurate.simulate(axis, torque, dt, initial=initial)


def _with_known(axis: Axis, record: Recording) -> Axis:
    """The axis with the torque on it that a recording knows sample by sample."""
    return axis if record.known_torque is None else axis + KnownTorque.of(record.known_torque, record.dt)


def run_servo(source: Model, record: Recording, engine: str, *, rest: bool = False, start: Start | None = None) -> Trajectory:
    """One run under the model's own servo on the recorded command, from a start, else at rest at the angle measured first.

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

        return literal_servo_run(source, driven, start)
    experiment = prepare(driven, minimum=2)
    if start is None:
        return free_run(axis, experiment)
    chain = axis.chain
    initial = start.of_bodies([c.ratio for c in chain.couplings])
    initial[0] -= [experiment.angle * chain.total_ratio(i) for i in range(len(chain.bodies))]
    return free_run(axis.started(start.states), experiment, initial)


def fitted_start(source: Model, record: Recording) -> Start | None:
    """The start that suits a recording best: angle by its noise, speed, deflections of the chain, states of effects.

    By the signal that is compared: the velocity, or the angle where it was not recorded, and that of a servo. None for a
    recording that is too short or does not move, and for one from rest where no effect of the model has a state at the start.
    """
    from diagnose.data.servo import as_servo
    from diagnose.verdict.reference import cases_of
    from diagnose.verdict.reference_start import suited

    if record.velocity is None and record.angle is None:
        return None
    try:
        if source.axis.chain.servo is not None:
            _, (record,), _, _ = as_servo(source.axis, [record], [])
        (case,) = cases_of([record], [])
    except InputError:
        return None
    if not case.moving and not source.axis.start_states:
        return None
    noise = case.spread()[0]

    def of_angle(case: Case, run: Run) -> np.ndarray:
        return np.asarray((record.column("angle") - run.angle) / noise)

    start, shift = suited(
        _with_known(source.axis, record),
        case,
        errors=of_angle if record.velocity is None and noise > 0 and not case.servo else None,
        locked=True,
    )
    return None if shift is None else start


def at_first_sample(source: Model, record: Recording, start: str | Start) -> np.ndarray:
    """Angles and velocities (2, n) of the chain at the first sample: of a given start, else undeflected.

    ``auto``: at rest or moving as recorded, whichever follows the recording better over its first half second.
    """
    if not isinstance(start, str):
        from mjsim.system import assemble

        return start.of_bodies(assemble(source.axis).f[2, :-1].tolist())
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
