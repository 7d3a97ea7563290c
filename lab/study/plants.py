"""What is simulated: the report's cases as data, each with its line in the figures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from mjsim.effects.backlash import Backlash
from mjsim.effects.coulomb_friction import CoulombFriction
from mjsim.effects.static_friction import StaticFriction

if TYPE_CHECKING:
    import numpy as np

    from mjsim.axis import Axis

__all__ = ["FEATURE_NAMES", "PLANTS", "Plant", "build", "nominal", "response"]

FEATURE_NAMES = ("first_notch", "first_peak", "second_notch", "second_peak")


@dataclass(frozen=True)
class Plant:
    """A case: effects laid on the nominal axis as (id, ((parameter, value), ...)), and the share of the torque that it gets."""

    id: str
    label: str
    effects: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()
    linear: tuple[tuple[str, float], ...] = ()
    torque_share: float = 1.0


def _coulomb(torque: float) -> tuple[tuple[str, tuple[tuple[str, float], ...]], ...]:
    return ((CoulombFriction.id, (("torque_Nm", torque),)),)


def _static(peak: float) -> tuple[tuple[str, tuple[tuple[str, float], ...]], ...]:
    return ((StaticFriction.id, (("torque_Nm", 0.1), ("peak", peak))),)


def _gap(gap: float) -> tuple[tuple[str, tuple[tuple[str, float], ...]], ...]:
    return ((Backlash.id, (("gap_rad", gap),)),)


_ALL = (
    Plant("linear", "linear model"),
    Plant("damping_positive", "linear model, $d_g = +62$", linear=(("dg", 62.0),)),
    Plant("coulomb_1", "case 1: 0.0355 Nm", _coulomb(0.0355)),
    Plant("coulomb_2", "case 2: 0.1 Nm", _coulomb(0.1)),
    Plant("coulomb_3", "case 3: 0.355 Nm", _coulomb(0.355)),
    Plant("static_2", "case 2, peak = 2", _static(2.0)),
    Plant("static_5", "case 2, peak = 5", _static(5.0)),
    Plant("gap_1", "b = 0.0001 rad", _gap(1e-4)),
    Plant("gap_2", "b = 0.0002 rad", _gap(2e-4)),
    Plant("gap_5", "b = 0.0005 rad", _gap(5e-4)),
    Plant("gap_10", "b = 0.001 rad", _gap(1e-3)),
    Plant("torque_50", "b = 0.0001 rad, 50 % torque", _gap(1e-4), torque_share=0.5),
    Plant("torque_20", "b = 0.0001 rad, 20 % torque", _gap(1e-4), torque_share=0.2),
)
PLANTS: dict[str, Plant] = {p.id: p for p in _ALL}
"""The report's cases by name; ``coulomb_2`` is also static friction with peak 1, ``gap_1`` also 100 % torque."""


@cache
def nominal() -> Axis:
    """The published linear model, read from its MJCF."""
    from mjsim.mjcf import load_axis
    from mjsim.models import shipped_model

    return load_axis(shipped_model("robot_axis1"))


def build(plant: Plant) -> Axis:
    """The axis of a case."""
    from mjsim.effects import effect_class

    axis = nominal().with_linear(dict(plant.linear)) if plant.linear else nominal()
    for name, parameters in plant.effects:
        axis = axis + effect_class(name)(**dict(parameters))  # type: ignore[arg-type]
    return axis


def response(axis: Axis, frequency_hz: np.ndarray) -> np.ndarray:
    """Velocity of body 0 over torque of the linear part, from the physics, complex (K,) [rad/s/Nm]; K frequencies [Hz]."""
    import numpy as np

    from mjsim.system import assemble, state_matrix

    f = assemble(axis).f
    a = state_matrix(f)
    n = f.shape[1]
    b = np.zeros(2 * n)
    b[n] = 1.0 / f[0, 0]
    s = 2j * np.pi * np.asarray(frequency_hz, float)
    matrix = s[:, None, None] * np.eye(2 * n) - a
    return np.asarray(np.linalg.solve(matrix, np.broadcast_to(b.astype(complex), (s.size, 2 * n))[..., None])[:, n, 0])
