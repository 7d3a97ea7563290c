"""Which stretches of a recording that is too long to be fitted as a whole are fitted: the most informative ones.

The recording is cut into windows of equal length. Of each window the features

    a, v, sign v, v |v|, 1, q, q^2, rms of the fast part of v

of block means (acceleration a, velocity v, angle q) give the Gram matrix G_w: what a regression of inertia, viscous and Coulomb
friction, drag, constant and position-dependent torques would learn from it. Windows are chosen one after the other, each the
one that raises log det(sum of G) the most (D-optimal design; V. V. Fedorov, Theory of Optimal Experiments, 1972). G is whitened
by its mean over all windows, so that neither units nor the scale of a feature matter. A part of the recording from which
nothing is chosen yet is preferred, so that slow changes show.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.data.experiment import measured_angle, measured_velocity, prepare
from diagnose.data.noise import white_noise_level
from diagnose.thresholds import LONGEST, MOST, SIGMAS, STRETCH_COUNT
from mjsim.errors import InputError
from mjsim.recording import Recording

__all__ = ["Stretch", "Stretches", "choose", "information", "informative"]


@dataclass(frozen=True)
class Stretch:
    """One chosen window: rows [first, last) of the file, its times [s], what it adds to log det, and whether it is held out."""

    file: str
    first: int
    last: int
    start_s: float
    end_s: float
    gain: float
    held_out: bool

    def as_dict(self) -> dict[str, object]:
        """For ``diagnosis.json``."""
        role = "held-out" if self.held_out else "estimation"
        return {**{k: v for k, v in dataclasses.asdict(self).items() if k != "held_out"}, "role": role}


@dataclass(frozen=True)
class Stretches:
    """Chosen windows of one recording, in the order of time, as recordings and in words."""

    chosen: tuple[Stretch, ...]
    recordings: tuple[Recording, ...]
    windows: int
    unusable: int

    def fitted(self) -> list[Recording]:
        """Those that are fitted."""
        return [r for s, r in zip(self.chosen, self.recordings, strict=True) if not s.held_out]

    def held(self) -> list[Recording]:
        """Those that are held out."""
        return [r for s, r in zip(self.chosen, self.recordings, strict=True) if s.held_out]

    def sentence(self) -> str:
        """What was chosen, for the notes of the diagnosis."""
        length = self.recordings[0].duration
        places = ", ".join(f"{s.start_s:.6g} s" for s in self.chosen)
        skipped = f" {self.unusable} windows cannot be used (gaps, no motion)." if self.unusable else ""
        return (
            f"{self.chosen[0].file} is too long to be fitted as a whole: {len(self.chosen)} stretches of {length:.4g} s, the "
            f"most informative of {self.windows} windows, are used ({sum(s.held_out for s in self.chosen)} held out). "
            f"They begin at {places}.{skipped}"
        )


def information(recording: Recording, blocks: int = 512) -> np.ndarray | None:
    """The Gram matrix (8, 8) of the features of a window; None where the axis does not move or the input is constant."""
    v, q = measured_velocity(recording), measured_angle(recording)
    noise = white_noise_level(v)
    if (recording.driven and np.ptp(recording.input) == 0) or np.std(v) < 1.5 * noise or np.ptp(v) == 0:
        return None
    width = max(1, len(v) // blocks)
    count = len(v) // width
    cut = count * width
    means = [x[:cut].reshape(count, width).mean(axis=1) for x in (v, q)]
    fast = np.sqrt(np.mean(np.diff(v, prepend=v[0])[:cut].reshape(count, width) ** 2, axis=1))
    speed, angle = means
    moves = np.abs(speed) > SIGMAS * noise / np.sqrt(width)
    rate = np.gradient(speed, width * recording.dt)
    table = np.column_stack([rate, speed, np.sign(speed) * moves, speed * np.abs(speed), np.ones(count), angle, angle**2, fast])
    return np.asarray(table.T @ table / count)


def informative(grams: Sequence[np.ndarray | None], count: int) -> list[tuple[int, float]]:
    """(window, what it adds to log det) of ``count`` windows, in the order of choice.

    Of the windows of a part of the recording (``count`` parts of equal length) from which none is chosen yet the best one is
    taken, when it adds at least `MOST` of what the best of all windows adds.
    """
    usable = [i for i, g in enumerate(grams) if g is not None]
    if not usable:
        return []
    stack = np.array([grams[i] for i in usable])
    values, vectors = np.linalg.eigh(np.mean(stack, axis=0))
    keep = values > 1e-12 * values[-1]
    white = vectors[:, keep] / np.sqrt(values[keep])
    stack = white.T @ stack @ white
    part = np.array(usable) * count // len(grams)
    total = 1e-3 * np.eye(stack.shape[1])
    free, fresh = np.ones(len(usable), bool), np.ones(count, bool)
    chosen: list[tuple[int, float]] = []
    while len(chosen) < count and free.any():
        gain = np.linalg.slogdet(total + stack)[1] - np.linalg.slogdet(total)[1]
        gain[~free] = -np.inf
        best = int(np.argmax(gain))
        new = np.where(fresh[part], gain, -np.inf)
        if np.max(new) >= MOST * gain[best]:
            best = int(np.argmax(new))
        chosen.append((usable[best], float(gain[best])))
        total = total + stack[best]
        free[best], fresh[part[best]] = False, False
    return chosen


def choose(
    file: str, sha256: str, windows: Callable[[int], Iterator[tuple[int, Recording | None]]], *, held_out: bool | None = None
) -> Stretches:
    """The most informative windows of a recording that is read twice: once for what each tells, once for the chosen ones.

    ``windows(rows)`` gives (first row, recording) of windows of so many rows, None for one that cannot be read. ``held_out``:
    whether the recording as a whole is; else every third of the windows, in the order of choice. Raises InputError where none
    can be used.
    """
    rows = LONGEST // 2 // STRETCH_COUNT
    grams = [None if r is None or len(r) < rows else information(r) for _, r in windows(rows)]
    ranked = informative(grams, STRETCH_COUNT)
    order = {index: place for place, (index, _) in enumerate(ranked)}
    found: list[tuple[Stretch, Recording]] = []
    for index, (first, recording) in enumerate(windows(rows)):
        if index not in order or recording is None:
            continue
        times = float(recording.time[0]), float(recording.time[-1])
        held = order[index] % 3 == 2 if held_out is None else held_out
        stretch = Stretch(file, first, first + len(recording), *times, ranked[order[index]][1], held)
        digest = hashlib.sha256(f"{sha256}:{first}:{len(recording)}".encode()).hexdigest()
        recording = dataclasses.replace(recording, source=f"{file} [{times[0]:.6g}-{times[1]:.6g} s]", sha256=digest)
        try:
            prepare(recording)
        except InputError:
            continue
        found.append((stretch, recording))
    if not found or (held_out is None and all(s.held_out for s, _ in found)):
        raise InputError(
            file, f"none of its {len(grams)} windows of {rows} samples can be used (gaps, no motion, a constant input)",
            "an axis that moves", "give a part of the recording in which it does",
        )  # fmt: skip
    return Stretches(tuple(s for s, _ in found), tuple(r for _, r in found), len(grams), sum(g is None for g in grams))
