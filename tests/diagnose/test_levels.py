"""Levels of noise, intervals and limits: each decision on both sides of its threshold, on made-up figures."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnose.evidence.intervals import at_bounds, half_width, open_sizes, sizes_of
from diagnose.fit.least_squares import Status
from diagnose.thresholds import ROUNDING, SIGMAS, SMALL
from diagnose.verdict import determined as asked
from diagnose.verdict import reference_stage
from diagnose.verdict.determined import _admissible, _poorer, determined
from diagnose.verdict.reference import Case, Run, at_noise, chi_square, figures, noise_level
from diagnose.verdict.reference_stage import (
    NEAR,
    Nominal,
    _reaches,
    _shifts,
    _soft_fits,
    apart,
    by_other_friction,
    without_difference,
)  # fmt: skip
from mjsim.chain import Limit
from mjsim.effects import effect_class
from mjsim.plant import Start
from mjsim.recording import Recording

DT, N = 0.01, 200
START = Start(0.0, 0.0, 0.0)
COULOMB = effect_class("coulomb_friction")(torque_Nm=0.1)
STRIBECK = effect_class("stribeck_friction")(torque_Nm=0.1, extra_static_torque_Nm=0.1, stribeck_velocity_rad_s=1.0)


def case(measured=None, *, sigma=0.1, held=80, angle=None, source="log.csv"):
    """A case whose last samples are held out, the first one in neither part."""
    measured = 2.0 + np.arange(N) % 2 if measured is None else measured
    r = Recording(DT * np.arange(N), np.zeros(N), measured, angle, DT, source=source)
    part = np.arange(N)
    return Case(r, measured, sigma, True, (part > 0) & (part < N - held), part >= N - held)


def run(velocity, angle=None):
    return Run(velocity, np.zeros(len(velocity)) if angle is None else angle, START)


def test_the_level_of_noise():
    """1.05 n, and `SIGMAS` standard deviations of a chi-square of n degrees of freedom, which is sqrt(2 n)."""
    assert noise_level(200) == 200 * (1 + SMALL) + SIGMAS * 20.0
    assert noise_level(0) == 0.0


@pytest.mark.parametrize("part", ["estimation", "held_out"])
def test_noise_is_told_on_both_kinds_of_data(part):
    one = case()
    keep = getattr(one, part)
    n = int(keep.sum())
    for factor, quiet in ((1 - 1e-9, True), (1 + 1e-9, False)):
        off = one.sigma * math.sqrt(factor * noise_level(n) / n)
        assert at_noise([one], [run(one.measured + off * keep)]) is quiet
    assert at_noise([one], [run(one.measured)])
    assert not at_noise([one], [None])


def test_chi_square_of_parts_of_runs():
    one = case()
    off = run(one.measured + 0.1)
    assert chi_square([one, one], [off, off]) == (pytest.approx(2 * 119), 238)
    assert chi_square([one], [run(off.velocity[:50])]) == (pytest.approx(49), 49)
    assert chi_square([one], [None], "held_out") == (math.inf, 80)
    assert chi_square([case(held=0)], [None], "held_out") == (0.0, 0)


def test_figures_of_two_recordings():
    """Over all samples of a part: the rms, and the rms over the spread of the measured signal about its mean."""
    one, other = case(), case(2.0 + 2.0 * (np.arange(N) % 2))
    runs = [run(one.measured + 0.3), run(other.measured - 0.1)]
    found = figures([one, other], runs)
    assert found.rms == pytest.approx(math.sqrt((0.09 + 0.01) / 2))
    assert found.held_out_rms == pytest.approx(found.rms)
    assert found.held_out_nrmse == pytest.approx(math.sqrt((0.09 + 0.01) / (0.25 + 1.0)))
    assert found.nrmse == pytest.approx(found.rms / math.sqrt((0.25 + 1.0) / 2), rel=1e-3)
    none = figures([case(held=0)], [run(one.measured)])
    assert none.rms == 0.0
    assert math.isnan(none.held_out_rms)
    assert math.isnan(none.held_out_nrmse)
    assert figures([one, other], [None, runs[1]]).rms == math.inf
    assert figures([case(held=0), one], [None, runs[0]]).held_out_rms == pytest.approx(0.3)


class Sizes:
    """A fit of Coulomb and Stribeck friction and of an inertia, its numbers and standard errors given."""

    def __init__(self, values: dict[tuple[str, str], tuple[float, float]]) -> None:
        self.effects = (COULOMB, STRIBECK)
        entries = [SimpleNamespace(owner=owner, name=name, si=lambda x: 2.0 * x) for owner, name in values]
        self.hypothesis = SimpleNamespace(entries=entries)
        self.fit = SimpleNamespace(x=np.array([v / 2.0 for v, _ in values.values()]))
        self.errors = [e for _, e in values.values()]

    def standard_errors(self, noise: Any) -> list[float]:
        return self.errors


def test_a_size_is_open_where_its_interval_contains_zero():
    c, s = COULOMB.key, STRIBECK.key
    assert "stribeck_velocity_rad_s" not in sizes_of(STRIBECK)
    half = half_width(1.0)
    assert half == pytest.approx(1.95996, rel=1e-5)
    f = Sizes({("", "Jm"): (0.0, 1.0), (c, "torque_Nm"): (half, 1.0), (s, "extra_static_torque_Nm"): (-0.99 * half, 1.0),
               (s, "stribeck_velocity_rad_s"): (0.0, 1.0)})  # fmt: skip
    (found,) = open_sizes(f, None)
    assert (found.effect, found.name, found.value) == (STRIBECK, "extra_static_torque_Nm", -0.99 * half)
    assert found.ci95 == (pytest.approx(-1.99 * half), pytest.approx(0.01 * half))
    assert [o.name for o in open_sizes(f, None, {s: ("stribeck_velocity_rad_s",)})] == ["stribeck_velocity_rad_s"]
    assert open_sizes(f, None, {}) == ()
    f.errors = [math.nan] * 4
    assert [o.name for o in open_sizes(f, None)] == ["torque_Nm", "extra_static_torque_Nm"]  # of no interval nothing is known


def test_a_number_at_a_bound():
    """Inertias and stiffnesses of the model, whose entries are logarithms, within `ROUNDING` of a bound."""
    entry = lambda name, owner="", log=True: SimpleNamespace(name=name, owner=owner, log=log)  # noqa: E731
    entries = [entry("low"), entry("near low"), entry("within"), entry("near high"), entry("high"), entry("own", "coulomb@motor"),
               entry("plain", log=False)]  # fmt: skip
    x = [-1.0, -1.0 + 2 * ROUNDING, 0.0, 1.0 - 2 * ROUNDING, 1.0, 1.0, 1.0]
    hypothesis = SimpleNamespace(entries=entries, bounds=([-1.0] * 7, [1.0] * 7))
    assert at_bounds(SimpleNamespace(hypothesis=hypothesis, fit=SimpleNamespace(x=x))) == ("low", "high")
    x[1], x[3] = -1.0 + 0.5 * ROUNDING, 1.0 - 0.5 * ROUNDING
    assert at_bounds(SimpleNamespace(hypothesis=hypothesis, fit=SimpleNamespace(x=x))) == ("low", "near low", "near high", "high")


def structure(name, *effects, cost=0.0, ok=True, status=None):
    fit = SimpleNamespace(status=status)
    return SimpleNamespace(name=name, effects=effects, key=tuple(e.key for e in effects), cost=cost, ok=ok, fit=fit)


def search(*rivals, others=(), limits=(), significant=lambda f: True):
    """A search of made-up structures, whose criterion is their cost."""
    without, *simpler = rivals
    return SimpleNamespace(
        pruning=SimpleNamespace(
            without=lambda best, effect: without, simplified=lambda best, effect: [lambda f=f: f for f in simpler],
            limits=lambda *_: [lambda f=f: f for f in limits],
        ),
        state=SimpleNamespace(admitted=lambda ids: "hysteresis" not in ids), criterion=lambda f: f.cost,
        significance=SimpleNamespace(significant=lambda nominal, f: significant(f)), nominal=lambda: "nominal",
        fits={f.name: f for f in others}, context=SimpleNamespace(gain=lambda nominal, least: 5.0),
        halving=SimpleNamespace(may_gain=lambda nominal, f, floor: floor == 5.0 and f.name != "behind"),
        polish=lambda f: structure(f"{f.name} polished", *f.effects, cost=f.cost - 1.0),
        options=SimpleNamespace(width=2), fitter=SimpleNamespace(noise=None, refined=lambda f: f),
    )  # fmt: skip


OPEN = asked.Open(STRIBECK, "extra_static_torque_Nm", 0.01, (-0.01, 0.03))
SPRING = effect_class("joint_spring")(stiffness_Nm_rad=1.0, torque_at_zero_Nm=0.0)


def test_an_undetermined_effect_gives_way_to_the_structure_of_the_least_criterion():
    best = structure("both", STRIBECK, SPRING)
    nothing, simpler = structure("spring", SPRING, cost=2.0), structure("simpler", COULOMB, SPRING, cost=1.0)
    assert _poorer(search(nothing, simpler), best, OPEN, {STRIBECK.key}) is simpler
    assert _poorer(search(nothing, structure("simpler", COULOMB, cost=1.0, ok=False)), best, OPEN, {STRIBECK.key}) is nothing
    assert _poorer(search(nothing, structure("still", STRIBECK, cost=0.0)), best, OPEN, {STRIBECK.key}) is nothing
    limit = structure("limit", COULOMB, cost=0.5)
    assert _poorer(search(nothing, simpler, limits=[limit, best]), best, OPEN, {STRIBECK.key}) is limit
    assert _poorer(search(structure("spring", SPRING, ok=False)), best, OPEN, {STRIBECK.key}) is None


def test_a_rival_takes_the_place_of_what_the_recording_cannot_show(monkeypatch):
    outside = asked.Outside(STRIBECK, None)
    monkeypatch.setattr(asked, "out_of_range", lambda f, fitter: ("too fast",) if f.name == "outside" else ())
    best, least = structure("stribeck", STRIBECK), structure("nothing", cost=2.0)
    rival = structure("rival", SPRING, cost=1.0)
    assert _poorer(search(least, others=[rival]), best, outside, {STRIBECK.key}) is rival
    assert _poorer(search(least, others=[structure("same", SPRING, cost=2.0)]), best, outside, {STRIBECK.key}) is least
    assert _poorer(search(least, others=[rival], significant=lambda f: False), best, outside, {STRIBECK.key}) is least
    second = structure("second", COULOMB, cost=1.5)
    assert (
        _poorer(search(least, others=[second, rival], significant=lambda f: f is second), best, outside, {STRIBECK.key}) is second
    )
    assert _poorer(search(least, others=[rival]), best, OPEN, {STRIBECK.key}) is least


def test_which_structures_of_the_search_are_asked_about(monkeypatch):
    monkeypatch.setattr(asked, "out_of_range", lambda f, fitter: ("too fast",) if f.name == "outside" else ())
    least, good = structure("nothing", cost=2.0), structure("good", SPRING, cost=1.0)
    for other in (
        structure("failed", SPRING, ok=False),
        structure("empty"),
        structure("it", STRIBECK),
        structure("outside", SPRING),
    ):
        assert _admissible(search(least, others=[other, good]), {STRIBECK.key}, least) == [good]
    begun, behind = (structure(n, SPRING, cost=0.5, status=Status.BUDGET) for n in ("begun", "behind"))
    assert [f.name for f in _admissible(search(least, others=[good, begun]), {STRIBECK.key}, least)] == ["begun polished", "good"]
    assert _admissible(search(least, others=[good, behind]), {STRIBECK.key}, least) == [behind, good]
    three = [structure(str(i), SPRING, cost=float(i)) for i in (3, 1, 2)]
    assert [f.name for f in _admissible(search(least, others=three), {STRIBECK.key}, least)] == ["1", "2"]


def test_one_effect_after_the_other_is_left_out(monkeypatch):
    both, one = structure("both", STRIBECK, SPRING), structure("spring", SPRING)
    monkeypatch.setattr(asked, "out_of_range", lambda f, fitter: ())
    monkeypatch.setattr(asked, "open_sizes", lambda f, noise: (OPEN,) if f.name == "both" else ())
    monkeypatch.setattr(asked, "_by_chance", lambda search, best: [])
    s = search(one)
    s.polish = lambda f: f
    best, said = determined(s, both)
    assert best is one
    assert said == (
        "Stribeck friction at the motor is not named: the 95 % interval of its extra_static_torque_Nm, [-0.01, 0.03], contains "
        "zero; it is left out.",
    )
    assert determined(s, one) == (one, ())
    failed = structure("both", STRIBECK, SPRING, ok=False)
    assert determined(s, failed) == (failed, ())
    assert determined(search(structure("none", ok=False)), both) == (both, ())


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("whose", ["angle", "run", "sum"])
def test_a_limit_is_reached_within_a_tenth_of_the_travel(side, whose):
    """Of the recording's angle (the sum of its velocity where it has none), or of the run of the file."""
    swing = 0.5 * np.sin(np.linspace(0, 6 * np.pi, N))
    travel, end = float(np.ptp(swing)), float(np.max(side * swing))
    for factor, reaches in ((0.99, True), (1.01, False)):
        far = end + factor * NEAR * travel
        limit = Limit(*sorted((side * far, -side * 1e3)), 1.0, 1.0)
        if whose == "angle":
            assert _reaches(limit, case(angle=swing), None) is reaches
        elif whose == "run":
            assert _reaches(limit, case(angle=0.0 * swing), run(np.zeros(N), swing)) is reaches
        else:
            velocity = np.diff(swing, prepend=0.0) / DT
            assert _reaches(limit, case(velocity), None) is reaches


