"""An encoder that errs over its turn is told from torques and transmission errors of the same order."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.evidence.encoder import encoder_gain, fit_with_encoder_error, gain_with_encoder_error
from diagnose.evidence.predictable import motion_error
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.result import Verdict
from mjsim.effects import effect_class

LOCKED = ("torque_ripple", "transmission_error", "position_dependent_friction")
ORDER, ERROR = 4.0, 1e-3  # error of the encoder [rad]


def erring(recording, error=ERROR, order=ORDER):
    """The recording as an encoder shows it that errs so many times a turn, by so many radians."""
    q, v = recording.angle, recording.velocity
    return dataclasses.replace(
        recording, angle=q + error * np.sin(order * q + 0.3), velocity=v * (1 + error * order * np.cos(order * q + 0.3))
    )


def gains(robot, recording, effect):
    """What chi-square loses by the encoder and by the effect, on a refitted nominal model."""
    fitter = Fitter(robot, MotionView(), (prepare(recording),), (), 1)
    base = fitter.fit(fitter.hypothesis(()))
    best = min((fitter.fit(fitter.hypothesis([effect.with_values({"phase_rad": p})], base.linear)) for p in (0, 1.6, 3.1, -1.6)),
               key=lambda f: f.chi2)  # fmt: skip
    fitter.close()
    return encoder_gain(fitter, base, effect), base.chi2 - best.chi2


def ripple(amplitude=0.02):
    return effect_class("torque_ripple")(amplitude_Nm=amplitude, cycles_per_rev=ORDER, phase_rad=0.4)


def test_the_encoder_gains_more_where_it_errs(robot, record):
    encoder, effect = gains(robot, erring(record()), ripple())
    assert encoder > 30
    assert encoder > 1.1 * effect


def test_ripple_gains_more_where_there_is_ripple(robot, record):
    encoder, effect = gains(robot, record(ripple()), ripple())
    assert effect > 1000
    assert encoder < 0.6 * effect


@pytest.mark.slow
def test_the_order_need_not_be_known_to_the_last_digit(robot, record):
    exact, _ = gains(robot, erring(record()), ripple())
    off, _ = gains(robot, erring(record()), ripple().with_values({"cycles_per_rev": ORDER * 1.005}))
    assert off == pytest.approx(exact, rel=0.1)


@pytest.mark.slow
def test_an_effect_without_an_order_has_no_such_rival(robot, record):
    assert gains(robot, record(), ripple())[0] >= 0
    fitter = Fitter(robot, MotionView(), (prepare(record()),), (), 1)
    base = fitter.fit(fitter.hypothesis(()))
    assert encoder_gain(fitter, base, effect_class("coulomb_friction")(torque_Nm=0.1)) == 0
    fitter.close()


@pytest.mark.slow
def test_no_physics_is_named_for_it(robot, pair):
    first, other = (erring(r) for r in pair())
    result = diagnose(robot, [first], [other], Options(jobs=1, effects=LOCKED))
    assert result.verdict is not Verdict.MISSING_PHYSICS
    assert not result.findings


def fits(robot, recording, effect):
    fitter = Fitter(robot, MotionView(), (prepare(recording),), (prepare(recording),), 1)
    base = fitter.fit(fitter.hypothesis(()))
    best = fitter.fit(fitter.hypothesis([effect], base.linear))
    fitter.close()
    return fitter, base, best


def test_what_the_encoder_explains_is_no_gain_of_an_effect(robot, record):
    fitter, base, best = fits(robot, erring(record()), ripple(1e-3))
    assert base.chi2 - best.chi2 > 25
    assert gain_with_encoder_error(fitter, base, best) < 0.3 * (base.chi2 - best.chi2)


def test_an_effect_that_is_there_gains_beside_the_encoder(robot, record):
    friction = effect_class("coulomb_friction")(torque_Nm=0.05)
    fitter, base, best = fits(robot, erring(record(friction)), friction)
    assert gain_with_encoder_error(fitter, base, best) > 0.5 * (base.chi2 - best.chi2) > 1000


def test_an_error_of_the_encoder_is_no_missed_motion(robot, record, monkeypatch):
    """Angle and velocity both show it, so that only its repeating with the turn tells it from motion."""
    erred, by_encoder, _ = fits(robot, erring(record(seconds=5)), ripple(1e-3))
    rippled, by_ripple, _ = fits(robot, record(ripple(), seconds=5), ripple(1e-3))
    found = motion_error(erred, by_encoder), motion_error(rippled, by_ripple)
    monkeypatch.setattr("diagnose.evidence.predictable.whole_orders", lambda angle: [])
    before = motion_error(erred, by_encoder), motion_error(rippled, by_ripple)
    assert found[0] < 0.5 * before[0]
    assert found[1] > 0.7 * before[1]


def test_fast_motion_of_a_right_model_is_no_missed_motion(robot, record):
    """The mean of two samples' velocities is not that of the time between: the difference passed for an error of the encoder."""
    fitter, base, _ = fits(robot, record(seconds=5, amplitude=4.0, top=45.0, noise=0.03), ripple(1e-3))
    assert motion_error(fitter, base) == 0.0


@pytest.fixture
def refitted(robot):
    """``refitted(recording)``: a fitter, and the nominal model refitted to a recording that is held out as well."""
    opened = []

    def make(recording):
        opened.append(Fitter(robot, MotionView(), (prepare(recording),), (prepare(recording),), 1))
        return opened[-1], opened[-1].fit(opened[-1].hypothesis(()))

    yield make
    for fitter in opened:
        fitter.close()


def test_parameters_that_bent_to_the_encoder_are_put_right(refitted, record):
    fitter, base = refitted(erring(record(seconds=5), 2e-3))
    beside = fit_with_encoder_error(fitter, base, 25.0)
    assert beside.chi2 > base.chi2, "more is left of what the encoder shows"
    assert motion_error(fitter, beside) < 0.3 * motion_error(fitter, base), "and less of motion"


def test_an_encoder_that_does_not_err_changes_nothing(refitted, record):
    fitter, base = refitted(record())
    assert fit_with_encoder_error(fitter, base, 50.0) is None
