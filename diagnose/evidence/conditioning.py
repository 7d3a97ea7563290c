"""How well the data determine the numbers of a fit: rank and condition of its Jacobian."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr

from diagnose.fit.fitted import Fitted
from diagnose.result import Conditioning
from diagnose.thresholds import ROUNDING

__all__ = ["conditioning", "conditioning_of"]


def conditioning(fitted: Fitted) -> Conditioning:
    """Of the rows of the data alone, without those of the prior."""
    J = fitted.fit.J[: len(fitted.fit.residual) - fitted.hypothesis.prior_terms[0]]
    return conditioning_of(J, [e.label for e in fitted.hypothesis.entries])


def conditioning_of(J: np.ndarray, labels: Sequence[str]) -> Conditioning:
    """Of a Jacobian or a regressor (N, P) with columns of length one; labels (P,): of the numbers.

    The rank is that of a QR factorisation with column pivoting, |R_ii| > ROUNDING |R_11| (G. H. Golub, C. F. Van Loan, Matrix
    Computations, section 5.4). A column of zeros stays as it is: the data do not depend on that number. The condition is infinite
    where the rank is not full.
    """
    lengths = np.linalg.norm(J, axis=0)
    if not J.size or not lengths.any():
        return Conditioning(len(labels), 0, math.inf, tuple(labels))
    J = J / np.where(lengths > 0, lengths, 1.0)
    R, pivot = qr(J, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.sum(diagonal > ROUNDING * diagonal[0]))
    singular = np.linalg.svd(R[: len(labels)], compute_uv=False)
    condition = float(singular[0] / singular[-1]) if rank == len(labels) else math.inf
    return Conditioning(len(labels), rank, condition, tuple(labels[i] for i in pivot[rank:]))
