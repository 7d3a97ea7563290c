"""Force along a recorded motion: exact for a body under each hold of its input, and for an input that acts early."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.fit.fitter import Fitter
from diagnose.fit.timing import taken_early
from diagnose.problem.view import ForceView, MotionView
from mjsim.axis import Axis, Body, Chain
from mjsim.effects.admissible import mode, ringing
from mjsim.hold import at_samples, between
from mjsim.recording import Recording

DT, INERTIA, VISCOUS = 0.01, 0.02, 0.05
AXIS = Axis(Chain((Body("motor", INERTIA, VISCOUS, "j"),), ()))


def levels(seed: int, count: int = 1500) -> np.ndarray:
    """A torque that steps every tenth of a second, behind a decay: content up to half the sampling rate."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-1.0, 1.0, count // 10), 10) * np.tile(0.9 ** np.arange(10), count // 10)


def moved(u: np.ndarray, hold: str, steps: int, early: bool = False) -> Recording:
    """Inertia and damping under a torque, in so many steps a sample; ``early``: semi-implicit ones, as a simulator takes."""
    start, slope = between(u, DT, hold)
    h = DT / steps
    q = v = 0.0
    out = []
    for a, b in zip(start, slope, strict=True):
        out.append(q)
        for i in range(steps):
            rate = (a + b * (i + 0.5) * h - VISCOUS * v) / INERTIA
            q += h * v + (h * h if early else 0.5 * h * h) * rate
            v += h * rate
    return Recording(DT * np.arange(len(u)), u, None, np.array(out), DT, source="a.csv", hold=hold)


def misfit(view: ForceView, recording: Recording) -> float:
    """Rms error of the true model over that of the torque."""
    experiment = prepare(recording)
    s, keep = view.signals(AXIS, experiment, None), view.counts(experiment)
    assert s is not None
    return float(np.std((s.measured - s.predicted)[keep]) / np.std(s.measured[keep]))


@pytest.mark.parametrize(("hold", "error"), [("held", 2e-3), ("linear", 2e-3), ("mean", 1e-2)])
def test_the_true_model_needs_the_torque_that_acted(hold, error):
    """Under the filter's band, with content up to half the sampling rate; a mean is off by the input's second difference."""
    recording = moved(levels(1), hold, 100)
    assert misfit(ForceView(decimate=1), recording) < error
    other = dataclasses.replace(recording, hold="linear" if hold == "held" else "held")
    assert misfit(ForceView(decimate=1), other) > 5 * error, "each by its own hold"


def test_a_mean_about_a_sample_is_that_of_the_input_under_a_triangle():
    u = levels(2, 100)
    for hold in ("held", "linear", "mean"):
        start, slope = between(u, DT, hold)
        at = (np.arange(50) + 0.5) / 50
        inside = start[:, None] + slope[:, None] * DT * at
        fine = np.sum(inside[1:-1] * (1.0 - at), axis=1) + np.sum(inside[:-2] * at, axis=1)
        np.testing.assert_allclose(at_samples(u, hold)[1:-1], fine / 50, atol=1e-3 if hold != "mean" else 0.05)
    with pytest.raises(ValueError, match="hold 'cubic'"):
        at_samples(u, "cubic")


@pytest.mark.parametrize("steps", [5, 10])
def test_a_simulator_that_steps_semi_implicitly_acts_half_its_timestep_early(steps):
    pair = tuple(prepare(moved(levels(seed), "held", steps, early=True)) for seed in (3, 4))
    fitter = Fitter(AXIS, ForceView(decimate=1), pair[:1], pair[1:], 1)
    found = taken_early(fitter)
    assert found.view.early == pytest.approx(0.5 * DT / steps, rel=0.1)
    before, after = (f.fit(f.hypothesis(())).chi2 for f in (fitter, found))
    assert after < 0.1 * before
    fitter.close()


def test_no_lead_is_taken_where_there_is_none():
    pair = tuple(prepare(moved(levels(seed), "held", 100)) for seed in (3, 4))
    for view in (ForceView(decimate=1), MotionView()):
        fitter = Fitter(AXIS, view, pair[:1], pair[1:], 1)
        assert getattr(taken_early(fitter).view, "early", 0.0) < 0.02 * DT
        fitter.close()


def test_a_mode_lies_in_the_band_that_is_compared_and_rings():
    assert ForceView().band(DT) == pytest.approx(10.0)
    assert ForceView(cutoff_hz=4.0).band(DT) == 4.0
    assert MotionView().band(DT) == pytest.approx(50.0)
    scales = next(iter(Fitter(AXIS, ForceView(), (e := (prepare(moved(levels(5), "held", 20)),)), e, 1).scales.values()))
    narrow = dataclasses.replace(scales, band=5.0)
    (inside,), (outside,) = (mode(1e-3, 1e-3 * (2 * np.pi * hz) ** 2, narrow) for hz in (4.9, 5.2))
    assert inside.holds
    assert not outside.holds
    for damping, rings in ((1.9, True), (2.1, False)):
        (ratio,) = ringing(1.0, 1.0, damping)
        assert ratio.holds is rings
