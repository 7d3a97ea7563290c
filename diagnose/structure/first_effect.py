"""What one effect beside the nominal model promises to leave, before any is fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from diagnose.data.split import split
from diagnose.fit.usable import Usable
from diagnose.options import Options
from diagnose.progress import Progress
from diagnose.structure.passes import prepared
from mjsim.axis import Axis
from mjsim.recording import Recording

__all__ = ["least_by_one"]


def least_by_one(
    nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options,
    corrections: Mapping[str, np.ndarray],
) -> float:  # fmt: skip
    """Chi-square of the estimation data that the refitted nominal model leaves beside the effect of the largest score test.

    To first order in the amplitude. ``corrections`` and errors: as of `diagnose.pipeline.diagnose`.
    """
    usable = Usable.of(nominal, recordings, held_out, options)
    fitter = usable.fitter(split(usable.recordings, usable.held_out), options, corrections)
    try:
        with threadpool_limits(1, "blas"):
            search, base = prepared(fitter, options, Progress())
            move = search.moves.add(base)
    finally:
        fitter.close()
    gains = [] if move is None else [s.gain for _, s in move.neighbours if math.isfinite(s.gain)]
    return base.chi2 - max(gains, default=0.0)
