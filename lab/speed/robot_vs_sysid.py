"""Damping and dry friction at six servo joints, fitted by ours and by `mujoco.sysid`: ``python lab/speed/robot_vs_sysid.py``.

    pip install -e '.[bench]'        (in a virtual environment of its own)

The arm of six joints is a sealed plant (`lab.robot.servo_plant`), logged for 10 s at 100 Hz through an encoder of 2^14 steps.
Free are the damping and the frictionloss of each joint, from twice and half of the truth on; all else in the file is true.
Ours: each joint runs free while the others follow the recording. `mujoco.sysid`: the whole arm in MuJoCo, its least squares with
its defaults. Times are processor times on one thread, the least of two runs in turns, without loading and compiling.

All answers are judged alike, all joints together in MuJoCo on a held-out log: at the file's timestep h of 1 ms, and at h / 8. At
h, MuJoCo's motion leads by half a step, which `mujoco.sysid` takes up in the damping (kp h / 2 more than the truth). Ours gives
two sets of numbers, as a diagnosis does: those of the motion, and those of corrected.xml, fitted in MuJoCo at h from there on
(`simgap.robot_polish`). The time is that of both. Exit 1 when ours is less than ten times faster, when the error of corrected.xml
at h is larger than that of `mujoco.sysid`, or that of the numbers of the motion at h / 8.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from diagnose.robot.servos.fit import Number, block_weights, fit
from diagnose.robot.servos.motion import joint_problem, prepare
from lab.benchmark.arms.sysid import ARM
from lab.robot.servo_cases import BASE, RATE, SECONDS, STEP, nominal_robot
from lab.robot.servo_plant import ServoRobot, command_for, servo_mjcf, simulate
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot, robot_from
from mjsim.robot.recording import RobotRecording
from simgap.robot_polish import stepped

SEEDS = (31, 32)  # of the commands: fitted, held out
SHARE = 0.06  # of a joint's rms servo torque: its dry friction
FASTER = 10.0
STEPS = 2  # of Gauss-Newton in MuJoCo
NUMBERS = Number("damping"), Number("friction")
Values = tuple[np.ndarray, np.ndarray]  # damping, frictionloss of each joint


def mjcf(truth: ServoRobot, values: Values) -> str:
    """The arm with other numbers at its joints."""
    text = servo_mjcf(truth)
    for link, damping, loss in zip(truth.arm.links, *values, strict=True):
        text = text.replace(f'damping="{link.viscous}"/>', f'damping="{damping:.12g}" frictionloss="{loss:.12g}"/>', 1)
    return text


def robot_of(truth: ServoRobot, values: Values) -> Robot:
    """The robot of that file."""
    return robot_from(mujoco.MjModel.from_xml_string(mjcf(truth, values)))


def recordings(truth: ServoRobot, robot: Robot) -> list[RobotRecording]:
    """The log that is fitted, and the held-out one."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    out = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        command = command_for(truth, rng, t, BASE)
        q = simulate(truth, command, 1 / RATE)
        q = STEP * np.round((q + 0.3 * STEP * rng.standard_normal(q.shape)) / STEP)
        out.append(RobotRecording(t, robot.joints, 1 / RATE, q, command=command))
    return out


def ours(truth: ServoRobot, robot: Robot, r: RobotRecording) -> tuple[Values, Values, float]:
    """The values by each joint's own run, those by MuJoCo at the file's timestep, and the processor time [s]."""
    began = time.process_time()
    motion = prepare(robot, r, False)
    problems = [joint_problem(robot, [motion], name, False) for name in robot.joints]
    fits = []
    for p in problems:
        found = fit(p, NUMBERS, p.nominal, block_weights(p, p.error(p.nominal)))
        fits.append(fit(p, NUMBERS, found.slots, block_weights(p, found.error)))
    slots = [f.slots for f in fits]
    for _ in range(STEPS):
        error = r.angle - closed_loop(robot_of(truth, _values(slots)), r).z
        slots = [
            stepped(p, NUMBERS, x, f.slots, e, f.weights, 0.0) for p, f, x, e in zip(problems, fits, slots, error.T, strict=True)
        ]
    return _values([f.slots for f in fits]), _values(slots), time.process_time() - began


def _values(slots: Sequence[np.ndarray]) -> Values:
    damping, loss = (np.array([float(x[SLOT[name]]) for x in slots]) for name in ("damping", "friction"))
    return damping, loss


