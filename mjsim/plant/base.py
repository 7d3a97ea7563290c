"""The interface of a plant: sites and signals, parameters, free run, inverse, linear model, cost, numerical tolerance."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from mjsim.errors import InputError
from mjsim.quantity import Motion, Quantity
from mjsim.recording import Recording

__all__ = [
    "Hold",
    "Linear",
    "Parameter",
    "Plant",
    "Side",
    "Signal",
    "Site",
    "Start",
    "as_input",
    "check_units",
    "mean_input",
    "signals_of",
]


class Hold(enum.Enum):
    """How the input goes between log samples.

    HELD: u[k] acts from sample k to sample k + 1. LINEAR: straight lines between samples. MEAN: u[k] is the mean over the
    interval that ends at sample k.
    """

    HELD = "held"
    LINEAR = "linear"
    MEAN = "mean"


class Side(enum.Enum):
    """Side of a joint's transmission on which a signal is measured."""

    DRIVE = "drive"
    LINK = "link"


@dataclass(frozen=True)
class Site:
    """Where a signal acts or is measured: an MJCF joint and the side of its transmission."""

    joint: str
    side: Side = Side.DRIVE


@dataclass(frozen=True)
class Signal:
    """One column of an input or output: ``role`` (torque, command, velocity, angle), its site and SI unit."""

    role: str
    site: Site
    unit: str


@dataclass(frozen=True)
class Parameter:
    """A number of a plant: its name (``Jm``, or ``id@place.name`` of an effect), value in SI and unit."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class Start:
    """State at the first sample: angle [rad | m] and velocity [rad/s | m/s] of the driven body.

    input: input that acts ahead of the first sample, which a delay or lag still delivers. deflections, rates: of the couplings
    behind the driven body, in their order, d_j = r_j q_j - q_{j+1}; zero of those that are not given. states: numbers of effects
    that each run has of its own (`Effect.start_parameter`), by ``id@place.name``; those of the model where they are not given.
    """

    angle: float = 0.0
    velocity: float = 0.0
    input: float = 0.0
    deflections: tuple[float, ...] = ()
    rates: tuple[float, ...] = ()
    states: tuple[tuple[str, float], ...] = ()

    def of_bodies(self, ratios: Sequence[float]) -> np.ndarray:
        """Angles and velocities (2, n) of the bodies of a chain, by the ratios (n - 1) of its couplings."""
        out = np.zeros((2, len(ratios) + 1))
        out[:, 0] = self.angle, self.velocity
        for j, ratio in enumerate(ratios):
            out[:, j + 1] = ratio * out[:, j]
            for row, values in enumerate((self.deflections, self.rates)):
                if j < len(values):
                    out[row, j + 1] -= values[j]
        return out


@dataclass(frozen=True, eq=False)
class Linear:
    """Discrete linear model x[k+1] = a x[k] + b u[k], y[k] = c x[k] for an input held over each sample of dt [s].

    a (s, s), b (s, m), c (p, s), in SI; x is the deviation from the state about which the plant was linearised.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    dt: float

    def run(self, u: np.ndarray) -> np.ndarray:
        """Outputs (N, p) from rest on inputs (N, m)."""
        x, out = np.zeros(len(self.a)), np.empty((len(u), len(self.c)))
        for k, now in enumerate(u):
            out[k] = self.c @ x
            x = self.a @ x + self.b @ now
        return out


