"""The rules of the search: how held-out errors are compared, how work is spread, from where structures are extended."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_axis import effect
from scipy.stats import wilcoxon

from diagnose.data.experiment import prepare
from diagnose.evidence import context
from diagnose.evidence.held_out import Comparison, compare, signed_rank
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Status
from diagnose.fit.validation import observed_held_out, predicted_samples
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import Candidate, Screened, inherit, takes_place
from diagnose.structure.moves import at_limits, elsewhere, ground, named, promising, refines, simpler_at, with_other_laws
from diagnose.structure.search import Search
from diagnose.thresholds import FAR, PORTION, PRIOR, PUT_RIGHT
from mjsim.effects import effect_class

N, BLOCKS = 20_000, 40


def held(errors: np.ndarray) -> HeldOut:
    parts = np.array_split(errors, BLOCKS)
    rms = float(np.sqrt(np.mean(errors**2)))
    return HeldOut(errors, np.array([float(p @ p) for p in parts]), np.array([len(p) for p in parts]), rms, rms)


@pytest.fixture
def noise():
    return np.random.default_rng(3).standard_normal(N)


def test_an_effect_that_shows_in_two_blocks_of_forty_is_significant(noise):
    """Ranks are blind to it: 38 blocks say nothing."""
    effect = np.zeros(N)
    effect[9_000:10_000] = 0.8 * np.sin(np.arange(1_000) / 5)
    found = compare(held(noise + effect), held(noise), known=True)
    assert found.relative_gain > 0
    assert found.p_value < 1e-3


def test_predictions_that_differ_by_chance_are_not_significant():
    """200 pairs of models that are both right up to an error of their own: at most the share that the level allows."""
    rng = np.random.default_rng(4)
    alarms = 0
    for _ in range(200):
        e = rng.standard_normal(4_000)
        shift = 0.05 * np.sin(np.arange(4_000) / rng.uniform(3, 300) + rng.uniform(0, 6))
        alarms += compare(held(e), held(e + shift), known=True).p_value < 0.05
    assert alarms <= 10  # 5 % and no more, though the sign of the difference is a coin's


@settings(deadline=None)
@given(st.lists(st.integers(-6, 6), min_size=3, max_size=60).filter(any))
def test_the_signed_rank_test_is_that_of_scipy_ties_and_zeros_too(values):
    d = 0.1 * np.array(values)
    known = wilcoxon(d, alternative="greater", method="approx", correction=False).pvalue
    assert signed_rank(d) == pytest.approx(known, rel=1e-9)


def test_a_model_that_cannot_be_run_is_worth_nothing_and_its_rival_everything(noise):
    assert compare(held(noise), None).p_value == 1.0
    better = compare(None, held(noise))
    assert better.relative_gain == np.inf
    assert better.p_value == 0.0


def coulomb(level=0.1):
    return effect_class("coulomb_friction")(torque_Nm=level)


def test_the_prior_is_nought_at_the_nominal_parameters(fitter_of, pair):
    """Inertias and stiffnesses are held by their logarithm, the others by their ratio."""
    fitter = fitter_of(pair())
    h = fitter.hypothesis(())
    np.testing.assert_allclose(fitter.problem.prior(h, h.start), 0.0, atol=1e-12)
    fitter = fitter.relax(prior_weight=4.0)
    off = fitter.hypothesis((), {"Jm": 2 * fitter.nominal.chain.bodies[0].inertia})
    assert np.max(fitter.problem.prior(off, off.start)) == pytest.approx(2.0 * np.log(2.0) / PRIOR)


def test_what_a_prior_costs_is_no_misfit(fitter_of, pair):
    fitter = fitter_of(pair()).relax(prior_weight=1e4)
    inertia = fitter.nominal.chain.bodies[0].inertia
    off = fitter.fit(fitter.hypothesis((), {"Jm": 1.2 * inertia}), iterations=0)
    errors = off.fit.residual[: -len(fitter.nominal.chain.linear_parameters())]
    assert fitter.misfit(off) == pytest.approx(float(errors @ errors) / off.n)
    assert fitter.misfit(off) < off.chi2 / off.n


def test_sensitivities_are_lent_under_another_weight_of_the_prior(fitter_of, pair):
    """Those of the recordings as they are, those of the prior anew."""
    fitter = fitter_of(pair(coulomb()))
    lender = fitter.fit(fitter.hypothesis([coulomb()]), iterations=3)
    fitter = fitter.relax(prior_weight=100.0)
    asked = []

    def run(tasks):
        asked.append(len(tasks))
        return [task() for task in tasks]

    _, lent = fitter._borrowed(lender.hypothesis, lender.fit.x, lender, 1e-3, run)
    rows = len(fitter.nominal.chain.linear_parameters())
    np.testing.assert_array_equal(lent[:-rows], lender.fit.J[:-rows])
    np.testing.assert_allclose(lent[-rows:], 10.0 * lender.fit.J[-rows:], atol=1e-6)
    assert sum(asked) == 1, "nothing is run for what is known, only the residual there"


def test_who_has_no_sensitivities_lends_none_and_is_sure_of_nothing(fitter_of, pair):
    """Its first differences failed, or nobody asked for them: what it keeps is zero."""
    fitter = fitter_of(pair(coulomb()))
    bare = fitter.fit(fitter.hypothesis([coulomb()]), iterations=0)
    assert fitter._borrowed(bare.hypothesis, bare.fit.x, bare, 1e-3, fitter.map) is None
    assert np.all(np.isinf(bare.standard_errors()))
    assert fitter.fit(bare.hypothesis, bare.fit.x, borrow=bare, secant=True).chi2 < bare.chi2


def test_a_rival_far_from_the_noise_is_fitted_roughly_and_one_near_it_is_not(fitter_of, pair):
    fitter = fitter_of(pair(coulomb(0.3)))
    bare, right = fitter.hypothesis(()), fitter.hypothesis([coulomb(0.2)])
    far, fitted = fitter.fit(bare, rival=True), fitter.fit(bare)
    assert far.chi2 / far.n > FAR
    assert far.fit.iterations < fitted.fit.iterations
    assert far.chi2 < 1.02 * fitted.chi2
    near, exact = fitter.fit(right, rival=True), fitter.fit(right)
    assert near.chi2 / near.n < FAR
    np.testing.assert_allclose(near.fit.x, exact.fit.x, rtol=1e-6)


def test_a_structure_without_an_effect_is_fitted_once(fitter_of, pair):
    fitter = fitter_of(pair(coulomb(0.3)))
    search = Search(fitter, SearchOptions(only=("coulomb_friction",)))
    best = search.run()
    first = search.reduction.without(best, best.effects[0])
    runs = fitter.runs
    assert search.reduction.without(best, best.effects[0]) is first
    assert fitter.runs == runs


def test_the_search_ends_without_the_prior_that_guided_it(fitter_of, pair):
    fitter = fitter_of(pair(coulomb(0.3)))
    weights = []
    search = Search(fitter, SearchOptions(only=("coulomb_friction",)))
    weigh = search.tempering.weigh
    search.tempering.weigh = lambda guide, f: weights.append(guide) or weigh(guide, f)
    free = search.nominal()
    best = search.run()
    assert max(weights) > 1.0, "so large a misfit is guided"
    assert search.fitter.prior_weight == 1.0
    assert search.pool[()].chi2 == free.chi2, "the rival to beat is the freely refitted nominal model"
    assert best.key == ("coulomb_friction@motor",)
    assert best.effects[0].torque_Nm == pytest.approx(0.3, rel=0.01)


def test_what_goes_beside_a_refinement_is_sought_from_its_simpler_form(fitter_of, pair):
    fitter = fitter_of(pair(coulomb()))
    search = Search(fitter, SearchOptions())
    simple = fitter.fit(fitter.hypothesis([coulomb(0.02)]), iterations=1)
    finer = fitter.fit(fitter.hypothesis([effect_class("asymmetric_friction")(torque_Nm=0.02, asymmetry_Nm=0.001)]), iterations=1)
    assert ground(finer, search.pool) is finer, "the simpler form is not known yet"
    search.keep(simple)
    assert finer.chi2 > 1.5 * finer.n
    assert ground(finer, search.pool) is simple
    done = fitter.fit(fitter.hypothesis([effect_class("asymmetric_friction")(torque_Nm=0.1, asymmetry_Nm=0.001)]))
    assert ground(done, search.pool) is done, "nothing is missing beside it"


def test_coloured_noise_is_whitened_before_anything_is_sought_in_it(robot, pair):
    """And an offset of the sensor, which is no motion either, is not whitened away."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(8)

    def coloured(r, offset):
        noise = lfilter([1.0], [1.0, -0.9], 0.05 * rng.standard_normal(len(r)))
        return dataclasses.replace(r, velocity=r.velocity + noise + offset)

    few = ("coulomb_friction", "sensor_offset", "torque_offset", "actuator_lag")
    for offset, expected in ((0.0, []), (0.4, ["sensor_offset"])):
        first, other = (coloured(r, offset) for r in pair())
        result = diagnose(robot, [first], [other], Options(jobs=1, effects=few))
        assert [f.effect for f in result.findings] == expected
        # the floor is that of the noise there is, and what is left is no mismatch
        assert result.noise_floor == pytest.approx(np.hypot(0.05, 0.05 / np.sqrt(1 - 0.81)), rel=0.1)
        assert result.fit["corrected"].held_out_rms < 1.1 * result.noise_floor
        if not offset:
            assert result.mismatch.above_noise < 0.1
    first, other = (dataclasses.replace(coloured(r, 0.0), angle=None) for r in pair())
    blind = diagnose(robot, [first], [other], Options(jobs=1, effects=("coulomb_friction", "actuator_lag")))
    assert not blind.findings
    assert any("one channel alone" in note for note in blind.notes)


