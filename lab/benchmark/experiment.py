"""Experiments: how the axis is driven. Open loop by a torque, or in closed loop by a velocity profile under a PI law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

__all__ = [
    "EXCITATIONS",
    "RATE",
    "Experiment",
    "chirp",
    "draw_experiment",
    "log_uniform",
    "multisine",
    "speed_multisine",
    "steps",
    "trapezoid",
]

RATE = 2000.0  # rows a second [Hz]


@dataclass(frozen=True)
class Experiment:
    """One drive of the axis: torque [Nm] (a feed-forward in closed loop) and velocity set point [rad/s], row by row."""

    excitation: str
    torque: np.ndarray
    speed_set: np.ndarray
    closed: bool = False
    kp: float = 0.0  # [Nm s/rad]
    ki: float = 0.0  # [Nm/rad]
    feed_noise: bool = False  # the controller sees the sensor's noise
    settings: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.torque.flags.writeable = False
        self.speed_set.flags.writeable = False


def _open(name: str, u: np.ndarray, **settings: float) -> Experiment:
    """An open-loop experiment, its torque rounded to what the log keeps (7 digits), so that the log is the input."""
    u = np.array([float(f"{x:.7g}") for x in u])
    return Experiment(name, u, np.zeros_like(u), settings=settings)


def chirp(seconds: float, amplitude: float, f0: float, f1: float) -> Experiment:
    """A sin(2 pi (f0 t + (f1 - f0) t^2 / (2 T))) [Nm], linear from f0 to f1 [Hz]."""
    t = np.arange(round(seconds * RATE)) / RATE
    u = amplitude * np.sin(2 * np.pi * (f0 * t + (f1 - f0) * t * t / (2 * seconds)))
    return _open("chirp", u, amplitude_Nm=amplitude, f0_Hz=f0, f1_Hz=f1)


def multisine(seconds: float, rms: float, f0: float, f1: float, rng: np.random.Generator) -> Experiment:
    """All harmonics of 1/T between f0 and f1 [Hz] with one amplitude and random phases, of the given rms [Nm]."""
    n = round(seconds * RATE)
    lines = np.arange(max(int(np.ceil(f0 * seconds)), 1), int(f1 * seconds) + 1)
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    u = np.fft.irfft(spectrum, n)
    return _open("multisine", rms * u / np.sqrt(np.mean(u * u)), rms_Nm=rms, f0_Hz=f0, f1_Hz=f1)


def steps(seconds: float, amplitude: float, dwell: float, rng: np.random.Generator) -> Experiment:
    """Torque levels drawn within +-amplitude [Nm], each held between half and twice the dwell [s]; the mean is taken off."""
    n = round(seconds * RATE)
    u = np.zeros(n)
    row = 0
    while row < n:
        hold = max(round(dwell * RATE * 2 ** rng.uniform(-1, 1)), 1)
        u[row : row + hold] = amplitude * rng.uniform(-1, 1)
        row += hold
    return _open("steps", u - u.mean(), amplitude_Nm=amplitude, dwell_s=dwell)


def trapezoid(seconds: float, speed: float, kp: float, ki: float, feed_noise: bool, rng: np.random.Generator) -> Experiment:
    """Velocity levels within +-speed [rad/s], joined by ramps, followed by a PI law on the measured motor velocity."""
    n = round(seconds * RATE)
    knots_t, knots_v = [0.0], [0.0]
    while knots_t[-1] < seconds:
        level = speed * rng.uniform(-1, 1)
        knots_t += [knots_t[-1] + rng.uniform(0.15, 0.6)]
        knots_v += [level]
        knots_t += [knots_t[-1] + rng.uniform(0.2, 1.0)]
        knots_v += [level]
    v = np.interp(np.arange(n) / RATE, knots_t, knots_v)
    settings = {"speed_rad_s": speed, "kp_Nms_rad": kp, "ki_Nm_rad": ki, "noise_in_loop": float(feed_noise)}
    return Experiment("trapezoid", np.zeros(n), v, True, kp, ki, feed_noise, settings)


def speed_multisine(seconds: float, rms: float, f1: float, kp: float, ki: float, rng: np.random.Generator) -> Experiment:
    """A random-phase multisine up to f1 [Hz] as velocity set point of the given rms [rad/s], followed by a PI law."""
    v = multisine(seconds, rms, 0.1, f1, rng).torque.copy()
    v -= v[0] * np.exp(-np.arange(v.size) / (0.2 * RATE))  # starts at rest
    settings = {"rms_rad_s": rms, "f1_Hz": f1, "kp_Nms_rad": kp, "ki_Nm_rad": ki, "noise_in_loop": 1.0}
    return Experiment("speed_multisine", np.zeros_like(v), v, True, kp, ki, True, settings)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between low and high, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _draw_chirp(rng: np.random.Generator, seconds: float, amplitude: float) -> Experiment:
    f0, f1 = 0.5, float(rng.choice([30.0, 30.0, 45.0]))
    if rng.random() < 0.2:
        f0, f1 = f1, f0
    return chirp(seconds, amplitude, f0, f1)


def _draw_multisine(rng: np.random.Generator, seconds: float, amplitude: float) -> Experiment:
    return multisine(seconds, 0.6 * amplitude, 0.1, float(rng.choice([30.0, 40.0, 60.0])), rng)


def _draw_steps(rng: np.random.Generator, seconds: float, amplitude: float) -> Experiment:
    return steps(seconds, amplitude, log_uniform(rng, 0.03, 0.3), rng)


def _draw_trapezoid(rng: np.random.Generator, seconds: float, amplitude: float) -> Experiment:
    kp = log_uniform(rng, 0.02, 0.15)
    noisy = bool(rng.random() < 0.7)
    return trapezoid(seconds, 20.0 * amplitude, kp, kp * log_uniform(rng, 0.3, 5.0), noisy, rng)


def _draw_speed_multisine(rng: np.random.Generator, seconds: float, amplitude: float) -> Experiment:
    kp = log_uniform(rng, 0.05, 0.2)
    f1 = float(rng.choice([8.0, 15.0, 30.0]))
    return speed_multisine(seconds, 6.0 * amplitude, f1, kp, kp * log_uniform(rng, 0.5, 5.0), rng)


EXCITATIONS: dict[str, Callable[[np.random.Generator, float, float], Experiment]] = {
    "chirp": _draw_chirp,
    "multisine": _draw_multisine,
    "steps": _draw_steps,
    "trapezoid": _draw_trapezoid,
    "speed_multisine": _draw_speed_multisine,
}


def draw_experiment(kind: str, rng: np.random.Generator, amplitude: float, seconds: float = 10.0) -> Experiment:
    """Draw an experiment of the kind named; ``amplitude`` [Nm] sets its strength, the other settings are random.

    In closed loop the speed goes with it: 20 rad/s (trapezoid) or 6 rad/s rms (multisine) per Nm.
    """
    return EXCITATIONS[kind](rng, seconds, amplitude)
