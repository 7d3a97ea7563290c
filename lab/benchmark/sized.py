"""Draw an axis, what is concealed in it, how it is driven and measured, until the effect has the size that its level asks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lab.benchmark.catalogue import Entry, compose, draw
from lab.benchmark.experiment import Experiment, draw_experiment, log_uniform
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import free_run, record
from lab.benchmark.refit import COARSE, LINEAR, rms
from lab.benchmark.size import Size, hidden_by_linear, raw, sizes, without
from mjsim.errors import InputError

__all__ = [
    "SIZE",
    "SPREAD",
    "Found",
    "any_axis",
    "any_experiment",
    "any_noise",
    "draw_of_size",
    "hide_from_refit",
    "not_white",
    "usual_noise",
]

# Smallest size of what neither a linear refit nor a simpler effect hides, and largest of what the linear refit leaves,
# both over the noise rms. Under noise both bounds are for the latter, and a tenth of the noise must be distinct. Faint effects
# are about as small as can be seen at all: they show where detection begins and count for the curves of power alone.
SIZE: dict[str, tuple[float, float]] = {
    "plain": (1.0, 80.0),
    "other_law": (1.0, 80.0),
    "under_noise": (0.15, 0.95),
    "behind_refit": (0.3, 4.0),
    "behind_feedback": (0.3, 30.0),
    "two_effects": (0.6, 80.0),
    "out_of_library": (0.5, 80.0),
    "faint": (0.012, 0.25),
    "coloured": (1.0, 80.0),
}
SPREAD = 0.06  # relative half-width of the linear parameters about Table 2
TRIES = 240
TURN = 30  # tries for one choice of effects


@dataclass(frozen=True)
class Found:
    """A case of the size asked for, as it is to be recorded; ``size``: of each effect."""

    laws: Laws
    entries: tuple[Entry, ...]
    parameters: tuple[dict[str, float], ...]
    measurement: Measurement
    experiment: Experiment
    size: tuple[Size, ...]


def any_axis(rng: np.random.Generator, spread: float = SPREAD) -> Laws:
    """Linear parameters about the nominal ones, each within a relative ``spread``."""
    nominal = Laws()
    return nominal._replace(**{n: getattr(nominal, n) * (1 + spread * float(rng.uniform(-1, 1))) for n in LINEAR})


def any_experiment(rng: np.random.Generator, entries: tuple[Entry, ...], closed: bool = False) -> Experiment:
    """A drive that the effects prefer, in most draws; of the speed loop where ``closed``."""
    if closed:
        kind = str(rng.choice(["trapezoid", "speed_multisine"]))
    else:
        kind = str(rng.choice(["chirp"] * 7 + ["multisine"] * 7 + ["steps"] * 2 + ["trapezoid"] * 4))
        prefers = [k for e in entries for k in e.prefers]
        if prefers and rng.random() < 0.8:
            kind = str(rng.choice(prefers))
    return draw_experiment(kind, rng, log_uniform(rng, 0.5, 4.0))


def usual_noise(rng: np.random.Generator) -> Measurement:
    """White noise of the velocity."""
    return Measurement(velocity_noise=log_uniform(rng, 0.03, 0.15))


def any_noise(rng: np.random.Generator) -> Measurement:
    """White, coloured, repetitive over the turn, or quantised by an encoder: what a recorder does to a sound model."""
    base = usual_noise(rng)
    kind = rng.choice(["white", "ar1", "ar2", "repetitive", "quantised"])
    if kind == "ar1":
        return replace(base, poles=(complex(rng.uniform(0.5, 0.98)),))
    if kind == "ar2":
        pole = rng.uniform(0.7, 0.97) * np.exp(2j * np.pi * log_uniform(rng, 10.0, 300.0) / 2000.0)
        return replace(base, poles=(complex(pole), complex(np.conj(pole))))
    if kind == "repetitive":
        cycles = float(rng.choice([1.0, 2.0, 4.0, 8.0]))
        phase = float(rng.uniform(-np.pi, np.pi))
        amplitude = log_uniform(rng, 1e-4, 3e-3) / cycles
        return replace(base, repeat_amplitude=amplitude, repeat_cycles=cycles, repeat_phase=phase)
    if kind == "quantised":
        step = base.velocity_noise * log_uniform(rng, 0.1, 1.0)  # noise larger than a step: it acts as further white noise
        return replace(base, velocity_step=step, encoder_step=2 * np.pi / float(rng.choice([2**12, 2**14, 2**17])))
    return base


def not_white(rng: np.random.Generator) -> Measurement:
    """Any noise but white."""
    while (measurement := any_noise(rng)).kind == "white":
        continue
    return measurement


def _dress(laws: Laws, chosen: tuple[Entry, ...], rng: np.random.Generator, peak: float) -> tuple[Laws, list[dict[str, Any]]]:
    parameters = []
    for entry in chosen:
        p = draw(entry, rng, peak)
        laws = compose(laws, entry, p)
        parameters.append(p)
    return laws, parameters


def draw_of_size(
    level: str,
    rng: np.random.Generator,
    pool: tuple[Entry, ...],
    first: str | None = None,
    count: int = 1,
    *,
    closed: bool = False,
    hide: Callable[[Laws, tuple[Entry, ...], np.ndarray, float], Laws] | None = None,
    under_noise: bool = False,
    quiet: float = 0.0,
    measured: Callable[[np.random.Generator], Measurement] = usual_noise,
) -> Found:
    """Draw until every effect has the size that the level asks for; ``first`` is given up after 2 ``TURN`` tries.

    ``under_noise``: the noise is raised until the effect has the size drawn, to 1 rad/s or ``quiet`` times the rms speed.
    """
    low, high = SIZE[level]
    chosen = _choose(rng, pool, count, first)
    for attempt in range(TRIES):
        if attempt % TURN == TURN - 1:
            chosen = _choose(rng, pool, count, first if attempt < 2 * TURN else None)
        measurement = measured(rng)
        try:
            laws = any_axis(rng)
            experiment = any_experiment(rng, chosen, closed)
            bare = record(laws, experiment, measurement, rng, substeps=COARSE)
            peak = float(np.max(np.abs(bare.torque)))
            laws, parameters = _dress(laws, chosen, rng, peak)
            if laws.droop * peak * peak > 0.3 or laws.cubic_g < 0 or laws.cubic_a < 0:
                continue
            if any(e.effect == "held_rows" for e in chosen):
                measurement = replace(measurement, dropped=parameters[0]["probability"], hold=round(parameters[0]["rows"]))
            torque = record(laws, experiment, measurement, rng, substeps=COARSE).torque
            noise = measurement.velocity_noise
            if measurement.dropped > 0.0:
                s = _dropped_size(laws, torque, measurement, rng)
                size = [Size(s, s, s)]
            else:
                if not under_noise and min(raw(laws, [e], torque) for e in chosen) < low * noise:
                    continue
                if hide is not None:
                    laws = hide(laws, chosen, torque, high * noise)
                size = _sizes(laws, chosen, torque, noise, *((0.0, np.inf) if under_noise else (low, high)))
            if under_noise and size:
                loud = size[0].after_refit * noise / log_uniform(rng, low, high)
                if not 0.02 <= loud <= max(1.0, quiet * rms(bare.velocity_true)):
                    continue
                size = [Size(*(x * noise / loud for x in (size[0].raw, size[0].after_refit, size[0].distinct)))]
                measurement = replace(measurement, velocity_noise=loud)
            distinct = min(0.1, low) if under_noise else low
            if size and all(distinct <= s.distinct and s.after_refit <= high for s in size):
                return Found(laws, chosen, tuple(parameters), measurement, experiment, tuple(size))
        except InputError:
            continue
    raise InputError(f"level {level}", f"no case of the size {low}-{high} in {TRIES} draws", todo="try another seed")


def _sizes(laws: Laws, chosen: tuple[Entry, ...], torque: np.ndarray, noise: float, low: float, high: float) -> list[Size]:
    """Size of each effect; empty as soon as one is outside the bounds."""
    out = []
    for entry in chosen:
        size = sizes(laws, entry, torque, noise, low, high, chosen)
        if size is None or size.distinct < low:
            return []
        out.append(size)
    return out


def _choose(rng: np.random.Generator, pool: tuple[Entry, ...], count: int, first: str | None) -> tuple[Entry, ...]:
    """Draw effects of different groups: each effect alike likely, then its place or law; ``first`` is one of them."""
    names = list(dict.fromkeys(e.effect for e in pool))
    while True:
        picked = [str(x) for x in rng.choice(names, count, replace=False)]
        if first is not None and first not in picked:
            picked[0] = first
        rows = [[e for e in pool if e.effect == name] for name in picked]
        entries = tuple(row[int(rng.integers(len(row)))] for row in rows)
        if len({e.group for e in entries}) == count:
            return entries


def _dropped_size(laws: Laws, torque: np.ndarray, measurement: Measurement, rng: np.random.Generator) -> float:
    y = free_run(laws, torque, substeps=COARSE).velocity
    _, _, drop = measurement.noise(torque.size, rng)
    last = np.maximum.accumulate(np.where(drop == 0, np.arange(drop.size), 0))
    return rms(y - y[last]) / measurement.velocity_noise


def hide_from_refit(laws: Laws, entries: tuple[Entry, ...], torque: np.ndarray, limit: float) -> Laws:
    """Re-tune the true linear parameters until the best linear model of the output *is* the nominal one.

    An effect of which that model leaves more than twice ``limit`` [rad/s] is given up at once.
    """
    nominal = Laws()
    best, best_miss = laws, np.inf
    for _ in range(5):
        start = laws._replace(**{n: getattr(nominal, n) for n in LINEAR})
        fitted = hidden_by_linear(laws, entries, torque, start)
        if fitted.left > 2 * limit:
            raise InputError("hide", "the refit leaves too much", "an effect that linear parameters nearly hide")
        bare = laws
        for entry in entries:
            bare = without(bare, entry)
        plain = bare._replace(**{n: getattr(nominal, n) for n in LINEAR})
        y = free_run(laws, torque, substeps=COARSE).velocity
        miss = rms(y - free_run(plain, torque, substeps=COARSE).velocity) / max(fitted.left, 1e-9)
        if miss < best_miss:
            best, best_miss = laws, miss
        if miss < 1.05:
            break
        change = {n: getattr(laws, n) * getattr(nominal, n) / getattr(fitted.laws, n) for n in LINEAR}
        for n in LINEAR:
            if not 0.5 < change[n] / getattr(nominal, n) < 2.0:
                raise InputError("hide", f"{n} would have to be {change[n]:.3g}", "half to twice the nominal value")
        laws = laws._replace(**change)
    if best_miss > 1.3:
        raise InputError("hide", f"the nominal model stays {best_miss:.2f} times worse than the refit", "at most 1.3")
    return best