def test_an_effect_of_no_size_is_dropped_though_the_nominal_model_had_gone_wrong(pair, robot):
    """A nominal fit that ended at a wrong minimum must not make evidence for what only showed the way out of it."""
    first, other = pair()
    fitter = Fitter(robot, MotionView(), (prepare(first),), (prepare(other),), 1)
    search = Search(fitter, SearchOptions())
    good = search.nominal()
    friction = effect_class("coulomb_friction")(place="arm", torque_Nm=0.0)
    richer = fitter.fit(fitter.hypothesis((friction,), good.linear), iterations=3)
    wrong = {name: value * (3.0 if name == "kg" else 1.0) for name, value in good.linear.items()}
    stuck = fitter.fit(fitter.hypothesis((), wrong), iterations=0)
    stuck = dataclasses.replace(stuck, fit=dataclasses.replace(stuck.fit, status=Status.CONVERGED))
    search.pool.put(stuck)
    search.pool.put(richer)
    assert stuck.chi2 > 2 * richer.chi2
    assert search.reduction.eliminate(richer).key == ()
    assert search.nominal().chi2 < 1.01 * good.chi2
    fitter.close()


def test_what_the_angle_shows_is_taken_in_first(robot, pair):
    """A velocity that drifts from the angle has an offset, whatever else is missing."""
    hidden = (
        effect("sensor_offset", place="sensor", value=0.2),
        effect("friction_drift", torque_Nm=0.04, relative_change=1.5, time_constant_s=1.0),
    )
    few = ("coulomb_friction", "friction_drift", "asymmetric_friction", "sensor_offset", "torque_offset", "gravity_load")
    first, other = pair(*hidden, seconds=5.0)
    result = diagnose(robot, [first], [other], Options(jobs=1, effects=few))
    assert {f.effect for f in result.findings} == {"sensor_offset", "friction_drift"}


