"""How well the data determine the numbers of a fit: rank and condition of its Jacobian."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import qr

from diagnose.fit.fitted import Fitted
from diagnose.result import Conditioning
from diagnose.thresholds import ROUNDING

__all__ = ["conditioning"]


def conditioning(fitted: Fitted) -> Conditioning:
    """Of the rows of the data alone, without those of the prior, and columns of length one.

    The rank is that of a QR factorisation with column pivoting, |R_ii| > ROUNDING |R_11| (G. H. Golub, C. F. Van Loan, Matrix
    Computations, section 5.4). A column of zeros stays as it is: the data do not depend on that number. The condition is infinite
    where the rank is not full.
    """
    entries = fitted.hypothesis.entries
    J = fitted.fit.J[: len(fitted.fit.residual) - fitted.hypothesis.prior_terms[0]]
    lengths = np.linalg.norm(J, axis=0)
    if not J.size or not lengths.any():
        return Conditioning(len(entries), 0, math.inf, tuple(e.label for e in entries))
    J = J / np.where(lengths > 0, lengths, 1.0)
    R, pivot = qr(J, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.sum(diagonal > ROUNDING * diagonal[0]))
    singular = np.linalg.svd(R[: len(entries)], compute_uv=False)
    condition = float(singular[0] / singular[-1]) if rank == len(entries) else math.inf
    return Conditioning(len(entries), rank, condition, tuple(entries[i].label for i in pivot[rank:]))
