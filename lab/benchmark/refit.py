"""The best that other parameters can do: how much of an effect a refit hides, by Gauss-Newton on the sealed plant itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lab.benchmark.laws import Laws
from lab.benchmark.plant import free_run
from mjsim.errors import InputError

__all__ = ["COARSE", "LINEAR", "Refit", "refit", "rms"]

LINEAR = ("Jm", "Jg", "Ja", "fm", "kg", "ka", "dg", "da")
COARSE = 25  # solver steps a row: 20 us is enough for a size


def rms(x: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


@dataclass(frozen=True)
class Refit:
    """The refitted laws and the rms of what remains [rad/s]."""

    laws: Laws
    left: float


def refit(
    start: Laws,
    torque: np.ndarray,
    velocity: np.ndarray,
    free: tuple[str, ...],
    scale: dict[str, float],
    rounds: int = 6,
    *,
    positive: tuple[str, ...] = (),
) -> Refit:
    """Fit the fields named in ``free`` so that a free run on ``torque`` [Nm] meets the noise-free ``velocity`` [rad/s].

    Linear fields step in proportion to themselves, others by ``scale``; those named in ``positive`` stay so.
    Levenberg-Marquardt on velocity, every second row.
    """
    thin = slice(None, None, 2)
    target = velocity[thin]

    def output(laws: Laws) -> np.ndarray:
        return free_run(laws, torque, substeps=COARSE).velocity[thin]

    unit = {name: scale.get(name, abs(getattr(start, name))) for name in free}
    best, y = start, output(start)
    error = rms(target - y)
    damping = 1e-6
    for _ in range(rounds):
        columns = []
        for name in free:
            step = 1e-3 * unit[name]
            up = output(best._replace(**{name: getattr(best, name) + step}))
            columns.append((up - y) / 1e-3)
        A = np.stack(columns, 1)
        H, g = A.T @ A, A.T @ (target - y)
        if not H.any():
            break  # friction holds the axis: none of them moves it
        before = error
        for _ in range(5):
            x = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12 * H.max()), g)
            x = np.clip(x, -0.3, 0.3) if np.max(np.abs(x)) > 0.3 else x
            trial = best._replace(**{n: getattr(best, n) + float(d) * unit[n] for n, d in zip(free, x, strict=True)})
            try:
                y_trial = output(trial) if _physical(trial, positive) else None
            except InputError:
                y_trial = None
            if y_trial is not None and rms(target - y_trial) < error:
                best, y, error = trial, y_trial, rms(target - y_trial)
                damping = max(damping * 0.1, 1e-9)
                break
            damping = max(damping * 30.0, 1e-4)
        if error > before * 0.999:
            break
    return Refit(best, error)


def _physical(laws: Laws, positive: tuple[str, ...]) -> bool:
    masses = (laws.Jm, laws.Jg, laws.Ja - laws.Je, laws.kg, laws.ka)
    held = (laws.coulomb_m, laws.act_delay, *(getattr(laws, name) for name in positive))
    return min(masses) > 0.0 and min(held) >= 0.0
