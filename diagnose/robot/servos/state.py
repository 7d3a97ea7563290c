"""The state of a search at one servo joint: problem, options, what stands, and what a step would gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from diagnose.evidence.held_out import Comparison, compare
from diagnose.fit.fitted import HeldOut
from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.fit import Fit, Number, fit, independent
from diagnose.robot.servos.library import ServoLaw
from diagnose.robot.servos.motion import JointProblem
from mjsim.robot.joint_kernel import SLOT

__all__ = ["QUICK", "JointSearch", "Step", "Structure", "cleared", "free_numbers", "held_out", "replaced"]

QUICK = 10  # iterations of a finalist's fit


@dataclass(frozen=True, eq=False)
class Structure:
    """A set of laws with its fit."""

    laws: tuple[ServoLaw, ...]
    fit: Fit

    @property
    def key(self) -> frozenset[str]:
        """What tells structures apart."""
        return frozenset(law.key for law in self.laws)

    @property
    def values(self) -> dict[str, float]:
        """Slot values by name."""
        return {name: float(self.fit.slots[k]) for name, k in SLOT.items()}


@dataclass(frozen=True)
class Step:
    """Gain of one structure over another: fitted (less the price), held-out comparison, and held-out log-likelihood gain."""

    gain: float
    held: Comparison
    likelihood: float

    @property
    def total(self) -> float:
        """On fitted and held-out samples together."""
        return self.gain + self.likelihood


@dataclass(eq=False)
class JointSearch:
    """The search at one joint, and where it stands."""

    problem: JointProblem
    options: RobotOptions
    numbers: tuple[Number, ...]
    now: Structure
    refitted: Structure
    laws: tuple[ServoLaw, ...]
    joints: int
    refusals: dict[str, str] = field(default_factory=dict)
    removed: set[str] = field(default_factory=set)
    visited: set[frozenset[str]] = field(default_factory=set)
    without: dict[str, Structure] = field(default_factory=dict)
    alike: dict[str, tuple[str, ...]] = field(default_factory=dict)
    clock: str = ""

    def note_clock(self, sentence: str, told: bool) -> None:
        """Keep in words whether the servo or the log is late; where it is not told, the other one is an equivalent."""
        self.clock = sentence
        for law in self.now.laws:
            if law.is_delay:
                others = tuple(x for x in self.alike.get(law.key, ()) if x != law.id)
                self.alike[law.key] = others if told else (law.id, *others)

    def cleared(self, rest: Sequence[ServoLaw]) -> np.ndarray:
        """Slots of the present fit with those of other laws as in the file."""
        return cleared(self.now.laws, rest, self.now.fit.slots, self.problem.nominal)

    @property
    def weights(self) -> np.ndarray:
        """Of the samples' errors (N,)."""
        return self.now.fit.weights

    def multiplicity(self, law: ServoLaw) -> float:
        """What a p-value is multiplied by: half of the level for the commonest law at any joint, half for all others at all
        joints.

        Source: C. R. Genovese, K. Roeder, L. Wasserman, Biometrika 93 (2006) 509.
        """
        common = sum(x.common for x in self.laws)
        if common in (0, len(self.laws)):
            return float(self.joints * len(self.laws))
        return 2.0 * self.joints * (common if law.common else len(self.laws) - common)

    @property
    def entry(self) -> float:
        """Extended BIC: 2 log of the number of (joint, law, start)."""
        return 2.0 * math.log(self.joints * sum(len(x.starts) for x in self.laws))

    @property
    def independent_samples(self) -> float:
        """Independent fitted samples, by the error without effects."""
        p, n = self.problem, 0.0
        for k in range(len(p.sources)):
            e = self.refitted.fit.error[p.part(k)][p.fitted[p.part(k)]]
            n += len(e) * independent(e, p.dt) if len(e) else 0.0
        return max(n, 3.0)

    def price(self, laws: Sequence[ServoLaw]) -> float:
        """Cost of the numbers of laws: log of the independent samples each, and 2 log of the starts of a law."""
        n = self.independent_samples
        return sum(math.log(n) * len(x.numbers) + 2.0 * math.log(len(x.starts)) for x in laws)

    def gain(self, poorer: Fit, richer: Fit, which: str) -> float:
        """Twice the log-likelihood ratio on the fitted or held-out samples, by the independent ones of each recording."""
        p = self.problem
        before = after = count = 0.0
        for k in range(len(p.sources)):
            mask = getattr(p, which)[p.part(k)]
            a, b = poorer.error[p.part(k)][mask], richer.error[p.part(k)][mask]
            if len(a):
                w2 = self.weights[p.part(k)][mask] ** 2
                least = float(np.sum(w2)) * p.noise**2
                before, after = before + max(float(w2 @ a**2), least), after + max(float(w2 @ b**2), least)
                count += independent(b, p.dt, a - b) * len(a)
        return count * math.log(before / after) if after > 0 else 0.0

    def step(self, poorer: Structure, richer: Structure) -> Step:
        """What a structure gains over another one."""
        more = self.price(richer.laws) - self.price(poorer.laws)
        before, after = (held_out(self.problem, x.fit.error, self.weights, poorer.fit.error - richer.fit.error, richer.fit.error)
                         for x in (poorer, richer))  # fmt: skip
        return Step(
            self.gain(poorer.fit, richer.fit, "fitted") - more, compare(before, after), self.gain(poorer.fit, richer.fit, "held")
        )

    def why_not(self, step: Step, law: ServoLaw, ease: float = 1.0) -> str:
        """The test that refuses a step; empty when none does."""
        if not (step.gain > 0.0 and step.total > self.entry / ease):
            return f"gains {step.gain:.1f} on the fitted samples, {step.total:.1f} on all; {self.entry / ease:.1f} needed"
        if step.held.relative_gain < self.options.material / ease:
            taken, needed = 100 * step.held.relative_gain, 100 * self.options.material
            return f"takes {taken:.1f} % off the held-out squared error, {needed:g} % needed"
        p = min(1.0, step.held.p_value * self.multiplicity(law))
        if p > self.options.p_enter * ease:
            return f"held-out p = {p:.2g} over all joints and laws, {self.options.p_enter:g} needed"
        return ""

    def sane(self, structure: Structure) -> bool:
        """Whether all laws have physical numbers."""
        return all(law.sane(structure.values) for law in structure.laws)

    def fitted(
        self, laws: Sequence[ServoLaw], base: np.ndarray, most: int = QUICK, part: JointProblem | None = None
    ) -> Structure:
        """Laws fitted from slots, to all fitted samples or to a part."""
        return Structure(tuple(laws), fit(self.problem, free_numbers(self.numbers, laws), base, self.weights, most, part))


