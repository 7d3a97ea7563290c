"""A stop of the joint is named from its impacts, with its angle; abrupt motion that is no stop is not."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from diagnose.check import Machine, Severity, check_log
from diagnose.check.thresholds import IMPACTS
from mjsim.axis import Axis, Body, Chain
from mjsim.recording import Recording

RATE, SECONDS, INERTIA, VISCOUS, STEPS = 500, 8.0, 0.02, 0.05, 20
MACHINE = Machine(Axis(Chain((Body("motor", 0.8 * INERTIA, VISCOUS, "j"),), ())))


def log(
    stop: float = math.inf, frequency: float = 140.0, low: float = -math.inf, knock: bool = False, seed: int = 0
) -> Recording:
    """A joint that a torque and a weak spring in it move; beyond ``stop`` and ``low`` a spring of ``frequency`` [rad/s] acts."""
    rng, t = np.random.default_rng(seed), np.arange(round(RATE * SECONDS)) / RATE
    tones = [(f, rng.uniform(0.0, 2.0 * np.pi)) for f in (0.7, 1.1, 1.9, 3.1)]
    wave = 0.35 * sum(np.sin(2.0 * np.pi * f * t + p) for f, p in tones) * np.minimum(1.0, t / 0.3)
    h, q, v = 1.0 / RATE / STEPS, 0.0, 0.0
    out = np.empty((3, len(t)))
    for k in range(len(t)):
        u = wave[k] - 0.3 * q
        out[:, k] = u, v, q
        if knock and k == 2000:
            v += 4.0
        for _ in range(STEPS):
            push = 0.0
            if q > stop or q < low:
                beyond = q - stop if q > stop else q - low
                push = -INERTIA * (frequency**2 * beyond + 0.4 * frequency * v)
                push = min(push, 0.0) if q > stop else max(push, 0.0)
            v += h * (u - VISCOUS * v + push) / INERTIA
            q += h * v
    noisy = out + np.array([0.0, 0.01, 0.001])[:, None] * rng.standard_normal(out.shape)
    return Recording(t, noisy[0], noisy[1], noisy[2], 1.0 / RATE, source="log.csv")


def stops(recording: Recording, machine: Machine = MACHINE):
    return [p for p in check_log(machine, [recording]).problems if p.problem == "joint_stop"]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_stop_is_named_with_its_angle(seed):
    (found,) = stops(log(0.6, seed=seed))
    assert found.value == pytest.approx(0.6, abs=0.03)
    assert found.severity is Severity.LIMITS
    assert len(found.marks) >= IMPACTS
    assert "limited" in found.advice


def test_a_stop_at_either_end_is_named():
    found = stops(log(0.6, low=-0.9))
    assert sorted(round(p.value, 1) for p in found) == [-0.9, 0.6]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_motion_without_a_stop_names_none(seed):
    assert stops(log(seed=seed)) == []


def test_an_end_that_the_torque_could_hold_is_no_stop():
    assert stops(log(0.6, frequency=4.0)) == []


def test_fewer_impacts_than_a_stop_makes_are_none():
    whole = log(0.6)
    (found,) = stops(whole)
    second = found.marks[IMPACTS - 2][1]
    third = found.marks[IMPACTS - 1][0]
    assert stops(whole.slice(0, round(RATE * 0.5 * (second + third)))) == []


def test_abrupt_motion_elsewhere_takes_the_answer_back():
    assert stops(log(0.6, knock=True)) == []


def test_a_stop_that_the_model_has_is_not_to_be_added():
    (found,) = stops(log(0.6), dataclasses.replace(MACHINE, range=(-9.0, 0.6)))
    assert "record within the range" in found.advice
    assert "limited" not in found.advice
