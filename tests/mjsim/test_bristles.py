"""Stiff bristles: a step is cut only where one holds or turns, and the motion is that of steps that are cut everywhere."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from robot_axis import effect

from mjsim.excitation import Grid, chirp, multisine
from mjsim.ode import simulate, work_done
from mjsim.system import STEP, assemble

DT, N = 5e-4, 8_000
LEVEL = {"torque_Nm": 0.1}
STRIBECK = {**LEVEL, "extra_static_torque_Nm": 0.1, "stribeck_velocity_rad_s": 0.6, "damping_Nms_rad": 0.05}
VALUES = {"presliding_friction": LEVEL, "stribeck_friction_with_bristles": STRIBECK}
INPUTS = {
    "chirp": chirp(N * DT, DT, 1.5, 1.0, 30.0),
    "multisine": multisine(np.random.default_rng(1), N * DT, DT, 0.8, 0.25, 30.0, period=N * DT, grid=Grid.FULL),
}


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


QUICK = {
    ("presliding_friction", 300.0, "multisine"), ("presliding_friction", 1.2e4, "chirp"),
    ("stribeck_friction_with_bristles", 300.0, "chirp"), ("stribeck_friction_with_bristles", 3e3, "multisine"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "stiffness", "drive"),
    [
        pytest.param(*case, marks=() if case in QUICK else pytest.mark.slow)
        for case in itertools.product(VALUES, (300.0, 3e3, 1.2e4), INPUTS)
    ],
)
def test_stiff_bristles_cost_steps_only_where_they_hold(robot, name, stiffness, drive):
    axis, torque = robot + effect(name, **VALUES[name], stiffness_Nm_rad=stiffness), INPUTS[drive]
    system = assemble(axis)
    n, parts = system.steps(DT, 0.0)
    assert n == 1
    assert parts == system.substeps(DT, 0.0) > 3
    fine = simulate(axis, torque, DT, substeps=min(8 * parts, 64)).velocity
    before = work_done()
    everywhere = simulate(axis, torque, DT, substeps=parts).velocity
    between = work_done()
    here = simulate(axis, torque, DT).velocity
    assert work_done() - between < 0.75 * (between - before)
    assert rms(here - fine) < max(2.0 * rms(everywhere - fine), 3e-5 * rms(fine))


def test_how_long_a_run_takes_is_foretold_by_the_measured_speed(robot):
    torque = INPUTS["chirp"]
    for stiffness in (30.0, 300.0, 3e3):
        system = assemble(robot + effect("presliding_friction", torque_Nm=0.1, stiffness_Nm_rad=stiffness))
        before = work_done()
        velocity = simulate(system, torque, DT).velocity
        taken = (work_done() - before) / (4 * N)
        assert system.mean_steps(DT, velocity) == pytest.approx(taken, rel=0.3)


def test_what_has_no_stiff_bristle_is_not_cut(robot):
    for axis in (
        robot,
        robot + effect("coulomb_friction", torque_Nm=0.1),
        robot + effect("hysteresis", torque_Nm=5.0, stiffness_Nm_rad=1e5),
    ):
        system = assemble(axis)
        assert system.steps(DT, 0.0) == (system.substeps(DT, 0.0), 1)
        assert system.mean_steps(DT, np.ones(N)) == system.substeps(DT, 0.0)
    soft = assemble(robot + effect("presliding_friction", torque_Nm=0.1, stiffness_Nm_rad=1e-3))
    assert soft.steps(DT, 0.0, STEP)[1] == 1
