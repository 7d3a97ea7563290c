"""Parts of a scenario's file: excitations and noise, each a validated table."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from mjsim import excitation as ex

__all__ = ["Chirp", "Multisine", "Noise", "NotNegative", "Positive", "Step", "Strict", "Trapezoids"]


class Strict(BaseModel):
    """A table without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class Chirp(Strict):
    """Linear chirp of constant amplitude [N m | N]."""

    kind: Literal["chirp"]
    amplitude: Positive
    low_hz: Positive = 0.5
    high_hz: Positive = 30.0

    def torque(self, duration: float, dt: float, rng: np.random.Generator) -> np.ndarray:
        """Commanded torque (N,)."""
        return ex.chirp(duration, dt, self.amplitude, self.low_hz, self.high_hz)


class Multisine(Strict):
    """Random-phase multisine of this rms [N m | N], periodic."""

    kind: Literal["multisine"]
    rms: Positive
    low_hz: Positive = 0.5
    high_hz: Positive = 45.0
    period_s: Positive = 5.0
    grid: Literal["full", "odd"] = "full"

    def torque(self, duration: float, dt: float, rng: np.random.Generator) -> np.ndarray:
        """Commanded torque (N,)."""
        return ex.multisine(rng, duration, dt, self.rms, self.low_hz, self.high_hz, period=self.period_s, grid=ex.Grid(self.grid))


class Step(Strict):
    """A torque step."""

    kind: Literal["step"]
    amplitude: float
    at_s: NotNegative = 0.5

    def torque(self, duration: float, dt: float, rng: np.random.Generator) -> np.ndarray:
        """Commanded torque (N,)."""
        return ex.step(duration, dt, self.amplitude, self.at_s)


class Trapezoids(Strict):
    """A velocity loop (P-PI cascade) that follows trapezoids to and fro."""

    kind: Literal["trapezoids"]
    speed: Positive
    acceleration: Positive
    hold_s: NotNegative = 1.0
    rest_s: NotNegative = 0.5
    position_gain: NotNegative
    velocity_gain: Positive
    integral_gain: NotNegative
    limit: Positive

    @property
    def cascade(self) -> ex.Cascade:
        """The controller."""
        return ex.Cascade(self.position_gain, self.velocity_gain, self.integral_gain, self.limit)


class Noise(Strict):
    """Standard deviations of the white noise on the logged channels, in the log's units."""

    velocity: NotNegative = 0.0
    angle: NotNegative = 0.0
    torque: NotNegative = 0.0
