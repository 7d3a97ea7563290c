"""The answer as Markdown."""

from __future__ import annotations

import dataclasses
import re

from synthetic import synthetic

from diagnose.report.summary import summary
from diagnose.result import Verdict


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


def test_nothing_found() -> None:
    d = dataclasses.replace(
        synthetic(2_500), verdict=Verdict.NO_MISMATCH, findings=(), fit={}, notes=(), next_experiment=None, linear_parameters={}
    )
    assert summary(d).startswith("## No mismatch")
    assert cells(summary(d)) == []
