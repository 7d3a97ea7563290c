"""Spatial orders that stand out of a residual: also between whole numbers, over many turns, beside a large slow error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from diagnose.data.experiment import prepare
from diagnose.evidence.orders import find_orders
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView
from diagnose.structure.passes import _orders
from mjsim.axis import Axis, Body, Chain, Coupling
from mjsim.effects import effect_class
from mjsim.effects.base import Scales
from mjsim.ode import simulate
from mjsim.recording import Recording

DT = 2.5e-4
# a motor and an arm on a soft spring, as a flexible joint on a bench has them: 7 Hz, in the midst of what it is excited by
BENCH = Axis(
    Chain(
        (Body("motor", 0.0021, 0.004, "motor"), Body("arm", 0.0016, 0.0, "arm")), (Coupling("gearbox", 1.0, 1.6, 0.0012, "arm"),)
    )
)


@pytest.mark.parametrize("order", [3.0, 6.37, 17.81])
def test_an_order_over_twenty_turns(order):
    """A line is 0.05 wide over 126 rad: a coarser grid steps over it."""
    t = DT * np.arange(16_000)
    angle = 40 * np.sin(2 * np.pi * 0.45 * t) + 23 * np.sin(2 * np.pi * 0.7 * t + 1)
    a = [1.0, -np.exp(-DT / 0.3)]
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(t))
    residual = lfilter([1.0 - np.exp(-DT / 0.3)], a, 3.0 * np.sin(order * angle)) + noise
    found = find_orders(residual, angle, np.gradient(angle, DT), np.array([1.0 - np.exp(-DT / 0.3)]), np.array(a), DT)
    assert found[0] == pytest.approx(order, abs=0.015)


@pytest.mark.parametrize(("duration", "dt", "hz"), [(20.0, 2e-3, 0.9), (4.0, 2.5e-4, 160.0), (10.0, 1e-3, 25.0)])
def test_a_mode_begins_near_every_frequency_that_a_recording_can_show(duration, dt, hz):
    scales = Scales(*[1.0] * 11, dt=dt, duration=duration)
    starts = effect_class("extra_flexible_mode").starts(scales)
    frequencies = [np.sqrt(s["stiffness_Nm_rad"] / s["inertia_kgm2"]) / (2 * np.pi) for s in starts]
    assert np.min(np.abs(np.log(np.array(frequencies) / hz))) < np.log(1.3)


@pytest.mark.parametrize("order", [6.0, 11.0])
def test_an_inertia_that_varies_is_sought_over_the_arms_own_motion(order):
    """Its torque goes with the arm's acceleration and speed squared: waves of the motor's angle show its order by chance."""
    dt, n = 2e-3, 8000
    rng = np.random.default_rng(0)
    torque = np.convolve(rng.standard_normal(n), np.ones(20) / 20, "same")
    varies = effect_class("position_dependent_inertia")(place="arm", relative_amplitude=0.17, cycles_per_rev=order, phase_rad=0.7)
    run = simulate(BENCH + varies, torque, dt)
    recording = Recording(run.time, torque, run.velocity + 0.05 * rng.standard_normal(n), run.angle, dt)
    fitter = Fitter(BENCH, MotionView(), (prepare(recording),), (prepare(recording),), 1)
    _, swung, _ = _orders(fitter, fitter.fit(fitter.hypothesis(())))
    assert swung[0] == pytest.approx(order, rel=0.01)
