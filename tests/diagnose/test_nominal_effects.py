"""A nominal model that has effects itself (a weight, dry friction, a limit): fitted with its numbers, refined in their place."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.hypothesis import make
from diagnose.problem.view import MotionView
from diagnose.structure.candidates import candidates
from mjsim.mjcf import load_axis, write_corrected
from mjsim.mujoco_run import run_literal
from mjsim.ode import simulate
from mjsim.recording import Recording
from simgap.pipeline import corrected_axis

PENDULUM = """<mujoco model="pendulum">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.0005" integrator="RK4"/>
  <worldbody>
    <body name="link">
      <joint name="shoulder" type="hinge" axis="0 1 0" armature="0.02" damping="0.05" frictionloss="0.15"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.3"/>
      <geom name="bob" type="sphere" pos="0 0 -0.4" size="0.05" mass="1.2"/>
    </body>
  </worldbody>
  <actuator><motor name="motor_torque" joint="shoulder" gear="20" ctrlrange="-2 2"/></actuator>
  <sensor><jointpos name="motor_angle" joint="shoulder"/><jointvel name="motor_velocity" joint="shoulder"/></sensor>
</mujoco>
"""
NOISE, DT = 0.01, 0.002


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("nominal") / "pendulum.xml"
    path.write_text(PENDULUM, encoding="utf-8")
    return path


def record(axis, seed):
    rng = np.random.default_rng(seed)
    t = DT * np.arange(5000)
    u = sum(np.cos(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f in np.arange(2, 80) / 10)
    u *= 0.2 / np.std(u)
    y = simulate(axis, u, DT)
    noisy = y.velocity + NOISE * rng.standard_normal(len(t)), y.angle + 2e-4 * rng.standard_normal(len(t))
    return Recording(t, u, *noisy, DT)


def pair(axis):
    return [record(axis, 1)], [record(axis, 2)]


LIGHTER = {"gravity_load@arm.torque_Nm": 4.6, "coulomb_friction@motor.torque_Nm": 0.25, "Jm": 0.2, "fm": 0.06}


@pytest.fixture(scope="module")
def lighter(model):
    nominal = load_axis(model)
    true = nominal.with_values(LIGHTER)
    return nominal, true, diagnose(nominal, *pair(true), Options(jobs=1))


def test_another_weight_and_friction_are_parameters(lighter):
    nominal, _, result = lighter
    assert {e.key for e in nominal.effects} == {"coulomb_friction@motor", "actuator_saturation@actuator", "gravity_load@arm"}
    assert result.verdict.value == "parameters_only"
    found = corrected_axis(nominal, result)
    estimates = dict(result.linear_parameters)
    estimates |= {f"{n.key}.{name}": e for n in result.nominal_effects for name, e in n.parameters.items()}
    for name, value in LIGHTER.items():
        assert estimates[name].value == pytest.approx(value, rel=0.003)
    assert {e.key: e.values for e in found.effects}["gravity_load@arm"]["torque_Nm"] == pytest.approx(4.6, rel=0.01)


def test_what_is_not_exercised_stays_as_given(lighter):
    nominal, _, result = lighter
    own = {n.effect: n for n in result.nominal_effects}
    assert own["actuator_saturation"].parameters == {}
    assert own["actuator_saturation"].nominal == {"limit_Nm": 2.0}
    kept = {e.key: e for e in corrected_axis(nominal, result).effects}
    assert kept["actuator_saturation@actuator"].values == {"limit_Nm": 2.0}


@pytest.mark.slow
def test_plain_mujoco_has_the_other_weight(lighter, model, tmp_path):
    nominal, true, result = lighter
    out = tmp_path / "corrected.xml"
    found = corrected_axis(nominal, result)
    written = write_corrected(model, found, out)
    assert written.lacks == ()
    assert {e.key for e in load_axis(out).effects} == {e.key for e in nominal.effects}
    r = record(true, 3)
    of_law, of_nominal = (simulate(a, r.torque, DT).velocity for a in (found, nominal))
    plain = run_literal(out, r.torque, DT).velocity
    assert np.std(plain - of_law) < 0.01 * np.std(of_nominal - of_law)


@pytest.mark.slow
def test_a_refinement_takes_the_place_of_nominal_friction(model, tmp_path):
    nominal = load_axis(model)
    refined = make(
        "stribeck_friction", "motor", {"torque_Nm": 0.2, "extra_static_torque_Nm": 0.2, "stribeck_velocity_rad_s": 0.5}
    )
    true = nominal.with_values({"gravity_load@arm.torque_Nm": 5.0}).with_effects([refined])
    assert "coulomb_friction@motor" not in {e.key for e in true.effects}
    result = diagnose(nominal, *pair(true), Options(jobs=1, effects=("stribeck_friction", "torque_offset", "time_delay")))
    assert result.verdict.value == "missing_physics"
    assert [(f.effect, f.place) for f in result.findings] == [("stribeck_friction", "motor")]
    for name, value in refined.values.items():
        assert result.findings[0].parameters[name].value == pytest.approx(value, rel=0.05)
    assert any("as the nominal model had it: what was found has taken its place" in note for note in result.notes)
    found = corrected_axis(nominal, result)
    assert {e.id for e in found.effects} == {"stribeck_friction", "actuator_saturation", "gravity_load"}
    out = tmp_path / "corrected.xml"
    write_corrected(model, found, out)
    back = {e.key: e.values for e in load_axis(out).effects}
    assert back["stribeck_friction@motor"] == pytest.approx(found.effects[-1].values)
    # and back to the nominal model from there
    write_corrected(out, nominal, tmp_path / "again.xml")
    assert {e.key: e.values for e in load_axis(tmp_path / "again.xml").effects} == {e.key: e.values for e in nominal.effects}


def test_what_the_nominal_model_has_is_not_offered_again(model):
    nominal = load_axis(model)
    experiments = [prepare(record(nominal, s)) for s in (1, 2)]
    fitter = Fitter(nominal, MotionView(), (experiments[0],), (experiments[1],), 1)
    keys = {c.key for c in candidates(fitter)}
    assert not keys & {"coulomb_friction@motor", "gravity_load@arm", "actuator_saturation@actuator"}
    assert {"stribeck_friction@motor", "asymmetric_friction@motor", "torque_offset@motor"} <= keys


def test_numbers_of_an_axis_by_name(model):
    nominal = load_axis(model)
    axis = nominal.with_values({"Jm": 0.3, "coulomb_friction@motor.torque_Nm": 0.4})
    assert axis.chain.bodies[0].inertia == 0.3
    assert axis.effects[0].values == {"torque_Nm": 0.4}
    with pytest.raises(KeyError, match="unknown linear parameter"):
        nominal.with_values({"Jx": 1.0})
    with pytest.raises(KeyError, match="no effect of the axis"):
        nominal.with_values({"backlash@gearbox.gap_rad": 1.0})
