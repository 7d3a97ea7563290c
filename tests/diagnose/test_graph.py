"""Neighbours of a structure: confounders that are told apart once another effect is there, and those of an answer."""

from __future__ import annotations

from robot_axis import effect

from diagnose.structure.budget import SearchOptions
from diagnose.structure.search import Search

PLANT = {"Jm": 4.7e-4, "fm": 0.0345, "kg": 1.46e5, "ka": 0.458e5, "Ja": 1.66}
STICKS = effect("static_friction", torque_Nm=0.15, peak=2.4)


def test_a_confounder_is_exchanged_once_friction_tells_the_two_apart(fitter_of, pair):
    """Alone, lags of actuator and sensor have the same residual, and either may enter first."""
    lags = [
        effect("actuator_lag", place="actuator", time_constant_s=2e-3),
        effect("sensor_lag", place="sensor", time_constant_s=2e-3),
    ]
    fitter = fitter_of(pair(STICKS, lags[0]))
    search = Search(fitter, SearchOptions())
    for lag in lags:
        search.keep(fitter.fit(fitter.hypothesis([lag])))
    base = fitter.fit(fitter.hypothesis([STICKS, lags[1]], PLANT), iterations=6)
    for move in filter(None, search.moves.replace(base)):
        search.race.run(move.base, move.entrants, move.floor)
    key = tuple(sorted([STICKS.key, lags[0].key]))
    assert search.fits[key].chi2 < 1.1 * base.n < 0.5 * base.chi2
    runs = fitter.runs
    assert [m for m in search.moves.replace(base) if m is not None] == [], "once for a residual"
    assert fitter.runs == runs


def test_confounders_of_an_answer_are_fitted_though_the_budget_is_spent(fitter_of, pair):
    """Equivalents are a part of the answer."""
    lag = effect("actuator_lag", place="actuator", time_constant_s=2e-3)
    fitter = fitter_of(pair(lag))
    search = Search(fitter, SearchOptions())
    best = fitter.fit(fitter.hypothesis([lag], PLANT))
    fitter.allow(fitter.runs - 1)
    assert fitter.spent
    assert best.chi2 < 1.1 * best.n
    search.pruning.fit_confounders(best, best.effects[0])
    (found,) = (f for key, f in search.fits.items() if key == ("sensor_lag@sensor",))
    assert found.chi2 < 1.1 * found.n
