"""Does the residual still hold structure that the recorded input and motion predict? The test behind ``unexplained``.

A dictionary of torques, functions of the measured velocity, angle and command, is passed through the fitted linear axis, and
the residual is regressed on it (ridge) on the estimation samples. What counts is how much it predicts of the *held-out*
residual: noise, coloured
or not, is not predicted by it; physics that was left out is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from diagnose.data.experiment import Experiment, measured_angle, measured_velocity, middle
from diagnose.data.runs import free_run
from diagnose.evidence.encoder import whole_orders
from diagnose.evidence.orders import torque_to_velocity
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.problem.problem import bounded
from diagnose.problem.view import ForceView
from diagnose.thresholds import BLOCKS, INTERVALS, SIGMAS, TWICE, WINDOWS
from mjsim.axis import Axis
from mjsim.ode import DivergedError
from mjsim.quantity import Motion
from mjsim.signals import lfilter

__all__ = ["Structure", "by_rate_of_angle", "error_of_angle", "motion_error", "motion_errors", "remaining_structure"]


@dataclass(frozen=True)
class Structure:
    """share.

    Part of the held-out squared residual, whitened as it was fitted, that the dictionary predicts (<= 0 when none); p_value:
    one-sided, over blocks.
    """

    share: float
    p_value: float


def _clean_velocity(fitter: Fitter, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray:
    """Velocity (N,) for the dictionary: the model's own in free run, so that the sensor's noise is not regressed on itself."""
    v = measured_velocity(experiment.recording)
    if fitter.view.channel != "torque":
        s = fitter.view.signals(axis, experiment, initial)
        if s is not None and fitter.view.channel == "angle":
            velocity: np.ndarray = np.gradient(s.predicted, experiment.recording.dt)
            return velocity
        return v if s is None else s.predicted
    width = max(3, int(0.003 / experiment.recording.dt))
    kernel = np.hanning(width + 2)[1:-1]
    return np.convolve(v, kernel / kernel.sum(), mode="same")


def _dictionary(fitter: Fitter, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray:
    """Responses (M, k) of the judged channel to the torques of the dictionary."""
    r = experiment.recording
    s = _clean_velocity(fitter, axis, experiment, initial)
    scale = fitter.scales["motor"].velocity or 1.0
    x = s / scale
    u = r.input / (fitter.scales["motor"].input or 1.0)
    torques = [np.ones_like(x), np.tanh(x / 0.02), np.tanh(x / 0.1), x, np.abs(x), x * np.abs(x), x**3, u * np.abs(u), u**3,
               np.abs(u),
               np.tanh(x / 0.05) * np.abs(u), np.tanh(x / 0.05) * np.exp(-((x / 0.1) ** 2)),
               np.tanh(x / 0.05) * np.arange(len(x)) / len(x)]  # fmt: skip
    if r.angle is not None:
        q = r.angle
        c = (q - q.mean()) / max(float(np.ptp(q)), 1e-12) * 2
        torques += [c, c**2, c**3, c * np.tanh(x / 0.05)]
        for order in fitter.orders[:3]:
            for trig in (np.sin(order * q), np.cos(order * q)):
                torques += [trig, trig * np.tanh(x / 0.05)]
    basis = np.column_stack(torques)
    lagged = [np.concatenate([np.zeros(k), u[:-k]]) for k in (max(1, int(d / r.dt)) for d in (0.001, 0.003, 0.01, 0.03, 0.1))]
    if isinstance(fitter.view, ForceView):
        laws = [_hats(x), *([] if r.angle is None else [_hats(r.angle)])]
        return fitter.view.low_passed(np.column_stack([basis, *laws]), experiment)
    b, a = torque_to_velocity(axis, r.dt, about=middle(r), by_velocity=r.angle is None)
    through = lfilter(b, a, np.column_stack([basis, u, *lagged]))
    return np.column_stack([np.where(bounded(through).all(axis=0), through, 0.0), s])


def _hats(x: np.ndarray) -> np.ndarray:
    """Piecewise linear functions (N, k) of a variable (N,) on equal intervals: any law of it alone."""
    knots = np.linspace(float(np.min(x)), float(np.max(x)), INTERVALS[0] + 1)
    return np.column_stack([np.interp(x, knots, one) for one in np.eye(len(knots))])


def _regressed(
    fitter: Fitter, experiment: Experiment, axis: Axis, initial: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Responses of the dictionary (M, k) and the residual (M,) on the samples that count, both over the noise and whitened.

    Under feedback the torque holds earlier noise, which tells of later noise as long as that is coloured.
    """
    e = fitter.error(axis, experiment, initial)
    if e is None:
        return None
    w, keep = fitter.whitened(e, experiment)
    responses = _dictionary(fitter, axis, experiment, initial)[: len(e)]
    return np.column_stack([fitter.whitened(column, experiment)[0][keep] for column in responses.T]), w[keep]


