"""Scenarios of robots: a fixed-base MJCF, concealed effects, an exciting trajectory and noise, as validated TOML, and their log.

model = "arm6"                      # a shipped model, or a path from the scenario's file
duration_s = 20.0
[excitation]
kind = "fourier"                    # see mjsim.robot.exciting
base_hz = 0.1
harmonics = 5
[payload]                           # a point mass that the nominal model lacks
body = "flange"
mass = 1.0
[joints.joint3]                     # numbers of a joint that the nominal model has otherwise
armature = 0.12
[[effects]]
id = "coulomb_friction"
joint = "joint2"
torque_Nm = 2.0
[noise]
angle = 2e-5                        # standard deviations of white noise, in the units of the log

Joints that a torque drives get the torque of the nominal model along the trajectory and a tracking loop, both held over a
sample as a digital controller's; joints under a servo get the trajectory as command. All are stepped together by MuJoCo with
the file's options.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from mjsim.errors import InputError, nearest
from mjsim.mjcf.assets import bring_assets
from mjsim.mjcf.drive_laws import range_of
from mjsim.mjcf.whole import is_whole, write_whole
from mjsim.models import model_beside, model_path, shipped_models
from mjsim.robot.binding import Payload
from mjsim.robot.carried import AT_SERVO, needed_parameters
from mjsim.robot.closed_loop import closed_loop, motor_gain
from mjsim.robot.drives import joint_drives
from mjsim.robot.exciting import Excitation, Limits, exciting
from mjsim.robot.inertia import moved, point_mass
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.recording import SUFFIXES, RobotRecording
from mjsim.robot.rows import nominal_torque
from mjsim.robot.write import carried_effects, write_robot
from mjsim.scenario import Format, refused, versions, write_columns
from mjsim.scenario_parts import Noise, NotNegative, Positive, Strict
from mjsim.toml import toml_at

__all__ = ["Fourier", "RobotLog", "RobotScenario", "robot_scenario", "run_robot", "shipped_robot_scenarios", "write_robot_log"]

_FOLDER = Path(__file__).resolve().parent.parent / "scenarios" / "robots"
NUMBERS = ("armature", "damping", "frictionloss", "stiffness")


class Fourier(Strict):
    """A Fourier series for each joint, of ``harmonics`` multiples of ``base_hz`` [Hz], optimised for its condition number."""

    kind: Literal["fourier"] = "fourier"
    base_hz: Positive = 0.1
    harmonics: Annotated[int, Field(ge=2, le=50)] = 5
    share: Annotated[float, Field(gt=0, le=1)] = Limits.share
    speed_rad_s: Positive = Limits.speed_rad_s
    speed_m_s: Positive = Limits.speed_m_s
    joints: tuple[str, ...] = ()


class PointMass(Strict):
    """A point mass [kg] at ``pos`` [m] in the frame of a body."""

    body: str
    mass: NotNegative
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)


class RobotScenario(Strict):
    """A validated scenario of a robot; ``name`` and ``folder`` come from its file."""

    name: str
    folder: Path
    about: str = ""
    model: str = "arm6"
    seed: Annotated[int, Field(ge=0)] = 0
    duration_s: Positive = 20.0
    sample_time_s: Positive = 4e-3
    format: Format = Format.CSV
    excitation: Fourier = Fourier()
    effects: tuple[dict[str, Any], ...] = ()
    joints: dict[str, dict[str, float]] = Field(default_factory=dict)
    payload: PointMass | None = None
    noise: Noise = Noise()

    @property
    def model_path(self) -> Path:
        """The model's file, as `mjsim.models.model_beside` finds it from the scenario's folder."""
        return model_beside(self.folder, self.model)


def shipped_robot_scenarios() -> dict[str, str]:
    """Names of the shipped scenarios of robots and what they are about."""
    return {path.stem: str(toml_at(path).get("about", "")) for path in sorted(_FOLDER.glob("*.toml"))}


def robot_scenario(source: str | Path, **overrides: Any) -> RobotScenario | None:
    """The scenario of a robot: from a TOML file whose excitation is a Fourier series, a shipped one, or a model.

    A model (an .xml file, or a shipped model of several driven joints) gives a trajectory and nothing concealed. None where the
    source is none of these, such as a scenario of an axis. ``overrides`` that are not None replace keys. Raises InputError.
    """
    given = {k: v for k, v in overrides.items() if v is not None}
    path, name = Path(source), str(source)
    shipped = _FOLDER / f"{name.removesuffix('.toml')}.toml"
    if path.suffix == ".xml" or (name in shipped_models() and not path.is_file()):
        model = model_path(name)
        if path.suffix != ".xml" and np.sum(load_robot(model).driven) < 2:
            return None
        return RobotScenario(name=model.stem, folder=Path(), **({"model": str(model.resolve())} | given))
    if path.suffix != ".toml" or not path.is_file():
        if not shipped.is_file() or "/" in name:
            return None
        path = shipped
    table = toml_at(path)
    excitation = table.get("excitation")
    if not isinstance(excitation, dict) or excitation.get("kind") != "fourier":
        return None
    table.update(given)
    try:
        return RobotScenario(**{**table, "name": path.stem, "folder": path.resolve().parent})
    except ValidationError as error:
        tables: dict[str, type[Strict]] = {"excitation": Fourier, "noise": Noise, "payload": PointMass}
        raise refused(path, error.errors(), RobotScenario, tables) from None


@dataclass(frozen=True, eq=False)
class RobotLog:
    """What a scenario gives: the nominal robot, the trajectory asked for, the motion as poses (N, nq) of the nominal file, and
    the logged columns (noise included) by name."""

    scenario: RobotScenario
    robot: Robot
    wanted: Excitation
    qpos: np.ndarray
    columns: Mapping[str, np.ndarray]


def run_robot(scenario: RobotScenario) -> RobotLog:
    """Run a scenario. Raises InputError for what cannot be run, and where the run diverges."""
    where = f"scenario {scenario.name!r}"
    robot = load_robot(scenario.model_path)
    _known_joints(where, robot, scenario.excitation.joints, "[excitation] joints")
    if not robot.driven.all():
        name = robot.joints[int(np.argmin(robot.driven))]
        raise InputError(scenario.model_path, f"joint {name!r} has no actuator", "one at every joint that no equality ties",
                         "add one, or fix the joint in a copy of the model")  # fmt: skip
    dt, count = scenario.sample_time_s, round(scenario.duration_s / scenario.sample_time_s)
    if count < 2:
        raise InputError(f"{where}: duration_s", repr(scenario.duration_s), f"at least two samples of {dt} s", "lengthen it")
    phases, noise = (np.random.default_rng(s) for s in np.random.SeedSequence(scenario.seed).spawn(2))
    e, time = scenario.excitation, dt * np.arange(count)
    limits = Limits(share=e.share, speed_rad_s=e.speed_rad_s, speed_m_s=e.speed_m_s)
    wanted = exciting(robot, phases, time, e.base_hz, e.harmonics, limits, e.joints)
    asked = _asked(robot, wanted, time, dt)
    with tempfile.TemporaryDirectory() as work:
        true, carried = _true(scenario, robot, Path(work), where)
        run = closed_loop(true, asked, carried, sampled=True)
    if run.diverged:
        at = float(time[int(np.flatnonzero(~np.isfinite(run.z).all(axis=1))[0])])
        raise InputError(where, f"the run diverges at {at:.4g} s", "a model that MuJoCo can step", "make its timestep smaller")
    columns: dict[str, np.ndarray] = {"time_s": time}
    for j, name in enumerate(robot.joints):
        units, drawn = SUFFIXES[robot.motions[j]], noise.standard_normal((3, count))
        if asked.has("command", name):
            columns[f"{name}.command_{units['command']}"] = asked.command[:, j]  # type: ignore[index]
        elif asked.has("torque", name):
            torque = asked.torque[:, j] + run.tracking[:, j] / robot.gear[j]  # type: ignore[index]
            columns[f"{name}.torque_{units['torque']}"] = torque + scenario.noise.torque * drawn[2]
        columns[f"{name}.angle_{units['angle']}"] = run.z[:, j] + scenario.noise.angle * drawn[0]
        columns[f"{name}.velocity_{units['velocity']}"] = run.dz[:, j] + scenario.noise.velocity * drawn[1]
    return RobotLog(scenario, robot, wanted, run.z @ robot.tie.T + robot.rest, columns)


def _known_joints(where: str, robot: Robot, names: Mapping[str, Any] | tuple[str, ...], key: str) -> None:
    for name in names:
        if name not in robot.joints:
            raise InputError(
                f"{where}: {key}", f"joint {name!r} is not in the model", f"one of {', '.join(robot.joints)}",
                nearest(name, robot.joints, "correct the name"),
            )  # fmt: skip


def _asked(robot: Robot, wanted: Excitation, time: np.ndarray, dt: float) -> RobotRecording:
    """The trajectory as commands of servos and torques of motors, for a run: what a controller sends."""
    drives = joint_drives(robot)
    servo = np.array([d is not None for d in drives])
    torque = nominal_torque(robot, wanted.z, wanted.dz, wanted.ddz) / robot.gear
    command = np.array(wanted.z)
    for j, d in enumerate(drives):
        if d is not None:  # the command with which the servo rests at the trajectory, its offset and gear taken in
            command[:, j] = (wanted.dz if d.velocity else wanted.z)[:, j] * d.gear / d.servo.scale
            command[:, j] += 0.0 if d.velocity else (d.servo.zero + d.length) / d.servo.scale
        elif robot.driven[j]:
            torque[:, j] = np.clip(torque[:, j], *(motor_gain(robot, j) * np.array(range_of(robot.model, robot.actuators[j]))))
    return RobotRecording(
        time, robot.joints, dt, wanted.z, torque=np.where(~servo & robot.driven, torque, np.nan),
        command=np.where(servo, command, np.nan),
    )  # fmt: skip


def _true(scenario: RobotScenario, robot: Robot, work: Path, where: str) -> tuple[Robot, list[dict[str, Any]]]:
    """The robot that the nominal one stands for, and its effects that MJCF has no element for."""
    links = robot.nominal - robot.fixed
    if scenario.payload is not None:
        p = scenario.payload
        at, pos, quat = robot.link_of(Payload(p.body, p.mass, p.pos).body)
        links[at] += moved(point_mass(p.mass, np.array(p.pos)), pos, quat)
    _known_joints(where, robot, tuple(scenario.joints), "[joints]")
    for name, values in scenario.joints.items():
        for key in values:
            if key not in NUMBERS:
                raise InputError(f"{where}: [joints.{name}]", f"key {key!r} is not known", ", ".join(NUMBERS),
                                 nearest(key, NUMBERS, "rename or remove it"))  # fmt: skip
    effects = [_effect(dict(given), robot, where) for given in scenario.effects]
    source = scenario.model_path
    if not is_whole(source):
        source = write_whole(source, work / "whole.xml")
        bring_assets(source)
    path = work / f"true_{source.name}"
    write_robot(source, robot, path, links, scenario.joints, effects)
    return load_robot(path), carried_effects(path)


def _effect(given: dict[str, Any], robot: Robot, where: str) -> dict[str, Any]:
    """An effect as a corrected file carries it, from its table ``{id, joint, parameters}``."""
    id_, joint, place, source = (str(given.pop(key, "")) for key in ("id", "joint", "place", "from"))
    known = needed_parameters()
    if id_ not in known:
        raise InputError(f"{where}: [[effects]] id", repr(id_), f"one of {', '.join(sorted(known))}", nearest(id_, known))
    _known_joints(where, robot, (joint, *([source] if source else [])), f"effect {id_!r} joint")
    if id_ == "coupled_transmission" and not source:
        raise InputError(f"{where}: effect {id_!r}", "no joint that it comes from", 'from = "JOINT"', "add it")
    if id_ in AT_SERVO and place != "sensor" and joint_drives(robot)[robot.joints.index(joint)] is None:
        raise InputError(
            f"{where}: effect {id_!r}", f"joint {joint!r} is driven by a torque", "a joint under a servo, whose command it "
            "changes", "choose another effect, or make the actuator <position>",
        )  # fmt: skip
    needed, optional = known[id_]
    unknown, lacking = set(given) - needed - optional, needed - set(given)
    if unknown or lacking:
        one = min(unknown or lacking)
        raise InputError(
            f"{where}: effect {id_!r}", f"unknown key {one!r}" if unknown else f"no {one!r}",
            ", ".join(("joint", *sorted(needed | optional))),
            nearest(one, needed | optional, "rename it") if unknown else "add it",
        )  # fmt: skip
    for key, value in given.items():
        if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
            raise InputError(f"{where}: effect {id_!r}", f"{key} = {value!r}", "a number", "correct it")
    extra = {"place": place} if place else {}
    return {"effect": id_, "joint": joint, "parameters": given} | extra | ({"from": source} if source else {})


def write_robot_log(log: RobotLog, out: Path) -> tuple[Path, dict[str, Any]]:
    """Write the log and beside it its provenance (JSON); never half a file. Returns the log's path and the provenance."""
    s, path = log.scenario, log.scenario.model_path
    told = {
        "scenario": s.model_dump(mode="json", exclude={"folder"}),
        "effects": [dict(e) for e in s.effects],
        "model": {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()},
        "trajectory": {"condition": log.wanted.condition, "size": log.wanted.shrunk},
        "seed": s.seed, "versions": versions(),
    }  # fmt: skip
    return write_columns(out, s.name, s.format, log.columns, told), told
