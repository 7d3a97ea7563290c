"""Side by side equals one by one, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from robot_axis import DT, axis, chirp, effect

from mjsim import accurate, ode, reference
from mjsim.batch import Drive, Engine, rollout
from mjsim.ode import DivergedError, Trajectory

AXES = [
    axis(effect("coulomb_friction", torque_Nm=level), effect("backlash", gap_rad=gap))
    for level in (0.05, 0.1)
    for gap in (1e-4, 5e-4)
]
DRIVES = [Drive(chirp(0.4, amplitude=a), DT) for a in (0.5, 1.0, 2.0)]
RUN = {Engine.ODE: ode.simulate, Engine.ACCURATE: accurate.simulate, Engine.REFERENCE: reference.simulate}


@pytest.mark.parametrize("engine", list(Engine))
def test_same_bits(engine: Engine) -> None:
    together = rollout(AXES, DRIVES, engine=engine, threads=3)
    for model, row in zip(AXES, together, strict=True):
        for drive, run in zip(DRIVES, row, strict=True):
            alone = RUN[engine](model, drive.torque, drive.dt)
            assert isinstance(run, Trajectory)
            assert np.array_equal(run.velocity, alone.velocity)
            assert np.array_equal(run.coupling_torque, alone.coupling_torque)


def test_a_run_that_diverges_is_given_back_as_such() -> None:
    wild = axis().with_linear({"fm": -1e3})
    (first, second) = rollout([wild, axis()], [DRIVES[0]])
    assert isinstance(first[0], DivergedError)
    assert isinstance(second[0], Trajectory)
