"""The prediction-error estimators: one core, MATLAB's five commands on top."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from ident.checks import check_estimation_data
from ident.data import IOData, frozen
from ident.model import PolyModel
from ident.options import Focus, InitialCondition, Options, SearchOptions
from ident.search import MARGIN, factor, residual, search
from ident.start import first_models, noise_model, stabilised
from ident.structure import Structure
from mjsim.errors import InputError
from mjsim.signals import lfilter

__all__ = ["Estimate", "Start", "Status", "armax", "arx", "ararx", "bj", "oe", "pem"]  # noqa: RUF022


class Status(Enum):
    """Why the search ended; ``advice`` says what to do."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit"
    NO_DESCENT = "no further descent"
    RANK_DEFICIENT = "orders too high for the data"

    @property
    def advice(self) -> str:
        """What to try next, in words."""
        return {
            Status.CONVERGED: "A minimum was reached.",
            Status.ITERATION_LIMIT: "The search was cut off: raise SearchOptions.max_iterations, or lower the orders.",
            Status.NO_DESCENT: "Rounding or the stability limit stopped the search near a minimum: look at the residuals; "
            "fewer orders or less filtering usually help.",
            Status.RANK_DEFICIENT: "A minimum was reached where some coefficients cannot be told apart (poles cancel zeros): "
            "lower the orders; single coefficients and their errors mean little, the frequency response still does.",
        }[self]


@dataclass(frozen=True)
class Start:
    """One start of the search: the route, its loss before and after, the iterations."""

    route: str
    loss_before: float
    loss_after: float
    iterations: int


@dataclass(frozen=True)
class Estimate:
    """An estimated model and how it came about.

    model: the polynomial model with covariance. data: what it was estimated from (after the prefilter). residuals: e(t), shape
    (N,).
    loss: mean of e^2. initial_plant, initial_noise: the coefficients of I and K. initial_condition: the kind used. starts: the
    log.
    """

    model: PolyModel
    data: IOData
    residuals: NDArray
    loss: float
    status: Status
    options: Options
    initial_condition: InitialCondition
    initial_plant: NDArray
    initial_noise: NDArray
    starts: tuple[Start, ...]
    seconds: float

    @property
    def n_free(self) -> int:
        """Coefficients that were fitted (without initial conditions)."""
        return self.model.structure.n_parameters


def _sizes(s: Structure, with_state: bool) -> NDArray:
    state = (s.n_plant_state, s.n_noise_state) if with_state else (0, 0)
    return np.array([s.na, s.nb, s.nc, s.nd, s.nf, *state])


def _buffers(size: int) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    pulse = np.zeros(size)
    pulse[0] = 1.0
    return np.zeros(size), np.zeros(size), np.zeros(size), np.zeros((8, size)), pulse


def _state_columns(s: Structure) -> slice:
    return slice(s.n_parameters, s.n_parameters + s.n_plant_state + s.n_noise_state)


def _best_state(s: Structure, theta: NDArray, u: NDArray, y: NDArray) -> tuple[NDArray, float, float]:
    """Least-squares initial conditions at theta (linear): [I, K], loss without, loss with."""
    n = _sizes(s, True)
    full = np.r_[theta, np.zeros(n[5] + n[6])]
    w, v, e, signals, pulse = _buffers(y.size)
    before = residual(full, n, s.nk, u, y, w, v, e, _radius(1.0))
    if not np.isfinite(before):
        return np.zeros(n[5] + n[6]), before, before
    r = factor(full, n, s.nk, u, y, w, v, e, signals, pulse)
    block = r[:, _state_columns(s)]
    scale = np.maximum(np.linalg.norm(block, axis=0), 1e-300)
    step = np.linalg.lstsq(block / scale, r[:, -1], rcond=1e-10)[0] / scale
    after = float(np.sum((r[:, -1] - block @ step) ** 2))
    return -step, float(before), after


def _uses_state(s: Structure, kind: InitialCondition, before: float, after: float, size: int) -> bool:
    if kind is InitialCondition.ZERO:
        return False
    if kind is not InitialCondition.AUTO:
        return True
    from scipy.stats import f as f_distribution

    m = s.n_plant_state + s.n_noise_state
    free = size - s.n_parameters - m
    if m == 0 or free <= 0 or after <= 0.0:
        return False
    return bool((before - after) / m / (after / free) > f_distribution.ppf(0.999, m, free))


STAGES = (0.95, 0.98, 0.995)
"""Limits on the roots of C, released one after the other where the limit binds."""


def _radius(noise: float) -> NDArray:
    """Largest root radius per polynomial for the search; only those of C and F are read."""
    radius = np.full(7, 1.0 - MARGIN)
    radius[2] = min(noise, 1.0 - MARGIN)
    return radius


