"""A torque map runs like an effect and is none: law, splines, round trip through MJCF, MuJoCo against the ODE."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from scipy.interpolate import BSpline

from mjsim import accurate
from mjsim.effects import registered
from mjsim.effects.law import N_LOCAL
from mjsim.errors import InputError
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.models import shipped_model
from mjsim.mujoco_run import lacking
from mjsim.ode import simulate
from mjsim.torque_map import VARIABLES, MapAxis, TorqueMap, basis

DT = 5e-4
SPEED = MapAxis("velocity", -40.0, 40.0, 8, 4.0)
COMMAND = MapAxis("torque command", -1.0, 1.0, 4)
RNG = np.random.default_rng(0)


def drag(*, two=False):
    """A torque against the motion, which with a second variable grows with the command."""
    axes = (SPEED, COMMAND) if two else (SPEED,)
    level = np.linspace(0.05, -0.05, SPEED.count)
    c = np.outer(level, np.linspace(0.5, 1.5, COMMAND.count)).ravel() if two else level
    return TorqueMap(place="motor", axes=axes, coefficients=tuple(c))


def twist():
    axes = (MapAxis("deflection", -1e-3, 1e-3, 5), MapAxis("angle", -0.3, 0.3, 4))
    c = np.outer(np.linspace(-8, 8, 8), np.linspace(-1, 1, 7)).ravel()
    return TorqueMap(place="gearbox", coupling=True, axes=axes, coefficients=tuple(c))


def test_it_is_no_cause_that_a_search_could_name():
    assert TorqueMap.id not in registered()
    assert not TorqueMap.specs()
    assert "not a cause" in drag().describe()


def test_the_splines_are_those_of_scipy():
    x = np.linspace(-1.0, 1.0, 101)
    h = 2.0 / COMMAND.intervals
    knots = -1.0 + h * np.arange(-3, COMMAND.intervals + 4)
    theirs = BSpline.design_matrix(x[:-1], knots, 3).toarray()
    np.testing.assert_allclose(basis(COMMAND, x[:-1]), theirs, atol=1e-12)
    np.testing.assert_allclose(basis(SPEED, np.linspace(-60, 60, 50)).sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_array_equal(basis(SPEED, np.array([55.0])), basis(SPEED, np.array([40.0])))


@pytest.mark.parametrize("two", [False, True])
def test_the_law_is_the_surface(two, robot):
    shape = drag(two=two)
    (port,) = shape.ports(robot.chain)
    for v, u in itertools.product((-50.0, -7.0, 0.0, 0.3, 40.0, 41.0), (-2.0, 0.1, 1.0)):
        z, out = [0.0] * N_LOCAL, [0.0] * 3
        z[VARIABLES["velocity"][0]], z[VARIABLES["torque command"][0]] = v, u
        port.law(z, port.p, out)
        assert out[0] == pytest.approx(float(shape.torque(*(np.array([a]) for a in (v, u)[: len(shape.axes)]))[0]), abs=1e-14)


@pytest.mark.parametrize("shape", [drag(), drag(two=True), twist()], ids=["one", "two", "coupling"])
def test_mujoco_agrees_with_the_equations(shape, robot):
    torque = chirp(1.0, DT, 1.0, 0.5, 30.0)
    axis = robot + shape
    one, other = simulate(axis, torque, DT).velocity, accurate.simulate(axis, torque, DT).velocity
    plain = simulate(robot, torque, DT).velocity
    moved = np.sqrt(np.mean((one - plain) ** 2))
    assert moved > 1e-3
    assert np.sqrt(np.mean((one - other) ** 2)) < 1e-4 * np.sqrt(np.mean(one**2))


def test_it_travels_in_the_model_file(robot, tmp_path):
    friction = registered()["coulomb_friction"](torque_Nm=0.02)
    axis = robot + friction + drag(two=True) + twist().with_coefficients(RNG.standard_normal(56))
    with pytest.raises(ValueError, match="twice"):
        axis + drag()
    path = tmp_path / "mapped.xml"
    write_corrected(shipped_model("robot_axis1"), axis, path)
    again = load_axis(path)
    assert again.effects == axis.effects
    torque = chirp(0.5, DT, 1.0, 0.5, 30.0)
    np.testing.assert_array_equal(simulate(again, torque, DT).velocity, simulate(axis, torque, DT).velocity)
    assert any("torque map" in line for line in lacking(load_model(path)))
    # and back to what it was
    write_corrected(path, robot, tmp_path / "back.xml")
    assert load_axis(tmp_path / "back.xml").effects == ()


def test_a_damaged_map_is_one_line(robot, tmp_path):
    path = tmp_path / "mapped.xml"
    write_corrected(shipped_model("robot_axis1"), robot + drag(), path)
    path.write_text(path.read_text().replace("&quot;velocity&quot;", "&quot;speed&quot;").replace('"velocity"', '"speed"'))
    with pytest.raises(InputError, match="speed"):
        load_axis(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"place": "sensor"}, "choose from motor"),
        ({"coefficients": (0.0,)}, "1 coefficients; expected 11"),
        ({"coupling": True}, "a coupling has no velocity"),
        ({"axes": ()}, "one or two"),
    ],
)
def test_nonsense_is_refused(change, said):
    given = {"place": "motor", "axes": (SPEED,), "coefficients": (0.0,) * 11, **change}
    with pytest.raises(ValueError, match=said):
        TorqueMap(**given)


def test_json_holds_all_of_it():
    assert TorqueMap.from_dict(json.loads(json.dumps(twist().as_dict()))) == twist()
    with pytest.raises(ValueError, match="low < high"):
        MapAxis("velocity", 1.0, -1.0, 5)
    with pytest.raises(KeyError, match="no parameters"):
        drag().with_values({"torque_Nm": 1.0})
