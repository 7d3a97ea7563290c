"""Held-out errors of two models compared in blocks: signed ranks, their sum, and models that cannot be run."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import wilcoxon

from diagnose.evidence.held_out import compare, signed_rank
from diagnose.fit.fitted import HeldOut

N, BLOCKS = 20_000, 40


def held(errors: np.ndarray) -> HeldOut:
    parts = np.array_split(errors, BLOCKS)
    rms = float(np.sqrt(np.mean(errors**2)))
    return HeldOut(errors, np.array([float(p @ p) for p in parts]), np.array([len(p) for p in parts]), rms, rms)


@pytest.fixture
def noise():
    return np.random.default_rng(3).standard_normal(N)


def test_an_effect_that_shows_in_two_blocks_of_forty_is_significant(noise):
    """Ranks are blind to it: 38 blocks say nothing."""
    effect = np.zeros(N)
    effect[9_000:10_000] = 0.8 * np.sin(np.arange(1_000) / 5)
    found = compare(held(noise + effect), held(noise), known=True)
    assert found.relative_gain > 0
    assert found.p_value < 1e-3


def test_predictions_that_differ_by_chance_are_not_significant():
    """200 pairs of models that are both right up to an error of their own: at most the share that the level allows."""
    rng = np.random.default_rng(4)
    alarms = 0
    for _ in range(200):
        e = rng.standard_normal(4_000)
        shift = 0.05 * np.sin(np.arange(4_000) / rng.uniform(3, 300) + rng.uniform(0, 6))
        alarms += compare(held(e), held(e + shift), known=True).p_value < 0.05
    assert alarms <= 10  # 5 % and no more, though the sign of the difference is a coin's


@settings(deadline=None)
@given(st.lists(st.integers(-6, 6), min_size=3, max_size=60).filter(any))
def test_the_signed_rank_test_is_that_of_scipy_ties_and_zeros_too(values):
    d = 0.1 * np.array(values)
    known = wilcoxon(d, alternative="greater", method="approx", correction=False).pvalue
    assert signed_rank(d) == pytest.approx(known, rel=1e-9)


def test_a_model_that_cannot_be_run_is_worth_nothing_and_its_rival_everything(noise):
    assert compare(held(noise), None).p_value == 1.0
    better = compare(None, held(noise))
    assert better.relative_gain == np.inf
    assert better.p_value == 0.0
