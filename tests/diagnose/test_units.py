"""Neither the size of a machine nor its pace changes an answer: a scaled axis has the same diagnosis, scaled."""

from __future__ import annotations

import dataclasses

import pytest
from robot_axis import effect

from diagnose.pipeline import Options, diagnose

FEW = ("coulomb_friction", "hardening_stiffness", "torque_offset", "time_delay", "actuator_lag", "torque_ripple")
COULOMB = effect("coulomb_friction", torque_Nm=0.1)
DELAY = effect("time_delay", place="actuator", delay_s=2e-3)
RIPPLE = effect("torque_ripple", amplitude_Nm=0.04, cycles_per_rev=6.3, phase_rad=0.5)


def scaled(axis, mass, pace):
    """An axis ``mass`` times as heavy that moves alike in ``pace`` times the time."""
    powers = {"J": 0, "f": -1, "d": -1, "k": -2}
    linear = {p.name: p.value * mass * pace ** powers[p.name[0]] for p in axis.chain.linear_parameters()}
    return axis.with_linear(linear)


def retimed(r, mass, pace):
    """Its recording."""
    return dataclasses.replace(
        r, time=r.time * pace, dt=r.dt * pace, torque=r.torque * mass / pace**2, velocity=r.velocity / pace, sha256=""
    )


HEAVY_AND_SLOW, LIGHT_AND_FAST = (1e3, 5.0), (1e-3, 0.2)


@pytest.mark.parametrize(
    ("hidden", "mass", "pace"),
    [
        pytest.param(COULOMB, *HEAVY_AND_SLOW, id="coulomb_friction, heavy", marks=pytest.mark.slow),
        pytest.param(COULOMB, *LIGHT_AND_FAST, id="coulomb_friction, light", marks=pytest.mark.slow),
        pytest.param(DELAY, *HEAVY_AND_SLOW, id="time_delay, heavy", marks=pytest.mark.slow),
        pytest.param(RIPPLE, *LIGHT_AND_FAST, id="torque_ripple, light", marks=pytest.mark.slow),
    ],
)
def test_a_scaled_machine_has_the_scaled_diagnosis(pair, robot, hidden, mass, pace):
    recordings = pair(hidden, seconds=1.5)
    plain = diagnose(robot, recordings[:1], recordings[1:], Options(jobs=1, effects=FEW))
    assert [(f.effect, f.place) for f in plain.findings] == [(hidden.id, hidden.place)]
    scales_with(robot, recordings, plain, mass, pace)


def scales_with(robot, recordings, plain, mass, pace):
    first, other = (retimed(r, mass, pace) for r in recordings)
    other_size = diagnose(scaled(robot, mass, pace), [first], [other], Options(jobs=1, effects=FEW))
    assert other_size.verdict is plain.verdict
    assert [(f.effect, f.place) for f in other_size.findings] == [(f.effect, f.place) for f in plain.findings]
    units = {"torque_Nm": mass / pace**2, "amplitude_Nm": mass / pace**2, "delay_s": pace}
    for name, estimate in plain.findings[0].parameters.items():
        expected = estimate.value * units.get(name, 1.0)
        assert other_size.findings[0].parameters[name].value == pytest.approx(expected, rel=1e-3, abs=1e-3 * abs(expected))
    assert other_size.gap_closed == pytest.approx(plain.gap_closed, abs=1e-3)
