"""How many simulations a diagnosis may take, counted the same with any number of threads."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from mjsim.effects import effect_class
from mjsim.excitation import chirp
from mjsim.ode import simulate, work_done
from mjsim.recording import Recording

DT, N, NOISE = 1e-3, 4_000, 0.05
STICTION = {"torque_Nm": 0.06, "peak": 3.6}
PAIR = ("coulomb_friction", "static_friction", "stribeck_friction", "sensor_lag", "hysteresis")


def recorded(plant, seed: int, amplitude: float = 0.6) -> Recording:
    """A chirp of an axis that sticks at each reversal."""
    torque = chirp(N * DT, DT, amplitude, 0.5, 25.0)
    run = simulate(plant, torque, DT)
    rng = np.random.default_rng(seed)
    return Recording(
        run.time, torque, run.velocity + NOISE * rng.standard_normal(N), run.angle + 1e-4 * rng.standard_normal(N), DT
    )


@pytest.fixture(scope="module")
def plant(robot):
    """Static friction behind a sensor that lags: neither is seen for what it is without the other."""
    changed = robot.with_linear({p.name: 1.05 * p.value for p in robot.chain.linear_parameters() if p.name != "dg"})
    return changed + effect_class("static_friction")(**STICTION) + effect_class("sensor_lag")(time_constant_s=2e-3)


def test_a_run_is_counted_in_products_of_a_step(robot):
    """One a step where all is affine between events, four by RK4; the same each time."""
    torque = np.full(1001, 0.2)

    def took(axis) -> int:
        before = work_done()
        simulate(axis, torque, DT, substeps=2)
        return work_done() - before

    assert took(robot) == 2000
    smooth = robot + effect_class("quadratic_friction")(coefficient_Nm_s2_rad2=1e-6)
    assert took(smooth) == 4 * 2000
    sticking = robot + effect_class("static_friction")(**STICTION)
    assert took(sticking) == took(sticking) >= 2000


@pytest.fixture(scope="module")
def spent(robot, plant):
    """``spent(jobs)``: a diagnosis that spends its budget."""
    estimation, held_out = recorded(plant, 1), recorded(plant, 2, 0.5)
    few = Options(jobs=1, effects=PAIR, effort=0.02)
    return lambda jobs: diagnose(robot, [estimation], [held_out], dataclasses.replace(few, jobs=jobs))


@pytest.mark.slow
def test_a_search_that_has_spent_its_budget_says_so(spent):
    two = spent(2)
    assert two.verdict is Verdict.UNEXPLAINED
    assert any("--effort" in note for note in two.notes)


@pytest.mark.slow
def test_a_budget_is_spent_alike_by_any_number_of_threads(spent):
    one, two = spent(1), spent(2)
    assert [(f.effect, f.place) for f in one.findings] == [(f.effect, f.place) for f in two.findings]
    assert one.fit["corrected"].rms == two.fit["corrected"].rms
    assert one.rivals == two.rivals