def test_held_out_data_judge_structures_of_one_size_as_well(fitter_of, pair):
    fitter = fitter_of(pair(effect("coulomb_friction", torque_Nm=0.1)))
    search = Search(fitter, SearchOptions())
    right = fitter.fit(fitter.hypothesis([effect("coulomb_friction", torque_Nm=0.1)]))
    wrong = fitter.fit(fitter.hypothesis([effect("torque_offset", torque_Nm=0.01)], right.linear))
    flattered = dataclasses.replace(wrong, fit=dataclasses.replace(wrong.fit, cost=0.5 * right.chi2))
    for f in (right, flattered):
        search.pool.put(f)
    assert search.criterion(flattered) < search.criterion(right)
    assert search.selection.best(right) is right, "by the estimation data alone it would be the other"


def test_a_held_out_run_that_goes_astray_judges_as_far_as_it_foretells(fitter_of, pair, monkeypatch):
    first, other = pair(coulomb())
    half = np.arange(len(other)) < len(other) // 2
    lost = np.where(half, 0.0, 5.0 * np.sin(np.arange(len(other)) / 20))
    fitter = fitter_of((first, dataclasses.replace(other, velocity=other.velocity + lost)))
    search = Search(fitter, SearchOptions())
    base, right = search.nominal(), fitter.fit(fitter.hypothesis([coulomb()]))
    monkeypatch.setattr(Fitted, "rough", property(lambda f: f.key == right.key))
    monkeypatch.setattr(context, "observed_held_out", lambda by, f, gain: None)
    monkeypatch.setattr(context, "predicted_samples", lambda by, f: [half] if f is right else None)
    blind = compare(search.held_out(base), search.held_out(right), known=True)
    judged = search.context.compared(base, right)
    assert judged.relative_gain > 3 * blind.relative_gain
    assert judged.p_value < 1e-6
    assert search.context.compared(right, base).relative_gain < 0, "and it speaks against the other just as far"
    monkeypatch.setattr(context, "predicted_samples", lambda by, f: None)
    search.context.memo.predicted.clear()
    assert search.context.compared(base, right) == blind


def test_a_held_out_run_that_goes_astray_is_judged_by_led_models_too(fitter_of, pair, monkeypatch):
    """Static friction beside an effect not yet found left 1.2 of the noise for Coulomb friction's 105, and was refused."""
    first, other = pair(coulomb())
    more = 5.0 * np.sin(np.arange(len(other)) / 20)  # of motion: both sensors see it
    turned = dataclasses.replace(other, velocity=other.velocity + more, angle=other.angle + np.cumsum(more) * other.dt)
    fitter, clean = fitter_of((first, turned)), fitter_of((first, other))
    search = Search(fitter, SearchOptions())
    base, right = search.nominal(), fitter.fit(fitter.hypothesis([coulomb()]))
    monkeypatch.setattr(Fitted, "rough", property(lambda f: f.key == right.key))
    monkeypatch.setattr(context, "predicted_samples", lambda by, f: None)
    monkeypatch.setattr(context, "observed_held_out", lambda by, f, gain: observed_held_out(clean, f, gain))
    blind = compare(search.held_out(base), search.held_out(right), known=True)
    led = compare(*(observed_held_out(clean, f, PUT_RIGHT) for f in (base, right)), known=True)
    assert blind.p_value > 2 * led.p_value
    assert search.context.compared(base, right) == Comparison(led.relative_gain, 2 * led.p_value)
    nearly = dataclasses.replace(right, fit=dataclasses.replace(right.fit, cost=right.n + 0.02 * (base.chi2 - base.n)))
    search.pool._held[right.key] = search.held_out(right)
    assert search.context.compared(base, nearly) == blind, (
        "it leaves too much on the estimation data to be right but for its events"
    )