def remaining_structure(fitter: Fitter, fitted: Fitted, blocks: int = 25) -> Structure:
    """Share of the held-out residual that the dictionary predicts, and how sure that it predicts any."""
    from scipy.special import stdtr

    h, x = fitted.hypothesis, fitted.fit.x
    solved: list[tuple[Axis, np.ndarray | None]] = [(h.axis(x, i), h.initial(x, i)) for i in range(len(fitter.experiments))]
    for experiment in fitter.held_out:
        own = fitter.own_values(h, fitted, experiment)
        if own is None:
            return Structure(0.0, 1.0)
        solved.append(own)
    everything = (*fitter.experiments, *fitter.held_out)
    regressed = fitter.map([partial(_regressed, fitter, e, *own) for e, own in zip(everything, solved, strict=True)])
    played = [r for r in regressed if r is not None]
    estimation, held_out = played[: len(fitter.experiments)], played[len(fitter.experiments) :]
    if len(played) < len(everything):
        return Structure(0.0, 1.0)
    X, y = (np.concatenate(parts) for parts in zip(*estimation, strict=True))
    scale = np.sqrt(np.mean(X**2, axis=0)) + 1e-300
    X = X / scale
    gram = X.T @ X + 1e-4 * len(X) * np.eye(X.shape[1])
    weights = np.linalg.solve(gram, X.T @ y)
    gains, before = [], 0.0
    for responses, z in held_out:
        predicted = (responses / scale) @ weights
        # a gain of any size that carries over counts, a wrong amplitude does not hide it
        gain = 2 * z * predicted - predicted**2
        gains += [float(np.sum(p)) for p in np.array_split(gain, blocks)]
        before += float(z @ z)
    if not before > 0:  # nothing is left to predict
        return Structure(0.0, 1.0)
    g = np.array(gains)
    t = float(np.mean(g) / (np.std(g, ddof=1) / np.sqrt(len(g)) + 1e-300))
    return Structure(float(np.sum(g)) / before, float(stdtr(len(g) - 1, -t)))


def motion_error(
    fitter: Fitter, fitted: Fitted, windows: Sequence[float] = WINDOWS, on: Sequence[Experiment] | None = None
) -> float | None:
    """How much of the error is motion that really took place: the most that any of ``windows`` [s] shows.

    In units of the velocity noise variance; None where it cannot be told, 0 where it is within four standard errors of none.
    The velocity error and the rate of the angle error, both averaged over a window, share the motion that the model missed
    and nothing else: the noise of one sensor is not in the other. Their covariance on the held-out recordings (or those ``on``
    which it is asked) is therefore the mean square of the missed motion, whatever the colour of either noise. Over a long
    window little noise is left, and no motion faster than it; over a short one it is the other way round. What repeats with the
    turn of the encoder is taken out of both. Held-out phases and speeds are estimated as for the free-run error. Where an angle
    alone was measured, see `_angle_error`.
    """
    if fitter.view.channel == "torque":
        return None
    on = fitter.held_out if on is None else on
    if fitter.view.channel == "angle" or by_rate_of_angle(fitter):
        return _angle_error(fitter, fitted, on)
    runs = []
    for experiment in on:
        r = experiment.recording
        if r.velocity is None or r.angle is None:
            return None
        speed = 0.5 * (r.velocity[1:] + r.velocity[:-1])
        if np.std(speed - np.diff(r.angle) / r.dt) < 1e-6 * np.std(r.velocity):
            return None  # one channel was computed from the other
        solved = fitter.own_values(fitted.hypothesis, fitted, experiment)
        if solved is None:
            return None
        y = free_run(solved[0], experiment, solved[1])
        # between samples by the errors' mean: the mean of the velocities themselves errs where they bend
        missed = r.velocity - y.velocity
        if experiment.correction is not None:
            missed = missed + experiment.correction
        error, angle_error = 0.5 * (missed[1:] + missed[:-1]), r.angle - y.angle
        if fitter.nominal.chain.motion is Motion.HINGE:
            cyclic = _encoder_error(error, r.angle, experiment.counts, r.dt)
            error, angle_error = error - np.diff(cyclic) / r.dt, angle_error - cyclic
        runs.append((error, angle_error, experiment.counts, r.dt))
    return _most_shared(runs, windows)


def _angle_error(fitter: Fitter, fitted: Fitted, on: Sequence[Experiment]) -> float | None:
    """Mean square of the angle's error above that of its noise, over the latter; None where it may be noise of another colour.

    An angle shows motion itself, so that its error e is motion as far as it exceeds the noise sigma that the recording shows.
    No second channel tells coloured noise from motion here: up to an rms of `TWICE` sigma it may be either. What repeats with
    the turn of the encoder is taken out. Also where the rate of the angle is judged: white noise of the angle has the power
    density (sin(w dt) / dt)^2 sigma^2 dt / pi there, next to nothing at the frequencies of a motion, and hides at its own
    rms an error that the angle shows.
    """
    total, weight = 0.0, 0.0
    for experiment in on:
        r = experiment.recording
        level = fitter.view.noise(experiment) if fitter.view.channel == "angle" else experiment.angle_noise
        solved = fitter.own_values(fitted.hypothesis, fitted, experiment)
        if solved is None or r.angle is None or not level:
            return None
        e = error_of_angle(fitter, experiment, *solved)
        if e is None:
            return None
        keep = fitter.counted(experiment)
        orders = whole_orders(r.angle) if fitter.nominal.chain.motion is Motion.HINGE else []
        if orders:
            waves = np.column_stack([trig(n * r.angle) for n in orders for trig in (np.sin, np.cos)])
            e = e - waves @ np.linalg.lstsq(waves[keep], e[keep], rcond=1e-8)[0]
        total, weight = total + float(np.sum((e[keep] / level) ** 2)), weight + float(np.sum(keep))
    if weight == 0.0 or total <= TWICE**2 * weight:
        return None
    return total / weight - 1.0


