"""`simulate`: the motion of a model on an input, with the effects that it has or that are added."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from diagnose.data.gap_input import as_moved
from mjsim.effects import Effect, NotApplicableError
from mjsim.errors import InputError, nearest
from mjsim.mjcf import load_model
from mjsim.ode import DivergedError, Trajectory
from mjsim.plant import Start
from mjsim.quantity import Motion
from mjsim.recording import Recording
from simgap.api.model import Model
from simgap.api.recording import loaded
from simgap.simulation import ENGINES, STARTS, at_first_sample, fitted_start, run_servo, run_torque

__all__ = ["simulate"]

INPUT = "input"  # source of an input from memory, with which no motion was recorded
UNITS = {
    Motion.HINGE: {"time": "s", "torque": "Nm", "velocity": "rad/s", "angle": "rad"},
    Motion.SLIDE: {"time": "s", "torque": "N", "velocity": "m/s", "angle": "m"},
}


def simulate(
    model: Model | str | Path | mujoco.MjSpec,
    source: ArrayLike | Recording | str | Path,
    dt: float | None = None,
    *,
    effects: Sequence[Effect] = (),
    engine: str = "ode",
    start: str | Start = "auto",
    joint: str | None = None,
) -> Recording:
    """Simulate a model of an axis on an input; the result is a `Recording` of the input and the motion.

    ``source``: the input (N,) at samples ``dt`` [s] apart, a torque [N m | N] or the command of a servo [rad | m], from rest at
    angle 0; or a recording (a file, columns by name, a `Recording`), on whose input the model runs and whose first sample it
    starts from; in gaps of its stamps the input is what moved the axis across them, as `diagnose` takes it.
    ``effects``: physics to add to the model, such as ``simgap.effects["backlash"](place="gearbox", gap_rad=1e-3)``.
    ``engine``: ``"ode"`` the analytic equations, ``"mujoco"`` MuJoCo with steps that end at events, ``"literal"`` plain MuJoCo on
    the file as it is. ``start``: at the first sample of a recording, ``"rest"``, ``"recorded"``, a state, or ``"auto"``: where
    the recording starts in motion the state that suits all of it best, else that of the first two with the smaller error.
    Raises `InputError` for an effect that the model has no place for, and for a run that diverges.

    >>> import numpy as np
    >>> import simgap
    >>> torque = np.ones(500)  # 2 s of 1 N m
    >>> run = simgap.simulate("pendulum", torque, dt=0.004)
    >>> round(float(run.angle.max()), 2)  # rad
    0.65
    >>> stuck = simgap.effects["coulomb_friction"](place="motor", torque_Nm=1.5)
    >>> simgap.simulate("pendulum", torque, dt=0.004, effects=[stuck]).angle.max() < 1e-6
    np.True_
    """
    for name, value, choices in (("engine", engine, ENGINES), ("start", start, STARTS)):
        if isinstance(value, str) and value not in choices:
            raise InputError(name, repr(value), " or ".join(choices), nearest(str(value), choices, "correct it"))
    subject = Model(model)
    given = load_model(subject.path)
    if effects:
        given = dataclasses.replace(given, axis=_with(given.axis, effects))
        if engine == "literal":
            raise InputError("engine", "'literal' runs the file, and effects are added", "'ode' or 'mujoco'")
    servo = given.axis.chain.servo is not None
    record = _input(source, dt, subject, servo=servo, joint=joint)
    try:
        if start == "auto" and record.source != INPUT:
            start = fitted_start(given, record) or start
        if servo:
            begin = None if isinstance(start, str) else start
            run = run_servo(given, record, engine, rest=record.source == INPUT, start=begin)
        else:
            initial = at_first_sample(given, record, start) if record.velocity is not None or record.angle is not None else None
            run = run_torque(given, record.torque, record, engine, initial)
    except DivergedError as error:
        raise InputError(record.source, str(error)) from None
    return _recording(run, record, given.axis.chain.motion, servo=servo)


def _with(axis: Any, effects: Sequence[Effect]) -> Any:
    try:
        for effect in effects:
            effect.ports(axis.chain)
            axis = axis + effect
    except (NotApplicableError, ValueError) as error:
        raise InputError("effects", str(error), "effects that the model has a place for", "leave it out") from None
    return axis


def _input(source: Any, dt: float | None, model: Model, *, servo: bool, joint: str | None) -> Recording:
    """The input as a recording; of an array there is no motion to start from."""
    if isinstance(source, Recording | str | Path) or hasattr(source, "keys"):
        record = loaded(source, model, joint=joint)
        if not isinstance(record, Recording):
            raise InputError(record.source, "a recording of a robot", "of one axis", "name a joint")
        return as_moved(record)
    values = np.asarray(source, float)
    if values.ndim != 1 or len(values) < 2 or not np.isfinite(values).all():
        raise InputError("input", f"shape {values.shape}", "at least two finite numbers (N,)", "correct it")
    if dt is None or not 0 < dt < math.inf:
        raise InputError("dt", repr(dt), "the time between two samples [s]", "give it with an input from memory")
    time, none = dt * np.arange(len(values)), np.full(len(values), np.nan)
    return Recording(
        time, none if servo else values, None, np.zeros(len(values)) if servo else None, float(dt),
        source=INPUT, command=values if servo else None,
    )  # fmt: skip


def _recording(run: Trajectory, record: Recording, motion: Motion, *, servo: bool) -> Recording:
    """The run as a recording of the same experiment, at its times."""
    return Recording(
        record.time, np.full(len(run.time), np.nan) if servo else run.torque, run.velocity, run.angle, record.dt,
        source="simulation", units=UNITS[motion], command=run.torque if servo else None, hold=record.hold,
        joint=record.joint, known=dict(record.known),
    )  # fmt: skip
