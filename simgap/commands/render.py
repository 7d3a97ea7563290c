"""``simgap render``: film a model or a scenario without a display."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simgap.arguments import Amount, Choice, InputFile, ModelFile, NamedSource, OutputFile, model_root, spare_inputs, take_file
from simgap.terminal import lines_wanted, printable

if TYPE_CHECKING:
    from mjsim.axis import Axis
    from mjsim.ode import Trajectory
    from mjsim.render import Rig, Take
    from mjsim.robot.scenario import RobotScenario

__all__ = ["command"]

SLOW = (0.3, 1.5)  # band of the chirp that moves a model [Hz]: seen at 25 pictures a second
SEEN = 0.02  # deflection [rad | m] that a picture shows, see `_hidden`
EXCITED = 10.0  # [s] of the trajectory of a robot: one period
WIDE = (0.5, 15.0)  # and of the one that winds an elastic axis up


@dataclass(frozen=True)
class _Wanted:
    """What was asked for: logs, camera, joint, how two motions are shown, and what `film` takes."""

    recording: Path | None
    simulation: Path | None
    camera: str | None
    joint: str | None
    style: str
    magnify: float
    film: dict[str, Any]


def _size(text: str) -> tuple[int, int]:
    from mjsim.errors import InputError

    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        width = height = 0
    if not (160 <= width <= 3840 and 120 <= height <= 2160):
        raise InputError("--size", repr(text), "WIDTHxHEIGHT such as 960x720, between 160x120 and 3840x2160")
    return width, height


def _is_model(source: str) -> bool:
    """Whether a name is that of a model: an MJCF file or a shipped model, and no scenario."""
    from mjsim.models import shipped_models
    from mjsim.robot.scenario import shipped_robot_scenarios
    from mjsim.scenario import shipped_scenarios

    if source.endswith(".xml"):
        return True
    if source in shipped_models():
        return True
    scenarios = [*shipped_scenarios(), *shipped_robot_scenarios()]
    if not source.endswith(".toml") and source not in scenarios:
        from mjsim.errors import InputError, nearest

        known = [*scenarios, *shipped_models()]
        raise InputError(f"{source!r}", "no such file, scenario or model", f"an .xml or .toml file or one of: {', '.join(known)}",
                         nearest(source, known))  # fmt: skip
    return False


def _film_model(path: Path, out: Path, view: str, wanted: _Wanted) -> str:
    """Film a model: its own geoms where one of them moves, else the magnified axis. Returns what was drawn."""
    from diagnose.data.gap_input import as_moved
    from mjsim.render.take import Rig, recorded, simulated, take_of_run

    if view == "magnified":
        return _film_axis(path, out, wanted)
    excited = None if wanted.recording is not None or wanted.simulation is not None else _excited(path)
    rig = Rig.of(path, wanted.joint)
    takes: list[Take] = []
    if excited is not None:
        rig, takes = excited
    elif wanted.simulation is not None:
        takes.append(recorded(rig, wanted.simulation, "simulation"))
    elif wanted.recording is not None or rig.axis is None:
        takes.append(simulated(rig, wanted.recording, ready=as_moved))
    else:
        said, run = _demonstrated(rig.axis.path, *SLOW)
        takes.append(take_of_run(rig, said, run))
    if wanted.recording is not None:
        takes.append(recorded(rig, wanted.recording))
    if _film_takes(rig, takes, out, wanted, needs_motion=view == "auto" and rig.axis is not None):
        return "the model's own geoms"
    return _film_axis(path, out, wanted)


def _robot_take(scenario: RobotScenario) -> tuple[Rig, list[Take]]:
    """The motion of a scenario of a robot, and its model."""
    from mjsim.render import Rig
    from mjsim.render.take import take_of_robot
    from mjsim.robot.scenario import run_robot

    rig = Rig.of(scenario.model_path)
    return rig, [take_of_robot(rig, run_robot(scenario))]


def _excited(path: Path) -> tuple[Rig, list[Take]] | None:
    """A robot that no recording moves, on an exciting trajectory; None for what is no robot or cannot follow one."""
    from mjsim.errors import InputError
    from mjsim.robot.scenario import robot_scenario
    from simgap.robot import is_robot_model

    try:
        scenario = robot_scenario(path, duration_s=EXCITED) if is_robot_model(path) else None
        return None if scenario is None else _robot_take(scenario)
    except InputError:
        return None


def _film_takes(rig: Rig, takes: list[Take], out: Path, wanted: _Wanted, *, needs_motion: bool) -> bool:
    """Film takes in the model's own geoms; False, and no film, when a moving geom is needed and none moves."""
    import numpy as np

    from mjsim.render import Scene, Style, film_takes
    from mjsim.render.own import magnified

    shown = [magnified(rig.model, t, wanted.magnify) for t in takes]
    scene = Scene(rig.path, np.concatenate([t.qpos for t in shown]), wanted.camera, rig.joint)
    if needs_motion and not scene.moves:
        return False
    notes = [f"motion x {wanted.magnify:g}"] if wanted.magnify != 1 else []
    film_takes(scene, shown, out, Style(wanted.style), notes=notes, **wanted.film)
    return True


