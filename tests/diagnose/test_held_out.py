"""Held-out errors in paired blocks: both tests against plain ways to compute them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import t as student
from scipy.stats import wilcoxon

from diagnose.evidence.held_out import Comparison, compare, signed_rank
from diagnose.fit.fitted import HeldOut
from diagnose.thresholds import FINER


def held_out(errors, n):
    """Errors in blocks of ``n`` samples each."""
    ends = np.cumsum(n)
    sse = np.array([float(np.sum(errors[e - k : e] ** 2)) for e, k in zip(ends, n, strict=True)])
    rms = math.sqrt(float(np.mean(errors**2)))
    return HeldOut(errors, sse, np.array(n), rms, rms)


def by_hand(before, after, known):
    """The score test, block by block."""
    shift, scores, energies = before.errors - after.errors, [], []
    at = 0
    for n in before.n:
        edges = [int(at + n * k / FINER) for k in range(FINER)] + [at + n]
        for low, high in pairwise(edges):
            scores.append(float(np.sum(shift[low:high] * after.errors[low:high])))
            energies.append(float(np.sum(shift[low:high] ** 2)))
        at += n
    energy = np.array(energies)
    variance = float(np.sum(np.square(scores)))
    if known:
        variance = max(variance, float(energy.sum()))
    freedom = max(1.0, energy.sum() ** 2 / float(np.sum(energy**2)) - 1.0)
    used = np.array(before.n) > 0
    gain = float(np.sum((before.sse - after.sse)[used]))
    return float(student.sf(0.5 * gain / math.sqrt(variance), freedom))


@pytest.mark.parametrize("seed", range(4))
def test_signed_ranks_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    d = np.round(rng.standard_normal(40) + 0.2, 1)
    assert np.any(d == 0)
    assert len(np.unique(np.abs(d))) < len(d)
    expected = wilcoxon(d, alternative="greater", method="approx", correction=False).pvalue
    assert signed_rank(d) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(("size", "scale"), [(0.3, 1.0), (0.3, 0.05), (0.3, 3.0)])
def test_the_smaller_p_value_counts_twice(known, size, scale):
    """An error that the richer model does not make; with noise of, below and above the variance that is known."""
    rng = np.random.default_rng(1)
    n = [90, 30, 60, 45, 75]
    noise = scale * rng.standard_normal(sum(n))
    before = held_out(noise + size * np.sin(np.arange(sum(n)) / 7) * scale, n)
    after = held_out(noise, n)
    ranked = signed_rank(before.sse - after.sse)
    expected = min(1.0, 2.0 * min(ranked, by_hand(before, after, known)))
    found = compare(before, after, known=known)
    assert found.p_value == pytest.approx(expected, rel=1e-9)
    assert found.relative_gain == pytest.approx(1.0 - after.chi2 / before.chi2)
    back = compare(after, before, known=known)
    assert back.relative_gain < 0
    assert back.p_value > 0.5


def test_an_effect_that_shows_in_one_block_has_one_degree_of_freedom():
    """Its sub-blocks are all that the difference makes itself felt in."""
    rng = np.random.default_rng(2)
    n = [30] * 12
    noise = rng.standard_normal(sum(n))
    burst = np.zeros(sum(n))
    burst[40:50] = 2.0
    before, after = held_out(noise + burst, n), held_out(noise, n)
    expected = by_hand(before, after, True)
    assert compare(before, after, known=True).p_value == pytest.approx(2 * min(expected, signed_rank(before.sse - after.sse)))
    assert expected > student.sf(3.0, 30)


def test_blocks_without_samples_do_not_count():
    rng = np.random.default_rng(3)
    n = [40, 0, 50, 60, 0]
    noise = rng.standard_normal(sum(n))
    before, after = held_out(1.5 * noise, n), held_out(noise, n)
    full = [40, 50, 60]
    same = compare(held_out(1.5 * noise, full), held_out(noise, full), known=True)
    assert compare(before, after, known=True) == same


def test_what_cannot_be_told():
    one = held_out(np.ones(30), [10, 10, 10])
    assert compare(one, None) == Comparison(-math.inf, 1.0)
    assert compare(None, one) == Comparison(math.inf, 0.0)
    assert compare(None, None) == Comparison(-math.inf, 1.0)
    assert compare(one, one) == Comparison(0.0, 1.0)
    rng = np.random.default_rng(4)
    noise = rng.standard_normal(60)
    for n, told in (([30, 30], False), ([30, 0, 30], False), ([20, 20, 20], True), ([29, 1, 30], True)):
        found = compare(held_out(2 * noise, n), held_out(noise, n))
        assert found.relative_gain == pytest.approx(0.75)
        assert (found.p_value < 1.0) is told, "of two blocks nothing is told"
