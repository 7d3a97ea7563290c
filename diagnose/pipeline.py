"""The whole flow: recording -> compare -> locate -> hypothesise -> fit -> validate -> decide -> result."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from diagnose.data.split import Split, split
from diagnose.evidence.predictable import remaining_structure
from diagnose.explain.locate import locate
from diagnose.explain.torque_map import fit_map
from diagnose.fit.fitter import Fitter
from diagnose.fit.ledger import Ledger
from diagnose.fit.usable import Usable
from diagnose.options import Options
from diagnose.progress import Progress, Step
from diagnose.result import Diagnosis, Verdict
from diagnose.structure.passes import searched
from diagnose.thresholds import RUNS, SECOND_SPLIT
from diagnose.verdict.assemble import diagnosis, unit_of
from diagnose.verdict.decide import decide, only_held_out_shows
from diagnose.verdict.determined import determined
from diagnose.verdict.findings import findings, merged
from diagnose.verdict.notes import DERIVED, SHARED, Outcome
from diagnose.verdict.witnesses import remaining_error, repeated_rows
from mjsim.axis import Axis
from mjsim.recording import Recording

__all__ = ["Options", "diagnose"]


def diagnose(
    nominal: Axis,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    options: Options | None = None,
    progress: Callable[[Step], None] = lambda _: None,
    ledger: Ledger | None = None,
    corrections: Mapping[str, np.ndarray] | None = None,
    surpassed: Callable[[Diagnosis], bool] | None = None,
) -> Diagnosis:
    """Diagnose recordings of one axis against its nominal model.

    ``progress`` is called with each `Step`; ``ledger``: where fits are written down as they are found, and looked up before they
    are made. ``corrections`` (N,): added to the measured velocity where motion is compared, by the SHA-256 (else source) of
    a recording. ``surpassed``: asked before a torque map is fitted, with the diagnosis without one; where another diagnosis is
    better, none is fitted. Raises InputError for recordings that cannot be used or a nominal model that cannot be run on them.
    """
    options, began = options or Options(), time.monotonic()
    usable = Usable.of(nominal, recordings, held_out, options)
    recordings, held_out = usable.recordings, usable.held_out
    taken = 0

    def by(experiments: Split, surpassed: Callable[[Diagnosis], bool] | None = None) -> Diagnosis:
        nonlocal taken
        fitter = usable.fitter(experiments, options, corrections or {}, ledger)
        fitter.allow(max(options.effort * RUNS - taken, SECOND_SPLIT * options.effort * RUNS), began + options.seconds)
        try:
            with threadpool_limits(1, "blas"):  # rivals are spread over the cores, not the products within one
                return _diagnose(fitter, options, Progress(progress), began, surpassed)
        finally:
            taken += fitter.runs
            fitter.close()

    result = by(split(recordings, held_out), surpassed)
    said = (*usable.said, *((DERIVED,) if usable.derived else ()))
    result = dataclasses.replace(result, notes=(*said, *result.notes))
    if held_out and options.since(began).seconds and only_held_out_shows(result):
        shared = by(split((*recordings, *held_out), ()))
        if shared.verdict is Verdict.MISSING_PHYSICS:
            return dataclasses.replace(shared, notes=(*said, SHARED, *shared.notes))
    return result


def _diagnose(
    fitter: Fitter, options: Options, progress: Progress, began: float, surpassed: Callable[[Diagnosis], bool] | None
) -> Diagnosis:
    progress.stage("compare", "refitting the nominal model")
    search, best, whitened = searched(fitter, options, progress)
    fitter, base = search.fitter, search.nominal()
    progress.stage("validate", "residual, intervals, rivals")
    best = search.polish(merged(search, best))
    best, undetermined = determined(search, fitter.refined(best))
    structure = remaining_structure(fitter, best)
    mismatches = locate(fitter, base)
    found = findings(search, best)
    remaining = remaining_error(search, base, best, structure, options)
    verdict = decide(search, base, best, remaining)
    rows = repeated_rows(fitter, best)
    outcome = Outcome(search, best, found, remaining, verdict, rows, whitened, False, unit_of(fitter), undetermined)
    if verdict is Verdict.UNEXPLAINED and surpassed is not None:
        unmapped = diagnosis(outcome, base, None, mismatches, options, began)
        if not only_held_out_shows(unmapped) and surpassed(unmapped):  # else it may be diagnosed again itself
            return unmapped
    mapped = fit_map(fitter, (base, best), search.held_out(best), progress) if verdict is Verdict.UNEXPLAINED else None
    return diagnosis(dataclasses.replace(outcome, mapped=mapped is not None), base, mapped, mismatches, options, began)
