"""A torque goes between samples as its recording says, by every engine."""

from __future__ import annotations

import numpy as np
import pytest

import simgap
from mjsim.hold import between, within
from mjsim.recording import Recording
from simgap.simulation import ENGINES

DT, PARTS, COUNT = 0.02, 20, 150


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("hold", ["held", "linear", "mean"])
def test_a_torque_goes_between_samples_as_its_recording_says(engine, hold):
    t = DT / PARTS * np.arange(COUNT * PARTS)
    smooth = 0.3 * np.sin(2 * np.pi * 4.0 * t) + 0.1
    logged = smooth[::PARTS]
    if hold == "mean":
        logged = np.concatenate([logged[:1], smooth.reshape(-1, PARTS).mean(axis=1)[:-1]])
    lines = np.interp(t + 0.5 * DT / PARTS, t[::PARTS], logged)
    acted = {"held": np.repeat(logged, PARTS), "linear": lines, "mean": smooth}[hold]
    truth = simgap.simulate("pendulum", acted, dt=DT / PARTS, engine=engine).angle[::PARTS]
    record = Recording(DT * np.arange(COUNT), logged, np.zeros(COUNT), np.zeros(COUNT), DT, source="a.csv", hold=hold)
    run = simgap.simulate("pendulum", record, engine=engine, start="rest")
    assert len(run.angle) == COUNT
    np.testing.assert_array_equal(run.torque, logged)
    error = np.std((run.angle - truth)[:-1]) / np.std(truth)
    assert error < 0.01
    if hold != "held":
        other = simgap.simulate("pendulum", logged, dt=DT, engine=engine)
        assert np.std((other.angle - truth)[:-1]) / np.std(truth) > 5 * error


def test_parts_of_a_sample_have_its_mean():
    u = np.random.default_rng(1).standard_normal(30)
    for hold in ("held", "linear", "mean"):
        start, slope = between(u, DT, hold)
        means = within(u, DT, hold, 7).reshape(-1, 7).mean(axis=1)
        np.testing.assert_allclose(means, start + 0.5 * DT * slope, atol=1e-12)