def _descend(
    first: NDArray, n: NDArray, s: Structure, u: NDArray, y: NDArray, free: NDArray, how: SearchOptions
) -> tuple[NDArray, float, int, int, NDArray]:
    """One start to its minimum: theta, loss, iterations, code, factor.

    Levenberg-Marquardt in the coefficients themselves. Where that ends other than at a minimum inside the limits of stability,
    the start is followed again in coordinates that can slide along the limit, C held within the first of the ``STAGES``.
    """
    theta, loss, iterations, code, _, r = search(
        first, n, s.nk, u, y, free, how.max_iterations, how.tolerance, False, _radius(how.noise_radius)
    )
    c = _c_columns(s)
    if code == 0 or not np.all(free[c]):
        return theta, loss, int(iterations), int(code), r
    total = int(iterations)
    x = first.copy()
    x[c] = stabilised(np.r_[1.0, x[c]], min(STAGES[0], how.noise_radius) - 0.01)[1:]
    for radius in [r_ for r_ in STAGES if r_ < how.noise_radius] + [how.noise_radius]:
        x, end, more, code_x, _, r_x = search(
            x, n, s.nk, u, y, free, 2 * how.max_iterations, how.tolerance, True, _radius(radius)
        )
        total += int(more)
        if end < loss:
            theta, loss, code, r = x, end, code_x, r_x
        if s.nc == 0 or np.max(np.abs(np.roots(np.r_[1.0, x[c]]))) < radius - 0.005:
            break
    return theta, loss, total, int(code), r


def _backcast(
    theta: NDArray, n: NDArray, s: Structure, u: NDArray, y: NDArray, free: NDArray, how: SearchOptions
) -> tuple[NDArray, float, int, int, NDArray]:
    """Alternate: initial conditions by least squares at the present coefficients, then the coefficients with these held.

    As ``_descend``. A step of one kind never raises the loss, so that the pair ends at a minimum of the joint problem.
    """
    count = s.n_parameters
    held = free.copy()
    held[count:] = 0
    total, previous = 0, np.inf
    theta, loss, iterations, code, r = _descend(theta, n, s, u, y, held, how)
    for _ in range(how.max_iterations):
        total += iterations
        if previous - loss <= how.tolerance * loss:
            break
        previous = loss
        state = _best_state(s, theta[:count], u, y)[0]
        theta, loss, iterations, code, r = _descend(np.r_[theta[:count], state], n, s, u, y, held, how)
    return theta, loss, total, code, r


def _c_columns(s: Structure) -> slice:
    return slice(s.na + s.nb, s.na + s.nb + s.nc)


def _covariance(r: NDArray, n: int, variance: float) -> tuple[NDArray, bool]:
    """Parameter covariance from the factor of the gradient; the pseudo-inverse where the data leave directions open."""
    block = r[:-1, :-1]
    scale = np.linalg.norm(block, axis=0)
    scale[scale == 0.0] = 1.0
    _, values, vt = np.linalg.svd(block / scale)
    keep = values > 1e-9 * values[0]
    half = (vt[keep].T / values[keep]) / scale[:, None]
    return variance * (half @ half.T)[:n, :n], not bool(np.all(keep))


def _prefiltered(data: IOData, options: Options) -> IOData:
    if options.prefilter is None:
        return data
    num, den = options.prefilter
    return data.with_signals(lfilter(num, den, data.u), lfilter(num, den, data.y))


def pem(data: IOData, structure: Structure, options: Options | None = None, start: PolyModel | None = None) -> Estimate:
    """Estimate a polynomial model by the prediction-error method (MATLAB ``polyest``).

    Minimises ``V = 1/N sum e(t)^2`` with ``e = D/C (A y - B/F u)`` by Levenberg-Marquardt with analytic gradients from several
    initial values, C and F kept stable; the covariance is ``s^2 (J'J)^-1``, ``s^2 = sum e^2 / (N - n)`` (Ljung, chapters 9, 10).
    ``start``: a further initial value (MATLAB ``bj(data, init_sys)``). Raises InputError for data that cannot carry the model.
    """
    options = options or Options()
    check_estimation_data(data, structure, clipping=not options.accept_clipping)
    began = time.perf_counter()
    data = _prefiltered(data, options)
    if options.focus is Focus.SIMULATION and structure.name != "oe":
        return _by_simulation(data, structure, options, began)
    return _fit(data, structure, options, began, start, None)


