"""Where the mismatch is, before any name is tried: in time, in frequency, over the state, and in the mechanism.

The disturbance torque at a place is what, added there, would turn the model's output into the measured one. It is found by
regularised
deconvolution of the residual through the fitted linear axis (the Wiener filter of a flat disturbance in the measured noise):

    D(f) = G*(f) E(f) / (|G(f)|^2 + S_noise / S_disturbance)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from diagnose.data.experiment import Experiment, measured_angle, measured_velocity, middle
from diagnose.data.runs import free_run
from diagnose.evidence.orders import torque_to_velocity
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.whiten import noise_psd, noise_rms
from diagnose.result import Mismatch, Place, Share, StateShare
from mjsim.axis import Axis
from mjsim.chain import Chain
from mjsim.recording import Recording
from mjsim.servo import Target
from mjsim.signals import coherence, freqz, welch

__all__ = ["Bins", "Played", "disturbance", "locate", "played", "states"]


@dataclass(frozen=True, eq=False)
class Played:
    """A fitted model on one recording: the axis with that recording's own numbers, its start, and the error e (M,)."""

    experiment: Experiment
    role: str
    axis: Axis
    initial: np.ndarray | None
    e: np.ndarray


def played(fitter: Fitter, fitted: Fitted) -> list[Played]:
    """A fitted model on every recording, those for estimation first; one whose blocks are held out comes once."""
    out = []
    for i, experiment in enumerate(fitter.experiments):
        axis, initial = fitted.hypothesis.axis(fitted.fit.x, i), fitted.hypothesis.initial(fitted.fit.x, i)
        e = fitter.error(axis, experiment, initial)
        assert e is not None
        out.append(Played(experiment, "estimation", axis, initial, e))
    known = {id(x.recording) for x in fitter.experiments}
    for experiment in fitter.held_out:
        solved = None if id(experiment.recording) in known else fitter.own_values(fitted.hypothesis, fitted, experiment)
        e = None if solved is None else fitter.error(solved[0], experiment, solved[1])
        if solved is not None and e is not None:
            out.append(Played(experiment, "held-out", *solved, e))
    return out


