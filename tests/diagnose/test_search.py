"""The rules of the search that need no recording: how held-out errors of two structures are compared, how work is spread."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from diagnose.fitter import Fitter, HeldOut
from diagnose.search import compare

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


def test_a_model_that_cannot_be_run_is_worth_nothing_and_its_rival_everything(noise):
    assert compare(held(noise), None).p_value == 1.0
    better = compare(None, held(noise))
    assert better.relative_gain == np.inf
    assert better.p_value == 0.0


def test_the_widest_level_of_work_is_spread_and_the_order_kept(pair, robot):
    """Work within a task stays on the task's thread, so that no task waits for a thread that waits for it."""
    from diagnose.experiment import prepare
    from diagnose.view import MotionView

    experiments = tuple(prepare(r) for r in pair())
    fitter = Fitter(robot, MotionView(), experiments[:1], experiments[1:], jobs=2)
    try:

        def outer(i: int) -> tuple[int, bool]:
            mine = threading.get_ident()
            inner = fitter.map([threading.get_ident, threading.get_ident, threading.get_ident])
            return i, all(t == mine for t in inner)

        answers = fitter.map([lambda i=i: outer(i) for i in range(8)])
        assert answers == [(i, True) for i in range(8)]
    finally:
        fitter.close()
