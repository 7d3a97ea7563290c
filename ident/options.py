"""Validated options of the estimators; each default with its MATLAB equivalent."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from mjsim.errors import InputError

__all__ = ["Focus", "InitialCondition", "Options", "SearchOptions"]


class InitialCondition(Enum):
    """What the filters hold before the first sample (MATLAB option ``InitialCondition``)."""

    AUTO = "auto"
    """Zero, unless estimated initial conditions lower the loss significantly (F test at 99.9 %). MATLAB's default, 'auto'."""
    ZERO = "zero"
    ESTIMATE = "estimate"
    """Further parameters of the search: exact Gauss-Newton in all of them."""
    BACKCAST = "backcast"
    """Best least-squares fit at the present coefficients, in turn with the search over these."""


class Focus(Enum):
    """What is made small (MATLAB option ``Focus``)."""

    PREDICTION = "prediction"
    """The one-step prediction error. MATLAB's default."""
    SIMULATION = "simulation"
    """The simulation error for B and F; the noise model is fitted afterwards with these held."""


@dataclass(frozen=True)
class SearchOptions:
    """The Levenberg-Marquardt search.

    max_iterations: per start (MATLAB ``SearchOptions.MaxIterations`` = 20; here 100, as an iteration costs milliseconds).
    tolerance: stop when the relative loss decrease that Gauss-Newton predicts falls below it (MATLAB ``Tolerance`` 0.01 is in per
    cent, that is 1e-4; here 1e-11: one iteration more, and the response is that of the minimum to six digits).
    starts: at most so many initial values are followed to their minimum. The search ends early when two agree.
    noise_radius: the roots of C stay within it. On data without power in a band (a low-pass before, a simulation without
    noise) the best C runs to the unit circle and beyond use; the limit keeps the problem well posed. MATLAB limits it to 1.
    """

    max_iterations: int = 100
    tolerance: float = 1e-11
    starts: int = 4
    noise_radius: float = 0.98

    def __post_init__(self) -> None:
        if not 1 <= self.max_iterations <= 100_000:
            raise InputError("max_iterations", f"{self.max_iterations}", "1 to 100000")
        if not 0.0 < self.tolerance < 1.0:
            raise InputError("tolerance", f"{self.tolerance}", "a number between 0 and 1")
        if not 0.5 <= self.noise_radius <= 1.0:
            raise InputError("noise_radius", f"{self.noise_radius}", "0.5 to 1")
        if not 1 <= self.starts <= 20:
            raise InputError("starts", f"{self.starts}", "1 to 20")


@dataclass(frozen=True)
class Options:
    """How an estimator works.

    initial_condition: MATLAB ``InitialCondition``, default 'auto'.
    focus: MATLAB ``Focus``, default 'prediction'.
    prefilter: numerator and denominator in q^-1 of a filter put on both channels first (MATLAB ``WeightingFilter``), or None.
    accept_clipping: fit an output that sits at its limits for runs of samples too (MATLAB does not look).
    """

    initial_condition: InitialCondition = InitialCondition.AUTO
    focus: Focus = Focus.PREDICTION
    prefilter: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    search: SearchOptions = field(default_factory=SearchOptions)
    accept_clipping: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.initial_condition, InitialCondition):
            raise InputError("initial_condition", repr(self.initial_condition), "one of " + ", ".join(map(str, InitialCondition)))
        if not isinstance(self.focus, Focus):
            raise InputError("focus", repr(self.focus), "one of " + ", ".join(map(str, Focus)))
