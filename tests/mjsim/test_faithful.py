"""A corrected file holds a form of an effect that MuJoCo steps as the equations say, with the options that it has."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from robot_axis import effect

from mjsim.errors import InputError
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis, load_model
from mjsim.mjcf.adjust import adjust
from mjsim.mjcf.faithful import AUTHOR, as_plain, write_faithful
from mjsim.ode import DivergedError
from mjsim.plant import ChainPlant, MujocoPlant

DT = 1e-3
MODEL = """<mujoco><option timestep="0.0005" integrator="{integrator}"/><worldbody><body name="arm">
  <joint name="hinge" axis="0 0 1" damping=".05"/><inertial pos="0 0 0" mass="1" diaginertia=".05 .05 .05"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
EFFECTS = {
    "coulomb": effect("coulomb_friction", torque_Nm=0.2),
    "presliding": effect("presliding_friction", torque_Nm=0.2, stiffness_Nm_rad=200.0),
    "stiff presliding": effect("presliding_friction", torque_Nm=0.2, stiffness_Nm_rad=2e5),
    "damped presliding": effect("presliding_friction_with_damping", torque_Nm=0.2, stiffness_Nm_rad=2e4, damping_Nms_rad=200.0),
    "fast mode": effect("extra_flexible_mode", inertia_kgm2=0.01, stiffness_Nm_rad=1.5e4, damping_Nms_rad=0.5),
    "offset": effect("torque_offset", torque_Nm=0.1),
}


INTEGRATORS = ("Euler", "implicitfast", "RK4")
QUICK = {(name, INTEGRATORS[k % 3]) for k, name in enumerate(EFFECTS)} | {("coulomb", "RK4"), ("stiff presliding", "Euler")}


@pytest.mark.parametrize(
    ("name", "integrator"),
    [pytest.param(*case, marks=() if case in QUICK else pytest.mark.slow) for case in itertools.product(EFFECTS, INTEGRATORS)],
)
def test_a_form_that_mujoco_steps_as_found_is_written(name, integrator, tmp_path):
    path, out = tmp_path / "model.xml", tmp_path / "corrected.xml"
    path.write_text(MODEL.format(integrator=integrator), encoding="utf-8")
    axis = load_axis(path) + EFFECTS[name]
    u = chirp(1.5, DT, 0.6, 0.5, 6.0)[:, None]
    ideal = ChainPlant(axis).run(u, DT)[:, 0]
    seen = []

    def differs(at):
        try:
            seen.append(float(np.linalg.norm(MujocoPlant.load(at).run(u, DT)[:, 0] - ideal) / np.linalg.norm(ideal)))
        except DivergedError:
            seen.append(np.inf)
        return seen[-1], seen[-1] <= 0.01

    form = write_faithful(path, axis, out, differs)
    assert form.differs == min(seen) < 0.01
    assert form.lacks == ()
    assert differs(out) == (form.differs, True)
    assert load_model(out).axis.effects == axis.effects
    if form.form.startswith("finer"):
        assert "times the steps" in out.read_text(encoding="utf-8")


def test_what_plain_mujoco_has_of_an_effect(tmp_path):
    path, out = tmp_path / "model.xml", tmp_path / "corrected.xml"
    path.write_text(MODEL.format(integrator="Euler"), encoding="utf-8")
    axis = load_axis(path) + effect("static_friction", torque_Nm=0.2, peak=2.0) + EFFECTS["offset"]
    axis += effect("sensor_quantisation", place="sensor", step=0.1)
    form = write_faithful(path, axis, out, lambda _: (0.0, True))
    assert len(form.lacks) == 2
    keys = {key for key, _ in load_model(out).carried.lacks}
    assert as_plain(axis, keys).effects == (EFFECTS["coulomb"], EFFECTS["offset"])
    assert as_plain(axis, ()) == axis


def test_stiff_friction_keeps_the_authors_timestep_where_that_is_near_enough(tmp_path):
    path, out = tmp_path / "model.xml", tmp_path / "corrected.xml"
    path.write_text(MODEL.format(integrator="Euler"), encoding="utf-8")
    axis, steps = load_axis(path) + EFFECTS["coulomb"], []

    def differs(at):
        m = MujocoPlant.load(at).model
        steps.append((m.opt.timestep, -m.dof_solref[0, 1] * m.opt.timestep))
        return 1.0, False

    write_faithful(path, axis, out, differs)
    assert [s for s, _ in steps[:4]] == pytest.approx([5e-4, 5e-4, 1.25e-4, 1e-4])
    assert [rate for _, rate in steps[1:4]] == pytest.approx([1.0, 1.0, 1.0])


def test_an_effect_that_no_form_does_is_carried_only(tmp_path):
    path, out = tmp_path / "model.xml", tmp_path / "corrected.xml"
    path.write_text(MODEL.format(integrator="Euler"), encoding="utf-8")
    axis = load_axis(path) + EFFECTS["coulomb"]

    def differs(at):
        return (2.0 if MujocoPlant.load(at).model.dof_frictionloss.any() else 1.0), False

    form = write_faithful(path, axis, out, differs)
    assert form.form == "coulomb_friction@motor carried only"
    assert "does not step any form" in form.lacks[0]
    assert load_axis(out).effects == axis.effects
    assert form.form != AUTHOR


def test_settings_of_an_element_that_is_not_there_are_refused(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(MODEL.format(integrator="Euler"), encoding="utf-8")
    with pytest.raises(InputError, match="carries no correction"):
        adjust(path, [("option", "", "timestep", "1e-4")])
    out = tmp_path / "corrected.xml"
    write_faithful(path, load_axis(path), out, lambda _: (0.0, True))
    with pytest.raises(InputError, match="'elbow' is not in this file"):
        adjust(out, [("joint", "elbow", "solreffriction", "0.02 1")])