def test_only_laws_that_stick_or_strike_go_astray(fitter_of, pair):
    fitter = fitter_of(pair(coulomb()))
    assert predicted_samples(fitter, fitter.fit(fitter.hypothesis(()))) is None


def test_a_move_sideways_is_judged_directly_where_the_error_is_the_models_own(fitter_of, pair):
    """Two gains from far off, each counted by its own samples' worth, may say the contrary of the two structures' own errors."""
    fitter = fitter_of(pair(coulomb()))
    search = Search(fitter, SearchOptions())
    search.nominal()
    right = fitter.fit(fitter.hypothesis([coulomb()]))
    wrong = fitter.fit(fitter.hypothesis([effect("torque_offset", torque_Nm=0.01)], right.linear))
    nearly = dataclasses.replace(wrong, fit=dataclasses.replace(wrong.fit, cost=1.1 * right.chi2))
    for f in (right, nearly):
        search.pool.put(f)
    search.pool._held = {k: search.held_out(right) for k in (right.key, nearly.key)}  # held-out data do not tell them apart
    search.context.worth_of = lambda poorer, richer: 0.1 if richer.key == right.key else 1.0
    assert search.context.ahead(nearly, right) > 0
    assert search.selection.best(right) is right


def test_a_held_out_run_that_needs_a_phase_of_its_own_is_judged_with_it(fitter_of, pair, monkeypatch):
    """A model whose phase of the fitted recording cannot be run on the held-out one: its error there was divided by nought."""
    fitter = fitter_of(pair(effect("torque_ripple", amplitude_Nm=0.02, cycles_per_rev=4.0, phase_rad=0.3)))
    found = fitter.fit(fitter.hypothesis([effect("torque_ripple", amplitude_Nm=0.02, cycles_per_rev=4.0, phase_rad=0.3)]))
    own = fitter.own_values(found.hypothesis, found, fitter.held_out[0])[0]
    run = MotionView.signals
    monkeypatch.setattr(MotionView, "signals", lambda self, axis, *rest: run(self, axis, *rest) if axis == own else None)
    assert 0 < fitter.validate(found).nrmse < 0.1


def test_another_law_of_the_same_name_stands_once_it_fits_better_and_no_worse_on_held_out_data(fitter_of, pair):
    fitter = fitter_of(pair(coulomb()))
    search = Search(fitter, SearchOptions())
    search.nominal()
    plain = fitter.fit(fitter.hypothesis([coulomb()]))
    form = effect("coulomb_friction_with_creep", torque_Nm=coulomb().torque_Nm, creep_velocity_rad_s=0.5)
    creeping = fitter.fit(fitter.hypothesis([form], plain.linear), iterations=0)
    assert named(creeping) == named(plain)
    better = dataclasses.replace(creeping, fit=dataclasses.replace(creeping.fit, cost=0.99 * plain.chi2))
    here = search.held_out(plain)

    def scaled(factor: float) -> HeldOut:
        return dataclasses.replace(here, errors=here.errors * factor, sse=here.sse * factor**2)

    search.pool._held = {plain.key: here, better.key: scaled(0.9999)}
    assert search.significance.better_law(plain, better)
    assert not search.significance.better_law(search.nominal(), better), "of another name"
    search.pool._held[better.key] = scaled(1.0001)
    assert not search.significance.better_law(plain, better), "held-out data speak against it"
    search.pool._held[better.key] = scaled(0.9999)
    level = dataclasses.replace(creeping, fit=dataclasses.replace(creeping.fit, cost=0.9999 * plain.chi2))
    assert not search.significance.better_law(plain, level), "no better on the estimation data"


def test_what_comes_near_is_tried_by_its_other_laws(fitter_of, pair):
    """As large as the best, nearly as good, and of an effect that has another law; not what is far off or has none."""
    fitter = fitter_of(pair(coulomb()))
    search = Search(fitter, SearchOptions())
    best = search.nominal()
    stribeck = effect("stribeck_friction", torque_Nm=0.1, extra_static_torque_Nm=0.1, stribeck_velocity_rad_s=1.0)
    others = effect("torque_offset", torque_Nm=0.01), stribeck, effect("quadratic_friction", coefficient_Nm_s2_rad2=1e-3)
    effects = (coulomb(), *others)
    fits = [fitter.fit(fitter.hypothesis([e], best.linear), iterations=0) for e in effects]
    costs = (1.01, 1.0, 1.05, 1.05)
    friction, offset, *_ = fits = [
        dataclasses.replace(f, fit=dataclasses.replace(f.fit, cost=c)) for f, c in zip(fits, costs, strict=True)
    ]
    pool = {f.key: f for f in (best, *fits)}
    near = [f.key for f in with_other_laws(pool, search.state.candidates, offset, 0.1)]
    assert near == [("coulomb_friction@motor",), ("stribeck_friction@motor",)]
    assert with_other_laws(pool, search.state.candidates, offset, 0.005) == []
    assert with_other_laws(pool, search.state.candidates, friction, 0.1) == [], "what refines it fits as it does"


