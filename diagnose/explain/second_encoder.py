"""A second encoder behind the gear against the motor's: late, wound up, or with a gap between?

    q_motor(t) - q_second(t) = c + [q(t) - q(t - T)] + tau / k + (b/2) sign(tau) + h sign(v)

c: offset of the two zeros, of each recording its own; T: delay of the second encoder; tau / k: wind-up of a spring under the
link-side torque; b: backlash, on the flank that the torque pushes; h: hysteresis, wind-up held by dry friction behind the spring.
A delay draws the same loop over the velocity as wind-up with hysteresis does over the torque, so each is fitted, all are
compared, and a term is kept only where it lowers the error on held-out data significantly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.data.experiment import Experiment, measured_velocity
from diagnose.thresholds import ALPHA, BLOCKS, SMALL
from mjsim.axis import Chain
from mjsim.quantity import Quantity

__all__ = ["TERMS", "Explanation", "SecondEncoder", "judge_second_encoder"]

TERMS = {
    "time_delay": "a delay of the second encoder",
    "compliance": "wind-up of an elastic gear",
    "backlash": "backlash",
    "hysteresis": "hysteresis",
}


@dataclass(frozen=True)
class Explanation:
    """Some terms fitted together: delay [s], compliance [rad/(N m)], backlash (whole gap) and hysteresis [rad]; rms [rad | m]."""

    terms: tuple[str, ...]
    values: Mapping[str, float]
    rms: float
    held_out_rms: float


@dataclass(frozen=True)
class SecondEncoder:
    """What explains the difference of the two encoders: ``found`` and every set of terms that was tried, best held-out first."""

    found: Explanation
    compared: tuple[Explanation, ...]
    difference: float
    held_out_difference: float
    unit: str = "rad"

    def sentence(self) -> str:
        """In plain words, with the figures."""
        before = f"{1e6 * self.held_out_difference:.3g}"
        micro = f"micro{self.unit}" if self.unit == "rad" else "micrometres"
        if not self.found.terms:
            return f"The second encoder follows the motor's to {before} {micro} (held out); no term explains the residual."
        parts = []
        for t in self.found.terms:
            v = self.found.values[t]
            size = {"time_delay": f"{1e3 * v:.3g} ms", "compliance": f"{v:.3g} {self.unit} for a unit of torque"}.get(
                t, f"{1e6 * v:.3g} {micro}"
            )
            parts.append(f"{TERMS[t]} ({size})")
        gone = [TERMS[t] for t in TERMS if t not in self.found.terms]
        return (
            f"The difference between the two encoders is explained by {' and '.join(parts)}: {before} -> "
            f"{1e6 * self.found.held_out_rms:.3g} {micro} on held-out data. Not needed beside it: {', '.join(gone)}."
        )


@dataclass(frozen=True)
class _Part:
    """Columns of one recording: time, motor angle, second angle, link-side torque, velocity and which samples count."""

    time: np.ndarray
    angle: np.ndarray
    second: np.ndarray
    torque: np.ndarray
    velocity: np.ndarray
    keep: np.ndarray


def judge_second_encoder(
    chain: Chain, estimation: Sequence[Experiment], held_out: Sequence[Experiment], longest: float = 0.02
) -> SecondEncoder | None:
    """Compare the terms on the recordings that have a second encoder; None where there is none, or no
    torque beside it. ``longest``: largest delay [s]."""
    fit, held = ([_part(chain, e, longest) for e in group if _has(e)] for group in (estimation, held_out))
    if not fit or not held:
        return None
    compared: dict[tuple[str, ...], tuple[Explanation, np.ndarray]] = {}
    for count in range(len(TERMS) + 1):
        for terms in itertools.combinations(TERMS, count):
            values, rms = _fit(fit, terms, longest)
            blocks = _blocks(held, terms, values)
            compared[terms] = Explanation(terms, values, rms, math.sqrt(float(np.sum(blocks[0]) / np.sum(blocks[1])))), blocks[0]
    found: tuple[str, ...] = ()
    while len(found) < len(TERMS):
        wider = [t for t in compared if len(t) == len(found) + 1 and set(found) <= set(t)]
        best = min(wider, key=lambda t: compared[t][0].rms)
        if not _significant(compared[found][1], compared[best][1]):
            break
        found = best
    ranked = tuple(sorted((e for e, _ in compared.values()), key=lambda e: e.held_out_rms))
    return SecondEncoder(
        compared[found][0], ranked, compared[()][0].rms, compared[()][0].held_out_rms, Quantity.ANGLE.unit(chain.motion)
    )


def _has(experiment: Experiment) -> bool:
    r = experiment.recording
    return r.second_angle is not None and r.angle is not None and bool(np.isfinite(r.torque).all())


def _part(chain: Chain, experiment: Experiment, longest: float) -> _Part:
    r = experiment.recording
    assert r.angle is not None
    assert r.second_angle is not None
    keep = experiment.counts.copy()
    edge = math.ceil(longest / r.dt) + 1
    keep[:edge] = keep[-edge:] = False
    return _Part(r.time, r.angle, r.second_angle, chain.gain * r.torque, measured_velocity(r), keep)


def _columns(part: _Part, terms: Sequence[str], delay: float) -> tuple[np.ndarray, np.ndarray]:
    """(difference less the delay's part, columns of the linear terms), less their means, on the samples that count."""
    from scipy.interpolate import CubicSpline

    d = part.angle - part.second
    if delay:
        d = d - (part.angle - CubicSpline(part.time, part.angle)(part.time - delay))
    still = 0.02 * float(np.std(part.velocity))
    made = {
        "compliance": part.torque,
        "backlash": 0.5 * np.sign(part.torque),
        "hysteresis": np.tanh(part.velocity / max(still, 1e-300)),
    }
    columns = np.column_stack([np.ones(len(d)), *(made[t] for t in terms if t in made)])[part.keep]
    return d[part.keep] - np.mean(d[part.keep]), columns[:, 1:] - np.mean(columns[:, 1:], axis=0)


def _solve(parts: Sequence[_Part], terms: Sequence[str], delay: float) -> tuple[np.ndarray, float, int]:
    """Linear terms at a given delay, none below zero: a spring and a gap have a sign. Coefficients, sum of squares, samples."""
    from scipy.optimize import nnls

    made = [_columns(p, terms, delay) for p in parts]
    d, x = np.concatenate([m[0] for m in made]), np.concatenate([m[1] for m in made])
    if x.shape[1] == 0:
        return np.empty(0), float(d @ d), len(d)
    scale = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
    c, left = nnls(x / scale, d)
    return c / scale, left**2, len(d)


def _fit(parts: Sequence[_Part], terms: Sequence[str], longest: float) -> tuple[dict[str, float], float]:
    """Values of the terms and the rms that they leave."""
    from scipy.optimize import minimize_scalar

    delay = 0.0
    if "time_delay" in terms:
        grid = np.linspace(-longest, longest, 41)
        start = int(np.argmin([_solve(parts, terms, float(x))[1] for x in grid]))
        low, high = grid[max(start - 1, 0)], grid[min(start + 1, 40)]
        delay = float(minimize_scalar(lambda x: _solve(parts, terms, x)[1], bounds=(low, high), method="bounded").x)
    c, squares, n = _solve(parts, terms, delay)
    values = dict(zip((t for t in terms if t != "time_delay"), map(float, c), strict=True))
    if "time_delay" in terms:
        values["time_delay"] = delay
    return values, math.sqrt(squares / n)


def _blocks(parts: Sequence[_Part], terms: Sequence[str], values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Squared error and number of samples in blocks, the offset of each recording estimated anew and nothing else."""
    squares, count = [], []
    for p in parts:
        d, x = _columns(p, terms, values.get("time_delay", 0.0))
        e = d - x @ np.array([values[t] for t in terms if t != "time_delay"])
        for block in np.array_split(e, BLOCKS):
            squares.append(float(block @ block))
            count.append(len(block))
    return np.array(squares), np.array(count)


def _significant(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether a further term takes a material part of the held-out squared error, in most blocks."""
    from scipy.stats import wilcoxon

    d = before - after
    if np.sum(d) <= SMALL * np.sum(before):
        return False
    return float(wilcoxon(d, alternative="greater").pvalue) * len(TERMS) < ALPHA
