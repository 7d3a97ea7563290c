"""Where the input and the measured outputs of a model stand in MuJoCo's arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco

from mjsim.errors import InputError
from mjsim.mjcf import custom
from mjsim.mjcf.drive_laws import law_of, refused_law
from mjsim.quantity import Motion
from mjsim.toml import lies_at, toml_at

__all__ = ["Channels", "find_channels"]

_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
_SENSED = {
    "velocity": mujoco.mjtSensor.mjSENS_JOINTVEL,
    "angle": mujoco.mjtSensor.mjSENS_JOINTPOS,
}


@dataclass(frozen=True)
class Channels:
    """Indices of the driven joint (qpos, dof), its actuator and its bound sensors.

    control: column of ctrl, width: number of its columns; velocity, angle: columns of sensordata, None where qvel and qpos are
    read; role: torque, or command of a servo. actuator, control: -1 of a model without actuators, whose input does nothing.
    """

    joint: str
    motion: Motion
    role: str
    actuator: int
    actuator_name: str
    control: int
    width: int
    position: int
    dof: int
    velocity: int | None
    angle: int | None
    velocity_id: int | None
    angle_id: int | None


def find_channels(model: mujoco.MjModel, path: Path, actuator: str | None = None) -> Channels:
    """The bound actuator (else the only one), its joint and the bound sensors (else joint sensors on it). Raises InputError."""
    bound = _bound(model, path)
    a = _actuator(model, path, actuator or bound.get("actuator"))
    joint = _driven(model, path, a)
    velocity = _sensor(model, bound.get("velocity_sensor"), "velocity", joint)
    angle = _sensor(model, bound.get("angle_sensor"), "angle", joint)
    law = law_of(model, a) if a >= 0 and refused_law(model, a) is None else None
    servo = law is not None and bool(law.of_length or law.of_speed)
    slide = int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_SLIDE
    return Channels(
        joint=model.joint(joint).name, motion=Motion.SLIDE if slide else Motion.HINGE, role="command" if servo else "torque",
        actuator=a, actuator_name=model.actuator(a).name if a >= 0 else "",
        control=int(model.actuator_ctrladr[a]) if a >= 0 else -1,
        width=int(sum(model.actuator_ctrlnum)), position=int(model.jnt_qposadr[joint]), dof=int(model.jnt_dofadr[joint]),
        velocity=None if velocity is None else int(model.sensor_adr[velocity]),
        angle=None if angle is None else int(model.sensor_adr[angle]), velocity_id=velocity, angle_id=angle,
    )  # fmt: skip


def _bound(model: mujoco.MjModel, path: Path) -> dict[str, str]:
    """Names that the file carries, and over them those of the ``[model]`` table beside it."""
    out: dict[str, str] = {}
    for t in range(model.ntext):
        if mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, t) == custom.NAME:
            start, size = int(model.text_adr[t]), int(model.text_size[t])
            out |= dict(custom.unpack(model.text_data[start : start + size - 1].decode(), path).bound)
    beside = path.with_suffix(".toml")
    if lies_at(beside):
        out |= toml_at(beside).get("model", {})
    return out


def _actuator(model: mujoco.MjModel, path: Path, wanted: str | None) -> int:
    inputs = [a for a in range(model.nactuator) if model.actuator_ctrlnum[a] > 0]
    if not wanted and not inputs:
        return -1
    chosen = [a for a in inputs if wanted is None or model.actuator(a).name == wanted]
    if len(chosen) != 1:
        names = ", ".join(model.actuator(a).name or f"#{a}" for a in inputs) or "none"
        raise InputError(path, f"{len(chosen)} actuators {wanted or ''}".rstrip(), f"one of: {names}", "bind one in [model]")
    return chosen[0]


def _driven(model: mujoco.MjModel, path: Path, a: int) -> int:
    """The joint whose angle the drive's is; of a model without actuators, the one that moves."""
    if a >= 0 and mujoco.mjtTrn(int(model.actuator_trntype[a])) in _JOINT:
        joint = int(model.actuator_trnid[a, 0])
        if int(model.jnt_type[joint]) in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            return joint
        raise InputError(path, f"joint {model.joint(joint).name!r} is neither hinge nor slide", "one of these", "bind another")
    from mjsim.mjcf import load_model

    return int(model.joint(load_model(path, actuator=model.actuator(a).name if a >= 0 else None).found.chain.bodies[0].joint).id)


def _sensor(model: mujoco.MjModel, wanted: str | None, what: str, joint: int) -> int | None:
    """The bound sensor, else the first joint sensor on the driven joint; None where there is none."""
    for s in range(model.nsensor):
        if model.sensor(s).name == (wanted or f"motor_{what}"):
            return s
    kind = _SENSED[what]
    of_joint = (s for s in range(model.nsensor) if int(model.sensor_type[s]) == kind and int(model.sensor_objid[s]) == joint)
    return next(of_joint, None)
