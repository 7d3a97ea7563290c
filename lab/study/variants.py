"""The robustness map: the experiments and pipelines under which every claim is asked again."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from lab.study.cell import Cell, Experiment
from lab.study.pipeline import BETTER, FAITHFUL, Pipeline
from lab.study.plants import PLANTS

__all__ = ["AMPLITUDES", "BASE", "BASE_BETTER", "Variant", "cells", "robustness_map"]

AMPLITUDES = (0.25, 0.5, 1.0, 2.0, 5.0)
"""Input torque [Nm]."""


@dataclass(frozen=True)
class Variant:
    """One column of the map: an experiment and a pipeline; ``changed`` says in what it differs from its family's base.

    ``linear_engine``: what runs the linear case (the literal model, where MJCF says it all), else as the experiment.
    """

    family: str
    changed: str
    experiment: Experiment
    pipeline: Pipeline
    linear_engine: str | None = None

    def cell(self, plant: str) -> Cell:
        """The cell of a case under this variant."""
        e = self.experiment
        if self.linear_engine and plant == "linear":
            e = replace(e, engine=self.linear_engine)
        return Cell(plant, e, self.pipeline)


BASE = Variant("report", "base", Experiment(engine="accurate"), FAITHFUL, "literal")
"""2 Nm, 20 s, 0.5 to 30 Hz, 0.01 rad/s of noise, in MuJoCo, through the report's pipeline."""
BASE_BETTER = Variant("better", "base", Experiment(high_hz=45.0, engine="accurate"), BETTER, "literal")
"""The same with a chirp to 45 Hz, which holds the second peak, through the better pipeline."""


def robustness_map(quick: bool = False) -> tuple[Variant, ...]:
    """The two bases, then variants: one thing changes at a time, amplitude in both bands; away from the bases the ODE runs."""
    out = [BASE, BASE_BETTER]
    for base in (BASE, BASE_BETTER):
        e, p, family = replace(base.experiment, engine="ode"), base.pipeline, base.family
        other = 45.0 if e.high_hz == 30.0 else 30.0

        def add(changed: str, experiment: Experiment, pipeline: Pipeline = p, family: str = family) -> None:
            out.append(Variant(family, changed, experiment, pipeline))

        for amplitude in (0.5, 5.0) if quick else AMPLITUDES:
            if amplitude != e.amplitude:
                add(f"{amplitude:g} Nm", replace(e, amplitude=amplitude))
        if quick:
            continue
        add("ODE", e)
        for amplitude in AMPLITUDES:
            label = f"{other:g} Hz" + ("" if amplitude == e.amplitude else f", {amplitude:g} Nm")
            add(label, replace(e, amplitude=amplitude, high_hz=other))
        for duration in (10.0, 40.0):
            add(f"{duration:g} s", replace(e, duration=duration))
        for noise in (0.0, 0.1):
            add(f"noise {noise:g}", replace(e, noise=noise))
        add("other noise", replace(e, seed=2))
        nb, nc, nd, nf, nk = p.orders
        for more in (-1, 1):
            orders = (nb + more, nc + more, nd + more, nf + more, nk)
            add("[" + " ".join(map(str, orders)) + "]", e, replace(p, orders=orders))
        if family == "report":
            add("long search", e, replace(p, name="search", long_search=True))
    return tuple(out)


def cells(variants: Iterable[Variant]) -> list[Cell]:
    """Every case under every variant."""
    return [v.cell(p) for v in variants for p in PLANTS]
