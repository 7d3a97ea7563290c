"""Measured against modelled output of several models on one data set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.data import IOData, frozen
from ident.model import PolyModel
from ident.predict import predicted, simulated
from ident.quality import fit_percent
from mjsim.errors import InputError

__all__ = ["Comparison", "compare"]


@dataclass(frozen=True)
class Comparison:
    """Measured against modelled output of several models.

    names, fit_percent: one entry per model. outputs: (models, N). horizon: samples, or None for simulation.
    """

    names: tuple[str, ...]
    fit_percent: tuple[float, ...]
    outputs: np.ndarray
    data: IOData
    horizon: int | None


def compare(data: IOData, models: dict[str, PolyModel], horizon: int | None = None) -> Comparison:
    """Simulate (``horizon=None``) or predict the output of each model and give its NRMSE fit; MATLAB ``compare(data, sys,
    k)``."""
    if not models:
        raise InputError("compare", "no model", "at least one")
    outputs = []
    for name, model in models.items():
        if abs(model.dt / data.dt - 1) > 1e-6:
            raise InputError(
                f"model {name}", f"dt = {model.dt:g} s, data {data.dt:g} s", "equal sampling intervals", "decimate the data alike"
            )
        outputs.append(simulated(model, data) if horizon is None else predicted(model, data, horizon))
    fits = tuple(fit_percent(data.y, o) if np.all(np.isfinite(o)) else float("-inf") for o in outputs)
    return Comparison(tuple(models), fits, frozen(np.array(outputs)), data, horizon)
