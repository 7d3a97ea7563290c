"""Comparison of two sets of answers: McNemar's exact test, gains and losses, parameters, simulations, exit code."""

from __future__ import annotations

import math
from math import comb

import pytest
from click.testing import CliRunner

from lab.panel.cli import panel
from lab.panel.compare import compare, markdown, mcnemar
from lab.panel.record import Finding, Record, write_answers
from mjsim.errors import InputError


def answer(case, outcome="right", *, verdict="missing_physics", effect="backlash", value=1.0, null=False, **more):
    findings = (Finding(effect, "arm", {"gap_rad": (value, 0.9, 1.1)}),) if effect else ()
    return Record(case, "h", "c", verdict, outcome, null, findings, **more)


def by_case(*records):
    return {r.case: r for r in records}


@pytest.mark.parametrize(("gained", "lost"), [(0, 1), (1, 1), (0, 5), (0, 6), (2, 9), (7, 3), (10, 30)])
def test_mcnemar_is_the_two_sided_binomial_tail(gained, lost):
    n, most = gained + lost, max(gained, lost)
    tail = sum(comb(n, k) for k in range(most, n + 1)) / 2**n
    assert mcnemar(gained, lost) == pytest.approx(min(1.0, 2 * tail), rel=1e-12)


def test_mcnemar_of_no_difference_is_one():
    assert mcnemar(0, 0) == 1.0


def with_losses(lost, gained=0):
    before = by_case(*(answer(f"l{k}") for k in range(lost)), *(answer(f"g{k}", "missed") for k in range(gained)), answer("s"))
    after = by_case(*(answer(f"l{k}", "missed") for k in range(lost)), *(answer(f"g{k}") for k in range(gained)), answer("s"))
    return compare(before, after)


def test_a_loss_is_significant_from_six_of_six():
    five, six = with_losses(5), with_losses(6)
    assert (five.lost, five.significant_loss, five.fails) == (5, False, False)
    assert (six.lost, six.significant_loss, six.fails) == (6, True, True)
    gains = with_losses(0, 6)
    assert (gains.gained, gains.fails) == (6, False)


def test_one_more_false_alarm_fails():
    null = {"null": True, "effect": ""}
    before = by_case(answer("a", verdict="no_mismatch", **null), answer("b", "false alarm", null=True))
    assert not compare(before, before).fails
    after = {**before, "a": answer("a", "false alarm", null=True)}
    found = compare(before, after)
    assert (found.false_alarms.before, found.false_alarms.after, found.fails) == (1, 2, True)


def test_a_parameter_has_moved_outside_its_interval_alone():
    before = by_case(answer("a"), answer("b"), answer("c"))
    after = by_case(answer("a", value=1.1), answer("b", value=1.1001), answer("c", effect="torque_ripple", value=9.0))
    found = compare(before, after)
    assert [(m.case, m.parameter, m.after) for m in found.moved] == [("b", "backlash@arm.gap_rad", 1.1001)]
    assert found.common_parameters == 2


def test_parameters_differ_beyond_the_level_of_their_intervals():
    """One of twenty may lie outside an interval of 95 %; what no model explains is not counted."""

    def compared(moved, count, verdict="missing_physics"):
        names = [f"c{k}" for k in range(count)]
        before = by_case(*(answer(n, verdict=verdict) for n in names))
        return compare(
            before, by_case(*(answer(n, verdict=verdict, value=9.0 if k < moved else 1.0) for k, n in enumerate(names)))
        )

    assert not compared(1, 20).parameters_differ
    assert compared(2, 20).parameters_differ
    assert compared(1, 19).parameters_differ
    unexplained = compared(5, 20, "unexplained")
    assert (len(unexplained.moved), unexplained.explained_parameters, unexplained.parameters_differ) == (5, 0, False)


def test_figures_of_paired_cases_only():
    before = by_case(
        answer("a", simulations=100, held_out=(3.0, 2.0, 1.0)), answer("b", simulations=300, held_out=(3.0, 2.0, 1.0)),
        answer("c", simulations=None), answer("only_before"),
    )  # fmt: skip
    other = Record("d", "other", "c", "no_mismatch", None, False)
    after = by_case(
        answer("a", simulations=200, held_out=(3.0, 2.0, 1.1)), answer("b", simulations=400, held_out=(3.0, 2.0, 0.9)),
        answer("c", simulations=9), other,
    )  # fmt: skip
    found = compare({**before, "d": Record("d", "h", "c", "no_mismatch", None, False)}, after)
    assert found.cases == 3
    assert found.unpaired == ("d", "only_before")
    assert (found.simulations_median.before, found.simulations_median.after) == (200, 300)
    assert found.held_out_ratio[0] == pytest.approx(1.0)
    assert found.held_out_ratio[2] == pytest.approx(1.1)


def test_a_change_without_a_truth_is_told_and_not_counted():
    before = by_case(answer("k", None), answer("same", None))
    found = compare(before, {**before, "k": answer("k", None, effect="time_delay")})
    assert [(c.case, c.kind) for c in found.changes] == [("k", "changed")]
    assert (found.known, found.gained, found.lost) == (0, 0, 0)
    assert math.isnan(found.right.before)


def test_runs_without_a_common_case_are_refused():
    with pytest.raises(InputError, match="same files"):
        compare(by_case(answer("a")), by_case(answer("b")))


def test_the_command_prints_tables_and_exits_by_the_loss(tmp_path):
    files = [tmp_path / f"{name}.json" for name in ("before", "after")]
    for path, outcome in zip(files, ("right", "missed"), strict=True):
        write_answers(path, [answer(f"case{k}", outcome) for k in range(6)], {})
    same = CliRunner().invoke(panel, ["compare", str(files[0]), str(files[0])])
    assert same.exit_code == 0, same.output
    assert "no significant loss" in same.output
    worse = CliRunner().invoke(panel, ["compare", *map(str, files), "--json", str(tmp_path / "figures.json")])
    assert worse.exit_code == 1
    assert "| case0 | lost | missing_physics: backlash@arm |" in worse.output
    assert '"fails": true' in (tmp_path / "figures.json").read_text()


def test_markdown_has_a_row_for_each_figure():
    text = markdown(with_losses(1, 2), "old", "new")
    for row in ("right, of those with a truth | 2 of 4 | 3 of 4", "false alarms", "simulations, 95th percentile"):
        assert row in text
