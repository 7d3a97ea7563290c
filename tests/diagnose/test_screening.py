"""Screening of neighbours by as few samples as give the same answer as all."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import hold_out_blocks, prepare
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import ForceView, MotionView
from diagnose.structure.candidates import candidates
from diagnose.structure.score import screen
from diagnose.structure.screening import Screening, screening_of
from mjsim.effects import effect_class
from mjsim.excitation import chirp
from mjsim.ode import simulate
from mjsim.recording import Recording

DT, N = 5e-4, 16_000
NOISE = 0.05
FRICTION = {"torque_Nm": 0.1}


def recorded(plant, seed, amplitude=0.6):
    rng = np.random.default_rng(seed)
    torque = chirp(N * DT, DT, amplitude, 0.5, 30.0)
    run = simulate(plant, torque, DT)
    speed = run.velocity + NOISE * rng.standard_normal(N)
    return Recording(run.time, torque, speed, run.angle + 1e-4 * rng.standard_normal(N), DT)


@pytest.fixture(scope="module")
def recordings(robot):
    plant = robot.with_linear({"Jm": 1.04 * robot.chain.bodies[0].inertia}) + effect_class("coulomb_friction")(**FRICTION)
    return recorded(plant, 1), recorded(plant, 2, 0.8)


@pytest.fixture(scope="module")
def fitter(robot, recordings):
    """Two recordings, of which every third stretch does not count."""
    experiments = tuple(prepare(r, counts=hold_out_blocks(r)[0]) for r in recordings)
    made = Fitter(robot, MotionView(), experiments, experiments, 1)
    yield made
    made.close()


@pytest.fixture(scope="module")
def base(fitter):
    return fitter.fit(fitter.hypothesis(()))


def test_where_much_is_left_a_part_of_the_samples_is_screened(fitter, base):
    thin = screening_of(fitter, base)
    assert thin.every == 3
    assert thin.base.chi2 / thin.base.n == pytest.approx(base.chi2 / base.n, rel=0.05)
    r = thin.fitter.residual(base.hypothesis)(base.fit.x)
    np.testing.assert_allclose(r, thin.base.fit.residual, atol=1e-9)


def test_its_sensitivities_are_those_of_all_samples(fitter, base):
    thin = screening_of(fitter, base)
    anew = thin.fitter.fit(base.hypothesis, base.fit.x, iterations=1)
    for a, b in zip(anew.fit.J.T, thin.base.fit.J.T, strict=True):
        assert np.linalg.norm(a - b) < 0.03 * np.linalg.norm(b)


@pytest.mark.slow
def test_it_promises_what_all_samples_promise(fitter, base):
    thin, supposed = screening_of(fitter, base), candidates(fitter)
    some = {s.candidate: s.gain for s in thin.screen(supposed)}
    every = screen(fitter, base, supposed)
    large = [s for s in every if s.gain > 0.1 * base.chi2]
    assert len(large) > 10
    for s in large:
        assert some[s.candidate] == pytest.approx(s.gain, rel=0.02)


def test_every_channel_that_is_bound_is_decimated(fitter, robot, recordings):
    whole = [dataclasses.replace(r, **dict.fromkeys(("current", "supply", "temperature"), r.time)) for r in recordings]
    more = Fitter(robot, fitter.view, tuple(prepare(r) for r in whole), (), 1)
    part = screening_of(more, more.fit(more.hypothesis(())))
    more.close()
    assert part.every > 1


def test_what_enters_is_judged_by_all_samples_and_near_its_minimum(fitter, base):
    thin = screening_of(fitter, base)
    (friction,) = thin.screen([c for c in candidates(fitter) if c.key == "coulomb_friction@motor"])
    entered = thin.start((), friction, True)
    full = fitter.fit(entered.hypothesis, entered.fit.x)
    assert entered.n == base.n
    assert full.chi2 <= entered.chi2 < 1.02 * full.chi2
    assert entered.effects[0].values["torque_Nm"] == pytest.approx(FRICTION["torque_Nm"], rel=0.02)
    np.testing.assert_allclose(entered.fit.J, fitter.fit(entered.hypothesis, entered.fit.x, iterations=1).fit.J, atol=1e-6)


def test_what_it_simulates_is_counted(fitter, base):
    thin = screening_of(fitter, base)
    before = fitter.work
    thin.screen(candidates(fitter)[:4])
    assert fitter.work > before
    assert thin.fitter.work == 0


def test_where_little_is_left_all_samples_are_screened(fitter, base):
    right = fitter.fit(fitter.hypothesis((effect_class("coulomb_friction")(**FRICTION),)))
    assert fitter.misfit(right) < 1.1
    assert screening_of(fitter, right).every == 1


def test_where_a_part_would_tell_something_else_all_are_screened(robot, fitter, monkeypatch):
    """A gap strikes at other moments when it is run by other steps: what its run leaves is then no measure."""
    loose = fitter.fit(fitter.hypothesis((effect_class("backlash")(gap_rad=5e-4),)), iterations=1)
    assert loose.rough
    monkeypatch.setattr("diagnose.structure.screening.SMALL", 0.0)
    assert screening_of(fitter, loose).every == 1


@pytest.mark.parametrize("view", [pytest.param(ForceView(), marks=pytest.mark.slow), MotionView()])
def test_errors_that_are_filtered_are_screened_in_full(robot, recordings, view):
    experiment = prepare(recordings[0])
    whitened = Fitter(robot, view, (experiment,), (experiment,), 1).relax(whitening=np.array([1.0, -0.5]))
    f = whitened.fit(whitened.hypothesis(()), iterations=1)
    assert screening_of(whitened, f).every == 1


def test_an_angle_alone_is_screened_in_full(robot, recordings):
    experiment = prepare(dataclasses.replace(recordings[0], velocity=None))
    made = Fitter(robot, MotionView(), (experiment,), (experiment,), 1)
    assert screening_of(made, made.fit(made.hypothesis(()), iterations=1)).every == 1


def test_a_short_recording_is_screened_in_full(robot, recordings):
    experiment = prepare(recordings[0].slice(0, 8000))
    made = Fitter(robot, MotionView(), (experiment,), (experiment,), 1)
    assert screening_of(made, made.fit(made.hypothesis(()), iterations=1)).every == 1


@pytest.mark.slow
def test_a_screening_of_all_samples_is_the_fitter_itself(fitter, base):
    whole = Screening(fitter, base, fitter)
    (best, *_) = screen(fitter, base, candidates(fitter))
    assert whole.screen(candidates(fitter))[0].gain == best.gain
    assert whole.fitter is fitter
