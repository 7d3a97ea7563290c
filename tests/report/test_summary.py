"""The answer as Markdown."""

from __future__ import annotations

import dataclasses
import re

from synthetic import synthetic

from diagnose.report.summary import summary
from diagnose.result import Estimate, FitFigures, Verdict
from diagnose.robot.result import JointResult, RobotDiagnosis, RobotFinding
from diagnose.robot.summary import summary as robot_summary


def cells(text: str) -> list[list[str]]:
    """The rows of all tables."""
    rows = [line for line in text.splitlines() if line.startswith("|")]
    return [[c.strip() for c in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows]


def test_it_holds_the_answer_with_its_figures() -> None:
    text = summary(synthetic(2_500))
    assert text.startswith("## Missing physics\n\nThe simulation leaves out dry friction")
    rows = cells(text)
    assert ["nominal, as given", "0.6200", "0.6600"] in rows
    assert any(r[0] == "Coulomb friction, motor (motor)" and r[2:4] == ["0.10013", "0.09982 … 0.10044"] for r in rows)
    assert any(r[0] == "Jm (inertia, motor)" and r[-1] == "1.0\N{NARROW NO-BREAK SPACE}%" for r in rows)
    assert "**Next:** A multisine" in text
    assert "`axis_estimation.csv`, `axis_held_out.csv`" in text


def test_every_row_of_a_table_has_as_many_cells_and_text_is_no_markup() -> None:
    d = synthetic(2_500)
    finding = dataclasses.replace(d.findings[0], element="<b>|`x`")
    hostile = dataclasses.replace(d, findings=(finding,), notes=("a <script> & *b* | [c](d)",), summary="One | two\n# three.")
    text = summary(hostile)
    assert "<script" not in text.replace("\\<", "")
    assert "\\*b\\* \\| \\[c\\](d)" in text
    assert "\n# three" not in text
    widths = [len(r) for r in cells(text)]
    assert set(widths) == {3, 6}


def test_a_robot_has_a_row_a_joint_and_its_findings() -> None:
    e, f = Estimate(1.0, (0.9, 1.1), "N m"), FitFigures(0.1, 0.2, 0.3, 0.4)
    finding = RobotFinding("coulomb_friction", "el|bow", "elbow", "Friction.", {"torque_Nm": e}, {"p_value": 1e-5})
    fits = {"nominal": f, "refitted": f, "corrected": f}
    joints = {
        name: JointResult(name, "N m", verdict, "Told.", found, fits, {}, {}, (0.0, 1.0), ())
        for name, verdict, found in (("el|bow", Verdict.MISSING_PHYSICS, (finding,)), ("wrist", Verdict.NO_MISMATCH, ()))
    }
    changed = tuple(f"kp of joint{k}: 50 -> 35" for k in range(25))
    robot = RobotDiagnosis(
        Verdict.MISSING_PHYSICS, "Missing: Coulomb friction at elbow.", joints, {}, {}, {}, (), changed, ("<b>a note</b>",), 3,
        20.0, ({"file": "a.csv", "sha256": "0", "role": "estimation"},), 0, 1.0, {"simgap": "1"},
    )  # fmt: skip
    text = robot_summary(robot)
    assert text.startswith("## Missing physics\n\nMissing: Coulomb friction at elbow")
    rows = cells(text)
    assert ["wrist", "No mismatch", "N·m", "0.3000", "0.3000", "0.3000"] in rows
    assert any(r[0] == "Coulomb friction at el\\|bow" and r[1] == "torque\\_Nm" for r in rows)
    assert {len(r) for r in rows} == {6}
    assert "- and 5 more" in text
    assert "<b>" not in text.replace("\\<", "")


def test_nothing_found() -> None:
    d = dataclasses.replace(
        synthetic(2_500), verdict=Verdict.NO_MISMATCH, findings=(), fit={}, notes=(), next_experiment=None, linear_parameters={}
    )
    assert summary(d).startswith("## No mismatch")
    assert cells(summary(d)) == []
