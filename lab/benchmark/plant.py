"""The sealed plant: an axis with its laws, driven by an experiment, read by a measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lab.benchmark.experiment import RATE, Experiment
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.solver import run
from mjsim.errors import InputError

__all__ = ["SUBSTEPS", "Motion", "free_run", "record"]

SUBSTEPS = 100  # solver steps a row: 5 us; its error is shown by halving in tests/benchmark


@dataclass(frozen=True)
class Motion:
    """Logged torque [Nm], measured and true motor velocity [rad/s], measured and true motor angle [rad] at ``RATE``.

    ``end`` is the state one row after the last: angles of motor, gearbox, arm and split-off mass, then their speeds.
    """

    torque: np.ndarray
    velocity: np.ndarray
    velocity_true: np.ndarray
    angle: np.ndarray
    angle_true: np.ndarray
    end: np.ndarray

    def __post_init__(self) -> None:
        for name in ("torque", "velocity", "velocity_true", "angle", "angle_true", "end"):
            getattr(self, name).flags.writeable = False

    @property
    def time(self) -> np.ndarray:
        """Time of the rows [s]."""
        return np.arange(self.torque.size) / RATE


def _motion(result: tuple[np.ndarray, ...]) -> Motion:
    motion = Motion(*result)
    if not np.all(np.isfinite(motion.velocity)) or np.max(np.abs(motion.velocity_true)) > 1e4:
        raise InputError("plant", "the motion diverges", "a stable axis", "lower the controller's gains or the torque")
    return motion


def record(
    laws: Laws,
    experiment: Experiment,
    measurement: Measurement,
    rng: np.random.Generator,
    *,
    substeps: int = SUBSTEPS,
) -> Motion:
    """Run an experiment from rest and record it with its noise."""
    laws = laws._replace(
        encoder_step=measurement.encoder_step,
        sen_step=max(laws.sen_step, measurement.velocity_step),
        repeat_amplitude=measurement.repeat_amplitude,
        repeat_cycles=measurement.repeat_cycles,
        repeat_phase=measurement.repeat_phase,
    )
    noise_v, noise_a, drop = measurement.noise(experiment.torque.size, rng)
    e = experiment
    return _motion(run(laws, e.torque, e.speed_set, e.kp, e.ki, e.closed, e.feed_noise, noise_v, noise_a, drop, RATE, substeps))


def free_run(laws: Laws, torque: np.ndarray, *, substeps: int = SUBSTEPS) -> Motion:
    """Run the axis open loop and noise-free on a held torque [Nm] (say, a logged one)."""
    none = np.zeros(torque.size)
    still = np.zeros(torque.size, np.int8)
    return _motion(run(laws, torque, none, 0.0, 0.0, False, False, none, none, still, RATE, substeps))
