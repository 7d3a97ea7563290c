"""The robot's own parameters with physical consistency: every link a body that can exist, no negative armature or friction.

    minimise  f(x) - mu ( sum over links log det J_l + sum log of armatures, dampings, dry frictions )

f: the regression with its prior, effects included; J_l: pseudo-inertia of link l less what is fixed to it, whose positive definiteness is
mass > 0, inertia > 0 and the triangle inequality. A convex problem; Newton steps along a path of mu that ends where the barrier
is worth less than a tenth of a unit of chi-square (a barrier of nu terms is nu mu from the optimum).
Sources: Wensing, Kim, Slotine, IEEE RA-L 3 (2018) 60; S. Boyd, L. Vandenberghe, Convex Optimization (2004), ch. 11.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnose.robot.problem import Problem
from diagnose.robot.solve import Solution
from mjsim.robot.inertia import SIZE, pseudo_inertia

__all__ = ["consistent", "physical"]

GAP = 0.1  # chi-square that the barrier may cost in all
LEAST = 1e-4  # of a link's nominal scale that a start is kept inside by
_BASIS = pseudo_inertia(np.eye(SIZE))


def consistent(problem: Problem, theta: np.ndarray) -> bool:
    """Whether all links are bodies that can exist, and no armature, damping or dry friction is negative."""
    links = theta[: len(problem.robot.links) * SIZE].reshape(-1, SIZE) - problem.robot.fixed
    return bool(np.all(np.linalg.eigvalsh(pseudo_inertia(links))[:, 0] > 0) and np.all(theta[links.size :] >= 0))


def physical(problem: Problem, s: Solution, weights: Mapping[int, float]) -> np.ndarray:
    """theta (P,) of least cost that is physically consistent, the coefficients of the effects kept.

    Returns the solution's own theta where that is consistent already.
    """
    if consistent(problem, s.theta):
        return s.theta
    P, robot = len(problem.names), problem.robot
    H, center = np.eye(P), (s.theta - problem.nominal) / problem.scale
    for j in problem.joints:
        H += weights[j] ** 2 * problem.grams[j][1]
    x = (_inside(problem) - problem.nominal) / problem.scale
    size = len(robot.links) * SIZE
    terms = 4 * len(robot.links) + P - size
    mu = 1e4 * GAP / terms
    while True:
        for _ in range(60):
            gradient, hessian = _barrier(problem, x)
            g = H @ (x - center) + mu * gradient
            step = -np.linalg.solve(H + mu * hessian, g)
            length = 1.0
            while not _feasible(problem, x + length * step):
                length *= 0.5
                if length < 1e-10:
                    break
            decrement = float(-g @ step)
            x = x + (0.95 if length < 1 else 1.0) * length * step
            if decrement < 1e-3 * GAP:
                break
        if mu * terms <= GAP:
            return problem.nominal + problem.scale * x
        mu /= 10.0


def _feasible(problem: Problem, x: np.ndarray) -> bool:
    return consistent(problem, problem.nominal + problem.scale * x) and bool(
        np.all((problem.nominal + problem.scale * x)[len(problem.robot.links) * SIZE :] > 0)
    )


def _inside(problem: Problem) -> np.ndarray:
    """A strictly consistent point: the nominal, with a small sphere in every link and no parameter of a joint at nought."""
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


def _barrier(problem: Problem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
    rest = np.arange(size, len(x))
    ratio = problem.scale[size:] / theta[size:]
    gradient[size:] = -ratio
    hessian[rest, rest] = ratio**2
    return gradient, hessian
