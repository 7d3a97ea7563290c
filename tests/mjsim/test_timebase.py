"""Time stamps: rounded to a grid, jittered, with gaps; what a message advises is enough."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mjsim.errors import InputError
from mjsim.timebase import grid_step, rate_of, rounded_up, sample_time, unrounded

PATH = Path("log.csv")
DT = 1 / 417  # s


def whole_ms(time):
    return np.round(time, 3)


@pytest.mark.parametrize(("g", "origin"), [(1e-3, 0.0), (1e-2, 0.0), (1e-3, 1.7e9), (1.0, 0.0)])
def test_the_grid_of_stamps_is_told(g, origin):
    steps = np.random.default_rng(0).integers(1, 4, 200)
    assert grid_step(origin + g * np.cumsum(steps)) == pytest.approx(g)


def test_stamps_off_any_grid_have_none():
    assert grid_step(np.cumsum(np.random.default_rng(0).uniform(0.9, 1.1, 200))) == 0.0


@pytest.mark.parametrize("rounding", [whole_ms, lambda t: 1e-3 * np.floor(1e3 * t + 1e-9)])
def test_whole_milliseconds_are_uniform_samples(rounding):
    stamps = rounding(0.0007 + DT * np.arange(251))
    assert set(np.round(1e3 * np.diff(stamps)).astype(int)) == {2, 3}
    with pytest.raises(InputError):
        sample_time(PATH, stamps)
    time, note = unrounded(stamps)
    assert "rounded to 1 ms" in note
    assert sample_time(PATH, time) == pytest.approx(DT, rel=2e-4)
    assert np.max(np.abs(time - stamps)) < 1.1e-3, "the line may begin at either end of the rounding"


@pytest.mark.parametrize(("off", "uniform"), [(0.4, True), (1.5, False)])
def test_a_sample_further_off_than_the_rounding_was_taken_then(off, uniform):
    stamps = whole_ms(DT * np.arange(251))
    stamps[100] = whole_ms(DT * 100 + 1e-3 * off)
    assert bool(unrounded(stamps)[1]) is uniform


def test_stamps_of_a_fine_grid_are_left_as_they_are():
    stamps = np.round(DT * np.arange(100), 6)
    assert unrounded(stamps)[0] is stamps


def test_the_rate_of_rounded_stamps_is_the_mean_and_not_the_median():
    stamps = whole_ms(DT * np.arange(251) + np.where(np.arange(251) == 100, 1.5e-3, 0.0))
    assert not unrounded(stamps)[1]
    assert rate_of(stamps) == pytest.approx((stamps[-1] - stamps[0]) / 250)
    assert sample_time(PATH, stamps, uniform=False) == pytest.approx(rate_of(stamps), rel=1e-8)


def test_the_rate_of_a_log_with_gaps_is_that_between_them():
    time = DT * np.delete(np.arange(500), [50, 51, 52, 300])
    assert rate_of(time) == pytest.approx(DT)


@pytest.mark.parametrize("seed", range(5))
def test_the_jitter_that_a_refusal_advises_is_accepted(seed):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(100) + rng.uniform(-0.2, 0.2, 100) * DT
    with pytest.raises(InputError) as refused:
        sample_time(PATH, time)
    advised = float(re.search(r"jitter = ([\d.e-]+)", str(refused.value)).group(1))
    assert sample_time(PATH, time, advised) == pytest.approx(DT, rel=0.01)


@pytest.mark.parametrize(("x", "up"), [(0.0826, 0.083), (0.082, 0.083), (0.0999, 0.1), (1.21, 1.3), (0.5, 0.51)])
def test_rounded_up_is_never_below(x, up):
    assert rounded_up(x) in (pytest.approx(up), pytest.approx(x))
    assert rounded_up(x) >= x
