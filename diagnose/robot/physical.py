"""The solution with physical consistency: every link a body that can exist, no negative armature or friction.

    minimise  f(x) - mu ( sum over links log det J_l + sum log of armatures, dampings, dry frictions )

f: the regression with its prior, its least over the effects' coefficients; J_l: pseudo-inertia of link l less what is fixed
to it, whose positive definiteness is
mass > 0, inertia > 0 and the triangle inequality. A convex problem; Newton steps along a path of mu that ends where the barrier
is worth less than a tenth of a unit of chi-square (a barrier of nu terms is nu mu from the optimum).
Sources: Wensing, Kim, Slotine, IEEE RA-L 3 (2018) 60; S. Boyd, L. Vandenberghe, Convex Optimization (2004), ch. 11.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnose.robot.problem import Problem
from diagnose.robot.solve import Solution, normal, unpacked
from mjsim.robot.inertia import SIZE, pseudo_inertia

__all__ = ["consistent", "physical"]

GAP = 0.1  # chi-square that the barrier may cost in all
LEAST = 1e-4  # of a link's nominal scale that a start is kept inside by
_BASIS = pseudo_inertia(np.eye(SIZE))


def consistent(problem: Problem, theta: np.ndarray) -> bool:
    """Whether all links are bodies that can exist, and no armature, damping or dry friction is negative."""
    links = theta[: len(problem.robot.links) * SIZE].reshape(-1, SIZE) - problem.robot.fixed
    return bool(np.all(np.linalg.eigvalsh(pseudo_inertia(links))[:, 0] > 0) and np.all(theta[links.size :] >= 0))


def physical(problem: Problem, s: Solution, weights: Mapping[int, float], start: np.ndarray | None = None) -> Solution:
    """The physically consistent solution of least cost with the same terms; the solution itself where it is consistent.

    start (P,): a strictly consistent theta to begin at, by default one next to the nominal.
    """
    n = normal(problem, s.terms, weights, s.columns)
    P = len(problem.names)
    theta = np.where(n.free, s.theta, 1.0)  # what has given way is neither free nor bound
    if consistent(problem, theta):
        return s
    C = slice(P, len(n.g))
    to_coefficients = np.linalg.solve(n.H[C, C], np.column_stack([n.H[C, :P], n.g[C]])) if len(n.g) > P else np.zeros((0, P + 1))
    H = n.H[:P, :P] - n.H[:P, C] @ to_coefficients[:, :P]
    g = n.g[:P] - n.H[:P, C] @ to_coefficients[:, P]
    x = ((_inside(problem) if start is None else start) - problem.nominal) / problem.scale
    x = np.where(n.free, x, n.fixed)
    stiffness = np.zeros((P, P))
    terms = 4 * len(problem.robot.links) + int(n.free.sum()) - len(problem.robot.links) * SIZE
    mu = 1e3 * GAP / terms
    while True:
        for _ in range(50):
            gradient, hessian = _barrier(problem, x, n.free)
            slope, stiffness = (H @ x - g + mu * gradient)[n.free], mu * hessian
            step = np.zeros(P)
            step[n.free] = -np.linalg.solve((H + stiffness)[np.ix_(n.free, n.free)], slope)
            length = 1.0
            while not _feasible(problem, x + length * step, n.free) and length > 1e-10:
                length *= 0.5
            x = x + (0.95 if length < 1 else 1.0) * length * step
            if float(-slope @ step[n.free]) < 1e-2 * GAP:
                break
        if mu * terms <= GAP:
            break
        mu /= 30.0
    full = np.concatenate([x, to_coefficients[:, P] - to_coefficients[:, :P] @ x])
    return unpacked(problem, s.terms, n, full, stiffness)


def _feasible(problem: Problem, x: np.ndarray, free: np.ndarray) -> bool:
    theta = np.where(free, problem.nominal + problem.scale * x, 1.0)
    return consistent(problem, theta) and bool(np.all(theta[len(problem.robot.links) * SIZE :] > 0))


def _inside(problem: Problem) -> np.ndarray:
    """A strictly consistent point: the nominal, with a small sphere in every link and no parameter of a joint at zero."""
    size = len(problem.robot.links) * SIZE
    theta = problem.nominal.copy()
    links = theta[:size].reshape(-1, SIZE) - problem.robot.fixed
    scale = problem.scale[:size].reshape(-1, SIZE)
    for phi, s in zip(links, scale, strict=True):
        share = LEAST
        while np.linalg.eigvalsh(pseudo_inertia(phi))[0] <= 0 or share == LEAST:
            phi += share * np.array([s[0], 0, 0, 0, *[0.4 * s[4]] * 3, 0, 0, 0])
            share *= 2
    theta[:size] = (links + problem.robot.fixed).ravel()
    theta[size:] = np.maximum(theta[size:], LEAST * problem.scale[size:])
    return theta


def _barrier(problem: Problem, x: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (P,) and Hessian (P, P) of -sum log det J_l - sum log of the joints' parameters, in scaled x."""
    theta = problem.nominal + problem.scale * x
    size = len(problem.robot.links) * SIZE
    links = theta[:size].reshape(-1, SIZE) - problem.robot.fixed
    gradient, hessian = np.zeros(len(x)), np.zeros((len(x), len(x)))
    for at, phi in enumerate(links):
        own = slice(at * SIZE, (at + 1) * SIZE)
        inverse = np.linalg.inv(pseudo_inertia(phi))
        E = inverse @ (_BASIS * problem.scale[own, None, None])
        gradient[own] = -np.trace(E, axis1=1, axis2=2)
        hessian[own, own] = np.einsum("aij,bji->ab", E, E)
    rest = size + np.flatnonzero(free[size:])
    ratio = problem.scale[rest] / theta[rest]
    gradient[rest] = -ratio
    hessian[rest, rest] = ratio**2
    return gradient, hessian
