"""What moves alike until another effect is there, and what is behind by its minimum alone, is tried before what is dear."""

from __future__ import annotations

import pytest
from robot_axis import effect

from diagnose.evidence.context import Context
from diagnose.evidence.held_out import Comparison
from diagnose.structure.budget import SearchOptions
from diagnose.structure.search import Search
from diagnose.thresholds import BESIDE_NOMINAL

PLANT = {"Jm": 4.7e-4, "fm": 0.0345, "kg": 1.46e5, "ka": 0.458e5, "Ja": 1.66}
STICKS = effect("static_friction", torque_Nm=0.15, peak=2.4)


def test_a_lag_at_the_other_end_is_tried_as_soon_as_friction_is_there(fitter_of, pair):
    """Alone they are told apart by nothing; the one that happened to be first had its friction refined for all the budget."""
    lags = [
        effect("actuator_lag", place="actuator", time_constant_s=2e-3),
        effect("sensor_lag", place="sensor", time_constant_s=2e-3),
    ]
    fitter = fitter_of(pair(STICKS, lags[0]))
    search = Search(fitter, SearchOptions())
    for lag in lags:
        search.keep(fitter.fit(fitter.hypothesis([lag])))
    base = fitter.fit(fitter.hypothesis([STICKS, lags[1]], PLANT), iterations=6)
    search.growth.exchange_confounders(base)
    key = tuple(sorted([STICKS.key, lags[0].key]))
    assert search.pool[key].chi2 < 1.1 * base.n < 0.5 * base.chi2
    runs = fitter.runs
    search.growth.exchange_confounders(search.pool[key])
    assert fitter.runs == runs, "nothing is left to explain"


def test_what_a_law_comes_to_is_built_on_in_its_place(fitter_of, pair):
    """Stribeck friction over a speed that the motion never resolves left as little, and beside it the whole budget went."""
    fitter = fitter_of(pair(STICKS))
    search = Search(fitter, SearchOptions())
    search.nominal()
    numbers = {"torque_Nm": 0.15, "extra_static_torque_Nm": 0.21, "stribeck_velocity_rad_s": 0.01}
    base = fitter.fit(fitter.hypothesis([effect("stribeck_friction", **numbers)], PLANT), iterations=5)
    assert base.chi2 < 1.5 * base.n
    search.keep(base)
    assert search.growth.expand(base) == []
    assert search.pool[(STICKS.key,)].effects[0].peak == pytest.approx(2.4, rel=0.05)
    assert all(len(key) < 2 for key in search.pool)


def test_what_is_behind_in_a_free_run_alone_is_let_go(fitter_of, pair):
    fitter = fitter_of(pair(STICKS))
    search = Search(fitter, SearchOptions())
    astray = fitter.fit(fitter.hypothesis([STICKS.with_values({"peak": 2.2})], PLANT))
    numbers = {"torque_Nm": 0.15, "extra_static_torque_Nm": 0.21, "stribeck_velocity_rad_s": 0.1}
    beside = fitter.fit(fitter.hypothesis([effect("stribeck_friction", **numbers)], PLANT), iterations=15)
    assert astray.chi2 > beside.chi2 > 1.1 * beside.n
    search.keep(astray)
    search.path.release_once(astray, beside)
    found = search.pool[(STICKS.key,)]
    assert found.chi2 < 1.1 * found.n
    runs = fitter.runs
    search.path.release_once(astray, beside)
    assert fitter.runs == runs, "once"


