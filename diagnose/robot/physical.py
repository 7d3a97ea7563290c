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

from diagnose.robot.linear import inverse_root, solved
from diagnose.robot.problem import Problem
from diagnose.robot.solve import Solution, normal, unpacked
from mjsim.robot.inertia import SIZE, pseudo_inertia

__all__ = ["consistent", "physical"]

GAP = 0.1  # chi-square that the barrier may cost in all
LEAST = 1e-4  # of a link's nominal scale that a start is kept inside by
# of a link's nominal scale: the wall of the barrier is so far inside that rounding (1e-16 of the parameters) leaves a body,
# and that no torque of a log shows it
MARGIN = 1e-9
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
    to_coefficients = solved(n.H[C, C], np.column_stack([n.H[C, :P], n.g[C]])) if len(n.g) > P else np.zeros((0, P + 1))
    H = n.H[:P, :P] - n.H[:P, C] @ to_coefficients[:, :P]
    g = n.g[:P] - n.H[:P, C] @ to_coefficients[:, P]
    x = ((_inside(problem) if start is None else start) - problem.nominal) / problem.scale
    x = np.where(n.free, x, n.fixed)
    if not _feasible(problem, x, n.free):  # a start at the wall
        x = np.where(n.free, (_inside(problem) - problem.nominal) / problem.scale, n.fixed)
    stiffness = np.zeros((P, P))
    terms = 4 * len(problem.robot.links) + int(n.free.sum()) - len(problem.robot.links) * SIZE
    mu = 1e3 * GAP / terms
    while True:
        for _ in range(50):
            gradient, hessian = _barrier(problem, x, n.free)
            slope, stiffness = (H @ x - g + mu * gradient)[n.free], mu * hessian
            step = np.zeros(P)
            step[n.free] = -solved((H + stiffness)[np.ix_(n.free, n.free)], slope)
            length = 1.0
            while not _feasible(problem, x + length * step, n.free) and length > 1e-10:
                length *= 0.5
            if length <= 1e-10:  # no step that stays inside: the optimum of this mu to rounding
                break
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
    size = len(problem.robot.links) * SIZE
    least = np.linalg.eigvalsh(pseudo_inertia(_within(problem, theta[:size])))[:, 0]
    return bool(np.all(least > 0) and np.all(theta[size:] > 0))


def _within(problem: Problem, links: np.ndarray) -> np.ndarray:
    """Parameters (L, 10) of links (10 L,) less what is fixed to them and less `MARGIN` of a sphere of each link's scale."""
    sphere = MARGIN * _spheres(problem)
    return np.asarray(links.reshape(-1, SIZE) - problem.robot.fixed - sphere)


def _spheres(problem: Problem) -> np.ndarray:
    """Parameters (L, 10) of a sphere at the origin of each link, of the scale of its mass and inertia."""
    scale = problem.scale[: len(problem.robot.links) * SIZE].reshape(-1, SIZE)
    out = np.zeros_like(scale)
    out[:, 0], out[:, 4:7] = scale[:, 0], 0.4 * scale[:, 4:5]
    return out


def _inside(problem: Problem) -> np.ndarray:
    """A strictly consistent point: the nominal, with a small sphere in every link and no parameter of a joint at zero."""
    size = len(problem.robot.links) * SIZE
    theta = problem.nominal.copy()
    links = theta[:size].reshape(-1, SIZE) - problem.robot.fixed
    for phi, sphere in zip(links, _spheres(problem), strict=True):
        share = LEAST
        while np.linalg.eigvalsh(pseudo_inertia(phi - MARGIN * sphere))[0] <= 0 or share == LEAST:
            phi += share * sphere
            share *= 2
    theta[:size] = (links + problem.robot.fixed).ravel()
    theta[size:] = np.maximum(theta[size:], LEAST * problem.scale[size:])
    return theta


def _barrier(problem: Problem, x: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (P,) and Hessian (P, P) of -sum log det J_l - sum log of the joints' parameters, in scaled x."""
    theta = problem.nominal + problem.scale * x
    size = len(problem.robot.links) * SIZE
    links = _within(problem, theta[:size])
    gradient, hessian = np.zeros(len(x)), np.zeros((len(x), len(x)))
    for at, phi in enumerate(links):
        own = slice(at * SIZE, (at + 1) * SIZE)
        W = inverse_root(pseudo_inertia(phi))  # J^-1 = W W'
        E = W.T @ (_BASIS * problem.scale[own, None, None]) @ W
        gradient[own] = -np.trace(E, axis1=1, axis2=2)
        flat = E.reshape(SIZE, -1)
        hessian[own, own] = flat @ flat.T  # tr(J^-1 B_a J^-1 B_b) as a Gram matrix, which rounding leaves positive semidefinite
    rest = size + np.flatnonzero(free[size:])
    ratio = problem.scale[rest] / theta[rest]
    gradient[rest] = -ratio
    hessian[rest, rest] = ratio**2
    return gradient, hessian
