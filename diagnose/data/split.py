"""Which recordings, or parts of them, are fitted and which are held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

from diagnose.data.experiment import Experiment, fewest_of, hold_out_blocks, prepare, with_common_noise
from mjsim.errors import InputError
from mjsim.recording import Recording

__all__ = ["Split", "split"]

Split = tuple[tuple[Experiment, ...], tuple[Experiment, ...]]
"""Estimation and held-out experiments."""


def split(recordings: Sequence[Recording], held_out: Sequence[Recording]) -> Split:
    """Estimation and held-out experiments; blocks of the recordings where no other recording is given."""
    ready = partial(prepare, minimum=fewest_of(recordings))
    if held_out:
        used = {r.sha256: r.source for r in recordings if r.sha256}
        for r in held_out:
            if r.sha256 in used:
                raise InputError(
                    f"--held-out {r.source}", f"the same data as {used[r.sha256]}, which is fitted",
                    "a recording that is not fitted", "leave it out: blocks of the recordings are then held out",
                )  # fmt: skip
        every = with_common_noise([ready(r) for r in (*recordings, *held_out)])
        return every[: len(recordings)], every[len(recordings) :]
    every = with_common_noise(list(map(ready, recordings)))
    masks = [hold_out_blocks(r) for r in recordings]
    estimation, held = (
        tuple(dataclasses.replace(e, counts=e.counts & mask[i]) for e, mask in zip(every, masks, strict=True)) for i in (0, 1)
    )
    return estimation, held
