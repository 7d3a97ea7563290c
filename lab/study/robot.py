"""The robot of figure 4: a surrogate whose parameters are drawn by a seed and kept out of the plot, or a user's recording."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lab.study.cell import DT, LOW_HZ, Experiment, Result, analyse
from lab.study.pipeline import BETTER, FAITHFUL, Pipeline
from lab.study.plants import nominal
from mjsim.errors import InputError

__all__ = ["Robot", "RobotResult", "recorded_robot", "robot_models", "surrogate_robot"]

_SEED = 1400


@dataclass(frozen=True)
class Robot:
    """Torque [Nm] and velocity [rad/s] of a robot, (N,) each; ``label`` says on the plot what it is, ``truth`` what it hides."""

    torque: np.ndarray
    velocity: np.ndarray
    dt: float
    label: str
    source: str
    key: str
    truth: dict[str, Any]


@dataclass(frozen=True)
class RobotResult:
    """Robot and nominal model on the same torque through the same pipeline."""

    pipeline: str
    robot: Result
    model: Result

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"pipeline": self.pipeline, "robot": self.robot.to_dict(), "model": self.model.to_dict()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> RobotResult:
        """Inverse of `to_dict`."""
        return cls(values["pipeline"], Result.from_dict(values["robot"]), Result.from_dict(values["model"]))


def surrogate_robot(high_hz: float, duration: float = 20.0) -> Robot:
    """A simulated robot: drawn linear parameters, damping of the gearbox positive, friction and slack, noise; in MuJoCo."""
    from mjsim import accurate
    from mjsim.effects.backlash import Backlash
    from mjsim.effects.coulomb_friction import CoulombFriction
    from mjsim.excitation import chirp

    rng = np.random.default_rng(_SEED)
    scale = {n: float(rng.uniform(0.95, 1.05)) for n in ("Jm", "Jg", "fm", "kg")}
    scale |= {"Ja": float(rng.uniform(0.85, 0.95)), "ka": float(rng.uniform(1.0, 1.15)), "da": float(rng.uniform(0.8, 1.5))}
    known = {p.name: p.value for p in nominal().chain.linear_parameters()}
    values = {n: known[n] * s for n, s in scale.items()} | {"dg": float(rng.uniform(10.0, 60.0))}
    friction, gap = float(rng.uniform(0.02, 0.08)), float(rng.uniform(2e-5, 8e-5))
    axis = nominal().with_linear(values)
    axis = axis + CoulombFriction(torque_Nm=friction) + Backlash(gap_rad=gap)
    e = Experiment(high_hz=high_hz, duration=duration)
    torque = chirp(e.duration, DT, e.amplitude, LOW_HZ, e.high_hz)
    velocity = np.asarray(accurate.simulate(axis, torque, DT).velocity) + 0.05 * rng.standard_normal(torque.size)
    return Robot(
        torque, velocity, DT, "surrogate robot (concealed parameters, not a measured IRB1400)",
        "surrogate robot", f"surrogate {_SEED} {high_hz:g} {duration:g}",
        {"linear": values, "coulomb_friction_Nm": friction, "backlash_rad": gap, "velocity_noise_rad_s": 0.05, "seed": _SEED},
    )  # fmt: skip


def recorded_robot(path: Path) -> Robot:
    """A user's log as the robot. Raises InputError for what cannot be used."""
    from ident import IOData
    from ident.checks import check_clipping, check_moving
    from mjsim.recording import load

    recording = load(path)
    if recording.dt > 2.6e-3:
        raise InputError(path, f"sampled every {recording.dt:g} s", "at most 2.5 ms, to be decimated to 5 ms", "record faster")
    how = ""
    if recording.velocity is not None:
        velocity = np.asarray(recording.velocity)
    else:
        velocity = np.gradient(np.asarray(recording.angle), recording.dt)
        how = ", angle differentiated"
    torque = np.asarray(recording.torque)
    raw = IOData(torque, velocity, recording.dt, "torque", "velocity", "Nm", "rad/s", str(path))
    check_moving(raw)
    check_clipping(raw, channels="y")  # a torque at the drive's limit is still what was applied
    key = hashlib.sha256(path.read_bytes()).hexdigest()
    return Robot(torque, velocity, recording.dt, f"recording {recording.source}{how}", str(path), key, {})


def _at(pipeline: Pipeline, dt: float) -> Pipeline:
    """The same target rate for another sampling interval."""
    from dataclasses import replace

    return replace(pipeline, decimate=max(1, round(pipeline.decimate * DT / dt)))


def robot_models(robot: Robot, pipelines: tuple[Pipeline, ...] = (FAITHFUL, BETTER)) -> tuple[RobotResult, ...]:
    """Models of the robot and of the nominal axis run on the robot's torque. Raises InputError."""
    from mjsim import accurate

    simulated = np.asarray(accurate.simulate(nominal(), robot.torque, robot.dt).velocity)
    e = Experiment()  # the noise of all other cells: without any, the fit of the noise model is ill-conditioned
    simulated = simulated + e.noise * np.random.default_rng(e.seed).standard_normal(simulated.size)
    out = []
    for pipeline in pipelines:
        here = _at(pipeline, robot.dt)
        measured = analyse(robot.torque, robot.velocity, robot.dt, here, robot.source)
        if measured.void and pipeline is FAITHFUL:
            raise InputError(robot.source, measured.void.removeprefix(f"{robot.source}: "))
        model = analyse(robot.torque, simulated, robot.dt, here, "the model on the recorded torque")
        out.append(RobotResult(pipeline.name, measured, model))
    return tuple(out)