def test_a_structure_is_promising_by_how_far_chi_square_falls_whatever_the_level_of_the_noise(fitter_of, pair):
    fitter = fitter_of(pair(coulomb()))
    search = Search(fitter, SearchOptions())
    base = search.nominal()
    larger = fitter.fit(fitter.hypothesis([coulomb()], base.linear), iterations=0)
    quiet = dataclasses.replace(base, fit=dataclasses.replace(base.fit, cost=1.0 * base.n))
    for share, told in ((0.6, True), (0.8, False)):
        f = dataclasses.replace(larger, fit=dataclasses.replace(larger.fit, cost=share * base.n))
        assert bool(promising({f.key: f}, quiet, set())) is told
    assert promising({f.key: f}, quiet, {f.key}) == []


def test_a_gain_on_all_of_a_held_out_run_counts_where_what_is_foretold_of_it_says_nothing(fitter_of, pair, monkeypatch):
    """Static friction in a loop left 1.07 of the noise on held-out data for Coulomb friction's 2.27, and was refused."""
    first, other = pair(coulomb())
    start = np.arange(len(other)) < 500
    lost = np.where(np.arange(len(other)) > len(other) - 1000, 0.2 * np.sin(np.arange(len(other)) / 20), 0.0)
    fitter = fitter_of((first, dataclasses.replace(other, velocity=other.velocity + lost)))
    search = Search(fitter, SearchOptions())
    base, right = search.nominal(), fitter.fit(fitter.hypothesis([coulomb()]))
    monkeypatch.setattr(Fitted, "rough", property(lambda f: f.key == right.key))
    monkeypatch.setattr(context, "observed_held_out", lambda by, f, gain: None)
    monkeypatch.setattr(context, "predicted_samples", lambda by, f: [start & ~start] if f is right else None)
    own = fitter.validate
    monkeypatch.setattr(fitter, "validate", lambda f, samples=None: own(f) if samples is None else held(np.zeros(N)))
    on_all = compare(search.held_out(base), search.held_out(right), known=True)
    judged = search.context.compared(base, right)
    assert judged.relative_gain == on_all.relative_gain > 0.5
    assert judged.p_value == min(1.0, 2 * on_all.p_value) < 1e-6


def test_what_a_better_law_may_still_miss_is_no_effect_of_its_own(fitter_of, pair):
    """Where another law of an effect changed much, a hundredth of that is no evidence for anything beside it; of less, more."""
    fitter = fitter_of(pair(coulomb()))
    search = Search(fitter, SearchOptions())
    levels = {"torque_Nm": 0.1, "extra_static_torque_Nm": 0.05, "stribeck_velocity_rad_s": 1.0}
    load = effect("gravity_load", place="arm", torque_Nm=0.1, phase_rad=0.0)
    own = fitter.fit(fitter.hypothesis([effect("stribeck_friction", **levels)]), iterations=0)
    exponent = effect("stribeck_friction_with_exponent", **levels, exponent=1.0)
    other = fitter.fit(fitter.hypothesis([exponent]), iterations=0)
    richer = fitter.fit(fitter.hypothesis([*other.effects, load], other.linear), iterations=0)
    costs = {own: 50.0, other: 1.2, richer: 1.0}
    own, other, richer = (dataclasses.replace(f, fit=dataclasses.replace(f.fit, cost=c * f.n)) for f, c in costs.items())
    assert search.context.law_error(other) == 0.0, "nobody knows what the contract's own law leaves"
    search.keep(own)
    assert search.context.law_error(own) == 0.0
    assert search.context.law_error(other) == pytest.approx((0.01 * 48.8 + 0.02) * other.n)
    assert not search.significance.significant(other, richer)
    assert search.context.floor(other) > 3_000
    near = dataclasses.replace(own, fit=dataclasses.replace(own.fit, cost=1.5 * own.n))
    search.pool.clear()
    search.pool._least.clear()
    search.keep(near)
    assert search.context.law_error(other) == pytest.approx(0.03 * 0.3 * other.n)
    search.keep(own)
    search.pool.clear()
    assert search.context.law_error(other) > 0.0, "what has left the pool was fitted all the same"


def test_a_rival_without_hope_is_not_fitted_on(fitter_of, pair):
    """Where a structure leaves noise alone, what a rival's sensitivities foretell tells whether to go on."""
    fitter = fitter_of(pair(coulomb(0.3)))
    search = Search(fitter, SearchOptions())
    right = fitter.fit(fitter.hypothesis([coulomb(0.3)]))
    poor = fitter.fit(fitter.hypothesis([coulomb(0.3)]), iterations=1)
    beside = [*right.effects, effect("gravity_load", place="arm", torque_Nm=1e-4, phase_rad=0.0)]
    idle = fitter.fit(fitter.hypothesis(beside, right.linear), iterations=2)
    assert not search.race.promising(right, idle, search.context.floor(right))
    assert search.race.promising(search.nominal(), poor, search.context.floor(right)), "far from noise all go on"
    assert search.race.promising(idle, dataclasses.replace(right, fit=right.fit), -10.0), "as good, and simpler"


