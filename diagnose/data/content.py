"""Recordings cut to the rate that their content needs.

Of a low-passed or interpolated channel the fastest part of its spectrum tells nothing of its noise: it is what the filter left.
Sampled at twice the frequency at which its content ends, the noise is nearly white again, and its level is that of what a model
can be compared with.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from diagnose.check.content import content_end
from diagnose.data.noise import white_noise_level
from diagnose.thresholds import FAR, FEWEST, MATERIAL
from mjsim.recording import ARRAYS, Recording
from mjsim.signals import plain_step

__all__ = ["at_content_rate", "decimated"]


def at_content_rate(recordings: Sequence[Recording]) -> tuple[list[Recording], tuple[str, ...]]:
    """The recordings, sampled as slowly as the content of their judged channel asks for, and a sentence where they were.

    The judged channel is the velocity, else the angle. All are left as they are where one of them is not filtered, or where its
    noise does not show at the slower rate either.
    """
    each = [_factor(r) for r in recordings]
    every = min(each, default=1)
    if every < 2:
        return list(recordings), ()
    name = "velocity" if recordings[0].velocity is not None else "angle"
    said = (
        f"The {name} holds nothing above {0.5 / recordings[0].dt / max(each):.3g} Hz (it was filtered or interpolated), so that "
        f"its noise does not show in its fastest part. Every {_ordinal(every)} sample is used, and the mean of the input between."
    )
    return [decimated(r, every) for r in recordings], (said,)


def decimated(recording: Recording, every: int, *, held: bool = False) -> Recording:
    """Every so-manyth sample of a recording; the input is the mean over each of the longer samples.

    A row holds the mean of the interval before it; ``held``: of the interval that begins with it, as of an input that is held.
    """
    n = len(recording) // every

    def cut(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[: n * every : every])

    arrays: dict[str, Any] = {name: cut(x) for name in ARRAYS if (x := getattr(recording, name)) is not None}
    for name in ("torque", "command", "control", "known_torque"):
        x = getattr(recording, name)
        if x is not None:
            after = np.append(x[1:], x[-1])
            ahead = {"held": x, "linear": 0.5 * (x + after), "mean": after}  # means of the intervals that begin with a row
            means = ahead[recording.hold][: n * every].reshape(n, every).mean(axis=1)
            arrays[name] = means if held else np.concatenate([means[:1], means[:-1]])
    columns = {k: cut(v) for k, v in recording.columns.items()}
    if recording.missing is not None:
        arrays["missing"] = cut(recording.missing)
    return dataclasses.replace(recording, **arrays, columns=columns, dt=recording.dt * every, hold="held" if held else "mean")


def _factor(recording: Recording) -> int:
    """By how much a recording may be sampled more slowly; 1 where its noise shows as it is, or does not show then either.

    Below the end of a filter's band the level of the noise hardly depends on the rate at which it is sampled. Beyond that what is
    taken for noise is motion, and so it is at every rate where there is no noise: a simulation's log stays as it is.
    The level of white noise does not grow with the interval, that of motion with its square or faster: below the first power
    it is noise.
    """
    x = recording.angle if recording.velocity is None else recording.velocity
    if x is None or plain_step(x) > 0 or content_end(x, recording.dt) is None:
        return 1
    factors = np.unique(np.round(np.geomspace(1, max(len(x) // FEWEST, 1), 24)).astype(int))
    levels = np.array([np.mean([white_noise_level(x[at::k]) for at in range(min(k, 4))]) for k in factors])
    growth = np.diff(np.log(levels)) / np.diff(np.log(factors))
    shown = (levels > FAR * levels[0]) & (levels < MATERIAL * float(np.std(x)))
    at = np.flatnonzero(shown[:-1] & (growth < 1.0))
    return int(factors[at[0]]) if len(at) else 1


def _ordinal(k: int) -> str:
    ending = "th" if k % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(k % 10, "th")
    return f"{k}{ending}"
