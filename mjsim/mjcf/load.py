"""MJCF -> axis: parameters of the chain, and the effects that the file carries or expresses by its own elements."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mjsim.axis import Axis
from mjsim.effects import BacklashLaw, Effect, effect_class
from mjsim.errors import InputError
from mjsim.mjcf import custom
from mjsim.mjcf.chain import Found, find_chain
from mjsim.mjcf.compile import compile_file
from mjsim.mjcf.layout import lay_out, outside
from mjsim.quantity import Motion
from mjsim.recording import Binding

__all__ = ["Model", "carried_binding", "load_axis", "load_model"]


@dataclass(frozen=True)
class Model:
    """A compiled MJCF, the chain found in it, and the axis they make. ``carried``: what its <custom> element says, or None."""

    path: Path
    found: Found
    axis: Axis
    carried: custom.Carried | None

    @property
    def mjmodel(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.found.layout.model


def load_axis(path: str | Path, *, actuator: str | None = None) -> Axis:
    """Read an MJCF file as an axis: chain parameters in SI and its effects.

    ``actuator`` names the driven one; else ``[model] actuator`` of the TOML beside the file, else its only actuator. Raises
    InputError when the file does not load or is no single-axis chain, saying what is outside and what still works.
    """
    return load_model(path, actuator=actuator).axis


def load_model(path: str | Path, *, actuator: str | None = None, bound: Mapping[str, str] | None = None) -> Model:
    """`load_axis`, together with the compiled model and where each number stands in it.

    ``bound`` takes the place of the ``[model]`` table beside the file.
    """
    path = Path(path)
    model = compile_file(path)
    carried = _carried(model, path)
    if bound is None:
        bound = {**(dict(carried.bound) if carried else {}), **_bound(path)}
    layout = lay_out(model, path, actuator or bound.get("actuator"), carried.ignored if carried else ())
    found = find_chain(layout, path, (_sensor(model, path, bound, "velocity"), _sensor(model, path, bound, "angle")))
    _linear_only(found, path, carried)
    _passive_actuators(model, path, carried)
    _no_contact(model, path)
    _at_rest(found, path, carried)
    if carried is not None:
        axis = _carried_axis(found, carried, path)
    else:
        axis = Axis(found.chain, tuple(_native_effects(found, path)), _law(found))
    return Model(path, found, axis, carried)


def carried_binding(model: Model, recording: Path) -> Binding | None:
    """The binding that a corrected model carries, when no TOML file stands beside the recording or the model."""
    if any(p.with_suffix(".toml").is_file() for p in (recording, model.path)) or not (model.carried and model.carried.binding):
        return None
    with tempfile.TemporaryDirectory() as work:
        at = Path(work) / model.path.with_suffix(".toml").name
        at.write_text(model.carried.binding, encoding="utf-8")
        found = Binding.from_toml(at)
    return None if found is None else dataclasses.replace(found, source=f"{model.path}: <custom> text {custom.NAME!r}")


def _carried_axis(found: Found, carried: custom.Carried, path: Path) -> Axis:
    try:
        axis = Axis(found.chain, carried.effects, carried.law)
        for effect in axis.effects:
            effect.ports(found.chain)
    except ValueError as error:
        raise InputError(
            path, f"an effect it carries does not fit it ({error})", "places of this chain", "correct the text"
        ) from None
    return axis


def _bound(path: Path) -> dict[str, str]:
    """``[model]`` of the TOML beside the model."""
    beside = path.with_suffix(".toml")
    if not beside.is_file():
        return {}
    try:
        table = tomllib.loads(beside.read_text(encoding="utf-8")).get("model", {})
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(beside, f"not valid TOML ({error})", "a TOML file", "correct it") from None
    known = ("actuator", "velocity_sensor", "angle_sensor")
    for key, value in table.items():
        if key not in known or not isinstance(value, str):
            raise InputError(f"{beside}: [model]", f"key {key!r} is not known", f"{', '.join(known)}, each a name", "rename it")
    return dict(table)


def _sensor(model: mujoco.MjModel, path: Path, bound: Mapping[str, str], what: str) -> str:
    """The bound sensor, else the one with the default name, else the first of its kind, else the default name."""
    names = [model.sensor(s).name for s in range(model.nsensor)]
    wanted = bound.get(f"{what}_sensor")
    default = f"motor_{what}"
    if wanted is not None and wanted != default:
        if wanted not in names:
            raise InputError(path, f"no sensor {wanted!r}", f"one of: {', '.join(names) or 'none'}", "bind one that is there")
        return wanted
    kinds = {
        "velocity": (mujoco.mjtSensor.mjSENS_JOINTVEL, mujoco.mjtSensor.mjSENS_ACTUATORVEL),
        "angle": (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_ACTUATORPOS),
    }[what]
    of_kind = [n for s, n in enumerate(names) if n and mujoco.mjtSensor(int(model.sensor_type[s])) in kinds]
    return default if default in names or not of_kind else of_kind[0]


def _carried(model: mujoco.MjModel, path: Path) -> custom.Carried | None:
    for t in range(model.ntext):
        if mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, t) == custom.NAME:
            start, size = int(model.text_adr[t]), int(model.text_size[t])
            return custom.unpack(model.text_data[start : start + size - 1].decode(), path)
    return None


def _linear_only(found: Found, path: Path, carried: custom.Carried | None) -> None:
    """Polynomial coefficients that no effect stands for are outside (those of `_native_effects` are read there)."""
    if carried is not None:
        return
    for j, parts in enumerate(found.on_coupling):
        for p in parts:
            if p.element.stiffness[1] or any(p.element.damping[1:]):
                raise outside(
                    path, f"{found.chain.couplings[j].joint!r} has a polynomial law beyond a cubic spring", "leave it out"
                )
    for i, parts in enumerate(found.on_body):
        for p in parts:
            if p.element.damping[2] or (p.element.damping[1] and i > 0):
                raise outside(
                    path,
                    f"{found.chain.bodies[i].joint!r} has a polynomial damping that is not v |v| at the motor",
                    "leave it out",
                )


def _passive_actuators(model: mujoco.MjModel, path: Path, carried: custom.Carried | None) -> None:
    for a in range(model.nactuator):
        name = model.actuator(a).name
        if model.actuator_ctrlnum[a] == 0 and (carried is None or name not in carried.ignored):
            raise outside(path, f"actuator {name!r} acts by itself", "remove it")


def _no_contact(model: mujoco.MjModel, path: Path) -> None:
    data = mujoco.MjData(model)
    for turn in (0.0, 0.3, -0.3, 1.5, -1.5, 3.0):
        data.qpos[:] = model.qpos0
        for j in range(model.njnt):
            low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
            data.qpos[j] = min(max(model.qpos0[j] + turn, low), high)
        mujoco.mj_forward(model, data)
        if data.ncon:
            geoms = [model.geom(int(g)).name or f"number {g}" for g in data.contact[0].geom]
            raise outside(path, f"geoms {geoms[0]} and {geoms[1]} touch", 'set contype="0" conaffinity="0"')


def _at_rest(found: Found, path: Path, carried: custom.Carried | None) -> None:
    """Springs must be at rest where the angles are zero, and nothing else may push (fluid, gravity compensation).

    In a corrected file gravity compensation stands for another weight.
    """
    model = found.layout.model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    spring = found.layout.base.T @ data.qfrc_spring
    scale = sum((np.abs(p.element.row) * abs(p.element.stiffness[0]) for ps in found.on_coupling for p in ps), np.zeros(model.nv))
    if np.max(np.abs(spring)) > 1e-9 * max(1.0, float(np.max(scale))):
        raise outside(path, "a spring is loaded in the zero position", "let springref equal ref")
    data.qvel[:] = found.layout.base @ np.ones(found.layout.base.shape[1])
    mujoco.mj_forward(model, data)
    if np.any(data.qfrc_fluid) or (np.any(data.qfrc_gravcomp) and carried is None):
        raise outside(path, "fluid drag or gravity compensation acts", "set density and viscosity to zero")


def _law(found: Found) -> BacklashLaw:
    """A gap that MJCF expresses has its damper inside the gap too."""
    return BacklashLaw.UNGATED if any(found.gaps) else BacklashLaw.GATED


def _make(path: Path, name: str, place: str, **values: float) -> Effect:
    cls = effect_class(name)
    if place not in cls.places:
        raise outside(path, f"{name.replace('_', ' ')} at {place!r}", f"it is known at {', '.join(cls.places)}")
    return cls(place=place, **values)


def _native_effects(found: Found, path: Path) -> list[Effect]:
    """Effects that the file expresses by its own elements."""
    out: list[Effect] = []
    chain, model, drive = found.chain, found.layout.model, found.layout.drive
    for i, parts in enumerate(found.on_body):
        level = sum(abs(p.scale) * p.element.friction for p in parts)
        if level:
            out.append(_make(path, "coulomb_friction", chain.bodies[i].place, torque_Nm=level))
        drag = sum(p.element.damping[1] * abs(p.scale) ** 3 for p in parts)
        if drag:
            out.append(_make(path, "quadratic_friction", chain.bodies[i].place, coefficient_Nm_s2_rad2=drag))
    for j, gaps in enumerate(found.gaps):
        width = sum(w for _, _, w in gaps)
        if width:
            out.append(_make(path, "backlash", chain.couplings[j].place, gap_rad=width))
        cubic = sum(p.element.stiffness[2] * p.scale**4 for p in found.on_coupling[j])
        if cubic:
            out.append(_make(path, "hardening_stiffness", chain.couplings[j].place, coefficient_Nm_rad3=cubic))
    limit = _limit(found, path)
    if limit is not None:
        out.append(_make(path, "actuator_saturation", "actuator", limit_Nm=limit))
    a = drive.id
    if model.actuator_delay[a] > 0:
        out.append(_make(path, "time_delay", "actuator", delay_s=float(model.actuator_delay[a])))
    dyntype = mujoco.mjtDyn(int(model.actuator_dyntype[a]))
    if dyntype in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT):
        out.append(_make(path, "actuator_lag", "actuator", time_constant_s=float(model.actuator_dynprm[a, 0])))
    elif dyntype != mujoco.mjtDyn.mjDYN_NONE:
        raise outside(path, f"actuator {drive.name!r} has dynamics other than a first-order filter", 'use dyntype="filter"')
    bias = 0.0
    if int(model.actuator_biastype[a]) == mujoco.mjtBias.mjBIAS_AFFINE:
        bias = float(model.actuator_biasprm[a, 0]) * chain.gain / drive.gain
    return [*out, *_gravity(found, path, bias)]


def _limit(found: Found, path: Path) -> float | None:
    """Smallest symmetric limit of the input [unit of the input]."""
    model, drive = found.layout.model, found.layout.drive
    a = drive.id
    ranges = []
    if model.actuator_ctrllimited[a]:
        ranges.append(("ctrlrange", model.actuator_ctrlrange[a], 1.0))
    if model.actuator_forcelimited[a]:
        ranges.append(("forcerange", model.actuator_forcerange[a], abs(drive.gain)))
    for name, (low, high), _ in ranges:
        if abs(low + high) > 1e-9 * abs(high - low):
            raise outside(path, f"{name} of actuator {drive.name!r} is {low:g} .. {high:g}", "a range symmetric about zero")
    return min((float(r[1]) / scale for _, r, scale in ranges), default=None)


def _gravity(found: Found, path: Path, bias: float) -> list[Effect]:
    """Constant torque at the motor and the weight on the last body, from the actuator's bias and MuJoCo's gravity."""
    model, n = found.layout.model, len(found.chain.bodies)
    data = mujoco.MjData(model)
    to_q = found.base()
    samples = 16
    force = np.zeros((samples, n))
    angle = 2 * math.pi * np.arange(samples) / samples
    rigid = np.array([found.chain.total_ratio(i) for i in range(n)]) / found.chain.total_ratio(n - 1)
    for k in range(samples):
        data.qpos[:] = model.qpos0 + to_q @ rigid * angle[k]
        mujoco.mj_forward(model, data)
        force[k] = -to_q.T @ data.qfrc_bias
    mean = force.mean(axis=0)
    small = 1e-9 * max(1.0, float(np.sum(model.body_mass)) * float(np.linalg.norm(model.opt.gravity)))
    sine, cosine = 2 * np.sin(angle) @ force / samples, 2 * np.cos(angle) @ force / samples
    rest = force - mean - np.outer(np.sin(angle), sine) - np.outer(np.cos(angle), cosine)
    if np.max(np.abs(rest)) > small * 1e3 or np.any(np.hypot(sine, cosine)[:-1] > small) or np.any(np.abs(mean[1:]) > small):
        raise outside(path, "gravity loads more than the last body of the chain", "balance it, or switch gravity off")
    out = []
    offset = bias + (float(mean[0]) if abs(mean[0]) > small else 0.0)
    if offset:
        out.append(_make(path, "torque_offset", "motor", torque_Nm=offset))
    # force = -T sin(angle + phase) = -T cos(phase) sin(angle) - T sin(phase) cos(angle)
    weight = float(np.hypot(sine[-1], cosine[-1]))
    if weight > small:
        if found.chain.motion is not Motion.HINGE:
            raise outside(path, "gravity varies along a slide", "keep the slide straight")
        phase = math.atan2(-float(cosine[-1]), -float(sine[-1]))
        out.append(_make(path, "gravity_load", "arm", torque_Nm=weight, phase_rad=phase))
    return out
