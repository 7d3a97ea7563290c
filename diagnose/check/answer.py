"""The answer of a diagnosis whose log is wrong: no search, no findings, and the fault by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnose.check.types import LogCheck
from diagnose.data.listed import listed
from diagnose.result import Diagnosis, Mismatch, Verdict
from mjsim.axis import Axis
from mjsim.recording import Recording

__all__ = ["wrong_log"]


def wrong_log(
    nominal: Axis, check: LogCheck, recordings: Sequence[Recording], held_out: Sequence[Recording], seed: int
) -> Diagnosis:
    """``unexplained`` without findings: whatever a fit of this log says is the fault of the log."""
    none = np.zeros(0)
    advice = "; ".join(dict.fromkeys(p.advice for p in check.to_fix()))
    by_force = recordings[0].velocity is None
    return Diagnosis(
        verdict=Verdict.UNEXPLAINED, summary=check.sentence, findings=(),
        mismatch=Mismatch((), (), (), (), (none, none, none, none), float("nan"), float("nan")),
        linear_parameters={}, nominal_parameters={p.name: p.value for p in nominal.chain.linear_parameters()}, fit={},
        noise_floor=float("nan"), gap_closed=0.0, rivals=(), failed={},
        notes=("No physics was sought: the check of the log says that it has to be fixed first.",),
        next_experiment=f"Fix the log: {advice}.", channel="angle" if by_force else "velocity",
        unit=("rad" if by_force else "rad/s") if nominal.chain.motion.value == "hinge" else ("m" if by_force else "m/s"), view="",
        traces=(), seed=seed, seconds=check.seconds, log=check,
        recordings=listed(recordings, held_out),
    )  # fmt: skip