def test_an_effect_that_explains_little_of_much_creeps_whatever_the_prior_weighs(fitter_of, pair):
    """A case ended with an error: what the prior cost under a new weight was more than all that the older fit had left."""
    fitter = fitter_of(pair(coulomb(0.3)))
    search = Search(fitter, SearchOptions())
    base = search.nominal()
    trifle = fitter.fit(fitter.hypothesis([effect("quadratic_friction", coefficient_Nm_s2_rad2=1e-9)], base.linear), iterations=0)
    right = fitter.fit(fitter.hypothesis([coulomb(0.3)]))
    for weight in (1.0, 1e9):
        search.use(fitter.relax(prior_weight=weight))
        assert search._creeps(base, trifle)
        assert not search._creeps(base, right), "it leaves noise"


def test_a_structure_that_leaves_less_than_noise_leaves_something_if_that_has_a_colour(fitter_of, pair):
    fitter = fitter_of(pair(coulomb()))
    search = Search(fitter, SearchOptions())
    right, wrong = fitter.fit(fitter.hypothesis([coulomb()])), search.nominal()
    less = [dataclasses.replace(f, fit=dataclasses.replace(f.fit, cost=0.8 * f.n)) for f in (right, wrong)]
    assert not search.context.visible(right)
    assert not search.context.visible(less[0])
    assert search.context.visible(less[1])
    assert search.context.visible(wrong)


def test_near_the_end_of_what_may_be_simulated_rivals_are_begun_a_few_at_a_time(fitter_of, pair):
    """All that a race begins was begun at once, and it passed the end by as much as it takes."""
    fitter = fitter_of(pair(coulomb(0.3)))
    search = Search(fitter, SearchOptions())
    base = search.nominal()
    ranked = [
        (base.effects, s)
        for s in search.race.look(base).screen(search.state.candidates)
        if s.candidate.id != "presliding_friction"
    ]
    slow = effect("presliding_friction", torque_Nm=50.0, stiffness_Nm_rad=2e3)  # which never slides
    stiff = (base.effects, Screened(Candidate(slow.id, slow.place), slow, 1e3, (slow,)))
    fitter.allow(fitter.runs + 1)
    ranked = search.race._within_reach(base, [stiff, *ranked])[: 3 * PORTION]
    assert stiff not in ranked, "what is slow to run is not begun at all"
    assert "too slow" in search.state.failed[slow.key], "and not dropped in silence"
    assert len(ranked) == 3 * PORTION
    assert len(search.race.run(base, ranked)) == PORTION
    assert search.race.run(base, ranked) == []
    fitter.allow(math.inf)
    assert len(search.race.run(base, ranked)) == 3 * PORTION
    assert stiff in search.race._within_reach(base, [stiff])
    assert slow.key not in search.state.failed


def test_a_law_at_the_edge_of_its_numbers_is_the_law_of_fewer(fitter_of, pair):
    """Static friction that ended in another minimum lost to Stribeck friction which faded over a speed far below the noise."""
    sticks = effect("static_friction", torque_Nm=0.1, peak=1.8)
    fitter = fitter_of(pair(sticks))
    search = Search(fitter, SearchOptions())
    level = {"torque_Nm": 0.1, "extra_static_torque_Nm": 0.08, "stribeck_velocity_rad_s": 0.003}
    base = fitter.fit(fitter.hypothesis([effect("stribeck_friction", **level)]), iterations=3)
    assert [e.key for (e,) in at_limits(base)] == [sticks.key]
    search.starts.limits(base)
    assert search.pool[(sticks.key,)].chi2 < 1.01 * base.chi2
    (found,) = search.pool[(sticks.key,)].effects
    assert found.torque_Nm == pytest.approx(0.1, rel=0.05)
    assert found.peak == pytest.approx(1.8, rel=0.05)
    search.pool.clear()
    search.state.tried.clear()
    search.state.consider(tuple(c for c in search.state.candidates if c.id != sticks.id))
    search.starts.limits(base)
    assert not search.pool, "not offered"


def test_what_is_slow_to_run_is_tried_as_the_law_that_it_refines_from_its_own_numbers(fitter_of, pair):
    """Bristles too stiff to give had led out of a wrong minimum, and all that followed had waited for their runs."""
    fitter = fitter_of(pair(coulomb(0.1)))
    search = Search(fitter, SearchOptions())
    stiff = effect("presliding_friction", torque_Nm=0.1, stiffness_Nm_rad=2e5)
    base = fitter.fit(fitter.hypothesis([stiff]), iterations=0)
    assert search.context.slow(base)
    assert [e.key for (e,) in simpler_at(base)] == ["coulomb_friction@motor"]
    search.keep(fitter.fit(fitter.hypothesis([coulomb(0.9)]), iterations=0))
    search.starts.limits(base)
    found = search.pool[("coulomb_friction@motor",)]
    assert found.chi2 < 1.01 * base.chi2
    assert found.effects[0].torque_Nm == pytest.approx(0.1, rel=0.01)
    soft = fitter.fit(fitter.hypothesis([effect("presliding_friction", torque_Nm=0.1, stiffness_Nm_rad=2.0)]), iterations=0)
    assert not search.context.slow(soft)
    runs = fitter.runs
    search.starts.limits(soft)
    assert fitter.runs == runs, "what is soon run is left as it is"


