"""The torque that a recorded motion needs, as a linear relation with one delay: the estimate behind sign, unit, side, skew and
hold.

    D [u(t - delay) - f v - F sign(v) - a - b sin(theta) - c cos(theta)] = rho N v        (units of the input)

Samples at rest do not count: the friction there is anything up to its level.

N / D is the nominal driving-point impedance (machine.py) and theta the angle of the last body. All coefficients are free: a wrong
parameter changes them, a wrong unit changes them together. Inertias, stiffnesses and dampings move as well, as logarithms of
factors with a prior, by Gauss-Newton; rho takes what is common to them. The signals are cut at the top of the band and sampled
there, so that the residual fills the band (regression.py). Source: W. Khalil, E. Dombre, Modeling, Identification and Control of
Robots (2002) ch. 12 (inverse dynamic identification); C. K. Sanathanan, J. Koerner, IEEE Trans. Automatic Control 8 (1963) 56
(the fixed denominator).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from diagnose.check.machine import Machine
from diagnose.check.regression import Solution, regress, solve
from diagnose.check.spectrum import Spectrum, clear_band, noise_level
from diagnose.check.thresholds import SHAPE_SPREAD

__all__ = ["HOLDS", "Fit", "Pair", "Ratio", "Relation", "Signals", "compare_channels", "hold_response"]

HOLDS = ("held", "linear", "mean")
TOP = 40.0  # [Hz] above which unmodelled flexibility, not the log, decides the relation of most robots
SAMPLED = 0.3  # of the sampling rate: above it the images of a held input fold back
FEWEST = 40  # samples in the band that a fit needs: five times its coefficients
TURNS = 4  # of Gauss-Newton on the shape: the fourth changes a mode that is 20 % off by less than 0.1 %
POOR = 0.9  # part of the torque that is explained, below which more starts are tried
STARTS = 8  # of the delay, side by side over the window
LAGS = tuple(np.linspace(0.7, 1.6, 10))  # time constant over delay: they are equal where the motion is slow
NEAR = 5e-3  # [s] delays of a second start: what most logs without a skew have
WINDOW = 0.25  # [s] largest delay that is looked for
REST = 3  # samples of the band, 40 ms at 40 Hz
SHARE = 0.1  # of the recording that the window may take at either end


def hold_response(hold: str, frequency: np.ndarray, dt: float) -> np.ndarray:
    """Transfer (K,) from the samples of the input, as a spectrum, to the input between them: held, linear, or logged as a
    mean."""
    x = np.asarray(frequency) * dt
    sinc, half = np.sinc(x), np.exp(-1j * math.pi * x)
    if hold == "held":
        return np.asarray(sinc * half)
    if hold == "linear":
        return np.asarray(sinc**2 + 0j)
    return np.asarray(np.conj(half) / np.maximum(sinc, 0.1))


@dataclass(frozen=True, eq=False)
class Signals:
    """Channels in SI: sample time [s], torque, velocity or None, angle or None, each (N,)."""

    dt: float
    torque: np.ndarray
    velocity: np.ndarray | None
    angle: np.ndarray | None


@dataclass(frozen=True)
class Ratio:
    """An estimate and its standard error; mostly a number of the recording over the same number of the model."""

    value: float
    error: float

    def determined(self, relative: float) -> bool:
        """Whether the standard error is within a part of the value."""
        return math.isfinite(self.value) and self.error < relative * abs(self.value)


@dataclass(frozen=True, eq=False)
class Fit:
    """One fit of the relation.

    delay [s]: of the response behind the torque; inertia, loss, gravity: ratios to the model, None where the model or the log has
    none; dissipated [input times velocity]: mean power that friction takes; explained: part of the torque's variance; over_none,
    over_lag: whitened residual power at no delay, and with a first-order lag instead, over that at the delay;
    plain_over_none: that of the plain residual, each delay with its own whitening; extra: coefficient of the
    additional column; count: samples in the band; top [Hz]: the band; time, target, residual (M,): decimated grid, units of the
    input.
    """

    delay: Ratio
    inertia: Ratio
    loss: Ratio | None
    gravity: Ratio | None
    dissipated: Ratio
    explained: float
    over_none: float
    over_lag: float
    plain_over_none: float
    extra: Ratio | None
    count: int
    top: float
    time: np.ndarray
    target: np.ndarray
    residual: np.ndarray


@dataclass(frozen=True)
class Pair:
    """Angle against velocity: ratio of the rate of the angle to the velocity, and delay [s] of the velocity behind the angle."""

    ratio: Ratio
    delay: Ratio
    explained: float


class Relation:
    """The relation laid out for one response ("velocity" or "angle") of a recording; `fit` solves it for one hold.

    ``shape``: that of another relation of the same machine; found when it is None.
    """

    def __init__(self, signals: Signals, machine: Machine, response: str, shape: np.ndarray | None = None) -> None:
        motion = signals.velocity if response == "velocity" else signals.angle
        assert motion is not None
        self._machine, self._dt, self._shape = machine, signals.dt, shape
        top = min(TOP, SAMPLED / signals.dt)
        self.top = min(top, clear_band(Spectrum.of(motion, signals.dt, top), noise_level(motion), signals.dt))
        duration = (len(motion) - 1) * signals.dt
        self._count = math.floor(2 * self.top * duration)
        self._window = min(WINDOW, SHARE * duration)
        self.enough = self._count > FEWEST + machine.shape_size
        if not self.enough:
            return
        time = np.linspace(0.0, duration, self._count + 1)
        edge = max(self._window, 2.0 / self.top)
        self._inner = (time >= edge) & (time <= duration - edge)
        self.time = time[self._inner]
        self._torque = Spectrum.of(signals.torque, signals.dt, self.top)
        self._motion = Spectrum.of(motion, signals.dt, self.top)
        self._order = 0 if response == "velocity" else 1
        self._velocity = self._motion.derivative(self._order, self._count)[self._inner]
        self._moves = _moves(self._velocity, noise_level(motion) if response == "velocity" else 0.0)
        self.enough = int(np.sum(self._moves)) > FEWEST + machine.shape_size and float(np.std(self._velocity)) > 0
        if self.enough:
            self._torques, self._kinds = self._lay_out(signals, motion)

    def _lay_out(self, signals: Signals, motion: np.ndarray) -> tuple[list[Spectrum], dict[str, list[int]]]:
        """Spectra of the torques beside the impedance, and which columns of the relation belong to which kind."""
        order, n = self._order, len(motion)
        wide = Spectrum.of(motion, self._dt, min(4 * self.top, 0.5 / self._dt)).derivative(order, n - 1)
        torques = [Spectrum.of(wide, self._dt, self.top)]
        kinds: dict[str, list[int]] = {"inertia": [0], "loss": [1], "position": []}
        noise = noise_level(motion) if order == 0 else 0.0
        direction = np.tanh(wide / max(3 * noise, 0.02 * float(np.std(wide)), 1e-300))
        if np.min(direction) < -0.5 and np.max(direction) > 0.5:
            kinds["loss"].append(1 + len(torques))
            torques.append(Spectrum.of(direction, self._dt, self.top))
        self._angle = signals.angle
        if self._angle is None:
            self._angle = np.concatenate([[0.0], np.cumsum(0.5 * (wide[1:] + wide[:-1])) * self._dt])
        if self._machine.hinge:
            for function in (np.sin, np.cos):
                kinds["position"].append(1 + len(torques))
                torques.append(Spectrum.of(function(float(self._machine.ratios[-1]) * self._angle), self._dt, self.top))
        return torques, kinds

    def _through(self, x: Spectrum, response: np.ndarray, order: int = 0) -> np.ndarray:
        """A signal's derivative through a response (K,), on the inner grid; its line by the response at rest."""
        s = 2j * math.pi * x.frequency
        return x.through(response * s**order, self._count)[self._inner] if order == 0 else (
            x.filtered(response * s**order, self._count)[self._inner] + x.slope * float(response[0].real)
        )  # fmt: skip

    def _responses(self, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, D) on the lines of the band; at rest N is 0 and D its value at the lowest line."""
        f = self._motion.frequency.copy()
        f[0] = f[1] * 1e-3
        N, D = self._machine.impedance(f, shape)
        N[0], D[0] = 0.0, D[0].real
        return N, D

    def fit(self, hold: str = "held", extra: np.ndarray | None = None) -> Fit | None:
        """Fit all coefficients and the delay; None where the band holds too few samples. ``extra`` (N,): one more column."""
        if not self.enough:
            return None
        torques = [*self._torques, Spectrum.of(extra, self._dt, self.top)] if extra is not None else self._torques
        response = hold_response(hold, self._torque.frequency, self._dt)
        size = self._machine.shape_size
        shape, X, _, found = self._best(torques, response)
        self.shape = shape
        k = X.shape[1] - size
        weights = {"inertia": self._weights("inertia", k), "loss": self._loss_weights(k), "gravity": self._gravity_weights(k)}
        ratios = {name: None if w is None else _combined(found, w) for name, w in weights.items()}
        inertia = ratios["inertia"]
        assert inertia is not None
        alone = None
        if extra is not None:
            alone = Ratio(float(found.coefficients[k - 1]), math.sqrt(max(float(found.covariance[k - 1, k - 1]), 0.0)))
        over_none, over_lag = self._beyond(X, shape, response, found)
        return Fit(
            Ratio(found.delay, found.delay_error), inertia, ratios["loss"], ratios["gravity"], self._dissipated(found, k),
            found.explained, over_none, over_lag, self._plain_over_none(X, shape, response, found), alone,
            int(np.sum(self._moves)), self.top, self.time, found.target, found.residual,
        )  # fmt: skip

    def _best(
        self, torques: list[Spectrum], hold: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Callable[[float | np.ndarray], np.ndarray], Solution]:
        """The best of a few starts, by the power of the whitened residual: a delay may stand for a shape that is still wrong."""
        best = self._solved(torques, hold, 0.0, self._window)
        if not self._machine.shape_size or self._shape is not None:
            return best
        starts = [(0.0, NEAR)] if abs(best[3].delay) > NEAR else []
        if best[3].explained < POOR:
            width = self._window / STARTS
            starts += [((2 * k + 1 - STARTS) * width, width) for k in range(STARTS)]
        for centre, width in starts:
            other = self._solved(torques, hold, centre, width)
            if np.sum(other[3].white ** 2) < np.sum(best[3].white ** 2):
                best = other
        return best

    def _solved(
        self, torques: list[Spectrum], hold: np.ndarray, centre: float, window: float
    ) -> tuple[np.ndarray, np.ndarray, Callable[[float | np.ndarray], np.ndarray], Solution]:
        """Shape, columns, input and solution after the turns of Gauss-Newton, with delays within ``window`` [s] of a centre."""
        size, given = self._machine.shape_size, self._shape
        shape, rho = np.zeros(size) if given is None else given, 0.0
        for turn in range(1 + TURNS if size and given is None else 2 if size else 1):
            X, y = self._relation(shape, torques, hold, rho)
            found = regress(X, y, (centre - window, centre + window), self.top, self._prior(X.shape[1], rho), self._moves)
            if rho and given is None and turn < TURNS:
                shape = np.clip(shape + found.coefficients[X.shape[1] - size :], -1.0, 1.0)
            rho = float(found.coefficients[0])
        return shape, X, y, found

    def _relation(
        self, shape: np.ndarray, torques: list[Spectrum], hold: np.ndarray, rho: float
    ) -> tuple[np.ndarray, Callable[[float | np.ndarray], np.ndarray]]:
        """Columns (M, k) and the input as a function of the delay: impedance, torques, a constant, then one for each shape
        factor.

        The last ones are there where ``rho`` is not 0. The derivatives by the shape are those of N v, and of D at the torque that
        the impedance takes, which is rho N v / D itself.
        """
        N, D = self._responses(shape)
        columns = [self._through(self._motion, N, self._order)]
        columns += [self._through(x, D) for x in self._torques]
        columns.append(np.ones(len(self.time)))
        columns += [self._through(x, D) for x in torques[len(self._torques) :]]
        h = 1e-4
        for i in range(len(shape) if rho else 0):
            step = np.zeros(len(shape))
            step[i] = h
            up, down = self._responses(shape + step), self._responses(shape - step)
            change = (up[0] - down[0]) / (2 * h) - N / np.where(D == 0, 1, D) * (up[1] - down[1]) / (2 * h)
            columns.append(self._through(self._motion, rho * change, self._order))
        turned = hold * D
        return np.column_stack(columns), lambda delay: self._torque.delayed(delay, turned, self._count)[self._inner]

    def _prior(self, k: int, rho: float) -> np.ndarray:
        """Precisions (k,) of the coefficients: those of the shape, where they are, have a spread, the others none."""
        out = np.zeros(k)
        if rho and self._machine.shape_size:
            out[-self._machine.shape_size :] = 1 / SHAPE_SPREAD**2
        return out

    def _weights(self, kind: str, k: int) -> np.ndarray:
        w = np.zeros(k)
        w[self._kinds[kind]] = 1.0
        return w

    def _power_weights(self, k: int) -> np.ndarray:
        """Mean power lost to friction, as weights of the coefficients."""
        w = np.zeros(k)
        for i in self._kinds["loss"]:
            w[i] = float(np.mean(self._velocity * self._torques[i - 1].derivative(0, self._count)[self._inner]))
        return w

    def _dissipated(self, found: Solution, k: int) -> Ratio:
        return _combined(found, self._power_weights(k))

    def _loss_weights(self, k: int) -> np.ndarray | None:
        """The power lost to friction over that of the model, as weights of the coefficients."""
        nominal = float(np.mean(self._velocity * self._machine.friction(self._velocity)))
        return None if nominal == 0 else self._power_weights(k) / nominal

    def _gravity_weights(self, k: int) -> np.ndarray | None:
        """The part of the position torque that is the model's, over the model's, without means, as weights of the
        coefficients."""
        assert self._angle is not None
        nominal = self._machine.gravity(self._angle)
        if nominal is None or not self._kinds["position"]:
            return None
        g = Spectrum.of(nominal, self._dt, self.top).derivative(0, self._count)[self._inner]
        g = g - np.mean(g)
        if float(g @ g) == 0:
            return None
        w = np.zeros(k)
        for i in self._kinds["position"]:
            column = self._torques[i - 1].derivative(0, self._count)[self._inner]
            w[i] = float(g @ (column - np.mean(column))) / float(g @ g)
        return w

    def _plain_over_none(self, X: np.ndarray, shape: np.ndarray, hold: np.ndarray, found: Solution) -> float:
        """Power of the plain residual at no delay over that at the delay, in the rows that count."""
        turned = hold * self._responses(shape)[1]
        none = regress(X, lambda d: self._torque.delayed(d, turned, self._count)[self._inner], (0.0, 0.0), self.top,
                       found.prior, found.keep, fixed=True)  # fmt: skip
        powers = [float(np.sum(s.residual[s.keep] ** 2)) for s in (none, found)]
        return powers[0] / max(powers[1], 1e-300)

    def _beyond(self, X: np.ndarray, shape: np.ndarray, hold: np.ndarray, found: Solution) -> tuple[float, float]:
        """Residual power at no delay, and with the best first-order lag, over that at the delay.

        The lag's time constant is searched over the delay times `LAGS`; 1 + s T and exp(s T) agree to first order.
        """
        direct = hold * self._responses(shape)[1]
        least = max(float(found.white @ found.white), 1e-300)

        def power(lag: float) -> float:
            response = direct / (1 + 2j * math.pi * self._torque.frequency * lag)
            y = self._torque.through(response, self._count)[self._inner]
            white = solve(X, y, found.filters, found.prior, found.keep)[1]
            return float(white @ white) / least

        lags = [factor * found.delay for factor in LAGS] if found.delay > 0 else []
        return power(0.0), min((power(lag) for lag in lags), default=math.inf)


def _moves(velocity: np.ndarray, noise: float) -> np.ndarray:
    """Which samples (M,) of a velocity are no rest: there the friction takes whatever torque is applied, and the relation fails.

    Rest is a run of at least `REST` samples whose speed is that of the noise; a reversal passes through it faster.
    """
    slow = np.abs(velocity) < max(3 * noise, 0.02 * float(np.std(velocity)))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(int)))
    moves = np.ones(len(velocity), bool)
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last - first >= REST:
            moves[max(first - 1, 0) : last + 1] = False
    return moves


def compare_channels(signals: Signals) -> Pair | None:
    """Fit v(t + delay) = q'(t) / ratio + constant; None where one channel is missing or the band holds too few samples."""
    if signals.velocity is None or signals.angle is None:
        return None
    dt, n = signals.dt, len(signals.velocity)
    top = min(TOP, SAMPLED / dt)
    tops = [clear_band(Spectrum.of(x, dt, top), noise_level(x), dt) for x in (signals.velocity, signals.angle)]
    top, duration = min(tops), (n - 1) * dt
    count, window = math.floor(2 * top * duration), min(WINDOW, SHARE * (n - 1) * dt)
    if count <= FEWEST:
        return None
    time = np.linspace(0.0, duration, count + 1)
    edge = max(window, 2.0 / top)
    inner = (time >= edge) & (time <= duration - edge)
    if np.sum(inner) <= FEWEST:
        return None
    rate = Spectrum.of(signals.angle, dt, top).derivative(1, count)[inner]
    velocity = Spectrum.of(signals.velocity, dt, top)
    ones = np.ones(len(velocity.frequency), complex)
    columns = np.column_stack([rate, np.ones(len(rate))])
    found = regress(columns, lambda d: velocity.delayed(-d, ones, count)[inner], (-window, window), top)
    slope, error = float(found.coefficients[0]), math.sqrt(max(float(found.covariance[0, 0]), 0.0))
    ratio = Ratio(1 / slope, error / slope**2) if slope else Ratio(math.inf, math.inf)
    return Pair(ratio, Ratio(found.delay, found.delay_error), found.explained)


def _combined(found: Solution, weights: np.ndarray) -> Ratio:
    """A weighted sum of the first coefficients with its standard error."""
    w = np.zeros(len(found.coefficients))
    w[: len(weights)] = weights
    return Ratio(float(w @ found.coefficients), math.sqrt(max(float(w @ found.covariance @ w), 0.0)))
