"""Joint flexibility from torque against motor motion: a spring between the motor, whose angle is logged, and its link.

    tau_j = rotor theta_j'' + friction of the motor + s_j          s_j = k_j (theta_j - q_j) = torque of the links along q

The links move as q_j = theta_j - c_j s_j, with c_j = 1 / k_j. The motor's rotor and friction keep the logged motion. A compliance
changes the rows of all joints, by gravity, inertia and the second derivative of s_j (1 % of s_j where the motion is ten times as
slow as the joint). Its size is found by Gauss-Newton steps, the links' motion computed anew in each.
Source: M. W. Spong, J. Dyn. Syst. Meas. Control 109 (1987) 310.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.evidence.held_out import compare
from diagnose.result import Estimate
from diagnose.robot.laws import FLEXIBLE
from diagnose.robot.linear import solved
from diagnose.robot.motion import OVERSAMPLING, RobotMotion, derivative
from diagnose.robot.options import RobotOptions
from diagnose.robot.problem import Problem
from diagnose.robot.result import RobotFinding
from diagnose.robot.select import select
from diagnose.robot.solve import Solution, held_out, solve, told_apart, weigh, worth
from diagnose.robot.state import Selection
from mjsim.robot.model import Robot
from mjsim.robot.rows import link_rows

__all__ = ["Elastic", "deflected", "elastic", "flexible_findings"]

STEP = 1e-3  # of the differences: a deflection over the travel of the joint
ROUNDS = 4  # Gauss-Newton steps
SETTLED = 0.01  # relative change of a compliance below which no further step is made
PASSES = 5  # of the deflection, each of which errs by (w / w0)^2 of the error before; w0: of the joint, w: of the motion
SENTENCE = "The joint is flexible: its link follows the motor over a spring."

ORDER, STANDS_OUT = 4, 4.0  # of the low-pass of a torque; power over that of noise up to which it is kept, as of servo positions

Build = Callable[[Sequence[RobotMotion]], Problem]


@dataclass(frozen=True, eq=False)
class Elastic:
    """A search with flexible joints: their compliances [rad/Nm | m/N] by joint, variances, and the rigid search before."""

    search: Selection
    compliance: Mapping[int, float]
    variance: Mapping[int, float]
    rigid: Selection


def deflected(robot: Robot, motion: RobotMotion, compliance: Mapping[int, float], links: np.ndarray) -> RobotMotion:
    """The motion with that of the links behind flexible joints; links (L, 10): inertial parameters."""
    if not compliance:
        return dataclasses.replace(motion, link=None)
    z, dz, ddz = motion.z, motion.dz, motion.ddz
    for _ in range(PASSES):
        s = np.einsum("nmlk,lk->nm", link_rows(robot, z, dz, ddz), links)
        bend = np.zeros_like(z)
        for j, c in compliance.items():
            bend[:, j] = c * _smooth(s[:, j], motion.dt)
        z, dz = motion.z - bend, motion.dz - derivative(bend, motion.dt)
        ddz = motion.ddz - derivative(bend, motion.dt, second=True)
    return dataclasses.replace(motion, link=(z, dz, ddz))


def _smooth(s: np.ndarray, dt: float) -> np.ndarray:
    """A torque (N,) of the links behind a zero-phase low-pass at the highest frequency at which it stands out of encoder noise.

    White noise of an angle makes a torque of a power A f^4, of which A is read off the upper half of the band that the motion
    has. Two derivatives of the torque would make that noise larger than the torque.
    """
    from scipy.signal import butter, sosfiltfilt, welch

    f, power = welch(s, 1 / dt, nperseg=min(len(s), 1024), detrend="linear")
    band = (f > 0) & (f < 1.0 / (OVERSAMPLING * dt))
    f, power = f[band], power[band]
    noise = float(np.median(power[len(f) // 2 :] / f[len(f) // 2 :] ** 4))
    drowned = np.flatnonzero(power < STANDS_OUT * noise * f**4)
    cutoff = float(f[max(int(drowned[0]), 1)]) if len(drowned) else float(f[-1])
    return np.asarray(sosfiltfilt(butter(ORDER, 2 * cutoff * dt, output="sos"), s))


def elastic(robot: Robot, motions: Sequence[RobotMotion], rigid: Selection, options: RobotOptions, build: Build) -> Elastic:
    """The search with those joints flexible that the torques of all joints show so; build: the regression of motions."""
    best = Elastic(rigid, {}, {}, rigid)
    if options.late or (options.effects and FLEXIBLE not in options.effects):
        return best
    start = rigid.physical(solve(rigid.problem, (), rigid.weights, rigid.rows)) if rigid.solution.terms else rigid.solution
    for begun in (rigid.solution, start) if rigid.solution.terms else (rigid.solution,):
        found = _one_after_other(robot, motions, rigid, begun, build)
        if not found:
            continue
        problem, theta = _fitted_last(robot, motions, rigid, found, build, begun)
        again = select(problem, options)
        trial = Elastic(again, found, _variance(robot, motions, again, found, build, theta), rigid)
        if _total(best.search, again) - rigid.price * (len(found) - len(best.compliance)) > 0.0:
            best = trial
    return best


def _moved(
    robot: Robot, motions: Sequence[RobotMotion], compliance: Mapping[int, float], theta: np.ndarray, build: Build
) -> Problem:
    shape = robot.nominal.shape
    links = theta[: robot.nominal.size].reshape(shape)
    return build([deflected(robot, m, compliance, links) for m in motions])


def _solved(problem: Problem, like: Selection, terms: Solution) -> tuple[Selection, Solution]:
    """The terms of a solution fitted to another problem, in weights of its own residuals."""
    rows = problem.rows(terms.theta)
    weights, solution = weigh(problem, terms.terms, rows)
    s = dataclasses.replace(like, problem=problem, rows=rows, weights=weights, cache={}, solution=solution)
    return s, s.physical(solution)


def _one_after_other(
    robot: Robot, motions: Sequence[RobotMotion], rigid: Selection, begun: Solution, build: Build
) -> dict[int, float]:
    """Compliances that enter one by one while all rows together show them."""
    compliance: dict[int, float] = {}
    s, now = rigid, begun
    while len(compliance) < len(rigid.problem.joints):
        gains = {j: _slope(robot, motions, s, now, compliance, j, build) for j in rigid.problem.joints if j not in compliance}
        j = max(gains, key=lambda k: gains[k][0])
        if gains[j][0] < _entry(rigid):
            break
        trial, (last, solution) = _descended(robot, motions, s, now, compliance, j, build)
        if trial[j] <= 0.0 or not _passes(s, now, solution):
            break
        compliance, s, now = trial, last, solution
    return compliance


def _entry(s: Selection) -> float:
    """Extended BIC: price of one number and 2 log of the number of (joint, law), flexibility among them."""
    return s.price + 2.0 * math.log(s.candidates + len(s.problem.joints))


def _slope(
    robot: Robot, motions: Sequence[RobotMotion], s: Selection, now: Solution, compliance: Mapping[int, float], joint: int,
    build: Build
) -> tuple[float, float, float]:  # fmt: skip
    """(what the weighted squares lose, step of the compliance that loses it, its variance), to first order, all else free."""
    p, theta = s.problem, now.theta
    torque = float(np.std(np.concatenate([p.fitted[joint].measured]))) + 1e-300
    travel = float(np.max([np.ptp(m.z[:, joint]) for m in motions]))
    h = STEP * travel / torque
    moved = _moved(robot, motions, {**compliance, joint: compliance.get(joint, 0.0) + h}, theta, build)
    P = len(p.names)
    H, g = np.zeros((P + 1, P + 1)), np.zeros(P + 1)
    H[np.arange(P), np.arange(P)] = 1.0
    if now.stiffness is not None:
        H[:P, :P] += now.stiffness
    for j in p.joints:
        own = [now.columns[i][0] for i, t in enumerate(now.terms) if t.joint == j]
        B = np.hstack([p.fitted[j].A * p.scale, (moved.fitted[j].A - p.fitted[j].A) @ theta[:, None] / h])
        e, w2 = now.fitted[j], s.weights[j] ** 2
        if own:  # the columns of effects are projected out
            C = np.hstack(own)
            Q = np.linalg.qr(C / (np.sqrt(np.mean(C**2, axis=0)) + 1e-300))[0]
            B, e = B - Q @ (Q.T @ B), e - Q @ (Q.T @ e)
        H += w2 * (B.T @ B)
        g += w2 * (B.T @ e)
    beside = solved(H[:P, :P], np.column_stack([H[:P, P], g[:P]]))
    information = float(H[P, P] - H[P, :P] @ beside[:, 0])
    slope = float(g[P] - H[P, :P] @ beside[:, 1])
    if information <= 1e-9 * H[P, P]:
        return 0.0, 0.0, math.inf
    step = slope / information
    return (slope * step if step + compliance.get(joint, 0.0) > 0.0 else 0.0), step, 1.0 / information


def _descended(
    robot: Robot, motions: Sequence[RobotMotion], s: Selection, now: Solution, compliance: Mapping[int, float], joint: int,
    build: Build
) -> tuple[dict[int, float], tuple[Selection, Solution]]:  # fmt: skip
    """Gauss-Newton steps of all compliances, one after the other, ``joint`` first."""
    found = {**compliance, joint: 0.0}
    order = [joint, *compliance]
    for _ in range(ROUNDS):
        largest = 0.0
        for j in order:
            _, step, _ = _slope(robot, motions, s, now, found, j, build)
            largest = max(largest, abs(step) / (abs(found[j] + step) + 1e-300))
            found[j] = max(found[j] + step, 0.0)
            s, now = _solved(_moved(robot, motions, found, now.theta, build), s, now)
        if largest < SETTLED:
            break
    return found, (s, now)


def _passes(s: Selection, before: Solution, after: Solution) -> bool:
    """Whether all rows together pass what an effect must pass to enter where fitted, and one row where held out."""
    if s.raw_gain(before, after) < _entry(s):
        return False
    tests = []
    for j in s.problem.joints:
        share = told_apart(s.problem, before, after, j)
        tests.append(compare(*(held_out(s.problem, x, s.weights, j, share) for x in (before, after))))
    n = len(s.problem.joints) * (s.hypotheses + len(s.problem.joints))  # rows that may show each of them
    return any(t.relative_gain > s.options.material and min(1.0, 2.0 * t.p_value * n) < s.options.p_enter for t in tests)


def _total(before: Selection, after: Selection) -> float:
    """Gain of one search over another on fitted and held-out samples, less the price of its effects."""
    a, b = before.solution, after.solution
    held = sum(before.held_gain(a, b, j) for j in before.problem.joints)
    return before.raw_gain(a, b) + held - (before.charge(b.terms) - before.charge(a.terms))


def _fitted_last(
    robot: Robot, motions: Sequence[RobotMotion], rigid: Selection, compliance: Mapping[int, float], build: Build, begun: Solution
) -> tuple[Problem, np.ndarray]:
    """The regression under these compliances, and the parameters with which the deflection is computed."""
    problem = _moved(robot, motions, compliance, begun.theta, build)
    _, now = _solved(problem, rigid, begun)
    return _moved(robot, motions, compliance, now.theta, build), now.theta


def _variance(
    robot: Robot, motions: Sequence[RobotMotion], s: Selection, compliance: Mapping[int, float], build: Build, theta: np.ndarray
) -> dict[int, float]:
    """Variance of each compliance, all else free."""
    return {j: _slope(robot, motions, s, s.solution, compliance, j, build)[2] for j in compliance}


def flexible_findings(e: Elastic) -> dict[int, list[RobotFinding]]:
    """A finding for each flexible joint, with the interval of its stiffness and what it takes off the held-out error."""
    out: dict[int, list[RobotFinding]] = {}
    robot = e.search.problem.robot
    for j, c in e.compliance.items():
        half = 1.96 * math.sqrt(e.variance[j]) / c  # of the logarithm
        value = Estimate(
            1.0 / c, (math.exp(-half) / c, math.exp(half) / c), "N m/rad" if robot.motions[j].value == "hinge" else "N/m"
        )
        a, b = e.rigid.solution, e.search.solution
        share = worth(e.rigid.problem, j, a.fitted[j] - b.fitted[j], b.fitted[j])
        before, after = (held_out(e.rigid.problem, x, e.search.weights, j, share) for x in (a, b))
        n = float(e.search.hypotheses + len(e.search.problem.joints))
        evidence = {
            "held_out_error_before": before.rms, "held_out_error_after": after.rms,
            "p_value": min(1.0, n * compare(before, after).p_value), "delta_chi2": e.rigid.raw_gain(a, b), "hypotheses": n,
        }  # fmt: skip
        name = robot.joints[j]
        out[j] = [RobotFinding(FLEXIBLE, name, name, SENTENCE, {"stiffness_Nm_rad": value}, evidence, ())]
    return out
