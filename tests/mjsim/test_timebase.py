"""Time stamps: rounded to a grid, jittered, with gaps; what a message advises is enough."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mjsim.errors import InputError
from mjsim.timebase import grid_step, rate_of, resample, rounded_up, sample_time, unrounded

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


def late_rows(n=400, of=13, logged=8):
    """Stamps of a logger that is held up: so many rows at the sample time, each off by up to a tenth, then a gap."""
    k = np.arange(n)
    return DT * (k + np.random.default_rng(0).uniform(-0.1, 0.1, n))[k % of < logged]


def test_gaps_are_let_through_where_a_jitter_is_declared():
    time = late_rows()
    with pytest.raises(
        InputError, match=r"jitter = 0\.\d+ resamples them, and what lies in the 30 gaps is not compared"
    ) as refused:
        sample_time(PATH, time, gaps=True)
    advised = float(re.search(r"jitter = ([\d.]+)", str(refused.value)).group(1))
    assert advised < 0.25, "that of the rows between the gaps"
    assert sample_time(PATH, time, advised, gaps=True) == pytest.approx(DT, rel=0.01)
    with pytest.raises(InputError):
        sample_time(PATH, time, advised)


def test_a_log_with_gaps_is_resampled_from_end_to_end():
    time = late_rows()
    held = np.repeat(np.arange(40.0), 13)[:400][np.round(time / DT).astype(int)]
    out, note = resample({"time": time, "torque": held, "angle": np.sin(7 * time)}, "held", DT)
    missing = out.pop("missing")
    assert {len(x) for x in out.values()} == {len(missing)}
    assert out["time"][-1] == pytest.approx(time[-1], abs=DT)
    assert 0.3 < missing.mean() < 5 / 13 + 0.01
    assert np.min(np.abs(out["time"][missing][:, None] - time)) > 0.4 * DT
    np.testing.assert_allclose(out["angle"][~missing], np.sin(7 * out["time"][~missing]), atol=1e-5)
    last = np.searchsorted(time, out["time"][missing], side="right") - 1
    whole = time[last + 1] >= out["time"][missing] + DT  # the sample ends before the next row
    np.testing.assert_allclose(out["torque"][missing][whole], held[last[whole]], atol=1e-9)
    assert whole.sum() > 3 * 30
    assert f"{missing.sum()} of its {len(missing)} samples lie in 30 gaps" in note


def test_a_constant_input_stays_constant_when_it_is_resampled():
    time = late_rows()
    out, _ = resample({"time": time, "torque": np.full(len(time), 0.6)}, "held", DT)
    assert set(out["torque"]) == {0.6}


@pytest.mark.parametrize(("x", "up"), [(0.0826, 0.083), (0.082, 0.083), (0.0999, 0.1), (1.21, 1.3), (0.5, 0.51)])
def test_rounded_up_is_never_below(x, up):
    assert rounded_up(x) in (pytest.approx(up), pytest.approx(x))
    assert rounded_up(x) >= x


def test_uniform_stamps_with_few_decimals_are_not_called_rounded():
    time = np.round(0.01 * np.arange(500), 2)
    same, note = unrounded(time)
    assert note == ""
    assert np.array_equal(same, time)
