"""What a search owes to the recordings it was given: other minima, other filters, stretches of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robot_axis import effect

from diagnose.data.experiment import held_rows, prepare
from diagnose.evidence.predictable import motion_error, remaining_structure
from diagnose.fit.fitter import Fitter
from diagnose.fit.validation import pooled
from diagnose.fit.whiten import whitened_fit
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.progress import Progress
from diagnose.result import Verdict
from diagnose.structure import passes
from diagnose.structure.budget import SearchOptions
from diagnose.structure.moves import Moves
from diagnose.structure.search import Search
from lab.benchmark.experiment import speed_multisine, trapezoid
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import record as record_plant
from lab.benchmark.seal import write_motion
from mjsim.recording import load


@pytest.fixture
def search_of(robot):
    def make(first, other):
        return Search(Fitter(robot, MotionView(), (prepare(first),), (prepare(other),), 1), SearchOptions())

    return make


@pytest.mark.slow
def test_friction_that_varies_over_the_turn_comes_out_of_a_wrong_order_and_phase(search_of, pair):
    truth = {"torque_Nm": 0.15, "relative_amplitude": 0.4, "cycles_per_rev": 3.0, "phase_rad": -2.5}
    search = search_of(*pair(effect("position_dependent_friction", place="motor", **truth), amplitude=1.5))
    search.use(search.fitter.with_orders((2.2, 3.3)))
    fitter = search.fitter
    wrong = {"torque_Nm": 0.15, "relative_amplitude": 0.1, "cycles_per_rev": 3.3, "phase_rad": 0.5}
    stuck = fitter.fit(fitter.hypothesis((effect("position_dependent_friction", place="motor", **wrong),)))
    assert stuck.chi2 > 2 * stuck.n, "else there is nothing to show"
    search.keep(stuck)
    for move in filter(None, search.moves.replace(stuck)):
        search.halving.run(move.base, move.neighbours, move.floor)
    found = search.fits[stuck.key]
    assert found.chi2 < 1.05 * found.n
    assert found.effects[0].values["cycles_per_rev"] == pytest.approx(3.0, rel=1e-3)


def test_where_the_held_out_recording_cannot_tell_stretches_of_the_other_one_do(search_of, record):
    """A limit of the torque at a fifth of the noise's variance; the held-out errors are made alike."""
    limit = effect("actuator_saturation", place="actuator", limit_Nm=0.85)
    search = search_of(record(limit, noise=1.0), record(limit, noise=1.0, seed=1))
    before = search.nominal()
    search.warm_start(search.fitter.fit(search.fitter.hypothesis((limit,))))
    after = search.fits[("actuator_saturation@actuator",)]
    assert search.significance.significant(before, after)
    assert not search.significance.hardly_exercised(after, "actuator_saturation@actuator")
    heard = search.held_out(before), search.held_out(after)
    search.fits._held_out = {before.key: heard[1], after.key: heard[1]}
    assert search.significance.significant(before, after)
    assert search.significance.hardly_exercised(after, "actuator_saturation@actuator")
    search.fits._held_out = {before.key: heard[1], after.key: heard[0]}
    assert not search.significance.significant(before, after), "held-out data that speak against an effect are heard"


def test_stretches_do_not_bear_out_what_one_part_of_a_recording_holds(search_of, record):
    """A disturbance at one moment lets some effect fit better; on the stretches that were held out it does nothing."""
    first, other = record(noise=0.3), record(noise=0.3, seed=1)
    shaken = first.velocity.copy()
    shaken[200:800] += 1.5 * np.sin(np.arange(600) / 15)
    search = search_of(dataclasses.replace(first, velocity=shaken), other)
    before = search.nominal()
    search.warm_start(search.fitter.fit(search.fitter.hypothesis((effect("coulomb_friction", torque_Nm=0.01),))))
    (after,) = (f for f in search.fits.values() if f.key)
    after = dataclasses.replace(after, fit=dataclasses.replace(after.fit, cost=0.9 * before.fit.cost))  # as if it gained much
    same = search.held_out(after)
    search.fits._held_out = {before.key: same, after.key: same}
    assert not search.significance.significant(before, after)


