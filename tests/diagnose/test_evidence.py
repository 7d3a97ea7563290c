"""The tests of one structure against another, at their levels; noise models, the pool and the frozen problem."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.evidence.force_orders import few_periods
from diagnose.evidence.held_out import Comparison
from diagnose.evidence.outcome import PASS, Pair, Veto, first_veto
from diagnose.evidence.rivals import servo
from diagnose.evidence.rivals.few_periods import no_slow_error
from diagnose.evidence.rivals.gain import gains
from diagnose.evidence.rivals.generalises import generalises
from diagnose.evidence.rivals.law import no_error_of_a_law
from diagnose.evidence.rivals.servo import no_answer_of_a_servo
from diagnose.fit.fits import Fits
from diagnose.problem.noise_model import KnownNoise, ModelError
from diagnose.result import Refused
from diagnose.structure.state import Refusal
from diagnose.thresholds import MOST, NEARLY_ALL
from diagnose.verdict.refusals import refusals
from mjsim.effects import effect_class


def structure(*effects, chi2=1000.0):
    """A fitted structure as far as the tests look at it."""
    return SimpleNamespace(effects=effects, key=tuple(sorted(e.key for e in effects)), chi2=chi2, ok=math.isfinite(chi2))


def context(noise=None, gain=0.0, unseen=0.0, held=(0.0, 1.0), blocks=None, law=0.0, travel=1.0, unsure=()):
    """Answers to what the tests ask."""
    noise = noise or KnownNoise()
    return SimpleNamespace(
        prices=noise.prices, gain=lambda *_: gain, unseen_gain=lambda *_: unseen, law_error=lambda _: law,
        compared=lambda *_: Comparison(*held), compared_in_blocks=lambda *_: blocks and Comparison(*blocks),
        fitter=SimpleNamespace(
            noise=noise, scales={"motor": SimpleNamespace(travel=travel)}, problem=SimpleNamespace(unsure=unsure)
        ),
    )  # fmt: skip


def friction():
    return effect_class("coulomb_friction")(torque_Nm=0.1)


def delay():
    return effect_class("time_delay")(place="actuator", delay_s=1e-3)


@pytest.mark.parametrize("noise", [KnownNoise(), ModelError()])
def test_a_gain_must_reach_the_entry_of_its_noise(noise):
    pair, entry = Pair(structure(), structure(friction())), noise.prices.entry
    assert gains(context(noise, gain=entry), pair) is PASS
    assert gains(context(noise, gain=entry - 1.0, unseen=1.0), pair) is PASS
    refused = gains(context(noise, gain=entry - 0.01), pair)
    assert refused == Veto("gain", {"gain": pytest.approx(entry - 0.01), "needed": entry})


def test_what_an_error_of_a_law_may_give_is_no_gain():
    before, after = structure(friction(), chi2=1000.0), structure(friction(), delay(), chi2=900.0)
    assert no_error_of_a_law(context(law=100.0), Pair(before, after)) is PASS
    assert isinstance(no_error_of_a_law(context(law=100.1), Pair(before, after)), Veto)
    assert no_error_of_a_law(context(law=100.1), Pair(before, structure(delay(), chi2=900.0))) is PASS, "not beside it"


def test_held_out_data_judge_by_size_and_chance_over_all_hypotheses():
    prices = KnownNoise.prices
    pair = Pair(structure(), structure(friction()), hypotheses=4)
    clear = (2 * prices.material, prices.p_enter / 4.1)
    assert generalises(context(held=clear), pair) is PASS
    chance = (2 * prices.material, prices.p_enter / 4)
    refused = generalises(context(held=chance), pair)
    assert refused.code == "held_out"
    assert refused.numbers["p_value"] == refused.numbers["largest_p_value"], "it has to lie below"
    assert isinstance(generalises(context(held=(prices.material, 0.0)), pair), Veto), "not material"
    assert generalises(context(held=(0.0, 0.9)), pair).numbers["p_value"] == 1.0, "a probability"
    assert generalises(context(held=chance, blocks=clear), pair) is PASS, "stretches tell where the recordings cannot"


@pytest.mark.parametrize(("noise", "share", "passes"), [
    (ModelError(), MOST - 0.01, False), (ModelError(), MOST, True), (KnownNoise(), 0.0, True),
])  # fmt: skip
def test_a_delay_must_take_more_than_a_servo_answers(noise, share, passes):
    pair = Pair(structure(chi2=1000.0), structure(delay(), chi2=1000.0 * (1.0 - share)))
    assert (no_answer_of_a_servo(context(noise, held=(0.9, 0.0)), pair) is PASS) is passes
    assert (no_answer_of_a_servo(context(noise, held=(share, 0.0)), pair) is PASS) is passes, "nor on held-out data alone"
    pair = Pair(structure(chi2=1000.0), structure(delay(), friction(), chi2=1000.0 * (1.0 - share)))
    assert (no_answer_of_a_servo(context(noise, held=(0.9, 0.0)), pair) is PASS) is passes, "nor beside friction"


@pytest.mark.parametrize("is_open", [True, False])
def test_an_effect_of_an_open_size_is_an_answer_of_a_servo_too(monkeypatch, is_open):
    """Friction is none, unless its size may be zero."""
    asked = []
    monkeypatch.setattr(servo, "open_sizes", lambda f, noise, sizes: asked.append(dict(sizes)) or ([1] if is_open else []))
    known = Pair(structure(delay(), chi2=1000.0), structure(delay(), friction(), chi2=999.0))
    assert (no_answer_of_a_servo(context(ModelError(), held=(0.0, 1.0)), known) is PASS) is not is_open
    assert asked == [{friction().key: friction().amplitudes}], "of what is added"


def times_few(periods):
    return periods * few_periods()


@pytest.mark.parametrize("travel", [1.0, 2.0])
@pytest.mark.parametrize(("periods", "share", "passes"), [
    (0.99, NEARLY_ALL - 0.01, False), (0.99, NEARLY_ALL + 0.01, True), (1.0, 0.0, True),
])  # fmt: skip
def test_a_few_periods_over_the_travel_must_take_most_of_the_error(periods, share, passes, travel):
    def ripple(times):
        order = times * few_periods() * 2 * math.pi / travel
        return effect_class("torque_ripple")(amplitude_Nm=1.0, cycles_per_rev=order, phase_rad=0.0)

    pair = Pair(structure(chi2=1000.0), structure(ripple(periods), friction(), chi2=1000.0 * (1.0 - share)))
    assert (no_slow_error(context(ModelError(), held=(0.95, 0.0), travel=travel), pair) is PASS) is passes
    near = (times_few(periods) * 2 * math.pi + 0.9 * 2 * math.pi) / travel
    asked = context(ModelError(), held=(share, 0.0), travel=travel, unsure=(near,))
    assert (no_slow_error(asked, pair) is PASS) is (share >= NEARLY_ALL), "nor one that stands out taken alone only"
    assert no_slow_error(context(KnownNoise()), pair) is PASS
    pair = Pair(structure(chi2=1000.0), structure(ripple(periods), ripple(50.0), chi2=1000.0 * (1.0 - share)))
    assert (no_slow_error(context(ModelError(), held=(0.95, 0.0), travel=travel), pair) is PASS) is passes, "one of two"
    known = Pair(structure(ripple(0.5), chi2=1000.0), structure(ripple(0.5), friction(), chi2=999.0))
    assert no_slow_error(context(ModelError(), held=(0.0, 1.0), travel=travel), known) is PASS, "it was there before"


def test_what_takes_just_so_much_passes():
    few = effect_class("torque_ripple")(amplitude_Nm=1.0, cycles_per_rev=1.0, phase_rad=0.0)
    for test, effect, level in ((no_slow_error, few, NEARLY_ALL), (no_answer_of_a_servo, delay(), MOST)):
        pair = Pair(structure(chi2=1000.0), structure(effect, chi2=1.0))
        assert test(context(ModelError(), held=(level, 0.0)), pair) is PASS
        assert isinstance(test(context(ModelError(), held=(math.nextafter(level, 0.0), 0.0)), pair), Veto)


def test_a_structure_holds_another_where_it_has_all_of_its_effects_and_more():
    one, two, other = structure(friction()), structure(friction(), delay()), structure(delay())
    assert [Pair(*sides).nested for sides in ((one, two), (one, one), (two, one), (one, other))] == [True, False, False, False]


def test_tests_after_a_veto_are_not_run():
    veto, asked = Veto("first", {}), []

    def refuses(*_):
        return veto

    def counts(*_):
        asked.append(1)
        return PASS

    pair = Pair(structure(), structure(friction()))
    assert first_veto(context(), pair, (counts, refuses, counts)) is veto
    assert first_veto(context(), pair, (counts,)) is PASS
    assert len(asked) == 2


def test_an_unknown_noise_level_is_neither_exceeded_nor_kept():
    known, unknown = KnownNoise(), ModelError()
    assert known.exceeds(1.1, 1.0)
    assert known.within(1.0, 1.0)
    assert not unknown.exceeds(1e9, 1.0)
    assert not unknown.within(0.0, 1.0)
    assert (known.hypotheses(2, 40), unknown.hypotheses(2, 40), unknown.hypotheses(2, 0)) == (2, 40, 1)
    assert known.cost_at(3.0, 100) == 300.0
    assert unknown.cost_at(3.0, 100) == math.inf
    assert known.floor(0.1) == 0.1
    assert math.isnan(unknown.floor(0.1))


def test_the_best_fit_of_each_structure_is_kept_with_its_held_out_error():
    fits, asked = Fits(), []
    fitter = SimpleNamespace(validate=lambda f: asked.append(f.chi2) or f.chi2)
    worse, better = structure(friction(), chi2=20.0), structure(friction(), chi2=10.0)
    fits.keep(worse)
    assert fits.held_out(worse, fitter) == fits.held_out(worse, fitter) == 20.0
    fits.keep(better)
    assert fits.known_held_out(better) is None
    assert fits.held_out(better, fitter) == 10.0, "it is computed again for another fit"
    fits.keep(worse)
    fits.keep(structure(friction(), chi2=math.inf))
    assert fits.best(worse) is better
    assert asked == [20.0, 10.0]
    assert fits.common(worse, structure(delay())) is None


def test_a_problem_is_frozen_and_relaxed_problems_leave_it_as_it_is(fitter_of, pair):
    problem = fitter_of(pair(friction())).problem
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.prior_weight = 2.0
    relaxed = problem.relax(whitening=np.array([1.0, -0.5]), prior_weight=3.0)
    assert (problem.prior_weight, len(problem.whitening)) == (1.0, 1)
    assert (relaxed.prior_weight, len(relaxed.whitening)) == (3.0, 2)
    assert relaxed.scales is problem.scales
    assert problem.with_orders((5.0,)).orders == (5.0,)
    assert problem.orders == ()
    observed = problem.under_observer(100.0)
    assert observed.view.observer_gain == 100.0
    assert problem.view.observer_gain == 0.0


def test_leading_rivals_are_told_with_the_test_that_refused_them():
    best, poorer = structure(friction(), chi2=10.0), structure(chi2=30.0)
    asked, never = structure(friction(), delay(), chi2=9.0), structure(delay(), chi2=50.0)
    refusal = Refusal(asked.key, best.key, Veto("encoder", {"gain": 3.0, "needed": 25.0}))
    selection = SimpleNamespace(needed=lambda rival, best: 25.0 if len(rival.key) > len(best.key) else 0.5)
    search = SimpleNamespace(
        fits={f.key: f for f in (never, best, asked, poorer)},
        criterion=lambda f: f.chi2,
        state=SimpleNamespace(refusals={asked.key: refusal}),
        selection=selection,
    )
    told = refusals(search, best)
    assert [r.effects for r in told] == [asked.key, poorer.key, never.key]
    assert told[0].as_dict() == {
        "effects": list(asked.key), "against": list(best.key), "test": "encoder", "numbers": {"gain": 3.0, "needed": 25.0},
    }  # fmt: skip
    assert told[1] == Refused(poorer.key, best.key, "criterion", {"gain": -20.0, "needed": 0.5})
