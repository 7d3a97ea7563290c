"""Chains of more bodies than have code of their own: one compiled kernel for all lengths, which is exact for linear ones.

The first run on a machine compiles it (some 40 s of processor time).
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from mjsim import kernel
from mjsim.axis import Axis, Body, Chain, Coupling
from mjsim.ode import simulate
from mjsim.system import UNROLLED, assemble, state_matrix

DT = 1e-3


def chain(count: int) -> Axis:
    bodies = tuple(Body(f"b{i}", 0.1 * (i + 1), 0.05, f"joint{i}") for i in range(count))
    return Axis(Chain(bodies, tuple(Coupling(f"c{i}", 1.0, 200.0, 0.5, f"spring{i}") for i in range(1, count))))


def test_what_stands_for_the_bodies() -> None:
    assert assemble(chain(UNROLLED)).bodies == (0,) * UNROLLED
    longer = assemble(chain(UNROLLED + 1)).bodies
    assert isinstance(longer, np.ndarray)
    assert longer.shape == (UNROLLED + 1,)


@pytest.mark.parametrize("count", [UNROLLED + 1, UNROLLED + 2, 20])
def test_a_long_linear_chain_is_the_matrix_exponential(count: int) -> None:
    axis, steps = chain(count), 400
    torque = np.sin(2 * np.pi * (1.0 + 20.0 * DT * np.arange(steps)) * DT * np.arange(steps))
    simulate(chain(UNROLLED + 1), np.zeros(2), DT)
    compiled = len(kernel.integrate.signatures)
    run = simulate(axis, torque, DT)
    assert len(kernel.integrate.signatures) == compiled  # nothing more was compiled
    m = np.zeros((2 * count + 1, 2 * count + 1))
    m[: 2 * count, : 2 * count] = state_matrix(assemble(axis).f)
    m[count, 2 * count] = 1 / axis.chain.bodies[0].inertia
    phi = expm(m * DT)
    x, expected = np.zeros(2 * count), np.empty(steps)
    for i, value in enumerate(torque):
        expected[i] = x[count]
        x = phi[: 2 * count, : 2 * count] @ x + phi[: 2 * count, 2 * count] * value
    assert np.abs(run.velocity - expected).max() < 1e-10 * np.abs(expected).max()
