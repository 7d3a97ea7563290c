"""Which effects one servo joint has: forward selection, refinement, exchange and removal, each step held to unseen samples.

A law is screened by what a run with it, at one of its starts, explains of the error beside the free numbers; the few best are
fitted with
all numbers free. One enters when it gains on the fitted samples (extended BIC), is physical, takes enough off the held-out
squared error
and passes the paired block tests at a level that counts all laws of all joints.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from diagnose.evidence.held_out import Comparison, compare
from diagnose.fit.fitted import HeldOut
from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.fit import (
    Fit,
    Number,
    counted,
    covariance,
    fit,
    independent,
    jacobian,
    weights_by_recording,
)  # fmt: skip
from diagnose.robot.servos.library import ServoLaw, servo_laws
from diagnose.robot.servos.motion import JointProblem
from mjsim.robot.joint_kernel import SLOT

__all__ = ["ALIKE", "QUICK", "JointSearch", "Structure", "held_out", "own_numbers", "refit_with", "search_joint", "start_fit"]

FINALISTS = 5  # laws that are fitted, by what the screening promises
PROMISING = 0.25  # of what is needed to enter: a promise is that of one start alone
ROUNDS = 12  # moves at most
QUICK = 10  # iterations of a finalist's fit
STAYS = 5.0  # times the level to enter, at which a law stays: what enters at 1 % may stay at 5 %
ALIKE = 10.0  # twice a log-likelihood ratio within which two laws are not told apart
INERTIA_PRIOR = math.log(3.0)  # of the armature's logarithm: a rotor's inertia is known to a factor of three
THIN = 4000  # samples on which starts are compared and finalists fitted first
REFITTED = 2  # finalists that are fitted to all samples
NOT_PHYSICAL = "its numbers are not physical"
GAIN_PRIOR = math.log(30.0)  # of a gain's logarithm: the file may be far off, but not by any factor
FAR = (1.0, 0.3, 0.1, 0.03, 0.01)  # gains over those of the file, from which the fit without effects starts


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

    def cleared(self, rest: Sequence[ServoLaw]) -> np.ndarray:
        """Slots of the present fit with those of other laws as in the file."""
        return _cleared(self.now.laws, rest, self.now.fit.slots, self.problem.nominal)

    @property
    def weights(self) -> np.ndarray:
        """Of the recordings' errors."""
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
                w2 = float(self.weights[k]) ** 2
                before, after = (
                    before + w2 * max(float(a @ a), len(a) * p.noise**2),
                    after + w2 * max(float(b @ b), len(a) * p.noise**2),
                )
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
        if step.gain < self.entry / ease:
            return f"gains {step.gain:.1f} on the fitted samples, {self.entry / ease:.1f} needed"
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
        return Structure(tuple(laws), fit(self.problem, _free(self.numbers, laws), base, self.weights, most, part))


def held_out(
    problem: JointProblem, error: np.ndarray, weights: np.ndarray, difference: np.ndarray | None = None,
    left: np.ndarray | None = None
) -> HeldOut:  # fmt: skip
    """Held-out errors in blocks three times as long as they remember, weighted by recording."""
    errors, sse, count, squares, spread = [], [], [], 0.0, 0.0
    for k in range(len(problem.sources)):
        part, mask = problem.part(k), problem.held[problem.part(k)]
        if not mask.any():
            continue
        e, a = error[part][mask], problem.angle[part][mask]
        own = e if left is None else left[part][mask]
        share = independent(own, problem.dt, None if difference is None else difference[part][mask])
        memory = 3 * max(1, round(1.0 / share))
        for stretch in np.split(np.arange(len(e)), np.flatnonzero(np.diff(np.flatnonzero(mask)) > 1) + 1):
            for piece in np.array_split(e[stretch], max(1, round(len(stretch) / memory))):
                w = piece * weights[k]
                errors.append(w)
                sse.append(float(w @ w))
                count.append(len(w))
        squares += float(e @ e)
        spread += float(np.sum((a - np.mean(a)) ** 2))
    flat = np.concatenate(errors) if errors else np.zeros(0)
    return HeldOut(
        flat, np.array(sse), np.array(count), math.sqrt(squares / max(len(flat), 1)), math.sqrt(squares / (spread + 1e-300))
    )


