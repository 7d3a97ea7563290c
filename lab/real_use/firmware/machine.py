"""The machines: a joint or an arm of plain MuJoCo, the user's file of it, and its logs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from lab.real_use.firmware.design import JOINTS, Case
from lab.real_use.firmware.drive import PERIOD, Firmware, Loop

__all__ = ["Machine", "log_of", "write_log"]

FINE = 4  # steps of MuJoCo in a period of the drive
SETTLE = 1.0  # [s] that a machine stands at its first command before the log
ENCODER = 2.0 * math.pi / 4096

Passive = Callable[[mujoco.MjModel, mujoco.MjData], np.ndarray]


@dataclass(frozen=True)
class Machine:
    """A joint or an arm, true or as the user's file has it.

    Of a joint: mass [kg], lever [m] (0: a balanced table), inertia; of an arm: extra mass at the tip. friction: dry friction of
    each joint; passive: further force at the joints; gap [rad], stiffness [N m/rad]: between motor and link; stop: half range.
    """

    kind: str
    firmware: Firmware
    mass: float = 0.8
    lever: float = 0.25
    inertia: float = 0.01
    armature: float = 0.01
    damping: float = 0.05
    friction: tuple[float, ...] = (0.0,)
    scale: float = 1.0
    payload: float = 0.0
    gap: float = 0.0
    stiffness: float = 0.0
    stop: float = math.inf
    compensated: bool = False
    passive: tuple[Passive, ...] = field(default=(), compare=False)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that are logged."""
        return JOINTS if self.kind == "arm" else ("j",)

    def with_drive(self, **changes: object) -> Machine:
        """A copy whose drive has other numbers."""
        return replace(self, firmware=replace(self.firmware, **changes))  # type: ignore[arg-type]

    def text(self, servo: bool, timestep: float = 0.002) -> str:
        """MJCF with ``<position>`` of the drive's kp and kv (the user's file), or with motors (the machine)."""
        names = self.joints
        kp, kv = (np.broadcast_to(np.asarray(x, dtype=float), len(names)) for x in (self.firmware.kp, self.firmware.kv))
        actuators = "".join(
            f'<{"position" if servo else "motor"} name="{n}_drive" joint="{n}"' + f' kp="{a:.6g}" kv="{b:.6g}"' * servo + "/>"
            for n, a, b in zip(names, kp, kv, strict=True)
        )  # fmt: skip
        body = self._arm() if self.kind == "arm" else self._joint()
        return (
            f'<mujoco model="{self.kind}">\n  <compiler angle="radian"/>\n'
            f'  <option timestep="{timestep:g}" integrator="implicitfast"/>\n  <worldbody>{body}</worldbody>\n'
            f"  <actuator>{actuators}</actuator>\n</mujoco>\n"
        )

    def _joint(self) -> str:
        kind, axis = {"slide": ("slide", "1 0 0"), "turntable": ("hinge", "0 0 1")}.get(self.kind, ("hinge", "0 1 0"))
        inertia = " ".join([f"{self.inertia:.6g}"] * 3)
        link = f'<inertial pos="0 0 {-self.lever:.6g}" mass="{self.mass:.6g}" diaginertia="{inertia}"/>'
        stop = f' limited="true" range="{-self.stop:.6g} {self.stop:.6g}"' if math.isfinite(self.stop) else ""
        numbers = f'damping="{self.damping:.6g}" armature="{self.armature:.6g}" frictionloss="{self.friction[0]:.6g}"{stop}'
        joint = f'<joint name="j" type="{kind}" axis="{axis}" {numbers}/>'
        if not self.gap and not self.stiffness:
            return f'<body name="link">{joint}{link}</body>'
        between = f'<joint name="between" type="{kind}" axis="{axis}" damping="{self.damping / 5:.6g}"'
        between += f' stiffness="{self.stiffness:.6g}"' if self.stiffness else ""
        half = self.gap / 2
        between += f' limited="true" range="{-half:.6g} {half:.6g}" solreflimit=".002 1"' if self.gap else ""
        rotor = '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-6 1e-6 1e-6"/>'
        return f'<body name="rotor">{joint}{rotor}<body name="link">{between}/>{link}</body></body>'

    def _arm(self) -> str:
        s = self.scale
        length = np.array([0.0, 0.3, 0.25, 0.1]) * s
        mass = np.array([1.5, 1.2, 0.8, 0.3]) * s**2
        axes, out = ("0 0 1", "0 1 0", "0 1 0", "0 1 0"), ""
        for i, name in enumerate(JOINTS):
            place = "0 0 .1" if i < 2 else f"{length[i - 1]:.6g} 0 0"
            numbers = f'damping="{self.damping * (1.0, 1.0, 0.5, 0.1)[i]:.6g}" armature="{(0.02, 0.02, 0.01, 0.003)[i]}"'
            joint = f'<joint name="{name}" axis="{axes[i]}" {numbers} frictionloss="{self.friction[i]:.6g}"/>'
            across = mass[i] * max(length[i], 0.1) ** 2 / 12
            inertia = f'mass="{mass[i]:.6g}" diaginertia="{across / 5:.6g} {across:.6g} {across:.6g}"'
            out += f'<body name="l{i}" pos="{place}">{joint}<inertial pos="{length[i] / 2:.6g} 0 0" {inertia}/>'
        if self.payload:
            out += f'<body name="payload" pos="{length[3]:.6g} 0 0"><inertial pos="0 0 0" mass="{self.payload:.6g}" '
            out += 'diaginertia="1e-4 1e-4 1e-4"/></body>'
        return out + "</body>" * len(JOINTS)


