"""What the whole study found: the claims with their verdicts, the figures, and the fits behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lab.study.claims import Group
from lab.study.damping import DampingStudy
from lab.study.figures import Picture
from lab.study.ledger import Entry
from lab.study.robot import Robot, RobotResult

__all__ = ["Study"]


@dataclass(frozen=True)
class Study:
    """What the study found."""

    entries: tuple[Entry, ...]
    base: Group
    better: Group
    ladder: tuple[Mapping[str, Any], ...]
    damping: DampingStudy
    robot: Robot
    robot_results: tuple[RobotResult, ...]
    pictures: tuple[Picture, ...]
    claims: list[dict[str, Any]]
    cells: int
    computed: int
    quick: bool
    seconds: float
