"""What the error of a right model is: sensor noise of a known level, or the model's own error, whose level is not known.

Under known noise chi-square over n is compared with one, samples are independent once the error is whitened, and a held-out error
is compared with the noise. Judged by force the error is the model's own: it is coloured, its level is not known, and evidence is
relative (docs/decisions/evidence.md).
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import final

__all__ = ["KnownNoise", "ModelError", "NoiseModel", "Prices"]


@dataclass(frozen=True)
class Prices:
    """What an effect must achieve to enter.

    price: of a parameter in the criterion C = n log(chi2 / n) + price * parameters; entry: least gain of C; material: least
    relative gain of the held-out squared error; p_enter: largest one-sided p-value of that gain, over the hypotheses asked about.
    """

    price: float
    entry: float
    material: float
    p_enter: float


class NoiseModel(abc.ABC):
    """How large an error may be by noise alone."""

    prices: Prices
    absolute: bool
    """Whether the level is known, so that an error can be compared with it."""

    @abc.abstractmethod
    def exceeds(self, ratio: float, level: float) -> bool:
        """Whether a mean square over the noise variance is certain to lie above a level."""

    @abc.abstractmethod
    def within(self, ratio: float, level: float) -> bool:
        """Whether a mean square over the noise variance is certain to lie at or below a level."""

    @abc.abstractmethod
    def hypotheses(self, asked: int, candidates: int) -> int:
        """How many hypotheses a held-out p-value is corrected for.

        asked: structures that the held-out data were asked about; candidates: effects and places that the search considers.
        """

    @abc.abstractmethod
    def cost_at(self, level: float, n: int) -> float:
        """The chi-square of n samples at a level times the noise variance; infinite where the level is not known."""

    @abc.abstractmethod
    def floor(self, rms: float, unknown: float = math.nan) -> float:
        """The noise rms, given what it is if it is known; else ``unknown``."""


@final
class KnownNoise(NoiseModel):
    """Sensor noise whose level the recording tells.

    The estimation data choose a structure among the candidates, so that only structures that the held-out data are asked about
    count as hypotheses.
    """

    prices = Prices(price=8.0, entry=25.0, material=0.0015, p_enter=0.01)
    absolute = True

    def exceeds(self, ratio: float, level: float) -> bool:
        """Compared with the level."""
        return ratio > level

    def within(self, ratio: float, level: float) -> bool:
        """Compared with the level."""
        return ratio <= level

    def hypotheses(self, asked: int, candidates: int) -> int:
        """Those that the held-out data were asked about."""
        return asked

    def cost_at(self, level: float, n: int) -> float:
        """level n."""
        return level * n

    def floor(self, rms: float, unknown: float = math.nan) -> float:
        """The noise rms."""
        return rms


@final
class ModelError(NoiseModel):
    """An error of the model itself, which both recordings share: all candidates count as hypotheses.

    Independent samples are few: the price of a parameter is about Akaike's, and the held-out data judge.
    """

    prices = Prices(price=6.0, entry=10.0, material=0.02, p_enter=0.02)
    absolute = False

    def exceeds(self, ratio: float, level: float) -> bool:
        """Never: the level is not known."""
        return False

    def within(self, ratio: float, level: float) -> bool:
        """Never: the level is not known."""
        return False

    def hypotheses(self, asked: int, candidates: int) -> int:
        """All candidates."""
        return max(1, candidates)

    def cost_at(self, level: float, n: int) -> float:
        """Infinite."""
        return math.inf

    def floor(self, rms: float, unknown: float = math.nan) -> float:
        """Not known."""
        return unknown