def _command(case: Case, rng: np.random.Generator, reach: np.ndarray, seconds: float) -> np.ndarray:
    """Command (N, joints) that begins at rest."""
    n, dt = round(seconds * case.rate), 1.0 / case.rate
    t = np.arange(n) * dt
    columns = []
    for amplitude in reach:
        if case.motion == "sines":
            f = np.exp(rng.uniform(math.log(0.1), math.log(0.8 if case.machine == "arm" else 1.5), 7))
            wave = (np.sin(2 * np.pi * f[:, None] * t + rng.uniform(0, 2 * np.pi, (7, 1))) / np.sqrt(f[:, None])).sum(axis=0)
            wave = wave - wave[0] * np.exp(-t / 0.3)
            columns.append(amplitude * wave / np.max(np.abs(wave)))
            continue
        goals = np.repeat(rng.uniform(-1.0, 1.0, n), np.round(rng.uniform(0.6, 1.8, n) / dt).astype(int))[: n - round(0.5 / dt)]
        goals = amplitude * np.concatenate([np.zeros(n - len(goals)), goals])
        if case.motion == "ramps":
            most = amplitude * rng.uniform(1.5, 3.0) * dt
            for k in range(1, n):
                goals[k] = goals[k - 1] + np.clip(goals[k] - goals[k - 1], -most, most)
        columns.append(goals)
    return np.column_stack(columns)


def _run(case: Case, machine: Machine, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (N, joints) at the samples, and the largest force of each drive."""
    m = mujoco.MjModel.from_xml_string(machine.text(False))
    m.opt.timestep = PERIOD / FINE
    d = mujoco.MjData(m)
    at, of = ([int(getattr(m.joint(j), adr)[0]) for j in machine.joints] for adr in ("qposadr", "dofadr"))
    loop = Loop(machine.firmware, len(machine.joints))
    still = mujoco.MjData(m)
    each = round(1.0 / case.rate / PERIOD)
    out, peak = np.zeros((len(command), len(at))), np.zeros(len(at))
    for k in range(-round(SETTLE * case.rate), len(command)):
        now, after = command[max(k, 0)], command[max(min(k + 1, len(command) - 1), 0)]
        if k >= 0:
            out[k] = d.qpos[at]
        for i in range(each):
            target = now + (after - now) * i / each if case.way == "interpolated" else now
            d.ctrl[:] = loop.force(target, d.qpos[at], d.qvel[of])
            if machine.compensated:
                still.qpos[:] = d.qpos
                mujoco.mj_forward(m, still)
                d.ctrl[:] += still.qfrc_bias[of]
            if k >= 0:
                peak = np.maximum(peak, np.abs(d.ctrl))
            for _ in range(FINE):
                d.qfrc_applied[:] = sum((f(m, d) for f in machine.passive), np.zeros(m.nv))
                mujoco.mj_step(m, d)
    return out, peak


def log_of(case: Case, machine: Machine, which: int, seconds: float = 20.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Command and measured angle (N, joints) of the recording number ``which``, and the largest force of each drive."""
    rng = np.random.default_rng([case.seed, 2, which])
    reach = np.array({"arm": (0.8, 0.5, 0.6, 0.7), "slide": (0.15,)}.get(case.machine, (0.8,)))
    command = _command(case, rng, reach, seconds)
    angle, peak = _run(case, machine, command)
    step = ENCODER * (0.2 if case.machine == "slide" else 1.0)
    noise = rng.standard_normal(angle.shape)
    measured = step * np.round(angle / step) if case.sensor == "encoder" else angle + 0.2 * step * noise
    return command, measured, peak


def write_log(path: Path, case: Case, machine: Machine, command: np.ndarray, angle: np.ndarray) -> None:
    """Write a log as CSV: time, and command and angle of each joint."""
    unit = "m" if case.machine == "slide" else "rad"
    value = "position" if case.machine == "slide" else "angle"
    names, columns = ["time_s"], [np.arange(len(command)) / case.rate]
    for i, joint in enumerate(machine.joints):
        prefix = "" if len(machine.joints) == 1 else f"{joint}."
        names += [f"{prefix}command_{unit}", f"{prefix}{value}_{unit}"]
        columns += [command[:, i], angle[:, i]]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=",".join(names), comments="", fmt="%.7g")
