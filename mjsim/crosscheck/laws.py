"""Laws that a run must keep whatever the solver: the scaling of torque and gap, and the balance of energy."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mjsim import accurate, ode, reference
from mjsim.axis import Axis
from mjsim.crosscheck.engines import judge, literal
from mjsim.crosscheck.report import Cell, Row, Status
from mjsim.effects import BacklashLaw
from mjsim.effects.backlash import Backlash
from mjsim.effects.coulomb_friction import CoulombFriction
from mjsim.effects.ports import Friction
from mjsim.law_probes import constant
from mjsim.mjcf import load_model, write_corrected
from mjsim.mujoco_run import run_signals
from mjsim.ode import Trajectory
from mjsim.system import assemble

__all__ = ["energy_error", "energy_rows", "scaling_row"]


def scaling_row(axis: Axis, model: Path, u: np.ndarray, dt: float) -> Row:
    """Gap 5e-4 at full torque against five times gap 1e-4 at a fifth of it: the same number to rounding, in every runner."""
    big, small = (axis + Backlash(gap_rad=g) for g in (5e-4, 1e-4))
    own = [dataclasses.replace(a, backlash_law=BacklashLaw.UNGATED) for a in (big, small)]
    runs: dict[str, Callable[[Axis, np.ndarray], Trajectory | None]] = {
        "exact": lambda a, w: reference.simulate(a, w, dt),
        "kernel": lambda a, w: ode.simulate(a, w, dt),
        "accurate": lambda a, w: accurate.simulate(a, w, dt),
        "literal": lambda a, w: literal(model, own[0] if a is big else own[1], w, dt, None)[0],
    }
    cells = []
    for name, run in runs.items():
        start = time.perf_counter()
        full, fifth = run(big, u), run(small, 0.2 * u)
        seconds = time.perf_counter() - start
        assert full is not None
        assert fifth is not None
        cells.append(judge(name, 5 * fifth.velocity, full.velocity, 1e-9, False, seconds))
    return Row("scaling law", "itself", 0.0, 0.0, tuple(cells))


def energy_error(axis: Axis, run: Trajectory) -> float:
    """Imbalance of stored plus dissipated energy over its initial value: linear chain, gaps without damper, Coulomb friction."""
    from scipy.integrate import cumulative_simpson

    s = assemble(axis)
    stored, lost = np.zeros(len(run.time)), np.zeros(len(run.time))
    for i in range(s.n):
        stored += 0.5 * s.f[0, i] * run.v[:, i] ** 2
        lost += s.f[1, i] * cumulative_simpson(run.v[:, i] ** 2, x=run.time, initial=0)
    for j in range(s.n - 1):
        d = s.f[2, j] * run.q[:, j] - run.q[:, j + 1]
        rate = s.f[2, j] * run.v[:, j] - run.v[:, j + 1]
        stored += 0.5 * s.f[3, j] * (d - np.clip(d, -s.f[5, j], s.f[5, j])) ** 2
        lost += s.f[4, j] * cumulative_simpson(rate**2, x=run.time, initial=0)
    for port in (p for effect in axis.effects for p in effect.ports(axis.chain) if isinstance(p, Friction)):
        level = constant(port.law, port.p, 1.0)
        if level is None:
            raise ValueError("the balance covers friction of constant levels only")
        lost += level[0] * cumulative_simpson(np.abs(run.v[:, port.body]), x=run.time, initial=0)
    return float(np.max(np.abs(stored + lost - stored[0])) / stored[0])


def energy_rows(axis: Axis, model: Path) -> list[Row]:
    """Release from a deflection, no torque, the negative damping taken out."""
    dt = 5e-5
    passive = axis.with_linear({p.name: 0.0 for p in axis.chain.linear_parameters() if p.kind == "damping" and p.value < 0})
    start = np.zeros((2, len(axis.chain.bodies)))
    start[0, -1] = 0.01
    u = np.zeros(4001)
    eventful = passive + CoulombFriction(torque_Nm=0.1) + Backlash(gap_rad=5e-4)
    rows = []
    for name, a in (("energy, linear", passive), ("energy, Fc 0.1 + gap 5e-4", eventful)):
        runs: dict[str, Trajectory] = {
            "exact": reference.simulate(a, u, dt, initial=start),
            "kernel": ode.simulate(a, u, dt, initial=start),
            "accurate": accurate.simulate(a, u, dt, initial=start),
        }
        if a is passive:
            with tempfile.TemporaryDirectory() as work:
                written = write_corrected(model, a, Path(work) / model.name)
                runs["literal"] = run_signals(load_model(written.path), u, dt, initial=start)
        cells = []
        for engine, run in runs.items():
            error = energy_error(a, run)
            cells.append(Cell(engine, error, 1e-6, Status.HOLDS if error <= 1e-6 else Status.MISSED))
        rows.append(Row(name, "balance", 0.0, 0.0, tuple(cells)))
    return rows
