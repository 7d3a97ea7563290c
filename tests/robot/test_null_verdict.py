"""A joint's numbers are called changed only where one of them is, or the file's error is above the noise."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.robot.servos.answer import AT_NOISE, UNTOLD, _at_noise, _is_met, _ratios
from diagnose.robot.servos.fit import Number
from mjsim.quantity import Motion


@pytest.mark.parametrize(("level", "at_noise"), [(0.99 * AT_NOISE, True), (1.01 * AT_NOISE, False)])
@pytest.mark.parametrize("where", ["fitted", "held"])
def test_noise_is_asked_of_fitted_and_held_out_samples(level, at_noise, where):
    p = SimpleNamespace(noise=2e-4, fitted="fitted", held="held")
    fit = SimpleNamespace(rms=lambda mask: (level if mask == where else 1.0) * p.noise)
    assert _at_noise(SimpleNamespace(problem=p), fit) is at_noise


def test_a_ratio_that_is_not_told_is_left_out():
    """A friction that the data put at nothing has a logarithm of any size: no interval can be printed of it."""
    numbers = (Number("kp"), Number("damp"), Number("friction"))
    fit = SimpleNamespace(numbers=numbers, x=np.log([10.0, 0.5, 1e-11]))
    V = np.diag([0.01, 0.01, 1e6])
    out = _ratios(SimpleNamespace(now=SimpleNamespace(fit=fit)), V, Motion.HINGE)
    assert list(out) == ["(kv + damping) / kp"]
    assert out["(kv + damping) / kp"].value == pytest.approx(0.05)
    for half, told in ((0.99 * UNTOLD, True), (1.01 * UNTOLD, False)):
        V[2, 2] = (half / 1.96) ** 2 - 0.01
        assert ("friction / kp" in _ratios(SimpleNamespace(now=SimpleNamespace(fit=fit)), V, Motion.HINGE)) is told


@pytest.mark.parametrize(("share", "p_value", "is_met"), [(0.05, 1e-3, True), (0.06, 1e-3, False), (0.06, 0.05, True)])
def test_an_error_above_the_noise_is_met_where_nothing_predicts_it(monkeypatch, share, p_value, is_met):
    monkeypatch.setattr("diagnose.robot.servos.answer.black_box", lambda problem, fit: (share, p_value))
    monkeypatch.setattr("diagnose.robot.servos.answer.tells", lambda problem, error, weights: True)
    p = SimpleNamespace(noise=2e-4, fitted="fitted", held="held")
    s = SimpleNamespace(problem=p, options=SimpleNamespace(remains=0.05))
    fit = SimpleNamespace(rms=lambda mask: 3.0 * p.noise, error=None, weights=None)
    assert _is_met(s, fit) is is_met
    monkeypatch.setattr("diagnose.robot.servos.answer.tells", lambda problem, error, weights: False)
    assert _is_met(s, fit) is (share <= 0.05), "a test that has too few samples clears nothing"
