"""``simgap replay``: simulate a model, with the physics found in it, on the input of a recording."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simgap.arguments import Choice, InputFile, ModelFile, OutputFile, model_root, spare_inputs, take_file
from simgap.terminal import printable

if TYPE_CHECKING:
    import numpy as np

    from mjsim.mjcf import Model
    from mjsim.plant import Start
    from mjsim.recording import Recording
    from simgap.api.model import Model as Subject

__all__ = ["command"]


@click.command("replay")
@click.argument("model", type=ModelFile())
@model_root
@click.argument("recording", type=InputFile())
@click.option(
    "--out",
    type=OutputFile(".csv", ".parquet", ".npz", ".mcap"),
    required=True,
    help="Predicted motion: .csv, .mcap, .npz or .parquet.",
)
@click.option(
    "--engine",
    type=Choice(["ode", "mujoco", "literal"]),
    default="ode",
    show_default=True,
    help="ode: the analytic equations. mujoco: MuJoCo with steps that end at stick, slip and contact. Both simulate every "
    "effect. literal: plain MuJoCo on the file, with the effects that MJCF expresses.",
)
@click.option(
    "--start",
    type=Choice(["auto", "rest", "recorded"]),
    default="auto",
    show_default=True,
    help="Motion at the first sample. auto: of a recording that starts in motion, the state that suits all of it best, which "
    "is printed; else rest or the recorded velocity, by the error over the first half second.",
)
@click.option("--joint", default=None, help="The joint, of a log that holds several; default: the model's driven one.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(model: Path, recording: Path, out: Path, engine: str, start: str, joint: str | None, as_json: bool) -> None:
    """Simulate MODEL (a file or a shipped name) on the input of RECORDING, write the predicted motion and print the fit.

    The simulation includes the effects that `simgap diagnose` wrote into the model. In the ode engine, effects that depend on
    the angle take the recorded angle where there is one. The fit is 100 (1 - nrmse) percent; nrmse is the rms error over the
    standard deviation of the measured channel. Beside the ode engine the error of the file in plain MuJoCo is printed, unless
    MJCF cannot express one of its effects; of a coarse timestep the two differ. A recording of the diagnosis that wrote MODEL,
    beside which its diagnosis.json lies, is taken with the hold of the input that was found there, unless its binding states one.

    Of a robot, MuJoCo steps all joints together on the recorded commands; joints that a torque drives are held to the
    recording by a tracking loop, whose torque is written as well.

    Example: simgap replay report/corrected.xml other.csv --out prediction.csv
    """
    import numpy as np

    from diagnose.data.gap_input import as_moved
    from diagnose.data.listed import as_taken, holds_beside
    from diagnose.json_file import json_text
    from mjsim.errors import InputError, nearest
    from mjsim.mjcf import load_model
    from mjsim.mujoco_run import lacking
    from mjsim.recording import Recording
    from mjsim.writers import WRITERS
    from simgap.api.model import Model
    from simgap.api.recording import loaded
    from simgap.api.simulating import simulate
    from simgap.simulation import fitted_start

    take_file(out)
    if out.suffix and out.suffix.lower() not in WRITERS:
        raise InputError("--out", f"{out.name!r}", f"a name that ends in {', '.join(WRITERS)}",
                         nearest(out.suffix.lower(), WRITERS, "correct it"))  # fmt: skip
    spare_inputs([out], [recording, model])
    from simgap.robot import is_robot

    if is_robot([recording], model):
        _robot(model, recording, out, as_json=as_json)
        return
    source, subject = load_model(model), Model(model)
    record = loaded(recording, subject, joint=joint)
    assert isinstance(record, Recording)
    noted = len(record.notes)
    record = as_moved(as_taken(record, holds_beside(model)))
    servo = source.axis.chain.servo is not None
    fitted = fitted_start(source, record) if start == "auto" else None
    run = simulate(subject, record, engine=engine, start=start if fitted is None else fitted)
    channel = "velocity" if record.velocity is not None and (not servo or record.angle is None) else "angle"
    measured, predicted = record.column(channel), getattr(run, channel)
    if channel == "angle" and not servo and fitted is None:
        predicted = predicted + (measured[0] - predicted[0])
    compared = np.ones(len(record), bool) if record.missing is None else ~record.missing
    figures = _figures(measured[compared], predicted[compared], recording)
    run.save(out)
    result = {**figures, "channel": channel, "engine": engine, "effects": [e.key for e in source.axis.effects]}
    result |= {"start": dataclasses.asdict(fitted)} if fitted else {}
    plain = _plain_rms(subject, record, fitted or start, channel) if engine == "ode" else None
    result |= {} if plain is None else {"plain_mujoco_rms": plain}
    force = _force(source, record) if record.judge == "force" else None
    if force is not None:
        result["force"] = force
    lacks = lacking(source) if engine == "literal" else ()
    if engine == "literal":
        result["lacks"] = list(lacks)
    if as_json:
        click.echo(json_text(result, None))
        return
    unit = {"velocity": ("rad/s", "m/s"), "angle": ("rad", "m")}[channel][source.axis.chain.motion.value == "slide"]
    click.echo(
        f"{channel}: rms error {figures['rms']:.6g} {unit}, nrmse {figures['nrmse']:.6g}, fit {figures['fit_percent']:.3f} %"
    )
    if plain is not None:
        click.echo(f"  in plain MuJoCo, by the options of the file: rms error {plain:.6g} {unit} (--engine literal)")
    for line in (*record.notes[noted:], *_told(fitted, source), *(f"plain MuJoCo lacks {x}" for x in lacks)):
        click.echo(f"  {line}")
    if record.loop == "closed":
        click.echo("  recorded under feedback: a free run can drift even with the true model")
    if force is not None:
        click.echo(
            f"torque that the recorded motion needs: relative error {100 * force['relative']:.3f} %, nrmse {force['nrmse']:.6g}"
        )
    click.echo(printable(f"wrote {out}"))


def _plain_rms(model: Subject, record: Recording, start: str | Start, channel: str) -> float | None:
    """Rms error of the file in plain MuJoCo, from the same start.

    None where it lacks an effect without anything in its place, or diverges.
    """
    import numpy as np

    from mjsim.errors import InputError
    from mjsim.mjcf import load_model
    from mjsim.mujoco_run import lacking
    from simgap.api.simulating import simulate

    source = load_model(model.path)
    if lacking(source) and not (source.carried and source.carried.linear):
        return None
    try:
        run = simulate(model, record, engine="literal", start=start)
    except InputError:
        return None
    predicted, measured = getattr(run, channel), record.column(channel)
    if channel == "angle" and isinstance(start, str) and source.axis.chain.servo is None:
        predicted = predicted + (measured[0] - predicted[0])
    compared = slice(None) if record.missing is None else ~record.missing
    return float(np.sqrt(np.mean((measured - predicted)[compared] ** 2)))


def _told(start: Start | None, source: Model) -> list[str]:
    """A fitted state at the first sample, where there is one, and the effects of the model, in words."""
    angle, speed = ("m", "m/s") if source.axis.chain.motion.value == "slide" else ("rad", "rad/s")
    told = [f"with {effect.describe(source.axis.chain.motion)}" for effect in source.axis.effects]
    if start is None:
        return told
    parts = [f"angle {start.angle:.4g} {angle}", f"velocity {start.velocity:.4g} {speed}"]
    parts += [f"deflection {d:.3g}" for d in start.deflections] + [f"its rate {v:.3g}" for v in start.rates]
    parts += [f"{name} {value:.4g}" for name, value in start.states]
    moving = " in motion," if start.velocity else ""
    return [f"starts{moving} in the state fitted to the recording: {', '.join(parts)}", *told]


def _robot(model: Path, recording: Path, out: Path, *, as_json: bool) -> None:
    """Replay of all joints of a robot by MuJoCo, whichever engine is asked for."""
    from diagnose.json_file import json_text
    from simgap.robot_replay import replay_robot

    found = replay_robot(model, recording, out)
    if as_json:
        click.echo(json_text(found.as_dict(), None))
        return
    for name, r in found.joints.items():
        loop = f", torque of the tracking loop {r['tracking_rms']:.4g} rms" if "tracking_rms" in r else ""
        click.echo(
            f"{name}: rms error {r['rms']:.6g} {r['unit']}, nrmse {r['nrmse']:.6g}, fit {100 * (1 - r['nrmse']):.3f} %{loop}"
        )
    for line in (*found.notes, *(f"with {x}" for x in found.effects)):
        click.echo(f"  {line}")
    for line in found.lacking:
        click.echo(f"  not run: {line}")
    click.echo(printable(f"wrote {out}"))


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
