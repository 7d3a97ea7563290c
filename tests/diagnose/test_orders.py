"""Spatial orders that stand out of a residual: also between whole numbers, over many turns, beside a large slow error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from diagnose.orders import find_orders
from mjsim.effects import effect_class
from mjsim.effects.base import Scales

DT = 2.5e-4


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
