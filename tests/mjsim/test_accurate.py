"""MuJoCo landing on events against the exact reference, and its twin model."""

from __future__ import annotations

import numpy as np
import pytest
from robot_axis import CHAIN, DT, axis, chirp, effect, relative

from mjsim import accurate, reference
from mjsim.effects import BacklashLaw
from mjsim.ode import DivergedError
from mjsim.system import assemble

CASES = {
    "linear": [],
    "coulomb 0.355": [("coulomb_friction", {"torque_Nm": 0.355})],
    "peak 5": [("static_friction", {"torque_Nm": 0.1, "peak": 5.0})],
    "gap 1e-3": [("backlash", {"gap_rad": 1e-3})],
    "gap and peak": [("backlash", {"gap_rad": 1e-3}), ("static_friction", {"torque_Nm": 0.355, "peak": 2.0})],
    "gearbox friction": [("coulomb_friction", {"torque_Nm": 5.0, "place": "gearbox"})],
    "lag": [("actuator_lag", {"time_constant_s": 2e-3}), ("coulomb_friction", {"torque_Nm": 0.1})],
}


@pytest.mark.parametrize("name", CASES)
def test_lands_on_the_reference(name: str) -> None:
    model = axis(*(effect(k, **v) for k, v in CASES[name]))  # type: ignore[arg-type]
    u = chirp(1.5)
    exact = reference.simulate(model, u, DT)
    run = accurate.simulate(model, u, DT)
    assert relative(run.velocity, exact.velocity) < 2e-5
    assert relative(run.coupling_torque[:, 0], exact.coupling_torque[:, 0]) < 2e-5


@pytest.mark.parametrize("law", list(BacklashLaw))
def test_each_backlash_law(law: BacklashLaw) -> None:
    model = axis(effect("backlash", gap_rad=5e-4), law=law)
    u = chirp(1.5)
    assert relative(accurate.simulate(model, u, DT).velocity, reference.simulate(model, u, DT).velocity) < 2e-5


def test_scaling_law() -> None:
    u = chirp(1.5)
    big, small = (axis(effect("backlash", gap_rad=g)) for g in (5e-4, 1e-4))
    assert relative(5 * accurate.simulate(small, 0.2 * u, DT).velocity, accurate.simulate(big, u, DT).velocity) < 1e-9


def test_rests_are_exact() -> None:
    run = accurate.simulate(axis(effect("static_friction", torque_Nm=0.1, peak=5.0)), chirp(2.0), DT)
    still = run.v[:, 0] == 0.0
    assert still.sum() > 100
    assert np.all(np.diff(run.q[:, 0])[still[:-1] & still[1:]] == 0.0)


def test_the_native_model_has_the_masses_of_the_chain() -> None:
    mine = accurate.native_model(assemble(axis()))
    np.testing.assert_allclose(mine.model.dof_M0, [b.inertia for b in CHAIN.bodies], rtol=1e-14)
    mine.timestep[0] = 1.25e-4
    assert mine.model.opt.timestep == 1.25e-4


def test_divergence_is_named(tmp_path: object) -> None:
    with pytest.raises(DivergedError, match=r"diverged at .* s, body 'motor'"):
        accurate.simulate(axis().with_linear({"fm": -1e3}), chirp(1.0), DT)
