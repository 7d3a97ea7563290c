"""The search with the numerics that fit the recordings: the simulator's or exact ones, soft dry friction or one that holds.

The nominal structure chooses (`diagnose.verdict.reference_stage`). Physics that it lacks leaves the choice open: then the nominal
structure with the effect of the largest score test chooses first, by a factor of two. Where the first choice leaves more than
noise, or finds several effects, of which one may compensate for the numerics, the search is repeated with the other choice, and
the diagnosis of the higher penalised likelihood counts. Where the nominal structure shows the simulator's numerics by a factor of
two, the first choice counts unless it leaves an error of twice the noise variance.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from diagnose.evidence.rivals.quantisation import within_the_step
from diagnose.fit.ledger import Ledger
from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.problem.noise_model import KnownNoise
from diagnose.progress import Step
from diagnose.result import Diagnosis, Verdict
from diagnose.structure.first_effect import least_by_one
from diagnose.thresholds import FAR, TWICE, UNEXPLAINED
from diagnose.verdict.reference_stage import Nominal, by_other_friction, by_other_numerics, without_difference
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.recording import Recording

__all__ = ["by_either_numerics", "by_first_effect", "open_beyond"]


def by_either_numerics(
    given: Nominal, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options,
    say: Callable[[Step], None], ledger: Ledger | None, stale: Callable[[Diagnosis], bool] = lambda _: False,
) -> tuple[Axis, Nominal, Diagnosis]:  # fmt: skip
    """The nominal axis with the friction that fits the recordings, its runs, and the diagnosis beside it.

    ``stale``: asked of an answer that leaves other numerics open; where it holds these are not searched, since the recordings are
    taken otherwise and searched again.
    """
    began, n = time.monotonic(), sum(int(c.estimation.sum()) for c in given.cases)
    given = by_first_effect(given, recordings, held_out, options)
    better: list[tuple[Nominal, Diagnosis]] = []
    asked: list[Diagnosis] = []

    def surpassed(first: Diagnosis) -> bool:
        """Search with the other numerics that ``first`` leaves open; whether one of these answers is better."""
        asked.append(first)
        others = list(_others(given, first))
        if others and stale(first):
            return True
        for why, other in others:
            within = options.since(began)
            if not within.seconds:
                break
            say(Step("search", f"again with {why}"))
            so_far = better[-1][1] if better else first
            behind = partial(_behind, so_far, n)
            second = diagnose(other.axis, recordings, held_out, within, say, None, other.corrections(), behind)
            if not behind(second):
                better.append((other, second))
                if next(_others(other, second), None) is None:
                    break
        return bool(better)

    first = diagnose(given.axis, recordings, held_out, options.since(began), say, ledger, given.corrections(), surpassed)
    if not asked:
        surpassed(first)
    nominal, result = better[-1] if better else (given, first)
    return nominal.axis, nominal, without_difference(result, nominal)


def open_beyond(given: Nominal | None) -> float:
    """Times the noise variance beyond which a diagnosis leaves open what the recordings were compared with.

    The noise where neither numerics show; twice that of an error where the simulator's show by a factor of two.
    """
    return FAR if given is not None and given.simulator and given.shows_simulator else UNEXPLAINED


def by_first_effect(given: Nominal, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options) -> Nominal:
    """The nominal file with the simulator's numerics where one effect beside it then promises to leave half as much."""
    if not given.shifts or given.simulator:
        return given
    other = dataclasses.replace(by_other_numerics(given), beside=True)
    exact, by_simulator = (least_by_one(g.axis, recordings, held_out, options, g.corrections()) for g in (given, other))
    return other if TWICE * by_simulator <= exact else given


def _others(given: Nominal, first: Diagnosis) -> Iterator[tuple[str, Nominal]]:
    """Other numerics that the answer leaves open, and in words what they are, the likelier first."""
    if given.simulator and given.shows_simulator and not _far(first, FAR):
        return
    steps = given.shifts and (_far(first) or sum(f.kind == "physics" for f in first.findings) > 1)
    friction = given.other is not None and _open(first, given.axis)
    first_friction = friction and "friction" in _families(first)  # a law of it may stand for its creep
    for kind in ("friction", "steps") if first_friction else ("steps", "friction"):
        if kind == "friction" and friction:
            yield (
                f"dry friction that {'holds at rest' if _soft(given.axis) else 'is soft, as in MuJoCo'}",
                by_other_friction(given),
            )
        if kind == "steps" and steps:
            why = "exact numerics" if given.simulator else "the numerics of the simulator"
            yield why, by_other_numerics(given)


def _soft(axis: Axis) -> bool:
    return any(b.softness for b in axis.chain.bodies)


def _open(result: Diagnosis, axis: Axis) -> bool:
    """Whether the numerics of dry friction may be what the answer lacks, or what it names.

    It leaves more than noise or does not explain it, and has a law of friction or of the speed, or the model has one: friction
    that creeps is taken for one that grows with the speed. Or a law of friction takes the place of the model's own.
    """
    families = _families(result) | {e.family for e in axis.effects}
    return (bool(families & {"friction", "speed"}) and _far(result)) or _replaces_friction(result, axis)


def _replaces_friction(result: Diagnosis, axis: Axis) -> bool:
    """Whether a law of friction takes the place of the model's own."""
    return "friction" in _families(result) & {e.family for e in axis.effects}


def _families(result: Diagnosis) -> set[str]:
    return {effect_class(f.law).family for f in result.findings if f.kind == "physics"}


def _far(result: Diagnosis, level: float = UNEXPLAINED) -> bool:
    """Whether more than ``level`` times the noise variance is left, beyond the step of an encoder, or it is not explained."""
    far = result.fit["corrected"].rms ** 2 > level * result.noise_floor**2 and not within_the_step(result)
    return far or result.verdict is Verdict.UNEXPLAINED


def _behind(first: Diagnosis, n: int, second: Diagnosis) -> bool:
    return not _better(second, first, n)


def _better(second: Diagnosis, first: Diagnosis, n: int) -> bool:
    """Whether the second has the higher penalised likelihood of n estimation samples and the smaller held-out error."""

    def cost(d: Diagnosis) -> float:
        numbers = len(d.linear_parameters) + sum(len(f.parameters) for f in d.findings)
        return n * 2.0 * math.log(max(d.fit["corrected"].rms, 1e-300)) + KnownNoise.prices.price * numbers

    held = [d.fit["corrected"].held_out_rms for d in (second, first)]
    return cost(second) < cost(first) and not held[0] > held[1]
