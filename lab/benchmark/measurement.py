"""What the recorder adds: noise of several colours, an error over the turn, quantisation, repeated rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

__all__ = ["Measurement"]


@dataclass(frozen=True)
class Measurement:
    """Noise of velocity [rad/s] and angle [rad]; coloured by 1/A(q) with the poles given, scaled to the rms stated.

    ``encoder_step`` [rad] and ``velocity_step`` [rad/s] quantise; the encoder's error over one turn is
    ``repeat_amplitude`` sin(``repeat_cycles`` angle + ``repeat_phase``) [rad], and the velocity shows its derivative.
    """

    velocity_noise: float = 0.05
    angle_noise: float = 1e-4
    poles: tuple[complex, ...] = ()
    encoder_step: float = 0.0
    velocity_step: float = 0.0
    repeat_amplitude: float = 0.0
    repeat_cycles: float = 0.0
    repeat_phase: float = 0.0
    dropped: float = 0.0  # probability that a row starts a hold of the sensor
    hold: int = 0  # rows of a hold

    @property
    def kind(self) -> str:
        """The kind of noise in a word."""
        if self.repeat_amplitude > 0.0:
            return "repetitive"
        if self.velocity_step > 0.0 or self.encoder_step > 0.0:
            return "quantised"
        return "white" if not self.poles else f"ar{len(self.poles)}"

    @property
    def floor(self) -> float:
        """Rms of what no model can predict in the velocity [rad/s]: its noise and the rounding to steps."""
        return float(np.hypot(self.velocity_noise, self.velocity_step / np.sqrt(12)))

    def noise(self, rows: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw velocity noise, angle noise and the rows at which the sensor repeats itself."""
        e = rng.standard_normal(rows + 2000)
        if self.poles:
            a = np.real(np.poly(self.poles))
            impulse = signal.lfilter([1.0], a, np.eye(1, 20000)[0])
            e = signal.lfilter([1.0], a, e) / np.sqrt(np.sum(impulse * impulse))
        angle = rng.standard_normal(rows)
        drop = np.zeros(rows, np.int8)
        if self.dropped > 0.0:
            for row in np.flatnonzero(rng.random(rows) < self.dropped):
                drop[row : row + self.hold] = 1
        return self.velocity_noise * e[2000:], self.angle_noise * angle, drop
