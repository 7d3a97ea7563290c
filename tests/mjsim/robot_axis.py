"""The study's axis and experiment for tests."""

from __future__ import annotations

import numpy as np

from mjsim.axis import Axis, Body, Chain, Coupling
from mjsim.effects import BacklashLaw, Effect, effect_class

DT = 5e-4

CHAIN = Chain(
    bodies=(Body("motor", 4.56e-4, 3.55e-2, "motor"), Body("gearbox", 9.92, 0.0, "gearbox"), Body("arm", 1.72, 0.0, "arm")),
    couplings=(Coupling("gearbox", 1 / 118, 1.5e5, -62.0, "gearbox"), Coupling("arm", 1.0, 0.446e5, 20.0, "arm")),
)


def axis(*effects: Effect, law: BacklashLaw = BacklashLaw.GATED) -> Axis:
    return Axis(CHAIN, effects, law)


def effect(name: str, **parameters: float | str) -> Effect:
    return effect_class(name)(**parameters)  # type: ignore[arg-type]


def chirp(duration: float = 10.0, top: float = 30.0, amplitude: float = 1.0, dt: float = DT) -> np.ndarray:
    t = np.arange(round(duration / dt)) * dt
    return amplitude * np.sin(2 * np.pi * (0.5 * t + (top - 0.5) / (2 * duration) * t * t))


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)))
