"""Data that cannot carry a model: each lack is one clear line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from ident import (
    Decimation,
    IOData,
    LowPass,
    Options,
    SearchOptions,
    Structure,
    bj,
    bode,
    check_residuals,
    compare,
    decimate,
    oe,
    predicted,
    spectral,
)
from ident.checks import check_clipping, check_diverging, check_recording, excited_directions, held_stretch
from mjsim.errors import InputError

rng = np.random.default_rng(0)
U = rng.standard_normal(500)
T = np.arange(500) * 0.01


def one_line(call, *said):
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for word in said:
        assert word in message
    return message


def test_missing_samples():
    y = U.copy()
    y[7] = np.nan
    one_line(lambda: IOData(U, y, 0.01), "output y", "sample 7", "fill the gap")


def test_shapes_and_intervals():
    one_line(lambda: IOData(U, U[:-1], 0.01), "500 input and 499 output")
    one_line(lambda: IOData(U.reshape(2, -1), U, 0.01), "shape")
    one_line(lambda: IOData(["a"], [1.0], 0.01), "not numeric")
    one_line(lambda: IOData(U, U, 0.0), "positive")


def test_too_short_for_the_order():
    one_line(lambda: bj(IOData(U[:40], U[:40], 0.01), (5, 5, 5, 5, 1)), "40 samples", "bj[5 5 5 5 1]", "lower the orders")


def test_constant_channels():
    one_line(lambda: oe(IOData(np.ones(500), U, 0.01), (2, 2, 1)), "input u is constant")
    one_line(lambda: oe(IOData(U, np.zeros(500), 0.01), (2, 2, 1)), "output y is constant")


def test_rank_poor_input_names_the_missing_frequencies():
    u = np.sin(2 * np.pi * 5 * T)
    message = one_line(lambda: bj(IOData(u, u + 0.01 * U, 0.01), (5, 5, 5, 5, 1)), "excites only", "no power at", "Hz")
    assert "-50 Hz" in message


def test_clipped_output():
    y = np.clip(5 * np.sin(2 * np.pi * 0.7 * T) + 0.1 * U, -3.0, 3.0)
    one_line(lambda: oe(IOData(U, y, 0.01), (2, 2, 1)), "clipped", "limit 3")


def test_quantised_or_switching_output_is_not_clipped():
    y = np.round(20 * np.sin(2 * np.pi * 0.7 * T)) / 20
    oe(IOData(U, y, 0.01), (1, 1, 1))
    oe(IOData(U, np.sign(U), 0.01), (1, 1, 1))


def test_diverging_output():
    one_line(lambda: oe(IOData(U, 1.1 ** np.arange(500) * (1 + 0.1 * U), 0.01), (2, 2, 1)), "unstable")


def test_options_are_validated():
    one_line(lambda: Structure.bj(0, 1, 1, 1), "order nb")
    one_line(lambda: Structure.bj(-1, 1, 1, 1), "order nb")
    one_line(lambda: Structure.from_listed("bj", (1, 2)), "nb nc nd nf nk")
    one_line(lambda: SearchOptions(max_iterations=0), "max_iterations")
    one_line(lambda: Options(focus="simulation"), "focus")
    one_line(lambda: LowPass(8, 1.5), "cut-off")
    one_line(lambda: Decimation(0), "decimation")


def test_uses_out_of_range():
    model = oe(IOData(U, np.r_[0, U[:-1]], 0.01), (1, 0, 1)).model
    one_line(lambda: bode(model, [60.0]), "Nyquist")
    one_line(lambda: predicted(model, IOData(U, U, 0.01), 0), "horizon")
    one_line(lambda: compare(IOData(U, U, 0.02), {"m": model}), "sampling interval")
    one_line(lambda: spectral(IOData(U, U, 0.01), 400), "window")
    assert check_residuals(U, np.ones(500)).lags == 25


def chirp_record(n=4000, dt=0.005, seed=0):
    t = dt * np.arange(n)
    u = signal.chirp(t, 0.5, t[-1], 30)
    return u, signal.lfilter([0.1], [1, -0.9], u) + 0.01 * np.random.default_rng(seed).standard_normal(n)


BJ5 = Structure.bj(5, 5, 5, 5, 1)


def test_a_recording_is_judged_before_a_filter_hides_what_it_lacks():
    u, y = chirp_record()
    one_line(lambda: check_recording(IOData(np.ones_like(u), y, 0.005), BJ5), "input u is constant (1)")
    one_line(lambda: check_recording(IOData(u, np.full_like(y, 3.0), 0.005), BJ5), "output y is constant (3)")
    one_line(lambda: check_recording(IOData(u, y, 0.005), BJ5, 100), "40 samples (every 100th of the recording)")
    t = 0.005 * np.arange(u.size)
    three = sum(np.sin(2 * np.pi * f * t) for f in (3, 7, 11))
    one_line(lambda: check_recording(IOData(three, y, 0.005), BJ5), "only 6 of the 10", "no power at", "-100 Hz")
    check_recording(IOData(u, y, 0.005), BJ5)


@pytest.mark.parametrize("digits", [6, 10, 17])
@pytest.mark.parametrize("count", [1, 3, 4])
def test_sines_excite_two_directions_each_however_they_are_printed(count, digits):
    t = 0.005 * np.arange(4000)
    u = sum(np.sin(2 * np.pi * f * t) for f in (3.3, 7.1, 11.7, 20.2)[:count])
    printed = np.array([float(f"%.{digits}g" % x) for x in u])
    assert excited_directions(printed, 10) == 2 * count


def test_a_slow_sine_excites_two_directions_and_three_with_an_offset():
    u = np.sin(0.1 * np.arange(400))
    assert excited_directions(u, 10) == 2
    assert excited_directions(u + 1, 10) == 3


@pytest.mark.parametrize("every", [1, 2, 5, 10])
def test_a_chirp_and_noise_excite_every_direction(every):
    t = 5e-4 * np.arange(40_000)
    assert excited_directions(signal.chirp(t, 0.5, 20, 30)[::every], 13) == 13
    assert excited_directions(rng.standard_normal(80), 10) == 10
    assert excited_directions(np.sin(t) + 1e-3 * rng.standard_normal(t.size), 10) == 10


def test_decimated_data_say_what_their_samples_are():
    u, y = chirp_record(400)
    one_line(lambda: bj(decimate(IOData(u, y, 0.005)), (5, 5, 5, 5, 1)), "40 samples (every 10th of the recording)")


def test_clipped_input_is_refused_and_may_be_accepted():
    u, y = chirp_record()
    data = IOData(np.clip(u, -0.6, 0.6), y, 0.005)
    one_line(lambda: check_recording(data, BJ5), "input u", "limit 0.6", "clipped", "--clipping accept")
    check_recording(data, BJ5, clipping=False)
    clipped = IOData(u, np.clip(y, -0.5, 0.5), 0.005)
    one_line(lambda: oe(clipped, (2, 2, 1)), "output y", "clipped")
    assert oe(clipped, (2, 2, 1), Options(accept_clipping=True)).loss > 0


@pytest.mark.parametrize("levels", [2, 40])
def test_a_switching_or_staircase_input_is_not_clipped(levels):
    steps = np.round(rng.uniform(-2, 2, 400), 1) if levels > 2 else np.sign(rng.standard_normal(400))
    u = np.repeat(steps, 10)
    check_clipping(IOData(u, chirp_record()[1], 0.005))


@settings(deadline=None, max_examples=30)
@given(st.floats(0.3, 3.0), st.floats(1e-3, 1e3), st.integers(0, 1000))
def test_growth_is_told_from_a_resonance_reached_at_last(rate, scale, seed):
    u, y = chirp_record(seed=seed)
    t = 0.005 * np.arange(u.size)
    diverging = IOData(u, scale * (y + 1e-3 * np.exp(rate * t)), 0.005)
    if 1e-3 * np.exp(rate * t[-1]) > 1e3:
        one_line(lambda: check_diverging(diverging), "unstable", "cut the record before sample")
    check_diverging(IOData(u, scale * y, 0.005))
    pole = np.exp((-2 + 2j * np.pi * 30) * 0.005)  # a sharp resonance at the chirp's end
    ring = signal.lfilter([1.0], np.real(np.poly([pole, pole.conj()])), u)
    check_diverging(IOData(u, scale * ring, 0.005))
    check_diverging(IOData(u, scale * np.cumsum(np.cumsum(u + 1.0)), 0.005))  # a ramp's square is no instability


def test_a_held_stretch_is_found_where_values_else_never_repeat():
    _, y = chirp_record()
    assert held_stretch(y) is None
    lost = y.copy()
    lost[700:760] = lost[700]
    assert held_stretch(lost) == (700, 60)
    lost[700:760] = 0.0
    assert held_stretch(lost) is None  # rest
    assert held_stretch(np.round(y, 1)) is None  # quantised
