"""How a command or a torque goes between samples, where nobody stated it and the recordings show it.

A controller that interpolates its setpoints acts half a sample earlier than one that holds them; where a row is the mean over
the interval before it, a whole sample earlier. No drive is early, so that an error which falls where the command acts earlier is
the hold's, as long as it grows again for what is earlier still: a lead without end is a law's, such as a velocity feedforward.
The numbers of the model are refitted under each hold, and once more beside dry friction, which most joints have.

An effect that was found under the assumed hold is compared with the other holds as well: what acts half a sample early is also a
small velocity feedforward.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from diagnose.check.types import Problem, Severity
from diagnose.data.split import split
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import orthonormal
from diagnose.fit.usable import Usable
from diagnose.fit.whiten import effective_share
from diagnose.options import Options
from diagnose.problem.noise_model import ModelError
from diagnose.thresholds import EQUIVALENT, FAIR, TWICE, UNEXPLAINED
from mjsim.axis import Axis
from mjsim.effects import Effect, registered
from mjsim.effects.native import DryFriction
from mjsim.hold import HOLDS
from mjsim.recording import Recording
from mjsim.robot.recording import RobotRecording

__all__ = ["earlier", "hold_instead", "hold_shows", "input_channel", "is_assumed", "shown_hold", "taken_hold", "with_hold"]

R = TypeVar("R", Recording, RobotRecording)
WORDS = {
    "held": "is held between samples",
    "linear": "goes in straight lines between samples",
    "mean": "is logged as the mean over the interval before a row",
}


def is_assumed(recordings: Sequence[R]) -> bool:
    """Whether all recordings, of one joint or of a robot, have an input that is taken to be held, and none states so."""
    driven = all(r.command is not None or (isinstance(r, Recording) and r.driven) for r in recordings)
    return driven and all(r.hold == "held" and not r.hold_stated for r in recordings)


def with_hold(recordings: Sequence[R], hold: str) -> list[R]:
    """The recordings with another hold of the command."""
    return [dataclasses.replace(r, hold=hold) for r in recordings]


def shown_hold(axis: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], seconds: float) -> str:
    """The hold that takes a quarter off the squared error of a held input where the numbers of ``axis`` are refitted.

    Or leaves noise alone where a held input leaves more. "held" where none does, or where an input that is earlier by another
    sample leaves less. ``seconds``: the most that it takes.
    """
    until = time.monotonic() + seconds
    left = {"held": _refitted(axis, recordings, held_out, until)}
    for hold in HOLDS:
        other = with_hold(recordings, hold), with_hold(held_out, hold)
        if hold != "held" and _promises(axis, *other, left["held"]):
            left[hold] = _refitted(axis, *other, until)
    for k in range(2):  # without dry friction and with it
        own = {hold: x[k] for hold, x in left.items() if len(x) > k}
        best = min(own, key=lambda hold: own[hold].cost, default="held")
        if "held" not in own or best == "held" or not own["held"].is_improved_by(own[best]):
            continue
        if best == "mean":
            ahead = _refitted(axis, [earlier(r) for r in recordings], [earlier(r) for r in held_out], until)
            if len(ahead) <= k or ahead[k].cost < own[best].cost:
                continue
        return best
    return "held"


def hold_shows(axis: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording]) -> bool:
    """Whether straight lines between samples move an axis by more than noise that is known hides, beside a held input."""
    residuals = []
    for hold in ("held", "linear"):
        fitter = _fitter(axis, with_hold(recordings, hold), with_hold(held_out, hold))
        try:
            residuals += fitter.run([fitter.at_start(fitter.hypothesis(()))])
        finally:
            fitter.close()
    first, second = residuals
    if first is None or second is None or len(first) != len(second) or not fitter.noise.absolute:
        return True
    return bool(np.mean((first - second) ** 2) > UNEXPLAINED - 1.0)


def hold_instead(
    found: Axis, fewer: Sequence[Axis], recordings: Sequence[Recording], held_out: Sequence[Recording], seconds: float
) -> str:
    """The hold under which a structure with an effect less explains as much as ``found`` does under a held command.

    "held" where none does. ``fewer``: the structures with an effect less. As much: the criterion, which counts the effect, is
    not ahead by more than what is held to be equivalent. ``seconds``: the most that it takes.
    """
    until = time.monotonic() + seconds
    whole = _refitted(found, recordings, held_out, until, dry=False)
    if not whole:
        return "held"
    left = dict.fromkeys(("linear", "mean"), math.inf)
    for hold in left:
        held = with_hold(recordings, hold), with_hold(held_out, hold)
        for axis in fewer:
            for x in _refitted(axis, *held, until, dry=False, far=TWICE * whole[0].cost):
                left[hold] = min(left[hold], x.cost)
    best = min(left, key=lambda hold: left[hold])
    ahead = whole[0].independent * math.log(left[best] / whole[0].cost) - ModelError.prices.entry
    return best if ahead <= EQUIVALENT else "held"


def taken_hold(hold: str, rate: float, channel: str = "command") -> Problem:
    """What a check of the log says where a hold other than the assumed one is taken; ``rate``: samples/s."""
    shift = {"linear": -0.5, "mean": -1.0}[hold]
    return Problem(
        channel, "hold", shift, "samples",
        f"The {channel} {WORDS[hold]}, and is not held as assumed: the joint answers it {-1e3 * shift / rate:.3g} ms earlier.",
        f'the diagnosis takes it so; state [recording] hold = "{hold}" to confirm it', Severity.LIMITS,
    )  # fmt: skip


def input_channel(r: R) -> str:
    """The channel that drives a recording's joints: its command, or its torque."""
    return "torque" if r.command is None else "command"