def test_how_far_two_models_are_apart():
    one, other = case(sigma=0.1), case(sigma=0.5)
    a, b = run(one.measured), run(one.measured + 0.2)
    assert apart([one, other], [a, a], [b, b]) == pytest.approx(2.0)
    assert apart([other], [a], [b]) == pytest.approx(0.4)
    assert apart([one], [a], [a]) == 0.0
    assert apart([one], [None], [a]) == math.inf
    assert apart([one], [a], [None]) == math.inf
    (shift,) = _shifts([one], [a], [b])
    assert shift == pytest.approx(0.2)
    assert _shifts([one, one], [a, None], [b, b]) == ()
    assert _shifts([one], [a], [None]) == ()


@pytest.mark.parametrize(
    ("soft", "hard", "fits"),
    [(1.0, 2.0, True), (2.0, 2.0, True), (2.0, 1.0, False), (1.0, None, True), (None, 2.0, False), (None, None, False)],
)  # fmt: skip
def test_soft_friction_fits_as_well(monkeypatch, soft, hard, fits):
    found = {"soft": soft, "hard": hard}

    def refit(axis, cases, starts):
        return None if found[axis] is None else SimpleNamespace(chi2=found[axis])

    monkeypatch.setattr(reference_stage, "refit_in_engine", refit)
    assert _soft_fits("soft", "hard", (), ()) is fits


