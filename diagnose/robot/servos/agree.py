"""Which masses of a servo robot differ from the file's: of links, their first moments, a payload; ranked against each other.

A wrong mass acts at every joint before it, in proportions that follow from the motion. A number of one joint alone (gain,
weight) takes its place there, and no law does at all joints. The masses are selected forward by the evidence of all joints
together, as effects are at one joint: extended BIC over the candidates, `RobotOptions.material` of the pooled held-out squared
error, and paired held-out blocks. They are selected twice: beside the joints without any effect, and beside the effects that were
found without them. The joints are searched again under each selection, and the better answer for the whole robot stands.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.result import Estimate
from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.bodies import GRAVITY, MASS, MOMENTS, PAYLOAD, BodyNumber, is_physical
from diagnose.robot.servos.fit import covariance, fit
from diagnose.robot.servos.library import WEIGHT
from diagnose.robot.servos.masses import UNSEEN, Loaded, fit_masses, gain_of, information
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.state import JointSearch, Structure, cleared, free_numbers
from diagnose.thresholds import EQUIVALENT
from mjsim.robot.model import Robot

__all__ = ["Masses", "agree", "pooled_payload"]

FINALISTS = 3  # masses that are fitted: those with the largest gain to first order
COMMON = " (by the other masses of the file: a factor common to masses and gains is not told by command and position)"
STAYS = 5.0  # times the level to enter, at which a mass stays, as for effects

Search = Callable[[Sequence[JointProblem], Sequence[JointSearch]], tuple[JointSearch, ...]]


@dataclass(frozen=True, eq=False)
class Masses:
    """Masses that differ from the file's: indices among ``numbers``, x (C,) more, covariance (C, C), and of each selected
    one the candidates that could stand in its place as well."""

    numbers: tuple[BodyNumber, ...]
    selected: tuple[int, ...]
    x: np.ndarray
    variance: np.ndarray
    alike: Mapping[int, tuple[int, ...]]

    @property
    def told(self) -> tuple[tuple[str, str, float, Estimate], ...]:
        """(key, words, value of the file, estimate) of each selected number.

        Where the first moment of a link differs as well, its mass is not told by the motion: mass and inertia change in one
        proportion, of which only the inertia is felt beside the first moment. That proportion and the first moment are given.
        """
        out = []
        for k in self.selected:
            one = self.numbers[k]
            weights, nominal, unit = np.zeros(len(self.x)), one.nominal, one.unit
            weights[k] = 1.0
            key, words = one.key, one.words
            moments = [self.numbers[o] for o in self.selected if self.numbers[o].kind in MOMENTS]
            mass = [o for o in self.selected if self.numbers[o].kind == MASS and self.numbers[o].link == one.link]
            if one.kind == MASS and any(n.link == one.link for n in moments):
                weights, nominal, unit = weights / one.nominal, 1.0, "1"
                key, words = f"{one.body}.inertia / that of the file", f"inertia of {one.body} / that of the file"
            elif one.kind in MOMENTS and mass:
                weights[mass[0]] = one.nominal / self.numbers[mass[0]].nominal
            value = nominal + float(weights @ self.x)
            half = 1.96 * math.sqrt(max(float(weights @ self.variance @ weights), 0.0))
            out.append((key, words, nominal, Estimate(value, (value - half, value + half), unit)))
        return tuple(out)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Value and interval by key, as told."""
        return {key: e for key, _, _, e in self.told}

    @property
    def nominal(self) -> dict[str, float]:
        """Values of the file by key, as told."""
        return {key: given for key, _, given, _ in self.told}

    @property
    def lines(self) -> tuple[str, ...]:
        """In words, what each selected number is, and what cannot be told from it."""
        out = []
        for k, (_, words, given, e) in zip(self.selected, self.told, strict=True):
            one, others = self.numbers[k], [self.numbers[o] for o in self.alike.get(k, ())]
            point = {one.kind} | {n.kind for n in others if n.link == one.link}
            name = f"payload or mass of {one.body}" if {MASS, PAYLOAD} <= point else words
            rest = [n.words for n in others if name == words or n.link != one.link]
            also = f"; {' or '.join(rest)} cannot be told from it" if rest else ""
            if one.kind == PAYLOAD or name != words:
                value, low, high = (f"{v - given:+.4g}" for v in (e.value, *e.ci95))
            else:
                value, low, high = f"{given:.4g} -> {e.value:.4g}", f"{e.ci95[0]:.4g}", f"{e.ci95[1]:.4g}"
            unit = "" if e.unit == "1" else f" {e.unit}"
            out.append(f"{name}: {value}{unit} [{low}, {high}]{also}{'' if one.kind == GRAVITY else COMMON}")
        return tuple(out)


