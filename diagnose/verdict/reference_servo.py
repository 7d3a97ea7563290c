"""Servo logs in the user's simulator: the files, stepped by plain MuJoCo on the recorded command, beside the measured angle."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diagnose.data.experiment import hold_out_blocks, prepare
from diagnose.result import Diagnosis, FitFigures
from diagnose.verdict.reference_verdict import MISSES
from mjsim.mjcf import Model, load_model
from mjsim.ode import DivergedError
from mjsim.recording import Recording
from mjsim.servo_run import literal_servo_run

__all__ = ["judge_servo", "servo_figures"]


def _masks(recordings: Sequence[Recording], held_out: Sequence[Recording]) -> list[tuple[Recording, np.ndarray, np.ndarray]]:
    """Each recording with the samples (N,) bool that were fitted and those that were held out."""
    out = []
    for r in recordings:
        counts = prepare(r).counts
        mine, other = (counts, np.zeros(len(r), bool)) if held_out else tuple(counts & part for part in hold_out_blocks(r))
        out.append((r, mine, other))
    return [*out, *((r, np.zeros(len(r), bool), prepare(r).counts) for r in held_out)]


def servo_figures(source: Model, recordings: Sequence[Recording], held_out: Sequence[Recording]) -> FitFigures:
    """Errors of the angle [rad | m] of a file in plain MuJoCo, on estimation and held-out samples; infinite where it diverges."""
    squares, spread, count = np.zeros(2), np.zeros(2), np.zeros(2)
    for r, *masks in _masks(recordings, held_out):
        assert r.angle is not None
        try:
            e = r.angle - literal_servo_run(source, r).angle
        except DivergedError:
            e = np.full(len(r), math.inf)
        for i, keep in enumerate(masks):
            if keep.any():
                squares[i] += float(np.sum(e[keep] ** 2))
                spread[i] += float(np.sum((r.angle[keep] - r.angle[keep].mean()) ** 2))
                count[i] += int(keep.sum())
    values = [(math.sqrt(s / n), math.sqrt(s / v)) if n and v else (math.nan, math.nan)
              for s, v, n in zip(squares, spread, count, strict=True)]  # fmt: skip
    return FitFigures(*values[0], *values[1])


def judge_servo(
    result: Diagnosis, model: Path, corrected: Path, recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> Diagnosis:
    """The diagnosis with MuJoCo's figures of both files; those of the engine move to ``surrogate``.

    A note says where the corrected file misses the engine's error by more than `MISSES`.
    """
    engine = {name: result.fit[name] for name in ("nominal", "refitted", "corrected") if name in result.fit}
    if "corrected" not in engine:
        return result
    nominal, found = (servo_figures(load_model(path), recordings, held_out) for path in (model, corrected))
    fits = {**result.fit, "nominal": nominal, "corrected": found}
    notes = result.notes
    reported = engine["corrected"]
    pairs = ((found.rms, reported.rms), (found.held_out_rms, reported.held_out_rms))
    if any(not a <= MISSES * b for a, b in pairs if not math.isnan(b)):
        notes = (
            f"Warning: corrected.xml in plain MuJoCo has a held-out error of {found.held_out_rms:.4g} {result.unit} (estimation "
            f"{found.rms:.4g}), and not the {reported.held_out_rms:.4g} ({reported.rms:.4g}) of the fitting engine: see its "
            "comment for what MJCF cannot hold, or lower its timestep.",
            *notes,
        )
    return dataclasses.replace(result, fit=fits, surrogate=engine, notes=notes)
