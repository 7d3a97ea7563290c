"""The nonlinearity tests: they find what is there, and on linear systems they keep the false-alarm rate that they state."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal, stats

from ident import IOData, amplitude_test, detection_lines, odd_multisine
from mjsim.errors import InputError

FIRST_ORDER = ([0, 0.5], [1, -0.8])
_POLES = [r * np.exp(s * 1j * w) for r, w in ((0.995, 0.55), (0.99, 0.8)) for s in (1, -1)]
_ZEROS = [0.995 * np.exp(s * 1j * 0.65) for s in (1, -1)]
RESONANT = (np.r_[0, np.real(np.poly(_ZEROS))], np.real(np.poly(_POLES)))
"""Two peaks and a notch, each narrower than a block of lines."""
SYSTEMS = {"first order": FIRST_ORDER, "resonant": RESONANT}
COLOURS = {"white": ([1], [1]), "low": ([1], [1, -0.9]), "peaked": ([1], [1, -1.8 * np.cos(0.9), 0.81])}
RATE = 0.05
RUNS = pytest.mark.parametrize("runs", [60, pytest.param(300, marks=pytest.mark.slow)])
SOME, ALL = ("first order", "low"), [(system, colour) for system in ("first order", "resonant") for colour in COLOURS]
NOISES = pytest.mark.parametrize(
    ("system", "colour"), [pytest.param(*pair, marks=() if pair == SOME else pytest.mark.slow) for pair in ALL]
)


def most(runs):
    """99.9 % binomial limit on the false alarms of so many runs."""
    return stats.binom.ppf(0.999, runs, RATE)


def coloured(rng, n, colour):
    v = signal.lfilter(*COLOURS[colour], rng.standard_normal(n))
    return v / np.std(v)


def multisine_record(seed, system=FIRST_ORDER, colour="white", even=0.0, odd=0.0, sigma=0.05, periods=6):
    rng = np.random.default_rng(seed)
    ms = odd_multisine(1000, 0.01, (0.5, 20.0), 1.0, rng)
    u = ms.repeated(periods)
    x = signal.lfilter(*system, u)
    x = x / np.std(x)
    return ms, IOData(u, x + even * x**2 + odd * x**3 + sigma * coloured(rng, x.size, colour), 0.01)


def chirps(seed, law=lambda x: x, system=FIRST_ORDER, colour="white", sigma=0.05, shape=1.0):
    rng = np.random.default_rng(seed)
    t = np.arange(4000) * 0.005
    records = []
    for level in (0.5, 2.0 * shape):
        u = level * signal.chirp(t, 0.5, 20, 30)
        records.append(IOData(u, law(signal.lfilter(*system, u)) + sigma * coloured(rng, t.size, colour), 0.005))
    return records


def test_detection_lines_name_the_kind_of_distortion():
    ms, data = multisine_record(0)
    assert not detection_lines(data, ms).nonlinear
    ms, data = multisine_record(1, even=0.02)
    result = detection_lines(data, ms)
    assert result.nonlinear
    assert "even" in result.sentence
    assert "odd" not in result.sentence
    ms, data = multisine_record(2, odd=0.01)
    assert "odd" in detection_lines(data, ms).sentence


@NOISES
@RUNS
def test_detection_lines_keep_their_false_alarm_rate(system, colour, runs):
    """Noise of any colour: each line is judged against its own noise."""
    skip, periods = (4, 9) if system == "resonant" else (1, 6)
    alarms = sum(
        detection_lines(d, m, RATE, skip=skip).nonlinear
        for m, d in (multisine_record(s, SYSTEMS[system], colour, periods=periods) for s in range(runs))
    )
    assert alarms <= most(runs)


def test_detection_lines_see_weak_distortion():
    found = sum(detection_lines(d, m).nonlinear for m, d in (multisine_record(s, even=0.01) for s in range(40)))
    assert found >= 36


def test_detection_lines_without_noise():
    ms, data = multisine_record(4, sigma=0.0)
    assert not detection_lines(data, ms, skip=2).nonlinear


def test_detection_lines_want_enough_periods_of_the_same_sampling():
    ms, data = multisine_record(5, periods=2)
    with pytest.raises(InputError, match="repeat the multisine"):
        detection_lines(data, ms)
    with pytest.raises(InputError, match="equal sampling intervals"):
        detection_lines(IOData(data.u, data.y, 0.02), ms)


def test_amplitude_test_finds_a_dead_band_and_passes_a_linear_system():
    assert not amplitude_test(*chirps(0)).nonlinear
    bent = amplitude_test(*chirps(0, lambda x: x - 0.1 * np.clip(x / 0.1, -1, 1)))
    assert bent.nonlinear
    assert "moves with the level" in bent.sentence
    assert not amplitude_test(*chirps(0, sigma=0.0)).nonlinear


@NOISES
@RUNS
def test_amplitude_test_keeps_its_false_alarm_rate(system, colour, runs):
    """However sharp the resonances: what both levels share cancels, it is not smoothed."""
    alarms = sum(amplitude_test(*chirps(s, system=SYSTEMS[system], colour=colour), RATE).nonlinear for s in range(runs))
    assert alarms <= most(runs)


@RUNS
def test_amplitude_test_keeps_its_rate_when_the_inputs_are_not_proportional(runs):
    shape = 1 + 0.5 * np.sin(np.pi * np.arange(4000) / 2000)
    alarms = sum(amplitude_test(*chirps(s, system=RESONANT, shape=shape), RATE).nonlinear for s in range(runs))
    assert alarms <= most(runs)


def test_amplitude_test_measures_the_change():
    low, high = chirps(7, sigma=0.001)
    result = amplitude_test(low, IOData(high.u, 1.1 * high.y, high.dt))
    assert result.nonlinear
    inner = result.change_db[1:8]  # the first block straddles the chirp's edge
    np.testing.assert_allclose(inner, 20 * np.log10(1.1), atol=0.05)


def test_amplitude_test_wants_equal_records():
    low, high = chirps(8)
    with pytest.raises(InputError, match="equal records"):
        amplitude_test(low, high.part(0, 3000))
    with pytest.raises(InputError, match="at least 14"):
        amplitude_test(low, high, block=5)
