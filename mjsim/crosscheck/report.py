"""What a cross-check says: rows of engines against a truth, as text, for JSON and as a picture."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["Cell", "Report", "Row", "Status", "plot", "table"]


class Status(enum.Enum):
    """How a comparison ended."""

    HOLDS = "holds"
    MISSED = "MISSED"
    CHAOTIC = "chaotic"
    ABSENT = "not expressible"


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
    """One case: its truth, what the truth is worth, and the engines against it.

    sensitivity: relative change of the motor's velocity over a relative change of the input; judged: the first seconds [s] that
    are compared, 0 where the motion is chaotic from the start, None where all of it is.
    """

    name: str
    truth: str
    truth_error: float
    sensitivity: float
    cells: tuple[Cell, ...]
    judged: float | None = None


@dataclass(frozen=True)
class Report:
    """The rows, and what was left out with its reason; robot: whether they are of a robot's joints."""

    rows: tuple[Row, ...]
    skipped: tuple[tuple[str, str], ...] = ()
    robot: bool = False

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
                "judged_s": r.judged,
                "engines": {
                    c.engine: {"error": c.error if math.isfinite(c.error) else None, "limit": c.limit, "status": c.status.value,
                               "seconds": round(c.seconds, 3), **({"note": c.note} if c.note else {})}
                    for c in r.cells
                },
            }
            for r in self.rows
        ]  # fmt: skip
        return {"rows": rows, "skipped": [{"case": n, "why": w} for n, w in self.skipped], "missed": list(self.missed)}


ENGINES = ("exact", "kernel", "accurate", "batch", "literal")
OF_AXIS = (
    "relative RMS of motor velocity; ! missed, ~ chaotic from the start: shown, not judged\n"
    "sensit.: relative change of the velocity over one of the input; compared while it is no more than 2"
)
OF_ROBOT = "relative RMS of what the case names; exact: MuJoCo by Runge-Kutta, literal: as the file has it; ! missed"


def table(rows: Sequence[Row], *, robot: bool = False) -> list[str]:
    """The rows as text; ``robot``: they are of a robot's joints."""
    engines = [e for e in ENGINES if not robot or any(c.engine == e for r in rows for c in r.cells)]
    width = max(len(r.name) for r in rows)
    own = "" if robot else f"{'own err':>8s} {'sensit.':>8s} "
    head = f"{'case':{width}s}  {'truth':12s} {own}" + " ".join(f"{e:>16s}" for e in engines)
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
        own = "" if robot else f"{row.truth_error:8.1e} {row.sensitivity:8.1e} "
        out.append(f"{row.name:{width}s}  {row.truth:12s} {own}" + " ".join(cells))
    out += ["", f"error / limit, {OF_ROBOT if robot else OF_AXIS}"]
    whole = max((row.judged or 0.0 for row in rows), default=0.0)
    out += [f"{row.name}: compared over the first {row.judged:.3g} s" for row in rows if row.judged and row.judged < whole]
    out += [f"{row.name}: {c.engine} {c.note}" for row in rows for c in row.cells if "timestep of" in c.note]
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
    lines = np.arange(len(rows))
    for engine, colour in colours.items():
        at = [(i, c) for i, r in enumerate(rows) for c in r.cells if c.engine == engine and math.isfinite(c.error)]
        if not at:
            continue
        where = [i for i, _ in at]
        axes.plot([max(c.error, 1e-15) for _, c in at], where, marks[engine], color=colour, ms=5, label=engine, mew=1.4)
        axes.plot([c.limit for _, c in at], where, "|", color=colour, ms=11, mew=1.6, alpha=0.7)
    axes.set_xscale("log")
    axes.set_yticks(lines, [r.name for r in rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="x", color="#E0E0E0")
    axes.set_axisbelow(True)
    axes.set_xlabel(f"relative RMS error{'' if report.robot else ' of motor velocity'} (bars: limits)")
    of_robot, of_axis = "MuJoCo against the equations of the robot", "MuJoCo and the kernel against the analytic equations"
    axes.set_title(of_robot if report.robot else of_axis, fontsize=11)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    figure.savefig(path, dpi=130)
