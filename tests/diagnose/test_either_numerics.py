"""When a diagnosis is repeated with the other kind of dry friction, and which of the two counts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.result import FitFigures, Verdict
from diagnose.thresholds import UNEXPLAINED
from diagnose.verdict.reference_stage import Nominal
from mjsim.effects import effect_class
from simgap.either_numerics import _better, _open, _others

FRICTION = SimpleNamespace(effects=(effect_class("coulomb_friction")(torque_Nm=0.1),))
NONE = SimpleNamespace(effects=(effect_class("gravity_load")(torque_Nm=0.1, phase_rad=0.0),))


def result(verdict, rms=1.0, held_out=1.0, findings=()):
    fit = {"corrected": FitFigures(rms, rms, held_out, held_out)}
    return SimpleNamespace(verdict=verdict, fit=fit, noise_floor=1.0, findings=findings, linear_parameters={"Jm": None})


@pytest.mark.parametrize("verdict", list(Verdict))
def test_a_search_is_repeated_where_more_than_noise_is_left_beside_friction(verdict):
    above, below = (UNEXPLAINED**0.5 * factor for factor in (1.001, 0.999))
    assert _open(result(verdict, above), FRICTION)
    assert _open(result(verdict, below), FRICTION) is (verdict is Verdict.UNEXPLAINED)
    assert not _open(result(verdict, above), NONE)
    found = (SimpleNamespace(kind="physics", law="stribeck_friction", parameters={}),)
    assert _open(result(verdict, above, findings=found), NONE)


def test_the_other_kind_counts_where_it_fits_better_by_its_price_and_held_out():
    first = result(Verdict.UNEXPLAINED, 1.05)
    assert _better(result(Verdict.PARAMETERS_ONLY), first, 1000)
    assert not _better(result(Verdict.PARAMETERS_ONLY, held_out=1.01), first, 1000)
    richer = (SimpleNamespace(kind="physics", law="joint_spring", parameters=dict.fromkeys("ab")),)
    assert _better(result(Verdict.MISSING_PHYSICS, findings=richer), first, 1000)
    assert not _better(result(Verdict.MISSING_PHYSICS, findings=richer), first, 100)


def given(**what):
    return Nominal(None, FRICTION, None, 0.0, None, (), (), (), 1.0, **what)


PHYSICS = SimpleNamespace(kind="physics", law="joint_spring", parameters={})


def test_the_other_numerics_are_searched_where_an_effect_may_stand_in_for_them():
    shifts = (np.ones(3),)
    one, two = result(Verdict.MISSING_PHYSICS, findings=(PHYSICS,)), result(Verdict.MISSING_PHYSICS, findings=(PHYSICS,) * 2)
    for simulator in (True, False):
        ((why, other),) = _others(given(simulator=simulator, shifts=shifts), two)
        assert other.simulator is not simulator
        assert ("exact" in why) is simulator
        assert list(_others(given(simulator=simulator, shifts=shifts), one)) == []
        assert len(list(_others(given(simulator=simulator, shifts=shifts), result(Verdict.UNEXPLAINED, 1.1)))) == 1
    assert list(_others(given(), two)) == []
