"""The input in gaps of the stamps: held at the last row, or smooth to the next one, as the motion across them shows.

A log that lacks rows lacks the input too, and what acted meanwhile moves all that follows in a free run. The momentum that the
axis gained across a stretch from row a to row b is

    v_b - v_a = sum_j w_j integral of x_j dt,      x = (input, velocity, sin q, cos q, angle, sign v, 1)

whatever its inertia, damping, weight, spring and dry friction are. The weights w are fitted to stretches of the same lengths that
lack no row, by least squares, and each input in the gaps is judged by its error there. A logger that loses rows leaves the input
as smooth as it was; one that is held up with the task leaves it held.

A smooth input lies on a straight line between the rows beside a gap, or on the cubic through two rows on each side (J.-P. Berrut,
L. N. Trefethen, SIAM Rev. 46 (2004) 501), whichever errs less at the rows of the stretches that lack none. A chord lies inside a
curve: on straight lines a sinusoidal torque is too small in every gap, and friction is found too small.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from diagnose.data.experiment import smooth_velocity
from mjsim.recording import Recording

__all__ = ["as_moved", "with_input_in_gaps"]

INPUTS = ("torque", "command", "control")

TAKEN = (
    "The input in {count} gaps of the stamps was not recorded. It is taken on {form}: "
    "across the gaps the motion then errs by {smooth:.3g} {unit}, with the input held by {held:.3g}."
)
LINE, CUBIC = "straight lines between the rows beside them", "cubics through two rows on each side"


def with_input_in_gaps(
    recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[list[Recording], list[Recording], tuple[str, ...]]:
    """The recordings with the input in their gaps as the motion shows it, in all alike, and a sentence where it is changed.

    As given where no row is missing, the input is not held between samples, or the motion is no clearer by a smooth input.
    """
    every = [*recordings, *held_out]
    curved = _bends(every)
    smooth = [_smooth(r, curved=curved) for r in every]
    if not any(r is not new for r, new in zip(every, smooth, strict=True)):
        return list(recordings), list(held_out), ()
    asked = [_errors(r, new) for r, new in zip(every, smooth, strict=True) if new is not r]
    errors = [e for e in asked if e is not None]
    if not errors:
        return list(recordings), list(held_out), ()
    held, by_smooth = (float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in zip(*errors, strict=True))
    if not by_smooth < held:
        return list(recordings), list(held_out), ()
    unit = "rad/s" if every[0].units.get("velocity") != "m/s" else "m/s"
    count, form = sum(len(_gaps(r)) for r in every), CUBIC if curved else LINE
    said = TAKEN.format(count=count, form=form, smooth=by_smooth, held=held, unit=unit)
    return smooth[: len(recordings)], smooth[len(recordings) :], (said,)


def as_moved(recording: Recording) -> Recording:
    """One recording with the input in its gaps as the motion shows it, and a note where it is changed."""
    (filled,), _, said = with_input_in_gaps([recording], [])
    return dataclasses.replace(filled, notes=(*recording.notes, *said)) if said else recording


def _gaps(r: Recording) -> list[tuple[int, int]]:
    """The rows (a, b) that were measured last before each gap and first after it."""
    if r.missing is None:
        return []
    there = np.flatnonzero(~r.missing)  # a part of a recording may begin or end in a gap, of which one side is not known
    return [(int(a), int(b)) for a, b in pairwise(there) if b > a + 1]


def _fillable(r: Recording) -> bool:
    """Whether rows are missing, the input is held between samples, and there is a motion to judge by."""
    return r.hold == "held" and bool(_gaps(r)) and not (r.velocity is None and r.angle is None)


def _smooth(r: Recording, *, curved: bool) -> Recording:
    """The recording with a smooth input across the gaps, on cubics where ``curved``; itself where nothing is to be filled."""
    if not _fillable(r):
        return r
    assert r.missing is not None
    there, k = np.flatnonzero(~r.missing), np.arange(len(r))
    filled = {}
    for name in INPUTS:
        known = getattr(r, name)
        if known is not None:
            filled[name] = np.interp(k, there, known[there])
            for a, b in _gaps(r) if curved else ():
                if a > 0 and b < len(r) - 1 and not r.missing[a - 1] and not r.missing[b + 1]:
                    filled[name][a + 1 : b] = _cubic(b - a) @ known[[a - 1, a, b, b + 1]]
    return dataclasses.replace(r, **filled)


def _cubic(n: int) -> np.ndarray:
    """Weights (n - 1, 4) of the rows -1, 0, n, n + 1 in the values at the rows 1 to n - 1 of the cubic through them."""
    at, rows = np.array([-1.0, 0.0, n, n + 1.0]), np.arange(1.0, n)
    return np.column_stack([np.prod([(rows - o) / (x - o) for o in at if o != x], axis=0) for x in at])


def _line(n: int) -> np.ndarray:
    """Weights (n - 1, 4) of the rows -1, 0, n, n + 1 in the values at the rows 1 to n - 1 of the line from row 0 to row n."""
    share = np.arange(1.0, n) / n
    return np.column_stack([np.zeros(n - 1), 1.0 - share, share, np.zeros(n - 1)])


def _bends(recordings: Sequence[Recording]) -> bool:
    """Whether cubics err less than lines across stretches that lack no row, of the lengths of the gaps."""
    squares = np.zeros(2)
    for r in filter(_fillable, recordings):
        assert r.missing is not None
        whole, u = np.concatenate([[0], np.cumsum(r.missing)]), r.input
        for n, count in Counter(b - a for a, b in _gaps(r)).items():
            first = np.arange(1, len(u) - n - 1)
            first = first[whole[first - 1] == whole[first + n + 2]]
            if len(first):
                across = u[first[:, None] + np.arange(-1, n + 2)]
                ends, between = across[:, [0, 1, n + 1, n + 2]], across[:, 2 : n + 1]
                squares += [count * float(np.mean((between - ends @ w(n).T) ** 2)) for w in (_cubic, _line)]
    return bool(squares[0] < squares[1])


def _errors(held: Recording, smooth: Recording) -> tuple[np.ndarray, np.ndarray] | None:
    """What the momentum across each gap (g,) errs by, as a velocity: with the input held, and smooth.

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
    first, second = (moved - _across(_gained(r, v), ends) @ w for r in (held, smooth))
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
