"""Filter, residual tests, prediction, spectra, JSON, control, figures."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import signal

import ident
from ident import (
    Decimation,
    Design,
    IOData,
    LowPass,
    Phase,
    PolyModel,
    Structure,
    bj,
    bode,
    check_residuals,
    compare,
    decimate,
    etfe,
    fit_percent,
    load,
    low_pass,
    oe,
    pole_zero,
    predicted,
    quality,
    residual_tests,
    save,
    select_order,
    shared_filter,
    simulated,
    spectral,
)
from ident.serial import from_json, model_from_dict, model_to_dict, to_dict
from mjsim.errors import InputError


def noise(n, seed=0):
    rng = np.random.default_rng(seed)
    return IOData(rng.standard_normal(n), rng.standard_normal(n), 0.0005)


def test_public_names_exist():
    assert sorted(ident.__all__) == sorted(set(ident.__all__))
    for name in ident.__all__:
        assert hasattr(ident, name)


def test_the_low_pass_is_order_8_at_two_fifths_of_nyquist():
    w, h = signal.sosfreqz(LowPass().sections(), worN=[0.4 * np.pi, 0.2 * np.pi, 0.8 * np.pi])
    db = 20 * np.log10(np.abs(h))
    assert_allclose(db[0], -3.01, atol=0.01)
    assert db[1] > -0.1
    assert db[2] < -100
    assert w.size == 3


def test_decimation_is_scipys_and_matlabs_decimate():
    data = noise(4000)
    ours = decimate(data)
    reference = signal.decimate(data.u, 10, n=8, ftype="iir", zero_phase=True)
    assert ours.dt == pytest.approx(0.005)
    assert len(ours) == 400
    assert_allclose(ours.u[20:-20], reference[20:-20], atol=1e-4)


@pytest.mark.parametrize("phase", list(Phase))
@pytest.mark.parametrize("design", list(Design))
def test_filters_leave_the_ratio_of_the_channels(phase, design):
    rng = np.random.default_rng(4)
    u = rng.standard_normal(6000)
    data = IOData(u, 3.0 * u, 0.0005)
    out = shared_filter(data, Decimation(10, design, phase), LowPass(phase=phase))
    assert_allclose(out.y, 3.0 * out.u, rtol=1e-9, atol=1e-12)


def test_zero_phase_does_not_shift_and_causal_does():
    t = np.arange(4000) * 0.0005
    x = np.sin(2 * np.pi * 5 * t)
    data = IOData(x, x, 0.0005)
    assert np.max(np.abs(low_pass(data, LowPass(8, 0.1, Phase.ZERO_PHASE)).u - x)[200:-200]) < 1e-6
    assert np.max(np.abs(low_pass(data, LowPass(8, 0.1)).u - x)[200:-200]) > 0.05


def test_residual_tests_hold_their_size_under_the_null():
    rng = np.random.default_rng(5)
    trials = 600
    white = independent = feedback = 0
    for _ in range(trials):
        u = signal.lfilter([1], [1, -0.8], rng.standard_normal(800))
        t = check_residuals(rng.standard_normal(800), u)
        white += not t.white
        independent += not t.independent
        feedback += t.feedback
    for rejected in (white, independent, feedback):
        assert rejected / trials < 0.025  # 1 % nominal; 99.9 % binomial limit is 2.4 %


SLOW = np.real(np.poly([0.98, 0.985 * np.exp(0.05j), 0.985 * np.exp(-0.05j)]))
"""A plant whose memory is long against the 25 lags of the tests."""


def _slow_record(seed, colour, n=3000):
    rng = np.random.default_rng(seed)
    u = np.repeat(np.sign(rng.standard_normal(n // 10)), 10)
    x = signal.lfilter([0, 0.001, 0.002, 0.001], SLOW, u)
    v = signal.lfilter([1], colour, rng.standard_normal(n))
    return IOData(u, x + 0.05 * np.std(x) * v / np.std(v), 0.001)


@pytest.mark.parametrize(
    ("colour", "structure"),
    [
        pytest.param([1], Structure.oe(3, 3, 1), id="white", marks=pytest.mark.slow),
        pytest.param([1, -0.97], Structure.bj(3, 0, 1, 3, 1), id="coloured", marks=pytest.mark.slow),
        pytest.param([1, -0.97], Structure.oe(3, 3, 1), id="coloured, no noise model", marks=pytest.mark.slow),
    ],
)
def test_independence_holds_its_size_on_the_data_of_the_fit(colour, structure):
    """Also on a slow plant, and with residuals that are coloured: good plants are not called poor."""
    tests = [residual_tests(ident.pem(_slow_record(s, colour), structure)) for s in range(150)]
    assert np.mean([t.independence_p < 0.05 for t in tests]) < 0.12  # 5 % nominal; 99.9 % binomial limit
    assert np.mean([t.feedback_p < 0.05 for t in tests]) < 0.12
    if structure.nd or colour == [1]:
        assert np.mean([t.whiteness_p < 0.05 for t in tests]) < 0.12


def test_independence_sees_what_a_slow_model_lacks():
    found = sum(not residual_tests(ident.pem(_slow_record(s, [1]), Structure.oe(2, 2, 1))).independent for s in range(20))
    assert found >= 18


def test_residual_tests_find_what_is_left():
    rng = np.random.default_rng(6)
    u, e = rng.standard_normal(2000), rng.standard_normal(2000)
    assert not check_residuals(signal.lfilter([1], [1, -0.3], e), u).white
    late = check_residuals(e + 0.2 * np.r_[0, 0, u[:-2]], u)
    assert not late.independent
    assert late.cross[late.lags + 2] > late.cross_bound
    assert not late.feedback
    assert check_residuals(e + 0.2 * np.r_[u[3:], 0, 0, 0], u).feedback


def test_residuals_of_a_complete_model_pass(bj_truth):
    passed = [
        (t.white, t.independent) for t in (residual_tests(bj(bj_truth.record(1500, s), (2, 2, 2, 2, 1))) for s in range(25))
    ]
    assert np.sum(passed) >= 48


def test_an_incomplete_model_fails(bj_truth):
    data = bj_truth.record(4000, 3, sigma=0.1)
    assert not residual_tests(oe(data, (1, 1, 1))).independent
    plant_only = residual_tests(oe(data, (2, 2, 1)))
    assert plant_only.independent
    assert not plant_only.white


def test_one_step_prediction_is_the_output_less_the_residual(truth):
    data = truth.record(700, 7)
    estimate = ident.pem(data, truth.model.structure)
    assert_allclose(predicted(estimate.model, data, 1)[60:], (data.y - estimate.residuals)[60:], atol=2e-2)


def test_prediction_tends_to_simulation_with_the_horizon(bj_truth):
    data = bj_truth.record(900, 8)
    fits = [fit_percent(data.y, predicted(bj_truth.model, data, k)) for k in (1, 2, 5, 200)]
    assert fits[0] > fits[-1]
    assert_allclose(predicted(bj_truth.model, data, 300)[400:], simulated(bj_truth.model, data)[400:], atol=1e-6)


def test_simulation_finds_the_initial_state(bj_truth):
    data = bj_truth.record(600, 9, sigma=0.0).part(300, 600)
    assert fit_percent(data.y, simulated(bj_truth.model, data)) > 99.99
    assert fit_percent(data.y, simulated(bj_truth.model, data, initial=False)) < 95
    result = compare(data, {"truth": bj_truth.model})
    assert result.fit_percent[0] > 99.99


def test_criteria_are_matlabs(bj_truth):
    data = bj_truth.record(1000, 10)
    estimate = bj(data, (2, 2, 2, 2, 1))
    q, n, d = quality(estimate), 1000, 8
    v = float(np.mean(estimate.residuals**2))
    assert q.loss == pytest.approx(v)
    assert q.fpe == pytest.approx(v * (1 + d / n) / (1 - d / n))
    assert q.naic == pytest.approx(np.log(v) + 2 * d / n)
    assert q.aic == pytest.approx(n * np.log(v) + 2 * d + n * (np.log(2 * np.pi) + 1))
    assert q.bic - q.aic == pytest.approx(d * np.log(n) - 2 * d)


def test_order_selection_finds_the_order(bj_truth):
    data = bj_truth.record(2000, 11)
    grid = [Structure.bj(n, 2, 2, n, 1) for n in (1, 2, 3, 4)]
    chosen = select_order(data, grid, validation=bj_truth.record(500, 12))
    assert chosen.best.structure.nf == 2
    assert chosen.best_validation.validation_percent > 60


def test_pole_zero_regions_cover(bj_truth):
    pz = pole_zero(bj(bj_truth.record(4000, 13), (2, 2, 2, 2, 1)).model)
    true = np.roots([1, -1.5, 0.7])
    for root in pz.poles:
        near = true[np.argmin(np.abs(true - root.z))]
        d = np.array([(near - root.z).real, (near - root.z).imag])
        assert d @ np.linalg.solve(root.covariance, d) < 18
    assert pz.zeros[0].z.real == pytest.approx(-0.5, abs=0.1)


def test_spectral_estimates_agree_with_the_truth(bj_truth):
    data = bj_truth.record(20000, 14, sigma=0.05)
    s = spectral(data)
    inside = (s.frequency_hz > 0.2) & (s.frequency_hz < 3)
    truth = np.abs(bj_truth.model.frequency_response(s.frequency_hz))
    assert_allclose(np.abs(s.response)[inside] / truth[inside], 1.0, atol=0.25)
    assert np.median(s.coherence[inside]) > 0.9
    assert (
        np.median(np.abs(np.abs(etfe(data).response) / np.abs(bj_truth.model.frequency_response(etfe(data).frequency_hz)) - 1))
        < 0.2
    )


def test_json_round_trip_keeps_every_bit(truth, tmp_path):
    estimate = ident.pem(truth.record(600, 15), truth.model.structure)
    save(estimate, tmp_path / "identification.json")
    back = load(tmp_path / "identification.json")
    for name in "ABCDF":
        assert np.array_equal(getattr(back, name), getattr(estimate.model, name))
    assert np.array_equal(back.covariance, estimate.model.covariance)
    assert back.structure == estimate.model.structure
    assert list(tmp_path.iterdir()) == [tmp_path / "identification.json"]


def test_json_holds_the_contract(bj_truth):
    values = to_dict(bj(bj_truth.record(600, 16), (2, 2, 2, 2, 1)))
    for key in (
        "structure",
        "orders",
        "dt",
        "B",
        "C",
        "D",
        "F",
        "noise_variance",
        "std",
        "fit_percent",
        "fpe",
        "aic",
        "bic",
        "residual_tests",
    ):
        assert key in values
    assert values["orders"] == [2, 2, 2, 2, 1]
    assert set(values["bode"]) >= {"frequency_hz", "magnitude_db", "phase_deg", "magnitude_db_ci95"}
    assert len(values["bode"]["magnitude_db_ci95"]) == 2
    assert values["F"][0] == 1.0
    assert len(values["B"]) == 2


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(-10, 10), min_size=1, max_size=4), st.lists(st.floats(-0.3, 0.3), max_size=3), st.integers(0, 4))
def test_any_model_survives_json_and_control(b, f, nk):
    b, f = [round(x, 4) or 1.0 for x in b], [round(x, 4) or 0.1 for x in f]
    model = PolyModel(Structure.oe(len(b), len(f), nk), 0.01, [1], b, [1], [1], [1, *f])
    assert model_from_dict(model_to_dict(model)).theta.tolist() == model.theta.tolist()
    grid = np.linspace(0.5, 49, 20)
    answer = model.frequency_response(grid)
    system = model.to_control()
    assert_allclose(system(np.exp(2j * np.pi * grid * 0.01)), answer, rtol=1e-8, atol=1e-10)
    assert_allclose(PolyModel.from_control(system).frequency_response(grid), answer, rtol=1e-6, atol=1e-9)


def test_a_delay_comes_back_from_state_space_and_dt_is_kept():
    model = PolyModel(Structure.bj(2, 1, 1, 2, 3), 0.005, [1], [1, 0.5], [1, 0.3], [1, -0.2], [1, -1.5, 0.7])
    for system in (model.to_control(), control.ss(model.to_control())):
        back = PolyModel.from_control(system)
        assert (back.structure, back.dt, system.dt) == (Structure.oe(2, 2, 3), 0.005, 0.005)
        assert_allclose(back.B, model.B, rtol=1e-9)
    u = np.sign(np.random.default_rng(0).standard_normal(50))
    again = control.forced_response(model.to_control(), 0.005 * np.arange(50), u)
    assert_allclose(again.outputs, model.simulate(u), atol=1e-12)
    z = np.exp(2j * np.pi * np.array([1.0, 40.0]) * 0.005)
    assert_allclose(model.noise_to_control()(z), model.noise_response([1.0, 40.0]))


def test_from_control_wants_a_causal_system():
    with pytest.raises(InputError, match="causal"):
        PolyModel.from_control(control.tf([1, 0, 0], [1, 0.5], 0.1))


def test_from_control_wants_a_discrete_single_channel_system():
    with pytest.raises(InputError, match="discrete"):
        PolyModel.from_control(control.tf([1], [1, 1]))


@pytest.mark.parametrize(
    ("text", "said"),
    [("{", "not JSON"), ("[]", "not an object"), ("{}", "missing"), ('{"structure": "bj", "orders": [1]}', "orders")],
)
def test_unusable_json_is_one_line(text, said):
    with pytest.raises(InputError, match=said) as caught:
        from_json(text, "file.json")
    assert "\n" not in str(caught.value)


def test_extrema_of_a_resonance():
    poles = np.exp((-1 + 1j * 2 * np.pi * 20) * 0.005)
    f = np.real(np.poly([poles, poles.conj()]))
    found = bode(PolyModel(Structure.oe(1, 2, 1), 0.005, [1], [1], [1], [1], f)).extrema()
    assert [e.kind for e in found] == ["peak"]
    assert found[0].frequency_hz == pytest.approx(20, rel=0.01)


@pytest.mark.slow
def test_figures_are_drawn(bj_truth):
    from ident.page import png
    from ident.plot import plot_bode, plot_comparison, plot_orders, plot_pole_zero, plot_residuals

    data = bj_truth.record(600, 20)
    estimate = bj(data, (2, 2, 2, 2, 1))
    figures = [
        plot_bode({"model": bode(estimate.model)}, spectral(data), (0.5, 4.0), "m/N"),
        plot_residuals(residual_tests(estimate)),
        plot_pole_zero(pole_zero(estimate.model)),
        plot_orders(select_order(data, [Structure.bj(n, 2, 2, n, 1) for n in (1, 2)])),
        plot_comparison(compare(data, {"model": estimate.model})),
    ]
    for figure in figures:
        assert png(figure).startswith(b"\x89PNG")
    axis = figures[0].axes[-1]
    assert axis.get_xlim()[1] == pytest.approx(0.5 / data.dt, rel=1e-6)
    figures[0].draw_without_rendering()
    assert {t.get_text() for t in axis.get_xticklabels()} >= {f"{10.0**k:g}" for k in (-1, 0)}
