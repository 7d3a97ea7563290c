"""Linear algebra of a robot's regression: matrices that are positive definite only before rounding."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.robot.linear import inverse, inverse_root, solved

K = 8


def wall(strength: float) -> np.ndarray:
    """Prior and data of full rank, and a barrier's curvature of rank 2 next to its wall."""
    rng = np.random.default_rng(7)
    A, B = rng.standard_normal((40, K)), rng.standard_normal((2, K - 3))
    H = np.eye(K) + A.T @ A
    H[: K - 3, : K - 3] += strength * (B.T @ B)
    return H


@pytest.mark.parametrize("strength", [0.0, 1e3, 1e8])
def test_a_system_that_double_precision_holds_is_solved_exactly(strength):
    H, b = wall(strength), np.arange(1.0, K + 1)
    x = solved(H, b)
    assert np.allclose(H @ x, b, rtol=0, atol=1e-15 * np.linalg.cond(H) * np.linalg.norm(b) + 1e-12)
    assert np.allclose(inverse(H) @ b, x, rtol=1e-6, atol=1e-9)
    W = inverse_root(H)
    assert np.allclose(W.T @ H @ W, np.eye(K), atol=1e-15 * np.linalg.cond(H) + 1e-12)


@pytest.mark.parametrize("strength", [1e18, 1e22])
def test_a_matrix_that_rounding_makes_indefinite_has_a_finite_solution(strength):
    """Unknowns off the wall keep their solution; those at the wall do not move along its normal."""
    H, b = wall(strength), np.arange(1.0, K + 1)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(H)
    x, off = solved(H, b), slice(K - 3, K)
    assert np.all(np.isfinite(x))
    assert np.all(np.linalg.eigvalsh(inverse(H)) > -1e-12 * np.max(inverse(H)))
    at_wall = np.max(np.abs(x[: K - 3]))
    assert at_wall < 1.0
    # of the unknowns off the wall, with those at the wall as they are
    given = np.linalg.solve(H[off, off], b[off] - H[off, : K - 3] @ x[: K - 3])
    assert np.allclose(x[off], given, rtol=1e-3, atol=1e-3)


def test_an_unknown_that_nothing_determines_stays_at_zero():
    H = np.diag([4.0, 0.0, -1e-12])
    assert np.allclose(solved(H, np.array([2.0, 1.0, 1.0])), [0.5, 0.0, 0.0])


def test_no_unknown_gives_an_empty_solution():
    assert solved(np.zeros((0, 0)), np.zeros(0)).shape == (0,)
