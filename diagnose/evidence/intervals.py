"""Which sizes of the effects of a structure the data leave open: their 95 % interval contains zero."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

from scipy.special import ndtri

from diagnose.fit.fitted import Fitted
from diagnose.problem.noise_model import NoiseModel
from diagnose.thresholds import ROUNDING
from mjsim.effects import Effect

__all__ = ["Open", "at_bounds", "half_width", "open_sizes", "sizes_of"]


@final
@dataclass(frozen=True)
class Open:
    """A size of an effect whose interval contains zero; value and 95 % interval in SI units."""

    effect: Effect
    name: str
    value: float
    ci95: tuple[float, float]


def half_width(error: float) -> float:
    """Half of a 95 % interval of a normal distribution with a standard error."""
    return float(ndtri(0.975)) * error


def sizes_of(effect: Effect) -> tuple[str, ...]:
    """The parameters without which an effect is another one, or none."""
    return effect.amplitudes if effect.sizes is None else effect.sizes


def open_sizes(f: Fitted, noise: NoiseModel, sizes: Mapping[str, tuple[str, ...]] | None = None) -> tuple[Open, ...]:
    """The sizes of the supposed effects of a structure whose intervals contain zero; ``sizes``: others to ask about, by key."""
    asked = {e.key: sizes_of(e) for e in f.effects} if sizes is None else sizes
    effects = {e.key: e for e in f.effects}
    out = []
    for entry, x, error in zip(f.hypothesis.entries, f.fit.x, f.standard_errors(noise), strict=True):
        if entry.owner not in effects or entry.name not in asked.get(entry.owner, ()):
            continue
        value, half = entry.si(float(x)), half_width(float(error))
        if not abs(value) >= half:
            out.append(Open(effects[entry.owner], entry.name, value, (value - half, value + half)))
    return tuple(out)


def at_bounds(best: Fitted) -> tuple[str, ...]:
    """Inertias and stiffnesses of the model that a fit has at a bound of what it may be."""
    low, high = best.hypothesis.bounds
    entries = zip(best.hypothesis.entries, best.fit.x, low, high, strict=True)
    return tuple(e.name for e, x, a, b in entries if e.owner == "" and e.log and not a + ROUNDING < x < b - ROUNDING)
