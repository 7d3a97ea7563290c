"""The hold that the recordings show takes the place of one that nobody stated."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.check import check_log
from diagnose.check.found_hold import told_as_taken, with_found_hold
from diagnose.check.types import Severity


@pytest.fixture
def taken(machine):
    """``taken(*recordings)``: the holds that are taken, the last recording held out; None where they stay."""

    def take(*recordings):
        found = with_found_hold(check_log(machine(), recordings), machine(), recordings[:-1], recordings[-1:])
        return None if found is None else [r.hold for group in found for r in group]

    return take


@pytest.mark.parametrize("between", ["linear", "mean"])
def test_the_hold_that_all_show_is_taken(between, log, checked, machine):
    given = log(rate=250, between=between)
    check = checked(given)
    found = with_found_hold(check, machine(), [given], [])
    assert [r.hold for r in found[0]] == [between]
    said = [p for p in told_as_taken(check, checked(*found[0])).problems if p.problem == "hold"]
    assert [p.severity for p in said] == [Severity.LIMITS]
    assert "the diagnosis takes it so" in said[0].advice


def test_a_hold_that_is_stated_or_that_one_contradicts_stays(log, taken):
    given, other = log(rate=250, between="linear"), log(rate=250, between="held")
    assert taken(given, named(given)) == ["linear", "linear"]
    assert taken(given, named(dataclasses.replace(given, hold_stated=True))) is None
    assert taken(given, named(other)) is None
    assert taken(other, named(other)) is None
    assert taken(named(other), given) is None


@pytest.mark.parametrize(("between", "expected"), [("linear", ["linear", "linear"]), ("held", None)])
def test_a_recording_too_noisy_to_show_its_hold_alone_follows_the_others(between, expected, log, checked, taken):
    given, short = log(rate=250, between="linear"), log(rate=250, between=between)
    rng = np.random.default_rng(0)
    noisy = named(dataclasses.replace(short, velocity=short.velocity + rng.normal(0.0, NOISE * short.velocity.std(), len(short))))
    assert not [p for p in checked(noisy).problems if p.problem == "hold"], "it shows none alone"
    assert taken(given, noisy) == expected


NOISE = 0.05


def named(recording):
    """Another recording than that of its name."""
    return dataclasses.replace(recording, source="other.csv")