def _film_axis(path: Path, out: Path, wanted: _Wanted) -> str:
    """Film the axis of a model as rotor, gear and arm, wind-up and gap magnified."""
    from diagnose.data.gap_input import as_moved
    from mjsim import ode
    from mjsim.control import as_driven
    from mjsim.mjcf import load_axis
    from mjsim.recording import load
    from mjsim.render import film, shot_of_recording, shot_of_run

    axis = load_axis(path)
    if wanted.recording is None:
        said, run = _demonstrated(path, *WIDE)
        shots = [shot_of_run(said, axis, run)]
    else:
        driven = axis.chain.driven
        record = as_moved(as_driven(axis.chain, load(wanted.recording, model=path, driven=driven)))
        if wanted.simulation is not None:
            first = shot_of_recording("simulation", axis, load(wanted.simulation, model=path, driven=driven))
        else:
            start = None
            if record.velocity is not None or record.angle is not None:
                import numpy as np

                ratios = np.array([axis.chain.total_ratio(i) for i in range(len(axis.chain.bodies))])
                q0 = float(record.angle[0]) if record.angle is not None else 0.0
                v0 = float(record.velocity[0]) if record.velocity is not None else 0.0
                start = np.stack([ratios * q0, ratios * v0])
            first = shot_of_run("simulation", axis, ode.simulate(axis, record.input, record.dt, initial=start))
        shots = [first, shot_of_recording("recording", axis, record)]
    film(shots, out, **wanted.film)
    return "the axis, magnified"


def _film_scenario(source: str, out: Path, view: str, wanted: _Wanted) -> str:
    """Film a scenario: in the geoms of its model where they show its motion, else as the magnified axis."""
    from mjsim.errors import InputError
    from mjsim.render import Rig, film, shot_of_run
    from mjsim.render.take import take_of_run
    from mjsim.robot.scenario import robot_scenario
    from mjsim.scenario import load_scenario, run

    if wanted.recording is not None or wanted.simulation is not None:
        raise InputError(source, "--recording and --simulation need a model", "MODEL.xml", "name the model")
    robot = robot_scenario(source)
    if robot is not None:
        _film_takes(*_robot_take(robot), out, wanted, needs_motion=False)
        return "the model's own geoms"
    scenario = load_scenario(source)
    log = run(scenario)
    if view == "model" or (view == "auto" and not _hidden(log.axis, log.motion)):
        rig = Rig.of(scenario.model_path)
        take = take_of_run(rig, f"simulation of {scenario.name}", log.motion)
        if _film_takes(rig, [take], out, wanted, needs_motion=view == "auto"):
            return "the model's own geoms"
    film([shot_of_run("simulation", log.axis, log.motion)], out, **wanted.film)
    return "the axis, magnified"


def _hidden(axis: Axis, motion: Trajectory) -> bool:
    """Whether an axis has deflections that its own geoms would not show: all below 1 % of the width of the picture.

    The longest lever of a picture is half its width, so that 0.02 rad moves a point by 1 % of it: 10 pixels of 960. The
    width of a slide's picture is taken as 2 m.
    """
    import numpy as np

    from mjsim.render.stage import deflections

    d = deflections(axis.chain, motion.q)
    return bool(d.size) and float(np.max(np.abs(d))) < SEEN


def _demonstrated(path: Path, low: float, high: float) -> tuple[str, Trajectory]:
    """What a model that no recording moves is moved by, and the run: in plain MuJoCo, else by the equations.

    A chirp from ``low`` to ``high`` [Hz] as a cosine, so that a free mass moves to and fro and does not drift away.
    """
    import numpy as np

    from mjsim import ode
    from mjsim.mjcf import load_model
    from mjsim.mujoco_run import lacking, run_signals
    from mjsim.quantity import Motion

    source = load_model(path)
    amplitude = _amplitude(source.axis, 2 * np.pi * low)
    t = 5e-4 * np.arange(round(8.0 / 5e-4))
    torque = amplitude * np.cos(2 * np.pi * (low + 0.5 * (high - low) * t / 8.0) * t)
    unit = "N m" if source.axis.chain.motion is Motion.HINGE else "N"
    said = f"simulation, chirp {low:g}-{high:g} Hz, {amplitude:.3g} {unit}"
    if not lacking(source):
        try:
            return said, run_signals(source, torque, 5e-4, before=float(torque[0]))
        except ode.DivergedError:  # by the file's own solver settings; the equations still show the motion
            pass
    return said, ode.simulate(source.axis, torque, 5e-4)