def test_a_richer_structure_is_compared_at_the_numbers_that_the_poorer_one_has_come_to(fitter_of, pair, monkeypatch):
    """Held-out data may ask more of a number than the others tell of it: two guesses of it are then compared."""
    friction, steps = effect("coulomb_friction", torque_Nm=0.1), effect("sensor_quantisation", place="sensor", step=0.3)
    fitter = fitter_of(pair(friction, steps))
    search = Search(fitter, SearchOptions())
    first = fitter.fit(fitter.hypothesis([friction], PLANT), iterations=3)
    after = fitter.fit(fitter.hypothesis([friction, steps], first.linear))
    before = fitter.fit(first.hypothesis, first.fit.x)
    assert after.chi2 < 0.5 * before.chi2
    search.keep(after)
    assert search.context.compared(before, after).relative_gain > 0.0
    assert search.significance.richer_from(before, after) is None, "held-out data do not speak against it"
    monkeypatch.setattr(Context, "compared", lambda self, *pair: Comparison(-1.0, 1.0))
    assert search.significance.richer_from(before, after) is None, "it has come to the same numbers"
    search.significance._richer.clear()
    monkeypatch.setattr("diagnose.structure.significance.MOVED", 0.0)
    begun = search.significance.richer_from(before, after)
    assert begun is not None
    assert begun.chi2 < after.chi2 + search.options.entry
    runs = fitter.runs
    assert search.significance.richer_from(before, after) is begun
    assert fitter.runs == runs, "once"
    assert search.significance.richer_from(begun, begun) is None, "of itself there is no other"
    assert not search.significance.generalises_by(before, begun, 2)
    assert search.pool[after.key] is after, "it stands as it was"
    monkeypatch.undo()
    assert search.significance.generalises_by(before, begun, 2)
    assert search.pool[after.key] is begun


def test_what_promises_beside_the_nominal_parameters_is_tried_though_refitted_ones_have_gone_elsewhere(fitter_of, pair):
    """Friction of the arm: beside the refit it was fourteenth of 34 and not tried, and no way led to it from there."""
    friction = effect("coulomb_friction", place="arm", torque_Nm=21.0)
    fitter = fitter_of(pair(friction))
    search = Search(fitter, SearchOptions())
    astray = fitter.fit(fitter.hypothesis((), search.nominal().linear), iterations=0)
    first = search.race.look(astray).from_nominal(search.growth.additions(astray))
    assert len(first) == BESIDE_NOMINAL
    assert first[0].candidate.key == friction.key
    search.growth.expand(astray)
    assert search.pool[(friction.key,)].chi2 < 1.1 * astray.n < 0.1 * astray.chi2
    assert not search.race.look(search.pool[(friction.key,)]).apart


def test_a_limit_of_a_law_is_begun_at_its_other_starts_too(fitter_of, pair):
    """The peak that Stribeck friction had come to led static friction to a minimum beside the right one."""
    fitter = fitter_of(pair(STICKS))
    search = Search(fitter, SearchOptions())
    numbers = {"torque_Nm": 0.15, "extra_static_torque_Nm": 0.03, "stribeck_velocity_rad_s": 0.3}
    base = fitter.fit(fitter.hypothesis([effect("stribeck_friction", **numbers)], PLANT), iterations=0)
    found = search.starts._about_limit((), STICKS.with_values({"peak": 1.2}), base)
    alone = fitter.fit(fitter.hypothesis([STICKS.with_values({"peak": 1.2})], PLANT), iterations=20, rival=True)
    assert found.chi2 < 1.1 * found.n < alone.chi2
    assert found.effects[0].peak == pytest.approx(2.4, rel=0.1)


def test_what_cannot_be_told_from_an_answer_is_fitted_whatever_may_still_be_simulated(fitter_of, pair):
    """Which end lags is open, and that is a part of the answer; of what explains nothing it is none."""
    lag = effect("actuator_lag", place="actuator", time_constant_s=2e-3)
    fitter = fitter_of(pair(lag))
    search = Search(fitter, SearchOptions())
    best = fitter.fit(fitter.hypothesis([lag], PLANT))
    far = fitter.fit(fitter.hypothesis([lag.with_values({"time_constant_s": 5e-3})], PLANT), iterations=0)
    fitter.allow(fitter.runs - 1)
    assert fitter.spent
    assert best.chi2 < 1.1 * best.n < 0.5 * far.chi2
    search.reduction.fit_confounders(far, far.effects[0])
    assert not search.pool
    search.reduction.fit_confounders(best, best.effects[0])
    (found,) = (f for key, f in search.pool.items() if key == ("sensor_lag@sensor",))
    assert found.chi2 < 1.1 * found.n
