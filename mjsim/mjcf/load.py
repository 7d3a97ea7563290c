"""MJCF -> axis: parameters of the chain, and the effects that the file carries or expresses by its own elements."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mjsim.axis import Axis
from mjsim.chain import Chain
from mjsim.effects import BacklashLaw, Effect, PlaceError, registered
from mjsim.effects.native import ServoIntegral, Value
from mjsim.errors import InputError, nearest
from mjsim.mjcf import custom
from mjsim.mjcf.chain import Found, find_chain
from mjsim.mjcf.compile import compile_file
from mjsim.mjcf.layout import lay_out, outside
from mjsim.mjcf.native_read import read_native
from mjsim.recording import Binding
from mjsim.toml import lies_at, toml_at, toml_of

__all__ = ["Model", "carried_binding", "effect_of", "load_axis", "load_model"]


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

    def integral_force(self, states: Iterable[tuple[str, float]] = ()) -> float | None:
        """Force of the actuator at the first sample by integral action, with that of the servo's zero, which a ``<pid>`` lacks.

        [N m | N]; ``states``: as of `Axis.started`. None of a servo without integral action.
        """
        axis = self.axis.started(states)
        servo, values = axis.chain.servo, (v for e in axis.effects for v in e.native(axis.chain).values)
        found = next((v for v in values if isinstance(v, ServoIntegral)), None)
        return None if found is None or servo is None else found.start - servo.kp * servo.zero


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
    data = mujoco.MjData(model)  # for all of what follows: making one takes longer than its use
    layout = lay_out(model, data, path, actuator or bound.get("actuator"), carried.ignored if carried else ())
    found = find_chain(layout, path, (_sensor(model, path, bound, "velocity"), _sensor(model, path, bound, "angle")))
    _linear_only(found, path, carried)
    _ignored_only(model, path, carried)
    _no_contact(model, data, path)
    _at_rest(found, data, path)
    if carried is not None:
        axis = _carried_axis(found, carried, path)
    else:
        axis = Axis(found.chain, tuple(effect_of(v, found.chain, path) for v in read_native(found, path, data)), _law(found))
    return Model(path, found, axis, carried)


def carried_binding(model: Model, recording: Path) -> Binding | None:
    """The binding that a corrected model carries, when no TOML file stands beside the recording or the model."""
    if any(p.with_suffix(".toml").is_file() for p in (recording, model.path)) or not (model.carried and model.carried.binding):
        return None
    table = toml_of(model.carried.binding, f"{model.path}: its binding")  # of a file beside the model: its [model] was read there
    found = Binding.from_tables(table, model.path.with_suffix(".toml"))
    return None if found is None else dataclasses.replace(found, source=f"{model.path}: <custom> text {custom.NAME!r}")


def _carried_axis(found: Found, carried: custom.Carried, path: Path) -> Axis:
    try:
        axis = Axis(found.chain.with_linear(dict(carried.linear)), carried.effects, carried.law)
        for effect in axis.effects:
            effect.ports(axis.chain)
    except (KeyError, ValueError) as error:
        raise InputError(
            path, f"an effect it carries does not fit it ({error})", "places of this chain", "correct the text"
        ) from None
    return axis


def _bound(path: Path) -> dict[str, str]:
    """``[model]`` of the TOML beside the model."""
    beside = path.with_suffix(".toml")
    if not lies_at(beside):
        return {}
    table = toml_at(beside).get("model", {})
    known = ("actuator", "velocity_sensor", "angle_sensor")
    for key, value in table.items():
        if key not in known or not isinstance(value, str):
            raise InputError(f"{beside}: [model]", f"key {key!r} is not known", f"{', '.join(known)}, each a name",
                             nearest(key, set(known) - {key}, "rename it"))  # fmt: skip
    return dict(table)


def _sensor(model: mujoco.MjModel, path: Path, bound: Mapping[str, str], what: str) -> str:
    """The bound sensor, else the one with the default name, else the first of its kind, else the default name."""
    names = [model.sensor(s).name for s in range(model.nsensor)]
    wanted = bound.get(f"{what}_sensor")
    default = f"motor_{what}"
    if wanted is not None and wanted != default:
        if wanted not in names:
            raise InputError(path, f"no sensor {wanted!r}", f"one of: {', '.join(names) or 'none'}",
                             nearest(wanted, filter(None, names), "bind one that is there"))  # fmt: skip
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
            try:
                text = model.text_data[start : start + size - 1].decode()
            except UnicodeDecodeError:
                raise InputError(
                    path, f"the <text> {custom.NAME!r} is not UTF-8", "UTF-8", "use the file as simgap wrote it"
                ) from None
            return custom.unpack(text, path)
    return None


def _linear_only(found: Found, path: Path, carried: custom.Carried | None) -> None:
    """Polynomial coefficients that no effect stands for are outside (those of `read_native` are read there)."""
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


def _ignored_only(model: mujoco.MjModel, path: Path, carried: custom.Carried | None) -> None:
    """In a corrected file the actuators without input are those that the correction wrote."""
    if carried is None:
        return
    for a in range(model.nactuator):
        name = model.actuator(a).name
        if model.actuator_ctrlnum[a] == 0 and name not in carried.ignored:
            raise outside(path, f"actuator {name!r} acts by itself", "remove it")


def _no_contact(model: mujoco.MjModel, data: mujoco.MjData, path: Path) -> None:
    mujoco.mj_resetData(model, data)
    for turn in (0.0, 0.3, -0.3, 1.5, -1.5, 3.0):
        data.qpos[:] = model.qpos0
        for j in range(model.njnt):
            low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
            data.qpos[j] = min(max(model.qpos0[j] + turn, low), high)
        mujoco.mj_forward(model, data)
        if data.ncon:
            geoms = [model.geom(int(g)).name or f"number {g}" for g in data.contact[0].geom]
            raise outside(path, f"geoms {geoms[0]} and {geoms[1]} touch", 'set contype="0" conaffinity="0"')


def _at_rest(found: Found, data: mujoco.MjData, path: Path) -> None:
    """Springs of the chain must be at rest where the angles are zero, and no fluid may push."""
    model = found.layout.model
    springs = [p.element for ps in found.on_coupling for p in ps if p.element.stiffness[0]]
    spring, scale = np.zeros(model.nv), np.zeros(model.nv)
    for p in springs:
        stretch = float(p.row @ model.qpos0) - p.rest
        stretch -= min(max(stretch, -0.5 * p.gap), 0.5 * p.gap)
        spring += p.stiffness[0] * stretch * p.row
        scale += p.stiffness[0] * np.abs(p.row)
    if np.max(np.abs(found.layout.base.T @ spring)) > 1e-9 * max(1.0, float(np.max(scale))):
        raise outside(path, "a spring is loaded in the zero position", "let springref equal ref")
    mujoco.mj_resetData(model, data)
    data.qvel[:] = found.layout.base @ np.ones(found.layout.base.shape[1])
    mujoco.mj_forward(model, data)
    if np.any(data.qfrc_fluid):
        raise outside(path, "fluid drag acts", "set density and viscosity to zero")


def _law(found: Found) -> BacklashLaw:
    """A gap that MJCF expresses has its damper inside the gap too."""
    return BacklashLaw.UNGATED if any(found.gaps) else BacklashLaw.GATED


def effect_of(value: Value, chain: Chain, path: Path) -> Effect:
    """The effect that a native value stands for; raises InputError where that effect is not known at the place."""
    try:
        for cls in registered().values():
            effect = cls.read(value, chain)
            if effect is not None:
                return effect
    except PlaceError as error:
        name = error.effect.replace("_", " ")
        raise outside(path, f"{name} at {error.place!r}", f"it is known at {', '.join(error.places)}") from None
    raise outside(path, f"no effect stands for {value}", "leave it out")
