"""A diagnosis on a terminal of 80 columns: no word of it is cut, no text of a file is markup."""

from __future__ import annotations

from pathlib import Path

import pytest

from diagnose.result import Estimate, FitFigures, Verdict
from diagnose.robot.result import JointResult, RobotDiagnosis, RobotFinding
from simgap.show import estimate_text, show_robot


@pytest.mark.parametrize("joint", ["elbow", "[bold]x"])
def test_a_robot_fits_a_terminal(joint, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    e, f = Estimate(0.8, (0.7, 0.9), "N m"), FitFigures(0.1, 0.2, 0.3, 0.4)
    finding = RobotFinding("coulomb_friction", joint, joint, "Dry friction.", {"torque_Nm": e}, {"p_value": 1e-5})
    fits = {"nominal": f, "refitted": f, "corrected": f}
    result = JointResult(joint, "N m", Verdict.MISSING_PHYSICS, "Told.", (finding,), fits, {}, {}, (0.0, 1.0), ())
    robot = RobotDiagnosis(
        Verdict.MISSING_PHYSICS,
        "Missing: friction.",
        {joint: result},
        {},
        {},
        {},
        (),
        (),
        ("[red]a note",),
        3,
        20.0,
        (),
        0,
        1.0,
        {},
    )
    show_robot(robot, Path("out"))
    said = capsys.readouterr().out
    assert "…" not in said
    assert f"coulomb_friction at {joint}" in said
    assert "torque_Nm = 0.8 N m   95 % [0.7, 0.9]" in said
    assert "missing_physics │ 40.00 %" in said
    assert "[red]a note" in said
    assert max(map(len, said.splitlines())) <= 80


@pytest.mark.parametrize(
    ("estimate", "said"),
    [
        (Estimate(0.1, (0.099, 0.101), "N m"), "0.1 N m   95 % [0.099, 0.101]"),
        (Estimate(0.0500521511, (0.0500521461, 0.0500521561), "N m"), "0.0500521511 N m   95 % [0.0500521461, 0.0500521561]"),
        (Estimate(2.0, (2.0, 2.0), ""), "2    95 % [2, 2]"),
    ],
)
def test_an_interval_is_not_printed_as_a_point(estimate, said):
    assert estimate_text(estimate) == said
