"""Every plant keeps one interface: free run, inverse, linear model and parameters agree with each other and across plants."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mjsim.errors import InputError
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis
from mjsim.ode import DivergedError
from mjsim.plant import ChainPlant, Hold, MujocoPlant, Start, check_units, run_together
from mjsim.plant.base import mean_input
from mjsim.recording import Recording

DT = 2e-3
PENDULUM = """<mujoco><option timestep="0.0005" integrator="{integrator}"/><worldbody><body name="arm" pos="0 0 1">
  <joint name="hinge" axis="0 1 0" damping="{damping}"/>
  <geom type="sphere" pos="0 0 -.4" size=".04" mass=".5" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
GEARED = PENDULUM.replace('<motor name="drive"', '<motor name="drive" gear="20"').replace(
    '"{damping}"', '"{damping}" armature="0.05"'
)
SLIDE = """<mujoco><option timestep="0.0005" integrator="{integrator}"/><worldbody><body name="first">
  <joint name="cart" type="slide" axis="1 0 0" damping="{damping}"/>
  <geom type="box" size=".1 .1 .1" mass="2" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><motor name="drive" joint="cart"/></actuator>
  <sensor><jointpos name="x" joint="cart"/><jointvel name="v" joint="cart"/></sensor></mujoco>"""
TWO_MASS = """<mujoco><option timestep="0.0005" integrator="{integrator}" gravity="0 0 0"/><worldbody><body name="first">
  <joint name="motor" axis="0 0 1" damping="{damping}"/><inertial pos="0 0 0" mass="1" diaginertia=".02 .02 .02"/>
  <body name="second"><joint name="link" axis="0 0 1" stiffness="40" damping=".02"/>
  <inertial pos="0 0 0" mass="1" diaginertia=".05 .05 .05"/></body></body></worldbody>
  <actuator><motor name="drive" joint="motor"/></actuator></mujoco>"""
SERVO = """<mujoco><option timestep="0.0005" integrator="implicitfast" gravity="0 0 0"/><worldbody><body name="first">
  <joint name="hinge" axis="0 1 0" damping=".05"/><geom type="box" size=".1 .1 .1" mass="1"/></body></worldbody>
  <actuator>{servo}</actuator></mujoco>"""
MODELS = {"pendulum": PENDULUM, "geared": GEARED, "slide": SLIDE, "two_mass": TWO_MASS}
GAINS = {"pendulum": 0.4, "geared": 0.02, "slide": 3.0, "two_mass": 0.3}
INTEGRATORS = ("Euler", "implicitfast", "RK4")


@pytest.fixture
def at(tmp_path):
    """Path of a model written on the spot."""

    def write(name="pendulum", integrator="Euler", damping=0.1):
        path = tmp_path / f"{name}.xml"
        path.write_text(MODELS[name].format(integrator=integrator, damping=damping), encoding="utf-8")
        return path

    return write


def drive(name, seconds=2.0):
    return chirp(seconds, DT, GAINS[name], 0.3, 4.0)[:, None]


def relative(y, z):
    return float(np.linalg.norm(y[:, 0] - z[:, 0]) / np.linalg.norm(z[:, 0]))


PLANTS = {"chain": lambda path: ChainPlant(load_axis(path)), "mujoco": MujocoPlant.load}
each_plant = pytest.mark.parametrize("make", PLANTS.values(), ids=PLANTS)
each_model = pytest.mark.parametrize("name", MODELS)


@each_model
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_plants_agree_within_their_declared_tolerances(name, integrator, at):
    path = at(name, integrator)
    chain, own = ChainPlant(load_axis(path)), MujocoPlant.load(path)
    u = drive(name)
    assert relative(own.run(u, DT), chain.run(u, DT)) < own.tolerance + chain.tolerance


@each_model
@each_plant
def test_run_is_deterministic_and_takes_the_stated_shapes(make, name, at):
    plant = make(at(name))
    u = drive(name, 0.5)
    y = plant.run(u, DT)
    assert y.shape == (len(u), 2) == (len(u), len(plant.outputs))
    assert np.array_equal(y, plant.run(u, DT))
    assert {s.role for s in plant.outputs} == {"velocity", "angle"}
    assert plant.inputs[0].unit == ("N" if name == "slide" else "N m")
    for wrong in (u[:, 0], np.zeros((5, 2)), np.zeros((1, 1))):
        with pytest.raises(ValueError, match=r"shape|expected"):
            plant.run(wrong, DT)
    with pytest.raises(ValueError, match="finite"):
        plant.run(np.full((5, 1), np.nan), DT)
    assert plant.cost(DT) > 0


@each_model
@each_plant
def test_the_inverse_of_a_run_is_its_input(make, name, at):
    """MuJoCo's inverse lands on every sample; the chain's is of second order in the sample time."""
    plant = make(at(name, "implicitfast"))
    u = drive(name, 1.0)
    found = plant.inverse(plant.run(u, DT), DT)
    limit = 1e-8 if isinstance(plant, MujocoPlant) else 0.01
    assert np.max(np.abs(found - u)[:-1]) < limit * np.max(np.abs(u))


@each_model
@each_plant
def test_the_linear_model_predicts_a_small_run(make, name, at):
    plant = make(at(name))
    u = 1e-3 * drive(name, 1.0)
    y = plant.run(u, DT)
    assert relative(plant.linearised(DT).run(u), y) < 1e-5


