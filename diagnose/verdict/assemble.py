"""The `Diagnosis` from what the stages have come to."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping

from diagnose.data.listed import listed
from diagnose.evidence.conditioning import conditioning
from diagnose.explain.next_experiment import next_experiment
from diagnose.explain.torque_map import Mapped
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.whiten import noise_rms
from diagnose.options import Options
from diagnose.result import Diagnosis, FitFigures, Mismatch, Verdict
from diagnose.verdict.calibration import false_alarm_rate
from diagnose.verdict.decide import estimates, only_repeated_rows
from diagnose.verdict.figures import error_figures, figures, rivals, traces
from diagnose.verdict.findings import nominal_effect
from diagnose.verdict.friction_over_time import friction_by_recording
from diagnose.verdict.notes import Outcome, notes
from diagnose.verdict.refusals import refusals
from diagnose.verdict.summary import REPEATED_ROWS, summary

__all__ = ["diagnosis", "unit_of"]


def unit_of(fitter: Fitter) -> str:
    """Unit of the judged channel."""
    angular = fitter.nominal.chain.motion.value == "hinge"
    if fitter.view.channel == "angle":
        return "rad" if angular else "m"
    if fitter.view.channel == "velocity":
        return "rad/s" if angular else "m/s"
    control = {r.units.get("control") or "ctrl" for e in fitter.experiments if (r := e.recording).control_column}
    if control:  # the torque is compared as the actuator takes it, before gain and gear
        return control.pop() if len(control) == 1 else "ctrl"
    return "N m" if angular else "N"


def diagnosis(
    outcome: Outcome, base: Fitted, mapped: Mapped | None, mismatches: tuple[Mismatch, ...], options: Options, began: float
) -> Diagnosis:
    """The result, with everything that the report needs; ``base``: the refitted nominal model; ``began``: monotonic time [s]."""
    search, fitter, best, found = outcome.search, outcome.search.fitter, outcome.best, outcome.found
    by_rows = only_repeated_rows(outcome.verdict, outcome.rows, options)
    verdict = Verdict.UNEXPLAINED if by_rows else outcome.verdict
    said = notes(outcome, options)
    fits, gap = _figures(outcome, base, mapped)
    answer = summary(verdict, found, fits, gap, fitter.noise.absolute, outcome.unit, search.state.late)
    return Diagnosis(
        verdict=verdict,
        summary=REPEATED_ROWS if by_rows else answer,
        findings=found if verdict in (Verdict.MISSING_PHYSICS, Verdict.UNEXPLAINED) else (),
        mismatch=mismatches[0],
        mismatches=mismatches,
        linear_parameters=estimates(best, fitter, owner=""),
        nominal_parameters={p.name: p.value for p in fitter.nominal.chain.linear_parameters()},
        nominal_effects=tuple(nominal_effect(fitter, best, e) for e in best.hypothesis.carried),
        fit=fits,
        noise_floor=fitter.noise.floor(_noise_level(outcome)),
        gap_closed=gap,
        rivals=rivals(search, best),
        refusals=refusals(search, best),
        failed=dict(search.state.failed),
        notes=said,
        next_experiment=next_experiment(fitter, search.fits.values(), best, found),
        channel=fitter.view.channel,
        unit=outcome.unit,
        view="motion (free run)" if fitter.view.channel != "torque" else "force (inverse dynamics)",
        traces=traces(fitter, base, best, mapped.fitted if mapped is not None else None),
        recordings=listed([e.recording for e in fitter.experiments], [e.recording for e in fitter.held_out]),
        hypotheses=search.tested,
        simulations=fitter.runs,
        friction=friction_by_recording(fitter, best) if options.by_recording else {},
        conditioning=conditioning(best),
        false_alarm=false_alarm_rate(),
        seed=options.seed,
        seconds=time.monotonic() - began,
        versions=_versions(),
        map=mapped.result if mapped is not None else None,
    )  # fmt: skip


def _noise_level(outcome: Outcome) -> float:
    """Noise rms of the first recording: what the recording shows where an unexplained error may only look like coloured noise."""
    fitter = outcome.search.fitter
    shown = fitter.view.noise(fitter.experiments[0])
    one_channel = outcome.remaining.motion[1] is None
    if outcome.remaining.unexplained and one_channel and shown is not None:
        return shown
    return noise_rms(fitter, fitter.experiments[0])


def _figures(outcome: Outcome, base: Fitted, mapped: Mapped | None) -> tuple[Mapping[str, FitFigures], float]:
    fitter = outcome.search.fitter
    fits, gap = figures(fitter, outcome.search, base, outcome.best)
    if mapped is None:
        return fits, gap
    h, x = mapped.fitted.hypothesis, mapped.fitted.fit.x
    return {**fits, "mapped": error_figures(fitter, lambda i: h.axis(x, i), mapped.fitted, mapped.held_out)}, gap


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {"python": platform.python_version(), **{n: version(n) for n in ("simgap", "mujoco", "numpy", "scipy", "numba")}}
