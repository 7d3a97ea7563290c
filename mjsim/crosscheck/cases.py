"""What is cross-checked: every registered effect at every place, and a study's levels, gaps and peaks, each with its limits."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from mjsim import ode
from mjsim.axis import Axis
from mjsim.effects import NotApplicableError, Scales, registered
from mjsim.effects.backlash import Backlash
from mjsim.effects.coulomb_friction import CoulombFriction
from mjsim.effects.ports import JointLimit
from mjsim.effects.static_friction import StaticFriction
from mjsim.mjcf.native_write import FRICTION_STEP
from mjsim.ode import Trajectory
from mjsim.system import assemble

__all__ = ["DT", "Case", "effect_cases", "scales_at", "study_cases"]

DT = 5e-4
LITERAL = 2e-3  # what plain MuJoCo's soft friction and limits reach at the steps that the writer of the file chooses
KERNEL = 2e-5  # the kernel at its own choice of step


@dataclass(frozen=True)
class Case:
    """An axis to run, and the limits of each engine, relative RMS of motor velocity.

    ``literal_step``: timestep of plain MuJoCo [s], the file's when None; ``drive``: factor on the chirp's amplitude.
    """

    name: str
    axis: Axis
    accurate: float
    literal: float | None = LITERAL
    literal_step: float | None = None
    kernel: float = KERNEL
    drive: float = 1.0


def scales_at(axis: Axis, run: Trajectory, place: str) -> Scales:
    """Typical sizes at a place from a run of the axis without effects."""
    chain, dt = axis.chain, float(run.time[1] - run.time[0])
    body = chain.body(place)
    body = 0 if body is None else body
    coupling = chain.coupling(place)
    torque = run.torque * chain.gain if coupling is None else run.coupling_torque[:, coupling]
    deflection, stiffness = 0.0, chain.couplings[0].stiffness if chain.couplings else 0.0
    if coupling is not None:
        c = chain.couplings[coupling]
        deflection = float(np.std(c.ratio * run.q[:, coupling] - run.q[:, coupling + 1]))
        stiffness = c.stiffness
    v, travel = run.v[:, body], float(np.ptp(run.q[:, body]))
    turned = max(float(np.ptp(run.q[:, 0])), 1e-12)  # spatial laws of the gear run over the motor's angle
    u = run.torque
    reach = float(np.max(np.abs(run.q[:, 0] - run.q[0, 0])))

    def rms(a: np.ndarray) -> float:
        return float(np.sqrt(np.mean(a**2)))

    return Scales(
        torque=rms(torque), max_torque=float(np.max(np.abs(torque))), velocity=rms(v), max_velocity=float(np.max(np.abs(v))),
        deflection=deflection, inertia=chain.bodies[body].inertia, stiffness=stiffness, travel=travel, input=rms(u),
        max_input=float(np.max(np.abs(u))), output=rms(run.velocity), dt=dt, duration=float(run.time[-1]),
        orders=(2 * math.pi * 3 / turned,), acceleration=float(np.max(np.abs(np.gradient(v, dt)))),
        stops=tuple((side, float(run.q[0, 0]) + 0.5 * side * reach, 0.02) for side in (-1, 1)),
    )  # fmt: skip


def effect_cases(
    axis: Axis, u: np.ndarray, dt: float = DT, names: Collection[str] | None = None
) -> tuple[list[Case], list[tuple[str, str]]]:
    """One case for every registered effect at every place, at the first start of a fit; and what the chain has no place for.

    ``u``: torque (N) [N m], sampled every ``dt`` [s]; ``names``: of the effects that are wanted, all where None is given.
    The input is mirrored where the effect changes nothing as it is, as a stop that the motion goes away from.
    """
    bare = Axis(axis.chain, (), axis.backlash_law)
    run = ode.simulate(bare, u, dt)
    cases, skipped = [], []
    for name, cls in registered().items():
        if names is not None and name not in names:
            continue
        for place in cls.places:
            try:
                cls(place=place, **dict.fromkeys((x.name for x in cls.specs()), 1.0)).ports(axis.chain)
            except NotApplicableError as error:
                skipped.append((f"{name}@{place}", str(error)))
                continue
            except ValueError:
                pass  # the values of the trial, not the place
            values = cls.starts(scales_at(bare, run, place))[0]
            try:
                effect = cls(place=place, **values)
                system = assemble(bare + effect)
            except ValueError as error:
                skipped.append((f"{name}@{place}", str(error)))
                continue
            change = np.max(np.abs(ode.simulate(system, u, dt).velocity - run.velocity))
            felt = change > KERNEL * np.max(np.abs(run.velocity))
            limits = {"accurate": effect.tolerance, "kernel": max(KERNEL, effect.tolerance)}
            # no timestep is written with a limit: the author's may be too long for an impact
            step = FRICTION_STEP if any(isinstance(port, JointLimit) for port in effect.ports(axis.chain)) else None
            cases.append(Case(effect.key, bare + effect, **limits, literal_step=step, drive=1.0 if felt else -1.0))
    return cases, skipped


def study_cases(axis: Axis) -> list[Case]:
    """The study's levels, gaps, peaks and their combinations on the robot axis, with the limits asked of them."""
    out = [Case("linear", axis, 1e-5, literal=1e-5)]
    for level, limit in ((0.0355, 5e-4), (0.1, 5e-4), (0.355, 1e-3)):
        out.append(Case(f"Fc {level}", axis + CoulombFriction(torque_Nm=level), 2e-5, limit, 5e-5))
    out += [Case(f"Fc 0.1 peak {p:g}", axis + StaticFriction(torque_Nm=0.1, peak=p), 2e-5) for p in (2.0, 5.0)]
    out += [Case(f"gap {g:g}", axis + Backlash(gap_rad=g), 2e-5, literal=1e-3) for g in (1e-4, 5e-4, 1e-3)]
    for gap, level in ((5e-4, 0.1), (1e-3, 0.355)):
        both = axis + Backlash(gap_rad=gap)
        out.append(Case(f"gap {gap:g} + Fc {level}", both + CoulombFriction(torque_Nm=level), 2e-5, None))
        for peak in (2.0, 5.0):
            name = f"gap {gap:g} + Fc {level} peak {peak:g}"
            # a torque below the breakaway level would compare standstill with standstill
            drive = max(1.0, math.ceil(1.1 * level * peak))
            if drive > 1:
                name += f", {drive:g} Nm"
            out.append(Case(name, both + StaticFriction(torque_Nm=level, peak=peak), 2e-5, None, drive=drive))
    return out