@dataclass(frozen=True, eq=False)
class _Robot:
    """What a selection of masses works on."""

    robot: Robot
    numbers: tuple[BodyNumber, ...]
    searches: tuple[JointSearch, ...]
    options: RobotOptions

    @property
    def scales(self) -> np.ndarray:
        """Scale (C,) of each number."""
        return np.array([n.scale for n in self.numbers])

    @property
    def moves(self) -> int:
        """Number of candidates: the mass of each link, alone and with its first moment, gravity compensation and the payload."""
        return 2 * sum(n.kind == MASS for n in self.numbers) + 2

    @property
    def entry(self) -> float:
        """Extended BIC: 2 log of the number of candidates."""
        return 2.0 * math.log(self.moves)

    @property
    def price(self) -> float:
        """Of one mass: log of the independent samples of all joints."""
        return math.log(sum(s.independent_samples for s in self.searches))

    def fitted(self, structures: Sequence[Structure], selected: Sequence[int], start: np.ndarray) -> Loaded:
        """Structures under the selected masses, all numbers free."""
        begun = np.where(np.isin(np.arange(len(start)), selected), start, 0.0)
        return fit_masses(self.searches, structures, begun, selected, self.scales)

    def total(self, poorer: Loaded, richer: Loaded, more: int) -> float:
        """Gain on fitted and held-out samples less the price of all numbers; more: masses that the richer has more."""
        fitted, held, _ = gain_of(self.searches, poorer.structures, richer.structures)
        return fitted + held - more * self.price

    def refuses(self, poorer: Loaded, richer: Loaded, more: int, ease: float = 1.0) -> bool:
        """Whether a test refuses so many masses more."""
        gain, _, held = gain_of(self.searches, poorer.structures, richer.structures)
        return (
            gain - more * self.price < self.entry / ease
            or held.relative_gain < self.options.material / ease
            or min(1.0, held.p_value * self.moves) > self.options.p_enter * ease
            or not is_physical(self.robot, self.numbers, richer.x)
        )

    def selection(
        self, structures: Sequence[Structure], begun: Sequence[int] = (), start: np.ndarray | None = None
    ) -> tuple[tuple[int, ...], Loaded]:
        """Masses that enter one by one, and leave where they do not stay."""
        selected = tuple(begun)
        now = self.fitted(structures, selected, np.zeros(len(self.numbers)) if start is None else start)
        while len(selected) < len(self.numbers):
            found = self._enter(selected, now)
            if found is None:
                break
            selected, now = found
        return self._left(selected, now)

    def _enter(self, selected: tuple[int, ...], now: Loaded) -> tuple[tuple[int, ...], Loaded] | None:
        best: tuple[float, tuple[int, ...], Loaded] | None = None
        for move in self._moves(now, selected):
            more = (*selected, *move)
            trial = self.fitted(now.structures, more, now.x)
            if not self.refuses(now, trial, len(move)):
                total = self.total(now, trial, len(move))
                if best is None or total > best[0]:
                    best = total, more, trial
        return None if best is None else best[1:]

    def _moves(self, now: Loaded, selected: Sequence[int]) -> list[tuple[int, ...]]:
        """The masses that gain most to first order, each alone and with the components of its first moment that are seen.

        A first moment alone may leave no physical body.
        """
        gain, share = information(self.searches, now, self.scales, selected)
        masses = self._finalists(gain, selected)
        links = dict.fromkeys(self.numbers[k].link for k in (*masses, *selected))
        groups = [
            tuple(
                k for k, n in enumerate(self.numbers)
                if n.link == link and n.kind != PAYLOAD and k not in selected and share[k] > UNSEEN
            ) for link in links
        ]  # fmt: skip
        return list(dict.fromkeys([*((k,) for k in masses), *(g for g in groups if g)]))

    def _finalists(self, gain: np.ndarray, but: Sequence[int]) -> list[int]:
        """Masses with the largest gains (C,), but for some."""
        return [
            int(k) for k in np.argsort(-gain)
            if gain[k] >= self.entry and int(k) not in but and self.numbers[k].kind not in MOMENTS
        ][:FINALISTS]  # fmt: skip

    def _left(self, selected: tuple[int, ...], now: Loaded) -> tuple[tuple[int, ...], Loaded]:
        """Without the masses that no longer pay beside the others."""
        for c in selected if len(selected) > 1 else ():
            rest = tuple(k for k in selected if k != c)
            without = self.fitted(now.structures, rest, now.x)
            if is_physical(self.robot, self.numbers, without.x) and self.refuses(without, now, 1, STAYS):
                return self._left(rest, without)
        return selected, now

    def ranked(self, selected: tuple[int, ...], now: Loaded) -> tuple[tuple[int, ...], Loaded, dict[int, tuple[int, ...]]]:
        """The selection with each mass exchanged for the one that does as well and leaves the joints' numbers nearest to those of
        the file; and of each selected mass the others that do as well.

        One heavier link and the others lighter under softer servos are the same motion.
        """
        chosen, best, alike = list(selected), now, {}
        for i, c in enumerate(selected):
            rest = tuple(k for k in chosen if k != c)
            without = self.fitted(best.structures, rest, best.x)
            gain, _ = information(self.searches, without, self.scales, rest)
            others = [] if self.numbers[c].kind in MOMENTS else self._finalists(gain, chosen)
            trials = {k: self.fitted(without.structures, (*rest, k), without.x) for k in others}
            same = {
                k: x for k, x in trials.items()
                if self.total(now, x, 0) > -EQUIVALENT and is_physical(self.robot, self.numbers, x.x)
            } | {c: best}  # fmt: skip
            chosen[i], best = min(same.items(), key=lambda x: self._off(x[1]))
            alike[chosen[i]] = tuple(k for k in same if k != chosen[i])
        return tuple(chosen), best, alike

    def _off(self, x: Loaded) -> float:
        """Sum of the squared logarithms of the joints' numbers over those of the file."""
        return sum(
            float(v - n.prior[0]) ** 2
            for t in x.structures
            for n, v in zip(t.fit.numbers, t.fit.x, strict=True)
            if n.log and n.prior is not None
        )