def disturbance(fitter: Fitter, on: Played, body: int = 0) -> np.ndarray:
    """Torque on a body that would close the gap on a recording, on the view's grid (M,)."""
    experiment, axis, e = on.experiment, on.axis, on.e
    if fitter.view.channel == "torque":
        # commanded minus needed: what acted on top of the command is its negative
        return -e * (1.0 if body == 0 else 1.0 / axis.chain.total_ratio(body))
    r = experiment.recording
    b, a = torque_to_velocity(axis, r.dt, body, middle(r), by_velocity=r.angle is None)
    n = len(e)
    pad = 2 * n
    spectrum = np.fft.rfft(e - 0.0, pad)
    integrates = _target(axis.chain) is Target.VELOCITY and r.angle is not None
    g = _response(b, a, pad, integrates=integrates)
    noise = noise_rms(fitter, experiment) ** 2
    power = max(float(np.mean(e**2)) - noise, 1e-3 * noise)
    gain = float(np.mean(np.abs(g[: max(2, len(g) // 20)]) ** 2))
    ridge = gain * noise / power * 0.05 + 1e-9 * gain
    return np.asarray(np.fft.irfft(np.conj(g) * spectrum / (np.abs(g) ** 2 + ridge), pad)[:n])


def _response(b: np.ndarray, a: np.ndarray, length: int, *, integrates: bool) -> np.ndarray:
    """Response (length / 2 + 1,) at the frequencies of a Fourier transform; that of an integrator at rest is the next one's."""
    at = 2 * np.pi * np.arange(length // 2 + 1) / length
    if not integrates:
        return freqz(b, a, at)
    g = freqz(b, a, at[1:])
    return np.concatenate([g[:1], g])


def states(fitter: Fitter, on: Played) -> dict[str, tuple[np.ndarray, str]]:
    """The states that a law may depend on, on the view's grid: name -> (values, unit)."""
    experiment = on.experiment
    r = experiment.recording
    v = measured_velocity(r)
    smooth = _smooth(v, max(3, int(0.002 / r.dt)))
    every = slice(None, None, fitter.view.decimate)
    speed = smooth[every]
    angular = fitter.nominal.chain.motion.value == "hinge"
    unit_v, unit_q, unit_t = ("rad/s", "rad", "N m") if angular else ("m/s", "m", "N")
    out = {
        "velocity": (speed, unit_v),
        "|velocity|": (np.abs(speed), unit_v),
    }
    if r.driven:
        follows = _target(fitter.nominal.chain)
        unit = unit_t if r.command is None else unit_v if follows is Target.VELOCITY else unit_q
        out["torque command" if r.command is None else "servo error"] = (_input(fitter.nominal.chain, r)[every], unit)
    accel = np.gradient(smooth, r.dt)[every]
    out["acceleration"] = (accel, f"{unit_v}/s")
    if r.angle is not None:
        q = r.angle[every]
        out["angle"] = (q, unit_q)
        for k, order in enumerate(fitter.orders[:2]):
            out[f"phase of order {order:.4g}" if k else f"phase of order {order:.4g} of the angle"] = (
                np.mod(order * q, 2 * np.pi), "rad",
            )  # fmt: skip
    chain = on.axis.chain
    if chain.couplings and fitter.view.channel != "torque":
        y = free_run(on.axis, experiment)
        for j, c in enumerate(chain.couplings):
            if j < y.q.shape[1] - 1:
                out[f"deflection at {c.place}"] = (c.ratio * y.q[:, j] - y.q[:, j + 1], "rad")
    out["time"] = (r.time[every], "s")
    return out


def _target(chain: Chain) -> Target | None:
    return None if chain.servo is None else chain.servo.target


def _input(chain: Chain, r: Recording) -> np.ndarray:
    """The input (N,): the torque, or how far the motion is behind the command of a servo."""
    if r.command is None or chain.servo is None:
        return r.torque
    if chain.servo.target is Target.VELOCITY:
        error: np.ndarray = chain.servo.scale * r.command - chain.servo.zero - measured_velocity(r)
    else:
        error = r.command - measured_angle(r)
    return error


def _smooth(x: np.ndarray, width: int) -> np.ndarray:
    kernel = np.hanning(width + 2)[1:-1]
    return np.convolve(x, kernel / kernel.sum(), mode="same")


class Bins:
    """Samples of a state x (M,) in bins of equal numbers, split at zero, so that a jump there stays sharp.

    None (``centre`` (0,)) where the samples are few or all alike.
    """

    def __init__(self, x: np.ndarray, count: int = 24) -> None:
        self.count, self.centre = 0, np.empty(0)
        if len(x) < 10 * count or np.ptp(x) == 0:
            return
        edges = np.quantile(x, np.linspace(0, 1, count + 1))
        if edges[0] < 0 < edges[-1]:
            edges[np.argmin(np.abs(edges[1:-1])) + 1] = 0.0
        edges = np.unique(edges)
        self.count = len(edges) - 1
        index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, self.count - 1)
        half = (np.arange(len(x)) * 20 // len(x)) % 2  # of interleaved stretches: each judges the function of the other
        self._in = index + self.count * half
        self._size = np.bincount(self._in, minlength=2 * self.count).reshape(2, -1)
        self.centre = self._sums(x).sum(axis=0) / np.maximum(self._size.sum(axis=0), 1)

    def _sums(self, y: np.ndarray) -> np.ndarray:
        return np.bincount(self._in, y, 2 * self.count).reshape(2, -1)

    def explained(self, y: np.ndarray) -> float:
        """Share (>= 0) of the variance of y (M,) that a function of x explains, cross-validated between the halves."""
        if not self.count:
            return 0.0
        y = y - y.mean()
        sums, size = self._sums(y), self._size
        means = np.where(size > 0, sums / np.maximum(size, 1), sums.sum(axis=1, keepdims=True) / size.sum(axis=1, keepdims=True))
        other = means[::-1]
        return max(0.0, float(np.sum(2 * other * sums - other**2 * size)) / max(float(y @ y), 1e-300))

    def function(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means of y (M,) over the bins, and their standard errors."""
        if not self.count:
            return np.empty(0), np.empty(0)
        size = np.maximum(self._size.sum(axis=0), 1)
        mean = self._sums(y).sum(axis=0) / size
        return mean, np.sqrt(np.maximum(self._sums(y**2).sum(axis=0) / size - mean**2, 0) / size)


def locate(fitter: Fitter, fitted: Fitted) -> tuple[Mismatch, ...]:
    """Time, frequency, state and place of what a fitted model leaves, for every recording; the first one is for estimation."""
    return tuple(fitter.map([partial(_located, fitter, on) for on in played(fitter, fitted)]))


def _located(fitter: Fitter, on: Played) -> Mismatch:
    experiment, e = on.experiment, on.e
    counted = fitter.counted(experiment)
    every = fitter.view.decimate
    dt = experiment.recording.dt * every
    noise = fitter.noise.floor(noise_rms(fitter, experiment) ** 2, 0.0)
    energy = float(np.mean(e[counted] ** 2))
    above = max(0.0, 1.0 - noise / energy) if energy > 0 else 0.0
    spectrum, linear = _spectrum(fitter, experiment, e, dt)
    of_states, of_places = _state_shares(fitter, on, counted, states(fitter, on))
    return Mismatch(
        time=_time_shares(experiment.recording.time[::every][: len(e)], e, counted, noise),
        frequency=_frequency_shares(*spectrum[:3]),
        state=of_states,
        place=of_places,
        spectrum=spectrum,
        above_noise=above,
        linear_share=linear,
        source=experiment.recording.source,
        role=on.role,
        energy=above * energy * int(counted.sum()) / fitter.sigma(experiment) ** 2,
    )


def _time_shares(time: np.ndarray, e: np.ndarray, counted: np.ndarray, noise: float, pieces: int = 20) -> tuple[Share, ...]:
    """Energy above noise in stretches of equal length, strongest first, those with more than their even share."""
    out = []
    excess = np.where(counted, e**2 - noise, 0.0)
    total = float(np.sum(np.maximum([np.sum(p) for p in np.array_split(excess, pieces)], 0))) or 1.0
    for t, p in zip(np.array_split(time, pieces), np.array_split(excess, pieces), strict=True):
        share = max(0.0, float(np.sum(p))) / total
        if share > 1.5 / pieces:
            out.append(Share(float(t[0]), float(t[-1]), share))
    return tuple(sorted(out, key=lambda s: -s.share)[:6])


def _spectrum(
    fitter: Fitter, experiment: Experiment, e: np.ndarray, dt: float
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], float]:
    """(frequency, residual, noise and output psd), and the share of the residual coherent with the input."""
    every = fitter.view.decimate
    r = experiment.recording
    y = {"torque": r.torque, "angle": r.angle}.get(fitter.view.channel)
    y = measured_velocity(r) if y is None else y
    y, u = y[::every][: len(e)], r.input[::every][: len(e)]
    segment = min(len(e) // 2, max(256, 2 ** int(np.log2(len(e) / 6))))  # by one segment alone all is coherent
    f, pe = welch(e, dt, segment, level=True)
    _, py = welch(y, dt, segment)
    c = coherence(u, e, segment)
    count = 2 * len(e) / segment - 1
    c = np.maximum(0.0, (c - 1 / count) / (1 - 1 / count))
    pn = noise_psd(fitter, experiment, 2 * np.pi * f * dt) * 2 * dt if fitter.noise.absolute else np.zeros_like(f)
    excess = np.maximum(pe - pn, 0)
    total = float(np.sum(excess))
    return (f, pe, pn, py), float(np.sum(excess * c) / total) if total > 0 else 0.0


def _frequency_shares(f: np.ndarray, pe: np.ndarray, pn: np.ndarray) -> tuple[Share, ...]:
    """Contiguous bands that hold the residual's energy above noise, strongest first."""
    excess = np.maximum(pe - 1.5 * pn, 0.0)
    total = float(np.sum(excess))
    if total <= 0:
        return ()
    out: list[Share] = []
    threshold = 0.1 * float(np.max(excess))
    inside = excess > threshold
    start = None
    for i in range(len(f) + 1):
        on = i < len(f) and inside[i]
        if on and start is None:
            start = i
        if not on and start is not None:
            out.append(Share(float(f[start]), float(f[i - 1] + (f[1] - f[0])), float(np.sum(excess[start:i]) / total)))
            start = None
    return tuple(sorted(out, key=lambda s: -s.share)[:5])


def _state_shares(
    fitter: Fitter, on: Played, counted: np.ndarray, known: dict[str, tuple[np.ndarray, str]]
) -> tuple[tuple[StateShare, ...], tuple[Place, ...]]:
    """How much of the torque that would close the gap each state explains; and for every place the largest part one state does.

    The places are the bodies, with how large a torque there would close the gap, and the sensor.
    """
    chain = fitter.nominal.chain
    bins = {name: Bins(x[: len(on.e)][counted]) for name, (x, _) in known.items()}
    table: Sequence[tuple[str, int]] = [
        (p, i) for p in ("motor", "gearbox", "arm") if (i := chain.body(p)) is not None and (i > 0 or p == "motor")
    ]
    unit = "N m" if chain.motion.value == "hinge" else "N"
    needed = {body: disturbance(fitter, on, body)[counted] for body in {0, *(i for _, i in table)}}
    out = []
    for name, of in bins.items():
        mean, error = of.function(needed[0])
        out.append(StateShare(name, known[name][1], of.explained(needed[0]), of.centre, mean, error))

    def place(name: str, element: str, y: np.ndarray, unit: str) -> Place:
        shares = {state: of.explained(y) for state, of in bins.items()}
        by = max(shares, key=lambda state: shares[state])
        return Place(name, element, float(np.sqrt(np.mean(y**2))), unit, shares[by], by if shares[by] > 0 else "nothing")

    places = [place(p, chain.element(p), needed[body], unit) for p, body in table]
    sensor = chain.angle_sensor if fitter.view.channel == "angle" else chain.velocity_sensor
    places.append(place("sensor", sensor, on.e[counted], "as the channel"))
    return tuple(sorted(out, key=lambda s: -s.share)), tuple(sorted(places, key=lambda p: -p.explained))
