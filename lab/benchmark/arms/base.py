"""What every arm is: a name, and a function from a task to an answer."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from mjsim.axis import Axis
from mjsim.recording import Recording

__all__ = ["Answer", "Arm", "Task"]


@dataclass(frozen=True)
class Task:
    """One case as an arm gets it.

    ``diagnosis``: the ``diagnosis.json`` of the same two recordings, for the figures of the refitted nominal model, which need
    not be fitted again; empty when there is none.
    """

    model: Path
    nominal: Axis
    estimation: Recording
    held_out: Recording
    diagnosis: Mapping[str, Any]

    @property
    def refitted_rms(self) -> float:
        """Held-out rms [rad/s] of the refitted nominal model as the diagnosis has it; nan without a diagnosis."""
        value = self.diagnosis.get("fit", {}).get("refitted", {}).get("held_out_rms")
        return math.nan if value is None else float(value)


@dataclass(frozen=True)
class Answer:
    """What an arm reached.

    ``held_out_rms``: free-run error [rad/s] on the held-out recording; ``refitted_rms``: that of the refitted nominal model,
    judged alike (same samples, same filter); ``noise_gain``: rms of white noise of rms 1 after that filter. ``named``: the
    effects or terms that it says are missing, None for an arm that names nothing. ``note``: what else is worth knowing.
    """

    held_out_rms: float
    refitted_rms: float
    noise_gain: float = 1.0
    named: tuple[str, ...] | None = None
    note: str = ""


@dataclass(frozen=True)
class Arm:
    """A rival.

    ``names``: what its answer names, "effects" (``effect@place`` of the library), "terms" or "" for nothing; ``needs``: modules
    that it imports beyond the core dependencies, all of the ``bench`` extra.
    """

    id: str
    what: str
    fit: Callable[[Task], Answer]
    names: str = ""
    needs: tuple[str, ...] = ()

    def lacks(self) -> tuple[str, ...]:
        """The modules that are not installed."""
        return tuple(m for m in self.needs if not _installed(m))

    def run(self, task: Task) -> dict[str, Any]:
        """The answer as plain values with its ``seconds``; one that breaks is ``{"error": text}``, never dropped."""
        began = time.perf_counter()
        try:
            answer = asdict(self.fit(task))
        except Exception as error:  # one case that breaks must not end the run; it is counted and listed
            return {"error": f"{type(error).__name__}: {error}", "seconds": time.perf_counter() - began}
        return {**answer, "seconds": time.perf_counter() - began}


def _installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False