def _amplitude(axis: Axis, w: float) -> float:
    """Input that swings a model by about 0.3 rad or 0.2 m at w [rad/s], friction overcome twice over [N m | N]."""
    from mjsim.effects import ports
    from mjsim.law_probes import constant
    from mjsim.quantity import Motion

    chain = axis.chain
    inertia = sum(b.inertia * chain.total_ratio(i) ** 2 for i, b in enumerate(chain.bodies))
    damping = sum(b.viscous * chain.total_ratio(i) ** 2 for i, b in enumerate(chain.bodies))
    reach = (0.3 if chain.motion is Motion.HINGE else 0.2) / abs(chain.total_ratio(len(chain.bodies) - 1))
    torque = reach * w * (inertia**2 * w**2 + damping**2) ** 0.5
    for effect in axis.effects:
        for port in effect.ports(chain):
            if isinstance(port, ports.Friction):
                level = constant(port.law, port.p, 1.0) or (0.0, 0.0)
                torque += 2.0 * level[1] * abs(chain.total_ratio(port.body))
    return float(f"{torque / abs(chain.gain):.2g}")


def _told(frames: Iterable[int], count: int) -> Iterator[int]:
    """The frames, with a line on standard error at each tenth of them."""
    for i, frame in enumerate(frames):
        if (10 * i) // count > (10 * (i - 1)) // count:
            click.echo(f"simgap: picture {i + 1} of {count}", err=True)
        yield frame


def _bar(frames: Iterable[int], count: int) -> Iterator[int]:
    with click.progressbar(frames, length=count, label="rendering", file=sys.stderr) as bar:
        yield from bar


@click.command(epilog="Example: simgap render pendulum.xml --recording log.csv --out pendulum.mp4")
@click.argument("source", metavar="SCENARIO_OR_MODEL", type=NamedSource(models=True))
@model_root
@click.option(
    "--out", required=True, type=OutputFile(".mp4", ".gif", ".png"), help="FILE.mp4, FILE.gif or FILE.png (one picture)."
)
@click.option("--recording", type=InputFile(), help="A log: shows the model on its input, and the recorded motion.")
@click.option("--simulation", type=InputFile(), help="A log of a simulation, shown instead of running the model.")
@click.option("--style", type=Choice(["ghost", "side"]), default="ghost", show_default=True,
              help="With a recording: as a translucent ghost in the same picture, or in a second picture.")  # fmt: skip
@click.option("--camera", help="Camera of the MJCF file; 'free' fits one to the motion (default: the file's first, else free).")
@click.option("--joint", help="Joint that the recording measures, where the model has several.")
@click.option("--view", type=Choice(["auto", "model", "magnified"]), default="auto", show_default=True,
              help="model: the file's own geoms. magnified: a drawn axis with wind-up and gap enlarged.")  # fmt: skip
@click.option("--magnify", type=Amount(min=0, min_open=True), default=1.0, show_default=True,
              help="Enlarge the motion of the model's own geoms about the first pose.")  # fmt: skip
@click.option("--start", type=float, help="First moment shown [s]; of a png, the moment (default: the largest motion).")
@click.option("--duration", type=Amount(min=0, min_open=True), help="Length of the motion shown [s].")
@click.option("--speed", type=Amount(1e-3, 1e3), default=1.0, show_default=True, help="0.2 is slow motion.")
@click.option("--fps", type=Amount(1, 120), default=25.0, show_default=True, help="Pictures a second.")
@click.option("--size", default="960x720", show_default=True, help="Size of each picture with its traces [pixels].")
@click.option("--json", "as_json", is_flag=True, help="Print the file and what it shows as JSON.")
def command(
    source: str, out: Path, recording: Path | None, simulation: Path | None, style: str, camera: str | None, joint: str | None,
    view: str, magnify: float, start: float | None, duration: float | None, speed: float, fps: float, size: str,
    as_json: bool,
) -> None:  # fmt: skip
    """Film SCENARIO_OR_MODEL without a display.

    A model is drawn with its own geoms, lights and cameras; a light, a floor or a camera is added where the file has none. With
    a recording, the recorded angles pose the model, beside a simulation of the model on the recorded input.

    A drawn axis with magnified wind-up and gap takes the place of the geoms where no visible geom of a model moves, and in a
    scenario of an elastic axis whose deflections stay below 1 % of the picture. --view overrides this choice.
    """
    from mjsim.errors import InputError
    from mjsim.ode import DivergedError
    from mjsim.render.writer import need_suffix

    need_suffix(out)
    take_file(out)
    progress = _bar if sys.stderr.isatty() else _told if lines_wanted() else None
    given = {"size": _size(size), "fps": fps, "speed": speed, "start": start, "duration": duration, "progress": progress}
    wanted = _Wanted(recording, simulation, camera, joint, style, magnify, given)
    if simulation is not None and recording is None:
        raise InputError("--simulation", "no recording to compare it with", "--recording LOG", "add it")
    is_model = _is_model(source)
    path = ModelFile().convert(source, None, None) if is_model else Path(source)
    spare_inputs([out], [path, recording, simulation])
    try:
        drawn = _film_model(path, out, view, wanted) if is_model else _film_scenario(source, out, view, wanted)
    except DivergedError as error:
        raise InputError(source, str(error)) from None
    click.echo(json.dumps({"file": str(out), "shows": drawn}) if as_json else printable(f"{out}: {drawn}"))
