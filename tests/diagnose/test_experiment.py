"""Which samples count, how noisy they are, whether they start in motion; what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diagnose.experiment import hold_out_blocks, measured_velocity, prepare, white_noise_level
from mjsim.errors import InputError
from mjsim.recording import Recording


def still(n, torque=None):
    t = 5e-4 * np.arange(n)
    return Recording(t, np.sin(t) if torque is None else torque, np.zeros(n), np.zeros(n), 5e-4, source="log.csv")


@pytest.mark.parametrize("sigma", [0.01, 0.05, 0.25])
def test_the_noise_level_is_read_off_the_recording(record, sigma):
    levels = [white_noise_level(record(noise=sigma, seed=s, seconds=5.0).velocity) for s in range(3)]
    # the median of 10 000 differences that overlap: a standard error of about 3 %
    assert levels == pytest.approx([sigma] * 3, rel=0.08)


def test_a_few_jumps_do_not_raise_the_noise_level():
    y = 0.1 * np.random.default_rng(0).standard_normal(10_000)
    y[3000:] += 5.0
    y[7000] = 40.0
    assert white_noise_level(y) == pytest.approx(0.1, rel=0.06)
    assert white_noise_level(np.ones(4)) == 0.0


@settings(max_examples=50, deadline=None)
@given(st.integers(40, 5000), st.integers(3, 20))
def test_held_out_blocks_share_no_sample_and_lose_none(n, blocks):
    mine, other = hold_out_blocks(still(n), blocks)
    assert np.all(mine ^ other)
    assert mine[0]
    assert np.mean(other) == pytest.approx((blocks // 3) / blocks, abs=blocks / n)


def test_velocity_from_the_angle_where_there_is_none(record):
    r = record(noise=0.0)
    without = dataclasses.replace(r, velocity=None)
    assert np.std(measured_velocity(without)[1:-1] - r.velocity[1:-1]) < 0.2  # 1e-4 rad over two samples of noise: 0.14 rad/s


def test_a_recording_cut_out_of_a_motion_starts_in_motion(record):
    r = record()
    assert not prepare(r).moving
    fastest = int(np.argmax(np.abs(r.velocity)))
    cut = prepare(r.slice(fastest, len(r)))
    assert cut.moving
    assert cut.before == r.torque[fastest]
    assert np.all(cut.counts)


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        (still(150), "150 samples"),
        (still(1000, np.ones(1000)), "the torque is constant"),
        (still(1000), "does not rise above its noise"),
    ],
)
def test_what_cannot_be_diagnosed_is_one_line(recording, said):
    with pytest.raises(InputError, match=said) as caught:
        prepare(recording)
    assert str(caught.value).startswith("log.csv")
    assert "\n" not in str(caught.value)


def test_noise_alone_is_no_motion():
    n = 4000
    noise = np.random.default_rng(0).standard_normal(n)
    with pytest.raises(InputError, match="does not rise above its noise"):
        prepare(dataclasses.replace(still(n), velocity=noise))


def test_a_clipped_velocity_is_refused(record):
    r = record(noise=0.0)
    top = 0.5 * np.max(np.abs(r.velocity))
    with pytest.raises(InputError, match="stands at its limit"):
        prepare(dataclasses.replace(r, velocity=np.clip(r.velocity, -top, top)))
