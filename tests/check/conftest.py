"""A pendulum whose parameters are off by some per cent, recorded for a few seconds: the sound log that faults are laid on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from diagnose.check import LogCheck, Machine, check_log
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import effect_class
from mjsim.excitation import Grid, multisine
from mjsim.ode import simulate
from mjsim.recording import Recording

FINE = 4000
SECONDS = 4.0


def _axis(inertia: float, viscous: float, friction: float, weight: float, gain: float = 1.0) -> Axis:
    return Axis(
        Chain((Body("motor", inertia, viscous, "pivot"),), (), gain=gain),
        (
            effect_class("coulomb_friction")(place="motor", torque_Nm=friction),
            effect_class("gravity_load")(place="arm", torque_Nm=weight, phase_rad=0.0),
        ),
    )


NOMINAL = _axis(0.18, 0.08, 0.1, 4.0)
TRUE = (0.2, 0.07, 0.12, 4.4)


@lru_cache(16)
def _motion(rate: int, between: str, gain: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Logged torque (N,), and velocity and angle on the fine grid."""
    u = multisine(np.random.default_rng(3), SECONDS, 1 / rate, 1.8 / gain, 0.3, 8.0, period=4.0, grid=Grid.FULL)
    every = FINE // rate
    fine = np.repeat(u, every)
    if between != "held":
        fine = np.interp((np.arange(len(fine)) + 0.5) / every, np.arange(len(u)), u)
    run = simulate(_axis(*TRUE, gain=gain), fine, 1 / FINE)
    if between == "mean":
        u = np.concatenate([[fine[0]], fine.reshape(-1, every).mean(axis=1)[:-1]])
    return u, run.velocity, run.angle


@pytest.fixture(scope="session")
def log() -> Callable[..., Recording]:
    """``log(rate=500, late=0.0, between="held", seed=0, gain=1)``: motion ``late`` [s] against the torque, with white noise."""

    def make(rate: int = 500, late: float = 0.0, between: str = "held", seed: int = 0, gain: float = 1.0) -> Recording:
        u, v, q = _motion(rate, between, gain)
        rng = np.random.default_rng(seed)
        fine, t = np.arange(len(v)) / FINE, np.arange(len(u)) / rate
        inside = (t - late >= 0) & (t - late <= fine[-1])
        noisy = [
            np.interp(t - late, fine, x) + part * np.std(x) * rng.standard_normal(len(t)) for x, part in ((v, 0.01), (q, 0.001))
        ]
        count = int(np.sum(inside))
        return Recording(
            np.arange(count) / rate, u[inside], noisy[0][inside], noisy[1][inside], 1 / rate, source="log.csv",
            units={"torque": "Nm", "velocity": "rad/s", "angle": "rad"},
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def machine() -> Callable[..., Machine]:
    """``machine(gain=1, range=None)``: the nominal pendulum, its inertia, friction and weight 10 to 20 % off."""

    def make(gain: float = 1.0, range: tuple[float, float] | None = None) -> Machine:
        return Machine(dataclasses.replace(NOMINAL, chain=dataclasses.replace(NOMINAL.chain, gain=gain)), range)

    return make


@pytest.fixture(scope="session")
def checked(machine) -> Callable[..., LogCheck]:
    """``checked(recording, **of_machine)``."""
    return lambda recording, **options: check_log(machine(**options), [recording])
