"""A fitted hypothesis, and what it leaves on held-out data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.fit.least_squares import Fit, Status
from diagnose.problem.hypothesis import Hypothesis
from diagnose.problem.noise_model import NoiseModel
from diagnose.problem.start_state import is_of_start
from diagnose.thresholds import BLOCKS, ENGINE, UNEXPLAINED
from mjsim.axis import Axis
from mjsim.effects import Effect

__all__ = ["Fitted", "HeldOut", "key_of"]


def key_of(effects: Sequence[Effect]) -> tuple[str, ...]:
    """What tells two structures apart: the sorted keys of their effects."""
    return tuple(sorted(e.key for e in effects))


@dataclass(frozen=True)
class Fitted:
    """A fitted hypothesis.

    chi2 is the weighted sum of squares over n samples; ``effects`` carry the fitted values of recording 0.
    """

    hypothesis: Hypothesis
    fit: Fit
    n: int

    @property
    def key(self) -> tuple[str, ...]:
        """The structure."""
        return key_of(self.hypothesis.effects)

    @property
    def chi2(self) -> float:
        """Weighted sum of squares on the estimation samples."""
        return self.fit.cost

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The supposed effects with their fitted values."""
        return self.axis.effects[len(self.hypothesis.carried) :]

    @property
    def carried(self) -> tuple[Effect, ...]:
        """The nominal axis's own effects with their fitted values."""
        return self.axis.effects[: len(self.hypothesis.carried)]

    @property
    def axis(self) -> Axis:
        """The fitted axis (values of the first recording)."""
        return self.hypothesis.axis(self.fit.x, 0)

    @property
    def linear(self) -> dict[str, float]:
        """Fitted linear parameters, and as ``id@place.name`` those of the nominal axis's own effects."""
        values = self.hypothesis.values(self.fit.x)
        own = {e.key for e in self.hypothesis.carried}
        linear = {n: v for (o, n, r), v in values.items() if o == "" and not is_of_start(o, n) and r <= 0}
        return linear | {f"{o}.{n}": v for (o, n, r), v in values.items() if o in own and r < 0}

    @property
    def own(self) -> dict[tuple[str, str, int], float]:
        """Fitted per-recording values."""
        return {k: v for k, v in self.hypothesis.values(self.fit.x).items() if k[2] >= 0}

    @property
    def ok(self) -> bool:
        """Whether the fit ran at all."""
        return self.fit.status is not Status.FAILED

    @property
    def rough(self) -> bool:
        """Whether bodies stick or strike in it."""
        return self.hypothesis.rough

    def unconverged(self) -> Fitted:
        """The same with the status of a fit that was stopped early: its tolerance was loose, or its Jacobian a secant update."""
        return dataclasses.replace(self, fit=dataclasses.replace(self.fit, status=Status.BUDGET)) if self.ok else self

    def covariance_draws(self, widths: np.ndarray, seed: int) -> list[np.ndarray]:
        """Points (p,) about the fit, so many standard errors wide by its covariance; the same for a seed."""
        J = self.fit.J
        if len(widths) == 0 or not J.any():
            return []
        scale = np.linalg.norm(J, axis=0)
        scale[scale == 0] = np.inf  # what the residual does not depend on stays
        _, s, vt = np.linalg.svd(J / scale, full_matrices=False)
        root = (vt.T / np.maximum(s, 1e-5 * s[0])) * math.sqrt(self.chi2 / self.n)
        lower, upper = self.hypothesis.bounds
        rng = np.random.default_rng(seed)
        return [np.clip(self.fit.x + width * (root @ rng.standard_normal(len(s))) / scale, lower, upper) for width in widths]

    def standard_errors(self, noise: NoiseModel | None = None) -> np.ndarray:
        """Standard errors [SI] of the vector's numbers (p,), from the Gauss-Newton Hessian and the residual variance.

        Two integrations of one law differ by up to about ENGINE of the noise, and that error does not average out over n samples:
        it can shift an estimate by ENGINE sqrt(n) standard errors, which is added in quadrature. So can the whole error above
        the noise (known by default) of a nonsmooth model: it is then an event at another moment, and the minimum one of many.
        """
        J = self.fit.J
        events = max(0.0, self.chi2 / self.n - UNEXPLAINED) if self.rough and (noise is None or noise.absolute) else 0.0
        variance = self.chi2 / max(self.n - J.shape[1], 1) + self.n * (ENGINE**2 + events)
        scale = np.sqrt(np.sum(J**2, axis=0)) + 1e-300
        _, s, vt = np.linalg.svd(J / scale, full_matrices=False)
        s = np.maximum(s, 1e-10 * s[0] + 1e-300)
        slope = np.array([abs(e.slope(v)) for e, v in zip(self.hypothesis.entries, self.fit.x, strict=True)])
        left = self.chi2 > UNEXPLAINED * self.n or (noise is not None and not noise.absolute)
        with np.errstate(over="ignore"):  # what the data do not answer to at all has no bound
            squares = variance * np.sum((vt.T / s) ** 2, axis=1)
            if left and not self.rough and J.any():
                squares = np.maximum(squares, self._clustered((vt.T / s) @ (vt.T / s).T, scale))
            errors: np.ndarray = slope * np.sqrt(squares) / scale
            return errors

    def _clustered(self, inverse: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Variances (p,) of the scaled numbers where errors are correlated: by the scores of `BLOCKS` stretches.

        V = H^-1 (sum of g_b g_b') H^-1, g_b = J_b' r_b; a residual that is the model's own error tells less than so many samples.
        Source: K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13.
        """
        J, r = self.fit.J[: self.n] / scale, self.fit.residual[: self.n]
        scores = np.array([a.T @ b for a, b in zip(np.array_split(J, BLOCKS), np.array_split(r, BLOCKS), strict=True)])
        return np.asarray(np.sum((scores @ inverse) ** 2, axis=0)) * BLOCKS / (BLOCKS - 1)


@dataclass(frozen=True)
class HeldOut:
    """Weighted errors on held-out samples, in blocks: errors (N,), sse (B,), n (B,); rms and nrmse in the view's unit."""

    errors: np.ndarray
    sse: np.ndarray
    n: np.ndarray
    rms: float
    nrmse: float

    @property
    def chi2(self) -> float:
        """Weighted sum of squares."""
        return float(np.sum(self.sse))
