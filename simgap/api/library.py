"""`Library`: the effects that a diagnosis can name, by their identifiers; `simgap.effects` is the one there is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, final

from mjsim.effects import Effect, registered
from mjsim.effects.registry import named_instead

if TYPE_CHECKING:
    import pandas

__all__ = ["Library", "effects"]


@final
class Library(Mapping[str, type[Effect]]):
    """Effects by identifier; the value is the class of the effect, whose parameters are its arguments.

    >>> import simgap
    >>> "backlash" in simgap.effects
    True
    >>> gap = simgap.effects["backlash"](place="gearbox", gap_rad=1e-3)
    >>> gap.values
    {'gap_rad': 0.001}
    >>> [(p.name, p.unit()) for p in gap.specs()]
    [('gap_rad', 'rad')]
    """

    def __getitem__(self, name: str) -> type[Effect]:
        known = registered()
        if name not in known:
            raise KeyError(f"unknown effect {name!r}: {named_instead(name, known, 'list(simgap.effects) names them')}")
        return known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(registered())

    def __len__(self) -> int:
        return len(registered())

    def __repr__(self) -> str:
        return f"<{len(self)} effects: {', '.join(self)}>"

    def to_frame(self) -> pandas.DataFrame:
        """Identifier, places, parameters with their units, and the source in the literature; one row an effect."""
        from simgap.api.frames import frame

        rows = [
            {
                "effect": name, "places": ", ".join(cls.places), "source": cls.citation,
                "parameters": ", ".join(f"{s.name} [{s.unit()}]" for s in cls.specs()),
            }
            for name, cls in self.items()
        ]  # fmt: skip
        return frame(("effect", "places", "parameters", "source"), rows)


effects = Library()
