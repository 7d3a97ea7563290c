"""A search among models that the measured velocity leads, and how many simulations a diagnosis may take."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Status
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.result import Verdict
from diagnose.structure.budget import SearchOptions
from diagnose.structure.growth import Growth
from diagnose.structure.multistart import Multistart
from diagnose.structure.observer_search import among_led
from diagnose.structure.search import Search
from mjsim.effects import effect_class
from mjsim.excitation import chirp
from mjsim.ode import simulate, work_done
from mjsim.recording import Recording

DT, N, NOISE = 1e-3, 8_000, 0.05
STICTION = {"torque_Nm": 0.06, "peak": 3.6}
PAIR = ("coulomb_friction", "static_friction", "stribeck_friction", "sensor_lag", "hysteresis")


def recorded(plant, seed: int, amplitude: float = 0.6) -> Recording:
    """A chirp of an axis that sticks at each reversal."""
    torque = chirp(N * DT, DT, amplitude, 0.5, 25.0)
    run = simulate(plant, torque, DT)
    rng = np.random.default_rng(seed)
    return Recording(
        run.time, torque, run.velocity + NOISE * rng.standard_normal(N), run.angle + 1e-4 * rng.standard_normal(N), DT
    )


@pytest.fixture(scope="module")
def plant(robot):
    """Static friction behind a sensor that lags: neither is seen for what it is without the other."""
    changed = robot.with_linear({p.name: 1.05 * p.value for p in robot.chain.linear_parameters() if p.name != "dg"})
    return changed + effect_class("static_friction")(**STICTION) + effect_class("sensor_lag")(time_constant_s=2e-3)


@pytest.fixture
def search(robot, plant):
    """A search that has only the nominal model so far."""
    experiment, held = (prepare(recorded(plant, seed, a)) for seed, a in ((1, 0.6), (2, 0.5)))
    fitter = Fitter(robot, MotionView(), (experiment,), (held,), 1)
    found = Search(fitter, SearchOptions(only=PAIR))
    found.nominal()
    yield found
    fitter.close()


def test_a_pair_of_which_one_sticks_is_found_among_led_models(search):
    before = search.fitter.runs
    among_led(search)
    best = min(search.pool.values(), key=search.criterion)
    assert best.key == ("sensor_lag@sensor", "static_friction@motor")
    assert best.chi2 < 0.02 * search.nominal().chi2
    assert before < search.fitter.runs < before + 15_000


def test_what_sticks_is_asked_what_it_lacks_though_it_comes_near_only_as_another_law(search, monkeypatch):
    """Friction of another law had won the race; what sticks was not near the best until it was tried in its place."""
    laws = effect_class("coulomb_friction")(torque_Nm=0.05), effect_class("static_friction")(**STICTION)
    first, sticking = (search.fitter.fit(search.fitter.hypothesis([law]), iterations=3) for law in laws)
    monkeypatch.setattr(Growth, "expand", lambda self, base: self.state.keep(first) or [first])
    monkeypatch.setattr(Growth, "refine", lambda self, base, *, forms=False: self.state.keep(sticking) or [sticking])
    asked = []
    monkeypatch.setattr(Search, "_under_observer", lambda self, current, best: asked.append({*self.pool}) or best)
    monkeypatch.setattr(Growth, "exchange", lambda self, base: asked.append("exchange") or [])
    search.run()
    assert sticking.key not in asked[0]
    assert sticking.key in asked[1], "once more, before anything gives way to it"
    assert asked[2] == "exchange"


def test_led_models_are_searched_where_the_best_explains_little_though_nothing_sticks(search):
    """Under feedback a free run went where no effect alone brought it back, and a ripple was not found."""
    lag = search.fitter.fit(search.fitter.hypothesis([effect_class("sensor_lag")(time_constant_s=1e-3)]), iterations=3)
    nominal = search.nominal()
    asked = []
    search.observed_by = lambda: asked.append(1)
    much = dataclasses.replace(lag, fit=dataclasses.replace(lag.fit, cost=0.2 * nominal.chi2))
    search._under_observer(nominal, much)
    assert not asked
    little = dataclasses.replace(lag, fit=dataclasses.replace(lag.fit, cost=0.5 * nominal.chi2))
    search._under_observer(nominal, little)
    search._under_observer(nominal, little)
    assert asked == [1], "once"


def test_led_models_are_not_begun_at_the_nominal_parameters_again(search, monkeypatch):
    """They have hardly any minima but one: what is short of its promise is so from there as well, and costs half a search."""
    asked = []
    monkeypatch.setattr(Multistart, "short_of_promise", lambda self, base, s: asked.append(self.state.options.free))
    search.growth.expand(search.nominal())
    among_led(search)
    assert True in asked
    assert False not in asked


def test_no_structure_is_made_up_where_led_models_lack_what_none_has(search):
    """Of effects that cannot explain it none is fitted to a free run."""
    search.state.consider(tuple(c for c in search.state.candidates if c.id == "hysteresis"))
    among_led(search)
    assert list(search.pool) == [()]


def test_a_structure_that_cannot_be_run_free_is_left_out(search, monkeypatch):
    """Led, a model may stand that swings up by itself."""
    led = search.fitter.fit(search.fitter.hypothesis((effect_class("static_friction")(**STICTION),)), iterations=0)
    lost = dataclasses.replace(led, fit=dataclasses.replace(led.fit, cost=np.inf, status=Status.FAILED))
    monkeypatch.setattr("diagnose.structure.observer_search._search", lambda _: [led])
    monkeypatch.setattr(search.fitter, "fit", lambda *_, **__: lost)
    monkeypatch.setattr("diagnose.structure.observer_search.released", lambda *_, **__: None)
    among_led(search)
    assert list(search.pool) == [()]


def test_what_a_run_takes_is_counted_in_products_of_a_step(robot):
    """One a step where all is affine between events, four by RK4; the same each time."""
    torque = np.full(1001, 0.2)

    def took(axis) -> int:
        before = work_done()
        simulate(axis, torque, DT, substeps=2)
        return work_done() - before

    assert took(robot) == 2000
    smooth = robot + effect_class("quadratic_friction")(coefficient_Nm_s2_rad2=1e-6)
    assert took(smooth) == 4 * 2000
    sticking = robot + effect_class("static_friction")(**STICTION)
    assert took(sticking) == took(sticking) >= 2000


def test_a_search_that_may_not_go_on_says_so_whatever_the_number_of_threads(robot, plant):
    estimation, held_out = recorded(plant, 1), recorded(plant, 2, 0.5)
    few = Options(jobs=1, effects=PAIR, effort=0.02)
    one, two = (diagnose(robot, [estimation], [held_out], dataclasses.replace(few, jobs=jobs)) for jobs in (1, 2))
    assert one.verdict is Verdict.UNEXPLAINED
    assert any("--effort" in note for note in one.notes)
    assert [(f.effect, f.place) for f in one.findings] == [(f.effect, f.place) for f in two.findings]
    assert one.fit["corrected"].rms == two.fit["corrected"].rms
    assert one.rivals == two.rivals
