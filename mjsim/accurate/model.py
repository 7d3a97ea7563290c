"""The axis as MuJoCo steps it: its MJCF, the compiled model, and where MuJoCo's functions and its timestep stand in memory."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from mjsim.quantity import Motion
from mjsim.system import System

__all__ = ["NativeModel", "native_model", "native_xml"]


def native_xml(system: System) -> str:
    """The axis as MJCF in absolute coordinates: bodies side by side, couplings as fixed tendons; no effects."""
    chain = system.chain
    joint = "hinge" if chain.motion is Motion.HINGE else "slide"
    bodies, tendons, limit = [], [], system.limit
    limited, constraint = "", ' constraint="disable"'
    if limit is not None:
        most = max(limit.impedance[:2])
        solimp = " ".join(map(repr, limit.impedance))
        limited = f' limited="true" range="{limit.lower!r} {limit.upper!r}" solimplimit="{solimp}"'
        limited += f' solreflimit="{-limit.stiffness * most**2!r} {-limit.damping * most!r}"'
        constraint = ""
    for i, b in enumerate(chain.bodies):
        size = f'mass="1" diaginertia="{b.inertia!r} {b.inertia!r} {b.inertia!r}"'
        if chain.motion is Motion.SLIDE:
            size = f'mass="{b.inertia!r}" diaginertia="1 1 1"'
        more = "" if i else limited
        bodies.append(
            f'    <body name="b{i}"><joint name="j{i}" type="{joint}" axis="0 0 1" damping="{b.viscous!r}"{more}/>'
            f'<inertial pos="0 0 0" {size}/></body>'
        )
    for j, c in enumerate(chain.couplings):
        tendons.append(
            f'    <fixed name="t{j}" stiffness="{c.stiffness!r}" damping="{c.damping!r}" springlength="0">'
            f'<joint joint="j{j}" coef="{c.ratio!r}"/><joint joint="j{j + 1}" coef="-1"/></fixed>'
        )
    return "\n".join(
        [
            '<mujoco model="axis">',
            '  <compiler angle="radian" boundmass="0" boundinertia="0" balanceinertia="false"/>',
            '  <option integrator="RK4" gravity="0 0 0" jacobian="dense">',
            f'    <flag contact="disable"{constraint} autoreset="disable"/>',
            "  </option>",
            "  <worldbody>",
            *bodies,
            "  </worldbody>",
            "  <tendon>" if tendons else "",
            *tendons,
            "  </tendon>" if tendons else "",
            f'  <actuator><motor name="u" joint="j0" gear="{chain.gain!r}"/></actuator>',
            "</mujoco>",
        ]
    )


@dataclass(frozen=True)
class NativeModel:
    """A compiled axis, its data, and views into the fields that a run switches or reads."""

    model: mujoco.MjModel
    data: mujoco.MjData
    timestep: np.ndarray
    tendon: np.ndarray
    step: int
    forward: int


def native_model(system: System) -> NativeModel:
    """Compile an axis. Every run owns one, so runs do not share state."""
    model = mujoco.MjModel.from_xml_string(native_xml(system))
    data = mujoco.MjData(model)
    nominal = np.zeros((2, max(1, model.ntendon)))
    nominal[0, : model.ntendon], nominal[1, : model.ntendon] = model.tendon_stiffness, model.tendon_damping
    step, forward = _entry_points()
    return NativeModel(model, data, _timestep(model), nominal, step, forward)


@cache
def _entry_points() -> tuple[int, int]:
    """Addresses of mj_step and mj_forward in the library that the bindings have loaded."""
    folder = Path(mujoco.__file__).parent
    found = [p for pattern in ("libmujoco*.so*", "libmujoco*.dylib", "mujoco.dll") for p in sorted(folder.glob(pattern))]
    if not found:
        raise ImportError(f"no MuJoCo library in {folder}; install mujoco anew")
    library = ctypes.CDLL(str(found[0]))
    addresses = [ctypes.cast(getattr(library, name), ctypes.c_void_p).value for name in ("mj_step", "mj_forward")]
    assert addresses[0] is not None
    assert addresses[1] is not None
    return addresses[0], addresses[1]


@cache
def _timestep_offset() -> int:
    """Bytes from the start of an mjModel to opt.timestep, looked for by value: no layout of a version is assumed."""
    model = mujoco.MjModel.from_xml_string('<mujoco><option timestep="0.123456789"/></mujoco>')
    raw = (ctypes.c_double * 512).from_address(model._address)  # the sizes and mjOption stand at the head of the struct
    for i, first in enumerate(list(raw)):
        if first == 0.123456789:
            model.opt.timestep = 0.25
            if raw[i] == 0.25:
                return 8 * i
            model.opt.timestep = 0.123456789
    raise ImportError(f"opt.timestep is not where it is expected in mujoco {mujoco.__version__}; simgap needs 4.0")


def _timestep(model: mujoco.MjModel) -> np.ndarray:
    """A view of opt.timestep, which the bindings give as a number only."""
    return np.ctypeslib.as_array((ctypes.c_double * 1).from_address(model._address + _timestep_offset()))