def earlier(r: R) -> R:
    """A recording whose input acts two samples earlier: a sample before the mean over the interval before a row."""
    given = r.torque if r.command is None else r.command
    assert given is not None
    moved = np.concatenate([given[2:], np.repeat(given[-1:], min(2, len(r)), axis=0)])[: len(r)]
    return dataclasses.replace(r, torque=moved) if r.command is None else dataclasses.replace(r, command=moved)


@dataclass(frozen=True)
class _Left:
    """What a refit leaves: the weighted sum of squares, how many samples of it are independent, and whether it is noise."""

    cost: float
    independent: float
    noise: bool
    fitted: Fitted

    def is_improved_by(self, other: _Left) -> bool:
        """Whether another refit takes a quarter off it, or all but the noise, by more than chance."""
        gain = other.independent * math.log(self.cost / other.cost)
        clear = other.cost < (1.0 - FAIR) * self.cost or (other.noise and not self.noise)
        return clear and gain > ModelError.prices.entry


def _refitted(
    axis: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], until: float, *, dry: bool = True,
    far: float = math.inf,
) -> list[_Left]:  # fmt: skip
    """What the axis leaves with its numbers refitted; with ``dry`` what it leaves beside dry friction too, where it has none.

    far: cost above which a fit ends with an iteration that takes less than `FAIR` off.
    """
    fitter = _fitter(axis, recordings, held_out)
    try:
        fitter.allow(math.inf, until)
        found = [fitter.fit(fitter.hypothesis(()), slow=(far, FAIR))]
        if found[0].ok and dry:
            fits = [fitter.fit(fitter.hypothesis((e,), found[0].linear, found[0].own)) for e in _dry_friction(fitter)]
            found += [min(fits, key=lambda f: f.chi2)] if fits else []
        return [
            _Left(f.chi2, f.n * effective_share(fitter, f), _is_noise(fitter, f), f) for f in found if f.ok and f.chi2 > 0.0
        ]  # fmt: skip
    finally:
        fitter.close()


def _promises(axis: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], held: Sequence[_Left]) -> bool:
    """Whether recordings of another hold leave less at the numbers of a refit of held ones, beside what its slopes take up."""
    fitter = _fitter(axis, recordings, held_out)
    try:
        starts = [fitter.hypothesis(x.fitted.effects, x.fitted.linear, x.fitted.own) for x in held]
        residuals = fitter.run([fitter.at_start(h) for h in starts])
    finally:
        fitter.close()
    for x, r in zip(held, residuals, strict=True):
        q = orthonormal(x.fitted.fit.J)
        if r is not None and (len(r) != len(q) or r @ r - float(np.sum((q.T @ r) ** 2)) < x.cost):
            return True
    return False


def _fitter(axis: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording]) -> Fitter:
    options = Options(jobs=1)
    usable = Usable.of(axis, recordings, held_out, options)
    return usable.fitter(split(usable.recordings, usable.held_out), options, {})


def _is_noise(fitter: Fitter, f: Fitted) -> bool:
    """Whether what a fit leaves is as large as noise that is known."""
    return fitter.noise.absolute and fitter.noise.within(f.chi2 / f.n, UNEXPLAINED)


def _dry_friction(fitter: Fitter) -> list[Effect]:
    """What MJCF's dry friction stands for on the driven body, at each start of a fit; none where the axis has a friction."""
    chain = fitter.nominal.chain
    found = next((e for cls in registered().values() if (e := cls.read(DryFriction(0, 1.0), chain)) is not None), None)
    if found is None or any(e.family == found.family for e in fitter.nominal.effects):
        return []
    cls = type(found)
    return [cls(place=found.place, **start) for start in cls.starts(fitter.scales_for(cls, found.place))]
