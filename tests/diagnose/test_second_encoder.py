"""What is between two encoders: a delay, a spring, a gap, or nothing; and which of them is not named for another."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.explain.second_encoder import TERMS, SecondEncoder, judge_second_encoder
from lab.benchmark.experiment import multisine
from lab.benchmark.laws import Laws
from lab.benchmark.plant import free_run
from mjsim.axis import Axis
from mjsim.recording import Recording

NOISE = 2e-5  # [rad], both encoders


def read(laws: Laws, seed: int, *, delay: int = 0, stiffness: float = 0.0, gap: float = 0.0) -> Recording:
    """The sealed plant's motor, and a second encoder behind a massless spring or gap, ``delay`` samples late."""
    rng = np.random.default_rng(seed)
    motion = free_run(laws, multisine(3.0, 0.5, 0.2, 6.0, rng).torque)
    dt = float(motion.time[1])
    q = motion.angle_true
    link = q - (motion.torque / stiffness if stiffness else 0.0) - 0.5 * gap * np.sign(motion.torque)
    late = np.concatenate([np.full(delay, link[0]), link[: len(link) - delay]])
    noise = NOISE * rng.standard_normal((2, len(q)))
    v = motion.velocity_true + 0.01 * rng.standard_normal(len(q))
    return Recording(motion.time, motion.torque, v, q + noise[0], dt, second_angle=0.3 + late + noise[1])


def judged(robot: Axis, **options: float) -> SecondEncoder:
    parts = [[prepare(read(Laws(coulomb_m=0.05), seed, **options))] for seed in (1, 2)]
    result = judge_second_encoder(robot.chain, *parts)
    assert result is not None
    return result


def test_a_delay_is_a_delay_and_no_backlash(robot):
    result = judged(robot, delay=6)
    assert result.found.terms == ("time_delay",)
    assert result.found.values["time_delay"] == pytest.approx(6 * 5e-4, rel=0.01)
    assert "Not needed beside it: wind-up of an elastic gear, backlash, hysteresis" in result.sentence()


@pytest.mark.slow
def test_a_spring_is_a_spring(robot):
    result = judged(robot, stiffness=1000.0)
    assert result.found.terms == ("compliance",)
    assert result.found.values["compliance"] == pytest.approx(1e-3, rel=0.02)


def test_a_gap_is_a_gap(robot):
    result = judged(robot, gap=1e-3)
    assert result.found.terms == ("backlash",)
    assert result.found.values["backlash"] == pytest.approx(1e-3, rel=0.02)


@pytest.mark.slow
def test_a_delay_and_a_spring_are_both_found(robot):
    result = judged(robot, delay=4, stiffness=1000.0)
    assert set(result.found.terms) == {"time_delay", "compliance"}


def test_nothing_is_nothing(robot):
    result = judged(robot)
    assert result.found.terms == ()
    assert result.found.held_out_rms == pytest.approx(NOISE * np.sqrt(2), rel=0.05)
    assert len(result.compared) == 2 ** len(TERMS)


def test_without_a_second_encoder_nothing_is_said(robot):
    one = read(Laws(), 1)
    alone = [prepare(dataclasses.replace(one, second_angle=None))]
    assert judge_second_encoder(robot.chain, alone, alone) is None