def own_numbers(problem: JointProblem) -> tuple[Number, ...]:
    """The file's own numbers that are free: gains, sum of kv and damping, armature, zero, and the dry friction that it has."""
    p = problem.nominal
    prior = (
        (math.log(p[SLOT["armature"]]), INERTIA_PRIOR)
        if p[SLOT["armature"]] > 0
        else (math.log(_links(problem)), 2 * INERTIA_PRIOR)
    )
    inertia = Number("armature", prior=prior)

    def gain(slot: str, value: float, most: float) -> Number:
        known = (math.log(value), GAIN_PRIOR) if value > 0 else None
        return Number(slot, upper=max(most, 2.0 * value), prior=known)

    # of a servo that is faster than the samples the data show no more than that
    inertia_sum, fastest = float(p[SLOT["armature"]]) + _links(problem), 2 * math.pi / problem.dt
    if problem.drive.velocity:
        kv = gain("kv", float(p[SLOT["kv"]]), inertia_sum * fastest)
        numbers = [kv, inertia, *([Number("damping")] if p[SLOT["damping"]] > 0 else [])]
    else:
        damp = gain("damp", float(p[SLOT["kv"]] + p[SLOT["damping"]]), inertia_sum * fastest)
        numbers = [
            gain("kp", float(p[SLOT["kp"]]), inertia_sum * fastest**2),
            damp,
            inertia,
            Number("zero", False, 0.01 * float(np.ptp(problem.angle)) + 1e-12),
        ]
    return (*numbers, *([Number("friction")] if p[SLOT["friction"]] > 0 else []))


def _links(problem: JointProblem) -> float:
    """Mean inertia of the links that the joint carries."""
    return float(np.mean(problem.series[:, 0]))


def _free(numbers: Sequence[Number], laws: Sequence[ServoLaw]) -> tuple[Number, ...]:
    own = {n.slot for law in laws for n in law.numbers}
    return (*(n for n in numbers if n.slot not in own), *dict.fromkeys(n for law in laws for n in law.numbers))


def start_fit(problem: JointProblem, numbers: tuple[Number, ...]) -> Fit:
    """The fit without effects, in the weights of its own errors: the best of starts at the file, at softer gains and at a
    regression."""
    p = problem.nominal
    weights = weights_by_recording(problem, problem.error(p))
    part = problem.windows(THIN)
    starts = [regressed(problem, "friction" in {n.slot for n in numbers})]
    for factor in FAR:
        s = p.copy()
        for name in ("kp", "kv", "damping", "friction"):
            s[SLOT[name]] *= factor if name in ("kp", "friction") else math.sqrt(factor)
        if s[SLOT["armature"]] <= 0:
            s[SLOT["armature"]] = 0.1 * _links(problem)
        if not problem.drive.velocity and s[SLOT["kv"]] + s[SLOT["damping"]] <= 0:
            s[SLOT["kv"]] = 0.02 * s[SLOT["kp"]]
        starts.append(s)
    best = min((fit(problem, numbers, s, weights, QUICK, part) for s in starts if s is not None), key=lambda x: x.sse)
    for _ in range(2):
        best = fit(problem, numbers, best.slots, weights_by_recording(problem, best.error))
    return counted(problem, best, weights_by_recording(problem, best.error))


def regressed(problem: JointProblem, friction: bool) -> np.ndarray | None:
    """Slots (K,) by a regression at the samples in motion, None where it gives no gains.

        target - q = (tau + armature q'' + damp q' + F sign q') / kp + zero

    tau: what the links need. Errors are those of the command and the position at one instant, so that it is a start and no
    answer.
    """
    if problem.drive.velocity:
        return None
    tau, q, v = problem.series[:, 4], problem.series[:, 5], problem.series[:, 6]
    a = np.gradient(v, problem.dt)
    keep = problem.fitted & (np.abs(v) > 0.1 * np.sqrt(np.mean(v**2)))
    columns = [tau, v, a, np.ones_like(v), *([np.sign(v)] if friction else [])]
    C = np.column_stack(columns)[keep]
    size = np.sqrt(np.mean(C**2, axis=0)) + 1e-12
    c = np.linalg.lstsq(C / size, (problem.first - q)[keep], rcond=1e-6)[0] / size
    p = problem.nominal.copy()
    if c[0] <= 0 or c[1] <= 0:
        return None
    kp = 1.0 / c[0]
    damp = kp * c[1]
    p[SLOT["kp"]], p[SLOT["armature"]] = kp, max(kp * c[2], 0.3 * p[SLOT["armature"]], 1e-3 * _links(problem))
    p[SLOT["damping"]] = min(p[SLOT["damping"]], damp)
    p[SLOT["kv"]], p[SLOT["zero"]] = damp - p[SLOT["damping"]], c[3]
    if friction:
        p[SLOT["friction"]] = max(kp * c[4], 1e-3 * kp * float(np.std(problem.first - q)))
    return p


