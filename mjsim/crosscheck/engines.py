"""One case through every engine, against the truth that it has."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjsim import accurate, ode, reference
from mjsim.axis import Axis
from mjsim.crosscheck.cases import Case
from mjsim.crosscheck.report import Cell, Row, Status
from mjsim.effects import BacklashLaw
from mjsim.mjcf import load_model, write_corrected
from mjsim.mjcf.editor import MjcfEditor
from mjsim.mujoco_run import run_signals
from mjsim.ode import Trajectory
from mjsim.system import assemble

__all__ = ["compare", "judge", "literal", "own_error", "relative", "truth_of"]

NUDGE = 1e-6  # relative change of the input by which the condition is measured: above the truth's own error, below every limit
# Condition up to which a run is judged: the limit of 2e-3 is twice what plain MuJoCo errs on well-conditioned motion (up to
# 1.2e-3 for friction and gaps, docs/decisions/mjcf.md), which is used up at two; the other limits leave more.
CONDITION = 2.0
JUDGED = 0.1  # of the duration: a shorter leading part of a chirp from 0.5 to 30 Hz over 10 s has fewer than two periods
FINER = (1, 5, 25)  # parts of the written timestep at which plain MuJoCo is tried


def relative(run: np.ndarray, truth: np.ndarray) -> float:
    """Relative RMS of a difference."""
    return float(np.sqrt(np.mean((run - truth) ** 2) / max(float(np.mean(truth**2)), 1e-300)))


def literal(model: Path, axis: Axis, u: np.ndarray, dt: float, step: float | None) -> tuple[Trajectory | None, float, str]:
    """Plain MuJoCo on a copy of the model with the axis written into it, at a timestep of ``step`` [s] or less.

    Returns the run, the timestep that the file got, and ""; None, 0 and the reason where MJCF cannot express the axis.
    """
    with tempfile.TemporaryDirectory() as work:
        source = model if step is None else _with_step(model, step, Path(work) / f"nominal_{model.name}")
        written = write_corrected(source, axis, Path(work) / model.name)
        # a damper that acts in the gap is plain MuJoCo's own law: it is judged by that
        lacks = [line for line in written.lacks if axis.backlash_law is not BacklashLaw.UNGATED or "gap" not in line]
        if lacks:
            return None, 0.0, lacks[0]
        loaded = load_model(written.path)
        return run_signals(loaded, u, dt), float(loaded.mjmodel.opt.timestep), ""


def _with_step(model: Path, step: float, out: Path) -> Path:
    """A copy of a model, and of the binding beside it, whose timestep is ``step`` [s] or less."""
    editor = MjcfEditor(model, load_model(model).found)
    editor.step(step)
    editor.relocate(out)
    out.write_bytes(editor.xml.raw)
    beside = model.with_suffix(".toml")
    if beside.is_file():
        out.with_suffix(".toml").write_text(beside.read_text(encoding="utf-8"), encoding="utf-8")
    return out


@dataclass(frozen=True, eq=False)
class Truth:
    """What engines are compared with: velocity (N,), kind, own error, condition, and how many leading samples are judged.

    The condition is the relative change of the motor's velocity over a relative change of the input, over the whole run; that of
    the first ``judged`` samples is no more than `CONDITION`. 0: the motion is chaotic from the start.
    """

    velocity: np.ndarray
    kind: str
    error: float
    condition: float
    judged: int


def truth_of(axis: Axis, u: np.ndarray, dt: float) -> Truth:
    """The exact reference where the axis is piecewise affine, else the kernel at 16 steps a sample."""
    more = (1.0 + NUDGE) * u
    if reference.not_affine(axis) is None:
        run, other = (reference.simulate(axis, w, dt) for w in (u, more))
        kind, own = "exact", 0.0
    else:
        s = assemble(axis)
        run, other = (ode.simulate(s, w, dt, substeps=16) for w in (u, more))
        kind, own = "kernel x16", relative(ode.simulate(s, u, dt, substeps=8).velocity, run.velocity)
    change = np.sqrt(np.cumsum((other.v[:, 0] - run.v[:, 0]) ** 2) / np.maximum(np.cumsum(run.v[:, 0] ** 2), 1e-300))
    well = np.flatnonzero(change <= CONDITION * NUDGE)
    judged = int(well[-1]) + 1 if len(well) else 0
    return Truth(run.velocity, kind, own, float(change[-1]) / NUDGE, judged if judged >= JUDGED * len(u) else 0)


def judge(engine: str, run: np.ndarray, truth: np.ndarray, limit: float, chaotic: bool, seconds: float, note: str = "") -> Cell:
    """Whether a run (N,) meets its limit."""
    error = relative(run, truth)
    missed = Status.CHAOTIC if chaotic else Status.MISSED
    status = Status.HOLDS if error <= limit else missed
    return Cell(engine, error, limit, status, seconds, note)


def own_error(model: Path, axis: Axis, u: np.ndarray, dt: float) -> float:
    """Relative RMS error of plain MuJoCo on the bare chain: what the file's own timestep and integrator make of any form."""
    bare = Axis(axis.chain, (), axis.backlash_law)
    plain = literal(model, bare, u, dt, None)[0]
    return 0.0 if plain is None else relative(plain.velocity, truth_of(bare, u, dt).velocity)


