"""The steps in which a sensor reports show in its values, up to noise of some part of a step."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diagnose.data.scales import value_steps
from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from mjsim.signals import plain_step, whole_step


def motion(seed: int) -> np.ndarray:
    """A smooth signal of some five units, 20 000 samples."""
    rng = np.random.default_rng(seed)
    t = np.arange(20_000) * 5e-4
    return sum(3.0 * np.sin(2 * np.pi * f * t + p) for f, p in zip(rng.uniform(0.3, 9, 6), rng.uniform(0, 6, 6), strict=True))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.floats(0.05, 0.6), st.floats(0.05, 0.3), st.booleans())
def test_a_step_is_among_those_found(seed, step, part, before):
    noise = part * step * np.random.default_rng(seed).standard_normal(20_000)
    clean = motion(seed)
    values = step * np.round((clean + noise) / step) if before else step * np.round(clean / step) + noise
    found = value_steps(values, 1.1 * float(np.hypot(part * step, step / np.sqrt(12))))
    assert any(s == pytest.approx(step, rel=5e-3) for s in found)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.floats(0.02, 0.5))
def test_a_signal_without_steps_shows_none(seed, noise):
    values = motion(seed) + noise * np.random.default_rng(seed).standard_normal(20_000)
    # but at the coarse end, where the values' own distribution has lines: a start that is not borne out
    assert all(s > np.ptp(values) / 16 for s in value_steps(values, noise))


def stepped(recording, step):
    """The recording as a sensor shows it that rounds what the noise has moved."""
    return dataclasses.replace(recording, velocity=step * np.round(recording.velocity / step))


@pytest.mark.parametrize(("step", "found"), [(0.2, True), (0.03, False)])
def test_steps_are_named_above_the_noise_and_are_noise_below(robot, pair, step, found):
    first, other = (stepped(r, step) for r in pair())
    result = diagnose(robot, [first], [other], Options(jobs=1, effects=("sensor_quantisation", "coulomb_friction")))
    if found:
        assert [f.effect for f in result.findings] == ["sensor_quantisation"]
        assert result.findings[0].parameters["step"].value == pytest.approx(step, rel=5e-3)
    else:
        assert result.verdict is not Verdict.MISSING_PHYSICS


@pytest.mark.parametrize(("step", "noise"), [(0.34, 0.09), (0.54, 0.06), (0.2, 0.15)])
def test_values_that_were_rounded_last_lie_on_a_grid(step, noise):
    """However broad or narrow their distribution, and where they mostly move by more than a step at once."""
    rng = np.random.default_rng(4)
    t = 5e-4 * np.arange(20_000)
    for top in (3.0, 60.0):
        v = top * np.sin(2 * np.pi * 1.3 * t) ** 5 + noise * rng.standard_normal(len(t))
        rounded = np.round(step * np.round(v / step), 5)  # as a file holds them
        assert value_steps(rounded, noise) == (pytest.approx(step, rel=1e-4),)
    assert whole_step(np.array([])) == 0.0
    assert whole_step(np.array([0.2, 0.4, 0.7])) == 0.0


def test_a_signal_that_moves_by_two_steps_has_the_smaller_one():
    v = np.repeat([0.0, 2.0, 4.0, 3.0, 5.0, 3.0, 1.0], 4)
    assert plain_step(v) == pytest.approx(1.0)
