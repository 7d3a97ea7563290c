"""Recordings with the same channels: what one of them lacks is not used of the others either."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from mjsim.errors import InputError
from mjsim.recording import Recording

__all__ = ["with_common_channels"]


def with_common_channels(
    recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[list[Recording], list[Recording], tuple[str, ...]]:
    """Estimation and held-out recordings with the responses that all of them have, and a sentence for each that was left out.

    Raises InputError where they have no response in common.
    """
    everything = [*recordings, *held_out]
    said, gone = [], []
    for name in ("velocity", "angle"):
        lacking = [r.source for r in everything if getattr(r, name) is None]
        if lacking and len(lacking) < len(everything):
            gone.append(name)
            said.append(f"The {name} is not used: {', '.join(lacking)} {'has' if len(lacking) == 1 else 'have'} none.")
    nothing: dict[str, Any] = dict.fromkeys(gone)
    if not gone:
        return list(recordings), list(held_out), ()
    out = [[dataclasses.replace(r, **nothing) for r in group] for group in (recordings, held_out)]
    for r in (*out[0], *out[1]):
        if r.velocity is None and r.angle is None:
            raise InputError(
                r.source, "no response that the other recordings have too", "velocity or angle in all of them",
                "bind the same channel in each, or leave recordings out",
            )  # fmt: skip
    return out[0], out[1], tuple(said)
