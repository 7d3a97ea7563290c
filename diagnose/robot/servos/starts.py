"""The file's own numbers at a servo joint that are free, and the fit of them without effects."""

from __future__ import annotations

import math

import numpy as np

from diagnose.robot.servos.fit import Fit, Number, block_loss, block_scale, block_weights, counted, fit
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.state import QUICK
from mjsim.robot.joint_kernel import SLOT

__all__ = ["THIN", "own_numbers", "regressed", "start_fit"]

THIN = 4000  # samples on which starts are compared and finalists fitted first
INERTIA_PRIOR = math.log(3.0)  # of the armature's logarithm: a rotor's inertia is known to a factor of three
GAIN_PRIOR = math.log(30.0)  # of the logarithm of a gain, or of dry friction: the file may be far off, but not by any factor
FAR = (1.0, 0.3, 0.1, 0.03, 0.01)  # gains over those of the file, from which the fit without effects starts


def own_numbers(problem: JointProblem) -> tuple[Number, ...]:
    """The file's own numbers that are free: gains, sum of kv and damping, armature, zero, and the dry friction that it has."""
    p = problem.nominal
    prior = (
        (math.log(p[SLOT["armature"]]), INERTIA_PRIOR)
        if p[SLOT["armature"]] > 0
        else (math.log(_links(problem)), 2 * INERTIA_PRIOR)
    )
    inertia = Number("armature", prior=prior)

    def gain(slot: str, value: float, most: float) -> Number:
        known = (math.log(value), GAIN_PRIOR) if value > 0 else None
        return Number(slot, upper=max(most, 2.0 * value), prior=known)

    # of a servo that is faster than the samples the data show no more than that
    inertia_sum, fastest = float(p[SLOT["armature"]]) + _links(problem), 2 * math.pi / problem.dt
    if problem.drive.velocity:
        kv = gain("kv", float(p[SLOT["kv"]]), inertia_sum * fastest)
        numbers = [kv, inertia, *([Number("damping")] if p[SLOT["damping"]] > 0 else [])]
    else:
        damp = gain("damp", float(p[SLOT["kv"]] + p[SLOT["damping"]]), inertia_sum * fastest)
        numbers = [
            gain("kp", float(p[SLOT["kp"]]), inertia_sum * fastest**2),
            damp,
            inertia,
            Number("zero", False, 0.01 * float(np.ptp(problem.angle)) + 1e-12),
        ]
    if p[SLOT["integral"]] > 0.0:
        numbers.append(Number("integral", prior=(math.log(p[SLOT["integral"]]), GAIN_PRIOR)))
    loss = float(p[SLOT["friction"]])
    return (*numbers, *([Number("friction", prior=(math.log(loss), GAIN_PRIOR))] if loss > 0 else []))


def _links(problem: JointProblem) -> float:
    """Mean inertia of the links that the joint carries."""
    return float(np.mean(problem.series[:, 0]))


def start_fit(problem: JointProblem, numbers: tuple[Number, ...]) -> Fit:
    """The fit without effects, in the weights of its own errors: the best of starts at the file, at softer gains and at a
    regression.

    The starts are compared by the loss that `block_weights` stands for, at one scale.
    """
    part = problem.windows(THIN)
    tried = [_begun(problem, part, numbers, s) for s in _starts(problem, numbers)]
    errors = [part.error(x.slots) for x in tried]
    scale = min(block_scale(part, e) for e in errors)
    best = min(zip((block_loss(part, e, scale) for e in errors), tried, strict=True), key=lambda x: x[0])[1]
    for _ in range(2):
        best = fit(problem, numbers, best.slots, block_weights(problem, best.error))
    return counted(problem, best, block_weights(problem, best.error))


def _begun(problem: JointProblem, part: JointProblem, numbers: tuple[Number, ...], start: np.ndarray) -> Fit:
    """A quick fit of a part from slots (K,), in equal weights first and then in those of its own errors."""
    weights = np.full(len(problem.angle), 1.0 / max(float(np.std(problem.angle)), problem.noise, 1e-12))
    for _ in range(2):
        found = fit(problem, numbers, start, weights, QUICK, part)
        start, weights = found.slots, block_weights(problem, found.error)
    return found


def _starts(problem: JointProblem, numbers: tuple[Number, ...]) -> list[np.ndarray]:
    """Slots (K,) from which the fit without effects starts."""
    p = problem.nominal
    found = regressed(problem, "friction" in {n.slot for n in numbers})
    starts = [] if found is None else [found]
    for factor in FAR:
        s = p.copy()
        for name in ("kp", "kv", "damping", "friction"):
            s[SLOT[name]] *= factor if name in ("kp", "friction") else math.sqrt(factor)
        if s[SLOT["armature"]] <= 0:
            s[SLOT["armature"]] = 0.1 * _links(problem)
        if not problem.drive.velocity and s[SLOT["kv"]] + s[SLOT["damping"]] <= 0:
            s[SLOT["kv"]] = 0.02 * s[SLOT["kp"]]
        starts.append(s)
    return starts


def regressed(problem: JointProblem, friction: bool) -> np.ndarray | None:
    """Slots (K,) by a regression at the samples in motion, None where it gives no gains.

        target - q = (tau + armature q'' + damp q' + F sign q') / kp + zero

    tau: what the links need. Errors are those of the command and the position at one instant, so that it is a start and no
    answer.
    """
    if problem.drive.velocity:
        return None
    tau, q, v = problem.series[:, 4], problem.series[:, 5], problem.series[:, 6]
    a = np.gradient(v, problem.dt)
    keep = problem.fitted & (np.abs(v) > 0.1 * np.sqrt(np.mean(v**2)))
    columns = [tau, v, a, np.ones_like(v), *([np.sign(v)] if friction else [])]
    C = np.column_stack(columns)[keep]
    size = np.sqrt(np.mean(C**2, axis=0)) + 1e-12
    c = np.linalg.lstsq(C / size, (problem.first - q)[keep], rcond=1e-6)[0] / size
    p = problem.nominal.copy()
    if c[0] <= 0 or c[1] <= 0:
        return None
    kp = 1.0 / c[0]
    damp = kp * c[1]
    p[SLOT["kp"]], p[SLOT["armature"]] = kp, max(kp * c[2], 0.3 * p[SLOT["armature"]], 1e-3 * _links(problem))
    p[SLOT["damping"]] = min(p[SLOT["damping"]], damp)
    p[SLOT["kv"]], p[SLOT["zero"]] = damp - p[SLOT["damping"]], c[3]
    if friction:
        p[SLOT["friction"]] = max(kp * c[4], 1e-3 * kp * float(np.std(problem.first - q)))
    return p
