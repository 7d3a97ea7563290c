"""The target of a servo with limited acceleration: its law beside a plain loop, and a servo on it beside plain MuJoCo."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mjsim.effects import NotApplicableError, effect_class
from mjsim.hold import between
from mjsim.mjcf import load_axis
from mjsim.ode import simulate
from mjsim.servo import Target
from mjsim.trapezoid import finely, parts_of, profiled
from tests.mjsim.profile_logs import DT, log, plain_profile, steps
from tests.mjsim.servo_logs import GEARED, PENDULUM, write


def sines(dt: float, seconds: float) -> np.ndarray:
    t = np.arange(0.0, seconds, dt)
    return 0.6 * np.sin(4.0 * t) + 0.2 * np.sin(11.0 * t + 1.0)


@pytest.mark.parametrize("limit", [0.8, math.inf])
@pytest.mark.parametrize("hold", ["held", "linear"])
@pytest.mark.parametrize("dt", [0.02, 0.0025])
def test_the_law_is_that_of_a_plain_loop(dt, hold, limit):
    u = steps(3.0, dt, 1) if hold == "held" else sines(dt, 3.0)
    found = finely(*between(u, dt, hold), dt, limit, 9.0)
    expected = plain_profile(u, dt, dt / parts_of(dt), limit, 9.0, hold)
    # about a command that it has reached the loop goes to and fro, at half the speed that a step adds: the next move begins so,
    # and lasts less than a second
    assert np.max(np.abs(found - expected)) < 0.5 * 9.0 * dt / parts_of(dt)
    assert np.max(np.abs(found - expected)) < 2e-3 * np.ptp(u)
    h = dt / parts_of(dt)
    v = np.diff(found) / h
    assert np.max(np.abs(v)) <= limit * (1 + 1e-9)
    assert np.max(np.abs(np.diff(v))) <= 9.0 * h * (1 + 1e-6)


def test_a_step_takes_the_shortest_time():
    """2 sqrt(way / A), or way / V + V / A where the speed is limited (Biagiotti, Melchiorri, section 3.2)."""
    dt, way, most = 1e-3, 0.7, 12.0
    for limit, time in ((math.inf, 2 * math.sqrt(way / most)), (1.5, way / 1.5 + 1.5 / most)):
        r = finely(*between(np.r_[0.0, np.full(1500, way)], dt, "held"), dt, limit, most)
        there = np.flatnonzero(np.abs(r - way) > 1e-4 * way)[-1] * dt
        assert there == pytest.approx(time, abs=5 * dt)
        assert np.max(r) < way + most * dt**2
        np.testing.assert_allclose(r[-100:], way, rtol=1e-9)


@pytest.mark.parametrize("hold", ["held", "linear", "mean"])
def test_without_a_bound_the_target_is_the_command(hold):
    start, slope = between(sines(0.02, 3.0), 0.02, hold)
    first, grow = profiled(start, slope, 0.02, math.inf, 1e12)
    if hold == "mean":  # its lines do not meet, and a target is continuous
        assert np.max(np.abs(first + 0.01 * grow - start - 0.01 * slope)[1:]) < 0.01
    elif hold == "linear":
        np.testing.assert_allclose((first, grow), (start, slope), atol=1e-8)
    else:  # it is there within a step
        rest = np.abs(np.diff(start, prepend=start[0]))
        assert np.all(np.abs(first + 0.01 * grow - start) < 0.05 * rest + 1e-12)


@pytest.mark.parametrize(
    ("template", "hold", "limit"),
    [(PENDULUM, "held", 1.2), (PENDULUM, "linear", math.inf), (GEARED, "held", math.inf), (GEARED, "linear", 1.2)],
)
def test_a_servo_follows_it_as_in_plain_mujoco(tmp_path, template, hold, limit):
    axis, r = load_axis(write(tmp_path / "servo.xml", template)), log(template, hold, 1, 4.0, limit)
    gear = axis.chain.gain
    bound = axis + effect_class("acceleration_limit")(limit_rad_s2=10.0 * gear)
    if math.isfinite(limit):
        bound = bound + effect_class("velocity_limit")(limit_rad_s=limit * gear)
    start = np.array([[r.angle[0]], [0.0]])
    errors = [np.std(simulate(a, r.input, DT, initial=start, hold=hold).angle - r.angle) for a in (axis, bound)]
    assert errors[1] < 0.02 * errors[0]


def test_it_is_of_position_servos(tmp_path):
    axis = load_axis(write(tmp_path / "servo.xml", PENDULUM))
    limit = effect_class("acceleration_limit")(limit_rad_s2=4.0)
    assert limit.ports(axis.chain)[0].limit == 4.0
    velocity = dataclasses.replace(axis.chain, servo=dataclasses.replace(axis.chain.servo, target=Target.VELOCITY))
    for chain in (velocity, dataclasses.replace(axis.chain, servo=None)):
        with pytest.raises(NotApplicableError):
            limit.ports(chain)


def test_the_nearest_that_mjcf_has_is_a_velocity_limit(tmp_path):
    chain = load_axis(write(tmp_path / "servo.xml", PENDULUM)).chain
    limit = effect_class("acceleration_limit")(limit_rad_s2=4.0)
    assert limit.native(chain).values == ()
    other, effects = limit.nearest(chain, 0.7)
    assert other == chain
    assert [e.id for e in effects] == ["velocity_limit"]
