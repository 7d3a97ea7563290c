"""Verdict, intervals, p-values and equivalents at the levels that decide, of structures as plain data."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from diagnose.evidence.held_out import Comparison
from diagnose.evidence.intervals import half_width
from diagnose.options import Options
from diagnose.problem.noise_model import KnownNoise, ModelError
from diagnose.result import Verdict
from diagnose.structure.budget import SearchOptions
from diagnose.verdict import decide as decide_module
from diagnose.verdict.decide import decide, equivalents, estimates, only_repeated_rows, p_values
from diagnose.verdict.witnesses import RepeatedRows
from mjsim.effects import effect_class
from mjsim.quantity import Motion, Quantity

COULOMB = effect_class("coulomb_friction")(torque_Nm=0.1)
DELAY = effect_class("time_delay")(place="actuator", delay_s=1e-3)
OFFSET = effect_class("torque_offset")(torque_Nm=0.02)
SEARCH = SearchOptions()
(MARGIN,) = equivalents.__defaults__  # in C


class Entry(SimpleNamespace):
    """A free number of a hypothesis, in units of ``scale``."""

    quantity, recording, scale = Quantity.TORQUE, -1, 1.0

    def si(self, x):
        return x * self.scale


def structure(*effects, chi2=1000.0, n=1000, numbers=0, criterion=0.0, rms=None):
    entries = tuple(Entry(owner="", name=f"p{i}") for i in range(numbers))
    return SimpleNamespace(
        effects=effects, key=tuple(sorted(e.key for e in effects)), chi2=chi2, n=n, criterion=criterion, own={},
        held=None if rms is None else SimpleNamespace(rms=rms),
        hypothesis=SimpleNamespace(entries=entries, size=numbers, bounds=(np.full(numbers, -99.0), np.full(numbers, 99.0))),
    )  # fmt: skip


def search(*structures, residual=None, held=0.5, given=None):
    fitter = SimpleNamespace(
        fit=lambda hypothesis, x, iterations: "as given", validate=lambda fitted: given,
        residual=lambda hypothesis: lambda x: residual if x == "start" else None,
        hypothesis=lambda effects, linear, own: SimpleNamespace(start="start"),
        noise=KnownNoise(), nominal=SimpleNamespace(chain=SimpleNamespace(motion=Motion.HINGE)),
    )  # fmt: skip
    fits = {f.key: f for f in structures}
    return SimpleNamespace(
        fitter=fitter, options=SEARCH, fits=fits, criterion=lambda f: f.criterion, held_out=lambda f: f.held,
        context=SimpleNamespace(
            ahead=lambda best, f: f.criterion - best.criterion, compared=lambda *_: Comparison(0.1, held), effective=1.0
        ),
    )  # fmt: skip


@pytest.fixture(autouse=True)
def bounds(monkeypatch):
    """Parameters that stand at their bounds, by name: none unless a test adds one."""
    names = []
    monkeypatch.setattr(decide_module, "at_bounds", lambda best: tuple(names))
    return names


def test_a_parameter_at_its_bound_explains_nothing(bounds):
    remaining = SimpleNamespace(unexplained=False)
    bounds.append("Jm")
    assert decide(search(residual=np.ones(1000)), structure(), structure(), remaining) is Verdict.UNEXPLAINED
    assert decide(search(), structure(), structure(COULOMB), remaining) is Verdict.MISSING_PHYSICS, (
        "an effect is named all the same"
    )


@pytest.mark.parametrize("unexplained", [True, False])
@pytest.mark.parametrize("best", [structure(COULOMB), structure()])
def test_what_is_left_decides_before_what_was_found(best, unexplained):
    verdict = decide(search(residual=np.ones(1000)), structure(), best, SimpleNamespace(unexplained=unexplained))
    expected = Verdict.MISSING_PHYSICS if best.effects else Verdict.NO_MISMATCH
    assert verdict is (Verdict.UNEXPLAINED if unexplained else expected)


@pytest.mark.parametrize(("times", "verdict"), [(0.999, Verdict.NO_MISMATCH), (1.001, Verdict.PARAMETERS_ONLY)])
def test_refitted_parameters_must_gain_more_than_their_price(times, verdict):
    """The entry, and half the price of each of them: gain = n log(cost as given / chi2)."""
    base = structure(chi2=700.0, n=900, numbers=7)
    gain = times * (SEARCH.entry + SEARCH.price * 7 / 2)
    as_given = np.full(4, math.sqrt(700.0 * math.exp(gain / 900) / 4))
    remaining = SimpleNamespace(unexplained=False)
    assert decide(search(residual=as_given), base, base, remaining) is verdict
    assert decide(search(residual=None), base, base, remaining) is Verdict.PARAMETERS_ONLY, "as given it cannot be run"


@pytest.mark.parametrize(
    ("given", "fitted", "verdict"),
    [(1.0, 1.01, Verdict.NO_MISMATCH), (1.0, 0.99, Verdict.PARAMETERS_ONLY), (None, 1.0, Verdict.PARAMETERS_ONLY)],
)
def test_numbers_of_an_unknown_noise_must_predict_better_than_those_of_the_file(given, fitted, verdict):
    base = structure(chi2=700.0, n=900, numbers=7, rms=fitted)
    asked = search(residual=np.full(4, 1e3), given=None if given is None else SimpleNamespace(rms=given))
    remaining = SimpleNamespace(unexplained=False)
    assert decide(asked, base, base, remaining) is Verdict.PARAMETERS_ONLY, "of a known noise the criterion alone decides"
    asked.fitter.noise = ModelError()
    assert decide(asked, base, base, remaining) is verdict


@pytest.mark.parametrize("verdict", Verdict)
def test_rows_that_were_not_measured_are_a_mismatch_of_their_own(verdict):
    options = Options()
    spared = verdict in (Verdict.MISSING_PHYSICS, Verdict.UNEXPLAINED)
    assert only_repeated_rows(verdict, RepeatedRows(3, options.missed * 1.001), options) is not spared
    assert not only_repeated_rows(verdict, RepeatedRows(3, options.missed), options)


def test_intervals_of_one_owner_in_si_units():
    phase, twice = 2 * math.pi + 0.25, 2.0
    entries = [
        Entry(owner="", name="Jm"), Entry(owner="f", name="torque_Nm", scale=twice), Entry(owner="f", name="phase_rad"),
        Entry(owner="f", name="second", recording=1), Entry(owner="f", name="first", recording=0),
        Entry(owner="", name="initial_velocity"),
    ]  # fmt: skip
    fitted = SimpleNamespace(
        hypothesis=SimpleNamespace(entries=entries, bounds=(np.full(6, -99.0), np.full(6, 99.0))),
        fit=SimpleNamespace(x=np.array([1.0, 3.0, phase, 4.0, 5.0, 6.0])),
        standard_errors=lambda noise: np.full(6, 0.5),
    )
    found = estimates(fitted, search().fitter, "f")
    assert list(found) == ["torque_Nm", "phase_rad", "first"]
    assert found["torque_Nm"].value == 3.0 * twice
    assert found["torque_Nm"].ci95 == pytest.approx((6.0 - half_width(0.5), 6.0 + half_width(0.5)))
    assert found["torque_Nm"].unit == "N m"
    assert found["phase_rad"].value == pytest.approx(0.25), "within half a turn of zero"
    assert list(estimates(fitted, search().fitter, "")) == ["Jm"]


@pytest.mark.parametrize(("more", "freedom"), [(0, 1), (1, 1), (3, 3)])
def test_p_values_of_the_likelihood_ratio(more, freedom):
    poorer, richer = structure(chi2=1010.0, n=500, numbers=4), structure(COULOMB, chi2=1000.0, n=500, numbers=4 + more)
    held, ratio, gain = p_values(search(held=0.03), poorer, richer)
    assert held == 0.03
    assert gain == pytest.approx(500 * math.log(1.01))
    assert ratio == pytest.approx(chi2.sf(gain, freedom))
    worse = p_values(search(), richer, poorer)
    assert worse[1] == 1.0
    assert worse[2] < 0


def test_equivalents_are_as_near_by_the_criterion_and_replace_one_effect():
    best = structure(COULOMB, DELAY, criterion=100.0, numbers=5)
    near = structure(OFFSET, DELAY, criterion=100.0 + MARGIN)
    far = structure(effect_class("quadratic_friction")(coefficient_Nm_s2_rad2=1.0), DELAY, criterion=100.01 + MARGIN)
    more = structure(COULOMB, DELAY, OFFSET, criterion=90.0)
    other = structure(COULOMB, OFFSET, criterion=90.0)
    both = structure(OFFSET, effect_class("viscous_friction")(place="arm", coefficient_Nms_rad=1.0), criterion=90.0)
    found = search(best, near, far, more, other, both)
    assert tuple(equivalents(found, best, COULOMB)) == ("torque_offset",)
    assert tuple(equivalents(found, best, COULOMB, margin=MARGIN + 1.0)) == ("torque_offset", "quadratic_friction")
    assert tuple(equivalents(found, best, DELAY)) == ("torque_offset",)


def test_equivalents_stand_in_the_order_of_the_criterion_and_at_other_places_by_key():
    elsewhere = effect_class("coulomb_friction")(place="arm", torque_Nm=0.1)
    best = structure(COULOMB, criterion=0.0, numbers=5)
    found = search(best, structure(OFFSET, criterion=3.0), structure(elsewhere, criterion=2.0))
    assert tuple(equivalents(found, best, COULOMB)) == ("coulomb_friction@arm", "torque_offset")


def test_equivalents_stand_in_the_order_of_the_held_out_error_with_it():
    best = structure(COULOMB, criterion=0.0, numbers=5)
    delay = structure(DELAY, criterion=2.0, rms=0.44)
    found = search(best, delay, structure(OFFSET, criterion=3.0, rms=0.35))
    assert list(equivalents(found, best, COULOMB).items()) == [("torque_offset", 0.35), ("time_delay", 0.44)]


@pytest.mark.parametrize(("numbers", "listed"), [(5, True), (6, False)])
def test_a_refinement_that_gains_nothing_is_no_equivalent(numbers, listed):
    static = effect_class("static_friction")(torque_Nm=0.1, peak=1.1)
    assert COULOMB.id in type(static).refines
    best = structure(COULOMB, numbers=5)
    found = search(best, structure(static, numbers=numbers))
    assert bool(equivalents(found, best, COULOMB)) is listed


def test_another_law_of_the_same_effect_is_no_equivalent():
    law = effect_class("coulomb_friction_with_creep")(torque_Nm=0.1, creep_velocity_rad_s=1.0)
    assert law.name() == COULOMB.name()
    best = structure(COULOMB)
    assert equivalents(search(best, structure(law, numbers=0)), best, COULOMB) == {}


@pytest.mark.parametrize(
    ("rms", "squares", "numbers", "listed"),
    [(0.4, 1.039, 5, True), (0.5, 1.039, 5, False), (0.4, 1.041, 5, False), (0.4, 1.039, 6, False)],
)
def test_what_the_held_out_data_prefer_is_an_equivalent(rms, squares, numbers, listed):
    best = structure(COULOMB, criterion=0.0, numbers=5, rms=0.5)
    other = structure(OFFSET, criterion=50.0 + MARGIN, numbers=numbers, chi2=1000.0 * squares, rms=rms)
    assert bool(equivalents(search(best, other), best, COULOMB)) is listed
