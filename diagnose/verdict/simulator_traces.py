"""Signals of the files as MuJoCo steps them, for the plots of a report."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from diagnose.result import Traces
from diagnose.verdict.reference import Case, Run, judged

__all__ = ["with_runs"]


def with_runs(
    traces: Sequence[Traces], cases: Sequence[Case], nominal: Sequence[Run | None], corrected: Sequence[Run | None]
) -> tuple[Traces, ...]:
    """The traces with the nominal and the corrected signals of MuJoCo's runs, where these are on the same samples.

    A file that diverges has no nominal signal, and keeps the corrected one of the fitting engine.
    """
    runs = {c.recording.source: (c, a, b) for c, a, b in zip(cases, nominal, corrected or [None] * len(cases), strict=True)}

    def by_simulator(t: Traces) -> Traces:
        case, given, mended = runs.get(t.source, (None, None, None))
        if case is None or len(case.measured) != len(t.time):
            return t
        first = None if given is None else np.asarray(judged(case, given))
        second = t.corrected if mended is None else np.asarray(judged(case, mended))
        return dataclasses.replace(t, nominal=first, corrected=second)

    return tuple(map(by_simulator, traces))
