"""The input in gaps of the stamps: held at the last row, or on a straight line to the next one, as the motion across them shows.

A log that lacks rows lacks the input too, and what acted meanwhile moves all that follows in a free run. The momentum that the
axis gained across a stretch from row a to row b is

    v_b - v_a = sum_j w_j integral of x_j dt,      x = (input, velocity, sin q, cos q, angle, sign v, 1)

whatever its inertia, damping, weight, spring and dry friction are. The weights w are fitted to stretches of the same lengths that
lack no row, by least squares, and each input in the gaps is judged by its error there. A logger that loses rows leaves the input
as smooth as it was; one that is held up with the task leaves it held.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from diagnose.data.experiment import smooth_velocity
from mjsim.recording import Recording

__all__ = ["with_input_in_gaps"]

INPUTS = ("torque", "command", "control")

TAKEN = (
    "The input in {count} gaps of the stamps was not recorded. It is taken on straight lines between the rows beside them: "
    "across the gaps the motion then errs by {line:.3g} {unit}, with the input held by {held:.3g}."
)


def with_input_in_gaps(
    recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[list[Recording], list[Recording], tuple[str, ...]]:
    """The recordings with the input in their gaps as the motion shows it, in all alike, and a sentence where it is changed.

    As given where no row is missing, the input is not held between samples, or the motion is no clearer by straight lines.
    """
    every = [*recordings, *held_out]
    lines = [_on_lines(r) for r in every]
    if not any(r is not new for r, new in zip(every, lines, strict=True)):
        return list(recordings), list(held_out), ()
    asked = [_errors(r, new) for r, new in zip(every, lines, strict=True) if new is not r]
    errors = [e for e in asked if e is not None]
    if not errors:
        return list(recordings), list(held_out), ()
    held, line = (float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in zip(*errors, strict=True))
    if not line < held:
        return list(recordings), list(held_out), ()
    unit = "rad/s" if every[0].units.get("velocity") != "m/s" else "m/s"
    said = TAKEN.format(count=sum(len(_gaps(r)) for r in every), line=line, held=held, unit=unit)
    return lines[: len(recordings)], lines[len(recordings) :], (said,)


def _gaps(r: Recording) -> list[tuple[int, int]]:
    """The rows (a, b) that were measured last before each gap and first after it."""
    if r.missing is None:
        return []
    there = np.flatnonzero(~r.missing)  # a part of a recording may begin or end in a gap, of which one side is not known
    return [(int(a), int(b)) for a, b in pairwise(there) if b > a + 1]


def _on_lines(r: Recording) -> Recording:
    """The recording with its input on straight lines across the gaps; itself where there are none or the input is not held."""
    if r.hold != "held" or not _gaps(r) or (r.velocity is None and r.angle is None):
        return r
    assert r.missing is not None
    there, k = np.flatnonzero(~r.missing), np.arange(len(r))
    filled = {
        name: np.interp(k, there, getattr(r, name)[there]) for name in INPUTS if getattr(r, name) is not None
    }  # fmt: skip
    return dataclasses.replace(r, **filled)


def _errors(held: Recording, lines: Recording) -> tuple[np.ndarray, np.ndarray] | None:
    """What the momentum across each gap (g,) errs by, as a velocity: with the input held, and on straight lines.

    None where fewer than ten stretches without a gap are there for each weight.
    """
    gaps, v = _gaps(held), smooth_velocity(held)
    assert held.missing is not None
    lengths = sorted({b - a for a, b in gaps})
    whole = np.concatenate([[0], np.cumsum(held.missing)])
    plain = [(a, a + n) for n in lengths for a in range(0, len(v) - n, len(lengths)) if whole[a] == whole[a + n + 1]]
    known = _gained(held, v)
    if len(plain) < 10 * known.shape[1]:
        return None
    ends = np.array(plain, int)
    w = np.linalg.lstsq(_across(known, ends), _across(v, ends), rcond=1e-10)[0]
    ends = np.array(gaps, int)
    moved = _across(v, ends)
    first, second = (moved - _across(_gained(r, v), ends) @ w for r in (held, lines))
    return first, second


def _across(x: np.ndarray, ends: np.ndarray, rows: int = 5) -> np.ndarray:
    """By how much x (N, ...) grows across stretches (g, 2): the mean of so many rows from the last, less that up to the first.

    Noise falls with the root of ``rows``; what acts within them is in the integrals, averaged alike.
    """
    k = np.arange(rows)
    before, after = (np.clip(ends[:, i, None] + way * k, 0, len(x) - 1) for i, way in ((0, -1), (1, 1)))
    return np.asarray(x[after].mean(axis=1) - x[before].mean(axis=1))


def _gained(r: Recording, v: np.ndarray) -> np.ndarray:
    """Integrals (N, p) from the first row on of what moves the axis: the input held over each sample, all else by trapezoids."""
    assert r.missing is not None
    there, k = np.flatnonzero(~r.missing), np.arange(len(r))
    v = np.interp(k, there, v[there])
    q = np.cumsum(v) * r.dt if r.angle is None else np.interp(k, there, r.angle[there])
    state = np.column_stack([v, np.sin(q), np.cos(q), q, np.sign(v), np.ones(len(v))])
    steps = np.column_stack([r.input[:-1], 0.5 * (state[1:] + state[:-1])])
    return np.vstack([np.zeros(steps.shape[1]), np.cumsum(steps * r.dt, axis=0)])