def test_digits_of_a_quantised_velocity_that_repeat_were_not_held(record):
    r = record(amplitude=0.3, noise=0.1)
    step = 0.04, 4e-4
    coarse = dataclasses.replace(
        r, velocity=np.round(r.velocity / step[0]) * step[0], angle=np.round(r.angle / step[1]) * step[1]
    )
    both = (np.diff(coarse.velocity) == 0) & (np.diff(coarse.angle) == 0)
    assert both.sum() > 20, "else there is nothing to show"
    assert not held_rows(coarse).any()


@pytest.fixture(scope="module")
def looped(tmp_path_factory):
    """``looped(laws, measurement, rng, *loops)``: recordings under speed control by rms [rad/s], band [Hz], kp and ki."""

    def make(laws, measurement, rng, *loops):
        folder = tmp_path_factory.mktemp("looped")
        for k, (rms, f1, kp, ki) in enumerate(loops):
            write_motion(folder / f"{k}.csv", record_plant(laws, speed_multisine(10.0, rms, f1, kp, ki, rng), measurement, rng))
        return [load(folder / f"{k}.csv") for k in range(len(loops))]

    return make


@pytest.fixture(scope="module")
def fed_back(looped):
    """Speed loops that see noise with a resonance, of an axis whose linear parameters are off by some percent."""
    nominal = Laws()
    laws = nominal._replace(
        Jm=0.98 * nominal.Jm, Jg=0.94 * nominal.Jg, Ja=1.1 * nominal.Ja, fm=0.9 * nominal.fm, kg=1.1 * nominal.kg
    )
    measurement = Measurement(velocity_noise=0.074, poles=(0.726 + 0.582j, 0.726 - 0.582j))
    loops = (3.95, 8.0, 0.143, 0.175), (3.63, 15.0, 0.173, 0.52)
    return looped(laws, measurement, np.random.default_rng(6), *loops)


@pytest.mark.slow
def test_coloured_noise_in_a_loop_is_no_missing_physics(robot, fed_back):
    """A fit on plain errors takes the noise for response, and the torque, which holds it, predicts the residual."""
    first, other = fed_back
    fitter = Fitter(robot, MotionView(), (prepare(first),), (prepare(other),), 1)
    plain = fitter.fit(fitter.hypothesis(()))
    assert motion_error(fitter, plain) > Options().missed, "else there is nothing to show"
    found = whitened_fit(fitter, plain)
    assert found is not None
    filter_, settled = found
    assert motion_error(fitter, settled) < Options().missed
    coloured = remaining_structure(fitter, settled)
    assert coloured.p_value < 1e-6, "else there is nothing to show"
    white = remaining_structure(fitter.relax(whitening=filter_), settled)
    assert white.share < Options().structure_share or white.p_value > Options().structure_p
    result = diagnose(robot, [first], [other], Options(jobs=1))
    assert result.verdict in (Verdict.PARAMETERS_ONLY, Verdict.NO_MISMATCH)
    assert not result.findings


def is_sought_on_whitened_errors_only(fitter, monkeypatch):
    """Search by a fitter, and find nothing."""
    searched_by = []
    monkeypatch.setattr(Moves, "add", lambda self, base: searched_by.append(len(self.state.fitter.whitening)))
    _, best, whitened = passes.searched(fitter, Options(jobs=1), Progress())
    assert whitened
    assert 1 not in searched_by, "nothing is sought on plain errors"
    assert not best.effects
    fitter.close()


@pytest.mark.slow
def test_what_all_recordings_settle_is_noise_although_one_leaves_much_open(robot, fed_back, monkeypatch):
    """A null whose plain fit missed motion by eleven times the noise was searched on plain errors until the budget was spent."""
    first, other = fed_back
    fitter = Fitter(robot, MotionView(), (prepare(first),), (prepare(other),), 1)
    monkeypatch.setattr(passes, "pooled", lambda by, f: dataclasses.replace(pooled(by, f), n=-1))
    monkeypatch.setattr(passes, "motion_error", lambda _, f, **on: 0.0 if f.n == -1 else 11.0)
    is_sought_on_whitened_errors_only(fitter, monkeypatch)


