"""Fitted in one direction of motion and judged in both: friction, which one direction does not show, is no all-clear."""

from __future__ import annotations

import numpy as np
import pytest
from twins import Bristle, recording, run, wave

from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from mjsim.axis import Axis, Body, Chain

RATE = 100.0
NOMINAL = Axis(Chain((Body("motor", 0.005, 0.01, "j"),), ()))


def log(seed: int, mean: float, swing: float):
    rng = np.random.default_rng(seed)
    t = np.arange(round(4.0 * RATE)) / RATE
    goal = mean + swing * wave(rng, t, 0.3, 2.5)
    u, q, v = run(
        lambda k, _q, v: 0.08 * (goal[k] - v), RATE, 0.006, lambda _t, _q, v, u: u - 0.01 * v, friction=Bristle(0.1),
        samples=len(t), substeps=40,
    )  # fmt: skip
    start = 100 if mean else 0
    noisy = v + 0.02 * rng.standard_normal(len(t)), q + 1e-4 * rng.standard_normal(len(t))
    if mean:
        assert np.min(v[start:]) > 0
    return recording(RATE, u[start:], noisy[0][start:], noisy[1][start:] - q[start], f"{seed}.csv")


@pytest.mark.slow
def test_friction_that_one_direction_hides_is_no_all_clear():
    only = Options(jobs=1, effects=("coulomb_friction",))
    result = diagnose(NOMINAL, [log(1, 8.0, 2.0)], [log(2, 0.0, 8.0)], only)
    assert result.verdict in (Verdict.MISSING_PHYSICS, Verdict.UNEXPLAINED)
    assert any(f.effect in ("coulomb_friction", "presliding_friction") for f in result.findings)
    assert result.linear_parameters["Jm"].value == pytest.approx(0.006, rel=0.01)
