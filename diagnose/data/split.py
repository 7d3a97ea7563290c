"""Which recordings, or parts of them, are fitted and which are held out."""

from __future__ import annotations

from collections.abc import Sequence

from diagnose.data.experiment import Experiment, hold_out_blocks, prepare
from mjsim.errors import InputError
from mjsim.recording import Recording

__all__ = ["Split", "split"]

Split = tuple[tuple[Experiment, ...], tuple[Experiment, ...]]
"""Estimation and held-out experiments."""


def split(recordings: Sequence[Recording], held_out: Sequence[Recording]) -> Split:
    """Estimation and held-out experiments; blocks of the recordings where no other recording is given."""
    if held_out:
        used = {r.sha256: r.source for r in recordings if r.sha256}
        for r in held_out:
            if r.sha256 in used:
                raise InputError(
                    f"--held-out {r.source}", f"the same data as {used[r.sha256]}, which is fitted",
                    "a recording that is not fitted", "leave it out: blocks of the recordings are then held out",
                )  # fmt: skip
        return tuple(prepare(r) for r in recordings), tuple(prepare(r) for r in held_out)
    estimation, held = [], []
    for r in recordings:
        mine, other = hold_out_blocks(r)
        estimation.append(prepare(r, counts=mine))
        held.append(prepare(r, counts=other))
    return tuple(estimation), tuple(held)
