"""A joint's numbers are called changed only where one of them is, or the file's error is above the noise."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from diagnose.robot.servos.answer import AT_NOISE, _at_noise


@pytest.mark.parametrize(("level", "at_noise"), [(0.99 * AT_NOISE, True), (1.01 * AT_NOISE, False)])
@pytest.mark.parametrize("where", ["fitted", "held"])
def test_noise_is_asked_of_fitted_and_held_out_samples(level, at_noise, where):
    p = SimpleNamespace(noise=2e-4, fitted="fitted", held="held")
    fit = SimpleNamespace(rms=lambda mask: (level if mask == where else 1.0) * p.noise)
    assert _at_noise(SimpleNamespace(problem=p), fit) is at_noise
