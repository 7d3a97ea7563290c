"""How errors are weighed: a sensor that reports in steps tells by its samples where the axis is, not by which of them turn."""

from __future__ import annotations

import numpy as np
import pytest
from robot_axis import effect

STEP, NOISE = 0.4, 0.02  # of the sensor and beside it [rad/s]


@pytest.fixture
def stepped():
    """``stepped(step)``: the sensor's steps."""
    return lambda step=STEP: effect("sensor_quantisation", place="sensor", step=step)


@pytest.fixture
def fitter(fitter_of, pair, stepped):
    return fitter_of(pair(stepped(), noise=NOISE, seconds=3.0))


def test_the_sensitivities_of_a_rounded_model_are_those_ahead_of_the_rounding(fitter, stepped):
    """Secants of the rounded model tell which few samples a small step turns: of the motion they tell nothing."""
    rounded, smooth = fitter.hypothesis([stepped()]), fitter.hypothesis(())
    x = rounded.start
    own = rounded.rounding
    assert [rounded.entries[i].name for i in own] == ["step"]
    shared = [i for i in range(len(x)) if i not in own]
    r, J = fitter.linearised(rounded, x, 1e-3, fitter.run)
    _, expected = fitter.linearised(smooth, smooth.start, 1e-3, fitter.run)
    np.testing.assert_array_equal(r, fitter.residual(rounded)(x))
    np.testing.assert_allclose(J[:, shared], expected, atol=1e-9 * np.max(np.abs(expected)))
    assert np.any(J[:, own[0]]), "its own numbers show in the digits alone"
    assert fitter.problem.slope(smooth) is None
    plain = np.column_stack([fitter.residual(rounded)(x + 1e-3 * np.eye(len(x))[i]) - r for i in shared]) / 1e-3
    off = np.linalg.norm(plain - expected, axis=0) / np.linalg.norm(expected, axis=0)
    assert np.median(off) > 0.1


def test_a_rounded_model_is_fitted_from_afar_and_its_step_stays_where_it_is(fitter, stepped):
    off = {"Jm": 5.2e-4, "kg": 1.6e5, "ka": 0.5e5, "Ja": 1.55}
    found = fitter.fit(fitter.hypothesis([stepped()], off))
    assert found.chi2 < 1.2 * found.n
    assert found.effects[0].step == pytest.approx(STEP, rel=1e-3)
    for name, value in {"Jm": 4.7e-4, "kg": 1.46e5, "ka": 0.458e5, "Ja": 1.66}.items():
        assert found.linear[name] == pytest.approx(value, rel=0.01), name


def test_sensitivities_are_taken_side_by_side_in_either_direction(fitter, stepped):
    refined = fitter.refined(fitter.fit(fitter.hypothesis([stepped()]), iterations=4))
    errors = refined.standard_errors()
    assert np.all(np.isfinite(errors))
    assert refined.fit.x.shape == errors.shape
