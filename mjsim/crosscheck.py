"""MuJoCo against the analytic equations, effect by effect: every registered effect is covered because the registry is walked.

Each case is an axis, run on one chirp by the ODE kernel, by plain MuJoCo (literal: only what MJCF expresses, judged by its own
law), by the accurate runner alone and in a batch. The truth is the exact reference where the case is piecewise affine, else the
kernel at 16 steps per sample. Beside it stand the truth's own error (16 against 8 steps) and its sensitivity: what 1e-10 of the
start angle changes. Where that is large the motion is chaotic, no two solvers agree, and the case is shown but not judged.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjsim import accurate, ode, reference
from mjsim.axis import Axis
from mjsim.batch import Drive, Engine, rollout
from mjsim.effects import BacklashLaw, Effect, NotApplicableError, Scales, effect_class, registered
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mjcf.compile import caught_warnings
from mjsim.models import shipped_model
from mjsim.mujoco_run import run_signals
from mjsim.ode import Trajectory
from mjsim.system import assemble

__all__ = [
    "Case",
    "Cell",
    "Report",
    "Row",
    "Status",
    "check_all",
    "compare",
    "effect_cases",
    "energy_error",
    "literal",
    "plot",
    "scales_at",
    "study_cases",
    "table",
]

DT = 5e-4
CHAOTIC = 1e-6  # a change of 1e-10 rad that grows ten-thousand-fold: no tolerance below that can be asked
LITERAL = 2e-3  # what plain MuJoCo's soft friction and limits reach at the steps that the writer of the file chooses
KERNEL = 2e-5  # the kernel at its own choice of step


class Status(enum.Enum):
    """How a comparison ended."""

    HOLDS = "holds"
    MISSED = "MISSED"
    CHAOTIC = "chaotic"
    ABSENT = "not expressible"


@dataclass(frozen=True)
class Case:
    """An axis to run, and the limits of each engine, relative RMS of motor velocity.

    ``literal_step``: timestep of plain MuJoCo [s], the file's when None; ``drive``: factor on the chirp's amplitude.
    """

    name: str
    axis: Axis
    accurate: float
    literal: float | None = LITERAL
    literal_step: float | None = None
    kernel: float = KERNEL
    drive: float = 1.0


@dataclass(frozen=True)
class Cell:
    """One engine on one case."""

    engine: str
    error: float
    limit: float
    status: Status
    seconds: float = 0.0
    note: str = ""


@dataclass(frozen=True)
class Row:
    """One case: its truth, what the truth is worth, and the engines against it."""

    name: str
    truth: str
    truth_error: float
    sensitivity: float
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Report:
    """The rows, and what was left out with its reason."""

    rows: tuple[Row, ...]
    skipped: tuple[tuple[str, str], ...] = ()

    @property
    def missed(self) -> tuple[str, ...]:
        """Every comparison that missed its limit, in words."""
        return tuple(
            f"{row.name}: {c.engine} {c.error:.2g} > {c.limit:.2g}"
            for row in self.rows for c in row.cells if c.status is Status.MISSED
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        rows = [
            {
                "case": r.name, "truth": r.truth, "truth_error": r.truth_error, "sensitivity": r.sensitivity,
                "engines": {
                    c.engine: {"error": c.error if math.isfinite(c.error) else None, "limit": c.limit, "status": c.status.value,
                               "seconds": round(c.seconds, 3), **({"note": c.note} if c.note else {})}
                    for c in r.cells
                },
            }
            for r in self.rows
        ]  # fmt: skip
        return {"rows": rows, "skipped": [{"case": n, "why": w} for n, w in self.skipped], "missed": list(self.missed)}


def relative(run: np.ndarray, truth: np.ndarray) -> float:
    """Relative RMS of a difference."""
    return float(np.sqrt(np.mean((run - truth) ** 2) / max(float(np.mean(truth**2)), 1e-300)))


def scales_at(axis: Axis, run: Trajectory, place: str) -> Scales:
    """Typical sizes at a place from a run of the axis without effects."""
    chain, dt = axis.chain, float(run.time[1] - run.time[0])
    body = chain.body(place)
    body = 0 if body is None else body
    coupling = chain.coupling(place)
    torque = run.torque * chain.gain if coupling is None else run.coupling_torque[:, coupling]
    deflection, stiffness = 0.0, chain.couplings[0].stiffness if chain.couplings else 0.0
    if coupling is not None:
        c = chain.couplings[coupling]
        deflection = float(np.std(c.ratio * run.q[:, coupling] - run.q[:, coupling + 1]))
        stiffness = c.stiffness
    v, travel = run.v[:, body], float(np.ptp(run.q[:, body]))
    turned = max(float(np.ptp(run.q[:, 0])), 1e-12)  # spatial laws of the gear run over the motor's angle
    u = run.torque
    rms = lambda a: float(np.sqrt(np.mean(a**2)))  # noqa: E731
    return Scales(
        torque=rms(torque), max_torque=float(np.max(np.abs(torque))), velocity=rms(v), max_velocity=float(np.max(np.abs(v))),
        deflection=deflection, inertia=chain.bodies[body].inertia, stiffness=stiffness, travel=travel, input=rms(u),
        max_input=float(np.max(np.abs(u))), output=rms(run.velocity), dt=dt, duration=float(run.time[-1]),
        orders=(2 * math.pi * 3 / turned,),
    )  # fmt: skip


def effect_cases(axis: Axis, u: np.ndarray, dt: float = DT) -> tuple[list[Case], list[tuple[str, str]]]:
    """One case for every registered effect at every place, at the first start of a fit; and what the chain has no place for."""
    bare = Axis(axis.chain, (), axis.backlash_law)
    run = ode.simulate(bare, u, dt)
    cases, skipped = [], []
    for name, cls in registered().items():
        for place in cls.places:
            try:
                cls(place=place, **dict.fromkeys((x.name for x in cls.specs()), 1.0)).ports(axis.chain)
            except NotApplicableError as error:
                skipped.append((f"{name}@{place}", str(error)))
                continue
            except ValueError:
                pass  # the values of the trial, not the place
            values = cls.starts(scales_at(bare, run, place))[0]
            try:
                effect = cls(place=place, **values)
                with_it = bare + effect
                assemble(with_it)
            except ValueError as error:
                skipped.append((f"{name}@{place}", str(error)))
                continue
            cases.append(Case(effect.key, with_it, effect.tolerance, kernel=max(KERNEL, effect.tolerance)))
    return cases, skipped


def _make(name: str, **values: float) -> Effect:
    return effect_class(name)(**values)  # type: ignore[arg-type]


def study_cases(axis: Axis) -> list[Case]:
    """The study's levels, gaps, peaks and their combinations on the robot axis, with the limits asked of them."""
    e = _make
    out = [Case("linear", axis, 1e-5, literal=1e-5)]
    for level, limit in ((0.0355, 5e-4), (0.1, 5e-4), (0.355, 1e-3)):
        out.append(Case(f"Fc {level}", axis + e("coulomb_friction", torque_Nm=level), 2e-5, limit, 5e-5))
    out += [Case(f"Fc 0.1 peak {p:g}", axis + e("static_friction", torque_Nm=0.1, peak=p), 2e-5) for p in (2.0, 5.0)]
    out += [Case(f"gap {g:g}", axis + e("backlash", gap_rad=g), 2e-5, literal=1e-3) for g in (1e-4, 5e-4, 1e-3)]
    for gap, level in ((5e-4, 0.1), (1e-3, 0.355)):
        both = axis + e("backlash", gap_rad=gap)
        out.append(Case(f"gap {gap:g} + Fc {level}", both + e("coulomb_friction", torque_Nm=level), 2e-5, None))
        for peak in (2.0, 5.0):
            name = f"gap {gap:g} + Fc {level} peak {peak:g}"
            # a torque below the breakaway level would compare standstill with standstill
            drive = max(1.0, math.ceil(1.1 * level * peak))
            if drive > 1:
                name += f", {drive:g} Nm"
            out.append(Case(name, both + e("static_friction", torque_Nm=level, peak=peak), 2e-5, None, drive=drive))
    return out


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


