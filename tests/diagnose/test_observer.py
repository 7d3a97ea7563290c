"""A model led by the measured velocity: where bodies stick, a free run has a minimum for each order in which they do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import simgap
from diagnose.data.experiment import prepare
from diagnose.evidence.outcome import Pair, Veto
from diagnose.evidence.rivals.events import no_moment_of_an_event
from diagnose.fit import path
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView, highest_observer_gain
from diagnose.structure.budget import SearchOptions
from diagnose.structure.search import Search
from diagnose.thresholds import OBSERVER_GAINS
from diagnose.verdict.decide import estimates
from mjsim.effects import effect_class
from mjsim.excitation import chirp
from mjsim.ode import simulate
from mjsim.recording import Recording

DT, N = 1e-3, 10_000
NOISE = 0.05
STICTION = {"torque_Nm": 0.05, "peak": 4.5}


def events_only(search, before, after) -> bool:
    """Whether the test of the moments of events refuses the richer structure."""
    return isinstance(no_moment_of_an_event(search.context, Pair(before, after)), Veto)


@pytest.fixture(scope="module")
def sticking(robot):
    """A chirp at which the axis sticks at each reversal, and the axis that it is of."""
    plant = robot + effect_class("static_friction")(**STICTION)
    rng = np.random.default_rng(2)
    torque = chirp(N * DT, DT, 0.6, 0.5, 25.0)
    run = simulate(plant, torque, DT)
    speed = run.velocity + NOISE * rng.standard_normal(N)
    return plant, Recording(run.time, torque, speed, run.angle + 1e-4 * rng.standard_normal(N), DT)


@pytest.fixture(scope="module")
def fitter(robot, sticking):
    experiment = prepare(sticking[1])
    with_held_out = Fitter(robot, MotionView(), (experiment,), (experiment,), 1)
    yield with_held_out
    with_held_out.close()


def test_the_truth_led_leaves_little_but_noise(sticking, fitter):
    plant, _ = sticking
    experiment = fitter.experiments[0]
    view = MotionView(observer_gain=OBSERVER_GAINS[0])
    s = view.signals(plant, experiment, None)
    assert np.std(s.measured - s.predicted) < 1.5 * NOISE  # some of it from the noise that leads it


def test_what_draws_a_model_is_torque_in_proportion_to_its_error(robot, sticking, fitter):
    """The lead is the recorded velocity as input and viscous friction as loss: for a linear axis, feedback of its error."""
    wrong = robot.with_linear({"Jm": 2 * robot.chain.bodies[0].inertia})
    free, led = (MotionView(observer_gain=rate).signals(wrong, fitter.experiments[0], None) for rate in (0.0, 300.0))
    assert np.std(led.measured - led.predicted) < 0.5 * np.std(free.measured - free.predicted)


def test_an_axis_is_led_by_its_own_inertia_and_fits_no_better_for_being_small(robot, fitter):
    """By the nominal one, a tenth of an axis under a tenth of the torque was led ten times as closely."""
    small = robot.with_linear({p.name: 0.1 * p.value for p in robot.chain.linear_parameters()})
    limited = effect_class("actuator_saturation")(limit_Nm=0.06)
    as_large = robot + effect_class("actuator_saturation")(limit_Nm=0.6)
    errors = []
    for axis in (small + limited, as_large):
        s = MotionView(observer_gain=300.0).signals(axis, fitter.experiments[0], None)
        errors.append(np.std(s.measured - s.predicted))
    assert errors[0] > 0.9 * errors[1]


def test_a_led_model_measures_without_bias(robot):
    """Drawn to the velocity of the sample before, half a sample late on average, an inertia came out 7 % too small at 300 / s."""
    run = simulate(robot, chirp(N * DT, DT, 0.6, 0.5, 25.0), DT)
    made = prepare(Recording(run.time, chirp(N * DT, DT, 0.6, 0.5, 25.0), run.velocity, run.angle, DT))
    fitter = Fitter(robot, MotionView(), (made,), (made,), 1)
    try:
        base = fitter.fit(fitter.hypothesis(()))
        inertia = robot.chain.bodies[0].inertia
        assert path.observed(fitter, base, 300.0).linear["Jm"] == pytest.approx(inertia, rel=0.01)
    finally:
        fitter.close()


@pytest.mark.parametrize(
    ("name", "place", "values"),
    [
        ("actuator_lag", "actuator", {"time_constant_s": 3e-3}),
        ("time_delay", "actuator", {"delay_s": 2.3e-3}),
        ("actuator_saturation", "actuator", {"limit_Nm": 0.4}),
        ("time_delay", "sensor", {"delay_s": 2.4e-3}),
        ("sensor_lag", "sensor", {"time_constant_s": 1.5e-3}),
    ],
)
def test_a_model_is_led_past_its_actuator_and_from_ahead_of_its_sensor(robot, name, place, values):
    """What leads acts on the axis as it is, by the velocity that the axis had: the truth, led, leaves what it leaves without."""
    effect = effect_class(name)(place=place, **values)
    torque = chirp(N * DT, DT, 0.6, 0.5, 25.0)
    noise = NOISE * np.random.default_rng(3).standard_normal(N)

    def left(plant, of):
        run = simulate(plant, torque, DT)
        experiment = prepare(Recording(run.time, torque, run.velocity + noise, run.angle, DT))
        s = MotionView(observer_gain=300.0).signals(of, experiment, None)
        return np.std(s.measured - s.predicted)

    alone = left(robot, robot)
    assert left(robot + effect, robot + effect) < 1.05 * alone
    assert left(robot + effect, robot) > 2.0 * alone


def test_a_slow_sensor_leaves_no_room_for_a_high_rate(robot, fitter):
    """Ahead of its lag the noise that leads is larger than that of the recording: it would shake what sticks."""
    slow = robot + effect_class("sensor_lag")(time_constant_s=5e-3)
    assert highest_observer_gain(robot) == np.inf
    assert 100.0 < highest_observer_gain(slow) < 1000.0
    lagging = fitter.fit(fitter.hypothesis((effect_class("sensor_lag")(time_constant_s=5e-3),)), iterations=0)
    assert path.observed(fitter, lagging, 1000.0, 0) is None
    assert path.observed(fitter, lagging, 100.0, 0) is not None


def test_a_nonsmooth_structure_is_fitted_along_falling_observer_gains(robot, fitter):
    start = effect_class("static_friction")(torque_Nm=0.05, peak=3.9)
    far = {p.name: 1.06 * p.value for p in robot.chain.linear_parameters() if p.name != "dg"}
    plain = fitter.fit(fitter.hypothesis((start,), far), iterations=25)
    found = path.relaxed(fitter, plain)
    assert found.chi2 < 0.6 * plain.chi2
    assert abs(found.effects[0].peak - STICTION["peak"]) < 0.6 * abs(plain.effects[0].peak - STICTION["peak"])


def test_the_same_fit_each_time(fitter):
    start = fitter.fit(fitter.hypothesis((effect_class("static_friction")(torque_Nm=0.055, peak=4.0),)), iterations=5)
    first, second = (path.observed(fitter, start, OBSERVER_GAINS[0], 3, spread=4, keep=2) for _ in range(2))
    assert np.array_equal(first.fit.x, second.fit.x)


def test_an_interval_at_another_order_of_events_holds_the_truth(robot, fitter):
    """A minimum of many is narrow, and says nothing of how far the right one is."""
    start = effect_class("static_friction")(torque_Nm=0.054, peak=4.2)
    wrong = fitter.refined(fitter.fit(fitter.hypothesis((start,)), iterations=25))
    assert wrong.chi2 > 1.1 * wrong.n
    for name, estimate in estimates(wrong, fitter, owner=wrong.key[0]).items():
        assert estimate.ci95[0] <= STICTION[name] <= estimate.ci95[1]
    right = fitter.refined(fitter.fit(fitter.hypothesis((effect_class("static_friction")(**STICTION),))))
    sure = estimates(right, fitter, owner=right.key[0])["torque_Nm"]
    assert sure.ci95[1] - sure.ci95[0] < 0.02 * sure.value


def test_an_effect_that_only_moves_events_does_not_pay(robot, fitter):
    """Of two fits of stiction that stick at other moments, the better one is no evidence for what was added to it."""
    search = Search(fitter, SearchOptions())
    stiction = effect_class("static_friction")(torque_Nm=0.055, peak=4.1)
    ripple = effect_class("torque_ripple")(amplitude_Nm=1e-3, cycles_per_rev=5.4, phase_rad=0.0)
    before = fitter.fit(fitter.hypothesis((stiction,)), iterations=0)
    true = fitter.hypothesis((effect_class("static_friction")(**STICTION), ripple))
    after = fitter.fit(true, iterations=15)
    assert after.chi2 < 0.9 * before.chi2
    assert events_only(search, before, after)
    bare = dataclasses.replace(before, fit=dataclasses.replace(before.fit, cost=before.n * 1.0))
    assert events_only(search, bare, after), "nor where noise alone is left: there are minima below the one that was found"


@pytest.mark.slow
def test_a_pair_is_led_once_but_for_the_last_digits_of_its_fits(robot, fitter, monkeypatch):
    search = Search(fitter, SearchOptions())
    ripple = effect_class("torque_ripple")(amplitude_Nm=1e-3, cycles_per_rev=5.4, phase_rad=0.0)
    stiction = effect_class("static_friction")(**STICTION)
    before, after = (fitter.fit(fitter.hypothesis(effects), iterations=1) for effects in ((stiction,), (stiction, ripple)))
    led, calls = path.observed, []
    monkeypatch.setattr("diagnose.evidence.rivals.events.observed", lambda *args, **how: calls.append(args) or led(*args, **how))
    said = events_only(search, before, after)
    first = len(calls)
    finer = dataclasses.replace(before, fit=dataclasses.replace(before.fit, cost=before.chi2 * (1 - 1e-4)))
    assert events_only(search, finer, after) == said
    assert 0 < first == len(calls)
    other = dataclasses.replace(before, fit=dataclasses.replace(before.fit, cost=before.chi2 * 0.98))
    events_only(search, other, after)
    assert len(calls) > first


@pytest.mark.slow
def test_an_effect_that_is_there_beside_stiction_gains_in_a_led_model_too(robot, sticking):
    plant, _ = sticking
    ripple = effect_class("torque_ripple")(amplitude_Nm=0.02, cycles_per_rev=5.4, phase_rad=0.4)
    torque = chirp(N * DT, DT, 0.6, 0.5, 25.0)
    run = simulate(plant + ripple, torque, DT)
    speed = run.velocity + NOISE * np.random.default_rng(6).standard_normal(N)
    experiment = prepare(Recording(run.time, torque, speed, run.angle, DT))
    other = Fitter(robot, MotionView(), (experiment,), (experiment,), 1)
    try:
        search = Search(other, SearchOptions())
        stiction = effect_class("static_friction")(**STICTION)
        alone = other.fit(other.hypothesis((stiction,)), iterations=15)
        both = other.fit(other.hypothesis((stiction, ripple)), iterations=10)
        assert not events_only(search, alone, both)
    finally:
        other.close()


def test_a_structure_is_led_once_from_where_it_is(fitter):
    f = fitter.fit(fitter.hypothesis([effect_class("static_friction")(**STICTION)]), iterations=2)
    led, before = path.observed(fitter, f, 300.0, 3), fitter.work
    assert path.observed(fitter, f, 300.0, 3) is led
    assert fitter.work == before
    assert path.observed(fitter, f, 100.0, 3) is not led
    assert fitter.work > before


def test_secants_bring_a_rough_cost_as_low_in_fewer_runs(fitter):
    h = fitter.hypothesis([effect_class("static_friction")(torque_Nm=0.06, peak=4.0)])
    spent = fitter.work
    plain = fitter.fit(h, iterations=15)
    spent, middle = fitter.work - spent, fitter.work
    quick = fitter.by_secants(h)
    assert quick.chi2 < 1.1 * plain.chi2
    assert fitter.work - middle < 0.7 * spent


@pytest.mark.slow
def test_an_effect_is_found_although_free_runs_have_many_minima():
    """A pendulum that goes over the top: the nominal structure ends in a wrong minimum, about which score tests tell nothing."""
    dt = 0.004
    t = np.arange(0, 3, dt)
    torque = 3 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    offset = simgap.effects["torque_offset"](place="motor", torque_Nm=0.5)
    run = simgap.simulate("pendulum", torque, dt=dt, effects=[offset])
    noise = 0.01 * np.random.default_rng(0).standard_normal(t.size)
    log = {"time_s": t, "torque_Nm": torque, "velocity_rad_s": run.velocity + noise}
    found = simgap.diagnose(log, "pendulum", effects=["torque_offset", "coulomb_friction", "torque_ripple"])
    assert [f.effect for f in found.findings] == ["torque_offset"]
    assert found.findings[0].parameters["torque_Nm"].value == pytest.approx(0.5, abs=0.01)
