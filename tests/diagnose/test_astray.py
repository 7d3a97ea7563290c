"""What a held-out error may be held against: a free run that goes astray, and a recording that was fitted badly."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.pipeline import Options, _closed, diagnose
from diagnose.result import Verdict
from lab.benchmark.cases import make_case
from lab.benchmark.catalogue import OUTSIDE, compose, find
from lab.benchmark.experiment import multisine, steps
from lab.benchmark.laws import Laws
from mjsim.recording import Recording

NOISE = 0.07


def test_the_part_of_an_error_that_was_closed():
    assert _closed(3.0, 0.0) == 1.0  # rms 2 -> 1, the noise being 1
    assert _closed(8.0, 3.0) == pytest.approx(0.5)  # rms 3 -> 2
    assert _closed(8.0, 8.0) == 0.0
    assert _closed(8.0, 15.0) == pytest.approx(-0.5)
    assert _closed(0.0, 1.0) == 0.0
    assert _closed(3.0, -0.1) == 1.0


def test_a_gap_is_named_although_its_free_run_goes_astray(robot, sealed):
    """Two runs of the plant whose parameters differ by 1e-5 come apart on the held-out recording: it was `unexplained`."""
    rng = np.random.default_rng(4)
    laws = compose(Laws(), find("backlash", "gearbox"), {"gap_rad": 1.23e-3})
    pair = sealed(laws, (steps(6.0, 1.07, 0.03, rng), multisine(10.0, 0.43, 0.1, 40.0, rng)), 5, NOISE)
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=("backlash", "coulomb_friction", "hysteresis"), jobs=1))
    assert found.verdict is Verdict.MISSING_PHYSICS
    (finding,) = found.findings
    assert (finding.effect, finding.place) == ("backlash", "gearbox")
    assert finding.parameters["gap_rad"].value == pytest.approx(1.23e-3, rel=1e-3)
    assert found.fit["corrected"].held_out_rms > 3 * NOISE, "the run does go astray"
    assert any("goes astray" in note for note in found.notes)


def test_what_is_left_on_the_fitted_recording_counts(robot, sealed):
    """A torque that fades as the motor heats, for which drag is a stand-in that a weak held-out recording does not betray."""
    rng = np.random.default_rng(6)
    laws = compose(Laws(), find("thermal_derating", "actuator", OUTSIDE), {"per_Nm2": 0.42, "time_s": 3.1})
    pair = sealed(laws, (multisine(8.0, 0.5, 0.1, 30.0, rng), multisine(8.0, 0.02, 0.1, 30.0, rng)), 7)
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=("quadratic_friction", "coulomb_friction"), jobs=1))
    assert found.fit["corrected"].held_out_rms < 1.1 * 0.05, "held-out data alone do not betray it"
    assert found.verdict is Verdict.UNEXPLAINED


def test_a_parameter_that_took_the_colour_of_the_noise_is_not_missing_physics(robot):
    """A trapezoid under feedback leaves inertias open: on plain errors one went to a tenth, and the model missed motion by that.

    Case 044 of `parameters_only`, seed 2033: noise at 43 Hz, 48 times as large as its fastest part; it was `unexplained`.
    """
    case = make_case("parameters_only", np.random.default_rng([2033, 8, 44]), None)
    pair = [Recording(m.time, m.torque, m.velocity, m.angle, m.time[1]) for m in (case.estimation, case.held_out)]
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=("actuator_lag",), jobs=1))
    assert found.verdict is Verdict.PARAMETERS_ONLY
    assert found.linear_parameters["Jg"].value == pytest.approx(case.truth["linear_parameters"]["Jg"], rel=0.1)
