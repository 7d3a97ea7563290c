"""Is the delay of a joint one of its servo, or are its positions logged late? The other joints tell.

A servo that acts late moves its joint late, and the others feel that motion when it is logged. A position column that is late
shows a motion that the others felt before. Both hypotheses are fitted at every joint: what the joints carry is computed from the
positions as logged, or from positions that are moved earlier.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.robot.servos.fit import MOST, fit
from diagnose.robot.servos.library import ServoLaw
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.state import JointSearch, Structure, free_numbers
from diagnose.thresholds import EQUIVALENT
from mjsim.robot.joint_kernel import SLOT

__all__ = ["Clock", "clocks"]

FEW = 3  # joints with a delay, up to which every set of late columns is tried; else none, each and all
ROUNDS = 2  # times that the positions are moved by the delay that was fitted before

Series = Callable[[Mapping[str, float]], Sequence[JointProblem]]
Lates = dict[str, float]


@dataclass(frozen=True)
class Clock:
    """What the robot tells about the delay of one joint: twice the log-likelihood ratio of a late column over a late servo."""

    joint: str
    evidence: float
    seconds: float

    @property
    def log(self) -> bool:
        """Whether the column is late."""
        return self.evidence > EQUIVALENT

    @property
    def distinguishable(self) -> bool:
        """Whether the data distinguish the two hypotheses."""
        return abs(self.evidence) > EQUIVALENT

    @property
    def sentence(self) -> str:
        """For the finding."""
        if not self.distinguishable:
            return "A late servo and a late column of positions cannot be told apart here: check the stamps of the log."
        which, other = ("the column of positions is late", "servo") if self.log else ("the servo is late", "column")
        ratio = f"twice the log-likelihood ratio over a late {other} is {abs(self.evidence):.0f}"
        return f"By all joints together, {which} ({ratio})."


def clocks(searches: Sequence[JointSearch], series: Series) -> tuple[list[Clock], Lates]:
    """For each joint with a delay, whether its column of positions is late, and the best set of late columns [s].

    ``series``: the problems of all joints, with positions of some joints moved earlier [s].
    """
    suspects = {s.problem.name: _delay(s) for s in searches if _delay(s) > 0.0}
    if not suspects:
        return [], {}
    base = {s.problem.name: s.now if s.problem.name not in suspects else _formed(s, s.problem, False) for s in searches}
    names = list(suspects)
    every = len(names) if len(names) <= FEW else 1
    sets = [x for k in range(1, every + 1) for x in itertools.combinations(names, k)]
    if tuple(names) not in sets:
        sets.append(tuple(names))
    weighed: dict[tuple[str, ...], tuple[float, Lates]] = {(): (0.0, {})}
    for chosen in sets:
        weighed[chosen] = _weighed(searches, base, {n: suspects[n] for n in chosen}, series)
    out = []
    for name in names:
        late, not_late = (max(v[0] for k, v in weighed.items() if (name in k) == there) for there in (True, False))
        out.append(Clock(name, late - not_late, suspects[name]))
    told = {c.joint for c in out if c.log}
    best = max((v for k, v in weighed.items() if set(k) <= told), key=lambda v: v[0])
    return [c if c.joint in best[1] or not c.log else dataclasses.replace(c, evidence=0.0) for c in out], best[1]


def _delay(s: JointSearch) -> float:
    return sum(float(s.now.fit.slots[SLOT[n.slot]]) for law in s.now.laws if law.is_delay for n in law.numbers)


def _formed(s: JointSearch, problem: JointProblem, late: bool) -> Structure:
    """The laws that stand with the delay in one of its forms, fitted."""
    form = next(x for x in s.laws if x.is_delay and x.is_logged == late)
    laws: tuple[ServoLaw, ...] = tuple(form if x.is_delay else x for x in s.now.laws)
    slots, seconds = s.now.fit.slots.copy(), _delay(s)
    slots[SLOT["late"]], slots[SLOT["delay"]] = (seconds, 0.0) if late else (0.0, seconds)
    return Structure(laws, fit(problem, free_numbers(s.numbers, laws), slots, s.weights, MOST))


def _weighed(
    searches: Sequence[JointSearch], base: Mapping[str, Structure], lates: Mapping[str, float], series: Series
) -> tuple[float, Lates]:
    """Twice the log-likelihood ratio of late columns over late servos, all joints together, and the delays of the columns [s]."""
    total, now = 0.0, dict(lates)
    for _ in range(ROUNDS):
        total, used = 0.0, dict(now)
        for s, problem in zip(searches, series(used), strict=True):
            name = problem.name
            if name in used:
                trial = _formed(s, problem, True)
                now[name] = float(trial.fit.slots[SLOT["late"]])
            else:
                was = base[name]
                trial = Structure(was.laws, fit(problem, was.fit.numbers, was.fit.slots, s.weights, MOST))
            total += dataclasses.replace(s, problem=problem).step(base[name], trial).total
        if all(np.isclose(now[n], used[n], rtol=0.0, atol=1e-4) for n in now):
            break
    return total, now
