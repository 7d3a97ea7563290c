"""When a diagnosis is repeated with the other kind of dry friction, and which of the two counts."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.options import Options
from diagnose.problem.noise_model import KnownNoise
from diagnose.result import FitFigures, Verdict
from diagnose.thresholds import FAR, UNEXPLAINED
from diagnose.verdict.reference_stage import Nominal, by_other_numerics
from mjsim.effects import effect_class
from simgap import either_numerics
from simgap.either_numerics import _better, _far, _open, _others, _soft, by_either_numerics, by_first_effect, open_beyond

FRICTION = SimpleNamespace(effects=(effect_class("coulomb_friction")(torque_Nm=0.1),))
NONE = SimpleNamespace(effects=(effect_class("gravity_load")(torque_Nm=0.1, phase_rad=0.0),))


def result(verdict, rms=1.0, held_out=1.0, findings=()):
    fit = {"corrected": FitFigures(rms, rms, held_out, held_out)}
    return SimpleNamespace(
        verdict=verdict, fit=fit, noise_floor=1.0, findings=findings, linear_parameters={"Jm": None}, channel="velocity"
    )


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
    for chi2, asked in ((49.0, 0), (51.0, 1)):  # of the nominal structure, with the simulator's numerics and with exact ones
        shown = given(simulator=True, shifts=shifts, refitted=SimpleNamespace(chi2=chi2), by_engine=SimpleNamespace(chi2=100.0))
        assert len(list(_others(shown, two))) == asked
        for noise, far in ((FAR * 0.99, asked), (FAR * 1.01, 1)):
            assert len(list(_others(shown, result(Verdict.MISSING_PHYSICS, noise**0.5)))) == far
        assert len(list(_others(shown, result(Verdict.UNEXPLAINED)))) == 1


def test_more_than_noise_is_told_by_the_level_of_the_noise():
    """The squared error is compared with `UNEXPLAINED` times the squared noise, whatever the unit."""
    noise = 0.01
    for factor, far in ((1.001, True), (0.999, False)):
        one = result(Verdict.MISSING_PHYSICS, noise * (UNEXPLAINED * factor) ** 0.5)
        one.noise_floor = noise
        assert _far(one) is far


def test_a_number_costs_its_price_in_twice_the_log_likelihood():
    """One number more pays where n log of the ratio of the mean squares is above the price."""
    n, price = 500, KnownNoise.prices.price
    richer = (SimpleNamespace(kind="physics", law="joint_spring", parameters={"a": None}),)
    for factor, better in ((1.01, True), (0.99, False)):
        rms = math.exp(-0.5 * price * factor / n)
        assert _better(result(Verdict.MISSING_PHYSICS, rms, findings=richer), result(Verdict.UNEXPLAINED), n) is better
    assert not _better(result(Verdict.UNEXPLAINED), result(Verdict.UNEXPLAINED), n)  # the same is not better
    assert _better(result(Verdict.UNEXPLAINED, 0.0), result(Verdict.UNEXPLAINED), n)


@pytest.fixture
def searched(monkeypatch):
    """`by_either_numerics` around made-up searches: (answers in turn, others, seconds, each takes) -> (answer, calls)."""

    def ask(answers, others, seconds=math.inf, takes=1.0, maps=None, **stale):
        now, calls = [100.0], []

        def diagnose(axis, recordings, held_out, options, say, ledger, corrections, surpassed=None):
            at = len(calls)
            calls.append((axis, options.seconds, ledger, corrections))
            now[0] += takes
            if surpassed is not None and maps is not None:
                maps.append("none" if surpassed(answers[at]) else "fitted")
            return answers[at]

        monkeypatch.setattr(either_numerics.time, "monotonic", lambda: now[0])
        monkeypatch.setattr(either_numerics, "diagnose", diagnose)
        monkeypatch.setattr(either_numerics, "_others", lambda *_: iter(others))
        monkeypatch.setattr(either_numerics, "without_difference", lambda diagnosis, nominal: (diagnosis, nominal))
        out = by_either_numerics(made("first"), [], [], Options(seconds=seconds), lambda _: None, "ledger", **stale)
        return out, calls

    return ask


def made(name, n=100):
    case = SimpleNamespace(estimation=np.arange(n + 7) < n)
    return SimpleNamespace(axis=name, cases=(case, case), corrections=lambda: name, shifts=())


def test_the_best_of_several_numerics_counts(searched):
    worse, good, best = (result(Verdict.UNEXPLAINED, rms) for rms in (1.0, 0.9, 0.5))
    others = [("a", made("second")), ("b", made("third"))]
    (axis, nominal, told), calls = searched([good, worse, best], others, seconds=10.0)
    assert (axis, nominal.axis) == ("third", "third")
    assert told == (best, nominal)
    assert [c[0] for c in calls] == ["first", "second", "third"]
    assert [c[1] for c in calls] == [10.0, 9.0, 8.0]
    assert [c[2] for c in calls] == ["ledger", None, None]
    assert [c[3] for c in calls] == ["first", "second", "third"]
    (axis, _, told), _ = searched([best, worse, good], others)
    assert axis == "first"
    assert told[0] is best


@pytest.mark.parametrize("maps", [None, []])
def test_no_other_numerics_are_searched_for_recordings_that_are_taken_otherwise(searched, maps):
    bad, good = (result(Verdict.UNEXPLAINED, rms) for rms in (1.0, 0.5))
    asked = []

    def stale(answer):
        asked.append(answer)
        return True

    (axis, _, told), calls = searched([bad, good], [("a", made("second"))], maps=maps, stale=stale)
    assert (axis, told[0], len(calls), asked) == ("first", bad, 1, [bad])
    assert maps in (None, ["none"])
    searched([bad], [], maps=maps, stale=stale)
    assert asked == [bad]


def test_a_torque_map_is_fitted_only_where_no_other_numerics_are_better(searched):
    """A search that would fit a map asks first; the searches that follow are then not repeated."""
    bad, good = (result(Verdict.UNEXPLAINED, rms) for rms in (1.0, 0.5))
    others = [("a", made("second"))]
    for answers, axis, fates in (([bad, good], "second", ["fitted", "none"]), ([good, bad], "first", ["none", "fitted"])):
        maps = []
        (found, _, told), calls = searched(answers, others, seconds=10.0, maps=maps)
        assert (found, told[0], maps) == (axis, good, fates)  # the second search ends first
        assert [c[:3] for c in calls] == [("first", 10.0, "ledger"), ("second", 9.0, None)]


def test_no_search_begins_when_the_time_is_over(searched):
    others = [("a", made("second")), ("b", made("third"))]
    answers = [result(Verdict.UNEXPLAINED, rms) for rms in (1.0, 0.9, 0.5)]
    assert len(searched(answers, others, seconds=2.0)[1]) == 2
    assert len(searched(answers, others, seconds=2.01)[1]) == 3
    assert len(searched(answers, others, seconds=1.0)[1]) == 1


def test_the_samples_that_count_are_those_of_the_fit(searched):
    """A gain of 8.4 in n log of the squared ratio, n being the 200 samples of both cases: above the price of 8."""
    rms = math.exp(-0.5 * 8.4 / 200)
    richer = (SimpleNamespace(kind="physics", law="joint_spring", parameters={"a": None}),)
    answers = [result(Verdict.UNEXPLAINED), result(Verdict.MISSING_PHYSICS, rms, findings=richer)]
    assert KnownNoise.prices.price == 8.0
    assert searched(answers, [("a", made("second"))])[0][0] == "second"
    answers[1] = result(Verdict.MISSING_PHYSICS, math.exp(-0.5 * 7.9 / 200), findings=richer)
    assert searched(answers, [("a", made("second"))])[0][0] == "first"


@pytest.mark.parametrize("soft", [(), (None,), (None, 1.0), (1.0, None)])
def test_soft_friction_of_any_body_is_soft(soft):
    axis = SimpleNamespace(chain=SimpleNamespace(bodies=[SimpleNamespace(softness=s) for s in soft]))
    assert _soft(axis) is (1.0 in soft)


def test_friction_in_place_of_the_models_own_asks_for_the_other_kind(monkeypatch):
    """A law of friction that creeps explains what soft friction does, down to the noise."""
    law = SimpleNamespace(kind="physics", law="coulomb_friction_with_creep", parameters={})
    found = result(Verdict.MISSING_PHYSICS, findings=(law,))
    assert _open(found, FRICTION)
    assert not _open(found, NONE)
    shifts = (np.ones(3),)
    monkeypatch.setattr(either_numerics, "by_other_friction", lambda nominal: nominal)
    rigid = SimpleNamespace(effects=FRICTION.effects, chain=SimpleNamespace(bodies=()))
    both = dataclasses.replace(given(shifts=shifts), axis=rigid, other=FRICTION)
    assert next(why for why, _ in _others(both, result(Verdict.UNEXPLAINED, 1.1, findings=(law,)))).startswith("dry friction")
    assert [why for why, _ in _others(both, result(Verdict.UNEXPLAINED, 1.1, findings=(PHYSICS,)))][-1].startswith("dry friction")
    bare = dataclasses.replace(both, axis=SimpleNamespace(effects=(), chain=SimpleNamespace(bodies=())))
    assert next(why for why, _ in _others(bare, result(Verdict.UNEXPLAINED, 1.1, findings=(law,)))).startswith("dry friction")


def test_the_nominal_structure_with_one_effect_chooses_where_alone_it_does_not(monkeypatch):
    """By a factor of two, and only where the nominal structure leaves the choice open."""
    rigid = SimpleNamespace(effects=NONE.effects, chain=SimpleNamespace(bodies=()))
    soft = SimpleNamespace(effects=NONE.effects, chain=SimpleNamespace(bodies=(SimpleNamespace(softness=1.0),)))
    case = SimpleNamespace(recording=SimpleNamespace(sha256="", source="log.csv"))
    nominal = dataclasses.replace(given(shifts=(np.ones(3),)), axis=rigid, other=soft, cases=(case,))
    left = {}
    monkeypatch.setattr(either_numerics, "least_by_one", lambda axis, *_: left[axis is soft])
    for exact, by_simulator, chosen in ((100.0, 49.0, True), (100.0, 51.0, False), (10.0, 100.0, False), (math.inf, 9.0, True)):
        left.update({False: exact, True: by_simulator})
        found = by_first_effect(nominal, [], [], Options())
        assert (found.simulator, found.shows_simulator, found.axis is soft) == (chosen,) * 3
        assert open_beyond(found) == (FAR if chosen else UNEXPLAINED)
        assert chosen or found is nominal
    left.clear()
    for decided in (dataclasses.replace(nominal, simulator=True), dataclasses.replace(nominal, shifts=())):
        assert by_first_effect(decided, [], [], Options()) is decided
    assert open_beyond(None) == UNEXPLAINED


def test_friction_that_a_file_lacks_is_soft_with_the_numerics_of_the_simulator():
    rigid = SimpleNamespace(effects=NONE.effects, chain=SimpleNamespace(bodies=()))
    soft = SimpleNamespace(effects=NONE.effects, chain=SimpleNamespace(bodies=(SimpleNamespace(softness=1.0),)))
    exact = dataclasses.replace(given(shifts=(np.ones(3),)), axis=rigid, other=soft)
    simulator = by_other_numerics(exact)
    assert (simulator.simulator, simulator.axis, simulator.other) == (True, soft, rigid)
    back = by_other_numerics(simulator)
    assert (back.simulator, back.axis, back.other) == (False, rigid, soft)
    frictional = SimpleNamespace(effects=FRICTION.effects, chain=rigid.chain)
    own = dataclasses.replace(exact, axis=frictional, other=soft)  # it has friction, of the kind that fits
    assert by_other_numerics(own).axis is frictional
    assert by_other_numerics(dataclasses.replace(exact, other=None)).axis is rigid
