"""Check recordings against a model: every registered check on every recording, what was understood, what can be identified."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

from threadpoolctl import threadpool_limits

from diagnose.check import faults as _faults  # noqa: F401  (registers the checks)
from diagnose.check.context import Context
from diagnose.check.excitation import excitation
from diagnose.check.machine import Machine
from diagnose.check.registry import checks
from diagnose.check.thresholds import Z95
from diagnose.check.types import LogCheck, Severity, TorqueTrace
from diagnose.check.understood import understood
from diagnose.data.experiment import measured_count
from mjsim.recording import Recording

__all__ = ["check_log"]


def check_log(machine: Machine, recordings: Sequence[Recording]) -> LogCheck:
    """Check recordings of one axis against its nominal model; problems that must be fixed come first.

    Uses no random numbers and does not change its arguments.
    """
    began = time.monotonic()
    with threadpool_limits(1, "blas"):
        together = sum(map(measured_count, recordings))
        contexts = [Context(r, machine, together) for r in recordings]
        found = [
            dataclasses.replace(problem, recording=c.recording.source)
            for c in contexts
            for one in checks().values()
            for problem in one.run(c.recording, machine, c)
        ]
        found.sort(key=lambda p: p.severity is not Severity.FIX)
        measured = {c.recording.source: _measured(c) for c in contexts}
        told, can = understood(contexts, machine), excitation(contexts, machine)
        torque = {
            c.recording.source: TorqueTrace(c.fit.time, c.fit.target, c.fit.target - c.fit.residual)
            for c in contexts if c.fit is not None
        }  # fmt: skip
    asked = tuple(c.question for c in checks().values())
    return LogCheck(told, tuple(found), tuple(can), measured, torque, time.monotonic() - began, asked)


def _measured(context: Context) -> dict[str, Any]:
    """Estimates that the checks rest on, with 95 % intervals."""
    out: dict[str, Any] = {"noise": dict(context.noise), "sample_time_s": context.recording.dt}
    fit, scale = context.fit, context.scale
    if fit is not None:
        names = {"delay_s": fit.delay, "inertia_ratio": fit.inertia, "friction_ratio": fit.loss, "gravity_ratio": fit.gravity}
        out |= {k: {"value": r.value, "ci95": [r.value - Z95 * r.error, r.value + Z95 * r.error]}
                for k, r in names.items() if r is not None}  # fmt: skip
        out |= {"torque_explained": fit.explained, "band_Hz": fit.top}
    if scale is not None and scale.evidence.pair is not None:
        out["angle_over_velocity"] = scale.evidence.pair.ratio.value
    return out
