"""What a search names is kept where its file follows the recordings better in MuJoCo than the one as given."""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace

import pytest
from rotor_log import rotor_log

from diagnose.result import Estimate, Finding, Verdict
from diagnose.verdict.reference_runs import run_files
from diagnose.verdict.reference_stage import compare_nominal
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.mjcf.faithful import AUTHOR, Faithful, write_as_author
from mjsim.plant import MujocoPlant
from simgap.bench import Bench
from simgap.judging import _or_as_given

ROTOR = """<mujoco><option timestep="0.005" integrator="Euler" gravity="0 0 0"/><worldbody><body name="rotor">
  <joint name="hinge" axis="0 0 1" damping="0.4" stiffness="3"/>
  <geom type="cylinder" size=".2 .05" mass="5"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""


def log(seed, drag):
    """A recording of the rotor; ``drag``: coefficient of friction by the square of the velocity."""
    return rotor_log(ROTOR, seed, drag)


@pytest.mark.parametrize(
    ("in_log", "found", "as_given"),
    [(0.0, 1e-4, True), pytest.param(1.5e-4, 1e-5, False, marks=pytest.mark.slow), (1.5e-4, 1.5e-4, False)],
)
def test_an_effect_is_kept_where_its_file_follows_better(in_log, found, as_given, tmp_path):
    """A drag that is in the log is kept, its number refitted where it is too small; without it the file as given stands."""
    path, out = tmp_path / "rotor.xml", tmp_path / "corrected.xml"
    path.write_text(ROTOR, encoding="utf-8")
    given = load_axis(path)
    drag = effect_class("quadratic_friction")(coefficient_Nm_s2_rad2=found)
    axis = given + drag
    nominal = compare_nominal(path, given, [log(1, in_log)], [log(2, in_log)], 1)
    assert nominal is not None
    parameters = {name: Estimate(value, (0.9 * value, 1.1 * value), "") for name, value in drag.values.items()}
    findings = (Finding(drag.id, drag.place, "hinge", "", parameters, {}),)
    result = SimpleNamespace(verdict=Verdict.MISSING_PHYSICS, findings=findings, linear_parameters={})
    write = partial(write_as_author, path)
    form = Faithful(AUTHOR, math.nan, write(axis, out), write)
    runs = run_files([MujocoPlant.load(out)], nominal.cases, 1)[0]
    bench = Bench(path, given, axis, result, nominal, out, 1)
    assert _or_as_given(bench, axis, result, form, runs, ())[1] is as_given
    assert not _or_as_given(bench, axis, result, form, runs, findings)[1]  # a setting of the simulator was found
