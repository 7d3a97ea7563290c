"""Data that cannot carry a model: each lack is one clear line."""

from __future__ import annotations

import numpy as np
import pytest

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
    oe,
    predicted,
    spectral,
)
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
