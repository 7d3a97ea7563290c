"""Settings of a simulator that act like physics: how soft its dry friction and limits are, its timestep, its integrator.

Each setting has a mended form that is as near to the continuous law as MuJoCo comes: the same form as `write_corrected` writes.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.mjcf.custom import Edit

__all__ = ["SETTINGS", "Setting", "altered", "mended"]

FRICTION_STEP = 1e-4  # largest timestep at which stiff friction meets the law to 1e-3 (docs/decisions/mjcf.md)
LIMIT_STEP = 5e-5  # the same for stiff limits
FINER = 2.0  # times the timestep, with RK4: an error of fourth order is a sixteenth, of first order gone
IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)


@dataclass(frozen=True)
class Setting:
    """A setting: its identifier, what it does in plain words, which physics its error looks like."""

    id: str
    sentence: str


SETTINGS = (
    Setting(
        "soft_friction",
        "The simulator's dry friction is soft: it creeps where the joint should stick, and yields late (solreffriction, "
        "solimpfriction).",
    ),
    Setting("soft_limit", "The simulator's joint limit is soft: it gives way and rebounds (solreflimit, solimplimit)."),
    Setting("coarse_timestep", "The simulator's timestep or integrator is coarse for this motion: its error acts like damping."),
)


def mended(model: mujoco.MjModel, setting: str) -> tuple[mujoco.MjModel, list[Edit]] | None:
    """A copy of a model with one setting mended, and the edits that do it in its file; None where the model has no such thing."""
    m = copy.copy(model)
    edits: list[Edit]
    match setting:
        case "soft_friction":
            _finer(m, FRICTION_STEP)
            edits = _friction(m, list(_frictions(m)))
        case "soft_limit":
            _finer(m, LIMIT_STEP)
            edits = _limits(m, [(j, m.joint(j).name) for j in range(m.njnt) if m.jnt_limited[j]])
        case "coarse_timestep":
            m.opt.timestep /= FINER
            m.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
            edits = [("option", "", "integrator", "RK4")]
        case _:
            raise KeyError(f"no setting {setting!r}; choose from {', '.join(s.id for s in SETTINGS)}")
    if not edits:
        return None
    if m.opt.timestep != model.opt.timestep:
        edits.append(("option", "", "timestep", f"{float(f'{m.opt.timestep:.12g}')!r}"))
    return m, edits


def altered(model: mujoco.MjModel, other: mujoco.MjModel, setting: str) -> bool:
    """Whether two models of the same elements differ in a setting: in the impedances of friction or limits, or in how they step.

    The stiffness of a limit may be a number of the model, and is not compared.
    """
    match setting:
        case "soft_friction":
            pairs = [(model.dof_solimp, other.dof_solimp), (model.tendon_solimp_fri, other.tendon_solimp_fri)]
        case "soft_limit":
            pairs = [(model.jnt_solimp, other.jnt_solimp)]
        case _:
            return bool(model.opt.timestep != other.opt.timestep or model.opt.integrator != other.opt.integrator)
    return not all(np.array_equal(a, b) for a, b in pairs)


def _finer(m: mujoco.MjModel, largest: float) -> None:
    m.opt.timestep /= max(1, math.ceil(m.opt.timestep / largest - 1e-9))


def _frictions(m: mujoco.MjModel) -> Iterator[tuple[str, int, str]]:
    """Joints (by degree of freedom) and tendons with dry friction: kind, index, name."""
    for dof in np.flatnonzero(m.dof_frictionloss):
        yield "joint", int(dof), m.joint(int(m.dof_jntid[dof])).name
    for t in np.flatnonzero(m.tendon_frictionloss):
        yield "tendon", int(t), m.tendon(int(t)).name


def _friction(m: mujoco.MjModel, found: Sequence[tuple[str, int, str]]) -> list[Edit]:
    runge_kutta = int(m.opt.integrator) == mujoco.mjtIntegrator.mjINT_RK4
    rate = float(f"{(2.5 if runge_kutta else 1.0) / m.opt.timestep:.6g}")
    edits: list[Edit] = []
    for kind, index, name in found:
        solref, solimp = (m.dof_solref, m.dof_solimp) if kind == "joint" else (m.tendon_solref_fri, m.tendon_solimp_fri)
        solref[index], solimp[index] = (-1.0, -rate), IMPEDANCE
        edits += [(kind, name, "solreffriction", f"-1 {-rate:g}"), (kind, name, "solimpfriction", _row(IMPEDANCE))]
    return edits


def _limits(m: mujoco.MjModel, found: Sequence[tuple[int, str]]) -> list[Edit]:
    h = m.opt.timestep
    stiff = tuple(float(f"{x:.6g}") for x in (-1.0 / h**2, -2.0 / h))
    edits: list[Edit] = []
    for joint, name in found:
        m.jnt_solref[joint], m.jnt_solimp[joint] = stiff, IMPEDANCE
        edits += [("joint", name, "solreflimit", _row(stiff)), ("joint", name, "solimplimit", _row(IMPEDANCE))]
    return edits


def _row(values: Sequence[float]) -> str:
    return " ".join(f"{v:.6g}" for v in values)
