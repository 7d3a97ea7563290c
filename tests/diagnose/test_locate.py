"""Where the mismatch is, on every recording: shares above noise, states, places, in the result and on the page."""

from __future__ import annotations

import numpy as np
import pytest
from robot_axis import effect

from diagnose.pipeline import Options, diagnose
from diagnose.report.page import render_report

FEW = Options(jobs=1, effects=("coulomb_friction",))
COULOMB = effect("coulomb_friction", torque_Nm=0.1)


@pytest.fixture(scope="module")
def three(pair, record, robot):
    first, other = pair(COULOMB, seconds=3.0)
    return diagnose(robot, [first, record(COULOMB, seed=5, amplitude=0.6, seconds=3.0)], [other], FEW)


def test_every_recording_is_looked_at(three):
    assert [(m.source, m.role) for m in three.mismatches] == [
        ("synthetic_0.csv", "estimation"), ("synthetic_5.csv", "estimation"), ("synthetic_1.csv", "held-out"),
    ]  # fmt: skip
    assert three.mismatches[0] is three.mismatch
    assert sum(three.shares()) == pytest.approx(1.0)
    for m in three.mismatches:
        assert m.above_noise > 0.8
        assert next(s.share for s in m.state if s.state == "velocity") > 0.15
        assert {p.place for p in m.place} == {"motor", "gearbox", "arm", "sensor"}
        assert np.all(np.isfinite(m.spectrum[1]))


def test_the_shares_are_of_the_energy_above_noise(three):
    for m, t in zip(three.mismatches, three.traces, strict=True):
        energy = np.sum((t.measured - t.refitted)[t.counted] ** 2 - t.sigma**2) / t.sigma**2
        assert m.energy == pytest.approx(energy, rel=1e-6)


def test_json_and_page_hold_each(three):
    said = three.as_dict()["mismatch"]
    assert [r["file"] for r in said["recordings"]] == [m.source for m in three.mismatches]
    assert said["recordings"][0]["state"] == said["state"]
    assert sum(r["share"] for r in said["recordings"]) == pytest.approx(1.0)
    page = render_report(three)
    assert "Where it is in synthetic_5.csv (estimation)" in page
    assert "Where it is in synthetic_1.csv (held-out)" in page
    assert "0.05 s ahead" in page


@pytest.mark.slow
def test_a_recording_whose_blocks_are_held_out_comes_once(record, robot):
    result = diagnose(robot, [record(COULOMB, seconds=6.0)], (), FEW)
    assert [m.source for m in result.mismatches] == ["synthetic_0.csv"]
    assert result.shares() == (1.0,)
    near, _, far = result.fit["refitted"].ahead
    assert near[1] < far[1]
    assert result.fit["corrected"].ahead[0][1] == pytest.approx(0.05, rel=0.1)
