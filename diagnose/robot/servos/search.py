"""Which effects one servo joint has: forward selection, refinement, exchange and removal, each step held to unseen samples.

A law is screened by the share of the error that a run at one of its starts explains beside the free parameters; the few best are
fitted with all numbers free. One enters when it gains on all samples (extended BIC) and on the fitted ones, is physical, takes
enough off the held-out squared error and passes the paired block tests at a level that counts all laws of all joints.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.fit import Fit, Number, block_weights, covariance, fit
from diagnose.robot.servos.library import PLAIN, ServoLaw, servo_laws
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.screening import own_as_in_file, screen, with_start
from diagnose.robot.servos.starts import THIN, regressed
from diagnose.robot.servos.state import QUICK, JointSearch, Structure, cleared, free_numbers, replaced
from diagnose.thresholds import EQUIVALENT
from mjsim.robot.joint_kernel import SLOT

__all__ = ["refit_with", "search_joint"]

MERGING = 25  # iterations of a law that takes the place of several, which starts far from its optimum
FINALISTS = 5  # laws that are fitted: those with the largest gain in the screening
PROMISING = 0.25  # of what is needed to enter: a promise is that of one start alone
ROUNDS = 12  # moves at most
STAYS = 5.0  # times the level to enter, at which a law stays: what enters at 1 % may stay at 5 %
REFITTED = 2  # finalists that are fitted to all samples
NOT_PHYSICAL = "its numbers are not physical"


def search_joint(
    problem: JointProblem, options: RobotOptions, joints: int, numbers: tuple[Number, ...], begun: Fit, without: str = ""
) -> JointSearch:
    """Search for the effects of one joint.

    begun: its fit without effects; without: the key of a law that is not tried.
    """
    laws = tuple(x for x in servo_laws(problem, begun.slots, options.effects) if x.key != without)
    start = Structure((), begun)
    s = JointSearch(problem, options, numbers, start, start, laws, joints)
    for _ in range(ROUNDS):
        s.visited.add(s.now.key)
        if (
            options.late
            or not laws
            or not (
                _enter(s, _is_common)
                or _enter(s, functools.partial(_eligible, s))
                or _enter(s, _any)
                or _exchange(s)
                or _merge(s)
                or _remove(s)
                or _reduce(s)
            )
        ):
            break
        _settle(s)
    _rivals(s)
    return s


def _rivals(s: JointSearch) -> None:
    """For each law that stands: the structure without it, and the laws that could stand in its place as well.

    A rival is one that is physical and within `EQUIVALENT` on fitted and held-out samples together. One that takes the place of
    several laws is a rival of each of them.
    """
    s.visited.clear()
    found: dict[str, list[str]] = {law.key: [] for law in s.now.laws}
    there = {law.key for law in s.now.laws}
    for law in s.now.laws:
        rest = tuple(x for x in s.now.laws if x is not law)
        s.without[law.key] = without = s.fitted(rest, s.cleared(rest)) if rest else s.refitted
        others = [x for x in s.laws if not _same(x, law) and law.id not in x.holds and x.key not in there]
        for other, begun in _finalists(s, without, others, FINALISTS):
            if frozenset(x.key for x in begun.laws) == s.now.key or len(begun.laws) != len(s.now.laws):
                continue
            trial = s.fitted(begun.laws, begun.fit.slots)
            if s.sane(trial) and s.step(s.now, trial).total > -EQUIVALENT:
                found[law.key].append(other.id)
    for other, taken, trial in _merged(s):
        if s.step(s.now, trial).total > -EQUIVALENT:
            for law in taken:
                found[law.key].append(other.id)
    for law, parts, trial in _split(s):
        if s.step(s.now, trial).total > -EQUIVALENT:
            found[law.key] += [x.id for x in parts]
    s.alike |= {key: tuple(dict.fromkeys(names)) for key, names in found.items()}


def _same(a: ServoLaw, b: ServoLaw) -> bool:
    """Whether two laws are forms of one effect at one place."""
    return a.id == b.id and a.place == b.place


def _merged(s: JointSearch) -> Iterator[tuple[ServoLaw, tuple[ServoLaw, ...], Structure]]:
    """Laws that take the place of several that stand: (law, those that it replaces, fitted structure)."""
    for law in s.laws:
        laws = replaced(s.now.laws, law)
        taken = tuple(x for x in s.now.laws if x not in laws)
        if law.id in {x.id for x in s.now.laws} or len(taken) < 2:
            continue
        slots = cleared(s.now.laws, laws, with_start(s, law, dict(law.starts[0]), s.now.fit.slots), s.problem.nominal)
        trial = s.fitted(laws, slots, MERGING)
        if s.sane(trial):
            yield law, taken, trial


def _split(s: JointSearch) -> Iterator[tuple[ServoLaw, tuple[ServoLaw, ...], Structure]]:
    """Laws that stand and contain several others: (law, those together in its place, fitted structure)."""
    for law in s.now.laws:
        parts = tuple(x for x in s.laws if x.id in law.holds and not x.form)
        if len(parts) < 2 or any(x.dry for x in parts):
            continue
        laws = (*(x for x in s.now.laws if x is not law), *parts)
        slots = cleared(s.now.laws, laws, s.now.fit.slots, s.problem.nominal)
        for part in parts:
            slots = with_start(s, part, dict(part.starts[0]), slots)
        trial = s.fitted(laws, slots, MERGING)
        if s.sane(trial):
            yield law, parts, trial


def _merge(s: JointSearch) -> bool:
    """Put one law in the place of several where it does as well: each law costs its entry (extended BIC)."""
    for _, taken, trial in _merged(s):
        if trial.key not in s.visited and s.step(s.now, trial).total + s.entry * (len(taken) - 1) > 0.0:
            s.now = trial
            return True
    return False


def _settle(s: JointSearch) -> None:
    """Refit what stands, in the weights of its own errors; the fit without effects is counted in the same weights."""
    p = s.problem
    weights = block_weights(p, s.now.fit.error)
    s.now = Structure(s.now.laws, fit(p, s.now.fit.numbers, s.now.fit.slots, weights))
    s.refitted = Structure((), fit(p, s.numbers, s.refitted.fit.slots, weights, QUICK))


def _trial(s: JointSearch, rest: Sequence[ServoLaw], law: ServoLaw, slots: np.ndarray) -> Structure:
    """A law fitted in place of those that it replaces."""
    laws = replaced(rest, law)
    return s.fitted(laws, cleared(s.now.laws, laws, slots, s.problem.nominal))


def _eligible(s: JointSearch, law: ServoLaw) -> bool:
    """Simple laws, and those that refine one that stands or the dry friction that the file has."""
    there = {x.id for x in s.now.laws} | ({PLAIN} if s.problem.nominal[SLOT["friction"]] > 0 else set())
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


def _finalists(
    s: JointSearch, base: Structure, candidates: Sequence[ServoLaw], most: int = REFITTED
) -> list[tuple[ServoLaw, Structure]]:
    """The laws that promise most beside a structure, fitted to a part of the samples; the best ``most`` of them.

    They are compared by their likelihood with the size of the errors free, n log(sum of squares), and the price of their numbers.
    Dry friction is always among them where there is none: it starts from a regression as well.
    """
    part = s.problem.windows(THIN)
    least = s.problem.noise**2 * float(np.sum(s.weights[part.rows][part.fitted] ** 2))
    out: list[tuple[float, ServoLaw, Structure]] = []
    for promised, law, slots in screen(s, base, [x for x in candidates if not x.limit_of]):
        dry = law.common and base.fit.slots[SLOT["friction"]] == 0.0
        if not dry and (promised < PROMISING * s.entry or len(out) >= FINALISTS):
            if promised < PROMISING * s.entry:
                s.refusals.setdefault(law.key, f"promises {promised:.1f} on the fitted samples, {s.entry:.1f} needed")
            continue
        laws = replaced(base.laws, law)
        if frozenset(x.key for x in laws) in s.visited:
            continue
        starts = [cleared(base.laws, laws, x, s.problem.nominal) for x in (slots, own_as_in_file(s, slots))]
        again = _regressed_beside(s, base) if dry else None
        starts += [again] if again is not None else []
        trial = min((s.fitted(laws, x, QUICK, part) for x in starts), key=lambda x: x.fit.sse)
        out.append((s.independent_samples * math.log(max(trial.fit.sse, least)) + s.price(laws), law, trial))
    out.sort(key=lambda x: x[0])
    return [(law, trial) for k, (_, law, trial) in enumerate(out) if k < most or law.common]


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
    """Put another law in the place of one, where that is clearly better or as good with fewer numbers.

    One with more numbers has to show it on held-out samples; their price is in the total.
    """
    for law in s.now.laws:
        rest = tuple(x for x in s.now.laws if x is not law)
        base = s.fitted(rest, cleared(s.now.laws, rest, s.now.fit.slots, s.problem.nominal), QUICK, s.problem.windows(THIN))
        others = [x for x in s.laws if not _same(x, law) and x.key not in {y.key for y in s.now.laws}]
        for _, begun in _finalists(s, base, others):
            trial = s.fitted(begun.laws, begun.fit.slots)
            if not s.sane(trial):
                continue
            step = s.step(s.now, trial)
            more = len(trial.fit.numbers) - len(s.now.fit.numbers)
            wanted = 0.0 if more < 0 else EQUIVALENT
            shown = step.held.relative_gain > s.options.material and step.held.p_value < s.options.p_enter
            if step.total > wanted and step.likelihood > 0.0 and (more <= 0 or shown):
                s.now = trial
                return True
    return False


def _remove(s: JointSearch) -> bool:
    """Take off the law that pays least beside the others, if it no longer pays; it does not come back."""
    worst: tuple[float, Structure, ServoLaw, str] | None = None
    for law in s.now.laws:
        rest = tuple(x for x in s.now.laws if x is not law)
        without = s.fitted(rest, cleared(s.now.laws, rest, s.now.fit.slots, s.problem.nominal))
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
        there = {y.key for y in rest}
        simpler = [x for x in s.laws if (x.limit_of == law.key or (x.id in law.holds and not x.form)) and x.key not in there]
        trials = [
            _trial(s, rest, x, s.now.fit.slots if x.dry else with_start(s, x, dict(x.starts[0]), s.now.fit.slots))
            for x in simpler
        ]
        trials = [x for x in trials if s.sane(x)]
        s.now = min(trials, key=lambda x: x.fit.sse) if trials else s.fitted(
            rest, cleared(s.now.laws, rest, s.now.fit.slots, s.problem.nominal))  # fmt: skip
        s.removed.add(law.key)
        s.refusals[law.key] = "one of its numbers is not determined"
        return True
    return False


def _determined(n: Number, x: float, variance: float) -> bool:
    """A logarithm to a factor of three, at 95 %; a pair of sine and cosine counts as one elsewhere; others: not zero."""
    half = 1.96 * math.sqrt(max(variance, 0.0))
    if n.log:
        return half < math.log(3.0)
    return n.slot.endswith(("_sin", "_cos")) or n.slot.startswith("cable") or n.slot == "spring" or abs(x) > half


def refit_with(s: JointSearch, numbers: tuple[Number, ...]) -> None:
    """Fit what stands, and the joint without effects, with other priors of its own numbers."""
    s.numbers = numbers
    s.now = Structure(s.now.laws, fit(s.problem, free_numbers(numbers, s.now.laws), s.now.fit.slots, s.weights))
    s.refitted = Structure((), fit(s.problem, numbers, s.refitted.fit.slots, s.weights))
    s.without.clear()
