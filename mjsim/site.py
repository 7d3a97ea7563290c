"""Sites: where in a model something acts, by an MJCF joint and a side of it.

The contract's place strings (``motor``, ``gearbox``, ``arm``, ``actuator``, ``sensor``) are aliases of sites on one chain:
`Chain.site` and `Chain.place` convert.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

__all__ = ["Side", "Site"]


class Side(enum.Enum):
    """What of a joint is meant."""

    MOTOR = "motor"  # the body that the actuator drives
    LINK = "link"  # a body behind a coupling
    COUPLING = "coupling"  # the spring, gear or gap between two bodies
    ACTUATOR = "actuator"  # the way from the command to the torque
    SENSOR = "sensor"  # the way from the motion to the log


@dataclass(frozen=True)
class Site:
    """An MJCF joint and a side of it; ``str()`` and `parse` are ``joint/side``."""

    joint: str
    side: Side

    def __str__(self) -> str:
        return f"{self.joint}/{self.side.value}"

    @classmethod
    def parse(cls, text: str) -> Site:
        """The site that ``joint/side`` names. Raises ValueError with the sides that there are."""
        joint, _, side = text.rpartition("/")
        try:
            found = Side(side)
        except ValueError:
            found = None
        if found is None or not joint:
            raise ValueError(f"site {text!r}; expected joint/side with a side of {', '.join(s.value for s in Side)}")
        return cls(joint, found)
