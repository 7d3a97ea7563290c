"""A recording for the tests of the app."""

from __future__ import annotations

import numpy as np
import pytest

import simgap


@pytest.fixture(scope="session")
def log():
    """Four seconds of a pendulum at 250 Hz with friction that its model lacks, as CSV."""
    t = np.arange(0, 4, 0.004)
    torque = 3 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    friction = simgap.effects["coulomb_friction"](place="motor", torque_Nm=0.3)
    found = simgap.simulate("pendulum", torque, dt=0.004, effects=[friction])
    velocity = found.velocity + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    rows = "".join(f"{a:.4f},{b:.8g},{c:.8g}\n" for a, b, c in zip(t, torque, velocity, strict=True))
    return ("time_s,torque_Nm,velocity_rad_s\n" + rows).encode()
