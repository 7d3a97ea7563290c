"""How a hypothesis of `diagnose.check.scale` becomes a problem; the faults of sign, unit and side are in files of their own."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.scale import Evidence, Hypothesis, Scale
from diagnose.check.thresholds import Z95
from diagnose.check.types import Problem, Severity

__all__ = ["chosen", "scale_problem"]


def chosen(context: Context, kind: str) -> Scale | None:
    """The scale where its chosen hypothesis is of a kind, and the input is a torque at all; else None."""
    scale = context.scale
    if scale is None or scale.chosen.kind != kind or context.is_command:
        return None
    return scale


def scale_problem(scale: Scale, context: Context) -> list[Problem]:
    """One problem: the estimated factor with its interval, the known factor, and what else would explain it."""
    h = scale.chosen
    value, ci95, basis = _estimate(h, scale.labelled)
    others = "; ".join(o.what for o in scale.equivalents)
    either = f" The data cannot tell this from: {others}." if others else ""
    return [
        Problem(
            h.channel, h.kind, value, "1",
            f"{h.what[0].upper()}{h.what[1:]}: {basis} {value:.4g} times what the labels say "
            f"(95 % {ci95[0]:.4g} to {ci95[1]:.4g}); with the known factor {1 / h.factor:.6g} everything agrees.{either}",
            h.advice, Severity.FIX, ci95,
        )
    ]  # fmt: skip


def _estimate(h: Hypothesis, labelled: Evidence) -> tuple[float, tuple[float, float], str]:
    """The factor as it was estimated under the labels, with its interval, and what it is a factor of."""
    if labelled.pair is not None and not labelled.channels_agree():
        r, basis = labelled.pair.ratio, "the rate of the angle is"
    else:
        r, basis = labelled.fits[0].inertia, "the inertia in the recording is"
    return r.value, (r.value - Z95 * r.error, r.value + Z95 * r.error), basis
