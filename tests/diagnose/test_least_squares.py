"""Levenberg-Marquardt: known minima, bounds, and the reason why it stopped."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from diagnose.fit.least_squares import Status, jacobian, levenberg_marquardt

FREE = (np.full(2, -np.inf), np.full(2, np.inf))


def run(tasks):
    return [t() for t in tasks]


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0], 0.1])  # a part that no step removes, as noise is


def solve(residual, x0, bounds=FREE, **options):
    x0 = np.array(x0, float)
    return levenberg_marquardt(residual, x0, bounds, step=np.full(len(x0), 1e-6), run=run, **{"max_iterations": 100, **options})


def test_a_curved_valley():
    fit = solve(rosenbrock, [-1.2, 1.0], tolerance=1e-12)
    assert fit.status is Status.CONVERGED
    np.testing.assert_allclose(fit.x, [1, 1], rtol=1e-5)
    assert fit.cost == pytest.approx(fit.residual @ fit.residual)


def test_a_bound_that_is_active_is_met_and_the_rest_is_optimal_there():
    bounds = (np.array([-2.0, -2.0]), np.array([0.5, 2.0]))
    fit = solve(rosenbrock, [-1.2, 1.0], bounds, tolerance=1e-12)
    assert fit.status is Status.CONVERGED
    np.testing.assert_allclose(fit.x, [0.5, 0.25], rtol=1e-5)


def test_a_start_outside_its_bounds_is_taken_to_them():
    fit = solve(rosenbrock, [5.0, 5.0], (np.zeros(2), np.full(2, 2.0)), tolerance=1e-12)
    np.testing.assert_allclose(fit.x, [1, 1], rtol=1e-4)


def test_the_budget_is_named():
    assert solve(rosenbrock, [-1.2, 1.0], max_iterations=2).status is Status.BUDGET


def test_a_rough_cost_is_said_to_stall():
    """The secant sees a slope that no step confirms."""

    def rough(x):
        return np.array([1.0 + 0.2 * abs(x[0]) + (0.0 if x[0] == 0 else 1.0) - 1e-3 * (0 < x[0] < 2e-6) * 1e6 * x[0] * 1e3])

    fit = levenberg_marquardt(rough, np.zeros(1), (np.full(1, -1.0), np.ones(1)), step=np.full(1, 1e-6), run=run)
    assert fit.status is Status.STALLED
    assert fit.x[0] == 0
    assert "rough" in fit.status.value


def test_a_model_that_cannot_be_run_at_its_start_has_failed():
    fit = solve(lambda x: None, [0.0, 0.0])
    assert fit.status is Status.FAILED
    assert not np.isfinite(fit.cost)


def test_a_start_whose_neighbour_cannot_be_run_leaves_no_sensitivities():
    fit = solve(lambda x: rosenbrock(x) if x[0] == 0.0 else None, [0.0, 0.0])
    assert fit.status is Status.STALLED
    assert fit.cost == pytest.approx(1.01)
    np.testing.assert_array_equal(fit.J, np.zeros((3, 2)))


def test_a_wall_is_stepped_back_from():
    """The model cannot be run beyond 1.5: the step is shortened, not given up."""

    def walled(x):
        return None if x[0] > 1.5 else rosenbrock(x)

    np.testing.assert_allclose(solve(walled, [-1.2, 1.0], tolerance=1e-12).x, [1, 1], rtol=1e-5)


def test_a_known_jacobian_is_used_for_the_first_step():
    a = np.array([[2.0, 1.0], [1.0, 3.0], [0.0, 1.0]])
    b = np.array([1.0, 2.0, 3.0])
    calls = []

    def linear(x):
        calls.append(x)
        return a @ x - b

    fit = solve(linear, [0.0, 0.0], J0=a, tolerance=1e-9)
    assert not np.array_equal(calls[1], [1e-6, 0.0]), "no secant was run in the first iteration"
    np.testing.assert_allclose(fit.x, np.linalg.lstsq(a, b, rcond=None)[0], rtol=1e-4)


def test_a_known_residual_is_not_run_again():
    calls = []

    def residual(x):
        calls.append(x)
        return rosenbrock(x)

    start = np.array([-1.2, 1.0])
    fit = solve(residual, start, r0=rosenbrock(start), tolerance=1e-12)
    assert not any(np.array_equal(x, start) for x in calls)
    np.testing.assert_array_equal(fit.x, solve(rosenbrock, start, tolerance=1e-12).x)


def test_secants_against_central_differences():
    x = np.array([0.3, -0.7])

    def residual(y):
        return np.array([np.sin(y[0]) * y[1], y[0] ** 3, np.exp(y[1]), y[0] * y[1]])

    truth = np.array([[np.cos(x[0]) * x[1], np.sin(x[0])], [3 * x[0] ** 2, 0], [0, np.exp(x[1])], [x[1], x[0]]])
    J = jacobian(residual, x, residual(x), np.full(2, 1e-6), *FREE, run)
    np.testing.assert_allclose(J, truth, atol=1e-5)
    at_bound = jacobian(residual, x, residual(x), np.full(2, 1e-6), np.full(2, -1.0), x.copy(), run)
    np.testing.assert_allclose(at_bound, truth, atol=1e-5)
    assert jacobian(lambda y: None, x, residual(x), np.full(2, 1e-6), *FREE, run) is None


@settings(max_examples=60, deadline=None)
@given(
    arrays(float, (6, 3), elements=st.floats(-3, 3)), arrays(float, 6, elements=st.floats(-3, 3)),
    arrays(float, 3, elements=st.floats(-1, 1)),
)  # fmt: skip
def test_a_linear_problem_within_bounds(a, b, x0):
    """Never outside, never worse than the start."""

    def residual(x):
        return np.append(a @ x - b, 0.1)

    lower, upper = np.full(3, -1.0), np.full(3, 1.0)
    fit = levenberg_marquardt(residual, x0, (lower, upper), step=np.full(3, 1e-4), run=run, max_iterations=200, tolerance=1e-12)
    assert np.all(fit.x >= lower)
    assert np.all(fit.x <= upper)
    start = residual(x0)
    assert fit.cost <= start @ start + 1e-12


def test_a_bound_is_released_when_the_others_have_moved():
    """Holding x1 at its bound is right until x0 and x2 have moved; SciPy's bounded least squares knows the optimum."""
    from scipy.optimize import lsq_linear

    a = np.ones((6, 3))
    a[0, 0] = a[3, 1] = 0.0
    b = np.array([0.5, 0.0, 0.0, -2.0, 0.0, 0.0])
    fit = levenberg_marquardt(
        lambda x: a @ x - b, np.zeros(3), (-np.ones(3), np.ones(3)), step=np.full(3, 1e-4), run=run, max_iterations=200
    )
    best = lsq_linear(a, b, (-1, 1), tol=1e-12)
    assert fit.cost == pytest.approx(2 * best.cost, rel=1e-5)


