"""What else is to be said of a diagnosis: limits of the data, doubts, and how the answer was reached."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from diagnose.check.unused import unused_channels
from diagnose.evidence.intervals import at_bounds
from diagnose.explain.second_encoder import judge_second_encoder
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.whiten import noise_rms
from diagnose.options import Options
from diagnose.result import Finding, Verdict
from diagnose.structure.search import Search
from diagnose.thresholds import TWICE
from diagnose.verdict.refusals import refusals, refused_in_words
from diagnose.verdict.servo_zero import constant_torque, with_an_offset
from diagnose.verdict.witnesses import Remaining, RepeatedRows
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.effects.registry import registered
from mjsim.quantity import Quantity

__all__ = ["DERIVED", "LATE", "SHARED", "Outcome", "notes", "unphysical"]

SHARED = (
    "The estimation recordings fit without it: they hardly exercise what is missing, and the held-out ones do. So all recordings "
    "were fitted over two thirds of their length, in blocks, and judged on the rest. Record an estimation run that exercises it."
)

LATE = (
    "The budget of time (--budget) was used up when the search ended: structures may be left untried, and no torque map was "
    "sought. A larger budget looks further; --effort limits the search in the same way on every machine."
)

DERIVED = (
    "The velocity column was made of the angle column, by differences or behind a filter: it holds the angle's noise and nothing "
    "more. The angle alone is used."
)


@dataclass(frozen=True)
class Outcome:
    """What the stages before the report have come to.

    whitened: whether errors were whitened; mapped: whether a torque map is given; unit: of the judged channel.
    """

    search: Search
    best: Fitted
    found: tuple[Finding, ...]
    remaining: Remaining
    verdict: Verdict
    rows: RepeatedRows
    whitened: bool
    mapped: bool
    unit: str
    undetermined: tuple[str, ...] = ()


def notes(outcome: Outcome, options: Options) -> tuple[str, ...]:
    """Sentences, in the order in which they are printed."""
    said = [
        *outcome.undetermined,
        *_of_the_model(outcome),
        *_of_the_numbers(outcome),
        *_of_the_residual(outcome, options),
        *_of_the_search(outcome, options),
    ]
    if outcome.search.fitter.nominal.chain.servo is None and "gain" not in " ".join(said):
        said.append(
            "A pure error of the torque gain cannot be told from a common scale of all inertias, stiffnesses and dampings; "
            "it is reported as changed parameters."
        )
    return tuple(said)


def _of_the_model(outcome: Outcome) -> Iterator[str]:
    nominal, kept = outcome.search.fitter.nominal, {e.key for e in outcome.best.hypothesis.carried}
    yield from unphysical(nominal)
    for e in nominal.effects:
        if e.key not in kept:
            yield (
                f"{e.describe(nominal.chain.motion).removesuffix('.')}, as the nominal model had it: "
                "what was found has taken its place."
            )
    if outcome.rows.count:
        yield (
            f"{outcome.rows.count} rows repeat velocity and angle of the row before to the last digit while the axis moves: the "
            "logger or the sensor held them. They are left out of every fit and error. This is no physics of the axis."
        )


def _of_the_numbers(outcome: Outcome) -> Iterator[str]:
    for name in at_bounds(outcome.best):
        yield (
            f"{name} stands at its bound: the recording asks for more than the model's value may be off. This is no finding: "
            "check unit, gear side and the model's value."
        )
    early = getattr(outcome.search.fitter.view, "early", 0.0)
    if early > 0:
        yield (
            f"The input acts {1e3 * early:.3g} ms before its rows, which no drive does: stamps do, or a simulator that takes "
            "semi-implicit steps (half its timestep). It is taken so, and is no physics."
        )
    experiments = (*outcome.search.fitter.experiments, *outcome.search.fitter.held_out)
    servo = outcome.search.fitter.nominal.chain.servo is not None
    yield from unused_channels((e.recording for e in experiments), servo=servo)
    if not outcome.search.fitter.nominal.chain.couplings:
        yield from _of_the_load(outcome.found)
    moved = constant_torque(outcome.search.fitter, outcome.best)
    if moved is not None:
        yield _of_the_zero(outcome, *moved)


def _of_the_zero(outcome: Outcome, zero: float, torque: float) -> str:
    """What the zero of a servo takes up, and what tells the two apart."""
    fitter = outcome.search.fitter
    angle, force = (q.unit(fitter.nominal.chain.motion) for q in (Quantity.ANGLE, Quantity.TORQUE))
    alike = (n.replace("_", " ") for e in outcome.best.effects for n in with_an_offset(fitter, outcome.best, e))
    others = " or ".join(("a constant torque", *dict.fromkeys(alike)))
    return (
        f"The zero of the servo is found {zero:.3g} {angle} off the model's, which kp makes {abs(torque):.3g} {force}: {others} "
        "moves the joint alike. The angle at rest without power, or a recording with another kp, tells them apart."
    )


def _of_the_load(found: Sequence[Finding]) -> Iterator[str]:
    """What tells friction by the load from friction over the angle, where either may be: on a rigid axis with a weight."""
    for f in found:
        names = [n for n in (e.split("@")[0] for e in f.equivalents) if n in registered()]
        by_load = [n.replace("_", " ") for n in names if effect_class(n).by_load]
        over_angle = [n.replace("_", " ") for n in names if _over_angle(n)]
        said = f.effect.replace("_", " ").capitalize()
        if by_load:
            yield (
                f"{said} follows the torque of the weight over the angle: {by_load[0]} makes the same motion. Another load (a "
                "known mass added) tells them apart."
            )
        elif effect_class(f.effect).by_load and over_angle:
            yield (
                f"{said}: the torque of the drive follows the angle in these recordings, so that {over_angle[0]} makes the same "
                "motion. Another load (a known mass added), or moves that are fast enough for the inertia, tell them apart."
            )


def _over_angle(name: str) -> bool:
    """Whether an effect is friction that repeats over the angle."""
    cls = effect_class(name)
    return cls.family == "friction" and any(s.name == "cycles_per_rev" for s in cls.specs())


def _of_the_residual(outcome: Outcome, options: Options) -> Iterator[str]:
    remaining, fitter = outcome.remaining, outcome.search.fitter
    structure, missed = remaining.structure, remaining.motion[1]
    if missed is not None and remaining.unexplained:
        yield (
            "Motion that the model misses, confirmed by the angle, has "
            f"{math.sqrt(max(missed, 0.0)):.2g} times the rms of the velocity noise on held-out data."
        )
    if structure.share > options.structure_share and structure.p_value < options.structure_p and not remaining.diverges:
        yield (
            f"Structure remains that no known effect accounts for: the recorded input and motion predict "
            f"{100 * structure.share:.1f} % of the held-out residual energy (p = {structure.p_value:.1g})."
        )
    held = outcome.search.held_out(outcome.best)
    level = noise_rms(fitter, fitter.experiments[0])
    far = held is not None and fitter.noise.absolute and held.rms**2 > TWICE**2 * level**2
    if far and held is not None and outcome.verdict is Verdict.MISSING_PHYSICS and not remaining.diverges:
        yield (
            f"The remaining held-out error is {held.rms / level:.3g} times the noise: the named effects explain most of the "
            "mismatch, not all of it."
        )
    if remaining.beyond_sensors:
        assert held is not None
        yield (
            f"The model misses the held-out force by {100 * held.nrmse:.3g} % of its variation, which is more than the noise of "
            "the sensors can be: a torque acts that it does not know of."
        )
    if remaining.unexplained and not outcome.mapped:
        yield "No torque map over one or two state variables lowers the held-out error for sure: none is given."
    feedback = fitter.noise.absolute and any(e.recording.loop == "closed" for e in fitter.experiments)
    if outcome.verdict is Verdict.UNEXPLAINED and feedback:
        yield (
            "The axis was under feedback. A torque that no model knows of (other axes, cables, the process) is missed motion in "
            "a free run; judged by force (--judge force) it counts as error, and what repeats in spite of it is named."
        )
    if remaining.by_parameters:
        yield (
            "The estimation recordings leave parameters open that the held-out ones need: fitted to both together, the same "
            "structure leaves nothing material. Record more of what the held-out ones contain before trusting the parameters."
        )
    if remaining.diverges:
        yield (
            "The free run diverges on the held-out recording: stick-slip or impacts come at other moments, by an error of the "
            "parameters far within their intervals, and the rest follows. Where these leave no doubt of the motion nothing "
            "material is left: what remains is how far such events carry, and no missing physics."
        )
    if remaining.by_torque_noise:
        yield (
            "The remaining error is no larger than the noise of the recorded torque causes in a free run, and it falls once "
            "that torque is smoothed: it is noise of the torque's sensor. Record the commanded torque, or judge by force."
        )
    if remaining.by_encoder:
        yield (
            "The remaining error repeats with the turn of the encoder at every speed: it is an error of the encoder, not of the "
            "motion."
        )


def _of_the_search(outcome: Outcome, options: Options) -> Iterator[str]:
    search, fitter, best = outcome.search, outcome.search.fitter, outcome.best
    if search.state.late:
        yield LATE
    elif fitter.spent and not fitter.late and outcome.verdict is Verdict.UNEXPLAINED:
        yield (
            f"The search ended once it had taken {fitter.most_runs:.0f} simulations, and left structures untried: "
            f"--effort {4 * options.effort:g} looks four times as long."
        )
    yield from _steps(search, best, outcome.unit)
    yield from refused_in_words(refusals(search, best))
    for f in outcome.found:
        if search.significance.hardly_exercised(best, f"{f.form or f.effect}@{f.place}"):
            yield (
                f"The held-out recording hardly exercises {f.effect.replace('_', ' ')} at the {f.place}: it was judged on "
                "stretches of the estimation recordings that were held out of its fit. Record a held-out run that exercises it."
            )
    second = judge_second_encoder(fitter.nominal.chain, fitter.experiments, fitter.held_out)
    if second is not None:
        yield second.sentence()
    if not outcome.whitened:
        return
    yield "The residual is coloured; errors were whitened before rivals were compared, so that its correlation is counted."
    if outcome.remaining.motion[1] is None:
        yield _of_one_channel(fitter)


def _of_one_channel(fitter: Fitter) -> str:
    """What one channel leaves open, and what would tell, where the recordings lack it."""
    said = (
        "Coloured noise cannot be told from motion that the model misses, since one channel alone shows the motion: what "
        "is left was taken for noise."
    )
    if fitter.view.channel == "angle":
        return f"{said} It is at most {TWICE:g} times the noise of the angle."
    both = all(e.recording.angle is not None and e.recording.velocity is not None for e in fitter.experiments)
    if both:
        return f"{said} The angle that is recorded beside the velocity tells nothing more here."
    return f"{said} Record angle and velocity."


def _steps(search: Search, best: Fitted, unit: str) -> list[str]:
    """What the simpler form of each found effect achieves: how the refinement was reached."""
    out = []
    after = search.held_out(best)
    before = search.held_out(search.nominal())
    for effect in best.effects:
        rest = [k for k in best.key if k != effect.key]
        for simple in type(effect).refines:
            f = search.fits.get(tuple(sorted([*rest, f"{simple}@{effect.place}"])))
            held = search.held_out(f) if f is not None else None
            if held and after and before:
                out.append(
                    f"Held-out error {before.rms:.4g} {unit} for the refitted nominal model, {held.rms:.4g} with "
                    f"{simple.replace('_', ' ')}, {after.rms:.4g} with {effect.id.replace('_', ' ')}."
                    if not rest
                    else f"Held-out error {held.rms:.4g} {unit} with {simple.replace('_', ' ')} in place of "
                    f"{effect.id.replace('_', ' ')}, {after.rms:.4g} with it."
                )
    return out


def unphysical(axis: Axis) -> tuple[str, ...]:
    """Nominal values that no passive mechanism has."""
    out = [
        f"The nominal damping at {c.joint!r} is negative ({c.damping:g}): no passive spring has that. It may stand for a delay, "
        "for friction or for a further mode that was left out when it was identified."
        for c in axis.chain.couplings
        if c.damping < 0
    ]
    out += [
        f"The nominal viscous friction at {b.joint!r} is negative ({b.viscous:g})." for b in axis.chain.bodies if b.viscous < 0
    ]
    return tuple(out)