class Plant(Protocol):
    """A model that can be run on an input.

    Inputs are arrays (N, m), outputs (N, p), one column for each `Signal`, one row for each sample of dt [s].
    """

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The m inputs."""

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """The p outputs."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The numbers that `with_values` can change."""

    @property
    def tolerance(self) -> float:
        """Numerical error of a free run: relative RMS of the velocity against the exact solution of the plant's own equations."""

    def with_values(self, values: Mapping[str, float]) -> Self:
        """A copy with some parameters replaced. Raises KeyError for a name that it does not have."""

    def run(self, u: np.ndarray, dt: float, *, start: Start | None = None, hold: Hold = Hold.HELD) -> np.ndarray:
        """Outputs (N, p) of a free run on inputs (N, m). Raises ValueError for shapes, DivergedError when it diverges."""

    def inverse(self, y: np.ndarray, dt: float, *, start: Start | None = None) -> np.ndarray:
        """Inputs (N, m), held over each sample, that make the outputs (N, p) of the driven body. Raises DivergedError."""

    def linearised(self, dt: float, *, start: Start | None = None) -> Linear:
        """Linear model about a state of rest. Raises ValueError where states are hidden (delays, bristles)."""

    def cost(self, dt: float) -> float:
        """Time that a sample of dt [s] takes [us], by nominal figures that are the same on every machine."""


def as_input(u: np.ndarray, columns: int) -> np.ndarray:
    """Inputs as an array (N, m). Raises ValueError for another shape or a value that is not finite."""
    u = np.asarray(u, float)
    if u.ndim != 2 or u.shape[1] != columns or len(u) < 2:
        raise ValueError(f"input has shape {u.shape}; expected (N, {columns}) with N >= 2")
    if not np.isfinite(u).all():
        raise ValueError(f"input is not finite at sample {int(np.argmin(np.isfinite(u).all(axis=1)))}")
    return u


def mean_input(u: np.ndarray, dt: float, step: float, count: int, hold: Hold) -> np.ndarray:
    """Mean of an input (N, m), sampled at dt [s], over each of ``count`` steps of ``step`` [s]; the last value goes on."""
    n = len(u)
    if hold is Hold.MEAN:
        u = np.vstack([u[1:], u[-1:]])
    if hold is Hold.HELD or hold is Hold.MEAN:
        steps = dt / step
        if abs(steps - round(steps)) < 1e-6 and round(steps) >= 1:
            return np.repeat(u, round(steps), axis=0)[:count] if count <= n * round(steps) else _tail(u, round(steps), count)
    t = step * np.arange(count + 1) / dt  # in samples
    k = np.minimum(t.astype(int), n - 1)
    g = (t - k)[:, None]
    following = np.vstack([u[1:], u[-1:]])
    whole = u if hold is not Hold.LINEAR else 0.5 * (u + following)
    integral = np.vstack([np.zeros((1, u.shape[1])), np.cumsum(whole, axis=0)])
    slope = np.zeros_like(u) if hold is not Hold.LINEAR else following - u
    reached = integral[k] + u[k] * g + 0.5 * slope[k] * g**2
    return np.asarray(np.diff(reached, axis=0) * dt / step)


def _tail(u: np.ndarray, steps: int, count: int) -> np.ndarray:
    held = np.repeat(u, steps, axis=0)
    return np.vstack([held, np.repeat(u[-1:], count - len(held), axis=0)])


def signals_of(joint: str, motion: Motion, role: str) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
    """Inputs and outputs of a plant with one driven joint; ``role`` of its input: torque or command."""
    site = Site(joint)
    unit = Quantity.TORQUE.unit(motion) if role == "torque" else "1"
    velocity, angle = ("rad/s", "rad") if motion is Motion.HINGE else ("m/s", "m")
    return (Signal(role, site, unit),), (Signal("velocity", site, velocity), Signal("angle", site, angle))


def check_units(plant: Plant, recording: Recording) -> None:
    """Compare the SI units that a binding states with the plant's. Raises InputError where they differ (a slide read in rad)."""
    for signal in (*plant.inputs, *plant.outputs):
        stated = recording.units.get(signal.role, "").replace(" ", "")
        if stated and signal.unit != "1" and stated != signal.unit.replace(" ", ""):
            raise InputError(
                recording.source, f"{signal.role} is in {stated}", f"{signal.unit}, as joint {signal.site.joint!r} moves",
                "correct the unit in the binding, or bind another joint",
            )  # fmt: skip
