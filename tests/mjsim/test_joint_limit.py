"""MuJoCo's soft joint limits in the fitting engine: the same law at any state, the same motion, and which files have them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mjsim.axis import Axis
from mjsim.crosscheck import literal, relative
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis, load_model
from mjsim.mjcf.joint_limit import limit_of, with_limit
from mjsim.mjcf.native_write import FRICTION_STEP
from mjsim.mjcf.softness import with_softness
from mjsim.models import shipped_model
from mjsim.ode import inverse, simulate
from mjsim.system import assemble

DT = 1e-3
RK4 = 'timestep="0.00005" integrator="RK4"'
SHAFT = (
    '<body><joint name="{0}" axis="0 1 0" stiffness="30" damping=".02"/>'
    '<inertial pos="0 0 0" mass=".005" diaginertia=".001 .001 .001"/>{1}</body>'
)
LOAD = SHAFT.format("shaft", SHAFT.format("arm", ""))


def text(joint: str = "", option: str = RK4, friction: float = 0.0, load: str = "", inertia: float = 0.01) -> str:
    return f"""<mujoco><compiler angle="radian"/><option {option}/><worldbody><body>
    <joint name="j" axis="0 1 0" damping=".05" frictionloss="{friction}" limited="true" range="-.5 .6" {joint}/>
    <inertial pos="0 0 -.2" mass=".4" diaginertia="{inertia} {inertia} {inertia}"/>{load}</body></worldbody>
    <actuator><motor name="drive" joint="j"/></actuator></mujoco>"""


def read(path: Path, content: str) -> tuple[mujoco.MjModel, Axis]:
    path.write_text(content)
    model = load_model(path)
    return model.mjmodel, with_limit(with_softness(model.axis, model), model)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    solref=st.one_of(
        st.tuples(st.floats(0.005, 0.5), st.floats(0.1, 3.0)), st.tuples(st.floats(-1e5, -1.0), st.floats(-500.0, 0.0))
    ),
    low=st.floats(0.0, 1.0), high=st.floats(0.0, 1.0), width=st.floats(0.0, 0.5), middle=st.floats(0.05, 0.95),
    power=st.floats(1.0, 5.0), inertia=st.floats(1e-3, 1.0), friction=st.sampled_from([0.0, 0.1]), seed=st.integers(0, 99),
)  # fmt: skip
def test_the_law_is_that_of_mujoco_at_any_state(
    tmp_path: Path, solref: tuple[float, float], low: float, high: float, width: float, middle: float, power: float,
    inertia: float, friction: float, seed: int,
) -> None:  # fmt: skip
    joint = f'solreflimit="{solref[0]} {solref[1]}" solimplimit="{low} {high} {width} {middle} {power}"'
    m, axis = read(tmp_path / "model.xml", text(joint, friction=friction, inertia=inertia))
    rng, d = np.random.default_rng(seed), mujoco.MjData(m)
    q, v, u = rng.uniform(-1.0, 1.1, 40), rng.normal(size=40), rng.normal(size=40)
    a = np.empty(40)
    for k in range(40):
        d.qpos[0], d.qvel[0], d.ctrl[0] = q[k], v[k], u[k]
        mujoco.mj_forward(m, d)
        a[k] = d.qacc[0]
    size = 1.0 + np.abs(a) * (inertia + 0.016) / (1.0 - min(max(low, high), 0.9999))
    assert np.max(np.abs(inverse(axis, q, v, a, DT) - u) / size) < 1e-9


@pytest.mark.parametrize(
    ("joint", "option", "friction", "load", "within"),
    [
        ("", RK4, 0.0, "", 6e-4),
        ("", 'timestep="0.00001" integrator="RK4"', 0.0, "", 1.5e-4),
        ("", RK4, 0.1, "", 6e-4),
        ("", 'timestep=".00005" integrator="implicitfast"', 0.1, "", 6e-4),
        ('solreflimit=".05 .6" solimplimit=".5 .99 .05 .3 3"', RK4, 0.1, "", 3e-4),
        ('solreflimit="-900 -3" solimplimit=".8 .8 .01 .5 2"', RK4, 0.0, "", 2e-4),
        ('margin=".02" ref=".1"', RK4, 0.0, "", 1e-3),
        # the only one with limits and three bodies, for which code would be compiled
        pytest.param('solreflimit=".05 1"', RK4 + ' gravity="0 0 0"', 0.0, LOAD, 1e-3, marks=pytest.mark.slow),
    ],
)
def test_the_engine_moves_as_mujoco_does(
    tmp_path: Path, joint: str, option: str, friction: float, load: str, within: float
) -> None:
    m, axis = read(tmp_path / "model.xml", text(joint, option, friction, load))
    torque = 1.5 * np.sin(2 * np.pi * 2.1 * DT * np.arange(800))
    d, expected = mujoco.MjData(m), np.empty(800)
    for k, u in enumerate(torque):
        expected[k], d.ctrl[0] = d.qvel[0], u
        for _ in range(round(DT / m.opt.timestep)):
            mujoco.mj_step(m, d)
    body = axis.chain.bodies[0]
    free = dataclasses.replace(
        axis, chain=dataclasses.replace(axis.chain, bodies=(dataclasses.replace(body, limit=None), *axis.chain.bodies[1:]))
    )
    size = np.sqrt(np.mean(expected**2))
    assert np.sqrt(np.mean((simulate(axis, torque, DT).velocity - expected) ** 2)) < within * size
    assert np.sqrt(np.mean((simulate(free, torque, DT).velocity - expected) ** 2)) > 100 * within * size


def test_contact_and_release_are_located(tmp_path: Path) -> None:
    """The motion does not depend on the steps, though the acceleration jumps where the joint meets the limit."""
    _, axis = read(tmp_path / "model.xml", text('solreflimit=".05 .6" solimplimit=".9 .9 .001 .5 2"'))
    torque = 1.5 * np.sin(2 * np.pi * 2.1 * DT * np.arange(800))
    coarse, fine = (simulate(axis, torque, DT, substeps=n).velocity for n in (2, 40))
    assert np.max(np.abs(coarse - fine)) < 2e-5 * np.max(np.abs(fine))


@pytest.mark.parametrize(("upper", "differs"), [(0.3, True), (0.33, False)])
def test_a_limit_acts_from_its_angle_on(tmp_path: Path, upper: float, differs: bool) -> None:
    _, axis = read(tmp_path / "model.xml", text())
    body = axis.chain.bodies[0]
    assert body.limit is not None

    def run(high: float) -> np.ndarray:
        limited = dataclasses.replace(body, limit=dataclasses.replace(body.limit, lower=-9.0, upper=high))
        chain = dataclasses.replace(axis.chain, bodies=(limited,))
        return simulate(dataclasses.replace(axis, chain=chain), torque, DT).angle

    torque = 0.25 * np.sin(2 * np.pi * 0.9 * DT * np.arange(1500))
    free = run(9.0)
    scale = 0.315 / np.max(free)
    torque = torque * scale
    most = np.max(run(9.0))
    assert 0.3 < most < 0.33
    assert bool(np.any(run(upper) != run(9.0))) is differs


@pytest.mark.parametrize("joint", ['limited="false"', 'solreflimit="0 -5"', 'margin=".6"'])
def test_limits_that_no_law_stands_for_are_not_read(tmp_path: Path, joint: str) -> None:
    content = text(joint).replace('limited="true" ', "", 1 if joint.startswith("limited") else 0)
    (tmp_path / "model.xml").write_text(content)
    model = load_model(tmp_path / "model.xml")
    assert limit_of(model) is None
    assert with_limit(model.axis, model) == model.axis


def test_a_range_that_is_not_asked_for_costs_nothing(tmp_path: Path) -> None:
    (tmp_path / "model.xml").write_text(text().replace('pos="0 0 -.2"', 'pos="0 0 0"'))
    model = load_model(tmp_path / "model.xml")
    assert assemble(model.axis).affine
    assert not assemble(with_limit(model.axis, model)).affine


@pytest.mark.slow
@pytest.mark.parametrize("side", [-1, 1])
def test_a_stop_of_a_joint_that_others_follow_is_written_as_found(side: int) -> None:
    """MuJoCo regularises such a limit by another inertia than the body's."""
    path = shipped_model("robot_axis1")
    axis = load_axis(path)
    torque = np.full(400, 0.1 * side)
    stop = effect_class(f"{'upper' if side > 0 else 'lower'}_joint_stop")
    at = 0.5 * float(simulate(axis, torque, DT).angle[-1])
    stopped = axis + stop(angle_rad=at, time_constant_s=0.02, damping_ratio=0.5)
    expected = simulate(stopped, torque, DT).velocity
    assert np.min(side * expected) < 0, "it is thrown back"
    plain, _, lacks = literal(path, stopped, torque, DT, FRICTION_STEP)
    assert plain is not None, lacks
    assert relative(plain.velocity, expected) < 1e-3
