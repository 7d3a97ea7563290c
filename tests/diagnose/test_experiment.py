"""Which samples count, how noisy they are, whether they start in motion; what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, filtfilt, lfilter

from diagnose.data import derived
from diagnose.data.derived import without_derived_velocity
from diagnose.data.experiment import (
    held_rows,
    hold_out_blocks,
    measured_velocity,
    prepare,
    smooth_velocity,
)
from diagnose.data.noise import white_noise_level
from diagnose.data.scales import reversals
from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
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


def test_a_coarse_velocity_that_is_held_is_not_taken_for_clipped():
    """A held speed is one step of a coarse sensor, its greatest one for 6 % of the time; clipped to it, it is refused."""
    t = np.arange(20000) / 2000
    speed = 17.0 * np.interp(t, [0, 0.5, 2.5, 3.5, 5.5, 6, 8, 8.5, 10], [0, 0.5, 0.5, -0.6, -0.6, 0.83, 0.83, 0.2, 0.2])
    speed += 0.14 * np.random.default_rng(0).standard_normal(len(t))
    coarse = np.round(speed / 1.48) * 1.48
    recording = Recording(t, np.sin(7 * t), coarse, None, 5e-4, source="log.csv")
    at_top = np.abs(coarse) == np.abs(coarse).max()
    assert np.mean(at_top[1:] & (np.diff(coarse) == 0)) > 0.06, "else there is nothing to show"
    assert prepare(recording).counts.all()
    fine = np.round(np.clip(speed, -9.0, 9.0) / 0.01) * 0.01
    with pytest.raises(InputError, match="stands at its limit 9 "):
        prepare(dataclasses.replace(recording, velocity=fine))


def dropped(recording, every=200, rows=8):
    """The recording as a logger shows it that holds a row for some rows, now and then."""
    last = np.arange(len(recording))
    for k in range(every, len(recording) - rows, every):
        last[k : k + rows] = k - 1
    return dataclasses.replace(recording, velocity=recording.velocity[last], angle=recording.angle[last])


def test_rows_that_were_held_are_known_and_do_not_count(record):
    recording = record()
    assert not held_rows(recording).any()
    found = held_rows(dropped(recording))
    assert found.sum() > 0.9 * 8 * (len(recording) // 200 - 1), "but for those near standstill"
    assert np.array_equal(prepare(dropped(recording)).counts, ~found)
    half = np.arange(len(recording)) < len(recording) // 2
    assert np.array_equal(prepare(dropped(recording), counts=half).counts, half & ~found)


def test_a_coarse_sensor_an_axis_at_rest_and_a_lone_channel_hold_nothing(record):
    recording = record()
    coarse = dataclasses.replace(recording, angle=np.round(recording.angle / 0.01) * 0.01, velocity=np.round(recording.velocity))
    assert not held_rows(coarse).any()
    assert not held_rows(dataclasses.replace(dropped(recording), angle=None)).any()
    rest = np.concatenate([np.zeros(500), recording.velocity]), np.concatenate([np.zeros(500), recording.angle])
    t = recording.dt * np.arange(len(rest[0]))
    assert not held_rows(Recording(t, np.sin(t), *rest, recording.dt)).any()


def test_held_rows_are_said_and_are_no_physics(robot, pair):
    first, other = (dropped(r) for r in pair())
    result = diagnose(robot, [first], [other], Options(effects=("coulomb_friction", "actuator_lag"), jobs=1))
    assert result.verdict is Verdict.UNEXPLAINED
    assert not result.findings
    assert "not measured" in result.summary
    assert any("repeat velocity and angle" in note for note in result.notes)
    assert result.fit["corrected"].held_out_rms < 1.05 * result.noise_floor, "they are left out of the fit"


def test_a_row_of_a_recording_that_is_fitted_in_blocks_is_counted_once(robot, record):
    recording = dropped(record(seconds=4))
    result = diagnose(robot, [recording], [], Options(effects=("actuator_lag",), jobs=1))
    assert any(note.startswith(f"{held_rows(recording).sum()} rows") for note in result.notes)


@pytest.mark.parametrize(("dt", "level"), [(0.01, 0.05), (5e-4, 0.05)])
def test_noise_of_a_slow_recording_is_not_its_motion(dt, level):
    rng = np.random.default_rng(5)
    t = dt * np.arange(2000)
    motion = sum(3.0 * np.cos(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f in np.arange(1.0, 31.0))
    assert white_noise_level(motion + level * rng.standard_normal(len(t))) == pytest.approx(level, rel=0.3)


def test_white_noise_has_one_level_by_either_way():
    rng = np.random.default_rng(6)
    for n in (300, 700, 2000):
        levels = [white_noise_level(rng.standard_normal(n)) for _ in range(200)]
        assert min(levels) > 0.7
        assert max(levels) < 1.4


def test_a_velocity_that_is_a_difference_of_the_angle_is_no_second_channel():
    rng, dt = np.random.default_rng(7), 1e-3
    t = dt * np.arange(4000)
    motion = sum(np.sin(2 * np.pi * f * t + f) / f for f in (1.0, 3.0, 11.0))
    angle = np.round((motion + 1e-5 * rng.standard_normal(len(t))) / 1e-4) * 1e-4
    steps = np.diff(angle) / dt
    shown = np.gradient(motion, dt)
    for made in (np.append(0.0, steps), np.append(steps, 0.0), np.gradient(angle, dt), np.round(np.gradient(angle, dt), 6)):
        r = Recording(t, motion, made, angle, dt)
        assert without_derived_velocity(r).velocity is None
    for own in (shown, shown + 0.05 * rng.standard_normal(len(t))):
        r = Recording(t, motion, own, angle, dt)
        assert without_derived_velocity(r) is r
    b, a = butter(2, 0.2)
    for made in (lfilter(b, a, np.gradient(angle, dt)), filtfilt(b, a, np.gradient(angle, dt))):
        assert without_derived_velocity(Recording(t, motion, made, angle, dt)).velocity is None
    for own in (lfilter(b, a, shown), lfilter(b, a, shown + 0.05 * rng.standard_normal(len(t)))):
        assert without_derived_velocity(Recording(t, motion, own, angle, dt)).velocity is not None
    alone = Recording(t, motion, shown, None, dt)
    assert without_derived_velocity(alone) is alone


def test_whether_a_velocity_was_made_of_the_angle_is_computed_once(monkeypatch):
    rng, dt = np.random.default_rng(8), 1e-3
    t = dt * np.arange(4000)
    angle = np.sin(7.0 * t) + 1e-5 * rng.standard_normal(len(t))
    asked, filtered = [], derived._filtered
    monkeypatch.setattr(derived, "_filtered", lambda *a: asked.append(a) or filtered(*a))
    for rate in (7.0, 7.0, 7.5):
        own = rate * np.cos(7.0 * t)
        without_derived_velocity(Recording(t, angle, own, angle, dt))
    assert len(asked) == 2


def test_a_diagnosis_says_that_the_velocity_is_the_angle(robot, record):
    r = record(seconds=2)
    angle = np.round(r.angle / 1e-3) * 1e-3
    made = [Recording(r.time, r.torque, np.append(0.0, np.diff(angle)) / r.dt, angle, r.dt)]
    result = diagnose(robot, made, (), Options(jobs=1, effects=("torque_offset", "time_delay")))
    assert result.channel == "velocity"
    assert any("made of the angle column" in note for note in result.notes)
    assert result.verdict is Verdict.PARAMETERS_ONLY


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3])
def test_a_smooth_velocity_is_that_of_the_motion_and_not_of_the_noise(noise):
    t = 5e-4 * np.arange(12000)
    rng = np.random.default_rng(3)
    angle = 0.2 * np.sin(2 * np.pi * 0.8 * t) + noise * rng.standard_normal(len(t))
    r = Recording(t, np.zeros(len(t)), None, angle, 5e-4)
    expected = 0.2 * 2 * np.pi * 0.8 * np.cos(2 * np.pi * 0.8 * t)
    size = np.sqrt(np.mean(expected**2))
    assert np.sqrt(np.mean((smooth_velocity(r) - expected) ** 2)) < 0.12 * size
    assert reversals(smooth_velocity(r)) == pytest.approx(2 * 0.8 * t[-1], abs=1)
    if noise == 1e-3:
        assert np.sqrt(np.mean((measured_velocity(r) - expected) ** 2)) > size
