"""The score test of a candidate with two directions, of which the base may take up one."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.structure.score import _project
from mjsim.effects import effect_class

N = 400
SPRING = effect_class("joint_spring")(place="motor", stiffness_Nm_rad=2.0, torque_at_zero_Nm=0.5)


@pytest.fixture
def signals():
    """Responses to the stiffness and to the torque at angle zero (N,), and noise of a hundredth of them."""
    t = np.linspace(0.0, 1.0, N)
    rng = np.random.default_rng(4)
    return np.sin(20.0 * t), np.ones(N), 0.01 * rng.standard_normal((2, N))


@pytest.mark.parametrize(("taken", "offset"), [(True, 0.0), (False, 3.0)])
def test_a_torque_that_a_fitted_zero_takes_up_gets_no_amplitude(signals, taken, offset):
    stiff, torque, (noise, other) = signals
    q = (torque + 0.01 * other)[:, None] if taken else np.zeros((N, 1))  # that of the zero, but for what noise makes of it
    q = q / np.linalg.norm(q) if taken else q
    r0 = -2.0 * stiff - offset * torque + noise
    gain, found = _project(SPRING, [r0 + stiff + torque, r0 + stiff - torque], r0, q, move=True)
    assert found.stiffness_Nm_rad == pytest.approx(2.0 * 2.0, rel=0.02)
    assert found.torque_at_zero_Nm == pytest.approx(offset * 0.5, abs=0.02)
    left = r0 - q @ (q.T @ r0)
    assert gain == pytest.approx(float(left @ left), rel=0.02)


def test_one_direction_is_scored_however_little_of_it_is_left(signals):
    stiff, torque, _ = signals
    q = torque[:, None] / np.sqrt(N)
    r0 = -1e-3 * (stiff - np.mean(stiff))
    gain, _ = _project(SPRING, [r0 + torque - r0], r0, q, move=True)
    assert gain == pytest.approx(float(r0 @ r0), rel=1e-6)