def _fit(data: IOData, s: Structure, options: Options, began: float, start: PolyModel | None, held: NDArray | None) -> Estimate:
    """The search proper on data scaled to unit size; ``held`` marks coefficients of theta that stay as they start."""
    us, ys = float(np.std(data.u)) or 1.0, float(np.std(data.y)) or 1.0
    u, y = np.asarray(data.u) / us, np.asarray(data.y) / ys
    gain = np.ones(s.n_parameters)
    gain[s.na : s.na + s.nb] = ys / us
    size = len(data)

    candidates: list[tuple[float, str, NDArray]] = []
    proposals = [] if held is not None else list(first_models(s, u, y))
    if start is not None:
        proposals.insert(0, ("given", start.theta / gain))
    limit = _radius(options.search.noise_radius)
    w, v, e, *_ = _buffers(size)
    n0 = _sizes(s, False)
    for route, theta in proposals:
        loss = residual(theta, n0, s.nk, u, y, w, v, e, limit)
        if np.isfinite(loss):
            candidates.append((loss, route, theta))
    if not candidates:
        raise InputError(data.source, f"no stable first model of {s} was found", "data of a stable system", "lower the orders")
    if options.initial_condition is not InitialCondition.ZERO:
        candidates = [(_best_state(s, t, u, y)[2], r, t) for _, r, t in candidates]
    candidates.sort(key=lambda c: c[0])

    kind = options.initial_condition
    free0 = np.ones(s.n_parameters, np.int64) if held is None else (~held).astype(np.int64)
    log: list[Start] = []
    ends: list[tuple[float, NDArray, int, NDArray, bool]] = []
    with_state: bool | None = None

    def follow(before: float, route: str, first: NDArray) -> None:
        nonlocal with_state
        state, zero_loss, state_loss = _best_state(s, first, u, y)
        if with_state is None:
            with_state = _uses_state(s, kind, zero_loss, state_loss, size)
        n = _sizes(s, with_state)
        theta = np.r_[first, state] if with_state else first
        free = np.r_[free0, np.ones(theta.size - free0.size, np.int64)]
        if kind is InitialCondition.BACKCAST:
            theta, loss, iterations, code, r = _backcast(theta, n, s, u, y, free, options.search)
        else:
            theta, loss, iterations, code, r = _descend(theta, n, s, u, y, free, options.search)
        if kind is InitialCondition.AUTO and not with_state and not ends:
            _, zero_loss, state_loss = _best_state(s, theta, u, y)
            if _uses_state(s, kind, zero_loss, state_loss, size):
                with_state = True
                n = _sizes(s, True)
                theta = np.r_[theta, _best_state(s, theta, u, y)[0]]
                free = np.r_[free0, np.ones(theta.size - free0.size, np.int64)]
                theta, loss, more, code, r = _descend(theta, n, s, u, y, free, options.search)
                iterations += more
        log.append(Start(route, before / size * ys**2, loss / size * ys**2, int(iterations)))
        ends.append((float(loss), theta, int(code), r, with_state))

    def agreed() -> bool:
        losses = sorted(x[0] for x in ends)
        return len(losses) > 1 and losses[1] <= losses[0] * (1 + 1e-6) + 1e-24 * size

    for candidate in candidates[: options.search.starts]:
        follow(*candidate)
        if agreed():
            break
    if held is None and options.search.starts > 1 and not agreed() and s.name == "bj":
        for route, theta in _nested(data, s, options, began, gain):
            loss = residual(theta, n0, s.nk, u, y, w, v, e, limit)
            if np.isfinite(loss):
                follow(loss, route, theta)

    loss, theta, code, r, used = min(ends, key=lambda x: x[0])
    n = _sizes(s, used)
    residual(theta, n, s.nk, u, y, w, v, e, limit)
    count = s.n_parameters
    degrees = max(1, size - int(np.sum(free0)) - (theta.size - count))
    variance = loss / degrees
    keep = np.r_[free0.astype(bool), np.ones(theta.size - count, bool), True]
    covariance = np.zeros((count, count))
    inner, deficient = _covariance(_columns(r, keep), int(np.sum(free0)), variance)
    index = np.flatnonzero(free0)
    covariance[np.ix_(index, index)] = inner
    covariance *= np.outer(gain, gain)
    status = {0: Status.CONVERGED, 1: Status.ITERATION_LIMIT}.get(code, Status.NO_DESCENT)
    if deficient and status is not Status.ITERATION_LIMIT:
        status = Status.RANK_DEFICIENT
    model = PolyModel.from_theta(s, theta[:count] * gain, data.dt, variance * ys**2, covariance)
    used_kind = InitialCondition.ZERO if not used else kind if kind is not InitialCondition.AUTO else InitialCondition.ESTIMATE
    ni = s.n_plant_state if used else 0
    return Estimate(
        model=model,
        data=data,
        residuals=frozen(e * ys),
        loss=loss / size * ys**2,
        status=status,
        options=options,
        initial_condition=used_kind,
        initial_plant=frozen(theta[count : count + ni] * ys),
        initial_noise=frozen(theta[count + ni :] * ys),
        starts=tuple(log),
        seconds=time.perf_counter() - began,
    )


