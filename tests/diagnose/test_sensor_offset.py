"""What the angle says of an offset of the velocity: five standard errors of the blocks' means decide."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.evidence.sensor_offset import excluded_by_angle
from diagnose.thresholds import BLOCKS, SIGMAS
from mjsim.recording import Recording

DT = 1e-3
OFFSET, SOUND = {"torque_offset": "sensor_offset"}, {"sensor_offset": ""}


def experiment(apart, speed=None):
    """A recording whose velocity, between samples, lies ``apart`` (N - 1,) above the rate of its angle."""
    n = len(apart) + 1
    v = np.sin(0.05 * np.arange(n)) if speed is None else speed
    rate = 0.5 * (v[1:] + v[:-1]) - apart
    angle = np.append(0.0, np.cumsum(rate) * DT)
    return SimpleNamespace(recording=Recording(DT * np.arange(n), v, v, angle, DT))


def blocks(level, offset, length=40):
    """Blocks that lie ``level`` above and below an offset in turn."""
    return offset + level * np.repeat((-1.0) ** np.arange(BLOCKS), length)


@pytest.mark.parametrize(("times", "verdict"), [(0.998, SOUND), (1.002, OFFSET), (-0.998, SOUND), (-1.002, OFFSET)])
def test_an_offset_stands_out_of_the_blocks_by_standard_errors(times, verdict):
    level = 0.1
    spread = level * math.sqrt(BLOCKS / (BLOCKS - 1))
    at_least = 1e-4 * np.std(experiment(blocks(level, 0.0)).recording.velocity) / math.sqrt(40 * BLOCKS + 1)
    offset = times * SIGMAS * (spread / math.sqrt(BLOCKS) + at_least)
    assert excluded_by_angle([experiment(blocks(level, offset))]) == verdict


@pytest.mark.parametrize(("times", "verdict"), [(0.998, SOUND), (1.002, OFFSET)])
def test_blocks_that_are_alike_leave_a_ten_thousandth_of_the_speed(times, verdict):
    """Noise that cancels within every block: what rounding leaves is no error of the mean."""
    noise = np.tile([1e-3, -1e-3], 20 * BLOCKS)
    speed = experiment(noise).recording.velocity
    offset = times * SIGMAS * 1e-4 * float(np.std(speed)) / math.sqrt(len(speed))
    assert excluded_by_angle([experiment(noise + offset)]) == verdict


@pytest.mark.parametrize(("n", "told"), [(99, False), (100, True)])
def test_a_hundred_samples_are_asked_for(n, told):
    assert bool(excluded_by_angle([experiment(np.full(n - 1, 5.0) + np.resize([0.1, -0.1], n - 1))])) is told


@pytest.mark.parametrize(("spread", "told"), [(0.5e-9, False), (2e-9, True)])
def test_a_channel_that_was_computed_from_the_other_tells_nothing(spread, told):
    n = 40 * BLOCKS
    found = experiment(np.zeros(n))
    v = found.recording.velocity
    apart = spread * np.std(v) * np.resize([1.0, -1.0], n)
    assert bool(excluded_by_angle([experiment(apart, v)])) is told


def test_recordings_must_agree():
    sound, off = experiment(blocks(0.1, 0.0)), experiment(blocks(0.1, 1.0))
    assert excluded_by_angle([]) == {}
    assert excluded_by_angle([sound, off]) == {}
    assert excluded_by_angle([off, off]) == OFFSET
    assert excluded_by_angle([sound, sound]) == SOUND
    r = off.recording
    alone = SimpleNamespace(recording=Recording(r.time, r.torque, r.velocity, None, DT))
    lone_angle = SimpleNamespace(recording=Recording(r.time, r.torque, None, r.angle, DT))
    assert excluded_by_angle([alone, lone_angle, off]) == OFFSET, "those with one channel say nothing"