def test_a_perfect_fit_ends():
    assert solve(lambda x: x - 1.0, [1.0, 1.0]).status is Status.CONVERGED


@given(arrays(float, (6, 2), elements=st.floats(-2, 2)), arrays(float, 2, elements=st.floats(-3, 3)))
@settings(max_examples=40, deadline=None)
def test_a_jacobian_brought_up_to_date_by_secants_stays_right_on_a_linear_problem(A, x0):
    A = A + np.vstack([3 * np.eye(2), np.zeros((4, 2))])
    calls = []

    def linear(x):
        calls.append(x)
        return A @ x - np.arange(6.0)

    fit = solve(linear, x0, tolerance=1e-10, secant=True)
    best = np.linalg.lstsq(A, np.arange(6.0), rcond=None)[0]
    assert fit.cost == pytest.approx(float(np.sum((A @ best - np.arange(6.0)) ** 2)), rel=1e-6, abs=1e-9)
    assert len(calls) < 3 + 2 * fit.iterations + 12  # two differences once, then one trial an iteration


def test_no_number_moves_farther_than_its_reach_in_one_iteration():
    """From beyond the next crest a full step would settle on another wave."""
    t = np.linspace(0, 10, 400)

    def wave(x):
        return np.sin(x[0] * t) - np.sin(2.0 * t)

    visited = []

    def watched(x):
        visited.append(float(x[0]))
        return wave(x)

    fit = levenberg_marquardt(
        watched, np.array([2.25]), (np.zeros(1), np.full(1, 9.0)), step=np.full(1, 1e-6), run=run, reach=np.full(1, 0.1)
    )
    assert fit.x[0] == pytest.approx(2.0, abs=1e-6)
    assert min(visited) > 1.8
    assert max(visited) < 2.4


def test_above_a_cost_a_coarser_tolerance_is_enough():
    """A slow valley: far from the noise the fit ends early, near it it goes on as if nothing had been said."""

    def slow(x):
        return np.array([1e2 * (x[1] - np.sin(x[0])), 3 - x[0], 10.0])

    full = solve(slow, [-6.0, 0.0], tolerance=1e-9)
    rough = solve(slow, [-6.0, 0.0], tolerance=1e-9, coarse=(full.cost - 1.0, 0.3))
    unmoved = solve(slow, [-6.0, 0.0], tolerance=1e-9, coarse=(1e9, 0.3))
    assert rough.status is Status.CONVERGED
    assert rough.iterations < full.iterations
    assert rough.cost > full.cost
    np.testing.assert_array_equal(unmoved.x, full.x)


def test_a_column_that_cannot_be_run_is_turned():
    def residual(x):
        return None if x[0] > 1.0 else np.array([2.0 * x[0] - x[1], x[1] ** 2, 3.0])

    x = np.array([1.0, 2.0])
    wide = np.full(2, np.inf)
    J = jacobian(residual, x, residual(x), np.full(2, 1e-6), -wide, wide, lambda tasks: [task() for task in tasks])
    np.testing.assert_allclose(J, [[2.0, -1.0], [0.0, 4.0], [0.0, 0.0]], atol=1e-5)
