"""Physics outside the library, as a map: a smooth torque over one or two state variables that lowers the held-out error.

Where the verdict is ``unexplained``, maps at every place of the chain and over every one and two of its variables are screened:
the response of the judged channel to each spline, through the fitted linear axis, and a penalised regression of the residual on
them. The best few are fitted in the model itself, by Gauss-Newton, together with all its numbers:

    minimise |r(x, c)|^2 + lambda |S c|^2,        S: second differences of the coefficients along each variable

lambda and the choice of the map are made by cross-validation over stretches of the estimation data. What the model's own numbers
could say as well (viscous friction, stiffness, an offset that was found) is taken out of the map and left to them, since only
their sum is determined. The one that is best there must then pay on held-out data, or none is given. Its bands are those of a
smoothing spline (G. Wahba, J. R. Stat. Soc. B 45 (1983) 133), widened by the correlation of the residual.
See docs/decisions/torque-map.md.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from diagnose.data.experiment import Experiment, middle
from diagnose.evidence.held_out import compare
from diagnose.evidence.intervals import half_width
from diagnose.evidence.orders import torque_to_velocity
from diagnose.explain.map_regression import Regression, Solution, roughness, solve
from diagnose.explain.map_shapes import shapes, variables, words
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit, Linearised, Status, jacobian, levenberg_marquardt
from diagnose.fit.whiten import effective_share
from diagnose.problem.hypothesis import Hypothesis
from diagnose.problem.problem import bounded
from diagnose.progress import Progress
from diagnose.result import MapResult, MapVariable
from diagnose.thresholds import ALPHA, BLOCKS, FOLDS, LEADING, LEAST_SAMPLES, MATERIAL, SAME, SMALL
from mjsim.axis import Axis
from mjsim.quantity import Quantity
from mjsim.signals import lfilter
from mjsim.torque_map import VARIABLES, TorqueMap

__all__ = ["Mapped", "fit_map"]


@dataclass(frozen=True)
class Mapped:
    """A map that lowers the held-out error significantly: the fitted model with it, and its result."""

    fitted: Fitted
    held_out: HeldOut
    result: MapResult


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A map without numbers, the model that it is laid on, and what the screen says of it; cost: cross-validated chi-square."""

    start: Fitted
    shape: TorqueMap
    solution: Solution

    @property
    def cost(self) -> float:
        return self.solution.cost * self.start.chi2


@dataclass(frozen=True, eq=False)
class _Refined:
    """A map fitted in the model; problem: the regression at it; cost: cross-validated chi-square there."""

    fitted: Fitted
    shape: TorqueMap
    solution: Solution
    problem: Regression
    cost: float


def fit_map(fitter: Fitter, starts: Sequence[Fitted], before: HeldOut | None, progress: Progress | None = None) -> Mapped | None:
    """The map that lowers the held-out error significantly, or None.

    ``starts``: models that it may be laid on, the refitted nominal one and the best that was found (named effects may have stood
    in for what is mapped); ``before``: what it must beat. None is sought once the budget of time is used up.
    """
    if before is None or fitter.late or any(isinstance(e, TorqueMap) for e in fitter.nominal.effects):
        return None
    progress = progress or Progress()
    progress.stage("map", "the residual, over each state variable")
    ranked = sorted((c for f in {f.key: f for f in starts}.values() for c in _screen(fitter, f)), key=lambda c: c.cost)
    tried: list[_Refined] = []
    until = fitter.runs + 0.1 * fitter.most_runs  # a small part of what the search may take
    for candidate in ranked[:LEADING]:
        if fitter.runs > until:
            break
        progress.stage("map", f"fitting one {words(candidate.shape)}")
        refined = _refine(fitter, candidate, until)
        if refined is not None:
            tried.append(refined)
    for t in sorted(tried, key=lambda t: t.cost):
        after = fitter.validate(t.fitted)
        gain = compare(before, after)
        p_value = min(1.0, gain.p_value * len(tried))
        if after is not None and gain.relative_gain > MATERIAL and p_value < ALPHA:
            return Mapped(t.fitted, after, _result(fitter, t, before, after, p_value))
    return None


