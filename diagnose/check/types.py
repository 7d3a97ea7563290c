"""What a check of a log returns: problems with a number, a unit and an advice, and one verdict over them."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

__all__ = ["Excitation", "LogCheck", "LogVerdict", "Problem", "Severity", "TorqueTrace"]


class Severity(enum.Enum):
    """What a problem means for a diagnosis: LIMITS narrows what it can show, FIX makes it wrong."""

    LIMITS = "limits"
    FIX = "fix"


class LogVerdict(enum.Enum):
    """The three answers; the value stands in the JSON."""

    READY = "ready"
    LIMITS = "limits"
    FIX = "fix"


@dataclass(frozen=True)
class Problem:
    """One problem of one recording.

    channel: role in the recording (time, torque, velocity, angle); problem: identifier of the fault; value [unit] with ci95 where
    it is estimated; sentence: what is wrong; advice: what to do; marks: intervals (start, end) [s] at which it shows; recording:
    file name.
    """

    channel: str
    problem: str
    value: float
    unit: str
    sentence: str
    advice: str
    severity: Severity
    ci95: tuple[float, float] | None = None
    marks: tuple[tuple[float, float], ...] = ()
    recording: str = ""

    def as_dict(self) -> dict[str, Any]:
        """As in the contract, with the sentence, the severity, the interval and the file beside it."""
        return {
            "channel": self.channel,
            "problem": self.problem,
            "value": self.value,
            "unit": self.unit,
            "advice": self.advice,
            "sentence": self.sentence,
            "severity": self.severity.value,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "recording": self.recording,
        }


@dataclass(frozen=True)
class Excitation:
    """Whether one family of effects can be identified from the recordings: a word and the reason with its numbers."""

    family: str
    identifiable: bool
    sentence: str

    def as_dict(self) -> dict[str, Any]:
        """By name."""
        return {"family": self.family, "identifiable": self.identifiable, "sentence": self.sentence}


@dataclass(frozen=True, eq=False)
class TorqueTrace:
    """Logged torque at the estimated delay and what the fitted relation needs for the motion (M,), units of the input; time
    [s]."""

    time: np.ndarray
    logged: np.ndarray
    needed: np.ndarray


@dataclass(frozen=True)
class LogCheck:
    """Outcome of a check: what was understood (topic -> sentence), the problems, and what the excitation allows.

    measured: per recording, the estimates that the checks rest on (delay, ratios, noise), for the JSON; torque: per recording,
    for the page; seconds: how long the check took; asked: the questions that were examined, in words.
    """

    understood: Mapping[str, str]
    problems: Sequence[Problem]
    excitation: Sequence[Excitation]
    measured: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    torque: Mapping[str, TorqueTrace] = field(default_factory=dict)
    seconds: float = math.nan
    asked: Sequence[str] = ()

    @property
    def verdict(self) -> LogVerdict:
        """FIX when any problem has to be fixed, LIMITS when any limits, else READY."""
        severities = {p.severity for p in self.problems}
        if Severity.FIX in severities:
            return LogVerdict.FIX
        return LogVerdict.LIMITS if severities else LogVerdict.READY

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        if self.verdict is LogVerdict.FIX:
            return f"The log is wrong and has to be fixed first. {self.to_fix()[0].sentence}"
        if self.verdict is LogVerdict.LIMITS:
            return f"The log can be used with limits. {self.problems[0].sentence}"
        return "The log is ready for a diagnosis."

    def to_fix(self) -> tuple[Problem, ...]:
        """The problems that have to be fixed first."""
        return tuple(p for p in self.problems if p.severity is Severity.FIX)

    def as_dict(self) -> dict[str, Any]:
        """``log`` of the contract's ``diagnosis.json``, and ``check.json``."""
        return {
            "verdict": self.verdict.value,
            "problems": [p.as_dict() for p in self.problems],
            "understood": dict(self.understood),
            "excitation": [e.as_dict() for e in self.excitation],
            "measured": {k: dict(v) for k, v in self.measured.items()},
        }
