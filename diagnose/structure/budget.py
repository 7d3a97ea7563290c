"""How long a search may look, and what it takes for an effect to enter."""

from __future__ import annotations

from dataclasses import dataclass

from diagnose.problem.noise_model import KnownNoise, Prices

__all__ = ["SearchOptions"]


@dataclass(frozen=True)
class SearchOptions:
    """Budgets and thresholds.

    price: of a parameter in C; entry: least gain of C (after the price) for an effect to enter; material: least relative gain of
    held-out squared error; p_enter: largest one-sided p-value of the held-out gain, times the number of structures asked about;
    depth: most effects; width: rivals fitted in full at each move.
    """

    price: float = KnownNoise.prices.price
    entry: float = KnownNoise.prices.entry
    material: float = KnownNoise.prices.material
    p_enter: float = KnownNoise.prices.p_enter
    depth: int = 3
    width: int = 10
    only: tuple[str, ...] = ()

    @property
    def prices(self) -> Prices:
        """What an effect must achieve to enter."""
        return Prices(self.price, self.entry, self.material, self.p_enter)
