"""A page of the proof: Markdown, its pictures, and its figures as JSON, written together."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.serial import write_atomic
from mjsim.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["BLUE", "GREY", "RED", "Page", "Say", "axes", "interval", "number", "plain", "table", "write_page"]

Say = Callable[[str], None]  # told what a page is at
BLUE, RED, GREY = "#2a6f97", "#c44e52", "#777777"


@dataclass(frozen=True)
class Page:
    """One page: its file name without ending, Markdown (pictures named ``NAME/PICTURE.png``), pictures, figures for machines."""

    name: str
    text: str
    pictures: Mapping[str, Figure] = field(default_factory=dict)
    figures: Mapping[str, Any] = field(default_factory=dict)


def number(x: float | None, digits: int = 4) -> str:
    """A number in a table; a dash where there is none."""
    return "–" if x is None or not math.isfinite(x) else f"{x:.{digits}g}"


def interval(value: float, ci95: Sequence[float], digits: int = 4) -> str:
    """value [low, high]."""
    return f"{number(value, digits)} [{number(ci95[0], digits)}, {number(ci95[1], digits)}]"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def axes(width: float, height: float, columns: int = 1, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure in the manner of the project and its axes, row by row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    made = figure.subplots(rows, columns, squeeze=False)
    for a in made.flat:
        a.spines[["top", "right"]].set_visible(False)
        a.tick_params(labelsize=8)
        for label in (a.xaxis.label, a.yaxis.label, a.title):
            label.set_fontsize(9)
    return figure, list(made.flat)


def plain(value: Any) -> Any:
    """JSON has no NumPy numbers and none that are not finite."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_page(page: Page, folder: Path, *, figures: bool = True) -> Path:
    """``folder/NAME.md``, its pictures in ``folder/NAME/``, its ``figures`` in ``folder/NAME.json``. Raises InputError."""
    try:
        for name, figure in page.pictures.items():
            drawn = io.BytesIO()
            figure.savefig(drawn, format="png", metadata={"Software": None})
            write_atomic(folder / page.name / f"{name}.png", drawn.getvalue())
        if figures:
            write_atomic(folder / f"{page.name}.json", json.dumps(plain(page.figures), indent=1) + "\n")
        write_atomic(folder / f"{page.name}.md", page.text.rstrip() + "\n")
    except OSError as error:
        raise InputError(folder, f"cannot be written ({error.strerror})", "a writable folder") from None
    return folder / f"{page.name}.md"
