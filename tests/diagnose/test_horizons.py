"""A free run whose error has many minima is fitted stretch by stretch."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.fit.fitter import Fitter
from diagnose.fit.path import over_horizons
from diagnose.problem.view import MotionView
from mjsim.axis import Axis, Body, Chain, Coupling
from mjsim.effects import effect_class
from mjsim.ode import simulate
from mjsim.quantity import Motion
from mjsim.recording import Recording

DT, N = 1e-3, 8000
GAP = 3e-5
NOMINAL = {"Jm": 40.0, "Ja": 25.0, "fm": 300.0, "kg": 2.5e6, "dg": 350.0}


def gap(width):
    return effect_class("backlash")(place="gearbox", gap_rad=width)


@pytest.fixture(scope="module")
def screw():
    """A ball screw (60 Hz) with a gap of half its deflection, what is known of it (numbers up to 10 % off), and its stiffness."""
    nominal = Axis(
        Chain((Body("motor", 40.0, 300.0, "m"), Body("arm", 25.0, 0.0, "j")), (Coupling("gearbox", 1.0, 2.5e6, 350.0, "j"),),
              Motion.SLIDE), (),
    )  # fmt: skip
    rng = np.random.default_rng(1)
    f = np.geomspace(0.3, 150.0, 300)
    waves = np.sin(2 * np.pi * f * DT * np.arange(N)[:, None] + rng.uniform(0, 6, 300)) / np.sqrt(np.maximum(f, 1.0))
    force = 300.0 * waves.sum(1) / np.std(waves.sum(1))
    true = {name: value * (1 + 0.1 * rng.uniform(-1, 1)) for name, value in NOMINAL.items()}
    run = simulate(nominal.with_linear(true) + gap(GAP), force, DT)
    speed = run.velocity + 2.2e-3 * rng.standard_normal(N)
    return nominal, Recording(run.time, force, speed, run.angle + 1e-7 * rng.standard_normal(N), DT), true["kg"]


@pytest.mark.slow
def test_a_gap_is_found_that_plain_fits_miss(screw):
    nominal, recording, stiffness = screw
    fitter = Fitter(nominal, MotionView(), (prepare(recording),), (), 1)
    deflection = fitter.scales["gearbox"].deflection
    plain = [fitter.fit(fitter.hypothesis([gap(part * deflection)]), iterations=20) for part in (0.1, 0.5)]
    assert min(p.chi2 / p.n for p in plain) > 1.3
    best = min((over_horizons(fitter, p, p.linear) for p in plain), key=lambda f: f.chi2)
    assert best.chi2 < 1.02 * best.n
    assert best.effects[0].gap_rad == pytest.approx(GAP, rel=0.05)
    assert best.linear["kg"] == pytest.approx(stiffness, rel=0.03)
    fitter.close()


def test_a_stretch_of_an_experiment_is_corrected_as_it_was(screw):
    _, recording, _ = screw
    correction = np.linspace(0.0, 1.0, N)
    whole = dataclasses.replace(prepare(recording), correction=correction)
    part = whole.first(0.25)
    assert len(part.recording) == len(part.counts) == len(part.correction) == N // 4
    assert np.array_equal(part.correction, correction[: N // 4])
    measured = MotionView().signals(screw[0], part, None).measured
    assert np.allclose(measured, recording.velocity[: N // 4] + part.correction)