def _nested(data: IOData, s: Structure, options: Options, began: float, gain: NDArray) -> list[tuple[str, NDArray]]:
    """Last starts, where no two of the others ended alike: the same plant's output-error model, with and without a noise model.

    It is nested in the wanted structure, so that the search cannot end above its loss. This is where poles and zeros of a noise
    model that the data do not need cancel each other and stall a search from elsewhere.
    """
    plain = replace(options, focus=Focus.PREDICTION, prefilter=None)
    try:
        plant = _fit(data, Structure.oe(s.nb, s.nf, s.nk), plain, began, None, None)
    except InputError:
        return []
    c, d = noise_model(np.asarray(plant.residuals), s.nc, s.nd)
    b, f = np.asarray(plant.model.B), np.asarray(plant.model.F)[1:]
    plain_noise = np.zeros(s.nc), np.zeros(s.nd)
    return [
        ("simulation", np.r_[b, c[1:], d[1:], f] / gain),
        ("simulation, white noise", np.r_[b, *plain_noise, f] / gain),
    ]


def _columns(r: NDArray, keep: NDArray) -> NDArray:
    return np.asarray(np.linalg.qr(r[:, keep], mode="r"))


def _by_simulation(data: IOData, s: Structure, options: Options, began: float) -> Estimate:
    """Output-error fit of the plant, then the noise model with the plant held."""
    if s.na and s.nf:
        raise InputError(f"structure {s}", "simulation focus with both A and F", "bj, oe, arx, armax or ararx")
    plain = replace(options, focus=Focus.PREDICTION)
    plant = _fit(data, Structure.oe(s.nb, s.na + s.nf, s.nk), plain, began, None, None)
    den = np.asarray(plant.model.F)
    v = plant.residuals
    if s.na:
        v = lfilter(den, [1.0], v)
    c, d = noise_model(np.asarray(v), s.nc, s.nd)
    a, f = (den[1:], np.empty(0)) if s.na else (np.empty(0), den[1:])
    start = PolyModel.from_theta(s, np.r_[a, plant.model.B, c[1:], d[1:], f], data.dt)
    held = np.ones(s.n_parameters, bool)
    held[s.na + s.nb : s.na + s.nb + s.nc + s.nd] = False
    fitted = _fit(data, s, replace(plain), began, start, held)
    covariance = np.array(fitted.model.covariance)
    inner = plant.model.covariance
    assert inner is not None
    order = np.r_[np.arange(s.nb, s.nb + s.na), np.arange(s.nb)] if s.na else np.arange(s.nb + s.nf)
    place = np.flatnonzero(held)
    covariance[np.ix_(place, place)] = np.asarray(inner)[np.ix_(order, order)]
    model = replace(fitted.model, covariance=covariance)
    return replace(fitted, model=model, options=options, starts=plant.starts + fitted.starts)


def bj(data: IOData, orders: tuple[int, int, int, int, int], options: Options | None = None) -> Estimate:
    """Box-Jenkins ``y = B/F u + C/D e``, orders [nb nc nd nf nk] as MATLAB's ``bj``."""
    return pem(data, Structure.from_listed("bj", orders), options)


def oe(data: IOData, orders: tuple[int, int, int], options: Options | None = None) -> Estimate:
    """Output error ``y = B/F u + e``, orders [nb nf nk] as MATLAB's ``oe``."""
    return pem(data, Structure.from_listed("oe", orders), options)


def arx(data: IOData, orders: tuple[int, int, int], options: Options | None = None) -> Estimate:
    """``A y = B u + e``, orders [na nb nk] as MATLAB's ``arx``."""
    return pem(data, Structure.from_listed("arx", orders), options)


def armax(data: IOData, orders: tuple[int, int, int, int], options: Options | None = None) -> Estimate:
    """``A y = B u + C e``, orders [na nb nc nk] as MATLAB's ``armax``."""
    return pem(data, Structure.from_listed("armax", orders), options)


def ararx(data: IOData, orders: tuple[int, int, int, int], options: Options | None = None) -> Estimate:
    """``A y = B u + 1/D e``, orders [na nb nd nk]."""
    return pem(data, Structure.from_listed("ararx", orders), options)