def test_the_other_kind_of_friction_has_no_numerics_taken_out(monkeypatch):
    one, passed = case(), []
    monkeypatch.setattr(reference_stage, "as_servo", lambda axis, *_: (f"servo {axis}",))

    def surrogate(axis, c, start, *, locked):
        passed.append((axis, start, locked))
        return run(one.measured + 0.1)

    monkeypatch.setattr(reference_stage, "run_surrogate", surrogate)
    given = Nominal(
        "p", "soft", "hard", 1.0, "plant", (one, one), [run(one.measured), None], [], 9.0, True, "refit", "engine", (1,)
    )
    out = by_other_friction(given)
    assert (out.axis, out.other, out.simulator, out.refitted, out.by_engine, out.shifts) == ("hard", None, False, None, None, ())
    assert passed == [("servo hard", START, False), ("servo hard", one.start(), False)]
    assert out.apart == math.inf
    with pytest.raises(ValueError, match="one kind"):
        by_other_friction(out)


@dataclasses.dataclass(frozen=True)
class Signals:
    """Traces of one recording."""

    source: str
    time: np.ndarray
    measured: np.ndarray
    nominal: np.ndarray | None = None
    refitted: np.ndarray | None = None
    corrected: np.ndarray | None = None
    mapped: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Told:
    """What of a diagnosis is changed."""

    traces: tuple[Signals, ...]


def test_signals_are_shown_as_they_were_recorded():
    t = np.arange(N)
    shift = 0.25 * np.ones(N)
    result = Told((Signals("log.csv", t, 1.0 * t, 2.0 * t), Signals("log.csv", t[:9], 1.0 * t[:9]), Signals("x.csv", t, 1.0 * t)))
    given = SimpleNamespace(simulator=True, cases=(case(),), shifts=(shift,))
    first, short, other = without_difference(result, given).traces
    assert np.array_equal(first.measured, t - shift)
    assert np.array_equal(first.nominal, 2.0 * t - shift)
    assert first.corrected is None
    assert short is result.traces[1]
    assert other is result.traces[2]
    assert without_difference(result, SimpleNamespace(simulator=False)) is result
