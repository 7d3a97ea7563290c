"""An empty loop on threads: what the machine has of a second core to give while a benchmark runs."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit

__all__ = ["spin_on"]


@njit(nogil=True)
def spin(n):
    x = 0.1
    for _ in range(n):
        x = x * 1.0000001 + 1e-9 * np.sin(x)
    return x


def spin_on(threads: int) -> None:
    """Eight equal pieces of work without memory or locks, on so many threads."""
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(spin, [10_000_000] * 8))