def held_out(
    problem: JointProblem, error: np.ndarray, weights: np.ndarray, difference: np.ndarray | None = None,
    left: np.ndarray | None = None
) -> HeldOut:  # fmt: skip
    """Held-out errors in blocks three times as long as they remember, in weights (N,)."""
    errors, sse, count, squares, spread = [], [], [], 0.0, 0.0
    for k in range(len(problem.sources)):
        part, mask = problem.part(k), problem.held[problem.part(k)]
        if not mask.any():
            continue
        e, a, w = error[part][mask], problem.angle[part][mask], weights[part][mask]
        own = e if left is None else left[part][mask]
        share = independent(own, problem.dt, None if difference is None else difference[part][mask])
        memory = 3 * max(1, round(1.0 / share))
        for stretch in np.split(np.arange(len(e)), np.flatnonzero(np.diff(np.flatnonzero(mask)) > 1) + 1):
            for piece in np.array_split(e[stretch] * w[stretch], max(1, round(len(stretch) / memory))):
                errors.append(piece)
                sse.append(float(piece @ piece))
                count.append(len(piece))
        squares += float(e @ e)
        spread += float(np.sum((a - np.mean(a)) ** 2))
    flat = np.concatenate(errors) if errors else np.zeros(0)
    return HeldOut(
        flat, np.array(sse), np.array(count), math.sqrt(squares / max(len(flat), 1)), math.sqrt(squares / (spread + 1e-300))
    )


def free_numbers(numbers: Sequence[Number], laws: Sequence[ServoLaw]) -> tuple[Number, ...]:
    """Numbers that are free with laws: the file's own, but those that a law fills, then the laws'."""
    own = {n.slot for law in laws for n in law.numbers}
    return (*(n for n in numbers if n.slot not in own), *dict.fromkeys(n for law in laws for n in law.numbers))


def replaced(laws: Sequence[ServoLaw], new: ServoLaw) -> tuple[ServoLaw, ...]:
    """Laws with a new one, in place of those that it contains, or that contain it, or that fill the same slots."""
    kept = [x for x in laws if not (x.id in new.holds or new.id in x.holds or x.id == new.id) and not (_shared(x, new))]
    return (*kept, new)


def _shared(a: ServoLaw, b: ServoLaw) -> bool:
    both = (set(a.slots) & set(b.slots)) - {"friction"}
    return bool(both)


def cleared(laws: Sequence[ServoLaw], kept: Sequence[ServoLaw], slots: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Slots with those of laws that are gone as in the file."""
    out = slots.copy()
    own = {x for law in kept for x in law.slots}
    for law in laws:
        for name in law.slots:
            if name not in own:
                out[SLOT[name]] = nominal[SLOT[name]] if name != "friction" or nominal[SLOT["friction"]] == 0 else out[SLOT[name]]
    return out
