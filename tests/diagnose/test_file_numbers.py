"""Numbers that are refitted in plain MuJoCo: those that a log cannot tell stay, and the others become the diagnosis's."""

from __future__ import annotations

import dataclasses
import math
from functools import partial

import numpy as np
import pytest
from servo_logs import PENDULUM, model, record, write

from diagnose.result import Diagnosis, Estimate, Finding, FitFigures, Verdict
from diagnose.verdict.reference import Run, cases_of
from diagnose.verdict.reference_fit import refit_in_simulator, standard_errors
from diagnose.verdict.reference_stage import compare_nominal
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis, write_corrected
from mjsim.mjcf.faithful import write_as_author
from simgap.file_numbers import with_numbers_of_file, without_short_times

WEIGHT = "gravity_load@arm.torque_Nm"
FRICTION = 0.08


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    path = write(tmp_path_factory.mktemp("file_numbers") / "m.xml", PENDULUM)
    log = record(model(PENDULUM, friction=FRICTION, kp=9.0), rate=100.0, seconds=6.0)
    return path, load_axis(path), log


@pytest.mark.slow
def test_a_refit_keeps_what_sets_the_scale_of_a_servo_log(given):
    path, axis, log = given
    cases = compare_nominal(path, axis, [log], [], 1).cases
    assert WEIGHT in cases[0].unshown
    assert cases[0].first(100).unshown == cases[0].unshown
    free = [dataclasses.replace(c, unshown=()) for c in cases]
    for asked, kept in ((cases, True), (free, False)):
        starts = [c.start() for c in asked]
        refit = refit_in_simulator(axis, partial(write_as_author, path), "out.xml", asked, starts, 1, math.inf)
        assert (WEIGHT not in refit.values) == kept
        assert (WEIGHT not in standard_errors(refit.axis, asked, starts)) == kept
        assert "kp" in refit.values


@pytest.mark.slow
def test_a_known_gain_that_the_file_has_otherwise_is_refitted(given):
    path, axis, log = given
    (case,) = compare_nominal(path, axis, [dataclasses.replace(log, known={"kp": 9.0})], [], 1).cases
    assert "kp" not in case.unshown
    kp = axis.chain.servo.kp
    (case,) = compare_nominal(path, axis, [dataclasses.replace(log, known={"kp": kp})], [], 1).cases
    assert "kp" in case.unshown


def diagnosis(rms: float) -> Diagnosis:
    """A diagnosis of which only what is asked for is there: friction too small by a tenth, an error ``rms``."""
    off = Estimate(0.9 * FRICTION, (0.89 * FRICTION, 0.91 * FRICTION), "N m")
    f = Finding("coulomb_friction", "motor", "hinge", "friction", {"torque_Nm": off}, {})
    empty = {x.name: None for x in dataclasses.fields(Diagnosis)}
    fit = {"corrected": FitFigures(rms, 0.0, rms, 0.0, ())}
    return Diagnosis(
        **(empty | {"findings": (f,), "linear_parameters": {"kp": Estimate(8.0, (7.9, 8.1), "N m/rad")}, "fit": fit})
    )


@pytest.mark.parametrize(("times", "other", "taken"), [(2.0, False, True), (1.0, False, False), (2.0, True, False)])
def test_they_are_those_of_the_file_where_the_equations_leave_more(given, tmp_path, times, other, taken):
    path, axis, log = given
    friction = effect_class("coulomb_friction")(torque_Nm=FRICTION)
    out = tmp_path / "corrected.xml"
    write_corrected(path, axis.with_values({"kp": 9.0}).with_effects([friction]), out)
    cases = cases_of([log], [])
    rng = np.random.default_rng(3)
    runs = [Run(np.zeros(len(c.measured)), c.measured + c.sigma * rng.standard_normal(len(c.measured)), c.start()) for c in cases]
    result = with_numbers_of_file(diagnosis(times * cases[0].sigma), out, cases, runs, other=other)
    found, kp = result.findings[0].parameters["torque_Nm"], result.linear_parameters["kp"]
    assert found.value == pytest.approx(FRICTION if taken else 0.9 * FRICTION)
    assert kp.value == pytest.approx(9.0 if taken else 8.0)
    assert found.ci95[0] < found.value < found.ci95[1]
    assert ("0.08 N m" in result.findings[0].sentence) == taken


@pytest.mark.parametrize(("samples", "stated", "named"), [(0.1, False, False), (0.1, True, True), (0.4, False, True)])
def test_a_delay_of_a_part_of_a_sample_is_named_where_the_hold_is_stated(given, samples, stated, named):
    _, axis, log = given
    log = dataclasses.replace(log, hold_stated=stated)
    late = Estimate(samples * log.dt, (0.9 * samples * log.dt, 1.1 * samples * log.dt), "s")
    delay = Finding("time_delay", "actuator", "hinge", "delay", {"delay_s": late}, {})
    found = dataclasses.replace(diagnosis(1.0), verdict=Verdict.MISSING_PHYSICS, notes=())
    alone = without_short_times(dataclasses.replace(found, findings=(delay,)), axis, cases_of([log], []))
    assert (alone.findings == (delay,)) == named
    assert alone.verdict == (Verdict.MISSING_PHYSICS if named else Verdict.PARAMETERS_ONLY)
    assert len(alone.notes) == (0 if named else 1)
    beside = without_short_times(dataclasses.replace(found, findings=(*found.findings, delay)), axis, cases_of([log], []))
    assert beside.findings == (*found.findings, *((delay,) if named else ()))
    assert beside.verdict is Verdict.MISSING_PHYSICS


def test_short_recordings_are_judged_too(given):
    _, axis, log = given
    short = cases_of([log.slice(0, 100)], [], 100)
    found = dataclasses.replace(diagnosis(1.0), verdict=Verdict.MISSING_PHYSICS, notes=())
    assert without_short_times(found, axis, short) is found
