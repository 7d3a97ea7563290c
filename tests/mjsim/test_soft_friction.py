"""MuJoCo's soft dry friction in the fitting engine: the same motion, the same inverse, and which files have it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjsim.chain import Softness
from mjsim.mjcf import load_model
from mjsim.mjcf.softness import has_soft_friction, with_softness
from mjsim.ode import inverse, simulate, work_done
from mjsim.system import assemble

DT = 1e-3
SHORT_STEP = 'timestep="0.0002"'


def text(joint: str = "", option: str = SHORT_STEP, load: str = "") -> str:
    return f"""<mujoco><option {option}/><worldbody><body>
    <joint name="j" axis="0 1 0" damping=".05" frictionloss=".1" {joint}/>
    <inertial pos="0 0 -.2" mass=".4" diaginertia=".01 .01 .01"/>{load}</body></worldbody>
    <actuator><motor name="drive" joint="j"/></actuator></mujoco>"""


LOAD = (
    '<body><joint name="shaft" axis="0 1 0" stiffness="30" damping=".02"/>'
    '<inertial pos="0 0 0" mass=".01" diaginertia=".002 .002 .002"/></body>'
)


@pytest.fixture
def torque() -> np.ndarray:
    t = DT * np.arange(2000)
    return 0.25 * np.sin(2 * np.pi * 1.1 * t) + 0.2 * np.sin(2 * np.pi * 0.37 * t + 1.0)


def by_mujoco(path: Path, torque: np.ndarray) -> np.ndarray:
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    out = np.empty(len(torque))
    for k, u in enumerate(torque):
        out[k] = d.qvel[0]
        d.ctrl[0] = u
        for _ in range(round(DT / m.opt.timestep)):
            mujoco.mj_step(m, d)
    return out


@pytest.mark.parametrize(
    ("joint", "option", "load", "within"),
    [
        ("", SHORT_STEP + ' integrator="RK4"', "", 2e-5),
        ("", 'timestep=".001" integrator="RK4"', "", 3e-4),
        ("", SHORT_STEP, "", 2e-3),
        ('solreffriction=".05 1" solimpfriction=".7 .9 .001 .5 2"', SHORT_STEP + ' integrator="RK4"', "", 2e-5),
        ('solreffriction="-10 -300" solimpfriction=".95 .95 .001 .5 2"', SHORT_STEP + ' integrator="RK4"', "", 1e-4),
        ("", SHORT_STEP + ' integrator="RK4" gravity="0 0 0"', LOAD, 1e-4),
    ],
)
def test_the_engine_moves_as_mujoco_does(
    tmp_path: Path, torque: np.ndarray, joint: str, option: str, load: str, within: float
) -> None:
    (tmp_path / "model.xml").write_text(text(joint, option, load))
    model = load_model(tmp_path / "model.xml")
    expected = by_mujoco(tmp_path / "model.xml", torque)
    soft = simulate(with_softness(model.axis, model), torque, DT).velocity
    hard = simulate(model.axis, torque, DT).velocity
    size = np.sqrt(np.mean(expected**2))
    assert np.sqrt(np.mean((soft - expected) ** 2)) < within * size
    assert np.sqrt(np.mean((hard - expected) ** 2)) > 5 * within * size


@pytest.mark.parametrize(
    ("joint", "load"), [("", ""), ('solreffriction=".05 1" solimpfriction=".7 .9 .001 .5 2"', ""), ("", LOAD)]
)
def test_a_step_is_cut_only_where_a_body_creeps(tmp_path: Path, joint: str, load: str) -> None:
    """The motion is that of steps that are cut everywhere, at a part of their cost, which the measured speed foretells."""
    (tmp_path / "model.xml").write_text(text(joint))
    model = load_model(tmp_path / "model.xml")
    system = assemble(with_softness(model.axis, model))
    dt, t = 0.02, 0.02 * np.arange(1000)
    torque = 0.5 * np.sin(2 * np.pi * 1.1 * t) + 0.4 * np.sin(2 * np.pi * 0.37 * t + 1.0)
    torque[300:500] = 0.05  # at rest on the slope
    n, parts = system.steps(dt, 0.0)
    assert n * parts >= system.substeps(dt, 0.0) > n
    runs, taken = [], []
    for substeps in (64, n * parts, None):
        before = work_done()
        runs.append(simulate(system, torque, dt, substeps=substeps, most_substeps=1000).velocity)
        taken.append((work_done() - before) / (4 * len(t)))
    fine, everywhere, here = runs
    assert taken[2] < 0.8 * taken[1]
    assert system.mean_steps(dt, here) == pytest.approx(taken[2], rel=0.3)
    size, most = np.sqrt(np.mean(fine**2)), 2.0 * np.sqrt(np.mean((everywhere - fine) ** 2))
    assert np.sqrt(np.mean((here - fine) ** 2)) < max(most, 3e-5 * size)


def test_the_inverse_gives_the_torque_back(tmp_path: Path, torque: np.ndarray) -> None:
    (tmp_path / "model.xml").write_text(text())
    model = load_model(tmp_path / "model.xml")
    axis = with_softness(model.axis, model)
    y = simulate(axis, torque, DT, substeps=20)
    f = axis.chain.bodies[0]
    soft = f.softness
    assert soft is not None
    others = torque - f.viscous * y.velocity - 0.4 * 0.2 * 9.81 * np.sin(y.angle)
    friction = np.clip(soft.impedance * (others + soft.rate * f.inertia * y.velocity), -0.1, 0.1)
    found = inverse(axis, y.angle, y.velocity, (others - friction) / f.inertia, DT)
    assert np.max(np.abs(found - torque)) < 1e-9


@pytest.mark.parametrize(
    ("joint", "option", "soft"),
    [
        ("", SHORT_STEP, Softness(0.9, 2 / (0.95 * 0.02))),
        ('solreffriction=".1 1" solimpfriction=".5 .8 .001 .5 2"', SHORT_STEP, Softness(0.5, 2 / (0.8 * 0.1))),
        ('solreffriction="-1 -5000" solimpfriction=".9999 .9999 .001 .5 2"', SHORT_STEP, None),
        ('solreffriction="-1 -500" solimpfriction=".9999 .9999 .001 .5 2"', SHORT_STEP, Softness(0.9999, 500 / 0.9999)),
    ],
)
def test_the_softness_of_a_file_is_that_of_its_constraint(tmp_path: Path, joint: str, option: str, soft: Softness | None) -> None:
    (tmp_path / "model.xml").write_text(text(joint, option))
    model = load_model(tmp_path / "model.xml")
    assert has_soft_friction(model) is (soft is not None)
    found = with_softness(model.axis, model).chain.bodies[0].softness
    if soft is None:
        assert found is None
    else:
        assert found is not None
        assert dataclasses.astuple(found) == pytest.approx(dataclasses.astuple(soft))


def test_a_joint_without_friction_has_the_softness_that_it_would_have(tmp_path: Path) -> None:
    (tmp_path / "model.xml").write_text(text().replace('frictionloss=".1"', ""))
    model = load_model(tmp_path / "model.xml")
    assert not has_soft_friction(model)
    assert with_softness(model.axis, model).chain.bodies[0].softness is not None


@pytest.mark.parametrize("at", ["0 0 0", "0 0 -.1"])
def test_a_slide_with_an_armature_creeps_as_in_mujoco(tmp_path: Path, torque: np.ndarray, at: str) -> None:
    """MuJoCo regularises without the armature where the centre of mass is at the joint."""
    (tmp_path / "model.xml").write_text(
        f"""<mujoco><option {SHORT_STEP} integrator="RK4"/><worldbody><body>
        <joint name="j" type="slide" axis="1 0 0" damping=".05" frictionloss=".1" armature=".6"/>
        <inertial pos="{at}" mass=".4" diaginertia=".01 .01 .01"/></body></worldbody>
        <actuator><motor name="drive" joint="j"/></actuator></mujoco>"""
    )
    model = load_model(tmp_path / "model.xml")
    expected = by_mujoco(tmp_path / "model.xml", 0.3 * torque)
    soft = simulate(with_softness(model.axis, model), 0.3 * torque, DT).velocity
    assert np.sqrt(np.mean((soft - expected) ** 2)) < 1e-4 * np.sqrt(np.mean(expected**2))