def test_a_structure_that_was_fitted_without_an_effect_is_not_begun_there_again(fitter_of, pair, monkeypatch):
    sticks = effect("static_friction", torque_Nm=0.3, peak=1.3)
    fitter = fitter_of(pair(sticks))
    search = Search(fitter, SearchOptions())
    richer = fitter.fit(fitter.hypothesis([sticks, effect("torque_offset", torque_Nm=0.01)]))
    offset = next(e for e in richer.effects if e.id == "torque_offset")
    rest = search.reduction.without(richer, offset)
    assert rest.rough
    begun = []
    monkeypatch.setattr("diagnose.structure.significance.warm_started", lambda *asked: begun.append(asked) or rest)
    search.path.land = lambda f: None
    search.significance.poorer_from(rest, richer)
    assert not begun
    search.state.warm.clear()
    search.significance._poorer.clear()
    search.significance.poorer_from(search.pool[rest.key], richer)
    assert len(begun) == 1


def test_a_fit_that_is_behind_and_comes_no_nearer_ends(fitter_of, pair):
    """The cost of what sticks falls for ever: a simpler form of it had taken half of a diagnosis."""
    fitter = fitter_of(pair(coulomb(0.3)))
    start = fitter.hypothesis([effect("static_friction", torque_Nm=0.02, peak=3.0)])
    all_the_way = fitter.fit(start, iterations=30, rival=True)
    behind = fitter.fit(start, iterations=30, rival=True, slow=(0.5 * all_the_way.chi2, 0.1))
    near = fitter.fit(start, iterations=30, rival=True, slow=(1e9 * all_the_way.chi2, 0.1))
    assert near.chi2 == all_the_way.chi2
    assert behind.fit.iterations < all_the_way.fit.iterations


def test_what_the_screen_has_first_is_fitted_from_the_nominal_parameters_where_it_fell_short(fitter_of, pair):
    """A spring that stiffens much lost its race: the refitted nominal parameters had gone to stand in for it."""
    spring = effect("hardening_stiffness", place="arm", coefficient_Nm_rad3=1e10)
    fitter = fitter_of(pair(spring))
    search = Search(fitter, SearchOptions())
    base = search.nominal()
    begun = fitter.fit(fitter.hypothesis([spring.with_values({"coefficient_Nm_rad3": 1e3})], base.linear), iterations=0)
    search.keep(begun)
    far = spring.with_values({"coefficient_Nm_rad3": 3e10})
    promised = Screened(Candidate(spring.id, spring.place), far, base.chi2 - base.n, (far,))
    found = search.starts.short_of_promise(base, promised)
    assert begun.chi2 > 2 * base.n > 1.5 * found.chi2
    assert search.pool[found.key] is found
    assert search.starts.short_of_promise(base, promised) is None, "it keeps what it promised"


def test_a_weight_takes_the_place_of_an_offset_though_it_hangs_on_another_body(fitter_of, pair):
    """Its race was run beside parameters that had gone astray; beside the offset that it nearly is, its level is known."""
    weight = effect("gravity_load", place="arm", torque_Nm=25.0, phase_rad=-1.1)
    fitter = fitter_of(pair(weight))
    search = Search(fitter, SearchOptions())
    base = fitter.fit(fitter.hypothesis([effect("torque_offset", torque_Nm=0.1)]))
    search.keep(base)
    (found,) = (f for f in search.growth.refine(base) if f.key == (weight.key,))
    assert found.chi2 < 1.1 * found.n < base.chi2
    assert found.effects[0].torque_Nm == pytest.approx(25.0, rel=0.1)
    assert refines(found, base)
    start = {"torque_Nm": 3.0, "phase_rad": 0.0}
    for ratio in (120.0, 1.0, -1.0):  # a direct drive, a gear that turns the other way
        assert inherit(type(weight), start, effect("torque_offset", torque_Nm=-0.1), ratio)["torque_Nm"] == 0.1 * abs(ratio)
    offset, friction = (Candidate(name, "motor") for name in ("torque_offset", "coulomb_friction"))
    assert not takes_place(offset, weight)
    assert not takes_place(friction, weight)
    assert not takes_place(Candidate("gravity_load", "arm"), coulomb())


