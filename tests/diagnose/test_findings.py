"""What is named of the best structure: compounds, effects whose sizes are determined, evidence against the structure without."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.evidence.admissible import Outside
from diagnose.evidence.held_out import Comparison
from diagnose.evidence.intervals import Open
from diagnose.problem.noise_model import KnownNoise
from diagnose.thresholds import EQUIVALENT
from diagnose.verdict import determined as determined_module
from diagnose.verdict import findings as findings_module
from diagnose.verdict.determined import _alike, _sentence, determined
from diagnose.verdict.findings import findings, merged, nominal_effect
from mjsim.axis import Body, Chain
from mjsim.effects import effect_class
from mjsim.effects.admissible import Range
from mjsim.quantity import Quantity

COULOMB = effect_class("coulomb_friction")(torque_Nm=0.1)
STRIBECK = effect_class("stribeck_friction")(torque_Nm=0.1, extra_static_torque_Nm=0.01, stribeck_velocity_rad_s=1.0)
DELAY = effect_class("time_delay")(place="actuator", delay_s=1e-3)
OFFSET = effect_class("torque_offset")(torque_Nm=0.02)


def structure(*effects, chi2=1000.0, criterion=0.0, ok=True):
    return SimpleNamespace(
        effects=effects, key=tuple(sorted(e.key for e in effects)), chi2=chi2, n=1000, criterion=criterion, ok=ok,
        linear={}, own={},
        hypothesis=SimpleNamespace(entries=(), size=0, bounds=(np.zeros(0), np.zeros(0))), fit=SimpleNamespace(x=np.zeros(0)),
        standard_errors=lambda noise: np.zeros(0),
    )  # fmt: skip


def search_of(robot, without=None, simpler=(), limits=(), admitted=lambda ids: True):
    """The parts of a search that are asked; ``without``: the structure without an effect, by its key."""
    fits = {}
    pruning = SimpleNamespace(
        without=lambda best, effect: without[effect.key], simplified=lambda best, effect: [lambda f=f: f for f in simpler],
        limits=lambda *_: [lambda f=f: f for f in limits], fit_confounders=lambda best, effect: asked.append(effect.key),
    )  # fmt: skip
    asked: list[str] = []
    return SimpleNamespace(
        fitter=SimpleNamespace(
            noise=KnownNoise(), nominal=robot, map=lambda tasks: [t() for t in tasks], refined=lambda f: f,
            hypothesis=lambda effects, linear=None, own=None: effects, fit=lambda effects, iterations: fits["next"],
        ),
        pruning=pruning, polish=lambda f: f, criterion=lambda f: f.criterion, asked=asked,
        state=SimpleNamespace(admitted=admitted, candidates=(), refusals={}), fits=fits, tested=0,
        keep=lambda f: fits.__setitem__(f.key, f), held_out=lambda f: SimpleNamespace(rms=f.chi2 / 1000),
        context=SimpleNamespace(ahead=lambda best, f: f.criterion - best.criterion, compared=lambda *_: Comparison(0.1, 0.02)),
    )  # fmt: skip


@pytest.fixture
def open_in(monkeypatch):
    """Effects that count as undetermined, wherever they are."""

    def these(*effects, chance=False):
        if not chance:
            monkeypatch.setattr(determined_module, "_by_chance", lambda search, best: [])

        def found(f, noise):
            return tuple(Open(e, e.amplitudes[0], 0.01, (-0.02, 0.04)) for e in f.effects if e in effects)

        monkeypatch.setattr(determined_module, "open_sizes", found)
        monkeypatch.setattr(determined_module, "out_of_range", lambda f, fitter: ())

    return these


def test_an_undetermined_effect_gives_way_to_the_least_criterion(robot, open_in):
    open_in(STRIBECK)
    best = structure(STRIBECK, DELAY)
    bare, plain, worse = (
        structure(DELAY, criterion=5.0),
        structure(COULOMB, DELAY, criterion=1.0),
        structure(OFFSET, criterion=2.0),
    )
    found, said = determined(search_of(robot, {STRIBECK.key: bare}, simpler=(plain,), limits=(worse,)), best)
    assert found is plain
    assert said == (
        "Stribeck friction at the motor is not named: the 95 % interval of its torque_Nm, [-0.02, 0.04], contains zero; "
        "coulomb friction is fitted in its place.",
    )
    found, said = determined(search_of(robot, {STRIBECK.key: bare}), best)
    assert found is bare
    assert said[0].endswith("contains zero; it is left out.")


def test_what_keeps_the_effect_or_is_not_admitted_does_not_take_its_place(robot, open_in):
    open_in(STRIBECK)
    best = structure(STRIBECK)
    failed, same = structure(criterion=-9.0, ok=False), structure(STRIBECK, OFFSET, criterion=-8.0)
    barred, left = structure(COULOMB, criterion=-7.0), structure(OFFSET, criterion=3.0)
    search = search_of(
        robot, {STRIBECK.key: failed}, simpler=(same, barred), limits=(same, left), admitted=lambda ids: COULOMB.id not in ids
    )
    assert determined(search, best)[0] is left
    nothing = search_of(robot, {STRIBECK.key: failed})
    assert determined(nothing, best) == (best, ()), "none can be fitted"


@pytest.mark.parametrize(("tested", "kept"), [(2, True), (3, False)])
def test_a_gain_that_the_best_of_many_hypotheses_has_by_chance_names_nothing(robot, open_in, tested, kept):
    open_in(chance=True)
    best, bare = structure(DELAY), structure()
    search = search_of(robot, {DELAY.key: bare})
    search.tested = tested  # the p-value of one is .02
    search.keep(best)
    found, said = determined(search, best)
    assert found is (best if kept else bare)
    if not kept:
        assert said == (
            "Time delay at the actuator is not named: over 3 hypotheses its gain on held-out data has p = 0.06, which is chance; "
            "it is left out.",
        )
        assert search.state.refusals[best.key].veto.code == "chance"


def test_each_undetermined_effect_is_taken_in_turn(robot, open_in):
    open_in(STRIBECK, OFFSET)
    best, one, none = structure(STRIBECK, OFFSET, DELAY), structure(OFFSET, DELAY), structure(DELAY)
    search = search_of(robot, {STRIBECK.key: one, OFFSET.key: none})
    found, said = determined(search, best)
    assert found is none
    assert len(said) == 2
    open_in()
    assert determined(search, best) == (best, ())
    open_in(STRIBECK)
    failed = structure(STRIBECK, ok=False)
    assert determined(search, failed) == (failed, ()), "nothing is known of a fit that failed"


def test_exchange_of_undetermined_effects_ends(robot, open_in):
    """Each step may bring in another effect, but none that was refused."""
    open_in(STRIBECK, COULOMB)
    turn = {STRIBECK.key: structure(COULOMB), COULOMB.key: structure(STRIBECK)}
    found, said = determined(search_of(robot, turn), structure(STRIBECK))
    assert len(said) == 1
    assert found.key == (COULOMB.key,)
    found, said = determined(search_of(robot, {**turn, COULOMB.key: structure()}), structure(STRIBECK))
    assert len(said) == 2
    assert found.key == ()


@pytest.mark.parametrize(("behind", "ok", "is_merged"), [(10.0, True, True), (10.01, True, False), (0.0, False, False)])
def test_one_compound_effect_for_two_that_are_not_told_apart(robot, monkeypatch, behind, ok, is_merged):
    """Within a margin of 10 in C, a likelihood ratio of 150."""
    monkeypatch.setattr(findings_module, "compounds", lambda candidates, effects: [(STRIBECK,)])
    best, simpler = structure(COULOMB, OFFSET, criterion=1.0), structure(STRIBECK, criterion=1.0 + behind, ok=ok)
    search = search_of(robot)
    search.fits["next"] = simpler
    assert merged(search, best) is (simpler if is_merged else best)
    assert (simpler.key in search.fits) is is_merged


@pytest.mark.parametrize(("tested", "corrected"), [(0, 0.02), (1, 0.02), (5, 0.1), (80, 1.0)])
def test_findings_come_by_their_gain_each_against_the_structure_without_it(robot, monkeypatch, tested, corrected):
    monkeypatch.setattr(findings_module, "_by_weight", lambda *_: ())
    best = structure(COULOMB, DELAY, chi2=1000.0)
    search = search_of(robot, {COULOMB.key: structure(DELAY, chi2=1100.0), DELAY.key: structure(COULOMB, chi2=3000.0)})
    search.tested = tested
    delay, friction = findings(search, best)
    assert (delay.effect, delay.place, friction.effect) == ("time_delay", "actuator", "coulomb_friction")
    assert friction.form == ""
    assert friction.element == "motor"
    assert friction.evidence["delta_chi2"] == pytest.approx(1000 * math.log(1.1))
    assert (friction.evidence["held_out_error_before"], friction.evidence["held_out_error_after"]) == (1.1, 1.0)
    assert friction.evidence["p_value"] == pytest.approx(corrected)
    assert friction.evidence["hypotheses"] == tested
    assert search.asked == [COULOMB.key, DELAY.key], "confounders are fitted first"
    search.held_out = lambda f: None
    assert math.isnan(findings(search, best)[0].evidence["held_out_error_after"])


def test_parameters_of_a_nominal_effect_that_no_sample_shows_are_left_out(robot):
    """The rows of the prior stand below the samples' and tell nothing of the recordings."""
    entries = [
        SimpleNamespace(owner=STRIBECK.key, name=n, quantity=Quantity.TORQUE, recording=-1, si=lambda x: x)
        for n in ("torque_Nm", "extra_static_torque_Nm")
    ]
    J = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 5.0]])
    best = SimpleNamespace(
        fit=SimpleNamespace(residual=np.zeros(3), J=J, x=np.array([0.2, 0.3])),
        hypothesis=SimpleNamespace(entries=entries, told=(1, 3), prior_terms=(1, 3), bounds=(np.full(2, -9.0), np.full(2, 9.0))),
        standard_errors=lambda noise: np.ones(2),
    )  # fmt: skip
    search = search_of(robot)
    found = nominal_effect(search.fitter, best, STRIBECK)
    assert list(found.parameters) == ["torque_Nm"]
    assert found.nominal == STRIBECK.values


