"""Native values -> MJCF elements: one writer for each kind of value, at the place of the chain that the value names."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from mjsim.effects import native as N  # noqa: N812
from mjsim.effects.ports import BacklashLaw
from mjsim.mjcf.editor import MjcfEditor, element, number, row
from mjsim.mjcf.joint_limit import on_joint
from mjsim.mjcf.linear import LinearWriter
from mjsim.mjcf.motor_write import MotorWriter
from mjsim.mjcf.native_read import weight_under
from mjsim.mjcf.servo_write import (
    STAYS,
    can_be_general,
    write_force,
    write_integral,
    write_lag,
    write_limit,
    write_line,
    write_slew,
)  # fmt: skip
from mjsim.mjcf.slack_write import IMPEDANCE, NOT_ONE_JOINT, limit_slack, loosen_link
from mjsim.quantity import Motion

__all__ = ["FRICTION_STEP", "NativeWriter"]

FRICTION_STEP = 1e-4  # largest timestep at which plain MuJoCo meets the law to about 1e-3 (measured, docs/decisions/mjcf.md)
DELAY_STEP = 1e-4
GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2], MuJoCo's own


class NativeWriter:
    """Writes native values through an editor.

    ``held``: the values that the author's file has; ``friction_step``: largest timestep [s] beside dry friction.

    Dry friction of one body and constant torques of the drive add up over the values that are written and those that are kept.
    """

    def __init__(
        self,
        editor: MjcfEditor,
        linear: LinearWriter,
        law: BacklashLaw,
        held: Sequence[N.Value],
        friction_step: float = FRICTION_STEP,
    ) -> None:
        self.editor = editor
        self.linear = linear
        self.law = law
        self.held = tuple(held)
        self.friction_step = friction_step
        self._motors = MotorWriter(editor, FRICTION_STEP)
        self._friction: dict[int, float] = {}
        self._torque = 0.0

    def write(self, value: N.Value) -> str:
        """Write a value; returns what plain MuJoCo lacks of it then, "" when nothing."""
        return _WRITERS[type(value)](self, value)

    def keep(self, value: N.Value) -> None:
        """A value that the file has and that stays as it is."""
        if isinstance(value, N.DryFriction):
            self._friction[value.body] = self._friction.get(value.body, 0.0) + value.level
        elif isinstance(value, N.DriveTorque):
            self._torque += value.torque

    def close(self) -> None:
        """Write the constant torque of the drive, whose parts add up: what a weight along a slide gives is taken off."""
        editor, drive = self.editor, self.editor.found.layout.drive
        if editor.chain.servo is not None:
            extra = self._torque - sum(v.torque for v in self.held if isinstance(v, N.DriveTorque))
            write_force(editor, self.linear.target.servo, extra / editor.chain.gain)
        if editor.chain.servo is not None or drive.id < 0:
            return
        present = drive.law.constant
        per_torque = drive.gain / editor.chain.gain
        pull = sum(v.torque for v in self.held if isinstance(v, N.DriveTorque)) - present / per_torque
        if editor.chain.motion is Motion.SLIDE:
            pull *= self.linear.target.bodies[0].inertia / editor.chain.bodies[0].inertia
        bias = (self._torque - pull) * per_torque
        if abs(bias - present) > 1e-12 * max(abs(bias), abs(present), abs(pull * per_torque)):
            editor.set("actuator", editor.general(), biastype="affine", biasprm=f"{number(bias)} 0 0")

    # ---- bodies -----------------------------------------------------------------------------------------------------------

    def _dry_friction(self, value: N.DryFriction) -> str:
        """A frictionloss that sticks."""
        self.keep(value)
        self.editor.step(self.friction_step)
        self.editor.follow(lambda: self._write_friction(value.body, self._friction[value.body]))
        return ""

    def _write_friction(self, body: int, level: float) -> None:
        editor = self.editor
        runge_kutta = int(editor.model.opt.integrator) == mujoco.mjtIntegrator.mjINT_RK4
        rate = (2.5 if runge_kutta else 1.0) / editor.timestep
        attributes = {
            "frictionloss": number(level),
            "solreffriction": f"-1 {number(-float(f'{rate:.6g}'))}",
            "solimpfriction": IMPEDANCE,
        }
        joint = editor.joint_of(body)
        for part in editor.found.on_body[body]:  # what the file has elsewhere is in the level
            if part.element.friction and (part.element.kind, part.element.name) != ("joint", joint):
                editor.set(part.element.kind, part.element.name, frictionloss="0")
        if joint is not None:
            editor.set("joint", joint, **attributes)
            return
        name = f"{editor.chain.bodies[body].joint}_friction"
        if ("tendon", name) in editor.added:
            for key, text in attributes.items():
                editor.xml.set(editor.node("tendon", name), key, text)
        else:
            editor.absolute_tendon(body, "friction", chain=False, **attributes)

    def _viscous_damping(self, value: N.ViscousDamping) -> str:
        """Damping of a tendon along the body's absolute angle, where the chain has none."""
        self.editor.absolute_tendon(value.body, "viscous", chain=False, damping=number(value.coefficient))
        return ""

    def _ground_spring(self, value: N.GroundSpring) -> str:
        """Stiffness and rest position of the one spring that the body has, else of its joint."""
        editor = self.editor
        parts = [p for p in editor.found.on_body[value.body] if p.element.stiffness[0]]
        if len(parts) > 1:
            return "several springs hold the body"
        kind, name, scale = "joint", editor.joint_of(value.body), 1.0
        if parts:
            kind, name, scale = parts[0].element.kind, parts[0].element.name, parts[0].scale
        if name is None:
            return NOT_ONE_JOINT
        stiffness, rest = number(value.stiffness / scale**2), value.rest * scale
        if kind == "tendon":
            editor.set(kind, name, stiffness=stiffness, springlength=number(rest))
        else:
            editor.hold_tendons(name)
            editor.set(kind, name, stiffness=stiffness, springref=number(math.degrees(rest) if editor.degrees() else rest))
        return ""

    def _square_drag(self, value: N.SquareDrag) -> str:
        """The second coefficient of a joint's damping."""
        editor, joint = self.editor, self.editor.joint_of(value.body)
        if joint is None:
            return NOT_ONE_JOINT
        now = editor.node("joint", joint).attributes.get("damping")
        dof = int(editor.model.jnt_dofadr[editor.model.joint(joint).id])
        linear = float(now.split()[0]) if now else float(editor.model.dof_damping[dof])
        editor.set("joint", joint, damping=row([linear, value.coefficient]))
        return ""

    def _body_bristle(self, value: N.BodyBristle) -> str:
        joint = self.editor.joint_of(value.body)
        if joint is None:
            return NOT_ONE_JOINT
        self._motors.bristle(value, value, (f"{joint}_bristle", "joint", joint))
        return ""

    def _split_body(self, value: N.SplitBody) -> str:
        """A further body below, on a joint of its own."""
        editor, model = self.editor, self.editor.model
        heavy = max((m for m, _ in editor.found.masses[value.body] if m.kind == "body"), key=lambda m: m.value)
        if not heavy.name or not model.body_jntnum[heavy.id]:
            return "its body has no joint of its own"
        self.linear.scale(value.body, 1.0 - value.inertia / self.linear.target.bodies[value.body].inertia)
        joint = int(model.body_jntadr[heavy.id])
        name = editor.fresh("body", f"{editor.chain.bodies[value.body].joint}_extra")
        place, axis = (row(list(v[joint])) for v in (model.jnt_pos, model.jnt_axis))
        motion = editor.chain.motion
        weight, tensor = (value.inertia, 1.0) if motion is Motion.SLIDE else (1.0, value.inertia)
        lines = [
            element("body", close=False, name=name),
            "  " + element("joint", name=name, type=motion.value, pos=place, axis=axis,
                           stiffness=number(value.stiffness), damping=number(value.damping)),
            "  " + element("inertial", pos=place, mass=number(weight), diaginertia=row([tensor] * 3)),
            "</body>",
        ]  # fmt: skip
        editor.xml.append(editor.node("body", heavy.name), lines)
        editor.added.append(("body", name))
        editor.ignored.append(name)
        return ""

    def _loose_link(self, value: N.LooseLink) -> str:
        """A slack joint and the spring of the contact, about which the link turns: it never pulls."""
        return loosen_link(self.editor, self.linear, value)

    def _weight(self, value: N.Weight) -> str:
        """Mass and centre of the body, whose inertia stays, where the file has a weight there or has it without its gravity."""
        own = next((v for v in self.held if isinstance(v, N.Weight) and v.body == value.body), None)
        if own is None:
            own = weight_under(self.editor.found, self.editor.path, GRAVITY)
            if own is None or own.body != value.body or self.editor.model.opt.gravity.any():
                return "MJCF has no element for it where no body of the file has a weight"
            self.editor.option(gravity=row(list(GRAVITY)))
            self.linear.weighed = True
        turn = math.remainder(value.phase - own.phase, 2 * math.pi)
        self.linear.weigh(value.body, value.torque / own.torque, turn)
        return ""

    def _joint_range(self, value: N.JointRange) -> str:
        """Range and solver settings of the driven joint, by direct numbers, which MuJoCo takes as they are at any timestep."""
        editor, joint = self.editor, self.editor.joint_of(0)
        if joint is None:
            return NOT_ONE_JOINT
        limit = on_joint(value.limit, editor.model, joint, editor.chain.bodies[0].inertia)
        most, span = limit.impedance[1], np.array([limit.lower, limit.upper])
        editor.set(
            "joint", joint, limited="true", range=row(list(np.degrees(span) if editor.degrees() else span)),
            solreflimit=row([-limit.stiffness * most**2, -limit.damping * most]), solimplimit=row(limit.impedance),
            margin="0" if editor.model.joint(joint).margin[0] else None,
        )  # fmt: skip
        return ""

    # ---- couplings --------------------------------------------------------------------------------------------------------

    def _slack(self, value: N.Slack) -> str:
        """The range of a slack joint where the coupling has one, else a dead band in place of its spring."""
        editor, slack = self.editor, self._slack_joint(value.coupling)
        if slack is None:
            if not self._dead_band(value.coupling, value.width):
                return "no one element carries its spring"
        else:
            chain, j = self.linear.target, value.coupling
            ends = [chain.total_ratio(i) for i in (j, j + 1)]
            lighter = min(b.inertia * (r / ends[1]) ** 2 for b, r in zip(chain.bodies[j : j + 2], ends, strict=True))
            limit_slack(editor, slack, value.width, lighter, chain.couplings[j].damping)
            self._release(slack)
        return self._gap_damper

    @property
    def _gap_damper(self) -> str:
        return (
            "" if self.law is BacklashLaw.UNGATED else "its gap is there, but its damper acts inside the gap too (law 'ungated')"
        )

    def _release(self, slack: str) -> None:
        """Switch off the equality that holds a slack joint."""
        model = self.editor.model
        for e in range(model.neq):
            if int(model.eq_type[e]) != mujoco.mjtEq.mjEQ_JOINT or int(model.eq_obj2id[e]) >= 0:
                continue
            if model.joint(int(model.eq_obj1id[e])).name == slack:
                self.editor.set("equality", model.equality(e).name, active="false")

    def _slack_joint(self, coupling: int) -> str | None:
        """A joint of the file that is nothing but slack of this coupling, open or held."""
        found, model = self.editor.found, self.editor.model
        for kind, joint, _ in found.gaps[coupling]:
            if kind == "joint":
                return str(model.joint(joint).name)
        along = found.chain.couplings[coupling].ratio * found.rows[coupling] - found.rows[coupling + 1]
        used = {p.element.id for p in (*sum(found.on_coupling, ()), *sum(found.on_body, ())) if p.element.kind == "joint"}
        for j in range(model.njnt):
            dof = int(model.jnt_dofadr[j])
            held = not np.any(found.layout.base[dof])
            if held and model.jnt_limited[j] and j not in used and abs(abs(float(along[dof])) - 1.0) < 1e-9:
                return str(model.joint(j).name)
        return None

    def _dead_band(self, coupling: int, width: float) -> bool:
        editor = self.editor
        parts = [p for p in editor.found.on_coupling[coupling] if p.element.stiffness[0]]
        if len(parts) != 1:
            return False
        spring, half = parts[0].element, 0.5 * width * abs(parts[0].scale)
        if spring.kind == "tendon":
            rest = 0.5 * float(np.sum(editor.model.tendon_lengthspring[spring.id]))
            editor.set("tendon", spring.name, springlength=row([rest - half, rest + half]))
            return True
        stiffness = editor.node("joint", spring.name).attributes.get("stiffness") or number(spring.stiffness[0])
        editor.set("joint", spring.name, stiffness="0")
        name = editor.fresh("tendon", f"{spring.name}_spring")
        editor.tendon(name, spring.row, chain=True, stiffness=stiffness, springlength=row([-half, half]))
        return True

    def _cubic_spring(self, value: N.CubicSpring) -> str:
        """The third coefficient of the spring's stiffness."""
        editor = self.editor
        parts = [p for p in editor.found.on_coupling[value.coupling] if p.element.stiffness[0]]
        if len(parts) != 1:
            return "no one element carries its spring"
        p = parts[0]
        kind, name = p.element.kind, p.element.name
        moved = next((n for k, n in editor.added if k == "tendon" and n.rstrip("_") == f"{name}_spring"), None)
        if moved is not None:
            kind, name = "tendon", moved
        now = editor.node(kind, name).attributes.get("stiffness")
        linear = float(now.split()[0]) if now else p.element.stiffness[0]
        editor.set(kind, name, stiffness=row([linear, 0.0, value.coefficient / p.scale**4]))
        return ""

    def _coupling_bristle(self, value: N.CouplingBristle) -> str:
        """A bristle on the element that carries the spring."""
        editor, parts = self.editor, self.editor.found.on_coupling[value.coupling]
        p = next((p for p in parts if p.element.stiffness[0]), parts[0])
        where, target = p.element.kind, p.element.name
        joint = editor.chain.couplings[value.coupling].joint
        if where == "actuator":
            target = editor.fresh("tendon", f"{joint}_across")
            where = "tendon"
            editor.tendon(target, p.element.row, chain=False)
        as_body = N.BodyBristle(value.coupling, value.level, value.stiffness)
        self._motors.bristle(value, as_body, (f"{joint}_hysteresis", where, target), abs(p.scale))
        return ""

    # ---- actuator and sensors ---------------------------------------------------------------------------------------------

    def _cogging(self, value: N.Cogging) -> str:
        return self._motors.cogging(value)

    def _drive_torque(self, value: N.DriveTorque) -> str:
        """A part of the actuator's bias, which `close` writes."""
        if self.editor.found.layout.drive.id < 0:
            return "" if value in self.held else "the model has no actuator for a constant torque"
        if value.torque and not can_be_general(self.editor):
            return STAYS
        self._torque += value.torque
        return ""

    def _drive_limit(self, value: N.DriveLimit) -> str:
        write_limit(self.editor, value.limit)
        return ""

    def _drive_lag(self, value: N.DriveLag) -> str:
        return write_lag(self.editor, self.linear.target.servo, value.time_constant) if value.time_constant > 0 else ""

    def _command_slew(self, value: N.CommandSlew) -> str:
        return write_slew(self.editor, self.linear.target.servo, value.limit)

    def _servo_integral(self, value: N.ServoIntegral) -> str:
        return write_integral(self.editor, self.linear.target.servo, value.gain)

    def _speed_line(self, value: N.SpeedLine) -> str:
        return write_line(self.editor, value.stall, value.no_load)

    def _drive_delay(self, value: N.DriveDelay) -> str:
        """In whole steps."""
        if value.delay > 0:
            self.editor.step(DELAY_STEP)
            self.editor.follow(lambda: self._delay("actuator", self.editor.found.layout.drive.name, value.delay))
        return ""

    def _sensor_delay(self, value: N.SensorDelay) -> str:
        """At the bound sensors."""
        editor, chain = self.editor, self.editor.chain
        known = {editor.model.sensor(s).name for s in range(editor.model.nsensor)}
        names = sorted({chain.velocity_sensor, chain.angle_sensor} & known)
        for name in names:
            editor.follow(lambda name=name: self._delay("sensor", name, value.delay, interp="linear"))  # type: ignore[misc]
        return "" if names else "the model has no sensor for it"

    def _delay(self, kind: str, name: str, delay: float, **more: str) -> None:
        samples = math.ceil(delay / self.editor.timestep - 1e-9) + 1
        self.editor.set(kind, name, delay=number(delay), nsample=str(samples), **more)


_WRITERS: Mapping[type, Callable[[NativeWriter, Any], str]] = {
    N.DryFriction: NativeWriter._dry_friction, N.ViscousDamping: NativeWriter._viscous_damping,
    N.SquareDrag: NativeWriter._square_drag, N.BodyBristle: NativeWriter._body_bristle,
    N.CouplingBristle: NativeWriter._coupling_bristle, N.Slack: NativeWriter._slack, N.CubicSpring: NativeWriter._cubic_spring,
    N.SplitBody: NativeWriter._split_body, N.LooseLink: NativeWriter._loose_link,
    N.Weight: NativeWriter._weight, N.GroundSpring: NativeWriter._ground_spring,
    N.JointRange: NativeWriter._joint_range, N.Cogging: NativeWriter._cogging, N.DriveTorque: NativeWriter._drive_torque,
    N.DriveLimit: NativeWriter._drive_limit, N.DriveLag: NativeWriter._drive_lag, N.DriveDelay: NativeWriter._drive_delay,
    N.CommandSlew: NativeWriter._command_slew, N.SpeedLine: NativeWriter._speed_line, N.SensorDelay: NativeWriter._sensor_delay,
    N.ServoIntegral: NativeWriter._servo_integral,
}  # fmt: skip