@pytest.mark.slow
def test_what_a_filter_leaves_open_all_recordings_may_settle(robot, looped):
    """A null whose estimation recording tells little of a damping, by the noise's own filter as well, was `unexplained`."""
    measurement = Measurement(velocity_noise=0.0375, poles=(0.857 + 0.395j, 0.857 - 0.395j))
    loops = (5.5, 8.0, 0.159, 0.766), (5.0, 30.0, 0.1, 0.08)
    first, other = looped(Laws(), measurement, np.random.default_rng(4), *loops)
    fitter = Fitter(robot, MotionView(), (prepare(first),), (prepare(other),), 1)
    plain = fitter.fit(fitter.hypothesis(()))
    filter_, settled = whitened_fit(fitter, plain)
    assert motion_error(fitter, settled) > Options().missed, "else there is nothing to show"
    assert motion_error(fitter, pooled(fitter, plain)) > Options().missed, "else there is nothing to show"
    whitened = fitter.relax(whitening=filter_)
    assert motion_error(whitened, pooled(whitened, settled)) < Options().missed
    result = diagnose(robot, [first], [other], Options(jobs=1, effects=("coulomb_friction", "torque_offset", "sensor_lag")))
    assert result.verdict in (Verdict.PARAMETERS_ONLY, Verdict.NO_MISMATCH)


@pytest.mark.parametrize("spent", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_search_that_could_not_look_takes_nothing_back(search_of, pair, monkeypatch, spent):
    """The whitened search of two effects was left the simulations for one, and the answer was that one."""
    search = search_of(*pair(effect("coulomb_friction", torque_Nm=0.3)))
    fitter, offset = search.fitter, effect("torque_offset", torque_Nm=0.01)
    both = fitter.fit(fitter.hypothesis((effect("coulomb_friction", torque_Nm=0.3), offset)))
    one = fitter.fit(fitter.hypothesis((both.effects[0],)))
    answers = [both, one, one]

    def answer(by, *asked, **known):
        if len(answers) == 2 and spent:
            fitter.allow(fitter.runs - 1)
        search = Search(by, SearchOptions())
        search.nominal()
        return search, answers.pop(0)

    monkeypatch.setattr(passes, "_search", answer)
    monkeypatch.setattr(passes, "_whitening", lambda *asked: (np.array([1.0, -0.1 * len(answers)]), False))
    by, found, whitened = passes.searched(fitter, Options(jobs=1), Progress(lambda step: None))
    assert found is (both if spent else one)
    assert whitened is not spent
    assert len(by.fitter.whitening) == (1 if spent else 2)


def test_the_mean_of_coloured_noise_is_not_sought_as_an_offset(robot, tmp_path, monkeypatch):
    """A null in a loop with noise of a long memory had a residual with a mean, and was searched on plain errors."""
    rng, measurement = np.random.default_rng(4), Measurement(velocity_noise=0.068, poles=(0.985,))
    for k, (speed, kp, ki) in enumerate([(25.3, 0.0958, 0.2726), (27.0, 0.0479, 0.105)]):
        motion = record_plant(Laws(), trapezoid(10.0, speed, kp, ki, True, rng), measurement, rng)
        write_motion(tmp_path / f"{k}.csv", motion)
    first, other = (load(tmp_path / f"{k}.csv") for k in range(2))
    fitter = Fitter(robot, MotionView(), (prepare(first),), (prepare(other),), 1)
    plain = fitter.error_of(fitter.fit(fitter.hypothesis(())), 0)
    assert np.mean(plain) ** 2 > passes.MATERIAL / 2 * np.mean(plain**2), "else there is nothing to show"
    is_sought_on_whitened_errors_only(fitter, monkeypatch)


@pytest.mark.parametrize("own_filter", [True, False])
def test_what_is_found_with_the_last_simulation_must_earn_its_filter(search_of, pair, monkeypatch, own_filter):
    """A delay that took coloured noise for response was named, since no simulation was left for the search on whitened errors."""
    search = search_of(*pair(effect("coulomb_friction", torque_Nm=0.3)))
    fitter = search.fitter
    one = fitter.fit(fitter.hypothesis((effect("coulomb_friction", torque_Nm=0.3),)))
    none = fitter.fit(fitter.hypothesis(()))
    answers = [one, none]
    fitter.allow(0)
    assert fitter.spent
    monkeypatch.setattr(passes, "_search", lambda by, *asked, **known: (Search(by, SearchOptions()), answers.pop(0)))
    monkeypatch.setattr(passes, "_whitening", lambda *asked: (np.array([1.0, -0.5]), own_filter))
    _, found, whitened = passes.searched(fitter, Options(jobs=1), Progress(lambda step: None))
    assert found is (one if own_filter else none)
    assert whitened is not own_filter
