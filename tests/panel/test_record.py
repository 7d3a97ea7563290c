"""Records: scored by the benchmark's rules or by expected names, written as lines, read back."""

from __future__ import annotations

import math

import pytest

from lab.panel.case import Content
from lab.panel.record import outcome_of, read_answers, record_of, write_answers
from mjsim.errors import InputError

TRUTH = {
    "level": "plain", "verdict": "missing_physics", "effects": ["coulomb_friction"], "where": {"coulomb_friction": "motor"},
    "parameters": {"coulomb_friction": {"torque_Nm": 0.1}}, "velocity_noise_rms_rad_s": 0.05,
}  # fmt: skip


def said(verdict, *effects, interval=(0.09, 0.11), place="motor"):
    parameters = {"torque_Nm": {"value": 0.1012345678, "ci95": list(interval), "unit": "Nm"}}
    errors = {name: {"held_out_rms": x} for name, x in zip(("nominal", "refitted", "corrected"), (3.0, 1.0, 0.05), strict=True)}
    return {
        "verdict": verdict,
        "findings": [{"effect": e, "place": place, "parameters": parameters, "equivalents": []} for e in effects],
        "linear_parameters": {"Jm": {"value": 1.0, "ci95": [0.9, None], "unit": "kg m2"}},
        "fit": {**errors, "noise_floor": {"rms": 0.05}},
    }


@pytest.mark.parametrize(
    ("result", "outcome"),
    [
        (said("missing_physics", "coulomb_friction"), "right"),
        (said("missing_physics", "coulomb_friction", "torque_ripple"), "right and one too many"),
        (said("missing_physics", "torque_ripple"), "wrong name"),
        (said("unexplained", "coulomb_friction"), "unexplained"),
        (said("no_mismatch"), "missed"),
        ({"error": "ValueError: no"}, "error"),
    ],
)
def test_a_truth_is_scored_by_the_rules_of_the_benchmark(result, outcome):
    assert outcome_of(Content(("a",), (), "m", truth=TRUTH), result) == outcome


def test_a_name_on_nothing_is_a_false_alarm():
    content = Content(("a",), (), "m", truth={"level": "nothing", "verdict": "no_mismatch", "effects": [], "where": {},
                                             "parameters": {}, "velocity_noise_rms_rad_s": 0.05})  # fmt: skip
    record = record_of("x", "h", "c", content, {"seconds": 1.0, "cpu_seconds": 1.0}, said("missing_physics", "torque_ripple"))
    assert (record.null, record.outcome, record.good) == (True, "false alarm", False)


@pytest.mark.parametrize(
    ("result", "outcome"),
    [
        (said("missing_physics", "coulomb_friction", "torque_offset"), "right"),
        (said("missing_physics", "asymmetric_friction"), "right"),
        (said("missing_physics", "asymmetric_friction", "time_delay"), "right and one too many"),
        (said("missing_physics", "torque_offset"), "part of it"),
        (said("missing_physics", "backlash"), "wrong name"),
        (said("unexplained", "asymmetric_friction"), "unexplained"),
        (said("parameters_only"), "missed"),
        ({"error": "no"}, "error"),
    ],
)
def test_expected_names_of_a_real_machine(result, outcome):
    ways = [["asymmetric_friction"], ["coulomb_friction", "torque_offset"]]
    content = Content(("a",), (), "m", expected={"verdicts": ["missing_physics"], "effects": ways})
    assert outcome_of(content, result) == outcome


def test_without_a_truth_an_answer_is_neither_right_nor_wrong():
    record = record_of("x", "h", "c", Content(("a",), (), "m"), {"simulations": 7}, said("missing_physics", "backlash"))
    assert record.outcome is None
    assert record.good is None
    assert record.simulations == 7


def test_answers_are_one_line_a_case_and_come_back(tmp_path):
    content = Content(("a",), (), "m", truth=TRUTH)
    records = [
        record_of("b", "h2", "c", content, {"seconds": 1.5, "cpu_seconds": 1.25, "simulations": 40},
                  said("missing_physics", "coulomb_friction")),
        record_of("a", "h1", "c", content, {"error": "ValueError: no"}, {}),
    ]  # fmt: skip
    path = tmp_path / "answers.json"
    write_answers(path, records, {"commit": "c"})
    assert len(path.read_text().splitlines()) == 2 + len(records)
    back = read_answers(path)
    assert list(back) == ["a", "b"]
    assert back["a"] == records[1]
    assert back["b"].findings[0].parameters["torque_Nm"] == (0.101235, 0.09, 0.11)
    assert back["b"].linear["Jm"] == (1.0, 0.9, None)
    assert back["b"].inside == (1, 1)
    assert math.isclose(back["b"].errors[0], 0.0123457)
    assert back["b"].simulations == 40


def test_a_file_that_holds_no_answers_is_refused(tmp_path):
    (tmp_path / "other.json").write_text("{}")
    for path in (tmp_path / "other.json", tmp_path / "none.json", tmp_path):
        with pytest.raises(InputError):
            read_answers(path)
