"""Friction that a simulator other than MuJoCo smooths, F tanh(v / v_s), is Coulomb friction that fades in."""

from __future__ import annotations

import json

import numpy as np
import pytest

from diagnose.options import Options
from diagnose.structure.candidates import related
from mjsim.effects import effect_class
from simgap.pipeline import diagnose_files

MODEL = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="rotor">
  <joint name="hinge" axis="0 0 1" damping=".05"/><inertial pos="0 0 0" mass="1" diaginertia=".07 .07 .07"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
INERTIA, DAMPING, LEVEL, DT, FINE = 0.07, 0.05, 0.2, 2e-3, 20


def log(path, speed, seed):
    """The equation of motion by small steps, with white noise."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(2000)
    torque = 0.8 * sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) for f in (0.3, 1.1, 4.0))
    q = v = 0.0
    motion = np.empty((len(t), 2))
    for k, u in enumerate(torque):
        motion[k] = v, q
        for _ in range(FINE):
            v += DT / FINE * (u - DAMPING * v - LEVEL * np.tanh(v / speed)) / INERTIA
            q += DT / FINE * v
    motion += rng.normal(0.0, (0.01, 1e-4), motion.shape)
    table = np.column_stack([t, torque, motion])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="")
    return path


@pytest.mark.parametrize(
    ("speed", "options"),
    [
        pytest.param(0.1, Options(jobs=1, effects=("coulomb_friction",)), marks=pytest.mark.slow),
        pytest.param(0.1, Options(jobs=2), marks=pytest.mark.slow),
        pytest.param(0.5, Options(jobs=2), marks=pytest.mark.slow),
    ],
)
def test_smooth_friction_is_found_with_its_speed(tmp_path, speed, options):
    model = tmp_path / "model.xml"
    model.write_text(MODEL)
    first, second = (log(tmp_path / f"{seed}.csv", speed, seed) for seed in (1, 2))
    diagnose_files([first], model, tmp_path / "out", [second], options, progress=False, page=False)
    found = json.loads((tmp_path / "out/diagnosis.json").read_text())
    assert found["verdict"] == "missing_physics"
    (finding,) = found["findings"]
    assert finding["effect"] == "coulomb_friction"
    values = {name: p["value"] for name, p in finding["parameters"].items()}
    assert values["torque_Nm"] == pytest.approx(LEVEL, rel=0.01)
    assert values["creep_velocity_rad_s"] == pytest.approx(speed, rel=0.05)


@pytest.mark.parametrize("name", ["coulomb_friction", "presliding_friction", "asymmetric_friction", "sublinear_viscous_friction"])
def test_another_form_takes_the_place_of_what_refines_the_same_effect(name):
    effect = effect_class(name)(place="motor", **{s.name: 0.5 for s in effect_class(name).specs()})
    assert related("coulomb_friction_with_creep", effect)
    offset = effect_class("torque_offset")(place="motor", torque_Nm=0.5)
    assert not related("coulomb_friction_with_creep", offset)
