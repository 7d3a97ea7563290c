"""Logs of torque and a coarse angle: the noise of the angle's rate hides motion that the angle shows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.evidence.predictable import by_rate_of_angle, error_of_angle, motion_error
from diagnose.evidence.torque_noise import of_torque_noise
from diagnose.fit.fitter import Fitter
from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.problem.view import MotionView
from diagnose.result import Verdict
from diagnose.thresholds import TWICE
from diagnose.verdict.reference import Run, at_noise, cases_of
from mjsim.axis import Axis, Body, Chain
from mjsim.ode import simulate
from mjsim.recording import Recording
from mjsim.system import assemble

DT, N, STEP = 4e-3, 2000, 8e-4
NOMINAL = Axis(Chain((Body("motor", 0.07, 0.4, "hinge"),), ()))
RATE_NOISE = STEP / np.sqrt(12.0) / (np.sqrt(2.0) * DT)
CLEAR = (Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY)


def log(seed, push=0.0):
    """Torque and encoder angle of a rotor; ``push``: amplitude [N m] of a slow torque that is not in the log."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(N)
    u = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.3, 1.1, 3.0))
    angle = simulate(assemble(NOMINAL), u + push * np.sin(2 * np.pi * 0.37 * t + seed), DT).angle
    return Recording(t, u, None, STEP * np.round(angle / STEP), DT, source=f"log_{seed}.csv")


def fitted(*recordings):
    experiments = [prepare(r) for r in recordings]
    fitter = Fitter(NOMINAL, MotionView.of(NOMINAL, recordings), experiments[:1], experiments[1:], 1)
    return fitter, fitter.fit(fitter.hypothesis(()))


@pytest.mark.parametrize(("push", "clear"), [(0.0, True), (0.008, False)])
def test_an_error_below_the_noise_of_the_rate_is_no_all_clear(push, clear):
    logs = [log(1, push), log(2, push)]
    result = diagnose(NOMINAL, logs[:1], logs[1:], Options(jobs=1, judge="motion", effects=("coulomb_friction",)))
    assert result.fit["corrected"].held_out_rms < 1.2 * RATE_NOISE, "the rate alone shows noise"
    assert (result.verdict in CLEAR) is clear
    assert result.verdict in (*CLEAR, Verdict.UNEXPLAINED)


@pytest.mark.parametrize("times", [0.97, 1.03])
def test_twice_the_noise_of_the_angle_is_motion(times):
    fitter, base = fitted(log(1, 0.02), log(2, 0.02))
    try:
        assert by_rate_of_angle(fitter)
        (held,) = fitter.held_out
        ratio = motion_error(fitter, base)
        assert ratio > 100.0
        level = held.angle_noise * np.sqrt(ratio + 1.0) / (times * TWICE)
        scaled = Fitter(NOMINAL, fitter.view, fitter.experiments, (dataclasses.replace(held, angle_noise=level),), 1)
        found = motion_error(scaled, base)
        assert found == (None if times < 1.0 else pytest.approx((times * TWICE) ** 2 - 1.0, rel=1e-6))
        scaled.close()
    finally:
        fitter.close()


def test_a_right_model_leaves_the_noise_of_the_angle():
    fitter, base = fitted(log(1), log(2))
    try:
        assert motion_error(fitter, base) is None
        (held,) = fitter.held_out
        e = error_of_angle(fitter, held, *fitter.own_values(base.hypothesis, base, held))
        assert np.std(e) < 1.3 * held.angle_noise
        correction = 0.1 * np.sin(np.arange(N) * DT)
        moved = error_of_angle(fitter, dataclasses.replace(held, correction=correction), base.axis, None)
        plain = error_of_angle(fitter, held, base.axis, None)
        expected = 0.1 * (1.0 - np.cos(np.arange(N) * DT))
        assert np.max(np.abs(moved - plain - expected + expected.mean())) < 1e-6
    finally:
        fitter.close()


def test_what_the_noise_of_a_torque_makes_of_an_angle():
    clean, noise = log(3), 0.05
    rng = np.random.default_rng(4)
    seen = dataclasses.replace(clean, torque=clean.torque + noise * rng.standard_normal(N))
    expected = np.sqrt(of_torque_noise(NOMINAL, prepare(seen), of_angle=True))
    true = simulate(assemble(NOMINAL), clean.torque, DT).angle
    drawn = [
        np.mean((simulate(assemble(NOMINAL), clean.torque + noise * rng.standard_normal(N), DT).angle - true) ** 2)
        for _ in range(60)
    ]
    assert expected == pytest.approx(np.sqrt(np.mean(drawn)), rel=0.3)


@pytest.mark.parametrize(("off", "quiet"), [(0.0, True), (0.99, True), (1.01, False)])
def test_a_file_agrees_with_a_rate_and_with_its_angle(off, quiet):
    """A slow wave whose rate is below the noise of the rate, and whose angle is so many times twice the angle's noise."""
    wave = np.sin(2 * np.pi * np.arange(N) / N)
    still = simulate(assemble(NOMINAL), log(1).torque, DT).angle
    q = still + STEP / 3.0 * np.random.default_rng(5).standard_normal(N)
    r = dataclasses.replace(log(1), angle=q)
    cases, level = cases_of([r], []), prepare(r).angle_noise
    size = np.sqrt(2.0 * max((off * TWICE * level) ** 2 - np.var(q - still), 0.0))
    runs = [Run(np.gradient(still, DT), still + size * wave, cases[0].start())]
    assert at_noise(cases, runs)
    assert at_noise(cases, runs, angles=True) is quiet
