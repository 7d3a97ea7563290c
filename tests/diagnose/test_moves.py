"""Moves: how far C may fall by one, and added bodies from all their starts."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from robot_axis import effect

from diagnose.fit.least_squares import Status
from diagnose.fit.starts import multistart
from diagnose.problem.noise_model import KnownNoise, ModelError
from diagnose.structure import halving
from diagnose.structure.candidates import Candidate
from diagnose.structure.moves import Moves
from diagnose.structure.score import Screened
from diagnose.thresholds import COARSE, FAR, LARGE, SMALL, TWICE

N = 1000
LINEAR = effect("coulomb_friction", torque_Nm=0.1)
NONLINEAR = effect("hardening_stiffness", place="arm", coefficient_Nm_rad3=1.0)


def bound(noise, law, chi2, gain) -> float:
    """The bound of a move that adds one effect to a structure that leaves ``chi2``."""
    state = SimpleNamespace(fitter=SimpleNamespace(noise=noise), context=SimpleNamespace(effective=1.0))
    base = SimpleNamespace(chi2=chi2, n=N)
    return Moves(state, None)._bound(base, Screened(Candidate(law.id, law.place), law, gain, (law,)))


@pytest.mark.parametrize(
    ("chi2", "gain", "left"), [(4000.0, 500.0, 4000.0 - TWICE * 500.0), (4000.0, 2500.0, N), (900.0, 50.0, 850.0)]
)
def test_a_linear_response_is_bounded_by_its_score_test_and_the_noise(chi2, gain, left):
    assert bound(KnownNoise(), LINEAR, chi2, gain) == pytest.approx(N * math.log(chi2 / left))


@pytest.mark.parametrize(("gain", "left"), [(0.0, N), (3900.0, 100.0), (math.inf, N)])
def test_a_nonlinear_response_may_explain_all_above_the_noise(gain, left):
    assert bound(KnownNoise(), NONLINEAR, 4000.0, gain) == pytest.approx(N * math.log(4000.0 / left))


@pytest.mark.parametrize(("gain", "left"), [(500.0, 4000.0 - TWICE * 500.0), (math.inf, 2000.0)])
def test_where_the_noise_is_not_known_the_score_test_stands(gain, left):
    assert bound(ModelError(), NONLINEAR, 4000.0, gain) == pytest.approx(N * math.log(4000.0 / left))


def test_an_added_body_is_fitted_from_all_its_starts_at_the_nominal_parameters(fitter_of, pair):
    """A spring of 0.4 of the nominal one stands in for the body, and no few iterations lead from there to it."""
    mode = effect("extra_flexible_mode", place="arm", inertia_kgm2=0.4, stiffness_Nm_rad=9000.0, damping_Nms_rad=5.0)
    fitter = fitter_of(pair(mode, seconds=1.0))
    as_is = fitter.fit(fitter.hypothesis(()), iterations=0)
    linear = as_is.linear | {"ka": 0.4 * as_is.linear["ka"]}
    far = fitter.fit(fitter.hypothesis([mode.with_values({"inertia_kgm2": 1e-3})], linear), iterations=0)
    found = multistart(fitter, far, far.effects[0])
    assert found.chi2 < 1.1 * found.n < 0.1 * far.chi2
    assert multistart(fitter, found, found.effects[0]) is found


def test_starts_are_fitted_in_coarse_steps_and_the_best_in_those_of_the_view(fitter_of, pair, monkeypatch):
    mode = effect("extra_flexible_mode", place="arm", inertia_kgm2=0.4, stiffness_Nm_rad=9000.0, damping_Nms_rad=5.0)
    fitter = fitter_of(pair(mode, seconds=1.0))
    far = fitter.fit(fitter.hypothesis([mode.with_values({"inertia_kgm2": 1e-3})]), iterations=0)
    steps, fit = [], type(fitter).fit
    monkeypatch.setattr(type(fitter), "fit", lambda self, *a, **how: steps.append(self.view.step) or fit(self, *a, **how))
    multistart(fitter, far, far.effects[0])
    first = 2 * type(mode).multistart
    assert steps[:first] == [COARSE] * first
    assert set(steps[first:]) == {fitter.view.step}
    assert fitter.view.step < COARSE


@pytest.mark.slow
def test_starts_keep_of_each_recording_what_belongs_to_the_other_effects(fitter_of, pair, monkeypatch):
    """A start in motion that was fitted without the effect compensates for it: a gap behind a motor was not found from there."""
    mode = effect("extra_flexible_mode", place="arm", inertia_kgm2=0.4, stiffness_Nm_rad=9000.0, damping_Nms_rad=5.0)
    ripple = effect("torque_ripple", amplitude_Nm=0.02, cycles_per_rev=8.0, phase_rad=0.5)
    fitter = fitter_of([r.slice(300, len(r)) for r in pair(mode)])
    far = fitter.fit(fitter.hypothesis([mode, ripple]), iterations=0)
    assert {owner for owner, _, _ in far.own} == {"", ripple.key}
    kept, made = [], type(fitter).hypothesis
    monkeypatch.setattr(type(fitter), "hypothesis", lambda self, e, linear, own: kept.append(own) or made(self, e, linear, own))
    multistart(fitter, far, mode)
    assert len(kept) == len(type(mode).starts(fitter.scales_for(type(mode), "arm")))
    assert all({owner for owner, _, _ in own} == {ripple.key} for own in kept)


@pytest.mark.parametrize(("best", "restarts"), [(1.02 * LARGE, 1), (0.98 * LARGE, 0)])
def test_an_added_body_is_not_fitted_anew_beside_a_neighbour_that_leaves_little(monkeypatch, best, restarts):
    mode = effect("extra_flexible_mode", place="arm", inertia_kgm2=0.4, stiffness_Nm_rad=9000.0, damping_Nms_rad=5.0)
    noise, asked = KnownNoise(), []
    fitter = SimpleNamespace(noise=noise, late=False, misfit=lambda f: f.left, above=lambda f, level: f.left > level)
    state = SimpleNamespace(fitter=fitter, once=lambda *_: True, keep=lambda _: None)
    far, near = (SimpleNamespace(left=x, effects=(e,), key=(e.key,)) for x, e in ((2 * FAR, mode), (best, LINEAR)))
    monkeypatch.setattr(halving, "multistart", lambda *a: asked.append(a))
    halving.Halving(state)._restart(SimpleNamespace(key=()), [near, far])
    assert len(asked) == restarts


ORDER = ["coulomb_friction", "integral_action", "torque_ripple", "extra_flexible_mode"]


@pytest.mark.parametrize("left", [0.9 * SMALL, 1.1 * SMALL])
@pytest.mark.parametrize("at", range(3))
def test_a_feedback_a_long_law_and_a_body_are_begun_last_and_not_where_another_leaves_little(monkeypatch, left, at):
    base, asked = SimpleNamespace(chi2=1e4, key=()), []
    found = {name: SimpleNamespace(chi2=left * 1e4 if k == at else 9e3) for k, name in enumerate(ORDER)}

    def fitted(_, base, neighbours, floor, ahead=()):
        names = [s.candidate.id for _, s in neighbours]
        if names:
            asked.append((names, len(ahead)))
        return [found[name] for name in names]

    monkeypatch.setattr(halving.Halving, "_fitted", fitted)
    monkeypatch.setattr(halving.Halving, "_from_nominal", lambda _, base, neighbours, found: found)
    monkeypatch.setattr(halving.Halving, "_long", lambda _, base, n: [x for x in n if x[1].candidate.id == "torque_ripple"])
    neighbours = [((), SimpleNamespace(candidate=SimpleNamespace(id=name))) for name in reversed(ORDER)]
    out = halving.Halving(SimpleNamespace(fitter=SimpleNamespace(above=lambda f, _: True))).run(base, neighbours, 0.0)
    begun = at + 1 if left < SMALL else 4
    assert asked == [([name], k) for k, name in enumerate(ORDER[:begun])]
    assert len(out) == begun


@pytest.mark.parametrize(("runs", "order", "late"), [(14_000, 3e6, True), (14_000, 3.0, False), (math.inf, 3e6, False)])
def test_a_law_is_long_that_takes_more_runs_than_the_others_and_than_its_share(fitter_of, pair, runs, order, late):
    fitter = fitter_of(pair())
    fitter.allow(runs)
    base = fitter.fit(fitter.hypothesis(()), iterations=0)
    ripple = effect("torque_ripple", amplitude_Nm=0.02, cycles_per_rev=order, phase_rad=0.5)
    neighbours = [((), SimpleNamespace(effect=e)) for e in (ripple, LINEAR, effect("torque_offset", torque_Nm=0.1))]
    assert halving.Halving(SimpleNamespace(fitter=fitter))._long(base, neighbours) == neighbours[: int(late)]


def test_one_fit_takes_a_part_of_the_budget(fitter_of, pair):
    ripple = effect("torque_ripple", amplitude_Nm=0.02, cycles_per_rev=8.0, phase_rad=0.5)
    fitter = fitter_of(pair(LINEAR, seconds=1.0))
    plain = fitter.fit(fitter.hypothesis([ripple]))
    assert plain.fit.iterations > 3
    fitter.allow(1.0)
    stopped = fitter.fit(fitter.hypothesis([ripple]))
    assert (stopped.fit.iterations, stopped.fit.status) == (1, Status.BUDGET)
    assert plain.chi2 < stopped.chi2 < math.inf


@pytest.mark.parametrize(
    ("effects", "best", "lead", "tried"),
    [((), 76.0, 75.0, True), ((), 76.0, 77.0, False), ((LINEAR,), 76.0, 10.0, False), ((), 74.0, 10.0, False)],
)
def test_where_no_neighbour_helps_the_leading_one_at_the_nominal_numbers_is_fitted(monkeypatch, effects, best, lead, tried):
    """Of a base that leaves 100: a quarter off it is needed, and less than what the best neighbour leaves."""
    fitted = []

    def fit(hypothesis, start):
        fitted.append((hypothesis, start))
        return SimpleNamespace(ok=True)

    state = SimpleNamespace(
        fitter=SimpleNamespace(late=False, above=lambda f, _: True, fit=fit, hypothesis=lambda *_: "of the best"),
        keep=lambda f: None, fits=SimpleNamespace(best=lambda f: f),
    )  # fmt: skip
    leading = SimpleNamespace(chi2=lead, hypothesis="of the lead", fit=SimpleNamespace(x="where it came to"))
    monkeypatch.setattr(halving.Halving, "_leading_at_nominal", lambda *_: leading)
    found = [SimpleNamespace(chi2=best, effects=(LINEAR,), own={})]
    base = SimpleNamespace(chi2=100.0, effects=effects)
    assert halving.Halving(state)._from_nominal(base, [], found) == found
    led = [("of the lead", "where it came to")] if tried else [("of the best", None)] if best < 75.0 else []
    assert fitted == led
