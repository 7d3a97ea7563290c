"""The estimates behind the checks: derivatives, delays with honest errors, and scales of any known factor."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.relation import HOLDS, Relation, Signals, compare_channels, hold_response
from diagnose.check.scale import find_scale, hypotheses
from diagnose.check.spectrum import Spectrum, quantisation_step
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model


def test_derivatives_and_delays_of_a_smooth_signal():
    dt, n = 0.01, 1001
    t = dt * np.arange(n)
    x = 0.3 * t + np.sin(2 * np.pi * t) * np.sin(np.pi * t / 10) ** 4
    s = Spectrum.of(x, dt, 20.0)
    assert s.derivative(0, n - 1) == pytest.approx(x, abs=1e-6)
    assert s.derivative(1, n - 1)[100:-100] == pytest.approx(np.gradient(x, dt)[100:-100], abs=0.02)
    ones = np.ones(len(s.frequency), complex)
    late = s.delayed(0.1, ones, n - 1)
    assert late[50:-50] == pytest.approx(np.interp(t - 0.1, t, x)[50:-50], abs=2e-3)
    both = s.delayed(np.array([0.1, -0.2]), ones, n - 1)
    assert np.array_equal(both[:, 0], late)
    assert len(s.derivative(0, 100)) == 101


def test_holds_differ_by_half_a_sample():
    f, dt = np.array([1.0, 3.0]), 0.02
    phase = {h: np.angle(hold_response(h, f, dt)) / (2 * np.pi * f * dt) for h in HOLDS}
    assert phase["held"] == pytest.approx([-0.5, -0.5])
    assert phase["linear"] == pytest.approx([0.0, 0.0])
    assert phase["mean"] == pytest.approx([0.5, 0.5])


def test_the_impedance_is_that_of_the_rigid_chain_at_low_frequencies():
    m = Machine(load_axis(shipped_model("robot_axis1")))
    f = np.array([0.05])
    n, d = m.impedance(f)
    assert (n / d)[0].imag == pytest.approx(2 * np.pi * f[0] * m.inertia, rel=1e-3)
    # the locked modes are where it is largest
    f = np.linspace(10, 35, 20001)
    z = np.abs(np.divide(*m.impedance(f)))
    peaks = f[1:-1][(z[1:-1] > z[:-2]) & (z[1:-1] > z[2:])]
    assert peaks == pytest.approx(m.locked_modes, rel=0.01)


def test_the_errors_of_the_delay_are_honest(log, machine):
    """Over draws of the noise, the delay scatters as its standard error says."""
    late, errors, delays = 0.011, [], []
    for seed in range(12):
        r = log(rate=500, late=late, seed=seed)
        fit = Relation(Signals(r.dt, r.torque, r.velocity, r.angle), machine(), "velocity").fit()
        delays.append(fit.delay.value)
        errors.append(fit.delay.error)
    assert np.mean(delays) == pytest.approx(late, abs=2e-4)
    assert 0.3 < np.std(delays) / np.mean(errors) < 2.0


def test_ratios_to_the_model(log, machine):
    r = log()
    fit = Relation(Signals(r.dt, r.torque, r.velocity, r.angle), machine(), "velocity").fit()
    assert fit.inertia.value == pytest.approx(0.2 / 0.18, rel=0.05)
    assert fit.gravity.value == pytest.approx(1.1, rel=0.05)
    assert fit.loss.value == pytest.approx(1.0, abs=0.25)
    assert fit.explained > 0.99


def test_angle_against_velocity(log):
    r = log()
    pair = compare_channels(Signals(r.dt, r.torque, 0.1 * r.velocity, r.angle))
    assert pair.ratio.value == pytest.approx(10.0, rel=0.01)
    assert abs(pair.delay.value) < 1e-3


@pytest.mark.slow
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_known_factor_is_found_and_no_other(data, log, machine):
    """A hypothesis undone is chosen, or is among its equivalents; a factor within a parameter's reach is none."""
    m = machine(gain=20.0)
    r = log(gain=20.0, seed=data.draw(st.integers(0, 3)))
    signals = Signals(r.dt, r.torque, r.velocity, r.angle)
    known = [h for h in hypotheses(m, signals) if h.time == 1.0]
    h = data.draw(st.sampled_from(known))
    wrong = dataclasses.replace(h, torque=1 / h.torque, velocity=1 / h.velocity, angle=1 / h.angle).apply(signals)
    found = find_scale(wrong, m)
    assert h in (found.chosen, *found.equivalents)
    small = data.draw(st.floats(0.6, 1.6))
    assert find_scale(Signals(r.dt, small * r.torque, r.velocity, r.angle), m).chosen.kind == "none"


def test_a_recording_too_short_for_the_band_is_not_judged(log, machine):
    short = log().slice(0, 100)
    context = Context(short, machine())
    assert context.fit is None
    assert context.scale is not None
    assert context.scale.chosen.kind == "none"


@pytest.mark.parametrize("step", [1e-3, 0.02])
def test_the_step_of_a_rounded_signal(step):
    x = np.cumsum(np.random.default_rng(0).standard_normal(4000)) * 0.01
    assert quantisation_step(step * np.round(x / step)) == pytest.approx(step)
    assert quantisation_step(x) == 0.0
