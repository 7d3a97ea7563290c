"""The best fit of each structure of one problem, and its held-out error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import final

from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter

__all__ = ["Fits", "Key"]

Key = tuple[str, ...]
"""A structure: the sorted keys of its effects."""


@final
class Fits(Mapping[Key, Fitted]):
    """The best fit of each structure. A fit is never forgotten, a better one takes its place."""

    def __init__(self) -> None:
        self._best: dict[Key, Fitted] = {}
        self._held_out: dict[Key, HeldOut | None] = {}

    def __getitem__(self, key: Key) -> Fitted:
        return self._best[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._best)

    def __len__(self) -> int:
        return len(self._best)

    def keep(self, f: Fitted) -> None:
        """Take a fit, unless it failed or a better one of its structure is there."""
        best = self._best.get(f.key)
        if f.ok and (best is None or f.chi2 < best.chi2):
            self._best[f.key] = f
            self._held_out.pop(f.key, None)

    def best(self, f: Fitted) -> Fitted:
        """The best fit of the structure of ``f``; ``f`` where there is none."""
        return self._best.get(f.key, f)

    def common(self, f: Fitted, other: Fitted) -> Fitted | None:
        """The structure of the effects that two structures share."""
        return self._best.get(tuple(sorted(set(f.key) & set(other.key))))

    def held_out(self, f: Fitted, fitter: Fitter) -> HeldOut | None:
        """Held-out error of a structure: computed once for its best fit."""
        if f.key not in self._held_out:
            self._held_out[f.key] = fitter.validate(f)
        return self._held_out[f.key]

    def known_held_out(self, f: Fitted) -> HeldOut | None:
        """Held-out error of a structure if it was computed."""
        return self._held_out.get(f.key)