def agree(
    robot: Robot, numbers: tuple[BodyNumber, ...], searches: tuple[JointSearch, ...], options: RobotOptions, again: Search,
    say: Callable[[str], None],
) -> tuple[tuple[JointSearch, ...], Masses]:  # fmt: skip
    """The searches under the masses that all joints agree on, and these.

    again: searches the joints of problems anew, with what was found of delays in the searches before.
    """
    r = _Robot(robot, numbers, searches, options)
    none = Loaded(np.zeros(len(numbers)), np.zeros((len(numbers),) * 2), tuple(s.now for s in searches))
    tried: dict[tuple[int, ...], Loaded] = {}
    for structures in () if options.late else ([s.refitted for s in searches], [_without_numbers(s) for s in searches]):
        selected, found = r.selection(structures)
        if selected and tuple(sorted(selected)) not in tried:
            tried[tuple(sorted(selected))] = found
    best: tuple[float, tuple[JointSearch, ...], tuple[int, ...], Loaded] = (0.0, searches, (), none)
    for selected, found in tried.items():
        say(f"all joints: {', '.join(numbers[k].key for k in selected)}")
        under = again([s.problem.with_masses(found.x, found.variance) for s in searches], searches)
        if options.late:  # this search may have ended early, without effects that the one before found
            break
        own = dataclasses.replace(r, searches=under)
        chosen, last = own.selection([_without_numbers(s, PAYLOAD) for s in under], selected, found.x)
        total = r.total(none, last, len(chosen))
        if chosen and total > best[0]:
            best = total, under, chosen, last
    _, searches, selected, last = best
    if not selected:
        return searches, pooled_payload(numbers, searches)
    selected, last, alike = dataclasses.replace(r, searches=searches).ranked(selected, last)
    for s, structure in zip(searches, last.structures, strict=True):
        carry(s, last.x, last.variance, structure)
    return searches, Masses(numbers, selected, last.x, last.variance, alike)


def _without_numbers(s: JointSearch, *ids: str) -> Structure:
    """What stands at a joint without payload and weight, where these are numbers of the robot; or without the laws named."""
    rest = tuple(x for x in s.now.laws if not (x.number and x.id in (ids or (PAYLOAD, WEIGHT))))
    if len(rest) == len(s.now.laws):
        return s.now
    if not rest:
        return s.refitted
    base = cleared(s.now.laws, rest, s.now.fit.slots, s.problem.nominal)
    return Structure(rest, fit(s.problem, free_numbers(s.numbers, rest), base, s.weights))


def carry(s: JointSearch, x: np.ndarray, variance: np.ndarray, now: Structure) -> None:
    """Put a joint under masses (C,) that the robot carries, with a structure that was fitted to them."""
    s.problem = s.problem.with_masses(x, variance)
    s.now = Structure(now.laws, fit(s.problem, now.fit.numbers, now.fit.slots, now.fit.weights))
    s.refitted = Structure((), fit(s.problem, s.numbers, s.refitted.fit.slots, now.fit.weights))
    s.without.clear()


def pooled_payload(numbers: tuple[BodyNumber, ...], searches: tuple[JointSearch, ...]) -> Masses:
    """The payload on the last link [kg] that the joints whose search took one agree on, by their variances; none where none did.

    All joints are then fitted with it, and it is no law of any of them.
    """
    x, variance = np.zeros(len(numbers)), np.zeros((len(numbers),) * 2)
    values, variances = [], []
    for s in searches:
        at = [i for i, n in enumerate(s.now.fit.numbers) if n.slot == PAYLOAD]
        if at:
            n, coded, V = s.now.fit.numbers[at[0]], s.now.fit.x[at[0]], covariance(s.problem, s.now.fit)
            values.append(n.value(float(coded)))
            variances.append(float(V[at[0], at[0]]) * n.scale**2)
    if not values:
        return Masses(numbers, (), x, variance, {})
    weights = 1.0 / np.array(variances)
    mean = float(np.average(values, weights=weights))
    spread = float(np.average((np.array(values) - mean) ** 2, weights=weights)) / max(len(values) - 1, 1)
    x[-1], variance[-1, -1] = mean, 1.0 / float(np.sum(weights)) + spread
    for s in searches:
        carry(s, x, variance, _without_numbers(s, PAYLOAD))
    same = tuple(k for k, n in enumerate(numbers) if n.link == numbers[-1].link and n.kind == MASS)
    return Masses(numbers, (len(numbers) - 1,), x, variance, {len(numbers) - 1: same})
