"""The prediction-error estimators: one core, MATLAB's five commands on top."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from ident.checks import check_estimation_data
from ident.data import IOData, frozen
from ident.descent import Descents, Scaled, best_state, covariance_of, radius
from ident.model import PolyModel
from ident.options import Focus, InitialCondition, Options
from ident.start import first_models, noise_model
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
    residuals: np.ndarray
    loss: float
    status: Status
    options: Options
    initial_condition: InitialCondition
    initial_plant: np.ndarray
    initial_noise: np.ndarray
    starts: tuple[Start, ...]
    seconds: float

    @property
    def n_free(self) -> int:
        """Coefficients that were fitted (without initial conditions)."""
        return self.model.structure.n_parameters


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


def _first_candidates(
    s: Structure, scaled: Scaled, options: Options, start: np.ndarray | None, fixed: bool, source: str
) -> list[tuple[float, str, np.ndarray]]:
    """Stable first models as (loss, route, theta), the least loss first; ``fixed``: only the given ``start`` is used."""
    proposals = [] if fixed else list(first_models(s, scaled.u, scaled.y))
    if start is not None:
        proposals.insert(0, ("given", start))
    stable = [(scaled.loss(s, theta), route, theta) for route, theta in proposals]
    stable = [c for c in stable if np.isfinite(c[0])]
    if not stable:
        raise InputError(source, f"no stable first model of {s} was found", "data of a stable system", "lower the orders")
    if options.initial_condition is not InitialCondition.ZERO:
        stable = [(best_state(s, theta, scaled.u, scaled.y)[2], route, theta) for _, route, theta in stable]
    return sorted(stable, key=lambda c: c[0])


def _status(code: int, deficient: bool) -> Status:
    status = {0: Status.CONVERGED, 1: Status.ITERATION_LIMIT}.get(code, Status.NO_DESCENT)
    return Status.RANK_DEFICIENT if deficient and status is not Status.ITERATION_LIMIT else status


def _fit(
    data: IOData, s: Structure, options: Options, began: float, start: PolyModel | None, held: np.ndarray | None
) -> Estimate:
    """Search on data scaled to unit size; ``held`` marks coefficients of theta that keep their start values."""
    us, ys = float(np.std(data.u)) or 1.0, float(np.std(data.y)) or 1.0
    scaled = Scaled(np.asarray(data.u) / us, np.asarray(data.y) / ys, radius(options.search.noise_radius))
    gain = np.ones(s.n_parameters)
    gain[s.na : s.na + s.nb] = ys / us
    size = len(data)

    given = None if start is None else start.theta / gain
    candidates = _first_candidates(s, scaled, options, given, held is not None, data.source)
    free = np.ones(s.n_parameters, np.int64) if held is None else (~held).astype(np.int64)
    descents = Descents(s, scaled, options, free)
    for candidate in candidates[: options.search.starts]:
        descents.follow(*candidate)
        if descents.agreed():
            break
    if held is None and options.search.starts > 1 and not descents.agreed() and s.name == "bj":
        for route, theta in _nested(data, s, options, began, gain):
            loss = scaled.loss(s, theta)
            if np.isfinite(loss):
                descents.follow(loss, route, theta)

    end = descents.best()
    residuals = scaled.residuals(s, end.theta, end.with_state)
    count = s.n_parameters
    degrees = max(1, size - int(np.sum(free)) - (end.theta.size - count))
    variance = end.loss / degrees
    covariance, deficient = covariance_of(end.factor, free, end.theta.size - count, variance)
    covariance *= np.outer(gain, gain)
    model = PolyModel.from_theta(s, end.theta[:count] * gain, data.dt, variance * ys**2, covariance)
    kind = options.initial_condition
    used_kind = kind if kind is not InitialCondition.AUTO else InitialCondition.ESTIMATE
    ni = s.n_plant_state if end.with_state else 0
    unit = ys**2 / size
    return Estimate(
        model=model,
        data=data,
        residuals=frozen(residuals * ys),
        loss=end.loss * unit,
        status=_status(end.code, deficient),
        options=options,
        initial_condition=used_kind if end.with_state else InitialCondition.ZERO,
        initial_plant=frozen(end.theta[count : count + ni] * ys),
        initial_noise=frozen(end.theta[count + ni :] * ys),
        starts=tuple(Start(d.route, d.before * unit, d.loss * unit, d.iterations) for d in descents.ends),
        seconds=time.perf_counter() - began,
    )


def _nested(data: IOData, s: Structure, options: Options, began: float, gain: np.ndarray) -> list[tuple[str, np.ndarray]]:
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