def _timed(run: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    out = run()
    return out, time.perf_counter() - start


def _judged(engine: str, run: Trajectory, truth: Truth, limit: float, seconds: float, note: str = "") -> Cell:
    """A run against a truth over the part that is judged, over all of it where there is none."""
    end = truth.judged or len(truth.velocity)
    return judge(engine, run.velocity[:end], truth.velocity[:end], limit, truth.judged == 0, seconds, note)


def compare(case: Case, model: Path, u: np.ndarray, dt: float, batched: Trajectory) -> Row:
    """One case through every engine."""
    truth = truth_of(case.axis, u, dt)
    run, seconds = _timed(lambda: ode.simulate(case.axis, u, dt))
    cells = [_judged("kernel", run, truth, case.kernel, seconds)]
    run, seconds = _timed(lambda: accurate.simulate(case.axis, u, dt))
    cells.append(_judged("accurate", run, truth, case.accurate, seconds))
    same = np.array_equal(run.velocity, batched.velocity)
    cell = _judged("batch", batched, truth, case.accurate, 0.0, "the accurate runner's bits" if same else "")
    cells.append(cell if same else dataclasses.replace(cell, status=Status.MISSED, note="differs from a run alone"))
    if case.literal is not None:
        cells.append(_literal_cell(case, case.literal, model, u, dt, truth))
    return Row(case.name, truth.kind, truth.error, truth.condition, tuple(cells), truth.judged * dt)


def _literal_cell(case: Case, limit: float, model: Path, u: np.ndarray, dt: float, truth: Truth) -> Cell:
    """Plain MuJoCo at the timestep that is written and, where that misses the limit, at parts of it.

    The error of a form that has the effect's law goes with the timestep; a form of another law misses the limit at each.
    """
    own_law = dataclasses.replace(case.axis, backlash_law=BacklashLaw.UNGATED)
    notes = []
    if assemble(own_law).f[5].any():
        notes.append("judged by the ungated law")
        truth = truth_of(own_law, u, dt)
    end = truth.judged or len(u)
    written, first, cell = 0.0, math.nan, None
    for parts in FINER:
        step = written / parts if written else case.literal_step
        begun = time.perf_counter()
        plain, at, why = literal(model, own_law, u[:end], dt, step)
        if plain is None:
            return Cell("literal", math.nan, limit, Status.ABSENT, 0.0, why)
        cell = _judged("literal", plain, truth, limit, time.perf_counter() - begun)
        if parts == 1:
            written, first = at, cell.error
        elif cell.status is Status.HOLDS:
            notes.append(f"at a timestep of {at:.3g} s; {first:.2g} at the {written:.3g} s that is written")
        if cell.status is not Status.MISSED:
            break
    assert cell is not None
    return dataclasses.replace(cell, note="; ".join(notes))