def search_joint(
    problem: JointProblem, options: RobotOptions, joints: int, numbers: tuple[Number, ...], begun: Fit
) -> JointSearch:
    """Search for the effects of one joint; ``begun``: its fit without effects."""
    laws = servo_laws(problem, begun.slots, options.effects)
    start = Structure((), begun)
    s = JointSearch(problem, options, numbers, start, start, laws, joints)
    for _ in range(ROUNDS):
        s.visited.add(s.now.key)
        if not laws or not (
            _enter(s, _is_common)
            or _enter(s, functools.partial(_eligible, s))
            or _enter(s, _any)
            or _exchange(s)
            or _remove(s)
            or _reduce(s)
        ):
            break
        _settle(s)
    _rivals(s)
    return s


def _rivals(s: JointSearch) -> None:
    """For each law that stands: the structure without it, and the laws that could stand in its place as well.

    A rival is one that is physical and within `ALIKE` on fitted and held-out samples together.
    """
    s.visited.clear()
    for law in s.now.laws:
        rest = tuple(x for x in s.now.laws if x is not law)
        s.without[law.key] = without = s.fitted(rest, s.cleared(rest)) if rest else s.refitted
        others = [x for x in s.laws if x.id != law.id and law.id not in x.holds and x.key not in {y.key for y in s.now.laws}]
        found = []
        for other, begun in _finalists(s, without, others):
            if frozenset(x.key for x in begun.laws) == s.now.key or len(begun.laws) != len(s.now.laws):
                continue
            trial = s.fitted(begun.laws, begun.fit.slots)
            if s.sane(trial) and s.step(s.now, trial).total > -ALIKE:
                found.append(other.id)
        s.alike[law.key] = tuple(dict.fromkeys(found))


def _settle(s: JointSearch) -> None:
    """Refit what stands, in the weights of its own errors; the fit without effects is counted in the same weights."""
    p = s.problem
    weights = weights_by_recording(p, s.now.fit.error)
    s.now = Structure(s.now.laws, fit(p, s.now.fit.numbers, s.now.fit.slots, weights))
    s.refitted = Structure((), fit(p, s.numbers, s.refitted.fit.slots, weights, QUICK))


def _with(s: JointSearch, law: ServoLaw, start: dict[str, float], base: np.ndarray) -> np.ndarray:
    """Slots of a start beside what stands; dry friction keeps the size that it has."""
    out, values = base.copy(), dict(start)
    present = float(base[SLOT["friction"]])
    if "friction" in values and present > 0:
        ratio = present / values["friction"]
        values["friction"] = present * (0.8 if "extra" in values else 1.0)
        for name in ("extra", "asymmetry"):
            if name in values:
                values[name] *= ratio
    for name, value in values.items():
        for slot in ("load", "load_back") if name == "load_both" else (name,):
            out[SLOT[slot]] = value
    return out


def _screen(s: JointSearch, now: Structure, laws: Sequence[ServoLaw]) -> list[tuple[float, ServoLaw, np.ndarray]]:
    """(promised gain less the price, law, slots of its best start), most first.

    A run at a start is one direction d of the error; what it explains beside the free numbers is (d'r)^2 / d'd, all projected
    on what their
    derivatives do not span.
    """
    part = s.problem.windows(THIN)
    weights = s.weights[part.which]
    each = np.repeat(weights, np.diff(part.starts))[part.fitted]
    J = jacobian(part, now.fit.numbers, now.fit.x, now.fit.slots, weights)[: int(part.fitted.sum())]
    Q = np.linalg.qr(J + 1e-12)[0]
    r = each * part.error(now.fit.slots)[part.fitted]
    r0 = r - Q @ (Q.T @ r)
    left = float(r0 @ r0)
    n = s.independent_samples
    out = []
    for law in laws:
        best: tuple[float, np.ndarray] | None = None
        for start in law.starts:
            slots = _with(s, law, dict(start), now.fit.slots)
            d = each * part.error(slots)[part.fitted] - r
            d = d - Q @ (Q.T @ d)
            size = float(d @ d)
            explained = float(d @ r0) ** 2 / size if size > 1e-12 * left else 0.0
            if float(d @ r0) > 0 and _one_sided(law):
                explained = 0.0  # the error would grow with it
            if best is None or explained > best[0]:
                best = explained, slots
        assert best is not None
        promised = -n * math.log(max(1.0 - best[0] / left, 1e-9)) - s.price([law])
        out.append((promised, law, best[1]))
    return sorted(out, key=lambda x: -x[0])


