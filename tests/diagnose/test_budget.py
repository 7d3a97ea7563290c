"""The budget of time: what ends with it, and what is said of an answer whose search it ended."""

from __future__ import annotations

import math
import time

import pytest
from robot_axis import effect

from diagnose.data.experiment import prepare
from diagnose.fit.engine import Engine
from diagnose.fit.fitter import Fitter
from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.problem.view import MotionView
from diagnose.progress import Progress
from diagnose.result import Verdict
from diagnose.structure import passes
from diagnose.structure.budget import SearchOptions
from diagnose.structure.search import Search
from diagnose.verdict.notes import LATE

EFFECTS = ("coulomb_friction", "torque_offset", "quadratic_friction")


@pytest.fixture(scope="module")
def rubbing(pair):
    return pair(effect("coulomb_friction", torque_Nm=0.3))


def test_what_is_left_of_the_budget():
    began = time.monotonic() - 10.0
    assert Options().since(began).seconds == math.inf
    assert Options(seconds=60.0).since(began).seconds == pytest.approx(50.0, abs=0.5)
    assert Options(seconds=5.0).since(began).seconds == 0.0


def test_an_answer_without_the_time_to_search_says_so(robot, rubbing):
    first, other = rubbing
    late = diagnose(robot, [first], [other], Options(jobs=1, effects=EFFECTS[:1], seconds=1e-6))
    assert late.verdict is Verdict.UNEXPLAINED
    assert not late.findings
    assert LATE in late.notes
    assert late.map is None
    assert "no effect that was tried in the time" in late.summary
    found = diagnose(robot, [first], [other], Options(jobs=1, effects=EFFECTS[:1], seconds=3600.0))
    assert [f.effect for f in found.findings] == ["coulomb_friction"]
    assert LATE not in found.notes


def test_no_further_search_begins_without_time(robot, rubbing, monkeypatch):
    """A search that could not look would find nothing."""
    searches = []
    once = passes._search
    monkeypatch.setattr(passes, "_search", lambda *asked, **known: searches.append(1) or once(*asked, **known))
    fitter = Fitter(robot, MotionView(), *((prepare(r),) for r in rubbing), 1)
    fitter.allow(math.inf, time.monotonic())
    search, best, whitened = passes.searched(fitter, Options(jobs=1, effects=EFFECTS), Progress())
    assert (len(searches), search.state.late, best.effects, whitened) == (1, True, (), False)


@pytest.mark.parametrize("in_time", [pytest.param(1, marks=pytest.mark.slow), 4])
def test_a_move_ends_with_the_budget(robot, rubbing, monkeypatch, in_time):
    """The candidates that are left when the time is used up are not fitted; those before are."""
    fitter = Fitter(robot, MotionView(), *((prepare(r),) for r in rubbing), 1)
    search = Search(fitter, SearchOptions(only=EFFECTS))
    base = search.nominal()
    search.state.consider([c for c in _candidates(fitter) if c.id in EFFECTS])
    move = search.moves.add(base)
    assert move is not None
    left = iter([False] * in_time)  # asked before the move, and before each candidate
    monkeypatch.setattr(Engine, "late", property(lambda engine: next(left, True)))
    fitted = search.halving.run(base, move.neighbours, -math.inf)
    assert len(fitted) == in_time - 1 < len(move.neighbours)
    assert list(search.state.failed.values()) == ["the time was used up"] * (len(move.neighbours) - len(fitted))


def _candidates(fitter):
    from diagnose.structure.candidates import candidates

    return candidates(fitter, EFFECTS)
