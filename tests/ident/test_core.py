"""The prediction-error core: gradients, recovery, agreement with independent computations, MATLAB's meaning of the orders."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import least_squares as scipy_least_squares
from scipy.signal import lfilter

from ident import (
    Focus,
    InitialCondition,
    IOData,
    Options,
    PolyModel,
    SearchOptions,
    Status,
    Structure,
    ararx,
    armax,
    arx,
    bj,
    bode,
    oe,
    pem,
)
from ident.kernel import is_stable
from ident.search import factor, from_reflection, residual, to_reflection

LIMIT = np.full(7, 1.0 - 1e-7)


def residuals_at(theta: np.ndarray, n: np.ndarray, nk: int, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    w, v, e = (np.zeros(u.size) for _ in range(3))
    assert np.isfinite(residual(theta, n, nk, u, y, w, v, e, LIMIT))
    return e


@pytest.mark.parametrize(
    "sizes", [(0, 3, 2, 2, 3, 3, 2), (2, 2, 2, 0, 0, 2, 2), (2, 2, 0, 1, 0, 2, 1), (0, 2, 0, 0, 2, 0, 0), (1, 2, 1, 1, 2, 3, 1)]
)
@pytest.mark.parametrize("nk", [0, 1, 3])
def test_gradient_is_that_of_finite_differences(sizes, nk):
    rng = np.random.default_rng(3)
    n = np.array(sizes)
    u, y = rng.standard_normal(90), rng.standard_normal(90)
    theta = np.concatenate([0.3 * rng.standard_normal(k) / (1 + np.arange(k)) for k in sizes])
    e = residuals_at(theta, n, nk, u, y)
    steps = 1e-6 * np.eye(theta.size)
    jacobian = np.stack(
        [(residuals_at(theta + h, n, nk, u, y) - residuals_at(theta - h, n, nk, u, y)) / 2e-6 for h in steps], axis=1
    )
    w, v, e2, pulse = np.zeros(90), np.zeros(90), np.zeros(90), np.zeros(90)
    pulse[0] = 1.0
    residual(theta, n, nk, u, y, w, v, e2, LIMIT)
    r = factor(theta, n, nk, u, y, w, v, e2, np.zeros((8, 90)), pulse)
    full = np.column_stack([jacobian, e])
    assert_allclose(r.T @ r, full.T @ full, rtol=1e-6, atol=1e-6 * np.abs(full.T @ full).max())


@settings(deadline=None, max_examples=60)
@given(st.lists(st.floats(-3, 3), min_size=1, max_size=6), st.floats(0.6, 1.0))
def test_unconstrained_coordinates_cover_the_stable_polynomials(x, radius):
    poly, jacobian = from_reflection(np.array(x), radius)
    assert np.all(np.abs(np.roots(poly)) < radius + 1e-3)
    assert_allclose(to_reflection(poly, radius), x, rtol=1e-4, atol=1e-5)
    h = 1e-6
    for j in range(len(x)):
        up, down = np.array(x), np.array(x)
        up[j] += h
        down[j] -= h
        numeric = (from_reflection(up, radius)[0] - from_reflection(down, radius)[0])[1:] / (2 * h)
        assert_allclose(jacobian[:, j], numeric, atol=1e-6 * max(1.0, np.abs(poly).max()))


@settings(deadline=None, max_examples=100)
@given(st.lists(st.floats(-2, 2), min_size=1, max_size=6))
def test_stability_test_agrees_with_the_roots(coefficients):
    poly = np.r_[1.0, coefficients]
    largest = np.max(np.abs(np.roots(poly)), initial=0.0)
    if abs(largest - 1) > 1e-4:
        assert is_stable(poly, 0.0) == (largest < 1)


def test_recovers_the_truth_within_four_standard_errors(truth):
    estimate = pem(truth.record(4000, 1), truth.model.structure)
    assert estimate.status is Status.CONVERGED
    std = np.sqrt(np.diag(estimate.model.covariance))
    assert np.all(np.abs(estimate.model.theta - truth.model.theta) < 4 * std)
    assert estimate.model.noise_variance == pytest.approx(0.09, rel=0.1)


def test_without_noise_the_truth_is_found_to_rounding(truth):
    data = truth.record(500, 2, sigma=0.0)
    estimate = oe(data, (truth.model.structure.nb, 2, truth.model.structure.nk))
    assert_allclose(estimate.model.F, np.polymul(truth.model.A, truth.model.F), atol=1e-7)
    assert_allclose(estimate.model.B, truth.model.B, atol=1e-7)


def test_two_algorithms_give_one_answer(bj_truth):
    """Levenberg-Marquardt here and SciPy's trust region on an independent predictor end in the same minimum."""
    data = bj_truth.record(1500, 5)
    estimate = bj(data, (2, 2, 2, 2, 1), Options(initial_condition=InitialCondition.ZERO))

    def predictor(theta):
        b, c, d, f = np.split(theta, [2, 4, 6])
        v = data.y - lfilter(np.r_[0, b], np.r_[1, f], data.u)
        return lfilter(np.r_[1, d], np.r_[1, c], v)

    other = scipy_least_squares(predictor, bj_truth.model.theta, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert_allclose(estimate.model.theta, other.x, atol=2e-5)
    assert estimate.loss == pytest.approx(2 * other.cost / 1500, rel=1e-8)
    assert_allclose(estimate.residuals, predictor(estimate.model.theta), atol=1e-10)


def test_arx_is_ordinary_least_squares_without_the_first_samples():
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal(300), np.cumsum(rng.standard_normal(300)) * 0.1
    estimate = arx(IOData(u, y, 1.0), (2, 3, 1), Options(initial_condition=InitialCondition.ESTIMATE))
    rows = np.column_stack([-y[2:-1], -y[1:-2], u[2:-1], u[1:-2], u[:-3]])
    expected, *_ = np.linalg.lstsq(rows, y[3:], rcond=None)
    assert_allclose(np.r_[estimate.model.A[1:], estimate.model.B], expected, atol=1e-9)


def test_orders_mean_what_they_mean_in_matlab():
    """nk = 1 is one sample of delay; nb counts the coefficients of B."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal(400)
    y = np.r_[0, 0, 2 * u[:-2]] + np.r_[0, 0, 0, -1 * u[:-3]] + 1e-3 * rng.standard_normal(400)
    model = oe(IOData(u, y, 1.0), (2, 0, 2)).model
    assert_allclose(model.B, [2, -1], atol=1e-3)
    assert model.to_control().dt == 1.0
    assert Structure.from_listed("bj", (5, 4, 3, 2, 1)) == Structure(nb=5, nc=4, nd=3, nf=2, nk=1)
    assert Structure.bj(5, 4, 3, 2, 1).listed == (5, 4, 3, 2, 1)


def test_the_named_commands_are_the_core(bj_truth):
    data = bj_truth.record(1000, 9)
    for command, orders, name in (
        (arx, (2, 2, 1), "arx"),
        (armax, (2, 2, 2, 1), "armax"),
        (ararx, (2, 2, 1, 1), "ararx"),
        (oe, (2, 2, 1), "oe"),
    ):
        estimate = command(data, orders)
        again = pem(data, Structure.from_listed(name, orders))
        assert estimate.model.structure.name == name
        assert_allclose(estimate.model.theta, again.model.theta)


@pytest.mark.parametrize("kind", [InitialCondition.ESTIMATE, InitialCondition.BACKCAST, InitialCondition.AUTO])
def test_initial_conditions_are_found_when_the_record_starts_in_motion(bj_truth, kind):
    late = bj_truth.record(1400, 11, sigma=0.02).part(1000, 1400)
    good = bj(late, (2, 2, 2, 2, 1), Options(initial_condition=kind))
    rest = bj(late, (2, 2, 2, 2, 1), Options(initial_condition=InitialCondition.ZERO))
    assert good.loss < 0.2 * rest.loss
    assert good.initial_condition is not InitialCondition.ZERO
    assert_allclose(good.model.F, bj_truth.model.F, atol=0.01)


def test_backcasting_ends_where_the_joint_search_does(bj_truth):
    late = bj_truth.record(1400, 11, sigma=0.1).part(1000, 1400)
    a, b = (
        bj(late, (2, 2, 2, 2, 1), Options(initial_condition=k)) for k in (InitialCondition.ESTIMATE, InitialCondition.BACKCAST)
    )
    assert b.loss == pytest.approx(a.loss, rel=1e-4)
    assert_allclose(b.model.F, a.model.F, atol=2e-3)


def test_auto_takes_zero_for_a_record_from_rest(bj_truth):
    assert bj(bj_truth.record(1500, 12), (2, 2, 2, 2, 1)).initial_condition is InitialCondition.ZERO


def test_simulation_focus_gives_the_output_error_plant(bj_truth):
    data = bj_truth.record(2000, 13)
    focused = bj(data, (2, 2, 2, 2, 1), Options(focus=Focus.SIMULATION))
    plain = oe(data, (2, 2, 1))
    assert_allclose(focused.model.F, plain.model.F, atol=1e-12)
    assert_allclose(focused.model.C, bj_truth.model.C, atol=0.2)
    assert np.all(np.diag(focused.model.covariance) > 0)


def test_a_common_prefilter_leaves_the_plant(bj_truth):
    data = bj_truth.record(4000, 14, sigma=0.05)
    plant = bj(data, (2, 2, 4, 2, 1), Options(prefilter=((1.0,), (1.0, -0.5)))).model
    assert_allclose(plant.F, bj_truth.model.F, atol=0.02)


@pytest.mark.slow
def test_a_box_jenkins_model_ends_no_higher_than_the_output_error_model_in_it():
    """Oversampled, with white noise: C and D are not needed, cancel, and stalled every start but the nested one."""
    rng = np.random.default_rng(0)
    f = np.real(
        np.poly([0.985, 0.996 * np.exp(0.0785j), 0.996 * np.exp(-0.0785j), 0.995 * np.exp(0.103j), 0.995 * np.exp(-0.103j)])
    )
    zeros = [0.9997 * np.exp(s * 0.0537j) for s in (1, -1)] + [0.998 * np.exp(s * 0.0919j) for s in (1, -1)]
    u = np.repeat(rng.choice([-2.0, 2.0], 1500), 10)
    x = lfilter(np.r_[0.0, np.real(np.poly(zeros))], f, u)
    data = IOData(u, x + 0.01 * np.std(x) * rng.standard_normal(u.size), 5e-4)
    full, plain = bj(data, (5, 5, 5, 5, 1)), oe(data, (5, 5, 1))
    assert full.loss <= plain.loss


def test_scaling_the_data_scales_the_model(bj_truth):
    data = bj_truth.record(800, 15)
    scaled = IOData(1e6 * data.u, 1e-5 * data.y, data.dt)
    a, b = bj(data, (2, 2, 2, 2, 1)).model, bj(scaled, (2, 2, 2, 2, 1)).model
    assert_allclose(b.F, a.F, rtol=1e-7)
    assert_allclose(b.B, 1e-11 * a.B, rtol=1e-7)
    assert_allclose(b.std["B"], 1e-11 * a.std["B"], rtol=1e-6)


def test_too_high_orders_are_told(bj_truth):
    data = bj_truth.record(600, 16, sigma=0.0)
    estimate = oe(data, (4, 4, 1))
    assert estimate.status is Status.RANK_DEFICIENT
    assert "lower the orders" in estimate.status.advice
    f = np.geomspace(0.05, 4.9, 40)
    assert_allclose(estimate.model.frequency_response(f), bj_truth.model.frequency_response(f), rtol=1e-4)


def test_the_search_says_when_it_was_cut_off(bj_truth):
    data = bj_truth.record(400, 17)
    estimate = bj(data, (2, 2, 2, 2, 1), Options(search=SearchOptions(max_iterations=1, tolerance=1e-14, starts=1)))
    assert estimate.status is Status.ITERATION_LIMIT
    assert "max_iterations" in estimate.status.advice


def test_models_stay_stable_on_data_without_power_in_a_band(bj_truth):
    """Low-passed data drive the zeros of C outwards; the search follows its limit and every start agrees on the plant."""
    from ident import LowPass, low_pass

    data = low_pass(bj_truth.record(2000, 18, sigma=0.01), LowPass(8, 0.4))
    estimate = bj(data, (2, 2, 2, 2, 1))
    assert np.max(np.abs(np.roots(estimate.model.C))) < 0.981
    f = np.geomspace(0.05, 1.5, 30)
    assert_allclose(np.abs(estimate.model.frequency_response(f) / bj_truth.model.frequency_response(f)), 1.0, atol=0.1)


def test_response_gradient_is_that_of_finite_differences(bj_truth):
    m, f = bj_truth.model, np.array([0.3, 1.0, 3.0])
    for model in (m, PolyModel(Structure.armax(2, 2, 1, 0), 0.1, [1, -1.5, 0.7], [1, 2], [1, 0.1], [1], [1])):
        gradient = model.response_gradient(f)
        for j, h in enumerate(1e-6 * np.eye(model.theta.size)):
            up, down = (PolyModel.from_theta(model.structure, model.theta + s * h, 0.1) for s in (1, -1))
            numeric = (up.frequency_response(f) - down.frequency_response(f)) / 2e-6
            assert_allclose(gradient[:, j], numeric, atol=1e-6 * np.abs(gradient).max())


@pytest.mark.slow
def test_bands_cover_as_often_as_they_say(bj_truth):
    f = np.geomspace(0.05, 4.5, 25)
    truth_db = 20 * np.log10(np.abs(bj_truth.model.frequency_response(f)))
    inside = []
    for seed in range(200):
        low, high = bode(bj(bj_truth.record(2000, 1000 + seed), (2, 2, 2, 2, 1)).model, f).magnitude_db_interval()
        inside.append((low <= truth_db) & (truth_db <= high))
    assert 0.93 <= np.mean(inside) <= 0.97
