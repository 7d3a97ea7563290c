"""The score: faults named, controls on which anything is named, and faults that a diagnosis would take for physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from diagnose.check import LogCheck, LogVerdict, Machine, check_log
from lab.log_faults.cases import KINDS, Case, draw

__all__ = ["Outcome", "Score", "interval", "judge", "measure"]

BAR = 0.95  # of the faults that must be named


@dataclass(frozen=True)
class Outcome:
    """One case: was the fault named, on the right channel; what else was named; the verdicts; what the control was told."""

    case: dict[str, Any]
    named: bool
    verdict: str
    also: tuple[str, ...]
    control: tuple[str, ...]
    seconds: float


@dataclass(frozen=True)
class Score:
    """All outcomes."""

    seed: int
    outcomes: tuple[Outcome, ...]

    @property
    def named(self) -> int:
        """Faults that were named."""
        return sum(o.named for o in self.outcomes)

    @property
    def alarms(self) -> int:
        """Controls on which a fault was named."""
        return sum(bool(o.control) for o in self.outcomes)

    @property
    def passed_on(self) -> int:
        """Faults that were not named and whose log a diagnosis would search for physics."""
        return sum(not o.named and o.verdict != LogVerdict.FIX.value for o in self.outcomes)

    def holds(self) -> bool:
        """Whether the bars are met."""
        return self.named >= BAR * len(self.outcomes) and self.alarms == 0

    def text(self) -> str:
        """The score in lines."""
        n = len(self.outcomes)
        low, high = interval(self.named, n)
        lines = [
            f"seed {self.seed}: {self.named} of {n} faults named ({100 * self.named / n:.1f} %, "
            f"95 % {100 * low:.1f} to {100 * high:.1f} %)",
            f"controls with a fault named: {self.alarms} of {n} (95 % up to {100 * interval(self.alarms, n)[1]:.1f} %)",
            f"faults not named and passed on to the search for physics: {self.passed_on}",
        ]
        for kind in KINDS:
            of = [o for o in self.outcomes if o.case["kind"] == kind]
            if of:
                also = sum(bool(o.also) for o in of)
                fix = sum(o.verdict == LogVerdict.FIX.value for o in of)
                lines.append(
                    f"  {kind}: {sum(o.named for o in of)} of {len(of)}; {fix} fix first; {also} with something else named too"
                )
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """For the JSON."""
        n = len(self.outcomes)
        return {
            "seed": self.seed, "count": n, "named": self.named, "named_ci95": list(interval(self.named, n)),
            "control_alarms": self.alarms, "control_alarms_ci95": list(interval(self.alarms, n)), "passed_on": self.passed_on,
            "cases": [
                {**o.case, "named": o.named, "verdict": o.verdict, "also": list(o.also), "control": list(o.control)}
                for o in self.outcomes
            ],
        }  # fmt: skip


def interval(k: int, n: int) -> tuple[float, float]:
    """Clopper-Pearson 95 % interval of a share."""
    from scipy.stats import beta

    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return low, high


EXPECTED = {"sample_rate"}  # true of a slow log of the three-mass axis whatever else is wrong: no fault that was laid


def judge(case: Case, faulty: LogCheck, control: LogCheck) -> Outcome:
    """Compare what was named with what was laid."""
    right = [p for p in faulty.problems if p.problem == case.kind and p.channel in case.channels]
    also = tuple(f"{p.problem}/{p.channel}" for p in faulty.problems if p not in right and p.problem not in EXPECTED)
    told = tuple(f"{p.problem}/{p.channel}" for p in control.problems if p.problem not in EXPECTED)
    about = {
        "number": case.number,
        "machine": case.plant.name,
        "experiment": case.experiment,
        "kind": case.kind,
        "detail": case.detail,
    }
    return Outcome(about, bool(right), faulty.verdict.value, also, told, faulty.seconds)


def measure(count: int, seed: int, say: Callable[[str], None] = lambda _: None) -> Score:
    """Draw, check and judge so many cases."""
    outcomes = []
    for number in range(count):
        case = draw(number, seed)
        machine = Machine.of(case.plant.nominal)
        outcome = judge(case, check_log(machine, [case.faulty]), check_log(machine, [case.clean]))
        outcomes.append(outcome)
        word = "named" if outcome.named else "MISSED"
        c = outcome.case
        say(
            f"{number:3d} {c['machine']:15s} {c['experiment']:22s} {c['kind']:15s} {c['detail']:28s} {word}; {outcome.verdict}"
            f"; also {', '.join(outcome.also) or 'nothing'}; control {', '.join(outcome.control) or 'clean'}"
        )
    return Score(seed, tuple(outcomes))