def theirs(truth: ServoRobot, start: Values, r: RobotRecording) -> tuple[Values, float]:
    """The same by `mujoco.sysid`."""
    from importlib import import_module

    from lab.benchmark.arms.sysid import _modifier, _quiet

    sysid: Any = import_module("mujoco.sysid")
    spec = mujoco.MjSpec.from_string(mjcf(truth, start))
    model = spec.compile()
    assert r.command is not None
    began = time.process_time()
    each = round(r.dt / model.opt.timestep)
    fine = np.arange(len(r.time) * each) * model.opt.timestep
    control = sysid.TimeSeries.from_control_names(fine, np.repeat(r.command, each, axis=0), model)
    signals = [(f"joint{j + 1}_qpos", sysid.SignalType.MjStateQPos) for j in range(model.nv)]
    measured = sysid.TimeSeries.from_names(r.time, r.angle, model, signals)
    initial = sysid.create_initial_state(model, r.angle[0], np.zeros(model.nv), np.zeros(model.na))
    parameters = sysid.ParameterDict()
    for j in range(model.nv):
        for kind, values in (("damping", start[0]), ("frictionloss", start[1])):
            parameters.add(sysid.Parameter(f"{kind}{j}", 1.0, 0.02, 50.0, modifier=_modifier(_setter(j, kind, values[j]))))
    with _quiet():
        sequence = sysid.ModelSequences("arm", spec, "log", initial, control, measured, allow_missing_sensors=True)
        residual = sysid.build_residual_fn(models_sequences=[sequence], n_threads=1, enabled_observations=signals)
        found, _ = sysid.optimize(parameters, residual, optimizer="mujoco", verbose=False)
    factors = {n: float(p.value[0]) for n, p in found.items()}
    out = tuple(
        values * [factors[f"{kind}{j}"] for j in range(model.nv)]
        for kind, values in zip(("damping", "frictionloss"), start, strict=True)
    )
    return (out[0], out[1]), time.process_time() - began


def _setter(joint: int, kind: str, value: float) -> Any:
    def apply(spec: Any, factor: float) -> None:
        element = spec.joint(f"joint{joint + 1}")
        if kind == "damping" and np.ndim(element.damping):
            element.damping = np.array([value * factor, *np.asarray(element.damping)[1:]])
        else:
            setattr(element, kind, value * factor)

    return apply


def errors(truth: ServoRobot, values: Values, r: RobotRecording) -> dict[str, float]:
    """rms error [rad] of all joints together in MuJoCo, at the file's timestep and at an eighth of it."""
    robot = robot_of(truth, values)
    return {
        key: float(np.sqrt(np.mean((closed_loop(robot, r, finer=finer).z - r.angle) ** 2)))
        for key, finer in (("held_out", 1), ("held_out_fine", 8))
    }


def main() -> None:
    """Measure, print, exit 1 when the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if lacks := ARM.lacks():
        parser.error(f"mujoco.sysid lacks {', '.join(lacks)}: pip install -e '.[bench]'")
    plain = nominal_robot(6)
    r = recordings(plain, robot_of(plain, (np.ones(6), np.zeros(6))))[0]
    assert r.command is not None
    torque = np.array([s.kp for s in plain.servos]) * np.sqrt(np.mean((r.command - r.angle) ** 2, axis=0))
    truth = ServoRobot(
        plain.arm, tuple(dataclasses.replace(s, friction=SHARE * x) for s, x in zip(plain.servos, torque, strict=True))
    )
    true = np.array([x.viscous for x in truth.arm.links]), np.array([s.friction for s in truth.servos])
    start = 2.0 * true[0], 0.5 * true[1]
    robot = robot_of(truth, start)
    estimation, held = recordings(truth, robot)
    ours(truth, robot, estimation)
    runs = [(ours(truth, robot, estimation), theirs(truth, start, estimation)) for _ in range(2)]
    (motion, file, _), (sysid, _) = runs[0]
    result: dict[str, Any] = {
        name: {"damping": values[0].tolist(), "frictionloss": values[1].tolist(), **errors(truth, values, held)}
        for name, values in (("truth", true), ("motion", motion), ("corrected", file), ("sysid", sysid))
    }
    seconds = [min(run[k][-1] for run in runs) for k in range(2)]
    result |= {"seconds": {"ours": seconds[0], "sysid": seconds[1]}, "ratio": seconds[1] / seconds[0]}
    result["holds"] = bool(
        result["ratio"] >= FASTER
        and result["corrected"]["held_out"] <= result["sysid"]["held_out"]
        and result["motion"]["held_out_fine"] <= result["sysid"]["held_out_fine"]
    )
    for name in ("truth", "motion", "corrected", "sysid"):
        x = result[name]
        numbers = "; ".join(f"{key} {np.round(x[key], 4).tolist()}" for key in ("damping", "frictionloss"))
        fine, coarse = (1e3 * x[key] for key in ("held_out_fine", "held_out"))
        print(f"{name:9s} held-out error {coarse:.3f} mrad at the file's timestep, {fine:.3f} at an eighth; {numbers}")
    print(f"ours {seconds[0]:.2f} s, mujoco.sysid {seconds[1]:.2f} s")
    print(f"{'holds' if result['holds'] else 'MISSED'}: {result['ratio']:.1f} times faster (>= {FASTER:g})")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")
    sys.exit(0 if result["holds"] else 1)


if __name__ == "__main__":
    main()
