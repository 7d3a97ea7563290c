"""How large a concealed effect is in the recording, in units of the noise, and how much of it other parameters can hide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lab.benchmark.catalogue import Entry
from lab.benchmark.laws import Laws
from lab.benchmark.plant import free_run
from lab.benchmark.refit import COARSE, LINEAR, Refit, refit, rms

__all__ = ["RIVAL_SCALE", "Size", "hidden_by_linear", "raw", "sizes", "without"]

# Step units of the rival fields that a refit may free.
RIVAL_SCALE = {"coulomb_m": 0.2, "offset_m": 0.2, "act_delay": 3e-3}
ROUNDS = 12  # iterations of a refit at most
STEPS = "sensor_quantisation"  # the effect that is noise to the others


@dataclass(frozen=True)
class Size:
    """Rms over the noise rms of the output difference that the effect makes, in a free run on the logged torque.

    ``raw``: with and without it. ``after_refit``: what the best linear parameters leave. ``distinct``: what is left when the
    simpler effects that resemble it are fitted as well, and what else the plant holds: a weight of another phase is a sensor's
    offset while the arm hardly turns.
    """

    raw: float
    after_refit: float
    distinct: float


def without(laws: Laws, entry: Entry) -> Laws:
    """The plant less one effect."""
    idle = Laws()
    names = [*entry.fields.values(), *entry.fixed]
    return laws._replace(**{name: getattr(idle, name) for name in names})


def raw(laws: Laws, entries: Sequence[Entry], torque: np.ndarray) -> float:
    """Rms [rad/s] of the output difference with and without the effects."""
    bare = laws
    for entry in entries:
        bare = without(bare, entry)
    a = free_run(laws, torque, substeps=COARSE).velocity
    return rms(a - free_run(bare, torque, substeps=COARSE).velocity)


def hidden_by_linear(laws: Laws, entries: Sequence[Entry], torque: np.ndarray, start: Laws | None = None) -> Refit:
    """The best linear model of the plant's noise-free output, starting from ``start`` or from the plant's own."""
    bare = start or laws
    for entry in entries:
        bare = without(bare, entry)
    return refit(bare, torque, free_run(laws, torque, substeps=COARSE).velocity, LINEAR, RIVAL_SCALE)


def sizes(
    laws: Laws,
    entry: Entry,
    torque: np.ndarray,
    noise: float,
    low: float = 0.0,
    high: float = np.inf,
    beside: Sequence[Entry] = (),
) -> Size | None:
    """The three sizes of one effect of a plant that holds others (``beside``); None once ``after_refit`` is outside [low, high].

    A sensor's steps are noise to what else is there: the output is compared without them.
    """
    others = [e for e in beside if e is not entry and e.effect != STEPS]
    if entry.effect != STEPS:
        laws = laws._replace(sen_step=0.0)
    target = free_run(laws, torque, substeps=COARSE).velocity
    bare = without(laws, entry)
    first = refit(bare, torque, target, LINEAR, RIVAL_SCALE, rounds=ROUNDS)
    if not low * noise <= first.left <= high * noise:
        return None
    second = first
    rivals = tuple(name for name in entry.rivals if getattr(bare, name) == getattr(Laws(), name))
    if rivals:
        start = first.laws
        if "coulomb_m" in rivals:
            level = max(laws.coulomb_m, laws.bristle_level, laws.deadzone, 0.02)
            alone = bare._replace(coulomb_m=level)
            start = min((start._replace(coulomb_m=1e-3), alone), key=lambda s: _error(s, torque, target))
        second = refit(start, torque, target, LINEAR + rivals, RIVAL_SCALE, rounds=ROUNDS)
        second = min(first, second, key=lambda s: s.left)
    if others and second.left >= low * noise:
        theirs = [(field, e.draws.get(name)) for e in others for name, field in e.fields.items()]
        positive = tuple(field for field, drawn in theirs if drawn is None or not (drawn.signed or drawn.uniform))
        free = LINEAR + rivals + tuple(field for field, _ in theirs)
        third = refit(second.laws, torque, target, free, RIVAL_SCALE, rounds=ROUNDS, positive=positive)
        second = min(second, third, key=lambda s: s.left)
    return Size(raw(laws, [entry], torque) / noise, first.left / noise, second.left / noise)


def _error(laws: Laws, torque: np.ndarray, target: np.ndarray) -> float:
    return rms(free_run(laws, torque, substeps=COARSE).velocity - target)
