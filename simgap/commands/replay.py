"""``simgap replay``: simulate a model, with the physics found in it, on the input of a recording."""

from __future__ import annotations

import contextlib
import csv
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simgap.arguments import ModelFile, need_file, spare_inputs
from simgap.terminal import printable

if TYPE_CHECKING:
    import numpy as np

    from mjsim.mjcf import Model
    from mjsim.ode import Trajectory
    from mjsim.recording import Recording

__all__ = ["command"]

_COLUMNS = {
    "hinge": ("time_s", "torque_Nm", "velocity_rad_s", "angle_rad"),
    "slide": ("time_s", "torque_N", "velocity_m_s", "angle_m"),
}
_COMMAND = {"hinge": "command_rad", "slide": "command_m"}


@click.command("replay")
@click.argument("model", type=ModelFile())
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Predicted motion, a CSV file.")
@click.option(
    "--engine",
    type=click.Choice(["ode", "mujoco", "literal"]),
    default="ode",
    show_default=True,
    help="ode: the analytic equations. mujoco: MuJoCo with steps that end at stick, slip and contact. Both simulate every "
    "effect. literal: plain MuJoCo on the file, with the effects that MJCF expresses.",
)
@click.option(
    "--start",
    type=click.Choice(["auto", "rest", "recorded"]),
    default="auto",
    show_default=True,
    help="Motion at the first sample: auto chooses rest or the recorded velocity by the error over the first half second.",
)
@click.option("--joint", default=None, help="The joint, of a log that holds several; default: the model's driven one.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(model: Path, recording: Path, out: Path, engine: str, start: str, joint: str | None, as_json: bool) -> None:
    """Simulate MODEL (a file or a shipped name) on the input of RECORDING, write the predicted motion and print the fit.

    The simulation includes the effects that `simgap diagnose` wrote into the model. In the ode engine, effects that depend on
    the angle take the recorded angle where there is one. The fit is 100 (1 - nrmse) percent; nrmse is the rms error over the
    standard deviation of the measured channel.

    Example: simgap replay report/corrected.xml other.csv --out prediction.csv
    """
    from mjsim.errors import InputError
    from mjsim.mjcf import carried_binding, load_model
    from mjsim.ode import DivergedError
    from mjsim.recording import load

    need_file(out)
    spare_inputs([out], [recording, model])
    source = load_model(model)
    record = load(
        recording, model=model, binding=carried_binding(source, recording), joint=joint, prefer=source.axis.chain.bodies[0].joint
    )
    servo = source.axis.chain.servo is not None
    try:
        run = (
            _servo_run(source, record, engine)
            if servo
            else _run(source, record.torque, record, engine, _initial(source, record, start))
        )
    except DivergedError as error:
        raise InputError(recording, str(error)) from None
    channel = "velocity" if record.velocity is not None and not servo else "angle"
    measured, predicted = record.column(channel), getattr(run, channel)
    if channel == "angle" and not servo:
        predicted = predicted + (measured[0] - predicted[0])
    figures = _figures(measured, predicted, recording)
    _write(out, source.axis.chain.motion.value, run, servo=servo)
    result = {**figures, "channel": channel, "engine": engine, "effects": [e.key for e in source.axis.effects]}
    force = _force(source, record) if record.judge == "force" else None
    if force is not None:
        result["force"] = force
    lacks: tuple[str, ...] = ()
    if engine == "literal":
        from mjsim.mujoco_run import lacking

        lacks = lacking(source)
        result["lacks"] = list(lacks)
    if as_json:
        click.echo(json.dumps(result))
        return
    unit = {"velocity": ("rad/s", "m/s"), "angle": ("rad", "m")}[channel][source.axis.chain.motion.value == "slide"]
    click.echo(
        f"{channel}: rms error {figures['rms']:.6g} {unit}, nrmse {figures['nrmse']:.6g}, fit {figures['fit_percent']:.3f} %"
    )
    for effect in source.axis.effects:
        click.echo(f"  with {effect.describe(source.axis.chain.motion)}")
    for line in lacks:
        click.echo(f"  plain MuJoCo lacks {line}")
    if record.loop == "closed":
        click.echo("  recorded under feedback: a free run can drift even with the true model")
    if force is not None:
        click.echo(
            f"torque that the recorded motion needs: relative error {100 * force['relative']:.3f} %, nrmse {force['nrmse']:.6g}"
        )
    click.echo(printable(f"wrote {out}"))


def _servo_run(source: Model, record: Recording, engine: str) -> Trajectory:
    """One run under the model's own servo on the recorded command, from the angle that was measured first."""
    from diagnose.data.experiment import prepare
    from diagnose.data.runs import free_run
    from diagnose.data.servo import as_servo
    from mjsim.errors import InputError

    if engine == "mujoco":
        raise InputError("--engine", "'mujoco', and the model is a servo", "'ode'", "leave the option out")
    axis, (driven,), _, _ = as_servo(source.axis, [record], [])
    if engine == "literal":
        from mjsim.servo_run import literal_servo_run

        return literal_servo_run(source, driven)
    return free_run(axis, prepare(driven, minimum=2))


def _run(source: Model, torque: np.ndarray, record: Recording, engine: str, initial: np.ndarray | None) -> Trajectory:
    """One run on a commanded torque, the recording's or its beginning."""
    if engine == "literal":
        from mjsim.mujoco_run import run_signals

        return run_signals(source, torque, record.dt, initial=initial)
    if engine == "mujoco":
        from mjsim import accurate

        return accurate.simulate(source.axis, torque, record.dt, initial=initial)
    from mjsim import ode

    angle = None if record.angle is None else record.angle[: len(torque)]
    return ode.simulate(source.axis, torque, record.dt, initial=initial, angle=angle)


def _initial(source: Model, record: Recording, start: str) -> np.ndarray:
    """Angles and velocities (2, n) of the undeflected chain at the first sample.

    ``auto``: at rest or moving as recorded, whichever follows the recording better over its first half second.
    """
    import numpy as np

    chain = source.axis.chain
    ratios = np.array([chain.total_ratio(i) for i in range(len(chain.bodies))])
    angle = float(record.angle[0]) if record.angle is not None else 0.0
    rest = np.array([angle * ratios, 0.0 * ratios])
    if start == "rest":
        return rest
    speed = record.velocity if record.velocity is not None else np.gradient(record.column("angle"), record.dt)
    few = max(2, min(len(speed), round(0.005 / record.dt)))
    first = float(np.polynomial.Polynomial.fit(np.arange(few), speed[:few], 1)(0.0))
    moving = np.array([angle * ratios, first * ratios])
    if start == "recorded":
        return moving
    count = max(2, min(len(speed), round(0.5 / record.dt)))
    error = []
    for initial in (rest, moving):
        run = _run(source, record.torque[:count], record, "ode", initial)
        error.append(float(np.linalg.norm(run.velocity - speed[:count])))
    return rest if error[0] <= error[1] else moving


def _figures(measured: np.ndarray, predicted: np.ndarray, where: Path) -> dict[str, float]:
    import numpy as np

    from mjsim.errors import InputError

    spread = float(np.linalg.norm(measured - np.mean(measured)))
    if spread == 0.0:
        raise InputError(where, "the measured channel is constant", "a channel that varies", "record a motion")
    error = float(np.linalg.norm(measured - predicted))
    return {"rms": error / len(measured) ** 0.5, "nrmse": error / spread, "fit_percent": 100.0 * (1.0 - error / spread)}


def _force(source: Model, record: Recording) -> dict[str, float] | None:
    """Error of the torque that the recorded motion needs (inverse dynamics), as `simgap diagnose` judges such recordings.

    relative: rms error over rms torque; nrmse: over its spread.
    """
    import numpy as np

    from diagnose.data.experiment import prepare
    from diagnose.problem.view import ForceView

    view, experiment = ForceView(), prepare(record)
    signals = view.signals(source.axis, experiment, None)
    if signals is None:
        return None
    counts = view.counts(experiment)
    measured, error = signals.measured[counts], (signals.measured - signals.predicted)[counts]
    size = float(np.linalg.norm(error))
    return {
        "rms": size / len(error) ** 0.5,
        "relative": size / float(np.linalg.norm(measured)),
        "nrmse": size / float(np.linalg.norm(measured - np.mean(measured))),
    }


def _write(out: Path, motion: str, run: Trajectory, *, servo: bool) -> None:
    """Write the prediction beside its final name, then move it there."""
    time, torque, *rest = _COLUMNS[motion]
    columns = (time, _COMMAND[motion] if servo else torque, *rest)
    from mjsim.errors import InputError

    part = out.with_name(f".{out.name}.part")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with part.open("w", newline="", encoding="utf-8") as handle:
            writer = csv.writer(handle)
            writer.writerow(columns)
            for row in zip(run.time, run.torque, run.velocity, run.angle, strict=True):
                writer.writerow([f"{v:.12g}" for v in row])
        os.replace(part, out)
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})", "a writable place", "choose another --out") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
