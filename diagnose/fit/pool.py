"""The best fit of each structure by the present weights, and its held-out error."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import final

from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter

__all__ = ["Key", "Pool"]

Key = tuple[str, ...]
"""A structure: the sorted keys of its effects."""


@final
class Pool(Mapping[Key, Fitted]):
    """Fits by structure.

    `least` tells the lowest chi-square that a structure ever had, also of what was cleared since.
    """

    def __init__(self) -> None:
        self._fits: dict[Key, Fitted] = {}
        self._held: dict[Key, HeldOut | None] = {}
        self._least: dict[Key, float] = {}

    def __getitem__(self, key: Key) -> Fitted:
        return self._fits[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._fits)

    def __len__(self) -> int:
        return len(self._fits)

    def keep(self, f: Fitted) -> None:
        """Take a fit, unless it failed or a better one of its structure is there."""
        if not f.ok:
            return
        self._least[f.key] = min(f.chi2, self._least.get(f.key, math.inf))
        old = self._fits.get(f.key)
        if old is None or f.chi2 < old.chi2:
            self.put(f)

    def put(self, f: Fitted) -> None:
        """Let a fit stand for its structure, whatever was there."""
        self._fits[f.key] = f
        self._held.pop(f.key, None)

    def newest(self, f: Fitted) -> Fitted:
        """The fit that stands for the structure of ``f``; ``f`` where none does."""
        return self._fits.get(f.key, f)

    def common(self, f: Fitted, other: Fitted) -> Fitted | None:
        """The structure of the effects that two structures share."""
        return self._fits.get(tuple(sorted(set(f.key) & set(other.key))))

    def least(self, key: Key, default: float) -> float:
        """The lowest chi-square that a structure ever had."""
        return self._least.get(key, default)

    def held_out(self, f: Fitted, fitter: Fitter) -> HeldOut | None:
        """Held-out error of a structure: computed once for the fit that stands for it."""
        if f.key not in self._held:
            self._held[f.key] = fitter.validate(f)
        return self._held[f.key]

    def known_held_out(self, f: Fitted) -> HeldOut | None:
        """Held-out error of a structure if it was computed."""
        return self._held.get(f.key)

    def beside(self, f: Fitted) -> Pool:
        """A copy in which ``f`` stands for its structure."""
        other = Pool()
        other._fits, other._held, other._least = dict(self._fits), dict(self._held), self._least
        other.put(f)
        return other

    def adopt(self, f: Fitted, other: Pool) -> None:
        """Let ``f`` stand for its structure, with the held-out error that another pool knows of it."""
        self.put(f)
        if f.key in other._held:
            self._held[f.key] = other._held[f.key]

    def drop(self, *keys: Key) -> None:
        """Forget some structures."""
        for key in keys:
            self._fits.pop(key, None)

    def clear(self) -> None:
        """Forget all structures: they were fitted by other weights."""
        self._fits.clear()
        self._held.clear()
