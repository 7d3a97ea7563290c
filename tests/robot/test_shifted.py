"""A delay that most joints have in common is told as one of the log or the bus."""

from __future__ import annotations

from types import SimpleNamespace

from diagnose.result import Estimate
from diagnose.robot.shifted import shifted


def _joints(*delays):
    found = [[SimpleNamespace(parameters={"delay_s": Estimate(d, (d - 1e-3, d + 1e-3), "s")})] if d else [] for d in delays]
    return {f"joint{k}": SimpleNamespace(findings=x) for k, x in enumerate(found)}


def test_most_joints_and_two_at_least():
    assert "3 of 5 joints have a delay of 20 ms" in shifted(_joints(0.02, 0.0205, 0.0195, 0, 0))[0]
    assert shifted(_joints(0.02, 0.0205, 0, 0)) == []
    assert shifted(_joints(0.02)) == []
    assert shifted(_joints(0, 0)) == []


def test_one_other_delay_does_not_hide_it():
    assert "4 of 6 joints" in shifted(_joints(0.0188, 0.048, 0.0194, 0.0194, 0.0187, 0))[0]
    assert shifted(_joints(0.02, 0.03, 0.04)) == []
