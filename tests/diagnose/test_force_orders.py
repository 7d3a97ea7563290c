"""Orders that stand out of a coloured torque residual, and how many of its samples count."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from diagnose.data.experiment import prepare
from diagnose.evidence.force_orders import force_orders, line_energy, stands_out
from diagnose.fit.fitter import Fitter
from diagnose.fit.whiten import effective_share_between, levinson
from diagnose.problem.view import ForceView
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.recording import Recording

DT = 1e-3
TURN = 2 * np.pi / 0.0025  # one turn of a screw of 2.5 mm lead [rad/m]


def carriage(seed: int, ripple: float = 0.0, seconds: float = 12.0) -> tuple[Axis, Recording]:
    """To and fro at up to 0.11 m/s, torque by inverse dynamics, with red noise of 2 N (time constant 0.2 s) and a ripple."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(round(seconds / DT))
    v = 0.07 * np.sin(2 * np.pi * 0.35 * t) + 0.04 * np.sin(2 * np.pi * 0.83 * t + rng.uniform(0, 6))
    q = np.cumsum(v) * DT
    axis = load_axis(shipped_model("emps"))
    body = axis.chain.bodies[0]
    red = lfilter([1.0], [1.0, -0.995], rng.standard_normal(len(t)))
    force = body.inertia * np.gradient(v, DT) + body.viscous * v + 2.0 * red / np.std(red)
    force += ripple * np.sin(TURN * q + 0.7) + 0.2 * rng.standard_normal(len(t))
    return axis, Recording(t, force, None, q, DT, source=f"carriage_{seed}", judge="force")


def fitter_on(axis: Axis, recording: Recording) -> Fitter:
    experiment = prepare(recording)
    return Fitter(axis, ForceView(decimate=10), (experiment,), (experiment,), 1)


def test_a_turn_of_the_screw_stands_out_of_slow_errors():
    """A quarter of the residual's rms, at a period that passes in 20 ms: between samples of the decimated view."""
    axis, recording = carriage(0, ripple=0.5)
    fitter = fitter_on(axis, recording)
    found, _ = force_orders(fitter, fitter.fit(fitter.hypothesis(())))
    assert found
    assert found[0] == pytest.approx(TURN, abs=np.pi / np.ptp(recording.angle))


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 9))])
def test_slow_errors_alone_have_no_order(seed):
    axis, recording = carriage(seed)
    fitter = fitter_on(axis, recording)
    assert force_orders(fitter, fitter.fit(fitter.hypothesis(())))[0] == ()


def test_line_energy_is_that_of_a_regression():
    """Of the filtered residual on the filtered regressors, without filtering a single regressor."""
    rng = np.random.default_rng(3)
    q = np.cumsum(1.0 + 0.4 * np.sin(2 * np.pi * np.arange(8000) / 2000)) * 1e-3
    d = lfilter([1.0], [1.0, -0.9], rng.standard_normal(8000)) + 0.4 * np.cos(900 * q)
    orders = np.array([300.0, 900.0, 1500.0])
    energy = line_energy(d, q, np.gradient(q, DT), np.ones(8000), np.ones(8000, bool), orders, DT)
    a, _ = levinson(np.array([d[: 8000 - k] @ d[k:] for k in range(51)]), 50)
    white = lfilter(a, [1.0], d)[50:]
    for n, e in zip(orders, energy, strict=True):
        x = lfilter(a, [1.0], np.column_stack([np.sin(n * q), np.cos(n * q)]), axis=0)[50:]
        explained = float(white @ x @ np.linalg.solve(x.T @ x, x.T @ white))
        assert e == pytest.approx(explained, rel=0.1, abs=2.0)


def test_what_stands_out_is_a_matter_of_its_neighbours():
    grid = np.linspace(10.0, 100.0, 91)
    level = np.random.default_rng(0).exponential(1.0, 91)
    level[50] = 60.0
    assert stands_out(level, grid, 50, 1.0) < 1e-6
    assert stands_out(level, grid, 49, 1.0) > 1e-3
    assert stands_out(100 * level, grid, 50, 1.0) == pytest.approx(stands_out(level, grid, 50, 1.0))
    assert stands_out(level, grid, 1, 50.0) == 1.0  # no neighbour far enough: nothing can be said


def test_a_sample_is_worth_more_to_a_fast_effect_than_to_a_slow_one():
    """Of red noise of correlation 0.135 at 10 ms: Bartlett's share for a square wave and for a ripple."""
    axis, recording = carriage(2, ripple=0.5)
    fitter = fitter_on(axis, recording)
    base = fitter.fit(fitter.hypothesis(()))
    slow = fitter.fit(fitter.hypothesis((effect_class("coulomb_friction")(torque_Nm=1.0),)))
    ripple = effect_class("torque_ripple")(amplitude_Nm=0.5, cycles_per_rev=TURN, phase_rad=0.7)
    fast = fitter.fit(fitter.hypothesis((ripple,)))
    assert effective_share_between(fitter, base, slow) < 0.2
    assert effective_share_between(fitter, base, fast) > 0.5
    assert effective_share_between(fitter, base, base) == 1.0  # no difference, nothing to be correlated with


def test_judged_by_motion_has_no_orders_of_force():
    axis, recording = carriage(4)
    fitter = fitter_on(axis, recording)
    other = SimpleNamespace(experiments=fitter.experiments, view=None)
    assert force_orders(other, fitter.fit(fitter.hypothesis(()))) == ((), ())  # type: ignore[arg-type]
