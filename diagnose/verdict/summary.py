"""The answer in one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from diagnose.result import Finding, FitFigures, Verdict

__all__ = ["REPEATED_ROWS", "summary"]

REPEATED_ROWS = (
    "The mismatch is no physics of the axis: rows of the recordings repeat the row before and were not measured; where they "
    "were, the nominal structure agrees to within the noise."
)


def summary(
    verdict: Verdict, findings: Sequence[Finding], fits: Mapping[str, FitFigures], gap: float, known: bool, unit: str,
    late: bool = False,
) -> str:  # fmt: skip
    """The answer in one sentence; ``late``: whether the budget of time ended the search."""
    before, after = fits["refitted"].held_out_rms, fits["corrected"].held_out_rms
    names = " and ".join(f"{f.effect.replace('_', ' ').replace('coulomb', 'Coulomb')} at the {f.place}" for f in findings)
    none = "no effect that was tried in the time" if late else "no known effect"
    match verdict:
        case Verdict.NO_MISMATCH:
            return "Nothing is missing: the nominal model agrees with the recording to within its noise."
        case Verdict.PARAMETERS_ONLY if not known:  # by force: how much of the residual is noise is not known
            return (
                "No missing physics can be named: with its parameters adjusted the nominal structure misses the held-out force "
                f"by {100 * fits['corrected'].held_out_nrmse:.3g} % of its variation, and {none} reliably lowers that."
            )
        case Verdict.PARAMETERS_ONLY:
            return "No physics is missing: the nominal structure fits once its parameters are adjusted."
        case Verdict.MISSING_PHYSICS:
            share = min(100.0, 100 * gap)
            part = "the error above the noise" if known else "the error"
            closed = f", removing {share:.1f} % of {part}" if math.isfinite(gap) else ""
            return (
                f"The simulation left out {names}: adding it lowers the held-out error "
                f"from {before:.4g} to {after:.4g} {unit}{closed}."
            )
        case Verdict.UNEXPLAINED if not known and not findings:
            return (
                "The mismatch is not explained: with its parameters adjusted the nominal structure misses the held-out force by "
                f"{100 * fits['corrected'].held_out_nrmse:.3g} % of its variation, and {none} reliably lowers that."
            )
        case Verdict.UNEXPLAINED:
            accounts = "accounts" if len(findings) == 1 else "account"
            part = f" {names} {accounts} for part of it (held-out error {before:.4g} to {after:.4g}), but" if findings else ""
            none = "no effect that was tried in the time" if late else "none of the known effects"
            return f"The mismatch is not explained:{part} structure remains that {none} accounts for."