def _judge(engine: str, run: np.ndarray, truth: np.ndarray, limit: float, chaotic: bool, seconds: float, note: str = "") -> Cell:
    error = relative(run, truth)
    missed = Status.CHAOTIC if chaotic else Status.MISSED
    status = Status.HOLDS if error <= limit else missed
    return Cell(engine, error, limit, status, seconds, note)


def _timed(run: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    out = run()
    return out, time.perf_counter() - start


def compare(case: Case, model: Path, u: np.ndarray, dt: float, batched: Trajectory) -> Row:
    """One case through every engine."""
    truth, kind, own, sensitivity = _truth(case.axis, u, dt)
    chaotic = sensitivity > CHAOTIC
    run, seconds = _timed(lambda: ode.simulate(case.axis, u, dt))
    cells = [_judge("kernel", run.velocity, truth, case.kernel, chaotic, seconds)]
    run, seconds = _timed(lambda: accurate.simulate(case.axis, u, dt))
    cells.append(_judge("accurate", run.velocity, truth, case.accurate, chaotic, seconds))
    same = np.array_equal(run.velocity, batched.velocity)
    cell = _judge("batch", batched.velocity, truth, case.accurate, chaotic, 0.0, "the accurate runner's bits" if same else "")
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
            cells.append(_judge("literal", plain.velocity, other, case.literal, chaotic, seconds, note))
    return Row(case.name, kind, own, sensitivity, tuple(cells))


def scaling_row(axis: Axis, model: Path, u: np.ndarray, dt: float) -> Row:
    """Gap 5e-4 at full torque against five times gap 1e-4 at a fifth of it: the same number to rounding, in every runner."""
    big, small = (axis + _make("backlash", gap_rad=g) for g in (5e-4, 1e-4))
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
        cells.append(_judge(name, 5 * fifth.velocity, full.velocity, 1e-9, False, seconds))
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
    for effect in axis.effects:
        if effect.id == "coulomb_friction":
            body = axis.chain.body(effect.place)
            assert body is not None
            lost += effect.values["torque_Nm"] * cumulative_simpson(np.abs(run.v[:, body]), x=run.time, initial=0)
    return float(np.max(np.abs(stored + lost - stored[0])) / stored[0])


def energy_rows(axis: Axis, model: Path) -> list[Row]:
    """Release from a deflection, no torque, the negative damping taken out."""
    dt = 5e-5
    passive = axis.with_linear({p.name: 0.0 for p in axis.chain.linear_parameters() if p.kind == "damping" and p.value < 0})
    start = np.zeros((2, len(axis.chain.bodies)))
    start[0, -1] = 0.01
    u = np.zeros(4001)
    eventful = passive + _make("coulomb_friction", torque_Nm=0.1) + _make("backlash", gap_rad=5e-4)
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


def check_all(model: str | Path | None = None, *, duration: float = 10.0, amplitude: float = 1.0) -> Iterator[Row | Report]:
    """Run every case; yields each row as it is done and last the report.

    ``model``: a file, or the shipped robot axis when None. ``duration`` [s] and ``amplitude`` [N m | N] are those of the chirp,
    0.5 to 30 Hz. The study's cases and the laws run on the robot axis only.
    """
    path = shipped_model("robot_axis1") if model is None else Path(model)
    axis = load_axis(path)
    u = chirp(duration, DT, amplitude, 0.5, 30.0)
    robot = axis == load_axis(shipped_model("robot_axis1"))
    cases = study_cases(axis) if robot else [Case("the model as it is", axis, 1e-4, literal=None)]
    more, skipped = effect_cases(axis, u)
    cases += more
    rows = []
    # in the batch, together; then each alone
    factors = sorted({c.drive for c in cases})
    together = rollout([c.axis for c in cases], [Drive(f * u, DT) for f in factors], engine=Engine.ACCURATE)

    def one(at: int) -> Row:
        batched = together[at][factors.index(cases[at].drive)]
        if not isinstance(batched, Trajectory):
            raise batched
        return compare(cases[at], path, cases[at].drive * u, DT, batched)

    with caught_warnings(), ThreadPoolExecutor(os.cpu_count()) as pool:
        for row in pool.map(one, range(len(cases))):
            rows.append(row)
            yield row
    if robot:
        for row in (scaling_row(axis, path, u, DT), *energy_rows(axis, path)):
            rows.append(row)
            yield row
    yield Report(tuple(rows), tuple(skipped))


def table(rows: Sequence[Row]) -> list[str]:
    """The rows as text."""
    engines = ("exact", "kernel", "accurate", "batch", "literal")
    width = max(len(r.name) for r in rows)
    head = f"{'case':{width}s}  {'truth':10s} {'own err':>8s} {'sensit.':>8s} " + " ".join(f"{e:>16s}" for e in engines)
    out = [head, "-" * len(head)]
    for row in rows:
        by = {c.engine: c for c in row.cells}
        cells = []
        for engine in engines:
            c = by.get(engine)
            if c is None:
                cells.append(f"{'':>16s}")
            elif c.status is Status.ABSENT:
                cells.append(f"{'not in MJCF':>16s}")
            else:
                mark = {Status.HOLDS: " ", Status.MISSED: "!", Status.CHAOTIC: "~"}[c.status]
                cells.append(f"{c.error:7.1e}/{c.limit:.0e} {mark}")
        out.append(f"{row.name:{width}s}  {row.truth:10s} {row.truth_error:8.1e} {row.sensitivity:8.1e} " + " ".join(cells))
    out += ["", "error / limit, relative RMS of motor velocity; ! missed, ~ chaotic (sensitivity above 1e-6: shown, not judged)"]
    return out


def plot(report: Report, path: Path) -> None:
    """Errors of the engines by case, with their limits, on a log scale."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = report.rows
    figure = Figure(figsize=(9.5, 0.24 * len(rows) + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    colours = {"exact": "#777777", "kernel": "#0072B2", "accurate": "#009E73", "batch": "#56B4E9", "literal": "#D55E00"}
    marks = {"exact": "D", "kernel": "o", "accurate": "s", "batch": "x", "literal": "^"}
    y = np.arange(len(rows))
    for engine, colour in colours.items():
        at = [(i, c) for i, r in enumerate(rows) for c in r.cells if c.engine == engine and math.isfinite(c.error)]
        if not at:
            continue
        where = [i for i, _ in at]
        axes.plot([max(c.error, 1e-15) for _, c in at], where, marks[engine], color=colour, ms=5, label=engine, mew=1.4)
        axes.plot([c.limit for _, c in at], where, "|", color=colour, ms=11, mew=1.6, alpha=0.7)
    seen = [(i, r.sensitivity) for i, r in enumerate(rows) if r.sensitivity > 0]
    axes.plot([s for _, s in seen], [i for i, _ in seen], ".", color="#BBBBBB", ms=6, label="sensitivity to 1e-10 rad", zorder=0)
    axes.set_xscale("log")
    axes.set_yticks(y, [r.name for r in rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="x", color="#E0E0E0")
    axes.set_axisbelow(True)
    axes.set_xlabel("relative RMS error of motor velocity (bars: limits)")
    axes.set_title("MuJoCo and the kernel against the analytic equations", fontsize=11)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    figure.savefig(path, dpi=130)
