"""Low-passed and interpolated logs: noise is estimated at the rate that the content needs."""

from __future__ import annotations

import numpy as np
import pytest
from twins import low_passed, motor, recording

from diagnose.check.content import content_end
from diagnose.data.content import at_content_rate, decimated
from diagnose.data.experiment import prepare
from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from mjsim.axis import Axis, Body, Chain

RATE, CUT = 1000.0, 40.0
NOMINAL = Axis(Chain((Body("motor", 0.01, 0.04, "j"),), ()))


def filtered(seed: int, level: float = 0.06, noise: float = 0.05):
    u, v, _ = motor(seed, RATE, 6.0, level, noise)
    return recording(RATE, low_passed(u, RATE, CUT), low_passed(v, RATE, CUT), None, f"{seed}.csv")


def test_the_end_of_a_filtered_channel_is_found_above_a_floor_of_rounding():
    r = filtered(1)
    assert r.velocity is not None
    printed = np.array([float(f"{x:.9g}") for x in r.velocity])
    for x in (r.velocity, printed):
        end = content_end(x, r.dt)
        assert end is not None
        assert 0.4 * CUT < end < 1.6 * CUT


def test_a_raw_channel_fills_its_band_however_far_the_axis_turns():
    u, v, q = motor(1, RATE, 4.0)
    assert content_end(v, 1 / RATE) is None
    turned = q + 20.0 * np.arange(len(q)) / RATE
    assert content_end(turned, 1 / RATE) is None
    assert at_content_rate([recording(RATE, u, v, q, "a.csv")])[1] == ()


def test_noise_of_a_filtered_log_is_that_within_its_band():
    r = filtered(1)
    (slow,), said = at_content_rate([r])
    within = 0.05 * np.sqrt(2 * CUT / RATE)
    assert prepare(r).sigma < 0.01 * within
    assert 0.6 * within < prepare(slow).sigma < 1.7 * within
    assert "filtered or interpolated" in said[0]
    assert slow.dt > 5 * r.dt
    assert slow.hold == "mean"


def test_one_raw_log_keeps_all_as_they_are():
    u, v, _ = motor(2, RATE, 6.0)
    logs = [filtered(1), recording(RATE, u, v, None, "raw.csv")]
    kept, said = at_content_rate(logs)
    assert [r.dt for r in kept] == [1 / RATE] * 2
    assert said == ()


def test_an_interpolated_angle_is_taken_at_the_rate_of_its_samples():
    u, _, q = motor(1, 200.0, 12.0, noise=0.06)
    t, fine = np.arange(len(q)) / 200.0, np.arange(5 * len(q)) / 1000.0
    angle = np.interp(fine, t, q)
    (slow,), said = at_content_rate([recording(1000.0, np.repeat(u, 5), None, angle, "a.csv")])
    assert said
    assert slow.dt >= 0.003


@pytest.mark.parametrize(("hold", "first"), [("held", 1.0), ("mean", 2.0), ("linear", 1.5)])
def test_the_input_of_a_slower_log_is_its_mean(hold, first):
    """Rows 0 to 8: the mean of the first interval of three samples stands in the row at its end."""
    r = recording(100.0, np.arange(9.0), np.zeros(9), None, "a.csv", hold=hold)
    slow = decimated(r, 3)
    assert slow.torque[1] == pytest.approx(first)
    assert slow.hold == "mean"
    ahead = decimated(r, 3, held=True)
    assert (ahead.torque[0], ahead.hold) == (pytest.approx(first), "held")
    assert len(slow) == 3
    assert slow.dt == pytest.approx(0.03)


@pytest.mark.parametrize("level", [0.0, 0.06])
def test_a_filtered_log_gets_no_false_all_clear_and_no_false_alarm(level):
    logs, _ = at_content_rate([filtered(s, level) for s in (1, 2)])
    only = ("coulomb_friction", "torque_offset")
    result = diagnose(NOMINAL, logs[:1], logs[1:], Options(jobs=1, effects=only))
    names = {f.effect for f in result.findings}
    assert names == set() if not level else names & {"coulomb_friction", "presliding_friction"}
    assert result.verdict in ((Verdict.MISSING_PHYSICS, Verdict.UNEXPLAINED) if level else (Verdict.PARAMETERS_ONLY,))
