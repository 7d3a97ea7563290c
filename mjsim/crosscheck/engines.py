"""One case through every engine, against the truth that it has."""

from __future__ import annotations

import dataclasses
import math
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mjsim import accurate, ode, reference
from mjsim.axis import Axis
from mjsim.crosscheck.cases import Case
from mjsim.crosscheck.report import Cell, Row, Status
from mjsim.effects import BacklashLaw
from mjsim.mjcf import load_model, write_corrected
from mjsim.mujoco_run import run_signals
from mjsim.ode import Trajectory
from mjsim.system import assemble

__all__ = ["compare", "judge", "literal", "own_error", "relative"]

CHAOTIC = 1e-6  # a change of 1e-10 rad that grows ten-thousand-fold: no tolerance below that can be asked


def relative(run: np.ndarray, truth: np.ndarray) -> float:
    """Relative RMS of a difference."""
    return float(np.sqrt(np.mean((run - truth) ** 2) / max(float(np.mean(truth**2)), 1e-300)))


def literal(model: Path, axis: Axis, u: np.ndarray, dt: float, step: float | None) -> tuple[Trajectory | None, str]:
    """Plain MuJoCo on a copy of the model with the axis written into it; None and the reason where MJCF cannot express it."""
    with tempfile.TemporaryDirectory() as work:
        source = model
        if step is not None:
            source = Path(work) / f"nominal_{model.name}"
            source.write_text(re.sub(r'timestep="[^"]*"', f'timestep="{step!r}"', model.read_text(encoding="utf-8")))
            beside = model.with_suffix(".toml")
            if beside.is_file():
                source.with_suffix(".toml").write_text(beside.read_text(encoding="utf-8"))
        written = write_corrected(source, axis, Path(work) / model.name)
        # a damper that acts in the gap is plain MuJoCo's own law: it is judged by that
        lacks = [line for line in written.lacks if axis.backlash_law is not BacklashLaw.UNGATED or "gap" not in line]
        if lacks:
            return None, lacks[0]
        return run_signals(load_model(written.path), u, dt), ""


def _truth(axis: Axis, u: np.ndarray, dt: float) -> tuple[np.ndarray, str, float, float]:
    """Velocity of the truth, its kind, its own error and its sensitivity to 1e-10 of the start angle."""
    nudge = np.zeros((2, len(axis.chain.bodies)))
    nudge[0, 0] = 1e-10
    if reference.not_affine(axis) is None:
        v = reference.simulate(axis, u, dt).velocity
        return v, "exact", 0.0, relative(reference.simulate(axis, u, dt, initial=nudge).velocity, v)
    s = assemble(axis)
    v = ode.simulate(s, u, dt, substeps=16).velocity
    own = relative(ode.simulate(s, u, dt, substeps=8).velocity, v)
    return v, "kernel x16", own, relative(ode.simulate(s, u, dt, substeps=16, initial=nudge).velocity, v)


def judge(engine: str, run: np.ndarray, truth: np.ndarray, limit: float, chaotic: bool, seconds: float, note: str = "") -> Cell:
    """Whether a run (N,) meets its limit."""
    error = relative(run, truth)
    missed = Status.CHAOTIC if chaotic else Status.MISSED
    status = Status.HOLDS if error <= limit else missed
    return Cell(engine, error, limit, status, seconds, note)


def own_error(model: Path, axis: Axis, u: np.ndarray, dt: float) -> float:
    """Relative RMS error of plain MuJoCo on the bare chain: what the file's own timestep and integrator make of any form."""
    bare = Axis(axis.chain, (), axis.backlash_law)
    plain, _ = literal(model, bare, u, dt, None)
    return 0.0 if plain is None else relative(plain.velocity, _truth(bare, u, dt)[0])


def _timed(run: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    out = run()
    return out, time.perf_counter() - start


def compare(case: Case, model: Path, u: np.ndarray, dt: float, batched: Trajectory) -> Row:
    """One case through every engine."""
    truth, kind, own, sensitivity = _truth(case.axis, u, dt)
    chaotic = sensitivity > CHAOTIC
    run, seconds = _timed(lambda: ode.simulate(case.axis, u, dt))
    cells = [judge("kernel", run.velocity, truth, case.kernel, chaotic, seconds)]
    run, seconds = _timed(lambda: accurate.simulate(case.axis, u, dt))
    cells.append(judge("accurate", run.velocity, truth, case.accurate, chaotic, seconds))
    same = np.array_equal(run.velocity, batched.velocity)
    cell = judge("batch", batched.velocity, truth, case.accurate, chaotic, 0.0, "the accurate runner's bits" if same else "")
    cells.append(cell if same else dataclasses.replace(cell, status=Status.MISSED, note="differs from a run alone"))
    if case.literal is not None:
        own_law = dataclasses.replace(case.axis, backlash_law=BacklashLaw.UNGATED)
        (plain, why), seconds = _timed(lambda: literal(model, own_law, u, dt, case.literal_step))
        if plain is None:
            cells.append(Cell("literal", math.nan, case.literal, Status.ABSENT, 0.0, why))
        else:
            has_gap = bool(assemble(own_law).f[5].any())
            other = _truth(own_law, u, dt)[0] if has_gap else truth
            note = "judged by the ungated law" if has_gap else ""
            cells.append(judge("literal", plain.velocity, other, case.literal, chaotic, seconds, note))
    return Row(case.name, kind, own, sensitivity, tuple(cells))
