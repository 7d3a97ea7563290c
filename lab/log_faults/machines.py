"""Three machines: the shipped three-mass axis, a pendulum, and a geared hinge with gravity; nominal models and perturbed
truths."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjsim.axis import Axis, Body, Chain
from mjsim.effects.coulomb_friction import CoulombFriction
from mjsim.effects.gravity_load import GravityLoad
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model

__all__ = ["MACHINES", "Plant", "perturbed"]

OFF = 0.2  # largest relative error of a parameter


@dataclass(frozen=True)
class Plant:
    """A nominal axis; rms of the torque and band [Hz] of its experiments."""

    name: str
    nominal: Axis
    torque: float
    low: float
    high: float


def _pendulum() -> Plant:
    chain = Chain((Body("motor", 0.18, 0.08, "pivot"),), ())
    effects = (
        CoulombFriction(place="motor", torque_Nm=0.1),
        GravityLoad(place="arm", torque_Nm=4.0, phase_rad=0.0),
    )
    return Plant("pendulum", Axis(chain, effects), 1.8, 0.3, 8.0)


def _hinge() -> Plant:
    chain = Chain((Body("motor", 1.4, 2.5, "shoulder"),), (), gain=20.0)
    effects = (
        CoulombFriction(place="motor", torque_Nm=1.5),
        GravityLoad(place="arm", torque_Nm=12.0, phase_rad=0.6),
    )
    return Plant("geared hinge", Axis(chain, effects), 1.0, 0.3, 10.0)


def MACHINES() -> tuple[Plant, ...]:
    """The three machines."""
    axis = load_axis(shipped_model("robot_axis1"))
    return Plant("three-mass axis", axis, 0.7, 0.5, 40.0), _pendulum(), _hinge()


def perturbed(plant: Plant, rng: np.random.Generator) -> Axis:
    """The nominal axis with every inertia, stiffness, friction and weight off by up to 20 %."""
    axis = plant.nominal
    values = {p.name: p.value * math.exp(rng.uniform(-1, 1) * math.log(1 + OFF)) for p in axis.chain.linear_parameters()}
    for effect in axis.effects:
        factor = math.exp(rng.uniform(-1, 1) * math.log(1 + OFF))
        values[f"{effect.key}.torque_Nm"] = factor * effect.values["torque_Nm"]
    return axis.with_values(values)
