"""The search with the kind of dry friction that fits the recordings: one that holds at rest, or MuJoCo's, which is soft.

The nominal structure chooses between the two where the file has friction (`diagnose.verdict.reference_stage`). Friction that the
file lacks, or physics that hides the difference, leaves the choice open: where the first kind does not lead to the noise, the
other is searched too, and the diagnosis of the higher penalised likelihood counts.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence

from diagnose.fit.ledger import Ledger
from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.problem.noise_model import KnownNoise
from diagnose.progress import Step
from diagnose.result import Diagnosis, Verdict
from diagnose.thresholds import UNEXPLAINED
from diagnose.verdict.reference_stage import Nominal, by_other_friction, without_difference
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.recording import Recording

__all__ = ["by_either_friction"]


def by_either_friction(
    given: Nominal, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options,
    say: Callable[[Step], None], ledger: Ledger,
) -> tuple[Axis, Nominal, Diagnosis]:  # fmt: skip
    """The nominal axis with the friction that fits the recordings, its runs, and the diagnosis beside it."""
    began = time.monotonic()
    first = diagnose(given.axis, recordings, held_out, options, say, ledger, given.corrections())
    left = options.seconds - (time.monotonic() - began)
    if given.other is None or left <= 0 or not _open(first, given.axis):
        return given.axis, given, without_difference(first, given)
    say(Step("search", "again with dry friction that " + ("holds at rest" if _soft(given.axis) else "is soft, as in MuJoCo")))
    other = by_other_friction(given)
    second = diagnose(other.axis, recordings, held_out, dataclasses.replace(options, seconds=left), say, None, None)
    if not _better(second, first, sum(int(c.estimation.sum()) for c in given.cases)):
        return given.axis, given, without_difference(first, given)
    return other.axis, other, second


def _soft(axis: Axis) -> bool:
    return any(b.softness for b in axis.chain.bodies)


def _open(result: Diagnosis, axis: Axis) -> bool:
    """Whether friction is in the model or the answer, and the answer leaves more than noise or does not explain it."""
    physics = [effect_class(f.law) for f in result.findings if f.kind == "physics"]
    friction = any(family == "friction" for family in (*(c.family for c in physics), *(e.family for e in axis.effects)))
    far = result.fit["corrected"].rms ** 2 > UNEXPLAINED * result.noise_floor**2
    return friction and (far or result.verdict is Verdict.UNEXPLAINED)


def _better(second: Diagnosis, first: Diagnosis, n: int) -> bool:
    """Whether the second has the higher penalised likelihood of n estimation samples and the smaller held-out error."""

    def cost(d: Diagnosis) -> float:
        numbers = len(d.linear_parameters) + sum(len(f.parameters) for f in d.findings)
        return n * 2.0 * math.log(max(d.fit["corrected"].rms, 1e-300)) + KnownNoise.prices.price * numbers

    held = [d.fit["corrected"].held_out_rms for d in (second, first)]
    return cost(second) < cost(first) and not held[0] > held[1]
