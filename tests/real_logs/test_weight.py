"""Friction over the angle of an axis whose load is a weight may be friction by the load: both are named."""

from __future__ import annotations

import math

import numpy as np
import pytest

from diagnose.explain.weight_friction import follows_weight, load_effects
from diagnose.thresholds import NEARLY_ALL
from mjsim.axis import Body, Chain
from mjsim.effects import effect_class
from mjsim.quantity import Motion

CHAIN = Chain((Body("motor", 0.1, 0.05, "j"),), ())
WEIGHT = effect_class("gravity_load")(torque_Nm=3.0, phase_rad=0.0)
ANGLE = np.linspace(-1.6, 1.6, 60)


def friction(cycles, phase, relative=0.5):
    values = {"torque_Nm": 0.3, "relative_amplitude": relative, "cycles_per_rev": cycles, "phase_rad": phase}
    return effect_class("position_dependent_friction")(**values)


@pytest.mark.parametrize(
    ("cycles", "phase", "relative", "alike"),
    [(2.0, -math.pi / 2, 0.5, True), (2.0, 0.0, 0.5, False), (9.0, -math.pi / 2, 0.5, False), (2.0, -math.pi / 2, 0.02, False)],
)
def test_a_level_that_follows_the_weight_is_told(cycles, phase, relative, alike):
    found = follows_weight(friction(cycles, phase, relative), [WEIGHT], CHAIN, ANGLE, 1.0)
    assert (found**2 > NEARLY_ALL) == alike


def test_without_a_weight_there_is_nothing_to_follow():
    assert follows_weight(friction(2.0, 0.0), [], CHAIN, ANGLE, 1.0) == 0.0
    offset = effect_class("torque_offset")(torque_Nm=1.0)
    assert follows_weight(friction(2.0, 0.0), [offset], CHAIN, ANGLE, 1.0) == 0.0
    assert follows_weight(effect_class("coulomb_friction")(torque_Nm=0.3), [WEIGHT], CHAIN, ANGLE, 1.0) == 0.0


def test_effects_of_the_load_are_those_that_say_so():
    assert load_effects(friction(2.0, 0.0)) == ("load_dependent_friction",)
    assert load_effects(WEIGHT) == ()
    assert CHAIN.motion is Motion.HINGE
