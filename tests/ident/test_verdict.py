"""What is said of a model in words, and the test behind it that the input does anything at all."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from ident import Grade, IOData, bj, judge
from ident.quality import input_effect_p

COLOURS = {"white": ([1], [1]), "slow": ([1], [1, -0.97]), "low-passed": signal.butter(8, 0.4)}


def unrelated(seed, colour, n=1500):
    rng = np.random.default_rng(seed)
    u = signal.chirp(np.arange(n) * 0.005, 0.5, n * 0.005, 30)
    return IOData(u, signal.lfilter(*COLOURS[colour], rng.standard_normal(n)), 0.005)


@pytest.mark.parametrize("colour", list(COLOURS))
def test_the_input_is_said_to_do_nothing_as_often_as_stated(colour):
    alarms = sum(input_effect_p(unrelated(s, colour)) < 0.05 for s in range(300))
    assert alarms / 300 < 0.095  # 5 % nominal; 99.9 % binomial limit


def test_a_weak_effect_under_much_noise_is_seen():
    data = unrelated(1, "slow")
    weak = data.with_signals(data.u, data.y + 5.0 * signal.lfilter([0, 0.1], [1, -0.9], data.u))
    assert input_effect_p(weak) < 1e-3


def test_an_output_that_has_nothing_to_do_with_the_input_is_no_good_model():
    verdict = judge(bj(unrelated(2, "slow"), (1, 1, 1, 1, 1)))
    assert verdict.grade is Grade.NO_EFFECT
    assert "no model of a plant" in verdict.sentences[0]
    assert not verdict.trusted_bands


def test_a_good_model_of_a_noisy_output_says_that_it_is_noisy(bj_truth):
    verdict = judge(bj(bj_truth.record(4000, 3, sigma=3.0), (2, 2, 2, 2, 1)))
    assert verdict.grade is Grade.GOOD
    assert any("Most of the output is noise" in s for s in verdict.sentences)
    assert verdict.trusted_bands