@pytest.mark.parametrize(("ahead", "refused"), [(EQUIVALENT, True), (1.001 * EQUIVALENT, False)])
def test_an_effect_that_cannot_be_told_from_one_too_small_to_be_shown_is_not_named(ahead, refused):
    """The structure with the small effect in its place is as good, by the criterion, to within what tells rivals apart."""
    dead, lead = (SimpleNamespace(key=f"{x}@actuator", name=lambda x=x: x, place="actuator") for x in ("dead", "lead"))
    small = {lead.key: Outside(lead, Range("lead", 6e-5, 2e-3, math.inf, "a sample", timing=True))}
    best = SimpleNamespace(key=("dead@actuator", "rub@motor"), effects=(dead,))
    search = SimpleNamespace(
        fits={("lead@actuator", "rub@motor"): "rival"}, context=SimpleNamespace(ahead=lambda f, other: ahead)
    )
    found = _alike(search, best, small)
    assert [(a.effect, a.small.effect) for a in found] == ([(dead, lead)] if refused else [])
    assert _alike(search, best, {}) == []
    if refused:
        assert "too small to be shown: below 0.002, a sample" in _sentence(best, SimpleNamespace(effects=(), key=()), found[0])


WAVE = effect_class("position_dependent_friction")(torque_Nm=0.3, relative_amplitude=0.5, cycles_per_rev=2.0, phase_rad=0.0)


