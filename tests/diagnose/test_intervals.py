"""Effects whose sizes the data do not determine are not named; an error far above the noise is no all-clear."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.evidence.intervals import open_sizes, sizes_of
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.result import Verdict
from diagnose.structure.budget import SearchOptions
from diagnose.structure.search import Search
from diagnose.verdict.determined import determined
from diagnose.verdict.witnesses import _far_from_noise
from mjsim.effects import effect_class

COULOMB = effect_class("coulomb_friction")(torque_Nm=0.1)


@pytest.fixture(scope="module")
def fitted(robot, record):
    """A fitter of a recording with Coulomb friction, and the fits of Coulomb and of Stribeck friction to it."""
    pair = [prepare(record(COULOMB, seed=seed, changed=False)) for seed in (1, 2)]
    fitter = Fitter(robot, MotionView(), tuple(pair[:1]), tuple(pair[1:]), 1)
    simple = fitter.fit(fitter.hypothesis((COULOMB,)))
    stribeck = effect_class("stribeck_friction")(torque_Nm=0.1, extra_static_torque_Nm=0.001, stribeck_velocity_rad_s=1.0)
    yield fitter, fitter.refined(simple), fitter.refined(fitter.fit(fitter.hypothesis((stribeck,))))
    fitter.close()


def test_a_size_far_from_zero_is_determined(fitted):
    fitter, simple, _ = fitted
    assert open_sizes(simple, fitter.noise) == ()


@pytest.mark.parametrize(("times", "is_open"), [(0.9, True), (1.1, False)])
def test_the_interval_decides_at_two_standard_errors(fitted, times, is_open):
    """Of a fit moved to 0.9 and 1.1 times 1.96 standard errors from zero."""
    fitter, simple, _ = fitted
    at = next(i for i, e in enumerate(simple.hypothesis.entries) if e.owner == COULOMB.key)
    entry, error = simple.hypothesis.entries[at], simple.standard_errors(fitter.noise)[at]
    x = simple.fit.x.copy()
    x[at] = entry.scaled(times * 1.96 * error)
    moved = dataclasses.replace(simple, fit=dataclasses.replace(simple.fit, x=x))
    found = open_sizes(moved, fitter.noise)
    assert bool(found) is is_open
    assert all(o.ci95[0] <= 0.0 <= o.ci95[1] and o.name == "torque_Nm" for o in found)


def test_what_may_be_zero_in_the_same_effect_is_no_size():
    mode = effect_class("extra_flexible_mode")
    assert "damping_Nms_rad" in mode.amplitudes
    assert "damping_Nms_rad" not in sizes_of(mode(inertia_kgm2=1.0, stiffness_Nm_rad=1.0, damping_Nms_rad=0.0))


def test_an_undetermined_refinement_gives_way_to_its_simpler_form(fitted):
    fitter, _, stribeck = fitted
    assert [o.name for o in open_sizes(stribeck, fitter.noise)] == ["extra_static_torque_Nm"]
    search = Search(fitter, SearchOptions())
    search.nominal()
    search.keep(stribeck)
    best, said = determined(search, stribeck)
    assert best.key == (COULOMB.key,)
    (sentence,) = said
    assert "contains zero" in sentence
    assert "coulomb friction is fitted in its place" in sentence


@pytest.mark.parametrize(("times", "far"), [(1.9, False), (2.1, True)])
def test_an_error_of_twice_the_noise_is_no_noise(robot, record, times, far):
    """With one channel: above twice the noise rms (4 times its mean square) the residual counts as structure."""
    e = prepare(dataclasses.replace(record(seed=3, changed=False), angle=None))
    fitter = Fitter(robot, MotionView(), (e,), (), 1)
    try:
        base = fitter.fit(fitter.hypothesis(()))
        rms = float(np.sqrt(np.mean(fitter.error_of(base, 0)[fitter.counted(e)] ** 2)))
        level = dataclasses.replace(e, sigma=rms / times)
        scaled = Fitter(robot, MotionView(), (level,), (), 1)
        assert _far_from_noise(scaled, base, None, None) is far
        assert not _far_from_noise(scaled, base, None, 0.0), "a second channel has told"
        scaled.close()
    finally:
        fitter.close()


@pytest.mark.slow
def test_one_channel_with_a_large_error_is_no_all_clear(robot, record):
    """Friction outside the effects that are allowed, of which one channel shows four times the noise."""
    logs = [dataclasses.replace(record(COULOMB, seed=s), angle=None) for s in (4, 5)]
    result = diagnose(robot, logs[:1], logs[1:], Options(effects=("sensor_lag",), jobs=1))
    assert result.fit["corrected"].held_out_rms > 2 * result.noise_floor
    assert result.verdict is Verdict.UNEXPLAINED
