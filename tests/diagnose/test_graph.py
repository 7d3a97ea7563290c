"""Neighbours of a structure: confounders of an answer."""

from __future__ import annotations

from robot_axis import effect

from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import candidates
from diagnose.structure.graph import split
from diagnose.structure.search import Search

PLANT = {"Jm": 4.7e-4, "fm": 0.0345, "kg": 1.46e5, "ka": 0.458e5, "Ja": 1.66}


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


def test_each_start_of_a_part_is_a_neighbour_of_a_compound_effect(fitter_of, pair):
    """Stribeck friction beside an offset in the place of asymmetric friction: a wrong fading speed is a minimum of its own."""
    whole = effect("asymmetric_friction", torque_Nm=0.1, asymmetry_Nm=0.03)
    fitter = fitter_of(pair(whole))
    base = fitter.fit(fitter.hypothesis([whole], PLANT))
    only = ("coulomb_friction", "asymmetric_friction", "stribeck_friction", "torque_offset")
    neighbours = split(fitter, candidates(fitter, only), base)
    speeds = [s.effect.values["stribeck_velocity_rad_s"] for _, s in neighbours if s.candidate.id == "stribeck_friction"]
    assert len(speeds) == len(set(speeds)) > 1
    for others, s in neighbours:
        assert [e.id for e in others] == ["torque_offset"]
        assert others[0].values["torque_Nm"] == -base.effects[0].values["asymmetry_Nm"]
        assert s.starts == (s.effect,)