@pytest.mark.parametrize(
    ("alike", "behind", "ok", "named"),
    [
        (0.95, EQUIVALENT, True, ("load_dependent_friction",)), (0.95, 1.01 * EQUIVALENT, True, ()), (0.95, 0.0, False, ()),
        (0.85, 0.0, True, ()),
    ],
)  # fmt: skip
def test_friction_by_the_load_is_an_equivalent_where_it_leaves_as_little(monkeypatch, alike, behind, ok, named):
    """Where friction over the angle follows a weight, its square by more than 0.8, the data are asked, within 10 in C."""
    rigid = SimpleNamespace(chain=Chain((Body("motor", 0.1, 0.05, "j"),), ()), effects=())
    search, best = search_of(rigid), structure(WAVE, DELAY)
    recording = SimpleNamespace(angle=np.zeros(8))
    search.fitter.experiments, search.fitter.scales = (
        [SimpleNamespace(recording=recording)],
        {"motor": SimpleNamespace(velocity=1.0)},
    )
    search.fitter.scales_for = lambda cls, place: SimpleNamespace(torque=1.0)
    load = effect_class("load_dependent_friction")(coefficient=0.1)
    best.carried = ()
    search.fits["next"] = structure(COULOMB, load, DELAY, criterion=behind, ok=ok)
    asked = []
    search.fitter.hypothesis = lambda effects, linear=None, own=None: asked.append(effects)
    monkeypatch.setattr(findings_module, "follows_weight", lambda *_: alike)
    assert findings_module._by_weight(search, best, WAVE) == named
    assert [sorted(e.id for e in effects) for effects in asked] == (
        [["coulomb_friction", "load_dependent_friction", "time_delay"]] if alike > 0.9 else []
    )
    undriven = dataclasses.replace(rigid.chain, driven=False)
    search.fitter.nominal = SimpleNamespace(chain=undriven, effects=())
    assert findings_module._by_weight(search, best, WAVE) == (), "nothing drives it: its load is nothing"
