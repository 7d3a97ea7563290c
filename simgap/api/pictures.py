"""Pictures of a diagnosis as matplotlib figures; none is shown or kept by pyplot."""

from __future__ import annotations

import io
from typing import final

import numpy as np
from matplotlib.figure import Figure

from diagnose.result import Diagnosis
from diagnose.robot.result import RobotDiagnosis

__all__ = ["NotebookFigure", "of_axis", "of_robot"]

MEASURED, NOMINAL, CORRECTED = "#222222", "#c44e52", "#2a7ab9"
MOST = 2000  # points of a curve: more than a screen has


@final
class NotebookFigure(Figure):
    """A figure that a notebook shows where it is the value of a cell; plain figures are shown with pyplot only."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def _thin(count: int) -> slice:
    return slice(None, None, max(1, count // MOST))


def of_axis(result: Diagnosis) -> Figure:
    """The first recording: measured and predicted above, errors below; an empty figure where nothing was searched."""
    figure = NotebookFigure(figsize=(9, 5), layout="constrained")
    if not result.traces:
        figure.text(0.5, 0.5, result.summary, ha="center", wrap=True)
        return figure
    trace = result.traces[0]
    above, below = figure.subplots(2, 1, sharex=True)
    cut = _thin(len(trace.time))
    above.plot(trace.time[cut], trace.measured[cut], color=MEASURED, label="measured")
    for name, values, colour in (("as given", trace.nominal, NOMINAL), ("corrected", trace.corrected, CORRECTED)):
        if values is not None:
            above.plot(trace.time[cut], values[cut], color=colour, label=name, linewidth=1)
            below.plot(trace.time[cut], (trace.measured - values)[cut], color=colour, label=name, linewidth=1)
    above.set(ylabel=f"{result.channel} [{result.unit}]", title=result.summary)
    above.title.set_wrap(True)
    below.set(xlabel="time [s]", ylabel=f"error [{result.unit}]")
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower right", ncols=3, frameon=False)
    return figure


def of_robot(result: RobotDiagnosis) -> Figure:
    """Torque of each joint in its first recording: measured, by the model as given, and corrected."""
    figure = NotebookFigure(figsize=(9, 1.8 * max(2, len(result.joints))), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(result.joints), 1, sharex=True))
    for place, (name, joint) in zip(axes, result.joints.items(), strict=True):
        trace = joint.traces[0]
        place.plot(trace.time, trace.measured, color=MEASURED, label="measured")
        place.plot(trace.time, trace.nominal, color=NOMINAL, label="as given", linewidth=1)
        place.plot(trace.time, trace.corrected, color=CORRECTED, label="corrected", linewidth=1)
        place.set(ylabel=f"{name} [{joint.unit}]", title=joint.verdict.value)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
    axes[-1].set(xlabel="time [s]")
    return figure
