"""Fitters of recordings of known truth."""

from __future__ import annotations

import pytest

from diagnose.data.experiment import prepare
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView


@pytest.fixture
def fitter_of(robot):
    """``fitter_of((estimation, held out))``: a fitter on one thread."""
    opened = []

    def make(recordings) -> Fitter:
        first, other = (prepare(r) for r in recordings)
        opened.append(Fitter(robot, MotionView(), (first,), (other,), 1))
        return opened[-1]

    yield make
    for fitter in opened:
        fitter.close()