def test_what_is_locked_to_position_is_refined_again_at_the_order_that_now_stands_out(fitter_of, pair):
    """It had entered at an order of the nominal model's residual, and its rivals stood in its way from then on."""
    values = {"torque_Nm": 0.1, "relative_amplitude": 0.4, "phase_rad": 0.3}
    varying = effect("position_dependent_friction", cycles_per_rev=6.0, **values)
    fitter = fitter_of(pair(varying))
    fitter = fitter.with_orders((40.0,))
    search = Search(fitter, SearchOptions())
    base = fitter.fit(fitter.hypothesis([coulomb()]))
    search.keep(base)
    search.keep(fitter.fit(fitter.hypothesis([varying.with_values({"cycles_per_rev": 40.0})]), iterations=3))
    assert search.pool[(varying.key,)].chi2 < 1.2 * base.chi2
    assert not [f for f in search.growth.refine(base) if f.key == (varying.key,)]
    search.use(fitter.with_orders((6.0,)))
    (found,) = (f for f in search.growth.refine(base) if f.key == (varying.key,))
    assert found.chi2 < 1.1 * found.n < base.chi2
    assert found.effects[0].cycles_per_rev == pytest.approx(6.0, abs=0.01)
    search.use(fitter.with_orders((40.0, 6.0)))
    assert [f.key for f in search.growth.refine(base)].count((varying.key,)) == 1
    assert not [f for f in search.growth.refine(base) if f.key == (varying.key,)], "once by these orders"


def test_what_promises_to_take_up_nearly_all_is_tried_before_what_is_dear(fitter_of, pair):
    """A delay beside friction: led models and other laws of friction took what a search may take, and it was never tried."""
    fitter = fitter_of(pair(coulomb(), effect("time_delay", place="actuator", delay_s=1.5e-3)))
    search = Search(fitter, SearchOptions())
    alone = fitter.fit(fitter.hypothesis([coulomb()]))
    search.keep(alone)
    assert search.growth.promises(alone, set())
    assert not search.growth.promises(alone, {alone.key}), "it was tried"
    both = search.fitter.fit(fitter.hypothesis([coulomb(), effect("time_delay", place="actuator", delay_s=1.5e-3)]))
    assert not search.growth.promises(both, set()), "nothing is left"


def test_nothing_beside_the_simpler_form_promises_what_a_refinement_does(fitter_of, pair):
    fitter = fitter_of(pair(effect("static_friction", torque_Nm=0.1, peak=4.0)))
    search = Search(fitter, SearchOptions())
    simple = fitter.fit(fitter.hypothesis([coulomb()]))
    search.keep(simple)
    assert not search.growth.promises(simple, set())


def test_other_laws_of_an_effect_wait_for_a_better_effect(fitter_of, pair):
    """They are slow to run; where another effect leaves half of it or less, it is not the law that is wrong."""
    fitter = fitter_of(pair(effect("static_friction", torque_Nm=0.1, peak=4.0)))
    search = Search(fitter, SearchOptions())
    search.nominal()
    simple = fitter.fit(fitter.hypothesis([coulomb()]))
    search.keep(simple)
    grown = search.growth.refine(simple)
    assert min(f.chi2 for f in grown) < 0.5 * simple.chi2
    assert ("coulomb_friction_with_creep@motor",) not in search.pool
    only = Search(fitter, SearchOptions(only=("coulomb_friction", "coulomb_friction_with_creep")))
    only.keep(simple)
    only.growth.refine(simple, forms=True)
    assert ("coulomb_friction_with_creep@motor",) in only.pool


def test_the_same_effect_at_the_other_end_is_no_other_ground(fitter_of, pair):
    fitter = fitter_of(pair(effect("time_delay", place="sensor", delay_s=2e-3)))
    ends = [fitter.fit(fitter.hypothesis([effect("time_delay", place=p, delay_s=1.9e-3)])) for p in ("actuator", "sensor")]
    lag = fitter.fit(fitter.hypothesis([effect("sensor_lag", place="sensor", time_constant_s=2e-3)]))
    assert elsewhere(*ends)
    assert not elsewhere(ends[0], ends[0])
    assert not elsewhere(lag, ends[0])


def test_a_further_body_is_begun_at_the_nominal_parameters_where_refitted_ones_stand_in_for_it(fitter_of, pair):
    """A spring of 0.4 of the nominal one had left 1.2 times the noise: no first look from the nominal ones is a rival of that."""
    mode = effect("extra_flexible_mode", place="arm", inertia_kgm2=0.4, stiffness_Nm_rad=9000.0, damping_Nms_rad=5.0)
    fitter = fitter_of(pair(mode))
    search = Search(fitter, SearchOptions())
    as_is = fitter.fit(fitter.hypothesis(()), iterations=0)
    gone = fitter.fit(fitter.hypothesis((), as_is.linear | {"ka": 0.4 * as_is.linear["ka"]}), iterations=0)
    lost = fitter.fit(fitter.hypothesis([mode.with_values({"inertia_kgm2": 1e-3})], gone.linear), iterations=0)
    search.starts.from_nominal(as_is, [lost], ("structure",))
    assert not search.pool, "they are where they were"
    search.starts.from_nominal(gone, [lost], ("coupling",))
    assert not search.pool
    search.starts.from_nominal(gone, [lost], ("structure",))
    assert search.pool[lost.key].chi2 < 1.1 * lost.n < 0.1 * lost.chi2
