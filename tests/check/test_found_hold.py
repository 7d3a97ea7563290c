"""The hold that all recordings show takes the place of one that nobody stated."""

from __future__ import annotations

import dataclasses

import pytest

from diagnose.check.found_hold import told_as_taken, with_found_hold
from diagnose.check.types import Severity


@pytest.mark.parametrize("between", ["linear", "mean"])
def test_the_hold_that_all_show_is_taken(between, log, checked):
    given = log(rate=250, between=between)
    check = checked(given)
    taken = with_found_hold(check, [given], [])
    assert [r.hold for r in taken[0]] == [between]
    said = [p for p in told_as_taken(check, checked(*taken[0])).problems if p.problem == "hold"]
    assert [p.severity for p in said] == [Severity.LIMITS]
    assert "the diagnosis takes it so" in said[0].advice


def test_a_hold_that_is_stated_or_that_one_does_not_show_stays(log, checked):
    given, other = log(rate=250, between="linear"), log(rate=250, between="held")
    stated = dataclasses.replace(given, hold_stated=True)
    assert with_found_hold(checked(given), [given], []) is not None
    assert with_found_hold(checked(stated), [stated], []) is None
    assert with_found_hold(checked(given), [given], [other]) is None
    assert with_found_hold(checked(other), [other], []) is None