def _folds(fitter: Fitter, size: int) -> np.ndarray:
    """Fold of each row of a residual vector: stretches of the recordings in turn; the prior's rows belong to none."""
    parts = []
    for experiment in fitter.experiments:
        _, keep = fitter.whitened(np.zeros(len(fitter.counted(experiment))), experiment)
        at = np.arange(len(keep)) * BLOCKS // len(keep) % FOLDS
        parts.append(at[keep])
    fold = np.concatenate(parts)
    return np.concatenate([fold, np.full(size - len(fold), -1)])


def _screen(fitter: Fitter, best: Fitted) -> list[_Candidate]:
    """All maps by their cross-validated cost on the linearised model, the simpler ones before what gains little on them."""
    known = variables(fitter, best)
    if known is None:
        return []
    fold = _folds(fitter, len(best.fit.residual))
    respond = _Responses(fitter, best)
    # which map is worth a fit so many rows tell; all of the prior's
    own = best.hypothesis.prior_terms[0]
    samples = len(fold) - own
    rows = np.concatenate([np.arange(0, samples, max(1, samples // LEAST_SAMPLES)), np.arange(samples, len(fold))])
    r, J, fold = best.fit.residual[rows], best.fit.J[rows], fold[rows]
    left = float(r @ r)

    def judged(shape: TorqueMap) -> _Candidate | None:
        D = respond.of(shape, known)[rows]
        if not bounded(D).all():
            return None
        problem = Regression(r, np.zeros(D.shape[1]), J, D, roughness(shape), fold)
        return _Candidate(best, shape, solve(problem, left))

    found = [c for c in fitter.map([partial(judged, shape) for shape in shapes(known)]) if c is not None]
    found.sort(key=lambda c: c.solution.cost)
    found = [c for c in found if c.solution.cost < 1 - MATERIAL]
    single = min((c.solution.cost for c in found if len(c.shape.axes) == 1), default=math.inf)
    return [c for c in found if len(c.shape.axes) == 1 or c.solution.cost < (1 - SMALL) * single]


class _Responses:
    """Responses of the residual vector to the splines of a map, through the fitted linear axis."""

    def __init__(self, fitter: Fitter, best: Fitted) -> None:
        self.fitter, self.best = fitter, best
        self.filters: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}

    def _through(self, axis: Axis, r: int, experiment: Experiment, body: int, torque: np.ndarray) -> np.ndarray:
        """Velocity of body 0 (N, k) that torques (N, k) on a body make; no number where it leaves all bounds."""
        if (r, body) not in self.filters:
            recording = experiment.recording
            self.filters[(r, body)] = torque_to_velocity(
                axis, recording.dt, body, middle(recording), by_velocity=recording.angle is None
            )
        response = lfilter(*self.filters[(r, body)], torque)
        return np.where(bounded(response), response, np.nan)

    def of(self, shape: TorqueMap, known: list[dict[tuple[str, bool, str], np.ndarray]]) -> np.ndarray:
        """(N, k), in the residual's units and rows."""
        fitter, chain = self.fitter, self.fitter.nominal.chain
        parts = []
        for r, experiment in enumerate(fitter.experiments):
            axis = self.best.hypothesis.axis(self.best.fit.x, r)
            torque = shape.row(*(known[r][(shape.place, shape.coupling, a.variable)] for a in shape.axes))
            if fitter.view.channel == "torque":
                e = torque[:: fitter.view.decimate] / chain.gain
            elif shape.coupling:
                j = chain.coupling(shape.place)
                assert j is not None
                ahead = self._through(axis, r, experiment, j, torque)
                e = chain.couplings[j].ratio * ahead - self._through(axis, r, experiment, j + 1, torque)
            else:
                i = chain.body(shape.place)
                assert i is not None
                e = -self._through(axis, r, experiment, i, torque)
            parts.append(_weighted(fitter, experiment, e))
        own = len(self.best.fit.residual) - sum(len(p) for p in parts)
        return np.concatenate([*parts, np.zeros((own, parts[0].shape[1]))])


def _weighted(fitter: Fitter, experiment: Experiment, e: np.ndarray) -> np.ndarray:
    columns = [fitter.whitened(e[:, i], experiment) for i in range(e.shape[1])]
    return np.column_stack([w[keep] for w, keep in columns])


# the fit in the model


def _with(h: Hypothesis, shape: TorqueMap) -> Hypothesis:
    """The hypothesis about an axis that has the map already; its vector stays the same."""
    nominal = h.nominal
    return dataclasses.replace(h, nominal=dataclasses.replace(nominal, effects=(*nominal.effects, shape)))


def _refine(fitter: Fitter, candidate: _Candidate, until: float, rounds: int = 6) -> _Refined | None:
    """Gauss-Newton in the model over its numbers and the coefficients, the penalty chosen anew at each linearisation.

    ``until``: what the fitter may have simulated when another one is begun.
    """
    best, solution = candidate.start, candidate.solution
    h = best.hypothesis
    k = len(h.entries)
    S = roughness(candidate.shape)
    fold = _folds(fitter, len(best.fit.residual))
    lower, upper = h.bounds
    x, c = best.fit.x, np.zeros(S.shape[1])
    problem = _linearised(fitter, h, candidate.shape, x, float(np.max(np.abs(solution.c))), S, fold)
    if problem is None:
        return None
    outcome: _Refined | None = None
    for _ in range(rounds):
        solution = solve(problem, best.chi2)
        V, root = solution.V, math.sqrt(solution.penalty)
        amplitude = max(float(np.std(solution.c)), 1e-12)
        unit = V / (np.max(np.abs(V), axis=0) + 1e-300) * amplitude

        def residual(z: np.ndarray, c: np.ndarray = c, unit: np.ndarray = unit, root: float = root) -> np.ndarray | None:
            coefficients = c + unit @ z[k:]
            part = fitter.residual(_with(h, candidate.shape.with_coefficients(coefficients)))(z[:k])
            return None if part is None else np.concatenate([part, root * (S @ coefficients)])

        free = np.full(unit.shape[1], np.inf)
        bounds = np.concatenate([lower, -free]), np.concatenate([upper, free])
        step = np.concatenate([np.full(k, 1e-3), np.full(unit.shape[1], 1e-2)])
        start = np.concatenate([x, np.zeros(unit.shape[1])])
        known = np.vstack(
            [np.column_stack([problem.J, problem.D @ unit]), np.column_stack([np.zeros((len(S), k)), root * S @ unit])]
        )
        fit = levenberg_marquardt(
            residual, start, bounds, step=step, run=fitter.run, max_iterations=8, tolerance=1e-3, J0=known, secant=True
        )
        if fit.status is Status.FAILED:
            break
        x, c = fit.x[:k], c + unit @ fit.x[k:]
        shape = candidate.shape.with_coefficients(c)
        problem = _linearised(fitter, h, shape, x, float(np.max(np.abs(c))), S, fold)
        if problem is None:
            break
        after = solve(problem, best.chi2)
        at = Linearised.known(problem.r, problem.J)
        cost = float(problem.r @ problem.r)
        fell = outcome is None or cost < (1 - SAME) * outcome.fitted.chi2
        own = Fit(x, cost, at, fit.status, fit.iterations, fit.predicted_gain)
        outcome = _Refined(Fitted(_with(h, shape), own, best.n), shape, after, problem, after.cost * best.chi2)
        if not fell or fitter.runs > until:
            break
    return outcome


def _linearised(
    fitter: Fitter, h: Hypothesis, shape: TorqueMap, x: np.ndarray, amplitude: float, S: np.ndarray, fold: np.ndarray
) -> Regression | None:
    """Residual and sensitivities in the model at a map; coefficients are moved by a hundredth of ``amplitude``."""
    k, n = len(x), len(shape.coefficients)
    amplitude = max(amplitude, 1e-12)
    c = np.array(shape.coefficients)

    def residual(z: np.ndarray) -> np.ndarray | None:
        return fitter.residual(_with(h, shape.with_coefficients(c + amplitude * z[k:])))(z[:k])

    z = np.concatenate([x, np.zeros(n)])
    r = residual(z)
    lower, upper = h.bounds
    free = np.full(n, np.inf)
    step = np.concatenate([np.full(k, 1e-3), np.full(n, 1e-2)])
    if r is None:
        return None
    J = jacobian(residual, z, r, step, np.concatenate([lower, -free]), np.concatenate([upper, free]), fitter.run)
    return None if J is None else Regression(r, c, J[:, :k], J[:, k:] / amplitude, S, fold)


# what is told of it


def _result(fitter: Fitter, refined: _Refined, before: HeldOut, after: HeldOut, p_value: float) -> MapResult:
    """Grid, values and bands."""
    fitted, shape, solution, problem = refined.fitted, refined.shape, refined.solution, refined.problem
    X = np.column_stack([problem.J, problem.D @ solution.V])
    size = np.linalg.norm(X, axis=0) + 1e-300
    rough = np.zeros((X.shape[1], X.shape[1]))
    k = problem.J.shape[1]
    scaled = problem.S @ solution.V / size[k:]
    rough[k:, k:] = solution.penalty * scaled.T @ scaled
    gram = (X / size).T @ (X / size)
    variance = fitted.chi2 / max(fitted.n, 1) / max(effective_share(fitter, fitted), 1e-3)
    covariance = variance * np.linalg.pinv(gram + rough, hermitian=True)[k:, k:]
    W = solution.V / size[k:]
    count = 41 if len(shape.axes) == 1 else 21
    points = [a.points(count) for a in shape.axes]
    rows = shape.row(*(g.ravel() for g in np.meshgrid(*points, indexing="ij")))
    values = rows @ np.array(shape.coefficients)
    half = half_width(1.0) * np.sqrt(np.maximum(np.sum((rows @ W @ covariance) * (rows @ W), axis=1), 0.0))
    motion = fitter.nominal.chain.motion
    form = (count,) * len(points)
    rms, seen = _visited(fitter, fitted, shape, points)
    unit = Quantity.TORQUE.unit(motion)
    own = len(fitted.hypothesis.carried)
    return MapResult(
        effect=shape,
        element=fitter.nominal.chain.element(shape.place, coupling=shape.coupling),
        sentence=f"{shape.describe(motion).removesuffix('.')}. On these recordings it is {rms:.3g} {unit} rms.",
        variables=tuple(
            MapVariable(a.variable, VARIABLES[a.variable][1].unit(motion), g) for a, g in zip(shape.axes, points, strict=True)
        ),
        unit=unit,
        seen=seen,
        values=values.reshape(form),
        low=(values - half).reshape(form),
        high=(values + half).reshape(form),
        held_out_error_before=before.rms,
        held_out_error_after=after.rms,
        p_value=p_value,
        linear=fitted.linear,
        effects=fitted.axis.effects[own:],
    )


def _visited(fitter: Fitter, fitted: Fitted, shape: TorqueMap, points: list[np.ndarray]) -> tuple[float, np.ndarray]:
    """Rms of the map on the estimation recordings, and which points of its grid they come by."""
    from scipy.ndimage import binary_dilation

    seen = np.zeros(tuple(len(p) for p in points), bool)
    edges = [0.5 * (p[1:] + p[:-1]) for p in points]
    squares: list[float] = []
    for own in variables(fitter, fitted) or []:
        x = [own[(shape.place, shape.coupling, a.variable)] for a in shape.axes]
        seen[tuple(np.searchsorted(e, v) for e, v in zip(edges, x, strict=True))] = True
        squares.append(float(np.mean(shape.torque(*x) ** 2)))
    return float(np.sqrt(np.mean(squares))) if squares else math.nan, binary_dilation(seen)
