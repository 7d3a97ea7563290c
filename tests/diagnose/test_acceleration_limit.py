"""Limited acceleration of a servo's target, on one joint: named beside and without a velocity limit, and not where it is not."""

from __future__ import annotations

import dataclasses
import math

import pytest

from diagnose.data.servo import as_servo
from diagnose.data.split import split
from diagnose.fit.fitter import Fitter
from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.problem.choose_view import choose_view, with_samples
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from tests.mjsim.profile_logs import ACCELERATION, log
from tests.mjsim.servo_logs import PENDULUM, write

RIVALS = ("acceleration_limit", "velocity_limit", "actuator_lag", "time_delay", "actuator_saturation", "coulomb_friction")
NOISE, SECONDS = 2e-4, 8.0
FORCE = ' forcelimited="true" forcerange="-2 2"'


@pytest.fixture(scope="module")
def axis(tmp_path_factory):
    return load_axis(write(tmp_path_factory.mktemp("servo") / "servo.xml", PENDULUM))


def names(axis, limit: float, acceleration: float, hold: str = "held", rivals=RIVALS, seconds=SECONDS, **true: object):
    a, b = (log(PENDULUM, hold, seed, seconds, limit, acceleration, NOISE, **true) for seed in (1, 2))
    found = diagnose(axis, [a], [b], dataclasses.replace(Options(jobs=1), effects=rivals))
    return {f.effect: {k: v.value for k, v in f.parameters.items()} for f in found.findings}, found


@pytest.mark.slow
def test_it_is_named_beside_a_velocity_limit(axis):
    found, result = names(axis, 1.2, ACCELERATION, rivals=RIVALS[:4], seconds=5.0)
    assert set(found) == {"acceleration_limit", "velocity_limit"}
    assert found["acceleration_limit"]["limit_rad_s2"] == pytest.approx(ACCELERATION, rel=0.03)
    assert found["velocity_limit"]["limit_rad_s"] == pytest.approx(1.2, rel=0.01)
    assert result.verdict.value == "missing_physics"
    assert result.fit["corrected"].held_out_rms < 1.25 * NOISE


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["held", "linear"])
def test_it_is_named_alone(axis, hold):
    found, result = names(axis, math.inf, ACCELERATION, hold)
    assert set(found) == {"acceleration_limit"}
    assert found["acceleration_limit"]["limit_rad_s2"] == pytest.approx(ACCELERATION, rel=0.03)
    assert result.fit["corrected"].held_out_rms < 1.25 * NOISE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "true", "expected"),
    [
        (math.inf, {}, set()),
        (1.2, {}, {"velocity_limit"}),
        (math.inf, {"more": FORCE}, {"actuator_saturation"}),
        (math.inf, {"kp": 6.0}, set()),
    ],
)
def test_it_is_not_named_where_it_is_not(axis, limit, true, expected):
    assert set(names(axis, limit, math.inf, **true)[0]) == expected


@pytest.mark.slow
def test_it_is_named_among_the_whole_library(axis):
    assert set(names(axis, 1.2, ACCELERATION, rivals=())[0]) == {"acceleration_limit", "velocity_limit"}


def test_more_than_four_times_the_accelerations_that_were_reached_is_not_admissible(axis):
    logs = [[log(PENDULUM, "held", seed, 4.0, math.inf)] for seed in (1, 2)]
    nominal, fitted, held, _ = as_servo(axis, *logs)
    view, experiments = choose_view(fitted, None, nominal), split(fitted, held)
    fitter = Fitter(nominal, with_samples(view, (*experiments[0], *experiments[1]), nominal, None), *experiments, jobs=1)
    cls = effect_class("acceleration_limit")
    scales = fitter.scales_for(cls, "actuator")
    fitter.close()
    assert ACCELERATION < scales.acceleration < 4 * ACCELERATION, "a servo runs past its target"
    for value, admissible in ((ACCELERATION, True), (10 * scales.acceleration, False)):
        assert all(r.holds for r in cls(limit_rad_s2=value).admissible(scales)) == admissible
