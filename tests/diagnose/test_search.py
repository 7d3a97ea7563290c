"""The rules of the search: how held-out errors are compared, how work is spread, from where structures are extended."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest
from robot_axis import effect

from diagnose.data.experiment import prepare
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Status
from diagnose.fit.validation import predicted_samples
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import Candidate, can_replace, inherit
from diagnose.structure.graph import limits, named, refines
from diagnose.structure.search import Search
from diagnose.thresholds import FAR, TWICE
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import effect_class
from mjsim.ode import simulate
from mjsim.recording import Recording

N, BLOCKS = 20_000, 40


@pytest.fixture(scope="module")
def short(pair):
    """Pairs of recordings of a second."""
    return partial(pair, seconds=1.0)


def coulomb(level=0.1):
    return effect_class("coulomb_friction")(torque_Nm=level)


def test_the_prior_is_nought_at_the_nominal_parameters(fitter_of, short):
    """Inertias and stiffnesses are held by their logarithm, the others by their ratio."""
    fitter = fitter_of(short())
    h = fitter.hypothesis(())
    np.testing.assert_allclose(fitter.problem.prior(h, h.start), 0.0, atol=1e-12)
    fitter = fitter.relax(prior_weight=4.0)
    off = fitter.hypothesis((), {"Jm": 2 * fitter.nominal.chain.bodies[0].inertia})
    assert np.max(fitter.problem.prior(off, off.start)) == pytest.approx(2.0 * np.log(2.0) * TWICE)


def test_what_a_prior_costs_is_no_misfit(fitter_of, short):
    fitter = fitter_of(short()).relax(prior_weight=1e4)
    inertia = fitter.nominal.chain.bodies[0].inertia
    off = fitter.fit(fitter.hypothesis((), {"Jm": 1.2 * inertia}), iterations=0)
    errors = off.fit.residual[: -off.hypothesis.prior_terms[0]]
    assert fitter.misfit(off) == pytest.approx(float(errors @ errors) / off.n)
    assert fitter.misfit(off) < off.chi2 / off.n


def test_sensitivities_are_lent_under_another_weight_of_the_prior(fitter_of, short):
    """Those of the recordings as they are, those of the prior anew."""
    fitter = fitter_of(short(coulomb()))
    lender = fitter.fit(fitter.hypothesis([coulomb()]), iterations=3)
    fitter = fitter.relax(prior_weight=100.0)
    asked = []

    def run(tasks):
        asked.append(len(tasks))
        return [task() for task in tasks]

    _, lent = fitter._from_neighbour(lender.hypothesis, lender.fit.x, lender, 1e-3, run)
    rows = lender.hypothesis.prior_terms[0]
    np.testing.assert_array_equal(lent[:-rows], lender.fit.J[:-rows])
    np.testing.assert_allclose(lent[-rows:], 10.0 * lender.fit.J[-rows:], atol=1e-6)
    assert sum(asked) == 1, "nothing is run for what is known, only the residual there"


def test_who_has_no_sensitivities_lends_none_and_is_sure_of_nothing(fitter_of, short):
    """Its first differences failed, or nobody asked for them: what it keeps is zero."""
    fitter = fitter_of(short(coulomb()))
    bare = fitter.fit(fitter.hypothesis([coulomb()]), iterations=0)
    assert fitter._from_neighbour(bare.hypothesis, bare.fit.x, bare, 1e-3, fitter.map) is None
    assert np.all(np.isinf(bare.standard_errors()))
    assert fitter.fit(bare.hypothesis, bare.fit.x, neighbour=bare, secant=True).chi2 < bare.chi2


def test_a_rival_far_from_the_noise_is_fitted_roughly_and_one_near_it_is_not(fitter_of, short):
    fitter = fitter_of(short(coulomb(0.3)))
    bare, right = fitter.hypothesis(()), fitter.hypothesis([coulomb(0.2)])
    far, fitted = fitter.fit(bare, rival=True), fitter.fit(bare)
    assert far.chi2 / far.n > FAR
    assert far.fit.iterations < fitted.fit.iterations
    assert far.chi2 < 1.02 * fitted.chi2
    near, exact = fitter.fit(right, rival=True), fitter.fit(right)
    assert near.chi2 / near.n < FAR
    np.testing.assert_allclose(near.fit.x, exact.fit.x, rtol=1e-6)


def test_a_structure_without_an_effect_is_fitted_once(fitter_of, short):
    fitter = fitter_of(short(coulomb(0.3)))
    search = Search(fitter, SearchOptions(only=("coulomb_friction",)))
    best = search.run()
    first = search.pruning.without(best, best.effects[0])
    runs = fitter.runs
    assert search.pruning.without(best, best.effects[0]) is first
    assert fitter.runs == runs


@pytest.mark.slow
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


def test_an_effect_of_no_size_is_dropped_though_the_nominal_model_had_gone_wrong(short, robot):
    """A nominal fit that ended at a wrong minimum must not make evidence for what only showed the way out of it."""
    first, other = short()
    fitter = Fitter(robot, MotionView(), (prepare(first),), (prepare(other),), 1)
    search = Search(fitter, SearchOptions())
    good = search.nominal()
    friction = effect_class("coulomb_friction")(place="arm", torque_Nm=0.0)
    richer = fitter.fit(fitter.hypothesis((friction,), good.linear), iterations=3)
    wrong = {name: value * (3.0 if name == "kg" else 1.0) for name, value in good.linear.items()}
    stuck = fitter.fit(fitter.hypothesis((), wrong), iterations=0)
    stuck = dataclasses.replace(stuck, fit=dataclasses.replace(stuck.fit, status=Status.CONVERGED))
    search.fits._best[()] = stuck
    search.keep(richer)
    assert stuck.chi2 > 2 * richer.chi2
    assert search.pruning.eliminate(richer).key == ()
    assert search.nominal().chi2 < 1.01 * good.chi2
    fitter.close()


def test_a_law_that_gains_nothing_over_its_limit_is_dropped_for_it(robot, short):
    """Stribeck friction that fades over next to no speed, where static friction was fitted from a bad start."""
    hidden = effect("static_friction", torque_Nm=0.1, peak=1.8)
    first, other = short(hidden)
    fitter = Fitter(robot, MotionView(), (prepare(first),), (prepare(other),), 1)
    search = Search(fitter, SearchOptions())
    fading = effect("stribeck_friction", torque_Nm=0.1, extra_static_torque_Nm=0.08, stribeck_velocity_rad_s=1e-3)
    found = fitter.fit(fitter.hypothesis((fading,)))
    stuck = fitter.fit(fitter.hypothesis((effect("static_friction", torque_Nm=0.02, peak=1.1),)), iterations=0)
    search.keep(found)
    search.keep(stuck)
    assert stuck.chi2 > 2 * found.chi2
    assert search.pruning.eliminate(found).key == ("static_friction@motor",)
    fitter.close()


@pytest.mark.parametrize("cycles", [1.0003, 2.0])
def test_a_torque_that_repeats_once_a_turn_is_a_weight(cycles):
    body = Body("motor", 0.08, 0.1, "hinge")
    pendulum = Axis(Chain((body,), ()), (effect("torque_ripple", amplitude_Nm=1.5, cycles_per_rev=round(cycles), phase_rad=0.2),))
    t, rng = np.arange(1000) * 4e-3, np.random.default_rng(0)
    u = 2.0 * np.sin(2 * np.pi * (0.3 + 0.2 * t) * t)
    run = simulate(pendulum, u, 4e-3)
    r = Recording(t, u, run.velocity + 0.02 * rng.standard_normal(len(t)), run.angle + 1e-4 * rng.standard_normal(len(t)), 4e-3)
    experiment = prepare(r)
    fitter = Fitter(Axis(pendulum.chain, ()), MotionView(), (experiment,), (experiment,), 1)
    search = Search(fitter, SearchOptions())
    ripple = effect("torque_ripple", amplitude_Nm=1.5, cycles_per_rev=cycles, phase_rad=0.2)
    found = fitter.fit(fitter.hypothesis((ripple,)))
    (kept,) = search.pruning.eliminate(found).effects
    fitter.close()
    if cycles == 2.0:
        assert kept.id == "torque_ripple"
        assert not ripple.limits()
    else:
        assert kept.id == "gravity_load"
        assert kept.torque_Nm == pytest.approx(1.5, rel=0.01)


@pytest.mark.slow
def test_what_the_angle_shows_is_taken_in_first(robot, pair):
    """A velocity that drifts from the angle has an offset, whatever else is missing."""
    hidden = (
        effect("sensor_offset", place="sensor", value=0.2),
        effect("friction_drift", torque_Nm=0.04, relative_change=1.5, time_constant_s=1.0),
    )
    few = ("coulomb_friction", "friction_drift", "asymmetric_friction", "sensor_offset", "torque_offset", "gravity_load")
    first, other = pair(*hidden, seconds=3.0)
    result = diagnose(robot, [first], [other], Options(jobs=1, effects=few))
    assert {f.effect for f in result.findings} == {"sensor_offset", "friction_drift"}


def test_held_out_data_judge_structures_of_one_size_as_well(fitter_of, short):
    fitter = fitter_of(short(effect("coulomb_friction", torque_Nm=0.1)))
    search = Search(fitter, SearchOptions())
    right = fitter.fit(fitter.hypothesis([effect("coulomb_friction", torque_Nm=0.1)]))
    wrong = fitter.fit(fitter.hypothesis([effect("torque_offset", torque_Nm=0.01)], right.linear))
    flattered = dataclasses.replace(wrong, fit=dataclasses.replace(wrong.fit, cost=0.5 * right.chi2))
    for f in (right, flattered):
        search.keep(f)
    assert search.criterion(flattered) < search.criterion(right)
    assert search.selection.best(right) is right, "by the estimation data alone it would be the other"


def test_only_laws_that_stick_or_strike_go_astray(fitter_of, short):
    fitter = fitter_of(short(coulomb()))
    assert predicted_samples(fitter, fitter.fit(fitter.hypothesis(()))) is None


def test_a_move_sideways_is_judged_directly_where_the_error_is_the_models_own(fitter_of, short):
    """Two gains from far off, each counted by its own samples' worth, may say the contrary of the two structures' own errors."""
    fitter = fitter_of(short(coulomb()))
    search = Search(fitter, SearchOptions())
    search.nominal()
    right = fitter.fit(fitter.hypothesis([coulomb()]))
    wrong = fitter.fit(fitter.hypothesis([effect("torque_offset", torque_Nm=0.01)], right.linear))
    nearly = dataclasses.replace(wrong, fit=dataclasses.replace(wrong.fit, cost=1.1 * right.chi2))
    for f in (right, nearly):
        search.keep(f)
    search.fits._held_out = {k: search.held_out(right) for k in (right.key, nearly.key)}  # held-out data do not tell them apart
    search.context.share_between = lambda poorer, richer: 0.1 if richer.key == right.key else 1.0
    assert search.context.ahead(nearly, right) > 0
    assert search.selection.best(right) is right


def test_a_held_out_run_that_needs_a_phase_of_its_own_is_judged_with_it(fitter_of, short, monkeypatch):
    """A model whose phase of the fitted recording cannot be run on the held-out one: its error there was divided by nought."""
    fitter = fitter_of(short(effect("torque_ripple", amplitude_Nm=0.02, cycles_per_rev=4.0, phase_rad=0.3)))
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

    search.fits._held_out = {plain.key: here, better.key: scaled(0.9999)}
    assert search.significance.better_law(plain, better)
    assert not search.significance.better_law(search.nominal(), better), "of another name"
    search.fits._held_out[better.key] = scaled(1.0001)
    assert not search.significance.better_law(plain, better), "held-out data speak against it"
    search.fits._held_out[better.key] = scaled(0.9999)
    level = dataclasses.replace(creeping, fit=dataclasses.replace(creeping.fit, cost=0.9999 * plain.chi2))
    assert not search.significance.better_law(plain, level), "no better on the estimation data"


def test_what_a_better_law_may_still_miss_is_no_effect_of_its_own(fitter_of, pair):
    """Where another law of an effect changed much, a hundredth of that is no evidence for anything beside it; of less, more."""
    fitter = fitter_of(pair(coulomb(), seconds=3.0))
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
    assert search.context.law_error(other) == pytest.approx(0.02 * 48.8 * other.n)
    assert not search.significance.significant(other, richer)
    assert search.context.floor(other) > 3_000
    near = dataclasses.replace(own, fit=dataclasses.replace(own.fit, cost=1.5 * own.n))
    search.fits._best[own.key] = near
    assert search.context.law_error(other) == pytest.approx(0.02 * 0.3 * other.n)


def test_a_neighbour_whose_sensitivities_predict_no_gain_is_not_fitted_on(fitter_of, short):
    """Where a structure leaves noise alone, the sensitivities of a neighbour bound what it may gain."""
    fitter = fitter_of(short(coulomb(0.3)))
    search = Search(fitter, SearchOptions())
    right = fitter.fit(fitter.hypothesis([coulomb(0.3)]))
    poor = fitter.fit(fitter.hypothesis([coulomb(0.3)]), iterations=1)
    beside = [*right.effects, effect("gravity_load", place="arm", torque_Nm=1e-4, phase_rad=0.0)]
    idle = fitter.fit(fitter.hypothesis(beside, right.linear), iterations=2)
    assert not search.halving.may_gain(right, idle, search.context.floor(right))
    assert search.halving.may_gain(search.nominal(), poor, search.context.floor(right)), "far from noise all go on"
    assert search.halving.may_gain(idle, dataclasses.replace(right, fit=right.fit), -10.0), "as good, and simpler"


def test_a_structure_that_leaves_less_than_noise_leaves_something_if_that_has_a_colour(fitter_of, pair):
    fitter = fitter_of(pair(coulomb()))
    search = Search(fitter, SearchOptions())
    right, wrong = fitter.fit(fitter.hypothesis([coulomb()])), search.nominal()
    less = [dataclasses.replace(f, fit=dataclasses.replace(f.fit, cost=0.8 * f.n)) for f in (right, wrong)]
    assert not search.context.visible(right)
    assert not search.context.visible(less[0])
    assert search.context.visible(less[1])
    assert search.context.visible(wrong)


def test_a_law_at_the_edge_of_its_numbers_is_the_law_of_fewer(fitter_of, short):
    """Static friction that ended in another minimum lost to Stribeck friction which faded over a speed far below the noise."""
    sticks = effect("static_friction", torque_Nm=0.1, peak=1.8)
    fitter = fitter_of(short(sticks))
    search = Search(fitter, SearchOptions())
    level = {"torque_Nm": 0.1, "extra_static_torque_Nm": 0.08, "stribeck_velocity_rad_s": 0.003}
    base = fitter.fit(fitter.hypothesis([effect("stribeck_friction", **level)]), iterations=3)
    assert [s.candidate.key for _, s in limits(search.state.candidates, base)] == [sticks.key]
    (fit,) = search.pruning.limits(base)
    fit()
    assert search.fits[(sticks.key,)].chi2 < 1.01 * base.chi2
    (found,) = search.fits[(sticks.key,)].effects
    assert found.torque_Nm == pytest.approx(0.1, rel=0.05)
    assert found.peak == pytest.approx(1.8, rel=0.05)
    other = Search(fitter, SearchOptions())
    other.state.consider(tuple(c for c in other.state.candidates if c.id != sticks.id))
    assert other.pruning.limits(base) == [], "not offered"


def test_a_fit_that_is_behind_and_comes_no_nearer_ends(fitter_of, short):
    """The cost of what sticks falls for ever: a simpler form of it had taken half of a diagnosis."""
    fitter = fitter_of(short(coulomb(0.3)))
    start = fitter.hypothesis([effect("static_friction", torque_Nm=0.02, peak=3.0)])
    all_the_way = fitter.fit(start, iterations=30, rival=True)
    behind = fitter.fit(start, iterations=30, rival=True, slow=(0.5 * all_the_way.chi2, 0.1))
    near = fitter.fit(start, iterations=30, rival=True, slow=(1e9 * all_the_way.chi2, 0.1))
    assert near.chi2 == all_the_way.chi2
    assert behind.fit.iterations < all_the_way.fit.iterations


def replaced(search: Search, base: Fitted) -> list[Fitted]:
    """What the moves that replace an effect come to."""
    return [f for m in search.moves.replace(base) if m is not None for f in search.halving.run(m.base, m.neighbours, m.floor)]


def test_a_weight_takes_the_place_of_an_offset_though_it_hangs_on_another_body(fitter_of, short):
    """It was fitted beside parameters that had diverged; beside the offset that it nearly is, its level is known."""
    weight = effect("gravity_load", place="arm", torque_Nm=25.0, phase_rad=-1.1)
    fitter = fitter_of(short(weight))
    search = Search(fitter, SearchOptions())
    base = fitter.fit(fitter.hypothesis([effect("torque_offset", torque_Nm=0.1)]))
    search.keep(base)
    (found,) = (f for f in replaced(search, base) if f.key == (weight.key,))
    assert found.chi2 < 1.1 * found.n < base.chi2
    assert found.effects[0].torque_Nm == pytest.approx(25.0, rel=0.1)
    assert refines(found, base)
    start = {"torque_Nm": 3.0, "phase_rad": 0.0}
    for ratio in (120.0, 1.0, -1.0):  # a direct drive, a gear that turns the other way
        assert inherit(type(weight), start, effect("torque_offset", torque_Nm=-0.1), ratio)["torque_Nm"] == 0.1 * abs(ratio)
    offset, friction = (Candidate(name, "motor") for name in ("torque_offset", "coulomb_friction"))
    assert not can_replace(offset, weight)
    assert not can_replace(friction, weight)
    assert not can_replace(Candidate("gravity_load", "arm"), coulomb())


@pytest.mark.slow
def test_a_position_locked_effect_is_refined_again_at_the_order_that_stands_out(fitter_of, pair):
    """It may have entered at an order of the nominal model's residual."""
    values = {"torque_Nm": 0.1, "relative_amplitude": 0.4, "phase_rad": 0.3}
    varying = effect("position_dependent_friction", cycles_per_rev=6.0, **values)
    fitter = fitter_of(pair(varying))
    fitter = fitter.with_orders((40.0,))
    search = Search(fitter, SearchOptions())
    base = fitter.fit(fitter.hypothesis([coulomb()]))
    search.keep(base)
    search.keep(fitter.fit(fitter.hypothesis([varying.with_values({"cycles_per_rev": 40.0})]), iterations=3))
    search.use(fitter.with_orders((6.0,)))
    assert (varying.key,) in {f.key for f in replaced(search, base)}
    found = search.fits[(varying.key,)]
    assert found.chi2 < 1.1 * found.n < base.chi2
    assert found.effects[0].cycles_per_rev == pytest.approx(6.0, abs=0.01)
    assert replaced(search, base) == [], "once by these orders"
