"""A log of torque and angle: compared by force, and by motion where a free run of the answer follows it."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from diagnose.options import Options
from diagnose.pipeline import diagnose
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.ode import simulate
from mjsim.recording import Recording
from mjsim.system import assemble
from simgap.either_view import _follows_freely, _is_open
from simgap.pipeline import diagnose_files

MODEL = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="rotor">
  <joint name="hinge" axis="0 0 1" damping="0.4"/><inertial pos="0 0 0" mass="1" diaginertia=".07 .07 .07"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
NOMINAL = Axis(Chain((Body("motor", 0.07, 0.4, "hinge"),), ()))
COULOMB = effect_class("coulomb_friction")(torque_Nm=0.4)
ONLY = ("coulomb_friction", "torque_offset")
DT = 2e-3


def log(seed, disturbance=0.0):
    """Torque and angle of a rotor with Coulomb friction; ``disturbance``: rms of a slow torque that is not in the log."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(4000)
    u = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.3, 1.1, 4.0))
    unknown = np.cumsum(rng.standard_normal(len(t)))
    unknown *= disturbance / np.std(unknown)
    run = simulate(assemble(NOMINAL + COULOMB), u + unknown, DT)
    return Recording(t, u, None, run.angle + 2e-5 * rng.standard_normal(len(t)), DT, source=f"log_{seed}.csv")


def by_force(recordings):
    return diagnose(NOMINAL, recordings[:1], recordings[1:], Options(jobs=1, judge="force", effects=ONLY))


@pytest.mark.parametrize(("disturbance", "follows"), [(0.0, True), (0.3, False)])
def test_a_free_run_follows_where_no_unknown_torque_makes_it_drift(disturbance, follows):
    pair = [log(1, disturbance), log(2, disturbance)]
    assert _follows_freely(NOMINAL, by_force(pair), pair[:1], pair[1:], Options(jobs=1)) is follows


def test_what_was_asked_for_is_not_changed():
    pair = [log(1), log(2)]
    result = by_force(pair)
    assert _is_open(result, pair[0], Options())
    assert not _is_open(result, pair[0], Options(judge="force"))
    assert not _is_open(result, dataclasses.replace(pair[0], judge="force"), Options())
    assert not _is_open(result, dataclasses.replace(pair[0], velocity=np.gradient(pair[0].angle, DT)), Options())
    assert not _is_open(dataclasses.replace(result, channel="velocity"), pair[0], Options())


def test_motion_decides_where_it_explains_the_recordings(tmp_path):
    model = tmp_path / "rotor.xml"
    model.write_text(MODEL, encoding="utf-8")
    assert load_axis(model).chain.bodies[0].inertia == pytest.approx(0.07)
    files = []
    for r in (log(1), log(2)):
        files.append(tmp_path / r.source)
        np.savetxt(
            files[-1],
            np.column_stack([r.time, r.torque, r.angle]),
            delimiter=",",
            header="time_s,torque_Nm,angle_rad",
            comments="",
        )
    diagnose_files(files[:1], model, tmp_path / "out", files[1:], Options(jobs=1, effects=ONLY), progress=False)
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert said["verdict"] == "missing_physics"
    assert said["judged_on"]["channel"] == "velocity"
    (found,) = (f for f in said["findings"] if f["class"] == "physics")
    assert found["effect"] == "coulomb_friction"
    low, high = found["parameters"]["torque_Nm"]["ci95"]
    assert low < 0.4 < high
    assert high - low < 0.01
    assert any("compared by force first" in note.lower() for note in said["notes"])