def _one_sided(law: ServoLaw) -> bool:
    """Whether all amplitudes of a law are positive."""
    return all(n.log for n in law.numbers)


def _replaced(laws: Sequence[ServoLaw], new: ServoLaw) -> tuple[ServoLaw, ...]:
    """Laws with a new one, in place of those that it contains, or that contain it, or that fill the same slots."""
    kept = [x for x in laws if not (x.id in new.holds or new.id in x.holds or x.id == new.id) and not (_shared(x, new))]
    return (*kept, new)


def _shared(a: ServoLaw, b: ServoLaw) -> bool:
    both = (set(a.slots) & set(b.slots)) - {"friction"}
    return bool(both)


def _cleared(laws: Sequence[ServoLaw], kept: Sequence[ServoLaw], slots: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Slots with those of laws that are gone as in the file."""
    out = slots.copy()
    own = {x for law in kept for x in law.slots}
    for law in laws:
        for name in law.slots:
            if name not in own:
                out[SLOT[name]] = nominal[SLOT[name]] if name != "friction" or nominal[SLOT["friction"]] == 0 else out[SLOT[name]]
    return out


def _trial(s: JointSearch, rest: Sequence[ServoLaw], law: ServoLaw, slots: np.ndarray) -> Structure:
    """A law fitted in place of those that it replaces."""
    laws = _replaced(rest, law)
    return s.fitted(laws, _cleared(s.now.laws, laws, slots, s.problem.nominal))


def _eligible(s: JointSearch, law: ServoLaw) -> bool:
    """Simple laws, and those that refine one that stands or the dry friction that the file has."""
    there = {x.id for x in s.now.laws} | ({"coulomb_friction"} if s.problem.nominal[SLOT["friction"]] > 0 else set())
    return not law.holds or bool(set(law.holds) & there)


def _is_common(law: ServoLaw) -> bool:
    return law.common


def _any(law: ServoLaw) -> bool:
    return True


def _enter(s: JointSearch, allowed: Callable[[ServoLaw], bool]) -> bool:
    """Let the best candidate enter that passes; remember why others do not."""
    there = {x.key for x in s.now.laws} | s.removed
    candidates = [x for x in s.laws if x.key not in there and allowed(x) and not any(x.id in y.holds for y in s.now.laws)]
    best: tuple[float, Structure] | None = None
    for law, begun in _finalists(s, s.now, candidates):
        trial = s.fitted(begun.laws, begun.fit.slots)
        step = s.step(s.now, trial)
        why = s.why_not(step, law) if s.sane(trial) else NOT_PHYSICAL
        if why:
            s.refusals[law.key] = why
        elif best is None or step.total > best[0]:
            best = step.total, trial
    if best is None:
        return False
    s.now = best[1]
    return True


def _finalists(s: JointSearch, base: Structure, candidates: Sequence[ServoLaw]) -> list[tuple[ServoLaw, Structure]]:
    """The laws that promise most beside a structure, fitted to a part of the samples; the best `REFITTED` of them.

    Dry friction is always among them where there is none: it starts from a regression as well.
    """
    part = s.problem.windows(THIN)
    out: list[tuple[float, ServoLaw, Structure]] = []
    for promised, law, slots in _screen(s, base, candidates):
        dry = law.common and base.fit.slots[SLOT["friction"]] == 0.0
        if not dry and (promised < PROMISING * s.entry or len(out) >= FINALISTS):
            if promised < PROMISING * s.entry:
                s.refusals.setdefault(law.key, f"promises {promised:.1f} on the fitted samples, {s.entry:.1f} needed")
            continue
        laws = _replaced(base.laws, law)
        if frozenset(x.key for x in laws) in s.visited:
            continue
        starts = [_cleared(base.laws, laws, slots, s.problem.nominal)]
        again = _regressed_beside(s, base) if dry else None
        starts += [again] if again is not None else []
        trial = min((s.fitted(laws, x, QUICK, part) for x in starts), key=lambda x: x.fit.sse)
        out.append((trial.fit.sse + s.price([law]), law, trial))
    out.sort(key=lambda x: x[0])
    return [(law, trial) for k, (_, law, trial) in enumerate(out) if k < REFITTED or law.common]


def _regressed_beside(s: JointSearch, base: Structure) -> np.ndarray | None:
    """Slots of the regression with dry friction, what other laws fill kept."""
    found = regressed(s.problem, True)
    if found is None:
        return None
    out = base.fit.slots.copy()
    for name in ("kp", "kv", "damping", "armature", "zero", "friction"):
        out[SLOT[name]] = found[SLOT[name]]
    return out


def _exchange(s: JointSearch) -> bool:
    """Put another law in the place of one, where that is clearly better or as good with fewer numbers."""
    for law in s.now.laws:
        rest = tuple(x for x in s.now.laws if x is not law)
        base = s.fitted(rest, _cleared(s.now.laws, rest, s.now.fit.slots, s.problem.nominal), QUICK, s.problem.windows(THIN))
        others = [x for x in s.laws if x.id != law.id and x.key not in {y.key for y in s.now.laws}]
        for other, begun in _finalists(s, base, others):
            trial = s.fitted(begun.laws, begun.fit.slots)
            if not s.sane(trial):
                continue
            step = s.step(s.now, trial)
            more = len(trial.fit.numbers) - len(s.now.fit.numbers)
            wanted = 0.0 if more < 0 else ALIKE
            if step.total > wanted and step.likelihood > 0.0 and (more <= 0 or not s.why_not(step, other)):
                s.now = trial
                return True
    return False


def _remove(s: JointSearch) -> bool:
    """Take off the law that pays least beside the others, if it no longer pays; it does not come back."""
    worst: tuple[float, Structure, ServoLaw, str] | None = None
    for law in s.now.laws:
        rest = tuple(x for x in s.now.laws if x is not law)
        without = s.fitted(rest, _cleared(s.now.laws, rest, s.now.fit.slots, s.problem.nominal))
        step = s.step(without, s.now)
        why = s.why_not(step, law, STAYS)
        if why and (worst is None or step.gain < worst[0]):
            worst = step.gain, without, law, why
    if worst is None:
        return False
    s.now = worst[1]
    s.removed.add(worst[2].key)
    s.refusals[worst[2].key] = f"beside the other findings: {worst[3]}"
    return True


def _reduce(s: JointSearch) -> bool:
    """Put a simpler law in the place of one of which a number is not determined, else take it off."""
    V = covariance(s.problem, s.now.fit)
    places = {n.slot: k for k, n in enumerate(s.now.fit.numbers)}
    for law in s.now.laws:
        if all(_determined(n, float(s.now.fit.x[places[n.slot]]), float(V[places[n.slot], places[n.slot]])) for n in law.numbers):
            continue
        rest = tuple(x for x in s.now.laws if x is not law)
        simpler = [x for x in s.laws if x.id in law.holds and not x.form and x.key not in {y.key for y in rest}]
        trials = [
            _trial(s, rest, x, s.now.fit.slots if x.dry else _with(s, x, dict(x.starts[0]), s.now.fit.slots)) for x in simpler
        ]
        trials = [x for x in trials if s.sane(x)]
        s.now = min(trials, key=lambda x: x.fit.sse) if trials else s.fitted(
            rest, _cleared(s.now.laws, rest, s.now.fit.slots, s.problem.nominal))  # fmt: skip
        s.removed.add(law.key)
        s.refusals[law.key] = "one of its numbers is not determined"
        return True
    return False


def _determined(n: Number, x: float, variance: float) -> bool:
    """A logarithm to a factor of three, at 95 %; a pair of sine and cosine counts as one elsewhere; others: not nought."""
    half = 1.96 * math.sqrt(max(variance, 0.0))
    if n.log:
        return half < math.log(3.0)
    return n.slot.endswith(("_sin", "_cos")) or n.slot.startswith("cable") or n.slot == "spring" or abs(x) > half


def refit_with(s: JointSearch, numbers: tuple[Number, ...]) -> None:
    """Fit what stands, and the joint without effects, with other priors of its own numbers."""
    s.numbers = numbers
    s.now = Structure(s.now.laws, fit(s.problem, _free(numbers, s.now.laws), s.now.fit.slots, s.weights))
    s.refitted = Structure((), fit(s.problem, numbers, s.refitted.fit.slots, s.weights))
    s.without.clear()
