"""A servo judged by force: it answers torques that no model knows of, and its answers are no physics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.evidence.rivals import servo
from diagnose.evidence.rivals.servo import size_is_open
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import ForceView
from diagnose.result import Verdict
from diagnose.structure.budget import SearchOptions
from diagnose.structure.search import Search
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import effect_class
from mjsim.recording import Recording

DT, SECONDS, INERTIA, VISCOUS = 4e-3, 10.0, 10.0, 20.0
FEW = ("asymmetric_friction", "coulomb_friction", "gravity_load", "quadratic_friction", "stribeck_friction", "torque_ripple")
NOMINAL = Axis(Chain((Body("motor", 0.85 * INERTIA, 1.3 * VISCOUS, "axis"),), ()))


def moved(rng, unknown, dry=0.0, memory=0.05, ripple=0.0):
    """Ten seconds of smooth moves under a position loop of 5 Hz, a torque of ``unknown`` times the rms needed on the axis."""
    goal, at, k = np.zeros(round(SECONDS / DT)), 0.0, 50
    while k < len(goal):
        s = np.linspace(0, 1, round(rng.uniform(0.4, 2.5) / DT))
        to = rng.uniform(-0.8, 0.8)
        goal[k : k + len(s)] = (at + (to - at) * (10 * s**3 - 15 * s**4 + 6 * s**5))[: len(goal) - k]
        at, k = to, k + len(s)
    speed = np.gradient(goal, DT)
    rms = float(np.sqrt(np.mean((INERTIA * np.gradient(speed, DT) + VISCOUS * speed) ** 2)))
    noise, acting, q, v = rng.standard_normal(len(goal)), 0.0, 0.0, 0.0
    forget, turn, sub = math.exp(-DT / memory), 2 * math.pi * 5, 16
    angle, torque = np.empty(len(goal)), np.empty(len(goal))
    for k in range(len(goal)):
        acting = forget * acting + math.sqrt(1 - forget**2) * noise[k] * unknown * rms
        u = INERTIA * turn**2 * (goal[k] - q) + 1.6 * INERTIA * turn * (speed[k] - v)
        angle[k], torque[k] = q, u
        for _ in range(sub):
            free = u + acting - VISCOUS * v - ripple * rms * math.sin(14.0 * q + 1.0)
            if v == 0.0 and abs(free) <= dry * rms:
                continue
            after = v + DT / sub * (free - math.copysign(dry * rms, v if v != 0.0 else free)) / INERTIA
            after = 0.0 if v * after < 0.0 and abs(free) <= dry * rms else after
            q, v = q + 0.5 * DT / sub * (v + after), after
    angle = 5e-5 * np.round(angle / 5e-5)
    return Recording(DT * np.arange(len(goal)), torque, None, angle, DT, judge="force", loop="closed")


def told(seed, effects=(), **how):
    rng = np.random.default_rng([seed, 4])
    fitted, held = moved(rng, **how), moved(rng, **how)
    return diagnose(NOMINAL, [fitted], [held], Options(effects=effects))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_answer_to_unknown_torques_is_named_nothing(seed):
    result = told(seed, unknown=0.4)
    assert not result.findings
    assert result.verdict is Verdict.UNEXPLAINED
    assert "no known effect reliably lowers that" in result.summary
    assert any("a torque acts that it does not know of" in n for n in result.notes)


@pytest.mark.slow
def test_a_small_error_of_force_is_an_all_clear():
    result = told(3, unknown=0.04)
    assert not result.findings
    assert result.verdict is Verdict.PARAMETERS_ONLY
    assert "No missing physics can be named" in result.summary


@pytest.mark.slow
def test_without_that_rule_it_would_be(monkeypatch):
    monkeypatch.setattr(servo, "IMITATED", set())
    assert told(1, (*FEW, "time_delay"), unknown=0.4).findings


@pytest.mark.slow
@pytest.mark.parametrize(("unknown", "memory"), [(0.15, 0.05), (0.05, 1.0)])
def test_friction_beside_them_is_named(unknown, memory):
    result = told(5, FEW, unknown=unknown, memory=memory, dry=0.3)
    assert [f.effect for f in result.findings] == ["coulomb_friction"]


@pytest.mark.slow
def test_ripple_of_few_periods_is_named_where_it_is_most_of_the_error():
    """Three or four periods over the travel have no other orders beside them to stand out of."""
    result = told(5, FEW, unknown=0.02, ripple=0.3)
    assert [f.effect for f in result.findings] == ["torque_ripple"]
    assert result.findings[0].parameters["cycles_per_rev"].value == pytest.approx(14.0, rel=0.03)


def test_bristles_that_never_slide_are_a_spring():
    """A law of which the data leave a size open is judged as what it then cannot be told from; Coulomb friction's they show."""
    rng = np.random.default_rng([7, 4])
    fitted, held = (prepare(moved(rng, unknown=0.05, dry=0.3)) for _ in range(2))
    fitter = Fitter(NOMINAL, ForceView(), (fitted,), (held,), 1)
    search = Search(fitter, SearchOptions())
    bristles = effect_class("presliding_friction")(place="motor", torque_Nm=300.0, stiffness_Nm_rad=50.0)
    dry = effect_class("coulomb_friction")(place="motor", torque_Nm=8.0)
    assert size_is_open(
        search.context, fitter.fit(fitter.hypothesis((bristles,)), iterations=1), {bristles.key: bristles.amplitudes}
    )
    assert not size_is_open(search.context, fitter.fit(fitter.hypothesis((dry,))), {dry.key: dry.amplitudes})
    fitter.close()