def by_rate_of_angle(fitter: Fitter) -> bool:
    """Whether the rate of an angle is judged, since no velocity was measured."""
    return fitter.view.channel == "velocity" and all(e.recording.velocity is None for e in fitter.experiments)


def error_of_angle(fitter: Fitter, experiment: Experiment, axis: Axis, initial: np.ndarray | None) -> np.ndarray | None:
    """Measured less simulated angle (N,) of a free run, without its mean where its rate is judged; None where it diverges."""
    if fitter.view.channel == "angle":
        return fitter.error(axis, experiment, initial)
    try:
        e = measured_angle(experiment.recording) - free_run(axis, experiment, initial).angle
    except DivergedError:
        return None
    if experiment.correction is not None:  # of the rate
        c = experiment.correction
        e = e + np.concatenate([[0.0], np.cumsum(0.5 * (c[1:] + c[:-1]))]) * experiment.recording.dt
    return np.asarray(e - np.mean(e[fitter.counted(experiment)]))


def motion_errors(
    fitter: Fitter, base: Fitted, best: Fitted, on: Sequence[Experiment] | None = None
) -> tuple[float | None, float | None]:
    """The motion that each of two models misses, as the angle confirms it."""
    before, after = fitter.map([partial(motion_error, fitter, f, on=on) for f in (base, best)])
    return before, after


def _encoder_error(error: np.ndarray, angle: np.ndarray, counts: np.ndarray, dt: float) -> np.ndarray:
    """What a velocity error (N - 1,) holds of an error of the angle (N,) that repeats each turn of the encoder [rad].

    The angle and its rate both show it, and the axis did not move so.
    """
    orders = whole_orders(angle)
    if not orders:
        return np.zeros(len(angle))
    waves = np.column_stack([trig(n * angle) for n in orders for trig in (np.sin, np.cos)])
    rates = np.diff(waves, axis=0) / dt
    keep = counts[:-1] & counts[1:]
    return np.asarray(waves @ np.linalg.lstsq(rates[keep], error[keep], rcond=1e-8)[0])


def _most_shared(runs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, float]], windows: Sequence[float]) -> float | None:
    """The most that any of ``windows`` [s] shows (`_shared`); where none tells, what the longest one shows that does.

    The rate of a coarse angle is noisy: by steps s over a window T its rms is s / (sqrt(6) T), which falls faster than the noise
    of a mean.
    """
    found = [x for window in windows if (x := _shared(runs, window)) is not None]
    window = sum(float(np.sum(counts)) * dt for _, _, counts, dt in runs) / BLOCKS
    while not found and window > max(windows):
        found = [x] if (x := _shared(runs, window)) is not None else []
        window /= 2
    return max(found, default=None)


def _shared(runs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, float]], window: float) -> float | None:
    """What velocity errors and angle errors share over one window, per run: (N - 1,), (N,), the samples that count, dt.

    None where too few windows count, or their noise is such that the velocity errors would not stand out if all were motion.
    """
    products: list[float] = []
    speeds: list[float] = []
    noise: list[float] = []
    apart: list[float] = []
    for error, angle_error, counts, dt in runs:
        k = max(2, round(window / dt))
        count = len(error) // k
        parts = error[: count * k].reshape(count, k)
        speed = parts.mean(axis=1)
        angle = np.diff(angle_error[: count * k + 1 : k]) / (k * dt)
        keep = counts[: count * k].reshape(count, k).all(axis=1)
        products += list((speed * angle)[keep])
        speeds += list(speed[keep])
        d2 = (speed - angle)[keep] ** 2  # in which shared motion cancels
        apart += list(d2)
        # the noise of single samples: what varies within a window, and what the window's mean shows beside the angle
        if keep.any():  # elsewhere an error of the encoder was extrapolated from the samples that count
            noise += list(d2 + float(np.mean(parts[keep].var(axis=1))))
    if len(products) < 20:
        return None
    p = np.array(products)
    # the spread of the products is as large as they are where the motion is a short burst; that of independent noises alone is at
    # most half the root of E d^4 >= (E d^2)^2 >= 4 var(speed) var(angle)
    spread = min(float(np.std(p, ddof=1)), 0.5 * float(np.sqrt(np.mean(np.square(apart)))))
    least = SIGMAS * spread / np.sqrt(len(p))
    if np.mean(p) <= least:
        return 0.0 if np.mean(np.square(speeds)) > least else None
    return float(np.mean(p) / np.mean(noise))