@each_model
@each_plant
def test_parameters_are_replaced_by_name(make, name, at):
    plant = make(at(name))
    first = plant.parameters[0]
    other = plant.with_values({first.name: 2.0 * first.value})
    assert {p.name: p.value for p in other.parameters}[first.name] == pytest.approx(2.0 * first.value) or isinstance(
        plant, MujocoPlant
    )
    u = drive(name, 0.5)
    assert np.std(other.run(u, DT)[:, 0]) < 0.9 * np.std(plant.run(u, DT)[:, 0])
    with pytest.raises(KeyError):
        plant.with_values({"no_such": 1.0})


@each_plant
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_energy_is_kept_without_losses(make, integrator, at):
    """Kinetic and potential energy of a swinging pendulum, to the first order of the timestep (implicitfast among them)."""
    plant = make(at("pendulum", integrator, damping=0.0))
    y = plant.run(np.zeros((1000, 1)), DT, start=Start(0.0, 3.0))
    inertia = plant.parameters[0].value
    energy = 0.5 * inertia * y[:, 0] ** 2 + 0.5 * 9.81 * 0.4 * (1 - np.cos(y[:, 1]))
    assert np.ptp(energy) < 4 * plant.tolerance * energy[0]


@each_plant
@pytest.mark.parametrize("hold", Hold)
def test_a_slow_log_holds_what_acted_between_its_samples(make, hold, at):
    """A run on every fourth sample of an input, laid out as declared, is the run on the input itself."""
    plant = make(at("slide"))
    slow, fine = 0.02, 0.005
    u = np.random.default_rng(0).standard_normal((60, 1))
    dense = mean_input(u, slow, fine, len(u) * 4, hold)
    y, z = plant.run(u, slow, hold=hold), plant.run(dense, fine)[::4]
    # straight lines are laid out in steps, as fine as each plant has them
    assert relative(y, z) < (2e-2 if hold is Hold.LINEAR else 2 * plant.tolerance)


@pytest.mark.parametrize("dt", [0.0013, 0.0002, 0.00075])
def test_samples_between_steps_are_interpolated(dt, at):
    plant = MujocoPlant.load(at("two_mass", "RK4"))
    assert plant.interpolates(dt)
    assert not plant.interpolates(0.001)
    t = dt * np.arange(int(1.0 / dt))
    u = 0.3 * np.sin(6 * t)[:, None]
    exact = ChainPlant(load_axis(plant.path)).run(u, dt)
    y = plant.run(u, dt)
    assert relative(y, exact) < 1e-3
    assert np.max(np.abs(y[:, 1] - exact[:, 1])) < 1e-3 * np.ptp(exact[:, 1])


def test_several_runs_at_once_are_those_one_by_one(at):
    plant = MujocoPlant.load(at("pendulum"))
    us = [k * drive("pendulum", 0.5) for k in (1.0, -0.5, 2.0)]
    starts = [Start(0.1 * k, -0.2 * k) for k in range(3)]
    many = plant.run_many(us, DT, starts, threads=2)
    together = run_together([(plant, u, DT, s) for u, s in zip(us, starts, strict=True)])
    for u, s, y, z in zip(us, starts, many, together, strict=True):
        alone = plant.run(u, DT, start=s)
        assert np.array_equal(alone, y)
        assert np.array_equal(alone, z)
        assert alone[0] == pytest.approx([s.velocity, s.angle])


@pytest.mark.parametrize(
    ("servo", "role"),
    [
        ('<position joint="hinge" kp="20" kv="2"/>', "command"),
        ('<velocity joint="hinge" kv="5"/>', "command"),
        ('<general joint="hinge" gainprm="20" biastype="affine" biasprm="0 -20 -2"/>', "command"),
        ('<motor joint="hinge"/>', "torque"),
    ],
)
def test_a_servo_takes_its_command(servo, role, tmp_path):
    path = tmp_path / "servo.xml"
    path.write_text(SERVO.format(servo=servo), encoding="utf-8")
    plant = MujocoPlant.load(path)
    assert plant.inputs[0].role == role
    y = plant.run(np.full((2000, 1), 0.5), DT)
    if "position" in servo or "general" in servo:
        assert y[-1] == pytest.approx([0.0, 0.5], abs=1e-3)
    if "velocity" in servo:
        assert y[-1, 0] == pytest.approx(0.5 * 5 / 5.05, rel=1e-3)


def test_a_run_that_diverges_says_where_and_what_to_do(at):
    path = at("two_mass")
    path.write_text(path.read_text().replace('stiffness="40"', 'stiffness="1e7"').replace('damping=".02"', 'damping="-10"'))
    with pytest.raises(DivergedError, match="timestep"):
        MujocoPlant.load(path).run(drive("two_mass"), DT)


def test_a_unit_that_the_joint_does_not_have_is_refused(at):
    plant = MujocoPlant.load(at("slide"))
    n = np.zeros(300)
    recording = Recording(DT * np.arange(300), n, n, n, DT, units={"angle": "rad", "velocity": "m/s"})
    with pytest.raises(InputError, match="angle is in rad"):
        check_units(plant, recording)
    check_units(plant, dataclasses.replace(recording, units={"angle": "m", "torque": "N"}))


@pytest.mark.parametrize("dt", [DT, 0.0007, 0.0002])
def test_pieces_of_a_run_are_the_run(at, dt):
    plant, u = MujocoPlant.load(at("two_mass")), drive("two_mass")
    start = Start(0.1, -0.2)
    parts = list(plant.pieces(u, dt, start=start, ends=[2, 300, 301, len(u)]))
    assert [len(y) for y in parts] == [2, 298, 1, len(u) - 301]
    assert np.array_equal(np.concatenate(parts), plant.run(u, dt, start=start))
    with pytest.raises(ValueError, match="rising numbers"):
        next(plant.pieces(u, dt, ends=[300, 200, len(u)]))
